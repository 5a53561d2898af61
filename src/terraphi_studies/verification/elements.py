"""Element tests: strength and dilation of one material point, under each yield criterion.

A point is driven along a strain path by the predictor and return mapping of either kernel.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.soil import Soil, YieldCriterion, friction_angle_from_plane_strain_deg
from terraphi.forward.plane.plasticity import (
    Four,
    cone_of,
    jaumann_predictor,
    material_of,
    return_mapping,
    return_to_cone,
)
from terraphi_studies.verification.check import Check, Family, Outcome, Task

Update = Callable[[Four, Four, float], Four]
"""From stress [Pa], gradient of the displacement in the plane [-] and strain across it [-]."""

MAPPINGS = ("return_mapping", "return_to_cone")
"""The return mapping of the reference kernel and that of the fast one."""
STRAIN_STEPS = 800
LARGE_STRAIN_STEPS = 10_000
CONFINEMENT = 1000.0
"""Stress that is held along a path [Pa], that of soil six centimetres deep."""
ELASTIC_COHESION = 1e12
"""Cohesion with which soil never yields [Pa]."""
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


# -- a point on its path ---------------------------------------------------------------------------


class Failure(NamedTuple):
    """Where a path ends: the soil flows and its stress changes no more."""

    stress: FloatArray
    """(σ_xx, σ_zz, σ_xz, σ_yy) [Pa]."""
    strain: FloatArray
    """Last increment of (ε_xx, ε_zz, γ_xz, ε_yy) [-], all of it plastic by then."""

    @property
    def mean(self) -> float:
        """In-plane mean stress p, compression negative [Pa]."""
        return float(0.5 * (self.stress[0] + self.stress[1]))

    @property
    def radius(self) -> float:
        """Radius of Mohr's circle in the plane, (σ1 - σ3)/2 [Pa]."""
        return math.hypot(0.5 * (self.stress[0] - self.stress[1]), self.stress[2])

    @property
    def root_j2(self) -> float:
        """√J2 [Pa]."""
        sxx, szz, sxz, syy = self.stress
        third = (sxx + szz + syy) / 3.0
        normal = (sxx - third) ** 2 + (szz - third) ** 2 + (syy - third) ** 2
        return math.sqrt(0.5 * normal + sxz**2)

    @property
    def i1(self) -> float:
        """First invariant, compression negative [Pa]."""
        return float(self.stress[0] + self.stress[1] + self.stress[3])

    @property
    def dilatancy(self) -> float:
        """Volumetric strain rate over the rate of the largest shear strain in the plane [-]."""
        exx, ezz, gxz, _ = self.strain
        return float((exx + ezz) / math.hypot(exx - ezz, gxz))


def update_of(soil: Soil, mapping: str) -> Update:
    """Stress update of a soil by one of :data:`MAPPINGS`.

    The kernels' own predictor and return mapping. Strain across the plane, which they never see,
    adds its elastic part to the trial stress: what the return does with it is theirs.
    """
    material = material_of(soil)
    cone = cone_of(material)
    across = np.array([material.lame_lambda] * 2 + [0.0, material.lame_lambda])
    across[3] += 2.0 * material.shear_modulus

    def update(stress: Four, gradient: Four, strain_yy: float) -> Four:
        trial = jaumann_predictor(
            stress, gradient, 1.0, material.lame_lambda, material.shear_modulus
        )
        sxx, szz, sxz, syy = (np.array(trial) + across * strain_yy).tolist()
        if mapping == "return_mapping":
            return return_mapping((sxx, szz, sxz, syy), material)
        return return_to_cone((sxx, szz, sxz, syy), cone)

    return update


def held(guess: float, wanted: float, component: Callable[[float], float]) -> float:
    """Strain at which a stress component has the wanted value, by secants."""
    before, here = 0.0, guess
    low, high = component(before) - wanted, component(here) - wanted
    for _ in range(60):
        if high == low or abs(high) <= 1e-12 * abs(wanted):
            break
        before, here, low = here, here - high * (here - before) / (high - low), high
        high = component(here) - wanted
    return here


