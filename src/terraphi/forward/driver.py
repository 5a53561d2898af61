"""Driver of the material point method: blocks of steps in, a force history out."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.errors import InputError, SimulationError
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.motion import bin_centres
from terraphi.experiment.scenario import Scenario
from terraphi.forward import forecast
from terraphi.forward.breakdown import account_of, is_whole
from terraphi.forward.checkpoint import Keeper, rests_on
from terraphi.forward.plane import packets, scalar
from terraphi.forward.plane.bed import empty_grid
from terraphi.forward.plane.model import model_of
from terraphi.forward.plane.scalar import LEDGER_ROWS
from terraphi.forward.state import State, copy_of, first_state, read_only
from terraphi.forward.watch import Checkpoint, Observer, Snapshot

if TYPE_CHECKING:
    from terraphi.forward.mpm.solver import Blocks

FloatArray = NDArray[np.float64]
log = logging.getLogger(__name__)

Kernel = Literal["packets", "scalar"]
KERNELS: dict[Kernel, Callable[..., int]] = {
    "packets": packets.advance,
    "scalar": scalar.advance,
}
"""By name, functions that take a block of steps in two dimensions.

``scalar`` is the reference; ``packets`` is fast, and gives the same but for rounding. In three
dimensions, where :mod:`terraphi.forward.mpm.phase` has both, ``packets`` rounds to single
precision."""

BLOCK = 2000
"""Steps in a block: what is done between two reports of progress.

Blocks end at multiples of their length even if a run goes on from a checkpoint, for the fast kernel
packs its particles anew at the start of each, and its roundings depend on that."""


BLOCK_IN_SPACE = 400
"""The same in three dimensions, where a step takes ten times longer."""


def block_length(scenario: Scenario) -> int:
    """Steps in a block: the above or, with Lagrangian phases, whole phases as near below it."""
    phase = max(1, scenario.numerics.steps_per_phase)
    most = BLOCK if scenario.dimensions == 2 else BLOCK_IN_SPACE
    return max(phase, most // phase * phase)


def simulate(
    scenario: Scenario,
    *,
    kernel: Kernel = "packets",
    progress: Callable[[float], None] | None = None,
    checkpoint: Checkpoint | None = None,
    observe: Observer | None = None,
) -> ForceHistory:
    """Move the leg through the bed and record the forces.

    Parameters
    ----------
    scenario
        A scenario of ``model = "mpm"``.
    kernel
        ``packets``, or ``scalar``: the reference, three times slower and the same but for rounding.
        Not part of the scenario, as it does not bear on the result; recorded in its provenance.
    progress
        Called now and then with the fraction done, 0 to 1.
    checkpoint
        File to which the state is written now and then, and once more if anything stops the run.
        If it is there already and is of this run, the run goes on from it. It is left behind at
        the end, for the caller to remove.
    observe
        Called with the state at the start and after each block of steps.

    Returns
    -------
    ForceHistory
        Mean force in each bin of the path (0.1° of a rotation), from the momentum that the
        contact takes out of the grid, times the leg's width in two dimensions. Bitwise the same at
        each run on the same machine, whether or not it was stopped, kept and observed on the way.

    Raises
    ------
    InputError
        If the scenario is for another model, there is no such kernel, or a checkpoint that a
        person named does not fit.
    SimulationError
        If the solution breaks down; the message says between which steps, at which particle, the
        likely cause and where the last good state is kept.
    """
    if scenario.model != "mpm":
        raise InputError(f"model = '{scenario.model}': this is the solver of model = 'mpm'")
    if kernel not in KERNELS:
        raise InputError(f"kernel = '{kernel}': there are {' and '.join(KERNELS)}")
    began = time.perf_counter()
    keeper = Keeper(checkpoint, scenario, kernel)
    blocks = _blocks_of(scenario, kernel)
    state, steps = keeper.resumed() or blocks.first_state(), step_count(scenario)
    length = block_length(scenario)
    _show(observe, scenario, state)
    compiled, whole = 0.0, state
    try:
        while state.step < steps:
            whole = copy_of(state)
            state, lost = blocks.take(state, min(length, steps - state.step))
            if not blocks.is_whole(state, lost):
                then, now = blocks.in_plane(whole), blocks.in_plane(state)
                account = account_of(scenario, then, now, lost, steps)
                raise SimulationError(account + keeper.last_resort(whole))
            whole, compiled = state, compiled or time.perf_counter()
            _show(observe, scenario, state)
            keeper.offer(state)
            if progress is not None:
                progress(state.step / steps)
    except SimulationError:
        raise
    except BaseException:  # a person, a parent process or an observer who wants no more
        keeper.save(whole)
        raise
    seconds = {
        "first_block": max(compiled - began, 0.0),
        "all": keeper.seconds + time.perf_counter() - began,
        "checkpoints": keeper.cost,
    }
    log.info("%d steps of %d particles in %.1f s", steps, len(state.soil.mass), seconds["all"])
    provenance = {
        "kernel": kernel,
        "rests_on": rests_on(kernel, dimensions=scenario.dimensions),
        **_books(scenario, state),
        "seconds": seconds,
    }
    if scenario.numerics.contact == "unbalanced":
        provenance |= _applied(scenario, state)
    if keeper.resumed_at:
        provenance["resumed_at_step"] = keeper.resumed_at
    return ForceHistory(
        bin_centres(scenario.motion),
        _mean_force(scenario, state.impulse[:, :2], state.held),
        coordinate=scenario.motion.coordinate,
        provenance=provenance,
    )


def _blocks_of(scenario: Scenario, kernel: Kernel) -> _Blocks | Blocks:
    """What takes the steps of a scenario."""
    if scenario.dimensions == 2:
        return _Blocks(scenario, kernel)
    from terraphi.forward.mpm.solver import Blocks

    return Blocks(scenario, kernel)


class _Blocks:
    """A kernel together with the constants and the working memory that it needs for a scenario."""

    def __init__(self, scenario: Scenario, kernel: Kernel) -> None:
        self._scenario = scenario
        self._advance = KERNELS[kernel]
        self._constants = (empty_grid(scenario), model_of(scenario))

    def first_state(self) -> State:
        """State before the first step."""
        return first_state(self._scenario)

    def is_whole(self, state: State, lost: int) -> bool:
        """Whether a state can be; see :func:`terraphi.forward.breakdown.is_whole`."""
        return is_whole(state, lost)

    def in_plane(self, state: State) -> State:
        """State as those need it who look for what went wrong: as it is."""
        return state

    def take(self, state: State, count: int) -> tuple[State, int]:
        """Take some steps; the arrays of the given state are changed.

        Parameters
        ----------
        state
            The state at the end of a block.
        count
            Number of steps to take.

        Returns
        -------
        State
            The same arrays after these steps.
        int
            Index of the first particle to leave the grid, or -1.
        """
        bins = len(state.held)
        path = path_of_steps(self._scenario, np.arange(state.step, state.step + count), bins)
        lost = self._advance(state.soil, *self._constants, *path, state.impulse, state.audit)
        state.held[:] += np.bincount(path[2], minlength=bins)
        return state._replace(step=state.step + count), lost


def _show(observe: Observer | None, scenario: Scenario, state: State) -> None:
    """Call the observer, if there is one, with a read-only view of a state."""
    if observe is not None:
        observe(Snapshot(scenario, state.step, step_count(scenario), read_only(state.soil)))


def _mean_force(scenario: Scenario, impulse: FloatArray, held: FloatArray) -> FloatArray:
    """Mean force [N] of impulses over steps held, shape [bin, axis]."""
    return impulse / (held * scenario.numerics.time_step)[:, None] * _width(scenario)


def _width(scenario: Scenario) -> float:
    """What impulses are multiplied by: the leg's width [m] in the plane, else 1."""
    return scenario.leg.width if scenario.dimensions == 2 else 1.0


