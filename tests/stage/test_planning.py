from __future__ import annotations

import itertools
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from stage.errors import InputError
from stage.lights import Light, dome
from stage.measurability import HalfAngleCriterion, Measurability, measurability
from stage.planning import METHODS, LightPlan, PlanningTask, plan
from stage.planning.bits import as_words, merge_rows, votes
from stage.planning.cover import Covered, CoverProblem
from stage.planning.covering import fewest_lights, lower_bound

Mask = NDArray[np.bool_]
SURFACE_METHODS = ("static", "greedy", "optimal")


def some_lights(count: int) -> list[Light]:
    return dome(count, [0.5], 1.0)


def table(*rows: str) -> Mask:
    """One row of x and . per light, one column per pixel."""
    return np.array([[mark == "x" for mark in row] for row in rows])


def cover_task(diffuse: Mask, specular: Mask | None = None, **options: object) -> PlanningTask:
    seen = Measurability.from_arrays(diffuse, np.zeros_like(diffuse) if specular is None else specular)
    return PlanningTask(some_lights(len(diffuse)), seen, **options)  # type: ignore[arg-type]


# -- covers whose answers are known by hand ---------------------------------------------------------------------------


def test_marginal_gain_skips_a_light_that_shows_nothing_new() -> None:
    diffuse = table("xxxx..", "xxx...", "....xx", "...x..")
    static, greedy = (plan(method, cover_task(diffuse)) for method in ("static", "greedy"))
    # M14: the ranking takes the second largest light although all its pixels are covered
    assert static.lights == [0, 1, 2]
    assert greedy.lights == [0, 2]
    assert greedy.lower_bound == static.lower_bound == 2


def test_marginal_gain_is_not_always_better() -> None:
    diffuse = table("xxxxxx......", "xx....xxx...", "xx.......xxx", "......xx.xx.")
    static, greedy, optimal = (plan(method, cover_task(diffuse)) for method in SURFACE_METHODS)
    assert static.lights == [0, 1, 2]
    assert greedy.lights == [0, 3, 1, 2]
    assert optimal.count == optimal.lower_bound == 3


def test_each_point_wants_two_strong_highlights() -> None:
    specular = table("xxx..", "x.x..", ".x.x.", "...x.")
    greedy = plan("greedy", cover_task(np.zeros_like(specular), specular))
    assert greedy.lights == [0, 1, 2, 3]
    # after light 1 the first and third pixel have two views, after light 2 the second, after light 3 the fourth
    assert greedy.curve == [(1, 0.0, 0.0), (2, 0.0, 0.4), (3, 0.0, 0.6), (4, 0.0, 0.8)]
    assert greedy.coverage == {"diffuse": 0.0, "limit_diffuse": 0.0, "specular": 0.8, "limit_specular": 0.8}


def test_a_pixel_with_a_single_highlight_is_hopeless_and_draws_no_light() -> None:
    specular = table("xx..", "xx..", "..xx", "....")
    static, greedy = (plan(method, cover_task(np.zeros_like(specular), specular)) for method in ("static", "greedy"))
    assert greedy.lights == [0, 1]
    # the ranking by S_p counts hopeless pixels as the text does; here that changes nothing
    assert static.lights == [0, 1]
    assert greedy.coverage["limit_specular"] == 0.5


def test_both_components_take_turns_and_a_satisfied_one_is_not_served() -> None:
    diffuse = table("xxxxx", ".....", "xx...", ".....", ".....")
    specular = table(".....", "xxx..", ".....", "xxx..", "...xx")
    greedy = plan("greedy", cover_task(diffuse, specular))
    assert greedy.lights == [0, 1, 3]
    assert greedy.reached == {"diffuse": 1, "specular": 3}
    # one light may be the best of both kinds, and is then taken once
    both = plan("static", cover_task(diffuse, np.roll(specular, -1, axis=0)))
    assert both.lights == [0, 2]


def test_target_is_a_share_of_the_limit() -> None:
    # ten of twenty pixels can be measured; 0.8 of the limit is eight pixels
    diffuse = np.zeros((5, 20), dtype=bool)
    for light in range(5):
        diffuse[light, 2 * light : 2 * light + 2] = True
    for method in SURFACE_METHODS:
        some = plan(method, cover_task(diffuse, target=0.8))
        assert some.count == some.lower_bound == 4
        assert some.coverage["diffuse"] == 0.4
        assert some.limit_reached == {"diffuse": False, "specular": True}
        every = plan(method, cover_task(diffuse))
        assert every.count == every.lower_bound == 5
        assert every.limit_reached == {"diffuse": True, "specular": True}


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("count", [1, 2, 4])
def test_count_gives_exactly_that_many(method: str, count: int) -> None:
    diffuse = table("xxxx..", "xxx...", "....xx", "...x..")
    specular = table("xxx...", "xxx...", "......", "...xxx")
    chosen = plan(method, cover_task(diffuse, specular, count=count))
    assert chosen.count == len(set(chosen.lights)) == len(chosen.curve) == count
    assert chosen.lower_bound <= count


