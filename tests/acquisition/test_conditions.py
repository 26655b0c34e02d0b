"""Interlocks: a condition says no, or cannot be asked, and the session must not go on."""

from __future__ import annotations

import os
import signal
import stat
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
import yaml

from acquisition.commands import GIVEN_BYTES, CommandError, run_command
from acquisition.conditions import CommandCondition, TemperatureCondition, conditions_of
from simulators.clock import VirtualClock
from stage.devices import Thermometer
from stage.errors import DeviceError, InputError
from stage.rig import CommandInterlock, Rig, TemperatureInterlock, rig_from_mapping
from tests.acquisition.fake_stage import make_rig
from tests.drivers.servo_bench import servo_bench

Script = Callable[..., Path]


@pytest.fixture
def script(tmp_path: Path) -> Script:
    """Write an executable shell script."""

    def write(*lines: str, name: str = "look") -> Path:
        path = tmp_path / name
        path.write_text("#!/bin/sh\n" + "\n".join(lines) + "\n")
        path.chmod(path.stat().st_mode | stat.S_IXUSR)
        return path

    return write


def looks(tmp_path: Path, *command: str, clock: Any = None, **options: Any) -> CommandCondition:
    interlock = CommandInterlock(kind="command", name="door", run=command, **options)
    return CommandCondition(interlock, tmp_path, clock or VirtualClock())


class Oven:
    """Something that is as hot as it is told to be."""

    def __init__(self, **temperatures: float) -> None:
        self.temperatures: dict[str, float] = temperatures
        self.asked = 0
        self.silent = False

    def temperatures_c(self) -> dict[str, float]:
        self.asked += 1
        if self.silent:
            raise DeviceError("oven on COM3: no status packet; check power and cable")
        return self.temperatures


def watches(oven: Oven, clock: Any = None, **options: Any) -> TemperatureCondition:
    interlock = TemperatureInterlock(kind="temperature", limit_c=60, resume_c=50, **options)
    return TemperatureCondition(interlock, [oven], clock or VirtualClock())


def rig_with(*interlocks: dict[str, Any]) -> Rig:
    return Rig.model_validate(make_rig().to_json() | {"interlocks": list(interlocks)})


# Commands


def test_a_command_that_succeeds_lets_the_session_go_on_whatever_it_prints(tmp_path, script):
    script("echo all is well")
    assert looks(tmp_path, "./look").reason() is None


@pytest.mark.parametrize(
    ("lines", "says"),
    [
        (("echo; echo '  the door  is open '; echo more", "exit 1"), "the door is open"),
        (("echo the window is open >&2", "exit 3"), "the window is open"),
        (("exit 3",), "the command ./look ended with exit status 3"),
        (("kill -9 $$",), "the command ./look was killed by signal 9"),
        (("printf '\\033[31mred\\007'; exit 1",), "[31mred"),
    ],
)
def test_the_first_line_of_a_command_that_says_no_is_the_reason(tmp_path, script, lines, says):
    script(*lines)
    assert looks(tmp_path, "./look").reason() == says


def test_a_command_that_is_not_there_or_may_not_be_run_suspends(tmp_path, script):
    assert looks(tmp_path, "./gone").reason() == "the command ./gone cannot be run (No such file or directory)"
    script("exit 0").chmod(0o600)
    assert looks(tmp_path, "./look").reason() == "the command ./look cannot be run (Permission denied)"
    assert "cannot be run" in (looks(tmp_path / "nowhere", "true").reason() or "")


@pytest.mark.system
def test_a_command_that_hangs_is_killed_with_its_children(tmp_path, script):
    script("sleep 300 &", "echo $! > child", "wait")
    begun = time.monotonic()
    says = looks(tmp_path, "./look", timeout_s=0.3).reason()
    assert says == "the command ./look did not end within 0.3 s"
    assert time.monotonic() - begun < 5
    child = int((tmp_path / "child").read_text())
    deadline = time.monotonic() + 5
    while time.monotonic() < deadline and runs(child):
        time.sleep(0.01)
    assert not runs(child)


