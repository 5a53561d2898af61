r"""Resistive force theory: the soil's force on each element of a leg, as if it were alone.

Each element of the leg feels a stress that grows with its depth and depends on how it is inclined
and where it moves, and on nothing else: neither on speed (slow motion is assumed) nor on its
neighbours, nor on what passed there before. Two laws are known here.

``dimensions = 2``
    Li, Zhang & Goldman, *Science* 339:1408 (2013), doi 10.1126/science.1229163, with the
    coefficients of a named medium and a factor ζ. The soil's density and friction angle play no
    part: they are in the coefficients. The stress belongs to an element, not to a face, and so
    does not ask which side leads.
``dimensions = 3``
    Agarwal, Goldman & Kamrin, *PNAS* 120 (2023), doi 10.1073/pnas.2214017120, from the bulk
    density ρ, an internal friction :math:`\mu = \tan\varphi` and the leg's surface friction
    :math:`\mu_s`. Only faces that lead and are submerged feel anything. φ is the parameter of this
    empirical law, fitted to continuum simulations with that internal friction; it is a convention
    of its own, and ``soil.yield_criterion`` plays no part.

Both see the leg as its centre line, a sheet without thickness: its round ends and edges, small
next to its faces, are left out. So the plate is a straight leg here. For the straight leg of Li et
al. in loose poppy seeds this is also what the published figures of the second law amount to.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from terraphi.experiment.arrays import FloatArray, namespace
from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.leg import Leg, frame_axes
from terraphi.experiment.motion import Poses, bin_centres
from terraphi.experiment.units import GRAVITY
from terraphi.forward.feet import for_arrays, scale_of_friction

if TYPE_CHECKING:
    from terraphi.experiment.scenario import Scenario

BLOCK = 512
"""Poses evaluated together; bounds the memory."""
GRAZING = 1e-9
"""N·v over which the force on a face begins [-]. The law does not fade as n·v does, so that without
this margin rounding would decide over a face that slides along itself."""
AT_ONCE = 4096
"""Faces whose stress is found at a time, so that they stay in the processor's cache."""


PLANE_COEFFICIENTS = {
    "generic": (0.206, 0.169, 0.212, 0.358, 0.055, -0.124, 0.253, 0.007, 0.088),
    "poppy_loose": (0.051, 0.047, 0.053, 0.083, 0.020, -0.026, 0.057, 0.000, 0.025),
    "poppy_close": (0.094, 0.092, 0.092, 0.151, 0.035, -0.039, 0.086, 0.018, 0.046),
    "glass03_loose": (0.040, 0.030, 0.045, 0.077, 0.000, -0.031, 0.066, 0.000, 0.017),
    "glass03_close": (0.081, 0.063, 0.078, 0.133, 0.024, -0.050, 0.087, 0.000, 0.033),
    "glass3_close": (0.045, 0.031, 0.046, 0.084, 0.012, -0.031, 0.060, 0.000, 0.015),
}
"""Fourier coefficients A00, A10, B11, B01, B-11, C11, C01, C-11, D10 of the stress per depth in two
dimensions [N/cm³], by medium: Li et al. (2013), supplement; ``generic`` needs its ζ."""


def simulate(
    scenario: Scenario, *, progress: Callable[[float], None] | None = None
) -> ForceHistory:
    """Sum the resistive forces over the leg along its path.

    Parameters
    ----------
    scenario
        A scenario of ``model = "rft"``.
    progress
        Called now and then with the fraction done, 0 to 1.

    Returns
    -------
    ForceHistory
        Force at the centre of each bin of the path (0.1° of a rotation). The law is smooth and
        independent of speed, so this stands for the mean over the bin.

    Raises
    ------
    InputError
        If the soil has cohesion, which neither law knows.
    """
    if scenario.soil.cohesion > 0.0:
        raise InputError(
            f"soil.cohesion = {scenario.soil.cohesion:g} Pa: resistive force theory knows "
            "cohesionless soil only; set it to 0, or model = 'mpm'"
        )
    began = time.perf_counter()
    centres = bin_centres(scenario.motion)
    force, moment = np.zeros((len(centres), 2)), np.zeros(len(centres))
    for first in range(0, len(centres), BLOCK):
        block = slice(first, first + BLOCK)
        poses = scenario.motion.poses_at(centres[block])
        force[block], moment[block] = leg_force(scenario, poses)
        if progress is not None:
            progress(min(first + BLOCK, len(centres)) / len(centres))
    seconds = {"all": time.perf_counter() - began}
    return ForceHistory(
        centres,
        force,
        coordinate=scenario.motion.coordinate,
        provenance={"panels": scenario.rft.panels, "seconds": seconds},
        moment=moment,
    )


