"""Whether sigma covers the errors that its priors speak of: walks with errors drawn from them."""

from __future__ import annotations

import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import norm
from scipy.stats.qmc import LatinHypercube

from terraphi.robot.forces import Priors, estimate
from terraphi.robot.model import Quadruped

GO2 = Quadruped.load("go2")
_WALKER = runpy.run_path(str(Path(__file__).with_name("walker.py")))
Walk, tilted = _WALKER["Walk"], _WALKER["tilted"]
DRAWS = 24
NONE = Priors(gain=0.0, coulomb_Nm=0.0, friction_part=0.0, attitude_deg=0.0)


def covered(priors: Priors, *, gait: str = "trot") -> float:
    """Part of the forces in stance within sigma, over walks with errors from priors."""
    period, speed = (0.42, 0.3) if gait == "trot" else (1.2, 0.1)
    walk = Walk(
        gait=gait, period=period, speed=speed, duration=2 * period, coulomb=0.0, viscous=0.0,
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
        found = estimate(worn, robot=GO2, friction=False, priors=priors)
        inside.append((np.abs(found.force - force) < found.sigma)[loaded])
    if not (priors.gain or priors.coulomb_Nm):  # a tilt of the axes leaves F_z as it is
        inside = [each[:, :2] for each in inside]
    return float(np.mean(np.concatenate(inside)))


@pytest.mark.parametrize(
    ("gait", "known"),
    [
        ("walk", {}),
        ("trot", {}),
        ("trot", {"coulomb_Nm": 0.0, "attitude_deg": 0.0}),
        ("trot", {"gain": 0.0, "attitude_deg": 0.0}),
        ("trot", {"gain": 0.0, "coulomb_Nm": 0.0}),
    ],
    ids=["walk", "all", "gain", "friction", "attitude"],
)
def test_sigma_covers_what_all_samples_share(known: dict[str, float], gait: str) -> None:
    assert 0.60 < covered(replace(Priors(), **known), gait=gait) < 0.76


def test_noise_is_what_remains_without_shared_errors() -> None:
    log, _ = Walk(duration=2.0).log()
    with_all, without = estimate(log, robot=GO2), estimate(log, robot=GO2, priors=NONE)
    np.testing.assert_array_equal(with_all.force, without.force)
    np.testing.assert_array_equal(with_all.noise, without.noise)
    np.testing.assert_allclose(without.sigma, without.noise, rtol=1e-6)
    assert (with_all.sigma >= with_all.noise).all()
