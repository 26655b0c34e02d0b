"""Where a sphere is in a picture: its outline, given as a circle, taken from a mask, or detected.

Pixels as in `stage.camera`: (u, v) with the centre of column u, row v at (u, v).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import binary_dilation, label, map_coordinates
from scipy.optimize import least_squares
from skimage.measure import find_contours

from stage.camera import Camera
from stage.errors import InputError

Array = NDArray[np.float64]

SAMPLES = 360
"""Places on an outline that is given or detected."""

BY_HAND_PX = 0.5
"""Standard deviation of a circle that somebody measured."""

JIG_M = 0.0001
"""Standard deviation of a place on a jig, metres."""

LEAST_STD_PX = 0.03
"""Standard deviation of a circle through many edge points, at least: edges have their own bias."""

ALIKE = 10
"""Neighbouring points on an outline whose errors are taken to be the same."""

SMALLEST_PX = 6.0
"""Radius below which a sphere tells no direction: one pixel on its picture is then some 20 degrees of light."""

ROUND_SHARE = 0.03
"""RMS distance from a circle, as a share of the radius, above which a patch of a mask is no sphere."""

SEARCH_PX = 480
"""Longer side of the picture in which circles are looked for."""

SEARCH_SHARES = (0.08, 0.03, 0.015)
"""How far from a proposed circle its edge is looked for, in radii, each time about the circle found before."""

LIKE_SIZE_SHARE = 0.3
"""Radius, as a share of the largest detected one, below which a circle is taken for a reflection or a screw."""

FAINTEST_EDGE = 0.002
"""Slope per half pixel of the picture (0 to 1) below which there is no edge."""

EDGE_SHARE = 0.25
"""Slope of an edge, as a share of the steepest near by, from which on it may be the rim."""

SUPPORT_SHARE = 0.5
"""Share of a detected outline that must lie on an edge of the picture."""


@dataclass(frozen=True, eq=False)
class Outline:
    """The picture of a sphere's rim.

    Attributes
    ----------
    points : (n, 2) float
        Places on it, pixels.
    centre : (2,) float
        Of the circle nearest to them, pixels. Under perspective the outline is an ellipse, and neither its centre nor
        this one is the picture of the sphere's centre.
    radius : float
        Of that circle, pixels.
    rms_px : float
        Of the points' distances from the circle.
    std_px : float
        What the circle is taken to be off by in each of u, v and radius, standard deviation.
    """

    points: Array
    centre: Array
    radius: float
    rms_px: float
    std_px: float

    def share_of_radius(self, pixel: ArrayLike) -> float:
        """Distance of a pixel from the centre in radii: 0 there, 1 on the rim."""
        return float(np.linalg.norm(np.asarray(pixel, dtype=float) - self.centre) / self.radius)


def given_circle(u: float, v: float, radius: float) -> Outline:
    """Outline of a sphere whose circle was measured by hand; raises `InputError` where it is too small."""
    if not np.isfinite([u, v, radius]).all() or radius < SMALLEST_PX:
        raise InputError(
            f"sphere: expected u, v and a radius of at least {SMALLEST_PX:g} pixels, got {u}, {v}, {radius}"
        )
    turn = 2 * np.pi * np.arange(SAMPLES) / SAMPLES
    points = np.stack([u + radius * np.cos(turn), v + radius * np.sin(turn)], -1)
    return Outline(points, np.array([u, v], dtype=float), float(radius), 0.0, BY_HAND_PX)


def of_sphere(camera: Camera, centre: ArrayLike, radius_m: float, std_m: float = JIG_M) -> Outline:
    """Outline of a sphere whose place is known, metres in the world: on a jig that stands at the stage's origin.

    The tangents from the pinhole touch the sphere on a circle about the line to its centre.

    Parameters
    ----------
    centre : (3,) float
        World, metres.
    radius_m, std_m : float
        Its radius, and how far it may stand from there in each axis, standard deviation, metres.

    Raises
    ------
    InputError
        Where the camera does not see it whole, or the circle is too small.
    """
    c = np.asarray(centre, dtype=float)
    to_eye = camera.centre - c
    distance = float(np.linalg.norm(to_eye))
    if distance <= radius_m:
        raise InputError(f"sphere: the camera is inside the one at {c.tolist()}")
    axis = to_eye / distance
    side = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    side /= np.linalg.norm(side)
    turn = 2 * np.pi * np.arange(SAMPLES)[:, None] / SAMPLES
    ring = np.cos(turn) * side + np.sin(turn) * np.cross(axis, side)
    rim = c + radius_m * (radius_m / distance * axis + np.sqrt(1 - (radius_m / distance) ** 2) * ring)
    pixels, _ = camera.project(rim)
    if not (
        np.isfinite(pixels).all() and (pixels >= 0).all() and (pixels <= (camera.width - 1, camera.height - 1)).all()
    ):
        raise InputError(f"sphere: the camera does not see all of the one at {c.tolist()}")
    focal_px = float(np.sqrt(camera.K[0, 0] * camera.K[1, 1]))
    return replace(through(pixels), std_px=max(LEAST_STD_PX, std_m * focal_px / distance))


def through(points: ArrayLike) -> Outline:
    """Outline with the circle nearest to points on it, few outliers taking no part.

    Raises
    ------
    InputError
        Where the circle is too small.
    """
    p = np.asarray(points, dtype=float)
    # Kasa's circle: |p|^2 = 2 c.p + (r^2 - |c|^2) is linear in its unknowns; the geometric distance then refines it.
    middle = p.mean(0)
    q = p - middle
    solution, *_ = np.linalg.lstsq(np.column_stack([2 * q, np.ones(len(q))]), (q**2).sum(1), rcond=None)
    start = [*solution[:2], np.sqrt(max(solution[2] + solution[:2] @ solution[:2], 1e-12))]
    fit = least_squares(lambda c: np.linalg.norm(q - c[:2], axis=1) - c[2], start, loss="soft_l1", f_scale=0.15)
    centre, radius = fit.x[:2] + middle, float(fit.x[2])
    if radius < SMALLEST_PX:
        raise InputError(f"sphere: has a radius of {radius:.1f} pixels, expected at least {SMALLEST_PX:g}; come closer")
    distance = np.linalg.norm(p - centre, axis=1) - radius
    rms = float(np.sqrt(np.mean(distance**2)))
    return Outline(p, centre, radius, rms, max(LEAST_STD_PX, rms * float(np.sqrt(ALIKE / len(p)))))


def outlines_of_mask(mask: ArrayLike, source: str) -> list[Outline]:
    """Outlines of the round patches of a mask, from left to right.

    Parameters
    ----------
    mask : (height, width)
        Bool, or any number whose half of the largest is the outline, so that a smooth mask counts to sub-pixels.
    source : str
        Its file, for the error.

    Raises
    ------
    InputError
        Where no patch is there, or one is not round.
    """
    values = np.asarray(mask, dtype=float)
    values = values / values.max() if values.max() > 0 else values
    patches, count = label(values >= 0.5)
    found = []
    for number in range(1, count + 1):
        patch = patches == number
        if patch.sum() < np.pi * SMALLEST_PX**2:
            continue
        alone = np.where(binary_dilation(patch, iterations=2), values, 0)
        rims = find_contours(alone, 0.5)  # type: ignore[no-untyped-call]
        if not rims:
            raise InputError(f"{source}: mask: covers the whole picture; mark spheres only")
        outline = through(max(rims, key=len)[:, ::-1])
        if outline.rms_px > ROUND_SHARE * outline.radius:
            raise InputError(
                f"{source}: mask: the patch about u {outline.centre[0]:.0f}, v {outline.centre[1]:.0f} is not round "
                f"({100 * outline.rms_px / outline.radius:.1f} % of its radius off a circle); mark spheres only"
            )
        found.append(outline)
    if not found:
        raise InputError(f"{source}: mask: marks no sphere")
    return _left_to_right(found)


def refined(picture: ArrayLike, outline: Outline) -> Outline:
    """Move an outline that was measured by hand onto the edges of a picture, to a fraction of a pixel.

    Parameters
    ----------
    picture : (height, width) float
        Linear; the mean over all lights shows more of the rim than one picture does, and no shadow's edge.
    outline : Outline
        Right within some 5 % of its radius.

    Raises
    ------
    InputError
        Where too little of the rim shows.
    """
    u, v = outline.centre.tolist()
    found = _on_edges(_smooth(picture), u, v, outline.radius)
    if found is None:
        raise InputError(
            f"sphere: less than {100 * SUPPORT_SHARE:.0f} % of the rim about u {u:.0f}, v {v:.0f} shows in the "
            "pictures; give the circle more closely and as it is, or mark the sphere in a mask"
        )
    return found[1]


def detect_outlines(picture: ArrayLike, count: int | None = None) -> list[Outline]:
    """Find the outlines of spheres in a picture, from left to right.

    Circles that Hough's transform proposes are moved onto the edges of the picture and kept where most of their rim
    lies on one.

    Parameters
    ----------
    picture : (height, width) float
        Linear; the mean over all lights shows more of the rims than one picture does.
    count : int, optional
        How many there are; as many as are found where it is not given.

    Raises
    ------
    InputError
        Where fewer are found, or none.
    """
    toned = np.sqrt(_smooth(picture))  # in which dark rims count; `refined` then finds where they are
    kept: list[tuple[float, Outline]] = []
    for u, v, radius in _proposals(toned):
        refined = _on_edges(toned, u, v, radius)
        if refined is None:
            continue
        support, outline = refined
        # A larger circle with as much of an edge is the sphere; what lies inside is what it reflects.
        rank = support * outline.radius
        overlapping = [
            k
            for k, (_, other) in enumerate(kept)
            if np.linalg.norm(other.centre - outline.centre) < max(other.radius, outline.radius)
        ]
        if any(kept[k][0] >= rank for k in overlapping):
            continue
        kept = [one for k, one in enumerate(kept) if k not in overlapping] + [(rank, outline)]
    largest = max((outline.radius for _, outline in kept), default=0.0)
    kept = [one for one in kept if one[1].radius >= LIKE_SIZE_SHARE * largest]
    found = [outline for _, outline in sorted(kept, key=lambda one: -one[0])]
    if not found or (count is not None and len(found) < count):
        wanted = "a sphere" if count is None else f"{count} spheres"
        raise InputError(
            f"sphere: expected {wanted}, found {len(found)} in the pictures; give each with --sphere U,V,RADIUS or "
            "mark them in a --mask"
        )
    return _left_to_right(found[:count])


def _proposals(grey: Array) -> list[tuple[float, float, float]]:
    """Circles (u, v, radius) that Hough's transform sees in a small copy, in which a rim is one or two pixels wide."""
    share = min(1.0, SEARCH_PX / max(grey.shape))
    small = cv2.resize(grey, None, fx=share, fy=share, interpolation=cv2.INTER_AREA)
    found = cv2.HoughCircles(
        np.rint(255 * small).astype(np.uint8),
        cv2.HOUGH_GRADIENT_ALT,
        dp=1.5,
        minDist=SMALLEST_PX,
        param1=60,
        param2=0.4,
        minRadius=int(SMALLEST_PX),
        maxRadius=min(small.shape) // 2,
    )
    circles = np.empty((0, 3)) if found is None else np.asarray(found, dtype=float).reshape(-1, 3)
    # Pixel centres are at integers in both sizes.
    return [((u + 0.5) / share - 0.5, (v + 0.5) / share - 0.5, r / share) for u, v, r in circles]


