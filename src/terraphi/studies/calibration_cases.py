"""What study calibration inverts: truths as they are and made worse, and strangers."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from terraphi.errors import InputError
from terraphi.history import ForceHistory
from terraphi.inference.calibrated import CalibratedLikelihood
from terraphi.inference.coverage import one_world
from terraphi.inference.fit import fit_without_discrepancy
from terraphi.inference.hypotheses import Problem
from terraphi.inference.inversion import DISCREPANCIES, NODES, Inversion, invert
from terraphi.inference.library import PreparedLeg
from terraphi.inference.posterior import quadrature
from terraphi.library import Library
from terraphi.measurements import measurement, names

FloatArray = NDArray[np.float64]

NOISES = (0.02, 0.05, 0.10)
"""White noise of a reading, of the peak force [-]."""
CORRELATED = 0.02
"""Noise correlated over 6°, of the peak force [-]."""
CORRELATION_DEG = 6.0
OFFSET = 0.02
"""Offset of both forces, of the peak force [-]."""
THETA_DEG = 1.0
"""Error of the leg angle [deg]."""
DENSITY = 1.2
"""Error of the density, a factor [-]."""
OTHER_MODEL = "rft3d"
"""Library of another forward model, whose histories the model must not explain."""


class Truth(NamedTuple):
    """A history whose friction angle is known."""

    phi_deg: float
    history: ForceHistory


class Way(NamedTuple):
    """Something that is done to truths before they are inverted."""

    name: str
    truths: Sequence[Truth]
    spoil: Callable[[ForceHistory], ForceHistory]
    density: float = 1.0
    """Factor on the density that is told [-]."""
    discrepancies: tuple[str, ...] = DISCREPANCIES
    """Those that it is inverted with."""


def truths_of(library: str) -> list[Truth]:
    """Straight truths of a library: the paper's fourteen, thrice, else any; empty if none."""
    return _straight(f"{library}-fourteen") or _straight(f"{library}-truths")


def _straight(name: str) -> list[Truth]:
    try:
        found = Library.load(name)
    except InputError:
        return []
    return [
        Truth(case.scenario.soil.friction_angle_deg, case.history)
        for case in found.cases
        if case.history and case.scenario.leg.shape == "straight"
    ]


def ways(library: str, rng: np.random.Generator) -> list[Way]:
    """All that is done, in the order of the table; empty if the library has no truths.

    Parameters
    ----------
    library
        Name of the library.
    rng
        Of the noise.
    """
    truths, hips = truths_of(library), _straight(f"{library}-hip")
    if not truths:
        return []

    def noisy(fraction: float) -> Callable[[ForceHistory], ForceHistory]:
        return lambda h: _spoilt(h, fraction * rng.standard_normal(h.force.shape))

    def turned(history: ForceHistory) -> ForceHistory:
        shifted = history.position + math.radians(THETA_DEG)
        return replace(history, position=shifted, provenance={})

    def nameless(history: ForceHistory) -> ForceHistory:
        return replace(history, provenance={})

    found = [
        Way("clean", truths, lambda h: h),
        *(Way(f"white noise {f:.0%}", truths, noisy(f)) for f in NOISES),
        Way(
            f"noise over {CORRELATION_DEG:g}°, {CORRELATED:.0%}",
            truths,
            lambda h: _spoilt(h, CORRELATED * _correlated(h, rng)),
        ),
        Way(f"offset {OFFSET:.0%}", truths, lambda h: _spoilt(h, OFFSET * np.ones_like(h.force))),
        Way(f"θ off by {THETA_DEG:g}°", truths, turned),
    ]
    if hips:
        found.append(Way("hip off by 2 mm", hips, nameless))
    wrong = f"density off by {DENSITY - 1.0:.0%}"
    found.append(Way(wrong, truths, nameless, DENSITY, ("gp",)))
    for fraction in NOISES:
        name = f"{wrong}, white noise {fraction:.0%}"
        found.append(Way(name, truths, noisy(fraction), DENSITY, ("gp",)))
    return found


def inverted(trained: Library, way: Way) -> dict[str, dict[str, Any]]:
    """Errors and coverage over the truths, by the discrepancy they were inverted with.

    Parameters
    ----------
    trained
        The library.
    way
        What is inverted.

    Returns
    -------
    dict
        Of each discrepancy the summary of all, with those of each particle seed in ``by_seed``.
    """
    density = way.density * trained.cases[0].scenario.soil.density
    spoilt = [(truth.phi_deg, way.spoil(truth.history)) for truth in way.truths]
    seeds = max(Counter(phi for phi, _ in spoilt).values())
    tables = {}
    for discrepancy in way.discrepancies:
        found = [
            (phi, invert(history, library=trained, density=density, discrepancy=discrepancy))
            for phi, history in spoilt
        ]
        size = len(found) // seeds
        groups = [_summary(found[i * size : (i + 1) * size]) for i in range(seeds)]
        tables[discrepancy] = {**_summary(found), "by_seed": groups}
    return tables


