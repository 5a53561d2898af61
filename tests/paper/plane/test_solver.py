"""Whole simulations: signs, symmetry, scaling, repeatability, books, and how they fail."""

from __future__ import annotations

import hashlib
import math
import os
import pickle
import subprocess
import sys

import numpy as np
import pytest

from terraphi.experiment.errors import SimulationError
from terraphi.experiment.scenario import GRAVITY
from terraphi.forward.driver import path_of_steps, simulate
from terraphi.forward.forecast import step_count
from terraphi.laws.build import run_case


@pytest.fixture(name="sweep", scope="module")
def _sweep(coarse):
    """A coarse straight leg from entry to just behind the vertical."""
    motion = {"motion.start_deg": -100.0, "motion.stop_deg": 30.0}
    return simulate(coarse(**motion, **{"relief.enabled": False}))


def test_signs_are_those_of_li(sweep):
    """Going down the leg is lifted; through the vertical it is thrust forward."""
    down = sweep.means(np.radians(np.arange(-70.0, -29.0)), math.radians(0.5))
    across = sweep.means(np.radians(np.arange(-20.0, 11.0)), math.radians(0.5))
    assert down[:, 1].min() > 0
    assert across[:, 0].min() > 0
    # Before its tip comes near the surface there is nothing to feel.
    assert not sweep.force[sweep.theta_deg < -95].any()


def test_books_close(sweep):
    impulse = sweep.provenance["impulse_kg_m_s"]
    assert sweep.provenance["momentum_mismatch"] < 1e-10
    time = sweep.provenance["steps"] * 5e-5
    weight = 1650.0 * 0.280 * 0.160 * 0.0254 * GRAVITY
    assert impulse["gravity"][1] == pytest.approx(-weight * time, rel=1e-9)
    # The force on the leg is, per bin, what it gave to the soil.
    seconds = math.radians(0.1) / (0.2 * 20.0)
    np.testing.assert_allclose(
        sweep.force.sum(axis=0) * seconds, -np.array(impulse["leg"]), rtol=0.01, atol=1e-6
    )


def bits_of(history) -> str:
    return hashlib.sha256(history.force.tobytes()).hexdigest()


def bits_in_another_process(scenario, **environment: str) -> str:
    """Of a case as executors send it to workers, which import what the pickle names alone.

    They have the extra ``simulate``, and not what else ``terraphi paper`` needs.
    """
    script = (
        "import hashlib, pickle, sys\n"
        "sys.modules['matplotlib'] = None\n"
        "function, arguments = pickle.load(sys.stdin.buffer)\n"
        "print(hashlib.sha256(function(*arguments).force.tobytes()).hexdigest())\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script],
        input=pickle.dumps((run_case, (scenario.model_dump_json(), "no-such-folder/checkpoint"))),
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), **environment},
        capture_output=True,
        check=True,
    )
    return done.stdout.decode().strip()


def test_same_run_gives_the_same_bits(coarse):
    first = bits_of(simulate(coarse()))
    assert bits_of(simulate(coarse())) == first
    assert bits_in_another_process(coarse()) == first


@pytest.mark.slow
def test_bits_do_not_depend_on_where_the_machine_code_came_from(coarse, tmp_path):
    """Compiled a moment ago, or read from the cache: it must be the same code that runs."""
    environment = {"NUMBA_CACHE_DIR": str(tmp_path)}
    compiled = bits_in_another_process(coarse(), **environment)
    assert any(tmp_path.rglob("*.nbc"))
    assert bits_in_another_process(coarse(), **environment) == compiled


def test_force_scales_with_density_and_stiffness_together(coarse):
    """Without cohesion a bed twice as heavy and stiff pushes twice as hard, to the last bit."""
    once = simulate(coarse())
    twice = simulate(coarse(**{"soil.density": 3300.0, "soil.youngs_modulus": 40e6}))
    assert np.array_equal(twice.force, 2.0 * once.force)


def test_stronger_soil_pushes_harder(coarse):
    weak, strong = (
        simulate(coarse(**{"soil.friction_angle_deg": phi})).Fz.mean() for phi in (25.0, 40.0)
    )
    assert 0 < weak < strong


