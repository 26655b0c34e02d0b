"""The record of a capture while it runs: RAW frames, and one line per frame that is safely on the disk.

::

    OUT/capture/plan.json        what was to be taken, exposure times included
    OUT/capture/places.json      where the joints go for its lights, in the order of travel
    OUT/capture/raw/NAME.dng     each written, synced and renamed, and only then recorded
    OUT/capture/shots.jsonl      one line per recorded frame; a torn last line is no record
    OUT/capture/decisions.jsonl  which lights were chosen as the capture went, and why (see `acquisition.decisions`)
    OUT/capture/events.jsonl     what happened: pauses, failures, findings, and who asked for what
    OUT/capture/end.json         how the last run ended

A crash at any byte leaves a record that can be resumed: what it lists is there; what it does not list is taken again.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import shutil
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from acquisition.check import Places
from acquisition.decisions import FILE as DECISIONS
from acquisition.decisions import Decisions
from acquisition.disk import Disk
from acquisition.plan import CapturePlan, Shot, read_plan
from acquisition.quality import FrameStatistics
from acquisition.taken import SessionEvent, TakenShot
from stage.errors import InputError

FOLDER = "capture"
PLACES = TypeAdapter(list[tuple[str, tuple[int, ...], tuple[float, ...]]])


class CaptureRecord:
    """A capture's folder. See `open_record`.

    Attributes
    ----------
    out, folder : Path
        The dataset's folder, and the record's inside it.
    plan : CapturePlan
        What is to be taken.
    taken : dict of int to TakenShot
        What has been, by index in the plan.
    superseded : list of TakenShot
        Frames that were taken again, because of what was found in them. They stay on the disk.
    places : mapping or None
        Joint values by place in the order of travel, once they were found: an interrupted capture goes on in the same
        order, and need not look for it again.
    decisions : Decisions or None
        Where the plan's lights are candidates of which some are chosen as the capture goes; None where all are taken.
    run : int
        Number of the run that goes on, or went on last, counted from 1.
    """

    def __init__(self, out: Path, plan: CapturePlan, disk: Disk | None = None, *, chooses: bool = False) -> None:
        self.out, self.plan = out, plan
        self.folder = out / FOLDER
        self.taken: dict[int, TakenShot] = {}
        self.superseded: list[TakenShot] = []
        self.places: Places | None = None
        self._places_there: Places | None = None
        self.run = 0
        self._disk = disk or Disk()
        self._decided = self.folder / DECISIONS
        self.decisions = Decisions(self._decided, self._disk) if chooses else None
        self._shots = plan.shots()
        self._takes: Counter[int] = Counter()
        self._log, self._events = self.folder / "shots.jsonl", self.folder / "events.jsonl"
        self._log_bytes = self._events_bytes = 0
        self._seen = self._went_on, *_ = self._state()
        self._lock: int | None = None

    @property
    def shots(self) -> tuple[Shot, ...]:
        """All shots of the plan."""
        return self._shots

    @property
    def wanted(self) -> tuple[Shot, ...]:
        """Shots of the plan; where lights are chosen as the capture goes, those that are known to be wanted so far.

        Of the references those that were taken, since it takes more of them only where more lights are taken.
        """
        if self.decisions is None:
            return self._shots
        chosen = set(self.decisions.chosen)
        return tuple(
            shot
            for shot in self._shots
            if shot.index in self.taken
            or shot.kind in ("dark", "flat")
            or (shot.kind == "light" and chosen.issuperset(shot.candidates))
        )

    @property
    def missing(self) -> tuple[Shot, ...]:
        """What is wanted, minus what is recorded."""
        return tuple(shot for shot in self.wanted if shot.index not in self.taken)

    @property
    def possible(self) -> tuple[Shot, ...]:
        """What is missing, and what may yet be chosen."""
        if self.decisions is None or self.decisions.are_over:
            return self.missing
        return tuple(shot for shot in self._shots if shot.index not in self.taken)

    @property
    def spare_references(self) -> tuple[Shot, ...]:
        """Where lights are chosen as the capture goes, the references that may be taken; of a plan, they are `missing`.

        Once it is over, one: where lights were photographed after the last reference.
        """
        if self.decisions is None:
            return ()
        left = tuple(shot for shot in self._shots if shot.kind == "reference" and shot.index not in self.taken)
        if not self.decisions.are_over:
            return left
        kinds = [line.kind for line in self.taken.values() if line.kind in ("light", "reference")]
        return left[:1] if kinds[-1:] == ["light"] else ()

    @property
    def is_complete(self) -> bool:
        """Whether all that is wanted is recorded, and nothing more can be wanted."""
        return (self.decisions is None or self.decisions.are_over) and not self.missing

    @property
    def due(self) -> tuple[Shot, ...]:
        """What is missing, and what an earlier run has kept although something is wrong with it."""
        kept = self.taken.get
        return tuple(
            shot
            for shot in self.wanted
            if (one := kept(shot.index)) is None or (one.is_doubtful and one.run < self.run)
        )

    @property
    def lines(self) -> list[TakenShot]:
        """All that is recorded: the frames that stand, and those that were taken again."""
        return [*self.superseded, *self.taken.values()]

    @property
    def last_begun(self) -> datetime | None:
        """Time of day at which the last run into the folder began; None where no frame tells it."""
        last = max(self.lines, key=lambda line: line.run, default=None)
        if last is None:
            return None
        into_s = min((begin for begin, _ in last.spans.values()), default=0.0)
        return datetime.fromisoformat(last.started) - timedelta(seconds=into_s)

    def next_take(self, shot: Shot) -> int:
        """Number of the take that comes next for a shot, counted from 1."""
        return self._takes[shot.index] + 1

    @property
    def is_ours(self) -> bool:
        """Whether the folder is there and this process captures into it."""
        return self._lock is not None

    def require_size(self, width: int, height: int) -> None:
        """Raise `InputError` where frames are recorded whose pictures are of another size."""
        for line in self.lines:
            if (line.width, line.height) != (width, height):
                raise InputError(
                    f"rig: camera.width, camera.height: expected {line.width} x {line.height} like the frames that are "
                    f"recorded in {self.out}, got {width} x {height}; go on with the rig that took them"
                )

    def begin(self) -> None:
        """Make the folder and write the plan, or cut off what a crash has torn; nothing is written before.

        Raises `InputError` where another process captures into it, or it cannot be written.
        """
        with self.writing():
            (self.folder / "raw").mkdir(parents=True, exist_ok=True)
            self._claim()
            if self._state() != self._seen:
                self._release()
                raise InputError(f"{self.out}: output: another capture has run into it just now; start this one again")
        self.run += 1
        with self.writing():
            if self.decisions is not None:  # before the plan, so that a plan alone says that all is taken
                self.decisions.begin()
            elif not (self.folder / "plan.json").exists():
                self._decided.unlink(missing_ok=True)  # of one that did not get as far as its plan
            if not (self.folder / "plan.json").exists():
                plan = (json.dumps(self.plan.to_json(), indent=1) + "\n").encode()
                self._disk.write_synced(self.folder / "plan.json", plan)
            if self.places is not None and self.places != self._places_there:
                rows = [[*place, joints] for place, joints in self.places.items()]
                self._disk.write_synced(self.folder / "places.json", json.dumps(rows).encode() + b"\n")
            self._disk.append_synced(self._log, b"", self._log_bytes)
            self._sweep()

    def write_frame(self, shot: Shot, data: bytes, suffix: str) -> str:
        """Put a RAW file on the disk; returns its name in the folder. It is not recorded yet.

        Raises `OSError`; trying again is all there is to do.
        """
        take = self.next_take(shot)
        name = f"raw/{shot.name}{'' if take == 1 else f'-take{take}'}{suffix}"
        self._disk.write_synced(self.folder / name, data)
        return name

    def add(self, taken: TakenShot) -> None:
        """Record a frame that `write_frame` has put on the disk; raises `OSError`, and it is not recorded."""
        line = (taken.model_dump_json() + "\n").encode()
        self._disk.append_synced(self._log, line, self._log_bytes)
        self._log_bytes += len(line)
        # the statistics are for a run that takes over: in memory, thousands of frames of them would be in the way
        self._know(taken.model_copy(update={"statistics": None}))

    def note(self, event: SessionEvent) -> None:
        """Write what happened, where the disk can take it: a note is no reason to stop a capture."""
        if not self.is_ours:
            return
        line = (event.model_dump_json() + "\n").encode()
        with suppress(OSError):
            self._disk.append_synced(self._events, line, self._events_bytes)
            self._events_bytes += len(line)

    def frame(self, taken: TakenShot) -> bytes:
        """RAW file of a recorded frame; raises `InputError` where it is not what was recorded."""
        path = self.folder / taken.file
        try:
            data = path.read_bytes()
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror})") from None
        if hashlib.sha256(data).hexdigest() != taken.sha256:
            raise InputError(f"{path}: sha256: is not the file that was recorded; remove it and resume the capture")
        return data

    def end(self, **how: Any) -> None:
        """Write how the run ended, and let others into the folder; where nothing was recorded, leave nothing behind.

        Raises `InputError` where the disk cannot be written.
        """
        try:
            with self.writing():
                if self.taken or self.superseded or self._went_on:
                    self._disk.write_synced(self.folder / "end.json", (json.dumps(how, indent=1) + "\n").encode())
                else:
                    self._remove()
        finally:
            self._release()

    def _sweep(self) -> None:
        """Remove what a crash has left half written."""
        for half in (*self.folder.glob("*.part"), *self.folder.glob("raw/*.part")):
            shutil.rmtree(half) if half.is_dir() else half.unlink()

    def _remove(self) -> None:
        for path in sorted(self.folder.rglob("*"), reverse=True):
            path.rmdir() if path.is_dir() else path.unlink()
        self.folder.rmdir()
        if not any(self.out.iterdir()):
            self.out.rmdir()

    @contextmanager
    def writing(self) -> Iterator[None]:
        """Say in one sentence what the disk refused."""
        try:
            yield
        except OSError as error:
            raise InputError(cannot_be_written(self.out, error)) from error

    def read(self) -> None:
        """Take over what earlier runs have recorded; raises `InputError` where a line is damaged."""
        if self.decisions is not None:
            self.decisions.read(set(self.plan.chosen))
        raw = self.folder / "raw"
        sizes = {f"raw/{file.name}": file.stat().st_size for file in os.scandir(raw)} if raw.is_dir() else {}
        for number, line in enumerate(self._whole_lines(self._log), 1):
            self._log_bytes += len(line)
            try:
                one = TakenShot.model_validate_json(line)
                if one.statistics is not None:
                    FrameStatistics.from_record(one.statistics)
            except ValidationError as error:
                fault = error.errors(include_url=False)[0]["msg"]
                raise InputError(f"{self._log}: line {number}: is damaged ({fault})") from None
            if not (0 <= one.shot < len(self._shots) and _is_of(one, self._shots[one.shot])):
                raise InputError(f"{self._log}: line {number}: shot {one.shot} is not one of this plan's")
            self.run = max(self.run, one.run)
            if sizes.get(one.file) == one.size_bytes:
                self._know(one)
            else:
                self._takes[one.shot] = one.take - 1  # its name is free again
                if one.accepted:
                    self.taken.pop(one.shot, None)
        with suppress(OSError, ValidationError):  # what cannot be used is looked for again
            rows = PLACES.validate_json((self.folder / "places.json").read_bytes())
            self.places = {(part, candidates): joints for part, candidates, joints in rows}
            self._places_there = self.places
        self._events_bytes = sum(map(len, self._whole_lines(self._events)))

    def _know(self, taken: TakenShot) -> None:
        self._takes[taken.shot] = taken.take
        if not taken.accepted:
            self.superseded.append(taken)
            return
        if (before := self.taken.pop(taken.shot, None)) is not None:
            self.superseded.append(before)
        self.taken[taken.shot] = taken

    def _whole_lines(self, path: Path) -> list[bytes]:
        content = path.read_bytes() if path.exists() else b""
        return [line for line in content.splitlines(True) if line.endswith(b"\n")]

    def _state(self) -> tuple[bool, int, int]:
        """What tells whether somebody else has captured into the folder since it was read."""
        frames, decisions = (path.stat().st_size if path.exists() else 0 for path in (self._log, self._decided))
        return (self.folder / "plan.json").exists(), frames, decisions

    def _claim(self) -> None:
        self._lock = os.open(self.folder, os.O_RDONLY)
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self._release()
            raise InputError(f"{self.out}: output: another capture is running into it; wait for its end") from None

    def _release(self) -> None:
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None


def cannot_be_written(out: Path, error: OSError) -> str:
    """One sentence on a disk that refuses."""
    return f"{out}: output: cannot be written ({error.strerror}); the frames taken so far are kept, go on with --resume"


def open_record(
    out: str | Path, plan: CapturePlan, *, resume: bool, disk: Disk | None = None, chooses: bool | None = None
) -> CaptureRecord:
    """Look at a capture's folder, to begin there or to go on; nothing is written yet.

    Parameters
    ----------
    out : str or Path
        Folder of the dataset to be; its parent must exist.
    plan : CapturePlan
        With its exposure times.
    resume : bool
        Whether an interrupted capture of the same plan may be there.
    disk : Disk, optional
        What the record is written through.
    chooses : bool, optional
        Whether the plan's lights are candidates of which some are chosen as the capture goes; as the folder says where
        not given.

    Raises
    ------
    InputError
        Where `out` holds something else, another plan's capture or a damaged record, or cannot be there.
    """
    out = Path(out)
    try:
        return _opened(out, plan, resume=resume, disk=disk, chooses=chooses)
    except OSError as error:
        raise InputError(f"{error.filename or out}: cannot be read ({error.strerror}); choose another output") from None


def _opened(out: Path, plan: CapturePlan, *, resume: bool, disk: Disk | None, chooses: bool | None) -> CaptureRecord:
    folder = out / FOLDER
    if out.exists() and not out.is_dir():
        raise InputError(f"{out}: output: is a file, expected a folder that does not exist yet")
    begun, chose = (folder / "plan.json").exists(), (folder / DECISIONS).exists()
    record = CaptureRecord(out, plan, disk, chooses=begun and chose if chooses is None else chooses)
    if begun:
        if not resume:
            raise InputError(f"{out}: output: holds a capture already; go on with it by --resume, or choose another")
        if chooses is not None and chooses != chose:
            how = "a capture that chooses its lights as it goes" if chose else "a capture of all lights of its plan"
            raise InputError(f"{out}: output: holds {how}; go on with it {'with' if chose else 'without'} --until")
        if read_plan(folder / "plan.json").to_json() != plan.to_json():
            raise InputError(f"{folder / 'plan.json'}: holds another plan's capture; choose another output folder")
        record.read()
        return record
    if (log := folder / "shots.jsonl").exists() and log.stat().st_size:
        raise InputError(
            f"{folder / 'plan.json'}: is gone, and {log} lists frames; put it back, or choose another output"
        )
    if out.is_dir() and any(path.name != FOLDER for path in out.iterdir()):
        raise InputError(f"{out}: output: the folder exists and is not empty; choose another or remove it first")
    if not out.absolute().parent.is_dir():
        raise InputError(f"{out}: output: the folder {out.absolute().parent} does not exist")
    return record


def _is_of(taken: TakenShot, shot: Shot) -> bool:
    return (taken.kind, taken.part, taken.candidates) == (shot.kind, shot.part, shot.candidates)
