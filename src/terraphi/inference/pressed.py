r"""The friction angle from a body pressed straight down: force over sinkage, by a law of a foot.

The force is m(z) F(φ, z + z₀) with the contact z₀ and the mobilization m = 1 − A exp(−z / (b R)) of
loose soil that compacts before it bears. For each node of A and b, φ and z₀ are fitted; the nodes'
weights are their likelihood times the prior, exp(−A / A₀). How well that holds in real sand is
known from one, and is a term of its own that grows with A.
"""

from __future__ import annotations

import importlib.metadata
import math
import time
from pathlib import Path
from typing import Any

import numpy as np

from terraphi.experiment.arrays import FloatArray, IntArray
from terraphi.experiment.errors import InputError, nearest
from terraphi.experiment.reading import read_pressed
from terraphi.experiment.rig import Tool
from terraphi.inference.answer import Answer, Edge, Estimate, RecordFit, Verdict
from terraphi.inference.estimator import least_squares, weights
from terraphi.inference.likelihood import UNKNOWN_DENSITY
from terraphi.inference.records import density_doubts, density_with_sd, roughness
from terraphi.laws.foot import DEEPEST, LAWS, Foot
from terraphi.laws.store import PHI

WINDOWS = 40
"""Equal windows of sinkage."""
DENSITY = 1600.0
"""Density of which nothing is said [kg/m³]."""
FRICTION, FRICTION_SD = 0.5, 0.15
"""Between body and soil [-]."""
SHAPE_SD, SHAPE_LENGTH, FLOOR = 0.08, 1.0, 0.02
"""Error of a law's course over depth [-], its correlation length in ln z, and an independent error
over the largest force: chosen; laws follow loose grains within 5 to 10 %."""
SOIL_SD_DEG = 1.4
"""Of the error of laws of feet, the part by which soils differ [deg]: 1.4 to 1.6 for five laws in
loose grains (``docs/plates.md``). Soils in which feet read low are those in which legs do."""
DEEP_SD = 0.10
"""Error of laws for each radius beyond :data:`~terraphi.laws.foot.DEEPEST` [-], chosen."""
CONTACT_M, CONTACT = 1e-3, 0.03
"""Error of the first contact: the larger of a length [m] and a part of the radius."""
CONTRACTIONS, PRIOR, EXPONENTS = np.linspace(0.0, 0.98, 15), 0.25, np.array([1.3, 2.0, 3.0])
"""Nodes of A, the mean of its prior, and nodes of b [-]."""
SIGNIFICANT = 0.3
"""A from which an answer names it, with a chance below 5 % that it is a tenth of this [-]."""
COMPACTING_DEG, MOSTLY = 4.0, 0.4
"""Standard deviation of φ of soil that compacts [deg], and the A from which it is all of that: six
plates on the loosest Cullinan sand (A from 0.34 to 0.98) read 7° less to 1° more than its triaxial
tests, root mean square 4° (``studies/sheared_sands.py``). No other sand is known, so that the
interval is as wide on both sides."""
APART, BOUND = 3.0, 0.8
"""Difference of φ between both halves of the depth over its standard deviation, and A, above which
a record is a misfit [-]: chosen. Measured plates of 60 and 100 mm on sand with an angle of repose
of 29° have A from 0.87 on and φ from 41° on: the correction carries them, not the law."""
LIMIT = 0.15
"""Residual above which a record is a misfit, over the range of the force [-]."""
FEWEST_AIR = 6
"""Readings in air that a zero needs (chosen)."""
TARED = 0.01
"""Force in air over the largest from which it is named [-]."""
RANGE_DEG = np.arange(10.0, 55.5, 0.5)


