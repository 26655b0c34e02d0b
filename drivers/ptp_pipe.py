"""What a PTP camera's wire has to do, whether it is USB or a network: carry transactions, and events on the side."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

from drivers.ptp_protocol import OK, Operation, describe
from stage.errors import DeviceError

ANSWER_TIMEOUT_S = 5.0
TRANSFER_TIMEOUT_S = 120.0
"""A file that trickles in may take so long in all; 50 MB take 4 to 7 s over USB."""


class PtpRefusedError(DeviceError):
    """The camera answered an operation with anything but OK."""

    def __init__(self, message: str, response: int) -> None:
        super().__init__(message)
        self.response = response


class TruncatedTransferError(DeviceError):
    """The camera sent less than it announced; the transaction is over and another can begin."""


@dataclass(frozen=True)
class Reply:
    """A camera's answer to one operation.

    Attributes
    ----------
    code, transaction : int
        Of the response.
    parameters : tuple of int
        Of the response.
    data : bytes
        What came before the response; empty where the operation has none.
    complete : bool
        Whether that was as much as was announced.
    """

    code: int
    transaction: int
    parameters: tuple[int, ...]
    data: bytes = b""
    complete: bool = True


class PtpPipe(ABC):
    """One camera's wire.

    Any `DeviceError` but the two above means that the wire failed: camera and host may disagree on what comes next,
    and only a new pipe helps.

    Parameters
    ----------
    name : str
        What errors call the camera.
    answer_timeout_s : float
        Longest silence in the middle of a transaction; a file may take twice as long to begin.
    """

    def __init__(self, name: str, answer_timeout_s: float = ANSWER_TIMEOUT_S) -> None:
        self.name = name
        self._answer_timeout_s = answer_timeout_s
        self._transaction = 0

    @abstractmethod
    def open(self) -> None:
        """Connect, for this program alone."""

    @abstractmethod
    def close(self) -> None:
        """Let go of the camera; never raises."""

    def reset(self) -> None:
        """Abandon whatever transaction the camera may still be in; nothing where connecting does that."""
        return None

    @abstractmethod
    def event(self, timeout_s: float) -> tuple[int, tuple[int, ...]] | None:
        """Code and parameters of the next event, or None where none comes in time."""

    @abstractmethod
    def _carry(self, operation: Operation, number: int, values: tuple[int, ...], data: bytes | None) -> Reply:
        """Carry out one transaction of a given number."""

    def transact(self, operation: Operation, *values: int, data: bytes | None = None) -> tuple[tuple[int, ...], bytes]:
        """Carry out one operation.

        Parameters
        ----------
        operation : Operation
            What to do.
        *values : int
            Its parameters.
        data : bytes, optional
            What to send with it.

        Returns
        -------
        parameters : tuple of int
            Of the response.
        data : bytes
            What the camera sent; empty where the operation has none.

        Raises
        ------
        PtpRefusedError
            Where the camera answers anything but OK; it names the operation and the response.
        TruncatedTransferError
            Where less arrived than was announced.
        DeviceError
            Where the transfer itself fails.
        """
        # a session is opened by number 0, and counts up from there
        number = self._transaction = 0 if operation is Operation.OPEN_SESSION else self._transaction + 1
        reply = self._carry(operation, number, values, data)
        if reply.transaction != number:
            raise DeviceError(
                f"{self.name}: {operation.name} of transaction {number} was answered for transaction "
                f"{reply.transaction}; try again"
            )
        if reply.code != OK:
            shown = [hex(value) for value in values]
            raise PtpRefusedError(
                f"{self.name}: {operation.name} {shown} was refused: {describe(reply.code)}", reply.code
            )
        if not reply.complete:
            raise TruncatedTransferError(
                f"{self.name}: {operation.name} ended after {len(reply.data)} bytes; try again"
            )
        return reply.parameters, reply.data

    def _silence_s(self, operation: Operation) -> float:
        return self._answer_timeout_s * (2 if operation is Operation.GET_OBJECT else 1)
