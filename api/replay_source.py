"""Photographs of a folder as the pictures of a replay camera."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from acquisition.dataset.images import encode_exr
from acquisition.importing import load_any
from drivers.replay_camera import Photograph
from stage.errors import DeviceError, InputError
from stage.lights import Light
from stage.rig import Replay

Array = NDArray[np.float64]


class World(Protocol):
    """What knows where the light is, such as `simulators.world.RigWorld`."""

    def now(self) -> float:
        """Time, seconds."""
        ...

    def light(self, at_s: float) -> tuple[Array, Array]:
        """Position (3,) and radiant intensity (3,) of the lamp at a time."""
        ...


def lit_in(world: World) -> Callable[[], Light | None]:
    """What light a world shows now; None where its lamp is dark."""

    def lit() -> Light | None:
        position, intensity = world.light(world.now())
        if not intensity.any():
            return None
        return Light(position=tuple(position.tolist()), intensity=tuple(intensity.tolist()))

    return lit


class DatasetPhotographs:
    """A folder that ``import`` reads, as a `drivers.replay_camera.ReplaySource`.

    Each photograph goes as its file is, where the rig's camera reads that as the dataset does; else as an EXR of its
    linear values, which does not tell where it was clipped.

    Parameters
    ----------
    device : Replay
        Folder, transfer function and how near is near enough.

    Raises
    ------
    InputError
        As `acquisition.importing.load_any`, after ``camera.device.folder``.
    """

    def __init__(self, device: Replay) -> None:
        self._device = device
        try:
            self._dataset = load_any(Path(device.folder))
        except InputError as error:
            raise InputError(f"camera.device.folder: {error}") from None
        aims = [frame.light.direction or frame.light.position for frame in self._dataset.frames]
        self._towards = np.array(aims, dtype=float)
        self._towards /= np.linalg.norm(self._towards, axis=1, keepdims=True)

    @property
    def name(self) -> str:
        """The folder."""
        return self._device.folder

    def photograph(self, light: Light | None) -> Photograph:
        """The photograph whose light is nearest in direction, seen from the stage's centre; black where it is dark.

        Raises
        ------
        DeviceError
            Where even the nearest is further than `within_deg`, or its file cannot be read.
        """
        if light is None:
            black = np.zeros((self._dataset.height, self._dataset.width, 3), np.uint16)
            return Photograph(cv2.imencode(".png", black)[1].tobytes(), "dark.png")
        aim = np.array(light.direction or light.position)
        aim /= np.linalg.norm(aim)
        # the chord, because the cosine of a small angle is 1 to all digits
        angle_deg = np.degrees(2 * np.arcsin(np.clip(np.linalg.norm(self._towards - aim, axis=1) / 2, 0, 1)))
        nearest = int(angle_deg.argmin())
        if not angle_deg[nearest] <= self._device.within_deg:
            raise DeviceError(
                f"replay of {self.name}: the light is {angle_deg[nearest]:.2f} degrees from where the nearest "
                f"photograph, {self._dataset.frames[nearest].image!r}, was taken, and camera.device.within_deg allows "
                f"{self._device.within_deg:g}; plan lights where photographs were taken"
            )
        data, suffix = self._file(nearest)
        frame = self._dataset.frames[nearest]
        metadata = {
            "photograph": frame.image,
            "light": str([round(value, 6) for value in self._towards[nearest].tolist()]),
            "light_intensity": str(list(frame.light.intensity)),
            "off_by_deg": f"{angle_deg[nearest]:.4f}",
        }
        return Photograph(data, f"{Path(frame.image).stem}{suffix}", metadata)

    def _file(self, i: int) -> tuple[bytes, str]:
        """A picture file and its suffix."""
        frame, path = self._dataset.frames[i], self._dataset.path(i)
        read_alike = frame.transfer == self._device.transfer or path.suffix.lower() == ".exr"
        try:
            if frame.scale == 1 and read_alike:
                return path.read_bytes(), path.suffix
            return encode_exr(self._dataset.image(i), name=str(path)), ".exr"
        except (InputError, OSError) as error:
            raise DeviceError(
                f"replay of {self.name}: {frame.image!r} cannot be read ({error}); check the folder"
            ) from error