def simple_shear(soil: Soil, mapping: str) -> Failure:
    """Shear by γ_xz without strain along x, under a constant σ_zz."""
    update, shear = update_of(soil, mapping), _strain_step(soil)
    stress = (-CONFINEMENT, -CONFINEMENT, 0.0, -CONFINEMENT)
    rise = 0.1 * shear
    for _ in range(STRAIN_STEPS):

        def pressed(ezz: float, now: Four = stress) -> float:
            return update(now, (0.0, shear, 0.0, ezz), 0.0)[1]

        rise = held(rise or shear, -CONFINEMENT, pressed)
        stress = update(stress, (0.0, shear, 0.0, rise), 0.0)
    return Failure(np.array(stress), np.array([0.0, rise, shear, 0.0]))


def compression(soil: Soil, mapping: str, across: float = 0.0) -> Failure:
    """Compression along z under a constant σ_xx.

    Strain across the plane is ``across`` times that along x: 0 is biaxial compression, 1 triaxial,
    for the ``triaxial`` criterion.
    """
    update, step = update_of(soil, mapping), -_strain_step(soil)
    stress = (-CONFINEMENT, -CONFINEMENT, 0.0, -CONFINEMENT)
    wide = -0.3 * step
    for _ in range(STRAIN_STEPS):

        def pressed(exx: float, now: Four = stress) -> float:
            return update(now, (exx, 0.0, 0.0, step), across * exx)[0]

        wide = held(wide, -CONFINEMENT, pressed)
        stress = update(stress, (wide, 0.0, 0.0, step), across * wide)
    return Failure(np.array(stress), np.array([wide, step, 0.0, across * wide]))


def extension(soil: Soil, mapping: str) -> Failure:
    """Equal extension along x and z, far beyond what any soil bears."""
    update, step = update_of(soil, mapping), _strain_step(soil)
    stress = (0.0, 0.0, 0.0, 0.0)
    for _ in range(STRAIN_STEPS):
        stress = update(stress, (step, 0.0, 0.0, step), 0.0)
    return Failure(np.array(stress), np.array([step, step, 0.0, 0.0]))


def elastic_shear(soil: Soil, mapping: str) -> Failure:
    """Simple shear by γ = 1 from zero stress at constant volume, v_x = γ̇ z."""
    update, step = update_of(soil, mapping), 1.0 / LARGE_STRAIN_STEPS
    stress = (0.0, 0.0, 0.0, 0.0)
    for _ in range(LARGE_STRAIN_STEPS):
        stress = update(stress, (0.0, step, 0.0, 0.0), 0.0)
    return Failure(np.array(stress), np.array([0.0, 0.0, step, 0.0]))


def _strain_step(soil: Soil) -> float:
    """Increment: some dozens reach failure, the other hundreds flow until all is steady [-]."""
    return 0.05 * (CONFINEMENT + soil.cohesion) / soil.shear_modulus


# -- the tests -------------------------------------------------------------------------------------


def _compare(
    path: Callable[[Soil, str], Failure],
    soil: Soil,
    *known: tuple[str, str, float, str, Callable[[Failure], float]],
    case: str,
    note: str = "",
    resolution: str = f"{STRAIN_STEPS} strain steps",
) -> list[Check]:
    """Drive a soil along a path with both mappings, and check the one that deviates the more.

    Each of ``known`` is a problem, a quantity, its exact value, where that comes from, and how it
    is read off where the path ends.
    """
    ends = [path(soil, mapping) for mapping in MAPPINGS]
    return [
        Check(
            problem=problem,
            case=case,
            quantity=quantity,
            expected=expected,
            obtained=float(max(map(read, ends), key=lambda value: abs(value - expected))),
            tolerance=TOLERANCE,
            resolution=resolution,
            source=source,
            note=note,
        )
        for problem, quantity, expected, source, read in known
    ]


