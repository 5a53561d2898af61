r"""The friction angle from a body pressed straight down: force over sinkage, by a law of a foot.

The force at the sinkage z is m(z) F(φ, z + z₀). z₀ is the error of the contact. The mobilization
m = 1 − A exp(−z / (b R)) is that of loose soil that compacts before it bears, R the radius of the
body. φ and z₀ are fitted at each node of A and b by least squares, and the weight of a node is its
likelihood times the prior exp(−A / A₀). The law reads too low in soil that compacts: nodes with a
large A have an offset and a standard deviation of their own, learned from one sand.
"""

from __future__ import annotations

import importlib.metadata
import math
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from terraphi.experiment.arrays import BoolArray, FloatArray, IntArray, block_means
from terraphi.experiment.errors import InputError, nearest
from terraphi.experiment.files import label_of
from terraphi.experiment.history import resolution
from terraphi.experiment.pressed_reading import read_pressed
from terraphi.experiment.priors import CONTACT_SD_M, CONTACT_SD_PART, DENSITY
from terraphi.experiment.rig import Tool
from terraphi.experiment.tables import ToolTable
from terraphi.experiment.wheel_reading import read_rolled
from terraphi.inference.answer import Answer, Estimate, RecordFit
from terraphi.inference.estimator import least_squares, weights
from terraphi.inference.records import (
    density_warnings,
    density_with_sd,
    grain_size,
    is_ceiling,
    readings_hash,
    roughness,
)
from terraphi.inference.terms import TERMS, ordered_budget, root_sum_square
from terraphi.inference.verdict import (
    Judgment,
    consistent,
    large_residual,
    misfit,
    out_of_range,
    unusual,
)
from terraphi.laws.foot import DEEPEST, LAWS, Foot

WINDOWS = 40
"""Equal windows of sinkage."""
SHAPE_SD, SHAPE_LENGTH, FLOOR = 0.08, 1.0, 0.02
"""Error of a law's course over depth [-], its correlation length in ln z, and an independent error
over the largest force: chosen; laws follow loose grains within 5 to 10 %."""
SOIL_SD_DEG = 1.4
"""Of the error of laws of feet, the part by which soils differ [deg]: 1.4 to 1.6 for five laws in
loose grains (``docs/plates.md``). Soils in which feet read low are those in which legs do."""
DEEP_SD = 0.10
"""Error of laws for each radius beyond :data:`~terraphi.laws.foot.DEEPEST` [-], chosen."""
CONTRACTIONS, PRIOR, EXPONENTS = np.linspace(0.0, 0.98, 15), 0.25, np.array([1.3, 2.0, 3.0])
"""Nodes of A, the mean of its prior, and nodes of b [-]."""
NODES = np.array([(a, b) for a in CONTRACTIONS for b in EXPONENTS])
"""A and b, shape [node, 2]."""
SIGNIFICANT = 0.3
"""A from which soil compacts, and an answer says so with a chance below 5 % that it is a tenth of
this [-], chosen: feet in loose grains have up to 0.33, plates on loose Cullinan sand 0.42 to 1."""
COMPACT = NODES[:, 0] >= SIGNIFICANT
"""Nodes of soil that compacts, shape [node]."""
COMPACTING_DEG, COMPACTING_SD_DEG = 2.2, 3.7
"""What a law reads too little in soil that compacts, and the standard deviation that remains [deg]:
six plates on the loosest Cullinan sand. Each left out in turn, they leave 3.1°, and the triaxial
tests of that sand 2.0° in common (``studies/sheared_sands.py``). No other sand is known."""
SHALLOW = 2.0
"""Largest ratio of the radius to the depth, by which that standard deviation grows in records less
than a radius deep [-]: down to half a radius the plates on Cullinan sand read 8° too little, discs
in loose grains 7° too much, and as much down to a quarter."""
LOOSE_DEG = 37.0 + 1.64 * LAWS["foot"].sd_deg
"""φ above which soil is not loose [deg]: 1.64 standard deviations of the best law (one in twenty)
above the largest critical angle of seventeen sands (Bolton 1986, Géotechnique 36:65, table 1)."""
GRAINS_DEG = 15.0
"""Standard deviation of φ by grains as large as the body [deg]; it goes with their diameter. Grains
of 4 to 9 mm add 14 ± 10° to balls of 44 mm and take 17 ± 11° off discs of 60 mm, over the diameter
(``docs/plates.md``), so that nothing is corrected."""
HALVES = 3.0
"""Difference of φ between both halves of the depth over its standard deviation above which a record
is a misfit [-], chosen."""
LIMIT = 0.15
"""Residual above which a record is a misfit, over the range of the force [-]."""
FEWEST_AIR = 6
"""Readings in air that a zero needs (chosen)."""
ROUGHER = 0.1
"""Difference of the friction by which its effect is found [-]."""
FRICTIONS = (0.05, 0.65)
"""Frictions that law ``foot`` has [-]."""
EXCESS, FEWEST_EXCESSES = 0.25, 3
"""Force on readings that are no deeper than earlier ones, less the largest on these, over the
largest of all [-], and how many such readings a record may not have. Of 64 records (grains, plates
on sands) with noise of 1 mm and 3 % of the force it is 0.18 at most, with a sinkage that sticks at
half of the way 0.2 to 0.8."""
LIKE_DISC = 1.25
"""Residual of a ball over that of a disc as wide from which an answer says so [-]: at most 1.11 in
26 records of balls in grains; 18 of 30 records of discs, read as balls, exceed it."""
MOST_STEPS = 20
"""Most forces of a test in steps of load [-]."""
TARED = 0.01
"""Force in air over the largest from which it is named [-]."""
RANGE_DEG = np.arange(10.0, 55.5, 0.5)


