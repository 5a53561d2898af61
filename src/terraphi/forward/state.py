"""The state of a run between two blocks of steps: all that is needed to go on from there."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.motion import bin_centres
from terraphi.experiment.scenario import Scenario
from terraphi.forward.plane.bed import Particles, geostatic_bed
from terraphi.forward.plane.scalar import Audit, empty_audit, empty_reaction

FloatArray = NDArray[np.float64]


class State(NamedTuple):
    """State of a run; its arrays are changed in place by the kernels."""

    soil: Any
    """The particles, in the order in which they were made: packing depends on it. Arrays by name:
    :class:`~terraphi.forward.plane.bed.Particles` or, in three dimensions,
    :class:`terraphi.forward.mpm.bed.Soil`."""
    audit: Audit
    """The soil's momentum so far."""
    impulse: FloatArray
    """Impulse of the soil on the leg, as :func:`~terraphi.forward.plane.scalar.empty_reaction` has
    it."""
    held: FloatArray
    """Number of steps in each bin [-], shape [bin]."""
    step: int
    """Number of steps taken."""


def first_state(scenario: Scenario) -> State:
    """State before the first step."""
    bins = len(bin_centres(scenario.motion))
    return State(geostatic_bed(scenario), empty_audit(), empty_reaction(bins), np.zeros(bins), 0)


def copy_of(state: State) -> State:
    """Copy that no kernel will change."""
    return State(
        type(state.soil)(*(field.copy() for field in state.soil)),
        Audit(*(field.copy() for field in state.audit)),
        state.impulse.copy(),
        state.held.copy(),
        state.step,
    )


def read_only(soil: Any) -> Any:
    """Views of the particles through which nothing can be changed."""
    views = type(soil)(*(field.view() for field in soil))
    for view in views:
        view.flags.writeable = False
    return views


def flawed_particle(soil: Particles) -> int:
    """Index of the first particle that cannot be.

    Parameters
    ----------
    soil
        The particles.

    Returns
    -------
    int
        A particle with a position, velocity, gradient or stress that is not a number; -1 if there
        is none.
    """
    whole = np.ones(len(soil.mass), dtype=bool)
    for field in (soil.position, soil.velocity, soil.gradient, soil.stress):
        whole &= np.isfinite(field).all(axis=1)
    return -1 if whole.all() else int(np.argmin(whole))
