"""Sensitivity: what moves the simulated forces, one setting of the simulation changed at a time.

The cases are those of the shipped plan ``sensitivity``: preset ``paper-1`` four times sped up, and
each value of each key in the plan by itself, brought together key by key. The deviation between two
histories is the NRMSD of the benchmark: on 1° means over |θ| < 85°, in percent of the reference's
peak-to-peak. Peaks are taken on 1° means as well. What counts as a change is measured by runs that
differ in the places of their particles alone.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np

from terraphi.experiment.history import ForceHistory, Peaks
from terraphi.experiment.scenario import Scenario
from terraphi.library.plan import BASE, PRESET, Plan, Variant, label, value_of
from terraphi.view.plots import BLUE, GREEN, ORANGE, PURPLE, Curve, comparison_figure
from terraphi.view.table import Table
from terraphi_studies import PAPER_LIBRARY, Study, capitalised, degrees, page
from terraphi_studies.measures import FORCES, both, nrmsd_percent, peaks_and_angles, rms
from terraphi_studies.pictures import sensitivity_figure
from terraphi_studies.planned import Simulations, minutes_of, need_base, not_yet

NAME = "sensitivity"
TITLE = "Sensitivity of the simulated forces to the settings of the simulation"
PICTURE = "change of the peak forces with each setting"
BASE_LOOK = ("black", "-")
LOOKS = ((BLUE, "--"), (ORANGE, "-."), (GREEN, ":"), (PURPLE, "-"))
"""Colour and line of the other curves of a group, which differ in grey as well."""
SEED = "numerics.seed"
LEAST_TOLERANCE = 2.0
"""Deviations and changes of peaks below this are of no interest [%]."""
SCATTERS = 2.0
"""Deviations below this many times the scatter between seeds cannot be told from it [-]."""

Percent = dict[str, float]
"""A percentage for each force, ``Fz`` and ``Fx``."""


class Setting(NamedTuple):
    """How a key of a scenario is named and judged in this study."""

    name: str
    """For people."""
    write: Callable[[Scenario], str]
    """Its value in a scenario, for people."""
    reference: Literal["base", "least", "most"] = "base"
    """Which of its values the others are compared with."""
    remark: str = ""
    """What to know of it."""
    size: Callable[[Scenario], float] | None = None
    """A step whose limit is zero, where there is one."""


def _damping(scenario: Scenario) -> str:
    numerics = scenario.numerics
    if numerics.damping_rate == 0.0:
        return "none"
    return f"{math.exp(-numerics.damping_rate * numerics.time_step):.4g} a step"


def _remap(scenario: Scenario) -> str:
    interval = scenario.numerics.remap_interval
    return f"each {1e3 * interval:g} ms" if interval else "each step"


SETTINGS = {
    "numerics.speed_up": Setting("speed-up k", lambda s: f"{s.numerics.speed_up:g}", "least"),
    "numerics.cells": Setting(
        "cell size Δx",
        lambda s: f"{1e3 * s.numerics.cell_size:.2f} mm",
        "most",
        "The contact band is counted in cells: a finer grid also thins what the soil meets as leg",
        lambda s: s.numerics.cell_size,
    ),
    "numerics.time_step": Setting(
        "time step Δt",
        lambda s: f"{1e6 * s.numerics.time_step:g} µs",
        "least",
        size=lambda s: s.numerics.time_step,
    ),
    "numerics.damping_rate": Setting(
        "damping",
        _damping,
        remark="The factor is that at k = 1; at any other k the drag on the soil is the same",
    ),
    "numerics.contact_band_cells": Setting(
        "contact band", lambda s: f"{s.numerics.contact_band_cells:g} Δx"
    ),
    "soil.youngs_modulus": Setting(
        "Young's modulus E", lambda s: f"{1e-6 * s.soil.youngs_modulus:g} MPa"
    ),
    "numerics.particles_per_cell_side": Setting(
        "particles per cell", lambda s: f"{s.numerics.particles_per_cell_side**2:d}", "most"
    ),
    "numerics.transfer": Setting("transfer", lambda s: s.numerics.transfer.upper()),
    "numerics.remap_interval": Setting("transfer takes place", _remap),
    SEED: Setting("seed", lambda s: f"{s.numerics.seed:d}"),
    PRESET: Setting("preset", lambda s: s.name),
}
"""Keys that the study has names for."""


def setting_of(key: str) -> Setting:
    """The setting of a key, named by the key itself where the study has no name for it."""
    name = key.rpartition(".")[2].replace("_", " ")
    return SETTINGS.get(key) or Setting(name, lambda scenario: str(value_of(scenario, key)))


@dataclass(frozen=True)
class Simulated:
    """One finished case, with its value of the setting for people, and its largest forces."""

    scenario: Scenario
    history: ForceHistory
    label: str
    peaks: Peaks

    def peak(self, force: str) -> float:
        """Largest ``Fz`` or ``Fx`` [N]."""
        return float(getattr(self.peaks, force))

    def change_from(self, other: Simulated, whole: Simulated | None = None) -> Percent:
        """Change of the peaks from another case's [% of that case's, or of a third's]."""
        return {
            f: 100.0 * (self.peak(f) - other.peak(f)) / (whole or other).peak(f) for f in FORCES
        }


