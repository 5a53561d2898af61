"""Element tests: strength and dilation of one material point, under each yield criterion."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from terraphi.experiment.soil import Soil, YieldCriterion, friction_angle_from_plane_strain_deg
from terraphi_studies.verification import element
from terraphi_studies.verification.check import Check, Family, Outcome, Task
from terraphi_studies.verification.element import CONFINEMENT, ELASTIC_COHESION, MAPPINGS, Failure

TOLERANCE = 1e-3
COHESION = 500.0
"""[Pa]."""
PHI_DEG: dict[YieldCriterion, float] = {"plane_strain": 35.0, "paper": 35.0, "triaxial": 30.0}
"""Friction angle of each criterion; a triaxial one of 35° with its dilation acts as 68°."""
DILATIONS = ("0", "10°", "φ")

DAVIS = (
    "Davis (1968), in *Soil Mechanics: Selected Topics*, ed. I. K. Lee, pp. 341–380: "
    "τ/σ_n = sin φ cos ψ / (1 − sin φ sin ψ); without dilation sin φ, associated tan φ"
)
MOHR = "Mohr's circle at failure: (σ1 − σ3)/2 = k − p sin φ, with k = c cos φ and p = ½ tr σ"
EQUIVALENT = (
    "φ and ψ are those of Mohr-Coulomb in plane strain: `paper` has sin φ' = α, sin ψ' = β; "
    "`triaxial` sin φ' = 3α √(1 − 3β²)/(1 − 3αβ), sin ψ' = 3β/√(1 − 3β²), because the plastic "
    "strain across the plane vanishes at failure; α, β = 2 sin/(√3 (3 − sin)) of φ, ψ"
)
COMPRESSION = (
    "Cone through the compressive meridian of Mohr-Coulomb: q/p = 6 sin φ/(3 − sin φ), and the "
    "same of ψ for the plastic strain rates"
)
MATCHED = (
    "Drucker & Prager (1952), *Quart. Appl. Math.* 10, 157; without dilation s_yy = 0. On √J2 "
    "over p = −I1/3: associated 3 tan φ/√(9 + 12 tan² φ), ψ = 0 sin φ"
)
DIENES = "Dienes (1979), *Acta Mech.* 32, 217: simple shear with the Jaumann rate, τ = G sin γ"
STEPS = f"{element.STRAIN_STEPS} strain steps"


def checks(*, quick: bool) -> list[Check]:
    """All element tests.

    Parameters
    ----------
    quick
        Leaves out the flow rules between none and associated, and most friction angles.

    Returns
    -------
    list
        Each obtained value is that of the return mapping that deviates the more.
    """
    found = []
    dilations = (DILATIONS[0], DILATIONS[-1]) if quick else DILATIONS
    for criterion in PHI_DEG:
        for dilation in dilations:
            found += _plane_strain(criterion, dilation)
    for phi in (35.0,) if quick else (25.0, 30.0, 35.0, 40.0, 45.0):
        found += _triaxial_compression(phi)
    for associated in (False, True):
        found += _matched(35.0, associated=associated)
    for criterion in PHI_DEG:
        found += _cohesion(criterion)
    return found + _tip() + _objectivity()


def _plane_strain(criterion: YieldCriterion, dilation: str) -> list[Check]:
    """Simple shear and biaxial compression without cohesion."""
    phi = PHI_DEG[criterion]
    psi = {"0": 0.0, "10°": 10.0, "φ": phi}[dilation]
    soil = Soil(yield_criterion=criterion, friction_angle_deg=phi, dilation_angle_deg=psi)
    strength, dilatancy = equivalent(soil)
    slope = strength * math.sqrt(1.0 - dilatancy**2) / (1.0 - strength * dilatancy)
    common: dict[str, Any] = {
        "case": f"`{criterion}`, φ = {phi:g}°, ψ = {dilation}",
        "note": "" if criterion == "plane_strain" else EQUIVALENT,
    }
    shear = _ends(element.simple_shear, soil)
    compressed = _ends(element.biaxial, soil)
    found = [
        _check(
            "Simple shear under a constant normal stress", "τ/σ_n", slope, DAVIS,
            [end.stress[2] / -end.stress[1] for end in shear], **common,
        ),
        _check(
            "Biaxial compression", "(σ1 − σ3)/(σ1 + σ3)", strength, MOHR,
            [end.radius / -end.mean for end in compressed], **common,
        ),
    ]  # fmt: skip
    if psi > 0.0:
        found.append(
            _check(
                "Dilation in simple shear", "volumetric over shear strain rate", dilatancy,
                "sin ψ = ε̇_v/γ̇_max, the definition of the dilation angle",
                [end.dilatancy for end in shear], **common,
            )
        )  # fmt: skip
    return found


def _triaxial_compression(phi: float) -> list[Check]:
    """Axisymmetric compression, to which the ``triaxial`` criterion is matched."""
    soil = Soil(yield_criterion="triaxial", friction_angle_deg=phi, flow="associated")
    ends = _ends(element.triaxial_compression, soil)
    sine = math.sin(math.radians(phi))
    expected = 6.0 * sine / (3.0 - sine)
    rates = [
        float((e[0] + e[1] + e[3]) / (2.0 / 3.0 * (e[0] - e[1])))
        for e in (end.strain for end in ends)
    ]
    ratios = [float(end.stress[0] - end.stress[1]) / (-end.i1 / 3.0) for end in ends]
    common: dict[str, Any] = {"case": f"`triaxial`, φ = ψ = {phi:g}°"}
    name = "Triaxial compression"
    return [
        _check(name, "q/p", expected, COMPRESSION, ratios, **common),
        _check(name, "ε̇_v/ε̇_q", expected, COMPRESSION, rates, **common),
    ]


def _matched(phi: float, *, associated: bool) -> list[Check]:
    """The cone that is matched to Mohr-Coulomb in plane strain, driven in plane strain."""
    angle = friction_angle_from_plane_strain_deg(phi, "triaxial", associated=associated)
    soil = Soil(
        yield_criterion="triaxial",
        friction_angle_deg=angle,
        flow="associated" if associated else "dilation",
    )
    ends = _ends(element.biaxial, soil)
    tangent = math.tan(math.radians(phi))
    slope = (
        3.0 * tangent / math.sqrt(9.0 + 12.0 * tangent**2)
        if associated
        else math.sin(math.radians(phi))
    )
    flow = "associated" if associated else "ψ = 0"
    common: dict[str, Any] = {"case": f"φ = {phi:g}° in plane strain, {flow}"}
    name = "Drucker-Prager cone matched to plane strain"
    return [
        _check(
            name, "√J2/p", slope, MATCHED, [end.root_j2 / (-end.i1 / 3.0) for end in ends], **common
        ),
        _check(
            name, "(σ1 − σ3)/(σ1 + σ3)", math.sin(math.radians(phi)), MOHR,
            [end.radius / -end.mean for end in ends], **common,
        ),
    ]  # fmt: skip


def _cohesion(criterion: YieldCriterion) -> list[Check]:
    """Biaxial compression of cohesive soil."""
    phi = PHI_DEG[criterion]
    soil = Soil(yield_criterion=criterion, friction_angle_deg=phi, cohesion=COHESION)
    strength, _ = equivalent(soil)
    sine, cosine = math.sin(math.radians(phi)), math.cos(math.radians(phi))
    intercept = 6.0 * COHESION * cosine / (math.sqrt(3.0) * (3.0 - sine))
    if criterion == "plane_strain":
        intercept = COHESION * cosine
    # σ3 = -p - r is what is held, and r = k - p sin φ.
    expected = (intercept + CONFINEMENT * strength) / (1.0 - strength)
    return [
        _check(
            "Cohesive soil in biaxial compression",
            "(σ1 − σ3)/2 [Pa]",
            expected,
            MOHR,
            [end.radius for end in _ends(element.biaxial, soil)],
            case=f"`{criterion}`, φ = {phi:g}°, c = {COHESION:g} Pa, σ3 = {CONFINEMENT:g} Pa",
            note=""
            if criterion == "plane_strain"
            else EQUIVALENT + "; there k = 6 c cos φ/(√3 (3 − sin φ))",
        )
    ]


def _tip() -> list[Check]:
    """Tension: the tip of the cone, and the cut-off before it."""
    found = []
    for cutoff in (None, 100.0):
        soil = Soil(
            yield_criterion="plane_strain",
            friction_angle_deg=35.0,
            cohesion=COHESION,
            tension_cutoff=cutoff,
        )
        tip = COHESION / math.tan(math.radians(35.0))
        ends = [element.extension(soil, mapping) for mapping in MAPPINGS]
        found.append(
            _check(
                "Cohesive soil pulled apart",
                "p [Pa]",
                tip if cutoff is None else cutoff,
                "Tip of the cone c cot φ, or the tension cut-off if that is lower",
                [end.mean for end in ends],
                case=f"`plane_strain`, φ = 35°, c = {COHESION:g} Pa, "
                + ("no cut-off" if cutoff is None else f"cut-off {cutoff:g} Pa"),
            )
        )
    return found


def _objectivity() -> list[Check]:
    """Large simple shear of elastic soil."""
    soil = Soil(yield_criterion="plane_strain", cohesion=ELASTIC_COHESION)
    shear = 1.0
    ends = [element.elastic_shear(soil, mapping, shear) for mapping in MAPPINGS]
    name = "Elastic soil in large simple shear"
    modulus = soil.shear_modulus
    common: dict[str, Any] = {"case": f"γ = {shear:g}", "resolution": "10000 strain steps"}
    return [
        _check(
            name, "τ/G", math.sin(shear), DIENES,
            [float(end.stress[2]) / modulus for end in ends], **common,
        ),
        _check(
            name, "σ_xx/G", 1.0 - math.cos(shear), DIENES + ", σ_xx = −σ_zz = G (1 − cos γ)",
            [float(end.stress[0]) / modulus for end in ends], **common,
        ),
    ]  # fmt: skip


def equivalent(soil: Soil) -> tuple[float, float]:
    """Sines of the Mohr-Coulomb friction and dilation angles that a soil has in plane strain.

    Parameters
    ----------
    soil
        Of any criterion.

    Returns
    -------
    tuple
        sin φ', sin ψ' [-].
    """
    friction = math.sin(math.radians(soil.friction_angle_deg))
    dilation = math.sin(math.radians(soil.potential_angle_deg))
    if soil.yield_criterion == "plane_strain":
        return friction, dilation
    # Written out here, so that they do not rest on what is tested.
    alpha, beta = (2.0 * sine / (math.sqrt(3.0) * (3.0 - sine)) for sine in (friction, dilation))
    if soil.yield_criterion == "paper":
        return alpha, beta
    room = math.sqrt(1.0 - 3.0 * beta**2)
    return 3.0 * alpha * room / (1.0 - 3.0 * alpha * beta), 3.0 * beta / room


def _ends(path: Callable[[Soil, str], Failure], soil: Soil) -> list[Failure]:
    return [path(soil, mapping) for mapping in MAPPINGS]


def _check(
    problem: str,
    quantity: str,
    expected: float,
    source: str,
    obtained: Sequence[float],
    *,
    case: str,
    note: str = "",
    resolution: str = STEPS,
) -> Check:
    """Check of the obtained value that is farther from the expected one."""
    worst = max(obtained, key=lambda value: abs(value - expected))
    return Check(
        problem=problem,
        case=case,
        quantity=quantity,
        expected=expected,
        obtained=float(np.asarray(worst)),
        tolerance=TOLERANCE,
        resolution=resolution,
        source=source,
        note=note,
    )


def element_tests(quick: bool) -> Outcome:
    """The one task of this family."""
    return Outcome(checks(quick=quick))


FAMILY = Family(
    title="Element tests",
    meaning="One material point, driven along a strain path by the predictor and the return "
    "mappings of both kernels (the worse of the two stands in the table). If these pass, a "
    "friction angle means what its yield criterion says, and soil dilates by the angle asked for.",
    tasks=lambda quick: [Task("elements", element_tests, {"quick": quick}, cost=10.0)],
)
