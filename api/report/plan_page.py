"""The page of a plan: what its lights show and what none can, where they stand, and what more or fewer would do."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from acquisition.check.estimate import spoken_time
from acquisition.dataset import staged_file
from api.report import imaging
from api.report.appendix import provenance_section, summary_block
from api.report.content import ReportContent
from api.report.geometry import stage_section
from api.report.markup import (
    NOTHING,
    chart,
    details,
    figure,
    image,
    number,
    percent,
    section,
    swatches,
    table,
    text,
    tile,
    tiles,
)
from api.report.page import assemble
from api.report.plan_content import PlanContent, PlanRow, Trace
from api.report.plan_figures import COMPONENTS, coverage_chart, traces_chart
from api.report.plan_maps import plan_maps


def write_plan_report(path: str | Path, content: PlanContent) -> None:
    """Write `content` as one self-contained HTML file, wholly or not at all.

    Parameters
    ----------
    path : str or Path
        The file; an existing one is replaced in one step.
    content : PlanContent
        What to show; parts that are None or empty leave no trace.

    Raises
    ------
    InputError
        Where the file cannot be written.
    """
    page = render_plan_page(content)
    with staged_file(Path(path)) as temporary:
        temporary.write_text(page, encoding="utf-8")


def render_plan_page(content: PlanContent) -> str:
    """The page as text; equal content gives equal text. See `api.report.page.render_page` for what it may fetch."""
    shared = ReportContent(content.title, summary=content.summary, stage=content.stage, provenance=content.provenance)
    sections = (
        _warnings_section(content),
        _methods_section(content),
        _maps_section(content),
        stage_section(shared),
        _coverage_section(content),
        _targets_section(content),
        _time_section(content),
        provenance_section(shared),
    )
    return assemble(content.title, content.lede, summary_block(shared), sections)


def _warnings_section(content: PlanContent) -> str:
    items = "".join(f"<li>{text(sentence)}</li>" for sentence in content.warnings)
    return section("warnings", "What to know first", (f"<ul>{items}</ul>",)) if items else ""


def _methods_section(content: PlanContent) -> str:
    if not content.plans:
        return ""
    names = list(dict.fromkeys(name for row in content.plans for name in row.figures))
    timed = any(row.seconds is not None for row in content.plans)
    shown = any(row.curve for row in content.plans)
    headers = ["method", "bound by", "lights", "at least\nproved", "gap\nlights"]
    headers += ["diffuse\n% of object", "specular\n% of object"] * shown + ["capture"] * timed
    rows = [_method_cells(row, names, shown, timed) for row in content.plans]
    caption = (
        "Each method's plan for the same task. No set of fewer candidates than the proved number shows as much as the "
        "plan beside it has to." + (" Bold: the plan of this page." if any(row.chosen for row in content.plans) else "")
    )
    return section("methods", "Methods", (table([*headers, *map(_plain, names)], rows, caption=caption, words=2),))


def _method_cells(row: PlanRow, names: Sequence[str], shown: bool, timed: bool) -> list[str]:
    name = f"<strong>{text(row.method)}</strong>" if row.chosen else text(row.method)
    cells = [name, text(row.bound_by), str(row.count), str(row.lower_bound), str(row.count - row.lower_bound)]
    if shown:
        cells += [percent(share, 2) for share in row.curve[-1][1:]] if row.curve else [NOTHING, NOTHING]
    if timed:
        cells.append(NOTHING if row.seconds is None else text(spoken_time(row.seconds)))
    return cells + [number(row.figures.get(name)) for name in names]


def _plain(name: str) -> str:
    return name.replace("_", " ")


def _maps_section(content: PlanContent) -> str:
    if content.maps is None:
        return ""
    mask = content.maps.mask
    parts = [
        tile(one.label, image(imaging.embed(one.rgb, where=one.mask), f"Map: {one.label}.") + swatches(one.legend))
        for one in plan_maps(content.maps)
    ]
    height, width = mask.shape
    caption = (
        "By how many of the chosen lights each pixel is shown diffuse-only and with a strong highlight, and what no "
        f"candidate shows of it. The image has {width} × {height} pixels, {number(int(mask.sum()))} of them on the "
        "object. A pixel wants one light that shows its diffuse reflection alone and two that show its highlight "
        "strongly. Shares are of the object's pixels."
    )
    return section("maps", "What the chosen lights show", (figure(tiles(parts, "triple"), caption),))


def _coverage_section(content: PlanContent) -> str:
    rows = [row for row in content.plans if row.curve]
    if not rows:
        return ""
    charts = []
    for component, (column, name) in enumerate(COMPONENTS):
        label = f"Chart of the {name} coverage against the number of lights for {len(rows)} methods; numbers below."
        plot = coverage_chart(content, 1 if component else 0)
        last = ", ".join(f"{row.method} {percent(row.curve[-1][column])} with {row.count}" for row in rows)
        charts.append(tile(name, chart(f"chart-coverage-{name}", plot, f"{label} {last}.")))
    caption = (
        "Share of the object's pixels that are shown diffuse-only at least once, and with a strong highlight at least "
        "twice, by the first so many lights of each plan."
    )
    if content.limits is not None:
        caption += (
            f" All candidates together show {percent(content.limits[0], 2)} and {percent(content.limits[1], 2)} "
            "(dotted)."
        )
    caption += " Long dashes: no plan that reaches the target has fewer lights, which is proved."
    cells = [
        [text(row.method), str(count), percent(diffuse, 2), percent(specular, 2)]
        for row in rows
        for count, diffuse, specular in row.curve
    ]
    return section(
        "coverage",
        "Coverage against number of lights",
        (
            figure(tiles(charts, "pair"), caption),
            details("Coverage in numbers", table(["method", "lights", "diffuse", "specular"], cells)),
        ),
    )


def _targets_section(content: PlanContent) -> str:
    if not content.lights_by_target:
        return ""
    caption = (
        "How many lights it takes to show a share of what all candidates together show, in each component. Marks are "
        "the targets that were planned for; a plan serves all lower targets too. Between the dashed line and the best "
        "plan lies what is not known: no plan is below the line."
    )
    return section(
        "targets",
        "Lights against target",
        _traced("targets", content.lights_by_target, "target, %", "lights", caption, 100.0),
    )


def _time_section(content: PlanContent) -> str:
    body: list[str] = []
    if content.seconds_by_target:
        caption = (
            "How long a capture takes for a share of what all candidates together show: with the fewest lights in "
            "their shortest order, and with the lights that take least time, which may be more but nearer to each "
            "other. No plan is below the dashed line."
        )
        body += _traced("times", content.seconds_by_target, "target, %", "capture, s", caption, 100.0)
    if content.error_by_seconds:
        caption = "Expected error after so many seconds of capture, light by light."
        body += _traced("errors", content.error_by_seconds, "capture, s", "expected error", caption, 1.0, early=False)
    return section("time", "Time against quality", body)


def _traced(
    ident: str,
    traces: Sequence[Trace],
    x_title: str,
    y_title: str,
    caption: str,
    factor: float,
    *,
    early: bool = True,
) -> tuple[str, str]:
    """A chart and, folded away, its numbers."""
    plot = traces_chart(traces, x_title, y_title, x_factor=factor, early=early)
    cells = [
        [text(trace.name), number(factor * x), number(int(y) if float(y).is_integer() else y)]
        for trace in traces
        for x, y in zip(trace.x, trace.y, strict=True)
    ]
    headers = ["line", *(title.replace(", ", "\n") for title in (x_title, y_title))]
    return (
        figure(chart(f"chart-{ident}", plot, f"Chart of {y_title} against {x_title}; numbers below."), caption),
        details("In numbers", table(headers, cells)),
    )