def runs(process: int) -> bool:
    """Whether a process is there and not merely waiting to be reaped."""
    with suppress(OSError):
        return "\nState:\tZ" not in Path(f"/proc/{process}/status").read_text()
    return False


@pytest.mark.system
def test_a_command_that_floods_its_output_takes_no_memory_and_no_time_beyond_its_own(tmp_path):
    assert looks(tmp_path, "sh", "-c", "yes | head -c 20000000; exit 1", timeout_s=20).reason() == "y"
    with pytest.raises(CommandError, match="did not end within"):
        run_command(["yes"], timeout_s=0.2)


@pytest.mark.system
def test_what_a_command_leaves_running_keeps_nobody_waiting(tmp_path, script):
    script("sleep 300 &", "echo $! > child", "echo no", "exit 1")
    begun = time.monotonic()
    assert looks(tmp_path, "./look", timeout_s=20).reason() == "no"
    assert time.monotonic() - begun < 10
    os.kill(int((tmp_path / "child").read_text()), signal.SIGKILL)


@pytest.mark.system
def test_a_command_that_does_not_read_what_it_is_given_keeps_nobody_waiting():
    assert run_command(["true"], timeout_s=10, given=b"x" * GIVEN_BYTES).code == 0
    assert run_command(["wc", "-c"], timeout_s=10, given=b"x" * GIVEN_BYTES).line == str(GIVEN_BYTES)
    with pytest.raises(ValueError, match="at most"):
        run_command(["true"], timeout_s=10, given=b"x" * (GIVEN_BYTES + 1))


@pytest.mark.system
def test_somebody_who_gives_up_need_not_wait_for_a_command():
    begun, enough = time.monotonic(), threading.Event()
    threading.Timer(0.2, enough.set).start()
    with pytest.raises(CommandError):
        run_command(["sleep", "300"], timeout_s=300, give_up=enough.is_set)
    assert time.monotonic() - begun < 10


def test_a_command_runs_beside_the_rigs_description_wherever_the_session_was_started(tmp_path, script, monkeypatch):
    (tmp_path / "rig").mkdir()
    (tmp_path / "rig" / "closed").touch()
    script("test -e closed", name="rig/door")
    monkeypatch.chdir(tmp_path)
    condition = looks(Path("rig"), "./door")
    monkeypatch.chdir("/")
    assert condition.reason() is None


def test_an_answer_is_kept_for_as_long_as_the_interlock_says(tmp_path, script):
    clock = VirtualClock()
    script("echo x >> asked", "test -e closed")
    condition = looks(tmp_path, "./look", clock=clock, every_s=1.0)
    assert condition.reason() is not None
    (tmp_path / "closed").touch()
    assert condition.reason() is not None
    clock.sleep(1.0)
    assert condition.reason() is None
    clock.sleep(0.5)
    assert condition.reason() is None
    assert (tmp_path / "asked").read_text() == "x\nx\n"


# Temperature


def test_what_got_too_hot_cools_down_before_the_session_goes_on():
    clock, oven = VirtualClock(), Oven(pan=20, tilt=59.9)
    condition = watches(oven, clock, every_s=1.0)
    said = []
    for tilt in (59.9, 60, 55, 50.1, 50, 55, 59.9, 61, 49):
        oven.temperatures["tilt"] = tilt
        said.append(condition.reason() is None)
        clock.sleep(1.0)
    assert said == [True, False, False, False, True, True, True, False, True]


def test_the_hottest_part_is_named():
    assert watches(Oven(pan=61, tilt=75)).reason() == "tilt has 75 degrees C (limit 60); goes on at 50"


def test_a_temperature_that_nobody_tells_suspends_until_somebody_does():
    clock, oven = VirtualClock(), Oven(pan=20)
    condition = watches(oven, clock)
    oven.silent = True
    assert condition.reason() == (
        "the temperature cannot be read (oven on COM3: no status packet; check power and cable)"
    )
    oven.silent = False
    assert condition.reason() is not None  # the answer is still young
    clock.sleep(5.0)
    assert condition.reason() is None
    assert oven.asked == 2
    assert watches(Oven()).reason() == "no part tells its temperature"


