"""Reading: what the paper's printed text leaves open, tried one by one against its forces.

The text fixes the equations and the numbers, and still leaves open which flow rule was meant, when
the damping acts, how wide the band of contact is, how thick the leg, what the transfer keeps, and
what counts as reaction. Each reading is simulated at φ = 25° and 45° (the paper's convention), the
ends of its library, for which the paper prints peaks. How far a reading is off is the root mean
square of the relative errors of those four peaks; where the peaks lie and where the leg first
meets resistance stand beside it. Nothing that the text says is varied.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np

from terraphi.experiment.history import ForceHistory
from terraphi.experiment.scenario import Scenario
from terraphi.library.plan import Plan
from terraphi.view.table import Table
from terraphi_studies import Study, page
from terraphi_studies.measures import (
    ENDS_DEG,
    FORCES,
    PAPER_ANGLES_DEG,
    PAPER_ENGAGEMENT_DEG,
    PAPER_PEAKS_N,
    PHI,
    engagement_deg,
    off_by_percent,
    peak_angles_of,
    peaks_of,
)
from terraphi_studies.pictures import readings_figure
from terraphi_studies.planned import Simulations, missing_from, need_base, not_yet, steps_of

NAME = "reading"
TITLE = "Readings of the paper's text, and how far each is from its forces"
CLOSE_PERCENT = 15.0
"""Root mean square error of the peaks within which a reading would count as found."""
NORMAL_ONLY = "reaction without friction"
METHOD = (
    "Straight leg, φ = 25° and 45° by the paper's convention, preset `paper-1` four times sped up, "
    "with the drag on the soil that it has at the true speed, one thing read differently at a "
    "time. Off by: root mean square of the relative errors of the four peaks that the paper "
    "prints. Engages: |F| stays above 2 % of the peak of F_z from there on; a bare leg touches the "
    "soil at -75°. Plan: `reading`. Run again: `terraphi study reading`."
)
PICTURE = "peaks of each reading at both ends of the library, and the paper's"


def _peak(phi: float, force: str, reading: Mapping[str, Any]) -> str:
    peak = reading["peaks_N"][phi]
    return peak if isinstance(peak, str) else f"{peak[force]:.1f} N"


def _angles(reading: Mapping[str, Any]) -> str:
    angles = reading["angles_deg"][ENDS_DEG[-1]]
    return ", ".join(f"{angles[force]:.0f}°" for force in FORCES)


def _if_known(key: str, unit: str) -> Any:
    return lambda reading: f"{reading[key]:.0f}{unit}" if key in reading else ""


COLUMNS = (
    ("reading", "{reading}"),
    *((f"{force} at {phi:g}°", partial(_peak, phi, force)) for phi in ENDS_DEG for force in FORCES),
    ("peaks at (45°)", lambda reading: _angles(reading) if "angles_deg" in reading else ""),
    ("engages (45°)", _if_known("engagement_deg", "°")),
    ("off by", _if_known("off_by_percent", " %")),
)


def run(*, cases: Simulations) -> Study:
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
    steps = {phi: steps_of(plan) for phi, plan in plans.items()}
    ends = {name: {phi: steps[phi][name] for phi in steps} for name in steps[ENDS_DEG[0]]}
    pairs = {
        name: {phi: finished[s.hash] for phi, s in pair.items()}
        for name, pair in ends.items()
        if not missing_from(pair, finished)
    }
    base = plans[ENDS_DEG[0]].scenario.name
    pairs[NORMAL_ONLY] = {phi: normal_part(history) for phi, history in pairs[base].items()}
    readings = [_measured(name, pair) for name, pair in pairs.items()]
    readings.sort(key=lambda reading: reading["off_by_percent"])
    planned = {f"{name} at {phi:g}°": s for phi in steps for name, s in steps[phi].items()}
    waiting = missing_from(planned, finished)
    broken = {name: failed[s.hash] for name, s in waiting.items() if s.hash in failed}
    missing = {name: s for name, s in waiting.items() if name not in broken}
    paper = {
        "peaks_N": PAPER_PEAKS_N,
        "angles_deg": PAPER_ANGLES_DEG,
        "engagement_deg": PAPER_ENGAGEMENT_DEG,
    }
    data = {
        "paper": paper,
        "readings": readings,
        "closest": readings[0]["reading"],
        "failed": broken,
        "missing": list(missing),
    }
    first = {**paper, "reading": "the paper", "angles_deg": {ENDS_DEG[-1]: PAPER_ANGLES_DEG}}
    table = Table.of(TITLE, COLUMNS, [first, *readings, *_broken(ends, finished, failed)])
    notes = [*_notes(data), *not_yet(NAME, missing)]
    return Study(
        table=table,
        data=data,
        figures={NAME: readings_figure(readings, PAPER_PEAKS_N)},
        documents=page(NAME, table, METHOD, notes, PICTURE),
        notes=notes,
    )


def normal_part(history: ForceHistory) -> ForceHistory:
    """What is left of a straight leg's forces if friction along it does not count.

    (F·n) n with n = (cos θ, -sin θ), normal to the leg whose direction is (-sin θ, -cos θ); the
    round ends count as parts of the faces.
    """
    normal = np.stack([np.cos(history.position), -np.sin(history.position)], axis=1)
    along = np.sum(history.force * normal, axis=1, keepdims=True)
    return ForceHistory(history.position, along * normal, history.coordinate, history.axes)


def _measured(name: str, pair: Mapping[float, ForceHistory]) -> dict[str, Any]:
    peaks = {phi: peaks_of(history) for phi, history in pair.items()}
    return {
        "reading": name,
        "peaks_N": peaks,
        "angles_deg": {phi: peak_angles_of(history) for phi, history in pair.items()},
        "engagement_deg": engagement_deg(pair[ENDS_DEG[-1]]),
        "off_by_percent": off_by_percent(peaks),
    }


def _broken(
    ends: Mapping[str, Mapping[float, Scenario]],
    finished: Mapping[str, ForceHistory],
    failed: Mapping[str, str],
) -> list[dict[str, Any]]:
    """Readings that break down at one end or both, with the peaks of the other."""
    return [
        {
            "reading": name,
            "peaks_N": {
                phi: peaks_of(finished[s.hash])
                if s.hash in finished
                else ("breaks down" if s.hash in failed else "not yet")
                for phi, s in pair.items()
            },
        }
        for name, pair in ends.items()
        if any(s.hash in failed for s in pair.values())
    ]


def _notes(data: Mapping[str, Any]) -> list[str]:
    readings = data["readings"]
    closest, off = readings[0]["reading"], readings[0]["off_by_percent"]
    notes = [f"Closest to the paper's peaks: {closest}, off by {off:.0f} %."]
    if off > CLOSE_PERCENT:
        notes.append(
            f"No reading comes within {CLOSE_PERCENT:g} %: the forces that the paper prints are "
            "not reproduced."
        )
    wider = [
        r["reading"] for r in readings if all(p["Fx"] > p["Fz"] for p in r["peaks_N"].values())
    ]
    which = ", ".join(wider) if wider else "no reading here"
    notes.append(f"The paper's F_x exceeds its F_z at both ends; so does that of: {which}.")
    return notes + [
        f"Cannot be simulated to the end: {name}: {why}." for name, why in data["failed"].items()
    ]
