"""Which lights a capture has chosen as it went: one line per decision, on the disk before the first of its shots.

::

    OUT/capture/decisions.jsonl  one line per decision; its being there says that lights are chosen as the capture goes
"""

from __future__ import annotations

from collections.abc import Collection
from itertools import chain
from pathlib import Path

from pydantic import Field, ValidationError

from acquisition.disk import Disk
from acquisition.plan import PlanPart
from stage.errors import InputError

FILE = "decisions.jsonl"


class Decision(PlanPart):
    """What was decided after some lights were photographed.

    Attributes
    ----------
    time : str
        Time of day, UTC.
    run : int
        Run of the session.
    after : int
        Number of lights that had been photographed.
    candidates : tuple of int
        Lights of the plan that come next; none where the capture is to end.
    reason : str
        One sentence for the person.
    figures : dict of str to float
        What it was decided by, such as ``predicted_error``, in the chooser's units.
    """

    time: str
    run: int
    after: int
    candidates: tuple[int, ...]
    reason: str
    figures: dict[str, float] = Field(default_factory=dict)


class Decisions:
    """The decisions of one capture, in turn.

    Parameters
    ----------
    path : Path
        ``decisions.jsonl``.
    disk : Disk
        What it is written through.
    """

    def __init__(self, path: Path, disk: Disk) -> None:
        self._path, self._disk = path, disk
        self._made: list[Decision] = []
        self._bytes = 0

    @property
    def made(self) -> tuple[Decision, ...]:
        """All that are on the disk."""
        return tuple(self._made)

    @property
    def chosen(self) -> tuple[int, ...]:
        """Lights that were chosen, in the order in which they were."""
        return tuple(chain.from_iterable(decision.candidates for decision in self._made))

    @property
    def are_over(self) -> bool:
        """Whether it was decided that no more lights are wanted."""
        return bool(self._made) and not self._made[-1].candidates

    def read(self, allowed: Collection[int]) -> None:
        """Take over what earlier runs have decided; a torn last line is no decision.

        Raises `InputError` where a line is damaged, or chooses a light that is not one of the `allowed` or was chosen
        before.
        """
        for number, line in enumerate(self._path.read_bytes().splitlines(True), 1):
            if not line.endswith(b"\n"):
                break
            try:
                decision = Decision.model_validate_json(line)
            except ValidationError as error:
                fault = error.errors(include_url=False)[0]["msg"]
                raise InputError(f"{self._path}: line {number}: is damaged ({fault})") from None
            if wrong := self.wrong_in(decision.candidates, allowed):
                raise InputError(f"{self._path}: line {number}: candidates: {wrong}")
            self._made.append(decision)
            self._bytes += len(line)

    def wrong_in(self, candidates: Collection[int], allowed: Collection[int]) -> str:
        """What is wrong with a choice of some of the `allowed` lights; empty where nothing is."""
        before = set(self.chosen)
        for candidate in candidates:
            if candidate not in allowed:
                return f"light {candidate} is none that the plan would take"
            if candidate in before:
                return f"light {candidate} was chosen before"
            before.add(candidate)
        return ""

    def begin(self) -> None:
        """Make the file where there is none, or cut off what a crash has torn; raises `OSError`."""
        self._disk.append_synced(self._path, b"", self._bytes)

    def add(self, decision: Decision) -> None:
        """Put a decision on the disk; raises `OSError`, and nothing was decided."""
        line = (decision.model_dump_json() + "\n").encode()
        self._disk.append_synced(self._path, line, self._bytes)
        self._bytes += len(line)
        self._made.append(decision)
