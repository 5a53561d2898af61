"""Why a solution broke down: what happened to which particle, where, and which key to change.

A kernel stops at the first particle that leaves the grid, and a number that is none spreads until
one does, so that the particles are left as they were at the failing step or a few steps later.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.scenario import Scenario
from terraphi.forward.state import State, flawed_particle

FloatArray = NDArray[np.float64]


def account_of(scenario: Scenario, before: State, after: State, lost: int, steps: int) -> str:
    """One sentence about a breakdown, for people.

    Parameters
    ----------
    scenario
        What is simulated.
    before
        The last good state.
    after
        The state in which the block of steps after it was left.
    lost
        Index of the particle that left the grid, or -1.
    steps
        Number of steps of the whole simulation.

    Returns
    -------
    str
        Between which steps, particle and place, the likely cause and what to do about it.
    """
    flawed = flawed_particle(after.soil)
    particle = lost if lost >= 0 else max(flawed, 0)
    position = after.soil.position[particle]
    if not np.isfinite(position).all():
        position = before.soil.position[particle]
    what = _what(lost, flawed)
    if particle in (lost, flawed):
        x, z = 1e3 * position
        what = f"particle {particle} {what} near x = {x:.2f} mm, z = {z:.2f} mm"
    return (
        f"the solution broke down between steps {before.step} and {after.step} of {steps} "
        f"({_place(scenario, before.step)} to {_place(scenario, after.step)}): {what}; "
        f"likely cause: {likely_cause(scenario, after, particle)}"
    )


def is_whole(state: State, lost: int) -> bool:
    """Whether a state can be: nobody has left the grid, and all numbers are numbers."""
    return lost < 0 and flawed_particle(state.soil) < 0 and bool(np.isfinite(state.impulse).all())


def likely_cause(scenario: Scenario, after: State, particle: int) -> str:
    """What most likely has gone wrong, and what to do about it.

    Parameters
    ----------
    scenario
        What is simulated.
    after
        State in which the failing steps were left.
    particle
        Index of the particle that shows it.

    Returns
    -------
    str
    """
    limit, time_step = scenario.time_step_limit, scenario.numerics.time_step
    if time_step > limit:
        return (
            f"numerics.time_step = {time_step:g} s is above the limit of stability, {limit:.3g} s; "
            "take a smaller numerics.time_step"
        )
    return _speed_cause(scenario, after.soil.velocity) or _edge_cause(
        scenario, after.soil.position[particle]
    )


def _speed_cause(scenario: Scenario, velocity: FloatArray) -> str:
    """A particle that outruns what the time step can follow; or nothing."""
    # A velocity that is not a number is what came of it, not its cause.
    speed = np.nan_to_num(np.hypot(*velocity.T), nan=0.0, posinf=0.0)
    fastest = int(speed.argmax())
    wave, numerics = scenario.soil.p_wave_speed, scenario.numerics
    courant = (wave + speed[fastest]) * numerics.time_step / numerics.cell_size
    if courant <= 1.0 and speed[fastest] <= wave:
        return ""
    return (
        f"particle {fastest} moves at {speed[fastest]:.4g} m/s, where compression waves run at "
        f"{wave:.4g} m/s: a Courant number of {courant:.3g}; take a smaller numerics.time_step"
    )


def _edge_cause(scenario: Scenario, position: FloatArray) -> str:
    """How a particle without any other peculiarity came to leave the grid."""
    bed, size = scenario.bed, scenario.numerics.domain
    gaps = {
        "left": position[0],
        "right": size - position[0],
        "floor": position[1],
        "top": size - position[1],
    }
    side = min(gaps, key=gaps.__getitem__)
    if not np.isfinite(position).all() or gaps[side] > 3.0 * scenario.numerics.cell_size:
        return "none of the usual ones; try a smaller numerics.time_step"
    if side == "top":
        swelling = (
            f", where {_dilation(scenario)} lifts it; lower the dilation, or raise"
            if scenario.soil.potential_angle_deg > 0.0
            else "; raise"
        )
        return (
            f"soil has risen to the top of the grid, {1e3 * (size - bed.surface):.0f} mm above the "
            f"first surface{swelling} numerics.domain"
        )
    wall = {"left": "bed.left", "right": "bed.left + bed.width", "floor": "bed.floor"}[side]
    return (
        f"soil has been pressed through the wall at {wall}, less than two cells of "
        f"{1e3 * scenario.numerics.cell_size:.2g} mm from the edge of the grid; take more "
        "numerics.cells, or move the wall inwards"
    )


def _dilation(scenario: Scenario) -> str:
    soil = scenario.soil
    if soil.flow == "associated":
        return f"associated flow (dilation angle {soil.potential_angle_deg:g} deg)"
    return f"a dilation angle of {soil.potential_angle_deg:g} deg"


def _what(lost: int, flawed: int) -> str:
    if lost >= 0:
        return "left the grid"
    if flawed < 0:
        return "the force on the leg is not a number"
    return "has a velocity or a stress that is not a number"


def _place(scenario: Scenario, step: int) -> str:
    """Time and place on the path at a step."""
    time = step * scenario.numerics.time_step
    at = np.array([time * scenario.numerics.speed_up])
    value = float(scenario.motion.coordinates(at)[0])
    where = (
        f"theta = {math.degrees(value):.1f} deg"
        if scenario.motion.coordinate == "theta"
        else f"displacement = {value * 1e3:.2f} mm"
    )
    return f"time {time:.5g} s, {where}"
