"""Calibration: whether intervals hold the truth as often as they say, and how narrow they are.

Simulation-based calibration in thousands of simulated worlds, each with a truth and a library of
its own; coverage through the one shipped library; its truths, as they are and made worse; histories
that the model must not explain.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from terraphi.errors import InputError
from terraphi.history import ForceHistory
from terraphi.inference.coverage import calibrate, through_one_library
from terraphi.inference.inversion import Inversion, invert
from terraphi.inference.library import prepare
from terraphi.library import Library
from terraphi.measurements import measurement, names
from terraphi.studies import Study
from terraphi.studies.calibration_figures import calibration_figure

REPLICATES = 5000
WORLDS, TRUTHS = 40, 50
"""Worlds that the one library may be of, and truths in each."""
NOISES = (0.02, 0.05, 0.10)
"""White noise of a reading, of the peak force [-]."""
CORRELATED = 0.02
"""Noise correlated over 6°, of the peak force [-]."""
CORRELATION_DEG = 6.0
OFFSET = 0.02
"""Offset of both forces, of the peak force [-]."""
THETA_DEG = 1.0
"""Error of the leg angle [deg]."""
OTHER_MODEL = "rft3d"
"""Library of another forward model, whose histories the model must not explain."""
DENSITY = 1.2
"""Error of the density, a factor [-]."""


def run(
    *,
    library: str = "quick-plane-strain",
    replicates: int = REPLICATES,
    seed: int = 0,
    progress: Callable[[float, float], None] | None = None,
) -> Study:
    """Check the intervals of the straight leg of a library.

    Parameters
    ----------
    library
        Name of a shipped library; its truths, ``NAME-truths``, are used if there are any.
    replicates, seed
        Number of worlds and seed of all draws.
    progress
        Called with steps done and all steps.

    Returns
    -------
    Study
        ``data``: ``library``, ``yield``, ``replicates``, ``coverage68``, ``coverage95``,
        ``rank_chi2_p``, ``ci68_half_width_deg``, ``one_library`` (the same coverages, mean and 5 to
        95 % over worlds), ``truths`` (by what was done to them: ``cases``, ``abs_error_deg``,
        ``ci68_half_width_deg``, ``inside68``, ``inside95``, ``misfit``), ``strangers``.

    Raises
    ------
    InputError
        If there is no such library.
    """

    def report(done: int) -> None:
        if progress is not None:
            progress(done, 4)

    trained = Library.load(library)
    leg = prepare(trained, "straight", within=(-math.inf, math.inf))
    coverage = calibrate(leg, replicates=replicates, seed=seed)
    report(1)
    one68, one95 = through_one_library(leg, worlds=WORLDS, truths=TRUTHS, seed=seed + 1)
    report(2)
    truths = _truths(trained)
    tables = _tables(trained, truths, np.random.default_rng(seed + 2)) if truths else {}
    report(3)
    strangers = _strangers(trained)
    data = {
        "library": library,
        "yield": leg.curves.scenario.convention,
        **coverage.as_dict(),
        "seed": seed,
        "one_library": {
            name: {"mean": float(part.mean()), "p05_p95": np.quantile(part, [0.05, 0.95]).tolist()}
            for name, part in (("coverage68", one68), ("coverage95", one95))
        },
        "truths": tables,
        "strangers": strangers,
    }
    return Study(
        title=f"Calibration of the intervals of library '{library}', leg straight",
        header=("what", "cases", "|error|", "68 % half-width", "in 68 %", "in 95 %", "misfit"),
        rows=_rows(data),
        data=data,
        figures={"calibration": calibration_figure(coverage, leg, one68)},
        notes=_notes(data),
    )


def _truths(trained: Library) -> list[tuple[float, ForceHistory]]:
    """Friction angles [deg] and histories of the straight truths of a library, if it has any."""
    try:
        found = Library.load(f"{trained.name}-truths")
    except InputError:
        return []
    return [
        (case.scenario.soil.friction_angle_deg, case.history)
        for case in found.cases
        if case.history and case.scenario.leg.shape == "straight"
    ]


def _tables(
    trained: Library, truths: list[tuple[float, ForceHistory]], rng: np.random.Generator
) -> dict[str, Any]:
    """Errors and coverage over the truths, as they are and made worse in several ways."""

    def noisy(fraction: float) -> Callable[[ForceHistory], ForceHistory]:
        return lambda h: _spoilt(h, fraction * rng.standard_normal(h.force.shape))

    ways: dict[str, tuple[Callable[[ForceHistory], ForceHistory], float]] = {
        "clean": (lambda h: h, 1.0),
        **{f"white noise {fraction:.0%}": (noisy(fraction), 1.0) for fraction in NOISES},
        f"noise over {CORRELATION_DEG:g}°, {CORRELATED:.0%}": (
            lambda h: _spoilt(h, CORRELATED * _correlated(h, rng)), 1.0,
        ),
        f"offset {OFFSET:.0%}": (lambda h: _spoilt(h, OFFSET * np.ones_like(h.force)), 1.0),
        f"θ off by {THETA_DEG:g}°": (
            lambda h: replace(h, position=h.position + math.radians(THETA_DEG), provenance={}), 1.0,
        ),
        f"density off by {DENSITY - 1.0:.0%}": (lambda h: replace(h, provenance={}), DENSITY),
        **{
            f"density off by {DENSITY - 1.0:.0%}, white noise {fraction:.0%}": (
                noisy(fraction), DENSITY,
            )
            for fraction in NOISES
        },
    }  # fmt: skip
    density = trained.cases[0].scenario.soil.density
    return {
        name: _summary(
            [
                (
                    phi,
                    invert(
                        spoil(h), library=trained, likelihood="calibrated", density=factor * density
                    ),
                )
                for phi, h in truths
            ]
        )
        for name, (spoil, factor) in ways.items()
    }


def _spoilt(history: ForceHistory, relative: np.ndarray[Any, Any]) -> ForceHistory:
    """A history with something added, relative to each force's peak; no longer one of ours."""
    peak = np.abs(history.force).max(axis=0)
    return replace(history, force=history.force + peak * relative, provenance={})


