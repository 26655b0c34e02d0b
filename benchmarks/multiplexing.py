"""What patterns of lights gain over single lights on the simulated dome: predicted, and measured against the truth.

``python -m benchmarks.multiplexing`` prints the figures, ``python -m benchmarks.multiplexing PICTURE.png`` draws them.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from acquisition.multiplexing.brightness import measure_brightness
from acquisition.multiplexing.choice import recommend
from acquisition.multiplexing.decoding import Demultiplexed, demultiplex
from acquisition.multiplexing.drift import pattern_scales
from acquisition.multiplexing.matrices import patterns, weights_of
from acquisition.multiplexing.trade import Trade
from acquisition.radiance import SITES, RawFrame, read_raw
from api.report.canvas import INK, MUTED, RGB, blank, paste, text_width, write
from simulators.clock import VirtualClock
from simulators.image_formation import ImageFormer
from simulators.raw import Sensor, blocks_to_rgb, through_filters
from simulators.scene import dish
from simulators.view import Pinhole
from stage.flashing import FlashGuard
from tests.acquisition.multiplexed_dome import dome_rig, noise_of
from tests.stage.test_flashing import RecordingLamp

Array = NDArray[np.float64]

SIZE = (80, 60)
NODES = 401
LIGHTS = (7, 15, 31, 63)
ELECTRONS = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0)
"""Mean signal of one light, by photosite, over the pixels that show the object."""
BASE_S = 0.01
STRAY = 0.01
"""Brightness of the room as a share of one light's."""
DARKS = 16
DRIFT = 0.01
REFERENCES = 9
PICTURE_SIZE, PICTURE_ELECTRONS, PICTURE_LIGHT = (140, 104), 2.0, 20


class Stage:
    """The dish under a dome, its lights as bright as one wishes: radiance per second of electrons, noise apart."""

    def __init__(self, lights: int, *, size: tuple[int, int] = SIZE, seed: int = 1) -> None:
        self.lights, self.sensor = lights, Sensor()
        self.noise = noise_of(self.sensor)
        self._rng = np.random.default_rng([seed, lights])
        rig = dome_rig(lights, size=size)
        place = rig.camera
        pinhole = Pinhole(place.width, place.height, np.array(place.K), np.array(place.world_to_camera))
        former = ImageFormer(dish(nodes=NODES), pinhole.photosites())
        mosaics = [
            through_filters(former.render(emitter.position_m or (0.0, 0.0, 1.0))) for emitter in rig.light.emitters
        ]
        radiance = np.stack(mosaics)
        self.object = blocks_to_rgb(radiance.mean(0)).min(-1) > 0
        # Radiance at which one light gives one electron in the base time, on average over object and channels.
        per_second = np.array(self.sensor.electrons_per_radiance_s)
        mean = (blocks_to_rgb(radiance.mean(0))[self.object] * per_second).mean() * BASE_S
        self._unit = radiance / mean
        self._stray = STRAY * self._unit.mean()

    def photograph(self, lit: Sequence[int], electrons: float, *, scale: float = 1.0, share: float = 1.0) -> RawFrame:
        """A RAW frame of some lights, that give so many electrons each in the base time, exposed for a share of it."""
        light = electrons * (scale * self._unit[list(lit)].sum(0) + self._stray)
        mosaic = self.sensor.read(light, share * BASE_S, 100, self._rng)
        return read_raw(self.sensor.dng(mosaic, share * BASE_S, 100), "simulated")

    @cached_property
    def unit_dn(self) -> Array:
        """Numbers (lights, height, width, 3) that single lights of one electron give, without noise."""
        per_dn = np.array(self.sensor.radiance_per_dn_s()) / BASE_S
        return np.stack([blocks_to_rgb(mosaic) for mosaic in self._unit]) / per_dn

    def dark(self, electrons: float) -> tuple[NDArray[np.floating[Any]], Array]:
        """Mean frame without light, and its variance."""
        frames = [self.photograph((), electrons) for _ in range(DARKS)]
        mean = np.mean([frame.values for frame in frames], axis=0)
        return mean, self.noise.variance_dn(mean - frames[0].black) / DARKS

    def decoded(self, electrons: float, scales: Sequence[float] | None = None) -> Demultiplexed:
        """Single-light pictures, in numbers, from patterns."""
        rows = patterns(self.lights)
        frames = [
            self.photograph(row, electrons, scale=1.0 if scales is None else scales[i]) for i, row in enumerate(rows)
        ]
        black, black_variance = self.dark(electrons)
        # what is clipped differs from pixel to pixel by the dark frame, so it is marked rather than compared
        marked = [np.where(frame.clipped, np.inf, frame.values - black) for frame in frames]
        return demultiplex(
            np.stack(marked),
            weights_of(rows, self.lights),
            saturation=frames[0].white,
            variances=np.stack([self.noise.variance_dn(frame.values - frame.black) for frame in frames]),
            dark_variance=black_variance,
        )

    def one_by_one(self, electrons: float) -> Array:
        """Single-light pictures, in numbers; not a number where clipped."""
        black, _ = self.dark(electrons)
        frames = [self.photograph((light,), electrons) for light in range(self.lights)]
        return np.stack([np.where(frame.clipped, np.nan, frame.values - black) for frame in frames])


