from __future__ import annotations

import threading

import numpy as np
import pytest

from stage.threads import cores, in_blocks


@pytest.mark.parametrize(("count", "least"), [(0, 1), (1, 1), (7, 1), (1000, 1), (1000, 999), (1000, 5000)])
def test_blocks_cover_every_item_once(count: int, least: int) -> None:
    seen = np.zeros(count, dtype=int)

    def work(start: int, stop: int) -> None:
        assert 0 <= start < stop <= count
        seen[start:stop] += 1

    in_blocks(work, count, least)
    assert (seen == 1).all()


def test_little_work_stays_in_the_callers_thread() -> None:
    names: list[str] = []
    in_blocks(lambda _start, _stop: names.append(threading.current_thread().name), 10, 10)
    assert names == [threading.current_thread().name]


def test_an_error_in_a_block_reaches_the_caller() -> None:
    def work(start: int, _stop: int) -> None:
        if start > 0:
            raise ArithmeticError("block")
        if cores() == 1:
            raise ArithmeticError("one block only")

    with pytest.raises(ArithmeticError):
        in_blocks(work, 100)


def test_work_within_a_block_stays_in_the_blocks_thread() -> None:
    strangers: list[str] = []

    def outer(_start: int, _stop: int) -> None:
        mine = threading.current_thread().name

        def inner(_first: int, _last: int) -> None:
            if threading.current_thread().name != mine:
                strangers.append(mine)

        in_blocks(inner, 1000)

    if cores() == 1:
        pytest.skip("one core: there are no other threads")
    in_blocks(outer, 1000)
    assert strangers == []
