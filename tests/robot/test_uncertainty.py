"""Whether sigma covers the errors that its priors speak of: walks with errors drawn from them."""

from __future__ import annotations

import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import norm
from scipy.stats.qmc import LatinHypercube

from terraphi.robot.forces import SensorErrors, estimate
from terraphi.robot.model import Robot

GO2 = Robot.load("go2")
_WALKER = runpy.run_path(str(Path(__file__).with_name("walker.py")))
Walk, tilted = _WALKER["Walk"], _WALKER["tilted"]
DRAWS = 10


def covered(priors: SensorErrors) -> float:
    """Part of the forces in stance within sigma, over walks with errors from priors."""
    walk = Walk(
        gait="trot", period=0.42, speed=0.3, duration=0.84, coulomb=0.0, viscous=0.0,
        inertia=0.0, sinkage=0.0, torque_noise=0.1,
    )  # fmt: skip
    log, force = walk.log()
    loaded = force[..., 2] > 15.0
    inside = []
    # Normal numbers that are spread evenly, so that few draws tell the share of all.
    drawn = norm.ppf(LatinHypercube(26, rng=0).random(DRAWS))
    for row in drawn:
        gain = 1.0 + priors.gain * row[:12].reshape(4, 3)
        lost = priors.coulomb_Nm * row[12:24].reshape(4, 3) * np.tanh(log.velocity / 0.02)
        roll, pitch = np.radians(priors.attitude_deg * row[24:])
        worn = replace(tilted(log, roll, pitch), torque=(log.torque + lost) * gain)
        estimated_forces = estimate(worn, robot=GO2, friction=False, priors=priors)
        inside.append((np.abs(estimated_forces.force - force) < estimated_forces.sigma)[loaded])
    if not (priors.gain or priors.coulomb_Nm):  # a tilt of the axes leaves F_z as it is
        inside = [each[:, :2] for each in inside]
    return float(np.mean(np.concatenate(inside)))


@pytest.mark.parametrize("known", [{}, {"gain": 0.0, "coulomb_Nm": 0.0}], ids=["all", "attitude"])
def test_sigma_covers_what_all_samples_share(known: dict[str, float]) -> None:
    assert 0.58 < covered(replace(SensorErrors(), **known)) < 0.78
