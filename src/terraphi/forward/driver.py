"""Driver of the material point method: blocks of steps in, a force history out."""

from __future__ import annotations

import logging
import pathlib
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import SimulationError
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.motion import Poses, bin_centres
from terraphi.experiment.scenario import Scenario
from terraphi.experiment.solvers import SOLVERS
from terraphi.forward.body import Path
from terraphi.forward.checkpoint import Keeper, State
from terraphi.forward.forecast import step_count
from terraphi.forward.ledger import Audit, empty_audit, empty_reaction
from terraphi.forward.mpm.solver import MpmSolver

log = logging.getLogger(__name__)

BLOCK = {2: 2000, 3: 400}
"""Steps in a block, by dimensions: what is done between two reports of progress.

Blocks end at multiples of their length even if a run goes on from a checkpoint, for the fast kernel
packs its particles anew at the start of each, and its roundings depend on that."""


class Solver(Protocol):
    """A kernel with its constants and working memory, as the driver and an observer use it."""

    kernel: str
    """Name of the kernel."""
    width: float
    """Factor of the impulses: in plane strain the leg's width [m], else 1."""

    @property
    def ledger_rows(self) -> tuple[str, ...]:
        """Names of the rows of the ledger."""

    def bed(self) -> Any:
        """Soil before the first step."""

    def advance(self, soil: Any, path: Path, impulse: FloatArray, audit: Audit) -> int:
        """Take some steps in place; index of the first particle to leave the grid, or -1."""

    def fields(self, soil: Any) -> tuple[FloatArray, dict[str, NDArray[Any]]]:
        """Places (x, y, z) [m] of the particles, and their fields by name."""

    def provenance(self, state: State) -> dict[str, Any]:
        """Part of a history's provenance that this solver alone has."""


@dataclass(frozen=True)
class Snapshot:
    """The state between two blocks of steps, to look at and not to change.

    Attributes
    ----------
    scenario
        What is simulated.
    step
        Number of steps taken.
    steps
        Number of steps in all.
    soil
        The particles as the solver has them; changed as soon as the observer returns.
    solver
        Gives their places and fields.
    """

    scenario: Scenario
    step: int
    steps: int
    soil: Any
    solver: Solver

    @property
    def time(self) -> float:
        """Time of the soil [s], in which the leg moves ``speed_up`` times faster than it should."""
        return self.step * self.scenario.numerics.time_step

    @property
    def pose(self) -> Poses:
        """Place of the leg; each array has one row. Its velocities are not sped up."""
        return self.scenario.motion.poses(np.array([self.time * self.scenario.numerics.speed_up]))


Observer: TypeAlias = Callable[[Snapshot], None]
"""Called at the start, or where a simulation goes on, and after each block of steps."""


