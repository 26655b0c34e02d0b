"""What every device of a role must do, whatever brand fills it, on a simulator and on a bench."""

from __future__ import annotations

import math
import random
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from typing import Any

import numpy as np
import pytest

from api.devices import Wires, Workshop
from stage.devices import AxisGroup, Device, FrameCamera, Lamp
from stage.errors import DeviceError, InputError

pytestmark = pytest.mark.system
lamps_awake = pytest.mark.usefixtures("awake")

ROLES = {"motion": AxisGroup, "lamp": Lamp, "camera": FrameCamera}
STEP_RAD, STEP_M = math.radians(2), 0.01


def use(device: Any, wires: Wires) -> None:
    """Have a device do what it is there for."""
    match device:
        case FrameCamera():
            device.capture(wires.rig.camera.device.exposure_s)
        case Lamp():
            wires.clock.sleep(1.1)  # a test may not flash either
            device.set_level(1.0)
        case AxisGroup():
            device.move_to(nearby(device, wires))


def nearby(motion: AxisGroup, wires: Wires) -> tuple[float, ...]:
    """A place a little away from where the joints stand, within their limits."""
    steps = [STEP_M if joint.whole_turn is None else STEP_RAD for joint in wires.rig.motion.joints]
    found = []
    for at, step, (low, high) in zip(motion.positions(), steps, motion.limits, strict=True):
        inside = min(max(at, low), high)  # a machine's home may lie beyond
        found.append(inside + step if inside + step <= high else inside - step)
    return tuple(found)


@pytest.fixture
def awake(workshop: Workshop, wires: Wires, request: pytest.FixtureRequest) -> Iterator[None]:
    """A controller that both moves and lights lets its lamp shine only once its axes know where they are."""
    role = request.node.callspec.params.get("role", "lamp")
    if role == "lamp" and wires.rig.light.driver == "grbl-spindle":
        with workshop.motion():
            yield
    else:
        yield


@pytest.mark.parametrize("role", ROLES)
def test_drivers_fill_their_role(workshop: Workshop, role: str) -> None:
    device = getattr(workshop, role)()
    assert isinstance(device, ROLES[role])
    assert isinstance(device, Device)
    assert device.name


@lamps_awake
@pytest.mark.parametrize("role", ROLES)
def test_open_close_and_make_safe_from_any_state_any_number_of_times(
    workshop: Workshop, wires: Wires, role: str
) -> None:
    device = getattr(workshop, role)()
    device.make_safe()
    device.close()
    for _ in range(2):
        device.open()
        device.open()
        device.make_safe()
        use(device, wires)
        device.make_safe()
        device.make_safe()
        device.close()
        device.close()
        device.make_safe()
        if wires.world is not None:
            assert not wires.world.light(wires.clock.now())[1].any()


@pytest.mark.parametrize("role", ROLES)
def test_a_device_that_is_not_open_says_so(workshop: Workshop, wires: Wires, role: str) -> None:
    device = getattr(workshop, role)()
    acts = {
        "motion": lambda: device.move_to(wires.rig.motion.home),
        "lamp": lambda: device.set_level(1.0),
        "camera": lambda: device.capture(wires.rig.camera.device.exposure_s),
    }
    with pytest.raises(DeviceError, match="not open"):
        acts[role]()


@pytest.mark.parametrize("role", ROLES)
def test_two_openers_of_one_device_are_refused(workshop: Workshop, wires: Wires, role: str) -> None:
    if role == "motion" and role not in wires.rig.addresses():
        pytest.skip("there is nothing to plug in")
    if role == "lamp" and wires.rig.light.driver == "grbl-spindle":
        pytest.skip("its controller is taken by the axes, whose turn is tried by itself")
    if role == "camera" and wires.rig.camera.device.driver in ("opencv", "replay"):
        pytest.skip("a stream or a folder may be watched by many")
    other = Workshop(wires.rig, wires.clock, wires.usb, wires.world)
    first, second = getattr(workshop, role)(), getattr(other, role)()
    with first:
        with pytest.raises(DeviceError, match="another program"):
            second.open()
        use(first, wires)
    with second:
        use(second, wires)


