"""Correlation lengths and nugget of a Gaussian process whose weights share them.

Law `legs` is fitted so, by `legs.py --fit`: by the largest sum of the restricted likelihoods of all
weights, each with a variance of its own.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize

from terraphi.laws.gp import matern
from terraphi.laws.legs import AXES, Legs

FloatArray = np.ndarray

LENGTHS = np.geomspace(0.15, 8.0, 16)
"""Correlation lengths that are tried, in units of the half range of φ [-]."""
NUGGETS = np.geomspace(1e-8, 1e2, 24)
"""Nuggets that are tried, over the variance of the process [-]."""


def hyperparameters(
    t: FloatArray, basis: FloatArray, weights: FloatArray, rough: FloatArray
) -> FloatArray:
    """Correlation length of each coordinate, and the nugget, shape [1, axis + 1].

    From the best one of a grid of lengths that are equal in all directions.

    Parameters
    ----------
    t, basis
        Standardized coordinates of the cases, shape [case, axis], and polynomials of the mean
        there, [case, q].
    weights
        Shape [case, weight].
    rough
        Roughness b of each case, shape [case]: its nugget goes with b².
    """
    # Divided by b, the nugget is the same for all cases.
    f, w, scale = basis / rough[:, None], weights / rough[:, None], np.outer(rough, rough)
    best, start = -np.inf, np.zeros(1 + t.shape[1])
    for length in LENGTHS:
        roots, vectors = np.linalg.eigh(matern(t, t, np.full(t.shape[1], length)) / scale)
        for nugget in NUGGETS / np.median(rough) ** 2:
            spectrum = np.maximum(roots, 0.0) + nugget
            value = restricted_log_likelihood(spectrum, vectors, f, w).sum()
            if value > best:
                best, start = value, np.log([*[length] * t.shape[1], nugget])
    return np.exp(refined(t, f, w, scale, start))[None]


def refined(
    t: FloatArray, basis: FloatArray, w: FloatArray, scale: FloatArray, start: FloatArray
) -> FloatArray:
    """Log lengths and log nugget of the largest restricted likelihood of all columns of w.

    With P = A⁻¹ − A⁻¹F(F'A⁻¹F)⁻¹F'A⁻¹ and σ² = w'Pw / (n − q), the derivative of that of a column
    by a parameter is [(Pw)' ∂A (Pw) / σ² − tr(P ∂A)] / 2.
    """
    free = len(w) - basis.shape[1]
    squared_distance = np.square(t[:, None] - t)

    def loss(p: FloatArray) -> tuple[float, FloatArray]:
        squared = squared_distance / np.exp(2.0 * p[:-1])
        lag = np.sqrt(5.0 * squared.sum(axis=-1))
        decay = np.exp(-lag) / scale
        a = matern(t, t, np.exp(p[:-1])) / scale + np.exp(p[-1]) * np.eye(len(w))
        inverse = np.linalg.inv(a)
        trend = inverse @ basis
        normal = basis.T @ trend
        projected = inverse - trend @ np.linalg.solve(normal, trend.T)
        projected_w = projected @ w
        # Without noise A is nearly singular, and rounding decides its sign.
        sigma2 = np.maximum((w * projected_w).sum(axis=0) / free, 1e-300)
        volume = np.linalg.slogdet(a)[1] + np.linalg.slogdet(normal)[1]
        value = (free * np.log(sigma2) + volume).sum()
        # By the elements of A, and these by the logarithm of each length and of the nugget.
        by_a = w.shape[1] * projected - (projected_w / sigma2) @ projected_w.T
        by_length = np.einsum("ij,ijk->k", by_a * 5.0 / 3.0 * (1.0 + lag) * decay, squared)
        return 0.5 * value, 0.5 * np.append(by_length, np.exp(p[-1]) * np.trace(by_a))

    low = np.full_like(start, np.log(LENGTHS[0]))
    high = np.full_like(start, np.log(20.0 * LENGTHS[-1]))
    low[-1], high[-1] = start[-1] - 10.0, start[-1] + 10.0
    bounds = list(zip(low, high, strict=True))
    return np.asarray(minimize(loss, start, jac=True, method="L-BFGS-B", bounds=bounds).x)


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


def left_out(law: Legs) -> tuple[FloatArray, FloatArray]:
    """Each case of law `legs` by the others, hyperparameters kept: y less the prediction, its SD.

    With it is left out what differs by the size of its cell only. Shape [case, weight] each
    (Rasmussen & Williams 2006, section 5.4.2, for the blocks of a partition).
    """
    process, (_, basis, y, _) = law.process, law.training
    residual, sd = np.zeros((2, *y.shape))
    group = np.unique(np.delete(law.x, AXES.index("cells"), axis=1).round(5),
                      axis=0, return_inverse=True)[1].ravel()  # fmt: skip
    # Q = A⁻¹ − A⁻¹F (F'A⁻¹F)⁻¹ F'A⁻¹ is the precision of the data with the mean's coefficients
    # unknown. A block b that is left out is off its prediction by Q_bb⁻¹ (Q y)_b, and has the
    # covariance σ² Q_bb⁻¹: one inverse serves all blocks.
    trend = process.inverse @ basis
    precision = process.inverse - trend @ process.spread @ trend.T
    weighted = precision @ y
    for block in (np.flatnonzero(group == index) for index in range(group.max() + 1)):
        covariance = np.linalg.inv(precision[np.ix_(block, block)])
        residual[block] = covariance @ weighted[block]
        sd[block] = np.sqrt(np.outer(np.diag(covariance), process.sigma2))
    return residual, sd
