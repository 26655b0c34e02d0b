"""Where the time of a capture goes: what was done for each shot, and when, as a picture. Drawn by OpenCV."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2

from acquisition.taken import Stage, TakenShot
from api.report.canvas import INK, MUTED, PAPER, RGB, blank, fitted, text_width, write
from api.report.chart import COLOURS, round_step
from api.report.content import ByteImage

WIDTH, MARGIN, NAMES = 1280, 36, 110
ROW, BAR, AXIS = 26, 20, 34
HEADING, HEAD = 34, 92
STAGES: tuple[Stage, ...] = ("move", "settle", "light", "expose", "download", "decode", "write")
OPEN: RGB = (238, 240, 243)
"""Behind all rows while the shutter is open."""
LINE: RGB = (205, 209, 214)
TICKS = 10
"""About so many on the time axis."""


@dataclass(frozen=True)
class Course:
    """One capture, or a part of it.

    Attributes
    ----------
    heading : str
        What it is.
    shots : sequence of TakenShot
        In the order in which they were taken.
    """

    heading: str
    shots: Sequence[TakenShot]


def timeline_picture(courses: Sequence[Course], title: str, lede: str = "") -> ByteImage:
    """Draw what was done for each shot; all courses have one scale of time, and begin with their first shot.

    Parameters
    ----------
    courses : sequence of Course
        From top to bottom, each with at least one shot.
    title, lede : str
        Above them.

    Returns
    -------
    (height, 1280, 3) uint8
        RGB. A shot has one colour in all rows, and its number where there is room; while the shutter is open, the
        background is grey.
    """
    longest_s = max(_end(course) - _begin(course) for course in courses)
    per_course = HEADING + len(STAGES) * ROW + AXIS
    canvas = blank(WIDTH, HEAD + len(courses) * per_course + MARGIN // 2)
    write(canvas, fitted(title, 26, WIDTH - 2 * MARGIN, 700), MARGIN, 50, 26, INK, 700)
    write(canvas, fitted(lede, 15, WIDTH - 2 * MARGIN), MARGIN, 76, 15, MUTED)
    scale = (WIDTH - 2 * MARGIN - NAMES) / longest_s
    for number, course in enumerate(courses):
        _draw(canvas, course, HEAD + number * per_course, scale, longest_s)
    return canvas


def _draw(canvas: ByteImage, course: Course, top: int, scale: float, longest_s: float) -> None:
    zero_s, left = _begin(course), MARGIN + NAMES
    rows, bottom = top + HEADING, top + HEADING + len(STAGES) * ROW

    def x(seconds: float) -> int:
        return left + round((seconds - zero_s) * scale)

    write(canvas, fitted(course.heading, 15, WIDTH - 2 * MARGIN, 600), MARGIN, top + 20, 15, INK, 600)
    for shot in course.shots:
        if "expose" in shot.spans:
            opened, closed = shot.spans["expose"]
            cv2.rectangle(canvas, (x(opened), rows), (max(x(closed), x(opened) + 1) - 1, bottom), OPEN, -1)
    for row, stage in enumerate(STAGES):
        y = rows + row * ROW
        cv2.line(canvas, (left, y + ROW), (WIDTH - MARGIN, y + ROW), LINE, 1)
        write(canvas, stage, MARGIN, y + 18, 14, INK)
        for number, shot in enumerate(course.shots):
            if stage not in shot.spans:
                continue
            begin, end = (x(moment) for moment in shot.spans[stage])
            if begin < left:
                continue
            corner = (max(end, begin + 2) - 1, y + (ROW + BAR) // 2)
            cv2.rectangle(canvas, (begin, y + (ROW - BAR) // 2), corner, COLOURS[number % len(COLOURS)], -1)
            words = str(shot.shot)
            if (room := end - begin - text_width(words, 12, 600)) > 4:
                write(canvas, words, begin + room // 2, y + 18, 12, PAPER, 600)
    step = round_step(longest_s, TICKS)
    for tick in range(math.floor(longest_s / step) + 1):
        words, at = f"{tick * step:g} s", left + round(tick * step * scale)
        cv2.line(canvas, (at, bottom), (at, bottom + 5), MUTED, 1)
        if at + text_width(words, 12) / 2 < WIDTH - MARGIN / 2:
            write(canvas, words, at - text_width(words, 12) // 2, bottom + 20, 12, MUTED)


def _begin(course: Course) -> float:
    return min(begin for begin, _ in course.shots[0].spans.values())


def _end(course: Course) -> float:
    return max(end for shot in course.shots for _, end in shot.spans.values())
