"""The package as people install it: built, small, and working in an environment of its own.

``TERRAPHI_DIST`` names a folder with the sdist and the wheel of a release, which are tested instead
of ones that are built here.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import venv
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[1]
LARGEST_BYTES = 8_000_000
EXTRAS = ("matplotlib", "mujoco", "numba", "rasterio", "scipy", "starlette")
"""Packages that extras bring and the base does without."""


@pytest.fixture(scope="module")
def dist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a source distribution, and a wheel that was built out of that."""
    if given := os.environ.get("TERRAPHI_DIST"):
        return Path(given).resolve()
    place = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(place), str(ROOT)]
    made = subprocess.run(command, capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stderr
    return place


@pytest.fixture(scope="module")
def wheel(dist: Path) -> Path:
    (result,) = dist.glob("*.whl")
    return result


@pytest.fixture
def run(tmp_path: Path) -> Callable[..., str]:
    """Run a program of a new environment, outside of the checkout."""
    place = tmp_path / "environment"
    venv.create(place, with_pip=True)
    programs = place / ("Scripts" if os.name == "nt" else "bin")
    (tmp_path / "elsewhere").mkdir()
    clean = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    clean["PIP_CONSTRAINT"] = str(ROOT / "constraints.txt")

    def run(program: str, *words: object) -> str:
        done = subprocess.run(
            [str(programs / program), *map(str, words)],
            cwd=tmp_path / "elsewhere", env=clean, capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        return done.stdout

    return run


def contents(wheel: Path) -> dict[str, int]:
    """CRC of each file in a wheel."""
    with zipfile.ZipFile(wheel) as archive:
        return {item.filename: item.CRC for item in archive.infolist()}


def test_wheel_is_small_and_holds_every_file_of_the_package(wheel: Path) -> None:
    assert wheel.stat().st_size <= LARGEST_BYTES
    held = {name for name in contents(wheel) if ".dist-info/" not in name}
    source = ROOT / "src"
    files = (path for path in (source / "terraphi").rglob("*") if path.is_file())
    ours = {path.relative_to(source).as_posix() for path in files}
    assert held == {n for n in ours if "__pycache__" not in n and ".nc.cases/" not in n}


def test_source_distribution_builds_the_same_wheel(dist: Path, wheel: Path, tmp_path: Path) -> None:
    (source,) = dist.glob("*.tar.gz")
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run([*command, "--wheel-dir", str(tmp_path), str(source)], check=True)
    (again,) = tmp_path.glob("*.whl")
    assert contents(again) == contents(wheel)


def test_base_inverts_calibrates_and_exports(
    wheel: Path, run: Callable[..., str], tmp_path: Path
) -> None:
    run("python", "-m", "pip", "install", "--quiet", wheel)
    listed = json.loads(run("python", "-m", "pip", "list", "--format=json"))
    assert not {entry["name"].lower() for entry in listed} & {*EXTRAS}
    place = run("python", "-c", "import terraphi; print(terraphi.__file__)").strip()
    assert Path(place).is_relative_to(tmp_path / "environment")
    forces, rig = tmp_path / "elsewhere" / "forces.csv", ("--rig", "li2013", "--leg", "c")
    shutil.copy(Path(place).parent / "data" / "li2013" / "yuma-c.csv", forces)
    density = ("--density", "1650±50")
    shown = run("terraphi", "invert", forces.name, *rig, *density, "--out", "answer", "--json")
    answer = json.loads(shown)
    assert answer["verdict"] == "consistent"
    run("terraphi", "calibrate", forces.name, *rig, *density, "--phi", "30±1", "--out", "cal.toml")
    calibrated = json.loads(
        run("terraphi", "invert", forces.name, *rig, *density, "--calibration", "cal.toml",
            "--json")
    )  # fmt: skip
    assert calibrated["phi_deg"]["sd"] < answer["phi_deg"]["sd"]
    run("terraphi", "export", "answer", "--to", "newton", "--out", "soil.py")
    assert "soil.py" in {path.name for path in forces.parent.iterdir()}
    run("terraphi", "doctor")


def test_demo_runs_with_pictures(wheel: Path, run: Callable[..., str], tmp_path: Path) -> None:
    run("python", "-m", "pip", "install", "--quiet", f"{wheel}[plot]")
    run("terraphi", "demo", "--out", "demo")
    assert list((tmp_path / "elsewhere" / "demo").glob("*.png"))
