"""Simulations of a plan that changes one key at a time, brought together key by key and measured.

The deviation between two histories is the NRMSD of the benchmark study: on 1° means over
|θ| < 85°, in percent of the reference's peak-to-peak. Peaks are taken on 1° means as well.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np

from terraphi.experiment.history import ForceHistory, Peaks
from terraphi.experiment.scenario import Scenario
from terraphi.library.plan import BASE, PRESET, Plan, Variant, value_of
from terraphi_studies import PAPER_LIBRARY, degrees
from terraphi_studies.benchmark import nrmsd_percent

FORCES = ("Fz", "Fx")
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
    reference: Literal["base", "least", "most"]
    """Which of its values the others are compared with."""
    rule: Literal["limit", "convergence", "share", "scatter", "effect"]
    """What follows from it; see :func:`conclude`."""
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
    "numerics.speed_up": Setting(
        "speed-up k", lambda s: f"{s.numerics.speed_up:g}", "least", "limit"
    ),
    "numerics.cells": Setting(
        "cell size Δx",
        lambda s: f"{1e3 * s.numerics.cell_size:.2f} mm",
        "most",
        "convergence",
        "The contact band is counted in cells: a finer grid also thins what the soil meets as leg",
        lambda s: s.numerics.cell_size,
    ),
    "numerics.time_step": Setting(
        "time step Δt",
        lambda s: f"{1e6 * s.numerics.time_step:g} µs",
        "least",
        "convergence",
        size=lambda s: s.numerics.time_step,
    ),
    "numerics.damping_rate": Setting(
        "damping",
        _damping,
        "base",
        "share",
        "The factor is that at k = 1; at any other k the drag on the soil is the same",
    ),
    "numerics.contact_band_cells": Setting(
        "contact band", lambda s: f"{s.numerics.contact_band_cells:g} Δx", "base", "effect"
    ),
    "soil.youngs_modulus": Setting(
        "Young's modulus E", lambda s: f"{1e-6 * s.soil.youngs_modulus:g} MPa", "base", "effect"
    ),
    "numerics.particles_per_cell_side": Setting(
        "particles per cell",
        lambda s: f"{s.numerics.particles_per_cell_side**2:d}",
        "most",
        "convergence",
    ),
    "numerics.transfer": Setting(
        "transfer", lambda s: s.numerics.transfer.upper(), "base", "effect"
    ),
    "numerics.remap_interval": Setting("transfer takes place", _remap, "base", "effect"),
    SEED: Setting("seed", lambda s: f"{s.numerics.seed:d}", "base", "scatter"),
    PRESET: Setting("preset", lambda s: s.name, "base", "effect"),
}
"""Keys that the study knows; any other is judged by its effect."""


@dataclass(frozen=True)
class Simulated:
    """One finished case.

    Attributes
    ----------
    scenario, history
        What was simulated and what came of it.
    label
        Its value of the setting, for people.
    peaks
        Largest forces.
    """

    scenario: Scenario
    history: ForceHistory
    label: str
    peaks: Peaks

    def peak(self, force: str) -> float:
        """Largest ``Fz`` or ``Fx`` [N]."""
        return float(getattr(self.peaks, force))


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
    awaited
        What the reference would be if everything were finished, where it is another one.
    """

    key: str
    setting: Setting
    cases: tuple[Simulated, ...]
    base: Simulated
    reference: Simulated
    awaited: str | None

    def deviation(self, case: Simulated) -> Percent:
        """NRMSD of a case from the reference [%]."""
        found = nrmsd_percent(self.reference.history, case.history)
        return {force: found[force] for force in FORCES}


def setting_of(key: str) -> Setting:
    """The setting of a key; one that the study has no name for is judged by its effect."""
    name = key.rpartition(".")[2].replace("_", " ")
    plain = Setting(name, lambda scenario: str(value_of(scenario, key)), "base", "effect")
    return SETTINGS.get(key, plain)


