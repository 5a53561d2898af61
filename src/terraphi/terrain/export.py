"""An answer as a simulator's parameters: a Python module, JSON, or a material in USD."""

from __future__ import annotations

import importlib.metadata
import json
from collections.abc import Callable, Mapping
from numbers import Integral
from pathlib import Path
from typing import Any, cast

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import GUESSED, InputError, nearest
from terraphi.experiment.files import atomic_write
from terraphi.experiment.outputs import SIGNATURE, changed, check_file
from terraphi.experiment.soil import cone_slope
from terraphi.forward.rft import stress_scale, to_plane_strain
from terraphi.inference.answer import Answer, StoredAnswer
from terraphi.laws.foot import LAWS, Foot
from terraphi.terrain.simulators import (
    MATCHES,
    Match,
    Simulator,
    check_dp_type,
    in_words,
    simulator,
)

ANGLES = ("phi_deg", "phi_plane_strain_deg")
EXACT = ("plane_strain", "rft3d")
"""Conventions whose plane-strain angle follows from the angle alone."""
AGREEMENT_DEG = 0.01
"""Rounding of an answer's angles [deg]."""
FORMATS = {".py": "python", ".json": "json", ".usda": "usda"}
"""Suffix of a file to what is written into it."""
MOST_DRAWS = 100_000
"""Draws of an export at most."""
PLATE = Foot(0.05, "disc")
"""Plate whose sinkage gives Bekker's parameters."""
SINKAGE, DOWN = 0.02, 0.5 * np.pi
"""Of the plate [m], in which the law is linear; and its direction of motion [rad]."""
JANOSI = (0.010, 0.025)
"""Janosi's K of sand, from firm to loose [m] (Wong, 2008, Theory of Ground Vehicles)."""


def export(
    answer: Answer | StoredAnswer | Path | str,
    *,
    to: str,
    match: Match = "plane-strain",
    dp_type: str | None = None,
    draws: int = 0,
    seed: int = 0,
    anyway: bool = False,
    out: Path | str | None = None,
) -> dict[str, Any]:
    """Write a simulator's parameters from an answer.

    Parameters
    ----------
    answer
        An answer, the folder of ``terraphi invert --out``, its ``answer.nc``, or the output of
        ``invert --json``.
    to
        The simulator: ``genesis``, ``newton``, ``isaaclab``, ``chrono-crm``, ``chrono-scm``,
        ``geotaichi`` or ``rft3d``.
    match
        Stress path along which it is as strong as the soil: ``plane-strain`` or ``triaxial``.
    dp_type
        Cone of GeoTaichi: ``Circumscribed``, ``MiddleCircumscribed`` (default) or ``Inscribed``.
    draws
        Number of draws of the posterior.
    seed
        Of the choice of draws.
    anyway
        Whether an answer whose verdict is not ``consistent`` is accepted.
    out
        A Python module (``.py``), ``.json`` or, of newton and isaaclab, ``.usda`` file to write.

    Returns
    -------
    dict
        What a ``.json`` file holds: ``parameter``, ``value``, ``ci68``, ``ci95``, ``draws``,
        ``density_kg_m3``, ``caution`` and more.

    Raises
    ------
    InputError
        If the answer has no φ, or none with an equivalent in plane strain; if its verdict is not
        ``consistent``; if it has no draws and some are wanted; if it lacks a key; if an option is
        unknown or the file cannot be written.

    Examples
    --------
    >>> answer = terraphi.invert("li2013:poppy_loose/straight")
    >>> found = terraphi.export(answer, to="genesis", draws=64, out="soil.py")
    >>> found["parameter"], len(found["draws"])
    ('friction_angle', 64)
    """
    target = simulator(to, dp_type=dp_type)
    check_dp_type(dp_type, to)
    if match not in MATCHES:
        raise InputError(f"unknown stress path '{match}'; {nearest(match, MATCHES)}")
    whole = isinstance(cast("object", draws), Integral) and not isinstance(draws, bool)
    if not (whole and 0 <= draws <= MOST_DRAWS):
        raise InputError(f"draws = {draws!r}; 0 to {MOST_DRAWS} are accepted")
    path = None if out is None else Path(out)
    if path is not None:
        if path.suffix not in FORMATS:
            raise InputError(f"{path}: name a .py, .json or .usda file")
        check_file(path)
    found = _parameters(StoredAnswer.of(answer), target, match, draws, seed, anyway=anyway)
    if path is not None:
        content = text(found, FORMATS[path.suffix])
        with atomic_write(path) as temporary:
            temporary.write_text(content, encoding="utf-8")
    return found


