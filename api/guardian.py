"""The guardian: a small process that makes the stage safe where the one that drove it has died.

A DMX interface goes on sending its last levels when its host is gone, and a controller finishes its last move. So for
as long as real devices are open, a second process waits for the end of a pipe. Where that comes without a word, as
after ``kill -9``, a crash or a lack of memory, it opens light and motion itself, light first, and makes them safe.
"""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from stage.clock import Clock, SystemClock
from stage.errors import DeviceError, InputError
from stage.rig import Rig, rig_from_mapping

READY, RELEASED = b"ready\n", b"released\n"
START_S = 30.0
"""Longest wait for the guardian: it has to load its drivers."""
TRIES, PAUSE_S = 20, 0.5
"""How often a device is tried: a dead process may hold its port for a moment, and a device may be restarting."""


@contextmanager
def guarded(rig: Rig) -> Iterator[None]:
    """Have a guardian watch over the devices of a rig; on return it is released, whatever happened inside.

    Raises
    ------
    DeviceError
        Where the guardian does not start: nothing should move or shine without it.
    """
    guardian = subprocess.Popen(
        [sys.executable, "-m", "api.guardian"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        start_new_session=True,  # the terminal's Ctrl-C and hang-up are not for it
    )
    assert guardian.stdin is not None
    assert guardian.stdout is not None
    try:
        with suppress(BrokenPipeError):
            guardian.stdin.write(json.dumps(rig.to_json()).encode() + b"\n")
            guardian.stdin.flush()
        readable, _, _ = select.select([guardian.stdout], [], [], START_S)
        if not readable or guardian.stdout.readline() != READY:
            raise DeviceError(
                "guardian: the process that would darken the stage after a crash did not start; "
                "check the memory that is free, then try again"
            )
        yield
    finally:
        for say in (lambda: guardian.stdin.write(RELEASED), guardian.stdin.close):
            with suppress(BrokenPipeError):
                say()
        guardian.stdout.close()
        guardian.wait()


def make_rig_safe(rig: Rig, clock: Clock | None = None) -> list[str]:
    """Open light, then motion of a rig, each on its own, and make it safe; return what went wrong, in sentences.

    Parameters
    ----------
    rig : Rig
        With real addresses.
    clock : Clock, optional
        Pauses between tries.
    """
    from api.devices import Workshop

    clock = clock or SystemClock()
    workshop = Workshop(rig.at_rest(), clock)  # nobody is there to see a machine home itself
    trouble = []
    for build in (workshop.lamp, workshop.motion):
        for left in reversed(range(TRIES)):
            try:
                with build():
                    break  # leaving makes it safe
            except (DeviceError, InputError) as error:
                if not left:
                    trouble.append(str(error))
                clock.sleep(PAUSE_S)
    return trouble


def main() -> int:
    """Wait for the end of stdin; see the module."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    rig = rig_from_mapping(json.loads(sys.stdin.buffer.readline()), "guardian")
    import api.devices  # noqa: F401  # while there is time: after a crash every second is a second of light

    with suppress(BrokenPipeError):
        os.write(sys.stdout.fileno(), READY)
    if sys.stdin.buffer.read() == RELEASED:
        return 0
    trouble = make_rig_safe(rig)
    with suppress(OSError):  # the terminal may be gone as well
        for sentence in trouble or ["the process that drove the stage is gone; light and motion were made safe"]:
            sys.stderr.write(f"lightstage guardian: {sentence}\n")
    return 1 if trouble else 0


if __name__ == "__main__":
    sys.exit(main())
