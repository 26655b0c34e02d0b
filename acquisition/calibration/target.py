"""Radiant intensity of each light, falloff and emission of the lamp, from photographs of a white target."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, NonNegativeFloat, PositiveFloat

from acquisition.calibration.emission import Fitted, Seen, fit, held_out_errors
from acquisition.calibration.files import Calibration, CalibrationPart, InputFile
from acquisition.calibration.plane import Plane, plane_geometry
from acquisition.dataset import IlluminationDataset
from stage.errors import InputError
from stage.lights import Light, Triple
from stage.rig.light import SAME_PLACE_M

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

LEAST_COSINE = 0.1
"""Cosine of incidence below which a target's roughness and tilt count for more than the light."""

MOST_CELLS = 4096
"""Pixels are averaged to at most so many square cells, which keeps noise small and memory flat."""

FEWEST_CELLS = 64
"""Usable cells that a light needs."""

MOST_OUTLYING_SHARE = 0.35
"""Share of a light's cells that may be far off the model before the target is not what it is said to be."""

OUTLYING_SIGMAS = 5.0
CHECKER = 8
"""Squares of the chequerboard, per side of the target, whose two colours predict each other."""

NonNegativeTriple = tuple[NonNegativeFloat, NonNegativeFloat, NonNegativeFloat]


class CalibratedLight(CalibrationPart):
    """One light of an intensity calibration.

    Attributes
    ----------
    position, direction : (3,) float or None
        As in the dataset; exactly one is given.
    nominal : (3,) float
        Intensity that the dataset gives.
    intensity, std : (3,) float
        Intensity found, along the lamp's axis, and its standard deviation from the spread over the target. What is
        wrong with albedo, plane or position is not in it.
    spread_share : float
        Robust standard deviation of the target's relative errors, the channels' mean.
    usable_share : float
        Share of the target that was lit, not clipped and not steep.
    """

    position: Triple | None = None
    direction: Triple | None = None
    nominal: NonNegativeTriple
    intensity: NonNegativeTriple
    std: NonNegativeTriple
    spread_share: NonNegativeFloat
    usable_share: NonNegativeFloat


class IntensityCalibration(Calibration):
    """Radiant intensities.

    Attributes
    ----------
    absolute : bool
        Whether the pictures were in units of radiance; otherwise intensities are relative to each other only.
    albedo : (3,) float
        Of the target.
    lights : tuple of CalibratedLight
        In the dataset's order.
    scale, scale_std : (3,) float
        Intensity found over the nominal one, by channel: the median over the lights, and its standard deviation from
        the spread among them (their own standard deviation where there is one light).
    emitters : tuple of (3,) float
        Intensities at full level of the lamp's emitters: the nominal ones, as the dataset's rig gives them, times
        `scale`; of a dome, each times the scale of the light that stands where the emitter does. Empty where the
        dataset does not name its rig.
    emission : str
        ``isotropic``; or ``lobe``, intensity falling as a power of the cosine to the lamp's axis, which points from
        the lamp to the stage's centre. Isotropic unless held-out parts of the target are predicted better by a lobe.
    lobe_exponent, lobe_exponent_std : float or None
        That power as fitted, also where it was found not to be needed; None for distant lights.
    falloff_exponent, falloff_exponent_std : float or None
        Power of the distance that the light falls off with, fitted together with the chosen emission; 2 is expected.
        Where the target does not tell it from the emission, its standard deviation is large. None for distant lights.
    """

    kind: Literal["intensity"] = "intensity"
    absolute: bool
    albedo: tuple[PositiveFloat, PositiveFloat, PositiveFloat]
    lights: tuple[CalibratedLight, ...] = Field(min_length=1)
    scale: NonNegativeTriple
    scale_std: NonNegativeTriple
    emitters: tuple[NonNegativeTriple, ...] = ()
    emission: Literal["isotropic", "lobe"]
    lobe_exponent: float | None = None
    lobe_exponent_std: NonNegativeFloat | None = None
    falloff_exponent: float | None = None
    falloff_exponent_std: NonNegativeFloat | None = None


