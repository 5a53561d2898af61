"""Folders import only from those above them, and a command loads only what it needs."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[1] / "src" / "terraphi"
FOLDERS = (
    "experiment", "forward", "laws", "inference", "robot", "terrain", "view",
    "paper", "cli",
)  # fmt: skip
HEAVY = {"distributed", "emcee", "h5py", "matplotlib", "numba", "pandas", "scipy", "xarray"}


def imported(tree: ast.AST) -> set[str]:
    """Folders that a module imports from, wherever the import stands; "" is `terraphi` itself."""
    names: set[str] = set()
    for node in ast.walk(tree):
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


@pytest.mark.parametrize("folder", [name for name in FOLDERS if (SOURCE / name).is_dir()])
def test_folder_imports_only_from_those_above(folder: str) -> None:
    allowed = set(FOLDERS[: FOLDERS.index(folder) + 1])
    wrong = {
        path.relative_to(SOURCE).as_posix(): found
        for path in sorted((SOURCE / folder).rglob("*.py"))
        if path.name != "__main__.py"
        and (found := imported(ast.parse(path.read_text(encoding="utf-8"))) - allowed)
    }
    assert not wrong


def test_every_folder_has_its_place() -> None:
    found = {path.name for path in SOURCE.iterdir() if (path / "__init__.py").is_file()}
    assert found <= set(FOLDERS)


@pytest.mark.parametrize(
    ("module", "heavy"),
    [("terraphi", HEAVY), ("terraphi.cli.main", {*HEAVY, "numpy", "pydantic"})],
)
def test_import_stays_light(module: str, heavy: set[str]) -> None:
    code = f"import sys, {module}; print(*sorted({heavy!r} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []
