"""The page and the picture of a plan: whole, self-contained, true to the plan, and readable without scripts."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

from api.plan_report import coverage_maps, plan_content, target_traces
from api.report.picture import WIDTH
from api.report.plan_content import CoverageMaps, Lack, PlanContent, PlanRow, Trace
from api.report.plan_figures import KNOWN, colours, stepped
from api.report.plan_maps import LACKS, NONE_YET, plan_maps
from api.report.plan_page import render_plan_page, write_plan_report
from api.report.plan_picture import plan_picture, write_plan_picture
from api.surface_source import surface_of_mesh
from stage.camera import Camera
from stage.errors import InputError
from stage.lights import Light, dome
from stage.measurability import Measurability, measurability
from stage.planning import PlanningTask, plan
from stage.planning.cost import time_curve
from stage.planning.learning_cost import Learnt
from tests.api.plan_page_content import MASK, SIZE, full, maps
from tests.api.test_report_page import Page

SECTIONS = {
    "warnings": ("warnings",),
    "plans": ("methods", "coverage"),
    "maps": ("maps",),
    "stage": ("stage",),
    "lights_by_target": ("targets",),
    "provenance": ("provenance",),
}
EMPTY = PlanContent(title="")


@pytest.fixture(scope="module")
def html() -> str:
    return render_plan_page(full())


@pytest.fixture(scope="module")
def page(html: str) -> Page:
    return Page(html)


# -- the page ---------------------------------------------------------------------------------------------------------


def test_every_section_is_there_and_in_the_contents(page: Page) -> None:
    sections = [attributes["id"] for attributes in page.named("section")]
    assert sorted(sections) == sorted([*(one for ids in SECTIONS.values() for one in ids), "time"])
    assert [attributes["href"] for attributes in page.named("a")] == [f"#{ident}" for ident in sections]


def test_every_picture_and_chart_says_what_is_seen(page: Page) -> None:
    assert all(len(attributes["alt"]) > 10 for attributes in page.named("img"))
    charts = [attributes for attributes in page.named("div") if attributes.get("class") == "chart"]
    assert [c["id"] for c in charts] == [
        *("chart-stage", "chart-coverage-diffuse", "chart-coverage-specular"),
        *("chart-targets", "chart-times", "chart-errors"),
    ]
    assert all(len(attributes["aria-label"]) > 20 for attributes in charts)
    assert len(page.named("figure")) == len(page.named("figcaption")) == 6


def test_nothing_is_fetched(page: Page, html: str) -> None:
    for _, attributes in page.elements:
        for name in ("src", "href", "data", "poster", "srcset", "action"):
            assert attributes.get(name, "#").startswith(("#", "data:image/")), attributes
    assert not page.named("link")
    assert not page.named("iframe")
    policy = next(a["content"] for a in page.named("meta") if a.get("http-equiv") == "Content-Security-Policy")
    assert policy.startswith("default-src 'none'; img-src data: blob:;")
    assert html.count("plotly.js v") == 1
    assert len(html) < 8e6


@pytest.mark.parametrize("part", sorted(SECTIONS))
def test_a_part_without_data_leaves_no_trace(part: str) -> None:
    plain = render_plan_page(replace(full(), **{part: getattr(EMPTY, part)}))
    for ident in SECTIONS[part]:
        assert f'id="{ident}"' not in plain
        assert f'href="#{ident}"' not in plain


def test_the_time_section_holds_either_chart() -> None:
    for missing in ("seconds_by_target", "error_by_seconds"):
        assert 'id="time"' in render_plan_page(replace(full(), **{missing: ()}))
    assert 'id="time"' not in render_plan_page(replace(full(), seconds_by_target=(), error_by_seconds=()))


def test_a_title_is_enough_and_needs_no_script() -> None:
    page = Page(render_plan_page(PlanContent(title="Nothing yet")))
    assert page.text == "Nothing yet Nothing yet"
    assert not page.named("script")


def test_names_cannot_become_markup() -> None:
    evil = '</script><script>alert("x")</script>&\'"'
    content = replace(
        full(),
        title=evil,
        lede=evil,
        summary=((evil, evil),),
        warnings=(evil,),
        plans=(PlanRow(evil, 1, 1, evil, ((1, 0.5, 0.5),), 1.0, {evil: 1.0}, True),),
        lights_by_target=(Trace(evil, (0.5, 1.0), (1, 2)),),
        provenance={evil: evil},
    )
    page = Page(render_plan_page(content))
    assert not any(source.startswith("alert") for source in page.scripts)
    assert len([s for s in page.named("script") if not s.get("type")]) == 2


def test_the_table_tells_count_bound_gap_and_seconds(html: str, page: Page) -> None:
    methods = html[html.index('<section id="methods">') : html.index('<section id="maps">')]
    _, optimal, greedy = re.findall(r"<tr>.*?</tr>", methods)
    cells = [re.sub("<.*?>", "", cell) for cell in re.findall(r"<t[hd].*?</t[hd]>", optimal)]
    assert cells == ["optimal", "integer programme", "3", "3", "0", "95.00\u202f%", "62.00\u202f%", "12 s", "0.01000"]
    cells = [re.sub("<.*?>", "", cell) for cell in re.findall(r"<t[hd].*?</t[hd]>", greedy)]
    assert cells == ["greedy", "linear relaxation", "5", "3", "2", "96.00\u202f%", "64.00\u202f%", "–", "–"]
    assert "<strong>optimal</strong>" in html
    assert "seconds of proof" in page.text
    assert "12.0 % of the object's pixels have no diffuse-only light." in page.text


def test_equal_content_gives_equal_bytes_and_a_failed_write_leaves_what_was_there(tmp_path: Path, html: str) -> None:
    write_plan_report(tmp_path / "a.html", full())
    assert (tmp_path / "a.html").read_bytes() == html.encode()
    for write in (write_plan_report, write_plan_picture):
        with pytest.raises(InputError, match="missing"):
            write(tmp_path / "missing" / "plan", full())
    assert [p.name for p in tmp_path.iterdir()] == ["a.html"]


# -- the maps ---------------------------------------------------------------------------------------------------------


def test_legends_count_the_pixels_of_the_object() -> None:
    diffuse, specular, lacks = plan_maps(maps())
    assert [words for _, words in lacks.legend] == [f"{name}, 20.0\u202f%" for _, name in LACKS.values()]
    # no diffuse-only light, neither and no surface are three columns in five; the views go from 0 to 19 row by row
    assert [words for _, words in diffuse.legend] == [
        "too few candidates show it, 60.0\u202f%",
        *("none yet, 2.0\u202f%", "1, 2.0\u202f%", "2 to 3, 4.0\u202f%", "4 to 7, 8.0\u202f%"),
        *("8 to 15, 16.0\u202f%", "16 or more, 8.0\u202f%"),
    ]
    assert [words for _, words in specular.legend][:4] == [
        "too few candidates show it, 60.0\u202f%",
        *("none yet, 2.0\u202f%", "1: not enough, 2.0\u202f%", "2, 2.0\u202f%"),
    ]


def test_pictures_are_cut_to_the_object_and_painted_by_the_legend() -> None:
    diffuse = plan_maps(maps())[0]
    assert diffuse.rgb.shape == (22, 22, 3)
    np.testing.assert_array_equal(diffuse.mask, MASK[4:26, 9:31])
    painted = {tuple(colour) for colour in diffuse.rgb[diffuse.mask].tolist()}
    assert painted == {colour for colour, _ in diffuse.legend}
    assert ((diffuse.rgb == NONE_YET).all(-1) & diffuse.mask).sum() == 8
    nothing = np.zeros(SIZE, dtype=bool)
    assert plan_maps(replace(maps(), mask=nothing))[0].legend == ()


def test_views_and_lacks_are_those_of_the_bits() -> None:
    rng = np.random.default_rng(0)
    diffuse, specular = rng.random((2, 11, int(MASK.sum()))) < 0.15
    seen = Measurability.from_arrays(diffuse, specular)
    without = np.ones(seen.pixels, dtype=bool)
    without[7] = False
    chosen = [3, 9, 10]
    found = coverage_maps(MASK, replace(seen, seen=without), chosen)
    np.testing.assert_array_equal(found.diffuse[MASK], diffuse[chosen].sum(0))
    np.testing.assert_array_equal(found.specular[MASK], specular[chosen].sum(0))
    assert not found.diffuse[~MASK].any()
    lack = found.lack[MASK]
    assert lack[7] == Lack.SURFACE
    dull, few = ~diffuse.any(0) & without, (specular.sum(0) < 2) & without
    np.testing.assert_array_equal(lack == Lack.BOTH, dull & few)
    np.testing.assert_array_equal(lack == Lack.DIFFUSE, dull & ~few)
    np.testing.assert_array_equal(lack == Lack.HIGHLIGHTS, ~dull & few)


# -- the charts -------------------------------------------------------------------------------------------------------


def test_a_method_has_one_colour_in_all_charts() -> None:
    assert colours(["greedy", "optimal"]) == [KNOWN["greedy"], KNOWN["optimal"]]
    named = colours(["time", "optimal", "next"])
    assert len(set(named)) == 3
    assert named[1] == KNOWN["optimal"]
    assert len(colours(["static", *map(str, range(9))])) == 10


def test_stairs_never_promise_more_than_was_found() -> None:
    plan_line = stepped(Trace("plan", (0.5, 0.8), (2, 5)), early=True)
    assert list(zip(plan_line.x, plan_line.y, strict=True)) == [(0.5, 2), (0.5, 5), (0.8, 5)]
    bound = stepped(Trace("bound", (0.5, 0.8), (1, 4), True), early=True)
    assert list(zip(bound.x, bound.y, strict=True)) == [(0.5, 1), (0.8, 1), (0.8, 4)]


# -- the picture ------------------------------------------------------------------------------------------------------


def test_picture_is_a_png_of_fixed_width(tmp_path: Path) -> None:
    write_plan_picture(tmp_path / "plan.png", full())
    image = cv2.imread(str(tmp_path / "plan.png"))
    np.testing.assert_array_equal(image[..., ::-1], plan_picture(full()))
    assert image.shape[1] == WIDTH
    assert 900 < image.shape[0] < 2000
    for missing in ("maps", "plans", "lights_by_target", "summary"):
        less = plan_picture(replace(full(), **{missing: getattr(EMPTY, missing)}))
        assert less.shape[0] <= image.shape[0]
    assert plan_picture(PlanContent(title="only a title " * 30)).shape[1] == WIDTH


# -- from plans -------------------------------------------------------------------------------------------------------


def test_content_of_a_planned_sphere() -> None:
    camera = Camera.look_at(48, 36, 90.0, (0.0, -0.6, 0.6))
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.1)
    surface = surface_of_mesh(np.asarray(ball.vertices), np.asarray(ball.faces), camera)
    lights = [Light(position=light.position) for light in dome(6, np.radians([20, 50]), 0.7)]
    seen = measurability(
        surface.points, surface.normals, surface.view, lights, mask=surface.mask, occluder=surface.occluder
    )
    task = PlanningTask(lights, seen, target=0.9, time_limit_s=1.0)
    plans = [plan(method, task) for method in ("optimal", "greedy")]
    times = time_curve(task, np.ones((13, 13)) - np.eye(13), 0.5, [0.5, 0.9])
    content = plan_content(
        lights,
        surface,
        seen,
        plans,
        target=0.9,
        warnings=("one more",),
        seconds={"optimal": 7.0},
        lights_by_target=target_traces({"optimal": [(0.5, 3)]}, [(0.5, 2)]),
        times=times,
        learnt={"information": [Learnt((1,), 2.0, 0.5)], "none": []},
        provenance={"command": "plan"},
    )
    assert content.stage is not None
    assert content.stage.chosen == tuple(plans[0].lights)
    assert content.maps is not None
    assert content.maps.mask.sum() == seen.pixels
    share = np.mean(content.maps.diffuse[surface.mask] > 0)
    assert share == pytest.approx(plans[0].coverage["diffuse"])
    assert np.mean(content.maps.specular[surface.mask] > 1) == pytest.approx(plans[0].coverage["specular"])
    assert [(row.method, row.chosen, row.seconds) for row in content.plans] == [
        ("optimal", True, 7.0),
        ("greedy", False, None),
    ]
    assert "one more" in content.warnings
    assert [trace.name for trace in content.seconds_by_target] == ["fewest lights", "least time", "proved: at least"]
    assert [trace.name for trace in content.error_by_seconds] == ["information"]
    assert content.provenance["command"] == "plan"
    assert "12 candidate lights" in content.lede
    Page(render_plan_page(content))


def test_a_plan_without_a_surface_has_lights_and_no_maps() -> None:
    lights = dome(6, [0.5], 1.0)
    content = plan_content(lights, None, None, [plan("farthest", PlanningTask(lights, count=3))])
    assert content.maps is None
    assert content.limits is None
    assert content.summary == (("lights", "3 of 6"),)
    text = Page(render_plan_page(content)).text
    assert "Coverage" not in text
    mixed = [*lights, Light(direction=(0, 0, 1))]
    assert plan_content(mixed, None, None, [plan("random", PlanningTask(mixed, count=3))]).stage is None


# -- bad input --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: CoverageMaps(MASK, np.zeros((2, 2), np.uint8), maps().specular, maps().lack), "CoverageMaps.diffuse"),
        (lambda: Trace("t", (1.0,), ()), "Trace 't'.*got 1 and 0"),
        (lambda: Trace("t", (), ()), "at least one"),
        (lambda: Trace("t", (1.0,), (np.nan,)), "finite"),
        (lambda: Trace("t", (1.0, 0.5), (1.0, 1.0)), "must not fall"),
    ],
)
def test_content_of_the_wrong_shape_is_refused(make, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()
