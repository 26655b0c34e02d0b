"""A Universal Robots controller of the e-Series without its wires: modes, safety, program, registers.

The arm moves in the world's time; the watchdog of the program guards the wire, so it runs in real time.

References
----------
Universal Robots, "Real-Time Data Exchange (RTDE) Guide": robot and safety modes, status bits, registers.
Universal Robots, "Script Manual e-Series": movej, stopj, rtde_set_watchdog.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Sequence
from enum import IntEnum, IntFlag
from typing import Final, Protocol

from simulators.faults import FaultBoard
from simulators.ur.arm import Arm, World

CYCLE_S: Final = 0.002
"""Of the control loop of the e-Series."""
SAFETY_DECELERATION: Final = 20.0
"""How hard the arm brakes when a program ends, radians per second squared of its fastest joint."""
UNLOCK_AFTER_S: Final = 5.0
"""How long a protective stop cannot be released (Dashboard Server manual: unlock protective stop)."""
WORKING: Final = (0.0, -1.5708, 1.5708, -1.5708, -1.5708, 0.0)


class RobotMode(IntEnum):
    """Value of `robot_mode`."""

    POWER_OFF = 3
    POWER_ON = 4
    IDLE = 5
    RUNNING = 7


class SafetyMode(IntEnum):
    """Value of `safety_mode`."""

    NORMAL = 1
    PROTECTIVE_STOP = 3
    ROBOT_EMERGENCY_STOP = 7


class SafetyBits(IntFlag):
    """Bits of `safety_status_bits`."""

    NORMAL = 1 << 0
    PROTECTIVE_STOPPED = 1 << 2
    ROBOT_EMERGENCY_STOPPED = 1 << 6
    EMERGENCY_STOPPED = 1 << 7
    STOPPED_DUE_TO_SAFETY = 1 << 10


class RuntimeState(IntEnum):
    """Value of `runtime_state`."""

    STOPPED = 1
    PLAYING = 2


SAFETY_BITS: Final = {
    SafetyMode.NORMAL: SafetyBits.NORMAL,
    SafetyMode.PROTECTIVE_STOP: SafetyBits.PROTECTIVE_STOPPED | SafetyBits.STOPPED_DUE_TO_SAFETY,
    SafetyMode.ROBOT_EMERGENCY_STOP: SafetyBits.ROBOT_EMERGENCY_STOPPED
    | SafetyBits.EMERGENCY_STOPPED
    | SafetyBits.STOPPED_DUE_TO_SAFETY,
}


class Program(Protocol):
    """What runs on the controller."""

    def step(self) -> bool:
        """One cycle; False where the program has come to its end."""
        ...


class Controller:
    """State of the controller. Safe to use from several threads.

    Parameters
    ----------
    world : World
        Where the arm moves.
    start : (6,) float
        Joint angles to begin with, radians.
    wire_time : callable
        Seconds that the watchdog counts.

    Attributes
    ----------
    arm : Arm
        What it moves.
    board : FaultBoard
        Faults: ``protective-stop``, ``emergency-stop``, ``brown-out`` (the controller restarts and the arm is without
        power), ``silent`` (nothing is sent or heard; option ``for_s``), ``program-lost`` (stopped on the pendant),
        ``stall`` (something holds the arm, and its program waits for it; option ``for_s``), ``not-remote`` (local
        control). A message is a command to the control program, questions not counted.
    inputs, outputs : dict
        Registers by the names of the RTDE Guide.
    payload_kg : float
        What the program says hangs on the flange.
    boots : int
        How often the controller has been started; connections do not outlive a start.
    """

    def __init__(
        self,
        world: World,
        start: Sequence[float] = WORKING,
        *,
        wire_time: Callable[[], float] = time.monotonic,
    ) -> None:
        self.arm = Arm(world, start)
        self.lock = threading.RLock()
        self.board = FaultBoard()
        self.inputs: dict[str, float] = {}
        self.outputs: dict[str, float] = {}
        self.owners: dict[str, object] = {}
        self.payload_kg = 0.0
        self.boots = 1
        self.cycles = 0
        self.remote = True
        self.robot_mode = RobotMode.RUNNING
        self.safety_mode = SafetyMode.NORMAL
        self._world, self._wire_time = world, wire_time
        self._program: Program | None = None
        self._silent_until = -math.inf
        self._stopped_at = 0.0
        self._watchdog_s: float | None = None
        self._heard_at = 0.0
        self.board.offer("protective-stop", self.protective_stop)
        self.board.offer("emergency-stop", self.emergency_stop)
        self.board.offer("brown-out", self.restart)
        self.board.offer("silent", self.fall_silent)
        self.board.offer("program-lost", self.stop_program)
        self.board.offer("stall", self.arm.stall)
        self.board.offer("not-remote", self.go_local)

    @property
    def program_running(self) -> bool:
        """Whether a program runs."""
        return self._program is not None

    @property
    def powered(self) -> bool:
        """Whether the arm has power, braked or not."""
        return self.robot_mode in (RobotMode.POWER_ON, RobotMode.IDLE, RobotMode.RUNNING)

    @property
    def silent(self) -> bool:
        """Whether nothing is sent and nothing is heard."""
        return self._world.now() < self._silent_until

    def cycle(self) -> None:
        """One turn of the control loop: watchdog, program."""
        with self.lock:
            self.cycles += 1
            late = self._watchdog_s is not None and self._wire_time() - self._heard_at > self._watchdog_s
            ended = self._program is not None and not self._program.step()
            if late or ended:
                self.stop_program()

    def run(self, program: Program) -> None:
        """Start a program in place of the one that runs; a controller that is not fit to run one ignores it."""
        with self.lock:
            if self.remote and self.robot_mode is RobotMode.RUNNING and self.safety_mode is SafetyMode.NORMAL:
                self.stop_program()
                self._program = program

    def stop_program(self) -> None:
        """End the program that runs, as the stop button does: the arm brakes, the watchdog is gone."""
        with self.lock:
            self._program, self._watchdog_s = None, None
            self.arm.brake(SAFETY_DECELERATION)

    def guard(self, min_frequency_hz: float) -> None:
        """Stop the program where input registers are not written at least so often (rtde_set_watchdog)."""
        with self.lock:
            self._watchdog_s = 1.0 / min_frequency_hz
            self._heard_at = self._wire_time()

    def hear(self, values: dict[str, float]) -> None:
        """Take over input registers that a host has written."""
        with self.lock:
            self._heard_at = self._wire_time()
            self.inputs |= values

    def protective_stop(self) -> None:
        """Stop as in a collision; stands until it is released."""
        self._stop_for(SafetyMode.PROTECTIVE_STOP)

    def emergency_stop(self) -> None:
        """Stop as on the red button: the arm brakes and loses its power."""
        self._stop_for(SafetyMode.ROBOT_EMERGENCY_STOP)
        self.robot_mode = RobotMode.POWER_OFF

    def release(self) -> bool:
        """Release a protective stop; False while it is too young."""
        with self.lock:
            if self.safety_mode is SafetyMode.PROTECTIVE_STOP:
                if self._world.now() - self._stopped_at < UNLOCK_AFTER_S:
                    return False
                self.safety_mode = SafetyMode.NORMAL
            return True

    def power_on(self) -> None:
        """Give the arm power, its brakes still on."""
        with self.lock:
            self.safety_mode = SafetyMode.NORMAL
            self.robot_mode = RobotMode.IDLE

    def release_brakes(self) -> None:
        """Make the arm ready to move."""
        with self.lock:
            self.robot_mode = RobotMode.RUNNING

    def restart(self) -> None:
        """Lose the supply and start again: nobody is connected, the arm has no power."""
        with self.lock:
            self.boots += 1
            self.stop_program()
            self.robot_mode = RobotMode.POWER_OFF
            self.inputs.clear()
            self.outputs.clear()

    def fall_silent(self, for_s: float = math.inf) -> None:
        """Neither send nor hear, while the arm goes on."""
        self._silent_until = self._world.now() + for_s

    def speak(self) -> None:
        """End the silence."""
        self._silent_until = -math.inf

    def go_local(self) -> None:
        """Switch to local control on the pendant: hosts may look, not touch."""
        self.remote = False

    def _stop_for(self, mode: SafetyMode) -> None:
        with self.lock:
            self.stop_program()
            self.safety_mode = mode
            self._stopped_at = self._world.now()