@dataclass(frozen=True)
class Group:
    """The finished cases that differ in one setting, the base among them.

    Attributes
    ----------
    key, setting
        Which.
    cases
        In order of the setting's value where it is a number, else the base first.
    base
        The base among them.
    reference
        The case that the others are compared with, among those finished.
    """

    key: str
    setting: Setting
    cases: tuple[Simulated, ...]
    base: Simulated
    reference: Simulated

    def deviation(self, case: Simulated) -> Percent:
        """NRMSD of a case from the reference [%]."""
        return nrmsd_percent(self.reference.history, case.history)

    def limits(self, tolerance: Percent) -> dict[str, float | None]:
        """Where straight lines through the peaks meet a step size of zero [N], by force.

        Empty if the setting is no such step; ``None`` unless there are at least three peaks, all
        within the tolerance [%] of their line.
        """
        if self.setting.size is None:
            return {}
        sizes = np.array([self.setting.size(case.scenario) for case in self.cases])
        found: dict[str, float | None] = dict.fromkeys(FORCES)
        for force in FORCES if len(sizes) >= 3 else ():
            peaks = np.array([case.peak(force) for case in self.cases])
            slope, limit = np.polyfit(sizes / sizes.max(), peaks, 1)
            off = np.abs(peaks - limit - slope * sizes / sizes.max()) / peaks
            if 100.0 * off.max() <= tolerance[force] and limit > 0.0:
                found[force] = float(limit)
        return found


def groups_of(plan: Plan, finished: Mapping[str, ForceHistory]) -> list[Group]:
    """Groups of a plan that have at least one finished case beside the base, in its order.

    Parameters
    ----------
    plan
        A plan that changes one key at a time.
    finished
        Histories by the hash of their scenario, the base's among them.
    """
    found = []
    for key, members in itertools.groupby(plan.variants()[1:], key=lambda variant: variant.key):
        planned = _in_order([Variant(BASE, None, plan.scenario), *members], key)
        setting = setting_of(key)
        done = {
            hashed: Simulated(v.scenario, history, setting.write(v.scenario), history.peaks())
            for v in planned
            if (history := finished.get(hashed := v.scenario.hash)) is not None
        }
        if len(done) < 2:
            continue
        base, cases = done[plan.scenario.hash], tuple(done.values())
        reference = {"base": base, "least": cases[0], "most": cases[-1]}[setting.reference]
        found.append(Group(key, setting, cases, base, reference))
    return found


def _in_order(variants: list[Variant], key: str) -> list[Variant]:
    """Variants in order of their value where all are numbers."""
    if key == PRESET:
        return variants
    values = [value_of(variant.scenario, key) for variant in variants]
    if not all(isinstance(value, int | float) for value in values):
        return variants
    return [variants[i] for i in np.argsort(np.array(values, dtype=np.float64), kind="stable")]


