r"""Stress update of one material point: Jaumann rate, then return to the yield surface.

Stress is (σ_xx, σ_yy, σ_zz, σ_xy, σ_xz, σ_yz) [Pa], tension positive, with principal stresses
:math:`\sigma_1 \ge \sigma_2 \ge \sigma_3`.

Mohr-Coulomb (``yield_surface = "mohr_coulomb"``, whatever the intermediate stress): six planes

.. math:: f = (1 + \sin\varphi)\,\sigma_i - (1 - \sin\varphi)\,\sigma_j - 2c\cos\varphi \le 0,

each with the potential of the same form in ψ. The return (de Souza Neto, Peric, Owen, 2008,
*Computational Methods for Plasticity*, ch. 8.2) goes along :math:`D\,\partial g` to the face of
(σ₁, σ₃); where that would change the order of the principal stresses, to the edge σ₁ = σ₂
or σ₂ = σ₃, on which two faces flow; beyond the tip, to the tip. In the mean stress m and the
gaps between principal stresses a return is short, for on an edge one gap is zero, the other
follows from m by f = 0, and m falls by 2 K sin ψ times the sum of both multipliers.

Why the faces' own flow, and no radial return, which shrinks the deviatoric stress without turning
it and has the same strength: so φ and ψ mean what they mean in limit analysis, and a point strained
in a plane does step by step what it does in two dimensions, whatever the stress across.

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

Softening: with the plastic shear strain κ = ∫(dε₁ᵖ - dε₃ᵖ) sin φ falls and sin ψ
goes linearly to the critical state, where ψ = 0. Of either sign: soil with ψ < 0 is compacted.

A yield surface is a function from a :class:`Trial` and the mobilised sines to the mean stress and
the gaps after the return, and the plastic change of volume. To add one, write it here, its twin
without branches in ``lanes``, and name it in :data:`SURFACES` and in ``experiment/soil.py``.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from terraphi.experiment.soil import Soil
from terraphi.forward.compiled import kernel

Six = tuple[float, float, float, float, float, float]
Nine = tuple[float, float, float, float, float, float, float, float, float]
Four = tuple[float, float, float, float]

SURFACES = ("mohr_coulomb", "matsuoka_nakai")
"""Names of the yield surfaces, in the order of ``Material.surface``."""
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
    bulk_modulus: float
    """K [Pa]; 0 of soil whose plastic changes of volume leave its mean stress."""
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
    tip: float
    """Mean stress at the tip of the surface, c cot φ [Pa]."""
    per_slip: float
    """1 / (2 G) [1/Pa]."""
    surface: Any
    """Which of :data:`SURFACES`, as a number."""

    @property
    def swells(self) -> bool:
        """Whether yielding changes its volume."""
        return self.sin_dilation != 0.0


class Trial(NamedTuple):
    """A trial stress as the yield surfaces see it, without its directions, in any precision."""

    mean: Any
    """m [Pa]."""
    radius: Any
    """√J₂ [Pa]."""
    cosine: Any
    """cos 3θ, 1 in triaxial extension [-]."""
    high: Any
    """σ₁ - σ₂ [Pa]."""
    low: Any
    """σ₂ - σ₃ [Pa]."""


def material_of(soil: Soil) -> Material:
    """Constants of a soil."""
    phi = math.radians(soil.friction_angle_deg)
    critical = soil.critical_friction_angle_deg
    return Material(
        soil.lame_lambda,
        soil.shear_modulus,
        soil.lame_lambda + 2.0 / 3.0 * soil.shear_modulus,
        math.sin(phi),
        math.sin(math.radians(soil.potential_angle_deg)),
        math.sin(phi if critical is None else math.radians(critical)),
        1.0 / soil.softening_strain if soil.softens else 0.0,
        2.0 * soil.cohesion * math.cos(phi),
        soil.cohesion / math.tan(phi),
        0.5 / soil.shear_modulus,
        SURFACES.index(soil.yield_surface),
    )


def held_mean(material: Material) -> Material:
    """Constants of soil whose plastic changes of volume leave its mean stress: K is 0."""
    held = -2.0 / 3.0 * material.shear_modulus
    return material._replace(lame_lambda=held, bulk_modulus=0.0)


@kernel
def jaumann_predictor(
    stress: Six, strain: Nine, volumetric: Any, material: Material, half: Any
) -> Six:
    """Trial stress after one step of hypoelasticity with the Jaumann rate.

    In the precision of its arguments; both kernels call it.

    Parameters
    ----------
    stress
        [Pa].
    strain
        Velocity gradient times the step, ∂v_a/∂x_b Δt row by row [-].
    volumetric
        Its trace, or the one to take instead: the excess is spread over the diagonal [-].
    material
        Constants.
    half
        ½, which in Python's own precision would be a double.

    Returns
    -------
    tuple
        σ + (Wσ - σW) + λ tr(D) 1 + 2 G D [Pa].
    """
    xx, yy, zz, xy, xz, yz = stress
    dxx, axy, axz, ayx, dyy, ayz, azx, azy, dzz = strain
    shear, bulk = material.shear_modulus, material.bulk_modulus
    wxy, wxz, wyz = half * (axy - ayx), half * (axz - azx), half * (ayz - azy)
    double = shear + shear
    # λ v + 2 G (v - tr)/3 = K v - (K - λ) tr
    even = bulk * volumetric - (bulk - material.lame_lambda) * (dxx + dyy + dzz)
    tx, ty, tz = wxy * xy + wxz * xz, wyz * yz - wxy * xy, wxz * xz + wyz * yz
    return (
        xx + even + double * dxx + (tx + tx),
        yy + even + double * dyy + (ty + ty),
        zz + even + double * dzz - (tz + tz),
        xy + shear * (axy + ayx) + wxy * (yy - xx) + wxz * yz + wyz * xz,
        xz + shear * (axz + azx) + wxz * (zz - xx) + wxy * yz - wyz * xy,
        yz + shear * (ayz + azy) + wyz * (zz - yy) - wxy * xz - wxz * xy,
    )


@kernel
def with_gaps(deviator: Six, even: Any, slope: Any, bend: Any) -> Six:
    """The polynomial ``even`` 1 + ``slope`` s + ``bend`` s² of a deviator s, in its precision."""
    xx, yy, zz, xy, xz, yz = deviator
    return (
        even + slope * xx + bend * (xx * xx + xy * xy + xz * xz),
        even + slope * yy + bend * (xy * xy + yy * yy + yz * yz),
        even + slope * zz + bend * (xz * xz + yz * yz + zz * zz),
        slope * xy + bend * (xx * xy + xy * yy + xz * yz),
        slope * xz + bend * (xx * xz + xy * yz + xz * zz),
        slope * yz + bend * (xy * xz + yy * yz + yz * zz),
    )


@kernel
def softened(strain: Any, material: Material, one: Any) -> tuple[Any, Any]:
    """Mobilised sin φ and sin ψ at a plastic shear strain [-]; ``one`` in its precision."""
    left = one - material.per_softening * strain
    left = left if left > one - one else one - one
    return (
        material.sin_critical + left * (material.sin_friction - material.sin_critical),
        left * material.sin_dilation,
    )


@kernel
def mohr_coulomb(trial: Trial, sin_phi: float, sin_psi: float, material: Material) -> Four:
    """Return to the surface of Mohr and Coulomb.

    Parameters
    ----------
    trial
        Stress.
    sin_phi, sin_psi
        Mobilised [-].
    material
        Constants.

    Returns
    -------
    tuple
        Mean stress and both gaps after the return [Pa], and the plastic change of volume [-], 0
        beyond the tip.
    """
    lame, shear, k = material.lame_lambda, material.shear_modulus, material.strength
    mean, high, low = trial.mean, trial.high, trial.low
    bulk = material.bulk_modulus
    first = mean + (2.0 * high + low) / 3.0
    third = first - high - low
    excess = (1.0 + sin_phi) * first - (1.0 - sin_phi) * third - k
    if excess <= 0.0:
        return mean, high, low, 0.0
    # To the face of (σ₁, σ₃): its multiplier is f over ∂f D ∂g.
    common = 4.0 * lame * sin_phi * sin_psi
    face = common + 4.0 * shear * (1.0 + sin_phi * sin_psi)
    multiplier = excess / face
    new_high = high - 2.0 * shear * (1.0 + sin_psi) * multiplier
    new_low = low - 2.0 * shear * (1.0 - sin_psi) * multiplier
    # A gap that turned negative has changed the order: two faces flow alike, to their edge.
    if new_high < 0.0:  # the edge σ₁ = σ₂
        both = 2.0 * excess - (1.0 + sin_phi) * high
        multiplier = both / (face + common + 2.0 * shear * (1.0 - sin_phi) * (1.0 - sin_psi))
        mean -= 2.0 * bulk * sin_psi * multiplier
        new_high, new_low = 0.0, 3.0 * (k - 2.0 * sin_phi * mean) / (3.0 - sin_phi)
    elif new_low < 0.0:  # the edge σ₂ = σ₃
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
def matsuoka_nakai(trial: Trial, sin_phi: float, sin_psi: float, material: Material) -> Four:
    """Return to the surface of Matsuoka and Nakai, as :func:`mohr_coulomb`."""
    mean, radius, span = trial.mean, trial.radius, trial.high + trial.low
    # With u = 1/x the surface is s² u³ - u - q = 0, whose largest root this is.
    shape = 0.5 * sin_phi * (3.0 - sin_phi * sin_phi) * trial.cosine
    slope = 0.5 * math.sqrt(3.0) * sin_phi / math.cos(math.acos(min(shape, 1.0)) / 3.0)
    excess = radius - slope * (material.tip - mean)
    if excess <= 0.0:
        return mean, trial.high, trial.low, 0.0
    # Along the radius κ grows by the loss of σ₁ - σ₃ over 2 G, and m falls by K sin ψ times that.
    bulk = material.bulk_modulus
    shear = 2.0 * material.shear_modulus * max(radius, SMALLEST) / max(span, SMALLEST)
    slip = excess / (shear + slope * bulk * sin_psi)
    mean -= bulk * sin_psi * slip
    if mean > material.tip:
        return material.tip, 0.0, 0.0, 0.0
    left = (radius - shear * slip) / max(radius, SMALLEST)
    if left < 0.0:
        return material.tip, 0.0, 0.0, sin_psi * slip
    return mean, left * trial.high, left * trial.low, sin_psi * slip


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
    # Invariants J₂ and J₃ of the deviator, the Lode angle θ, and from it the principal values:
    # the first is (2/√3) √J₂ cos θ, the last the same of 60° - θ with a minus.
    second = 0.5 * (xx * xx + yy * yy + zz * zz) + xy * xy + xz * xz + yz * yz
    third = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
    radius = math.sqrt(second)
    cosine = 1.5 * math.sqrt(3.0) * third / max(second * radius, SMALLEST_CUBE)
    cosine = min(max(cosine, -1.0), 1.0)
    lode = math.acos(cosine) / 3.0
    size = 2.0 / math.sqrt(3.0) * radius
    first, last = size * math.cos(lode), -size * math.cos(math.pi / 3.0 - lode)
    high, low = 2.0 * first + last, -first - 2.0 * last
    sin_phi, sin_psi = softened(strain, material, 1.0)
    seen = Trial(mean, radius, cosine, high, low)
    if material.surface == 0:
        found = mohr_coulomb(seen, sin_phi, sin_psi, material)
    else:
        found = matsuoka_nakai(seen, sin_phi, sin_psi, material)
    new_mean, new_high, new_low, swelling = found
    # New principal values as a polynomial of the old: slopes over both gaps, and their difference.
    slope_high, slope_low = new_high / max(high, SMALLEST), new_low / max(low, SMALLEST)
    bend = (slope_high - slope_low) / max(high + low, SMALLEST)
    slope = slope_high + bend * last
    even = new_mean - bend * 2.0 / 3.0 * second
    made = with_gaps((xx, yy, zz, xy, xz, yz), even, slope, bend)
    slip = material.per_slip * (high + low - new_high - new_low)
    return made, max(slip, 0.0), swelling
