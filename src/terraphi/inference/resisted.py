r"""The friction angle from a wheel whose sinkage was not measured: by the resistance to its motion.

At a given load each φ has its sinkage z by law ``foot`` over the rim, and z the share of the load
that resists the motion,

.. math:: D = \frac{T/R - P}{W},

with the torque T, the pull P, the load W and the radius R. Friction adds to T/R and P alike, and
nearly cancels. In grains D differs from the law's by :data:`RESISTANCE_SD`, by +0.06 on average
without slip and by −0.05 at a slip of 0.5, and changes by 0.010 to 0.020 for each degree: ± 3 to
6°. Rows of one soil are taken to differ alike. Pull or torque alone show the
friction of the rim. The prior is uniform over the angles of dry soils.
"""

from __future__ import annotations

import math
import time
from typing import Any, NamedTuple

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError
from terraphi.experiment.rig import Tool
from terraphi.experiment.wheel_reading import MEASURED, Rolled
from terraphi.inference.answer import Answer, Estimate, RecordFit
from terraphi.inference.pressed import PressedRecord, tool_answer
from terraphi.inference.rolled import LIMIT, usable, wheel_of
from terraphi.inference.terms import ordered_budget, root_sum_square
from terraphi.inference.verdict import LITTLE_KNOWN, USUAL_DEG, Judgment, large_residual
from terraphi.laws.wheel import FRICTIONS, WHEEL_ERROR, Wheel, rolling

RESISTANCE_SD, ALONE_SD = 0.055, 0.10
"""Error of the resistance by pull and torque, and of either of them alone, over the load [-]:
wheels in grains (``studies/wheels.py`` prints the first; the second is chosen)."""
LUGS_SD = 0.3
"""Standard deviation of the friction of a rim with lugs [-]: they add up to 0.4 to pull and torque
alike; chosen."""
ROUGHER = 0.1
"""Difference of the friction by which its effect is found [-]."""
MOST = 20
"""Rows up to which each is read; more are averaged in blocks, in their order."""
FEW = np.arange(USUAL_DEG[0], USUAL_DEG[1] + 0.5)
"""Angles at which the law is computed [deg]."""
GRID = np.arange(USUAL_DEG[0], USUAL_DEG[1] + 0.01, 0.05)
STRAIGHT_DEG = 5.0
"""Largest side slip [deg]; chosen."""
LEAST_SLOPE = 1e-4
"""Least change of D with φ that is divided by [1/deg]."""
DEEP = "the wheel would sink in deeper than law foot has at all angles; check load and diameter"
CONTRADICTION = 2.5
"""Difference from the nearest angle's resistance over its error that is a misfit [-]; chosen."""


class _Resisted(NamedTuple):
    """Rows of a wheel without a sinkage, and what the law has for them."""

    tool: Tool
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

    def curves(self, friction: float, density: float) -> tuple[FloatArray, FloatArray]:
        """D [-] and the sinkage [mm] on GRID by the law, shape [grid, row]; NaN beyond it."""
        forces = rolling(
            self.wheel, self.rows["load"], self.rows["slip"], FEW, 0.0 * FEW + density,
            surface_friction=friction,
        )  # fmt: skip
        shares = self.share(forces["pull_N"], forces["torque_Nm"])
        model, sunk = (
            np.stack([np.interp(GRID, FEW, row) for row in values.T], axis=1)
            for values in (shares, forces["sinkage_mm"])
        )
        return model, sunk

    def errors(self, model: FloatArray, noise: float, rho: float, rho_sd: float) -> dict[str, Any]:
        """Errors of the mean D by cause [-], one standard deviation each, shape [grid]."""
        friction, mean = self.tool.friction, model.mean(axis=1)
        ends = np.clip(friction + np.array([-ROUGHER, ROUGHER]), FRICTIONS[0], FRICTIONS[-1])
        smoother, rougher = (self.curves(end, rho)[0].mean(axis=1) for end in ends.tolist())
        friction_sd = LUGS_SD if self.wheel.lugs else self.tool.friction_sd
        slope = np.gradient(mean, GRID)
        return {
            "resistance": RESISTANCE_SD if self.has_both else ALONE_SD,
            "surface friction": friction_sd * (rougher - smoother) / float(np.ptp(ends)),
            "noise": noise / math.sqrt(model.shape[1]),
            "density": self.curves(friction, rho + rho_sd)[0].mean(axis=1) - mean,
            "slip": slope * float(np.mean(WHEEL_ERROR.sd_by_slip(self.rows["slip"]))),
            "model: soil": slope * WHEEL_ERROR.soil_deg,
            "model: law": slope * WHEEL_ERROR.law_deg,
        }


