"""Blocks of rows of many photographs at once, within a bound on memory."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquisition.dataset.images import Stored
from acquisition.dataset.spool import Spool

Read = Callable[[int], Stored]
Linear = Callable[[int, Stored, NDArray[np.float32]], None]
Valid = Callable[[int, Stored], NDArray[np.bool_]]

_BYTES_PER_SAMPLE = 3 * 4 + 1  # three float32 channels and one flag
MOST_WORKERS = 8
"""Threads that decode; a picture of a large camera takes 150 MB, so that they also bound the memory."""


@dataclass(frozen=True, eq=False)
class Tile:
    """Some rows of some frames.

    Attributes
    ----------
    rows : slice
        Rows of the picture that the tile covers.
    images : (frames, rows, width, 3) float32
        Linear radiance.
    valid : (frames, rows, width) bool
        False where a channel is clipped.
    """

    rows: slice
    images: NDArray[np.float32]
    valid: NDArray[np.bool_]


def iterate_tiles(
    read: Read, linear: Linear, valid: Valid, frames: Sequence[int], size: tuple[int, int], max_bytes: int
) -> Iterator[Tile]:
    """Yield tiles of at most `max_bytes` (at least one row each), decoding every frame once.

    Parameters
    ----------
    read : callable
        Frame index to stored samples.
    linear : callable
        Takes frame index, stored samples (h, width[, 3]) and the array (h, width, 3) to put the radiance into.
    valid : callable
        Frame index and stored samples to the flags (h, width) of unclipped pixels.
    frames : sequence of int
        Frame indices; one that comes twice is decoded twice.
    size : (height, width)
        Pixels of every frame.
    max_bytes : int
        Bound of a tile's arrays. Beside them live, while files are decoded, a few pictures as stored.
    """
    height, width = size
    per_row = max(len(frames) * width * _BYTES_PER_SAMPLE, 1)
    rows = max(min(max_bytes // per_row, height), 1)
    with Spool() as spool:
        whole = decoded(read, frames)
        if rows < height:
            for samples in whole:
                spool.append(samples)
        for start in range(0, height, rows):
            block = slice(start, min(start + rows, height))
            shape = (len(frames), block.stop - block.start, width)
            images, flags = np.empty((*shape, 3), np.float32), np.empty(shape, bool)
            for k, i in enumerate(frames):
                samples = spool.rows(k, block) if rows < height else next(whole)
                linear(i, samples, images[k])
                flags[k] = valid(i, samples)
            yield Tile(block, images, flags)


def decoded(read: Read, frames: Sequence[int]) -> Iterator[Stored]:
    """Yield the stored samples of each frame in order, decoded by several threads and at most that many ahead."""
    workers = min(os.cpu_count() or 1, MOST_WORKERS)
    with ThreadPoolExecutor(workers, thread_name_prefix="decode") as pool:
        ahead: deque[Future[Stored]] = deque()
        for i in frames:
            ahead.append(pool.submit(read, i))
            if len(ahead) > workers:
                yield ahead.popleft().result()
        while ahead:
            yield ahead.popleft().result()
