from __future__ import annotations

from typing import Any

import pytest
import usb.core

from drivers.udmx import UdmxLamp
from simulators.udmx import UdmxFunction
from simulators.usb_backend import UsbFunction, VirtualUsb
from stage.errors import DeviceError
from stage.rig import UdmxLight
from tests.drivers.usb_bench import LockedUsb, UsbBench, check_that_it_conforms


class Bench(UsbBench):
    def __init__(self) -> None:
        super().__init__()
        self.dongle = UdmxFunction(self.world, self.clock)
        self.usb.plug_in(self.dongle)

    def lamp(self, *channels: int, backend: Any = None, **settings: Any) -> UdmxLamp:
        emitters = [{"channel": channel} for channel in channels or (1,)]
        light = UdmxLight.model_validate({"driver": "udmx", "emitters": emitters, **settings})
        return UdmxLamp(light, clock=self.clock, backend=backend or self.usb)


@pytest.fixture
def bench() -> Bench:
    return Bench()


class Eavesdropper(VirtualUsb):
    """Notes the control requests of the vendor's kind."""

    def ctrl_transfer(self, dev_handle: Any, *setup: Any) -> int:
        kind, request, value, index, data, _ = setup
        if kind & 0x60 == 0x40:
            self.heard.append((kind, request, value, index, bytes(data)))
        return super().ctrl_transfer(dev_handle, *setup)

    heard: list[tuple[int, int, int, int, bytes]]


def test_requests_are_those_of_the_header_file(bench: Bench) -> None:
    bus = Eavesdropper(bench.clock)
    bus.heard = []
    bus.plug_in(bench.dongle)
    with bench.lamp(5, 7, backend=bus) as lamp:
        assert bus.heard.pop() == (0x40, 2, 512, 0, bytes(512))
        lamp.set_levels((1.0, 0.2))
        assert bus.heard.pop() == (0x40, 2, 3, 4, bytes([255, 0, 51]))  # what changed, and what lies between
        lamp.set_levels((1.0, 0.4))
        assert bus.heard.pop() == (0x40, 2, 1, 6, bytes([102]))
        lamp.set_levels((1.0, 0.4))
        assert bus.heard.pop() == (0x40, 2, 1, 0, bytes([0]))  # nothing did: is it still there
    assert bus.heard.pop() == (0x40, 2, 3, 4, bytes(3))


def test_it_does_what_lamps_do(bench: Bench) -> None:
    check_that_it_conforms(bench.usb, bench.dongle, bench.lamp)


def test_levels_reach_the_lamp_in_256_steps_once_the_line_carries_them(bench: Bench) -> None:
    with bench.lamp(512, 1, warm_up_s=0.5) as lamp:
        start = bench.clock.now()
        assert lamp.set_levels((1.0, 0.5)) == (1.0, 128 / 255)
        assert bench.clock.now() - start == pytest.approx(2 * 0.045 + 0.5)
        assert (bench.world.levels[511], bench.world.levels[0]) == (255, 128)
        with pytest.raises(DeviceError, match="expected 2 levels"):
            lamp.set_levels((1.0,))
        with pytest.raises(DeviceError, match="from 0 to 1"):
            lamp.set_level(2.0)
        lamp.dark()
        assert bench.world.levels == bytes(512)


@pytest.mark.parametrize("fault", ["stall", "silent"])
def test_a_transfer_that_fails_now_and_then_is_repeated_with_all_channels(bench: Bench, fault: str) -> None:
    with bench.lamp(3) as lamp:
        lamp.set_level(0.2)
        bench.dongle.board.strike(fault, times=2)
        before = bench.dongle.board.messages
        assert lamp.set_level(1.0) == (1.0,)
        assert bench.dongle.board.messages - before == 3
        assert bench.world.levels[2] == 255


