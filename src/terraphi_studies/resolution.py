"""Resolution: is the force of preset ``resolved`` the soil's, and what took it there.

Three shipped plans. ``waterfall`` leads from preset ``paper-1`` to ``resolved``, one remedy after
another. ``resolution`` takes ``resolved`` and halves the cells, the time step and the speed-up, and
makes the soil four times as stiff: none of these is a property of the soil, so the peaks should
stay. What a change is worth is seen beside what another seed does. A step that follows another is
measured from that one: so the cells of preset ``resolved-2`` are halved, for each leg; a step to
another leg or friction angle begins anew. ``space`` does the same in three dimensions, with the
numerics of plan ``sand3d``. Peaks are those of 1° means, over the part of the path that holds
both.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from terraphi.experiment.history import ForceHistory
from terraphi.library.plan import BASE, PREVIOUS, Plan
from terraphi.view.table import Table
from terraphi_studies import Study, degrees, page
from terraphi_studies.measures import FORCES, both, peaks_of
from terraphi_studies.pictures import waterfall_figure
from terraphi_studies.planned import Simulations, missing_from, need_base, not_yet, steps_of

PLANS = ("waterfall", "resolution", "space")
NAME = "resolution"
TITLE = "Resolution: from preset paper-1 to preset resolved, and whether that has arrived"
COLUMNS = (
    ("step", "{step}"),
    ("peak Fz", "{peaks_N[Fz]:.2f} N"),
    ("peak Fx", "{peaks_N[Fx]:.2f} N"),
    ("change of Fz", "{said[Fz]}"),
    ("change of Fx", "{said[Fx]}"),
    ("of the means, Fz / Fx", "{said[mean]}"),
)
TOLERANCE_PERCENT = 5.0
"""What halving anything may do to a peak [%]."""
SEED = "seed "
"""Steps that are called so and a number are the base with other particle places; with the name of a
step and a comma before it, that step."""
PICTURE = "peaks along the way, and what is left of them when things are halved"
HALVED = "resolved-2, Δx halved"
"""The step that says what is left of the grid in the forces."""

ByForce = Mapping[str, float]


def run(*, cases: Simulations) -> Study:
    """Measure the finished cases of the plans.

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
        If a base is not simulated yet, the folder cannot be written, or a simulation failed.
    """
    way, halved, space = (Plan.load(name) for name in PLANS)
    return study_of(way, halved, space, cases.histories(way, halved, space))


def study_of(way: Plan, halved: Plan, space: Plan, finished: Mapping[str, ForceHistory]) -> Study:
    """The study on what is finished of the plans.

    Parameters
    ----------
    way
        Plan of steps that lead from one preset to the other.
    halved, space
        Plans of steps that each change the base.
    finished
        Histories by the hash of their scenario.

    Returns
    -------
    Study
        ``data``: ``waterfall`` (list of ``step``, ``peaks_N``, ``change_N``), ``resolved``
        (``peaks_N``: mean over the seeds, ``seed_scatter_percent``), ``halved`` (by step:
        ``from``, the step that it follows or the base, ``seeds``, ``peaks_N``, ``change_percent``,
        ``within_5_percent``, ``mean_change_percent``: that of the mean over the path; both also
        as ``change_deg`` and ``mean_change_deg``, in degrees of the friction angle, null where the
        step's leg or angle is not the base's; a step to another has ``from`` null and no change),
        ``space`` (its ``base`` and ``steps``, as these two), ``change_when_halved_percent`` (by
        force: ``mean_change_percent`` of :data:`HALVED`; null while that is missing),
        ``percent_per_degree`` by force, and ``missing``.

    Raises
    ------
    InputError
        If a base is not among the finished.
    """
    for plan in (way, halved, space):
        need_base(plan, finished)
    steps = _waterfall(way, finished)
    resolved, changes = _changes(halved, finished)
    of_space, in_space = _changes(space, finished)
    missing = {
        name: s
        for plan in (way, halved, space)
        for name, s in missing_from(steps_of(plan), finished).items()
    }
    data = {
        "waterfall": steps,
        "resolved": resolved,
        "halved": changes,
        "change_when_halved_percent": changes.get(HALVED, {}).get("mean_change_percent"),
        "space": {"base": of_space, "steps": in_space},
        "percent_per_degree": {f: 100.0 * degrees.rise_of()[f] for f in FORCES},
        "missing": list(missing),
    }
    rows = [
        *_steps(steps),
        *_changed(resolved, changes, base="resolved"),
        *_changed(of_space, in_space, base=space.scenario.name),
    ]
    table = Table.of(TITLE, COLUMNS, rows)
    alone = {name: change for name, change in changes.items() if name in _alone(changes)}
    notes = [*_notes(data), *not_yet(NAME, missing)]
    return Study(
        table=table,
        data=data,
        figures={NAME: waterfall_figure(steps, alone, TOLERANCE_PERCENT)},
        documents=page(NAME, table, _method(), notes, PICTURE),
        notes=notes,
    )


def _changes(
    plan: Plan, finished: Mapping[str, ForceHistory]
) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
    """The base of a plan, and what its finished steps change; see :func:`study_of`."""
    runs = _runs(plan, finished)
    both_of = {
        name: ([peaks_of(h) for h in same], [_level(h) for h in same])
        for name, same in runs.items()
    }
    start = {name: (_mean(peaks), _mean(levels)) for name, (peaks, levels) in both_of.items()}
    of = {
        name: (scenario.leg.shape, scenario.soil.friction_angle_deg)
        for name, scenario in steps_of(plan).items()
    }
    changes: dict[str, dict[str, Any]] = {}
    for name, before in followed(plan).items():
        if name in start and before in start:
            change = {"from": before, "seeds": len(runs[name]), "peaks_N": start[name][0]}
            if of[name] != of[before]:
                change["from"] = None
            else:
                change |= _change(*start[name], *start[before])
                if of[name] != of[plan.scenario.name]:
                    change |= {"change_deg": None, "mean_change_deg": None}
            changes[name] = change
    return _seeds(*both_of[plan.scenario.name]), changes


def followed(plan: Plan) -> dict[str, str]:
    """Steps of a plan to what each one changes: another step, or the base by its name."""
    names = [plan.scenario.name, *(step.name for step in plan.steps)]
    return {
        step.name: {PREVIOUS: before, BASE: names[0]}.get(step.after, step.after)
        for before, step in zip(names, plan.steps, strict=False)
    }


def _runs(plan: Plan, finished: Mapping[str, ForceHistory]) -> dict[str, list[ForceHistory]]:
    """Finished histories by step, or the base by its name: one, or those that differ by a seed."""
    found: dict[str, list[ForceHistory]] = {}
    for name, scenario in steps_of(plan).items():
        if scenario.hash in finished:
            step, _, seed = name.rpartition(SEED)
            same = (step.removesuffix(", ") or plan.scenario.name) if seed.isdigit() else name
            found.setdefault(same, []).append(finished[scenario.hash])
    return found


def _waterfall(way: Plan, finished: Mapping[str, ForceHistory]) -> list[dict[str, Any]]:
    """Peaks along the way and what each step took; ends where the first case is missing."""
    steps: list[dict[str, Any]] = []
    for name, scenario in steps_of(way).items():
        if scenario.hash not in finished:
            break
        peaks = peaks_of(finished[scenario.hash])
        before = steps[-1]["peaks_N"] if steps else peaks
        change = {f: peaks[f] - before[f] for f in FORCES}
        steps.append({"step": name, "peaks_N": peaks, "change_N": change})
    return steps


def _level(history: ForceHistory) -> dict[str, float]:
    """Mean forces over the path [N]."""
    return {"Fz": float(history.Fz.mean()), "Fx": float(history.Fx.mean())}


def _mean(values: Sequence[ByForce]) -> dict[str, float]:
    return {f: float(np.mean([value[f] for value in values])) for f in FORCES}


def _percent(values: ByForce, whole: ByForce) -> dict[str, float]:
    return {f: 100.0 * (values[f] / whole[f] - 1.0) for f in FORCES}


def _degrees(percent: ByForce) -> dict[str, float]:
    return {f: degrees.in_degrees(percent[f], f) for f in FORCES}


def _seeds(peaks: Sequence[ByForce], levels: Sequence[ByForce]) -> dict[str, Any]:
    """Mean over runs that differ in their particle seed alone, and their scatter."""
    mean = _mean(peaks)
    apart = [_percent(level, _mean(levels)) for level in levels]
    return {
        "peaks_N": mean,
        "seeds": len(peaks),
        "seed_scatter_percent": {
            f: 100.0 * float(np.std([p[f] for p in peaks], ddof=1)) / mean[f]
            if len(peaks) > 1
            else None
            for f in FORCES
        },
        "mean_scatter_percent": {f: max(abs(a[f]) for a in apart) for f in FORCES},
    }


def _change(
    peaks: ByForce, level: ByForce, peaks_before: ByForce, level_before: ByForce
) -> dict[str, Any]:
    """How far peaks, and means over the path, are from those of what is changed."""
    percent, of_mean = _percent(peaks, peaks_before), _percent(level, level_before)
    return {
        "change_percent": percent,
        "change_deg": _degrees(percent),
        "within_5_percent": all(abs(v) <= TOLERANCE_PERCENT for v in percent.values()),
        "mean_change_percent": of_mean,
        "mean_change_deg": _degrees(of_mean),
    }


# -- what people see -------------------------------------------------------------------------------


def _steps(steps: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Rows of the waterfall."""
    rows = []
    for i, step in enumerate(steps):
        said = {f: f"{step['change_N'][f]:+.2f} N" if i else "" for f in FORCES}
        rows.append({**step, "said": {**said, "mean": ""}})
    return rows