def groups_of(plan: Plan, finished: Mapping[str, ForceHistory]) -> list[Group]:
    """Groups of a plan that have at least one finished case beside the base.

    Parameters
    ----------
    plan
        A plan that changes one key at a time.
    finished
        Histories by the hash of their scenario, the base's among them.

    Returns
    -------
    list of Group
        In the plan's order.
    """
    found = []
    for key, members in itertools.groupby(plan.variants()[1:], key=lambda variant: variant.key):
        planned = _in_order([Variant(BASE, None, plan.scenario), *members], key)
        setting = setting_of(key)
        done = {
            variant.scenario.hash: _simulated(variant, setting, finished[variant.scenario.hash])
            for variant in planned
            if variant.scenario.hash in finished
        }
        if len(done) < 2:
            continue
        base = done[plan.scenario.hash]
        cases = tuple(done.values())
        places = {"least": 0, "most": -1}
        reference = base if setting.reference == "base" else cases[places[setting.reference]]
        wanted = plan.scenario
        if setting.reference != "base":
            wanted = planned[places[setting.reference]].scenario
        awaited = None if wanted.hash in done else setting.write(wanted)
        found.append(Group(key, setting, cases, base, reference, awaited))
    return found


def _in_order(variants: list[Variant], key: str) -> list[Variant]:
    """Variants in order of their value where all are numbers."""
    if key == PRESET:
        return variants
    values = [value_of(variant.scenario, key) for variant in variants]
    if not all(isinstance(value, int | float) for value in values):
        return variants
    return [variants[i] for i in np.argsort(np.array(values, dtype=np.float64), kind="stable")]


def _simulated(variant: Variant, setting: Setting, history: ForceHistory) -> Simulated:
    return Simulated(variant.scenario, history, setting.write(variant.scenario), history.peaks())


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
    found = [group for group in groups if group.key == SEED]
    if not found:
        return Scatter(1, dict.fromkeys(FORCES, 0.0), dict.fromkeys(FORCES, 0.0))
    pairs = list(itertools.combinations(found[0].cases, 2))
    apart = [nrmsd_percent(one.history, other.history) for one, other in pairs]
    base = found[0].base

    def rms(values: list[float]) -> float:
        return float(np.sqrt(np.mean(np.square(values))))

    return Scatter(
        len(found[0].cases),
        {force: rms([each[force] for each in apart]) for force in FORCES},
        {
            force: rms([change(one, other, force, whole=base) for one, other in pairs])
            for force in FORCES
        },
    )


def change(
    before: Simulated, after: Simulated, force: str, *, whole: Simulated | None = None
) -> float:
    """Change of a peak from one case to another [% of the first's, or of another's]."""
    return 100.0 * (after.peak(force) - before.peak(force)) / (whole or before).peak(force)


# -- what follows, in numbers ----------------------------------------------------------------------


class Tolerance(NamedTuple):
    """Largest deviations that count as none."""

    nrmsd: Percent
    """[%]."""
    peak: Percent
    """[%]."""

    def allows(self, group: Group, case: Simulated) -> bool:
        """Whether a case is no further from its group's reference than that, in both forces."""
        moves = {force: change(group.reference, case, force) for force in FORCES}
        return _within(group.deviation(case), self.nrmsd) and _within(moves, self.peak)


def tolerance_of(scatter: Scatter) -> Tolerance:
    """Tolerance that a scatter allows: twice as much, and never less than 2 %."""
    return Tolerance(*(_at_least(each) for each in (scatter.nrmsd, scatter.peak)))


def _at_least(scatter: Percent) -> Percent:
    return {force: max(LEAST_TOLERANCE, SCATTERS * scatter[force]) for force in FORCES}


def _within(percent: Percent, tolerance: Percent) -> bool:
    return all(abs(percent[force]) <= tolerance[force] for force in FORCES)


