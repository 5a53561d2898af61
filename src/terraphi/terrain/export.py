"""An answer as a simulator's parameters: a Python module, JSON, or a material in USD."""

from __future__ import annotations

import importlib.metadata
import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from terraphi.experiment.arrays import MOST_SEED, FloatArray, count
from terraphi.experiment.documents import DATA
from terraphi.experiment.errors import InputError, nearest
from terraphi.experiment.files import atomic_write
from terraphi.experiment.outputs import SIGNATURE, check_file
from terraphi.experiment.priors import FOOT_FRICTION
from terraphi.forward.rft import stress_scale
from terraphi.inference.answer import Answer
from terraphi.inference.stored import StoredAnswer
from terraphi.laws.foot import LAWS, Foot
from terraphi.laws.wheel import MOBILIZATION
from terraphi.terrain.simulators import MATCHES, Match, Simulator, in_words, simulator
from terraphi.terrain.soils import SoilDistribution, soil

FORMATS = {".py": "python", ".json": "json", ".usda": "usda"}
"""Suffix of a file to what is written into it."""
PARTICLES = 3
"""Particles along the side of a voxel, as in Newton's examples."""
PLATE = Foot(0.05, "disc")
"""Plate whose sinkage gives Bekker's parameters."""
LEG_FRICTION_ABOUT = "that of the library's leg, unless it was inferred; None: unknown"
SINKAGE = 0.02
"""Sinkage of the plate [m], in which the law is linear."""
JANOSI_RANGE = 3.0
"""Factor of Janosi's K about that of law ``wheel`` [-], its logarithm uniform; chosen: a wheel of
80 N on sand has 2 to 3 mm, a published model of one of 130 N uses 0.5 to 0.7 mm
(github.com/melanz/wheel-soil), and vehicles of tens of kPa have 10 to 25 mm (Wong, 2008)."""


