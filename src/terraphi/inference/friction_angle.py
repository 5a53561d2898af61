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
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.errors import InputError
from terraphi.experiment.scenario import Scenario
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
from terraphi.inference.checks import doubts, unlike
from terraphi.inference.explanation import OFFSETS, explain
from terraphi.inference.findings import Doubt, Measure, Side, Verdict
from terraphi.inference.fit import SMALLEST_PROBABILITY, fit_without_discrepancy
from terraphi.inference.identifiability import Identifiability
from terraphi.inference.noise import Noise, shape_of, window_covariance
from terraphi.inference.paper_likelihood import PaperLikelihood
from terraphi.inference.posterior import LogLikelihood, Posterior, ensemble, quadrature, tabulated
from terraphi.inference.prepared_leg import prepare
from terraphi.inference.prior import Marginal
from terraphi.inference.trials import Looked, Repeats, Trial, check_trials, read_twice
from terraphi.inference.verdict import (
    NRMSD_LIMIT,
    damaged,
    deviations,
    edge_by_density,
    edge_by_mass,
    fit_measures,
    judge,
    nrmsd,
    uninformed,
)
from terraphi.library.store import Library
from terraphi.surrogate.kronecker import single_threaded
from terraphi.surrogate.paper import LegSurrogate
from terraphi.surrogate.training import DENSITY

FloatArray = NDArray[np.float64]
log = logging.getLogger(__name__)

NODES = {"calibrated": 401, "paper": 4001}
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


@dataclass(frozen=True)
class Ways:
    """How to infer: as in :func:`terraphi.inference.inversion.invert`."""

    likelihood: str
    noise: Noise
    discrepancy: str | None
    sampler: str
    seed: int


@dataclass(frozen=True, eq=False)
class _Leg:
    """All histories of one leg, with their likelihood.

    Attributes
    ----------
    group
        The histories.
    scenario
        Any of the library's for this leg.
    curves
        The library's, at its density [N], shape [case, 2 theta].
    predict
        Curves at friction angles, at the density of the soil [N], [k] -> [k, 2 theta].
    nodes
        Friction angles at which records are explained [deg], and the curves there [N].
    bounds_deg, step_deg
        Range of the library's angles [deg], and their spacing.
    scale
        Density of the soil over that of the library [-].
    of
        Log-likelihood of the mean [N], shape [2 theta], of a number of its histories.
    """

    group: Repeats
    scenario: Scenario
    curves: FloatArray
    predict: Callable[[FloatArray], FloatArray]
    nodes: tuple[FloatArray, FloatArray]
    bounds_deg: tuple[float, float]
    step_deg: float
    scale: float
    of: Callable[[FloatArray, int], LogLikelihood]

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


def infer(
    looked: Looked,
    *,
    library: Library,
    prior: Marginal | None,
    density: float | None,
    density_assumed: bool,
    ways: Ways,
) -> Inversion:
    """Infer the friction angle.

    Parameters
    ----------
    looked
        The histories, without what is not to be believed of them.
    library
        Simulations over φ.
    prior
        Of φ; ``None``: uniform over the library.
    density
        Bulk density of the soil [kg/m³]; ``None`` assumes the library's.
    density_assumed
        Whether a density given is itself a guess.
    ways
        How to.

    Raises
    ------
    InputError
        If a history, a leg or the density cannot be used.
    """
    # What the paper's surrogate learns depends in its last digits on how sums are split.
    threads = nullcontext() if ways.likelihood == "paper" else single_threaded()
    with threads:
        legs = [_leg(group, looked, library, density, ways) for group in looked.groups]
        # After the library is ready: the time that one more history takes.
        began = time.perf_counter()
        posterior, flat, prior = _posterior(legs, prior, ways)
        core = time.perf_counter() - began
        verdict, warnings, budget = _judged(looked, legs, posterior, prior, ways)
    warnings += uninformed(flat)
    scenario = legs[0].scenario
    summary = Summary.of_posterior(posterior)
    phi = AngleSummary(summary.median, summary.ci68, summary.ci95)
    equivalent, why_not = plane_strain_summary(phi, scenario)
    used = scenario.soil.density if density is None else density
    priors = {PHI: prior}
    if density is not None:
        priors[DENSITY] = Marginal(density, density)
    return Inversion(
        records=tuple(r for leg in legs for r in _records(looked, leg, posterior)),
        library=library.name,
        convention=scenario.convention,
        likelihood=ways.likelihood,
        sampler=posterior.sampler,
        seed=posterior.seed,
        marginal={PHI: summary},
        priors=priors,
        of_phi=posterior,
        phi_plane_strain=equivalent,
        plane_strain_reason=why_not,
        density=used,
        density_assumed=density is None or density_assumed,
        verdict=damaged(verdict) if looked.spoilt else verdict,
        warnings=tuple(warnings),
        budget=budget,
        together=_together(legs, posterior, prior, used, ways) if looked.several else None,
        provenance={"core_seconds": core},
    )


