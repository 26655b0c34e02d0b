"""Lanes: in order, bounded, and side by side in virtual time."""

from __future__ import annotations

import threading

import pytest

from acquisition.session.lanes import Lane
from simulators.clock import VirtualClock
from stage.clock import SystemClock


def test_jobs_are_done_in_order_and_all_before_the_end() -> None:
    lane, done = Lane("test", SystemClock(), room=3), list[int]()
    for i in range(50):
        lane.submit(lambda i=i: done.append(i))  # type: ignore[misc]
    lane.close()
    lane.close()
    assert done == list(range(50))


def test_a_full_lane_holds_up_who_submits() -> None:
    lane, gate, submitted = Lane("test", SystemClock(), room=2), threading.Event(), list[int]()

    def feed() -> None:
        for i in range(4):
            lane.submit(gate.wait)
            submitted.append(i)

    feeder = threading.Thread(target=feed)
    feeder.start()
    while lane.load < 2:
        pass
    assert len(submitted) <= 2
    gate.set()
    feeder.join()
    lane.wait_until()
    assert (lane.load, submitted) == (0, [0, 1, 2, 3])
    lane.close()


def test_two_lanes_take_as_long_as_the_longer() -> None:
    clock = VirtualClock()
    one, other = Lane("one", clock, 8), Lane("other", clock, 8)
    with clock.at_work():
        for _ in range(5):
            one.submit(lambda: clock.sleep(1.0))
            other.submit(lambda: clock.sleep(0.7))
        clock.sleep(2.5)
        assert clock.now() == 2.5
        one.wait_until()
        assert clock.now() == pytest.approx(5.0)
        other.wait_until()
        one.close()
        other.close()
    clock.sleep(1.0)
    assert clock.now() == pytest.approx(6.0)
