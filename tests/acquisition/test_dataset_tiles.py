"""Tiles say what the whole stack says, within a bound on memory."""

from __future__ import annotations

import os
import tracemalloc
from collections import Counter
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal
from numpy.typing import NDArray

from acquisition.dataset import IlluminationDataset, write_dataset
from acquisition.dataset import folder as folder_module
from acquisition.dataset import spool as spool_module
from acquisition.dataset import tiles as tiles_module
from acquisition.dataset.headers import Header
from stage.errors import InputError
from stage.lights import Light

UP = Light(direction=(0, 0, 1))


@pytest.fixture(scope="module")
def mixed(tmp_path_factory: pytest.TempPathFactory) -> IlluminationDataset:
    """Every kind of stored sample in one set: half, float, 8 and 16 bits, grey and colour."""
    home = tmp_path_factory.mktemp("mixed")
    rng = np.random.default_rng(2)
    byte = rng.integers(0, 255, (23, 17, 3), dtype=np.uint8, endpoint=True)
    word = rng.integers(0, 65535, (23, 17), dtype=np.uint16, endpoint=True)
    cv2.imwrite(str(home / "byte.png"), byte)
    cv2.imwrite(str(home / "word.tif"), word)
    frames = [
        (UP, home / "byte.png", {"transfer": "srgb", "scale": 2.0}),
        (UP, rng.random((23, 17, 3)), {"saturation": 0.9}),
        (UP, home / "word.tif", {"saturation": 0.5}),
        (UP, rng.random((23, 17))),
    ]
    return write_dataset(home / "set", name="mixed", frames=frames, half=True)


@settings(deadline=None, max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.integers(0, 3), max_size=6), st.integers(1, 30000))
def test_tiles_are_the_stack(mixed: IlluminationDataset, frames: list[int], max_bytes: int) -> None:
    tiles = list(mixed.tiles(frames, max_bytes))
    assert [tile.rows.start for tile in tiles] == [0, *(tile.rows.stop for tile in tiles[:-1])]
    assert tiles[-1].rows.stop == mixed.height
    assert_array_equal(np.concatenate([tile.images for tile in tiles], axis=1), mixed.stack(frames))
    valid = np.concatenate([tile.valid for tile in tiles], axis=1)
    expected = [mixed.valid(i) for i in frames]
    assert_array_equal(valid, np.array(expected, dtype=bool).reshape(len(frames), 23, 17))
    row = len(frames) * 17 * 13
    assert all(tile.images.nbytes + tile.valid.nbytes <= max(max_bytes, row) for tile in tiles)


def test_each_file_is_decoded_once(mixed: IlluminationDataset, monkeypatch: pytest.MonkeyPatch) -> None:
    decoded: Counter[str] = Counter()
    read = folder_module.read_picture

    def counting(path: Path, header: Header | None = None) -> NDArray[np.generic]:
        decoded[path.name] += 1
        return read(path, header)

    monkeypatch.setattr(folder_module, "read_picture", counting)
    assert len(list(mixed.tiles(range(4), max_bytes=1))) == mixed.height
    assert set(decoded.values()) == {1}
    assert len(decoded) == 4


def test_memory_is_bounded_by_the_tile_not_by_the_set(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    frames = ((UP, rng.random((160, 200, 3)).astype(np.float32)) for _ in range(40))
    found = write_dataset(tmp_path / "set", name="big", frames=frames)
    whole = 40 * 160 * 200 * 12
    bound = whole // 40
    workers = min(os.cpu_count() or 1, tiles_module.MOST_WORKERS)
    pictures = (3 + 2 * workers) * 160 * 200 * 12  # those that are being decoded
    tracemalloc.start()
    try:
        total = sum(float(tile.images.sum(dtype=np.float64)) for tile in found.tiles(range(40), max_bytes=bound))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert total == pytest.approx(40 * 160 * 200 * 3 / 2, rel=0.01)
    assert peak < 2 * bound + pictures < whole


def test_leaving_early_closes_the_spool(
    mixed: IlluminationDataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    before = len(list(Path("/proc/self/fd").iterdir())) if Path("/proc/self/fd").is_dir() else 0
    tiles = mixed.tiles(range(4), max_bytes=1)
    next(tiles)
    tiles.close()  # type: ignore[attr-defined]
    assert list(tmp_path.iterdir()) == []
    if before:
        assert len(list(Path("/proc/self/fd").iterdir())) == before


def test_a_spool_that_cannot_be_written_is_named(mixed: IlluminationDataset, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(spool_module, "spool_folder", lambda: "/nowhere")
    with pytest.raises(InputError, match="/nowhere: TMPDIR: pictures cannot be spooled there"):
        list(mixed.tiles(range(4), max_bytes=1))
    assert len(list(mixed.tiles(range(4)))) == 1  # a set that fits needs no spool
