"""What operators ask of a session, from whatever thread: requests wait here for the session's next step."""

from __future__ import annotations

import threading
from collections import deque

from acquisition.session.lanes import HEED_S


class Gate:
    """Requests, each with its reason. All methods may be called from any thread.

    Attributes
    ----------
    reason : str
        Of the last request that changed what the session should do.
    """

    def __init__(self) -> None:
        self.reason = ""
        self._changed = threading.Condition()
        self._pause = False
        self._end = False
        self._abort = False
        self._skip: str | None = None
        self._retakes: deque[tuple[int, str]] = deque()

    @property
    def wants_pause(self) -> bool:
        """Whether to pause after the shot."""
        return self._pause

    @property
    def wants_end(self) -> bool:
        """Whether to end after the shot, or at once."""
        return self._end

    @property
    def wants_abort(self) -> bool:
        """Whether to end at once."""
        return self._abort

    def pause(self, reason: str) -> None:
        """Ask for a pause."""
        with self._changed:
            self._pause, self.reason = True, reason

    def resume(self) -> None:
        """Ask to go on."""
        with self._changed:
            self._pause, self.reason = False, ""
            self._changed.notify_all()

    def end(self, reason: str, *, abort: bool) -> None:
        """Ask for the end; the first reason stays, unless an abort overtakes a stop."""
        with self._changed:
            if not self._end or (abort and not self._abort):
                self.reason = reason
            self._abort = self._abort or abort  # first, so that no end is seen without it
            self._end = True
            self._changed.notify_all()

    def skip(self, reason: str) -> None:
        """Ask to leave a shot that is failing for later."""
        with self._changed:
            self._skip = reason

    def take_skip(self) -> str | None:
        """Why to skip, where that was asked for since the last call."""
        with self._changed:
            reason, self._skip = self._skip, None
            return reason

    def retake(self, shot: int, reason: str) -> None:
        """Ask for another frame of a shot."""
        with self._changed:
            self._retakes.append((shot, reason))
            self._changed.notify_all()

    def take_retakes(self) -> list[tuple[int, str]]:
        """Retakes asked for since the last call."""
        with self._changed:
            asked = list(self._retakes)
            self._retakes.clear()
            return asked

    def wait_for_resume(self) -> None:
        """Wait until nobody wants a pause, or somebody wants the end."""
        with self._changed:
            while not self._changed.wait_for(lambda: not self._pause or self._end, HEED_S):
                pass
