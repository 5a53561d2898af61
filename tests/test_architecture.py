"""Folders import only from those above them, a command loads only what it needs, and code stays
readable: no pronoun is the name of a value, and no function is longer than 70 lines.
"""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[1] / "src" / "terraphi"
FOLDERS = (
    "experiment", "forward", "laws", "inference", "robot", "terrain", "view",
    "paper", "cli",
)  # fmt: skip
PRONOUNS = {
    "alike", "apart", "both", "found", "known", "one", "others", "own", "seen", "some", "whole",
}  # fmt: skip
LONGEST = 70
HEAVY = {"distributed", "emcee", "h5py", "matplotlib", "numba", "pandas", "scipy", "xarray"}


@lru_cache
def nodes_of(path: Path) -> list[ast.AST]:
    """Nodes of the syntax of a module."""
    return [*ast.walk(ast.parse(path.read_text(encoding="utf-8")))]


def imported(nodes: list[ast.AST]) -> set[str]:
    """Folders that a module imports from, wherever the import stands; "" is `terraphi` itself."""
    names: set[str] = set()
    for node in nodes:
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    ours = (name.split(".") for name in names)
    return {
        parts[1] if len(parts) > 1 and parts[1] in FOLDERS else ""
        for parts in ours
        if parts[0] == "terraphi"
    }


def test_folder_imports_only_from_those_above() -> None:
    wrong = {
        path.relative_to(SOURCE).as_posix(): folders
        for place, folder in enumerate(FOLDERS)
        for path in sorted((SOURCE / folder).rglob("*.py"))
        if path.name != "__main__.py"
        and (folders := imported(nodes_of(path)) - {*FOLDERS[:place]}) - {folder}
    }
    assert not wrong


def test_every_folder_has_its_place() -> None:
    assert {path.parent.name for path in SOURCE.glob("*/__init__.py")} <= set(FOLDERS)


@pytest.mark.parametrize(
    ("module", "heavy"),
    [("terraphi", HEAVY), ("terraphi.cli.main", {*HEAVY, "numpy", "pydantic"})],
)
def test_import_stays_light(module: str, heavy: set[str]) -> None:
    code = f"import sys, {module}; print(*sorted({heavy!r} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


def names_given(nodes: list[ast.AST]) -> Iterator[str]:
    """Names of the variables and arguments of a module."""
    for node in nodes:
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id
        elif isinstance(node, ast.arg):
            yield node.arg


def lines_of_code(function: ast.FunctionDef, text: list[str]) -> int:
    """Lines of a function without blank lines, comments and its docstring."""
    docstring = ast.get_docstring(function, clean=False)
    lines = (line.strip() for line in text[function.lineno - 1 : function.end_lineno])
    code = sum(bool(line) and not line.startswith("#") for line in lines)
    return code - sum(bool(line.strip()) for line in (docstring or "").splitlines())


def test_no_pronoun_is_the_name_of_a_value() -> None:
    wrong = {
        f"{file.relative_to(SOURCE).as_posix()}: {name}"
        for file in SOURCE.rglob("*.py")
        for name in names_given(nodes_of(file))
        if name.strip("_") in PRONOUNS
    }
    assert not wrong


def test_functions_fit_a_screen() -> None:
    long: dict[str, int] = {}
    for file in SOURCE.rglob("*.py"):
        text = file.read_text(encoding="utf-8").splitlines()
        for node in nodes_of(file):
            if isinstance(node, ast.FunctionDef):
                lines = lines_of_code(node, text)
                if lines > LONGEST:
                    long[f"{file.relative_to(SOURCE).as_posix()}: {node.name}"] = lines
    assert not long
