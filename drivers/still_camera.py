"""What still cameras have in common, whatever their wire: one picture per release, the right one, or an error.

Cameras fall asleep, lose a release, deliver the file before once more and leave files behind. Drivers add the wire:
how to link, to set an exposure, to release, and to find, read and delete files.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import PurePosixPath
from typing import Generic, TypeVar

from drivers.frame_camera import NoPictureError, TwoStepCamera
from drivers.frame_check import FrameCheck
from stage.clock import Clock, SystemClock
from stage.devices import CapturedFrame, Exposure
from stage.errors import DeviceError, InputError

EXPOSURE_MATCH = 0.02
"""Cameras round: 1/60 s is 166 or 167 ticks, so the nearest offered time within this share is what was meant."""
CAPTURE_TIMEOUT_S = 15.0
"""Beyond the exposure itself."""
RELINK_PAUSES_S = (0.5, 1.0, 1.5)
"""A camera that wakes up takes about a second to be on its wire again."""
GIVEN_UP_S = 1.0
"""Beyond the exposure and read-out: by then a picture that nobody fetched is on the card, or keeps the camera busy."""

T = TypeVar("T")
Setting = TypeVar("Setting")
"""An exposure time as the camera writes it."""
Key = TypeVar("Key")
"""What a file on the card goes by."""


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
    keys : list or None
        The picture's files; None where they are not known (yet).
    link_lost : bool
        Whether the link that it was released on is gone, and with it the announcement.
    """

    setting: Setting
    exposure_s: float
    started_s: float | None = None
    known: set[Key] = field(default_factory=set)
    keys: list[Key] | None = None
    link_lost: bool = False


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


