"""Verb ``rig check``: open every device of a stage, have each do a little, and report."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from acquisition.conditions import conditions_of
from acquisition.radiance import RawFrame, read_frame
from api.devices import Workshop, on_its_wires
from api.rig_file import in_rig, read_calibrated_rig
from stage.clock import Clock
from stage.devices import AxisGroup, Device, FrameCamera, Lamp
from stage.errors import DeviceError, InputError
from stage.rig import FixedDome, Rig

TRIAL_DEG, TRIAL_M = 5.0, 0.02
"""How far each joint is moved from where it stands, where moving was asked for."""
BLINKS, BLINK_S = 2, 0.5
"""How often the light comes on, and for how long it stays on and off: well below 3 Hz."""
SEEN_SIGMA = 5.0
"""The lamp is seen where the lit frame is brighter than the dark one by so many standard errors."""


@dataclass
class Finding:
    """What is to be said of one device.

    Attributes
    ----------
    role, device : str
        What it is for, and how errors call it.
    trouble : str or None
        What is wrong, in one sentence; None where all is well.
    facts : dict
        What it said and did.
    """

    role: str
    device: str
    trouble: str | None = None
    facts: dict[str, Any] = field(default_factory=dict)

    def said(self) -> dict[str, Any]:
        """For people: whether all is well, or what is not, and the facts."""
        return {"trouble": self.trouble or "none", **self.facts}

    def to_json(self) -> dict[str, Any]:
        """For machines."""
        verdict = {"ok": self.trouble is None, "trouble": self.trouble}
        return {"role": self.role, "device": self.device, **verdict, **self.facts}


def check_rig(path: Path, *, move: bool = False) -> list[Finding]:
    """Open every device of a rig, blink the light, take a dark and a lit frame; a device that fails stops no other.

    Parameters
    ----------
    path : Path
        ``rig.yaml``.
    move : bool
        Whether each joint may move by 5 degrees or 20 mm and back, within its limits, and a machine home itself.

    Returns
    -------
    list of Finding
        One per device: motion, light, camera, what the camera sees of the light, and whether each interlock would let
        a capture go on.

    Raises
    ------
    InputError
        For a description that is wrong; nothing is opened then.
    """
    rig = read_calibrated_rig(path)
    try:
        findings = _findings(rig, path.parent, move)
    except InputError as error:
        raise InputError(in_rig(str(error), path)) from None
    for finding in findings:
        if finding.trouble is not None:
            finding.trouble = in_rig(finding.trouble, path)
    return findings


def _findings(rig: Rig, folder: Path, move: bool) -> list[Finding]:
    with on_its_wires(rig if move else rig.at_rest()) as wires, ExitStack() as stack:
        plugged, clock = wires.rig, wires.clock
        workshop = Workshop(plugged, clock, wires.usb, wires.world)
        motion = _opened(stack, "motion", workshop.motion)
        lamp = _opened(stack, "light", workshop.lamp)
        camera = _opened(stack, "camera", workshop.camera)
        if motion[1] is not None:
            with _noted(motion[0]):
                motion[0].facts |= _try_motion(motion[1], plugged, move)
        if lamp[1] is not None:
            with _noted(lamp[0]):
                lamp[0].facts |= _blink(lamp[1], clock)
        if camera[1] is not None:
            with _noted(camera[0]):
                camera[0].facts |= _take(camera[1], plugged)
        findings = [motion[0], lamp[0], camera[0]]
        if lamp[1] is not None and camera[1] is not None and findings[2].trouble is None:
            sight = Finding("view", f"{findings[2].device}, {findings[1].device}")
            findings.append(sight)
            with _noted(sight):
                sight.facts |= _seen(lamp[1], camera[1], plugged, clock)
        devices = [device for _, device in (motion, lamp, camera)]
        if None not in devices:
            for condition in conditions_of(rig, devices, folder, clock):
                findings.append(Finding("interlock", condition.name, condition.reason()))
        return findings


def _opened(stack: ExitStack, role: str, build: Callable[[], Any]) -> tuple[Finding, Any]:
    """A device that is open, or None and why not."""
    finding = Finding(role, role)
    with _noted(finding):
        device: Device = build()
        finding.device = device.name
        opened = stack.enter_context(device)
        finding.device = device.name  # some know their model only now
        return finding, opened
    return finding, None


@contextmanager
def _noted(finding: Finding) -> Iterator[None]:
    try:
        yield
    except (DeviceError, InputError) as error:
        finding.trouble = str(error)


def _try_motion(motion: AxisGroup, rig: Rig, move: bool) -> dict[str, Any]:
    if isinstance(rig.motion, FixedDome):
        return {"joints": []}
    joints, here = rig.motion.joints, motion.positions()
    facts: dict[str, Any] = {
        "joints": [joint.shown(value) for joint, value in zip(joints, here, strict=True)],
        "light_m": np.round(rig.motion.light_position(here), 4).tolist(),
    }
    if not move:
        return facts
    worst = 0.0
    # a machine's home may lie beyond the limits
    inside = [min(max(value, low), high) for value, (low, high) in zip(here, rig.motion.limits, strict=True)]
    for number, joint in enumerate(joints):
        step = TRIAL_M if joint.whole_turn is None else math.radians(TRIAL_DEG)
        target = list(inside)
        low, high = joint.limits
        target[number] = inside[number] + step if inside[number] + step <= high else max(inside[number] - step, low)
        for goal in (target, inside):
            if (reason := rig.moving_obstruction(motion.positions(), goal)) is not None:
                raise InputError(f"rig: {reason}; the joints were left where they stand")
            reached = motion.move_to(goal).positions
            worst = max(worst, *(abs(a - b) / t for a, b, t in zip(reached, goal, rig.motion.tolerances, strict=True)))
    return facts | {"moved": True, "worst_error_of_tolerance": round(worst, 3)}


def _blink(lamp: Lamp, clock: Clock) -> dict[str, Any]:
    levels: tuple[float, ...] = ()
    for _ in range(BLINKS):
        levels = lamp.set_level(1.0)
        clock.sleep(BLINK_S)
        lamp.dark()
        clock.sleep(BLINK_S)
    return {"emitters": lamp.emitters, "blinks": BLINKS, "levels": list(levels)}


def _take(camera: FrameCamera, rig: Rig) -> dict[str, Any]:
    device = rig.camera.device
    try:
        camera.require_exposure(device.exposure_s)
    except InputError as error:
        raise InputError(f"rig: camera.device.{error}") from None
    frame = camera.capture(device.exposure_s)
    raw = read_frame(frame.data, frame.name, transfer=rig.camera.device.transfer)
    facts = {
        "frame": frame.name,
        "bytes": len(frame.data),
        "pixels": list(raw.size),
        "expose_s": round(frame.expose_s, 3),
        "download_s": round(frame.download_s, 3),
        **frame.metadata,
    }
    if raw.size != (rig.camera.width, rig.camera.height):
        raise InputError(
            f"rig: camera.width, camera.height: expected {raw.size[0]} x {raw.size[1]}, as the camera's pictures are, "
            f"got {rig.camera.width} x {rig.camera.height}"
        )
    return facts


def _seen(lamp: Lamp, camera: FrameCamera, rig: Rig, clock: Clock) -> dict[str, Any]:
    lamp.dark()
    dark = _decoded(camera, rig)
    lamp.set_level(1.0)
    lit = _decoded(camera, rig)
    lamp.dark()
    gain = lit.values.mean(-1) - dark.values.mean(-1)
    sigma = float(gain.std()) / math.sqrt(gain.size) or math.inf
    facts = {
        "brighter_by": round(float(gain.mean()) / (lit.white - float(lit.black.mean())), 5),
        "clipped_share": round(float(lit.clipped.any(-1).mean()), 4),
    }
    if not gain.mean() > SEEN_SIGMA * sigma:
        raise DeviceError(
            "view: the camera does not see the lamp come on; check that it is connected to the channels that the rig "
            "names, that it lights the object, and that the exposure is long enough"
        )
    return facts


def _decoded(camera: FrameCamera, rig: Rig) -> RawFrame:
    frame = camera.capture(rig.camera.device.exposure_s)
    return read_frame(frame.data, frame.name, transfer=rig.camera.device.transfer)