def invert_pressed(
    source: Any,
    text: str,
    *,
    density: float | str | None = None,
    law: Any = None,
    columns: Any = None,
) -> Answer:
    """Infer φ from a table of sinkage and force; raises InputError as :func:`invert` does."""
    began, tool, name = time.perf_counter(), Tool.of(text), str(law or "foot")
    if name not in LAWS:
        raise InputError(f"no law '{name}' of a tool; {nearest(name, tuple(LAWS))}")
    radius = tool.radius
    table = read_pressed(source, math.pi * radius**2, columns)
    label = str(source) if isinstance(source, str | Path) else f"{type(source).__name__} ({text})"
    rho, rho_sd = DENSITY, UNKNOWN_DENSITY * DENSITY
    if density is not None:
        rho, rho_sd = density_with_sd(density, label)
    z, force, used, notes = _virgin(table.sinkage, table.force, table.notes, label)
    foot = Foot(radius, "ball" if tool.leg == "ball" else "disc")
    over_disc = tool.over_disc

    def curve(x: FloatArray, mu: float = FRICTION) -> FloatArray:
        """Force [N] at (φ, z₀), [k, 2] -> [k, n]."""
        return np.asarray(over_disc * LAWS[name].force(
            foot, z + x[:, 1:], 0.5 * np.pi, friction_angle_deg=x[:, :1], density=rho,
            surface_friction=mu,
        )[..., 1])  # fmt: skip

    known = np.isfinite(curve(np.stack([RANGE_DEG, 0 * RANGE_DEG], -1))).all(axis=1)
    low, high = RANGE_DEG[known][[0, -1]].tolist()
    noise = roughness(force)
    apart = np.abs(np.log(z[:, None] / z))
    shape = SHAPE_SD**2 * np.outer(force, force) * np.exp(-apart / SHAPE_LENGTH)
    course = shape + (FLOOR * force.max()) ** 2 * np.eye(z.size)
    error = course + noise**2 * np.eye(z.size)
    nodes = np.array([(a, b) for a in CONTRACTIONS for b in EXPONENTS])
    borne = 1.0 - nodes[:, :1] * np.exp(-z / (nodes[:, 1:] * radius))
    contact_sd = max(CONTACT_M, CONTACT * radius)
    scale, precision = np.array([1.0, contact_sd]), np.array([0.0, contact_sd**-2])

    def residual(x: FloatArray, rows: IntArray) -> FloatArray:
        return force - borne[rows] * curve(x)

    def slope(x: FloatArray, rows: IntArray) -> FloatArray:
        steps = 1e-3 * scale
        inner = np.clip(x, [low + 0.01, -np.inf], [high - 0.01, np.inf])
        pairs = [(curve(inner + d) - curve(inner - d)) / (2.0 * d.sum()) for d in np.diag(steps)]
        return np.asarray(borne[rows][..., None] * np.stack(pairs, -1))

    weight = np.broadcast_to(np.linalg.inv(error), (len(nodes), z.size, z.size))
    best = least_squares(
        residual, slope, weight, np.tile([0.5 * (low + high), 0.0], (len(nodes), 1)),
        bounds=(np.array([low, -3.0 * contact_sd]), np.array([high, 3.0 * contact_sd])),
        scale=scale, precision=precision,
    )  # fmt: skip
    cost = np.einsum("kn,nm,km->k", best.residual, weight[0], best.residual)
    cost += precision[1] * best.x[:, 1] ** 2 + 2.0 * nodes[:, 0] / PRIOR
    chance = np.exp(0.5 * (cost.min() - cost))
    chance /= chance.sum()
    phi = best.x[:, 0]
    top = int(chance.argmax())
    # Named terms at the likeliest node; errors of the whole force in proportion to it.
    gain, covariance = weights(best.slope[top : top + 1], weight[:1], precision)
    row, model = gain[0, 0], borne[top] * curve(best.x[top : top + 1])[0]
    rough = borne[top] * np.subtract(*(
        curve(best.x[top : top + 1], mu=FRICTION + s * 0.1)[0] for s in (1, -1)
    )) / 0.2  # fmt: skip
    deep = DEEP_SD * np.maximum(z / radius - DEEPEST, 0.0) * model
    contraction = float(chance @ nodes[:, 0])
    budget = {
        "model: compaction": COMPACTING_DEG * min(contraction / MOSTLY, 1.0),
        "model: soil": SOIL_SD_DEG,
        "model: law": math.sqrt(LAWS[name].sd_deg ** 2 - SOIL_SD_DEG**2),
        "model: course": math.sqrt(float(row @ course @ row)),
        "density": abs(float(row @ model)) * rho_sd / rho,
        "surface friction": abs(float(row @ rough)) * FRICTION_SD,
        "contact": abs(float(covariance[0, 0, 1])) / contact_sd,
        "noise": noise * math.sqrt(float(row @ row)),
        "contraction": math.sqrt(float(chance @ (phi - chance @ phi) ** 2)),
        "depth": abs(float(row @ deep)),
        "rectangle": abs(float(row @ model) * 0.5 * math.log(over_disc)),
    }  # fmt: skip
    budget = {k: sd for k, sd in sorted(budget.items(), key=lambda one: -one[1]) if sd > 1e-3}
    sd = math.sqrt(sum(s**2 for k, s in budget.items() if k != "contraction"))
    grid = np.arange(max(low - 15.0, 0.5), min(high + 15.0, 80.0), 0.05)
    posterior = np.exp(-0.5 * ((grid[:, None] - phi) / sd) ** 2) @ chance
    posterior /= np.trapezoid(posterior, grid)
    estimate = Estimate.of_density(grid, posterior)
    size = float(np.sqrt(np.square(force - model).mean()) / np.ptp(force))
    verdict: Verdict = "consistent"
    edge: Edge | None = None
    reason = f"Consistent: the law follows the force within {100.0 * size:.0f} % of its range."
    if chance @ (phi > high - 0.1) > 0.5 or chance @ (phi < low + 0.1) > 0.5:
        edge = "high" if phi[top] > 0.5 * (low + high) else "low"
        end, word, other = (
            (high, "above", "; cohesive or dense soil bears more") if edge == "high"
            else (low, "below", " of the force, its sign and the zero of the sinkage")
        )  # fmt: skip
        verdict = "out_of_range"
        reason = (
            f"Out of range: φ lies {word} {end:g}°, the end of law {name}; check diameter and "
            f"unit{other}."
        )
    elif size > LIMIT:
        verdict = "misfit"
        reason = (
            f"Misfit: the residual is {100.0 * size:.0f} % of the force's range, the limit "
            f"{100.0 * LIMIT:.0f} %; check tool and columns. Do not use the angle."
        )
    # φ of the shallow and of the deep half, with contact and contraction as they are.
    angles = np.arange(low, high, 0.1)
    every = borne[top] * curve(np.stack([angles, 0 * angles + best.x[top, 1]], -1))
    far = z > 0.5 * z[-1]
    shallow, deeper = (
        float(angles[np.square((every - force)[:, half]).sum(axis=1).argmin()])
        for half in (~far, far)
    )
    steady = math.sqrt(sd**2 - budget.get("model: compaction", 0.0) ** 2)
    if verdict == "consistent" and abs(deeper - shallow) > APART * steady:
        verdict = "misfit"
        reason = (
            f"Misfit: the upper half of the depth gives φ = {shallow:.0f}°, the lower half "
            f"{deeper:.0f}°; check tool, surface and layers. Do not use the angle."
        )
    if verdict == "consistent" and contraction > BOUND:
        verdict = "misfit"
        reason = (
            f"Misfit: {100.0 * contraction:.0f} % of the law's force are missing at the "
            "surface, and it grows faster with depth than that of loose soil of one density; "
            "check tool, density and zero of the sinkage. Do not use the angle."
        )
    named = verdict == "consistent" and contraction > SIGNIFICANT
    if named and chance[nodes[:, 0] < 0.1 * SIGNIFICANT].sum() < 0.05:
        notes.insert(0, f"The force begins {100.0 * contraction:.0f} % lower than the law's: loose "
                     "soil that compacts as it is pressed.")  # fmt: skip
    if z[-1] > DEEPEST * radius:
        notes.insert(0, f"The law is extrapolated from {1e3 * DEEPEST * radius:.0f} mm on, to "
                     f"{1e3 * z[-1]:.0f} mm.")  # fmt: skip
    guessed = [] if density is not None else [f"The density {rho:g} kg/m³ is assumed."]
    by_phi, shown = best.slope[top, :, 0], ("model: course", "noise")
    # What else is unsure looks like another angle.
    shared = sum(share**2 for name, share in budget.items() if name not in shown)
    ends = curve(np.stack([np.clip(estimate.ci95, low, high), best.x[[top, top], 1]], -1))
    fit = RecordFit(
        source=label, rig=tool, simulated=False, n_readings=used, n_left_out=table.rows - used,
        theta_deg=1e3 * z, data=force[None], curve=model[None],
        band=(borne[top] * ends)[:, None], nrmsd={"Fz": size}, limit=LIMIT,
        tangent=np.stack([model - by_phi * best.x[top, 0], by_phi])[:, None],
    )  # fmt: skip
    return Answer(
        parameters={PHI: estimate}, convention="plane_strain", phi_plane_strain=estimate,
        phi_plane_strain_reason="", verdict=verdict, reason=reason, edge=edge, budget_deg=budget,
        density_kg_m3=rho, density_sd_kg_m3=rho_sd, density_assumed=density is None, law=name,
        law_reason="" if law else "the default for tools", second_opinion=None,
        warnings=(*density_doubts(rho), *guessed, *notes), records=(fit,), grid_deg=grid,
        density=posterior, covariance=error + shared * np.outer(by_phi, by_phi),
        leg_friction=FRICTION,
        provenance={
            "terraphi": importlib.metadata.version("terraphi"), "contraction": contraction,
            "law_hash": LAWS[name].hash,
            "contact_mm": 1e3 * float(best.x[top, 1]),
            "seconds": round(time.perf_counter() - began, 3),
        },
    )  # fmt: skip


def _virgin(
    sinkage: FloatArray, force: FloatArray, notes: list[str], label: str
) -> tuple[FloatArray, FloatArray, int, list[str]]:
    """Means over windows of the readings deeper than any before, less what is read in air."""
    deepest = np.maximum.accumulate(np.append(-np.inf, sinkage))[:-1]
    virgin, notes = sinkage > deepest, list(notes)
    if (~virgin).any():
        notes.append(
            f"{(~virgin).sum()} of {len(virgin)} readings are no deeper than earlier ones "
            "(unloading, rests) and left out."
        )
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
    count = np.bincount(at, minlength=WINDOWS)
    if (depths := int((count > 0).sum())) < 8:
        raise InputError(f"{label}: readings at {depths} depths below the surface, 8 are needed; "
                         "check the zero and sign of the sinkage")  # fmt: skip
    means = [np.bincount(at, v, WINDOWS)[count > 0] / count[count > 0] for v in (z, f)]
    return means[0], means[1], z.size, notes
