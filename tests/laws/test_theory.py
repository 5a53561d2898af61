"""Law ``rft3d`` against simulations of resistive force theory, which sum it panel by panel."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from terraphi import Rig, calibrate, invert
from terraphi.experiment.errors import InputError
from terraphi.experiment.history import window_weights
from terraphi.experiment.scenario import Scenario
from terraphi.forward import simulate
from terraphi.forward.rft import stress_scale
from terraphi.laws.named import law_named
from terraphi.laws.store import PHI
from terraphi.laws.theory import Theory

OTHER = {
    "leg.shape": "c", "leg.chord": 0.12, "leg.width": 0.03, "leg.half_thickness": 0.005,
    "leg.friction": 0.25, "motion.hip.1": 0.215,
}  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "phi"),
    [({"leg.shape": "straight"}, 16.0), ({"leg.shape": "reversed_c"}, 48.0), (OTHER, 29.3)],
)
def test_forces_and_moments_are_those_of_a_simulation(changes: dict[str, Any], phi: float) -> None:
    """Of any rig, at any angle."""
    scenario = Scenario.load("quick").replace(**changes, **{PHI: phi})
    history = simulate(scenario)
    rig = Rig.of_scenario(scenario)
    law = Theory().law(rig)
    force, arm = law(np.array([[phi]]))[0], law.arm
    assert scenario.soil.density == law.density
    centre, half = np.radians(law.theta_deg), np.radians(0.5)
    means = history.means(centre, half).T
    np.testing.assert_allclose(force, means, atol=2e-3 * np.abs(means).max())
    ends = (np.clip(centre + end, *history.position[[0, -1]]) for end in (-half, half))
    moment = window_weights(history.position, *ends) @ history.moment
    np.testing.assert_allclose((arm * force).sum(axis=0), moment, atol=0.01 * np.ptp(moment))
    assert invert(history).phi.median == pytest.approx(phi, abs=2e-3)


def test_forces_are_in_proportion_to_density_and_scale() -> None:
    """Up to the ends of the law; beyond them it is refused."""
    rig = {"leg": "c", "length_mm": 110, "width_mm": 40, "thickness_mm": 8, "hip_height_mm": 35}
    theory, phi = law_named("rft3d"), np.array([15.0, 25.0, 35.0, 50.0])
    curves = theory.forces(rig, phi, density=1000.0)
    scaled = curves.forces / stress_scale(phi, 1.0)[:, None, None]
    np.testing.assert_allclose(scaled, scaled[[0] * 4], rtol=1e-12)
    double = theory.forces(rig, phi, density=2000.0)
    np.testing.assert_allclose(double.forces, 2.0 * curves.forces, rtol=1e-12)
    near = theory.forces(rig, [29.99, 30.0, 30.01], density=1000.0)
    slope = (near.forces[2] - near.forces[0]) / 0.02
    np.testing.assert_allclose(near.slope[1], slope, atol=1e-3 * float(abs(slope).max()))
    with pytest.raises(InputError, match="15 to 50"):
        theory.forces(rig, 51.0)


def test_the_friction_of_a_leg_is_that_measured_unless_it_is_given() -> None:
    """Aluminum on poppy seeds: 0.40."""
    sizes = {"leg": "straight", "length_mm": 76.2, "width_mm": 25.4, "thickness_mm": 6.4,
             "hip_height_mm": 20}  # fmt: skip
    measured, given, same = (
        invert("li2013:yuma/straight", rig=rig, law="rft3d")
        for rig in (sizes, {**sizes, "leg_friction": "0.2±0.02"}, {**sizes, "leg_friction": 0.4})
    )
    assert (measured.leg_friction, given.leg_friction) == (0.4, 0.2)
    assert measured.phi.median == pytest.approx(same.phi.median, abs=1e-9)
    assert given.phi.median != pytest.approx(measured.phi.median, abs=0.1)


def test_a_calibration_by_former_simulations_is_refused() -> None:
    calibration = calibrate("li2013:yuma/straight", 27.0, 1.0, law="rft3d")
    assert invert("li2013:poppy_loose/straight", law="rft3d", calibration=calibration).phi.sd > 0.0
    former = calibration.model_copy(update={"library_hash": "0" * 64})
    with pytest.raises(InputError, match="calibrate again"):
        invert("li2013:poppy_loose/straight", law="rft3d", calibration=former)
