r"""Factor of safety of an infinite slope, and the probability that it is below 1.

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

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from terraphi.experiment.arrays import FloatArray, between_rows
from terraphi.experiment.errors import InputError, nearest, needing
from terraphi.experiment.files import number_with_sd, plain_number
from terraphi.experiment.units import GRAVITY
from terraphi.terrain.field import STEEPEST, tangent

with needing("a map", "rasterio and SciPy", extra="terrain"):
    from scipy.special import ndtr, ndtri

WATER = 1000.0
"""Density of water [kg/m³]."""
FLATTEST = math.radians(0.5)
"""Inclinations below this count as this; their factor of safety is large."""
SAMPLES = 256
"""Points of a Sobol sequence over φ and all priors."""
NODES, WEIGHTS = np.polynomial.hermite_e.hermegauss(9)
NODES, WEIGHTS = NODES.astype(np.float32), (WEIGHTS / WEIGHTS.sum()).astype(np.float32)
"""Of a mean over a standard normal number."""
STEPS = 0.1, 0.05, 0.1, 0.1
"""Between nodes of the mean and standard deviation of z, of cos θ and m [-]: medians within 1 % on
slopes of 6 to 52° by the default priors, within 4 % in light saturated soil and at a standard
deviation of 1."""
PIECE = 8192
"""Cells or nodes whose medians are computed at a time: a sample of each takes 8 MB."""

QUANTITIES = {
    "cohesion_Pa": (0.0, 1e6, "0:1000"),  # of the soil
    "root_cohesion_Pa": (0.0, 1e5, "0:4000"),  # that roots add
    "root_loss": (0.0, 1.0, "0:1"),  # share of the roots' cohesion
    "depth_m": (0.05, 20.0, "0.5:1.5"),  # thickness of the layer, normal to the slope
    "wetness": (0.0, 1.0, "0:1"),  # share of the thickness that is saturated
    "density_kg_m3": (1000.0, 2600.0, "1600:2000"),  # bulk, of the layer
}
"""Quantities that forces on a foot do not determine: bounds, and the default prior, which is a wide
guess."""


def priors_of(given: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Prior of each of :data:`QUANTITIES`.

    Parameters
    ----------
    given
        ``KEY=LOW:HIGH`` (uniform), ``KEY=MEAN+-SD`` (normal, cut off at the key's bounds) or
        ``KEY=VALUE``; the others are uniform over their usual range.

    Returns
    -------
    dict
        Of each quantity: ``kind`` uniform (``low``, ``high``), normal (``mean``, ``sd``) or fixed
        (``value``).

    Raises
    ------
    InputError
        If a key is unknown, or a number cannot be read or is outside the bounds of the quantity.
    """
    priors = {key: _prior(usual) for key, (_, _, usual) in QUANTITIES.items()}
    if not isinstance(given, Sequence) or not all(isinstance(text, str) for text in given):
        raise InputError("prior: give texts as 'wetness=0.3+-0.2'")
    for text in given:
        key, _, value = text.partition("=")
        if key not in QUANTITIES:
            raise InputError(f"prior '{text}': unknown key; {nearest(key, QUANTITIES)}")
        try:
            priors[key] = _prior(value)
        except ValueError:
            expected = "KEY=LOW:HIGH, KEY=MEAN+-SD (SD above 0) or KEY=VALUE"
            raise InputError(f"prior '{text}': expected {expected}") from None
        low, high = QUANTITIES[key][:2]
        ends = [number for name, number in priors[key].items() if name not in ("kind", "sd")]
        if not all(low <= end <= high for end in ends):
            raise InputError(f"prior '{text}': {key} lies between {low:g} and {high:g}")
    return priors


def _prior(value: str) -> dict[str, Any]:
    """A prior as written; raises ValueError."""
    if ":" in value:
        low, high = (plain_number(part) for part in value.split(":"))
        if low < high:
            return {"kind": "uniform", "low": low, "high": high}
    mean, sd = number_with_sd(value)
    if sd is None:
        return {"kind": "fixed", "value": mean}
    if not 0.0 < sd < np.inf:
        raise ValueError(value)
    return {"kind": "normal", "mean": mean, "sd": sd}


def quantiles(key: str, prior: Mapping[str, Any], share: FloatArray) -> FloatArray:
    """Quantiles of the prior of a quantity, shape of ``share``."""
    if prior["kind"] == "fixed":
        return np.full(share.shape, prior["value"])
    if prior["kind"] == "uniform":
        return np.asarray(prior["low"] + share * (prior["high"] - prior["low"]))
    mean, sd = prior["mean"], prior["sd"]
    low, high = (ndtr((end - mean) / sd) for end in QUANTITIES[key][:2])
    return np.asarray(mean + sd * ndtri(low + share * (high - low)))


