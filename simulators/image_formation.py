r"""How the virtual object looks: GGX microfacets over Lambert, cast shadows, one diffuse bounce, a pinhole camera.

It shares no code with `reconstruct`, nor with shading, shadow or projection code of `stage`: what is fitted to these
images is never the model that made them.

.. math:: L_c = I_c \Big(\frac{\rho_c}{\pi} + \frac{D\,G\,F}{4\,c_l\,c_v}\Big) \frac{V\,c_l}{r^2}
    + \frac{\rho_c}{\pi} E^{\mathrm{bounce}}_c

References
----------
B. Walter et al., "Microfacet models for refraction through rough surfaces", EGSR 2007 (GGX distribution).
E. Heitz, "Understanding the masking-shadowing function in microfacet-based BRDFs", JCGT 2014 (joint Smith G).
C. Schlick, "An inexpensive BRDF model for physically-based rendering", Eurographics 1994 (F).
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from simulators.bounce import Bounce
from simulators.raycast import LIFT_M, Caster, first_hit
from simulators.scene import Relief
from simulators.view import Pinhole, Visible

Array = NDArray[np.float64]


@njit(cache=True, nogil=True)
def ggx(cos_l: float, cos_v: float, cos_h: float, cos_d: float, f0: float, alpha: float) -> float:
    """Specular reflectance in 1/sr of a GGX surface.

    Parameters
    ----------
    cos_l, cos_v, cos_h : float
        Cosines of light, viewer and half vector with the normal.
    cos_d : float
        Cosine of the half vector with light or viewer.
    f0, alpha : float
        Reflectance at normal incidence, and width of the microfacet distribution, > 0.

    Returns
    -------
    float
        0 where light or viewer is below the horizon.
    """
    if cos_l <= 0 or cos_v <= 0:
        return 0.0
    a2 = alpha * alpha
    d = a2 / (np.pi * (cos_h * cos_h * (a2 - 1) + 1) ** 2)
    lambda_l = 0.5 * (np.sqrt(1 + a2 * (1 / (cos_l * cos_l) - 1)) - 1)
    lambda_v = 0.5 * (np.sqrt(1 + a2 * (1 / (cos_v * cos_v) - 1)) - 1)
    f = f0 + (1 - f0) * (1 - cos_d) ** 5
    f_r: float = d * f / ((1 + lambda_l + lambda_v) * 4 * cos_l * cos_v)
    return f_r


@njit(cache=True, nogil=True)
def shine(
    points: Array,
    normals: Array,
    views: Array,
    f0: Array,
    alpha: Array,
    light: Array,
    half: float,
    top: float,
    heights: Array,
    block_max: Array,
) -> tuple[Array, Array]:
    """Direct light on surface points from a point light of unit intensity, shadows cast.

    Parameters
    ----------
    points, normals, views : (m, 3) float
        Places in metres, unit normals, unit vectors to the viewer.
    f0, alpha : (m,) float
        GGX parameters; ``f0 = 0`` leaves the specular part out.
    light : (3,) float
        Metres.
    half, top, heights, block_max
        `Caster.arguments`.

    Returns
    -------
    irradiance, gloss : (m,) float
        ``V cos / r**2`` in 1/m**2, and the specular radiance.
    """
    irradiance = np.zeros(len(points))
    gloss = np.zeros(len(points))
    origin = np.empty(3)
    for k in range(len(points)):
        p, n, v = points[k], normals[k], views[k]
        to_light = light - p
        r = np.sqrt(to_light @ to_light)
        if r == 0:
            continue
        to_light /= r
        cos_l = to_light @ n
        if cos_l <= 0:
            continue
        for a in range(3):
            origin[a] = p[a] + LIFT_M * n[a]
        if first_hit(origin, to_light, r, half, top, heights, block_max) < r:
            continue
        irradiance[k] = cos_l / (r * r)
        h = to_light + v
        length = np.sqrt(h @ h)
        if f0[k] > 0 and length > 0:
            h /= length
            gloss[k] = ggx(cos_l, v @ n, h @ n, h @ v, f0[k], alpha[k]) * irradiance[k]
    return irradiance, gloss


class ImageFormer:
    """Renders one relief from one camera; all that does not depend on the light is computed once.

    Parameters
    ----------
    relief : Relief
        The object.
    camera : Pinhole
        Its pixels are sampled at their centres.
    """

    def __init__(self, relief: Relief, camera: Pinhole) -> None:
        self.relief, self.camera = relief, camera
        self.caster = Caster.of(relief)
        self.visible = Visible.through(camera, relief, self.caster)
        self.bounce = Bounce(relief, self.caster)
        self._from_nodes = self.bounce.weights(self.visible.points)

    def render_direct(self, position: ArrayLike, intensity: ArrayLike = (1.0, 1.0, 1.0)) -> Array:
        """Like `render`, without the light that the object throws onto itself."""
        return self.visible.image(self._direct(np.asarray(position, dtype=float), np.asarray(intensity, dtype=float)))

    def render(self, position: ArrayLike, intensity: ArrayLike = (1.0, 1.0, 1.0)) -> Array:
        """Noise-free radiance under an isotropic point light.

        Parameters
        ----------
        position : (3,) float
            Metres, world.
        intensity : (3,) float
            Radiant intensity per channel.

        Returns
        -------
        (height, width, 3) float
            Linear radiance; a white Lambertian point shows ``intensity * cos / (pi * r**2)``; 0 off the object.
        """
        at, strength = np.asarray(position, dtype=float), np.asarray(intensity, dtype=float)
        nodes, none = self.bounce, np.zeros(len(self.bounce.points))
        direct, _ = shine(nodes.points, nodes.normals, nodes.normals, none, none, at, *self.caster.arguments)
        bounced = self.visible.albedo / np.pi * (self._from_nodes @ nodes.received(direct, strength))
        return self.visible.image(self._direct(at, strength) + bounced)

    def render_sky(self, radiance: ArrayLike = (1.0, 1.0, 1.0)) -> Array:
        """Radiance (height, width, 3) under a uniform sky, diffuse and without bounce: the room's stray light."""
        open_share = np.asarray(self._from_nodes @ self.bounce.sky)
        return self.visible.image(self.visible.albedo * np.asarray(radiance, dtype=float) * open_share[:, None])

    def _direct(self, position: Array, intensity: Array) -> Array:
        see = self.visible
        irradiance, gloss = shine(
            see.points, see.normals, see.views, see.f0, see.alpha, position, *self.caster.arguments
        )
        lit: Array = intensity * (see.albedo / np.pi * irradiance[:, None] + gloss[:, None])
        return lit
