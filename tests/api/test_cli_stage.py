"""``plan`` and ``capture``: from a rig description to a dataset, over simulated wires."""

from __future__ import annotations

import hashlib
import json

import numpy as np
import pytest
import yaml

from acquisition.dataset import open_dataset, write_dataset
from acquisition.dataset.mesh import write_ply
from acquisition.plan import read_plan
from api.demo_stage import demo_rig, held_out_lights
from api.devices import open_bench, simulation_seed
from api.verbs.planning import rig_lights
from simulators.scene import dish
from stage.camera import Camera
from stage.devices import AxisGroup, FrameCamera, Lamp
from stage.errors import InputError
from stage.lights import Light
from stage.rig import Rig
from tests.api.conftest import write_json
from tests.reconstruct.toy import distant_lights


@pytest.fixture(autouse=True)
def coarse_dish(monkeypatch):
    """The simulated object on a grid a sixteenth as fine, which is enough for 40 x 30 pixels."""
    monkeypatch.setattr("simulators.world.dish", lambda: dish(nodes=201))


SMALL = {"width": 40, "height": 30, "focal": 180.0}


def small_rig(**changes) -> dict:
    """The demo's rig with a camera of 40 x 30 pixels."""
    description = demo_rig().to_json()
    camera = Camera.look_at(SMALL["width"], SMALL["height"], SMALL["focal"], (0, -0.7, 0.98)).to_json()
    description["camera"] |= {key: camera[key] for key in ("width", "height", "K")}
    for path, value in changes.items():
        *parts, key = path.split("__")
        place = description
        for part in parts:
            place = place[part]
        place[key] = value
    return description


@pytest.fixture
def rig(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text(yaml.safe_dump(small_rig()))
    return path


@pytest.fixture
def bump(tmp_path):
    """Mesh file of a shallow dome about the stage's centre, 0.2 m across."""
    axis = np.linspace(-0.1, 0.1, 21)
    x, y = np.meshgrid(axis, axis)
    vertices = np.stack([x, y, 0.05 - 2 * (x**2 + y**2)], -1).reshape(-1, 3)
    corner = (np.arange(20)[:, None] * 21 + np.arange(20)).ravel()
    faces = np.concatenate([corner[:, None] + [0, 1, 22], corner[:, None] + [0, 22, 21]])
    write_ply(tmp_path / "bump.ply", vertices, faces)
    return tmp_path / "bump.ply"


def test_plan_of_a_rig_and_a_mesh_is_what_the_design_prints(run, rig, bump, tmp_path):
    outcome = run("plan", "--rig", rig, "--surface", bump, "--out", tmp_path / "plan.json", "--json")
    assert outcome.code == 0, outcome
    found = outcome.json
    assert found["count"] == len(found["lights"]) >= found["lower_bound"] >= 1
    assert set(found["coverage"]) == {"diffuse", "specular", "limit_diffuse", "limit_specular"}
    assert found["coverage"]["specular"] == found["coverage"]["limit_specular"] > 0
    plan = read_plan(tmp_path / "plan.json")
    assert list(plan.lights) == found["lights"]
    assert len(plan.candidates) == 60
    assert plan.provenance["surface"] == str(bump)


def test_plan_takes_a_count_and_a_target(run, rig, bump, tmp_path):
    common = ("plan", "--rig", rig, "--surface", bump, "--json", "--out", tmp_path / "plan.json")
    assert run(*common, "--count", 5).json["count"] == 5
    low, high = (run(*common, "--target", share).json["count"] for share in (0.5, 1))
    assert low < high


@pytest.mark.parametrize("method", ["farthest", "random"])
def test_methods_that_need_no_surface(run, tmp_path, method):
    lights = write_json(tmp_path / "lights.json", [light.to_json() for light in distant_lights(9)])
    plan = tmp_path / "plan.json"
    outcome = run("plan", "--candidates", lights, "--method", method, "--count", 4, "--out", plan, "--json")
    assert outcome.code == 0, outcome
    assert outcome.json["count"] == 4
    assert len(set(outcome.json["lights"])) == 4


def test_a_dataset_brings_lights_and_surface(run, tmp_path):
    camera = Camera.look_at(24, 18, 40.0, (0, 0, 1), up=(0, 1, 0))
    depth = np.full((18, 24), 1.0, np.float32)
    lights = [Light(position=(x, y, 0.8)) for x in (-0.9, -0.3, 0.3, 0.9) for y in (-0.9, 0.0, 0.9)]
    picture = np.ones((18, 24, 3), np.float32)
    write_dataset(
        tmp_path / "flat", name="flat", frames=[(light, picture) for light in lights], camera=camera, depth=depth
    )
    outcome = run("plan", "--candidates", tmp_path / "flat", "--out", tmp_path / "plan.json", "--json")
    assert outcome.code == 0, outcome
    assert outcome.json["coverage"]["specular"] > 0
    again = run(
        "plan",
        "--candidates",
        tmp_path / "flat",
        "--surface",
        tmp_path / "flat",
        "--out",
        tmp_path / "p2.json",
        "--json",
    )
    assert again.json["lights"] == outcome.json["lights"]


def test_plan_refuses(refused, rig, bump, ramps, tmp_path):
    out = ("--out", tmp_path / "plan.json")
    lights = write_json(tmp_path / "lights.json", [{"direction": [0, 0, 1]}, {"direction": [0, 1, 1]}])
    group = write_json(tmp_path / "group.json", [[{"direction": [0, 0, 1]}, {"direction": [0, 1, 1]}]])
    assert "--rig, --candidates" in refused("plan", *out)
    assert "--method: expected one of static" in refused("plan", "--rig", rig, "--method", "odd", *out)
    assert "--surface: the method 'optimal'" in refused("plan", "--candidates", lights, *out)
    assert "give --rig for its camera" in refused("plan", "--candidates", lights, "--surface", bump, *out)
    assert "no depth, mesh or normals" in refused("plan", "--candidates", lights, "--surface", ramps, *out)
    assert "no such file or folder" in refused("plan", "--rig", rig, "--surface", tmp_path / "none.ply", *out)
    assert "lit together" in refused("plan", "--candidates", group, "--method", "random", "--count", 1, *out)
    said = refused("plan", "--candidates", lights, "--method", "random", "--count", 3, *out)
    assert "--count: expected 1 to 2 lights" in said
    assert "--count" in refused("plan", "--candidates", lights, "--method", "random", *out)
    assert "--target" in refused("plan", "--rig", rig, "--surface", bump, "--target", 2, *out)
    assert "output" in refused("plan", "--rig", rig, "--surface", bump, "--out", tmp_path / "no" / "plan.json")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (": [", "is not YAML"),
        ("[1, 2]", "expected a mapping"),
        ("schema: lightstage-rig/2", "schema"),
        (yaml.safe_dump(small_rig() | {"colour": 1}), "colour: unknown key"),
        (yaml.safe_dump(small_rig(motion__kinematics__radius_m=float("nan"))), "motion.kinematics.radius_m"),
        (yaml.safe_dump(small_rig(motion__driver="stepper")), "motion.driver"),
    ],
)
def test_a_bad_rig_is_refused_by_file_and_field(refused, tmp_path, text, says):
    rig = tmp_path / "rig.yaml"
    rig.write_text(text)
    said = refused("plan", "--rig", rig, "--method", "random", "--count", 3, "--out", tmp_path / "plan.json")
    assert f"{rig}: " in said
    assert says in said


