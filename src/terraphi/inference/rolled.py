r"""The friction angle from a wheel: load at a sinkage and a slip, by law ``foot`` over the rim.

Each row i is read for itself, φ_i: the angle at which the rim carries the load
(:mod:`~terraphi.laws.wheel`), less what wheels in grains of known φ read too much. Rows of one
wheel have errors in common. So φ is their mean with weights 1 / C_ii, and its error that of the
covariance

.. math::
    C_{ij} = u_i u_j (K_{ij} + \tau^2 \delta_{ij})
             + \sum_t \frac{\partial\varphi_i}{\partial t}
               \frac{\partial\varphi_j}{\partial t} s_t^2,

u = ∂φ/∂ln W, K the error of the law's course over depth, τ the scatter of the rows, and t what all
rows share: the zero of the sinkage and the effect of the slip. Terms that move all rows alike do
not weigh, and come on top.

**Without a sinkage** φ comes from the resistance to the motion. At a given load each φ has its
sinkage by law ``foot``, and that the share of the load that resists,

.. math:: D = \frac{T/R - P}{W},

with the torque T, the radius R, the pull P and the load W. Friction adds to T/R and P alike, and
nearly cancels. In grains D differs from the law's by :data:`RESISTANCE_SD`, by +0.06 on average
without slip and by −0.05 at a slip of 0.5, and changes by 0.010 to 0.020 for each degree: ± 3 to
6°. Rows of one soil are taken to differ alike. Pull or torque alone show the friction of the rim.
The prior is uniform over the angles of dry soils.
"""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike

from terraphi.experiment.arrays import BoolArray, FloatArray, between_rows, block_means
from terraphi.experiment.errors import GUESSED, InputError, nearest
from terraphi.experiment.priors import FRICTION_BY_TORQUE_SD
from terraphi.experiment.rig import Tool
from terraphi.experiment.tables import ToolTable
from terraphi.experiment.wheel_reading import MEASURED
from terraphi.inference.answer import Answer, Estimate, RecordFit, normal_density
from terraphi.inference.pressed import (
    LOOSE_DEG,
    ROUGHER,
    SHAPE_LENGTH,
    SHAPE_SD,
    PressedRecord,
    open_pressed,
    tool_answer,
    tool_fit,
)
from terraphi.inference.terms import ordered_budget, root_sum_square
from terraphi.inference.verdict import (
    LITTLE_KNOWN,
    USUAL_DEG,
    Judgment,
    large_residual,
    misfit,
    out_of_range,
    unusual,
)
from terraphi.laws.wheel import (
    DEEPEST,
    FRICTIONS,
    SLIPS,
    THEORY_ERROR,
    WHEEL_ERROR,
    Wheel,
    WheelError,
    WheelForces,
    rolling,
    wheel_forces,
)
from terraphi.laws.wrench import angles_deg

SHOWN, MOST_SLIPS = 40, 9
"""Points of a picture, and of the law's sinkage, pull and torque in it."""
MOST_ROWS = 120
"""Rows up to which each is read; more are averaged in blocks, in their order."""
LEAST_BY_LOAD_DEG = 4.0
"""Least change of φ with ln of the load [deg]: inside the law it is 5 to 9."""
LEAST_SCATTER = 0.05
"""Scatter of ln W of rows that are few, or agree better [-]; chosen."""
MAD = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation [-]."""
ZERO_SD_M = 1e-3
"""Zero of the sinkage [m]; chosen."""
GRAIN_SD = 0.25
"""Error of the half grain that is added to the sinkage, over the diameter [-]; chosen."""
MOST_SIDE = 45.0
"""Largest side slip of rows that are read [deg]; chosen."""
LIMIT = 0.15
"""Residual of the load above which a record is a misfit, over the load itself or its range where
that is larger [-]; chosen: that of plates. A published wheel has 0.10."""
FULL_SLIP = 0.35
"""Slip from which on the torque shows the friction of rim and soil [-]."""
MOST_TORQUE = 1.2
"""Torque over that of the roughest rim up to which the friction is taken from it [-]; chosen."""
SLACK, OTHER_PULL = 0.02, 0.25
"""Power over load and speed [-] by which a pull may exceed the torque's, and difference of the pull
over the load from the law's above which it is named; wheels in grains have up to 0.22; chosen."""
SCATTERED_PULL = 0.2
"""Standard deviation of the pull less that of the law, over the load, above which it is named [-];
chosen: the shipped wheel has 0.05."""
OTHER_COURSE, OPPOSITE = 0.05, -0.8
"""Least range of the pull over the load, and correlation of it with the law's over the rows below
which its sign is named [-]; chosen."""
DRIVEN, OTHER_TORQUE = 0.1, 0.15
"""Slip from which on a wheel is driven for sure, and torque over load times radius above the
friction of the rim from which on it is named [-]; chosen."""
RESISTANCE_SD, ALONE_SD = 0.055, 0.10
"""Error of the resistance by pull and torque, and of either of them alone, over the load [-]:
wheels in grains (``studies/wheels.py`` prints the first; the second is chosen)."""
LUGS_SD = 0.3
"""Standard deviation of the friction of a rim with lugs [-]: they add up to 0.4 to pull and torque
alike; chosen."""
UNSUNK_ROWS = 20
"""Rows without a sinkage up to which each is read; more are averaged in blocks, in their order."""
FEW = np.arange(USUAL_DEG[0], USUAL_DEG[1] + 0.5)
"""Angles at which the law is computed without a sinkage [deg]."""
GRID = np.arange(USUAL_DEG[0], USUAL_DEG[1] + 0.01, 0.05)
"""Angles to which it is interpolated [deg]."""
STRAIGHT_DEG = 5.0
"""Largest side slip of rows without a sinkage [deg]; chosen."""
LEAST_SLOPE = 1e-4
"""Least change of the resistance D with φ that is divided by [1/deg]."""
DEEP = "the wheel would sink in deeper than law foot has at all angles; check load and diameter"
CONTRADICTION = 2.5
"""Difference from the nearest angle's resistance over its error that is a misfit [-]; chosen."""
STEP_DEG = 2.0
"""Step of the angles whose loads are computed [deg]: ln W is interpolated between them."""


