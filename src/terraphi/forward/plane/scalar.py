"""The reference kernel: one particle after another, every option, nothing clever.

The order within a step is that of the paper: particles to grid, gravity, leg, walls, damping, grid
to particles, stress, relief. Faster kernels are tested against this one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.scenario import Scenario
from terraphi.forward.body import Intruder, pose_of
from terraphi.forward.compiled import kernel
from terraphi.forward.ledger import Audit, close_books, enter_reaction, write_books
from terraphi.forward.plane.bed import Grid, Particles
from terraphi.forward.plane.contact import against_leg, against_leg_unbalanced, against_walls
from terraphi.forward.plane.plasticity import Material, jaumann_predictor, return_mapping
from terraphi.forward.plane.relief import Fading, decay, faded
from terraphi.forward.plane.transfer import grid_to_particle, particles_to_grid

FloatArray = NDArray[np.float64]


class Stepping(NamedTuple):
    """Constants of a step, as the kernel takes them."""

    time_step: float
    """Δt [s]."""
    cell_size: float
    """Δx [m]."""
    gravity: float
    """g [m/s²]."""
    damping_before: float
    """Factor on grid velocities before contact with leg and walls [-]."""
    damping_after: float
    """Factor on grid velocities after it [-]."""
    affine: float
    """1 if particles keep the gradient of the grid's velocity, else 0."""
    band: float
    """Distance from the leg within which nodes are in contact [m]."""
    left: float
    """Left wall x [m]."""
    right: float
    """Right wall x [m]."""
    floor: float
    """Floor z [m]."""
    rough: bool
    """Whether the floor is rough."""
    update_volume: bool
    """Whether particle volumes follow the deformation."""
    phase: int
    """Steps for which the grid keeps its velocities; 0: none."""
    surface: bool
    """Whether particles press on the leg's surface, rather than nodes near it."""
    mean_dilatation: bool
    """Whether stresses follow the mean volumetric strain rate of a cell."""
    mean_distortion: bool
    """Whether stresses follow the mean distortion rate of a cell."""
    unbalanced: bool
    """Whether the leg counts more force than it applies, as in the paper's prototype."""
    turning: float
    """1 if stress turns with the soil's spin, else 0."""
    inner_viscosity: float
    """Viscosity against strain rates that differ from the means over their cells [Pa s]."""


def stepping_of(scenario: Scenario) -> Stepping:
    """Constants of a scenario."""
    numerics, bed, soil = scenario.numerics, scenario.bed, scenario.soil
    impedance = soil.density * soil.p_wave_speed
    factor = numerics.damping_factor
    return Stepping(
        time_step=numerics.time_step,
        cell_size=numerics.cell_size,
        gravity=bed.gravity,
        damping_before=1.0 if numerics.damping_order == "after_contact" else factor,
        damping_after=factor if numerics.damping_order == "after_contact" else 1.0,
        affine=1.0 if numerics.transfer == "apic" else 0.0,
        band=_band(scenario),
        left=bed.left,
        right=bed.left + bed.width,
        floor=bed.floor,
        rough=bed.floor_friction == "rough",
        update_volume=numerics.particle_volume == "updated",
        phase=numerics.steps_per_phase,
        surface=numerics.contact == "surface",
        mean_dilatation=scenario.mean_dilatation,
        mean_distortion=scenario.mean_distortion,
        unbalanced=numerics.contact == "unbalanced",
        turning=1.0 if numerics.stress_rate == "jaumann" else 0.0,
        inner_viscosity=scenario.cell_damping * impedance * numerics.cell_size,
    )


def _band(scenario: Scenario) -> float:
    """Distance from the leg within which nodes are in contact [m]; far inside it if none are."""
    if scenario.numerics.contact == "surface":
        return -scenario.leg.reach()
    return scenario.numerics.contact_band_cells * scenario.numerics.cell_size


@kernel
def advance(
    soil: Particles,
    grid: Grid,
    material: Material,
    intruder: Intruder,
    fading: Fading,
    stepping: Stepping,
    poses: FloatArray,
    turned: FloatArray,
    bins: NDArray[np.int64],
    impulse: FloatArray,
    audit: Audit,
) -> int:
    """Run the kernel over a block of steps, changing its array arguments in place.

    Parameters
    ----------
    soil
        :class:`~terraphi.forward.plane.bed.Particles`.
    grid
        :class:`~terraphi.forward.plane.bed.Grid`, working memory.
    material, intruder, fading, stepping
        Constants.
    poses
        Hip x, z [m], θ [rad], hip velocity x, z [m/s], angular rate [rad/s]; shape [step, 6].
    turned
        |Δθ| of each step once θ > 0, zero before [rad], shape [step].
    bins
        History bin of each step, shape [step].
    impulse
        As :func:`empty_reaction` makes it, added to.
    audit
        :class:`Audit`, updated.

    Returns
    -------
    int
        Index of the first particle to leave the grid, or -1 if none did.
    """
    impulses = np.zeros((5, 2))
    impulses[:] = audit.impulses
    for step in range(poses.shape[0]):
        momentum = particles_to_grid(soil, grid, stepping.cell_size, stepping.time_step)
        close_books(audit, impulses, momentum)
        impulses[:] = 0.0
        counted = update_grid(grid, intruder, stepping, poses[step], impulses)
        enter_reaction(impulse, bins[step], counted, (impulses[1, 0], impulses[1, 1]))
        lost = update_particles(soil, grid, material, fading, stepping, turned[step], impulses)
        if lost >= 0:
            return lost
        write_books(audit, impulses, momentum)
    return -1