def test_a_rigs_dome_is_what_its_arm_reaches():
    assert len(rig_lights(demo_rig(), source="rig")) == 60
    half = small_rig()
    half["motion"]["joints"][0]["limits_deg"] = [-91, 91]
    assert len(rig_lights(Rig.model_validate(half), source="rig")) == 5 * 7
    low = small_rig()
    low["motion"]["joints"][1]["limits_deg"] = [0, 10]
    with pytest.raises(InputError, match="reaches none of the 60 places"):
        rig_lights(Rig.model_validate(low), source="rig")


def test_lights_of_a_fixed_dome_are_its_own_and_a_gantry_asks_for_places():
    fixed = small_rig(motion={"driver": "fixed-dome"})
    fixed["light"]["emitters"] = [
        {"channel": n, "intensity": [n, n, n], "position_m": [0.1 * (n % 2), 0, 0.5]} for n in range(1, 5)
    ]
    found = rig_lights(Rig.model_validate(fixed), source="rig")
    np.testing.assert_allclose([light.position for light in found], [(0.1, 0, 0.5), (0, 0, 0.5)], atol=1e-12)
    assert [light.intensity[0] for light in found] == [4, 6]
    joints = [{"axis": axis, "limits_m": [0, 1]} for axis in "XYZ"]
    gantry = {"driver": "grbl", "port": "sim:", "kinematics": {"kind": "gantry"}, "joints": joints}
    with pytest.raises(InputError, match="say where by --candidates"):
        rig_lights(Rig.model_validate(small_rig(motion=gantry)), source="rig")


