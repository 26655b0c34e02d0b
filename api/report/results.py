"""How good and how fast: the table of models, real beside rendered, and pictures under new light."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import Any

import cv2
import numpy as np

from api.report import imaging
from api.report.content import ByteImage, Comparison, Relit, ReportContent
from api.report.figures import speed_figure
from api.report.markup import (
    chart,
    figure,
    image,
    note,
    number,
    paragraph,
    percent,
    scale_bar,
    section,
    table,
    text,
    tile,
    tiles,
)

MAX_COMPARISONS = 24
OUTSIDE_RGB = (213, 94, 0)

# Key, heading with unit, which end is best, significant digits.
_COLUMNS = (
    ("model", "model", None, 0),
    ("train", "lights\nfitted", None, 0),
    ("test", "lights\nheld out", None, 0),
    ("mae", "MAE\ngrey levels", min, 3),
    ("psnr", "PSNR\ndB", max, 4),
    ("ssim", "SSIM\n ", max, 3),
    ("mae_object", "MAE, object\ngrey levels", min, 3),
    ("psnr_object", "PSNR, object\ndB", max, 4),
    ("outside", "outside\n% of object", None, 3),
    ("fit_s", "fit\ns", min, 3),
    ("render_ms_per_megapixel", "render\nms per megapixel", min, 3),
    ("peak_mib", "peak memory\nMiB", min, 4),
)


def models_section(content: ReportContent) -> str:
    """Table of models and the two charts of error against time."""
    rows = content.models
    if not rows:
        return ""
    charts = []
    for key, axis in (
        ("render_ms_per_megapixel", "time to render, ms per megapixel"),
        ("fit_s", "time to fit, s"),
    ):
        plot = speed_figure(rows, key, axis)
        if plot is not None:
            label = f"Chart of the mean absolute error of each model against its {axis}; the numbers are in the table."
            charts.append(chart(f"chart-{key.replace('_', '-')}", plot, label))
    caption = (
        "Error against time, one point per model, time on a logarithmic axis. Lower and further left is better: "
        "on the dashed line are the models that no other beats in both."
    )
    return section(
        "models",
        "Models: error and time",
        (
            paragraph(content.models_scale) if content.models_scale else "",
            _models_table(rows),
            figure(tiles(charts, "pair"), caption) if charts else "",
        ),
    )


def _models_table(rows: Sequence[Mapping[str, Any]]) -> str:
    known = [column for column in _COLUMNS if any(row.get(column[0]) is not None for row in rows)]
    named = {column[0] for column in _COLUMNS}
    plain = (key for row in rows for key, value in row.items() if isinstance(value, (str, int, float, np.number)))
    extra = [key for key in dict.fromkeys(plain) if key not in named]
    columns = known + [(key, key.replace("_", " "), None, 4) for key in extra]
    best = {}
    for key, _, choose, _ in columns:
        values = [value for value in (_measured(row.get(key)) for row in rows) if value is not None]
        if choose is not None and len(values) > 1:
            best[key] = choose(values)
    cells = []
    for row in rows:
        line = []
        for key, _, _, digits in columns:
            value = row.get(key)
            shown = _cell(key, value, digits)
            line.append(f"<strong>{shown}</strong>" if key in best and _measured(value) == best[key] else shown)
        cells.append(line)
    marked = " Bold: best of its column." if best else ""
    caption = f"Each model was fitted to some lights and scored on others; errors are means over images.{marked}"
    return table([heading for _, heading, _, _ in columns], cells, caption=caption)


def _cell(key: str, value: Any, digits: int) -> str:
    if isinstance(value, str):
        return text(value)
    known = _measured(value)
    return number(100 * known if key == "outside" and known is not None else known, digits)


def _measured(value: Any) -> int | float | None:
    """The number itself where it is one, else None; whole numbers stay whole. The PSNR of equal images is infinite."""
    if not isinstance(value, (int, float, np.number)) or np.isnan(value):
        return None
    return int(value) if isinstance(value, (int, np.integer)) else float(value)


def comparisons_section(content: ReportContent) -> str:
    """Real, rendered and the size of their difference on one colour scale (paper 001 Fig. 6, K18)."""
    shown = _by_light(content.comparisons)
    if not shown:
        return ""
    top = imaging.difference_scale(content.comparisons)
    rows = [
        _comparison_rows(light, list(same), top)
        for light, same in groupby(shown, key=lambda comparison: comparison.light)
    ]
    above = float(np.mean(np.concatenate([imaging.difference(c).ravel() > top for c in shown])))
    height, width = shown[0].real.shape[:2]
    small = imaging.embed(shown[0].real, photograph=True).shown
    sentences = [
        "Held-out photographs, the renderings under the same light, and the size of their difference: the mean over "
        "red, green and blue of |real − rendered| in grey levels of 255.",
        f"One colour scale serves all differences and ends at {top} grey levels, {number(255 / top, 3)} times "
        f"magnified; {percent(above, 2)} of the pixels lie above it.",
    ]
    if any(c.linear for c in shown):
        sentences.append(
            "Values are linear in radiance: pictures are shown through the sRGB curve, differences are not."
        )
    sentences.append(f"Images of {width} × {height} pixels, shown at {small[0]} × {small[1]}.")
    if len(shown) < len(content.comparisons):
        sentences.append(f"The first {len(shown)} of {len(content.comparisons)} comparisons.")
    bar = scale_bar(0, top, "grey levels of |real − rendered|", imaging.ERRORS)
    return section("comparisons", "Real against rendered", (figure(bar + "\n".join(rows), " ".join(sentences)),))


def _by_light(comparisons: Sequence[Comparison]) -> list[Comparison]:
    """Comparisons of one light side by side, up to the most that a page of bounded size holds."""
    names = list(dict.fromkeys(c.light for c in comparisons))
    ordered = [c for name in names for c in comparisons if c.light == name]
    return ordered[:MAX_COMPARISONS]


def _comparison_rows(light: str, same: Sequence[Comparison], top: int) -> str:
    """One light: real, rendered and difference in a row; with several models, a column for each of them."""
    parts = [tile("photograph", image(_photograph(same[0].real, same[0]), f"Photograph taken under {light}."), [light])]
    for comparison in same:
        size = imaging.difference(comparison)
        figures = [
            f"MAE {number(comparison.mae, 3)}" if comparison.mae is not None else "",
            f"PSNR {number(comparison.psnr, 4)} dB" if comparison.psnr is not None else "",
            f"SSIM {number(comparison.ssim, 3)}" if comparison.ssim is not None else "",
        ]
        measured = ", ".join(f for f in figures if f)
        found = f"mean {number(float(size.mean()), 3)}, largest {number(float(size.max()), 3)} grey levels"
        rendered = image(
            _photograph(comparison.rendered, comparison), f"Rendering by {comparison.model} under {comparison.light}."
        )
        coloured = image(
            imaging.embed(imaging.colour_scale(size, 0, top, imaging.ERRORS)),
            f"Size of the difference between photograph and {comparison.model} under {comparison.light}: {found}.",
        )
        heading = f"rendered: {comparison.model}"
        if len(same) == 1:
            parts += [tile(heading, rendered, [measured]), tile("size of the difference", coloured, [found])]
        else:
            parts.append(tile(heading, rendered + note(measured) + coloured, [f"difference: {found}"]))
    return tiles(parts, "triple" if len(same) == 1 else "models")


def _photograph(values: ByteImage, comparison: Comparison) -> imaging.Embedded:
    return imaging.embed(imaging.display(values / 255.0) if comparison.linear else values, photograph=True)


def relit_section(content: ReportContent) -> str:
    """Pictures under light that was never there, all with one exposure."""
    if not content.relit:
        return ""
    exposure = imaging.common_exposure([r.image for r in content.relit])
    parts = [_relit_tile(r, exposure) for r in content.relit]
    caption = (
        "Rendered under light that no photograph was taken with. One exposure serves all: a radiance of "
        f"{number(1 / exposure, 3)} is display white, shown through the sRGB curve."
    )
    if any(r.outside is not None and r.outside.any() for r in content.relit):
        caption += (
            " Orange outlines: the light lies outside the sampled region and the nearest measured value is shown."
        )
    return section("relit", "Under new light", (figure(tiles(parts), caption),))


def _relit_tile(relit: Relit, exposure: float) -> str:
    shown = imaging.display(relit.image, exposure)
    said = ""
    if relit.outside is not None and relit.outside.any():
        edges, _ = cv2.findContours(relit.outside.astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(shown, edges, -1, OUTSIDE_RGB, max(1, shown.shape[1] // 320))
        said = f"{percent(float(relit.outside.mean()))} of the image from the nearest measured value"
    return tile(relit.title, image(imaging.embed(shown, photograph=True), f"The object under {relit.title}."), [said])
