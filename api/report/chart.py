"""A chart of a few lines as a picture, for a page that cannot run scripts. Drawn by OpenCV."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from api.report.canvas import INK, MUTED, RGB, blank, fitted, text_width, write
from api.report.content import ByteImage

WIDTH, HEIGHT = 1280, 480
LEFT, RIGHT, TOP, BOTTOM = 84, 330, 76, 60
# Okabe and Ito's colours.
COLOURS: tuple[RGB, ...] = ((0, 114, 178), (230, 159, 0), (0, 158, 115), (213, 94, 0))
GRID: RGB = (226, 229, 233)
TICKS, FEW_TICKS = 6, 4
"""About so many on each axis; fewer on a narrow chart."""
DASH = 7
"""Pixels of a dash, and between two."""


@dataclass(frozen=True, eq=False)
class Line:
    """Points joined in their order.

    Attributes
    ----------
    name : str
        Beside the chart.
    x, y : (n,) float
        n >= 1.
    colour : RGB or None
        The next one of the palette where none is given.
    dashed : bool
        For bounds and limits.
    """

    name: str
    x: ArrayLike
    y: ArrayLike
    colour: RGB | None = None
    dashed: bool = False


def chart(
    lines: Sequence[Line],
    title: str,
    x_name: str,
    y_name: str,
    *,
    width: int = WIDTH,
    height: int = HEIGHT,
    names: int = RIGHT,
    x_from: float = 0.0,
) -> ByteImage:
    """Draw lines over common axes, y from zero: (height, width, 3) uint8, RGB.

    Parameters
    ----------
    lines : sequence of Line
        At least one.
    title, x_name, y_name : str
        Above the chart, below its x axis and above its y axis.
    width, height, names : int
        Pixels, all in all and for the lines' names on the right.
    x_from : float
        Where the x axis begins, a multiple of its step if it can be; below all x.
    """
    canvas = blank(width, height)
    points = [np.stack([np.asarray(line.x, float), np.asarray(line.y, float)], -1) for line in lines]
    low = np.array([x_from, 0.0])
    top = np.max([one.max(0) for one in points], 0) - low
    about = TICKS if width >= WIDTH else FEW_TICKS
    steps = [round_step(float(one), about) for one in top]
    ends = [step * math.ceil(one / step - 1e-9) for one, step in zip(top, steps, strict=True)]
    right = width - names
    size = np.array([right - LEFT, TOP + BOTTOM - height]) / ends
    origin = np.array([LEFT, height - BOTTOM])
    letters = 22 if width >= WIDTH else 16
    write(canvas, fitted(title, letters, width - LEFT, 700), LEFT, 44, letters, INK, 700)
    write(canvas, y_name, LEFT, TOP - 10, 13, MUTED)
    write(canvas, x_name, right - text_width(x_name, 13), height - 14, 13, MUTED)
    for tick in range(round(ends[0] / steps[0]) + 1):
        at, words = LEFT + round(tick * steps[0] * size[0]), f"{x_from + tick * steps[0]:g}"
        cv2.line(canvas, (at, height - BOTTOM), (at, height - BOTTOM + 5), MUTED, 1)
        write(canvas, words, at - text_width(words, 13) // 2, height - BOTTOM + 22, 13, MUTED)
    for tick in range(round(ends[1] / steps[1]) + 1):
        at, words = height - BOTTOM + round(tick * steps[1] * size[1]), f"{tick * steps[1]:g}"
        cv2.line(canvas, (LEFT, at), (right, at), GRID, 1)
        write(canvas, words, LEFT - 10 - text_width(words, 13), at + 5, 13, MUTED)
    # the first line on top of the others
    for number, (line, places) in reversed(list(enumerate(zip(lines, points, strict=True)))):
        colour, y = line.colour or COLOURS[number % len(COLOURS)], TOP + 20 + 28 * number
        way = np.rint(origin + (places - low) * size).astype(np.int32)
        key = np.array([[right + 24, y], [right + 52, y]], dtype=np.int32)
        for piece, thick in ((way, 2), (key, 3)):
            parts = _dashes(piece) if line.dashed else [piece]
            cv2.polylines(canvas, parts, False, colour, thick, cv2.LINE_AA if thick == 2 else cv2.LINE_8)
        write(canvas, fitted(line.name, 14, names - 70), right + 62, y + 5, 14, INK)
    return canvas


def _dashes(way: NDArray[np.int32]) -> list[NDArray[np.int32]]:
    """Every other piece of a way."""
    corners = way.astype(float)
    ends = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))]
    begins = np.arange(0.0, max(ends[-1], 1e-9), 2 * DASH)
    parts = []
    for begin in begins:
        along = np.r_[begin, ends[(ends > begin) & (ends < begin + DASH)], min(begin + DASH, ends[-1])]
        place = np.stack([np.interp(along, ends, corners[:, axis]) for axis in (0, 1)], -1)
        parts.append(np.rint(place).astype(np.int32))
    return parts


def round_step(longest: float, about: int) -> float:
    """A round number of which `longest` holds about so many."""
    power = 10 ** math.floor(math.log10(longest / about))
    return float(min((m * power for m in (1, 2, 5, 10)), key=lambda step: abs(longest / step - about)))
