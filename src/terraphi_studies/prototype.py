"""Prototype: what the contact of the paper's public prototype counts, and what it applies.

The prototype counts more force than it applies to the soil (``docs/explanation/prototype.md``). The
cases of the shipped plan ``prototype`` are at φ = 25° and 45° (the paper's convention), the ends of
the paper's library: preset ``paper-code-1`` at three speeds k, and with one thing changed. Damping
keeps its factor a step at every k, as it would in the prototype. A force that grows with the speed
is not strength of the soil, which has none that does: what a line through the peaks over k leaves
at k = 0 is told beside them, for the contact of the paper's text as well.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from terraphi.experiment.documents import shipped_folder, shipped_names
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.measurements import measurement
from terraphi.experiment.scenario import Scenario
from terraphi.library.build import cases_folder, finished_cases
from terraphi.library.plan import Plan
from terraphi.library.store import Case, Library
from terraphi.view.table import Table
from terraphi_studies import PAPER_LIBRARY, PROTOTYPE_LIBRARY, Study
from terraphi_studies.benchmark import PHI_DEG, FinishedCase, in_the_sand
from terraphi_studies.measures import (
    ENDS_DEG,
    FORCES,
    PAPER_ANGLES_DEG,
    PAPER_ENGAGEMENT_DEG,
    PAPER_PEAKS_N,
    both,
    engagement_beside_paper,
    engagement_deg,
    nrmsd_percent,
    off_by_percent,
    peak_angles_of,
    peaks_beside_paper,
    peaks_of,
)
from terraphi_studies.pictures import speeds_figure
from terraphi_studies.planned import Simulations, missing_from, not_yet, steps_of

NAME = "prototype"
SAND, LEG = "li2013:yuma/straight", "straight"
TOLD_DEG = (*ENDS_DEG, PHI_DEG)
"""Friction angles at which the deviation from the sand is told in words [deg]."""
CODE, TEXT = "its code", "its text"
MODELS = (TEXT, CODE, "")
"""Whose contact a case has, in the table's order; empty of one with something else changed."""
SPEED_ASIDE = {
    "soil.friction_angle_deg": 35.0,
    "numerics.seed": 0,
    "numerics.speed_up": 1.0,
    "numerics.damping_rate": 0.0,
    "motion.start_deg": -95.0,
    "motion.stop_deg": 20.0,
}
"""Keys in which cases of one model may differ: damping goes with the speed."""


def _counted(force: str) -> Any:
    def cell(case: Mapping[str, Any]) -> str:
        angles = case.get("angles_deg")
        at = f" at {angles[force]:.0f}°" if angles else ""
        return f"{case['counted_peaks_N'][force]:.1f} N{at}"

    return cell


def _share(key: str) -> Any:
    return lambda case: (
        both({f: 100.0 * case[key][f] for f in FORCES}, " %", ".0f") if key in case else ""
    )


COLUMNS = (
    ("", "{name}"),
    ("counted Fz", _counted("Fz")),
    ("counted Fx", _counted("Fx")),
    (
        "applied Fz / Fx",
        lambda case: both(case["applied_peaks_N"], " N") if "applied_peaks_N" in case else "",
    ),
    ("of the peaks", _share("share_of_peaks")),
    ("of the path", _share("share_of_path")),
    (
        "engages",
        lambda case: f"{case['engagement_deg']:.0f}°" if "engagement_deg" in case else "",
    ),
)


