"""The per-pixel loops that blend three photographs, compiled; `reference` says the same in plain numpy."""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

Singles = NDArray[np.float32]
Ints = NDArray[np.int32]
Mask = NDArray[np.bool_]


@njit(cache=True, parallel=True)
def blend_pixels(
    images: Singles, facets: Ints, facet: Ints, share: Singles, gain: Singles, strength: Singles, root: bool
) -> Singles:
    """Image of every pixel's own facet, (h, w, 3) float32; 0 where `facet` is -1.

    Parameters
    ----------
    images : (n, h, w, 3) float32
        Photographs per unit intensity.
    facets : (f, 3) int32
    facet, share, gain
        From `locate`.
    strength : (3,) float32
        The wanted light's intensity.
    root : bool
        Mean of square roots, squared, instead of the plain mean.
    """
    h, w = facet.shape
    out = np.empty((h, w, 3), np.float32)
    for y in prange(h):
        out[y] = 0.0
        for x in range(w):
            f = facet[y, x]
            if f < 0:
                continue
            a, b, c = facets[f, 0], facets[f, 1], facets[f, 2]
            s, g = share[y, x], gain[y, x]
            for ch in range(3):
                va, vb, vc = g[0] * images[a, y, x, ch], g[1] * images[b, y, x, ch], g[2] * images[c, y, x, ch]
                out[y, x, ch] = strength[ch] * _mean(va, vb, vc, s[0], s[1], s[2], root)
    return out


@njit(cache=True, parallel=True)
def blend_planes(
    first: Singles,
    second: Singles,
    third: Singles,
    object_mask: Mask,
    share: Singles,
    gain: Singles,
    strength: Singles,
    root: bool,
) -> Singles:
    """As `blend_pixels` where all pixels share one facet, whose three photographs (h, w, 3) are given."""
    h, w = object_mask.shape
    out = np.empty((h, w, 3), np.float32)
    for y in prange(h):
        out[y] = 0.0
        for x in range(w):
            if not object_mask[y, x]:
                continue
            for ch in range(3):
                va, vb, vc = gain[0] * first[y, x, ch], gain[1] * second[y, x, ch], gain[2] * third[y, x, ch]
                out[y, x, ch] = strength[ch] * _mean(va, vb, vc, share[0], share[1], share[2], root)
    return out


@njit(cache=True)
def _mean(va: float, vb: float, vc: float, sa: float, sb: float, sc: float, root: bool) -> float:
    if not root:
        return sa * va + sb * vb + sc * vc
    m = sa * _signed_root(va) + sb * _signed_root(vb) + sc * _signed_root(vc)
    return m * abs(m)


@njit(cache=True)
def _signed_root(value: float) -> float:
    # Dark-subtracted photographs have small negative values, whose root keeps the sign.
    return np.sqrt(value) if value >= 0 else -np.sqrt(-value)  # type: ignore[no-any-return]
