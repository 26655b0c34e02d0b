"""What a picture file says about itself before a pixel is decoded, and whether all of it is there.

Decoders fill what is missing from a truncated file with grey and say nothing, so completeness is checked here, from
the container's own structure and without reading the pixel data.
"""

from __future__ import annotations

import logging
import os
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_EXR_MAGIC = b"\x76\x2f\x31\x01"
_TIFF_MAGICS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
# Scan lines per chunk, by the header's compression number (OpenEXR file layout; none, RLE, ZIPS, ZIP, PIZ, PXR24,
# B44, B44A, DWAA, DWAB).
_EXR_CHUNK_LINES = (1, 1, 1, 16, 32, 16, 32, 32, 32, 256)


class PictureError(ValueError):
    """A clause that says what is wrong with a picture file; the caller puts the file and the field before it."""


@dataclass(frozen=True)
class Header:
    """Size and sample type of a picture file.

    Attributes
    ----------
    format : str
        ``exr``, ``png``, ``jpeg`` or ``tiff``, by the file's content.
    width, height : int
        Pixels.
    dtype : numpy dtype
        uint8, uint16, float16 or float32.
    channels : tuple of str
        Channel names of an EXR file; empty for the other formats.
    """

    format: str
    width: int
    height: int
    dtype: np.dtype[np.generic]
    channels: tuple[str, ...] = ()

    @property
    def is_integer(self) -> bool:
        """Whether stored values run from 0 to 1 (integer files) rather than freely (EXR)."""
        return self.dtype.kind == "u"


def read_header(path: Path) -> Header:
    """Read size and sample type of a picture file and check that the file is complete.

    Raises
    ------
    PictureError
        Where the file is missing, unreadable, of an unknown kind, truncated or of an unsupported sample type.
    """
    try:
        with path.open("rb") as file:
            return header_of(file)
    except FileNotFoundError:
        raise PictureError("does not exist") from None
    except IsADirectoryError:
        raise PictureError("is a folder, not a picture") from None
    except OSError as error:
        raise PictureError(f"cannot be read ({error.strerror})") from None


def header_of(file: BinaryIO) -> Header:
    """Like `read_header`, of a file that is open or in memory, at its beginning."""
    magic = file.read(8)
    file.seek(0)
    try:
        if magic == PNG_SIGNATURE:
            return _png(file)
        if magic[:2] == b"\xff\xd8":
            return _jpeg(file)
        if magic[:4] == _EXR_MAGIC:
            return _exr(file)
        if magic[:4] in _TIFF_MAGICS:
            return _tiff(file)
    except struct.error:
        raise PictureError("is truncated inside its header") from None
    raise PictureError("is not an EXR, PNG, TIFF or JPEG picture" if magic else "is empty")


def _size_of(file: BinaryIO) -> int:
    at = file.tell()
    size = file.seek(0, os.SEEK_END)
    file.seek(at)
    return size


def _png(file: BinaryIO) -> Header:
    file.seek(len(PNG_SIGNATURE))
    length, kind = struct.unpack(">I4s", file.read(8))
    width, height, depth = struct.unpack(">IIB", file.read(9))
    if kind != b"IHDR" or width < 1 or height < 1:
        raise PictureError("is a damaged PNG: it does not begin with its size")
    file.seek(len(PNG_SIGNATURE))
    while kind != b"IEND":
        leader = file.read(8)
        if len(leader) < 8:
            raise PictureError("is truncated: the PNG's last chunk is missing")
        length, kind = struct.unpack(">I4s", leader)
        file.seek(length + 4, os.SEEK_CUR)
    if file.tell() > _size_of(file):
        raise PictureError("is truncated: the PNG's last chunk is cut")
    return Header("png", width, height, np.dtype(np.uint16 if depth == 16 else np.uint8))


def _jpeg(file: BinaryIO) -> Header:
    file.seek(2)
    header: Header | None = None
    while True:
        (prefix,) = struct.unpack("B", file.read(1))
        if prefix != 0xFF:
            raise PictureError("is a damaged JPEG: a marker is missing between its segments")
        marker = 0xFF
        while marker == 0xFF:  # any number of fill bytes may precede a marker
            (marker,) = struct.unpack("B", file.read(1))
        if marker == 0xD9:
            raise PictureError("is a damaged JPEG: it ends before its picture begins")
        (length,) = struct.unpack(">H", file.read(2))
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            precision, height, width = struct.unpack(">BHH", file.read(5))
            if precision != 8 or width < 1 or height < 1:
                raise PictureError(f"is a JPEG of {precision} bits and {width} x {height} pixels, which cannot be read")
            header = Header("jpeg", width, height, np.dtype(np.uint8))
            length -= 5
        file.seek(length - 2, os.SEEK_CUR)
        if marker == 0xDA:
            break
    # Inside coded data 0xFF is always followed by 0 or a restart marker, so the first 0xFFD9 from here on is the end.
    if header is None or not _contains_from(file, file.tell(), b"\xff\xd9"):
        raise PictureError("is truncated: the JPEG's end marker is missing")
    return header


