"""Forces on a leg over several parameters, known at scattered points, and between them.

Points are scattered over the parameters, yet each brings all leg angles. Over n points x of a
design in d parameters and M leg angles the covariance of a force is

    K = sigma^2 K_x (x) K_theta + tau^2 I,         (x) the Kronecker product (`kronecker`),
    K_x = t^2 (1 + x.y) + c(r),                    K_theta = exp(-lag^2 / 2 l^2) + f^2 I,

r the distance of x and y, c the Matern correlation of order 5/2, with a length of its own
along each parameter (Rasmussen & Williams, eq. 4.17), t the size of a
free plane and f that of a part which is smooth over the parameters and jumps over the leg angle, as
forces do where a face of the leg begins to lead. Parameters are scaled to their bounds, from -1 to
1. Beyond `FIT_CASES` points hyperparameters are those of maximum evidence on as many of them,
evenly taken; the process is conditioned on all.

Forces on a leg grow several times over the range of a friction angle, and so do the deviations of
a curve from its neighbours. Divided by their size they are close to what a stationary process
describes. The logarithm of the size is a Gaussian process of its own: what is not known of it is an
error that multiplies both forces on the leg alike, at all leg angles.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from terraphi.experiment.arrays import FloatArray
from terraphi.surrogate.kronecker import Kronecker, maximise, single_threaded
from terraphi.surrogate.process import Process, Values
from terraphi.surrogate.training import DENSITY, Training

TREND = 10.0
"""Prior standard deviation of the plane over that of the process [-]: nearly free."""


@dataclass(frozen=True)
class DesignKernel:
    """Hyperparameters; variances are relative to the variance of the values.

    Attributes
    ----------
    lengths
        Correlation length along each parameter, in half widths of its bounds [-].
    theta_length_deg
        Correlation length along the leg angle [deg].
    signal_variance, noise_variance
        sigma^2 and tau^2 [-].
    fine
        f, size of the part that is white over the leg angle [-].
    """

    lengths: tuple[float, ...]
    theta_length_deg: float
    signal_variance: float
    noise_variance: float
    fine: float = 0.0

    def over_points(self, one: FloatArray, other: FloatArray) -> FloatArray:
        """K_x between points, shapes [k, d] and [l, d] -> [k, l]."""
        lag = np.sqrt(5.0 * self.distance2(one, other))
        correlation = (1.0 + lag + np.square(lag) / 3.0) * np.exp(-lag)
        return correlation + TREND**2 * (1.0 + one @ other.T)

    def variance(self, points: FloatArray) -> FloatArray:
        """Diagonal of K_x, shape [k, d] -> [k]."""
        return 1.0 + TREND**2 * (1.0 + np.square(points).sum(axis=1))

    def distance2(self, one: FloatArray, other: FloatArray) -> FloatArray:
        """Squared distances in correlation lengths, shape [k, l]."""
        a, b = one / np.array(self.lengths), other / np.array(self.lengths)
        squares = np.square(a).sum(axis=1)[:, None] + np.square(b).sum(axis=1) - 2.0 * a @ b.T
        return np.maximum(squares, 0.0)

    def slope(self, distance2: FloatArray) -> FloatArray:
        """-2 dc/d(squared distance); times (x_k - y_k)^2 / l_k^2 it is dc/d log l_k."""
        lag = np.sqrt(5.0 * distance2)
        return 5.0 / 3.0 * (1.0 + lag) * np.exp(-lag)

    def over_angles(self, theta_deg: FloatArray) -> FloatArray:
        """K_theta, shape [theta, theta]."""
        smooth = np.exp(-0.5 * np.square((theta_deg[:, None] - theta_deg) / self.theta_length_deg))
        return smooth + self.fine**2 * np.eye(theta_deg.size)

    @staticmethod
    def centre_and_unit(values: FloatArray) -> tuple[FloatArray, float]:
        """Mean at each leg angle, and the standard deviation about it [N]."""
        mean = values.mean(axis=0)
        return mean, float((values - mean).std())

    def gradient(self, known: Kronecker, points: FloatArray, theta_deg: FloatArray) -> FloatArray:
        """Derivative of the log evidence by each logarithm of :meth:`pack`."""
        slope = known.by_entries("left") * self.slope(self.distance2(points, points))
        rows = slope.sum(axis=1)
        found = []
        for k, length in enumerate(self.lengths):
            x = points[:, k] / length
            # sum_ij slope_ij (x_i - x_j)^2 without the matrix of differences.
            found.append(2.0 * float(rows @ np.square(x) - x @ slope @ x))
        by_theta = known.by_entries("right")
        lag2 = np.square((theta_deg[:, None] - theta_deg) / self.theta_length_deg)
        found.append(float(np.sum(by_theta * lag2 * np.exp(-0.5 * lag2))))
        found.append(known.by_signal())
        found.append(2.0 * self.fine**2 * float(np.trace(by_theta)))
        found.append(known.by_noise())
        return np.array(found)

    def pack(self) -> FloatArray:
        """Logarithms of what is fitted: lengths, theta length, sigma^2, f, tau^2."""
        return np.log(
            [
                *self.lengths, self.theta_length_deg, self.signal_variance,
                self.fine, self.noise_variance,
            ]
        )  # fmt: skip

    @classmethod
    def unpack(cls, logarithms: FloatArray) -> DesignKernel:
        """Inverse of :meth:`pack`."""
        *lengths, theta, signal, fine, noise = np.exp(logarithms).tolist()
        return cls(tuple(lengths), theta, signal, noise, fine)


FIT_CASES = 250
"""Points on which hyperparameters are found, at most."""
LENGTHS = (0.05, 40.0)
"""Least and largest correlation length along a parameter, in half widths of its bounds [-]."""
SIGNAL_VARIANCES = (1e-4, 1e5)
NOISE_VARIANCES = (1e-9, 1e1)
FINES = (1e-4, 1e1)


def fit(
    points: ArrayLike, theta_deg: ArrayLike, values: ArrayLike, *, seed: int = 0
) -> Process[DesignKernel]:
    """The process of the hyperparameters of most evidence, conditioned on the values.

    Parameters
    ----------
    points
        Parameters scaled to [-1, 1], at least three points, shape [case, d].
    theta_deg, values
        As in :meth:`Process.condition`.
    seed
        Of the optimiser's random start besides two good guesses.

    Raises
    ------
    ValueError
        If all values are the same.
    """
    with single_threaded():
        data = Values(points, theta_deg, values, DesignKernel)
        if len(data.points) > FIT_CASES:
            even = np.linspace(0, len(data.points) - 1, FIT_CASES).round().astype(int)
            data = Values(data.points[even], theta_deg, data.values[even], DesignKernel)
        kernel = _maximise_evidence(data, seed)
        return Process.condition(points, theta_deg, values, kernel)


def _maximise_evidence(data: Values, seed: int) -> DesignKernel:
    def evidence(logarithms: FloatArray) -> tuple[float, FloatArray]:
        return data.evidence(DesignKernel.unpack(logarithms))

    d = data.points.shape[1]
    # A single leg angle, of a quantity that has none, has no spacing: any will do.
    spacing = float(np.diff(data.theta_deg).min(initial=90.0))
    span = max(float(np.ptp(data.theta_deg)), spacing)
    bounds = [*[LENGTHS] * d, (0.5 * spacing, 10.0 * span), SIGNAL_VARIANCES, FINES]
    bounds.append(NOISE_VARIANCES)
    guesses = [
        np.log([*[length] * d, span / 8.0, 1.0, fine, noise])
        for length, fine, noise in ((2.0, 0.1, 1e-4), (5.0, 0.01, 1e-2))
    ]
    best = maximise(
        evidence, guesses, np.log(bounds), restarts=1, seed=seed,
        ftol=1e-10, gtol=1e-4, maxiter=200,
    )  # fmt: skip
    return DesignKernel.unpack(best)


def fit_size(points: FloatArray, forces: FloatArray, *, seed: int = 0) -> Process[DesignKernel]:
    """Logarithm of the root mean square force; it has no leg angles, or rather one.

    Parameters
    ----------
    points
        Parameters scaled to [-1, 1], shape [case, d].
    forces
        [N], shape [case, force].
    seed
        Of the optimiser's random start.

    Raises
    ------
    ValueError
        If all cases have forces of one size.
    """
    sizes = np.log(np.sqrt(np.mean(np.square(forces), axis=1)))
    return fit(points, [0.0], sizes[:, None], seed=seed)


def _size_at(log_size: Process[DesignKernel], points: FloatArray) -> FloatArray:
    """Size of the forces [N], shape [k, d] -> [k]."""
    return np.exp(log_size.rotated_mean(points)[:, 0] * log_size.basis[0, 0])


@dataclass(frozen=True, eq=False)
class DesignSurrogate:
    """A process for each force on one leg, over named parameters.

    Forces of cohesionless soil are proportional to its density but for what its stiffness does, so
    the processes model forces over density and over their size at the density of the library, and
    both multiply them again: the density may be a parameter whether the library varies it or not.

    Attributes
    ----------
    bounds
        Dotted key of each parameter that the library varies to its bounds.
    reference_density
        Density that stands for itself where none is given [kg/m3].
    log_size
        Process of the logarithm of the forces' size in newtons, at the reference density.
    Fx, Fz
        Processes of the forces over their size [-].
    """

    bounds: Mapping[str, tuple[float, float]]
    reference_density: float
    log_size: Process[DesignKernel]
    Fx: Process[DesignKernel]
    Fz: Process[DesignKernel]

    @classmethod
    def fit(cls, data: Training, *, seed: int = 0) -> Self:
        """Fit a process to each force; errors as in :func:`fit`.

        Parameters
        ----------
        data
            Points and forces.
        seed
            Of the optimiser's random start.
        """
        reference = data.scenario.soil.density
        scaled = data.forces * (reference / data.density)[:, None]
        points = to_unit(data.values, data.bounds)
        log_size = fit_size(points, scaled, seed=seed)
        scaled /= _size_at(log_size, points)[:, None]
        half = data.theta_deg.size
        parts = (scaled[:, :half], scaled[:, half:])
        fx, fz = (fit(points, data.theta_deg, part, seed=seed) for part in parts)
        return cls(data.bounds, reference, log_size, fx, fz)

    @property
    def theta_deg(self) -> FloatArray:
        """Leg angles [deg], shape [theta]."""
        return self.Fx.theta_deg

    @property
    def processes(self) -> tuple[Process[DesignKernel], Process[DesignKernel]]:
        """Those of Fx and Fz."""
        return self.Fx, self.Fz

    def points(self, named: Mapping[str, FloatArray]) -> FloatArray:
        """Scaled points of parameters by key, each of shape [k] -> [k, d].

        Raises
        ------
        KeyError
            If a parameter of the library is missing.
        """
        return to_unit(np.column_stack([named[key] for key in self.bounds]), self.bounds)

    def scale(self, named: Mapping[str, FloatArray]) -> FloatArray:
        """Factor of density and size on what the processes predict [N], shape [k]."""
        return self._relative_density(named) * _size_at(self.log_size, self.points(named))

    def located(self, named: Mapping[str, FloatArray]) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Points, scale, and variance of the factor by which both forces may be wrong alike [-]."""
        points = self.points(named)
        logarithm, variance = self.log_size.predict(points)
        scale = self._relative_density(named) * np.exp(logarithm[:, 0])
        return points, scale, variance[:, 0]

    def _relative_density(self, named: Mapping[str, FloatArray]) -> FloatArray | float:
        density = named.get(DENSITY)
        return 1.0 if density is None else density / self.reference_density

    def slopes(
        self, named: Mapping[str, FloatArray], keys: Sequence[str], steps: Sequence[float]
    ) -> list[FloatArray]:
        """Slopes of each force over some parameters, by central differences, in the basis.

        Parameters
        ----------
        named
            Points: dotted key to values, shape [k] each.
        keys, steps
            Parameters, and the step of each, in its unit.

        Returns
        -------
        list of ndarray
            Of Fx and Fz [N per unit], shape [k, key, theta]; a basis of the leg angles each.
        """
        found: list[list[FloatArray]] = [[], []]
        for key, step in zip(keys, steps, strict=True):
            ends = [{**named, key: named[key] + side * step} for side in (-1.0, 1.0)]
            for process, slopes in zip(self.processes, found, strict=True):
                low, high = (
                    self.scale(end)[:, None] * process.rotated_mean(self.points(end))
                    for end in ends
                )
                slopes.append((high - low) / (2.0 * step))
        return [np.stack(slopes, axis=1) for slopes in found]

    def predict(self, named: Mapping[str, FloatArray]) -> tuple[FloatArray, FloatArray]:
        """Mean [N] and variance [N^2] of the forces, parameters of shape [k] -> [k, 2 theta].

        Parameters
        ----------
        named
            Dotted key to values in the key's own unit; ``soil.density`` may be left out.
        """
        points, scale, factor = self.located(named)
        parts = [process.predict(points) for process in self.processes]
        mean = scale[:, None] * np.hstack([mean for mean, _ in parts])
        variance = np.square(scale)[:, None] * np.hstack([variance for _, variance in parts])
        return mean, variance + factor[:, None] * np.square(mean)


def to_unit(values: FloatArray, bounds: Mapping[str, tuple[float, float]]) -> FloatArray:
    """Parameters scaled from their bounds to [-1, 1], shape [k, d]."""
    low, high = np.array(list(bounds.values())).T
    return 2.0 * (values - low) / (high - low) - 1.0


def from_unit(points: FloatArray, bounds: Mapping[str, tuple[float, float]]) -> FloatArray:
    """Inverse of :func:`to_unit`."""
    low, high = np.array(list(bounds.values())).T
    return low + 0.5 * (points + 1.0) * (high - low)
