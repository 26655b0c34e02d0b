"""What the guard lets through never has more than three flashes in any second, whoever asks for what and when."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass

import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulators.clock import VirtualClock
from stage.devices import Lamp, OpenedByWith
from stage.errors import DeviceError
from stage.flashing import FlashGuard

TENTH = 0.1


@dataclass(frozen=True)
class Shown:
    """Levels, and the times between which they appeared."""

    begun_s: float
    ended_s: float
    levels: tuple[float, ...]


class RecordingLamp(OpenedByWith):
    """Takes some time for what it does, and fails when it is told to, after it has gone dark."""

    name = "lamp"

    def __init__(self, clock: VirtualClock, emitters: int = 1) -> None:
        self.clock, self.emitters = clock, emitters
        self.takes_s, self.fails = 0.0, False
        self.shown = [Shown(-math.inf, -math.inf, (0.0,) * emitters)]
        self.calls: list[str] = []

    def open(self) -> None:
        self.calls.append("open")

    def close(self) -> None:
        self.calls.append("close")

    def make_safe(self) -> None:
        self.calls.append("make_safe")
        self.show((0.0,) * self.emitters)

    def dark(self) -> None:
        self.show((0.0,) * self.emitters)

    def set_level(self, level: float) -> tuple[float, ...]:
        return self.set_levels((level,) * self.emitters)

    def set_levels(self, levels: Sequence[float]) -> tuple[float, ...]:
        if self.fails:
            self.show((0.0,) * self.emitters)
            raise DeviceError("lamp: went dark; check it")
        self.show(tuple(levels))
        return tuple(levels)

    def show(self, levels: tuple[float, ...]) -> None:
        begun_s = self.clock.now()
        self.clock.sleep(self.takes_s)
        self.shown.append(Shown(begun_s, self.clock.now(), levels))


def most_flashes_in_a_second(shown: Sequence[Shown]) -> int:
    """Most disjoint rises by a tenth, of an emitter or the sum, that some second may hold.

    By definition rather than by the guard's bookkeeping: pairs of states i < j with the later one a tenth above, that
    do not overlap, from the one that ends first to the next (which finds the most there can be).
    """
    states = [(*one.levels, sum(one.levels)) for one in shown]
    most = 0
    for first in range(1, len(shown)):
        count, begin = 0, first - 1
        for j in range(first, len(shown)):
            if shown[j].begun_s - shown[first].ended_s > 1.0 - 1e-9:
                break
            if any(b - a >= TENTH - 1e-9 for i in range(begin, j) for a, b in zip(states[i], states[j], strict=True)):
                count, begin = count + 1, j
        most = max(most, count)
    return most


LEVELS = st.integers(0, 20).map(lambda steps: steps / 20)
PAUSES_S = st.sampled_from([0.0, 0.01, 0.1, 0.2, 0.25, 1 / 3, 0.5, 0.7])


@st.composite
def wishes(draw: st.DrawFn) -> tuple[int, list[tuple[str, float, float, tuple[float, ...]]]]:
    emitters = draw(st.integers(1, 3))
    levels = st.tuples(*[LEVELS | st.sampled_from([0.0, 1.0])] * emitters)
    acts = st.sampled_from(["set"] * 8 + ["dark", "make_safe", "fail", "reopen"])
    return emitters, draw(st.lists(st.tuples(acts, PAUSES_S, st.sampled_from([0.0, 0.05]), levels), max_size=40))


@given(wishes())
def test_no_second_has_more_than_three_flashes(
    wish: tuple[int, list[tuple[str, float, float, tuple[float, ...]]]],
) -> None:
    emitters, acts = wish
    clock = VirtualClock()
    lamp = RecordingLamp(clock, emitters)
    guard = FlashGuard(lamp, clock)
    for act, pause_s, lamp.takes_s, levels in acts:
        clock.sleep(pause_s)
        lamp.fails = act == "fail"
        match act:
            case "dark":
                guard.dark()
            case "make_safe":
                guard.make_safe()
            case "reopen":
                guard.make_safe()
                guard.close()
                guard.open()
            case _:
                with suppress(DeviceError):
                    guard.set_levels(levels)
    assert most_flashes_in_a_second(lamp.shown) <= 3


@given(st.lists(st.tuples(PAUSES_S, LEVELS), max_size=30))
def test_who_waits_as_long_as_he_is_told_is_never_refused(wish: list[tuple[float, float]]) -> None:
    clock = VirtualClock(start_s=12345.678)
    guard = FlashGuard(RecordingLamp(clock), clock)
    for pause_s, level in wish:
        clock.sleep(pause_s)
        clock.sleep(guard.pause_s())
        assert guard.pause_s() == 0.0
        guard.set_level(level)
        guard.dark()


@pytest.mark.parametrize("rate_hz", [3.5, 10, 30, 31, 60, 1000])
def test_flashing_is_refused_at_the_fourth_flash_at_any_rate(rate_hz: float) -> None:
    clock = VirtualClock()
    lamp = RecordingLamp(clock)
    guard = FlashGuard(lamp, clock)
    for _ in range(3):
        guard.set_level(1.0)
        clock.sleep(0.5 / rate_hz)
        guard.dark()
        clock.sleep(0.5 / rate_hz)
    with pytest.raises(DeviceError, match=r"flash number 4 within a second.*; wait 0\.\d{3} s, or write"):
        guard.set_level(1.0)
    assert lamp.shown[-1].levels == (0.0,)
    clock.sleep(guard.pause_s())
    assert guard.set_level(1.0) == (1.0,)


def test_three_flashes_in_a_second_go_on_for_ever() -> None:
    clock = VirtualClock()
    guard = FlashGuard(RecordingLamp(clock), clock)
    for _ in range(30):
        assert guard.set_level(1.0) == (1.0,)
        guard.dark()
        clock.sleep(0.334)


def test_light_that_moves_over_a_dome_flashes() -> None:
    clock = VirtualClock()
    guard = FlashGuard(RecordingLamp(clock, emitters=5), clock)
    for lit in range(3):
        guard.set_levels([float(emitter == lit) for emitter in range(5)])
    with pytest.raises(DeviceError, match="flash number 4"):
        guard.set_levels([0, 0, 0, 1, 0])


def test_many_small_rises_at_once_are_one_flash_and_one_small_rise_is_none() -> None:
    clock = VirtualClock()
    guard = FlashGuard(RecordingLamp(clock, emitters=100), clock)
    for _ in range(10):
        guard.set_levels([0.05, *[0.0] * 99])
        guard.dark()
    for _ in range(3):
        guard.set_level(0.05)
        guard.dark()
    with pytest.raises(DeviceError, match="flash number 4"):
        guard.set_level(0.05)


def test_flicker_of_light_that_never_goes_out_is_flashing_too() -> None:
    clock = VirtualClock()
    guard = FlashGuard(RecordingLamp(clock), clock)
    for _ in range(3):
        guard.set_level(1.0)
        guard.set_level(0.8)
    with pytest.raises(DeviceError, match="flash number 4"):
        guard.set_level(1.0)


def test_a_fade_counts_once_for_every_tenth_however_fine_its_steps() -> None:
    clock = VirtualClock()
    guard = FlashGuard(RecordingLamp(clock), clock)
    for step in range(40):
        guard.set_level(step / 100)
    with pytest.raises(DeviceError, match="flash number 4"):
        guard.set_level(0.4)


def test_light_that_somebody_switched_off_while_it_came_on_is_dark() -> None:
    clock = VirtualClock()
    lamp = RecordingLamp(clock)
    lamp.takes_s = 0.01
    guard = FlashGuard(lamp, clock)
    for _ in range(3):
        clock.at(clock.now() + 0.005, guard.dark)
        guard.set_level(1.0)
    with pytest.raises(DeviceError, match="flash number 4"):
        guard.set_level(1.0)


def test_what_the_rig_allows_is_not_refused() -> None:
    clock = VirtualClock()
    guard = FlashGuard(RecordingLamp(clock), clock, allowed=True)
    for _ in range(20):
        guard.set_level(1.0)
        guard.dark()
        assert guard.pause_s() == 0.0


def test_the_guard_is_a_lamp_and_passes_everything_on() -> None:
    clock = VirtualClock()
    lamp = RecordingLamp(clock, emitters=2)
    guard = FlashGuard(lamp, clock)
    assert isinstance(guard, Lamp)
    assert (guard.name, guard.emitters) == ("lamp", 2)
    with guard:
        assert guard.set_levels((0.25, 0.5)) == (0.25, 0.5)
    assert lamp.calls == ["open", "make_safe", "close"]
    assert lamp.shown[-1].levels == (0.0, 0.0)


class HeldLamp(RecordingLamp):
    """Does not know of `make_safe` in other threads, and calls somebody on the way into a call."""

    before: Callable[[], None] = staticmethod(lambda: None)

    def set_levels(self, levels: Sequence[float]) -> tuple[float, ...]:
        self.before()
        return super().set_levels(levels)


@pytest.fixture
def held() -> HeldLamp:
    return HeldLamp(VirtualClock())


def in_a_thread(act: Callable[[], object]) -> tuple[threading.Thread, list[DeviceError]]:
    """Have a thread act, and keep its errors."""
    errors: list[DeviceError] = []

    def run() -> None:
        try:
            act()
        except DeviceError as error:
            errors.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    return thread, errors


def test_a_call_that_reaches_the_lamp_after_it_was_made_safe_is_undone_before_that_returns(held: HeldLamp) -> None:
    on_its_way, go_on = threading.Event(), threading.Event()
    guard = FlashGuard(held, held.clock)

    def before() -> None:
        on_its_way.set()
        assert go_on.wait(10)

    held.before = before
    setter, errors = in_a_thread(lambda: guard.set_level(1.0))
    assert on_its_way.wait(10)
    safe, none = in_a_thread(guard.make_safe)
    while held.calls.count("make_safe") < 3:  # it does not wait for that call, and keeps the lamp dark
        threading.Event().wait(0.001)
    assert safe.is_alive()
    go_on.set()
    safe.join(10)
    setter.join(10)
    assert not none
    assert "lamp: it was made safe meanwhile" in str(errors[0])
    assert held.shown[-1].levels == (0.0,)
    assert (1.0,) in [shown.levels for shown in held.shown]  # a moment too late it was, which is a flash
    held.before = lambda: None
    for _ in range(2):
        guard.set_level(1.0)
        guard.dark()
    with pytest.raises(DeviceError, match="flash number 4"):
        guard.set_level(1.0)


def test_calls_that_wait_for_another_or_begin_while_it_is_made_safe_do_not_reach_the_lamp(held: HeldLamp) -> None:
    guard = FlashGuard(held, held.clock)
    on_its_way, go_on = threading.Event(), threading.Event()

    def before() -> None:
        on_its_way.set()
        assert go_on.wait(10)

    held.before = before
    first, first_errors = in_a_thread(lambda: guard.set_level(1.0))
    assert on_its_way.wait(10)
    second, second_errors = in_a_thread(lambda: guard.set_level(0.5))
    safe, _ = in_a_thread(guard.make_safe)
    while "make_safe" not in held.calls:
        threading.Event().wait(0.001)
    third, third_errors = in_a_thread(lambda: guard.set_level(0.25))
    for thread in (second, third):
        thread.join(10)
    go_on.set()
    for thread in (first, safe):
        thread.join(10)
    assert [len(errors) for errors in (first_errors, second_errors, third_errors)] == [1, 1, 1]
    assert not {(0.5,), (0.25,)} & {shown.levels for shown in held.shown}
    held.before = lambda: None
    assert guard.set_level(0.25) == (0.25,)  # until somebody wants light again
