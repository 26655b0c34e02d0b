"""What every lamp asks of the levels that it is given, and says where it was made safe meanwhile."""

from __future__ import annotations

from collections.abc import Sequence

from stage.errors import DeviceError


def require_levels(name: str, levels: Sequence[float], emitters: int) -> None:
    """Raise `DeviceError` where there is not one level from 0 to 1 per emitter."""
    if len(levels) != emitters:
        raise DeviceError(
            f"{name}: expected {emitters} level{'s' * (emitters != 1)}, got {len(levels)}; nothing was lit"
        )
    if not all(0 <= level <= 1 for level in levels):  # refuses NaN too
        raise DeviceError(f"{name}: levels go from 0 to 1, got {list(levels)}; nothing was lit")


def made_safe(name: str) -> str:
    """What a call says that was cut short by `make_safe`."""
    return f"{name}: it was made safe meanwhile and is dark; set the levels again when light is wanted"
