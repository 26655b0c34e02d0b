"""A PTP camera's network side: PTP/IP over two TCP connections, one for commands and one for events.

References
----------
CIPA DC-005-2005 (PTP-IP): packets (clause 2.3), establishing a connection (2.2), data phases (2.4).
"""

from __future__ import annotations

import struct
import threading
from collections import deque
from collections.abc import Callable
from typing import Protocol

from simulators.ptp import Answer, PtpResponder
from simulators.tcp import Session, TcpPort

INIT_COMMAND, INIT_COMMAND_ACK, INIT_EVENT, INIT_EVENT_ACK, INIT_FAIL = 1, 2, 3, 4, 5
REQUEST, RESPONSE, EVENT, START_DATA, DATA, END_DATA, PROBE, PROBE_ANSWER = 6, 7, 8, 9, 10, 12, 13, 14
DATA_FOLLOWS = 2
FAIL_BUSY, FAIL_UNSPECIFIED = 2, 3
GUID = b"lightstage-sim-1"
VERSION = 0x00010000
PIECE = 1 << 16
LONGEST_PACKET = 1 << 28
POLL_S = 0.004
STEP_S = 0.25
"""The camera waits for its exposures in steps of its world's time, after each of which it may be closed."""


class Clock(Protocol):
    """Time that the camera's waits take."""

    def now(self) -> float:
        """Time, seconds."""
        ...

    def sleep(self, seconds: float) -> None:
        """Let time pass."""
        ...


class PtpIpPort(TcpPort):
    """The camera's address on the network; it takes one initiator at a time.

    Parameters
    ----------
    camera : PtpResponder
        Behind the address. When it falls asleep its connections are dropped.
    clock : Clock
        The world's time. While the camera has an event or an answer due, it waits in this time.
    host : str
        Address to listen on.
    port : int
        15740 is the standard's; 0 takes any free one.
    """

    def __init__(self, camera: PtpResponder, clock: Clock, host: str = "127.0.0.1", port: int = 0) -> None:
        self._camera, self._clock = camera, clock
        self._sessions: list[_PtpIpSession] = []
        self._closing = threading.Event()
        self._plugging = threading.Lock()
        camera.when_asleep(self._hang_up)
        super().__init__(self._answer_the_door, host, port, poll_s=POLL_S)
        # not in the thread that serves the port: who waits keeps the clock's appointments, and one may be to unplug it
        self._waiting = threading.Thread(target=self._let_time_pass, name=f"simulated wait {self.address}", daemon=True)
        self._waiting.start()

    def plug_in(self) -> None:
        """Listen; does nothing while plugged in."""
        with self._plugging:
            super().plug_in()

    def unplug(self) -> None:
        """Reset all connections and listen no more; does nothing while unplugged."""
        with self._plugging:  # a host notices before it is over, and may have it plugged in again from another thread
            super().unplug()

    def close(self) -> None:
        """Unplug for good; callable any number of times."""
        self._closing.set()
        self._waiting.join()
        super().close()

    def _let_time_pass(self) -> None:
        while not self._closing.wait(POLL_S):
            due = [when for session in list(self._sessions) if (when := session.due_s()) is not None]
            if due:
                self._clock.sleep(min(min(due) - self._clock.now(), STEP_S))

    def _answer_the_door(self) -> Session:
        session = _PtpIpSession(self._camera, self._clock, self._sessions)
        self._sessions.append(session)
        return session

    def _hang_up(self) -> None:
        for session in list(self._sessions):
            session.hang_up()