def _leg(
    group: Repeats, looked: Looked, library: Library, density: float | None, ways: Ways
) -> _Leg:
    """Make a leg of the library ready."""
    maker = _by_paper if ways.likelihood == "paper" else _calibrated
    return maker(group, looked, library, density, ways)


def _by_paper(
    group: Repeats, looked: Looked, library: Library, density: float | None, _ways: Ways
) -> _Leg:
    """As printed by Xu & Wang."""
    curves = library.curves(group.leg, readings=group.readings)
    scenario = curves.scenario
    check_trials(group, scenario, density=density, several=looked.several)
    surrogate = LegSurrogate.fit(curves.phi_deg, curves.theta_deg, curves.Fx, curves.Fz)
    scale = 1.0 if density is None else density / scenario.soil.density
    nodes = np.linspace(*surrogate.phi_bounds_deg, CURVES)

    def predict(phi_deg: FloatArray) -> FloatArray:
        return surrogate.predict(phi_deg, scale=scale)

    def of(vector: FloatArray, _trials: int) -> LogLikelihood:
        likelihood = PaperLikelihood(vector, group.observations[0].theta_deg)
        return lambda phi_deg: likelihood(predict(phi_deg))

    return _Leg(
        group=group,
        scenario=scenario,
        curves=np.hstack([curves.Fx, curves.Fz]),
        predict=predict,
        nodes=(nodes, predict(nodes)),
        bounds_deg=surrogate.phi_bounds_deg,
        step_deg=surrogate.phi_step_deg,
        scale=scale,
        of=of,
    )


def _calibrated(
    group: Repeats, looked: Looked, library: Library, density: float | None, ways: Ways
) -> _Leg:
    """Every part of the residual with its own covariance."""
    prepared = prepare(library, group.leg, readings=group.readings)
    curves, surrogate = prepared.curves, prepared.surrogate
    check_trials(group, curves.scenario, density=density, several=looked.several)
    scale = 1.0 if density is None else density / curves.scenario.soil.density
    for trial in group.trials:
        ways.noise.check_against(trial.history, source=trial.source if looked.several else "")
    gp = (ways.discrepancy or _default_discrepancy(looked, library)) == "gp"
    shape, sigma = shape_of(ways.noise, _windows(group))

    def predict(phi_deg: FloatArray) -> FloatArray:
        return surrogate.predict(phi_deg, scale=scale)

    def of(vector: FloatArray, trials: int) -> LogLikelihood:
        data = vector / scale
        size = None if sigma is None else sigma / scale / np.sqrt(trials)
        leg = prepared.averaged(trials).read_for(data)
        return CalibratedLikelihood(Problem(leg, data, shape, size, gp))

    return _Leg(
        group=group,
        scenario=curves.scenario,
        curves=np.hstack([curves.Fx, curves.Fz]),
        predict=predict,
        nodes=(prepared.phi_deg, scale * prepared.mean),
        bounds_deg=surrogate.phi_bounds_deg,
        step_deg=surrogate.phi_step_deg,
        scale=scale,
        of=of,
    )