@dataclass(frozen=True, eq=False)
class _Roll:
    """Rows of a wheel, and the law that they are read by."""

    wheel: Wheel
    density: float
    rows: dict[str, FloatArray]
    """Of :class:`~terraphi.experiment.tables.ToolTable`."""
    sinkage: FloatArray
    """With what grains add [m], shape [row]."""
    friction: float
    law: str

    @property
    def error(self) -> WheelError:
        """Of the law."""
        return WHEEL_ERROR if self.law == "foot" else THEORY_ERROR

    @property
    def too_much_deg(self) -> FloatArray:
        """What the law reads too much in grains, shape [row]."""
        return np.asarray(self.error.of(self.rows["slip"]))

    @cached_property
    def angles(self) -> FloatArray:
        """Angles of the law [deg]."""
        low = max(angles_deg(friction)[0] for friction in FRICTIONS)
        high = min(angles_deg(friction)[1] for friction in FRICTIONS)
        return np.linspace(low, high, round((high - low) / STEP_DEG) + 1)

    @cached_property
    def by_friction(self) -> FloatArray:
        """Ln of the load [N] at each of FRICTIONS and each angle, shape [friction, row, angle]."""
        return self.at(0.0, FRICTIONS)

    @cached_property
    def loads(self) -> FloatArray:
        """Ln of the load [N] at each angle, shape [row, angle]."""
        place = np.interp(self.friction, FRICTIONS, range(len(FRICTIONS)))
        return np.asarray(between_rows(self.by_friction, place))

    @cached_property
    def read_deg(self) -> FloatArray:
        """φ as the law reads each row [deg]; beyond the law, its ends, shape [row]."""
        return self.read(self.loads)

    def rougher(self, friction: float) -> _Roll:
        """The same rows on a rim of another friction, whose loads are interpolated as before."""
        other = replace(self, friction=friction)
        vars(other)["by_friction"] = self.by_friction  # as cached_property keeps it
        return other

    def at(self, moved: float, friction: ArrayLike) -> FloatArray:
        """Ln of the load at each angle, the rim moved down [m], shape [row, angle]."""
        load = self.forces(self.angles[:, None], friction, moved).load
        return np.log(np.maximum(load.swapaxes(-1, -2), 1e-12))

    def forces(self, phi_deg: FloatArray, friction: ArrayLike, moved: float = 0.0) -> WheelForces:
        """Forces on each row's wheel at angles [deg], shape [row] or [angle, 1]."""
        z = np.clip(self.sinkage + moved, 1e-5, DEEPEST * self.wheel.reach)
        return wheel_forces(
            self.wheel, z, self.rows["slip"], phi_deg=phi_deg, density=self.density,
            surface_friction=friction, side_slip_deg=self.rows["side_slip"], law=self.law,
        )  # fmt: skip

    def read(self, loads: FloatArray, factor: float = 1.0) -> FloatArray:
        """φ of each row by ln of the load at each angle [deg]; beyond the law, its ends."""
        measured = np.log(factor * self.rows["load"])
        pairs = zip(measured, np.maximum.accumulate(loads, axis=1), strict=True)
        return np.array([np.interp(w, row, self.angles) for w, row in pairs])


