"""Charts models against each other on lights they were not fitted to: error, seconds and memory."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.dataset import IlluminationDataset
from reconstruct.grey_levels import GreyLevels
from reconstruct.holdout import Split, hold_out
from reconstruct.metrics import Score, score
from reconstruct.model import Model, Progress, Rendering, model_class, no_progress
from reconstruct.resources import PeakMemory
from reconstruct.warm_up import warm_up
from stage.camera import Camera
from stage.errors import InputError
from stage.lights import Light

DEFAULT_HOLDOUT = "every:5"
FIT_SHARE = 0.7
"""Share of a model's progress that its fit is taken to be; the rest is rendering."""


@dataclass(frozen=True)
class Row:
    """One line of the table of models; every figure is a mean over the held-out images unless it says otherwise.

    Attributes
    ----------
    model : str
        Registered name.
    train, test : int
        Images fitted to and images judged. With folds `test` counts all folds and `train` is the mean, rounded.
    mae, psnr, ssim : float
        Full frame, 8-bit, see `reconstruct.metrics.Score`; off the object a model renders 0. `ssim` is None for
        pictures smaller than its window.
    mae_object, psnr_object : float or None
        Over the object's pixels; None without a mask.
    outside : float
        Share of the object's pixels whose light lay outside what was sampled.
    fit_s : float
        Seconds of one fit (mean over folds) on a warm process: compilation is not in it, reading the images is.
    render_ms_per_megapixel : float
        Milliseconds of the median rendering over full-frame megapixels; the very first one, which may build tables, is
        not among them.
    peak_mib : float
        Largest resident memory of the process while fitting and rendering, MiB.
    statistics : dict
        What the model counted (saturated, dark, shadowed observations and the like), from the last fit.
    """

    model: str
    train: int
    test: int
    mae: float
    psnr: float
    ssim: float | None
    mae_object: float | None
    psnr_object: float | None
    outside: float
    fit_s: float
    render_ms_per_megapixel: float
    peak_mib: float
    statistics: dict[str, float] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """Return the row as one flat JSON object; object-only figures are left out where the set has no mask."""
        row = {key: value for key, value in vars(self).items() if key != "statistics"}
        if self.mae_object is None:
            del row["mae_object"], row["psnr_object"]
        return row | {"statistics": self.statistics}


@dataclass(frozen=True)
class HeldOut:
    """One held-out image: its number in the judged set, its light, its error and its share outside what was sampled."""

    index: int
    light: Light
    score: Score
    outside: float


@dataclass(frozen=True)
class Comparison:
    """One held-out image beside its rendering, both (height, width, 3) uint8, and the (height, width) outside mask."""

    index: int
    light: Light
    real: NDArray[np.uint8]
    rendered: NDArray[np.uint8]
    outside: NDArray[np.bool_]


@dataclass(frozen=True)
class ModelResult:
    """All that evaluating one model yields.

    Attributes
    ----------
    row : Row
        Its line in the table.
    images : list of HeldOut
        Every held-out image, in order of its number.
    comparisons : list of Comparison
        For the lights of `Evaluation.shown`.
    inspected : object
        What the caller's `inspect` made of the fitted model.
    """

    row: Row
    images: list[HeldOut]
    comparisons: list[Comparison]
    inspected: Any = None


@dataclass(frozen=True)
class Evaluation:
    """The table of models and what a report shows beside it.

    Attributes
    ----------
    results : list of ModelResult
        In the order asked for.
    splits : list of Split
        What was held out; a test set of its own is one split, whose `test` counts the test set's images.
    shown : list of int
        Held-out images of the last split: the first model's worst, median and best (fewer if they coincide).
    white : float
        Linear radiance that became 255; 1 for 8-bit sets, which keep their stored scale.
    """

    results: list[ModelResult]
    splits: list[Split]
    shown: list[int]
    white: float

    @property
    def rows(self) -> list[Row]:
        """The table."""
        return [result.row for result in self.results]


Inspect = Callable[[Model, Split, list[int]], Any]
"""Called once per model, before it is dropped: the model of the last split, that split, `Evaluation.shown`."""


