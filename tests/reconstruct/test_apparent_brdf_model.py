"""The apparent BRDF as a model: fitted, judged, kept on disk, and honest about where it breaks."""

from __future__ import annotations

import errno
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from acquisition.dataset import write_dataset
from reconstruct.apparent_brdf import samples
from reconstruct.apparent_brdf.model import UNRELIABLE, ApparentBrdf
from reconstruct.model import load_model, render_together
from stage.errors import InputError
from stage.lights import Light
from tests.reconstruct.analytic_scene import ALBEDO, Ball, Singles, far, near, rings, spiral

DOME = rings([10, 25, 40, 55, 70, 85], 12)
BALL = Ball()
GLOSSY = Ball(gloss=1.0)


def root_mean_square(values: np.ndarray[Any, Any]) -> float:
    return float(np.sqrt(np.mean(np.square(values, dtype=float))))


@pytest.fixture(scope="module")
def matte(tmp_path_factory: pytest.TempPathFactory) -> ApparentBrdf:
    dataset = BALL.dataset(tmp_path_factory.mktemp("matte") / "ball", near(DOME, intensity=(2.0, 3.0, 4.0)))
    return ApparentBrdf.fit(dataset, range(len(dataset)))


@pytest.fixture(scope="module")
def glossy(tmp_path_factory: pytest.TempPathFactory) -> ApparentBrdf:
    dataset = GLOSSY.dataset(tmp_path_factory.mktemp("glossy") / "ball", near(DOME))
    return ApparentBrdf.fit(dataset, range(len(dataset)))


def test_a_photographed_light_gives_its_photograph_and_no_doubt(matte: ApparentBrdf) -> None:
    for k in (0, 17, 71):
        assert_allclose(matte.render(matte.lights[k]).image, BALL.photograph(matte.lights[k]), rtol=1e-5, atol=1e-7)
        assert_allclose(matte.uncertainty(matte.lights[k]), 0, atol=1e-6)


def test_matte_ball_under_a_light_that_never_was(matte: ApparentBrdf) -> None:
    """Where all lights of a facet reach the point, the closed form is met; elsewhere only near the terminator not."""
    light = Light(position=(0.3, 0.2, 0.6), intensity=(5.0, 1.0, 0.5))
    rendering, truth = matte.render(light), BALL.photograph(light)
    assert not rendering.outside[BALL.mask].any()
    lit = np.ones(BALL.mask.shape, bool)
    triplets = matte.triplets(light)
    for k in range(len(matte.lights)):
        dark = (BALL.photograph(matte.lights[k]) == 0).all(-1)
        lit &= ~(dark & (triplets == k).any(-1))
    assert lit.sum() > 150
    assert_allclose(rendering.image[lit], truth[lit], rtol=2e-5, atol=1e-7)
    assert np.abs(rendering.image - truth).max() < 0.05 * truth.max()


def test_leaving_lights_out_prefers_the_plain_mean_for_a_matte_ball_and_roots_for_a_glossy_one(
    matte: ApparentBrdf, tmp_path: Path
) -> None:
    assert matte.interpolant.mean == "linear"
    assert matte.interpolant.weighting == "cosine-exact"
    sharp = Ball(gloss=2.0, shininess=200).dataset(tmp_path / "sharp", near(DOME))
    model = ApparentBrdf.fit(sharp, range(len(sharp)))
    assert model.interpolant.mean == "square-root"
    assert model.statistics()["mean_is_square_root"] == 1
    assert ApparentBrdf.fit(sharp, range(len(sharp)), mean="linear").interpolant.mean == "linear"


@pytest.mark.parametrize("lights", [far(DOME), near(DOME)])
def test_what_answers_alike_in_all_directions_stays_so(lights: list[Light], tmp_path: Path) -> None:
    """No cosine in the data, so the weighting that is exact for a cosine has to give way (K10)."""
    distant = lights[0].is_distant
    middle = np.zeros((*BALL.mask.shape, 3)) if distant else BALL.points
    frames = []
    for light in lights:
        _, attenuation = light.incident(middle)
        value = np.where(BALL.mask, 0.25 * attenuation, 0)
        frames.append((light, np.repeat(value[..., None], 3, axis=-1).astype(np.float32)))
    camera, depth = (None, None) if distant else (BALL.camera, BALL.depth)
    dataset = write_dataset(tmp_path / "glow", name="glow", frames=frames, camera=camera, depth=depth, mask=BALL.mask)
    model = ApparentBrdf.fit(dataset, range(len(dataset)))
    assert model.interpolant.weighting == "distance-normalised"
    wanted = Light(direction=(0.3, 0.2, 0.6)) if distant else Light(position=(0.3, 0.2, 0.6))
    expected = np.where(BALL.mask, 0.25 * wanted.incident(middle)[1], 0)
    assert_allclose(model.render(wanted).image[..., 0], expected, rtol=1e-5)


