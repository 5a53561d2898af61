"""Stamps that jitter while samples do not, against walks of known times and forces."""

from __future__ import annotations

import runpy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from go2.logs import write_csv

from terraphi.robot.joint_log import JointLog
from terraphi.robot.logs.clock import regular
from terraphi.robot.results import analyse

Walk = runpy.run_path(str(Path(__file__).with_name("walker.py")))["Walk"]
COLUMNS = ("time", "angle", "velocity", "torque", "quaternion", "angular_velocity", "acceleration")


@pytest.fixture(scope="module")
def trot() -> tuple[JointLog, np.ndarray]:
    return Walk(gait="trot", period=0.42, speed=0.3, velocity_noise=0.003).log()


def kept(log: JointLog, which: np.ndarray) -> JointLog:
    return JointLog(*(getattr(log, name)[which] for name in COLUMNS))


@pytest.mark.parametrize("kind", ["normal", "late"])
def test_late_stamps_do_not_become_forces(trot: Any, kind: str, tmp_path: Path) -> None:
    log, force = trot
    rng = np.random.default_rng(4)
    late = rng.exponential(1e-3, 5000) if kind == "late" else rng.normal(0.0, 1e-3, 5000)
    stamps = log.time + late
    worn = replace(log, time=stamps)
    write_csv(tmp_path / "log.csv", worn)
    for found in (analyse(worn), analyse(tmp_path / "log.csv")):
        error = np.sqrt(np.nanmean((found.forces.force - force)[force[..., 2] > 1.0] ** 2, axis=0))
        assert error.max() < 1.0
        assert found.summary()["dropped"] == 0
        said = [note for note in found.notes if "even times" in note]
        assert len(said) == 1
        assert "stamps are off by" in said[0]


def test_lost_samples_stay_lost(trot: Any) -> None:
    rng = np.random.default_rng(1)
    there = rng.random(5000) > 0.004
    there[2000:2080] = False
    log = kept(trot[0], there)
    worn = replace(log, time=log.time + rng.normal(0.0, 5e-4, len(log.time)))
    off = regular(worn).time - log.time
    assert np.abs(off - off.mean()).max() < 0.002  # no more than a sample from the truth
    assert analyse(worn).summary()["missing"] == pytest.approx(5000 - there.sum(), abs=2)


def test_samples_that_are_uneven_keep_their_stamps(trot: Any) -> None:
    log = trot[0]
    time = np.sort(log.time + np.random.default_rng(2).normal(0.0, 3e-4, 5000))
    columns = {name: getattr(log, name).reshape(5000, -1) for name in COLUMNS[1:]}
    seen = {
        name: np.stack([np.interp(time, log.time, c) for c in values.T], axis=1).reshape(
            getattr(log, name).shape
        )
        for name, values in columns.items()
    }
    uneven = JointLog(time, **seen)
    assert regular(uneven) is uneven
    assert regular(log) is log
