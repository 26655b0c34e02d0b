"""Axes and lamp of one GRBL controller are made safe by another thread, whatever the first is waiting for."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator

import pytest

from stage.errors import DeviceError
from tests.drivers.grbl_bench import STEP_RAD, GrblBench, grbl_bench

pytestmark = pytest.mark.system


@pytest.fixture
def bench() -> Iterator[GrblBench]:
    with grbl_bench() as made:
        yield made


def from_another_thread(act: Callable[[], None]) -> None:
    thread = threading.Thread(target=act)
    thread.start()
    thread.join(20)
    assert not thread.is_alive()


def test_a_lamp_made_safe_while_axes_on_its_controller_move_stops_them_and_keeps_the_position(bench: GrblBench) -> None:
    axes, lamp = bench.axes(bench.shared), bench.lamp(bench.shared)
    with axes, lamp:
        axes.move_to((0.0, 0.1))
        lamp.set_level(1.0)
        bench.soon(lambda: from_another_thread(lamp.make_safe))
        with pytest.raises(DeviceError, match="the call was cut short to make it safe"):
            axes.move_to((2.0, 1.0))
        assert bench.light == 0
        stood = bench.true_rad
        assert 0.05 < stood[0] < 1.0
        bench.clock.sleep(5.0)
        assert bench.true_rad == stood
        assert axes.positions() == pytest.approx(stood, abs=STEP_RAD)  # and not homed anew
        assert lamp.set_level(0.5) == (128 / 255,)
        assert axes.move_to((0.0, 0.1)).positions == pytest.approx((0.0, 0.1), abs=STEP_RAD)


def test_homing_is_cut_short_by_a_reset_and_begun_anew_by_the_next_call() -> None:
    with grbl_bench(homed=False) as bench:
        axes = bench.axes()
        bench.soon(lambda: from_another_thread(axes.make_safe), 0.6)
        with pytest.raises(DeviceError, match="cut short"):
            axes.open()
        stood = bench.true_rad
        bench.clock.sleep(5.0)
        assert bench.true_rad == stood
        with axes:
            assert axes.move_to((0.1, 0.1)).positions == pytest.approx((0.1, 0.1), abs=STEP_RAD)
            assert bench.true_rad == pytest.approx((0.1, 0.1), abs=STEP_RAD)


def test_the_order_to_hold_does_not_wait_for_an_answer_that_is_owed_to_another_thread(bench: GrblBench) -> None:
    heard: dict[bytes, float] = {}
    asked = threading.Event()
    feed = bench.sim.feed

    def listen(data: bytes) -> bytes:
        heard.setdefault(data[:3], time.monotonic())
        if data.startswith(b"G21"):
            asked.set()
        return feed(data)

    bench.port._feed = listen
    errors: list[DeviceError] = []
    with bench.axes() as axes:

        def move() -> None:
            with pytest.raises(DeviceError, match="cut short") as failure:
                axes.move_to((2.0, 1.0))
            errors.append(failure.value)

        bench.board.strike("swallowed-ok")
        mover = threading.Thread(target=move)
        mover.start()
        assert asked.wait(10)
        time.sleep(0.02)
        axes.make_safe()
        mover.join(10)
        assert errors
        assert heard[b"!"] - heard[b"G21"] < 0.25  # the answer is waited for 0.3 s
        assert bench.true_rad[0] < 1.0
