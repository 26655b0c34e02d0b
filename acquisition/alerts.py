"""Alerts: somebody elsewhere is told when an unattended session needs them.

A hook (a web address or a command) is called from a thread of its own, so that the session never waits for it, and in a
process of its own, so that it can be killed whatever it does. Both live in real time.
"""

from __future__ import annotations

import json
import math
import shlex
import shutil
import sys
import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Final, Protocol, Self
from urllib.parse import urlsplit

from acquisition import webhook
from acquisition.commands import (
    SHOWN_CHARACTERS,
    CommandError,
    CommandTimeoutError,
    ended_badly,
    run_command,
)
from acquisition.taken import SessionEvent
from stage.errors import InputError

if TYPE_CHECKING:
    from acquisition.session import SessionStatus

TOLD: Final = ("operator", "suspended", "skipped", "faulty", "emergency-stop", "ended")
"""Events that need somebody, or may. What the session repairs by itself, by another try or frame, is none."""
OFTEN: Final = ("skipped", "faulty")
QUIET_S: Final = 60.0
"""Those that can come with every shot are told so seldom at the most."""
PROGRESS: Final = {"phase", "outcome", "run", "shots", "taken", "elapsed_s", "remaining_s"}
"""Of a `SessionStatus`, what a hook is told."""
ROOM: Final = 32
"""Alerts that may wait; where there are more, the oldest is dropped."""
TRIES: Final = 5
PAUSE_S, LONGEST_PAUSE_S = 1.0, 30.0
"""Before an alert is tried again; each pause is three times the one before."""
CLOSING_PAUSE_S = 1.0
ANSWER_S = 5.0
"""Longest wait for a server's next word."""
HOOK_S = 10.0
"""After so long a hook is killed."""
CLOSE_S = 20.0
"""Longest wait for the last alerts at the end of a session: one that hangs, and one after it."""
MESSAGE_CHARACTERS, ADDRESS_CHARACTERS = 1000, 2000


class Alert(Protocol):
    """Told of every event of a session; what it does with it is its own affair."""

    def __call__(self, event: SessionEvent) -> None:
        """Take note of an event. Never raises, and never keeps the session waiting."""
        ...


@dataclass(frozen=True)
class Trouble:
    """Why an alert did not get through.

    Attributes
    ----------
    what : str
        The end of a sentence about the hook.
    final : bool
        Whether trying again is of no use.
    """

    what: str
    final: bool = False


@dataclass
class _Waiting:
    event: SessionEvent
    status: SessionStatus | None
    tries: int = 0


class HookAlert(ABC):
    """Calls a hook with those events of a session that need somebody.

    They are `TOLD`, but for an ``ended`` that completed. The hook gets a JSON object: ``event`` (its kind),
    ``message``, ``time`` (UTC), ``shot`` (index or null), ``session`` (the folder), ``progress`` (of `SessionStatus`,
    or null) and ``text``, one line that says it all.

    Parameters
    ----------
    name : str
        How trouble with the hook calls it: nothing secret.
    folder : Path
        Of the session.
    note : callable
        Told in one sentence what did not get through, for the person; called from the alert's thread.
    pause_s : float
        Before the second try.
    """

    def __init__(
        self,
        name: str,
        folder: Path,
        *,
        note: Callable[[str], None] = lambda sentence: None,
        pause_s: float = PAUSE_S,
    ) -> None:
        self.name = name
        self._folder = folder.absolute()
        self._status: Callable[[], SessionStatus | None] = lambda: None
        self._note, self._pause_s = note, pause_s
        self._waiting: deque[_Waiting] = deque()
        self._dropped = 0
        self._told: dict[str, float] = {}
        self._changed = threading.Condition()
        self._close_by: float | None = None
        self._thread = threading.Thread(target=self._run, name=f"alerts to {name}")
        self._thread.start()

    def __call__(self, event: SessionEvent) -> None:
        """See `Alert`."""
        if event.kind not in TOLD:
            return
        status, now = self._status(), time.monotonic()
        if event.kind == "ended" and status is not None and status.outcome == "completed":
            return
        if event.kind in OFTEN and now - self._told.get(event.kind, -math.inf) < QUIET_S:
            return
        self._told[event.kind] = now
        self._put(_Waiting(event, status))

    def send(self, event: SessionEvent) -> None:
        """Tell of an event, whatever it is."""
        self._put(_Waiting(event, self._status()))

    def follow(self, status: Callable[[], SessionStatus]) -> None:
        """Tell from now on how far the session is, too; asked when an event comes, from the thread that it comes in."""
        self._status = status

    def close(self, wait_s: float = CLOSE_S) -> None:
        """Send what is still waiting, the latest first, and end; callable any number of times, and never raises."""
        with self._changed:
            if self._close_by is None:
                self._close_by = time.monotonic() + wait_s
            self._changed.notify_all()
        self._thread.join(wait_s + CLOSING_PAUSE_S)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @abstractmethod
    def _send(self, message: dict[str, Any]) -> Trouble | None:
        """Call the hook once, within `HOOK_S`; returns what went wrong."""

    def _put(self, one: _Waiting) -> None:
        with self._changed:
            if len(self._waiting) >= ROOM:
                self._waiting.popleft()
                self._dropped += 1
            self._waiting.append(one)
            self._changed.notify_all()

    def _given_up(self) -> bool:
        """Whether there is no time left."""
        return self._close_by is not None and time.monotonic() > self._close_by

    def _run(self) -> None:
        while (one := self._next()) is not None:
            self._tell(one)
        left = self._dropped + len(self._waiting)
        if left:
            self._say(f"alert: {left} messages to {self.name} were never sent")

    def _next(self) -> _Waiting | None:
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._close_by is not None)
            if not self._waiting or self._given_up():
                return None
            # where little time is left, how the session ended matters most
            return self._waiting.popleft() if self._close_by is None else self._waiting.pop()

    def _tell(self, one: _Waiting) -> None:
        trouble = self._send(self._message(one.event, one.status))
        if trouble is None:
            return
        one.tries += 1
        if trouble.final or one.tries == TRIES or self._given_up():
            told = f"{one.event.kind}: {one.event.message}"[:SHOWN_CHARACTERS]
            often = "" if one.tries == 1 else f", in {one.tries} tries"
            self._say(f"alert: {self.name} {trouble.what}{often}; it was not told: {told}")
            return
        with self._changed:
            self._waiting.appendleft(one)
            closing = self._close_by is not None
            pause_s = min(self._pause_s * 3 ** (one.tries - 1), CLOSING_PAUSE_S if closing else LONGEST_PAUSE_S)
            self._changed.wait_for(lambda: self._close_by is not None and not closing, pause_s)

    def _say(self, sentence: str) -> None:
        with suppress(OSError, ValueError):  # the terminal may be gone; the next alert is to go out all the same
            self._note(sentence)

    def _message(self, event: SessionEvent, status: SessionStatus | None) -> dict[str, Any]:
        message = event.message[:MESSAGE_CHARACTERS]
        so_far = "" if status is None else f" ({status.taken} of {status.shots} shots taken)"
        return {
            "event": event.kind,
            "message": message,
            "time": event.time,
            "shot": event.shot,
            "session": str(self._folder),
            "progress": None if status is None else status.model_dump(mode="json", include=PROGRESS),
            "text": f"lightstage: {self._folder.name}: {event.kind}: {message[:SHOWN_CHARACTERS]}{so_far}",
        }


