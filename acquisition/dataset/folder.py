"""One fixed camera, many lights, one photograph per light: the illumination dataset (K01), read lazily."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from acquisition.dataset import transfer as transfers
from acquisition.dataset.geometry import Geometry, settle
from acquisition.dataset.headers import Header, PictureError, read_header
from acquisition.dataset.images import Stored, check_finite, read_picture
from acquisition.dataset.mesh import Triangles
from acquisition.dataset.tiles import Tile, decoded, iterate_tiles
from stage.camera import Camera
from stage.errors import InputError
from stage.lights import Light


@dataclass(frozen=True)
class Frame:
    """One photograph and the light it was taken under.

    Attributes
    ----------
    image : str
        File, relative to the dataset's folder.
    light : Light
        Where the light stood and how strong it was.
    scale : float
        Linear radiance per unit of the decoded stored value, > 0.
    transfer : str
        ``linear``, ``srgb`` or ``gamma:G``; the last two for integer files only.
    saturation : float or None
        Stored value at and above which a sample is clipped. None: 1 for integer files, never for EXR.
    variance : str or None
        File with the variance of the stored value, relative to the dataset's folder.
    """

    image: str
    light: Light
    scale: float = 1.0
    transfer: str = "linear"
    saturation: float | None = None
    variance: str | None = None


class IlluminationDataset:
    """Photographs of one view under many lights, with whatever is known of the surface.

    On construction every picture's header is checked and the geometry is settled; pixels are decoded when asked for
    and not kept. `open_dataset` reads one from a folder; importers construct it over foreign folders.

    Attributes
    ----------
    folder : Path
        Where the files lie; no file outside it is ever read.
    source : Path
        The file that describes the set, named in errors.
    name : str
    camera : Camera or None
        None means orthographic and unknown; then all lights are distant, and the world frame is x right, y up, z
        towards the camera.
    frames : tuple of Frame
    provenance : dict
    height, width : int
        Pixels.
    mask : (height, width) bool
        Object pixels; all of them where nothing else is known. Where there is depth, pixels without it are none.
    depth : (height, width) float32 or None
        z in the camera frame, metres; 0 outside the mask.
    normals : (height, width, 3) float32 or None
        World-frame unit vectors as the set gives them; 0 outside the mask and where the set knows none.
    mesh : (vertices (n, 3), faces (m, 3)) or None
        Triangle mesh, world frame, metres.
    mesh_path : Path or None
        The file it was read from.
    """

    def __init__(
        self,
        folder: str | Path,
        name: str,
        frames: Sequence[Frame],
        *,
        camera: Camera | None = None,
        geometry: Geometry | None = None,
        provenance: dict[str, Any] | None = None,
        source: str | Path | None = None,
    ) -> None:
        self.folder = Path(folder)
        self._root = os.path.realpath(self.folder)
        self.source = Path(source) if source is not None else self.folder
        self.name = name
        self.camera = camera
        self.frames = tuple(frames)
        self.provenance = dict(provenance or {})
        if not self.frames:
            raise InputError(f"{self.source}: frames: the set has no pictures")
        self._paths = [self._checked_path(f.image, f"frames[{i}].image") for i, f in enumerate(self.frames)]
        self._headers = [self._header(path, f"frames[{i}].image") for i, path in enumerate(self._paths)]
        first = self._headers[0]
        self.height, self.width = (first.height, first.width) if camera is None else (camera.height, camera.width)
        for i in range(len(self.frames)):
            self._check_frame(i)
        settled = settle(geometry or Geometry(), (self.height, self.width), self.lights, camera, self.source)
        assert settled.mask is not None
        self.mask: NDArray[np.bool_] = settled.mask
        self.depth = settled.depth
        self.normals = settled.normals
        self.mesh: Triangles | None = settled.mesh
        self.mesh_path = settled.mesh_path

    def __len__(self) -> int:
        """Count of frames."""
        return len(self.frames)

    def __repr__(self) -> str:
        return f"IlluminationDataset({self.name!r}, {len(self)} frames of {self.width} x {self.height}, {self.folder})"

    @property
    def lights(self) -> list[Light]:
        """The light of each frame, in order."""
        return [frame.light for frame in self.frames]

    @property
    def is_eight_bit(self) -> bool:
        """Whether all pictures are 8-bit integer files, so that 0-255 as stored is the set's own display scale."""
        return all(header.dtype == np.uint8 for header in self._headers)

    @cached_property
    def points(self) -> NDArray[np.float64] | None:
        """Surface points (height, width, 3), world frame, metres; NaN outside the mask. None without depth."""
        if self.camera is None or self.depth is None:
            return None
        return self.camera.depth_to_points(self.depth)

    @cached_property
    def view(self) -> NDArray[np.float32]:
        """Unit vectors (height, width, 3) from the surface to the camera, world frame; (0, 0, 1) without a camera."""
        if self.camera is None:
            return np.broadcast_to(np.array([0, 0, 1], np.float32), (self.height, self.width, 3)).copy()
        rays = self.camera.rays()
        return np.asarray(-rays / np.linalg.norm(rays, axis=-1, keepdims=True), dtype=np.float32)

    def image(self, i: int) -> NDArray[np.float32]:
        """Linear radiance of frame `i`, (height, width, 3); a grey picture is repeated to three channels.

        Raises `InputError` where the file is damaged or holds NaN or infinity.
        """
        out = np.empty((self.height, self.width, 3), np.float32)
        self._linear(i, self._read(i), out)
        return out

    def stored(self, i: int) -> NDArray[np.float32]:
        """Values of frame `i` as stored, (height, width, 3); 0 to 1 for integer files."""
        return _three(self._stored(self._read(i)))

    def valid(self, i: int) -> NDArray[np.bool_]:
        """Where frame `i` is not clipped: every channel's stored value lies below the saturation. (height, width)."""
        return self._valid(i, self._read(i))

    def variance(self, i: int) -> NDArray[np.float32] | None:
        """Variance of `image(i)`, (height, width, 3), or None where the frame has none.

        The stored value's variance is carried through the transfer function to first order.
        """
        name = self.frames[i].variance
        if name is None:
            return None
        field = f"frames[{i}].variance"
        path = self._checked_path(name, field)
        try:
            samples = read_picture(path)
            check_finite(samples)
            if (samples < 0).any():
                raise PictureError("holds negative variances")
        except PictureError as error:
            raise InputError(f"{self.source}: {field}: {name!r} {error}") from None
        steepness = self.frames[i].scale * transfers.slope(self.frames[i].transfer, self.stored(i))
        return np.asarray(_three(self._stored(samples)) * steepness**2, dtype=np.float32)

    def tiles(self, frames: Sequence[int], max_bytes: int = 1 << 28) -> Iterator[Tile]:
        """Yield the named frames in blocks of rows, top to bottom, each file decoded once.

        Parameters
        ----------
        frames : sequence of int
            Indices, in the order in which the tiles hold them.
        max_bytes : int
            Bound of a tile's arrays; at least one row is always held. A stack beyond it is spooled, as stored, to a
            temporary file.

        Yields
        ------
        Tile
        """
        self._check_indices(frames)
        return iterate_tiles(self._read, self._linear, self._valid, frames, (self.height, self.width), max_bytes)

    def stack(self, frames: Sequence[int]) -> NDArray[np.float32]:
        """Linear radiance of the named frames, (len(frames), height, width, 3), all in memory."""
        self._check_indices(frames)
        out = np.empty((len(frames), self.height, self.width, 3), np.float32)
        for i, samples, target in zip(frames, decoded(self._read, frames), out, strict=True):
            self._linear(i, samples, target)
        return out

    def encode(self, i_or_transfer: int | str, linear: ArrayLike) -> NDArray[np.float32]:
        """Linear radiance to stored values in 0..1, clipped: the inverse of how a frame is read.

        Parameters
        ----------
        i_or_transfer : int or str
            A frame, whose transfer and scale are inverted, or the name of a transfer function.
        linear : (...,) float
        """
        if isinstance(i_or_transfer, str):
            return np.asarray(transfers.encode(i_or_transfer, linear), dtype=np.float32)
        frame = self.frames[i_or_transfer]
        return np.asarray(transfers.encode(frame.transfer, np.asarray(linear) / frame.scale), dtype=np.float32)

    def validate(self) -> None:
        """Decode every picture and variance once; raises `InputError` at the first that is damaged or not finite."""
        for i in range(len(self.frames)):
            self._read(i)
            self.variance(i)

    def path(self, i: int) -> Path:
        """File of frame `i`."""
        return self._paths[i]

    def _check_indices(self, frames: Sequence[int]) -> None:
        for i in frames:
            if not 0 <= i < len(self.frames):
                raise InputError(f"{self.source}: frames: there is no frame {i}; the set has 0 to {len(self) - 1}")

    def _checked_path(self, name: str, field: str) -> Path:
        return inside(self.folder, name, f"{self.source}: {field}", self._root)

    def _header(self, path: Path, field: str) -> Header:
        try:
            return read_header(path)
        except PictureError as error:
            name = path.relative_to(self.folder) if path.is_relative_to(self.folder) else path
            raise InputError(f"{self.source}: {field}: {str(name)!r} {error}") from None

    def _check_frame(self, i: int) -> None:
        frame, field = self.frames[i], f"{self.source}: frames[{i}]"
        files = [("image", frame.image, self._headers[i])]
        if frame.variance is not None:
            path = self._checked_path(frame.variance, f"frames[{i}].variance")
            files.append(("variance", frame.variance, self._header(path, f"frames[{i}].variance")))
        like = "the first picture" if self.camera is None else "the camera"
        for key, name, header in files:
            if (header.height, header.width) != (self.height, self.width):
                raise InputError(
                    f"{field}.{key}: {name!r} is {header.width} x {header.height} pixels, "
                    f"expected {self.width} x {self.height} like {like}"
                )
        try:
            transfers.gamma_of(frame.transfer)
        except InputError as error:
            raise InputError(f"{field}.{error}") from None
        if frame.transfer != "linear" and not self._headers[i].is_integer:
            raise InputError(
                f"{field}.transfer: {frame.transfer!r} is for integer pictures, and {frame.image!r} is an EXR"
            )
        if self.camera is None and not frame.light.is_distant:
            raise InputError(f"{field}.light.position: a near light needs a camera, which is null")

    def _read(self, i: int) -> Stored:
        try:
            samples = read_picture(self._paths[i], self._headers[i])
            check_finite(samples)
        except PictureError as error:
            raise InputError(f"{self.source}: frames[{i}].image: {self.frames[i].image!r} {error}") from None
        return samples

    @staticmethod
    def _stored(samples: Stored) -> NDArray[np.float32]:
        top = np.float32(np.iinfo(samples.dtype).max if samples.dtype.kind == "u" else 1)
        return samples.astype(np.float32) / top

    def _linear(self, i: int, samples: Stored, out: NDArray[np.float32]) -> None:
        """Put the linear radiance of stored samples (h, width[, 3]) into `out` (h, width, 3)."""
        frame = self.frames[i]
        if samples.dtype.kind == "u":
            table = _table(frame.transfer, frame.scale, int(np.iinfo(samples.dtype).max))
            if samples.ndim == 3:
                np.take(table, samples, out=out, mode="clip")  # without a mode, take buffers its output
            else:
                out[...] = table[samples][..., None]
        else:
            np.multiply(samples if samples.ndim == 3 else samples[..., None], np.float32(frame.scale), out=out)

    def _valid(self, i: int, samples: Stored) -> NDArray[np.bool_]:
        saturation = self.frames[i].saturation
        if saturation is None:
            if samples.dtype.kind == "f":
                return np.ones(samples.shape[:2], dtype=bool)
            saturation = 1.0
        # Slices, because numpy's reduction over so short an axis takes ten times as long.
        top = (
            samples if samples.ndim == 2 else np.maximum(np.maximum(samples[..., 0], samples[..., 1]), samples[..., 2])
        )
        limit = saturation * (np.iinfo(samples.dtype).max if samples.dtype.kind == "u" else 1)
        return np.asarray(top.astype(np.float64) < limit)


@lru_cache(maxsize=64)
def _table(transfer: str, scale: float, top: int) -> NDArray[np.float32]:
    """Radiance of every value that an integer file can hold: exact, and faster than powers per pixel."""
    table = (scale * transfers.decode(transfer, np.arange(top + 1) / top)).astype(np.float32)
    table.setflags(write=False)
    return table


def _three(samples: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.repeat(samples[..., None], 3, axis=-1) if samples.ndim == 2 else samples


def inside(folder: Path, name: str, where: str, root: str | None = None) -> Path:
    """Path of the file `name` in `folder`; raises `InputError` beginning with `where` if it leads out of the folder.

    `root` is the folder's real path, for callers that ask about many files.
    """
    root = os.path.realpath(folder) if root is None else root
    try:
        # Strings, because a set has hundreds of files and pathlib takes most of the time to open it.
        escapes = os.path.commonpath([root, os.path.realpath(os.path.join(root, name))]) != root  # noqa: PTH118
    except ValueError:
        raise InputError(f"{where}: {name!r} is not a usable path") from None
    if escapes or name.startswith("/"):
        raise InputError(f"{where}: {name!r} leaves the dataset's folder; only relative paths inside it are read")
    return folder / name
