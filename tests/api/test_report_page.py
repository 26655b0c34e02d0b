"""The page is whole, self-contained, readable without scripts, and equal for equal content (K17-K20, K22, M17, M22)."""

from __future__ import annotations

import base64
import hashlib
import re
from dataclasses import fields, replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from api.report import ReportContent, write_report
from api.report.content import Comparison, MapView, StageView, TripletView
from api.report.imaging import difference_scale
from api.report.page import render_page
from api.report.results import MAX_COMPARISONS
from stage.errors import InputError
from stage.lights import Light
from tests.api.report_content import SIZE, comparison, full, picture

VOID = {"meta", "img", "br", "link", "hr", "input"}
SECTIONS = {
    "models": "models",
    "comparisons": "comparisons",
    "relit": "relit",
    "maps": "maps",
    "stage": "stage",
    "coverage": "coverage",
    "triplets": "triplets",
    "reflectance": "pixel",
    "counts": "counts",
    "timings": "timings",
    "limits": "limits",
    "provenance": "provenance",
}


class Page(HTMLParser):
    """Elements, their attributes and the words of a page; refuses a tag that is closed out of turn."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.elements: list[tuple[str, dict[str, str]]] = []
        self.words: list[str] = []
        self.scripts: list[str] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, {name: value or "" for name, value in attrs}))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open[-1:] == ["script"]:
            self.scripts.append(data)
        elif self.open[-1:] != ["style"]:
            self.words.append(data)

    def named(self, tag: str) -> list[dict[str, str]]:
        return [attributes for name, attributes in self.elements if name == tag]

    @property
    def text(self) -> str:
        """Words of the page with single plain spaces between them."""
        return " ".join(" ".join(self.words).split())


@pytest.fixture(scope="module")
def html() -> str:
    return render_page(full())


@pytest.fixture(scope="module")
def page(html: str) -> Page:
    return Page(html)


def test_every_section_is_there_and_in_the_contents(page: Page) -> None:
    sections = [attributes["id"] for attributes in page.named("section")]
    assert sorted(sections) == sorted(SECTIONS.values())
    assert [attributes["href"] for attributes in page.named("a")] == [f"#{ident}" for ident in sections]


def test_every_picture_and_chart_says_what_is_seen(page: Page) -> None:
    images = page.named("img")
    assert len(images) >= 14
    assert all(len(attributes["alt"]) > 10 for attributes in images)
    charts = [attributes for attributes in page.named("div") if attributes.get("class") == "chart"]
    assert [c["id"] for c in charts] == [
        *("chart-fit-s", "chart-stage", "chart-coverage", "chart-triplets", "chart-pixel-map", "chart-pixel-surface")
    ]
    assert all(len(attributes["aria-label"]) > 20 for attributes in charts)
    assert page.text.count("Figure") == 0, "figures are numbered by the style sheet alone"
    assert len(page.named("figure")) == len(page.named("figcaption")) == 8


def test_nothing_is_fetched(page: Page) -> None:
    for _, attributes in page.elements:
        for name in ("src", "href", "data", "poster", "srcset", "action"):
            assert attributes.get(name, "#").startswith(("#", "data:image/")), attributes
    assert not page.named("link")
    assert not page.named("base")
    assert not page.named("iframe")


def test_policy_allows_no_network_and_only_the_scripts_of_the_page(page: Page, html: str) -> None:
    policy = next(a["content"] for a in page.named("meta") if a.get("http-equiv") == "Content-Security-Policy")
    assert policy.startswith("default-src 'none'; img-src data: blob:;")
    run: list[str] = re.findall(r"<script>(.*?)</script>", html, re.S)
    assert len(run) == 2
    for source in run:
        assert base64.b64encode(hashlib.sha256(source.encode()).digest()).decode() in policy
    allowed = re.search(r"script-src ([^;]*);", policy)
    assert allowed is not None
    assert "unsafe" not in allowed[1]
    assert 'plotlyServerURL: ""' in run[1], "plotly's button that uploads a chart stays off"


def test_equal_content_gives_equal_bytes(tmp_path: Path, html: str) -> None:
    write_report(tmp_path / "a.html", full())
    write_report(tmp_path / "b.html", full())
    assert (tmp_path / "a.html").read_bytes() == (tmp_path / "b.html").read_bytes() == html.encode()
    assert len(html) < 8e6


def test_plotly_is_there_once_and_only_for_charts(html: str) -> None:
    assert html.count("plotly.js v") == 1
    plain = render_page(replace(full(), stage=None, coverage=None, triplets=None, reflectance=None, models=()))
    assert "<script" not in plain
    assert "script-src 'none'" in plain
    assert len(plain) < 1e6


@pytest.mark.parametrize("part", sorted(SECTIONS))
def test_a_part_without_data_leaves_no_trace(part: str) -> None:
    content = full()
    without = replace(content, **{part: getattr(ReportContent(title=""), part)})
    ident = SECTIONS[part]
    plain = render_page(
        replace(without, **{name: getattr(ReportContent(title=""), name) for name in _charted() - {part}})
    )
    assert f'id="{ident}"' not in plain
    assert f'href="#{ident}"' not in plain


def _charted() -> set[str]:
    """Parts that need plotly.js; left out where its 5 MB would only be parsed again."""
    return {"stage", "coverage", "triplets", "reflectance", "models"}


def test_a_title_is_enough() -> None:
    page = Page(render_page(ReportContent(title="Nothing yet")))
    assert page.text == "Nothing yet Nothing yet"
    assert not page.named("section")
    assert not page.named("nav")


def test_names_cannot_become_markup() -> None:
    evil = '<script>alert("x")</script>&\'"'
    content = ReportContent(
        title=evil,
        lede=evil,
        summary=((evil, evil),),
        comparisons=(comparison(evil, evil),),
        maps=MapView({evil: np.ones(SIZE)}, evil),
        models=({"model": evil, evil: evil, "mae": 1.0},),
        models_scale=evil,
        timings={evil: 1.0},
        counts={evil: 2},
        limits=(evil,),
        provenance={evil: evil},
    )
    page = Page(render_page(content))
    assert not page.named("script")
    assert page.text.count('alert("x")') >= 12


def test_names_in_charts_cannot_end_their_script(html: str) -> None:
    evil = "</script><script>alert(1)</script>"
    rows = tuple({"model": evil, "mae": m, "fit_s": t} for m, t in ((1.0, 2.0), (2.0, 1.0)))
    page = Page(render_page(ReportContent(title="t", models=rows)))
    assert len(page.named("script")) == 3
    assert not any(source.startswith("alert") for source in page.scripts)


def test_table_shows_figures_units_and_the_best(html: str, page: Page) -> None:
    assert "MAE grey levels PSNR dB" in page.text
    assert "<strong>4.00</strong>" in html
    assert "<strong>9.00</strong>" not in html
    row = next(row for row in re.findall(r"<tr>.*?</tr>", html) if ">ptm<" in row)
    assert "–" in row, "a figure that is not known is a dash"
    odd = {"model": "m", "mae": float("nan"), "note": "needs normals", "outside": 0.125, "statistics": {"nested": 1}}
    only = render_page(ReportContent(title="t", models=(odd,)))
    assert "<strong>" not in only
    assert "needs normals" in only
    assert "% of object" in only
    assert ">12.5<" in only
    assert "nested" not in only


def test_differences_on_the_page_are_those_of_the_images() -> None:
    rng = np.random.default_rng(1)
    pairs = [
        Comparison(f"light {k}", "m", picture(k), rng.integers(0, 256, (*SIZE, 3), dtype=np.uint8)) for k in range(3)
    ]
    sizes = [np.abs(p.real.astype(float) - p.rendered.astype(float)).mean(axis=-1) for p in pairs]
    page = Page(render_page(ReportContent(title="t", comparisons=tuple(pairs))))
    for size in sizes:
        assert f"mean {size.mean():.1f}, largest {size.max():.0f} grey levels" in page.text
    top = difference_scale(pairs)
    above = 100 * np.mean([size > top for size in sizes])
    assert np.percentile(sizes, 99.5) <= top
    assert f"ends at {top} grey levels" in page.text
    assert f"{above:.2f} % of the pixels lie above it" in page.text
    label = next(a["aria-label"] for a in page.named("div") if a.get("class") == "scale")
    assert label == f"colour scale from 0 to {top} grey levels of |real − rendered|"


def test_evaluated_figures_are_shown_as_they_are() -> None:
    page = Page(render_page(ReportContent(title="t", comparisons=(comparison(shift=4),))))
    assert "MAE 4.00, PSNR 31.00 dB, SSIM 0.900" in page.text
    assert "mean 4.00, largest 4.00 grey levels" in page.text


def test_linear_values_are_shown_through_the_srgb_curve_and_say_so() -> None:
    linear, stored = (
        Page(render_page(ReportContent(title="t", comparisons=(comparison(linear=flag),)))) for flag in (True, False)
    )
    assert "sRGB curve" in linear.text
    assert "sRGB curve" not in stored.text
    assert linear.named("img")[0]["src"] != stored.named("img")[0]["src"]
    assert linear.named("img")[2]["src"] == stored.named("img")[2]["src"]


def test_comparisons_of_one_light_share_its_photograph_and_their_number_is_bounded() -> None:
    many = tuple(comparison(f"light {k}", model) for model in ("a", "b") for k in range(20))
    page = Page(render_page(ReportContent(title="t", comparisons=many)))
    alts = [a["alt"] for a in page.named("img")]
    assert sum(alt.startswith("Photograph") for alt in alts) == MAX_COMPARISONS // 2
    assert sum(alt.startswith("Rendering") for alt in alts) == MAX_COMPARISONS
    assert f"The first {MAX_COMPARISONS} of 40 comparisons" in page.text


def test_maps_with_gaps_are_shown_and_counted() -> None:
    values = np.linspace(0, 1, SIZE[0] * SIZE[1]).reshape(SIZE)
    values[3, 4], values[5, 6], values[7, 8] = np.nan, np.inf, -np.inf
    colour = np.repeat(values[..., None], 3, axis=-1)
    mask = np.ones(SIZE, dtype=bool)
    maps = {"roughness": values, "diffuse": colour, "normals": colour, "empty": np.full(SIZE, np.nan)}
    page = Page(render_page(ReportContent(title="t", maps=MapView(maps, "m", mask))))
    missing = 3 * 3 + SIZE[0] * SIZE[1]
    assert f"Grey: not finite, {missing} values" in page.text
    assert "no value is finite" in page.text


def test_angles_are_read_in_degrees() -> None:
    view = MapView({"nearest_half_angle": np.full(SIZE, np.pi / 6)})
    assert "median 30.0, range 30.0 to 30.0" in Page(render_page(ReportContent(title="t", maps=view))).text


@pytest.mark.parametrize("in_maps", [True, False])
def test_what_was_measured_directly_is_counted_on_the_object(in_maps: bool) -> None:
    mask = np.zeros(SIZE, dtype=bool)
    mask[:, :10] = True
    estimated = np.zeros(SIZE, dtype=bool)
    estimated[:, 4:] = True
    maps = {"roughness": np.ones(SIZE), "estimated": estimated.astype(float)}
    view = MapView(maps, "m", mask) if in_maps else MapView({"roughness": np.ones(SIZE)}, "m", mask, estimated)
    text = Page(render_page(ReportContent(title="t", maps=view))).text
    assert "measured directly, 60.0 %" in text
    assert "filled in, 40.0 %" in text


def test_counts_say_their_share_where_the_total_is_known(page: Page) -> None:
    assert "shadowed: the light is hidden or below the surface, left out of fits 250 25.00 %" in page.text
    text = Page(render_page(ReportContent(title="t", counts={"saturated": 7.0, "share_estimated": 0.5}))).text
    assert text.endswith("left out of fits 7 pixels measured directly 50.00 %")
    model = {"observations": 8.0, "observations_dark": 2.0, "facets": 2.5}
    text = Page(render_page(ReportContent(title="t", counts=model))).text
    assert text.endswith("dark: too little light to tell, left out of fits 2 25.00 % facets 2.500")


def test_directions_without_a_plan_are_shown_too() -> None:
    directions = np.array([[0, 0, 1.0], [0.6, 0, 0.8], [0, 0.6, 0.8]])
    triples = np.broadcast_to([0, 1, 2], (*SIZE, 3))
    view = TripletView(triples, directions, np.array([[0, 1, 2]]), Light(direction=(0.1, 0.1, 1)), True)
    text = Page(render_page(ReportContent(title="t", stage=StageView(directions, (), True), triplets=view))).text
    assert "3 lights as directions (unit vectors)" in text
    assert "every pixel has the same triplet" in text


def test_a_failed_write_leaves_what_was_there(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="missing"):
        write_report(tmp_path / "missing" / "report.html", ReportContent(title="t"))
    (tmp_path / "report.html").write_text("old")
    broken = replace(ReportContent(title="t"), timings={"plan": "soon"})
    with pytest.raises(TypeError):
        write_report(tmp_path / "report.html", broken)
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]
    assert (tmp_path / "report.html").read_text() == "old"


def test_every_optional_part_of_the_content_is_a_section_or_above_them() -> None:
    above = {"title", "lede", "summary", "models_scale"}
    assert {field.name for field in fields(ReportContent)} == above | set(SECTIONS)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: StageView(np.zeros((3, 2))), "StageView.lights"),
        (lambda: StageView(np.zeros((3, 3)), (3,)), "StageView.chosen"),
        (lambda: StageView(np.zeros((3, 3)), surface=np.zeros((4, 3)), surface_rgb=picture()[0, :3]), "surface_rgb"),
        (lambda: Comparison("l", "m", picture(), picture()[1:]), "Comparison.rendered"),
        (lambda: MapView({"a": np.zeros((2, 2)), "b": np.zeros((2, 3))}), "one size"),
    ],
)
def test_content_of_the_wrong_shape_is_refused(make, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()
