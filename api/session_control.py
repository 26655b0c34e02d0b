"""Commands to a running session from another terminal: JSON lines over a Unix socket in the capture's folder.

::

    {"command": "status"}                           any of `COMMANDS`
    {"command": "pause", "reason": "a visitor"}
    {"command": "retake", "shot": 7, "reason": "the dog"}

An answer holds ``"ok": true``, the ``status`` and, after an emergency stop, what is ``unsafe``; or ``"ok": false`` and
the ``error``, one sentence. Every connection has a thread of its own, so that nothing can stand in an emergency stop's
way. The socket is its owner's only.
"""

from __future__ import annotations

import json
import os
import shutil
import socket
import stat
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from stage.errors import DeviceError, InputError
from stage.validation import first_fault

if TYPE_CHECKING:  # a client needs none of it, and is to answer at once
    from acquisition.session import Session

SOCKET = "control.sock"
"""A socket; or a file that names one, where the folder's disk takes no sockets or its path is too long for one."""
Command = Literal["status", "pause", "resume", "stop", "abort", "emergency-stop", "skip", "retake"]
COMMANDS: tuple[str, ...] = get_args(Command)
CONNECTIONS = 16
"""That may be open at a time; one more, and the oldest is hung up on."""
LINE_BYTES, REASON_CHARACTERS = 1 << 14, 500
IDLE_S, POLL_S = 60.0, 0.1
CLOSE_S = 5.0
"""Longest wait for answers that are under way when the session ends."""
CONNECT_S, ANSWER_S, STOPPED_S = 2.0, 10.0, 60.0
"""Longest waits of a client; for an emergency stop every device is waited for."""
GOING: Final = ("running", "pausing", "paused", "suspended")
FITTING: Final = {
    "pause": GOING,
    "resume": ("pausing", "paused"),
    "stop": (*GOING, "stopping"),
    "abort": (*GOING, "stopping"),
    "skip": GOING,
    "retake": GOING,
}
"""Phases in which a command makes sense; those that are not named always do."""


class Request(BaseModel):
    """One line of a client."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    command: Command
    reason: str = Field(default="asked for from another terminal", min_length=1, max_length=REASON_CHARACTERS)
    shot: int | None = None


@contextmanager
def controlled(session: Session, folder: Path, note: Callable[[str], None] = lambda sentence: None) -> Iterator[None]:
    """Let a session be controlled from other processes, for as long as it runs.

    Parameters
    ----------
    session : Session
        Its methods are called from threads of this context.
    folder : Path
        Of the capture's record, which is locked against a second session. What a killed one has left is replaced.
    note : callable
        Told in one sentence where control is not possible; the session goes on without.
    """
    try:
        listener, left_behind = _listen(folder.resolve())
    except OSError as error:
        note(f"{folder}: the session cannot be controlled from another terminal ({error.strerror or error})")
        yield
        return
    server = _Server(session, listener)
    try:
        yield
    finally:
        for path in left_behind:
            with suppress(OSError):
                path.rmdir() if path.is_dir() else path.unlink(missing_ok=True)
        server.close()


def ask(out: Path, command: str, *, reason: str | None = None, shot: int | None = None) -> dict[str, Any]:
    """Give a command to the session that is running in a folder.

    Parameters
    ----------
    out : Path
        Folder of the dataset.
    command : str
        One of `COMMANDS`.
    reason : str, optional
        For the record.
    shot : int, optional
        Index of the shot to take again.

    Returns
    -------
    dict
        The answer: ``status`` and, after an emergency stop, ``unsafe``, sentences.

    Raises
    ------
    InputError
        Where no session is running there, or it refuses.
    DeviceError
        Where it does not answer.
    """
    if reason is not None and not 0 < len(reason) <= REASON_CHARACTERS:
        raise InputError(f"--reason: expected 1 to {REASON_CHARACTERS} characters, got {len(reason)}")
    given = {"command": command, "reason": reason, "shot": shot}
    request = json.dumps({key: value for key, value in given.items() if value is not None}).encode() + b"\n"
    wait_s = STOPPED_S if command == "emergency-stop" else ANSWER_S
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as wire:
            deadline = time.monotonic() + wait_s
            _connect(wire, _address(out.resolve() / "capture" / SOCKET), deadline)
            answer = _answer_to(wire, request, deadline)
    except PermissionError:
        raise InputError(f"{out}: its session belongs to another user") from None
    except TimeoutError:
        raise DeviceError(
            f"{out}: the session has not answered {command} within {wait_s:g} s; "
            "interrupt it where it runs, and switch the stage's power off if it must stop"
        ) from None
    except (OSError, ValueError):
        raise InputError(f"{out}: no session is running here") from None
    if not answer["ok"]:
        raise InputError(f"{out}: {answer['error']}")
    return answer


def _connect(wire: socket.socket, address: str, deadline: float) -> None:
    wire.settimeout(CONNECT_S)
    while True:
        try:
            return wire.connect(address)
        except BlockingIOError:  # too many are waiting to be let in
            if time.monotonic() > deadline:
                raise TimeoutError from None
            time.sleep(POLL_S)


def _answer_to(wire: socket.socket, request: bytes, deadline: float) -> dict[str, Any]:
    """Send a line and read one; raises `ValueError` where the other end goes away."""
    wire.sendall(request)
    said = b""
    while not said.endswith(b"\n"):
        wire.settimeout(max(deadline - time.monotonic(), 1e-3))
        said += (piece := wire.recv(1 << 16))
        if not piece:
            raise ValueError("hung up")
    answer: dict[str, Any] = json.loads(said)
    return answer


def _address(place: Path) -> str:
    if stat.S_ISSOCK(place.lstat().st_mode):
        return str(place)
    return place.read_text(encoding="utf-8").strip()


def _listen(folder: Path) -> tuple[socket.socket, list[Path]]:
    """A listening socket for a folder, and what has to be removed after it, in this order."""
    place = folder / SOCKET
    _clear(place)
    try:
        return _bound(place), [place]
    except OSError:  # too long a name, or a file system without sockets
        away = Path(tempfile.mkdtemp(prefix="lightstage-", dir=_runtime_folder()))
    try:
        listener = _bound(away / SOCKET)
        place.write_text(f"{away / SOCKET}\n", encoding="utf-8")
    except OSError:
        shutil.rmtree(away, ignore_errors=True)
        raise
    return listener, [place, away / SOCKET, away]


def _runtime_folder() -> str | None:
    """Where a user's sockets belong; None for where temporary files do."""
    folder = os.environ.get("XDG_RUNTIME_DIR")
    return folder if folder and os.access(folder, os.W_OK) else None


