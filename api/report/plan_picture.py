"""One picture that sums a plan up: stage, coverage maps and curves, drawn by OpenCV."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from api.report.canvas import blank, draw_stage, paste
from api.report.chart import Line, chart
from api.report.content import ByteImage
from api.report.picture import COLUMN, GAP, MARGIN, WIDTH, Tile, draw_header, draw_row, write_png
from api.report.plan_content import PlanContent, Trace
from api.report.plan_figures import BOUND, COMPONENTS, colours, stepped, trace_colours
from api.report.plan_maps import plan_maps

PANEL = (WIDTH - 2 * MARGIN - GAP) // 2
PANEL_HEIGHT, NAMES = 360, 190
PERCENT, HALF = 100.0, 50.0
STAGE_HEIGHT = 250


def write_plan_picture(path: str | Path, content: PlanContent) -> None:
    """Write a PNG, 1280 pixels wide: stage and maps in a row, below them the curves, two side by side.

    Parts that are None or empty are left out. Raises `InputError` where the file cannot be written.
    """
    write_png(Path(path), plan_picture(content))


def plan_picture(content: PlanContent) -> ByteImage:
    """Compose the picture: (height, 1280, 3) RGB uint8."""
    blocks = [draw_header(content.title, content.lede, content.summary)]
    tiles = _tiles(content)
    if tiles:
        blocks.append(draw_row(tiles))
    panels = _panels(content)
    for first in range(0, len(panels), 2):
        row = blank(WIDTH, PANEL_HEIGHT)
        for place, panel in enumerate(panels[first : first + 2]):
            paste(row, panel, MARGIN + place * (PANEL + GAP), 0)
        blocks.append(row)
    return np.concatenate([*blocks, blank(WIDTH, MARGIN - 8)])


def _tiles(content: PlanContent) -> list[Tile]:
    tiles = []
    if content.stage is not None:
        view = content.stage
        height = STAGE_HEIGHT
        words = f"{len(view.chosen)} of {len(view.lights)} candidates" if view.chosen else f"{len(view.lights)} lights"
        tiles.append(Tile("chosen lights in order", draw_stage(view, COLUMN, height), words))
    if content.maps is not None:
        for one in plan_maps(content.maps):
            tiles.append(Tile(one.label, np.where(one.mask[..., None], one.rgb, np.uint8(255)), legend=one.legend))
    return tiles


def _panels(content: PlanContent) -> list[ByteImage]:
    panels = [_coverage(content, component) for component in (0, 1) if any(row.curve for row in content.plans)]
    for traces, title, x_name, y_name, factor in (
        (content.lights_by_target, "lights against target", "target, %", "lights", PERCENT),
        (content.seconds_by_target, "time against quality", "target, %", "seconds of capture", PERCENT),
        (
            content.error_by_seconds,
            "expected error against time",
            "seconds of capture",
            "expected error",
            1.0,
        ),
    ):
        if traces:
            panels.append(_traces(traces, title, x_name, y_name, factor))
    return panels


def _coverage(content: PlanContent, component: int) -> ByteImage:
    column, name = COMPONENTS[component]
    rows = [row for row in content.plans if row.curve]
    last = max(row.count for row in rows)
    lines = [
        Line(
            f"{row.method}, {row.count}",
            [0, *(step[0] for step in row.curve)],
            [0.0, *(100 * step[column] for step in row.curve)],
            colour,
        )
        for row, colour in zip(rows, colours([row.method for row in rows]), strict=True)
    ]
    if content.limits is not None:
        lines.append(Line("all candidates", [0, last], [100 * content.limits[component]] * 2, BOUND, True))
    bound = max((row.lower_bound for row in rows if row.chosen), default=0)
    if bound:
        lines.append(Line(f"proved: at least {bound}", [bound, bound], [0, 100], BOUND, True))
    words = f"{name} coverage against number of lights"
    return _panel(lines, words, "lights", "object's pixels, %")


def _traces(traces: Sequence[Trace], title: str, x_name: str, y_name: str, factor: float) -> ByteImage:
    stairs = [stepped(trace, early=factor == PERCENT) for trace in traces]
    lines = [
        Line(trace.name, [factor * x for x in trace.x], list(trace.y), colour, trace.proven)
        for trace, colour in zip(stairs, trace_colours(traces), strict=True)
    ]
    lowest = min(factor * x for trace in traces for x in trace.x)
    return _panel(lines, title, x_name, y_name, HALF if factor == PERCENT and lowest >= HALF else 0.0)


def _panel(lines: list[Line], title: str, x_name: str, y_name: str, x_from: float = 0.0) -> ByteImage:
    return chart(lines, title, x_name, y_name, width=PANEL, height=PANEL_HEIGHT, names=NAMES, x_from=x_from)
