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
continuous (:data:`~terraphi.forward.rft.FADE`).

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
import warnings
from dataclasses import dataclass
from functools import cached_property, lru_cache
from importlib.util import find_spec
from typing import Any

import numpy as np

from terraphi.experiment.arrays import FloatArray, like, namespace, numbers
from terraphi.experiment.errors import InputError, nearest
from terraphi.experiment.priors import FOOT_FRICTION
from terraphi.experiment.scenario import LIMITS
from terraphi.experiment.units import GRAVITY
from terraphi.forward.rft import FADE, scale_of_friction, unit_stress
from terraphi.laws.foot import (
    BEYOND_DEG,
    DEEPEST,
    DEPTHS,
    DESCENTS,
    MOVED,
    Foot,
    foot_faces,
    interpolated,
    resistive_table,
    simulated_table,
)

SPACING, LEVEL = float(DESCENTS[1] - DESCENTS[0]), len(DESCENTS) // 2
"""Step of :data:`~terraphi.laws.foot.DESCENTS` [rad], and its row of level motion."""
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
FASTEST, HUGE = 10.0, 1e9
"""Speed [m/s] beyond which a landing has its inertia, and largest plain number; chosen. Balls that
the inertia was learned from hit at up to 1.5 m/s."""
FEW = 16
"""Balls or discs up to which plain numbers are faster than arrays where nothing is compiled."""
NONE: FloatArray = np.zeros((1, 6))
"""Force and moment of feet that are not held."""
IS_COMPILED = find_spec("numba") is not None
DOUBLE, PLAIN = np.dtype(np.float64), frozenset({float, int, np.float64})
WIDTHS = (3, 7), (3, 6), (3,), (3,)
"""Types of a number, and last axes of pose, velocity, and force and moment that are held."""
TINY = 1e-12
"""Least length [m], speed [m/s], area [m²] or force [N] that is divided by."""
AREA: dict[str, Any] = {"low": 0.0, "high": 4.0 * LARGEST**2, "unit": "m²"}
"""Range of the area of a face."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """Faces of a foot in its own frame, small next to the foot.

    Attributes
    ----------
    points
        Centres [m], shape [face, 3].
    normals
        Outward unit normals [-], shape [face, 3].
    areas
        [m²], shape [face].
    corners
        Of triangles, from their centres [m], shape [face, 3, 3]: what of a face is submerged is
        exact then. Without them, a face is in soil or not by its centre.
    """

    points: FloatArray
    normals: FloatArray
    areas: FloatArray
    corners: FloatArray | None = None

    def __post_init__(self) -> None:
        """Check the faces."""
        points = numbers("points", self.points, last=(3,), low=-LARGEST, high=LARGEST, unit="m")
        shape = (points.size // 3, 3)
        if points.shape != shape or not points.size:
            raise InputError(f"points of shape {points.shape}; give [face, 3]")
        areas = numbers("areas", self.areas, points, shape=shape[:1], **AREA)
        for name, value in (("points", points), ("normals", unit_normals(self.normals, points)),
                            ("areas", areas)):  # fmt: skip
            object.__setattr__(self, name, value)
        if self.corners is not None:
            ends: dict[str, Any] = {"low": -2.0 * LARGEST, "high": 2.0 * LARGEST, "unit": "m"}
            corners = numbers("corners", self.corners, points, shape=(*shape[:1], 3, 3), **ends)
            object.__setattr__(self, "corners", corners)

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
        expected = (
            "mesh: give corners [corner, 3] and triangles [face, 3] of whole numbers, or an object "
            "with vertices and faces"
        )
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
                "mesh: the surface is not closed, has a face twice, or one whose corners run the "
                "other way than its neighbors'; give one solid, its corners counterclockwise seen "
                "from outside"
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
                raise InputError(
                    f"mesh: more than {MOST_FACES} faces with edges of {most:g} m; give longest"
                )
        reach = float(np.linalg.norm(each.mean(axis=1), axis=1).max(initial=0.0))
        if reach > LARGEST:
            raise InputError(f"mesh: reaches {reach:g} m; corners are in meters")
        cross = np.cross(each[:, 1] - each[:, 0], each[:, 2] - each[:, 0])
        twice = np.linalg.norm(cross, axis=1)
        keep = twice > 0.0
        if not keep.any():
            raise InputError("mesh: no triangle has an area")
        middles = each[keep].mean(axis=1)
        solid = cls(middles, cross[keep] / twice[keep, None], 0.5 * twice[keep],
                    each[keep] - middles[:, None])  # fmt: skip
        if solid.areas @ np.vecdot(solid.normals, solid.points) <= 0.0:
            raise InputError("mesh: turned inside out; order corners counterclockwise from outside")
        return solid

    @cached_property
    def reach(self) -> float:
        """Distance from the origin that no face exceeds [m]."""
        corners = 0.0 if self.corners is None else np.linalg.norm(self.corners, axis=2).max(axis=1)
        return float((np.linalg.norm(self.points, axis=1) + corners).max())

    def footprint(self, depth: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Radius [m] and roundness [-] of what is submerged, shape [depth] each.

        At depths of its origin [m], level; the radius is that of a circle of the projected area,
        and the roundness 1 for a ball and 0 for a disc.
        """
        below = depth[:, None] - self.points[:, 2]
        down = np.where(below > 0.0, self.areas * np.maximum(-self.normals[:, 2], 0.0), 0.0)
        return _footprint(down.sum(axis=1), down @ self.normals, below.max(axis=1))[:2]


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
    if not isinstance(foot, Foot | Mesh):
        raise InputError(f"foot of type {type(foot).__name__}; give a Foot or a Mesh")
    checked: Any = _checked(pose, velocity, phi_deg, density, surface_friction, surface, rest_speed,
                            held, step, stiffness)  # fmt: skip
    if checked and (wrenches := _one_by_one(foot, *checked, inertia=inertia)) is not None:
        shape = (*velocity.shape[:-1], 3)
        return wrenches[:, :3].reshape(shape), wrenches[:, 3:].reshape(shape)
    pose = numbers("pose", pose, last=(3, 7), unit="m")
    velocity = numbers("velocity", velocity, pose, last=(3, 6), unit="m/s")
    rest_speed = _number("rest_speed", rest_speed, low=TINY, unit="m/s")
    xp, lead = namespace(pose), tuple(pose.shape[:-1])
    place = xp.reshape(pose, (-1, pose.shape[-1]))
    if place.shape[-1] == 7:
        numbers("pose: length of the quaternion", _norm(xp, place[:, 3:]), low=1e-6)
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
    xp = namespace(place)
    body_force: Any = _of_foot if isinstance(foot, Foot) else _of_mesh
    force_, moment, deep = body_force(foot, place, moving, fade, **soil)
    if inertia and isinstance(foot, Foot):
        fall = xp.clip(-moving[:, 2], 0.0, FASTEST) * like(place, deep > 0.0)
        push = _landing(foot, xp.clip(deep, 0.0, None), fall, soil["density"])
        force_ = force_ + xp.stack([0.0 * push, 0.0 * push, push], axis=1)
    wrenches = xp.concat([force_, moment], axis=1)
    if before is None:
        return wrenches
    # f ← F + (f − F) exp(−k |Δx| / max(|f|, |F|)) of the module's head; in the air nothing is
    # kept. A mesh that turns moves its farthest face by |ω| times its reach.
    travel = _norm(xp, moving[:, :3])
    if moving.shape[-1] == 6 and isinstance(foot, Mesh):
        travel = travel + foot.reach * _norm(xp, moving[:, 3:])
    size = xp.maximum(_norm(xp, before[:, :3]), _norm(xp, force_))
    kept = xp.exp(-stride * travel / xp.clip(size, TINY, None))
    kept = xp.where(deep > 0.0, kept, xp.zeros_like(kept))[:, None]
    return wrenches + kept * (before - wrenches)


