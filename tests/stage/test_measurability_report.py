from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from stage.expected_reflectance import ExpectedReflectance
from stage.lights import Light, dome
from stage.measurability import Criterion, HalfAngleCriterion, LobeCriterion, Measurability, measurability

Array = NDArray[np.float64]
PUBLISHED = HalfAngleCriterion()


def ball(size: int = 121) -> tuple[Array, NDArray[np.bool_]]:
    """Normals of a ball seen from far above, and where it is."""
    x, y = np.meshgrid(np.linspace(-1, 1, size), np.linspace(-1, 1, size))
    mask = x**2 + y**2 < 1
    return np.stack([x, y, np.sqrt(np.where(mask, 1 - x**2 - y**2, 0))], -1), mask


def hemisphere(rings: int, per_ring: int) -> list[Light]:
    """Distant lights all over the upper half of the sky."""
    heights = np.arcsin((np.arange(rings) + 0.5) / rings)
    return [Light(direction=light.position) for light in dome(per_ring, heights, 1.0)]


def of_ball(lights: list[Light], criterion: Criterion) -> Measurability:
    normals, mask = ball()
    return measurability(None, normals, [0, 0, 1], lights, mask=mask, criterion=criterion)


@pytest.mark.parametrize("above_deg", [50.0, 60.0, 75.0])
def test_a_ball_has_no_diffuse_only_light_within_a_disc(above_deg: float) -> None:
    # a half angle is at most 45 degrees and half the slant, so what is seen at less than 2 above - 90 degrees has none;
    # seen from far away, the slant's sine is the radius in the picture
    criterion = HalfAngleCriterion(float(np.radians(above_deg)))
    report = of_ball(hemisphere(16, 40), criterion).report()
    closed_form = np.sin(np.radians(2 * above_deg - 90)) ** 2
    assert_allclose(report.share(report.no_diffuse), closed_form, atol=0.04)
    assert report.share(report.no_diffuse) > closed_form - 0.002


def test_with_sixty_lights_it_is_a_third_of_the_ball_and_by_the_lobe_nothing() -> None:
    lights = hemisphere(5, 12)
    published, lobe = (of_ball(lights, criterion).report() for criterion in (PUBLISHED, LobeCriterion()))
    assert 0.25 < published.share(published.no_diffuse) < 0.4
    assert lobe.no_diffuse == 0
    assert published.sentences()[0].endswith(
        "of the object's pixels have no diffuse-only light among the 60 candidates; with a threshold of 60 degrees no "
        "light gives one to what is seen at less than 30 degrees, and judging by the expected lobe may."
    )
    assert not any("diffuse-only" in sentence for sentence in lobe.sentences())


def test_counts_by_hand() -> None:
    marks = np.array([[1, 0, 0, 0, 1], [0, 0, 0, 0, 0]], bool), np.array([[0, 1, 1, 0, 1], [0, 0, 1, 0, 1]], bool)
    report = Measurability.from_arrays(*marks).report()
    assert (report.lights, report.pixels, report.unseen) == (2, 5, 0)
    assert (report.no_diffuse, report.no_specular, report.one_specular, report.unmeasured) == (3, 2, 1, 1)
    assert report.shares() == {
        "unseen": 0.0, "no_diffuse": 0.6, "no_specular": 0.4, "one_specular": 0.2, "unmeasured": 0.2
    }  # fmt: skip
    assert report.sentences() == [
        "20.0 % of the object's pixels are measured by none of the 2 candidates.",
        "60.0 % of the object's pixels have no diffuse-only light among the 2 candidates.",
        "40.0 % of the object's pixels show a strong highlight to none of the 2 candidates.",
        "20.0 % of the object's pixels show a strong highlight to one candidate only, by which strength and roughness "
        "cannot be told apart.",
    ]


def test_what_has_no_surface_is_counted_apart() -> None:
    normals = np.tile([0.0, 0.0, 1.0], (1000, 1))
    points = np.zeros((1000, 3))
    normals[0], normals[1], points[2] = 0, [0, 0, -1], np.nan
    lights = [Light(position=(1.9 * x, 0.0, 1.0)) for x in (-1, -0.1, 0.1, 1)]
    report = measurability(points, normals, [0, 0, 1], lights).report()
    assert (report.unseen, report.no_diffuse, report.no_specular, report.unmeasured) == (3, 0, 0, 0)
    assert report.sentences() == [
        "0.3 % of the object's pixels have no surface, or one that faces away from the camera: nothing measures them."
    ]


def test_nothing_amiss_says_nothing() -> None:
    everything = np.ones((2, 3), bool)
    assert Measurability.from_arrays(everything, everything).report().sentences() == []


def test_where_no_highlight_is_expected_none_is_missed() -> None:
    matte = LobeCriterion(ExpectedReflectance(specular=0.0))
    report = of_ball(hemisphere(5, 12), matte).report()
    assert report.no_diffuse == report.unmeasured == 0
    assert report.no_specular == report.pixels
    assert report.sentences() == ["No highlight is expected of this material, so none is planned for."]


def test_a_rough_surface_hears_why_it_has_no_diffuse_only_light() -> None:
    rough = LobeCriterion(ExpectedReflectance(roughness_rad=float(np.radians(30))))
    [sentence] = of_ball(hemisphere(5, 12), rough).report().sentences()
    assert (
        "have no diffuse-only light among the 60 candidates, because the expected lobe of 30 degrees reaches"
        in sentence
    )
