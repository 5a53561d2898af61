"""The inversion from end to end: a force history and a library in, an answer out."""

from __future__ import annotations

import functools
import importlib.metadata
import logging
import time
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.errors import InputError, nearest
from terraphi.experiment.history import ForceHistory, Observation
from terraphi.experiment.scenario import Scenario
from terraphi.inference.answer import AngleSummary, Inversion, plane_strain_summary
from terraphi.inference.budget import Budget, budget_of
from terraphi.inference.calibrated import CalibratedLikelihood, Problem
from terraphi.inference.checks import check_magnitudes, check_same_setup, doubts, unlike
from terraphi.inference.defects import Inspection, inspect_record, touches_soil_deg
from terraphi.inference.explanation import OFFSETS, Explanation, explain
from terraphi.inference.findings import Doubt, Verdict
from terraphi.inference.fit import Fit, fit_without_discrepancy
from terraphi.inference.noise import Noise, shape_of, window_covariance
from terraphi.inference.paper_likelihood import PaperLikelihood
from terraphi.inference.posterior import LogLikelihood, Posterior, ensemble, quadrature, tabulated
from terraphi.inference.prepared_leg import prepare, single_threaded
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
from terraphi.inference.words import of_doubt
from terraphi.library.shipped import is_there_to_try_others
from terraphi.library.store import Library
from terraphi.surrogate.paper import LegSurrogate

__all__ = [
    "DISCREPANCIES",
    "LIKELIHOODS",
    "SAMPLERS",
    "AngleSummary",
    "Inversion",
    "invert",
    "plane_strain_summary",
]

FloatArray = NDArray[np.float64]
log = logging.getLogger(__name__)
Likelihood = Literal["calibrated", "paper"]
Sampler = Literal["quadrature", "emcee"]
LIKELIHOODS: tuple[Likelihood, ...] = ("calibrated", "paper")
SAMPLERS: tuple[Sampler, ...] = ("quadrature", "emcee")
DISCREPANCIES = ("none", "gp")
NODES = 401
"""Nodes of the quadrature to begin with, where the likelihood is smooth."""

_SOFTWARE = ("terraphi", "numpy", "scipy", "emcee")


class _Found(NamedTuple):
    """What both likelihoods come to."""

    posterior: Posterior
    phi: AngleSummary
    best: FloatArray
    band: FloatArray
    nrmsd: dict[str, float]
    verdict: Verdict
    why: Explanation
    budget: Budget | None
    scenario: Scenario
    curves: FloatArray
    core_seconds: float


def invert(
    history: ForceHistory,
    *,
    library: Library,
    leg: str = "straight",
    density: float | None = None,
    density_assumed: bool = False,
    likelihood: str = "calibrated",
    noise: float | str | Path | None = None,
    discrepancy: str | None = None,
    sampler: str = "quadrature",
    seed: int = 0,
    source: str = "",
) -> Inversion:
    """Infer the friction angle from a force history.

    With c = 0 and a fixed stiffness the forces are proportional to the density, so the library's
    curves are multiplied by ρ / ρ_library.

    Parameters
    ----------
    history
        Forces over the whole window |θ| ≤ 85°.
    library
        Simulations over φ.
    leg
        Shape of the leg that was moved.
    density
        Bulk density of the soil [kg/m³]; ``None`` assumes the library's.
    density_assumed
        Whether a density given is itself a guess.
    likelihood
        ``calibrated``, or ``paper``: as printed by Xu & Wang.
    noise
        Standard deviation of a force reading [N], or a TOML file with ``sigma_Fx_N`` and
        ``sigma_Fz_N``; ``None`` or ``inferred`` infers it. Of the calibrated likelihood only.
    discrepancy
        ``gp``: the model may be wrong by a Gaussian process over θ; ``none``: it is right.
        ``None`` takes ``none`` for a history simulated as the library was and ``gp`` for any
        other. Likewise.
    sampler
        ``quadrature`` (exact, one parameter) or ``emcee`` (the paper's settings).
    seed
        Seed of emcee.
    source
        Where the forces come from, for people.

    Returns
    -------
    Inversion

    Raises
    ------
    InputError
        If the history, the leg, the density or an option cannot be used.
    """
    _check_options(likelihood, sampler, noise, discrepancy)
    began = time.perf_counter()
    inspection = inspect_record(history, touches_deg=touches_soil_deg(library, leg))
    history = inspection.history
    try:
        observation, how = history.observation(), {"sampler": sampler, "seed": seed}
    except InputError as error:
        said = [f"{error}.", *map(of_doubt, inspection.doubts)]
        raise InputError(" ".join(said).rstrip(".")) from error
    if likelihood == "paper":
        found = _by_paper(history, observation, library, leg, density, how)
    else:
        errors = (Noise.parse(noise), discrepancy)
        with single_threaded():
            found = _calibrated(history, observation, library, leg, density, errors, how)
    equivalent, why_not = plane_strain_summary(found.phi, found.scenario)
    used = found.scenario.soil.density if density is None else density
    verdict, warnings = _told(found, inspection, observation, library, leg, used)
    return Inversion(
        source=source or str(history.provenance.get("file", "")),
        observation=observation,
        readings=history.position,
        leg=leg,
        library=library.name,
        convention=found.scenario.convention,
        posterior=found.posterior,
        phi=found.phi,
        phi_plane_strain=equivalent,
        plane_strain_reason=why_not,
        density=used,
        density_assumed=density is None or density_assumed,
        data=inspection.as_dict(),
        best=found.best,
        band=found.band,
        nrmsd=found.nrmsd,
        verdict=verdict,
        warnings=tuple(warnings),
        likelihood=likelihood,
        budget=found.budget,
        provenance={
            **_provenance(library),
            **_origin(history),
            "seconds": time.perf_counter() - began,
            "core_seconds": found.core_seconds,
        },
    )


