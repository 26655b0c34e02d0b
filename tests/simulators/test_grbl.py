from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulators.grbl_settings import Setup
from tests.grbl_manual import BANNER, BUILD, REPORT, SETTINGS, UNLOCK
from tests.simulators.grbl_bench import HOMED, Machine


def test_it_wakes_up_locked_where_it_can_be_homed() -> None:
    machine = Machine(Setup())
    assert machine.grbl.feed(b"?") == b"<Alarm|MPos:0.000,0.000,0.000|FS:0,0|WCO:0.000,0.000,0.000>\r\n"
    assert machine.say("G0X-1") == "error:9\r\n"
    assert machine.grbl.feed(b"\x18") == BANNER + UNLOCK
    assert machine.say("$X") == "[MSG:Caution: Unlocked]\r\nok\r\n"
    assert machine.status()["state"] == "Idle"
    assert Machine(Setup({22: 0})).status()["state"] == "Idle"


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        ("", "ok"),
        ("(a remark) ; another", "ok"),
        ("g21 g90", "ok"),
        ("1X", "error:1"),
        ("GX", "error:2"),
        ("G1X1.2.3F100", "error:1"),
        ("G1X--1F100", "error:2"),
        ("$Q", "error:3"),
        ("$999=1", "error:3"),
        ("$30=-1", "error:4"),
        ("G1X-1F-5", "error:4"),
        ("S-1", "error:4"),
        ("$20=1", "ok"),
        ("$J=X5F100", "error:15"),
        ("$J=X-5F100M3", "error:16"),
        ("$J=X-5", "error:22"),
        ("$J=F5", "error:26"),
        ("G2X1I1", "error:20"),
        ("M7", "error:20"),
        ("A5", "error:20"),
        ("G0G1X-1", "error:21"),
        ("M3M5", "error:21"),
        ("G1X-1", "error:22"),
        ("G0.5X-1", "error:23"),
        ("X-1X-2", "error:25"),
        ("G4", "error:28"),
        ("G80X-1", "error:31"),
        ("G53G80", "error:30"),
        ("G0X-1P2", "error:36"),
    ],
)
def test_lines_are_answered_as_the_manual_numbers_them(line: str, answer: str) -> None:
    assert Machine().say(line) == f"{answer}\r\n"


def test_homing_that_is_not_enabled_and_soft_limits_without_it() -> None:
    machine = Machine(s22=0, s20=0)
    assert machine.say("$H") == "error:5\r\n"
    assert machine.say("$20=1") == "error:10\r\n"


def test_a_line_of_79_characters_is_taken_and_one_more_is_not() -> None:
    machine = Machine()
    line = "G0X-100." + "0" * 71
    assert machine.say(line) == "ok\r\n"
    assert machine.say(line + "0") == "error:11\r\n"


def test_a_line_is_a_trapezoid_of_speed_on_all_axes_together() -> None:
    machine = Machine()
    assert machine.say("G90G21G53G1X-130Y-140F3000") == "ok\r\n"  # 50 mm at 50 mm/s
    assert machine.status()["state"] == "Run"
    # $120 and $121 are 500 mm/s2, and the line's direction (0.6, 0.8) makes 500 / 0.8 along it.
    push, speed, length = 625.0, 50.0, 50.0
    total = length / speed + speed / push
    for share in (0.03, 0.3, 0.5, 0.9):
        machine.clock.sleep(share * total - machine.clock.now())
        now = machine.clock.now()
        ramp = min(now, speed / push)
        far = push * ramp**2 / 2 + speed * (now - ramp)
        assert machine.true == pytest.approx((-100 - 0.6 * far, -100 - 0.8 * far, -100), abs=1e-6)
    machine.clock.sleep(total)
    assert machine.status()["state"] == "Idle"
    assert machine.true == pytest.approx((-130, -140, -100))


