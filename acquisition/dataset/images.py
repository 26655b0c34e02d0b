"""Pixels in and out: EXR (half, float), PNG, TIFF and JPEG of 8 and 16 bits."""

from __future__ import annotations

import io
import struct
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import OpenEXR
from numpy.typing import ArrayLike, NDArray

from acquisition.dataset.headers import PNG_SIGNATURE, Header, PictureError, header_of, read_header
from stage.errors import InputError

Stored = NDArray[Any]
"""Samples as the file holds them: (height, width) or (height, width, 3) of uint8, uint16, float16 or float32."""

HALF_MAX = 65504.0

# A picture that cannot be decoded is one error raised here, not lines that the library prints.
cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)


def read_picture(path: Path, header: Header | None = None) -> Stored:
    """Decode a picture to its stored samples, colours in the order R, G, B and without alpha.

    Parameters
    ----------
    path : Path
        An EXR, PNG, TIFF or JPEG file.
    header : Header, optional
        What `read_header` said earlier; the file must still say so.

    Returns
    -------
    (height, width) or (height, width, 3)
        One channel where the file has one.

    Raises
    ------
    PictureError
        Where the file is unreadable, truncated or damaged, or holds NaN or infinity.
    """
    found = read_header(path)
    if header is not None and found != header:
        raise PictureError("changed while it was in use")
    if found.format == "exr":
        return _decode_exr(str(path), found)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise PictureError(f"cannot be read ({error.strerror})") from None
    return _decode_integer(data, found)


def decode_picture(data: bytes) -> Stored:
    """Like `read_picture`, of a file in memory."""
    header = header_of(io.BytesIO(data))
    return _decode_exr(io.BytesIO(data), header) if header.format == "exr" else _decode_integer(data, header)


def _decode_integer(data: bytes, header: Header) -> Stored:
    if header.format == "png":
        _check_png_sums(data)
    try:
        samples = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        samples = None
    if samples is None or samples.dtype != header.dtype:
        raise PictureError(f"is a damaged {header.format.upper()} that cannot be decoded")
    if samples.ndim == 3:
        samples = cv2.cvtColor(samples, cv2.COLOR_BGR2RGB if samples.shape[2] == 3 else cv2.COLOR_BGRA2RGB)
    return _of_size(samples, header)


def _of_size(samples: Stored, header: Header) -> Stored:
    if samples.shape[:2] != (header.height, header.width):
        raise PictureError("is damaged: its pixels do not have the size that its header gives")
    return samples


def _check_png_sums(data: bytes) -> None:
    """Verify each chunk's CRC, because the decoder shows a damaged PNG as far as it gets and reports success."""
    at, kind = len(PNG_SIGNATURE), b""
    while kind != b"IEND":
        length, kind = struct.unpack_from(">I4s", data, at)
        (expected,) = struct.unpack_from(">I", data, at + 8 + length)
        if zlib.crc32(memoryview(data)[at + 4 : at + 8 + length]) != expected:
            raise PictureError(f"is damaged: the check sum of its {kind.decode('latin-1')} chunk is wrong")
        at += 12 + length


def _decode_exr(source: str | io.BytesIO, header: Header) -> Stored:
    names = set(header.channels)
    if {"R", "G", "B"} <= names:
        wanted = ["R", "G", "B"]
    elif len(names - {"A"}) == 1:
        wanted = sorted(names - {"A"})
    else:
        raise PictureError(f"has the channels {', '.join(header.channels)}; expected R, G, B or a single one")
    try:
        with OpenEXR.File(source, separate_channels=True) as file:
            channels = file.channels()
            planes = [np.asarray(channels[name].pixels) for name in wanted]
    except (RuntimeError, ValueError, KeyError, IndexError):
        raise PictureError("is a damaged EXR that cannot be decoded") from None
    samples = planes[0].copy() if len(planes) == 1 else np.stack(planes, -1)
    return _of_size(samples.astype(header.dtype, copy=False), header)


def check_finite(samples: Stored) -> None:
    """Raise `PictureError` where samples hold NaN or infinity, with the first such pixel."""
    if samples.dtype.kind != "f":
        return
    bad = ~np.isfinite(samples)
    if bad.any():
        row, column = np.argwhere(bad)[0][:2]
        raise PictureError(f"holds NaN or infinity in {int(bad.sum())} samples, first at row {row}, column {column}")


def read_exr(path: str | Path) -> NDArray[np.float32]:
    """Read an EXR file as float32: (height, width) where it has one channel, else (height, width, 3) RGB.

    Values are as stored; NaN and infinity pass. Raises `InputError` that names the file.
    """
    try:
        samples = read_picture(Path(path))
    except PictureError as error:
        raise InputError(f"{path}: {error}") from None
    if samples.dtype.kind != "f":
        raise InputError(f"{path}: is not an EXR file")
    return samples.astype(np.float32)


def write_exr(path: str | Path, array: ArrayLike, half: bool = False) -> None:
    """Write (height, width) as one channel ``Z`` or (height, width, 3) as RGB, losslessly compressed.

    Parameters
    ----------
    path : str or Path
        Replaced where it exists. Not staged: wrap it in `staged_file` or `staged_folder`.
    array : (height, width) or (height, width, 3) float
        Stored as float32, or as 16-bit half floats where `half` is set.

    Raises
    ------
    InputError
        Where the shape is another one, or a finite value exceeds what a half float holds (65504).
    """
    Path(path).write_bytes(encode_exr(array, half, name=str(path)))


def encode_exr(array: ArrayLike, half: bool = False, *, name: str) -> bytes:
    """Return what `write_exr` writes; `name` is what errors speak of."""
    values = np.asarray(array)
    if values.ndim not in (2, 3) or (values.ndim == 3 and values.shape[2] != 3) or values.size == 0:
        raise InputError(f"{name}: expected the shape (height, width) or (height, width, 3), got {values.shape}")
    if half and np.abs(values[np.isfinite(values)]).max(initial=0) > HALF_MAX:
        raise InputError(f"{name}: a value exceeds {HALF_MAX:g}, the largest that half floats hold; write floats")
    pixels = np.ascontiguousarray(values, dtype=np.float16 if half else np.float32)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, {"Z": pixels} if pixels.ndim == 2 else {"RGB": pixels}) as file:
        stream = io.BytesIO()  # the library's own file writing reports a full disk on stderr only
        file.write(stream)
    return stream.getvalue()


def write_png(path: Path, array: NDArray[Any]) -> None:
    """Write (height, width) or (height, width, 3) RGB of uint8 or uint16 as PNG."""
    pixels = array[..., ::-1] if array.ndim == 3 else array
    ok, data = cv2.imencode(".png", np.ascontiguousarray(pixels))
    if not ok:
        raise InputError(f"{path}: an array of {array.dtype} and shape {array.shape} cannot be written as PNG")
    path.write_bytes(data.tobytes())
