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

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from terraphi.experiment.arrays import FloatArray
from terraphi.surrogate.kronecker import Kronecker, maximise, single_threaded
from terraphi.surrogate.process import Process, Values

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

    def over_points(self, one: FloatArray, other: FloatArray) -> FloatArray:
        """K_phi between friction angles [deg], shapes [k, 1] and [l, 1] -> [k, l]."""
        return np.exp(-0.5 * np.square(one - other.T) / self.phi_length_deg**2)

    def variance(self, points: FloatArray) -> FloatArray:
        """Diagonal of K_phi, shape [k, 1] -> [k]."""
        return np.ones(len(points))

    def over_angles(self, theta_deg: FloatArray) -> FloatArray:
        """K_theta, shape [theta, theta]."""
        return np.exp(-0.5 * np.square(theta_deg[:, None] - theta_deg) / self.theta_length_deg**2)

    @staticmethod
    def centre_and_unit(values: FloatArray) -> tuple[FloatArray, float]:
        """Mean and standard deviation of all values [N], the mean for each leg angle alike."""
        return np.full(values.shape[1], values.mean()), float(values.std())

    def gradient(self, known: Kronecker, points: FloatArray, theta_deg: FloatArray) -> FloatArray:
        """Derivative of the log evidence by the logarithm of each hyperparameter."""
        over_phi, over_theta = self.over_points(points, points), self.over_angles(theta_deg)
        phi2, theta2 = np.square(points - points.T), np.square(theta_deg[:, None] - theta_deg)
        by_phi = known.along("left", over_phi * phi2 / self.phi_length_deg**2)
        by_theta = known.along("right", over_theta * theta2 / self.theta_length_deg**2)
        return np.array([known.by_signal(), by_phi, by_theta, known.by_noise()])


def fit(
    phi_deg: ArrayLike,
    theta_deg: ArrayLike,
    values: ArrayLike,
    *,
    shortest_theta_length_deg: float = SHORTEST_THETA_LENGTH_DEG,
    restarts: int = 3,
) -> Process[KernelParameters]:
    """The process of the hyperparameters of most evidence, conditioned on the values.

    L-BFGS-B on the logarithms of the parameters, from one heuristic start and several random ones.
    Correlation lengths are at most ten times the span of the training angles, and that over the
    friction angle at least half their smallest spacing. Beyond these angles the process returns to
    the mean of its values: it interpolates, it does not extrapolate.

    Parameters
    ----------
    phi_deg, theta_deg
        Friction angles, at least three, and leg angles [deg], increasing, shapes [phi] and [theta].
    values
        Force [N], shape [phi, theta].
    shortest_theta_length_deg
        Lower bound of the correlation length along the leg angle [deg].
    restarts
        Number of random starts.

    Raises
    ------
    ValueError
        If all values are the same.
    """

    def evidence(logarithms: FloatArray) -> tuple[float, FloatArray]:
        return data.evidence(KernelParameters(*np.exp(logarithms).tolist()))

    with single_threaded():
        phi = np.asarray(phi_deg, dtype=np.float64)
        data = Values(phi[:, None], theta_deg, values, KernelParameters)
        spans = np.ptp(phi), np.ptp(data.theta_deg)
        shortest = (0.5 * np.diff(phi).min(), shortest_theta_length_deg)
        lengths = [(low, 10.0 * span) for low, span in zip(shortest, spans, strict=True)]
        # Forces vary slowly with phi and over some tens of degrees with theta; little is noise.
        heuristic = np.log([1.0, spans[0] / 2.0, spans[1] / 8.0, 1e-3])
        bounds = np.log([SIGNAL_VARIANCE_BOUNDS, *lengths, NOISE_VARIANCE_BOUNDS])
        best = maximise(evidence, [heuristic], bounds, restarts=restarts, ftol=1e-13, gtol=1e-6)
        kernel = KernelParameters(*np.exp(best).tolist())
        return Process.condition(phi[:, None], theta_deg, values, kernel)


@dataclass(frozen=True, eq=False)
class LegSurrogate:
    """The forces on one leg as a function of the friction angle, a process for each component.

    Its observation vectors are d = [Fx(theta_1..m), Fz(theta_1..m)], the order of the paper.
    """

    Fx: Process[KernelParameters]
    Fz: Process[KernelParameters]

    @classmethod
    def fit(
        cls,
        phi_deg: ArrayLike,
        theta_deg: ArrayLike,
        Fx: ArrayLike,
        Fz: ArrayLike,
        **options: Any,
    ) -> Self:
        """Fit a process to each component.

        Parameters
        ----------
        phi_deg, theta_deg
            Friction and leg angles [deg], shapes [phi] and [theta].
        Fx, Fz
            Forward and upward force of the soil on the leg [N], shape [phi, theta].
        options
            As in :func:`fit`, whose errors are raised.
        """
        return cls(*(fit(phi_deg, theta_deg, force, **options) for force in (Fx, Fz)))

    @property
    def phi_deg(self) -> FloatArray:
        """Training friction angles [deg], shape [phi]."""
        return self.Fx.points[:, 0]

    @property
    def theta_deg(self) -> FloatArray:
        """Leg angles of a prediction [deg], shape [theta]."""
        return self.Fx.theta_deg

    @property
    def phi_bounds_deg(self) -> tuple[float, float]:
        """Smallest and largest training friction angle [deg]."""
        return float(self.phi_deg[0]), float(self.phi_deg[-1])

    def predict(self, phi_deg: ArrayLike, *, scale: float = 1.0) -> FloatArray:
        """Mean observation vectors [N], shape [k] -> [k, 2 theta].

        Parameters
        ----------
        phi_deg
            Friction angles [deg], shape [k].
        scale
            Factor on the forces [-], such as the soil's density over the library's.
        """
        phi = np.atleast_1d(np.asarray(phi_deg, dtype=np.float64))[:, None]
        return scale * np.hstack([gp.rotated_mean(phi) @ gp.basis.T for gp in (self.Fx, self.Fz)])

    def predict_variance(self, phi_deg: ArrayLike) -> FloatArray:
        """Variance of the latent forces of `predict` [N^2], shape [k] -> [k, 2 theta]."""
        phi = np.atleast_1d(np.asarray(phi_deg, dtype=np.float64))[:, None]
        return np.hstack([gp.predict(phi)[1] for gp in (self.Fx, self.Fz)])