@lru_cache(maxsize=16)
def _function(foot: Foot | Mesh, friction: float, inertia: bool) -> tuple[Any, ...]:
    """Function of :mod:`~terraphi.forward.feet` for a foot, and arguments that stay the same."""
    from terraphi.forward import feet

    if isinstance(foot, Foot):
        first, step, table = _foot_table(foot.shape, friction)
        moved = inertia * MOVED[0] * math.pi * foot.radius**2
        return feet.feet, (table, first, step, float(foot.radius), foot.shape == "ball", moved,
                           MOVED[1] * foot.radius, FASTEST)  # fmt: skip
    (first, step, ball), (_, _, disc) = (_ratio_table(s, friction) for s in ("ball", "disc"))
    # Motions below the lowest have its ratios.
    table = np.concatenate([ball, disc], axis=-1)[
        :, np.maximum(np.arange(len(DESCENTS)) - LOWEST, 0)
    ]
    corners = np.empty((0, 3, 3)) if foot.corners is None else foot.corners
    faces = [
        np.ascontiguousarray(values, np.float64)
        for values in (foot.points, foot.normals, foot.areas, corners)
    ]
    return feet.meshes, (table, first, step, friction, FLAT, foot.reach, *faces)


def _one_by_one(
    foot: Foot | Mesh, place: FloatArray, moving: FloatArray, soil: FloatArray, friction: float,
    fade: float, before: FloatArray | None, stride: float, *, inertia: bool,
) -> FloatArray | None:  # fmt: skip
    """Force and moment on feet by :mod:`~terraphi.forward.feet`, shape [foot, 6].

    ``soil`` has φ, density and surface, shape [foot or 1, 3], ``before`` the force and moment that
    are held, [foot, 6], and ``stride`` is their stiffness times the time. ``None`` where a number
    cannot be used, or operations on arrays are faster.
    """
    if not IS_COMPILED and (isinstance(foot, Mesh) or len(place) > FEW):
        return None
    function, rest = _function(foot, friction, inertia)
    # Of one kind: for another, as of arrays that cannot be written, all would be compiled again.
    place, moving = (a if a.flags.carray else np.array(a, order="C") for a in (place, moving))
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
    arrays: Any = (pose, velocity)
    plain: Any = (phi_deg, density, friction, surface, rest_speed)
    if held is not None:
        if type(held) is not tuple or len(held) != 2:
            return None
        arrays, plain = (pose, velocity, *held), (*plain, step, stiffness)
    lead = getattr(pose, "shape", ())[:-1]
    for number in plain:
        if type(number) not in PLAIN or not abs(number) < HUGE:  # an integer may exceed any float
            return None
    for array, widths in zip(arrays, WIDTHS, strict=False):
        if type(array) is not np.ndarray or array.dtype != DOUBLE or array.shape[:-1] != lead:
            return None
        if not array.ndim or array.shape[-1] not in widths:
            return None
    place, moving, *last = [array.reshape(-1, array.shape[-1]) for array in arrays]
    soil = np.array([[phi_deg, density, surface]], DOUBLE)
    (low, high), (least, most, _) = angles_deg(friction), LIMITS["soil.density"]
    if not (low <= phi_deg <= high and least <= density <= most and rest_speed >= TINY):
        return None
    if held is None:
        return place, moving, soil, friction, float(rest_speed), None, 0.0
    before = np.concatenate(last, axis=1)
    if step < 0.0 or stiffness < 0.0 or not np.abs(before).max(initial=0.0) < HUGE:
        return None
    return place, moving, soil, friction, TINY, before, float(step * stiffness)


