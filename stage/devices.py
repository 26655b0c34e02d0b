"""What a session may ask of a device: one small protocol per role, whatever brand fills it.

All calls block until they are done, and every wait inside them has a timeout. A device that fails raises
`stage.errors.DeviceError`; a wish that it cannot fulfil (an angle beyond its travel, a level above one) is refused
before anything moves or lights up. A device whose connection was lost stays in use until `close`: the next call
connects it again, so that trying again is all that a caller need do.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from types import TracebackType
from typing import Protocol, Self, runtime_checkable

from stage.errors import DeviceError


@runtime_checkable
class Device(Protocol):
    """Anything that is opened, used and put away.

    One thread calls a device at a time; `make_safe` alone may be called from another while a call is in progress, which
    then ends soon with `DeviceError`. A camera's `download` may have a thread of its own.
    """

    @property
    def name(self) -> str:
        """How errors call it: what it is and where it is plugged in."""
        ...

    def open(self) -> None:
        """Connect, identify and prepare; does nothing where it is open already."""
        ...

    def close(self) -> None:
        """Let go of the port; callable from any state, any number of times, and never raises."""
        ...

    def make_safe(self) -> None:
        """Go dark, still and idle; callable from any state, any number of times.

        Does nothing on a device that is not in use. Raises `DeviceError` only where the device cannot be reached, so
        that somebody learns that it may not be safe.
        """
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


@dataclass(frozen=True)
class Arrival:
    """The end of a move.

    Attributes
    ----------
    positions : tuple of float
        Where the joints stand, as measured, radians or metres.
    move_s, settle_s : float
        Seconds until they had arrived, and of rest after that.
    """

    positions: tuple[float, ...]
    move_s: float = 0.0
    settle_s: float = 0.0


@runtime_checkable
class AxisGroup(Device, Protocol):
    """Joints that start together, so that a move takes as long as the slowest joint and no longer.

    A joint's value is in radians where it turns and in metres where it slides. A single axis is a group of one.
    """

    @property
    def limits(self) -> tuple[tuple[float, float], ...]:
        """Least and greatest value per joint."""
        ...

    def positions(self) -> tuple[float, ...]:
        """Where the joints are now, as measured."""
        ...

    def move_to(self, targets: Sequence[float]) -> Arrival:
        """Start all joints, wait until all have settled; raise `DeviceError` on limit, stall or timeout.

        Every target is checked before any joint moves.
        """
        ...


@runtime_checkable
class Lamp(Device, Protocol):
    """One light of one or more emitters (a white one, or red, green and blue)."""

    @property
    def emitters(self) -> int:
        """How many levels it takes."""
        ...

    def set_level(self, level: float) -> tuple[float, ...]:
        """Drive all emitters to the same level, 0 to 1; see `set_levels`."""
        ...

    def set_levels(self, levels: Sequence[float]) -> tuple[float, ...]:
        """Drive each emitter to its own level, 0 to 1, and return once the light shows it.

        Returns the levels really set, after rounding to the steps of the wire.
        """
        ...

    def dark(self) -> None:
        """Switch all emitters off."""
        ...


@dataclass(frozen=True)
class Exposure:
    """A photograph that was taken and is still in the camera.

    Attributes
    ----------
    exposure_s : float
        Exposure time that the camera was set to, seconds.
    started_s : float
        When the exposure was asked for, on the clock of the camera's driver.
    expose_s : float
        Seconds until the light was free to move on.
    handle : object
        What the driver fetches it by.
    """

    exposure_s: float
    started_s: float
    expose_s: float
    handle: object


@dataclass(frozen=True)
class CapturedFrame:
    """One photograph as the camera filed it.

    Attributes
    ----------
    data : bytes
        The file, for example a camera RAW (DNG).
    name : str
        The camera's name for it.
    exposure_s : float
        Exposure time that the camera was set to, seconds.
    started_s : float
        When the exposure was asked for, on the clock of the camera's driver.
    expose_s, download_s : float
        Seconds until the light was free to move on, and of the download with the wait for the camera's announcement.
    metadata : mapping of str to str
        Whatever else the device tells (maker, model, serial number, capture date).
    """

    data: bytes
    name: str
    exposure_s: float
    started_s: float
    expose_s: float = 0.0
    download_s: float = 0.0
    metadata: Mapping[str, str] = field(default_factory=dict)


@runtime_checkable
class FrameCamera(Device, Protocol):
    """A still camera."""

    def require_exposure(self, exposure_s: float) -> None:
        """Raise `InputError`, naming the nearest, where the camera does not offer an exposure time."""
        ...

    def nearest_exposure(self, exposure_s: float) -> float:
        """The nearest exposure time that the camera offers, seconds; the same where it takes any."""
        ...

    def expose(self, exposure_s: float) -> Exposure:
        """Expose once, and return when the shutter is closed for certain: the light may move on.

        Raises `InputError` for an exposure time that the camera does not offer.
        """
        ...

    def download(self, exposure: Exposure) -> CapturedFrame:
        """Fetch what `expose` has taken, once, before the next exposure, in this or another thread.

        Raises `DeviceError` where the file does not come, or is not of that exposure: it must be taken again.
        """
        ...

    def capture(self, exposure_s: float) -> CapturedFrame:
        """Expose and download, and once more where that went wrong; raises `InputError` as `expose` does."""
        ...


@runtime_checkable
class Thermometer(Protocol):
    """A device that can tell how hot its parts are, whatever else it does."""

    def temperatures_c(self) -> Mapping[str, float]:
        """Temperature of each part by its name, degrees Celsius; raises `DeviceError` where it cannot be read."""
        ...


class OpenedByWith(ABC):
    """Give a device the `with` statement: opened on entry, made safe and closed on every way out."""

    @abstractmethod
    def open(self) -> None:
        """See `Device.open`."""

    @abstractmethod
    def close(self) -> None:
        """See `Device.close`."""

    @abstractmethod
    def make_safe(self) -> None:
        """See `Device.make_safe`."""

    def __enter__(self) -> Self:
        try:
            self.open()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.make_safe()
        except DeviceError as unsafe:
            if error is None:
                raise
            error.add_note(f"and it could not be made safe: {unsafe}")
        finally:
            self.close()


def make_all_safe(devices: Iterable[Device]) -> list[DeviceError]:
    """Make every device safe, whatever the others do; return the errors of those that could not be."""
    errors: list[DeviceError] = []
    for device in devices:
        try:
            device.make_safe()
        except DeviceError as error:
            errors.append(error)
    return errors
