"""One friction angle from several maneuvers in one soil: different rigs, plates and balls.

Each answer is a normal distribution. The table of terms has which of their errors two answers
share (:data:`~terraphi.inference.terms.TERMS`), so that the best mean is that of generalized least
squares. Where answers differ by more than their errors, Birge's ratio widens what each answer has
alone, because shared errors cancel in a difference. Far larger differences are a misfit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from statistics import NormalDist
from typing import Any, NamedTuple

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.bodies import OUTLINES
from terraphi.experiment.errors import InputError
from terraphi.experiment.rig import Rig
from terraphi.inference.answer import BY_LAW, Answer, Verdict, decimals, normal_density
from terraphi.inference.checks import UNUSUAL
from terraphi.inference.terms import TERMS, ordered_budget

CHANCE = 0.05
"""Largest share of sound sets of answers of which two differ so much that they are a misfit
[-]; it is divided by the number of pairs (Bonferroni)."""


class Errors(NamedTuple):
    """Errors of several answers."""

    sds: FloatArray
    """Standard deviation of φ by term [deg], shape [term, answer]."""
    shared: FloatArray
    """Correlation of each term between answers, shape [term, answer, answer]."""
    covariance: FloatArray
    """Covariance of the angles by which they are weighed [deg²], shape [answer, answer]."""
    alone: FloatArray
    """Variance of what no other answer shares [deg²], shape [answer]."""


def errors_of(answers: Sequence[Answer], names: Sequence[str]) -> Errors:
    """Errors of answers by terms, from their budgets and the table of terms."""
    k = len(answers)
    sds = np.array([[a.budget_deg.get(name, 0.0) for a in answers] for name in names])
    sds = sds.reshape(-1, k)
    rigs, laws = [answer.rigs[0] for answer in answers], [answer.law for answer in answers]
    keys = {"record": [*range(k)], "rig": rigs, "leg": [rig.leg for rig in rigs], "law": laws,
            "soil": [None] * k}  # fmt: skip
    shared = np.array(
        [[[first == other for other in keys[TERMS[name].key]] for first in keys[TERMS[name].key]]
         for name in names], float,
    ).reshape(-1, k, k)  # fmt: skip
    causes = [answer.offset_causes_deg for answer in answers]
    if "model: offset" in names:
        shared[names.index("model: offset")] = _correlation(causes, laws)
    # Covariances between answers are products of the terms' standard deviations where the error is
    # shared; the diagonal is each answer's whole variance.
    variance = np.array([answer.phi.sd**2 for answer in answers])
    between = sds[:, :, None] * sds[:, None] * (shared - np.eye(k))
    between *= np.array([TERMS[name].weighs for name in names], bool)[:, None, None]
    alone = variance - (np.square(sds) * between.any(axis=2)).sum(axis=0)
    return Errors(sds, shared, np.diag(variance) + between.sum(axis=0), np.maximum(alone, 0.0))


def _correlation(causes: Sequence[tuple[float, ...]], laws: Sequence[str]) -> FloatArray:
    """Correlation of the offset's errors of answers, shape [answer, answer].

    Answers by one law share the independent causes of that error, each with its own size. Where the
    causes are not known, the whole error is shared.
    """
    correlation = np.equal.outer(laws, laws).astype(float)
    for i, j in np.argwhere(correlation):
        if causes[i] and len(causes[i]) == len(causes[j]):
            # The errors are Σ aₖ ξₖ and Σ bₖ ξₖ, with causes ξ of unit variance.
            a, b = np.array(causes[i]), np.array(causes[j])
            correlation[i, j] = a @ b / math.sqrt(a @ a * (b @ b))
    return correlation


def combined(answers: Sequence[Answer]) -> Answer:
    """Friction angle of one soil by several answers.

    Parameters
    ----------
    answers
        Of the same soil at the same density, in one convention.

    Raises
    ------
    InputError
        If their conventions differ.
    LookupError
        If the table of terms lacks a term of an answer.
    """
    if len({answer.convention for answer in answers}) > 1:
        raise InputError("φ in different conventions has no common angle; leave out --law")
    names = [*dict.fromkeys(name for answer in answers for name in answer.budget_deg)]
    phi, errors = np.array([answer.phi.median for answer in answers]), errors_of(answers, names)
    # Generalized least squares of one angle: w = C⁻¹1 / (1'C⁻¹1), of variance w'Cw.
    inverse = np.linalg.inv(errors.covariance)
    # An answer that shares most of its error with a better one has the weight 0, not less.
    weight = np.maximum(inverse.sum(axis=1), 0.0)
    weight /= weight.sum()
    median = float(weight @ phi)
    deviation = phi - median
    # Birge's ratio √(χ² / (n − 1)): where answers differ by more than their errors, what no other
    # answer shares is widened by it.
    birge = math.sqrt(max(float(deviation @ inverse @ deviation) / (len(phi) - 1), 1.0))
    widening = math.sqrt((birge**2 - 1.0) * float(weight**2 @ errors.alone))
    # Variance of the mean by each term: Σᵢⱼ wᵢ σᵢ ρᵢⱼ σⱼ wⱼ.
    moved = weight * errors.sds
    variances = np.einsum("ti,tij,tj->t", moved, errors.shared, moved)
    # A term that does not weigh is each answer's in the covariance, and one error in the interval.
    joined = np.array([not TERMS[name].weighs for name in names]) * (
        variances - np.square(moved).sum(axis=1)
    )
    sd = math.sqrt(float(weight @ errors.covariance @ weight + joined.sum()) + widening**2)
    budget = dict(zip(names, np.sqrt(variances).tolist(), strict=True))
    if widening > 0.0:
        budget["disagreement"] = widening
    grid, density = normal_density(median, sd)
    verdict, reason = _verdict(answers, errors.covariance, decimals((median - sd, median + sd)),
                               is_widened=widening > 0.0)  # fmt: skip
    return _merged(
        answers,
        weight,
        verdict=verdict,
        reason=reason,
        budget_deg=ordered_budget(budget),
        grid_deg=grid,
        density=density,
    )


def _verdict(
    answers: Sequence[Answer], covariance: FloatArray, digits: int, *, is_widened: bool
) -> tuple[Verdict, str]:
    """Verdict and its reason: that of the first answer that is not sound, or their agreement."""
    for answer in answers:
        if answer.verdict != "consistent":
            head, _, reason = answer.reason.partition(": ")
            return answer.verdict, f"{head}: {_name(answer)}: {reason}"
    angles = ", ".join(
        f"{_name(answer)} {answer.phi.median:.{digits}f} ± {answer.phi.sd:.{max(digits, 1)}f}°"
        for answer in answers
    )
    phi, variance = np.array([answer.phi.median for answer in answers]), covariance.diagonal()
    # The difference of two answers has the variance Cᵢᵢ + Cⱼⱼ − 2 Cᵢⱼ.
    pairs = np.triu_indices(len(phi), 1)
    sd = np.sqrt((variance[:, None] + variance - 2.0 * covariance)[pairs])
    limit = NormalDist().inv_cdf(1.0 - 0.5 * CHANCE / sd.size)
    if (np.abs(phi[:, None] - phi)[pairs] / sd).max() > limit:
        check = "check sizes, density, moisture and whether the soil is the same"
        return "misfit", f"Misfit: {angles} disagree; {check}. Do not use the angle."
    return (
        "consistent",
        f"Consistent: {angles} agree{' within their errors' if is_widened else ''}.",
    )


def _merged(answers: Sequence[Answer], weight: FloatArray, **values: Any) -> Answer:
    """The first answer with other values, and the records, assumptions and warnings of all."""
    first = answers[0]
    # The errors of the records are joint within an answer only. The base has no SciPy.
    ends = np.cumsum([0, *(len(answer.covariance) for answer in answers)])
    covariance = np.zeros((ends[-1], ends[-1]))
    for answer, begin, end in zip(answers, ends[:-1], ends[1:], strict=True):
        covariance[begin:end, begin:end] = answer.covariance
    laws = dict.fromkeys(answer.law for answer in answers)
    frictions, cohesions = zip(*((a.leg_friction, a.cohesion_pa) for a in answers), strict=True)
    return replace(
        first,
        edge=next((answer.edge for answer in answers if answer.edge), None),
        law=", ".join(laws),
        law_reason=first.law_reason if len(laws) == 1 else "",
        second_opinion=None,
        phi_of_force_deg=_phi_of_force(answers, weight),
        phi_if_damp_deg=_joint_angle([a.phi_if_damp_deg for a in answers], weight),
        offset_causes_deg=_joint_causes(answers, weight),
        leg_friction=frictions[0] if len({*frictions}) == 1 else None,
        cohesion_pa=cohesions[0] if len({*cohesions}) == 1 else None,
        density_assumed=any(answer.density_assumed for answer in answers),
        records=tuple(record for answer in answers for record in answer.records),
        covariance=covariance,
        warnings=_warnings(answers),
        provenance={
            **{k: v for k, v in first.provenance.items() if k not in BY_LAW},
            **{
                name: [value for answer in answers for value in answer.provenance.get(name, ())]
                for name in ("gain", "noise")
                if name in first.provenance
            },
            "answers": [
                {"source": a.source, "median": a.phi.median, "sd": a.phi.sd, "weight": w}
                for a, w in zip(answers, weight.tolist(), strict=True)
            ],
        },
        **values,
    )


def _joint_causes(answers: Sequence[Answer], weight: FloatArray) -> tuple[float, ...]:
    """Causes of the error of the offset of answers by one law; empty of several laws."""
    causes = [answer.offset_causes_deg for answer in answers]
    if len({answer.law for answer in answers}) > 1 or len({*map(len, causes)}) > 1:
        return ()
    return tuple((weight @ np.array(causes)).tolist())


def _phi_of_force(answers: Sequence[Answer], weight: FloatArray) -> dict[str, float | None] | None:
    """φ by half and by twice the force [deg], answers whose force has a measured scale as is."""
    is_sound = all(answer.verdict == "consistent" for answer in answers)
    if not is_sound or not any(answer.phi_of_force_deg for answer in answers):
        return None
    scaled: dict[str, float | None] = {}
    for key in ("half", "twice"):
        angles = [(a.phi_of_force_deg or {key: a.phi.median})[key] for a in answers]
        scaled[key] = _joint_angle(angles, weight)
    return scaled


def _joint_angle(angles: Sequence[float | None], weight: FloatArray) -> float | None:
    """Weighted mean of angles [deg]; ``None`` if an answer has none."""
    return None if None in angles else float(weight @ np.array(angles, float))


def _warnings(answers: Sequence[Answer]) -> tuple[str, ...]:
    """Warnings of all answers, each once; those of one answer begin with its name."""
    density = np.array([answer.density_kg_m3 for answer in answers])
    sd = np.array([answer.density_sd_kg_m3 or 0.0 for answer in answers])
    of_all = set(answers[0].warnings).intersection(*(answer.warnings for answer in answers))
    sentences = []
    if np.ptp(density) > UNUSUAL * sd.max():
        ends = f"from {density.min():g} to {density.max():g} kg/m³, inverted as one soil"
        sentences.append(f"The records have densities {ends}: check that they are.")
    for answer in answers:
        sources = tuple(record.source for record in answer.records)
        sentences += [
            text if text in of_all or text.startswith(sources) else f"{_name(answer)}: {text}"
            for text in answer.warnings
        ]
    return tuple(dict.fromkeys(sentences))


def _name(answer: Answer) -> str:
    """The record of an answer, or the legs of several."""
    legs = dict.fromkeys(OUTLINES[rig.leg].label for rig in answer.rigs if isinstance(rig, Rig))
    several = len(answer.records) > 1 and legs
    return f"{', '.join(legs)} ({len(answer.records)} records)" if several else answer.source
