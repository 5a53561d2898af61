r"""Force and moment of soil on feet that a simulator moves: balls, discs and meshes, many at once.

All take φ in plane strain and have the level of law ``foot`` (:mod:`~terraphi.laws.foot`). A ball
or a disc has the law itself. A mesh has the faces' forces by resistive force theory, in the
proportion in which both differ for a ball and a disc of the mesh's footprint:

.. math::
    F = \sum_f C\bigl(\operatorname{diag}(d, d, l)\, F_f^{rft}\bigr), \qquad
    (d, l) = m\,(d, l)_{ball} + (1 - m)\,(d, l)_{disc},

with Coulomb's bound C, which cuts the part of a face's force along the face to μ_s times the part
across it, the drag's and the lift's ratio d and l over φ, direction and depth, and the roundness m
of what points down and is submerged: one less the length of its mean normal (weighted by projected
area), over that of a cap of the same area and depth. It is 0 for a plane, tilted or not. The ratios
are those that give a ball and a disc the law's force with the bound. So meshes of both have it
(``tests/laws/test_wrench.py``), but for drag of a disc above μ_s times the lift; other shapes come
between.

Resistive force theory jumps where a face turns through the vertical or begins to lead; here it is
continuous (:data:`~terraphi.forward.feet.FADE`).

Arrays may be of NumPy or of another library of the array-API standard, as PyTorch, CuPy and JAX;
results are of the same library, type and device.

**At rest.** No quasi-static law has a force on a foot that stands. There are two ways:

- without memory, the force fades below ``rest_speed`` v₀, so that a standing foot creeps. It acts
  as a damper of F/v₀: an explicit step h of an apparent mass m is stable for h < 2 m v₀ / F.
- with the force ``held`` from the step before, it follows the law over a displacement,

  .. math:: f \leftarrow F + (f - F)\, e^{-k |\Delta x| / \max(|f|, |F|)},

  which is a spring of stiffness k at rest and the law in steady motion: a standing foot stays. The
  slope of f is at most 2 k, since \|f − F\| is at most twice the larger. So a semi-implicit Euler
  step h is stable for 2 k h² < 4 m, that is **k h² < 2 m**, with m the least apparent mass of the
  foot, one over the largest eigenvalue of J M⁻¹ Jᵀ. Feet of one body share its mass: take M as it
  is, and J of all feet that stand. Take k near that bound: a soft spring without a damper ratchets
  (1 kg on a ball of 22 mm, steps of 5 ms: 8 mm deep after 8 s at a quarter of it, 102 mm and
  sinking at a fortieth; with a damper of 20 N s/m it stays at 2 and 9 mm).
"""

from __future__ import annotations

import math
import sys
import warnings
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from terraphi.experiment.arrays import HUGE, FloatArray, between_rows, like, namespace, numbers
from terraphi.experiment.errors import InputError, nearest
from terraphi.experiment.priors import FOOT_FRICTION
from terraphi.experiment.scenario import LIMITS
from terraphi.experiment.units import GRAVITY
from terraphi.forward import feet
from terraphi.forward.feet import FADE, TINY, for_arrays, scale_of_friction
from terraphi.forward.rft import unit_stress
from terraphi.laws.foot import (
    BEYOND_DEG,
    DEEPEST,
    DEPTHS,
    DESCENTS,
    MOVED,
    Foot,
    foot_faces,
    resistive_table,
    simulated_table,
)

LOWEST = 33
"""Row of :data:`~terraphi.laws.foot.DESCENTS` of the lowest direction for which the ratios are
computed, 9°; motions below it have those. There a level face begins to lead."""
SIMULATED = 45
"""Row of the lowest direction that was simulated, 45°."""
PROPORTIONS = np.linspace(0.0, 1.5, 16)
"""Ratio of the drag over that of the lift, d/l, for which balls and discs are summed [-]."""
FINE, MOST_FACES = 0.75, 100_000
"""Longest edge of a face over the extent of its mesh [-], and faces at most; chosen: a box of 36
faces that does not turn has the exact force, one that turns with edges at 0.12 of its speed that of
6,144 faces within 0.1 % in the median of directions, and 4 % in 95 of 100."""
LARGEST = 2.0
"""Farthest face from the origin of a foot [m]; chosen."""
UNIT = 0.01
"""Error of the length of a unit normal [-]; chosen, for normals that were rounded."""
FLAT = 0.01
"""Roundness below which a mesh is flat [-]; chosen, for a warning alone."""
FASTEST = 10.0
"""Speed beyond which a landing has its inertia [m/s]; chosen. Balls that the inertia was learned
from hit at up to 1.5 m/s."""
FEW = 16
"""Balls or discs up to which plain numbers are faster than arrays where nothing is compiled."""
NONE: FloatArray = np.zeros((1, 6))
"""Force and moment of feet that are not held."""
DOUBLE, PLAIN = np.dtype(np.float64), frozenset({float, int, np.float64})
WIDTHS = (3, 7), (3, 6), (3,), (3,)
"""Types of a number, and last axes of pose, velocity, and force and moment that are held."""