def _landing(foot: Foot, depth: Any, fall: Any, density: Any) -> Any:
    """Momentum that a falling foot gives the soil in a second, v² dm/dz of ``moved_mass`` [N].

    Of numbers or arrays of any library: the depth [m], the speed downward [m/s] and the density.
    """
    size, reach = MOVED
    slower = 1.0 + (depth / (reach * foot.radius)) ** 4
    return size * math.pi * foot.radius**2 * density * fall**2 * slower**-1.25


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


def unit_normals(normals: Any, points: Any) -> Any:
    """Normals of length 1, [face, 3] or as the points [..., face, 3]; raises InputError."""
    faces = tuple(points.shape)
    normals = numbers("normals", normals, points, last=(3,))
    if tuple(normals.shape) not in (faces, faces[-2:]):
        normals = numbers("normals", normals, points, shape=faces)
    length = _norm(namespace(points), normals)
    numbers("normals: length", length, low=1.0 - UNIT, high=1.0 + UNIT)
    return normals


def _friction(surface_friction: Any) -> float:
    """The friction of all feet [-]; raises InputError."""
    ends = LIMITS["leg.friction"][:2]
    values = numbers("surface_friction", surface_friction, low=ends[0], high=ends[1])
    try:
        flat = namespace(values).reshape(values, (-1,))
        friction = float(flat[0])
        several = bool(namespace(values).any(flat != friction))
    except (TypeError, IndexError):
        raise InputError("surface_friction is traced or empty; give a number") from None
    if several:
        raise InputError("surface_friction has several values; give one, and call once for each")
    return friction


