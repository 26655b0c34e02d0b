"""From what HiGHS proves in floating point to whole lights."""

from __future__ import annotations

import numpy as np

_ROUNDING = 1e-5
"""What HiGHS's tolerances may add to an objective; taken off before a bound is rounded up to whole lights."""


def rounded_up(bound: float) -> int:
    """Whole lights that a bound from HiGHS proves; 0 where it proves nothing."""
    return int(np.ceil(bound - _ROUNDING)) if np.isfinite(bound) else 0
