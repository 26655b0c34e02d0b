"""One capture after the other, each interrupted and resumed until it is complete, in virtual time.

Every run of a capture is a process of its own, forked from one that has loaded everything, so that being killed and
hanging are what they are for real: nothing is cleaned up, and a watchdog ends it.
"""

from __future__ import annotations

import faulthandler
import os
import select
import signal
import sys
import threading
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path

import numpy as np

from acquisition.capture import capture
from acquisition.plan import CapturePlan, DomeLights, PlannedLight, Reference
from acquisition.session import Phase, Session
from benchmarks.capture_faults.faulty_disk import FaultyDisk, bring_back, hidden
from benchmarks.capture_faults.mishaps import KINDS, Mishaps
from benchmarks.capture_faults.person import Person
from benchmarks.capture_faults.rehearsal import RADIUS_M, Rehearsal, make_rig
from benchmarks.capture_faults.verify import Line, lines, losses, mistakes, silent_frames
from stage.errors import DeviceError, EndedEarlyError, InputError
from stage.lights import dome

MISHAPS_IN = 4
"""Runs of a capture in which things go wrong; in those after them all is well."""
MOST_RUNS = MISHAPS_IN + 2
HANG_S = 60.0
DENSE_SHARE, DENSE = 1 / 6, 36
FRAMES_PER_RUN = 1_000_000
PATIENCE_S = 30.0
NOON = datetime(2024, 1, 1, 12, tzinfo=UTC)
COMPLETE = b"="
WRONG = b"!"


@dataclass
class Findings:
    """What came of some cases.

    Attributes
    ----------
    strikes : Counter of str
        How often each mishap has happened.
    wrong : list of (str, str)
        Case, and what was wrong in it.
    runs, frames : int
        Runs of captures, and frames that were wanted.
    noticed, unnoticed : int
        Frames that only showed by themselves that they were of another light or of none: taken again, or not.
    """

    strikes: Counter[str] = field(default_factory=Counter)
    wrong: list[tuple[str, str]] = field(default_factory=list)
    runs: int = 0
    frames: int = 0
    noticed: int = 0
    unnoticed: int = 0


def make_plan(rng: np.random.Generator) -> CapturePlan:
    """A small capture: a ring or two of lights, one or two exposures, sometimes repeats and reference frames.

    One in six has so many lights that a picture can be compared with those beside it.
    """
    if rng.random() < DENSE_SHARE:
        candidates = DomeLights(kind="dome", count=DENSE, radius_m=RADIUS_M, elevation_deg=(15, 80))
        return CapturePlan(candidates=candidates, exposures_s=(0.05,), dark_frames=2)
    elevations = rng.choice([0.5, 0.75, 1.0], size=int(rng.integers(1, 3)), replace=False)
    lights = dome(int(rng.integers(4, 7)), sorted(elevations.tolist()), RADIUS_M)
    return CapturePlan(
        candidates=tuple(PlannedLight(position=light.position) for light in lights),
        exposures_s=((0.05,), (0.02, 0.08))[int(rng.integers(2))],
        dark_frames=int(rng.integers(0, 3)),
        repeats=1 + int(rng.random() < 0.2),
        reference=Reference(every=3, candidate=0) if rng.random() < 0.4 else None,
    )


def load_everything(folder: Path) -> None:
    """Capture once in this process, so that what is loaded on the way is there for all that are forked from it."""
    plan = CapturePlan(candidates=DomeLights(kind="dome", count=3, radius_m=RADIUS_M, elevation_deg=(15, 80)))
    stage = Rehearsal(Mishaps((0,), 0.0, print), 0)
    capture(plan, stage.arm, stage.lamp, stage.camera, folder, rig=make_rig(), clock=stage.clock)


