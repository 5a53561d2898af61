"""The one door to all forward models, and what it writes into a history."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from terraphi import forward
from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.scenario import Scenario

RFT = Scenario.model_validate({"name": "a", "model": "rft", "numerics": {"seed": 7}})


def test_history_says_where_it_comes_from(tmp_path: Path) -> None:
    history = forward.simulate(RFT)
    content = json.loads(json.dumps(dict(history.provenance)))
    assert Scenario.model_validate(content["scenario"]) == RFT
    assert content["scenario_hash"] == RFT.hash
    assert (content["model"], content["model_version"], content["seed"]) == ("rft", "rft-1", 7)
    assert content["numpy"] == np.__version__
    assert {"terraphi", "python", "machine", "seconds", "panels"} <= set(content)
    assert "numba" not in content
    history.to_netcdf(tmp_path / "a.nc")
    assert ForceHistory.load(tmp_path / "a.nc").provenance == content


def test_resistive_force_theory_keeps_nothing_and_has_nothing_to_show(tmp_path: Path) -> None:
    forward.simulate(RFT, checkpoint=tmp_path / "c")
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(InputError, match="model = 'rft' has no particles to look at"):
        forward.simulate(RFT, observe=print)


def test_asking_for_versions_compiles_nothing() -> None:
    code = (
        "import sys; from terraphi.forward import model_version, software; "
        "from terraphi.experiment.scenario import Scenario; "
        "assert model_version(Scenario()) == 'mpm-1'; software(Scenario()); "
        "print('numba' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
