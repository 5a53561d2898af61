"""Whether an inferred friction angle may be believed: a first, numerical rule.

An inversion always returns an angle. It means little if the model cannot reproduce the forces at
any angle, or if the angle lies beyond those the library holds and the posterior piles up at an
edge; the verdict says so instead of letting the edge pass for an answer.

What would explain a record that no friction angle of a library fits.

A slip of the person who recorded it (columns exchanged, a sign turned, another unit, the path read
backwards), a sensor that was not tared or whose zero moved, or a friction angle beyond the
library's end. Each is tried on the library's own curves, and counts only if it explains the record
far better than any angle does as it stands. A record that none explains is one that the model does
not describe; a wider library would not help.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from terraphi.experiment.history import WINDOW_DEG
from terraphi.inference.budget import information_gain_bits
from terraphi.inference.calibrated import AMPLITUDES
from terraphi.inference.fit import LARGEST_ODDS, SMALLEST_PROBABILITY, Fit
from terraphi.inference.paper_likelihood import peak_to_peak
from terraphi.inference.posterior import Posterior

__all__ = ["Verdict", "judge", "nrmsd"]


@dataclass(frozen=True)
class Verdict:
    """What the numbers allow to say of an inversion.

    Attributes
    ----------
    verdict
        ``"consistent"``, ``"misfit"`` (no angle reproduces the forces) or ``"out_of_range"`` (the
        posterior is cut off by an edge of the library, and more than a misfit would do by itself).
    edge
        Which edge cuts it off; None unless out of range.
    reason
        One plain sentence with the numbers.
    """

    verdict: Literal["consistent", "misfit", "out_of_range"]
    edge: Literal["low", "high"] | None
    reason: str


def nrmsd(data: ArrayLike, model: ArrayLike) -> dict[str, float]:
    """Normalised root-mean-square deviation of each force.

    Parameters
    ----------
    data, model
        Measured and predicted observation vectors [Fx, Fz] [N], shape [2 theta].

    Returns
    -------
    dict
        RMS(data - model) over the peak-to-peak of the data of that force, a fraction [-], under
        ``"Fx"`` and ``"Fz"``.

    Raises
    ------
    ValueError
        If shapes differ, a value is not finite, or a force of the data does not vary.
    """
    spans = peak_to_peak(data)
    measured, predicted = (np.asarray(v, dtype=np.float64) for v in (data, model))
    if predicted.shape != measured.shape:
        raise ValueError(f"model has shape {predicted.shape}; data have {measured.shape}")
    if not np.isfinite(predicted).all():
        i = int(np.argmin(np.isfinite(predicted)))
        raise ValueError(f"model[{i}] is {predicted[i]}; it must be finite")
    deviations = np.sqrt(np.mean(np.square(measured - predicted).reshape(2, -1), axis=1))
    return {name: float(rms) / spans[name] for name, rms in zip(spans, deviations, strict=True)}


def judge(
    posterior: Posterior,
    *,
    bounds_deg: tuple[float, float],
    step_deg: float,
    residual_nrmsd: Mapping[str, float],
    convention: str = "",
    nrmsd_limit: float = 0.10,
    edge_mass_limit: float = 0.05,
    explanation: Explanation | None = None,
) -> Verdict:
    """Judge an inversion by where its posterior lies and how well its median fits.

    A misfit if either force deviates by more than ``nrmsd_limit``, unless an angle beyond an edge
    of the library would explain that; else out of range if more than ``edge_mass_limit`` of the
    mass lies within half a library step of an edge; else consistent.

    Parameters
    ----------
    posterior
        Posterior of the friction angle.
    bounds_deg
        Smallest and largest friction angle of the library [deg].
    step_deg
        Spacing of the library's friction angles [deg].
    residual_nrmsd
        Deviation of the model at the median from the data, as from `nrmsd`, fractions [-].
    convention
        What the friction angle means, named beside every angle in the reason.
    nrmsd_limit, edge_mass_limit
        Largest deviation and largest mass near an edge that are accepted, fractions [-].
    explanation
        What would explain forces that do not fit; ``None``: nothing was looked for.

    Raises
    ------
    ValueError
        If bounds do not increase, the step is not positive, or deviations are not those of
        ``"Fx"`` and ``"Fz"``, finite and not negative.
    """
    low, high = bounds_deg
    if not low < high:
        raise ValueError(f"bounds_deg are {low:g} and {high:g}; they must increase")
    if not 0.0 < step_deg < np.inf:
        raise ValueError(f"step_deg is {step_deg:g}; it must be positive and finite")
    if set(residual_nrmsd) != {"Fx", "Fz"}:
        raise ValueError(f"residual_nrmsd has keys {sorted(residual_nrmsd)}; expected Fx and Fz")
    if not all(0.0 <= value < np.inf for value in residual_nrmsd.values()):
        raise ValueError(f"residual_nrmsd is {dict(residual_nrmsd)}; fractions must be 0 or more")

    margin = step_deg / 2.0
    of = f" ({convention})" if convention else ""
    low_mass, high_mass = posterior.mass(low, low + margin), posterior.mass(high - margin, high)
    misfit = _describe_misfit(residual_nrmsd, nrmsd_limit)
    at_low = low_mass >= high_mass
    explained = explanation or Explanation()
    beyond = not misfit or explained.beyond == ("low" if at_low else "high")
    if max(low_mass, high_mass) > edge_mass_limit and beyond:
        mass, edge_deg = (low_mass, low) if at_low else (high_mass, high)
        reason = (
            f"{_percent(mass)} of the posterior mass lies within {margin:g}° of the "
            f"{'lower' if at_low else 'upper'} edge of the library at {edge_deg:g}°{of} (limit "
            f"{_percent(edge_mass_limit)}), so the friction angle may lie "
            f"{'below' if at_low else 'above'} it"
        )
        other_mass = high_mass if at_low else low_mass
        if other_mass > edge_mass_limit:
            reason += f", and {_percent(other_mass)} lies as close to the other edge"
        reason += f"; moreover, {misfit}." if misfit else "."
        return Verdict("out_of_range", "low" if at_low else "high", reason)
    if misfit:
        return Verdict("misfit", None, f"No friction angle fits: {misfit}.")
    return Verdict(
        "consistent",
        None,
        f"At the median the model deviates from the forces by {_percent(residual_nrmsd['Fx'])} "
        f"(Fx) and {_percent(residual_nrmsd['Fz'])} (Fz) of their peak-to-peak (limit "
        f"{_percent(nrmsd_limit)}), and at most {_percent(max(low_mass, high_mass))} of the "
        f"posterior mass lies within {margin:g}° of an edge of the library at {low:g}° or "
        f"{high:g}°{of} (limit {_percent(edge_mass_limit)}).",
    )


def _describe_misfit(residual_nrmsd: Mapping[str, float], limit: float) -> str | None:
    """A clause on the deviations, or None if both are accepted."""
    if max(residual_nrmsd.values()) <= limit:
        return None
    deviations = " and ".join(f"{_percent(residual_nrmsd[name])} ({name})" for name in ("Fx", "Fz"))
    return (
        f"at the median the model deviates from the forces by {deviations} of their "
        f"peak-to-peak (limit {_percent(limit)})"
    )


def _percent(fraction: float) -> str:
    return f"{100.0 * fraction:.1f} %"


EDGE_DENSITY = float(np.exp(-2.0))
"""Density at an edge, over the largest, above which the posterior is cut off: that of a normal
distribution two standard deviations from its mean [-]."""
AT_EDGE = 0.9
"""The same, above which the posterior counts as being at the edge, and a misfit as its sign [-]."""
EDGE_WIDTH = 1e-3
"""Width over which it is taken, of the library's span [-]."""
UNINFORMED_BITS = 0.1
"""Information below which a posterior is hardly the forces' doing: a range smaller by 7 % has that
much."""