@dataclass(frozen=True, eq=False, init=False)
class Mesh:
    """Triangles of a foot's surface in its own frame; :meth:`of` checks that it is closed.

    Attributes
    ----------
    corners
        Of the triangles [m], counterclockwise seen from outside, shape [face, 3, 3].
    """

    corners: FloatArray

    def __init__(self, corners: Any, *former: Any) -> None:
        """Check the corners; raises InputError."""
        if former:
            raise InputError("Mesh takes corners alone; for points, normals and areas call wrench")
        ends: dict[str, Any] = {"low": -2.0 * LARGEST, "high": 2.0 * LARGEST, "unit": "m"}
        corners = numbers("corners", corners, last=(3,), **ends)
        if corners.ndim != 3 or corners.shape[1] != 3 or not corners.size:
            raise InputError(f"corners of shape {corners.shape}; give [face, 3, 3]")
        object.__setattr__(self, "corners", corners.copy())  # faces are kept
        numbers("corners: areas of the triangles", self.areas, low=TINY**2, unit="m²")

    @classmethod
    def of(cls, mesh: Any, triangles: Any = None, *, longest: float | None = None) -> Mesh:
        """Faces of a closed surface of triangles, large ones in parts.

        Parameters
        ----------
        mesh
            Corners [m], shape [corner, 3]; or an object with ``vertices`` and ``faces``, as those
            of trimesh.
        triangles
            Corners of each triangle, counterclockwise seen from outside, shape [face, 3].
        longest
            Longest edge of a face [m]; triangles are halved along each edge until they have it. By
            default :data:`FINE` of the extent. Faces matter for a foot that turns alone.

        Raises
        ------
        InputError
            If the shapes are others, no triangle has an area, there are too many, or the surface
            is open, has a face twice, is inside out or larger than a foot.
        """
        if triangles is None:
            mesh, triangles = getattr(mesh, "vertices", None), getattr(mesh, "faces", None)
        expected = "mesh: give corners [corner, 3], triangles [face, 3], or vertices and faces"
        if mesh is None or triangles is None:
            raise InputError(expected)
        corners = numbers("mesh", mesh, last=(3,), unit="m")
        index = numbers("triangles", triangles, last=(3,), low=0, high=len(corners) - 1)
        if corners.ndim != 2 or index.ndim != 2 or (index % 1.0).any():
            raise InputError(expected)
        each = corners[index.astype(np.int64)]
        # A closed surface passes each edge once in either direction; equal corners are one.
        same = np.unique(each.reshape(-1, 3), axis=0, return_inverse=True)[1].reshape(-1, 3)
        same = same[(same != np.roll(same, 1, axis=1)).all(axis=1)]
        edges = np.stack([same, np.roll(same, -1, axis=1)], axis=-1).reshape(-1, 2)
        there, back = (np.unique(pairs, axis=0) for pairs in (edges, edges[:, ::-1]))
        if len(there) < len(edges) or not np.array_equal(there, back):
            raise InputError(
                "mesh: the surface is not closed, has a face twice or one that runs the other way; "
                "give one solid, its corners counterclockwise from outside"
            )
        most = FINE * float(np.ptp(each.reshape(-1, 3), axis=0).max())
        most = most if longest is None else _number("longest", longest, TINY, "m")
        while (
            large := (np.linalg.norm(each - each[:, (1, 2, 0)], axis=2) > most).any(axis=1)
        ).any():
            # A triangle becomes four by the middles of its edges, similar to it and half as long.
            a, b, c = each[large].swapaxes(0, 1)
            ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
            quarters = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
            each = np.concatenate(
                [each[~large], *(np.stack(quarter, axis=1) for quarter in quarters)]
            )
            if len(each) > MOST_FACES:
                why = f"more than {MOST_FACES} faces with edges of {most:g} m; give longest"
                raise InputError(f"mesh: {why}")
        reach = float(np.linalg.norm(each.mean(axis=1), axis=1).max(initial=0.0))
        if reach > LARGEST:
            raise InputError(f"mesh: reaches {reach:g} m; corners are in meters")
        cross = np.cross(each[:, 1] - each[:, 0], each[:, 2] - each[:, 0])
        twice = np.linalg.norm(cross, axis=1)
        keep = twice > 0.0
        if not keep.any():
            raise InputError("mesh: no triangle has an area")
        solid = cls(each[keep])
        if solid.areas @ np.vecdot(solid.normals, solid.points) <= 0.0:
            raise InputError("mesh: turned inside out; order corners counterclockwise from outside")
        return solid

    @cached_property
    def faces(self) -> FloatArray:
        """Corners [m], unit normals [-] and areas [m²], shape [13, face]."""
        a, b, c = self.corners.swapaxes(0, 1)
        cross = np.cross(b - a, c - a)
        twice = np.linalg.norm(cross, axis=1, keepdims=True)
        normals = cross / np.maximum(twice, TINY**2)
        return np.ascontiguousarray(np.hstack([a, b, c, normals, 0.5 * twice]).T)

    @cached_property
    def points(self) -> FloatArray:
        """Centres of the triangles [m], shape [face, 3]."""
        return np.asarray(self.corners.mean(axis=1))

    @property
    def normals(self) -> FloatArray:
        """Outward unit normals [-], shape [face, 3]."""
        return self.faces[9:12].T

    @property
    def areas(self) -> FloatArray:
        """Of the triangles [m²], shape [face]."""
        return self.faces[12]

    @cached_property
    def reach(self) -> float:
        """Distance from the origin that no face exceeds [m]."""
        around = np.linalg.norm(self.corners - self.points[:, None], axis=2).max(axis=1)
        return float((np.linalg.norm(self.points, axis=1) + around).max())

    def footprint(self, depth: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Radius [m] and roundness [-] of what is submerged, shape [depth] each.

        At depths of its origin [m], level; the radius is that of a circle of the projected area,
        and the roundness 1 for a ball and 0 for a disc.
        """
        below = depth[:, None] - self.points[:, 2]
        down = np.where(below > 0.0, self.areas * np.maximum(-self.normals[:, 2], 0.0), 0.0)
        normal = tuple((down @ self.normals).T)
        radius, roundness, _ = for_arrays(np).footprint(down.sum(axis=1), normal, below.max(axis=1))
        return radius, roundness


def force(
    foot: Foot | Mesh,
    pose: Any,
    velocity: Any,
    *,
    phi_deg: Any,
    density: Any,
    surface_friction: float = FOOT_FRICTION.mean,
    surface: Any = 0.0,
    rest_speed: float = 0.01,
    held: tuple[Any, Any] | None = None,
    step: float | None = None,
    stiffness: float | None = None,
    inertia: bool = True,
) -> tuple[Any, Any]:
    """Force and moment of soil on feet, by law ``foot``.

    Parameters
    ----------
    foot
        A ball or disc, or a mesh.
    pose
        Of the feet: the position of the centre of a ball or disc, or of a mesh's origin [m], shape
        [..., 3]; with a unit quaternion (w, x, y, z), shape [..., 7]. z is up.
    velocity
        In the world: linear [m/s], shape [..., 3]; with angular [rad/s], shape [..., 6].
    phi_deg, density
        φ in plane strain [deg] and bulk density [kg/m³]: numbers, or one for each foot, [...].
    surface_friction
        Coulomb coefficient between foot and soil [-], 0.05 to 0.65.
    surface
        Height of the level surface [m], a number or one for each foot.
    rest_speed
        Below it the force falls with the speed to zero [m/s], unless it is ``held``.
    held
        What this function returned at the step before; zeros at first.
    step
        Time since then [s].
    stiffness
        Of soil that holds a foot, k [N/m]; below 2 m over the square of ``step`` it is stable (see
        the module).
    inertia
        Whether a ball or disc that goes down feels the momentum of the soil that it sets in motion,
        v² dm/dz (:func:`~terraphi.laws.foot.moved_mass`). Meshes do not.

    Returns
    -------
    tuple of array
        Force [N] and moment about the position [N m], shape [..., 3]. A ball's moment is that of
        resistive force theory in the lift's proportion; a disc has none, and stays level.

    Raises
    ------
    InputError
        If φ or the friction is outside the law's table, a number is not finite or out of range, or
        a shape is another. Arrays that JAX or PyTorch traces have no numbers to check yet.

    Warns
    -----
    UserWarning
        If a foot is deeper than the law was simulated (arrays of NumPy only).

    Examples
    --------
    >>> from terraphi.laws.wrench import force
    >>> up, _ = force(Foot(0.022), [0.0, 0.0, 0.0], [0.0, 0.0, -0.1], phi_deg=35.0, density=1550.0)
    >>> bool(up[2] > 0.0)
    True
    """
    if not isinstance(foot, (Foot, Mesh)):  # a union would be made at each call
        raise InputError(f"foot of type {type(foot).__name__}; give a Foot or a Mesh")
    checked: Any = _checked(pose, velocity, phi_deg, density, surface_friction, surface, rest_speed,
                            held, step, stiffness)  # fmt: skip
    if checked and (wrenches := _one_by_one(foot, *checked, inertia=inertia)) is not None:
        if pose.ndim != 2:
            wrenches = wrenches.reshape(*pose.shape[:-1], 6)
        return wrenches[..., :3], wrenches[..., 3:]
    pose = numbers("pose", pose, last=(3, 7), unit="m")
    velocity = numbers("velocity", velocity, pose, last=(3, 6), unit="m/s")
    rest_speed = _number("rest_speed", rest_speed, low=TINY, unit="m/s")
    xp, lead = namespace(pose), tuple(pose.shape[:-1])
    place = xp.reshape(pose, (-1, pose.shape[-1]))
    if place.shape[-1] == 7:
        length = xp.sqrt(xp.sum(place[:, 3:] ** 2, axis=1))
        numbers("pose: length of the quaternion", length, low=1e-6)
    moving = _each("velocity", velocity, pose, lead, velocity.shape[-1])
    soil = _soil(pose, lead, "foot", surface_friction, phi_deg, density, surface)
    fade, before, stride = (TINY if held is not None else rest_speed), None, 0.0
    if held is not None:
        if step is None or stiffness is None:
            raise InputError(
                "held: give the time since then as step [s], and stiffness [N/m], below 2 m / step²"
            )
        last: Any = held
        if not isinstance(last, tuple | list) or len(last) != 2:
            kind = type(held).__name__
            raise InputError(f"held is {kind}; give force and moment of the step before")
        before = xp.concat([_each("held", values, pose, lead, 3) for values in last], axis=1)
        stride = _number("stiffness", stiffness, unit="N/m") * _number("step", step, unit="s")
    wrenches = None
    if xp is np:
        columns = np.stack([soil["phi_deg"], soil["density"], soil["surface"]], axis=1)
        wrenches = _one_by_one(foot, place, moving, columns, soil["surface_friction"], fade, before,
                               stride, inertia=inertia)  # fmt: skip
    if wrenches is None:
        wrenches = _at_once(foot, place, moving, soil, fade, before, stride, inertia)
    return tuple(xp.reshape(part, (*lead, 3)) for part in (wrenches[:, :3], wrenches[:, 3:]))


def _at_once(
    foot: Foot | Mesh, place: Any, moving: Any, soil: dict[str, Any], fade: Any, before: Any,
    stride: Any, inertia: bool,
) -> Any:  # fmt: skip
    """Force and moment on feet by operations on arrays of any library, shape [foot, 6]."""
    xp, friction = namespace(place), soil["surface_friction"]
    of, linear, spin = for_arrays(xp), _columns(moving[:, :3]), None
    travel, height = of.norm(linear), soil["surface"] - place[:, 2]
    if isinstance(foot, Foot):
        _, (is_ball, *rest) = _function(foot, friction, inertia)
        depth = height + (foot.radius if is_ball else 0.0)
        _warn_deep(xp, depth / foot.radius)
        wrench = of.foot_wrench(linear, depth, soil["phi_deg"], soil["density"], fade, *rest)
    else:
        faces = [like(place, row)[None, :] for row in foot.faces]
        rows: Any = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
        if place.shape[-1] == 7:
            rows = of.rotation(*(place[:, i : i + 1] for i in range(3, 7)))
        share, depths, lowest, arms = of.part_in_soil(
            rows, height[:, None], *(tuple(faces[i : i + 3]) for i in (0, 3, 6))
        )
        if moving.shape[-1] == 6:  # its farthest face moves by |ω| times its reach
            spin = _columns(moving[:, 3:])
            travel = travel + foot.reach * of.norm(spin)
        depth, normals = xp.max(lowest, axis=1), of.turned(rows, tuple(faces[9:12]))
        wrench = _sum_of_faces(
            (depths, share, depth), normals, faces[12], _columns(moving[:, None, :3]), arms, spin,
            surface_friction=friction, law="foot", rest_speed=fade, phi_deg=soil["phi_deg"],
            density=soil["density"],
        )  # fmt: skip
    if before is not None:
        wrench = of.held(wrench, (_columns(before), _columns(before[:, 3:])), travel, stride, depth)
    return xp.stack([*wrench[0], *wrench[1]], axis=1)


def _columns(vectors: Any) -> Any:
    """The three components of vectors, over the last axis."""
    return tuple(vectors[..., i] for i in range(3))


@lru_cache(maxsize=16)
def _function(foot: Foot | Mesh, friction: float, inertia: bool) -> tuple[Any, ...]:
    """Function of :mod:`~terraphi.forward.feet` for a foot, and arguments that stay the same."""
    functions: Any = feet.compiled() or feet
    if isinstance(foot, Foot):
        first, step, table = _foot_table(foot.shape, friction)
        moved = inertia * MOVED[0] * math.pi * foot.radius**2
        return functions.feet, (foot.shape == "ball", table, first, step, float(foot.radius), moved,
                                MOVED[1] * foot.radius, FASTEST)  # fmt: skip
    (first, step, ball), (_, _, disc) = (_ratio_table(s, friction) for s in ("ball", "disc"))
    return functions.meshes, (foot.faces, ball, disc, first, step, friction, FLAT, foot.reach)


def _one_by_one(
    foot: Foot | Mesh, place: FloatArray, moving: FloatArray, soil: FloatArray, friction: float,
    fade: float, before: FloatArray | None, stride: float, *, inertia: bool,
) -> FloatArray | None:  # fmt: skip
    """Force and moment on feet by :mod:`~terraphi.forward.feet`, shape [foot, 6].

    ``soil`` has φ, density and surface, shape [foot or 1, 3], ``before`` the force and moment that
    are held, [foot, 6], and ``stride`` is their stiffness times the time. ``None`` where a number
    cannot be used, or operations on arrays are faster.
    """
    if (isinstance(foot, Mesh) or len(place) > FEW) and feet.compiled() is None:
        return None
    function, rest = _function(foot, friction, inertia)
    # Of one kind: for another, as of arrays that cannot be written, all would be compiled again.
    if not (place.flags.carray and moving.flags.carray):
        place, moving = np.array(place, order="C"), np.array(moving, order="C")
    if before is None:
        before, stride = NONE, -1.0
    deepest, wrenches = function(place, moving, soil, before, fade, stride, *rest)
    if deepest > DEEPEST:
        _warn_deep(np, np.array([deepest]))
    return wrenches if deepest >= 0.0 else None


def _checked(
    pose: Any, velocity: Any, phi_deg: Any, density: Any, friction: Any, surface: Any,
    rest_speed: Any, held: Any, step: Any, stiffness: Any,
) -> tuple[Any, ...] | None:  # fmt: skip
    """Arguments of :func:`_one_by_one` after the foot, up to ``inertia``; ``None`` of others.

    Of arrays of NumPy and numbers for all feet: a check of each by itself costs more than the force
    on four feet. Whether places and velocities are finite is left to the function; what is held,
    which only limits a force there, is checked here.
    """
    try:
        soil = _row(phi_deg, density, friction, surface, rest_speed)
    except TypeError:  # arrays have no hash
        return None
    if held is not None and (type(held) is not tuple or not _are_plain(step, stiffness)):
        return None
    arrays: Any = (pose, velocity) if held is None else (pose, velocity, *held)
    lead = getattr(pose, "shape", ())[:-1]
    for array, widths in zip(arrays, WIDTHS, strict=False):
        if type(array) is not np.ndarray or array.dtype != DOUBLE or array.shape[:-1] != lead:
            return None
        if not array.ndim or array.shape[-1] not in widths:
            return None
    if soil is None or len(arrays) != (2 if held is None else 4):
        return None
    if len(lead) != 1:
        arrays = [array.reshape(-1, array.shape[-1]) for array in arrays]
    place, moving, *last = arrays
    if held is None:
        return place, moving, soil, friction, float(rest_speed), None, 0.0
    before = np.concatenate(last, axis=1)
    if step < 0.0 or stiffness < 0.0 or not np.abs(before).max(initial=0.0) < HUGE:
        return None
    return place, moving, soil, friction, TINY, before, float(step * stiffness)


@lru_cache(maxsize=64, typed=True)
def _row(
    phi_deg: Any, density: Any, friction: Any, surface: Any, rest_speed: Any
) -> FloatArray | None:
    """φ, density and surface, shape [1, 3]; ``None`` unless all are numbers in range."""
    if not _are_plain(phi_deg, density, friction, surface, rest_speed):
        return None
    (low, high), (least, most, _) = angles_deg(friction), LIMITS["soil.density"]
    is_in_range = low <= phi_deg <= high and least <= density <= most and rest_speed >= TINY
    return np.array([[phi_deg, density, surface]], DOUBLE) if is_in_range else None


def _are_plain(*values: Any) -> bool:
    """True of finite numbers of Python or NumPy."""
    # An integer may exceed any float.
    return all(type(value) in PLAIN and abs(value) < HUGE for value in values)


def _number(name: str, value: Any, low: float = 0.0, unit: str = "") -> Any:
    """A number that is not negative; raises InputError."""
    array = numbers(name, value, shape=(), low=low, unit=unit)
    return float(array) if namespace(array) is np else array


def _each(
    name: str, value: Any, places: Any, lead: tuple[int, ...], *last: int, **ends: Any
) -> Any:
    """A row for each foot of an array of places, shape [foot, *last]; raises InputError."""
    rows = numbers(name, value, places, shape=(*lead, *last), **ends)
    return rows if len(lead) == 1 else namespace(places).reshape(rows, (-1, *last))


def _friction(surface_friction: Any) -> float:
    """The friction of all feet [-]; raises InputError."""
    low, high, _ = LIMITS["leg.friction"]
    value = numbers("surface_friction", surface_friction, low=low, high=high)
    if np.shape(value):
        raise InputError("surface_friction is an array; give a number, and call once for each")
    try:
        return float(value)
    except TypeError:
        raise InputError("surface_friction is traced; give a number") from None


def angles_deg(surface_friction: float) -> tuple[float, float]:
    """Least and largest φ of law ``foot`` [deg]; raises InputError as `simulated_table` does."""
    first, _, table = simulated_table("ball", float(surface_friction))
    return first - BEYOND_DEG, first + table.shape[1] - 1 + BEYOND_DEG


def _soil(
    places: Any, lead: tuple[int, ...], law: str, surface_friction: Any, phi_deg: Any, density: Any,
    surface: Any,
) -> dict[str, Any]:  # fmt: skip
    """Friction, and φ, density and surface of each foot of an array of places, [foot].

    Raises InputError.
    """
    friction = _friction(surface_friction)
    angles = angles_deg(friction) if law == "foot" else LIMITS["soil.friction_angle_deg"]
    low, high, unit = LIMITS["soil.density"]
    return {
        "surface_friction": friction,
        "phi_deg": _each("phi_deg", phi_deg, places, lead, low=angles[0], high=angles[1],
                         unit=f"deg in plane strain by law '{law}'"),
        "density": _each("density", density, places, lead, low=low, high=high, unit=unit),
        "surface": _each("surface", surface, places, lead, unit="m"),
    }  # fmt: skip


def _warn_deep(xp: Any, ratio: Any) -> None:
    """Warn of feet deeper than law ``foot`` was simulated, from depths over their radius [-]."""
    if xp is np and ratio.size and float(ratio.max()) > DEEPEST:
        frame, level = sys._getframe(), 1
        while frame.f_back and frame.f_globals["__name__"].startswith("terraphi."):
            frame, level = frame.f_back, level + 1  # to who called this package
        warnings.warn(  # one text, so that it is shown once
            f"a foot is deeper than {DEEPEST:g} radii, from where law 'foot' is extrapolated",
            stacklevel=level,
        )


def wrench(
    points: Any,
    normals: Any,
    areas: Any,
    velocities: Any,
    *,
    phi_deg: Any,
    density: Any,
    surface_friction: float,
    law: str = "foot",
    surface: Any = 0.0,
    about: Any = (0.0, 0.0, 0.0),
    rest_speed: float = 0.01,
    mobilization: float = 0.0,
    sheared: Any = None,
) -> tuple[Any, Any]:
    """Force and moment of soil on the faces of many feet, whose places are known already.

    Parameters
    ----------
    points
        Centres of the faces [m], shape [..., face, 3]; z is up.
    normals
        Outward unit normals [-], shape [..., face, 3] or [face, 3].
    areas
        Of the faces [m²], shape [face].
    velocities
        Of the faces [m/s], shape [..., face, 3] or what broadcasts to it, as [..., 1, 3].
    phi_deg
        φ in plane strain [deg], a number or one for each foot, shape [...].
    density
        Bulk density ρ [kg/m³], a number or one for each foot.
    surface_friction
        Coulomb coefficient between foot and soil [-].
    law
        Level of the forces: ``foot``, or ``rft``, resistive force theory as published.
    surface
        Height of the level surface [m], a number or one for each foot.
    about
        What the moment is about [m], shape [..., 3] or [3].
    rest_speed
        Below it the force falls with the speed to zero [m/s].
    mobilization
        Shear displacement K over which friction on a face develops [m]: it is the full one times
        1 − exp(−j/K) (Janosi & Hanamoto, 1961). By default all of it is there at once.
    sheared
        Shear displacement j of each face since it met the soil [m], shape [..., face].

    Returns
    -------
    tuple of array
        Force [N] and moment [N m], shape [..., 3]. By law ``foot`` the force on each face keeps
        Coulomb's bound.

    Raises
    ------
    InputError
        If φ or the friction is outside the law's table, a number is not finite or out of range, a
        normal has another length than 1, or there is no such law.

    Warns
    -----
    UserWarning
        If a foot is deeper than law ``foot`` was simulated (arrays of NumPy only).

    Examples
    --------
    >>> down, up = [[0.0, 0.0, -0.02]], [[0.0, 0.0, -1.0]]
    >>> soil = {"phi_deg": 33.0, "density": 1600.0, "surface_friction": 0.4}
    >>> force, moment = wrench(down, up, [1e-3], [[0.0, 0.0, -0.1]], **soil)
    >>> bool(force[2] > 0.0)
    True
    """
    if law not in ("foot", "rft"):
        raise InputError(f"unknown law '{law}'; {nearest(law, ('foot', 'rft'))}")
    points = numbers("points", points, last=(3,), unit="m")
    if points.ndim < 2 or points.shape[-2] == 0:
        raise InputError(f"points of shape {tuple(points.shape)}; give [..., face, 3]")
    xp, (lead, last) = namespace(points), (tuple(points.shape[:-2]), tuple(points.shape[-2:]))
    soil = _soil(points, lead, law, surface_friction, phi_deg, density, surface)
    flat, normals = xp.reshape(points, (-1, *last)), numbers("normals", normals, points, last=(3,))
    if tuple(normals.shape) != last:
        normals = _each("normals", normals, points, lead, *last)
    length = xp.sqrt(xp.sum(normals * normals, axis=-1))
    numbers("normals: length", length, low=1.0 - UNIT, high=1.0 + UNIT)
    velocities = _each("velocities", velocities, points, lead, *last, unit="m/s")
    arms = flat - _each("about", about, points, lead, 3, unit="m")[:, None, :]
    depth = soil.pop("surface")[:, None] - flat[:, :, 2]
    submerged = depth, like(depth, depth > 0.0), xp.max(depth, axis=1)
    most = 4.0 * LARGEST**2
    areas = numbers("areas", areas, points, shape=last[:1], low=0.0, high=most, unit="m²")
    sums = _sum_of_faces(
        submerged, _columns(normals), areas, _columns(velocities), _columns(arms), None, law=law,
        rest_speed=_number("rest_speed", rest_speed, low=TINY, unit="m/s"),
        mobilized=_mobilized(mobilization, sheared, points), **soil,
    )  # fmt: skip
    total, moment = (xp.reshape(xp.stack(part, axis=1), (*lead, 3)) for part in sums)
    return total, moment


def _mobilized(mobilization: Any, sheared: Any, points: Any) -> Any:
    """Share of the friction of each face that is there [-], shape [foot, face]; None if all is."""
    length = float(_number("mobilization", mobilization, unit="m"))
    if (length > 0.0) != (sheared is not None):
        raise InputError("mobilization, sheared: give both [m], or neither")
    if sheared is None:
        return None
    xp, faces = namespace(points), tuple(points.shape[:-1])
    way = numbers("sheared", sheared, points, shape=faces, low=0.0, unit="m")
    return xp.reshape(-xp.expm1(-way / length), (-1, faces[-1]))


def _sum_of_faces(
    submerged: tuple[Any, Any, Any], normals: Any, areas: Any, velocities: Any, arms: Any,
    spin: Any, *, surface_friction: float, law: str, rest_speed: float, phi_deg: Any, density: Any,
    mobilized: Any = None,
) -> tuple[Any, Any]:  # fmt: skip
    """Force and moment of feet, three arrays [foot] each.

    ``submerged`` is the depth of faces in the mean over what is in soil [m], this share of the
    area, [foot, face] each, and the greatest depth [m], [foot]. Vectors are three arrays that
    broadcast to [foot, face], or ``spin``, the angular velocity, [foot]; or ``None``. ``mobilized``
    is the share of the friction [foot, face], or ``None``.
    """
    depths, share, deepest = submerged
    xp, shape = namespace(depths), depths.shape
    of = for_arrays(xp)
    # NumPy computes the faces that are submerged only, the others have no force.
    at = np.nonzero(share > 0.0) if xp is np else None
    owner = at[0] if at else None

    def flat(values: Any) -> Any:
        """An array of faces, of what there is for faces or feet and faces."""
        values = xp.broadcast_to(values, shape)
        return values[at] if at else values

    def total(values: Any) -> Any:
        """Sum over the faces of each foot."""
        return xp.sum(values, axis=1) if owner is None else np.bincount(owner, values, shape[0])

    def spread(values: Any) -> Any:
        """A foot's number for each of its faces."""
        return values[:, None] if owner is None else values[owner]

    n, v, arm = (tuple(map(flat, vectors)) for vectors in (normals, velocities, arms))
    depth, area = xp.clip(flat(depths), 0.0, None), flat(areas * share)
    is_bounded = law == "foot" or mobilized is not None
    mobilized = 1.0 + 0.0 * area if mobilized is None else flat(mobilized)
    turning = (0.0, 0.0, 0.0) if spin is None else tuple(map(spread, spin))
    v, speed, direction, along = of.motion(v, turning, arm, n)
    # Before any face is dropped: projected area, depth and normal of what faces down.
    down = area * xp.clip(-n[2], 0.0, None)
    base, deep, normal = total(down), total(down * depth), tuple(total(down * part) for part in n)
    # Only faces that lead feel the soil. NumPy drops the others; traced arrays keep their shape.
    if owner is not None:
        kept = np.flatnonzero(along > 0.0)
        n, v, arm, direction = (
            tuple(part[kept] for part in each) for each in (n, v, arm, direction)
        )
        owner, depth, area, speed = owner[kept], depth[kept], area[kept], speed[kept]
        along, mobilized = along[kept], mobilized[kept]
    stress = scale_of_friction(xp.sin(math.pi / 180.0 * phi_deg), density)  # tan φ_rft = sin φ
    size = depth * area * xp.clip(speed / rest_speed, None, 1.0) * spread(stress)
    f = of.times(size, of.face_stress(n, direction, along, surface_friction, FADE, True))
    # To the level of law foot: drag and lift by their ratios, which depend on where the foot as a
    # whole goes, by the mean velocity of its leading faces; then each face to Coulomb's bound.
    if law == "foot":
        (first, step, ball), (_, _, disc) = (
            _ratio_table(name, surface_friction) for name in ("ball", "disc")
        )
        weight = area * xp.clip(along, 0.0, None)
        drag, lift, roundness, ratio = of.ratios(
            base, normal, deep, deepest, tuple(total(weight * part) for part in v),
            phi_deg - first, ball, disc, step,
        )  # fmt: skip
        # What is flat or on edge is no ball, whatever it points down with.
        _warn_deep(xp, xp.where((roundness > FLAT) & (base > TINY), ratio, 0.0 * ratio))
        f = f[0] * spread(drag), f[1] * spread(drag), f[2] * spread(lift)
    if is_bounded:
        f = of.coulomb(f, direction, n, surface_friction, mobilized)
    force, moment = (tuple(map(total, vectors)) for vectors in (f, of.cross(arm, f)))
    return force, moment


@lru_cache(maxsize=8)
def _ratio_table(shape: str, surface_friction: float) -> tuple[float, float, FloatArray]:
    """First φ [deg], step of the depth over the radius, and ratios times the depth over the radius.

    The ratios d, l of the module's formula and 0, [φ, descent, depth, 3], the descents from
    :data:`LOWEST` on. Times the depth, since what a footing bears at its surface is over the
    theory's as the radius over the depth.

    The bound leaves a face's force in proportion to a common factor of d and l. So d/l is that for
    which the sum over the faces of a ball or disc has the law's direction, and l follows from its
    size. A drag beyond the bound of a flat face has the d/l at which that slides.
    """
    first, step, law = simulated_table(shape, surface_friction)
    law, depths = law[:, :, LOWEST:], step * np.arange(law.shape[3], dtype=np.float64)
    sums = _bounded_sums(shape, surface_friction, depths)
    # Angle of the force above the level, over [descent, depth, d/l] and [φ, descent, depth]; drag
    # is negative. It falls with d/l, until all faces slide.
    turned, wanted = (np.arctan2(lift, -drag) for drag, lift in (sums, law))
    wanted = np.maximum(wanted, turned.min(axis=-1))
    # Bracket the wanted direction between two of the proportions that were summed, and interpolate.
    low = np.count_nonzero(turned > wanted[..., None] + 1e-9, axis=-1) - 1
    low = np.clip(low, 0, PROPORTIONS.size - 2)
    low[:, -1] = low[:, -2]  # Straight down nothing drags: as three degrees from it.
    rows, columns = np.indices(turned.shape[:2])
    before, after = (turned[rows, columns, low + i] for i in (0, 1))
    part = np.clip((before - wanted) / np.maximum(before - after, 1e-12), 0.0, 1.0)
    part[:, -1] = part[:, -2]
    proportion = PROPORTIONS[1] * (low + part)
    unit, above = (sums[1][rows, columns, low + i] for i in (0, 1))
    unit = unit + part * (above - unit)
    mu = np.sin(np.radians(first + np.arange(law.shape[1])))
    scale = scale_of_friction(mu, 1.0 / GRAVITY)[:, None, None]
    lift = np.divide(law[1], unit, out=np.zeros_like(unit), where=unit > 0.0)
    ratio = np.stack([proportion * lift, lift, 0.0 * lift], axis=-1) * depths[:, None]
    return first, step, ratio / scale[..., None]


def _bounded_sums(shape: str, surface_friction: float, depths: FloatArray) -> FloatArray:
    """Force over ξ R³ of a foot at l = 1, along the motion and up, [2, descent, depth, d/l].

    By resistive force theory with Coulomb's bound; the descents from :data:`LOWEST` on.
    """
    height, normal, area = foot_faces(shape)
    levels, ring = np.unique(height, return_inverse=True)
    submerged = np.maximum(depths[:, None] - levels, 0.0)
    descents, of = DESCENTS[LOWEST:], for_arrays(np)
    sums = np.empty((2, descents.size, depths.size, PROPORTIONS.size))
    for i, turn in enumerate(descents.tolist()):
        direction = np.broadcast_to([math.cos(turn), 0.0, -math.sin(turn)], normal.shape)
        pushed = (area[:, None] * unit_stress(normal, direction, surface_friction, fade=FADE)).T
        for j, level in enumerate(PROPORTIONS.tolist()):
            scaled = tuple(pushed * [[level], [level], [1.0]])
            x, _, z = of.coulomb(scaled, tuple(direction.T), tuple(normal.T), surface_friction, 1.0)
            sums[:, i, :, j] = np.stack([np.bincount(ring, x), np.bincount(ring, z)]) @ submerged.T
    return sums


@lru_cache(maxsize=8)
def _foot_table(shape: str, surface_friction: float) -> tuple[float, float, FloatArray]:
    """Force of :func:`~terraphi.laws.foot.simulated_table`, and the moment over ρ g R⁴ as third."""
    first, step, law = simulated_table(shape, surface_friction)
    places = np.indices(law.shape[2:], dtype=np.float64) * [[[1.0]], [[step / DEPTHS[1]]]]
    _, lift, moment = (between_rows(t, *places) for t in resistive_table(shape, surface_friction))
    # In the lift's proportion, below the lowest direction that was simulated in that one's.
    rows = np.maximum(np.arange(len(DESCENTS)), SIMULATED)
    ratio = law[1][:, rows] / np.maximum(lift[rows], TINY)
    return first, step, np.stack([*law, ratio * moment], axis=-1)
