"""The charts of the report as plotly figures; paper, ink and grid take their colours from the page that shows them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import ArrayLike, NDArray

from api.report.content import Coverage, FloatArray, StageView, TripletView
from api.report.facets import TripletColours

# Okabe and Ito's colours.
BLUE, ORANGE, VERMILLION, GREY = "#0072B2", "#E69F00", "#D55E00", "#8A8A8A"
_VIEW = {"eye": {"x": 1.42, "y": -1.6, "z": 0.85}, "center": {"x": 0, "y": 0, "z": -0.16}}


def angles_deg(vectors: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Azimuth about +z from +x and elevation above the x-y plane of (n, 3) vectors, degrees."""
    x, y, z = np.asarray(vectors, dtype=float).reshape(-1, 3).T
    return np.degrees(np.arctan2(y, x)), np.degrees(np.arctan2(z, np.hypot(x, y)))


def stage_figure(view: StageView) -> go.Figure:
    """The stage in 3-D: candidates, chosen lights numbered in order, camera and surface."""
    figure = go.Figure()
    reach = float(np.median(np.linalg.norm(view.lights, axis=1))) or 1.0
    surface, colours = view.surface_sample()
    if len(surface):
        rgb = GREY if colours is None else [f"rgb({r},{g},{b})" for r, g, b in colours]
        options = {"marker": {"size": 2, "color": rgb}, "hoverinfo": "skip", "showlegend": False}
        figure.add_trace(points_trace(surface, "object's surface", **options))
    others = [i for i in range(len(view.lights)) if i not in set(view.chosen)]
    if others:
        figure.add_trace(
            points_trace(
                view.lights[others],
                "candidate" if view.chosen else "light",
                marker={"size": 4, "color": GREY, "opacity": 0.75},
                text=_light_names(view.lights, others),
            )
        )
    if view.chosen:
        numbers = [str(k + 1) for k in range(len(view.chosen))]
        names = _light_names(view.lights, view.chosen)
        figure.add_trace(
            points_trace(
                view.lights[list(view.chosen)],
                "chosen, in order",
                mode="markers+text",
                marker={"size": 7, "color": VERMILLION},
                text=numbers,
                textposition="top center",
                hovertext=[f"choice {n}: {name}" for n, name in zip(numbers, names, strict=True)],
            )
        )
    figure.add_traces(_camera(view, reach))
    return scene_layout(figure, "direction" if view.distant else "metres")


def coverage_figure(coverage: Coverage) -> go.Figure:
    """Share of the surface that can be measured against the number of lights, both components (paper 003 Fig. 8)."""
    figure = go.Figure()
    counts = [row[0] for row in coverage.curve]
    first, last = min(0, *counts), max(counts)
    parts = (
        ("diffuse", [row[1] for row in coverage.curve], coverage.limit_diffuse, BLUE, "circle"),
        ("specular", [row[2] for row in coverage.curve], coverage.limit_specular, VERMILLION, "diamond"),
    )
    for name, shares, limit, colour, symbol in parts:
        figure.add_scatter(
            x=counts,
            y=[100 * share for share in shares],
            name=name,
            mode="lines+markers",
            line={"color": colour, "width": 2},
            marker={"symbol": symbol, "size": 7},
            hovertemplate="%{x} lights: %{y:.2f} %<extra>" + name + "</extra>",
        )
        levels = [(f"{name}, all candidates", limit, "dot")]
        if coverage.target < 1:
            levels.append((f"{name}, target", coverage.target * limit, "dash"))
        for label, level, dash in levels:
            figure.add_scatter(
                x=[first, last],
                y=[100 * level] * 2,
                name=label,
                mode="lines",
                line={"color": colour, "width": 1.2, "dash": dash},
                hovertemplate="%{y:.2f} %<extra>" + label + "</extra>",
            )
    figure.update_xaxes(title="number of lights", range=[first - 0.3, last + 0.3])
    figure.update_yaxes(title="measurable surface, %", range=[0, 104])
    return flat_layout(figure, 400)


