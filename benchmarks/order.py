"""Seconds that the joints move: in the order of the list, always to the nearest light, and in the order that was found.

``python -m benchmarks.order PICTURE`` draws the ways of a pan-tilt arm through its joint angles.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from acquisition.order import Route, order_shots
from acquisition.routing.travel import Places, motion_profile
from api.report.canvas import CHOSEN, MUTED, blank, write
from stage.camera import Camera
from stage.rig import Motion, Rig, rig_from_mapping

Array = NDArray[np.float64]

FEW, MANY = 60, 4186
RADIUS_M = 0.7
TURNS = {"limits_deg": [-170, 170]}, {"limits_deg": [0, 90]}
GRBL = {"driver": "grbl", "port": "sim:"}
MOTIONS: dict[str, dict[str, Any]] = {
    "pan-tilt on servos": {
        "driver": "dynamixel",
        "port": "sim:",
        "kinematics": {"kind": "pan-tilt", "radius_m": RADIUS_M},
        "joints": [{"servo_id": 1, **TURNS[0]}, {"servo_id": 2, **TURNS[1], "zero_deg": 90}],
    },
    "turntable and arc on GRBL": {
        **GRBL,
        "kinematics": {"kind": "turntable-arc", "radius_m": RADIUS_M},
        "joints": [
            {"axis": "X", **TURNS[0], "speed_deg_s": 20, "acceleration_deg_s2": 60},
            {"axis": "Y", **TURNS[1], "speed_deg_s": 40},
        ],
    },
    "gantry on GRBL": {
        **GRBL,
        "kinematics": {"kind": "gantry", "origin_m": [-0.3, -0.3, 0.4]},
        "joints": [{"axis": axis, "limits_m": [0.0, 0.6]} for axis in "XYZ"],
    },
    "UR5e arm": {
        "driver": "ur",
        "host": "sim:",
        "kinematics": {"kind": "arm", "model": "ur5e", "base_m": [-0.6, 0.0, 0.0]},
        "joints": [{"limits_deg": [low, low + 180]} for low in (-90, -180, 0, -180, -180, -90)],
    },
}


def run() -> list[dict[str, Any]]:
    """Order 60 and 4,186 lights for each kind of motion, from where it is home.

    Returns
    -------
    list of dict
        By motion and lights: seconds of travel `listed`, `nearest_neighbour`, `found`, the proven `bound`, the `gap` as
        a share, `rest` (seconds of rest after moves, as many in every order) and `took`, seconds of computing.
    """
    rows = []
    for name, lights in LIGHT_SETS:
        for number in (FEW, MANY):
            if name == "UR5e arm" and number == MANY:  # inverse kinematics alone would take several minutes
                continue
            for shape, positions in lights(number).items():
                rows.append({"motion": name, "lights": number, "shape": shape, **figures(stage(name), positions)})
    return rows


def stage(name: str) -> Rig:
    """A rig with one of the motions."""
    return rig_from_mapping(
        {
            "schema": "lightstage-rig/1",
            "camera": {
                **Camera.look_at(40, 30, 180.0, (0, -0.7, 0.98)).to_json(),
                "device": {"driver": "ptp-usb", "exposure_s": 0.05},
            },
            "motion": MOTIONS[name],
            "light": {
                "driver": "enttec-dmx-usb-pro",
                "port": "sim:",
                "emitters": [{"channel": 1, "intensity": [1.0, 1.0, 1.0]}],
            },
        },
        "order",
    )


def on_a_dome(number: int) -> dict[str, Array]:
    """Lights all round within reach of the pan: on a spiral and at random; and the grid of two degrees (K02)."""
    rng, step = np.random.default_rng(4), np.arange(number) + 0.5
    spiral = np.stack([(step * (5**0.5 - 1) / 2) % 1, step / number], -1)
    found = {"spiral": spiral, "random": rng.uniform(size=(number, 2))}
    shapes = {shape: _on_sphere(np.radians(340 * (share[:, 0] - 0.5)), share[:, 1]) for shape, share in found.items()}
    return shapes | ({"grid": quarter_grid()} if number == MANY else {})


def quarter_grid() -> Array:
    """Every two degrees of azimuth and elevation over the upper front quarter sphere, row by row: 91 x 46."""
    azimuth, elevation = np.radians(np.arange(-90.0, 91.0, 2.0)), np.radians(np.arange(0.0, 91.0, 2.0))
    around, up = np.meshgrid(azimuth, elevation)
    return _on_sphere(around.ravel(), np.sin(up.ravel()))


def in_a_box(number: int) -> dict[str, Array]:
    """Lights at random in a gantry's room."""
    low = np.array([-0.3, -0.3, 0.4])
    return {"random": np.random.default_rng(4).uniform(low, low + 0.6, (number, 3))}


