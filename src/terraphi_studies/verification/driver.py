"""Any soil in motion: what a scenario's solver does, from a state of one's own.

The solver begins with a bed at rest and moves a leg. Problems with known answers begin with other
stresses and velocities, in other boxes, and often without a leg; the steps are the same.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import SimulationError
from terraphi.experiment.motion import bin_centres
from terraphi.experiment.scenario import Scenario
from terraphi.forward.driver import KERNELS, Kernel, path_of_steps, step_count
from terraphi.forward.plane.bed import Grid, Particles, empty_grid, geostatic_bed
from terraphi.forward.plane.contact import Intruder, intruder_of
from terraphi.forward.plane.plasticity import Material, material_of
from terraphi.forward.plane.relief import Fading, fading_of
from terraphi.forward.plane.scalar import Audit, Stepping, empty_audit, empty_reaction, stepping_of
from terraphi.library.workers import heartbeat

BLOCK = 1000
"""Steps between two heartbeats."""
ELASTIC = 1e9
"""Cohesion with which soil never yields [Pa]."""
PARKED = (-9.0, -9.0, 0.0, 0.0, 0.0, 0.0)
"""Pose of a leg that is nowhere near."""


_HAIR = 1e-9
ON_NODES = {
    "bed.left": 0.01 + _HAIR,
    "bed.floor": 0.01 + _HAIR,
    "bed.width": 0.28 - 2.0 * _HAIR,
    "bed.height": 0.16,
}
"""A box whose edges lie on nodes of 30, 60 or 120 cells; by a hair inside of them, lest the last
digit of a node's position decides whether the wall holds it."""


def benchmark(cells: int, *, courant: float, on_nodes: bool = False, **changes: Any) -> Scenario:
    """Scenario of the benchmark on another grid.

    Parameters
    ----------
    cells
        Cells along a side of the domain.
    courant
        Part of a cell that a compression wave passes in a step [-].
    on_nodes
        Whether the box is that of :data:`ON_NODES`; any grid of fewer than 60 cells needs it.
    **changes
        As for :meth:`~terraphi.experiment.scenario.Scenario.replace`.
    """
    box = ON_NODES if on_nodes else {}
    fine = Scenario().replace(**{"numerics.time_step": 1e-6, **box, **changes})
    step = courant * fine.numerics.domain / cells / fine.soil.p_wave_speed
    return fine.replace(**{"numerics.cells": cells, "numerics.time_step": step})


def in_words(scenario: Scenario) -> str:
    """Grid, particles and time step."""
    numerics = scenario.numerics
    return (
        f"Δx {1e3 * numerics.cell_size:.3g} mm, {numerics.particles_per_cell_side**2} a cell, "
        f"Δt {1e6 * numerics.time_step:.3g} µs"
    )


class Rig(NamedTuple):
    """Everything that the kernels take besides the soil."""

    grid: Grid
    material: Material
    intruder: Intruder
    fading: Fading
    stepping: Stepping
    audit: Audit

    def changed(self, **stepping: Any) -> Rig:
        """Copy with other constants of a step, such as ``gravity=0.0``."""
        return self._replace(stepping=self.stepping._replace(**stepping))

    def open_box(self) -> Rig:
        """Copy without walls and floor."""
        return self.changed(left=-9.0, right=9.0, floor=-9.0)


def rig_of(scenario: Scenario) -> Rig:
    """Rig of a scenario, with books that are still empty."""
    return Rig(
        empty_grid(scenario),
        material_of(scenario.soil),
        intruder_of(scenario.leg, inset=scenario.tip_inset),
        fading_of(scenario),
        stepping_of(scenario),
        empty_audit(),
    )


def advance(
    soil: Particles,
    rig: Rig,
    steps: int,
    *,
    pose: tuple[float, ...] = PARKED,
    kernel: Kernel = "packets",
    body_force: Callable[[float], FloatArray] | None = None,
) -> None:
    """Take some steps with a leg that keeps its pose, changing soil, grid and books in place.

    Parameters
    ----------
    soil
        The particles.
    rig
        The rest.
    steps
        How many.
    pose
        Hip x, z [m], θ [rad], hip velocity x, z [m/s], angular rate [rad/s].
    kernel
        Which kernel.
    body_force
        From the time of a step's start [s] to the acceleration of each particle [m/s²], shape
        [particle, 2]: given to the particles before the step, which takes it to the grid with
        their momentum. The kernels are then called step by step, which the packets do by half
        steps of the reference kernel alone.

    Raises
    ------
    SimulationError
        If a particle leaves the grid.
    """
    block = BLOCK if body_force is None else 1
    for done in range(0, steps, block):
        count = min(block, steps - done)
        if done % BLOCK == 0:
            heartbeat(0.0)
        if body_force is not None:
            time_step = rig.stepping.time_step
            soil.velocity[:] += time_step * body_force(done * time_step)
        still = np.zeros(count)
        _take(soil, rig, kernel, np.tile(pose, (count, 1)), still, still.astype(np.int64))