def run(*, cases: Simulations) -> Study:
    """Set what is counted beside what is applied, in the finished cases of the plan.

    Parameters
    ----------
    cases
        Where they are, and who simulates what is missing.

    Returns
    -------
    Study
        ``data``: ``cases`` (``name``, ``model``, ``phi_deg``, ``speed_up``; ``counted_peaks_N``,
        ``applied_peaks_N``, ``share_of_peaks`` and ``share_of_path`` by force; ``angles_deg`` of
        the counted peaks; ``engagement_deg``); ``off_by_percent`` of the paper's four peaks, of its
        code and its text; ``without_speed``, list of ``model``, ``phi_deg``, ``force``, ``kind``
        (``counted`` or ``applied``), ``speeds``, ``peak_N`` at k = 0, ``share`` of that at k = 1
        and ``line_off_percent``, the farthest peak from the line; ``nrmsd_percent``, list of
        ``phi_deg`` and, by force, ``counted``, ``applied`` and ``text``: deviations from the
        straight leg in Yuma sand; ``missing``. A figure of the peaks over the speed.

    Raises
    ------
    InputError
        If the folder cannot be written, a simulation failed or was interrupted.
    """
    plan = Plan.load(NAME)
    return study_of(plan, cases.histories(plan), _cases_so_far(PROTOTYPE_LIBRARY))


def study_of(
    plan: Plan, finished: Mapping[str, ForceHistory], library: Sequence[FinishedCase] = ()
) -> Study:
    """The study on what is finished.

    Parameters
    ----------
    plan
        Of steps that change the base.
    finished
        Histories by the hash of their scenario.
    library
        Cases of the prototype's library, over the whole path, for the deviation from the sand.

    Returns
    -------
    Study
        As :func:`run` describes it.
    """
    runs = [
        (f"{case.scenario.soil.friction_angle_deg:g}°, {TEXT}", case.scenario, case.history)
        for case in Library.load(PAPER_LIBRARY).cases
        if case.scenario.soil.friction_angle_deg in ENDS_DEG and case.history
    ]
    models = {_speed_aside(runs[0][1]): TEXT, _speed_aside(plan.scenario): CODE}
    steps = steps_of(plan)
    runs += [(name, s, finished[s.hash]) for name, s in steps.items() if s.hash in finished]
    cases = [
        _measured(name, models.get(_speed_aside(scenario), ""), scenario, history)
        for name, scenario, history in runs
    ]
    cases.sort(key=lambda case: (case["phi_deg"], MODELS.index(case["model"]), case["speed_up"]))
    lines, missing = _without_speed(cases), missing_from(steps, finished)
    data = {
        "cases": cases,
        "off_by_percent": _off_by(cases),
        "without_speed": lines,
        "nrmsd_percent": _in_yuma(library),
        "missing": list(missing),
    }
    at_true_speed = [case for case in cases if (case["model"], case["speed_up"]) == (CODE, 1.0)]
    return Study(
        table=Table.of(
            "Force that the contact of the paper's prototype counts, and force that it applies",
            COLUMNS,
            _rows(cases, lines),
        ),
        data=data,
        figures={NAME: speeds_figure(cases, lines)},
        notes=[*_notes(data), *not_yet(NAME, missing)],
        beside_paper=[
            *(
                peaks_beside_paper(case["phi_deg"], case["counted_peaks_N"])
                for case in at_true_speed
            ),
            engagement_beside_paper([case["engagement_deg"] for case in at_true_speed]),
        ],
    )


def _cases_so_far(name: str) -> list[FinishedCase]:
    """Straight leg's cases of a shipped library; of one that is being built, the finished ones."""
    if name in shipped_names("libraries", ".nc"):
        cases = Library.load(name).cases
    else:
        done = finished_cases(cases_folder(shipped_folder("libraries", f"{name}.nc")))
        cases = tuple(Case(s, done.get(s.hash), "") for s in Plan.load(name).cases())
    return [
        FinishedCase(case.scenario, case.history)
        for case in cases
        if case.history and case.scenario.leg.shape == LEG
    ]


def _speed_aside(scenario: Scenario) -> str:
    """Hash of a scenario but for what :data:`SPEED_ASIDE` names."""
    return scenario.replace(**SPEED_ASIDE).hash


