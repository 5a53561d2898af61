"""When a solution breaks down: the step, the particle, the likely cause, the last good state."""

from __future__ import annotations

import re

import numpy as np
import pytest

from terraphi.experiment.errors import SimulationError
from terraphi.forward.mpm import packets, scalar
from terraphi.forward.mpm.breakdown import find_breakdown, is_whole, likely_cause
from terraphi.forward.mpm.solver import BLOCK, _Blocks, simulate, step_count
from terraphi.forward.mpm.state import copy_of, first_state, flawed_particle
from terraphi.forward.watch import Checkpoint

SWELLING = {
    "soil.yield_criterion": "plane_strain",
    "soil.flow": "associated",
    "soil.friction_angle_deg": 45.0,
    "numerics.particle_volume": "updated",
}
"""Associated flow at c = 0 and a large angle, whose particles swell with the soil."""
ENTERING = {"motion.start_deg": -130.0, "motion.stop_deg": -20.0}


def account_of(scenario, **options) -> str:
    with pytest.raises(SimulationError) as caught:
        simulate(scenario, **options)
    message = str(caught.value)
    assert "\n" not in message
    return message


def step_in(message: str) -> int:
    found = re.search(r"broke down at step (\d+) of", message)
    assert found
    return int(found[1])


@pytest.mark.parametrize("kernel", ["packets", "scalar"])
def test_swelling_soil_is_named_with_step_particle_and_state(coarse, tmp_path, kernel) -> None:
    scenario = coarse(**ENTERING, **SWELLING)
    kept = Checkpoint(tmp_path / "c", every=1e9)
    message = account_of(scenario, checkpoint=kept, kernel=kernel)
    step = step_in(message)
    assert BLOCK < step < step_count(scenario)
    place = re.search(r"time ([\d.]+) s, theta = (-[\d.]+) deg", message)
    assert place
    assert float(place[1]) == pytest.approx(step * 5e-5, rel=1e-3)
    turned = np.degrees(0.2 * 20.0 * step * 5e-5)
    assert float(place[2]) == pytest.approx(-130.0 + turned, abs=0.1)
    assert re.search(
        r"particle \d+ (left the grid|has no volume left|has a velocity or a stress that is not); ?"
        r".*x = [\d.]+ mm, z = [\d.]+ mm.*velocity \(.*\) m/s, stress \(xx .*\) kPa and volume "
        r"ratio [\d.e+]+",
        message,
    )
    assert "associated flow (dilation angle 45 deg) makes sheared soil swell" in message
    assert "take particle_volume = 'fixed'" in message
    # The last good state is there, although it was not yet time for a checkpoint, and from it the
    # same thing happens again.
    begin = step // BLOCK * BLOCK
    assert f"the last good state, before step {begin}, is in {kept.path}" in message
    looks = []
    again = account_of(scenario, checkpoint=kept, kernel=kernel, observe=looks.append)
    assert looks[0].step == begin
    assert again == message


def test_the_remedies_that_are_named_help(coarse) -> None:
    """Both together: one alone lets some roundings through and not others."""
    remedy = {
        "soil.flow": "dilation",
        "soil.dilation_angle_deg": 0.0,
        "numerics.particle_volume": "fixed",
    }
    history = simulate(coarse(**{**ENTERING, **SWELLING, **remedy}))
    assert np.isfinite(history.force).all()


@pytest.mark.parametrize("kernel", ["packets", "scalar"])
def test_the_step_is_the_first_that_fails(coarse, kernel) -> None:
    """One step at a time, which is the plain way to find it."""
    scenario = coarse(**SWELLING)
    step = step_in(account_of(scenario, kernel=kernel))
    blocks = _Blocks(scenario, kernel)
    for count, fine in ((step, True), (step + 1, False), (step_count(scenario), False)):
        assert is_whole(*blocks.take(first_state(scenario), count)) is fine


