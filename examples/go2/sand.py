"""Sand under the feet of the simulated Go2: a force law, a field of φ and an uneven surface.

The law F gives the force of steady motion in virgin sand. Sand also holds a foot that rests, and
lets go of one that is lifted. So the force changes by −k Δx while it is within the law's limits
(an ellipse from its lift straight down and its drag on the level), and follows the law outside,

    f ← F(new depth) + (f − F(old depth)) exp(−k |Δx| / |F|),

which is the law itself while the foot moves on. A foot that goes down sets soil of a mass m in
motion, and feels d(m v)/dt as well.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from go2.model import FOOT_RADIUS
from terraphi.laws.foot import LAWS, Foot, inertial_force
from terraphi.robot.joint_log import FEET

FloatArray = NDArray[np.float64]

STIFFNESS = 1.5e5
"""Of sand that is unloaded, or loaded again [N/m]."""
DAMPING = 20.0
"""Of a foot that sand holds [N s/m]; one that moves on feels the law alone."""
LAG_S = 3e-3
"""Time over which the acceleration of a foot is averaged [s]: an added mass must lag in a step that
does not know the next velocity."""
FIRMER = (0.0, 1.0, 1.5, 2.0), (7.9, 3.5, 0.5, 0.0)
"""Distance from a print over the radius [-], and how much more a ball reads there [deg]: grains
(:data:`terraphi.inference.footfalls.NEAR_RADII`)."""
WAVES = 40
"""Cosines that a random field is made of."""


@dataclass(frozen=True)
class Field:
    """A smooth random field over the plane, with the covariance of a squared exponential.

    Attributes
    ----------
    mean, spread
        Of its values.
    length
        Correlation length [m].
    seed
        Which one.
    """

    mean: float
    spread: float
    length: float
    seed: int = 0

    @cached_property
    def _waves(self) -> tuple[FloatArray, FloatArray]:
        rng = np.random.default_rng(self.seed)
        wave = rng.normal(0.0, 1.0 / self.length, (WAVES, 2))
        return wave, rng.uniform(0.0, 2.0 * np.pi, WAVES)

    def __call__(self, place: FloatArray) -> FloatArray:
        """Values at places [m], shape [..., 2 or more]."""
        wave, phase = self._waves
        angle = np.asarray(place)[..., :2] @ wave.T + phase
        return self.mean + self.spread * np.sqrt(2.0 / WAVES) * np.cos(angle).sum(axis=-1)


@dataclass(frozen=True)
class Sand:
    """What the robot walks on.

    Attributes
    ----------
    phi
        Friction angle [deg] over the plane.
    surface
        Height of the surface [m] over the plane.
    density
        [kg/m³].
    surface_friction
        Coefficient between foot and sand [-].
    law
        One of :data:`~terraphi.laws.foot.LAWS`.
    radius
        Of the feet [m].
    exponent
        Added to the power with which the law grows with depth [-].
    cohesion
        Of damp sand [Pa]; it adds the bearing capacity c N_c s_c d_c of the foot's circle by
        Hansen (see :mod:`terraphi.laws.foot`).
    """

    phi: Field = field(default_factory=lambda: Field(42.0, 1.5, 1.0))
    surface: Field = field(default_factory=lambda: Field(0.0, 0.005, 0.4))
    density: float = 1550.0
    surface_friction: float = 0.5
    law: str = "foot"
    radius: float = FOOT_RADIUS
    exponent: float = 0.0
    cohesion: float = 0.0

    def under(self, model: mujoco.MjModel, *, step: float) -> SandForces:
        """The forces of this sand on a robot whose simulation takes steps of some length [s]."""
        return SandForces(self, model, step)

    def lift(self, depth: FloatArray, descent: FloatArray, phi: FloatArray) -> FloatArray:
        """Force of steady motion along the horizontal part of it, and up [N], shape [..., 2]."""
        # Bearing capacity speaks of feet that go down: of others it gets a drag, to stand on.
        directed = self.law in ("rft", "foot")
        force = LAWS[self.law].force(
            Foot(self.radius),
            depth,
            descent if directed else np.where(descent > -1e-3, 0.5 * np.pi, -0.5 * np.pi),
            friction_angle_deg=phi,
            density=self.density,
            surface_friction=self.surface_friction,
        )
        if not directed:
            force[..., 0] = -0.6 * force[..., 1] * np.cos(descent)
        force *= (np.maximum(depth, 1e-4)[..., None] / self.radius) ** self.exponent
        if self.cohesion:
            tan, n_q = np.tan(np.radians(phi)), _bearing(phi)
            cap = np.clip(depth, 0.0, self.radius)
            deep = np.arctan(np.maximum(depth, 0.0) / (2.0 * self.radius))
            bears = ((n_q - 1.0) / tan + n_q) * (1.0 + 0.4 * deep)
            area = np.pi * cap * (2.0 * self.radius - cap)
            held = self.cohesion * bears * area * (descent > -1e-3)
            force += np.stack([-0.6 * held * np.cos(descent), held], axis=-1)
        return force


@dataclass(frozen=True)
class Elastic(Sand):
    """A mat, foam or floor that springs back, bare or under sand.

    Attributes
    ----------
    stiffness
        Of its spring [N/m].
    lossy, relaxation
        Stiffness of a second spring [N/m] behind a damper, and the time in which that relaxes [s]
        (a standard linear solid).
    cover
        Depth of the sand on it [m]; 0: it is bare.
    """

    stiffness: float = 5e3
    lossy: float = 0.0
    relaxation: float = 0.1
    cover: float = 0.0

    def lift(self, depth: FloatArray, descent: FloatArray, phi: FloatArray) -> FloatArray:
        """Force of the sand on top of it."""
        return super().lift(depth, descent, phi) * (self.cover > 0.0)


@dataclass(frozen=True)
class Trodden(Sand):
    """Sand with the prints of a walk before, in each of which φ is higher and the surface lower.

    Attributes
    ----------
    prints
        Place and depth of each [m], shape [print, 3].
    """

    prints: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))

    def under(self, model: mujoco.MjModel, *, step: float) -> SandForces:
        """The forces of this sand, its fields as they are after the first walk."""
        from scipy.spatial import cKDTree

        tree, (phi, surface) = cKDTree(self.prints[:, :2]), (self.phi, self.surface)

        def near(place: FloatArray) -> tuple[FloatArray, FloatArray]:
            apart, row = tree.query(np.asarray(place)[..., :2])
            return apart / self.radius, self.prints[row, 2]

        def stronger(place: FloatArray) -> FloatArray:
            return phi(place) + np.interp(near(place)[0], *FIRMER)

        def lower(place: FloatArray) -> FloatArray:
            apart, depth = near(place)
            return surface(place) - depth * np.clip(1.0 - (apart / 1.5) ** 2, 0.0, 1.0)

        after: Any = {"phi": stronger, "surface": lower}
        return SandForces(
            Sand(**{**{f.name: getattr(self, f.name) for f in fields(Sand)}, **after}), model, step
        )


@dataclass(frozen=True)
class Crust(Sand):
    """Weak snow under a crust.

    Attributes
    ----------
    breaks_N, thickness
        Force at which a foot breaks through, and its depth by then [m].
    weak
        Growth of the force with depth below the crust [N/m].
    """

    breaks_N: float = 40.0
    thickness: float = 0.008
    weak: float = 1500.0

    def lift(self, depth: FloatArray, descent: FloatArray, phi: FloatArray) -> FloatArray:
        """Force of crust or snow, the same at all places."""
        del phi
        below = depth - self.thickness
        up = np.where(below < 0.0, self.breaks_N * depth / self.thickness, self.weak * below)
        up = np.where(descent > -1e-3, np.maximum(up, 0.0), 0.0)
        return np.stack([-0.6 * up * np.cos(descent), up], axis=-1)


@dataclass(frozen=True)
class Displaced(Sand):
    """Sand by Archimedes' law for grains: the lift is K(φ) ρ g times the volume displaced.

    Attributes
    ----------
    lifting
        K of sand of 40° [-]; it grows with φ as the bearing factor N_q does.
    """

    lifting: float = 102.0

    def lift(self, depth: FloatArray, descent: FloatArray, phi: FloatArray) -> FloatArray:
        """Force of such sand."""
        z, size = np.maximum(depth, 0.0), self.radius
        cap = np.minimum(z, size)
        volume = np.pi * cap**2 * (size - cap / 3.0) + np.pi * size**2 * (z - cap)
        up = self.lifting * _bearing(phi) / _bearing(40.0) * self.density * 9.81 * volume
        up = np.where(descent > -1e-3, up, 0.0)
        return np.stack([-0.6 * up * np.cos(descent), up], axis=-1)


def _bearing(phi_deg: FloatArray | float) -> FloatArray:
    """Bearing factor N_q."""
    sin = np.sin(np.radians(phi_deg))
    return np.exp(np.pi * np.tan(np.radians(phi_deg))) * (1.0 + sin) / (1.0 - sin)


@dataclass(frozen=True)
class Ground(Sand):
    """Ground by another formula than a law's: sums of parts that yield for good, the same anywhere.

    Attributes
    ----------
    strength, hardening
        Undrained shear strength of clay [Pa] and its growth with depth [Pa/m]; it bears nine times
        that on the area of contact.
    stiffness, power
        Of a layer whose force is k R (z/R)^n: k [N/m] and n [-].
    crust_N, thickness
        Force at which a crust on top breaks, and its depth by then [m].
    """

    strength: float = 0.0
    hardening: float = 0.0
    stiffness: float = 0.0
    power: float = 1.0
    crust_N: float = 0.0
    thickness: float = 0.006

    def lift(self, depth: FloatArray, descent: FloatArray, phi: FloatArray) -> FloatArray:
        """Force of such ground."""
        del phi
        z, size = np.maximum(depth, 0.0), self.radius
        cap = np.minimum(z, size)
        area = np.pi * cap * (2.0 * size - cap)
        up = 9.0 * (self.strength + self.hardening * z) * area
        up += self.stiffness * size * (z / size) ** self.power
        if self.crust_N:
            up = np.where(z < self.thickness, self.crust_N * z / self.thickness, up)
        up = np.where(descent > -1e-3, up, 0.0)
        return np.stack([-0.6 * up * np.cos(descent), up], axis=-1)


class SandForces:
    """Pushes the feet of one simulation."""

    def __init__(self, sand: Sand, model: mujoco.MjModel, step: float) -> None:
        self._sand, self._model, self._step = sand, model, step
        self._feet = [model.body(f"{foot}_foot").id for foot in FEET]
        self._last, self._held = np.full((4, 3), np.nan), np.zeros((4, 3))
        self._sinking = np.zeros(4)
        self._spring = np.zeros((4, 4))  # shear of the elastic ground, pressure, lossy part
        self.force = np.zeros((4, 3))
        """On each foot in the world [N], shape [foot, 3]."""

    def push(self, data: mujoco.MjData) -> None:
        """Update the forces for where the feet are now, and apply them."""
        place = data.xpos[self._feet].copy()
        moved = place - np.where(np.isnan(self._last), place, self._last)
        self._last = place
        sand = self._sand
        depth = sand.surface(place) - (place[:, 2] - sand.radius)
        in_it = depth > 0.0
        self._follow(depth, moved, sand.phi(place), in_it)
        if isinstance(sand, Elastic):
            self._press(sand, depth - sand.cover, moved)
        # Tangential stresses on the ball turn it; they matter while it is hardly submerged.
        low = sand.radius * np.exp(-np.maximum(depth, 0.0) / sand.radius)
        for i, body in enumerate(self._feet):
            x, y, _ = data.xfrc_applied[body, :3] = self.force[i]
            data.xfrc_applied[body, 3:] = low[i] * np.array([y, -x, 0.0])

    def _follow(
        self, depth: FloatArray, moved: FloatArray, phi: FloatArray, in_it: NDArray[np.bool_]
    ) -> None:
        level = np.hypot(moved[:, 0], moved[:, 1])
        far = np.linalg.norm(moved, axis=1)
        descent = np.arctan2(-moved[:, 2], level)
        old = np.maximum(depth + moved[:, 2], 0.0)
        # The law before and after the step, and its limits straight down and level.
        ways = np.stack([descent, descent, np.full(4, 0.5 * np.pi), np.zeros(4)])
        every = self._sand.lift(np.stack([old, depth, depth, depth]), ways, np.stack([phi] * 4))
        heading = moved[:, :2] / np.maximum(level, 1e-12)[:, None]
        law = np.concatenate([every[:2, :, :1] * heading, every[:2, :, 1:]], axis=-1)
        trial = self._held - STIFFNESS * moved
        pressed = trial[:, 2] / np.maximum(every[2, :, 1], 1e-6)
        dragged = np.hypot(trial[:, 0], trial[:, 1]) / np.maximum(-every[3, :, 0], 1e-6)
        holds = np.hypot(pressed, dragged) < 1.0
        size = np.maximum(np.linalg.norm(law[1], axis=1), 0.5)
        kept = np.exp(-STIFFNESS * far / size)[:, None]
        flowing = law[1] + (self._held - law[0]) * kept
        self._held = np.where(holds[:, None], trial, flowing)
        self._held[:, 2] = np.maximum(self._held[:, 2], 0.0)
        self._held[~in_it] = 0.0
        down = -moved[:, 2] / self._step
        faster = (down - self._sinking) / LAG_S
        self._sinking += self._step * faster
        inertia = inertial_force(Foot(self._sand.radius), depth, down, faster, self._sand.density)
        inertia = np.where(~holds & (down > 0.0), inertia, 0.0)
        damped = np.where(holds[:, None], DAMPING / self._step * moved, 0.0)
        self.force = self._held - damped
        self.force[:, 2] += inertia
        self.force[:, 2] = np.maximum(self.force[:, 2], 0.0)
        self.force[~in_it] = 0.0

    def _press(self, ground: Elastic, deep: FloatArray, moved: FloatArray) -> None:
        """Add the force of elastic ground: a standard linear solid, and shear up to friction."""
        spring, gone = self._spring, np.maximum(deep, 0.0) - np.maximum(deep + moved[:, 2], 0.0)
        spring[:, 3] = spring[:, 3] * np.exp(-self._step / ground.relaxation) + ground.lossy * gone
        spring[:, 2] = np.maximum(ground.stiffness * deep + spring[:, 3], 0.0)
        spring[:, :2] -= 2e4 * moved[:, :2]
        most = ground.surface_friction * spring[:, 2]
        size = np.linalg.norm(spring[:, :2], axis=1)
        slips = size > most
        spring[:, :2] *= np.where(slips, most / np.maximum(size, 1e-9), 1.0)[:, None]
        spring[deep <= 0.0] = 0.0
        sticks = (~slips & (deep > 0.0))[:, None]
        self.force += spring[:, :3]
        self.force[:, :2] -= np.where(sticks, DAMPING / self._step * moved[:, :2], 0.0)
