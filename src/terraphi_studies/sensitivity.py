"""Sensitivity: what moves the simulated forces, one setting of the simulation changed at a time.

The cases are those of the shipped plan ``sensitivity``: preset ``paper-1`` four times sped up, and
each value of each key in the plan by itself. Their simulations are shipped, a file each, named by
the hash of the scenario. Reading them takes seconds; what is missing is simulated on request and
kept in a folder. Grouping and measures are in :mod:`~terraphi_studies.sensitivity_cases`, the rules
of the conclusions in :mod:`~terraphi_studies.sensitivity_rules`.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from terraphi.experiment.documents import shipped_folder
from terraphi.experiment.errors import InputError
from terraphi.experiment.files import held
from terraphi.experiment.history import ForceHistory, Peaks
from terraphi.experiment.scenario import Scenario
from terraphi.library.build import finished_cases, simulate_cases
from terraphi.library.cluster import pool
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
from terraphi_studies import PAPER_LIBRARY, Study, degrees, page
from terraphi_studies.sensitivity_cases import (
    FORCES,
    Group,
    Simulated,
    change,
    groups_of,
    scatter_of,
    setting_of,
)
from terraphi_studies.sensitivity_rules import (
    Conclusion,
    Tolerance,
    conclude,
    conclude_scatter,
    tolerance_of,
)

NAME = "sensitivity"
TITLE = "Sensitivity of the simulated forces to the settings of the simulation"
HEADER = ("setting", "value", "peak Fz", "peak Fx", "NRMSD Fz", "NRMSD Fx")
SPEED = 6.5e7
"""Particle-steps a second on one core [1/s], where no finished case says how many."""
BASE_LOOK = ("black", "-")
LOOKS = ((BLUE, "--"), (ORANGE, "-."), (GREEN, ":"), (PURPLE, "-"))
"""Colour and line of the other curves of a group, which differ in grey as well."""


def run(
    *,
    build: Path | None = None,
    workers: int | None = None,
    cluster: str | None = None,
    progress: Callable[[float, float], None] | None = None,
) -> Study:
    """Measure the finished cases of the shipped plan and draw the conclusions.

    Parameters
    ----------
    build
        Folder of further finished cases. What is neither shipped nor there is simulated first, and
        kept there, a file each; without a folder nothing is simulated.
    workers
        Processes to simulate on; 1 if not given.
    cluster
        Address of a Dask cluster to simulate on instead.
    progress
        Called with the number of finished cases, counting parts, and of all.

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
    plan, finished = shipped_plan(), finished_for(NAME, build)
    if (workers or cluster) and build is None:
        raise InputError(
            f"study '{NAME}' needs workers for what it simulates: name a --build FOLDER"
        )
    if build is not None and missing_from(plan, finished):
        finished = simulate_missing(plan, build, workers, cluster, progress)
    return study_of(plan, finished)


def simulate_missing(
    plan: Plan,
    folder: Path,
    workers: int | None,
    cluster: str | None,
    progress: Callable[[float, float], None] | None,
    *,
    keep_failures: bool = False,
    known_failures: Mapping[str, str] = MappingProxyType({}),
) -> dict[str, ForceHistory]:
    """Simulate what is missing of a shipped plan; all finished cases, as :func:`finished_for`.

    Workers are processes here, 1 if not given, or those of the cluster at an address. Raises
    InputError if they cannot be had or the folder not be written, and if a simulation failed or was
    interrupted: the others are kept. Where failures are kept, one that fails is no error.
    """
    try:
        with held(folder), pool(workers, cluster, default=1) as running:
            finished, failures = simulate_cases(
                plan,
                folder,
                known=finished_for(plan.name, None),
                executor=running.executor,
                progress=lambda done, total: progress and progress(running.counted(done), total),
                keep_failures=keep_failures,
                known_failures=known_failures,
            )
    except KeyboardInterrupt:
        raise InputError(
            f"{folder}: interrupted; what was finished is kept there, and the same command goes on "
            "from there"
        ) from None
    for variant in plan.variants():
        if variant.scenario.hash in failures and not keep_failures:
            reason = failures[variant.scenario.hash]
            raise InputError(f"plan '{plan.name}': {label(variant)} failed: {reason}")
    return finished


