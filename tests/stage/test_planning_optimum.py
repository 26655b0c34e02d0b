from __future__ import annotations

import itertools
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.optimize import linprog

from stage.errors import InputError
from stage.lights import dome
from stage.measurability import HALF_ANGLE_STEP_RAD, Measurability
from stage.planning import PlanningTask, plan
from stage.planning.against_target import lights_against_target
from stage.planning.apart import sets_apart
from stage.planning.bits import table
from stage.planning.branching import fewest_by_branching
from stage.planning.cover import CoverProblem, Tally
from stage.planning.covering import fewest_lights, tightest_first, undominated
from stage.planning.exchange import fewer_by_exchange
from stage.planning.least_lights import LeastLights
from stage.planning.planes import Planes
from stage.planning.swaps import covered_after_swaps
from stage.planning.whole import rounded_up

Mask = NDArray[np.bool_]
Array = NDArray[np.float64]
Steps = NDArray[np.uint8]

APART_STEPS = 10
APART_RAD = APART_STEPS * HALF_ANGLE_STEP_RAD


def measured(diffuse: Mask, specular: Mask, steps: Steps | None = None) -> Measurability:
    """Arrays (lights, pixels) as measurability; half angles in steps."""
    bits = [np.packbits(part.T, axis=1) for part in (diffuse, specular)]
    return Measurability(len(diffuse), *bits, half_angle_steps=None if steps is None else steps.T.copy())


def task_of(seen: Measurability, **options: object) -> PlanningTask:
    return PlanningTask(dome(seen.lights, [0.5], 1.0), seen, **options)  # type: ignore[arg-type]


@st.composite
def instances(draw: st.DrawFn) -> tuple[Mask, Mask, Steps]:
    lights, pixels = draw(st.integers(2, 7)), draw(st.integers(1, 25))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    diffuse, specular = rng.random((2, lights, pixels)) < draw(st.sampled_from([0.2, 0.4, 0.7]))
    diffuse[0, 0] = True
    return diffuse, specular, rng.integers(0, 41, (lights, pixels), dtype=np.uint8)


def paired(specular: Mask, steps: Steps, chosen: tuple[int, ...] | list[int], apart: int | None) -> Mask:
    """Pixels with two of the chosen highlights, far enough apart: straight from the definition."""
    pixels = specular.shape[1]
    found = np.zeros(pixels, dtype=bool)
    for a, b in itertools.combinations(chosen, 2):
        far = np.abs(steps[a].astype(int) - steps[b]) >= (apart or 0)
        found |= specular[a] & specular[b] & far
    return found


def fewest_by_hand(diffuse: Mask, specular: Mask, steps: Steps, target: float, apart: int | None) -> int:
    every = range(len(diffuse))
    limit = diffuse.any(0).sum(), paired(specular, steps, list(every), apart).sum()

    def enough(chosen: tuple[int, ...]) -> bool:
        shown = diffuse[list(chosen)].any(0).sum(), paired(specular, steps, chosen, apart).sum()
        return all(got >= target * most - 1e-9 for got, most in zip(shown, limit, strict=True))

    sizes = range(len(diffuse) + 1)
    return next(k for k in sizes if any(enough(some) for some in itertools.combinations(every, k)))


# -- proof against every subset ---------------------------------------------------------------------------------------


@given(instances(), st.sampled_from([0.5, 0.8, 0.95, 1.0]), st.booleans())
@settings(max_examples=40, deadline=None)
def test_optimum_is_the_fewest_of_all_subsets_and_no_worse_than_greedy_or_static(
    instance: tuple[Mask, Mask, Steps], target: float, apart: bool
) -> None:
    diffuse, specular, steps = instance
    task = task_of(measured(*instance), target=target, apart_rad=APART_RAD if apart else None)
    plans = {method: plan(method, task) for method in ("static", "greedy", "optimal")}
    fewest = fewest_by_hand(diffuse, specular, steps, target, APART_STEPS if apart else None)
    assert plans["optimal"].count == plans["optimal"].lower_bound == fewest
    for found in plans.values():
        assert found.lower_bound <= fewest <= found.count
        pairs = paired(specular, steps, found.lights, APART_STEPS if apart else None)
        assert found.coverage["specular"] == pytest.approx(pairs.mean())
        assert found.coverage["diffuse"] == pytest.approx(diffuse[found.lights].any(0).mean())