def plate(coarse, direction: float):
    """A plate that leaves the middle of a lattice bed to the right (1) or to the left (-1)."""
    return simulate(
        coarse(
            **{
                "numerics.particle_jitter": 0.0,
                "leg.shape": "plate",
                "leg.chord": 0.05,
                "motion": {
                    "kind": "translation",
                    "start": [0.150 + direction * 1e-3, 0.175],
                    "velocity": [direction * 0.02, 0.0],
                    "distance": 0.004,
                },
            }
        )
    )


def test_right_and_left_are_mirror_images(coarse):
    right, left = plate(coarse, 1.0), plate(coarse, -1.0)
    size = np.abs(right.force).max()
    assert right.Fx[5:].max() < 0 < left.Fx[5:].min()
    np.testing.assert_allclose(right.Fx, -left.Fx, atol=1e-6 * size)
    np.testing.assert_allclose(right.Fz, left.Fz, atol=1e-6 * size)


def test_path_moves_as_its_velocities_say(coarse):
    scenario = coarse(
        motion={
            "kind": "rotation",
            "start_deg": -60.0,
            "stop_deg": -50.0,
            "rate": 0.2,
        }
    )
    count = step_count(scenario)
    poses, turned, bins = path_of_steps(scenario, np.arange(count), 100)
    theta, rate = poses[:, 2], poses[:, 5]
    np.testing.assert_allclose(np.diff(theta) / 5e-5, 0.5 * (rate[1:] + rate[:-1]), rtol=1e-3)
    assert math.degrees(theta[0]) == pytest.approx(-60.0)
    assert math.degrees(theta[-1] + rate[-1] * 5e-5) == pytest.approx(-50.0, abs=0.02)
    assert rate.max() == pytest.approx(0.2 * 20.0, rel=1e-3)
    assert not turned.any()
    assert (np.diff(bins) >= 0).all()
    assert set(bins) == set(range(100))
    # The middle of each step lies in its bin of 0.1°.
    past = np.degrees(0.5 * (theta[1:] + theta[:-1])) + 60.0 - 0.1 * bins[:-1]
    assert ((past > -1e-4) & (past < 0.1 + 1e-4)).all()


def test_too_long_a_step_breaks_down_and_says_why(coarse):
    scenario = coarse()
    numerics = scenario.numerics.model_copy(update={"time_step": 2e-4})
    words = (
        r"broke down between steps 0 and \d+ of .*left the grid.*likely cause: "
        r"numerics\.time_step.* above the limit of stability"
    )
    with pytest.raises(SimulationError, match=words):
        simulate(scenario.model_copy(update={"numerics": numerics}))


def test_soil_that_dilates_without_end_rises_to_the_top_of_the_grid(coarse):
    scenario = coarse(
        **{"soil.yield_criterion": "plane_strain", "soil.flow": "associated"},
        **{"soil.friction_angle_deg": 45.0, "motion.start_deg": -100.0, "motion.stop_deg": 30.0},
    )
    with pytest.raises(SimulationError, match=r"left the grid.*or raise numerics\.domain"):
        simulate(scenario)


@pytest.mark.slow
def test_particle_places_matter_little_over_a_whole_sweep(coarse):
    """Two beds that differ in nothing but the places of their particles, 1° means."""
    runs = [
        simulate(
            coarse(
                **{
                    "numerics.cells": 64,
                    "numerics.time_step": 2.5e-5,
                    "numerics.seed": seed,
                    "motion.start_deg": -135.0,
                    "motion.stop_deg": 135.0,
                }
            )
        )
        for seed in (0, 1)
    ]
    centre = np.radians(np.arange(-85.0, 86.0))
    first, other = (run.means(centre, math.radians(0.5)) for run in runs)
    for axis in range(2):
        change = np.abs(first[:, axis] - other[:, axis])
        assert np.sqrt((change**2).mean()) < 0.05 * np.abs(first[:, axis]).max()
        assert change.max() < 0.25 * np.abs(first[:, axis]).max()
    for run in runs:
        assert run.provenance["momentum_mismatch"] < 1e-10
        assert run.peaks().theta_Fz_deg < run.peaks().theta_Fx_deg
