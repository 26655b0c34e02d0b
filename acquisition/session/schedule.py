"""Which shot is next: parts in turn, each in the order of travel, references in between, failures later."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

from acquisition.check import Place, Places
from acquisition.plan import Shot

SETUPS = ("flat", "object", "background")
"""What stands on the stage, in this order; the parts that are not named are of the object."""
FOR_OPERATOR = {
    "flat": "put the evenly coloured target in the object's place",
    "object": "put the object back in its place",
    "background": "take the object away, and leave all else as it is",
}


@dataclass(frozen=True)
class Due:
    """A shot that is to be taken.

    Attributes
    ----------
    shot : Shot
        What.
    attempt : int
        Which try it is, counted from 1; each new frame begins anew.
    rounds : int
        How often it has failed for now.
    retakes : int
        How often it was asked for again because of what was found in its frames.
    """

    shot: Shot
    attempt: int = 1
    rounds: int = 0
    retakes: int = 0


def place_of(shot: Shot) -> Place:
    """Where the light has to be for a shot."""
    return shot.part, shot.candidates


def setup_of(shot: Shot) -> str:
    """What stands on the stage for a shot."""
    return shot.part if shot.part in SETUPS else "object"


@dataclass
class Schedule:
    """Shots that are due, in order.

    Parameters
    ----------
    missing : iterable of Shot
        Those that are to be taken.
    places : mapping
        Joint values by place in the order of travel (see `acquisition.check`); places that are not named come last, as
        listed.
    reference_every : int or None
        Lit shots between two reference frames.
    is_open : bool
        Whether more shots of the object may come, by `add`. The references among `missing` are a supply then, of which
        as many are taken as it takes: none is due at the end of what is known so far, and one after `close`.
    """

    missing: Iterable[Shot]
    places: Places = field(default_factory=dict)
    reference_every: int | None = None
    is_open: bool = False

    def __post_init__(self) -> None:
        self._has_supply = self.is_open
        rank = {place: i for i, place in enumerate(self.places)}
        self._first: deque[Due] = deque()
        self._later: deque[Due] = deque()
        """Those that failed, for the end of what stands on the stage."""
        self._given_up: list[Due] = []
        self._setups = deque(SETUPS)
        """Those that are not done with, in turn."""
        self._shots: dict[str, deque[Shot]] = {}
        self._references: dict[str, deque[Shot]] = {}
        self._since_reference: int | None = None
        shots = sorted(self.missing, key=lambda shot: (SETUPS.index(setup_of(shot)), shot.index))
        for setup in SETUPS:
            own = [shot for shot in shots if setup_of(shot) == setup]
            self._references[setup] = deque(shot for shot in own if shot.kind == "reference")
            lit = [shot for shot in own if shot.kind not in ("reference", "dark")]
            lit.sort(key=lambda shot: rank.get(place_of(shot), len(rank)))
            self._shots[setup] = deque([*(shot for shot in own if shot.kind == "dark"), *lit])

    @property
    def retakes(self) -> tuple[int, ...]:
        """Shots that are to be taken again next."""
        return tuple(due.shot.index for due in tuple(self._first) if due.retakes)

    @property
    def skipped(self) -> tuple[int, ...]:
        """Shots that failed so far."""
        return tuple(due.shot.index for due in (*tuple(self._later), *self._given_up))

    def next(self) -> Due | None:
        """The shot that is due; None where there is none (which a failure or a retake may change)."""
        if self._first:
            return self._first.popleft()
        while self._setups:
            shots, references = self._shots[self._setups[0]], self._references[self._setups[0]]
            if references and self._wants_reference(shots):
                self._since_reference = 0
                return Due(references.popleft())
            if shots:
                if shots[0].kind == "light":
                    self._since_reference = (self._since_reference or 0) + 1
                return Due(shots.popleft())
            if self._later:
                return self._later.popleft()
            if self.is_open and self._setups[0] == "object":
                return None
            self._setups.popleft()
            self._since_reference = None
        # a failure may be learned of after all else was taken
        return self._later.popleft() if self._later else None

    def again(self, due: Due) -> None:
        """Have a shot taken again, next."""
        self._first.append(due)

    def add(self, shots: Iterable[Shot]) -> None:
        """Have more shots of the object taken, in this order, while it `is_open`."""
        self._shots["object"].extend(shots)

    def close(self) -> None:
        """Say that no more shots will come."""
        self.is_open = False

    def put_off(self, due: Due) -> None:
        """Leave a shot that has failed to the end of what stands on the stage; what fails then as well is given up."""
        if due.rounds:
            self._given_up.append(due)
        else:
            self._later.append(replace(due, attempt=1, rounds=1))

    @property
    def has_more(self) -> bool:
        """Whether anything is due."""
        references = self._wants_last() and any(self._references.values())
        return bool(self._first or self._later or any(self._shots.values()) or references)

    @property
    def given_up(self) -> Sequence[Due]:
        """Shots that failed for good."""
        return self._given_up

    def _wants_reference(self, shots: deque[Shot]) -> bool:
        """Before the first lit shot, after every so many, and after the last."""
        if not shots:
            return self._wants_last()
        if shots[0].kind == "dark" or self.reference_every is None:
            return False
        return self._since_reference is None or self._since_reference >= self.reference_every

    def _wants_last(self) -> bool:
        """Whether references that are left are due after the last lit shot: one of a supply, all of those of a plan."""
        return not self.is_open and (not self._has_supply or bool(self._since_reference))