def _parameters(
    read: StoredAnswer, to: Simulator, match: Match, draws: int, seed: int, *, anyway: bool
) -> dict[str, Any]:
    """What :func:`export` returns."""
    answer = read.answer
    if None in (answer[name] for name in ANGLES):
        reason = answer.get("phi_plane_strain_reason") or "it was not inferred"
        raise InputError(f"{read.source}: no friction angle in plane strain: {reason}")
    _check(read)
    caution = " ".join(q for q in answer.get("questions", ()) if GUESSED not in q)
    if answer["verdict"] != "consistent":
        caution = f"the verdict is {answer['verdict'].replace('_', ' ')}: {answer['reason']}"
        if not anyway:
            raise InputError(f"{read.source}: {caution} To export it all the same, add --anyway")
    caution = ". ".join(filter(None, [changed(Path(read.source)), caution]))
    chosen, lost = np.empty(0), 0.0
    if draws:
        every = in_plane_strain(read)
        there = every[np.isfinite(every)]
        lost = 1.0 - there.size / every.size
        chosen = np.random.default_rng(seed).choice(there, draws, replace=draws > there.size)
    phi = dict(answer["phi_plane_strain_deg"])
    density, assumed = answer["density_kg_m3"], answer.get("density_assumed", True)
    records = [one["source"] for one in answer.get("records", ())]
    inferred = answer.get("parameters", {}).get("leg.friction")
    friction = inferred["median"] if inferred else answer.get("leg_friction")
    values = _summary(lambda angle: to.from_angle(angle, match), phi, chosen)
    found = {
        "made": f"{SIGNATURE} {importlib.metadata.version('terraphi')}",
        "caution": caution,
        "to": to.name,
        "title": to.title,
        "parameter": to.parameter,
        "unit": to.unit,
        "meaning": to.law.meaning,
        "formula": to.law.formula,
        "dp_type": to.dp_type,
        "matched": match,
        "value": values.pop("median"),
        **values,
        "draws_go_to": to.draws_go_to,
        "draws_without_equivalent": lost,
        "phi_plane_strain_deg": phi,
        "density_kg_m3": float(density),
        "density_assumed": assumed,
        "leg_friction_assumed": friction,
        "dilation_deg": 0.0,
        "cohesion_Pa": 0.0,
        "not_inferred": to.not_inferred,
        "source": {
            "answer": read.source,
            "record": answer.get("source") or ", ".join(records),
            "law": answer["law"],
            "verdict": answer["verdict"],
            "draws_seed": seed,
            "provenance": answer.get("provenance", {}),
        },
    }
    if to.name == "chrono-scm":
        found |= bekker(phi, chosen, float(density), seed=seed)
    if to.name == "rft3d":
        about = "[N/m³] ξ_n, which all stresses per depth are proportional to"
        scale = _summary(lambda a: float(stress_scale(to.from_angle(a), density)), phi, chosen)
        found["XI_N"] = {**scale, "about": about}
    return found


def bekker(
    phi: Mapping[str, Any], draws_deg: FloatArray, density: float, *, seed: int = 0
) -> dict[str, Any]:
    r"""Parameters of SCM: Bekker's :math:`p = K_\varphi z^n` and Janosi's K.

    The pressure under a flat plate is that of three-dimensional resistive force theory, whose angle
    is :math:`\tan\varphi_{rft} = \sin\varphi`. Its stress is proportional to depth, so that n is 1
    and :math:`K_\varphi` does not depend on the plate. K of Janosi is not inferred.

    Parameters
    ----------
    phi
        Median and intervals of φ in plane strain [deg], as in an answer.
    draws_deg
        Draws of it [deg], shape [draw].
    density
        Bulk density [kg/m³].
    seed
        Of the draws of Janosi's K.

    Returns
    -------
    dict
        ``BEKKER_KPHI`` [N/m^(n+2)], ``BEKKER_N`` [-] and ``JANOSI_SHEAR`` [m]: median, intervals,
        draws, and ``about``, which says where they come from.
    """

    def stiffness(phi_deg: float) -> float:
        force = LAWS["rft"].force(
            PLATE, SINKAGE, DOWN, friction_angle_deg=phi_deg, density=density, surface_friction=0.5
        )
        return float(force[1] / (np.pi * PLATE.radius**2 * SINKAGE))

    law = "from φ by resistive force theory of a flat plate, p = K z; Bekker_Kc is 0"
    median, *ends = np.quantile(JANOSI, [0.5, 0.16, 0.84, 0.025, 0.975]).round(6).tolist()
    drawn = np.random.default_rng(seed).uniform(*JANOSI, draws_deg.size).round(6).tolist()
    janosi = {"median": median, "ci68": ends[:2], "ci95": ends[2:], "draws": drawn}
    return {
        "BEKKER_KPHI": {**_summary(stiffness, phi, draws_deg), "about": f"[N/m^(n+2)] {law}"},
        "BEKKER_N": {**_summary(lambda _: 1.0, phi, draws_deg), "about": f"[-] {law}"},
        "JANOSI_SHEAR": {**janosi, "about": "[m] NOT inferred: range for sand (Wong, 2008)"},
    }