class Scatter(NamedTuple):
    """How far apart two runs are that differ in the places of their particles alone."""

    runs: int
    """How many seeds there are; with fewer than two the scatter is unknown, and 0 below."""
    nrmsd: Percent
    """Root mean square, over all pairs of runs, of their NRMSD [%]."""
    peak: Percent
    """Root mean square, over all pairs, of the difference of their peaks [% of the base's]."""


def scatter_of(groups: list[Group]) -> Scatter:
    """Scatter between seeds."""
    group = next((group for group in groups if group.key == SEED), None)
    if group is None:
        return Scatter(1, dict.fromkeys(FORCES, 0.0), dict.fromkeys(FORCES, 0.0))
    pairs = list(itertools.combinations(group.cases, 2))
    apart = [nrmsd_percent(one.history, other.history) for one, other in pairs]
    peaks = [other.change_from(one, group.base) for one, other in pairs]
    return Scatter(
        len(group.cases),
        *({force: rms([each[force] for each in found]) for force in FORCES}
          for found in (apart, peaks)),
    )  # fmt: skip


class Tolerance(NamedTuple):
    """Largest deviations that count as none [%]."""

    nrmsd: Percent
    peak: Percent

    def allows(self, group: Group, case: Simulated) -> bool:
        """Whether a case is no further from its group's reference than that, in both forces."""
        moves, apart = case.change_from(group.reference), group.deviation(case)
        return all(apart[f] <= self.nrmsd[f] and abs(moves[f]) <= self.peak[f] for f in FORCES)


def tolerance_of(scatter: Scatter) -> Tolerance:
    """Tolerance that a scatter allows: twice as much, and never less than 2 %."""
    return Tolerance(
        *(
            {force: max(LEAST_TOLERANCE, SCATTERS * percent[force]) for force in FORCES}
            for percent in (scatter.nrmsd, scatter.peak)
        )
    )


# -- the study -------------------------------------------------------------------------------------


def run(*, cases: Simulations) -> Study:
    """Measure the finished cases of the shipped plan.

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
        (``setting``, ``reference``, ``cases``, and of a step size ``limit_N``, see
        :meth:`Group.limits`); ``missing`` (``case``, ``core_minutes``). A figure of all peaks, one
        of the histories in each group, and a page with the first of them.

    Raises
    ------
    InputError
        If the base is not among the finished.
    """
    need_base(plan, finished)
    missing = [v for v in plan.variants() if v.scenario.hash not in finished]
    groups = groups_of(plan, finished)
    scatter = scatter_of(groups)
    tolerance = tolerance_of(scatter)
    # The scatter first: all that follows is measured by it.
    groups.sort(key=lambda group: group.key != SEED)
    waiting = {
        f"{(setting := setting_of(v.key)).name} {setting.write(v.scenario)}": v.scenario
        for v in missing
    }
    notes = [*_notes(groups, scatter), *not_yet(NAME, waiting)]
    rows = [_row(g, case, not tolerance.allows(g, case)) for g in groups for case in g.cases]
    table = Table(TITLE, HEADER, rows)
    return Study(
        table=table,
        data={
            "plan": plan.name,
            "base": {
                "scenario_hash": plan.scenario.hash,
                "peaks": peaks_and_angles(finished[plan.scenario.hash].peaks()),
            },
            "scatter_percent": {
                "seeds": scatter.runs,
                "nrmsd": scatter.nrmsd,
                "peak": scatter.peak,
            },
            "tolerance_percent": tolerance._asdict(),
            "groups": {group.key: _group_data(group, tolerance) for group in groups},
            "missing": [
                {"case": label(v), "core_minutes": minutes_of(v.scenario)} for v in missing
            ],
        },
        figures=_figures(groups, tolerance),
        documents=page(NAME, table, _method(plan), notes, PICTURE),
        notes=notes,
    )


