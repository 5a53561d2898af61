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

import functools
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError
from terraphi.experiment.rig import Rig
from terraphi.laws.gp import Process, fitted
from terraphi.laws.law import LegLaw, is_similar, remedy
from terraphi.laws.store import Curves, Library

SMOOTH_DEG = 5.0
"""Width of the mean by which the size of scatter is smoothed over the leg angle [deg]."""
LEAST = 1e-9
"""Share of the variance that a component must have [-]."""


@dataclass(frozen=True, eq=False)
class Emulator:
    """Forces of one leg over the friction angle.

    Attributes
    ----------
    curves
        What it was made from.
    """

    curves: Curves

    # -- fitting ---------------------------------------------------------------------------------

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Smallest and largest friction angle [deg], shape [1] each."""
        return self.curves.x.min(axis=0), self.curves.x.max(axis=0)

    def _standard(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """φ from the center over the half range [k, 1], and polynomials of the mean [k, q].

        These are constant, linear and, of ten cases, quadratic.
        """
        low, high = self.bounds
        t = (x - 0.5 * (low + high)) / (0.5 * (high - low))
        is_curved = len(self.curves.x) > 9 and np.unique(self.curves.x).size > 2
        return t, np.asarray(t ** np.arange(3 if is_curved else 2))

    def _exponential(self, sizes: FloatArray) -> Callable[[FloatArray], FloatArray]:
        """Exponential of the polynomial nearest to the logarithm of a size of each case."""
        # Of the logarithm, so that a size stays positive and errors are relative.
        polynomials = self._standard(self.curves.x)[1]
        nearest = np.linalg.lstsq(polynomials, np.log(sizes), rcond=None)[0]
        return lambda x: np.exp(self._standard(x)[1] @ nearest)

    @cached_property
    def size(self) -> Callable[[FloatArray], FloatArray]:
        """Size a(x) of the forces [N], a function of φ: shape [k, 1] -> [k]."""
        return self._exponential(np.sqrt(np.square(self.curves.force).mean(axis=(1, 2))))

    @cached_property
    def _components(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Mean z0 [2 theta], components u [k, 2 theta] and weights w of the cases [case, k]."""
        # With a(x) divided out the curves differ by shape alone. Z − z0 = U S V': the rows of V'
        # are the components, the columns of U S the weights.
        z = self.curves.force.reshape(len(self.curves.x), -1) / self.size(self.curves.x)[:, None]
        mean = z.mean(axis=0)
        case_vectors, values, u = np.linalg.svd(z - mean, full_matrices=False)
        kept = np.square(values) > LEAST * np.square(values).sum()
        return mean, u[kept], (case_vectors * values)[:, kept]

    @cached_property
    def _processes(self) -> list[Process]:
        """A fitted process for each component."""
        rough = self.scatter_size if self._scatters else lambda x: np.ones(len(x))
        x = self.curves.x
        return fitted(*self._standard(x), self._components[2], rough(x))

    @property
    def _scatters(self) -> bool:
        """True if simulations differ by their particle seed."""
        return self.curves.scenario.model == "mpm"

    @cached_property
    def _leave_one_out_residual(self) -> FloatArray:
        """Residual of each curve outside the span of the others, over a(x) [-], [case, 2 theta]."""
        z = self.curves.force.reshape(len(self.curves.x), -1) / self.size(self.curves.x)[:, None]
        z -= z.mean(axis=0)
        # What no combination of the others has is scatter between seeds: the least of all sums of
        # curves in which one has the weight 1 and the others -1 together.
        weights = np.linalg.pinv(z @ z.T, rcond=1e-12, hermitian=True)
        return weights @ z / np.diag(weights)[:, None]

    @cached_property
    def scatter_size(self) -> Callable[[FloatArray], FloatArray]:
        """Size b(x) of the scatter over that of the forces [-], as :attr:`size`."""
        rms = np.sqrt(np.square(self._leave_one_out_residual).mean(axis=1))
        return self._exponential(rms + 1e-12)

    @cached_property
    def _unexplained_covariance(self) -> FloatArray:
        """Covariance of the scatter outside the components, over (a b)² [-], [2 theta, 2 theta]."""
        theta = self.curves.theta_deg
        residual = self._leave_one_out_residual / self.scatter_size(self.curves.x)[:, None]
        residual = residual.reshape(len(residual), 2, theta.size)
        # There are far fewer curves than angles, so that their covariance itself would be of low
        # rank: the variance is smoothed over θ, and the correlation depends on the lag alone.
        near = np.exp(-0.5 * np.square((theta[:, None] - theta) / SMOOTH_DEG))
        near /= near.sum(axis=1, keepdims=True)
        sd = np.sqrt(np.square(residual).mean(axis=0) @ near.T)
        sd = np.maximum(sd, 1e-3 * sd.max())
        # Zeros behind each row, so that its end is not taken for the neighbour of its beginning.
        spectrum = np.square(np.abs(np.fft.rfft(residual / sd, 2 * theta.size)))
        correlation = np.fft.irfft(spectrum.mean(axis=(0, 1)))[: theta.size]
        lag = np.abs(np.subtract.outer(np.arange(theta.size), np.arange(theta.size)))
        # By Wiener and Khinchin: the correlation is the transform of the mean power spectrum.
        toeplitz = (correlation / correlation[0])[lag]
        return np.kron(np.eye(2), toeplitz) * np.outer(sd.ravel(), sd.ravel())

    # -- prediction ------------------------------------------------------------------------------

    def __call__(self, x: FloatArray) -> FloatArray:
        """Forces (Fx, Fz) at friction angles [N], shape [k, 1] -> [k, 2, theta].

        Beyond the range of φ the forces continue in proportion to exp(ln a) and with the mean of
        each weight, which grows uncertain there.
        """
        mean, u, _ = self._components
        weights = np.hstack([process.mean(*self._standard(x)) for process in self._processes])
        return (self.size(x)[:, None] * (mean + weights @ u)).reshape(len(x), 2, -1)

    def interpolation(self, x: FloatArray) -> FloatArray:
        """Factor F of the emulator's own covariance F F' at one point [N], shape [2 theta, k]."""
        # Weights are independent: a column a(x) σ_k(x) u_k for each component.
        at = self._standard(x[None])
        variance = [process.variance(*at)[0, 0] for process in self._processes]
        return np.asarray((self.size(x[None])[0] * np.sqrt(variance)) * self._components[1].T)

    def scatter(self, x: FloatArray) -> FloatArray:
        """Covariance of the scatter of one simulation at a point [N²], [2 theta, 2 theta]."""
        if not self._scatters:
            return np.zeros((2 * self.curves.theta_deg.size,) * 2)
        u = self._components[1]
        nugget = np.concatenate([process.nugget for process in self._processes])
        size = self.size(x[None])[0] * self.scatter_size(x[None])[0]
        return np.asarray(np.square(size) * ((u.T * nugget) @ u + self._unexplained_covariance))


