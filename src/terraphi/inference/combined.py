"""One friction angle from several maneuvers in one soil: different rigs, plates and balls.

Each answer is a normal distribution. Answers share the error of the density and what the soil does
that no law has, those of one law what is wrong with it, and all what is not known of moisture, so
that the best mean is that of generalized least squares. Where answers disagree by more than their
errors, Birge's ratio widens what is each one's own, for what they share cancels in their
difference. Far more is a misfit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from terraphi.experiment.arrays import BoolArray, FloatArray
from terraphi.experiment.errors import InputError
from terraphi.experiment.rig import LEG_NAMES, Rig
from terraphi.inference.answer import Answer, Estimate, RecordFit, Verdict, decimals
from terraphi.inference.checks import densities
from terraphi.laws.store import PHI

OF_SOIL = ("density", "model: soil")
"""Terms that all answers share."""
OF_LAW = ("model: law", "model: apparatus", "model: compaction", "surface friction", "rectangle",
          "gain", "leg friction")  # fmt: skip
"""Terms that answers by one law share; legs have one sensor and one surface."""
OF_LEG = ("model: offset",)
"""Terms that answers of one shape of leg share."""
DISAGREE = 1.96
"""Standard deviations of the difference of two answers above which they are a misfit [-]: one sound
pair in twenty, and fewer in grains, whose intervals hold more than they claim."""
STEP_DEG = 0.05


def combined(answers: Sequence[Answer]) -> Answer:
    """The angle of one soil that several answers are of.

    Parameters
    ----------
    answers
        Of the same soil at the same density, in plane strain; errors of their records are
        independent but for the density and the law.

    Raises
    ------
    InputError
        If an answer is in another convention.
    """
    if any(one.convention != "plane_strain" or PHI not in one.parameters for one in answers):
        raise InputError("answers that are joined are of φ in plane strain; leave out --law")
    phi = np.array([one.phi.median for one in answers])
    terms: dict[str, FloatArray] = {
        name: np.array([one.budget_deg.get(name, 0.0) for one in answers])
        for name in dict.fromkeys(name for one in answers for name in one.budget_deg)
    }
    laws = np.array([one.law for one in answers])
    legs = np.array([getattr(one.records[0].rig, "leg", one.source) for one in answers])
    one_law, one_leg = (each[:, None] == each for each in (laws, legs))
    one_soil = np.ones((len(phi),) * 2, dtype=bool)
    # What is shared goes off the diagonal, and is not what an answer has of its own.
    own = np.array([one.phi.sd**2 for one in answers])
    covariance = np.diag(own)
    same: dict[str, BoolArray] = {}
    for names, shared in ((OF_LAW, one_law), (OF_LEG, one_leg), (OF_SOIL, one_soil)):
        for name in names:
            if name in terms:
                same[name] = shared
                share = np.outer(terms[name], terms[name]) * shared
                covariance += share - np.diag(np.diag(share))
                own -= np.square(terms[name]) * (shared.sum(axis=1) > 1)
    inverse = np.linalg.inv(covariance)
    # An answer that shares most of its error with a better one is worth nothing, not less.
    weight = np.maximum(inverse.sum(axis=1), 0.0)
    weight /= weight.sum()
    median = float(weight @ phi)
    apart = phi - median
    birge = math.sqrt(max(float(apart @ inverse @ apart) / (len(phi) - 1), 1.0))
    wider = math.sqrt((birge**2 - 1.0) * float(weight**2 @ np.maximum(own, 0.0)))
    # All are too high in soil that is damper than it is taken for, but not by the same share, so
    # that in weights and differences it counts as each one's own; in the interval it is one.
    same["cohesion"] = one_soil
    moist = weight * terms.get("cohesion", 0.0)
    squares = float(weight @ covariance @ weight + moist.sum() ** 2 - np.square(moist).sum())
    sd = math.hypot(math.sqrt(squares), wider)
    budget = {
        name: math.sqrt(float((weight * each) @ same.get(name, np.eye(len(phi))) @ (weight * each)))
        for name, each in terms.items()
    }
    if wider > 0.0:
        budget["disagreement"] = wider
    digits = decimals((median - sd, median + sd))
    named = list(zip(map(_name, answers), answers, strict=True))
    read = [f"{name} {one.phi.median:.{digits}f} ± {one.phi.sd:.1f}°" for name, one in named]
    verdict: Verdict = "consistent"
    within = " within their errors" if wider > 0.0 else ""
    reason = f"Consistent: {', '.join(read)} agree{within}."
    variance = np.diag(covariance)
    pairs = np.triu_indices(len(phi), 1)
    differ = np.sqrt((variance[:, None] + variance - 2.0 * covariance)[pairs])
    spread = np.abs(phi[:, None] - phi)[pairs] / differ
    if worse := [(name, one) for name, one in named if one.verdict != "consistent"]:
        [(name, one), *_] = worse
        head, _, rest = one.reason.partition(": ")
        verdict, reason = one.verdict, f"{head}: {name}: {rest}"
    elif spread.max() > DISAGREE:
        verdict = "misfit"
        reason = (
            f"Misfit: {', '.join(read)} disagree; check sizes, density and moisture, and whether "
            "the soil is the same. Do not use the angle."
        )
    grid = np.arange(max(median - 6.0 * sd, 0.5), min(median + 6.0 * sd, 85.0), STEP_DEG)
    density = np.exp(-0.5 * ((grid - median) / sd) ** 2)
    density /= np.trapezoid(density, grid)
    estimate = Estimate.of_density(grid, density)
    first = answers[0]
    density_kg_m3 = np.array([one.density_kg_m3 for one in answers])
    density_sd = np.array([one.density_sd_kg_m3 or 0.0 for one in answers])
    frictions = {one.leg_friction for one in answers}
    cohesions = {one.cohesion_pa for one in answers}
    # What is said of all is said once.
    alike = set(first.warnings).intersection(*(one.warnings for one in answers))
    warnings = [
        text if text in alike or text.startswith(tuple(r.source for r in one.records))
        else f"{name}: {text}" for name, one in named for text in one.warnings
    ]  # fmt: skip
    # Each answer's errors are its own.
    records: list[RecordFit] = []
    ends = np.cumsum([0, *(len(one.covariance) for one in answers)])
    joint = np.zeros((ends[-1], ends[-1]))
    scaled: dict[str, float | None] | None = None
    if any(answer.phi_of_force_deg for answer in answers):
        # Where the force's scale was measured, it is right.
        scaled = {}
        for key in ("half", "twice"):
            angles = [(a.phi_of_force_deg or {key: a.phi.median})[key] for a in answers]
            scaled[key] = None if None in angles else float(weight @ np.array(angles, float))
    for one, start, end in zip(answers, ends[:-1], ends[1:], strict=True):
        joint[start:end, start:end] = one.covariance
        records += one.records
    return replace(
        first,
        parameters={PHI: estimate},
        phi_plane_strain=estimate,
        verdict=verdict,
        reason=reason,
        edge=next((one.edge for one in answers if one.edge), None),
        law=", ".join(dict.fromkeys(one.law for one in answers)),
        law_reason=first.law_reason if one_law.all() else "",
        second_opinion=None,
        phi_of_force_deg=scaled,
        leg_friction=first.leg_friction if len(frictions) == 1 else None,
        cohesion_pa=first.cohesion_pa if len(cohesions) == 1 else None,
        budget_deg=dict(sorted(budget.items(), key=lambda term: -term[1])),
        density_assumed=any(one.density_assumed for one in answers),
        records=tuple(records),
        covariance=joint,
        grid_deg=grid,
        density=density,
        warnings=tuple(dict.fromkeys([*densities(density_kg_m3, density_sd), *warnings])),
        provenance={
            **first.provenance,
            **{
                name: [value for one in answers for value in one.provenance.get(name, ())]
                for name in ("gain", "noise")
                if name in first.provenance
            },
            "answers": [
                {"source": one.source, "median": one.phi.median, "sd": one.phi.sd, "weight": w}
                for one, w in zip(answers, weight.tolist(), strict=True)
            ],
        },
    )


def _name(answer: Answer) -> str:
    """The record of an answer, or the legs of several."""
    legs = dict.fromkeys(LEG_NAMES[rig.leg] for rig in answer.rigs if isinstance(rig, Rig))
    several = len(answer.records) > 1 and legs
    return f"{', '.join(legs)} ({len(answer.records)} records)" if several else answer.source
