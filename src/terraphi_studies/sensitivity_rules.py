"""What follows from a study of sensitivity: rules from numbers to sentences.

No change is taken for one that is smaller than the **tolerance**: twice the scatter between seeds,
and never less than 2 %. It is set for each force, for deviations (NRMSD) and for peaks apart.

The rules, by the kind of setting:

``limit``
    The largest value up to which every value tried deviates from the least one by no more than the
    tolerance, in both forces.
``convergence``
    Converged if, from the base to the finest value tried, both the peaks and the histories differ
    by no more than the tolerance, in both forces. Where the base itself is the finest, it is the
    next coarser value that is judged so. If three peaks or more lie on a straight line over the
    step size, to within the tolerance, its end at zero estimates their limit. What differs is given
    in degrees of the friction angle too (:mod:`terraphi_studies.degrees`).
``share``
    The part of the base's peak that goes when the setting is switched off, or, where that is not
    simulated yet, turned down as far as it was.
``effect``
    The value that moves the peaks furthest from the base's, and whether it does by more than the
    tolerance.
``scatter``
    The scatter itself.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from terraphi_studies import PAPER_LIBRARY, capitalised, degrees
from terraphi_studies.sensitivity_cases import FORCES, Group, Percent, Scatter, Simulated, change

LEAST_TOLERANCE = 2.0
"""Deviations and changes of peaks below this are of no interest [%]."""
SCATTERS = 2.0
"""Deviations below this many times the scatter between seeds cannot be told from it [-]."""
SIGNS = {"Fz": "F_z", "Fx": "F_x"}


class Tolerance(NamedTuple):
    """Largest deviations that count as none."""

    nrmsd: Percent
    """[%]."""
    peak: Percent
    """[%]."""


class Conclusion(NamedTuple):
    """What follows from a group."""

    sentence: str
    """For people."""
    numbers: dict[str, Any]
    """What the sentence rests on, JSON-able."""


def tolerance_of(scatter: Scatter) -> Tolerance:
    """Tolerance that a scatter allows."""
    return Tolerance(*(_at_least(each) for each in (scatter.nrmsd, scatter.peak)))


def _at_least(scatter: Percent) -> Percent:
    return {force: max(LEAST_TOLERANCE, SCATTERS * scatter[force]) for force in FORCES}


def conclude(group: Group, scatter: Scatter) -> Conclusion:
    """Apply the rule of a group's setting.

    Parameters
    ----------
    group
        Finished cases, at least one beside the base.
    scatter
        Between seeds.

    Returns
    -------
    Conclusion
    """
    if group.setting.rule == "scatter":
        return conclude_scatter(scatter)
    rules: dict[str, Callable[[Group, Tolerance], Conclusion]] = {
        "limit": _limit,
        "convergence": _convergence,
        "share": _share,
        "effect": _effect,
    }
    sentence, numbers = rules[group.setting.rule](group, tolerance_of(scatter))
    if group.setting.remark:
        sentence += f" ({group.setting.remark}.)"
    if group.awaited is not None:
        sentence += f" (Preliminary: the reference is to be {group.awaited}, not simulated yet.)"
        numbers = {**numbers, "awaited": group.awaited}
    return Conclusion(sentence, numbers)


def conclude_scatter(scatter: Scatter) -> Conclusion:
    """What counts as no change."""
    tolerance = tolerance_of(scatter)
    known = (
        f"{scatter.runs} runs that differ in their seed alone are {both(scatter.nrmsd)} apart in "
        f"NRMSD and {both(scatter.peak)} in their peaks"
        if scatter.runs > 1
        else "the scatter between seeds is not known yet"
    )
    return Conclusion(
        f"Tolerance (F_z / F_x here and below): {known}; a deviation within "
        f"{both(tolerance.nrmsd)} and a peak's change within {both(tolerance.peak)} count as none.",
        {"runs": scatter.runs},
    )


def _limit(group: Group, tolerance: Tolerance) -> Conclusion:
    name, reference = group.setting.name, group.reference
    safe, beyond = reference, None
    for case in group.cases:
        if case is reference:
            continue
        moves = {force: change(reference, case, force) for force in FORCES}
        calm = _within(group.deviation(case), tolerance.nrmsd) and _within(moves, tolerance.peak)
        if not calm:
            beyond = case
            break
        safe = case
    numbers = {"safe": safe.label, "beyond": beyond.label if beyond else None}
    if safe is reference and beyond is not None:
        said = (
            f"none above {reference.label} is safe: {beyond.label} deviates from it by "
            f"{both(group.deviation(beyond))} already, its peaks by {moved(reference, beyond)}"
        )
    else:
        far = (
            f"; {beyond.label} deviates by {both(group.deviation(beyond))}, its peaks by "
            f"{moved(reference, beyond)}"
            if beyond
            else ""
        )
        bound = "safe up to" if beyond else "safe as far as it was tried, up to"
        said = (
            f"{bound} {safe.label}, which deviates from {reference.label} by "
            f"{both(group.deviation(safe))}, its peaks by {moved(reference, safe)}{far}"
        )
    return Conclusion(f"{capitalised(name)}: {said}.", numbers)


def _convergence(group: Group, tolerance: Tolerance) -> Conclusion:
    finest_first = group.cases if group.setting.reference == "least" else group.cases[::-1]
    finest, next_finest = finest_first[:2]
    # Where the base is the finest there is, the next coarser value says what refining does.
    coarse = next_finest if finest is group.base else group.base
    apart = group.deviation(coarse)
    moves = {force: change(coarse, finest, force) for force in FORCES}
    peaks, histories = _within(moves, tolerance.peak), _within(apart, tolerance.nrmsd)
    verdict = {
        (True, True): "have converged",
        (True, False): "have converged in their peaks, not in their course,",
    }.get((peaks, histories), "have not converged")
    more = ""
    if coarse is not next_finest:
        more = f"; the last refinement, from {next_finest.label}, moves the peaks by "
        more += moved(next_finest, finest)
    trend = {force: _trend(finest_first, force) for force in FORCES}
    if trend["Fz"] and trend["Fz"] == trend["Fx"]:
        more += f"; both peaks {trend['Fz']} with every refinement"
    limit = {force: _limit_at_zero(group, force, tolerance.peak[force]) for force in FORCES}
    for force, value in limit.items():
        if value is not None:
            past = 100.0 * (group.base.peak(force) - value) / value
            more += (
                f"; the peaks of {SIGNS[force]} lie on a straight line to {value:.2f} N at size 0"
            )
            turned = degrees.in_degrees(past, force, library=PAPER_LIBRARY)
            more += f" (the base: {past:+.0f} %, {turned:+.1f}°)"
    return Conclusion(
        f"{capitalised(group.setting.name)}: the forces {verdict} at {coarse.label}; at "
        f"{finest.label} the peaks differ by {moved(coarse, finest)} "
        f"({degrees.worth(moves, library=PAPER_LIBRARY)}) and the histories by "
        f"{both(apart)}{more}.",
        {
            "converged": peaks and histories,
            "peaks_converged": peaks,
            "from_to": [coarse.label, finest.label],
            "peak_change_percent": moves,
            "peak_change_deg": {
                f: degrees.in_degrees(moves[f], f, library=PAPER_LIBRARY) for f in FORCES
            },
            "nrmsd_percent": apart,
            "trend": trend,
            "limit_N": limit,
        },
    )


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


def _share(group: Group, tolerance: Tolerance) -> Conclusion:
    base, least = group.base, group.cases[0]  # in order of the setting's value
    if least is base:  # turned up, never down
        return _effect(group, tolerance)
    off = least.label == "none"
    share = {force: -change(base, least, force) for force in FORCES}
    peaks = ", ".join(
        f"{SIGNS[f]} {base.peak(f):.2f} N with it and {least.peak(f):.2f} N "
        + ("without" if off else f"at {least.label}")
        for f in FORCES
    )
    what = "makes" if off else f"less that of {least.label} makes"
    within = "; within the tolerance" if _within(share, tolerance.peak) else ""
    return Conclusion(
        f"{capitalised(group.setting.name)}: {base.label} {what} {both(share)} of the peak force "
        f"({peaks}{within}).",
        {"share_percent": share, "against": least.label},
    )


def _effect(group: Group, tolerance: Tolerance) -> Conclusion:
    base = group.base
    others = [case for case in group.cases if case is not base]

    def size(case: Simulated) -> float:
        return max(abs(change(base, case, force)) / tolerance.peak[force] for force in FORCES)

    most = max(others, key=size)
    moves = {force: change(base, most, force) for force in FORCES}
    matters = not _within(moves, tolerance.peak)
    verdict = "moves the peaks" if matters else "moves the peaks by no more than the tolerance"
    return Conclusion(
        f"{capitalised(group.setting.name)}: {verdict}, most at {most.label}: by "
        f"{moved(base, most)}, to {most.peak('Fz'):.2f} and {most.peak('Fx'):.2f} N; the history "
        f"deviates by {both(group.deviation(most))}.",
        {"matters": matters, "most": most.label, "peak_change_percent": moves},
    )


# -- words -----------------------------------------------------------------------------------------


def both(percent: Percent) -> str:
    """Two percentages, such as ``1.2 / 0.9 %``, in the order of :data:`FORCES`."""
    return " / ".join(f"{percent[force]:.1f}" for force in FORCES) + " %"


def moved(before: Simulated, after: Simulated) -> str:
    """Changes of both peaks, with their signs."""
    return " / ".join(f"{change(before, after, force):+.1f}" for force in FORCES) + " %"


def _within(percent: Percent, tolerance: Percent) -> bool:
    return all(abs(percent[force]) <= tolerance[force] for force in FORCES)
