"""How plans go wrong: what a plan believes to show, what it truly shows, how well the fit relights, and what is said.

In each case the planner knows a surface, lights and a roughness that are wrong in one way. It chooses among 60 lights;
the photographs are then simulated by equation (1) with what is true, fitted by least squares with what is believed, and
compared under lights that no plan has. ``python -m benchmarks.planning_stability PICTURE`` draws it.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from api.report.canvas import CHOSEN, INK, MUTED, blank, write
from reconstruct.fitting.least_squares import LobeFit, fit_lobes
from reconstruct.fitting.levels import Noise
from reconstruct.fitting.observations import observe
from reconstruct.reflectance.torrance_sparrow import MIN_COS_VIEW, half_angle, radiance
from stage.camera import Camera
from stage.expected_reflectance import ExpectedReflectance
from stage.lights import Light, dome
from stage.measurability import LobeCriterion, measurability
from stage.planning import PlanningTask, plan
from stage.planning.advice import advice
from stage.planning.task import PlannedSurface
from stage.surface import fit_surface, triangulate_depth
from stage.visibility import Occluder, render_geometry

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SIDE_PX = 120
TARGET = 0.95
DOME_M = 2.5
READ_NOISE = 0.01
"""Standard deviation of a photograph's noise, as a share of a white surface square to the light."""

PLAIN = ExpectedReflectance(roughness_rad=float(np.radians(8.0)))


@dataclass(frozen=True)
class Case:
    """One way to be wrong.

    Attributes
    ----------
    depth_noise_m, normal_noise_rad : float
        Of the surface that the planner and the fit know; the object is about 1 m wide.
    true, expected : ExpectedReflectance
        What the object reflects like, and what the planner reckons with.
    lights_off_rad : float
        By how much each light truly stands aside, in a direction of its own.
    bumps_m : float
        Height of the object's bumps.
    one_side : bool
        Only candidates on the right.
    """

    name: str
    depth_noise_m: float = 0.0
    normal_noise_rad: float = 0.0
    true: ExpectedReflectance = PLAIN
    expected: ExpectedReflectance = PLAIN
    lights_off_rad: float = 0.0
    bumps_m: float = 0.03
    one_side: bool = False


def with_roughness(degrees: float, specular: float = PLAIN.specular) -> ExpectedReflectance:
    """`PLAIN` with another lobe."""
    return replace(PLAIN, specular=specular, roughness_rad=float(np.radians(degrees)))


CASES = (
    Case("as it is believed"),
    Case("depth noise 0.5 mm", depth_noise_m=0.5e-3),
    Case("depth noise 2 mm", depth_noise_m=2e-3),
    Case("normals off by 3 degrees", normal_noise_rad=float(np.radians(3.0))),
    Case("normals off by 10 degrees", normal_noise_rad=float(np.radians(10.0))),
    Case("truly half as rough", true=with_roughness(4.0)),
    Case("truly twice as rough", true=with_roughness(16.0)),
    Case("lights off by 1 degree", lights_off_rad=float(np.radians(1.0))),
    Case("lights off by 5 degrees", lights_off_rad=float(np.radians(5.0))),
    Case("mirror-like, and expected so", true=with_roughness(0.5), expected=with_roughness(0.5)),
    Case("mirror-like, not expected", true=with_roughness(0.5)),
    Case("matte, and expected so", true=with_roughness(8.0, 0.0), expected=with_roughness(8.0, 0.0)),
    Case("matte, not expected", true=with_roughness(8.0, 0.0)),
    Case("shadows itself heavily", bumps_m=0.3),
    Case("candidates on one side", one_side=True),
)


@dataclass(frozen=True, eq=False)
class Surface:
    """Object pixels, and what throws shadows on them."""

    points: Array
    normals: Array
    view: Array
    occluder: Occluder


def run() -> list[dict[str, Any]]:
    """All cases.

    Returns
    -------
    list of dict
        Per case: ``lights`` chosen, ``believed`` and ``true`` shares of the object's pixels (``diffuse`` once,
        ``specular`` twice), relative ``error`` of relighting with the plan, ``error_all`` with all candidates, and what
        the planner ``said``.
    """
    return [figures(case) for case in CASES]