def test_lights_beyond_the_limit_are_those_that_see_most() -> None:
    diffuse = table("xxxx", "x...", "xx..", "xxx.")
    assert plan("greedy", cover_task(diffuse, count=3)).lights == [0, 3, 2]


def test_optimal_count_covers_more_than_greedy() -> None:
    # the classical trap: the largest set first, then two more for what two sets would have covered
    diffuse = table(".xxxx.", "xxx...", "...xxx")
    assert plan("greedy", cover_task(diffuse, count=2)).coverage["diffuse"] == pytest.approx(5 / 6)
    best = plan("optimal", cover_task(diffuse, count=2))
    assert sorted(best.lights) == [1, 2]
    assert best.coverage["diffuse"] == 1.0


def test_ties_go_to_the_lowest_index() -> None:
    diffuse = table("..xx", "xx..", "xx..", "..xx")
    assert plan("greedy", cover_task(diffuse)).lights == [0, 1]
    assert plan("static", cover_task(diffuse)).lights == [0, 1]


def test_plan_as_json() -> None:
    diffuse = table("xxxx..", "xxx...", "....xx", "...x..")
    answer = json.loads(json.dumps(plan("greedy", cover_task(diffuse)).to_json()))
    assert answer["lights"] == [0, 2]
    assert answer["count"] == answer["lower_bound"] == 2
    assert answer["coverage"] == {"diffuse": 1.0, "specular": 0.0, "limit_diffuse": 1.0, "limit_specular": 0.0}
    assert answer["curve"] == [[1, 4 / 6, 0.0], [2, 1.0, 0.0]]


# -- properties on any cover ------------------------------------------------------------------------------------------


@st.composite
def covers(draw: st.DrawFn) -> tuple[Mask, Mask]:
    lights, pixels = draw(st.integers(2, 7)), draw(st.integers(1, 25))
    density = draw(st.floats(0.1, 0.7))
    chance = np.random.default_rng(draw(st.integers(0, 2**32 - 1))).random((2, lights, pixels))
    diffuse, specular = chance < density
    # the first pixel makes every cover worth planning
    diffuse[0, 0] = True
    return diffuse, specular


def enough(diffuse: Mask, specular: Mask, lights: tuple[int, ...] | list[int], target: float) -> bool:
    """Whether a choice reaches the target, counted pixel by pixel."""
    chosen = list(lights)
    shown = diffuse[chosen].any(0).sum(), (specular[chosen].sum(0) >= 2).sum()
    limit = diffuse.any(0).sum(), (specular.sum(0) >= 2).sum()
    return all(got >= target * most - 1e-9 for got, most in zip(shown, limit, strict=True))


@given(covers(), st.sampled_from([0.5, 0.8, 0.95, 1.0]))
@settings(max_examples=60, deadline=None)
def test_every_method_reaches_the_target_and_optimal_is_the_fewest(cover: tuple[Mask, Mask], target: float) -> None:
    diffuse, specular = cover
    task = cover_task(diffuse, specular, target=target, seed=3)
    plans = {method: plan(method, task) for method in METHODS}
    sizes = range(len(diffuse) + 1)
    fewest = next(
        k for k in sizes if any(enough(*cover, some, target) for some in itertools.combinations(range(len(diffuse)), k))
    )
    for found in plans.values():
        assert enough(diffuse, specular, found.lights, target)
        assert len(set(found.lights)) == found.count >= fewest >= found.lower_bound
        check_curve(found, diffuse, specular)
    assert plans["optimal"].count == plans["optimal"].lower_bound == fewest


def check_curve(found: LightPlan, diffuse: Mask, specular: Mask) -> None:
    steps = np.array(found.curve)
    assert_array_equal(steps[:, 0], np.arange(1, found.count + 1))
    assert (np.diff(steps[:, 1:], axis=0) >= 0).all()
    for n, lit_diffuse, lit_specular in found.curve:
        chosen = found.lights[:n]
        assert lit_diffuse == pytest.approx(diffuse[chosen].any(0).mean())
        assert lit_specular == pytest.approx((specular[chosen].sum(0) >= 2).mean())
    assert steps[-1, 1:] == pytest.approx([found.coverage["diffuse"], found.coverage["specular"]])


