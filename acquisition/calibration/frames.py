"""RAW files to calibrate a camera from, read one at a time: no more than a few are ever in memory."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from acquisition.radiance import RawFrame, raw_exposure_s, read_raw
from stage.errors import DeviceError, InputError


@dataclass(frozen=True, eq=False)
class ExposedFrame:
    """A RAW frame with what is known of it.

    Attributes
    ----------
    raw : RawFrame
        Its numbers.
    exposure_s : float
        Seconds, > 0.
    source : str
        Its name, for errors.
    """

    raw: RawFrame
    exposure_s: float
    source: str


def exposed_frames(
    paths: Sequence[Path], progress: Callable[[float], None] = lambda share: None
) -> Iterator[ExposedFrame]:
    """Decode RAW files, shortest exposure first and otherwise in the order given.

    Raises
    ------
    InputError
        Where one cannot be read, is no RAW file or does not tell its exposure time.
    """
    timed = sorted(((_exposure_s(path), path) for path in paths), key=lambda one: one[0])
    for i, (exposure_s, path) in enumerate(timed):
        with _input_errors(path):
            raw = read_raw(path.read_bytes(), str(path))
        yield ExposedFrame(raw, exposure_s, str(path))
        progress((i + 1) / len(paths))


def _exposure_s(path: Path) -> float:
    with _input_errors(path):
        exposure_s = raw_exposure_s(path.read_bytes(), str(path))
    if exposure_s is None:
        raise InputError(f"{path}: exposure time: the file does not tell it")
    return exposure_s


@contextmanager
def _input_errors(path: Path) -> Iterator[None]:
    """What is wrong with a file that no camera can take again."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    except DeviceError as error:
        raise InputError(str(error).removeprefix("camera: ").removesuffix("; take it again")) from None


def require_alike(frame: ExposedFrame, first: ExposedFrame) -> None:
    """Refuse a frame of another size or sensitivity than the first one's; raises `InputError`."""
    if frame.raw.size != first.raw.size:
        raise InputError(f"{frame.source}: is {_size(frame)} pixels, expected {_size(first)} like {first.source}")
    if frame.raw.iso != first.raw.iso:
        raise InputError(f"{frame.source}: was taken at {_iso(frame)}, expected {_iso(first)} like {first.source}")


def _size(frame: ExposedFrame) -> str:
    return "{} x {}".format(*frame.raw.size)


def _iso(frame: ExposedFrame) -> str:
    return "an unknown ISO" if frame.raw.iso is None else f"ISO {frame.raw.iso:g}"
