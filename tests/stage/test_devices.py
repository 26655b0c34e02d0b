from __future__ import annotations

import pytest

from stage.clock import SystemClock
from stage.devices import Device, OpenedByWith, make_all_safe
from stage.errors import DeviceError


class Thing(OpenedByWith):
    name = "thing"

    def __init__(self, *, opens: bool = True, safe: bool = True) -> None:
        self.opens, self.safe, self.log = opens, safe, list[str]()

    def open(self) -> None:
        self.log.append("open")
        if not self.opens:
            raise DeviceError("thing: does not open")

    def close(self) -> None:
        self.log.append("close")

    def make_safe(self) -> None:
        self.log.append("safe")
        if not self.safe:
            raise DeviceError("thing: cannot be reached")


def test_with_opens_makes_safe_and_closes() -> None:
    thing = Thing()
    assert isinstance(thing, Device)
    with thing as same:
        assert same is thing
    assert thing.log == ["open", "safe", "close"]


def test_with_closes_what_does_not_open() -> None:
    thing = Thing(opens=False)
    with pytest.raises(DeviceError, match="does not open"), thing:
        pass
    assert thing.log == ["open", "close"]


def test_with_makes_safe_after_an_interruption() -> None:
    thing = Thing()
    with pytest.raises(KeyboardInterrupt), thing:
        raise KeyboardInterrupt
    assert thing.log == ["open", "safe", "close"]


def test_what_could_not_be_made_safe_is_told_and_hides_no_other_error() -> None:
    with pytest.raises(DeviceError, match="cannot be reached"), Thing(safe=False):
        pass
    with pytest.raises(ValueError, match="of the caller") as caught, Thing(safe=False):
        raise ValueError("of the caller")
    assert "cannot be reached" in caught.value.__notes__[0]


def test_one_failing_device_does_not_keep_the_rest_from_being_made_safe() -> None:
    things = [Thing(safe=False), Thing(), Thing(safe=False)]
    errors = make_all_safe(things)
    assert len(errors) == 2
    assert all(thing.log == ["safe"] for thing in things)


def test_system_clock_goes_forward() -> None:
    clock = SystemClock()
    start = clock.now()
    clock.sleep(-1)
    clock.sleep(0.001)
    assert clock.now() >= start + 0.001
