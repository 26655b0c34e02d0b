"""The published stopping rule: enough is measured, and more lights would hardly measure more (M15).

The text of 003_063c1864929fbf91.txt, 2.2, fixes a threshold of 80 %, "judged" against what all candidates show, and
ends the selection where specular measurability "cannot increase more". Neither is defined. Its Table 1 ends with 9 to
14 of 60 lights, at 96.6 to 99.9 % of the specular limit. Four readings, in the order of how many lights they take:

- ``80 %``: stop at that share of the limit. Ends far below Table 1.
- ``knee``: stop there at the earliest, and from there on where the curve of specular coverage over the number of lights
  is highest above the straight line from nothing to all candidates. Beyond it, no number of further lights brings its
  even share, ``limit / candidates`` each. This is what is done here: it has no constant to choose, a light that adds
  little does not end it while later ones add much, and of the four it behaves most like Table 1
  (``python -m benchmarks.table_one``).
- ``idle``: stop beyond 80 % at the first light that adds no pixel at all. One pixel more or less decides.
- ``limit``: stop when nothing can be added. Two to four times as many lights as in Table 1, for the last few pixels.

The knee is that of Satopaa et al., "Finding a 'Kneedle' in a haystack", ICDCS workshops 2011, on a finished curve.
It moves with the number of candidates: twice as many halve the even share.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stage.planning.cover import Tally
from stage.planning.outcome import outcome
from stage.planning.task import LightPlan, PlanningTask


def stops_saturated(task: PlanningTask) -> bool:
    """Whether the task ends by the published rule; a number of lights that is asked for comes first."""
    return task.stop == "saturation" and task.count is None


def saturated(method: str, task: PlanningTask, full: Tally) -> LightPlan:
    """Plan of the first lights of a choice, up to where the published rule stops it.

    Its lower bound is for what these lights show, which is more than the threshold asks for.

    Parameters
    ----------
    task : PlanningTask
        Its `target` is the published threshold.
    full : Tally
        The same choice carried on to the limit of both components.
    """
    kept = Tally(full.problem)
    for light in full.chosen[: _stop(full, task.target)]:
        kept.add(light)
    return outcome(method, replace(task, count=len(kept.chosen)), kept)


def _stop(full: Tally, target: float) -> int:
    """Number of lights, from those that reach the target on, at which the specular curve has its knee."""
    problem = full.problem
    covered = np.rint(np.array([(0, 0), *(step[1:] for step in full.curve)]) * problem.pixels).astype(np.int64)
    enough = int((covered >= problem.wanted(target)).all(1).argmax())
    # whole numbers, so that among equals the fewest lights win whatever the rounding
    height = covered[:, 1] * problem.lights - np.arange(len(covered)) * problem.limit.specular
    return enough + int(height[enough:].argmax())
