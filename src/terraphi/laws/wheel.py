r"""Force of soil on a rigid wheel that rolls, slips or is braked over level ground.

Law ``foot`` on the rim (:func:`~terraphi.laws.wrench.wrench`), with Coulomb's bound on each face.
Angles are counted from the lowest point of the rim to the front::

            |-> v            A point of the rim at θ is at R (sin θ, −cos θ) from the axle, and
       _____|_____           moves at (v − ω R cos θ, −ω R sin θ). So it presses on the soil,
      /     |     \          n · v > 0, where θ > 0, from where the rim meets the soil at θ₁:
     |   ω  +------|-> x     cos θ₁ = 1 − z / R.
      \     |\ θ₁ /          Behind its lowest point it leaves the soil, whose rebound is left out.
    ___\____|_\__/____ z = 0
        \___|__\/

*Slip* s is 1 − v / (ω R) of a wheel that is driven, and ω R / v − 1 of one that is braked (s < 0),
so that −1 is a locked wheel. Friction develops over the shear displacement

.. math::
    j = R\,\Bigl|(\theta_1 - \theta) - \frac{v}{\omega R}(\sin\theta_1 - \sin\theta)\Bigr|,
    \qquad 1 - e^{-j/K}

(Janosi & Hanamoto 1961; Wong & Reece 1967, J. Terramechanics 4:81). A smooth rim slides over the
soil, and a rough one takes it along: of the rim's tangential velocity the soil counts a part as
large as the friction as motion against it (:data:`TANGENTIAL`), so that rough wheels dig. *Lugs*
hold the soil, and the part is 1. Those that stand close carry the soil between them along: the
wheel then has the radius to their tips, and the soil's friction. Those that stand far apart cut
into the soil, and the rim bears the load.

The load that a rim carries at a given sinkage depends on φ, little on the friction and hardly on K.
Pull and torque at a given sinkage do not depend on φ: they show the friction.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from terraphi.experiment.arrays import FloatArray, numbers
from terraphi.experiment.errors import InputError
from terraphi.experiment.priors import DENSITY, FRICTION
from terraphi.laws.wrench import angles_deg, wrench

FACES = 320
"""Faces of the rim between both ends of :data:`DEEPEST`. Those behind the lowest point do not
press, and belong to the footprint."""
DEEPEST = 0.6
"""Largest sinkage over the radius [-]; chosen."""
STEEPEST = 0.95
"""Largest slip, driven or braked [-]; chosen: at a locked wheel the soil before it moves along."""
MOBILIZATION = 0.003
"""K, shear displacement over which friction develops [m]: 2 to 3 mm meet the pull and torque of a
smooth wheel on sand at slips of 0.1 to 0.6 (Ding et al. 2011), and grains of 6 mm had 3 mm."""
CLOSE, FAR = 3.0, 6.0
"""Distance of lugs over their height up to which they carry all soil between them along, and from
which none [-]. The passive wedge before a plate is 1 / tan(45° − φ/2) = 1.7 to 2.2 times as long,
and soil behind it goes along; chosen. In grains 12 lugs of 6 mm at 5.8 heights were tried: the rim
carries the load, as without lugs, and the soil does not slide along it; lugs at twice that distance
are taken to hold none, which is chosen."""
FRICTIONS = (0.05, 0.35, 0.65)
"""Frictions whose forces are interpolated, to the ends of law ``foot`` [-]."""
SLIPS = (-0.5, 0.6)
"""Least and largest slip of which something was learned [-]: beyond, a wheel pushes a mound or
digs."""
TANGENTIAL = 1.0
"""Part of the rim's tangential velocity that counts as motion against the soil, over the friction
[-], ± 0.2. φ that wheels by the material point method are read as then changes by 0.5° from a slip
of 0.2 to 0.5, at frictions of 0.3 and 0.55 and 28 to 36°; by 4.0° if all of it counts
(``studies/wheel_slip.py``)."""
LITTLE = 0.2
"""Slip above which readings are level [-]."""
POINTS = 60
"""Depths between which a sinkage is sought."""
NODES, WIDTH_DEG = 9, 1e-3
"""Angles between which many soils are interpolated, and their least range [deg]."""
TINY = 1e-12
STILL = 1e-9
"""Speed over that of the rim below which a face stands [-]: the law has no rate."""


class WheelError(NamedTuple):
    """Error of φ by load, sinkage and slip, in grains of known φ [deg]."""

    offset_deg: float
    """Mean error from a slip of LITTLE on."""
    free_deg: float
    """Further error of a wheel without slip; it falls linearly to none at LITTLE."""
    driven_sd_deg: float
    """Standard deviation for each unit of slip."""
    braked_deg: float
    """Further error for each unit of slip below zero."""
    braked_sd_deg: float
    """Standard deviation for each unit of slip below zero."""
    soil_deg: float
    """Standard deviation between soils."""
    law_deg: float
    """Standard deviation of the offset."""

    def of(self, slip: Any) -> Any:
        """Mean error of φ at a slip [deg]."""
        free = self.free_deg * np.clip(1.0 - slip / LITTLE, 0.0, 1.0)
        return self.offset_deg + free + self.braked_deg * np.maximum(-slip, 0.0)

    def sd_by_slip(self, slip: Any) -> Any:
        """Standard deviation of the effect of the slip [deg]; driven rows share it, or braked."""
        return np.where(slip > 0.0, self.driven_sd_deg, -self.braked_sd_deg) * slip


WHEEL_ERROR = WheelError(1.1, 1.3, 4.0, 3.8, 7.0, 1.4, 1.5)
"""Offset and braking are learned from wheels in loose grains, half a grain added to the sinkage
(``studies/wheels.py`` prints them), the error without slip from wheels by the material point method
(``studies/wheel_slip.py``). Braked wheels push a mound, and read more. Soils differ as for feet.
The standard deviations by slip and of the offset are chosen."""
THEORY_ERROR = WheelError(0.0, 0.0, 12.0, 0.0, 13.0, 1.4, 5.8)
"""Of resistive force theory, from which nothing is taken off; soil and law as for feet."""


@dataclass(frozen=True)
class Wheel:
    """A rigid wheel.

    Attributes
    ----------
    radius, width
        Of the rim, without lugs [m].
    lugs, lug_height
        Number of straight lugs across the rim, and how far they stand out [m].

    Raises
    ------
    InputError
        If a size is no wheel's.
    """

    radius: float
    width: float
    lugs: int = 0
    lug_height: float = 0.0

    def __post_init__(self) -> None:
        """Check the sizes."""
        for name, value in (("radius", self.radius), ("width", self.width)):
            numbers(name, value, shape=(), low=5e-3, high=2.0, unit="m")
        numbers("lug_height", self.lug_height, shape=(), low=0.0, high=0.5 * self.radius, unit="m")
        if (self.lugs > 0) != (self.lug_height > 0.0) or not 0 <= self.lugs <= 200:
            raise InputError("lugs: give their number, up to 200, and their height, or neither")

    @property
    def reach(self) -> float:
        """Radius to the tips of the lugs [m]."""
        return self.radius + self.lug_height

    @property
    def spacing(self) -> float:
        """Distance of the lugs' tips over their height [-]; infinite without lugs."""
        if not self.lugs:
            return math.inf
        return 2.0 * math.pi * self.reach / self.lugs / self.lug_height

    @property
    def carried(self) -> float:
        """Share of the soil between the lugs that goes along [-]."""
        return min(max((FAR - self.spacing) / (FAR - CLOSE), 0.0), 1.0)

    @property
    def held(self) -> float:
        """Share of the soil under the rim that lugs keep from sliding [-]."""
        return min(max(2.0 - self.spacing / FAR, 0.0), 1.0)

    @property
    def bare(self) -> float:
        """How far the lugs stand out of the cylinder that bears the load [m]."""
        return (1.0 - self.carried) * self.lug_height