def element_tests(quick: bool) -> Outcome:
    """All element tests; quick ones leave out flow rules in between, and most friction angles."""
    found = []
    for criterion in PHI_DEG:
        for dilation in (DILATIONS[0], DILATIONS[-1]) if quick else DILATIONS:
            found += _plane_strain(criterion, dilation)
    for phi in (35.0,) if quick else (25.0, 30.0, 35.0, 40.0, 45.0):
        found += _triaxial_compression(phi)
    for associated in (False, True):
        found += _matched(35.0, associated=associated)
    for criterion in PHI_DEG:
        found += _cohesion(criterion)
    return Outcome(found + _tip() + _objectivity())


def _plane_strain(criterion: YieldCriterion, dilation: str) -> list[Check]:
    """Simple shear and biaxial compression without cohesion."""
    phi = PHI_DEG[criterion]
    psi = {"0": 0.0, "10°": 10.0, "φ": phi}[dilation]
    soil = Soil(yield_criterion=criterion, friction_angle_deg=phi, dilation_angle_deg=psi)
    strength, dilatancy = equivalent(soil)
    slope = strength * math.sqrt(1.0 - dilatancy**2) / (1.0 - strength * dilatancy)
    compare = partial(
        _compare,
        case=f"`{criterion}`, φ = {phi:g}°, ψ = {dilation}",
        note="" if criterion == "plane_strain" else EQUIVALENT,
    )
    sheared = compare(
        simple_shear,
        soil,
        ("Simple shear under a constant normal stress", "τ/σ_n", slope, DAVIS,
         lambda end: end.stress[2] / -end.stress[1]),
        ("Dilation in simple shear", "volumetric over shear strain rate", dilatancy,
         "sin ψ = ε̇_v/γ̇_max, the definition of the dilation angle", lambda end: end.dilatancy),
    )  # fmt: skip
    (pressed,) = compare(
        compression,
        soil,
        ("Biaxial compression", "(σ1 − σ3)/(σ1 + σ3)", strength, MOHR,
         lambda end: end.radius / -end.mean),
    )  # fmt: skip
    return [sheared[0], pressed, *(sheared[1:] if psi > 0.0 else ())]


def _triaxial_compression(phi: float) -> list[Check]:
    """Axisymmetric compression, to which the ``triaxial`` criterion is matched."""
    sine = math.sin(math.radians(phi))
    expected = 6.0 * sine / (3.0 - sine)

    def stresses(end: Failure) -> float:
        return float(end.stress[0] - end.stress[1]) / (-end.i1 / 3.0)

    def rates(end: Failure) -> float:
        exx, ezz, _, eyy = end.strain
        return float((exx + ezz + eyy) / (2.0 / 3.0 * (exx - ezz)))

    return _compare(
        partial(compression, across=1.0),
        Soil(yield_criterion="triaxial", friction_angle_deg=phi, flow="associated"),
        ("Triaxial compression", "q/p", expected, COMPRESSION, stresses),
        ("Triaxial compression", "ε̇_v/ε̇_q", expected, COMPRESSION, rates),
        case=f"`triaxial`, φ = ψ = {phi:g}°",
    )


def _matched(phi: float, *, associated: bool) -> list[Check]:
    """The cone that is matched to Mohr-Coulomb in plane strain, driven in plane strain."""
    angle = friction_angle_from_plane_strain_deg(phi, "triaxial", associated=associated)
    sine, tangent = math.sin(math.radians(phi)), math.tan(math.radians(phi))
    slope = 3.0 * tangent / math.sqrt(9.0 + 12.0 * tangent**2) if associated else sine
    name = "Drucker-Prager cone matched to plane strain"
    return _compare(
        compression,
        Soil(
            yield_criterion="triaxial",
            friction_angle_deg=angle,
            flow="associated" if associated else "dilation",
        ),
        (name, "√J2/p", slope, MATCHED, lambda end: end.root_j2 / (-end.i1 / 3.0)),
        (name, "(σ1 − σ3)/(σ1 + σ3)", sine, MOHR, lambda end: end.radius / -end.mean),
        case=f"φ = {phi:g}° in plane strain, {'associated' if associated else 'ψ = 0'}",
    )


