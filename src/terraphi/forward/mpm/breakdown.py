"""Why a solution broke down: the step, the particle, what it was like, and the likely cause."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.scenario import Scenario
from terraphi.forward.mpm.state import State, flawed_particle

FloatArray = NDArray[np.float64]

SWOLLEN = 2.0
"""Volume ratio J beyond which soil has come apart [-]."""
SQUASHED = 0.2
"""Volume ratio J below which soil has been pressed to nothing [-]."""

Steps = Callable[[int], tuple[State, int]]
"""Takes so many steps from the start of the last block; the state then, and who left the grid."""


@dataclass(frozen=True)
class Breakdown:
    """Where a solution broke down.

    Attributes
    ----------
    step
        The step that failed, the first being 0.
    place
        Time and place on the path, for people.
    particle
        Index of the particle that shows it.
    what
        What happened to it.
    position
        (x, z) before that step [m].
    velocity
        (x, z) before that step [m/s].
    stress
        (σ_xx, σ_zz, σ_xz, σ_yy) before that step [Pa].
    stretch
        Volume ratio J before that step [-].
    cause
        The likely cause, and what to do about it.
    """

    step: int
    place: str
    particle: int
    what: str
    position: FloatArray
    velocity: FloatArray
    stress: FloatArray
    stretch: float
    cause: str

    def sentence(self, steps: int) -> str:
        """All of it for people; ``steps`` is the number of steps in all."""
        x, z = 1e3 * self.position
        sxx, szz, sxz, _ = 1e-3 * self.stress
        return (
            f"the solution broke down at step {self.step} of {steps} ({self.place}): "
            f"particle {self.particle} {self.what}; before that it was at x = {x:.2f} mm, "
            f"z = {z:.2f} mm with velocity ({self.velocity[0]:.4g}, {self.velocity[1]:.4g}) m/s, "
            f"stress (xx {sxx:.4g}, zz {szz:.4g}, xz {sxz:.4g}) kPa and volume ratio "
            f"{self.stretch:.4g}; likely cause: {self.cause}"
        )


def find_breakdown(scenario: Scenario, start: State, count: int, take: Steps) -> Breakdown:
    """Find the step at which a block of steps fails, by bisection.

    The same kernel takes fewer steps from the same start: but for the last of them, which it
    finishes in another way, these are the same steps to the last bit.

    Parameters
    ----------
    scenario
        What is simulated.
    start
        State before the block.
    count
        Number of steps of the block, which fails.
    take
        Takes steps from the start.

    Returns
    -------
    Breakdown
    """
    fine, before, failing = 0, start, count
    state, lost = take(count)
    while failing - fine > 1:
        middle = (fine + failing) // 2
        tried, left = take(middle)
        if is_whole(tried, left):
            fine, before = middle, tried
        else:
            failing, state, lost = middle, tried, left
    flawed = flawed_particle(state.soil)
    particle = lost if lost >= 0 else max(flawed, 0)
    soil, step = before.soil, start.step + fine
    return Breakdown(
        step=step,
        place=_place(scenario, step),
        particle=particle,
        what=_what(state, lost, flawed),
        position=soil.position[particle],
        velocity=soil.velocity[particle],
        stress=soil.stress[particle],
        stretch=float(soil.stretch[particle]),
        cause=likely_cause(scenario, before, particle),
    )


def is_whole(state: State, lost: int) -> bool:
    """Whether a state can be: nobody has left the grid, and all numbers are numbers."""
    return lost < 0 and flawed_particle(state.soil) < 0 and bool(np.isfinite(state.impulse).all())


def likely_cause(scenario: Scenario, before: State, particle: int) -> str:
    """What most likely has gone wrong, and what to do about it.

    Parameters
    ----------
    scenario
        What is simulated.
    before
        State before the step that fails.
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
    return (
        _volume_cause(scenario, before, particle)
        or _speed_cause(scenario, before)
        or _edge_cause(scenario, before.soil.position[particle])
    )


def _volume_cause(scenario: Scenario, before: State, particle: int) -> str:
    """Volumes that follow the deformation to where there is no soil any more; or nothing."""
    if scenario.numerics.particle_volume == "fixed":
        return ""
    low, high = float(before.soil.stretch.min()), float(before.soil.stretch.max())
    if high > SWOLLEN and scenario.soil.potential_angle_deg > 0.0:
        return (
            f"{_dilation(scenario)} makes sheared soil swell without end, and with "
            f"numerics.particle_volume = 'updated' its particles with it (volume ratio up to "
            f"{high:.3g}, cohesion {scenario.soil.cohesion:g} Pa); take particle_volume = 'fixed', "
            "or soil.flow = 'dilation' with a small soil.dilation_angle_deg"
        )
    own = float(before.soil.stretch[particle])
    if own > SWOLLEN:
        return (
            f"numerics.particle_volume = 'updated' has let loose soil swell: this particle to "
            f"{own:.3g} times its volume; take particle_volume = 'fixed'"
        )
    if low < SQUASHED:
        return (
            f"numerics.particle_volume = 'updated' has pressed a particle to {low:.3g} of its "
            "volume; take particle_volume = 'fixed', or a smaller numerics.time_step"
        )
    return ""


def _speed_cause(scenario: Scenario, before: State) -> str:
    """A particle that outruns what the time step can follow; or nothing."""
    speed = np.hypot(*before.soil.velocity.T)
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
    if gaps[side] > 3.0 * scenario.numerics.cell_size:
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


def _what(after: State, lost: int, flawed: int) -> str:
    if lost >= 0:
        return "left the grid"
    if flawed < 0:
        return "is as it should be, yet the force on the leg is not a number"
    if not after.soil.stretch[flawed] > 0.0:
        return "has no volume left"
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