def test_joints_arrive_where_they_are_sent_and_say_so(workshop: Workshop, wires: Wires) -> None:
    with workshop.motion() as motion:
        start = motion.positions()
        assert len(start) == len(motion.limits) == len(wires.rig.motion.joints)
        target = nearby(motion, wires)
        arrival = motion.move_to(target)
        assert arrival.move_s >= 0
        assert arrival.settle_s >= 0
        tolerances = getattr(wires.rig.motion, "tolerances", ())
        for reached, here, goal, tolerance in zip(
            arrival.positions, motion.positions(), target, tolerances, strict=True
        ):
            assert abs(reached - goal) <= 1.01 * tolerance
            assert abs(here - reached) <= tolerance
        motion.move_to(nearby(motion, wires))


def test_targets_beyond_a_limit_or_of_another_number_are_refused_and_nothing_moves(
    workshop: Workshop, wires: Wires
) -> None:
    with workshop.motion() as motion:
        start = motion.positions()
        with pytest.raises(DeviceError, match=r"expected .* got"):
            motion.move_to((*start, 0.0))
        for number, (low, high) in enumerate(motion.limits):
            for beyond in (low - 0.1, high + 0.1, math.nan):
                target = list(nearby(motion, wires))
                target[number] = beyond
                with pytest.raises(DeviceError, match="limits"):
                    motion.move_to(target)
        np.testing.assert_allclose(motion.positions(), start, atol=2e-3)


@lamps_awake
def test_a_lamp_says_what_it_really_shows_and_refuses_what_it_cannot(workshop: Workshop, wires: Wires) -> None:
    with workshop.lamp() as lamp:
        lit = lamp.set_level(0.5)
        assert len(lit) == lamp.emitters == len(wires.rig.light.emitters)
        assert lit == pytest.approx([0.5] * lamp.emitters, abs=0.02)
        if wires.world is not None:
            now = wires.clock.now()
            np.testing.assert_allclose(wires.world.light(now)[1], wires.rig.light.intensity_at(lit), rtol=1e-6)
        for wrong in ([1.5] * lamp.emitters, [-0.1] * lamp.emitters, [math.nan] * lamp.emitters):
            with pytest.raises(DeviceError, match="0 to 1"):
                lamp.set_levels(wrong)
        with pytest.raises(DeviceError, match="expected"):
            lamp.set_levels([0.5] * (lamp.emitters + 1))
        lamp.dark()
        if wires.world is not None:
            assert not wires.world.light(wires.clock.now())[1].any()
    if wires.world is not None:
        assert not wires.world.light(wires.clock.now())[1].any()


def test_a_camera_gives_a_new_file_for_every_exposure_and_refuses_times_it_lacks(
    workshop: Workshop, wires: Wires
) -> None:
    exposure_s = wires.rig.camera.device.exposure_s
    with workshop.camera() as camera:
        camera.require_exposure(exposure_s)
        with pytest.raises(InputError, match="exposure_s"):
            camera.require_exposure(1e6)
        with pytest.raises(InputError, match="exposure_s"):
            camera.capture(1e6)
        first, second = camera.capture(exposure_s), camera.capture(exposure_s)
        assert first.data
        assert first.name
        assert first.name != second.name or first.data != second.data
        assert first.exposure_s == pytest.approx(exposure_s, rel=0.02)
        assert first.expose_s > 0
        assert first.download_s >= 0
        assert second.started_s >= first.started_s


@lamps_awake
@pytest.mark.parametrize("role", ROLES)
def test_unplugged_devices_fail_in_one_sentence_and_work_again_once_plugged_in(
    workshop: Workshop, wires: Wires, role: str
) -> None:
    name = "light" if role == "lamp" else role
    if wires.stage is None or name not in wires.stage.parts:
        pytest.skip(f"{role}: there is no simulated plug to pull")
    plug = wires.stage.parts[name].plug
    device = getattr(workshop, role)()
    device.open()
    use(device, wires)
    plug.unplug()
    with pytest.raises(DeviceError) as failure:
        use(device, wires)
    assert str(failure.value).startswith(device.name.split()[0])
    assert "check" in str(failure.value).rsplit(";", 1)[-1]  # the next step
    assert "\n" not in str(failure.value)
    if not isinstance(device, FrameCamera):
        with pytest.raises(DeviceError):  # who knows whether it is safe
            device.make_safe()
    with pytest.raises(DeviceError):
        use(device, wires)
    plug.plug_in()
    use(device, wires)
    device.make_safe()
    plug.unplug()
    device.close()
    device.make_safe()
    with pytest.raises(DeviceError):
        device.open()
    device.make_safe()
    plug.plug_in()