def run() -> dict[str, Any]:
    """Photograph the dish one light at a time and in patterns, and compare both with the truth.

    Returns
    -------
    dict
        ``gain``: by number of lights and mean electrons per light, ``predicted`` and ``measured`` gain of the
        signal-to-noise ratio over the object (root of the ratio of mean squared errors), ``standard_error`` of the
        latter, ``chi_square`` of the decoded pictures by their own variance, ``clipped_percent`` of patterns' pixels,
        and whether ``auto`` chooses patterns from four test frames (``chosen``), at which share of the exposure time.
        ``break_even_electrons``: by number of lights, from read noise alone. ``drift``: see `drift`. ``flashing``: see
        `flashing`.
    """
    found: dict[str, Any] = {"gain": {}, "break_even_electrons": {}, "drift": {}}
    for lights in LIGHTS:
        stage = Stage(lights)
        read = float(np.square(stage.noise.read_e).mean())
        found["break_even_electrons"][lights] = float(Trade.of(lights).break_even(read))
        found["gain"][lights] = {electrons: gains(stage, electrons) for electrons in ELECTRONS}
        found["drift"][lights] = drift(stage)
    return {**found, "flashing": flashing()}


def gains(stage: Stage, electrons: float) -> dict[str, Any]:
    """One row of the table; see `run`."""
    truth = stage.unit_dn * electrons
    single, patterned = stage.one_by_one(electrons), stage.decoded(electrons)
    assert patterned.variances is not None
    seen = stage.object & np.isfinite(single).all((0, 3)) & (patterned.pictures < patterned.saturation).all((0, 3))
    one, many = (((pictures - truth) ** 2)[:, seen] for pictures in (single, patterned.pictures))
    gain_e = np.array(stage.noise.electrons_per_dn)
    signal = truth[:, seen].mean(0) * gain_e
    stray = (stage.dark(electrons)[0][seen] - stage.sensor.black_dn).mean(0) * gain_e
    trade, read = Trade.of(stage.lights), np.square(stage.noise.read_e)
    # the dark frames' share, which patterns suppress
    dark = (read + stray) / DARKS * np.array([[[1]], [[(2 / (stage.lights + 1)) ** 2]]])
    variances = np.stack([trade.single_variance(signal, read, stray), trade.pattern_variance(signal, read, stray)])
    predicted = ((variances + dark) / SITES).mean((1, 2))
    # lights of a pixel share noise, pixels do not
    by_pixel = [error.mean((0, 2)) for error in (one, many)]
    relative = np.array([error.std() / error.mean() / len(error) ** 0.5 for error in by_pixel])
    measured = float(np.sqrt(one.mean() / many.mean()))
    frames = (stage.photograph((light,), electrons) for light in np.linspace(0, stage.lights - 1, 4).astype(int))
    brightness = measure_brightness(frames, stage.photograph((), electrons), BASE_S, stage.noise, lights=stage.lights)
    offered = [BASE_S * 2 ** (-k / 2) for k in range(20)]
    choice = recommend(stage.noise, brightness, lights=stage.lights, exposure_s=BASE_S, offered_s=offered)
    return {
        "predicted": float(np.sqrt(predicted[0] / predicted[1])),
        "measured": measured,
        "standard_error": measured * float(np.linalg.norm(relative)) / 2,
        "chi_square": float((many / patterned.variances[:, seen]).mean()),
        "clipped_percent": 100 * float(1 - seen.sum() / stage.object.sum()),
        "chosen": choice.use,
        "exposure_share": choice.exposure_s / BASE_S,
    }