def simulate(
    scenario: Scenario,
    *,
    progress: Callable[[float], None] | None = None,
    checkpoint: pathlib.Path | str | None = None,
    observe: Observer | None = None,
) -> ForceHistory:
    """Move the leg through the bed and record the forces.

    Parameters
    ----------
    scenario
        A scenario of ``model = "mpm"``.
    progress, checkpoint, observe
        As in :func:`terraphi.forward.simulate`.

    Returns
    -------
    ForceHistory
        Mean force in each bin of the path (0.1° of a rotation), from the momentum that the
        contact takes out of the grid. Bitwise the same at each run on the same machine, whether or
        not it was stopped, kept and observed on the way.

    Raises
    ------
    InputError
        If what lies at the place of the checkpoint is none.
    SimulationError
        If the solution breaks down; the message says between which steps, and the likely cause.
    """
    began = time.perf_counter()
    solver: Solver = SOLVERS[2](scenario) if scenario.dimensions == 2 else MpmSolver(scenario)
    kept = None if checkpoint is None else pathlib.Path(checkpoint)
    keeper = Keeper(kept, scenario, solver.kernel)
    centres, steps = bin_centres(scenario.motion), step_count(scenario)
    bins, length = len(centres), block_length(scenario)
    first = State(solver.bed(), empty_audit(), empty_reaction(bins), np.zeros(bins), 0)
    state = keeper.resumed(first)
    if observe is not None:
        observe(Snapshot(scenario, state.step, steps, state.soil, solver))
    while state.step < steps:
        done = min(state.step + length, steps)
        path = path_of_steps(scenario, np.arange(state.step, done), bins)
        lost = solver.advance(state.soil, path, state.impulse, state.audit)
        numbers = [field for field in (*state.soil, state.impulse) if field.dtype.kind == "f"]
        if lost >= 0 or not all(np.isfinite(field).all() for field in numbers):
            raise SimulationError(_breakdown(scenario, state.step, done, steps, lost))
        state.held[:] += np.bincount(path.bins, minlength=bins)
        state = state._replace(step=done)
        keeper.offer(state)
        if observe is not None:
            observe(Snapshot(scenario, done, steps, state.soil, solver))
        if progress is not None:
            progress(done / steps)
    seconds = keeper.seconds + time.perf_counter() - began
    log.info("%d steps of %d particles in %.1f s", steps, len(state.soil.mass), seconds)
    provenance = {
        "kernel": solver.kernel,
        "momentum_mismatch": float(state.audit.worst[0]),
        "impulse_kg_m_s": {
            row: [float(v) * solver.width for v in state.audit.ledger[i]]
            for i, row in enumerate(solver.ledger_rows)
        },
        "particles": len(state.soil.mass),
        "steps": state.step,
        "seconds": {"all": seconds},
        **({"resumed_at_step": keeper.resumed_at} if keeper.resumed_at else {}),
        **solver.provenance(state),
    }
    mean = state.impulse / (state.held * scenario.numerics.time_step)[:, None] * solver.width
    return ForceHistory(
        centres,
        mean[:, :2],
        coordinate=scenario.motion.coordinate,
        provenance=provenance,
        moment=mean[:, 2] if scenario.dimensions == 3 else None,
    )


def _breakdown(scenario: Scenario, before: int, after: int, steps: int, lost: int) -> str:
    """One sentence: between which steps a solution broke down, what happened, the likely cause."""
    numerics, limit, soil = scenario.numerics, scenario.time_step_limit, scenario.soil
    what = f"particle {lost} left the grid" if lost >= 0 else "a stress or velocity is not a number"
    if numerics.time_step > limit:
        cause = f"numerics.time_step is above the limit of stability, {limit:.3g} s; lower it"
    elif soil.potential_angle_deg > 0.0:
        cause = (
            f"soil that dilates by {soil.potential_angle_deg:g} deg swells until it leaves the "
            "grid; lower the dilation, or raise numerics.domain"
        )
    else:
        cause = "too long a step for soil this fast; lower numerics.time_step"
    return (
        f"the solution broke down between steps {before} and {after} of {steps}: {what}; likely "
        f"cause: {cause}"
    )


def block_length(scenario: Scenario) -> int:
    """Steps in a block: :data:`BLOCK` or, with phases of several steps, whole ones below it."""
    phase = max(1, scenario.numerics.steps_per_phase)
    return max(phase, BLOCK[scenario.dimensions] // phase * phase)


def path_of_steps(scenario: Scenario, indices: NDArray[np.int64], bin_count: int) -> Path:
    """Places of the leg at steps of the given indices, in a history of ``bin_count`` bins."""
    speed_up, time_step = scenario.numerics.speed_up, scenario.numerics.time_step
    start = indices.astype(np.float64) * time_step * speed_up
    pose = scenario.motion.poses(start)
    poses = np.column_stack([pose.hip, pose.theta, pose.velocity * speed_up, pose.rate * speed_up])
    turned = np.where(pose.theta > 0.0, np.abs(pose.rate) * speed_up * time_step, 0.0)
    middle = scenario.motion.coordinates(start + 0.5 * time_step * speed_up)
    low, high = scenario.motion.span
    bins = np.floor((middle - low) / (high - low) * bin_count).astype(np.int64)
    return Path(np.ascontiguousarray(poses), turned, np.clip(bins, 0, bin_count - 1))
