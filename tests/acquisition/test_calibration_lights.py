from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from acquisition.calibration.applying_lights import apply_lights
from acquisition.calibration.chrome import calibrate_lights, mean_picture
from acquisition.calibration.files import read_calibration, write_calibration
from acquisition.calibration.highlights import find_highlight
from acquisition.calibration.lights import CAMERA_AXES, LightsCalibration
from acquisition.calibration.outlines import Outline, detect_outlines, given_circle, of_sphere, outlines_of_mask
from acquisition.calibration.pictures import PictureFolder, linear_picture
from acquisition.calibration.spheres import MirrorSphere
from acquisition.dataset import open_dataset, write_dataset
from acquisition.importing.files import read_table
from stage.camera import Camera
from stage.errors import InputError
from stage.lights import Light, dome
from tests.acquisition.board_photographs import Taken

Array = NDArray[np.float64]

CAMERA = Camera.look_at(160, 120, 300.0, (0.0, -0.9, 0.75))
R = 0.06
PLACES = np.array([(-0.12, -0.05, 0.0), (0.0, 0.13, 0.0), (0.12, -0.04, 0.0)])
LIGHTS = np.array([light.position for light in dome(4, np.radians([45, 65]), 0.8)])
OUTLINES = [of_sphere(CAMERA, place, R) for place in PLACES]
DISC = given_circle(40.0, 30.0, 25.0)


def degrees(one: Array, other: Array) -> Array:
    sine = np.linalg.norm(np.cross(one, other), axis=-1)
    return np.asarray(np.degrees(np.arctan2(sine, (one * other).sum(-1))))


def spots(places: list[tuple[Array, float]], size: tuple[int, int], width: float = 1.2) -> Array:
    """Gaussian spots of given heights."""
    v, u = np.mgrid[: size[0], : size[1]]
    out = np.zeros(size)
    for (x, y), height in places:
        out += height * np.exp(-((u - x) ** 2 + (v - y) ** 2) / (2 * width**2))
    return out


def stage_pictures(extra: dict[int, tuple[Array, float]] | None = None, dark: int | None = None) -> Taken:
    """Three spheres' highlights in a dim room with a window that is mirrored in each, noise included."""
    rng = np.random.default_rng(0)
    window = [(one.centre + 0.6 * one.radius * np.array([-0.5, 0.6]), 1.5) for one in OUTLINES]
    images = []
    for i, light in enumerate(LIGHTS):
        lamp = [] if i == dark else [(MirrorSphere(p, R).highlight(CAMERA, light), 5.0) for p in PLACES]
        if extra and i in extra:
            lamp.append(extra[i])
        picture = spots(lamp + window, (120, 160)) + 0.02 + rng.normal(0, 0.002, (120, 160))
        images.append(np.repeat(picture.astype(np.float32)[..., None], 3, -1))
    return Taken(images, clipped_at=4.0)


def calibrated(pictures: Taken) -> LightsCalibration:
    return calibrate_lights(pictures, OUTLINES, name="toy", camera=CAMERA, radius_m=R)


@pytest.mark.parametrize("clip", [np.inf, 0.7, 0.4])
def test_a_spot_is_found_to_a_fraction_of_a_pixel_clipped_or_not(clip: float) -> None:
    true = np.array([45.3, 22.8])
    picture = spots([(true, 1.0)], (60, 80), 2.0)
    found = find_highlight(np.minimum(picture, clip), DISC, clipped=picture >= clip)
    assert found.pixel == pytest.approx(true, abs=0.05 if clip == np.inf else 0.15)
    assert (found.clipped_share > 0) == np.isfinite(clip)


def test_ambient_light_is_taken_off() -> None:
    true, lamp = np.array([50.0, 35.0]), np.array([30.0, 20.0])
    ambient = spots([(lamp, 3.0)], (60, 80), 2.5)
    picture = ambient + spots([(true, 1.0)], (60, 80))
    assert find_highlight(picture, DISC, ambient=ambient).pixel == pytest.approx(true, abs=0.05)
    assert find_highlight(picture, DISC).pixel == pytest.approx(lamp, abs=0.5)


def test_a_streak_that_scratches_make_does_not_pull_the_spot() -> None:
    v, u = np.mgrid[:60, :80].astype(float)
    lamp = np.hypot(u - 42, v - 28) < 5
    streak = (np.abs((u - 42) - 0.3 * (v - 28)) < 1.2) & (v > 28) & (v < 50)
    picture = np.where(lamp | streak, 1.0, 0.0)
    found = find_highlight(picture, DISC, clipped=picture > 0.9)
    assert found.pixel == pytest.approx((42, 28), abs=0.5)
    weight = picture / picture.sum()
    assert (weight * v).sum() - 28 > 2  # what the mean place of all that is bright would be off by


