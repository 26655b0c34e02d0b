"""What a capture has while nobody stands beside it: alerts that go out, and commands that come in."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime
from pathlib import Path

from acquisition.alerts import HookAlert, alert_for
from acquisition.record import FOLDER
from acquisition.session import Outcome, Session
from acquisition.taken import SessionEvent
from api.last_word import last_word
from api.session_control import controlled


class Attendance:
    """Stands between a session and those who are elsewhere. See `attendance`."""

    def __init__(self, out: Path, alerts: Sequence[HookAlert], note: Callable[[str], None]) -> None:
        self._out, self._alerts, self._note = out, alerts, note
        self._session: Session | None = None

    def heard(self, event: SessionEvent) -> None:
        """Pass an event on: a session's ``on_event``."""
        for alert in self._alerts:
            alert(event)

    @contextmanager
    def attended(self, session: Session) -> Iterator[None]:
        """Let a session be controlled from elsewhere while it runs: its ``attended``."""
        self._session = session
        for alert in self._alerts:
            alert.follow(session.status)
        with controlled(session, self._out / FOLDER, self._note):
            yield

    def failed(self, error: Exception) -> None:
        """Tell of what went wrong after the session's end, as while the dataset is written."""
        if self._session is None or self._session.outcome is not Outcome.COMPLETED:
            return  # nothing has begun, or the session has told
        message = f"all shots are taken, but the dataset is not written: {error}"
        for alert in self._alerts:
            alert.send(SessionEvent(time=datetime.now(UTC).isoformat(), kind="ended", message=message))


@contextmanager
def attendance(out: Path, hooks: Sequence[str], note: Callable[[str], None]) -> Iterator[Attendance]:
    """Alerts and control for a capture; on the way out the last alerts are waited for, but not for long.

    Parameters
    ----------
    out : Path
        Folder of the dataset.
    hooks : sequence of str
        Whom to tell: see `acquisition.alerts.alert_for`.
    note : callable
        Told in one sentence what does not work, for the person; called from any thread.

    Raises
    ------
    InputError
        For a hook that is none.
    """
    with ExitStack() as stack:
        if hooks:
            stack.enter_context(last_word(out, hooks))
        found = Attendance(out, [stack.enter_context(alert_for(hook, out, note)) for hook in hooks], note)
        try:
            yield found
        except Exception as error:
            found.failed(error)
            raise
