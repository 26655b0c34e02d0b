"""Optimal design: closed forms for Lambert's law, the twin in plain numpy, enumeration, and what must never happen."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from stage.errors import InputError
from stage.planning.information.design import LEAST_PRIOR, Criterion, Design, inverses
from stage.planning.information.sampling import stratified

Array = NDArray[np.float64]
CRITERIA: tuple[Criterion, ...] = ("a-optimal", "d-optimal", "relighting")
NOTHING = np.zeros((3, 3))


def spiral(count: int) -> Array:
    """Unit vectors spread evenly over the upper half of the sphere (Fibonacci's spiral)."""
    k = np.arange(count) + 0.5
    z, azimuth = 1 - k / count, np.pi * (1 + 5**0.5) * k
    flat = np.sqrt(1 - z**2)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), z], -1)


def ring(count: int, slant: float) -> Array:
    azimuth = 2 * np.pi * np.arange(count) / count
    return np.stack(
        [np.sin(slant) * np.cos(azimuth), np.sin(slant) * np.sin(azimuth), np.full(count, np.cos(slant))], 1
    )


def lambertian(directions: Array, criterion: Criterion = "a-optimal") -> Design:
    """One point of unknown albedo times normal b that every light reaches: i = l . b (Woodham), unit noise."""
    return Design(directions[:, None], np.ones((len(directions), 1)), NOTHING, criterion=criterion)


def some_design(seed: int, criterion: Criterion, lights: int = 9, points: int = 5, size: int = 3) -> Design:
    rng = np.random.default_rng(seed)
    jacobian = rng.normal(size=(lights, points, size)) * rng.uniform(0.1, 10, size)
    variance = rng.uniform(0.3, 3, (lights, points))
    variance[rng.random(variance.shape) < 0.2] = np.inf
    root = rng.normal(size=(points, size, size))
    weight = np.eye(size) + root @ root.transpose(0, 2, 1)
    return Design(jacobian, variance, np.diag(rng.uniform(0.1, 2, size)), weight, criterion)


# -- Lambert's law, where the optimum is known ------------------------------------------------------------------------


def test_an_orthogonal_triad_and_equal_spacing_reach_nine_over_n() -> None:
    triad = lambertian(np.eye(3))
    triad.choose(3)
    assert triad.objective() == pytest.approx(9 / 3, rel=1e-5)
    for count in (3, 4, 5, 8, 13):
        spaced = lambertian(ring(count, np.arccos(1 / np.sqrt(3))))  # 54.7 degrees
        spaced.choose(count)
        assert spaced.objective() == pytest.approx(9 / count, rel=1e-5)
    for slant in (0.7, 1.2):
        other = lambertian(ring(6, slant))
        other.choose(6)
        assert other.objective() > 9 / 6 * 1.05


@pytest.mark.parametrize("criterion", ["a-optimal", "d-optimal"])
@pytest.mark.parametrize("count", [3, 4, 5, 6, 8, 12, 24])
def test_planner_finds_the_lambertian_optimum(criterion: Criterion, count: int) -> None:
    directions = spiral(400)
    design = lambertian(directions, criterion)
    design.choose(count)
    design.exchange(5.0)
    chosen = directions[design.chosen]
    trace = np.trace(np.linalg.inv(chosen.T @ chosen))
    assert 9 / count * (1 - 1e-9) <= trace <= 9 / count * 1.01
    assert np.linalg.slogdet(chosen.T @ chosen)[1] == pytest.approx(3 * np.log(count / 3), abs=0.01)


@given(st.integers(3, 30), st.integers(0, 2**32 - 1))
def test_no_lights_are_better_than_nine_over_n(count: int, seed: int) -> None:
    """By the inequality of means: trace(M) = n, so that trace(M^-1) >= 9/n and det(M) <= (n/3)^3."""
    directions = np.random.default_rng(seed).normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    design = lambertian(directions)
    design.choose(count)
    assert design.objective() >= 9 / count * (1 - 1e-4)  # the stand-in for a prior makes it a little smaller
    volume = lambertian(directions, "d-optimal")
    assert volume.objective_if(range(count)) >= -3 * np.log(count / 3) - 1e-4


