"""Constants of a scenario as the kernels take them."""

from __future__ import annotations

import math
from typing import NamedTuple

from terraphi.experiment.scenario import Scenario
from terraphi.forward.body import Intruder, intruder_of
from terraphi.paper.plane.plasticity import Material, material_of


class Model(NamedTuple):
    """Everything about a step that does not change from step to step."""

    time_step: float
    """Δt [s]."""
    cell_size: float
    """Δx [m]."""
    gravity: float
    """g [m/s²]."""
    damping_before: float
    """Factor on grid velocities before contact with leg and walls [-]."""
    damping_after: float
    """Factor on grid velocities after it [-]."""
    affine: float
    """1 if particles keep the gradient of the grid's velocity (APIC), else 0 (PIC)."""
    turning: float
    """1 if stress turns with the soil's spin (Jaumann), else 0."""
    band: float
    """Distance from the leg within which nodes are in contact [m]."""
    unbalanced: bool
    """True if contact is that of the paper's prototype."""
    first_x: float
    """Place of the wall behind, where x is least [m]."""
    last_x: float
    """Place of the wall ahead [m]."""
    floor: float
    """Floor z [m]."""
    rough: bool
    """True if soil that presses on the floor sticks to it."""
    relief_distance: float
    """Displacement beyond which a particle fades [m]; inf where there is no relief."""
    relief_rate: float
    """[1/rad]."""
    relief_least: float
    """Smallest weight [-]."""
    material: Material
    """The soil's."""
    intruder: Intruder
    """The leg."""


def model_of(scenario: Scenario) -> Model:
    """Constants of a scenario."""
    numerics, bed, relief = scenario.numerics, scenario.bed, scenario.relief
    factor, before = numerics.damping_factor, numerics.damping_order == "before_contact"
    fades = relief.enabled and scenario.motion.kind == "rotation"
    return Model(
        time_step=numerics.time_step,
        cell_size=numerics.cell_size,
        gravity=bed.gravity,
        damping_before=factor if before else 1.0,
        damping_after=1.0 if before else factor,
        affine=1.0 if numerics.transfer == "apic" else 0.0,
        turning=1.0 if numerics.stress_rate == "jaumann" else 0.0,
        band=numerics.contact_band_cells * numerics.cell_size,
        unbalanced=numerics.contact == "unbalanced",
        first_x=bed.left,
        last_x=bed.left + bed.width,
        floor=bed.floor,
        rough=bed.floor_friction == "rough",
        relief_distance=relief.distance if fades else math.inf,
        relief_rate=relief.rate,
        relief_least=relief.least,
        material=material_of(scenario.soil),
        intruder=intruder_of(scenario.leg),
    )
