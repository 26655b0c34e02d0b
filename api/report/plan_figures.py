"""The charts of a plan's page, as plotly figures; the picture takes its colours from here."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import plotly.graph_objects as go

from api.report.figures import flat_layout
from api.report.plan_content import PlanContent, Trace

RGB = tuple[int, int, int]
# Okabe and Ito's colours; those of the methods are the same in all charts.
PALETTE: tuple[RGB, ...] = (
    *((0, 114, 178), (213, 94, 0), (0, 158, 115), (230, 159, 0), (204, 121, 167), (86, 180, 233)),
)
BOUND: RGB = (128, 128, 128)
KNOWN: dict[str, RGB] = dict(
    zip(("optimal", "greedy", "information", "static", "random", "farthest"), PALETTE, strict=True)
)
SYMBOLS = ("circle", "diamond", "square", "triangle-up", "cross", "star", "x")
COMPONENTS: tuple[tuple[int, str], ...] = ((1, "diffuse"), (2, "specular"))


def colours(names: Sequence[str]) -> list[RGB]:
    """A colour for each name, the same in every chart; names that are not known take what is left of the palette."""
    free = [colour for colour in PALETTE if colour not in {KNOWN.get(name) for name in names}]
    found, used = [], 0
    for name in names:
        if name in KNOWN:
            found.append(KNOWN[name])
        else:
            found.append(free[used % len(free)] if free else BOUND)
            used += 1
    return found


def coverage_chart(content: PlanContent, component: Literal[0, 1]) -> go.Figure:
    """Coverage of one component against the number of lights: every method, the limit, the target and the bound."""
    column, name = COMPONENTS[component]
    rows = [row for row in content.plans if row.curve]
    figure = go.Figure()
    last = max(row.count for row in rows)
    for number, (row, colour) in enumerate(zip(rows, colours([row.method for row in rows]), strict=True)):
        figure.add_scatter(
            x=[0, *(step[0] for step in row.curve)],
            y=[0.0, *(100 * step[column] for step in row.curve)],
            name=row.method,
            mode="lines+markers",
            line={"color": css(colour), "width": 3 if row.chosen else 1.8},
            marker={"symbol": SYMBOLS[number % len(SYMBOLS)], "size": 7 if row.chosen else 5},
            hovertemplate="%{x} lights: %{y:.2f} %<extra>" + row.method + "</extra>",
            zorder=1 if row.chosen else 0,
        )
    if content.limits is not None:
        levels = [("all candidates", content.limits[component], "dot")]
        if content.target < 1:
            levels.append(("target", content.target * content.limits[component], "dash"))
        for label, level, dash in levels:
            figure.add_scatter(
                x=[0, last],
                y=[100 * level] * 2,
                name=label,
                mode="lines",
                line={"color": css(BOUND), "width": 1.4, "dash": dash},
                hovertemplate="%{y:.2f} %<extra>" + label + "</extra>",
            )
    bound = max(row.lower_bound for row in rows if row.chosen) if any(row.chosen for row in rows) else 0
    if bound:
        figure.add_scatter(
            x=[bound, bound],
            y=[0, 100],
            name=f"proved: at least {bound} lights",
            mode="lines",
            line={"color": css(BOUND), "width": 2, "dash": "longdash"},
            hoverinfo="name",
        )
    figure.update_xaxes(title="number of lights", range=[-0.02 * last, 1.03 * last])
    figure.update_yaxes(title=f"object's pixels, {name}, %", range=[0, 104])
    return flat_layout(figure, 400)


def traces_chart(
    traces: Sequence[Trace], x_title: str, y_title: str, *, x_factor: float = 1.0, early: bool = False
) -> go.Figure:
    """Staircases over common axes, y from zero; bounds are dashed and grey. For `early`, see `stepped`."""
    figure = go.Figure()
    for number, (trace, colour) in enumerate(zip(traces, trace_colours(traces), strict=True)):
        figure.add_scatter(
            x=[x_factor * value for value in trace.x],
            y=list(trace.y),
            name=trace.name,
            mode="lines+markers",
            line={
                "color": css(colour),
                "width": 2,
                "dash": "dash" if trace.proven else "solid",
                "shape": "vh" if early and not trace.proven else "hv",
            },
            marker={"symbol": SYMBOLS[number % len(SYMBOLS)], "size": 6},
            hovertemplate="%{x:.4g}: %{y:.4g}<extra>" + trace.name + "</extra>",
        )
    figure.update_xaxes(title=x_title)
    figure.update_yaxes(title=y_title, rangemode="tozero")
    return flat_layout(figure, 360)


def stepped(trace: Trace, *, early: bool) -> Trace:
    """The same as the corners of a staircase.

    A plan serves every lower target as well: where `early`, its stairs rise right after the target before. A bound
    holds for every higher target, and what has been learnt stays until the next light: these rise late.
    """
    x, y = list(trace.x), list(trace.y)
    rising = early and not trace.proven
    corners = zip(x[:-1], y[1:], strict=True) if rising else zip(x[1:], y[:-1], strict=True)
    places = [(x[0], y[0])]
    for corner, place in zip(corners, zip(x[1:], y[1:], strict=True), strict=True):
        places += [corner, place]
    return Trace(trace.name, [one for one, _ in places], [other for _, other in places], trace.proven)


def trace_colours(traces: Sequence[Trace]) -> list[RGB]:
    """Grey for bounds, and for the others as in every chart."""
    free = iter(colours([trace.name for trace in traces if not trace.proven]))
    return [BOUND if trace.proven else next(free) for trace in traces]


def css(colour: RGB) -> str:
    """As a style sheet writes it."""
    return f"#{bytes(colour).hex()}"
