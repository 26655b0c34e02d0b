"""The record of a capture while it runs: RAW frames, and one line per frame that is safely on the disk.

::

    OUT/capture/plan.json        what was to be taken, exposure times included
    OUT/capture/raw/NAME.dng     each written, synced and renamed, and only then recorded
    OUT/capture/shots.jsonl      one line per recorded frame; a torn last line is no record
    OUT/capture/end.json         how the last run ended

A crash at any byte leaves a record that can be resumed: what it lists is there; what it does not list is taken again.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from acquisition.plan import CapturePlan, PlanPart, Shot, read_plan
from stage.errors import InputError
from stage.lights import Light, Triple

FOLDER = "capture"


class TakenShot(PlanPart):
    """One recorded frame.

    Attributes
    ----------
    shot : int
        Index in the plan.
    candidate : int or None
        Index of the light; None for a dark frame.
    exposure_s, exposed_s : float
        Exposure time commanded, and the one that the camera set.
    file, sha256, size_bytes : str, str, int
        The RAW file, relative to the record's folder.
    commanded, measured : tuple of float or None
        Joint values sent, and those read back before the exposure, radians or metres; None for a dark frame.
    position, intensity : (3,) float or None
        The light that they and the lamp's levels make, metres and the rig's units; None for a dark frame.
    started : str
        Time of day at which the shot was begun, UTC.
    move_s, settle_s, light_s, expose_s, download_s, decode_s, write_s : float
        Seconds for moving, coming to rest, setting the lamp, exposure with read-out, download, decoding, and writing.
    attempts : int
        Tries that it took.
    camera : mapping
        What the camera said of the frame.
    """

    shot: int
    candidate: int | None
    exposure_s: float
    exposed_s: float
    file: str
    sha256: str
    size_bytes: int
    commanded: tuple[float, ...] | None
    measured: tuple[float, ...] | None
    position: Triple | None
    intensity: Triple | None
    started: str
    move_s: float
    settle_s: float
    light_s: float
    expose_s: float
    download_s: float
    decode_s: float
    write_s: float
    attempts: int
    camera: dict[str, str]

    def light(self) -> Light:
        """The light of the frame, as measured."""
        return Light(position=self.position, intensity=self.intensity or (0.0, 0.0, 0.0))


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
    """

    def __init__(self, out: Path, plan: CapturePlan, taken: dict[int, TakenShot], whole_bytes: int) -> None:
        self.out, self.plan = out, plan
        self.folder = out / FOLDER
        self.taken = taken
        self._log = self.folder / "shots.jsonl"
        self._whole_bytes = whole_bytes

    @property
    def missing(self) -> tuple[Shot, ...]:
        """The plan minus what is recorded."""
        return tuple(shot for shot in self.plan.shots() if shot.index not in self.taken)

    def begin(self) -> None:
        """Make the folder and write the plan, or cut off what a crash has torn; nothing is written before."""
        with self._writing():
            (self.folder / "raw").mkdir(parents=True, exist_ok=True)
            if not (self.folder / "plan.json").exists():
                _write_synced(self.folder / "plan.json", (json.dumps(self.plan.to_json(), indent=1) + "\n").encode())
            with self._log.open("ab") as log:
                log.truncate(self._whole_bytes)
                os.fsync(log.fileno())

    def write_frame(self, shot: Shot, data: bytes, suffix: str) -> tuple[str, str]:
        """Put a RAW file on the disk; returns its name in the folder, and its SHA-256. It is not recorded yet."""
        name = f"raw/{shot.name}{suffix}"
        with self._writing():
            _write_synced(self.folder / name, data)
        return name, hashlib.sha256(data).hexdigest()

    def add(self, taken: TakenShot) -> None:
        """Record a frame that `write_frame` has put on the disk."""
        line = (taken.model_dump_json() + "\n").encode()
        with self._writing(), self._log.open("ab") as log:
            log.write(line)
            log.flush()
            os.fsync(log.fileno())
        self.taken[taken.shot] = taken

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
        """Write how the run ended."""
        with self._writing():
            _write_synced(self.folder / "end.json", (json.dumps(how, indent=1) + "\n").encode())

    def remove_if_empty(self) -> None:
        """Leave nothing behind where no frame was recorded."""
        if self.taken or not self.folder.is_dir():
            return
        for path in sorted(self.folder.rglob("*"), reverse=True):
            path.rmdir() if path.is_dir() else path.unlink()
        self.folder.rmdir()
        if not any(self.out.iterdir()):
            self.out.rmdir()

    @contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise InputError(
                f"{self.out}: output: cannot be written ({error.strerror}); "
                "the frames taken so far are kept, go on with --resume"
            ) from error


def open_record(out: str | Path, plan: CapturePlan, *, resume: bool) -> CaptureRecord:
    """Look at a capture's folder, to begin there or to go on; nothing is written yet.

    Parameters
    ----------
    out : str or Path
        Folder of the dataset to be; its parent must exist.
    plan : CapturePlan
        With its exposure times.
    resume : bool
        Whether an interrupted capture of the same plan may be there.

    Raises
    ------
    InputError
        Where `out` holds something else, another plan's capture or a damaged record, or cannot be there.
    """
    out = Path(out)
    folder = out / FOLDER
    if out.exists() and not out.is_dir():
        raise InputError(f"{out}: output: is a file, expected a folder that does not exist yet")
    if (folder / "plan.json").exists():
        if not resume:
            raise InputError(f"{out}: output: holds a capture already; go on with it by --resume, or choose another")
        if read_plan(folder / "plan.json").to_json() != plan.to_json():
            raise InputError(f"{folder / 'plan.json'}: holds another plan's capture; choose another output folder")
        return CaptureRecord(out, plan, *_read_shots(folder, plan))
    if out.is_dir() and any(path.name != FOLDER for path in out.iterdir()):
        raise InputError(f"{out}: output: the folder exists and is not empty; choose another or remove it first")
    if not out.absolute().parent.is_dir():
        raise InputError(f"{out}: output: the folder {out.absolute().parent} does not exist")
    return CaptureRecord(out, plan, {}, 0)


def _read_shots(folder: Path, plan: CapturePlan) -> tuple[dict[int, TakenShot], int]:
    """Frames that are recorded and there, and how many bytes of the log are whole lines."""
    path = folder / "shots.jsonl"
    content = path.read_bytes() if path.exists() else b""
    whole = content[: content.rfind(b"\n") + 1]
    shots = plan.shots()
    taken: dict[int, TakenShot] = {}
    for number, line in enumerate(whole.splitlines(), 1):
        try:
            one = TakenShot.model_validate_json(line)
        except ValidationError as error:
            fault = error.errors(include_url=False)[0]["msg"]
            raise InputError(f"{path}: line {number}: is damaged ({fault})") from None
        if not (0 <= one.shot < len(shots) and shots[one.shot].candidate == one.candidate):
            raise InputError(f"{path}: line {number}: shot {one.shot} is not one of this plan's")
        file = folder / one.file
        if file.is_file() and file.stat().st_size == one.size_bytes:
            taken[one.shot] = one
        else:
            taken.pop(one.shot, None)
    return taken, len(whole)


def _write_synced(path: Path, data: bytes) -> None:
    part = path.with_name(path.name + ".part")
    with part.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    part.replace(path)
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)