def _measured(name: str, model: str, scenario: Scenario, history: ForceHistory) -> dict[str, Any]:
    """What a case counted and applied: the same, unless its contact kept what it applied."""
    counted, kept = peaks_of(history), history.applied()
    applied = {f: float(getattr(kept, f).max()) for f in FORCES} if kept else counted
    ends = history.position[0], history.position[-1]
    middle, half = np.array([sum(ends) / 2.0]), (ends[1] - ends[0]) / 2.0
    fx, fz = ((kept or history).force.mean(axis=0) / history.means(middle, half)[0]).tolist()
    share = {"Fz": fz, "Fx": fx}
    return {
        "name": name,
        "model": model,
        "phi_deg": scenario.soil.friction_angle_deg,
        "speed_up": scenario.numerics.speed_up,
        "counted_peaks_N": counted,
        "applied_peaks_N": applied,
        "share_of_peaks": {force: applied[force] / counted[force] for force in FORCES},
        "share_of_path": share,
        "angles_deg": peak_angles_of(history),
        "engagement_deg": engagement_deg(history),
    }


def _off_by(cases: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Error of the peaks at the true speed, by model, root mean square [%]."""
    peaks = {
        model: {
            case["phi_deg"]: case["counted_peaks_N"]
            for case in cases
            if (case["model"], case["speed_up"]) == (model, 1.0)
        }
        for model in (TEXT, CODE)
    }
    return {m: off_by_percent(ends) for m, ends in peaks.items() if len(ends) == len(ENDS_DEG)}


def _without_speed(cases: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Peaks that lines over the speed leave at k = 0, where two speeds at least are finished."""
    lines = []
    for (phi, model), some in itertools.groupby(cases, lambda c: (c["phi_deg"], c["model"])):
        group = list(some)
        speeds = np.array([case["speed_up"] for case in group])
        if not model or len(speeds) < 2 or speeds[0] != 1.0:
            continue
        kinds = ("counted", "applied") if model == CODE else ("counted",)
        for kind, force in itertools.product(kinds, FORCES):
            peaks = np.array([case[f"{kind}_peaks_N"][force] for case in group])
            slope, left = np.polyfit(speeds, peaks, 1)
            off = np.abs(left + slope * speeds - peaks) / peaks
            lines.append(
                {
                    "model": model,
                    "phi_deg": phi,
                    "kind": kind,
                    "force": force,
                    "speeds": speeds.tolist(),
                    "peak_N": float(left),
                    "slope_N": float(slope),
                    "share": float(left / peaks[0]),
                    "line_off_percent": 100.0 * float(off.max()),
                }
            )
    return lines


def _in_yuma(library: Sequence[FinishedCase]) -> list[dict[str, Any]]:
    """Deviations from the sand of what is counted and applied, and of the text's forces."""
    sand = measurement(SAND)
    by_text = {
        case.scenario.soil.friction_angle_deg: FinishedCase(case.scenario, case.history)
        for case in Library.load(PAPER_LIBRARY).cases
        if case.history
    }
    found = []
    for case in library:
        counted = in_the_sand(case, sand)
        phi = case.scenario.soil.friction_angle_deg
        histories = {"counted": counted, "applied": counted.applied() or counted}
        if phi in by_text:
            histories["text"] = in_the_sand(by_text[phi], sand)
        deviations = {name: nrmsd_percent(sand.history, h) for name, h in histories.items()}
        found.append({"phi_deg": phi, **deviations})
    return found


# -- what people see -------------------------------------------------------------------------------


def _rows(
    cases: Sequence[Mapping[str, Any]], lines: Sequence[Mapping[str, Any]]
) -> list[Mapping[str, Any]]:
    """At each end the paper's peaks, then each model's cases and what is left without speed."""
    rows: list[Mapping[str, Any]] = []
    for phi, printed in PAPER_PEAKS_N.items():
        rows.append(
            {
                "name": f"{phi:g}°, the paper",
                "counted_peaks_N": printed,
                "angles_deg": PAPER_ANGLES_DEG,
                "engagement_deg": PAPER_ENGAGEMENT_DEG,
            }
        )
        for model in MODELS:
            at = (model, phi)
            rows += [case for case in cases if (case["model"], case["phi_deg"]) == at]
            left = [line for line in lines if (line["model"], line["phi_deg"]) == at]
            if left:
                rows.append(_row_of_lines(*at, left))
    return rows


def _row_of_lines(model: str, phi: float, lines: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """What is left without speed: a row of figures that no simulation has."""
    peaks: dict[str, dict[str, float]] = {}
    for line in lines:
        peaks.setdefault(line["kind"], {})[line["force"]] = line["peak_N"]
    counted = peaks["counted"]
    applied = peaks.get("applied", counted)
    return {
        "name": f"{phi:g}°, {model}, a line to k = 0",
        "counted_peaks_N": counted,
        "applied_peaks_N": applied,
        "share_of_peaks": {force: applied[force] / counted[force] for force in FORCES},
    }


def _notes(data: Mapping[str, Any]) -> list[str]:
    off = [f"{model} {percent:.0f} %" for model, percent in data["off_by_percent"].items()]
    notes = [f"Off the paper's four peaks, root mean square: {', '.join(off)}."] if off else []
    groups: dict[str, list[Mapping[str, Any]]] = {}
    for line in data["without_speed"]:
        who = line["model"] if line["model"] == TEXT else f"{line['model']}, {line['kind']}"
        groups.setdefault(who, []).append(line)
    notes += [_about_speed(who, lines) for who, lines in groups.items()]
    notes += _about_parts(data)
    return notes + [_about_sand(row) for row in data["nrmsd_percent"] if row["phi_deg"] in TOLD_DEG]


def _about_speed(who: str, lines: Sequence[Mapping[str, Any]]) -> str:
    """How much of the peaks is left without speed, at all angles and of both forces."""
    shares = [100.0 * line["share"] for line in lines]
    speeds = sorted({speed for line in lines for speed in line["speeds"]})
    left = (
        f"{who}: of the peaks at k = 1 a line over k = {', '.join(f'{k:g}' for k in speeds)} "
        f"leaves {min(shares):.0f} to {max(shares):.0f} % at k = 0"
    )
    if len(speeds) == 2:  # a line meets two points
        return f"{left}."
    off = max(line["line_off_percent"] for line in lines)
    return f"{left}; no peak is more than {off:.1f} % off it."


def _about_parts(data: Mapping[str, Any]) -> list[str]:
    """What the counted peaks at k = 1 are made of, if lines tell what is left of them."""
    shares = {
        case["phi_deg"]: case["share_of_peaks"]
        for case in data["cases"]
        if (case["model"], case["speed_up"]) == (CODE, 1.0)
    }
    parts = []
    for line in (line for line in data["without_speed"] if line["kind"] == "applied"):
        applied = shares[line["phi_deg"]][line["force"]]
        left = applied * line["share"]
        parts.append([1.0 - applied, applied - left, left])
    if not parts:
        return []
    percent = 100.0 * np.array(parts)
    low, high = percent.min(axis=0), percent.max(axis=0)
    told = [f"{least:.0f} to {most:.0f} %" for least, most in zip(low, high, strict=True)]
    first = f"Of the peaks that {CODE} counts at k = 1, {told[0]} are not applied"
    return [f"{first}, {told[1]} are applied and go with the speed, {told[2]} are left."]


def _about_sand(row: Mapping[str, Any]) -> str:
    names = {"counted": "counted", "applied": "applied", "text": TEXT}
    parts = [f"{name} {both(row[kind], ' %')}" for kind, name in names.items() if kind in row]
    return f"NRMSD Fz / Fx from Yuma sand at {row['phi_deg']:g}°: {', '.join(parts)}."
