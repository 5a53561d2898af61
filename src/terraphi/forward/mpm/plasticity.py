r"""Stress update of one material point: Jaumann rate, then return to the yield surface.

Stress is (σ_xx, σ_yy, σ_zz, σ_xy, σ_xz, σ_yz) [Pa], tension positive, with principal stresses
:math:`\sigma_1 \ge \sigma_2 \ge \sigma_3`.

Trial stresses enter by their mean m, √J₂, the Lode angle θ (cos 3θ = 1 in extension) and the gaps
between principal stresses, all from

.. math:: \sigma_1 = m + \tfrac{2}{\sqrt 3} \sqrt{J_2} \cos\theta, \quad
          \sigma_3 = m - \tfrac{2}{\sqrt 3} \sqrt{J_2} \cos(60^\circ - \theta), \quad
          \cos 3\theta = \tfrac{3 \sqrt 3}{2} J_3 J_2^{-3/2}. \qquad (1)

Both cosines are one function, cos(⅔ arccos s), of √(½(1 ± cos 3θ)).

Mohr-Coulomb (``yield_surface = "mohr_coulomb"``, whatever the intermediate stress): six planes

.. math:: f = (1 + \sin\varphi)\,\sigma_i - (1 - \sin\varphi)\,\sigma_j - 2c\cos\varphi \le 0,
          \qquad (2)

each with the potential g of the same form in ψ. The return (de Souza Neto, Peric, Owen, 2008,
*Computational Methods for Plasticity*, ch. 8.2) goes along :math:`D\,\partial g` to the face of
(σ₁, σ₃), by the multiplier

.. math:: f / (\partial f \, D \, \partial g), \quad \partial f \, D \, \partial g
          = 4\lambda \sin\varphi \sin\psi + 4 G (1 + \sin\varphi \sin\psi), \qquad (3)

which takes 2 G (1 ± sin ψ) times itself from the gaps; where that would change the order of the
principal stresses, to the edge σ₁ = σ₂ or σ₂ = σ₃, on which two faces flow; beyond the tip, to the
tip. An edge needs only the sum of both multipliers, the sum of both f over

.. math:: \partial f \, D \, \partial g + 4\lambda \sin\varphi \sin\psi
          + 2 G (1 \mp \sin\varphi)(1 \mp \sin\psi), \qquad (4)

for one gap is zero there, m falls by 2 K sin ψ times that sum, and f = 0 gives the other gap,

.. math:: 3\,(2c\cos\varphi - 2 m \sin\varphi) / (3 \mp \sin\varphi), \qquad (5)

with the upper sign on σ₁ = σ₂.

Why the faces' own flow, and no radial return, which shrinks the deviatoric stress without turning
it and has the same strength: so φ and ψ mean what they mean in limit analysis, and a point strained
in a plane does step by step what it does in two dimensions, whatever the stress across.

Matsuoka and Nakai (1974, Proc. JSCE 232, 59), ``yield_surface = "matsuoka_nakai"``:

.. math:: I_1 I_2 / I_3 = (9 - 3 s^2) / (1 - s^2), \quad s = \sin\varphi,

smooth, through Mohr-Coulomb of one angle in triaxial compression and extension and of larger ones
between them. φ is that in plane strain without dilation, where the intermediate deviatoric stress
vanishes. With t the mean stress at the tip the surface is

.. math:: \sqrt{J_2} = x\,(t - m), \quad x^2 + q x^3 = s^2, \quad
          q = (3 - s^2) \cos 3\theta / \sqrt{27}, \qquad (6)

.. math:: x = \tfrac{\sqrt 3}{2} s / \cos(\tfrac{1}{3} \arccos c), \quad
          c = \tfrac{1}{2} s\,(3 - s^2) \cos 3\theta, \qquad (7)

1/x being the largest root of s² u³ - u - q = 0. The return is radial: the deviatoric stress shrinks
without turning, and m falls by K sin ψ times the increment of κ. It is the plainest of smooth flow
rules; tests of sand with three different stresses fit another one (Lade and Duncan, 1975, J.
Geotech. Eng. Div. ASCE 101, 1037). The choice of surface changes φ by 1 to 2° on a
leg: docs, *Three dimensions*.

The new tensor has the old directions. With new principal values a quadratic polynomial of the
old ones, that is a polynomial of the old tensor (Newton's divided differences), so that no
directions need be found, and equal principal stresses do no harm: for a deviator s

.. math:: m' + b\,(s^2 - \tfrac{2}{3} J_2) + (r_1 - b\,|s_3|)\,s, \quad
          b = (r_1 - r_2) / (\sigma_1 - \sigma_3), \qquad (8)

where r are the ratios of new to old gaps, σ₁ - σ₂ first.

Softening: with the plastic shear strain κ = ∫(dε₁ᵖ - dε₃ᵖ) sin φ falls and sin ψ
goes linearly to the critical state, where ψ = 0. Of either sign: soil with ψ < 0 is compacted.

All is written once, without branches, for both kernels. Vectors of numbers cannot branch, and
Python's own numbers would make doubles of single precision: a :class:`Precision` says what one is,
and every other number follows from it, at compile time.

A yield surface is a function from a :class:`Trial` and the mobilised sines to the mean stress and
the gaps after the return, and the plastic change of volume. To add one, write it here as
:func:`mohr_coulomb` is, with its name in :data:`SURFACES` and a line in :func:`return_to_surface`,
and name it in ``experiment/soil.py``.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from terraphi.experiment.soil import Soil
from terraphi.forward.compiled import kernel

Six = tuple[Any, Any, Any, Any, Any, Any]
Nine = tuple[float, float, float, float, float, float, float, float, float]
Four = tuple[Any, Any, Any, Any]

SURFACES = ("mohr_coulomb", "matsuoka_nakai")
"""Names of the yield surfaces."""
SHORT_OF_TIP = 1e-5
"""Distance from the tip at which a mean stress beyond it is put, over the size of the stress [-];
rounding might put it beyond."""


SHARING_ROUNDS = 3
"""Newton steps with which a cell shares its plastic changes of volume."""


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
    surface: tuple[int, ...]
    """As many numbers as :data:`SURFACES` has names before that of the surface. The length is part
    of the type, so that the compiler makes a kernel for each surface: the fast one cannot branch,
    and would compute all."""

    @property
    def swells(self) -> bool:
        """True if yielding changes the soil's volume."""
        return self.sin_dilation != 0.0


