"""How many lights each target costs: one question asked for a row of targets, with what one answer tells the next."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from stage.planning.greedy import choose_greedily
from stage.planning.optimal import fewest
from stage.planning.outcome import goal, problem_of
from stage.planning.planes import Planes
from stage.planning.static import choose_by_rank
from stage.planning.task import PlanningTask


class LightsForTarget(NamedTuple):
    """Numbers of lights that reach a target.

    Attributes
    ----------
    target : float
        Share, per component, of what all candidates together show.
    greedy, static, optimal : int
        Lights of these methods.
    lower_bound : int
        No set of fewer candidates reaches the target.
    """

    target: float
    greedy: int
    static: int
    optimal: int
    lower_bound: int


def lights_against_target(task: PlanningTask, targets: Sequence[float]) -> list[LightsForTarget]:
    """Lights that each target takes, the lowest target first.

    A choice that reaches a target reaches every lower one, and a bound holds for every higher one, so that neither
    falls as the target rises; planes found for one target serve all.

    Parameters
    ----------
    task : PlanningTask
        Its `time_limit_s` is for all targets together, an equal part of what is left for each; `target`, `count` and
        `stop` have no say.
    targets : sequence of float
        Each above 0 and up to 1.

    Raises
    ------
    InputError
        Without a surface, or where a target is out of range.
    """
    problem = problem_of(task, "optimal")
    planes, deadline = Planes(problem), problem.begun_s + task.time_limit_s
    found: list[LightsForTarget] = []
    choice: list[int] | None = None
    order = sorted(set(targets), reverse=True)
    # from the highest target down, each choice is a start for the next
    for number, target in enumerate(order):
        here = replace(task, target=target, count=None, stop="target")
        greedy, static = choose_greedily(here, problem), choose_by_rank(here, problem)
        now = time.monotonic()
        until = now + max(deadline - now, 0.0) / (len(order) - number)
        starts = [greedy.chosen, static.chosen, *([choice] if choice else [])]
        choice, (bound, _) = fewest(here, problem, goal(here, problem), planes, until, starts)
        found.append(LightsForTarget(target, len(greedy.chosen), len(static.chosen), len(choice), bound))
    found.reverse()
    proved = 0
    for number, row in enumerate(found):
        proved = max(proved, row.lower_bound)
        found[number] = row._replace(lower_bound=proved)
    return found