class _PtpIpSession(Session):
    """One connection: what its first packet makes of it, for commands or for events."""

    def __init__(self, camera: PtpResponder, clock: Clock, siblings: list[_PtpIpSession]) -> None:
        self._camera, self._clock, self._siblings = camera, clock, siblings
        self._received = bytearray()
        self._role = 0
        self._ended = False
        self._request: tuple[int, int, tuple[int, ...]] | None = None
        self._sent_along = b""
        self._late: deque[tuple[float, bytes]] = deque()
        self._packets: dict[int, Callable[[bytes], bytes]] = {
            INIT_COMMAND: self._begin_commands,
            INIT_EVENT: self._begin_events,
            REQUEST: self._take_request,
            START_DATA: lambda _payload: b"",
            DATA: self._take_data,
            END_DATA: self._end_data,
            PROBE: lambda _payload: packet(PROBE_ANSWER),
        }

    def feed(self, data: bytes) -> bytes:
        self._received += data
        answers = bytearray()
        while len(self._received) >= 8 and not self._ended:
            length, kind = struct.unpack_from("<II", self._received)
            if not 8 <= length <= LONGEST_PACKET:
                self._ended = True
            if len(self._received) < length:
                break
            payload = bytes(self._received[8:length])
            del self._received[:length]
            try:
                if kind in self._packets:
                    answers += self._packets[kind](payload)
            except struct.error:  # a packet shorter than its kind is: not a host to talk to
                self._ended = True
        return bytes(answers)

    def poll(self) -> bytes:
        said = bytearray()
        while self._late and self._late[0][0] <= self._clock.now():
            said += self._late.popleft()[1]
        while self._role == INIT_EVENT and (event := self._camera.take_event()) is not None:
            said += packet(EVENT, struct.pack("<HII", event[0], 0, event[1]))
        return bytes(said)

    def due_s(self) -> float | None:
        """When the world's time will bring something to say; asked from another thread."""
        if self._role == INIT_EVENT:
            return self._camera.event_due_s()
        late = list(self._late)
        return late[0][0] if late else None

    def finished(self) -> bool:
        return self._ended

    def closed(self) -> None:
        self._siblings.remove(self)
        if self._role == INIT_COMMAND:
            self._camera.reset()
            for session in self._siblings:  # without commands there is nobody to tell events to
                session._ended = session._ended or session._role == INIT_EVENT

    def hang_up(self) -> None:
        self._ended = True
        self._late.clear()

    def _begin_commands(self, _payload: bytes) -> bytes:
        if any(session._role == INIT_COMMAND and not session._ended for session in self._siblings):
            self._ended = True
            return packet(INIT_FAIL, struct.pack("<I", FAIL_BUSY))
        self._role = INIT_COMMAND
        name = "Simulated Camera".encode("utf-16-le") + b"\0\0"
        return packet(INIT_COMMAND_ACK, struct.pack("<I", 1) + GUID + name + struct.pack("<I", VERSION))

    def _begin_events(self, _payload: bytes) -> bytes:
        if not any(session._role == INIT_COMMAND for session in self._siblings):
            self._ended = True
            return packet(INIT_FAIL, struct.pack("<I", FAIL_UNSPECIFIED))
        self._role = INIT_EVENT
        return packet(INIT_EVENT_ACK)

    def _take_request(self, payload: bytes) -> bytes:
        phase, code, number = struct.unpack_from("<IHI", payload)
        count = (len(payload) - 10) // 4
        self._request, self._sent_along = (code, number, struct.unpack_from(f"<{count}I", payload, 10)), b""
        return b"" if phase == DATA_FOLLOWS else self._run()

    def _take_data(self, payload: bytes) -> bytes:
        self._sent_along += payload[4:]
        return b""

    def _end_data(self, payload: bytes) -> bytes:
        self._sent_along += payload[4:]
        return self._run()

    def _run(self) -> bytes:
        if self._request is None or self._role != INIT_COMMAND:
            return b""
        (code, number, values), self._request = self._request, None
        answer = self._camera.operate(code, values, self._sent_along)
        if answer is None:
            return b""
        said = _said(answer, number)
        if not answer.after_s and not self._late:
            return said
        self._late.append((self._clock.now() + answer.after_s, said))
        return b""


def packet(kind: int, payload: bytes = b"") -> bytes:
    """One packet: its length with this header, its kind, its payload."""
    return struct.pack("<II", 8 + len(payload), kind) + payload


def _said(answer: Answer, number: int) -> bytes:
    parts = []
    if answer.data is not None:
        data = answer.data[: answer.sent_bytes]
        pieces = [data[at : at + PIECE] for at in range(0, len(data), PIECE)]
        parts.append(packet(START_DATA, struct.pack("<IQ", number, len(answer.data))))
        parts += [packet(DATA, struct.pack("<I", number) + piece) for piece in pieces]
        if not answer.stalls:
            parts.append(packet(END_DATA, struct.pack("<I", number)))
    if not answer.stalls:
        values = struct.pack(f"<{len(answer.parameters)}I", *answer.parameters)
        parts.append(packet(RESPONSE, struct.pack("<HI", answer.code, number) + values))
    return b"".join(parts)
