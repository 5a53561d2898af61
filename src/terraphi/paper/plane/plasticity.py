"""Stress update of one material point: Jaumann rate, then return to the Drucker-Prager cone.

Stress is (σ_xx, σ_zz, σ_xz, σ_yy) [Pa], tension positive. The three yield criteria are one cone

    r + α p ≤ k        with the plastic potential r + β p

and differ in its measures and slopes (:mod:`terraphi.experiment.soil` says what φ then means):

    ``paper``, ``plane_strain``   r = Mohr's radius,   p = (σ_xx + σ_zz)/2,         σ_yy not used
    ``triaxial``                  r = √J₂,             p = σ_xx + σ_zz + σ_yy = I₁

Plastic flow along the potential lowers r by G Δλ and p by B β Δλ, with B = λ + G in the plane and
9 K = 9 λ + 6 G for I₁. Back on the cone, r + α p = k, so

    Δλ = (r + α p - k) / (G + B α β).

A return that would pass r = 0 ends at the tip of the cone, p = k/α. With β = 0 the mean stress
never changes, so a trial state beyond the tip would never arrive: it is put at the tip directly.
A tension cut-off does the same at a smaller p, for any flow rule. (Xu & Wang; PHYSICS section 1.)
"""

from __future__ import annotations

import math
from typing import NamedTuple

from terraphi.experiment.soil import Soil, cone_slope
from terraphi.forward.compiled import kernel

Four = tuple[float, float, float, float]

SMALLEST = 1e-300
"""Keeps 0/0 out of the direction of a stress without shear."""


class Material(NamedTuple):
    """Constants of the stress update, for the center c of the stress: p, or I₁/3."""

    lame_lambda: float
    """λ [Pa]."""
    shear_modulus: float
    """G [Pa]."""
    share: float
    """Part of σ_xx and σ_zz in c [-]."""
    out: float
    """1 if σ_yy counts, else 0."""
    slope: float
    """Decrease of the largest r per increase of c [-]."""
    intercept: float
    """k [Pa]."""
    per_excess: float
    """Δλ per r in excess of the cone [1/Pa]."""
    drop: float
    """Decrease of c per Δλ [Pa]."""
    apex: float
    """c at the tip [Pa]."""
    limit: float
    """c beyond which a trial state is put there; may be inf [Pa]."""


def material_of(soil: Soil) -> Material:
    """Constants of a soil."""
    alpha = cone_slope(soil.friction_angle_deg, soil.yield_criterion)
    beta = cone_slope(soil.potential_angle_deg, soil.yield_criterion)
    lam, shear = soil.lame_lambda, soil.shear_modulus
    if soil.yield_criterion == "triaxial":
        share, out, per_center, bulk = 1.0 / 3.0, 1.0, 3.0, 9.0 * lam + 6.0 * shear
    else:
        share, out, per_center, bulk = 0.5, 0.0, 1.0, lam + shear
    apex = soil.cone_intercept / alpha / per_center
    limit = apex if beta == 0.0 else math.inf
    if soil.tension_cutoff is not None:
        limit = min(apex, soil.tension_cutoff)
    return Material(
        lam,
        shear,
        share,
        out,
        alpha * per_center,
        soil.cone_intercept,
        1.0 / (shear + bulk * alpha * beta),
        bulk * beta / per_center,
        apex,
        limit,
    )


@kernel
def jaumann_predictor(
    stress: Four,
    gradient: Four,
    time_step: float,
    lame_lambda: float,
    shear_modulus: float,
    turning: float = 1.0,
) -> Four:
    """Trial stress after one step of hypoelasticity: σ + Δt (Wσ - σW + λ tr(D) 1 + 2 G D).

    Parameters
    ----------
    stress
        (σ_xx, σ_zz, σ_xz, σ_yy) [Pa].
    gradient
        Velocity gradient (∂vx/∂x, ∂vx/∂z, ∂vz/∂x, ∂vz/∂z) [1/s]: D its symmetric part, W the rest.
    time_step
        Δt [s].
    lame_lambda, shear_modulus
        λ, G [Pa].
    turning
        Factor on the spin W: 1, or 0 for the prototype, whose stress does not turn [-].
    """
    sxx, szz, sxz, syy = stress
    # D Δt and W Δt; σ_yy of plane strain changes by the volume alone.
    dxx = gradient[0] * time_step
    dzz = gradient[3] * time_step
    dxz = 0.5 * (gradient[1] + gradient[2]) * time_step
    spin = 0.5 * turning * (gradient[1] - gradient[2]) * time_step
    volumetric = lame_lambda * (dxx + dzz)
    # Wσ - σW of W = [[0, w], [-w, 0]]: (2 w σ_xz, -2 w σ_xz) and w (σ_zz - σ_xx) for σ_xz.
    turn = 2.0 * spin * sxz
    return (
        sxx + turn + volumetric + 2.0 * shear_modulus * dxx,
        szz - turn + volumetric + 2.0 * shear_modulus * dzz,
        sxz + spin * (szz - sxx) + 2.0 * shear_modulus * dxz,
        syy + volumetric,
    )


@kernel
def return_mapping(trial: Four, material: Material) -> Four:
    """Bring a trial stress [Pa] back to the cone; without branches, for whole vector registers."""
    sxx, szz, sxz, syy = trial
    # Center c and radius r of the criterion: Mohr's circle, or I₁/3 and √J₂.
    center = material.share * (sxx + szz) + material.share * material.out * syy
    dxx, dzz, dyy = sxx - center, szz - center, material.out * (syy - center)
    radius = math.sqrt(0.5 * (dxx * dxx + dzz * dzz + dyy * dyy) + sxz * sxz)
    # Along the potential to the cone. Elastic states have no excess, and stay.
    excess = max(radius + material.slope * center - material.intercept, 0.0)
    # Δλ = (r + α p - k) / (G + B α β), r -= G Δλ, p -= B β Δλ.
    multiplier = material.per_excess * excess
    new_radius = radius - material.shear_modulus * multiplier
    new_center = center - material.drop * multiplier
    # Past r = 0: the tip. Too much tension to begin with: the cut-off.
    new_center = material.apex if new_radius < 0.0 else new_center
    new_center = material.limit if center > material.limit else new_center
    new_radius = 0.0 if center > material.limit else max(new_radius, 0.0)
    # The deviator keeps its direction and shrinks with r.
    shrink = new_radius / max(radius, SMALLEST)
    return (
        new_center + shrink * dxx,
        new_center + shrink * dzz,
        shrink * sxz,
        material.out * (new_center + shrink * dyy),
    )
