"""Drawing without a browser: words, colour bars and a plain view of the stage, by OpenCV on RGB arrays."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from api.report.content import ByteImage, StageView
from api.report.imaging import colour_table

RGB = tuple[int, int, int]
INK: RGB = (28, 31, 36)
MUTED: RGB = (96, 103, 112)
PAPER: RGB = (255, 255, 255)
CANDIDATE: RGB = (158, 163, 170)
CHOSEN: RGB = (213, 94, 0)
CAMERA: RGB = (0, 114, 178)

# The stage is drawn this many times larger and averaged down, so that small discs are round and evenly spaced.
_FINE = 3
_VIEW_AZIMUTH, _VIEW_ELEVATION = math.radians(-58), math.radians(24)


def blank(width: int, height: int) -> ByteImage:
    """White paper."""
    return np.full((height, width, 3), PAPER, dtype=np.uint8)


def write(canvas: ByteImage, words: str, x: int, y: int, size: int, colour: RGB = INK, weight: int = 400) -> int:
    """Write `words`, `size` pixels high, with their baseline's left end at (x, y); returns where they end."""
    # OpenCV's font has no narrow no-break space.
    plain = words.replace("\u202f", " ")
    (end, _), _ = cv2.putText(canvas, plain, (x, y), colour, cv2.FontFace("sans"), size, weight)
    return int(end)


def text_width(words: str, size: int, weight: int = 400) -> int:
    """Width in pixels of `words`."""
    _, _, width, _ = cv2.getTextSize((0, 0), words, (0, 0), cv2.FontFace("sans"), size, weight)
    return int(width)


def fitted(words: str, size: int, width: int, weight: int = 400) -> str:
    """`words`, cut with an ellipsis where they are wider than `width` pixels."""
    if text_width(words, size, weight) <= width:
        return words
    while words and text_width(words + "…", size, weight) > width:
        words = words[:-1]
    return words.rstrip() + "…"


def paste(canvas: ByteImage, picture: ByteImage, x: int, y: int) -> None:
    """Put `picture` onto `canvas` with its upper left corner at (x, y)."""
    canvas[y : y + picture.shape[0], x : x + picture.shape[1]] = picture


def colour_bar(width: int, height: int, colormap: int) -> ByteImage:
    """Horizontal colour scale, low values on the left."""
    row = colour_table(colormap)[np.linspace(0, 255, width).round().astype(int)]
    return np.ascontiguousarray(np.broadcast_to(row, (height, width, 3)))


def draw_stage(view: StageView, width: int, height: int) -> ByteImage:
    """Parallel view of the stage from the side and above: candidates grey, chosen lights numbered, camera, surface."""
    canvas = blank(width * _FINE, height * _FINE)
    reach = float(np.median(np.linalg.norm(view.lights, axis=1))) or 1.0
    ring = np.linspace(0, 2 * np.pi, 145)
    horizon = reach * np.stack([np.cos(ring), np.sin(ring), np.zeros_like(ring)], axis=-1)
    drawn = [view.lights, horizon]
    camera = None
    if view.camera is not None:
        centre = view.camera.centre
        # A camera far off would shrink the lights to a dot; its direction is what this picture can tell.
        camera = centre * min(1.0, 1.3 * reach / (float(np.linalg.norm(centre)) or 1.0))
        drawn.append(camera[None])
    places = _project(np.concatenate(drawn))[:, :2]
    low, high = places.min(axis=0), places.max(axis=0)
    size = np.array([width, height]) * _FINE
    scale = float(min((size - 36 * _FINE) / np.maximum(high - low, 1e-9)))

    def at(points: ArrayLike) -> NDArray[np.int32]:
        uv = (_project(points)[..., :2] - (low + high) / 2) * scale * [1, -1] + size / 2
        return np.asarray(uv.round(), dtype=np.int32)

    cv2.polylines(canvas, [at(horizon)], True, (205, 209, 214), _FINE, cv2.LINE_AA)
    surface, surface_rgb = view.surface_sample()
    order = np.argsort(_project(surface)[:, 2])
    colours = np.full((len(order), 3), MUTED, dtype=np.uint8) if surface_rgb is None else surface_rgb[order]
    for place, colour in zip(at(surface)[order].tolist(), colours.tolist(), strict=True):
        cv2.circle(canvas, place, round(1.5 * _FINE), colour, -1)
    rank = {light: k + 1 for k, light in enumerate(view.chosen)}
    for index in np.argsort(_project(view.lights)[:, 2]).tolist():
        u, v = at(view.lights[index]).tolist()
        if index not in rank:
            cv2.circle(canvas, (u, v), 3 * _FINE, CANDIDATE, -1)
            continue
        cv2.circle(canvas, (u, v), 9 * _FINE, CHOSEN, -1)
        label = str(rank[index])
        letters = (12, 11, 8)[min(len(label), 3) - 1] * _FINE
        write(canvas, label, u - text_width(label, letters, 600) // 2, round(v + 0.36 * letters), letters, PAPER, 600)
    if camera is not None:
        u, v = at(camera).tolist()
        cv2.rectangle(canvas, (u - 7 * _FINE, v - 5 * _FINE), (u + 7 * _FINE, v + 5 * _FINE), CAMERA, -1)
        cv2.circle(canvas, (u, v), 3 * _FINE, PAPER, -1)
    return np.asarray(cv2.resize(canvas, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _project(points: ArrayLike) -> NDArray[np.float64]:
    """World points (..., 3) to right, up and towards the viewer."""
    ca, sa, ce, se = (f(a) for a in (_VIEW_AZIMUTH, _VIEW_ELEVATION) for f in (math.cos, math.sin))
    axes = np.array([[-sa, ca, 0.0], [-se * ca, -se * sa, ce], [ce * ca, ce * sa, se]])
    return np.asarray(np.asarray(points, dtype=float) @ axes.T)