def test_a_weaker_reflection_of_the_lamp_is_passed_over() -> None:
    true = np.array([50.0, 35.0])
    found = find_highlight(spots([(true, 1.0), (np.array([28.0, 38.0]), 0.4)], (60, 80)), DISC)
    assert found.pixel == pytest.approx(true, abs=0.02)
    assert 0 < found.rival_share < 0.5


@pytest.mark.parametrize(
    ("places", "fault"),
    [
        ([], "no spot stands out"),
        ([(np.array([50.0, 35.0]), 1.0), (np.array([30.0, 20.0]), 0.95)], "two spots are about equally strong"),
        ([(np.array([40 + 24.8, 30.0]), 1.0)], "lies at the sphere's rim"),
        ([(np.array([75.0, 50.0]), 1.0)], "no spot stands out"),  # beside the sphere
    ],
)
def test_what_is_no_highlight_is_said_and_not_guessed(places: list[tuple[Array, float]], fault: str) -> None:
    noise = np.random.default_rng(1).normal(0, 0.01, (60, 80))
    found = find_highlight(spots(places, (60, 80), 0.6) + noise, DISC)
    assert found.pixel is None
    assert fault in found.fault


def test_positions_come_back_from_pictures() -> None:
    found = calibrated(stage_pictures())
    assert found.frame == "world"
    assert found.has_positions
    positions = np.array([light.position for light in found.lights])
    assert np.median(degrees(positions, LIGHTS)) < 0.5
    assert found.residuals["highlight_max_px"] < 0.3
    assert found.residuals["leave_one_out_max_deg"] < 3
    assert found.residuals["not_found_count"] == 0
    for one, place in zip(found.spheres, PLACES, strict=True):
        assert one.centre_m == pytest.approx(place, abs=1e-3)


def test_a_light_that_is_off_is_reported_as_not_found() -> None:
    found = calibrated(stage_pictures(dark=3))
    assert found.missing() == [3]
    assert found.lights[3].position is None
    assert "sphere 0: no spot stands out" in found.lights[3].note
    assert found.residuals["not_found_count"] == 1


def test_a_wrong_highlight_in_one_sphere_is_told_by_the_others() -> None:
    wrong = OUTLINES[1].centre + np.array([-7.0, -6.0])
    found = calibrated(stage_pictures(extra={2: (wrong, 40.0)}))
    assert found.lights[2].highlights_px[1] is None
    assert found.lights[2].note == "sphere 1: its highlight does not fit the others"
    assert degrees(np.array(found.lights[2].position), LIGHTS[2]) < 1.5


def test_without_a_radius_there_are_directions_only_and_one_sphere_gives_them_too() -> None:
    pictures = stage_pictures()
    for outlines in (OUTLINES, OUTLINES[1:2]):
        found = calibrate_lights(pictures, outlines, name="toy", camera=CAMERA)
        assert not found.has_positions
        places = PLACES if len(outlines) == 3 else PLACES[1:2]
        seen_from = (LIGHTS[:, None] - places).mean(1)
        directions = np.array([light.direction for light in found.lights])
        assert np.median(degrees(directions, seen_from)) < 3  # of a near light, as seen from the spheres' middle


def test_spheres_too_close_together_give_directions_and_say_why() -> None:
    places = np.array([(-0.002, 0, 0), (0.002, 0, 0)])
    outlines = [of_sphere(CAMERA, place, R) for place in places]
    images = []
    for light in LIGHTS[:3]:
        spot = MirrorSphere(places[0], R).highlight(CAMERA, light)
        images.append(np.repeat(spots([(spot, 1.0)], (120, 160)).astype(np.float32)[..., None], 3, -1))
    found = calibrate_lights(Taken(images), outlines, name="close", camera=CAMERA, radius_m=R)
    assert all(light.position is None and light.direction is not None for light in found.lights)
    assert "too close together to tell its distance" in found.lights[0].note


def test_a_calibration_survives_its_file(tmp_path: Path) -> None:
    found = calibrated(stage_pictures(dark=1))
    write_calibration(found, tmp_path / "lights.json")
    assert read_calibration(tmp_path / "lights.json") == found


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({"schema": "lightstage-calibration/2"}, "schema: expected 'lightstage-calibration/1'"),
        ({"kind": "sound"}, "kind: expected one of camera, .*lights.*, got 'sound'"),
        ({"frame": "moon"}, "frame: "),
        ({"moon": 1}, "moon: unknown key"),
        ({"lights": []}, "lights: "),
        ({"residuals": {"a_px": "much"}}, r"residuals\.a_px: "),
    ],
)
def test_a_damaged_file_is_one_sentence(tmp_path: Path, change: dict[str, object], fault: str) -> None:
    path = tmp_path / "lights.json"
    write_calibration(calibrated(stage_pictures()), path)
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(InputError, match=f"lights.json: {fault}"):
        read_calibration(path)