def angles_deg(surface_friction: float) -> tuple[float, float]:
    """Least and largest φ of law ``foot`` [deg]; raises InputError as `simulated_table` does."""
    first, _, table = simulated_table("ball", float(surface_friction))
    return first - BEYOND_DEG, first + len(table) - 1 + BEYOND_DEG


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
        warnings.warn(  # one text, so that it is shown once
            f"a foot is deeper than {DEEPEST:g} of its radii, to which law 'foot' was simulated; "
            "its forces are continued from there",
            stacklevel=4,
        )


def _of_foot(
    foot: Foot, place: Any, moving: Any, fade: float, *, surface_friction: float, phi_deg: Any,
    density: Any, surface: Any,
) -> tuple[Any, Any, Any]:  # fmt: skip
    """Force, moment and depth of balls or discs, shape [foot, 3], [foot, 3] and [foot]."""
    xp = namespace(place)
    depth = surface - place[:, 2] + (foot.radius if foot.shape == "ball" else 0.0)
    level = _norm(xp, moving[:, :2])
    speed = _norm(xp, moving[:, :3])
    first, step, table = _foot_table(foot.shape, surface_friction)
    turn = xp.atan2(-moving[:, 2], level) / SPACING + LEVEL
    ratio = xp.clip(depth, 0.0, None) / foot.radius
    _warn_deep(xp, ratio)
    unit = interpolated(table, phi_deg - first, turn, ratio / step)
    size = density * GRAVITY * foot.radius**3 * xp.clip(speed / fade, None, 1.0)
    unit = unit * (size * like(place, depth > 0.0))[:, None]
    # The table has the force in the plane of the motion: turn it into the heading.
    heading = moving[:, :2] / xp.clip(level, TINY, None)[:, None]
    along, lift, turning = unit[:, 0], unit[:, 1], foot.radius * unit[:, 2:3]
    # The moment is about the level axis across the motion, left of it.
    across = xp.stack([-heading[:, 1], heading[:, 0], xp.zeros_like(depth)], axis=1)
    forces = xp.stack([along * heading[:, 0], along * heading[:, 1], lift])
    forces = _against(xp, forces, moving[:, :3].T / xp.clip(speed, TINY, None))
    return forces.T, turning * across, depth


