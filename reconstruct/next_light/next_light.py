"""The closed loop: capture a few, fit, ask which light would teach most, stop where nothing more can be gained."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from acquisition.dataset import IlluminationDataset
from reconstruct.fitting.geometry import ObjectGeometry
from reconstruct.model import Progress, model_class, no_progress
from reconstruct.next_light.belief import Belief, belief
from reconstruct.next_light.spreading import MISFIT, farthest_from
from reconstruct.next_light.stopping import Outlook, Verdict, judge
from reconstruct.next_light.thinning import CoarseGeometry, ThinnedDataset, coarse_grid
from reconstruct.next_light.wanted import wanted_lights
from reconstruct.parametric import ParametricModel
from stage.errors import InputError
from stage.expected_reflectance import ExpectedReflectance
from stage.lights import Light
from stage.planning import PlanningTask
from stage.planning.information.parameters import plan_parameters
from stage.planning.simple import plan_farthest
from stage.planning.task import Aim, PlannedSurface

FIRST = 6
"""Lights before the first fit: twice the unknowns of a point, so that its misfit shows."""

LOOKED_AT = 2000
"""Object pixels that decisions are made by, on a coarse grid: a mean over them is known to some 2 % of its spread."""

LOOK_BACK = 4
"""The latest photographs, which the ones before them must have predicted."""

_EXCHANGE_S = 1.0  # to improve a batch by swaps


@dataclass(frozen=True)
class Decision:
    """What to do next.

    Attributes
    ----------
    lights : tuple of int
        Candidates to capture next, the most telling first; none where it is time to stop.
    reason : str
        One sentence for the person, with the figures.
    predicted_error : float
        Expected mean absolute error of held-out pictures over the object, 8-bit grey levels, with what is captured.
    floor_error : float
        The same if all candidates were captured.
    surprise : float
        Error with which the latest photographs were predicted by the ones before them, over the error that was
        expected of that; 1 is a perfect forecast. `predicted_error` and `floor_error` are corrected by it.
    """

    lights: tuple[int, ...]
    reason: str
    predicted_error: float
    floor_error: float
    surprise: float

    @property
    def figures(self) -> dict[str, float]:
        """The numbers by name."""
        return {
            "predicted_error": self.predicted_error,
            "floor_error": self.floor_error,
            "surprise": self.surprise,
        }

    def naming(self, names: Sequence[int]) -> Decision:
        """The same decision with ``names[i]`` for candidate i."""
        return replace(self, lights=tuple(names[i] for i in self.lights))

    def to_json(self) -> dict[str, Any]:
        """Return the decision as command line and REST print it."""
        return {"lights": list(self.lights), "reason": self.reason, **self.figures}


@dataclass(frozen=True, eq=False)
class _View:
    """A dataset on the coarse grid that decisions are made by."""

    source: IlluminationDataset
    dataset: ThinnedDataset
    geometry: CoarseGeometry

    @classmethod
    def of(cls, source: IlluminationDataset) -> Self:
        whole = ObjectGeometry.of(source)
        grid = coarse_grid(len(whole.normals), LOOKED_AT)
        return cls(source, ThinnedDataset(source, whole.mask, grid), CoarseGeometry.on_grid(whole, grid))


@dataclass(frozen=True, eq=False)
class _Fit:
    """A model of the coarse grid, and what is believed by it."""

    model: ParametricModel
    belief: Belief


def planned_surface(dataset: IlluminationDataset, lights: Sequence[Light]) -> PlannedSurface | None:
    """Surface for `NextLight.first` on the coarse grid, without reading a picture; None where the set knows none."""
    if ObjectGeometry.lacking(dataset) is not None:
        return None
    whole = ObjectGeometry.of(dataset)
    coarse = CoarseGeometry.on_grid(whole, coarse_grid(len(whole.normals), LOOKED_AT))
    lit = np.packbits(coarse.lit_by(lights).T, axis=1)
    return PlannedSurface(coarse.normals, coarse.view, coarse.points, lit)


class NextLight:
    """Chooses lights one after the other by what the photographs so far have taught.

    The same photographs give the same decision, whoever asks and however often: nothing is kept between decisions but
    what was read from a dataset that is still the same object. Photographs of lights that are not captured are never
    read.

    Parameters
    ----------
    lights : sequence of Light
        The candidates, all near or all distant.
    model : str
        A parametric model of `reconstruct.model.REGISTRY`, which the photographs are for.
    tolerance : float, optional
        Stop once the mean absolute error of held-out pictures over the object (``mae_object`` of
        `reconstruct.evaluate.Row`) is expected to be at most this, 8-bit grey levels. By default, and where it cannot
        be reached, the loop stops once all candidates together would make that error hardly smaller
        (`reconstruct.next_light.stopping.NEGLIGIBLE`, `UNSEEN`).
    aim : str
        What the next light shall make small: the expected squared error of pictures under `wanted_lights`
        (``relighting``), or trace (``a-optimal``) or determinant (``d-optimal``) of the parameters' covariance.
    batch : int
        Lights per decision, chosen together; fewer fits, and a few more photographs.
    most : int, optional
        Never capture more lights than this.
    wanted : sequence of Light, optional
        Lights that renderings shall be good for; by default spread evenly between the candidates.
    expected : ExpectedReflectance
        What the object is expected to reflect like before it has been photographed.
    seed : int
        Of the sampled points of the first choice.

    Raises
    ------
    InputError
        Names the argument.
    """

    def __init__(
        self,
        lights: Sequence[Light],
        *,
        model: str = "torrance-sparrow",
        tolerance: float | None = None,
        aim: Aim = "relighting",
        batch: int = 1,
        most: int | None = None,
        wanted: Sequence[Light] | None = None,
        expected: ExpectedReflectance | None = None,
        seed: int = 0,
    ) -> None:
        if not lights:
            raise InputError("candidates: the list of lights is empty")
        found = model_class(model)
        if not issubclass(found, ParametricModel):
            raise InputError(
                f"model: '{model}' has no parameters whose uncertainty could say which light comes next; choose "
                "lambert, method-1 or torrance-sparrow, or plan its lights beforehand by the method 'information'"
            )
        if tolerance is not None and not tolerance > 0:
            raise InputError(f"tolerance: expected grey levels above 0, got {tolerance:g}")
        if aim not in ("relighting", "a-optimal", "d-optimal"):
            raise InputError(f"aim: expected relighting, a-optimal or d-optimal, got {aim!r}")
        if batch < 1:
            raise InputError(f"batch: expected at least one light, got {batch}")
        if most is not None and most < 1:
            raise InputError(f"most: expected at least one light, got {most}")
        self.lights = tuple(lights)
        self.most = len(lights) if most is None else min(most, len(lights))
        self.tolerance, self.aim, self.batch = tolerance, aim, batch
        self._model = found
        self._wanted = None if wanted is None else list(wanted)
        self._expected = ExpectedReflectance() if expected is None else expected
        self._seed = seed
        self._view: _View | None = None

    def first(self, surface: PlannedSurface | None = None) -> tuple[int, ...]:
        """Candidates to begin with, before there is any photograph.

        Parameters
        ----------
        surface : PlannedSurface, optional
            What is to be lit: the lights are then those that would make the parameters of the expected reflectance most
            certain (D-optimal). Without it they are spread evenly.
        """
        count = min(FIRST, self.most)
        task = PlanningTask(
            self.lights, count=count, surface=surface, expected=self._expected, aim="d-optimal", seed=self._seed
        )
        return tuple((plan_farthest if surface is None else plan_parameters)(task).lights)

    def decide(
        self,
        dataset: IlluminationDataset,
        frames: Sequence[int],
        captured: Sequence[int],
        progress: Progress = no_progress,
    ) -> Decision:
        """Which lights come next, or that it is time to stop, and why.

        Parameters
        ----------
        dataset : IlluminationDataset
            Knows the surface.
        frames : sequence of int
            The frame of `dataset` that shows each of `captured`; no other frame is read.
        captured : sequence of int
            Candidates in the order of their capture.

        Raises
        ------
        InputError
            The model cannot be fitted to the dataset, or the arguments do not fit each other.
        """
        self._check(dataset, frames, captured)
        if self._view is None or self._view.source is not dataset:
            self._view = _View.of(dataset)
        view = self._view
        fit = self._fit(view, frames)
        progress(0.4)
        surprise = self._surprise(view, frames)
        progress(0.7)
        left = [i for i in range(len(self.lights)) if i not in set(captured)]
        wanted = self._wanted_about(view.geometry)
        expected = fit.belief.predicted_error(wanted)
        outlook = Outlook(
            now=expected.mean_absolute,
            floor=fit.belief.predicted_error(wanted, [self.lights[i] for i in left]).mean_absolute,
            surprise=surprise,
            captured=len(captured),
            left=len(left),
            misfit=expected.floor if self.aim == "relighting" and expected.floor > MISFIT else None,
        )
        verdict = judge(outlook, tolerance=self.tolerance, most=self.most)
        chosen: tuple[int, ...] = ()
        if not verdict.stop and outlook.misfit is not None:
            count = min(self.batch, self.most - len(captured))
            chosen = farthest_from(self.lights, captured, left, count, centre=_middle(view.geometry))
        elif not verdict.stop:
            chosen = self._choose(fit.belief, left, wanted, len(captured))
        progress(1.0)
        return self._decision(chosen, verdict, outlook)

    def _check(self, dataset: IlluminationDataset, frames: Sequence[int], captured: Sequence[int]) -> None:
        if len(frames) != len(captured) or not frames:
            raise InputError(f"captured: expected one frame per captured light, got {len(frames)} and {len(captured)}")
        if len(set(captured)) < len(captured) or not all(0 <= i < len(self.lights) for i in captured):
            raise InputError("captured: expected candidates, each of them once")
        lacking = self._model.cannot_fit(dataset)
        if lacking is not None:
            raise InputError(f"{dataset.source}: {self._model.name} cannot be fitted to this set: {lacking}")

    def _fit(self, view: _View, frames: Sequence[int]) -> _Fit:
        model = self._model.fit(view.dataset, frames, geometry=view.geometry)
        every: NDArray[np.int64] = np.arange(len(view.geometry.normals))
        return _Fit(model, belief(model, view.dataset, frames, every, expected=self._expected))

    def _surprise(self, view: _View, frames: Sequence[int]) -> float | None:
        """Error over expected error with which the earlier photographs predict the latest ones; None if they cannot."""
        back = min(max(LOOK_BACK, self.batch), len(frames) // 2)
        if not back:
            return None
        try:
            before = self._fit(view, frames[:-back])
        except InputError:  # on the earlier photographs alone nothing of the object can be used
            return None
        display, mask = before.belief.display, view.geometry.mask
        found, expected = 0.0, 0.0
        for i in frames[-back:]:
            light = view.dataset.frames[i].light
            real = display.grey(view.dataset.image(i)[mask])
            rendered = display.grey(before.model.render(light).image[mask])
            found += float(np.abs(real - rendered).mean())
            expected += before.belief.predicted_error([light]).mean_absolute
        return found / expected if expected > 0 else None

    def _wanted_about(self, geometry: ObjectGeometry) -> list[Light]:
        if self._wanted is not None:
            return self._wanted
        return wanted_lights(self.lights, centre=_middle(geometry))

    def _choose(self, known: Belief, left: list[int], wanted: list[Light], captured: int) -> tuple[int, ...]:
        """The batch that teaches most."""
        design = known.design([self.lights[i] for i in left], wanted, self.aim)
        design.choose(min(self.batch, self.most - captured))
        if self.batch > 1:
            design.exchange(_EXCHANGE_S)
        return tuple(left[k] for k in design.chosen)

    @staticmethod
    def _decision(chosen: tuple[int, ...], verdict: Verdict, outlook: Outlook) -> Decision:
        return Decision(chosen, verdict.reason, outlook.predicted, outlook.predicted_floor, outlook.ratio)


def _middle(geometry: ObjectGeometry) -> NDArray[np.float64]:
    """Point that lights are seen from: the object's middle, or the origin where only its normals are known."""
    return np.zeros(3) if geometry.points is None else np.asarray(geometry.points.mean(axis=0))