@dataclass(frozen=True, eq=False)
class PressedRecord:
    """Force over sinkage of a tool that was pressed straight down, or rows of a wheel.

    Attributes
    ----------
    source, density_kg_m3, density_sd_kg_m3, density_assumed, grain_size_mm
        As of :class:`~terraphi.inference.records.Record`.
    rig
        The plate or ball.
    table
        Sinkage and force in the order of time; of a wheel its slip and load as well.
    """

    source: str
    rig: Tool
    table: ToolTable
    density_kg_m3: float
    density_sd_kg_m3: float
    density_assumed: bool
    grain_size_mm: float = 0.0

    @property
    def readings_hash(self) -> str:
        """:func:`~terraphi.inference.records.readings_hash` of its table."""
        return readings_hash(np.array([*self.table.values.values()]))


def tool_answer(
    record: PressedRecord, law: Any, began: float, *, judgment: Judgment,
    posterior: tuple[FloatArray, FloatArray], warnings: Iterable[str],
    friction: float | None = None, provenance: Mapping[str, Any] | None = None, **values: Any,
) -> Answer:  # fmt: skip
    """The answer of a record of a tool by a law, ``foot`` by default.

    ``posterior`` has angles [deg] and the density of φ there [1/deg], ``provenance`` what the law
    adds, and ``values`` are those of :class:`~terraphi.inference.answer.Answer`. ``friction`` is
    that of the tool unless it was inferred.
    """
    rho = record.density_kg_m3
    assumed = [f"The density {rho:g} kg/m³ is assumed."] if record.density_assumed else []
    verdict, reason, edge = judgment
    return Answer(
        convention="plane_strain", verdict=verdict, reason=reason, edge=edge,
        density_kg_m3=rho, density_sd_kg_m3=record.density_sd_kg_m3,
        density_assumed=record.density_assumed, law=str(law or "foot"),
        law_reason="" if law else "the default for this tool",
        leg_friction=record.rig.friction if friction is None else friction,
        grid_deg=posterior[0], density=posterior[1],
        warnings=(*density_warnings(rho), *assumed, *warnings),
        provenance={
            "terraphi": importlib.metadata.version("terraphi"), **(provenance or {}),
            "seconds": round(time.perf_counter() - began, 3),
        },
        **values,
    )  # fmt: skip