def evaluate(
    dataset: IlluminationDataset,
    models: Sequence[str],
    *,
    holdout: str | None = None,
    test: IlluminationDataset | None = None,
    progress: Progress = no_progress,
    inspect: Inspect | None = None,
) -> Evaluation:
    """Fit each model to some lights and judge it on the others.

    Held-out images are rendered with their own light and intensity, so the rendering is on the set's own scale
    (`reconstruct.grey_levels.GreyLevels`; with a test set of its own, that set's scale). Models are worked one at a
    time and dropped, so that the memory of one does not count for the next.

    Parameters
    ----------
    dataset : IlluminationDataset
        Fitted to, and judged on where no `test` is given.
    models : sequence of str
        Registered names.
    holdout : str, optional
        See `reconstruct.holdout.hold_out`; ``every:5`` where neither this nor `test` is given.
    test : IlluminationDataset, optional
        A set of its own to judge on, of the same view; the models are then fitted to all of `dataset`.
    inspect : callable, optional
        Sees every fitted model before it is dropped.

    Raises
    ------
    InputError
        Before any fit: an unknown model, one that cannot be fitted to this dataset, a hold-out rule that cannot be met,
        or a test set of another view.
    """
    classes = _checked(dataset, models)
    judged = dataset if test is None else test
    if test is None:
        splits = hold_out(holdout or DEFAULT_HOLDOUT, len(dataset.frames))
    elif holdout is not None:
        raise InputError("--holdout, --test: give one of the two; a test set of its own leaves nothing to hold out")
    else:
        check_same_view(dataset, test)
        splits = [Split(tuple(range(len(dataset.frames))), tuple(range(len(test.frames))))]
    levels = GreyLevels(judged)
    shown: list[int] = []
    results = []
    for number, found in enumerate(classes):
        run = _Run(found, dataset, judged, levels, _part(progress, number, len(classes)))
        warm_up(found, dataset, splits[0].train)
        for fold, split in enumerate(splits):
            model = run.split(split, fold, len(splits))
        shown = shown or run.shown(splits[-1])
        comparisons = [run.compare(model, index) for index in shown]
        inspected = inspect(model, splits[-1], shown) if inspect is not None else None
        results.append(
            ModelResult(run.row(model, splits), sorted(run.images, key=lambda i: i.index), comparisons, inspected)
        )
        del model
    progress(1.0)
    return Evaluation(results, splits, shown, levels.white)


def _part(progress: Progress, number: int, count: int) -> Progress:
    """Progress of step `number` of `count` equal ones."""
    return lambda share: progress((number + share) / count)


def _checked(dataset: IlluminationDataset, models: Sequence[str]) -> list[type[Model]]:
    if not models:
        raise InputError("--model: name at least one model")
    classes = [model_class(name) for name in models]
    for found in classes:
        check_can_fit(found, dataset)
    return classes


def check_can_fit(model: type[Model], dataset: IlluminationDataset) -> None:
    """Raise `InputError` that says what `dataset` lacks for `model`."""
    lacking = model.cannot_fit(dataset)
    if lacking is not None:
        raise InputError(f"{dataset.source}: {model.name} cannot be fitted to this set: {lacking}")


def check_same_view(dataset: IlluminationDataset, test: IlluminationDataset) -> None:
    """Raise `InputError` unless both sets were taken by one camera from one place, with lights of one kind."""
    ours, theirs = (dataset.width, dataset.height), (test.width, test.height)
    if ours != theirs:
        raise InputError(
            f"{test.source}: images: {theirs[0]} x {theirs[1]} pixels; the fitted set has {ours[0]} x {ours[1]}"
        )
    a, b = dataset.camera, test.camera
    if a is not None and b is not None and not same_camera(a, b):
        raise InputError(f"{test.source}: camera: differs from the camera of the fitted set {dataset.source}")