def test_uncertainty_is_the_size_of_the_error(glossy: ApparentBrdf) -> None:
    """One calibrated standard deviation: root mean squares agree within a factor of 2, and few errors exceed three."""
    rng = np.random.default_rng(5)
    errors, deviations = [], []
    for _ in range(25):
        direction = rng.normal((0, 0, 1.5))
        direction[2] = abs(direction[2]) + 0.3
        light = Light(position=tuple(direction / np.linalg.norm(direction)))
        error = np.sqrt(((glossy.render(light).image - GLOSSY.photograph(light)) ** 2).mean(-1))
        errors.append(error[GLOSSY.mask])
        deviations.append(glossy.uncertainty(light)[GLOSSY.mask])
    ratio = root_mean_square(np.concatenate(errors)) / root_mean_square(np.concatenate(deviations))
    assert 0.5 < ratio < 2
    assert (np.concatenate(errors) <= 3 * np.concatenate(deviations) + 1e-6).mean() > 0.9


def test_uncertainty_grows_beyond_the_rim(glossy: ApparentBrdf) -> None:
    by_elevation = [
        glossy.uncertainty(Light(position=(np.cos(e), 0.1, np.sin(e))))[GLOSSY.mask].mean()
        for e in np.radians([5, -10, -40])
    ]
    assert by_elevation[0] < by_elevation[1] < by_elevation[2]


def test_error_falls_with_more_lights_and_the_result_says_where_it_breaks(tmp_path: Path) -> None:
    """A narrow highlight: hopeless with 20 lights, and said to be; with lights enough it is met."""
    sharp = Ball(gloss=3.0, shininess=150)
    wanted = Light(direction=(0.25, 0.1, 0.9))
    truth = sharp.photograph(wanted)
    errors, claimed, warned = [], [], []
    for count in (20, 80, 400):
        dataset = sharp.dataset(tmp_path / str(count), far(spiral(count, 0.05)))
        model = ApparentBrdf.fit(dataset, range(count))
        errors.append(root_mean_square(model.render(wanted).image - truth) / root_mean_square(truth))
        claimed.append(model.statistics()["leave_one_out_rms_of_signal"])
        warned.append(any("too sparse" in sentence for sentence in model.limits()))
    assert errors[0] > 3 * errors[2]
    assert claimed[0] > claimed[1] > claimed[2]
    assert claimed[0] > UNRELIABLE > claimed[2]
    assert warned[0]
    assert not warned[2]


def test_several_lights_superpose(matte: ApparentBrdf) -> None:
    """K12."""
    a, b = Light(position=(0.5, 0.1, 0.8), intensity=(1, 2, 3)), Light(direction=(0.1, -0.4, 1.0))
    both = render_together(matte, [(a, 2.0), (b, 0.5)])
    assert_allclose(both.image, 2 * matte.render(a).image + 0.5 * matte.render(b).image, rtol=1e-6)


def test_intensity_of_the_photographed_lights_is_divided_out(tmp_path: Path, matte: ApparentBrdf) -> None:
    rng = np.random.default_rng(0)
    lights = [Light(position=tuple(d), intensity=tuple(rng.uniform(0.5, 2, 3))) for d in DOME]
    model = ApparentBrdf.fit(BALL.dataset(tmp_path / "uneven", lights), range(len(lights)))
    wanted = Light(position=(0.2, 0.2, 0.7))
    assert_allclose(model.render(wanted).image, matte.render(wanted).image, rtol=1e-4, atol=1e-7)


def test_distant_lights_need_no_geometry(tmp_path: Path) -> None:
    dataset = BALL.dataset(tmp_path / "plain", far(DOME), geometry=False)
    model = ApparentBrdf.fit(dataset, range(0, len(dataset), 2))
    assert ApparentBrdf.cannot_fit(dataset) is None
    image = model.render(Light(direction=(0.2, 0.1, 1.0))).image
    assert root_mean_square(image - BALL.photograph(Light(direction=(0.2, 0.1, 1.0)))) < 0.02 * image.max()
    with pytest.raises(InputError, match=r"light\.position: a near light needs geometry\.depth"):
        model.render(Light(position=(0, 0, 1)))


