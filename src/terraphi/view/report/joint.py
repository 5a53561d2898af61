"""The report of a joint inversion: several histories, or several parameters."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from terraphi.experiment.errors import InputError
from terraphi.view.report.inversion import STATUS, measures
from terraphi.view.report.parts import Part, Section, Table, Text, number
from terraphi.view.report.study import pictures

UNCHECKED = "consistent; nobody has checked how often joint intervals hold the truth"
PICTURES = "Fits, and the corner plot of the posterior"


def is_joint(answer: Path) -> bool:
    """Whether an ``answer.json`` is one of several histories or parameters."""
    try:
        return bool(json.loads(answer.read_text(encoding="utf-8"))["likelihood"] == "joint")
    except (OSError, ValueError, KeyError, TypeError):
        return False


def section(path: Path) -> Section:
    """Report of a joint inversion.

    Parameters
    ----------
    path
        Folder, or ``answer.json``.

    Returns
    -------
    Section

    Raises
    ------
    InputError
        If the answer cannot be read.
    """
    folder = path if path.is_dir() else path.parent
    file = folder / "answer.json" if path.is_dir() else path
    try:
        answer = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{file}: not an answer as 'terraphi invert --out' writes it") from error
    parts: list[Part] = [
        _parameters(answer),
        *measures(answer),
        Text("What the forces fix", tuple(map(str, answer["identifiability"]["sentences"]))),
        *_expected(answer),
        _histories(answer),
        *pictures(folder, PICTURES, folded=False),
    ]
    about = {key: answer[key] for key in ("library", "likelihood", "sampler", "seed", "fixed")}
    status = STATUS.get(str(answer["verdict"]), "none")
    sound = status == "good"
    return Section(
        kind="joint inversion",
        title=", ".join(str(history["source"]) for history in answer["histories"]) or path.name,
        headline=_headline(answer),
        reason=str(answer["reason"]),
        status="doubtful" if sound else status,
        badge=UNCHECKED if sound else "",
        parts=parts,
        provenance={"result": path.name, **about, **answer.get("provenance", {})},
    )


def _headline(answer: Mapping[str, Any]) -> str:
    """All parameters with their 68 % intervals, and the verdict."""
    found = [
        f"{name} = {number(one['median'])} (68 %: {_range(one['ci68'])})"
        for name, one in zip(_names(answer), answer["parameters"].values(), strict=True)
    ]
    return f"{'; '.join(found)}. Verdict: {str(answer['verdict']).replace('_', ' ')}."


def _names(answer: Mapping[str, Any]) -> list[str]:
    """Names with units, φ with its convention."""
    convention = (answer["phi_deg"] or {}).get("yield", "")
    found = []
    for one in answer["parameters"].values():
        name = f"φ, {convention}" if one["name"] == "φ" else str(one["name"])
        found.append(f"{name} [{one['unit'] or '-'}]")
    return found


def _range(ends: Any) -> str:
    return f"{number(ends[0], 5)} to {number(ends[1], 5)}"


def _parameters(answer: Mapping[str, Any]) -> Table:
    rows = [
        (
            name,
            number(one["median"], 5),
            _range(one["ci68"]),
            _range(one["ci95"]),
            _range(one["conditional"]["ci68"]),
            f"{one['convergence']['split_rhat']:.3f}",
            f"{one['convergence']['effective_sample_size']:.0f}",
        )
        for name, one in zip(_names(answer), answer["parameters"].values(), strict=True)
    ]
    header = ("", "median", "68 %", "95 %", "68 %, others known", "R-hat", "effective draws")
    note = "" if answer["converged"] else "The draws have not converged: do not use them."
    return Table("Parameters", header, rows, note, wide=True)


def _expected(answer: Mapping[str, Any]) -> list[Part]:
    """What each leg alone would leave of every parameter, if there are several."""
    expected = answer["expected_sd"]
    if len(expected) < 3:
        return []
    rows = [
        ("all" if leg == "all" else f"leg {leg} alone", *(number(sd, 3) for sd in by.values()))
        for leg, by in expected.items()
    ]
    header = ("", *_names(answer))
    return [Table("Expected standard deviations", header, rows, wide=True)]


def _histories(answer: Mapping[str, Any]) -> Table:
    rows = [
        (str(h["source"]), str(h["leg"]), f"{h['nrmsd']['Fx']:.1%}", f"{h['nrmsd']['Fz']:.1%}")
        for h in answer["histories"]
    ]
    return Table("Histories, and deviation of the best curve", ("", "leg", "Fx", "Fz"), rows)