@dataclass(frozen=True, eq=False)
class Sample:
    """Draws of φ and all other quantities, shape [sample] each.

    Attributes
    ----------
    normal
        Standard normal number for φ.
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
    def of(cls, priors: Mapping[str, Mapping[str, Any]], count: int, seed: int) -> Sample:
        """Draw a scrambled Sobol sequence."""
        from scipy.stats.qmc import Sobol

        sobol = Sobol(len(QUANTITIES) + 1, rng=np.random.default_rng(seed)).random(count)
        sobol = np.clip(sobol, 1e-9, 1.0 - 1e-9)
        drawn = {
            key: quantiles(key, priors[key], sobol[:, i + 1]) for i, key in enumerate(QUANTITIES)
        }
        cohesion = drawn["cohesion_Pa"] + (1.0 - drawn["root_loss"]) * drawn["root_cohesion_Pa"]
        weight = drawn["density_kg_m3"] * GRAVITY * drawn["depth_m"]
        lightness = WATER / drawn["density_kg_m3"]
        return cls(ndtri(sobol[:, 0]), cohesion / weight, drawn["wetness"], lightness)

    def carried(self, wetness: Any = None) -> Any:
        """Share of the weight that grains carry, 1 - m ρ_w/ρ, shape [cell, sample] or [1, sample].

        Parameters
        ----------
        wetness
            m of each cell, shape [cell]; by default that of the sample.
        """
        return 1.0 - (self.wetness[None] if wetness is None else wetness[:, None]) * self.lightness

    def critical(self, theta: Any, wetness: Any = None) -> Any:
        """Value z of tan φ at which F = 1, shape [cell, sample].

        Parameters
        ----------
        theta
            Inclination [rad], shape [cell].
        wetness
            As of :meth:`carried`.
        """
        theta = np.maximum(theta, FLATTEST)[:, None]
        # Neutrally buoyant soil carries nothing: it is unstable at every φ, or at none.
        inverse = 1.0 / np.maximum(STEEPEST * self.carried(wetness), 1e-12)
        share = np.tan(theta) - self.strength / np.cos(theta)
        share *= inverse
        np.clip(share, 1e-7, 1.0 - 1e-7, out=share)
        share /= 1.0 - share
        return np.log(share, out=share)

    def single(self) -> Sample:
        """In single precision, for a quarter of the time."""
        return Sample(*(values.astype(np.float32) for values in vars(self).values()))


def unstable(mean: Any, sd: Any, critical: Any) -> Any:
    """Probability that F < 1, shape [cell]; exact in φ, a mean over the samples of the rest.

    Parameters
    ----------
    mean, sd
        Of z, the logit of tan φ, shape [cell].
    critical
        Of :meth:`Sample.critical`.
    """
    deviate = critical - mean[:, None]
    deviate *= 1.0 / sd[:, None]
    return normal_share(deviate).mean(axis=1)


def normal_share(x: Any) -> Any:
    """Cumulative normal distribution within 2e-5, in the array itself and a fifth of SciPy's time.

    Its logit is odd and nearly a line; by three odd powers with the least largest error.
    """
    np.clip(x, -8.0, 8.0, out=x)
    square = x * x
    power = square * 6.33573e-4
    power -= 0.0736052
    power *= square
    power -= 1.59543
    power *= x
    np.exp(power, out=power)
    power += 1.0
    return np.reciprocal(power, out=power)


def median(mean: Any, sd: Any, theta: Any, wetness: Any, sample: Sample) -> Any:
    """Median of F, shape [cell], linear between nodes that are :data:`STEPS` apart.

    F sin θ = c / (ρ g h) + cos θ (1 - m ρ_w/ρ) tan φ hardly bends between them. Cells that are
    fewer than the nodes over their range have a median each.
    """
    theta = np.maximum(theta, FLATTEST)
    axes = [mean, sd, np.cos(theta), *([] if wetness is None else [wetness])]
    steps = list(zip(axes, STEPS, strict=False))
    counts = [int(np.ptp(values) / step) + 2 for values, step in steps]
    if math.prod(counts) >= mean.size:
        return _medians(sample, *axes) / np.sin(theta)
    lines = [
        v.min() + step * np.arange(count, dtype=v.dtype)
        for (v, step), count in zip(steps, counts, strict=True)
    ]
    nodes = [part.ravel() for part in np.meshgrid(*lines, indexing="ij")]
    places = [(v - line[0]) / step for (v, step), line in zip(steps, lines, strict=True)]
    return between_rows(_medians(sample, *nodes).reshape(counts), *places) / np.sin(theta)


def _medians(sample: Sample, mean: Any, sd: Any, cos: Any, wetness: Any = None) -> Any:
    """Median of F sin θ of each cell or node, shape [cell]."""
    result = np.empty_like(mean)
    for first in range(0, mean.size, PIECE):
        z, deviation, level, *wet = (
            values[first : first + PIECE]
            for values in (mean, sd, cos, *([] if wetness is None else [wetness]))
        )
        factor = tangent(z[:, None] + deviation[:, None] * sample.normal)
        factor *= sample.carried(*wet) * level[:, None]
        factor += sample.strength
        result[first : first + PIECE] = np.median(factor, axis=1)
    return result


def phi_share(mean: Any, sd: Any, theta: Any, wetness: Any, sample: Sample) -> Any:
    """Share of the variance of F that is due to φ alone, shape [cell].

    The first-order index of Sobol (1993), Var E[F | φ] / Var F. With F = A + B T, where T = tan φ
    is independent of A and B, Var F = Var A + E[T²] Var B + E[B]² Var T + 2 E[T] Cov(A, B).
    """
    cos = np.cos(np.maximum(theta, FLATTEST))
    nodes = tangent(mean[:, None] + sd[:, None] * NODES)
    first, second = nodes @ WEIGHTS, (nodes * nodes) @ WEIGHTS
    # B is 1 - m ρ_w/ρ, with m of the sample or of the cell.
    share = sample.lightness * (sample.wetness if wetness is None else 1.0)
    factor = 1.0 if wetness is None else wetness
    strength = sample.strength - sample.strength.mean()
    due = (1.0 - factor * share.mean()) ** 2 * np.maximum(second - first**2, 0.0)
    rest = strength.var() / cos**2 + second * factor**2 * share.var()
    rest -= 2.0 * first * factor * (strength * share).mean() / cos
    return np.clip(due / np.maximum(due + rest, 1e-30), 0.0, 1.0)