def tool_fit(
    record: PressedRecord, phi_deg: float, along: FloatArray, data: FloatArray,
    curves: Sequence[FloatArray], slope: FloatArray, nrmsd: dict[str, float],
    limit: float | None, **values: Any,
) -> RecordFit:  # fmt: skip
    """A record of a tool over its sinkage [mm] or slip [-], with the law's curves.

    ``curves`` are those at φ and at both ends of its 95 % interval [N], ``slope`` is that of the
    first with φ [N/deg], shape [n] each; ``values`` are further ones of the fit.
    """
    return RecordFit(
        source=record.source, rig=record.rig, theta_deg=along, data=data[None],
        curve=curves[0][None], band=np.sort(curves, axis=0)[::2, None], nrmsd=nrmsd, limit=limit,
        tangent=np.stack([curves[0] - slope * phi_deg, slope])[:, None],
        **{"n_readings": record.table.rows, **values},
    )  # fmt: skip


def open_pressed(
    source: Any, tool: Tool, columns: Any, density: float | str | None = None,
    grain_size_mm: float | None = None,
) -> PressedRecord:  # fmt: skip
    """Open a table of sinkage and force; raises InputError if it cannot be used."""
    area = math.pi * tool.radius**2 if tool.shape.foot == "disc" else None
    table = (
        read_pressed(source, area, columns) if tool.shape.foot
        else read_rolled(source, tool.radius, columns)
    )  # fmt: skip
    is_file = isinstance(source, str | Path)
    label = label_of(source) if is_file else f"{type(source).__name__} ({tool})"
    mean, sd = DENSITY if density is None else density_with_sd(density, label)
    grains = grain_size(grain_size_mm, 2e3 * tool.radius, label)
    return PressedRecord(label, tool, table, mean, sd, density is None, grains)


@dataclass(frozen=True, eq=False)
class _Press:
    """A body that was pressed in, its window means, and the law that they are read by."""

    tool: Tool
    law: str
    density: float
    z: FloatArray
    """Sinkage [m], shape [n]."""
    force: FloatArray
    noise: float
    grains: float = 0.0
    """Diameter of the grains over that of the body [-]."""

    def curve(self, x: FloatArray, friction: float | None = None) -> FloatArray:
        """The law's force [N] at (φ, z₀), [k, 2] -> [k, n], with the tool's friction or another."""
        foot = Foot(self.tool.radius, self.tool.shape.foot or "disc")
        lift = LAWS[self.law].lift(
            foot, self.z + x[:, 1:], 0.5 * np.pi, friction_angle_deg=x[:, :1],
            density=self.density,
            surface_friction=self.tool.friction if friction is None else friction,
        )  # fmt: skip
        return np.asarray(self.tool.factor * lift)

    @cached_property
    def ends(self) -> tuple[float, float]:
        """Smallest and largest φ that the law has [deg]."""
        covered = np.isfinite(self.curve(np.stack([RANGE_DEG, 0 * RANGE_DEG], -1))).all(axis=1)
        low, high = RANGE_DEG[covered][[0, -1]].tolist()
        return low, high

    @property
    def contact_sd(self) -> float:
        """Standard deviation of z₀ [m]."""
        return max(CONTACT_SD_M, CONTACT_SD_PART * self.tool.radius)

    @cached_property
    def borne(self) -> FloatArray:
        """m(z) at each node, shape [node, n]."""
        return np.asarray(1.0 - NODES[:, :1] * np.exp(-self.z / (NODES[:, 1:] * self.tool.radius)))

    @cached_property
    def course(self) -> FloatArray:
        """Covariance of the error of the law's course over depth, shape [n, n]."""
        distance = np.abs(np.log(self.z[:, None] / self.z))
        shape = SHAPE_SD**2 * np.outer(self.force, self.force) * np.exp(-distance / SHAPE_LENGTH)
        return np.asarray(shape + (FLOOR * self.force.max()) ** 2 * np.eye(self.z.size))

    @property
    def error(self) -> FloatArray:
        """Covariance of the course and of the noise [N²], shape [n, n]."""
        return np.asarray(self.course + self.noise**2 * np.eye(self.z.size))

    @property
    def compaction_sd(self) -> float:
        """Standard deviation of φ of soil that compacts [deg]."""
        return COMPACTING_SD_DEG * min(max(self.tool.radius / float(self.z[-1]), 1.0), SHALLOW)


