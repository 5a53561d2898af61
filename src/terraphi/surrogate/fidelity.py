"""What finer simulations of a few angles make of a library's forces: a second fidelity.

A library is computed with cells of one size h, or a motion sped up by k, and its forces have an
error that vanishes with h or with k - 1. At some friction angles there are finer simulations. With
r the size of a fine one over the library's, (k_f - 1) / (k - 1) of the speed-up, the library's
forces g (`joint`) and those of a fine curve are (after Kennedy & O'Hagan, *Biometrika* 87:1, 2000)

    limit   = g + sum_p c_p                + ripple_1
    g_f(r)  = g + sum_p (1 - r^p) c_p      + ripple_1 - ripple_r,

one c_p for each of POWERS, which have a part of their prior in common:

    c_p(phi, theta) = a_p(phi) g(phi, theta) + s(phi) delta_p(phi, theta),

a the *level*, a factor of each force, in part one for all friction angles and in part a process
over them; s the peak-to-peak of each force; delta a process of mean zero, Matern over phi and
theta, times a profile: no correction where the leg is in no soil. A ripple is what one grid or
speed shows beside another that is no power of the size: an offset, a factor of each force that goes
over phi as the level does, and a part that is Matern over phi and white over theta.
A fine curve less the coarse mean has besides the error of that mean, as the surrogate knows it, and
particle scatter of its own, of the coarse size times a factor.

**Which power?** An error c h^p alone would leave the limit at 1 / (1 - r^p) times the finest
curve's difference. No one has measured p, a second fine size tells it badly (errors of h and of
h^2 may cancel: `tip_inset_cells` is there to do so), and one that is taken for certain makes
intervals too narrow. A sum of powers needs no such choice: at half the size the limit is 1.98 times
the difference (2 for p = 1), give or take two fifths of that. The share ALIKE of the c_p's variance
is of one process that all have, for errors seldom cancel, the rest of one for each power, with
variances as WEIGHTS. An error that goes with the square root alone is at two to three standard
deviations.

**Few curves.** Three to five say little of hyperparameters: these are those of most posterior
density under the log-normal priors of PRIORS, within limits. That they are not certain is FEW, a
factor on all standard deviations, and more of it for a leg without any curves.

**A leg without fine curves** has as its level the mean factor that the correction is of another
leg's forces, for a force that is too high by a tenth on one leg is likely to be so on the next. Of
all else it has the prior, with WIDER in place of FEW: legs differ.

**Two causes.** The corrections for cells and for the speed-up are added. An error that goes with
the product of the two would be counted in both; so the smaller of the two, where they have one
sign, is an uncertainty besides (:class:`Refinement`).

The correction's error is taken as independent of the coarse surrogate's, which it corrects in part.
With an error e of the coarse mean the corrected forces have (1 - w) e, w the share of the finest
difference that the limit is; (1 + w^2) var e is counted, more than (1 - w)^2 var e.

The number of fine curves is small and each has a scatter of its own, so that the covariance is no
Kronecker product; its algebra is dense, its hyperparameters found as those of all surrogates
(`kronecker.maximise`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.scenario import Scenario
from terraphi.library.finer import FineCurves
from terraphi.surrogate.joint import JointSurrogate, matern, smoothing, window_spans
from terraphi.surrogate.kronecker import maximise, single_threaded

POWERS, WEIGHTS = np.array([0.5, 1.0, 2.0]), np.array([0.5, 0.25, 0.25])
"""Powers p of the size with which errors vanish [-], and their shares of the prior variance."""
ALIKE = 0.4
"""Share of that variance which the powers have in common: errors seldom cancel [-]."""
CONSTANT = 0.3
"""Share of the level's variance that is one for all friction angles [-]."""
LEVEL_LENGTH_DEG = 20.0
"""Correlation length of the rest [deg]."""
FEW, WIDER = 1.25, 2.0
"""Factors on the standard deviations of a leg with fine curves, and of one without [-]."""
LEAST_PROFILE = 0.05
"""Least profile over its largest [-]."""
Prior = tuple[float, float, float, float]
PRIORS: Mapping[str, Prior] = {
    "level": (0.1, 2.5, 0.01, 0.5),
    "amplitude": (0.05, 3.0, 0.002, 0.5),
    "phi_length_deg": (20.0, 1.6, 8.0, 60.0),
    "theta_length_deg": (20.0, 1.6, 4.0, 60.0),
    "offset": (0.005, 2.0, 0.0005, 0.05),
    "ripple": (0.003, 3.0, 0.0005, 0.05),
    "scatter": (1.0, 1.5, 0.2, 5.0),
}
"""Of each hyperparameter median and factor of one standard deviation, and least and largest."""
OFFSET_OF_GRIDS_IN_SPACE = (0.02, 2.0, 0.0005, 0.1)
"""The same, of the offset where the cause is the grid in three dimensions: where in cells of 5 mm
the soil lies is worth 3 % of the force there (`study resolution`)."""
STEP = 1e-4
"""Of logarithms of hyperparameters, for derivatives."""