@given(covers(), st.integers(1, 7))
@settings(max_examples=30, deadline=None)
def test_asked_counts_are_bounded_from_below_and_optimal_covers_most(cover: tuple[Mask, Mask], count: int) -> None:
    diffuse, specular = cover
    task = cover_task(diffuse, specular, count=min(count, len(diffuse)))
    limits = Covered(int(diffuse.any(0).sum()), int((specular.sum(0) >= 2).sum()))

    def worth(lights: tuple[int, ...] | list[int]) -> float:
        chosen = list(lights)
        shown = diffuse[chosen].any(0).sum(), (specular[chosen].sum(0) >= 2).sum()
        return float(sum(got / most for got, most in zip(shown, limits, strict=True) if most))

    plans = {method: plan(method, task) for method in METHODS}
    most = max(worth(some) for some in itertools.combinations(range(len(diffuse)), task.count or 0))
    assert worth(plans["optimal"].lights) == pytest.approx(most)
    for found in plans.values():
        assert found.lower_bound <= found.count == task.count
        check_curve(found, diffuse, specular)


@given(covers(), st.integers(0, 100))
@settings(max_examples=25, deadline=None)
def test_order_and_repetition_of_pixels_change_nothing(cover: tuple[Mask, Mask], seed: int) -> None:
    diffuse, specular = cover
    order = np.random.default_rng(seed).permutation(diffuse.shape[1])
    for method in ("static", "greedy"):
        once = plan(method, cover_task(diffuse, specular))
        again = plan(method, cover_task(*(np.tile(part[:, order], 3) for part in cover)))
        assert once.lights == again.lights
        assert once.coverage == pytest.approx(again.coverage)


# -- the parts --------------------------------------------------------------------------------------------------------