def test_triplets_name_the_lights_of_each_pixel(matte: ApparentBrdf) -> None:
    """K20: for a light on a photographed place that light is among the three, and neighbours share triplets."""
    triplets = matte.triplets(matte.lights[30])
    assert (triplets[BALL.mask] == 30).any(-1).all()
    assert (triplets[~BALL.mask] == -1).all()
    near_light = matte.triplets(Light(position=(0.1, 0.1, 0.45)))
    assert len(np.unique(near_light[BALL.mask], axis=0)) > 20


def test_reflectance_function_of_a_pixel(matte: ApparentBrdf) -> None:
    """Fig. 1: for a Lambertian point albedo / pi * cos(theta), whatever the distance of the lights (K05)."""
    row, column = 12, 14
    directions, values = matte.reflectance_function(row, column)
    cosine = np.clip(directions @ BALL.normals[row, column], 0, None)
    assert_allclose(np.linalg.norm(directions, axis=1), 1)
    assert_allclose(values, cosine[:, None] * ALBEDO / np.pi, rtol=1e-4, atol=1e-6)
    with pytest.raises(InputError, match="row 0, column 0 is not on the object"):
        matte.reflectance_function(0, 0)
    with pytest.raises(InputError, match="row -1"):
        matte.reflectance_function(-1, 14)


@pytest.mark.parametrize("which", ["matte", "plain"])
def test_saved_model_renders_the_same(which: str, matte: ApparentBrdf, tmp_path: Path) -> None:
    model = matte
    if which == "plain":
        model = ApparentBrdf.fit(
            BALL.dataset(tmp_path / "plain", far(DOME), geometry=False), range(40), beyond="nearest-light"
        )
    folder = tmp_path / "model"
    folder.mkdir()
    model.save(folder)
    folder = folder.rename(tmp_path / "moved")  # self-contained
    again = load_model(folder)
    assert isinstance(again, ApparentBrdf)
    assert isinstance(again.images, np.memmap)
    for light in (Light(direction=(0.3, 0.1, 0.9)), Light(direction=(1.0, 0.1, -0.5))):
        assert_array_equal(again.render(light).image, model.render(light).image)
        assert_array_equal(again.render(light).outside, model.render(light).outside)
        assert_array_equal(again.uncertainty(light), model.uncertainty(light))
    assert again.statistics() == model.statistics()
    assert again.limits() == model.limits()
    info = json.loads((folder / "model.json").read_text())
    assert any("photographed viewpoint" in sentence for sentence in info["limits"])  # K24


