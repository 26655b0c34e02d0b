"""Command ``lightstage``: every verb, its options, and nothing else; the work is in `api.verbs`.

Only what every verb needs is imported here, so that ``--help`` and a mistyped option answer at once.
"""

from __future__ import annotations

import sys
import warnings
from pathlib import Path
from typing import Annotated, Any

import typer

from api import console
from api.calibrate_cli import calibrate
from api.plan_cli import plan

app = typer.Typer(
    name="lightstage",
    cls=console.OneSentence,
    help="Plan, capture, reconstruct and relight with a light stage, and say how wrong the result is.",
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

rig_app = typer.Typer(name="rig", help="Look after the devices of a stage.", rich_markup_mode=None)
app.add_typer(rig_app)
app.add_typer(calibrate)

Json = Annotated[bool, typer.Option("--json", help="One JSON value on stdout, progress on stderr.")]
Dataset = Annotated[Path, typer.Argument(metavar="DATASET", help="A dataset, or any folder that 'import' reads.")]


@app.command()
def demo(
    out: Annotated[Path, typer.Option(help="Folder for datasets, models, pictures and report.html.")] = Path(
        "demo-out"
    ),
    json: Json = False,
) -> None:
    """Plan, capture on the simulated stage, fit, relight and report."""
    from api.demonstration import demo as run

    with console.progress("demo") as progress:
        result = run(out, progress=progress)
    if json:
        console.write_json(result)
        return
    _write_rows(result["models"])
    console.write_facts(
        {
            "lights": f"{result['plan']['count']} of {result['candidates']}",
            "seconds": f"{result['seconds']:.0f}",
            "report": result["report"],
        }
    )


@app.command(name="import")
def import_(
    source: Annotated[Path, typer.Argument(metavar="SOURCE", help="Folder of photographs.")],
    out: Annotated[Path, typer.Argument(metavar="OUT", help="New dataset folder.")],
    format: Annotated[str, typer.Option(metavar="auto|dataset|lp|diligent|psbox", help="Layout of SOURCE.")] = "auto",
    transfer: Annotated[
        str, typer.Option(metavar="auto|linear|srgb|gamma:2.2", help="How stored values relate to radiance.")
    ] = "auto",
    lp: Annotated[str | None, typer.Option(metavar="NAME", help="Which .lp file, where SOURCE holds several.")] = None,
    json: Json = False,
) -> None:
    """Write a foreign folder of photographs as a dataset."""
    from api.verbs.importing import import_ as run

    with console.progress("import"):
        result = run(source, out, format=format, transfer=transfer, lp=lp)
    console.write_result(result, json)


app.command()(plan)


@app.command(name="check")
def check_plan(
    rig: Annotated[Path, typer.Option(metavar="RIG", help="Description of the stage and its devices.")],
    plan: Annotated[Path, typer.Option(metavar="plan.json", help="Where the light goes.")],
    out: Annotated[
        Path | None, typer.Argument(metavar="OUT", help="Dataset folder; of an interrupted capture, what is left.")
    ] = None,
    camera: Annotated[bool, typer.Option("--camera", help="Ask the camera which exposure times it offers.")] = False,
    most: Annotated[
        int | None, typer.Option(metavar="N", help="Lights that 'capture --until' may take; all have to be possible.")
    ] = None,
    json: Json = False,
) -> None:
    """Say whether a plan can be captured, and how long it takes; nothing moves."""
    from api.verbs.checking_plan import check_plan as run

    with console.progress("check"):
        estimate = run(rig, plan, out, ask_camera=camera, most=most)
    if json:
        console.write_json(estimate.to_json())
    else:
        print(estimate.summary())


@app.command()
def capture(
    out: Annotated[Path, typer.Argument(metavar="OUT", help="New dataset folder.")],
    rig: Annotated[Path, typer.Option(metavar="RIG", help="Description of the stage and its devices.")],
    plan: Annotated[Path, typer.Option(metavar="plan.json", help="Where the light goes.")],
    resume: Annotated[
        bool, typer.Option("--resume", help="Take only what an interrupted capture has not taken.")
    ] = False,
    alert: Annotated[
        list[str] | None,
        typer.Option(metavar="URL|COMMAND", help="Whom to tell when somebody is needed; may be given several times."),
    ] = None,
    patience: Annotated[
        float, typer.Option(metavar="SECONDS", min=0, help="How long to wait for a disk that refuses.")
    ] = 600.0,
    until: Annotated[
        str | None,
        typer.Option(
            metavar="ERROR|auto",
            help="Choose among all candidates as the capture goes, until other pictures are expected to be off by "
            "ERROR grey levels; auto: until nothing more is to be gained.",
        ),
    ] = None,
    model: Annotated[
        str | None, typer.Option(metavar="NAME", help="What --until fits; torrance-sparrow by default.")
    ] = None,
    most: Annotated[int | None, typer.Option(metavar="N", help="Lights that --until takes at the most.")] = None,
    batch: Annotated[
        int | None, typer.Option(metavar="B", help="Lights that --until chooses at a time; 1 by default.")
    ] = None,
    json: Json = False,
) -> None:
    """Photograph the object under every light of a plan, or under as many as it takes."""
    from api.adaptive_capture import until_of
    from api.verbs.capturing import capture as run

    with console.progress("capture") as progress:
        result = run(
            rig,
            plan,
            out,
            resume=resume,
            alerts=alert or (),
            patience_s=patience,
            until=until_of(until, model=model, most=most, batch=batch),
            note=console.say,
            progress=progress,
        )
    console.write_result(result, json)


@app.command()
def session(
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Folder that a running 'capture' was given.")],
    command: Annotated[
        str, typer.Argument(metavar="status|pause|resume|stop|abort|emergency-stop|skip|retake", help="What to do.")
    ],
    shot: Annotated[int | None, typer.Argument(metavar="N", help="Number of the shot to take again.")] = None,
    reason: Annotated[str | None, typer.Option(metavar="TEXT", help="For the record.")] = None,
    json: Json = False,
) -> None:
    """Look at a running capture, and steer it from another terminal."""
    from api.verbs.controlling import session as run

    found = run(out, command, shot=shot, reason=reason)
    if json:
        console.write_json(found)
        return
    counted = {"taken": f"{found['taken']} of {found['shots']} shots"}
    console.write_facts({key: value for key, value in (found | counted).items() if value not in ([], {}, None, "")})


@app.command()
def simulate(
    rig: Annotated[Path, typer.Option(metavar="RIG", help="Description of the stage.")],
    rig_out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the description with the simulators' addresses here.")
    ] = None,
    faults: Annotated[
        Path | None, typer.Option(metavar="SCRIPT", help="What is to go wrong, one JSON per line.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the sensor's noise.")] = 0,
    control_port: Annotated[int, typer.Option(min=0, max=65535, help="For commands; 0 takes a free one.")] = 0,
    json: Json = False,
) -> None:
    """Answer in place of a rig's devices until Ctrl-C, on ports that any program can open."""
    from api.verbs.simulating import simulate as run

    with run(rig, rig_out=rig_out, faults=faults, seed=seed, control_port=control_port) as (found, wait):
        console.write_result(found, json)
        sys.stdout.flush()  # whoever started it reads the addresses from a pipe
        wait()


