"""The verdict of the calibrated likelihood, in words."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from terraphi.inference.explanation import Explanation
from terraphi.inference.fit import LARGEST_ODDS, SMALLEST_PROBABILITY, Fit
from terraphi.inference.hypotheses import AMPLITUDES
from terraphi.inference.information import information_gain_bits
from terraphi.inference.posterior import Posterior
from terraphi.inference.verdict import Verdict

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
        question = f" {explanation.question}" if explanation.question else ""
        return Verdict("misfit", None, f"No friction angle fits: {clause}{reach}.{question}")
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
