from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import cv2
import numpy as np
import OpenEXR
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from acquisition.dataset import read_exr, write_exr
from acquisition.dataset.headers import PictureError, read_header
from acquisition.dataset.images import read_picture, write_png
from stage.errors import InputError

SHAPES = st.sampled_from([(3, 5), (4, 2, 3), (1, 1), (1, 1, 3), (33, 2, 3)])


def smooth(height: int = 24, width: int = 31) -> NDArray[np.float32]:
    noise = np.random.default_rng(3).random((height, width, 3)).astype(np.float32)
    return np.asarray(cv2.GaussianBlur(noise, (0, 0), 3), dtype=np.float32)


@settings(deadline=None, max_examples=30)
@given(
    SHAPES.flatmap(lambda s: arrays(np.float32, s, elements=st.floats(allow_nan=False, allow_infinity=False, width=32)))
)
def test_float_exr_round_trip_is_exact(tmp_path_factory: pytest.TempPathFactory, picture: NDArray[np.float32]) -> None:
    path = tmp_path_factory.mktemp("exr") / "a.exr"
    write_exr(path, picture)
    assert_array_equal(read_exr(path), picture)


@settings(deadline=None, max_examples=30)
@given(SHAPES.flatmap(lambda s: arrays(np.float16, s, elements=st.floats(-65504, 65504, width=16))))
def test_half_exr_round_trip_is_exact(tmp_path_factory: pytest.TempPathFactory, picture: NDArray[np.float16]) -> None:
    path = tmp_path_factory.mktemp("exr") / "a.exr"
    write_exr(path, picture, half=True)
    assert read_header(path).dtype == np.float16
    assert_array_equal(read_exr(path), picture.astype(np.float32))


def test_exr_refuses_what_it_would_lose(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"a\.exr: a value exceeds 65504"):
        write_exr(tmp_path / "a.exr", np.full((2, 2), 7e4), half=True)
    with pytest.raises(InputError, match="expected the shape"):
        write_exr(tmp_path / "a.exr", np.zeros((2, 2, 4)))
    with pytest.raises(InputError, match="expected the shape"):
        write_exr(tmp_path / "a.exr", np.zeros((0, 2)))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["none", "rle", "zips", "zip", "piz"])
def test_lossless_exr_of_any_compression_is_read(tmp_path: Path, name: str) -> None:
    picture, path = smooth(), tmp_path / "a.exr"
    compression = {
        "none": OpenEXR.NO_COMPRESSION,
        "rle": OpenEXR.RLE_COMPRESSION,
        "zips": OpenEXR.ZIPS_COMPRESSION,
        "zip": OpenEXR.ZIP_COMPRESSION,
        "piz": OpenEXR.PIZ_COMPRESSION,
    }[name]
    alpha = np.ones((*picture.shape[:2], 1), np.float32)
    with OpenEXR.File({"compression": compression}, {"RGBA": np.concatenate([picture, alpha], -1)}) as file:
        file.write(str(path))
    assert_array_equal(read_exr(path), picture)


def test_exr_of_other_channels_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    flat = np.zeros((2, 2), np.float32)
    with OpenEXR.File({}, {"X": flat, "Y": flat}) as file:
        file.write(str(path))
    with pytest.raises(InputError, match=r"a\.exr: has the channels X, Y; expected R, G, B or a single one"):
        read_exr(path)
    with OpenEXR.File({}, {"id": flat.astype(np.uint32)}) as file:
        file.write(str(path))
    with pytest.raises(InputError, match="another kind than half or float"):
        read_exr(path)


