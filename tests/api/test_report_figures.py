"""Charts hold the numbers they were given; facets and pixels share their colours; surfaces pass through the lights."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from api.report.content import Coverage, ReflectanceFunction, StageView
from api.report.facets import PALETTE, colour_triplets
from api.report.figures import angles_deg, coverage_figure, speed_figure, stage_figure, triplet_figure
from api.report.pixel_figures import reflectance_map, reflectance_surface
from stage.camera import Camera
from stage.lights import Light
from tests.api.report_content import FACETS, LIGHTS, full, triplets


def traces(figure) -> dict:
    return {trace.name: trace for trace in figure.data}


def test_angles_of_the_axes() -> None:
    azimuth, elevation = angles_deg([[1, 0, 0], [0, 2, 0], [-1, 0, 0], [0, 0, 3], [1, 0, -1]])
    np.testing.assert_allclose(azimuth, [0, 90, 180, 0, 0], atol=1e-12)
    np.testing.assert_allclose(elevation, [0, 0, 0, 90, -45], atol=1e-12)


def test_stage_shows_chosen_lights_in_order_and_the_rest_as_candidates() -> None:
    view = full().stage
    assert view is not None
    shown = traces(stage_figure(view))
    chosen = shown["chosen, in order"]
    assert list(chosen.text) == ["1", "2", "3", "4", "5"]
    np.testing.assert_allclose(np.stack([chosen.x, chosen.y, chosen.z], -1), LIGHTS[list(view.chosen)], rtol=1e-6)
    assert len(shown["candidate"].x) == len(LIGHTS) - len(view.chosen)
    np.testing.assert_allclose(
        [shown["camera"].x[0], shown["camera"].y[0], shown["camera"].z[0]], [0, -0.9, 0.6], atol=1e-6
    )


def test_a_camera_far_off_is_drawn_nearer_and_says_so() -> None:
    camera = Camera.look_at(32, 24, 60, (0, -12, 5))
    name = next(n for n in traces(stage_figure(StageView(LIGHTS, camera=camera))) if n.startswith("camera"))
    assert name == "camera, drawn nearer: 13.00 m away"


def test_a_dense_surface_is_sampled_evenly() -> None:
    surface = np.random.default_rng(0).normal(size=(12_001, 3))
    rgb = np.zeros((12_001, 3), dtype=np.uint8)
    points, colours = StageView(LIGHTS, surface=surface, surface_rgb=rgb).surface_sample()
    assert colours is not None
    assert len(points) == len(colours) == 4001
    np.testing.assert_array_equal(points, surface[::3])


def test_coverage_holds_curve_limits_and_target_of_both_components() -> None:
    coverage = Coverage(((1, 0.4, 0.2), (2, 0.9, 0.5)), 1.0, 0.8, 0.8)
    shown = traces(coverage_figure(coverage))
    np.testing.assert_allclose(shown["diffuse"].y, [40, 90])
    np.testing.assert_allclose(shown["specular"].y, [20, 50])
    assert list(shown["specular"].x) == [1, 2]
    np.testing.assert_allclose(shown["specular, all candidates"].y, [80, 80])
    np.testing.assert_allclose(shown["specular, target"].y, [64, 64])
    assert "specular, target" not in traces(coverage_figure(replace(coverage, target=1.0)))


def test_speed_joins_the_models_that_no_other_beats() -> None:
    rows = [
        {"model": name, "fit_s": seconds, "mae": error}
        for name, seconds, error in (
            ("a", 1.0, 4.0),
            ("b", 2.0, 5.0),
            ("c", 3.0, 2.0),
            ("d", 30.0, 2.0),
            ("e", 50.0, 1.0),
        )
    ]
    rows += [{"model": "unknown", "fit_s": None, "mae": 1.0}, {"model": "instant", "fit_s": 0.0, "mae": 1.0}]
    figure = speed_figure(rows, "fit_s", "time to fit, s")
    assert figure is not None
    best, models = figure.data
    assert list(best.x) == [1.0, 3.0, 50.0]
    assert list(models.text) == ["a", "b", "c", "d", "e"]
    assert speed_figure(rows[:1], "fit_s", "time to fit, s") is None


def test_facets_have_the_colours_of_their_pixels() -> None:
    view = triplets()
    colours = colour_triplets(view.triples)
    mesh = traces(triplet_figure(view, colours))["triplets in use"]
    for place, facet in (((5, 20), FACETS[0]), ((20, 20), FACETS[1])):
        corner = list(zip(mesh.i, mesh.j, mesh.k, strict=True)).index(tuple(sorted(facet)))
        assert mesh.facecolor[corner] == "rgb({},{},{})".format(*colours.picture[place])
    assert not colours.rendered[:3, :3].any()
    assert (colours.picture[:3, :3] == 0).all()
    np.testing.assert_allclose(colours.share, [12 / 24 + 9 / (2 * 759) - 9 / (2 * 768), 0.5], atol=0.02)
    assert colours.share.sum() == pytest.approx(1)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.integers(4, 80))
def test_neighbours_across_an_edge_never_share_a_colour(seed: int, count: int) -> None:
    points = np.random.default_rng(seed).normal(size=(count, 3))
    facets = ConvexHull(points / np.linalg.norm(points, axis=1, keepdims=True)).simplices
    colours = colour_triplets(facets[None])
    assert {tuple(c) for c in colours.rgb.tolist()} <= {tuple(c) for c in PALETTE.tolist()}
    for a in range(len(colours.triples)):
        for b in range(a):
            if len(set(colours.triples[a]) & set(colours.triples[b])) == 2:
                assert colours.rgb[a].tolist() != colours.rgb[b].tolist()


def test_an_image_without_triplets_has_no_colours() -> None:
    colours = colour_triplets(np.full((4, 5, 3), -1))
    assert len(colours.triples) == len(colours.rgb) == 0
    assert not colours.rendered.any()


def test_wanted_light_far_away_is_drawn_outside_the_measured_ones() -> None:
    view = replace(triplets(), wanted=Light(direction=(0, 3, 4)))
    marker = [t for t in triplet_figure(view, colour_triplets(view.triples)).data if t.name == "wanted light"][-1]
    np.testing.assert_allclose([marker.x[0], marker.y[0], marker.z[0]], 1.15 * 0.8 * np.array([0, 0.6, 0.8]), rtol=1e-6)


def linear_function() -> ReflectanceFunction:
    """Radiance that is linear in the azimuthal equidistant map, which linear interpolation reproduces exactly."""
    azimuth, elevation = np.radians(angles_deg(LIGHTS))
    value = 5 + (np.pi / 2 - elevation) * (np.cos(azimuth) + 0.5 * np.sin(azimuth))
    return ReflectanceFunction(LIGHTS, np.repeat(value[:, None], 3, axis=1), (0, 0))


def test_surface_between_the_lights_is_linear_in_the_equidistant_map() -> None:
    figure = reflectance_surface(linear_function())
    assert figure is not None
    surface, dots = figure.data
    azimuth, elevation = np.radians(np.meshgrid(surface.x, surface.y))
    expected = 5 + (np.pi / 2 - elevation) * (np.cos(azimuth) + 0.5 * np.sin(azimuth))
    inside = np.isfinite(surface.z)
    assert inside.mean() > 0.7
    np.testing.assert_allclose(surface.z[inside], expected[inside], atol=1e-5)
    np.testing.assert_allclose(surface.z[inside[:, 0], 0], surface.z[inside[:, 0], -1], atol=1e-5)
    np.testing.assert_allclose(dots.z, linear_function().values[:, 0], rtol=1e-6)


def test_map_shows_nothing_outside_the_lights_and_every_measured_dot() -> None:
    heat, dots = reflectance_map(linear_function()).data
    x, y = np.meshgrid(heat.x, heat.y)
    assert np.isnan(heat.z[np.hypot(x, y) > 76]).all(), "the lowest ring is 75 degrees from the zenith"
    assert np.isfinite(heat.z[np.hypot(x, y) < 60]).all()
    np.testing.assert_allclose(dots.marker.color, linear_function().values[:, 0])


@pytest.mark.parametrize(
    "directions",
    [LIGHTS[:2], np.array([[0, 0, 1.0], [0.6, 0, 0.8], [0.8, 0, 0.6], [-0.6, 0, 0.8]]), np.zeros((4, 3))],
    ids=["two lights", "an arc through the zenith", "no direction"],
)
def test_lights_that_span_no_area_give_dots_alone(directions: np.ndarray) -> None:
    function = ReflectanceFunction(directions, np.ones_like(directions), (0, 0))
    assert reflectance_surface(function) is None
    assert [trace.type for trace in reflectance_map(function).data] == ["scatter"]


def test_lights_that_were_not_measured_are_left_out() -> None:
    function = linear_function()
    values = function.values.copy()
    values[3] = np.nan
    *_, dots = reflectance_map(replace(function, values=values)).data
    assert len(dots.x) == len(LIGHTS) - 1
