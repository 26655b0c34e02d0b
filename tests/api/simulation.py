"""A simulated stage in a process of its own, as `lightstage simulate` starts it."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from api.demo_stage import demo_rig
from stage.camera import Camera


def reachable_rig(width: int = 40, height: int = 30) -> dict[str, Any]:
    """The demo's rig with fast servos, a small camera, and nothing on USB."""
    description = demo_rig().to_json()
    camera = Camera.look_at(width, height, 4.5 * width, (0, -0.7, 0.98)).to_json()
    description["camera"] |= {key: camera[key] for key in ("width", "height", "K")}
    description["camera"]["device"] = {"driver": "ptp-ip", "port": "sim:", "exposure_s": 0.05}
    for joint in description["motion"]["joints"]:
        joint |= {"speed_deg_s": 300, "acceleration_deg_s2": 1200}
    return description


@dataclass
class Simulation:
    """The process, the description to use, and the control socket."""

    process: subprocess.Popen[bytes]
    rig: Path
    started: dict[str, Any]

    def ask(self, **request: Any) -> dict[str, Any]:
        """One request to the control socket, and its answer."""
        host, port = self.started["control"].rsplit(":", 1)
        with socket.create_connection((host, int(port)), timeout=10) as wire, wire.makefile("rw") as lines:
            lines.write(json.dumps(request) + "\n")
            lines.flush()
            return json.loads(lines.readline())


@contextmanager
def simulation(folder: Path, rig: dict[str, Any] | None = None, *options: str) -> Iterator[Simulation]:
    """Run the simulators until the block ends; they must end well."""
    described, plugged = folder / "described.yaml", folder / "plugged.yaml"
    described.write_text(yaml.safe_dump(rig or reachable_rig()))
    command = [
        sys.executable,
        "-m",
        "api.cli",
        "simulate",
        "--rig",
        str(described),
        "--rig-out",
        str(plugged),
        "--json",
    ]
    with subprocess.Popen([*command, *options], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        try:
            assert process.stdout is not None
            text = b""
            while not text.rstrip().endswith(b"}"):
                line = process.stdout.readline()
                assert line, process.stderr.read() if process.stderr else ""
                text += line
            running = Simulation(process, plugged, json.loads(text))
            yield running
            if process.poll() is None:
                assert running.ask(command="stop") == {"ok": True}
            assert process.wait(20) == 0
        finally:
            process.kill()
