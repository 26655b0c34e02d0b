"""What can go wrong with a simulated GRBL controller, by name."""

from __future__ import annotations

from typing import Protocol

from simulators.faults import FaultBoard


class Controller(Protocol):
    """What a controller can suffer by itself."""

    def power_up(self) -> None:
        """Start anew after a brown-out."""
        ...

    def raise_alarm(self, number: int) -> None:
        """Lock, for a numbered reason."""
        ...

    def jam(self) -> None:
        """Cease to step."""
        ...

    def trip(self, axis: str) -> None:
        """Close a limit switch."""
        ...


class GrblFaults:
    """The faults of one controller: those of its wire lie in wait here, the others it suffers at once.

    Offered on the board: ``swallowed-ok``, ``error``, ``silent``, ``garbled`` (of the next lines, messages or answers),
    ``alarm``, ``brown-out``, ``stall`` and ``hard-limit``. Messages are lines and real-time bytes alike.
    """

    def __init__(self, controller: Controller, board: FaultBoard) -> None:
        self._board = board
        self._swallow = self._deaf = self._garble = 0
        self._errors: list[int] = []
        board.offer("swallowed-ok", self._swallow_ok)
        board.offer("error", self._answer_error)
        board.offer("silent", self._fall_silent)
        board.offer("garbled", self._garble_answers)
        board.offer("alarm", lambda number: controller.raise_alarm(number))
        board.offer("brown-out", controller.power_up)
        board.offer("stall", controller.jam)
        board.offer("hard-limit", lambda axis="X": controller.trip(axis))

    def hears(self) -> bool:
        """Count a message; whether it is heard."""
        self._board.message()
        if self._deaf:
            self._deaf -= 1
            return False
        return True

    def swallows_ok(self) -> bool:
        """Whether the next ``ok`` never reaches the wire."""
        if self._swallow:
            self._swallow -= 1
            return True
        return False

    def error_due(self) -> int | None:
        """Number of the error that the next line gets instead of being carried out."""
        return self._errors.pop(0) if self._errors else None

    def damaged(self, said: bytes) -> bytes:
        """What reaches the wire of an answer: one bit of its middle may be flipped."""
        if not said or not self._garble:
            return said
        self._garble -= 1
        middle = len(said.rstrip()) // 2
        return said[:middle] + bytes([said[middle] ^ 0x10]) + said[middle + 1 :]

    def _swallow_ok(self, times: int = 1) -> None:
        self._swallow += times

    def _answer_error(self, number: int, times: int = 1) -> None:
        self._errors += [number] * times

    def _fall_silent(self, messages: int = 4) -> None:
        self._deaf += messages

    def _garble_answers(self, times: int = 1) -> None:
        self._garble += times
