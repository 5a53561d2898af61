"""A soil for a simulator: φ in plane strain and bulk density, with their uncertainty.

From a table of sands, from numbers with their errors, or from an answer.
"""

from __future__ import annotations

import tomllib
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache, cached_property, partialmethod
from numbers import Real
from pathlib import Path
from statistics import NormalDist
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from terraphi.experiment.arrays import FloatArray, count, generator, numbers
from terraphi.experiment.documents import DATA
from terraphi.experiment.errors import GUESSED, InputError, nearest
from terraphi.experiment.files import number_with_sd
from terraphi.experiment.outputs import changed
from terraphi.experiment.priors import DENSITY, FRICTION
from terraphi.experiment.scenario import LIMITS
from terraphi.experiment.soil import cone_slope
from terraphi.forward.rft import to_plane_strain
from terraphi.inference.answer import QUANTILES, Estimate
from terraphi.inference.records import density_with_sd
from terraphi.inference.stored import StoredAnswer

if TYPE_CHECKING:
    from terraphi.laws.wheel import Wheel

ANGLES = ("phi_deg", "phi_plane_strain_deg")
EXACT = ("plane_strain", "rft3d")
"""Conventions whose plane-strain angle follows from the angle alone."""
AGREEMENT_DEG = 0.01
"""Rounding of an answer's angles [deg]."""
MOST_DRAWS = 100_000
"""Draws of an export at most."""
LEAST_DENSITY = 0.1
"""Least density of a draw over the mean [-]; chosen, so that none is negative."""
MOST_SDS = 3.0
"""Standard deviations from the mean at which draws of φ end [-]; chosen, so that those of the table
are within law ``foot``, which ends at 55°."""


class Sand(NamedTuple):
    """An entry of ``data/soils.toml``: means and standard deviations, and where they come from."""

    phi: tuple[float, float]
    """φ in plane strain [deg] that carries the load."""
    density: tuple[float, float]
    """Bulk density [kg/m³]."""
    source: str
    correlation: float = 0.0
    """Between φ and density [-]."""


@cache
def table() -> dict[str, dict[str, Any]]:
    """Soils, uses and what is refused, as ``data/soils.toml`` has them."""
    return tomllib.loads((DATA / "soils.toml").read_text(encoding="utf-8"))


@cache
def named() -> dict[str, Sand]:
    """Soils by name, and by what is found where, as on a beach."""
    sands = {name: Sand(**entry) for name, entry in table()["soils"].items()}
    for use, names in table()["uses"].items():
        parts = [sands[name] for name in names]
        # The covariance of a mixture is the mean of those of its parts and that of their means.
        means, sds = (np.array([[s.phi[i], s.density[i]] for s in parts]) for i in (0, 1))
        total = np.cov(means.T, bias=True) + np.diag(np.square(sds).mean(axis=0))
        total += np.mean([s.correlation * s.phi[1] * s.density[1] for s in parts]) * (1 - np.eye(2))
        (phi, density), (phi_sd, density_sd) = means.mean(axis=0), np.sqrt(np.diag(total))
        sands[use] = Sand(
            (float(phi), float(phi_sd)), (round(float(density)), round(float(density_sd))),
            f"equal shares of {', '.join(names)}", float(total[0, 1] / (phi_sd * density_sd)),
        )  # fmt: skip
    return sands


