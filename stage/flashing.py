"""No light that flashes at a rate which can trigger seizures, unless the rig allows it by name.

A flash is a rise of the light by a tenth of full level or more, of any one emitter or of all together, above the lowest
that it has been since it last flashed. So light that moves from one emitter of a dome to another flashes, because the
second rises; and a fade, however fine its steps, counts once for every tenth. No more than three flashes may fall into
any second. That keeps what is faster than 30 Hz away as well: whatever flashes so fast passes through slower rates when
it starts and stops, and at every frame that a line drops.

References
----------
W3C, "Web Content Accessibility Guidelines 2.2", general flash threshold: three flashes in any second, of a tenth of the
maximum luminance or more. There, bright flicker and small areas pass; here neither does, since nobody knows how much of
whose view the stage fills.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Sequence

from stage.clock import Clock
from stage.cutoff import Cutoff
from stage.devices import Lamp, OpenedByWith
from stage.errors import DeviceError
from stage.validation import shortened

RISE = 0.1
"""Least rise that counts, of levels from 0 to 1."""
ROUNDING = 1e-9
FLASHES, WINDOW_S = 3, 1.0
MARGIN_S = 1e-3
"""What `FlashGuard.pause_s` asks for on top, so that rounding in somebody's clock does not bring a refusal."""


class FlashGuard(OpenedByWith):
    """A lamp that refuses to flash more than three times in any second: a `stage.devices.Lamp` around another.

    Going dark is never refused. A flash shows at some time between a call and its return, so a second is counted from
    the return of one call to the next call. After a failure the lamp is taken to be dark: the next light is a flash.
    Once `make_safe` has returned, no call that began before lights the lamp, in whatever thread.

    Parameters
    ----------
    lamp : Lamp
        The driver.
    clock : Clock
        In which the second is counted.
    allowed : bool
        Whether the rig says ``light.flashing: allowed``; nothing is refused then.
    """

    def __init__(self, lamp: Lamp, clock: Clock, *, allowed: bool = False) -> None:
        self._lamp, self._clock, self._allowed = lamp, clock, allowed
        self._lowest = [0.0] * (lamp.emitters + 1)  # of each emitter and of their sum, since its last flash
        self._flashed_s: deque[float] = deque(maxlen=FLASHES)
        self._books = threading.Lock()
        self._cutoff = Cutoff(clock, lambda: f"{self.name}: it was made safe meanwhile; nothing was lit")

    @property
    def name(self) -> str:
        """Of the lamp."""
        return self._lamp.name

    @property
    def emitters(self) -> int:
        """Of the lamp."""
        return self._lamp.emitters

    def open(self) -> None:
        """See `stage.devices.Device.open`; a lamp is dark once it is open."""
        self._lamp.open()

    def close(self) -> None:
        """See `stage.devices.Device.close`."""
        self._take_for_dark()
        self._lamp.close()

    def make_safe(self) -> None:
        """Go dark, whenever, also in the middle of another thread's call, which then fails."""
        with self._cutoff.stop() as interrupts:
            self._take_for_dark()
            self._lamp.make_safe()
            if interrupts:
                # that call may have been on its way to the lamp, and have reached it since
                with self._cutoff.exchange(meanwhile=self._lamp.make_safe):
                    self._lamp.make_safe()
                    self._take_for_dark()

    def dark(self) -> None:
        """Go dark, whenever."""
        self._take_for_dark()
        self._lamp.dark()

    def pause_s(self) -> float:
        """Seconds to wait before a further flash is permitted; zero where it is permitted now."""
        with self._books:
            if self._allowed or len(self._flashed_s) < FLASHES:
                return 0.0
            left = self._flashed_s[0] + WINDOW_S - self._clock.now()
            return left + MARGIN_S if left >= 0 else 0.0

    def set_level(self, level: float) -> tuple[float, ...]:
        """See `set_levels`."""
        return self.set_levels((level,) * self.emitters)

    def set_levels(self, levels: Sequence[float]) -> tuple[float, ...]:
        """See `stage.devices.Lamp.set_levels`.

        Raises
        ------
        DeviceError
            Where the change would be the fourth flash within a second, and nothing was changed; see `pause_s`.
        """
        with self._cutoff.call(), self._cutoff.exchange():
            really = self._set_levels(levels)
            self._cutoff.check()
        return really

    def _set_levels(self, levels: Sequence[float]) -> tuple[float, ...]:
        shown, lowest = [*levels, sum(levels)], self._lowest
        rises = [now - low > RISE - ROUNDING for now, low in zip(shown, lowest, strict=False)]
        pause_s = self.pause_s() if any(rises) else 0.0
        if pause_s:
            raise DeviceError(
                f"{self.name}: levels of {shortened(list(levels))} would be flash number {FLASHES + 1} within a "
                f"second, and flashing can trigger seizures; wait {pause_s:.3f} s, or write 'light.flashing: allowed' "
                "into the rig if nobody at the stage is in danger"
            )
        try:
            really = self._lamp.set_levels(levels)
        except BaseException:
            self._take_for_dark()  # who knows what it shows
            raise
        finally:
            if any(rises):
                with self._books:
                    self._flashed_s.append(self._clock.now())
        with self._books:
            if self._lowest is lowest:  # or else another thread has gone dark meanwhile
                self._lowest = [
                    now if risen else min(now, low) for now, risen, low in zip(shown, rises, lowest, strict=True)
                ]
        return really

    def _take_for_dark(self) -> None:
        with self._books:
            self._lowest = [0.0] * len(self._lowest)