class _Fit(NamedTuple):
    """Angles of all nodes, and the likeliest node."""

    chance: FloatArray
    """Of each node, shape [node]."""
    by_law: FloatArray
    """φ without the offset of soil that compacts [deg], shape [node]."""
    phi: FloatArray
    """φ with it [deg], shape [node]."""
    top: int
    """The likeliest node."""
    contact: float
    """z₀ there [m]."""
    model: FloatArray
    """Force there [N], shape [n]."""
    slope: FloatArray
    """Its slope by φ [N/deg], shape [n]."""
    mean_deg: float
    """Mean of φ over the nodes [deg]."""
    row: FloatArray
    """Slope of the mean φ by the force [deg/N], shape [n]."""


def invert_pressed(record: PressedRecord, law: Any = None) -> Answer:
    """Infer φ from a record of a tool; raises InputError as :func:`invert` does."""
    began, tool, name = time.perf_counter(), record.rig, str(law or "foot")
    if name not in LAWS:
        raise InputError(f"no law '{name}' of a tool; {nearest(name, tuple(LAWS))}")
    table, label = record.table, record.source
    if not tool.shape.foot:
        from terraphi.inference.rolled import invert_rolled

        return invert_rolled(record, law)
    rho, rho_sd = record.density_kg_m3, record.density_sd_kg_m3
    grains = record.grain_size_mm / (2e3 * tool.radius)
    z, force, used, notes = _virgin(table, label)
    press = _Press(tool, name, rho, z, force, roughness(force), grains)
    fit = _fit(press)
    budget = _budget(press, fit, rho_sd / rho)
    steady_sd = root_sum_square(budget, "contraction", "model: compaction")
    # Of each node φ is normal. Nodes of soil that compacts are wider: the standard deviation of
    # what the law misses there is theirs alone. The grid reaches beyond the law, for offsets move
    # φ out of it.
    sd = np.hypot(steady_sd, press.compaction_sd * COMPACT)
    grid = np.arange(max(press.ends[0] - 15.0, 0.5), min(press.ends[1] + 18.0, 80.0), 0.05)
    density = np.exp(-0.5 * ((grid[:, None] - fit.phi) / sd) ** 2) @ (fit.chance / sd)
    posterior = grid, np.asarray(density / np.trapezoid(density, grid))
    estimate = Estimate.of_density(*posterior)
    # Curves are drawn at the likeliest node, at angles as the law reads them: φ of the soil less
    # what is added where it compacts.
    level, read = fit.phi[fit.top], fit.by_law[fit.top]
    ends = np.array(estimate.ci95) - (level - read)
    ends = press.curve(np.stack([np.clip(ends, *press.ends), [fit.contact] * 2], -1))
    residual = float(np.sqrt(np.square(force - fit.model).mean()) / np.ptp(force))
    fitted = tool_fit(
        record, level, 1e3 * z, force, [fit.model, *(press.borne[fit.top] * ends)], fit.slope,
        {"Fz": residual}, LIMIT, n_readings=used, n_left_out=table.rows - used,
    )  # fmt: skip
    judgment = _verdict(press, fit, fitted, estimate.median, steady_sd)
    is_sound = judgment[0] == "consistent"
    # Terms that do not show in the residual look like another angle.
    angle_sd = root_sum_square(budget, *(name for name in budget if TERMS[name].residual))
    return tool_answer(
        record, law, began, judgment=judgment, posterior=posterior, budget_deg=budget,
        records=(fitted,),
        phi_of_force_deg=_phi_of_force(press, fit, estimate.median) if is_sound else None,
        warnings=(
            *notes, *unusual(estimate.median, "size of the tool"),
            *_warnings(press, fit, is_sound=is_sound),
        ),
        covariance=press.error + angle_sd**2 * np.outer(fit.slope, fit.slope),
        provenance={
            "law_hash": LAWS[name].hash, "contraction": float(fit.chance @ NODES[:, 0]),
            "compacts": float(fit.chance @ COMPACT), "contact_mm": 1e3 * fit.contact,
        },
    )  # fmt: skip