def judge_calibrated(
    posterior: Posterior,
    fit: Fit,
    *,
    residual_nrmsd: Mapping[str, float],
    convention: str,
    explanation: Explanation,
) -> Verdict:
    """Judge an inversion: by whether an edge cuts the posterior off, and by the fit.

    A misfit if the best fit without a discrepancy is not one that scatter and noise explain: a
    wider library would not help. But out of range if an angle beyond the library's end would
    explain the forces, or if they fit and the density at an edge is not small. Else consistent.

    Parameters
    ----------
    posterior
        Posterior of the friction angle.
    fit
        The best fit without a discrepancy.
    residual_nrmsd
        Deviation of the model at the median from the data, by force, fractions [-].
    convention
        What the friction angle means.
    explanation
        What would explain forces that do not fit.
    """
    densities = edge_densities(posterior)
    cut = max(densities) > EDGE_DENSITY
    clause = _misfit(fit, residual_nrmsd) if fit.misfit else ""
    at_low, edge = _edge(posterior, densities, convention)
    limit = AT_EDGE if clause else EDGE_DENSITY
    beyond = not clause or explanation.beyond == ("low" if at_low else "high")
    if max(densities) > limit and beyond:
        reason = (
            f"The posterior is cut off by the {edge} (limit {limit:.0%}), so the friction "
            f"angle may lie {'below' if at_low else 'above'} it"
        )
        reason += f"; moreover, {clause}." if clause else "."
        return Verdict("out_of_range", "low" if at_low else "high", reason)
    if clause:
        reach = f"; the posterior reaches the {edge}" if cut else ""
        return Verdict("misfit", None, f"No friction angle fits: {clause}{reach}.")
    return Verdict(
        "consistent",
        None,
        f"Scatter and noise explain the residual: its chi-square is {fit.chi2:.0f} with "
        f"{fit.freedom} degrees of freedom (probability {fit.probability:.2f}, limit "
        f"{SMALLEST_PROBABILITY:g}), and the odds of a model discrepancy are "
        f"{_odds_in_words(fit.log10_odds)} (limit {LARGEST_ODDS:.0f}:1).",
    )