class StillCamera(TwoStepCamera, Generic[Setting, Key]):
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
    shutter_lag_s : float or None
        Longest time from a release to the opening of the shutter, seconds; None where it is not known.
    """

    def __init__(
        self, name: str, release_name: str, clock: Clock | None, capture_timeout_s: float, shutter_lag_s: float | None
    ) -> None:
        self._name, self._release_name = name, release_name
        self._clock = clock or SystemClock()
        self._capture_timeout_s, self._shutter_lag_s = capture_timeout_s, shutter_lag_s
        self._in_use = False
        self._metadata: dict[str, str] = {}
        self._setting: Setting | None = None
        """The exposure time that the camera has; None where that is not known."""
        self._known: set[Key] = set()
        """Files on the card that are no picture of ours."""
        self._pending: Shot[Setting, Key] | None = None
        """What was released and not fetched."""
        self._readout_s = 0.0
        """Longest time from the end of an exposure to its announcement."""
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
    def _take_stock(self) -> None:
        """Know all files that are on the card by now."""

    @abstractmethod
    def _release(self, shot: Shot[Setting, Key]) -> None:
        """Begin to expose; notes in the shot when, and which files were there before."""

    @abstractmethod
    def _await_files(self, shot: Shot[Setting, Key]) -> list[Key]:
        """The files of a shot once they are announced; raises `NoPictureError` where none are."""

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
        self._lose_link()

    def require_exposure(self, exposure_s: float) -> None:
        """Raise `InputError`, naming the nearest, where the camera does not offer an exposure time."""
        self._choose(exposure_s)

    def nearest_exposure(self, exposure_s: float) -> float:
        """The nearest exposure time that the camera offers, seconds."""
        self._require_open()
        return self._nearest(exposure_s)[1]

    def expose(self, exposure_s: float) -> Exposure:
        """Expose once, and return when the shutter is closed for certain.

        That is when the camera announces the file, or earlier where its `shutter_lag_s` is known. A busy camera is
        asked again for some seconds. Where the wire fails or the camera falls asleep it is linked once more, for which
        it has some seconds, and goes on where it was: a picture that is on the card by then is not taken again.

        Raises
        ------
        InputError
            For an exposure time that the camera does not offer; the sentence names the nearest.
        DeviceError
            Where the camera refuses, stops answering, or takes no picture.
        """
        setting, offered_s = self._choose(exposure_s)
        shot: Shot[Setting, Key] = Shot(setting, offered_s)
        self._persistently(lambda: self._take(shot))
        assert shot.started_s is not None
        return Exposure(offered_s, shot.started_s, self._clock.now() - shot.started_s, shot)

    def download(self, exposure: Exposure) -> CapturedFrame:
        """Fetch the file of the latest exposure, then delete it from the camera; nothing is exposed for that.

        Where the wire fails or the camera falls asleep it is linked once more, and the file looked for on the card.

        Raises
        ------
        DeviceError
            Where the camera stops answering or there is no file, its bytes are those of the one before, or it tells
            another exposure time; also for an exposure that is not the latest, or was fetched before.
        """
        shot = self._pending
        if shot is None or shot is not exposure.handle:
            raise DeviceError(f"{self.name}: that exposure was fetched or given up before; take the picture again")
        begun_s = self._clock.now()
        frame = self._persistently(lambda: self._fetch(shot, exposure, begun_s))
        wrong = self._check.fault(frame.data, shot.exposure_s)
        if wrong is not None:
            self._setting = None  # whatever the camera has made of it
            raise NoPictureError(
                f"{self.name}: after {self._release_name} {wrong}; switch it off and on, and check its settings"
            )
        return frame

    def _persistently(self, act: Callable[[], T]) -> T:
        """Carry out a step, and go on with it on a new link where the wire fails."""
        try:
            self._link()
            return act()
        except DeviceError as error:
            if self._has_answered(error):
                raise
            self._drop()
            try:
                self._relink()
                return act()
            except NoPictureError as nothing:
                raise NoPictureError(str(error)) from nothing  # which says why
            except DeviceError as again:
                if not self._has_answered(again):
                    self._drop()
                raise error from again

    def _drop(self) -> None:
        self._unlink()  # in mid-transaction camera and host disagree on what comes next
        self._lose_link()

    def _lose_link(self) -> None:
        if self._pending is not None:
            self._pending.keys, self._pending.link_lost = None, True  # the next session may number its files anew

    def _take(self, shot: Shot[Setting, Key]) -> None:
        if shot.started_s is not None:
            shot.keys = self._find(shot)
            return
        self._give_up()
        if shot.setting != self._setting:
            self._set_exposure(shot.setting)
            self._setting = shot.setting
        self._pending = shot
        self._release(shot)
        if self._shutter_lag_s is None:
            shot.keys = self._announced(shot)
        else:
            self._clock.sleep(self._shutter_lag_s + shot.exposure_s)

    def _announced(self, shot: Shot[Setting, Key]) -> list[Key]:
        assert shot.started_s is not None
        keys = self._await_files(shot)
        took_s = self._clock.now() - shot.started_s - shot.exposure_s
        self._readout_s = max(self._readout_s, min(took_s, self._capture_timeout_s))
        return keys

    def _give_up(self) -> None:
        """Have the picture that nobody fetched on the card, and known there, or it could be taken for the next."""
        if self._pending is None:
            return
        if self._pending.started_s is not None:
            over_s = self._pending.started_s + (self._shutter_lag_s or 0.0) + self._pending.exposure_s
            self._clock.sleep(max(over_s + self._readout_s + GIVEN_UP_S - self._clock.now(), 0.0))
            self._take_stock()
        self._pending = None

    def _fetch(self, shot: Shot[Setting, Key], exposure: Exposure, begun_s: float) -> CapturedFrame:
        if shot.keys is None:
            shot.keys = self._find(shot) if shot.link_lost else self._announced(shot)
        files = {key: self._stored(key) for key in shot.keys}
        # a camera set to RAW and JPEG files both: the RAW is the measurement
        wanted = min(files.values(), key=lambda file: file.is_jpeg)
        data = wanted.download()
        downloaded_s = self._clock.now()
        left = self._tidy(files)
        self._pending = None
        return CapturedFrame(
            data=data,
            name=PurePosixPath(wanted.path).name,
            exposure_s=shot.exposure_s,
            started_s=exposure.started_s,
            expose_s=exposure.expose_s,
            download_s=downloaded_s - begun_s,
            metadata={**self._metadata, **wanted.metadata, **left},
        )

    def _tidy(self, files: Mapping[Key, StoredFile]) -> dict[str, str]:
        """Delete a picture that is safe here from the card, where it only takes room; tells what is left there."""
        try:
            kept = {key: file.path for key, file in files.items() if not file.delete()}
        except DeviceError:
            self._drop()
            kept = {key: file.path for key, file in files.items()}
        self._known = (self._known - files.keys()) | kept.keys()
        return {"left_on_card": ", ".join(sorted(kept.values()))} if kept else {}

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
        self._require_open()
        setting, nearest_s = self._nearest(exposure_s)
        if not abs(nearest_s - exposure_s) <= EXPOSURE_MATCH * exposure_s:
            raise InputError(f"exposure_s: the camera offers no {exposure_s:g} s; the nearest is {nearest_s:g} s")
        return setting, nearest_s

    def _require_open(self) -> None:
        if not self._in_use:
            raise DeviceError(f"{self.name}: it is not open; open it first")
