r"""The law of a leg: forces over the friction angle, their uncertainty, and their range.

Slow dry soil under gravity gives F = ρ g L³ f(θ; φ, μ, ratios of the rig), so that a library of one
rig is the law of all rigs with its proportions, and a law may have these ratios as further axes.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError
from terraphi.experiment.rig import Rig
from terraphi.laws.emulator import Emulator, emulator_of
from terraphi.laws.store import Library

SIMILAR = (0.02, 0.015, 0.015)
"""Largest differences of a rig from the library's: width over the library's, height of the hip and
thickness over the length. Each moves φ by at most 0.5° (2 mm of Li's hip by 1°, 10 % of force
by 1.6 to 2°), which is less than what is assumed of sizes that were not measured."""
FRICTION = (0.1, 0.6)
"""Frictions of a leg that laws know [-]: those that were simulated."""
STEP = 1e-3
"""Step of numerical derivatives, of the range of φ [-]."""


class LegLaw(ABC):
    """Forces on the leg of a rig, over friction angles x [deg], shape [k, 1] or [1]."""

    bounds: tuple[FloatArray, FloatArray]
    """Smallest and largest friction angle [deg], shape [1] each."""
    theta_deg: FloatArray
    """Leg angles of the forces [deg], shape [theta]."""
    density: float
    """Bulk density that the forces are for [kg/m³]; they are in proportion to it."""
    leg_friction: float
    """Friction of the leg that the forces are for [-]."""
    _arm: FloatArray | None = None
    most_cohesion: float = 0.0
    """Largest cohesion c / (ρ g L) of the law [-]; 0: it is of dry soil."""

    @abstractmethod
    def within(self, x: FloatArray, cohesion: float) -> FloatArray:
        """Forces (Fx, Fz) [N] at angles within the bounds, [k, 1] -> [k, 2, theta]."""

    @property
    def arm(self) -> FloatArray | None:
        """(a, b) [m] with M = a Fx + b Fz, the moment about the hip, shape [2, theta].

        ``None``: the law has no moment.
        """
        return self._arm

    # An exact law of a rig has no errors of its own.

    def interpolation(self, _x: FloatArray, _cohesion: float) -> FloatArray:
        """Factor F of the covariance F F' of the interpolation at a point [N], [2 theta, k]."""
        return np.zeros((2 * self.theta_deg.size, 1))

    def scatter(self, _x: FloatArray, _cohesion: float) -> FloatArray:
        """Covariance between particle seeds at a point [N²], [2 theta, 2 theta]."""
        return np.zeros((2 * self.theta_deg.size,) * 2)

    def modes(self, _x: FloatArray, _cohesion: float) -> dict[str, FloatArray]:
        """Factors of further covariances at a point [N], by cause, shape [2 theta, k] each."""
        return {}

    def of_hip(self, _x: FloatArray, _cohesion: float) -> FloatArray | None:
        """Change of the forces with the hip's height at a point [N/mm], shape [2 theta, 1]."""
        return None

    def __call__(self, x: FloatArray, cohesion: float = 0.0) -> FloatArray:
        """Forces (Fx, Fz) [N], [k, 1] -> [k, 2, theta]; linear in φ beyond its ends.

        The cohesion is c / (ρ g L) [-].
        """
        beyond = x - np.clip(x, *self.bounds)
        inside = x - beyond
        force = self.within(inside, cohesion)
        out = np.flatnonzero(beyond)
        if out.size:
            step = STEP * (self.bounds[1] - self.bounds[0])
            inner = self.within(inside[out] - np.sign(beyond[out]) * step, cohesion)
            force[out] += np.abs(beyond[out])[..., None] * ((force[out] - inner) / step)
        return force


class LibraryLaw(LegLaw):
    """The law of a library for a rig of its proportions, longer by a factor [-]."""

    def __init__(self, emulator: Emulator, longer: float) -> None:
        curves = emulator.curves
        self.emulator, self._scale = emulator, longer**3
        self.bounds, self.theta_deg = emulator.bounds, curves.theta_deg
        self.density = curves.scenario.soil.density
        self.leg_friction = curves.scenario.leg.friction
        self._arm = None if curves.arm is None else longer * curves.arm

    def within(self, x: FloatArray, _cohesion: float) -> FloatArray:
        """Forces within the bounds."""
        return self._scale * self.emulator(x)

    def interpolation(self, x: FloatArray, _cohesion: float) -> FloatArray:
        """Factor of the emulator's covariance."""
        return self._scale * self.emulator.interpolation(np.clip(x, *self.bounds))

    def scatter(self, x: FloatArray, _cohesion: float) -> FloatArray:
        """Covariance of the emulator's scatter."""
        return self._scale**2 * self.emulator.scatter(np.clip(x, *self.bounds))


def is_similar(rig: Rig, leg: Rig) -> bool:
    """True if a rig has the proportions of a simulated leg."""
    ratios, simulated = rig.ratios, leg.ratios
    differences = (
        ratios.width / simulated.width - 1.0,
        ratios.hip_height - simulated.hip_height,
        ratios.thickness - simulated.thickness,
    )
    return bool((np.abs(differences) <= SIMILAR).all())


def remedy(rig: Rig) -> str:
    """Advice for a rig that no shipped law covers."""
    sizes = rig.sizes_mm.items()
    options = " ".join(f"--{key[:-3].replace('_', '-')} {size:g}" for key, size in sizes)
    return (
        f"simulate it: terraphi library build --leg {rig.leg} {options}±{rig.hip_height_sd_mm:g} "
        "--out mine.nc; then add --law mine.nc. For a rough angle at once: --law rft3d"
    )


def check_friction(rig: Rig) -> None:
    """Raise InputError if the leg's friction is outside what was simulated."""
    if not FRICTION[0] <= rig.leg_friction <= FRICTION[1]:
        raise InputError(
            f"leg_friction = {rig.leg_friction:g}; {FRICTION[0]:g} to {FRICTION[1]:g} are accepted"
        )


def leg_law(library: Library, rig: Rig, *, strict: bool = True) -> LegLaw:
    """The law of a rig by a library of legs.

    Parameters
    ----------
    library
        Has the rig's leg.
    rig
        The apparatus.
    strict
        True if the rig must have the proportions of the library's leg.

    Raises
    ------
    InputError
        If the library lacks the leg, or its leg has other proportions.
    """
    emulator = emulator_of(library, rig.leg)
    simulated = Rig.of_scenario(emulator.curves.scenario)
    if strict and simulated is not None and not is_similar(rig, simulated):
        raise InputError(
            f"library {library.name} is of a {simulated}, and this leg has other proportions; "
            f"{remedy(rig)}"
        )
    return LibraryLaw(emulator, 1.0 if simulated is None else rig.length / simulated.length)
