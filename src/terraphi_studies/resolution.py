"""Resolution: is the force of preset ``resolved`` the soil's, and what took it there.

Two shipped plans. ``waterfall`` leads from preset ``paper-1`` to ``resolved``, one remedy after
another. ``resolution`` takes ``resolved`` and halves the cells, the time step and the speed-up, and
makes the soil four times as stiff: none of these is a property of the soil, so the peaks should
stay. What a change is worth is seen beside what another seed does. Peaks are those of 1° means,
over the part of the path that holds both.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from terraphi.experiment.history import ForceHistory
from terraphi.library.plan import BASE, Plan, Variant
from terraphi.view.plots import waterfall_figure
from terraphi.view.table import Table
from terraphi_studies import Study, degrees, page
from terraphi_studies.planned import Simulations, missing_from, need_base, not_yet, of_plans

PLANS = ("waterfall", "resolution")
TITLE = "Resolution: from preset paper-1 to preset resolved, and whether that has arrived"
HEADER = ("step", "peak Fz", "peak Fx", "change of Fz", "change of Fx")
FORCES = ("Fz", "Fx")
TOLERANCE_PERCENT = 5.0
"""What halving anything may do to a peak [%]."""
SEED = "seed"
"""Steps whose names begin so are the base with other particle places."""
HALVED = "Δx halved"
"""The step that says what is left of the grid in the forces."""


@of_plans
def run(cases: Simulations) -> Study:
    """Measure the finished cases of both plans.

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
    way, halved = (Plan.load(name) for name in PLANS)
    return study_of(way, halved, cases.histories(way, halved))


def study_of(way: Plan, halved: Plan, finished: Mapping[str, ForceHistory]) -> Study:
    """The study on what is finished of the two plans.

    Parameters
    ----------
    way
        Plan of steps that lead from one preset to the other.
    halved
        Plan of steps that each change the base.
    finished
        Histories by the hash of their scenario.

    Returns
    -------
    Study
        ``data``: ``waterfall`` (list of ``step``, ``peaks_N``, ``change_N``), ``resolved``
        (``peaks_N``: mean over the seeds, ``seed_scatter_percent``), ``halved`` (by step:
        ``peaks_N``, ``change_percent``, ``within_5_percent``, ``mean_change_percent``: that of the
        mean over the path; both also as ``change_deg`` and ``mean_change_deg``, in degrees of the
        friction angle), ``change_when_halved_percent`` (by force: ``mean_change_percent`` of
        :data:`HALVED`; null while that is missing), ``percent_per_degree`` by force, and
        ``missing``.

    Raises
    ------
    InputError
        If a base is not among the finished.
    """
    for plan in (way, halved):
        need_base(plan, finished)
    steps = _waterfall(way, finished)
    seeds = [
        _peaks(finished[v.scenario.hash]) for v in _seeds(halved) if v.scenario.hash in finished
    ]
    mean = {f: float(np.mean([peaks[f] for peaks in seeds])) for f in FORCES}
    scatter = {
        f: 100.0 * float(np.std([p[f] for p in seeds], ddof=1)) / mean[f]
        if len(seeds) > 1
        else None
        for f in FORCES
    }
    others = [
        v for v in halved.variants() if v not in _seeds(halved) and v.scenario.hash in finished
    ]
    changes = {v.key: _change(_peaks(finished[v.scenario.hash]), mean) for v in others}
    levels = [
        _level(finished[v.scenario.hash]) for v in _seeds(halved) if v.scenario.hash in finished
    ]
    for v in others:
        percent = _percent(_level(finished[v.scenario.hash]), levels)
        changes[v.key] |= {"mean_change_percent": percent, "mean_change_deg": _degrees(percent)}
    missing = {v.key: v.scenario for p in (way, halved) for v in missing_from(p, finished)}
    apart = [_percent(level, levels) for level in levels]
    resolved = {
        "peaks_N": mean,
        "seeds": len(seeds),
        "seed_scatter_percent": scatter,
        "mean_scatter_percent": {f: max(abs(a[f]) for a in apart) for f in FORCES},
    }
    data = {
        "waterfall": steps,
        "resolved": resolved,
        "halved": changes,
        "change_when_halved_percent": changes.get(HALVED, {}).get("mean_change_percent"),
        "percent_per_degree": {f: 100.0 * degrees.rise_of()[f] for f in FORCES},
        "missing": list(missing),
    }
    table = Table(TITLE, HEADER, _rows(steps, resolved, changes))
    notes = [*_notes(data), *not_yet("resolution", missing.items(), finished)]
    written = page(table, _method(), notes, "resolution.png", PICTURE)
    return Study(
        table=table,
        data=data,
        figures={"resolution": waterfall_figure(steps, changes, TOLERANCE_PERCENT)},
        documents={"resolution.md": written},
        notes=notes,
    )


def _waterfall(way: Plan, finished: Mapping[str, ForceHistory]) -> list[dict[str, Any]]:
    """Peaks along the way and what each step took; ends where the first case is missing."""
    steps: list[dict[str, Any]] = []
    for variant in way.variants():
        if variant.scenario.hash not in finished:
            break
        peaks = _peaks(finished[variant.scenario.hash])
        before = steps[-1]["peaks_N"] if steps else peaks
        name = way.scenario.name if variant.key == BASE else variant.key
        change = {f: peaks[f] - before[f] for f in FORCES}
        steps.append({"step": name, "peaks_N": peaks, "change_N": change})
    return steps


