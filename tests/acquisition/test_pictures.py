"""Pictures that are no RAW files: told from them by content, read exactly, and refused where torn."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from acquisition.dataset import open_dataset, write_dataset
from acquisition.dataset.images import encode_exr
from acquisition.dataset.transfer import decode
from acquisition.importing import load_any
from acquisition.merging import Sample, merge
from acquisition.pictures import is_picture, stored_samples
from acquisition.radiance import read_frame
from simulators.raw import Sensor
from stage.errors import DeviceError
from stage.lights import Light

RNG = np.random.default_rng(5)
COLOURS = {8: RNG.integers(0, 256, (6, 8, 3), dtype=np.uint8), 16: RNG.integers(0, 65536, (6, 8, 3), dtype=np.uint16)}


def png(samples: NDArray[Any]) -> bytes:
    return bytes(cv2.imencode(".png", samples[..., ::-1] if samples.ndim == 3 else samples)[1])


def tiff(samples: NDArray[Any], **how: Any) -> bytes:
    stream = io.BytesIO()
    tifffile.imwrite(stream, samples, **how)
    return stream.getvalue()


def jpeg(samples: NDArray[Any]) -> bytes:
    return bytes(cv2.imencode(".jpg", samples[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 100])[1])


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("write", [png, tiff])
@pytest.mark.parametrize("transfer", ["linear", "srgb", "gamma:2.2"])
def test_integer_pictures_are_read_exactly(bits: int, write: Any, transfer: str) -> None:
    stored = COLOURS[bits].copy()
    top = 2**bits - 1
    stored[0, 0] = top, 0, top - 1
    frame = read_frame(write(stored), "shot", transfer=transfer)
    assert_allclose(frame.values, decode(transfer, stored / top), rtol=1e-12)
    assert_array_equal(frame.clipped, stored == top)
    assert_array_equal(frame.black, 0)
    assert frame.white == 1
    assert frame.size == (8, 6)
    assert frame.exposure_s is None
    assert not frame.is_raw


@pytest.mark.parametrize("write", [png, tiff])
def test_a_grey_picture_has_three_equal_channels(write: Any) -> None:
    samples = stored_samples(write(COLOURS[16][..., 0]), "shot")
    assert samples is not None
    assert_array_equal(samples, np.repeat(COLOURS[16][..., :1], 3, -1))


def test_a_jpeg_is_read_to_its_own_precision() -> None:
    smooth = np.broadcast_to(np.arange(0, 256, 4, dtype=np.uint8)[:, None], (32, 64, 3)).copy()
    smooth[:] = np.linspace(20, 230, 64, dtype=np.uint8)[None, :, None]
    samples = stored_samples(jpeg(smooth), "shot")
    assert samples is not None
    assert np.abs(samples.astype(int) - smooth).max() <= 2


@pytest.mark.parametrize("half", [False, True])
def test_an_exr_is_linear_and_never_clipped(half: bool) -> None:
    values = RNG.uniform(0, 40, (6, 8, 3)).astype(np.float16 if half else np.float32)
    frame = read_frame(encode_exr(values, half, name="x"), "shot", transfer="srgb")
    assert_array_equal(frame.values, values)
    assert not frame.clipped.any()
    assert frame.white > values.max()
    for seconds in (0.3, 1.0, 7.0):
        linear = merge([Sample.of(frame, seconds)], room=frame.white - frame.black)
        assert_allclose(linear.image, values.astype(float) / seconds, rtol=1e-6)
        assert not linear.clipped.any()


def test_a_black_exr_is_black_and_not_clipped() -> None:
    black = read_frame(encode_exr(np.zeros((4, 4, 3)), name="x"), "dark")
    assert black.white > 0
    assert not black.clipped.any()
    assert not black.values.any()


def test_raw_files_are_no_pictures() -> None:
    sensor = Sensor()
    mosaic = sensor.read(np.full((48, 64), 0.1), 0.05, 100, RNG)
    dng = sensor.dng(mosaic, 0.05, 100)
    assert not is_picture(dng)
    assert read_frame(dng, "shot.dng").is_raw
    preview_first = tiff(COLOURS[8], photometric="rgb", subfiletype=1)
    nested = io.BytesIO()
    with tifffile.TiffWriter(nested) as writer:
        writer.write(COLOURS[8], photometric="rgb", subifds=1)
        writer.write(COLOURS[16], photometric="rgb")
    canon = b"II*\0\x10\0\0\0CR\x02\0" + bytes(40)
    for raw in (preview_first, nested.getvalue(), canon, b"FUJIFILMCCD-RAW ", b""):
        assert not is_picture(raw)
        with pytest.raises(DeviceError, match="cannot be decoded as a RAW file"):
            read_frame(raw, "shot")


FILES = {
    "PNG": png(COLOURS[16]),
    "TIFF": tiff(COLOURS[16]),
    "JPEG": jpeg(COLOURS[8]),
    "EXR": encode_exr(COLOURS[8].astype(float), name="x"),
}


@pytest.mark.parametrize("kind", FILES)
def test_a_torn_picture_is_refused_wherever_it_is_torn(kind: str) -> None:
    data = FILES[kind]
    for size in range(8, len(data) - 2, max(len(data) // 25, 1)):
        with pytest.raises(DeviceError, match=r"^camera: shot: .*; take it again$"):
            stored_samples(data[:size], "shot")


def test_a_png_with_a_flipped_bit_is_refused() -> None:
    data = bytearray(FILES["PNG"])
    data[len(data) // 2] ^= 1
    with pytest.raises(DeviceError, match="check sum"):
        read_frame(bytes(data), "shot")


def test_an_exr_with_infinity_is_refused() -> None:
    with pytest.raises(DeviceError, match="NaN or infinity"):
        read_frame(encode_exr(np.full((2, 2, 3), np.inf), name="x"), "shot")


@pytest.mark.data
@pytest.mark.parametrize("folder", ["diligent-bear", "psbox-cat"])
def test_real_photographs_are_read_as_their_dataset_reads_them(shared_data: Path, folder: str) -> None:
    dataset = load_any(shared_data / folder)
    for i in (0, len(dataset) - 1):
        frame = read_frame(dataset.path(i).read_bytes(), "shot", transfer=dataset.frames[i].transfer)
        assert_allclose(frame.values, dataset.image(i), atol=1e-7)
        assert_array_equal(~frame.clipped.any(-1), dataset.valid(i))


def test_the_files_of_a_dataset_are_such_pictures(tmp_path: Path) -> None:
    values = RNG.uniform(0, 2, (6, 8, 3)).astype(np.float32)
    write_dataset(tmp_path / "set", name="set", frames=[(Light(direction=(0, 0, 1)), values, {})])
    dataset = open_dataset(tmp_path / "set")
    assert_array_equal(read_frame(dataset.path(0).read_bytes(), "shot").values, dataset.image(0))
