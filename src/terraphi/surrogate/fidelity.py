"""What finer simulations of a few angles make of a library's forces: a second fidelity.

A library is computed with cells of one size h, or a motion sped up by k, and its forces have an
error that falls with h or with k - 1. At some friction angles there are finer simulations. The
coarse forces are g (`joint`), and the forces of the finest (Kennedy & O'Hagan, *Biometrika* 87:1,
2000)

    g_f(phi, theta) = g(phi, theta) + a g(phi, theta) + s(phi) delta(phi, theta),

a the *level*, a factor of each force, of prior N(0, LEVEL^2), which is wide; s the peak-to-peak of
each force; delta a process of mean zero, Matern over phi, Matern and a white part over theta (the
ripple of one grid beside another's), times a profile: no correction where the leg is in no soil. A
fine curve less the coarse mean has besides the error of that mean, as the surrogate knows it, and
particle scatter of its own, of the coarse size times a factor.

**Extrapolation.** An error c h^p is left by the share r^p in a curve of h_f = r h, so that the
limit is g + w (g_f - g), w = 1 / (1 - r^p); of the speed-up r = (k_f - 1) / (k - 1). The order p is
1 as far as anyone has measured, and may lie between 1/2 and 2: each of ORDERS has the same prior
probability. It is one for all angles and both forces. With one fine size the curves cannot tell
orders apart; with more they do, by their evidence. The mean is that of the most probable order, of
equal ones the nearest to 1. The covariance has that of each order and, of one sign at all angles,
how far its mean lies from ours:

    sum_p pi_p (w_p^2 P_p + (w_p m_p - w m) (w_p m_p - w m)^T).

**Few curves.** Three to five say little of hyperparameters: these are those of most posterior
density under the log-normal priors of PRIORS, within limits. The orders and the level are
integrated out.

**A leg without fine curves** has the level of another leg, since a force that is too high by a
tenth on one leg is likely to be so on the next; of the shape over theta, which goes with the leg's
own, it has the prior. All its standard deviations are twice that (WIDER).

The correction's error is taken as independent of the coarse surrogate's, whose scatter it corrects
in part: variances come out a little too large (by less than twice the interpolation and the
library's scatter).

The number of fine curves is small and each has a scatter of its own, so that the covariance is no
Kronecker product; its algebra is dense, its hyperparameters found as those of all surrogates
(`kronecker.maximise`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.library.finer import FineCurves
from terraphi.surrogate.joint import JointSurrogate, matern, smoothing, window_spans
from terraphi.surrogate.kronecker import maximise, single_threaded

ORDERS = 2.0 ** np.linspace(-1.0, 1.0, 25)
"""Orders p of convergence [-]."""
COARSELY = 3
"""Every how many of them are looked at first, if there are several fine sizes; if those that count
are as few, those in between are too."""
LEVEL = 0.5
"""Prior standard deviation of the level [-]."""
WIDER = 2.0
"""Factor on the standard deviations of a leg without fine curves [-]."""
LEAST_PROFILE = 0.05
"""Least profile over its largest [-]."""
PRIORS = {
    "amplitude": (0.05, 3.0, 0.002, 0.5),
    "phi_length_deg": (20.0, 1.6, 8.0, 60.0),
    "theta_length_deg": (20.0, 1.6, 4.0, 60.0),
    "fine": (0.1, 2.0, 0.01, 1.0),
    "scatter": (1.0, 1.5, 0.2, 5.0),
}
"""Of each hyperparameter median and factor of one standard deviation, and least and largest."""
STEP = 1e-4
"""Of logarithms of hyperparameters, for derivatives."""
NEGLIGIBLE = 1e-4
"""Probability of an order that is left out [-]."""


@dataclass(frozen=True)
class FidelityKernel:
    """Hyperparameters.

    Attributes
    ----------
    amplitude
        Standard deviation of delta where the profile is 1 [-].
    phi_length_deg, theta_length_deg
        Its correlation lengths [deg].
    fine
        Standard deviation of its part that is white over theta, over that of the smooth part [-].
    scatter
        Standard deviation of a fine curve's scatter over that of a coarse one [-].
    """

    amplitude: float = PRIORS["amplitude"][0]
    phi_length_deg: float = PRIORS["phi_length_deg"][0]
    theta_length_deg: float = PRIORS["theta_length_deg"][0]
    fine: float = PRIORS["fine"][0]
    scatter: float = PRIORS["scatter"][0]


class _Limit(NamedTuple):
    """The correction if the order is one of ORDERS."""

    order: float
    log_evidence: float
    factor: float
    """w [-]."""
    share: FloatArray
    """Of the finest curves' difference that each row has [-], shape [row 2 theta]."""
    cholesky: FloatArray
    """Of the rows' covariance."""
    weights: FloatArray
    """Inverse of that times the rows [1/N]."""
    level: FloatArray
    """Posterior mean of the level [-], shape [2]."""


