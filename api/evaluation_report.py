"""From an evaluation to what its report shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version

import numpy as np
from numpy.typing import NDArray

from acquisition.dataset import IlluminationDataset
from api.report.content import (
    Comparison,
    MapView,
    ReflectanceFunction,
    ReportContent,
    StageView,
    TripletView,
)
from api.report.figures import angles_deg
from api.report.imaging import common_exposure, display
from reconstruct.apparent_brdf.model import ApparentBrdf
from reconstruct.evaluate import Evaluation, ModelResult
from reconstruct.grey_levels import WHITE_PERCENTILE
from reconstruct.holdout import Split
from reconstruct.model import Model
from stage.lights import Light, light_vectors

LIVELY_PERCENTILE = 99.0
"""The pixel whose reflectance is plotted varies more over the lights than this share of the object's pixels."""


_NOT_PICTURED = {"correlation", "estimated_diffuse", "estimated_specular"}
"""Maps for machines: what a person wants of them stands in `estimated` and the maps of standard deviations."""


@dataclass(frozen=True, eq=False)
class Seen:
    """What is kept for the report of a fitted model that is dropped.

    Attributes
    ----------
    maps : dict of (height, width) or (height, width, 3) float32
    limits : list of str
    triplets : TripletView or None
        For a model that blends photographs.
    """

    maps: dict[str, NDArray[np.float32]]
    limits: list[str]
    triplets: TripletView | None


