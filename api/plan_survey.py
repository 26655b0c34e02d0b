"""What the page of a plan compares it with: other methods, other targets, and seconds."""

from __future__ import annotations

from dataclasses import replace

from acquisition.travel_cost import CaptureTimes, proven_order
from api.plan_choice import Chosen, rig_times
from api.plan_report import plan_content, target_traces
from api.planning_wishes import Wishes
from api.report.plan_content import PlanContent
from api.surface_source import Surface
from stage.errors import InputError
from stage.lights import Light
from stage.planning import plan as choose
from stage.planning.against_target import lights_against_target
from stage.planning.cost import time_curve
from stage.planning.touring import routed, short_way
from stage.rig import Rig

COMPARED = ("optimal", "greedy", "static", "farthest", "random")
TARGETS = (0.5, 0.6, 0.7, 0.8, 0.85, 0.9, 0.95, 0.98, 0.99, 1.0)


def survey(
    lights: list[Light], surface: Surface | None, chosen: Chosen, wishes: Wishes, *, rig: Rig | None = None
) -> PlanContent:
    """Plan by the other methods, for other targets, and for the least time where a rig reaches all candidates.

    Each of the three takes up to `Wishes.time_limit_s`. Without a surface there is nothing to compare with.
    """
    task = chosen.task
    if task.measurable is None or surface is None:
        return plan_content(lights, surface, None, [chosen.plan])
    each = replace(task, time_limit_s=wishes.time_limit_s / len(COMPARED))
    plans = [chosen.plan, *(choose(method, each) for method in COMPARED if method != chosen.plan.method)]
    rows = lights_against_target(replace(task, count=None), TARGETS)
    by_method = {
        "static": [(row.target, row.static) for row in rows],
        "greedy": [(row.target, row.greedy) for row in rows],
        "optimal": [(row.target, row.optimal) for row in rows],
    }
    times = chosen.times or _times(rig, lights)
    curve, seconds = [], {}
    if times is not None:
        curve = time_curve(replace(task, count=None), times.between_s, times.shot_s, TARGETS, prover=proven_order)
        seconds = {plan.method: times.total_s(routed(times.between_s, plan.lights, short_way)) for plan in plans}
    return plan_content(
        lights,
        surface,
        task.measurable,
        plans,
        target=task.target,
        seconds=seconds,
        lights_by_target=target_traces(by_method, [(row.target, row.lower_bound) for row in rows]),
        times=curve,
    )


def _times(rig: Rig | None, lights: list[Light]) -> CaptureTimes | None:
    """Seconds on a rig; None without one, or where it does not reach all candidates."""
    try:
        return None if rig is None else rig_times(rig, lights)
    except InputError:
        return None