@dataclass(frozen=True, eq=False)
class Correction:
    """What is to be added to a leg's coarse forces for one cause: the grid or the speed-up.

    A row is one fine curve; forces are observation vectors [Fx, Fz].

    Attributes
    ----------
    theta_deg, profile
        Leg angles [deg], shape [theta], and how delta varies over them [-], shape [2 theta].
    phi_deg, ratio
        Friction angle [deg] and r [-] of each row, shape [row].
    forces, differences
        Coarse forces there, and what the fine ones have beside them [N], shape [row, 2 theta].
    own, shared
        Covariance of the coarse scatter over the simulations that a row is the mean of, and of
        the coarse mean [N^2], shape [row, 2 theta, 2 theta].
    finest
        Smallest r [-].
    kernel
        Hyperparameters.
    level_mean, level_covariance
        Of the level a priori [-], shapes [2] and [2, 2].
    order_evidence
        Log evidence of ORDERS from elsewhere [-].
    widened
        Factor on all standard deviations [-].
    """

    theta_deg: FloatArray
    profile: FloatArray
    phi_deg: FloatArray
    ratio: FloatArray
    forces: FloatArray
    differences: FloatArray
    own: FloatArray
    shared: FloatArray
    finest: float
    kernel: FidelityKernel = field(default_factory=FidelityKernel)
    level_mean: FloatArray = field(default_factory=lambda: np.zeros(2))
    level_covariance: FloatArray = field(default_factory=lambda: LEVEL**2 * np.eye(2))
    order_evidence: FloatArray = field(default_factory=lambda: np.zeros(ORDERS.size))
    widened: float = 1.0

    @classmethod
    def of(
        cls, coarse: JointSurrogate, fine: FineCurves, kernel: FidelityKernel | None = None
    ) -> Self:
        """From fine curves beside the surrogate of the coarse ones.

        Parameters
        ----------
        coarse
            Without a correction.
        fine
            At least one.
        kernel
            Hyperparameters; ``None`` finds them.
        """
        forces = coarse.predict(fine.phi_deg)
        scatter = [coarse.scatter.covariance(phi) for phi in fine.phi_deg.tolist()]
        made = cls(
            theta_deg=coarse.theta_deg,
            profile=profile_of(coarse.theta_deg, coarse.predict(coarse.phi_deg)),
            phi_deg=fine.phi_deg,
            ratio=fine.ratio,
            forces=forces,
            differences=fine.forces - forces,
            own=np.stack(scatter) / fine.repeats[:, None, None],
            shared=np.stack([coarse.covariance(phi) for phi in fine.phi_deg.tolist()]),
            finest=float(fine.ratio.min()),
            kernel=kernel or FidelityKernel(),
        )
        return made if kernel else made.fitted()

    def fitted(self) -> Self:
        """The same with the hyperparameters of most posterior density."""
        table = np.log(list(PRIORS.values()))
        median, sd = table[:, 0], table[:, 1]

        def density(logarithms: FloatArray) -> tuple[float, FloatArray]:
            apart = (logarithms - median) / sd
            value, slope = self._evidence(logarithms)
            return value - 0.5 * float(apart @ apart), slope - apart / sd

        with single_threaded():
            best = maximise(density, [median], table[:, 2:], ftol=1e-8)
        return replace(self, kernel=FidelityKernel(*np.exp(best).tolist()))

    def _evidence(self, logarithms: FloatArray) -> tuple[float, FloatArray]:
        """Log evidence at the first order, and its gradient."""
        share, rows = self._share(1.0), self.differences.ravel()
        covariance = self._covariance(logarithms, share)
        inverse = np.linalg.inv(covariance)
        weights = inverse @ rows
        steps = STEP * np.eye(logarithms.size)
        slope = []
        for step in steps:
            ahead, back = (self._covariance(logarithms + d, share) for d in (step, -step))
            change = (ahead - back) / (2.0 * STEP)
            slope.append(0.5 * float(weights @ change @ weights - np.sum(inverse * change)))
        volume = float(np.linalg.slogdet(covariance)[1])
        return -0.5 * (float(rows @ weights) + volume), np.array(slope)

    def _covariance(self, logarithms: FloatArray, share: FloatArray) -> FloatArray:
        """Of the rows at logarithms of hyperparameters [N^2], [row 2 theta, row 2 theta]."""
        given = replace(self, kernel=FidelityKernel(*np.exp(logarithms).tolist()))
        return given._of_rows(share)

    def _of_rows(self, share: FloatArray) -> FloatArray:
        n, size = self.differences.shape
        found = share[:, None] * self._between(self.phi_deg, self.forces) * share
        blocks = found.reshape(n, size, n, size)
        for i in range(n):
            blocks[i, :, i] += self.kernel.scatter**2 * self.own[i]
            # Fine curves of one angle are compared with the same coarse mean.
            for j in np.flatnonzero(self.phi_deg == self.phi_deg[i]).tolist():
                blocks[i, :, j] += self.shared[i]
        return found

    def _share(self, order: float) -> FloatArray:
        """What each row has of the finest's difference [-], shape [row 2 theta]."""
        shares = (1.0 - self.ratio**order) / (1.0 - self.finest**order)
        return np.repeat(shares, self.profile.size)

    @cached_property
    def _correlation(self) -> FloatArray:
        """Of delta over theta and the two forces, over the profile [-], [2 theta, 2 theta]."""
        smooth = matern(self.theta_deg, self.theta_deg, self.kernel.theta_length_deg)
        white = self.kernel.fine**2 * np.eye(self.theta_deg.size)
        return np.kron(np.eye(2), smooth + white).astype(np.float64)

    def _between(self, phi_deg: FloatArray, forces: FloatArray) -> FloatArray:
        """Prior covariance with the rows [N^2], shape [k 2 theta, row 2 theta]."""
        over_phi = matern(phi_deg, self.phi_deg, self.kernel.phi_length_deg)
        one, other = self._sizes(forces), self._sizes(self.forces)
        smooth = over_phi[:, None, :, None] * one[:, :, None, None] * other
        smooth *= self._correlation[None, :, None, :]
        of_level = _by_force(forces) @ self.level_covariance @ _by_force(self.forces).T
        covariance: FloatArray = smooth.reshape(of_level.shape) + of_level
        return covariance

    def _sizes(self, forces: FloatArray) -> FloatArray:
        """Standard deviation of s delta [N], [k, 2 theta] -> the same."""
        return self.kernel.amplitude * window_spans(forces) * self.profile

    @cached_property
    def _limits(self) -> tuple[_Limit, ...]:
        """What each order says that is not negligible, those of most evidence first."""
        every, known = range(ORDERS.size), {}

        def limits(indices: Iterable[int]) -> list[_Limit]:
            found = []
            for i in indices:
                order, share = float(ORDERS[i]), self._share(float(ORDERS[i]))
                if share.tobytes() not in known:
                    known[share.tobytes()] = self._conditioned(share)
                evidence, *rest = known[share.tobytes()]
                told = float(self.order_evidence[i]) + evidence
                factor = 1.0 / (1.0 - self.finest**order)
                found.append(_Limit(order, told, factor, share, *rest))
            return found

        # Without a second fine size all orders have one decomposition; else each is large.
        several = np.unique(self.ratio).size > 1
        found = limits(every[::COARSELY] if several else every)
        probability = _probability(found)
        if several and np.square(probability).sum() > 1.0 / COARSELY:
            near = COARSELY * int(probability.argmax())
            found = limits(every[max(near - 2 * COARSELY, 0) : near + 2 * COARSELY + 1])
            probability = _probability(found)
        pairs = zip(found, probability, strict=True)
        kept = [one for one, share in pairs if share > NEGLIGIBLE]
        # Orders that explain the curves alike differ by round-off.
        return tuple(sorted(kept, key=lambda x: (-round(x.log_evidence, 6), abs(np.log(x.order)))))

    def _conditioned(self, share: FloatArray) -> tuple[float, FloatArray, FloatArray, FloatArray]:
        """Log evidence, and what follows of the rows; see :class:`_Limit`."""
        with single_threaded():
            factor = np.linalg.cholesky(self._of_rows(share)).astype(np.float64)
            by_force = share[:, None] * _by_force(self.forces)
            rows = self.differences.ravel() - by_force @ self.level_mean
            white = _whitened(factor, rows)
            weights = _whitened(factor, white, transposed=True)
        evidence = -0.5 * float(white @ white) - float(np.log(np.diag(factor)).sum())
        level: FloatArray = self.level_mean + self.level_covariance @ (by_force.T @ weights)
        return evidence, factor, weights, level

    @cached_property
    def order_probability(self) -> FloatArray:
        """Of each order that is not negligible, most probable first [-]."""
        return _probability(self._limits)

    def mean(self, phi_deg: FloatArray, forces: FloatArray) -> FloatArray:
        """Correction at friction angles [N], shape [k] -> [k, 2 theta].

        Parameters
        ----------
        phi_deg
            Friction angles [deg].
        forces
            Coarse forces there [N], shape [k, 2 theta].
        """
        best = self._limits[0]
        found: FloatArray = best.factor * self._mean(best, phi_deg, forces)
        return found

    def _mean(self, limit: _Limit, phi_deg: FloatArray, forces: FloatArray) -> FloatArray:
        """Mean difference of the finest curves [N]."""
        weights = (limit.share * limit.weights).reshape(self.forces.shape)
        shapes = (self._sizes(self.forces) * weights) @ self._correlation
        over_phi = matern(phi_deg, self.phi_deg, self.kernel.phi_length_deg)
        by_level = forces * np.repeat(limit.level, self.theta_deg.size)
        return by_level + self._sizes(forces) * (over_phi @ shapes)

    def covariance(self, phi_deg: FloatArray, forces: FloatArray) -> FloatArray:
        """Covariance of its error [N^2], shape [k] -> [k, 2 theta, 2 theta]; as :meth:`mean`."""
        size, mean = self.profile.size, self.mean(phi_deg, forces)
        sizes, between = self._sizes(forces), self._between(phi_deg, forces)
        by_force = _by_force(forces).reshape(-1, size, 2)
        prior = sizes[:, :, None] * self._correlation * sizes[:, None, :]
        prior += by_force @ self.level_covariance @ by_force.transpose(0, 2, 1)
        total, explained = np.zeros_like(prior), {}
        for limit, probability in zip(self._limits, self.order_probability, strict=True):
            key = limit.share.tobytes()
            if key not in explained:
                with single_threaded():
                    white = _whitened(limit.cholesky, (between * limit.share).T)
                white = white.reshape(len(white), len(phi_deg), size)
                explained[key] = white.transpose(1, 2, 0) @ white.transpose(1, 0, 2)
            apart = limit.factor * self._mean(limit, phi_deg, forces) - mean
            total += probability * limit.factor**2 * (prior - explained[key])
            total += probability * apart[:, :, None] * apart[:, None, :]
        return self.widened**2 * total

    def for_leg(self, coarse: JointSurrogate) -> Self:
        """What it says of a leg without fine curves.

        Parameters
        ----------
        coarse
            That leg's surrogate, without a correction.
        """
        best = self._limits[0]
        by_force = best.share[:, None] * _by_force(self.forces)
        white = _whitened(best.cholesky, by_force @ self.level_covariance)
        none = np.zeros((0, 2 * coarse.theta_deg.size))
        by_order = {one.order: one.log_evidence for one in self._limits}
        return replace(
            self,
            theta_deg=coarse.theta_deg,
            profile=profile_of(coarse.theta_deg, coarse.predict(coarse.phi_deg)),
            phi_deg=np.zeros(0),
            ratio=np.zeros(0),
            forces=none,
            differences=none,
            level_mean=best.level,
            level_covariance=self.level_covariance - white.T @ white,
            order_evidence=np.array([by_order.get(p, -np.inf) for p in ORDERS.tolist()]),
            widened=WIDER,
        )

    def as_dict(self) -> dict[str, float]:
        """Hyperparameters, as plain numbers."""
        return asdict(self.kernel)