@dataclass(frozen=True, eq=False)
class _Mean:
    """φ of all rows, with the slopes of each row's reading."""

    phi: FloatArray
    """Of each row, less what grains read too much [deg]."""
    weight: FloatArray
    mean: float
    scatter: float
    """τ [-]."""
    by_load: FloatArray
    """u [deg]."""
    slopes: dict[str, FloatArray]
    """Error of φ of each row by one standard deviation of what rows share [deg]."""
    course: FloatArray
    """Covariance of the course [deg²], shape [row, row]."""


def _opened(record: PressedRecord, law: Any) -> tuple[_Roll, _Mean, float, list[str]]:
    """Rows of a record, their φ, the density's standard deviation over it [-], and notes.

    Raises InputError.
    """
    name, tool = str(law or "foot"), record.rig
    if name not in ("foot", "rft"):
        raise InputError(f"no law '{name}' of a wheel; {nearest(name, ('foot', 'rft'))}")
    if tool.shape.foot:
        raise InputError(f"{record.source}: rows of {tool}, not of a wheel")
    wheel, grain = wheel_of(tool), 1e-3 * record.grain_size_mm
    rows, notes = usable(record.table, wheel, record.source)
    rho, rho_sd = record.density_kg_m3, record.density_sd_kg_m3
    sinkage = np.minimum(rows["sinkage"] + 0.5 * grain, DEEPEST * wheel.reach)
    roll = _Roll(wheel, rho, rows, sinkage, tool.friction, name)
    # A row that no angle of the law explains tells nothing about the others.
    beyond = (roll.read_deg <= roll.angles[0]) | (roll.read_deg >= roll.angles[-1])
    if beyond.any() and beyond.mean() < 0.5:
        rows_out = f"{beyond.sum()} of {beyond.size} rows"
        notes.append(f"{rows_out} are left out: no angle of the law has their load and sinkage.")
        rows = {role: column[~beyond] for role, column in rows.items()}
        roll = replace(roll, rows=rows, sinkage=sinkage[~beyond])
    friction, friction_sd = tool.friction, tool.friction_sd
    is_given = "friction" in tool.model_fields_set
    if not is_given and (shown := _friction(roll)):
        friction, friction_sd = shown
        notes.append(f"{GUESSED}the friction of the rim from the torque: {friction:.2f}.")
        roll = roll.rougher(friction)
    elif not is_given:
        way = f"measure the torque at slips of {FULL_SLIP:g} or more, or give --friction"
        notes.append(f"The friction of the rim, {friction:.2f}, is assumed: {way}.")
    return roll, _mean(roll, grain, friction_sd), rho_sd / rho, notes


def invert_rolled(record: PressedRecord, law: Any = None) -> Answer:
    """Infer φ from a record of a wheel; raises InputError as :func:`invert` does."""
    began = time.perf_counter()
    if not record.table.has_sinkage:
        return _unsunk_answer(record, law, began)
    return _answer(record, law, began, *_opened(record, law))


def _answer(
    record: PressedRecord, law: Any, began: float, roll: _Roll, fit: _Mean, density_sd: float,
    notes: list[str],
) -> Answer:  # fmt: skip
    """The answer of a record as it was read."""
    budget = _budget(fit, density_sd, roll.error)
    posterior = normal_density(fit.mean, root_sum_square(budget))
    estimate = Estimate.of_density(*posterior)
    fitted = _record_fit(record, roll, fit, estimate)
    judgment, excess = _verdict(roll, fit, fitted)
    return tool_answer(
        record, law, began, judgment=judgment, posterior=posterior, budget_deg=budget,
        friction=roll.friction, records=(fitted,),
        phi_of_force_deg=_phi_of_force(roll, fit) if judgment[0] == "consistent" else None,
        warnings=(
            *_contradictions(roll, fit, excess), *notes,
            *unusual(estimate.median, "size of the wheel"),
        ),
        covariance=np.diag((fit.scatter * fitted.data[0]) ** 2),
    )  # fmt: skip