def _group_data(group: Group, tolerance: Tolerance) -> dict[str, Any]:
    limits = group.limits(tolerance.peak)
    return {
        "setting": group.setting.name,
        "reference": group.reference.label,
        "cases": [
            {
                "value": case.label,
                "scenario_hash": case.scenario.hash,
                "peaks": peaks_and_angles(case.peaks),
                "peak_change_percent": case.change_from(group.base),
                "change_from_reference_percent": case.change_from(group.reference),
                "nrmsd_percent": None if case is group.reference else group.deviation(case),
                "moves": not tolerance.allows(group, case),
            }
            for case in group.cases
        ],
        **({"limit_N": limits} if limits else {}),
    }


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


def _notes(groups: Sequence[Group], scatter: Scatter) -> list[str]:
    """What counts as a change, what causes one, and what to know beside."""
    tolerance = tolerance_of(scatter)
    apart = (
        f"{scatter.runs} runs that differ in their seed alone are {both(scatter.nrmsd, ' %')} "
        f"(F_z / F_x) apart in NRMSD and {both(scatter.peak, ' %')} in their peaks"
        if scatter.runs > 1
        else "The scatter between seeds is not known yet"
    )
    bound = f"{both(tolerance.nrmsd, ' %')} in NRMSD or {both(tolerance.peak, ' %')} in a peak"
    moving = {
        g.setting.name: [case.label for case in g.cases if not tolerance.allows(g, case)]
        for g in groups
    }
    told = [f"{name} {', '.join(labels)}" for name, labels in moving.items() if labels]
    notes = [
        f"{apart}. A case moves the forces if it is more than {bound} from the reference.",
        f"The forces are moved by: {'; '.join(told) or 'nothing that was tried'}.",
    ]
    ends = [
        f"{g.setting.name}, {force} {value:.2f} N (the base: {past:+.0f} %, {turned:+.1f}°)"
        for g in groups
        for force, value in g.limits(tolerance.peak).items()
        if value is not None
        for past in [100.0 * (g.base.peak(force) - value) / value]
        for turned in [degrees.in_degrees(past, force, library=PAPER_LIBRARY)]
    ]
    if ends:
        notes.append(f"Straight lines through the peaks end, at size zero, at: {'; '.join(ends)}.")
    remarks = [(capitalised(g.setting.name), g.setting.remark) for g in groups]
    return notes + [f"{name}: {remark}." for name, remark in remarks if remark]


HEADER = (
    *("setting", "value", "peak Fz", "peak Fx", "change of peaks", "as degrees of φ"),
    *("NRMSD Fz", "NRMSD Fx", "moves"),
)


def _row(group: Group, case: Simulated, moves: bool) -> tuple[str, ...]:
    """Cells of a case; those that compare are empty at the reference."""
    first = (
        group.setting.name if case is group.cases[0] else "",
        case.label + (" (base)" if case is group.base else ""),
        *(f"{case.peak(f):.2f} N at {getattr(case.peaks, f'theta_{f}_deg'):.0f}°" for f in FORCES),
    )
    if case is group.reference:
        return (*first, *[""] * (len(HEADER) - len(first)))
    change, deviation = case.change_from(group.reference), group.deviation(case)
    return (
        *first,
        both(change, " %", "+.1f"),
        degrees.worth(change, library=PAPER_LIBRARY),
        *(f"{deviation[force]:.1f} %" for force in FORCES),
        "yes" if moves else "no",
    )


def _figures(groups: list[Group], tolerance: Tolerance) -> dict[str, Any]:
    """All peaks in one picture, and the histories of each group in one each."""
    changes = {
        group.setting.name: [(case.label, case.change_from(group.base)) for case in group.cases]
        for group in groups
    }
    found = {NAME: sensitivity_figure(changes, tolerance.peak)}
    for group in groups:
        looks = itertools.cycle(LOOKS)
        curves = [
            Curve(case.label, case.history, *(BASE_LOOK if case is group.base else next(looks)))
            for case in group.cases
        ]
        title = f"{group.setting.name} (black: the base)"
        found[f"{NAME}-{group.key.rpartition('.')[2]}"] = comparison_figure(title, curves)
    return found
