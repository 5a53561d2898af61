"""What studies measure of histories and answers, how they say it, and what Xu & Wang print."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.history import WINDOW_DEG, ForceHistory, Peaks
from terraphi.experiment.measurements import Measurement, medium_and_leg
from terraphi.inference.answer import Inversion
from terraphi.library.store import Library
from terraphi_studies import Beside

FORCES = ("Fz", "Fx")
WHOLE_DEG = np.arange(-WINDOW_DEG + 1.0, WINDOW_DEG)
"""Leg angles of 1° means, whole degrees within |θ| < 85° [deg]."""
PHI = "soil.friction_angle_deg"
"""Key of the friction angle in plans."""
PEAK_CELLS = (
    ("peak Fz", "{Fz_N:.1f} N at {theta_Fz_deg:.0f}°"),
    ("peak Fx", "{Fx_N:.1f} N at {theta_Fx_deg:.0f}°"),
)
"""Columns of a table whose records are those of :func:`peaks_and_angles`."""

ENDS_DEG = (25.0, 45.0)
"""Friction angles at which the paper prints peaks [deg]: the ends of its library."""
PAPER_PEAKS_N = {25.0: {"Fz": 8.6, "Fx": 10.2}, 45.0: {"Fz": 14.0, "Fx": 15.5}}
"""Peaks that the paper prints, by φ [deg] and force."""
PAPER_ANGLES_DEG = {"Fz": -50.0, "Fx": 0.0}
"""Leg angles at which they lie, about."""
PAPER_ENGAGEMENT_DEG = -85.0
"""Leg angle at which the leg first meets resistance, about."""
ENGAGED = 0.02
"""Share of the peak of F_z above which the leg counts as engaged."""


def peaks_of(history: ForceHistory) -> dict[str, float]:
    """Largest forces [N], of means over 1°, by force."""
    peaks = history.peaks()
    return {"Fz": peaks.Fz, "Fx": peaks.Fx}


def peak_angles_of(history: ForceHistory) -> dict[str, float]:
    """Leg angles of the largest forces [deg], by force."""
    peaks = history.peaks()
    return {"Fz": peaks.theta_Fz_deg, "Fx": peaks.theta_Fx_deg}


def peaks_and_angles(peaks: Peaks) -> dict[str, float]:
    """Largest forces [N] and where they lie [deg], JSON-able."""
    return {
        "Fz_N": peaks.Fz,
        "theta_Fz_deg": peaks.theta_Fz_deg,
        "Fx_N": peaks.Fx,
        "theta_Fx_deg": peaks.theta_Fx_deg,
    }


def engagement_deg(history: ForceHistory) -> float:
    """Leg angle from which on |F| stays above :data:`ENGAGED` of the peak of F_z for 5° [deg]."""
    size = np.hypot(history.Fx, history.Fz) > ENGAGED * history.peaks().Fz
    degrees = history.theta_deg
    span = max(1, round(5.0 / float(np.median(np.diff(degrees)))))
    for i in range(len(size) - span):
        if size[i : i + span].all():
            return float(degrees[i])
    return math.nan


def means_of(history: ForceHistory) -> FloatArray:
    """Means over 1° [N] at whole degrees within |θ| < 85°, shape [theta, 2]."""
    return history.means(np.radians(WHOLE_DEG), math.radians(0.5))


def nrmsd_percent(measured: ForceHistory, model: ForceHistory) -> dict[str, float]:
    """Deviation of a model from a measurement, ``Fx`` and ``Fz`` [%].

    The root mean square of the difference of means over 1° within |θ| < 85°, which both must
    cover, in percent of the measured peak-to-peak: the NRMSD of Xu & Wang.
    """
    return nrmsd_of_means(means_of(measured), means_of(model))


def nrmsd_of_means(data: FloatArray, guess: FloatArray) -> dict[str, float]:
    """As :func:`nrmsd_percent`, of what :func:`means_of` makes of the two."""
    off = np.sqrt(np.mean((data - guess) ** 2, axis=0))
    fx, fz = (100.0 * off / np.ptp(data, axis=0)).tolist()
    return {"Fx": fx, "Fz": fz}


def off_by_percent(peaks_N: Mapping[float, Mapping[str, float]]) -> float:
    """Root mean square of the relative errors of the four peaks that the paper prints [%]."""
    return 100.0 * rms(
        [
            peaks_N[phi][force] / value - 1.0
            for phi, values in PAPER_PEAKS_N.items()
            for force, value in values.items()
        ]
    )


def rms(values: ArrayLike) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def both(values: Mapping[str, float], unit: str = "", digits: str = ".1f") -> str:
    """Values of both forces with their unit, such as ``8.6 / 10.2 N``, that of F_z first."""
    return " / ".join(f"{values[force]:{digits}}" for force in FORCES) + unit


def peaks_beside_paper(phi_deg: float, peaks_N: Mapping[str, float]) -> Beside:
    """Peaks at one of :data:`ENDS_DEG` beside those that the paper prints."""
    printed = PAPER_PEAKS_N[phi_deg]
    return (f"peaks Fz / Fx at {phi_deg:g}°", both(peaks_N, " N"), both(printed, " N"))


def engagement_beside_paper(angles_deg: Sequence[float]) -> Beside:
    """Median of the angles of first resistance beside the paper's."""
    return (
        "leg angle of first resistance (ours: median)",
        f"{np.median(angles_deg):.0f}°",
        f"about {PAPER_ENGAGEMENT_DEG:.0f}°",
    )


def answer_of(one: Measurement, found: Inversion) -> dict[str, Any]:
    """What an inversion makes of a measured record, beside its angle of repose, JSON-able."""
    plane = found.phi_plane_strain
    return {
        "library": found.library,
        "yield": found.convention,
        "medium": medium_and_leg(one.name)[0],
        "leg": one.leg,
        "phi_median_deg": found.phi.median,
        "ci95_deg": list(found.phi.ci95),
        "phi_plane_strain_deg": plane.median if plane else None,
        "verdict": found.verdict.verdict,
        "angle_of_repose_deg": one.angle_of_repose_deg,
    }


def recovered(found: Sequence[tuple[float, Inversion]]) -> dict[str, Any]:
    """How far answers are from the truth, how wide, and how many hold it.

    Parameters
    ----------
    found
        True friction angle [deg] and answer of each case.

    Returns
    -------
    dict
        ``cases``; ``abs_error_deg`` and ``ci68_half_width_deg`` (``median``, ``max``); ``inside68``
        and ``inside95``.
    """
    error = np.array([abs(answer.phi.median - truth) for truth, answer in found])
    half = np.array([0.5 * (a.phi.ci68[1] - a.phi.ci68[0]) for _, a in found])
    return {
        "cases": len(found),
        "abs_error_deg": {"median": float(np.median(error)), "max": float(error.max())},
        "ci68_half_width_deg": {"median": float(np.median(half)), "max": float(half.max())},
        "inside68": sum(a.phi.ci68[0] <= truth <= a.phi.ci68[1] for truth, a in found),
        "inside95": sum(a.phi.ci95[0] <= truth <= a.phi.ci95[1] for truth, a in found),
    }


class Truth(NamedTuple):
    """A history whose friction angle is known."""

    phi_deg: float
    history: ForceHistory


def straight_truths(library: Library) -> list[Truth]:
    """Finished histories of a library's straight leg."""
    return [
        Truth(case.scenario.soil.friction_angle_deg, case.history)
        for case in library.cases
        if case.history and case.scenario.leg.shape == "straight"
    ]
