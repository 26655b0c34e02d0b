from __future__ import annotations

import pytest

from stage.errors import InputError
from tests.grbl_manual import BANNER, UNLOCK
from tests.simulators.grbl_bench import Machine


def test_faults_by_name() -> None:
    machine = Machine()
    board = machine.grbl.board
    assert board.names == (
        "alarm",
        "brown-out",
        "error",
        "garbled",
        "hard-limit",
        "silent",
        "stall",
        "swallowed-ok",
    )
    board.strike("swallowed-ok", times=2)
    assert machine.say("G90") + machine.say("G91") + machine.say("") == "ok\r\n"
    board.strike("error", number=20)
    assert machine.say("G90") + machine.say("G90") == "error:20\r\nok\r\n"
    board.strike("silent", messages=2)
    assert machine.say("G20") + machine.grbl.feed(b"?").decode() + machine.say("") == "ok\r\n"
    assert "G21" in machine.say("$G")  # it did not hear
    board.strike("garbled")
    assert machine.say("") not in ("", "ok\r\n")
    assert machine.say("") == "ok\r\n"
    board.strike("alarm", number=9)
    assert machine.grbl.feed(b"") == b"ALARM:9\r\n" + BANNER + UNLOCK
    board.strike("alarm", number=5)
    assert machine.say("G90") == "ALARM:5\r\nerror:9\r\n"
    for options in ({}, {"number": 1, "times": 2}):
        with pytest.raises(InputError):
            board.strike("alarm", **options)


def test_a_brown_out_counts_from_zero_wherever_the_machine_stands() -> None:
    machine = Machine()
    machine.say("M3S1000")
    machine.grbl.board.strike("brown-out")
    assert machine.grbl.feed(b"") == BANNER + UNLOCK
    assert machine.status()["MPos"] == "0.000,0.000,0.000"
    assert machine.true == (-100, -100, -100)
    assert machine.light == 0


def test_a_stall_freezes_the_position_until_a_reset() -> None:
    machine = Machine()
    machine.say("G1X-200F6000")
    machine.clock.sleep(0.5)
    machine.grbl.board.strike("stall")
    stuck = machine.status()["MPos"]
    machine.clock.sleep(5)
    assert machine.status()["state"] == "Run"
    assert machine.status()["MPos"] == stuck
    machine.grbl.feed(b"!\x18")
    assert machine.status() == {"state": "Idle", "MPos": stuck, "FS": "0,0", "WCO": "0.000,0.000,0.000"}
    machine.grbl.board.strike("stall")  # at rest: it lies in wait
    machine.say("G1X-200F6000")
    machine.clock.sleep(5)
    assert (machine.status()["state"], machine.status()["MPos"]) == ("Run", stuck)


@pytest.mark.parametrize("enabled", [True, False])
def test_a_limit_switch_locks_where_hard_limits_are_on(enabled: bool) -> None:
    machine = Machine(s21=enabled)
    machine.say("G1X-200F6000")
    machine.clock.sleep(0.5)
    machine.grbl.board.strike("hard-limit", axis="Y")
    if enabled:
        assert machine.grbl.feed(b"?") == b"ALARM:1\r\n[MSG:Reset to continue]\r\n"
        machine.grbl.feed(b"\x18")
        assert machine.status()["state"] == "Alarm"
    else:
        assert machine.status()["Pn"] == "Y"
        assert machine.status()["state"] == "Run"


def test_a_fault_strikes_at_the_nth_message() -> None:
    machine = Machine()
    machine.grbl.board.strike_at(3, "error", number=8)
    assert [machine.say("G90") for _ in range(2)] == ["ok\r\n"] * 2
    machine.grbl.board.strike_at(4, "brown-out")
    assert machine.say("G90") == "error:8\r\n"
    assert machine.say("G90").encode() == BANNER + UNLOCK  # and the line is lost
