"""The friction angle alone, from one history or several, by quadrature of log-likelihoods added.

Histories of one leg share what the surrogate leaves open, what their readings leave open and what
the model gets wrong; noise and the scatter of the bed are each one's own. So their mean is inverted
as one record whose noise and scatter are those of a mean: what is shared is counted once, however
often a trial is repeated. Legs err independently, as in `target`.

Each history is tested by itself, and all of them for whether one angle can be that of all: twice
the log-likelihood that they lose by having one angle is a chi-square of as many degrees of freedom
as there are further histories (Wilks, Ann. Math. Stat. 9:60, 1938).
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError
from terraphi.inference.answer import (
    PHI,
    AngleSummary,
    Inversion,
    Record,
    Summary,
    Together,
    plane_strain_summary,
)
from terraphi.inference.budget import Budget, budget_of
from terraphi.inference.calibrated import CalibratedLikelihood, Problem
from terraphi.inference.discrepancy import (
    ACCEPTED,
    ALONE,
    Learnt,
    Level,
    SoilLikelihood,
    learnt_for,
)
from terraphi.inference.explanation import SLIPS, USUAL_DEG
from terraphi.inference.findings import Doubt, Measure, Verdict
from terraphi.inference.fit import SMALLEST_PROBABILITY, fit_without_discrepancy
from terraphi.inference.identifiability import Identifiability
from terraphi.inference.noise import shape_of
from terraphi.inference.paper_likelihood import PaperLikelihood
from terraphi.inference.posterior import LogLikelihood, Posterior, quadrature
from terraphi.inference.prepared_leg import prepare
from terraphi.inference.prior import Marginal
from terraphi.inference.sampler import Draws, sample
from terraphi.inference.trials import Looked, Matched, Repeats, Through, Ways, beyond, check_trials
from terraphi.inference.verdict import (
    NRMSD_LIMIT,
    Edge,
    damaged,
    edge_densities,
    edge_masses,
    edge_of,
    fit_measures,
    judge,
    uninformed,
)
from terraphi.library.store import Library
from terraphi.surrogate.joint import JointSurrogate
from terraphi.surrogate.kronecker import single_threaded
from terraphi.surrogate.paper import LegSurrogate
from terraphi.surrogate.training import DENSITY

log = logging.getLogger(__name__)

NODES = {None: 401, "calibrated": 401, "paper": 4001}
"""Nodes of the quadrature to begin with."""
CURVES = 401
"""Angles at which the paper's surrogate is asked for what would explain a record."""
DRAWS = 4000
"""Draws that stand for the noise and the discrepancy that were inferred."""
UNSEEN = 0.01
"""Offset, of peak-to-peak, that a sensor may have whose zero no reading shows [-]: about that of
the shipped measurements in air."""
FOUND_OUT = 16.0
"""Chi-square that an offset adds to a record that shows it to be a misfit."""
BULK = (600.0, 800.0, 1000.0, 1300.0, 1700.0, 2200.0)
"""Bulk densities that are tried where one is assumed: from light grains to heavy, dense ones
[kg/m3]."""


@dataclass(frozen=True, eq=False)
class _Leg:
    """All histories of one leg, with their likelihood.

    Attributes
    ----------
    group
        The histories.
    through
        What they are compared with.
    scale
        Density of the soil over that of the library [-].
    surrogate
        Of the library's curves, at the library's density.
    nodes
        Friction angles at which records are explained [deg], and the curves there [N].
    of
        Log-likelihood of the mean [N], shape [2 theta], of a number of its histories.
    """

    group: Repeats
    through: Through
    scale: float
    surrogate: LegSurrogate | JointSurrogate
    nodes: tuple[FloatArray, FloatArray]
    of: Callable[[FloatArray, int], LogLikelihood]

    @property
    def bounds_deg(self) -> tuple[float, float]:
        """Range of the library's angles [deg]."""
        return self.surrogate.phi_bounds_deg

    def predict(self, phi_deg: ArrayLike) -> FloatArray:
        """Curves at friction angles, at the density of the soil [N], [k] -> [k, 2 theta]."""
        return self.surrogate.predict(phi_deg, scale=self.scale)

    @cached_property
    def whole(self) -> LogLikelihood:
        """Log-likelihood of all its histories."""
        return self.of(self.group.mean, len(self.group.trials))

    @cached_property
    def each(self) -> list[LogLikelihood]:
        """That of each history by itself."""
        if len(self.group.trials) == 1:
            return [self.whole]
        return [self.of(vector, 1) for vector in self.group.vectors]


