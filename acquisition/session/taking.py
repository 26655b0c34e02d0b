"""One exposure: the light to its place, lit, at rest; the shutter open and closed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, timedelta

import numpy as np

from acquisition.check import Places, lamp_levels, reach
from acquisition.session.filing import Photograph
from acquisition.session.schedule import Due, place_of
from acquisition.session.ways import clear_way
from acquisition.taken import Span, Stage
from stage.clock import Clock
from stage.devices import Arrival, AxisGroup, FrameCamera
from stage.errors import DeviceError
from stage.flashing import FlashGuard
from stage.rig import FixedDome, Rig

STILL_M = 0.001
"""How far the light may travel while the shutter is open."""


@dataclass(frozen=True)
class Taking:
    """Takes single exposures.

    Parameters
    ----------
    rig : Rig
        Kinematics and lamp.
    motion, lamp, camera
        Open devices.
    places : mapping
        Joint values by place; where a place has none, the nearest solution is taken.
    clock : Clock
        For durations.
    begun_s, began : float, datetime
        When the run began, on the clock and by time of day.
    require_going : callable
        Called before anything moves or shines; raises where the session is to end at once.
    wait_for_camera : callable
        Returns when the camera has handed over the photograph before.
    """

    rig: Rig
    motion: AxisGroup
    lamp: FlashGuard
    camera: FrameCamera
    places: Places
    clock: Clock
    begun_s: float
    began: datetime
    require_going: Callable[[], None]
    wait_for_camera: Callable[[], None]

    def take(self, due: Due) -> Photograph:
        """Expose once; the photograph is still in the camera.

        The light moves, and the lamp is set, while the camera hands over the photograph before.
        """
        shot, begin = due.shot, self._now()
        spans: dict[Stage, Span] = {}
        arrival: Arrival | None = None
        commanded, light = None, None
        levels = (0.0,) * self.lamp.emitters
        if shot.lights:
            commanded = self._target(due)
            for stop in self._way_to(commanded):
                self.require_going()
                arrival = self.motion.move_to(stop)
            assert arrival is not None
            moved = self._now()
            spans["move"] = (begin, moved - arrival.settle_s)
            spans["settle"] = (moved - arrival.settle_s, moved)
            self.clock.sleep(self.lamp.pause_s())
            self.require_going()
            levels = self.lamp.set_levels(lamp_levels(self.rig.light, shot))
            if shot.light is not None:
                light = self.rig.light_at(arrival.positions, levels)
            spans["light"] = (moved, self._now())
        else:
            self.lamp.dark()
            spans["light"] = (begin, self._now())
        self.wait_for_camera()
        self.require_going()
        opened = self._now()
        exposure = self.camera.expose(shot.exposure_s)
        spans["expose"] = (opened, self._now())
        return Photograph(
            due,
            exposure,
            (self.began + timedelta(seconds=begin)).isoformat(),
            spans,
            levels,
            commanded,
            arrival,
            light,
            fault=self._motion_meanwhile(arrival),
        )

    def _target(self, due: Due) -> tuple[float, ...]:
        planned = self.places.get(place_of(due.shot))
        return reach(self.rig, due.shot, self.motion.positions()) if planned is None else planned

    def _way_to(self, target: tuple[float, ...]) -> list[tuple[float, ...]]:
        """Where to go one after the other; round what is in the way of a move that was in no plan.

        Such moves come after a retry, for a reference and to lights that are chosen as the session goes.
        """
        if not self.rig.keep_out:
            return [target]
        here = self.motion.positions()
        way = clear_way(self.rig, self.places, here, target)
        if way is None:
            reason = self.rig.moving_obstruction(here, target)
            raise DeviceError(f"{self.motion.name}: the way to the next light is barred, {reason}")
        return way

    def _motion_meanwhile(self, arrival: Arrival | None) -> DeviceError | None:
        """What is wrong with a photograph during which the light moved."""
        motion = self.rig.motion
        if arrival is None or isinstance(motion, FixedDome):
            return None
        try:
            places = [motion.light_position(joints) for joints in (arrival.positions, self.motion.positions())]
        except DeviceError as error:
            return error
        drift = float(np.linalg.norm(places[1] - places[0]))
        if drift <= STILL_M:
            return None
        return DeviceError(f"{self.motion.name}: the light moved by {1000 * drift:.1f} mm while the shutter was open")

    def _now(self) -> float:
        return self.clock.now() - self.begun_s
