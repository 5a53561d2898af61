"""Prototype: what the contact of the paper's public prototype counts, and what it applies.

The prototype counts more force than it applies to the soil (``docs/explanation/prototype.md``). The
cases of the shipped plan ``prototype`` are at φ = 25° and 45° (the paper's convention), the ends of
the paper's library: preset ``paper-code-1`` at three speeds k, and with one thing changed. Damping
keeps its factor a step at every k, as it would in the prototype. A force that grows with the speed
is not strength of the soil, which has none that does: what a line through the peaks over k leaves
at k = 0 is told beside them, for the contact of the paper's text as well.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from terraphi.experiment.documents import shipped_folder, shipped_names
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.measurements import measurement
from terraphi.experiment.scenario import Scenario
from terraphi.library.build import cases_folder, finished_cases
from terraphi.library.plan import BASE, Plan
from terraphi.library.store import Case, Library
from terraphi.view.table import Table
from terraphi_studies import PAPER_LIBRARY, PROTOTYPE_LIBRARY, Beside, Study
from terraphi_studies.benchmark import PHI_DEG, FinishedCase, in_the_sand, nrmsd_percent
from terraphi_studies.pictures import speeds_figure
from terraphi_studies.planned import Simulations, missing_from, not_yet, of_plans
from terraphi_studies.reading import (
    ENDS_DEG,
    PAPER_ANGLES_DEG,
    PAPER_ENGAGEMENT_DEG,
    PAPER_PEAKS_N,
    engagement_deg,
    off_by_percent,
)

NAME = "prototype"
SAND, LEG = "li2013:yuma/straight", "straight"
FORCES = ("Fz", "Fx")
TOLD_DEG = (*ENDS_DEG, PHI_DEG)
"""Friction angles at which the deviation from the sand is told in words [deg]."""
CODE, TEXT = "its code", "its text"
HEADER = (
    *("", "counted Fz", "counted Fx", "applied Fz / Fx"),
    *("of the peaks", "of the path", "engages"),
)
SPEED_ASIDE = {
    "soil.friction_angle_deg": 35.0,
    "numerics.seed": 0,
    "numerics.speed_up": 1.0,
    "numerics.damping_rate": 0.0,
    "motion.start_deg": -95.0,
    "motion.stop_deg": 20.0,
}
"""Keys in which cases of one model may differ: damping goes with the speed."""


class Forces(NamedTuple):
    """What a case counted and applied."""

    name: str
    model: str
    """:data:`CODE` or :data:`TEXT`; empty of a case with something else changed."""
    scenario: Scenario
    counted: ForceHistory
    applied: ForceHistory
    """The counted one itself of a contact that counts what it applies."""

    @property
    def phi_deg(self) -> float:
        """Friction angle [deg], by the paper's convention."""
        return self.scenario.soil.friction_angle_deg

    @property
    def speed_up(self) -> float:
        """Factor k of the speed [-]."""
        return self.scenario.numerics.speed_up

    def peaks(self, kind: str) -> dict[str, float]:
        """Largest means over a degree [N], by force; ``kind`` is ``counted`` or ``applied``."""
        if kind == "counted" or self.applied is self.counted:
            found = self.counted.peaks()
            return {"Fz": found.Fz, "Fx": found.Fx}
        return {"Fz": float(self.applied.Fz.max()), "Fx": float(self.applied.Fx.max())}

    def share_of_path(self) -> dict[str, float]:
        """Mean of the applied over mean of the counted force along the path [-], by force."""
        ends = self.counted.position[0], self.counted.position[-1]
        middle, half = np.array([sum(ends) / 2.0]), (ends[1] - ends[0]) / 2.0
        applied, counted = self.applied.force.mean(axis=0), self.counted.means(middle, half)[0]
        return {"Fz": float(applied[1] / counted[1]), "Fx": float(applied[0] / counted[0])}