def _contains_from(file: BinaryIO, start: int, needle: bytes) -> bool:
    """Whether `needle` stands at or after `start`; the file's last bytes are tried first, for it is usually there."""
    file.seek(max(start, _size_of(file) - 64))
    if needle in file.read():
        return True
    file.seek(start)
    return needle in file.read()


def _tiff(file: BinaryIO) -> Header:
    import tifffile  # only sets that hold TIFF pay for its import

    # What it logs about a damaged file is said once, by the error raised here.
    logging.getLogger("tifffile").addHandler(logging.NullHandler())
    try:
        with tifffile.TiffFile(file) as tiff:
            page = tiff.pages.first
            width, height = int(page.imagewidth), int(page.imagelength)
            bits, form = page.bitspersample, int(page.sampleformat)
            chunks = zip(page.dataoffsets, page.databytecounts, strict=True)
            end = max((offset + count for offset, count in chunks), default=0)
    except (tifffile.TiffFileError, ValueError, IndexError, KeyError, TypeError, struct.error):
        raise PictureError("is a damaged or truncated TIFF") from None
    if end == 0 or end > _size_of(file):
        raise PictureError("is truncated: the TIFF's pixel data is cut")
    if bits not in (8, 16) or form != 1:
        raise PictureError("is a TIFF of another kind than 8- or 16-bit unsigned integers")
    return Header("tiff", width, height, np.dtype(np.uint8 if bits == 8 else np.uint16))


def _exr(file: BinaryIO) -> Header:
    file.seek(4)
    (version,) = struct.unpack("<I", file.read(4))
    if version & 0x1800:
        raise PictureError("is a deep or multi-part EXR; one flat picture is expected")
    attributes: dict[str, bytes] = {}
    while name := _text(file):
        _text(file)
        (size,) = struct.unpack("<i", file.read(4))
        value = file.read(max(size, 0))
        if len(value) != size:
            raise PictureError("is truncated inside its header")
        attributes[name] = value
    x0, y0, x1, y1 = struct.unpack("<4i", attributes.get("dataWindow", b""))
    width, height = x1 - x0 + 1, y1 - y0 + 1
    channels = _exr_channels(attributes.get("channels", b""))
    if width < 1 or height < 1 or not channels:
        raise PictureError("is a damaged EXR: it has no pixels or no channels")
    kinds = {kind for kind, _ in channels.values()}
    if kinds - {1, 2} or any(sampling != (1, 1) for _, sampling in channels.values()):
        raise PictureError("is an EXR of another kind than half or float channels at full resolution")
    compression = attributes.get("compression", b"\xff")[0]
    if not version & 0x200 and compression < len(_EXR_CHUNK_LINES):
        _check_exr_chunks(file, -(-height // _EXR_CHUNK_LINES[compression]))
    dtype = np.dtype(np.float16 if kinds == {1} else np.float32)
    return Header("exr", width, height, dtype, tuple(channels))


def _text(file: BinaryIO) -> str:
    """Read one NUL-terminated name of an EXR header."""
    out = bytearray()
    while (byte := file.read(1)) != b"\0":
        if not byte or len(out) > 255:
            raise PictureError("is truncated inside its header")
        out += byte
    return out.decode("latin-1")


def _exr_channels(data: bytes) -> dict[str, tuple[int, tuple[int, int]]]:
    """Sample type and subsampling of each channel, by name."""
    out: dict[str, tuple[int, tuple[int, int]]] = {}
    while data and data[0]:
        name, _, data = data.partition(b"\0")
        kind, _, x, y = struct.unpack("<iiii", data[:16])
        out[name.decode("latin-1")] = (kind, (x, y))
        data = data[16:]
    return out


def _check_exr_chunks(file: BinaryIO, count: int) -> None:
    """Follow the table of chunk offsets: each must point into the file, and the last chunk must end inside it."""
    table = file.read(8 * count)
    size = _size_of(file)
    if len(table) < 8 * count:
        raise PictureError("is truncated: the EXR's table of chunks is cut")
    offsets = np.frombuffer(table, "<u8")
    if offsets.min() < file.tell() or offsets.max() + 8 > size:
        raise PictureError("is truncated: the EXR's pixel data is cut")
    file.seek(int(offsets.max()))
    _, length = struct.unpack("<iI", file.read(8))
    if file.tell() + length > size:
        raise PictureError("is truncated: the EXR's last scan lines are cut")
