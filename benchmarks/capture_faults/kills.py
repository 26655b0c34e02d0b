"""The command ``lightstage capture`` in processes that are killed at random bytes and moments, and resumed.

The stage is simulated as always (``sim:``), drivers and wires included; only its pictures say what they are of.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import tifffile
import yaml
from numpy.typing import NDArray

import simulators.world
from acquisition.plan import CapturePlan, PlannedLight, Shot, write_plan
from api import cli
from api.demo_stage import ARM_M, LAMP, demo_rig
from benchmarks.capture_faults.identity import Identity, MarkedSensor
from benchmarks.capture_faults.kill_switch import Count, KillSwitch
from benchmarks.capture_faults.verify import Line, lines, losses, mistakes
from simulators.image_formation import ImageFormer
from simulators.raw import Sensor, blocks_to_rgb, through_filters
from simulators.scene import dish
from simulators.view import Pinhole
from simulators.world import STRAY_RADIANCE, RigWorld
from stage.camera import Camera
from stage.lights import dome
from stage.rig import Rig, rig_from_mapping

WIDTH, HEIGHT = 40, 30
EXPOSURE_S = 0.05
USED = ("api.verbs.capturing", "drivers.dynamixel", "drivers.enttec", "drivers.ptp_camera", "simulators.stage_sim")
"""What the command loads as it goes; here it is loaded once, and not in every process."""
MOST_RUNS = 60
MOST_WRONG = 20
FRAMES_PER_RUN = 1_000_000
RANGES: dict[Count, int] = {"bytes of frames": 25_000, "bytes of lines": 4_000, "steps": 60}
"""How much of it a run does at most before it is killed: two to four shots' worth."""
AT_A_MOMENT, LONGEST_S = 0.25, 1.0
"""Share of the processes that are killed from outside, and after how long at most."""
LOOK_S = 0.002
HANG_S = 60.0
LOG = "log.txt"
UNLIKE = 0.1
UNLIKE_DARK = 0.3
"""Mean difference from the computed picture, as a share of its brightness, above which it is one of something else; a
dark frame is mostly noise."""


def small_rig() -> Rig:
    """The demo's rig with fast servos and a small camera."""
    description = demo_rig().to_json()
    place = Camera.look_at(WIDTH, HEIGHT, 4.5 * WIDTH, (0, -0.7, 0.98)).to_json()
    description["camera"] |= {key: place[key] for key in ("width", "height", "K")}
    for joint in description["motion"]["joints"]:
        joint |= {"speed_deg_s": 300, "acceleration_deg_s2": 1200}
    return rig_from_mapping(description, "kills")


class MarkedWorld(RigWorld):
    """A simulated world whose photographs say what they are of.

    Parameters
    ----------
    built : ImageFormer
        The object, computed once for all.
    first_frame : int
        Number of the first photograph.
    """

    def __init__(self, built: ImageFormer, first_frame: int, **given: Any) -> None:
        super().__init__(**given | {"former": lambda camera: built, "sensor": MarkedSensor(identify=self._identify)})
        self._next = first_frame

    def _identify(self, exposure_s: float) -> Identity:
        (x, y, z), intensity = self.light(self.now() + exposure_s / 2)
        number, self._next = self._next, self._next + 1
        return Identity(number, (float(x), float(y), float(z)), float(intensity[0]) / LAMP[0], exposure_s)


@dataclass
class Killed:
    """What came of captures that were killed.

    Attributes
    ----------
    kills : Counter of str
        By what was counted until the kill.
    runs, captures, frames : int
        Processes, captures, and frames that were wanted.
    wrong : list of (str, str)
        Capture, and what was wrong with it.
    """

    kills: Counter[str] = field(default_factory=Counter)
    runs: int = 0
    captures: int = 0
    frames: int = 0
    wrong: list[tuple[str, str]] = field(default_factory=list)


class Onlooker:
    """Knows what every light should look like.

    Parameters
    ----------
    rig : Rig
        Of the world.
    former : ImageFormer
        What is in it.
    """

    def __init__(self, rig: Rig, former: ImageFormer) -> None:
        self._former, self._sensor, self._stray = former, Sensor(), former.render_sky(STRAY_RADIANCE)

    def look(self, shot: Shot, path: Path) -> list[str]:
        """Whether a file shows the object under the light of its shot, in noise-free radiance; else, one sentence."""
        numbers = blocks_to_rgb(tifffile.imread(path)) - self._sensor.black_dn
        seen = numbers * np.array(self._sensor.radiance_per_dn_s()) / shot.exposure_s
        radiance = self._stray.copy()
        for light in shot.lights:
            assert light.position is not None
            radiance += self._former.render(light.position, LAMP)
        wanted = blocks_to_rgb(through_filters(radiance))
        unlike = np.abs(_coarse(seen) - _coarse(wanted)).mean() / wanted.mean()
        limit = UNLIKE if shot.lights else UNLIKE_DARK
        return [f"shot {shot.index}: mislabelled: differs by {unlike:.0%} from its light"] if unlike > limit else []


