r"""A virtual bevameter: plates pressed into simulated soil, for Bekker's law as SCM has it.

:math:`p = K_\varphi z^n` (Bekker, 1969, with :math:`k_c = 0` for soil without cohesion) is fitted
to the mean pressure under rough strips of two widths, which are pressed into the soil of preset
``resolved`` on a coarse grid. That law is no property of sand: a wider strip bears more pressure
at the same sinkage, and the fits differ; their difference is a part of the intervals.
The forces are proportional to the density, as those on a leg are.

The solver moves a plate along one straight line at a given speed, so that a plate under a constant
load cannot be sheared, and Janosi's K is not inferred: its range is that of the literature.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.scenario import Scenario
from terraphi.forward import simulate

WIDTHS = (0.05, 0.10)
"""Of the strips [m], about a robot's foot and a small wheel."""
CELL = 0.005
"""Side of a cell of the grid [m]."""
SINKAGE = (0.004, 0.05)
"""Over which the law is fitted, and how deep the strips go [m]."""
SPEED = 0.05
"""Of the strips [m/s]: ρ v² is far below any pressure."""
ROOM = (0.40, 0.20)
"""Half the width of the bed, and its depth [m]."""
FRICTION = 0.5
"""Of the strip [-]: rough, as plates of a bevameter are."""
AT = 0.02
"""Sinkage at which pressures are interpolated over φ [m]."""
NODES = 5
MARGIN_DEG = 3.0
"""By which the nodes reach beyond the draws [deg]; a narrow posterior would leave scatter alone."""
ANGLES_DEG = (15.0, 48.0)
"""Between which strips are pressed [deg]."""
JANOSI = (0.010, 0.025)
"""Janosi's K of sand, from firm to loose [m] (Wong, 2008, Theory of Ground Vehicles)."""
QUANTILES = (0.5, 0.16, 0.84, 0.025, 0.975)


class Pressing(NamedTuple):
    """What a strip tells: Bekker's law of one φ and one width."""

    phi_deg: float
    width: float
    log_pressure: float
    """Logarithm of the pressure [Pa] at the sinkage :data:`AT`."""
    exponent: float
    """n [-]."""


def scenarios(phi_deg: FloatArray) -> list[Scenario]:
    """Half a strip pressed into the bed beside a smooth wall, its plane of symmetry.

    Parameters
    ----------
    phi_deg
        Of the posterior [deg], shape [draw]; :data:`NODES` angles around them are simulated.
    """
    low, high = np.nanquantile(phi_deg, [0.005, 0.995])
    lowest = max(low - MARGIN_DEG, ANGLES_DEG[0])
    nodes = np.linspace(lowest, min(high + MARGIN_DEG, ANGLES_DEG[1]), NODES)
    return [strip(float(phi), width) for phi in nodes for width in WIDTHS]


def strip(phi_deg: float, width: float) -> Scenario:
    """One strip."""
    base = Scenario.load("resolved")
    # A hair beyond a node, which then holds the soil whatever its last digit.
    edge = (4 + 1e-6) * CELL
    tall = SINKAGE[1] + 4 * CELL
    cells = math.ceil(max(edge + ROOM[0] + 3 * CELL, edge + ROOM[1] + 2 * tall + 4 * CELL) / CELL)
    time_step = base.numerics.time_step * CELL / base.numerics.cell_size
    return Scenario.model_validate(
        {
            "soil": base.soil.model_dump() | {"friction_angle_deg": phi_deg},
            "leg": {
                "shape": "plate",
                "chord": 0.5 * width + 3 * CELL,
                "half_thickness": 0.5 * tall,
                "width": 1.0,
                "friction": FRICTION,
            },
            "motion": {
                "kind": "translation",
                "start": [edge + 0.5 * width, edge + ROOM[1] + 0.5 * tall],
                "orientation_deg": 90.0,
                "velocity": [0.0, -SPEED],
                "distance": SINKAGE[1],
                "bin_width": SINKAGE[1] / 100,
            },
            "bed": {"left": edge, "floor": edge, "width": ROOM[0], "height": ROOM[1]},
            "relief": base.relief.model_dump(),
            "numerics": base.numerics.model_dump()
            | {
                "domain": cells * CELL,
                "cells": cells,
                "time_step": time_step,
                "remap_interval": base.numerics.steps_per_phase * time_step,
                "speed_up": 1.0,
            },
        }
    )