@dataclass(frozen=True, eq=False)
class _Found:
    """What was found of the friction angle.

    Attributes
    ----------
    posterior
        Of the soil's angle.
    draws
        Of that by emcee, if it was asked for.
    flat
        The same under a uniform prior.
    core
        Posterior of the library's angle: before the spread of soils about the library is added.
    level
        That spread; ``None``: the soil's angle is the library's.
    prior
        Of the soil's angle.
    """

    posterior: Posterior
    draws: Draws | None
    flat: Posterior
    core: Posterior
    level: Level | None
    prior: Marginal

    @property
    def library_angle(self) -> dict[str, float]:
        """The library's angle, and its error, with that of an assumed density [deg]."""
        by_density = self.level.parts_deg.get("density", 0.0) if self.level else 0.0
        sd = float(np.hypot(self.core.sd, by_density))
        return {"median": self.core.median, "sd": sd}

    def in_library(self, phi_deg: ArrayLike, leg: _Leg) -> FloatArray:
        """Angles of the library's curves that stand for angles of the soil [deg], [k] -> [k]."""
        offset = self.level.offset_deg if self.level else 0.0
        return np.clip(np.asarray(phi_deg) - offset, *leg.bounds_deg)


def infer(looked: Looked, library: Library, ways: Ways) -> Inversion:
    """Infer the friction angle.

    Parameters
    ----------
    looked
        The histories, without what is not to be believed of them.
    library
        Simulations over φ.
    ways
        How to.

    Raises
    ------
    InputError
        If a history, a leg, the density or an option cannot be used.
    """
    if ways.likelihood == "joint":
        raise InputError(
            "likelihood 'joint' is that of several parameters; φ alone has 'calibrated' or 'paper'"
        )
    if ways.steps is not None:
        raise InputError(
            f"steps = {ways.steps}: they are those of several parameters; φ alone is inferred by "
            "quadrature, and drawn by emcee as in the paper: leave them out"
        )
    by_paper, density = ways.likelihood == "paper", ways.density
    # What the paper's surrogate learns depends in its last digits on how sums are split.
    with nullcontext() if by_paper else single_threaded():
        legs = [_leg(group, looked, library, ways) for group in looked.groups]
        # After the library is ready: the time that one more history takes.
        began = time.perf_counter()
        found = _posterior(legs, ways)
        seconds = time.perf_counter() - began
        records, verdict, warnings, budget = _judged(looked, legs, found, ways)
    warnings += uninformed(found.flat)
    scenario, posterior = legs[0].through.scenario, found.posterior
    draws = found.draws
    if draws is not None and not draws.converged:
        warnings.append(Doubt("not_converged"))
    summary = Summary.of_posterior(posterior) if draws is None else Summary.of(draws.flat)
    # A calibrated angle is one of plane strain, as those of the known soils are.
    calibrated = ways.calibration is not None
    equivalent, why_not = plane_strain_summary(summary, scenario)
    if calibrated:
        equivalent, why_not = AngleSummary(summary.median, summary.ci68, summary.ci95), ""
    used = scenario.soil.density if density is None else density
    priors = {PHI: found.prior}
    if density is not None:
        priors[DENSITY] = Marginal(density, density)
    return Inversion(
        records=tuple(records),
        library=library.name,
        convention="plane_strain" if calibrated else scenario.convention,
        likelihood="paper" if by_paper else "calibrated",
        sampler="quadrature" if draws is None else "emcee",
        seed=None if draws is None else ways.seed,
        marginal={PHI: summary},
        priors=priors,
        of_phi=posterior,
        phi_plane_strain=equivalent,
        plane_strain_reason=why_not,
        density=used,
        density_assumed=ways.density_assumed,
        verdict=damaged(verdict) if looked.spoilt else verdict,
        warnings=tuple(warnings),
        budget=budget,
        together=_together(legs, found, used, ways) if looked.several else None,
        draws=draws,
        provenance={
            "core_seconds": seconds,
            "library_angle_deg": found.library_angle,
            "library_phi_deg": list(found.core.bounds_deg),
        },
    )


