r"""Friction parameters of simulators, and the friction angle that acts in each: one table.

Each of them bounds shear by pressure in one way or another, so one number brings them together: the
ratio :math:`q = \sqrt{J_2}/p` at yield, with :math:`p = -\tfrac13 \mathrm{tr}\,\sigma`. In plane
strain without dilation the out-of-plane stress at failure is the mean of the other two principal
stresses, so that :math:`\sqrt{J_2}` is the Mohr radius, p the centre of Mohr's circle, and
:math:`q = \sin\varphi`. A cone is round and Mohr-Coulomb is not: a cone that is right in plane
strain is too weak in triaxial compression, where
:math:`q = 6\sin\varphi / (\sqrt3 (3 - \sin\varphi))` would be right, and no cone is right in both.

The laws were read in the sources of Genesis (engine/materials/MPM/sand.py, 2025), Newton
(solvers/implicit_mpm/rheology_solver_kernels.py, 2026), Chrono (chrono_fsi/sph and
chrono_vehicle/terrain/SCMTerrain.cpp, 2025) and GeoTaichi (DruckerPrager.py, 2025).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from numbers import Real
from typing import Any, Literal, NamedTuple, cast, get_args

from terraphi.experiment.errors import InputError, nearest

Match = Literal["plane-strain", "triaxial"]
MATCHES: tuple[Match, ...] = get_args(Match)
FOOT_DEG = (14.0, 55.0)
"""Angles of law ``foot`` (:func:`~terraphi.laws.wrench.angles_deg`) [deg]."""
LEAST_DEG = 2.0
"""No soil has less [deg]; an angle in radians is below."""


class Law(NamedTuple):
    """A friction parameter as a function of q."""

    meaning: str
    formula: str
    """The parameter from φ in plane strain, without dilation or cohesion."""
    value: Callable[[float], float]
    """Parameter from q; not a number where no value is that strong."""
    ratio: Callable[[float], float]
    """Q from the parameter."""


ROOT = math.sqrt(3.0)


def _sine(angle_deg: float) -> float:
    return math.sin(math.radians(angle_deg))


def _arcsine(sine: float) -> float:
    return math.degrees(math.asin(sine)) if 0.0 <= sine <= 1.0 else math.nan


RATIO = Law("√J2 ≤ μ p", "μ = sin φ", lambda q: q, lambda mu: mu)
COMPRESSION = Law(
    "√J2 ≤ 6 sin θ/(√3(3 - sin θ)) p: the cone of triaxial compression",
    "sin θ = 3 sin φ / (2√3 + sin φ)",
    lambda q: _arcsine(3.0 * q / (2.0 * ROOT + q)),
    lambda angle: 6.0 * _sine(angle) / (ROOT * (3.0 - _sine(angle))),
)
EXTENSION = Law(
    "√J2 ≤ 6 sin θ/(√3(3 + sin θ)) p: the cone of triaxial extension",
    "sin θ = 3 sin φ / (2√3 - sin φ)",
    lambda q: _arcsine(3.0 * q / (2.0 * ROOT - q)),
    lambda angle: 6.0 * _sine(angle) / (ROOT * (3.0 + _sine(angle))),
)
INSCRIBED = Law(
    "√J2 ≤ 3 tan θ/√(9 + 12 tan² θ) p: plane strain with associated flow",
    "sin θ = sin φ / √(1 - sin² φ / 3)",
    lambda q: _arcsine(q / math.sqrt(max(1.0 - q**2 / 3.0, 1e-12))),
    lambda angle: _sine(angle) / math.sqrt(1.0 + _sine(angle) ** 2 / 3.0),
)
SHEARED_PLANE = Law(
    "τ ≤ σ tan δ on a horizontal plane, mobilised as 1 - exp(-j/K)",
    "tan δ = sin φ",
    lambda q: math.degrees(math.atan(q)),
    lambda angle: math.tan(math.radians(angle)),
)
RESISTIVE = SHEARED_PLANE._replace(
    meaning="√J2 ≤ p tan φ, without dilation: the soil that ξ was fitted to (Agarwal et al., 2023)",
    formula="tan φ_rft = sin φ",
)
PLANE_STRAIN = Law(
    "law foot of terraphi on each foot", "φ itself", _arcsine, _sine,
)  # fmt: skip
CONES = {"Circumscribed": COMPRESSION, "MiddleCircumscribed": EXTENSION, "Inscribed": INSCRIBED}
"""Cones of GeoTaichi, by its ``dpType``."""


def ratio_of_angle(phi_deg: float, match: Match = "plane-strain") -> float:
    """√J2 / p [-] of a cone as strong as Mohr-Coulomb soil of φ [deg] along one stress path.

    The path is plane strain without dilation, or triaxial compression.
    """
    return (
        math.sin(math.radians(phi_deg)) if match == "plane-strain" else COMPRESSION.ratio(phi_deg)
    )


def angle_of_ratio(ratio: float, match: Match = "plane-strain") -> float | None:
    """Inverse of :func:`ratio_of_angle` [deg]; ``None`` for a cone stronger than any angle."""
    angle = _arcsine(ratio) if match == "plane-strain" else COMPRESSION.value(ratio)
    return None if math.isnan(angle) else angle


@dataclass(frozen=True)
class Simulator:
    """One simulator's friction.

    Attributes
    ----------
    name, title
        On the command line, and in text.
    parameter, unit
        What it calls its friction; ``deg``, or empty for a pure number.
    law
        What the parameter does.
    not_inferred
        What else the simulator needs and the forces do not determine.
    draws_go_to
        What can take a draw of the posterior each.
    dp_type
        GeoTaichi's cone.
    """

    name: str
    title: str
    parameter: str
    unit: str
    law: Law
    not_inferred: str
    draws_go_to: str
    dp_type: str | None = None

    def from_angle(self, phi_deg: float, match: Match = "plane-strain") -> float:
        """The parameter, in its unit, that acts as Mohr-Coulomb soil of an angle [deg].

        Raises
        ------
        InputError
            If the simulator cannot be that strong, or has no such stress path.
        """
        if self.name in ("chrono-scm", "rft3d", "mujoco") and match == "triaxial":
            raise InputError(f"{self.name} has no triaxial compression: leave out --match triaxial")
        if self.name == "mujoco" and not FOOT_DEG[0] <= phi_deg <= FOOT_DEG[1]:
            ends = "{:g} to {:g}°".format(*FOOT_DEG)
            raise InputError(f"φ = {phi_deg:.1f}°; law foot has {ends}")
        parameter = self.law.value(ratio_of_angle(phi_deg, match))
        if math.isnan(parameter):
            soil = f"{phi_deg:.1f} deg in {match.replace('-', ' ')}"
            raise InputError(f"{self.title}: cannot be as strong as {soil}; use another dpType")
        return parameter


def in_words(value: float, unit: str) -> str:
    """A parameter with its unit: ``25.2 deg``, or ``0.574``."""
    return f"{value:.1f} {unit}" if unit else f"{value:.3f}"


# fmt: off
GENESIS = COMPRESSION._replace(formula=f"{COMPRESSION.formula}; above 42.2 deg no φ is as strong")
NEWTON = Simulator(
    "newton", "Newton, SolverImplicitMPM", "friction", "",
    RATIO._replace(meaning="√J2 ≤ μ p of each particle (mpm:friction)"),
    "young_modulus, poisson_ratio, damping, yield_pressure, yield_stress, hardening",
    "a particle each, so that every world has its own",
)
CRM = RATIO._replace(
    meaning="√J2 ≤ μ p, radial return; with an equal mu_fric_2 it is independent of rate",
    formula="μ = sin φ (Chrono's guide has tan φ, which makes 35 deg act as 44.4)",
)
_TABLE = (
    Simulator(
        "genesis", "Genesis, MPM.Sand", "friction_angle", "deg", GENESIS, "E, nu, sampler",
        "a scene each: the environments of one scene share their materials",
    ),
    NEWTON,
    replace(NEWTON, name="isaaclab", title="Isaac Lab on Newton's SolverImplicitMPM"),
    Simulator(
        "chrono-crm", "Chrono::FSI-SPH, CRM soil", "mu_fric_s", "", CRM,
        "Young_modulus, Poisson_ratio, mu_I0, average_diam; cohesion_coeff is 0",
        "a simulation each: a terrain has one soil",
    ),
    Simulator(
        "chrono-scm", "Chrono::Vehicle, SCM deformable terrain", "Mohr_friction", "deg",
        SHEARED_PLANE, "elastic_K, damping_R; Mohr_cohesion is 0",
        "a terrain each; by place through a soil-parameters callback",
    ),
    Simulator(
        "geotaichi", "GeoTaichi, Drucker-Prager", "Friction", "deg", EXTENSION,
        "YoungModulus, PoissonRatio, Tensile, softening; Dilation and Cohesion are 0",
        "a simulation each; in a random field, the fifth column of a particle",
    ),
    Simulator(
        "rft3d", "three-dimensional resistive force theory", "friction_angle_deg", "deg",
        RESISTIVE, "the friction of your own foot on the soil, for LEG_FRICTION",
        "a call each",
    ),
    Simulator(
        "mujoco", "MuJoCo, spheres as feet in soil", "friction_angle_deg", "deg", PLANE_STRAIN,
        "the friction of your own foot on the soil, for LEG_FRICTION; damping of the joints",
        "a Soil each",
    ),
)
# fmt: on
SIMULATORS = {entry.name: entry for entry in _TABLE}
NAMES = tuple(SIMULATORS)


def simulator(name: str, *, dp_type: str | None = None) -> Simulator:
    """Look up a simulator.

    Parameters
    ----------
    name
        One of :data:`NAMES`.
    dp_type
        Cone of GeoTaichi, one of :data:`CONES`; by default its own default.

    Raises
    ------
    InputError
        If there is none of that name, or it has no such cone.
    """
    if name not in SIMULATORS:
        raise InputError(f"unknown simulator '{name}'; {nearest(name, NAMES)}")
    entry = SIMULATORS[name]
    if name != "geotaichi":
        if dp_type is not None:
            raise InputError(f"dp_type {dp_type}: only geotaichi has this option; leave it out")
        return entry
    cone = dp_type or "MiddleCircumscribed"
    if cone not in CONES:
        raise InputError(f"unknown dpType '{cone}'; {nearest(cone, CONES)}")
    return replace(entry, title=f"{entry.title} with dpType {cone}", law=CONES[cone], dp_type=cone)


def convert(
    value: float | str,
    *,
    from_: str | None = None,
    to: str | None = None,
    dp_type: str | None = None,
) -> dict[str, Any]:
    """Friction angles that act where a simulator's friction has a value, or the reverse.

    Parameters
    ----------
    value
        The parameter of ``from_``, in its unit. Without ``from_`` a soil, as of
        :func:`~terraphi.soil`: φ in plane strain as ``"33±2"``, a name, or an answer.
    from_, to
        Names of simulators: ``genesis``, ``newton``, ``isaaclab``, ``chrono-crm``,
        ``chrono-scm``, ``geotaichi`` or ``rft3d``.
    dp_type
        Cone of GeoTaichi: ``Circumscribed``, ``MiddleCircumscribed`` (default) or ``Inscribed``.

    Returns
    -------
    dict
        ``phi_plane_strain_deg`` and ``phi_triaxial_deg``: the Mohr-Coulomb angles as which it acts
        in plane strain without dilation and in triaxial compression, ``None`` where it is stronger
        than any; ``value`` of ``to`` with its parameter, equally strong in plane strain. Of a soil,
        what :func:`~terraphi.export` returns.

    Raises
    ------
    InputError
        If a name or the value cannot be used, or ``to`` cannot be as strong.

    Examples
    --------
    >>> found = terraphi.convert(0.68, from_="newton", to="genesis")
    >>> round(found["phi_plane_strain_deg"], 1), round(found["value"], 1)
    (42.8, 29.5)
    >>> round(terraphi.convert("33±2", to="newton")["value"], 3)
    0.545
    """
    if "mujoco" in (from_, to):
        why = "its friction is of two rigid bodies; 'terraphi export SOIL --to mujoco' has soil"
        raise InputError(f"mujoco has no soil: {why}")
    if from_ is None:
        from terraphi.terrain.export import export

        if to is None:
            raise InputError(f"convert {value}: name the simulator that it is from, or to")
        return export(value, to=to, dp_type=dp_type)
    given = simulator(from_, dp_type=dp_type if to != "geotaichi" or from_ == to else None)
    least, most, unit = (LEAST_DEG, 90.0, " degrees, not radians") if given.unit else (0, 2, "")
    real = isinstance(cast("object", value), Real)
    number = float(value) if real else math.nan
    if not least < number < most:
        expected = f"{given.title} expects {least:g} to {most:g}{unit}"
        raise InputError(f"{given.parameter} = {value!r}: {expected}")
    ratio = given.law.ratio(number)
    result: dict[str, Any] = {
        "from": from_,
        "parameter": given.parameter,
        "given": number,
        "meaning": given.law.meaning,
        "phi_plane_strain_deg": angle_of_ratio(ratio),
        # The shear strength of one plane does not determine that of other stress paths.
        "phi_triaxial_deg": None if from_ == "chrono-scm" else angle_of_ratio(ratio, "triaxial"),
    }
    if to is None:
        return result
    target = simulator(to, dp_type=dp_type if to == "geotaichi" else None)
    value_there = target.law.value(ratio)
    if math.isnan(value_there):
        strength = f"{given.parameter} {in_words(number, given.unit)} of {from_}"
        raise InputError(f"{target.title}: cannot be as strong as {strength}")
    result |= {"to": to, "to_parameter": target.parameter, "to_unit": target.unit}
    return result | {"value": value_there}


def converted_in_words(converted: dict[str, Any]) -> list[str]:
    """Result of :func:`convert`, a sentence each."""
    if "from" not in converted:
        from terraphi.terrain.export import headline

        # A friction depends on no density.
        return [
            headline(converted | {"density_assumed": False}),
            f"It means {converted['meaning']}.",
        ]
    sentences = ["{from}: {parameter} {given:g} means {meaning}.".format_map(converted)]
    for name, path in {"plane_strain": "plane strain", "triaxial": "triaxial compression"}.items():
        phi = converted[f"phi_{name}_deg"]
        if phi is not None:
            sentences.append(f"In {path} it acts as a friction angle of {phi:.1f} deg.")
        elif converted["from"] != "chrono-scm":
            sentences.append(f"In {path} it is stronger than any friction angle.")
    if "to" in converted:
        value = in_words(converted["value"], converted["to_unit"])
        sentences.append(f"The same in {converted['to']}: {converted['to_parameter']} {value}.")
    return sentences
