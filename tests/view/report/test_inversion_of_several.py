"""The section of an inversion of several histories, from what its folder holds."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from terraphi.experiment.errors import InputError
from terraphi.view.report.inversion import UNCHECKED_TOGETHER
from terraphi.view.report.recognise import recognise, sections


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    summary = {"median": 31.0, "sd": 0.1, "ci68": [30.9, 31.1], "ci95": [30.8, 31.2]}
    convergence = {"split_rhat": 1.0004, "effective_sample_size": 9000.2}
    one = {**summary, "conditional": summary, "convergence": convergence}
    answer = {
        "phi_deg": {**summary, "yield": "rft3d"},
        "phi_plane_strain_deg": None,
        "verdict": "consistent",
        "reason": "All is well.",
        "likelihood": "joint",
        "library": "box",
        "sampler": "emcee",
        "seed": 0,
        "fixed": {},
        "converged": True,
        "acceptance_fraction": 0.4,
        "parameters": {
            "soil.friction_angle_deg": {**one, "name": "φ", "unit": "deg"},
            "soil.density": {**one, "name": "ρ", "unit": "kg/m³"},
        },
        "identifiability": {"sentences": ["φ and ρ cannot be told apart."]},
        "expected_sd": {
            leg: {"soil.friction_angle_deg": 0.1, "soil.density": 20.0}
            for leg in ("straight", "c", "all")
        },
        "histories": [
            {"source": "a.csv", "leg": "straight", "nrmsd": {"Fx": 0.01, "Fz": 0.02}},
            {"source": "b.csv", "leg": "c", "nrmsd": {"Fx": 0.03, "Fz": 0.04}},
        ],
    }
    (tmp_path / "answer.json").write_text(json.dumps(answer))
    return tmp_path


def test_a_joint_inversion_is_told_and_shown(folder: Path) -> None:
    for source in (folder, folder / "answer.json"):
        assert recognise(str(source)).kind == "inversion"
        (found,) = sections([str(source)])
        assert found.headline.startswith("φ, rft3d [deg] = 31.00 (68 %: 30.90 to 31.10); ρ [kg/m³]")
        # Its likelihood has no certificate: coverage was never simulated.
        assert (found.status, found.badge) == ("doubtful", UNCHECKED_TOGETHER)
        assert [part.title for part in found.parts] == [
            "Parameters",
            "What the forces tell of each parameter",
            "What each leg alone would leave",
            "Histories, and deviation of the best curve",
        ]


def test_an_answer_of_something_else_is_refused(folder: Path) -> None:
    answer = json.loads((folder / "answer.json").read_text())
    del answer["parameters"]
    (folder / "answer.json").write_text(json.dumps(answer))
    with pytest.raises(InputError, match="not as terraphi writes it"):
        sections([str(folder)])
