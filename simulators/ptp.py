"""A still camera that speaks PTP: operations in, responses, files and events out; its pictures are the world's.

Transport-free: `simulators.usb_camera` puts it on USB, `simulators.ptp_ip` on a network.

References
----------
ISO 15740:2013, operations, responses, events and datasets.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from typing import Protocol

from simulators.faults import FaultBoard

OK, NO_SESSION, NOT_SUPPORTED, BAD_HANDLE = 0x2001, 0x2003, 0x2005, 0x2009
BAD_PROPERTY, STORE_FULL, BUSY, BAD_VALUE, ALREADY_OPEN = 0x200A, 0x200C, 0x2019, 0x201C, 0x201E
OBJECT_ADDED, CAPTURE_COMPLETE = 0x4002, 0x400D
EXPOSURE_TIME, EXPOSURE_INDEX = 0x500D, 0x500F
U16, U32 = (0x0004, "<H"), (0x0006, "<I")
STORAGE = 0x00010001
DNG = 0x3811
TICKS_PER_S = 10_000
EXPOSURE_TICKS = (
    *(1, 2, 5, 10, 13, 17, 20, 25, 31, 40, 50, 62, 80, 100, 125, 166, 200, 250, 333, 400, 500, 666, 769),
    *(1000, 1250, 1666, 2000, 2500, 3333, 4000, 5000, 6000, 8000, 10000, 13000, 16000, 20000, 25000, 32000, 40000),
    *(50000, 60000, 80000, 100000, 150000, 200000, 300000),
)
"""1/10000 s to 30 s in about thirds of a stop, as cameras round them."""
SENSITIVITIES = (100, 200, 400, 800, 1600)
SLOW_S = 6.0
"""A RAW file of 50 MB takes 4 to 7 s over USB."""


class World(Protocol):
    """What the camera needs of the world that it looks at."""

    def now(self) -> float:
        """Time, seconds."""
        ...

    def expose(self, exposure_s: float, iso: int = 100) -> bytes:
        """RAW file of an exposure that begins now."""
        ...


class CameraFaults:
    """What goes wrong with the camera: how many more times, by the name it has on the camera's board."""

    NAMES = (
        *("busy", "full", "silent", "session-lost", "lost-picture", "missing-announcement", "missing-completion"),
        *("torn-download", "stalled-download", "slow-download", "repeated-frame", "wrong-exposure"),
    )
    """In turn: 'device busy' or 'card full' in answer to a release; an operation that is not answered; a session that
    the camera has forgotten; a release that comes to nothing; one of the two events not sent; a download that ends
    half-way, that stops half-way without an end, that takes `SLOW_S` longer; the file before once more; an exposure
    of half the time."""

    def __init__(self, board: FaultBoard) -> None:
        self._left = dict.fromkeys(self.NAMES, 0)
        for name in self.NAMES:
            board.offer(name, self._strikes(name))

    def spend(self, name: str) -> bool:
        """Whether the named fault strikes now; counts it down."""
        left = self._left[name]
        self._left[name] = max(left - 1, 0)
        return left > 0

    def _strikes(self, name: str) -> Callable[[int], None]:
        def strike(times: int = 1) -> None:
            self._left[name] = times

        return strike


@dataclass
class Answer:
    """How the camera answers one operation.

    Attributes
    ----------
    code : int
        Response code.
    parameters : tuple of int
        Of the response.
    data : bytes or None
        What comes before the response; None where the operation has no data.
    sent_bytes : int or None
        How much of the data really comes; None for all of it.
    stalls : bool
        Whether nothing more comes after that, not even the response.
    after_s : float
        How much later all of it comes.
    """

    code: int
    parameters: tuple[int, ...] = ()
    data: bytes | None = None
    sent_bytes: int | None = None
    stalls: bool = False
    after_s: float = 0.0


@dataclass
class _Property:
    kind: tuple[int, str]
    value: int
    allowed: tuple[int, ...]

    def pack(self, value: int) -> bytes:
        return struct.pack(self.kind[1], value)


@dataclass(order=True)
class _Due:
    time_s: float
    code: int = field(compare=False)
    parameter: int = field(compare=False)
    file: tuple[int, bytes] | None = field(compare=False, default=None)