@rig_app.command()
def check(
    rig: Annotated[Path, typer.Argument(metavar="RIG", help="Description of the stage.")],
    move: Annotated[bool, typer.Option("--move", help="Let every joint move by 5 degrees or 20 mm and back.")] = False,
    json: Json = False,
) -> None:
    """Open every device, blink the light, take a dark and a lit frame, and report."""
    from api.verbs.checking import check_rig as run

    with console.progress("rig check"):
        findings = run(rig, move=move)
    if json:
        console.write_json([finding.to_json() for finding in findings])
    else:
        console.write_facts({f"{one.role}: {one.device}": one.said() for one in findings})
    if any(finding.trouble for finding in findings):
        raise typer.Exit(1)


@app.command()
def fit(
    dataset: Dataset,
    model: Annotated[str, typer.Option(metavar="NAME", help="Which model.")],
    out: Annotated[Path, typer.Option(metavar="MODEL", help="New model folder.")],
    lights: Annotated[str | None, typer.Option(metavar="0,5,7", help="Fit to these images only.")] = None,
    exclude: Annotated[str | None, typer.Option(metavar="1,6,11", help="Fit to all but these images.")] = None,
    json: Json = False,
) -> None:
    """Learn how the object answers light."""
    from api.verbs.fitting import fit as run

    with console.progress(f"fit {model}") as progress:
        result = run(dataset, model, out, lights=lights, exclude=exclude, progress=progress)
    console.write_result(result, json)


