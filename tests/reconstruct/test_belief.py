"""Belief after a fit: the fit's own covariance, refits of noisy photographs, hidden highlights, errors foretold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from acquisition.dataset import IlluminationDataset, write_dataset
from reconstruct.grey_levels import GreyLevels
from reconstruct.next_light.belief import Belief, belief
from reconstruct.next_light.display import Display
from reconstruct.next_light.prior import prior_information
from reconstruct.parametric import Lambert, MethodOne, ParametricModel, TorranceSparrow
from stage.errors import InputError
from stage.expected_reflectance import ExpectedReflectance
from stage.lights import Light
from stage.planning.information.sensitivity import DIFFUSE, LOG_ROUGHNESS, SPECULAR
from tests.reconstruct.spheres import MATTE, Material, View, equation_one, photographs, rings, sphere_set

Array = NDArray[np.float64]
GLOSSY = Material(roughness=0.2)
SLANTS = np.radians([15.0, 25.0, 35.0])
NOISE = 0.01
COPIES = 200


class Patches(NamedTuple):
    """One row of pixels per normal; a row's pixels differ by their noise alone, so that one fit is as many refits."""

    dataset: IlluminationDataset
    view: View


def patches(
    folder: Path,
    lights: Sequence[Light],
    material: Material,
    *,
    slants: Sequence[float] = tuple(SLANTS),
    noise: float = NOISE,
    copies: int = COPIES,
) -> Patches:
    """Photon noise and some of reading, as a set without variance images is taken to have."""
    slant, azimuth = np.asarray(slants), np.arange(len(slants))
    rows = np.stack([np.sin(slant) * np.cos(azimuth), np.sin(slant) * np.sin(azimuth), np.cos(slant)], -1)
    normals = np.repeat(rows[:, None], copies, axis=1)
    view = View(normals.reshape(-1, 3), np.tile([0.0, 0.0, 1.0], (normals[..., 0].size, 1)), None)
    images = photographs(view, lights, material)
    white = np.percentile(images, 99.5)
    spread = noise * np.sqrt((0.02 * white + images) / white)
    images = images + spread * np.random.default_rng(len(lights)).normal(size=images.shape)
    stack = images.astype(np.float32).reshape(len(lights), *normals.shape)
    frames = list(zip(lights, stack, strict=True))
    mask = np.ones(normals.shape[:2], bool)
    return Patches(write_dataset(folder, name="p", frames=frames, normals=normals.astype(np.float32), mask=mask), view)


def believed(found: ParametricModel, dataset: IlluminationDataset, step: int = 1) -> Belief:
    return belief(found, dataset, range(len(dataset)), np.arange(0, len(found.geometry.normals), step))


def at(half_angle_deg: float, azimuth: float = 0.3) -> Light:
    """A distant light at this half angle for a point seen face-on."""
    polar = np.radians(2 * half_angle_deg)
    return Light(direction=(np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)))


@pytest.mark.parametrize("intensity", [(1, 1, 1), (1.0, 0.7, 0.4)])
def test_information_is_the_inverse_of_the_fits_own_covariance(tmp_path: Path, intensity: tuple[float, ...]) -> None:
    made = patches(tmp_path / "set", rings(intensity=intensity), GLOSSY, copies=40)
    model = TorranceSparrow.fit(made.dataset, range(60))
    known = believed(model, made.dataset, step=3)
    assert known.found.all()
    covariance = np.linalg.inv(known.information)
    # rho_s = 8 pi sigma^2 P_s, alpha = sqrt(2) sigma
    by_p_s = 8 * np.pi * known.sigma**2
    slope = np.stack([by_p_s, 2 * by_p_s * known.p_s], -1)
    lobe = covariance[:, SPECULAR:, SPECULAR:]
    std_specular = np.sqrt(np.einsum("qi,qij,qj->q", slope, lobe, slope))
    std_roughness = np.sqrt(2) * known.sigma * np.sqrt(covariance[:, LOG_ROUGHNESS, LOG_ROUGHNESS])
    assert_allclose(std_specular, model.values["std_specular"][known.pixels], rtol=1e-4)
    assert_allclose(std_roughness, model.values["std_roughness"][known.pixels], rtol=1e-4)
    # a channel's own diffuse reflectance lacks what the other two say about it
    share = np.square(intensity) / np.sum(np.square(intensity))
    apart = (1 / share - 1) / known.information[:, DIFFUSE, DIFFUSE, None]
    std_diffuse = np.pi * np.sqrt(covariance[:, DIFFUSE, DIFFUSE, None] + apart)
    assert_allclose(std_diffuse, model.values["std_diffuse"][known.pixels], rtol=1e-4)