def drift(stage: Stage) -> dict[str, float]:
    """What a lamp that fades evenly by `DRIFT` does to the pictures of patterns, without noise.

    Returns
    -------
    dict
        Root mean square errors as percent of the mean signal: ``predicted_percent`` by the closed form for equally
        bright lights, ``measured_percent``, and ``corrected_percent``, left over after a correction by reference
        frames of one light with their noise (mean over the object, 32 electrons per photosite).
    """
    weights, truth = weights_of(patterns(stage.lights), stage.lights), stage.unit_dn[:, stage.object]
    scales = 1 + DRIFT * np.linspace(0.5, -0.5, len(weights))
    shown = np.tensordot(scales[:, None] * weights, truth, 1)[:, None]
    at = np.linspace(0, len(weights) - 1, REFERENCES)
    lamp = np.interp(at, np.arange(len(weights)), scales)
    dark = stage.dark(32.0)[0]
    reference = [
        float((stage.photograph((0,), 32.0, scale=scale).values - dark)[stage.object].mean()) for scale in lamp
    ]
    found = pattern_scales(reference, at.tolist(), list(range(len(weights))))

    def error_percent(used: Array) -> float:
        pictures = demultiplex(shown, used, saturation=1e9).pictures[:, 0]
        return 100 * float(np.sqrt(((pictures - truth) ** 2).mean()) / truth.mean())

    return {
        "predicted_percent": 100 * float(np.sqrt(stage.lights + 1) * scales.std()),
        "measured_percent": error_percent(weights),
        "corrected_percent": error_percent(found[:, None] * weights),
    }


def flashing() -> dict[str, Any]:
    """Seconds that the frames of 63 lights take by what the cap on flashing allows, by seconds per frame.

    Returns
    -------
    dict
        By seconds from one light to the next: ``single_s`` and ``patterns_s`` with the cap, ``allowed_s`` without it,
        for either.
    """
    rows = {"single_s": tuple((light,) for light in range(63)), "patterns_s": patterns(63)}
    return {
        str(frame_s): {
            **{name: _lit_s(shown, frame_s, allowed=False) for name, shown in rows.items()},
            "allowed_s": _lit_s(rows["patterns_s"], frame_s, allowed=True),
        }
        for frame_s in (0.02, 0.1, 1 / 3, 1.1)
    }


def _lit_s(rows: Sequence[Sequence[int]], frame_s: float, *, allowed: bool) -> float:
    clock = VirtualClock()
    guard = FlashGuard(RecordingLamp(clock, 63), clock, allowed=allowed)
    for row in rows:
        clock.sleep(guard.pause_s())
        guard.set_levels([float(light in row) for light in range(63)])
        clock.sleep(frame_s)
    return clock.now()


COLOURS: dict[int, RGB] = {7: (86, 180, 233), 15: (0, 158, 115), 31: (230, 159, 0), 63: (213, 94, 0)}
PLOT_WIDTH, LEFT, TOP, BOTTOM, BETWEEN = 560, 70, 76, 64, 34
GAINS = (0.5, 1.0, 2.0, 4.0)