@app.command()
def relight(
    model: Annotated[Path, typer.Argument(metavar="MODEL", help="Folder written by 'fit'.")],
    lights: Annotated[
        Path, typer.Option(metavar="lights.json", help="Lights to render; an inner list is lit together.")
    ],
    out: Annotated[Path, typer.Option(metavar="DIR", help="New folder: one linear EXR per light.")],
    json: Json = False,
) -> None:
    """Render a model under light that was never there."""
    from api.verbs.relighting import relight as run

    with console.progress("relight") as progress:
        result = run(model, lights, out, progress=progress)
    if json:
        console.write_json(result)
        return
    rows = [[picture["image"], f"{100 * picture['outside_share']:.1f} %"] for picture in result["images"]]
    console.write_table(f"{result['out']} ({result['model']})", ["image", "outside"], rows)


@app.command()
def evaluate(
    dataset: Dataset,
    model: Annotated[list[str], typer.Option(metavar="NAME", help="Which model; may be given several times.")],
    test: Annotated[
        Path | None, typer.Option(metavar="DATASET", help="Judge on this set; the models are fitted to all of DATASET.")
    ] = None,
    holdout: Annotated[
        str | None,
        typer.Option(metavar="every:5|folds:5|random:F:SEED|i,j,...", help="Images to hold out; every:5 by default."),
    ] = None,
    report: Annotated[Path | None, typer.Option(metavar="FILE", help="HTML page with pictures to write.")] = None,
    json: Json = False,
) -> None:
    """Chart models on lights they were not fitted to."""
    from api.verbs.evaluating import evaluate as run

    with console.progress("evaluate") as progress:
        evaluation = run(dataset, model, test=test, holdout=holdout, report=report, progress=progress)
    rows = [row.to_json() for row in evaluation.rows]
    if json:
        console.write_json(rows)
        return
    _write_rows(rows)
    if report is not None:
        console.write_facts({"report": report})


@app.command()
def bench(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for JSON, pictures and a page.")] = Path("bench-out"),
    json: Json = False,
) -> None:
    """Measure speed against accuracy, and stability."""
    from api.verbs.benchmarking import bench as run

    with console.progress("bench") as progress:
        result = run(out, progress=progress)
    console.write_result(result, json)


def _write_rows(rows: list[dict[str, Any]]) -> None:
    figures = {
        "mae": "MAE",
        "psnr": "PSNR",
        "ssim": "SSIM",
        "mae_object": "MAE obj",
        "psnr_object": "PSNR obj",
        "fit_s": "fit s",
        "render_ms_per_megapixel": "ms/MP",
        "peak_mib": "MiB",
    }
    shown = {key: label for key, label in figures.items() if any(row.get(key) is not None for row in rows)}
    table = [
        [
            row["model"],
            str(row["train"]),
            str(row["test"]),
            *("-" if row.get(key) is None else f"{row[key]:.4g}" for key in shown),
        ]
        for row in rows
    ]
    console.write_table(
        "held-out lights (8-bit grey levels, dB, seconds, milliseconds per megapixel)",
        ["model", "train", "test", *shown.values()],
        table,
    )


def main() -> None:
    """Entry of the console script."""
    if not console.debugging():
        # What a library warns of is for its callers; a person reads one sentence, and machines read stderr by the line.
        warnings.simplefilter("ignore")
    app(prog_name="lightstage")


if __name__ == "__main__":
    main()