def test_an_axis_goes_no_faster_than_its_setting() -> None:
    machine = Machine(s110=600)
    machine.say("G0X-200")  # 100 mm at 10 mm/s
    assert machine.after(5, b"?").startswith("<Run|MPos:-149.9")
    machine.say("")
    machine.clock.sleep(5.1)
    assert machine.status()["state"] == "Idle"


def test_ok_is_withheld_while_the_planner_is_full() -> None:
    machine = Machine()
    said = "".join(machine.say(f"G90G1X{-100 - k}F600") for k in range(1, 18))  # 0.1 s each and a little more
    assert said == "ok\r\n" * 15
    assert machine.after(0.05) == ""
    assert machine.after(0.1) == "ok\r\n"
    assert machine.status()["state"] == "Run"
    assert machine.after(0.1) == "ok\r\n"
    machine.clock.sleep(5)
    assert machine.status() | {"Ov": ""} == {
        "state": "Idle",
        "MPos": "-117.000,-100.000,-100.000",
        "FS": "0,0",
        "Ov": "",
    }


def test_bytes_beyond_the_receive_buffer_are_lost() -> None:
    machine = Machine()
    machine.say("G4P1")
    machine.grbl.feed(b"G0X-1\n" * 40)
    said = machine.after(60)
    assert said.count("ok") < 30


def test_a_dwell_and_a_new_spindle_speed_wait_for_the_machine_to_rest() -> None:
    machine = Machine()
    assert machine.say("G1X-150F3000") == "ok\r\n"
    assert machine.say("M3S1000") == ""
    assert machine.light == 0
    assert machine.after(0.9) == ""
    assert machine.after(0.3) == "ok\r\n"
    assert machine.light == 1
    assert machine.say("G4P0.5") == ""
    assert machine.say("M5") == ""
    assert machine.after(0.4) == ""
    assert machine.after(0.2) == "ok\r\nok\r\n"
    assert machine.light == 0


def test_beyond_the_travel_it_locks_and_says_nothing_until_reset_and_keeps_its_position() -> None:
    machine = Machine()
    machine.say("M3S500")
    machine.say("G1X-300F3000")
    machine.clock.sleep(1)
    assert machine.say("G0X1") == ""  # it brakes first
    assert machine.after(1) == "ALARM:2\r\n[MSG:Reset to continue]\r\n"
    assert machine.light == 0
    assert machine.say("$$") + machine.grbl.feed(b"?!~").decode() == ""
    assert machine.grbl.feed(b"\x18") == BANNER + UNLOCK
    assert float(machine.status()["MPos"].split(",")[0]) == pytest.approx(machine.true[0], abs=1e-3)
    assert -152 < machine.true[0] < -148


def test_homing_answers_at_its_end_and_listens_to_nothing_but_a_reset() -> None:
    machine = Machine(Setup(positions={"X": -77.0, "Y": -3.0, "Z": -50.0}))
    assert machine.say("$H") == ""
    assert machine.grbl.feed(b"?!") == b""
    assert machine.after(30) == "ok\r\n"
    assert machine.true == pytest.approx((-1, -1, -1))  # the pull-off, $27
    assert machine.status()["MPos"] == "-1.000,-1.000,-1.000"
    machine.say("$H")
    assert machine.after(0.5, b"\x18").encode() == b"ALARM:6\r\n" + BANNER + UNLOCK


@pytest.mark.parametrize(
    ("zero_at_switch", "mask", "home"), [(False, 7, -359), (True, 7, 0), (True, 0, 0), (False, 0, -1)]
)
def test_where_home_is(zero_at_switch: bool, mask: int, home: float) -> None:
    machine = Machine(Setup({23: mask}, zero_at_switch=zero_at_switch))
    machine.say("$H")
    machine.clock.sleep(60)
    assert machine.status()["MPos"] == ",".join([f"{home:.3f}"] * 3)
    assert ("Z," in machine.say("$I")) == zero_at_switch
    assert machine.say(f"G0X{home + (10 if mask else -10)}") == "ok\r\n"
    machine.clock.sleep(5)
    beyond = home - 10 if mask else home + 10
    assert machine.say(f"G0X{beyond}").startswith("ALARM:2")


