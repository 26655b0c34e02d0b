"""What every device of a role must do, whatever brand fills it; later drivers join the lists."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from drivers.dynamixel import DynamixelAxis
from stage.devices import Axis, AxisGroup, Device, FrameCamera, Lamp
from stage.errors import DeviceError
from stage.rig import Joint
from tests.drivers.conftest import Bench

pytestmark = pytest.mark.system


def turntable(bench: Bench) -> DynamixelAxis:
    joint = Joint(servo_id=1, limits_deg=(-170, 170))
    return DynamixelAxis(bench.rig.motion.port, bench.rig.motion.baudrate, joint, clock=bench.clock)


ALL: list[Callable[[Bench], Any]] = [Bench.arm, Bench.lamp, Bench.photographer, turntable]
SERIAL: list[Callable[[Bench], Any]] = [Bench.arm, Bench.lamp, turntable]


def unplug(bench: Bench) -> None:
    bench.motion_port.unplug()
    bench.light_port.unplug()
    bench.usb.unplug(bench.camera_plug)


def plug_in(bench: Bench) -> None:
    bench.motion_port.plug_in()
    bench.light_port.plug_in()
    bench.usb.plug_in(bench.camera_plug)


def use(device: Any) -> None:
    """Have a device do what it is there for."""
    match device:
        case FrameCamera():
            device.capture(0.02)
        case Lamp():
            device.set_level(1.0)
        case AxisGroup():
            device.move_to([0.1] * len(device.limits_rad))
        case Axis():
            device.move_to(0.1)


@pytest.mark.parametrize(
    ("make", "role"),
    [(Bench.arm, AxisGroup), (Bench.lamp, Lamp), (Bench.photographer, FrameCamera), (turntable, Axis)],
)
def test_drivers_fill_their_role(bench: Bench, make: Callable[[Bench], Any], role: type) -> None:
    assert isinstance(make(bench), role)
    assert isinstance(make(bench), Device)
    assert make(bench).name


@pytest.mark.parametrize("make", ALL)
def test_open_close_and_make_safe_from_any_state_any_number_of_times(
    bench: Bench, make: Callable[[Bench], Any]
) -> None:
    device = make(bench)
    device.make_safe()
    device.close()
    for _ in range(2):
        device.open()
        device.open()
        device.make_safe()
        use(device)
        device.make_safe()
        device.make_safe()
        device.close()
        device.close()
        device.make_safe()


@pytest.mark.parametrize("make", ALL)
def test_a_device_that_is_not_open_says_so(bench: Bench, make: Callable[[Bench], Any]) -> None:
    with pytest.raises(DeviceError, match="not open"):
        use(make(bench))


@pytest.mark.parametrize("make", ALL)
def test_unplugged_devices_fail_in_one_sentence_and_work_again_once_plugged_in(
    bench: Bench, make: Callable[[Bench], Any]
) -> None:
    device = make(bench)
    device.open()
    use(device)
    unplug(bench)
    with pytest.raises(DeviceError) as failure:
        use(device)
    assert device.name in str(failure.value)
    assert "check" in str(failure.value).rsplit(";", 1)[1]  # the next step
    assert "\n" not in str(failure.value)
    if not isinstance(device, FrameCamera):
        with pytest.raises(DeviceError, match="no such port"):  # who knows whether it is safe
            device.make_safe()
    with pytest.raises(DeviceError):
        use(device)
    plug_in(bench)
    use(device)
    device.make_safe()
    unplug(bench)
    device.close()
    device.make_safe()
    with pytest.raises(DeviceError):
        device.open()
    device.make_safe()


@pytest.mark.parametrize("make", ALL)
def test_two_openers_of_one_device_are_refused(bench: Bench, make: Callable[[Bench], Any]) -> None:
    first, second = make(bench), make(bench)
    with first:
        with pytest.raises(DeviceError, match="another program"):
            second.open()
        use(first)
    with second:
        use(second)


@pytest.mark.parametrize("make", SERIAL)
def test_a_port_that_is_not_there_is_named(bench: Bench, make: Callable[[Bench], Any]) -> None:
    bench.close()
    with pytest.raises(DeviceError, match="no such port") as failure, make(bench):
        pass
    assert make(bench).name in str(failure.value)