def triplet_figure(view: TripletView, colours: TripletColours) -> go.Figure:
    """The triangulated lights, the used triplets in the colours of the picture (paper 001 Fig. 4)."""
    figure = go.Figure()
    x, y, z = np.asarray(view.lights, dtype=np.float32).T
    if len(colours.triples):
        i, j, k = colours.triples.T
        figure.add_mesh3d(
            **{"x": x, "y": y, "z": z, "i": i, "j": j, "k": k},
            facecolor=[f"rgb({r},{g},{b})" for r, g, b in colours.rgb],
            flatshading=True,
            lighting={"ambient": 1.0, "diffuse": 0.0, "specular": 0.0},
            opacity=0.9,
            hoverinfo="skip",
            name="triplets in use",
            showlegend=False,
        )
    corners = np.full((len(view.facets), 5, 3), np.nan, dtype=np.float32)
    corners[:, :4] = view.lights[view.facets[:, [0, 1, 2, 0]]]
    line = {"color": GREY, "width": 1.5}
    figure.add_trace(points_trace(corners.reshape(-1, 3), "triangulation", mode="lines", line=line, hoverinfo="skip"))
    figure.add_trace(
        points_trace(
            view.lights,
            "measured light",
            marker={"size": 3.5, "color": GREY},
            text=_light_names(view.lights, range(len(view.lights))),
        )
    )
    ray = np.stack([np.zeros(3), _wanted_place(view)])
    stem = {"mode": "lines", "line": {"color": VERMILLION, "width": 4}, "hoverinfo": "skip", "showlegend": False}
    figure.add_trace(points_trace(ray, "wanted light", **stem))
    marker = {"size": 7, "color": VERMILLION, "symbol": "diamond"}
    figure.add_trace(points_trace(ray[1], "wanted light", marker=marker, hoverinfo="name"))
    return scene_layout(figure, "direction" if view.distant else "metres")


def speed_figure(rows: Sequence[Mapping[str, Any]], time_key: str, time_label: str) -> go.Figure | None:
    """Error of each model against one of its times, log time; None with fewer than two models that have both.

    The dashed staircase joins the models that no other model beats in both.
    """
    pairs = [(_number(row.get(time_key)), _number(row.get("mae")), str(row.get("model", ""))) for row in rows]
    known = sorted((t, e, n) for t, e, n in pairs if t is not None and t > 0 and e is not None)
    if len(known) < 2:
        return None
    best: list[tuple[float, float]] = []
    for seconds, error, _ in known:
        if not best or error < best[-1][1]:
            best.append((seconds, error))
    figure = go.Figure()
    figure.add_scatter(
        x=[t for t, _ in best],
        y=[e for _, e in best],
        mode="lines",
        line={"color": GREY, "width": 1.2, "dash": "dash", "shape": "hv"},
        hoverinfo="skip",
    )
    figure.add_scatter(
        x=[t for t, _, _ in known],
        y=[e for _, e, _ in known],
        text=[n for _, _, n in known],
        mode="markers+text",
        # Neighbours in time carry their names on opposite sides, so that they do not cover each other.
        textposition=["top center" if k % 2 else "bottom center" for k in range(len(known))],
        marker={"size": 11, "color": BLUE},
        cliponaxis=False,
        hovertemplate="%{text}<br>%{x:.4g} "
        + time_label.rpartition(", ")[2]
        + "<br>%{y:.3f} grey levels<extra></extra>",
    )
    low, high = (math.log10(known[k][0]) for k in (0, -1))
    margin = 0.12 * (high - low) + 0.25
    decades = range(math.floor(low - margin), math.ceil(high + margin) + 1)
    ticks = [step * 10.0**k for k in decades for step in ((1, 2, 5) if high - low < 2 else (1,))]
    labels = [f"{tick:g}" for tick in ticks]
    figure.update_xaxes(type="log", title=time_label, range=[low - margin, high + margin])
    figure.update_xaxes(tickvals=ticks, ticktext=labels)
    figure.update_yaxes(title="mean absolute error, grey levels", rangemode="tozero")
    figure.update_layout(showlegend=False)
    return flat_layout(figure, 360)


def _number(value: Any) -> float | None:
    return float(value) if isinstance(value, (int, float, np.number)) and math.isfinite(value) else None


