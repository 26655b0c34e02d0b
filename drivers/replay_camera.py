"""No camera: photographs that were taken before, each shown while the light is where it was then.

So a session, its dataset and what is fitted to it can be rehearsed with real photographs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol

from drivers.frame_camera import TwoStepCamera
from stage.clock import Clock, SystemClock
from stage.devices import CapturedFrame, Exposure
from stage.errors import DeviceError, InputError
from stage.lights import Light
from stage.rig import Replay

EXPOSURE_MATCH = 0.02
"""Share by which the exposure time asked for may differ from the one that the photographs are said to have."""


@dataclass(frozen=True)
class Photograph:
    """A photograph as it lies in its folder, or as a picture file made of it.

    Attributes
    ----------
    data : bytes
        Picture file.
    name : str
        Its name.
    metadata : mapping of str to str
        What is known of it.
    """

    data: bytes
    name: str
    metadata: Mapping[str, str] = field(default_factory=dict)


class ReplaySource(Protocol):
    """Where photographs come from."""

    @property
    def name(self) -> str:
        """Of the folder, for errors."""
        ...

    def photograph(self, light: Light | None) -> Photograph:
        """The photograph under a light, or in the dark; raises `DeviceError` where there is none."""
        ...


class ReplayCamera(TwoStepCamera):
    """A camera that shows photographs of a folder: a `stage.devices.FrameCamera`.

    Parameters
    ----------
    device : Replay
        The exposure time that the photographs are taken to have.
    source : ReplaySource
        The photographs.
    lit : callable
        The light as it is now; None where it is dark.
    clock : Clock, optional
        What a frame's start is told in; the system's where none is given.
    """

    def __init__(
        self, device: Replay, source: ReplaySource, lit: Callable[[], Light | None], *, clock: Clock | None = None
    ) -> None:
        self._device, self._source, self._lit = device, source, lit
        self._clock = clock or SystemClock()
        self._in_use = False

    @property
    def name(self) -> str:
        """What it is, and of which photographs."""
        return f"replay of {self._source.name}"

    def open(self) -> None:
        """Nothing to connect."""
        self._in_use = True

    def close(self) -> None:
        """Nothing to let go of; never raises."""
        self._in_use = False

    def require_exposure(self, exposure_s: float) -> None:
        """Refuse any exposure time but that of the photographs; raises `InputError`."""
        fixed_s = self._device.exposure_s
        if not abs(exposure_s - fixed_s) <= EXPOSURE_MATCH * fixed_s:
            raise InputError(
                f"exposure_s: the photographs of {self.name} have no {exposure_s:g} s; "
                f"camera.device.exposure_s says they have {fixed_s:g} s"
            )

    def nearest_exposure(self, exposure_s: float) -> float:
        """The exposure time of the photographs, seconds."""
        self._require_open()
        return self._device.exposure_s

    def expose(self, exposure_s: float) -> Exposure:
        """See where the light is; raises `InputError` for another exposure time than that of the photographs."""
        self._require_open()
        self.require_exposure(exposure_s)
        return Exposure(self._device.exposure_s, self._clock.now(), 0.0, self._lit())

    def download(self, exposure: Exposure) -> CapturedFrame:
        """The photograph that was taken with the light where it was.

        Raises
        ------
        DeviceError
            Where no photograph was taken with the light near to where it was, or its file cannot be read.
        """
        self._require_open()
        light, begun_s = exposure.handle, self._clock.now()
        assert light is None or isinstance(light, Light)
        found = self._source.photograph(light)
        took_s = self._clock.now() - begun_s
        return CapturedFrame(
            found.data, found.name, exposure.exposure_s, exposure.started_s, 0.0, took_s, metadata=found.metadata
        )

    def _require_open(self) -> None:
        if not self._in_use:
            raise DeviceError(f"{self.name}: it is not open; open it first")
