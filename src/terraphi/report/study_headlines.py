"""What came out of a study, in one sentence."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

Data = Mapping[str, Any]


def headline(name: str, data: Data) -> str:
    """What came out, in one sentence.

    Parameters
    ----------
    name
        Of the study.
    data
        ``data.json``. If they are not those of such a study, the sentence is of their number.
    """
    try:
        return _SENTENCES[name](data)
    except (AttributeError, IndexError, KeyError, TypeError, ValueError):
        return f"A study of {len(data)} results."


def _recovery(data: Data) -> str:
    count, error = len(data["cases"]), data["abs_error_deg"]
    return (
        f"{count} friction angles ({data['yield']}) recovered with a median error of "
        f"{error['median']:.2f}°, the largest {error['max']:.2f}°; {data['inside68']} lie "
        f"inside their 68 % interval and {data['inside95']} inside their 95 % interval."
    )


def _calibration(data: Data) -> str:
    return (
        f"In {data['replicates']} simulated worlds 68 % intervals hold the truth in "
        f"{100.0 * data['coverage68']:.1f} % and 95 % intervals in "
        f"{100.0 * data['coverage95']:.1f} %."
    )


def _measured(data: Data) -> str:
    answers = data["answers"]
    believed = sum(answer["verdict"] == "consistent" for answer in answers)
    return (
        f"{len(answers)} inversions of measured forces, by {len(data['verdicts'])} libraries: "
        f"{believed or 'none'} consistent with the model."
    )


def _prediction(data: Data) -> str:
    sands = ", ".join(
        f"{medium} {fit['phi_deg']:.1f}° (μ = {fit['friction']:.2f})"
        for medium, fit in data["calibrated"].items()
    )
    return f"Friction angles that fit the straight leg: {sands}."


def _benchmark(data: Data) -> str:
    best = min(
        (max(forces.values()), leg, model)
        for leg, models in data["nrmsd_percent"].items()
        for model, forces in models.items()
    )
    return (
        f"Closest to the measured forces: {best[2]} on the {best[1]} leg, {best[0]:.1f} % of "
        "peak-to-peak in the worse of both forces."
    )


def _phi_sensitivity(data: Data) -> str:
    phi, peaks = data["phi_deg"], data["peak_Fz_N"]
    return (
        f"Peak lift goes from {peaks[0]:.1f} N at φ = {phi[0]:g}° to {peaks[-1]:.1f} N at "
        f"{phi[-1]:g}°."
    )


def _k0(data: Data) -> str:
    change = 100.0 * data["max_relative_change"]
    return f"The stress at rest changes a force history by at most {change:.2g} %."


def _surrogate(data: Data) -> str:
    errors = data["nrmsd_percent"]
    return (
        f"Held-out forces are predicted within {errors['Fz']:.2f} % (Fz) and "
        f"{errors['Fx']:.2f} % (Fx) of their peak-to-peak, root mean square."
    )


def _reading(data: Data) -> str:
    whole = [found for found in data["readings"] if found.get("off_by_percent") is not None]
    best = min(whole, key=lambda found: float(found["off_by_percent"]))
    return (
        f"Of {len(data['readings'])} readings of the paper's text the closest, "
        f"{best['reading']}, is {best['off_by_percent']:.0f} % off its peak forces."
    )


def _prototype(data: Data) -> str:
    shares = [
        100.0 * share
        for case in data["cases"]
        if case["model"] == "its code" and case["speed_up"] == 1.0
        for share in case["share_of_peaks"].values()
    ]
    return (
        f"The contact of the paper's prototype applies {min(shares):.0f} to {max(shares):.0f} % of "
        "the peak forces that it counts."
    )


def _sensitivity(data: Data) -> str:
    return f"One setting changed at a time, {len(data['groups'])} settings."


def _resolution(data: Data) -> str:
    first, last = data["waterfall"][0], data["waterfall"][-1]
    return (
        f"Peak lift goes from {first['peaks_N']['Fz']:.1f} N ({first['step']}) to "
        f"{last['peaks_N']['Fz']:.1f} N ({last['step']})."
    )


def _design(data: Data) -> str:
    parts = []
    for found in data["comparisons"]:
        grid, suggested = (found[order][-1][0] for order in ("grid", "suggested"))
        parts.append(f"{len(found['keys'])} varied, {found['cases'][-1]} cases: {grid:.2g}° and "
                     f"{suggested:.2g}°")  # fmt: skip
    return f"Error of φ by an even grid, and in the suggested order: {'; '.join(parts)}."


def _verification(data: Data) -> str:
    total = data["passed"] + data["missed"]
    return f"{data['passed']} of {total} checks against known answers passed."


_SENTENCES: dict[str, Callable[[Data], str]] = {
    "recovery": _recovery,
    "calibration": _calibration,
    "measured": _measured,
    "prediction": _prediction,
    "benchmark": _benchmark,
    "phi_sensitivity": _phi_sensitivity,
    "k0": _k0,
    "surrogate": _surrogate,
    "reading": _reading,
    "prototype": _prototype,
    "sensitivity": _sensitivity,
    "resolution": _resolution,
    "design": _design,
    "verification": _verification,
}
