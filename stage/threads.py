"""Blocks of rows or rays on all cores, for work that lets go of Python's interpreter lock.

Compiled kernels (numba with ``nogil``) and Embree's queries do. Plain threads are preferred to numba's own parallel
loops here: those may not be entered from two threads at once, which a service does, and take several times as long to
compile.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

_BLOCKS_PER_CORE = 4
"""More blocks than cores, so that a core that finishes early finds more to do."""


_thread = threading.local()


def cores() -> int:
    """Cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def in_blocks(work: Callable[[int, int], object], count: int, least: int = 1) -> None:
    """Call ``work(start, stop)`` for blocks that cover ``range(count)``, several at a time.

    A call from within `work` is done by its own thread, for the cores are already busy.

    Parameters
    ----------
    work : callable
        Fills its own block of an output; the blocks do not overlap. What it raises is raised here.
    count : int
        Items in all, >= 0.
    least : int
        Smallest block worth a thread; a `count` up to it is done by the caller's own thread.
    """
    workers = cores()
    size = max(least, -(-count // (workers * _BLOCKS_PER_CORE)))
    if workers == 1 or count <= size or getattr(_thread, "busy", False):
        if count:
            work(0, count)
        return
    starts = range(0, count, size)
    with ThreadPoolExecutor(min(workers, len(starts)), initializer=_mark_busy) as pool:
        for future in [pool.submit(work, start, min(start + size, count)) for start in starts]:
            future.result()


def _mark_busy() -> None:
    _thread.busy = True
