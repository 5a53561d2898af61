"""Recovery: invert fresh simulations of known friction angle, off the library's grid.

The truths have other particle seeds than the library. Each is inverted by quadrature and by emcee
at the paper's settings; the two medians must agree within Monte-Carlo error.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from terraphi.errors import InputError
from terraphi.inference.inversion import invert
from terraphi.library import Library
from terraphi.plots import recovery_figure
from terraphi.studies import Study


def run(*, library: str = "quick-plane-strain") -> Study:
    """Invert every case of the library's truths, shipped as ``NAME-truths``.

    Parameters
    ----------
    library
        Name of a shipped library that has truths.

    Returns
    -------
    Study
        ``data``: ``library``, ``yield``, ``cases`` (``phi_true_deg``, ``phi_median_deg``,
        ``ci68``, ``ci95``,
        ``emcee_median_deg``, ``emcee_median_error_deg``, ``medians_apart_in_errors``,
        ``verdict``), ``abs_error_deg`` and ``ci68_half_width_deg`` (``median``, ``max``),
        ``inside68``, ``inside95``.

    Raises
    ------
    InputError
        If there is no such library, or none of its truths.
    """
    trained = Library.load(library)
    truths = Library.load(f"{library}-truths")
    convention = trained.cases[0].scenario.convention
    cases = []
    for truth in truths.cases:
        if truth.history is None:
            raise InputError(f"library '{truths.name}' holds a failed case: {truth.failure}")
        leg, phi = truth.scenario.leg.shape, truth.scenario.soil.friction_angle_deg
        exact = invert(truth.history, library=trained, leg=leg)
        sampled = invert(truth.history, library=trained, leg=leg, sampler="emcee")
        error = sampled.posterior.convergence["median_standard_error"]
        cases.append(
            {
                "phi_true_deg": phi,
                "phi_median_deg": exact.phi.median,
                "ci68": list(exact.phi.ci68),
                "ci95": list(exact.phi.ci95),
                "emcee_median_deg": sampled.phi.median,
                "emcee_median_error_deg": error,
                "medians_apart_in_errors": abs(sampled.phi.median - exact.phi.median) / error,
                "verdict": exact.verdict.verdict,
            }
        )
    return Study(
        title=f"Recovery of {len(cases)} friction angles ({convention}) with library '{library}'",
        header=("true φ", "median", "error", "68 %", "95 %", "emcee - quadrature", "verdict"),
        rows=[_row(case) for case in cases],
        data={"library": library, "yield": convention, "cases": cases, **_summary(cases)},
        figures={
            "recovery": recovery_figure(
                np.array([case["phi_true_deg"] for case in cases]),
                np.array([case["phi_median_deg"] for case in cases]),
                np.array([case["ci68"] for case in cases]),
                np.array([case["ci95"] for case in cases]),
            )
        },
    )


def _summary(cases: list[dict[str, Any]]) -> dict[str, Any]:
    """Errors, widths and coverage over all cases."""
    error = np.array([abs(case["phi_median_deg"] - case["phi_true_deg"]) for case in cases])
    half = np.array([0.5 * (case["ci68"][1] - case["ci68"][0]) for case in cases])

    def inside(key: str) -> int:
        return sum(case[key][0] <= case["phi_true_deg"] <= case[key][1] for case in cases)

    return {
        "abs_error_deg": {"median": float(np.median(error)), "max": float(error.max())},
        "ci68_half_width_deg": {"median": float(np.median(half)), "max": float(half.max())},
        "inside68": inside("ci68"),
        "inside95": inside("ci95"),
    }


def _row(case: dict[str, Any]) -> tuple[str, ...]:
    apart = case["emcee_median_deg"] - case["phi_median_deg"]
    return (
        f"{case['phi_true_deg']:.2f}°",
        f"{case['phi_median_deg']:.2f}°",
        f"{case['phi_median_deg'] - case['phi_true_deg']:+.2f}°",
        "{:.2f} to {:.2f}°".format(*case["ci68"]),
        "{:.2f} to {:.2f}°".format(*case["ci95"]),
        f"{apart:+.4f}° ({case['medians_apart_in_errors']:.1f} errors)",
        case["verdict"].replace("_", " "),
    )
