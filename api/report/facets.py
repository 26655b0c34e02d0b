"""Colours for triplets of lights, the same in the picture and in the 3-D triangulation (paper 001 Fig. 4, K20)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from api.report.content import ByteImage, IntArray

# Okabe and Ito's colours, which people with colour blindness tell apart, and darker companions of them.
PALETTE = np.array(
    [
        *((0, 114, 178), (230, 159, 0), (0, 158, 115), (213, 94, 0), (86, 180, 233), (204, 121, 167), (240, 228, 66)),
        *((0, 62, 97), (140, 97, 0), (0, 92, 67), (130, 57, 0), (122, 62, 96)),
    ],
    dtype=np.uint8,
)
UNUSED = (120, 120, 120)


@dataclass(frozen=True, eq=False)
class TripletColours:
    """Triplets in use and their colours.

    Attributes
    ----------
    triples : (k, 3) int
        Distinct triplets, each ascending, ordered by the number of their pixels, most first.
    share : (k,) float
        Share of the rendered pixels of each.
    rgb : (k, 3) uint8
        Colour of each; two triplets that share an edge differ.
    picture : (height, width, 3) uint8
        The colour of its triplet at every rendered pixel, 0 elsewhere.
    rendered : (height, width) bool
        Where a triplet is given.
    """

    triples: IntArray
    share: NDArray[np.float64]
    rgb: ByteImage
    picture: ByteImage
    rendered: NDArray[np.bool_]


def colour_triplets(triples: IntArray) -> TripletColours:
    """Give every triplet of an index image (height, width, 3) a colour; -1 marks pixels without one."""
    rendered = np.asarray((triples >= 0).all(axis=-1))
    ascending = np.sort(triples[rendered], axis=-1)
    found, which, count = np.unique(ascending, axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(-count, kind="stable")
    rank = np.empty(len(order), dtype=int)
    rank[order] = np.arange(len(order))
    found, count = found[order], count[order]
    rgb = PALETTE[_colours(found)]
    picture = np.zeros((*rendered.shape, 3), dtype=np.uint8)
    picture[rendered] = rgb[rank[which.ravel()]]
    return TripletColours(found, count / max(1, count.sum()), rgb, picture, rendered)


def _colours(triples: IntArray) -> NDArray[np.intp]:
    """Greedy colouring, most used first: never the colour of an edge neighbour, then rarest near, then rarest of all.

    On a triangulated surface a facet has at most three edge neighbours, so a free colour is always there.
    """
    chosen = np.empty(len(triples), dtype=np.intp)
    colours = len(PALETTE)
    for k, triple in enumerate(triples):
        shared = np.isin(triples[:k], triple).sum(axis=-1)
        adjacent = np.bincount(chosen[:k][shared > 1], minlength=colours)
        touching = np.bincount(chosen[:k][shared > 0], minlength=colours)
        used = np.bincount(chosen[:k], minlength=colours)
        chosen[k] = np.lexsort((used, touching, adjacent))[0]
    return chosen
