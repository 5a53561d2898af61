"""The forces on a leg between the friction angles of a library, as in the paper (Xu & Wang).

Each force component is a Gaussian process of its own over friction angle and leg angle, known on a
full grid of both. Its covariance is the anisotropic squared exponential with white noise,

    K = sigma_f^2 K_phi (x) K_theta + sigma_n^2 I,    (x) the Kronecker product (`kronecker`),

and its hyperparameters are those of maximum marginal likelihood. Values are centred and scaled to
unit variance first, as scikit-learn does with ``normalize_y=True``.

Which wiggle of a force history belongs to the surrogate and which to the residual is a choice, and
it must be made once. The paper's residual covariance has a correlation length of about 6°, that of
the particles' scatter. A surrogate free to follow such short structure learns scatter as if it were
physics: its derivative with respect to phi grows rough, a residual covariance without white noise
weighs just that roughness most, and inversions of fresh simulations land degrees away from the
truth with intervals that exclude it. So the surrogate may not vary over the leg angle faster than
twice the residual's length; results are the same from 10° to 15°.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from terraphi.experiment.arrays import FloatArray
from terraphi.surrogate.kronecker import Kronecker, Posterior, maximise, single_threaded

SHORTEST_THETA_LENGTH_DEG = 12.0
"""Lower bound of the correlation length over the leg angle [deg], twice the residual's 6°."""

# Relative to the variance of the training values. The lower bound of the noise keeps K invertible
# in double precision where a noise-free forward model leaves nothing else to do so.
SIGNAL_VARIANCE_BOUNDS = (1e-3, 1e5)
NOISE_VARIANCE_BOUNDS = (1e-8, 1e1)


@dataclass(frozen=True)
class KernelParameters:
    """Hyperparameters of the kernel; variances are relative to the variance of the values.

    Parameters
    ----------
    signal_variance
        sigma_f^2 [-].
    phi_length_deg, theta_length_deg
        Correlation lengths along the friction angle and the leg angle [deg].
    noise_variance
        sigma_n^2 [-].
    """

    signal_variance: float
    phi_length_deg: float
    theta_length_deg: float
    noise_variance: float


