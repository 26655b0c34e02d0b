from __future__ import annotations

import threading

import pytest

from simulators.clock import RunningClock, VirtualClock
from simulators.fault_script import plan_faults, read_script
from simulators.faults import FaultBoard
from stage.errors import InputError


class Log:
    """A device with one fault that takes an option."""

    def __init__(self) -> None:
        self.struck: list[int] = []
        self.board = FaultBoard()
        self.board.offer("bang", self.bang)

    def bang(self, times: int = 1) -> None:
        self.struck.append(times)


SCRIPT = """
{"device": "light", "fault": "bang", "at_message": 3, "times": 7}

{"device": "light", "fault": "bang", "at_s": 2.5}
{"device": "light", "fault": "bang", "times": 2}
"""


def test_faults_strike_at_once_at_a_message_and_at_a_time() -> None:
    light, clock = Log(), VirtualClock()
    plan_faults(read_script(SCRIPT.splitlines(), "f"), {"light": light.board}, clock)
    assert light.struck == [2]
    light.board.message()
    light.board.message()
    assert light.struck == [2]
    light.board.message()
    assert light.struck == [2, 7]
    clock.sleep(2.4)
    assert light.struck == [2, 7]
    clock.sleep(0.2)
    assert light.struck == [2, 7, 1]


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("{", "f: line 1: is not JSON"),
        ("[]", "f: line 1: expected an object"),
        ('{"device": "light"}', "f: line 1: fault: is required"),
        ('{"device": "light", "fault": "bang", "at_s": -1}', "f: line 1: at_s: "),
        ('{"device": "light", "fault": "bang", "at_s": 1, "at_message": 1}', "f: line 1: at_message: give a time"),
        ('{"device": "oven", "fault": "bang"}', "faults: device: expected one of light, got 'oven'"),
        ('{"device": "light", "fault": "boom"}', "faults: light: fault: expected one of bang, got 'boom'"),
        ('{"device": "light", "fault": "bang", "loud": true}', "faults: light: options: "),
    ],
)
def test_a_bad_line_is_refused_in_one_sentence_and_nothing_strikes(line: str, words: str) -> None:
    light = Log()
    good = '{"device": "light", "fault": "bang"}'
    with pytest.raises(InputError) as refusal:
        plan_faults([*read_script([line], "f"), *read_script([good], "f")], {"light": light.board}, VirtualClock())
    assert str(refusal.value).startswith(words)
    assert "\n" not in str(refusal.value)
    assert light.struck == []


def test_appointments_are_kept_in_order_with_the_clock_at_their_time() -> None:
    clock, seen = VirtualClock(), list[tuple[str, float]]()
    clock.at(3.0, lambda: seen.append(("late", clock.now())))
    clock.at(1.0, lambda: seen.append(("early", clock.now())))
    clock.at(1.0, lambda: clock.at(2.0, lambda: seen.append(("made on the way", clock.now()))))
    clock.sleep(5.0)
    assert seen == [("early", 1.0), ("made on the way", 2.0), ("late", 3.0)]
    assert clock.now() == 5.0


def test_an_appointment_beyond_all_time_keeps_a_running_clock_from_no_other() -> None:
    clock, kept = RunningClock(), threading.Event()
    clock.at(1e300, lambda: None)
    clock.at(clock.now() + 0.01, kept.set)
    assert kept.wait(5.0)
    clock.close()


def test_a_running_clock_keeps_appointments_and_forgets_them_when_closed() -> None:

    clock, kept = RunningClock(), threading.Event()
    try:
        clock.at(clock.now() + 0.01, kept.set)
        assert kept.wait(5)
        never = threading.Event()
        clock.at(clock.now() + 1000, never.set)
    finally:
        clock.close()
        clock.close()
    assert not never.is_set()
