r"""The law of a leg: forces over the friction angle, their uncertainty, and their range.

Slow dry soil under gravity gives F = ρ g L³ f(θ; φ, μ, ratios of the rig), so that a library of one
rig is the law of all rigs with its proportions, and a law may have these ratios as further axes.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from terraphi.experiment.arrays import FloatArray, numbers
from terraphi.experiment.errors import InputError
from terraphi.experiment.rig import Rig
from terraphi.experiment.units import GRAVITY

if TYPE_CHECKING:
    import xarray as xr
    from numpy.typing import ArrayLike

    from terraphi.experiment.scenario import Scenario

PHI = "soil.friction_angle_deg"
"""Dotted scenario key of the friction angle."""
SIMILAR = (0.02, 0.015, 0.015)
"""Largest differences of a rig from the library's: width over the library's, height of the hip and
thickness over the length. Each moves φ by at most 0.5° (2 mm of Li's hip by 1°, 10 % of force
by 1.6 to 2°), which is less than what is assumed of sizes that were not measured."""
STEP = 1e-3
"""Step of numerical derivatives, of the range of φ [-]."""


class AnyLaw:
    """A law of legs, of whatever kind."""

    PRESET: ClassVar[str]
    """Name of a scenario of its soil."""

    @property
    def scenario(self) -> Scenario:
        """A scenario of its soil."""
        from terraphi.experiment.scenario import Scenario

        return Scenario.load(self.PRESET)

    def forces(
        self,
        rig: Rig | Mapping[str, Any] | Path | str,
        phi_deg: ArrayLike,
        *,
        leg: str | None = None,
        density: float | None = None,
        cohesion_pa: float = 0.0,
    ) -> xr.Dataset:
        """Forces on the leg of a rig by a law, and their slope with φ.

        They are as simulated. φ of measured forces has the law's mean offset on real soils taken
        off, so that these curves, inverted as if they were measured, give an angle up to 5° off;
        ``provenance["law_phi_deg"]`` of that answer has the angle by the law.

        Parameters
        ----------
        rig
            A :class:`~terraphi.Rig`, its keys, a TOML file, or ``li2013``.
        phi_deg
            Friction angles in the law's convention [deg], one or several.
        leg
            Shape of the leg, where the rig has several.
        density
            Bulk density [kg/m³]; forces are in proportion to it. By default that of the law's soil.
        cohesion_pa
            Cohesion [Pa], where the law knows it.

        Returns
        -------
        xarray.Dataset
            ``forces`` [N] and ``slope`` [N/deg], with the coordinates ``phi_deg``, ``force``
            (``Fx``, ``Fz``) and ``theta_deg``; and ``moment`` about the hip [N m].

        Raises
        ------
        InputError
            If the law is not for this rig, or an angle, friction or cohesion is outside it.

        Examples
        --------
        >>> curves = terraphi.law("legs").forces("li2013", [28.0, 33.0], leg="c", density=1600.0)
        >>> curves.forces.dims
        ('phi_deg', 'force', 'theta_deg')
        >>> bool(curves.slope.sel(force="Fz").max() > 0.0)
        True
        """
        import xarray as xr

        from terraphi.laws.legs import law_of
        from terraphi.laws.named import law_named

        law, apparatus = law_named(self), Rig.of(rig, leg)
        of_rig = law_of(law, apparatus, None)
        (low,), (high,) = of_rig.bounds
        unit = f"deg by law {law.name}"
        phi = numbers("phi_deg", phi_deg, low=low, high=high, unit=unit).ravel()
        # Forces go with the density, and a cohesion counts over the weight: c / (ρ g L).
        given = of_rig.density if density is None else density
        heavier = float(numbers("density", given, shape=(), low=100.0, high=1e4, unit="kg/m³"))
        heavier /= of_rig.density
        cohesion = cohesion_pa / (heavier * of_rig.density * GRAVITY * apparatus.length)
        if not 0.0 <= cohesion <= of_rig.most_cohesion:
            most = cohesion_pa / cohesion * of_rig.most_cohesion if cohesion else 0.0
            raise InputError(f"cohesion_pa = {cohesion_pa:g}: law {law.name} has 0 to {most:g} Pa")
        # A slope across two neighbors; at an end of the range it is one-sided.
        step = STEP * (high - low)
        before, after = (np.clip(phi + side, low, high) for side in (-step, step))
        lower, force, upper = (heavier * of_rig(x[:, None], cohesion) for x in (before, phi, after))
        dims = ("phi_deg", "force", "theta_deg")
        slope = (upper - lower) / (after - before)[:, None, None]
        variables: dict[Any, Any] = {
            "forces": (dims, force, {"units": "N"}), "slope": (dims, slope, {"units": "N/deg"}),
            "moment": (dims[::2], (of_rig.arm * force).sum(axis=1), {"units": "N m"}),
        }  # fmt: skip
        return xr.Dataset(
            variables,
            {"phi_deg": phi, "force": ["Fx", "Fz"], "theta_deg": of_rig.theta_deg},
            {"law": law.name, "rig": str(apparatus), "density_kg_m3": heavier * of_rig.density,
             "cohesion_Pa": cohesion_pa},
        )  # fmt: skip

    def summary(self) -> dict[str, Any]:
        """Contents and origin, JSON-able."""
        law: Any = self
        base = law.scenario
        return {
            "name": law.name, "model": base.model, "dimensions": base.dimensions,
            "convention": law.convention, "phi_deg": list(law.phi_deg), "legs": law.legs,
            "density_kg_m3": base.soil.density, "leg_friction": base.leg.friction,
            "provenance": dict(law.provenance),
        }  # fmt: skip


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
    most_cohesion: float = 0.0
    """Largest cohesion c / (ρ g L) of the law [-]; 0: it is of dry soil."""

    @property
    @abstractmethod
    def arm(self) -> FloatArray:
        """(a, b) [m] with M = a Fx + b Fz, the moment about the hip, shape [2, theta]."""

    @abstractmethod
    def within(self, x: FloatArray, cohesion: float) -> FloatArray:
        """Forces (Fx, Fz) [N] at angles within the bounds, [k, 1] -> [k, 2, theta]."""

    # An exact law of a rig has no errors of its own.

    def errors(
        self, _x: FloatArray, _cohesion: float, *, is_measured: bool
    ) -> dict[str, FloatArray]:
        """Factors F of covariances F F' at a point [N], by cause, shape [2 theta, k] each."""
        del is_measured
        return {}

    def of_hip(self, _x: FloatArray, _cohesion: float) -> FloatArray | None:
        """Change of the forces with the hip's height at a point [N/mm], shape [2 theta, 1]."""
        return None

    def __call__(self, x: FloatArray, cohesion: float = 0.0) -> FloatArray:
        """Forces (Fx, Fz) [N], [k, 1] -> [k, 2, theta]; linear in φ beyond its ends.

        The cohesion is c / (ρ g L) [-].
        """
        # F(φ_end) + (φ − φ_end) F'(φ_end), the slope from a step inward: a posterior reaches beyond
        # the cases, where what was fitted to them has no meaning.
        beyond = x - np.clip(x, *self.bounds)
        inside = x - beyond
        force = self.within(inside, cohesion)
        out = np.flatnonzero(beyond)
        if out.size:
            step = STEP * (self.bounds[1] - self.bounds[0])
            inner = self.within(inside[out] - np.sign(beyond[out]) * step, cohesion)
            force[out] += np.abs(beyond[out])[..., None] * ((force[out] - inner) / step)
        return force


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
