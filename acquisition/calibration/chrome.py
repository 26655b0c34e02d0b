"""From pictures of mirror spheres to the calibration of the lights that they were taken under."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from acquisition.calibration.files import InputFile
from acquisition.calibration.highlights import Highlight, find_highlight
from acquisition.calibration.lights import FoundLight, LightsCalibration, Pair, SeenSphere, light_residuals
from acquisition.calibration.outlines import Outline
from acquisition.calibration.pictures import Pictures
from acquisition.calibration.spheres import MirrorSphere, orthographic_direction
from acquisition.calibration.triangulation import Triangulation, triangulate
from acquisition.dataset.manifest import CameraEntry
from stage.camera import Camera
from stage.errors import InputError

Array = NDArray[np.float64]
Progress = Callable[[float], None]

LEAST_FOR_AMBIENT = 4
"""Pictures from which on their darkest values stand for the scene without the lamp, where no picture of it is given."""

LARGEST_RANGE_SHARE = 0.05
"""Standard deviation of a light's distance, as a share of it, above which only its direction is reported."""


def calibrate_lights(
    pictures: Pictures,
    outlines: Sequence[Outline],
    *,
    name: str,
    camera: Camera | None = None,
    radius_m: float | None = None,
    ambient: ArrayLike | None = None,
    inputs: Sequence[InputFile] = (),
    progress: Progress = lambda share: None,
) -> LightsCalibration:
    """Find the lights of a set of pictures of mirror spheres.

    Parameters
    ----------
    pictures : Pictures
        One per light.
    outlines : sequence of Outline
        Of each sphere.
    camera : Camera, optional
        Calibrated; orthographic projection is assumed without.
    radius_m : float, optional
        Radius of the spheres; positions need it.
    ambient : (height, width, 3) float, optional
        Picture of the scene without the lamp, in the units of the others. Of four pictures or more without one, each
        pixel's darkest value is taken.

    Raises
    ------
    InputError
        Where a picture has another size than the camera or the first one, or no light is found at all.
    """
    found = _highlights(pictures, outlines, camera, ambient, progress)
    pixels = np.array([[_or_nan(h.pixel) for h in row] for row in found])
    placed: Triangulation | None = None
    spheres: tuple[MirrorSphere, ...] = ()
    if camera is not None:
        spheres = tuple(MirrorSphere.from_outline(camera, outline, radius_m or 1.0) for outline in outlines)
        if radius_m is not None and len(outlines) > 1:
            placed = triangulate(camera, spheres, [outline.std_px for outline in outlines], pixels)
            spheres_moved = placed.spheres
        else:
            spheres_moved = spheres
        by_sphere = np.stack(
            [s.reflect(camera, np.nan_to_num(pixels[:, k]))[1] for k, s in enumerate(spheres_moved)], 1
        )
    else:
        by_sphere = np.array(
            [[orthographic_direction(o, p) for o, p in zip(outlines, row, strict=True)] for row in pixels]
        )
    by_sphere = np.where(np.isfinite(pixels).all(-1)[..., None], by_sphere, np.nan)
    if not np.isfinite(by_sphere).any():
        raise InputError(
            f"{pictures.path(0).parent}: no highlight was found in any picture; the first has {found[0][0].fault}"
        )
    left_out = None if placed is None else _leave_one_out(camera, placed, outlines, pixels)
    lights = tuple(
        _light(i, pictures.path(i).name, found[i], by_sphere[i], placed, left_out) for i in range(len(pictures))
    )
    seen = []
    for k, outline in enumerate(outlines):
        u, v = outline.centre.tolist()
        one = SeenSphere(centre_px=(u, v), radius_px=outline.radius, outline_rms_px=outline.rms_px)
        if camera is not None and radius_m is not None:
            now = spheres[k] if placed is None else placed.spheres[k]
            x, y, z = now.centre.tolist()
            shift = camera.project(np.stack([now.centre, spheres[k].centre]))[0]
            one = one.model_copy(
                update={
                    "centre_m": (x, y, z),
                    "radius_m": radius_m,
                    "moved_px": float(np.linalg.norm(shift[0] - shift[1])),
                }
            )
        seen.append(one)
    return LightsCalibration(
        name=name,
        frame="camera" if camera is None else "world",
        camera=None if camera is None else CameraEntry.model_validate(camera.to_json(), strict=False),
        spheres=tuple(seen),
        lights=lights,
        inputs=tuple(inputs),
        residuals=light_residuals(lights, **({} if placed is None else {"highlight_noise_px": placed.noise_px})),
    )


def mean_picture(pictures: Pictures) -> Array:
    """Mean over all pictures and channels, (height, width): what shows the most of the spheres' rims."""
    total = pictures.image(0).mean(-1, dtype=np.float64)
    for i in range(1, len(pictures)):
        total = total + _alike(pictures, i, total.shape).mean(-1)
    return np.asarray(total / len(pictures))


