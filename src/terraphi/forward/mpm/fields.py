"""Places and fields of the particles in space, as VTK takes them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.scenario import Scenario
from terraphi.forward.mpm.bed import Soil
from terraphi.forward.mpm.lattice import lattice_of, positions
from terraphi.forward.mpm.phase import velocities
from terraphi.forward.vtk import Data


def particle_fields(scenario: Scenario, soil: Soil) -> tuple[NDArray[np.float32], Data]:
    """Places and fields of the particles.

    Parameters
    ----------
    scenario
        What is simulated.
    soil
        The particles; of a mirrored half only those that are computed.

    Returns
    -------
    points
        (x, y, z) [m], shape [particle, 3].
    data
        ``velocity``, ``speed`` [m/s], ``pressure`` [Pa], the six components of the stress [Pa],
        ``plastic_shear_strain`` κ [-], ``weight``, always 1, and ``particle``, its index.
    """
    lattice = lattice_of(scenario)
    velocity = velocities(soil, lattice)
    names = ("xx", "yy", "zz", "xy", "xz", "yz")
    fields = {
        "velocity": velocity,
        "speed": np.linalg.norm(velocity, axis=1),
        "pressure": -soil.stress[:, :3].mean(axis=1),
        **{f"stress_{name}": soil.stress[:, c] for c, name in enumerate(names)},
        "plastic_shear_strain": soil.strain,
        "weight": np.ones(len(soil.mass)),
    }
    data: dict[str, NDArray[np.float32] | NDArray[np.int64]] = {
        name: values.astype(np.float32) for name, values in fields.items()
    }
    data["particle"] = np.arange(len(soil.mass))
    return positions(lattice, soil.cell, soil.offset).astype(np.float32), data
