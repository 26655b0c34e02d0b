from __future__ import annotations

import struct
from typing import Any

import pytest

from simulators.clock import VirtualClock
from simulators.ur.controller import WORKING, Controller, RobotMode
from simulators.ur.dashboard import DashboardSession
from simulators.ur.rtde import RtdeSession
from simulators.ur.script import ScriptSession
from tests.bench import PlainWorld

CONTROL_PROGRAM = b"def rtde_control():\n    def signal_ready():\n    end\nend\n"


@pytest.fixture
def controller() -> Controller:
    return Controller(PlainWorld(VirtualClock()))


def package(kind: str, body: bytes = b"") -> bytes:
    return struct.pack(">HB", 3 + len(body), ord(kind)) + body


def outputs(frequency: float, *names: str) -> bytes:
    return package("O", struct.pack(">d", frequency) + ",".join(names).encode())


class TestRtde:
    """Bytes as the RTDE Guide of Universal Robots writes them."""

    def test_protocol_and_controller_version(self, controller: Controller) -> None:
        rtde = RtdeSession(controller)
        assert rtde.feed(bytes.fromhex("00 05 56 00 02")) == bytes.fromhex("00 04 56 01")
        assert rtde.feed(bytes.fromhex("00 05 56 00 09")) == bytes.fromhex("00 04 56 00")
        answer = rtde.feed(bytes.fromhex("00 03 76"))
        assert answer[:3] == bytes.fromhex("00 13 76")
        assert struct.unpack(">4I", answer[3:])[:2] == (5, 11)

    def test_packages_may_arrive_in_any_pieces(self, controller: Controller) -> None:
        rtde = RtdeSession(controller)
        sent = package("V", b"\0\2") * 2
        assert b"".join(rtde.feed(sent[i : i + 1]) for i in range(len(sent))) == bytes.fromhex("00 04 56 01") * 2
        assert RtdeSession(controller).feed(sent) == bytes.fromhex("00 04 56 01") * 2

    def test_outputs_are_sent_at_the_frequency_that_was_asked_for(self, controller: Controller) -> None:
        rtde = RtdeSession(controller)
        answer = rtde.feed(outputs(125.0, "timestamp", "actual_q", "robot_mode", "output_int_register_2"))
        assert answer == package("O", b"\x01DOUBLE,VECTOR6D,INT32,INT32")
        assert rtde.poll() == b""
        assert rtde.feed(package("S")) == package("S", b"\x01")
        sent = []
        for _ in range(8):
            controller.cycle()
            sent.append(rtde.poll())
        assert [bool(one) for one in sent] == [False, False, False, True] * 2
        assert sent[3][:4] == bytes([0, 4 + 8 + 48 + 4 + 4, ord("U"), 1])
        assert struct.unpack(">d6dii", sent[3][4:]) == (pytest.approx(4 * 0.002), *WORKING, RobotMode.RUNNING, 0)
        assert rtde.feed(package("P")) == package("P", b"\x01")
        controller.cycle()
        assert rtde.poll() == b""

    def test_outputs_that_do_not_exist_are_refused(self, controller: Controller) -> None:
        rtde = RtdeSession(controller)
        assert rtde.feed(outputs(125.0, "actual_q", "wind")) == package("O", b"\x00VECTOR6D,NOT_FOUND")
        assert rtde.feed(outputs(5000.0, "actual_q")) == package("O", b"\x00VECTOR6D")

    def test_inputs_belong_to_the_host_that_asked_first(self, controller: Controller) -> None:
        one, two = RtdeSession(controller), RtdeSession(controller)
        wanted = package("I", b"input_int_register_0,input_double_register_3")
        assert one.feed(wanted) == package("I", b"\x01INT32,DOUBLE")
        assert two.feed(wanted) == package("I", b"\x00IN_USE,IN_USE")
        assert two.feed(package("I", b"input_int_register_48")) == package("I", b"\x00NOT_FOUND")
        one.closed()
        assert two.feed(wanted) == package("I", b"\x01INT32,DOUBLE")

    def test_input_data_reaches_the_registers_if_it_is_whole(self, controller: Controller) -> None:
        rtde = RtdeSession(controller)
        rtde.feed(package("I", b"input_int_register_0,input_double_register_3"))
        assert rtde.feed(package("U", b"\x01" + struct.pack(">id", 7, 1.5))) == b""
        assert controller.inputs == {"input_int_register_0": 7, "input_double_register_3": 1.5}
        for wrong in (b"", b"\x02" + struct.pack(">id", 8, 2.5), b"\x01\x00"):
            rtde.feed(package("U", wrong))
        assert controller.inputs["input_int_register_0"] == 7

    def test_noise_in_place_of_a_package_is_skipped(self, controller: Controller) -> None:
        rtde = RtdeSession(controller)
        assert rtde.feed(b"\x00\x00\x00" + package("V", b"\0\2")) == package("V", b"\x01")
        assert rtde.feed(package("?", b"abc")) == b""
        assert rtde.feed(package("V")) == package("V", b"\x00")
        assert rtde.feed(package("O", b"short")) == b""

    def test_a_silent_controller_neither_hears_nor_sends(self, controller: Controller) -> None:
        rtde = RtdeSession(controller)
        rtde.feed(outputs(500.0, "timestamp") + package("S"))
        controller.board.strike("silent")
        controller.cycle()
        assert rtde.poll() == rtde.feed(package("V", b"\0\2")) == b""
        controller.speak()
        assert rtde.poll()
        assert rtde.feed(package("V", b"\0\2"))

    def test_safety_shows_in_modes_and_bits(self, controller: Controller) -> None:
        rtde = RtdeSession(controller)
        rtde.feed(outputs(500.0, "safety_mode", "safety_status_bits", "robot_status_bits", "runtime_state"))
        rtde.feed(package("S"))

        def seen() -> tuple[Any, ...]:
            controller.cycle()
            return struct.unpack(">iIII", rtde.poll()[4:])

        assert seen() == (1, 0b1, 0b01, 1)
        controller.board.strike("protective-stop")
        assert seen() == (3, 1 << 2 | 1 << 10, 0b01, 1)
        controller.board.strike("emergency-stop")
        assert seen() == (7, 1 << 6 | 1 << 7 | 1 << 10, 0b00, 1)


