from __future__ import annotations

import pytest

from drivers.fixed_dome import FixedDomeMotion
from simulators.clock import VirtualClock
from stage.devices import Arrival, AxisGroup, Device
from stage.errors import DeviceError
from stage.rig import FixedDome


def test_it_is_a_group_of_no_joints_that_rests() -> None:
    clock = VirtualClock()
    dome = FixedDomeMotion(FixedDome(driver="fixed-dome", settle_s=0.25), clock=clock)
    assert isinstance(dome, AxisGroup)
    assert isinstance(dome, Device)
    with dome:
        assert dome.limits == dome.positions() == ()
        assert dome.move_to(()) == Arrival((), 0.0, 0.25)
        assert clock.now() == 0.25
        with pytest.raises(DeviceError, match="expected no joint values, got 1; check motion in the rig"):
            dome.move_to((0.1,))


def test_it_can_be_opened_and_closed_from_any_state_and_says_where_it_is_not_open() -> None:
    dome = FixedDomeMotion(FixedDome(driver="fixed-dome"), clock=VirtualClock())
    dome.make_safe()
    dome.close()
    for _ in range(2):
        dome.open()
        dome.open()
        dome.move_to(())
        dome.make_safe()
        dome.close()
        dome.close()
    with pytest.raises(DeviceError, match="fixed dome: it is not open; open it first"):
        dome.positions()
    with pytest.raises(DeviceError, match="not open"):
        dome.move_to(())
