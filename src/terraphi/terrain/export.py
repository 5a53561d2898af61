"""An answer as a simulator's parameters: a Python module, JSON, or a material in USD."""

from __future__ import annotations

import importlib.metadata
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError
from terraphi.experiment.outputs import SIGNATURE
from terraphi.experiment.soil import plane_strain_friction_angle_deg
from terraphi.inference.answer_file import Told
from terraphi.terrain.simulators import Match, Simulator

FORMATS = {".py": "python", ".json": "json", ".usda": "usda"}
"""Suffix of a file to what is written into it."""
ENOUGH = 1000
"""Draws that intervals of a bevameter rest on."""
AGREE_DEG = 1e-6
"""How closely a conversion has to give the answer's own numbers again [deg]."""


@dataclass(frozen=True)
class Export:
    """A simulator's parameters from an answer.

    Attributes
    ----------
    to
        The simulator.
    match
        Along which stress path it is as strong as the soil.
    phi_deg
        Median and equal-tailed intervals of φ in plane strain [deg], as in an answer.
    draws_deg
        Draws of it [deg], shape [draw].
    left_out
        Share of the draws that have no equivalent in plane strain [-].
    density, assumed
        Bulk density [kg/m³], and whether it was assumed; ``None`` if it was inferred.
    leg_friction
        Friction of the leg that the library took [-]; ``None`` where it is not known.
    caution
        Why the answer should not be used, or what it asks though it may be; empty if nothing.
    source
        Where the answer comes from; JSON-able.
    extra
        Constants besides, by name, with what they are: those of a virtual bevameter.
    """

    to: Simulator
    match: Match
    phi_deg: Mapping[str, Any]
    draws_deg: FloatArray
    left_out: float
    density: float
    assumed: bool | None
    leg_friction: float | None
    caution: str
    source: Mapping[str, Any]
    extra: Mapping[str, Any] = field(default_factory=dict)

    @property
    def value(self) -> float:
        """The parameter at the median of φ, in the simulator's unit."""
        return self.to.from_angle(float(self.phi_deg["median"]), self.match)

    @property
    def draws(self) -> list[float]:
        """The parameter at each draw."""
        return [round(self.to.from_angle(float(phi), self.match), 6) for phi in self.draws_deg]

    def as_dict(self) -> dict[str, Any]:
        """All of it, as ``--out FILE.json`` has it."""
        return {
            "made": f"{SIGNATURE} {importlib.metadata.version('terraphi')}",
            "caution": self.caution,
            "to": self.to.name,
            "title": self.to.title,
            "parameter": self.to.parameter,
            "unit": self.to.unit,
            "meaning": self.to.meaning,
            "formula": self.to.formula,
            "matched": self.match,
            "value": round(self.value, 6),
            "ci68": self._between("ci68"),
            "ci95": self._between("ci95"),
            "draws": self.draws,
            "draws_go_to": self.to.draws_are,
            "draws_without_equivalent": self.left_out,
            "phi_plane_strain_deg": dict(self.phi_deg),
            "density_kg_m3": self.density,
            "density_assumed": self.assumed,
            "leg_friction_assumed": self.leg_friction,
            "dilation_deg": 0.0,
            "cohesion_Pa": 0.0,
            "not_inferred": self.to.left_alone,
            **self.extra,
            "source": dict(self.source),
        }

    def _between(self, name: str) -> list[float]:
        return [round(self.to.from_angle(float(phi), self.match), 6) for phi in self.phi_deg[name]]

    def text(self, form: str) -> str:
        """The file's content.

        Parameters
        ----------
        form
            ``python``, ``json`` or ``usda``.

        Raises
        ------
        InputError
            If the simulator reads no such file.
        """
        if form == "json":
            return json.dumps(self.as_dict(), indent=2, ensure_ascii=False) + "\n"
        if form == "usda":
            return self._usda()
        constants: dict[str, Any] = {
            self.to.parameter.upper(): round(self.value, 6),
            "DRAWS": self.draws,
        }
        constants |= {"DENSITY": self.density, "LEG_FRICTION": self.leg_friction}
        constants |= self.to.constants
        lines = [f"{name} = {value!r}" for name, value in constants.items()]
        for name, one in self.extra.items():
            lines += [f"{name} = {one['median']!r}"]
            lines += [f"{name}_DRAWS = {one['draws']!r}"] if one["draws"] else []
        return (
            f'"""{_quoted(self._about())}"""\n\n' + "\n".join(lines) + "\n\n\n" + USES[self.to.name]
        )

    def headline(self) -> str:
        """The parameter in a sentence."""
        ends = " to ".join(map(self.to.words, self._between("ci95")))
        caution = f" CAUTION: {self.caution}" if self.caution else ""
        return (
            f"{self.to.title}: {self.to.parameter} {self.to.words(self.value)}, 95 %: {ends}, for "
            f"φ {self.phi_deg['median']:.1f} deg in plane strain.{caution}"
        )

    def _about(self) -> str:
        """What the module says of itself."""
        low, high = self.phi_deg["ci95"]
        ends = " to ".join(map(self.to.words, self._between("ci95")))
        to, version = self.to, importlib.metadata.version("terraphi")
        matched = f"Matched in plane strain: {to.formula}."
        if self.match == "triaxial":
            matched = "Matched in triaxial compression: stronger than φ in plane strain."
        leg = "is what the library took for the leg, unless the answer inferred it."
        lines = [
            f"CAUTION: {self.caution}" if self.caution else "",
            "From {answer}: {record}, library {library}.".format_map(self.source),
            f"φ {self.phi_deg['median']:.1f} deg in plane strain, 95 %: {low:.1f} to {high:.1f}.",
            f"{to.parameter} {to.words(self.value)}, 95 %: {ends}; it means: {to.meaning}.",
            matched,
            "Without dilation and cohesion, as the soil was inferred.",
            f"DRAWS are of the posterior: {to.draws_are}." if self.draws_deg.size else "",
            f"{self.left_out:.1%} of the draws have no equivalent." if self.left_out else "",
            self._density_in_words(),
            f"LEG_FRICTION {'is not known here.' if self.leg_friction is None else leg}",
            *(
                f"{name} {one['median']:.3g}, 95 %: {one['ci95'][0]:.3g} to {one['ci95'][1]:.3g}, "
                f"{one['about']}."
                for name, one in self.extra.items()
            ),
            f"Not inferred, and left alone: {to.left_alone}.",
        ]
        body = "\n".join(filter(None, lines))
        return f"Soil for {to.title}; {SIGNATURE} {version}.\n\n{body}\n"

    def _density_in_words(self) -> str:
        how = {True: "assumed", False: "given", None: "inferred too"}[self.assumed]
        return f"DENSITY [kg/m³] was {how}."

    def _usda(self) -> str:
        if self.to.name not in ("newton", "isaaclab"):
            raise InputError(f"{self.to.name} reads no materials in USD: name a .py or .json file")
        about = json.dumps(self._about(), ensure_ascii=False)
        return (
            f'#usda 1.0\n(\n    doc = {about}\n)\n\ndef Material "Soil" (\n'
            '    prepend apiSchemas = ["PhysicsMaterialAPI", "NewtonMPMMaterialAPI"]\n)\n{\n'
            f"    float physics:density = {self.density}\n"
            f"    float newton:mpm:internalFriction = {self.value:.6f}\n}}\n"
        )