def _windows(group: Repeats) -> FloatArray:
    """Noise covariance of window means, of readings of unit variance; that of each on average."""
    each = [
        window_covariance(t.history.position, o.theta_deg, read_at=group.readings)
        for t, o in zip(group.trials, group.observations, strict=True)
    ]
    return each[0] if len(each) == 1 else np.mean(each, axis=0)


def _default_discrepancy(looked: Looked, library: Library) -> str:
    """None where the library's own model made all histories: the model is right then."""
    scenario = library.cases[0].scenario
    ours = [
        "scenario" in t.history.provenance and not unlike(t.history, scenario, t.leg)
        for t in looked.trials
    ]
    return "none" if all(ours) else "gp"


def _common(legs: Sequence[_Leg]) -> tuple[float, float]:
    """Ends of the friction angles that the library has of all legs [deg]."""
    return max(leg.bounds_deg[0] for leg in legs), min(leg.bounds_deg[1] for leg in legs)


def _whole(legs: Sequence[_Leg]) -> LogLikelihood:
    """Log likelihood of all legs, which err independently."""

    def likelihood(phi_deg: FloatArray) -> FloatArray:
        total = legs[0].whole(phi_deg)
        for leg in legs[1:]:
            total = total + leg.whole(phi_deg)
        return total

    return likelihood


def _posterior(
    legs: Sequence[_Leg], prior: Marginal | None, ways: Ways
) -> tuple[Posterior, Posterior, Marginal]:
    """Posterior of φ by all legs, the same under a uniform prior, and the prior."""
    low, high = _common(legs)
    if prior is not None:
        low, high = max(low, prior.low), min(high, prior.high)
    if not low < high:
        raise InputError("the legs of the library have no friction angles in common")
    known = Marginal(low, high, None if prior is None else prior.normal)
    likelihood = _whole(legs)
    nodes = NODES[ways.likelihood]
    log.info("sampling φ over %g to %g deg by %s", low, high, ways.sampler)
    log_p = likelihood if known.normal is None else _times(likelihood, known)
    if ways.sampler == "emcee":
        table = tabulated(log_p, (low, high), nodes=nodes)
        posterior = ensemble(table, (low, high), seed=ways.seed)
    else:
        posterior = quadrature(log_p, (low, high), nodes=nodes)
    flat = posterior
    if known.normal is not None:
        flat = quadrature(likelihood, (low, high), nodes=nodes)
    return posterior, flat, known


def _records(looked: Looked, leg: _Leg, posterior: Posterior) -> list[Record]:
    """The histories of a leg, with the curve at the median and the band of the 95 %."""
    best = leg.predict(np.array([posterior.median]))[0]
    inside = leg.predict(np.linspace(*posterior.interval(0.95), 101))
    band = np.stack([inside.min(axis=0), inside.max(axis=0)])
    return [
        Record(
            source=trial.source,
            leg=leg.group.leg,
            observation=observation,
            readings=trial.history.position,
            best=best,
            nrmsd=nrmsd(observation.vector, best),
            data=looked.data_of(trial),
            simulation=trial.simulation,
            band=band,
        )
        for trial, observation in zip(leg.group.trials, leg.group.observations, strict=True)
    ]