def _told(
    found: _Found,
    inspection: Inspection,
    observation: Observation,
    library: Library,
    leg: str,
    density: float,
) -> tuple[Verdict, list[Doubt]]:
    """The verdict, of a spoilt record a misfit, and all doubts."""
    history, verdict = inspection.history, found.verdict
    curves = density / found.scenario.soil.density * found.curves
    question = found.why.question
    # A consistent record was not misread, and a zero that is seen to be off is told as such.
    told = inspection.spoilt and question is not None and question.code in OFFSETS
    if verdict.verdict != "misfit" or told:
        question = None
    warnings = [
        *inspection.doubts,
        *filter(None, [question, unlike(history, found.scenario, leg)]),
        *doubts(history, observation, curves, density, asked=question is not None),
        *uninformed(found.posterior),
    ]
    if is_there_to_try_others(library.name):
        warnings.append(Doubt("tries_others", {"name": library.name}))
    return damaged(verdict) if inspection.spoilt else verdict, warnings


def _check_options(
    likelihood: str, sampler: str, noise: float | str | Path | None, discrepancy: str | None
) -> None:
    """Refuse options that do not exist, or not together."""
    if likelihood not in LIKELIHOODS:
        raise InputError(f"unknown likelihood '{likelihood}'; {nearest(likelihood, LIKELIHOODS)}")
    if sampler not in SAMPLERS:
        raise InputError(f"unknown sampler '{sampler}'; {nearest(sampler, SAMPLERS)}")
    if discrepancy is not None and discrepancy not in DISCREPANCIES:
        raise InputError(
            f"unknown discrepancy '{discrepancy}'; {nearest(discrepancy, DISCREPANCIES)}"
        )
    if likelihood == "paper" and (noise is not None or discrepancy is not None):
        raise InputError(
            "the paper's likelihood has neither noise nor discrepancy; take 'calibrated', or drop "
            "them"
        )


def _default_discrepancy(history: ForceHistory, scenario: Scenario, leg: str) -> str:
    """None for what the library's own model made, for then it is true."""
    ours = "scenario" in history.provenance and not unlike(history, scenario, leg)
    return "none" if ours else "gp"


def _by_paper(
    history: ForceHistory,
    observation: Observation,
    library: Library,
    leg: str,
    density: float | None,
    how: dict[str, Any],
) -> _Found:
    """As printed by Xu & Wang."""
    curves = library.curves(leg, readings=history.position)
    scenario = curves.scenario
    check_magnitudes(density, observation, scenario)
    check_same_setup(history, scenario)
    surrogate = LegSurrogate.fit(curves.phi_deg, curves.theta_deg, curves.Fx, curves.Fz)
    scale = 1.0 if density is None else density / scenario.soil.density
    likelihood = PaperLikelihood(observation.vector, observation.theta_deg)
    nodes = np.linspace(*surrogate.phi_bounds_deg, NODES)
    why = explain(observation.vector, surrogate.predict(nodes, scale=scale), nodes)

    def log_p(phi_deg: FloatArray) -> FloatArray:
        return likelihood(surrogate.predict(phi_deg, scale=scale))

    began = time.perf_counter()
    posterior = _sample(log_p, surrogate.phi_bounds_deg, **how)
    core = time.perf_counter() - began
    phi, best, band, deviation = _curves(posterior, surrogate, observation, scale)
    verdict = judge(
        deviations(deviation, most=NRMSD_LIMIT),
        edge_by_mass(posterior, step_deg=surrogate.phi_step_deg, convention=scenario.convention),
        kind="paper",
        beyond=why.beyond,
    )
    vectors = np.hstack([curves.Fx, curves.Fz])
    about = (verdict, why, None, scenario)
    return _Found(posterior, phi, best, band, deviation, *about, vectors, core)


