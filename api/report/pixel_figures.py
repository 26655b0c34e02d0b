"""What one pixel saw as the light moved: over azimuth and elevation, and seen from above (paper 001 Fig. 1, K19)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import Delaunay, QhullError

from api.report.content import FloatArray, ReflectanceFunction
from api.report.figures import GREY, VERMILLION, angles_deg, flat_layout, points_trace, without_template

_COLOUR_BAR = {
    "orientation": "h",
    "title": {"text": "radiance", "side": "bottom"},
    "thickness": 10,
    "len": 0.6,
    "y": 0,
    "yanchor": "top",
}


def reflectance_surface(function: ReflectanceFunction) -> go.Figure | None:
    """Radiance of one pixel as a surface over azimuth and elevation (paper 001 Fig. 1); None where none is spanned.

    Between the lights the surface is linear in the azimuthal equidistant map about +z, which has neither a seam at 180
    degrees nor a pole; nothing is drawn outside the hull of the lights.
    """
    seen = _seen(function)
    interpolate = _interpolator(seen)
    if interpolate is None:
        return None
    azimuth, elevation = angles_deg(seen[:, :3])
    grid_a = np.linspace(-180, 180, 121)
    grid_e = np.linspace(elevation.min(), elevation.max(), 61)
    height = interpolate(*_equidistant(*np.meshgrid(grid_a, grid_e)))
    figure = go.Figure(
        go.Surface(
            x=grid_a.astype(np.float32),
            y=grid_e.astype(np.float32),
            z=height.astype(np.float32),
            colorscale="Viridis",
            colorbar=_COLOUR_BAR,
            hovertemplate="azimuth %{x:.0f}°, elevation %{y:.0f}°: %{z:.4g}<extra>between lights</extra>",
        )
    )
    figure.add_trace(
        points_trace(
            np.stack([azimuth, elevation, seen[:, 3]], axis=-1),
            "measured",
            marker={"size": 2.5, "color": VERMILLION},
            hovertemplate="azimuth %{x:.0f}°, elevation %{y:.0f}°: %{z:.4g}<extra>measured</extra>",
        )
    )
    figure.update_layout(
        height=480,
        showlegend=False,
        margin={"l": 0, "r": 0, "t": 10, "b": 0},
        scene={
            "xaxis": {"title": {"text": "azimuth, °"}, "tickvals": [-180, -90, 0, 90, 180]},
            "yaxis": {"title": {"text": "elevation, °"}},
            "zaxis": {"title": {"text": "radiance"}, "rangemode": "tozero"},
            "aspectmode": "manual",
            "aspectratio": {"x": 1.5, "y": 1.0, "z": 0.75},
            "camera": {"eye": {"x": 1.1, "y": -1.7, "z": 0.9}},
        },
    )
    return without_template(figure)


def reflectance_map(function: ReflectanceFunction) -> go.Figure:
    """Radiance of one pixel over light direction, seen from above: zenith in the middle, azimuth runs round."""
    seen = _seen(function)
    x, y = _equidistant(*angles_deg(seen[:, :3]))
    rim = max(90.0, 1.04 * float(np.hypot(x, y).max(initial=0.0)))
    figure = go.Figure()
    interpolate = _interpolator(seen)
    if interpolate is not None:
        axis = np.linspace(-rim, rim, 181)
        figure.add_heatmap(
            x=axis.astype(np.float32),
            y=axis.astype(np.float32),
            z=interpolate(*np.meshgrid(axis, axis)).astype(np.float32),
            coloraxis="coloraxis",
            hoverinfo="skip",
            zsmooth="best",
        )
    azimuth, elevation = angles_deg(seen[:, :3])
    figure.add_scatter(
        x=x,
        y=y,
        mode="markers",
        marker={"color": seen[:, 3], "coloraxis": "coloraxis", "size": 8, "line": {"color": "#ffffff", "width": 1}},
        customdata=np.stack([azimuth, elevation, seen[:, 3]], axis=-1),
        hovertemplate="azimuth %{customdata[0]:.0f}°, elevation %{customdata[1]:.0f}°: %{customdata[2]:.4g}"
        "<extra>measured</extra>",
    )
    for ring in (60, 30, 0):
        radius = 90 - ring
        figure.add_shape(type="circle", x0=-radius, x1=radius, y0=-radius, y1=radius, line={"color": GREY, "width": 1})
        label = {"font": {"size": 11, "color": "#1c1f24"}, "bgcolor": "rgba(255,255,255,0.75)", "borderpad": 1}
        tilt = math.radians(-75)
        figure.add_annotation(
            x=radius * math.cos(tilt), y=radius * math.sin(tilt), text=f"{ring}°", showarrow=False, **label
        )
    for degrees, text in ((0, "0°"), (90, "90°"), (180, "180°"), (-90, "−90°")):
        a = math.radians(degrees)
        place = {"x": rim * math.cos(a), "y": rim * math.sin(a)}
        shift = {"xshift": 16 * math.cos(a), "yshift": 12 * math.sin(a)}
        figure.add_annotation(**place, **shift, text=text, showarrow=False, font={"size": 11})
    span = [-1.16 * rim, 1.16 * rim]
    figure.update_xaxes(visible=False, range=span)
    figure.update_yaxes(visible=False, range=span, scaleanchor="x")
    figure.update_layout(coloraxis={"colorscale": "Viridis", "colorbar": _COLOUR_BAR})
    return flat_layout(figure, 480)


def _seen(function: ReflectanceFunction) -> NDArray[np.float64]:
    """Unit direction and mean of R, G, B where the pixel was measured: (n, 4)."""
    value = np.mean(function.values, axis=-1)
    length = np.linalg.norm(function.directions, axis=-1)
    good = np.isfinite(value) & (length > 0)
    return np.column_stack([function.directions[good] / length[good, None], value[good]]).astype(float)


def _equidistant(azimuth_deg: FloatArray, elevation_deg: FloatArray) -> tuple[NDArray[Any], NDArray[Any]]:
    """Azimuthal equidistant map about +z, in degrees from the zenith."""
    radius, angle = 90 - elevation_deg, np.radians(azimuth_deg)
    return radius * np.cos(angle), radius * np.sin(angle)


def _interpolator(seen: NDArray[np.float64]) -> LinearNDInterpolator | None:
    """Linear interpolation over the equidistant map, or None where the directions span no area."""
    try:
        plane = Delaunay(np.stack(_equidistant(*angles_deg(seen[:, :3])), axis=-1))
    except (QhullError, ValueError):
        return None
    return LinearNDInterpolator(plane, seen[:, 3])
