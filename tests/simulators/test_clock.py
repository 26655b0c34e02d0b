"""Virtual time: work side by side takes as long as the longest, and a rest is no work."""

from __future__ import annotations

import threading

import pytest

from simulators.clock import VirtualClock


def test_time_passes_only_when_somebody_waits() -> None:
    clock = VirtualClock(5.0)
    assert clock.now() == 5.0
    clock.sleep(2.0)
    clock.sleep(-1.0)
    assert clock.now() == 7.0


def test_appointments_are_kept_on_the_way_also_by_who_makes_new_ones() -> None:
    clock, kept = VirtualClock(), list[float]()

    def again() -> None:
        kept.append(clock.now())
        if len(kept) < 3:
            clock.at(clock.now() + 1.0, again)

    clock.at(0.5, again)
    clock.sleep(10.0)
    assert kept == [0.5, 1.5, 2.5]
    assert clock.now() == 10.0


def test_work_side_by_side_takes_as_long_as_the_longest() -> None:
    clock, told = VirtualClock(), dict[str, float]()

    def work(name: str, naps: int, nap_s: float) -> None:
        with works[name]:
            for _ in range(naps):
                clock.sleep(nap_s)
            told[name] = clock.now()

    with clock.at_work():
        works = {name: clock.at_work() for name in ("quick", "slow")}
        threads = [
            threading.Thread(target=work, args=("quick", 20, 0.05)),
            threading.Thread(target=work, args=("slow", 1, 3.0)),
        ]
        for thread in threads:
            thread.start()
        clock.sleep(2.0)
        told["here"] = clock.now()
        with clock.resting():
            for thread in threads:
                thread.join()
        assert clock.now() == 3.0
    assert told == pytest.approx({"quick": 1.0, "here": 2.0, "slow": 3.0})


def test_a_piece_of_work_within_another_counts_once() -> None:
    clock = VirtualClock()
    with clock.at_work(), clock.at_work():
        clock.sleep(1.0)
        with clock.resting():
            clock.sleep(1.0)
        clock.sleep(1.0)
    clock.sleep(1.0)
    assert clock.now() == 4.0


def test_somebody_at_work_who_does_not_wait_holds_the_time() -> None:
    clock = VirtualClock()
    busy, woken = clock.at_work(), threading.Event()

    def sleep() -> None:
        with clock.at_work():
            clock.sleep(1.0)
        woken.set()

    with busy:
        sleeper = threading.Thread(target=sleep)
        sleeper.start()
        assert not woken.wait(0.05)
        assert clock.now() == 0.0
    sleeper.join()
    assert clock.now() == 1.0
