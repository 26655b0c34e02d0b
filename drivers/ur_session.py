"""The far side of the robot arm's driver: ur-rtde in a process of its own, because it can hang and reconnects unasked.

A session looks first (dashboard and RTDE receive, which work in any state of the arm) and takes control afterwards.
Taking control uploads ur-rtde's program and guards it with the controller's watchdog: where this process ends or hangs,
nothing kicks the watchdog any more and the controller stops the program, and the arm with it.

References
----------
Universal Robots, "Real-Time Data Exchange (RTDE) Guide"; "Script Manual e-Series": rtde_set_watchdog.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from drivers.extras import require
from stage.errors import DeviceError

EXTRA: Final = "ur"
DASHBOARD_TIMEOUT_MS: Final = 2000
FRESH_S: Final = 1.0
"""The controller sends every 2 or 8 ms; after so long without news the connection is taken for dead."""
PACKAGE_POLL_S: Final = 0.0005
WATCHDOG_HZ: Final = 2.0
"""Without news for one period, 0.5 s, the controller stops its program."""
KICK_S: Final = 0.1
RELEASE_S: Final = 1.0
"""How long an earlier session's program may take to be stopped by its watchdog."""
RELEASE_POLL_S: Final = 0.02
REMOTE_SINCE: Final = (5, 6)
"""The PolyScope version that knows local and remote control; older ones take programs at any time."""
FIELDS: Final = (
    "timestamp",
    "actual_q",
    "actual_qd",
    "robot_mode",
    "safety_mode",
    "runtime_state",
    "target_speed_fraction",
)
PLAYING: Final = 2
SDK_ERRORS: Final = (RuntimeError, ValueError, IndexError)
"""What the exceptions of ur-rtde become in Python."""


@dataclass(frozen=True)
class ArmState:
    """What the controller says of the arm.

    Attributes
    ----------
    angles, speeds : (6,) float
        Of the joints as measured, radians and radians per second.
    robot_mode, safety_mode : int
        See the RTDE Guide.
    in_control : bool
        Whether our program runs and the watchdog is being kicked.
    move_ended : bool
        Whether the latest motion has come to its end, wherever that is.
    speed_fraction : float
        Speed slider of the pendant, 0 to 1.
    """

    angles: tuple[float, ...]
    speeds: tuple[float, ...]
    robot_mode: int
    safety_mode: int
    in_control: bool
    move_ended: bool
    speed_fraction: float


class UrSession:
    """One connection to a controller.

    Parameters
    ----------
    host : str
        Its address.
    """

    def __init__(self, host: str) -> None:
        self._host = host
        dashboard, receive = require("dashboard_client", EXTRA), require("rtde_receive", EXTRA)
        self._control_class = require("rtde_control", EXTRA).RTDEControlInterface
        try:
            self._dashboard = dashboard.DashboardClient(host)
            self._dashboard.connect(DASHBOARD_TIMEOUT_MS)
            self._receive = receive.RTDEReceiveInterface(host, -1.0, list(FIELDS))
        except SDK_ERRORS as error:
            raise self._failed(
                f"cannot connect: {error}", "check the power of the control box, the network cable, and motion.host"
            ) from error
        self._control: Any = None
        self._turn = threading.Lock()
        self._ended = threading.Event()
        self._guarded = False
        self._progress_before = 0

    def state(self) -> ArmState:
        """The arm as measured after the call began."""
        # Progress comes over a connection of its own: asked first, so that the angles are the newer of the two.
        ended = self._control is not None and self._move_ended()
        self._wait_for_package()
        self._wait_for_package()  # the first may have been under way before
        read = self._receive
        return ArmState(
            angles=tuple(read.getActualQ()),
            speeds=tuple(read.getActualQd()),
            robot_mode=read.getRobotMode(),
            safety_mode=read.getSafetyMode(),
            in_control=self._guarded and read.getRuntimeState() == PLAYING,
            move_ended=ended,
            speed_fraction=read.getTargetSpeedFraction(),
        )

    def take_control(self) -> None:
        """Upload the control program and guard it; refused in local control, or while another program runs."""
        version = tuple(int(part) for part in self._dashboard.polyscopeVersion().split(".")[:2])
        if version >= REMOTE_SINCE and not self._dashboard.isInRemoteControl():
            raise self._failed(
                "it is in local control and takes no commands", "switch it to remote control on the pendant, try again"
            )
        deadline = time.monotonic() + RELEASE_S
        while self._dashboard.running():
            if time.monotonic() > deadline:
                raise self._failed(
                    "another program runs on it, perhaps another session's", "end that one, or stop it on the pendant"
                )
            self._ended.wait(RELEASE_POLL_S)
        try:
            self._control = self._control_class(self._host)
            self._guarded = bool(self._control.setWatchdog(WATCHDOG_HZ))
        except SDK_ERRORS as error:
            raise self._failed(
                f"it does not start the control program: {error}", "look for a message on the pendant, then try again"
            ) from error
        if not self._guarded:
            raise self._failed("it does not arm its watchdog, so it was not moved", "try again")
        threading.Thread(target=self._kick, name="watchdog", daemon=True).start()

    def move(self, angles: Sequence[float], speed: float, acceleration: float) -> None:
        """Set out for joint angles, radians; speed and acceleration are those of the joint with the longest way."""
        with self._turn:
            # The SDK reconnects unasked, starts its program anew and sends the move again. The new program is not
            # guarded, so every move is, before and after it begins.
            if self._guarded and self._control.setWatchdog(WATCHDOG_HZ):
                self._progress_before = self._control.getAsyncOperationProgress()
                begun = self._control.moveJ(list(angles), speed, acceleration, True)
                if begun and self._control.setWatchdog(WATCHDOG_HZ):
                    return
        raise self._failed("it did not take the move", "look for a message on the pendant, then try again")

    def stop(self, deceleration: float) -> None:
        """Begin to brake: our own motion, or without control whatever program runs."""
        with self._turn:
            if self._guarded:
                self._control.stopJ(deceleration, True)
                return
        self._dashboard.stop()

    def release(self) -> None:
        """End the control program, rather than leaving that to the watchdog."""
        self._ended.set()
        with self._turn:
            if self._guarded:
                self._guarded = False
                self._control.stopScript()

    def _kick(self) -> None:
        while not self._ended.wait(KICK_S):
            with self._turn:
                if self._ended.is_set():
                    return
                try:
                    self._guarded = self._control.kickWatchdog()
                except SDK_ERRORS:
                    self._guarded = False
            if not self._guarded:
                return

    def _move_ended(self) -> bool:
        # Two consecutive operations never end with the same negative number.
        progress = self._control.getAsyncOperationProgress()
        return bool(progress < 0 and progress != self._progress_before)

    def _wait_for_package(self) -> None:
        seen, deadline = self._receive.getTimestamp(), time.monotonic() + FRESH_S
        while self._receive.getTimestamp() == seen:
            if time.monotonic() > deadline:
                raise self._failed(
                    f"asked for its state over RTDE, nothing has come for {FRESH_S:g} s",
                    "check the power of the control box and the network cable, then try again",
                )
            time.sleep(PACKAGE_POLL_S)

    def _failed(self, what: str, next_step: str) -> DeviceError:
        return DeviceError(f"robot arm at {self._host}: {what}; {next_step}")