def _leg(group: Repeats, looked: Looked, library: Library, ways: Ways) -> _Leg:
    """Make a leg of the library ready, and the likelihood of its histories."""
    readings, prepared = group.readings, None
    ours = all(trial.made_as(library.cases[0].scenario) for trial in looked.trials)
    # A history of the library's own grid and speed-up has the error that finer cases take away.
    library = library.as_simulated if ours else library
    if ways.likelihood != "paper":
        legs = len(looked.groups) if library.fine else 1
        prepared = prepare(library, group.leg, readings=readings, legs=legs)
    curves = prepared.curves if prepared else library.curves(group.leg, readings=readings)
    check_trials(group, curves.scenario, ways.density)
    scale = 1.0 if ways.density is None else ways.density / curves.scenario.soil.density
    density = scale * curves.scenario.soil.density
    shared = group, Through(curves.scenario, scale * curves.vectors, density), scale
    if prepared is None:
        surrogate = LegSurrogate.fit(curves.phi_deg, curves.theta_deg, curves.Fx, curves.Fz)
        angles = np.linspace(*surrogate.phi_bounds_deg, CURVES)

        def by_paper(vector: FloatArray, _trials: int) -> LogLikelihood:
            likelihood = PaperLikelihood(vector, surrogate.theta_deg)
            return lambda phi_deg: likelihood(surrogate.predict(phi_deg, scale=scale))

        return _Leg(*shared, surrogate, (angles, surrogate.predict(angles, scale=scale)), by_paper)
    looked.check_noise(ways.noise)
    learnt = _learnt(looked, library, ways.discrepancy, group.leg)
    wrong = learnt is not None or ways.discrepancy == "gp" or not (ours or ways.discrepancy)
    each = group.window_covariances
    shape, sigma = shape_of(ways.noise, each[0] if len(each) == 1 else np.mean(each, axis=0))

    def calibrated(vector: FloatArray, trials: int) -> LogLikelihood:
        data = vector / scale
        size = None if sigma is None else sigma / scale / np.sqrt(trials)
        problem = Problem(prepared.averaged(trials).read_for(data), data, shape, size, wrong)
        if learnt is not None:
            return SoilLikelihood(problem, learnt, group.leg)
        return CalibratedLikelihood(problem)

    nodes = prepared.phi_deg, scale * prepared.mean
    return _Leg(*shared, prepared.surrogate, nodes, calibrated)


def _learnt(
    looked: Looked, library: Library, asked: str | Learnt | None, leg: str
) -> Learnt | None:
    """The discrepancy of real soils, for measured records or where it is asked for."""
    if asked in ("none", "gp"):
        return None
    learnt = asked if isinstance(asked, Learnt) else learnt_for(library)
    there = learnt and learnt.library_hash == library.hash and leg in learnt.shapes
    if asked and not there:
        raise InputError(
            f"discrepancy 'soils': none was learnt for leg '{leg}' of library '{library.name}'; "
            "take 'gp'"
        )
    return learnt if there and (asked or not looked.trials[0].simulation) else None


def _level(legs: Sequence[_Leg], ways: Ways, core: Posterior) -> Level | None:
    """How the angle of a soil lies about that of the library; ``None``: it is the same."""
    soils = [leg.whole for leg in legs if isinstance(leg.whole, SoilLikelihood)]
    learnt = soils[0].learnt if soils else None
    level = learnt.level if learnt else None
    if ways.calibration is not None:
        if learnt is None:
            ways.calibration.check_legs(leg.group.leg for leg in legs)
        level = ways.calibration.level(core.median, learnt)
    if level is None or not soils or not ways.density_assumed:
        return level
    return level.wider("density", float(np.mean([one.by_density_deg for one in soils])))


def _common(legs: Sequence[_Leg]) -> tuple[float, float]:
    """Ends of the friction angles that the library has of all legs [deg]."""
    low, high = max(leg.bounds_deg[0] for leg in legs), min(leg.bounds_deg[1] for leg in legs)
    if not low < high:
        raise InputError("the legs of the library have no friction angles in common")
    return low, high


def _added(likelihoods: Iterable[LogLikelihood]) -> LogLikelihood:
    """Log likelihood of what errs independently."""
    every = list(likelihoods)
    return lambda phi_deg: sum((one(phi_deg) for one in every), np.zeros_like(phi_deg))


