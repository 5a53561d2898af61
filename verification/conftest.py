"""The fixture `check`, and the page that a run writes of all checks: docs/verification.md."""

from __future__ import annotations

import ast
import math
import platform
import re
from importlib.metadata import version
from pathlib import Path

import pytest

HEAD = """# Verification

`make verify` solves problems with known answers and writes this page. The number in brackets is
the reason for the tolerance. An empty cell is as the one above.
"""
COLUMNS = "| problem | quantity | expected | off by | allowed |"


@pytest.fixture
def check(request, record_property):
    """Record a number next to its known value, and fail at the end of the test if it is off."""
    missed = []

    def compare(problem, quantity, *, expected, found, within, why, absolute=False, sense="equal"):
        """Sense `at_most` or `at_least`: a difference to the other side is no miss."""
        off = (found - expected) / (1.0 if absolute else abs(expected))
        low, high = sense != "at_most", sense != "at_least"
        passed = math.isfinite(off) and not (low and off < -within) and not (high and off > within)
        share = f"{off:+.2g}" if absolute else f"{100.0 * off:+.2g}%"
        sign = {"equal": "±", "at_most": "≤", "at_least": "≥−"}[sense]
        cells = [
            problem, quantity, f"{expected:.4g}", share,
            sign + (f"{within:.3g}" if absolute else f"{100.0 * within:.3g}%"), why,
        ]  # fmt: skip
        record_property("check", cells)
        if not passed:
            missed.append(f"{problem}, {quantity}: {found:.6g}, not {expected:.6g} {cells[4]}")

    yield compare
    if missed:
        pytest.fail("\n".join(missed), pytrace=False)


def pytest_addoption(parser):
    """Where the page is written, if it is."""
    parser.addoption("--page", type=Path, help="write the checks of all files that ran whole here")


def pytest_configure(config):
    """Collect rows where tests are started, not in the workers that run them."""
    if config.getoption("--page") and not hasattr(config, "workerinput"):
        config.pluginmanager.register(Page(config.getoption("--page")))


class Page:
    """Rows of a run; sections of files that ran whole replace those of the page."""

    def __init__(self, path):
        self.path, self.rows, self.ran, self.failed = path, {}, {}, set()

    def pytest_runtest_logreport(self, report):
        """Keep the rows of a finished test, and count it."""
        file = report.nodeid.split("::")[0]
        if report.failed:
            self.failed.add(file)
        if report.when == "teardown":
            found = [cells for name, cells in report.user_properties if name == "check"]
            self.rows.setdefault(file, {})[report.location[1], report.nodeid] = found
            function = report.nodeid.split("::")[1].split("[")[0]
            self.ran.setdefault(file, set()).add(function)

    def pytest_sessionfinish(self, session):
        """Write the page."""
        sections = {}
        if self.path.is_file():
            parts = re.split(r"^(?=## )", self.path.read_text(encoding="utf-8"), flags=re.M)[1:]
            sections = {part.splitlines()[0]: part for part in parts}
        for file in sorted(self.ran):
            tree = ast.parse((session.config.rootpath / file).read_text(encoding="utf-8"))
            functions = [n.name for n in tree.body if isinstance(n, ast.FunctionDef)]
            if {n for n in functions if n.startswith("test_")} == self.ran[file]:
                title, _, text = ast.get_docstring(tree).partition("\n")
                sections[f"## {title.rstrip('.')}"] = self._section(file, title, text)
        rows = [line for part in sections.values() for line in part.splitlines() if "|" in line]
        versions = ", ".join(f"{name} {version(name)}" for name in ("terraphi", "numpy", "numba"))
        count = len(rows) - 2 * len(sections)
        made = f"{count} checks, {len(sections)} files; {versions}, {platform.machine()}.\n"
        order = sorted(sections.items(), key=lambda item: ORDER.index(item[0]))
        text = "\n".join([HEAD, made, *(part.strip() + "\n" for _, part in order)])
        self.path.write_text(text.rstrip() + "\n", encoding="utf-8")

    def _section(self, file, title, text):
        rows = [cells for _, found in sorted(self.rows[file].items()) for cells in found]
        reasons = list(dict.fromkeys(cells[-1] for cells in rows))
        lines = [f"## {title.rstrip('.')}", "", " ".join(text.split()), "", COLUMNS]
        lines.append("| --- " * 5 + "|")
        above = ["", ""]
        for *cells, why in rows:
            pairs = zip(cells[:2], above, strict=True)
            named = ["" if cell == old else cell for cell, old in pairs]
            lines.append(f"| {' | '.join([*named, *cells[2:]])} [{reasons.index(why) + 1}] |")
            above = cells[:2]
        lines += ["", *(f"{i}. {why[:1].upper()}{why[1:]}." for i, why in enumerate(reasons, 1))]
        failed = ["", f"**{Path(file).name} failed: see the run.**"] if file in self.failed else []
        return "\n".join([*lines, *failed, ""])


ORDER = [
    f"## {name}"
    for name in (
        "Element tests", "Soil at rest and waves", "Conservation", "Limit loads",
        "Collapse of a column", "Order of convergence", "Three dimensions",
    )
]  # fmt: skip