@dataclass(frozen=True)
class Inspector:
    """Called by `reconstruct.evaluate.evaluate` with each fitted model.

    Attributes
    ----------
    judged : IlluminationDataset
        The set whose images are held out.
    """

    judged: IlluminationDataset

    def __call__(self, model: Model, split: Split, shown: list[int]) -> Seen:
        """See `reconstruct.evaluate.Inspect`; the triplets are those of the median light."""
        light = self.judged.frames[shown[len(shown) // 2]].light
        triplets = triplets_of(model, light) if isinstance(model, ApparentBrdf) else None
        return Seen(model.maps(), model.limits(), triplets)


def triplets_of(model: ApparentBrdf, light: Light) -> TripletView:
    """Which triplet of photographed lights rendered which pixel (K20), with the rendering."""
    mesh, image = model.mesh, model.render(light).image
    return TripletView(
        triples=model.triplets(light),
        lights=mesh.vectors if mesh.distant else mesh.vectors + mesh.centre,
        facets=mesh.facets,
        wanted=light,
        distant=mesh.distant,
        rendered=display(image, common_exposure([image])),
        model=model.name,
    )


def evaluation_content(
    evaluation: Evaluation, dataset: IlluminationDataset, judged: IlluminationDataset
) -> ReportContent:
    """What the report of ``evaluate`` shows; the models must have been seen by an `Inspector`."""
    train = evaluation.splits[-1].train
    picture = mean_picture(dataset, train)
    best = min(evaluation.rows, key=lambda row: row.mae)
    return ReportContent(
        title=f"{dataset.name}: models on lights they were not fitted to",
        lede=f"Each model was fitted to {best.train} photographs and rendered {best.test} others it had not seen.",
        summary=(
            ("images", f"{len(dataset.frames)} of {dataset.width} x {dataset.height}"),
            ("least error", f"{best.model}: {best.mae:.2f} grey levels, {best.psnr:.2f} dB"),
        ),
        stage=stage_view(dataset, picture),
        comparisons=comparisons(evaluation, linear=not judged.is_eight_bit),
        triplets=next((seen.triplets for seen in _seen(evaluation) if seen.triplets is not None), None),
        reflectance=reflectance_of(dataset, train, picture),
        maps=maps_of(evaluation, dataset.mask),
        models=tuple(table_row(result) for result in evaluation.results),
        models_scale=scale_sentence(evaluation, judged),
        timings={f"fit {row.model}": row.fit_s for row in evaluation.rows},
        counts=counts_of(evaluation),
        limits=tuple(dict.fromkeys(limit for seen in _seen(evaluation) for limit in seen.limits)),
        provenance={
            "software": f"lightstage {version('lightstage')}",
            "dataset": dataset.name,
            "judged on": judged.name,
        },
    )


def _seen(evaluation: Evaluation) -> list[Seen]:
    return [result.inspected for result in evaluation.results if isinstance(result.inspected, Seen)]


def table_row(result: ModelResult) -> Mapping[str, object]:
    """A model's row without the statistics, which are the report's counts."""
    return {key: value for key, value in result.row.to_json().items() if key != "statistics"}


def mean_picture(dataset: IlluminationDataset, frames: Sequence[int], most: int = 12) -> NDArray[np.uint8]:
    """The object as many lights together would show it, (height, width, 3) sRGB; at most `most` images are read."""
    some = [frames[i] for i in np.unique(np.linspace(0, len(frames) - 1, min(most, len(frames))).astype(int))]
    total = np.zeros((dataset.height, dataset.width, 3), np.float32)
    for i in some:
        total += dataset.image(i)
    return display(total, common_exposure([total]))


def stage_view(
    dataset: IlluminationDataset,
    picture: NDArray[np.uint8],
    candidates: Sequence[Light] | None = None,
    chosen: Sequence[int] = (),
) -> StageView | None:
    """Lights (the dataset's, or those to choose from), camera and surface; None where near and distant are mixed."""
    lights = list(candidates or dataset.lights)
    if len({light.is_distant for light in lights}) > 1:
        return None
    view = StageView(light_vectors(lights), tuple(chosen), lights[0].is_distant, dataset.camera)
    if dataset.points is None:
        return view
    on = dataset.mask & np.isfinite(dataset.points).all(-1)
    return replace(view, surface=dataset.points[on], surface_rgb=picture[on])


def comparisons(evaluation: Evaluation, *, linear: bool) -> tuple[Comparison, ...]:
    """Real against rendered (Fig. 6 of paper 001): light by light, every model, the best first."""
    out = []
    for number in range(len(evaluation.shown)):
        for result in sorted(evaluation.results, key=lambda r: r.row.mae):
            pair = result.comparisons[number]
            found = next(image.score for image in result.images if image.index == pair.index)
            out.append(
                Comparison(
                    light=light_label(pair.index, pair.light),
                    model=result.row.model,
                    real=pair.real,
                    rendered=pair.rendered,
                    mae=found.mae,
                    psnr=found.psnr,
                    ssim=found.ssim,
                    linear=linear,
                )
            )
    return tuple(out)


def light_label(index: int, light: Light) -> str:
    """Number of the photograph and where its light stands, as seen from the stage's centre."""
    azimuth, elevation = angles_deg(light_vectors([light]))
    return f"photograph {index}, azimuth {azimuth[0]:.0f}°, elevation {elevation[0]:.0f}°"


def maps_of(evaluation: Evaluation, mask: NDArray[np.bool_]) -> MapView | None:
    """Parameter maps (Fig. 10 of paper 003) of the model of least error among those with the most maps."""
    with_maps = [r for r in evaluation.results if isinstance(r.inspected, Seen) and r.inspected.maps]
    if not with_maps:
        return None
    result = min(with_maps, key=lambda r: ("specular" not in r.inspected.maps, r.row.mae))
    maps = {name: values for name, values in result.inspected.maps.items() if name not in _NOT_PICTURED}
    estimated = maps.pop("estimated", None)
    return MapView(maps, result.row.model, mask, None if estimated is None else estimated > 0.5)


def reflectance_of(
    dataset: IlluminationDataset, frames: Sequence[int], picture: NDArray[np.uint8]
) -> ReflectanceFunction | None:
    """One lively pixel's radiance over light direction (Fig. 1 of paper 001, K19), photographs only."""
    if dataset.points is None and not all(light.is_distant for light in dataset.lights):
        return None
    total = np.zeros((dataset.height, dataset.width))
    squares = np.zeros_like(total)
    for i in frames:
        value = dataset.image(i).mean(-1)
        total += value
        squares += value.astype(float) ** 2
    spread = squares / len(frames) - (total / len(frames)) ** 2
    on = dataset.mask if dataset.points is None else dataset.mask & np.isfinite(dataset.points).all(-1)
    wanted = np.percentile(spread[on], LIVELY_PERCENTILE)
    row, column = np.unravel_index(np.argmin(np.where(on, np.abs(spread - wanted), np.inf)), spread.shape)
    pixel = int(row), int(column)
    values = np.array([dataset.image(i)[pixel] for i in frames], dtype=float)
    values[[not dataset.valid(i)[pixel] for i in frames]] = np.nan
    vectors = light_vectors([dataset.lights[i] for i in frames])
    directions = vectors if dataset.points is None or dataset.lights[0].is_distant else vectors - dataset.points[pixel]
    return ReflectanceFunction(directions, values, pixel, picture)


def scale_sentence(evaluation: Evaluation, judged: IlluminationDataset) -> str:
    """What 255 grey levels are."""
    if judged.is_eight_bit:
        return "Grey levels are the photographs' own, as stored, 0 to 255."
    return (
        f"255 grey levels are the {WHITE_PERCENTILE}th percentile of the object's values over all images "
        f"(radiance {evaluation.white:.4g}); the scale is linear and brighter values are clipped."
    )


def counts_of(evaluation: Evaluation) -> dict[str, float]:
    """What became of the observations, as the first model that sorts them counts them; else what any model counts."""
    by_model = [row.statistics for row in evaluation.rows]
    sorting = next((found for found in by_model if "observations" in found), None)
    if sorting is None:
        kept = {key: value for found in by_model for key, value in found.items()}
        return {key.replace("_", " "): value for key, value in kept.items() if "saturated" in key or "dark" in key}
    kinds = {k.removeprefix("observations_"): v for k, v in sorting.items() if k.startswith("observations_")}
    return {"observations": sorting["observations"], **{k.replace("_", " "): v for k, v in kinds.items()}}
