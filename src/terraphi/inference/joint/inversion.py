"""The joint inversion from end to end: histories, a library and priors in, an answer out."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from terraphi.experiment.errors import InputError, nearest
from terraphi.experiment.scenario import Scenario
from terraphi.forward import package_version
from terraphi.inference.answer import AngleSummary, plane_strain_summary
from terraphi.inference.defects import Inspection, inspect_record, touches_soil_deg
from terraphi.inference.findings import Doubt, Side, Verdict
from terraphi.inference.joint.answer import PHI, JointInversion, Summary
from terraphi.inference.joint.identifiability import Identifiability, label
from terraphi.inference.joint.prior import Marginal, is_on, priors
from terraphi.inference.joint.sampler import Draws, sample
from terraphi.inference.joint.target import JointLikelihood, LegLikelihood, Target
from terraphi.inference.joint.trials import (
    Repeats,
    Trial,
    check_trials,
    common_density,
    grouped,
    warnings_on,
)
from terraphi.inference.noise import Noise, window_covariance
from terraphi.inference.posterior import Posterior, quadrature
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
from terraphi.surrogate.training import DENSITY, Training, parameters, training

FloatArray = NDArray[np.float64]

DILATION = "soil.dilation_angle_deg"
DISCREPANCIES = ("none", "gp")
SLOPE_STEP = 1e-3
"""Step of differences over a parameter, of its prior standard deviation [-]."""
EDGE = 0.02
"""Width of an edge of a prior, of its span [-]."""


def invert_jointly(
    trials: Sequence[Trial],
    *,
    library: Library,
    prior: Sequence[str] = (),
    density: float | None = None,
    noise: float | str | Path | None = None,
    discrepancy: str | None = None,
    seed: int = 0,
    steps: int = 1500,
) -> JointInversion:
    """Infer the parameters that a library varies from one history or several.

    Parameters
    ----------
    trials
        Histories: several legs, repeated trials.
    library
        Simulations over the parameters, with every leg of the trials.
    prior
        As in :func:`~terraphi.inference.joint.prior.priors`; a prior on ``soil.density`` makes the
        density a parameter whether the library varies it or not.
    density
        Known bulk density [kg/m3]: short for the prior ``soil.density=VALUE``. Without either it
        is inferred if the library varies it, and else that of the sources or of the library.
    noise, discrepancy
        As in :func:`terraphi.invert`; noise is that of one reading. Noise that is inferred is of
        one size in newtons for both forces.
    seed
        Of all draws.
    steps
        Of each ensemble to begin with; they double until the draws have converged.

    Raises
    ------
    InputError
        If a history, a leg, a prior or an option cannot be used.
    """
    if discrepancy is not None and discrepancy not in DISCREPANCIES:
        raise InputError(
            f"unknown discrepancy '{discrepancy}'; {nearest(discrepancy, DISCREPANCIES)}"
        )
    began = time.perf_counter()
    trials, inspections = _looked_at(trials, library)
    groups = grouped(trials)
    varied = parameters(library)
    given, assumed = _with_density(trials, varied, prior, density)
    marginals = priors(varied, given)
    keys = tuple(k for k, p in marginals.items() if not p.fixed)
    if not keys:
        raise InputError("every parameter is fixed; there is nothing to infer")
    with threadpool_limits(limits=1, user_api="blas"):
        data = _checked(groups, library, marginals)
        ours = all(t.made_as(d) for g, d in zip(groups, data, strict=True) for t in g.trials)
        gp = discrepancy == "gp" or (discrepancy is None and not ours)
        size, ratio = _window_noise(Noise.parse(noise), groups)
        likelihood = JointLikelihood(
            tuple(
                LegLikelihood(DesignSurrogate.fit(d), g.vectors, ratio)
                for g, d in zip(groups, data, strict=True)
            )
        )
        target = Target(likelihood, marginals, keys, size, gp)
        draws = sample(
            target.at,
            target.draw_prior,
            parameters=target.parameters,
            seed=seed,
            steps=steps,
            walkers=max(32, 4 * len(keys)),
        )
        about = {
            **{n: package_version(n) for n in ("terraphi", "numpy", "scipy", "emcee")},
            "library": dict(library.provenance),
            "library_hash": library.hash,
            "seconds": time.perf_counter() - began,
        }
        answer = _answer(groups, library, target, draws, about, assumed)
    warnings = [
        said
        for group, d in zip(groups, data, strict=True)
        for said in warnings_on(group, d, _density_of(marginals, d))
    ]
    warnings = [*_damage(trials, inspections), *warnings]
    if not answer.draws.converged:
        warnings.append(Doubt("not_converged"))
    return _told(answer, warnings, spoilt=any(i.spoilt for i in inspections))


def _told(answer: JointInversion, warnings: Sequence[Doubt], *, spoilt: bool) -> JointInversion:
    """The answer with all doubts; of a spoilt record it is a misfit."""
    verdict = damaged(answer.verdict) if spoilt else answer.verdict
    return replace(answer, verdict=verdict, warnings=tuple(warnings))


def _damage(trials: Sequence[Trial], inspections: Sequence[Inspection]) -> list[Doubt]:
    """What was left out of each trial."""
    return [
        replace(doubt, source=trial.source)
        for trial, inspection in zip(trials, inspections, strict=True)
        for doubt in inspection.doubts
    ]


def _looked_at(trials: Sequence[Trial], library: Library) -> tuple[list[Trial], list[Inspection]]:
    """Trials without the readings that are not to be believed, and what was found in each."""
    found = [
        inspect_record(t.history, touches_deg=touches_soil_deg(library, t.leg)) for t in trials
    ]
    left = [replace(t, history=i.history) for t, i in zip(trials, found, strict=True)]
    return left, found


def _with_density(
    trials: Sequence[Trial],
    varied: Mapping[str, object],
    prior: Sequence[str],
    density: float | None,
) -> tuple[list[str], bool]:
    """Priors with what is known of the density, and whether that is a guess."""
    said, assumed = any(is_on(text, DENSITY) for text in prior), False
    if said and density is not None:
        raise InputError(f"the density is given twice, as {density:g} kg/m³ and as a prior")
    if density is None and not said and DENSITY not in varied:
        density, assumed = common_density(trials)
    known = [] if density is None else [f"{DENSITY}={density!r}"]
    return [*prior, *known], assumed


def _checked(
    groups: Sequence[Repeats], library: Library, marginals: Mapping[str, Marginal]
) -> list[Training]:
    """What the library holds of each leg; refuses trials that it cannot be compared with."""
    found = []
    for group in groups:
        data = training(library, group.leg, readings=group.readings)
        check_trials(group, data.scenario, data.bounds, _fixed(marginals, DENSITY))
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
    noise: Noise, groups: Sequence[Repeats]
) -> tuple[float | None, tuple[float, float]]:
    """Standard deviation of a window mean of the noisier force [N], and of both over it [-].

    ``None`` if it is to be inferred. Noise counts as white from window to window; as neighbours
    share a reading, which makes their errors alike, its size is that of the part they share.
    """
    if noise.sigma_N is None:
        return None, (1.0, 1.0)
    for trial in (t for g in groups for t in g.trials):
        noise.check_against(trial.history, source=trial.source)
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
    groups: Sequence[Repeats],
    library: Library,
    target: Target,
    draws: Draws,
    about: dict[str, Any],
    density_assumed: bool,
) -> JointInversion:
    d, scenario = len(target.keys), library.cases[0].scenario
    flat = draws.values.reshape(-1, draws.values.shape[-1])
    noise, amplitude = target.errors(flat)
    best = draws.central
    named = {k: float(v[0]) for k, v in target.named(best[None]).items()}
    marginal = {k: Summary.of(flat[:, i]) for i, k in enumerate(target.keys)}
    sd = [target.priors[k].sd for k in target.keys]
    fits = {
        group.leg: leg.surrogate.predict({k: np.array([v]) for k, v in named.items()})[0][0]
        for group, leg in zip(groups, target.likelihood.legs, strict=True)
    }
    misfits = [nrmsd(o.vector, fits[g.leg]) for g in groups for o in g.observations]
    covariance = np.cov(flat[:, :d].T).reshape(d, d)
    identifiability = Identifiability.of(target.keys, covariance, sd)
    equivalent, why_not = _plane_strain(marginal, target, scenario)
    known = None if DENSITY in target.keys else named.get(DENSITY, scenario.soil.density)
    return JointInversion(
        groups=tuple(groups),
        library=library.name,
        convention=scenario.convention,
        phi_plane_strain=equivalent,
        plane_strain_reason=why_not,
        density=known,
        density_assumed=known is not None and (density_assumed or DENSITY not in named),
        keys=target.keys,
        priors=target.priors,
        draws=draws,
        noise_N=noise,
        amplitude=amplitude,
        marginal=marginal,
        conditional={k: _conditional(target, best, i) for i, k in enumerate(target.keys)},
        best=named,
        identifiability=identifiability,
        expected_sd=_expected(groups, target, (np.median(noise), np.median(amplitude)), named, sd),
        fits=fits,
        nrmsd=tuple(misfits),
        verdict=_judge(
            target, flat, identifiability, list(zip(_sources(groups), misfits, strict=True))
        ),
        discrepancy="gp" if target.discrepancy else "none",
        provenance=about,
    )


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
    errors: tuple[np.floating[Any], np.floating[Any]],
    named: Mapping[str, float],
    prior_sd: Sequence[float],
) -> dict[str, FloatArray]:
    """Standard deviations that each leg alone and all would leave, by linearisation.

    ``errors`` are the sizes of noise and discrepancy to reckon with: their medians, because those
    of a single draw change with its luck.
    """
    noise, amplitude = map(float, errors)
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


def _sources(groups: Sequence[Repeats]) -> list[str]:
    """Name of each history, leg by leg."""
    return [t.source or f"the history of leg {g.leg}" for g in groups for t in g.trials]


def _judge(
    target: Target,
    flat: FloatArray,
    identifiability: Identifiability,
    misfits: Sequence[tuple[str, Mapping[str, float]]],
) -> Verdict:
    """A misfit if forces deviate; out of range if an edge cuts off a parameter that was learnt."""
    fit = [
        measure
        for source, misfit in misfits
        for measure in deviations(misfit, most=NRMSD_LIMIT, source=source)
    ]
    edges = [
        _edge(key, target.priors[key], flat[:, i])
        for i, key in enumerate(target.keys)
        if identifiability.kinds[key] != "open"
    ]
    worst, _ = max(misfits, key=lambda pair: max(pair[1].values()))
    edge = max(edges, key=lambda edge: edge.size, default=None)
    return judge(fit, edge, kind="parameters", numbers={"worst": worst})


def _edge(key: str, prior: Marginal, values: FloatArray) -> Edge:
    """The edge of a prior where the density is larger."""
    counts, _ = np.histogram(values, bins=round(1.0 / EDGE), range=(prior.low, prior.high))
    cuts = zip(prior.cut_off, (counts[0], counts[-1]), strict=True)
    low, high = (float(count / counts.max()) if cut else 0.0 for cut, count in cuts)
    name, unit = label(key)
    numbers = {"at": prior.low if low >= high else prior.high, "unit": unit, "name": name}
    side: Side = "low" if low >= high else "high"
    return Edge(side, max(low, high), EDGE_DENSITY, AT_EDGE, "edge_density", numbers)