class Trial(NamedTuple):
    """A trial stress as the yield surfaces see it, without its directions, in any precision."""

    mean: Any
    """m [Pa]."""
    radius: Any
    """√J₂ [Pa]."""
    cosine: Any
    """cos 3θ, 1 in triaxial extension [-]."""
    first: Any
    """σ₁ [Pa]."""
    high: Any
    """σ₁ - σ₂ [Pa]."""
    low: Any
    """σ₂ - σ₃ [Pa]."""


class Precision(NamedTuple):
    """Numbers in a kernel's precision; Python's own would be doubles in a kernel of singles."""

    unit: Any
    """1 [-]."""
    smallest: Any
    """Keeps quotients of vanishing stresses from being no numbers [Pa]."""
    cosine: Any
    """A function to cos(⅔ arccos s), 0 ≤ s ≤ 1."""


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
        (0,) * SURFACES.index(soil.yield_surface),
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
    # L Δt = D + W: the diagonal is D's, each pair of the others makes a shear and a turn.
    dxx, axy, axz, ayx, dyy, ayz, azx, azy, dzz = strain
    shear, bulk = material.shear_modulus, material.bulk_modulus
    wxy, wxz, wyz = half * (axy - ayx), half * (axz - azx), half * (ayz - azy)
    double = shear + shear
    # λ v + 2 G (v - tr)/3 = K v - (K - λ) tr
    even = bulk * volumetric - (bulk - material.lame_lambda) * (dxx + dyy + dzz)
    # Half of the diagonal of Wσ - σW, whose trace is zero; W is antisymmetric.
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
def may_yield(stress: Six, material: Material, unit: Any) -> Any:
    """1 unless a stress [Pa] lies inside of the yield surface, then 0; in its precision.

    With p = t − m > 0 and the least s = sin φ, stresses inside of equation 6 have
    J₂ p + ½ (3 − s²) J₃ < s² p³. That holds again in triaxial compression far outside, beyond
    √J₂ = 2 √3 p / (3 − s²). The planes of Mohr and Coulomb have the cone √J₂ = √3 s p / √(3 + s²)
    inside.
    """
    zero, three = unit - unit, unit + unit + unit
    half, third = unit / (unit + unit), unit / three
    xx, yy, zz, xy, xz, yz = stress
    mean = third * (xx + yy + zz)
    xx, yy, zz, depth = xx - mean, yy - mean, zz - mean, material.tip - mean
    j2 = half * (xx * xx + yy * yy + zz * zz) + (xy * xy + xz * xz + yz * yz)
    sine = material.sin_friction
    sine = material.sin_critical if material.sin_critical < sine else sine
    square = sine * sine
    is_far = depth < zero
    if len(material.surface) == 0:
        excess = (three + square) * j2 - three * square * depth * depth
    else:
        width, double = three - square, depth + depth
        is_far |= width * width * j2 > three * double * double
        j3 = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
        excess = j2 * depth + half * width * j3 - square * depth * depth * depth
    # An operator on bits and not ``or``, which branches and keeps the loop from being vectorized.
    return unit if (excess > zero) | is_far else zero


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
def softened(strain: Any, material: Material, unit: Any) -> tuple[Any, Any]:
    """Mobilised sin φ and sin ψ at a plastic shear strain [-]; ``unit`` is 1 in its precision."""
    zero = unit - unit
    # From 1 at the peak to 0 in the critical state, along a line.
    peak_share = unit - material.per_softening * strain
    peak_share = peak_share if peak_share > zero else zero
    return (
        material.sin_critical + peak_share * (material.sin_friction - material.sin_critical),
        peak_share * material.sin_dilation,
    )


