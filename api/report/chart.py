"""A chart of a few lines as a picture, for a page that cannot run scripts. Drawn by OpenCV."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike

from api.report.canvas import INK, MUTED, RGB, blank, text_width, write
from api.report.content import ByteImage

WIDTH, HEIGHT = 1280, 480
LEFT, RIGHT, TOP, BOTTOM = 84, 330, 76, 60
# Okabe and Ito's colours.
COLOURS: tuple[RGB, ...] = ((0, 114, 178), (230, 159, 0), (0, 158, 115), (213, 94, 0))
GRID: RGB = (226, 229, 233)
TICKS = 6
"""About so many on each axis."""


@dataclass(frozen=True, eq=False)
class Line:
    """Points joined in their order.

    Attributes
    ----------
    name : str
        Beside the chart.
    x, y : (n,) float
        n >= 1.
    """

    name: str
    x: ArrayLike
    y: ArrayLike


def chart(lines: Sequence[Line], title: str, x_name: str, y_name: str) -> ByteImage:
    """Draw lines over common axes, both from zero: (480, 1280, 3) uint8, RGB."""
    canvas = blank(WIDTH, HEIGHT)
    points = [np.stack([np.asarray(line.x, float), np.asarray(line.y, float)], -1) for line in lines]
    top = np.max([one.max(0) for one in points], 0)
    steps = [round_step(float(one), TICKS) for one in top]
    ends = [step * math.ceil(one / step - 1e-9) for one, step in zip(top, steps, strict=True)]
    size = np.array([WIDTH - LEFT - RIGHT, TOP + BOTTOM - HEIGHT]) / ends
    origin = np.array([LEFT, HEIGHT - BOTTOM])
    write(canvas, title, LEFT, 44, 22, INK, 700)
    write(canvas, y_name, LEFT, TOP - 10, 13, MUTED)
    write(canvas, x_name, WIDTH - RIGHT - text_width(x_name, 13), HEIGHT - 14, 13, MUTED)
    for tick in range(round(ends[0] / steps[0]) + 1):
        at, words = LEFT + round(tick * steps[0] * size[0]), f"{tick * steps[0]:g}"
        cv2.line(canvas, (at, HEIGHT - BOTTOM), (at, HEIGHT - BOTTOM + 5), MUTED, 1)
        write(canvas, words, at - text_width(words, 13) // 2, HEIGHT - BOTTOM + 22, 13, MUTED)
    for tick in range(round(ends[1] / steps[1]) + 1):
        at, words = HEIGHT - BOTTOM + round(tick * steps[1] * size[1]), f"{tick * steps[1]:g}"
        cv2.line(canvas, (LEFT, at), (WIDTH - RIGHT, at), GRID, 1)
        write(canvas, words, LEFT - 10 - text_width(words, 13), at + 5, 13, MUTED)
    for number, (line, places) in enumerate(zip(lines, points, strict=True)):
        colour, y = COLOURS[number % len(COLOURS)], TOP + 20 + 28 * number
        cv2.polylines(canvas, [np.rint(origin + places * size).astype(np.int32)], False, colour, 2, cv2.LINE_AA)
        cv2.line(canvas, (WIDTH - RIGHT + 24, y), (WIDTH - RIGHT + 52, y), colour, 3)
        write(canvas, line.name, WIDTH - RIGHT + 62, y + 5, 14, INK)
    return canvas


def round_step(longest: float, about: int) -> float:
    """A round number of which `longest` holds about so many."""
    power = 10 ** math.floor(math.log10(longest / about))
    return float(min((m * power for m in (1, 2, 5, 10)), key=lambda step: abs(longest / step - about)))