APPLIED_BINS = 10
"""Bins of the history over which the applied force is averaged: a degree of a rotation."""


def _applied(scenario: Scenario, state: State) -> dict[str, Any]:
    """What the leg applied to the soil where its contact counts something else; JSON-able."""
    edges = np.arange(0, len(state.held), APPLIED_BINS)
    held = np.add.reduceat(state.held, edges)
    position = np.add.reduceat(bin_centres(scenario.motion) * state.held, edges) / held
    force = _mean_force(scenario, np.add.reduceat(state.impulse[:, 2:], edges), held)
    return {
        "momentum": "not balanced by design: the contact counts another force than it applies",
        "counted_impulse_kg_m_s": (state.impulse[:, :2].sum(axis=0) * scenario.leg.width).tolist(),
        "applied_impulse_kg_m_s": (state.impulse[:, 2:].sum(axis=0) * scenario.leg.width).tolist(),
        "applied_force": {
            "position": position.tolist(),
            "x_N": force[:, 0].tolist(),
            "z_N": force[:, 1].tolist(),
        },
    }


def _books(scenario: Scenario, state: State) -> dict[str, Any]:
    """Counts and balances of a finished run, JSON-able."""
    rows = LEDGER_ROWS if scenario.dimensions == 2 else (*LEDGER_ROWS[:4], "light_nodes")
    return {
        "momentum_mismatch": float(state.audit.worst[0]),
        "impulse_kg_m_s": {
            row: [float(v) * _width(scenario) for v in state.audit.ledger[i]]
            for i, row in enumerate(rows)
        },
        "particles": len(state.soil.mass),
        "steps": state.step,
    }


def step_count(scenario: Scenario) -> int:
    """Number of steps that cover the motion; see :func:`terraphi.forward.forecast.step_count`."""
    return int(forecast.step_count(scenario))


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