def _overlap(one: Outline, other: Outline) -> bool:
    """Whether one of them cannot be a sphere that is seen whole."""
    return bool(np.linalg.norm(one.centre - other.centre) < max(one.radius, other.radius))


def _smooth(picture: ArrayLike) -> Array:
    """Values from their 1st to 99th percentile as 0 to 1, still linear: a blurred step is steepest where it is."""
    values = np.asarray(picture, dtype=float)
    low, high = np.percentile(values, [1, 99])
    return np.asarray(
        cv2.GaussianBlur(np.clip((values - low) / max(high - low, 1e-12), 0, 1), (0, 0), 0.7), dtype=float
    )


def _on_edges(grey: Array, u: float, v: float, radius: float) -> tuple[float, Outline] | None:
    """Share of the rim that lies on an edge, and the outline through it; None where that is too little."""
    turn = 2 * np.pi * np.arange(SAMPLES) / SAMPLES
    direction = np.stack([np.cos(turn), np.sin(turn)], -1)
    centre, rows = np.array([u, v]), np.arange(SAMPLES)
    good, points = np.ones(SAMPLES, dtype=bool), np.empty((SAMPLES, 2))
    for reach in SEARCH_SHARES:
        reach_px = max(reach * radius, 3.0)
        offsets = np.arange(-reach_px, reach_px + 0.25, 0.5)
        places = centre + direction[:, None] * (radius + offsets[:, None])
        profile = map_coordinates(grey, [places[..., 1], places[..., 0]], order=1, mode="nearest")
        steep = np.abs(np.gradient(profile, axis=1))
        at = _outermost(steep)
        before, peak, after = steep[rows, at - 1], steep[rows, at], steep[rows, at + 1]
        bend = before - 2 * peak + after
        vertex = np.where(bend < 0, 0.5 * (before - after) / np.where(bend < 0, bend, 1), 0)
        points = centre + direction * (radius + offsets[at] + 0.5 * np.clip(vertex, -1, 1))[:, None]
        seen = (peak > FAINTEST_EDGE) & ((points >= 0) & (points <= np.array(grey.shape)[::-1] - 1)).all(1)
        if seen.sum() < SUPPORT_SHARE * SAMPLES:
            return None
        circle = through(points[seen])
        centre, radius = circle.centre, circle.radius
        distance = np.abs(np.linalg.norm(points - centre, axis=1) - radius)
        usual = 4.5 * float(np.median(distance[seen]))
        good = seen & (distance < np.clip(usual, 0.3, max(1.0, 0.25 * reach * radius)))
        if good.sum() < SUPPORT_SHARE * SAMPLES:
            return None
        circle = through(points[good])
        centre, radius = circle.centre, circle.radius
    return float(good.mean()), circle


def _outermost(steep: Array) -> NDArray[np.intp]:
    """Last peak of each row that is a good part of its highest: inside the rim a sphere mirrors edges as strong."""
    inner = steep[:, 1:-1]
    peak = (inner >= steep[:, :-2]) & (inner > steep[:, 2:]) & (inner >= EDGE_SHARE * steep.max(1, keepdims=True))
    last = peak.shape[1] - peak[:, ::-1].argmax(1)
    return np.asarray(np.where(peak.any(1), last, 1))


def _left_to_right(outlines: Sequence[Outline]) -> list[Outline]:
    return sorted(outlines, key=lambda one: float(one.centre[0]))