@dataclass(frozen=True, eq=False)
class GridGP:
    """A Gaussian process for one force component on the full phi x theta grid.

    Made by `fit` (hyperparameters of maximum evidence) or `condition` (hyperparameters given).
    Predictions are at the training leg angles. Beyond the training friction angles the process
    returns to the mean of its values: it interpolates, it does not extrapolate.

    Attributes
    ----------
    phi_deg, theta_deg
        Training friction and leg angles [deg], shapes [phi] and [theta].
    parameters
        Hyperparameters; variances relative to ``std**2``.
    log_marginal_likelihood
        Log evidence of the standardised values [-].
    mean, std
        Mean and standard deviation of the training values [N].
    """

    phi_deg: FloatArray
    theta_deg: FloatArray
    parameters: KernelParameters
    log_marginal_likelihood: float
    mean: float
    std: float
    _posterior: Posterior = field(repr=False)
    _mean_weights: FloatArray = field(repr=False)

    @classmethod
    def fit(
        cls,
        phi_deg: ArrayLike,
        theta_deg: ArrayLike,
        values: ArrayLike,
        *,
        shortest_theta_length_deg: float | None = None,
        restarts: int = 3,
        seed: int = 0,
    ) -> Self:
        """Find the hyperparameters of maximum marginal likelihood, and condition on the values.

        L-BFGS-B on the logarithms of the parameters, from one heuristic start and several random
        ones. Correlation lengths lie between half the smallest spacing and ten times the span of
        the training angles.

        Parameters
        ----------
        phi_deg
            Friction angles [deg], at least three, strictly increasing, shape [phi].
        theta_deg
            Leg angles [deg], at least two, strictly increasing, shape [theta].
        values
            Force component [N], shape [phi, theta].
        shortest_theta_length_deg
            Lower bound of the correlation length along the leg angle [deg]; ``None`` for half the
            smallest spacing.
        restarts, seed
            Number of random starts after the heuristic one, and their seed.

        Raises
        ------
        ValueError
            If all values are equal.
        """
        # Threads cost these small matrices far more than they gain, and starve other processes.
        with single_threaded():
            grid = _Grid(phi_deg, theta_deg, values)
            shortest = shortest_theta_length_deg or 0.5 * float(np.diff(grid.theta_deg).min())
            parameters = _maximise_evidence(grid, shortest, restarts=restarts, seed=seed)
            return cls.condition(phi_deg, theta_deg, values, parameters)

    @classmethod
    def condition(
        cls,
        phi_deg: ArrayLike,
        theta_deg: ArrayLike,
        values: ArrayLike,
        parameters: KernelParameters,
    ) -> Self:
        """Condition on the values at given hyperparameters; arguments and errors as in `fit`."""
        grid = _Grid(phi_deg, theta_deg, values)
        known = _Known(grid, parameters)
        posterior = known.posterior()
        return cls(
            phi_deg=grid.phi_deg,
            theta_deg=grid.theta_deg,
            parameters=parameters,
            log_marginal_likelihood=known.log_evidence(),
            mean=grid.mean,
            std=grid.std,
            _posterior=posterior,
            # Leg angles never change, so the way back from the basis folds into the weights.
            _mean_weights=grid.std * (posterior.mean_weights @ posterior.basis.T),
        )

    @property
    def noise_std(self) -> float:
        """Standard deviation of the white noise [N]: the scatter of the library itself."""
        return self.std * float(np.sqrt(self.parameters.noise_variance))

    def predict(self, phi_deg: ArrayLike) -> FloatArray:
        """Mean of the force at the training leg angles [N], shape [k] -> [k, theta]."""
        return self.mean + self._across(phi_deg) @ self._mean_weights

    def predict_variance(self, phi_deg: ArrayLike) -> FloatArray:
        """Variance of the force `predict`, without the white noise [N^2], same shape."""
        across = self._across(phi_deg)
        variance = self._posterior.variance(across, np.ones(len(across)))
        return self.std**2 * (variance @ np.square(self._posterior.basis.T))

    def _across(self, phi_deg: ArrayLike) -> FloatArray:
        """Correlation over phi with the training angles [-], shape [k, phi]."""
        phi = np.atleast_1d(np.asarray(phi_deg, dtype=np.float64))
        distance = (phi[:, None] - self.phi_deg) / self.parameters.phi_length_deg
        return np.exp(-0.5 * np.square(distance))


class _Grid:
    """Training data, standardised to zero mean and unit variance."""

    def __init__(self, phi_deg: ArrayLike, theta_deg: ArrayLike, values: ArrayLike) -> None:
        self.phi_deg = phi = np.array(phi_deg, dtype=np.float64)
        self.theta_deg = theta = np.array(theta_deg, dtype=np.float64)
        grid = np.array(values, dtype=np.float64)
        self.mean, self.std = float(grid.mean()), float(grid.std())
        if np.ptp(grid) == 0.0:
            raise ValueError(f"all values equal {self.mean:g}; they must vary over the grid")
        self.standardised = (grid - self.mean) / self.std
        self.distances2 = [np.square(angles[:, None] - angles) for angles in (phi, theta)]

    def evidence(self, logarithms: FloatArray) -> tuple[float, FloatArray]:
        """Log evidence and its gradient by the logarithm of each of `KernelParameters`."""
        known = _Known(self, KernelParameters(*np.exp(logarithms).tolist()))
        return known.log_evidence(), known.gradient()


class _Known(Kronecker):
    """The standardised values with their covariance."""

    def __init__(self, grid: _Grid, parameters: KernelParameters) -> None:
        # Squared exponentials (R & W eq. 4.9), and their derivatives by log length.
        lengths_deg = (parameters.phi_length_deg, parameters.theta_length_deg)
        pairs = list(zip(grid.distances2, lengths_deg, strict=True))
        left, right = (np.exp(-0.5 * distance2 / length**2) for distance2, length in pairs)
        self.slopes = [
            factor * distance2 / length**2
            for factor, (distance2, length) in zip((left, right), pairs, strict=True)
        ]
        super().__init__(
            left,
            right,
            grid.standardised,
            signal=parameters.signal_variance,
            noise=parameters.noise_variance,
        )

    def gradient(self) -> FloatArray:
        """By the logarithm of each of `KernelParameters`."""
        by_phi, by_theta = self.slopes
        along = self.along("left", by_phi), self.along("right", by_theta)
        return np.array([self.by_signal(), *along, self.by_noise()])


