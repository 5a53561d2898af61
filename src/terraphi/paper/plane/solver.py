"""The solver in plane strain, as the driver uses it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.motion import bin_centres
from terraphi.experiment.scenario import Scenario
from terraphi.forward.body import Path
from terraphi.forward.checkpoint import State
from terraphi.forward.ledger import LEDGER_ROWS, Audit
from terraphi.paper.plane.bed import Particles, empty_grid, geostatic_bed
from terraphi.paper.plane.model import model_of
from terraphi.paper.plane.scalar import advance

APPLIED_BINS = 10
"""Bins of the history over which the applied force is averaged: a degree of a rotation."""


class PlaneSolver:
    """The kernel with its constants and working memory, for the driver."""

    kernel, ledger_rows = "scalar", LEDGER_ROWS

    def __init__(self, scenario: Scenario) -> None:
        self._scenario, self.width = scenario, scenario.leg.width
        self._constants = (empty_grid(scenario), model_of(scenario))

    def bed(self) -> Particles:
        """Soil before the first step."""
        return geostatic_bed(self._scenario)

    def advance(self, soil: Particles, path: Path, impulse: FloatArray, audit: Audit) -> int:
        """Take some steps; index of the first particle to leave the grid, or -1."""
        grid, model = self._constants
        return int(advance(soil, grid, model, path, impulse, audit))

    def fields(self, soil: Particles) -> tuple[FloatArray, dict[str, NDArray[Any]]]:
        """Places (x, 0, z) [m] of the particles; velocities [m/s], stresses [Pa], weight [-]."""
        sxx, szz, sxz, syy = soil.stress.T
        return np.insert(soil.position, 1, 0.0, axis=1), {
            "velocity": np.insert(soil.velocity, 1, 0.0, axis=1),
            "speed": np.hypot(*soil.velocity.T),
            "displacement": np.insert(soil.position - soil.start, 1, 0.0, axis=1),
            "pressure": -0.5 * (sxx + szz),
            "mohr_radius": np.hypot(0.5 * (sxx - szz), sxz),
            "stress_xx": sxx,
            "stress_zz": szz,
            "stress_xz": sxz,
            "stress_yy": syy,
            "weight": soil.weight,
        }

    def provenance(self, state: State) -> dict[str, Any]:
        """Forces that the leg applied to the soil if its contact counts other ones."""
        scenario = self._scenario
        if scenario.numerics.contact != "unbalanced":
            return {}
        edges = np.arange(0, len(state.held), APPLIED_BINS)
        held = np.add.reduceat(state.held, edges)
        position = np.add.reduceat(bin_centres(scenario.motion) * state.held, edges) / held
        applied = np.add.reduceat(state.impulse[:, 2:], edges) * self.width
        force = applied / (held * scenario.numerics.time_step)[:, None]
        total = state.impulse.sum(axis=0) * self.width
        return {
            "momentum": "not balanced by design: the contact counts another force than it applies",
            "counted_impulse_kg_m_s": total[:2].tolist(),
            "applied_impulse_kg_m_s": total[2:].tolist(),
            "applied_force": {
                "position": position.tolist(),
                "x_N": force[:, 0].tolist(),
                "z_N": force[:, 1].tolist(),
            },
        }
