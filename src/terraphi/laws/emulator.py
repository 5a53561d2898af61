r"""Force curves between the cases of a library: principal components, a Gaussian process each.

With y(x) the curves (Fx, Fz) of a leg as one vector over the leg angle, and x the friction angle,

    y(x) = a(x) [ z0 + sum_k w_k(x) u_k + b(x) e ],

a(x) is the size of the forces and b(x) that of their scatter, exponentials of polynomials; z0 and
u_k are mean and principal components of the curves over their size. Each weight w_k is a Gaussian
process with a quadratic mean, a Matérn 5/2 kernel and a nugget, n_k, the scatter between particle
seeds; hyperparameters maximise the restricted likelihood (Rasmussen & Williams 2006, section 2.7).
e is scatter outside the components, estimated from the part of each curve that the other curves
cannot describe. Its size is smooth over θ. Its correlation is a function of the distance in θ, from
the mean periodogram.
"""

from __future__ import annotations

import copy
import functools
from collections.abc import Callable

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError
from terraphi.experiment.rig import Rig
from terraphi.laws.gp import fitted
from terraphi.laws.law import LegLaw, is_similar, remedy
from terraphi.laws.store import Curves, Library

SMOOTH_DEG = 5.0
"""Width of the mean by which the size of scatter is smoothed over the leg angle [deg]."""
LEAST = 1e-9
"""Share of the variance that a component must have [-]."""