def test_places_in_a_keep_out_zone_are_no_candidates():
    table = [{"kind": "half-space", "point_m": [0, 0, 0.2], "normal": [0, 0, 1]}]
    kept = rig_lights(Rig.model_validate(small_rig(keep_out=table)), source="rig")
    assert len(kept) < 60
    assert min(light.position[2] for light in kept) > 0.2


def test_held_out_lights_are_no_candidates():
    places = np.array([light.position for light in rig_lights(demo_rig(), source="rig")])
    for light in held_out_lights():
        nearest = np.linalg.norm(places - np.array(light.position), axis=1).min()
        assert nearest > 0.7 * np.radians(5)


@pytest.mark.parametrize(
    ("motion", "light", "says"),
    [("sim:", "/dev/ttyUSB0", "one world"), ("sim:1", "sim:2", "one world"), ("sim:x", "sim:x", "a seed")],
)
def test_a_stage_is_simulated_as_a_whole_or_not_at_all(motion, light, says):
    rig = demo_rig().plugged_in({"motion": motion, "light": light, "camera": motion})
    with pytest.raises(InputError, match=says):
        simulation_seed(rig)


def test_seed_of_a_simulated_stage():
    assert simulation_seed(demo_rig()) == 0
    roles = ("motion", "light", "camera")
    assert simulation_seed(demo_rig().plugged_in(dict.fromkeys(roles, "sim:12"))) == 12
    assert simulation_seed(demo_rig().plugged_in(dict.fromkeys(roles, "/dev/a"))) is None


@pytest.mark.system
def test_every_device_of_a_simulated_rig_is_the_real_driver():
    with open_bench(Rig.model_validate(small_rig())) as bench:
        assert isinstance(bench.motion, AxisGroup)
        assert isinstance(bench.lamp, Lamp)
        assert isinstance(bench.camera, FrameCamera)
        reached = bench.motion.move_to((0.3, 0.7)).positions
        np.testing.assert_allclose(reached, (0.3, 0.7), atol=0.01)
        bench.lamp.set_level(1.0)
        np.testing.assert_allclose(bench.world.light(bench.clock.now())[1], (1.5, 1.5, 1.5))


@pytest.mark.system
def test_capture_writes_a_dataset_that_models_can_be_fitted_to(run, refused, rig, bump, tmp_path):
    plan, out = tmp_path / "plan.json", tmp_path / "captured"
    assert run("plan", "--rig", rig, "--surface", bump, "--count", 6, "--out", plan).code == 0
    outcome = run("capture", "--rig", rig, "--plan", plan, out, "--json")
    assert outcome.code == 0, outcome
    assert (outcome.json["images"], outcome.json["lights"], outcome.json["depth"]) == (6, "near", True)
    dataset, planned = open_dataset(out), read_plan(plan)
    for frame, index in zip(dataset.frames, planned.lights, strict=True):
        wanted = planned.candidates[index].position
        assert np.linalg.norm(np.subtract(frame.light.position, wanted)) < 0.7 * np.radians(0.5)
    assert dataset.provenance["capture"]["rig"]["motion"]["port"] == "sim:"
    assert dataset.image(0).max() > 0.05
    fitted = run("fit", out, "--model", "lambert", "--out", tmp_path / "model", "--json")
    assert fitted.code == 0, fitted
    # A finished capture is not taken twice, and another one does not overwrite it.
    assert run("capture", "--rig", rig, "--plan", plan, out, "--resume", "--json").json == outcome.json
    assert "--resume" in refused("capture", "--rig", rig, "--plan", plan, out)


@pytest.mark.system
def test_a_capture_applies_the_calibrations_of_its_rig_and_names_them(run, refused, tmp_path):
    candidates = [light.to_json() for light in rig_lights(demo_rig(), source="rig")[:2]]
    plan = {"schema": "lightstage-plan/1", "lights": [0, 1], "candidates": candidates, "exposures_s": [0.05, 0.1]}
    plain = tmp_path / "plain.yaml"
    plain.write_text(yaml.safe_dump(small_rig()))
    with_dark = write_json(tmp_path / "with_dark.json", plan | {"dark_frames": 2})
    assert run("capture", "--rig", plain, "--plan", with_dark, tmp_path / "first").code == 0
    frames = sorted((tmp_path / "first" / "capture" / "raw").glob("*-dark-*"))
    found = run("calibrate", "dark", *frames, "--out", tmp_path / "dark.json")
    assert found.code == 0, found
    rig = tmp_path / "rig.yaml"
    rig.write_text(yaml.safe_dump(small_rig() | {"calibrations": ["dark.json"]}))
    without = write_json(tmp_path / "without.json", plan | {"dark_frames": 0})
    assert run("capture", "--rig", rig, "--plan", without, tmp_path / "second").code == 0
    [named] = open_dataset(tmp_path / "second").provenance["capture"]["calibrations"]
    assert (named["kind"], named["file"]) == ("dark", "dark.json")
    assert named["sha256"] == hashlib.sha256((tmp_path / "dark.json").read_bytes()).hexdigest()
    assert named["residuals"]
    first, second = (open_dataset(tmp_path / name).image(0) for name in ("first", "second"))
    np.testing.assert_allclose(second.mean(), first.mean(), rtol=0.02)
    rig.write_text(yaml.safe_dump(small_rig() | {"calibrations": ["dark.json", "dark.json"]}))
    said = refused("capture", "--rig", rig, "--plan", without, tmp_path / "third")
    assert "dark.json: kind: is a second calibration of kind 'dark'" in said