def _calibrated(
    history: ForceHistory,
    observation: Observation,
    library: Library,
    leg: str,
    density: float | None,
    errors: tuple[Noise, str | None],
    how: dict[str, Any],
) -> _Found:
    """Every part of the residual with its own covariance."""
    prepared = prepare(library, leg, readings=history.position)
    scenario, surrogate = prepared.curves.scenario, prepared.surrogate
    check_magnitudes(density, observation, scenario)
    check_same_setup(history, scenario)
    scale = 1.0 if density is None else density / scenario.soil.density
    noise, discrepancy = errors
    noise.check_against(history)
    discrepancy = discrepancy or _default_discrepancy(history, scenario, leg)
    shape, sigma = shape_of(noise, window_covariance(history.position, observation.theta_deg))
    began = time.perf_counter()
    likelihood = CalibratedLikelihood(
        Problem(
            leg=prepared.read_for(observation.vector / scale),
            data=observation.vector / scale,
            noise_shape=shape,
            noise_sigma=None if sigma is None else sigma / scale,
            discrepancy=discrepancy == "gp",
        )
    )
    posterior = _sample(likelihood, surrogate.phi_bounds_deg, nodes=NODES, **how)
    core = time.perf_counter() - began
    phi, best, band, deviation = _curves(posterior, surrogate, observation, scale)
    fit: Fit = fit_without_discrepancy(likelihood.problem, likelihood.without, scale=scale)
    budget = budget_of(likelihood, phi.median, fit, scale=scale)
    why = explain(observation.vector, scale * prepared.mean, prepared.phi_deg)
    verdict = judge(
        [*fit_measures(fit), *deviations(deviation)],
        edge_by_density(posterior, convention=scenario.convention),
        kind="calibrated",
        beyond=why.beyond,
    )
    vectors = np.hstack([prepared.curves.Fx, prepared.curves.Fz])
    about = (verdict, why, budget, scenario)
    return _Found(posterior, phi, best, band, deviation, *about, vectors, core)


def _sample(
    log_p: LogLikelihood,
    bounds_deg: tuple[float, float],
    *,
    sampler: str,
    seed: int,
    nodes: int = 4001,
) -> Posterior:
    log.info("sampling φ over %g to %g deg by %s", *bounds_deg, sampler)
    if sampler == "emcee":
        table = tabulated(log_p, bounds_deg, nodes=nodes)
        return ensemble(table, bounds_deg, seed=seed)
    return quadrature(log_p, bounds_deg, nodes=nodes)


def _curves(
    posterior: Posterior, surrogate: Any, observation: Observation, scale: float
) -> tuple[AngleSummary, FloatArray, FloatArray, dict[str, float]]:
    """Summary of the posterior, the curve at its median, the band of the 95 %, and the misfit."""
    phi = AngleSummary(posterior.median, posterior.interval(0.68), posterior.interval(0.95))
    best = surrogate.predict(np.array([phi.median]), scale=scale)[0]
    inside = surrogate.predict(np.linspace(*phi.ci95, 101), scale=scale)
    band = np.stack([inside.min(axis=0), inside.max(axis=0)])
    return phi, best, band, nrmsd(observation.vector, best)


@functools.cache
def _versions() -> dict[str, str]:
    """Versions of the software at work here."""
    return {name: importlib.metadata.version(name) for name in _SOFTWARE}


def _origin(history: ForceHistory) -> dict[str, Any]:
    """What a history that was simulated says of its simulation; empty for any other."""
    if "scenario" not in history.provenance:
        return {}
    known = ("scenario_hash", "model_version", "seed")
    return {"simulation": {key: history.provenance.get(key) for key in known}}


def _provenance(library: Library) -> dict[str, Any]:
    """Versions of the software, and what the library says of itself."""
    return {
        **_versions(),
        "library": dict(library.provenance),
        "library_hash": library.hash,
    }
