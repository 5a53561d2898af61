"""Driver of the material point method: blocks of steps in, a force history out."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from terraphi.errors import InputError, SimulationError
from terraphi.forward.mpm import packet_phases, packets, phases, scalar
from terraphi.forward.mpm.bed import empty_grid, geostatic_bed
from terraphi.forward.mpm.contact import intruder_of
from terraphi.forward.mpm.plasticity import material_of
from terraphi.forward.mpm.relief import fading_of
from terraphi.forward.mpm.scalar import LEDGER_ROWS, empty_audit, stepping_of
from terraphi.history import ForceHistory
from terraphi.motion import bin_centres
from terraphi.scenario import Scenario

FloatArray = NDArray[np.float64]
log = logging.getLogger(__name__)

Kernel = Literal["packets", "scalar"]
KERNELS: dict[Kernel, tuple[Callable[..., int], Callable[..., int]]] = {
    "packets": (packets.advance, packet_phases.advance),
    "scalar": (scalar.advance, phases.advance),
}
"""``packets``: the fast one; ``scalar``: the reference, to which it agrees but for rounding.

Of each, the one that transfers at every step and the one with Lagrangian phases."""

BLOCK = 2000
"""Steps between two reports of progress, or a little less."""


def block_length(scenario: Scenario) -> int:
    """Steps between two reports of progress: whole phases, if there are any."""
    phase = max(1, scenario.numerics.steps_per_phase)
    return max(phase, BLOCK // phase * phase)


def simulate(
    scenario: Scenario,
    *,
    kernel: Kernel = "packets",
    progress: Callable[[float], None] | None = None,
) -> ForceHistory:
    """Move the leg through the bed and record the forces.

    Parameters
    ----------
    scenario
        A scenario of ``model = "mpm"`` in two dimensions.
    kernel
        ``packets``, or ``scalar``: the reference, three times slower and the same but for rounding.
        Not part of the scenario, as it does not bear on the result; recorded in its provenance.
    progress
        Called now and then with the fraction done, 0 to 1.

    Returns
    -------
    ForceHistory
        Mean force in each bin of the path (0.1° of a rotation), from the momentum that the
        contact takes out of the grid, times the leg's width. Bitwise the same at each run on the
        same machine.

    Raises
    ------
    InputError
        If the scenario is for another model, or there is no such kernel.
    SimulationError
        If the solution breaks down; the message says where.
    """
    if scenario.model != "mpm":
        raise InputError(f"model = '{scenario.model}': this is the solver of model = 'mpm'")
    if kernel not in KERNELS:
        raise InputError(f"kernel = '{kernel}': there are {' and '.join(KERNELS)}")
    advance = KERNELS[kernel][scenario.numerics.steps_per_phase > 0]
    began = time.perf_counter()
    soil, grid, audit = geostatic_bed(scenario), empty_grid(scenario), empty_audit()
    constants = (
        material_of(scenario.soil),
        intruder_of(scenario.leg),
        fading_of(scenario),
        stepping_of(scenario),
    )
    centres = bin_centres(scenario.motion)
    impulse, held = np.zeros((len(centres), 2)), np.zeros(len(centres))
    steps = step_count(scenario)
    compiled = time.perf_counter()
    block = block_length(scenario)
    for first in range(0, steps, block):
        indices = np.arange(first, min(first + block, steps))
        poses, turned, bins = path_of_steps(scenario, indices, len(centres))
        lost = advance(soil, grid, *constants, poses, turned, bins, impulse, audit)
        held += np.bincount(bins, minlength=len(centres))
        if lost >= 0 or not np.isfinite(impulse).all():
            raise SimulationError(
                f"the solution broke down between steps {indices[0]} and {indices[-1]} of {steps} "
                f"({_where(scenario, indices[0])}): "
                f"{'a particle left the grid' if lost >= 0 else 'a force is not a number'}; "
                "try a smaller numerics.time_step"
            )
        if first == 0:
            compiled = time.perf_counter()
        if progress is not None:
            progress((indices[-1] + 1) / steps)
    force = impulse / (held * scenario.numerics.time_step)[:, None] * scenario.leg.width
    ended = time.perf_counter()
    log.info("%d steps of %d particles in %.1f s", steps, len(soil.mass), ended - began)
    provenance = {
        "kernel": kernel,
        "momentum_mismatch": float(audit.worst[0]),
        "impulse_kg_m_s": {
            row: [float(v) * scenario.leg.width for v in audit.ledger[i]]
            for i, row in enumerate(LEDGER_ROWS)
        },
        "particles": len(soil.mass),
        "steps": steps,
        "seconds": {"first_block": compiled - began, "all": ended - began},
    }
    return ForceHistory(
        centres, force, coordinate=scenario.motion.coordinate, provenance=provenance
    )


def step_count(scenario: Scenario) -> int:
    """Number of steps that cover the motion."""
    duration = scenario.motion.duration / scenario.numerics.speed_up
    return math.ceil(duration / scenario.numerics.time_step - 1e-9)


def path_of_steps(
    scenario: Scenario, indices: NDArray[np.int64], bin_count: int
) -> tuple[FloatArray, FloatArray, NDArray[np.int64]]:
    """Poses, turned angles and history bins of some steps, as the kernel takes them.

    Parameters
    ----------
    scenario
        The scenario.
    indices
        Steps, shape [step].
    bin_count
        Number of history bins.

    Returns
    -------
    poses
        Hip x, z [m], θ [rad], hip velocity x, z [m/s], angular rate [rad/s] at the start of each
        step, sped up; shape [step, 6].
    turned
        |Δθ| of each step once θ > 0 [rad], shape [step].
    bins
        History bin that the middle of each step falls into, shape [step].
    """
    speed_up, time_step = scenario.numerics.speed_up, scenario.numerics.time_step
    start = indices.astype(np.float64) * time_step * speed_up
    pose = scenario.motion.poses(start)
    poses = np.column_stack([pose.hip, pose.theta, pose.velocity * speed_up, pose.rate * speed_up])
    turned = np.where(pose.theta > 0.0, np.abs(pose.rate) * speed_up * time_step, 0.0)
    middle = scenario.motion.coordinates(start + 0.5 * time_step * speed_up)
    low, high = scenario.motion.span
    bins = np.floor((middle - low) / (high - low) * bin_count).astype(np.int64)
    return np.ascontiguousarray(poses), turned, np.clip(bins, 0, bin_count - 1)


def _where(scenario: Scenario, step: np.int64) -> str:
    """Place on the path at a step, for a message."""
    at = step * scenario.numerics.time_step * scenario.numerics.speed_up
    value = float(scenario.motion.coordinates(np.array([at]))[0])
    if scenario.motion.coordinate == "theta":
        return f"theta = {math.degrees(value):.1f} deg"
    return f"displacement = {value * 1e3:.2f} mm"