def test_a_bus_that_fell_silent_does_not_make_a_hot_part_cold():
    clock, oven = VirtualClock(), Oven(pan=70)
    condition = watches(oven, clock, every_s=1.0)
    assert condition.reason() is not None
    oven.silent = True
    clock.sleep(1.0)
    assert "cannot be read" in (condition.reason() or "")
    oven.silent, oven.temperatures["pan"] = False, 55
    clock.sleep(1.0)
    assert condition.reason() is not None


@pytest.mark.system
def test_servos_tell_their_temperature():
    with servo_bench() as bench, bench.arm() as arm:
        assert isinstance(arm, Thermometer)
        bench.servos[1].memory["temperature"] = 63
        assert arm.temperatures_c() == {"servo 1": 32.0, "servo 2": 63.0}
        assert watches(arm).reason() == "servo 2 has 63 degrees C (limit 60); goes on at 50"


@pytest.mark.system
def test_an_answer_during_which_time_passes_is_not_taken_for_an_old_one():
    with servo_bench() as bench, bench.arm() as arm:
        bench.bus.board.offer("delay", lambda: bench.clock.sleep(1.0))
        bench.bus.board.strike_at(bench.bus.board.messages + 1, "delay")
        assert arm.temperatures_c() == arm.temperatures_c()


# From the rig


def test_conditions_of_a_rig_are_in_its_order_and_carry_their_names(tmp_path):
    rig = rig_with(
        {"kind": "command", "name": "door", "run": ["true"]},
        {"kind": "temperature", "limit_c": 60, "resume_c": 50},
    )
    found = conditions_of(rig, [Oven(pan=30)], tmp_path, VirtualClock())
    assert [condition.name for condition in found] == ["door", "temperature"]
    assert [condition.reason() for condition in found] == [None, None]
    assert conditions_of(make_rig(), [], tmp_path, VirtualClock()) == ()


def test_a_temperature_that_no_device_tells_is_refused(tmp_path):
    rig = rig_with({"kind": "temperature", "limit_c": 60, "resume_c": 50})
    with pytest.raises(InputError, match=r"rig: interlocks\[0\]\.kind: no device of this rig tells its temperature"):
        conditions_of(rig, [object()], tmp_path, VirtualClock())


@pytest.mark.parametrize(
    ("interlocks", "says"),
    [
        ("[{kind: window}]", "interlocks[0].kind: expected one of command, temperature, got 'window'"),
        ("[{name: door, run: [look]}]", "interlocks[0].kind: is required and missing"),
        ("[{kind: command, run: [look]}]", "interlocks[0].name: is required and missing"),
        ("[{kind: command, name: door, run: []}]", "interlocks[0].run: "),
        ("[{kind: command, name: door, run: look}]", "interlocks[0].run: "),
        ("[{kind: command, name: door, run: ['']}]", "interlocks[0].run: expected a command"),
        ("[{kind: command, name: door, run: [a], timeout_s: 0}]", "interlocks[0].timeout_s: "),
        ("[{kind: command, name: door, run: [a], every_s: .nan}]", "interlocks[0].every_s: NaN"),
        ("[{kind: command, name: door, run: [a], shell: yes}]", "interlocks[0].shell: unknown key"),
        ("[{kind: temperature, limit_c: 60}]", "interlocks[0].resume_c: is required and missing"),
        ("[{kind: temperature, limit_c: 60, resume_c: 60}]", "interlocks[0].resume_c: expected less than limit_c, 60"),
        (
            "[{kind: command, name: door, run: [a]}, {kind: command, name: door, run: [b]}]",
            "interlocks: each needs a name of its own, got ['door', 'door']",
        ),
    ],
)
def test_a_bad_interlock_is_refused_by_field(interlocks, says):
    with pytest.raises(InputError) as refusal:
        rig_from_mapping(make_rig().to_json() | {"interlocks": yaml.safe_load(interlocks)}, "rig.yaml")
    assert str(refusal.value).startswith(f"rig.yaml: {says}")
