"""From plans to what their page shows."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from importlib.metadata import version

import numpy as np
from numpy.typing import NDArray

from acquisition.check.estimate import spoken_time
from api.report.content import StageView
from api.report.plan_content import CoverageMaps, Lack, PlanContent, PlanRow, Trace
from api.surface_source import Surface
from stage.lights import Light, light_vectors
from stage.measurability import Measurability
from stage.planning import LightPlan
from stage.planning.cost import TimeChoice
from stage.planning.cover import SPECULAR_NEED
from stage.planning.learning_cost import Learnt

MOST_VIEWS = 255
PERCENT = 100
SHADE, BRIGHT = 70, 235
"""Grey of the object's points that face the camera edge-on and straight on."""


def plan_content(
    lights: Sequence[Light],
    surface: Surface | None,
    measurable: Measurability | None,
    plans: Sequence[LightPlan],
    *,
    title: str = "Where the light must go",
    lede: str = "",
    target: float = 1.0,
    warnings: Sequence[str] = (),
    seconds: Mapping[str, float] | None = None,
    lights_by_target: Iterable[Trace] = (),
    times: Sequence[TimeChoice] = (),
    learnt: Mapping[str, Sequence[Learnt]] | None = None,
    provenance: Mapping[str, str] | None = None,
) -> PlanContent:
    """What the page of a plan shows.

    Parameters
    ----------
    lights : sequence of Light
        All candidates.
    surface : Surface or None
        The object.
    measurable : Measurability or None
        Of `surface` by `lights`.
    plans : sequence of LightPlan
        The plan that the page is about, then those of other methods for the same task.
    title, lede : str
        Headline, and the sentence below it; one that says what was chosen by default.
    target : float
        Share of what all candidates show that was asked for.
    warnings : sequence of str
        More than the plan's own.
    seconds : mapping of str to float, optional
        Seconds of a capture by method.
    lights_by_target : iterable of Trace
        Number of lights against target, by method, and the bound.
    times : sequence of TimeChoice
        As from `stage.planning.cost.time_curve`.
    learnt : mapping of str to sequence of Learnt, optional
        Expected error against seconds, by name of the line.
    provenance : mapping of str to str, optional
        What to say of where it comes from, besides the software's version.
    """
    chosen = plans[0]
    taken = dict(seconds or {})
    maps = None if surface is None or measurable is None else coverage_maps(surface.mask, measurable, chosen.lights)
    return PlanContent(
        title=title,
        lede=lede or f"{chosen.count} of {len(lights)} candidate lights, chosen by the method '{chosen.method}'.",
        summary=_summary(chosen, len(lights), taken.get(chosen.method)),
        warnings=tuple(dict.fromkeys([*chosen.warnings, *warnings])),
        stage=_stage(lights, chosen.lights, surface),
        maps=maps,
        plans=tuple(
            PlanRow(
                plan.method,
                plan.count,
                plan.lower_bound,
                plan.bound_by,
                tuple(plan.curve),
                taken.get(plan.method),
                plan.figures,
                plan is chosen,
            )
            for plan in plans
        ),
        limits=_limits(chosen),
        target=target,
        lights_by_target=tuple(lights_by_target),
        seconds_by_target=time_traces(times),
        error_by_seconds=tuple(
            Trace(name, [step.seconds for step in steps], [step.objective for step in steps])
            for name, steps in (learnt or {}).items()
            if steps
        ),
        provenance={"software": f"lightstage {version('lightstage')}", **(provenance or {})},
    )


