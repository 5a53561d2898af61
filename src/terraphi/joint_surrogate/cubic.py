"""The cubic in phi about which the forces vary: a proper prior, as large as the library says.

In each direction of the common basis the forces over scatter are growth(phi) times a cubic in
x = (phi - centre) / half-span and a Matern process of variance lambda. The coefficient of x^k has
mean zero and variance

    T_k^2 lambda_max (lambda / lambda_max)^p;

four amplitudes T_k and the power p are found by maximum evidence over all directions together, so
that forces drawn from the prior vary over phi as much as the library's do. A vaguer prior would
count the scatter's part of an estimated slope as slope.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

ORDERS = np.arange(4)
AMPLITUDES = (1e-2, 1e3)
"""Least and largest T_k [-]."""
POWERS = (0.3, 3.0)
"""Least and largest p [-]."""
LEAST = 1e-12
"""Least lambda / lambda_max [-]; round-off leaves no more."""


def powers_of(phi_deg: FloatArray, ends_deg: tuple[float, float]) -> FloatArray:
    """1, x, x^2, x^3 at friction angles [-], shape [...] -> [..., 4]."""
    centre, half = 0.5 * (ends_deg[0] + ends_deg[1]), 0.5 * (ends_deg[1] - ends_deg[0])
    result: FloatArray = ((phi_deg - centre) / half)[..., None] ** ORDERS
    return result


def cubic_variances(amplitudes: tuple[float, ...], power: float, roots: FloatArray) -> FloatArray:
    """Prior variances of the coefficients [-], shape [4, 2 theta].

    Parameters
    ----------
    amplitudes, power
        T_k and p [-].
    roots
        lambda of each direction [-], shape [2 theta].
    """
    top = float(roots.max())
    shape = np.maximum(roots / top, LEAST) ** power
    return np.outer(np.square(amplitudes), top * shape)


def fit_cubic(
    powers: FloatArray, local: FloatArray, roots: FloatArray, curves: FloatArray
) -> tuple[tuple[float, float, float, float], float]:
    """T_k and p of maximum evidence.

    Parameters
    ----------
    powers
        Growth times 1, x, x^2, x^3 at the library's angles [-], shape [case, 4].
    local
        Covariance of the Matern process over them, for lambda = 1 [-], shape [case, case].
    roots
        lambda of each direction [-], shape [2 theta].
    curves
        The library's curves in the basis, over sigma [-], shape [case, 2 theta].
    """
    from scipy.optimize import minimize

    rest = roots[:, None, None] * local + np.eye(len(powers))
    logarithms = np.log(np.maximum(roots / roots.max(), LEAST))

    def objective(p: FloatArray) -> tuple[float, FloatArray]:
        prior = cubic_variances(tuple(np.exp(p[:4])), float(p[4]), roots)
        covariance = (powers * prior.T[:, None, :]) @ powers.T + rest
        inverse = np.linalg.inv(covariance)
        weights = (inverse @ curves.T[:, :, None])[:, :, 0]
        volume = np.linalg.slogdet(covariance)[1].sum()
        value = 0.5 * (np.sum(weights * curves.T) + volume)
        # By the variance of each coefficient (Rasmussen & Williams eq. 5.9).
        squares = np.square(weights @ powers)
        traces = np.sum((inverse @ powers) * powers, axis=1)
        slope = 0.5 * (traces - squares) * prior.T
        return float(value), np.append(2.0 * slope.sum(axis=0), (slope.sum(axis=1) @ logarithms))

    bounds = [np.log(AMPLITUDES)] * 4 + [POWERS]
    start = np.append(np.log([40.0, 20.0, 15.0, 8.0]), 1.0)
    found = minimize(objective, start, jac=True, bounds=bounds, method="L-BFGS-B").x
    a, b, c, d = np.exp(found[:4]).tolist()
    return (a, b, c, d), float(found[4])
