"""A simulated stage whose world misbehaves on cue, behind the real drivers and in virtual time."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from acquisition.capture import capture
from acquisition.dataset import IlluminationDataset
from acquisition.plan import CapturePlan, DomeLights
from acquisition.taken import SessionEvent, TakenShot
from api.devices import Workshop
from simulators.clock import VirtualClock
from simulators.image_formation import ImageFormer
from simulators.scene import Relief, dish
from simulators.stage_sim import SimulatedStage
from simulators.view import Pinhole
from simulators.world import RigWorld
from stage.devices import AxisGroup, FrameCamera
from stage.flashing import FlashGuard
from stage.rig import Rig
from tests.conformance.rigs import DYNAMIXEL, ENTTEC, PTP_USB, stage

FAST = {"speed_deg_s": 300, "acceleration_deg_s2": 1200}
PAN, TILT = DYNAMIXEL["joints"]
ARM = DYNAMIXEL | {"joints": [PAN | FAST | {"limits_deg": [-180, 179]}, TILT | FAST]}
RADIUS_M = 0.7

Cue = Callable[[int], float]
"""What happens in an exposure, by its number, counted from 0 in the order in which they are taken."""


def arm_rig(**device: Any) -> Rig:
    """Servos, a lamp on DMX and a camera on USB; `device` are further fields of the camera's."""
    return stage(ARM, ENTTEC, PTP_USB | device)


def dome_plan(count: int, **rest: Any) -> CapturePlan:
    """Lights spread over the upper part of a dome."""
    lights = DomeLights(kind="dome", count=count, radius_m=RADIUS_M, elevation_deg=(25, 85))
    return CapturePlan(candidates=lights, **{"dark_frames": 2} | rest)


class Object:
    """What stands on the stage, and can be taken away: a `simulators.world.Former`."""

    def __init__(self, relief: Relief, camera: Pinhole) -> None:
        self._here = ImageFormer(relief, camera)
        self._flat = ImageFormer(Relief.uniform(np.zeros((61, 61)), 0.3), camera)
        self.stands = "object"

    def render(self, position: ArrayLike, intensity: ArrayLike = (1.0, 1.0, 1.0)) -> NDArray[np.float64]:
        """See `simulators.world.Former`; without an object there is black velvet."""
        if self.stands == "background":
            return 0.01 * self._flat.render(position, intensity)
        return (self._flat if self.stands == "flat" else self._here).render(position, intensity)

    def render_sky(self, radiance: ArrayLike = (1.0, 1.0, 1.0)) -> NDArray[np.float64]:
        """See `simulators.world.Former`."""
        return self._here.render_sky(radiance)


class World(RigWorld):
    """A world in which lamp and arm do something else than they are told, exposure by exposure.

    Attributes
    ----------
    object : Object
    gain : callable
        Share of the light that the lamp gives of what is sent to it.
    astray : callable
        By how much the first joint stands beside where its drive says, radians.
    gains : list of float
        Shares that were given so far, by exposure, as eight bits allow.
    levels : bytes
        Last sent to the lamp.
    """

    def __init__(self, rig: Rig, clock: VirtualClock, relief: Relief) -> None:
        self.gain: Cue = lambda exposure: 1.0
        self.astray: Cue = lambda exposure: 0.0
        self.gains: list[float] = []
        self.levels = bytes(512)
        self._beside_rad = 0.0
        made: list[Object] = []

        def former(camera: Pinhole) -> Object:
            made.append(Object(relief, camera))
            return made[0]

        super().__init__(rig=rig, seed=0, clock=clock.now, former=former)
        [self.object] = made

    def attach(self, actuator: str, position: Callable[[float], float]) -> None:
        """See `RigWorld`; the first joint may stand elsewhere than it says."""
        first = actuator == self.rig.motion.actuators[0]
        super().attach(actuator, lambda at_s: position(at_s) + (self._beside_rad if first else 0.0))

    def set_channels(self, levels: bytes) -> None:
        """See `RigWorld`; what comes of them is seen with the next exposure."""
        self.levels = bytes(levels)
        super().set_channels(levels)

    def expose(self, exposure_s: float, iso: int = 100) -> bytes:
        """See `RigWorld`."""
        exposure = len(self.gains)
        dimmed = bytes(round(level * self.gain(exposure)) for level in self.levels)
        self.gains.append(max(dimmed) / max(max(self.levels), 1))
        self._beside_rad = self.astray(exposure)
        super().set_channels(dimmed)
        try:
            return super().expose(exposure_s, iso)
        finally:
            super().set_channels(self.levels)
            self._beside_rad = 0.0


@dataclass
class Play:
    """An open stage, and what its sessions write.

    Attributes
    ----------
    out : Path
        Folder of the dataset.
    """

    rig: Rig
    world: World
    clock: VirtualClock
    stage: SimulatedStage
    motion: AxisGroup
    lamp: FlashGuard
    camera: FrameCamera
    out: Path

    def capture(self, plan: CapturePlan, **options: Any) -> IlluminationDataset:
        """See `acquisition.capture.capture`; whatever happens, the stage is dark afterwards."""
        try:
            return capture(
                plan, self.motion, self.lamp, self.camera, self.out, rig=self.rig, clock=self.clock, **options
            )
        finally:
            assert not any(self.world.levels)

    def shots(self) -> list[TakenShot]:
        """What was recorded, in turn."""
        lines = (self.out / "capture" / "shots.jsonl").read_text().splitlines()
        return [TakenShot.model_validate_json(line) for line in lines]

    def standing(self) -> dict[int, TakenShot]:
        """Frames that stand, by shot."""
        return {shot.shot: shot for shot in self.shots() if shot.accepted}

    def events(self, *kinds: str) -> list[SessionEvent]:
        """What happened, in turn; of some kinds where any are given."""
        lines = (self.out / "capture" / "events.jsonl").read_text().splitlines()
        found = [SessionEvent.model_validate_json(line) for line in lines]
        return [event for event in found if not kinds or event.kind in kinds]

    def end(self) -> dict[str, str]:
        """How the last session ended."""
        return dict(json.loads((self.out / "capture" / "end.json").read_text()))


@contextmanager
def play(rig: Rig, out: Path, relief: Relief | None = None) -> Iterator[Play]:
    """Open the devices of a simulated rig, in a world that does as it is told to."""
    clock = VirtualClock()
    world = World(rig, clock, relief or dish(nodes=161))
    with SimulatedStage(world, rig, clock) as simulated, ExitStack() as stack:
        workshop = Workshop(simulated.rig, clock, simulated.usb)
        motion = stack.enter_context(workshop.motion())
        lamp = stack.enter_context(workshop.lamp())
        camera = stack.enter_context(workshop.camera())
        yield Play(simulated.rig, world, clock, simulated, motion, lamp, camera, out)


def errors(dataset: IlluminationDataset, play: Play) -> NDArray[np.float64]:
    """Relative error of each picture against what the world shows under its light, root mean square."""
    found = []
    for number, frame in enumerate(dataset.frames):
        true = play.world.render(frame.light.position, frame.light.intensity)
        apart = np.asarray(dataset.image(number)) - true
        found.append(np.sqrt(np.mean(apart**2) / np.mean(true**2)))
    return np.array(found)