def _posterior(legs: Sequence[_Leg], ways: Ways) -> _Found:
    """Posterior of φ by all legs."""
    low, high = _common(legs)
    likelihood = _added(leg.whole for leg in legs)
    nodes, prior = NODES[ways.likelihood], ways.priors.get(PHI)
    core = level = None
    if ways.calibration or _soils(legs):
        core = quadrature(likelihood, (low, high), nodes=nodes)
        level = _level(legs, ways, core)
    if core and level:
        low, high = level.bounds(low, high)
        likelihood = _about(level, core)
    every = low, high
    if prior is not None and (level is None or prior.normal is None):
        low, high = max(low, prior.low), min(high, prior.high)
    if not low < high:
        raise InputError("the prior leaves no friction angle that all legs of the library have")
    known = Marginal(low, high, None if prior is None else prior.normal)
    log.info("sampling φ over %g to %g deg by %s", low, high, ways.sampler or "quadrature")
    log_p = likelihood if known.normal is None else _times(likelihood, known)
    posterior = quadrature(log_p, (low, high), nodes=nodes)
    draws = drawn(log_p, posterior, seed=ways.seed) if ways.sampler == "emcee" else None
    flat = posterior
    if known.normal is not None:
        flat = quadrature(likelihood, every, nodes=nodes)
    return _Found(posterior, draws, flat, core or posterior, level, known)


def drawn(log_p: LogLikelihood, exact: Posterior, *, seed: int) -> Draws:
    """Draws of a posterior by emcee, as in the paper (Xu & Wang), to compare with the exact one.

    A sampler asks tens of thousands of times, so the log density is interpolated between the nodes
    of the quadrature, which resolve it.
    """
    low, high = exact.bounds_deg
    at_nodes = log_p(exact.phi_deg)

    def log_posterior(points: FloatArray) -> FloatArray:
        phi = points[:, 0]
        inside = (phi >= low) & (phi <= high)
        return np.where(inside, np.interp(phi, exact.phi_deg, at_nodes), -np.inf)

    def draw_prior(count: int, rng: np.random.Generator) -> FloatArray:
        return rng.uniform(low, high, (count, 1))

    return sample(log_posterior, draw_prior, seed=seed)


def _about(level: Level, core: Posterior) -> LogLikelihood:
    """Log-likelihood of a soil's angle, by that of the library's."""
    return lambda phi_deg: level.log_density(core, phi_deg)


def _matched(
    looked: Looked, leg: _Leg, found: _Found, ways: Ways
) -> tuple[list[Matched], Budget | None]:
    """The histories of a leg beside the best curve, and the budget of the last were it alone.

    That curve is the one at the median, or at the library's end if that lies beyond.
    """
    best = leg.predict(found.in_library([found.posterior.median], leg))[0]
    angles = np.linspace(*found.posterior.interval(0.95), 101)
    inside = leg.predict(found.in_library(angles, leg))
    band = np.stack([inside.min(axis=0), inside.max(axis=0)])
    # What refining leaves open is so wide that a poor fit to real soil would pass for a good one.
    refined = isinstance(leg.surrogate, JointSurrogate) and leg.surrogate.correction is not None
    expected = isinstance(leg.whole, SoilLikelihood) or looked.trials[0].simulation
    hidden = refined and not expected
    limit = NRMSD_LIMIT if hidden or ways.likelihood == "paper" else None
    seen, budget = [], None
    every = looked.beside(leg.group, leg.through, best, leg.nodes, most=limit)
    for one, likelihood in zip(every, leg.each, strict=True):
        own, budget = _fit_of(likelihood, found, leg, source=looked.name_of(one.trial))
        record = replace(one.record, band=band)
        if isinstance(likelihood, SoilLikelihood):
            record = replace(record, expected=likelihood.learnt.expected(leg.group.leg, best))
        one = one._replace(record=record, measures=[*own, *one.measures])
        if isinstance(likelihood, SoilLikelihood) and own[0].exceeded and not one.why.question:
            why = replace(one.why, question=_by_one_factor(one, leg, ways))
            one = one._replace(why=why)
        seen.append(one)
    return seen, budget


def _by_one_factor(one: Matched, leg: _Leg, ways: Ways) -> Doubt | None:
    """A question on unit or density if one factor makes a misfit deviate as known soils do.

    Real soils deviate from the library too much for `explanation` to see that in the forces alone.
    """
    vector, used = one.record.observation.vector, one.through.density

    def known(forces: FloatArray) -> bool:
        soil, (low, high) = leg.of(forces, 1), USUAL_DEG
        if not isinstance(soil, SoilLikelihood) or not low <= soil.fitted.angle_deg <= high:
            return False
        return not replace(one.measures[0], value=soil.deviation).exceeded

    for code in ("pounds_force", "kilograms_force"):
        if known(SLIPS[code](vector.reshape(2, -1)).ravel()):
            return Doubt(code)
    if ways.density_assumed and used and any(known(vector * used / rho) for rho in BULK):
        return Doubt("assumed_density", {"used": used})
    return None