def points_trace(places: ArrayLike, name: str, **options: Any) -> go.Scatter3d:
    """Scatter trace of places (n, 3); hovering shows `text` unless the options say otherwise."""
    x, y, z = np.asarray(places, dtype=np.float32).reshape(-1, 3).T
    fallback = {"mode": "markers"} | ({} if {"hovertemplate", "hoverinfo"} & options.keys() else {"hoverinfo": "text"})
    return go.Scatter3d(x=x, y=y, z=z, name=name, **(fallback | options))


def _light_names(lights: FloatArray, indices: Sequence[int]) -> list[str]:
    azimuth, elevation = angles_deg(lights)
    return [f"light {i}: azimuth {azimuth[i]:.0f}°, elevation {elevation[i]:.0f}°" for i in indices]


def _camera(view: StageView, reach: float) -> list[go.Scatter3d]:
    """Pinhole and field of view; a camera much farther than the lights is drawn nearer and says so."""
    colour = BLUE
    if view.camera is None:
        if not view.distant:
            return []
        # Without a camera the world frame is the viewer's: +z points to the camera (DESIGN, dataset folder).
        arrow = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.25 * reach]])
        marker = {"size": [0, 6], "color": colour, "symbol": "square"}
        line = {"color": colour, "width": 3}
        return [points_trace(arrow, "to the camera", mode="lines+markers", marker=marker, line=line, hoverinfo="name")]
    centre = view.camera.centre
    distance = float(np.linalg.norm(centre))
    name = "camera"
    if distance > 2 * reach:
        name = f"camera, drawn nearer: {distance:.2f} m away"
        centre = centre * (1.5 * reach / distance)
    right, bottom = view.camera.width - 1, view.camera.height - 1
    rays = view.camera.rays(np.array([[0, 0], [right, 0], [right, bottom], [0, bottom]]))
    corners = centre + 0.25 * reach * rays
    path = np.concatenate(
        [[centre, corners[0], corners[1], centre, corners[2], corners[3], centre], corners[[0, 3, 2, 1]]]
    )
    marker = {"size": [6] + [0] * (len(path) - 1), "color": colour, "symbol": "square"}
    line = {"color": colour, "width": 3}
    return [points_trace(path, name, mode="lines+markers", marker=marker, line=line, hoverinfo="name")]


def _wanted_place(view: TripletView) -> NDArray[np.float64]:
    """Where the wanted light is drawn: its place, or just outside the measured lights where it is infinitely far."""
    if view.wanted.position is not None and not view.distant:
        return np.array(view.wanted.position)
    towards = np.array(view.wanted.direction or view.wanted.position, dtype=float)
    reach = float(np.linalg.norm(view.lights, axis=1).max())
    return np.asarray(1.15 * reach * towards / (np.linalg.norm(towards) or 1.0))


def scene_layout(figure: go.Figure, unit: str) -> go.Figure:
    """Layout of a 3-D view of the stage with equal axes, in metres or as unit directions."""
    axes = {f"{a}axis": {"title": {"text": f"{a}, m" if unit == "metres" else a}} for a in "xyz"}
    figure.update_layout(
        height=520,
        margin={"l": 0, "r": 0, "t": 10, "b": 0},
        scene={**axes, "aspectmode": "data", "camera": _VIEW},
        legend={"orientation": "h", "y": 0, "yanchor": "top", "itemsizing": "constant"},
    )
    return without_template(figure)


def flat_layout(figure: go.Figure, height: int) -> go.Figure:
    """Layout of a chart with two axes, `height` pixels high."""
    figure.update_layout(
        height=height,
        margin={"l": 60, "r": 16, "t": 16, "b": 52},
        legend={"orientation": "h", "y": -0.2, "yanchor": "top"},
        dragmode=False,
    )
    figure.update_xaxes(title_standoff=8)
    return without_template(figure)


def without_template(figure: go.Figure) -> go.Figure:
    """Take plotly's own template off: its colours are made for white paper, and the page brings one for its theme."""
    figure.update_layout(template=None, autosize=True)
    return figure