def _of_mesh(
    mesh: Mesh, place: Any, moving: Any, fade: float, surface_friction: float, **each: Any
) -> tuple[Any, Any, Any]:
    """Force, moment and depth of meshes, shape [foot, 3], [foot, 3] and [foot]."""
    xp = namespace(place)
    points, normals, areas = (like(place, x) for x in (mesh.points, mesh.normals, mesh.areas))
    turned = _rotation(xp, place[:, 3:]) if place.shape[-1] == 7 else None
    up = like(place, np.array([[0.0, 0.0, 1.0]])) if turned is None else turned[:, 2, :]
    depth = (each["surface"] - place[:, 2])[:, None] - up @ points.T
    if mesh.corners is None:
        lowest, share, points = depth, like(depth, depth > 0.0), points[None, :, :]
    else:
        corners = like(place, mesh.corners)
        heights = xp.reshape(up @ xp.reshape(corners, (-1, 3)).T, (up.shape[0], points.shape[0], 3))
        lowest = depth - xp.min(heights, axis=2)
        share, depth, weights = _submerged(xp, depth[..., None] - heights)
        # Forces act at the centre of pressure.
        points = points + xp.sum(weights[..., None] * corners, axis=2)
    if turned is not None:
        points = points @ xp.matrix_transpose(turned)
        normals = normals @ xp.matrix_transpose(turned)
    return _sum_of_faces(
        (depth, share, xp.max(lowest, axis=1)), normals, areas, moving[:, None, :3], points,
        moving[:, 3:] if moving.shape[-1] == 6 else None, surface_friction=surface_friction,
        law="foot", rest_speed=fade, phi_deg=each["phi_deg"], density=each["density"],
    )  # fmt: skip


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
    flat, normals = xp.reshape(points, (-1, *last)), unit_normals(normals, points)
    if normals.ndim != 2:
        normals = xp.reshape(normals, (-1, *last))
    velocities = _each("velocities", velocities, points, lead, *last, unit="m/s")
    arms = flat - _each("about", about, points, lead, 3, unit="m")[:, None, :]
    depth = soil.pop("surface")[:, None] - flat[:, :, 2]
    submerged = depth, like(depth, depth > 0.0), xp.max(depth, axis=1)
    areas = numbers("areas", areas, points, shape=last[:1], **AREA)
    total, moment, _ = _sum_of_faces(
        submerged, normals, areas, velocities, arms, None, law=law,
        rest_speed=_number("rest_speed", rest_speed, low=TINY, unit="m/s"),
        mobilized=_mobilized(mobilization, sheared, points), **soil,
    )  # fmt: skip
    return xp.reshape(total, (*lead, 3)), xp.reshape(moment, (*lead, 3))


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
) -> tuple[Any, Any, Any]:  # fmt: skip
    """Force, moment and greatest depth of feet, from arrays [foot, face, 3]; others [foot].

    ``submerged`` is the depth of faces in the mean over what is in soil [m], this share of the
    area, [foot, face] each, and the greatest depth [m], [foot]; ``spin`` the angular velocity
    [foot, 3], or ``None``; ``mobilized`` the share of the friction [foot, face], or ``None``.
    """
    depths, share, deepest = submerged
    xp = namespace(depths)
    feet, faces = depths.shape
    deepest = xp.clip(deepest, 0.0, None)
    # NumPy computes the faces that are submerged only, the others have no force.
    at = np.nonzero(share > 0.0) if xp is np else None
    owner = at[0] if at else None

    def flat(values: Any, *last: int) -> Any:
        """A row for each face, of what there is for faces or feet and faces."""
        values = xp.broadcast_to(values, (feet, faces, *last))
        return values[at] if at else xp.reshape(values, (-1, *last))

    n, v, arm = (flat(values, 3) for values in (normals, velocities, arms))
    depth, area = xp.clip(flat(depths), 0.0, None), flat(areas * share)
    mobilized = None if mobilized is None else flat(mobilized)

    def total(values: Any) -> Any:
        """Sum over the faces of each foot."""
        if owner is not None:
            return np.bincount(owner, values, feet)
        return xp.sum(xp.reshape(values, (feet, faces)), axis=1)

    def spread(values: Any) -> Any:
        """A foot's number for each of its faces."""
        return values[owner] if owner is not None else xp.repeat(values, faces)

    # A face at r moves at v + ω × r.
    if spin is not None:
        wx, wy, wz = (spread(spin[:, i]) for i in range(3))
        x, y, z = arm[:, 0], arm[:, 1], arm[:, 2]
        v = v + xp.stack([wy * z - wz * y, wz * x - wx * z, wx * y - wy * x], axis=1)
    # Before any face is dropped: projected area, mean depth and mean normal of what is submerged
    # and faces down, from which follow the footprint and the roundness.
    facing_down = area * xp.clip(-n[:, 2], 0.0, None)
    base = total(facing_down)
    mean = total(facing_down * depth) / xp.clip(base, TINY, None)
    normal = xp.stack([total(facing_down * n[:, i]) for i in range(3)], axis=1)
    speed = _norm(xp, v)
    direction = v / xp.clip(speed, TINY, None)[:, None]
    leading = xp.sum(n * direction, axis=1)
    # Only faces that lead feel the soil. NumPy drops the others; traced arrays keep their shape.
    if owner is not None:
        kept = np.flatnonzero(leading > 0.0)
        n, v, arm, direction = n[kept], v[kept], arm[kept], direction[kept]
        owner, depth, area, speed = owner[kept], depth[kept], area[kept], speed[kept]
        leading, mobilized = leading[kept], None if mobilized is None else mobilized[kept]
    stress = scale_of_friction(xp.sin(math.pi / 180.0 * phi_deg), density)  # tan φ_rft = sin φ
    size = depth * area * xp.clip(speed / rest_speed, None, 1.0) * spread(stress)
    forces = unit_stress(n, direction, surface_friction, fade=FADE).T * size
    # To the level of law foot: drag and lift by their ratios, which depend on where the foot as a
    # whole goes, by the mean velocity of its leading faces; then each face to Coulomb's bound.
    if law == "foot":
        weight = area * xp.clip(leading, 0.0, None)
        vx, vy, vz = (total(weight * v[:, i]) for i in range(3))
        descent = xp.atan2(-vz, xp.sqrt(vx * vx + vy * vy))
        drag, lift = _ratios(
            base, normal, mean, deepest, descent, phi_deg, surface_friction=surface_friction,
        )  # fmt: skip
        forces = forces * xp.stack([*[spread(drag)] * 2, spread(lift)])
    if law == "foot" or mobilized is not None:
        forces = _bounded(xp, forces, n.T, direction.T, surface_friction, mobilized)
    (fx, fy, fz), (x, y, z) = ([part[i, :] for i in range(3)] for part in (forces, arm.T))
    rows = (fx, fy, fz, y * fz - z * fy, z * fx - x * fz, x * fy - y * fx)
    sums = xp.stack([total(row) for row in rows], axis=1)
    return sums[:, :3], sums[:, 3:], deepest


