"""Contact of material points with the leg's true surface.

A particle stands for a square of soil; half the side of that is its radius. Where it comes closer
to the surface than its radius, it is pushed back in proportion (a penalty, far stiffer than the
soil: at 10 kPa a particle overlaps by a few thousandths of its size), and rubs as a spring that
slips at Coulomb's limit (Cundall and Strack, 1979, doi 10.1680/geot.1979.29.1.47). The force acts
where the particle touches, not at its centre: its moment about the centre goes to the grid as the
affine part of a momentum does. Contact thus begins where soil and leg meet, whatever the grid, as
in the particle-to-surface method of Nakamura et al. (2021, doi 10.1016/j.compgeo.2021.104069).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from terraphi.forward.mpm.bed import Grid, Particles
from terraphi.forward.mpm.compiled import kernel
from terraphi.forward.mpm.contact import Intruder, Pose, distance_to_leg
from terraphi.forward.mpm.plasticity import Material
from terraphi.forward.mpm.transfer import weights

STIFFNESS = 0.25
"""Force per overlap of a particle, and per metre of width, over the soil's M = λ + 2 G [-].

Stable even for a lone particle up to the Courant limit with three particles along the side of a
cell or fewer (more are refused); results do not depend on it."""
DAMPING = 0.3
"""Share of critical damping of a lone particle on that spring [-]."""


class Touch(NamedTuple):
    """What the leg does to a particle."""

    fx: float
    """Force x per metre of width [N/m]."""
    fz: float
    """Force z [N/m]."""
    arm_x: float
    """From the particle's centre to where the force acts, x [m]."""
    arm_z: float
    """z [m]."""
    slip: float
    """Elastic slip after the step [m]."""


@kernel
def touch(
    place: tuple[float, float],
    speed: tuple[float, float],
    radius: float,
    mass: float,
    weight: float,
    slip: float,
    material: Material,
    intruder: Intruder,
    pose: Pose,
    time_step: float,
) -> Touch:
    """Force of the leg on a particle.

    Parameters
    ----------
    place
        Its centre (x, z) [m].
    speed
        Velocity of the soil there (x, z) [m/s].
    radius
        [m].
    mass
        Per metre of width, with its weight [kg/m].
    weight
        q of the relief [-].
    slip
        Elastic slip before the step [m].
    material, intruder, pose
        Soil and leg.
    time_step
        Δt [s].

    Returns
    -------
    Touch
        Nothing but zeros if the particle does not reach the leg.
    """
    nothing = Touch(0.0, 0.0, 0.0, 0.0, 0.0)
    rx, rz = place[0] - pose.hip_x, place[1] - pose.hip_z
    far = intruder.reach + radius
    if rx * rx + rz * rz >= far * far:
        return nothing
    sine, cosine = pose.sine, pose.cosine
    distance, ns, nm = distance_to_leg(intruder, -sine * rx - cosine * rz, -cosine * rx + sine * rz)
    overlap = radius - distance
    if overlap <= 0.0:
        return nothing
    nx, nz = -sine * ns - cosine * nm, -cosine * ns + sine * nm
    # The leg turns from +z towards +x about +y: v = ω × r = ω (rz, -rx).
    ux = speed[0] - (pose.hip_vx + pose.rate * rz)
    uz = speed[1] - (pose.hip_vz - pose.rate * rx)
    normal, along = ux * nx + uz * nz, uz * nx - ux * nz
    spring = STIFFNESS * (material.lame_lambda + 2.0 * material.shear_modulus)
    dashpot = 2.0 * DAMPING * math.sqrt(spring * mass)
    # At most as large as the spring's force, so that contact begins softly.
    push = weight * spring * overlap
    press = push + min(max(-dashpot * normal, -push), push)
    rub, slip = _rub(slip + along * time_step, along, spring, dashpot, intruder.friction * press)
    return Touch(press * nx - rub * nz, press * nz + rub * nx, -distance * nx, -distance * nz, slip)


@kernel
def _rub(
    slip: float, along: float, spring: float, dashpot: float, most: float
) -> tuple[float, float]:
    """Force along the surface [N/m], ``most`` at most, and the slip that the spring keeps [m]."""
    held = -spring * slip
    if abs(held) > most:
        held = math.copysign(most, held)
        return held, -held / spring
    return min(max(held - dashpot * along, -most), most), slip


@kernel
def push_particle(
    grid: Grid, x: float, z: float, touched: Touch, cell_size: float, time_step: float
) -> None:
    """Give a force on a particle to the grid's momenta.

    Parameters
    ----------
    grid
        Holds momenta [kg/s]; added to.
    x, z
        Where the particle stands on the grid [m].
    touched
        The force and where it acts.
    cell_size, time_step
        Δx [m], Δt [s].
    """
    per_cell = 1.0 / cell_size
    i, j = int(x * per_cell - 0.5), int(z * per_cell - 0.5)
    fx, fz = x * per_cell - i, z * per_cell - j
    wx, wz = weights(fx), weights(fz)
    px, pz = touched.fx * time_step, touched.fz * time_step
    ax, az = 4.0 * per_cell * touched.arm_x, 4.0 * per_cell * touched.arm_z
    for b in range(3):
        for a in range(3):
            share = wz[b] * wx[a] * (1.0 + ax * (a - fx) + az * (b - fz))
            grid.vx[j + b, i + a] += share * px
            grid.vz[j + b, i + a] += share * pz


@kernel
def radius_of(soil: Particles, p: int) -> float:
    """Half the side of the square that a particle stands for [m]."""
    return 0.5 * math.sqrt(soil.volume[p] * soil.stretch[p])