def _changed(
    start: Mapping[str, Any], changes: Mapping[str, Any], *, base: str
) -> list[dict[str, Any]]:
    """Rows of a base and of what changes it; steps that do not begin with a preset get its name."""
    scatter = start["seed_scatter_percent"]
    of_seeds = {f: "" if scatter[f] is None else f"scatter {scatter[f]:.1f} %" for f in FORCES}
    of_seeds["mean"] = f"within {both(start['mean_scatter_percent'], ' %')}"
    name = f"{base}, mean of {start['seeds']} seeds"
    rows = [{"step": name, "peaks_N": start["peaks_N"], "said": of_seeds}]
    for above, (name, change) in zip(["", *changes], changes.items(), strict=False):
        said = dict.fromkeys((*FORCES, "mean"), "")
        if before := change["from"]:
            percent, turned = change["change_percent"], change["change_deg"]
            of = " from above" if before == above else f" from '{before}'"
            of = of if before in changes else ""
            for f in FORCES:
                worth = f", {turned[f]:+.1f}°" if turned else ""
                said[f] = f"{percent[f]:+.1f} %{worth}{of}"
            said["mean"] = both(change["mean_change_percent"], " %", "+.1f")
        step = f"resolved, {name}" if base == "resolved" and not name.startswith(base) else name
        rows.append({"step": step, "peaks_N": change["peaks_N"], "said": said})
    return rows


