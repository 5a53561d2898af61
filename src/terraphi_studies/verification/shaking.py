"""Whether soil that flows is at yield: what shakes in the numerics weakens it.

Soil without cohesion that is sheared bears all the strength that its pressure lets it have. At the
end of a phase particles move, and their stresses no longer balance on the grid; nothing in a phase
damps the waves that set in. Soil that shakes is at yield for a part of the time only, bears less,
and the force on the leg is too low: by a fifth at 40° and by more than a half at 50°, though it
still bears 97 and 86 % of its strength. `numerics.stiffness_damping` stops it.

Counted is soil whose plastic shear strain grows by more than 0.3 in a second of the leg's own
motion, under more than 200 Pa, at the end of each phase.
"""

from __future__ import annotations

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.scenario import Scenario
from terraphi.forward.mpm.bed import Soil
from terraphi.forward.mpm.solver import Blocks
from terraphi.library.plan import Plan
from terraphi.library.workers import heartbeat
from terraphi_studies.verification.check import Check, Outcome, Task

PATH_DEG, FIRST_DEG = (-80.0, -40.0), -50.0
"""Leg angles from which to which the leg turns, and from which on soil is looked at [deg]."""
SHEARED, LOADED = 0.3, 200.0
"""Rate of plastic shear strain [1/s] and mean stress [Pa] above which soil counts."""


def strength_borne(scenario: Scenario) -> float:
    """Mobilised sin φ over sin φ of soil that is sheared, weighed by its mean stress [-].

    Parameters
    ----------
    scenario
        Of a leg in three dimensions whose soil has no cohesion.

    Raises
    ------
    ArithmeticError
        If the solution breaks down, or no soil is sheared under load.
    """
    blocks, numerics = Blocks(scenario, "packets"), scenario.numerics
    state, steps = blocks.first_state(), numerics.steps_per_phase
    own_time = steps * numerics.time_step * numerics.speed_up
    first, last = np.radians(np.array([FIRST_DEG, PATH_DEG[1]]) - PATH_DEG[0])
    borne = due = turned = 0.0
    while turned < last:
        assert isinstance(state.soil, Soil)
        before = state.soil.strain.astype(np.float64)
        state, lost = blocks.take(state, steps)
        if not blocks.is_whole(state, lost):
            raise ArithmeticError("the solution broke down")
        heartbeat(0.0)
        turned += scenario.motion.top_coordinate_rate * own_time
        if turned > first:
            grown = (state.soil.strain - before) / own_time
            stress = _principal(state.soil.stress[grown > SHEARED].astype(np.float64))
            stress = stress[(stress.mean(axis=1) > LOADED) & (stress[:, 0] > 0.0)]
            weight = stress.mean(axis=1)
            borne += float(weight @ mobilised_sine(stress, scenario.soil.yield_surface))
            due += float(weight.sum())
    if due == 0.0:
        raise ArithmeticError("no soil is sheared under load")
    return borne / due / float(np.sin(np.radians(scenario.soil.friction_angle_deg)))


def mobilised_sine(stress: FloatArray, surface: str) -> FloatArray:
    """Sine of the friction angle of plane strain on whose surface stresses lie [-].

    Parameters
    ----------
    stress
        Principal stresses, pressure positive, smallest first [Pa], shape [..., 3].
    surface
        ``mohr_coulomb``, or ``matsuoka_nakai``: I₁ I₂ / I₃ = 9 + 6 tan² φ.
    """
    low, middle, high = np.moveaxis(stress, -1, 0)
    if surface == "mohr_coulomb":
        sine: FloatArray = (high - low) / (high + low)
        return sine
    first, third = low + middle + high, low * middle * high
    second = low * middle + middle * high + high * low
    square = np.maximum(first * second / third - 9.0, 0.0) / 6.0
    return np.sqrt(square / (1.0 + square))


def _principal(stress: FloatArray) -> FloatArray:
    """Principal stresses, pressure positive, smallest first: [particle, 6] -> [particle, 3]."""
    xx, yy, zz, xy, xz, yz = -stress.T
    rows = ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))
    return np.linalg.eigvalsh(np.moveaxis(np.array(rows), -1, 0))


def shaken(phi_deg: float) -> Outcome:
    """Strength borne along the straight leg's way in, with the leg, bed and numerics of `sand3d`.

    Parameters
    ----------
    phi_deg
        φ [deg].
    """
    scenario = Plan.load("sand3d").scenario.replace(
        **{
            "soil.friction_angle_deg": phi_deg,
            "motion.start_deg": PATH_DEG[0],
            "motion.stop_deg": PATH_DEG[1],
        }
    )
    check = Check(
        problem="Soil that flows is at yield",
        case=f"straight leg, library `sand3d`, φ = {phi_deg:g}°",
        quantity="strength borne over strength",
        expected=1.0,
        obtained=strength_borne(scenario),
        tolerance=0.02,
        sense="at_least",
        resolution=f"Δx {1e3 * scenario.numerics.cell_size:.3g} mm, 8 a cell",
        source="mobilised sin φ over sin φ, weighed by mean stress, of soil that is sheared",
    )
    return Outcome([check])


TASKS = [
    Task(f"shaken-{phi:g}", shaken, {"phi_deg": phi}, 30.0) for phi in (25.0, 35.0, 40.0, 50.0)
]
