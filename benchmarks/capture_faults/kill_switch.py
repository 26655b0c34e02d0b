"""``kill -9`` at an exact byte: a switch that a process carries under its own writes to one folder."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

Count = Literal["bytes of frames", "bytes of lines", "steps"]
"""What is counted: bytes into RAW files, bytes into the record's logs, or the beginnings and ends of all calls that
write, sync, cut or rename."""


@dataclass
class KillSwitch:
    """Kills this process once so much has been done in a folder.

    Attributes
    ----------
    folder : Path
        Where what is written counts.
    count : Count
        What to count.
    after : int
        How much of it is done; the byte that follows is not written, nor the next step begun.
    """

    folder: Path
    count: Count
    after: int

    def arm(self) -> None:
        """Put it under the calls of this process; there is no way back."""
        write = os.write

        def counted_write(file: int, data: bytes, /) -> int:
            path = Path(f"/proc/self/fd/{file}").readlink()
            if self.folder not in path.parents:
                return write(file, data)
            if self.count == ("bytes of frames" if path.parent.name == "raw" else "bytes of lines"):
                if self.after < len(data):
                    write(file, data[: self.after])
                    _die()
                self.after -= len(data)
            self._step()
            written = write(file, data)
            self._step()
            return written

        setattr(os, "write", counted_write)  # noqa: B010
        for name in ("fsync", "replace", "rename", "ftruncate"):
            setattr(os, name, self._stepping(getattr(os, name)))

    def _stepping(self, call: Callable[..., Any]) -> Callable[..., Any]:
        def step(*given: Any, **named: Any) -> Any:
            self._step()
            result = call(*given, **named)
            self._step()
            return result

        return step

    def _step(self) -> None:
        if self.count == "steps":
            if not self.after:
                _die()
            self.after -= 1


def _die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)
