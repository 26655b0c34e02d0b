"""Round trips of the drivers over simulated wires: what the software adds to the time that a real wire takes.

A simulated wire has no transmission time and no adapter that holds bytes back, so these are lower bounds. A row of
`DEVICES` opens a device and yields its operations, and the meter that counts the bytes of its wire.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from drivers import dynamixel_table as table
from drivers.dynamixel_bus import ServoBus
from drivers.link import SerialLink
from simulators import servo_bus
from simulators.clock import RunningClock
from simulators.ports import PtyPort
from simulators.servo import Servo

TIMES = 300
BAUD = 57600
BITS_PER_BYTE = 10
Operations = dict[str, Callable[[], object]]


def run() -> dict[str, Any]:
    """Time every operation of every device.

    Returns
    -------
    dict
        By device and operation: ``median_ms`` and ``p95_ms`` of the round trip, milliseconds, and ``wire_ms``, the
        transmission time of its bytes at ``baud`` bits per second on a real wire.
    """
    found: dict[str, Any] = {"times": TIMES, "baud": BAUD, "round_trips": {}}
    for device, opened in DEVICES.items():
        with opened() as (operations, carried):
            found["round_trips"][device] = {name: _timed(call, carried) for name, call in operations.items()}
    return found


class Nobody:
    """A world that only passes the time."""

    def __init__(self, now: Callable[[], float]) -> None:
        self.now = now

    def attach(self, actuator: str, position: Callable[[float], float]) -> None:
        """Nobody looks at what is attached."""


class Meter:
    """Counts the bytes that go over a wire, both ways."""

    def __init__(self, feed: Callable[[bytes], bytes]) -> None:
        self._feed, self.count = feed, 0

    def feed(self, data: bytes) -> bytes:
        """Pass on, and count."""
        answer = self._feed(data)
        self.count += len(data) + len(answer)
        return answer


@contextmanager
def echo() -> Iterator[tuple[Operations, Meter]]:
    """The bare pseudo-terminal: one byte there and back."""
    meter = Meter(lambda data: data)
    with PtyPort(meter.feed) as port:
        link = SerialLink("echo", port.path, BAUD)
        link.open()

        def there_and_back() -> None:
            link.write(b"x")
            link.read(1)

        yield {"one byte": there_and_back}, meter
        link.close()


@contextmanager
def servos() -> Iterator[tuple[Operations, Meter]]:
    """Six Dynamixel servos on one bus."""
    clock = RunningClock()
    ids = tuple(range(1, 7))
    meter = Meter(servo_bus.ServoBus(Servo(Nobody(clock.now), ident) for ident in ids).feed)
    with PtyPort(meter.feed) as port:
        bus = ServoBus(SerialLink("servo bus", port.path, BAUD))
        bus.open()

        def write_and_read_back() -> None:
            bus.write_all(table.ORDER, dict.fromkeys(ids, (11, 44, 2048)))
            bus.read_all(ids, table.PROGRESS)

        yield (
            {
                "ping": lambda: bus.ping(1),
                "read position": lambda: bus.read(1, table.PRESENT_POSITION),
                "write profile": lambda: bus.write(1, table.PROFILE_VELOCITY, 44),
                "sync read, 2 servos": lambda: bus.read_all(ids[:2], table.PROGRESS),
                "sync read, 6 servos": lambda: bus.read_all(ids, table.PROGRESS),
                "sync write and read back, 6 servos": write_and_read_back,
            },
            meter,
        )
        bus.close()
    clock.close()


DEVICES = {"pseudo-terminal": echo, "Dynamixel": servos}


def _timed(call: Callable[[], object], meter: Meter) -> dict[str, float]:
    call()
    before, took_ms = meter.count, []
    for _ in range(TIMES):
        start = time.perf_counter()
        call()
        took_ms.append(1000 * (time.perf_counter() - start))
    return {
        "median_ms": float(np.median(took_ms)),
        "p95_ms": float(np.percentile(took_ms, 95)),
        "wire_ms": 1000 * BITS_PER_BYTE * (meter.count - before) / TIMES / BAUD,
    }


if __name__ == "__main__":
    print(json.dumps(run(), indent=1))