def _highlights(
    pictures: Pictures,
    outlines: Sequence[Outline],
    camera: Camera | None,
    ambient: ArrayLike | None,
    progress: Progress,
) -> list[list[Highlight]]:
    size = pictures.image(0).shape[:2]
    if camera is not None and size != (camera.height, camera.width):
        raise InputError(
            f"{pictures.path(0)}: is {size[1]} x {size[0]} pixels, expected {camera.width} x {camera.height} like the "
            "camera's calibration"
        )
    for outline in outlines:
        if not (0 <= outline.centre[0] < size[1] and 0 <= outline.centre[1] < size[0]):
            raise InputError(f"sphere: its centre {outline.centre.round(1).tolist()} is outside the pictures")
    if ambient is not None:
        without = np.asarray(ambient, dtype=float).mean(-1)
        if without.shape != size:
            got = f"{without.shape[1]} x {without.shape[0]}"
            raise InputError(f"reference: is {got} pixels, expected {size[1]} x {size[0]} like the pictures")
    elif len(pictures) >= LEAST_FOR_AMBIENT:
        without = pictures.image(0).mean(-1, dtype=np.float64)
        for i in range(1, len(pictures)):
            without = np.minimum(without, _alike(pictures, i, size).mean(-1))
    else:
        without = None
    found = []
    for i in range(len(pictures)):
        grey, clipped = _alike(pictures, i, size).mean(-1, dtype=np.float64), ~pictures.valid(i)
        found.append([find_highlight(grey, outline, ambient=without, clipped=clipped) for outline in outlines])
        progress((i + 1) / len(pictures))
    return found


def _alike(pictures: Pictures, i: int, size: tuple[int, ...]) -> NDArray[np.float32]:
    image = pictures.image(i)
    if image.shape[:2] != size:
        got = f"{image.shape[1]} x {image.shape[0]}"
        raise InputError(f"{pictures.path(i)}: is {got} pixels, expected {size[1]} x {size[0]} like the first picture")
    return image


def _light(
    i: int,
    picture: str,
    highlights: Sequence[Highlight],
    by_sphere: Array,
    placed: Triangulation | None,
    left_out: Array | None,
) -> FoundLight:
    faults = [f"sphere {k}: {h.fault}" for k, h in enumerate(highlights) if h.fault]
    good = np.isfinite(by_sphere).all(-1)
    pixels: tuple[Pair | None, ...] = tuple(
        None if h.pixel is None else (float(h.pixel[0]), float(h.pixel[1])) for h in highlights
    )
    light = FoundLight(picture=picture, highlights_px=pixels, note="; ".join(faults))
    if not good.any():
        return light
    update: dict[str, object] = {}
    cosines = np.clip(by_sphere[good] @ by_sphere[good].T, -1, 1)
    if good.sum() > 1:
        update["disagreement_deg"] = float(np.degrees(np.arccos(cosines.min())))
    mean = by_sphere[good].mean(0)
    direction = mean / np.linalg.norm(mean)
    if placed is not None and good.sum() > 1:
        used = placed.used[i]
        if not used.any():
            fault = "the highlights in its spheres are not of one light"
            return light.model_copy(update={"note": "; ".join([*faults, fault])})
        strays = [f"sphere {k}: its highlight does not fit the others" for k in np.flatnonzero(good & ~used)]
        update["highlights_px"] = tuple(p if used[k] else None for k, p in enumerate(pixels))
        update["residual_px"], update["residual_deg"] = float(placed.residual_px[i]), float(placed.residual_deg[i])
        faults += strays
        position = placed.positions[i]
        if placed.range_share[i] <= LARGEST_RANGE_SHARE:
            update["position"] = tuple(position.tolist())
            update.pop("disagreement_deg")  # the spheres see a near light in different directions
            update["position_std_m"] = float(np.linalg.eigvalsh(placed.std_m[i]).max())
            direction = position / np.linalg.norm(position)
            if left_out is not None and np.isfinite(left_out[i]):
                update["leave_one_out_deg"] = float(left_out[i])
        else:
            faults.append(
                f"the spheres are too close together to tell its distance (standard deviation "
                f"{100 * placed.range_share[i]:.0f} % of it, at most {100 * LARGEST_RANGE_SHARE:.0f} %); direction only"
            )
    x, y, z = direction.tolist()
    return light.model_copy(update={**update, "direction": (x, y, z), "note": "; ".join(faults)})


def _leave_one_out(
    camera: Camera | None, placed: Triangulation, outlines: Sequence[Outline], pixels: Array
) -> Array | None:
    """Largest change of each light's direction from the stage's centre, degrees, without one of the spheres in turn."""
    if camera is None or len(outlines) < 3:
        return None
    worst = np.full(len(pixels), np.nan)
    whole = _unit(placed.positions)
    for k in range(len(outlines)):
        rest = [m for m in range(len(outlines)) if m != k]
        believed = np.where(placed.used[..., None], pixels, np.nan)[:, rest]
        spheres = [placed.spheres[m] for m in rest]
        part = triangulate(camera, spheres, [outlines[m].std_px for m in rest], believed)
        cosine = np.clip((_unit(part.positions) * whole).sum(-1), -1, 1)
        worst = np.fmax(worst, np.where(placed.used.sum(1) > 2, np.degrees(np.arccos(cosine)), np.nan))
    return worst


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def _or_nan(pixel: Array | None) -> Array:
    return np.full(2, np.nan) if pixel is None else pixel
