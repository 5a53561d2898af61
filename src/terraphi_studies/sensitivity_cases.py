"""Simulations of a plan that changes one key at a time, brought together key by key and measured.

The deviation between two histories is the NRMSD of the benchmark study: on 1° means over
|θ| < 85°, in percent of the reference's peak-to-peak. Peaks are taken on 1° means as well.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from terraphi.experiment.history import ForceHistory, Peaks
from terraphi.experiment.scenario import Scenario
from terraphi.library.plan import BASE, PRESET, Plan, Variant, value_of
from terraphi_studies.benchmark import nrmsd_percent

FORCES = ("Fz", "Fx")
SEED = "numerics.seed"

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
    """How a conclusion is drawn from it; see :mod:`terraphi_studies.sensitivity_rules`."""
    remark: str = ""
    """What to know of it; ends the conclusion."""
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
