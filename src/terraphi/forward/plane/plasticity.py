"""Stress update of one material point: Jaumann rate, then return to the Drucker-Prager cone.

Stress is (σ_xx, σ_zz, σ_xz, σ_yy) [Pa], tension positive; σ_yy is carried by the ``triaxial``
criterion alone. Each function is scalar and compiled; :mod:`terraphi.experiment.soil` says what
the criteria mean.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from terraphi.experiment.soil import Soil, cone_slope
from terraphi.forward.compiled import kernel

Four = tuple[float, float, float, float]

SMALLEST = 1e-300
"""Keeps a quotient of zeros from being no number."""


class Material(NamedTuple):
    """Constants of the stress update, as the kernels take them."""

    lame_lambda: float
    """λ [Pa]."""
    shear_modulus: float
    """G [Pa]."""
    alpha: float
    """Slope of the yield surface [-]."""
    beta: float
    """Slope of the plastic potential [-]."""
    intercept: float
    """k [Pa]."""
    tension_limit: float
    """Mean measure p (or I1) beyond which a trial state goes to the tip [Pa]; may be inf."""
    triaxial: bool
    """Whether the measures are √J2 and I1 rather than r and ½ tr σ."""


def material_of(soil: Soil) -> Material:
    """Constants of a soil.

    Parameters
    ----------
    soil
        Any soil.

    Returns
    -------
    Material
        The tension limit is the apex k/α where the potential has no slope, because the return
        would then never reach the cone; a ``tension_cutoff`` lowers it for any flow rule.
    """
    alpha = cone_slope(soil.friction_angle_deg, soil.yield_criterion)
    beta = cone_slope(soil.potential_angle_deg, soil.yield_criterion)
    triaxial = soil.yield_criterion == "triaxial"
    apex = soil.cone_intercept / alpha
    limit = apex if beta == 0.0 else math.inf
    if soil.tension_cutoff is not None:
        # The cut-off is on mean stress; I1 is three times that.
        limit = min(apex, (3.0 if triaxial else 1.0) * soil.tension_cutoff)
    return Material(
        soil.lame_lambda, soil.shear_modulus, alpha, beta, soil.cone_intercept, limit, triaxial
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
    """Trial stress after one step of hypoelasticity with the Jaumann rate.

    Parameters
    ----------
    stress
        (σ_xx, σ_zz, σ_xz, σ_yy) [Pa].
    gradient
        Velocity gradient (∂vx/∂x, ∂vx/∂z, ∂vz/∂x, ∂vz/∂z) [1/s].
    time_step
        Δt [s].
    lame_lambda, shear_modulus
        λ, G [Pa].
    turning
        Factor on the spin W: 1, or 0 for stress that does not turn with the soil [-].

    Returns
    -------
    tuple
        Trial stress [Pa], same order: σ + (Wσ - σW) + λ tr(D) 1 + 2 G D.
    """
    sxx, szz, sxz, syy = stress
    dxx = gradient[0] * time_step
    dzz = gradient[3] * time_step
    dxz = 0.5 * (gradient[1] + gradient[2]) * time_step
    spin = 0.5 * turning * (gradient[1] - gradient[2]) * time_step
    volumetric = lame_lambda * (dxx + dzz)
    turn = 2.0 * spin * sxz
    return (
        sxx + turn + volumetric + 2.0 * shear_modulus * dxx,
        szz - turn + volumetric + 2.0 * shear_modulus * dzz,
        sxz + spin * (szz - sxx) + 2.0 * shear_modulus * dxz,
        syy + volumetric,
    )


@kernel
def cone_return(
    radius: float,
    mean: float,
    alpha: float,
    beta: float,
    intercept: float,
    tension_limit: float,
    shear_modulus: float,
    bulk: float,
) -> tuple[float, float]:
    """Return of the stress measures to the cone ``radius + alpha mean = intercept``.

    Parameters
    ----------
    radius, mean
        Trial r and p, or √J2 and I1 [Pa].
    alpha, beta, intercept, tension_limit
        As in :class:`Material`.
    shear_modulus
        G [Pa]: the multiplier Δλ lowers the radius by G Δλ.
    bulk
        Modulus by which Δλ lowers the mean measure per unit β [Pa]: λ + G for p, 9K for I1.

    Returns
    -------
    tuple
        Radius and mean measure after the return [Pa].
    """
    if mean > tension_limit:
        return 0.0, tension_limit
    excess = radius + alpha * mean - intercept
    if excess <= 0.0:
        return radius, mean
    multiplier = excess / (shear_modulus + bulk * alpha * beta)
    shorter = radius - shear_modulus * multiplier
    if shorter < 0.0:
        return 0.0, intercept / alpha
    return shorter, mean - bulk * beta * multiplier


@kernel
def return_mapping(trial: Four, material: Material) -> Four:
    """Bring a trial stress back to the yield surface.

    Parameters
    ----------
    trial
        (σ_xx, σ_zz, σ_xz, σ_yy) [Pa].
    material
        :class:`Material`.

    Returns
    -------
    tuple
        Admissible stress [Pa], same order.
    """
    sxx, szz, sxz, syy = trial
    shear = material.shear_modulus
    if material.triaxial:
        mean = sxx + szz + syy
        third = mean / 3.0
        dxx, dzz, dyy = sxx - third, szz - third, syy - third
        radius = math.sqrt(0.5 * (dxx * dxx + dzz * dzz + dyy * dyy) + sxz * sxz)
        bulk = 9.0 * material.lame_lambda + 6.0 * shear
    else:
        mean = 0.5 * (sxx + szz)
        third = mean
        dxx, dzz, dyy = sxx - mean, szz - mean, 0.0
        radius = math.sqrt(0.5 * (dxx * dxx + dzz * dzz) + sxz * sxz)
        bulk = material.lame_lambda + shear
    new_radius, new_mean = cone_return(
        radius,
        mean,
        material.alpha,
        material.beta,
        material.intercept,
        material.tension_limit,
        shear,
        bulk,
    )
    shrink = new_radius / radius if radius > 0.0 else 0.0
    centre = new_mean / 3.0 if material.triaxial else new_mean
    return (
        centre + shrink * dxx,
        centre + shrink * dzz,
        shrink * sxz,
        centre + shrink * dyy if material.triaxial else 0.0,
    )


class Cone(NamedTuple):
    """Return mapping of all criteria in one formula, on the centre of the stress circle.

    The centre is the mean of the normal stresses that count, :math:`p` or :math:`I_1/3`.
    """

    share: float
    """Part of σ_xx and σ_zz in the centre [-]."""
    share_out: float
    """Part of σ_yy in the centre [-]."""
    out: float
    """1 if σ_yy counts, else 0."""
    slope: float
    """Decrease of the radius allowed per increase of the centre [-]."""
    intercept: float
    """Radius allowed where the centre is 0 [Pa]."""
    per_excess: float
    """Plastic multiplier per radius in excess [1/Pa]."""
    shear_modulus: float
    """Decrease of the radius per multiplier [Pa]."""
    drop: float
    """Decrease of the centre per multiplier [Pa]."""
    apex: float
    """Centre of the tip [Pa]."""
    limit: float
    """Centre beyond which a trial state goes to the tension limit [Pa]."""


def cone_of(material: Material) -> Cone:
    """Constants of a material; measures of mean stress become those of the centre."""
    shear = material.shear_modulus
    if material.triaxial:
        per_centre, share, out = 3.0, 1.0 / 3.0, 1.0
        bulk = 9.0 * material.lame_lambda + 6.0 * shear
    else:
        per_centre, share, out = 1.0, 0.5, 0.0
        bulk = material.lame_lambda + shear
    return Cone(
        share,
        share * out,
        out,
        material.alpha * per_centre,
        material.intercept,
        1.0 / (shear + bulk * material.alpha * material.beta),
        shear,
        bulk * material.beta / per_centre,
        material.intercept / material.alpha / per_centre,
        material.tension_limit / per_centre,
    )


@kernel
def return_to_cone(trial: Four, cone: Cone) -> Four:
    """Bring a trial stress back to the yield surface, without branches.

    Parameters
    ----------
    trial
        (σ_xx, σ_zz, σ_xz, σ_yy) [Pa].
    cone
        :class:`Cone`.

    Returns
    -------
    tuple
        Admissible stress [Pa], as :func:`return_mapping` gives.
    """
    sxx, szz, sxz, syy = trial
    centre = cone.share * (sxx + szz) + cone.share_out * syy
    dxx, dzz, dyy = sxx - centre, szz - centre, cone.out * (syy - centre)
    radius = math.sqrt(0.5 * (dxx * dxx + dzz * dzz + dyy * dyy) + sxz * sxz)
    excess = max(radius + cone.slope * centre - cone.intercept, 0.0)
    multiplier = cone.per_excess * excess
    new_radius = radius - cone.shear_modulus * multiplier
    new_centre = centre - cone.drop * multiplier
    new_centre = cone.apex if new_radius < 0.0 else new_centre
    new_centre = cone.limit if centre > cone.limit else new_centre
    new_radius = 0.0 if centre > cone.limit else max(new_radius, 0.0)
    shrink = new_radius / max(radius, SMALLEST)
    return (
        new_centre + shrink * dxx,
        new_centre + shrink * dzz,
        shrink * sxz,
        cone.out * (new_centre + shrink * dyy),
    )