@given(st.integers(1, 40), st.integers(0, 60), st.integers(0, 1000))
@settings(max_examples=40, deadline=None)
def test_merged_rows_and_votes(lights: int, rows: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    table_ = rng.random((rows, lights)) < 0.1
    words = as_words(np.packbits(table_, axis=1))
    first, weight = merge_rows(words)
    merged = words[first]
    assert weight.sum() == rows
    assert (np.diff(weight) <= 0).all()
    assert len(np.unique(merged, axis=0)) == len(merged)
    for row, times in zip(merged, weight, strict=True):
        assert (words == row).all(1).sum() == times
    assert_array_equal(votes(merged, weight, lights), table_.sum(0))


def test_implied_rows_are_dropped() -> None:
    # whoever sees the pixel of lights 0 and 1 twice has both, which covers every pixel of either
    diffuse = table("x...", ".x..", "xx..", "....")
    specular = table("...x", "...x", "....", "....")
    problem = CoverProblem.from_measurability(Measurability.from_arrays(diffuse, specular))
    programme = fewest_lights(problem, problem.limit)
    assert programme.matrix.shape == (1, 4)
    assert_array_equal(programme.matrix.toarray(), [[1, 1, 0, 0]])
    assert_array_equal(programme.least, [2])


def test_bound_without_time_falls_back_on_counting() -> None:
    rng = np.random.default_rng(0)
    seen = Measurability.from_arrays(*(rng.random((2, 40, 3000)) < 0.08))
    problem = CoverProblem.from_measurability(seen)
    wanted = problem.wanted(0.9)
    slow, how = lower_bound(problem, wanted, 60)
    fast, other = lower_bound(problem, wanted, 1e-6)
    assert how == "linear relaxation"
    assert other == "counting"
    assert 1 <= fast <= slow
    assert lower_bound(problem, Covered(0, 0), 60) == (0, "counting")


def test_a_short_time_limit_still_gives_a_plan_and_a_bound() -> None:
    rng = np.random.default_rng(1)
    diffuse, specular = rng.random((2, 40, 3000)) < 0.08
    found = plan("optimal", cover_task(diffuse, specular, target=0.9, time_limit_s=0.05))
    greedy = plan("greedy", cover_task(diffuse, specular, target=0.9))
    assert enough(diffuse, specular, found.lights, 0.9)
    assert found.lower_bound <= found.count <= greedy.count


# -- directions alone -------------------------------------------------------------------------------------------------


def test_farthest_point_on_a_circle_takes_opposites_then_the_middles() -> None:
    angle = np.radians(np.arange(0, 360, 45))
    circle = [Light(direction=(np.cos(a), np.sin(a), 0)) for a in angle]
    chosen = plan("farthest", PlanningTask(circle, count=8))
    assert chosen.lights == [0, 4, 2, 6, 1, 3, 5, 7]
    assert chosen.coverage == {"diffuse": None, "specular": None, "limit_diffuse": None, "limit_specular": None}
    assert chosen.limit_reached == {"diffuse": None, "specular": None}
    assert chosen.curve == []


def test_farthest_point_starts_in_the_middle_of_a_dome_and_spreads() -> None:
    lights = [*dome(12, np.radians([10, 40]), 1.0, centre=(1, 2, 3)), Light(position=(1, 2, 4))]
    chosen = plan("farthest", PlanningTask(lights, count=5, centre=(1.0, 2.0, 3.0)))
    assert chosen.lights[:2] == [24, 0]
    assert sorted(chosen.lights[1:]) == [0, 3, 6, 9]


def test_random_is_reproducible_and_follows_its_seed() -> None:
    lights = some_lights(30)
    one, same, other = (plan("random", PlanningTask(lights, count=10, seed=s)).lights for s in (5, 5, 6))
    assert one == same != other
    assert len(set(one)) == 10
    first = [plan("random", PlanningTask(some_lights(3), count=1, seed=s)).lights[0] for s in range(300)]
    assert_allclose(np.bincount(first) / 300, 1 / 3, atol=0.1)


# -- on a surface -----------------------------------------------------------------------------------------------------


def test_plans_of_a_ball() -> None:
    # a ball seen from far above, on a fine grid of normals
    x, y = np.meshgrid(np.linspace(-1, 1, 61), np.linspace(-1, 1, 61))
    mask = x**2 + y**2 < 0.98
    normals = np.stack([x, y, np.sqrt(np.where(mask, 1 - x**2 - y**2, 0))], -1)
    lights = [Light(direction=light.position) for light in dome(12, np.radians([15, 30, 45, 60, 75]), 1.0)]
    seen = measurability(None, normals, [0, 0, 1], lights, mask=mask, criterion=HalfAngleCriterion())
    plans = {method: plan(method, PlanningTask(lights, seen, target=0.8)) for method in ("static", "greedy")}
    # no light reaches pixels within 30 degrees of the view diffuse-only
    slant = np.degrees(np.arccos(normals[mask][:, 2]))
    assert not seen.diffuse[:, slant < 30].any()
    assert plans["greedy"].count < plans["static"].count
    assert plans["greedy"].count < 20
    for found in plans.values():
        assert (found.coverage["specular"] or 0) >= 0.8 * (found.coverage["limit_specular"] or 0)


# -- bad input --------------------------------------------------------------------------------------------------------


def test_unknown_methods_are_refused_by_name() -> None:
    with pytest.raises(InputError, match=r"expected one of static.*'best'"):
        plan("best", PlanningTask(some_lights(3), count=1))


@pytest.mark.parametrize("method", SURFACE_METHODS)
def test_methods_that_need_a_surface_say_so(method: str) -> None:
    with pytest.raises(InputError, match="surface"):
        plan(method, PlanningTask(some_lights(3), count=1))


@pytest.mark.parametrize("method", ["farthest", "random"])
def test_methods_without_surface_need_a_count(method: str) -> None:
    with pytest.raises(InputError, match="count"):
        plan(method, PlanningTask(some_lights(3)))


@pytest.mark.parametrize("method", METHODS)
def test_an_object_that_no_light_measures_is_refused(method: str) -> None:
    with pytest.raises(InputError, match="none of the 3 candidate lights"):
        plan(method, cover_task(np.zeros((3, 4), dtype=bool)))


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"target": 0.0}, "target"),
        ({"target": 1.01}, "target"),
        ({"target": np.nan}, "target"),
        ({"count": 0}, "count"),
        ({"count": 5}, "count"),
        ({"time_limit_s": 0.0}, "time limit"),
        ({"centre": (0, 0, np.nan)}, "centre"),
    ],
)
def test_bad_tasks_are_refused_by_field(options: dict[str, object], named: str) -> None:
    with pytest.raises(InputError, match=named):
        cover_task(table("x", "x", "x", "x"), **options)  # type: ignore[arg-type]


def test_mismatched_and_empty_candidates_are_refused() -> None:
    seen = Measurability.from_arrays(table("x", "x"), table("x", "x"))
    with pytest.raises(InputError, match="2 lights"):
        PlanningTask(some_lights(3), seen)
    with pytest.raises(InputError, match="empty"):
        PlanningTask([])
    with pytest.raises(InputError, match=r"candidates\[1\]"):
        plan("farthest", PlanningTask([Light(position=(0, 0, 1)), Light(position=(0, 0, 0))], count=1))
    with pytest.raises(InputError, match="mixed"):
        plan("farthest", PlanningTask([Light(position=(0, 0, 1)), Light(direction=(0, 0, 1))], count=1))
