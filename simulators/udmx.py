"""A uDMX dongle seen from USB: vendor requests in, levels onto a DMX line.

References
----------
anyma, uDMX: common/uDMX_cmds.h (requests), firmware/main.c (what it checks: a request out of range is acknowledged and
changes nothing, since the error byte goes to a host that does not read).
"""

from __future__ import annotations

from simulators.dmx_line import CHANNELS, Clock, DmxLine, OnLoss, World
from simulators.faults import FaultBoard
from simulators.usb_backend import UsbGoneError, UsbSilentError, UsbStallError

SET_SINGLE_CHANNEL, SET_CHANNEL_RANGE = 1, 2


class UdmxFunction:
    """The dongle and the line behind it.

    Parameters
    ----------
    world : World
        What the fixtures on the line light.
    clock : Clock
        Its time.
    serial_number : str
        As the dongle tells it.
    on_loss : str
        What the fixtures do when nothing comes any more.

    Attributes
    ----------
    board : FaultBoard
        Offers ``stall`` and ``silent``, which strike requests before they do anything, ``brown-out`` (a restart), and
        the faults of the line. Each request counts as a message.
    """

    vendor_id: int = 0x16C0
    product_id: int = 0x05DC
    interface_class: tuple[int, int, int] = (0xFF, 0, 0)
    endpoints: tuple[tuple[int, int, int], ...] = ()

    def __init__(
        self, world: World, clock: Clock, *, serial_number: str = "ilLUTZminator001", on_loss: OnLoss = "black"
    ) -> None:
        self.strings = ("www.anyma.ch", "uDMX", serial_number)
        self.line = DmxLine(world, clock, on_loss=on_loss)
        self.board = FaultBoard()
        self.board.offer("stall", self._stall)
        self.board.offer("silent", self._fall_silent)
        self.board.offer("brown-out", self.restart)
        self.line.offer_faults(self.board)
        self._levels = bytearray(CHANNELS)
        self._stalls = self._silences = 0
        self._restarted = False

    def lose_power(self) -> None:
        """Restart with levels of zero; nothing goes out until some are set."""
        self._levels = bytearray(CHANNELS)
        self.line.fall_silent()

    def restart(self) -> None:
        """Lose power for a moment, and come back on the bus as a new device."""
        self.lose_power()
        self._restarted = True

    def host_sends(self, endpoint: int, data: bytes) -> None:
        """There is no pipe but the one for requests."""
        raise UsbStallError

    def host_reads(self, endpoint: int, size: int) -> bytes | None:
        """There is no pipe but the one for requests."""
        raise UsbStallError

    def ready_s(self, endpoint: int) -> float | None:
        """Never."""
        return None

    def control(self, request_type: int, request: int, value: int, index: int, data: bytes) -> bytes:
        """Vendor requests; the firmware does not look at their type."""
        self.board.message()
        if self._restarted:
            self._restarted = False
            raise UsbGoneError
        if self._stalls:
            self._stalls -= 1
            raise UsbStallError
        if self._silences:
            self._silences -= 1
            raise UsbSilentError
        if request == SET_SINGLE_CHANNEL and value <= 0xFF and index < CHANNELS:
            self._levels[index] = value
            self.line.carry(self._levels)
        if request == SET_CHANNEL_RANGE and value <= len(data) and index < CHANNELS and index + value <= CHANNELS:
            self._levels[index : index + value] = data[:value]
            self.line.carry(self._levels)
        return b""

    def _stall(self, times: int = 1) -> None:
        self._stalls += times

    def _fall_silent(self, times: int = 1) -> None:
        self._silences += times
