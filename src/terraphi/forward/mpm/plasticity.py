r"""Stress update of one material point in space: Jaumann rate, then return to the yield surface.

Stress is (σ_xx, σ_yy, σ_zz, σ_xy, σ_xz, σ_yz) [Pa], tension positive, with principal stresses
:math:`\sigma_1 \ge \sigma_2 \ge \sigma_3`.

Mohr-Coulomb (``plane_strain``, whatever the intermediate stress): six planes

.. math:: f = (1 + \sin\varphi)\,\sigma_i - (1 - \sin\varphi)\,\sigma_j - 2c\cos\varphi \le 0,

each with the potential of the same form in ψ. The return (de Souza Neto, Peric, Owen, 2008,
*Computational Methods for Plasticity*, ch. 8.2) goes along :math:`D\,\partial g` to the face of
(σ₁, σ₃); where that would change the order of the principal stresses, to the edge σ₁ = σ₂
or σ₂ = σ₃, on which two faces flow; beyond the tip, to the tip. In the mean stress m and the
gaps between principal stresses a return is short, for on an edge one gap is zero, the other
follows from m by f = 0, and m falls by 2 K sin ψ times the sum of both multipliers.

Why the faces' own flow, and no radial return, which shrinks the deviatoric stress without turning
it and has the same strength: so φ and ψ mean what they mean in limit analysis, and a point strained
in a plane does step by step what it does in the solver of the plane, whatever the stress across.

Matsuoka and Nakai (1974, Proc. JSCE 232, 59), ``yield_surface = "matsuoka_nakai"``:

.. math:: I_1 I_2 / I_3 = (9 - 3 s^2) / (1 - s^2), \quad s = \sin\varphi,

smooth, through Mohr-Coulomb of one angle in triaxial compression and extension and of larger ones
between them. φ is that in plane strain without dilation, where the intermediate deviatoric stress
vanishes. At the Lode angle θ (cos 3θ = 1 in extension) the surface has

.. math:: \sqrt{J_2} = x\,(t - m), \quad x^2 + q x^3 = s^2, \quad
          q = (3 - s^2) \cos 3\theta / \sqrt{27},

t the mean stress at the tip. The return is radial: the deviatoric stress shrinks without turning,
and m falls by K sin ψ times the increment of κ. It is the plainest of smooth flow rules; tests of
sand with three different stresses fit another one (Lade and Duncan, 1975, J. Geotech. Eng. Div.
ASCE 101, 1037). Which of the two surfaces is taken is worth 1 to 2° of φ on a leg: docs, *Three
dimensions*.

The new tensor has the old directions. With new principal values a quadratic polynomial of the
old ones, that is a polynomial of the old tensor (Newton's divided differences), so that no
directions need be found, and equal principal stresses do no harm.

Drucker-Prager (``triaxial``): :math:`\sqrt{J_2} + \alpha I_1 \le k`, radial return.

Softening (not of the cone): with the plastic shear strain κ = ∫(dε₁ᵖ - dε₃ᵖ) sin φ falls and sin ψ
goes linearly to the critical state, where ψ = 0. Of either sign: soil with ψ < 0 is compacted.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from terraphi.experiment.soil import Soil, cone_slope
from terraphi.forward.compiled import kernel

Six = tuple[float, float, float, float, float, float]
Nine = tuple[float, float, float, float, float, float, float, float, float]

SMALLEST = 1e-12
"""Keeps a quotient of vanishing stresses from being no number [Pa]."""
SMALLEST_CUBE = 1e-36
"""The same for cubes of stresses [Pa³]."""
SHORT_OF_TIP = 1e-5
"""How far short of the tip a mean stress beyond it is put, lest rounding put it beyond, as a share
of the stress [-]."""


class Material(NamedTuple):
    """Constants of the stress update, as the kernels take them."""

    lame_lambda: float
    """λ [Pa]."""
    shear_modulus: float
    """G [Pa]."""
    sin_friction: float
    """sin φ at the peak [-]."""
    sin_dilation: float
    """sin ψ at the peak [-]."""
    sin_critical: float
    """sin φ in the critical state [-]."""
    per_softening: float
    """1 over the plastic shear strain to the critical state; 0: none softens [-]."""
    strength: float
    """2 c cos φ [Pa]."""
    cutoff: float
    """Mean stress beyond which a trial state goes to the tip [Pa]; may be inf."""
    tip: float
    """Mean stress at the tip of the surface, cut off or not [Pa]."""
    apex: float
    """Mean stress at the tip had it not been cut off [Pa]."""
    nakai: bool
    """Whether the surface is Matsuoka and Nakai's."""
    cone: bool
    """Whether the surface is Drucker and Prager's."""
    alpha: float
    """Slope of the cone [-]."""
    beta: float
    """Slope of its potential [-]."""
    intercept: float
    """k of the cone [Pa]."""

    @property
    def swells(self) -> bool:
        """Whether yielding changes its volume."""
        return self.sin_dilation != 0.0


