"""Several parameters at once, from one history or several: draws of a posterior by emcee."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from terraphi.experiment.arrays import FloatArray
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
from terraphi.inference.explanation import explain
from terraphi.inference.findings import Doubt, Side, Verdict
from terraphi.inference.identifiability import Identifiability, label
from terraphi.inference.noise import Noise, window_covariance
from terraphi.inference.posterior import Posterior, quadrature
from terraphi.inference.prior import Marginal
from terraphi.inference.sampler import Draws, sample
from terraphi.inference.target import JointLikelihood, LegLikelihood, Target
from terraphi.inference.trials import Looked, Repeats, Tried, beyond, check_trials
from terraphi.inference.verdict import (
    AT_EDGE,
    EDGE_DENSITY,
    NRMSD_LIMIT,
    Edge,
    damaged,
    deviations,
    judge,
    nrmsd,
)
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


def infer(
    looked: Looked,
    *,
    library: Library,
    priors: Mapping[str, Marginal],
    density_assumed: bool,
    noise: Noise,
    discrepancy: str | None,
    seed: int,
    steps: int,
) -> Inversion:
    """Infer the parameters that a library varies.

    Parameters
    ----------
    looked
        The histories, without what is not to be believed of them.
    library
        Simulations over the parameters.
    priors
        Of each parameter.
    density_assumed
        Whether a density that is known is a guess.
    noise, discrepancy, seed, steps
        As in :func:`terraphi.inference.inversion.invert`.

    Raises
    ------
    InputError
        If a history, a leg or a prior cannot be used.
    """
    groups = looked.groups
    keys = tuple(k for k, p in priors.items() if not p.fixed)
    with single_threaded():
        data = _checked(looked, library, priors)
        ours = all(t.made_as(d) for g, d in zip(groups, data, strict=True) for t in g.trials)
        gp = discrepancy == "gp" or (discrepancy is None and not ours)
        size, ratio = _window_noise(noise, groups, several=looked.several)
        likelihood = JointLikelihood(
            tuple(
                LegLikelihood(DesignSurrogate.fit(d), g.vectors, ratio)
                for g, d in zip(groups, data, strict=True)
            )
        )
        target = Target(likelihood, priors, keys, size, gp)
        draws = sample(
            target.at,
            target.draw_prior,
            parameters=target.parameters,
            seed=seed,
            steps=steps,
            walkers=max(32, 4 * len(keys)),
        )
        return _answer(looked, data, library, target, draws, density_assumed)


def _checked(looked: Looked, library: Library, marginals: Mapping[str, Marginal]) -> list[Training]:
    """What the library holds of each leg; refuses trials that it cannot be compared with."""
    found = []
    for group in looked.groups:
        data = training(library, group.leg, readings=group.readings)
        density = _fixed(marginals, DENSITY)
        check_trials(group, data.scenario, data.bounds, density, several=looked.several)
        cohesive = data.scenario.soil.cohesion > 0.0
        if DENSITY in marginals and DENSITY not in data.bounds and cohesive:
            raise InputError(
                "the library's soil has cohesion, and its forces are not proportional to the "
                "density; vary soil.density in the library"
            )
        found.append(data)
    return found


def _density_of(marginals: Mapping[str, Marginal], data: Training) -> float | None:
    """Density that a leg is inverted with [kg/m3], known or assumed; ``None`` if it is inferred."""
    if DENSITY in marginals:
        return _fixed(marginals, DENSITY)
    return data.scenario.soil.density


def _fixed(marginals: Mapping[str, Marginal], key: str) -> float | None:
    """Value of a parameter that is known; ``None`` if it is not one, or inferred."""
    known = marginals.get(key)
    return known.low if known is not None and known.fixed else None


def _window_noise(
    noise: Noise, groups: Sequence[Repeats], *, several: bool = True
) -> tuple[float | None, tuple[float, float]]:
    """Standard deviation of a window mean of the noisier force [N], and of both over it [-].

    ``None`` if it is to be inferred. Noise counts as white from window to window; as neighbours
    share a reading, which makes their errors alike, its size is that of the part they share.
    """
    if noise.sigma_N is None:
        return None, (1.0, 1.0)
    for trial in (t for g in groups for t in g.trials):
        noise.check_against(trial.history, source=trial.source if several else "")
    shares = [
        np.median(
            window_covariance(t.history.position, o.theta_deg, read_at=g.readings).sum(axis=1)
        )
        for g in groups
        for t, o in zip(g.trials, g.observations, strict=True)
    ]
    largest = max(noise.sigma_N)
    x, z = (s / largest if largest > 0.0 else 1.0 for s in noise.sigma_N)
    return float(largest * np.sqrt(np.mean(shares))), (x, z)


def _answer(
    looked: Looked,
    data: Sequence[Training],
    library: Library,
    target: Target,
    draws: Draws,
    density_assumed: bool,
) -> Inversion:
    groups = looked.groups
    d, scenario = len(target.keys), library.cases[0].scenario
    flat = draws.values.reshape(-1, draws.values.shape[-1])
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
        draws=draws,
    )
    records = _records(looked, target, point)
    tried = _tried(records, groups, target, point)
    verdict = _judge(target, flat, identifiability, records, beyond=beyond(tried))
    warnings = [*looked.damage, *_doubts(looked, data, target, tried, verdict)]
    if not draws.converged:
        warnings.append(Doubt("not_converged"))
    return Inversion(
        records=records,
        library=library.name,
        convention=scenario.convention,
        likelihood="joint",
        sampler="emcee",
        seed=draws.seed,
        marginal=marginal,
        priors=target.priors,
        of_phi=_of_phi(draws, target),
        phi_plane_strain=equivalent,
        plane_strain_reason=why_not,
        density=known,
        density_assumed=known is not None and (density_assumed or DENSITY not in point),
        verdict=damaged(verdict) if looked.spoilt else verdict,
        warnings=tuple(warnings),
        together=together,
    )


def _of_phi(draws: Draws, target: Target) -> Posterior | None:
    """Posterior of φ by the draws, if it was inferred."""
    if PHI not in target.keys:
        return None
    i, prior = target.keys.index(PHI), target.priors[PHI]
    drawn = np.ascontiguousarray(draws.values[..., i])
    ordered = np.sort(drawn, axis=None)
    return Posterior(
        bounds_deg=(prior.low, prior.high),
        phi_deg=ordered,
        cdf=(np.arange(ordered.size) + 0.5) / ordered.size,
        draws_deg=drawn,
        sampler="emcee",
        seed=draws.seed,
        convergence=draws.diagnostics[i].as_dict(),
    )


def _records(looked: Looked, target: Target, point: Mapping[str, float]) -> tuple[Record, ...]:
    """The histories leg by leg, with the curve at the best point."""
    at = {k: np.array([v]) for k, v in point.items()}
    found = []
    for group, leg in zip(looked.groups, target.likelihood.legs, strict=True):
        best = leg.surrogate.predict(at)[0][0]
        for trial, seen in zip(group.trials, group.observations, strict=True):
            found.append(
                Record(
                    source=trial.source,
                    leg=group.leg,
                    observation=seen,
                    readings=trial.history.position,
                    best=best,
                    nrmsd=nrmsd(seen.vector, best),
                    data=looked.data_of(trial),
                    simulation=trial.simulation,
                    leg_assumed=trial.leg_assumed,
                )
            )
    return tuple(found)


def _tried(
    records: Sequence[Record],
    groups: Sequence[Repeats],
    target: Target,
    point: Mapping[str, float],
) -> list[Tried]:
    """What would explain each history, on the curves over φ through the best point."""
    if PHI not in target.keys:
        return []
    phi = np.linspace(target.priors[PHI].low, target.priors[PHI].high, CURVES)
    along = {k: np.full(CURVES, v) for k, v in point.items()} | {PHI: phi}
    curves = {
        group.leg: leg.surrogate.predict(along)[0]
        for group, leg in zip(groups, target.likelihood.legs, strict=True)
    }
    trials = (trial for group in groups for trial in group.trials)
    return [
        Tried(
            trial,
            explain(r.observation.vector, curves[r.leg], phi),
            fits=max(r.nrmsd.values()) <= NRMSD_LIMIT,
        )
        for trial, r in zip(trials, records, strict=True)
    ]


def _doubts(
    looked: Looked,
    data: Sequence[Training],
    target: Target,
    tried: Sequence[Tried],
    verdict: Verdict,
) -> list[Doubt]:
    """Questions and doubts about each history."""
    found: list[Doubt] = []
    for group, one in zip(looked.groups, data, strict=True):
        density, curves = _density_of(target.priors, one), one.forces
        if density is not None:
            curves = curves * (density / one.density)[:, None]
        found += looked.doubts_on(
            group, one.scenario, curves, density, tried=tried,
            misfit=verdict.verdict == "misfit", varied=one.bounds,
        )  # fmt: skip
    return found


def _plane_strain(
    marginal: Mapping[str, Summary], target: Target, scenario: Scenario
) -> tuple[AngleSummary | None, str]:
    """The friction angle as one of plane strain, or why there is none."""
    if PHI not in target.keys:
        return None, "the friction angle was not inferred"
    if DILATION in target.keys and scenario.soil.yield_criterion == "triaxial":
        return None, "it depends on the dilation angle, which was inferred as well"
    dilation = _fixed(target.priors, DILATION)
    if dilation is not None:
        scenario = scenario.replace(**{DILATION: dilation})
    phi = marginal[PHI]
    return plane_strain_summary(AngleSummary(phi.median, phi.ci68, phi.ci95), scenario)


def _conditional(target: Target, best: FloatArray, i: int) -> Summary:
    """One parameter with all else held at the best draw."""

    def along(values: FloatArray) -> FloatArray:
        points = np.repeat(best[None], len(values), axis=0)
        points[:, i] = values
        return target(points)

    prior = target.marginals[i]
    found: Posterior = quadrature(along, (prior.low, prior.high), nodes=401)
    ends = found.interval(0.68)
    sd = 0.5 * (ends[1] - ends[0])
    return Summary(found.median, sd, ends, found.interval(0.95))


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
        for group, leg in zip(groups, target.likelihood.legs, strict=True)
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
    records: Sequence[Record],
    *,
    beyond: Side | None = None,
) -> Verdict:
    """A misfit if forces deviate; out of range if an edge cuts off a parameter that was learnt."""
    several = len(records) > 1
    fit = [
        measure
        for record in records
        for measure in deviations(
            record.nrmsd, most=NRMSD_LIMIT, source=record.source if several else ""
        )
    ]
    edges = {
        key: _edge(key, target.priors[key], flat[:, i])
        for i, key in enumerate(target.keys)
        if identifiability.kinds[key] != "open"
    }
    worst = max(records, key=lambda record: max(record.nrmsd.values()))
    at = max(edges, key=lambda key: edges[key].size, default="")
    name = worst.source or "the history"
    # It is beyond an end of φ that the forces would fit.
    return judge(
        fit,
        edges.get(at),
        kind="parameters",
        beyond=beyond if at == PHI else None,
        numbers={"worst": name},
    )


def _edge(key: str, prior: Marginal, values: FloatArray) -> Edge:
    """The edge of a prior where the density is larger."""
    counts, _ = np.histogram(values, bins=round(1.0 / EDGE), range=(prior.low, prior.high))
    cuts = zip(prior.cut_off, (counts[0], counts[-1]), strict=True)
    low, high = (float(count / counts.max()) if cut else 0.0 for cut, count in cuts)
    name, unit = label(key)
    numbers = {"at": prior.low if low >= high else prior.high, "unit": unit, "name": name}
    side: Side = "low" if low >= high else "high"
    return Edge(side, max(low, high), EDGE_DENSITY, AT_EDGE, "edge_density", numbers)
