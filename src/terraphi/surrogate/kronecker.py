"""Gaussian processes whose covariance is a Kronecker product: the algebra of every surrogate.

Each of n points, friction angles or points of several parameters, brings M numbers, forces at leg
angles: values Y of shape [n, M]. With its rows one after the other, Y has the covariance

    K = s A (x) B + t I,        A = U diag(a) U^T,    B = V diag(b) V^T,

(x) the Kronecker product, s and t the variances of signal and noise. Then K is diagonal in the
basis U (x) V, with the eigenvalues e_ij = s a_i b_j + t. With Z = U^T Y V and W = Z / e, each
element by its own,

    log p(Y) = -(sum Z W + sum log e + n M log 2 pi) / 2,
    2 d log p = y^T K^-1 dK K^-1 y - tr(K^-1 dK),

and at a point of covariances k with the n points, and k_0 with itself, the forces in the basis V
have the mean s k U W diag(b) and in direction j the variance s k_0 b_j - sum_i (s b_j (k U)_i)^2 /
e_ij (Rasmussen & Williams, *Gaussian Processes for Machine Learning*, 2006, eqs 2.25, 2.26, 2.30
and 5.9; Saatçi, *Scalable Inference for Structured Gaussian Process Models*, 2011, ch. 5). That
takes O(n^3 + m^3) where a dense solver needs O(n^3 m^3), and no matrix is larger than n x n, n x M
or M x M. It is `Kronecker`, and a `Posterior` predicts.

A sum of several terms, K = sum_k A_k (x) V diag(b_k) V^T + I, has no common U unless the A_k
commute, or their b_k are proportional so that it is one term. Diagonal in V alone, it falls apart
into one process over the points for each direction j, of covariance sum_k b_kj A_k + I. Those are
`Blocks`, of M matrices n x n.

Kernels, and the derivatives of A and B by hyperparameters, are those of each surrogate; `maximise`
finds the hyperparameters of most evidence.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from threadpoolctl import ThreadpoolController

from terraphi.experiment.arrays import FloatArray

Side = Literal["left", "right"]


class Factor(NamedTuple):
    """A factor of the covariance, basis diag(roots) basis^T."""

    roots: FloatArray
    basis: FloatArray


class Kronecker:
    """Values of covariance signal * left (x) right + noise * I.

    Parameters
    ----------
    left, right
        A and B [-], shapes [n, n] and [M, M].
    values
        Y [-], of mean zero, shape [n, M].
    noise, signal
        t and s [-].

    Attributes
    ----------
    left, right
        The factors in their eigenbases U and V.
    eigenvalues, weights
        e and W, shape [n, M].
    """

    def __init__(
        self,
        left: FloatArray,
        right: FloatArray,
        values: FloatArray,
        *,
        noise: float,
        signal: float = 1.0,
    ) -> None:
        # Round-off puts roots near -1e-16 where the exact matrix has tiny positive ones.
        self.left, self.right = (
            Factor(roots.clip(min=0.0), basis)
            for roots, basis in map(np.linalg.eigh, (left, right))
        )
        self.signal, self.noise = signal, noise
        self._signals = signal * np.outer(self.left.roots, self.right.roots)
        self.eigenvalues = self._signals + noise
        self._projected = self.left.basis.T @ values @ self.right.basis
        self.weights = self._projected / self.eigenvalues

    def log_evidence(self) -> float:
        """Log p(Y) [-]."""
        quadratic = np.sum(self._projected * self.weights)
        log_determinant = np.sum(np.log(self.eigenvalues))
        return float(-0.5 * (quadratic + log_determinant + self.weights.size * np.log(2 * np.pi)))

    @cached_property
    def _inverse(self) -> FloatArray:
        return 1.0 / self.eigenvalues

    @cached_property
    def _sensitivity(self) -> FloatArray:
        """Twice the derivative of the log evidence by each eigenvalue."""
        return np.square(self.weights) - self._inverse

    def by_signal(self) -> float:
        """Derivative of the log evidence by log s."""
        return 0.5 * float(np.sum(self._signals * self._sensitivity))

    def by_noise(self) -> float:
        """Derivative of the log evidence by log t."""
        return 0.5 * self.noise * float(np.sum(self._sensitivity))

    def along(self, side: Side, change: FloatArray) -> float:
        """Derivative of the log evidence along a change of one factor.

        Parameters
        ----------
        side
            The factor that changes; the other keeps its diagonal form.
        change
            Its derivative, of the factor's shape.
        """
        basis, roots, weights, inverse = self._seen_from(side)
        rotated = basis.T @ change @ basis
        quadratic = np.sum((rotated @ weights) * weights * roots)
        trace = np.diag(rotated) @ inverse @ roots
        return 0.5 * self.signal * float(quadratic - trace)

    def by_entries(self, side: Side, through: FloatArray | None = None) -> FloatArray:
        """Derivative of the log evidence by all entries of one factor at once.

        Its sum of products with a change is what :meth:`along` gives: use this for many changes.

        Parameters
        ----------
        side
            The factor.
        through
            T of a factor T C T^T, for the derivative by the entries of C; ``None``: the identity.
        """
        basis, roots, weights, inverse = self._seen_from(side)
        middle = (weights * roots) @ weights.T - np.diag(inverse @ roots)
        rotated = basis.T if through is None else basis.T @ through
        return 0.5 * self.signal * rotated.T @ middle @ rotated

    def _seen_from(self, side: Side) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Basis of one factor, roots of the other; weights and inverse with its axis first."""
        if side == "left":
            return self.left.basis, self.right.roots, self.weights, self._inverse
        return self.right.basis, self.left.roots, self.weights.T, self._inverse.T

    def left_out(self) -> FloatArray:
        """Mahalanobis square of each point's values, predicted from all others [-], shape [n].

        Closed form of leave-one-out (R & W eqs 5.10-5.12), in every direction of V.
        """
        basis = self.left.basis
        squares = np.square(basis @ self.weights) / (np.square(basis) @ self._inverse)
        return squares.sum(axis=1)

    def posterior(self, unit: float = 1.0) -> Posterior:
        """What is known of the process without noise, in values of this unit."""
        roots, signal = self.right.roots, self.signal
        return Posterior(
            basis=self.right.basis,
            roots=roots,
            signal=signal,
            unit=unit,
            mean_weights=unit * signal * self.left.basis @ (self.weights * roots),
            _points_basis=self.left.basis,
            _variance_weights=signal**2 * np.square(roots) / self.eigenvalues,
        )


