"""Whether a servo is fit to be moved as its joint asks, before its torque is switched on."""

from __future__ import annotations

import math
from collections.abc import Mapping

from drivers import dynamixel_table as table
from drivers.dynamixel_profile import velocity_units
from stage.rig import ServoJoint


def to_ticks(joint: ServoJoint, angle: float) -> int:
    """Encoder steps of a joint angle, radians."""
    return round(joint.machine_value(angle) / table.RAD_PER_TICK)


def from_ticks(joint: ServoJoint, ticks: int) -> float:
    """Joint angle, radians, of encoder steps."""
    return joint.joint_value(ticks * table.RAD_PER_TICK)


def alarm(servo: int, state: Mapping[str, int]) -> str:
    """What a servo's hardware error bits say; empty where there are none.

    Parameters
    ----------
    servo : int
        Its id.
    state : mapping of str to int
        Values of `dynamixel_table.CONDITION` by name.
    """
    status = state[table.HARDWARE_ERROR.name]
    if not status:
        return ""
    causes = [name for bit, name in table.HARDWARE_ERRORS.items() if status & bit] or ["unknown"]
    volts, degrees = state[table.PRESENT_VOLTAGE.name] / 10, state[table.PRESENT_TEMPERATURE.name]
    return (
        f"servo {servo} reports {' and '.join(causes)} (Hardware Error Status 0x{status:02X}, {volts:g} V, "
        f"{degrees} degrees C)"
    )


def unfit(
    joint: ServoJoint, model: int, setup: Mapping[str, int], state: Mapping[str, int], tolerance_ticks: int
) -> tuple[str, str] | None:
    """What keeps a servo from being moved, and what to do about it; None where nothing does.

    Parameters
    ----------
    joint : ServoJoint
        What the rig says.
    model : int
        Model number that the servo says it is.
    setup, state : mapping of str to int
        Values of `dynamixel_table.SETUP` and `.CONDITION` by name.
    tolerance_ticks : int
        How far beyond its limits the joint may be found.
    """
    servo = joint.servo_id
    who = f"servo {servo} ({table.MODELS.get(model, 'unknown')})"
    if model not in table.MODELS:
        return f"servo {servo} says it is model {model}", "use an X-series servo with 4096 steps per turn"
    if alarmed := alarm(servo, state):
        return alarmed, "remove the cause, then power-cycle the servo"
    mode = setup[table.OPERATING_MODE.name]
    if mode not in table.POSITION_MODES:
        return (
            f"{who} is in operating mode {mode}, not in a position mode",
            "set Operating Mode(11) to 3 or 4 with the vendor's tool",
        )
    fastest = setup[table.VELOCITY_LIMIT.name]
    if velocity_units(joint) > fastest:
        allowed = math.degrees(fastest * table.RAD_S_PER_UNIT)
        return (
            f"{who} turns no faster than {allowed:.1f} degrees/s (Velocity Limit), and the rig asks for "
            f"{joint.speed_deg_s:g}",
            "lower speed_deg_s",
        )
    low, high = joint.limits_deg
    ends = sorted(to_ticks(joint, angle) for angle in joint.limits)
    least, most = -table.MOST_TURNS_TICKS, table.MOST_TURNS_TICKS
    if mode == table.SINGLE_TURN:
        least, most = setup[table.MIN_POSITION_LIMIT.name], setup[table.MAX_POSITION_LIMIT.name]
    if not least <= ends[0] <= ends[1] <= most:
        return (
            f"{who} may turn from {least} to {most} steps, and its limits of {low:g} to {high:g} degrees need "
            f"{ends[0]} to {ends[1]}",
            "correct limits_deg or zero_deg, or the servo's position limits",
        )
    here = state[table.PRESENT_POSITION.name]
    if not ends[0] - tolerance_ticks <= here <= ends[1] + tolerance_ticks:
        angle = math.degrees(from_ticks(joint, here))
        return (
            f"{who} stands at {angle:.1f} degrees, outside its limits of {low:g} to {high:g}",
            "switch the servo power off and turn the joint back by hand",
        )
    return None