def leg_force(scenario: Scenario, poses: Poses) -> tuple[FloatArray, FloatArray]:
    """Force of the soil on the leg at some poses, and its moment about the hip.

    Parameters
    ----------
    scenario
        Soil, leg, free surface and which of the two laws.
    poses
        Where the leg is and how it moves; of the velocities only the direction counts.

    Returns
    -------
    ndarray
        Fx, Fz [N], shape [pose, 2].
    ndarray
        Moment [N m], positive in the direction of increasing θ, shape [pose].
    """
    soil, rft, leg = scenario.soil, scenario.rft, scenario.leg
    weight = scenario.bed.gravity / GRAVITY  # both laws are proportional to that of the soil
    stress: Callable[[FloatArray, FloatArray], FloatArray]
    if scenario.dimensions == 2:
        stress = partial(stress_per_depth_2d, medium=rft.medium, scale=rft.scale * weight)
    else:
        scale = float(stress_scale(soil.friction_angle_deg, soil.density * weight))
        stress = partial(sheet_stress, surface_friction=leg.friction, scale=scale)
    return sheet_force(leg, poses, stress, surface=scenario.bed.surface, panels=rft.panels)


def sheet_force(
    leg: Leg,
    poses: Poses,
    stress: Callable[[FloatArray, FloatArray], FloatArray],
    *,
    surface: float,
    panels: int = 200,
) -> tuple[FloatArray, FloatArray]:
    """Sum a stress per depth over the center line of a leg: force and moment of :func:`leg_force`.

    Parameters
    ----------
    stress
        Stress per depth [Pa/m] on elements with a tangent and a direction of motion, shape
        [element, 2] each.
    surface
        Height of the free surface [m].
    panels
        Number of elements.
    """
    line = leg.centre_line(panels)
    along, motion = (axis[:, None, :] for axis in frame_axes(poses.theta))
    # From the hip, and along the line, as (x, z), shape [pose, panel, 2].
    arm, tangent = (
        vectors[:, :1] * along + vectors[:, 1:] * motion for vectors in (line.centre, line.tangent)
    )
    # A point at r from the hip moves at θ̇ (r_z, -r_x), besides as the hip does.
    sweep = np.stack([arm[..., 1], -arm[..., 0]], axis=-1)
    velocity = poses.velocity[:, None, :] + poses.rate[:, None, None] * sweep
    speed = np.linalg.norm(velocity, axis=-1, keepdims=True)
    # An element that happens to stand still has no direction, and feels nothing here.
    direction = np.divide(velocity, speed, out=np.zeros_like(velocity), where=speed > 0.0)
    depth = surface - (poses.hip[:, None, 1] + arm[..., 1])
    submerged = depth > 0.0
    per_depth = np.zeros((*submerged.shape, 2))
    per_depth[submerged] = stress(tangent[submerged], direction[submerged])
    area_depth = np.where(submerged, depth, 0.0) * line.length * leg.width
    pushed = area_depth[..., None] * per_depth
    moment = arm[..., 1] * pushed[..., 0] - arm[..., 0] * pushed[..., 1]
    return pushed.sum(axis=1), moment.sum(axis=1)


def sheet_stress(
    tangent: FloatArray, direction: FloatArray, *, surface_friction: float, scale: float = 1.0
) -> FloatArray:
    """Stress per depth on the leading faces of a thin sheet: a scale times :func:`unit_stress`."""
    normal = np.stack([tangent[:, 1], -tangent[:, 0]], axis=-1)
    # A sheet has two faces; the one that leads is the one whose normal goes with the motion.
    normal *= np.where(np.vecdot(normal, direction) >= 0.0, 1.0, -1.0)[:, None]
    return np.asarray(scale * unit_stress(normal, direction, surface_friction))


def stress_per_depth_2d(
    tangent: FloatArray, direction: FloatArray, *, medium: str, scale: float = 1.0
) -> FloatArray:
    r"""Stress per depth on elements in two dimensions.

    With the angle of attack β of the element from the horizontal and the angle of intrusion γ of
    its velocity, both measured for a motion towards -x as positive downward,

    .. math::
        \alpha_z &= A_{00} + A_{10}\cos 2\beta + B_{11}\sin(2\beta+\gamma) + B_{01}\sin\gamma
                    + B_{-11}\sin(-2\beta+\gamma) \\
        \alpha_x &= C_{11}\cos(2\beta+\gamma) + C_{01}\cos\gamma + C_{-11}\cos(-2\beta+\gamma)
                    + D_{10}\sin 2\beta

    (Li et al., 2013, supplement). β matters modulo π only.

    Parameters
    ----------
    tangent
        Unit tangents (x, z) [-], shape [element, 2]; their sign does not matter.
    direction
        Unit vectors of the velocity (x, z) [-], shape [element, 2].
    medium
        Name in ``PLANE_COEFFICIENTS``.
    scale
        Factor ζ [-].

    Returns
    -------
    ndarray
        α of x and z [N/m³], shape [element, 2]; the force on an element is α × depth × area.
    """
    a00, a10, b11, b01, bm11, c11, c01, cm11, d10 = PLANE_COEFFICIENTS[medium]
    twice = 2 * np.arctan2(-tangent[:, 1], tangent[:, 0])
    gamma = np.arctan2(-direction[:, 1], -direction[:, 0])
    alpha_z = a00 + a10 * np.cos(twice) + b11 * np.sin(twice + gamma)
    alpha_z += b01 * np.sin(gamma) + bm11 * np.sin(-twice + gamma)
    alpha_x = c11 * np.cos(twice + gamma) + c01 * np.cos(gamma)
    alpha_x += cm11 * np.cos(-twice + gamma) + d10 * np.sin(twice)
    still = ~direction.any(axis=1)
    alpha = np.stack([alpha_x, alpha_z], axis=-1) * (scale * 1e6)  # N/cm³ to N/m³
    alpha[still] = 0.0
    return np.asarray(alpha, dtype=np.float64)