def _summary(
    of: Callable[[float], float], phi: Mapping[str, Any], draws_deg: FloatArray
) -> dict[str, Any]:
    """A function of φ at the median, the ends of the intervals and the draws."""
    ends = {name: [round(of(float(end)), 6) for end in phi[name]] for name in ("ci68", "ci95")}
    draws = [round(of(float(one)), 6) for one in draws_deg]
    return {"median": round(of(float(phi["median"])), 6), **ends, "draws": draws}


def _check(read: StoredAnswer) -> None:
    """Refuse medians and intervals that do not belong together, as of an answer edited by hand."""
    angles = (read.answer[name] for name in ANGLES)
    own, given = (np.array([one["median"], *one["ci68"], *one["ci95"]]) for one in angles)
    expected = _to_plane_strain(read, own)
    if read.answer["phi_deg"].get("yield") in EXACT and not np.allclose(
        expected, given, rtol=0.0, atol=AGREEMENT_DEG
    ):
        pair = f"phi_deg {own[0]:.1f} is {expected[0]:.1f} in plane strain"
        raise InputError(f"{read.source}: {pair}, found {given[0]:.1f}; invert again")


def _to_plane_strain(read: StoredAnswer, phi_deg: FloatArray) -> FloatArray:
    """Angles of an answer's convention as in plane strain [deg]; not a number if there is none."""
    convention = read.answer["phi_deg"].get("yield")
    if convention in ("paper", "plane_strain"):
        sine = [cone_slope(phi, convention) for phi in phi_deg]
        return np.asarray(np.degrees(np.arcsin(sine)))
    return to_plane_strain(phi_deg)


def in_plane_strain(read: StoredAnswer) -> FloatArray:
    """Draws of φ as plane-strain angles [deg], shape [draw]; not a number if there is none.

    Raises
    ------
    InputError
        If there are no draws, or the conversion does not reproduce the answer's own medians.
    """
    if not read.draws_deg.size:
        where = "name the folder of 'terraphi invert --out', or its answer.nc"
        raise InputError(f"{read.source}: has no draws of the posterior; {where}")
    median = _to_plane_strain(read, np.array([read.answer["phi_deg"]["median"]]))
    if not abs(median[0] - read.answer["phi_plane_strain_deg"]["median"]) < 1e-6:
        why = f"draws of '{read.answer['phi_deg']['yield']}' cannot be converted to plane strain"
        raise InputError(f"{read.source}: {why}; leave out --draws")
    return _to_plane_strain(read, read.draws_deg)


def text(found: Mapping[str, Any], form: str) -> str:
    """Content of a file in a form of :data:`FORMATS`, from what :func:`export` found.

    Raises
    ------
    InputError
        If the simulator reads no such file.
    """
    if form == "json":
        return json.dumps(found, indent=2, ensure_ascii=False) + "\n"
    if form == "usda":
        if found["to"] not in ("newton", "isaaclab"):
            raise InputError(f"{found['to']} reads no materials in USD: name a .py or .json file")
        return (
            f"#usda 1.0\n(\n    doc = {json.dumps(_about(found), ensure_ascii=False)}\n)\n\n"
            'def Material "Soil" (\n'
            '    prepend apiSchemas = ["PhysicsMaterialAPI", "NewtonMPMMaterialAPI"]\n)\n{\n'
            f"    float physics:density = {found['density_kg_m3']}\n"
            f"    float newton:mpm:internalFriction = {found['value']:.6f}\n}}\n"
        )
    constants = {found["parameter"].upper(): found["value"], "DRAWS": found["draws"]}
    constants |= {"DENSITY": found["density_kg_m3"], "LEG_FRICTION": found["leg_friction_assumed"]}
    if found["dp_type"]:
        constants["DP_TYPE"] = found["dp_type"]
    for name in filter(str.isupper, found):
        constants |= {name: found[name]["median"], f"{name}_DRAWS": found[name]["draws"]}
    lines = "\n".join(f"{name} = {value!r}" for name, value in constants.items())
    return f'"""{_quoted(_about(found))}"""\n\n{lines}\n\n\n{USES[found["to"]]}'