@of_plans
def run(cases: Simulations) -> Study:
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
    text = [
        (f"{case.scenario.soil.friction_angle_deg:g}°, {TEXT}", case.scenario, case.history)
        for case in Library.load(PAPER_LIBRARY).cases
        if case.scenario.soil.friction_angle_deg in ENDS_DEG and case.history
    ]
    own = [
        (plan.scenario.name if v.key == BASE else v.key, v.scenario, finished[v.scenario.hash])
        for v in plan.variants()
        if v.scenario.hash in finished
    ]
    models = {_speed_aside(text[0][1]): TEXT, _speed_aside(plan.scenario): CODE}
    found = [
        Forces(name, models.get(_speed_aside(s), ""), s, history, history.applied() or history)
        for name, s, history in (*text, *own)
    ]
    found.sort(key=lambda f: (f.phi_deg, [TEXT, CODE, ""].index(f.model), f.speed_up))
    missing = {v.key: v.scenario for v in missing_from(plan, finished)}
    lines, cases = _without_speed(found), [_measured(forces) for forces in found]
    data = {
        "cases": cases,
        "off_by_percent": _off_by(found),
        "without_speed": lines,
        "nrmsd_percent": _in_yuma(library),
        "missing": list(missing),
    }
    return Study(
        table=Table(
            "Force that the contact of the paper's prototype counts, and force that it applies",
            HEADER,
            _rows(found, lines),
        ),
        data=data,
        figures={NAME: speeds_figure(cases, lines)},
        notes=[*_notes(data), *not_yet(NAME, missing.items(), finished)],
        beside_paper=_beside_paper(found),
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


def _measured(forces: Forces) -> dict[str, Any]:
    counted, applied = forces.peaks("counted"), forces.peaks("applied")
    peaks = forces.counted.peaks()
    return {
        "name": forces.name,
        "model": forces.model,
        "phi_deg": forces.phi_deg,
        "speed_up": forces.speed_up,
        "counted_peaks_N": counted,
        "applied_peaks_N": applied,
        "share_of_peaks": {force: applied[force] / counted[force] for force in FORCES},
        "share_of_path": forces.share_of_path(),
        "angles_deg": {"Fz": peaks.theta_Fz_deg, "Fx": peaks.theta_Fx_deg},
        "engagement_deg": engagement_deg(forces.counted),
    }


def _off_by(found: Sequence[Forces]) -> dict[str, float]:
    """Error of the peaks at the true speed, by model, root mean square [%]."""
    peaks = {
        model: {f.phi_deg: f.counted.peaks() for f in found if (f.model, f.speed_up) == (model, 1)}
        for model in (TEXT, CODE)
    }
    return {m: off_by_percent(ends) for m, ends in peaks.items() if len(ends) == len(ENDS_DEG)}


def _without_speed(found: Sequence[Forces]) -> list[dict[str, Any]]:
    """Peaks that lines over the speed leave at k = 0, where two speeds at least are finished."""
    groups: dict[tuple[str, float], list[Forces]] = {}
    for forces in found:
        if forces.model:
            groups.setdefault((forces.model, forces.phi_deg), []).append(forces)
    lines = []
    for (model, phi), group in groups.items():
        speeds = np.array([forces.speed_up for forces in group])
        if len(speeds) < 2 or speeds[0] != 1.0:
            continue
        for kind in ("counted", "applied")[: 2 if model == CODE else 1]:
            for force in FORCES:
                peaks = np.array([forces.peaks(kind)[force] for forces in group])
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
    """Deviation from measured forces [%] by φ: of the counted, the applied, and the text's."""
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


def _rows(found: Sequence[Forces], lines: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    rows = []
    for phi, paper in PAPER_PEAKS_N.items():
        peaks = [f"{paper[f]:.1f} N at {PAPER_ANGLES_DEG[f]:.0f}°" for f in FORCES]
        rows.append((f"{phi:g}°, the paper", *peaks, "", "", "", f"{PAPER_ENGAGEMENT_DEG:.0f}°"))
        cases = [_measured(forces) for forces in found if forces.phi_deg == phi]
        for model in (TEXT, CODE, ""):
            rows += [_row(case) for case in cases if case["model"] == model]
            left = [line for line in lines if (line["model"], line["phi_deg"]) == (model, phi)]
            if left:
                rows.append(_row_of_lines(left))
    return rows


def _row(case: Mapping[str, Any]) -> tuple[str, ...]:
    return (
        case["name"],
        *(f"{case['counted_peaks_N'][f]:.1f} N at {case['angles_deg'][f]:.0f}°" for f in FORCES),
        _pair(case["applied_peaks_N"], "N"),
        *(_percent(case[f"share_of_{what}"]) for what in ("peaks", "path")),
        f"{case['engagement_deg']:.0f}°",
    )


def _row_of_lines(lines: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    """What is left without speed: a row of figures that no simulation has."""
    peaks: dict[str, dict[str, float]] = {}
    for line in lines:
        peaks.setdefault(line["kind"], {})[line["force"]] = line["peak_N"]
    counted = peaks["counted"]
    applied = peaks.get("applied", counted)
    return (
        f"{lines[0]['phi_deg']:g}°, {lines[0]['model']}, a line to k = 0",
        *(f"{counted[force]:.1f} N" for force in FORCES),
        _pair(applied, "N"),
        _percent({force: applied[force] / counted[force] for force in FORCES}),
        "",
        "",
    )


def _pair(values: Mapping[str, float], unit: str) -> str:
    return " / ".join(f"{values[force]:.1f}" for force in FORCES) + f" {unit}"


def _percent(shares: Mapping[str, float]) -> str:
    return " / ".join(f"{100.0 * shares[force]:.0f}" for force in FORCES) + " %"


def _notes(data: Mapping[str, Any]) -> list[str]:
    off = [f"{model} {percent:.0f} %" for model, percent in data["off_by_percent"].items()]
    notes = [f"Off the paper's four peaks, root mean square: {', '.join(off)}."] if off else []
    groups: dict[str, list[Mapping[str, Any]]] = {}
    for line in data["without_speed"]:
        who = line["model"] if line["model"] == TEXT else f"{line['model']}, {line['kind']}"
        groups.setdefault(who, []).append(line)
    notes += [_about_speed(who, lines) for who, lines in groups.items()]
    notes += _about_parts(data)
    notes += [_about_sand(row) for row in data["nrmsd_percent"] if row["phi_deg"] in TOLD_DEG]
    return notes


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
        (case["phi_deg"], force): case["share_of_peaks"][force]
        for case in data["cases"]
        for force in FORCES
        if (case["model"], case["speed_up"]) == (CODE, 1.0)
    }
    parts = []
    for line in (line for line in data["without_speed"] if line["kind"] == "applied"):
        applied = shares[line["phi_deg"], line["force"]]
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
    parts = [f"{name} {_pair(row[kind], '%')}" for kind, name in names.items() if kind in row]
    return f"NRMSD Fz / Fx from Yuma sand at {row['phi_deg']:g}°: {', '.join(parts)}."


def _beside_paper(found: Sequence[Forces]) -> list[Beside]:
    code = [forces for forces in found if (forces.model, forces.speed_up) == (CODE, 1.0)]
    lines: list[Beside] = [
        (
            f"peaks Fz / Fx at {forces.phi_deg:g}°",
            _pair(forces.peaks("counted"), "N"),
            _pair(PAPER_PEAKS_N[forces.phi_deg], "N"),
        )
        for forces in code
    ]
    engages = float(np.median([engagement_deg(forces.counted) for forces in code]))
    what = "leg angle of first resistance (ours: median)"
    return [*lines, (what, f"{engages:.0f}°", f"about {PAPER_ENGAGEMENT_DEG:.0f}°")]
