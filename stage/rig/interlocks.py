"""Interlocks: what must be so for a capture to go on. While one says no, the session is suspended."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, PositiveFloat, model_validator

from stage.rig.parts import RigPart


class Interlock(RigPart):
    """One interlock.

    Attributes
    ----------
    name : str
        For the person who reads why the session is suspended.
    every_s : float
        How old an answer may be before it is asked for again.
    """

    kind: str
    name: str
    every_s: PositiveFloat


class CommandInterlock(Interlock):
    """A command that looks: exit status 0 lets the session go on, any other suspends it.

    The first line that it prints is the reason. A command that cannot be run or does not end suspends the session too.

    Attributes
    ----------
    run : tuple of str
        The command and its arguments, without a shell. It runs in the folder of the rig's description, and one that
        holds a slash is looked for there.
    timeout_s : float
        After so long it is killed.
    """

    kind: Literal["command"]
    name: str = Field(min_length=1)
    every_s: PositiveFloat = 1.0
    run: tuple[str, ...] = Field(min_length=1)
    timeout_s: float = Field(default=2.0, gt=0, le=60)

    @model_validator(mode="after")
    def _runnable(self) -> Self:
        if not self.run[0] or any("\0" in word for word in self.run):
            raise ValueError(f"run: expected a command and its arguments, got {list(self.run)}")
        return self


class TemperatureInterlock(Interlock):
    """The hottest of all parts that tell their temperature.

    Attributes
    ----------
    limit_c, resume_c : float
        Suspended at and above the first, degrees Celsius, until all parts are at or below the second.
    """

    kind: Literal["temperature"]
    name: str = Field(default="temperature", min_length=1)
    every_s: PositiveFloat = 5.0
    limit_c: float
    resume_c: float

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if not self.resume_c < self.limit_c:
            raise ValueError(f"resume_c: expected less than limit_c, {self.limit_c:g}, got {self.resume_c:g}")
        return self


AnyInterlock = Annotated[CommandInterlock | TemperatureInterlock, Field(discriminator="kind")]
