"""Recovery: invert fresh simulations of known friction angle, off the library's grid.

The truths have other particle seeds than the library. Each is inverted by quadrature and by emcee,
four independent ensembles of 32 walkers; the two medians must agree within Monte-Carlo error. One
case shows the walkers of an ensemble at the paper's settings: 4000 steps, 1000 of them left out.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError
from terraphi.inference.answer import PHI, Inversion
from terraphi.inference.inversion import invert
from terraphi.inference.paper_likelihood import PaperLikelihood
from terraphi.inference.sampler import ensemble
from terraphi.library.shipped import companion
from terraphi.library.store import Case, Library
from terraphi.surrogate.paper import LegSurrogate
from terraphi.view.table import Table
from terraphi_studies import PAPER_LIBRARY, Progress, Study, steps
from terraphi_studies.measures import recovered
from terraphi_studies.pictures import recovery_figure, walkers_figure

SHOWN_DEG = 33.97
"""The case whose walkers the paper shows; the nearest one is taken."""
BURN_IN = 1000
BESIDE_PAPER = (
    ("median error", "{abs_error_deg[median]:.2f}°", "0.09°"),
    ("largest error", "{abs_error_deg[max]:.2f}°", "0.73°"),
    ("median 68 % half-width", "{ci68_half_width_deg[median]:.2f}°", "1.34°"),
    ("largest 68 % half-width", "{ci68_half_width_deg[max]:.2f}°", "1.93°"),
    ("truths inside their 68 % interval", "{inside68} of {cases}", "14 of 14"),
)
"""What Xu & Wang print, and what of ours stands beside it."""
COLUMNS = (
    ("true φ", "{phi_true_deg:.2f}°"),
    ("median", "{phi_median_deg:.2f}°"),
    ("error", lambda case: f"{case['phi_median_deg'] - case['phi_true_deg']:+.2f}°"),
    ("68 %", "{ci68[0]:.2f} to {ci68[1]:.2f}°"),
    ("95 %", "{ci95[0]:.2f} to {ci95[1]:.2f}°"),
    ("verdict", lambda case: case["verdict"].replace("_", " ")),
)


def run(
    *,
    library: str = PAPER_LIBRARY,
    progress: Progress | None = None,
) -> Study:
    """Invert every case of the library's truths, shipped as ``NAME-truths``.

    Parameters
    ----------
    library
        Name of a shipped library that has truths.
    progress
        Called with the number of truths inverted and of all.

    Returns
    -------
    Study
        ``data``: ``library``, ``yield``, ``cases`` (``phi_true_deg``, ``phi_median_deg``,
        ``ci68``, ``ci95``,
        ``emcee_median_deg``, ``emcee_median_error_deg``, ``medians_apart_in_errors``,
        ``verdict``; ``emcee_ci68``, ``emcee_rhat``, ``emcee_autocorrelation_steps``),
        ``abs_error_deg`` and ``ci68_half_width_deg`` (``median``, ``max``),
        ``inside68``, ``inside95``. Figures of all cases and of the walkers at 33.97°.

    Raises
    ------
    InputError
        If there is no such library, or none of its truths.
    """
    trained, truths = Library.load(library).as_simulated, companion(library, "truths")
    convention = trained.cases[0].scenario.convention
    cases: list[dict[str, Any]] = []
    answers: list[tuple[float, Inversion]] = []
    step = steps(len(truths.cases), progress)
    for truth in truths.cases:
        if truth.history is None:
            raise InputError(f"library '{truths.name}' holds a failed case: {truth.failure}")
        leg, phi = truth.scenario.leg.shape, truth.scenario.soil.friction_angle_deg
        exact, sampled = (
            invert(truth.history, library=trained, leg=leg, likelihood="paper", sampler=sampler)
            for sampler in ("quadrature", "emcee")
        )
        answers.append((phi, exact))
        cases.append(step(_case(phi, exact, sampled)))
    summary = recovered(answers)
    shown = min(range(len(cases)), key=lambda i: abs(answers[i][0] - SHOWN_DEG))
    return Study(
        table=Table.of(
            f"Recovery of {len(cases)} friction angles ({convention}) with library '{library}'",
            COLUMNS,
            cases,
        ),
        data={"library": library, "yield": convention, **summary, "cases": cases},
        figures={
            "recovery": recovery_figure(cases, convention),
            "walkers": walkers_figure(
                _walkers(trained, truths.cases[shown]), *answers[shown], BURN_IN, convention
            ),
        },
        notes=[_about_emcee(cases)],
        beside_paper=[
            (what, ours.format_map(summary), paper) for what, ours, paper in BESIDE_PAPER
        ],
    )


def _case(phi_true_deg: float, exact: Inversion, sampled: Inversion) -> dict[str, Any]:
    """What both samplers make of one truth."""
    convergence = sampled.convergence_of(PHI)
    error = convergence["median_standard_error"]
    return {
        "phi_true_deg": phi_true_deg,
        "phi_median_deg": exact.phi.median,
        "ci68": list(exact.phi.ci68),
        "ci95": list(exact.phi.ci95),
        "emcee_median_deg": sampled.phi.median,
        "emcee_median_error_deg": error,
        "emcee_ci68": list(sampled.phi.ci68),
        "emcee_rhat": convergence["split_rhat"],
        "emcee_autocorrelation_steps": convergence["autocorrelation_time_steps"],
        "medians_apart_in_errors": abs(sampled.phi.median - exact.phi.median) / error,
        "verdict": exact.verdict.verdict,
    }


def _about_emcee(cases: list[dict[str, Any]]) -> str:
    apart = max(abs(case["emcee_median_deg"] - case["phi_median_deg"]) for case in cases)
    errors = max(case["medians_apart_in_errors"] for case in cases)
    return (
        f"All by quadrature; emcee's medians differ from these by up to {apart:.3f}°, and by up to "
        f"{errors:.1f} Monte-Carlo errors."
    )


def _walkers(library: Library, truth: Case) -> FloatArray:
    """An ensemble at the paper's settings, from its first step [deg], shape [walker, step]."""
    import emcee

    assert truth.history is not None
    curves = library.curves(truth.scenario.leg.shape)
    surrogate = LegSurrogate.fit(curves.phi_deg, curves.theta_deg, curves.Fx, curves.Fz)
    likelihood = PaperLikelihood(truth.history.observation().vector, curves.theta_deg)

    low, high = surrogate.phi_bounds_deg

    def log_p(points: FloatArray) -> FloatArray:
        phi = points[:, 0]
        inside = (phi >= low) & (phi <= high)
        return np.where(inside, likelihood(surrogate.predict(phi.clip(low, high))), -np.inf)

    random = np.random.RandomState(0)  # emcee knows no other
    start = emcee.State(random.uniform(low, high, (32, 1)), random_state=random.get_state())
    sampler = ensemble(start.coords, log_p)
    sampler.run_mcmc(start, 4 * BURN_IN)
    drawn = sampler.get_chain()[:, :, 0].T
    return np.asarray(drawn)