def headline(found: Mapping[str, Any]) -> str:
    """The parameter in a sentence."""
    caution = f" CAUTION: {found['caution']}" if found["caution"] else ""
    phi = found["phi_plane_strain_deg"]["median"]
    return f"{found['title']}: {_value(found)}, for φ {phi:.1f} deg in plane strain.{caution}"


def _value(found: Mapping[str, Any]) -> str:
    value, low, high = (in_words(v, found["unit"]) for v in (found["value"], *found["ci95"]))
    return f"{found['parameter']} {value}, 95 %: {low} to {high}"


def _about(found: Mapping[str, Any]) -> str:
    """Docstring of the module."""
    phi, lost = found["phi_plane_strain_deg"], found["draws_without_equivalent"]
    low, high = phi["ci95"]
    matched = f"Matched in plane strain: {found['formula']}."
    if found["matched"] == "triaxial":
        matched = "Matched in triaxial compression: stronger than φ in plane strain."
    density = "given" if found["density_assumed"] is False else "assumed"
    lines = [
        f"Soil for {found['title']}; {found['made']}.\n",
        f"CAUTION: {found['caution']}" if found["caution"] else "",
        "From {answer}: {record}, law {law}.".format_map(found["source"]),
        f"φ {phi['median']:.1f} deg in plane strain, 95 %: {low:.1f} to {high:.1f}.",
        f"{_value(found)}; it means: {found['meaning']}.",
        matched,
        "Without dilation and cohesion, as the soil was inferred.",
        f"DRAWS are of the posterior: {found['draws_go_to']}." if found["draws"] else "",
        f"{lost:.1%} of the draws have no equivalent in plane strain." if lost else "",
        f"DENSITY [kg/m³] was {density}.",
        "LEG_FRICTION is that of the library's leg, unless it was inferred; None: unknown.",
    ]
    for name in filter(str.isupper, found):
        median, (low, high) = found[name]["median"], found[name]["ci95"]
        about = found[name]["about"]
        lines.append(f"{name} {median:.3g}, 95 %: {low:.3g} to {high:.3g}, {about}.")
    return "\n".join(filter(None, [*lines, f"Not inferred: {found['not_inferred']}.\n"]))


def _quoted(content: str) -> str:
    """A text that is safe between the quotation marks of a docstring."""
    lines = (repr(line)[1:-1].replace('"', '\\"') for line in content.split("\n"))
    return "\n".join(lines)


NEWTON = '''def set_friction(model, value=FRICTION, particles=slice(None)):
    """Before the solver is made: friction of some particles, one number or one for each."""
    friction = model.mpm.friction.numpy()
    friction[particles] = value
    model.mpm.friction.assign(friction)
'''
USES = {
    "genesis": '''def sand(value=FRICTION_ANGLE, **others):
    """The material of a scene; others are E, nu and sampler."""
    import genesis as gs

    return gs.materials.MPM.Sand(friction_angle=value, rho=DENSITY, **others)
''',
    "newton": NEWTON,
    "isaaclab": NEWTON,
    "chrono-crm": '''def fill(properties, value=MU_FRIC_S):
    """Fill SoilProperties (ElasticMaterialProperties in older releases) of ChFsiFluidSystemSPH."""
    properties.density = DENSITY
    properties.mu_fric_s = properties.mu_fric_2 = value
    properties.cohesion_coeff = 0.0
    return properties
''',
    "chrono-scm": '''def set_soil(
    terrain, *, elastic_k, damping_r, value=MOHR_FRICTION, bekker_kphi=BEKKER_KPHI,
    bekker_n=BEKKER_N, janosi=JANOSI_SHEAR,
):
    """Set the soil of an SCMTerrain in SI units; elastic_k is above bekker_kphi."""
    terrain.SetSoilParameters(bekker_kphi, 0.0, bekker_n, 0.0, value, janosi, elastic_k, damping_r)
''',
    "geotaichi": '''def material(young_modulus, poisson_ratio, value=FRICTION, **others):
    """One entry for add_material, with DruckerPrager as the model."""
    elastic = {"YoungModulus": young_modulus, "PoissonRatio": poisson_ratio}
    plastic = {"Friction": value, "dpType": DP_TYPE, "Dilation": 0.0, "Cohesion": 0.0}
    return {"MaterialID": 1, "Density": DENSITY, **elastic, **plastic, **others}
''',
    "rft3d": '''def soil(value=FRICTION_ANGLE_DEG, surface_friction=LEG_FRICTION):
    """Keywords of terraphi.laws.foot.wrench: force and moment on the mesh of a foot."""
    return {
        "friction_angle_deg": value, "density": DENSITY, "surface_friction": surface_friction,
    }
''',
}
"""Functions of the exported module that hand the constants to the simulator."""