def export(
    told: Told,
    to: Simulator,
    *,
    match: Match = "plane-strain",
    draws: int = 0,
    seed: int = 0,
    anyway: bool = False,
) -> Export:
    """A simulator's parameters from an answer.

    Parameters
    ----------
    told
        The answer.
    to
        The simulator.
    match
        Along which stress path it should be as strong as the soil.
    draws
        Number of draws of the posterior.
    seed
        Of their choice.
    anyway
        Whether an answer whose verdict is not ``consistent`` is taken.

    Raises
    ------
    InputError
        If the answer has no φ, or none with an equivalent in plane strain; if its verdict is not
        ``consistent``; if it has no draws and some are wanted; or if it lacks what answers have.
    """
    if min(draws, seed) < 0:
        raise InputError(f"draws = {draws}, seed = {seed}: expected whole numbers, 0 or more")
    try:
        made = _made(told, to, match, draws, seed, anyway)
        made.headline(), made.as_dict()
    except InputError:
        raise
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        what = f"it has no {error}" if isinstance(error, KeyError) else str(error)
        raise InputError(
            f"{told.source}: not as 'terraphi invert' writes it ({what}); make it again"
        ) from error
    return made


def _made(told: Told, to: Simulator, match: Match, draws: int, seed: int, anyway: bool) -> Export:
    answer = told.answer
    to.from_angle(30.0, match)  # whether it can be told any
    if answer["phi_deg"] is None:
        raise InputError(f"{told.source}: the friction angle was not inferred")
    if answer["phi_plane_strain_deg"] is None:
        raise InputError(
            f"{told.source}: its friction angle is one of '{answer['phi_deg']['yield']}', and has "
            f"no equivalent in plane strain: {answer.get('phi_plane_strain_reason', '')}"
        )
    caution = " ".join(answer.get("warnings", ()))
    if answer["verdict"] != "consistent":
        caution = f"the verdict is {answer['verdict'].replace('_', ' ')}: {answer['reason']}"
        if not anyway:
            raise InputError(f"{told.source}: {caution} Export it all the same with --anyway")
    if draws and not told.draws_deg.size:
        raise InputError(
            f"{told.source}: has no draws of the posterior; name the folder of 'terraphi invert "
            "--out', or its posterior.nc"
        )
    chosen, left_out = _drawn(told, draws, seed)
    return Export(
        to,
        match,
        answer["phi_plane_strain_deg"],
        chosen,
        left_out,
        *_density(answer),
        _leg_friction(answer),
        caution,
        {
            "answer": told.source,
            "record": answer.get("source")
            or ", ".join(one["source"] for one in answer.get("histories", ())),
            "library": answer["library"],
            "verdict": answer["verdict"],
            "draws_seed": seed,
            "provenance": answer.get("provenance", {}),
        },
    )