def write_picture(path: Path) -> None:
    """Draw predicted and measured gain, and one light of 63 as seen alone, decoded, and in truth."""
    tile_width, tile_height = PICTURE_SIZE[0] * 2, PICTURE_SIZE[1] * 2
    canvas = blank(LEFT + PLOT_WIDTH + 50 + tile_width + 30, TOP + 3 * (tile_height + BETWEEN))
    plot_height = canvas.shape[0] - TOP - BOTTOM
    write(canvas, "Patterns against single lights", LEFT, 34, 24, INK, 700)
    write(canvas, "gain in signal-to-noise ratio; lines predicted, dots measured", LEFT, 56, 15, MUTED)

    ends = ELECTRONS[0] / 3, ELECTRONS[-1] * 1.3

    def at(electrons: float, gain: float) -> tuple[int, int]:
        low, high = np.log(ends[0]), np.log(ends[1])
        bottom, top = np.log(GAINS[0] * 0.95), np.log(GAINS[-1] * 1.1)
        x = LEFT + PLOT_WIDTH * (np.log(electrons) - low) / (high - low)
        y = TOP + plot_height * (top - np.log(gain)) / (top - bottom)
        return round(float(x)), round(float(y))

    for gain in GAINS:
        cv2.line(canvas, at(ends[0], gain), at(ends[1], gain), (120,) * 3 if gain == 1 else (225,) * 3, 1)
        label = f"{gain:g}"
        write(canvas, label, LEFT - 10 - text_width(label, 15), at(ends[0], gain)[1] + 5, 15, MUTED)
    for electrons in ELECTRONS:
        x, y = at(electrons, GAINS[0] * 0.95)
        label = f"{electrons:g}"
        write(canvas, label, x - text_width(label, 15) // 2, y + 22, 15, MUTED)
    write(canvas, "mean electrons of one light, per photosite", LEFT + 130, canvas.shape[0] - 14, 15, MUTED)
    for lights in LIGHTS:
        stage, colour = Stage(lights), COLOURS[lights]
        rows = [(electrons, gains(stage, electrons)) for electrons in ELECTRONS]
        line = np.array([at(electrons, row["predicted"]) for electrons, row in rows])
        cv2.polylines(canvas, [line.astype(np.int32)], False, colour, 2, cv2.LINE_AA)
        for electrons, row in rows:
            cv2.circle(canvas, at(electrons, row["measured"]), 5, colour, -1, cv2.LINE_AA)
        label = f"{lights} lights"
        write(canvas, label, int(line[0][0]) - 12 - text_width(label, 15, 600), int(line[0][1]) + 5, 15, colour, 600)
    stage = Stage(LIGHTS[-1], size=PICTURE_SIZE)
    truth = stage.unit_dn[PICTURE_LIGHT] * PICTURE_ELECTRONS
    pictures = {
        f"one of 63 lights alone, {PICTURE_ELECTRONS:g} electrons": stage.one_by_one(PICTURE_ELECTRONS)[PICTURE_LIGHT],
        "the same light from 63 patterns": stage.decoded(PICTURE_ELECTRONS).pictures[PICTURE_LIGHT],
        "the same light without noise": truth,
    }
    for i, (title, picture) in enumerate(pictures.items()):
        x, y = LEFT + PLOT_WIDTH + 50, TOP + i * (tile_height + BETWEEN)
        shown = np.clip(picture / np.percentile(truth, 99.5), 0, 1) ** (1 / 2.2)
        tile = np.rint(255 * shown).astype(np.uint8).repeat(2, 0).repeat(2, 1)
        write(canvas, title, x, y - 8, 15, INK, 600)
        paste(canvas, tile, x, y)
    cv2.imwrite(str(path), canvas[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])


if __name__ == "__main__":
    if sys.argv[1:]:
        write_picture(Path(sys.argv[1]))
    else:
        print(json.dumps(run(), indent=1))