def phi_along(forces: Any, tool: Tool | str, **options: Any) -> dict[str, FloatArray]:
    """φ along the way of a wheel, row by row; long logs in blocks, :data:`MOST_ROWS` at most.

    Parameters
    ----------
    forces, tool
        As of :func:`terraphi.invert`.
    **options
        Its ``density``, ``grain_size_mm``, ``columns`` and ``law``.

    Returns
    -------
    dict
        Shape [row] each: ``phi_deg``; ``sd_relative_deg`` by what differs from row to row, for
        differences along the way; ``sd_deg`` by all errors, these NaN beyond the law; what the
        table has of ``time_s``, ``travel_m``, ``slip``, ``load_N`` and ``sinkage_mm``.

    Raises
    ------
    InputError
        As :func:`terraphi.invert`.

    Warns
    -----
    UserWarning
        With the warnings of the answer, and its reason if the verdict is not ``consistent``.
    """
    law = options.pop("law", None)
    record = open_pressed(forces, Tool.of(tool), **{"columns": None, **options})
    if not record.table.has_sinkage:
        raise InputError(f"{record.source}: φ along the way needs a sinkage")
    began = time.perf_counter()
    roll, fit, density_sd, _ = opened = _opened(record, law)
    answer = _answer(record, law, began, *opened)
    for sentence in (answer.reason, *answer.warnings)[answer.verdict == "consistent" :]:
        warnings.warn(sentence, stacklevel=2)
    # By neighbors, for φ may change along the way.
    steps = np.diff(fit.phi / fit.by_load)
    scatter = MAD * float(np.median(np.abs(steps))) / math.sqrt(2.0) if steps.size else fit.scatter
    alone = fit.by_load * max(scatter, LEAST_SCATTER)
    course = SHAPE_SD * fit.by_load
    slopes = np.array([*fit.slopes.values()])
    relative = np.sqrt(alone**2 + np.square(slopes - (slopes @ fit.weight)[:, None]).sum(axis=0))
    common = (density_sd * fit.by_load, roll.error.soil_deg, roll.error.law_deg)
    variance = (
        alone**2 + course**2 + np.square(slopes).sum(axis=0) + sum(np.square(x) for x in common)
    )
    names = {"time": ("time_s", 1.0), "travel": ("travel_m", 1.0), "slip": ("slip", 1.0),
             "load": ("load_N", 1.0), "sinkage": ("sinkage_mm", 1e3)}  # fmt: skip
    given = {name: factor * roll.rows[role] for role, (name, factor) in names.items()
             if role in roll.rows}  # fmt: skip
    is_in_range = (roll.read_deg > roll.angles[0]) & (roll.read_deg < roll.angles[-1])
    is_in_range &= fit.phi <= LOOSE_DEG
    angles = np.where(is_in_range, [fit.phi, relative, np.sqrt(variance)], math.nan)
    return given | dict(zip(("phi_deg", "sd_relative_deg", "sd_deg"), angles, strict=True))


def wheel_of(tool: Tool) -> Wheel:
    """The wheel of a tool of that shape."""
    diameter, width, *lugs = tool.size_mm
    number, height = lugs or (0.0, 0.0)
    return Wheel(5e-4 * diameter, 1e-3 * width, int(number), 1e-3 * height)


def usable(
    table: ToolTable, wheel: Wheel, label: str, most: int = MOST_ROWS
) -> tuple[dict[str, FloatArray], list[str]]:
    """Rows within what the law has, averaged in blocks where they are many; notes on the rest."""
    notes, values = list(table.notes), table.values
    slip, side, sunk = values["slip"], np.abs(values["side_slip"]), values["sinkage"]
    ends, limit = f"{SLIPS[0]:g} and {SLIPS[1]:g}", f"{1e3 * DEEPEST * wheel.reach:.0f} mm"
    # Rows that the law does not have, the sentence if there are no others, and why they are left
    # out.
    faults = (
        ((slip < SLIPS[0]) | (slip > SLIPS[1]) | (side > MOST_SIDE),
         (f"no row with a slip between {ends} at a side slip below {MOST_SIDE:g}°, but of "
          f"{slip.min():.2g} to {slip.max():.2g}; wheels that dig in are not read"),
         f"slip beyond {ends}, or side slip beyond {MOST_SIDE:g}°"),
        (sunk <= wheel.bare,
         f"the lugs alone are in the soil, up to {1e3 * wheel.bare:.0f} mm; give that of tips",
         "the lugs alone are in the soil"),
        (sunk > DEEPEST * wheel.reach,
         f"the wheel sinks in deeper than {limit}, {DEEPEST:g} of the radius; check its diameter",
         f"deeper than {limit}, {DEEPEST:g} of the radius"),
    )  # fmt: skip
    is_in_range = np.ones(slip.size, dtype=bool)
    for fault, refusal, reason in faults:
        if fault[is_in_range].all():
            raise InputError(f"{label}: {refusal}")
        if fault.any():
            notes.append(f"{fault.sum()} of {fault.size} rows are left out: {reason}.")
        is_in_range &= ~fault
    kept = {name: value[is_in_range] for name, value in values.items()}
    if (count := kept["slip"].size) > most:
        first = np.unique(np.linspace(0, count, most, endpoint=False).astype(int))
        columns = np.stack(list(kept.values()), axis=1)
        there = block_means(np.isfinite(columns).astype(float), first)
        with np.errstate(invalid="ignore"):  # a block without a torque has none
            means = block_means(np.nan_to_num(columns), first) / there
        kept = dict(zip(kept, means.T, strict=True))
    return kept, notes


