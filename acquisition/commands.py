"""Commands that a person has named, run so that none of them can hold up or harm a session."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

GLANCE_S = 0.02
KILL_WAIT_S = 1.0
KEPT_BYTES = 1 << 12
"""Of what a command prints; the rest is thrown away."""
GIVEN_BYTES = 1 << 14
"""What a pipe holds at least, so that a command which does not read keeps nobody waiting."""
SHOWN_CHARACTERS = 200


class CommandError(Exception):
    """A command could not be run or did not end: the end of a sentence about it."""


class CommandTimeoutError(CommandError):
    """A command took too long and was killed."""


@dataclass(frozen=True)
class Finished:
    """How a command ended.

    Attributes
    ----------
    code : int
        Exit status; minus the number of the signal that killed it.
    line : str
        First line that it printed, empty where it printed nothing.
    """

    code: int
    line: str


def run_command(
    command: Sequence[str],
    *,
    timeout_s: float,
    folder: Path | None = None,
    given: bytes = b"",
    give_up: Callable[[], bool] = lambda: False,
) -> Finished:
    """Run a command without a shell, out of the terminal's reach, and kill it where it takes too long.

    Parameters
    ----------
    command : sequence of str
        The command and its arguments.
    timeout_s : float
        In real time, as the command's own is.
    folder : Path, optional
        Where it runs.
    given : bytes
        What it reads on stdin, at most `GIVEN_BYTES`.
    give_up : callable
        Asked now and then; the command is killed once it says so.

    Raises
    ------
    CommandError
        Where it cannot be run or was killed.
    """
    if len(given) > GIVEN_BYTES:
        raise ValueError(f"given: expected at most {GIVEN_BYTES} bytes, got {len(given)}")
    try:
        process = subprocess.Popen(
            command,
            cwd=folder,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,  # the terminal's Ctrl-C is not for it, and its children can be killed with it
        )
    except (OSError, ValueError) as error:
        raise CommandError(f"cannot be run ({getattr(error, 'strerror', None) or error})") from None
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        with suppress(BrokenPipeError), process.stdin:
            process.stdin.write(given)
        said = _listen(process, process.stdout.fileno(), time.monotonic() + timeout_s, give_up)
    except TimeoutError:
        raise CommandTimeoutError(f"did not end within {timeout_s:g} s") from None
    finally:
        if process.poll() is None:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            with suppress(subprocess.TimeoutExpired):  # even SIGKILL waits for a driver inside the kernel
                process.wait(KILL_WAIT_S)
        process.stdout.close()
    return Finished(process.returncode, _first_line(said))


def ended_badly(finished: Finished) -> str:
    """How a command ended that did not succeed, as the end of a sentence about it."""
    if finished.code < 0:
        return f"was killed by signal {-finished.code}"
    return f"ended with exit status {finished.code}"


def _listen(process: subprocess.Popen[bytes], output: int, deadline: float, give_up: Callable[[], bool]) -> bytes:
    """The first bytes that the command prints until it ends; what it has started may hold the pipe for longer."""
    said, silent = b"", False
    poller = select.poll()
    poller.register(output, select.POLLIN)
    while True:
        ended = process.poll() is not None
        if silent:
            with suppress(subprocess.TimeoutExpired):
                process.wait(GLANCE_S)
        elif poller.poll(0 if ended else 1000 * GLANCE_S):
            piece = os.read(output, 1 << 16)
            said, silent = (said + piece)[:KEPT_BYTES], not piece
            ended = ended and len(said) == KEPT_BYTES
        if ended:
            return said
        if time.monotonic() > deadline or give_up():
            raise TimeoutError


def _first_line(said: bytes) -> str:
    text = said.decode(errors="replace").strip()
    line = "".join(c if c.isprintable() else " " for c in text.splitlines()[0]) if text else ""
    return " ".join(line.split())[:SHOWN_CHARACTERS]