def export(
    answer: SoilDistribution | Answer | StoredAnswer | Path | str | float,
    *,
    to: str,
    density: float | str | None = None,
    match: Match = "plane-strain",
    dp_type: str | None = None,
    draws: int = 0,
    seed: int = 0,
    anyway: bool = False,
    out: Path | str | None = None,
) -> dict[str, Any]:
    """Write a simulator's parameters from an answer, a soil or an angle.

    Parameters
    ----------
    answer
        An answer, or what :func:`~terraphi.soil` takes: the folder of ``terraphi invert --out``,
        its ``answer.nc``, the output of ``invert --json``, the name of a soil, or φ as ``"33±2"``.
    density
        Bulk density of a soil that has none of its own [kg/m³], as ``"1600±40"``.
    to
        The simulator: ``genesis``, ``newton``, ``isaaclab``, ``chrono-crm``, ``chrono-scm``,
        ``geotaichi``, ``rft3d`` or ``mujoco``.
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
        A Python module (``.py``), ``.json`` or, of newton and isaaclab, ``.usda`` file.

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
    seed = count("seed", seed, 0, MOST_SEED)
    target = simulator(to, dp_type=dp_type)
    if match not in MATCHES:
        raise InputError(f"unknown stress path '{match}'; {nearest(match, MATCHES)}")
    path = file_for(out, to)
    of_soil = soil(answer, density=density, anyway=anyway)
    phi, (chosen, densities) = of_soil.phi.as_dict(), of_soil.draws(draws, rng=seed)
    values = _summary(lambda angle: target.from_angle(angle, match), phi, chosen)
    parameters = {
        **described(target),
        "caution": of_soil.caution,
        "matched": match,
        "value": values.pop("median"),
        **values,
        "draws_without_equivalent": float(
            np.mean(~np.isfinite(of_soil.phi_values)) if draws else 0
        ),
        "phi_plane_strain_deg": phi,
        "density_kg_m3": of_soil.density,
        "density_assumed": of_soil.density_assumed,
        "density_draws_kg_m3": densities.round(3).tolist(),
        "leg_friction_assumed": of_soil.leg_friction,
        "dilation_deg": 0.0,
        "cohesion_Pa": 0.0,
        "source": {**of_soil.origin, "draws_seed": seed},
    }
    if to == "chrono-scm":
        parameters |= bekker(phi, chosen, of_soil.density, seed=seed)
    if to == "rft3d":
        about = "[N/m³] ξ_n, which all stresses per depth are proportional to"
        scale = _summary(
            lambda a: float(stress_scale(target.from_angle(a), of_soil.density)), phi, chosen
        )
        plane = {**_summary(float, phi, chosen), "about": "[deg] φ in plane strain, of wrench"}
        parameters |= {"XI_N": {**scale, "about": about}, "PHI_PLANE_STRAIN_DEG": plane}
    for name in {"BEKKER_KPHI", "XI_N"} & parameters.keys():  # in proportion to each draw's density
        drawn = np.array(parameters[name]["draws"]) * densities / of_soil.density
        parameters[name]["draws"] = drawn.round(6).tolist()
    write(parameters, path)
    return parameters


def file_for(out: Path | str | None, to: str) -> Path | None:
    """A file to write for a simulator; raises InputError if it cannot be written or read there."""
    if out is None:
        return None
    path = Path(out)
    if path.suffix not in FORMATS:
        raise InputError(f"{path}: name a .py, .json or .usda file")
    if path.suffix == ".usda" and to not in ("newton", "isaaclab"):
        raise InputError(f"{to} reads no materials in USD: name a .py or .json file")
    check_file(path)
    return path


def write(parameters: Mapping[str, Any], path: Path | None) -> None:
    """Write the parameters to a file of :func:`file_for`, if there is one."""
    if path is not None:
        content = text(parameters, FORMATS[path.suffix])
        with atomic_write(path) as temporary:
            temporary.write_text(content, encoding="utf-8")


def described(to: Simulator) -> dict[str, Any]:
    """Entries on a simulator that do not depend on the soil."""
    return {
        "made": f"{SIGNATURE} {importlib.metadata.version('terraphi')}",
        "to": to.name,
        "title": to.title,
        "parameter": to.parameter,
        "unit": to.unit,
        "meaning": to.law.meaning,
        "formula": to.law.formula,
        "dp_type": to.dp_type,
        "draws_go_to": to.draws_go_to,
        "not_inferred": to.not_inferred,
    }


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
        lift = LAWS["rft"].lift(
            PLATE, SINKAGE, math.pi / 2, friction_angle_deg=phi_deg, density=density,
            surface_friction=FOOT_FRICTION.mean,
        )  # fmt: skip
        return float(lift / (np.pi * PLATE.radius**2 * SINKAGE))

    law = "from φ by resistive force theory of a flat plate, p = K z; Bekker_Kc is 0"
    random = np.random.default_rng(seed).uniform(size=draws_deg.size)
    quantiles = np.array([0.5, 0.16, 0.84, 0.025, 0.975, *random])
    shear = (MOBILIZATION * JANOSI_RANGE ** (2.0 * quantiles - 1.0)).round(6).tolist()
    janosi = {"median": shear[0], "ci68": shear[1:3], "ci95": shear[3:5], "draws": shear[5:]}
    return {
        "BEKKER_KPHI": {**_summary(stiffness, phi, draws_deg), "about": f"[N/m^(n+2)] {law}"},
        "BEKKER_N": {**_summary(lambda _: 1.0, phi, draws_deg), "about": f"[-] {law}"},
        "JANOSI_SHEAR": {**janosi, "about": "[m] NOT inferred: of wheels of robots on sand"},
    }


def _summary(
    of: Callable[[float], float], phi: Mapping[str, Any], draws_deg: FloatArray
) -> dict[str, Any]:
    """A function of φ at the median, the ends of the intervals and the draws."""
    ends = {name: [round(of(float(end)), 6) for end in phi[name]] for name in ("ci68", "ci95")}
    draws = [round(of(float(angle)), 6) for angle in draws_deg]
    return {"median": round(of(float(phi["median"])), 6), **ends, "draws": draws}


def text(parameters: Mapping[str, Any], form: str) -> str:
    """Content of a file in a form of :data:`FORMATS`, from a result of :func:`export`."""
    if form == "json":
        return json.dumps(parameters, indent=2, ensure_ascii=False) + "\n"
    if form == "usda":
        return _stage(parameters)
    keys = {parameters["parameter"].upper(): "value", "DRAWS": "draws", "DENSITY": "density_kg_m3"}
    keys |= {"DENSITY_DRAWS": "density_draws_kg_m3", "LEG_FRICTION": "leg_friction_assumed"}
    constants = {name: parameters[key] for name, key in keys.items()}
    if parameters["dp_type"]:
        constants["DP_TYPE"] = parameters["dp_type"]
    for name in filter(str.isupper, parameters):
        constants |= {name: parameters[name]["median"], f"{name}_DRAWS": parameters[name]["draws"]}
    comments = {"DENSITY": assumed(parameters, "  # assumed")}
    lines = "\n".join(f"{n} = {value!r}{comments.get(n, '')}" for n, value in constants.items())
    # Safe between the quotation marks of a docstring.
    about = [repr(line)[1:-1].replace('"', '\\"') for line in _about(parameters).split("\n")]
    # Isaac Lab runs Newton, and has both modules.
    names = dict.fromkeys(["newton"] * (parameters["to"] == "isaaclab") + [parameters["to"]])
    uses = "\n\n".join(_template(f"{name}.txt") for name in names)
    return '"""' + "\n".join(about) + f'"""\n\n{lines}\n\n\n{uses}'


def _template(name: str) -> str:
    """A shipped text: functions that hand the constants to a simulator, or a stage and its bed."""
    return (DATA / "simulators" / name).read_text(encoding="utf-8")


def bed_of(
    box: tuple[float, float], voxel: float, rng: np.random.Generator
) -> tuple[FloatArray, float]:
    """Particles in a box of soil, its surface at z = 0, one at random in each cell [m].

    Their places, shape [particle, 3], and the side of a cell. ``box`` has half its width and its
    depth [m].
    """
    (half, deep), cell = box, voxel / PARTICLES
    counts = [round(size / cell) for size in (2.0 * half, 2.0 * half, deep)]
    grid = np.moveaxis(np.indices(counts), 0, -1).reshape(-1, 3)
    return (grid + rng.random(grid.shape)) * cell - [half, half, deep], cell


def _stage(parameters: Mapping[str, Any]) -> str:
    """USD with a scene and the soil as its material; of tuned soil the bed of particles as well."""
    voxel, bed = parameters.get("voxel_m"), ""
    scene = "" if voxel is None else f"        uniform float newton:mpm:voxelSize = {voxel:g}\n"
    if voxel is not None:
        places, cell = bed_of(parameters["bed_m"], voxel, np.random.default_rng(0))
        points = ", ".join(f"({x:.5g}, {y:.5g}, {z:.5g})" for x, y, z in places.tolist())
        mass = parameters["density_kg_m3"] * cell**3
        bed = _template("bed.usda").format(
            points=points, cell=cell, masses=", ".join([f"{mass:.6g}"] * len(places))
        )
    about = json.dumps(_about(parameters), ensure_ascii=False)
    return _template("stage.usda").format(
        about=about, scene=scene, bed=bed, density=parameters["density_kg_m3"],
        friction=parameters["value"], yield_stress=parameters["cohesion_Pa"],
    )  # fmt: skip


def headline(parameters: Mapping[str, Any]) -> str:
    """The parameter in a sentence."""
    caution = f" CAUTION: {parameters['caution']}" if parameters["caution"] else ""
    phi = parameters["phi_plane_strain_deg"]["median"]
    value = interval_in_words(parameters)
    density = assumed(parameters, f" The density {parameters['density_kg_m3']:g} kg/m³ is assumed.")
    return f"{parameters['title']}: {value}, for φ {phi:.1f} deg in plane strain.{density}{caution}"


def assumed(parameters: Mapping[str, Any], words: str) -> str:
    """Words on the density if it is assumed, else none."""
    return words if parameters["density_assumed"] is not False else ""


def interval_in_words(parameters: Mapping[str, Any]) -> str:
    """The parameter with its interval."""
    value, low, high = (
        in_words(v, parameters["unit"]) for v in (parameters["value"], *parameters["ci95"])
    )
    return f"{parameters['parameter']} {value}, 95 %: {low} to {high}"


def _about(parameters: Mapping[str, Any]) -> str:
    """Docstring of the module."""
    phi, lost = parameters["phi_plane_strain_deg"], parameters["draws_without_equivalent"]
    source, (low, high) = parameters["source"], phi["ci95"]
    matched = {
        "plane-strain": f"Matched in plane strain: {parameters['formula']}.",
        "triaxial": "Matched in triaxial compression: stronger than φ in plane strain.",
    }.get(parameters["matched"], f"Tuned to {parameters['matched']}.")
    lines = [
        f"Soil for {parameters['title']}; {parameters['made']}.\n",
        f"CAUTION: {parameters['caution']}" if parameters["caution"] else "",
        "From {answer}: {record}, law {law}.".format_map(source)
        if "answer" in source
        else "{soil}, {source}.".format_map(source),
        f"φ {phi['median']:.1f} deg in plane strain, 95 %: {low:.1f} to {high:.1f}.",
        f"{interval_in_words(parameters)}; it means: {parameters['meaning']}.",
        matched,
        "Without dilation and cohesion, as the soil of the law.",
        f"DRAWS go with DENSITY_DRAWS: {parameters['draws_go_to']}." if parameters["draws"] else "",
        f"{lost:.1%} of the draws have no equivalent: left out, or at the limit." if lost else "",
        f"DENSITY [kg/m³] was {assumed(parameters, 'assumed') or 'given'}.",
        f"LEG_FRICTION is {parameters.get('leg_friction_about', LEG_FRICTION_ABOUT)}.",
    ]
    for name in filter(str.isupper, parameters):
        median, (low, high) = parameters[name]["median"], parameters[name]["ci95"]
        about = parameters[name]["about"]
        lines.append(f"{name} {median:.3g}, 95 %: {low:.3g} to {high:.3g}, {about}.")
    return "\n".join(filter(None, [*lines, f"Not inferred: {parameters['not_inferred']}.\n"]))
