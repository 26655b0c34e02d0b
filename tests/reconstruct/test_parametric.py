"""The three parametric models on datasets: maps, shadows, rendering, uncertainty, saving, refusals."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from acquisition.dataset import IlluminationDataset, open_dataset, write_dataset, write_exr
from reconstruct.fitting import observer as observing
from reconstruct.fitting.geometry import ObjectGeometry
from reconstruct.model import Model, load_model, model_class, render_together
from reconstruct.parametric import Lambert, MethodOne, ParametricModel, TorranceSparrow
from stage.errors import InputError
from stage.lights import Light
from tests.reconstruct.spheres import GLOSSY, MATTE, Material, Set, View, equation_one, photographs, rings, sphere_set

MODELS = [Lambert, MethodOne, TorranceSparrow]
ALL = range(60)


@pytest.fixture(scope="module")
def glossy(tmp_path_factory: pytest.TempPathFactory) -> Set:
    return sphere_set(tmp_path_factory.mktemp("sets") / "glossy")


@pytest.fixture(scope="module")
def matte(tmp_path_factory: pytest.TempPathFactory) -> Set:
    return sphere_set(tmp_path_factory.mktemp("sets") / "matte", MATTE)


@pytest.fixture(scope="module")
def fitted(glossy: Set) -> dict[type[Model], Model]:
    return {model: model.fit(glossy.dataset, ALL) for model in MODELS}


def relative(found: np.ndarray, truth: object) -> float:
    return float(np.median(np.abs(found / np.asarray(truth) - 1)))


@pytest.mark.parametrize("model", MODELS)
def test_the_registry_finds_the_model(model: type[Model]):
    assert model_class(model.name) is model


def test_torrance_sparrow_finds_what_is_there(glossy: Set, fitted: dict[type[Model], Model]):
    maps = fitted[TorranceSparrow].maps()
    estimated = maps["estimated"] > 0
    assert estimated[glossy.mask].mean() > 0.5
    assert relative(maps["diffuse"][estimated], GLOSSY.diffuse) < 1e-3
    assert relative(maps["specular"][estimated], GLOSSY.specular) < 1e-3
    assert relative(maps["roughness"][estimated], GLOSSY.roughness) < 1e-3
    # elsewhere the highlight is interpolated, and the albedo fitted beside it
    assert relative(maps["specular"][glossy.mask & ~estimated], GLOSSY.specular) < 0.02
    assert relative(maps["diffuse"][glossy.mask & ~estimated], GLOSSY.diffuse) < 0.01


def test_method_one_finds_what_is_there_and_says_where_it_could_not(glossy: Set, fitted: dict[type[Model], Model]):
    model = fitted[MethodOne]
    maps = model.maps()
    diffuse, specular = maps["estimated_diffuse"] > 0, maps["estimated_specular"] > 0
    assert relative(maps["diffuse"][diffuse], GLOSSY.diffuse) < 2e-3
    assert relative(maps["specular"][specular], GLOSSY.specular) < 0.01
    assert relative(maps["roughness"][specular], GLOSSY.roughness) < 0.01
    facing = (maps["normals"] * dataset_view(glossy)).sum(-1)
    assert not diffuse[facing > np.cos(np.radians(30))].any()
    assert relative(maps["diffuse"][glossy.mask & ~diffuse], GLOSSY.diffuse) < 0.02
    counts = model.statistics()
    assert sum(v for k, v in counts.items() if k.startswith("closed_form_")) == glossy.mask.sum()


def dataset_view(made: Set) -> np.ndarray:
    out = np.zeros((*made.mask.shape, 3))
    out[made.mask] = made.view.view
    return out


@pytest.mark.parametrize("model", MODELS)
def test_a_matte_sphere(matte: Set, model: type[Model]):
    found = model.fit(matte.dataset, ALL)
    maps = found.maps()
    assert relative(maps["diffuse"][matte.mask], MATTE.diffuse) < 1e-3
    if "specular" in maps:
        assert maps["specular"].max() < 1e-3
        assert (maps["roughness"][matte.mask] > 0).all()


@pytest.mark.parametrize("model", MODELS)
def test_maps_are_finite_on_the_object_and_zero_outside(
    glossy: Set, fitted: dict[type[Model], Model], model: type[Model]
):
    maps = fitted[model].maps()
    assert {"diffuse", "normals", "estimated", "residual"} <= set(maps)
    for name, value in maps.items():
        assert value.dtype == np.float32
        assert value.shape[:2] == glossy.mask.shape
        assert np.isfinite(value).all(), name
        assert (value[~glossy.mask] == 0).all(), name


def test_estimated_is_the_definition_of_the_conventions(glossy: Set, fitted: dict[type[Model], Model]):
    """At least two unshadowed, unsaturated observations with a half angle of 20 degrees or less, in all models."""
    near = np.zeros(len(glossy.view.normals), int)
    for light in glossy.lights:
        to_light, _ = light.incident(glossy.view.points)
        half = to_light + glossy.view.view
        half /= np.linalg.norm(half, axis=-1, keepdims=True)
        angle = np.degrees(np.arccos(np.clip((half * glossy.view.normals).sum(-1), -1, 1)))
        near += (angle <= 20) & ((to_light * glossy.view.normals).sum(-1) > 0)
    for model in MODELS:
        found = fitted[model].maps()["estimated"][glossy.mask]
        assert_array_equal(found, near >= 2)


@pytest.mark.parametrize("model", [TorranceSparrow, Lambert])
def test_renders_the_lights_it_was_fitted_to(glossy: Set, matte: Set, model: type[Model]):
    made = glossy if model is TorranceSparrow else matte
    found = model.fit(made.dataset, ALL)
    for i in (0, 30, 59):
        image = made.dataset.image(i)
        rendering = found.render(made.lights[i])
        assert_allclose(rendering.image, image, atol=2e-3 * image.max())
        assert (rendering.image[~made.mask] == 0).all()


def test_renders_a_light_it_never_saw(glossy: Set, fitted: dict[type[Model], Model]):
    light = Light(position=(1.0, 2.0, 3.5), intensity=(50, 40, 10))
    rendering = fitted[TorranceSparrow].render(light)
    truth = equation_one(glossy.view, light, GLOSSY)
    assert_allclose(rendering.image[glossy.mask], truth, atol=5e-3 * truth.max())


@pytest.mark.parametrize("model", MODELS)
def test_rendering_is_linear_in_the_light(fitted: dict[type[Model], Model], model: type[Model]):
    one = Light(position=(0, 1, 4), intensity=(1, 2, 3))
    double = Light(position=(0, 1, 4), intensity=(2, 4, 6))
    found = fitted[model]
    assert_allclose(found.render(double).image, 2 * found.render(one).image, rtol=1e-5)
    together = render_together(found, [(one, 0.5), (double, 0.25)])
    assert_allclose(together.image, found.render(one).image, rtol=1e-5)
    assert_allclose(found.uncertainty(double), 2 * found.uncertainty(one), rtol=1e-5)


def test_cast_shadows_are_left_out_and_rendered(tmp_path: Path):
    """A small square before the sphere: its shadow under each light in closed form."""
    corners = np.array([[-0.5, -0.5, 2.0], [0.5, -0.5, 2.0], [0.5, 0.5, 2.0], [-0.5, 0.5, 2.0]]) * 0.7
    square = (corners, np.array([[0, 1, 2], [0, 2, 3]]))
    clear = sphere_set(tmp_path / "clear", MATTE)

    def shadow(light: Light) -> np.ndarray:
        to_light, distance = np.asarray(light.position) - clear.view.points, 1.4 - clear.view.points[:, 2]
        crossing = clear.view.points + to_light * (distance / to_light[:, 2])[:, None]
        return (np.abs(crossing[:, :2]) < 0.35).all(-1)

    def darken(stack: np.ndarray) -> np.ndarray:
        for image, light in zip(stack, clear.lights, strict=True):
            part = image[clear.mask]
            part[shadow(light)] = 0
            image[clear.mask] = part
        return stack

    made = sphere_set(tmp_path / "shadowed", MATTE, change=darken, mesh=square)
    model = TorranceSparrow.fit(made.dataset, ALL)
    assert relative(model.maps()["diffuse"][made.mask], MATTE.diffuse) < 1e-3
    for i in (0, 7, 20):
        assert_allclose(model.render(made.lights[i]).image, made.dataset.image(i), atol=2e-3)
    attached = sum(float((equation_one(made.view, light, MATTE) == 0).all(-1).sum()) for light in made.lights)
    cast = sum(
        float((shadow(light) & (equation_one(made.view, light, MATTE) > 0).any(-1)).sum()) for light in made.lights
    )
    assert model.statistics()["observations_shadowed"] == attached + cast


@pytest.mark.parametrize("keep", [("depth",), ("depth", "mask")])
def test_normals_from_depth(tmp_path: Path, keep: tuple[str, ...]):
    made = sphere_set(tmp_path / "set", side=64, keep=keep)
    model = TorranceSparrow.fit(made.dataset, ALL)
    maps = model.maps()
    estimated = maps["estimated"] > 0
    assert relative(maps["diffuse"][estimated], GLOSSY.diffuse) < 0.01
    assert relative(maps["specular"][estimated], GLOSSY.specular) < 0.02
    assert relative(maps["roughness"][estimated], GLOSSY.roughness) < 0.02


def uv_sphere(count: int = 120) -> tuple[np.ndarray, np.ndarray]:
    polar, azimuth = np.meshgrid(np.linspace(0, np.pi, count), np.linspace(0, 2 * np.pi, 2 * count), indexing="ij")
    sine = np.sin(polar)
    vertices = np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), np.cos(polar)], -1).reshape(-1, 3)
    index = np.arange(vertices.shape[0]).reshape(polar.shape)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    return vertices, np.concatenate([np.stack(t, -1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])


@pytest.mark.parametrize("keep", [(), ("mask",), ("depth", "normals", "mask")])
def test_geometry_from_a_mesh(tmp_path: Path, keep: tuple[str, ...]):
    made = sphere_set(tmp_path / "set", keep=keep, mesh=uv_sphere())
    model = TorranceSparrow.fit(made.dataset, ALL)
    maps = model.maps()
    estimated = maps["estimated"] > 0
    assert estimated[made.mask].mean() > 0.5
    assert relative(maps["diffuse"][estimated], GLOSSY.diffuse) < 0.01
    assert relative(maps["roughness"][estimated], GLOSSY.roughness) < 0.02
    assert not maps["estimated"][~made.mask].any()


def distant_set(folder: Path, material: Material = GLOSSY, **options: object) -> IlluminationDataset:
    """No camera: an orthographic view along -z, distant lights, normals only."""
    y, x = np.mgrid[0.95:-0.95:30j, -0.95:0.95:30j]
    mask = x**2 + y**2 < 0.9
    normals = np.where(mask[..., None], np.stack([x, y, np.sqrt(np.maximum(1 - x**2 - y**2, 0))], -1), 0)

    view = View(normals[mask], np.tile([0, 0, 1.0], (mask.sum(), 1)), None)
    stack = np.zeros((60, 30, 30, 3), np.float32)
    stack[:, mask] = photographs(view, rings(), material)
    geometry = {"normals": normals, "mask": mask} | options
    return write_dataset(folder, name="distant", frames=list(zip(rings(), stack, strict=True)), **geometry)


@pytest.mark.parametrize("masked", [True, False])
def test_without_a_camera(tmp_path: Path, masked: bool):
    dataset = distant_set(tmp_path / "set", **({} if masked else {"mask": None}))
    model = TorranceSparrow.fit(dataset, ALL)
    maps = model.maps()
    assert relative(maps["diffuse"][maps["estimated"] > 0], GLOSSY.diffuse) < 1e-3
    assert (maps["diffuse"][0, 0] == 0).all()  # normals that are zero tell the background where there is no mask
    assert any("cast shadows were judged from the photographs" in s for s in model.limits())
    assert_allclose(model.render(rings()[30]).image, dataset.image(30), atol=5e-3)
    with pytest.raises(InputError, match=r"light\.position"):
        model.render(Light(position=(0, 0, 5)))


@pytest.mark.parametrize("model", MODELS)
def test_a_set_without_a_surface_is_refused(tmp_path: Path, model: type[Model]):
    dataset = distant_set(tmp_path / "set", normals=None)
    lacking = "needs surface normals: the dataset has no normals, depth or mesh"
    assert model.cannot_fit(dataset) == lacking
    with pytest.raises(InputError, match=lacking):
        model.fit(dataset, ALL)


def test_near_lights_need_depth(tmp_path: Path):
    made = sphere_set(tmp_path / "set", keep=("normals", "mask"))
    clause = TorranceSparrow.cannot_fit(made.dataset)
    assert clause is not None
    assert "depth" in clause


def test_saturated_observations_are_left_out_and_counted(tmp_path: Path, glossy: Set):
    """Marked in the frames, or not marked and told by their plateau."""
    top = float(np.percentile(np.stack([glossy.dataset.image(i)[glossy.mask] for i in ALL]), 99))

    def clip(stack: np.ndarray) -> np.ndarray:
        return np.minimum(stack, np.float32(top))

    for made in (
        sphere_set(tmp_path / "silent", change=clip),
        marked(sphere_set(tmp_path / "marked", change=clip), top * (1 - 1e-6)),
    ):
        model = TorranceSparrow.fit(made.dataset, ALL)
        clipped = sum(int((made.dataset.image(i)[made.mask].max(-1) >= top * (1 - 1e-6)).sum()) for i in ALL)
        assert model.statistics()["observations_saturated"] == clipped > 100
        maps = model.maps()
        estimated = maps["estimated"] > 0
        assert relative(maps["specular"][estimated], GLOSSY.specular) < 0.01
        assert relative(maps["roughness"][estimated], GLOSSY.roughness) < 0.01


def marked(made: Set, saturation: float) -> Set:
    """The same set with `saturation` written into every frame."""
    path = made.dataset.folder / "dataset.json"
    manifest = json.loads(path.read_text())
    for frame in manifest["frames"]:
        frame["saturation"] = saturation
    path.write_text(json.dumps(manifest))

    return replace(made, dataset=open_dataset(made.dataset.folder))


def test_pixels_without_a_usable_observation_are_filled_in(tmp_path: Path):
    lights = rings(radius=5.0, intensity=(80, 80, 80))
    burnt = np.zeros((40, 40), bool)
    burnt[20:24, 18:22] = True

    def burn(stack: np.ndarray) -> np.ndarray:
        stack[:, burnt] = 1e3
        return stack

    made = marked(sphere_set(tmp_path / "burnt", MATTE, lights=lights, change=burn), 1e3)
    for model in MODELS:
        found = model.fit(made.dataset, ALL)
        maps = found.maps()
        assert not maps["estimated"][burnt].any()
        assert_allclose(maps["diffuse"][burnt], np.tile(MATTE.diffuse, (16, 1)), rtol=0.01)
        assert found.render(lights[0]).outside[burnt].all()
        assert np.isfinite(found.render(lights[0]).image).all()


def test_nothing_usable_is_refused_by_name(tmp_path: Path):
    made = marked(sphere_set(tmp_path / "set"), 1e-9)
    with pytest.raises(InputError, match=r"frames: every observation of the object is saturated or in shadow"):
        TorranceSparrow.fit(made.dataset, ALL)
    with pytest.raises(InputError, match="at least one"):
        TorranceSparrow.fit(made.dataset, [])


def test_dark_observations_are_counted_and_black_objects_are_black(tmp_path: Path):
    black = sphere_set(tmp_path / "black", change=np.zeros_like)
    for model in MODELS:
        found = model.fit(black.dataset, ALL)
        assert (found.maps()["diffuse"] == 0).all()
        assert (found.render(black.lights[0]).image == 0).all()
    grazing = TorranceSparrow.fit(sphere_set(tmp_path / "matte", MATTE).dataset, ALL)
    assert grazing.statistics()["observations_dark"] > 0


@pytest.mark.parametrize("count", [1, 2])
def test_very_few_lights(tmp_path: Path, count: int):
    made = sphere_set(tmp_path / "set", MATTE, lights=rings([20], radius=5.0, intensity=(80, 80, 80))[:count])
    for model in MODELS:
        found = model.fit(made.dataset, range(count))
        assert np.isfinite(found.maps()["diffuse"]).all()
        assert np.isfinite(found.uncertainty(made.lights[0])).all()
        if model is not MethodOne:
            assert relative(found.maps()["diffuse"][made.mask], MATTE.diffuse) < 0.01


def test_a_pixel_without_a_normal_takes_its_neighbours(tmp_path: Path, glossy: Set):
    normals = np.asarray(glossy.dataset.normals).copy()
    normals[20, 20] = 0
    made = sphere_set(tmp_path / "set", keep=("depth", "mask"), normals=normals)
    model = TorranceSparrow.fit(made.dataset, ALL)
    maps = model.maps()
    assert maps["estimated"][20, 20] == 0
    assert np.linalg.norm(maps["normals"][20, 20]) == pytest.approx(1)
    assert_allclose(maps["diffuse"][20, 20], GLOSSY.diffuse, rtol=0.05)
    assert model.statistics()["observations_without_surface"] == 60


def test_only_the_named_frames_are_used(tmp_path: Path, glossy: Set):
    def spoil(stack: np.ndarray) -> np.ndarray:
        stack[::2] = 1e4
        return stack

    made = sphere_set(tmp_path / "set", change=spoil)
    odd = list(range(1, 60, 2))
    spoilt, clean = TorranceSparrow.fit(made.dataset, odd), TorranceSparrow.fit(glossy.dataset, odd)
    assert_array_equal(spoilt.maps()["diffuse"], clean.maps()["diffuse"])


def test_pieces_give_what_the_whole_gives(
    glossy: Set, fitted: dict[type[Model], Model], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(observing, "OBSERVATION_BYTES", 100_000)
    shares: list[float] = []
    model = TorranceSparrow.fit(glossy.dataset, ALL, shares.append)
    for name, value in fitted[TorranceSparrow].maps().items():
        assert_array_equal(model.maps()[name], value, err_msg=name)
    assert shares == sorted(shares)
    assert shares[-1] == 1
    assert len(shares) > 10


def test_tiles_of_rows_give_what_one_tile_gives(glossy: Set, fitted: dict[type[Model], Model]):
    class Striped:
        """A dataset whose stack never fits in memory at once."""

        def __getattr__(self, name: str) -> object:
            return getattr(glossy.dataset, name)

        def tiles(self, frames: object) -> object:
            return glossy.dataset.tiles(frames, max_bytes=1)

    model = TorranceSparrow.fit(Striped(), ALL)  # type: ignore[arg-type]
    assert_array_equal(model.maps()["diffuse"], fitted[TorranceSparrow].maps()["diffuse"])


def test_outside_marks_highlights_nobody_measured(tmp_path: Path):
    """With lights from one side only, the other side's highlights are extrapolated."""
    lights = [light for light in rings(radius=5.0, intensity=(80, 80, 80)) if light.position[0] > 0]
    made = sphere_set(tmp_path / "set", lights=lights)
    model = TorranceSparrow.fit(made.dataset, range(len(lights)))
    assert not model.render(lights[5]).outside.any()
    opposite = Light(position=tuple(np.array(lights[5].position) * [-1, 1, 1]))
    outside = model.render(opposite).outside
    assert outside.any()
    assert not outside[~made.mask].any()
    assert np.isfinite(model.render(opposite).image).all()
    assert not Lambert.fit(made.dataset, range(len(lights))).render(opposite).outside.any()


