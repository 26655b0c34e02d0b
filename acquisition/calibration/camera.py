"""Kind ``camera``: intrinsics and lens distortion from pictures of a ChArUco board, pose from the one at the origin.

Method of Z. Zhang, "A flexible new technique for camera calibration", PAMI 2000, as OpenCV's `calibrateCameraExtended`
carries it out. RAW files give pictures of one pixel per 2 x 2 photosites, and K speaks of these.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from acquisition.calibration.board import Board, BoardFinder, SeenCorners
from acquisition.calibration.files import Calibration, CalibrationPart, InputFile
from acquisition.calibration.pictures import Pictures
from acquisition.dataset.manifest import CameraEntry
from stage.camera import Camera
from stage.errors import InputError

Array = NDArray[np.float64]
Progress = Callable[[float], None]

LEAST_VIEWS = 4
"""Views of the board; three determine K without distortion, the fourth tells whether they agree."""

LEAST_CORNERS = 8
"""Corners of the board in a view that counts."""

LEAST_TILT_DEG = 10.0
"""Angle between the two board planes that differ most; parallel planes leave focal length and distance undetermined."""

LARGEST_FOCAL_SHARE = 0.05
"""Standard deviation of the focal length as a share of it, above which the views did not determine it."""

DISTORTION_NAMES = ("k1", "k2", "p1", "p2")


class BoardView(CalibrationPart):
    """One picture of the board.

    Attributes
    ----------
    picture : str
        Name of its file.
    corners : int
        That were found in it.
    rms_px : float or None
        Reprojection error; None for a picture with too few corners, which did not count.
    held_out_rms_px : float or None
        The same with intrinsics from all other views, only its pose being its own.
    tilt_deg : float or None
        Angle of the board's normal with the optical axis.
    """

    picture: str
    corners: int = Field(ge=0)
    rms_px: float | None = None
    held_out_rms_px: float | None = None
    tilt_deg: float | None = None


class CameraCalibration(Calibration):
    """A camera that stands still.

    Attributes
    ----------
    camera : CameraEntry
        As datasets and `rig.yaml` write it. `world_to_camera` is the identity where no picture shows the origin.
    board : Board
        That was photographed.
    origin_picture : str or None
        Picture in which the board lay at the stage's origin, and so gave the pose.
    height_m : float
        Height of the board's printed face above the origin there.
    std_px : dict
        Standard deviations of fx, fy, cx, cy.
    std_distortion : dict
        Standard deviations of the distortion coefficients.
    views : tuple of BoardView
        Every picture.
    """

    kind: Literal["camera"] = "camera"
    camera: CameraEntry
    board: Board
    origin_picture: str | None = None
    height_m: float = 0.0
    std_px: dict[str, float]
    std_distortion: dict[str, float] = Field(default_factory=dict)
    views: tuple[BoardView, ...]

    def calibrated(self) -> Camera:
        """The camera."""
        c = self.camera
        return Camera.create(c.width, c.height, c.K, c.world_to_camera, c.distortion)


def calibrate_camera(
    pictures: Pictures,
    board: Board,
    *,
    name: str,
    origin: int | None = None,
    height_m: float = 0.0,
    distortion: bool = True,
    inputs: Sequence[InputFile] = (),
    progress: Progress = lambda share: None,
) -> CameraCalibration:
    """Calibrate a camera from pictures of a board.

    Parameters
    ----------
    pictures : Pictures
        The board in various places and tilts.
    board : Board
        Its print.
    origin : int, optional
        Index of the picture in which the board's middle is at the stage's origin, face up, its drawing's right and top
        along x and y.
    height_m : float
        Height of the printed face above the origin in that picture: the board's thickness.
    distortion : bool
        Whether to determine the lens's distortion (k1, k2, p1, p2) or to take it as none.

    Raises
    ------
    InputError
        Where too few views show enough corners, their planes are parallel, the pictures differ in size, or the views
        leave the focal length undetermined.
    """
    seen, size = _corners(pictures, board, progress)
    good = [i for i, one in enumerate(seen) if len(one) >= LEAST_CORNERS]
    folder = pictures.path(0).parent
    if len(good) < LEAST_VIEWS:
        raise InputError(
            f"{folder}: board: {len(good)} of {len(seen)} pictures show {LEAST_CORNERS} corners or more of the board "
            f"{board.squares[0]} x {board.squares[1]} {board.dictionary}, expected at least {LEAST_VIEWS}; "
            "check the board's description and take more"
        )
    if origin is not None and origin not in good:
        raise InputError(
            f"{pictures.path(origin)}: origin: shows {len(seen[origin])} corners, expected {LEAST_CORNERS}"
        )
    places = board.corner_places()
    fitted = _fit([seen[i] for i in good], places, size, distortion)
    normals = np.stack([np.asarray(cv2.Rodrigues(turn)[0], dtype=float)[:, 2] for turn in fitted.turns])
    spread = float(np.degrees(np.arccos(np.clip(np.abs(normals @ normals.T).min(), 0, 1))))
    if spread < LEAST_TILT_DEG:
        raise InputError(
            f"{folder}: board: its views are parallel within {spread:.1f} degrees, expected planes {LEAST_TILT_DEG:g} "
            "degrees apart or more; tilt the board between pictures"
        )
    std_focal = max(fitted.std[:2])
    if not std_focal <= LARGEST_FOCAL_SHARE * fitted.K[0, 0]:
        raise InputError(
            f"{folder}: board: its views leave the focal length open ({fitted.K[0, 0]:.0f} pixels, standard deviation "
            f"{std_focal:.0f}); tilt the board more, fill more of the picture, or take more views"
        )
    views = _views(pictures, seen, good, fitted, normals, places, size, distortion)
    pose = np.eye(4)
    if origin is not None:
        k = good.index(origin)
        pose[:3, :3] = cv2.Rodrigues(fitted.turns[k])[0]
        pose[:3, 3] = fitted.moves[k] - pose[:3, 2] * height_m
    camera = Camera.create(size[0], size[1], fitted.K, pose, fitted.lens if distortion else ())
    held = [view.held_out_rms_px for view in views if view.held_out_rms_px is not None]
    residuals = {
        "reprojection_rms_px": fitted.rms,
        "worst_view_rms_px": max(view.rms_px for view in views if view.rms_px is not None),
        "held_out_rms_px": float(np.sqrt(np.mean(np.square(held)))),
        "views_count": float(len(good)),
        "plane_spread_deg": spread,
    }
    return CameraCalibration(
        name=name,
        camera=CameraEntry.model_validate(camera.to_json(), strict=False),
        board=board,
        origin_picture=None if origin is None else pictures.path(origin).name,
        height_m=height_m,
        std_px=dict(zip(("fx", "fy", "cx", "cy"), fitted.std[:4], strict=True)),
        std_distortion=dict(zip(DISTORTION_NAMES, fitted.std[4:8], strict=True)) if distortion else {},
        views=tuple(views),
        inputs=tuple(inputs),
        residuals=residuals,
    )


class _Fit:
    """What OpenCV found: K, distortion, one pose per view, and their uncertainties."""

    def __init__(self, found: Sequence[Any]) -> None:
        rms, self.K, lens, turns, moves, std, _, per_view = found
        self.rms = float(rms)
        self.lens: Array = np.asarray(lens, dtype=float).ravel()[:4]
        self.turns: list[Array] = [np.asarray(turn, dtype=float).ravel() for turn in turns]
        self.moves: list[Array] = [np.asarray(move, dtype=float).ravel() for move in moves]
        self.std: list[float] = np.asarray(std, dtype=float).ravel().tolist()
        self.per_view: list[float] = np.asarray(per_view, dtype=float).ravel().tolist()


def _fit(seen: Sequence[SeenCorners], places: Array, size: tuple[int, int], distortion: bool) -> _Fit:
    flags = cv2.CALIB_FIX_K3  # a handful of views cannot tell k3 from k2
    if not distortion:
        flags |= cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_ZERO_TANGENT_DIST
    objects = [places[one.ids].astype(np.float32) for one in seen]
    pixels = [one.pixels.astype(np.float32) for one in seen]
    try:
        return _Fit(cv2.calibrateCameraExtended(objects, pixels, size, np.eye(3), np.zeros(5), flags=flags))
    except cv2.error as error:
        raise InputError(
            f"board: its views determine no camera ({error.err}); tilt the board between pictures"
        ) from None


def _corners(pictures: Pictures, board: Board, progress: Progress) -> tuple[list[SeenCorners], tuple[int, int]]:
    finder, seen, size = BoardFinder(board), [], (0, 0)
    for i in range(len(pictures)):
        image = pictures.image(i)
        here = (image.shape[1], image.shape[0])
        if i and here != size:
            raise InputError(
                f"{pictures.path(i)}: is {here[0]} x {here[1]} pixels, expected {size[0]} x {size[1]} like the others"
            )
        size = here
        seen.append(finder.find(image))
        progress((i + 1) / len(pictures))
    return seen, size


def _views(
    pictures: Pictures,
    seen: Sequence[SeenCorners],
    good: Sequence[int],
    fitted: _Fit,
    normals: Array,
    places: Array,
    size: tuple[int, int],
    distortion: bool,
) -> list[BoardView]:
    """Every picture, those that count with their error inside and outside of the fit."""
    out = []
    for i, one in enumerate(seen):
        view = BoardView(picture=pictures.path(i).name, corners=len(one))
        if i in good:
            k = good.index(i)
            rest = _fit([seen[m] for m in good if m != i], places, size, distortion)
            view = view.model_copy(
                update={
                    "rms_px": fitted.per_view[k],
                    "held_out_rms_px": _own_pose_rms(one, places, rest),
                    "tilt_deg": float(np.degrees(np.arccos(np.clip(abs(normals[k, 2]), 0, 1)))),
                }
            )
        out.append(view)
    return out


def _own_pose_rms(one: SeenCorners, places: Array, fitted: _Fit) -> float:
    """Reprojection error of a view whose pose alone is fitted, pixels."""
    _, turn, move = cv2.solvePnP(places[one.ids], one.pixels, fitted.K, fitted.lens)
    predicted, _ = cv2.projectPoints(places[one.ids], turn, move, fitted.K, fitted.lens)
    off = np.asarray(predicted, dtype=float).reshape(-1, 2) - one.pixels
    return float(np.sqrt((off**2).sum(1).mean()))
