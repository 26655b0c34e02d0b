"""Test frames by the stage's own lamp and camera."""

from __future__ import annotations

from acquisition.check.levels import light_levels
from acquisition.plan import CapturePlan
from acquisition.radiance import RawFrame, read_frame
from stage.clock import Clock
from stage.devices import FrameCamera
from stage.flashing import FlashGuard
from stage.rig import Rig


class DomeFrames:
    """Photographs of single lights of a fixed dome that are not kept: a `resolving.TakeTestFrame`.

    Parameters
    ----------
    plan : CapturePlan
        Whose candidates are lit.
    rig : Rig
        A fixed dome.
    lamp : FlashGuard
        Open, and the one that the capture will use, so that flashes before and after its start count together.
    camera : FrameCamera
        Open.
    clock : Clock
        That the lamp's guard counts on.
    """

    def __init__(self, plan: CapturePlan, rig: Rig, lamp: FlashGuard, camera: FrameCamera, clock: Clock) -> None:
        self._plan, self._rig, self._lamp, self._camera, self._clock = plan, rig, lamp, camera, clock

    def __call__(self, candidate: int | None, exposure_s: float) -> RawFrame:
        """Light a candidate, or none, and photograph it; the lamp is dark afterwards.

        Raises
        ------
        InputError
            Where the lamp cannot light the candidate as planned, or the camera lacks the exposure time.
        DeviceError
            Where lamp or camera fail, or the file cannot be decoded.
        """
        try:
            if candidate is None:
                self._lamp.dark()
            else:
                levels = light_levels(self._rig.light, self._plan.candidate_lights[candidate], candidate)
                self._clock.sleep(self._lamp.pause_s())
                self._lamp.set_levels(levels)
            frame = self._camera.capture(exposure_s)
        finally:
            self._lamp.dark()
        return read_frame(frame.data, frame.name, transfer=self._rig.camera.device.transfer)
