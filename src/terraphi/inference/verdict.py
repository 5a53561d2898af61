"""Whether what was inferred may be believed: one rule, for one history or several.

An inversion always returns an angle. It means little if the model cannot reproduce the forces at
any angle, or if the angle lies beyond those the library holds and the posterior piles up at an
edge; the verdict says so instead of letting the edge pass for an answer.

What counts as a fit and as an edge depends on the likelihood: the paper's has a largest deviation
and a largest mass near an edge; the calibrated one tests of fit (`fit`) and the density at an edge;
that of several parameters the deviation and the density at the edges of what was learnt.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from terraphi.inference.budget import information_gain_bits
from terraphi.inference.findings import Doubt, Measure, Side, Verdict
from terraphi.inference.fit import LARGEST_ODDS, SMALLEST_PROBABILITY, Fit
from terraphi.inference.paper_likelihood import peak_to_peak
from terraphi.inference.posterior import Posterior

NRMSD_LIMIT = 0.10
"""Largest deviation of a force that is accepted without a test of fit, of peak-to-peak [-]."""
EDGE_MASS = 0.05
"""Largest mass within half a library step of an edge that is accepted [-]."""
EDGE_DENSITY = float(np.exp(-2.0))
"""Density at an edge, over the largest, above which the posterior is cut off: that of a normal
distribution two standard deviations from its mean [-]."""
AT_EDGE = 0.9
"""The same, above which the posterior counts as being at the edge, and a misfit as its sign [-]."""
UNINFORMED_BITS = 0.1
"""Information below which a posterior is hardly the forces' doing: a range smaller by 7 % has that
much."""


@dataclass(frozen=True)
class Edge:
    """The edge at which most of a posterior lies.

    Attributes
    ----------
    side
        Which.
    size
        Mass near it, or the density at it over the largest [-].
    limit, limit_of_misfit
        Above which it cuts the posterior off, and the same if nothing in the library fits [-].
    code
        Of the measure that ``size`` is.
    numbers
        What sentences need: ``at``, ``unit``, and ``name`` of the parameter or its convention.
    """

    side: Side
    size: float
    limit: float
    limit_of_misfit: float
    code: str
    numbers: Mapping[str, Any] = field(default_factory=dict)


def judge(
    fit: Sequence[Measure],
    edge: Edge | None,
    *,
    kind: str,
    beyond: Side | None = None,
    numbers: Mapping[str, Any] | None = None,
) -> Verdict:
    """Judge an inversion by how well the model fits and by where its posterior lies.

    Out of range if an edge cuts the posterior off and the forces fit, or would fit at an angle
    beyond it. Else a misfit if any measure of the fit is exceeded: a wider library would not help.
    Else consistent.

    Parameters
    ----------
    fit
        How well the forces fit, of every history.
    edge
        Where most of the posterior lies; ``None``: nothing was learnt that an edge could cut off.
    kind
        ``calibrated``, ``soil``, ``paper`` or ``parameters``: what is meant by a fit.
    beyond
        End of the library beyond which an angle would explain forces that do not fit.
    numbers
        What else its sentence needs.
    """
    misfit = any(measure.exceeded for measure in fit)
    told: dict[str, Any] = dict(numbers or {})
    measures = list(fit)
    cut = False
    if edge is not None:
        told |= {"side": edge.side, **edge.numbers}
        limit = edge.limit_of_misfit if misfit else edge.limit
        of = str(edge.numbers.get("name", "")) if kind == "parameters" else ""
        measures.append(Measure(edge.code, edge.size, most=limit, about=edge.side, source=of))
        cut = edge.size > limit
        if cut and (not misfit or beyond == edge.side):
            code = "beyond" if misfit else "parameter_edge" if kind == "parameters" else "edge"
            return Verdict("out_of_range", edge.side, code, told, tuple(measures))
    alone = {"agreement": "disagreement", "prior_agreement": "against_prior"}
    exceeded = {measure.code for measure in fit if measure.exceeded}
    if len(exceeded) == 1 and exceeded <= alone.keys():
        return Verdict("misfit", None, alone[exceeded.pop()], told, tuple(measures))
    if misfit:
        reaches = edge is not None and edge.size > edge.limit
        code = f"{kind}_misfit_at_edge" if reaches else f"{kind}_misfit"
        return Verdict("misfit", None, code, told, tuple(measures))
    return Verdict("consistent", None, f"{kind}_consistent", told, tuple(measures))


def damaged(verdict: Verdict) -> Verdict:
    """The verdict on a record that is damaged: a misfit, whatever else."""
    return Verdict("misfit", None, "damaged", verdict.numbers, verdict.measures)


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
    """
    spans = peak_to_peak(data)
    measured, predicted = (np.asarray(v, dtype=np.float64) for v in (data, model))
    deviations = np.sqrt(np.mean(np.square(measured - predicted).reshape(2, -1), axis=1))
    return {name: float(rms) / spans[name] for name, rms in zip(spans, deviations, strict=True)}


