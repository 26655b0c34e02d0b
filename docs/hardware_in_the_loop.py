"""Hardware in the loop: a whole capture over real ports, while three things go wrong at random moments.

    .venv/bin/python docs/hardware_in_the_loop.py [--lights 60] [--seed 1] [--out hil-out]

The simulators run in a process of their own and answer on a pseudo-terminal for the servos, another for the DMX light,
and a TCP port for the camera. Everything else is what an operator types. At the end the dataset must be complete and
every light where it was planned.
"""

from __future__ import annotations

import argparse
import json
import random
import socket
import statistics
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from acquisition.dataset import open_dataset
from api.demo_stage import demo_rig

LIGHTSTAGE = [sys.executable, "-m", "api.cli"]
FAULTS: tuple[dict[str, Any], ...] = (
    {"device": "motion", "fault": "silent", "times": 1},
    {"device": "motion", "fault": "garbled", "times": 1},
    {"device": "motion", "fault": "stale", "times": 1},
    {"device": "motion", "fault": "brown-out", "servo": 2},
    {"device": "motion", "fault": "unplug", "for_s": 1.0},
    {"device": "light", "fault": "silent", "times": 1},
    {"device": "light", "fault": "brown-out"},
    {"device": "light", "fault": "unplug", "for_s": 1.0},
    {"device": "camera", "fault": "asleep"},
    {"device": "camera", "fault": "busy"},
    {"device": "camera", "fault": "lost-picture"},
    {"device": "camera", "fault": "missing-announcement"},
    {"device": "camera", "fault": "repeated-frame"},
    {"device": "camera", "fault": "torn-download"},
)
"""What a capture must survive without anybody's help."""
MESSAGES = {"motion": 20, "light": 3, "camera": 5}
"""About how many messages a shot takes, so that faults fall into the capture."""


def rig() -> dict[str, Any]:
    """The demonstration's stage with faster servos, and a camera that can be reached from another process."""
    description = demo_rig().to_json()
    for joint in description["motion"]["joints"]:
        joint |= {"speed_deg_s": 300, "acceleration_deg_s2": 1200}
    description["camera"]["device"] = {"driver": "ptp-ip", "port": "sim:", "exposure_s": 0.05}
    return description


@contextmanager
def simulated(rig: Path, plugged: Path) -> Iterator[socket.socket]:
    """The simulators, and a connection to their control socket."""
    command = [*LIGHTSTAGE, "simulate", "--rig", str(rig), "--rig-out", str(plugged), "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        text = ""
        while not text.rstrip().endswith("}"):
            line = process.stdout.readline().decode()
            if not line:
                raise SystemExit("the simulators did not start")
            text += line
        host, port = json.loads(text)["control"].rsplit(":", 1)
        with socket.create_connection((host, int(port))) as control:
            try:
                yield control
            finally:
                ask(control, {"command": "stop"})


def ask(control: socket.socket, request: dict[str, Any]) -> dict[str, Any]:
    """One line to the control socket, and its answer."""
    control.sendall(json.dumps(request).encode() + b"\n")
    answer = json.loads(control.makefile().readline())
    if not answer["ok"]:
        raise SystemExit(answer["error"])
    return answer


def run(lights: int, seed: int, out: Path) -> dict[str, Any]:
    """Plan, let things go wrong, capture, and look at what came of it."""
    out.mkdir(parents=True)
    ideal, plugged, plan, captured = (out / name for name in ("rig.yaml", "plugged.yaml", "plan.json", "captured"))
    ideal.write_text(yaml.safe_dump(rig()))
    lightstage("plan", "--rig", ideal, "--method", "farthest", "--count", lights, "--out", plan)
    with simulated(ideal, plugged) as control:
        rng = random.Random(seed)
        faults = rng.sample(FAULTS, 3)
        for fault in faults:
            device = fault["device"]
            moment = rng.randrange(5 * MESSAGES[device], max(lights - 5, 6) * MESSAGES[device])
            ask(control, fault | {"at_message": moment})
        lightstage("capture", "--rig", plugged, "--plan", plan, captured)
        left_dark = not any(ask(control, {"command": "state"})["intensity"])
    return {"lights": lights, "faults": faults, "left_dark": left_dark} | judged(captured, plan)


def lightstage(*arguments: object) -> None:
    """What an operator types."""
    subprocess.run([*LIGHTSTAGE, *map(str, arguments)], check=True, stdout=subprocess.DEVNULL)


def judged(captured: Path, plan: Path) -> dict[str, Any]:
    """Whether the dataset is complete, how far its lights are from where they were planned, and where time went."""
    dataset = open_dataset(captured)
    planned = json.loads(plan.read_text())
    wanted = np.array([planned["candidates"][index]["position"] for index in planned["lights"]])
    found = np.array([frame.light.position for frame in dataset.frames])
    cosine = (wanted * found).sum(1) / np.linalg.norm(wanted, axis=1) / np.linalg.norm(found, axis=1)
    shots = [json.loads(line) for line in (captured / "capture" / "shots.jsonl").read_text().splitlines()]
    parts = ("move", "settle", "light", "expose", "download", "decode", "write")
    lit = [shot["spans"] for shot in shots if shot["kind"] == "light"]
    return {
        "complete": len(found) == len(wanted),
        "tried_again": sum(shot["attempts"] > 1 for shot in shots),
        "worst_deg": float(np.degrees(np.arccos(np.clip(cosine, -1, 1))).max()),
        "median_ms": {
            part: round(1000 * statistics.median(end - begin for begin, end in spans), 1)
            for part, spans in ((part, [shot[part] for shot in lit]) for part in parts)
        },
    }


def main() -> None:
    """Run, and say what came of it."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    options.add_argument("--lights", type=int, default=60)
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--out", type=Path, default=Path("hil-out"))
    result = run(**vars(options.parse_args()))
    print(json.dumps(result, indent=1))
    if not (result["complete"] and result["left_dark"]):
        raise SystemExit("the capture is not what it should be")


if __name__ == "__main__":
    main()