# -- gains ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("criterion", CRITERIA)
@pytest.mark.parametrize("size", [1, 2, 3, 5])
def test_gains_are_differences_of_the_objective(criterion: Criterion, size: int) -> None:
    """The compiled rank-one update against inverting every matrix anew."""
    design = some_design(size, criterion, size=size)
    for light in (4, 1):
        design.add(light)
        others = [one for one in range(design.lights) if one not in design.chosen]
        expected = [design.objective() - design.objective_if([one]) for one in others]
        assert_allclose(design.gains()[others], expected, rtol=1e-8, atol=1e-12)
        assert_allclose(design.gains()[design.chosen], 0)
        assert others[int(np.argmax(expected))] == design.best()


@given(st.integers(0, 2**32 - 1), st.sampled_from(CRITERIA))
@settings(max_examples=30)
def test_properties_of_any_design(seed: int, criterion: Criterion) -> None:
    rng = np.random.default_rng(seed)
    design = some_design(seed, criterion)
    order = rng.permutation(design.lights).tolist()
    fewer, more, light = order[:2], order[:5], order[6]
    # a photograph never hurts, and order does not matter
    assert (design.gains() >= 0).all()
    assert design.objective_if(more) <= design.objective_if(fewer) + 1e-9
    assert design.objective_if(more) == pytest.approx(design.objective_if(more[::-1]), rel=1e-9)
    # the logarithm of the determinant is submodular: what is known already is not gained again
    if criterion == "d-optimal":
        first = design.objective_if(fewer) - design.objective_if([*fewer, light])
        later = design.objective_if(more) - design.objective_if([*more, light])
        assert later <= first + 1e-9
    before = design.objective()
    design.add(light)
    design.remove(light)
    assert design.objective() == pytest.approx(before, rel=1e-9)


@pytest.mark.parametrize("criterion", CRITERIA)
def test_greedy_and_exchange_against_every_choice(criterion: Criterion) -> None:
    for seed in range(5):
        design = some_design(seed, criterion, lights=10)
        start = design.objective()
        every = [design.objective_if(lights) for lights in itertools.combinations(range(10), 4)]
        design.choose(4)
        greedy = design.objective()
        design.exchange(5.0)
        swapped = design.objective()
        assert min(every) - 1e-9 <= swapped <= greedy + 1e-9
        assert swapped < np.mean(every)
        # of the gain that any four lights can have
        assert start - greedy >= (1 - 1 / np.e) * (start - min(every))
        assert start - swapped >= 0.95 * (start - min(every))


def test_exchange_keeps_fixed_lights_and_orders_the_rest() -> None:
    design = some_design(3, "a-optimal")
    for light in (8, 7, 6, 5):
        design.add(light)
    before = design.objective()
    design.exchange(5.0, fixed=[8])
    assert design.chosen[0] == 8
    assert len(set(design.chosen)) == 4
    assert design.objective() <= before
    # a capture that is cut short has the best of them
    again = some_design(3, "a-optimal")
    again.add(8)
    gains = again.gains()
    assert max(design.chosen[1:], key=lambda light: gains[light]) == design.chosen[1]


def test_no_time_no_exchange() -> None:
    design = some_design(3, "a-optimal")
    for light in (8, 7, 6):
        design.add(light)
    assert design.exchange(0.0) == 0
    assert set(design.chosen) == {8, 7, 6}


# -- singular and ill-scaled problems ----------------------------------------------------------------------------------


def test_points_that_no_light_reaches_change_no_choice() -> None:
    rng = np.random.default_rng(0)
    jacobian, dark = rng.normal(size=(12, 4, 3)), np.full((12, 3), np.inf)
    seen = Design(jacobian, np.ones((12, 4)), NOTHING)
    both = Design(
        np.concatenate([jacobian, rng.normal(size=(12, 3, 3))], 1), np.concatenate([np.ones((12, 4)), dark], 1), NOTHING
    )
    seen.choose(6)
    both.choose(6)
    assert seen.chosen == both.chosen
    assert both.objective() == pytest.approx(seen.objective() + 3 * 3)