class Draws(NamedTuple):
    """Soils that agree with what is known, shape [draw] each."""

    phi_deg: FloatArray
    """φ in plane strain [deg]."""
    density: FloatArray
    """Bulk density [kg/m³]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class SoilDistribution:
    """φ in plane strain and bulk density of a soil, with their uncertainty.

    Attributes
    ----------
    name
        What it is, or where the answer comes from.
    phi
        Median, standard deviation and intervals of φ in plane strain [deg].
    density, density_sd
        Bulk density and its standard deviation [kg/m³].
    density_assumed
        True if it is an assumption, not a measurement.
    correlation
        Between φ and density [-]: forces that determine φ give less of it if the soil is heavier.
    leg_friction
        Of the leg of an answer [-], or ``None``.
    caution
        What to know before it is used; may be empty.
    origin
        Where it comes from, as plain values.
    answer
        The answer that it is of, or ``None``.

    Examples
    --------
    >>> sand = terraphi.soil("loose dry sand")
    >>> sand
    loose dry sand: φ 33.0 ± 2.0° in plane strain, 1510 ± 80 kg/m³
    >>> round(sand.newton()["value"], 3)
    0.545
    >>> phi_deg, density = sand.draws(100, rng=1)
    >>> len(phi_deg)
    100
    """

    name: str
    phi: Estimate
    density: float
    density_sd: float
    density_assumed: bool = True
    correlation: float = 0.0
    leg_friction: float | None = None
    caution: str = ""
    origin: Mapping[str, Any] = field(default_factory=dict)
    answer: StoredAnswer | None = None

    def __repr__(self) -> str:
        """One line; the density of a named soil is that of the table, as its φ."""
        is_guess = self.density_assumed and self.origin.get("source", "given") == "given"
        return (
            f"{self.name}: φ {self.phi.median:.1f} ± {self.phi.sd:.1f}° in plane strain, "
            f"{self.density:g} ± {self.density_sd:g} kg/m³{' (assumed)' if is_guess else ''}"
        )

    @cached_property
    def phi_values(self) -> FloatArray:
        """Equally probable values of φ in plane strain [deg], NaN where an answer has none."""
        if self.answer is not None:
            return in_plane_strain(self.answer)
        return _normal(self.phi.median, self.phi.sd)

    def draws(self, n: int, *, rng: np.random.Generator | int | None = None) -> Draws:
        """Draw soils.

        Parameters
        ----------
        n
            How many.
        rng
            A generator, or the seed of one.

        Raises
        ------
        InputError
            If ``n`` is no count, or the answer's file has no draws.
        """
        n = count("draws", n, 0, MOST_DRAWS)
        if n == 0:
            return Draws(np.empty(0), np.empty(0))
        rng = generator(rng)
        there = self.phi_values[np.isfinite(self.phi_values)]
        phi = rng.choice(there, n, replace=n > there.size)
        deviation = (phi - there.mean()) / max(float(there.std()), 1e-9)
        independent = np.sqrt(1.0 - self.correlation**2) * rng.standard_normal(n)
        density = self.density + self.density_sd * (self.correlation * deviation + independent)
        return Draws(phi, np.maximum(density, LEAST_DENSITY * self.density))

    def wheel(
        self, diameter_mm: float, width_mm: float, load_N: float, slip: Any, *,
        lugs: tuple[int, float] = (0, 0.0), surface_friction: float | None = None,
        draws: int = 0, rng: np.random.Generator | int | None = None,
    ) -> dict[str, FloatArray]:  # fmt: skip
        """Sinkage, pull and torque of a rigid wheel, by law ``foot`` over its rim.

        Parameters
        ----------
        diameter_mm, width_mm
            Of the rim [mm].
        load_N
            Vertical load [N].
        slip
            1 − v / (ω R) of a driven wheel, ω R / v − 1 of a braked one [-]; a number or an array.
        lugs
            Their number and height [mm].
        surface_friction
            Between rim and soil [-], 0.05 to 0.65; by default that of an answer, or 0.3.
        draws
            How many soils are drawn; 0: the median φ and the mean density.
        rng
            A generator, or the seed of one.

        Returns
        -------
        dict
            ``sinkage_mm`` (of the lugs' tips), ``pull_N``, ``torque_Nm`` of the shape of ``slip``,
            of draws after one axis for these; NaN where the wheel sinks in deeper than the law has.
            The sinkages are those at which wheels are read right: φ with their error in grains.

        Raises
        ------
        InputError
            If a size, the load or the slip is no wheel's, or beyond the law.

        Warns
        -----
        UserWarning
            If the wheel sinks in deeper than the law has.

        Examples
        --------
        >>> rolling = terraphi.soil("loose dry sand").wheel(200, 80, 40.0, [0.1, 0.3])
        >>> bool(rolling["sinkage_mm"][1] > rolling["sinkage_mm"][0] > 0.0)
        True
        """
        from terraphi.laws.wheel import rolling

        if np.shape(lugs) != (2,) or lugs[0] % 1:
            raise InputError(f"lugs = {lugs}; give their number and height [mm], as (30, 10)")
        if surface_friction is None:
            surface_friction = FRICTION.mean if self.leg_friction is None else self.leg_friction
        body = _wheel(diameter_mm, width_mm, int(lugs[0]), 1e-3 * lugs[1])
        soils = self.draws(draws, rng=rng) if draws else Draws(
            np.array([self.phi.median]), np.array([self.density]))  # fmt: skip
        results = rolling(body, load_N, slip, *soils, surface_friction=surface_friction)
        if np.isnan(results["sinkage_mm"]).any():
            warnings.warn("NaN: the wheel sinks in deeper than the law has", stacklevel=2)
        return {name: value if draws else value[0] for name, value in results.items()}

    def bekker_wong(self, diameter_mm: float, width_mm: float) -> dict[str, float]:
        """Bekker's and Wong's numbers of a wheel model, fitted to :meth:`wheel`, for this wheel.

        Parameters
        ----------
        diameter_mm, width_mm
            Of the rim [mm].

        Returns
        -------
        dict
            By the names of :class:`~terraphi.laws.wheel.BekkerWong`.

        Raises
        ------
        InputError
            If a size is no wheel's.
        """
        from terraphi.laws.wheel import bekker_wong

        wheel = _wheel(diameter_mm, width_mm)
        return bekker_wong(wheel, self.phi.median, self.density)._asdict()

    def export(self, to: str, **options: Any) -> dict[str, Any]:
        """Parameters of a simulator, as :func:`~terraphi.terrain.export.export` has them."""
        from terraphi.terrain.export import export

        return export(self, to=to, **options)

    genesis = partialmethod(export, "genesis")
    """Friction of Genesis' MPM sand."""
    newton = partialmethod(export, "newton")
    """Friction of Newton's implicit MPM."""
    isaaclab = partialmethod(export, "isaaclab")
    """Friction of Newton's implicit MPM in Isaac Lab."""
    geotaichi = partialmethod(export, "geotaichi")
    """Friction of GeoTaichi's Drucker-Prager soil."""
    mujoco = partialmethod(export, "mujoco")
    """Soil under feet that are spheres."""
    rft = partialmethod(export, "rft3d")
    """Parameters of three-dimensional resistive force theory."""

    def chrono(self, terrain: str = "crm", **options: Any) -> dict[str, Any]:
        """Parameters of Chrono's ``crm`` (FSI-SPH) or ``scm`` terrain."""
        return self.export(f"chrono-{terrain}", **options)

    def force(self, foot: Any, pose: Any, velocity: Any, **options: Any) -> tuple[Any, Any]:
        """Force and moment on feet by law ``foot``, at the median φ and the mean density.

        Parameters
        ----------
        foot, pose, velocity
            As of :func:`terraphi.laws.wrench.force`: a :class:`~terraphi.laws.foot.Foot` or a
            :class:`~terraphi.laws.wrench.Mesh`, where it is, and how it moves.
        **options
            As there; ``phi_deg`` and ``density`` are those of this soil unless given, as one of
            :meth:`draws` for each foot.

        Raises
        ------
        InputError
            If φ or the friction is outside the law's table, or a shape is another.

        Examples
        --------
        >>> from terraphi.laws.foot import Foot
        >>> ball = Foot(radius=0.022)
        >>> sand = terraphi.soil("loose dry sand")
        >>> force, moment = sand.force(ball, [0.0, 0.0, 0.002], [0.0, 0.0, -0.1])
        >>> bool(force[2] > 10.0)
        True
        """
        from terraphi.laws.wrench import force

        soil = {"phi_deg": self.phi.median, "density": self.density}
        return force(foot, pose, velocity, **soil | options)


def _wheel(diameter_mm: float, width_mm: float, lugs: int = 0, lug_height: float = 0.0) -> Wheel:
    """Body of a wheel; raises InputError if a size is none in millimeters."""
    from terraphi.laws.wheel import Wheel

    for name, size in (("diameter_mm", diameter_mm), ("width_mm", width_mm)):
        numbers(name, size, shape=(), low=5.0, high=4000.0, unit="mm")
    return Wheel(5e-4 * diameter_mm, 1e-3 * width_mm, lugs, lug_height)


def soil(
    what: Any = None,
    *,
    phi: float | str | None = None,
    density: float | str | None = None,
    anyway: bool = False,
) -> SoilDistribution:
    """A soil for a simulator, without a test or from an answer.

    Parameters
    ----------
    what
        A name of :func:`named`, such as ``loose dry sand`` or ``beach``, φ as ``33`` or
        ``"33±2"``, or an answer: an
        :class:`~terraphi.Answer`, the folder of ``terraphi invert --out``, its ``answer.nc``, or
        the output of ``--json``.
    phi
        φ in plane strain [deg] in place of a name, as ``33`` (exact) or ``"33±2"``.
    density
        Bulk density [kg/m³], as ``1600`` (± 5 %) or ``"1600±40"``; by default that of the table,
        or that of :mod:`~terraphi.experiment.priors`. An answer has its own.
    anyway
        True if an answer is accepted whose verdict is not ``consistent``.

    Raises
    ------
    InputError
        If there is no such soil, a number cannot be, or the answer has no φ in plane strain.

    Examples
    --------
    >>> terraphi.soil("dense dry sand").phi.median
    42.0
    >>> terraphi.soil(phi="33±2", density="1600±40")
    φ = 33±2°: φ 33.0 ± 2.0° in plane strain, 1600 ± 40 kg/m³
    >>> terraphi.soil(phi="33±2")
    φ = 33±2°: φ 33.0 ± 2.0° in plane strain, 1600 ± 160 kg/m³ (assumed)
    """
    if isinstance(what, SoilDistribution):
        if phi is not None or density is not None:
            raise InputError("a soil has its own φ and density; leave them out")
        return what
    what = None if isinstance(what, str) and not what.strip() else what
    if (what is None) == (phi is None):
        raise InputError(f"soil: give its name ({', '.join(named())}), or phi as '33±2'")
    if isinstance(what, Real):
        what = f"{float(what):g}"
    name = str(what)
    sand = None
    if isinstance(what, str):
        # Any case, and as one of several words: "wet clay".
        for refused, lacks in table()["refused"].items():
            if refused.casefold() in what.casefold().split():
                raise InputError(f"{what}: not described by a friction angle; {lacks}")
        words = " ".join(what.casefold().replace("_", " ").split())
        name, sand = {key.casefold(): (key, sand) for key, sand in named().items()}.get(
            words, (name, None)
        )
    given = str(what if phi is None else phi).strip()
    angle = _angle(given) if sand is None and isinstance(what, str | None) else None
    if angle is not None:
        name, sand = f"φ = {given}°", Sand(angle, DENSITY, "given")
    elif phi is not None:
        raise InputError(f"phi = '{given}'; give degrees in plane strain as 33 or 33±2")
    if sand is None:
        if density is not None:
            raise InputError("an answer has its density; leave it out")
        return _of_answer(what, anyway=anyway)
    weight = sand.density if density is None else density_with_sd(density, "soil")
    return SoilDistribution(
        name=name,
        phi=Estimate.of(_normal(*sand.phi)),
        density=weight[0],
        density_sd=weight[1],
        density_assumed=density is None,
        correlation=sand.correlation if density is None else 0.0,
        origin={"soil": name, "source": sand.source},
    )


def _angle(text: str) -> tuple[float, float] | None:
    """Mean and standard deviation of φ [deg], ``None`` of another text; raises InputError."""
    low, high, _ = LIMITS["soil.friction_angle_deg"]
    try:
        mean, sd = number_with_sd(text)
    except ValueError:
        return None
    sd = sd or 0.0
    if not (low <= mean <= high and 0.0 <= sd <= 0.25 * mean):
        accepted = f"{low:g} to {high:g}° with a ± of a quarter at most are accepted"
        raise InputError(f"phi = {text}; {accepted}")
    return mean, sd


def _normal(mean: float, sd: float) -> FloatArray:
    """Equally probable values of a normal distribution, none beyond :data:`MOST_SDS`."""
    normal = NormalDist(0.0, 1.0)
    share = (np.arange(QUANTILES) + 0.5) / QUANTILES
    deviates = np.array([normal.inv_cdf(p) for p in share.tolist()])
    return mean + sd * np.clip(deviates, -MOST_SDS, MOST_SDS)


def _of_answer(what: Any, *, anyway: bool) -> SoilDistribution:
    """The soil of an answer."""
    if isinstance(what, str | Path):
        text, path = str(what), Path(what)
        if text != "-" and not path.suffix and not path.exists():
            hint = nearest(text, (*named(), "33±2"))
            raise InputError(f"'{text}' is neither an answer nor a soil; {hint}")
    read = StoredAnswer.of(what)
    answer = read.answer
    if None in (answer[name] for name in ANGLES):
        reason = answer.get("phi_plane_strain_reason") or "it was not inferred"
        raise InputError(f"{read.source}: no friction angle in plane strain: {reason}")
    _check(read)
    caution = " ".join(q for q in answer.get("warnings", ()) if GUESSED not in q)
    if answer["verdict"] != "consistent":
        caution = f"the verdict is {answer['verdict'].replace('_', ' ')}: {answer['reason']}"
        if not anyway:
            raise InputError(f"{read.source}: {caution} To export it all the same, add --anyway")
    caution = ". ".join(filter(None, [changed(Path(read.source)), caution]))
    phi = answer["phi_plane_strain_deg"]
    records = [record["source"] for record in answer.get("records", ())]
    inferred = answer.get("parameters", {}).get("leg.friction")
    density = float(answer["density_kg_m3"])
    sd = answer.get("density_sd_kg_m3")
    # A heavier soil of the same forces has a smaller angle: that is the density's term of σ_φ.
    share = answer.get("budget_deg", {}).get("density", 0.0) / max(phi.get("sd") or 0.0, 1e-9)
    return SoilDistribution(
        name=read.source,
        phi=Estimate(phi["median"], phi.get("sd", 0.0), tuple(phi["ci68"]), tuple(phi["ci95"])),
        density=density,
        density_sd=0.05 * density if sd is None else float(sd),
        density_assumed=answer.get("density_assumed", True),
        correlation=-min(share, 1.0),
        leg_friction=inferred["median"] if inferred else answer.get("leg_friction"),
        caution=caution,
        origin={
            "answer": read.source,
            "record": answer.get("source") or ", ".join(records),
            "law": answer["law"],
            "verdict": answer["verdict"],
            "provenance": answer.get("provenance", {}),
        },
        answer=read,
    )


def _check(read: StoredAnswer) -> None:
    """Refuse medians and intervals that do not belong together, as of an answer edited by hand."""
    estimates = (read.answer[name] for name in ANGLES)
    stated, given = (
        np.array([estimate["median"], *estimate["ci68"], *estimate["ci95"]])
        for estimate in estimates
    )
    expected = _to_plane_strain(read, stated)
    if read.answer["phi_deg"].get("yield") in EXACT and not np.allclose(
        expected, given, rtol=0.0, atol=AGREEMENT_DEG
    ):
        pair = f"phi_deg {stated[0]:.1f} is {expected[0]:.1f} in plane strain"
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
