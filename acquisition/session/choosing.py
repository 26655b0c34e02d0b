"""Lights that are chosen as a session goes: who chooses, and the thread in which that is thought about.

A plan lists candidates; the session takes those that the chooser names, and asks again when all of them are filed. The
lamp is dark meanwhile and nothing moves. A decision is on the disk before the first of its shots is taken.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol

from acquisition.decisions import Decision
from acquisition.plan import CapturePlan
from acquisition.record import CaptureRecord, cannot_be_written
from acquisition.session.course import EndedError
from acquisition.session.lanes import Lane
from stage.clock import Clock
from stage.errors import InputError

KEPT = "the frames taken so far are kept, go on with --resume"


@dataclass(frozen=True)
class Choice:
    """What a chooser wants.

    Attributes
    ----------
    candidates : tuple of int
        Lights of the plan that come next, in any order; none where enough is known.
    reason : str
        One sentence for the person.
    figures : mapping of str to float
        What it was decided by, such as ``predicted_error``; finite.
    """

    candidates: tuple[int, ...]
    reason: str
    figures: Mapping[str, float] = field(default_factory=dict)


class Chooser(Protocol):
    """Chooses lights by what was photographed so far."""

    def __call__(self, record: CaptureRecord, require_wanted: Callable[[], None]) -> Choice:
        """Which lights come next.

        Parameters
        ----------
        record : CaptureRecord
            ``record.decisions.chosen`` are the lights that were photographed, in the order in which they were chosen;
            ``record.taken`` are their frames. Nothing is taken while the chooser thinks.
        require_wanted : callable
            To be called now and then: raises where nobody waits for the choice any more.

        Raises
        ------
        InputError
            Where it cannot choose: the session ends, and can be resumed.
        """
        ...


def require_choosable(plan: CapturePlan) -> None:
    """Refuse a plan whose lights cannot be chosen one after the other.

    Dark frames, flat frames, brackets, repeats and references are taken as ever. Raises `InputError` for a second
    surface, a background and multiplexing.
    """
    for field_name, there in (
        ("multiplexing", plan.multiplexing != "off"),
        ("second_radius_m", plan.second_radius_m is not None),
        ("background", plan.background),
    ):
        if there:
            raise InputError(
                f"plan: {field_name}: takes lights that are known beforehand, and with --until they are chosen one "
                "after the other; remove the field, or capture without --until"
            )


class Choosing:
    """Asks a chooser in a thread of its own, so that the session can listen to people meanwhile.

    Parameters
    ----------
    chooser : Chooser
        Who is asked.
    record : CaptureRecord
        One with decisions.
    clock : Clock
        To which thinking is work.
    time : callable
        Time of day.
    write : callable
        Does what is given to it as often as a disk that refuses needs.
    require_wanted : callable
        Raises `EndedError` where nobody waits for a decision any more.
    most : int or None
        Lights that are taken at the most.
    """

    def __init__(
        self,
        chooser: Chooser,
        record: CaptureRecord,
        clock: Clock,
        *,
        time: Callable[[], str],
        write: Callable[[Callable[[], None]], None],
        require_wanted: Callable[[], None],
        most: int | None,
    ) -> None:
        assert record.decisions is not None
        self._chooser, self._record, self._decisions = chooser, record, record.decisions
        self._time, self._write, self._require_wanted, self._most = time, write, require_wanted, most
        self._lane = Lane("choose lights", clock)
        self._answer: Decision | BaseException | None = None
        self.is_thinking = False
        """Whether a question is open."""

    @property
    def is_over(self) -> bool:
        """Whether it was decided that no more lights are wanted."""
        return self._decisions.are_over

    def begin(self) -> None:
        """Ask for the next lights, unless that was done already."""
        if not self.is_thinking:
            self.is_thinking, self._answer = True, None
            self._lane.submit(self._think)

    def answer(self, is_disturbed: Callable[[], bool]) -> Decision | None:
        """Wait for the decision, which is on the disk then; None where somebody disturbs or ends the session before.

        Raises what the chooser has raised, and `InputError` where the disk cannot be written.
        """
        self._lane.wait_until(lambda load: not load or is_disturbed())
        if self._lane.load:
            return None
        self.is_thinking = False
        if isinstance(self._answer, EndedError):
            return None
        if isinstance(self._answer, BaseException):
            raise self._answer
        return self._answer

    def look_again(self) -> None:
        """Have who waits look whether it is disturbed."""
        self._lane.look_again()

    def close(self) -> None:
        """Let a thought end, and the thread; callable any number of times."""
        self._lane.close()

    def _think(self) -> None:
        try:
            decision = self._decided(self._chooser(self._record, self._require_wanted))
            self._require_wanted()
            self._write(lambda: self._decisions.add(decision))
            self._answer = decision
        except InputError as error:
            self._answer = InputError(f"{self._record.out}: the next lights could not be chosen ({error}); {KEPT}")
        except OSError as error:
            self._answer = InputError(cannot_be_written(self._record.out, error))
        except BaseException as error:
            self._answer = error

    def _decided(self, choice: Choice) -> Decision:
        candidates, reason = choice.candidates, choice.reason
        if wrong := self._decisions.wrong_in(candidates, set(self._record.plan.chosen)):
            raise InputError(wrong)
        before = len(self._decisions.chosen)
        if self._most is not None and before + len(candidates) > self._most:
            candidates = candidates[: max(self._most - before, 0)]
            reason = f"{reason}, and {self._most} lights are as many as are allowed"
        return Decision(
            time=self._time(),
            run=self._record.run,
            after=before,
            candidates=candidates,
            reason=reason,
            figures=dict(choice.figures),
        )
