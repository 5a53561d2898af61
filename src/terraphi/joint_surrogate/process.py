"""Both forces of a leg between a library's angles, with the covariance of what is not known.

A library's curves carry particle scatter, y_i = f(phi_i) + e_i (`scatter`). Over phi, theta and the
two forces f is a Gaussian process; divided by the scatter's standard deviation sigma(phi, theta),

    y / sigma ~ N(0, K_m (x) B + sum_k x^k x'^k (x) B_k + I (x) R),    (x) the Kronecker product,

where R is the scatter's correlation, K_m a Matern covariance over phi, B its covariance over leg
angles and forces (for each force a squared exponential in theta and a white part, for what the grid
leaves in every curve), and B_k that of the coefficients of a cubic (`cubic`); K_m and x^k are times
the growth of forces over scatter. The mean of n simulations of one case has R / n: its row, and
the growth there, are taken sqrt(n) times, so that all rows scatter alike.

B and R are diagonal in a common basis, B = A diag(lambda) A^T and R = A A^T (Rakitsch et al., *It
is all in the noise*, NIPS 2013), and so is B_k by definition: in that basis every direction is a
process over phi by itself, and evidence, prediction and the whole covariance of the 2 m forces at
any phi are in closed form. The covariance holds what interpolation leaves open and what the
library's own scatter does to the curve, which is the same for every history inverted with that
library.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from threadpoolctl import threadpool_limits

from terraphi.joint_surrogate.cubic import cubic_variances, fit_cubic, powers_of
from terraphi.joint_surrogate.evidence import (
    JointKernel,
    Spectrum,
    Standardised,
    matern,
    maximise_evidence,
)
from terraphi.scatter import Scatter, corrected, with_tail

FloatArray = NDArray[np.float64]

ROUNDS = 2
"""Corrections of the scatter by the curves."""
JITTER = 1e-9
"""Added to the variance of equal angles, so that they have a factor."""


@dataclass(frozen=True, eq=False)
class JointSurrogate:
    """Mean and covariance of the observation vector [Fx, Fz] of one leg, over phi.

    Attributes
    ----------
    phi_deg, theta_deg
        Training friction angles and leg angles [deg], shapes [case] and [theta].
    scatter, kernel
        Particle scatter of a simulation, and hyperparameters.
    root_repeats
        Square root of the number of simulations that each curve is the mean of [-], shape [case].
    basis
        A, in which all covariances are diagonal [-], shape [2 theta, 2 theta].
    whitener
        The inverse of A [-], same shape.
    standard_curves
        The library's curves in the basis, over sigma and times root_repeats [-], shape
        [case, 2 theta].
    prior_variance, cubic_variance
        Prior variance of the Matern process and of the cubic's coefficients in each direction of
        the basis, over sigma^2 [-], shapes [2 theta] and [4, 2 theta].
    """

    phi_deg: FloatArray
    theta_deg: FloatArray
    scatter: Scatter
    kernel: JointKernel
    root_repeats: FloatArray = field(repr=False)
    basis: FloatArray = field(repr=False)
    whitener: FloatArray = field(repr=False)
    standard_curves: FloatArray = field(repr=False)
    prior_variance: FloatArray = field(repr=False)
    cubic_variance: FloatArray = field(repr=False)
    _inverse: FloatArray = field(repr=False)

    @classmethod
    def fit(
        cls,
        phi_deg: ArrayLike,
        theta_deg: ArrayLike,
        curves: ArrayLike,
        scatter: Scatter,
        *,
        kernel: JointKernel | None = None,
        repeats: ArrayLike | None = None,
    ) -> Self:
        """Condition on the curves of a library.

        Without a kernel, its hyperparameters are found, and the scatter is fitted to how well each
        curve is predicted from the others: a quadratic in phi of its logarithm, and its tail.

        Parameters
        ----------
        phi_deg, theta_deg
            Friction angles, at least three, increasing, and leg angles [deg].
        curves
            Observation vectors [N], shape [case, 2 theta].
        scatter
            Of one simulation.
        kernel
            Hyperparameters, for a scatter already fitted; ``None`` finds those of maximum evidence.
        repeats
            Number of simulations that each curve is the mean of, shape [case]; ``None`` is one.

        Raises
        ------
        ValueError
            If shapes disagree, angles do not increase or are too few, or a value is not finite.
        """
        with threadpool_limits(limits=1, user_api="blas"):
            if kernel is None:
                scatter, kernel = _learn(phi_deg, theta_deg, curves, scatter, repeats)
            data = Standardised(phi_deg, theta_deg, curves, scatter, repeats)
            spectrum = Spectrum(data, kernel)
            whitener = spectrum.basis.T @ data.inverse_factor
            variances = cubic_variances(kernel.cubic, kernel.cubic_power, spectrum.roots)
            known = cls(
                phi_deg=data.phi,
                theta_deg=data.theta,
                scatter=scatter,
                kernel=kernel,
                root_repeats=data.root_repeats,
                basis=data.factor @ spectrum.basis,
                whitener=whitener,
                standard_curves=data.values @ whitener.T,
                prior_variance=spectrum.roots,
                cubic_variance=variances,
                _inverse=np.empty(0),
            )
            covariance = known._between(data.phi) * data.root_repeats[:, None]
            covariance += np.eye(data.phi.size)
            return replace(known, _inverse=np.linalg.inv(covariance).astype(np.float64))

    @property
    def phi_bounds_deg(self) -> tuple[float, float]:
        """Smallest and largest training friction angle [deg]."""
        return float(self.phi_deg[0]), float(self.phi_deg[-1])

    @property
    def phi_step_deg(self) -> float:
        """Largest spacing of the training friction angles [deg]."""
        return float(np.diff(self.phi_deg).max())

    def predict(self, phi_deg: ArrayLike, *, scale: float = 1.0) -> FloatArray:
        """Mean observation vectors [N], shape [k] -> [k, 2 theta].

        Parameters
        ----------
        phi_deg
            Friction angles [deg], shape [k].
        scale
            Factor on the forces [-], such as the soil's density over the library's.
        """
        phi = np.atleast_1d(np.asarray(phi_deg, dtype=np.float64))
        return scale * self.scatter.sigma(phi) * (self.standard_mean(phi) @ self.basis.T)

    def standard_mean(self, phi_deg: FloatArray, curves: FloatArray | None = None) -> FloatArray:
        """Mean in the common basis, over sigma [-], shape [k] -> [..., k, 2 theta].

        Parameters
        ----------
        phi_deg
            [deg], shape [k].
        curves
            Others than the library's, as :meth:`standard` gives them, [..., case, 2 theta].
        """
        weights = self._weights(self.standard_curves if curves is None else curves)
        local = self.scatter.growth(phi_deg)[:, None] * self.scatter.growth(self.phi_deg)
        local = local * matern(phi_deg, self.phi_deg, self.kernel.phi_length_deg)
        mean: FloatArray = self._cubic(phi_deg, weights)
        return mean + local @ (self.prior_variance * weights)

    def standard_cubic(self, phi_deg: FloatArray) -> FloatArray:
        """Part of :meth:`standard_mean` that is the library's cubic; shapes as there."""
        return self._cubic(phi_deg, self._weights(self.standard_curves))

    def _cubic(self, phi_deg: FloatArray, weights: FloatArray) -> FloatArray:
        coefficients = self.cubic_variance * (self._powers(self.phi_deg).T @ weights)
        found: FloatArray = self._powers(phi_deg) @ coefficients
        return found

    def standard(self, curves: FloatArray) -> FloatArray:
        """Curves [N] like the library's in the basis, of scatter 1 [-], shape [..., case, 2 theta].

        Each is the mean of as many simulations as the library's.
        """
        found: FloatArray = curves / self.scatter.sigma(self.phi_deg) @ self.whitener.T
        return self.root_repeats[:, None] * found

    def standard_variance(self, phi_deg: FloatArray) -> FloatArray:
        """Predictive variance in the common basis, over sigma^2 [-], shape [k] -> [k, 2 theta].

        The variance of the particle scatter itself is 1 in this basis.
        """
        between = self._between(phi_deg)
        explained: FloatArray = np.sum((between @ self._inverse) * between, axis=2).T
        return np.maximum(self._alone(phi_deg) - explained, 0.0)

    def standard_terms(self, phi_deg: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The two parts of :meth:`standard_variance`: interpolation, and the library's scatter.

        The prediction is W y with weights W; its error (f - W f(phi_i)) - W e has a part that the
        prior of f gives and one that the scatter e of the library gives.
        """
        between = self._between(phi_deg)
        scatter = np.square(between @ self._inverse).sum(axis=2).T
        total = self.standard_variance(phi_deg)
        return np.maximum(total - scatter, 0.0), np.minimum(scatter, total)

    def prior_covariance(self, one_deg: FloatArray, other_deg: FloatArray) -> FloatArray:
        """Prior covariance of f in each direction of the basis, over sigma^2 [-].

        Parameters
        ----------
        one_deg, other_deg
            Friction angles [deg], shapes [one] and [other]; the result has [one, other, 2 theta].
        """
        local = self.scatter.growth(one_deg)[:, None] * self.scatter.growth(other_deg)
        local = local * matern(one_deg, other_deg, self.kernel.phi_length_deg)
        one, other = self._powers(one_deg), self._powers(other_deg)
        products = one[:, None, :] * other
        covariance: FloatArray = products @ self.cubic_variance
        return covariance + local[:, :, None] * self.prior_variance

    def draw(
        self, phi_deg: FloatArray, rng: np.random.Generator, *, about: FloatArray | None = None
    ) -> FloatArray:
        """Draw f from its prior, in the basis and over sigma [-].

        Parameters
        ----------
        phi_deg
            Friction angles of each draw [deg], shape [..., k]; the result has [..., k, 2 theta].
        rng
            Random generator.
        about
            The cubic at these angles, same shape as the result; ``None`` draws it too.
        """
        growth = self.scatter.growth(phi_deg)
        local = matern(phi_deg, phi_deg, self.kernel.phi_length_deg)
        factor = np.linalg.cholesky(local + JITTER * np.eye(phi_deg.shape[-1]))
        size = self.prior_variance.size
        white = rng.standard_normal((*phi_deg.shape, size))
        drawn = growth[..., None] * (factor @ white) * np.sqrt(self.prior_variance)
        if about is None:
            coefficients = rng.standard_normal((*phi_deg.shape[:-1], 4, size))
            about = self._powers(phi_deg) @ (coefficients * np.sqrt(self.cubic_variance))
        found: FloatArray = drawn + about
        return found

    def covariance(self, phi_deg: float, *, scale: float = 1.0) -> FloatArray:
        """Predictive covariance of the forces f [N^2], shape [2 theta, 2 theta]."""
        phi = np.array([phi_deg], dtype=np.float64)
        left = scale * self.scatter.sigma(phi)[0][:, None] * self.basis
        result: FloatArray = (left * self.standard_variance(phi)[0]) @ left.T
        return result

    def _between(self, phi_deg: FloatArray) -> FloatArray:
        """Prior covariance of f with the rows of the curves, [k] -> [2 theta, k, case]."""
        covariance = self.prior_covariance(phi_deg, self.phi_deg).transpose(2, 0, 1)
        return covariance * self.root_repeats

    def _weights(self, curves: FloatArray) -> FloatArray:
        """What a mean gives each curve's angle: K^-1 y times root_repeats, [..., case, 2 theta]."""
        solved = np.einsum("jab,...bj->...aj", self._inverse, curves, optimize=True)
        weights: FloatArray = self.root_repeats[:, None] * solved
        return weights

    def _powers(self, phi_deg: FloatArray) -> FloatArray:
        """Growth times 1, x, x^2, x^3, shape [...] -> [..., 4]."""
        return self.scatter.growth(phi_deg)[..., None] * powers_of(phi_deg, self.phi_bounds_deg)

    def _alone(self, phi_deg: FloatArray) -> FloatArray:
        """Prior variance of f in the basis, over sigma^2 [-], shape [k] -> [k, 2 theta]."""
        local = np.outer(np.square(self.scatter.growth(phi_deg)), self.prior_variance)
        variance: FloatArray = np.square(self._powers(phi_deg)) @ self.cubic_variance + local
        return variance


def _learn(
    phi_deg: ArrayLike,
    theta_deg: ArrayLike,
    curves: ArrayLike,
    scatter: Scatter,
    repeats: ArrayLike | None,
) -> tuple[Scatter, JointKernel]:
    """Hyperparameters, and the scatter as curves predicted from the others show it."""
    for _ in range(ROUNDS):
        data = Standardised(phi_deg, theta_deg, curves, scatter, repeats)
        kernel, noise = maximise_evidence(data)
        squares = Spectrum(data, kernel, noise).left_out()
        scatter = corrected(scatter, data.phi, noise**2 * squares)
    data = Standardised(phi_deg, theta_deg, curves, scatter, repeats)
    kernel, noise = maximise_evidence(data)
    squares = Spectrum(data, kernel, noise).left_out()
    scatter = with_tail(scatter.scaled(noise), squares)
    vague = JointSurrogate.fit(phi_deg, theta_deg, curves, scatter, kernel=kernel, repeats=repeats)
    return scatter, _with_cubic(vague)


def _with_cubic(vague: JointSurrogate) -> JointKernel:
    """The hyperparameters with a prior of the cubic."""
    phi = vague.phi_deg
    growth = vague.root_repeats * vague.scatter.growth(phi)
    amplitudes, power = fit_cubic(
        growth[:, None] * powers_of(phi, vague.phi_bounds_deg),
        np.outer(growth, growth) * matern(phi, phi, vague.kernel.phi_length_deg),
        vague.prior_variance,
        vague.standard_curves,
    )
    return replace(vague.kernel, cubic=amplitudes, cubic_power=power)
