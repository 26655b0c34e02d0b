"""Where the light was and what it told: stage, coverage, triplets, one pixel over light direction."""

from __future__ import annotations

import cv2
import numpy as np

from api.report import imaging
from api.report.canvas import draw_stage
from api.report.content import ByteImage, ReportContent, TripletView
from api.report.facets import TripletColours, colour_triplets
from api.report.figures import angles_deg, coverage_figure, stage_figure, triplet_figure
from api.report.markup import (
    beside,
    chart,
    details,
    figure,
    image,
    number,
    percent,
    section,
    swatches,
    table,
    tile,
    tiles,
)
from api.report.pixel_figures import reflectance_map, reflectance_surface

LISTED_TRIPLETS = 10


def stage_section(content: ReportContent) -> str:
    """The stage and the chosen lights in 3-D, with the list of chosen lights."""
    view = content.stage
    if view is None:
        return ""
    azimuth, elevation = angles_deg(view.lights)
    what = "directions (unit vectors)" if view.distant else "positions in metres"
    label = f"3-D view of {len(view.lights)} lights, {len(view.chosen)} of them chosen."
    caption = f"{len(view.lights)} lights as {what}" + (
        f", {len(view.chosen)} of them chosen and numbered in the order of choice. " if view.chosen else ". "
    )
    caption += "Drag to turn it."
    drawn = image(imaging.embed(draw_stage(view, 640, 480)), label)
    listed = list(view.chosen) or list(range(len(view.lights)))
    unit = "" if view.distant else "\nm"
    rows = [
        [str(k + 1), str(i), *(number(float(x), 4) for x in view.lights[i]), f"{azimuth[i]:.1f}", f"{elevation[i]:.1f}"]
        for k, i in enumerate(listed)
    ]
    headers = ["order", "light", f"x{unit}", f"y{unit}", f"z{unit}", "azimuth\n°", "elevation\n°"]
    return section(
        "stage",
        "Stage and lights",
        (
            figure(chart("chart-stage", stage_figure(view), label, drawn), caption),
            details("Chosen lights in numbers" if view.chosen else "Lights in numbers", table(headers, rows)),
        ),
    )


def coverage_section(content: ReportContent) -> str:
    """Coverage against number of lights, both components (paper 003 Fig. 8, M17)."""
    coverage = content.coverage
    if coverage is None or not coverage.curve:
        return ""
    last = coverage.curve[-1]
    caption = (
        "Share of the visible surface on which each component can be measured, against the number of lights"
        + (f" chosen by the method '{coverage.method}'" if coverage.method else "")
        + f". With {last[0]}: diffuse {percent(last[1], 2)}, specular {percent(last[2], 2)}; "
        f"all candidates together reach {percent(coverage.limit_diffuse, 2)} and "
        f"{percent(coverage.limit_specular, 2)} (dotted)."
    )
    if coverage.target < 1:
        caption += f" The plan asked for {percent(coverage.target, 0)} of these limits (dashed)."
    if coverage.lower_bound is not None:
        caption += f" No plan that reaches the target has fewer than {coverage.lower_bound} lights."
    rows = [[str(n), percent(d, 2), percent(s, 2)] for n, d, s in coverage.curve]
    return section(
        "coverage",
        "Coverage against number of lights",
        (
            figure(chart("chart-coverage", coverage_figure(coverage), caption), caption),
            details("Coverage in numbers", table(["lights", "diffuse", "specular"], rows)),
        ),
    )


def triplets_section(content: ReportContent) -> str:
    """Which triplet of lights rendered which pixel, picture and triangulation in like colours (paper 001 Fig. 4)."""
    view = content.triplets
    if view is None:
        return ""
    colours = colour_triplets(view.triples)
    pictures = []
    if view.rendered is not None:
        shown = image(
            imaging.embed(view.rendered, photograph=True), f"Rendering by {view.model} under the wanted light."
        )
        pictures.append(tile(f"rendered: {view.model}", shown))
    coded = imaging.embed(colours.picture, where=colours.rendered)
    alt = f"Every pixel in the colour of the triplet of lights that rendered it, {len(colours.triples)} triplets."
    pictures.append(tile("triplet of each pixel", image(coded, alt)))
    plot = chart(
        "chart-triplets", triplet_figure(view, colours), "3-D view of the triangulated lights, used triplets coloured."
    )
    caption = (
        f"Each pixel was blended from the photographs of three lights; {len(colours.triples)} triplets of "
        f"{len(view.facets)} facets serve this image. A facet of the triangulation has the colour of the pixels it "
        "rendered; colours repeat, but not across an edge. Orange: the wanted light. " + _triplet_note(view)
    )
    return section(
        "triplets",
        "Which lights rendered which pixel",
        (
            figure(beside(tiles(pictures, "column"), plot), caption.strip()),
            details("Triplets in numbers", _triplet_table(colours)),
        ),
    )


def _triplet_note(view: TripletView) -> str:
    return "Lights are directions, so that every pixel has the same triplet." if view.distant else ""


def _triplet_table(colours: TripletColours) -> str:
    rows = [
        [swatches([(rgb.tolist(), " · ".join(map(str, triple.tolist())))]), percent(float(share), 2)]
        for triple, share, rgb in zip(colours.triples, colours.share, colours.rgb, strict=True)
    ][:LISTED_TRIPLETS]
    left = len(colours.triples) - len(rows)
    caption = f"The {len(rows)} triplets of most pixels; {left} more are not listed." if left else ""
    return table(["lights of the triplet", "pixels"], rows, caption=caption)


def reflectance_section(content: ReportContent) -> str:
    """One pixel's radiance over light direction (paper 001 Fig. 1, K19)."""
    function = content.reflectance
    if function is None or not len(function.directions):
        return ""
    row, column = function.pixel
    label = f"Radiance of the pixel in row {row}, column {column} over light direction, seen from above."
    body = tile("seen from above", chart("chart-pixel-map", reflectance_map(function), label))
    if function.picture is not None:
        marked = imaging.embed(_mark(function.picture, row, column), photograph=True)
        body = beside(tile("the pixel", image(marked, f"The object; a ring marks row {row}, column {column}.")), body)
    surface = reflectance_surface(function)
    if surface is not None:
        over = (
            f"Radiance of the pixel in row {row}, column {column} as a surface over azimuth and elevation of the light."
        )
        body += tile("over azimuth and elevation", chart("chart-pixel-surface", surface, over))
    azimuth, elevation = angles_deg(function.directions)
    rows = [
        [str(i), f"{azimuth[i]:.1f}", f"{elevation[i]:.1f}", *(number(float(v)) for v in function.values[i])]
        for i in range(len(function.directions))
    ]
    caption = (
        f"Reflectance function of the pixel in row {row}, column {column}: linear radiance (mean of red, green, blue) "
        "as the light moves. Dots are photographs, the colour between them is interpolated; azimuth runs about +z, "
        "elevation is measured from the x-y plane and is 90° in the middle."
    )
    headers = ["light", "azimuth\n°", "elevation\n°", "red", "green", "blue"]
    return section(
        "pixel",
        "One pixel over light direction",
        (figure(body, caption), details("The pixel in numbers", table(headers, rows))),
    )


def _mark(picture: ByteImage, row: int, column: int) -> ByteImage:
    marked = np.ascontiguousarray(picture).copy()
    radius = max(3, round(picture.shape[1] / 40))
    for colour, width in (((0, 0, 0), 3), ((255, 255, 255), 1)):
        cv2.circle(marked, (column, row), radius, colour, width * max(1, radius // 6), cv2.LINE_AA)
    return marked
