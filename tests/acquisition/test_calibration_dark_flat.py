"""Dark frames and flat fields: what a sensor of known noise, gain and faults is made of comes back."""

from __future__ import annotations

import json
import weakref
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from acquisition.calibration.dark import Dark, DarkCalibration, measure_dark, read_dark
from acquisition.calibration.files import InputFile
from acquisition.calibration.flat import Flat, FlatCalibration, measure_flat, read_flat
from acquisition.calibration.frames import ExposedFrame, exposed_frames
from acquisition.radiance import read_raw
from simulators.raw import Sensor, blocks_to_rgb
from stage.errors import InputError

Array = NDArray[np.float64]

SENSOR = Sensor(read_noise_e=6.0, dark_current_e_s=20.0)
GAIN = SENSOR.electrons_per_dn()
HEIGHT, WIDTH = 120, 160
EXPOSURES = (0.01, 1.0, 4.0)


def frame(mosaic: NDArray[np.integer], exposure_s: float, source: str = "frame", iso: int = 100) -> ExposedFrame:
    numbers = np.clip(mosaic, 0, SENSOR.white_dn).astype(np.uint16)
    raw = read_raw(SENSOR.dng(numbers, exposure_s, iso), source)
    return ExposedFrame(replace(raw, iso=float(iso)), exposure_s, source)


def dark_frames(each: int = 6, seed: int = 0) -> Iterator[ExposedFrame]:
    """A photosite of strong dark current at (10, 10), one of a large offset at (20, 21)."""
    rng = np.random.default_rng(seed)
    for exposure_s in EXPOSURES:
        for _ in range(each):
            numbers = SENSOR.read(np.zeros((HEIGHT, WIDTH)), exposure_s, 100, rng).astype(int)
            numbers[10, 10] += int(200 * exposure_s)
            numbers[20, 21] += 300
            yield frame(numbers, exposure_s)


def vignetting() -> Array:
    u, v = np.linspace(-1, 1, WIDTH), np.linspace(-1, 1, HEIGHT)[:, None]
    return np.asarray((1 + 0.3 * (u**2 + v**2)) ** -2)


def sensitivity() -> Array:
    """Vignetting and 1 % of pixel-to-pixel difference; the photosite at (50, 51) is dead."""
    differs = 1 + 0.01 * np.random.default_rng(7).standard_normal((HEIGHT, WIDTH))
    differs[50, 50], differs[50, 51], differs[51, 50] = 1, 0, 0  # both greens, so that the pixel's green is 0
    return vignetting() * differs


def flat_frames(light: float = 0.4, each: int = 6, shape: Array | float = 1.0, seed: int = 3) -> Iterator[ExposedFrame]:
    """An even surface times `shape`, under a lamp that wavers by 2 %."""
    rng = np.random.default_rng(seed)
    for exposure_s in (0.02, 0.05, 0.1):
        for _ in range(each):
            wave = 1 + 0.02 * rng.standard_normal()
            numbers = SENSOR.read(light * wave * sensitivity() * shape, exposure_s, 100, rng)
            yield frame(numbers, exposure_s, f"{exposure_s:g} s")


@pytest.fixture(scope="module")
def dark() -> Dark:
    return measure_dark(dark_frames())


@pytest.fixture(scope="module")
def flat(dark: Dark) -> Flat:
    return measure_flat(flat_frames(), dark=dark)


