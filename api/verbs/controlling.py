"""Verb ``session``: look at a running capture, and steer it from another terminal."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from api.session_control import COMMANDS, ask
from stage.errors import DeviceError, InputError


def session(out: Path, command: str, *, shot: int | None = None, reason: str | None = None) -> dict[str, Any]:
    """Give a command to the capture that is running in a folder.

    Parameters
    ----------
    out : Path
        The dataset folder that ``capture`` was given.
    command : str
        ``status``, ``pause`` and ``stop`` (after the shot that is being taken), ``resume``, ``abort``,
        ``emergency-stop`` (everything dark and still at once), ``skip`` or ``retake``.
    shot : int, optional
        Index of the shot to take again, as ``shots.jsonl`` counts; for ``retake`` only.
    reason : str, optional
        For the record.

    Returns
    -------
    dict
        Where the session is once the command is given: see `acquisition.session.states.SessionStatus`.

    Raises
    ------
    InputError
        Where no session is running there, or the command makes no sense now.
    DeviceError
        Where it does not answer, or something could not be made safe.
    """
    if command not in COMMANDS:
        raise InputError(f"session: expected one of {', '.join(COMMANDS)}, got {command!r}")
    if (shot is not None) != (command == "retake"):
        raise InputError("session: retake needs the number of a shot, and nothing else takes one")
    answer = ask(out, command, reason=reason, shot=shot)
    if answer["unsafe"]:
        raise DeviceError(f"{out}: could not be made safe: {'; '.join(answer['unsafe'])}")
    status: dict[str, Any] = answer["status"]
    return status
