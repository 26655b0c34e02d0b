"""Pictures of a ChArUco board through a known camera: the drawing warped by each pixel's own ray."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from acquisition.calibration.board import Board
from stage.camera import Camera

Array = NDArray[np.float64]
PX_PER_SQUARE = 60
SUPERSAMPLING = 2


def poses(count: int, rng: np.random.Generator, tilt_deg: float = 35.0) -> list[Array]:
    """Board to camera transforms with tilts about changing axes, the board in the picture's middle half."""
    found = []
    for k in range(count):
        turn = 2 * np.pi * k / count
        axis = np.radians(tilt_deg) * np.array([np.cos(turn), np.sin(turn), 0.3 * rng.normal()])
        pose = np.eye(4)
        pose[:3, :3] = cv2.Rodrigues(axis)[0] @ np.diag([1, -1, -1])
        pose[:3, 3] = [0.05 * np.sin(2 * turn), 0.03 * np.cos(3 * turn), 0.42 + 0.08 * rng.random()]
        found.append(pose)
    return found


@cache
def fine_rays(camera: Camera) -> Array:
    """Rays of unit depth through each pixel's parts, camera frame."""
    n = SUPERSAMPLING
    step = (np.arange(n) + 0.5) / n - 0.5
    u, v = np.meshgrid(
        (np.arange(camera.width)[:, None] + step).ravel(), (np.arange(camera.height)[:, None] + step).ravel()
    )
    still = Camera.create(camera.width, camera.height, camera.K, np.eye(4), camera.distortion)
    return still.rays(np.stack([u, v], -1))


def photograph(
    board: Board, camera: Camera, board_to_camera: Array, rng: np.random.Generator, noise: float = 0.01
) -> NDArray[np.float32]:
    """Linear picture (height, width, 3) of the board, blurred by half a pixel and noisy, before a grey wall."""
    drawing = board.drawing(PX_PER_SQUARE).astype(np.float32) / 255
    n, rays = SUPERSAMPLING, fine_rays(camera)
    inverse = np.linalg.inv(board_to_camera)
    origin, along = inverse[:3, 3], rays @ inverse[:3, :3].T
    hit = origin - along * (origin[2] / along[..., 2])[..., None]
    square = board.square_m / PX_PER_SQUARE
    column = hit[..., 0] / square + drawing.shape[1] / 2 - 0.5
    row = drawing.shape[0] / 2 - 0.5 - hit[..., 1] / square
    seen = cv2.remap(drawing, column.astype(np.float32), row.astype(np.float32), cv2.INTER_LINEAR, borderValue=(0.4,))
    area = seen.reshape(camera.height, n, camera.width, n).mean((1, 3))
    picture = cv2.GaussianBlur(area, (0, 0), 0.5) + rng.normal(0, noise, area.shape)
    return np.repeat(np.asarray(picture, dtype=np.float32)[..., None], 3, -1)


class Taken:
    """Pictures in memory, as a calibration asks for them."""

    def __init__(self, images: list[NDArray[np.float32]], clipped_at: float = np.inf) -> None:
        self.images, self.clipped_at = images, clipped_at

    def __len__(self) -> int:
        return len(self.images)

    def image(self, i: int) -> NDArray[np.float32]:
        return self.images[i]

    def valid(self, i: int) -> NDArray[np.bool_]:
        return np.asarray((self.images[i] < self.clipped_at).all(-1))

    def path(self, i: int) -> Path:
        return Path("shots") / f"{i:02d}.exr"
