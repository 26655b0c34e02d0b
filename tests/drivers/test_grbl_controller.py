from __future__ import annotations

import pytest

from drivers import grbl_controller
from drivers.grbl_controller import GrblController
from drivers.grbl_words import ALARMS, ERRORS, Report, read_report
from simulators.ports import PtyPort
from stage.errors import DeviceError
from tests.drivers.grbl_bench import grbl_bench
from tests.grbl_manual import BANNER, SETTINGS

system = pytest.mark.system


@pytest.mark.parametrize(
    ("line", "report"),
    [
        ("<Idle|MPos:0.000,-10.000,5.000|FS:0,0>", Report("Idle", "", (0, -10, 5), 0)),
        (
            "<Hold:1|MPos:1.000,2.000,3.000|Bf:15,128|FS:500,80|WCO:0.000,1.551,5.664>",
            Report("Hold", "1", (1, 2, 3), 80),
        ),
        ("<Run|MPos:0.000,0.000,0.000|F:500|Pn:XYZPDHRS|Ov:100,100,100|A:SFM>", Report("Run", "", (0, 0, 0), 0)),
        ("<Idle|WPos:-2.500,0.000,11.000|FS:0,0>", None),
        ("<Idle|MPos:0.000,-10. 00,5.000|FS:0,0>", None),
        ("<Idle|MPos:0.000,-10.000,5.000|FS:0>", None),
        ("<Idle|MPos:0.000", None),
        ("ok", None),
    ],
)
def test_reports_of_the_manual(line: str, report: Report | None) -> None:
    assert read_report(line) == report


@pytest.mark.parametrize(
    ("state", "moves"),
    [
        ("Idle", False),
        ("Run", True),
        ("Jog", True),
        ("Home", True),
        ("Hold:0", False),
        ("Hold:1", True),
        ("Door:0", False),
        ("Door:1", False),
        ("Door:2", True),
        ("Door:3", True),
        ("Alarm", False),
        ("Check", False),
    ],
)
def test_which_states_mean_that_the_machine_moves(state: str, moves: bool) -> None:
    report = read_report(f"<{state}|MPos:0.000,0.000,0.000|FS:0,0>")
    assert report is not None
    assert report.moves == moves
    assert report.shown == state


def test_what_is_wrong_comes_with_what_to_do() -> None:
    for words, advice in (*ERRORS.values(), *ALARMS.values()):
        assert words
        assert advice
        assert ";" not in words + advice


@system
def test_a_line_that_is_too_long_is_never_sent() -> None:
    with grbl_bench() as bench:
        bench.shared.open(bench)
        assert bench.shared.tell("G0X-200." + "0" * 71)  # 79 characters
        before = bench.board.messages
        with pytest.raises(DeviceError, match=r"is longer than GRBL takes; nothing was sent"):
            bench.shared.tell("G0X-200." + "0" * 72)
        assert bench.board.messages == before
        bench.shared.close(bench)


@system
def test_a_wrong_baudrate_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(grbl_controller, "RESET_S", 0.05)
    with grbl_bench() as bench:
        other = GrblController(bench.port.path, 9600, clock=bench.clock)
        with pytest.raises(
            DeviceError, match=r"no greeting after 8 resets .*check that this is a GRBL controller, .*bau"
        ):
            other.open(bench)
        assert not other.is_open


@system
@pytest.mark.parametrize(
    ("greeting", "words"),
    [
        (b"\r\nGrbl 0.9j ['$' for help]\r\n", r"speaks GRBL 0.9j, not 1.1; update"),
        (b"start\r\necho:Marlin 2.1\r\n", "no greeting after 8 resets"),
    ],
)
def test_another_firmware_is_refused(monkeypatch: pytest.MonkeyPatch, greeting: bytes, words: str) -> None:
    monkeypatch.setattr(grbl_controller, "RESET_S", 0.05)
    with PtyPort(lambda data: greeting if data == b"\x18" else b"") as port:
        controller = GrblController(port.path)
        with pytest.raises(DeviceError, match=words):
            controller.open(controller)


@system
def test_settings_that_are_not_listed_whole_are_asked_for_again_and_missed() -> None:
    def torn(data: bytes) -> bytes:
        answers = {
            b"\x18": BANNER,
            b"$$\n": SETTINGS.replace(b"$30=", b"$3\x10="),
            b"$I\n": b"[OPT:V,15,128]\r\nok\r\n",
        }
        return answers.get(data, b"")

    with PtyPort(torn) as port:
        controller = GrblController(port.path)
        with pytest.raises(DeviceError, match="did not list its settings in 3 tries"):
            controller.open(controller)


@system
def test_a_banner_of_the_start_itself_is_no_brown_out() -> None:
    """An Arduino restarts when its port is opened, and greets by itself some time later."""
    with grbl_bench() as bench:
        bench.shared.open(bench)
        bench.shared.close(bench)
        bench.sim.power_up()
        bench.port.hold_back(1.0)
        bench.shared.open(bench)
        assert not bench.shared.position_known
        assert bench.shared.status().state == "Alarm"
        bench.shared.close(bench)