def figures(case: Case, seed: int = 0) -> dict[str, Any]:
    """One case, planned, captured and fitted."""
    rng = np.random.default_rng(seed)
    truth, known = surfaces(case, rng)
    lights = [
        light for light in dome(12, np.radians([15, 30, 45, 60, 75]), DOME_M) if not case.one_side or _right(light)
    ]
    standing = [_moved(light, case.lights_off_rad, rng) for light in lights]
    criterion = LobeCriterion(case.expected)
    seen = measurability(
        known.points, known.normals, known.view, lights, occluder=known.occluder, criterion=criterion, lit=True
    )
    surface = PlannedSurface(known.normals, known.view, known.points, seen.lit_bits)
    task = PlanningTask(lights, seen, target=TARGET, expected=case.expected, surface=surface)
    chosen = plan("greedy", task)
    photographs = np.stack([photograph(truth, light, case.true, rng) for light in standing])
    return {
        "case": case.name,
        "lights": chosen.count,
        "believed": {part: chosen.coverage[part] for part in ("diffuse", "specular")},
        "true": truly_shown(truth, [standing[k] for k in chosen.lights], case.true),
        "error": relit(case, truth, known, lights, photographs, chosen.lights),
        "error_all": relit(case, truth, known, lights, photographs, range(len(lights))),
        "said": advice(task, chosen),
    }


def surfaces(case: Case, rng: np.random.Generator) -> tuple[Surface, Surface]:
    """The bumpy ball as it is, and as it is known; the same pixels."""
    ball = trimesh.creation.icosphere(subdivisions=6, radius=0.5)
    x, y, z = 2 * np.asarray(ball.vertices).T
    bumps = np.sin(5 * x + 1) * np.sin(6 * y + 1) * np.cos(5 * z)
    corners = np.asarray(ball.vertices) * (1 + 2 * case.bumps_m * bumps)[:, None]
    camera = Camera.look_at(SIDE_PX, SIDE_PX, 2.6 * SIDE_PX, (0, -0.8, 3.0))
    depth, normals, mask = render_geometry(corners, ball.faces, camera)
    known_depth, known_normals = depth, normals
    if case.depth_noise_m:
        fitted = fit_surface(np.where(mask, depth + rng.normal(0, case.depth_noise_m, depth.shape), 0.0), camera, mask)
        known_depth, known_normals, mask = fitted.depth, fitted.normals, mask & fitted.valid
    if case.normal_noise_rad:
        known_normals = known_normals + np.tan(case.normal_noise_rad) * rng.normal(size=normals.shape) / np.sqrt(2)
        known_normals = known_normals / np.maximum(np.linalg.norm(known_normals, axis=-1, keepdims=True), 1e-9)
    both = []
    for distance, normal in ((depth, normals), (known_depth, known_normals)):
        points = camera.depth_to_points(np.where(mask, distance, 0.0))
        view = camera.centre - points[mask]
        view /= np.linalg.norm(view, axis=-1, keepdims=True)
        both.append(Surface(points[mask], normal[mask], view, Occluder(*triangulate_depth(points))))
    return both[0], both[1]


def rendered(surface: Surface, light: Light, p_d: Array, p_s: Array, sigma: Array) -> Array:
    """Equation (1) with cast shadows, (P,)."""
    to_light, attenuation = light.incident(surface.points)
    cos_view = np.einsum("pi,pi->p", surface.normals, surface.view)
    value = radiance(
        p_d,
        p_s,
        sigma,
        cos_light=np.einsum("pi,pi->p", surface.normals, to_light),
        cos_view=np.where(cos_view > 0, np.maximum(cos_view, MIN_COS_VIEW), cos_view),
        half_angle=half_angle(surface.normals, surface.view, to_light),
        strength=DOME_M**2 * attenuation,
    )
    return np.where(surface.occluder.lit(surface.points, surface.normals, light), value, 0.0)


def photograph(surface: Surface, light: Light, material: ExpectedReflectance, rng: np.random.Generator) -> Array:
    """What the camera sees, with noise."""
    clean = rendered(surface, light, *_even(surface, material))
    return clean + rng.normal(0, READ_NOISE / np.pi, clean.shape)


def truly_shown(surface: Surface, lights: Sequence[Light], material: ExpectedReflectance) -> dict[str, float]:
    """Coverage of lights where they stand, on the surface as it is, for the lobe as it is."""
    seen = measurability(
        surface.points, surface.normals, surface.view, lights,
        occluder=surface.occluder, criterion=LobeCriterion(material),
    )  # fmt: skip
    return {"diffuse": float(seen.diffuse.any(0).mean()), "specular": float((seen.specular.sum(0) >= 2).mean())}