class PtpResponder:
    """The camera's firmware.

    Parameters
    ----------
    world : World
        What it looks at, and whose time its exposures take.
    readout_s : float
        From the end of the exposure to the file on the card.
    download_s : float
        What a file takes to come over the wire, beyond what the simulated wire itself takes.
    recovery_s : float
        For so long after a file is on the card the next release is refused; 0.35 to 0.5 s on some cameras.
    serial_number : str
        What it says it is.
    lacks : collection of int
        Operations that this model does not offer.

    Attributes
    ----------
    board : FaultBoard
        What can go wrong with it; it counts operations.
    """

    def __init__(
        self,
        world: World,
        *,
        readout_s: float = 0.05,
        download_s: float = 0.0,
        recovery_s: float = 0.0,
        serial_number: str = "LS0001",
        lacks: Collection[int] = (),
    ) -> None:
        self.board = FaultBoard()
        self.board.offer("asleep", self._fall_asleep)
        self.serial_number = serial_number
        self._faults = CameraFaults(self.board)
        self._world = world
        self._readout_s, self._download_s, self._recovery_s = readout_s, download_s, recovery_s
        self._lose_links: list[Callable[[], None]] = []
        self._slept = False
        self._session = 0
        self._files: dict[int, bytes] = {}
        self._next_handle = 1
        self._last = b""
        self._recovered_s = -math.inf
        self._due: list[_Due] = []
        self._properties = {
            EXPOSURE_TIME: _Property(U32, 200, EXPOSURE_TICKS),
            EXPOSURE_INDEX: _Property(U16, 100, SENSITIVITIES),
        }
        operations: dict[int, Callable[[tuple[int, ...], bytes], Answer]] = {
            0x1001: self._device_info,
            0x1002: self._open_session,
            0x1003: self._close_session,
            0x1004: lambda _p, _d: Answer(OK, data=_array("I", (STORAGE,))),
            0x1005: self._storage_info,
            0x1006: lambda _p, _d: Answer(OK, (len(self._files),)),
            0x1007: lambda _p, _d: Answer(OK, data=_array("I", tuple(self._files))),
            0x1008: self._object_info,
            0x1009: self._object,
            0x100B: self._delete,
            0x100E: self._capture,
            0x1014: self._describe,
            0x1015: self._value,
            0x1016: self._set_value,
        }
        self._operations = {code: run for code, run in operations.items() if code not in lacks}

    def when_asleep(self, lose_link: Callable[[], None]) -> None:
        """Have the camera's port called when it falls asleep: its link ends there, and it can be found anew."""
        self._lose_links.append(lose_link)

    def operate(self, code: int, parameters: tuple[int, ...], data: bytes = b"") -> Answer | None:
        """Carry out one operation; None where the camera stays silent."""
        self._slept = False
        self.board.message()
        self._settle()
        if self._slept or self._faults.spend("silent"):
            return None
        if self._faults.spend("session-lost"):
            self.reset()
        if code not in self._operations:
            return Answer(NOT_SUPPORTED)
        if not self._session and code not in (0x1001, 0x1002):
            return Answer(NO_SESSION)
        return self._operations[code]((*parameters, 0, 0, 0), data)

    def now(self) -> float:
        """Time of the camera's world, seconds."""
        return self._world.now()

    def reset(self) -> None:
        """Forget the session, as after the USB class request 'device reset' or a lost connection."""
        self._session = 0

    def event_due_s(self) -> float | None:
        """When the next event will be sent, or None where none is on its way."""
        due = list(self._due)  # asked from another thread where the camera waits in one of its own
        return min(due).time_s if due else None

    def take_event(self) -> tuple[int, int] | None:
        """Code and parameter of the next event, if its time has come."""
        if not self._due or min(self._due).time_s > self._world.now():
            return None
        due = min(self._due)
        self._due.remove(due)
        self._file(due)
        missing = "missing-announcement" if due.code == OBJECT_ADDED else "missing-completion"
        if self._faults.spend(missing):
            return self.take_event()
        return due.code, due.parameter

    def _settle(self) -> None:
        for due in self._due:
            if due.time_s <= self._world.now():
                self._file(due)

    def _file(self, due: _Due) -> None:
        if due.file is not None:
            self._files[due.file[0]] = due.file[1]
            due.file = None

    def _device_info(self, _parameters: tuple[int, ...], _data: bytes) -> Answer:
        data = struct.pack("<HIH", 100, 0, 0) + _text("") + struct.pack("<H", 0)
        data += _array("H", tuple(self._operations)) + _array("H", (OBJECT_ADDED, CAPTURE_COMPLETE))
        data += _array("H", tuple(self._properties)) + _array("H", (DNG,)) + _array("H", (DNG,))
        data += _text("Lightstage") + _text("Simulated Camera") + _text("1.0") + _text(self.serial_number)
        return Answer(OK, data=data)

    def _open_session(self, parameters: tuple[int, ...], _data: bytes) -> Answer:
        if self._session:
            return Answer(ALREADY_OPEN, (self._session,))
        self._session = parameters[0]
        return Answer(OK)

    def _close_session(self, _parameters: tuple[int, ...], _data: bytes) -> Answer:
        self._session = 0
        return Answer(OK)

    def _storage_info(self, _parameters: tuple[int, ...], _data: bytes) -> Answer:
        # removable memory, generic hierarchy, read and write; its size, what is free of it in bytes and in pictures
        data = struct.pack("<HHHQQI", 4, 2, 0, 1 << 36, 1 << 35, 9999)
        return Answer(OK, data=data + _text("card") + _text(""))

    def _object_info(self, parameters: tuple[int, ...], _data: bytes) -> Answer:
        handle = parameters[0]
        if handle not in self._files:
            return Answer(BAD_HANDLE)
        size = len(self._files[handle])
        data = struct.pack("<IHHIH7IHII", STORAGE, DNG, 0, size, 0, *[0] * 7, 0, 0, handle)
        return Answer(OK, data=data + _text(f"LS{handle:06d}.DNG") + _text("20200101T000000") + _text("") + _text(""))

    def _object(self, parameters: tuple[int, ...], _data: bytes) -> Answer:
        handle = parameters[0]
        if handle not in self._files:
            return Answer(BAD_HANDLE)
        data = self._files[handle]
        torn, stalled = self._faults.spend("torn-download"), self._faults.spend("stalled-download")
        return Answer(
            OK,
            data=data,
            sent_bytes=len(data) // 2 if torn or stalled else None,
            stalls=stalled,
            after_s=self._download_s + SLOW_S * self._faults.spend("slow-download"),
        )

    def _delete(self, parameters: tuple[int, ...], _data: bytes) -> Answer:
        return Answer(BAD_HANDLE if self._files.pop(parameters[0], None) is None else OK)

    def _capture(self, _parameters: tuple[int, ...], _data: bytes) -> Answer:
        now = self._world.now()
        if self._faults.spend("full"):
            return Answer(STORE_FULL)
        if now < self._recovered_s or any(due.time_s > now for due in self._due) or self._faults.spend("busy"):
            return Answer(BUSY)
        if self._faults.spend("lost-picture"):
            return Answer(OK)
        exposure_s = self._properties[EXPOSURE_TIME].value / TICKS_PER_S
        if self._faults.spend("wrong-exposure"):
            exposure_s /= 2
        picture = self._world.expose(exposure_s, self._properties[EXPOSURE_INDEX].value)
        if self._last and self._faults.spend("repeated-frame"):
            picture = self._last
        self._last = picture
        ready = now + exposure_s + self._readout_s
        self._recovered_s = ready + self._recovery_s
        handle, self._next_handle = self._next_handle, self._next_handle + 1
        self._due += [_Due(ready, OBJECT_ADDED, handle, (handle, picture)), _Due(ready, CAPTURE_COMPLETE, 0)]
        return Answer(OK)

    def _fall_asleep(self) -> None:
        self._slept = True
        self.reset()
        for lose_link in self._lose_links:
            lose_link()

    def _describe(self, parameters: tuple[int, ...], _data: bytes) -> Answer:
        prop = self._properties.get(parameters[0])
        if prop is None:
            return Answer(BAD_PROPERTY)
        data = struct.pack("<HHB", parameters[0], prop.kind[0], 1) + prop.pack(prop.allowed[0]) + prop.pack(prop.value)
        data += struct.pack("<BH", 2, len(prop.allowed)) + b"".join(prop.pack(value) for value in prop.allowed)
        return Answer(OK, data=data)

    def _value(self, parameters: tuple[int, ...], _data: bytes) -> Answer:
        prop = self._properties.get(parameters[0])
        return Answer(BAD_PROPERTY) if prop is None else Answer(OK, data=prop.pack(prop.value))

    def _set_value(self, parameters: tuple[int, ...], data: bytes) -> Answer:
        prop = self._properties.get(parameters[0])
        if prop is None:
            return Answer(BAD_PROPERTY)
        if len(data) != struct.calcsize(prop.kind[1]):
            return Answer(BAD_VALUE)
        (value,) = struct.unpack(prop.kind[1], data)
        if value not in prop.allowed:
            return Answer(BAD_VALUE)
        prop.value = value
        return Answer(OK)


def _text(text: str) -> bytes:
    if not text:
        return b"\0"
    return bytes([len(text) + 1]) + text.encode("utf-16-le") + b"\0\0"


def _array(code: str, values: tuple[int, ...]) -> bytes:
    return struct.pack(f"<I{len(values)}{code}", len(values), *values)