@functools.lru_cache(maxsize=16)
def emulator_of(library: Library, leg: str) -> Emulator:
    """Emulator of one leg of a library, kept for the next record; see `Library.curves`."""
    return Emulator(library.curves(leg))


class LibraryLaw(LegLaw):
    """The law of a library for a rig of its proportions, longer by a factor [-]."""

    def __init__(self, emulator: Emulator, longer: float) -> None:
        curves = emulator.curves
        self.emulator, self._scale = emulator, longer**3
        self.bounds, self.theta_deg = emulator.bounds, curves.theta_deg
        self.density = curves.scenario.soil.density
        self.leg_friction = curves.scenario.leg.friction
        self._arm = None if curves.arm is None else longer * curves.arm

    def within(self, x: FloatArray, _cohesion: float) -> FloatArray:
        """Forces within the bounds."""
        return self._scale * self.emulator(x)

    def interpolation(self, x: FloatArray, _cohesion: float) -> FloatArray:
        """Factor of the emulator's covariance."""
        return self._scale * self.emulator.interpolation(np.clip(x, *self.bounds))

    def scatter(self, x: FloatArray, _cohesion: float) -> FloatArray:
        """Covariance of the emulator's scatter."""
        return self._scale**2 * self.emulator.scatter(np.clip(x, *self.bounds))


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
    return LibraryLaw(emulator, 1.0 if simulated is None else rig.length / simulated.length)
