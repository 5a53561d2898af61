"""Transfer between particles and grid: quadratic B-splines, affine velocities.

APIC (Jiang et al., 2015, doi 10.1145/2766996) in its moving-least-squares form (Hu et al., 2018,
doi 10.1145/3197517.3201293). The affine term m C in the momentum is essential: without it the
transfer's own viscosity triples the forces at steps this small.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from terraphi.forward.compiled import kernel
from terraphi.forward.plane.bed import Grid, Particles

FloatArray = NDArray[np.float64]


@kernel
def weights(offset: float) -> tuple[float, float, float]:
    """Quadratic B-spline weights of the three nodes from a base node on.

    Parameters
    ----------
    offset
        Distance of the particle from the base node in cells, 0.5 to 1.5 [-].

    Returns
    -------
    tuple
        Three weights [-] that sum to one.
    """
    before, middle, after = 1.5 - offset, offset - 1.0, offset - 0.5
    return 0.5 * (before * before), 0.75 - middle * middle, 0.5 * (after * after)


@kernel
def particle_to_grid(
    soil: Particles, grid: Grid, p: int, cell_size: float, time_step: float
) -> tuple[float, float]:
    """Scatter one particle.

    Parameters
    ----------
    soil, grid, cell_size, time_step
        As in :func:`particles_to_grid`; the grid is added to.
    p
        Index of the particle.

    Returns
    -------
    tuple
        Momentum (x, z) of the particle per metre of width [kg/s].
    """
    per_cell = 1.0 / cell_size
    stress_scale = -4.0 * time_step * per_cell * per_cell
    i = int(soil.position[p, 0] * per_cell - 0.5)
    j = int(soil.position[p, 1] * per_cell - 0.5)
    fx = soil.position[p, 0] * per_cell - i
    fz = soil.position[p, 1] * per_cell - j
    wx, wz = weights(fx), weights(fz)
    mass = soil.weight[p] * soil.mass[p]
    k = stress_scale * soil.weight[p] * soil.volume[p] * soil.stretch[p]
    sxx, szz, sxz = soil.stress[p, 0], soil.stress[p, 1], soil.stress[p, 2]
    # The affine part of the momentum, per cell of distance from the particle.
    axx = (k * sxx + mass * soil.gradient[p, 0]) * cell_size
    axz = (k * sxz + mass * soil.gradient[p, 1]) * cell_size
    azx = (k * sxz + mass * soil.gradient[p, 2]) * cell_size
    azz = (k * szz + mass * soil.gradient[p, 3]) * cell_size
    px, pz = mass * soil.velocity[p, 0], mass * soil.velocity[p, 1]
    for b in range(3):
        rz = b - fz
        for a in range(3):
            rx = a - fx
            w = wz[b] * wx[a]
            grid.mass[j + b, i + a] += w * mass
            grid.vx[j + b, i + a] += w * (px + axx * rx + axz * rz)
            grid.vz[j + b, i + a] += w * (pz + azx * rx + azz * rz)
    return px, pz


@kernel
def particles_to_grid(
    soil: Particles, grid: Grid, cell_size: float, time_step: float
) -> tuple[float, float]:
    """Scatter mass and momentum, the latter with the impulse of the stresses.

    Parameters
    ----------
    soil
        :class:`~terraphi.forward.plane.bed.Particles`.
    grid
        :class:`~terraphi.forward.plane.bed.Grid`; cleared first.
    cell_size
        Δx [m].
    time_step
        Δt [s].

    Returns
    -------
    tuple
        Momentum (x, z) of the particles per metre of width [kg/s].
    """
    grid.mass[:] = 0.0
    grid.vx[:] = 0.0
    grid.vz[:] = 0.0
    total_x, total_z = 0.0, 0.0
    for p in range(soil.mass.size):
        px, pz = particle_to_grid(soil, grid, p, cell_size, time_step)
        total_x += px
        total_z += pz
    return total_x, total_z


@kernel
def stress_to_grid(
    soil: Particles,
    grid: Grid,
    p: int,
    stress: tuple[float, float, float],
    cell_size: float,
    time_step: float,
) -> None:
    """Scatter the impulse of one particle's stress alone.

    Parameters
    ----------
    soil, cell_size, time_step
        As in :func:`particles_to_grid`.
    grid
        Holds momenta; added to.
    p
        Index of the particle.
    stress
        (σ_xx, σ_zz, σ_xz) to take for it [Pa].
    """
    per_cell = 1.0 / cell_size
    i = int(soil.position[p, 0] * per_cell - 0.5)
    j = int(soil.position[p, 1] * per_cell - 0.5)
    fx = soil.position[p, 0] * per_cell - i
    fz = soil.position[p, 1] * per_cell - j
    wx, wz = weights(fx), weights(fz)
    k = -4.0 * time_step * per_cell * soil.weight[p] * soil.volume[p] * soil.stretch[p]
    sxx, szz, sxz = k * stress[0], k * stress[1], k * stress[2]
    for b in range(3):
        rz = b - fz
        for a in range(3):
            rx = a - fx
            w = wz[b] * wx[a]
            grid.vx[j + b, i + a] += w * (sxx * rx + sxz * rz)
            grid.vz[j + b, i + a] += w * (sxz * rx + szz * rz)


@kernel
def gather_values(
    first: FloatArray, second: FloatArray, x: float, z: float, cell_size: float
) -> tuple[float, float]:
    """Interpolate two values of the nodes at a place.

    Parameters
    ----------
    first, second
        Values of the nodes, shape [row, column].
    x, z
        The place [m].
    cell_size
        Δx [m].

    Returns
    -------
    tuple
        Both values there.
    """
    per_cell = 1.0 / cell_size
    i, j = int(x * per_cell - 0.5), int(z * per_cell - 0.5)
    wx, wz = weights(x * per_cell - i), weights(z * per_cell - j)
    one, two = 0.0, 0.0
    for b in range(3):
        for a in range(3):
            one += wz[b] * wx[a] * first[j + b, i + a]
            two += wz[b] * wx[a] * second[j + b, i + a]
    return one, two


@kernel
def grid_to_particle(
    soil: Particles, grid: Grid, p: int, cell_size: float
) -> tuple[float, float, tuple[float, float, float, float]]:
    """Gather velocity and velocity gradient of one particle.

    Parameters
    ----------
    soil, grid
        As in :func:`particles_to_grid`; the grid holds velocities.
    p
        Index of the particle.
    cell_size
        Δx [m].

    Returns
    -------
    tuple
        vx, vz [m/s] and (∂vx/∂x, ∂vx/∂z, ∂vz/∂x, ∂vz/∂z) [1/s].
    """
    per_cell = 1.0 / cell_size
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
    scale = 4.0 * per_cell
    return vx, vz, (scale * cxx, scale * cxz, scale * czx, scale * czz)