def test_uncertainty_is_the_spread_of_what_is_rendered(tmp_path: Path):
    """Fits to many noisy copies of one set: the spread of their renderings against the first one's own figure."""
    light = Light(position=(1.0, 2.0, 4.5), intensity=(80, 80, 80))
    rendered = []
    for seed in range(10):
        rng = np.random.default_rng(seed)

        def noisy(stack: np.ndarray, rng: np.random.Generator = rng) -> np.ndarray:
            white = np.percentile(stack[stack > 0], 99.5)
            std = 0.01 * np.sqrt(0.02 * white + stack)  # photon and read noise as a fit expects them
            return stack + (std * rng.normal(size=stack.shape)).astype(np.float32)

        made = sphere_set(tmp_path / str(seed), side=24, change=noisy)
        model = TorranceSparrow.fit(made.dataset, ALL)
        rendered.append(model.render(light).image)
        if seed == 0:
            claimed, estimated = model.uncertainty(light), model.maps()["estimated"] > 0
            residual = model.maps()["residual"]
    lit = estimated & (np.min(rendered, axis=0) > 0).all(-1)
    spread = np.std(rendered, axis=0, ddof=1)[lit].mean(-1)
    # the misfit of a single photograph is part of the claim, in proportion to the strength of the light
    points = made.view.points[lit[made.mask]]
    usual = np.mean([lamp.incident(made.view.points.mean(0))[1] for lamp in made.lights])
    misfit = residual[lit] * light.incident(points)[1] / usual
    assert np.median(claimed[lit] / np.hypot(spread, misfit)) == pytest.approx(1, rel=0.1)
    parameters = np.sqrt(np.maximum(claimed[lit] ** 2 - misfit**2, 0))
    assert np.median(parameters) == pytest.approx(np.median(spread), rel=0.2)
    assert (claimed[~made.mask] == 0).all()


