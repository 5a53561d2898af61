"""Values in a scenario that can be simulated and are probably a mistake: odd units, no soil."""

from __future__ import annotations

from operator import attrgetter

import numpy as np

from terraphi.experiment.scenario import Scenario

LIMITS = {
    "soil.friction_angle_deg": (5.0, 60.0, "deg"),
    "soil.density": (500.0, 5000.0, "kg/m³"),
    "soil.youngs_modulus": (1e5, 1e10, "Pa"),
    "leg.chord": (5e-3, 2.0, "m"),
    "leg.half_thickness": (1e-4, 0.1, "m"),
    "leg.width": (1e-3, 1.0, "m"),
    "leg.friction": (0.0, 2.0, "-"),
    "motion.duration": (1e-3, 1e4, "s"),
    "bed.height": (1e-3, 10.0, "m"),
    "numerics.time_step": (1e-8, 1e-2, "s"),
    "numerics.speed_up": (0.1, 1e3, "-"),
}
"""Smallest and largest plausible value of a key, and its unit."""
SHAKEN_DEG = {"mohr_coulomb": 31.0, "matsuoka_nakai": 36.0}
"""By yield surface, the φ [deg] above which soil in three dimensions shakes if nothing damps it.

Undamped, the straight leg of `sand3d` has 2 % less lift at 35° and a fifth less at 40°; with
Mohr-Coulomb the same at 30° and an eighth less at 35°."""
ENOUGH = 0.1
"""Least `stiffness_damping` that was seen to stop it [-]."""


def doubts(scenario: Scenario) -> list[str]:
    """Warnings about values that can be simulated and are probably a mistake, a sentence each."""
    found = []
    for key, (least, most, unit) in LIMITS.items():
        value = attrgetter(key)(scenario)
        if not least <= value <= most:
            found.append(f"{key} = {value:g} is unusual: in {unit}, mostly {least:g} to {most:g}")
    soil, damping = scenario.soil, scenario.numerics.stiffness_damping
    in_3d = (scenario.model, scenario.dimensions) == ("mpm", 3)
    if (
        in_3d
        and damping < ENOUGH
        and soil.friction_angle_deg > SHAKEN_DEG.get(soil.yield_surface, 31.0)
    ):
        found.append(
            f"undamped soil of {soil.friction_angle_deg:g}° shakes and carries less than its "
            "strength; set numerics.stiffness_damping = 0.25"
        )
    poses = scenario.motion.poses(np.linspace(0.0, scenario.motion.duration, 361))
    height = poses.placed(scenario.leg.outline())[..., 1] - scenario.bed.surface
    if height.min() > 0.0:
        gap = 1e3 * height.min()
        found.append(f"the leg stays {gap:.3g} mm above the soil; lower motion.hip")
    elif height[0].min() < 0.0:
        depth = -1e3 * height[0].min()
        found.append(f"the leg starts {depth:.3g} mm deep in the soil, so its first forces are off")
    return found