def test_the_first_block_has_no_state_to_keep(coarse, tmp_path) -> None:
    kept = Checkpoint(tmp_path / "c")
    message = account_of(coarse(**SWELLING), checkpoint=kept)
    assert message.endswith("the last good state is the first one")
    assert list(tmp_path.iterdir()) == []


def test_soil_that_rises_to_the_top_of_the_grid(coarse) -> None:
    """Fixed volumes swell all the same, and push the surface up."""
    scenario = coarse(
        **{**SWELLING, "numerics.particle_volume": "fixed"},
        **{"motion.start_deg": -100.0, "motion.stop_deg": 30.0},
    )
    message = account_of(scenario)
    assert "left the grid" in message
    assert "soil has risen to the top of the grid, 130 mm above the first surface" in message
    assert "raise numerics.domain" in message


def test_a_step_that_is_too_long(coarse) -> None:
    scenario = coarse()
    numerics = scenario.numerics.model_copy(update={"time_step": 2e-4})
    message = account_of(scenario.model_copy(update={"numerics": numerics}))
    assert "numerics.time_step = 0.0002 s is above the limit of stability, 6.59e-05 s" in message


# -- the causes, on states made for them ---------------------------------------------------------


def test_causes_of_states_made_for_them(coarse) -> None:
    plain, updated = coarse(), coarse(**{"numerics.particle_volume": "updated"})
    quiet = first_state(plain)
    middle = int(np.argmin(np.abs(quiet.soil.position - 0.1).sum(axis=1)))
    assert "none of the usual" in likely_cause(plain, quiet, middle)

    fast = copy_of(quiet)
    fast.soil.velocity[7] = 300.0, 400.0
    cause = likely_cause(plain, fast, middle)
    assert "particle 7 moves at 500 m/s, where compression waves run at 127.7 m/s" in cause
    courant = (127.738 + 500.0) * 5e-5 / (0.3 / 32)
    assert f"Courant number of {courant:.3g}" in cause

    squashed = copy_of(quiet)
    squashed.soil.stretch[3] = 0.01
    assert "pressed a particle to 0.01 of its volume" in likely_cause(updated, squashed, 3)
    # Loose spray of soil that does not dilate may well take more room; no cause for others.
    spray = copy_of(quiet)
    spray.soil.stretch[3] = 10.0
    assert "none of the usual" in likely_cause(updated, spray, middle)
    assert "let loose soil swell: this particle to 10 times" in likely_cause(updated, spray, 3)

    for place, words in {
        (0.004, 0.1): "through the wall at bed.left,",
        (0.296, 0.1): "through the wall at bed.left + bed.width,",
        (0.15, 0.004): "through the wall at bed.floor,",
        (0.15, 0.299): "risen to the top of the grid, 130 mm above the first surface; raise",
    }.items():
        edge = copy_of(quiet)
        edge.soil.position[5] = place
        assert words in likely_cause(plain, edge, 5)


@pytest.mark.parametrize("field", ["position", "velocity", "gradient", "stress", "stretch"])
def test_a_particle_that_cannot_be_is_found(coarse, field) -> None:
    soil = first_state(coarse()).soil
    assert flawed_particle(soil) == -1
    getattr(soil, field)[11] = np.nan
    assert flawed_particle(soil) == 11
    soil.stretch[4] = 0.0
    assert flawed_particle(soil) == 4


@pytest.mark.parametrize("advance", [packets.advance, scalar.advance])
@pytest.mark.parametrize("at", [0, 1, 37, 399])
def test_bisection_finds_the_step_at_which_a_stress_is_lost(coarse, at, advance) -> None:
    """A kernel that loses one stress at a known step; no particle has left the grid by then."""
    scenario = coarse()
    start = first_state(scenario)
    runs = []

    def take(count: int):
        runs.append(count)
        state = copy_of(start)._replace(step=count)
        if count > at:
            state.soil.stress[20, 2] = np.nan
        return state, -1

    found = find_breakdown(scenario, start, 400, take)
    assert (found.step, found.particle) == (at, 20)
    assert "not a number" in found.what
    assert len(runs) <= 11
