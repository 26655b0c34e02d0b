"""Parameter maps and what of them was measured directly (paper 003 Fig. 10, M22)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from api.report import imaging
from api.report.content import BoolArray, ByteImage, FloatArray, MapView, ReportContent
from api.report.markup import figure, image, number, percent, scale_bar, section, swatches, tile, tiles

# What a map means, its unit where a person reads it, and the factor to that unit; a map of standard deviations has the
# unit of its parent.
_LABELS = {
    "diffuse": ("diffuse albedo", "", 1.0),
    "specular": ("specular albedo, Ward's ρs", "", 1.0),
    "roughness": ("roughness, Ward's α", "", 1.0),
    "normals": ("surface normals, world frame", "", 1.0),
    "rung": ("rung of the model ladder", "", 1.0),
    "residual": ("residual of the fit, RMS", "radiance", 1.0),
    "nearest_half_angle": ("smallest half angle seen", "°", 180 / math.pi),
}
_ALBEDOS = ("diffuse", "specular")


@dataclass(frozen=True, eq=False)
class MapPicture:
    """One map as a picture with what is needed to read it.

    Attributes
    ----------
    label : str
        What the map holds.
    rgb : (height, width, 3) uint8
        The picture, to be shown on the object only.
    notes : tuple of str
        Figures of the map.
    scale : (float, float, str) or None
        Values at both ends of the colour scale and their unit.
    legend : tuple of (RGB, str)
        Names of colours, for maps of kinds.
    """

    label: str
    rgb: ByteImage
    notes: tuple[str, ...] = ()
    scale: tuple[float, float, str] | None = None
    legend: tuple[tuple[tuple[int, int, int], str], ...] = ()


def maps_section(content: ReportContent) -> str:
    """All maps as tiles with their colour scales."""
    view = content.maps
    if view is None or not view.maps:
        return ""
    mask = object_mask(view)
    parts = []
    for picture in map_pictures(view):
        shown = image(imaging.embed(picture.rgb, where=mask), f"Map: {picture.label}.")
        bar = scale_bar(*picture.scale, imaging.VALUES) if picture.scale else ""
        legend = swatches(picture.legend) if picture.legend else ""
        parts.append(tile(picture.label, shown + bar + legend, picture.notes))
    height, width = mask.shape
    caption = (
        "Parameter maps"
        + (f" of the model {view.model}" if view.model else "")
        + f", {width} × {height} pixels, {number(int(mask.sum()))} of them on the object. Colour scales end at the "
        "99th percentile; a range is that of the middle 90 % of the object's pixels."
    )
    missing = sum(int((~_finite(values) & mask).sum()) for values in _values(view).values())
    if missing:
        caption += f" Grey: not finite, {number(missing)} values."
    return section("maps", "Parameter maps", (figure(tiles(parts), caption),))


def object_mask(view: MapView) -> BoolArray:
    """The view's mask, or every pixel where any map is not 0."""
    if view.mask is not None:
        return view.mask
    any_value = [(values.reshape(*values.shape[:2], -1) != 0).any(axis=-1) for values in view.maps.values()]
    return np.asarray(np.any(any_value, axis=0))


def map_pictures(view: MapView) -> list[MapPicture]:
    """Every map of the view in order, then the one of what was measured directly."""
    mask = object_mask(view)
    pictures = [_picture(name, values, mask) for name, values in _values(view).items()]
    estimated = view.estimated
    if estimated is None and "estimated" in view.maps:
        estimated = np.asarray(_plain(view.maps["estimated"]) > 0)
    return [*pictures, _estimated_picture(estimated, mask)] if estimated is not None else pictures


def _values(view: MapView) -> dict[str, NDArray[np.float64]]:
    return {name: _plain(values) for name, values in view.maps.items() if name != "estimated"}


def _plain(values: FloatArray) -> NDArray[np.float64]:
    """Float array (height, width) or (height, width, 3): a single channel loses its axis."""
    array = np.asarray(values, dtype=float)
    return array[..., 0] if array.ndim == 3 and array.shape[2] == 1 else array


def _finite(values: NDArray[np.float64]) -> BoolArray:
    return np.asarray(np.isfinite(values).reshape(*values.shape[:2], -1).all(axis=-1))


def _picture(name: str, values: NDArray[np.float64], mask: BoolArray) -> MapPicture:
    label, unit, factor = _label(name)
    finite = _finite(values)
    inside = values[mask & finite]
    grey = np.broadcast_to(np.array(imaging.MISSING, dtype=np.uint8), (*mask.shape, 3))
    if not len(inside):
        return MapPicture(label, grey, ("no value is finite",))
    if values.ndim == 2:
        return _scalar_picture(label, unit, factor * values, factor * inside)
    if name == "normals":
        colour = np.clip(np.round(255 * (np.where(finite[..., None], values, 0) + 1) / 2), 0, 255).astype(np.uint8)
        notes: tuple[str, ...] = ("red, green, blue = x, y, z from −1 to 1",)
    else:
        # An albedo that reaches far enough towards 1 is shown as what it is: white where nothing is absorbed.
        brightest = 1 / imaging.common_exposure([inside])
        white = 1.0 if name in _ALBEDOS and 0.25 < brightest <= 1 else brightest
        colour = imaging.display(values, 1 / white)
        medians = ", ".join(number(float(m), 3) for m in np.median(inside, axis=0))
        notes = (f"median of red, green, blue: {medians}", f"display white is {number(white, 3)}, sRGB curve")
    return MapPicture(label, np.where(finite[..., None], colour, grey), notes)


def _scalar_picture(label: str, unit: str, values: NDArray[np.float64], inside: NDArray[np.float64]) -> MapPicture:
    lowest, first, low, middle, high, top = np.percentile(inside, [0, 1, 5, 50, 95, 99]).tolist()
    bottom = 0.0 if lowest >= 0 else first
    top = top if top > bottom else bottom + 1.0
    note = f"median {number(middle, 3)}, range {number(low, 3)} to {number(high, 3)}"
    return MapPicture(label, imaging.colour_scale(values, bottom, top), (note,), (bottom, top, unit))


def _estimated_picture(estimated: BoolArray, mask: BoolArray) -> MapPicture:
    share = float(np.mean(estimated[mask])) if mask.any() else 0.0
    legend = (
        (imaging.MEASURED, f"measured directly, {percent(share)}"),
        (imaging.FILLED_IN, f"filled in, {percent(1 - share)}"),
    )
    colour = np.where(estimated[..., None], imaging.MEASURED, imaging.FILLED_IN).astype(np.uint8)
    return MapPicture("what was measured directly", colour, legend=legend)


def _label(name: str) -> tuple[str, str, float]:
    if name.startswith("std_"):
        label, unit, factor = _label(name.removeprefix("std_"))
        return f"standard deviation of {label}", unit, factor
    return _LABELS.get(name, (name.replace("_", " "), "", 1.0))
