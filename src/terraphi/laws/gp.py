"""A Gaussian process with a polynomial mean, for weights that are known at cases.

Libraries and law ``legs`` interpolate their curves by it (:mod:`~terraphi.laws.emulator`,
:mod:`~terraphi.laws.legs`): Rasmussen & Williams 2006, sections 2.2 and 2.7.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from terraphi.experiment.arrays import FloatArray

LENGTHS = np.geomspace(0.15, 8.0, 16)
"""Correlation lengths that are tried, in units of the half range of φ [-]."""
NUGGETS = np.geomspace(1e-8, 1e2, 24)
"""Nuggets that are tried, over the variance of the process [-]."""


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


def matern(first: FloatArray, second: FloatArray, lengths: FloatArray) -> FloatArray:
    """Matérn correlation of order 5/2, shape [..., k, n]: smooth, but not infinitely so."""
    # (1 + √5 r + 5 r²/3) exp(−√5 r), eq. 4.17. |a − b|² = a² + b² − 2 a'b is one matrix product;
    # rounding may make it negative where both are equal.
    a, b = first / lengths, second / lengths
    squared = np.square(a).sum(axis=-1)[..., None] + np.square(b).sum(axis=-1)[..., None, :]
    squared = np.maximum(squared - 2.0 * a @ b.swapaxes(-1, -2), 0.0)
    lag = np.sqrt(5.0 * squared)
    return (1.0 + lag + 5.0 / 3.0 * squared) * np.exp(-lag)


def fitted(
    t: FloatArray, basis: FloatArray, weights: FloatArray, rough: FloatArray
) -> list[Process]:
    """A process of one parameter for each column of weights, by the restricted likelihood.

    It is looked for on a grid of length and nugget. The nugget of a case goes with the square of
    its roughness b; dividing everything by b makes it the same for all.
    """
    f, w, scale = basis / rough[:, None], weights / rough[:, None], np.outer(rough, rough)
    # A/bb' = K/bb' + λ 1 has the eigenvectors of K/bb' for all λ, so that one decomposition serves
    # all nuggets. The grid takes the place of a search: the likelihood may have several maxima.
    best, chosen = np.full(w.shape[1], -np.inf), np.zeros((w.shape[1], 2))
    for length in LENGTHS:
        roots, vectors = np.linalg.eigh(matern(t, t, np.array([length])) / scale)
        for noise in NUGGETS / np.median(rough) ** 2:
            value = restricted_log_likelihood(np.maximum(roots, 0.0) + noise, vectors, f, w)
            better = value > best
            best[better], chosen[better] = value[better], (length, noise)
    return [
        Process.of(t, basis, weights[:, [k]], chosen[k, :1], float(chosen[k, 1]), rough)
        for k in range(len(chosen))
    ]


def restricted_log_likelihood(
    roots: FloatArray, vectors: FloatArray, basis: FloatArray, weights: FloatArray
) -> FloatArray:
    """Restricted log-likelihood of each column, with its variance profiled out, [column]."""
    # −½ [(n − q) ln σ² + ln |A| + ln |F'A⁻¹F|] with A = V diag(roots) V', all in the basis V.
    f, w = vectors.T @ basis, vectors.T @ weights
    normal = f.T @ (f / roots[:, None])
    beta = np.linalg.solve(normal, f.T @ (w / roots[:, None]))
    free = len(w) - f.shape[1]
    sigma2 = (np.square(w - f @ beta) / roots[:, None]).sum(axis=0) / free
    volume = np.log(roots).sum() + np.linalg.slogdet(normal)[1]
    return -0.5 * (free * np.log(sigma2 + 1e-300) + volume)
