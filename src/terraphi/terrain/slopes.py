r"""Factor of safety of an infinite slope, and how often it is below 1.

A layer of soil slides on a plane parallel to the surface (Taylor, 1948; in the form of Pack,
Tarboton & Goodwin, 1998):

.. math:: F = \frac{c}{\rho g h \sin\theta}
    + \left(1 - m \frac{\rho_w}{\rho}\right) \frac{\tan\varphi}{\tan\theta}

with h the thickness of the layer *normal to the slope* (its vertical depth times cos θ), m the
share of it that seepage parallel to the slope saturates, ρ its bulk density, and c the cohesion of
soil and roots together: :math:`c = c_s + (1 - l) c_r` with l the share of the roots' that is lost,
as after a fire.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import ndtr, ndtri

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError, nearest
from terraphi.experiment.scenario import GRAVITY
from terraphi.inference.prior import Marginal, parsed
from terraphi.terrain.field import STEEPEST, tangent

WATER = 1000.0
"""Density of water [kg/m³]."""
FLATTEST = np.radians(0.5)
"""Inclinations below this count as this; their factor of safety is large whatever it is."""
SAMPLES = 256
"""Points of a Sobol sequence over φ and all priors."""


@dataclass(frozen=True)
class Quantity:
    """One of the quantities that nobody has measured with a foot."""

    low: float
    high: float
    usual: tuple[float, float]
    """Bounds of the prior where none is given: wide, and a guess."""
    about: str


QUANTITIES = {
    "cohesion_Pa": Quantity(0.0, 1e6, (0.0, 1000.0), "cohesion of the soil"),
    "root_cohesion_Pa": Quantity(0.0, 1e5, (0.0, 4000.0), "cohesion that roots add"),
    "root_loss": Quantity(0.0, 1.0, (0.0, 1.0), "share of the roots' cohesion that is lost"),
    "depth_m": Quantity(0.05, 20.0, (0.5, 1.5), "thickness of the layer, normal to the slope"),
    "wetness": Quantity(0.0, 1.0, (0.0, 1.0), "share of the thickness that is saturated"),
    "density_kg_m3": Quantity(1000.0, 2600.0, (1600.0, 2000.0), "bulk density of the layer"),
}
Priors = dict[str, Marginal]


def priors_of(given: Sequence[str]) -> Priors:
    """Prior of each of :data:`QUANTITIES`.

    Parameters
    ----------
    given
        ``KEY=LOW:HIGH`` (uniform), ``KEY=MEAN+-SD`` (normal, cut off at the key's bounds) or
        ``KEY=VALUE``; the others are uniform over their usual range.

    Raises
    ------
    InputError
        If a key is none, a number cannot be read or lies beyond what the quantity can be.
    """
    found = {key: Marginal(*one.usual) for key, one in QUANTITIES.items()}
    for text in given:
        key, _, value = text.partition("=")
        if key not in QUANTITIES:
            raise InputError(f"prior '{text}': unknown key; {nearest(key, QUANTITIES)}")
        one = QUANTITIES[key]
        marginal = parsed(text, value, Marginal(one.low, one.high))
        if not one.low <= marginal.low <= marginal.high <= one.high:
            raise InputError(
                f"prior '{text}' reaches from {marginal.low:g} to {marginal.high:g}; {key} lies "
                f"between {one.low:g} and {one.high:g}"
            )
        found[key] = marginal
    return found


def quantiles(marginal: Marginal, share: FloatArray) -> FloatArray:
    """Quantiles of a prior, shape of ``share``."""
    if marginal.normal is None:
        return marginal.low + share * (marginal.high - marginal.low)
    mean, sd = marginal.normal
    low, high = ndtr((marginal.low - mean) / sd), ndtr((marginal.high - mean) / sd)
    inside: FloatArray = mean + sd * ndtri(low + share * (high - low))
    return inside


@dataclass(frozen=True, eq=False)
class Sample:
    """Draws of what is not φ, shape [sample] each, and of φ where that is wanted.

    Attributes
    ----------
    normal
        A standard normal number for φ.
    strength
        c / (ρ g h) [-].
    wetness
        m [-].
    lightness
        ρ_w / ρ [-].
    """

    normal: FloatArray
    strength: FloatArray
    wetness: FloatArray
    lightness: FloatArray

    @classmethod
    def of(cls, priors: Priors, count: int, seed: int) -> Sample:
        """As even as a scrambled Sobol sequence is."""
        from scipy.stats.qmc import Sobol

        even = Sobol(len(QUANTITIES) + 1, rng=np.random.default_rng(seed)).random(count)
        even = np.clip(even, 1e-9, 1.0 - 1e-9)
        one = {key: quantiles(priors[key], even[:, i + 1]) for i, key in enumerate(QUANTITIES)}
        cohesion = one["cohesion_Pa"] + (1.0 - one["root_loss"]) * one["root_cohesion_Pa"]
        weight = one["density_kg_m3"] * GRAVITY * one["depth_m"]
        lightness = WATER / one["density_kg_m3"]
        return cls(ndtri(even[:, 0]), cohesion / weight, one["wetness"], lightness)

    def terms(self, theta: Any, wetness: Any = None) -> tuple[Any, Any]:
        """A and B of F = A + B tan φ, shape [cell, sample].

        Parameters
        ----------
        theta
            Inclination [rad], shape [cell].
        wetness
            m of each cell, shape [cell]; ``None``: that of the sample.
        """
        steep = np.maximum(theta, FLATTEST)[:, None]
        wet = self.wetness if wetness is None else wetness[:, None]
        carried = 1.0 - wet * self.lightness
        return self.strength / np.sin(steep), carried / np.tan(steep)


def unstable(mean: Any, sd: Any, a: Any, b: Any) -> Any:
    """Probability that F < 1, shape [cell]; exact in φ, a mean over the samples of the rest.

    Parameters
    ----------
    mean, sd
        Of z, the logit of tan φ, shape [cell].
    a, b
        Of :meth:`Sample.terms`.
    """
    # Soil that nothing presses on (b = 0) is unstable at every φ, or at none.
    critical = np.clip((1.0 - a) / np.maximum(b * STEEPEST, 1e-12), 1e-12, 1.0 - 1e-12)
    z = np.log(critical / (1.0 - critical))
    return ndtr((z - mean[:, None]) / sd[:, None]).mean(axis=1)


def spread(mean: Any, sd: Any, normal: FloatArray, a: Any, b: Any) -> tuple[Any, Any]:
    """Median of F, and the share of its variance that φ alone accounts for, shape [cell] each.

    The share is the first-order index of Sobol (1993): Var E[F | φ] / Var F = E[B]² Var tan φ /
    Var F, since φ is independent of A and B.
    """
    friction = tangent(mean[:, None] + sd[:, None] * normal)
    factor = a + b * friction
    median = np.median(factor, axis=1)
    alone = b.mean(axis=1) ** 2 * friction.var(axis=1)
    return median, np.clip(alone / np.maximum(factor.var(axis=1), 1e-30), 0.0, 1.0)
