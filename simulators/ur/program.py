"""The control program that ur-rtde uploads, as far as its register protocol goes.

A host writes a command number into an input register, sees "done" in an output register, clears the command and sees
"ready". Commands that move the arm can be asynchronous; a third register then counts operations and tells when they
have ended. What is not a motion, a watchdog or a payload is answered with "done" and has no effect.

References
----------
ur_rtde 1.6.5, rtde_control.script: main loop, process_cmd, write_async_progress_register.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Final

from simulators.ur.arm import JOINTS
from simulators.ur.controller import Controller

COMMAND: Final = "input_int_register_0"
ASYNCHRONOUS: Final = "input_int_register_1"
STATE: Final = "output_int_register_0"
ANSWER: Final = "output_int_register_1"
PROGRESS: Final = "output_int_register_2"
READY, DONE = 1, 2
COUNTS: Final = 128
"""Operations and changes of the progress register are counted modulo this."""
OPERATION_RUNS: Final = 1 << 15


class Command(IntEnum):
    """Numbers in the command register."""

    NONE = 0
    MOVEJ = 1
    SET_PAYLOAD = 17
    STOPL = 33
    STOPJ = 34
    SET_WATCHDOG = 35
    IS_STEADY = 47
    STOP_SCRIPT = 255


class ControlProgram:
    """One run of the program.

    Parameters
    ----------
    controller : Controller
        Whose registers and arm it works with.
    """

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self._executing = False
        self._waiting = False
        self._in_background = False
        self._operations = self._changes = 0
        self._report(running=False)
        controller.outputs[STATE] = READY

    def step(self) -> bool:
        """One cycle; False after the command that stops the program."""
        robot = self._controller
        if self._in_background and not robot.arm.busy:
            self._end_operation()
        if self._waiting:
            if robot.arm.busy:
                return True
            self._waiting = False
            robot.outputs[STATE] = DONE
        command = int(robot.inputs.get(COMMAND, Command.NONE))
        if command == Command.NONE:
            self._executing = False
            robot.outputs[STATE] = READY
        elif not self._executing:
            self._executing = True
            if command != Command.IS_STEADY:
                robot.board.message()
            if not robot.program_running:  # a fault has struck
                return False
            if command == Command.STOP_SCRIPT:
                robot.outputs[STATE] = 0
                return False
            self._process(command)
            if not self._waiting:
                robot.outputs[STATE] = DONE
        return True

    def _process(self, command: int) -> None:
        robot = self._controller
        if command == Command.MOVEJ:
            self._end_operation()
            goal = [self._number(index) for index in range(JOINTS)]
            self._set_out()
            robot.arm.movej(goal, speed=self._number(6), acceleration=self._number(7))
        elif command in (Command.STOPL, Command.STOPJ):
            self._end_operation()
            self._set_out()
            # The script's asynchronous stopj is a stopl: with the lamp about a metre out, m/s2 are about rad/s2.
            robot.arm.brake(self._number(0))
        elif command == Command.SET_WATCHDOG:
            robot.guard(self._number(0))
        elif command == Command.SET_PAYLOAD:
            robot.payload_kg = self._number(0)
        elif command == Command.IS_STEADY:
            robot.outputs[ANSWER] = int(not robot.arm.moving)

    def _set_out(self) -> None:
        """Begin a motion, in the background where the host will not wait."""
        if self._controller.inputs.get(ASYNCHRONOUS):
            self._in_background = True
            self._operations = (self._operations + 1) % COUNTS
            self._report(running=True)
        else:
            self._waiting = True

    def _end_operation(self) -> None:
        if self._in_background:
            self._in_background = False
            self._report(running=False)

    def _report(self, *, running: bool) -> None:
        self._changes = (self._changes + 1) % COUNTS
        word = self._changes << 16 | self._operations << 24 | (OPERATION_RUNS if running else 0)
        self._controller.outputs[PROGRESS] = word

    def _number(self, index: int) -> float:
        return self._controller.inputs.get(f"input_double_register_{index}", 0.0)