def uninformed(posterior: Posterior) -> list[str]:
    """A remark if the forces left the friction angle about as unknown as the library has it.

    Parameters
    ----------
    posterior
        Posterior under a uniform prior.
    """
    gain = information_gain_bits(posterior)
    if gain >= UNINFORMED_BITS:
        return []
    remark = (
        f"These forces hardly tell φ: they add {gain:.2f} bits to a uniform prior over the library "
        f"(limit {UNINFORMED_BITS:g}), so that the median is not theirs."
    )
    return [remark]


def _edge(
    posterior: Posterior, densities: tuple[float, float], convention: str
) -> tuple[bool, str]:
    """Whether the edge of more density is the lower one, and the edge in words."""
    at_low = densities[0] >= densities[1]
    edge = posterior.bounds_deg[0 if at_low else 1]
    return at_low, (
        f"{'lower' if at_low else 'upper'} edge of the library at {edge:g}° ({convention}), where "
        f"its density is {max(densities):.0%} of its largest"
    )


def edge_densities(posterior: Posterior) -> tuple[float, float]:
    """Density next to the lower and the upper edge, over the largest [-]."""
    low, high = posterior.bounds_deg
    if posterior.density is not None:
        top = float(posterior.density.max())
        return float(posterior.density[0]) / top, float(posterior.density[-1]) / top
    # Of draws, in bins a fifth of the 68 % interval wide.
    first, last = posterior.interval(0.68)
    width = max((last - first) / 5.0, EDGE_WIDTH * (high - low))
    counts, _ = np.histogram(posterior.phi_deg, bins=np.arange(low, high + width, width))
    below, above = posterior.mass(low, low + width), posterior.mass(high - width, high)
    top = float(counts.max()) / posterior.phi_deg.size
    return min(below / top, 1.0), min(above / top, 1.0)


def _misfit(fit: Fit, residual_nrmsd: Mapping[str, float]) -> str:
    """A clause on the misfit, with the numbers."""
    clauses = []
    if fit.probability < SMALLEST_PROBABILITY:
        clauses.append(
            f"without a discrepancy the residual of the best fit, at {fit.phi_deg:.1f}°, is "
            f"{np.sqrt(fit.chi2 / fit.freedom):.1f} times what scatter and noise allow "
            f"(chi-square {fit.chi2:.0f} with {fit.freedom} degrees of freedom)"
        )
    if fit.log10_odds > np.log10(LARGEST_ODDS):
        clauses.append(
            f"the residual follows the leg angle as noise does not: the odds of a model "
            f"discrepancy of {_amplitude(fit.amplitude)} of the peak-to-peak are "
            f"{_odds_in_words(fit.log10_odds)} (limit {LARGEST_ODDS:.0f}:1)"
        )
    deviations = " and ".join(
        f"{100 * residual_nrmsd[name]:.1f} % ({name})" for name in ("Fx", "Fz")
    )
    clauses.append(
        f"at the median the model deviates from the forces by {deviations} of their peak-to-peak"
    )
    return ", and ".join(clauses)


