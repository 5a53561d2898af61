"""The one door to all forward models, and what it writes into a history."""

from __future__ import annotations

import importlib.metadata
import json
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from terraphi import forward
from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.motion import Rotation, Translation, bin_centres
from terraphi.experiment.scenario import Scenario

RFT = Scenario.model_validate({"name": "a", "model": "rft", "numerics": {"seed": 7}})


def test_history_says_where_it_comes_from(tmp_path: Path) -> None:
    history = forward.simulate(RFT)
    known = json.loads(json.dumps(dict(history.provenance)))
    assert Scenario.model_validate(known["scenario"]) == RFT
    assert known["scenario_hash"] == RFT.hash
    assert (known["model"], known["model_version"], known["seed"]) == ("rft", "rft-1", 7)
    assert known["numpy"] == np.__version__
    assert known["python"].split(".")[0] == "3"
    assert {"terraphi", "machine", "seconds", "panels"} <= set(known)
    assert "numba" not in known
    history.to_netcdf(tmp_path / "a.nc")
    assert ForceHistory.from_netcdf(tmp_path / "a.nc").provenance == known


def test_material_point_method_is_called_and_its_words_are_kept(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    kept, looks = forward.Checkpoint(Path("c")), list.append

    def fake(scenario: Scenario, **options: Any) -> ForceHistory:
        assert options == {"progress": print, "checkpoint": kept, "observe": looks}
        return ForceHistory(np.array([0.0, 1.0]), np.ones((2, 2)), provenance={"machine": "mine"})

    monkeypatch.setattr("terraphi.forward.driver.simulate", fake)
    known = forward.simulate(Scenario(), progress=print, checkpoint=kept, observe=looks).provenance
    assert known["model_version"] == "mpm-1"
    assert known["machine"] == "mine"
    assert known["numba"] == importlib.metadata.version("numba")


def test_resistive_force_theory_keeps_nothing_and_has_nothing_to_show(tmp_path: Path) -> None:
    forward.simulate(RFT, checkpoint=forward.Checkpoint(tmp_path / "c", every=0.0))
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(InputError, match="model = 'rft' has no particles to look at"):
        forward.simulate(RFT, observe=print)


def test_version_of_a_package_that_is_not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    def absent(name: str) -> str:
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(importlib.metadata, "version", absent)
    assert forward.software(RFT)["terraphi"] == "unknown"


def test_asking_for_versions_compiles_nothing() -> None:
    code = (
        "import sys; from terraphi.forward import model_version, software; "
        "from terraphi.experiment.scenario import Scenario; "
        "assert model_version(Scenario()) == 'mpm-1'; software(Scenario()); "
        "print('numba' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_models_share_their_bins() -> None:
    history = forward.simulate(RFT)
    assert len(history.position) == 2700
    assert history.theta_deg[[0, -1]] == pytest.approx([-134.95, 134.95])
    assert np.diff(history.theta_deg) == pytest.approx(0.1)


MOTIONS: list[Any] = [
    Rotation(),
    Rotation(rate_profile=((-90.0, 0.1), (0.0, 2.0), (60.0, 0.5))),
    Translation(start=(0.1, 0.2), velocity=(0.03, -0.04), distance=0.02, orientation_deg=20.0),
]


@pytest.mark.parametrize("motion", MOTIONS)
def test_poses_by_coordinate_are_those_by_time(motion: Any) -> None:
    time = np.linspace(0.0, motion.duration, 50)
    by_time, by_place = motion.poses(time), motion.poses_at(motion.coordinates(time))
    for one, other in zip(by_time, by_place, strict=True):
        assert other == pytest.approx(one, abs=1e-12)


def test_bins_of_a_translation() -> None:
    motion = Translation(start=(0.0, 0.0), velocity=(1.0, 0.0), distance=0.01, bin_width=0.0025)
    assert bin_centres(motion) == pytest.approx([0.00125, 0.00375, 0.00625, 0.00875])
    assert math.isclose(bin_centres(motion).mean(), 0.005)