class Emulator(LegLaw):
    """The law of one leg of a library, for rigs of its proportions.

    Parameters
    ----------
    curves
        Forces of the leg over the friction angle.
    """

    _longer = 1.0

    def __init__(self, curves: Curves) -> None:
        self.curves, self._arm = curves, curves.arm
        self.bounds, self.theta_deg = (curves.x.min(axis=0), curves.x.max(axis=0)), curves.theta_deg
        self.density = curves.scenario.soil.density
        self.leg_friction = curves.scenario.leg.friction
        # With a(x) divided out the curves differ by shape alone. Z − z0 = U S V': the rows of V'
        # are the components, the columns of U S the weights.
        self._size = self._exponential(np.sqrt(np.square(curves.force).mean(axis=(1, 2))))
        z = curves.force.reshape(len(curves.x), -1) / self._size(curves.x)[:, None]
        self._mean = z.mean(axis=0)
        z -= self._mean
        case_vectors, values, u = np.linalg.svd(z, full_matrices=False)
        kept = np.square(values) > LEAST * np.square(values).sum()
        self._components = u[kept]
        # What no combination of the others has is scatter between seeds: the least of all sums of
        # curves in which one has the weight 1 and the others -1 together.
        weights = np.linalg.pinv(z @ z.T, rcond=1e-12, hermitian=True)
        residual = weights @ z / np.diag(weights)[:, None]
        self._scatter_size = self._exponential(np.sqrt(np.square(residual).mean(axis=1)) + 1e-12)
        # Only simulations with particles differ by a seed.
        rough, self._unexplained = np.ones(len(curves.x)), np.zeros((len(self._mean),) * 2)
        if curves.scenario.model == "mpm":
            rough = self._scatter_size(curves.x)
            self._unexplained = _stationary_covariance(residual / rough[:, None], self.theta_deg)
        else:
            self._scatter_size = lambda x: np.zeros(len(x))
        weights = (case_vectors * values)[:, kept]
        self._processes = fitted(*self._standard(curves.x), weights, rough)

    def _standard(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """φ from the center over the half range [k, 1], and polynomials of the mean [k, q].

        These are constant, linear and, of ten cases, quadratic.
        """
        low, high = self.bounds
        t = (x - 0.5 * (low + high)) / (0.5 * (high - low))
        is_curved = len(self.curves.x) > 9 and np.unique(self.curves.x).size > 2
        return t, np.asarray(t ** np.arange(3 if is_curved else 2))

    def _exponential(self, sizes: FloatArray) -> Callable[[FloatArray], FloatArray]:
        """Exponential of the polynomial nearest to the logarithm of a size of each case.

        A function of φ: shape [k, 1] -> [k].
        """
        # Of the logarithm, so that a size stays positive and errors are relative.
        polynomials = self._standard(self.curves.x)[1]
        nearest = np.linalg.lstsq(polynomials, np.log(sizes), rcond=None)[0]
        return lambda x: np.exp(self._standard(x)[1] @ nearest)

    def longer(self, factor: float) -> Emulator:
        """The law of a rig that is longer by a factor [-], by the same processes."""
        law = copy.copy(self)
        law._longer, law._arm = factor, None if self._arm is None else factor * self._arm
        return law

    def _size_at(self, x: FloatArray) -> FloatArray:
        """Size a(x) of the forces on the rig [N], shape [k, 1] -> [k]."""
        return self._longer**3 * self._size(x)

    def within(self, x: FloatArray, _cohesion: float) -> FloatArray:
        """Forces within the bounds."""
        weights = np.hstack([process.mean(*self._standard(x)) for process in self._processes])
        curves = self._mean + weights @ self._components
        return (self._size_at(x)[:, None] * curves).reshape(len(x), 2, -1)

    def interpolation(self, x: FloatArray, _cohesion: float = 0.0) -> FloatArray:
        """Factor of the covariance of the processes."""
        # Weights are independent: a column a(x) σ_k(x) u_k for each component.
        x = np.clip(x, *self.bounds)[None]
        variance = [process.variance(*self._standard(x))[0, 0] for process in self._processes]
        return np.asarray((self._size_at(x)[0] * np.sqrt(variance)) * self._components.T)

    def scatter(self, x: FloatArray, _cohesion: float = 0.0) -> FloatArray:
        """Covariance of the scatter of one simulation: of the weights, and outside of them."""
        x, u = np.clip(x, *self.bounds)[None], self._components
        nugget = np.concatenate([process.nugget for process in self._processes])
        size = self._size_at(x)[0] * self._scatter_size(x)[0]
        return np.asarray(np.square(size) * ((u.T * nugget) @ u + self._unexplained))


def _stationary_covariance(residual: FloatArray, theta: FloatArray) -> FloatArray:
    """Covariance of curves whose correlation depends on the lag in θ alone, [2 theta, 2 theta].

    From residuals of (Fx, Fz) over their size, shape [case, 2 theta].
    """
    residual = residual.reshape(len(residual), 2, theta.size)
    # There are far fewer curves than angles, so that their covariance itself would be of low rank:
    # the variance is smoothed over θ, and the correlation depends on the lag alone.
    near = np.exp(-0.5 * np.square((theta[:, None] - theta) / SMOOTH_DEG))
    near /= near.sum(axis=1, keepdims=True)
    sd = np.sqrt(np.square(residual).mean(axis=0) @ near.T)
    sd = np.maximum(sd, 1e-3 * sd.max())
    # By Wiener and Khinchin the correlation is the transform of the mean power spectrum. Zeros
    # behind each row, so that its end is not taken for the neighbour of its beginning.
    spectrum = np.square(np.abs(np.fft.rfft(residual / sd, 2 * theta.size)))
    correlation = np.fft.irfft(spectrum.mean(axis=(0, 1)))[: theta.size]
    lag = np.abs(np.subtract.outer(np.arange(theta.size), np.arange(theta.size)))
    toeplitz = (correlation / correlation[0])[lag]
    return np.kron(np.eye(2), toeplitz) * np.outer(sd.ravel(), sd.ravel())


@functools.lru_cache(maxsize=16)
def emulator_of(library: Library, leg: str) -> Emulator:
    """Emulator of one leg of a library, kept for the next record; see `Library.curves`."""
    return Emulator(library.curves(leg))


def leg_law(library: Library, rig: Rig, *, strict: bool = True) -> LegLaw:
    """The law of a rig by a library of legs.

    Parameters
    ----------
    library
        Has the rig's leg.
    rig
        The apparatus.
    strict
        True if the rig must have the proportions of the library's leg.

    Raises
    ------
    InputError
        If the library lacks the leg, or its leg has other proportions.
    """
    emulator = emulator_of(library, rig.leg)
    simulated = Rig.of_scenario(emulator.curves.scenario)
    if strict and simulated is not None and not is_similar(rig, simulated):
        raise InputError(
            f"library {library.name} is of a {simulated}, and this leg has other proportions; "
            f"{remedy(rig)}"
        )
    return emulator.longer(1.0 if simulated is None else rig.length / simulated.length)
