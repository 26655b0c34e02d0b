from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from acquisition.calibration.board import Board, BoardFinder
from acquisition.calibration.camera import CameraCalibration, calibrate_camera
from acquisition.calibration.files import read_calibration, write_calibration
from stage.camera import Camera
from stage.errors import InputError
from tests.acquisition.board_photographs import Taken, photograph, poses

BOARD = Board.parse("7x5,30mm,22mm,4X4_50")
K = np.array([[530.0, 0, 238.0], [0, 532.0, 182.0], [0, 0, 1]])
PINHOLE = Camera.create(480, 360, K, np.eye(4))
LENS = Camera.create(480, 360, K, np.eye(4), (-0.2, 0.08, 0.001, -0.0005))


@pytest.fixture(scope="module")
def through_lens() -> tuple[list[NDArray[np.float64]], Taken]:
    rng = np.random.default_rng(1)
    places = poses(7, rng)
    return places, Taken([photograph(BOARD, LENS, place, rng) for place in places])


def test_corners_are_where_the_board_frame_says() -> None:
    places = BOARD.corner_places()
    assert places.shape == (24, 3)
    assert np.abs(places.mean(0)).max() < 1e-8
    assert places[0] == pytest.approx((-0.075, 0.045, 0), abs=1e-8)  # upper left in the drawing: y is up
    rng = np.random.default_rng(0)
    (pose,) = poses(1, rng)
    seen = BoardFinder(BOARD).find(photograph(BOARD, PINHOLE, pose, rng, noise=0.0))
    camera = Camera.create(480, 360, K, pose)
    assert len(seen) >= 20
    assert np.abs(camera.project(places[seen.ids])[0] - seen.pixels).max() < 0.25


def test_camera_and_pose_come_back(through_lens: tuple[list[NDArray[np.float64]], Taken], tmp_path: Path) -> None:
    places, taken = through_lens
    found = calibrate_camera(taken, BOARD, name="lens", origin=2, height_m=0.005)
    camera = found.calibrated()
    wrong = np.array([camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2]]) - (530, 532, 238, 182)
    assert np.abs(wrong / list(found.std_px.values())).max() < 4  # as far off as it says
    assert np.abs(wrong).max() < 3
    # The lens bends rays alike all over the picture, whatever its coefficients trade among themselves.
    u, v = np.meshgrid(np.linspace(40, 440, 9), np.linspace(40, 320, 7))
    still = Camera.create(480, 360, camera.K, np.eye(4), camera.distortion)
    rays = [one.rays(np.stack([u, v], -1)).reshape(-1, 3) for one in (still, LENS)]
    units = [one / np.linalg.norm(one, axis=-1, keepdims=True) for one in rays]
    turn, _ = Rotation.align_vectors(*units)  # the principal point's error is a small turn of the camera
    assert np.median(np.linalg.norm(units[0] - turn.apply(units[1]), axis=-1)) * 530 < 0.3
    top = np.array([0, 0, 0.005, 1])  # the middle of the board's face, 5 mm above the origin
    assert (camera.world_to_camera @ top)[:3] == pytest.approx(places[2][:3, 3], abs=0.003)
    assert np.abs(camera.world_to_camera[:3, :3] - places[2][:3, :3]).max() < 0.01
    assert found.residuals["reprojection_rms_px"] < 0.15
    assert found.residuals["held_out_rms_px"] < 0.2
    assert found.origin_picture == "02.exr"
    write_calibration(found, tmp_path / "camera.json")
    again = read_calibration(tmp_path / "camera.json")
    assert isinstance(again, CameraCalibration)
    assert again == found


def test_too_few_views_and_parallel_views_are_refused(through_lens: tuple[list[NDArray[np.float64]], Taken]) -> None:
    _, taken = through_lens
    with pytest.raises(InputError, match=r"3 of 3 pictures show 8 corners or more .* expected at least 4"):
        calibrate_camera(Taken(taken.images[:3]), BOARD, name="x")
    with pytest.raises(InputError, match="0 of 4 pictures"):
        calibrate_camera(Taken(taken.images[:4]), Board.parse("7x5,30mm,22mm,6X6_50"), name="x")
    rng = np.random.default_rng(2)
    flat = Taken([photograph(BOARD, PINHOLE, pose, rng) for pose in poses(4, rng, tilt_deg=0.0)])
    with pytest.raises(InputError, match="views are parallel within"):
        calibrate_camera(flat, BOARD, name="x")
    odd = Taken([*taken.images[:4], taken.images[0][:-1]])
    with pytest.raises(InputError, match=r"04\.exr: is 480 x 359 pixels"):
        calibrate_camera(odd, BOARD, name="x")


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("7x5", "expected COLUMNSxROWS"),
        ("2x5,30mm,22mm,4X4_50", "squares: expected at least 3 x 3"),
        ("7x5,30mm,32mm,4X4_50", "marker_m: a marker is smaller"),
        ("7x5,30mm,22mm,9X9_50", "dictionary: expected one of OpenCV's"),
        ("999x999,30mm,22mm,4X4_50", "dictionary: 4X4_50 has 50 markers, and such a board shows 499000"),
    ],
)
def test_a_board_that_cannot_be_is_refused(text: str, fault: str) -> None:
    with pytest.raises(InputError, match=fault):
        Board.parse(text)
