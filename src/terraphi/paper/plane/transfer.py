"""Transfer between particles and grid: quadratic B-splines, affine velocities.

APIC (Jiang et al., 2015, doi 10.1145/2766996) in its moving-least-squares form (Hu et al., 2018,
doi 10.1145/3197517.3201293), with w the spline weights, p a particle and i a node:

    m_i = Σ w m_p,     (mv)_i = Σ w (m_p v_p + (m_p C_p - 4 Δt/Δx² V_p σ_p) (x_i - x_p))
    v_p = Σ w v_i,      C_p = 4/Δx² Σ w v_i (x_i - x_p)

4/Δx² is the inverse of the spline's second moment. The affine term m C in the momentum is
essential: without it (``transfer = "pic"``) the transfer's own viscosity triples the forces at
steps this small. A particle's mass and volume count with its weight q.
"""

from __future__ import annotations

from terraphi.forward.compiled import kernel
from terraphi.paper.plane.bed import Grid, Particles

Three = tuple[float, float, float]


@kernel
def weights(offset: float) -> Three:
    """Quadratic B-spline weights [-] of the three nodes from a base node on.

    ``offset`` is the distance of the particle from the base node in cells, 0.5 to 1.5.
    """
    before, middle, after = 1.5 - offset, offset - 1.0, offset - 0.5
    return 0.5 * (before * before), 0.75 - middle * middle, 0.5 * (after * after)


@kernel
def particles_to_grid(
    soil: Particles, grid: Grid, cell_size: float, time_step: float
) -> tuple[float, float]:
    """Clear the grid and add all particles; returns the soil's momentum (x, z) [kg/s].

    Parameters
    ----------
    soil
        :class:`~terraphi.paper.plane.bed.Particles`.
    grid
        :class:`~terraphi.paper.plane.bed.Grid`, of masses and momenta.
    cell_size, time_step
        Δx [m], Δt [s].
    """
    grid.mass[:] = 0.0
    grid.vx[:] = 0.0
    grid.vz[:] = 0.0
    per_cell = 1.0 / cell_size
    # Force of the stress, -Δt V σ ∇w, as an affine momentum: ∇w = 4 w r / Δx² (MLS-MPM).
    stress_scale = -4.0 * time_step * per_cell * per_cell
    total_x, total_z = 0.0, 0.0
    # Particles share nodes, so that one is added after the other.
    for p in range(soil.mass.size):
        # The base node (i, j), and the place of the particle from it [cell].
        i = int(soil.position[p, 0] * per_cell - 0.5)
        j = int(soil.position[p, 1] * per_cell - 0.5)
        fx = soil.position[p, 0] * per_cell - i
        fz = soil.position[p, 1] * per_cell - j
        wx, wz = weights(fx), weights(fz)
        mass = soil.weight[p] * soil.mass[p]
        k = stress_scale * soil.weight[p] * soil.volume[p]
        sxx, szz, sxz = soil.stress[p, 0], soil.stress[p, 1], soil.stress[p, 2]
        # The affine part of the momentum, per cell of distance from the particle.
        axx = (k * sxx + mass * soil.gradient[p, 0]) * cell_size
        axz = (k * sxz + mass * soil.gradient[p, 1]) * cell_size
        azx = (k * sxz + mass * soil.gradient[p, 2]) * cell_size
        azz = (k * szz + mass * soil.gradient[p, 3]) * cell_size
        # (m v)_i += w (m v_p + A r), r in cells.
        px, pz = mass * soil.velocity[p, 0], mass * soil.velocity[p, 1]
        total_x += px
        total_z += pz
        for b in range(3):
            rz = b - fz
            for a in range(3):
                rx = a - fx
                w = wz[b] * wx[a]
                grid.mass[j + b, i + a] += w * mass
                grid.vx[j + b, i + a] += w * (px + axx * rx + axz * rz)
                grid.vz[j + b, i + a] += w * (pz + azx * rx + azz * rz)
    return total_x, total_z


@kernel
def grid_to_particle(
    soil: Particles, grid: Grid, p: int, cell_size: float
) -> tuple[float, float, tuple[float, float, float, float]]:
    """Velocity and its gradient at one particle, from the velocities of the grid.

    Parameters
    ----------
    soil, grid, cell_size
        As in :func:`particles_to_grid`; the grid holds velocities.
    p
        Index of the particle.

    Returns
    -------
    tuple
        vx, vz [m/s] and (∂vx/∂x, ∂vx/∂z, ∂vz/∂x, ∂vz/∂z) [1/s].
    """
    per_cell = 1.0 / cell_size
    # The nodes and weights that the particle gave its momentum with.
    i = int(soil.position[p, 0] * per_cell - 0.5)
    j = int(soil.position[p, 1] * per_cell - 0.5)
    fx = soil.position[p, 0] * per_cell - i
    fz = soil.position[p, 1] * per_cell - j
    wx, wz = weights(fx), weights(fz)
    vx, vz = 0.0, 0.0
    cxx, cxz, czx, czz = 0.0, 0.0, 0.0, 0.0
    for b in range(3):
        rz = b - fz
        for a in range(3):
            rx = a - fx
            w = wz[b] * wx[a]
            gx = w * grid.vx[j + b, i + a]
            gz = w * grid.vz[j + b, i + a]
            vx += gx
            vz += gz
            cxx += gx * rx
            cxz += gx * rz
            czx += gz * rx
            czz += gz * rz
    # C = 4/Δx² Σ w v_i (x_i - x_p), and r is in cells: one Δx is left.
    scale = 4.0 * per_cell
    return vx, vz, (scale * cxx, scale * cxz, scale * czx, scale * czz)
