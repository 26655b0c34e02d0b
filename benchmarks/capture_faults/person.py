"""Somebody at the console, who pauses, stops, skips and asks again at any moment, from another thread."""

from __future__ import annotations

import threading
import time
from contextlib import suppress
from functools import partial

from acquisition.session import Session
from benchmarks.capture_faults.mishaps import KINDS, Mishaps
from simulators.clock import VirtualClock
from stage.errors import InputError

LONGEST_S = 40.0
"""How long after the beginning something may still be asked, virtual seconds."""
SOON_S = 0.002
"""Real seconds between two looks at a session."""
GIVE_UP_S = 20.0
MOST = 3


class Person:
    """Asks a session for this and that.

    Parameters
    ----------
    shots : int
        Of the plan.
    """

    def __init__(self, shots: int, clock: VirtualClock, mishaps: Mishaps) -> None:
        self._session: Session | None = None
        self._shots = shots
        self._draw = mishaps.at("operator")
        self._threads: list[threading.Thread] = []
        for _ in range(int(mishaps.share > 0) * self._draw.whole(0, MOST)):
            wish = str(self._draw.rng.choice(KINDS["operator"]))
            clock.at(self._draw.between(0, LONGEST_S), partial(self._begin, wish))

    def attend(self, session: Session) -> None:
        """Ask this session from now on."""
        self._session = session

    def finish(self) -> list[str]:
        """Wait until nothing that was asked for is under way; what did not come to its end, as sentences."""
        for thread in self._threads:
            thread.join(GIVE_UP_S)
        return [f"{thread.name} did not come to an end" for thread in self._threads if thread.is_alive()]

    def _begin(self, wish: str) -> None:
        if self._session is None or self._session.outcome is not None:
            return
        self._draw.strike(wish)
        thread = threading.Thread(target=self._ask, args=(self._session, wish), name=f"operator: {wish}")
        self._threads.append(thread)
        thread.start()

    def _ask(self, session: Session, wish: str) -> None:
        match wish:
            case "pause":
                session.pause("lunch")
                _wait_for(session, "paused", "ended")
                session.resume()
            case "stop":
                session.stop("lunch")
            case "abort":
                session.abort("wrong object")
            case "emergency stop":
                session.emergency_stop("a hand in the way")
            case "skip":
                session.skip("go on with the next")
            case "retake":
                with suppress(InputError):  # there may be no frame of that shot yet
                    session.retake(self._draw.whole(0, self._shots - 1), "somebody walked by")


def _wait_for(session: Session, *phases: str) -> None:
    end = time.monotonic() + GIVE_UP_S
    while session.status().phase not in phases and time.monotonic() < end:
        time.sleep(SOON_S)
