"""Transfer functions between a picture's stored values and linear radiance."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stage.errors import InputError

# Both branches of sRGB meet here (IEC 61966-2-1); taking the linear side's image keeps encode the inverse of decode.
_SRGB_STORED_KNEE = 0.04045
_SRGB_LINEAR_KNEE = _SRGB_STORED_KNEE / 12.92


def gamma_of(transfer: str) -> float | None:
    """Exponent of ``gamma:G``, or None for ``linear`` and ``srgb``.

    Raises
    ------
    InputError
        Where the name is none of ``linear``, ``srgb`` and ``gamma:G`` with a finite G > 0.
    """
    if transfer in ("linear", "srgb"):
        return None
    kind, _, number = transfer.partition(":")
    try:
        gamma = float(number)
    except ValueError:
        gamma = math.nan
    if kind != "gamma" or not math.isfinite(gamma) or gamma <= 0:
        raise InputError(f"transfer: expected 'linear', 'srgb' or 'gamma:G' with G > 0, got {transfer!r}")
    return gamma


def decode(transfer: str, stored: ArrayLike) -> NDArray[np.float64]:
    """Stored values (...,) in 0..1 to linear ones in 0..1; for ``linear`` any values, unchanged."""
    gamma = gamma_of(transfer)
    x = np.asarray(stored, dtype=np.float64)
    if transfer == "linear":
        return x
    if gamma is not None:
        return np.power(x, gamma)
    return np.where(x <= _SRGB_STORED_KNEE, x / 12.92, ((np.maximum(x, 0) + 0.055) / 1.055) ** 2.4)


def encode(transfer: str, linear: ArrayLike) -> NDArray[np.float64]:
    """Inverse of `decode`, clipped to 0..1, the range that a stored picture can hold."""
    gamma = gamma_of(transfer)
    x = np.clip(np.asarray(linear, dtype=np.float64), 0, 1)
    if transfer == "linear":
        return x
    if gamma is not None:
        return np.power(x, 1 / gamma)
    return np.where(x <= _SRGB_LINEAR_KNEE, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


def slope(transfer: str, stored: ArrayLike) -> NDArray[np.float64]:
    """Derivative of `decode` by the stored value, for carrying variances through it to first order."""
    gamma = gamma_of(transfer)
    x = np.asarray(stored, dtype=np.float64)
    if transfer == "linear":
        return np.ones_like(x)
    if gamma is not None:
        with np.errstate(divide="ignore"):  # a gamma below 1 is infinitely steep at 0
            return gamma * np.power(x, gamma - 1)
    return np.where(x <= _SRGB_STORED_KNEE, 1 / 12.92, 2.4 / 1.055 * ((np.maximum(x, 0) + 0.055) / 1.055) ** 1.4)
