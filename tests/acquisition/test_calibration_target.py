"""White targets: intensities, falloff and emission of lamps that are known come back as certain as they say."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from acquisition.calibration.applying import load_corrections
from acquisition.calibration.files import read_calibration_of, write_calibration
from acquisition.calibration.plane import Plane, lambertian_shape, plane_geometry
from acquisition.calibration.target import IntensityCalibration, measure_intensity
from acquisition.dataset import IlluminationDataset, write_dataset
from acquisition.merging import Sample, merge
from acquisition.radiance import read_raw
from simulators.scene import Relief
from simulators.world import RigWorld
from stage.camera import Camera
from stage.errors import InputError
from stage.lights import Light, dome
from stage.rig import Rig
from tests.acquisition.fake_stage import make_rig

Array = NDArray[np.float64]

WIDTH, HEIGHT = 72, 64
CAMERA = Camera.look_at(WIDTH, HEIGHT, 130.0, (0.0, -0.5, 1.0))
PLANE = Plane((0.0, 0.0, 0.0), (0.1, 0.0, 1.0))
ALBEDO = 0.8
NOMINAL = (2.0, 2.0, 4.0)


def lamps(count: int = 8, seed: int = 1) -> list[Light]:
    """On a dome whose radius wavers, each of its own intensity."""
    rng = np.random.default_rng(seed)
    return [
        Light(position=tuple(np.array(light.position) * rng.uniform(0.7, 1.3)), intensity=tuple(rng.uniform(1, 3, 3)))
        for light in dome(count // 2, np.radians([35, 65]), 0.5)
    ]


def photographs(
    lights: list[Light],
    *,
    noise: float = 0.01,
    falloff: float = 2.0,
    lobe: float = 0.0,
    dirty: bool = False,
    seed: int = 0,
) -> list[NDArray[np.float32]]:
    """The plane in closed form, with noise relative to the value; dirt stays where it is, glare wanders."""
    rng = np.random.default_rng(seed)
    points, _ = plane_geometry(CAMERA, PLANE)
    pictures = []
    for light in lights:
        place = np.array(light.position)
        away = points - place
        distance, radius = np.linalg.norm(away, axis=-1), np.linalg.norm(place)
        emitted = (away @ -place / (distance * radius)) ** lobe * (distance / radius) ** (2 - falloff)
        image = ALBEDO * lambertian_shape(CAMERA, PLANE, light) * emitted[..., None]
        image *= 1 + noise * rng.standard_normal(image.shape)
        if dirty:
            image[10:16, 10:16] *= 0.5
            i, j = rng.integers(20, 40, 2)
            image[i : i + 10, j : j + 10] *= 3
        pictures.append(image.astype(np.float32))
    return pictures


def dataset(folder: Path, lights: list[Light], pictures: list[Any], **options: Any) -> IlluminationDataset:
    """What a stage that takes all its lamps for equal makes of it."""
    told = [Light(position=light.position, intensity=NOMINAL) for light in lights]
    frames = [(light, picture, {"saturation": 100.0}) for light, picture in zip(told, pictures, strict=True)]
    return write_dataset(folder, **{"name": "white", "frames": frames, "camera": CAMERA, **options})


def measured(folder: Path, lights: list[Light], **made: Any) -> IntensityCalibration:
    return measure_intensity(dataset(folder / "white", lights, photographs(lights, **made)), albedo=ALBEDO, plane=PLANE)


def intensities(found: IntensityCalibration) -> tuple[Array, Array]:
    return np.array([one.intensity for one in found.lights]), np.array([one.std for one in found.lights])


def true(lights: list[Light]) -> Array:
    return np.array([light.intensity for light in lights])


def test_intensities_come_back_as_certain_as_they_say(tmp_path: Path) -> None:
    pulls = []
    for seed in range(3):
        lights = lamps(6, seed=seed)
        (tmp_path / str(seed)).mkdir()
        found, std = intensities(measured(tmp_path / str(seed), lights, seed=seed))
        assert (std < 1e-3 * found).all()
        pulls.append((found - true(lights)) / std)
    assert abs(np.mean(pulls)) < 0.4
    assert 0.75 < np.std(pulls) < 1.25


def test_dirt_and_glare_do_not_count(tmp_path: Path) -> None:
    lights = lamps()
    found = measured(tmp_path, lights, dirty=True)
    assert_allclose(intensities(found)[0], true(lights), rtol=1e-3)
    assert found.emission == "isotropic"
    assert found.residuals["target_spread_share"] < 0.015


def test_falloff_by_the_square_is_told_from_another(tmp_path: Path) -> None:
    for i, exponent in enumerate((2.0, 1.7)):
        (tmp_path / str(i)).mkdir()
        found = measured(tmp_path / str(i), lamps(), falloff=exponent)
        assert found.falloff_exponent is not None
        assert found.falloff_exponent_std is not None
        assert found.falloff_exponent_std < 0.003
        assert abs(found.falloff_exponent - exponent) < 4 * found.falloff_exponent_std


def test_a_lobe_is_taken_only_where_there_is_one(tmp_path: Path) -> None:
    lights = lamps()
    for i, (lobe, emission) in enumerate(((0.0, "isotropic"), (1.5, "lobe"))):
        (tmp_path / str(i)).mkdir()
        found = measured(tmp_path / str(i), lights, lobe=lobe)
        assert found.emission == emission
        assert found.lobe_exponent is not None
        assert found.lobe_exponent_std is not None
        assert abs(found.lobe_exponent - lobe) < 4 * found.lobe_exponent_std
        assert_allclose(intensities(found)[0], true(lights), rtol=2e-3)
        better = found.residuals["lobe_held_out_loss_share"] < found.residuals["isotropic_held_out_loss_share"] - 0.01
        assert better == (lobe > 0)


def test_where_falloff_and_lobe_look_alike_it_says_so(tmp_path: Path) -> None:
    # Straight above a level target, distance and emission angle tell the same.
    above = [Light(position=(0.0, 0.0, h), intensity=(1.0, 1.0, 1.0)) for h in (0.4, 0.401)]
    flat = Plane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    rng = np.random.default_rng(0)
    points, _ = plane_geometry(CAMERA, flat)
    pictures = []
    for light in above:
        away = points - np.array(light.position)
        cosine = -away[..., 2] / np.linalg.norm(away, axis=-1)
        image = ALBEDO * lambertian_shape(CAMERA, flat, light) * (cosine**2)[..., None]
        pictures.append((image * (1 + 0.01 * rng.standard_normal(image.shape))).astype(np.float32))
    found = measure_intensity(dataset(tmp_path / "a", above, pictures), albedo=ALBEDO, plane=flat)
    assert found.emission == "lobe"
    assert found.falloff_exponent_std is not None
    assert found.falloff_exponent_std > 0.5


def test_without_a_half_to_judge_by_a_lamp_is_isotropic(tmp_path: Path) -> None:
    lights = lamps()
    pictures = photographs(lights, lobe=1.5)
    row, column = (np.arange(n) // 2 // 4.375 for n in (HEIGHT, WIDTH))
    pictures[3][(row[:, None] + column).astype(int) % 2 == 0] = 200  # one colour of the chequerboard is clipped
    found = measure_intensity(dataset(tmp_path / "a", lights, pictures), albedo=ALBEDO, plane=PLANE)
    assert found.emission == "isotropic"
    assert "lobe_held_out_loss_share" not in found.residuals
    assert found.lobe_exponent == pytest.approx(1.5, abs=0.05)


def test_scale_is_what_all_lights_share(tmp_path: Path) -> None:
    lights = [Light(position=light.position, intensity=(1.8, 2.2, 4.0)) for light in lamps()]
    found = measured(tmp_path, lights)
    assert_allclose(found.scale, [0.9, 1.1, 1.0], rtol=1e-3)
    assert max(found.scale_std) < 5e-4
    assert found.residuals["between_lights_share"] < 1e-3
    assert not found.absolute
    assert found.emitters == ()


def test_the_rig_in_the_provenance_gives_the_emitters(tmp_path: Path) -> None:
    lights = [Light(position=light.position, intensity=(1.8, 2.2, 4.0)) for light in lamps()]
    emitters = [{"channel": 1, "intensity": [4.0, 4.0, 8.0]}]
    origin = {"radiance_per_dn_s": [1, 1, 1], "rig": {"light": {"emitters": emitters}}}
    lit = dataset(tmp_path / "a", lights, photographs(lights), provenance={"capture": origin})
    found = measure_intensity(lit, albedo=ALBEDO, plane=PLANE)
    assert found.absolute
    assert_allclose(found.emitters, [[3.6, 4.4, 8.0]], rtol=1e-3)
    places = [{"intensity": [2.0, 2.0, 4.0], "position_m": list(light.position or ())} for light in lights]
    lights = lamps()
    origin = {"rig": {"light": {"emitters": [*places, {"intensity": [1, 1, 1], "position_m": [9, 9, 9]}]}}}
    dome_lit = dataset(tmp_path / "b", lights, photographs(lights), provenance={"capture": origin})
    found = measure_intensity(dome_lit, albedo=ALBEDO, plane=PLANE)
    assert_allclose(found.emitters[:-1], true(lights), rtol=2e-3)
    assert_allclose(found.emitters[-1], found.scale)
    broken = dataset(tmp_path / "c", lights, photographs(lights), provenance={"capture": {"rig": {"light": 3}}})
    with pytest.raises(InputError, match=r"provenance\.capture\.rig: is not the description of a rig"):
        measure_intensity(broken, albedo=ALBEDO, plane=PLANE)


def test_depth_and_normals_serve_as_well_as_a_plane(tmp_path: Path) -> None:
    lights = lamps()
    points, normals = plane_geometry(CAMERA, PLANE)
    depth = CAMERA.project(points)[1]
    lit = dataset(tmp_path / "a", lights, photographs(lights), depth=depth, normals=normals)
    by_maps, by_plane = measure_intensity(lit, albedo=ALBEDO), measure_intensity(lit, albedo=ALBEDO, plane=PLANE)
    assert_allclose(intensities(by_maps)[0], intensities(by_plane)[0], rtol=1e-5)


def test_distant_lights_have_an_irradiance_and_no_falloff(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    normals = np.broadcast_to([0.0, 0.0, 1.0], (HEIGHT, WIDTH, 3))
    lights = [Light(direction=(x, 0.3, 1.0), intensity=(1.0, 2.0, 3.0)) for x in (-0.5, 0.0, 0.5)]
    frames = []
    for light in lights:
        assert light.direction is not None
        image = np.full((HEIGHT, WIDTH, 1), ALBEDO / np.pi * light.direction[2]) * np.array(light.intensity)
        noisy = image * (1 + 0.01 * rng.standard_normal(image.shape))
        frames.append((Light(direction=light.direction), noisy.astype(np.float32)))
    found = measure_intensity(
        write_dataset(tmp_path / "d", name="d", frames=frames, normals=normals), albedo=(ALBEDO, ALBEDO, ALBEDO)
    )
    assert_allclose(intensities(found)[0], [[1, 2, 3]] * 3, rtol=2e-3)
    assert found.falloff_exponent is None
    assert_allclose(np.array(found.lights[0].direction), np.array(lights[0].direction))


def test_a_lamp_of_one_colour(tmp_path: Path) -> None:
    lights = [Light(position=light.position, intensity=(3.0, 0.0, 0.0)) for light in lamps()]
    told = [Light(position=light.position, intensity=(2.0, 0.0, 0.0)) for light in lights]
    frames = list(zip(told, photographs(lights), strict=True))
    found = measure_intensity(
        write_dataset(tmp_path / "r", name="r", frames=frames, camera=CAMERA), albedo=ALBEDO, plane=PLANE
    )
    assert_allclose(found.scale, [1.5, 1, 1], rtol=1e-3)
    assert_allclose(intensities(found)[0][:, 1:], 0)
    frames[0] = (Light(position=told[0].position, intensity=(0.0, 2.0, 0.0)), frames[0][1])
    mixed = write_dataset(tmp_path / "m", name="m", frames=frames, camera=CAMERA)
    with pytest.raises(InputError, match="one colour at a time"):
        measure_intensity(mixed, albedo=ALBEDO, plane=PLANE)


def white_dome(strengths: Array) -> tuple[Rig, list[Light]]:
    """A simulated dome of lights over a level white target."""
    places = dome(3, np.radians([40, 70]), 0.5)
    tree = make_rig(**Camera.look_at(48, 44, 260.0, (0.05, -0.25, 0.6)).to_json()).to_json()
    tree["motion"] = {"driver": "fixed-dome"}
    tree["light"]["emitters"] = [
        {"channel": i + 1, "intensity": strength.tolist(), "position_m": list(light.position or ())}
        for i, (light, strength) in enumerate(zip(places, strengths, strict=True))
    ]
    return Rig.model_validate(tree), places


def test_a_simulated_dome_has_the_lamps_that_it_was_made_with(tmp_path: Path) -> None:
    """RAW frames of the simulated camera, absolute radiance, intensities, and back into the rig."""
    strengths = np.random.default_rng(3).uniform(0.2, 0.4, (6, 3))
    rig, places = white_dome(strengths)
    supposed, _ = white_dome(np.full((6, 3), 0.3))
    white = Relief.uniform(np.zeros((41, 41)), 0.12, albedo=(0.9, 0.9, 0.9))
    world = RigWorld(rig=rig, seed=1, relief=white, clock=lambda: 0.0)
    per_dn_s, exposure_s = world.sensor.radiance_per_dn_s(), 0.05
    dark = np.mean([read_raw(world.expose(exposure_s), "dark").values for _ in range(16)], axis=0)
    frames = []
    for i, place in enumerate(places):
        world.set_channels(bytes(255 if j == i else 0 for j in range(6)))
        raw = read_raw(world.expose(exposure_s), "lit")
        assert not raw.clipped.any()
        sample = Sample.of(raw, exposure_s, dark=dark)
        image = merge([sample], room=raw.white - raw.black, per_dn_s=per_dn_s).image
        light = Light(position=place.position, intensity=(0.3, 0.3, 0.3))
        frames.append((light, image))
    truth = world.truth()
    photographed = write_dataset(
        tmp_path / "w",
        name="w",
        frames=frames,
        camera=rig.camera.calibration(),
        depth=truth.depth,
        normals=truth.normals,
        mask=truth.mask,
        provenance={"capture": {"radiance_per_dn_s": per_dn_s, "rig": supposed.to_json()}},
    )
    found = measure_intensity(photographed, albedo=0.9)
    intensity, std = intensities(found)
    # Red and blue are seen a quarter of a pixel off the pixel's centre, which depth and normals are of.
    assert np.abs((intensity - strengths) / std)[:, 1].max() < 4
    assert_allclose(intensity, strengths, rtol=5e-3)
    assert found.emission == "isotropic"
    assert found.absolute
    write_calibration(found, tmp_path / "intensity.json")
    corrected = load_corrections([tmp_path / "intensity.json"]).rig(supposed)
    assert_allclose([emitter.intensity for emitter in corrected.light.emitters], strengths, rtol=5e-3)


def test_a_file_keeps_it(tmp_path: Path) -> None:
    shares: list[float] = []
    lights = lamps(4)
    lit = dataset(tmp_path / "a", lights, photographs(lights))
    found = measure_intensity(lit, albedo=ALBEDO, plane=PLANE, name="led", progress=shares.append)
    write_calibration(found, tmp_path / "intensity.json")
    assert read_calibration_of(tmp_path / "intensity.json", IntensityCalibration) == found
    assert shares == sorted(shares)


def spoilt(kind: str) -> list[NDArray[np.float32]]:
    pictures = photographs(lamps())
    match kind:
        case "clipped":
            pictures[3][2:] = 200
        case "shadowed":
            pictures[3][:, : WIDTH // 2] *= 0.02
        case "dark":
            pictures[3][:] = 0
    return pictures


@pytest.mark.parametrize(
    ("kind", "reason"),
    [
        ("clipped", r"frames\[3\]: shows \d+ usable cells of the target.*9\d % clipped"),
        ("shadowed", r"frames\[3\]: .* of the target is far from what a white plane shows"),
        ("dark", r"frames\[3\]: most of the target is black; was the light on?"),
    ],
)
def test_targets_that_are_not_seen(tmp_path: Path, kind: str, reason: str) -> None:
    lit = dataset(tmp_path / "a", lamps(), spoilt(kind))
    with pytest.raises(InputError, match=reason):
        measure_intensity(lit, albedo=ALBEDO, plane=PLANE)


def test_targets_in_the_wrong_place(tmp_path: Path) -> None:
    lights = lamps()
    pictures = photographs(lights)
    small = dataset(tmp_path / "s", lights, pictures, mask=np.pad(np.ones((6, 6)), ((20, 38), (20, 46))))
    with pytest.raises(InputError, match=r"frames\[0\]: shows 36 usable cells of the target, expected 64 or more"):
        measure_intensity(small, albedo=ALBEDO, plane=PLANE)
    lit = dataset(tmp_path / "a", lights, photographs(lights))
    with pytest.raises(InputError, match="turned away from the light"):
        measure_intensity(lit, albedo=ALBEDO, plane=Plane((0, 0, 0), (0.0, -1.0, 0.02)))
    with pytest.raises(InputError, match="the target is in no pixel"):
        measure_intensity(lit, albedo=ALBEDO, plane=Plane((0, 0, 5), (0, 0, 1)))
    with pytest.raises(InputError, match="needs depth and normals, or give the plane"):
        measure_intensity(lit, albedo=ALBEDO)
    for albedo in (0.0, 1.2, np.nan, (0.5, 0.5)):
        with pytest.raises(InputError, match="albedo: expected"):
            measure_intensity(lit, albedo=albedo, plane=PLANE)
    for point, normal in (((0, 0, 0), (0, 0, 0)), ((0, 0, np.inf), (0, 0, 1))):
        with pytest.raises(InputError, match="plane: expected a point and a normal"):
            Plane(point, normal)
    frames = [(Light(direction=(0, 0, 1)), pictures[0]), (lights[0], pictures[0])]
    mixed = write_dataset(tmp_path / "m", name="m", frames=frames, camera=CAMERA)
    with pytest.raises(InputError, match="near and distant lights are mixed"):
        measure_intensity(mixed, albedo=ALBEDO, plane=PLANE)
    distant = write_dataset(tmp_path / "d", name="d", frames=[(Light(direction=(0, 0, 1)), np.ones((9, 9, 3)))])
    with pytest.raises(InputError, match="camera: is null"):
        measure_intensity(distant, albedo=ALBEDO, plane=PLANE)
