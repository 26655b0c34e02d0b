"""Commands ``lightstage calibrate ...``: each kind of calibration, its options, and nothing else."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from api import console

calibrate = typer.Typer(
    name="calibrate", help="Measure what a stage's camera and lamp are like; writes calibration files."
)

Json = Annotated[bool, typer.Option("--json", help="One JSON value on stdout, progress on stderr.")]
Out = Annotated[Path, typer.Option(metavar="FILE", help="Calibration file to write.")]
Name = Annotated[str | None, typer.Option(metavar="NAME", help="For people; the file's name where none is given.")]
RawFiles = Annotated[list[Path], typer.Argument(metavar="RAW...", help="RAW files, or folders of them.")]
PlaneOption = Annotated[
    str | None, typer.Option(metavar="x,y,z,nx,ny,nz", help="The target's plane: a point on it and its normal, metres.")
]


@calibrate.command()
def response(
    bracket: Annotated[
        Path, typer.Argument(metavar="LIST", help="Text file: a picture and its exposure time in seconds per line.")
    ],
    out: Out,
    mask: Annotated[Path | None, typer.Option(metavar="FILE", help="Picture that is not 0 where to look.")] = None,
    clipped_at: Annotated[
        int, typer.Option(min=128, max=255, help="Stored value from which a sample counts as clipped.")
    ] = 250,
    name: Name = None,
    json: Json = False,
) -> None:
    """Recover the response curve of a camera that gives 8-bit pictures, from a bracket of one scene."""
    from api.verbs.calibrating_photometry import calibrate_response as run

    with console.progress("calibrate response"):
        result = run(bracket, out, mask=mask, name=name, clipped_at=clipped_at)
    console.write_result(result, json)


@calibrate.command()
def dark(frames: RawFiles, out: Out, name: Name = None, json: Json = False) -> None:
    """Measure offset, dark current, hot pixels and read noise from frames without light."""
    from api.verbs.calibrating_photometry import calibrate_dark as run

    with console.progress("calibrate dark") as progress:
        result = run(frames, out, name=name, progress=progress)
    console.write_result(result, json)


@calibrate.command()
def flat(
    frames: RawFiles,
    out: Out,
    dark: Annotated[Path | None, typer.Option(metavar="FILE", help="Dark calibration of the same camera.")] = None,
    rig: Annotated[
        Path | None, typer.Option(metavar="RIG", help="The stage, where a white target was lit by its lamp.")
    ] = None,
    light: Annotated[str | None, typer.Option(metavar="x,y,z", help="Where the lamp was, metres.")] = None,
    plane: PlaneOption = None,
    name: Name = None,
    json: Json = False,
) -> None:
    """Measure the relative response of the pixels, and electrons per number, from pictures of an even surface."""
    from api.verbs.calibrating_photometry import calibrate_flat as run

    with console.progress("calibrate flat") as progress:
        result = run(frames, out, dark=dark, rig=rig, light=light, plane=plane, name=name, progress=progress)
    console.write_result(result, json)


@calibrate.command()
def white(
    dataset: Annotated[Path, typer.Argument(metavar="DATASET", help="Photographs of a white target.")],
    out: Out,
    albedo: Annotated[str, typer.Option(metavar="A|R,G,B", help="Albedo of the target, above 0 and up to 1.")],
    plane: PlaneOption = None,
    lights: Annotated[str | None, typer.Option(metavar="0,5,7", help="Use these images only.")] = None,
    exclude: Annotated[str | None, typer.Option(metavar="1,6,11", help="Use all but these images.")] = None,
    name: Name = None,
    json: Json = False,
) -> None:
    """Measure the lights' intensities, their falloff and emission."""
    from api.verbs.calibrating_photometry import calibrate_white as run

    with console.progress("calibrate white") as progress:
        result = run(
            dataset, out, albedo=albedo, plane=plane, lights=lights, exclude=exclude, name=name, progress=progress
        )
    console.write_result(result, json)


