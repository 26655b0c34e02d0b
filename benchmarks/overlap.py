"""How near a session comes to the bound per shot, expose + max(move + settle, download), in real time on real wires.

Servos and lamp are simulated on pseudo-terminals and the camera on TCP, at the pace of real ones: an exposure takes
0.1 s and a download 1 s. The same capture is repeated with each shot on the disk before the light moves on.

``python -m benchmarks.overlap FILE.png`` also draws some shots of both.
"""

from __future__ import annotations

import json
import statistics
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2

from acquisition.capture import capture
from acquisition.plan import CapturePlan, DomeLights
from acquisition.session import Session
from acquisition.taken import TakenShot
from api.demo_stage import ARM_M, demo_rig
from api.devices import Workshop
from api.report.timeline import Course, timeline_picture
from simulators.clock import RunningClock
from simulators.stage_sim import SimulatedStage
from simulators.world import RigWorld
from stage.camera import Camera
from stage.devices import Arrival, AxisGroup
from stage.rig import Rig, rig_from_mapping

LIGHTS = 40
EXPOSURE_S, DOWNLOAD_S = 0.1, 1.0
WIDTH, HEIGHT = 40, 30
DRAWN = slice(10, 18)
LOOK_S, LONGEST_S = 0.001, 30.0


def run() -> dict[str, Any]:
    """Capture with and without overlap.

    Returns
    -------
    dict
        ``lights``, ``bound_s``, ``taken_s`` and ``over_bound``, the share by which that is longer; ``expose_s`` and
        ``download_s`` of a shot as measured, medians; ``one_after_the_other_s``, the same capture without overlap, and
        ``gain``, how many times faster it is with.
        The bound has the camera's times as they were set, and moving, settling and setting the lamp as measured.
    """
    return _figures(*_both())


def _both() -> tuple[list[TakenShot], list[TakenShot]]:
    with tempfile.TemporaryDirectory() as place:
        return shots_of(Path(place) / "side-by-side"), shots_of(Path(place) / "in-turn", in_turn=True)


def _figures(together: Sequence[TakenShot], in_turn: Sequence[TakenShot]) -> dict[str, Any]:
    bound, taken = bound_s(together), taken_s(together)
    return {
        "lights": len(together),
        "bound_s": bound,
        "taken_s": taken,
        "over_bound": taken / bound - 1,
        "expose_s": statistics.median(shot.seconds("expose") for shot in together),
        "download_s": statistics.median(shot.seconds("download") for shot in together),
        "one_after_the_other_s": taken_s(in_turn),
        "gain": taken_s(in_turn) / taken,
    }


def bound_s(shots: Sequence[TakenShot]) -> float:
    """Least time for shots in this order: the light stands still while the shutter is open, and no longer than it must.

    From the first move to the last download.
    """
    moves = [sum(shot.seconds(stage) for stage in ("move", "settle", "light")) for shot in shots]
    return moves[0] + sum(EXPOSURE_S + max(move, DOWNLOAD_S) for move in [*moves[1:], 0.0])


def taken_s(shots: Sequence[TakenShot]) -> float:
    """Time from the first move to the last frame on the disk."""
    return max(shot.spans["write"][1] for shot in shots) - shots[0].spans["move"][0]


def shots_of(out: Path, *, in_turn: bool = False) -> list[TakenShot]:
    """Capture into a folder; returns what was recorded, in the order of time.

    Parameters
    ----------
    out : Path
        Folder of the dataset.
    in_turn : bool
        Whether to wait for each frame to be on the disk before the light moves on.
    """
    rig = real_pace()
    plan = CapturePlan(
        candidates=DomeLights(kind="dome", count=LIGHTS, radius_m=ARM_M, elevation_deg=(20, 80)), dark_frames=0
    )
    clock = RunningClock()
    try:
        world = RigWorld(rig=rig, seed=0, clock=clock.now)
        with SimulatedStage(world, rig, clock) as stage:
            workshop = Workshop(stage.rig, clock)
            with workshop.motion() as arm, workshop.lamp() as lamp, workshop.camera() as camera:
                pace = Pace(arm, in_turn=in_turn)
                attended, progress = pace.attending, pace.progress
                capture(plan, pace, lamp, camera, out, rig=stage.rig, clock=clock, attended=attended, progress=progress)
    finally:
        clock.close()
    lines = (out / "capture" / "shots.jsonl").read_text().splitlines()
    return sorted(map(TakenShot.model_validate_json, lines), key=lambda shot: shot.spans["expose"])


def real_pace() -> Rig:
    """The demo's stage with a camera on the network that is as slow as a real one."""
    description = demo_rig().to_json()
    place = Camera.look_at(WIDTH, HEIGHT, 4.5 * WIDTH, (0, -0.7, 0.98)).to_json()
    timing = {"readout_s": 0.0, "download_s": DOWNLOAD_S}
    device = {"driver": "ptp-ip", "port": "sim:", "exposure_s": EXPOSURE_S, "shutter_lag_s": 0.0, "timing": timing}
    description["camera"] |= {key: place[key] for key in ("width", "height", "K")} | {"device": device}
    return rig_from_mapping(description, "overlap")


class Pace:
    """The joints that it is given, and a session that can be made to wait until each frame is recorded.

    Parameters
    ----------
    joints : AxisGroup
        What really moves.
    in_turn : bool
        Whether the session has to wait.
    """

    def __init__(self, joints: AxisGroup, *, in_turn: bool) -> None:
        self._joints, self._in_turn = joints, in_turn
        self._session: Session | None = None
        self._moves = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._joints, name)

    @contextmanager
    def attending(self, session: Session) -> Iterator[None]:
        """Learn from a session what is recorded."""
        self._session = session
        yield

    def move_to(self, targets: Sequence[float]) -> Arrival:
        """See `AxisGroup.move_to`."""
        self._moves += 1
        return self._joints.move_to(targets)

    def progress(self, share: float) -> None:
        """Called by the session between two shots."""
        end_s = time.monotonic() + LONGEST_S
        while self._in_turn and self._session and self._session.status().taken < self._moves:
            if time.monotonic() > end_s:
                raise TimeoutError("a frame was not recorded")
            time.sleep(LOOK_S)


def picture(together: Sequence[TakenShot], in_turn: Sequence[TakenShot], file: Path) -> None:
    """Draw some shots of both captures."""
    found = _figures(together, in_turn)
    shown = [
        Course(f"{name}: {taken_s(shots):.1f} s for all {len(shots)}", shots[DRAWN])
        for name, shots in (
            ("side by side", together),
            ("one after the other", in_turn),
        )
    ]
    lede = (
        f"Simulated servos, lamp and camera on real wires in real time: exposure {EXPOSURE_S:g} s (grey), download "
        f"{DOWNLOAD_S:g} s. The bound is {found['bound_s']:.1f} s; {100 * found['over_bound']:.1f} % more were taken."
    )
    drawn = timeline_picture(shown, f"{DRAWN.stop - DRAWN.start} shots of {found['lights']}", lede)
    cv2.imwrite(str(file), drawn[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])


if __name__ == "__main__":
    measured = _both()
    if sys.argv[1:]:
        picture(*measured, Path(sys.argv[1]))
    print(json.dumps(_figures(*measured), indent=1))
