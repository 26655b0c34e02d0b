"""A stage as a person describes it: devices, joints and kinematics, light, camera."""

from __future__ import annotations

from stage.rig.camera import CameraPlace, Gphoto2, OpenCvStream, PtpIp, PtpUsb, Replay
from stage.rig.description import Rig, rig_from_mapping
from stage.rig.interlocks import AnyInterlock, CommandInterlock, Interlock, TemperatureInterlock
from stage.rig.joints import GrblSlide, GrblTurn, Joint, LinearJoint, RevoluteJoint, ServoJoint
from stage.rig.light import (
    AnyLight,
    DmxEmitter,
    Emitter,
    EnttecLight,
    LightSource,
    SpindleEmitter,
    SpindleLight,
    SupplyEmitter,
    SupplyLight,
    UdmxLight,
)
from stage.rig.motion import AnyMotion, DynamixelMotion, FixedDome, GrblMotion, Motion, UrMotion
from stage.rig.parts import SLACK

__all__ = [
    "SLACK",
    "AnyInterlock",
    "AnyLight",
    "AnyMotion",
    "CameraPlace",
    "CommandInterlock",
    "DmxEmitter",
    "DynamixelMotion",
    "Emitter",
    "EnttecLight",
    "FixedDome",
    "Gphoto2",
    "GrblMotion",
    "GrblSlide",
    "GrblTurn",
    "Interlock",
    "Joint",
    "LightSource",
    "LinearJoint",
    "Motion",
    "OpenCvStream",
    "PtpIp",
    "PtpUsb",
    "Replay",
    "RevoluteJoint",
    "Rig",
    "ServoJoint",
    "SpindleEmitter",
    "SpindleLight",
    "SupplyEmitter",
    "SupplyLight",
    "TemperatureInterlock",
    "UdmxLight",
    "UrMotion",
    "rig_from_mapping",
]
