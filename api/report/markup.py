"""Small pieces of HTML: everything that was not written here is escaped on its way in."""

from __future__ import annotations

import html
import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
import plotly.io

from api.report.imaging import Embedded, colour_ramp_css

NOTHING = "–"


def text(value: object) -> str:
    """Escape for element content and quoted attributes."""
    return html.escape(str(value), quote=True)


def number(value: Any, digits: int = 4) -> str:
    """A number with `digits` significant digits; a dash for None and NaN."""
    if value is None or math.isnan(value):
        return NOTHING
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    if isinstance(value, (int, np.integer)) or value == 0:
        return f"{int(value):,}".replace(",", "\u202f")
    if abs(value) < 1e-5:
        return f"{value:.{digits - 1}e}"
    decimals = max(0, digits - 1 - math.floor(math.log10(abs(value))))
    return f"{value:,.{decimals}f}".replace(",", "\u202f")


def percent(share: float, decimals: int = 1) -> str:
    """A share of 0 to 1 as per cent."""
    return f"{100 * share:.{decimals}f}\u202f%" if math.isfinite(share) else NOTHING


def section(ident: str, heading: str, body: Iterable[str]) -> str:
    """One part of the page, or nothing where `body` has nothing."""
    inner = "\n".join(part for part in body if part)
    return f'<section id="{ident}">\n<h2>{text(heading)}</h2>\n{inner}\n</section>' if inner else ""


def paragraph(sentence: str) -> str:
    """Plain text as a paragraph."""
    return f"<p>{text(sentence)}</p>"


def figure(body: str, caption: str) -> str:
    """Pictures or charts with the words that say what is seen and in which unit; the style sheet numbers them."""
    return f"<figure>\n{body}\n<figcaption>{text(caption)}</figcaption>\n</figure>"


def image(picture: Embedded, alt: str) -> str:
    """An embedded picture with its alternative text; coarse pictures are enlarged pixel by pixel."""
    width, height = picture.shown
    coarse = ' class="coarse"' if width < 200 else ""
    return f'<img src="{picture.uri}" alt="{text(alt)}" width="{width}" height="{height}"{coarse}>'


def tile(heading: str, body: str, notes: Sequence[str] = ()) -> str:
    """One picture of a row: heading above, lines of notes below."""
    return f'<div class="tile"><div class="head">{text(heading)}</div>{body}{"".join(map(note, notes))}</div>'


def note(words: str) -> str:
    """A line of small print, or nothing for no words."""
    return f'<div class="note">{text(words)}</div>' if words else ""


def tiles(parts: Iterable[str], kind: str = "") -> str:
    """A row of tiles that wraps where the window is narrow."""
    return f'<div class="tiles {kind}">' + "\n".join(parts) + "</div>"


def beside(narrow: str, wide: str) -> str:
    """A narrow column of pictures beside a wide part; one above the other where the window is narrow."""
    return f'<div class="beside"><div>{narrow}</div><div>{wide}</div></div>'


def ticks(low: float, high: float) -> list[tuple[float, str]]:
    """Three to eight round values from `low` to `high` > `low`, with labels of equal precision."""
    span = high - low
    power = 10.0 ** math.floor(math.log10(span))
    step = next(s for s in (2 * power, power, power / 2, power / 5) if span / s >= 3 - 1e-9)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    decimals = max(0, -math.floor(math.log10(step) + 1e-9))
    style = f".{decimals}f" if decimals <= 5 else "g"
    return [(k * step, format(k * step, style)) for k in range(first, last + 1)]


def scale_bar(low: float, high: float, unit: str, colormap: int) -> str:
    """A colour scale with labelled ticks, of text and style alone."""
    # Labels lean inwards at both ends, so that none reaches beyond its bar.
    places = [(100 * (value - low) / (high - low), label) for value, label in ticks(low, high)]
    marks = "".join(f'<span style="--at:{x:.2f}%">{label}</span>' for x, label in places)
    ramp = f'<div class="ramp" style="background:{colour_ramp_css(colormap)}"></div>'
    label = f"colour scale from {number(low, 3)} to {number(high, 3)} {unit}"
    return f'<div class="scale" role="img" aria-label="{text(label)}">{ramp}<div class="marks">{marks}</div>' + (
        f'<div class="unit">{text(unit)}</div></div>' if unit else "</div>"
    )


def swatches(entries: Iterable[tuple[Sequence[int], str]]) -> str:
    """A legend of RGB colours and their names."""
    items = (f'<li><i style="background:#{bytes(rgb).hex()}"></i>{text(name)}</li>' for rgb, name in entries)
    return '<ul class="swatches">' + "".join(items) + "</ul>"


def table(headers: Sequence[str], rows: Iterable[Sequence[str]], *, caption: str = "", words: int = 1) -> str:
    """A table of ready HTML cells; the first `words` columns are text, the others numbers set flush right.

    A header may carry its unit after a line break.
    """
    head = "".join(f'<th scope="col"{_numeric(i, words)}>{_header(name)}</th>' for i, name in enumerate(headers))
    body = "\n".join(
        "<tr>"
        + "".join(
            f'<th scope="row">{cell}</th>' if i == 0 else f"<td{_numeric(i, words)}>{cell}</td>"
            for i, cell in enumerate(row)
        )
        + "</tr>"
        for row in rows
    )
    inner = f"<thead><tr>{head}</tr></thead><tbody>\n{body}\n</tbody>"
    # The caption stands outside of what scrolls, or a narrow window would cut it.
    above = f'<p class="caption">{text(caption)}</p>' if caption else ""
    named = f' aria-label="{text(caption)}"' if caption else ""
    return f'{above}<div class="scroll" tabindex="0"><table{named}>{inner}</table></div>'


def details(summary: str, body: str) -> str:
    """A part that is folded away until it is asked for."""
    return f"<details><summary>{text(summary)}</summary>{body}</details>"


def chart(ident: str, plot: go.Figure, label: str, without_script: str = "") -> str:
    """A plotly chart: its data beside an empty box that the page's script fills.

    Parameters
    ----------
    ident : str
        Fixed id of the box, so that equal content gives equal bytes.
    plot : plotly figure
        The chart; its height is the box's.
    label : str
        What is seen, for those who cannot see it.
    without_script : str
        HTML shown where scripts do not run.
    """
    data = str(plotly.io.to_json(plot, engine="json")).replace("<", "\\u003c")
    fallback = (
        without_script or '<p class="note">This chart needs JavaScript; its numbers stand in the table below.</p>'
    )
    return (
        f'<div class="chart" id="{ident}" role="img" aria-label="{text(label)}" '
        f'style="height:{plot.layout.height}px"></div>'
        f'<script type="application/json" data-chart="{ident}">{data}</script><noscript>{fallback}</noscript>'
    )


def _numeric(index: int, words: int) -> str:
    return "" if index < words else ' class="n"'


def _header(name: str) -> str:
    first, _, unit = name.partition("\n")
    return text(first) + (f"<small>{text(unit)}</small>" if unit else "")
