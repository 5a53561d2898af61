"""Reading: what the paper's printed text leaves open, tried one by one against its forces.

The text fixes the equations and the numbers, and still leaves open which flow rule was meant, when
the damping acts, how wide the band of contact is, how thick the leg, what the transfer keeps, and
what counts as reaction. Each reading is simulated at φ = 25° and 45° (the paper's convention), the
ends of its library, for which the paper prints peaks. How far a reading is off is the root mean
square of the relative errors of those four peaks; where the peaks lie and where the leg first
meets resistance stand beside it. Nothing that the text says is varied.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from terraphi.experiment.history import ForceHistory, Peaks
from terraphi.library.plan import BASE, Plan
from terraphi.view.plots import readings_figure
from terraphi.view.table import Table
from terraphi_studies import Study, page
from terraphi_studies.planned import Simulations, missing_from, need_base, not_yet, of_plans

NAME = "reading"
TITLE = "Readings of the paper's text, and how far each is from its forces"
PHI = "soil.friction_angle_deg"
ENDS_DEG = (25.0, 45.0)
PAPER_PEAKS_N = {25.0: {"Fz": 8.6, "Fx": 10.2}, 45.0: {"Fz": 14.0, "Fx": 15.5}}
"""Peaks that the paper prints, by φ [deg] and force."""
PAPER_ANGLES_DEG = {"Fz": -50.0, "Fx": 0.0}
"""Leg angles at which they lie, about."""
PAPER_ENGAGEMENT_DEG = -85.0
"""Leg angle at which the leg first meets resistance, about."""
ENGAGED = 0.02
"""Share of the peak of F_z above which the leg counts as engaged."""
CLOSE_PERCENT = 15.0
"""Root mean square error of the peaks within which a reading would count as found."""
NORMAL_ONLY = "reaction without friction"
HEADER = (
    "reading",
    "Fz at 25°",
    "Fx at 25°",
    "Fz at 45°",
    "Fx at 45°",
    "peaks at (45°)",
    "engages (45°)",
    "off by",
)


@of_plans
def run(cases: Simulations) -> Study:
    """Compare the finished readings with the paper.

    Parameters
    ----------
    cases
        Where they are, and who simulates what is missing.

    Returns
    -------
    Study
        As :func:`study_of` describes it.

    Raises
    ------
    InputError
        If the base is not simulated yet, the folder cannot be written, or a simulation failed.
    """
    plans = plans_at_both_ends(Plan.load(NAME))
    finished = cases.histories(*plans.values(), keep_failures=True)
    return study_of(plans, finished, cases.failures(NAME))


def plans_at_both_ends(plan: Plan) -> dict[float, Plan]:
    """The plan with its base at either end of the paper's library, by φ [deg]."""
    return {
        phi: plan.model_copy(update={"scenario": plan.scenario.replace(**{PHI: phi})})
        for phi in ENDS_DEG
    }


def study_of(
    plans: Mapping[float, Plan],
    finished: Mapping[str, ForceHistory],
    failed: Mapping[str, str] = MappingProxyType({}),
) -> Study:
    """The study on what is finished.

    Parameters
    ----------
    plans
        Of steps that each change the base, by φ [deg].
    finished
        Histories by the hash of their scenario.
    failed
        Why others could not be simulated, likewise.

    Returns
    -------
    Study
        ``data``: ``paper`` (``peaks_N`` by φ, ``angles_deg``, ``engagement_deg``), ``readings``
        (list of ``reading``, ``peaks_N`` and ``angles_deg`` by φ, ``engagement_deg``,
        ``off_by_percent``, least first), ``closest``, ``failed`` (why, by reading and φ) and
        ``missing``.

    Raises
    ------
    InputError
        If the base is not among the finished, at both ends.
    """
    for plan in plans.values():
        need_base(plan, finished)
    pairs = _pairs(plans, finished)
    pairs[NORMAL_ONLY] = {phi: normal_part(history) for phi, history in pairs[BASE].items()}
    readings = sorted(
        (_measured(name, pair) for name, pair in pairs.items()),
        key=lambda reading: reading["off_by_percent"],
    )
    name = next(iter(plans.values())).scenario.name
    for reading in readings:
        reading["reading"] = name if reading["reading"] == BASE else reading["reading"]
    waiting = {
        f"{v.key} at {phi:g}°": v.scenario
        for phi, plan in plans.items()
        for v in missing_from(plan, finished)
    }
    broken = {name: failed[s.hash] for name, s in waiting.items() if s.hash in failed}
    missing = {name: s for name, s in waiting.items() if name not in broken}
    data = {
        "paper": {
            "peaks_N": PAPER_PEAKS_N,
            "angles_deg": PAPER_ANGLES_DEG,
            "engagement_deg": PAPER_ENGAGEMENT_DEG,
        },
        "readings": readings,
        "closest": readings[0]["reading"],
        "failed": broken,
        "missing": list(missing),
    }
    rows = [_paper_row(), *(_row(reading) for reading in readings)]
    rows += _broken_rows(plans, finished, failed)
    table = Table(TITLE, HEADER, rows)
    notes = [*_notes(data), *not_yet(NAME, missing.items(), finished)]
    picture = "peaks of each reading at both ends of the library, and the paper's"
    return Study(
        table=table,
        data=data,
        figures={NAME: readings_figure(readings, PAPER_PEAKS_N)},
        documents={f"{NAME}.md": page(table, METHOD, notes, f"{NAME}.png", picture)},
        notes=notes,
    )