@kernel
def cosine_of_two_thirds(s: float) -> float:
    """cos(⅔ arccos s), 0 ≤ s ≤ 1."""
    return math.cos(2.0 / 3.0 * math.acos(min(s, 1.0)))


DOUBLE_PRECISION = Precision(1.0, 1e-12, cosine_of_two_thirds)
"""Of a stress by itself, and of the plain kernel that the fast one is tested against."""


@kernel
def mohr_coulomb(
    trial: Trial, sin_phi: Any, sin_psi: Any, material: Material, precision: Precision
) -> Four:
    """Return to the surface of Mohr and Coulomb.

    Parameters
    ----------
    trial
        Stress.
    sin_phi, sin_psi
        Mobilised [-].
    material
        Constants.
    precision
        Of all these.

    Returns
    -------
    tuple
        Mean stress and both gaps after the return [Pa], and the plastic change of volume [-], 0
        beyond the tip.
    """
    unit = precision.unit
    zero, two, three = unit - unit, unit + unit, unit + unit + unit
    mean, high, low = trial.mean, trial.high, trial.low
    plus, minus, gain, loss = unit + sin_phi, unit - sin_phi, unit + sin_psi, unit - sin_psi
    double = two * material.shear_modulus
    # f of the face of (σ₁, σ₃), eq. 2. An elastic state has no excess: what follows leaves it.
    excess = plus * trial.first - minus * (trial.first - high - low) - material.strength
    excess = excess if excess > zero else zero
    # Along D ∂g to it, by the multiplier of eq. 3, which narrows both gaps.
    common = (two + two) * material.lame_lambda * sin_phi * sin_psi
    face = common + double * (plus * gain + minus * loss)
    multiplier = excess / face
    high_face, low_face = high - double * gain * multiplier, low - double * loss * multiplier
    # A gap that turned negative has changed the order: two faces flow, to their edge (eq. 4).
    on_high, on_low = high_face < zero, low_face < zero
    # Both edges are computed: a division more, but none that waits for which one it is.
    both_high = (two * excess - plus * high) / (face + common + double * minus * loss)
    both_low = (two * excess - minus * low) / (face + common + double * plus * gain)
    flow = both_high if on_high else (both_low if on_low else multiplier)
    swelling = two * sin_psi * flow
    new = mean - material.bulk_modulus * swelling
    # On an edge one gap is zero and f = 0 gives the other (eq. 5); on the face both are as above.
    gap = three * (material.strength - two * sin_phi * new)
    gap = gap / (three - sin_phi if on_high else three + sin_phi)
    new_high = zero if on_high else (gap if on_low else high_face)
    new_low = gap if on_high else (zero if on_low else low_face)
    beyond = new > material.tip  # the soil comes apart
    new_high, new_low = zero if beyond else new_high, zero if beyond else new_low
    return material.tip if beyond else new, new_high, new_low, zero if beyond else swelling


