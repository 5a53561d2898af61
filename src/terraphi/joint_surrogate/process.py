"""Both forces of a leg between a library's angles, with the covariance of what is not known.

A library's curves carry particle scatter, y_i = f(phi_i) + e_i (`scatter`). Over phi, theta and the
two forces f is a Gaussian process; divided by the scatter's standard deviation sigma(phi, theta),

    y / sigma ~ N(0, K_phi (x) B + I (x) R),      (x) the Kronecker product,

where R is the scatter's correlation, K_phi the covariance over phi of a free cubic and a Matern
process, both times the growth of forces over scatter, and B the covariance over leg angles and
forces: for each force a squared exponential in theta and a white part, for what the grid leaves in
every curve. B and R are diagonal in a common basis, B = A diag(lambda) A^T and R = A A^T, so
evidence, prediction and the whole covariance of the 2 m forces at any phi are in closed form
(Rakitsch et al., *It is all in the noise*, NIPS 2013): in that basis the predictive covariance is
diagonal. It holds what interpolation leaves open and what the library's own scatter does to the
curve, which is the same for every history inverted with that library.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from threadpoolctl import threadpool_limits

from terraphi.joint_surrogate.evidence import (
    JointKernel,
    Spectrum,
    Standardised,
    maximise_evidence,
    phi_covariance,
)
from terraphi.scatter import Scatter, corrected, with_tail

FloatArray = NDArray[np.float64]

ROUNDS = 2
"""Corrections of the scatter by the curves."""


@dataclass(frozen=True, eq=False)
class JointSurrogate:
    """Mean and covariance of the observation vector [Fx, Fz] of one leg, over phi.

    Attributes
    ----------
    phi_deg, theta_deg
        Training friction angles and leg angles [deg], shapes [case] and [theta].
    scatter, kernel
        Particle scatter of the curves, and hyperparameters.
    log_evidence
        Log marginal likelihood of the standardised curves [-].
    basis
        A, in which all covariances are diagonal [-], shape [2 theta, 2 theta].
    whitener
        The inverse of A [-], same shape.
    """

    phi_deg: FloatArray
    theta_deg: FloatArray
    scatter: Scatter
    kernel: JointKernel
    log_evidence: float
    basis: FloatArray = field(repr=False)
    whitener: FloatArray = field(repr=False)
    _roots: FloatArray = field(repr=False)
    _phi_basis: FloatArray = field(repr=False)
    _phi_roots: FloatArray = field(repr=False)
    _projected: FloatArray = field(repr=False)

    @classmethod
    def fit(
        cls,
        phi_deg: ArrayLike,
        theta_deg: ArrayLike,
        curves: ArrayLike,
        scatter: Scatter,
        *,
        kernel: JointKernel | None = None,
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
            Of these curves.
        kernel
            Hyperparameters, for a scatter already fitted; ``None`` finds those of maximum evidence.

        Raises
        ------
        ValueError
            If shapes disagree, angles do not increase or are too few, or a value is not finite.
        """
        with threadpool_limits(limits=1, user_api="blas"):
            if kernel is None:
                scatter, kernel = _learn(phi_deg, theta_deg, curves, scatter)
            data = Standardised(phi_deg, theta_deg, curves, scatter)
            spectrum = Spectrum(data, kernel)
            return cls(
                phi_deg=data.phi,
                theta_deg=data.theta,
                scatter=scatter,
                kernel=kernel,
                log_evidence=spectrum.log_evidence(),
                basis=data.factor @ spectrum.basis,
                whitener=spectrum.basis.T @ data.inverse_factor,
                _roots=spectrum.roots,
                _phi_basis=spectrum.phi_basis,
                _phi_roots=spectrum.phi_roots,
                _projected=spectrum.projected,
            )

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

    def standard_mean(self, phi_deg: FloatArray, projected: FloatArray | None = None) -> FloatArray:
        """Mean in the common basis, over sigma [-], shape [k] -> [..., k, 2 theta].

        Parameters
        ----------
        phi_deg
            [deg], shape [k].
        projected
            Other curves than the library's, as :meth:`project` gives them, shape
            [..., case, 2 theta].
        """
        values = self._projected if projected is None else projected
        weights = self._roots / (np.outer(self._phi_roots, self._roots) + 1.0)
        mean: FloatArray = self._correlations(phi_deg) @ (weights * values)
        return mean

    def project(self, curves: FloatArray) -> FloatArray:
        """Curves over sigma in the eigenbasis of their covariance, shape [..., case, 2 theta]."""
        standard = curves / self.scatter.sigma(self.phi_deg) @ self.whitener.T
        projected: FloatArray = self._phi_basis.T @ standard
        return projected

    def standard_variance(self, phi_deg: FloatArray) -> FloatArray:
        """Predictive variance in the common basis, over sigma^2 [-], shape [k] -> [k, 2 theta].

        The variance of the particle scatter itself is 1 in this basis.
        """
        squares = np.square(self._correlations(phi_deg))
        products = np.outer(self._phi_roots, self._roots) + 1.0
        explained = squares @ (np.square(self._roots) / products)
        alone = np.array([np.add(*self.phi_covariance(phi, phi))[0, 0] for phi in phi_deg[:, None]])
        return np.maximum(np.outer(alone, self._roots) - explained, 0.0)

    def standard_terms(self, phi_deg: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The two parts of :meth:`standard_variance`: interpolation, and the library's scatter.

        The prediction is W y with weights W; its error (f - W f(phi_i)) - W e has a part that the
        prior of f gives and one that the scatter e of the library gives.
        """
        weights = self._roots / (np.outer(self._phi_roots, self._roots) + 1.0)
        scatter = np.square(self._correlations(phi_deg)) @ np.square(weights)
        total = self.standard_variance(phi_deg)
        return np.maximum(total - scatter, 0.0), np.minimum(scatter, total)

    @property
    def prior_variance(self) -> FloatArray:
        """Prior variance of f in the common basis, over sigma^2 [-], shape [2 theta]."""
        return self._roots

    @property
    def standard_curves(self) -> FloatArray:
        """The library's curves in the common basis, over sigma [-], shape [case, 2 theta]."""
        curves: FloatArray = self._phi_basis @ self._projected
        return curves

    def regress(self, correlation: FloatArray, curves: FloatArray) -> FloatArray:
        """Prediction from other curves, in the common basis.

        Parameters
        ----------
        correlation
            K_phi between angles and training angles [-], shape [..., k, case].
        curves
            Over sigma, in the basis [-], shape [..., case, 2 theta].
        """
        weights = self._roots / (np.outer(self._phi_roots, self._roots) + 1.0)
        inside = weights * (self._phi_basis.T @ curves)
        prediction: FloatArray = (correlation @ self._phi_basis) @ inside
        return prediction

    def standard_drift(self, phi_deg: FloatArray, other_deg: FloatArray) -> FloatArray:
        """Covariance of a prediction with the error of another [-], in the basis, over sigma^2.

        Predictions W y of a process with known mean are independent of their errors. Ours has a
        cubic with free coefficients, of which only y knows: cov(W y, W y - f) of the rest, with
        covariance K of its Matern part u, is W ((K + 1) W'^T - k').

        Parameters
        ----------
        phi_deg, other_deg
            Angles of the predictions and of the errors [deg], shape [k] each; the result has shape
            [k, 2 theta].
        """
        shrink = self._roots / (np.outer(self._phi_roots, self._roots) + 1.0)
        one, other = (self._correlations(phi)[:, :, None] * shrink for phi in (phi_deg, other_deg))
        local = self.phi_covariance(self.phi_deg, self.phi_deg)[1]
        inside = self._phi_basis.T @ local @ self._phi_basis
        alone = self.phi_covariance(other_deg, self.phi_deg)[1] @ self._phi_basis
        missing = other + self._roots * (inside @ other - alone[:, :, None])
        drift: FloatArray = np.sum(one * missing, axis=1)
        return drift

    def covariance(self, phi_deg: float, *, scale: float = 1.0) -> FloatArray:
        """Predictive covariance of the forces f [N^2], shape [2 theta, 2 theta]."""
        phi = np.array([phi_deg], dtype=np.float64)
        left = scale * self.scatter.sigma(phi)[0][:, None] * self.basis
        result: FloatArray = (left * self.standard_variance(phi)[0]) @ left.T
        return result

    def phi_covariance(
        self, one_deg: FloatArray, other_deg: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Cubic and Matern part of K_phi [-], [..., one] and [..., other] -> [..., one, other]."""
        cubic, matern = phi_covariance(
            one_deg, other_deg, self.kernel.phi_length_deg, self.phi_bounds_deg
        )
        one, other = self.scatter.growth(one_deg), self.scatter.growth(other_deg)
        growth = one[..., :, None] * other[..., None, :]
        return growth * cubic, growth * matern

    def _correlations(self, phi_deg: FloatArray) -> FloatArray:
        """K_phi between angles and training angles, in the latter's eigenbasis, [k, case]."""
        correlations: FloatArray = (
            np.add(*self.phi_covariance(phi_deg, self.phi_deg)) @ self._phi_basis
        )
        return correlations


def _learn(
    phi_deg: ArrayLike, theta_deg: ArrayLike, curves: ArrayLike, scatter: Scatter
) -> tuple[Scatter, JointKernel]:
    """Hyperparameters, and the scatter as curves predicted from the others show it."""
    for _ in range(ROUNDS):
        data = Standardised(phi_deg, theta_deg, curves, scatter)
        kernel, noise = maximise_evidence(data)
        squares = Spectrum(data, kernel, noise).left_out()
        scatter = corrected(scatter, data.phi, noise**2 * squares)
    data = Standardised(phi_deg, theta_deg, curves, scatter)
    kernel, noise = maximise_evidence(data)
    squares = Spectrum(data, kernel, noise).left_out()
    return with_tail(scatter.scaled(noise), squares), kernel