def _cohesion(criterion: YieldCriterion) -> list[Check]:
    """Biaxial compression of cohesive soil."""
    phi = PHI_DEG[criterion]
    soil = Soil(yield_criterion=criterion, friction_angle_deg=phi, cohesion=COHESION)
    strength, _ = equivalent(soil)
    sine, cosine = math.sin(math.radians(phi)), math.cos(math.radians(phi))
    intercept, note = COHESION * cosine, ""
    if criterion != "plane_strain":
        intercept = 6.0 * COHESION * cosine / (math.sqrt(3.0) * (3.0 - sine))
        note = EQUIVALENT + "; there k = 6 c cos φ/(√3 (3 − sin φ))"
    # σ3 = -p - r is what is held, and r = k - p sin φ.
    expected = (intercept + CONFINEMENT * strength) / (1.0 - strength)
    name = "Cohesive soil in biaxial compression"
    return _compare(
        compression,
        soil,
        (name, "(σ1 − σ3)/2 [Pa]", expected, MOHR, lambda end: end.radius),
        case=f"`{criterion}`, φ = {phi:g}°, c = {COHESION:g} Pa, σ3 = {CONFINEMENT:g} Pa",
        note=note,
    )


def _tip() -> list[Check]:
    """Tension: the tip of the cone, and the cut-off before it."""
    found = []
    source = "Tip of the cone c cot φ, or the tension cut-off if that is lower"
    for cutoff in (None, 100.0):
        soil = Soil(
            yield_criterion="plane_strain",
            friction_angle_deg=35.0,
            cohesion=COHESION,
            tension_cutoff=cutoff,
        )
        tip = COHESION / math.tan(math.radians(35.0)) if cutoff is None else cutoff
        found += _compare(
            extension,
            soil,
            ("Cohesive soil pulled apart", "p [Pa]", tip, source, lambda end: end.mean),
            case=f"`plane_strain`, φ = 35°, c = {COHESION:g} Pa, "
            + ("no cut-off" if cutoff is None else f"cut-off {cutoff:g} Pa"),
        )
    return found


def _objectivity() -> list[Check]:
    """Large simple shear of elastic soil."""
    soil = Soil(yield_criterion="plane_strain", cohesion=ELASTIC_COHESION)
    modulus, name = soil.shear_modulus, "Elastic soil in large simple shear"
    return _compare(
        elastic_shear,
        soil,
        (name, "τ/G", math.sin(1.0), DIENES, lambda end: float(end.stress[2]) / modulus),
        (name, "σ_xx/G", 1.0 - math.cos(1.0), DIENES + ", σ_xx = −σ_zz = G (1 − cos γ)",
         lambda end: float(end.stress[0]) / modulus),
        case="γ = 1",
        resolution=f"{LARGE_STRAIN_STEPS} strain steps",
    )  # fmt: skip


def equivalent(soil: Soil) -> tuple[float, float]:
    """Sines of the Mohr-Coulomb friction and dilation angles that a soil has in plane strain."""
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


FAMILY = Family(
    title="Element tests",
    meaning="One material point, driven along a strain path by the predictor and the return "
    "mappings of both kernels (the worse of the two stands in the table). If these pass, a "
    "friction angle means what its yield criterion says, and soil dilates by the angle asked for.",
    quick=[Task("elements", element_tests, {"quick": True}, cost=10.0)],
    full=[Task("elements", element_tests, {"quick": False}, cost=10.0)],
)