def _seeds(plan: Plan) -> list[Variant]:
    return [v for v in plan.variants() if v.key == BASE or v.key.startswith(SEED)]


def _peaks(history: ForceHistory) -> dict[str, float]:
    peaks = history.peaks()
    return {"Fz": peaks.Fz, "Fx": peaks.Fx}


def _level(history: ForceHistory) -> dict[str, float]:
    """Mean forces over the path [N]."""
    return {"Fz": float(history.Fz.mean()), "Fx": float(history.Fx.mean())}


def _percent(
    level: Mapping[str, float], references: Sequence[Mapping[str, float]]
) -> dict[str, float]:
    """How far mean forces are from the mean of others [%]."""
    return {
        f: 100.0 * (level[f] / float(np.mean([other[f] for other in references])) - 1.0)
        for f in FORCES
    }


def _degrees(percent: Mapping[str, float]) -> dict[str, float]:
    return {f: degrees.in_degrees(percent[f], f) for f in FORCES}


def _change(peaks: Mapping[str, float], mean: Mapping[str, float]) -> dict[str, Any]:
    percent = {f: 100.0 * (peaks[f] / mean[f] - 1.0) for f in FORCES}
    return {
        "peaks_N": dict(peaks),
        "change_percent": percent,
        "change_deg": _degrees(percent),
        "within_5_percent": all(abs(v) <= TOLERANCE_PERCENT for v in percent.values()),
    }


# -- what people see -------------------------------------------------------------------------------


def _rows(
    steps: Sequence[Mapping[str, Any]], resolved: Mapping[str, Any], changes: Mapping[str, Any]
) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for step in steps:
        peaks, change = step["peaks_N"], step["change_N"]
        taken = [f"{change[f]:+.2f} N" if rows else "" for f in FORCES]
        rows.append((step["step"], *(f"{peaks[f]:.2f} N" for f in FORCES), *taken))
    scatter = resolved["seed_scatter_percent"]
    rows.append(
        (
            f"resolved, mean of {resolved['seeds']} seeds",
            *(f"{resolved['peaks_N'][f]:.2f} N" for f in FORCES),
            *("" if scatter[f] is None else f"scatter {scatter[f]:.1f} %" for f in FORCES),
        )
    )
    for name, change in changes.items():
        peaks, percent, turned = (
            change[key] for key in ("peaks_N", "change_percent", "change_deg")
        )
        rows.append(
            (
                f"resolved, {name}",
                *(f"{peaks[f]:.2f} N" for f in FORCES),
                *(f"{percent[f]:+.1f} %, {turned[f]:+.1f}°" for f in FORCES),
            )
        )
    return rows


def _notes(data: Mapping[str, Any]) -> list[str]:
    notes = []
    steps = data["waterfall"][1:]
    if steps:
        largest = max(steps, key=lambda step: abs(step["change_N"]["Fz"]))
        notes.append(
            f"The largest step in F_z is '{largest['step']}': {largest['change_N']['Fz']:+.1f} N."
        )
    within = [name for name, change in data["halved"].items() if change["within_5_percent"]]
    beyond = [name for name in data["halved"] if name not in within]
    bound = f"{TOLERANCE_PERCENT:g} %"
    if within:
        notes.append(f"Both peaks of resolved move by at most {bound} with: {', '.join(within)}.")
    if beyond:
        notes.append(f"A peak of resolved moves by more than {bound} with: {', '.join(beyond)}.")
    if data["halved"]:
        apart = data["resolved"]["mean_scatter_percent"]
        moved = ", ".join(
            f"{name} {change['mean_change_percent']['Fz']:+.1f} / "
            f"{change['mean_change_percent']['Fx']:+.1f} % "
            f"({degrees.worth(change['mean_change_percent'])})"
            for name, change in data["halved"].items()
        )
        notes.append(
            f"The mean forces over the path (F_z / F_x), which seeds move by {apart['Fz']:.1f} / "
            f"{apart['Fx']:.1f} % at most, change by: {moved}."
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
        "Straight leg, φ = 35°, speed-up 10, peaks of 1° means. Each row of the first part adds a "
        "change to all before it; each of the second changes preset `resolved` by itself. Plans: "
        "`waterfall` and `resolution`. Run again: `terraphi study resolution`.\n\n"
        f"{degrees.said()}\n\n"
        "One run stands against the mean over the seeds, so that a change of a peak no larger "
        "than a few times the scatter is not told from it; the means over the path are the better "
        "witness.\n\n"
        "What the grid still holds of the force falls about in proportion to Δx: if halving it "
        f"takes 7 to 9 %, some {low:g} to {high:g} % is the grid's. A friction angle inferred from "
        f"forces without it is too low by as much as that is worth: {by_force}. The same contact "
        "and cells push a rough plate that has soil of associated flow beneath its toe with a "
        "tenth more than the exact passive force "
        f"({degrees.in_degrees(10.0, 'Fx'):.1f}° by F_x), and lie on a line that leads to it "
        "(`terraphi study verification --only plate`). Phases three times as long take a little of "
        "it away."
    )


PICTURE = "peaks along the way, and what is left of them when things are halved"
