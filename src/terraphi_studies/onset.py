"""Onset: what makes the lift of the straight leg rise at the leg angle where it does.

In Yuma sand and in glass beads the lift rises later than that of the model in space, which fits
their size. Plan ``onset`` changes the straight leg's soil, its friction and its height one at a
time; where the lift rises in each is set beside where it rises in the measured media. The lift
rises where its means over 1° first reach half of their largest, which no scale of the forces moves.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.measurements import measurement, medium_and_leg, names
from terraphi.library.plan import Plan
from terraphi.view.table import Table
from terraphi_studies import Study
from terraphi_studies.planned import Simulations, missing_from, need_base, not_yet, steps_of

NAME = "onset"
SEEDS = "space"
"""Plan of the same base, whose steps :data:`SEED` and a number are it with other particles."""
SEED = "seed "
THETA_DEG = np.arange(-79.0, 15.0)
"""Leg angles of the path that the plan and the measurements share [deg]."""
TITLE = "Where the lift of the straight leg rises to half its peak, and what moves that"
COLUMNS = (
    ("of", "{name}"),
    ("lift rises at", "{onset_deg:.1f}°"),
    (
        "beside the base",
        lambda row: (
            f"{abs(row['later_deg']):.1f}° {'later' if row['later_deg'] > 0 else 'earlier'}"
            if row["later_deg"]
            else ""
        ),
    ),
    ("mean lift", lambda row: row["size"]),
)


def run(*, cases: Simulations) -> Study:
    """Measure the finished cases of plan ``onset`` and the shipped media.

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
    plan, whole = Plan.load(NAME), Plan.load(SEEDS)
    # The other steps of that plan are another study's, which takes far longer.
    same = [step for step in whole.steps if step.name.startswith(SEED)]
    seeds = whole.model_copy(update={"steps": same})
    measured = {
        medium: one.history
        for (medium, leg), one in ((medium_and_leg(n), measurement(n)) for n in names())
        if leg == plan.scenario.leg.shape
    }
    return study_of(plan, seeds, cases.histories(plan, seeds), measured)


def study_of(
    plan: Plan,
    seeds: Plan,
    finished: Mapping[str, ForceHistory],
    measured: Mapping[str, ForceHistory],
) -> Study:
    """The study on what is finished.

    Parameters
    ----------
    plan
        Whose steps each change the base.
    seeds
        A plan of the same base, with steps that change its seed.
    finished
        Histories by the hash of their scenario.
    measured
        Histories of the same leg by medium.

    Returns
    -------
    Study
        ``data``: ``base`` and ``steps`` by name, ``onset_deg``, ``later_deg`` (than the base) and
        ``mean_lift_change_percent``; the base is a mean over seeds, with ``scatter_deg``, their
        standard deviation; ``media`` by name, ``onset_deg`` and ``later_deg``; ``missing``.

    Raises
    ------
    InputError
        If the base is not among the finished, or the two plans have different ones.
    """
    need_base(plan, finished)
    if plan.scenario.hash != seeds.scenario.hash:
        raise InputError(f"plans '{plan.name}' and '{seeds.name}' have different bases")
    of_plan, of_seeds = steps_of(plan), steps_of(seeds)
    same = [finished[plan.scenario.hash]] + [
        finished[s.hash]
        for name, s in of_seeds.items()
        if name.startswith(SEED) and s.hash in finished
    ]
    rises = [onset_deg(history) for history in same]
    base, size = float(np.mean(rises)), float(np.mean([_lift(h) for h in same]))
    scatter = float(np.std(rises, ddof=1)) if len(rises) > 1 else None
    changed: dict[str, dict[str, Any]] = {
        name: {
            "onset_deg": onset_deg(finished[s.hash]),
            "later_deg": onset_deg(finished[s.hash]) - base,
            "mean_lift_change_percent": 100.0 * (_lift(finished[s.hash]).mean() / size - 1.0),
        }
        for name, s in of_plan.items()
        if s.hash in finished and s.hash != plan.scenario.hash
    }
    media = {
        medium: {"onset_deg": onset_deg(history), "later_deg": onset_deg(history) - base}
        for medium, history in measured.items()
    }
    rows = [
        {"name": f"{_base(plan)}, mean of {len(rises)} seeds", "onset_deg": base}
        | {"later_deg": 0.0, "size": f"{size:.2f} N"},
        *(
            {"name": name, "size": f"{one['mean_lift_change_percent']:+.0f} %", **one}
            for name, one in changed.items()
        ),
        *({"name": f"measured, {name}", "size": "", **one} for name, one in media.items()),
    ]
    missing = missing_from(of_plan, finished)
    return Study(
        table=Table.of(TITLE, COLUMNS, rows),
        data={
            "base": {"onset_deg": base, "scatter_deg": scatter, "mean_lift_N": size},
            "steps": changed,
            "media": media,
            "missing": list(missing),
        },
        notes=[*_notes(scatter, changed), *not_yet(NAME, missing)],
    )


def _base(plan: Plan) -> str:
    """The base for people, with what the steps change."""
    return f"{plan.scenario.name}, φ {plan.scenario.soil.friction_angle_deg:g}°"


def onset_deg(history: ForceHistory) -> float:
    """Leg angle at which the 1° means of the lift first reach half of their largest [deg]."""
    lift = _lift(history)
    lift /= 0.5 * lift.max()
    after = max(int(np.argmax(lift >= 1.0)), 1)
    return float(np.interp(1.0, lift[after - 1 : after + 1], THETA_DEG[after - 1 : after + 1]))


def _lift(history: ForceHistory) -> FloatArray:
    """1° means of the lift at :data:`THETA_DEG` [N]."""
    return history.means(np.radians(THETA_DEG), math.radians(0.5))[:, history.axes.index("z")]


def _notes(scatter: float | None, changed: Mapping[str, Mapping[str, float]]) -> list[str]:
    """What moves the onset by more than other particles do."""
    if scatter is None or not changed:
        return []
    later = {name: one["later_deg"] for name, one in changed.items()}
    moved = {name: by for name, by in later.items() if abs(by) > 2.0 * scatter}
    what = "; ".join(f"{name} by {by:+.1f}°" for name, by in moved.items()) or "by nothing tried"
    return [f"Seeds scatter by {scatter:.1f}°. The onset is moved by more than twice that: {what}."]