def matched(
    leg: PreparedLeg, *, noise: float, worlds: int, truths: int, seed: int
) -> dict[str, float]:
    """Histories that the model does explain, through all of the inference.

    Parameters
    ----------
    leg
        Of the library, whose model is true in worlds that the library may be of.
    noise
        White noise of a window mean, of the peak force [-]; its size is inferred.
    worlds, truths
        Number of worlds, and of histories in each.
    seed
        Of all draws.

    Returns
    -------
    dict
        Number of ``cases``, fractions of 68 and 95 % intervals that hold the truth, ``coverage68``
        and ``coverage95`` [-], and how many cases are a ``misfit``.
    """
    rng, surrogate = np.random.default_rng(seed), leg.surrogate
    shape = np.eye(2 * len(surrogate.theta_deg))
    ranks, misfits = [], 0
    for _ in range(worlds):
        truth = np.sort(rng.uniform(*surrogate.phi_bounds_deg, size=truths))
        forces = one_world(surrogate, truth, rng) + surrogate.scatter.draw(truth, rng)
        white = rng.standard_normal(forces.shape)
        forces += noise * np.abs(forces).max(axis=1, keepdims=True) * white
        for phi, data in zip(truth.tolist(), forces, strict=True):
            likelihood = CalibratedLikelihood(Problem(leg, data, shape, None, discrepancy=False))
            posterior = quadrature(likelihood, surrogate.phi_bounds_deg, nodes=NODES)
            ranks.append(posterior.mass(surrogate.phi_bounds_deg[0], phi))
            fit = fit_without_discrepancy(likelihood.problem, likelihood.without, scale=1.0)
            misfits += fit.misfit
    off = np.abs(np.array(ranks) - 0.5)
    inside = {f"coverage{p}": float(np.mean(off <= 0.005 * p)) for p in (68, 95)}
    return {"cases": len(ranks), **inside, "misfit": misfits}


def strangers(trained: Library) -> dict[str, dict[str, int]]:
    """Histories that the straight leg of the model must not explain, and how many were believed.

    Of other legs passed off as the straight one, of resistive force theory if the model is another,
    and of measured sand.
    """
    legs = [c.history for c in trained.cases if c.scenario.leg.shape in {"c", "reversed_c"}][::3]
    law = [c for c in Library.load(OTHER_MODEL).cases if c.scenario.leg.shape == "straight"]
    if trained.cases[0].scenario.model == "rft":
        law = []
    sand = [m for m in map(measurement, names()) if m.leg == "straight"]
    kinds: dict[str, list[tuple[ForceHistory | None, float | None]]] = {
        "other legs": [(history, None) for history in legs],
        OTHER_MODEL: [
            (replace(c.history, provenance={}), c.scenario.soil.density) for c in law if c.history
        ],
        "measured sand": [(m.history, m.density_kg_m3) for m in sand],
    }
    found = {}
    for kind, histories in kinds.items():
        verdicts = [
            invert(history, library=trained, leg="straight", density=density).verdict.verdict
            for history, density in histories
            if history
        ]
        found[kind] = {"cases": len(verdicts), "believed": verdicts.count("consistent")}
    return found


def _spoilt(history: ForceHistory, relative: FloatArray) -> ForceHistory:
    """A history with something added, relative to each force's peak; no longer one of ours."""
    peak = np.abs(history.force).max(axis=0)
    return replace(history, force=history.force + peak * relative, provenance={})


def _correlated(history: ForceHistory, rng: np.random.Generator) -> FloatArray:
    """Smooth noise of unit variance over the leg angle, as the paper's residual has it."""
    coarse = np.arange(-140.0, 140.1, 2.0)
    covariance = np.exp(-0.5 * np.square((coarse[:, None] - coarse) / CORRELATION_DEG))
    factor = np.linalg.cholesky(covariance + 1e-6 * np.eye(coarse.size))
    drawn = factor @ rng.standard_normal((coarse.size, history.force.shape[1]))
    return np.column_stack([np.interp(history.theta_deg, coarse, column) for column in drawn.T])


def _summary(found: list[tuple[float, Inversion]]) -> dict[str, Any]:
    error = np.array([abs(a.phi.median - phi) for phi, a in found])
    half = np.array([0.5 * (a.phi.ci68[1] - a.phi.ci68[0]) for _, a in found])
    return {
        "cases": len(found),
        "abs_error_deg": {"median": float(np.median(error)), "max": float(error.max())},
        "ci68_half_width_deg": {"median": float(np.median(half)), "max": float(half.max())},
        "inside68": sum(a.phi.ci68[0] <= phi <= a.phi.ci68[1] for phi, a in found),
        "inside95": sum(a.phi.ci95[0] <= phi <= a.phi.ci95[1] for phi, a in found),
        "misfit": sum(a.verdict.verdict != "consistent" for _, a in found),
    }