def _judged(
    looked: Looked, legs: Sequence[_Leg], posterior: Posterior, prior: Marginal, ways: Ways
) -> tuple[Verdict, list[Doubt], Budget | None]:
    """Verdict, doubts, and the budget, which knows of no normal prior: then there is none."""
    measures, warnings, budget = [], looked.damage, None
    questions: list[tuple[Doubt, Trial]] = []
    beyond: set[Side | None] = set()
    for leg in legs:
        best = leg.predict(np.array([posterior.median]))[0]
        trials = zip(leg.group.trials, leg.group.observations, leg.each, strict=True)
        for trial, observation, likelihood in trials:
            source = trial.source if looked.several else ""
            why = explain(observation.vector, leg.nodes[1], leg.nodes[0])
            off = nrmsd(observation.vector, best)
            if isinstance(likelihood, CalibratedLikelihood):
                problem = likelihood.problem
                fit = fit_without_discrepancy(problem, likelihood.without, scale=leg.scale)
                own = [*fit_measures(fit, source=source), *deviations(off, source=source)]
                if not looked.several and prior.normal is None:
                    budget = budget_of(likelihood, posterior.median, fit, scale=leg.scale)
            else:
                own = deviations(off, most=NRMSD_LIMIT, source=source)
            measures += own
            fits = not any(measure.exceeded for measure in own)
            if not fits:
                beyond.add(why.beyond)
            # Noise may hide a flat top, and a smaller angle fit what is left of it.
            if why.question is not None and (not fits or why.question.code == "saturated"):
                questions.append((why.question, trial))
    if looked.several:
        measures.append(_agreement(legs, posterior))
    if prior.normal is not None:
        measures.append(_against(legs, prior.normal, ways))
    convention = legs[0].scenario.convention
    if ways.likelihood == "paper":
        edge = edge_by_mass(posterior, step_deg=legs[0].step_deg, convention=convention)
    else:
        edge = edge_by_density(posterior, convention=convention)
    at_library = edge.numbers["at"] in _common(legs)
    edge = replace(edge, numbers={**edge.numbers, "of": "library" if at_library else "prior"})
    verdict = judge(
        measures,
        edge,
        kind=ways.likelihood,
        beyond=beyond.pop() if len(beyond) == 1 else None,
    )
    if verdict.verdict == "consistent" and budget is not None:
        warnings = [*warnings, *_zero(looked, posterior, budget)]
    misfit = verdict.verdict == "misfit"
    asked = [pair for pair in questions if misfit or pair[0].code == "saturated"]
    return verdict, [*warnings, *_doubts(looked, legs, asked)], budget


def _zero(looked: Looked, posterior: Posterior, budget: Budget) -> list[Doubt]:
    """A doubt if a zero that may be off matters: noise hides an offset of a per cent or two.

    A history that was simulated has no sensor.
    """
    (trial,), (inspection,) = looked.trials, looked.inspections
    if trial.simulation:
        return []
    span = np.ptp(np.stack([trial.history.Fx, trial.history.Fz]), axis=1)
    hidden = np.minimum(UNSEEN * span, np.sqrt(FOUND_OUT / budget.offset_chi2_per_N2))
    sizes = hidden if inspection.zero_N is None else np.minimum(hidden, inspection.zero_N)
    moves = np.abs(budget.offset_deg_per_N * sizes)
    axis = int(moves.argmax())
    force, size, change = ("Fx", "Fz")[axis], float(sizes[axis]), float(moves[axis])
    numbers = {"force": force, "size_N": size, "moves_deg": change}
    doubt = Doubt("zero_unseen", numbers)
    low, high = posterior.interval(0.68)
    # Half its half-width: 95 % intervals then hold 92 %.
    return [doubt] if change > 0.25 * (high - low) else []


def _agreement(legs: Sequence[_Leg], posterior: Posterior) -> Measure:
    """How probable it is that histories of one angle differ as much."""
    from scipy.special import chdtrc

    each = [likelihood for leg in legs for likelihood in leg.each]
    bounds = posterior.bounds_deg
    nodes = NODES["calibrated"]

    def together(phi_deg: FloatArray) -> FloatArray:
        total: FloatArray = np.sum([likelihood(phi_deg) for likelihood in each], axis=0)
        return total

    def top(log_p: LogLikelihood) -> float:
        return float(log_p(quadrature(log_p, bounds, nodes=nodes).phi_deg).max())

    lost = 2.0 * (sum(map(top, each)) - top(together))
    probability = float(chdtrc(len(each) - 1, max(lost, 0.0)))
    return Measure("agreement", probability, least=SMALLEST_PROBABILITY)