def stress_scale(friction_angle_deg: ArrayLike, density: float) -> FloatArray:
    r"""Stress per depth :math:`\xi = \rho g (894\mu^3 - 386\mu^2 + 89\mu)` of a medium.

    Agarwal et al. (2023); :math:`\mu = \tan\varphi`.

    Parameters
    ----------
    friction_angle_deg
        φ of this law [deg], of any shape.
    density
        Bulk density ρ [kg/m³].

    Returns
    -------
    ndarray
        ξ [N/m³], of the same shape.
    """
    return np.asarray(scale_of_friction(np.tan(np.radians(friction_angle_deg)), density))


def to_plane_strain(friction_angle_deg: ArrayLike) -> FloatArray:
    """φ in plane strain of soil of an angle of this theory [deg]; not a number from 45° on.

    The theory is of soil that yields at √J₂ = p tan φ and does not dilate.
    """
    with np.errstate(invalid="ignore"):
        return np.asarray(np.degrees(np.arcsin(np.tan(np.radians(friction_angle_deg)))))


def from_plane_strain(friction_angle_deg: ArrayLike) -> FloatArray:
    """Angle of this theory for soil of φ in plane strain [deg]."""
    return np.asarray(np.degrees(np.arctan(np.sin(np.radians(friction_angle_deg)))))


def unit_stress(
    normal: Any, direction: Any, surface_friction: float, *, fade: float = GRAZING
) -> Any:
    r"""Stress per depth on leading faces in three dimensions, over ξ of :func:`stress_scale`.

    Agarwal et al. (2023), written with vectors in place of their angles β, γ, ψ: with
    :math:`\hat n` the normal of the element that points down (theirs has :math:`-\cos\beta` for a
    vertical part, so it is the outward normal reversed where a face looks up), :math:`\hat v` the
    direction of motion and :math:`\hat g` that of gravity,

    .. math::
        x_1 = \hat g\cdot\hat v,\quad x_2 = \hat g\cdot\hat n,\quad x_3 = \hat n\cdot\hat v,\qquad
        \alpha = f_1 \hat n + f_2 \hat v + f_3 \hat g,

    each :math:`f_i` a cubic in :math:`x_1, x_2, x_3`. Of α, the part along the outward normal is
    kept, and the part along the face is cut to :math:`\mu_s` times it (Coulomb).

    Where a face turns through the vertical (:math:`x_2 = 0`), :math:`\hat n` and with it
    :math:`x_3` reverse. α would not change if there :math:`f_1` were odd and :math:`f_2`,
    :math:`f_3` even in :math:`x_3`. They were fitted without that condition, so the law jumps: on a
    vertical plate that moves level the pressure per depth is 0.192 ξ if it looks down a little and
    0.229 ξ if it looks up, so that Fx of the straight leg jumps by 18 % at θ = 0 (0.5 N of 3 N in
    loose poppy seeds). The law is as published here; ``fade`` can make it continuous, as
    :mod:`~terraphi.laws.wrench` does.

    Parameters
    ----------
    normal
        Outward unit normals [-], shape [face, axis]; the last axis is z, up. An array of NumPy, or
        of another library of the array-API standard.
    direction
        Unit vectors of the velocity [-], shape [face, axis].
    surface_friction
        Coulomb coefficient between intruder and soil μ_s [-].
    fade
        Sine over which the law is made continuous [-]: on a face whose normal is so close to the
        level it goes over from that of faces that look up to that of faces that look down, and on
        one that leads by so little it fades.

    Returns
    -------
    array
        α/ξ [-], shape [face, axis]; zero where the face does not lead (n·v not positive). The force
        on a face is ξ × α/ξ × depth × area.
    """
    xp = namespace(normal)
    normal, direction = xp.broadcast_arrays(normal, direction)
    count, parts, of = max(normal.shape[0], 1), [], for_arrays(xp)
    size = AT_ONCE if xp is np else count
    for block in (slice(first, first + size) for first in range(0, count, size)):
        # In two dimensions nothing is along y.
        n, v = ((part[block, 0], part[block, 1] if part.shape[1] == 3 else 0.0 * part[block, 0],
                 part[block, -1]) for part in (normal, direction))  # fmt: skip
        stress = of.face_stress(n, v, of.dot(n, v), surface_friction, fade, fade > GRAZING)
        parts.append(xp.stack(stress if normal.shape[1] == 3 else stress[::2], axis=1))
    return xp.concat(parts, axis=0)
