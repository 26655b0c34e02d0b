"""Command ``lightstage plan`` and its options; the work is in `api.verbs.planning`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from api import console

Json = Annotated[bool, typer.Option("--json", help="One JSON value on stdout, progress on stderr.")]


def plan(
    out: Annotated[Path, typer.Option(metavar="plan.json", help="Plan to write.")],
    rig: Annotated[
        Path | None,
        typer.Option(
            metavar="RIG",
            help="Description of the stage: its camera, and its own dome of lights where --candidates are not given.",
        ),
    ] = None,
    candidates: Annotated[
        Path | None,
        typer.Option(metavar="DATASET|lights.json", help="Lights to choose from, instead of the rig's own."),
    ] = None,
    surface: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE|DATASET",
            help="What is to be lit: a mesh in metres as --rig sees it, or a dataset with depth or normals.",
        ),
    ] = None,
    method: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="optimal, greedy, static, information, farthest or random; the last three need no surface.",
        ),
    ] = "optimal",
    count: Annotated[
        int | None, typer.Option(metavar="K", help="Choose exactly K lights; the target then has no say.")
    ] = None,
    target: Annotated[
        float | None,
        typer.Option(
            metavar="F",
            help="Share of what all candidates can show, diffuse and specular; 1 by default, 0.8 to saturation.",
        ),
    ] = None,
    criterion: Annotated[
        Literal["lobe", "published"],
        typer.Option(
            help="What counts as shown: by the expected highlight, or by the published half angles, 60 and 20 degrees."
        ),
    ] = "lobe",
    roughness: Annotated[
        float | None,
        typer.Option(
            metavar="ALPHA",
            help="Expected roughness, as in the maps of a fitted model; 0.247 by default, a highlight of 10 degrees.",
        ),
    ] = None,
    highlight: Annotated[
        float,
        typer.Option(
            metavar="RATIO",
            help="Expected peak of the highlight, as a multiple of the diffuse radiance; 0 for a matte object.",
        ),
    ] = 1.0,
    apart: Annotated[
        float | None,
        typer.Option(
            metavar="DEG",
            help="Have the two highlights of a pixel differ by this half angle, so that its roughness can be told.",
        ),
    ] = None,
    stop: Annotated[
        Literal["target", "saturation"],
        typer.Option(help="When static and greedy end: at the target, or by the published rule."),
    ] = "target",
    aim: Annotated[
        Literal["relighting", "a-optimal", "d-optimal"],
        typer.Option(
            help="What the method information makes small: the error of relighting, or of a pixel's parameters."
        ),
    ] = "relighting",
    minimise: Annotated[
        Literal["lights", "time"], typer.Option(help="Fewest lights, or the least seconds of a capture on --rig.")
    ] = "lights",
    model: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="With --method information: choose by what this model lacks in the pictures of --candidates.",
        ),
    ] = None,
    tolerance: Annotated[
        float | None,
        typer.Option(metavar="ERROR", help="With --model: enough at this expected error in grey levels, of 255."),
    ] = None,
    seed: Annotated[int, typer.Option(metavar="N", help="Start of what is drawn at random.")] = 0,
    time_limit: Annotated[
        float, typer.Option(metavar="SECONDS", help="For the search; what is found and proved by then is the plan.")
    ] = 10.0,
    report: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Also write a page, or a picture (.png), with maps, curves and all methods; takes up to three "
            "times the limit more.",
        ),
    ] = None,
    json: Json = False,
) -> None:
    """Choose the lights that show the most, with a proof of how few could do."""
    from api.plan_words import for_people
    from api.planning_wishes import EXPECTED_ALPHA, Wishes
    from api.verbs.planning import plan as run

    wishes = Wishes(
        method=method,
        count=count,
        target=target,
        criterion=criterion,
        roughness=EXPECTED_ALPHA if roughness is None else roughness,
        highlight=highlight,
        apart_deg=apart,
        stop=stop,
        aim=aim,
        minimise=minimise,
        seed=seed,
        time_limit_s=time_limit,
    )
    with console.progress("plan") as progress:
        result = run(
            out,
            rig=rig,
            candidates=candidates,
            surface=surface,
            wishes=wishes,
            model=model,
            tolerance=tolerance,
            report=report,
            progress=progress,
        )
    if json:
        console.write_json(result)
    else:
        console.write_facts(for_people(result, asked=count is not None or stop == "saturation"))