def deviations(
    residual_nrmsd: Mapping[str, float], *, most: float | None = None, source: str = ""
) -> list[Measure]:
    """Measures of a fit from the deviations by `nrmsd`, with a limit or none."""
    return [
        Measure("nrmsd", residual_nrmsd[force], most=most, about=force, source=source)
        for force in ("Fx", "Fz")
    ]


def fit_measures(fit: Fit, *, source: str = "") -> list[Measure]:
    """Measures of a fit from the tests of the calibrated likelihood."""
    limit = float(np.log10(LARGEST_ODDS))
    return [
        Measure("chi2_per_freedom", fit.chi2 / fit.freedom, source=source),
        Measure("probability", fit.probability, least=SMALLEST_PROBABILITY, source=source),
        Measure("log10_odds", fit.log10_odds, most=limit, source=source),
        Measure("amplitude", fit.amplitude, source=source),
    ]


def edge_of(
    sizes: tuple[float, float],
    bounds: tuple[float, float],
    code: str,
    *,
    name: str,
    unit: str = "°",
) -> Edge:
    """The edge where more of a posterior lies.

    Parameters
    ----------
    sizes
        What there is of it at the lower and the upper one [-].
    bounds
        Where these are, in the parameter's unit.
    code
        What ``sizes`` are: ``edge_mass``, by the rule for the paper, or ``edge_density``.
    name, unit
        Of the parameter, or what the friction angle means.
    """
    limits = (EDGE_MASS, EDGE_MASS) if code == "edge_mass" else (EDGE_DENSITY, AT_EDGE)
    side: Side = "low" if sizes[0] >= sizes[1] else "high"
    numbers = {"at": bounds[0 if side == "low" else 1], "unit": unit, "name": name}
    return Edge(side, max(sizes), *limits, code, numbers)


def edge_masses(posterior: Posterior, step_deg: float) -> tuple[float, float]:
    """Mass within half a step of the library [deg] of the lower and the upper edge [-]."""
    (low, high), margin = posterior.bounds_deg, step_deg / 2.0
    return posterior.mass(low, low + margin), posterior.mass(high - margin, high)


def edge_densities(posterior: Posterior) -> tuple[float, float]:
    """Density at the lower and the upper edge, over the largest [-]."""
    top = float(posterior.density.max())
    return float(posterior.density[0]) / top, float(posterior.density[-1]) / top


def uninformed(posterior: Posterior) -> list[Doubt]:
    """A doubt if the forces left the friction angle about as unknown as the library has it.

    Parameters
    ----------
    posterior
        Posterior under a uniform prior.
    """
    gain = information_gain_bits(posterior)
    if gain >= UNINFORMED_BITS:
        return []
    return [Doubt("uninformed", {"bits": gain, "limit": UNINFORMED_BITS})]
