"""`make_safe` waits for one exchange at most, and ends whatever else is in progress."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager

import pytest

from simulators.clock import VirtualClock
from stage.clock import SystemClock
from stage.cutoff import Cutoff, CutShortError


def cutoff(clock: VirtualClock | SystemClock | None = None) -> Cutoff:
    return Cutoff(clock or VirtualClock(), lambda: "lamp: cut short")


def begun(pool: ThreadPoolExecutor, act: Callable[[threading.Event], None]) -> Future[None]:
    """A call in another thread, which has come to where it sets its event."""
    there = threading.Event()
    future = pool.submit(act, there)
    assert there.wait(10)
    return future


def test_a_call_that_nobody_stops_goes_through() -> None:
    gate = cutoff()
    with gate.call():
        for _ in range(3):
            with gate.call(), gate.exchange(), gate.exchange():
                gate.check()
        gate.sleep(0.12)
        gate.sleep(0.0)
        gate.sleep(-1.0)
    with gate.stop() as interrupts:
        assert not interrupts
        with gate.call(), gate.exchange():
            gate.sleep(0.1)


def test_sleep_takes_as_long_as_it_is_told() -> None:
    clock = VirtualClock(0.1)
    gate = cutoff(clock)
    for seconds in (0.001, 0.05, 0.1, 1 / 3, 2.7):
        before = clock.now()
        gate.sleep(seconds)
        assert clock.now() - before == pytest.approx(seconds, abs=1e-12)


def test_a_call_is_cut_short_at_its_next_exchange_and_every_later_one() -> None:
    gate, go_on = cutoff(), threading.Event()
    failed = []

    def act(there: threading.Event) -> None:
        with gate.call():
            there.set()
            assert go_on.wait(10)
            for _ in range(2):
                with pytest.raises(CutShortError, match="lamp: cut short"), gate.exchange():
                    failed.append("reached the wire")
            gate.sleep(0.01)

    with ThreadPoolExecutor() as pool:
        future = begun(pool, act)
        with gate.stop() as interrupts:
            assert interrupts
        go_on.set()
        with pytest.raises(CutShortError):
            future.result(10)
    assert not failed
    with gate.call(), gate.exchange():
        pass


def test_a_call_that_begins_while_it_is_made_safe_never_has_the_wire() -> None:
    gate, go_on = cutoff(), threading.Event()

    def act(there: threading.Event) -> None:
        with gate.call():
            there.set()
            assert go_on.wait(10)
            with gate.exchange():
                raise AssertionError("reached the wire")

    with ThreadPoolExecutor() as pool:
        with gate.stop():
            future = begun(pool, act)
        go_on.set()
        with pytest.raises(CutShortError):
            future.result(10)


def test_an_exchange_is_waited_for_and_a_rest_is_not() -> None:
    gate = cutoff(SystemClock())
    done: list[str] = []
    finish = threading.Event()

    def exchanging(there: threading.Event) -> None:
        with gate.call(), gate.exchange():
            there.set()
            assert finish.wait(10)
            done.append("exchange")

    def resting(there: threading.Event) -> None:
        with gate.call():
            there.set()
            gate.sleep(3600)

    with ThreadPoolExecutor() as pool:
        future = begun(pool, resting)
        with gate.stop(), gate.exchange():
            pass
        with pytest.raises(CutShortError):
            future.result(10)
        future = begun(pool, exchanging)
        threading.Timer(0.05, finish.set).start()
        with gate.stop(), gate.exchange():
            done.append("made safe")
        future.result(10)
    assert done == ["exchange", "made safe"]


def test_who_waits_for_the_wire_lets_simulated_time_pass_for_who_has_it() -> None:
    clock = VirtualClock()
    gate = cutoff(clock)

    def exchanging(there: threading.Event, work: AbstractContextManager[None]) -> None:
        with work, gate.call(), gate.exchange():
            there.set()
            clock.sleep(0.1)  # a wire that is silent until its timeout

    with ThreadPoolExecutor() as pool, clock.at_work():
        work = clock.at_work()
        future = begun(pool, lambda there: exchanging(there, work))
        with gate.stop(), gate.exchange():
            assert clock.now() == pytest.approx(0.1)
        future.result(10)


def test_whoever_is_made_safe_by_an_appointment_of_its_own_thread_is_cut_short_too() -> None:
    clock = VirtualClock()
    gate = cutoff(clock)
    seen: list[bool] = []

    def make_safe() -> None:
        with gate.stop() as interrupts, gate.exchange():
            seen.append(interrupts)

    clock.at(0.3, make_safe)
    with pytest.raises(CutShortError), gate.call():
        gate.sleep(1.0)
    assert seen == [False]  # there is nobody else to wait for
    assert clock.now() == pytest.approx(0.3, abs=0.05)
