"""Both forces of a leg between a library's angles, and the covariance of all that is not known.

A library's curves carry particle scatter, y_i = f(phi_i) + e_i (`scatter`). Over phi, theta and the
two forces f is a Gaussian process; divided by the scatter's standard deviation sigma(phi, theta),

    y / sigma ~ N(0, K_m (x) B + sum_k x^k x'^k (x) B_k + I (x) R),    (x) the Kronecker product,

where R is the scatter's correlation, K_m a Matern covariance over phi, B its covariance over leg
angles and forces (for each force a squared exponential in theta and a white part, for what the grid
leaves in every curve), and B_k that of the coefficients of a cubic in x = (phi - centre) /
half-span. K_m and x^k are times the growth of forces over scatter. The mean of n simulations of one
case has R / n: its row, and the growth there, are taken sqrt(n) times, so that all rows scatter
alike.

B and R are diagonal in a common basis, B = A diag(lambda) A^T and R = A A^T (Rakitsch et al., *It
is all in the noise*, NIPS 2013), and so is B_k by definition: the coefficient of x^k has mean zero
and in the direction of lambda the variance

    T_k^2 lambda_max (lambda / lambda_max)^p.

Hyperparameters are found in two steps. First the cubic is vague, all T_k large and p = 1, so that
all that is not R is one Kronecker product and `kronecker` gives the evidence; tau^2, a factor on R
that is 1 if the scatter is what it was taken to be, is found as well. Then the T_k and p are those
of most evidence over all directions together, so that forces drawn from the prior vary over phi as
much as the library's do: a vaguer prior would count the scatter's part of an estimated slope as
slope. With p other than 1 the terms differ from direction to direction, and every direction is a
process over phi by itself (`kronecker.Blocks`). In that basis prediction and the whole covariance
of the 2 m forces at any phi are in closed form. The covariance holds what interpolation leaves open
and what the library's own scatter does to the curve, which is the same for every history inverted
with that library.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike

from terraphi.experiment.arrays import FloatArray
from terraphi.surrogate.kronecker import Blocks, Kronecker, maximise, single_threaded
from terraphi.surrogate.scatter import Scatter, corrected, with_tail

if TYPE_CHECKING:
    from terraphi.surrogate.fidelity import Refinement

ORDERS = np.arange(4)
AMPLITUDES = (1e-2, 1e3)
"""Least and largest T_k [-]."""
POWERS = (0.3, 3.0)
"""Least and largest p [-]."""
LEAST = 1e-12
"""Least lambda / lambda_max [-]; round-off leaves no more."""


def powers_of(phi_deg: FloatArray, ends_deg: tuple[float, float]) -> FloatArray:
    """1, x, x^2, x^3 at friction angles [-], shape [...] -> [..., 4]."""
    centre, half = 0.5 * (ends_deg[0] + ends_deg[1]), 0.5 * (ends_deg[1] - ends_deg[0])
    return ((phi_deg - centre) / half)[..., None] ** ORDERS


def cubic_variances(amplitudes: tuple[float, ...], power: float, roots: FloatArray) -> FloatArray:
    """Prior variances of the coefficients [-], shape [4, 2 theta].

    Parameters
    ----------
    amplitudes, power
        T_k and p [-].
    roots
        lambda of each direction [-], shape [2 theta].
    """
    top = float(roots.max())
    shape = np.maximum(roots / top, LEAST) ** power
    return np.outer(np.square(amplitudes), top * shape)


def fit_cubic(
    powers: FloatArray, local: FloatArray, roots: FloatArray, curves: FloatArray
) -> tuple[tuple[float, float, float, float], float]:
    """T_k and p of maximum evidence.

    Parameters
    ----------
    powers
        Growth times 1, x, x^2, x^3 at the library's angles [-], shape [case, 4].
    local
        Covariance of the Matern process over them, for lambda = 1 [-], shape [case, case].
    roots
        lambda of each direction [-], shape [2 theta].
    curves
        The library's curves in the basis, over sigma [-], shape [case, 2 theta].
    """
    rest = roots[:, None, None] * local + np.eye(len(powers))
    logarithms = np.log(np.maximum(roots / roots.max(), LEAST))

    def evidence(p: FloatArray) -> tuple[float, FloatArray]:
        prior = cubic_variances(tuple(np.exp(p[:4])), float(p[4]), roots)
        blocks = Blocks((powers * prior.T[:, None, :]) @ powers.T + rest)
        value, by_variances = blocks.evidence(curves, powers)
        slope = by_variances * prior.T
        return value, np.append(2.0 * slope.sum(axis=0), slope.sum(axis=1) @ logarithms)

    start = np.append(np.log([40.0, 20.0, 15.0, 8.0]), 1.0)
    found = maximise(evidence, [start], [np.log(AMPLITUDES)] * 4 + [POWERS])
    a, b, c, d = np.exp(found[:4]).tolist()
    return (a, b, c, d), float(found[4])


TREND = 30.0
"""Prior standard deviation of the cubic's coefficients over that of the Matern process [-], until
`fit_cubic` finds it: so large that the process is fitted to what no cubic explains."""
NOISE_BOUNDS = (0.3, 3.0)
"""Least and largest factor on the scatter that curves may ask for [-]."""
PROFILE_DEG = 8.0
"""Smoothing of the prior's amplitude over the leg angle [deg]."""
PROFILE_FLOOR = 0.02
"""Least amplitude of the prior over its largest [-]."""


