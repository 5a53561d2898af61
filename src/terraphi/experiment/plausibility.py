"""What in a scenario can be simulated and is hardly meant: odd units, a leg without soil."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from terraphi.experiment.scenario import Scenario

POSES = 361
"""Moments of the motion at which the leg is looked at."""
LIMITS = {
    "soil.friction_angle_deg": (5.0, 60.0, "in degrees"),
    "soil.density": (500.0, 5000.0, "in kg/m³"),
    "soil.youngs_modulus": (1e5, 1e10, "in pascals"),
    "soil.cohesion": (0.0, 1e6, "in pascals"),
    "leg.chord": (5e-3, 2.0, "in metres"),
    "leg.half_thickness": (1e-4, 0.1, "in metres"),
    "leg.width": (1e-3, 1.0, "in metres"),
    "leg.friction": (0.0, 2.0, "a coefficient"),
    "motion.rate": (1e-3, 100.0, "in rad/s"),
    "motion.start_deg": (-720.0, 720.0, "in degrees"),
    "motion.stop_deg": (-720.0, 720.0, "in degrees"),
    "motion.distance": (1e-4, 10.0, "in metres"),
    "bed.left": (0.0, 10.0, "in metres"),
    "bed.floor": (0.0, 10.0, "in metres"),
    "bed.width": (1e-2, 10.0, "in metres"),
    "bed.height": (1e-3, 10.0, "in metres"),
    "bed.surcharge": (0.0, 1e6, "in pascals"),
    "numerics.time_step": (1e-8, 1e-2, "in seconds"),
    "numerics.speed_up": (0.1, 1e3, "a factor"),
    "numerics.contact_band_cells": (0.0, 5.0, "in cells"),
    "relief.distance": (0.0, 1.0, "in metres"),
    "rft.scale": (1e-2, 1e2, "a factor"),
}
"""Smallest and largest plausible value of a key, and the name of the quantity."""

SHAKEN_DEG = {"mohr_coulomb": 31.0, "matsuoka_nakai": 36.0}
"""By yield surface, the φ [deg] above which soil in three dimensions shakes if nothing damps it.
Undamped, the straight leg of `sand3d` has 2 % less lift at 35° and a fifth less at 40°; with the
faces of Mohr-Coulomb it has the same at 30° and an eighth less at 35°."""

ENOUGH = 0.1
"""Least `stiffness_damping` that was seen to stop it [-]."""


def doubts(scenario: Scenario) -> list[str]:
    """Return doubts about a scenario: values that can be simulated but are hardly meant.

    Parameters
    ----------
    scenario
        One that can be simulated.

    Returns
    -------
    list of str
        A sentence each, without a full stop; none if there is nothing to ask.
    """
    return [
        *_of_size(scenario),
        *_of_place(scenario),
        *_of_strains(scenario),
        *_of_shaking(scenario),
    ]


def doubts_between(scenarios: Iterable[Scenario]) -> list[str]:
    """Return doubts about scenarios that are to be compared with one another, as :func:`doubts`."""
    ways = {s.mean_distortion for s in scenarios if s.numerics.distortion == "auto"}
    if len(ways) < 2:
        return []
    doubt = (
        "numerics.distortion = 'auto' takes another way for soil that dilates than for soil that "
        "does not, which alone changes a leg's force by 3 to 10 %; set 'cell' or 'particle' for all"
    )
    return [doubt]


def _of_size(scenario: Scenario) -> Iterator[str]:
    for key, (least, most, what) in LIMITS.items():
        part, name = key.split(".")
        # A translation has no rate, a rotation no distance.
        value = getattr(getattr(scenario, part), name, None)
        if value is not None and not least <= value <= most:
            yield f"{key} = {value:g} is unusual: it is {what}, mostly {least:g} to {most:g}"


def _of_strains(scenario: Scenario) -> Iterator[str]:
    """Whether strains of whole cells are taken where they help (``docs/convergence.md``)."""
    if scenario.model != "mpm" or scenario.dimensions == 3:
        return
    if scenario.mean_distortion and not scenario.mean_dilatation:
        yield (
            "numerics.distortion of whole cells with dilatation = 'particle' makes soil up to "
            "twice as strong; set dilatation = 'cell'"
        )
    elif scenario.mean_distortion and scenario.cell_damping == 0.0:
        yield (
            "numerics.distortion of whole cells without cell_damping lets soil shake within them, "
            "which weakens it; set cell_damping = 0.2"
        )
    elif scenario.mean_dilatation and not scenario.mean_distortion and scenario.soil.dilates:
        yield (
            "numerics.dilatation = 'cell' makes soil that dilates far too strong; set distortion = "
            "'auto' and cell_damping = 0.2 beside it"
        )


def soil_shakes(scenario: Scenario) -> bool:
    """Whether soil in space shakes, so that it bears less than its strength."""
    return (
        (scenario.model, scenario.dimensions) == ("mpm", 3)
        and scenario.soil.friction_angle_deg > SHAKEN_DEG[scenario.soil.yield_surface]
        and scenario.numerics.stiffness_damping < ENOUGH
    )


def _of_shaking(scenario: Scenario) -> Iterator[str]:
    """Whether soil in space bears its strength (``docs/explanation/three-dimensions-cells.md``)."""
    if soil_shakes(scenario):
        yield (
            f"soil of {scenario.soil.friction_angle_deg:g}° shakes where nothing damps it, and "
            "bears less than it should; set numerics.stiffness_damping = 0.25"
        )


def _of_place(scenario: Scenario) -> Iterator[str]:
    """Whether the leg begins above the soil and gets into it."""
    motion, surface = scenario.motion, scenario.bed.surface
    poses = motion.poses(np.linspace(0.0, motion.duration, POSES))
    height = poses.placed(scenario.leg.outline())[..., 1]
    if height.min() > surface:
        gap = 1e3 * (height.min() - surface)
        yield f"the leg never reaches the soil: it stays {gap:.3g} mm above; lower motion.hip"
    elif height[0].min() < surface:
        deep = 1e3 * (surface - height[0].min())
        yield (
            f"the leg begins {deep:.3g} mm deep in the soil, of which the part in its place is "
            "left out, and its first forces are those of a start, not of a motion"
        )