def _correlated(history: ForceHistory, rng: np.random.Generator) -> np.ndarray[Any, Any]:
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


def _strangers(trained: Library) -> dict[str, dict[str, int]]:
    """Histories that the straight leg of the model must not explain, and how many were believed.

    Of other legs passed off as the straight one, of resistive force theory, and of measured sand.
    """
    legs = [c.history for c in trained.cases if c.scenario.leg.shape in {"c", "reversed_c"}][::3]
    law = [c for c in Library.load(OTHER_MODEL).cases if c.scenario.leg.shape == "straight"]
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
            invert(
                history, library=trained, leg="straight", likelihood="calibrated", density=density
            ).verdict.verdict
            for history, density in histories
            if history
        ]
        found[kind] = {"cases": len(verdicts), "believed": verdicts.count("consistent")}
    return found


def _rows(data: dict[str, Any]) -> list[tuple[str, ...]]:
    one = data["one_library"]
    rows = [
        (
            "simulated worlds",
            str(data["replicates"]),
            f"{data['abs_error_deg']:.3f}°",
            f"{data['ci68_half_width_deg']:.3f}°",
            f"{data['coverage68']:.1%}",
            f"{data['coverage95']:.1%}",
            "",
        ),
        (
            "through the one library",
            str(WORLDS * TRUTHS),
            "",
            "",
            *(f"{one[name]['mean']:.1%}" for name in ("coverage68", "coverage95")),
            "",
        ),
    ]
    for name, found in data["truths"].items():
        error, half, cases = found["abs_error_deg"], found["ci68_half_width_deg"], found["cases"]
        rows.append(
            (
                f"truths, {name}",
                str(cases),
                f"{error['median']:.3f}°, at most {error['max']:.2f}°",
                f"{half['median']:.3f}°",
                f"{found['inside68']} of {cases}",
                f"{found['inside95']} of {cases}",
                f"{found['misfit']} of {cases}",
            )
        )
    return rows


def _notes(data: dict[str, Any]) -> list[str]:
    strangers, spread = data["strangers"], data["one_library"]["coverage68"]["p05_p95"]
    return [
        f"Ranks of the truths are uniform with p = {data['rank_chi2_p']:.2g} (chi-square).",
        f"Through one library 68 % intervals cover {spread[0]:.0%} to {spread[1]:.0%}.",
        "Histories that must not be believed, and those that were: "
        + "; ".join(f"{kind} {n['cases']}, {n['believed']}" for kind, n in strangers.items())
        + ".",
    ]
