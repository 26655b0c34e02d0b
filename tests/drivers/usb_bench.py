"""A virtual USB, its clock and its world for lamps on USB, and what they all must do when plugs are pulled."""

from __future__ import annotations

import errno
from collections.abc import Callable
from typing import Any

import pytest
import usb.core

from simulators.clock import VirtualClock
from simulators.usb_backend import UsbFunction, VirtualUsb
from stage.devices import Device, Lamp
from stage.errors import DeviceError
from tests.bench import PlainWorld


class LockedUsb(VirtualUsb):
    """A bus whose devices this user may see and not open."""

    def open_device(self, dev: UsbFunction) -> Any:
        raise usb.core.USBError("Access denied (insufficient permissions)", -3, errno.EACCES)


class UsbBench:
    """Where lamps on USB are tried."""

    def __init__(self) -> None:
        self.clock = VirtualClock()
        self.world = PlainWorld(self.clock)
        self.usb = VirtualUsb(self.clock)


def check_that_it_conforms(usb: VirtualUsb, plug: UsbFunction, make: Callable[[], Any]) -> None:
    """What every lamp must do, whatever hangs on the bus: see tests/drivers/test_conformance.py."""
    lamp = make()
    assert isinstance(lamp, Lamp)
    assert isinstance(lamp, Device)
    lamp.make_safe()
    lamp.close()
    for call in (lambda: lamp.set_level(1.0), lamp.dark):
        with pytest.raises(DeviceError, match="not open"):
            call()
    for _ in range(2):
        lamp.open()
        lamp.open()
        lamp.make_safe()
        lamp.set_level(1.0)
        lamp.make_safe()
        lamp.make_safe()
        lamp.close()
        lamp.close()
        lamp.make_safe()

    with lamp, pytest.raises(DeviceError, match="another program"):
        make().open()

    lamp.open()
    lamp.set_level(1.0)
    usb.unplug(plug)
    for call in (lambda: lamp.set_level(1.0), lamp.make_safe, lamp.dark):
        with pytest.raises(DeviceError) as failure:
            call()
        story, next_step = str(failure.value).rsplit(";", 1)
        assert lamp.name in story
        assert "check" in next_step
        assert "\n" not in story
    usb.plug_in(plug)
    lamp.set_level(1.0)
    lamp.make_safe()
    usb.unplug(plug)
    lamp.close()
    lamp.make_safe()
    with pytest.raises(DeviceError, match="none found"):
        lamp.open()
    usb.plug_in(plug)