@pytest.mark.parametrize("model", MODELS)
def test_a_saved_model_answers_the_same(tmp_path: Path, fitted: dict[type[Model], Model], model: type[Model]):
    before = fitted[model]
    before.save(tmp_path)
    after = load_model(tmp_path)
    assert type(after) is model
    light = Light(position=(1.0, 2.0, 3.5), intensity=(50, 40, 10))
    assert_allclose(after.render(light).image, before.render(light).image, rtol=1e-6, atol=1e-7)
    assert_array_equal(after.render(light).outside, before.render(light).outside)
    assert_allclose(after.uncertainty(light), before.uncertainty(light), rtol=1e-6)
    assert after.statistics() == before.statistics()
    assert after.limits() == before.limits()
    for name, value in before.maps().items():
        assert_array_equal(after.maps()[name], value, err_msg=name)
    info = json.loads((tmp_path / "model.json").read_text())
    assert info["schema"] == "lightstage-model/1"
    assert info["limits"] == before.limits()
    assert (tmp_path / "diffuse.exr").exists()


@pytest.mark.parametrize("model", [MethodOne, TorranceSparrow])
def test_limits_name_what_cannot_be_shown(fitted: dict[type[Model], Model], model: type[Model]):
    """M23."""
    text = " ".join(fitted[model].limits()).lower()
    for word in ("metal", "mirror", "opaque", "fresnel", "interreflection"):
        assert word in text


