"""A simulated GRBL controller in a world of its own, to talk to without a port."""

from __future__ import annotations

from dataclasses import replace

from simulators.clock import VirtualClock
from simulators.grbl import Grbl
from simulators.grbl_settings import Setup
from tests.bench import PlainWorld

HOMED = Setup(homed=True, positions={"X": -100.0, "Y": -100.0, "Z": -100.0})


class Machine:
    """A controller in a world of its own."""

    def __init__(self, setup: Setup = HOMED, **settings: float) -> None:
        changed = {int(name[1:]): value for name, value in settings.items()}
        setup = replace(setup, settings={**setup.settings, **changed})
        self.clock = VirtualClock()
        self.world = PlainWorld(self.clock)
        self.grbl = Grbl(self.world, setup=setup)

    def say(self, text: str | bytes) -> str:
        return self.grbl.feed(text if isinstance(text, bytes) else text.encode() + b"\n").decode()

    def after(self, seconds: float, data: bytes = b"") -> str:
        self.clock.sleep(seconds)
        return self.grbl.feed(data).decode()

    def status(self) -> dict[str, str]:
        state, *fields = self.grbl.feed(b"?").decode().strip().strip("<>").split("|")
        return {"state": state, **dict(field.split(":") for field in fields)}

    @property
    def true(self) -> tuple[float, ...]:
        return tuple(self.world.drives[f"axis {letter}"](self.clock.now()) for letter in "XYZ")

    @property
    def light(self) -> float:
        return self.world.lights["spindle"]