def _maximise_evidence(
    grid: _Grid, shortest_theta_length_deg: float, *, restarts: int, seed: int
) -> KernelParameters:
    angles = (grid.phi_deg, grid.theta_deg)
    shortest = (0.5 * np.diff(grid.phi_deg).min(), shortest_theta_length_deg)
    lengths = [(low, 10.0 * np.ptp(a)) for low, a in zip(shortest, angles, strict=True)]
    # Forces vary slowly with phi and over some tens of degrees with theta; little of it is noise.
    heuristic = np.log([1.0, np.ptp(angles[0]) / 2.0, np.ptp(angles[1]) / 8.0, 1e-3])
    best = maximise(
        grid.evidence,
        [heuristic],
        np.log([SIGNAL_VARIANCE_BOUNDS, *lengths, NOISE_VARIANCE_BOUNDS]),
        restarts=restarts,
        seed=seed,
        ftol=1e-13,
        gtol=1e-6,
    )
    return KernelParameters(*np.exp(best).tolist())


@dataclass(frozen=True, eq=False)
class LegSurrogate:
    """The forces on one leg as a function of the friction angle, a process for each component.

    Its observation vectors are d = [Fx(theta_1..m), Fz(theta_1..m)], the order of the paper.
    """

    Fx: GridGP
    Fz: GridGP

    @classmethod
    def fit(
        cls,
        phi_deg: ArrayLike,
        theta_deg: ArrayLike,
        Fx: ArrayLike,
        Fz: ArrayLike,
        *,
        shortest_theta_length_deg: float = SHORTEST_THETA_LENGTH_DEG,
        restarts: int = 3,
        seed: int = 0,
    ) -> Self:
        """Fit a process to each component.

        Parameters
        ----------
        phi_deg, theta_deg
            Friction and leg angles [deg], shapes [phi] and [theta].
        Fx, Fz
            Forward and upward force of the soil on the leg [N], shape [phi, theta].
        shortest_theta_length_deg, restarts, seed
            As in `GridGP.fit`.

        Raises
        ------
        ValueError
            As in `GridGP.fit`.
        """
        fx, fz = (
            GridGP.fit(
                phi_deg,
                theta_deg,
                force,
                shortest_theta_length_deg=shortest_theta_length_deg,
                restarts=restarts,
                seed=seed,
            )
            for force in (Fx, Fz)
        )
        return cls(Fx=fx, Fz=fz)

    @property
    def theta_deg(self) -> FloatArray:
        """Leg angles of a prediction [deg], shape [theta]."""
        return self.Fx.theta_deg

    @property
    def phi_bounds_deg(self) -> tuple[float, float]:
        """Smallest and largest training friction angle [deg]."""
        return float(self.Fx.phi_deg[0]), float(self.Fx.phi_deg[-1])

    @property
    def phi_step_deg(self) -> float:
        """Largest spacing of the training friction angles [deg]."""
        return float(np.diff(self.Fx.phi_deg).max())

    def predict(self, phi_deg: ArrayLike, *, scale: float = 1.0) -> FloatArray:
        """Mean observation vectors [N], shape [k] -> [k, 2 theta].

        Parameters
        ----------
        phi_deg
            Friction angles [deg], shape [k].
        scale
            Factor on the forces [-], such as the soil's density over the library's.
        """
        return scale * np.hstack([self.Fx.predict(phi_deg), self.Fz.predict(phi_deg)])

    def predict_variance(self, phi_deg: ArrayLike) -> FloatArray:
        """Variance of the latent forces of `predict` [N^2], shape [k] -> [k, 2 theta]."""
        return np.hstack([gp.predict_variance(phi_deg) for gp in (self.Fx, self.Fz)])