@dataclass(frozen=True, eq=False)
class Refinement:
    """Corrections of a leg by cause, which err independently."""

    parts: Mapping[str, Correction]

    def mean(self, phi_deg: FloatArray, forces: FloatArray) -> FloatArray:
        """As of :meth:`Correction.mean` [N]."""
        return sum((one.mean(phi_deg, forces) for one in self.parts.values()), 0.0 * forces)

    def widened(self, factor: float) -> Refinement:
        """The same with standard deviations times a factor [-]."""
        each = self.parts.items()
        return Refinement({c: replace(one, widened=factor * one.widened) for c, one in each})

    def covariances(self, phi_deg: FloatArray, forces: FloatArray) -> dict[str, FloatArray]:
        """As of :meth:`Correction.covariance` [N^2], of each cause."""
        return {cause: one.covariance(phi_deg, forces) for cause, one in self.parts.items()}

    def covariance(self, phi_deg: FloatArray, forces: FloatArray) -> FloatArray:
        """Of all causes together [N^2]."""
        found: FloatArray = np.sum(list(self.covariances(phi_deg, forces).values()), axis=0)
        return found


def _probability(limits: Sequence[_Limit]) -> FloatArray:
    """Of each order, by the evidence [-]."""
    evidence = np.array([one.log_evidence for one in limits])
    probability: FloatArray = np.exp(evidence - evidence.max())
    probability /= probability.sum()
    return probability


