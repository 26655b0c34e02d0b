"""Error of a recovered response curve and of the merged radiance: known curves, and Debevec and Malik's own bracket."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any, get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from acquisition.calibration.response import CHANNELS, Response, Weighting, find_response, merge_pictures

DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "memorial-hdr"
SOLVER_SAMPLES = 900
"""Pixels that OpenCV's solver is given: its time grows with their third power."""

NORMAL_MEDIAN = 0.6745
"""Median of a normal distribution's absolute value, in standard deviations."""

OCTAVES = range(-12, 7, 2)


def run() -> dict[str, Any]:
    """Compare the solver with OpenCV's on known curves and on the published bracket, where that is on this machine.

    Returns
    -------
    dict
        ``known_curves``: see `known_curves`. ``memorial``: see `memorial`; ``left_out`` where it is not there.
    """
    found: dict[str, Any] = {"known_curves": known_curves()}
    if DATA.is_dir():
        found["memorial"] = memorial(DATA)
    else:
        found["left_out"] = "the published bracket is not on this machine"
    return found


def known_curves() -> dict[str, Any]:
    """Largest error of the exposure of the stored values 20 to 235, in percent, and seconds.

    One channel's curve of gamma 2.2 from 8 exposures of 40,000 radiances over 11 stops, rounded to 8 bits, without and
    with noise of one step.
    """
    rng = np.random.default_rng(3)
    light = np.exp(rng.uniform(-7, 1, (200, 200, 3)))
    times = 2.0 ** np.arange(-5, 3)
    expected = (np.arange(256) / 128) ** 2.2
    found: dict[str, Any] = {}
    for noise in (0.0, 1.0):
        pictures = [
            np.clip(
                np.rint(255 * np.minimum(light * t, 1) ** (1 / 2.2) + noise * rng.standard_normal(light.shape)), 0, 255
            ).astype(np.uint8)
            for t in times
        ]
        row: dict[str, Any] = {}
        for name, curve, seconds in (_ours(pictures, times), _opencv(pictures, times)):
            error = np.abs(np.exp(curve[0] - curve[0, 128]) / np.maximum(expected, 1e-9) - 1)[20:236]
            row[name] = {
                "worst_percent": 100 * float(error.max()),
                "falling_steps": int((np.diff(curve) <= 0).sum()),
                "seconds": seconds,
            }
        found[f"noise {noise:g}"] = row
    return found


def memorial(folder: Path) -> dict[str, Any]:
    """The eight longest exposures of the Stanford Memorial Church against the radiance map published with them.

    The map was made from sixteen exposures; film scans, registered by hand. Valid pixels are those without the pure
    blue border in any exposure, not clipped in the shortest of the eight, and not zero in the map. One factor per
    channel, the median ratio, is taken out.

    Returns
    -------
    dict
        ``error_stops``: by weighting and channel ``median`` and ``p95`` of the absolute error and ``valid_share``.
        ``by_octave``: of the green channel, noise-optimal: for pixels whose published radiance lies in the two octaves
        from 2**k on, their number, and median and 95th percentile of the error.
        ``map_rounding_stops``: median error that the map's own file format (RGBE) makes, by channel.
        ``deviation_over_stated``: by weighting and channel, how large deviations are in units of the standard deviation
        that goes with the merged picture, as ``rms`` and as ``median`` (over that of a normal distribution), both 1
        where the variance is right: ``from_map``, where errors of the published map and of the registration come on
        top, and ``between_halves``: of the 1st, 3rd, 5th and 7th exposure from the others.
        ``falling_steps``: steps at which the recovered curve falls, of 765, ours and OpenCV's. ``opencv``: the same
        errors with OpenCV's curve.
    """
    pictures, seconds, published, seen = read_memorial(folder)
    begin = time.perf_counter()
    response = find_response(pictures, seconds, mask=seen)
    taken = time.perf_counter() - begin
    errors = {w: error_stops(response, w, pictures, seconds, published, seen) for w in get_args(Weighting)}
    _, curve, opencv_s = _opencv(pictures, seconds, seen)
    green, level = errors["noise-optimal"][1], np.log2(np.maximum(published[..., 1], 1e-12))
    octaves = {}
    for k in OCTAVES:
        inside = np.isfinite(green) & (level >= k) & (level < k + 2)
        if inside.sum() >= 100:
            octaves[str(k)] = {"pixels": int(inside.sum()), **_figures(green[inside])}
    step = np.exp2(np.floor(np.log2(published.max(-1, keepdims=True).clip(1e-30))) + 1 - 8)
    rounding = np.log2(1 + step / 4 / np.maximum(published, step))  # the median of an even rounding error is a quarter
    return {
        "error_stops": {
            weighting: {
                name: {**_figures(one), "valid_share": float(np.isfinite(one).mean())}
                for name, one in zip(CHANNELS, by_channel, strict=True)
            }
            for weighting, by_channel in errors.items()
        },
        "opencv": {
            name: _figures(_against(_hat_mean(pictures, seconds, curve[c], c), published[..., c], seen))
            for c, name in enumerate(CHANNELS)
        },
        "deviation_over_stated": {
            w: deviation_over_stated(response, w, pictures, seconds, published, seen) for w in get_args(Weighting)
        },
        "by_octave": octaves,
        "map_rounding_stops": {name: float(np.median(rounding[seen][:, c])) for c, name in enumerate(CHANNELS)},
        "falling_steps": {
            "ours": int((np.diff(response.log_exposure) <= 0).sum()),
            "opencv": int((np.diff(curve) <= 0).sum()),
        },
        "solve_s": {"ours": taken, "opencv": opencv_s, "pixels": {"ours": int(seen.sum()), "opencv": SOLVER_SAMPLES}},
        "residuals": response.residuals,
    }