def _submerged(xp: Any, depths: Any) -> tuple[Any, Any, Any]:
    """What is submerged of triangles, from the depths of their corners [m], [foot, face, corner].

    Its share of the area, its mean depth [m], shape [foot, face], and the weights of the corners in
    the centre of pressure [-], shape [foot, face, corner].
    """
    # Of a triangle with one corner at a depth c > 0, the others at a ≤ b ≤ 0, a tip is submerged of
    # the area c² / (c − a)(c − b), in the mean c/3 deep. Its centre of pressure has the weight
    # c / 4 (c − d) of a corner at d, and the rest of the deep one. Where a < 0 < b, the tip at a is
    # left out of the whole, whose integral of the depth has the weights (3 mean + d) / 12.
    a, c = xp.min(depths, axis=2), xp.max(depths, axis=2)
    mean = xp.mean(depths, axis=2)
    is_tip = 3.0 * mean - a - c <= 0.0
    height = xp.clip(xp.where(is_tip, c, -a), 0.0, None)[..., None]
    away = xp.where(is_tip[..., None], c[..., None] - depths, depths - a[..., None])
    portion = xp.where(away > 0.0, height / xp.clip(away, TINY, None), xp.ones_like(away))
    part = xp.prod(portion, axis=2) * like(depths, height[..., 0] > 0.0)
    corner = 0.25 * portion * like(depths, away > 0.0)
    corner = corner + like(depths, away == 0.0) * (1.0 - xp.sum(corner, axis=2))[..., None]
    tip = (part * height[..., 0] / 3.0)[..., None] * corner
    uncut = like(depths, ~is_tip)
    weights = tip + uncut[..., None] * (3.0 * mean[..., None] + depths) / 12.0
    total = xp.sum(weights, axis=2)
    share = uncut + (1.0 - 2.0 * uncut) * part
    weights = weights / xp.clip(total, TINY, None)[..., None]
    return share, total / xp.clip(share, TINY, None), weights