@dataclass(frozen=True)
class JointKernel:
    """Hyperparameters of the process; amplitudes are relative to the curves' root mean square.

    Attributes
    ----------
    phi_length_deg
        Correlation length over the friction angle [deg].
    theta_length_deg
        Correlation lengths over the leg angle, of Fx and Fz [deg].
    amplitude
        Amplitude of each force [-].
    fine
        Amplitude of the part that is white over the leg angle, over that of the smooth part [-].
    cubic, cubic_power
        T_k and p of the cubic's prior [-].
    """

    phi_length_deg: float
    theta_length_deg: tuple[float, float]
    amplitude: tuple[float, float]
    fine: tuple[float, float]
    cubic: tuple[float, float, float, float] = (TREND, TREND, TREND, TREND)
    cubic_power: float = 1.0

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers and lists."""
        return {k: list(v) if isinstance(v, tuple) else v for k, v in asdict(self).items()}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """Read what :meth:`as_dict` wrote; raises KeyError, TypeError or ValueError."""
        told: dict[str, Any] = {f.name: data[f.name] for f in fields(cls)}
        pairs = {k: tuple(v) for k, v in told.items() if isinstance(v, list)}
        return cls(**{**told, **pairs})


class Standardised:
    """Curves over sigma, times the root of their repeats, and the factor of R."""

    def __init__(
        self,
        phi_deg: ArrayLike,
        theta_deg: ArrayLike,
        curves: ArrayLike,
        scatter: Scatter,
        repeats: ArrayLike | None = None,
    ) -> None:
        self.phi = phi = np.array(phi_deg, dtype=np.float64)
        self.theta = theta = np.array(theta_deg, dtype=np.float64)
        values = np.array(curves, dtype=np.float64)
        counts = np.ones(phi.size) if repeats is None else np.array(repeats, dtype=np.float64)
        self.root_repeats = np.sqrt(counts)
        self.values = self.root_repeats[:, None] * (values / scatter.sigma(phi))
        self.factor = np.linalg.cholesky(scatter.correlation)
        self.inverse_factor = np.linalg.inv(self.factor)
        self.white = self.values @ self.inverse_factor.T
        self.parts = (slice(0, theta.size), slice(theta.size, None))
        self.theta_distance2 = np.square(theta[:, None] - theta)
        self.growth = self.root_repeats * scatter.growth(phi)
        self.growth2 = np.outer(self.growth, self.growth)
        self.profile = self._profile()

    def _profile(self) -> FloatArray:
        """Root mean square of the curves over sigma and growth, smoothed, shape [2 theta]."""
        kernel = smoothing(self.theta_distance2)
        even = self.values / self.growth[:, None]
        squares = np.mean(np.square(even), axis=0).reshape(2, -1) @ kernel.T
        root = np.sqrt(squares)
        profile: FloatArray = np.maximum(root, PROFILE_FLOOR * root.max(axis=1, keepdims=True))
        return profile.ravel()


class Evidence(Kronecker):
    """The white curves L^-1 y / sigma with their covariance, R = L L^T; of the noise tau^2 I.

    Attributes
    ----------
    over_phi
        Covariance over phi, of the Matern process and a vague cubic, shape [case, case].
    smooth
        Part of B that is smooth over theta, of each force, over the profile, shape [theta, theta].
    """

    def __init__(self, data: Standardised, kernel: JointKernel, noise: float = 1.0) -> None:
        self.data, self.kernel = data, kernel
        m = data.theta.size
        powers = powers_of(data.phi, (float(data.phi[0]), float(data.phi[-1])))
        # Without the cubic the process pulls the curves towards zero and levels their bend.
        self.over_phi = data.growth2 * (
            TREND**2 * powers @ powers.T + matern(data.phi, data.phi, kernel.phi_length_deg)
        )
        self.smooth = [
            amplitude**2 * np.exp(-0.5 * data.theta_distance2 / length**2)
            for amplitude, length in zip(kernel.amplitude, kernel.theta_length_deg, strict=True)
        ]
        prior = np.zeros((2 * m, 2 * m))
        for part, smooth, fine in zip(data.parts, self.smooth, self._fine2, strict=True):
            prior[part, part] = smooth + fine * np.eye(m)
        prior *= np.outer(data.profile, data.profile)
        inverse = data.inverse_factor
        super().__init__(self.over_phi, inverse @ prior @ inverse.T, data.white, noise=noise**2)

    @property
    def _fine2(self) -> list[float]:
        """Variance of each force's part that is white over theta, over the profile [-]."""
        pairs = zip(self.kernel.amplitude, self.kernel.fine, strict=True)
        return [(amplitude * fine) ** 2 for amplitude, fine in pairs]

    def gradient(self) -> FloatArray:
        """By the log of each argument of `_pack`, in its order."""
        data, kernel = self.data, self.kernel
        lag = np.sqrt(5.0) * np.abs(data.phi[:, None] - data.phi) / kernel.phi_length_deg
        slope = data.growth2 * np.square(lag) * (1.0 + lag) / 3.0 * np.exp(-lag)
        found = [self.along("left", slope)]
        by_prior = self.by_entries("right", data.inverse_factor * data.profile)
        for force, part in enumerate(data.parts):
            sensitivity, smooth = by_prior[part, part], self.smooth[force]
            length = kernel.theta_length_deg[force]
            by_length = np.sum(sensitivity * smooth * data.theta_distance2) / length**2
            by_fine = 2.0 * self._fine2[force] * np.trace(sensitivity)
            found += [by_length, 2.0 * np.sum(sensitivity * smooth) + by_fine, by_fine]
        return np.array([*found, 2.0 * self.by_noise()])