def test_a_parameter_that_nothing_measures_is_not_gained() -> None:
    jacobian = np.random.default_rng(1).normal(size=(8, 3, 3))
    jacobian[..., 2] = 0
    design = Design(jacobian, np.ones((8, 3)), NOTHING)
    design.choose(5)
    assert_allclose(design.covariance()[:, 2, 2], 1.0)
    assert np.isfinite(design.objective())
    assert design.gains().max() < 10


@pytest.mark.parametrize("unit", [1e-6, 1e6])
def test_units_of_the_parameters_do_not_matter_to_determinant_and_prediction(unit: float) -> None:
    rng = np.random.default_rng(2)
    jacobian, wanted = rng.normal(size=(15, 6, 3)), rng.normal(size=(6, 2, 3))
    scale = np.array([1.0, unit, 1 / unit])
    for criterion in ("d-optimal", "relighting"):
        chosen = []
        for factor in (np.ones(3), scale):
            weight = np.einsum("qwi,qwj->qij", wanted * factor, wanted * factor)
            prior = np.diag(factor**2)
            design = Design(jacobian * factor, np.ones((15, 6)), prior, weight, criterion)
            design.choose(5)
            chosen.append(design.chosen)
        assert chosen[0] == chosen[1]


def test_the_stand_in_for_a_prior_is_a_small_share_of_the_information() -> None:
    jacobian = np.random.default_rng(3).normal(size=(20, 2, 3))
    design = Design(jacobian, np.ones((20, 2)), NOTHING)
    exact = np.einsum("lqi,lqj->qij", jacobian, jacobian)
    assert_allclose(design.covariance_if(range(20)), np.linalg.inv(exact), rtol=100 * LEAST_PRIOR, atol=1e-6)


def test_inverses_of_matrices_in_mixed_units() -> None:
    scale = np.array([1e-8, 1.0, 1e8])
    matrix = np.array([[2.0, 0.5, 0.1], [0.5, 1.0, 0.3], [0.1, 0.3, 3.0]])
    found = inverses((matrix * scale[:, None] * scale)[None])[0]
    assert_allclose(found * scale[:, None] * scale @ matrix, np.eye(3), atol=1e-12)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"variance": np.ones((4, 3))}, "jacobian, variance"),
        ({"variance": np.zeros((4, 2))}, r"variance\[0\]"),
        ({"variance": np.full((4, 2), np.nan)}, r"variance\[0\]"),
        ({"jacobian": np.full((4, 2, 3), np.nan)}, r"jacobian\[0\]"),
        ({"prior": np.eye(2)}, "prior"),
        ({"weight": np.full((3, 3), np.inf)}, "weight"),
        ({"criterion": "relighting"}, "weight"),
        ({"criterion": "best"}, "criterion"),
    ],
)
def test_refusals(change: dict[str, object], named: str) -> None:
    given: dict[str, object] = {"jacobian": np.ones((4, 2, 3)), "variance": np.ones((4, 2)), "prior": np.eye(3)}
    with pytest.raises(InputError, match=named):
        Design(**(given | change))  # type: ignore[arg-type]


def test_a_light_is_chosen_once() -> None:
    design = some_design(0, "a-optimal")
    design.add(2)
    with pytest.raises(InputError, match="light 2"):
        design.add(2)
    design.choose(99)
    assert sorted(design.chosen) == list(range(9))


# -- sampling ---------------------------------------------------------------------------------------------------------


@given(st.integers(1, 5000), st.integers(1, 300), st.integers(0, 100))
def test_stratified_sample(count: int, wanted: int, seed: int) -> None:
    drawn = stratified(count, wanted, seed)
    assert len(drawn) == min(count, wanted)
    assert (np.diff(drawn) > 0).all()
    assert drawn[0] >= 0
    assert drawn[-1] < count
    if wanted < count:
        run = count / wanted
        assert (np.abs(drawn - (np.arange(wanted) + 0.5) * run) <= 0.5 * run + 1).all()