def invert_resisted(record: PressedRecord, law: Any = None) -> Answer:
    """Infer φ from slip, load, torque and pull; raises InputError as :func:`invert` does."""
    began, tool = time.perf_counter(), record.rig
    if law not in (None, "foot") or not isinstance(record.table, Rolled):
        raise InputError(f"{record.source}: without a sinkage wheels have law foot alone")
    wheel = wheel_of(tool)
    rows, notes = usable(record.table, wheel, record.source, MOST)
    if np.abs(rows["side_slip"]).max() > STRAIGHT_DEG:
        raise InputError(f"{record.source}: a wheel with side slip needs a sinkage")
    order = np.argsort(rows["slip"], kind="stable")
    resisted = _Resisted(tool, wheel, {name: row[order] for name, row in rows.items()})
    rho, rho_sd = record.bulk_density
    measured = resisted.share(*(resisted.rows.get(name) for name in MEASURED))
    model, sunk = resisted.curves(tool.friction, rho)
    mean = model.mean(axis=1)
    if np.isnan(mean).all():
        raise InputError(f"{record.source}: {DEEP}")
    nearest = int(np.nanargmin(np.abs(mean - measured.mean())))
    errors = resisted.errors(model, float(np.std(measured - model[nearest])), rho, rho_sd)
    sd = np.sqrt(sum(np.square(error) for error in errors.values()))
    deviate = (measured.mean() - mean) / sd
    chance = np.nan_to_num(np.exp(-0.5 * deviate**2) / sd)
    posterior = GRID, chance / np.trapezoid(chance, GRID)
    estimate = Estimate.of_density(*posterior)
    at = int(np.abs(GRID - estimate.median).argmin())
    slope = max(abs(float(np.gradient(mean, GRID)[at])), LEAST_SLOPE)
    budget = ordered_budget(
        {name: float((np.abs(error) + 0.0 * GRID)[at]) / slope for name, error in errors.items()}
    )
    deep = np.interp(estimate.ci68[::-1], GRID, np.median(sunk, axis=1))
    depths = f"{deep[0]:.0f} to {deep[1]:.0f} mm"
    notes = [f"No sinkage was measured: the law has {depths} (68 %).", *notes]
    if root_sum_square(budget) > float(np.ptp(USUAL_DEG)) / math.sqrt(12.0):
        notes.insert(0, LITTLE_KNOWN)
    fitted = _fit(record, resisted, measured, model, estimate)
    return tool_answer(
        record, "foot", began, is_default=not law, posterior=posterior, budget_deg=budget,
        judgment=_verdict(float(np.nanmin(np.abs(deviate))), fitted), records=(fitted,),
        warnings=notes, covariance=np.diag((sd[at] * resisted.rows["load"]) ** 2),
    )  # fmt: skip


def _fit(
    record: PressedRecord, resisted: _Resisted, measured: FloatArray, model: FloatArray,
    estimate: Estimate,
) -> RecordFit:  # fmt: skip
    """Resistance T/R − P [N] over the slip, or pull or torque alone in its place."""
    angles = np.array([estimate.median, *estimate.ci95, estimate.median + 1.0])
    load = resisted.rows["load"]
    data = load * measured
    rows = [load * model[np.abs(GRID - angle).argmin()] for angle in angles.tolist()]
    size = max(float(np.ptp(data)), float(load.mean()))
    return RecordFit(
        source=record.source,
        rig=record.rig,
        simulated=False,
        n_readings=record.table.rows,
        theta_deg=resisted.rows["slip"],
        data=data[None],
        curve=rows[0][None],
        band=np.sort(rows[:3], axis=0)[::2, None],
        nrmsd={"Fx": float(np.sqrt(np.mean((data - rows[0]) ** 2))) / size},
        limit=LIMIT if resisted.has_both else None,
        tangent=np.stack([rows[0] - (rows[3] - rows[0]) * estimate.median, rows[3] - rows[0]])[
            :, None
        ],
    )


def _verdict(least: float, fitted: RecordFit) -> Judgment:
    """Verdict by the distance from the nearest angle's resistance over its error [-]."""
    if least > CONTRADICTION:
        return "misfit", (
            "Misfit: no angle has this pull and torque at this load; check signs, units and zero "
            "of both, the diameter and the friction. Do not use the angle."
        ), None  # fmt: skip
    if misfit := large_residual([fitted], "wheels in grains"):
        return misfit
    within = 100.0 * fitted.nrmsd["Fx"]
    reason = f"Consistent: the law has the resistance within {within:.0f} % of the load."
    return "consistent", reason, None
