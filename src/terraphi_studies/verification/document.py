"""The data of a verification, and the document made from the data alone."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from terraphi.experiment.scenario import Scenario
from terraphi.forward import software
from terraphi.view.table import Table
from terraphi_studies.verification.check import Check, Family, Outcome

HEADER = (
    *("problem", "quantity", "expected", "obtained", "deviation", "allowed"),
    *("resolution", "verdict"),
)
ROW = (
    *("problem", "case", "settings", "quantity", "resolution", "expected", "obtained"),
    *("deviation", "deviation_percent", "deviation_deg", "passed"),
)
"""What a machine needs of a check."""
SHORT_HEADER = ("problem", "quantity", "expected", "obtained", "deviation", "verdict")
_SIGN = {"equal": "±", "at_most": "up to +", "at_least": "down to −"}

_INTRODUCTION = """\
Problems whose answers are known, computed with the very kernels, contact and stress update that the
leg uses. This page, its figures and `data.json`, which has every number with all its digits, are
written by

```
{command}
```

An interrupted run goes on where it stopped; `--workers N` uses more cores; `--only NAME` computes
one family; `--quick` is a coarse version that takes seconds.

**{passed} checks pass, {missed} miss.** A check passes if obtained less expected is within what was
allowed beforehand, relative to what is expected where that is given in percent. A miss stays in the
table, with what is known of its cause. All are in one list, `rows` of `data.json` and of `--json`.
Tier: {tier}. Computed with {software}."""

_CLOSING = """\
Numbers in brackets refer to the list below a table: where the expected value comes from, what else
should be known, why something misses. Where a problem is solved with several settings of the
numerics, each has a column of deviations; `preset` are those of preset `resolved-2`. Degrees beside
a deviation say which other φ has the force that was obtained, by the exact solution."""


def data_of(found: Mapping[str, Mapping[str, Outcome]], *, quick: bool) -> dict[str, Any]:
    """Everything that was found, JSON-able, from the outcomes by family and task.

    Returns
    -------
    dict
        ``tier``, ``software``, ``passed``, ``missed``; ``families``: by name, ``checks`` (see
        :class:`~terraphi_studies.verification.check.Check`) and ``curves`` by task; and ``rows``,
        the checks of all families in one list, with the :data:`ROW` alone and ``family``.
    """
    content: dict[str, dict[str, Any]] = {
        name: {
            "checks": [check.as_dict() for one in outcomes.values() for check in one.checks],
            "curves": {task: dict(o.curves) for task, o in outcomes.items() if o.curves},
        }
        for name, outcomes in found.items()
    }
    rows = [
        {"family": name} | {key: check[key] for key in ROW}
        for name, family in content.items()
        for check in family["checks"]
    ]
    passed = sum(row["passed"] for row in rows)
    return {
        "tier": "quick" if quick else "full",
        "software": software(Scenario()),
        "passed": passed,
        "missed": len(rows) - passed,
        "rows": rows,
        "families": content,
    }


def checks_in(data: Mapping[str, Any]) -> dict[str, list[Check]]:
    """The checks of each family, from what :func:`data_of` gave."""
    families = data["families"].items()
    return {name: [Check.from_dict(one) for one in family["checks"]] for name, family in families}


def short_table(data: Mapping[str, Any]) -> Table:
    """All checks, for a terminal."""
    rows = []
    for check in (check for checks in checks_in(data).values() for check in checks):
        name = f"{check.problem}: {check.case}".replace("`", "")
        of = f"{name}, {check.settings}" if check.settings else name
        rows.append((of, *_numbers(check)[:4], "pass" if check.passed else "MISS"))
    title = f"Verification: {data['passed']} checks pass, {data['missed']} miss"
    return Table(title, SHORT_HEADER, rows)


def markdown(
    families: Mapping[str, Family], data: Mapping[str, Any], pictures: Mapping[str, Sequence[str]]
) -> str:
    """The document, in which each family has a table, numbered sources and notes.

    Parameters
    ----------
    families
        By name.
    data
        As :func:`data_of` gives it.
    pictures
        Names of each family's figures, which stand beside the document as PNG.
    """
    only = f" --only {next(iter(families))}" if len(families) == 1 else ""
    quick = " --quick" if data["tier"] == "quick" else ""
    command = f"terraphi study verification{only}{quick} --out DIR"
    versions = ", ".join(f"{name} {version}" for name, version in data["software"].items())
    of = checks_in(data)
    passed = {name: sum(check.passed for check in checks) for name, checks in of.items()}
    overview = Table(
        "",
        ("`--only`", "family", "pass", "miss"),
        [
            (f"`{name}`", family.title, str(passed[name]), str(len(of[name]) - passed[name]))
            for name, family in families.items()
        ],
    )
    parts = [
        "# Verification",
        _INTRODUCTION.format(**{**data, "command": command, "software": versions}),
        overview.markdown(),
        *_misses([check for checks in of.values() for check in checks if not check.passed]),
        _CLOSING,
    ]
    for name, family in families.items():
        parts += [f"## {family.title}", family.meaning, _section(of[name])]
        parts += [f"![{picture}]({picture}.png)" for picture in pictures.get(name, ())]
    return "\n\n".join(parts) + "\n"


def _misses(checks: Sequence[Check]) -> list[str]:
    """What misses, by cause."""
    by_cause: dict[str, list[str]] = {}
    for check in checks:
        of = f"settings: {check.settings}" if check.settings else ""
        where = ", ".join(filter(None, (check.problem, check.case, of, check.resolution)))
        found = f"{check.quantity} ({number(check.obtained)}, not {number(check.expected)})"
        by_cause.setdefault(check.cause or "not known", []).append(f"{where}: {found}")
    lines = []
    for cause, places in by_cause.items():
        lines += [f"- Cause: {cause}.", *(f"  - {place}" for place in places)]
    return ["## What misses, and why", "\n".join(lines)] if lines else []


def _section(checks: Sequence[Check]) -> str:
    """Table of a family, problem by problem, with its sources, notes and causes below."""
    footnotes: list[str] = []

    def mark(text: str) -> str:
        if not text:
            return ""
        if text not in footnotes:
            footnotes.append(text)
        return f" [{footnotes.index(text) + 1}]"

    problems = list(dict.fromkeys(check.problem for check in checks))
    ordered = sorted(checks, key=lambda check: problems.index(check.problem))
    make = _by_settings if any(check.settings for check in checks) else _by_problem
    grid = make(ordered, mark).markdown()
    listed = "\n".join(f"{number}. {text}." for number, text in enumerate(footnotes, start=1))
    return "\n\n".join(filter(None, (grid, listed)))


def _by_problem(checks: Sequence[Check], mark: Callable[[str], str]) -> Table:
    """A row a check. The source stands at the problem if all of it has the same, else at each."""
    rows: list[tuple[str, ...]] = []
    before = ""
    for check in checks:
        sources = {other.source for other in checks if other.problem == check.problem}
        shared = mark(check.source) if len(sources) == 1 else ""
        own = "" if shared else mark(check.source)
        head = f"**{check.problem}**{shared}" if check.problem != before else ""
        before = check.problem
        name = "<br>".join(filter(None, (head, check.case + mark(check.note))))
        quantity, *numbers = _numbers(check)
        verdict = "pass" if check.passed else f"**MISS**{mark(check.cause)}"
        rows.append((name, quantity + own, *numbers, check.resolution, verdict))
    return Table("", HEADER, rows)


def _by_settings(checks: Sequence[Check], mark: Callable[[str], str]) -> Table:
    """Problems that several settings solve: a column each, the preset's first.

    A cell has the deviation, in degrees of φ too where it is that of a force, and the verdict if
    that is a miss.
    """
    columns = sorted(
        dict.fromkeys(check.settings for check in checks), key=lambda name: name != "preset"
    )
    found: dict[tuple[str, ...], dict[str, Check]] = {}
    for check in checks:
        key = (check.problem, check.case, check.quantity, check.resolution)
        found.setdefault(key, {})[check.settings] = check
    rows: list[tuple[str, ...]] = []
    before = ""
    for (problem, case, quantity, resolution), by_settings in found.items():
        one = next(iter(by_settings.values()))
        head = f"**{problem}**" if problem != before else ""
        before = problem
        _, expected, _, _, allowed = _numbers(one)
        of = quantity + mark(one.source)
        cells = [_cell(by_settings.get(settings), mark) for settings in columns]
        name = "<br>".join(filter(None, (head, case)))
        rows.append((name, of, resolution, expected, allowed, *cells))
    header = ("problem", "quantity", "resolution", "expected", "allowed", *columns)
    return Table("", header, rows)


def _cell(check: Check | None, mark: Callable[[str], str]) -> str:
    if check is None:
        return ""
    deviation = _difference(check.deviation, check.relative, signed=True)
    if not math.isnan(check.deviation_deg):
        deviation += f", {check.deviation_deg:+.1f}°"
    if check.passed:
        return deviation + mark(check.note)
    return f"**MISS** {deviation}{mark(check.note)}{mark(check.cause)}"


def _numbers(check: Check) -> tuple[str, ...]:
    """Quantity, expected, obtained, deviation, allowed."""
    return (
        check.quantity,
        number(check.expected),
        number(check.obtained),
        _difference(check.deviation, check.relative, signed=True),
        _SIGN[check.sense] + _difference(check.tolerance, check.relative),
    )


def number(value: float) -> str:
    """Four digits; no more zeros than needed."""
    if math.isnan(value):
        return "none"
    return f"{value:.3e}" if value and not 1e-3 <= abs(value) < 1e5 else f"{value:.4g}"


def _difference(value: float, relative: bool, *, signed: bool = False) -> str:
    if math.isnan(value):
        return "none"
    sign = "+" if signed and value else ""
    if relative and abs(value) >= 1e-5:
        digits = ".0f" if abs(value) >= 0.995 else ".2g"
        return f"{100.0 * value:{sign}{digits}} %"
    return f"{value:{sign}.2g}"