def _bound(place: Path) -> socket.socket:
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        listener.bind(str(place))
        place.chmod(0o600)  # before it listens, so that nobody is quicker
        listener.listen()
        listener.settimeout(POLL_S)
    except BaseException:
        listener.close()
        with suppress(OSError):
            place.unlink(missing_ok=True)
        raise
    return listener


def _clear(place: Path) -> None:
    """Remove what a session that was killed has left."""
    with suppress(OSError, ValueError):
        away = Path(_address(place))
        if away != place and stat.S_ISSOCK(away.lstat().st_mode):
            away.unlink()
            away.parent.rmdir()
    place.unlink(missing_ok=True)


class _Server:
    """Accepts connections in a thread, and serves each in another."""

    def __init__(self, session: Session, listener: socket.socket) -> None:
        self._session, self._listener = session, listener
        self._connections: dict[socket.socket, threading.Thread] = {}
        self._lock = threading.Lock()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._accept, name="session control")
        self._thread.start()

    def close(self) -> None:
        """Let answers that are under way go out, and end all threads."""
        self._closing.set()
        self._thread.join()
        self._listener.close()
        deadline = time.monotonic() + CLOSE_S
        for how in (socket.SHUT_RD, socket.SHUT_RDWR):
            for wire, thread in self._open():
                _hang_up(wire, how)
                thread.join(max(deadline - time.monotonic(), POLL_S))

    def _open(self) -> list[tuple[socket.socket, threading.Thread]]:
        with self._lock:
            return list(self._connections.items())

    def _accept(self) -> None:
        while not self._closing.is_set():
            try:
                wire, _ = self._listener.accept()
            except TimeoutError:
                continue
            except OSError:  # the client was quick to go, or there are too many files open
                self._closing.wait(POLL_S)
                continue
            for oldest, _ in self._open()[: 1 - CONNECTIONS]:
                _hang_up(oldest, socket.SHUT_RDWR)
            thread = threading.Thread(target=self._serve, args=(wire,), name="session control of one client")
            with self._lock:
                self._connections[wire] = thread
            thread.start()

    def _serve(self, wire: socket.socket) -> None:
        pending = b""
        try:
            with suppress(OSError), wire:  # whoever goes away or falls silent is forgotten
                wire.settimeout(IDLE_S)
                while len(pending) <= LINE_BYTES and (data := wire.recv(LINE_BYTES)):
                    *lines, pending = (pending + data).split(b"\n")
                    for line in lines:
                        wire.sendall(json.dumps(self._answer(line)).encode() + b"\n")
        finally:
            with self._lock:
                del self._connections[wire]

    def _answer(self, line: bytes) -> dict[str, Any]:
        try:
            request = Request.model_validate_json(line)
            unsafe = self._obey(request)
            return {"ok": True, "status": self._session.status().model_dump(mode="json"), "unsafe": unsafe}
        except ValidationError as error:
            return {"ok": False, "error": first_fault(error).removeprefix(": ")}
        except (InputError, DeviceError) as error:
            return {"ok": False, "error": str(error)}
        except Exception as error:  # whoever has asked for an emergency stop must not be left without an answer
            return {"ok": False, "error": f"the session's answer failed with {type(error).__name__}: {error}"}

    def _obey(self, request: Request) -> list[str]:
        session, phase = self._session, self._session.phase.value
        if phase not in FITTING.get(request.command, (phase,)):
            raise InputError(f"command: the session is {phase}, so there is nothing to {request.command}")
        match request.command:
            case "pause":
                session.pause(request.reason)
            case "resume":
                session.resume()
            case "stop":
                session.stop(request.reason)
            case "abort":
                session.abort(request.reason)
            case "emergency-stop":
                return [str(danger) for danger in session.emergency_stop(request.reason)]
            case "skip":
                session.skip(request.reason)
            case "retake":
                if request.shot is None:
                    raise InputError("shot: retake needs the number of a shot")
                session.retake(request.shot, request.reason)
        return []


def _hang_up(wire: socket.socket, how: int) -> None:
    with suppress(OSError):
        wire.shutdown(how)