def _fit(press: _Press) -> _Fit:
    """φ and z₀ at each node, by least squares."""
    (low, high), sd = press.ends, press.contact_sd
    scale, precision = np.array([1.0, sd]), np.array([0.0, sd**-2])

    def residual(x: FloatArray, rows: IntArray) -> tuple[FloatArray, FloatArray]:
        # Central differences, a step within the angles of the law.
        inner, borne = np.clip(x, [low + 0.01, -np.inf], [high - 0.01, np.inf]), press.borne[rows]
        pairs = [(press.curve(inner + d) - press.curve(inner - d)) / (2.0 * d.sum())
                 for d in np.diag(1e-3 * scale)]  # fmt: skip
        return press.force - borne * press.curve(x), borne[..., None] * np.stack(pairs, -1)

    inverse = np.linalg.inv(press.error)
    weight = np.broadcast_to(inverse, (len(NODES), *inverse.shape))
    best = least_squares(
        residual, weight, np.tile([0.5 * (low + high), 0.0], (len(NODES), 1)),
        bounds=(np.array([low, -3.0 * sd]), np.array([high, 3.0 * sd])),
        scale=scale, precision=precision,
    )  # fmt: skip
    # Weight of a node: exp(−χ²/2) of its residual and contact, times the prior exp(−A / A₀).
    cost = np.einsum("kn,nm,km->k", best.residual, inverse, best.residual)
    cost += (best.x[:, 1] / sd) ** 2 + 2.0 * NODES[:, 0] / PRIOR
    chance = np.exp(0.5 * (cost.min() - cost))
    chance /= chance.sum()
    top, phi = int(chance.argmax()), best.x[:, 0] + COMPACTING_DEG * COMPACT
    # d/dF of Σ p φ over the nodes: of each φ, and of ln p = −½ cost, which is −W r at its minimum.
    gain = weights(best.slope, weight, precision)[0][:, 0]
    mean = float(chance @ phi)
    row = chance @ (gain - (phi - mean)[:, None] * (best.residual @ inverse))
    return _Fit(
        chance=chance, by_law=best.x[:, 0], phi=phi, top=top, contact=float(best.x[top, 1]),
        model=press.borne[top] * press.curve(best.x[top : top + 1])[0],
        slope=best.slope[top, :, 0], mean_deg=mean, row=row,
    )  # fmt: skip