@given(instances(), st.sampled_from([0.6, 0.9, 1.0]), st.booleans())
@settings(max_examples=40, deadline=None)
def test_no_bound_exceeds_the_optimum(instance: tuple[Mask, Mask, Steps], target: float, apart: bool) -> None:
    problem = CoverProblem.from_measurability(measured(*instance), APART_RAD if apart else None)
    wanted = problem.wanted(target)
    fewest = fewest_by_hand(*instance, target, APART_STEPS if apart else None)
    relaxed = Planes(problem).fewest(wanted, time.monotonic() + 10)
    assert rounded_up(relaxed.bound) <= fewest
    found, proved = fewest_lights(problem, wanted).solve(10)
    assert rounded_up(proved) == fewest == len(found or [])
    every = list(range(problem.lights))
    lights, bound = fewest_by_branching(problem, wanted, Planes(problem), every, 0, time.monotonic() + 10)
    assert bound == fewest == len(lights)
    assert problem.reaches(lights, wanted)
    # however short the time, what is left open counts
    lights, bound = fewest_by_branching(problem, wanted, Planes(problem), every, 0, time.monotonic())
    assert bound <= fewest <= len(lights)


@given(instances(), st.booleans(), st.integers(1, 4))
@settings(max_examples=40, deadline=None)
def test_planes_lie_above_the_coverage_of_every_choice(
    instance: tuple[Mask, Mask, Steps], apart: bool, seed: int
) -> None:
    problem = CoverProblem.from_measurability(measured(*instance), APART_RAD if apart else None)
    lights = problem.lights
    place = np.random.default_rng(seed).random(lights)
    for part in problem.components:
        cut = part.cut(place)
        for size in range(lights + 1):
            for chosen in itertools.combinations(range(lights), size):
                x = np.zeros(lights)
                x[list(chosen)] = 1
                assert cut.at(x) >= part.covered(chosen) - 1e-9
                # at whole lights the plane put there touches
                assert part.cut(x).at(x) == pytest.approx(part.covered(chosen))


