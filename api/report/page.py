"""One self-contained HTML page from a `ReportContent`: nothing is fetched when it is read."""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from string import Template

import plotly.offline

from acquisition.dataset import staged_file
from api.report.appendix import counts_section, limits_section, provenance_section, summary_block, timings_section
from api.report.content import ReportContent
from api.report.geometry import coverage_section, reflectance_section, stage_section, triplets_section
from api.report.maps import maps_section
from api.report.markup import text
from api.report.results import comparisons_section, models_section, relit_section

# Results first, then how they came about, then what to know before relying on them.
_SECTIONS = (
    models_section,
    comparisons_section,
    relit_section,
    maps_section,
    stage_section,
    coverage_section,
    triplets_section,
    reflectance_section,
    counts_section,
    timings_section,
    limits_section,
    provenance_section,
)
_HEADING = re.compile(r'<section id="([a-z]+)">\n<h2>(.*?)</h2>')


def write_report(path: str | Path, content: ReportContent) -> None:
    """Write `content` as one self-contained HTML file, wholly or not at all.

    Parameters
    ----------
    path : str or Path
        The file; an existing one is replaced in one step.
    content : ReportContent
        What to show; parts that are None or empty leave no trace.

    Raises
    ------
    InputError
        Where the file cannot be written.
    """
    page = render_page(content)
    with staged_file(Path(path)) as temporary:
        temporary.write_text(page, encoding="utf-8")


def render_page(content: ReportContent) -> str:
    """The page as text. Equal content gives equal text.

    The page carries its style, pictures and scripts; its content security policy forbids it to fetch anything and to
    run any script but its own. plotly.js (about 5 MB) is there only where a chart needs it.
    """
    return assemble(content.title, content.lede, summary_block(content), [make(content) for make in _SECTIONS])


def assemble(title: str, lede: str, summary: str, sections: Sequence[str]) -> str:
    """A page of ready sections, those that are empty left out, with its contents, style and scripts."""
    package = files("api.report")
    headings = [match.groups() for match in map(_HEADING.match, sections) if match]
    contents = "".join(f'<li><a href="#{ident}">{heading}</a></li>' for ident, heading in headings)
    body = "\n".join(part for part in sections if part)
    scripts: list[str] = []
    if "data-chart=" in body:
        scripts = [plotly.offline.get_plotlyjs(), (package / "charts.js").read_text(encoding="utf-8")]
    return Template((package / "page.html").read_text(encoding="utf-8")).substitute(
        title=text(title),
        lede=f'<p class="lede">{text(lede)}</p>' if lede else "",
        style=(package / "page.css").read_text(encoding="utf-8"),
        summary=summary,
        contents=f'<nav aria-label="Contents"><ol>{contents}</ol></nav>' if len(headings) > 2 else "",
        sections=body,
        scripts="\n".join(f"<script>{script}</script>" for script in scripts),
        allowed=" ".join(_hash_source(script) for script in scripts) or "'none'",
    )


def _hash_source(script: str) -> str:
    digest = base64.b64encode(hashlib.sha256(script.encode("utf-8")).digest()).decode("ascii")
    return f"'sha256-{digest}'"
