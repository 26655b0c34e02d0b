"""A small report with every part filled in, from closed forms: no photograph, no model."""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull

from api.report.content import (
    Comparison,
    Coverage,
    MapView,
    ReflectanceFunction,
    Relit,
    ReportContent,
    StageView,
    TripletView,
)
from stage.camera import Camera
from stage.lights import Light, dome, light_vectors

SIZE = (24, 32)
LIGHTS = light_vectors(dome(8, np.radians([15, 40, 65]), 0.8))
FACETS = ConvexHull(LIGHTS).simplices


def picture(seed: int = 0, shape: tuple[int, int] = SIZE) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (*shape, 3), dtype=np.uint8)


def comparison(light: str = "light 3", model: str = "lambert", shift: int = 4, linear: bool = False) -> Comparison:
    """A pair that differs by `shift` grey levels in every channel of every pixel."""
    real = picture() // 2
    return Comparison(light, model, real, (real + shift).astype(np.uint8), float(shift), 31.0, 0.9, linear)


def triplets() -> TripletView:
    """Upper half by the first facet, lower half by the second, a corner by none."""
    triples = np.empty((*SIZE, 3), dtype=int)
    triples[:12], triples[12:] = FACETS[0], FACETS[1][[2, 0, 1]]
    triples[:3, :3] = -1
    return TripletView(triples, LIGHTS, FACETS, Light(position=(0.1, -0.1, 0.3)), False, picture(2))


def full() -> ReportContent:
    mask = np.zeros(SIZE, dtype=bool)
    mask[4:20, 6:26] = True
    ramp = np.linspace(0.1, 0.4, SIZE[0] * SIZE[1]).reshape(SIZE) * mask
    maps = {
        "diffuse": np.repeat(ramp[..., None], 3, axis=-1),
        "specular": ramp / 5,
        "roughness": ramp[..., None],
        "normals": np.broadcast_to([0.0, 0.6, 0.8], (*SIZE, 3)) * mask[..., None],
        "std_roughness": ramp / 50,
    }
    estimated = mask & (np.arange(SIZE[1]) < 16)
    camera = Camera.look_at(32, 24, 60, (0, -0.9, 0.6))
    row = {"train": 19, "test": 5, "psnr": 31.0, "ssim": 0.9, "fit_s": 0.5, "peak_mib": 120.0}
    return ReportContent(
        title="A sphere on a plate",
        lede="Twenty-four lights, two models.",
        summary=(("lights used", "5 of 24"), ("mean error", "4.00 grey levels")),
        stage=StageView(LIGHTS, (9, 2, 17, 5, 20), False, camera, LIGHTS / 8, (127 * (1 + LIGHTS)).astype(np.uint8)),
        coverage=Coverage(((1, 0.4, 0.2), (2, 0.8, 0.5), (3, 0.95, 0.62)), 1.0, 0.8, 0.8, "greedy", 2),
        comparisons=(comparison(), comparison(model="ptm", shift=9)),
        relit=(Relit("a low light", np.repeat(ramp[..., None], 3, axis=-1), ~mask),),
        triplets=triplets(),
        reflectance=ReflectanceFunction(LIGHTS, np.repeat(LIGHTS[:, 2:], 3, axis=1), (10, 12), picture(3)),
        maps=MapView(maps, "torrance-sparrow", mask, estimated),
        models=(
            {"model": "lambert", "mae": 4.0, "render_ms_per_megapixel": 20.0} | row,
            {"model": "ptm", "mae": 9.0, "render_ms_per_megapixel": None} | row | {"fit_s": 2.0},
        ),
        models_scale="255 is the brightest value that the files hold.",
        timings={"plan": 1.0, "fit": 3.0},
        counts={"observations": 1000, "saturated": 5, "dark": 20, "shadowed": 250, "outside": 0},
        limits=("Metals are outside of the model.",),
        provenance={"command": "lightstage demo", "date": "2025-01-31"},
    )