Transfer = Annotated[
    str, typer.Option(metavar="auto|linear|srgb|gamma:2.2", help="How stored values relate to radiance, in a folder.")
]
Pattern = Annotated[str, typer.Option(metavar="PATTERN", help="Which pictures of a folder, such as 'IMG_*.png'.")]
Source = Annotated[Path, typer.Argument(metavar="FOLDER|DATASET", help="Pictures in the order of their names.")]


@calibrate.command()
def chrome(
    source: Source,
    out: Out,
    sphere: Annotated[
        list[str] | None, typer.Option(metavar="U,V,RADIUS", help="Circle of a sphere in pixels; once for each.")
    ] = None,
    sphere_at: Annotated[
        list[str] | None, typer.Option(metavar="X,Y,Z", help="Place of a sphere on a jig in metres; once for each.")
    ] = None,
    mask: Annotated[Path | None, typer.Option(metavar="FILE", help="Picture that is not 0 where spheres are.")] = None,
    count: Annotated[int | None, typer.Option(min=1, metavar="N", help="How many spheres to look for.")] = None,
    refine: Annotated[bool, typer.Option("--refine", help="Move circles onto the rims in the pictures.")] = False,
    camera: Annotated[Path | None, typer.Option(metavar="FILE", help="Camera calibration; positions need one.")] = None,
    radius_mm: Annotated[float | None, typer.Option(metavar="R", help="Radius of the spheres.")] = None,
    jig_mm: Annotated[
        float, typer.Option(min=0.0, metavar="S", help="Standard deviation of the places on the jig.")
    ] = 0.1,
    reference: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Picture of the scene without the lamp.")
    ] = None,
    pictures: Pattern = "*",
    transfer: Transfer = "auto",
    name: Name = None,
    json: Json = False,
) -> None:
    """Find where each light is from pictures of mirror spheres."""
    from api.verbs.calibrating_geometry import calibrate_chrome as run

    with console.progress("calibrate chrome") as progress:
        result = run(
            source,
            out,
            spheres=sphere or (),
            spheres_at=sphere_at or (),
            mask=mask,
            count=count,
            refine=refine,
            camera=camera,
            radius_mm=radius_mm,
            jig_mm=jig_mm,
            reference=reference,
            pictures=pictures,
            transfer=transfer,
            name=name,
            progress=progress,
        )
    console.write_result(result, json)


@calibrate.command()
def camera(
    source: Source,
    out: Out,
    board: Annotated[
        str, typer.Option(metavar="COLUMNSxROWS,SQUAREmm,MARKERmm,DICTIONARY", help="Such as 7x5,30mm,22mm,4X4_50.")
    ],
    origin: Annotated[
        str | None, typer.Option(metavar="PICTURE", help="Picture with the board at the stage's origin.")
    ] = None,
    height_mm: Annotated[float, typer.Option(metavar="H", help="Height of the board's face above the origin.")] = 0.0,
    no_distortion: Annotated[
        bool, typer.Option("--no-distortion", help="Take the lens as free of distortion.")
    ] = False,
    pictures: Pattern = "*",
    transfer: Transfer = "auto",
    name: Name = None,
    json: Json = False,
) -> None:
    """Find focal length, distortion and place of the camera from pictures of a ChArUco board."""
    from api.verbs.calibrating_geometry import calibrate_camera as run

    with console.progress("calibrate camera") as progress:
        result = run(
            source,
            out,
            board=board,
            origin=origin,
            height_mm=height_mm,
            distortion=not no_distortion,
            pictures=pictures,
            transfer=transfer,
            name=name,
            progress=progress,
        )
    console.write_result(result, json)


@calibrate.command()
def apply(
    calibration: Annotated[Path, typer.Argument(metavar="lights.json", help="Calibration of kind 'lights'.")],
    dataset: Annotated[Path, typer.Argument(metavar="DATASET", help="Taken under the same lights, in their order.")],
    out: Annotated[Path, typer.Argument(metavar="OUT", help="New dataset folder.")],
    json: Json = False,
) -> None:
    """Write a dataset again with its lights where a calibration found them."""
    from api.verbs.calibrating_geometry import apply_lights as run

    with console.progress("calibrate apply"):
        result = run(calibration, dataset, out)
    console.write_result(result, json)