def damage(folder: Path, how: str) -> str:
    """Break one file of a model folder; returns what the refusal must name."""
    path = folder / "model.json"
    info = json.loads(path.read_text())
    match how:
        case "missing array":
            (folder / "images.npy").unlink()
            return "images.npy: no such file"
        case "torn array":
            data = (folder / "points.npy").read_bytes()
            (folder / "points.npy").write_bytes(data[: len(data) // 2])
            return "points.npy: cannot be read as an array"
        case "wrong shape":
            np.save(folder / "images.npy", np.zeros((3, 2, 2, 3), np.float32))
            return "images.npy: expected float32 of shape"
        case "wrong type":
            np.save(folder / "object.npy", np.zeros((24, 28)))
            return "object.npy: expected bool"
        case "no lights":
            info["lights"] = info["frames"] = []
        case "bad light":
            info["lights"][3]["intensity"] = [-1, 0, 0]
        case "no centre":
            del info["centre"]
        case "unknown weighting":
            info["interpolant"]["weighting"] = "best"
        case "no points":
            info["has_points"] = False
    path.write_text(json.dumps(info))
    return "model.json: "


@pytest.mark.parametrize(
    "how",
    [
        "missing array",
        "torn array",
        "wrong shape",
        "wrong type",
        "no lights",
        "bad light",
        "no centre",
        "unknown weighting",
        "no points",
    ],
)
def test_damaged_model_names_the_file(how: str, matte: ApparentBrdf, tmp_path: Path) -> None:
    matte.save(tmp_path)
    named = damage(tmp_path, how)
    with pytest.raises(InputError, match=named) as refusal:
        load_model(tmp_path)
    assert str(refusal.value).startswith(str(tmp_path))
    assert "\n" not in str(refusal.value)


def test_photographs_larger_than_memory_live_in_a_file(
    matte: ApparentBrdf, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    dataset = BALL.dataset(tmp_path / "ball", near(DOME, intensity=(2.0, 3.0, 4.0)))
    monkeypatch.setattr(samples, "IN_MEMORY_BYTES", 0)
    model = ApparentBrdf.fit(dataset, range(len(dataset)))
    assert isinstance(model.images, np.memmap)
    light = Light(position=(0.2, 0.3, 0.8))
    assert_array_equal(model.render(light).image, matte.render(light).image)

    def full(_file: int, _start: int, _size: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("os.posix_fallocate", full)
    with pytest.raises(InputError, match=r"TMPDIR: no room for \d+ MiB of photographs \(No space left"):
        ApparentBrdf.fit(dataset, range(len(dataset)))


def test_saturated_and_dark_samples_are_counted(tmp_path: Path) -> None:
    pictures: list[Singles] = [np.full((6, 5, 3), 0.5, np.float32) for _ in range(4)]
    pictures[1][0, :2] = 1.0
    pictures[2][1, 1] = 0.0
    dataset = write_dataset(
        tmp_path / "set",
        name="set",
        frames=[(light, p, {"saturation": 1.0}) for light, p in zip(far(spiral(4, 0.2)), pictures, strict=True)],
    )
    statistics = ApparentBrdf.fit(dataset, range(4)).statistics()
    assert statistics["saturated_samples_kept"] == 2
    assert statistics["dark_samples_kept"] == 1


def test_three_lights_are_enough_and_nothing_is_claimed_of_them(tmp_path: Path) -> None:
    dataset = BALL.dataset(tmp_path / "three", far(rings([45], 3)), geometry=False)
    model = ApparentBrdf.fit(dataset, range(3))
    assert model.assessment.trials == 0
    assert "leave_one_out_rms_of_signal" not in model.statistics()
    image = model.render(Light(direction=(0.1, 0.0, 1.0))).image
    assert_allclose(image, BALL.photograph(Light(direction=(0.1, 0.0, 1.0))), atol=0.1)


def test_repeated_and_holed_light_sets_are_reported(tmp_path: Path) -> None:
    kept = spiral(150, 0.05)
    kept = kept[kept @ [0.7, 0.0, 0.7] < 0.85]
    lights = far(np.vstack([kept, kept[:1]]))
    model = ApparentBrdf.fit(BALL.dataset(tmp_path / "holed", lights, geometry=False), range(len(lights)))
    assert model.statistics()["lights_in_repeated_directions"] == 1
    assert model.statistics()["facets_over_holes"] > 0
    assert any("holes" in sentence for sentence in model.limits())
    assert model.render(Light(direction=(0.7, 0.05, 0.7))).outside[BALL.mask].all()


def test_what_cannot_be_fitted_is_named(tmp_path: Path) -> None:
    shallow = BALL.dataset(tmp_path / "two", far(DOME[:2]), geometry=False)
    assert "at least three lights: there are 2" in str(ApparentBrdf.cannot_fit(shallow))
    picture = BALL.photograph(Light(direction=(0, 0, 1)))
    blind = write_dataset(
        tmp_path / "blind", name="blind", frames=[(x, picture) for x in near(DOME)], camera=BALL.camera, mask=BALL.mask
    )
    assert "needs geometry.depth" in str(ApparentBrdf.cannot_fit(blind))
    mixed = BALL.dataset(tmp_path / "mixed", [*near(DOME[:9]), *far(DOME[9:])])
    assert "some have a position and some a direction" in str(ApparentBrdf.cannot_fit(mixed))
    for dataset in (shallow, blind, mixed):
        with pytest.raises(InputError, match=r"dataset\.json: apparent-brdf needs"):
            ApparentBrdf.fit(dataset, range(len(dataset)))


@pytest.mark.parametrize(
    ("lights", "says"),
    [
        (
            [*far(DOME[:9]), Light(direction=(0, 0, 1), intensity=(1, 0, 1))],
            r"frames\[9\]\.light\.intensity: green is 0",
        ),
        (far(np.tile(DOME[:1], (6, 1))), "lights: 6 in 1 distinct directions"),
        (far(rings([0], 8)), "lights: all lie in one plane"),
    ],
)
def test_lights_that_cannot_be_used_are_named(lights: list[Light], says: str, tmp_path: Path) -> None:
    dataset = BALL.dataset(tmp_path / "set", lights, geometry=False)
    with pytest.raises(InputError, match=r"dataset\.json: " + says):
        ApparentBrdf.fit(dataset, range(len(dataset)))
    with pytest.raises(InputError, match="lights: 2 in 2 distinct directions"):
        ApparentBrdf.fit(BALL.dataset(tmp_path / "few", far(DOME), geometry=False), [0, 5])


def test_progress_only_grows_and_ends_at_one(tmp_path: Path) -> None:
    shares: list[float] = []
    dataset = BALL.dataset(tmp_path / "set", far(DOME), geometry=False)
    ApparentBrdf.fit(dataset, range(len(dataset)), shares.append)
    assert shares == sorted(shares)
    assert shares[-1] == pytest.approx(1)
