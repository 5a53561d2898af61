r"""Dry soil, and what its friction angle means.

Three conventions are in use, and the same named angle acts as angles up to almost a factor of four
apart, so no friction angle in this package travels without the name of its yield criterion. With
the in-plane mean stress :math:`p = \tfrac12 \mathrm{tr}\,\sigma` (tension positive) and the
in-plane deviatoric magnitude :math:`r = \sqrt{\tfrac12 s:s}` (the Mohr radius):

``paper``
    :math:`r + \alpha p \le k` with :math:`\alpha = 2\sin\varphi / (\sqrt3 (3 - \sin\varphi))`, as
    printed by Xu & Wang. The constant was made for :math:`I_1` and three dimensions; on
    :math:`\tfrac12\mathrm{tr}\,\sigma` it makes 35° act as Mohr-Coulomb 15.8°.
``plane_strain``
    the same with :math:`\alpha = \sin\varphi`: Mohr-Coulomb exactly, what a geotechnical engineer
    means. In three dimensions Mohr-Coulomb as it stands, on all principal stresses.
``triaxial``
    :math:`\sqrt{J_2} + \alpha I_1 \le k` with the first constant and :math:`\sigma_{yy}` carried:
    the Drucker-Prager cone through the compressive meridian of Mohr-Coulomb. In plane strain it is
    far stronger than its name says, and beyond 42.2° (without dilation) nothing is its equal.
"""

from __future__ import annotations

import math
from typing import Literal, Self, get_args

from pydantic import Field, model_validator

from terraphi.experiment.documents import Strict, refuse
from terraphi.experiment.errors import InputError

YieldCriterion = Literal["paper", "plane_strain", "triaxial"]
YIELD_CRITERIA: tuple[YieldCriterion, ...] = get_args(YieldCriterion)


def cone_slope(angle_deg: float, yield_criterion: YieldCriterion) -> float:
    """Slope of the yield surface (from φ) or of the plastic potential (from ψ).

    Parameters
    ----------
    angle_deg
        Friction or dilation angle [deg].
    yield_criterion
        Its convention.

    Returns
    -------
    float
        α of ``r + α p`` (``paper``, ``plane_strain``) or of ``√J2 + α I1`` (``triaxial``) [-].
    """
    sine = math.sin(math.radians(angle_deg))
    if yield_criterion == "plane_strain":
        return sine
    return 2.0 * sine / (math.sqrt(3.0) * (3.0 - sine))


def plane_strain_friction_angle_deg(
    friction_angle_deg: float, yield_criterion: YieldCriterion, *, dilation_angle_deg: float = 0.0
) -> float:
    r"""Mohr-Coulomb friction angle that has the same strength in plane strain.

    ``paper`` does not see the out-of-plane stress, so :math:`\sin\varphi' = \alpha`. For
    ``triaxial`` the out-of-plane stress at failure follows from a vanishing plastic strain rate
    across the plane, :math:`s_{yy} = -2\beta\sqrt{J_2}`, which gives
    :math:`\sin\varphi' = 3\alpha\sqrt{1-3\beta^2} / (1-3\alpha\beta)`; associated flow (β = α)
    recovers the matching of Drucker & Prager, 1952 (Quart. Appl. Math. 10, 157).

    Parameters
    ----------
    friction_angle_deg
        φ in the convention ``yield_criterion`` [deg].
    yield_criterion
        The convention of both angles.
    dilation_angle_deg
        ψ in the same convention [deg]; equal to φ for associated flow.

    Returns
    -------
    float
        φ of ``plane_strain`` [deg].

    Raises
    ------
    InputError
        If no plane-strain Mohr-Coulomb angle is as strong.

    Examples
    --------
    >>> round(plane_strain_friction_angle_deg(35.0, "paper"), 1)
    15.8
    """
    alpha = cone_slope(friction_angle_deg, yield_criterion)
    if yield_criterion == "triaxial":
        beta = cone_slope(dilation_angle_deg, yield_criterion)
        room = 1.0 - 3.0 * beta**2
        sine = 3.0 * alpha * math.sqrt(room) / (1.0 - 3.0 * alpha * beta) if room > 0 else 2.0
    else:
        sine = alpha
    if not 0.0 <= sine <= 1.0:
        angles = f"{friction_angle_deg:.2f} deg (dilation {dilation_angle_deg:.2f} deg)"
        raise InputError(f"a triaxial friction angle of {angles} has no equivalent in plane strain")
    return math.degrees(math.asin(sine))