@kernel
def update_grid(
    grid: Grid, intruder: Intruder, stepping: Stepping, pose: FloatArray, impulses: FloatArray
) -> tuple[float, float]:
    """Turn momenta into velocities and apply gravity, leg, walls and damping, in that order.

    Damping comes before the leg instead where :class:`Stepping` says so.

    Parameters
    ----------
    grid
        Holds momenta; holds velocities afterwards.
    intruder, stepping
        Constants.
    pose
        One row of the poses.
    impulses
        Filled with what each of gravity, leg, walls and damping gave the soil [kg/s].

    Returns
    -------
    tuple
        What the contact counts as given by the leg (x, z) [kg/s].
    """
    leg_pose = pose_of(pose)
    counted_x, counted_z = 0.0, 0.0
    for j in range(grid.mass.shape[0]):
        for i in range(grid.mass.shape[1]):
            mass = grid.mass[j, i]
            if mass <= 0.0:
                continue
            vx, vz = grid.vx[j, i] / mass, grid.vz[j, i] / mass
            vz -= stepping.gravity * stepping.time_step
            impulses[0, 1] -= mass * stepping.gravity * stepping.time_step
            vx, vz = damped(vx, vz, mass, stepping.damping_before, impulses)

            x, z = i * stepping.cell_size, j * stepping.cell_size
            px, pz = vx, vz
            if stepping.unbalanced:
                vx, vz, cx, cz = against_leg_unbalanced(
                    vx, vz, x, z, intruder, stepping.band, stepping.cell_size, leg_pose
                )
            else:
                vx, vz = against_leg(vx, vz, x, z, intruder, stepping.band, leg_pose)
                cx, cz = vx - px, vz - pz
            impulses[1, 0] += mass * (vx - px)
            impulses[1, 1] += mass * (vz - pz)
            counted_x += mass * cx
            counted_z += mass * cz

            px, pz = vx, vz
            vx, vz = against_walls(
                vx, vz, x, z, stepping.left, stepping.right, stepping.floor, stepping.rough
            )
            impulses[2, 0] += mass * (vx - px)
            impulses[2, 1] += mass * (vz - pz)

            vx, vz = damped(vx, vz, mass, stepping.damping_after, impulses)
            grid.vx[j, i] = vx
            grid.vz[j, i] = vz
    return counted_x, counted_z


@kernel
def damped(
    vx: float, vz: float, mass: float, factor: float, impulses: FloatArray
) -> tuple[float, float]:
    """A node's velocity times a factor; what that gives to the soil is added to the impulses."""
    loss = factor - 1.0
    impulses[3, 0] += mass * vx * loss
    impulses[3, 1] += mass * vz * loss
    return vx * factor, vz * factor


@kernel
def update_particles(
    soil: Particles,
    grid: Grid,
    material: Material,
    fading: Fading,
    stepping: Stepping,
    turned: float,
    impulses: FloatArray,
) -> int:
    """Move the particles with the grid and update stress, volume and weight.

    Parameters
    ----------
    soil, grid, material, fading, stepping
        As in :func:`advance`.
    turned
        |Δθ| of this step once θ > 0 [rad].
    impulses
        Its last row is filled with what the relief took from the soil [kg/s].

    Returns
    -------
    int
        Index of the first particle to leave the grid, or -1.
    """
    low = 0.5 * stepping.cell_size
    high = (grid.mass.shape[0] - 2.5) * stepping.cell_size
    time_step = stepping.time_step
    factor = decay(turned, fading)
    for p in range(soil.mass.size):
        vx, vz, gradient = grid_to_particle(soil, grid, p, stepping.cell_size)
        stress = (soil.stress[p, 0], soil.stress[p, 1], soil.stress[p, 2], soil.stress[p, 3])
        trial = jaumann_predictor(
            stress,
            gradient,
            time_step,
            material.lame_lambda,
            material.shear_modulus,
            stepping.turning,
        )
        stress = return_mapping(trial, material)
        for c in range(4):
            soil.gradient[p, c] = stepping.affine * gradient[c]
            soil.stress[p, c] = stress[c]
        soil.velocity[p, 0] = vx
        soil.velocity[p, 1] = vz
        if stepping.update_volume:
            soil.stretch[p] *= 1.0 + (gradient[0] + gradient[3]) * time_step

        x = soil.position[p, 0] + vx * time_step
        z = soil.position[p, 1] + vz * time_step
        # Written so that a position that is not a number counts as outside.
        if not (low < x < high and low < z < high):
            return p
        soil.position[p, 0] = x
        soil.position[p, 1] = z

        weight = soil.weight[p]
        new = faded(weight, x - soil.start[p, 0], z - soil.start[p, 1], factor, fading)
        if new != weight:
            soil.weight[p] = new
            impulses[4, 0] += (new - weight) * soil.mass[p] * vx
            impulses[4, 1] += (new - weight) * soil.mass[p] * vz
    return -1
