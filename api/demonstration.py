"""Verb ``demo``: the whole flow on the simulated stage, and a page that shows what came of it."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import yaml

from acquisition.capture import capture
from acquisition.dataset import IlluminationDataset, read_exr, staged_folder
from acquisition.dataset.mesh import write_ply
from acquisition.developing import Geometry
from acquisition.plan import CapturePlan, write_plan
from api.demo_stage import NEW_LIGHTS, demo_rig, held_out_lights
from api.devices import Bench, open_bench
from api.evaluation_report import Inspector, Seen, evaluation_content, mean_picture, stage_view
from api.plan_choice import choose_lights
from api.planning_wishes import Wishes
from api.report import write_report, write_summary_picture
from api.report.content import Coverage, Relit, ReportContent
from api.surface_source import surface_of_depth
from api.verbs.planning import capture_plan, rig_lights
from api.verbs.relighting import relight
from reconstruct.evaluate import Evaluation, evaluate
from reconstruct.holdout import Split
from reconstruct.model import Model, Progress, no_progress
from stage.lights import Light
from stage.planning import LightPlan
from stage.surface import triangulate_depth

MODELS = ("lambert", "method-1", "torrance-sparrow", "apparent-brdf")
RELIT_WITH = ("torrance-sparrow", "apparent-brdf")
METHOD, TARGET, PLANNING_S = "optimal", 0.9, 3.0
"""Fewest lights for nine tenths of what all candidates show, and how long they are looked for."""


class Stopwatch:
    """Seconds by step, in order."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._begin = time.perf_counter()

    @property
    def total_s(self) -> float:
        """Seconds since it was made."""
        return time.perf_counter() - self._begin

    @contextmanager
    def step(self, name: str) -> Iterator[None]:
        """Time the block as the step `name`."""
        begin = time.perf_counter()
        yield
        self.seconds[name] = time.perf_counter() - begin


def demo(out: Path, *, progress: Progress = no_progress) -> dict[str, Any]:
    """Plan, capture over simulated wires, fit, relight, judge and report.

    The simulated stage renders its own object (two materials, a texture, a concavity, light that bounces once) for
    whatever servos and lamp really did, and its camera answers with noisy RAW frames; the object's depth is what a
    range scan would give. Everything after that is the code that a real stage runs.

    Parameters
    ----------
    out : Path
        Folder to write; one that an earlier demo wrote is replaced. It holds the rig, both plans and datasets, the
        object's mesh, models, relit images, ``report.html``, ``picture.png`` and ``summary.json``.

    Returns
    -------
    dict
        ``out``, ``report``, ``seconds``, ``timings`` by step, ``candidates``, ``plan`` and ``models``, the rows of
        ``evaluate``.
    """
    watch = Stopwatch()
    with staged_folder(out, replace=is_demo(out)) as folder:
        rig = demo_rig()
        (folder / "rig.yaml").write_text(yaml.safe_dump(rig.to_json(), sort_keys=False), encoding="utf-8")
        with open_bench(rig) as bench:
            assert bench.world is not None, "the demo's rig is simulated"
            truth = bench.world.truth()
            watch.seconds["open the simulated stage"] = watch.total_s
            progress(0.1)
            with watch.step("plan"):
                surface = surface_of_depth(truth.depth, truth.mask, rig.camera.calibration())
                candidates = rig_lights(rig, source="rig.yaml")
                chosen = choose_lights(
                    candidates, surface, Wishes(method=METHOD, target=TARGET, time_limit_s=PLANNING_S)
                ).plan
                # With the mesh beside it, each step can be repeated by its own command.
                points = rig.camera.calibration().depth_to_points(truth.depth)
                write_ply(folder / "object.ply", *triangulate_depth(points, truth.mask))
                place = out / "object.ply"
                planned = capture_plan(candidates, chosen, surface=place)
                between = CapturePlan.choosing(held_out_lights(), provenance={"surface": str(place.resolve())})
                write_plan(planned, folder / "plan.json")
                write_plan(between, folder / "heldout.json")
            with watch.step("capture"):
                train = _photograph(bench, planned, folder / "dataset", surface.geometry, _part(progress, 0.15, 0.45))
                test = _photograph(bench, between, folder / "heldout", surface.geometry, _part(progress, 0.45, 0.6))
        with watch.step("fit, render and judge"):
            evaluation = _fit_and_judge(train, test, folder / "models", _part(progress, 0.6, 0.9))
        with watch.step("relight"):
            relit = _relit_views(folder)
        with watch.step("report"):
            content = _content(train, test, evaluation, candidates, chosen, relit)
            write_summary_picture(folder / "picture.png", content)
            write_report(folder / "report.html", replace(content, timings=dict(watch.seconds)))
        summary = {
            "seconds": watch.total_s,
            "timings": watch.seconds,
            "candidates": len(candidates),
            "plan": chosen.to_json(),
            "models": [row.to_json() for row in evaluation.rows],
        }
        (folder / "summary.json").write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    progress(1.0)
    return {"out": str(out), "report": str(out / "report.html"), **summary}


