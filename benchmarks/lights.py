"""Round trips of the light drivers over their simulated wires, and how long each then waits for the light.

A real interface adds its own time: about 1 ms for the DMX USB Pro, up to 35 ms for all 512 channels of a uDMX.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from drivers.enttec import EnttecLamp
from drivers.scpi_supply import ScpiSupplyLamp
from drivers.udmx import UdmxLamp
from simulators.clock import VirtualClock
from simulators.dmx import DmxWidget
from simulators.faults import FaultBoard
from simulators.ports import PtyPort
from simulators.scpi_supply import Led, ScpiSupply
from simulators.udmx import UdmxFunction
from simulators.usb_backend import UsbFunction, VirtualUsb
from simulators.usbtmc import TmcFunction
from stage.devices import Lamp
from stage.rig import EnttecLight, SupplyLight, UdmxLight

CHANGES = 200


class DarkRoom:
    """A world that nobody looks at."""

    def __init__(self, clock: VirtualClock) -> None:
        self.now = clock.now

    def set_channels(self, levels: bytes) -> None:
        """Take no notice."""

    def set_light(self, key: str, level: float) -> None:
        """Take no notice."""


def run() -> dict[str, Any]:
    """Change the level of the first and the last emitter in turn, as often as `CHANGES`.

    Returns
    -------
    dict
        By lamp ``median_ms`` and ``p95_ms`` of one change on the wire, ``messages`` that it takes, and ``wait_ms``
        until the light shows it (DMX frames) or its current is measured (the supply's meter).
    """
    return {
        "Enttec DMX USB Pro, 1 channel": _enttec(1),
        "Enttec DMX USB Pro, 512 channels": _enttec(512),
        "uDMX, 1 channel": _udmx(1),
        "uDMX, 512 channels": _udmx(512),
        "SCPI supply, 1 output": _supply(1),
        "SCPI supply, 3 outputs": _supply(3),
    }


def _enttec(emitters: int) -> dict[str, float]:
    clock = VirtualClock()
    widget = DmxWidget(DarkRoom(clock), clock)
    with PtyPort(widget.feed, "dmx") as port:
        light = {"driver": "enttec-dmx-usb-pro", "port": port.path, "emitters": _channels(emitters)}
        return _timed(EnttecLamp(EnttecLight.model_validate(light), clock=clock), clock, widget.board)


def _udmx(emitters: int) -> dict[str, float]:
    clock = VirtualClock()
    dongle = UdmxFunction(DarkRoom(clock), clock)
    light = UdmxLight.model_validate({"driver": "udmx", "emitters": _channels(emitters)})
    with _plugged_in(dongle, clock) as bus:
        return _timed(UdmxLamp(light, clock=clock, backend=bus), clock, dongle.board)


def _supply(outputs: int) -> dict[str, float]:
    clock = VirtualClock()
    numbers = range(1, outputs + 1)
    supply = ScpiSupply(DarkRoom(clock), {number: Led.within(0.35, 12.0) for number in numbers})
    emitters = [{"output": number, "full_current_a": 0.35, "voltage_limit_v": 12.0} for number in numbers]
    light = SupplyLight.model_validate({"driver": "scpi-usbtmc", "emitters": emitters})
    with _plugged_in(TmcFunction(supply), clock) as bus:
        return _timed(ScpiSupplyLamp(light, clock=clock, backend=bus), clock, supply.board)


def _channels(count: int) -> list[dict[str, int]]:
    return [{"channel": channel} for channel in range(1, count + 1)]


@contextmanager
def _plugged_in(function: UsbFunction, clock: VirtualClock) -> Iterator[VirtualUsb]:
    bus = VirtualUsb(clock)
    bus.plug_in(function)
    yield bus


def _timed(lamp: Lamp, clock: VirtualClock, board: FaultBoard) -> dict[str, float]:
    took_s = []
    with lamp:
        messages, start_s = board.messages, clock.now()
        for change in range(CHANGES):
            levels = [0.0] * lamp.emitters
            levels[-(change % 2)] = 1.0 if change % 2 else 0.5
            begin = time.perf_counter()
            lamp.set_levels(levels)
            took_s.append(time.perf_counter() - begin)
        return {
            "median_ms": 1e3 * float(np.median(took_s)),
            "p95_ms": 1e3 * float(np.percentile(took_s, 95)),
            "messages": (board.messages - messages) / CHANGES,
            "wait_ms": 1e3 * (clock.now() - start_s) / CHANGES,
        }