def same_camera(a: Camera, b: Camera) -> bool:
    """Whether two cameras see alike, to a millionth of a pixel's scale, a micrometre and a microradian."""
    return (
        (a.width, a.height) == (b.width, b.height)
        and np.allclose(a.K, b.K, rtol=1e-6)
        and np.allclose(a.world_to_camera, b.world_to_camera, atol=1e-6)
        and np.array_equal(a.distortion, b.distortion)
    )


class _Run:
    """One model over all splits."""

    def __init__(
        self,
        model: type[Model],
        dataset: IlluminationDataset,
        judged: IlluminationDataset,
        levels: GreyLevels,
        progress: Progress,
    ) -> None:
        self._model, self._dataset, self._judged, self._levels, self._progress = (
            model,
            dataset,
            judged,
            levels,
            progress,
        )
        self._mask = dataset.mask if not dataset.mask.all() else judged.mask
        self._memory = PeakMemory()
        self._fit_s: list[float] = []
        self._render_s: list[float] = []
        self.images: list[HeldOut] = []

    def split(self, split: Split, fold: int, folds: int) -> Model:
        """Fit to one split and judge it."""
        self._memory.start()
        begin = time.perf_counter()
        model = self._model.fit(
            self._dataset, split.train, lambda share: self._progress((fold + FIT_SHARE * share) / folds)
        )
        self._fit_s.append(time.perf_counter() - begin)
        self._memory.stop()
        self._render(model, split.test[0])
        for number, index in enumerate(split.test):
            self._memory.start()
            begin = time.perf_counter()
            rendering = self._render(model, index)
            self._render_s.append(time.perf_counter() - begin)
            self._memory.stop()
            self.images.append(self._judge(index, rendering))
            self._progress((fold + FIT_SHARE + (1 - FIT_SHARE) * (number + 1) / len(split.test)) / folds)
        return model

    def _render(self, model: Model, index: int) -> Rendering:
        try:
            return model.render(self._judged.frames[index].light)
        except InputError as error:
            # A model speaks of "light.position"; here the light has a place in a file.
            raise InputError(f"{self._judged.source}: frames[{index}].{error}") from None

    def _judge(self, index: int, rendering: Rendering) -> HeldOut:
        if not np.isfinite(rendering.image).all():
            raise ArithmeticError(f"{self._model.name} rendered a value that is not finite for image {index}")
        mask = None if self._mask.all() else self._mask
        found = score(self._levels.real(index), self._levels.rendered(index, rendering.image), mask)
        return HeldOut(index, self._judged.frames[index].light, found, float(rendering.outside[self._mask].mean()))

    def shown(self, split: Split) -> list[int]:
        """Held-out images of `split` from worst over median to best PSNR."""
        ranked = sorted((i for i in self.images if i.index in set(split.test)), key=lambda i: i.score.psnr)
        return list(dict.fromkeys(ranked[k].index for k in (0, len(ranked) // 2, len(ranked) - 1)))

    def compare(self, model: Model, index: int) -> Comparison:
        """Render one image again, for people to look at."""
        light, rendering = self._judged.frames[index].light, self._render(model, index)
        return Comparison(
            index, light, self._levels.real(index), self._levels.rendered(index, rendering.image), rendering.outside
        )

    def row(self, model: Model, splits: Sequence[Split]) -> Row:
        """Means over all splits."""
        scores = [image.score for image in self.images]
        megapixels = self._dataset.height * self._dataset.width / 1e6
        return Row(
            model=self._model.name,
            train=round(float(np.mean([len(split.train) for split in splits]))),
            test=len(self.images),
            mae=float(np.mean([s.mae for s in scores])),
            psnr=float(np.mean([s.psnr for s in scores])),
            ssim=_mean([s.ssim for s in scores]),
            mae_object=_mean([s.mae_object for s in scores]),
            psnr_object=_mean([s.psnr_object for s in scores]),
            outside=float(np.mean([image.outside for image in self.images])),
            fit_s=float(np.mean(self._fit_s)),
            render_ms_per_megapixel=1000 * float(np.median(self._render_s)) / megapixels,
            peak_mib=self._memory.mib,
            statistics=model.statistics(),
        )


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None
