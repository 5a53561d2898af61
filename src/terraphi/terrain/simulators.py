r"""What simulators call friction, and which friction angle acts in each: one table.

Each of them bounds shear by pressure in one way or another, so one number brings them together: the
ratio :math:`q = \sqrt{J_2}/p` at yield, with :math:`p = -\tfrac13 \mathrm{tr}\,\sigma`. In plane
strain without dilation the out-of-plane stress at failure is the mean of the other two principal
stresses, so that :math:`\sqrt{J_2}` is the Mohr radius, p the centre of Mohr's circle, and
:math:`q = \sin\varphi`. A cone is round and Mohr-Coulomb is not: a cone that is right in plane
strain is too weak in triaxial compression, where
:math:`q = 6\sin\varphi / (\sqrt3 (3 - \sin\varphi))` would be right, and nobody can have both.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal, get_args

from terraphi.experiment.errors import InputError, nearest
from terraphi.experiment.soil import cone_slope

Match = Literal["plane-strain", "triaxial"]
MATCHES: tuple[Match, ...] = get_args(Match)
DP_TYPES = ("Circumscribed", "MiddleCircumscribed", "Inscribed")
"""Cones that GeoTaichi knows; it takes the second where none is named."""
DEFAULT_DP_TYPE = "MiddleCircumscribed"
LEAST_DEG = 2.0
"""No soil has less [deg]; angles in radians are all below."""


def ratio_of_angle(phi_deg: float, match: Match = "plane-strain") -> float:
    """Ratio q of a cone that is as strong as Mohr-Coulomb soil along one stress path.

    Parameters
    ----------
    phi_deg
        Mohr-Coulomb friction angle [deg].
    match
        Where cone and soil agree: in plane strain without dilation, or in triaxial compression.

    Returns
    -------
    float
        √J2 / p at yield [-].
    """
    if match == "plane-strain":
        return math.sin(math.radians(phi_deg))
    return 3.0 * cone_slope(phi_deg, "triaxial")


def angle_of_ratio(ratio: float, match: Match = "plane-strain") -> float | None:
    """Mohr-Coulomb angle [deg] as strong as a cone on a stress path; ``None`` if none is.

    The inverse of :func:`ratio_of_angle`.
    """
    if match == "plane-strain":
        return math.degrees(math.asin(ratio)) if 0.0 <= ratio <= 1.0 else None
    sine = 3.0 * math.sqrt(3.0) * ratio / (6.0 + math.sqrt(3.0) * ratio)
    return math.degrees(math.asin(sine)) if 0.0 <= sine <= 1.0 else None


def _compression(ratio: float) -> float:
    """Angle of the cone through the compressive meridian [deg]; always below 42.3° for sin φ."""
    angle = angle_of_ratio(ratio, "triaxial")
    return math.nan if angle is None else angle


def _extension(ratio: float) -> float:
    """Angle of the cone through the meridian of extension, q = 6 sin θ/(√3(3 + sin θ)) [deg]."""
    sine = 3.0 * ratio / (2.0 * math.sqrt(3.0) - ratio)
    return math.degrees(math.asin(sine)) if sine <= 1.0 else math.nan


def _inscribed(ratio: float) -> float:
    """Angle of the inscribed cone, q = 3 tan θ/√(9 + 12 tan² θ) [deg]."""
    room = 1.0 - 4.0 * ratio**2 / 3.0
    return math.degrees(math.atan(ratio / math.sqrt(room))) if room > 0.0 else math.nan


def _ratio_of_extension(angle_deg: float) -> float:
    sine = math.sin(math.radians(angle_deg))
    return 6.0 * sine / (math.sqrt(3.0) * (3.0 + sine))


def _ratio_of_inscribed(angle_deg: float) -> float:
    tangent = math.tan(math.radians(angle_deg))
    return 3.0 * tangent / math.sqrt(9.0 + 12.0 * tangent**2)


@dataclass(frozen=True)
class Simulator:
    """One simulator's friction.

    Attributes
    ----------
    name
        As on the command line.
    title
        Name for people.
    parameter
        What it calls its friction.
    unit
        ``deg``, or empty for a number without one.
    meaning
        What the parameter does there.
    formula
        The parameter from φ in plane strain, without dilation or cohesion.
    source
        Where that was read.
    value, ratio
        Parameter from q, not a number where there is none, and q from the parameter.
    most
        Values of the parameter at and above this are none.
    left_alone
        What the simulator asks for besides, and nobody has inferred.
    draws_are
        Where draws of the posterior can go.
    refused
        Why φ cannot be given to it; empty if it can.
    constants
        What an exported module has to name besides.
    """

    name: str
    title: str
    parameter: str
    unit: str
    meaning: str
    formula: str
    source: str
    value: Callable[[float], float]
    ratio: Callable[[float], float]
    most: float
    left_alone: str
    draws_are: str
    refused: str = ""
    constants: Mapping[str, str] = field(default_factory=dict)

    def from_angle(self, phi_deg: float, match: Match = "plane-strain") -> float:
        """The parameter with which this simulator acts as a Mohr-Coulomb angle.

        Parameters
        ----------
        phi_deg
            Mohr-Coulomb friction angle [deg].
        match
            As in :func:`ratio_of_angle`.

        Returns
        -------
        float
            In the simulator's unit.

        Raises
        ------
        InputError
            If the simulator cannot be given φ, or be that strong.
        """
        if self.refused:
            raise InputError(self.refused)
        if self.name == "chrono-scm" and match == "triaxial":
            raise InputError(
                "chrono-scm knows shear on a horizontal plane only, and no triaxial compression: "
                "leave out --match triaxial"
            )
        found = self.value(ratio_of_angle(phi_deg, match))
        if math.isnan(found):
            raise InputError(
                f"{self.title}: its {self.parameter} cannot be as strong as {phi_deg:.1f} deg in "
                f"{match.replace('-', ' ')}; take dpType Circumscribed"
            )
        return found

    def check(self, value: float) -> float:
        """The value; raises InputError if the parameter cannot have it."""
        if self.refused:
            raise InputError(self.refused)
        if not 0.0 < value < self.most:
            raise InputError(
                f"{self.parameter} = {value:g}: in {self.title} it lies between 0 and "
                f"{self.most:g}{' deg' if self.unit else ''}"
            )
        if self.unit and value < LEAST_DEG:
            raise InputError(
                f"{self.parameter} = {value:g}: {self.title} takes degrees, and no soil has below "
                f"{LEAST_DEG:g}; radians?"
            )
        return value

    def words(self, value: float) -> str:
        """A value of the parameter with the digits and the unit that it deserves."""
        return f"{value:.1f} deg" if self.unit else f"{value:.3f}"


_CONE = "√J2 ≤ μ p, stress returned along the deviator"


def _geotaichi(dp_type: str) -> Simulator:
    value, ratio, formula, meaning = {
        "Circumscribed": (
            _compression,
            lambda angle: ratio_of_angle(angle, "triaxial"),
            "sin θ = 3 sin φ / (2√3 + sin φ)",
            "√J2 ≤ 6 sin θ/(√3(3 - sin θ)) p: the cone of triaxial compression",
        ),
        "MiddleCircumscribed": (
            _extension,
            _ratio_of_extension,
            "sin θ = 3 sin φ / (2√3 - sin φ)",
            "√J2 ≤ 6 sin θ/(√3(3 + sin θ)) p: that of triaxial extension",
        ),
        "Inscribed": (
            _inscribed,
            _ratio_of_inscribed,
            "tan θ = sin φ / √(1 - 4 sin² φ / 3)",
            "√J2 ≤ 3 tan θ/√(9 + 12 tan² θ) p: plane strain with associated flow",
        ),
    }[dp_type]
    return Simulator(
        name="geotaichi",
        title=f"GeoTaichi, Drucker-Prager with dpType {dp_type}",
        parameter="Friction",
        unit="deg",
        meaning=meaning,
        formula=formula,
        source="consititutive_model/infinitesimal_strain/DruckerPrager.py (2025)",
        value=value,
        ratio=ratio,
        most=90.0,
        left_alone="YoungModulus, PoissonRatio, Tensile, softening; Dilation and Cohesion are 0",
        draws_are="a simulation each; in a random field, the fifth column of a particle",
        constants={"DP_TYPE": dp_type},
    )


NEWTON = Simulator(
    name="newton",
    title="Newton, SolverImplicitMPM",
    parameter="friction",
    unit="",
    meaning="√J2 ≤ μ p of each particle (mpm:friction)",
    formula="μ = sin φ",
    source="solvers/implicit_mpm/rheology_solver_kernels.py (2026)",
    value=lambda ratio: ratio,
    ratio=lambda value: value,
    most=2.0,
    left_alone="young_modulus, poisson_ratio, damping, yield_pressure, yield_stress, hardening",
    draws_are="a particle each, so that every world has its own",
)
_EVERY = [
    Simulator(
        name="genesis",
        title="Genesis, MPM.Sand",
        parameter="friction_angle",
        unit="deg",
        meaning="√J2 ≤ 6 sin θ/(√3(3 - sin θ)) p: the cone of triaxial compression",
        formula="sin θ = 3 sin φ / (2√3 + sin φ), at most 42.2 deg: more is stronger than any φ",
        source="engine/materials/MPM/sand.py (2025)",
        value=_compression,
        ratio=lambda angle: ratio_of_angle(angle, "triaxial"),
        most=90.0,
        left_alone="E, nu, sampler",
        draws_are="a scene each: the environments of one scene share their materials",
    ),
    NEWTON,
    Simulator(
        **{
            **vars(NEWTON),
            "name": "isaaclab",
            "title": "Isaac Lab on Newton's SolverImplicitMPM",
        }
    ),
    Simulator(
        name="chrono-crm",
        title="Chrono::FSI-SPH, CRM soil",
        parameter="mu_fric_s",
        unit="",
        meaning=f"{_CONE}; mu_fric_2 the same, so that it does not depend on the rate",
        formula="μ = sin φ (its guide says tan φ, which makes 35 deg act as 44.4)",
        source="chrono_fsi/sph/math and physics, mu_I and the elastic stress update (2025)",
        value=lambda ratio: ratio,
        ratio=lambda value: value,
        most=2.0,
        left_alone="Young_modulus, Poisson_ratio, mu_I0, average_diam; cohesion_coeff is 0",
        draws_are="a simulation each: a terrain has one soil",
    ),
    Simulator(
        name="chrono-scm",
        title="Chrono::Vehicle, SCM deformable terrain",
        parameter="Mohr_friction",
        unit="deg",
        meaning="τ ≤ σ tan δ on a horizontal plane, mobilised as 1 - exp(-j/K)",
        formula="tan δ = sin φ",
        source="chrono_vehicle/terrain/SCMTerrain.cpp (2025)",
        value=lambda ratio: math.degrees(math.atan(ratio)),
        ratio=lambda angle: math.tan(math.radians(angle)),
        most=90.0,
        left_alone="elastic_K, damping_R; Mohr_cohesion is 0",
        draws_are="a terrain each; by place through a soil-parameters callback",
    ),
    Simulator(
        name="mujoco",
        title="MuJoCo",
        parameter="friction",
        unit="",
        meaning="sliding of two rigid bodies",
        formula="none",
        source="its documentation, chapter on contact",
        value=lambda _: math.nan,
        ratio=lambda _: math.nan,
        most=0.0,
        left_alone="",
        draws_are="",
        refused="mujoco has no soil: its friction is that of two rigid bodies that slide on "
        "each other, which no friction angle of a soil determines; measure it between foot and "
        "ground, or take a simulator with soil",
    ),
]
SIMULATORS = {one.name: one for one in _EVERY}
NAMES = ("genesis", "newton", "isaaclab", "chrono-crm", "chrono-scm", "geotaichi", "mujoco")
"""All simulators, in the order in which help names them."""


def simulator(name: str, *, dp_type: str | None = None) -> Simulator:
    """Look a simulator up.

    Parameters
    ----------
    name
        One of :data:`NAMES`.
    dp_type
        Cone of GeoTaichi, one of :data:`DP_TYPES`; ``None``: the one that it takes itself.

    Raises
    ------
    InputError
        If there is none of that name, or it has no such cone.
    """
    if name not in NAMES:
        raise InputError(f"unknown simulator '{name}'; {nearest(name, NAMES)}")
    if name != "geotaichi":
        if dp_type is not None:
            raise InputError(f"--dp-type is GeoTaichi's, and {name} has none: leave it out")
        return SIMULATORS[name]
    chosen = dp_type or DEFAULT_DP_TYPE
    if chosen not in DP_TYPES:
        raise InputError(f"unknown dpType '{chosen}'; {nearest(chosen, DP_TYPES)}")
    return _geotaichi(chosen)


def converted(
    value: float, source: str, target: str | None = None, *, dp_type: str | None = None
) -> dict[str, float | str | None]:
    """What a simulator's friction means, and what another would have to be told.

    Parameters
    ----------
    value
        The parameter of ``source``, in its unit.
    source, target
        Names of simulators; no ``target``: the meaning alone.
    dp_type
        As in :func:`simulator`, of whichever is GeoTaichi.

    Returns
    -------
    dict
        ``phi_plane_strain_deg`` and ``phi_triaxial_deg``: the Mohr-Coulomb angles as which it acts
        in plane strain without dilation and in triaxial compression, ``None`` where it is stronger
        than any; ``value`` of the target with its ``parameter``. The target acts alike in plane
        strain; two cones then do so along every path.

    Raises
    ------
    InputError
        If a name or the value is none, or the target cannot be as strong.
    """
    if "geotaichi" not in (source, target):
        simulator(source, dp_type=dp_type)  # refuses a cone that nobody has
    given = simulator(source, dp_type=dp_type if source == "geotaichi" else None)
    ratio = given.ratio(given.check(value))
    plane = angle_of_ratio(ratio)
    # The shear of a plane says nothing of other paths.
    triaxial = None if source == "chrono-scm" else angle_of_ratio(ratio, "triaxial")
    told: dict[str, float | str | None] = {
        "from": source,
        "parameter": given.parameter,
        "given": value,
        "meaning": given.meaning,
        "phi_plane_strain_deg": plane,
        "phi_triaxial_deg": triaxial,
    }
    if target is None:
        return told
    wanted = simulator(target, dp_type=dp_type if target == "geotaichi" else None)
    if wanted.refused:
        raise InputError(wanted.refused)
    found = wanted.value(ratio)
    if math.isnan(found):
        raise InputError(
            f"{wanted.title}: its {wanted.parameter} cannot be as strong as {given.words(value)} "
            f"of {source}"
        )
    return {
        **told, "to": target, "to_parameter": wanted.parameter, "value": found,
        "to_unit": wanted.unit,
    }  # fmt: skip


def converted_in_words(told: Mapping[str, float | str | None]) -> list[str]:
    """What :func:`converted` found, in sentences."""

    def acts(name: str, where: str) -> str:
        found = told[name]
        if found is None:
            return f"In {where} it is stronger than any friction angle."
        return f"In {where} it acts as a friction angle of {found:.1f} deg."

    sentences = [
        f"{told['from']}: {told['parameter']} {told['given']:g} means {told['meaning']}.",
        acts("phi_plane_strain_deg", "plane strain"),
    ]
    if told["from"] != "chrono-scm":
        sentences.append(acts("phi_triaxial_deg", "triaxial compression"))
    if "to" in told:
        unit = f" {told['to_unit']}" if told["to_unit"] else ""
        value = f"{told['value']:.{1 if unit else 3}f}{unit}"
        sentences.append(f"The same in {told['to']}: {told['to_parameter']} {value}.")
    return sentences