def material_of(soil: Soil) -> Material:
    """Constants of a soil.

    Parameters
    ----------
    soil
        Its criterion is ``plane_strain`` (Mohr-Coulomb) or ``triaxial``.

    Returns
    -------
    Material
    """
    phi = math.radians(soil.friction_angle_deg)
    critical = soil.critical_friction_angle_deg
    cone = soil.yield_criterion == "triaxial"
    tip = soil.cone_intercept / cone_slope(soil.friction_angle_deg, soil.yield_criterion)
    tip /= 3.0 if cone else 1.0
    cutoff = math.inf if soil.tension_cutoff is None else min(soil.tension_cutoff, tip)
    return Material(
        soil.lame_lambda,
        soil.shear_modulus,
        math.sin(phi),
        math.sin(math.radians(soil.potential_angle_deg)),
        math.sin(phi if critical is None else math.radians(critical)),
        1.0 / soil.softening_strain if soil.softens else 0.0,
        2.0 * soil.cohesion * math.cos(phi),
        cutoff,
        min(cutoff, tip),
        tip,
        soil.yield_surface == "matsuoka_nakai",
        cone,
        cone_slope(soil.friction_angle_deg, "triaxial"),
        cone_slope(soil.potential_angle_deg, "triaxial"),
        soil.cone_intercept if cone else 0.0,
    )


def held_mean(material: Material) -> Material:
    """Constants of soil whose plastic changes of volume leave its mean stress: K is 0."""
    return material._replace(lame_lambda=-2.0 / 3.0 * material.shear_modulus)


@kernel
def bulk_modulus(material: Material) -> float:
    """K [Pa]."""
    return material.lame_lambda + 2.0 / 3.0 * material.shear_modulus


@kernel
def jaumann_predictor(
    stress: Six, strain: Nine, volumetric: float, lame_lambda: float, shear_modulus: float
) -> Six:
    """Trial stress after one step of hypoelasticity with the Jaumann rate.

    Parameters
    ----------
    stress
        [Pa].
    strain
        Velocity gradient times the step, ∂v_a/∂x_b Δt row by row [-].
    volumetric
        Its trace, or the one to take instead: the excess is spread over the diagonal [-].
    lame_lambda, shear_modulus
        λ, G [Pa].

    Returns
    -------
    tuple
        σ + (Wσ - σW) + λ tr(D) 1 + 2 G D [Pa].
    """
    xx, yy, zz, xy, xz, yz = stress
    dxx, axy, axz, ayx, dyy, ayz, azx, azy, dzz = strain
    wxy, wxz, wyz = 0.5 * (axy - ayx), 0.5 * (axz - azx), 0.5 * (ayz - azy)
    shear = 2.0 * shear_modulus
    even = lame_lambda * volumetric + shear * (volumetric - dxx - dyy - dzz) / 3.0
    return (
        xx + even + shear * dxx + 2.0 * (wxy * xy + wxz * xz),
        yy + even + shear * dyy + 2.0 * (wyz * yz - wxy * xy),
        zz + even + shear * dzz - 2.0 * (wxz * xz + wyz * yz),
        xy + shear_modulus * (axy + ayx) + wxy * (yy - xx) + wxz * yz + wyz * xz,
        xz + shear_modulus * (axz + azx) + wxz * (zz - xx) + wxy * yz - wyz * xy,
        yz + shear_modulus * (ayz + azy) + wyz * (zz - yy) - wxy * xz - wxz * xy,
    )