def is_demo(folder: Path) -> bool:
    """Whether a folder holds what an earlier demo wrote, and so may be replaced."""
    return all((folder / name).is_file() for name in ("rig.yaml", "heldout.json", "summary.json"))


def _part(progress: Progress, begin: float, end: float) -> Progress:
    return lambda share: progress(begin + (end - begin) * share)


def _photograph(
    bench: Bench, plan: CapturePlan, out: Path, geometry: Geometry, progress: Progress
) -> IlluminationDataset:
    return capture(
        plan,
        bench.motion,
        bench.lamp,
        bench.camera,
        out,
        rig=demo_rig(),
        geometry=geometry,
        name=f"dish-{out.name}",
        clock=bench.clock,
        progress=progress,
    )


def _fit_and_judge(
    train: IlluminationDataset, test: IlluminationDataset, models: Path, progress: Progress
) -> Evaluation:
    """Fit every model once, keep it in its folder, and judge it on the held-out lights."""
    look = Inspector(test)

    def keep(model: Model, split: Split, shown: list[int]) -> Seen:
        place = models / model.name
        place.mkdir(parents=True)
        model.save(place)
        return look(model, split, shown)

    return evaluate(train, MODELS, test=test, progress=progress, inspect=keep)


def _relit_views(folder: Path) -> list[Relit]:
    """Relight with `NEW_LIGHTS`, from the saved models."""
    lights = folder / "lights.json"
    lights.write_text(json.dumps([entry for _, entry in NEW_LIGHTS], indent=1) + "\n", encoding="utf-8")
    (folder / "relit").mkdir()
    views = []
    for model in RELIT_WITH:
        place = folder / "relit" / model
        relight(folder / "models" / model, lights, place)
        for number, (title, _) in enumerate(NEW_LIGHTS):
            outside = cv2.imread(str(place / f"{number:04d}.outside.png"), cv2.IMREAD_GRAYSCALE)
            image = read_exr(place / f"{number:04d}.exr")
            views.append(Relit(f"{title}, {model}", image, None if outside is None else outside > 0))
    return views


def _content(
    train: IlluminationDataset,
    test: IlluminationDataset,
    evaluation: Evaluation,
    candidates: Sequence[Light],
    chosen: LightPlan,
    relit: Sequence[Relit],
) -> ReportContent:
    base = evaluation_content(evaluation, train, test)
    best = min(evaluation.rows, key=lambda row: row.mae)
    share = chosen.coverage
    return replace(
        base,
        title="A light stage, end to end",
        lede=(
            f"{chosen.count} of {len(candidates)} places for the light were planned, photographed on a simulated stage "
            f"over its devices' own protocols, and reconstructed; {best.test} photographs from places in between, "
            "which no model has seen, say how wrong the renderings are."
        ),
        summary=(
            ("lights", f"{chosen.count} of {len(candidates)}, at least {chosen.lower_bound} are needed"),
            ("surface measured", f"diffuse {share['diffuse']:.1%}, specular {share['specular']:.1%}"),
            ("least error", f"{best.model}: {best.mae:.2f} grey levels, {best.psnr:.1f} dB"),
        ),
        stage=stage_view(train, mean_picture(train, range(len(train.frames))), candidates, chosen.lights),
        coverage=Coverage(
            curve=tuple(chosen.curve),
            limit_diffuse=share["limit_diffuse"] or 0.0,
            limit_specular=share["limit_specular"] or 0.0,
            target=TARGET,
            method=METHOD,
            lower_bound=chosen.lower_bound,
        ),
        relit=tuple(relit),
    )
