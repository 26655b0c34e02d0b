"""TCP servers: a simulator on one end, and on the other an address that a driver connects to as to any device."""

from __future__ import annotations

import os
import selectors
import socket
import struct
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from types import TracebackType
from typing import Self

RECEIVE_SIZE = 1 << 16
BACKLOG_SIZE = 1 << 22
"""A host that reads so slowly that this much waits for it is sent nothing new until it has caught up."""
_RESET_ON_CLOSE = struct.pack("ii", 1, 0)  # SO_LINGER: on, 0 s


class Session(ABC):
    """What a device says over one connection: a state machine with no socket and no thread.

    All methods of all sessions of one `TcpPort` are called from one thread, one after the other.
    """

    def greeting(self) -> bytes:
        """What the device says first."""
        return b""

    @abstractmethod
    def feed(self, data: bytes) -> bytes:
        """Answer what the host sent; data arrives in pieces of any size."""

    def poll(self) -> bytes:
        """What the device says of its own accord; called every `poll_s` of its port."""
        return b""

    def finished(self) -> bool:
        """Whether the device hangs up once everything it said is on its way; asked after each `feed` and `poll`."""
        return False

    def closed(self) -> None:
        """The connection is gone, whoever ended it."""
        return None


@dataclass(eq=False)
class _Connection:
    wire: socket.socket
    session: Session
    outbox: bytearray = field(default_factory=bytearray)


class TcpPort:
    """A listening socket that a simulator answers on, pumped by a thread of its own.

    The address stays the same over unplugging and plugging in again.

    Parameters
    ----------
    serve : callable
        Makes the session of a new connection; it may return one object again and again to share its state.
    host : str
        Address to listen on. All of 127.0.0.0/8 is this machine, so several devices of one fixed port can coexist.
    port : int
        0 takes any free one, see `port`.
    poll_s : float, optional
        How often sessions are asked for data of their own accord; never where None.

    Attributes
    ----------
    host, port
        Where it listens.
    """

    def __init__(
        self,
        serve: Callable[[], Session],
        host: str = "127.0.0.1",
        port: int = 0,
        *,
        poll_s: float | None = None,
    ) -> None:
        self._serve, self._poll_s = serve, poll_s
        self.host, self.port = host, port
        self._thread: threading.Thread | None = None
        self._late: list[float] = []
        self._stop_reader = self._stop_writer = -1
        self.plug_in()

    @property
    def address(self) -> str:
        """Host and port as people write them."""
        return f"{self.host}:{self.port}"

    def plug_in(self) -> None:
        """Listen; does nothing while plugged in."""
        if self._thread is not None:
            return
        listener = socket.create_server((self.host, self.port))
        listener.setblocking(False)
        self.port = listener.getsockname()[1]
        self._stop_reader, self._stop_writer = os.pipe()
        name = f"simulated {self.address}"
        self._thread = threading.Thread(target=self._pump, args=(listener,), name=name, daemon=True)
        self._thread.start()

    def unplug(self) -> None:
        """Reset all connections and listen no more; does nothing while unplugged."""
        if self._thread is None:
            return
        os.write(self._stop_writer, b"x")
        self._thread.join()
        self._thread = None
        for end in (self._stop_reader, self._stop_writer):
            os.close(end)

    def close(self) -> None:
        """Unplug for good; callable any number of times."""
        self.unplug()

    def hold_back(self, seconds: float) -> None:
        """Let the next answer arrive so much later, in real time."""
        self._late.append(seconds)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _pump(self, listener: socket.socket) -> None:
        with selectors.DefaultSelector() as selector, listener:
            selector.register(listener, selectors.EVENT_READ)
            selector.register(self._stop_reader, selectors.EVENT_READ)
            connections: dict[int, _Connection] = {}
            due = time.monotonic()
            try:
                while True:
                    events = selector.select(None if self._poll_s is None else max(due - time.monotonic(), 0.0))
                    for key, mask in events:
                        if key.fd == self._stop_reader:
                            return
                        if key.fd == listener.fileno():
                            self._accept(listener, selector, connections)
                        elif not self._exchange(connections[key.fd], mask):
                            self._drop(connections.pop(key.fd), selector)
                    if self._poll_s is not None and time.monotonic() >= due:
                        due = max(due + self._poll_s, time.monotonic())
                        for connection in connections.values():
                            if len(connection.outbox) < BACKLOG_SIZE:
                                connection.outbox += connection.session.poll()
                    for number, connection in list(connections.items()):
                        if not self._send(connection, selector):
                            self._drop(connections.pop(number), selector)
            finally:
                for connection in connections.values():
                    connection.wire.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET_ON_CLOSE)
                    self._drop(connection, selector)

    def _accept(
        self, listener: socket.socket, selector: selectors.BaseSelector, connections: dict[int, _Connection]
    ) -> None:
        try:
            wire, _ = listener.accept()
        except OSError:  # the host changed its mind before it was answered
            return
        wire.setblocking(False)
        wire.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        session = self._serve()
        connections[wire.fileno()] = _Connection(wire, session, bytearray(session.greeting()))
        selector.register(wire, selectors.EVENT_READ)

    def _exchange(self, connection: _Connection, mask: int) -> bool:
        """Hear the host out; False where it has hung up."""
        if not mask & selectors.EVENT_READ:
            return True
        try:
            data = connection.wire.recv(RECEIVE_SIZE)
            # a host that leaves Nagle on holds back the rest until this much is acknowledged; Linux forgets the option
            if hasattr(socket, "TCP_QUICKACK"):
                connection.wire.setsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)
        except BlockingIOError:
            return True
        except OSError:
            return False
        answer = connection.session.feed(data) if data else b""
        if answer and self._late:
            time.sleep(self._late.pop(0))
        connection.outbox += answer
        return bool(data)

    @staticmethod
    def _send(connection: _Connection, selector: selectors.BaseSelector) -> bool:
        """Send what the host takes now; False where there is nobody left to send to, or nothing left to say."""
        outbox = connection.outbox
        try:
            while outbox:
                del outbox[: connection.wire.send(outbox)]
        except BlockingIOError:
            pass
        except OSError:
            return False
        if connection.session.finished() and not outbox:
            return False
        # Who does not read is not listened to either, until it has caught up.
        wanted = selectors.EVENT_READ if len(outbox) < BACKLOG_SIZE else 0
        if outbox:
            wanted |= selectors.EVENT_WRITE
        selector.modify(connection.wire, wanted)
        return True

    @staticmethod
    def _drop(connection: _Connection, selector: selectors.BaseSelector) -> None:
        selector.unregister(connection.wire)
        connection.wire.close()
        connection.session.closed()