def _friction(roll: _Roll) -> tuple[float, float] | None:
    """Friction between rim and soil, by the torque of rows that slip fully, with its error [-]."""
    torque = roll.rows.get("torque", np.full(roll.sinkage.size, math.nan))
    slips = (roll.rows["slip"] >= FULL_SLIP) & np.isfinite(torque)
    if not slips.any() or roll.wheel.carried > 0.0:
        return None
    # T / (W R) at the angle at which the rim carries the load hardly depends on that angle.
    ratio = float(np.median(torque[slips] / (roll.rows["load"][slips] * roll.wheel.reach)))
    middle = np.full(roll.sinkage.size, 32.0)
    rims = (roll.forces(middle, friction) for friction in FRICTIONS)
    model = [float(np.median((forces.torque / forces.load)[slips])) / roll.wheel.reach
             for forces in rims]  # fmt: skip
    if not 0.5 * model[0] <= ratio <= MOST_TORQUE * model[-1]:
        return None  # named by _contradictions
    return float(np.interp(ratio, model, FRICTIONS)), FRICTION_BY_TORQUE_SD


def _mean(roll: _Roll, grain: float, friction_sd: float) -> _Mean:
    """φ of the rows by generalized least squares; ``grain`` is the diameter [m]."""
    step, middle, ends = 2e-4, FRICTIONS[1], (FRICTIONS[0], FRICTIONS[-1])
    by_load = (roll.read(roll.loads, 1.02) - roll.read(roll.loads, 0.98)) / math.log(1.02 / 0.98)
    by_load = np.maximum(by_load, LEAST_BY_LOAD_DEG)  # beyond the law the angle is its end
    by_depth = (roll.read(roll.at(step, middle)) - roll.read(roll.at(-step, middle))) / (2.0 * step)
    rough, smooth = (roll.read(roll.by_friction[i]) for i in (-1, 0))
    by_friction = (rough - smooth) / (ends[1] - ends[0])
    phi = roll.read_deg - roll.too_much_deg
    slopes = {
        "contact": by_depth * math.hypot(ZERO_SD_M, GRAIN_SD * grain),
        "slip": roll.error.sd_by_slip(roll.rows["slip"]),
        "surface friction": by_friction * friction_sd,
    }
    z, rows = roll.sinkage, np.outer(by_load, by_load)
    distance = np.abs(np.log(z[:, None] / z))
    course = SHAPE_SD**2 * np.exp(-distance / SHAPE_LENGTH) * rows
    scatter = LEAST_SCATTER
    if z.size > 2:
        residual = (phi - np.median(phi)) / by_load
        scatter = max(MAD * float(np.median(np.abs(residual))), LEAST_SCATTER)
    # Best weights of rows that share most of their error have both signs, and a few rows decide.
    # Those of independent rows cost little, and the mean lies within the rows.
    alone = course.diagonal() + (scatter * by_load) ** 2
    weight = 1.0 / (alone + sum(np.square(slope) for slope in slopes.values()))
    weight /= weight.sum()
    return _Mean(phi, weight, float(weight @ phi), scatter, by_load, slopes, course)


def _budget(fit: _Mean, density_sd: float, error: WheelError) -> dict[str, float]:
    """Standard deviation of φ by term [deg]; that of the density is relative [-]."""
    w = fit.weight
    return ordered_budget({
        **{name: abs(float(w @ slope)) for name, slope in fit.slopes.items()},
        "noise": fit.scatter * float(np.linalg.norm(w * fit.by_load)),
        "model: course": math.sqrt(float(w @ fit.course @ w)),
        "density": density_sd * abs(float(w @ fit.by_load)),
        "model: soil": error.soil_deg,
        "model: law": error.law_deg,
    })  # fmt: skip


