r"""A manufactured solution at any amplitude: the generalised vortex, for the Jaumann rate.

Kamojjala, Brannon, Sadeghirad & Guilkey (2015, Eng. Comput. 31, 193, doi
10.1007/s00366-013-0342-x) let every circle of a body turn by an angle of its own,
:math:`\alpha(r, t) = g(t)\,h(r)`, so that the body is sheared without any change of volume, and
give the body force that this takes. With the Jaumann rate the stress has a closed form: in the
frame that turns with a particle it is that of simple shear by :math:`\gamma = r\,\partial\alpha/
\partial r`,

.. math:: \sigma_{r\theta} = G \sin\gamma, \qquad
          \sigma_{\theta\theta} = -\sigma_{rr} = G (1 - \cos\gamma),

and the body force is :math:`b = a - \nabla\cdot\sigma/\rho` with :math:`a_r = -r\dot\alpha^2`,
:math:`a_\theta = r\ddot\alpha`. Here h(r) vanishes outside a ring, so that neither walls nor a
surface play a part.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

RING, HALF_WIDTH = 0.07, 0.06
"""Radius of the ring's middle, and half its width [m]."""
DURATION = 2e-3
"""Time in which the ring turns and turns back [s]."""
POWER = 4
"""h is (1 - s²) to this power, s from -1 to 1 across the ring: three derivatives are smooth."""


class Fields(NamedTuple):
    """Exact state of particles at a time."""

    position: FloatArray
    """[m], shape [particle, 2]."""
    velocity: FloatArray
    """[m/s], shape [particle, 2]."""
    stress: FloatArray
    """(σ_xx, σ_zz, σ_xz) [Pa], shape [particle, 3]."""
    body_force: FloatArray
    """Acceleration [m/s²], shape [particle, 2]."""


class Vortex:
    """The solution for given particles.

    Parameters
    ----------
    start
        Positions at time 0 [m], shape [particle, 2].
    centre
        Centre of the ring (x, z) [m].
    amplitude
        Largest angle [rad]; the shear strain γ is at most three times as large.
    shear_modulus, density
        G [Pa], ρ [kg/m³].
    """

    def __init__(
        self,
        start: FloatArray,
        centre: tuple[float, float],
        amplitude: float,
        shear_modulus: float,
        density: float,
    ) -> None:
        self.centre = np.array(centre)
        self.radius = np.hypot(*(start - self.centre).T)
        self.angle = np.arctan2(*(start - self.centre).T[::-1])
        self.amplitude, self.shear_modulus, self.density = amplitude, shear_modulus, density
        self._shape = _profile(self.radius)

    @property
    def largest_shear(self) -> float:
        """Largest |γ| at any time [-]."""
        return float(self.amplitude * np.abs(self.radius * self._shape[1]).max())

    @property
    def top_speed(self) -> float:
        """Largest speed at any time [m/s]."""
        return float(self.amplitude * math.pi / DURATION * (self.radius * self._shape[0]).max())

    def at(self, time: float) -> Fields:
        """Exact fields at a time [s]."""
        h, h1, h2 = self._shape
        g, g1, g2 = self._course(time)
        r, shear = self.radius, self.radius * g * h1
        turned, rate = self.angle + g * h, g1 * h
        sine, cosine = np.sin(shear), np.cos(shear)
        # Per ρ: σ_rr = -σ_θθ, so that div σ has (∂/∂r + 2/r) of both σ_rr and σ_rθ.
        stiffness = self.shear_modulus / self.density
        growth = g * (h1 + r * h2)
        inward = -r * rate**2 + stiffness * (sine * growth + 2.0 * (1.0 - cosine) / r)
        around = r * g2 * h - stiffness * (cosine * growth + 2.0 * sine / r)
        e_r = np.stack([np.cos(turned), np.sin(turned)], axis=1)
        e_t = np.stack([-e_r[:, 1], e_r[:, 0]], axis=1)
        s_rr, s_rt = -self.shear_modulus * (1.0 - cosine), self.shear_modulus * sine
        c, s = e_r.T
        s_xx = s_rr * (c * c - s * s) - 2.0 * s_rt * c * s
        s_xz = 2.0 * s_rr * c * s + s_rt * (c * c - s * s)
        return Fields(
            self.centre + r[:, None] * e_r,
            (r * rate)[:, None] * e_t,
            np.stack([s_xx, -s_xx, s_xz], axis=1),
            inward[:, None] * e_r + around[:, None] * e_t,
        )

    def _course(self, time: float) -> tuple[float, float, float]:
        """Course g(t) and its first two derivatives: from 0 to the amplitude and back."""
        pace = 2.0 * math.pi / DURATION
        half = 0.5 * self.amplitude
        return (
            half * (1.0 - math.cos(pace * time)),
            half * pace * math.sin(pace * time),
            half * pace**2 * math.cos(pace * time),
        )


def _profile(radius: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Profile h(r) [-] and its first two derivatives [1/m, 1/m²], shape [particle] each."""
    s = np.clip((radius - RING) / HALF_WIDTH, -1.0, 1.0)
    q = 1.0 - s * s
    first = -2.0 * POWER * s * q ** (POWER - 1) / HALF_WIDTH
    second = 4.0 * POWER * (POWER - 1) * s * s * q ** (POWER - 2) - 2.0 * POWER * q ** (POWER - 1)
    return q**POWER, first, second / HALF_WIDTH**2