@kernel
def softened(strain: float, material: Material) -> tuple[float, float]:
    """Mobilised sin φ and sin ψ at a plastic shear strain [-]."""
    left = max(1.0 - material.per_softening * strain, 0.0)
    return (
        material.sin_critical + left * (material.sin_friction - material.sin_critical),
        left * material.sin_dilation,
    )


@kernel
def mohr_coulomb_return(
    mean: float, high: float, low: float, sin_phi: float, sin_psi: float, material: Material
) -> tuple[float, float, float, float]:
    """Return of mean stress and gaps between principal stresses to the Mohr-Coulomb surface.

    Parameters
    ----------
    mean
        Trial mean stress m [Pa].
    high, low
        Trial σ₁ - σ₂ and σ₂ - σ₃ [Pa].
    sin_phi, sin_psi
        Mobilised [-].
    material
        Constants.

    Returns
    -------
    tuple
        The same three after the return [Pa], and the change of volume [-], 0 beyond the tip.
    """
    lame, shear, k = material.lame_lambda, material.shear_modulus, material.strength
    bulk = bulk_modulus(material)
    first = mean + (2.0 * high + low) / 3.0
    third = first - high - low
    excess = (1.0 + sin_phi) * first - (1.0 - sin_phi) * third - k
    if mean > material.cutoff:
        return material.tip, 0.0, 0.0, 0.0
    if excess <= 0.0:
        return mean, high, low, 0.0
    common = 4.0 * lame * sin_phi * sin_psi
    face = common + 4.0 * shear * (1.0 + sin_phi * sin_psi)
    multiplier = excess / face
    new_high = high - 2.0 * shear * (1.0 + sin_psi) * multiplier
    new_low = low - 2.0 * shear * (1.0 - sin_psi) * multiplier
    if new_high < 0.0:  # the edge σ1 = σ2
        both = 2.0 * excess - (1.0 + sin_phi) * high
        multiplier = both / (face + common + 2.0 * shear * (1.0 - sin_phi) * (1.0 - sin_psi))
        mean -= 2.0 * bulk * sin_psi * multiplier
        new_high, new_low = 0.0, 3.0 * (k - 2.0 * sin_phi * mean) / (3.0 - sin_phi)
    elif new_low < 0.0:  # the edge σ2 = σ3
        both = 2.0 * excess - (1.0 - sin_phi) * low
        multiplier = both / (face + common + 2.0 * shear * (1.0 + sin_phi) * (1.0 + sin_psi))
        mean -= 2.0 * bulk * sin_psi * multiplier
        new_high, new_low = 3.0 * (k - 2.0 * sin_phi * mean) / (3.0 + sin_phi), 0.0
    else:
        mean -= 2.0 * bulk * sin_psi * multiplier
    if mean > material.tip:
        return material.tip, 0.0, 0.0, 0.0
    return mean, new_high, new_low, 2.0 * sin_psi * multiplier


@kernel
def nakai_return(
    mean: float,
    radius: float,
    cosine: float,
    span: float,
    sin_phi: float,
    sin_psi: float,
    material: Material,
) -> tuple[float, float, float]:
    """Return of mean stress and √J₂ to the surface of Matsuoka and Nakai.

    Parameters
    ----------
    mean, radius
        Trial mean stress m and √J₂ [Pa].
    cosine
        cos 3θ, 1 in triaxial extension [-].
    span
        Trial σ₁ - σ₃ [Pa].
    sin_phi, sin_psi
        Mobilised [-].
    material
        Constants.

    Returns
    -------
    tuple
        The first two after the return [Pa], and the change of volume [-], 0 beyond the tip.
    """
    if mean > material.cutoff:
        return material.tip, 0.0, 0.0
    # With u = 1/x the surface is s² u³ - u - q = 0, whose largest root this is.
    third = math.acos(min(0.5 * sin_phi * (3.0 - sin_phi * sin_phi) * cosine, 1.0)) / 3.0
    slope = 0.5 * math.sqrt(3.0) * sin_phi / math.cos(third)
    excess = radius - slope * (material.apex - mean)
    if excess <= 0.0:
        return mean, radius, 0.0
    bulk = bulk_modulus(material)
    shear = 2.0 * material.shear_modulus * max(radius, SMALLEST) / max(span, SMALLEST)
    slip = excess / (shear + slope * bulk * sin_psi)
    mean -= bulk * sin_psi * slip
    radius -= shear * slip
    if mean > material.tip:
        return material.tip, 0.0, 0.0
    if radius < 0.0:
        return material.tip, 0.0, sin_psi * slip
    return mean, radius, sin_psi * slip


