"""The last word: a small process that tells somebody where the one that captured has died without telling anybody.

A process that is killed, or for which there is no memory left, sends no alert. So for as long as alerts are asked for,
a second one waits for the end of a pipe, as the guardian does; it is of use on a simulated stage, too.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path

RELEASED = b"released\n"
WAIT_S = 10.0
"""Longest wait for the end of a process that was released."""
GONE = "the process that captured is gone without a word; go on with --resume"


@contextmanager
def last_word(out: Path, hooks: Sequence[str]) -> Iterator[None]:
    """Have hooks told where this process dies inside the context.

    Parameters
    ----------
    out : Path
        Folder of the dataset.
    hooks : sequence of str
        See `acquisition.alerts.alert_for`; they are not seen in the list of processes.
    """
    process = subprocess.Popen(
        [sys.executable, "-m", "api.last_word"],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        start_new_session=True,  # the terminal's Ctrl-C and hang-up are not for it
    )
    assert process.stdin is not None
    try:
        with suppress(BrokenPipeError):
            process.stdin.write(json.dumps({"out": str(out.absolute()), "hooks": list(hooks)}).encode() + b"\n")
            process.stdin.flush()
        yield
    finally:
        with suppress(BrokenPipeError):
            process.stdin.write(RELEASED)
        with suppress(BrokenPipeError):
            process.stdin.close()
        try:
            process.wait(WAIT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def main() -> int:
    """Wait for the end of stdin; see the module."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    given = sys.stdin.buffer.readline()
    if not given or sys.stdin.buffer.read() == RELEASED:
        return 0
    # only now: while all is well, it shall take no memory
    from acquisition.alerts import alert_for
    from acquisition.taken import SessionEvent
    from stage.errors import InputError

    asked = json.loads(given)
    event = SessionEvent(time=datetime.now(UTC).isoformat(), kind="ended", message=GONE)
    with ExitStack() as stack:
        for hook in asked["hooks"]:
            with suppress(InputError):  # it died before it could refuse the hook
                stack.enter_context(alert_for(hook, Path(asked["out"]), _note)).send(event)
    return 0


def _note(sentence: str) -> None:
    os.write(sys.stderr.fileno(), f"lightstage: {sentence}\n".encode())


if __name__ == "__main__":
    sys.exit(main())