def relit(
    case: Case, truth: Surface, known: Surface, lights: list[Light], photographs: Array, chosen: Sequence[int]
) -> float:
    """Root mean square error under new lights over the root mean square of what is seen there."""
    used = [lights[k] for k in chosen]
    images = np.repeat(photographs[list(chosen)][..., None], 3, axis=-1).astype(np.float32)
    lit = np.array([known.occluder.lit(known.points, known.normals, light) for light in used])
    observed = observe(
        images,
        np.ones(images.shape[:2], bool),
        np.arange(len(known.points)),
        lights=[replace(light, intensity=(DOME_M**2,) * 3) for light in used],
        normals=known.normals,
        view=known.view,
        points=known.points,
        lit=lit,
    )
    parameters = _filled(fit_lobes(observed, Noise((READ_NOISE / np.pi) ** 2, 0.0)))
    wanted = dome(7, np.radians([22.0, 38.0, 55.0]), DOME_M)
    seen = np.array([rendered(truth, light, *_even(truth, case.true)) for light in wanted])
    made = np.array([rendered(known, light, *parameters) for light in wanted])
    return float(np.sqrt(((made - seen) ** 2).mean() / (seen**2).mean()))


def _filled(fit: LobeFit) -> tuple[Array, Array, Array]:
    """Parameters of every pixel: what was not found is the median of what was."""
    p_d = fit.p_d.mean(1)
    return (
        np.where(np.isfinite(p_d), p_d, np.nanmedian(p_d)),
        np.nan_to_num(fit.p_s),
        np.where(np.isfinite(fit.sigma), fit.sigma, 1.0),
    )


def _even(surface: Surface, material: ExpectedReflectance) -> tuple[Array, Array, Array]:
    one = np.ones(len(surface.points))
    return material.diffuse * one, material.specular * one, material.roughness_rad * one


def _right(light: Light) -> bool:
    return light.position is not None and light.position[0] > 0.1


def _moved(light: Light, angle_rad: float, rng: np.random.Generator) -> Light:
    place = np.asarray(light.position)
    axis = np.cross(place, rng.normal(size=3))
    turned = Rotation.from_rotvec(angle_rad * axis / np.linalg.norm(axis)).apply(place)
    return Light(position=tuple(turned))


def write_picture(path: Path) -> None:
    """Believed and true coverage and the error of each case, as bars."""
    rows = run()
    width, line, left, bar = 1280, 44, 300, 300
    canvas = blank(width, 70 + line * len(rows))
    write(canvas, "What a plan for 95 % believes to show, what it shows, and how well it relights", 20, 30, 18)
    heads = ("diffuse-only once", "highlight twice", "relighting error (line: all candidates)")
    for column, words in enumerate(heads):
        write(canvas, words, left + column * (bar + 25), 58, 14, MUTED)
    for number, row in enumerate(rows):
        top = 70 + number * line
        write(canvas, row["case"], 20, top + 20, 14)
        write(canvas, f"{row['lights']} light{'s' * (row['lights'] != 1)}", 20, top + 36, 11, MUTED)
        for column, part in enumerate(("diffuse", "specular")):
            x = left + column * (bar + 25)
            for share, y, colour in ((row["believed"][part], top + 6, MUTED), (row["true"][part], top + 20, CHOSEN)):
                cv2.rectangle(canvas, (x, y), (x + round(bar * share * 0.8), y + 11), colour, -1)
                write(canvas, f"{100 * share:.0f} %", x + round(bar * share * 0.8) + 6, y + 11, 11)
        x = left + 2 * (bar + 25)
        length, all_ = (round(0.8 * bar * min(1.0, row[key])) for key in ("error", "error_all"))
        cv2.rectangle(canvas, (x, top + 12), (x + length, top + 23), CHOSEN, -1)
        cv2.line(canvas, (x + all_, top + 8), (x + all_, top + 27), INK, 2)
        write(canvas, f"{100 * row['error']:.0f} %", x + max(length, all_) + 8, top + 23, 11)
    write(canvas, "grey: believed, orange: true", 20, 58, 12, MUTED)
    cv2.imwrite(str(path), canvas[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])


if __name__ == "__main__":
    if sys.argv[1:]:
        write_picture(Path(sys.argv[1]))
    else:
        print(json.dumps(run(), indent=1))