class WheelForces(NamedTuple):
    """Forces of the soil on a wheel, of the shape of what they were asked for."""

    pull: Any
    """Forward [N]: drawbar pull, negative where the wheel must be pushed."""
    load: Any
    """Up [N]."""
    torque: Any
    """That the motor needs [N m], negative of a brake."""
    side: Any
    """To the left, against a drift to the right [N]."""


def wheel_forces(
    wheel: Wheel,
    sinkage: ArrayLike,
    slip: ArrayLike,
    *,
    phi_deg: ArrayLike,
    density: float,
    surface_friction: ArrayLike = FRICTION.mean,
    mobilization: float = MOBILIZATION,
    side_slip_deg: ArrayLike = 0.0,
    law: str = "foot",
) -> WheelForces:
    """Forces of soil on a wheel at a given sinkage.

    Parameters
    ----------
    wheel
        The wheel.
    sinkage
        Of its lowest point, with lugs of their tips, below the undisturbed surface [m].
    slip
        As above [-].
    phi_deg
        φ in plane strain [deg].
    density
        Bulk density [kg/m³].
    surface_friction
        Between rim and soil [-], 0.05 to 0.65, a number or several, [friction]; what lugs carry
        along has that of the soil, tan φ, 0.65 at most.
    mobilization
        K [m]; 0: all friction at once.
    side_slip_deg
        Angle by which the wheel moves to the right of where it points [deg].
    law
        Level of the forces on a face: ``foot``, or ``rft``, resistive force theory as published.

    Returns
    -------
    WheelForces
        Of the common shape of sinkage, slip, φ and side slip, several frictions before it.

    Raises
    ------
    InputError
        If the sinkage is beyond :data:`DEEPEST` radii, the wheel is locked, or φ or the friction is
        outside of law ``foot``. A sinkage of lugs that do not reach the rim has no force.
    """
    z, s, phi, side = np.broadcast_arrays(
        *(np.asarray(v, dtype=np.float64) for v in (sinkage, slip, phi_deg, side_slip_deg))
    )
    numbers("sinkage", z, low=0.0, high=DEEPEST * wheel.reach, unit="m")
    numbers("slip", s, low=-STEEPEST, high=STEEPEST)
    numbers("side_slip_deg", side, low=-60.0, high=60.0, unit="deg")
    ends = FRICTIONS[0], FRICTIONS[-1]
    given = numbers("surface_friction", surface_friction, low=ends[0], high=ends[1])
    friction = np.reshape(given, (-1, 1))
    friction = friction + wheel.carried * (np.tan(np.radians(phi.ravel())) - friction)
    # Between tables of few frictions: the forces are nearly straight over it.
    at = np.interp(friction, FRICTIONS, np.arange(len(FRICTIONS)))
    places = np.maximum(z - wheel.bare, 0.0).ravel(), s.ravel(), phi.ravel(), side.ravel()
    rows = np.zeros((given.size, z.size, 4))
    for i, node in enumerate(FRICTIONS):
        share = np.maximum(1.0 - np.abs(at - i), 0.0)
        if share.any():
            rows += share[..., None] * _rim(wheel, *places, density, node, mobilization, law)
    return WheelForces(*np.moveaxis(rows, -1, 0).reshape(4, *given.shape, *z.shape))