@pytest.mark.parametrize(
    ("fault", "said"), [("stall", r"Pipe error.*; it refused"), ("silent", r"timed out; it stopped")]
)
def test_a_dongle_that_fails_for_longer_is_an_error_that_says_what_was_sent(
    bench: Bench, fault: str, said: str
) -> None:
    lamp = bench.lamp(3)
    lamp.open()
    bench.dongle.board.strike(fault, times=3)
    start = bench.clock.now()
    with pytest.raises(DeviceError, match=rf"uDMX dongle over USB: SetChannelRange of channels 1 to 512 .*{said}"):
        lamp.set_level(1.0)
    assert bench.clock.now() - start < 2.0
    assert lamp.set_level(0.4) == (0.4,)  # found again
    assert bench.world.levels[2] == 102
    lamp.close()


def test_a_dongle_that_restarts_is_noticed_and_sent_all_levels(bench: Bench) -> None:
    with bench.lamp(1, 9) as lamp:
        lamp.set_level(1.0)
        bench.dongle.board.strike("brown-out")
        bench.clock.sleep(2.0)
        assert bench.world.levels == bytes(512)
        with pytest.raises(DeviceError, match="check cable and power"):
            lamp.set_levels((1.0, 0.2))
        lamp.set_levels((1.0, 0.2))
        assert (bench.world.levels[0], bench.world.levels[8]) == (255, 51)


def test_a_dead_fixture_is_not_noticed(bench: Bench) -> None:
    with bench.lamp() as lamp:
        bench.dongle.board.strike("dead-channel", channel=1)
        assert lamp.set_level(1.0) == (1.0,)
        assert bench.world.levels[0] == 0


def test_of_several_dongles_the_serial_number_tells_which(bench: Bench) -> None:
    other = UdmxFunction(bench.world, bench.clock, serial_number="B2")
    bench.usb.plug_in(other)
    with pytest.raises(
        DeviceError,
        match=r"2 found \(16c0:05dc serial ilLUTZminator001, 16c0:05dc serial B2\); say which one by light.serial",
    ):
        bench.lamp().open()
    with bench.lamp(serial="B2") as lamp:
        assert lamp.name == "uDMX dongle B2 over USB"
        lamp.set_level(1.0)
        assert other.board.messages
        assert not bench.dongle.board.messages


class HobbyDevice(UdmxFunction):
    """Something else under the shared ids."""

    def __init__(self, bench: UsbBench) -> None:
        super().__init__(bench.world, bench.clock)
        self.strings = ("somebody", "kettle", "1")


def test_other_devices_under_the_shared_ids_are_left_alone(bench: Bench) -> None:
    kettle = HobbyDevice(bench)
    bench.usb.plug_in(kettle)
    with bench.lamp() as lamp:
        lamp.set_level(1.0)
    bench.usb.unplug(bench.dongle)
    with pytest.raises(DeviceError, match="uDMX dongle over USB: none found; check cable and power"):
        bench.lamp().open()
    assert not kettle.board.messages


def test_a_dongle_that_may_not_be_opened_says_so(bench: Bench) -> None:
    locked = LockedUsb(bench.clock)
    locked.plug_in(bench.dongle)
    with pytest.raises(DeviceError, match="permission denied; add a udev rule"):
        bench.lamp(backend=locked).open()


def test_without_libusb_the_sentence_names_the_package(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    def find(*_: object, **__: object) -> None:
        raise usb.core.NoBackendError("No backend available")

    monkeypatch.setattr(usb.core, "find", find)
    with pytest.raises(DeviceError, match="libusb is missing; install the package libusb"):
        bench.lamp().open()


def test_the_system_s_own_driver_is_detached(bench: Bench) -> None:
    class Kernel(VirtualUsb):
        detached = 0

        def is_kernel_driver_active(self, dev_handle: Any, intf: int) -> bool:
            return not self.detached

        def detach_kernel_driver(self, dev_handle: Any, intf: int) -> None:
            self.detached += 1

    bus = Kernel(bench.clock)
    plug: UsbFunction = bench.dongle
    bus.plug_in(plug)
    with bench.lamp(backend=bus):
        assert bus.detached == 1