def test_damaged_models_are_refused_by_file(tmp_path: Path, fitted: dict[type[Model], Model]):
    fitted[TorranceSparrow].save(tmp_path)
    path = tmp_path / "model.json"
    whole = path.read_text()
    (tmp_path / "specular.exr").rename(tmp_path / "away.exr")
    with pytest.raises(InputError, match=r"specular\.exr"):
        load_model(tmp_path)
    write_exr(tmp_path / "specular.exr", np.zeros((3, 3)))
    with pytest.raises(InputError, match=r"specular\.exr: expected"):
        load_model(tmp_path)
    (tmp_path / "away.exr").rename(tmp_path / "specular.exr")
    for key in ("maps", "geometry", "statistics", "reference_strength"):
        path.write_text(json.dumps({k: v for k, v in json.loads(whole).items() if k != key}))
        with pytest.raises(InputError, match=rf"model\.json: .*{key}"):
            load_model(tmp_path)
    path.write_text(whole)
    (tmp_path / "occluder.npz").write_bytes(b"nothing")
    with pytest.raises(InputError, match=r"occluder\.npz"):
        load_model(tmp_path)


def test_geometry_needs_a_normal_somewhere(tmp_path: Path):
    dataset = distant_set(tmp_path / "set", normals=np.zeros((30, 30, 3)))
    with pytest.raises(InputError, match="no pixel of the object has both"):
        ObjectGeometry.of(dataset)


def test_every_parametric_model_shares_one_base():
    assert all(issubclass(model, ParametricModel) for model in MODELS)