def _footprint(base: Any, normal: Any, deepest: Any) -> tuple[Any, Any, Any]:
    """Radius [m], roundness [-] and radius of the ball [m] of what faces down, [foot] each.

    From its projected area [m²], its sum of normals weighted by that [m²] and its depth [m]. The
    ball touches the soil over a circle of the radius with its cap that deep.
    """
    # Weighted by projected area, cos θ sin θ dθ, the mean normal of a spherical cap has the length
    # 2 (1 + c + c²) / (3 (1 + c)), with c the cosine of its rim's polar angle. One less that is
    # ``expected`` of a ball of this area and depth; the mesh has ``bent``.
    xp = namespace(base)
    bent = 1.0 - _norm(xp, normal) / xp.clip(base, TINY, None)
    radius, deepest = (xp.clip(value, TINY, None) for value in (xp.sqrt(base / math.pi), deepest))
    of_ball = xp.where(deepest < radius, 0.5 * (radius**2 / deepest + deepest), radius)
    level = 1.0 - xp.minimum(deepest, of_ball) / of_ball  # cosine of the rim's polar angle
    expected = (1.0 - level) * (1.0 + 2.0 * level) / (3.0 * (1.0 + level))
    return radius, xp.clip(bent / xp.clip(expected, TINY, None), 0.0, 1.0), of_ball


def _ratios(
    base: Any, normal: Any, mean: Any, deepest: Any, descent: Any, phi_deg: Any, *,
    surface_friction: float,
) -> tuple[Any, Any]:  # fmt: skip
    """Drag and lift by law ``foot`` over those of resistive force theory, [foot] each.

    Of what :func:`_footprint` takes, the mean depth [m] and the descent [rad].
    """
    xp = namespace(base)
    radius, roundness, of_ball = _footprint(base, normal, deepest)
    roundness, deepest = roundness[:, None], xp.clip(deepest, TINY, None)
    turn = xp.clip(descent / SPACING + LEVEL, LOWEST, None)
    scale: Any = 0.0
    for shape, share, depth, size in (
        ("ball", roundness, deepest, of_ball), ("disc", 1.0 - roundness, mean, radius),
    ):  # fmt: skip
        first, step, table = _ratio_table(shape, surface_friction)
        ratio = xp.clip(depth / size, 1e-3 * step, None)
        if shape == "ball":  # what is flat or on edge is no ball, whatever it points down with
            round_feet = (roundness[:, 0] > FLAT) & (base > TINY)
            _warn_deep(xp, xp.where(round_feet, ratio, 0.0 * ratio))
        law_force = interpolated(table, phi_deg - first, turn - LOWEST, ratio / step)
        scale = scale + share * law_force / ratio[:, None]
    return scale[:, 0], scale[:, 1]


@lru_cache(maxsize=8)
def _ratio_table(shape: str, surface_friction: float) -> tuple[float, float, FloatArray]:
    """First φ [deg], step of the depth over the radius, and ratios times the depth over the radius.

    The ratios d and l of the module's formula, [φ, descent, depth, 2], the descents from
    :data:`LOWEST` on. Times the depth, since what a footing bears at its surface is over the
    theory's as the radius over the depth.

    The bound leaves a face's force in proportion to a common factor of d and l. So d/l is that for
    which the sum over the faces of a ball or disc has the law's direction, and l follows from its
    size. A drag beyond the bound of a flat face has the d/l at which that slides.
    """
    first, step, law = simulated_table(shape, surface_friction)
    law, depths = law[:, LOWEST:], step * np.arange(law.shape[2], dtype=np.float64)
    sums = _bounded_sums(shape, surface_friction, depths)
    # Angle of the force above the level, over [descent, depth, d/l] and [φ, descent, depth]; drag
    # is negative. It falls with d/l, until all faces slide.
    turned, wanted = (np.arctan2(each[..., 1], -each[..., 0]) for each in (sums, law))
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
    unit = sums[rows, columns, low]
    unit = unit + part[..., None] * (sums[rows, columns, low + 1] - unit)
    mu = np.sin(np.radians(first + np.arange(len(law))))
    scale = scale_of_friction(mu, 1.0 / GRAVITY)[:, None, None]
    lift = np.zeros(law.shape[:-1])
    np.divide(law[..., 1], unit[..., 1], out=lift, where=unit[..., 1] > 0.0)
    ratio = np.stack([proportion * lift, lift], axis=-1) * depths[:, None] / scale[..., None]
    return first, step, ratio