def _against(legs: Sequence[_Leg], normal: tuple[float, float], ways: Ways) -> Measure:
    """How probable it is that the forces and a normal prior differ as much."""
    from scipy.special import chdtrc

    mean, sd = normal
    free = quadrature(_whole(legs), _common(legs), nodes=NODES[ways.likelihood])
    apart = (free.median - mean) ** 2 / (free.sd**2 + sd**2)
    return Measure("prior_agreement", float(chdtrc(1, apart)), least=SMALLEST_PROBABILITY)


def _doubts(
    looked: Looked, legs: Sequence[_Leg], questions: Sequence[tuple[Doubt, Trial]]
) -> list[Doubt]:
    """Questions and doubts about each history."""
    found: list[Doubt] = []
    asked = {id(trial): question for question, trial in questions}
    for leg in legs:
        own = leg.scenario.soil.density
        density = leg.scale * own
        for trial, observation in zip(leg.group.trials, leg.group.observations, strict=True):
            question = asked.get(id(trial))
            # A zero that is seen to be off is told as such.
            if looked.spoilt and question is not None and question.code in OFFSETS:
                question = None
            said = [question, unlike(trial.history, leg.scenario, leg.group.leg)]
            curves = leg.scale * leg.curves
            is_asked = question is not None
            said += doubts(trial.history, observation, curves, density, asked=is_asked)
            source = trial.source if looked.several else ""
            found += [replace(one, source=source) for one in said if one is not None]
        found += read_twice(leg.group)
    return found


def _times(likelihood: LogLikelihood, prior: Marginal) -> LogLikelihood:
    """Log density of a likelihood and a prior."""
    return lambda phi_deg: likelihood(phi_deg) + prior.log_density(phi_deg)


def _together(
    legs: Sequence[_Leg], posterior: Posterior, prior: Marginal, density: float, ways: Ways
) -> Together:
    """What each leg adds, and the noise and discrepancy that were inferred of all."""
    sd = {
        leg.group.leg: quadrature(
            _times(leg.whole, prior), posterior.bounds_deg, nodes=NODES[ways.likelihood]
        ).sd
        for leg in legs
    }
    sd["all"] = posterior.sd
    noise, amplitude = [np.zeros(1)], [np.zeros(1)]
    rng = np.random.default_rng(ways.seed)
    for leg in legs:
        if isinstance(leg.whole, CalibratedLikelihood):
            used = leg.whole.used
            weights = leg.whole.weights(posterior.median)
            drawn = rng.choice(len(weights), DRAWS // len(legs), p=weights / weights.sum())
            root = np.sqrt(len(leg.group.trials))
            noise.append(root * leg.scale * used.noise[drawn])
            amplitude.append(used.amplitude[drawn])
    some = slice(1, None) if len(noise) > 1 else slice(None)
    summary = Summary.of_posterior(posterior)
    return Together(
        conditional={PHI: summary},
        point={PHI: summary.median, DENSITY: density},
        identifiability=Identifiability.of((PHI,), np.array([[posterior.sd**2]]), [prior.sd]),
        expected_sd={name: np.array([one]) for name, one in sd.items()},
        noise_N=np.concatenate(noise[some]),
        amplitude=np.concatenate(amplitude[some]),
        discrepancy="gp" if any(_allows(leg.whole) for leg in legs) else "none",
    )


def _allows(likelihood: LogLikelihood) -> bool:
    """Whether a likelihood allows for a discrepancy."""
    return isinstance(likelihood, CalibratedLikelihood) and likelihood.problem.discrepancy