@pytest.mark.system
def test_capture_refuses_what_the_rig_cannot_do(refused, rig, tmp_path):
    far = {"schema": "lightstage-plan/1", "lights": [0], "candidates": [{"position": [0, 0, 3]}]}
    plan = write_json(tmp_path / "plan.json", far)
    said = refused("capture", "--rig", rig, "--plan", plan, tmp_path / "captured")
    assert f"{plan}: candidates[0].position" in said
    assert "no such file" in refused("capture", "--rig", rig, "--plan", tmp_path / "none.json", tmp_path / "captured")
    assert "no such file" in refused("capture", "--rig", tmp_path / "none", "--plan", plan, tmp_path / "captured")
    lost = write_json(tmp_path / "lost.json", far | {"provenance": {"surface": str(tmp_path / "gone.ply")}})
    assert "provenance.surface" in refused("capture", "--rig", rig, "--plan", lost, tmp_path / "captured")


def test_a_real_port_that_is_not_there_is_the_devices_failure(run, tmp_path):
    rig = tmp_path / "rig.yaml"
    ports = {"motion__port": str(tmp_path / "tty"), "light__port": str(tmp_path / "dmx"), "camera__device__port": "usb"}
    rig.write_text(yaml.safe_dump(small_rig(**ports)))
    candidates = [light.to_json() for light in rig_lights(demo_rig(), source="rig")[:3]]
    plan = write_json(
        tmp_path / "plan.json", {"schema": "lightstage-plan/1", "lights": [0, 1, 2], "candidates": candidates}
    )
    outcome = run("capture", "--rig", rig, "--plan", plan, tmp_path / "captured")
    assert (outcome.code, outcome.stdout) == (1, "")
    assert outcome.stderr.count("\n") == 1
    assert str(tmp_path / "tty") in outcome.stderr
    assert not (tmp_path / "captured").exists()


@pytest.mark.slow
@pytest.mark.system
def test_the_demo_from_plan_to_page(run, refused, monkeypatch, tmp_path):
    from api import demo_stage

    for name, value in (("WIDTH", 64), ("HEIGHT", 48), ("FOCAL_PX", 290.0)):
        monkeypatch.setattr(demo_stage, name, value)
    out = tmp_path / "demo-out"
    outcome = run("demo", "--out", out, "--json")
    assert outcome.code == 0, outcome
    found = outcome.json
    assert [row["model"] for row in found["models"]] == ["lambert", "method-1", "torrance-sparrow", "apparent-brdf"]
    assert found["plan"]["count"] < found["candidates"] == 60
    by_model = {row["model"]: row["mae_object"] for row in found["models"]}
    # Two materials and a highlight: the model that has one serves better than the one that has none.
    assert by_model["torrance-sparrow"] < by_model["lambert"] < 20
    page = (out / "report.html").read_text()
    assert page.count("<img") >= 12
    for model in ("torrance-sparrow", "apparent-brdf"):
        assert (out / "models" / model / "model.json").is_file()
        assert (out / "relit" / model / "0002.exr").is_file()
    assert len(open_dataset(out / "heldout").frames) == found["models"][0]["test"]
    assert json.loads((out / "summary.json").read_text())["plan"] == found["plan"]
    # Each step can be taken again by its own command.
    again = run(
        "plan", "--rig", out / "rig.yaml", "--surface", out / "object.ply", "--target", 0.8, "--out", out / "p.json"
    )
    assert again.code == 0, again
    taken = run("capture", "--rig", out / "rig.yaml", "--plan", out / "plan.json", tmp_path / "again", "--json")
    assert taken.code == 0, taken
    assert taken.json["images"] == found["plan"]["count"]
    assert taken.json["depth"]
    # What a demo wrote is replaced, what anyone else wrote is not.
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("keep")
    assert "not empty" in refused("demo", "--out", tmp_path / "mine")
