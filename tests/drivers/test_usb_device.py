from __future__ import annotations

import errno
from typing import Any

import pytest
import usb.core

from drivers.usb_device import UsbError, UsbInterface, Wanted, find_device
from simulators.clock import VirtualClock
from simulators.udmx import UdmxFunction
from simulators.usb_backend import VirtualUsb
from stage.errors import DeviceError
from tests.bench import PlainWorld

WANTED = Wanted("gadget", "light", interface=(0xFF,))


class FickleUsb(VirtualUsb):
    """A bus on which chosen calls fail with a chosen error, so many times."""

    def __init__(self, call: str, number: int, times: int = 1) -> None:
        super().__init__(VirtualClock())
        self.call, self.number, self.times = call, number, times

    def _fail(self, call: str) -> None:
        if call == self.call and self.times:
            self.times -= 1
            raise usb.core.USBError("it failed", -1, self.number)

    def enumerate_devices(self) -> Any:
        self._fail("enumerate")
        return super().enumerate_devices()

    def get_configuration_descriptor(self, dev: Any, config: int) -> Any:
        self._fail("describe")
        return super().get_configuration_descriptor(dev, config)

    def get_configuration(self, dev_handle: Any) -> int:
        self._fail("configuration")
        return super().get_configuration(dev_handle)

    def set_configuration(self, dev_handle: Any, config_value: int) -> None:
        self.configured = config_value
        super().set_configuration(dev_handle, config_value)

    def open_device(self, dev: Any) -> Any:
        self._fail("open")
        return super().open_device(dev)

    configured = 0


def gadget(serial_number: str = "A1") -> UdmxFunction:
    clock = VirtualClock()
    return UdmxFunction(PlainWorld(clock), clock, serial_number=serial_number)


def test_a_bus_that_cannot_be_searched_is_an_error_of_one_sentence() -> None:
    bus = FickleUsb("enumerate", errno.EIO)
    with pytest.raises(UsbError, match=r"gadget over USB: looking for it failed: .*it failed; check the cable"):
        find_device(WANTED, bus)


def test_a_device_that_vanishes_while_it_is_looked_at_is_passed_over() -> None:
    bus = FickleUsb("describe", errno.ENODEV)
    bus.plug_in(gadget())
    with pytest.raises(DeviceError, match="none found"):
        find_device(WANTED, bus)


def test_a_device_that_has_no_configuration_yet_is_given_one() -> None:
    bus = FickleUsb("configuration", errno.EIO)
    bus.plug_in(gadget())
    interface = UsbInterface(find_device(WANTED, bus), "gadget")
    interface.open()
    assert bus.configured == 1
    assert interface.number == 0
    interface.close()
    interface.close()


def test_of_several_those_that_do_not_tell_their_number_are_listed_all_the_same() -> None:
    bus = FickleUsb("open", errno.EACCES, times=1)
    bus.plug_in(gadget())
    bus.plug_in(gadget("B2"))
    with pytest.raises(DeviceError, match=r"2 found \(16c0:05dc serial unknown, 16c0:05dc serial B2\)"):
        find_device(WANTED, bus)


@pytest.mark.parametrize(
    ("number", "may_pass"),
    [(errno.EPIPE, True), (errno.ETIMEDOUT, True), (errno.EIO, True), (errno.ENODEV, False), (errno.EACCES, False)],
)
def test_errors_say_whether_it_is_worth_trying_again(number: int, may_pass: bool) -> None:
    bus = FickleUsb("open", number)
    bus.plug_in(gadget())
    interface = UsbInterface(find_device(WANTED, bus), "gadget")
    bus.times = 2
    with pytest.raises(UsbError) as failure:
        interface.open()
    assert (failure.value.number, failure.value.may_pass) == (number, may_pass)