def _budget(press: _Press, fit: _Fit, density_sd: float) -> dict[str, float]:
    """Standard deviation of φ by term [deg]; that of the density is relative [-]."""
    x = np.array([[fit.by_law[fit.top], fit.contact]])
    # A central difference within law ``foot``.
    low, high = np.clip(press.tool.friction + np.array([-ROUGHER, ROUGHER]), *FRICTIONS).tolist()
    rougher = (press.curve(x, high)[0] - press.curve(x, low)[0]) / (high - low)
    # Errors of the force [N], one standard deviation over depth.
    errors = {
        "density": density_sd * fit.model,
        "surface friction": press.tool.friction_sd * rougher * press.borne[fit.top],
        "depth": DEEP_SD * np.maximum(press.z / press.tool.radius - DEEPEST, 0.0) * fit.model,
        "rectangle": 0.5 * math.log(press.tool.factor) * fit.model,
    }
    sds = {name: abs(float(fit.row @ error)) for name, error in errors.items()}
    # By fits anew: a disc bears at once where it touches, which is not linear in the contact.
    # The likeliest curve, moved by a standard deviation of the contact either way, is the data.
    higher, lower = (
        _fit(
            replace(press, force=press.borne[fit.top] * press.curve(x + np.array([0.0, z]))[0])
        ).mean_deg
        for z in (press.contact_sd, -press.contact_sd)
    )
    return ordered_budget(sds | {
        "model: course": math.sqrt(float(fit.row @ press.course @ fit.row)),
        "noise": press.noise * float(np.linalg.norm(fit.row)),
        "contact": 0.5 * abs(higher - lower),
        "contraction": math.sqrt(float(fit.chance @ (fit.phi - fit.mean_deg) ** 2)),
        "model: compaction": press.compaction_sd * math.sqrt(float(fit.chance @ COMPACT)),
        "model: soil": SOIL_SD_DEG,
        "model: law": math.sqrt(LAWS[press.law].sd_deg ** 2 - SOIL_SD_DEG**2),
        "grain size": GRAINS_DEG * press.grains,
    })  # fmt: skip


def _verdict(
    press: _Press, fit: _Fit, record: RecordFit, phi_deg: float, steady_sd: float
) -> Judgment:
    """Verdict, its reason, and the end of the law beyond which φ lies."""
    low, high = press.ends
    loosest = min(high - 0.1, LOOSE_DEG)
    if phi_deg > loosest:
        advice = (
            "check the diameter and the unit; dense or cohesive soil bears more than loose soil"
        )
        return out_of_range(
            press.law, "high", loosest, advice, "the densest soil that tools can read"
        )
    if fit.chance @ (fit.by_law < low + 0.1) > 0.5:
        advice = "check diameter and unit of the force, its sign and the zero of the sinkage"
        return out_of_range(press.law, "low", low, advice)
    if verdict := large_residual([record], "loose grains"):
        return verdict
    # One angle describes homogeneous soil at all depths; halves that disagree are layers, a wrong
    # tool or a wrong surface.
    deep = press.z > 0.5 * press.z[-1]
    upper, lower = (_angle_of(press, fit, part=half) for half in (~deep, deep))
    if abs(lower - upper) > HALVES * steady_sd:
        angles = f"φ = {upper:.0f}°, the lower half {lower:.0f}°"
        return misfit(f"the upper half gives {angles}; check tool, surface and layers.")
    return consistent([record], "loose soil")


def _angle_of(
    press: _Press, fit: _Fit, factor: float = 1.0, part: BoolArray | slice = slice(None)
) -> float:
    """φ of the force times a factor, over a part of the depth, at the likeliest node [deg]."""
    angles = np.arange(*press.ends, 0.1)
    curves = press.borne[fit.top] * press.curve(np.stack([angles, 0 * angles + fit.contact], -1))
    return float(angles[np.square((curves - factor * press.force)[:, part]).sum(axis=1).argmin()])


def _phi_of_force(press: _Press, fit: _Fit, phi_deg: float) -> dict[str, float | None]:
    """φ that half and twice the force would be read as [deg]; ``None`` outside of the law."""
    now, half, twice = (_angle_of(press, fit, factor) for factor in (1.0, 0.5, 2.0))
    low, high = press.ends[0] + 0.1, min(press.ends[1] - 0.2, LOOSE_DEG)
    return {
        name: phi_deg + angle - now if low < angle and phi_deg + angle - now <= high else None
        for name, angle in (("half", half), ("twice", twice))
    }