def coverage_maps(mask: NDArray[np.bool_], measurable: Measurability, chosen: Sequence[int]) -> CoverageMaps:
    """Views of each object pixel (height, width) by the chosen lights, and what no candidate shows of it."""
    no_diffuse = ~measurable.diffuse_bits.any(1)
    few_highlights = np.bitwise_count(measurable.specular_bits).sum(1, dtype=np.int64) < SPECULAR_NEED
    lack = np.select(
        [no_diffuse & few_highlights, no_diffuse, few_highlights],
        [Lack.BOTH, Lack.DIFFUSE, Lack.HIGHLIGHTS],
        Lack.NOTHING,
    )
    if measurable.seen is not None:
        lack[~measurable.seen] = Lack.SURFACE
    return CoverageMaps(
        mask,
        _on(mask, _views(measurable.diffuse_bits, chosen)),
        _on(mask, _views(measurable.specular_bits, chosen)),
        _on(mask, lack),
    )


def target_traces(found: Mapping[str, Sequence[tuple[float, int]]], bound: Sequence[tuple[float, int]]) -> list[Trace]:
    """Lights against target: pairs by method, and those of the proved bound."""
    named = [(name, pairs, False) for name, pairs in found.items()] + [("proved: at least", bound, True)]
    return [
        Trace(name, [t for t, _ in pairs], [float(n) for _, n in pairs], sure) for name, pairs, sure in named if pairs
    ]


def time_traces(times: Sequence[TimeChoice]) -> tuple[Trace, ...]:
    """Seconds against target: fewest lights, least time, and the bound."""
    if not times:
        return ()
    targets = [choice.target for choice in times]
    return (
        Trace("fewest lights", targets, [choice.fewest.seconds for choice in times]),
        Trace("least time", targets, [choice.quickest.seconds for choice in times]),
        Trace("proved: at least", targets, [choice.quickest.bound_s for choice in times], proven=True),
    )


def _views(bits: NDArray[np.uint8], chosen: Sequence[int]) -> NDArray[np.int64]:
    views = np.zeros(len(bits), dtype=np.int64)
    for light in set(chosen):
        views += (bits[:, light // 8] >> (7 - light % 8)) & 1
    return np.minimum(views, MOST_VIEWS)


def _on(mask: NDArray[np.bool_], values: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Values (P,) of the object's pixels in their places; 0 elsewhere."""
    out = np.zeros(mask.shape, dtype=np.uint8)
    out[mask] = values
    return out


def _summary(chosen: LightPlan, candidates: int, seconds: float | None) -> tuple[tuple[str, str], ...]:
    rows = [("lights", f"{chosen.count} of {candidates}")]
    if chosen.curve:
        proof = "no fewer can do" if chosen.gap == 0 else f"at least {chosen.lower_bound}"
        rows.append(("proved", proof))
        for part in ("diffuse", "specular"):
            share = chosen.coverage[part]
            if share is not None:
                rows.append((f"{part} coverage", f"{PERCENT * share:.1f} %"))
    if seconds is not None:
        rows.append(("capture", spoken_time(seconds)))
    return tuple(rows)


def _limits(chosen: LightPlan) -> tuple[float, float] | None:
    diffuse, specular = (chosen.coverage[f"limit_{part}"] for part in ("diffuse", "specular"))
    return None if diffuse is None or specular is None else (diffuse, specular)


def _stage(lights: Sequence[Light], chosen: Sequence[int], surface: Surface | None) -> StageView | None:
    """Lights, camera and surface; None where near and distant lights are mixed, which have no common picture."""
    if len({light.is_distant for light in lights}) > 1:
        return None
    vectors = light_vectors(list(lights))
    camera = None if surface is None else surface.camera
    if surface is None or surface.points is None:
        return StageView(vectors, tuple(chosen), lights[0].is_distant, camera)
    on = surface.mask & np.isfinite(surface.points).all(-1)
    facing = np.clip(np.einsum("ij,ij->i", surface.normals[on], surface.view[on]), 0, 1)
    grey = np.rint(SHADE + (BRIGHT - SHADE) * facing).astype(np.uint8)
    rgb = np.repeat(grey[:, None], 3, axis=1)
    return StageView(vectors, tuple(chosen), lights[0].is_distant, camera, surface.points[on], rgb)
