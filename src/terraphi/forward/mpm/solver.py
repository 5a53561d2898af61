"""What the driver in :mod:`terraphi.forward.driver` needs to know of three dimensions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.motion import bin_count
from terraphi.experiment.scenario import Scenario
from terraphi.forward.driver import path_of_steps
from terraphi.forward.mpm.bed import Soil, geostatic_bed, particle_volume
from terraphi.forward.mpm.lattice import lattice_of, positions
from terraphi.forward.mpm.phase import Kernel, Phases, precision_of, velocities
from terraphi.forward.plane.bed import Particles
from terraphi.forward.plane.scalar import empty_audit, empty_reaction
from terraphi.forward.state import State

FloatArray = NDArray[np.float64]


class Blocks:
    """A kernel together with the constants and the working memory that it needs for a scenario."""

    def __init__(self, scenario: Scenario, kernel: Kernel) -> None:
        self._scenario, self._precision = scenario, precision_of(kernel)
        self._phases = Phases(scenario, kernel)

    def first_state(self) -> State:
        """State before the first step."""
        bins = bin_count(self._scenario.motion)
        soil = geostatic_bed(self._scenario, self._precision)
        self._phases.weigh_first(soil)
        return State(soil, empty_audit(), empty_reaction(bins), np.zeros(bins), 0)

    def take(self, state: State, count: int) -> tuple[State, int]:
        """Take some steps, as the driver's own blocks do; a block is a number of whole phases."""
        assert isinstance(state.soil, Soil)
        bins = len(state.held)
        path = path_of_steps(self._scenario, np.arange(state.step, state.step + count), bins)
        lost = self._phases.take(state.soil, path[0], path[2], state.impulse, state.audit)
        state.held[:] += np.bincount(path[2], minlength=bins)
        return state._replace(step=state.step + count), lost

    def is_whole(self, state: State, lost: int) -> bool:
        """Whether a state can be: nobody has left the grid, and all numbers are numbers."""
        soil = state.soil
        assert isinstance(soil, Soil)
        fields = (soil.offset, soil.stress, soil.vx, soil.vy, soil.vz, state.impulse)
        return lost < 0 and all(bool(np.isfinite(field).all()) for field in fields)

    def in_plane(self, state: State) -> State:
        """State as one in the plane, for those who look for what went wrong."""
        return state._replace(soil=in_plane(self._scenario, state.soil))


def in_plane(scenario: Scenario, soil: Soil) -> Particles:
    """Particles with what they have in the plane of motion.

    Parameters
    ----------
    scenario
        What is simulated.
    soil
        The particles in space.

    Returns
    -------
    Particles
        Their first places are those of now, and mass and volume those of the particles [kg, m³].
    """
    lattice, count = lattice_of(scenario), len(soil.mass)
    place = positions(lattice, soil.cell, soil.offset)[:, [0, 2]]
    return Particles(
        position=place,
        start=place,
        velocity=velocities(soil, lattice)[:, [0, 2]],
        gradient=np.zeros((count, 4)),
        stress=soil.stress[:, [0, 2, 4, 1]].astype(np.float64),
        mass=soil.mass.astype(np.float64),
        volume=np.full(count, particle_volume(scenario)),
        weight=np.ones(count),
    )