def about_an_arm(number: int) -> dict[str, Array]:
    """Lights where postures drawn at random put them, above the table."""
    motion = stage("UR5e arm").motion
    assert isinstance(motion, Motion)
    low, high = np.array(motion.limits).T
    places = motion.light_position(np.random.default_rng(4).uniform(low, high, (20 * number, len(low))))
    return {"random": places[places[:, 2] > 0.2][:number]}


LIGHT_SETS: tuple[tuple[str, Callable[[int], dict[str, Array]]], ...] = (
    ("pan-tilt on servos", on_a_dome),
    ("turntable and arc on GRBL", on_a_dome),
    ("gantry on GRBL", in_a_box),
    ("UR5e arm", about_an_arm),
)


def figures(rig: Rig, positions: Array) -> dict[str, float | None]:
    """What each order costs."""
    assert isinstance(rig.motion, Motion)
    home = rig.motion.home
    begin = time.perf_counter()
    route = order_shots(rig, positions, home)
    took = time.perf_counter() - begin
    return {
        "listed": _along(rig.motion, as_listed(rig.motion, positions)),
        "nearest_neighbour": _along(rig.motion, nearest_neighbours(rig.motion, route)),
        "found": route.travel_s,
        "bound": route.lower_bound_s,
        "gap": route.gap,
        "rest": route.settle_s,
        "took": took,
    }


def as_listed(motion: Motion, positions: Array) -> Array:
    """Joint values from home through all lights in the order of the list, always by the shortest move: (n + 1, k)."""
    joints = [motion.home]
    for position in positions:
        joints.append(motion.joints_for_position(position, joints[-1]))
    return np.array(joints)


def nearest_neighbours(motion: Motion, route: Route) -> Array:
    """The joint values of a route from home, always on to those that are nearest: (n + 1, k)."""
    places = Places(np.array([motion.home, *route.joints]), np.arange(len(route.joints) + 2), motion_profile(motion))
    left, way = np.ones(len(places), dtype=bool), [0]
    left[0] = False
    while left.any():
        here = way[-1]
        way.append(int(np.where(left, places.seconds(here, here + 1)[0], np.inf).argmin()))
        left[way[-1]] = False
    return np.asarray(places.postures[way])


def _along(motion: Motion, joints: Array) -> float:
    rows = joints.tolist()
    return sum(map(motion.travel_s, rows, rows[1:]))


def _on_sphere(azimuth: Array, height: Array) -> Array:
    """Positions at `RADIUS_M`, for azimuths in radians and heights as a share of the radius."""
    out = np.sqrt(np.maximum(1 - height**2, 0))
    return RADIUS_M * np.stack([out * np.cos(azimuth), out * np.sin(azimuth), height], -1)


def write_picture(path: Path) -> None:
    """Pan to the right and tilt upwards: 60 lights on rings and the grid of two degrees, as listed and in order."""
    rig = stage("pan-tilt on servos")
    assert isinstance(rig.motion, Motion)
    azimuth, height = np.meshgrid(np.radians(np.linspace(-162, 162, 20)), np.sin(np.radians([15, 40, 65])))
    few = _on_sphere(azimuth.ravel(), height.ravel())
    rows = []
    for positions, words in ((few, "lights on three rings"), (quarter_grid(), "lights every two degrees")):
        route = order_shots(rig, positions, rig.motion.home)
        found = np.array([rig.motion.home, *route.joints])
        listed = as_listed(rig.motion, positions)
        title = f"{len(positions):,} {words}: "
        rows.append(
            np.hstack(
                [
                    panel(listed, f"{title}{_along(rig.motion, listed):.1f} s of travel as listed"),
                    panel(found, f"{route.travel_s:.1f} s in order, bound {route.lower_bound_s:.1f} s"),
                ]
            )
        )
    cv2.imwrite(str(path), np.vstack(rows)[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])


def panel(joints: Array, title: str) -> NDArray[np.uint8]:
    """One way through pan and tilt."""
    width, height, margin, top = 760, 400, 20, 44
    canvas = blank(width, height)
    write(canvas, title, margin, 28, 17)
    low, high = joints.min(0), joints.max(0)
    share = (joints - low) / (high - low)
    room = np.array([width - 2 * margin, height - top - margin])
    at = np.rint(16 * ([margin, height - margin] + share * room * [1, -1])).astype(np.int32)
    cv2.polylines(canvas, [at], False, CHOSEN, 1, cv2.LINE_AA, 4)
    if len(at) < 1000:
        for place in at.tolist():
            cv2.circle(canvas, place, 3 * 16, MUTED, -1, cv2.LINE_AA, 4)
    return np.asarray(canvas)


if __name__ == "__main__":
    if sys.argv[1:]:
        write_picture(Path(sys.argv[1]))
    else:
        print(json.dumps(run(), indent=1))