class WebhookAlert(HookAlert):
    """Posts each alert to a web address; redirects are not followed. See `HookAlert`.

    Parameters
    ----------
    url : str
        An http or https address; a user and a password in it are sent as basic authentication, and nothing but the
        host is ever shown.
    folder, **options
        As in `HookAlert`.

    Raises
    ------
    InputError
        For what is no such address.
    """

    def __init__(self, url: str, folder: Path, **options: Any) -> None:
        host = _host(url)
        self._url = url
        super().__init__(host, folder, **options)

    def _send(self, message: dict[str, Any]) -> Trouble | None:
        # no site packages: what is needed is in the standard library, and starts four times as fast
        command = [sys.executable, "-I", "-S", str(Path(webhook.__file__).absolute())]
        given = _json({"url": self._url, "message": message, "timeout_s": ANSWER_S})
        try:
            finished = run_command(command, timeout_s=HOOK_S, given=given, give_up=self._given_up)
        except CommandTimeoutError:
            return Trouble("does not answer in time")
        except CommandError as error:
            return Trouble(f"could not be called, the command {sys.executable} {error}")
        if finished.code == 0:
            return None
        return Trouble(finished.line or ended_badly(finished), final=finished.code == webhook.FINAL)


class CommandAlert(HookAlert):
    """Runs a command for each alert, with the JSON object on its stdin. See `HookAlert`.

    Parameters
    ----------
    command : sequence of str
        The command and its arguments, without a shell.
    folder, **options
        As in `HookAlert`.
    """

    def __init__(self, command: Sequence[str], folder: Path, **options: Any) -> None:
        self._command = tuple(command)
        super().__init__(f"the command {self._command[0]}", folder, **options)

    def _send(self, message: dict[str, Any]) -> Trouble | None:
        try:
            finished = run_command(self._command, timeout_s=HOOK_S, given=_json(message), give_up=self._given_up)
        except CommandError as error:
            return Trouble(str(error), final=not isinstance(error, CommandTimeoutError))
        if finished.code == 0:
            return None
        return Trouble(ended_badly(finished) + (f" ({finished.line})" if finished.line else ""))


def alert_for(hook: str, folder: Path, note: Callable[[str], None] = lambda sentence: None) -> HookAlert:
    """The alert that a person has asked for: an http or https address, or else a command line.

    Parameters
    ----------
    hook : str
        As it was typed.
    folder, note
        As in `HookAlert`.

    Raises
    ------
    InputError
        For an address that is none, or a command that is not there.
    """
    if "://" in hook.partition(" ")[0]:
        return WebhookAlert(hook, folder, note=note)
    try:
        command = shlex.split(hook)
    except ValueError as error:
        raise InputError(f"--alert: is no command line ({error})") from None
    if not command or shutil.which(command[0]) is None:
        raise InputError(f"--alert: expected an http or https address, or a command that is there, got {hook!r}")
    return CommandAlert(command, folder, note=note)


def _host(url: str) -> str:
    """Scheme, host and port of a web address: what may be shown of it."""
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError:
        raise InputError("--alert: is no web address; expected one such as https://example.org/hook") from None
    plain = url.isascii() and url.isprintable() and " " not in url and len(url) <= ADDRESS_CHARACTERS
    if parts.scheme not in ("http", "https") or not parts.hostname or not plain:
        raise InputError("--alert: is no http or https address; expected one such as https://example.org/hook")
    host = f"[{parts.hostname}]" if ":" in parts.hostname else parts.hostname
    return f"{parts.scheme}://{host}" + (f":{port}" if port else "")


def _json(value: Any) -> bytes:
    return json.dumps(value, ensure_ascii=False).encode(errors="replace")