def with_bevameter(found: Export, told: Told, progress: Callable[[float, float], None]) -> Export:
    """An export to chrono-scm with what a virtual bevameter finds at the draws.

    Parameters
    ----------
    found
        The export.
    told
        The answer that it is of.
    progress
        Called with the work done and all of it.

    Returns
    -------
    Export
        Its intervals are of at least :data:`ENOUGH` draws, however few are written.
    """
    from terraphi.terrain.bevameter import bekker

    seed = int(found.source["draws_seed"])
    more, _ = _drawn(told, max(ENOUGH - found.draws_deg.size, 0), seed + 1)
    every = np.concatenate([found.draws_deg, more])
    extra = bekker(every, found.density, seed=seed, progress=progress)
    kept = {
        name: {**one, "draws": one["draws"][: found.draws_deg.size]} for name, one in extra.items()
    }
    return replace(found, extra=kept)


def check_bevameter(told: Told, to: Simulator) -> None:
    """Raise InputError where a bevameter is of no use, or there are no draws to press at."""
    if to.name != "chrono-scm":
        raise InputError(f"--bevameter is for chrono-scm; {to.name} has no sinkage law")
    if not told.draws_deg.size:
        raise InputError(
            f"{told.source}: has no draws of the posterior, at which plates are pressed; name the "
            "folder of 'terraphi invert --out', or its posterior.nc"
        )


def in_plane_strain(told: Told) -> FloatArray:
    """Draws of φ as plane-strain angles [deg], shape [draw]; those without one are not a number.

    Raises
    ------
    InputError
        If no flow rule turns the median into the one that the answer names.
    """
    angle, wanted = told.answer["phi_deg"], told.answer["phi_plane_strain_deg"]["median"]

    def convert(phi: float, associated: bool) -> float:
        try:
            return plane_strain_friction_angle_deg(
                phi, angle["yield"], dilation_angle_deg=phi if associated else 0.0
            )
        except InputError:
            return np.nan

    for associated in (False, True):
        if abs(convert(angle["median"], associated) - wanted) < AGREE_DEG:
            return np.array([convert(phi, associated) for phi in told.draws_deg.tolist()])
    raise InputError(
        f"{told.source}: its library's soil dilates by an angle of its own, with which draws are "
        "not converted; leave out --draws"
    )


def _drawn(told: Told, count: int, seed: int) -> tuple[FloatArray, float]:
    """Draws of φ in plane strain [deg], and the share of those that have no equivalent."""
    if not count:
        return np.empty(0), 0.0
    every = in_plane_strain(told)
    there = every[np.isfinite(every)]
    rng = np.random.default_rng(seed)
    return rng.choice(there, count, replace=count > there.size), 1.0 - there.size / every.size


def _quoted(text: str) -> str:
    """A text between the quotation marks of a docstring, whatever somebody wrote into it."""
    marks = text.replace("\\", "\\\\").replace('"', '\\"')
    return "".join(
        c if c.isprintable() or c == "\n" else c.encode("unicode_escape").decode() for c in marks
    )


def _density(answer: Mapping[str, Any]) -> tuple[float, bool | None]:
    """Density [kg/m³] and whether it was assumed; the median and ``None`` if it was inferred."""
    if answer["density_kg_m3"] is None:
        return float(answer["parameters"]["soil.density"]["median"]), None
    # An answer that does not say so gives no ground to rely on it.
    return float(answer["density_kg_m3"]), bool(answer.get("density_assumed", True))


def _leg_friction(answer: Mapping[str, Any]) -> float | None:
    """Friction of the leg: as inferred, else that of the library if the same is at hand."""
    from terraphi.library.store import Library

    if "leg.friction" in answer.get("parameters", {}):
        return float(answer["parameters"]["leg.friction"]["median"])
    try:
        library = Library.load(Path(answer["library"]).name)
    except InputError:
        return None
    same = library.hash == answer.get("provenance", {}).get("library_hash")
    return library.cases[0].scenario.leg.friction if same else None


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
    properties.mu_fric_s = value
    properties.mu_fric_2 = value
    properties.cohesion_coeff = 0.0
    return properties
''',
    "chrono-scm": '''def set_soil(
    terrain, bekker_kphi, bekker_n, janosi, elastic_k, damping_r, value=MOHR_FRICTION
):
    """Set the soil of an SCMTerrain in SI units; elastic_k is above bekker_kphi."""
    terrain.SetSoilParameters(
        bekker_kphi, 0.0, bekker_n, 0.0, value, janosi, elastic_k, damping_r
    )
''',
    "geotaichi": '''def material(young_modulus, poisson_ratio, value=FRICTION, **others):
    """One entry for add_material, with DruckerPrager as the model."""
    return {
        "MaterialID": 1,
        "Density": DENSITY,
        "YoungModulus": young_modulus,
        "PoissonRatio": poisson_ratio,
        "Friction": value,
        "dpType": DP_TYPE,
        "Dilation": 0.0,
        "Cohesion": 0.0,
        **others,
    }
''',
}
"""How a simulator takes the constants, as functions of the module that is exported."""
