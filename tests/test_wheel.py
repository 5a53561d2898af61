"""The package as people install it: built, small, and working in an environment of its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import venv
import zipfile
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[1]
LARGEST_BYTES = 25_000_000


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built as a release is: a source distribution, and a wheel out of that."""
    place = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(place), str(ROOT)]
    made = subprocess.run(command, capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stderr
    (found,) = place.glob("*.whl")
    return found


def test_the_wheel_is_small_enough(wheel: Path) -> None:
    assert wheel.stat().st_size <= LARGEST_BYTES


def test_the_wheel_holds_every_file_of_both_packages(wheel: Path) -> None:
    """But for finished cases of libraries that are not whole."""
    with zipfile.ZipFile(wheel) as archive:
        held = {name for name in archive.namelist() if ".dist-info/" not in name}
    source = ROOT / "src"
    files = {path.relative_to(source) for path in source.rglob("*") if path.is_file()}
    ours = {
        path.as_posix()
        for path in files
        if "__pycache__" not in path.parts and not any(p.endswith(".nc.cases") for p in path.parts)
    }
    assert held == ours


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the commands of an environment lie that has the wheel and what it needs."""
    place = tmp_path_factory.mktemp("environment")
    venv.create(place, with_pip=True)
    programs = place / ("Scripts" if os.name == "nt" else "bin")
    pinned = {**os.environ, "PIP_CONSTRAINT": str(ROOT / "constraints.txt")}
    command = [str(programs / "python"), "-m", "pip", "install", "--quiet", str(wheel)]
    made = subprocess.run(command, env=pinned, capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stderr
    return programs


def ran(installed: Path, folder: Path, *words: str) -> str:
    """What a command prints there, with nothing of this checkout in its way."""
    clean = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    made = subprocess.run(
        [str(installed / "terraphi"), *words],
        cwd=folder,
        env=clean,
        capture_output=True,
        text=True,
        check=False,
    )
    assert made.returncode == 0, made.stderr
    return made.stdout


def test_the_demo_runs_from_an_empty_environment(installed: Path, tmp_path: Path) -> None:
    assert "as well as it fits other sands" in ran(installed, tmp_path, "demo", "--out", "demo")
    assert list((tmp_path / "demo").glob("*.png"))


def test_nothing_that_is_shipped_is_missing_there(installed: Path, tmp_path: Path) -> None:
    assert json.loads(ran(installed, tmp_path, "doctor", "--json"))["sound"] is True


def test_studies_and_their_data_are_found_there(installed: Path, tmp_path: Path) -> None:
    found = json.loads(ran(installed, tmp_path, "study", "resolution", "--json"))
    assert found["missing"] == []
    assert "paper-truths" in ran(installed, tmp_path, "library", "list")