@dataclass(frozen=True, eq=False)
class Posterior:
    """The process without noise, in the basis V where its directions are independent.

    Points are told by their covariances K_x with the n: ``across``, shape [k, n].

    Attributes
    ----------
    basis, roots
        V and b [-], shapes [M, M] and [M].
    signal, unit
        s [-], and the unit of the values.
    mean_weights
        s U W diag(b) times the unit: ``across`` times these is the mean, shape [n, M].
    """

    basis: FloatArray
    roots: FloatArray
    signal: float
    unit: float
    mean_weights: FloatArray
    _points_basis: FloatArray
    _variance_weights: FloatArray

    def variance(self, across: FloatArray, alone: FloatArray) -> FloatArray:
        """Variance at points of variance ``alone`` a priori, shape [k] -> [k, M]."""
        explained = np.square(across @ self._points_basis) @ self._variance_weights
        prior = np.outer(self.signal * alone, self.roots)
        # The difference of two nearly equal numbers may round to a negative one.
        return self.unit**2 * np.maximum(prior - explained, 0.0)

    def covariance(self, one: FloatArray, other: FloatArray, between: FloatArray) -> FloatArray:
        """Covariance of points [k, n] and [l, n], ``between`` them a priori [k, l] -> [k, l, M]."""
        left, right = one @ self._points_basis, other @ self._points_basis
        # For each direction a product of [k, n] and [n, l].
        explained = np.einsum(
            "ki,ij,li->klj", left, self._variance_weights, right, optimize="greedy"
        )
        prior = (self.signal * between)[:, :, None] * self.roots
        return self.unit**2 * (prior - explained)


