"""Files from cameras that are not RAW: PNG, TIFF, JPEG and EXR pictures, told from RAW files by what is in them."""

from __future__ import annotations

import io
import logging
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

from acquisition.dataset.headers import PictureError
from acquisition.dataset.images import check_finite, decode_picture
from stage.errors import DeviceError

logging.getLogger("tifffile").addHandler(logging.NullHandler())  # else it prints what a torn file lacks

PNG, JPEG, EXR = b"\x89PNG\r\n\x1a\n", b"\xff\xd8", b"\x76\x2f\x31\x01"
TIFF = (b"II*\0", b"MM\0*")
CANON = b"CR"
"""At byte 8 of a Canon CR2, which begins like a TIFF."""
DNG_VERSION, SUB_IFDS, NEW_SUBFILE_TYPE = 50706, 330, 254
"""Tags of TIFF 6.0 and its supplement 1, and of DNG 1.4."""


def stored_samples(data: bytes, source: str) -> NDArray[Any] | None:
    """Stored samples of a picture file.

    Parameters
    ----------
    data : bytes
        The file.
    source : str
        Its name, for the error.

    Returns
    -------
    (height, width, 3) uint8, uint16, float16 or float32, or None
        Red, green, blue; three times the same where the picture is grey. None where the file is none of these
        pictures, and so may be a RAW file.

    Raises
    ------
    DeviceError
        Where it is such a picture, but torn or damaged, or holds NaN or infinity.
    """
    if not is_picture(data):
        return None
    try:
        samples = decode_picture(data)
        check_finite(samples)
    except PictureError as error:
        raise DeviceError(f"camera: {source}: {error}; take it again") from None
    return np.repeat(samples[..., None], 3, axis=-1) if samples.ndim == 2 else samples


def is_picture(data: bytes) -> bool:
    """Whether a file is a PNG, JPEG or EXR, or a TIFF that holds no RAW data."""
    if data.startswith((PNG, JPEG, EXR)):
        return True
    if not data.startswith(TIFF) or data[8:10] == CANON:
        return False
    try:
        with io.BytesIO(data) as file, tifffile.TiffFile(file) as tiff:  # else a cycle keeps the bytes alive
            tags = tiff.pages.first.tags
            # DNG says so; other RAW files keep a preview first, and the mosaic in a directory below it
            if DNG_VERSION in tags or SUB_IFDS in tags:
                return False
            thumbnail = tags.valueof(NEW_SUBFILE_TYPE, 0) & 1
            return not thumbnail and tiff.pages.first.photometric in (0, 1, 2, 3)
    except Exception:  # its parser fails in many ways on torn files; a torn TIFF is for the picture's reader to refuse
        return True