def profile_of(theta_deg: FloatArray, forces: FloatArray) -> FloatArray:
    """Root mean square of both forces over their peak-to-peak, smoothed, 1 at most [-], [2 theta].

    Parameters
    ----------
    theta_deg
        Leg angles [deg], shape [theta].
    forces
        Of a library [N], shape [case, 2 theta].
    """
    kernel = smoothing(np.square(theta_deg[:, None] - theta_deg))
    relative = (forces / window_spans(forces)).reshape(-1, 2, theta_deg.size)
    squares = kernel @ np.square(relative).mean(axis=(0, 1))
    profile = np.maximum(np.sqrt(squares / squares.max()), LEAST_PROFILE)
    return np.tile(profile, 2)


def _whitened(cholesky: FloatArray, values: FloatArray, *, transposed: bool = False) -> FloatArray:
    """Inverse of a lower triangle, or of its transpose, times values."""
    from scipy.linalg import solve_triangular

    if not values.size:
        return values
    found: FloatArray = solve_triangular(cholesky, values, lower=True, trans=int(transposed))
    return found


def _by_force(forces: FloatArray) -> FloatArray:
    """Forces times what a unit level adds to each, shape [k, 2 theta] -> [k 2 theta, 2]."""
    of_x = np.repeat([1.0, 0.0], forces.shape[1] // 2)
    return (forces[:, :, None] * np.stack([of_x, 1.0 - of_x], axis=1)).reshape(forces.size, 2)
