r"""The posterior density over the parameters, and the coordinates in which it is sampled.

Likelihood of several histories over several parameters.

The window means of trial k with a leg are, for each force,

    d_k = g(x) + b + e_k,      b ~ N(0, V(x) + a^2 p^2 K),      e_k ~ N(0, (s^2 + t^2) I),

V the surrogate's own covariance, with an error that multiplies both forces on a leg alike; a^2 p^2
K a model discrepancy of relative size a, as smooth over the leg angle as the forces themselves (K
the surrogate's covariance over theta, of unit mean variance; p the peak-to-peak of the data); t^2
the scatter of the simulations; s the noise of a window mean. What the surrogate and the model get
wrong they get wrong in every trial with that leg: b is shared, and repeating a trial averages out
e_k alone. Legs err independently.

In the basis of the leg angles that diagonalises K all of these are diagonal, so that with m trials
of mean z and spread S = sum_k (z_k - z)^2 along a direction of the basis

    -2 log p = (z - g)^2 / (v + q/m) + log(m v + q) + (m - 1) log q + S / q,

v the shared variance and q that of a trial: a sum over 2 M numbers, for any number of trials. The
common factor f has a covariance of rank one, f^2 g g^T, which adds (Woodbury; Rasmussen & Williams,
eqs A.9 and A.10), with w = v + q/m,

    -f^2 (g^T w^-1 (z - g))^2 / (1 + f^2 g^T w^-1 g) + log(1 + f^2 g^T w^-1 g).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.inference.prior import Marginal
from terraphi.surrogate.design import DesignSurrogate
from terraphi.surrogate.training import DENSITY

NOISE_RANGE = (1e-4, 0.3)
"""Noise of a window mean that may be inferred, of the largest peak-to-peak [-]; log-uniform."""
AMPLITUDE_RANGE = (1e-3, 1.0)
"""Relative size of a discrepancy; log-uniform."""


@dataclass(frozen=True, eq=False)
class Target:
    """The log posterior over the free parameters, log noise and log discrepancy.

    Attributes
    ----------
    likelihood
        Of all legs.
    priors
        Of every parameter, fixed ones too.
    keys
        Those that are free.
    noise
        Standard deviation of a window mean of the noisier force [N]; ``None`` if it is inferred.
    discrepancy
        Whether the model may be wrong.
    """

    likelihood: JointLikelihood
    priors: Mapping[str, Marginal]
    keys: tuple[str, ...]
    noise: float | None
    discrepancy: bool

    @property
    def hyper(self) -> list[Marginal]:
        """Priors of the logarithms of what else is inferred."""
        found = []
        if self.noise is None:
            low, high = np.log(np.array(NOISE_RANGE) * self.likelihood.largest).tolist()
            found.append(Marginal(low, high))
        if self.discrepancy:
            found.append(Marginal(*np.log(AMPLITUDE_RANGE).tolist()))
        return found

    @property
    def marginals(self) -> list[Marginal]:
        """Priors of all dimensions."""
        return [*(self.priors[k] for k in self.keys), *self.hyper]

    def named(self, values: FloatArray) -> dict[str, FloatArray]:
        """All parameters by key, fixed ones too; values of shape [k, d]."""
        free = {key: values[:, i] for i, key in enumerate(self.keys)}
        fixed = {k: np.full(len(values), p.low) for k, p in self.priors.items() if p.fixed}
        return {**fixed, **free}

    def _log_size(self, values: FloatArray) -> FloatArray:
        """Logarithm of the first leg's forces at the density of the library, shape [k]."""
        surrogate = self.likelihood.legs[0].surrogate
        reference = np.full(len(values), surrogate.reference_density)
        return np.log(surrogate.scale({**self.named(values), DENSITY: reference}))

    def coordinates(self, values: FloatArray) -> FloatArray:
        """Parameters with the logarithm of the forces' size in place of the density.

        Forces are proportional to the density, so that it and all else that makes forces large are
        known together alone: along a narrow, bent ridge. In these coordinates it is straight.
        """
        found = values.copy()
        if DENSITY in self.keys:
            i = self.keys.index(DENSITY)
            found[:, i] = np.log(values[:, i]) + self._log_size(values)
        return found

    def parameters(self, coordinates: FloatArray) -> FloatArray:
        """Inverse of :meth:`coordinates`."""
        found = coordinates.copy()
        if DENSITY in self.keys:
            i = self.keys.index(DENSITY)
            found[:, i] = np.exp(coordinates[:, i] - self._log_size(coordinates))
        return found

    def at(self, coordinates: FloatArray) -> FloatArray:
        """Log posterior density in the coordinates, up to a constant, shape [k, d] -> [k]."""
        values = self.parameters(coordinates)
        log_p = self(values)
        if DENSITY in self.keys:
            # The determinant of the change of variables.
            log_p += np.log(values[:, self.keys.index(DENSITY)])
        return log_p

    def errors(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Noise [N] and relative discrepancy [-], shape [k] each."""
        rest = list(np.exp(values[:, len(self.keys) :]).T)
        noise = rest.pop(0) if self.noise is None else np.full(len(values), self.noise)
        return noise, rest.pop(0) if self.discrepancy else np.zeros(len(values))

    def draw_prior(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Coordinates of draws of the prior, shape [count, d]."""
        return self.coordinates(np.column_stack([m.draw(count, rng) for m in self.marginals]))

    def __call__(self, values: FloatArray) -> FloatArray:
        """Log posterior up to a constant, shape [k, d] -> [k]."""
        log_p = np.sum(
            [m.log_density(v) for m, v in zip(self.marginals, values.T, strict=True)], axis=0
        )
        inside = np.isfinite(log_p)
        if inside.any():
            chosen = values[inside]
            log_p[inside] += self.likelihood(self.named(chosen), *self.errors(chosen))
        return log_p


class LegLikelihood:
    """All trials with one leg.

    Parameters
    ----------
    surrogate
        Of the leg.
    data
        Observation vectors [N], shape [trial, 2 theta].
    noise_ratio
        Noise of Fx and of Fz over that of the noisier [-].
    """

    def __init__(
        self,
        surrogate: DesignSurrogate,
        data: FloatArray,
        noise_ratio: tuple[float, float] = (1.0, 1.0),
    ) -> None:
        self.surrogate = surrogate
        self.noise_ratio = noise_ratio
        self.trials = len(data)
        half = surrogate.theta_deg.size
        self.parts = []
        for process, values in zip(
            surrogate.processes, (data[:, :half], data[:, half:]), strict=True
        ):
            rotated = values @ process.basis
            mean = rotated.mean(axis=0)
            spread = np.square(rotated - mean).sum(axis=0)
            span = float(np.ptp(values.mean(axis=0)))
            shape = np.square(span) * process.roots / process.roots.mean()
            self.parts.append((process, mean, spread, shape))
        self.largest = float(np.ptp(data.mean(axis=0).reshape(2, -1), axis=1).max())

    def __call__(
        self, named: Mapping[str, FloatArray], noise: FloatArray, amplitude: FloatArray
    ) -> FloatArray:
        """Log-likelihood up to a constant, shape [k].

        Parameters
        ----------
        named
            Dotted key to values, shape [k] each.
        noise
            s, standard deviation of a window mean of the noisier force [N], shape [k].
        amplitude
            a [-], shape [k]; zero for a model that is right.
        """
        points, scale, factor2 = self.surrogate.located(named)
        scale = scale[:, None]
        m, total = self.trials, np.zeros(len(points))
        along, norm = np.zeros(len(points)), np.zeros(len(points))
        for (process, mean, spread, shape), ratio in zip(self.parts, self.noise_ratio, strict=True):
            forces, variance = process.rotated(points)
            shared = np.square(scale) * variance + np.square(amplitude)[:, None] * shape
            own = np.square(ratio * noise)[:, None] + np.square(scale) * process.noise_variance
            curve, whole = scale * forces, shared + own / m
            terms = np.square(mean - curve) / whole + np.log(m * shared + own)
            terms = terms + (m - 1) * np.log(own) + spread / own
            total -= 0.5 * terms.sum(axis=1)
            along += np.sum(curve * (mean - curve) / whole, axis=1)
            norm += np.sum(np.square(curve) / whole, axis=1)
        by_factor = factor2 * np.square(along) / (1.0 + factor2 * norm)
        return total + 0.5 * (by_factor - np.log1p(factor2 * norm))

    def information(
        self, named: Mapping[str, float], keys: Sequence[str], steps: Sequence[float], *,
        noise: float, amplitude: float,
    ) -> FloatArray:  # fmt: skip
        """Fisher information of some parameters at a point, of the mean forces alone.

        Parameters
        ----------
        named
            The point: dotted key to value.
        keys
            Parameters wanted.
        steps
            Of the central differences, in the unit of each.
        noise, amplitude
            s [N] and a [-].

        Returns
        -------
        ndarray
            G^T C^-1 G, G the slopes of the forces; shape [key, key].
        """
        at = {key: np.array([value]) for key, value in named.items()}
        scale = float(self.surrogate.scale(at)[0])
        total = np.zeros((len(keys), len(keys)))
        along, norm = np.zeros(len(keys)), 0.0
        both = self.surrogate.slopes(at, keys, steps)
        for (process, _, _, shape), slopes, ratio in zip(
            self.parts, both, self.noise_ratio, strict=True
        ):
            forces, surrogate_variance = process.rotated(self.surrogate.points(at))
            curve, shared = scale * forces[0], scale**2 * surrogate_variance[0]
            own = (ratio * noise) ** 2 + scale**2 * process.noise_variance
            variance = shared + amplitude**2 * shape + own / self.trials
            total += (slopes[0] / variance) @ slopes[0].T
            along += slopes[0] @ (curve / variance)
            norm += float(np.sum(np.square(curve) / variance))
        factor2 = float(self.surrogate.factor_variance(at)[0])
        lost: FloatArray = factor2 * np.outer(along, along) / (1.0 + factor2 * norm)
        return total - lost


@dataclass(frozen=True, eq=False)
class JointLikelihood:
    """All legs; noise and discrepancy have the same relative size for all.

    Attributes
    ----------
    legs
        Likelihood of each leg.
    """

    legs: tuple[LegLikelihood, ...]

    @property
    def largest(self) -> float:
        """Largest peak-to-peak of the data [N]."""
        return max(leg.largest for leg in self.legs)

    def __call__(
        self, named: Mapping[str, FloatArray], noise: FloatArray, amplitude: FloatArray
    ) -> FloatArray:
        """Log-likelihood up to a constant, shape [k]; arguments as of `LegLikelihood`."""
        return np.sum([leg(named, noise, amplitude) for leg in self.legs], axis=0)