def test_a_matte_model_knows_its_albedo_as_the_fit_does(tmp_path: Path) -> None:
    made = patches(tmp_path / "set", rings(count=6), MATTE, copies=20)
    model = Lambert.fit(made.dataset, range(30))
    known = believed(model, made.dataset)
    # one channel of three, each with a third of the information
    std = np.pi * np.sqrt(3 / known.information[:, DIFFUSE, DIFFUSE])
    assert_allclose(np.tile(std[:, None], 3), model.values["std_diffuse"], rtol=1e-4)


@pytest.mark.parametrize("count", [60, 24])
def test_refits_of_noisy_photographs_scatter_as_believed(tmp_path: Path, count: int) -> None:
    """Monte Carlo: 200 fits of the same points; standard deviations agree within 20 %, correlations within 0.15."""
    lights = [rings()[i] for i in np.random.default_rng(1).permutation(60)[:count]]
    made = patches(tmp_path / "set", lights, GLOSSY)
    known = believed(TorranceSparrow.fit(made.dataset, range(count)), made.dataset)
    fitted = np.stack([known.p_d.mean(axis=1), known.p_s, np.log(known.sigma)], -1).reshape(len(SLANTS), COPIES, 3)
    covariance = known.covariance().reshape(len(SLANTS), COPIES, 3, 3)
    assert known.found.mean() > 0.99
    for several, one in zip(fitted, covariance, strict=True):
        expected, scattered = np.median(one, axis=0), np.cov(several.T)
        scale, spread = np.sqrt(np.diag(expected)), np.sqrt(np.diag(scattered))
        assert_allclose(spread, scale, rtol=0.2)
        assert_allclose(scattered / spread / spread[:, None], expected / scale / scale[:, None], atol=0.15)


@pytest.mark.parametrize("count", [60, 24, 12])
def test_error_of_relighting_is_foretold(tmp_path: Path, count: int) -> None:
    lights = [rings()[i] for i in np.random.default_rng(1).permutation(60)[:count]]
    made = patches(tmp_path / "set", lights, GLOSSY)
    model = TorranceSparrow.fit(made.dataset, range(count))
    known = believed(model, made.dataset)
    wanted = rings((10, 25, 40, 55), 5)
    truth = np.stack([equation_one(made.view, light, GLOSSY) for light in wanted])
    rendered = np.stack([model.render(light).image.reshape(-1, 3) for light in wanted])
    foretold = known.predicted_error(wanted)
    missed = known.display.grey(rendered) - known.display.grey(truth)
    assert foretold.parameters == pytest.approx(np.sqrt(np.mean(missed**2)), rel=0.25)
    assert foretold.grey_levels**2 == pytest.approx(foretold.parameters**2 + foretold.floor**2)
    # the floor is the noise of the photographs themselves: there is no other misfit here
    noise = NOISE * 255 / known.display.scale * np.sqrt(0.02 + truth / known.display.scale)
    assert foretold.floor == pytest.approx(np.sqrt(np.mean(noise**2)), rel=0.5)


def test_more_photographs_leave_the_floor_and_lower_the_rest(tmp_path: Path) -> None:
    lights = rings(count=4)
    made = patches(tmp_path / "set", lights, GLOSSY, copies=20)
    known = believed(TorranceSparrow.fit(made.dataset, range(len(lights))), made.dataset)
    wanted, more = rings((10, 40), 5), rings((20, 35, 50), 6)
    errors = [known.predicted_error(wanted, more[:n]) for n in range(0, 19, 6)]
    parameters = [error.parameters for error in errors]
    assert parameters == sorted(parameters, reverse=True)
    assert parameters[-1] < 0.8 * parameters[0]
    assert_allclose([error.floor for error in errors], errors[0].floor, rtol=0.02)


# -- highlights between the lights -------------------------------------------------------------------------------------


def wide_apart() -> list[Light]:
    """Half angles of 25 degrees and more for a point seen face-on."""
    return [at(half, azimuth) for half in (25, 35, 42) for azimuth in np.arange(6) * np.pi / 3]


