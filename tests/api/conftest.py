"""Runs the command line in this process, as typer's own tests do."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from api.cli import app
from reconstruct.model import REGISTRY
from tests.reconstruct.toy import TOYS, distant_lights, linear_set


@dataclass(frozen=True)
class Outcome:
    """Exit code and both streams of one command."""

    code: int
    stdout: str
    stderr: str

    @property
    def json(self) -> Any:
        """The one JSON value on stdout."""
        return json.loads(self.stdout)


Run = Callable[..., Outcome]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch) -> Run:
    """Run `lightstage` with the toy models registered beside the real ones."""
    for name, place in TOYS.items():
        monkeypatch.setitem(REGISTRY, name, place)
    monkeypatch.delenv("LIGHTSTAGE_DEBUG", raising=False)

    def call(*arguments: object) -> Outcome:
        result = CliRunner().invoke(app, [str(a) for a in arguments], prog_name="lightstage")
        return Outcome(result.exit_code, result.stdout, result.stderr)

    return call


@pytest.fixture
def refused(run: Run, tmp_path: Path) -> Callable[..., str]:
    """Run a command that must be refused: exit code 2, one sentence on stderr, nothing on stdout, nothing written."""

    def call(*arguments: object) -> str:
        before = set(tmp_path.rglob("*"))
        outcome = run(*arguments)
        assert outcome.code == 2, outcome
        assert outcome.stdout == ""
        assert outcome.stderr.count("\n") == 1, outcome.stderr
        assert outcome.stderr.startswith("lightstage: ")
        assert set(tmp_path.rglob("*")) == before
        return outcome.stderr

    return call


@pytest.fixture
def ramps(tmp_path: Path) -> Path:
    """Folder of a linear set with 8 distant lights."""
    return linear_set(tmp_path / "ramps", distant_lights(8), [1, 1, 1.5, 1, 1, 1, 1, 1.9]).folder


def write_json(path: Path, value: object) -> Path:
    """Write JSON and return its path."""
    path.write_text(json.dumps(value))
    return path


def numbers(values: Sequence[int]) -> str:
    """Image numbers as an option takes them."""
    return ",".join(map(str, values))
