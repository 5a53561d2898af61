"""The plain kernel: one particle after another, one node after another, nothing clever.

A step, in the order of the paper: particles to grid, gravity, leg, walls, damping, grid to
particles, stress, relief.
"""

from __future__ import annotations

import math

from terraphi.experiment.arrays import FloatArray
from terraphi.forward import ledger
from terraphi.forward.body import Path, pose_of
from terraphi.forward.compiled import kernel
from terraphi.forward.ledger import Audit, enter_reaction
from terraphi.paper.plane.bed import Grid, Particles
from terraphi.paper.plane.contact import against_leg, against_walls
from terraphi.paper.plane.model import Model
from terraphi.paper.plane.plasticity import jaumann_predictor, return_mapping
from terraphi.paper.plane.transfer import grid_to_particle, particles_to_grid

close_books, write_books = kernel(ledger.close_books), kernel(ledger.write_books)


@kernel
def advance(
    soil: Particles, grid: Grid, model: Model, path: Path, impulse: FloatArray, audit: Audit,
) -> int:  # fmt: skip
    """Run the kernel over a block of steps, changing its array arguments in place.

    Parameters
    ----------
    soil
        :class:`~terraphi.paper.plane.bed.Particles`.
    grid
        :class:`~terraphi.paper.plane.bed.Grid`, working memory.
    model
        :class:`~terraphi.paper.plane.model.Model`.
    path
        Where the leg is, :class:`~terraphi.forward.body.Path`.
    impulse
        As :func:`terraphi.forward.ledger.empty_reaction` makes it, added to.
    audit
        :class:`~terraphi.forward.ledger.Audit`, updated.

    Returns
    -------
    int
        Index of the first particle to leave the grid, or -1 if none did.
    """
    impulses = audit.impulses.copy()
    for step in range(path.turned.size):
        momentum = particles_to_grid(soil, grid, model.cell_size, model.time_step)
        # The momentum now must be that of a step ago and the impulses since then.
        close_books(audit, impulses, momentum)
        # Forces on the nodes, then back to the particles; the books are kept on the way.
        impulses[:] = 0.0
        counted = update_grid(grid, model, path.poses[step], impulses)
        enter_reaction(impulse, path.bins[step], counted, (impulses[1, 0], impulses[1, 1]))
        lost = update_particles(soil, grid, model, path.turned[step], impulses)
        if lost >= 0:
            return lost
        write_books(audit, impulses, momentum)
    return -1


@kernel
def update_grid(
    grid: Grid, model: Model, pose: FloatArray, impulses: FloatArray
) -> tuple[float, float]:
    """Turn momenta into velocities, and apply gravity, leg, walls and damping, in that order.

    Damping comes before the leg instead where the model says so.

    Parameters
    ----------
    grid
        Holds momenta; holds velocities afterwards.
    model
        Constants.
    pose
        One row of the poses.
    impulses
        What gravity, leg, walls and damping gave the soil is added to its rows [kg/s].

    Returns
    -------
    tuple
        What the contact counts as given by the leg (x, z) [kg/s].
    """
    leg = pose_of(pose)
    counted_x, counted_z = 0.0, 0.0
    for j in range(grid.mass.shape[0]):
        for i in range(grid.mass.shape[1]):
            mass = grid.mass[j, i]
            if mass <= 0.0:
                continue
            # v = (mv)/m, and gravity: v_z -= g Δt.
            vx, vz = grid.vx[j, i] / mass, grid.vz[j, i] / mass
            vz -= model.gravity * model.time_step
            impulses[0, 1] -= mass * model.gravity * model.time_step
            vx, vz = damped(vx, vz, mass, model.damping_before, impulses)

            # The leg, then the walls: soil between both cannot pass the wall. What the leg gives
            # to the node, m Δv, is over Δt the negative of the force on the leg.
            x, z = i * model.cell_size, j * model.cell_size
            px, pz = vx, vz
            vx, vz, cx, cz = against_leg(vx, vz, x, z, model, leg)
            impulses[1, 0] += mass * (vx - px)
            impulses[1, 1] += mass * (vz - pz)
            counted_x += mass * cx
            counted_z += mass * cz

            px, pz = vx, vz
            vx, vz = against_walls(vx, vz, x, z, model)
            impulses[2, 0] += mass * (vx - px)
            impulses[2, 1] += mass * (vz - pz)

            vx, vz = damped(vx, vz, mass, model.damping_after, impulses)
            grid.vx[j, i] = vx
            grid.vz[j, i] = vz
    return counted_x, counted_z