class Blocks:
    """A process over the points for each direction of V, of a covariance of its own.

    Parameters
    ----------
    covariances
        Of the values in each direction, noise included [-], shape [M, n, n].
    """

    def __init__(self, covariances: FloatArray) -> None:
        self.covariances = covariances
        self.inverse = np.linalg.inv(covariances).astype(np.float64)

    def weights(self, values: FloatArray) -> FloatArray:
        """K^-1 y in each direction, values in the basis V of shape [..., n, M]."""
        return np.einsum("jab,...bj->...aj", self.inverse, values, optimize=True)

    def evidence(self, values: FloatArray, shapes: FloatArray) -> tuple[float, FloatArray]:
        """Log evidence up to a constant, and its derivative by variances of terms within.

        Parameters
        ----------
        values
            In the basis V [-], shape [n, M].
        shapes
            Columns p_k of terms p_k p_k^T that all directions have, shape [n, k].

        Returns
        -------
        tuple
            Log p of the values [-], but for what does not depend on the covariances, and its
            derivative by the variance of each term in each direction, shape [M, k].
        """
        weights = (self.inverse @ values.T[:, :, None])[:, :, 0]
        volume = np.linalg.slogdet(self.covariances)[1].sum()
        quadratic = np.sum(weights * values.T)
        traces = np.sum((self.inverse @ shapes) * shapes, axis=1)
        by_variances = 0.5 * (np.square(weights @ shapes) - traces)
        return float(-0.5 * (quadratic + volume)), by_variances

    def explained(self, between: FloatArray) -> FloatArray:
        """Variance at points that the values explain.

        Parameters
        ----------
        between
            Covariance with the values, shape [M, k, n]; the result has [k, M].
        """
        return np.sum((between @ self.inverse) * between, axis=2).T

    def carried(self, between: FloatArray) -> FloatArray:
        """Variance of the mean by unit noise of the values; shapes as in :meth:`explained`."""
        return np.square(between @ self.inverse).sum(axis=2).T


def maximise(
    evidence: Callable[[FloatArray], tuple[float, FloatArray]],
    starts: Iterable[FloatArray],
    bounds: ArrayLike,
    *,
    restarts: int = 0,
    seed: int = 0,
    **tolerances: float,
) -> FloatArray:
    """Parameters of most evidence, by L-BFGS-B from several starts.

    Parameters
    ----------
    evidence
        Log evidence and its gradient at parameters, mostly logarithms of hyperparameters.
    starts
        Where to begin; moved within the bounds.
    bounds
        Least and largest value of each parameter, shape [parameter, 2].
    restarts, seed
        Random starts within the bounds besides, and their seed.
    tolerances
        Options of the optimiser, such as ``ftol``.
    """
    from scipy.optimize import minimize

    def objective(parameters: FloatArray) -> tuple[float, FloatArray]:
        value, gradient = evidence(parameters)
        return -value, -gradient

    low, high = np.asarray(bounds, dtype=np.float64).T
    random = np.random.default_rng(seed).uniform(low, high, size=(restarts, low.size))
    optima = [
        minimize(
            objective, np.clip(start, low, high), jac=True, bounds=np.column_stack([low, high]),
            method="L-BFGS-B", options=tolerances,
        )
        for start in (*starts, *random)
    ]  # fmt: skip
    return min(optima, key=lambda optimum: float(optimum.fun)).x


def single_threaded() -> AbstractContextManager[Any]:
    """Context in which BLAS uses one thread: more cost small matrices far more than they gain."""
    return _threads().limit(limits=1, user_api="blas")


@functools.cache
def _threads() -> ThreadpoolController:
    """Threads of NumPy's BLAS and of SciPy's, which is another and must have been loaded."""
    import scipy.linalg  # noqa: F401

    return ThreadpoolController()
