"""Collapse of a column.

A round column of soil is let go on a rough floor, in three dimensions, and spreads. Soil of φ = 30°
(Matsuoka and Nakai, ψ = 0, r₀/Δx = 12) is compared with fits to measurements, which do not include
φ. Run-out is that of 99.9 % of the mass.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from runs import Run, part_of_bed, sand3d
from terraphi.experiment.scenario import Scenario
from terraphi.experiment.units import GRAVITY

pytestmark = pytest.mark.slow

RADIUS = 0.1
"""r₀ [m]."""
PHASE = 12
"""Steps for which the grid keeps its velocities."""
LABORATORY = "fits of different laboratories, sands and floors differ by some 10 %"


def column_of(aspect, across):
    """A quarter of an upright cylinder between a smooth wall and a mirror; its leg is unused."""
    cell = RADIUS / across
    edge = (3 + 1e-6) * cell
    reach = math.ceil((1.5 + 1.5 * 1.24 * aspect) * across)
    cells = max(reach, math.ceil(aspect * across)) + 8
    base = sand3d(**{"soil.friction_angle_deg": 30.0, "numerics.speed_up": 1.0})
    content, middle = base.model_dump(), 0.5 * cells * cell
    time_step = base.numerics.time_step * cell / base.numerics.cell_size
    content["leg"] |= {"shape": "sphere", "chord": 4 * cell, "width": 4 * cell}
    content["motion"] = {
        "kind": "translation", "start": (middle, middle), "velocity": (0.01, 0.0),
        "distance": cell, "bin_width": cell,
    }  # fmt: skip
    content["bed"] |= {
        "left": edge, "floor": edge, "width": (cells - 3) * cell - edge, "height": aspect * RADIUS,
        "soil_left": edge, "soil_width": RADIUS, "breadth": 2 * reach * cell,
    }  # fmt: skip
    content["numerics"] |= {
        "domain": cells * cell, "cells": cells, "time_step": time_step,
        "remap_interval": PHASE * time_step, "tip_inset_cells": 0.0,
    }  # fmt: skip
    scenario = Scenario.model_validate(content)
    soil = part_of_bed(scenario, lambda at: np.hypot(at[:, 0] - edge, at[:, 1]) < RADIUS)
    return Run(scenario, soil)


@pytest.mark.parametrize("aspect", [0.6, 1.0, 1.5])
def test_round_column_runs_out_as_in_the_laboratory(check, aspect):
    column = column_of(aspect, 12)
    scenario, height = column.scenario, column.scenario.bed.height
    steps = math.ceil(8.0 * math.sqrt(height / GRAVITY) / scenario.numerics.time_step)
    column.advance(steps - steps % -PHASE)
    place, fields = column.fields()
    place = place - [scenario.bed.left, 0.0, 0.0]
    radius = np.hypot(place[:, 0], place[:, 1])
    speed = float(fields["speed"].mean())
    middle = place[radius < 0.15 * RADIUS, 2] - scenario.bed.floor
    # The uppermost particles lie half their spacing below the surface.
    top = float(np.quantile(middle, 0.99)) + 0.25 * scenario.numerics.cell_size
    problem = f"Round column, h₀/r₀ = {aspect:g}"
    check(
        problem, "run-out (r − r₀)/r₀ = 1.24 a (Lube et al. 2004)", expected=1.24 * aspect,
        found=float(np.quantile(radius, 0.999)) / RADIUS - 1.0, within=0.15, why=LABORATORY,
    )  # fmt: skip
    check(
        problem, "height in the middle over r₀, min(a, 0.74) (Lajeunesse et al. 2004)",
        expected=min(aspect, 0.74), found=top / RADIUS, within=0.15, why=LABORATORY,
    )  # fmt: skip
    assert speed < 0.001 * math.sqrt(GRAVITY * height), "it still moves"
