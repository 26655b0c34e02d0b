"""From a record to datasets: matched by identity, corrected, with the variance that they really have."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from acquisition.calibration.applying import Corrections
from acquisition.calibration.dark import Dark
from acquisition.calibration.flat import Flat
from acquisition.calibration.response import Response
from acquisition.dataset import IlluminationDataset, open_dataset
from acquisition.developing import Geometry, develop, noise_sources
from acquisition.noise import SensorNoise
from acquisition.plan import CapturePlan, Shot
from acquisition.record import CaptureRecord
from simulators.raw import blocks_to_rgb
from stage.errors import InputError
from stage.rig import Rig
from tests.acquisition.fake_stage import FULL, make_rig
from tests.acquisition.recorded import SENSOR, Radiance, dng, plan_of, ramp, recorded, taken_of

WIDTH, HEIGHT = 48, 40
SIZE = WIDTH, HEIGHT
RIG = make_rig(width=WIDTH, height=HEIGHT)
SURFACE = ramp(*SIZE)
STRAY = 0.004
GAIN = SENSOR.electrons_per_dn()
READ_DN2 = (SENSOR.read_noise_e / GAIN) ** 2 + 1 / 12


def truth(candidate: int) -> NDArray[np.float64]:
    return 0.5 * SURFACE * (1 + 0.2 * candidate)


def lit(shot: Shot) -> NDArray[np.float64]:
    """The surface under each light, twice as bright at the second radius; the background is half as bright."""
    factor = {"second-surface": 2.0, "background": 0.5}.get(shot.part, 1.0)
    light = sum((truth(i) for i in shot.candidates), np.zeros_like(SURFACE))
    return np.asarray((0.8 if shot.kind == "flat" else factor * light) + STRAY)


def developed(
    out: Path, plan: CapturePlan, radiance: Radiance = lit, *, rig: Rig = RIG, options: Any = None, **record: Any
) -> IlluminationDataset:
    taken = recorded(out, plan, radiance, size=SIZE, **record)
    return develop(taken, rig, geometry=Geometry(), name="wall", **(options or {}))


def origin(data: IlluminationDataset) -> dict[str, Any]:
    found: dict[str, Any] = data.provenance["capture"]
    return found


def calibrations() -> Corrections:
    """What perfect calibrations of the sensor would say."""
    level = np.full((HEIGHT, WIDTH, 3), SENSOR.black_dn, np.float32)
    slope = np.full(level.shape, SENSOR.dark_current_e_s / GAIN, np.float32)
    read = (float(np.sqrt(READ_DN2)),) * 3
    dark = Dark(level, slope, np.zeros(level.shape, bool), read, (0.01, 1.0), 1000, 100.0, {})
    flat = Flat(np.ones_like(level), (GAIN,) * 3, (0.01,) * 3, 100, 100.0, {})
    return Corrections(dark=dark, flat=flat, files={"dark": Path("dark.json"), "flat": Path("flat.json")})


def chi_square(data: IlluminationDataset, frame: int, expected: NDArray[np.float64]) -> NDArray[np.float64]:
    variance = data.variance(frame)
    assert variance is not None
    return np.asarray(((data.image(frame) - expected) ** 2 / variance).mean((0, 1)))


def test_frames_belong_to_their_lights_in_whatever_order_they_were_taken(tmp_path: Path) -> None:
    plan = plan_of(lights=(2, 0, 1), dark_frames=2, repeats=2, exposures_s=(0.01, 0.04))
    whole = developed(tmp_path / "whole", plan)
    shuffled = np.random.default_rng(1).permutation(len(plan.shots())).tolist()
    mixed = developed(tmp_path / "mixed", plan, only=shuffled)
    assert origin(whole)["candidates"] == [2, 0, 1]
    for i, candidate in enumerate((2, 0, 1)):
        assert mixed.frames[i] == whole.frames[i]
        assert_array_equal(mixed.image(i), whole.image(i))
        assert whole.frames[i].light.position == plan.candidates[candidate].position  # type: ignore[union-attr]
        assert whole.frames[i].light.intensity == FULL
        assert chi_square(whole, i, truth(candidate)).max() < 1.2
    listed = sorted(origin(whole)["shots"], key=lambda one: one["shot"])
    assert [one["shot"] for one in listed] == list(range(len(plan.shots())))
    assert all(len(one["sha256"]) == 64 for one in listed)
    assert sorted(path.name for path in (tmp_path / "whole").iterdir()) == ["capture", "dataset.json", "images"]
    assert not list((tmp_path / "whole" / "capture").glob("developed*"))


def test_frames_that_were_taken_again_are_not_used(tmp_path: Path) -> None:
    plan = plan_of(1)
    record = recorded(tmp_path / "out", plan, lambda shot: 0.0, size=SIZE)
    shot = record.shots[0]
    record.add(taken_of(record, shot, dng(lit(shot), shot, SIZE)))
    bad = taken_of(record, shot, dng(9 * lit(shot), shot, SIZE), accepted=False)
    record.add(bad)
    data = develop(record, RIG, geometry=Geometry(), name="wall")
    assert_allclose(data.image(0).mean((0, 1)), (truth(0) + STRAY).mean((0, 1)), rtol=0.02)


def test_an_unfinished_capture_is_developed_only_on_demand(tmp_path: Path) -> None:
    plan = plan_of(3, exposures_s=(0.01, 0.04), dark_frames=1)
    record = recorded(tmp_path / "out", plan, lit, size=SIZE, only=[0, 2, 3, 4])
    with pytest.raises(InputError, match=r"capture: 4 of 8 shots are missing, 00001-dark-0.04s first"):
        develop(record, RIG, geometry=Geometry(), name="wall")
    assert not (tmp_path / "out" / "dataset.json").exists()
    data = develop(record, RIG, geometry=Geometry(), name="wall", partial=True)
    assert len(data) == 2
    assert origin(data)["candidates"] == [0, 1]
    missing = {shot.name for shot in record.missing}
    assert set(origin(data)["missing"]) == missing
    assert len(missing) == 4
    assert_allclose(data.image(1).mean((0, 1)), truth(1).mean((0, 1)), rtol=0.02)
    none = recorded(tmp_path / "none", plan, lit, size=SIZE, only=[0])
    with pytest.raises(InputError, match="holds no picture of the object"):
        develop(none, RIG, geometry=Geometry(), name="wall", partial=True)


def test_other_parts_become_datasets_that_tell_their_partners(tmp_path: Path) -> None:
    plan = plan_of(3, lights=(1, 2), dark_frames=2, repeats=2, background=True, second_radius_m=0.7)
    mask = np.arange(WIDTH) > np.zeros((HEIGHT, 1))
    record = recorded(tmp_path / "out", plan, lit, size=SIZE)
    shares: list[float] = []
    develop(record, RIG, geometry=Geometry(mask=mask), name="wall", progress=shares.append)
    assert shares == pytest.approx(np.arange(1, 7) / 6)
    for part, factor in (("second-surface", 2.0), ("background", 0.5)):
        data = open_dataset(tmp_path / "out" / part)
        assert data.name == f"wall {part}"
        assert data.camera is not None
        assert data.camera.to_json() == RIG.camera.calibration().to_json()
        assert_array_equal(data.mask, mask)
        assert origin(data)["part"] == part
        assert origin(data)["candidates"] == [1, 2]
        assert origin(data)["object_frames"] == [0, 1]
        for i, candidate in enumerate((1, 2)):
            assert chi_square(data, i, factor * truth(candidate)).max() < 1.2
            radius = 0.7 if part == "second-surface" else 0.5
            assert np.linalg.norm(data.frames[i].light.position or ()) == pytest.approx(radius)
    develop(record, RIG, geometry=Geometry(), name="wall")  # once more replaces them all
    assert len(open_dataset(tmp_path / "out" / "background")) == 2


SOURCES: list[tuple[str, dict[str, Any], str | None, str]] = [
    ("calibrations", {}, "dark calibration", "flat field"),
    ("repeats", {"repeats": 2, "dark_frames": 2}, "dark frames", "frames of one light"),
    ("only repeats", {"repeats": 2}, "frames of one light", "frames of one light"),
    ("nothing", {"dark_frames": 2}, None, ""),
]


@pytest.mark.parametrize(("case", "fields", "read", "gain"), SOURCES)
def test_the_noise_is_known_from_the_best_source(
    tmp_path: Path, case: str, fields: dict[str, Any], read: str | None, gain: str
) -> None:
    plan = plan_of(2, exposures_s=(0.01, 0.04), **fields)
    known = calibrations() if case == "calibrations" else None
    data = developed(tmp_path / "out", plan, options={"corrections": known})
    told = origin(data)["noise"]
    if read is None:
        assert told.startswith("unknown: it takes a dark and a flat calibration")
        assert origin(data)["merging"] == "exposure-time"
        assert data.variance(0) is None
        return
    assert (told["read_from"], told["gain_from"]) == (read, gain)
    assert origin(data)["merging"] == "noise-optimal"
    assert_allclose(told["electrons_per_dn"], GAIN, rtol=0.1)
    offset = 0 if plan.dark_frames else STRAY
    assert_allclose(chi_square(data, 1, truth(1) + offset), 1, atol=0.15)


def test_a_file_may_tell_its_own_noise(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told = SensorNoise.from_numbers(np.full(3, READ_DN2), np.full(3, GAIN), 100.0, "file", "file")
    monkeypatch.setattr(noise_sources, "noise_profile", lambda data, frame: told)
    data = developed(tmp_path / "out", plan_of(1, dark_frames=2))
    assert (origin(data)["noise"]["read_from"], origin(data)["noise"]["gain_from"]) == ("dark frames", "file")
    assert_allclose(origin(data)["noise"]["read_e"], SENSOR.read_noise_e, rtol=0.1)
    assert_allclose(chi_square(data, 0, truth(0)), 1, atol=0.15)


def test_the_mean_of_few_darks_is_part_of_the_variance(tmp_path: Path) -> None:
    """One dark frame doubles the read noise; without its share chi square would be near 2 in the dark."""
    data = developed(
        tmp_path / "out", plan_of(1, dark_frames=1), lambda shot: STRAY, options={"corrections": calibrations()}
    )
    assert_allclose(chi_square(data, 0, np.zeros_like(SURFACE)), 1, atol=0.15)


def test_variances_are_left_out_on_demand(tmp_path: Path) -> None:
    options = {"corrections": calibrations(), "variance": False}
    data = developed(tmp_path / "out", plan_of(2), options=options)
    assert data.variance(0) is None
    assert len(list((tmp_path / "out" / "images").iterdir())) == 2


@pytest.mark.parametrize("weighting", ["noise-optimal", "debevec", "exposure-time"])
def test_a_bracket_has_no_clipped_pixels_but_those_of_its_shortest(tmp_path: Path, weighting: str) -> None:
    bright = np.where(np.arange(WIDTH)[:, None] < WIDTH // 2, 1.0, 12.0) * np.ones((HEIGHT, 1, 3))
    bright[3, 4] = 1e4
    plan = plan_of(1, exposures_s=(0.005, 0.02, 0.08))
    options = {"weighting": weighting, "corrections": calibrations()}
    data = developed(tmp_path / "out", plan, lambda shot: bright, options=options)
    saturation = data.frames[0].saturation
    assert saturation is not None
    clipped = data.image(0) >= saturation
    assert_array_equal(np.argwhere(clipped.all(-1)), [[3, 4]])
    assert origin(data)["clipped_share"] == {"0": pytest.approx(1 / (WIDTH * HEIGHT))}
    assert_array_equal(data.valid(0), ~clipped.any(-1))
    assert_allclose(data.image(0)[~clipped], bright[~clipped], rtol=0.1)
    variance = data.variance(0)
    assert variance is not None
    assert_array_equal(variance == 0, clipped)


def test_flat_frames_make_a_flat_field(tmp_path: Path) -> None:
    """Of a bracket, the exposure time that suits the target; vignetting is gone from the pictures."""
    vignetting = blocks_to_rgb(np.repeat(np.repeat(np.linspace(0.6, 1, WIDTH) * np.ones((HEIGHT, 1)), 2, 0), 2, 1))

    def through_lens(shot: Shot) -> NDArray[np.float64]:
        return vignetting * (lit(shot) - STRAY) + STRAY

    plan = plan_of(1, dark_frames=8, flat_frames=20, exposures_s=(0.02, 2.0))
    data = developed(tmp_path / "out", plan, through_lens)
    assert origin(data)["flat"]["frames"] == 20
    assert origin(data)["noise"]["gain_from"] == "flat field"
    ratio = data.image(0) / truth(0)
    mean = vignetting.mean((0, 1))
    assert_allclose(ratio.mean(0), np.broadcast_to(mean, (WIDTH, 3)), rtol=0.02)
    with pytest.raises(InputError, match="none of 2 s has 2 that are well exposed"):
        developed(tmp_path / "clipped", plan_of(1, flat_frames=2, exposures_s=(2.0,)))


def waning(shot: Shot) -> NDArray[np.float64]:
    """The lamp loses 10 % from the first shot to the last of 24, in the order of time."""
    return np.asarray((lit(shot) - STRAY) * brightness(shot) + STRAY)


def brightness(shot: Shot) -> float:
    return float(1.05 - 0.1 * when(shot) / 24)


def when(shot: Shot) -> float:
    """Reference frames are taken between the others, whatever their indices."""
    return float(shot.index) if shot.kind != "reference" else 4.0 * (shot.index - 22) + 2.5


def at_its_time(shot: Shot) -> dict[str, Any]:
    minutes = int(when(shot) * 60)
    return {"started": f"2024-01-01T12:{minutes // 60:02d}:{minutes % 60:02d}+00:00"}


DRIFTING = plan_of(20, dark_frames=2, reference={"every": 4, "candidate": 0})


def test_a_lamp_that_wanes_is_corrected_by_its_reference_frames(tmp_path: Path) -> None:
    data = developed(tmp_path / "out", DRIFTING, waning, told=at_its_time)
    drift = origin(data)["lamp_drift"]
    assert drift["corrected"] == [True] * 3
    assert len(drift["brightness"]) == 6
    assert_allclose(drift["range_share"], 0.0833, atol=0.005)
    shots = [shot for shot in DRIFTING.shots() if shot.kind == "light"]
    expected = np.array([brightness(shot) for shot in shots])
    found = np.array([frame.light.intensity for frame in data.frames]) / FULL
    assert_allclose(found / found.mean(0), (expected / expected.mean())[:, None] * np.ones(3), rtol=4e-3)
    for i in (0, 10, 19):
        share = data.image(i) / data.frames[i].light.intensity / truth(i) * FULL
        assert_allclose(np.median(share, axis=(0, 1)) * found.mean(0) / expected.mean(), 1, rtol=6e-3)


def test_a_steady_lamp_is_left_alone(tmp_path: Path) -> None:
    data = developed(tmp_path / "out", DRIFTING, told=at_its_time)
    assert origin(data)["lamp_drift"]["corrected"] == [False] * 3
    assert {frame.light.intensity for frame in data.frames} == {FULL}


def test_what_is_wrong_with_the_files(tmp_path: Path) -> None:
    plan = plan_of(1)
    record = recorded(tmp_path / "out", plan, lit, size=SIZE)
    file = record.folder / record.taken[0].file
    file.write_bytes(file.read_bytes()[:-1] + b"?")
    with pytest.raises(InputError, match=rf"{file.name}: sha256: is not the file that was recorded"):
        develop(record, RIG, geometry=Geometry(), name="wall")
    assert not (tmp_path / "out" / "dataset.json").exists()
    assert not list(record.folder.glob("developed*"))


def test_a_dark_calibration_of_another_camera_is_refused(tmp_path: Path) -> None:
    known = replace(calibrations(), dark=None)
    assert known.flat is not None
    small = replace(known, flat=replace(known.flat, response=known.flat.response[:4]))
    record: CaptureRecord = recorded(tmp_path / "out", plan_of(1), lit, size=SIZE)
    with pytest.raises(InputError, match=r"flat\.json: width, height: is of 48 x 4 pixels"):
        develop(record, RIG, geometry=Geometry(), name="wall", corrections=small)


def test_the_manifest_is_what_json_can_hold(tmp_path: Path) -> None:
    developed(tmp_path / "out", plan_of(2, dark_frames=2, repeats=2, reference={"every": 2, "candidate": 0}))
    told = json.loads((tmp_path / "out" / "dataset.json").read_text())["provenance"]["capture"]
    assert {"software", "plan", "rig", "calibrations", "noise", "merging", "demosaic", "lamp_drift", "missing"} <= set(
        told
    )


def test_a_camera_of_8_bit_pictures_has_the_variance_of_its_response(tmp_path: Path) -> None:
    """Gamma 2.2 with a noise of one step: what is stated is what two lights alike differ by."""
    curve = tuple((2.2 * np.log((np.arange(256) + 0.5) / 128.5)).tolist())
    std = tuple((2.2 / (np.arange(256) + 0.5)).tolist())
    response = Response(
        name="webcam",
        log_exposure=(curve, curve, curve),
        log_std=(std, std, std),
        clipped_at=250,
        observed=((0, 249),) * 3,
        exposures_s=(0.1, 1.0, 10.0),
        smoothness=(1.0, 1.0, 1.0),
    )

    def png(shot: Shot, data: bytes) -> tuple[bytes, str]:
        noise = np.random.default_rng(shot.index).standard_normal(SURFACE.shape)
        stored = 255 * np.clip(SURFACE * shot.exposure_s / 0.04, 0, 1) ** (1 / 2.2) * (shot.kind == "light")
        values = np.clip(np.rint(stored + noise), 0, 255).astype(np.uint8)
        return bytes(cv2.imencode(".png", values[..., ::-1])[1].tobytes()), ".png"

    known = Corrections(response=response, files={"response": Path("response.json")})
    plan = plan_of(2, dark_frames=1, exposures_s=(0.01, 0.04))
    data = developed(tmp_path / "out", plan, encode=png, options={"corrections": known})
    assert origin(data)["noise"] == "response calibration"
    assert origin(data)["merging"] == "noise-optimal, by the response curve"
    assert origin(data)["demosaic"] is None
    one, other = (data.variance(i) for i in range(2))
    assert one is not None
    assert other is not None
    bright = np.broadcast_to(SURFACE > 0.2, one.shape)
    square = (data.image(0) - data.image(1)) ** 2 / (one + other)
    assert_allclose(square[bright].mean(), 1, atol=0.2)