@pytest.mark.parametrize("slants", [(0.0,), (0.0, 0.5)])
def test_next_light_goes_where_a_highlight_can_hide(tmp_path: Path, slants: tuple[float, ...]) -> None:
    """Whether nothing is known of the object's highlights or another part has shown some."""
    sharp = Material(specular=0.02, roughness=0.1)  # sigma 4 degrees
    made = patches(tmp_path / "set", wide_apart(), sharp, slants=slants, noise=0.005, copies=60)
    known = believed(TorranceSparrow.fit(made.dataset, range(18)), made.dataset)
    hidden = known.pixels < 60
    assert not known.found[hidden].any()
    assert known.found[~hidden].all()
    left = known.covariance()[hidden, SPECULAR, SPECULAR] * known.prior[hidden, SPECULAR, SPECULAR]
    assert_allclose(left[known.sigma[hidden] < np.radians(6)], 1, rtol=0.01)
    candidates = [at(half) for half in range(0, 44, 3)]
    wanted = [at(half, azimuth) for half in range(0, 44, 4) for azimuth in range(5)]
    for aim in ("relighting", "a-optimal", "d-optimal"):
        assert known.design(candidates, wanted, aim).best() <= 5  # 15 degrees; the nearest seen were at 25
    assert known.predicted_error(wanted, [at(3)]).parameters < 0.85 * known.predicted_error(wanted).parameters


def test_lights_that_came_close_and_showed_nothing_leave_no_doubt(tmp_path: Path) -> None:
    lights = [*wide_apart(), *(at(half, azimuth) for half in (0, 4, 8, 12, 16) for azimuth in range(3))]
    made = patches(tmp_path / "set", lights, MATTE, slants=(0.0,), noise=0.005, copies=60)
    known = believed(TorranceSparrow.fit(made.dataset, range(len(lights))), made.dataset)
    assert not known.found.any()
    doubt = np.sqrt(known.covariance()[:, SPECULAR, SPECULAR])
    assert np.median(doubt) < 0.02 * np.median(known.p_d)
    # and what was seen counts for what was not: the object is believed to be matte (20 points of each width: 1 / 21)
    assert (1 / np.sqrt(known.prior[:, SPECULAR, SPECULAR]) < 0.25 * np.median(known.p_d)).all()


def test_where_no_point_of_many_has_a_highlight_the_next_has_none() -> None:
    """One point that no light came near beside matte ones that were measured: its P_s fades as 1 / sqrt(points)."""

    def unseen(measured: int) -> float:
        count = measured + 1
        information = np.zeros((count, 3, 3))
        information[:, DIFFUSE, DIFFUSE] = 1e8
        information[:-1, SPECULAR, SPECULAR] = 1e8
        p_d, nothing, sigma = np.full(count, 0.15), np.zeros(count), np.full(count, 0.17)
        known = np.ones(count, bool)
        given = p_d, nothing, sigma, known, information, nothing
        prior = prior_information(*given, ExpectedReflectance(diffuse=0.15, specular=0.15))
        return float(1 / np.sqrt(prior[-1, SPECULAR, SPECULAR]))

    assert_allclose([unseen(n) for n in (0, 3, 99, 999)], 0.15 / np.sqrt([1, 4, 100, 1000]), rtol=1e-3)


def test_expected_reflectance_decides_while_nothing_was_found(tmp_path: Path) -> None:
    made = patches(tmp_path / "set", wide_apart(), MATTE, slants=(0.0,), copies=20)
    model = TorranceSparrow.fit(made.dataset, range(18))
    pixels = np.arange(20)
    dull, shiny = (
        belief(model, made.dataset, range(18), pixels, expected=ExpectedReflectance(0.15, specular, np.radians(6)))
        for specular in (0.03, 0.3)
    )
    assert_allclose(np.unique(dull.sigma), np.radians([3, 6, 12]))
    ratio = dull.prior[:, SPECULAR, SPECULAR] / shiny.prior[:, SPECULAR, SPECULAR]
    sharp = dull.sigma < np.radians(4)
    assert_allclose(ratio[sharp], 100, rtol=0.01)
    # a broad lobe would have shown at half angles of 25 degrees, so much of one as of the other
    assert (ratio[~sharp] < 100).all()


def test_interpolated_highlight_that_the_photographs_belie_is_doubted(tmp_path: Path) -> None:
    """Its misfit is no floor: photographs of the highlight would mend it."""
    made = patches(tmp_path / "set", rings(), GLOSSY, copies=40)
    model = TorranceSparrow.fit(made.dataset, range(60))
    right = believed(model, made.dataset)
    part = right.pixels < 80  # of 120
    model.values["specular"] = np.where(part, 1.5, 1.0) * model.values["specular"]
    model.values["estimated_specular"] = np.where(part, 0.0, model.values["estimated_specular"])
    wrong = believed(model, made.dataset)
    doubt = 1 / np.sqrt(wrong.prior[part, SPECULAR, SPECULAR])
    assert np.median(doubt) > 0.9 * np.median(wrong.p_s[part] - right.p_s[part])
    assert np.median(wrong.rms_misfit[part]) == pytest.approx(np.median(right.rms_misfit[part]), rel=0.2)