def press(scenario: Scenario) -> Pressing:
    """Press a strip, and fit Bekker's law to its pressure."""
    history = simulate(scenario)
    width = 2.0 * (scenario.leg.chord - 3 * CELL)
    sinkage, pressure = np.asarray(history.position), history.force[:, 1] / (0.5 * width)
    told = (sinkage >= SINKAGE[0]) & (pressure > 0.0)
    slope, level = np.polyfit(np.log(sinkage[told] / AT), np.log(pressure[told]), 1)
    return Pressing(scenario.soil.friction_angle_deg, width, float(level), float(slope))


def bekker(
    phi_deg: FloatArray,
    density: float,
    *,
    seed: int = 0,
    progress: Callable[[float, float], None] = lambda _done, _all: None,
    pressed: Callable[[Scenario], Pressing] = press,
) -> dict[str, Any]:
    """Parameters of SCM at draws of φ.

    Parameters
    ----------
    phi_deg
        Draws of φ in plane strain [deg], shape [draw].
    density
        Bulk density [kg/m³].
    seed
        Of scatter and of Janosi's K.
    progress
        Called with the strips pressed and all of them.
    pressed
        How a strip is pressed.

    Returns
    -------
    dict
        ``BEKKER_KPHI`` [N/m^(n+2)], ``BEKKER_N`` [-] and ``JANOSI_SHEAR`` [m]: median, intervals,
        draws (shape [draw]) and ``about``, which says how they were found.
    """
    planned = scenarios(phi_deg)
    found = []
    for done, scenario in enumerate(planned):
        progress(done, len(planned))
        found.append(pressed(scenario))
    progress(len(planned), len(planned))
    angle = np.array([one.phi_deg for one in found])
    rng = np.random.default_rng(seed)
    clipped = np.clip(phi_deg, *ANGLES_DEG)
    drawn = []
    for values in ([one.log_pressure for one in found], [one.exponent for one in found]):
        line = np.polyfit(angle, values, 2)
        # What the curve leaves: both widths, and the scatter of particles.
        left = np.asarray(values) - np.polyval(line, angle)
        scatter = math.sqrt(float(left @ left) / (len(found) - 3))
        drawn.append(np.polyval(line, clipped) + scatter * rng.standard_normal(phi_deg.size))
    exponent = np.maximum(drawn[1], 0.0)
    scale = density / planned[0].soil.density
    stiffness = scale * np.exp(drawn[0]) / AT**exponent
    widths = " and ".join(f"{100 * width:g} cm" for width in WIDTHS)
    plate = (
        f"inferred, from strips of {widths} pressed {100 * SINKAGE[1]:g} cm deep; the interval "
        "holds the posterior of φ, the difference between the widths and the simulations' scatter"
    )
    return {
        "BEKKER_KPHI": _told(stiffness, f"[N/m^(n+2)] {plate}; Bekker_Kc is 0"),
        "BEKKER_N": _told(exponent, f"[-] {plate}"),
        "JANOSI_SHEAR": _told(
            rng.uniform(*JANOSI, phi_deg.size),
            "[m] NOT inferred: the literature's range for sand, 10 to 25 mm (Wong, 2008)",
        ),
    }


def _told(values: FloatArray, about: str) -> dict[str, Any]:
    median, *ends = (float(f"{q:.6g}") for q in np.quantile(values, QUANTILES))
    return {
        "median": median, "ci68": ends[:2], "ci95": ends[2:], "about": about,
        "draws": [float(f"{value:.6g}") for value in values],
    }  # fmt: skip