@dataclass(frozen=True)
class FidelityKernel:
    """Hyperparameters; level and amplitude are of the sum over the powers.

    Attributes
    ----------
    level
        Standard deviation of the factor a [-].
    amplitude
        That of delta where the profile is 1 [-].
    phi_length_deg, theta_length_deg
        Correlation lengths of delta [deg].
    offset
        Standard deviation of a ripple's factor [-].
    ripple
        That of its white part over the peak-to-peak, where the profile is 1 [-].
    scatter
        Standard deviation of a fine curve's scatter over that of a coarse one [-].
    """

    level: float = PRIORS["level"][0]
    amplitude: float = PRIORS["amplitude"][0]
    phi_length_deg: float = PRIORS["phi_length_deg"][0]
    theta_length_deg: float = PRIORS["theta_length_deg"][0]
    offset: float = PRIORS["offset"][0]
    ripple: float = PRIORS["ripple"][0]
    scatter: float = PRIORS["scatter"][0]

    @classmethod
    def known(cls, told: Mapping[str, float] | None) -> Self | None:
        """Those that a library's file has; ``None`` if it has none, or those of another version."""
        return cls(**told) if told is not None and told.keys() == PRIORS.keys() else None


class _Covariances(NamedTuple):
    """Prior covariance between forces at some angles and the rows [N^2], [k, row, 2 t, 2 t]."""

    powers: FloatArray
    """Of the sum of all c_p."""
    ripple: FloatArray
    """Of a ripple."""


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
    kernel
        Hyperparameters.
    level_mean
        Mean of the factor a priori, of both forces, 0 where there are rows [-], shape [2].
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
    kernel: FidelityKernel = field(default_factory=FidelityKernel)
    level_mean: FloatArray = field(default_factory=lambda: np.zeros(2))
    widened: float = FEW

    @classmethod
    def of(
        cls,
        coarse: JointSurrogate,
        fine: FineCurves,
        kernel: FidelityKernel | None = None,
        *,
        priors: Mapping[str, Prior] = PRIORS,
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
        priors
            Of the hyperparameters, from :func:`priors_of`.
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
            kernel=kernel or FidelityKernel(),
        )
        return made if kernel else made.fitted(priors)

    def fitted(self, priors: Mapping[str, Prior] = PRIORS) -> Self:
        """The same with the hyperparameters of most posterior density."""
        table = np.log(list(priors.values()))
        median, sd = table[:, 0], table[:, 1]

        def density(logarithms: FloatArray) -> tuple[float, FloatArray]:
            apart = (logarithms - median) / sd
            value, slope = self._evidence(logarithms)
            return value - 0.5 * float(apart @ apart), slope - apart / sd

        with single_threaded():
            best = maximise(density, [median], table[:, 2:], ftol=1e-8)
        return replace(self, kernel=FidelityKernel(*np.exp(best).tolist()))

    def _evidence(self, logarithms: FloatArray) -> tuple[float, FloatArray]:
        """Log evidence and its gradient."""
        rows = self.differences.ravel()
        covariance = self._covariance(logarithms)
        inverse = np.linalg.inv(covariance)
        weights = inverse @ rows
        slope = []
        for step in STEP * np.eye(logarithms.size):
            ahead, back = (self._covariance(logarithms + d) for d in (step, -step))
            change = (ahead - back) / (2.0 * STEP)
            slope.append(0.5 * float(weights @ change @ weights - np.sum(inverse * change)))
        volume = float(np.linalg.slogdet(covariance)[1])
        return -0.5 * (float(rows @ weights) + volume), np.array(slope)

    def _covariance(self, logarithms: FloatArray) -> FloatArray:
        """Of the rows at logarithms of hyperparameters [N^2], [row 2 theta, row 2 theta]."""
        return replace(self, kernel=FidelityKernel(*np.exp(logarithms).tolist()))._of_rows()

    def _of_rows(self) -> FloatArray:
        n, size = self.differences.shape
        prior, share = self._between(self.phi_deg, self.forces), self._shares
        found = self._shared_powers(share, share)[:, :, None, None] * prior.powers
        # Each row less the coarse forces has their ripple, and that of its own size.
        same = self.ratio[:, None] == self.ratio
        found += (1.0 + same)[:, :, None, None] * prior.ripple
        for i in range(n):
            found[i, i] += self.kernel.scatter**2 * self.own[i]
            # Fine curves of one angle are compared with the same coarse mean.
            found[i, self.phi_deg == self.phi_deg[i]] += self.shared[i]
        return found.transpose(0, 2, 1, 3).reshape(n * size, n * size)

    def _shared_powers(self, one: FloatArray, other: FloatArray) -> FloatArray:
        """Covariance that sums of the c_p have with these shares, over that of a c [-]."""
        mean = (one @ WEIGHTS)[:, None] * (other @ WEIGHTS)
        found: FloatArray = ALIKE * mean + (1.0 - ALIKE) * (one * WEIGHTS) @ other.T
        return found

    @property
    def _shares(self) -> FloatArray:
        """What each row has of each c_p [-], shape [row, power]."""
        return np.vstack([_share(ratio) for ratio in self.ratio.tolist()])

    def _between(self, phi_deg: FloatArray, forces: FloatArray) -> _Covariances:
        """Prior covariance with the rows."""
        kernel = self.kernel
        lag = matern(self.theta_deg, self.theta_deg, kernel.theta_length_deg)
        over_theta, white = np.kron(np.eye(2), lag), np.eye(self.profile.size)
        over_phi = matern(phi_deg, self.phi_deg, kernel.phi_length_deg)[:, :, None, None]
        sizes = self._sizes(forces)[:, None, :, None] * self._sizes(self.forces)[None, :, None, :]
        smooth = kernel.amplitude**2 * over_phi * over_theta * sizes
        of_one = np.kron(np.eye(2), np.ones((self.theta_deg.size, self.theta_deg.size)))
        alike = of_one * forces[:, None, :, None] * self.forces[None, :, None, :]
        alike = self._over_phi(phi_deg)[:, :, None, None] * alike
        ripple = kernel.ripple**2 * over_phi * white * sizes + kernel.offset**2 * alike
        return _Covariances(smooth + kernel.level**2 * alike, ripple)

    def _over_phi(self, phi_deg: FloatArray) -> FloatArray:
        """Correlation of the level with that of the rows [-], shape [k, row]."""
        return CONSTANT + (1.0 - CONSTANT) * matern(phi_deg, self.phi_deg, LEVEL_LENGTH_DEG)

    def _sizes(self, forces: FloatArray) -> FloatArray:
        """Peak-to-peak times profile [N], [k, 2 theta] -> the same."""
        return window_spans(forces) * self.profile

    def _across(self, phi_deg: FloatArray, forces: FloatArray, ratio: float | None) -> FloatArray:
        """Prior covariance of what is foretold with the rows [N^2], [k 2 theta, row 2 theta]."""
        prior = self._between(phi_deg, forces)
        share = self._shared_powers(_share(ratio), self._shares)[0]
        ripples = 1.0 + (np.zeros(self.ratio.size) if ratio is None else self.ratio == ratio)
        found = share[None, :, None, None] * prior.powers
        found += ripples[None, :, None, None] * prior.ripple
        k, n, size, _ = found.shape
        return found.transpose(0, 2, 1, 3).reshape(k * size, n * size)

    def _prior(self, forces: FloatArray, ratio: float | None) -> FloatArray:
        """Prior covariance of what is foretold [N^2], shape [k, 2 theta, 2 theta]."""
        kernel, size = self.kernel, self.theta_deg.size
        share = float(self._shared_powers(_share(ratio), _share(ratio))[0, 0])
        ripples = 1.0 if ratio is None else 2.0
        lag = matern(self.theta_deg, self.theta_deg, kernel.theta_length_deg)
        of_sizes = share * kernel.amplitude**2 * lag + ripples * kernel.ripple**2 * np.eye(size)
        sizes = self._sizes(forces)
        found = np.kron(np.eye(2), of_sizes) * sizes[:, :, None] * sizes[:, None, :]
        variance = share * kernel.level**2 + ripples * kernel.offset**2
        of_one = variance * np.kron(np.eye(2), np.ones((size, size)))
        total: FloatArray = found + of_one * forces[:, :, None] * forces[:, None, :]
        return total

    @cached_property
    def _conditioned(self) -> tuple[FloatArray, FloatArray]:
        """Cholesky factor of the rows' covariance, and its inverse times the rows."""
        with single_threaded():
            factor = np.linalg.cholesky(self._of_rows()).astype(np.float64)
            white = _whitened(factor, self.differences.ravel())
            return factor, _whitened(factor, white, transposed=True)

    def mean(
        self, phi_deg: FloatArray, forces: FloatArray, *, ratio: float | None = None
    ) -> FloatArray:
        """Correction at friction angles [N], shape [k] -> [k, 2 theta].

        Parameters
        ----------
        phi_deg
            Friction angles [deg].
        forces
            Coarse forces there [N], shape [k, 2 theta].
        ratio
            Not to the limit, but to what simulations of this r would give on average.
        """
        found: FloatArray = forces * np.repeat(self.level_mean, self.theta_deg.size)
        if self.phi_deg.size:
            told = self._across(phi_deg, forces, ratio) @ self._conditioned[1]
            found = found + told.reshape(found.shape)
        return found

    def covariance(
        self, phi_deg: FloatArray, forces: FloatArray, *, ratio: float | None = None
    ) -> FloatArray:
        """Covariance of its error [N^2], shape [k] -> [k, 2 theta, 2 theta]; as :meth:`mean`."""
        found = self._prior(forces, ratio)
        if self.phi_deg.size:
            with single_threaded():
                white = _whitened(self._conditioned[0], self._across(phi_deg, forces, ratio).T)
            white = white.reshape(len(white), len(phi_deg), -1)
            found = found - white.transpose(1, 2, 0) @ white.transpose(1, 0, 2)
        return self.widened**2 * found

    def for_leg(self, coarse: JointSurrogate) -> Self:
        """What it says of a leg without fine curves.

        Parameters
        ----------
        coarse
            That leg's surrogate, without a correction.
        """
        none = np.zeros((0, 2 * coarse.theta_deg.size))
        return replace(
            self,
            theta_deg=coarse.theta_deg,
            profile=profile_of(coarse.theta_deg, coarse.predict(coarse.phi_deg)),
            phi_deg=np.zeros(0),
            ratio=np.zeros(0),
            forces=none,
            differences=none,
            level_mean=self._factor(),
            widened=WIDER,
        )

    def _factor(self) -> FloatArray:
        """By how much the correction changes each force at the rows' angles [-], shape [2]."""
        phi, at = np.unique(self.phi_deg, return_index=True)
        forces = self.forces[at]
        shape = (-1, 2, self.theta_deg.size)
        told, own = self.mean(phi, forces).reshape(shape), forces.reshape(shape)
        factor: FloatArray = np.sum(told * own, axis=2) / np.square(own).sum(axis=2)
        return factor.mean(axis=0)

    def as_dict(self) -> dict[str, float]:
        """Hyperparameters, as plain numbers."""
        return asdict(self.kernel)


