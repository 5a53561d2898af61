r"""Law ``rft3d``: resistive force theory in closed form, for a leg of any size.

In three dimensions (Agarwal et al., 2023) the friction angle scales the stress and nothing else
(:mod:`~terraphi.forward.rft`), so that the forces of a rig are a scale of φ times one curve:

    F(θ; φ) = ξ(φ) f(θ; rig),    ξ = ρ g (894 μ³ − 386 μ² + 89 μ),    μ = tan φ.

The law needs no simulation. It is the second opinion of an answer by law ``legs``, which takes the
lever arms of the soil's force from it.
"""

from __future__ import annotations

import functools
import hashlib
from typing import Any, ClassVar

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.bodies import OUTLINES
from terraphi.experiment.leg import Leg
from terraphi.experiment.motion import Poses
from terraphi.experiment.priors import FRICTION
from terraphi.experiment.rig import Rig
from terraphi.forward.feet import SCALE_POLYNOMIAL, SPACE_COEFFICIENTS, scale_of_friction
from terraphi.forward.rft import sheet_force, sheet_stress
from terraphi.laws.law import AnyLaw, LegLaw

PHI_DEG = (15.0, 50.0)
"""Smallest and largest friction angle [deg]; chosen: those of sand, with room at either end."""
DENSITY, ALUMINUM = 1650.0, 0.40
"""Density [kg/m³] and friction of the leg [-], those of scenario ``quick``."""
THETA_DEG = np.arange(-90.0, 91.0)
"""Leg angles of the curves [deg]: means over 1° about whole degrees."""
ARM_DEG = 2.0
"""Width over which lever arms are smoothed [deg]."""
WITHIN_DEG = np.array([-0.25, 0.25])
"""Angles about a whole degree at which forces are averaged [deg]: the theory jumps at 0°, between
them. Angles of the shipped records are within 1e-4° of those by forty."""


class Theory(AnyLaw):
    """The law of all legs."""

    name, caveat, convention, phi_deg = "rft3d", "", "rft3d", PHI_DEG
    PRESET = "quick"
    provenance: ClassVar = {"source": "Agarwal et al. (2023)"}
    hash = hashlib.sha256(
        np.concatenate([SCALE_POLYNOMIAL, SPACE_COEFFICIENTS.ravel(), PHI_DEG]).tobytes()
    ).hexdigest()
    """SHA-256 of all that changes an answer, hexadecimal."""

    @property
    def legs(self) -> list[str]:
        """Shapes of its legs, sorted."""
        return sorted(OUTLINES)

    @staticmethod
    @functools.lru_cache(maxsize=32)
    def law(rig: Rig) -> TheoryLaw:
        """The law of a rig, kept for the next record."""
        return TheoryLaw(rig)

    def summary(self) -> dict[str, Any]:
        """Contents and origin, JSON-able."""
        about = "3-D resistive force theory for a leg of any size"
        return super().summary() | {"description": about, "cases": 0}


class TheoryLaw(LegLaw):
    """The law of a rig."""

    theta_deg = THETA_DEG
    bounds = np.array(PHI_DEG[:1]), np.array(PHI_DEG[1:])

    def __init__(self, rig: Rig) -> None:
        # Of aluminum on poppy seeds it was measured, and stands where the rig's is assumed.
        is_assumed = (rig.leg_friction, rig.leg_friction_sd) == FRICTION
        self.leg_friction, self.density = ALUMINUM if is_assumed else rig.leg_friction, DENSITY
        leg = Leg(shape=rig.leg, chord=rig.length, width=1e-3 * rig.width_mm,
                  half_thickness=5e-4 * rig.thickness_mm, friction=self.leg_friction)  # fmt: skip
        # Of a velocity the theory takes the direction alone: any rate will do, here 1 rad/s about a
        # hip at rest, with the surface of the soil at z = 0.
        theta = np.radians(np.add.outer(THETA_DEG, WITHIN_DEG))
        still = np.zeros((theta.size, 2))
        hip = still + np.array([0.0, 1e-3 * rig.hip_height_mm])
        poses = Poses(hip, theta.ravel(), still, np.ones(theta.size))
        stress = functools.partial(sheet_stress, surface_friction=self.leg_friction)
        force, moment = sheet_force(leg, poses, stress, surface=0.0)
        # Fx, Fz and the moment about the hip over their common scale, shape [3, theta].
        curve = np.column_stack([force, moment]).reshape(*theta.shape, 3)
        self._curve = curve.mean(axis=1).T

    @functools.cached_property
    def arm(self) -> FloatArray:
        """(a, b) with M = a Fx + b Fz, by least squares at neighboring angles, shape [2, theta].

        Where on the leg the soil presses depends little on φ: the moment of Li's legs is met within
        1 % of its range.
        """
        # Minimize Σ_s w(s − t) (M − a Fx − b Fz)² at each angle t, w a Gaussian: the normal
        # equations of all angles are solved at once. The ridge holds where both forces vanish, in
        # air. In a ratio of moment to force ξ cancels: one curve is enough for all φ.
        curve = self._curve / np.sqrt(np.square(self._curve[:2]).mean())
        near = np.exp(-0.5 * np.square(np.subtract.outer(THETA_DEG, THETA_DEG) / ARM_DEG))
        normal = np.einsum("it,jt,st->sij", curve[:2], curve, near)
        ridge = 1e-6 * np.trace(normal[:, :, :2], axis1=1, axis2=2).max() * np.eye(2)
        return np.linalg.solve(normal[:, :, :2] + ridge, normal[:, :, 2:])[:, :, 0].T

    def within(self, x: FloatArray, _cohesion: float) -> FloatArray:
        """Forces within the bounds."""
        scale = scale_of_friction(np.tan(np.radians(x[:, 0])), self.density)
        return np.asarray(scale[:, None, None] * self._curve[:2])
