"""Elastic waves: how fast standing waves of compression and of shear swing."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.scenario import GRAVITY, Scenario
from terraphi.experiment.soil import Soil
from terraphi.forward.plane.bed import Particles, geostatic_bed
from terraphi.view.plots import BLUE, GREEN, GREY, ORANGE, panels_of
from terraphi_studies.verification.check import Check, Family, Outcome, Task
from terraphi_studies.verification.driver import (
    ELASTIC,
    Rig,
    advance,
    benchmark,
    block_of,
    in_words,
    rig_of,
)
from terraphi_studies.verification.rest import SOFT_PLACES

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FloatArray = NDArray[np.float64]

COURANT = 0.4
PERIODS = 3.0
SAMPLES = 120
"""Looks at a wave in a period."""

SPEEDS = "c_p = √((λ + 2G)/ρ) = 127.7 m/s, c_s = √(G/ρ) = 68.3 m/s"


def wave_speeds(soil: Soil) -> tuple[float, float]:
    """c_p and c_s [m/s] from E, ν and ρ alone: c_p² = E (1 - ν) / (ρ (1 + ν) (1 - 2ν)).

    And c_s² = E / (2 ρ (1 + ν)).
    """
    ratio = soil.poisson_ratio
    unit = soil.youngs_modulus / (soil.density * (1.0 + ratio))
    return math.sqrt(unit * (1.0 - ratio) / (1.0 - 2.0 * ratio)), math.sqrt(0.5 * unit)


def compression_wave(cells: int, jitter: float, on_nodes: bool = True) -> Outcome:
    """Standing wave in a bed on a smooth floor, v_z = V sin(πz/2h) at the start.

    Its stress is a third of that of the weight, so that soil and walls never part.

    Parameters
    ----------
    cells
        Cells along a side of the domain.
    jitter
        Share of its sub-cell over which a particle's place is drawn [-].
    on_nodes
        Whether the edges of the box lie on nodes.
    """
    changes: dict[str, Any] = {
        "bed.floor_friction": "smooth",
        "numerics.particle_jitter": jitter,
    }
    scenario = elastic(cells, on_nodes=on_nodes, **changes)
    soil, rig = geostatic_bed(scenario), rig_of(scenario)
    height, speed = scenario.bed.height, scenario.soil.p_wave_speed
    wave_number = 0.5 * math.pi / height
    above = soil.start[:, 1] - scenario.bed.floor
    top_speed = 0.3 * GRAVITY * height / speed
    mode = np.zeros((len(above), 2))
    mode[:, 1] = np.sin(wave_number * above)
    soil.velocity[:] = top_speed * mode
    soil.gradient[:, 3] = top_speed * wave_number * np.cos(wave_number * above)
    times, swing = _swing(soil, rig, mode, 4.0 * height / speed)
    found = 4.0 * height / _period(times, swing)
    places = "on a lattice" if jitter == 0.0 else "at random"
    check = Check(
        problem="Standing compression wave in a bed",
        case=f"4 particles a cell, {places}",
        quantity="c_p [m/s]",
        expected=wave_speeds(scenario.soil)[0],
        obtained=found,
        tolerance=0.02,
        resolution=in_words(scenario),
        source=f"{SPEEDS}; a column on a rigid floor swings with the period 4h/c_p",
        cause="" if jitter == 0.0 else SOFT_PLACES,
    )
    return Outcome([check], _curves(times, swing, "p", 4.0 * height / speed))


def shear_wave(cells: int, per_side: int = 2) -> Outcome:
    """Lamé's mode of a free square block: shear alone, and no stress on any side.

    Parameters
    ----------
    cells
        Cells along a side of the domain.
    per_side
        Particles along a side of a cell.
    """
    scenario = elastic(cells, per_side=per_side)
    side = 0.16
    soil, mode, gradient = lame_mode(scenario, side)
    rig = rig_of(scenario).open_box().changed(gravity=0.0)
    soil.velocity[:], soil.gradient[:] = 1e-3 * mode, 1e-3 * gradient
    speed = wave_speeds(scenario.soil)[1]
    times, swing = _swing(soil, rig, mode, math.sqrt(2.0) * side / speed)
    check = Check(
        problem="Lamé's mode of a free square block",
        case=f"{per_side**2} particles a cell",
        quantity="c_s [m/s]",
        expected=speed,
        obtained=math.sqrt(2.0) * side / _period(times, swing),
        tolerance=0.02,
        resolution=in_words(scenario),
        source=f"{SPEEDS}; Lamé (1852): v = V (sin kx cos kz, −cos kx sin kz), k = π/side, swings "
        "with the period √2 side/c_s",
    )
    return Outcome([check], _curves(times, swing, "s", math.sqrt(2.0) * side / speed))


def elastic(cells: int, *, on_nodes: bool = True, per_side: int = 2, **changes: Any) -> Scenario:
    """Soil of the benchmark that never yields, undamped, laid in the state of an oedometer."""
    constants: dict[str, Any] = {
        "numerics.particle_jitter": 0.0,
        "numerics.particles_per_cell_side": per_side,
        "numerics.damping_rate": 0.0,
        "soil.cohesion": ELASTIC,
        "soil.k0": 0.3 / 0.7,
    }
    return benchmark(cells, courant=COURANT, on_nodes=on_nodes, **{**constants, **changes})


def lame_mode(scenario: Scenario, side: float) -> tuple[Particles, FloatArray, FloatArray]:
    """A square block in the middle of the domain, and Lamé's mode at its particles.

    Parameters
    ----------
    scenario
        Gives grid and density.
    side
        [m].

    Returns
    -------
    Particles
        At rest.
    mode
        (sin kx cos kz, -cos kx sin kz) from the block's centre [-], shape [particle, 2].
    gradient
        Its gradient (∂x/∂x, ∂x/∂z, ∂z/∂x, ∂z/∂z) [1/m], shape [particle, 4].
    """
    numerics = scenario.numerics
    low = 0.5 * (numerics.domain - side)
    spacing = numerics.cell_size / numerics.particles_per_cell_side
    soil = block_of((low, low), (side, side), spacing, scenario.soil.density)
    k = math.pi / side
    sx, sz = np.sin(k * (soil.start - 0.5 * numerics.domain)).T
    cx, cz = np.cos(k * (soil.start - 0.5 * numerics.domain)).T
    mode = np.stack([sx * cz, -cx * sz], axis=1)
    gradient = k * np.stack([cx * cz, -sx * sz, sx * sz, -cx * cz], axis=1)
    return soil, mode, gradient


def _swing(
    soil: Particles, rig: Rig, mode: FloatArray, period: float
) -> tuple[FloatArray, FloatArray]:
    """Share of a mode in the velocities over some periods: times [s] and share [m/s]."""
    between = max(1, round(period / SAMPLES / rig.stepping.time_step))
    count = math.ceil(PERIODS * period / (between * rig.stepping.time_step))
    weighed = soil.mass[:, None] * mode / float(soil.mass @ (mode**2).sum(axis=1))
    swing = []
    for _ in range(count):
        advance(soil, rig, between)
        swing.append(float((weighed * soil.velocity).sum()))
    times = between * rig.stepping.time_step * np.arange(1.0, count + 1.0)
    return np.asarray(times, dtype=np.float64), np.array(swing)


def _curves(times: FloatArray, swing: FloatArray, wave: str, period: float) -> dict[str, Any]:
    """What the figure is drawn from, JSON-able."""
    return {"time": times.tolist(), "swing": swing.tolist(), "wave": wave, "period": period}


def _period(times: FloatArray, swing: FloatArray) -> float:
    """Twice the mean distance of the zeros, each between two samples [s]."""
    before = np.flatnonzero(swing[:-1] * swing[1:] < 0.0)
    share = swing[before] / (swing[before] - swing[before + 1])
    zeros = times[before] + share * (times[before + 1] - times[before])
    return 2.0 * float(np.polyfit(np.arange(len(zeros)), zeros, 1)[0])


def _waves(*grids: int) -> list[Task]:
    """Both waves on grids of several sizes."""
    return [
        *(
            Task(f"p-{n}", compression_wave, {"cells": n, "jitter": 0.0}, 1e-6 * n**3)
            for n in grids
        ),
        *(Task(f"s-{n}", shear_wave, {"cells": n}, 1e-6 * n**3) for n in grids),
    ]


def figures(outcomes: Mapping[str, Outcome]) -> dict[str, Figure]:
    """Swing of each wave, on grids of several sizes."""
    figure, (panels,) = panels_of(1, 2, size=(10.0, 3.6))
    looks = ((GREEN, ":"), (ORANGE, "--"), (BLUE, "-"))
    names = {"p": "compression, v = V sin(πz/2h)", "s": "shear, Lamé's mode"}
    for axes, wave in zip(panels, names, strict=True):
        axes.axhline(0.0, color=GREY, lw=0.6)
        shown = [o for o in outcomes.values() if o.curves["wave"] == wave][:3]
        for outcome, (colour, style) in zip(shown, looks, strict=False):
            label = outcome.checks[0].resolution.split(",")[0]
            time, swing = (np.array(outcome.curves[key]) for key in ("time", "swing"))
            axes.plot(1e3 * time, swing / np.abs(swing).max(), style, color=colour, label=label)
        period = shown[0].curves["period"]
        time = np.linspace(0.0, PERIODS * period, 400)
        axes.plot(1e3 * time, np.cos(2.0 * math.pi * time / period), "k-", lw=0.5, label="exact")
        axes.set_title(names[wave], fontsize=10)
        axes.set_xlabel("time [ms]")
        axes.set_ylabel("share of the mode, of its largest")
        axes.set_ylim(-1.1, 1.5)
        axes.legend(fontsize="small", frameon=False, loc="upper right", ncols=4)
    return {"verification-waves": figure}


FAMILY = Family(
    title="Elastic waves",
    meaning="Standing waves of small amplitude in elastic, undamped soil. If these pass, "
    "stiffness, density and time step fit together.",
    full=[
        *_waves(30, 60, 120),
        Task(
            "p-benchmark", compression_wave, {"cells": 128, "jitter": 1.0, "on_nodes": False}, 3.0
        ),
        Task("s-fine", shear_wave, {"cells": 120, "per_side": 3}, 3.0),
    ],
    quick=_waves(30),
    figures=figures,
)
