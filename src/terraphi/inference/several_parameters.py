r"""Several parameters at once, from one history or several: draws of a posterior by emcee.

The window means of trial k with a leg are, for each force,

    d_k = g(x) + b + e_k,      b ~ N(0, V(x) + a^2 p^2 K),      e_k ~ N(0, (s^2 + t^2) I),

V the surrogate's own covariance, with an error that multiplies both forces on a leg alike; a^2 p^2
K a model discrepancy of relative size a, as smooth over the leg angle as the forces themselves (K
the surrogate's covariance over theta, of unit mean variance; p the peak-to-peak of the data); t^2
the scatter of the simulations; s the noise of a window mean. What the surrogate and the model get
wrong they get wrong in every trial with that leg: b is shared, and repeating a trial averages out
e_k alone. Legs err independently.

In the basis of the leg angles that diagonalises K all of these are diagonal, so that with m trials
of mean z and spread S = sum_k (z_k - z)^2 along a direction of the basis

    -2 log p = (z - g)^2 / (v + q/m) + log(m v + q) + (m - 1) log q + S / q,

v the shared variance and q that of a trial: a sum over 2 M numbers, for any number of trials. The
common factor f has a covariance of rank one, f^2 g g^T, which adds (Woodbury; Rasmussen & Williams,
eqs A.9 and A.10), with w = v + q/m,

    -f^2 (g^T w^-1 (z - g))^2 / (1 + f^2 g^T w^-1 g) + log(1 + f^2 g^T w^-1 g).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError
from terraphi.experiment.scenario import Scenario
from terraphi.inference.answer import (
    PHI,
    AngleSummary,
    Inversion,
    Summary,
    Together,
    plane_strain_summary,
)
from terraphi.inference.findings import Doubt, Verdict
from terraphi.inference.identifiability import Identifiability, fisher, label
from terraphi.inference.noise import Noise
from terraphi.inference.posterior import quadrature
from terraphi.inference.prior import Marginal
from terraphi.inference.sampler import Draws, sample
from terraphi.inference.trials import Looked, Matched, Repeats, Through, Ways, beyond, check_trials
from terraphi.inference.verdict import NRMSD_LIMIT, Edge, damaged, edge_of, judge
from terraphi.library.store import Library
from terraphi.surrogate.design import DesignSurrogate
from terraphi.surrogate.kronecker import single_threaded
from terraphi.surrogate.training import DENSITY, Training, training

DILATION = "soil.dilation_angle_deg"
STEPS = 1500
"""Of each ensemble to begin with."""
CURVES = 201
"""Angles at which curves are asked for what would explain a record."""
SLOPE_STEP = 1e-3
"""Step of differences over a parameter, of its prior standard deviation [-]."""
EDGE = 0.02
"""Width of an edge of a prior, of its span [-]."""

NOISE_RANGE = (1e-4, 0.3)
"""Noise of a window mean that may be inferred, of the largest peak-to-peak [-]; log-uniform."""
AMPLITUDE_RANGE = (1e-3, 1.0)
"""Relative size of a discrepancy; log-uniform."""


@dataclass(frozen=True, eq=False)
class Target:
    """The log posterior over the free parameters, log noise and log discrepancy.

    Attributes
    ----------
    legs
        Likelihood of each leg; noise and discrepancy have the same relative size for all.
    priors
        Of every parameter, fixed ones too.
    keys
        Those that are free.
    noise
        Standard deviation of a window mean of the noisier force [N]; ``None`` if it is inferred.
    discrepancy
        Whether the model may be wrong.
    """

    legs: tuple[LegLikelihood, ...]
    priors: Mapping[str, Marginal]
    keys: tuple[str, ...]
    noise: float | None
    discrepancy: bool

    @property
    def hyper(self) -> list[Marginal]:
        """Priors of the logarithms of what else is inferred."""
        found = []
        if self.noise is None:
            low, high = np.log(
                np.array(NOISE_RANGE) * max(leg.largest for leg in self.legs)
            ).tolist()
            found.append(Marginal(low, high))
        if self.discrepancy:
            found.append(Marginal(*np.log(AMPLITUDE_RANGE).tolist()))
        return found

    @property
    def marginals(self) -> list[Marginal]:
        """Priors of all dimensions."""
        return [*(self.priors[k] for k in self.keys), *self.hyper]

    def named(self, values: FloatArray) -> dict[str, FloatArray]:
        """All parameters by key, fixed ones too; values of shape [k, d]."""
        free = {key: values[:, i] for i, key in enumerate(self.keys)}
        fixed = {k: np.full(len(values), p.low) for k, p in self.priors.items() if p.fixed}
        return {**fixed, **free}

    def _log_size(self, values: FloatArray) -> FloatArray:
        """Logarithm of the first leg's forces at the density of the library, shape [k]."""
        surrogate = self.legs[0].surrogate
        reference = np.full(len(values), surrogate.reference_density)
        return np.log(surrogate.scale({**self.named(values), DENSITY: reference}))

    def coordinates(self, values: FloatArray) -> FloatArray:
        """Parameters with the logarithm of the forces' size in place of the density.

        Forces are proportional to the density, so that it and all else that makes forces large are
        known together alone: along a narrow, bent ridge. In these coordinates it is straight.
        """
        found = values.copy()
        if DENSITY in self.keys:
            i = self.keys.index(DENSITY)
            found[:, i] = np.log(values[:, i]) + self._log_size(values)
        return found

    def parameters(self, coordinates: FloatArray) -> FloatArray:
        """Inverse of :meth:`coordinates`."""
        found = coordinates.copy()
        if DENSITY in self.keys:
            i = self.keys.index(DENSITY)
            found[:, i] = np.exp(coordinates[:, i] - self._log_size(coordinates))
        return found

    def at(self, coordinates: FloatArray) -> FloatArray:
        """Log posterior density in the coordinates, up to a constant, shape [k, d] -> [k]."""
        values = self.parameters(coordinates)
        log_p = self(values)
        if DENSITY in self.keys:
            # The determinant of the change of variables.
            log_p += np.log(values[:, self.keys.index(DENSITY)])
        return log_p

    def errors(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Noise [N] and relative discrepancy [-], shape [k] each."""
        rest = list(np.exp(values[:, len(self.keys) :]).T)
        noise = rest.pop(0) if self.noise is None else np.full(len(values), self.noise)
        return noise, rest.pop(0) if self.discrepancy else np.zeros(len(values))

    def draw_prior(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Coordinates of draws of the prior, shape [count, d]."""
        return self.coordinates(np.column_stack([m.draw(count, rng) for m in self.marginals]))

    def __call__(self, values: FloatArray) -> FloatArray:
        """Log posterior up to a constant, shape [k, d] -> [k]."""
        log_p = np.sum(
            [m.log_density(v) for m, v in zip(self.marginals, values.T, strict=True)], axis=0
        )
        inside = np.isfinite(log_p)
        if inside.any():
            chosen = values[inside]
            named, errors = self.named(chosen), self.errors(chosen)
            log_p[inside] += np.sum([leg(named, *errors) for leg in self.legs], axis=0)
        return log_p


class LegLikelihood:
    """All trials with one leg.

    Parameters
    ----------
    surrogate
        Of the leg.
    data
        Observation vectors [N], shape [trial, 2 theta].
    noise_ratio
        Noise of Fx and of Fz over that of the noisier [-].
    """

    def __init__(
        self,
        surrogate: DesignSurrogate,
        data: FloatArray,
        noise_ratio: tuple[float, float] = (1.0, 1.0),
    ) -> None:
        self.surrogate = surrogate
        self.noise_ratio = noise_ratio
        self.trials = len(data)
        half = surrogate.theta_deg.size
        self.parts = []
        for process, values in zip(
            surrogate.processes, (data[:, :half], data[:, half:]), strict=True
        ):
            rotated = values @ process.basis
            mean = rotated.mean(axis=0)
            spread = np.square(rotated - mean).sum(axis=0)
            span = float(np.ptp(values.mean(axis=0)))
            shape = np.square(span) * process.roots / process.roots.mean()
            self.parts.append((process, mean, spread, shape))
        self.largest = float(np.ptp(data.mean(axis=0).reshape(2, -1), axis=1).max())

    def __call__(
        self, named: Mapping[str, FloatArray], noise: FloatArray, amplitude: FloatArray
    ) -> FloatArray:
        """Log-likelihood up to a constant, shape [k].

        Parameters
        ----------
        named
            Dotted key to values, shape [k] each.
        noise
            s, standard deviation of a window mean of the noisier force [N], shape [k].
        amplitude
            a [-], shape [k]; zero for a model that is right.
        """
        points, scale, factor2 = self.surrogate.located(named)
        scale = scale[:, None]
        m, total = self.trials, np.zeros(len(points))
        along, norm = np.zeros(len(points)), np.zeros(len(points))
        for (process, mean, spread, shape), ratio in zip(self.parts, self.noise_ratio, strict=True):
            forces, variance = process.rotated(points)
            shared = np.square(scale) * variance + np.square(amplitude)[:, None] * shape
            own = np.square(ratio * noise)[:, None] + np.square(scale) * process.noise_variance
            curve, whole = scale * forces, shared + own / m
            terms = np.square(mean - curve) / whole + np.log(m * shared + own)
            terms = terms + (m - 1) * np.log(own) + spread / own
            total -= 0.5 * terms.sum(axis=1)
            along += np.sum(curve * (mean - curve) / whole, axis=1)
            norm += np.sum(np.square(curve) / whole, axis=1)
        by_factor = factor2 * np.square(along) / (1.0 + factor2 * norm)
        return total + 0.5 * (by_factor - np.log1p(factor2 * norm))

    def information(
        self, named: Mapping[str, float], keys: Sequence[str], steps: Sequence[float], *,
        noise: float, amplitude: float,
    ) -> FloatArray:  # fmt: skip
        """Fisher information of some parameters at a point, of the mean forces alone.

        Parameters
        ----------
        named
            The point: dotted key to value.
        keys
            Parameters wanted.
        steps
            Of the central differences, in the unit of each.
        noise, amplitude
            s [N] and a [-].

        Returns
        -------
        ndarray
            G^T C^-1 G, G the slopes of the forces; shape [key, key].
        """
        at = {key: np.array([value]) for key, value in named.items()}
        points, scale, factor2 = self.surrogate.located(at)
        curves, variances = [], []
        for (process, _, _, shape), ratio in zip(self.parts, self.noise_ratio, strict=True):
            forces, surrogate_variance = process.rotated(points)
            curves.append(scale * forces)
            own = (ratio * noise) ** 2 + scale**2 * process.noise_variance
            shared = scale**2 * surrogate_variance + amplitude**2 * shape
            variances.append(shared + own / self.trials)
        return fisher(self.surrogate.slopes(at, keys, steps), curves, variances, factor2)[0]


def infer(looked: Looked, library: Library, ways: Ways) -> Inversion:
    """Infer the parameters that a library varies.

    Parameters
    ----------
    looked
        The histories, without what is not to be believed of them.
    library
        Simulations over the parameters.
    ways
        How to.

    Raises
    ------
    InputError
        If a history, a leg, a prior or an option cannot be used.
    """
    _refuse_what_is_for_phi(ways)
    priors = ways.priors
    groups = looked.groups
    keys = tuple(k for k, p in priors.items() if not p.fixed)
    with single_threaded():
        data = _checked(looked, library, ways)
        ours = all(
            t.made_as(d.scenario, d.bounds)
            for g, d in zip(groups, data, strict=True)
            for t in g.trials
        )
        gp = ways.discrepancy == "gp" or (ways.discrepancy is None and not ours)
        looked.check_noise(ways.noise)
        size, ratio = _window_noise(ways.noise, groups)
        legs = tuple(
            LegLikelihood(DesignSurrogate.fit(d), g.vectors, ratio)
            for g, d in zip(groups, data, strict=True)
        )
        target = Target(legs, priors, keys, size, gp)
        draws = sample(
            target.at,
            target.draw_prior,
            parameters=target.parameters,
            seed=ways.seed,
            steps=STEPS if ways.steps is None else ways.steps,
            walkers=max(32, 4 * len(keys)),
        )
        return _answer(looked, data, library, target, draws, ways)


def _refuse_what_is_for_phi(ways: Ways) -> None:
    """Refuse options that are for φ alone."""
    for name, given, only in (
        ("likelihood", ways.likelihood, "joint"),
        ("sampler", ways.sampler, "emcee"),
    ):
        if given not in (None, only):
            raise InputError(
                f"--{name} {given} is for the friction angle alone; several parameters know {only} "
                "only: leave it out"
            )
    if ways.discrepancy not in (None, "none", "gp"):
        raise InputError("discrepancy 'soils' is for the friction angle alone; take 'gp'")
    if ways.calibration is not None:
        raise InputError("a calibration is for the friction angle alone; drop it")


def _checked(looked: Looked, library: Library, ways: Ways) -> list[Training]:
    """What the library holds of each leg; refuses trials that it cannot be compared with."""
    found = []
    for group in looked.groups:
        data = training(library, group.leg, readings=group.readings)
        check_trials(group, data.scenario, ways.density, varied=data.bounds)
        cohesive = data.scenario.soil.cohesion > 0.0
        if DENSITY in ways.priors and DENSITY not in data.bounds and cohesive:
            raise InputError(
                "the library's soil has cohesion, and its forces are not proportional to the "
                "density; vary soil.density in the library"
            )
        found.append(data)
    return found


def _window_noise(
    noise: Noise, groups: Sequence[Repeats]
) -> tuple[float | None, tuple[float, float]]:
    """Standard deviation of a window mean of the noisier force [N], and of both over it [-].

    ``None`` if it is to be inferred. Noise counts as white from window to window; as neighbours
    share a reading, which makes their errors alike, its size is that of the part they share.
    """
    if noise.sigma_N is None:
        return None, (1.0, 1.0)
    shares = [np.median(one.sum(axis=1)) for g in groups for one in g.window_covariances]
    largest = max(noise.sigma_N)
    x, z = (s / largest if largest > 0.0 else 1.0 for s in noise.sigma_N)
    return float(largest * np.sqrt(np.mean(shares))), (x, z)


def _answer(
    looked: Looked,
    data: Sequence[Training],
    library: Library,
    target: Target,
    draws: Draws,
    ways: Ways,
) -> Inversion:
    groups = looked.groups
    d, scenario = len(target.keys), library.cases[0].scenario
    flat = draws.flat
    noise, amplitude = target.errors(flat)
    best = draws.central
    point = {k: float(v[0]) for k, v in target.named(best[None]).items()}
    marginal = {k: Summary.of(flat[:, i]) for i, k in enumerate(target.keys)}
    sd = [target.priors[k].sd for k in target.keys]
    covariance = np.cov(flat[:, :d].T).reshape(d, d)
    identifiability = Identifiability.of(target.keys, covariance, sd)
    equivalent, why_not = _plane_strain(marginal, target, scenario)
    known = None if DENSITY in target.keys else point.get(DENSITY, scenario.soil.density)
    errors = float(np.median(noise)), float(np.median(amplitude))
    together = Together(
        conditional={k: _conditional(target, best, i) for i, k in enumerate(target.keys)},
        point=point,
        identifiability=identifiability,
        expected_sd=_expected(groups, target, errors, point, sd),
        noise_N=noise,
        amplitude=amplitude,
        discrepancy="gp" if target.discrepancy else "none",
    )
    every = _matched(looked, data, target, point, ways)
    verdict = _judge(target, flat, identifiability, every)
    misfit = verdict.verdict == "misfit"
    warnings = [*looked.damage, *looked.doubts(every, misfit=misfit)]
    if not draws.converged:
        warnings.append(Doubt("not_converged"))
    return Inversion(
        records=tuple(one.record for one in every),
        library=library.name,
        convention=scenario.convention,
        likelihood="joint",
        sampler="emcee",
        seed=draws.seed,
        marginal=marginal,
        priors=target.priors,
        of_phi=None,
        draws=draws,
        phi_plane_strain=equivalent,
        plane_strain_reason=why_not,
        density=known,
        density_assumed=known is not None and (ways.density_assumed or DENSITY not in point),
        verdict=damaged(verdict) if looked.spoilt else verdict,
        warnings=tuple(warnings),
        together=together,
    )


def _matched(
    looked: Looked,
    data: Sequence[Training],
    target: Target,
    point: Mapping[str, float],
    ways: Ways,
) -> list[Matched]:
    """The histories leg by leg beside the curve at the best point.

    What would explain a misfit is looked for on the curves over φ through that point.
    """
    at = {k: np.array([v]) for k, v in point.items()}
    prior = target.priors.get(PHI)
    found: list[Matched] = []
    for group, one, leg in zip(looked.groups, data, target.legs, strict=True):
        density, curves, nodes = ways.density, one.forces, None
        if DENSITY not in ways.priors:
            density = one.scenario.soil.density
        if density is not None:
            curves = curves * (density / one.density)[:, None]
        through = Through(one.scenario, curves, density, one.bounds)
        if prior is not None and PHI in target.keys:
            phi = np.linspace(prior.low, prior.high, CURVES)
            along = {k: np.full(CURVES, v) for k, v in point.items()} | {PHI: phi}
            nodes = phi, leg.surrogate.predict(along)[0]
        best = leg.surrogate.predict(at)[0][0]
        found += looked.beside(group, through, best, nodes, most=NRMSD_LIMIT)
    return found


def _plane_strain(
    marginal: Mapping[str, Summary], target: Target, scenario: Scenario
) -> tuple[AngleSummary | None, str]:
    """The friction angle as one of plane strain, or why there is none."""
    if PHI not in target.keys:
        return None, "the friction angle was not inferred"
    if DILATION in target.keys and scenario.soil.yield_criterion == "triaxial":
        return None, "it depends on the dilation angle, which was inferred as well"
    dilation = target.priors.get(DILATION)
    if dilation is not None and dilation.fixed:
        scenario = scenario.replace(**{DILATION: dilation.low})
    return plane_strain_summary(marginal[PHI], scenario)


def _conditional(target: Target, best: FloatArray, i: int) -> Summary:
    """One parameter with all else held at the best draw."""

    def along(values: FloatArray) -> FloatArray:
        points = np.repeat(best[None], len(values), axis=0)
        points[:, i] = values
        return target(points)

    prior = target.marginals[i]
    found = quadrature(along, (prior.low, prior.high), nodes=401)
    ends = found.interval(0.68)
    return Summary(found.median, ends, found.interval(0.95), 0.5 * (ends[1] - ends[0]))


def _expected(
    groups: Sequence[Repeats],
    target: Target,
    errors: tuple[float, float],
    named: Mapping[str, float],
    prior_sd: Sequence[float],
) -> dict[str, FloatArray]:
    """Standard deviations that each leg alone and all would leave, by linearisation.

    ``errors`` are the sizes of noise and discrepancy to reckon with: their medians, because those
    of a single draw change with its luck.
    """
    noise, amplitude = errors
    steps = [SLOPE_STEP * sd for sd in prior_sd]
    by_leg = {
        group.leg: leg.information(named, target.keys, steps, noise=noise, amplitude=amplitude)
        for group, leg in zip(groups, target.legs, strict=True)
    }
    every = {**by_leg, "all": np.sum(list(by_leg.values()), axis=0)}
    before = np.diag(1.0 / np.square(prior_sd))
    return {
        name: np.sqrt(np.diag(np.linalg.inv(information + before)))
        for name, information in every.items()
    }


def _judge(
    target: Target,
    flat: FloatArray,
    identifiability: Identifiability,
    seen: Sequence[Matched],
) -> Verdict:
    """A misfit if forces deviate; out of range if an edge cuts off a parameter that was learnt."""
    edges = {
        key: _edge(key, target.priors[key], flat[:, i])
        for i, key in enumerate(target.keys)
        if identifiability.kinds[key] != "open"
    }
    worst = max((one.record for one in seen), key=lambda record: max(record.nrmsd.values()))
    at = max(edges, key=lambda key: edges[key].size, default="")
    name = worst.source or "the history"
    # It is beyond an end of φ that the forces would fit.
    return judge(
        [measure for one in seen for measure in one.measures],
        edges.get(at),
        kind="parameters",
        beyond=beyond(seen) if at == PHI else None,
        numbers={"worst": name},
    )


def _edge(key: str, prior: Marginal, values: FloatArray) -> Edge:
    """The edge of a prior where the density is larger."""
    counts, _ = np.histogram(values, bins=round(1.0 / EDGE), range=(prior.low, prior.high))
    cuts = zip(prior.cut_off, (counts[0], counts[-1]), strict=True)
    low, high = (float(count / counts.max()) if cut else 0.0 for cut, count in cuts)
    name, unit = label(key)
    return edge_of((low, high), (prior.low, prior.high), "edge_density", name=name, unit=unit)