def test_offset_dark_current_and_read_noise_come_back(dark: Dark) -> None:
    assert_allclose(dark.read_noise_dn, np.sqrt((6 / GAIN) ** 2 + 1 / 12), rtol=0.03)
    assert_allclose(np.median(dark.slope, axis=(0, 1)), 20 / GAIN, rtol=0.01)
    assert_allclose(np.median(dark.offset, axis=(0, 1)), 512, atol=0.1)
    # Of 18 frames; the photons of dark current at 4 s add to the read noise.
    error = (dark.at(4.0) - 512 - 80 / GAIN)[~dark.hot.any(-1)]
    assert error.std() < 2.5
    assert (dark.exposures_s, dark.frames, dark.iso, dark.size) == (EXPOSURES, 18, 100.0, (WIDTH // 2, HEIGHT // 2))
    read_e, dark_e = 6.0**2, np.mean(20 * np.array(EXPOSURES))
    assert dark.residuals["line_rms_dn"] == pytest.approx(np.sqrt(read_e + dark_e) / GAIN, rel=0.05)


def test_hot_pixels_are_those_and_no_others(dark: Dark) -> None:
    assert_array_equal(np.argwhere(dark.hot), [[5, 5, 0], [10, 10, 1]])
    assert dark.residuals["hot_share"] == pytest.approx(2 / (HEIGHT * WIDTH / 4))


def test_a_sensor_without_any_noise_has_no_hot_pixels() -> None:
    still = np.full((HEIGHT, WIDTH), 512)
    still[4, 4] = 513
    found = measure_dark(frame(still, t) for t in (0.1, 0.1, 1.0))
    assert not found.hot.any()
    assert found.read_noise_dn == (0, 0, 0)


def test_a_flat_is_the_sensitivity_of_each_pixel(flat: Flat) -> None:
    expected = blocks_to_rgb(sensitivity())
    answers = flat.response > 0
    assert_array_equal(np.argwhere(~answers.all(-1)), [[5, 5], [10, 10], [25, 25]])
    expected /= np.array([expected[..., c][answers[..., c]].mean() for c in range(3)])
    error = flat.response[answers] / expected[answers] - 1
    assert error.std() < 0.006
    assert_allclose([flat.response[..., c][answers[..., c]].mean() for c in range(3)], 1, rtol=1e-5)
    # Half of the frames against the other half: twice the error of all of them.
    assert flat.residuals["second_flat_share"] == pytest.approx(2 * error.std(), rel=0.1)
    assert flat.residuals["second_flat_smooth_share"] < 0.001
    assert flat.residuals["unusable_share"] == pytest.approx(3 / (HEIGHT * WIDTH / 4))


def test_a_second_flat_is_even_once_corrected(flat: Flat, dark: Dark) -> None:
    second = measure_flat(flat_frames(seed=11), dark=dark)
    both = (flat.response > 0) & (second.response > 0)
    corrected = second.response[both] / flat.response[both]
    assert second.response[both].std() > 0.1
    assert corrected.std() == pytest.approx(flat.residuals["second_flat_share"] / np.sqrt(2), rel=0.1)


@pytest.mark.parametrize("with_dark", [True, False])
def test_the_photon_transfer_gives_the_gain(dark: Dark, with_dark: bool) -> None:
    found = measure_flat(flat_frames(each=10), dark=dark if with_dark else None)
    assert found.electrons_per_dn is not None
    assert found.electrons_per_dn_std is not None
    pulls = (np.array(found.electrons_per_dn) - GAIN) / np.array(found.electrons_per_dn_std)
    assert np.abs(pulls).max() < 4
    assert max(found.electrons_per_dn_std) < 0.02 * GAIN
    # Bins of 300 differences: their variances waver by the root of 2 / 300.
    assert found.residuals["photon_transfer_rms_share"] == pytest.approx(np.sqrt(2 / 300), rel=0.25)


def test_a_single_frame_of_each_exposure_gives_no_gain() -> None:
    found = measure_flat(flat_frames(each=1))
    assert found.electrons_per_dn is None
    assert "photon_transfer_rms_share" not in found.residuals


def test_a_known_shape_of_the_light_is_divided_out(dark: Dark, flat: Flat) -> None:
    across = np.linspace(0.5, 1.5, WIDTH) * np.ones((HEIGHT, 1))
    found = measure_flat(flat_frames(light=0.3, shape=across), dark=dark, shape=blocks_to_rgb(across) * 7)
    both = (flat.response > 0) & (found.response > 0)
    assert abs(found.response[both] / flat.response[both] - 1).mean() < 0.008
    half = blocks_to_rgb(across)[..., 0]
    half[:10] = 0
    assert not (measure_flat(flat_frames(light=0.3, shape=across), shape=half).response[:10] > 0).any()


def test_only_a_few_frames_are_ever_in_memory() -> None:
    alive: list[weakref.ref[ExposedFrame]] = []
    most = 0

    def watched(frames: Iterator[ExposedFrame]) -> Iterator[ExposedFrame]:
        nonlocal most
        for one in frames:
            alive.append(weakref.ref(one))
            most = max(most, sum(ref() is not None for ref in alive))
            yield one
            del one

    measure_dark(watched(dark_frames()))
    measure_flat(watched(flat_frames()))
    assert most <= 4  # the first, the last and this one, and one that the generator itself holds


def test_files_keep_them(tmp_path: Path, dark: Dark, flat: Flat) -> None:
    inputs = [InputFile(file="0001.dng", sha256="0" * 64)]
    written = dark.save(tmp_path / "dark.json", name="camera", inputs=inputs)
    again = read_dark(tmp_path / "dark.json")
    for field in ("offset", "slope", "hot"):
        assert_array_equal(getattr(again, field), getattr(dark, field))
    assert (again.read_noise_dn, again.exposures_s, again.frames, again.iso, again.residuals) == (
        dark.read_noise_dn,
        dark.exposures_s,
        dark.frames,
        dark.iso,
        dark.residuals,
    )
    assert isinstance(written, DarkCalibration)
    assert written.inputs == tuple(inputs)
    assert isinstance(flat.save(tmp_path / "flat.json", name="camera"), FlatCalibration)
    other = read_flat(tmp_path / "flat.json")
    assert_array_equal(other.response, flat.response)
    assert other.electrons_per_dn == flat.electrons_per_dn
    assert len(list(tmp_path.iterdir())) == 6


def test_a_newer_file_takes_the_place_of_an_older_one(
    tmp_path: Path, dark: Dark, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "dark.json"
    dark.save(path, name="old")
    newer = measure_dark(dark_frames(each=3, seed=9))
    with monkeypatch.context() as patch:
        patch.setattr("acquisition.calibration.dark.write_calibration", _full)
        with pytest.raises(InputError, match="full"):
            newer.save(path, name="new")
    assert_array_equal(read_dark(path).offset, dark.offset)
    assert len(list(tmp_path.iterdir())) == 4
    newer.save(path, name="new")
    assert_array_equal(read_dark(path).offset, newer.offset)
    assert len(list(tmp_path.iterdir())) == 4


def _full(*_: object) -> None:
    raise InputError("dark.json: output: the disk is full")


@pytest.mark.parametrize("field", ["offset", "slope", "hot"])
def test_maps_that_are_not_the_files_own(tmp_path: Path, dark: Dark, field: str) -> None:
    path = tmp_path / "dark.json"
    dark.save(path, name="camera")
    tree = json.loads(path.read_text())
    place = tmp_path / tree[field]["file"]
    data = place.read_bytes()
    place.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    with pytest.raises(InputError, match=rf"dark\.json: {field}\.sha256: '{place.name}' is not the map"):
        read_dark(path)
    place.unlink()
    with pytest.raises(InputError, match=rf"dark\.json: {field}\.file: '{place.name}' cannot be read"):
        read_dark(path)
    place.write_bytes(data)
    tree[field]["width"] += 1
    path.write_text(json.dumps(tree))
    with pytest.raises(InputError, match=rf"dark\.json: {field}: .* has the shape"):
        read_dark(path)


def dark_of(*exposures_s: float, light: float = 0.0, iso: int = 100, size: int = HEIGHT) -> list[ExposedFrame]:
    rng = np.random.default_rng(1)
    return [
        frame(SENSOR.read(np.full((size, WIDTH), light), t, iso, rng), t, f"{i}.dng", iso)
        for i, t in enumerate(exposures_s)
    ]


Frames = Callable[[], list[ExposedFrame]]


@pytest.mark.parametrize(
    ("frames", "reason"),
    [
        (list, "two exposure times or more, got \\[\\]"),
        (lambda: dark_of(0.1, 0.1), "two exposure times or more, got \\[0.1\\]"),
        (lambda: dark_of(0.1, 1.0), "two frames or more of one exposure time"),
        (lambda: dark_of(0.1, 0.1, 1.0, light=0.02), "2.dng: is no dark frame"),
        (lambda: dark_of(0.1) + dark_of(0.1, size=80), "0.dng: is 80 x 40 pixels, expected 80 x 60"),
        (lambda: dark_of(0.1) + dark_of(0.1, iso=400), "was taken at ISO 400, expected ISO 100 like"),
    ],
)
def test_dark_frames_that_will_not_do(frames: Frames, reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        measure_dark(frames())


@pytest.mark.parametrize(
    ("frames", "reason"),
    [
        (list, "expected two or more, got 0"),
        (lambda: dark_of(0.1, light=0.2), "expected two or more, got 1"),
        (lambda: dark_of(0.1, 0.1, light=3.0), "0.dng: 100.0 % of the flat frame is clipped; expose it less"),
        (lambda: dark_of(0.001, 0.001, light=0.2), "reaches 0.. % of the range only; expose it more"),
        (lambda: dark_of(0.1, light=0.2) + dark_of(0.1, light=0.2, size=80), "expected 80 x 60 like"),
    ],
)
def test_flat_frames_that_will_not_do(frames: Frames, reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        measure_flat(frames())


def test_a_dark_or_a_shape_of_something_else(dark: Dark) -> None:
    taken = dark_of(0.1, 0.1, light=0.2)
    with pytest.raises(InputError, match="shape: expected 80 x 60 pixels, got 5 x 6"):
        measure_flat(taken, shape=np.ones((6, 5)))
    with pytest.raises(InputError, match="lit in no pixel"):
        measure_flat(taken, shape=np.zeros((60, 80)))
    with pytest.raises(InputError, match="dark: is of 80 x 60 pixels, expected 80 x 40"):
        measure_flat(dark_of(0.1, 0.1, light=0.2, size=80), dark=dark)
    with pytest.raises(InputError, match=r"dark: holds for ISO 100, and 0\.dng was taken at ISO 400"):
        measure_flat(dark_of(0.1, 0.1, light=0.05, iso=400), dark=dark)


def test_frames_come_from_files_by_exposure(tmp_path: Path) -> None:
    mosaic = np.full((HEIGHT, WIDTH), 600, np.uint16)
    paths = []
    for i, exposure_s in enumerate((1.0, 0.01, 1.0, 0.01)):
        paths.append(tmp_path / f"{i}.dng")
        paths[-1].write_bytes(SENSOR.dng(mosaic + np.uint16(i), exposure_s, 100))
    shares: list[float] = []
    found = list(exposed_frames(paths, shares.append))
    assert [(one.exposure_s, one.raw.values[0, 0, 0]) for one in found] == [
        (0.01, 601),
        (0.01, 603),
        (1.0, 600),
        (1.0, 602),
    ]
    assert shares == sorted(shares)
    assert shares[-1] == 1
    (tmp_path / "torn.dng").write_bytes(paths[0].read_bytes()[:500])
    (tmp_path / "untimed.dng").write_bytes(SENSOR.dng(mosaic, 0.0, 100))
    for name, reason in (
        ("torn.dng", "cannot be decoded"),
        ("gone.dng", "cannot be read"),
        ("untimed.dng", "exposure"),
    ):
        with pytest.raises(InputError, match=rf"{name}.*{reason}"):
            list(exposed_frames([tmp_path / name]))