@kernel
def damped(
    vx: float, vz: float, mass: float, factor: float, impulses: FloatArray
) -> tuple[float, float]:
    """A node's velocity times a factor; what that gives to the soil is added to the impulses."""
    impulses[3, 0] += mass * vx * (factor - 1.0)
    impulses[3, 1] += mass * vz * (factor - 1.0)
    return vx * factor, vz * factor


@kernel
def update_particles(
    soil: Particles, grid: Grid, model: Model, turned: float, impulses: FloatArray
) -> int:
    """Move the particles with the grid and update their stresses and weights.

    Parameters
    ----------
    soil, grid, model
        As in :func:`advance`; the grid holds velocities.
    turned
        |Δθ| of this step once θ > 0 [rad].
    impulses
        What the relief took from the soil is added to its last row [kg/s].

    Returns
    -------
    int
        Index of the first particle to leave the grid, or -1.
    """
    # Where splines find all their nodes.
    low, high = 0.5 * model.cell_size, (grid.mass.shape[0] - 2.5) * model.cell_size
    material = model.material
    factor = math.exp(-model.relief_rate * turned)
    # The relief's exp(-rate |Δθ|) is the same for all particles of a step.
    for p in range(soil.mass.size):
        vx, vz, gradient = grid_to_particle(soil, grid, p, model.cell_size)
        # Explicit: the strain of this step makes the stress that acts in the next.
        stress = (soil.stress[p, 0], soil.stress[p, 1], soil.stress[p, 2], soil.stress[p, 3])
        trial = jaumann_predictor(
            stress,
            gradient,
            model.time_step,
            material.lame_lambda,
            material.shear_modulus,
            model.turning,
        )
        stress = return_mapping(trial, material)
        for c in range(4):
            soil.gradient[p, c] = model.affine * gradient[c]
            soil.stress[p, c] = stress[c]
        soil.velocity[p, 0] = vx
        soil.velocity[p, 1] = vz

        x = soil.position[p, 0] + vx * model.time_step
        z = soil.position[p, 1] + vz * model.time_step
        # Written so that a position that is not a number counts as outside.
        if not (low < x < high and low < z < high):
            return p
        soil.position[p, 0] = x
        soil.position[p, 1] = z

        # Soil that fades takes momentum with it, which is entered in the ledger.
        weight = soil.weight[p]
        new = faded(weight, x - soil.start[p, 0], z - soil.start[p, 1], factor, model)
        if new != weight:
            soil.weight[p] = new
            impulses[4, 0] += (new - weight) * soil.mass[p] * vx
            impulses[4, 1] += (new - weight) * soil.mass[p] * vz
    return -1


@kernel
def faded(weight: float, dx: float, dz: float, factor: float, model: Model) -> float:
    """Weight of a particle after a step: q ← max(q_min, q exp(-rate |Δθ|)) once it is far.

    The relief of Xu & Wang: soil that the leg has carried far from its place fades. Without
    branches, so that it can be done to a whole vector register.

    Parameters
    ----------
    weight
        q [-].
    dx, dz
        Displacement since the start [m].
    factor
        exp(-rate |Δθ|) of the step [-].
    model
        Constants.
    """
    less = max(model.relief_least, weight * factor)
    return less if math.sqrt(dx * dx + dz * dz) > model.relief_distance else weight