def _judged(
    looked: Looked,
    legs: Sequence[_Leg],
    found: _Found,
    ways: Ways,
) -> tuple[list[Record], Verdict, list[Doubt], Budget | None]:
    """Records, verdict, doubts, and the budget, which knows of no normal prior: then it is none."""
    normal, budget = found.prior.normal, None
    every: list[Matched] = []
    for leg in legs:
        seen, budget = _matched(looked, leg, found, ways)
        every += seen
    measures = [measure for one in every for measure in one.measures]
    soils = _soils(legs)
    if looked.several:
        if soils:
            # The deviation of all measured histories: the geometric mean of those of each.
            mean = float(np.exp(np.mean([np.log(one.deviation) for one in soils])))
            most = soils[0].learnt.most()
            measures.append(Measure("soil_deviation", mean, most=most, about="all"))
        measures.append(_agreement(legs, found))
    if normal is not None:
        measures.append(_against(found.flat, normal))
    worst = max(soils, key=lambda one: one.deviation, default=None)
    verdict = judge(
        measures,
        _edge(legs, found, ways),
        kind="soil" if worst else ways.likelihood or "calibrated",
        beyond=beyond(every),
        numbers=worst.learnt.where(worst.leg, worst.fitted) if worst else None,
    )
    budget = None if looked.several or normal is not None else budget
    warnings = looked.damage
    if verdict.verdict == "consistent" and budget is not None:
        warnings += _zero(looked, found.posterior, budget)
    warnings += looked.doubts(every, misfit=verdict.verdict == "misfit")
    return [one.record for one in every], verdict, warnings, budget


def _fit_of(
    likelihood: LogLikelihood, found: _Found, leg: _Leg, *, source: str
) -> tuple[list[Measure], Budget | None]:
    """How well one history fits, and where the interval would come from if it were alone."""
    if isinstance(likelihood, SoilLikelihood):
        own = [likelihood.measure(source=source, accepted=ALONE if source else ACCEPTED)]
        return own, likelihood.budget(found.level, scale=leg.scale) if found.level else None
    if isinstance(likelihood, CalibratedLikelihood):
        fit = fit_without_discrepancy(likelihood.problem, likelihood.without, scale=leg.scale)
        (phi,) = found.in_library([found.posterior.median], leg).tolist()
        budget = budget_of(likelihood, phi, fit, scale=leg.scale)
        if found.level:
            budget = replace(budget, degrees={**budget.degrees, **found.level.parts_deg})
        return fit_measures(fit, source=source), budget
    return [], None


def _soils(legs: Sequence[_Leg]) -> list[SoilLikelihood]:
    """Likelihoods of measured histories, each by itself."""
    return [one for leg in legs for one in leg.each if isinstance(one, SoilLikelihood)]


def _edge(legs: Sequence[_Leg], found: _Found, ways: Ways) -> Edge:
    """Where the posterior, or that of the library's angle, is cut off."""
    name, bounds = legs[0].through.scenario.convention, found.posterior.bounds_deg
    if ways.likelihood == "paper":
        step = float(np.diff(legs[0].surrogate.phi_deg).max())
        edge = edge_of(edge_masses(found.posterior, step), bounds, "edge_mass", name=name)
    else:
        edge = max(
            (
                edge_of(edge_densities(one), one.bounds_deg, "edge_density", name=name)
                for one in (found.core, found.posterior)
            ),
            key=lambda one: one.size,
        )
    whose = "library" if edge.numbers["at"] in _common(legs) else "prior"
    return replace(edge, numbers={**edge.numbers, "of": whose})


