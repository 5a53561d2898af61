"""Bekker's pressure-sinkage parameters of a soil, from plates.

    p = (k_c / b + k_φ) zⁿ

p is the pressure, z the sinkage, and b the radius of a disc or the shorter side of a rectangle
(M. G. Bekker, *Introduction to Terrain-Vehicle Systems*, 1969; J. Y. Wong, *Theory of Ground
Vehicles*). One plate determines n and k_c / b + k_φ; plates of two sizes determine k_c and k_φ as
well. The fit is Wong's (1980, J. Terramechanics 17:13): ln p over ln z by least squares with the
weights p².
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from terraphi.experiment.rig import Tool
from terraphi.inference.answer import RecordFit

FEWEST = 3
"""Windows that a plate needs [-]."""


class Bekker(NamedTuple):
    """Parameters of the soil under one plate or several, in kN and m."""

    n: float
    """Exponent of the sinkage [-]."""
    k: dict[str, float]
    """k_c / b + k_φ of each size of plate by its b in mm [kN/m^(n+2)]."""
    k_c: float | None
    """[kN/m^(n+1)]; ``None`` of plates of one size."""
    k_phi: float | None
    """[kN/m^(n+2)]; ``None`` of plates of one size."""

    def __str__(self) -> str:
        """One line, with the units."""
        over, under = f"kN/m^{self.n + 2.0:.2f}", f"kN/m^{self.n + 1.0:.2f}"
        if self.k_c is None:
            [(b, k)] = self.k.items()
            values = f"k_c/b + k_φ = {_digits(k)} {over} at b = {b} mm (each: plates of two sizes)"
        else:
            values = f"k_c = {_digits(self.k_c)} {under}, k_φ = {_digits(self.k_phi or 0.0)} {over}"
        return f"Bekker: p = (k_c/b + k_φ) zⁿ, n = {self.n:.2f}, {values}"


def _digits(value: float) -> str:
    """Three digits, without an exponent."""
    return f"{float(f'{value:.3g}'):.9g}"


def bekker(records: Sequence[RecordFit]) -> Bekker | None:
    """Fit the records of plates; ``None`` if there are none."""
    sizes, logs, weights = [], [], []
    for record in records:
        tool = record.rig
        if not isinstance(tool, Tool) or tool.shape.foot != "disc":
            continue
        # p = F / (π R²), of a rectangle R is the radius of a disc of its area.
        b = tool.radius if len(tool.size_mm) == 1 else 1e-3 * min(tool.size_mm)
        z, p = 1e-3 * record.theta_deg, 1e-3 * record.data[0] / (math.pi * tool.radius**2)
        borne = p > 0.0
        if borne.sum() >= FEWEST:
            sizes.append(np.full(borne.sum(), b))
            logs.append(np.log([z[borne], p[borne]]))
            weights.append(p[borne] ** 2 / np.square(p[borne]).sum())
    if not sizes:
        return None
    size, of_size = np.unique(np.concatenate(sizes), return_inverse=True)
    (log_z, log_p), weight = np.hstack(logs), np.sqrt(np.concatenate(weights))
    # One exponent, and one ln k for each size.
    rows = np.column_stack([log_z, np.eye(size.size)[of_size]])
    n, *log_k = np.linalg.lstsq(weight[:, None] * rows, weight * log_p, rcond=None)[0].tolist()
    # k = k_c (1/b) + k_φ is a line over 1/b.
    k = np.exp(log_k)
    k_c, k_phi = np.polyfit(1.0 / size, k, 1).tolist() if size.size > 1 else (None, None)
    return Bekker(n, {f"{1e3 * b:g}": v for b, v in zip(size.tolist(), k.tolist(), strict=True)},
                  k_c, k_phi)  # fmt: skip
