"""Capture sessions: what is missing from a record is taken, whatever happens in between."""

from acquisition.session.choosing import Choice, Chooser, require_choosable
from acquisition.session.loop import ATTEMPTS
from acquisition.session.session import PATIENCE_S, Session
from acquisition.session.states import TRANSITIONS, Outcome, Phase, SessionStatus

__all__ = [
    "ATTEMPTS",
    "PATIENCE_S",
    "TRANSITIONS",
    "Choice",
    "Chooser",
    "Outcome",
    "Phase",
    "Session",
    "SessionStatus",
    "require_choosable",
]