def _bounded_sums(shape: str, surface_friction: float, depths: FloatArray) -> FloatArray:
    """Force over ξ R³ of a foot at l = 1, along the motion and up, [descent, depth, d/l, 2].

    By resistive force theory with Coulomb's bound; the descents from :data:`LOWEST` on.
    """
    height, normal, area = foot_faces(shape)
    levels, ring = np.unique(height, return_inverse=True)
    submerged = np.maximum(depths[:, None] - levels, 0.0)
    descents = DESCENTS[LOWEST:]
    sums = np.empty((descents.size, depths.size, PROPORTIONS.size, 2))
    for i, turn in enumerate(descents.tolist()):
        direction = np.broadcast_to([math.cos(turn), 0.0, -math.sin(turn)], normal.shape)
        pushed = (area[:, None] * unit_stress(normal, direction, surface_friction, fade=FADE)).T
        for j, level in enumerate(PROPORTIONS.tolist()):
            scaled = pushed * [[level], [level], [1.0]]
            x, _, z = _bounded(np, scaled, normal.T, direction.T, surface_friction)
            sums[i, :, j] = submerged @ np.stack([np.bincount(ring, x), np.bincount(ring, z)]).T
    return sums


@lru_cache(maxsize=8)
def _foot_table(shape: str, surface_friction: float) -> tuple[float, float, FloatArray]:
    """Force of :func:`~terraphi.laws.foot.simulated_table`, and the moment over ρ g R⁴ as third."""
    first, step, law = simulated_table(shape, surface_friction)
    places = np.indices(law.shape[1:3], dtype=np.float64) * [[[1.0]], [[step / DEPTHS[1]]]]
    theory = interpolated(resistive_table(shape, surface_friction), *places)
    # In the lift's proportion, below the lowest direction that was simulated in that one's.
    rows = np.maximum(np.arange(len(DESCENTS)), SIMULATED)
    lift = law[..., 1][:, rows] / np.maximum(theory[rows, :, 1], TINY)
    return first, step, np.concatenate([law, (lift * theory[..., 2])[..., None]], axis=-1)


def _bounded(
    xp: Any, force: Any, normal: Any, motion: Any, friction: float, mobilized: Any = None
) -> Any:
    """Forces on faces that take energy, with no more friction than Coulomb's, shape [3, face].

    ``normal`` is the outward one and ``motion`` the direction in which a face moves. No soil pulls
    at a face, and friction is mobilized by a share of it.
    """
    # f = −p n + t with p = max(−f·n, 0): |t| is cut to μ p.
    force = _against(xp, force, motion)
    pressure = xp.clip(-xp.sum(force * normal, axis=0), 0.0, None)
    along = force + pressure * normal
    size = xp.sqrt(xp.sum(along * along, axis=0))
    share = xp.clip(friction * pressure / xp.clip(size, TINY, None), None, 1.0)
    share = share if mobilized is None else share * mobilized
    return along * share - pressure * normal


def _against(xp: Any, force: Any, motion: Any) -> Any:
    """Forces without what would drive a motion, for soil takes energy, shape [3, face].

    Resistive force theory has such a part on faces that rise at some 10°.
    """
    return force - xp.clip(xp.sum(force * motion, axis=0), 0.0, None) * motion


def _norm(xp: Any, vectors: Any) -> Any:
    """Lengths of vectors, over the last axis."""
    return xp.sqrt(xp.sum(vectors * vectors, axis=-1))


def _rotation(xp: Any, quaternion: Any) -> Any:
    """Rotation matrices of quaternions (w, x, y, z), shape [foot, 3, 3]."""
    w, x, y, z = (quaternion[:, i] / xp.clip(_norm(xp, quaternion), TINY, None) for i in range(4))
    rows = (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    )
    return xp.stack([xp.stack(row, axis=-1) for row in rows], axis=-2)