def shipped_plan() -> Plan:
    """The plan that the package ships."""
    return Plan.load(NAME)


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
        (``setting``, ``reference``, ``cases``, ``conclusion``); ``missing`` (``case``,
        ``core_minutes``). A figure of all peaks, one of the histories in each group, and a page
        with the first of them.

    Raises
    ------
    InputError
        If the base is not among the finished.
    """
    missing = missing_from(plan, finished)
    if plan.scenario.hash not in finished:
        raise InputError(
            f"plan '{plan.name}': its base, with which all is compared, is not simulated yet; "
            "--build FOLDER simulates what is missing"
        )
    groups = groups_of(plan, finished)
    scatter = scatter_of(groups)
    tolerance = tolerance_of(scatter)
    conclusions = {group.key: conclude(group, scatter) for group in groups}
    base = finished[plan.scenario.hash].peaks()
    # The scatter first: all that follows is measured by it.
    groups.sort(key=lambda group: group.setting.rule != "scatter")
    notes = [
        conclude_scatter(scatter).sentence,
        *(conclusions[group.key].sentence for group in groups if group.setting.rule != "scatter"),
    ]
    if missing:
        notes.append(_not_yet(plan, missing))
    rows = [_row(group, case) for group in groups for case in group.cases]
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
            "groups": {g.key: _group_data(g, conclusions[g.key]) for g in groups},
            "missing": [
                {"case": label(variant), "core_minutes": minutes} for variant, minutes in missing
            ],
        },
        figures=_figures(groups, tolerance),
        documents={f"{NAME}.md": written},
        notes=notes,
    )


def missing_from(plan: Plan, finished: Mapping[str, ForceHistory]) -> list[tuple[Variant, float]]:
    """Variants of a plan that are not finished, and the time that each would take [min].

    The time is that of one core, at the highest speed of the finished cases: that of the one least
    disturbed by what else the machine did.
    """
    speeds = [
        history.provenance["particles"]
        * history.provenance["steps"]
        / history.provenance["seconds"]["all"]
        for history in finished.values()
        if {"particles", "steps", "seconds"} <= history.provenance.keys()
    ]
    speed = max(speeds, default=SPEED)
    return [
        (variant, _particle_steps(variant.scenario) / speed / 60.0)
        for variant in plan.variants()
        if variant.scenario.hash not in finished
    ]


def _total(missing: list[tuple[Variant, float]]) -> float:
    return sum(minutes for _, minutes in missing)


def _particle_steps(scenario: Scenario) -> float:
    bed, numerics = scenario.bed, scenario.numerics
    cells = bed.width * bed.height / numerics.cell_size**2
    steps = scenario.motion.duration / numerics.speed_up / numerics.time_step
    return cells * numerics.particles_per_cell_side**2 * steps


def finished_for(name: str, cases: Path | None) -> dict[str, ForceHistory]:
    """Usable histories, shipped for a plan and in a folder, by the hash of their scenario."""
    folders = [shipped_folder("cases", name), *([cases] if cases else [])]
    return {key: history for f in folders for key, history in finished_cases(f).items()}


# -- what people see -------------------------------------------------------------------------------


def _method(plan: Plan) -> str:
    scenario = plan.scenario
    return (
        f"{plan.description}: φ = {scenario.soil.friction_angle_deg:g}° "
        f"({scenario.soil.yield_criterion}), leg {scenario.leg.shape}. "
        "Forces are means over 1° of leg angle within |θ| < 85°. NRMSD: root mean square "
        "deviation from the reference, in percent of the reference's peak-to-peak; the reference "
        "is the row of its group without one, the finest value where there is a finest, the base "
        "elsewhere. Sentences follow from the table by the rules written in "
        "`terraphi_studies.sensitivity_rules`. Percentages are for F_z / F_x. "
        + degrees.said(PAPER_LIBRARY)
    )


def _not_yet(plan: Plan, missing: list[tuple[Variant, float]]) -> str:
    cases = ", ".join(
        f"{setting_of(variant.key).name} {setting_of(variant.key).write(variant.scenario)} "
        f"({minutes:.0f} min)"
        for variant, minutes in missing
    )
    return (
        f"Not simulated yet: {cases}; `terraphi study {plan.name} --build FOLDER` does it in about "
        f"{_total(missing):.0f} minutes of one core."
    )


def _row(group: Group, case: Simulated) -> tuple[str, ...]:
    name = group.setting.name if case is group.cases[0] else ""
    value = f"{case.label} (base)" if case is group.base else case.label
    peaks = [
        f"{case.peak(force):.2f} N at {getattr(case.peaks, f'theta_{force}_deg'):.0f}°"
        for force in FORCES
    ]
    if case is group.reference:
        return (name, value, *peaks, "", "")
    deviation = group.deviation(case)
    return (name, value, *peaks, *(f"{deviation[force]:.1f} %" for force in FORCES))


def _group_data(group: Group, conclusion: Conclusion) -> dict[str, Any]:
    return {
        "setting": group.setting.name,
        "reference": group.reference.label,
        "cases": [
            {
                "value": case.label,
                "scenario_hash": case.scenario.hash,
                "peaks": _peaks(case.peaks),
                "peak_change_percent": {f: change(group.base, case, f) for f in FORCES},
                "nrmsd_percent": None if case is group.reference else group.deviation(case),
            }
            for case in group.cases
        ],
        "conclusion": {"sentence": conclusion.sentence, **conclusion.numbers},
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