def _pairs(
    plans: Mapping[float, Plan], finished: Mapping[str, ForceHistory]
) -> dict[str, dict[float, ForceHistory]]:
    """Histories at both ends, by reading; those with both alone."""
    found: dict[str, dict[float, ForceHistory]] = {}
    for phi, plan in plans.items():
        for variant in plan.variants():
            if variant.scenario.hash in finished:
                found.setdefault(variant.key, {})[phi] = finished[variant.scenario.hash]
    return {name: pair for name, pair in found.items() if len(pair) == len(plans)}


def normal_part(history: ForceHistory) -> ForceHistory:
    """What is left of a straight leg's forces if friction along it does not count.

    Parameters
    ----------
    history
        Forces over θ.

    Returns
    -------
    ForceHistory
        (F·n) n with n = (cos θ, -sin θ), normal to the leg whose direction is (-sin θ, -cos θ);
        the round ends count as parts of the faces.
    """
    normal = np.stack([np.cos(history.position), -np.sin(history.position)], axis=1)
    along = np.sum(history.force * normal, axis=1, keepdims=True)
    return ForceHistory(history.position, along * normal, history.coordinate, history.axes)


def engagement_deg(history: ForceHistory) -> float:
    """Leg angle from which on |F| stays above :data:`ENGAGED` of the peak of F_z for 5° [deg]."""
    size = np.hypot(history.Fx, history.Fz) > ENGAGED * history.peaks().Fz
    degrees = history.theta_deg
    span = max(1, round(5.0 / float(np.median(np.diff(degrees)))))
    for i in range(len(size) - span):
        if size[i : i + span].all():
            return float(degrees[i])
    return math.nan


def _measured(name: str, pair: Mapping[float, ForceHistory]) -> dict[str, Any]:
    peaks = {phi: history.peaks() for phi, history in pair.items()}
    return {
        "reading": name,
        "peaks_N": {phi: {"Fz": p.Fz, "Fx": p.Fx} for phi, p in peaks.items()},
        "angles_deg": {
            phi: {"Fz": p.theta_Fz_deg, "Fx": p.theta_Fx_deg} for phi, p in peaks.items()
        },
        "engagement_deg": engagement_deg(pair[ENDS_DEG[-1]]),
        "off_by_percent": off_by_percent(peaks),
    }


def off_by_percent(peaks: Mapping[float, Peaks]) -> float:
    """Root mean square of the relative errors of the four peaks that the paper prints [%].

    Parameters
    ----------
    peaks
        By φ [deg], those of :data:`PAPER_PEAKS_N`.
    """
    errors = [
        getattr(peaks[phi], force) / value - 1.0
        for phi, values in PAPER_PEAKS_N.items()
        for force, value in values.items()
    ]
    return 100.0 * float(np.sqrt(np.mean(np.square(errors))))


# -- what people see -------------------------------------------------------------------------------

METHOD = (
    "Straight leg, φ = 25° and 45° by the paper's convention, preset `paper-1` four times sped up, "
    "one thing read differently at a time. Off by: root mean square of the relative errors of the "
    "four peaks that the paper prints. Engages: |F| stays above 2 % of the peak of F_z from there "
    "on; a bare leg touches the soil at -75°. Plan: `reading`. Run again: `terraphi study reading`."
)


def _paper_row() -> tuple[str, ...]:
    peaks = [f"{PAPER_PEAKS_N[phi][force]:.1f} N" for phi in ENDS_DEG for force in ("Fz", "Fx")]
    angles = f"{PAPER_ANGLES_DEG['Fz']:.0f}°, {PAPER_ANGLES_DEG['Fx']:.0f}°"
    return ("the paper", *peaks, angles, f"{PAPER_ENGAGEMENT_DEG:.0f}°", "")


def _row(reading: Mapping[str, Any]) -> tuple[str, ...]:
    peaks = [f"{reading['peaks_N'][phi][f]:.1f} N" for phi in ENDS_DEG for f in ("Fz", "Fx")]
    angles = reading["angles_deg"][ENDS_DEG[-1]]
    return (
        reading["reading"],
        *peaks,
        f"{angles['Fz']:.0f}°, {angles['Fx']:.0f}°",
        f"{reading['engagement_deg']:.0f}°",
        f"{reading['off_by_percent']:.0f} %",
    )


def _broken_rows(
    plans: Mapping[float, Plan], finished: Mapping[str, ForceHistory], failed: Mapping[str, str]
) -> list[tuple[str, ...]]:
    """Readings that break down at one end or both, with the peaks of the other."""
    cells: dict[str, list[str]] = {}
    broken = set()
    for plan in plans.values():
        for variant in plan.variants():
            key = variant.scenario.hash
            if key in failed:
                broken.add(variant.key)
            if key in finished:
                peaks = finished[key].peaks()
                shown = [f"{peak:.1f} N" for peak in (peaks.Fz, peaks.Fx)]
            else:
                shown = ["breaks down" if key in failed else "not yet"] * 2
            cells.setdefault(variant.key, []).extend(shown)
    return [(name, *shown, "", "", "") for name, shown in cells.items() if name in broken]


def _notes(data: Mapping[str, Any]) -> Sequence[str]:
    first = data["readings"][0]
    notes = [
        f"Closest to the paper's peaks: {first['reading']}, off by {first['off_by_percent']:.0f} %."
    ]
    if first["off_by_percent"] > CLOSE_PERCENT:
        notes.append(
            f"No reading comes within {CLOSE_PERCENT:g} %: the forces that the paper prints are "
            "not reproduced."
        )
    wider = [
        reading["reading"]
        for reading in data["readings"]
        if all(p["Fx"] > p["Fz"] for p in reading["peaks_N"].values())
    ]
    which = ", ".join(wider) if wider else "no reading here"
    notes.append(f"The paper's F_x exceeds its F_z at both ends; so does that of: {which}.")
    notes += [
        f"Cannot be simulated to the end: {name}: {why}." for name, why in data["failed"].items()
    ]
    return notes
