"""Sensitivity: what moves the simulated forces, one setting of the simulation changed at a time.

The cases are those of the shipped plan ``sensitivity``: preset ``paper-1`` four times sped up, and
each value of each key in the plan by itself. Their simulations are shipped, a file each, named by
the hash of the scenario. Reading them takes seconds; what is missing is simulated on request and
kept in a folder. Grouping and measures are in :mod:`~terraphi_studies.sensitivity_cases`.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

from terraphi.experiment.history import ForceHistory, Peaks
from terraphi.library.plan import Plan, Variant, label
from terraphi.view.plots import (
    BLUE,
    GREEN,
    ORANGE,
    PURPLE,
    Curve,
    comparison_figure,
    sensitivity_figure,
)
from terraphi.view.table import Table
from terraphi_studies import PAPER_LIBRARY, Study, capitalised, degrees, page
from terraphi_studies.planned import (
    Simulations,
    minutes_of,
    missing_from,
    need_base,
    not_yet,
    of_plans,
)
from terraphi_studies.sensitivity_cases import (
    FORCES,
    Group,
    Percent,
    Scatter,
    Simulated,
    Tolerance,
    change,
    conclude,
    groups_of,
    scatter_of,
    setting_of,
    tolerance_of,
)

NAME = "sensitivity"
TITLE = "Sensitivity of the simulated forces to the settings of the simulation"
HEADER = (
    *("setting", "value", "peak Fz", "peak Fx", "change of peaks", "as degrees of φ"),
    *("NRMSD Fz", "NRMSD Fx", "moves"),
)
BASE_LOOK = ("black", "-")
LOOKS = ((BLUE, "--"), (ORANGE, "-."), (GREEN, ":"), (PURPLE, "-"))
"""Colour and line of the other curves of a group, which differ in grey as well."""


@of_plans
def run(cases: Simulations) -> Study:
    """Measure the finished cases of the shipped plan and draw the conclusions.

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
        If the base, with which all is compared, is not simulated yet; if the folder cannot be
        written, a simulation failed or was interrupted: the others are kept.
    """
    plan = Plan.load(NAME)
    return study_of(plan, cases.histories(plan))


def study_of(plan: Plan, finished: Mapping[str, ForceHistory]) -> Study:
    """The study on what is finished of a plan.

    Parameters
    ----------
    plan
        A plan that changes one key at a time.
    finished
        Histories by the hash of their scenario.

    Returns
    -------
    Study
        ``data``: ``plan``; ``base`` (``scenario_hash``, ``peaks``); ``scatter_percent`` and
        ``tolerance_percent`` (``nrmsd`` and ``peak`` for ``Fz`` and ``Fx``); ``groups`` by key
        (``setting``, ``reference``, ``cases``; ``conclusion``, the numbers of
        :func:`~terraphi_studies.sensitivity_cases.conclude`); ``missing`` (``case``,
        ``core_minutes``). A figure of all peaks, one of the histories in each group, and a page
        with the first of them.

    Raises
    ------
    InputError
        If the base is not among the finished.
    """
    missing = missing_from(plan, finished)
    need_base(plan, finished)
    groups = groups_of(plan, finished)
    scatter = scatter_of(groups)
    tolerance = tolerance_of(scatter)
    conclusions = {group.key: conclude(group, scatter) for group in groups}
    base = finished[plan.scenario.hash].peaks()
    # The scatter first: all that follows is measured by it.
    groups.sort(key=lambda group: group.setting.rule != "scatter")
    waiting = {_named(v): v.scenario for v in missing}
    notes = [*_notes(groups, conclusions, scatter), *not_yet(NAME, waiting.items(), finished)]
    rows = [_row(group, case, tolerance) for group in groups for case in group.cases]
    table = Table(TITLE, HEADER, rows)
    picture = "change of the peak forces with each setting"
    written = page(table, _method(plan), notes, f"{NAME}.png", picture)
    return Study(
        table=table,
        data={
            "plan": plan.name,
            "base": {"scenario_hash": plan.scenario.hash, "peaks": _peaks(base)},
            "scatter_percent": {
                "seeds": scatter.runs,
                "nrmsd": scatter.nrmsd,
                "peak": scatter.peak,
            },
            "tolerance_percent": {"nrmsd": tolerance.nrmsd, "peak": tolerance.peak},
            "groups": {g.key: _group_data(g, tolerance, conclusions[g.key]) for g in groups},
            "missing": [
                {"case": label(v), "core_minutes": minutes_of(v.scenario, finished)}
                for v in missing
            ],
        },
        figures=_figures(groups, tolerance),
        documents={f"{NAME}.md": written},
        notes=notes,
    )


# -- what people see -------------------------------------------------------------------------------


def _method(plan: Plan) -> str:
    scenario = plan.scenario
    return (
        f"{plan.description}: φ = {scenario.soil.friction_angle_deg:g}° "
        f"({scenario.soil.yield_criterion}), leg {scenario.leg.shape}. "
        "Forces are means over 1° of leg angle within |θ| < 85°. NRMSD: root mean square "
        "deviation from the reference, in percent of the reference's peak-to-peak; the reference "
        "is the row of its group without one, the finest value where there is a finest, the base "
        "elsewhere. Changes of the peaks are from the reference too, for F_z / F_x. "
        + degrees.said(PAPER_LIBRARY)
    )


def _named(variant: Variant) -> str:
    setting = setting_of(variant.key)
    return f"{setting.name} {setting.write(variant.scenario)}"


def _notes(
    groups: Sequence[Group], conclusions: Mapping[str, Mapping[str, Any]], scatter: Scatter
) -> list[str]:
    """What counts as a change, what causes one, and what to know beside."""
    tolerance = tolerance_of(scatter)
    apart = (
        f"{scatter.runs} runs that differ in their seed alone are {_both(scatter.nrmsd)} "
        f"(F_z / F_x) apart in NRMSD and {_both(scatter.peak)} in their peaks"
        if scatter.runs > 1
        else "The scatter between seeds is not known yet"
    )
    bound = f"{_both(tolerance.nrmsd)} in NRMSD or {_both(tolerance.peak)} in a peak"
    moving = [[case.label for case in g.cases if not tolerance.allows(g, case)] for g in groups]
    told = [
        f"{g.setting.name} {', '.join(labels)}"
        for g, labels in zip(groups, moving, strict=True)
        if labels
    ]
    notes = [
        f"{apart}. A case moves the forces if it is more than {bound} from the reference.",
        f"The forces are moved by: {'; '.join(told) or 'nothing that was tried'}.",
    ]
    ends = [
        f"{g.setting.name}, {force} {value:.2f} N (the base: {past:+.0f} %, {turned:+.1f}°)"
        for g in groups
        for force, value in conclusions[g.key].get("limit_N", {}).items()
        if value is not None
        for past in [100.0 * (g.base.peak(force) - value) / value]
        for turned in [degrees.in_degrees(past, force, library=PAPER_LIBRARY)]
    ]
    if ends:
        notes.append(f"Straight lines through the peaks end, at size zero, at: {'; '.join(ends)}.")
    remarks = [(g.setting.name, g.setting.remark) for g in groups if g.setting.remark]
    notes += [f"{capitalised(name)}: {remark}." for name, remark in remarks]
    notes += [
        f"{capitalised(g.setting.name)}: the reference is to be {g.awaited}, not simulated yet."
        for g in groups
        if g.awaited is not None
    ]
    return notes


def _both(percent: Percent, sign: str = "") -> str:
    """Two percentages, such as ``1.2 / 0.9 %``, in the order of :data:`FORCES`."""
    return " / ".join(f"{percent[force]:{sign}.1f}" for force in FORCES) + " %"


def _from_reference(group: Group, case: Simulated) -> Percent:
    return {force: change(group.reference, case, force) for force in FORCES}


def _row(group: Group, case: Simulated, tolerance: Tolerance) -> tuple[str, ...]:
    name = group.setting.name if case is group.cases[0] else ""
    value = f"{case.label} (base)" if case is group.base else case.label
    peaks = [
        f"{case.peak(force):.2f} N at {getattr(case.peaks, f'theta_{force}_deg'):.0f}°"
        for force in FORCES
    ]
    if case is group.reference:
        return (name, value, *peaks, *[""] * (len(HEADER) - 4))
    moves, deviation = _from_reference(group, case), group.deviation(case)
    return (
        *(name, value, *peaks, _both(moves, "+"), degrees.worth(moves, library=PAPER_LIBRARY)),
        *(f"{deviation[force]:.1f} %" for force in FORCES),
        "no" if tolerance.allows(group, case) else "yes",
    )


def _group_data(
    group: Group, tolerance: Tolerance, conclusion: Mapping[str, Any]
) -> dict[str, Any]:
    return {
        "setting": group.setting.name,
        "reference": group.reference.label,
        "cases": [
            {
                "value": case.label,
                "scenario_hash": case.scenario.hash,
                "peaks": _peaks(case.peaks),
                "peak_change_percent": {f: change(group.base, case, f) for f in FORCES},
                "change_from_reference_percent": _from_reference(group, case),
                "nrmsd_percent": None if case is group.reference else group.deviation(case),
                "moves": not tolerance.allows(group, case),
            }
            for case in group.cases
        ],
        "conclusion": dict(conclusion),
    }


def _peaks(peaks: Peaks) -> dict[str, float]:
    return {
        "Fz_N": peaks.Fz,
        "theta_Fz_deg": peaks.theta_Fz_deg,
        "Fx_N": peaks.Fx,
        "theta_Fx_deg": peaks.theta_Fx_deg,
    }


def _figures(groups: list[Group], tolerance: Tolerance) -> dict[str, Any]:
    """All peaks in one picture, and the histories of each group in one each."""
    found = {
        NAME: sensitivity_figure(
            {
                group.setting.name: [
                    (case.label, {f: change(group.base, case, f) for f in FORCES})
                    for case in group.cases
                ]
                for group in groups
            },
            tolerance.peak,
        )
    }
    for group in groups:
        looks = itertools.cycle(LOOKS)
        curves = [
            Curve(case.label, case.history, *(BASE_LOOK if case is group.base else next(looks)))
            for case in group.cases
        ]
        title = f"{group.setting.name} (black: the base)"
        found[f"{NAME}-{group.key.rpartition('.')[2]}"] = comparison_figure(title, curves)
    return found
