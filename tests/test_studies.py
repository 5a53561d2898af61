"""The scripts in studies/ run, and their fits find what they were given."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import plates

STUDIES = Path(plates.__file__).parent


@pytest.mark.parametrize(("phi", "short"), [(28.0, 0.0), (35.0, 3e-4)])
def test_fit_of_a_plate_finds_angle_and_first_contact(phi: float, short: float) -> None:
    law, sinkage = plates.law_of("rft"), np.linspace(2e-3, 0.02, 30)
    test = plates.Test("made", 0.06, sinkage - short, law(0.06, phi, sinkage))
    found, misfit = plates.fitted(test, law)
    assert found == pytest.approx(phi, abs=0.2)  # the first contact is held to its prior
    assert misfit < 0.02


def test_simulated_discs_are_met_by_the_law_that_is_made_of_them() -> None:
    table = {key: np.array(v, float) for key, v in plates.columns("simulated.csv").items()}
    law = plates.simulated()
    own = (table["diameter_mm"] == 100.0) & (table["phi_deg"] == 32.0) & (table["sinkage_mm"] > 1.0)
    force = law(0.1, 32.0, table["sinkage_mm"][own] / 1e3)
    assert force.mean() == pytest.approx(table["force_N"][own].mean(), rel=1e-3)


def test_one_angle_is_that_of_the_tests() -> None:
    law, sinkage = plates.law_of("vesic"), np.linspace(2e-3, 0.02, 30)
    tests = [plates.Test("made", d, sinkage, law(d, 31.0, sinkage)) for d in (0.06, 0.1)]
    assert plates.one_angle(tests, law) == (
        pytest.approx(31.0, abs=0.05),
        pytest.approx(0, abs=1e-3),
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["plates", "resolution", "real_sand", "calibration"])
def test_script_writes_its_page(name: str, tmp_path: Path) -> None:
    command = [sys.executable, str(STUDIES / f"{name}.py"), "--out", str(tmp_path)]
    subprocess.run(command, check=True, capture_output=True, text=True)
    assert (tmp_path / f"{name}.png").is_file()
    assert "| ---" in (tmp_path / f"{name}.md").read_text(encoding="utf-8")
