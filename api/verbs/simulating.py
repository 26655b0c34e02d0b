"""Verb ``simulate``: the far ends of a rig's wires, in a process of their own."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

import yaml

from acquisition.dataset import staged_file
from api.devices import SIMULATED
from api.rig_file import calibration_files, read_rig
from simulators.clock import RunningClock
from simulators.control import ControlSession
from simulators.fault_script import plan_faults, read_script
from simulators.stage_sim import SimulatedStage
from simulators.tcp import TcpPort
from simulators.world import RigWorld
from stage.errors import InputError
from stage.rig import Replay, Rig

IN_PROCESS = {"ptp-usb": "ptp-ip, gphoto2 or opencv", "udmx": "enttec-dmx-usb-pro", "scpi-usbtmc": "enttec-dmx-usb-pro"}
"""Drivers of USB devices, which can be simulated in the driver's own process only, and what can be used instead."""


@contextmanager
def simulate(
    rig: Path,
    *,
    rig_out: Path | None = None,
    faults: Path | None = None,
    seed: int = 0,
    control_port: int = 0,
) -> Iterator[tuple[dict[str, Any], Callable[[], object]]]:
    """Start the simulators of a rig on real ports, all on one virtual world that lives in real time.

    Parameters
    ----------
    rig : Path
        ``rig.yaml``; its addresses are replaced by those that the simulators answer at.
    rig_out : Path, optional
        Where to write the description with those addresses.
    faults : Path, optional
        Fault script (see `simulators.fault_script`).
    seed : int
        Of the sensor's noise.
    control_port : int
        TCP port of the control socket on 127.0.0.1; 0 takes any free one.

    Yields
    ------
    dict
        ``rig``: the description's file, ``control``: address of the control socket, and the address of each device.
    callable
        Waits until somebody stops the simulation: Ctrl-C, SIGTERM, or the control socket.

    Raises
    ------
    InputError
        For a rig whose devices cannot be reached from another process, a bad script, or a port that is taken.
    """
    description = read_rig(rig)
    _require_reachable(description, rig)
    if rig_out is not None and rig_out.exists() and rig_out.samefile(rig):
        raise InputError(f"{rig_out}: output: is the description that is read; it would be gone after the simulation")
    planned = [] if faults is None else read_script(_lines(faults), str(faults))
    stopped = threading.Event()
    with ExitStack() as stack:
        clock = RunningClock()
        stack.callback(clock.close)
        world = RigWorld(rig=description, seed=seed, clock=clock.now)
        stage = stack.enter_context(SimulatedStage(world, description, clock))
        plan_faults(planned, stage.boards, clock, source=str(faults))
        try:
            control = stack.enter_context(
                TcpPort(lambda: ControlSession(stage, world, clock, stopped.set), port=control_port)
            )
        except OSError:
            raise InputError(f"control-port: {control_port} is taken already; 0 takes any free one") from None
        found = {"control": control.address} | {role: address for role, (_, address) in stage.rig.addresses().items()}
        if rig_out is not None:
            with staged_file(rig_out) as temporary:
                # where the description is written to, the calibrations may not lie beside it
                files = [str(file.resolve()) for file in calibration_files(description, rig)]
                written = stage.rig.to_json() | {"calibrations": files}
                temporary.write_text(yaml.safe_dump(written, sort_keys=False), encoding="utf-8")
            stack.callback(rig_out.unlink, missing_ok=True)  # its addresses end with the simulation
            found = {"rig": str(rig_out)} | found
        stack.enter_context(_on_signals(stopped.set))
        yield found, stopped.wait


@contextmanager
def _on_signals(act: Callable[[], None]) -> Iterator[None]:
    """Have Ctrl-C and SIGTERM do something else than end the process."""

    def heed(signum: int, frame: FrameType | None) -> None:
        act()

    before = {number: signal.signal(number, heed) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _require_reachable(rig: Rig, path: Path) -> None:
    if isinstance(rig.camera.device, Replay):
        raise InputError(
            f"{path}: camera.device.driver: replay needs no other process; "
            f"capture with addresses that begin with {SIMULATED!r}"
        )
    drivers = {"light.driver": rig.light.driver, "camera.device.driver": rig.camera.device.driver}
    for field, driver in drivers.items():
        if driver in IN_PROCESS:
            raise InputError(
                f"{path}: {field}: {driver} is a USB device, which another process cannot reach; "
                f"use {IN_PROCESS[driver]}, or capture with addresses that begin with {SIMULATED!r}"
            )


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text(encoding="utf-8-sig").splitlines()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not text ({error.reason})") from None
