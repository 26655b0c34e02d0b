"""Four pieces like those of 003_063c1864929fbf91.txt (Fig. 7): lengths in centimetres, facing +x, +z up."""

from __future__ import annotations

from collections.abc import Sequence

from simulators.shapes.implicit import Ellipsoid, Grown, Limb, limbs, mirrored

Part = Ellipsoid | Limb


def bird() -> Grown:
    """Doll of a bird: fat body, wings, tail, beak and feet; 24 cm high."""
    return _grown(
        (3.0, [Ellipsoid((0, 0, 9.5), (7.5, 6.6, 7.6), (0, 18, 0)), Ellipsoid((2.6, 0, 18), (4.9, 4.7, 4.6))]),
        (0.5, [Limb((6.6, 0, 17.6), (11.4, 0, 16.4), 1.8, 0.4)]),
        (0.8, mirrored([Ellipsoid((-1.6, 6.4, 10), (6.2, 1.3, 4.0), (-12, -22, 6))])),
        (1.5, [Ellipsoid((-9.2, 0, 5.6), (5.6, 3.2, 1.2), (0, -28, 0))]),
        (0.6, mirrored(limbs(((0.8, 2.8, 4.5), 1.2), ((1.0, 3.0, 1.2), 0.9)))),
        (0.5, mirrored([Ellipsoid((2.4, 3.1, 0.8), (3.0, 1.7, 0.8), (0, 0, 12))])),
        (0.2, mirrored([Ellipsoid((6.0, 2.7, 19.6), (0.8, 0.8, 0.9))])),
        (0.4, limbs(((1.6, 0, 22.2), 0.9), ((-0.6, 0, 24.2), 0.5))),
    )


def figure() -> Grown:
    """Figure of a person on a plate, one arm raised, one held before the body: 29 cm high, shadowing itself."""
    return _grown(
        (1.5, limbs(((0, 0, 12.2), 3.4), ((0, 0, 18.5), 3.5))),
        (0.8, limbs(((0, 0, 20.5), 1.5), ((0.2, 0, 23.0), 1.4))),
        (0.8, [Ellipsoid((0.4, 0, 25.0), (3.1, 2.9, 3.4))]),
        (0.4, [Ellipsoid((-0.6, 0, 26.3), (3.4, 3.4, 3.0)), Ellipsoid((3.5, 0, 24.6), (0.8, 0.5, 0.7))]),
        (1.0, limbs(((0, 3.4, 19.8), 1.5), ((0.8, 7.6, 20.6), 1.2), ((2.0, 9.0, 25.6), 1.0))),
        (1.0, limbs(((0, -3.4, 19.8), 1.5), ((1.0, -7.2, 16.4), 1.2), ((5.6, -4.8, 15.6), 1.0))),
        (0.5, [Ellipsoid((2.2, 9.2, 26.6), (1.3, 0.9, 1.6)), Ellipsoid((6.6, -4.2, 15.6), (1.5, 1.3, 0.9))]),
        (1.2, mirrored(limbs(((0, 1.9, 12), 2.2), ((0.6, 2.4, 7), 1.7), ((0, 2.7, 2.2), 1.3)))),
        (0.5, mirrored([Ellipsoid((1.2, 2.8, 1.6), (2.9, 1.5, 1.2))])),
        (0.4, [Ellipsoid((0.4, 0, 0.5), (6.6, 6.6, 0.9))]),
    )


def cat() -> Grown:
    """Ceramic of a sitting cat with its tail laid round it: 26 cm high."""
    return _grown(
        (2.5, limbs(((-2.4, 0, 6.2), 6.0), ((0.6, 0, 14.5), 4.0))),
        (1.5, mirrored([Ellipsoid((-0.6, 4.4, 4.4), (5.0, 2.7, 4.4), (0, -10, 0))])),
        (1.0, mirrored(limbs(((3.0, 2.0, 10.5), 1.9), ((4.6, 2.2, 1.6), 1.4)))),
        (0.6, mirrored([Ellipsoid((5.6, 2.2, 1.1), (2.1, 1.6, 1.1)), Ellipsoid((3.4, 5.2, 1.0), (2.8, 1.6, 1.0))])),
        (1.5, [Ellipsoid((2.0, 0, 19.2), (4.5, 5.2, 4.3))]),
        (0.7, [*mirrored([Ellipsoid((5.8, 1.0, 17.8), (1.3, 1.3, 1.1))]), Ellipsoid((6.7, 0, 18.6), (0.6, 0.7, 0.5))]),
        (0.7, mirrored(limbs(((1.4, 3.0, 21.8), 2.0), ((1.0, 4.4, 26.0), 0.4)))),
        (0.2, mirrored([Ellipsoid((5.6, 2.1, 20.4), (0.9, 0.9, 1.0))])),
        (0.6, limbs(((-8, 0, 2.2), 1.6), ((-8, 5.4, 1.8), 1.5), ((-3.4, 8.6, 1.6), 1.4), ((2.0, 8.2, 1.5), 1.0))),
    )


def pig() -> Grown:
    """Ceramic of a standing pig: 30 cm long."""
    return _grown(
        (2.5, [Ellipsoid((0, 0, 9.6), (10.6, 7.0, 7.0)), Ellipsoid((9.4, 0, 11.2), (5.2, 5.2, 5.0))]),
        (0.8, limbs(((12.6, 0, 10.4), 2.5), ((15.2, 0, 10.0), 2.3))),
        (0.3, mirrored([Ellipsoid((9.0, 3.9, 15.6), (1.0, 2.0, 2.9), (-24, 16, 0))])),
        (0.2, mirrored([Ellipsoid((13.0, 2.6, 13.4), (0.7, 0.7, 0.8))])),
        (1.2, mirrored([*limbs(((6.0, 3.6, 6), 2.6), ((6.6, 3.9, 1.9), 1.9))])),
        (1.2, mirrored([*limbs(((-6.2, 3.6, 6), 2.8), ((-6.6, 3.9, 1.9), 1.9))])),
        (
            0.4,
            limbs(
                ((-10.0, 0, 11.0), 0.8),
                ((-12.0, 1.2, 12.4), 0.7),
                ((-12.8, -0.6, 13.8), 0.7),
                ((-13.6, 0.6, 12.6), 0.6),
            ),
        ),
    )


def _grown(*parts: tuple[float, Sequence[Part]]) -> Grown:
    """Parts in groups, each with the width over which they blend into the others."""
    return Grown([(solid, blend) for blend, solids in parts for solid in solids])