@kernel
def matsuoka_nakai(
    trial: Trial, sin_phi: Any, sin_psi: Any, material: Material, precision: Precision
) -> Four:
    """Return to the surface of Matsuoka and Nakai, as :func:`mohr_coulomb`."""
    unit = precision.unit
    zero, two, three = unit - unit, unit + unit, unit + unit + unit
    half, mean, radius = unit / two, trial.mean, trial.radius
    # The slope x, eq. 7; cos(⅓ arccos c) is that of ⅔ of the half angle, of which √(½(1 + c)) is
    # the cosine.
    cosine = half * sin_phi * (three - sin_phi * sin_phi) * trial.cosine
    cosine = precision.cosine(math.sqrt(half * (unit + cosine)))
    slope = half * math.sqrt(three) * sin_phi / cosine
    excess = radius - slope * (material.tip - mean)
    excess = excess if excess > zero else zero
    # A slip takes its share of √J₂, and K sin ψ times itself of m, until both meet eq. 6.
    shear = two * material.shear_modulus / (trial.high + trial.low)
    slip = excess / (shear * radius + slope * material.bulk_modulus * sin_psi)
    swelling, shrink = sin_psi * slip, unit - shear * slip
    new = mean - material.bulk_modulus * swelling
    # No deviatoric stress remains at the tip; beyond it the soil comes apart.
    is_torn = new > material.tip
    beyond = shrink < zero or is_torn
    new, shrink = material.tip if beyond else new, zero if beyond else shrink
    return new, shrink * trial.high, shrink * trial.low, zero if is_torn else swelling


@kernel
def return_to_surface(
    trial: Six, strain: Any, material: Material, precision: Precision
) -> tuple[Six, Any, Any]:
    """Bring a trial stress back to the yield surface.

    Without branches, and in the precision of its arguments; both kernels call it.

    Parameters
    ----------
    trial
        [Pa].
    strain
        Plastic shear strain κ so far [-].
    material
        Constants.
    precision
        Of all these.

    Returns
    -------
    tuple
        Admissible stress [Pa].
    float
        Increment of κ [-].
    float
        Plastic change of volume [-]; 0 where the soil comes apart, its mean stress beyond the tip.
    """
    unit, smallest = precision.unit, precision.smallest
    zero, two, three = unit - unit, unit + unit, unit + unit + unit
    half, third = unit / two, unit / three
    xx, yy, zz, xy, xz, yz = trial
    mean = third * (xx + yy + zz)
    xx, yy, zz = xx - mean, yy - mean, zz - mean
    # Invariants J₂ and J₃ of the deviator, and cos 3θ (eq. 1).
    j2 = half * (xx * xx + yy * yy + zz * zz) + (xy * xy + xz * xz + yz * yz) + smallest * smallest
    j3 = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
    radius = math.sqrt(j2)
    cosine = three * half * math.sqrt(three) * j3 / (j2 * radius)
    cosine = cosine if cosine < unit else unit
    cosine = cosine if cosine > -unit else -unit
    # Gaps between principal values, eq. 1: cos θ is ``up``, cos(60° - θ) is ``down``.
    up = precision.cosine(math.sqrt(half * (unit + cosine)))
    down = precision.cosine(math.sqrt(half * (unit - cosine)))
    size = two * third * math.sqrt(three) * radius
    high, low = size * (two * up - down), size * (two * down - up)
    # Equal principal stresses have no gap: a tiny one keeps the quotients below finite.
    high, low = high if high > smallest else smallest, low if low > smallest else smallest
    sin_phi, sin_psi = softened(strain, material, unit)
    state = Trial(mean, radius, cosine, mean + size * up, high, low)
    if len(material.surface) == 0:
        returned = mohr_coulomb(state, sin_phi, sin_psi, material, precision)
    else:
        returned = matsuoka_nakai(state, sin_phi, sin_psi, material, precision)
    new_mean, new_high, new_low, swelling = returned
    # New principal values as a polynomial of the old, eq. 8.
    slope_high, slope_low = new_high / high, new_low / low
    bend = (slope_high - slope_low) / (high + low)
    slope, even = slope_high - bend * (size * down), new_mean - bend * (two * third) * j2
    stress = with_gaps((xx, yy, zz, xy, xz, yz), even, slope, bend)
    # κ grows by the loss of σ₁ - σ₃ over 2 G.
    slip = material.per_slip * (high * (unit - slope_high) + low * (unit - slope_low))
    return stress, slip if slip > zero else zero, swelling


@kernel
def return_mapping(trial: Six, strain: float, material: Material) -> tuple[Six, float, float]:
    """Bring a trial stress back to the yield surface, as :func:`return_to_surface` in double."""
    return return_to_surface(trial, strain, material, DOUBLE_PRECISION)