def _alone(changes: Mapping[str, Any]) -> list[str]:
    """Steps that change the base by themselves."""
    return [name for name, one in changes.items() if one["from"] and one["from"] not in changes]


def _notes(data: Mapping[str, Any]) -> list[str]:
    notes = []
    steps = data["waterfall"][1:]
    halved = {name: change for name, change in data["halved"].items() if change["from"]}
    if steps:
        largest = max(steps, key=lambda step: abs(step["change_N"]["Fz"]))
        notes.append(
            f"The largest step in F_z is '{largest['step']}': {largest['change_N']['Fz']:+.1f} N."
        )
    alone = _alone(data["halved"])
    within = [name for name in alone if halved[name]["within_5_percent"]]
    beyond = [name for name in alone if name not in within]
    bound = f"{TOLERANCE_PERCENT:g} %"
    if within:
        notes.append(f"Both peaks of resolved move by at most {bound} with: {', '.join(within)}.")
    if beyond:
        notes.append(f"A peak of resolved moves by more than {bound} with: {', '.join(beyond)}.")
    if halved:
        means = {name: change["mean_change_percent"] for name, change in halved.items()}
        moved = "; ".join(
            name
            + ("" if name in alone else f", from '{halved[name]['from']}'")
            + f" {both(mean, ' %', '+.1f')}"
            + (f" ({degrees.worth(mean)})" if halved[name]["mean_change_deg"] else "")
            for name, mean in means.items()
            if max(map(abs, mean.values())) > TOLERANCE_PERCENT
        )
        apart = both(data["resolved"]["mean_scatter_percent"], " %")
        notes.append(
            f"Mean forces over the path (F_z / F_x; seeds move those of resolved by {apart} at "
            f"most) change by more than {bound} with: {moved or 'nothing'}."
        )
    return notes


GRIDS_SHARE_PERCENT = (15.0, 20.0)
"""What the grid may hold of the forces of ``resolved``, judged from the halved cells [%]."""


def _method() -> str:
    low, high = GRIDS_SHARE_PERCENT
    by_force = ", ".join(
        f"{-degrees.in_degrees(-low, f):.1f} to {-degrees.in_degrees(-high, f):.1f}° by {words}"
        for f, words in (("Fz", "F_z"), ("Fx", "F_x"))
    )
    return (
        "Straight leg and φ = 35° unless others are named, speed-up 10, peaks of 1° means. Each "
        "row of the first part adds a change to all before it; each of the second changes preset "
        "`resolved`, and each of the third the leg in space on cells of 7 mm, by itself, but for "
        "what is said to be from above, or from a row by its name: that changes the row above it, "
        "or the one that is named. A row without changes is where another leg or angle begins. "
        "Preset `resolved-2` has the tip drawn in and phases of 20 steps on each grid. Rows *in "
        "space* are of the leg's true width, contact a cell short of its tip but where another is "
        "named, and soil with the smooth surface of Matsuoka and Nakai, damped, but where faces "
        "(those of Mohr-Coulomb) are named; of all means, those over the path. Plans: "
        "`waterfall`, `resolution` and `space`. "
        "Run again: `terraphi study resolution`.\n\n"
        f"{degrees.said()}\n\n"
        "Presets, and cells of 7 and 5 mm in space where contact ends at the tip or a cell short "
        "of it, are means over three seeds, all else is one run (`seeds` in `data.json`), so "
        "that a change of a peak no larger than a few times the scatter is not told from it; the "
        "means over the path are the better witness.\n\n"
        "What the grid still holds of the force of `resolved` falls about in proportion to Δx: if "
        f"halving it takes 7 to 9 %, some {low:g} to {high:g} % is the grid's. A friction angle "
        f"inferred from forces without it is too low by as much as that is worth: {by_force}. Most "
        "of it is where contact ends: `resolved-2` ends it 1.7 cells before the tip, and plates in "
        "soil that keeps its volume meet the force at Davis's reduced angle within 5 % "
        "(`terraphi study verification --only plate`; [convergence](convergence.md))."
    )
