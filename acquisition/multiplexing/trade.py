r"""What patterns do to noise: what is gained on read noise, what is lost on photon noise, and where they balance.

Let one light alone give s electrons, on average over the lights, in a photosite of read variance r, with b electrons of
stray light and dark current, and let patterns be exposed for the share :math:`\tau` of the same time. Then the mean
variance of a light's picture, in electrons of the single exposure, is

.. math:: \sigma^2_{\mathrm{single}} = r + b + s, \qquad
    \sigma^2_{\mathrm{patterns}} = \frac{\rho (r + \tau b)}{\tau^2} + \frac{\phi s}{\tau},

with :math:`\rho = 4n / (n + 1)^2` and :math:`\phi = 2n / (n + 1)` for a whole S-matrix of order n. So the
signal-to-noise ratio gains :math:`(n + 1) / (2 \sqrt n)` where reading rules and :math:`\sqrt{(n + 1) / 2n}`, or 0.71,
where photons do, and at equal exposures nothing where s is (n - 1) / (n + 1) times r.

All lights of a pixel come out with the same variance: what is dark under one light gets the noise of the bright ones.

References
----------
M. Harwit and N. J. A. Sloane, "Hadamard Transform Optics", Academic Press 1979, chapters 3 and 5.
N. Ratner and Y. Y. Schechner, "Illumination multiplexing within fundamental limits", CVPR 2007 (photon noise and
saturation).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from acquisition.multiplexing.matrices import decoder, patterns, weights_of

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Trade:
    """What the patterns of a number of lights do to noise.

    Attributes
    ----------
    lights, pictures : int
        Lights, and the patterns that tell them apart.
    read_factor, photon_factor : float
        By what the variance of reading and that of a light's own photons are multiplied (rho and phi above).
    most_lit : int
        Lights of the brightest pattern.
    """

    lights: int
    pictures: int
    read_factor: float
    photon_factor: float
    most_lit: int

    @classmethod
    @lru_cache
    def of(cls, lights: int) -> Self:
        """Of the patterns that `acquisition.multiplexing.matrices.patterns` gives for so many lights."""
        weights = weights_of(patterns(lights), lights)
        squares = (decoder(weights) ** 2).mean(0)
        lit = weights.sum(1)
        return cls(lights, len(weights), float(squares.sum()), float(squares @ lit), int(lit.max()))

    def single_variance(self, electrons: ArrayLike, read_variance: ArrayLike, stray: ArrayLike = 0.0) -> Array:
        """Variance of single-light pictures, electrons squared; parameters as in `pattern_variance`."""
        return np.asarray(sum(np.asarray(part, dtype=float) for part in (electrons, read_variance, stray)))

    def pattern_variance(
        self, electrons: ArrayLike, read_variance: ArrayLike, stray: ArrayLike = 0.0, *, share: float = 1.0
    ) -> Array:
        """Variance of the pictures that patterns are decoded to, on average over the lights.

        Parameters
        ----------
        electrons : (...,) float
            Mean signal of one light in one exposure of a single light, >= 0.
        read_variance : (...,) float
            Of a photosite, electrons squared, rounding included.
        stray : (...,) float
            Electrons of the room and of the dark current in that exposure.
        share : float
            Exposure time of a pattern over that of a single light, > 0.

        Returns
        -------
        (...,) float
            Electrons squared, in the scale of the single exposure.
        """
        read = self.read_factor * (np.asarray(read_variance, dtype=float) + share * np.asarray(stray)) / share**2
        return np.asarray(read + self.photon_factor * np.asarray(electrons, dtype=float) / share)

    def gain(
        self, electrons: ArrayLike, read_variance: ArrayLike, stray: ArrayLike = 0.0, *, share: float = 1.0
    ) -> Array:
        """By what patterns improve the signal-to-noise ratio; below 1 they spoil it. As in `pattern_variance`."""
        single = self.single_variance(electrons, read_variance, stray)
        return np.asarray(np.sqrt(single / self.pattern_variance(electrons, read_variance, stray, share=share)))

    def break_even(self, read_variance: ArrayLike, stray: ArrayLike = 0.0, *, share: float = 1.0) -> Array:
        """Mean signal of one light, electrons, below which patterns improve it.

        0 where they never do, and infinite where they always do, as they may that are many more than the lights (at the
        price of time). Parameters as in `pattern_variance`.
        """
        saved = np.asarray(read_variance, dtype=float) * (1 - self.read_factor / share**2)
        saved = saved + np.asarray(stray) * (1 - self.read_factor / share)
        lost = self.photon_factor / share - 1
        return np.asarray(np.maximum(saved, 0) / lost if lost > 0 else np.full(np.shape(saved), np.inf))

    def equal_share(self, electrons: ArrayLike, read_variance: ArrayLike, stray: ArrayLike = 0.0) -> Array:
        """Exposure time of a pattern, over that of a single light, with which both are equally noisy; > 0.

        Parameters as in `pattern_variance`.
        """
        read, room = np.asarray(read_variance, dtype=float), np.asarray(stray, dtype=float)
        linear = self.read_factor * room + self.photon_factor * np.asarray(electrons, dtype=float)
        # the positive root of read_factor * read / share**2 + linear / share = single_variance
        sought = self.single_variance(electrons, read, room)
        return np.asarray((linear + np.sqrt(linear**2 + 4 * self.read_factor * read * sought)) / (2 * sought))