def _record_fit(record: PressedRecord, roll: _Roll, fit: _Mean, estimate: Estimate) -> RecordFit:
    """The rows over their slip, and the law's loads at one φ for all of them."""
    order = np.argsort(roll.rows["slip"], kind="stable")
    law = fit.mean + roll.too_much_deg  # φ as the law reads each row

    def curve(moved: float) -> FloatArray:
        pairs = zip((law + moved)[order], roll.loads[order], strict=True)
        return np.exp([np.interp(phi, roll.angles, row) for phi, row in pairs])

    model, data = curve(0.0), roll.rows["load"][order]
    ends = [curve(end - estimate.median) for end in estimate.ci95]
    size = max(float(np.ptp(data)), float(data.mean()))
    nrmsd = float(np.sqrt(np.mean((data - model) ** 2))) / size
    slope = (curve(0.1) - curve(-0.1)) / 0.2
    # A long log is shown by means over neighboring slips.
    groups = np.array_split(np.arange(order.size), min(order.size, SHOWN))
    measured = _measured(roll.rows, roll.sinkage)[:, order]
    rows = np.stack([roll.rows["slip"][order], data, model, *ends, slope, *measured])
    shown = np.stack([rows[:, group].mean(axis=1) for group in groups], axis=1)
    return tool_fit(record, estimate.median, shown[0], shown[1], [*shown[2:5]], shown[5],
                    {"Fz": nrmsd}, LIMIT, measured=shown[6:])  # fmt: skip


def _measured(rows: dict[str, FloatArray], sinkage: FloatArray) -> FloatArray:
    """Load [N], sinkage [mm], pull [N] and torque [N m], NaN where there are none, [4, row]."""
    none = np.full(sinkage.size, math.nan)
    pull_and_torque = (rows.get(name, none) for name in MEASURED)
    return np.stack([rows["load"], 1e3 * sinkage, *pull_and_torque])


def draw_rolled(
    panels: Sequence[Any], record: RecordFit, answer: Answer, colour: str, dots: str
) -> None:
    """Draw sinkage, pull and torque of a wheel, measured and by law ``foot``, over the slip.

    At the measured loads, φ of the answer and both ends of its 95 %.
    """
    loads, *measured = np.asarray(record.measured)
    # Of several answers whose bodies differ in friction, that which was taken beforehand.
    rim = cast("Tool", record.rig)
    friction = answer.leg_friction or rim.friction
    at = np.unique(np.linspace(0, loads.size - 1, min(loads.size, MOST_SLIPS)).round().astype(int))
    angles = np.array([answer.phi.median, *answer.phi.ci95])
    forces = rolling(
        wheel_of(rim), loads[at], record.theta_deg[at], angles,
        0.0 * angles + answer.density_kg_m3, surface_friction=friction,
    )  # fmt: skip
    labels = "sinkage [mm]", "pull [N]", "torque [N m]"
    for axes, label, points, curves in zip(panels, labels, measured, forces.values(), strict=True):
        axes.plot(record.theta_deg[at], curves[0], color=colour)
        ends = curves.min(axis=0), curves.max(axis=0)
        axes.fill_between(record.theta_deg[at], *ends, color=colour, alpha=0.2, lw=0)
        axes.plot(record.theta_deg, points, ".", color=dots, ms=7, mec="black", mew=0.4)
        axes.set(xlabel="slip", ylabel=label)


def _verdict(roll: _Roll, fit: _Mean, record: RecordFit) -> tuple[Judgment, str]:
    """Verdict, and name of the reading that is larger than soil of this φ bears; empty of none."""
    median, low, high = np.median(roll.read_deg), roll.angles[0] + 0.1, roll.angles[-1] - 0.1
    advice = "check diameter, width, load and sinkage, their units and the zero of the sinkage"
    if median >= high or fit.mean > LOOSE_DEG:
        end = min(LOOSE_DEG, high)
        densest = "the densest soil that wheels can read"
        return out_of_range(roll.law, "high", end, advice, densest), ""
    if median <= low:
        return out_of_range(roll.law, "low", low, advice), ""
    # A wheel that drives pulls less than its torque over the radius.
    # Soil bears at most tan φ of the normal force as shear, with two errors of the law.
    most = math.tan(math.radians(fit.mean + 2.0 * roll.error.law_deg))
    for name, over, arm in (
        ("torque", "load times radius", roll.wheel.reach), ("pull", "load", 1.0)
    ):  # fmt: skip
        shear = roll.rows.get(name, np.zeros(1)) / (roll.rows["load"] * arm)
        shear = np.abs(shear[np.isfinite(shear)])
        if shear.size and (ratio := float(np.median(shear))) > most:
            ratios = f"{ratio:.2f} of {over}, and soil of this angle bears {most:.2f}"
            reason = f"the {name} is {ratios}; check their columns, units, gear and zero."
            return misfit(reason), name
    return _by_residual(record, "follows the load within {:.0%}, usual for wheels"), ""


def _by_residual(record: RecordFit, follows: str) -> Judgment:
    """Verdict by the residual; of a small one ``follows`` says what the law does, and how well."""
    [residual] = record.nrmsd.values()
    if verdict := large_residual([record], "wheels in grains"):
        return verdict
    share = follows.format(residual).replace("%", " %")
    return "consistent", f"Consistent: the law {share}.", None