def rolling(
    wheel: Wheel, load: ArrayLike, slip: ArrayLike, phi_deg: FloatArray, density: FloatArray, *,
    surface_friction: ArrayLike = FRICTION.mean,
) -> dict[str, FloatArray]:  # fmt: skip
    """Sinkage of the lugs' tips [mm], pull [N] and torque [N m] of a wheel in several soils.

    Parameters
    ----------
    wheel, surface_friction
        As of :func:`wheel_forces`.
    load, slip
        [N] and [-], of one shape or numbers.
    phi_deg, density
        φ in plane strain [deg] and bulk density [kg/m³], shape [soil].

    Returns
    -------
    dict
        ``sinkage_mm``, ``pull_N``, ``torque_Nm``, shape [soil, ...], after that of several
        frictions; NaN where the wheel would sink
        in deeper than :data:`DEEPEST` radii. φ is raised by what wheels in grains read too much.

    Raises
    ------
    InputError
        As :func:`wheel_forces`; if the load is none, or a slip is beyond :data:`SLIPS`.
    """
    loads, slips = np.broadcast_arrays(
        numbers("load", load, low=TINY, unit="N"),
        numbers("slip", slip, low=SLIPS[0], high=SLIPS[1]),
    )
    if not slips.size:
        raise InputError("slip: give a number, or an array of them")
    each = slips.ravel()
    low, high = angles_deg(FRICTIONS[1])
    deepest = DEEPEST * wheel.reach
    depths = wheel.bare + np.geomspace(1e-3 * wheel.reach, deepest - wheel.bare, POINTS)
    depths = np.minimum(depths, deepest)  # but for rounding
    read = np.clip(phi_deg[:, None] + WHEEL_ERROR.of(each), low, high - WIDTH_DEG)
    nodes = np.linspace(read.min(), read.max() + WIDTH_DEG, NODES)
    forces = wheel_forces(
        wheel, depths, each[:, None, None], phi_deg=nodes[:, None], density=DENSITY.mean,
        surface_friction=np.ravel(surface_friction),
    )  # fmt: skip
    # Forces go with the density. Over φ their logarithm is nearly straight.
    borne = np.log(np.maximum(np.maximum.accumulate(forces.load, axis=-1), TINY))
    at = (read - nodes[0]) / (nodes[1] - nodes[0])
    index = np.clip(at.astype(int), 0, NODES - 2)
    part = (at - index)[..., None]
    row = np.arange(each.size)
    curve = (1.0 - part) * borne[:, row, index] + part * borne[:, row, index + 1]
    wanted = np.log(loads.ravel() * DENSITY.mean / density[:, None])
    shares = np.stack([forces.pull, forces.torque]) / forces.load
    result = np.empty((3, len(curve), *read.shape))
    for k, i, j in np.ndindex(result.shape[1:]):
        depth = math.exp(np.interp(wanted[i, j], curve[k, i, j], np.log(depths), right=np.nan))
        pull, torque = (np.interp(depth, depths, share) for share in shares[:, k, j, index[i, j]])
        result[:, k, i, j] = 1e3 * depth, loads.flat[j] * pull, loads.flat[j] * torque
    shape = *np.shape(surface_friction), len(phi_deg), *slips.shape
    names = ("sinkage_mm", "pull_N", "torque_Nm")
    return {name: values.reshape(shape) for name, values in zip(names, result, strict=True)}


