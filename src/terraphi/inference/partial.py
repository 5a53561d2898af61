r"""Records of a part of the stroke: their information on φ, and what the missing part may change.

With g the window means of a whole stroke and p the peak-to-peak of each force, the windows that a
record has hold the share

    h = Σ_record (∂g/∂φ / p)² / Σ_whole (∂g/∂φ / p)²

of the information. Real soils deviate from the model differently at each angle, so that a part of a
record gives another φ than the whole. Cut to 22 windows of 40° to 160°, the shipped records move by
1.4° √(1/h - 1), root mean square, whatever the window: 1.1 to 1.5° for h from 0.1 to 0.99.

The moment about the hip gives another angle than the forces do, too: MOMENT_DEG is the root mean
square of what it differs by on the legs of simulated grains.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.history import FORCES, OBSERVATION_ANGLES, WINDOW_DEG, ForceHistory
from terraphi.inference.records import Record
from terraphi.laws.store import PHI

if TYPE_CHECKING:
    from terraphi.inference.likelihood import Likelihood

PART_DEG = 1.4
"""Standard deviation of the shift of φ at h = ½ [deg]."""
MOMENT_DEG = 0.9
"""Standard deviation of φ by a moment less that by both forces [deg]."""


class Part(NamedTuple):
    """How much of a whole stroke a record has."""

    share: float
    """Share h of the information on φ [-]."""
    span: FloatArray
    """Peak-to-peak of each channel over a whole stroke, by the record or the model, shape [c]."""
    model: FloatArray | None = None
    """That of Fx and Fz by the model [N], shape [2]; ``None`` of a record that is whole."""


def part_of(likelihood: Likelihood, i: int) -> Part:
    """What the i-th record has of a whole stroke, at the best point."""
    record = likelihood.records[i]
    forces = record.channels == FORCES
    every = record.theta_deg.size == OBSERVATION_ANGLES
    if PHI not in likelihood.keys or (forces and every):
        return Part(1.0, record.span)
    theta = np.radians(np.arange(-WINDOW_DEG - 3.0, WINDOW_DEG + 3.5))

    def of_model(axes: tuple[str, ...]) -> tuple[Record, FloatArray]:
        """A record of the whole stroke, and forces as it has them."""
        nothing = ForceHistory(
            theta, np.zeros((theta.size, len(axes))), axes=axes, moment=0 * theta
        )
        whole = replace(record, history=nothing)
        return whole, likelihood.forces_of(whole, i)

    whole, (below, curve, above) = of_model(record.history.axes)
    model = np.ptp(curve if forces else of_model(("x", "z"))[1][1], axis=1)
    span = record.span if every else np.maximum(record.span, np.ptp(curve, axis=1))
    has = np.isin(whole.theta_deg.round(6), record.theta_deg.round(6))
    information = np.square((above - below) / span[:, None])
    return Part(float(information[:, has].sum() / information.sum()), span, model)


def missing_parts(likelihood: Likelihood, slope: FloatArray) -> dict[str, FloatArray]:
    """Covariance of what missing angles and missing forces would change, if any are missing.

    Parameters
    ----------
    likelihood
        Of the records.
    slope
        ∂g/∂φ [N/deg], shape [n].
    """
    angles, forces = np.zeros((2, slope.size, slope.size))
    for record, part, stroke in zip(
        likelihood.records, likelihood.parts, likelihood.strokes, strict=True
    ):
        share = max(stroke.share, 1e-3)
        square = np.outer(slope[part], slope[part])
        angles[part, part] = PART_DEG**2 * (1.0 / share - 1.0) * square
        if record.channels != FORCES:
            forces[part, part] = MOMENT_DEG**2 * square
    named = {"missing angles": angles, "missing forces": forces}
    return {name: each for name, each in named.items() if each.any()}
