"""What stands at the edges of a report: figures to be read first, time, counts, limits and where it came from."""

from __future__ import annotations

import math

from api.report.content import ReportContent
from api.report.markup import number, percent, section, table, text

TOTAL = "observations"
_WHOLES = (TOTAL, "object_pixels")

_COUNT_LABELS = {
    "object_pixels": "pixels on the object",
    TOTAL: "observations: pixels on the object × lights",
    "neither": "neither diffuse only nor strongly specular",
    "diffuse_only": "diffuse only: half angle above the upper threshold",
    "specular": "strongly specular: half angle below the lower threshold",
    "saturated": "saturated: at or above the clipping level, left out of fits",
    "dark": "dark: too little light to tell, left out of fits",
    "shadowed": "shadowed: the light is hidden or below the surface, left out of fits",
    "without_surface": "without surface: no normal is known, left out of fits",
    "outside": "outside: the light lies outside the sampled region, nearest measured value used",
}
_SHARES = {
    "share_estimated": "pixels measured directly",
    "share_never_seen": "pixels that no usable light reached",
    "share_specular_known": "pixels whose specular part is known",
}


def summary_block(content: ReportContent) -> str:
    """The figures to be read first, as cards."""
    if not content.summary:
        return ""
    cards = "".join(
        f'<div class="card"><dt>{text(label)}</dt><dd>{text(value)}</dd></div>' for label, value in content.summary
    )
    return f'<dl class="cards">{cards}</dl>'


def timings_section(content: ReportContent) -> str:
    """Seconds by step, with bars."""
    steps = {name: seconds for name, seconds in content.timings.items() if math.isfinite(seconds)}
    if not steps:
        return ""
    total = sum(steps.values())
    longest = max(steps.values()) or 1.0
    rows = [
        [text(name), f'<span class="bar" style="width:{100 * seconds / longest:.1f}%"></span>', number(seconds, 3)]
        for name, seconds in steps.items()
    ]
    rows.append(["<strong>all steps</strong>", "", f"<strong>{number(total, 3)}</strong>"])
    return section("timings", "Where the time went", (table(["step", "", "time\ns"], rows, words=2),))


def counts_section(content: ReportContent) -> str:
    """How many observations were left out, and why."""
    if not content.counts:
        return ""
    total = content.counts.get(TOTAL, 0)
    rows = []
    for key, value in content.counts.items():
        kind = key.removeprefix(TOTAL + "_")
        if key in _SHARES:
            rows.append([text(_SHARES[key]), "", percent(value, 2)])
        else:
            label = _COUNT_LABELS.get(kind, kind.replace("_", " "))
            count = number(round(value)) if float(value).is_integer() else number(value)
            of_total = total and kind in _COUNT_LABELS and kind not in _WHOLES
            rows.append([text(label), count, percent(value / total, 2) if of_total else ""])
    return section("counts", "Observations", (table(["what", "count", "share"], rows),))


def limits_section(content: ReportContent) -> str:
    """What the models cannot show (M23)."""
    items = "".join(f"<li>{text(sentence)}</li>" for sentence in content.limits)
    return section("limits", "Limits of the models", (f"<ul>{items}</ul>",)) if items else ""


def provenance_section(content: ReportContent) -> str:
    """Command, versions, date and sources."""
    pairs = "".join(f"<dt>{text(key)}</dt><dd>{text(value)}</dd>" for key, value in content.provenance.items())
    return section("provenance", "Provenance", (f'<dl class="facts">{pairs}</dl>',)) if pairs else ""