@kernel
def cone_return(mean: float, radius: float, material: Material) -> tuple[float, float, float]:
    """Return of mean stress and √J₂ to the Drucker-Prager cone, as :func:`nakai_return`."""
    alpha, beta, k = material.alpha, material.beta, material.intercept
    if mean > material.cutoff:
        return material.tip, 0.0, 0.0
    excess = radius + 3.0 * alpha * mean - k
    if excess <= 0.0:
        return mean, radius, 0.0
    bulk = bulk_modulus(material)
    multiplier = excess / (material.shear_modulus + 9.0 * bulk * alpha * beta)
    radius -= material.shear_modulus * multiplier
    mean -= 3.0 * bulk * beta * multiplier
    if mean > material.tip:
        return material.tip, 0.0, 0.0
    if radius < 0.0:
        return material.tip, 0.0, 3.0 * beta * multiplier
    return mean, radius, 3.0 * beta * multiplier


@kernel
def return_mapping(trial: Six, strain: float, material: Material) -> tuple[Six, float, float]:
    """Bring a trial stress back to the yield surface.

    Parameters
    ----------
    trial
        [Pa].
    strain
        Plastic shear strain κ so far [-].
    material
        Constants.

    Returns
    -------
    tuple
        Admissible stress [Pa].
    float
        Increment of κ [-].
    float
        Plastic change of volume [-]; 0 where the soil comes apart, its mean stress beyond the tip.
    """
    xx, yy, zz, xy, xz, yz = trial
    mean = (xx + yy + zz) / 3.0
    xx, yy, zz = xx - mean, yy - mean, zz - mean
    second = 0.5 * (xx * xx + yy * yy + zz * zz) + xy * xy + xz * xz + yz * yz
    third = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
    radius = math.sqrt(second)
    cosine = 1.5 * math.sqrt(3.0) * third / max(second * radius, SMALLEST_CUBE)
    cosine = min(max(cosine, -1.0), 1.0)
    lode = math.acos(cosine) / 3.0
    size = 2.0 / math.sqrt(3.0) * radius
    first, last = size * math.cos(lode), -size * math.cos(math.pi / 3.0 - lode)
    high, low = 2.0 * first + last, -first - 2.0 * last
    sin_phi, sin_psi = softened(strain, material)
    if material.cone or material.nakai:
        if material.cone:
            new_mean, new_radius, swelling = cone_return(mean, radius, material)
        else:
            new_mean, new_radius, swelling = nakai_return(
                mean, radius, cosine, high + low, sin_phi, sin_psi, material
            )
        new_high = high * new_radius / max(radius, SMALLEST)
        new_low = low * new_radius / max(radius, SMALLEST)
    else:
        new_mean, new_high, new_low, swelling = mohr_coulomb_return(
            mean, high, low, sin_phi, sin_psi, material
        )
    # New principal values as a polynomial of the old: slopes over both gaps, and their difference.
    slope_high, slope_low = new_high / max(high, SMALLEST), new_low / max(low, SMALLEST)
    bend = (slope_high - slope_low) / max(high + low, SMALLEST)
    slope = slope_high + bend * last
    even = new_mean - bend * 2.0 / 3.0 * second
    made = (
        even + slope * xx + bend * (xx * xx + xy * xy + xz * xz),
        even + slope * yy + bend * (xy * xy + yy * yy + yz * yz),
        even + slope * zz + bend * (xz * xz + yz * yz + zz * zz),
        slope * xy + bend * (xx * xy + xy * yy + xz * yz),
        slope * xz + bend * (xx * xz + xy * yz + xz * zz),
        slope * yz + bend * (xy * xz + yy * yz + yz * zz),
    )
    slip = (high + low - new_high - new_low) / (2.0 * material.shear_modulus)
    return made, max(slip, 0.0), swelling