def _take(
    soil: Particles,
    rig: Rig,
    kernel: Kernel,
    poses: FloatArray,
    turned: FloatArray,
    bins: NDArray[np.int64],
    impulse: FloatArray | None = None,
) -> None:
    """Take a step for each pose; the leg's impulse is added up by bins if somebody asks for it."""
    take = KERNELS[kernel][rig.stepping.phase > 0]
    felt = empty_reaction(1) if impulse is None else impulse
    lost = take(soil, rig.grid, *rig[1:5], poses, turned, bins, felt, rig.audit)
    if lost >= 0:
        raise SimulationError(f"particle {lost} left the grid")


def block_of(
    corner: tuple[float, float],
    size: tuple[float, float],
    spacing: float,
    density: float,
    *,
    tilt: float = 0.0,
) -> Particles:
    """A rectangle of soil without stress, at rest, its particles on a lattice.

    Parameters
    ----------
    corner
        Its lower left corner (x, z) [m].
    size
        Its sides along the tilted x and z [m], whole multiples of the spacing, nearly.
    spacing
        Distance of the particles [m].
    density
        [kg/m³].
    tilt
        Angle by which it is turned about the corner, from +x towards +z [rad].
    """
    columns, rows = (max(1, round(side / spacing)) for side in size)
    step = np.array([size[0] / columns, size[1] / rows])
    column, row = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
    local = np.stack([column.ravel(), row.ravel()], axis=1) * step
    cosine, sine = math.cos(tilt), math.sin(tilt)
    position = np.array(corner) + local @ np.array([[cosine, sine], [-sine, cosine]])
    count = len(position)
    volume = np.full(count, step[0] * step[1])
    return Particles(
        position=position,
        start=position.copy(),
        velocity=np.zeros((count, 2)),
        gradient=np.zeros((count, 4)),
        stress=np.zeros((count, 4)),
        mass=density * volume,
        volume=volume,
        stretch=np.ones(count),
        weight=np.ones(count),
        slip=np.zeros(count),
    )


def follow(
    scenario: Scenario,
    soil: Particles,
    rig: Rig,
    first: int,
    count: int,
    *,
    kernel: Kernel = "packets",
    impulse: FloatArray | None = None,
) -> NDArray[np.int64]:
    """Take some steps of a scenario's own motion, changing soil, grid and books in place.

    Parameters
    ----------
    scenario
        Its motion moves the leg.
    soil, rig, kernel
        As in :func:`advance`.
    first, count
        Number of the first step, and how many.
    impulse
        Of the soil on the leg per metre of width [kg/s], by bin of the motion: is added to.

    Returns
    -------
    ndarray
        How many steps fell into each bin.

    Raises
    ------
    SimulationError
        If a particle leaves the grid.
    """
    places = 1 if impulse is None else len(impulse)
    held = np.zeros(places, np.int64)
    for begin in range(first, first + count, BLOCK):
        steps = np.arange(begin, min(begin + BLOCK, first + count))
        poses, turned, bins = path_of_steps(scenario, steps, places)
        held += np.bincount(bins, minlength=places)
        heartbeat(0.0)
        _take(soil, rig, kernel, poses, turned, bins, impulse)
    return held


def push(scenario: Scenario) -> tuple[FloatArray, FloatArray]:
    """Move the plate, with a smooth wall in line with its front behind the soil beneath it.

    Parameters
    ----------
    scenario
        A plate at the soil's left edge, upright, that moves to the right.

    Returns
    -------
    displacement, force
        [m], shape [bin], and force of the soil on the plate (x, z) per metre [N/m], shape [bin, 2].
    """
    soil = geostatic_bed(scenario)
    # A scenario keeps its leg between the walls; the plate's own place is behind this one.
    rig = rig_of(scenario).changed(left=scenario.bed.soil_span[0])
    places = bin_centres(scenario.motion)
    impulse = empty_reaction(len(places))
    held = follow(scenario, soil, rig, 0, step_count(scenario), impulse=impulse)
    return places, impulse[:, :2] / (held * scenario.numerics.time_step)[:, None]