class TestDashboard:
    def test_it_greets_and_answers_line_by_line(self, controller: Controller) -> None:
        dashboard = DashboardSession(controller)
        assert dashboard.greeting() == b"Connected: Universal Robots Dashboard Server\n"
        assert dashboard.feed(b"robotmode\nsafetysta") == b"Robotmode: RUNNING\n"
        assert dashboard.feed(b"tus\n") == b"Safetystatus: NORMAL\n"
        assert dashboard.feed(b"PolyscopeVersion\n").startswith(b"URSoftware 5.11.")
        assert dashboard.feed(b"is in remote control\r\nrunning\n") == b"true\nProgram running: false\n"
        assert dashboard.feed(b"dance\n") == b"could not understand: 'dance'\n"

    def test_a_person_can_bring_the_arm_back(self, controller: Controller) -> None:
        dashboard = DashboardSession(controller)
        controller.board.strike("emergency-stop")
        assert dashboard.feed(b"safetymode\nrobotmode\n") == b"Safetymode: ROBOT_EMERGENCY_STOP\nRobotmode: POWER_OFF\n"
        assert dashboard.feed(b"power on\nrobotmode\n") == b"Powering on\nRobotmode: IDLE\n"
        assert dashboard.feed(b"brake release\nrobotmode\n") == b"Brake releasing\nRobotmode: RUNNING\n"
        controller.board.strike("protective-stop")
        assert dashboard.feed(b"unlock protective stop\n").startswith(b"Cannot unlock protective stop until 5s")

    def test_it_stops_programs_and_hangs_up(self, controller: Controller) -> None:
        dashboard = DashboardSession(controller)
        ScriptSession(controller).feed(CONTROL_PROGRAM)
        assert dashboard.feed(b"stop\nrunning\n") == b"Stopped\nProgram running: false\n"
        assert not dashboard.finished()
        assert dashboard.feed(b"quit\n") == b"Disconnected\n"
        assert dashboard.finished()

    def test_a_silent_controller_says_nothing(self, controller: Controller) -> None:
        controller.board.strike("silent")
        dashboard = DashboardSession(controller)
        assert dashboard.greeting() == dashboard.feed(b"robotmode\n") == b""


class TestScript:
    def test_the_control_program_is_run_once_it_is_whole(self, controller: Controller) -> None:
        script = ScriptSession(controller)
        assert script.feed(CONTROL_PROGRAM[:-3]) == b""
        assert not controller.program_running
        script.feed(CONTROL_PROGRAM[-3:])
        assert controller.program_running

    def test_any_other_program_ends_the_one_that_runs(self, controller: Controller) -> None:
        script = ScriptSession(controller)
        script.feed(CONTROL_PROGRAM + b"def other():\n  popup(1)\nend\n")
        assert not controller.program_running

    def test_a_silent_controller_takes_none(self, controller: Controller) -> None:
        controller.board.strike("silent")
        ScriptSession(controller).feed(CONTROL_PROGRAM)
        assert not controller.program_running


@pytest.mark.parametrize("session", [RtdeSession, DashboardSession, ScriptSession])
def test_no_connection_outlives_a_restart(controller: Controller, session: Any) -> None:
    before = session(controller)
    assert not before.finished()
    controller.board.strike("brown-out")
    assert before.finished()
    assert not session(controller).finished()