def read_memorial(
    folder: Path,
) -> tuple[list[NDArray[np.uint8]], list[float], NDArray[np.float32], NDArray[np.bool_]]:
    """Pictures, exposure times, the published map, and where no exposure shows the border."""
    rows = [line.split() for line in (folder / "list.txt").read_text().splitlines() if line.strip()]
    pictures = [np.asarray(_opened(folder / name), np.uint8) for name, _ in rows]
    published = np.asarray(_opened(folder / "memorial.hdr"), np.float32)
    border = np.any([(picture == [0, 0, 255]).all(-1) for picture in pictures], axis=0)
    return pictures, [float(seconds) for _, seconds in rows], published, ~border


def _opened(path: Path) -> NDArray[Any]:
    picture = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if picture is None:
        raise FileNotFoundError(path)
    return picture[..., ::-1]


def error_stops(
    response: Response,
    weighting: Weighting,
    pictures: list[NDArray[np.uint8]],
    seconds: list[float],
    published: NDArray[np.float32],
    seen: NDArray[np.bool_],
) -> list[NDArray[np.float64]]:
    """By channel, the merged picture's error (height, width) against the published map; NaN where not valid."""
    merged = merge_pictures(response, pictures, seconds, weighting=weighting)
    return [
        _against(merged.image[..., c], published[..., c], seen & ~merged.clipped[..., c]) for c in range(len(CHANNELS))
    ]


def deviation_over_stated(
    response: Response,
    weighting: Weighting,
    pictures: list[NDArray[np.uint8]],
    seconds: list[float],
    published: NDArray[np.float32],
    seen: NDArray[np.bool_],
) -> dict[str, dict[str, dict[str, float]]]:
    """By channel, deviations in units of the stated standard deviation; see `memorial`."""
    whole, one, other = (
        merge_pictures(response, pictures[part], seconds[part], weighting=weighting)
        for part in (slice(None), slice(0, None, 2), slice(1, None, 2))
    )
    found = {}
    for c, name in enumerate(CHANNELS):
        valid = seen & ~(one.clipped | other.clipped | whole.clipped)[..., c]
        stops = _against(whole.image[..., c], published[..., c], valid)
        stated = np.sqrt(whole.variance[..., c]) / whole.image[..., c] / np.log(2)
        apart = np.where(valid, one.image[..., c] - other.image[..., c], np.nan)
        together = np.sqrt(one.variance[..., c] + other.variance[..., c])
        found[name] = {
            "from_map": _in_sigmas(stops / stated),
            "between_halves": _in_sigmas(apart / together),
        }
    return found


def _in_sigmas(deviation: NDArray[Any]) -> dict[str, float]:
    return {
        "rms": float(np.sqrt(np.nanmean(deviation**2))),
        "median": float(np.nanmedian(np.abs(deviation)) / NORMAL_MEDIAN),
    }


def _against(image: NDArray[Any], published: NDArray[Any], valid: NDArray[np.bool_]) -> NDArray[np.float64]:
    valid = valid & (published > 0) & np.isfinite(image)
    error = np.log2(np.where(valid, image, 1) / np.where(valid, published, 1))
    return np.where(valid, error - np.median(error[valid]), np.nan)


def _figures(error: NDArray[np.float64]) -> dict[str, float]:
    found = np.abs(error[np.isfinite(error)])
    return {"median": float(np.median(found)), "p95": float(np.percentile(found, 95))}


Solved = tuple[str, NDArray[np.float64], float]


def _ours(pictures: list[NDArray[np.uint8]], seconds: Any) -> Solved:
    begin = time.perf_counter()
    response = find_response(pictures, list(seconds))
    return "ours", np.array(response.log_exposure), time.perf_counter() - begin


def _opencv(pictures: list[NDArray[np.uint8]], seconds: Any, seen: NDArray[np.bool_] | None = None) -> Solved:
    """OpenCV's solver, which takes every pixel of the small pictures it is given and knows no mask."""
    side = round(SOLVER_SAMPLES**0.5)
    where = np.flatnonzero(np.ones(pictures[0].shape[:2], bool) if seen is None else seen)
    chosen = np.random.default_rng(1).choice(where, side * side, replace=False)
    tiles = [np.ascontiguousarray(picture.reshape(-1, 3)[chosen].reshape(side, side, 3)) for picture in pictures]
    begin = time.perf_counter()
    solver = cv2.createCalibrateDebevec(samples=side * side, random=False)
    curve = np.log(solver.process(tiles, np.asarray(seconds, np.float32))[:, 0].T.astype(float))
    return "opencv", curve, time.perf_counter() - begin


def _hat_mean(
    pictures: list[NDArray[np.uint8]], seconds: list[float], curve: NDArray[np.float64], c: int
) -> NDArray[np.float64]:
    """Equation (6) of the paper with a curve that may fall, which `Response` refuses; NaN where nothing has weight."""
    stored = np.stack(pictures)[..., c]
    weight = np.minimum(stored, 255 - stored).astype(float)
    total = weight.sum(0)
    mean = (weight * (curve[stored] - np.log(seconds)[:, None, None])).sum(0) / np.where(total > 0, total, 1)
    return np.where(total > 0, np.exp(mean), np.nan)


if __name__ == "__main__":
    print(json.dumps(run(), indent=1))