class Side:
    """Something that a thread of its own does, until it is done or raises."""

    def __init__(self, act: Callable[[], object], work: AbstractContextManager[None]) -> None:
        self.error: BaseException | None = None
        self.ended = threading.Event()
        self._act, self._work = act, work
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def join(self) -> BaseException | None:
        """Wait for the end, and return what was raised."""
        self._thread.join(20)
        assert not self._thread.is_alive()
        return self.error

    def _run(self) -> None:
        try:
            with self._work:
                self._act()
        except Exception as error:
            self.error = error
        finally:
            self.ended.set()


def test_make_safe_of_another_thread_stops_a_long_move_at_once(workshop: Workshop, wires: Wires) -> None:
    if wires.world is None:
        pytest.skip("on a bench joints are not sent far")
    clock = wires.clock
    with workshop.motion() as motion:
        if not motion.limits:
            pytest.skip("nothing moves")
        for after_s in (0.4, 0.41, 0.43):
            here = motion.positions()
            ends = motion.limits if after_s != 0.41 else [(high, low) for low, high in motion.limits]
            goal = tuple(low if abs(at - low) > 0.2 else high for at, (low, high) in zip(here, ends, strict=True))
            with clock.at_work():
                mover = Side(lambda goal=goal: motion.move_to(goal), clock.at_work())
                clock.sleep(after_s)
                begun_s, began_s = clock.now(), time.monotonic()
                motion.make_safe()
                assert clock.now() - begun_s < 1.0
                assert time.monotonic() - began_s < 10.0
            error = mover.join()
            assert isinstance(error, DeviceError), error
            assert "cut short" in str(error)
            stood = motion.positions()
            assert not np.allclose(stood, goal, atol=0.01)
            assert not np.allclose(stood, here, atol=1e-3)
            clock.sleep(3.0)
            np.testing.assert_allclose(motion.positions(), stood, atol=1e-9)
        target = nearby(motion, wires)
        np.testing.assert_allclose(motion.move_to(target).positions, target, atol=0.01)


@lamps_awake
def test_no_call_lights_a_lamp_that_was_made_safe_meanwhile(workshop: Workshop, wires: Wires) -> None:
    world, clock, chance = wires.world, wires.clock, random.Random(4)
    if world is None:
        pytest.skip("who is at a bench is not shown that many flashes")
    with workshop.lamp() as lamp:

        def hammer() -> None:
            while True:
                for level in (1.0, 0.9, 0.8, 0.0):
                    clock.sleep(lamp.pause_s())
                    lamp.set_level(level)

        for _ in range(15):
            other = Side(hammer, wires.clock.at_work())
            while not other.ended.wait(chance.uniform(0.0, 0.02)):  # between two calls there is nobody to tell
                lamp.make_safe()
            assert isinstance(other.join(), DeviceError)
            for _ in range(2):
                assert not world.light(clock.now())[1].any()
                clock.sleep(1.0)
        assert lamp.set_level(1.0) == (1.0,) * lamp.emitters


def test_a_photograph_comes_whatever_is_made_safe_meanwhile(workshop: Workshop, wires: Wires) -> None:
    with workshop.camera() as camera:
        exposure_s = wires.rig.camera.device.exposure_s
        photographer = Side(lambda: [camera.capture(exposure_s) for _ in range(5)], wires.clock.at_work())
        camera.make_safe()
        assert photographer.join() is None
        exposure = camera.expose(camera.nearest_exposure(exposure_s))
        assert exposure.expose_s > 0
        assert camera.download(exposure).data
        with pytest.raises(DeviceError, match="take the picture again"):
            camera.download(exposure)
