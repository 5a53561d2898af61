"""The posterior density over the parameters, and the coordinates in which it is sampled."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from terraphi.design_surrogate.training import DENSITY
from terraphi.inference.joint.likelihood import JointLikelihood
from terraphi.inference.joint.prior import Marginal

FloatArray = NDArray[np.float64]

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
        found: FloatArray = log_p
        return found
