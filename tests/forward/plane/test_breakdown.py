"""When a solution breaks down: the steps, the particle, the likely cause, the last good state."""

from __future__ import annotations

import re

import numpy as np
import pytest

from terraphi.experiment.errors import SimulationError
from terraphi.forward.breakdown import account_of, is_whole, likely_cause
from terraphi.forward.driver import BLOCK, _Blocks, simulate, step_count
from terraphi.forward.state import copy_of, first_state, flawed_particle
from terraphi.forward.watch import Checkpoint

SWELLING = {
    "soil.yield_criterion": "plane_strain",
    "soil.flow": "associated",
    "soil.friction_angle_deg": 45.0,
    "numerics.particle_volume": "updated",
}
"""Associated flow at c = 0 and a large angle, whose particles swell with the soil."""
ENTERING = {"motion.start_deg": -130.0, "motion.stop_deg": -20.0}


def told_of(scenario, **options) -> str:
    with pytest.raises(SimulationError) as caught:
        simulate(scenario, **options)
    message = str(caught.value)
    assert "\n" not in message
    return message


def steps_in(message: str) -> tuple[int, int]:
    found = re.search(r"broke down between steps (\d+) and (\d+) of", message)
    assert found
    return int(found[1]), int(found[2])


@pytest.mark.parametrize("kernel", ["packets", "scalar"])
def test_swelling_soil_is_named_with_step_particle_and_state(coarse, tmp_path, kernel) -> None:
    scenario = coarse(**ENTERING, **SWELLING)
    kept = Checkpoint(tmp_path / "c", every=1e9)
    message = told_of(scenario, checkpoint=kept, kernel=kernel)
    begin, end = steps_in(message)
    assert 0 < begin < end <= step_count(scenario)
    assert begin % BLOCK == 0
    assert end - begin <= BLOCK
    place = re.findall(r"time ([\d.]+) s, theta = (-[\d.]+) deg", message)
    for step, (time, theta) in zip((begin, end), place, strict=True):
        assert float(time) == pytest.approx(step * 5e-5, rel=1e-3)
        turned = np.degrees(0.2 * 20.0 * step * 5e-5)
        assert float(theta) == pytest.approx(-130.0 + turned, abs=0.1)
    assert re.search(
        r"particle \d+ (left the grid|has no volume left|has a velocity or a stress that is not a "
        r"number) near x = -?[\d.]+ mm, z = -?[\d.]+ mm; likely cause: ",
        message,
    )
    assert "associated flow (dilation angle 45 deg) makes sheared soil swell" in message
    assert "take particle_volume = 'fixed'" in message
    # The last good state is there, although it was not yet time for a checkpoint, and from it the
    # same thing happens again.
    assert f"the last good state, before step {begin}, is in {kept.path}" in message
    looks = []
    again = told_of(scenario, checkpoint=kept, kernel=kernel, observe=looks.append)
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
def test_it_is_between_these_steps_that_the_solution_breaks_down(coarse, kernel) -> None:
    scenario = coarse(**SWELLING)
    begin, end = steps_in(told_of(scenario, kernel=kernel))
    blocks = _Blocks(scenario, kernel)
    assert begin == 0 or is_whole(*blocks.take(first_state(scenario), begin))
    assert not is_whole(*blocks.take(first_state(scenario), end))


def test_the_first_block_has_no_state_to_keep(coarse, tmp_path) -> None:
    kept = Checkpoint(tmp_path / "c")
    message = told_of(coarse(**SWELLING), checkpoint=kept)
    assert message.endswith("the last good state is the first one")
    assert list(tmp_path.iterdir()) == []


def test_soil_that_rises_to_the_top_of_the_grid(coarse) -> None:
    """Fixed volumes swell all the same, and push the surface up."""
    scenario = coarse(
        **{**SWELLING, "numerics.particle_volume": "fixed"},
        **{"motion.start_deg": -100.0, "motion.stop_deg": 30.0},
    )
    message = told_of(scenario)
    assert "left the grid" in message
    assert "soil has risen to the top of the grid, 130 mm above the first surface" in message
    assert "raise numerics.domain" in message


def test_a_step_that_is_too_long(coarse) -> None:
    scenario = coarse()
    numerics = scenario.numerics.model_copy(update={"time_step": 2e-4})
    message = told_of(scenario.model_copy(update={"numerics": numerics}))
    assert "numerics.time_step = 0.0002 s is above the limit of stability, 6.59e-05 s" in message


# -- the causes, on states made for them ---------------------------------------------------------


def test_causes_of_states_made_for_them(coarse) -> None:
    plain, updated = coarse(), coarse(**{"numerics.particle_volume": "updated"})
    quiet = first_state(plain)
    middle = int(np.argmin(np.abs(quiet.soil.position - 0.1).sum(axis=1)))
    assert "none of the usual" in likely_cause(plain, quiet, middle)

    fast = copy_of(quiet)
    fast.soil.velocity[7] = 300.0, 400.0
    fast.soil.velocity[8] = np.nan
    cause = likely_cause(plain, fast, middle)
    assert "particle 7 moves at 500 m/s, where compression waves run at 127.7 m/s" in cause
    courant = (127.738 + 500.0) * 5e-5 / (0.3 / 32)
    assert f"Courant number of {courant:.3g}" in cause

    squashed = copy_of(quiet)
    squashed.soil.stretch[3] = 0.01
    squashed.soil.stretch[4] = np.nan
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


def test_what_is_not_a_number_is_named_where_it_was_last(coarse) -> None:
    scenario = coarse()
    before = first_state(scenario)
    after = copy_of(before)._replace(step=400)
    after.soil.position[20] = after.soil.stress[20] = np.nan
    x, z = 1e3 * before.soil.position[20]
    message = account_of(scenario, before, after, -1, 800)
    assert "between steps 0 and 400 of 800 (time 0 s" in message
    assert "particle 20 has a velocity or a stress that is not a number near " in message
    assert f"near x = {x:.2f} mm, z = {z:.2f} mm; likely cause: none of the usual" in message

    sound = copy_of(before)._replace(step=400)
    sound.impulse[0, 0] = np.nan
    message = account_of(scenario, before, sound, -1, 800)
    assert ": the force on the leg is not a number; likely cause: " in message