def _warnings(press: _Press, fit: _Fit, *, is_sound: bool) -> list[str]:
    """Sentences on depth, on a plate taken for a ball and, of a sound answer, on compaction."""
    sentences, deepest = [], 1e3 * DEEPEST * press.tool.radius
    if (bottom := 1e3 * press.z[-1]) > deepest:
        sentences.append(f"The law is extrapolated from {deepest:.0f} mm on, to {bottom:.0f} mm.")
    if (radii := press.z[-1] / press.tool.radius) < 1.0:
        depth = f"{radii:.1f} radii deep, where φ may be 8° wrong or more"
        sentences.append(f"It was pressed {depth}: press one radius deep at least.")
    if press.tool.shape.foot == "ball":
        disc = replace(press, tool=Tool.of(f"plate:{2e3 * press.tool.radius:g}"))
        ball, plate = (np.linalg.norm(press.force - f.model) for f in (fit, _fit(disc)))
        if ball > LIKE_DISC * plate:
            fits = f"{disc.tool} fits with {plate / ball:.0%} of the residual"
            sentences.append(f"The force grows as under a plate: a {fits}. Check the tool.")
    compacts = fit.chance[NODES[:, 0] < 0.1 * SIGNIFICANT].sum() < 0.05
    contraction = float(fit.chance @ NODES[:, 0])
    if is_sound and compacts and contraction > SIGNIFICANT:
        lower = f"The force begins {100.0 * contraction:.0f} % lower than the law's"
        sentences.append(f"{lower}: loose soil that compacts, or another zero of the sinkage.")
    return sentences


def _virgin(table: ToolTable, label: str) -> tuple[FloatArray, FloatArray, int, list[str]]:
    """Means over windows of the readings deeper than any before, less what is read in air."""
    sinkage, force, notes = table.values["sinkage"], table.values["force"], [*table.notes]
    top = float(force.max())
    # Of a test in steps of load every value is held; of a stroke the last one, or by a sensor that
    # saturates. Rough forces fall below that again, so that all that follows is left out.
    if len(np.unique(force)) > MOST_STEPS and is_ceiling(force, top, resolution(force)):
        end = 1 + int(force.argmax())
        held = f"from {top:.3g} N on, where the force stops (a load that is held, or a sensor that"
        notes.append(f"{len(force) - end} readings {held} saturates), are left out.")
        sinkage, force = sinkage[:end], force[:end]
    # On virgin loading each reading is deeper than all before it.
    deepest = np.maximum.accumulate(np.append(-np.inf, sinkage))[:-1]
    virgin = sinkage > deepest
    # Soil that was pressed bears no more than virgin soil did, down to where that was.
    borne = np.maximum.accumulate(np.where(virgin, force, -np.inf))
    if (count := np.count_nonzero(force > borne + EXCESS * top)) >= FEWEST_EXCESSES:
        fault = f"in {count} readings the force grows and the sinkage does not"
        raise InputError(f"{label}: {fault}; check its sensor, or cut the table to one stroke")
    if (~virgin).any():
        shallow = f"{(~virgin).sum()} of {len(virgin)} readings are no deeper than earlier ones"
        notes.append(f"{shallow} (unloading, rests) and left out.")
    z, f = sinkage[virgin], force[virgin]
    air = z < 0.0
    # Of the third farthest from the soil: coarse grains touch before the surface.
    far = z < np.quantile(z[air], 1.0 / 3.0) if air.sum() >= FEWEST_AIR else air & False
    zero = float(np.median(f[far])) if far.any() else 0.0
    f = f - zero
    if abs(zero) > TARED * np.abs(f).max(initial=0.0):
        notes.append(f"{zero:.3g} N are read above the soil and taken off.")
    z, f = z[z > 0.0], f[z > 0.0]
    at = np.minimum((z / z.max(initial=1e-9) * WINDOWS).astype(int), WINDOWS - 1)
    first = np.flatnonzero(np.diff(at, prepend=-1))
    if first.size < 8:
        depths = f"readings at {first.size} depths below the surface, 8 are needed"
        raise InputError(f"{label}: {depths}; state the surface by --columns sinkage_zero=VALUE")
    return block_means(z, first), block_means(f, first), z.size, notes