def _coarse(image: NDArray[np.float64]) -> NDArray[np.float64]:
    """Means over 5 x 5 pixels, in which little is left of the noise."""
    return np.asarray(image.reshape(HEIGHT // 5, 5, WIDTH // 5, 5, 3).mean((1, 3)))


def kill_captures(folder: Path, kills: int, seed: int) -> Killed:
    """Kill captures until they have been killed so often, and look at each when it is complete.

    Parameters
    ----------
    folder : Path
        Where they are written.
    kills, seed : int
        How often, and which.
    """
    for module in USED:
        import_module(module)
    rig, killed, rng = small_rig(), Killed(), np.random.default_rng(seed)
    place = rig.camera
    eye = Pinhole(place.width, place.height, np.array(place.K), np.array(place.world_to_camera))
    former = ImageFormer(dish(), eye.photosites())
    onlooker = Onlooker(rig, former)
    candidates = tuple(PlannedLight(position=light.position) for light in dome(5, [0.6, 1.0], ARM_M))
    plan = CapturePlan(candidates=candidates, lights=range(10), dark_frames=2, exposures_s=(EXPOSURE_S,))
    rig_file, plan_file = folder / "rig.yaml", folder / "plan.json"
    rig_file.write_text(yaml.safe_dump(rig.to_json()))
    write_plan(plan, plan_file)
    while killed.kills.total() < kills and len(killed.wrong) < MOST_WRONG:
        out, where = folder / f"capture{killed.captures}", f"--seed {seed}, capture {killed.captures}"
        killed.captures += 1
        killed.frames += len(plan.shots())
        before: list[Line] = []
        for run in range(MOST_RUNS):
            killed.runs += 1
            command = ["lightstage", "capture", "--rig", str(rig_file), "--plan", str(plan_file), str(out)]
            status = _run_and_kill(command + ["--resume"] * (run > 0), out, former, FRAMES_PER_RUN * run, rng, killed)
            wrong = losses(out, before)
            before = lines(out)
            if status == 0:
                wrong += mistakes(out, plan, look=onlooker.look)
            elif status != -signal.SIGKILL:
                wrong.append(f"ended with status {status}: {(folder / LOG).read_text().strip()}")
            killed.wrong += [(f"{where}, run {run + 1}", one) for one in wrong]
            if status == 0 or wrong:
                break
        else:
            killed.wrong.append((where, f"not complete after {MOST_RUNS} runs"))
    return killed


def _run_and_kill(
    command: list[str], out: Path, former: ImageFormer, first_frame: int, rng: np.random.Generator, killed: Killed
) -> int:
    """Run the command in a process, and kill it somewhere if it lasts so long; returns its exit status."""
    counts = list(RANGES)
    switch = None if rng.random() < AT_A_MOMENT else counts[int(rng.integers(len(counts)))]
    after = int(rng.integers(RANGES[switch or counts[0]]))
    pid = os.fork()
    if not pid:
        _child(command, out, partial(MarkedWorld, former, first_frame), switch, after)
    end_s = time.monotonic() + (HANG_S if switch else float(rng.uniform(0, LONGEST_S)))
    while os.waitid(os.P_PID, pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None:
        if time.monotonic() > end_s:
            os.kill(pid, signal.SIGKILL)
            break
        time.sleep(LOOK_S)
    status = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    if status == -signal.SIGKILL:
        killed.kills[switch or "moments"] += 1
    return status


def _child(command: list[str], out: Path, world: Callable[..., RigWorld], switch: Count | None, after: int) -> NoReturn:
    """Be the command; never returns."""
    status = 99
    try:
        log = os.open(out.parent / LOG, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(log, 1)
        os.dup2(log, 2)
        setattr(simulators.world, "RigWorld", world)  # noqa: B010  # which the command looks up there
        if switch:
            KillSwitch(out, switch, after).arm()
        sys.argv = command
        cli.main()
        status = 0
    except SystemExit as ended:
        status = ended.code if isinstance(ended.code, int) else 0
    finally:
        os._exit(status)