def run_case(folder: Path, seed: int, number: int, findings: Findings) -> None:
    """Capture, with mishaps, until it is complete; what was wrong goes into `findings`.

    Parameters
    ----------
    folder : Path
        Where the dataset may be written; it does not exist yet.
    seed, number : int
        Which case.
    """
    name, plan = f"--seed {seed} --case {number}", make_plan(np.random.default_rng((seed, number)))
    before: list[Line] = []
    findings.frames += len(plan.shots())
    for run in range(MOST_RUNS):
        findings.runs += 1
        share = 0.0 if run >= MISHAPS_IN else float(np.random.default_rng((seed, number, run)).uniform(0.3, 1.5))
        complete, wrong = _in_a_process(partial(_one_run, folder, plan, (seed, number, run), share), findings)
        bring_back(folder)
        if hidden(folder).exists():
            wrong.append("another folder was made while the disk was gone")
        wrong += losses(folder, before)
        before = lines(folder)
        if complete:
            wrong += mistakes(folder, plan)
            noticed, unnoticed = silent_frames(folder)
            findings.noticed += noticed
            findings.unnoticed += unnoticed
        elif run == MOST_RUNS - 1:
            wrong.append("did not complete although nothing goes wrong any more")
        findings.wrong += [(f"{name}, run {run + 1}", one) for one in wrong]
        if complete or wrong:
            return


def _one_run(
    out: Path, plan: CapturePlan, seed: tuple[int, int, int], share: float, tell: Callable[[bytes], None]
) -> None:
    """A run of a capture, in a process of its own."""
    mishaps = Mishaps(seed, share, lambda kind: tell(kind.encode()), silent=len(plan.chosen) == DENSE)
    stage = Rehearsal(mishaps, FRAMES_PER_RUN * seed[2])
    sessions: list[Session] = []
    person = Person(len(plan.shots()), stage.clock, mishaps)

    @contextmanager
    def attended(session: Session) -> Iterator[None]:
        sessions.append(session)
        person.attend(session)
        yield

    try:
        capture(
            plan,
            stage.arm,
            stage.lamp,
            stage.camera,
            out,
            rig=make_rig(),
            resume=True,
            patience_s=PATIENCE_S,
            clock=stage.clock,
            now=mishaps.clock_of_day(NOON + timedelta(days=10 * seed[2])),
            attended=attended,
            disk=FaultyDisk(out, stage.clock, mishaps),
        )
        tell(COMPLETE)
    except (DeviceError, InputError, EndedEarlyError, KeyboardInterrupt) as error:
        if not share:
            tell(WRONG + f"failed although nothing went wrong: {type(error).__name__}: {error}".encode())
    for sentence in (*person.finish(), *stage.trouble()):
        tell(WRONG + sentence.encode())
    left = [thread.name for thread in threading.enumerate() if thread is not threading.current_thread()]
    if left:
        tell(WRONG + f"threads were left: {', '.join(left)}".encode())
    for session in sessions:
        if session.outcome is None or session.phase is not Phase.ENDED:
            tell(WRONG + f"ended in phase {session.phase.value} with outcome {session.outcome}".encode())


def _in_a_process(act: Callable[[Callable[[bytes], None]], None], findings: Findings) -> tuple[bool, list[str]]:
    """Run in a forked process; returns whether it said that the capture is complete, and what is wrong."""
    reading, writing = os.pipe()
    pid = os.fork()
    if not pid:
        _child(act, reading, writing)
    os.close(writing)
    told, hung = _listen(reading, time.monotonic() + HANG_S), False
    if told is None:
        os.kill(pid, signal.SIGKILL)
        told, hung = b"", True
    os.waitpid(pid, 0)
    messages = told.split(b"\n")[:-1]
    known = {kind.encode() for kinds in KINDS.values() for kind in kinds}
    findings.strikes.update(message.decode() for message in messages if message in known)
    wrong = [message[1:].decode() for message in messages if message.startswith(WRONG)]
    return COMPLETE in messages, wrong + ([f"hung for {HANG_S:g} s"] if hung else [])


def _child(act: Callable[[Callable[[bytes], None]], None], reading: int, writing: int) -> None:
    os.close(reading)
    faulthandler.dump_traceback_later(0.8 * HANG_S, file=sys.stderr)

    def tell(message: bytes) -> None:
        os.write(writing, message.replace(b"\n", b" ") + b"\n")  # at once: the process may be killed next

    try:
        act(tell)
    except BaseException:
        tell(WRONG + " | ".join(traceback.format_exc().splitlines()).encode())
    finally:
        os._exit(0)


def _listen(reading: int, end: float) -> bytes | None:
    """All that comes until the other end is closed; None where that takes too long."""
    told = b""
    with os.fdopen(reading, "rb", buffering=0) as pipe:
        while select.select([pipe], [], [], max(end - time.monotonic(), 0.0))[0]:
            more = pipe.read(65536)
            if not more:
                return told
            told += more
    return None