def _amplitude(amplitude: float) -> str:
    """Amplitude in words; the largest that was tried stands for all beyond it."""
    if amplitude >= AMPLITUDES[-1]:
        return f"{AMPLITUDES[-1]:.0%} or more"
    return f"about {amplitude:.0%}"


def _odds_in_words(log10_odds: float) -> str:
    """Odds in words."""
    if log10_odds > 4.0:
        return f"1e{log10_odds:.0f}:1"
    if log10_odds >= 0.0:
        return f"{10.0**log10_odds:.0f}:1"
    return f"1:{10.0 ** min(-log10_odds, 6.0):.0f}"


FloatArray = NDArray[np.float64]

BETTER = 0.5
"""Deviation that is left, over that before, up to which an explanation counts [-]."""
CLOSE = 0.3
"""Deviation that is left, of peak-to-peak, up to which a slip counts [-]."""
CLOSE_BEYOND = 0.1
"""The same of an angle beyond the library's end [-]."""
OFFSET, STEP, CLOSE_OFFSET = 0.05, 0.1, 0.05
"""Constant force that counts as an offset, or as a step, and the deviation left up to which it
does, of peak-to-peak [-]. With an offset curves of another model come within 0.1 of a library's,
and with either the shipped measurements within 0.07."""
FURTHEST_DEG = 15.0
"""How far beyond the library's end an angle is looked for [deg]."""
STEP_WINDOWS = 3
"""Fewest windows of the record before a step and after it."""
TARED, MOVED = "Was the sensor tared?", "Did the zero of"
"""How the questions about an offset and a step begin."""


def _each(x: float, z: float) -> Callable[[FloatArray], FloatArray]:
    return lambda forces: forces * np.array([[x], [z]])


SLIPS: dict[str, Callable[[FloatArray], FloatArray]] = {
    "Are Fx and Fz exchanged?": lambda forces: forces[::-1],
    "Is the sign of Fx turned? It points forward, as a force on the leg.": _each(-1.0, 1.0),
    "Is the sign of Fz turned? It points up, as a force on the leg.": _each(1.0, -1.0),
    "Are these the forces of the leg on the soil? Those on the leg are meant.": _each(-1.0, -1.0),
    "Does theta run backwards? It grows as the leg moves.": lambda forces: forces[:, ::-1],
    "Are the forces in pounds-force? Newtons are meant.": _each(4.4482216, 4.4482216),
    "Are the forces in kilograms-force? Newtons are meant.": _each(9.80665, 9.80665),
    "Are the forces in grams-force? Newtons are meant.": _each(9.80665e-3, 9.80665e-3),
    "Are the forces in kilonewtons? Newtons are meant.": _each(1e3, 1e3),
    "Are the forces in millinewtons? Newtons are meant.": _each(1e-3, 1e-3),
}
"""Question to what would set the record right; forces have shape [2, theta]."""


@dataclass(frozen=True)
class Explanation:
    """What would explain a record.

    Attributes
    ----------
    question
        Whether it was a slip, as a question; empty if none would explain it.
    beyond
        Which end of the library the angle seems to lie beyond, if one.
    """

    question: str = ""
    beyond: Literal["low", "high"] | None = None


def explain(data: FloatArray, curves: FloatArray, phi_deg: FloatArray) -> Explanation:
    """Try slips and angles beyond the library on a record.

    Parameters
    ----------
    data
        Observation vector [N], shape [2 theta].
    curves
        The library's at closely spaced angles, at the density of the soil [N], [k, 2 theta].
    phi_deg
        These friction angles, increasing [deg], shape [k].
    """
    as_is = float(_deviation(data, curves).min())
    beyond, end = min((_beyond(data, curves, phi_deg, end), end) for end in ("low", "high"))
    forces = data.reshape(2, -1)
    slips = []
    for question, right in SLIPS.items():
        deviations = _deviation(right(forces).ravel(), curves)
        # At an end of the library a slip explains nothing: more of it would do the same.
        if 0 < int(deviations.argmin()) < len(curves) - 1:
            slips.append((float(deviations.min()), question))
    slip, question = min(slips, default=(np.inf, ""))
    offset, tare = _offset(data, curves)
    left, step = _step(data, curves)
    if left <= min(CLOSE_OFFSET, BETTER * min(as_is, slip, beyond, offset)):
        return Explanation(question=step)
    # It has a number to fit, as an angle beyond the end has, and a slip has none.
    if offset <= min(CLOSE_OFFSET, BETTER * min(as_is, slip, beyond)):
        return Explanation(question=tare)
    if beyond <= min(slip, CLOSE_BEYOND, BETTER * as_is):
        return Explanation(beyond="low" if end == "low" else "high")
    if slip <= min(CLOSE, BETTER * as_is):
        return Explanation(question=question)
    return Explanation()