# -- geometry, levels, other models ------------------------------------------------------------------------------------


def test_shadowed_and_clipped_candidates_teach_nothing(tmp_path: Path) -> None:
    made = sphere_set(tmp_path / "set", side=16, lights=rings(radius=5.0, count=3, intensity=(80, 80, 80)))
    model = TorranceSparrow.fit(made.dataset, range(15))
    known = believed(model, made.dataset)
    below, strong = Light(position=(0, 0, -5.0)), Light(position=(0.0, 1.0, 5.0), intensity=(1e4, 1e4, 1e4))
    assert np.isinf(known.variances([below])).all()
    assert_array_equal(known.jacobians([below]), 0)
    assert np.isfinite(known.variances([strong])).any()
    assert np.isinf(replace(known, saturation=1.0).variances([strong])).mean() > 0.9
    roof = np.array([[-9.0, -9, 3], [9, -9, 3], [9, 9, 3], [-9, 9, 3]]), np.array([[0, 1, 2], [0, 2, 3]])
    covered = replace(known, geometry=replace(known.geometry, mesh=roof))
    assert np.isfinite(known.variances(made.lights[:1])).any()
    assert np.isinf(covered.variances(made.lights[:1])).all()
    assert_array_equal(covered.jacobians(made.lights[:1]), 0)
    design = known.design([below, made.lights[0]], made.lights, "relighting")
    assert design.gains()[0] == 0
    assert design.best() == 1
    assert_allclose(
        known.radiance(made.lights[:2])[1], equation_one(made.view, made.lights[1], made.material), rtol=0.2
    )


@pytest.mark.parametrize("fitted", [Lambert, MethodOne])
def test_other_models(tmp_path: Path, fitted: type[ParametricModel]) -> None:
    made = patches(tmp_path / "set", rings(), GLOSSY, copies=20)
    known = believed(fitted.fit(made.dataset, range(60)), made.dataset)
    assert known.unknowns == (1 if fitted is Lambert else 3)
    error = known.predicted_error(rings((30,), 4), [at(3)])
    assert np.isfinite([error.grey_levels, error.parameters, error.floor]).all()
    assert known.design([at(3), at(20)], rings((30,), 4), "relighting").gains().min() > 0
    if fitted is Lambert:  # its misfit is the highlight that it does not have
        assert error.floor > 5 * error.parameters


def test_no_other_frame_is_read(tmp_path: Path) -> None:
    made = patches(tmp_path / "set", rings(), GLOSSY, copies=10)
    frames = list(range(0, 60, 2))
    model = TorranceSparrow.fit(made.dataset, frames)
    for i in range(1, 60, 2):
        made.dataset.path(i).unlink()
    known = belief(model, made.dataset, frames, np.arange(30))
    assert known.predicted_error(rings((30,), 4)).grey_levels > 0


def test_refusals(tmp_path: Path) -> None:
    made = patches(tmp_path / "one", rings(), GLOSSY, copies=4)
    other = patches(tmp_path / "two", rings(), GLOSSY, copies=5)
    model = TorranceSparrow.fit(made.dataset, range(60))
    with pytest.raises(InputError, match="another object"):
        belief(model, other.dataset, range(60), np.arange(3))
    with pytest.raises(InputError, match="wanted lights"):
        believed(model, made.dataset).design([at(3)], [], "relighting")


def test_display_is_the_scale_of_evaluations(tmp_path: Path) -> None:
    stored = np.random.default_rng(0).integers(0, 256, (4, 6, 8, 3), dtype=np.uint8)
    frames: list[tuple[Light, Path, dict[str, object]]] = []
    for light, picture in zip(rings()[:4], stored, strict=True):
        path = tmp_path / f"{len(frames)}.png"
        cv2.imwrite(str(path), picture)
        frames.append((light, path, {"transfer": "srgb", "scale": 3.0}))
    dataset = write_dataset(tmp_path / "set", name="bytes", frames=frames)
    display = Display.of(dataset, [2], white=99.0)
    linear = dataset.image(1) * np.float32(0.9)
    assert_allclose(np.rint(display.grey(linear)), GreyLevels(dataset).rendered(1, linear), atol=1)
    # steep at black, flat where both ends are clipped
    assert display.slope(0.0, 1e-4) > 5 * display.slope(1.0, 1e-4) > 0
    assert display.slope(4.0, 0.5) == 0
    assert display.slope(1.0, 0.0) == pytest.approx(display.slope(1.0, 1e-4), rel=1e-3)
