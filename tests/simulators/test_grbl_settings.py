from __future__ import annotations

import math
from typing import Any

import pytest

from simulators.grbl_settings import LAMP_ONLY, setup_for
from stage.rig import GrblSlide, GrblTurn
from tests.simulators.grbl_bench import Machine


@pytest.mark.parametrize(
    ("limits", "zero", "soft", "upwards"),
    [((-170.0, 170.0), -180.0, 1, False), ((0.0, 90.0), 5.0, 1, True), ((-90.0, 90.0), 0.0, 0, False)],
)
def test_a_setup_that_suits_a_rig(limits: tuple[float, float], zero: float, soft: int, upwards: bool) -> None:
    joint = GrblTurn(axis="X", limits_deg=limits, zero=zero, speed_deg_s=30, acceleration_deg_s2=100)
    setup = setup_for([joint], homed=True)
    assert setup.zero_at_switch == upwards
    machine = Machine(setup)
    assert machine.grbl.settings[20] == soft
    assert machine.grbl.settings[110] == 1800
    assert machine.grbl.settings[120] == pytest.approx(100)
    for limit in (*limits, sum(limits) / 2):
        assert machine.say(f"G53G0X{joint.machine_value(math.radians(limit))}") == "ok\r\n"
        machine.clock.sleep(30)
        assert machine.true[0] == pytest.approx(zero + limit)


def test_a_setup_for_slides_counts_millimetres() -> None:
    slide: Any = GrblSlide(axis="Y", limits_m=(-0.4, 0.0), speed_m_s=0.05, acceleration_m_s2=0.2)
    settings = setup_for([slide]).settings
    assert (settings[111], settings[121]) == (3000, 200)
    assert settings[131] >= 400


def test_a_controller_that_drives_a_lamp_alone_moves_nothing_in_the_world_and_is_ready_at_once() -> None:
    machine = Machine(LAMP_ONLY)
    assert machine.world.drives == {}
    assert machine.say("M3S1000") == "ok\r\n"
    assert machine.light == 1
