"""What all cameras have in common: a photograph is taken in two steps, and both once more where nothing came of it."""

from __future__ import annotations

from abc import abstractmethod

from stage.devices import CapturedFrame, Exposure, OpenedByWith
from stage.errors import DeviceError

SHOTS = 2
"""A picture that does not come, comes twice or is exposed wrongly is taken once more."""


class NoPictureError(DeviceError):
    """The camera took a release, and nothing came of it but an earlier picture, or one that was not asked for."""


class TwoStepCamera(OpenedByWith):
    """Makes `capture` of `expose` and `download`: the rest of a `stage.devices.FrameCamera` is the driver's."""

    @abstractmethod
    def expose(self, exposure_s: float) -> Exposure:
        """See `stage.devices.FrameCamera.expose`."""

    @abstractmethod
    def download(self, exposure: Exposure) -> CapturedFrame:
        """See `stage.devices.FrameCamera.download`."""

    def make_safe(self) -> None:
        """Do nothing: a camera neither moves nor shines, and every exposure here ends by itself."""

    def capture(self, exposure_s: float) -> CapturedFrame:
        """Expose and download; once more where no picture came, or another one.

        Raises
        ------
        InputError
            For an exposure time that the camera does not offer; the sentence names the nearest.
        DeviceError
            Where the camera refuses, stops answering, or delivers no such picture.
        """
        for left in reversed(range(SHOTS)):
            try:
                return self.download(self.expose(exposure_s))
            except NoPictureError:
                if not left:
                    raise
        raise AssertionError("unreachable")