@dataclass(frozen=True, eq=False)
class Refinement:
    """Corrections of a leg by cause, which err independently but for what both may count.

    What is left of an error that goes with the product of two causes is in the correction for each.
    It may be any share of the smaller of the two, where they have one sign: the root mean square of
    a uniform share is counted, in halves of each cause's variance.
    """

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
        found = {cause: one.covariance(phi_deg, forces) for cause, one in self.parts.items()}
        if len(found) > 1:
            one, other = (part.mean(phi_deg, forces) for part in self.parts.values())
            both = np.where(one * other > 0.0, np.minimum(np.abs(one), np.abs(other)), 0.0)
            both *= np.sign(one)
            wide = max(part.widened for part in self.parts.values())
            product = wide**2 * both[:, :, None] * both[:, None, :] / 3.0
            found = {cause: covariance + 0.5 * product for cause, covariance in found.items()}
        return found

    def covariance(self, phi_deg: FloatArray, forces: FloatArray) -> FloatArray:
        """Of all causes together [N^2]."""
        found: FloatArray = np.sum(list(self.covariances(phi_deg, forces).values()), axis=0)
        return found


def priors_of(cause: str, scenario: Scenario) -> Mapping[str, Prior]:
    """Priors of the hyperparameters of a correction, by its cause and one of the library's cases.

    They are :data:`PRIORS`, but for what is known of the material point method in space.
    """
    if cause == "grid" and scenario.model == "mpm" and scenario.dimensions == 3:
        return {**PRIORS, "offset": OFFSET_OF_GRIDS_IN_SPACE}
    return PRIORS


def _share(ratio: float | None) -> FloatArray:
    """What curves of a size, or the limit, have of each c_p [-], shape [1, power]."""
    return np.atleast_2d(1.0 - (ratio or 0.0) ** POWERS)


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

    found: FloatArray = solve_triangular(cholesky, values, lower=True, trans=int(transposed))
    return found