def test_a_feed_hold_brakes_and_goes_on_and_a_reset_then_keeps_the_position() -> None:
    machine = Machine()
    machine.say("M3S1000")
    machine.say("G1X-200F6000")
    machine.clock.sleep(0.5)
    machine.grbl.feed(b"!")
    assert machine.status()["state"] == "Hold:1"
    machine.clock.sleep(0.3)
    assert machine.status()["state"] == "Hold:0"
    held = machine.true
    assert held[0] == pytest.approx(-100 - 100 * 0.5 + 100**2 / 1000 - 100**2 / 1000, abs=0.01)
    assert machine.light == 1
    assert machine.say("M5") == ""  # lines wait, too
    machine.grbl.feed(b"~")
    assert machine.status()["state"] == "Run"
    assert machine.after(2) == "ok\r\n"
    assert machine.true[0] == pytest.approx(-200)
    machine.say("G1X-100")
    machine.clock.sleep(0.5)
    machine.grbl.feed(b"!")
    machine.clock.sleep(0.5)
    assert machine.grbl.feed(b"\x18") == BANNER
    assert machine.light == 0
    status = machine.status()
    assert status["state"] == "Idle"
    assert float(status["MPos"].split(",")[0]) == pytest.approx(machine.true[0], abs=1e-3)


def test_a_reset_in_mid_move_loses_the_position() -> None:
    machine = Machine()
    machine.say("G1X-200F6000")
    machine.clock.sleep(0.5)
    assert machine.grbl.feed(b"\x18") == b"ALARM:3\r\n" + BANNER + UNLOCK
    believed = float(machine.status()["MPos"].split(",")[0])
    assert machine.true[0] == pytest.approx(believed - 100**2 / 1000, abs=0.01)  # it coasted on
    machine.say("$H")
    machine.clock.sleep(60)
    assert machine.true == pytest.approx((-1, -1, -1))


def test_a_jog_is_cancelled_and_locks_g_code_out() -> None:
    machine = Machine()
    assert machine.say("$J=G91X-50F3000") == "ok\r\n"
    assert machine.status()["state"] == "Jog"
    assert machine.say("G0X-1") == "error:9\r\n"
    machine.clock.sleep(0.5)
    machine.grbl.feed(b"\x85")
    machine.clock.sleep(0.5)
    assert machine.status()["state"] == "Idle"
    assert -130 < machine.true[0] < -120
    assert "G0 " in machine.say("$G")  # a jog leaves the modes alone


def test_settings_and_listings_wait_for_an_idle_machine() -> None:
    machine = Machine()
    machine.say("G1X-200F600")
    for line in ("$$", "$I", "$#", "$10=3", "$H", "$C"):
        assert machine.say(line) == "error:8\r\n"
    assert machine.say("$G").startswith("[GC:G1 G54 G17 G21 G90 G94 M5 M9 T0 F600 S0]")


def test_answers_are_those_of_the_manual() -> None:
    listed = [line.split("=") for line in SETTINGS.decode().split("\r\n") if line.startswith("$")]
    settings = {int(number[1:]): float(value) for number, value in listed}
    machine = Machine(Setup(settings, {"Y": -10.0, "Z": 5.0}, homed=True))
    assert machine.grbl.feed(b"?") == REPORT
    assert machine.say("$$").encode() == SETTINGS
    assert machine.say("$I").encode() == BUILD
    assert machine.say("$#").startswith("[G54:0.000,0.000,0.000]\r\n[G55:0.000,0.000,0.000]\r\n")
    assert machine.say("$").startswith("[HLP:$$ $# $G $I $N $x=val $Nx=line $J=line $SLP $C $X $H ~ ! ? ctrl-x]")
    assert machine.grbl.feed(b"\x18") == BANNER


