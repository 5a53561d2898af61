"""A Gaussian process with a polynomial mean, for weights that are known at cases.

Law ``legs`` interpolates its curves by it (:mod:`~terraphi.laws.legs`): Rasmussen & Williams 2006,
sections 2.2 and 2.7.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from terraphi.experiment.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class Process:
    """A Gaussian process with a polynomial mean, fitted to one weight or to several that share it.

    With A = K + λ diag(b²), K of unit variance, F the polynomials at the cases with coefficients β,
    ``solved`` is A⁻¹(w − Fβ), ``inverse`` A⁻¹ and ``spread`` (F'A⁻¹F)⁻¹. Weights that share a
    process have the same correlation lengths and λ, and each a variance of its own.
    """

    t: FloatArray
    lengths: FloatArray
    beta: FloatArray
    solved: FloatArray
    inverse: FloatArray
    basis: FloatArray
    spread: FloatArray
    sigma2: FloatArray
    noise: float

    @classmethod
    def of(
        cls, t: FloatArray, basis: FloatArray, weights: FloatArray, lengths: FloatArray,
        noise: float, rough: FloatArray | float = 1.0,
    ) -> Process:  # fmt: skip
        """The process of known lengths [key] and λ, for weights [case, weight]."""
        # Generalized least squares for the mean, β = (F'A⁻¹F)⁻¹ F'A⁻¹ w (eq. 2.42), and the
        # restricted estimate of the variance, σ² = r'A⁻¹r / (n − q). A⁻¹ itself is kept, of at most
        # a thousand cases: the errors of cases that are left out need it.
        nugget = noise * np.square(rough) * np.ones(len(t))
        inverse = np.linalg.inv(matern(t, t, lengths) + np.diag(nugget)).astype(np.float64)
        spread = np.linalg.inv(basis.T @ inverse @ basis).astype(np.float64)
        beta = spread @ basis.T @ inverse @ weights
        residual = weights - basis @ beta
        solved = inverse @ residual
        sigma2 = (residual * solved).sum(axis=0) / max(len(t) - basis.shape[1], 1)
        return cls(t, lengths, beta, solved, inverse, basis, spread, sigma2, noise)

    def mean(self, t: FloatArray, basis: FloatArray) -> FloatArray:
        """Weights at other parameters, shape [k, key] -> [k, weight]."""
        return np.asarray(basis @ self.beta + matern(t, self.t, self.lengths) @ self.solved)

    @property
    def nugget(self) -> FloatArray:
        """Variance between particle seeds, over b², shape [weight]."""
        return self.sigma2 * self.noise

    def variance(self, t: FloatArray, basis: FloatArray) -> FloatArray:
        """Variance of the weights, without the nugget, shape [k, key] -> [k, weight]."""
        # Eq. 2.42: σ² [1 − k'A⁻¹k + R'(F'A⁻¹F)⁻¹R] with R = f − F'A⁻¹k: what the cases leave of
        # the process, and the uncertainty of the mean's coefficients, which grows away from them.
        cross = matern(t, self.t, self.lengths)
        unexplained_trend = basis - cross @ self.inverse @ self.basis
        explained = np.einsum("ki,ki->k", cross @ self.inverse, cross)
        of_mean = np.einsum("ki,ij,kj->k", unexplained_trend, self.spread, unexplained_trend)
        return np.maximum(1.0 - explained + of_mean, 0.0)[:, None] * self.sigma2


def matern(
    first: FloatArray, second: FloatArray, lengths: FloatArray | float, *, order: float = 2.5
) -> FloatArray:
    """Matérn correlation of order 5/2 or 3/2, shape [..., k, n]: smooth, but not infinitely so."""
    # (1 + l + l²/3) exp(−l) with l = √5 r, eq. 4.17; (1 + l) exp(−l) with l = √3 r of order 3/2.
    # |a − b|² = a² + b² − 2 a'b is one matrix product, about a centre for places far from zero;
    # rounding may make it negative where both are equal.
    centre = second.mean(axis=-2, keepdims=True)
    a, b = (first - centre) / lengths, (second - centre) / lengths
    squared = np.square(a).sum(axis=-1)[..., None] + np.square(b).sum(axis=-1)[..., None, :]
    squared = np.maximum(squared - 2.0 * a @ b.swapaxes(-1, -2), 0.0)
    lag = np.sqrt(2.0 * order * squared)
    smooth = {1.5: 0.0, 2.5: 5.0 / 3.0}[order] * squared
    return np.asarray((1.0 + lag + smooth) * np.exp(-lag))