def _deviation(data: FloatArray, curves: FloatArray) -> FloatArray:
    """Root mean square deviation from each curve, of the data's peak-to-peak, the larger force's.

    Shapes [2 theta] and [k, 2 theta] -> [k].
    """
    measured, model = data.reshape(2, -1), curves.reshape(len(curves), 2, -1)
    root = np.sqrt(np.square(model - measured).mean(axis=2))
    worst: FloatArray = (root / np.maximum(np.ptp(measured, axis=1), 1e-300)).max(axis=1)
    return worst


def _offset(data: FloatArray, curves: FloatArray) -> tuple[float, str]:
    """Deviation from the best curve once the mean is taken from one force, and the question."""
    apart = data.reshape(2, -1) - curves.reshape(len(curves), 2, -1)
    spans, found = np.ptp(data.reshape(2, -1), axis=1), []
    for axis, name in enumerate(("Fx", "Fz")):
        sizes = apart[:, axis].mean(axis=1)
        left = apart.copy()
        left[:, axis] -= sizes[:, None]
        share = np.sqrt(np.square(left).mean(axis=2)) / np.maximum(spans, 1e-300)
        best = int(share.max(axis=1).argmin())
        inside = 0 < best < len(curves) - 1
        if inside and abs(sizes[best]) > OFFSET * spans[axis]:
            question = f"{TARED} A constant {sizes[best]:.2g} N of {name} would explain the record."
            found.append((float(share[best].max()), question))
    return min(found, default=(np.inf, ""))


def _step(data: FloatArray, curves: FloatArray) -> tuple[float, str]:
    """Deviation from the best curve once one force is shifted from a window on, and the question.

    For means over windows hide the noise that hides a step from who looks at readings.
    """
    apart = data.reshape(2, -1) - curves.reshape(len(curves), 2, -1)
    spans, count = np.maximum(np.ptp(data.reshape(2, -1), axis=1), 1e-300), apart.shape[2]
    squares, found = np.square(apart).sum(axis=2), []
    theta_deg = np.linspace(-WINDOW_DEG, WINDOW_DEG, count)
    for axis, name in enumerate(("Fx", "Fz")):
        sums = np.cumsum(apart[:, axis, ::-1], axis=1)[:, ::-1]
        sizes = sums / np.arange(count, 0, -1)
        left = np.sqrt(np.maximum(squares[:, axis, None] - sizes * sums, 0.0) / count)
        other = np.sqrt(squares[:, 1 - axis] / count) / spans[1 - axis]
        share = np.maximum(left / spans[axis], other[:, None])[:, STEP_WINDOWS:-STEP_WINDOWS]
        best, after = np.unravel_index(int(share.argmin()), share.shape)
        first = int(after) + STEP_WINDOWS
        size = float(sizes[best, first])
        if 0 < best < len(curves) - 1 and abs(size) > STEP * spans[axis]:
            at = 0.5 * (theta_deg[first - 1] + theta_deg[first])
            question = (
                f"{MOVED} {name} move? A step of {size:.2g} N at about {at:.0f}° would "
                "explain the record."
            )
            found.append((float(share[best, after]), question))
    return min(found, default=(np.inf, ""))


def _beyond(data: FloatArray, curves: FloatArray, phi_deg: FloatArray, end: str) -> float:
    """Deviation from the best curve beyond an end, were forces to go on growing as at that end."""
    at, sign = (0, -1.0) if end == "low" else (-1, 1.0)
    edge, inner = curves[at], curves[at + int(-sign)]
    slope = (edge - inner) / abs(phi_deg[at] - phi_deg[at + int(-sign)])
    further = np.linspace(0.0, FURTHEST_DEG, 61)[1:, None]
    return float(_deviation(data, edge + further * slope).min())