class BekkerWong(NamedTuple):
    """Parameters of the wheel model of Bekker, Wong and Reece, for one wheel in one soil."""

    n: float
    """Exponent of the sinkage [-]."""
    k: float
    """k_c / b + k_φ [N/m^(n+2)]."""
    cohesion_pa: float
    """c [Pa]: none."""
    phi_deg: float
    """φ in plane strain [deg]."""
    shear_m: float
    """K, over which friction develops [m]."""
    residual: float
    """Root mean square of ln of the load by these numbers over that of law ``foot`` [-]."""


def bekker_wong(wheel: Wheel, phi_deg: float, density: float) -> BekkerWong:
    """Fit p = k zⁿ under a rim to the load by law ``foot``, at sinkages of 3 to 30 % of the radius.

    Pull and torque by these numbers are other ones.

    Parameters
    ----------
    wheel
        The wheel; its lugs are left out.
    phi_deg, density
        φ in plane strain [deg] and bulk density [kg/m³].

    Notes
    -----
    W = b R ∫ k (R (cos θ − cos θ₁))ⁿ cos θ dθ from 0 to θ₁ (Bekker 1969; Wong, *Theory of Ground
    Vehicles*). The numbers hold for this wheel: Bekker's k depends on the size.
    """
    wheel = Wheel(wheel.radius, wheel.width)
    radius = wheel.radius
    depth = np.linspace(0.03, 0.3, 20) * radius
    low, high = angles_deg(FRICTIONS[1])
    read = float(np.clip(phi_deg + WHEEL_ERROR.offset_deg, low, high))
    load = wheel_forces(wheel, depth, 0.1, phi_deg=read, density=density).load
    start = np.arccos(1.0 - depth / radius)
    theta = start[:, None] * np.linspace(0.0, 1.0, 200)
    below = radius * (np.cos(theta) - np.cos(start)[:, None])
    fits = []
    for n in np.arange(0.2, 1.8, 0.01).tolist():
        unit = wheel.width * radius * np.trapezoid(
            np.maximum(below, 0.0) ** n * np.cos(theta), theta, axis=1
        )  # fmt: skip
        ratio = np.log(load / unit)
        fits.append((float(ratio.std()), n, float(np.exp(ratio.mean()))))
    residual, n, k = min(fits)
    return BekkerWong(n, k, 0.0, phi_deg, MOBILIZATION, residual)


