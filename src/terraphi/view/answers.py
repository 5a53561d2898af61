"""Tables of an inversion's answer, as ``answer.json`` has it: for a terminal and for a page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from terraphi.inference.answer import PHI, decimals, decimals_of_sd
from terraphi.view.table import Table

Answer = Mapping[str, Any]


def was_drawn(answer: Answer) -> bool:
    """Whether several parameters were inferred, from draws, and not φ alone by quadrature."""
    return "acceptance_fraction" in answer


def _inferred(answer: Answer) -> Mapping[str, Any]:
    """Parameters by their keys; the files of the first schema have φ alone."""
    found: Mapping[str, Any] = answer.get("parameters", {PHI: answer["phi_deg"]})
    return found


def names_of(answer: Answer) -> list[str]:
    """Parameters with their units, φ with its convention."""
    return [
        f"φ, {answer['phi_deg']['yield']} [deg]"
        if key == PHI
        else f"{one['name']} [{one['unit'] or '-'}]"
        for key, one in _inferred(answer).items()
    ]


def parameters(answer: Answer, title: str) -> Table:
    """Median and intervals of each parameter, and of the equivalent of φ in plane strain.

    Of drawn ones also the interval with all others known, R-hat and the number of effective draws.
    """
    drawn = was_drawn(answer)
    rows, digits = [], {}
    for name, (key, one) in zip(names_of(answer), _inferred(answer).items(), strict=True):
        row: tuple[str, ...] = ()
        digits[key] = decimals(one["ci68"])
        if drawn:
            known, sound = one["conditional"], one["convergence"]
            digits[key] = decimals_of_sd(min(one["sd"], known["sd"]))
            row = (
                between(known["ci68"], digits[key]),
                f"{sound['split_rhat']:.3f}",
                f"{sound['effective_sample_size']:.0f}",
            )
        rows.append((name, *_told(one, digits[key]), *row))
    equal = answer["phi_plane_strain_deg"]
    if equal and answer["phi_deg"]["yield"] != "plane_strain":
        name = "φ, equivalent in plane strain [deg]"
        rows.append((name, *_told(equal, digits[PHI]), *(["-"] * 3 if drawn else [])))
    more = ("68 %, others known", "R-hat", "effective draws") if drawn else ()
    return Table(title, ("", "median", "68 %", "95 %", *more), rows)


def expected(answer: Answer) -> Table:
    """What each leg alone, and all together, would leave of every parameter."""
    rows = [
        ("all" if leg == "all" else f"leg {leg} alone", *(f"{sd:.3g}" for sd in by.values()))
        for leg, by in answer["expected_sd"].items()
    ]
    return Table("", ("expected standard deviation", *names_of(answer)), rows)


def between(ends: Sequence[float], digits: int) -> str:
    """An interval."""
    return f"{ends[0]:.{digits}f} to {ends[1]:.{digits}f}"


def _told(one: Mapping[str, Any], digits: int) -> list[str]:
    """Median and both intervals."""
    ends = (between(one[level], digits) for level in ("ci68", "ci95"))
    return [f"{one['median']:.{digits}f}", *ends]