def window_spans(forces: FloatArray) -> FloatArray:
    """Peak-to-peak of the force of each window of observation vectors [N], [..., 2 theta]."""
    halves = forces.reshape(*forces.shape[:-1], 2, forces.shape[-1] // 2)
    return np.repeat(np.ptp(halves, axis=-1), halves.shape[-1], axis=-1)


def smoothing(distance2: FloatArray) -> FloatArray:
    """Weights of a mean over neighbouring leg angles [-], from squared distances [deg²]."""
    kernel = np.exp(-0.5 * distance2 / PROFILE_DEG**2)
    return kernel / kernel.sum(axis=1, keepdims=True)


def matern(one_deg: FloatArray, other_deg: FloatArray, length_deg: float) -> FloatArray:
    """Matern correlation of order 5/2 over phi [-] (R & W eq. 4.17).

    It is smooth, but not infinitely so: where bands of shear jump, forces bend. A squared
    exponential, which cannot, has far less evidence on all our libraries.

    Parameters
    ----------
    one_deg, other_deg
        Friction angles [deg], shapes [..., one] and [..., other]; the result has [..., one, other].
    length_deg
        Correlation length [deg].
    """
    lag = np.sqrt(5.0) * np.abs(one_deg[..., :, None] - other_deg[..., None, :]) / length_deg
    return (1.0 + lag + np.square(lag) / 3.0) * np.exp(-lag)


def _pack(kernel: JointKernel, noise: float) -> FloatArray:
    parts = zip(kernel.theta_length_deg, kernel.amplitude, kernel.fine, strict=True)
    return np.log([kernel.phi_length_deg, *(v for part in parts for v in part), noise])


def _unpack(logarithms: FloatArray) -> tuple[JointKernel, float]:
    p = np.exp(logarithms).tolist()
    return JointKernel(p[0], (p[1], p[4]), (p[2], p[5]), (p[3], p[6])), p[7]


def maximise_evidence(data: Standardised) -> tuple[JointKernel, float]:
    """Hyperparameters of maximum evidence, and a factor on the scatter [-]."""

    def evidence(logarithms: FloatArray) -> tuple[float, FloatArray]:
        found = Evidence(data, *_unpack(logarithms))
        return found.log_evidence(), found.gradient()

    span, step = float(np.ptp(data.phi)), float(np.diff(data.phi).min())
    spacing = float(np.diff(data.theta).min())
    one = [(spacing, 90.0), (1e-2, 1e2), (1e-4, 1.0)]
    bounds = np.log([(step, 10.0 * span), *one, *one, NOISE_BOUNDS])
    # Forces vary slowly with phi, over some tens of degrees with theta, and little of it is fine.
    starts = [
        JointKernel(span * a, (b, b), (1.0, 1.0), (c, c))
        for a, b, c in ((0.7, 20.0, 0.02), (2.0, 10.0, 0.005))
    ]
    packed = [_pack(start, 1.0) for start in starts]
    return _unpack(maximise(evidence, packed, bounds, ftol=1e-10, gtol=1e-4))


ROUNDS = 2
"""Corrections of the scatter by the curves."""
STEP_DEG = 0.05
"""Half the step of derivatives with respect to the friction angle [deg]."""
JITTER = 1e-9
"""Added to the variance of equal angles, so that they have a factor."""


@dataclass(frozen=True, eq=False)
class JointSurrogate:
    """Mean and covariance of the observation vector [Fx, Fz] of one leg, over phi.

    What is called standard is of forces as simulated; a correction is not in it.

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
    correction
        What finer simulations add to the forces, and its error; ``None``: they are as simulated.
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
    correction: Refinement | None = None
    _blocks: Blocks = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Condition each direction of the basis on its curves."""
        covariance = self._between(self.phi_deg) * self.root_repeats[:, None]
        covariance += np.eye(self.phi_deg.size)
        object.__setattr__(self, "_blocks", Blocks(covariance))

    @cached_property
    def as_simulated(self) -> Self:
        """The same without the correction."""
        return replace(self, correction=None) if self.correction is not None else self

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
        """
        with single_threaded():
            if kernel is None:
                scatter, kernel = _learn(phi_deg, theta_deg, curves, scatter, repeats)
            data = Standardised(phi_deg, theta_deg, curves, scatter, repeats)
            roots, basis = Evidence(data, kernel).right
            whitener = basis.T @ data.inverse_factor
            variances = cubic_variances(kernel.cubic, kernel.cubic_power, roots)
            return cls(
                phi_deg=data.phi,
                theta_deg=data.theta,
                scatter=scatter,
                kernel=kernel,
                root_repeats=data.root_repeats,
                basis=data.factor @ basis,
                whitener=whitener,
                standard_curves=data.values @ whitener.T,
                prior_variance=roots,
                cubic_variance=variances,
            )

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
        phi = np.atleast_1d(np.asarray(phi_deg, dtype=np.float64))
        found = scale * self.scatter.sigma(phi) * (self.standard_mean(phi) @ self.basis.T)
        if self.correction is not None:
            found += scale * self.correction.mean(phi, found / scale)
        return found

    def slope(self, phi_deg: float) -> FloatArray:
        """Derivative of the forces with respect to the friction angle [N/deg], shape [2 theta]."""
        around = np.clip(phi_deg + np.array([-STEP_DEG, STEP_DEG]), *self.phi_bounds_deg)
        below, above = self.predict(around)
        return (above - below) / (around[1] - around[0])

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
        return self._powers(phi_deg) @ coefficients

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
        return np.maximum(self._alone(phi_deg) - self._blocks.explained(between), 0.0)

    def standard_terms(self, phi_deg: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The two parts of :meth:`standard_variance`: interpolation, and the library's scatter.

        The prediction is W y with weights W; its error (f - W f(phi_i)) - W e has a part that the
        prior of f gives and one that the scatter e of the library gives.
        """
        scatter = self._blocks.carried(self._between(phi_deg))
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
        return drawn + about

    def covariance(self, phi_deg: float) -> FloatArray:
        """Predictive covariance of the forces f [N^2], shape [2 theta, 2 theta]."""
        phi = np.array([phi_deg], dtype=np.float64)
        left = self.scatter.sigma(phi)[0][:, None] * self.basis
        found: FloatArray = (left * self.standard_variance(phi)[0]) @ left.T
        for error in self.corrections(phi_deg).values():
            found += error
        return found

    def corrections(self, phi_deg: float) -> dict[str, FloatArray]:
        """Covariance of the correction's error by cause [N^2], shape [2 theta, 2 theta] each."""
        if self.correction is None:
            return {}
        phi = np.array([phi_deg], dtype=np.float64)
        forces = self.as_simulated.predict(phi)
        found = self.correction.covariances(phi, forces)
        return {cause: covariance[0] for cause, covariance in found.items()}

    def _between(self, phi_deg: FloatArray) -> FloatArray:
        """Prior covariance of f with the rows of the curves, [k] -> [2 theta, k, case]."""
        covariance = self.prior_covariance(phi_deg, self.phi_deg).transpose(2, 0, 1)
        return covariance * self.root_repeats

    def _weights(self, curves: FloatArray) -> FloatArray:
        """What a mean gives each curve's angle: K^-1 y times root_repeats, [..., case, 2 theta]."""
        return self.root_repeats[:, None] * self._blocks.weights(curves)

    def _powers(self, phi_deg: FloatArray) -> FloatArray:
        """Growth times 1, x, x^2, x^3, shape [...] -> [..., 4]."""
        return self.scatter.growth(phi_deg)[..., None] * powers_of(phi_deg, self.phi_bounds_deg)

    def _alone(self, phi_deg: FloatArray) -> FloatArray:
        """Prior variance of f in the basis, over sigma^2 [-], shape [k] -> [k, 2 theta]."""
        local = np.outer(np.square(self.scatter.growth(phi_deg)), self.prior_variance)
        return np.square(self._powers(phi_deg)) @ self.cubic_variance + local


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
        squares = Evidence(data, kernel, noise).left_out()
        scatter = corrected(scatter, data.phi, noise**2 * squares)
    data = Standardised(phi_deg, theta_deg, curves, scatter, repeats)
    kernel, noise = maximise_evidence(data)
    squares = Evidence(data, kernel, noise).left_out()
    scatter = with_tail(scatter.scaled(noise), squares)
    vague = JointSurrogate.fit(phi_deg, theta_deg, curves, scatter, kernel=kernel, repeats=repeats)
    growth = vague.root_repeats * scatter.growth(vague.phi_deg)
    amplitudes, power = fit_cubic(
        growth[:, None] * powers_of(vague.phi_deg, vague.phi_bounds_deg),
        np.outer(growth, growth) * matern(vague.phi_deg, vague.phi_deg, kernel.phi_length_deg),
        vague.prior_variance,
        vague.standard_curves,
    )
    return scatter, replace(kernel, cubic=amplitudes, cubic_power=power)
