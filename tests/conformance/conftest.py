"""Every test here runs on each simulated stage, and with ``-m hardware --rig rig.yaml`` on a real one."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from api.devices import Wires, Workshop, on_its_wires
from api.rig_file import read_rig
from simulators.scene import dish
from stage.rig import Rig
from tests.conformance.rigs import SIMULATED


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "rig" not in metafunc.fixturenames:
        return
    stages = [pytest.param(rig, id=name) for name, rig in SIMULATED.items()]
    if path := metafunc.config.getoption("--rig"):
        stages.append(pytest.param(read_rig(Path(path)), id=str(path), marks=pytest.mark.hardware))
    metafunc.parametrize("rig", stages)


@pytest.fixture
def wires(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> Iterator[Wires]:
    """Where the stage's devices are found; nothing of it may be left behind."""
    monkeypatch.setattr("simulators.world.dish", lambda: dish(nodes=101))
    threads = threading.active_count()
    with on_its_wires(rig) as found:
        yield found
    assert threading.active_count() == threads


@pytest.fixture
def workshop(wires: Wires) -> Workshop:
    """Makes the stage's drivers."""
    return Workshop(wires.rig, wires.clock, wires.usb, wires.world)