def _phi_of_force(roll: _Roll, fit: _Mean) -> dict[str, float | None]:
    """φ that half and twice the load would be read as [deg]; ``None`` outside of the law."""
    scaled: dict[str, float | None] = {}
    for name, factor in (("half", 0.5), ("twice", 2.0)):
        rows = roll.read(roll.loads, factor)
        is_in_range = (rows > roll.angles[0]) & (rows < roll.angles[-1])
        phi = fit.mean + float(fit.weight @ (rows - roll.read_deg))
        scaled[name] = phi if is_in_range[fit.weight > 0.0].all() and phi < LOOSE_DEG else None
    return scaled


def _contradictions(roll: _Roll, fit: _Mean, excess: str) -> list[str]:
    """Sentences on a torque beyond the rim, and a pull that contradicts the torque or the law.

    A torque that is too large by the verdict is not named once more.
    """
    rows, reach = roll.rows, roll.wheel.reach
    sentences: list[str] = []
    driven: BoolArray = rows["slip"] > DRIVEN
    if "torque" in rows and driven.any():
        ratio = float(np.nanmedian((rows["torque"] / (rows["load"] * reach))[driven]))
        if ratio < -SLACK:
            sentences.append("The torque brakes a wheel that slips forward: check its sign.")
        elif ratio > roll.friction + OTHER_TORQUE and excess != "torque":
            sentences.append(
                f"The torque is {ratio:.2f} of load times radius, and a rim of friction "
                f"{roll.friction:.2f} bears less: check the diameter and the torque's unit."
            )
    if "pull" not in rows:
        return sentences
    if "torque" in rows and driven.any():
        # What the wheel pulls over its way is less than what the motor gives: P v ≤ T ω.
        power = rows["torque"] / reach - rows["pull"] * (1.0 - np.maximum(rows["slip"], 0.0))
        if float(np.nanmedian((power / rows["load"])[driven])) < -SLACK:
            sentences.append("The wheel pulls more than its torque gives: check signs and units.")
    phi = np.clip(fit.mean + roll.too_much_deg, roll.angles[0], roll.angles[-1])
    law = roll.forces(phi, roll.friction)
    pulls = np.array([rows["pull"] / rows["load"], law.pull / law.load])
    pulls = pulls[:, np.isfinite(pulls).all(axis=0)]
    difference = float(np.median(pulls[0] - pulls[1]))
    is_course = pulls.shape[1] > 2 and np.ptp(pulls, axis=1).min() > OTHER_COURSE
    if is_course and np.corrcoef(pulls)[0, 1] < OPPOSITE:
        sentences.append("The pull falls with the slip, and the law's rises: check its sign.")
    elif (scatter := float(np.std(pulls[0] - pulls[1]))) > SCATTERED_PULL:
        sentences.append(f"The pull scatters by {scatter:.2f} of the load: check its column.")
    if abs(difference) > OTHER_PULL:
        other = f"The pull differs from the law's by {difference:+.2f} of the load"
        sentences.append(f"{other}: check its sign, unit and zero, and the friction of the rim.")
    return sentences


# -- without a sinkage ----------------------------------------------------------------------------