def measure_intensity(
    dataset: IlluminationDataset,
    *,
    albedo: float | Sequence[float],
    plane: Plane | None = None,
    frames: Sequence[int] | None = None,
    name: str = "lamp",
    inputs: Sequence[InputFile] = (),
    progress: Callable[[float], None] = lambda share: None,
) -> IntensityCalibration:
    """Find intensities from photographs of a white Lambertian target.

    A point of albedo rho under a lamp of intensity I has the radiance ``rho / pi * I * cos / r**2``. Pixels are
    averaged to cells, value and expected value alike; intensities are fitted robustly
    (`acquisition.calibration.emission`), so that dirt and glare on a smaller part of the target do not count.

    Parameters
    ----------
    dataset : IlluminationDataset
        Photographs of the target; its mask tells where it is.
    albedo : float or (3,) float
        Of the target, > 0 and at most 1.
    plane : Plane, optional
        Where the target is; the dataset's depth and normals where none is given.
    frames : sequence of int, optional
        Indices of the photographs to use; all of them where none are given.
    name, inputs
        As in `Calibration`.
    progress : callable
        Called with the finished share, 0 to 1.

    Returns
    -------
    IntensityCalibration
        Residuals: ``target_spread_share``, the median light's spread over the target; ``between_lights_share``, robust
        standard deviation of intensity over nominal among the lights; ``isotropic_held_out_loss_share`` and
        ``lobe_held_out_loss_share``, mean robust loss on the held-out half, 1 for a sample beyond all reason (absent
        where a light shows too little of the target in one half).

    Raises
    ------
    InputError
        Where nothing tells where the target is, or a light sees too little of it: too small, clipped, shadowed,
        steep, or for the most part not as a white plane looks.
    """
    rho = _checked_albedo(albedo)
    points, normals = _geometry(dataset, plane)
    chosen = range(len(dataset)) if frames is None else frames
    lights = [dataset.lights[i] for i in chosen]
    if len({light.is_distant for light in lights}) > 1:
        raise InputError(f"{dataset.source}: frames: near and distant lights are mixed; calibrate them apart")
    nominal = np.array([light.intensity for light in lights])
    lit = nominal.max(0) > 0
    if not lit.any() or (nominal[:, lit] <= 0).any():
        raise InputError(
            f"{dataset.source}: frames: the lights' intensities are zero in different channels; "
            "calibrate lights of one colour at a time"
        )
    seen, usable_share, blocks = _cells(dataset, chosen, points, normals, rho, progress)
    seen = Seen(seen.values[..., lit], seen.usable[..., lit], seen.unit[..., lit], seen.log_distance, seen.log_cosine)
    _require_light(dataset, chosen, seen)
    plain = fit(seen)
    _require_white(dataset, chosen, seen, plain)
    fitted, residuals, shape = plain, dict[str, float](), dict[str, Any]()
    if not lights[0].is_distant:
        fitted, residuals, shape = _shaped(seen, plain, blocks)
    intensity, std = (_all_channels(part, lit) for part in (fitted.intensity, fitted.intensity_std))
    ratio = np.divide(intensity, nominal, out=np.ones_like(nominal), where=nominal > 0)
    scale, among = np.median(ratio, axis=0), 1.4826 * np.median(np.abs(ratio - np.median(ratio, axis=0)), axis=0)
    own = np.divide(std, nominal, out=np.zeros_like(nominal), where=nominal > 0)
    # A median of n normal values has 1.2533 / sqrt(n) times their standard deviation.
    scale_std = own[0] if len(lights) == 1 else 1.2533 * among / np.sqrt(len(lights))
    return IntensityCalibration(
        name=name,
        inputs=tuple(inputs),
        residuals={
            "target_spread_share": float(np.median(fitted.spread)),
            "between_lights_share": float((among / scale)[lit].mean()),
            **residuals,
        },
        absolute=_is_absolute(dataset),
        albedo=rho,
        lights=tuple(
            CalibratedLight(
                position=light.position,
                direction=light.direction,
                nominal=light.intensity,
                intensity=_triple(intensity[i]),
                std=_triple(std[i]),
                spread_share=float(fitted.spread[i].mean()),
                usable_share=float(usable_share[i]),
            )
            for i, light in enumerate(lights)
        ),
        scale=_triple(scale),
        scale_std=_triple(scale_std),
        emitters=_emitters(dataset, lights, ratio, scale),
        emission=shape.pop("emission", "isotropic"),
        **shape,
    )