@given(st.integers(1, 12), st.integers(0, 30), st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_least_lights_agree_with_highs_as_rows_come_and_bounds_move(lights: int, rows: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    programme = LeastLights(lights)
    vertex, low, high = programme.start(), np.zeros(lights), np.ones(lights)
    matrix, least = rng.normal(0.3, 0.5, (rows, lights)), rng.uniform(-0.5, 1.0, rows)
    for row in range(rows):
        programme.add(matrix[row], float(least[row]))
        if row % 5 == 4:
            light = rng.integers(lights)
            low[light], high[light] = sorted(rng.integers(0, 2, 2).tolist())
        value, x = programme.solve(vertex, np.arange(row + 1), low, high, np.inf)
        proved = programme.proved(vertex, low, high)
        known = linprog(np.ones(lights), -matrix[: row + 1], -least[: row + 1], bounds=np.stack([low, high], 1))
        if known.status == 2:
            assert np.isinf(value)
            return
        assert value == pytest.approx(known.fun, abs=1e-6)
        assert proved == pytest.approx(known.fun, abs=1e-6)
        assert programme.slack(x).min() > -1e-6
        vertex = programme.refreshed(vertex)


@given(instances(), st.booleans(), st.integers(1, 6), st.integers(0, 1000))
@settings(max_examples=40, deadline=None)
def test_every_swap_is_counted_as_the_choice_after_it(
    instance: tuple[Mask, Mask, Steps], apart: bool, number: int, seed: int
) -> None:
    problem = CoverProblem.from_measurability(measured(*instance), APART_RAD if apart else None)
    lights = problem.lights
    chosen = np.random.default_rng(seed).permutation(lights)[: min(number, lights)].tolist()
    for part in problem.components:
        covered, after = covered_after_swaps(part, chosen)
        assert covered == part.covered(chosen)
        for place, into in itertools.product(range(len(chosen)), range(lights)):
            swapped = [*chosen[:place], *chosen[place + 1 :]]
            assert after[place, into] == part.covered(swapped if into in chosen else [*swapped, into])


@given(instances(), st.integers(1, 7))
@settings(max_examples=25, deadline=None)
def test_no_choice_of_so_many_lights_exceeds_the_bound_of_shares(
    instance: tuple[Mask, Mask, Steps], count: int
) -> None:
    diffuse, specular, steps = instance
    count = min(count, len(diffuse))
    limits = diffuse.any(0).sum(), paired(specular, steps, list(range(len(diffuse))), None).sum()

    def share(chosen: tuple[int, ...] | list[int]) -> float:
        shown = diffuse[list(chosen)].any(0).sum(), paired(specular, steps, chosen, None).sum()
        return float(np.mean([got / most for got, most in zip(shown, limits, strict=True) if most]))

    best = max(share(some) for some in itertools.combinations(range(len(diffuse)), count))
    found = plan("optimal", task_of(measured(*instance), count=count))
    assert found.figures["share"] == pytest.approx(share(found.lights))
    assert share(plan("greedy", task_of(measured(*instance), count=count)).lights) <= found.figures["share"] + 1e-12
    assert found.figures["share"] <= best + 1e-12 <= found.figures["share_bound"] + 1e-6


# -- the parts --------------------------------------------------------------------------------------------------------


@given(instances(), st.integers(1, 30))
@settings(max_examples=60, deadline=None)
def test_rows_of_highlights_apart_say_what_the_definition_says(instance: tuple[Mask, Mask, Steps], apart: int) -> None:
    _, specular, steps = instance
    lights, pixels = specular.shape
    sets, start = sets_apart(measured(*instance), apart * HALF_ANGLE_STEP_RAD)
    members = table(sets, lights).astype(bool)
    for p in range(pixels):
        rows = members[start[p] : start[p + 1]]
        possible = paired(specular[:, [p]], steps[:, [p]], list(range(lights)), apart)[0]
        assert (len(rows) > 0) == possible
        for size in range(lights + 1):
            for chosen in itertools.combinations(range(lights), size):
                says = len(rows) > 0 and bool(rows[:, list(chosen)].any(1).all())
                assert says == paired(specular[:, [p]], steps[:, [p]], chosen, apart)[0]


def test_one_window_for_each_half_angle() -> None:
    # half angles of 0, 3, 6 and 9 degrees and 5 degrees wanted between two: 0 with 6 or 9, 3 with 9
    steps = np.array([[0], [6], [12], [18]], dtype=np.uint8)
    sets, start = sets_apart(measured(np.zeros((4, 1), bool), np.ones((4, 1), bool), steps), np.radians(5.0))
    assert start.tolist() == [0, 3]
    # outside [0, 5), [3, 8) and [6, 11) degrees
    assert table(sets, 4).tolist() == [[0, 0, 1, 1], [1, 0, 0, 1], [1, 1, 0, 0]]


def test_highlights_apart_change_the_plan_and_the_limit() -> None:
    specular = np.array([[1, 1], [1, 1], [1, 0]], dtype=bool)
    steps = np.array([[4, 4], [6, 6], [30, 0]], dtype=np.uint8)
    seen = measured(np.zeros_like(specular), specular, steps)
    assert sorted(plan("optimal", task_of(seen)).lights) == [0, 1]
    apart = plan("optimal", task_of(seen, apart_rad=np.radians(10.0)))
    assert 2 in apart.lights
    assert apart.count == apart.lower_bound == 2
    # the second pixel's two highlights are one degree apart
    assert apart.coverage["limit_specular"] == apart.coverage["specular"] == 0.5


def test_highlights_apart_want_known_half_angles() -> None:
    seen = measured(np.ones((3, 2), bool), np.ones((3, 2), bool))
    with pytest.raises(InputError, match="half angles"):
        plan("greedy", task_of(seen, apart_rad=0.1))
    steps = np.zeros((3, 2), dtype=np.uint8)
    with pytest.raises(InputError, match="apart: expected an angle above zero"):
        CoverProblem.from_measurability(measured(np.ones((3, 2), bool), np.ones((3, 2), bool), steps), -0.1)


@given(st.integers(1, 70), st.integers(0, 30), st.integers(0, 1000))
@settings(max_examples=40, deadline=None)
def test_dominance_leaves_rows_that_imply_all_others_and_not_each_other(lights: int, rows: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    members = rng.random((rows, lights)) < rng.uniform(0.05, 0.5)
    need = rng.integers(1, 3, rows)
    packed = np.zeros((rows, 8 * -(-lights // 64)), np.uint8)
    packed[:, : -(-lights // 8)] = np.packbits(members, axis=1)
    sets, needs = undominated(*tightest_first(packed.view(np.uint64), need))
    kept = table(sets, lights).astype(int)

    def implied(row: Mask, demand: int, by: NDArray[np.int64], by_demand: NDArray[np.int64]) -> bool:
        return bool((by_demand - (by * ~row).sum(1) >= demand).any())

    for row, demand in zip(members, need, strict=True):
        assert implied(row, demand, kept, needs)
    for i in range(len(kept)):
        others = np.arange(len(kept)) != i
        assert not implied(kept[i].astype(bool), needs[i], kept[others], needs[others])


@given(instances(), st.booleans())
@settings(max_examples=40, deadline=None)
def test_a_tally_counts_views_that_are_still_needed(instance: tuple[Mask, Mask, Steps], apart: bool) -> None:
    diffuse, specular, steps = instance
    lights = len(diffuse)
    least = APART_STEPS if apart else 0
    tally = Tally(CoverProblem.from_measurability(measured(*instance), APART_RAD if apart else None))
    possible = paired(specular, steps, list(range(lights)), least)
    for light in [*range(lights)][::-1]:
        chosen = tally.chosen
        done = paired(specular, steps, chosen, least)
        for other in range(lights):
            wanted = diffuse[other] & ~diffuse[chosen].any(0)
            assert tally.diffuse_gain[other] == (0 if other in chosen else wanted.sum())
            if other in chosen:
                assert tally.specular_gain[other] == 0
                continue
            if not apart:
                assert tally.specular_gain[other] == (specular[other] & possible & ~done).sum()
            # what one more light completes is among what it adds
            completes = paired(specular, steps, [*chosen, other], least) & ~done
            assert tally.specular_gain[other] >= completes.sum()
        tally.add(light)
        assert tally.covered.specular == paired(specular, steps, tally.chosen, least).sum()


# -- time, and a row of targets ---------------------------------------------------------------------------------------


def bowl(lights: int, pixels: int, seed: int) -> Measurability:
    """Normals and lights on a half sphere: what is near a light sees its highlight, what is far away does not."""
    rng = np.random.default_rng(seed)
    at = rng.normal(size=(lights, 3)), rng.normal(size=(pixels, 3))
    light, normal = (np.abs(v * [0, 0, 1]) + v * [1, 1, 0] for v in at)
    light, normal = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (light, normal))
    angle = np.arccos(np.clip(light @ normal.T, -1, 1))
    return measured(angle > 1.2, angle < 0.5, np.clip(np.degrees(angle) * 2, 0, 255).astype(np.uint8))


@pytest.mark.parametrize("target", [0.85, 1.0])
@pytest.mark.parametrize("method", ["greedy", "optimal"])
def test_bound_and_gap_are_given_however_short_the_time(method: str, target: float) -> None:
    seen = bowl(40, 4000, 0)
    plan(method, task_of(seen, target=target, time_limit_s=0.5))  # compiles what it needs
    begin = time.process_time()
    short = plan(method, task_of(seen, target=target, time_limit_s=0.05))
    assert time.process_time() - begin < 2
    assert 1 <= short.lower_bound <= short.count
    assert short.gap == short.count - short.lower_bound


def test_the_bound_is_close_on_a_bowl() -> None:
    seen = bowl(40, 4000, 1)
    for target, gap in ((0.99, 1), (1.0, 0)):
        assert plan("optimal", task_of(seen, target=target, time_limit_s=20)).gap <= gap


def test_exchange_needs_no_more_lights_than_it_starts_from() -> None:
    problem = CoverProblem.from_measurability(bowl(30, 2000, 2))
    wanted = problem.wanted(0.9)
    found = fewer_by_exchange(problem, wanted, list(range(30)), time.monotonic() + 20, lambda: 1, 0)
    assert problem.reaches(found, wanted)
    assert len(found) < 20
    assert found == fewer_by_exchange(problem, wanted, list(range(30)), time.monotonic() + 20, lambda: 1, 0)
    # without time only what costs no search is dropped
    at_once = fewer_by_exchange(problem, wanted, list(range(30)), 0.0, lambda: 1, 0)
    assert problem.reaches(at_once, wanted)
    assert len(found) <= len(at_once) <= 30


def test_lights_against_target_never_fall_and_agree_with_single_plans() -> None:
    seen = bowl(20, 500, 3)
    task = task_of(seen, time_limit_s=20)
    rows = lights_against_target(task, [1.0, 0.8, 0.9, 0.8])
    assert [row.target for row in rows] == [0.8, 0.9, 1.0]
    for row, after in itertools.pairwise(rows):
        assert row.optimal <= after.optimal
        assert row.lower_bound <= after.lower_bound
    for row in rows:
        assert row.lower_bound <= row.optimal <= min(row.greedy, row.static)
        assert row.greedy == plan("greedy", task_of(seen, target=row.target)).count
        assert row.static == plan("static", task_of(seen, target=row.target)).count
    with pytest.raises(InputError, match="target"):
        lights_against_target(task, [0.5, 1.5])
