"""What still cameras have in common, whatever their wire: one picture per call, the right one, or an error.

Cameras fall asleep, lose a release, deliver the file before once more and leave files behind. Drivers add the wire:
how to link, to set an exposure, to release, and to find, read and delete files.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import PurePosixPath
from typing import Generic, TypeVar

from drivers.frame_check import FrameCheck
from stage.clock import Clock, SystemClock
from stage.devices import CapturedFrame, OpenedByWith
from stage.errors import DeviceError, InputError

EXPOSURE_MATCH = 0.02
"""Cameras round: 1/60 s is 166 or 167 ticks, so the nearest offered time within this share is what was meant."""
CAPTURE_TIMEOUT_S = 15.0
"""Beyond the exposure itself."""
RELINK_PAUSES_S = (0.5, 1.0, 1.5)
"""A camera that wakes up takes about a second to be on its wire again."""
SHOTS = 2
"""A picture that does not come, comes twice or is exposed wrongly is taken once more."""

Setting = TypeVar("Setting")
"""An exposure time as the camera writes it."""
Key = TypeVar("Key")
"""What a file on the card goes by."""


class NoPictureError(DeviceError):
    """The camera took a release, and nothing came of it."""


@dataclass
class Shot(Generic[Setting, Key]):
    """How far one release has come; outlives the link that it began on.

    Attributes
    ----------
    setting, exposure_s
        The exposure time, as the camera writes it and in seconds.
    started_s : float or None
        When it was released, on the driver's clock; None where it was not yet.
    known : set
        The files that were there before.
    """

    setting: Setting
    exposure_s: float
    started_s: float | None = None
    known: set[Key] = field(default_factory=set)


@dataclass(frozen=True)
class StoredFile:
    """A file on the card.

    Attributes
    ----------
    path : str
        Its name, with the folder where the camera tells it.
    is_jpeg : bool
        Whether it is a JPEG file, and so no measurement where there is another.
    download : callable
        Reads it, whole.
    delete : callable
        Removes it; returns False where the camera will not.
    metadata : mapping of str to str
        What the camera tells of it.
    """

    path: str
    is_jpeg: bool
    download: Callable[[], bytes]
    delete: Callable[[], bool]
    metadata: Mapping[str, str] = field(default_factory=dict)


class StillCamera(OpenedByWith, Generic[Setting, Key]):
    """A still camera; drivers add the wire.

    Parameters
    ----------
    name : str
        Device and wire; drivers may add what they learn.
    release_name : str
        What the wire calls a release, for errors.
    clock : Clock or None
        Deadlines and pauses; the system's where None.
    capture_timeout_s : float
        How long a picture may take beyond its exposure, seconds.
    """

    def __init__(self, name: str, release_name: str, clock: Clock | None, capture_timeout_s: float) -> None:
        self._name, self._release_name = name, release_name
        self._clock = clock or SystemClock()
        self._capture_timeout_s = capture_timeout_s
        self._in_use = False
        self._metadata: dict[str, str] = {}
        self._setting: Setting | None = None
        """The exposure time that the camera has; None where that is not known."""
        self._known: set[Key] = set()
        """Files on the card that are no picture of ours."""
        self._check = FrameCheck()

    @abstractmethod
    def _link(self) -> None:
        """Have an open session, and know what the camera offers and holds; nothing where there is one."""

    @abstractmethod
    def _unlink(self) -> None:
        """Drop the session without a word; never raises."""

    @abstractmethod
    def _end(self) -> None:
        """Take leave of the camera and drop the session; never raises."""

    @abstractmethod
    def _has_answered(self, error: DeviceError) -> bool:
        """Whether an error is the camera's answer, which a new session would not change."""

    @abstractmethod
    def _nearest(self, exposure_s: float) -> tuple[Setting, float]:
        """The nearest offered exposure time, as the camera writes it and in seconds."""

    @abstractmethod
    def _set_exposure(self, setting: Setting) -> None:
        """Set an offered exposure time."""

    @abstractmethod
    def _release(self, shot: Shot[Setting, Key]) -> list[Key]:
        """Expose, and return the picture's files; notes in the shot when, and which files were there before."""

    @abstractmethod
    def _find(self, shot: Shot[Setting, Key]) -> list[Key]:
        """The files of a shot that was released on an earlier link; raises `NoPictureError` where there are none."""

    @abstractmethod
    def _stored(self, key: Key) -> StoredFile:
        """A file on the card."""

    @property
    def name(self) -> str:
        """Device and wire, and its model once that is known."""
        return self._name

    def open(self) -> None:
        """Find the camera, take it for this program alone, and read what it offers."""
        self._link()
        self._in_use = True

    def close(self) -> None:
        """Let go of the camera; never raises."""
        self._in_use = False
        self._end()

    def make_safe(self) -> None:
        """Do nothing: a camera neither moves nor shines, and every exposure here ends by itself."""

    def require_exposure(self, exposure_s: float) -> None:
        """Raise `InputError`, naming the nearest, where the camera does not offer an exposure time."""
        self._choose(exposure_s)

    def capture(self, exposure_s: float) -> CapturedFrame:
        """Expose once and download the file, then delete it from the camera.

        A busy camera is asked again for some seconds. Where the wire fails or the camera falls asleep it is linked
        once more, for which it has some seconds, and goes on where it was: a picture that is on the card by then is
        not taken again. A picture that does not come, has the bytes of the one before, or tells another exposure time
        is taken once more.

        Raises
        ------
        InputError
            For an exposure time that the camera does not offer; the sentence names the nearest.
        DeviceError
            Where the camera refuses, stops answering, or delivers no such picture.
        """
        setting, offered_s = self._choose(exposure_s)
        fault = ""
        for _ in range(SHOTS):
            try:
                frame = self._shoot(Shot(setting, offered_s))
            except NoPictureError as error:
                fault = str(error)
                continue
            wrong = self._check.fault(frame.data, offered_s)
            if wrong is None:
                return frame
            fault = f"{self.name}: after {self._release_name} {wrong}; switch it off and on, and check its settings"
            self._setting = None  # whatever the camera has made of it
        raise DeviceError(fault)

    def _shoot(self, shot: Shot[Setting, Key]) -> CapturedFrame:
        try:
            self._link()
            return self._take(shot)
        except DeviceError as error:
            if self._has_answered(error):
                raise
            self._unlink()  # in mid-transaction camera and host disagree on what comes next
            try:
                self._relink()
                return self._take(shot)
            except NoPictureError as nothing:
                raise NoPictureError(str(error)) from nothing  # which says why
            except DeviceError as again:
                if not self._has_answered(again):
                    self._unlink()
                raise error from again

    def _take(self, shot: Shot[Setting, Key]) -> CapturedFrame:
        if shot.started_s is None:
            if shot.setting != self._setting:
                self._set_exposure(shot.setting)
                self._setting = shot.setting
            keys = self._release(shot)
        else:
            keys = self._find(shot)
        assert shot.started_s is not None
        announced_s = self._clock.now()
        files = {key: self._stored(key) for key in keys}
        # a camera set to RAW and JPEG files both: the RAW is the measurement
        wanted = min(files.values(), key=lambda file: file.is_jpeg)
        data = wanted.download()
        downloaded_s = self._clock.now()
        kept = {key: file.path for key, file in files.items() if not file.delete()}
        self._known = (self._known - set(keys)) | set(kept)  # the picture is safe here; there it only takes room
        left = {"left_on_card": ", ".join(sorted(kept.values()))} if kept else {}
        return CapturedFrame(
            data=data,
            name=PurePosixPath(wanted.path).name,
            exposure_s=shot.exposure_s,
            started_s=shot.started_s,
            expose_s=announced_s - shot.started_s,
            download_s=downloaded_s - announced_s,
            metadata={**self._metadata, **wanted.metadata, **left},
        )

    def _relink(self) -> None:
        deadline = self._clock.now() + sum(RELINK_PAUSES_S)
        for pause_s in RELINK_PAUSES_S:
            try:
                return self._link()
            except DeviceError:
                if self._clock.now() >= deadline:
                    raise
            self._clock.sleep(pause_s)
        return self._link()

    def _choose(self, exposure_s: float) -> tuple[Setting, float]:
        if not self._in_use:
            raise DeviceError(f"{self.name}: it is not open; open it first")
        setting, nearest_s = self._nearest(exposure_s)
        if not abs(nearest_s - exposure_s) <= EXPOSURE_MATCH * exposure_s:
            raise InputError(f"exposure_s: the camera offers no {exposure_s:g} s; the nearest is {nearest_s:g} s")
        return setting, nearest_s