def _shaped(seen: Seen, plain: Fitted, blocks: NDArray[np.intp]) -> tuple[Fitted, dict[str, float], dict[str, Any]]:
    """The fit with the emission that held-out parts of the target ask for, its residuals, and what shape it found."""
    lobed = fit(seen, ["lobe"])
    needed, residuals = False, dict[str, float]()
    if all(seen.usable[:, blocks % 2 == colour].sum(1).min() >= FEWEST_CELLS // 4 for colour in (0, 1)):
        plainly, by_lobe = (held_out_errors(seen, terms, blocks) for terms in ([], ["lobe"]))
        gain = plainly - by_lobe
        # Taken only where the gain is certain: blocks are alike and apart, so their mean's standard error is known.
        needed = bool(gain.mean() > 2 * gain.std(ddof=1) / np.sqrt(len(gain))) and lobed.shape[0] > 0
        residuals = {
            "isotropic_held_out_loss_share": float(plainly.mean()),
            "lobe_held_out_loss_share": float(by_lobe.mean()),
        }
    both = fit(seen, ["falloff", "lobe"] if needed else ["falloff"])
    found = {
        "emission": "lobe" if needed else "isotropic",
        "lobe_exponent": float(lobed.shape[0]),
        "lobe_exponent_std": float(lobed.shape_std[0]),
        "falloff_exponent": float(2 + both.shape[0]),
        "falloff_exponent_std": float(both.shape_std[0]),
    }
    return (lobed if needed else plain), residuals, found


def _checked_albedo(albedo: float | Sequence[float]) -> Triple:
    values = np.broadcast_to(np.asarray(albedo, dtype=float), 3) if np.size(albedo) in (1, 3) else np.zeros(3)
    if not (np.isfinite(values).all() and (values > 0).all() and (values <= 1).all()):
        raise InputError(f"albedo: expected one or three numbers above 0 and up to 1, got {albedo!r}")
    return _triple(values)


def _geometry(dataset: IlluminationDataset, plane: Plane | None) -> tuple[Array | None, Array]:
    """Points (NaN off the target; None for distant lights without a camera) and unit normals of the pixels."""
    if plane is not None:
        if dataset.camera is None:
            raise InputError(f"{dataset.source}: camera: is null, so where the plane is seen is unknown")
        return plane_geometry(dataset.camera, plane)
    if dataset.normals is None or (dataset.points is None and not dataset.lights[0].is_distant):
        raise InputError(
            f"{dataset.source}: geometry: a white target needs depth and normals, or give the plane that it lies in"
        )
    return dataset.points, np.asarray(dataset.normals, dtype=float)


def _cells(
    dataset: IlluminationDataset,
    chosen: Sequence[int],
    points: Array | None,
    normals: Array,
    rho: Triple,
    progress: Callable[[float], None],
) -> tuple[Seen, Array, NDArray[np.intp]]:
    """What the cells of the target show, the share of the target that each light shows, and each cell's block."""
    target = dataset.mask & (np.abs(normals).max(-1) > 0)
    if points is not None:
        target = target & np.isfinite(points).all(-1)
    rows, columns = np.nonzero(target)
    if not rows.size:
        raise InputError(f"{dataset.source}: the target is in no pixel of the picture")
    side = max(1, int(np.ceil(np.sqrt(rows.size / MOST_CELLS))))
    of_cell = (rows - rows.min()) // side, (columns - columns.min()) // side
    _, cell, size = np.unique(of_cell[0] * dataset.width + of_cell[1], return_inverse=True, return_counts=True)
    count = len(size)
    x, n = None if points is None else points[target], normals[target]
    shape = (len(chosen), count, 3)
    values, unit, share = np.zeros(shape), np.zeros(shape), np.zeros(shape[:2])
    distance, cosine = np.zeros(shape[:2]), np.ones(shape[:2])

    def mean(per_pixel: Array, weight: Array) -> Array:
        return np.bincount(cell, per_pixel * weight, count) / np.maximum(np.bincount(cell, weight, count), 1)

    for i, frame in enumerate(chosen):
        light, valid = dataset.lights[frame], dataset.valid(frame)[target]
        to_light, attenuation = light.incident(x, (len(n),))
        incidence = np.einsum("pi,pi->p", to_light, n)
        use = (valid & (incidence > LEAST_COSINE)).astype(float)
        share[i] = mean(use, np.ones(len(use)))
        picture = dataset.image(frame)[target]
        for c in range(3):
            values[i, :, c] = mean(picture[:, c].astype(float), use)
            unit[i, :, c] = rho[c] / np.pi * mean(incidence * attenuation, use)
        if not light.is_distant:
            place = np.asarray(light.position)
            radius = float(np.linalg.norm(place))
            distance[i] = -0.5 * np.log(np.maximum(mean(attenuation, use), 1e-12) * radius**2)
            cosine[i] = np.clip(mean(to_light @ place / max(radius, 1e-12), use), 1e-6, 1)
        _require_seen(f"{dataset.source}: frames[{frame}]", share[i], valid, incidence)
        progress(0.7 * (i + 1) / len(chosen))
    usable = np.broadcast_to((share >= 0.5)[..., None], shape) & (unit > 0)
    usable_share = share @ size / size.sum()
    high, wide = (np.bincount(cell, part) / size for part in of_cell)
    square = max(high.max(), wide.max()) / CHECKER + 1e-9
    down, across = (high // square).astype(np.intp), (wide // square).astype(np.intp)
    # Numbered so that neighbours along rows and columns differ in parity.
    blocks = 2 * (down * CHECKER + across) + (down + across) % 2
    return Seen(values, usable, unit, distance, np.log(cosine)), usable_share, blocks


def _require_seen(field: str, share: Array, valid: Mask, incidence: Array) -> None:
    """Refuse a light that shows too little of the target, and say why."""
    if (cells := int((share >= 0.5).sum())) >= FEWEST_CELLS:
        return
    raise InputError(
        f"{field}: shows {cells} usable cells of the target, expected {FEWEST_CELLS} or more "
        f"({len(valid)} pixels, {100 * float((~valid).mean()):.0f} % clipped, "
        f"{100 * float((incidence <= LEAST_COSINE).mean()):.0f} % turned away from the light)"
    )


def _require_light(dataset: IlluminationDataset, chosen: Sequence[int], seen: Seen) -> None:
    """Refuse a light under which most of the target is black."""
    bright = (seen.usable & (seen.values > 0)).sum(1) / seen.usable.sum(1)
    if (bright <= 0.5).any():
        worst = chosen[int(np.argmin(bright.min(1)))]
        raise InputError(f"{dataset.source}: frames[{worst}]: most of the target is black; was the light on?")


def _require_white(dataset: IlluminationDataset, chosen: Sequence[int], seen: Seen, plain: Fitted) -> None:
    """Refuse a light under which the target looks for the most part unlike a white Lambertian plane."""
    predicted = np.where(seen.usable, plain.predict(seen), 1)
    error = np.where(seen.usable, seen.values / predicted - 1, 0)
    # The median light's spread is the measure: one that is shadowed has a wide spread of its own.
    limit = OUTLYING_SIGMAS * np.median(plain.spread, axis=0)
    outlying = ((np.abs(error) > np.maximum(limit, 0.05)).sum(1) / seen.usable.sum(1)).max(-1)
    worst = int(np.argmax(outlying))
    if outlying[worst] > MOST_OUTLYING_SHARE:
        raise InputError(
            f"{dataset.source}: frames[{chosen[worst]}]: {100 * outlying[worst]:.0f} % of the target is far from what "
            "a white plane shows; look for shadow, glare or a wrong plane, or leave the light out"
        )


def _is_absolute(dataset: IlluminationDataset) -> bool:
    capture = dataset.provenance.get("capture")
    return isinstance(capture, dict) and capture.get("radiance_per_dn_s") is not None


def _emitters(dataset: IlluminationDataset, lights: Sequence[Light], ratio: Array, scale: Array) -> tuple[Triple, ...]:
    """Calibrated intensities of the emitters of the dataset's rig, where it names one."""
    capture = dataset.provenance.get("capture")
    rig = capture.get("rig") if isinstance(capture, dict) else None
    try:
        emitters = rig["light"]["emitters"] if isinstance(rig, dict) else []
        nominal = [np.asarray(one["intensity"], dtype=float) for one in emitters]
        places = [one.get("position_m") for one in emitters]
    except (KeyError, TypeError, ValueError, AttributeError):
        raise InputError(f"{dataset.source}: provenance.capture.rig: is not the description of a rig") from None
    lamps = np.array([light.position or (np.inf,) * 3 for light in lights])
    found = []
    for intensity, place in zip(nominal, places, strict=True):
        own = scale
        if place is not None:
            away = np.linalg.norm(lamps - np.asarray(place, dtype=float), axis=1)
            own = ratio[int(np.argmin(away))] if away.min() <= SAME_PLACE_M else scale
        found.append(_triple(intensity * own))
    return tuple(found)


def _all_channels(values: Array, lit: Mask) -> Array:
    out = np.zeros((len(values), 3))
    out[:, lit] = values
    return out


def _triple(values: ArrayLike) -> Triple:
    r, g, b = (float(v) for v in np.asarray(values))
    return r, g, b
