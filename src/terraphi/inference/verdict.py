"""Whether an inferred friction angle may be believed: a first, numerical rule.

An inversion always returns an angle. It means little if the model cannot reproduce the forces at
any angle, or if the angle lies beyond those the library holds and the posterior piles up at an
edge; the verdict says so instead of letting the edge pass for an answer.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from terraphi.inference.explanation import Explanation
from terraphi.inference.posterior import Posterior
from terraphi.inference.residual import peak_to_peak

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
        question = f" {explained.question}" if explained.question else ""
        return Verdict("misfit", None, f"No friction angle fits: {misfit}.{question}")
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