def test_status_reports_carry_some_fields_now_and_then() -> None:
    machine = Machine(s10=3)
    machine.say("M3S300")
    reports = [machine.grbl.feed(b"?").decode().strip() for _ in range(12)]
    assert reports[0] == "<Idle|MPos:-100.000,-100.000,-100.000|Bf:15,128|FS:0,300|WCO:0.000,0.000,0.000>"
    assert reports[1] == "<Idle|MPos:-100.000,-100.000,-100.000|Bf:15,128|FS:0,300|Ov:100,100,100|A:S>"
    assert [("WCO" in one, "Ov" in one) for one in reports[2:10]] == [(False, False)] * 8
    assert "WCO" in reports[10]
    assert "Ov" in reports[11]


def test_work_coordinates_and_inches() -> None:
    machine = Machine(Setup({10: 0, 13: 1}, HOMED.positions, homed=True, work_offset={"X": -50.8}))
    assert machine.status()["WPos"] == "-1.937,-3.937,-3.937"
    machine.say("G20G0X-1")
    machine.clock.sleep(5)
    assert machine.true[0] == pytest.approx(-76.2, abs=0.01)
    machine.say("G53G0X-1")
    machine.clock.sleep(5)
    assert machine.true[0] == pytest.approx(-25.4, abs=0.01)


def test_check_mode_moves_nothing() -> None:
    machine = Machine()
    assert machine.say("$C") == "[MSG:Enabled]\r\nok\r\n"
    assert machine.say("M3S1000") + machine.say("G0X-5") == "ok\r\nok\r\n"
    assert machine.status()["state"] == "Check"
    assert machine.light == 0
    assert machine.say("$C") == f"[MSG:Disabled]\r\n{BANNER.decode()}ok\r\n"
    assert machine.true == (-100, -100, -100)


@pytest.mark.parametrize(
    ("line", "level"),
    [("M3S1000", 1.0), ("M3S5000", 1.0), ("M4S500", 128 / 255), ("M3S1", 1 / 255), ("M3S0", 0.0), ("S500", 0.0)],
)
def test_the_lamp_has_255_steps_of_pulse_width(line: str, level: float) -> None:
    machine = Machine()
    machine.say(line)
    assert machine.light == pytest.approx(level)
    machine.say("M2")
    assert machine.light == 0


def test_laser_mode_is_dark_at_rest_and_on_rapid_moves() -> None:
    machine = Machine(s32=1)
    machine.say("M3S1000")
    assert machine.light == 0  # G0 is active
    machine.say("G1F600")
    assert machine.light == 1
    machine.say("M4")
    assert machine.light == 0
    machine.say("G1X-110")
    assert machine.light == 1
    machine.after(5)
    assert machine.light == 0


def test_a_door_stops_motion_and_lamp() -> None:
    machine = Machine()
    machine.say("M3S1000")
    machine.say("G1X-200F6000")
    machine.clock.sleep(0.5)
    machine.grbl.feed(b"\x84")
    assert machine.status()["state"] == "Door:2"
    assert machine.light == 0
    machine.clock.sleep(1)
    assert machine.status()["state"] == "Door:0"
    machine.grbl.feed(b"~")
    machine.after(5)
    assert machine.true[0] == pytest.approx(-200)
    assert machine.light == 1


@given(cuts=st.lists(st.integers(1, 59), max_size=8, unique=True))
def test_what_comes_in_pieces_is_understood_as_in_one(cuts: list[int]) -> None:
    data = b"G90G1X-101F600\nM3S500\n$X\n?G0X-102\n(hold)\n$G\nG91\n?$10=3\nG4P0\n"
    whole, pieces = Machine(), Machine()
    at = [0, *sorted(cuts), len(data)]
    said = b"".join(pieces.grbl.feed(data[a:b]) for a, b in pairwise(at))
    assert said == whole.grbl.feed(data)