def test_a_dataset_takes_over_positions_and_names_the_calibration(tmp_path: Path) -> None:
    grey = np.full((120, 160, 3), 0.3, np.float32)
    off = [Light(position=tuple(p + 0.03), intensity=(1, 2, 3)) for p in LIGHTS]
    write_dataset(
        tmp_path / "set",
        name="object",
        frames=[(light, grey) for light in off],
        camera=CAMERA,
        provenance={"capture": {"software": "x"}},
    )
    write_calibration(calibrated(stage_pictures()), tmp_path / "lights.json")
    apply_lights(tmp_path / "lights.json", tmp_path / "set", tmp_path / "out")
    out = open_dataset(tmp_path / "out")
    found = read_calibration(tmp_path / "lights.json")
    assert isinstance(found, LightsCalibration)
    assert [light.position for light in out.lights] == [light.position for light in found.lights]
    assert out.lights[0].intensity == (1, 2, 3)
    assert out.provenance["capture"]["software"] == "x"
    (entry,) = out.provenance["capture"]["calibrations"]
    assert entry["kind"] == "lights"
    assert entry["file"] == "lights.json"
    assert len(entry["sha256"]) == 64
    assert entry["residuals"] == found.residuals
    write_calibration(calibrated(stage_pictures(dark=3)), tmp_path / "lights.json")
    with pytest.raises(InputError, match=r"lights\.json: lights\[3\]: was not found"):
        apply_lights(tmp_path / "lights.json", tmp_path / "set", tmp_path / "again")
    assert not (tmp_path / "again").exists()


def test_directions_turn_with_the_frame_they_are_wanted_in() -> None:
    found = calibrate_lights(stage_pictures(), OUTLINES, name="toy")
    assert found.frame == "camera"
    in_camera, in_world = found.direction_in_world(0, None), found.direction_in_world(0, CAMERA)
    assert in_camera is not None
    assert in_world is not None
    assert in_world == pytest.approx(CAMERA.world_to_camera[:3, :3].T @ CAMERA_AXES @ in_camera)
    assert degrees(in_world, LIGHTS[0]) < 15


@pytest.mark.data
def test_real_chrome_ball_against_the_students_solution(shared_data: Path) -> None:
    folder = shared_data / "uw-psm" / "chrome"
    mask = folder / "chrome.mask.png"
    outlines = outlines_of_mask(linear_picture(mask, "linear")[0].max(-1), str(mask))
    pictures = PictureFolder(folder, transfer="linear", without=(mask,))
    found = calibrate_lights(pictures, outlines, name="uw")
    reference = np.loadtxt(folder.parent / "lights.txt", skiprows=1)
    off = degrees(np.array([light.direction for light in found.lights]), reference)
    assert [light.picture for light in found.lights][-2:] == ["chrome.10.png", "chrome.11.png"]
    assert np.median(off) < 3  # the reference itself is good to 2 to 3 degrees
    assert np.sort(off)[-3] < 5  # two of its twelve lights are further off than that
    (detected,) = detect_outlines(mean_picture(pictures))
    assert detected.centre == pytest.approx(outlines[0].centre, abs=2)
    assert detected.radius == pytest.approx(outlines[0].radius, abs=2)


def probe(folder: Path) -> tuple[PictureFolder, Outline, Array]:
    """Pictures, circle (its origin is bottom left and its first pixel 1) and directions of a light probe of PSBox."""
    pictures = PictureFolder(folder, pattern="Image_*.JPG")
    x, y, radius = read_table(folder / "circle_data.txt").ravel()
    outline = given_circle(x - 1, pictures.image(0).shape[0] - y, radius)
    return pictures, outline, read_table(folder / "light_directions.txt").T


@pytest.mark.data
@pytest.mark.slow
@pytest.mark.parametrize("number", [1, 2])
def test_real_light_probes_against_their_authors_directions(shared_data: Path, number: int) -> None:
    pictures, outline, reference = probe(shared_data / "psbox-cat" / f"LightProbe-{number}")
    found = calibrate_lights(pictures, [outline], name="probe")
    off = degrees(np.array([light.direction for light in found.lights]), reference)
    assert found.residuals["not_found_count"] == 0
    assert np.median(off) < 0.7
    assert off.max() < 2