def _zero(looked: Looked, posterior: Posterior, budget: Budget) -> list[Doubt]:
    """A doubt if a zero that may be off matters: noise hides an offset of a per cent or two.

    A history that was simulated has no sensor, and beside the spread between real soils no zero
    matters.
    """
    (trial,), (inspection,) = looked.trials, looked.inspections
    if trial.simulation or budget.offset is None:
        return []
    span = np.ptp(np.stack([trial.history.Fx, trial.history.Fz]), axis=1)
    hidden = np.minimum(UNSEEN * span, np.sqrt(FOUND_OUT / budget.offset.chi2_per_N2))
    sizes = hidden if inspection.zero_N is None else np.minimum(hidden, inspection.zero_N)
    moves = np.abs(budget.offset.deg_per_N * sizes)
    axis = int(moves.argmax())
    force, size, change = ("Fx", "Fz")[axis], float(sizes[axis]), float(moves[axis])
    numbers = {"force": force, "size_N": size, "moves_deg": change}
    doubt = Doubt("zero_unseen", numbers)
    low, high = posterior.interval(0.68)
    # Half its half-width: 95 % intervals then hold 92 %.
    return [doubt] if change > 0.25 * (high - low) else []


def _agreement(legs: Sequence[_Leg], found: _Found) -> Measure:
    """How probable it is that histories of one angle differ as much."""
    from scipy.special import chdtrc

    each = [likelihood for leg in legs for likelihood in leg.each]
    # Where they are likelihoods of the library's angle, a soil's may lie beyond either end.
    ends = zip(found.core.bounds_deg, found.posterior.bounds_deg, strict=True)
    (low, _), (_, high) = map(sorted, ends)
    bounds, nodes = (low, high), NODES["calibrated"]

    def top(log_p: LogLikelihood) -> float:
        return float(log_p(quadrature(log_p, bounds, nodes=nodes).phi_deg).max())

    lost = 2.0 * (sum(map(top, each)) - top(_added(each)))
    probability = float(chdtrc(len(each) - 1, max(lost, 0.0)))
    return Measure("agreement", probability, least=SMALLEST_PROBABILITY)


def _against(free: Posterior, normal: tuple[float, float]) -> Measure:
    """How probable it is that the forces and a normal prior differ as much."""
    from scipy.special import chdtrc

    mean, sd = normal
    apart = (free.median - mean) ** 2 / (free.sd**2 + sd**2)
    return Measure("prior_agreement", float(chdtrc(1, apart)), least=SMALLEST_PROBABILITY)


def _times(likelihood: LogLikelihood, prior: Marginal) -> LogLikelihood:
    """Log density of a likelihood and a prior."""
    return lambda phi_deg: likelihood(phi_deg) + prior.log_density(phi_deg)


def _together(legs: Sequence[_Leg], found: _Found, density: float, ways: Ways) -> Together:
    """What each leg adds, and the noise and discrepancy that were inferred of all."""
    posterior, level, sd = found.posterior, found.level, {}
    for leg in legs:
        alone, bounds = leg.whole, posterior.bounds_deg
        if level is not None:
            alone = _about(level, quadrature(alone, leg.bounds_deg, nodes=NODES[ways.likelihood]))
        density_of = _times(alone, found.prior)
        sd[leg.group.leg] = quadrature(density_of, bounds, nodes=NODES[ways.likelihood]).sd
    sd["all"] = posterior.sd
    rng = np.random.default_rng(ways.seed)
    errors = [_errors(leg, found, DRAWS // len(legs), rng) for leg in legs]
    noise, amplitude = map(np.concatenate, zip(*errors, strict=True))
    parts = (leg.whole for leg in legs)
    wrong = any(isinstance(p, CalibratedLikelihood) and p.problem.discrepancy for p in parts)
    summary = Summary.of_posterior(posterior)
    return Together(
        conditional={PHI: summary},
        point={PHI: summary.median, DENSITY: density},
        identifiability=Identifiability.of((PHI,), np.array([[posterior.sd**2]]), [found.prior.sd]),
        expected_sd={name: np.array([one]) for name, one in sd.items()},
        noise_N=noise,
        amplitude=amplitude,
        discrepancy="soils" if _soils(legs) else "gp" if wrong else "none",
    )


def _errors(
    leg: _Leg, found: _Found, count: int, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Draws of the noise [N] and of the relative discrepancy [-] of a leg's histories."""
    whole, size = leg.whole, np.sqrt(len(leg.group.trials)) * leg.scale
    if isinstance(whole, SoilLikelihood):
        return np.full(2, size * whole.noise_N), np.full(2, whole.learnt.amplitude)
    if isinstance(whole, CalibratedLikelihood):
        weights = whole.weights(float(found.in_library(found.posterior.median, leg)))
        chosen = rng.choice(len(weights), count, p=weights / weights.sum())
        return size * whole.used.noise[chosen], whole.used.amplitude[chosen]
    return np.zeros(1), np.zeros(1)
