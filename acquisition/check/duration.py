r"""How long a capture takes, from its parts and from what passes side by side.

Three things go on at a time, as in `acquisition.session`: the light moves on and is set while the camera hands over the
photograph before, and the one before that is decoded and written. The light stands still while the shutter is open, so
a shot takes

.. math:: t = expose + \max(move + settle + pause + light, download)

unless decoding and writing take longer still.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from typing import Self

from acquisition.check.levels import lamp_levels
from acquisition.check.places import Joints
from acquisition.plan import Shot
from stage.clock import SystemClock
from stage.devices import OpenedByWith
from stage.flashing import FlashGuard
from stage.rig import Rig
from stage.rig.camera import StillCameraDevice

DOWNLOAD_BYTES_S, DECODE_BYTES_S, WRITE_BYTES_S = 10e6, 100e6, 100e6
"""Rates that are assumed where nothing is known: 50 MB of RAW take 4 to 7 s over USB."""
LIGHT_S = 0.05
"""Until a new level shows: two frames of DMX512, of 513 slots of 44 microseconds each."""
FRAMES_WAITING = 2
"""Photographs that may wait to be decoded and written before the camera has to wait too."""


@dataclass(frozen=True)
class Timings:
    """Seconds that a frame takes of the devices, besides moving and the exposure itself.

    Attributes
    ----------
    light_s : float
        Setting the lamp, until the light is steady.
    shutter_s : float
        Of an exposure, on top of the exposure time.
    download_s, decode_s, write_s : float
        From the camera to the disk, once the light is free to move on.
    """

    light_s: float = LIGHT_S
    shutter_s: float = 0.0
    download_s: float = 0.0
    decode_s: float = 0.0
    write_s: float = 0.0

    @classmethod
    def assumed(cls, rig: Rig, frame_bytes: int, **known: float) -> Self:
        """Timings as the rig says, and by the size of a frame where it does not; but for those that are known."""
        assumed = {
            "light_s": LIGHT_S + rig.light.warm_up_s,
            "download_s": frame_bytes / DOWNLOAD_BYTES_S,
            "decode_s": frame_bytes / DECODE_BYTES_S,
            "write_s": frame_bytes / WRITE_BYTES_S,
        }
        if isinstance(device := rig.camera.device, StillCameraDevice):
            readout_s = device.timing.readout_s
            assumed["download_s"] = device.timing.download_s or assumed["download_s"]
            if device.shutter_lag_s is None:
                assumed["shutter_s"] = readout_s
            else:  # the light need not wait for the camera to read out
                assumed["shutter_s"] = device.shutter_lag_s
                assumed["download_s"] += readout_s
        return cls(**assumed | known)


@dataclass(frozen=True)
class Duration:
    """Seconds of a capture, by part: each added up over all shots, and how long all of it takes.

    Attributes
    ----------
    move_s, settle_s : float
        From place to place, and coming to rest there.
    pause_s : float
        Waiting so that the light does not flash (see `stage.flashing`).
    light_s, expose_s, download_s, decode_s, write_s : float
        As in `Timings`.
    total_s : float
        From the first move until the last frame is on the disk; operators' pauses are not part of it.
    """

    move_s: float
    settle_s: float
    pause_s: float
    light_s: float
    expose_s: float
    download_s: float
    decode_s: float
    write_s: float
    total_s: float

    @property
    def parts(self) -> dict[str, float]:
        """Seconds by part."""
        return {field.name[:-2]: getattr(self, field.name) for field in fields(self) if field.name != "total_s"}

    @property
    def hidden_s(self) -> float:
        """Seconds that cost nothing, because something else went on at the time."""
        return sum(self.parts.values()) - self.total_s

    def to_json(self) -> dict[str, float]:
        """All of it."""
        return asdict(self) | {"hidden_s": self.hidden_s}


class _ModelClock(SystemClock):
    """Time that somebody sets."""

    time_s = 0.0

    def now(self) -> float:
        return self.time_s


class _ModelLamp(OpenedByWith):
    """A lamp that does as it is told, and is not there."""

    name = "lamp"

    def __init__(self, emitters: int) -> None:
        self.emitters = emitters

    def open(self) -> None: ...

    def close(self) -> None: ...

    def make_safe(self) -> None: ...

    def dark(self) -> None: ...

    def set_level(self, level: float) -> tuple[float, ...]:
        return (level,) * self.emitters

    def set_levels(self, levels: Sequence[float]) -> tuple[float, ...]:
        return tuple(levels)


def duration(
    rig: Rig, shots: Sequence[Shot], targets: Sequence[Joints | None], start: Sequence[float], timings: Timings
) -> Duration:
    """Duration of shots that are taken in this order.

    Parameters
    ----------
    rig : Rig
        Its profile of moves, its rest after them, and whether its lamp may flash.
    shots, targets : sequence
        Shots, and the joint values of each; None for a dark frame.
    start : sequence of float
        Joint values where it begins.
    timings : Timings
        Of camera, lamp and disk.
    """
    clock, here = _ModelClock(), tuple(start)
    lamp = FlashGuard(_ModelLamp(len(rig.light.emitters)), clock, allowed=rig.light.flashing == "allowed")
    levels: dict[tuple[str, tuple[int, ...]], tuple[float, ...]] = {}
    move_s = pause_s = open_s = handed_over_s = written_s = 0.0
    waiting = deque([0.0] * FRAMES_WAITING, maxlen=FRAMES_WAITING)  # when each is written
    for shot, target in zip(shots, targets, strict=True):
        if target is None:
            lamp.dark()
        else:
            way_s, here = rig.motion.travel_s(here, target), target
            clock.time_s += way_s + rig.motion.settle_s
            wait_s = lamp.pause_s()
            clock.time_s += wait_s
            key = shot.part, shot.candidates
            if key not in levels:
                levels[key] = lamp_levels(rig.light, shot)
            lamp.set_levels(levels[key])
            move_s, pause_s = move_s + way_s, pause_s + wait_s
        shutter_s = timings.shutter_s + shot.exposure_s
        clock.time_s = max(clock.time_s + timings.light_s, handed_over_s) + shutter_s
        open_s += shutter_s
        handed_over_s = max(clock.time_s + timings.download_s, waiting[0])
        written_s = max(handed_over_s, written_s) + timings.decode_s + timings.write_s
        waiting.append(written_s)
    return Duration(
        move_s=move_s,
        settle_s=rig.motion.settle_s * sum(target is not None for target in targets),
        pause_s=pause_s,
        light_s=timings.light_s * len(shots),
        expose_s=open_s,
        download_s=timings.download_s * len(shots),
        decode_s=timings.decode_s * len(shots),
        write_s=timings.write_s * len(shots),
        total_s=written_s,
    )