class Soil(Strict):
    """Dry soil: hypoelastic, Drucker-Prager.

    Examples
    --------
    >>> terraphi.Soil(density=1600.0, friction_angle_deg=30.0).cohesion
    0.0
    """

    density: float = Field(1650.0, gt=0)
    """Bulk density ρ [kg/m³]."""
    youngs_modulus: float = Field(20e6, gt=0)
    """Young's modulus E [Pa]."""
    poisson_ratio: float = Field(0.30, ge=0, lt=0.5)
    """Poisson's ratio ν [-]."""
    friction_angle_deg: float = Field(35.0, gt=0, lt=90)
    """Friction angle φ [deg] in the convention of ``yield_criterion``."""
    yield_criterion: YieldCriterion = "paper"
    """What φ means: ``paper``, as printed by Xu & Wang; ``plane_strain``, Mohr-Coulomb (in
    three dimensions, with all principal stresses); ``triaxial``, Drucker-Prager matched at
    triaxial compression."""
    yield_surface: Literal["mohr_coulomb", "matsuoka_nakai"] = "mohr_coulomb"
    """In three dimensions and for ``plane_strain``, what the intermediate stress does.
    ``mohr_coulomb``: nothing, φ is the same in every direction; ``matsuoka_nakai``: φ is that of
    plane strain without dilation (with ψ = 10° soil of 35° has 34.5° there); in triaxial
    compression and extension it is less (35°: 31.2°)."""
    dilation_angle_deg: float = Field(0.0, gt=-90, lt=90)
    """Dilation angle ψ [deg], same convention, at most φ; ignored by associated flow. Below zero,
    in three dimensions and for ``plane_strain``, soil is compacted as it flows, over
    ``softening_strain``."""
    flow: Literal["dilation", "associated"] = "dilation"
    """``dilation``: plastic potential of slope β(ψ); ``associated``: β = α."""
    cohesion: float = Field(0.0, ge=0)
    """Cohesion c [Pa]."""
    tension_cutoff: float | None = Field(None, ge=0)
    """Mean stress [Pa] beyond which a trial state goes to the tip of the cut cone whatever the
    flow rule; ``None``: tension is left to the cone's own apex."""
    critical_friction_angle_deg: float | None = Field(None, gt=0, lt=90)
    """Friction angle in the critical state [deg], for soil that softens: φ and ψ are then those of
    the peak; ``None``: φ stays, and ψ unless it is negative. In three dimensions,
    ``plane_strain`` alone."""
    softening_strain: float = Field(0.2, gt=0)
    """Plastic shear strain over which sin φ falls to the critical state and sin ψ goes to zero [-];
    soil with ψ < 0 loses half of it times sin ψ of its volume (or, by the faces of Mohr-Coulomb on
    an edge, up to half as much again)."""
    k0: float | None = Field(None, gt=0)
    """Ratio of horizontal to vertical stress at rest [-]; ``None``: 1 - sin φ (Jaky)."""

    @model_validator(mode="after")
    def _is_possible(self) -> Self:
        phi, psi = self.friction_angle_deg, self.potential_angle_deg
        critical = self.critical_friction_angle_deg or 0.0
        # Beyond a limit pressure falls faster than shear where the volume is held, and no stress
        # exists. This bound lies below that limit for all φ, both surfaces and their edges.
        sines = math.sin(math.radians(phi)) * math.sin(math.radians(psi))
        lost = -sines * (self.shear_modulus + 2.0 * self.lame_lambda) >= self.shear_modulus
        other = self.yield_criterion != "plane_strain" and self.yield_surface != "mohr_coulomb"
        sticky = critical > 0.0 and self.cohesion > 0.0
        refuse(
            {
                f"dilation_angle_deg = {psi:g} exceeds friction_angle_deg = {phi:g}": psi > phi,
                f"dilation_angle_deg = {psi:g} loses all stress; bring it nearer to 0": lost,
                f"yield_surface = '{self.yield_surface}' needs yield_criterion = 'plane_strain', "
                f"not '{self.yield_criterion}'": other,
                f"critical_friction_angle_deg = {critical:g} exceeds friction_angle_deg = {phi:g}, "
                "the peak": critical > phi,
                f"cohesion = {self.cohesion:g} Pa is not for soil that softens; set 0": sticky,
            }
        )
        return self

    @property
    def lame_lambda(self) -> float:
        """First Lamé constant λ [Pa]."""
        nu = self.poisson_ratio
        return self.youngs_modulus * nu / ((1.0 + nu) * (1.0 - 2.0 * nu))

    @property
    def shear_modulus(self) -> float:
        """Shear modulus G [Pa]."""
        return self.youngs_modulus / (2.0 * (1.0 + self.poisson_ratio))

    @property
    def p_wave_speed(self) -> float:
        """Speed of elastic compression waves √((λ + 2G)/ρ) [m/s]."""
        return math.sqrt((self.lame_lambda + 2.0 * self.shear_modulus) / self.density)

    @property
    def k0_at_rest(self) -> float:
        """Ratio of horizontal to vertical stress at rest [-]."""
        return self.k0 or 1.0 - math.sin(math.radians(self.friction_angle_deg))

    @property
    def potential_angle_deg(self) -> float:
        """Dilation angle that the flow rule amounts to [deg]; φ if associated."""
        return self.friction_angle_deg if self.flow == "associated" else self.dilation_angle_deg

    @property
    def softens(self) -> bool:
        """True if φ or ψ changes with the plastic shear strain."""
        return self.critical_friction_angle_deg is not None or self.potential_angle_deg < 0.0

    @property
    def cone_intercept(self) -> float:
        """Strength k at zero mean stress [Pa]."""
        phi = math.radians(self.friction_angle_deg)
        if self.yield_criterion == "plane_strain":
            return self.cohesion * math.cos(phi)
        return 6.0 * self.cohesion * math.cos(phi) / (math.sqrt(3.0) * (3.0 - math.sin(phi)))

    @property
    def plane_strain_friction_angle_deg(self) -> float:
        """Mohr-Coulomb angle of equal strength in plane strain [deg].

        Raises
        ------
        InputError
            If there is none (``triaxial``, large angles).
        """
        return plane_strain_friction_angle_deg(
            self.friction_angle_deg,
            self.yield_criterion,
            dilation_angle_deg=self.potential_angle_deg,
        )