class _Resisted(NamedTuple):
    """Rows of a wheel without a sinkage, and what the law has for them."""

    wheel: Wheel
    rows: dict[str, FloatArray]

    @property
    def has_both(self) -> bool:
        """True if pull and torque were measured."""
        return {*MEASURED} <= {*self.rows}

    def share(self, pull: Any, torque: Any) -> FloatArray:
        """D [-], of pull [N] or torque [N m] alone where the rows have no other."""
        pull = pull if "pull" in self.rows else 0.0
        torque = torque / self.wheel.reach if "torque" in self.rows else 0.0
        return np.asarray((torque - pull) / self.rows["load"])

    def curves(self, frictions: ArrayLike, densities: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """D [-] and sinkage [mm] by the law on GRID, [friction, density, grid, row]; NaN beyond it.

        The forces of all densities are the same but for their scale, and those at all frictions
        lie between the same few.
        """
        soils = np.tile(FEW, np.size(densities)), np.repeat(densities, FEW.size)
        forces = rolling(
            self.wheel, self.rows["load"], self.rows["slip"], *soils, surface_friction=frictions
        )
        shares = self.share(forces["pull_N"], forces["torque_Nm"])
        shape = np.size(frictions), np.size(densities), FEW.size, self.rows["load"].size
        model, sunk = (
            np.apply_along_axis(lambda few: np.interp(GRID, FEW, few), 2, values.reshape(shape))
            for values in (shares, forces["sinkage_mm"])
        )
        return model, sunk


def _unsunk_answer(record: PressedRecord, law: Any, began: float) -> Answer:
    """Infer φ from slip, load, torque and pull; raises InputError."""
    tool = record.rig
    if law not in (None, "foot"):
        raise InputError(f"{record.source}: without a sinkage wheels have law foot alone")
    wheel = wheel_of(tool)
    rows, notes = usable(record.table, wheel, record.source, UNSUNK_ROWS)
    if np.abs(rows["side_slip"]).max() > STRAIGHT_DEG:
        raise InputError(f"{record.source}: a wheel with side slip needs a sinkage")
    order = np.argsort(rows["slip"], kind="stable")
    resisted = _Resisted(wheel, {name: row[order] for name, row in rows.items()})
    rho, rho_sd = record.density_kg_m3, record.density_sd_kg_m3
    measured = resisted.share(*(resisted.rows.get(name) for name in MEASURED))
    smooth, rough = np.clip(tool.friction + np.array([-ROUGHER, ROUGHER]), *FRICTIONS[::2])
    curves, sunk = resisted.curves([tool.friction, smooth, rough], [rho, rho + rho_sd])
    model, sunk, means = curves[0, 0], sunk[0, 0], curves.mean(axis=-1)
    mean = means[0, 0]
    if np.isnan(mean).all():
        raise InputError(f"{record.source}: {DEEP}")
    nearest = int(np.nanargmin(np.abs(mean - measured.mean())))
    by_phi = np.gradient(mean, GRID)
    # Errors of the mean D by cause [-], one standard deviation each, shape [grid].
    errors = {
        "resistance": RESISTANCE_SD if resisted.has_both else ALONE_SD,
        "surface friction": (LUGS_SD if wheel.lugs else tool.friction_sd)
        * (means[2, 0] - means[1, 0]) / (rough - smooth),
        "noise": float(np.std(measured - model[nearest])) / math.sqrt(measured.size),
        "density": means[0, 1] - mean,
        "slip": by_phi * float(np.mean(WHEEL_ERROR.sd_by_slip(resisted.rows["slip"]))),
        "model: soil": by_phi * WHEEL_ERROR.soil_deg,
        "model: law": by_phi * WHEEL_ERROR.law_deg,
    }  # fmt: skip
    sd = np.sqrt(sum(np.square(error) for error in errors.values()))
    deviate = (measured.mean() - mean) / sd
    chance = np.nan_to_num(np.exp(-0.5 * deviate**2) / sd)
    posterior = GRID, chance / np.trapezoid(chance, GRID)
    estimate = Estimate.of_density(*posterior)
    at = int(np.abs(GRID - estimate.median).argmin())
    slope = max(abs(float(by_phi[at])), LEAST_SLOPE)
    budget = ordered_budget(
        {name: float((np.abs(error) + 0.0 * GRID)[at]) / slope for name, error in errors.items()}
    )
    deep = np.interp(estimate.ci68[::-1], GRID, np.median(sunk, axis=1))
    depths = f"{deep[0]:.0f} to {deep[1]:.0f} mm"
    notes = [f"No sinkage was measured: the law has {depths} (68 %).", *notes]
    if root_sum_square(budget) > float(np.ptp(USUAL_DEG)) / math.sqrt(12.0):
        notes.insert(0, LITTLE_KNOWN)
    fitted = _unsunk_fit(record, resisted, measured, model, estimate)
    judgment = _by_residual(fitted, "has the resistance within {:.0%} of the load")
    if np.nanmin(np.abs(deviate)) > CONTRADICTION:
        check = "check signs, units and zero of both, the diameter and the friction"
        judgment = misfit(f"no angle has this pull and torque at this load; {check}.")
    return tool_answer(
        record, law, began, judgment=judgment, posterior=posterior, budget_deg=budget,
        records=(fitted,), warnings=notes,
        covariance=np.diag((sd[at] * resisted.rows["load"]) ** 2),
    )  # fmt: skip


def _unsunk_fit(
    record: PressedRecord, resisted: _Resisted, measured: FloatArray, model: FloatArray,
    estimate: Estimate,
) -> RecordFit:  # fmt: skip
    """Resistance T/R − P [N] over the slip, or pull or torque alone in its place."""
    load = resisted.rows["load"]
    data = load * measured
    *curves, above = (
        load * model[np.abs(GRID - angle).argmin()]
        for angle in (estimate.median, *estimate.ci95, estimate.median + 1.0)
    )
    size = max(float(np.ptp(data)), float(load.mean()))
    return tool_fit(
        record, estimate.median, resisted.rows["slip"], data, curves, above - curves[0],
        {"Fx": float(np.sqrt(np.mean((data - curves[0]) ** 2))) / size},
        LIMIT if resisted.has_both else None, measured=_measured(resisted.rows, load + math.nan),
    )  # fmt: skip
