"""Codes of verdicts and doubts as sentences, each written here and nowhere else."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from terraphi.inference.calibrated import AMPLITUDES
from terraphi.inference.findings import Doubt, Measure, Verdict

VERDICTS = {
    "calibrated_consistent": (
        "Scatter and noise explain what the model leaves of the forces, and no edge of the library "
        "cuts the posterior off."
    ),
    "soil_consistent": (
        "The forces deviate from the model as those of real soils do, or less, and no edge of the "
        "library cuts the posterior off."
    ),
    "paper_consistent": (
        "The model deviates from the forces by no more than the limit, and no edge of the library "
        "cuts the posterior off."
    ),
    "parameters_consistent": (
        "No history deviates from the best curve by more than it may, and no edge of the priors "
        "cuts off what was learnt."
    ),
    "calibrated_misfit": (
        "No friction angle fits: the model deviates from the forces by more than scatter and noise "
        "explain."
    ),
    "calibrated_misfit_at_edge": (
        "No friction angle fits within scatter and noise; the posterior reaches the {edge}."
    ),
    "soil_misfit": (
        "Unlike known soils: {force} is off by {percent:+.0f} % of its range at {low:.0f} to "
        "{high:.0f}°. Do not use the angle."
    ),
    "soil_misfit_at_edge": (
        "Unlike known soils: {force} is off by {percent:+.0f} % at {low:.0f} to {high:.0f}°; the "
        "posterior reaches the {edge}."
    ),
    "paper_misfit": (
        "No friction angle fits: the model deviates from the forces by more than the limit."
    ),
    "paper_misfit_at_edge": "No friction angle fits; the posterior reaches the {edge}.",
    "parameters_misfit": (
        "No parameters fit: {worst} deviates by more than it may. Do not use them: their intervals "
        "do not allow for that."
    ),
    "parameters_misfit_at_edge": (
        "No parameters fit: {worst} deviates by more than it may. Do not use them; the posterior "
        "reaches the {edge}."
    ),
    "disagreement": (
        "No one friction angle fits all histories, though one fits each: they are not of one soil, "
        "or not as they were told."
    ),
    "against_prior": (
        "The forces and the prior of the friction angle exclude each other: one of them is wrong."
    ),
    "damaged": "A record is damaged. No angle is to be believed.",
    "edge": (
        "Too much of the posterior lies at the {edge}, so the friction angle may lie {beyond} it."
    ),
    "beyond": (
        "No curve of the library fits, but one beyond its {edge} would: the friction angle may lie "
        "{beyond} it."
    ),
    "parameter_edge": "The posterior is cut off by the {edge}; the true value may lie {beyond} it.",
}
"""Sentence of each verdict, of at most 25 words; its numbers stand in a table of the measures."""

MEASURES = {
    "chi2_per_freedom": "chi-square over its degrees of freedom",
    "probability": "probability of a residual as large",
    "log10_odds": "odds of a model discrepancy",
    "amplitude": "discrepancy, if there is one, of peak-to-peak",
    "soil_deviation": "deviation, as a multiple of that of known soils",
    "agreement": "probability that histories of one angle differ as much",
    "prior_agreement": "probability that forces and prior of one angle differ as much",
    "nrmsd": "deviation of the best curve, of peak-to-peak",
    "edge_mass": "posterior mass near the edge",
    "edge_density": "posterior density at the edge, of its peak",
}
"""Name of each measure."""

DOUBTS = {
    "exchanged": "Are Fx and Fz exchanged?",
    "turned_Fx": "Is the sign of Fx turned? It points forward, as a force on the leg.",
    "turned_Fz": "Is the sign of Fz turned? It points up, as a force on the leg.",
    "on_the_soil": "Are these the forces of the leg on the soil? Those on the leg are meant.",
    "backwards": "Does theta run backwards? It grows as the leg moves.",
    "pounds_force": (
        "Are the forces in pounds-force, or kilograms-force, or is the density wrong? Newtons and "
        "kg/m³ are meant."
    ),
    "kilograms_force": (
        "Are the forces in kilograms-force, or pounds-force, or is the density wrong? Newtons and "
        "kg/m³ are meant."
    ),
    "assumed_density": (
        "Is the density right? {used:g} kg/m³ is assumed; with another the forces would be like "
        "those of known soils: give --density."
    ),
    "grams_force": "Are the forces in grams-force? Newtons are meant.",
    "kilonewtons": "Are the forces in kilonewtons? Newtons are meant.",
    "millinewtons": "Are the forces in millinewtons? Newtons are meant.",
    "tared": (
        "Was the sensor tared? A constant {size_N:.2g} N of {force} would explain the record."
    ),
    "moved": (
        "Did the zero of {force} move? A step of {size_N:.2g} N at about {theta_deg:.0f}° would "
        "explain the record."
    ),
    "zero_unseen": (
        "Was the sensor tared? An offset of {size_N:.2g} N of {force} would hardly show, and move "
        "φ by {moves_deg:.2g}°; readings in air show it."
    ),
    "saturated": (
        "Was the sensor saturated? {force} cut off at {size_N:.3g} N would explain the record."
    ),
    "height": (
        "The leg meets the soil at {theta_deg:.0f}°, as if its hip were {size_mm:.0f} mm {way} "
        "than in known records: check the leg, that height and the zero of theta. A millimetre "
        "is worth up to 1° of φ."
    ),
    "unlike": (
        "The history was not simulated as the library was (the library's in brackets): "
        "{differences}; so the angle found may differ from the one that it was simulated with."
    ),
    "too_large": (
        "The largest mean force, {peak_N:.3g} N, is {ratio:.3g} times that of the library's "
        "largest curve: are the forces in newtons?"
    ),
    "too_small": (
        "The largest mean force, {peak_N:.3g} N, is {ratio:.3g} times smaller than that of "
        "the library's smallest curve: are the forces in newtons?"
    ),
    "runs_against": (
        "{force} runs against the library's ({correlation:.2f} correlation): is its sign right? Fx "
        "points forward and Fz up, as forces on the leg."
    ),
    "other_density": (
        "The history was {made} a density of {own:g} kg/m³ and is inverted with {used:g} kg/m³."
    ),
    "uninformed": (
        "These forces hardly tell φ: they add {bits:.2f} bits to a uniform prior "
        "over the angles looked at (limit {limit:g}), so that the median is not theirs."
    ),
    "unusual": (
        "Hardly any dry soil has a friction angle of {median:.1f}° in plane strain ({low:g} to "
        "{high:g}° is usual): check the density, the unit of the forces and the leg."
    ),
    "with_others": (
        "Inferred with other parameters, φ leaves out how real soils deviate from the model and "
        "may be far off: fix them, the density by --density."
    ),
    "tries_others": "Library '{name}' is shipped to try others, not to invert with.",
    "caveat": "Library {name}: {caveat}",
    "refined_in_part": (
        "Library {name} is refined, but of {cause} nothing is taken out: no finer case tells of it."
    ),
    "refined_without_soils": (
        "Library {name}, refined, does not know how real soils deviate from it: the interval "
        "leaves that out and is too narrow."
    ),
    "intervals_do_not_hold": (
        "Library {name}: its 95 % intervals hold {held:.0%} of simulated truths on leg {leg}; do "
        "not believe them. Replicates, or more friction angles, would help."
    ),
    "read_twice": (
        "It is read at other angles than another history of leg {leg}, more than {spacing_deg:g}° "
        "apart: the angle found may be off by some tenths of a degree."
    ),
    "not_converged": "The draws have not converged: do not use them.",
    **dict.fromkeys(
        ("dropout", "held", "spike", "clipped"), "{readings} left out: {what} {where}."
    ),
    **dict.fromkeys(("step",), "{force} shows {what}: {size_N:.2g} N {where}. Mend the record."),
    "offset": (
        "{force} shows {what}: {size_N:.2g} N {where}. Mend the record; or is the leg another?"
    ),
    "two_soils": (
        "Of these histories {worst} fits worst: are they of two soils? Invert each by itself."
    ),
    "known_soil": (
        "How real soils deviate was learnt from {medium} too, which flatters this verdict: "
        "'terraphi study real_soil' leaves it out."
    ),
}
"""Sentence of each doubt."""
DEFECTS = {
    "dropout": "readings of zero under load",
    "held": "held values",
    "spike": "spikes",
    "clipped": "a flat top at the largest force, as of a saturated sensor",
    "step": "a step, after which the zero is another",
    "offset": "a force on the leg in air",
}
"""What each defect of a record is."""
TOLD = 4
"""Differences of scenarios that are named."""


def of_verdict(verdict: Verdict) -> str:
    """A verdict as a sentence."""
    numbers = dict(verdict.numbers)
    low = numbers.get("side") == "low"
    if "at" in numbers:
        at, unit, name = (numbers[key] for key in ("at", "unit", "name"))
        if verdict.code.startswith("parameter"):
            numbers["edge"] = f"edge of {name} at {at:g} {unit}".rstrip()
        else:
            of = f" ({name})" if name else ""
            edge = f"{'lower' if low else 'upper'} edge"
            whose = "" if verdict.code == "beyond" else f"of the {numbers.get('of', 'library')} "
            numbers["edge"] = f"{edge} {whose}at"
            numbers["edge"] += f" {at:g}{'' if unit == '°' else ' '}{unit}{of}"
    numbers["beyond"] = "below" if low else "above"
    return VERDICTS[verdict.code].format(**numbers)


def of_doubt(doubt: Doubt) -> str:
    """A doubt as a sentence, or two; begins with its history, where there are several."""
    numbers = dict(doubt.numbers)
    if doubt.code in DEFECTS:
        numbers |= _of_defect(doubt.code, numbers)
    if doubt.code == "unlike":
        numbers["differences"] = _listed(numbers["differences"])
    said = DOUBTS[doubt.code].format(**numbers)
    return f"{doubt.source}: {said}" if doubt.source else said


def reason(verdict: Verdict, doubts: Sequence[Doubt]) -> str:
    """The verdict with all doubts, as a text."""
    return " ".join([of_verdict(verdict), *map(of_doubt, doubts)])


def rows_of(measures: Sequence[Measure]) -> list[tuple[str, str, str]]:
    """Name, value and limit of each measure, for a table."""
    rows = []
    for one in measures:
        name = MEASURES[one.code]
        about = {"low": "lower", "high": "upper"}.get(one.about, one.about)
        names = [name.replace("the edge", f"the {about} edge") if about != one.about else name]
        names += [about] if about and about == one.about else []
        limit = "-"
        if one.most is not None:
            limit = f"at most {_number(one.code, one.most)}"
        elif one.least is not None:
            limit = f"at least {_number(one.code, one.least)}"
        rows.append(
            (", ".join([*names, *filter(None, [one.source])]), _number(one.code, one.value), limit)
        )
    return rows


def _number(code: str, value: float) -> str:
    """A measure with the digits that it deserves."""
    if code == "log10_odds":
        return odds(value)
    if code == "amplitude":
        # The largest that was tried stands for all beyond it.
        more = " or more" if value >= AMPLITUDES[-1] else ""
        return f"{100.0 * value:.2g} %{more}"
    if code in ("probability", "agreement", "prior_agreement"):
        return f"{value:.2g}"
    if code in ("chi2_per_freedom", "soil_deviation"):
        return f"{value:.1f}"
    return f"{100.0 * value:.1f} %"


def odds(log10_odds: float) -> str:
    """Odds as people say them."""
    if log10_odds > 4.0:
        return f"1e{log10_odds:.0f}:1"
    if log10_odds >= 0.0:
        return f"{10.0**log10_odds:.0f}:1"
    return f"1:{10.0 ** min(-log10_odds, 6.0):.0f}"


def _of_defect(code: str, numbers: Mapping[str, Any]) -> dict[str, str]:
    """What the sentence of a defect is made of."""
    low, high = numbers["theta_deg"]
    where = f"between {low:.1f} and {high:.1f}°" if high > low else f"at {low:.1f}°"
    rows, force = numbers["rows"], numbers["force"]
    what = DEFECTS[code]
    if numbers["size_N"] is None and force != "both":
        what = f"{what} of {force}"
    return {
        "readings": "1 reading" if rows == 1 else f"{rows} readings",
        "what": what,
        "where": where,
    }


def _listed(differences: Sequence[tuple[str, Any, Any]]) -> str:
    """Keys in which a history differs from a library, with both values."""
    told = [f"{key} = {_word(own)} ({_word(other)})" for key, own, other in differences[:TOLD]]
    if len(differences) > TOLD:
        told.append(f"{len(differences) - TOLD} more")
    return told[0] if len(told) == 1 else f"{', '.join(told[:-1])} and {told[-1]}"


def _word(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