def _rim(
    wheel: Wheel, sinkage: FloatArray, slip: FloatArray, phi_deg: FloatArray, side: FloatArray,
    density: float, friction: float, mobilization: float, law: str,
) -> FloatArray:  # fmt: skip
    """Pull, load, torque and side force of rows, shape [row, 4]."""
    radius = wheel.reach - wheel.bare
    theta = ((2.0 * np.arange(FACES) + 1.0) / FACES - 1.0) * math.acos(1.0 - DEEPEST)
    sine, cosine = np.sin(theta), np.cos(theta)
    area = np.full(FACES, (theta[1] - theta[0]) * radius * wheel.width)
    normals = np.stack([sine, 0.0 * sine, -cosine], axis=-1)
    # Speeds over the larger of v and ω R; the law has none of its own.
    speed = np.where(slip >= 0.0, 1.0 - slip, 1.0)[:, None]
    turning = np.where(slip >= 0.0, 1.0, 1.0 + slip)[:, None]
    drift = -speed * np.tan(np.radians(side))[:, None] + 0.0 * sine
    velocities = np.stack([speed - turning * cosine, drift, -turning * sine], axis=-1)
    axle = np.stack([0.0 * sinkage, 0.0 * sinkage, radius - sinkage], axis=-1)
    shear: dict[str, Any] = {}
    if mobilization > 0.0:
        # Way of the rim past the soil since it came in at θ₁, across as well.
        start = np.arccos(1.0 - sinkage / radius)[:, None]
        time = np.maximum(start - theta, 0.0) / turning
        along = turning * time - speed / turning * (np.sin(start) - sine)
        sheared = radius * np.where(theta < start, np.hypot(along, drift * time), 0.0)
        shear = {"mobilization": mobilization, "sheared": sheared}
    options: dict[str, Any] = {
        "phi_deg": phi_deg, "density": density, "surface_friction": friction, "law": law,
        "about": axle, "rest_speed": STILL, **shear,
    }  # fmt: skip
    faces = radius * normals + axle[:, None], normals, area
    force, moment = wrench(*faces, velocities, **options)
    counted = max(min(TANGENTIAL * friction, 1.0), wheel.held)
    if law == "foot" and counted < 1.0:
        # The load is that of a rim whose tangential velocity counts in part; pull and torque keep
        # their share of it, so that soil takes energy as before.
        tangents = np.stack([cosine, 0.0 * sine, sine], axis=-1)
        along = (velocities * tangents).sum(axis=-1, keepdims=True) * tangents
        slower = velocities - (1.0 - counted) * along
        borne = wrench(*faces, slower, **options)[0][:, 2] / np.maximum(force[:, 2], TINY)
        force, moment = borne[:, None] * force, borne[:, None] * moment
    return np.stack([force[:, 0], force[:, 2], -moment[:, 1], force[:, 1]], axis=-1)