def conclude(group: Group, scatter: Scatter) -> dict[str, Any]:
    """What follows from a group, JSON-able.

    Parameters
    ----------
    group
        Finished cases, at least one beside the base.
    scatter
        Between seeds.

    Returns
    -------
    dict
        By the kind of setting. ``scatter``: ``runs``. ``limit``: ``safe``, the largest value up to
        which every one is within the tolerance, and ``beyond``, the next. ``convergence``: what
        refining the base does, or what led to it if it is the finest: ``from_to``,
        ``peak_change_percent``, ``peak_change_deg`` (of the friction angle), ``nrmsd_percent``,
        ``peaks_converged`` and ``converged`` (within the tolerance), ``trend`` of the peaks and
        ``limit_N``, the end at size zero of a line through them. ``share``: ``share_percent`` of
        the base's peaks that goes, and ``against`` which value. ``effect``: ``most``, the value
        that moves the peaks furthest from the base's, ``peak_change_percent`` and ``matters``.
        ``awaited``, where the reference is to be another one, not simulated yet.
    """
    if group.setting.rule == "scatter":
        return {"runs": scatter.runs}
    rules: dict[str, Callable[[Group, Tolerance], dict[str, Any]]] = {
        "limit": _limit,
        "convergence": _convergence,
        "share": _share,
        "effect": _effect,
    }
    numbers = rules[group.setting.rule](group, tolerance_of(scatter))
    return numbers if group.awaited is None else {**numbers, "awaited": group.awaited}


def _limit(group: Group, tolerance: Tolerance) -> dict[str, Any]:
    beyond = next((case for case in group.cases if not tolerance.allows(group, case)), None)
    calm = group.cases[: group.cases.index(beyond)] if beyond else group.cases
    return {"safe": calm[-1].label, "beyond": beyond.label if beyond else None}


def _convergence(group: Group, tolerance: Tolerance) -> dict[str, Any]:
    finest_first = group.cases if group.setting.reference == "least" else group.cases[::-1]
    finest, next_finest = finest_first[:2]
    # Where the base is the finest there is, the next coarser value says what refining does.
    coarse = next_finest if finest is group.base else group.base
    apart = group.deviation(coarse)
    moves = {force: change(coarse, finest, force) for force in FORCES}
    peaks = _within(moves, tolerance.peak)
    return {
        "converged": peaks and _within(apart, tolerance.nrmsd),
        "peaks_converged": peaks,
        "from_to": [coarse.label, finest.label],
        "peak_change_percent": moves,
        "peak_change_deg": {
            f: degrees.in_degrees(moves[f], f, library=PAPER_LIBRARY) for f in FORCES
        },
        "nrmsd_percent": apart,
        "trend": {force: _trend(finest_first, force) for force in FORCES},
        "limit_N": {f: _limit_at_zero(group, f, tolerance.peak[f]) for f in FORCES},
    }


def _trend(finest_first: tuple[Simulated, ...], force: str) -> str | None:
    """Whether peaks ``rise`` or ``fall`` with every refinement, of at least two."""
    steps = np.diff([case.peak(force) for case in finest_first[::-1]])
    if len(steps) < 2 or not (np.all(steps > 0.0) or np.all(steps < 0.0)):
        return None
    return "rise" if steps[0] > 0.0 else "fall"


def _limit_at_zero(group: Group, force: str, tolerance: float) -> float | None:
    """Where a straight line through the peaks meets a step size of zero [N].

    ``None`` unless there are at least three peaks, all within the tolerance [%] of their line.
    """
    if group.setting.size is None or len(group.cases) < 3:
        return None
    sizes = np.array([group.setting.size(case.scenario) for case in group.cases])
    peaks = np.array([case.peak(force) for case in group.cases])
    slope, limit = np.polyfit(sizes / sizes.max(), peaks, 1)
    off = np.abs(peaks - limit - slope * sizes / sizes.max()) / peaks
    return float(limit) if 100.0 * off.max() <= tolerance and limit > 0.0 else None


def _share(group: Group, tolerance: Tolerance) -> dict[str, Any]:
    least = group.cases[0]  # in order of the setting's value
    if least is group.base:  # turned up, never down
        return _effect(group, tolerance)
    share = {force: -change(group.base, least, force) for force in FORCES}
    return {"share_percent": share, "against": least.label}


def _effect(group: Group, tolerance: Tolerance) -> dict[str, Any]:
    def size(case: Simulated) -> float:
        return max(abs(change(group.base, case, f)) / tolerance.peak[f] for f in FORCES)

    most = max((case for case in group.cases if case is not group.base), key=size)
    moves = {force: change(group.base, most, force) for force in FORCES}
    return {
        "matters": not _within(moves, tolerance.peak),
        "most": most.label,
        "peak_change_percent": moves,
    }
