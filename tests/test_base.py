"""The base: what `pip install` brings without an extra inverts, calibrates and exports."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tomllib
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest
from packaging.requirements import Requirement
from scipy.interpolate import CubicSpline

import terraphi
from terraphi.laws import foot

ROOT = Path(__file__).parents[1]
HEAVY = {"emcee", "matplotlib", "numba", "scipy"}
RUN = """
import sys

absent = set(sys.argv.pop(1).split(","))

class Installed:
    def __init__(self, finder):
        self.finder = finder

    def __getattr__(self, name):
        return getattr(self.finder, name)

    def find_spec(self, name, path=None, target=None):
        gone = name.partition(".")[0] in absent
        return None if gone else self.finder.find_spec(name, path, target)

sys.meta_path[:] = map(Installed, sys.meta_path)
from terraphi.cli.main import main
commands = " ".join(sys.argv[1:]).split(" then ")
for command in commands:
    sys.argv[1:] = command.split()
    try:
        main()
    except SystemExit as leaving:
        if leaving.code:
            raise
"""
"""Commands, with ``then`` between them, where some modules are not installed."""


def base_packages() -> set[str]:
    """Packages that the dependencies of the project bring, without its extras."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    result: set[str] = set()
    waiting = [*project["dependencies"]]
    while waiting:
        item = Requirement(waiting.pop())
        name = item.name.lower().replace("_", "-")
        if name not in result and (item.marker is None or item.marker.evaluate({"extra": ""})):
            result.add(name)
            waiting += metadata.requires(name) or []
    return result


@pytest.fixture(scope="module")
def absent() -> set[str]:
    """Modules that are installed here, and not with the base."""
    kept = base_packages() | {"terraphi"}
    owners = {
        module: {name.lower().replace("_", "-") for name in names}
        for module, names in metadata.packages_distributions().items()
    }
    result = {module for module, names in owners.items() if not names & kept}
    assert result >= HEAVY
    return result


def ran(folder: Path, absent: set[str], *command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", RUN, ",".join(sorted(absent)), *command],
        cwd=folder, env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True, text=True, check=False,
    )  # fmt: skip


def test_the_base_inverts_as_the_whole(tmp_path: Path, absent: set[str]) -> None:
    """A leg and a plate of one soil; the picture that it cannot draw is named."""
    leg = "li2013:poppy_loose/c"
    terraphi.measurement(leg).history.to_csv(tmp_path / "leg.csv")
    plate = ROOT / "studies" / "data" / "grains" / "B-loose_disc_60_1.csv"
    for forces, options in (
        (["leg.csv"], {"rig": "li2013", "leg": "c", "density": "640±30"}),
        ([str(plate)], {"tool": "plate:60", "density": "1400±40"}),
    ):
        words = [word for key, value in options.items() for word in (f"--{key}", value)]
        done = ran(tmp_path, absent, "invert", *forces, *words, "--json", "--out", "answer")
        assert done.returncode == 0, done.stderr
        assert "'terraphi[plot]'" in done.stderr
        answer = terraphi.invert(str(tmp_path / forces[0]), **options)
        phi = json.loads(done.stdout)["phi_deg"]
        assert phi["median"] == pytest.approx(answer.phi.median, abs=1e-6)
        assert phi["ci95"] == pytest.approx(answer.phi.ci95, abs=1e-6)
        saved = terraphi.Answer.load(tmp_path / "answer")
        assert saved.phi.median == pytest.approx(answer.phi.median, abs=1e-6)
        assert {item.name for item in (tmp_path / "answer").glob("answer.*")} == {
            "answer.json", "answer.nc",
        }  # fmt: skip


def test_the_base_calibrates_exports_and_simulates(tmp_path: Path, absent: set[str]) -> None:
    leg = "li2013:poppy_loose/straight"
    lines = (
        f"calibrate {leg} --phi 36±2 --out poppy.toml",
        f"invert {leg} --calibration poppy.toml --out answer",
        "export answer --to newton",
        "convert 0.7 --from newton",
        "simulate quick",
        "demo --json",
    )
    done = ran(tmp_path, absent, " then ".join(lines))
    assert done.returncode == 0, done.stderr
    assert done.stdout.index('"answers"') > done.stdout.index("φ = ")


@pytest.mark.parametrize(
    ("command", "extra"),
    [
        (["simulate", "sand3d"], "simulate"),
        (["paper", "k0"], "plot,simulate"),
        (["footfalls", "walk.csv"], "robot"),
    ],
)
def test_what_is_missing_is_named_with_the_line_to_type(
    tmp_path: Path, absent: set[str], command: list[str], extra: str
) -> None:
    done = ran(tmp_path, absent, *command)
    assert done.returncode == 2
    assert done.stderr.rstrip().endswith(f"pip install 'terraphi[{extra}]'")
    assert len(done.stderr.splitlines()) == 1
    assert not [*tmp_path.iterdir()]


@pytest.mark.parametrize("count", [4, 9])
def test_spline_is_that_of_scipy(count: int) -> None:
    rng = np.random.default_rng(count)
    nodes = np.sort(rng.uniform(17.0, 52.0, count))
    values = rng.standard_normal((count, 3, 2))
    places = np.linspace(nodes[0], nodes[-1], 50)
    result = foot._cubic_spline(nodes, values, places)
    # Rounding grows with the condition of the basis, which close nodes make large.
    np.testing.assert_allclose(result, CubicSpline(nodes, values)(places), atol=1e-9)
