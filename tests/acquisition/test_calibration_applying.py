"""Calibrations listed in a rig: what they do to its pictures, to its description, and to what the dataset says."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from acquisition.calibration.applying import Corrections, load_corrections
from acquisition.calibration.board import Board
from acquisition.calibration.camera import CameraCalibration
from acquisition.calibration.dark import Dark, measure_dark
from acquisition.calibration.files import write_calibration
from acquisition.calibration.flat import Flat, measure_flat
from acquisition.calibration.frames import exposed_frames
from acquisition.calibration.response import Response
from acquisition.calibration.target import CalibratedLight, IntensityCalibration
from acquisition.dataset import IlluminationDataset
from acquisition.dataset.manifest import CameraEntry
from acquisition.developing import Geometry, develop
from acquisition.merging import Sample, merge
from acquisition.plan import CapturePlan, PlannedLight
from acquisition.radiance import read_frame
from acquisition.record import open_record
from acquisition.session import Session
from simulators.raw import through_filters
from stage.camera import Camera
from stage.errors import InputError
from stage.lights import dome
from stage.rig import Rig
from tests.acquisition.fake_stage import FULL, HEIGHT, SENSOR, WIDTH, FakeStage, StillClock, make_rig, noon

Array = NDArray[np.float64]

RIG = make_rig()
SHAPE = (HEIGHT, WIDTH, 3)
ONES = (1.0, 1.0, 1.0)
PLAN = CapturePlan(
    candidates=tuple(PlannedLight(position=light.position) for light in dome(3, [0.6], 0.5)),
    lights=(0, 2),
    exposures_s=(0.02,),
    dark_frames=0,
)


def a_dark(iso: float | None = None, width: int = WIDTH) -> Dark:
    offset = np.full((HEIGHT, width, 3), 500, np.float32)
    hot = np.zeros(offset.shape, bool)
    hot[2, 3, 1] = True
    return Dark(offset, offset / 100, hot, ONES, (0.1, 1.0), 8, iso, {"hot_share": 0.1})


def a_flat() -> Flat:
    response = np.linspace(0.5, 1.5, WIDTH, dtype=np.float32)[:, None] * np.ones(SHAPE, np.float32)
    response[5, 6, 2] = 0
    return Flat(response, None, None, 4, None, {"second_flat_share": 0.01})


def a_response() -> Response:
    """Gamma 2.2, clipped at 250."""
    curve = tuple((2.2 * np.log((np.arange(256) + 0.5) / 128.5)).tolist())
    std = (0.01,) * 256
    return Response(
        name="webcam",
        log_exposure=(curve, curve, curve),
        log_std=(std, std, std),
        clipped_at=250,
        observed=((0, 249),) * 3,
        exposures_s=(0.1, 1.0, 10.0),
        smoothness=ONES,
    )


def an_intensity(**fields: Any) -> IntensityCalibration:
    light = CalibratedLight(
        position=(0, 0, 1), nominal=FULL, intensity=(1, 2, 3), std=ONES, spread_share=0.01, usable_share=1
    )
    usual: dict[str, Any] = {
        "name": "led",
        "absolute": True,
        "albedo": ONES,
        "lights": (light,),
        "scale": ONES,
        "scale_std": ONES,
        "emission": "isotropic",
    }
    return IntensityCalibration(**usual | fields)


def a_camera(width: int = WIDTH, origin: str | None = "0.png") -> CameraCalibration:
    lens = Camera.look_at(width, HEIGHT, 55.0, (0.3, -1, 1))
    board = Board(squares=(5, 4), square_m=0.03, marker_m=0.02, dictionary="4X4_50")
    entry = CameraEntry.model_validate_json(json.dumps(lens.to_json()))
    return CameraCalibration(name="lens", camera=entry, board=board, origin_picture=origin, std_px={}, views=())


def files(folder: Path) -> list[Path]:
    """One of each kind for a camera that gives RAW files."""
    a_dark().save(folder / "dark.json", name="camera")
    a_flat().save(folder / "flat.json", name="camera")
    write_calibration(an_intensity(emitters=((1.5, 2.5, 3.5),)), folder / "led.json")
    write_calibration(a_camera(), folder / "lens.json")
    return [folder / f"{name}.json" for name in ("lens", "dark", "flat", "led")]


def captured(
    out: Path, plan: CapturePlan, rig: Rig, corrections: Corrections, stage: FakeStage | None = None
) -> IlluminationDataset:
    devices = (stage or FakeStage()).devices
    record = open_record(out, plan, resume=False)
    Session(record, rig, *devices, corrections=corrections, clock=StillClock(), now=noon).run()
    return develop(record, rig, geometry=Geometry(), name="wall", corrections=corrections)


def test_dark_and_flat_correct_what_the_sensor_did(tmp_path: Path) -> None:
    plain = captured(tmp_path / "plain", PLAN, RIG, Corrections.none())
    known = load_corrections(files(tmp_path)[1:3])
    found = captured(tmp_path / "found", PLAN, RIG, known)
    per_dn_s = np.array(SENSOR.radiance_per_dn_s()) / 0.02
    level = 500 + 0.02 * 5.0
    numbers = plain.image(0) / per_dn_s + 512
    expected = (numbers - level) * per_dn_s / np.linspace(0.5, 1.5, WIDTH)[:, None]
    saturation = found.frames[0].saturation
    assert saturation is not None
    measured = found.image(0) < saturation
    assert_array_equal(np.argwhere(~measured), [[2, 3, 1], [5, 6, 2]])
    assert_allclose(found.image(0)[measured], expected[measured], rtol=1e-5)
    assert found.provenance["capture"]["dark"] == "dark calibration"
    assert plain.provenance["capture"]["dark"] == "black level of the files"
    assert plain.provenance["capture"]["calibrations"] == []


def test_frames_without_the_lamp_come_before_the_dark_calibration(tmp_path: Path) -> None:
    plan = PLAN.model_copy(update={"dark_frames": 2})
    plain = captured(tmp_path / "plain", plan, RIG, Corrections.none())
    found = captured(tmp_path / "found", plan, RIG, load_corrections(files(tmp_path)[1:2]))
    saturation = found.frames[0].saturation
    assert saturation is not None
    measured = found.image(0) < saturation
    assert_array_equal(np.argwhere(~measured), [[2, 3, 1]])
    assert_allclose(found.image(0)[measured], plain.image(0)[measured], rtol=1e-6)
    assert found.provenance["capture"]["dark"] == "frames without the lamp"


def test_the_dataset_names_every_calibration(tmp_path: Path) -> None:
    paths = files(tmp_path)
    known = load_corrections(paths)
    found = captured(tmp_path / "found", PLAN, known.rig(RIG), known)
    named = found.provenance["capture"]["calibrations"]
    assert [one["kind"] for one in named] == ["camera", "dark", "flat", "intensity"]
    for one, path in zip(named, paths, strict=True):
        assert one["file"] == path.name
        assert one["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
        assert one["made"] == json.loads(path.read_text())["made"]
    assert named[2]["residuals"] == {"second_flat_share": 0.01}
    assert found.frames[0].light.intensity == (1.5, 2.5, 3.5)
    assert found.camera is not None
    assert found.camera.K[0, 0] == 55.0


def test_a_rig_takes_over_camera_and_lamp(tmp_path: Path) -> None:
    paths = files(tmp_path)
    calibrated = load_corrections(paths).rig(RIG)
    assert calibrated.camera.K[0][0] == 55.0
    assert calibrated.camera.world_to_camera != RIG.camera.world_to_camera
    assert calibrated.light.emitters[0].intensity == (1.5, 2.5, 3.5)
    assert calibrated.motion == RIG.motion
    assert load_corrections(paths).rig(calibrated) == calibrated
    write_calibration(a_camera(origin=None), paths[0])
    lens_only = load_corrections(paths[:1]).rig(RIG)
    assert lens_only.camera.K[0][0] == 55.0
    assert lens_only.camera.world_to_camera == RIG.camera.world_to_camera
    assert Corrections.none().rig(RIG) == RIG


def test_intensities_without_a_rig_serve_a_lamp_of_one_emitter(tmp_path: Path) -> None:
    write_calibration(an_intensity(), tmp_path / "led.json")
    known = load_corrections([tmp_path / "led.json"])
    assert known.rig(RIG).light.emitters[0].intensity == (1.0, 2.0, 3.0)
    tree = RIG.to_json()
    tree["light"]["emitters"] *= 2
    tree["light"]["emitters"][1] = {**tree["light"]["emitters"][0], "channel": 2}
    with pytest.raises(InputError, match=r"led\.json: emitters: the dataset it was made from did not name its rig"):
        known.rig(Rig.model_validate(tree))
    write_calibration(an_intensity(emitters=(ONES, ONES)), tmp_path / "led.json")
    with pytest.raises(InputError, match=r"led\.json: emitters: is of a lamp with 2 emitters, and the rig's has 1"):
        load_corrections([tmp_path / "led.json"]).rig(RIG)


def test_relative_intensities_do_not_serve_an_absolute_camera(tmp_path: Path) -> None:
    write_calibration(an_intensity(absolute=False), tmp_path / "led.json")
    known = load_corrections([tmp_path / "led.json"])
    with pytest.raises(InputError, match=r"led\.json: absolute: its intensities are relative"):
        known.rig(RIG)
    assert known.rig(make_rig(radiance_per_dn_s=None)).light.emitters[0].intensity == (1.0, 2.0, 3.0)


def picture(suffix: str, values: NDArray[Any]) -> bytes:
    return bytes(cv2.imencode(suffix, values[..., ::-1])[1].tobytes())


class PngStage(FakeStage):
    """Its camera gives 8-bit PNG pictures of gamma 2.2."""

    def __init__(self) -> None:
        super().__init__()
        self.camera.after = self._encode

    def _encode(self, shot: int, data: bytes) -> bytes:
        frame = read_frame(data, "x")
        linear = np.clip((frame.values - 512) / 16000, 0, 1)
        return picture(".png", np.rint(255 * linear ** (1 / 2.2)).astype(np.uint8))


DARK_FIRST = PLAN.model_copy(update={"dark_frames": 1})


def test_pictures_become_linear_by_their_response(tmp_path: Path) -> None:
    rig = make_rig(radiance_per_dn_s=None)
    raw = captured(tmp_path / "raw", DARK_FIRST, rig, Corrections.none())
    write_calibration(a_response(), tmp_path / "response.json")
    known = load_corrections([tmp_path / "response.json"])
    by_response = captured(tmp_path / "response", DARK_FIRST, rig, known, PngStage())
    gamma = rig.model_copy(
        update={
            "camera": rig.camera.model_copy(
                update={"device": rig.camera.device.model_copy(update={"transfer": "gamma:2.2"})}
            )
        }
    )
    by_name = captured(tmp_path / "name", DARK_FIRST, gamma, Corrections.none(), PngStage())
    for found in (by_response, by_name):
        ratio = found.image(0) / raw.image(0)
        assert_allclose(ratio, np.median(ratio), rtol=0.05)
    origin = by_response.provenance["capture"]
    assert origin["demosaic"] is None
    assert [one["kind"] for one in origin["calibrations"]] == ["response"]


def test_calibrations_of_raw_files_do_not_serve_pictures_nor_the_reverse(tmp_path: Path) -> None:
    paths = files(tmp_path)
    rig = make_rig(radiance_per_dn_s=None)
    with pytest.raises(InputError, match=r"dark\.json: kind: a dark calibration is for RAW files, and raw/.* is none"):
        captured(tmp_path / "a", PLAN, rig, load_corrections(paths[1:2]), PngStage())
    write_calibration(a_response(), tmp_path / "response.json")
    with pytest.raises(InputError, match=r"IMG\.DNG: a response curve is for 8-bit pictures"):
        captured(tmp_path / "b", PLAN, rig, load_corrections([tmp_path / "response.json"]))
    with pytest.raises(InputError, match=r"response\.json: kind: is for 8-bit pictures, and .*dark\.json is for RAW"):
        load_corrections([paths[1], tmp_path / "response.json"])


def test_lists_that_contradict_themselves(tmp_path: Path) -> None:
    paths = files(tmp_path)
    a_dark().save(tmp_path / "other.json", name="other")
    with pytest.raises(InputError, match=r"other\.json: kind: is a second calibration of kind 'dark', besides .*dark"):
        load_corrections([*paths, tmp_path / "other.json"])
    with pytest.raises(InputError, match=r"gone\.json: no such file"):
        load_corrections([tmp_path / "gone.json"])
    next(tmp_path.glob("flat.response-*.exr")).write_bytes(b"another")
    with pytest.raises(InputError, match=r"flat\.json: response\.sha256: .* is not the map"):
        load_corrections(paths)


def test_what_is_of_another_camera(tmp_path: Path) -> None:
    a_dark(width=20).save(tmp_path / "dark.json", name="other")
    known = load_corrections([tmp_path / "dark.json"])
    for use in (lambda: known.rig(RIG), lambda: captured(tmp_path / "a", PLAN, RIG, known)):
        with pytest.raises(InputError, match=r"dark\.json: width, height: is of 20 x 12 pixels, expected 14 x 12"):
            use()
    write_calibration(a_camera(width=20), tmp_path / "lens.json")
    with pytest.raises(InputError, match=r"lens\.json: width, height: is of 20 x 12 pixels"):
        load_corrections([tmp_path / "lens.json"]).rig(RIG)
    a_dark(iso=400.0).save(tmp_path / "dark.json", name="other")
    frame = read_frame(SENSOR.dng(np.full((2 * HEIGHT, 2 * WIDTH), 600, np.uint16), 0.1, 100), "x.dng")
    with pytest.raises(InputError, match=r"dark\.json: iso: was measured at ISO 400, and x\.dng was taken at ISO 100"):
        load_corrections([tmp_path / "dark.json"]).require_fit(replace(frame, iso=100.0), "x.dng")


def test_corrected_noise_is_that_of_the_sensor(tmp_path: Path) -> None:
    """A sensor with vignetting and dark current, calibrated, shows an even wall evenly."""
    rng = np.random.default_rng(4)
    across = np.linspace(0.6, 1.0, 60)

    def taken(name: str, light: float, exposure_s: float) -> Path:
        wall = through_filters(np.full((40, 60, 3), light) * across[:, None])
        path = tmp_path / f"{name}.dng"
        path.write_bytes(SENSOR.dng(SENSOR.read(wall, exposure_s, 100, rng), exposure_s, 100))
        return path

    darks = [taken(f"dark{i}{t}", 0, t) for t in (0.01, 2.0) for i in range(8)]
    dark = measure_dark(exposed_frames(darks))
    flat = measure_flat(exposed_frames([taken(f"flat{i}", 0.3, 0.1) for i in range(30)]), dark=dark)
    seen = read_frame(taken("wall", 0.1, 0.2).read_bytes(), "wall.dng")
    found = merge(
        [Sample.of(seen, 0.2, dark=dark.at(0.2))],
        room=seen.white - seen.black,
        per_dn_s=SENSOR.radiance_per_dn_s(),
        flat=flat.response,
    )
    green = found.image[..., 1]
    assert_allclose(green.mean(0), 0.1 * across.mean(), rtol=0.03)
    assert green.std() / green.mean() < 1.5 / np.sqrt(2 * 0.1 * 0.2 * 4e5 * 0.8)
