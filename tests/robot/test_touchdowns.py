"""Touch-downs of a foot whose way and force are known."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from terraphi.robot.stance import Stance
from terraphi.robot.touchdowns import touchdowns


def test_a_foot_that_drops_in_and_rests_began_where_it_first_met_force() -> None:
    """18 mm in 40 ms under up to 20 N, 0.2 s at 5 N, then 10 mm more; the stance begins late."""
    time = np.arange(0.0, 0.9, 0.002)
    feet = np.zeros((len(time), 4, 3))
    feet[:, 0, 2] = np.interp(
        time, [0.0, 0.3, 0.34, 0.54, 0.64], [0.135, 0.0, -0.018, -0.018, -0.028]
    )
    force = np.zeros((len(time), 4, 3))
    force[:, 0, 2] = np.interp(time, [0.3, 0.34, 0.35, 0.54, 0.55, 0.64], [0, 20, 5, 5, 20, 80])
    forces = SimpleNamespace(force=force, saturated=np.zeros((len(time), 4), dtype=bool))
    stance = Stance("FR", time[272:440], force[272:440, 0])
    seen = touchdowns(
        SimpleNamespace(time=time), forces, SimpleNamespace(feet=feet), [stance],
        np.zeros((len(time), 4, 6)), radius=0.022,
    )  # fmt: skip
    assert seen.begin[0] == pytest.approx(0.305, abs=0.004)  # where it bore 2.5 N
    used = seen.used[0]
    assert seen.drop[0][used].max() > 0.024
    resting = (seen.time[0] > 0.06) & (seen.time[0] < 0.22)
    assert not (used & resting).any()


def test_a_foot_that_goes_down_aslant_is_seen_as_it_went() -> None:
    """0.3 m/s forward and 0.4 m/s down until 50 ms after it touched the soil."""
    time, radius = np.arange(0.0, 0.4, 0.002), 0.022
    moving = np.minimum(time, 0.25)[:, None]
    feet = np.zeros((len(time), 4, 3))
    feet[:, 1] = [0.2, 0.1, 0.1] + moving * [0.3, 0.0, -0.4]
    force = np.zeros((len(time), 4, 3))
    force[:, 1, 2] = 1000.0 * np.clip(time - 0.2, 0.0, 0.05)
    per = np.zeros((len(time), 4, 6))
    forces = SimpleNamespace(force=force, saturated=np.zeros((len(time), 4), dtype=bool))
    stance = Stance("FL", time[100:180], force[100:180, 1])
    seen = touchdowns(
        SimpleNamespace(time=time), forces, SimpleNamespace(feet=feet), [stance], per,
        radius=radius,
    )  # fmt: skip
    steady = seen.used[0] & (seen.time[0] < 0.044)
    assert steady.sum() > 20
    assert seen.drop[0][steady] == pytest.approx(0.4 * seen.time[0][steady])
    assert seen.descent[0][steady] == pytest.approx(np.arctan2(0.4, 0.3))
    assert seen.speed[0][steady] == pytest.approx(0.5)
    assert seen.force[0][steady] == pytest.approx(1000.0 * seen.time[0][steady].clip(0.0))
    # The place is that of the ball's lowest point when it comes to rest.
    rests = [0.275, 0.1, 0.0 - radius]
    assert seen.place[0] == pytest.approx(rests, abs=2e-3)
    assert not seen.torn[0]