@pytest.mark.parametrize("suffix", ["png", "tif"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("colours", [1, 3])
def test_integer_pictures_are_read_exactly(tmp_path: Path, suffix: str, dtype: type, colours: int) -> None:
    shape = (24, 31) if colours == 1 else (24, 31, 3)
    picture = np.random.default_rng(0).integers(0, np.iinfo(dtype).max, shape, dtype=dtype, endpoint=True)
    path = tmp_path / f"a.{suffix}"
    cv2.imwrite(str(path), picture[..., ::-1] if colours == 3 else picture)
    header = read_header(path)
    assert (header.width, header.height, header.dtype, header.is_integer) == (31, 24, np.dtype(dtype), True)
    assert_array_equal(read_picture(path), picture)


@pytest.mark.parametrize("flags", [[], [cv2.IMWRITE_JPEG_PROGRESSIVE, 1], [cv2.IMWRITE_JPEG_RST_INTERVAL, 2]])
def test_jpeg_is_read_within_its_loss(tmp_path: Path, flags: list[int]) -> None:
    picture = (smooth() * 255).astype(np.uint8)
    path = tmp_path / "a.jpg"
    cv2.imwrite(str(path), picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 100, *flags])
    assert (read_header(path).width, read_header(path).height, read_header(path).dtype) == (31, 24, np.uint8)
    assert_allclose(read_picture(path), picture, atol=6)


def test_alpha_is_dropped_and_bytes_after_the_end_are_ignored(tmp_path: Path) -> None:
    picture = (smooth() * 255).astype(np.uint8)
    path = tmp_path / "a.png"
    cv2.imwrite(str(path), np.dstack([picture[..., ::-1], np.full(picture.shape[:2], 9, np.uint8)]))
    path.write_bytes(path.read_bytes() + b"trailer")
    assert_array_equal(read_picture(path), picture)
    jpeg = tmp_path / "a.jpg"
    cv2.imwrite(str(jpeg), picture)
    jpeg.write_bytes(jpeg.read_bytes() + bytes(200))
    assert read_picture(jpeg).shape == picture.shape


def every_format(folder: Path) -> list[Path]:
    picture = smooth(40, 50)
    write_exr(folder / "float.exr", picture)
    write_exr(folder / "half.exr", picture, half=True)
    write_png(folder / "8.png", (picture * 255).astype(np.uint8))
    write_png(folder / "16.png", (picture * 65535).astype(np.uint16))
    for name, top in (("8.tif", 255), ("16.tif", 65535)):
        cv2.imwrite(str(folder / name), (picture * top).astype(np.uint8 if top == 255 else np.uint16))
    cv2.imwrite(str(folder / "a.jpg"), (picture * 255).astype(np.uint8))
    cv2.imwrite(str(folder / "p.jpg"), (picture * 255).astype(np.uint8), [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])
    return sorted(folder.iterdir())


def test_a_file_cut_anywhere_is_refused_in_silence(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Decoders show a truncated picture as far as it goes; here no cut, at whatever byte, may pass."""
    cut = tmp_path / "cut"
    for path in every_format(tmp_path):
        data = path.read_bytes()
        read_picture(path)
        for length in {*range(0, 300, 7), *range(300, len(data), 211), *range(len(data) - 12, len(data))}:
            cut.write_bytes(data[:length])
            with pytest.raises(PictureError):
                read_picture(cut)
    out = capfd.readouterr()
    assert (out.out, out.err) == ("", "")


@pytest.mark.parametrize("name", ["float.exr", "half.exr", "8.png", "16.png", "a.jpg"])
def test_a_cut_is_found_without_decoding(tmp_path: Path, name: str) -> None:
    every_format(tmp_path)
    path = tmp_path / name
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(PictureError, match="is truncated"):
        read_header(path)


@settings(deadline=None, max_examples=150)
@given(st.sampled_from(["8.png", "16.png", "8.tif", "p.jpg"]), st.data())
def test_damaged_bytes_give_a_picture_or_one_error(
    tmp_path_factory: pytest.TempPathFactory, name: str, data: st.DataObject
) -> None:
    folder = tmp_path_factory.mktemp("damage")
    path = next(p for p in every_format(folder) if p.name == name)
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 3))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(content)
    with suppress(PictureError):
        assert read_picture(path).size > 0


def test_a_damaged_png_is_found_by_its_check_sum(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    write_png(path, (smooth() * 255).astype(np.uint8))
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0x10
    path.write_bytes(data)
    with pytest.raises(PictureError, match="check sum of its IDAT chunk"):
        read_picture(path)


def test_what_is_no_picture_is_named_as_such(tmp_path: Path) -> None:
    (tmp_path / "text.png").write_text("hello, this is text")
    (tmp_path / "empty.png").write_bytes(b"")
    for name, fault in (
        ("text.png", "is not an EXR, PNG, TIFF or JPEG"),
        ("empty.png", "is empty"),
        ("none.png", "does not exist"),
        (".", "is a folder"),
    ):
        with pytest.raises(PictureError, match=fault):
            read_header(tmp_path / name)
    cv2.imwrite(str(tmp_path / "float.tif"), smooth())
    with pytest.raises(PictureError, match="another kind than 8- or 16-bit"):
        read_header(tmp_path / "float.tif")
    every_format(tmp_path)
    with pytest.raises(InputError, match=r"8\.png: is not an EXR file"):
        read_exr(tmp_path / "8.png")
