"""The package as people install it: built, small, and working in an environment of its own."""

from __future__ import annotations

import os
import subprocess
import sys
import venv
import zipfile
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[1]
LARGEST_BYTES = 8_000_000


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built as a release is: a source distribution, and a wheel out of that."""
    place = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(place), str(ROOT)]
    made = subprocess.run(command, capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stderr
    (found,) = place.glob("*.whl")
    return found


def test_wheel_is_small_and_holds_every_file_of_the_package(wheel: Path) -> None:
    assert wheel.stat().st_size <= LARGEST_BYTES
    with zipfile.ZipFile(wheel) as archive:
        held = {name for name in archive.namelist() if ".dist-info/" not in name}
    source = ROOT / "src"
    files = (path for path in (source / "terraphi").rglob("*") if path.is_file())
    ours = {path.relative_to(source).as_posix() for path in files}
    assert held == {n for n in ours if "__pycache__" not in n and ".nc.cases/" not in n}


def test_base_inverts_and_demo_runs_from_an_empty_environment(wheel: Path, tmp_path: Path) -> None:
    place = tmp_path / "environment"
    venv.create(place, with_pip=True)
    programs = place / ("Scripts" if os.name == "nt" else "bin")
    pinned = {**os.environ, "PIP_CONSTRAINT": str(ROOT / "constraints.txt")}
    clean = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    for command, variables in (
        ([programs / "python", "-m", "pip", "install", "--quiet", wheel], pinned),
        ([programs / "terraphi", "invert", "li2013:yuma/c"], clean),
        ([programs / "terraphi", "doctor"], clean),
        ([programs / "python", "-m", "pip", "install", "--quiet", f"{wheel}[plot]"], pinned),
        ([programs / "terraphi", "demo", "--out", "demo"], clean),
    ):
        made = subprocess.run(
            [str(word) for word in command],
            cwd=tmp_path, env=variables, capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert made.returncode == 0, made.stderr
    assert list((tmp_path / "demo").glob("*.png"))
