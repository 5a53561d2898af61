"""The simulators' own material laws yield at the angle that was meant; where they are installed.

They are large and none of the developer's tools: ``pip install genesis-world newton`` (and torch).
"""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]

spec = importlib.util.spec_from_file_location(
    "element_tests", Path(__file__).with_name("test_simulators.py")
)
assert spec is not None
assert spec.loader is not None
elements = importlib.util.module_from_spec(spec)
spec.loader.exec_module(elements)

PHI = (25.0, 35.0, 45.0)


def genesis_material(angle_deg: float) -> Any:
    gs = pytest.importorskip("genesis")
    if not gs._initialized:
        gs.init(backend=gs.cpu, precision="64", logging_level="error")
    import quadrants as qd

    shear, lame = elements.SHEAR, elements.LAMBDA
    young = shear * (3 * lame + 2 * shear) / (lame + shear)
    sand = gs.materials.MPM.Sand(
        friction_angle=angle_deg, E=young, nu=lame / (2 * (lame + shear)), rho=1600.0
    )
    kept = [qd.Matrix.field(3, 3, dtype=gs.qd_float, shape=()) for _ in range(7)]
    u, s, v, trial, new, s_new, stress = kept

    @qd.kernel
    def step():
        f_new, s_out, jp = sand._update_F_S_Jp_sand(
            gs.qd_float(1.0), trial[None], u[None], s[None], v[None], gs.qd_float(0.0)
        )
        new[None] = f_new
        s_new[None] = s_out
        stress[None] = sand._update_stress_sand(
            u[None], s_out, v[None], trial[None], f_new, gs.qd_float(1.0), jp, gs.qd_float(0.0),
            qd.Vector([0.0, 0.0, 1.0]),
        )  # fmt: skip

    def update(deformation: Any, strain: np.ndarray) -> tuple[Any, np.ndarray]:
        if deformation is None:
            deformation = np.eye(3) * np.exp(-elements.PRESSURE / (3 * lame + 2 * shear))
        moved = (np.eye(3) + strain) @ deformation
        left, stretch, right = np.linalg.svd(moved)
        for field, value in ((u, left), (s, np.diag(stretch)), (v, right.T), (trial, moved)):
            field.from_numpy(value)
        step()
        return new.to_numpy(), stress.to_numpy()

    return update


def newton_material(friction: float) -> Any:
    wp = pytest.importorskip("warp")
    pytest.importorskip("newton")
    from newton._src.solvers.implicit_mpm import rheology_solver_kernels as law

    @wp.kernel
    def project(
        stress: wp.array(dtype=wp.mat33),  # type: ignore[valid-type]
        out: wp.array(dtype=wp.mat33),  # type: ignore[valid-type]
        mu: float,
    ):
        limits = law.YieldParamVec.from_values(mu, 1.0e10, 0.0, 0.0, 0.0, 0.0)
        # The solver's stress is that of compression, in the components of its strain space.
        held = law.project_stress(wp.fem.SymmetricTensorMapper.value_to_dof_3d(-stress[0]), limits)
        out[0] = -wp.fem.SymmetricTensorMapper.dof_to_value_3d(held)

    out = wp.zeros(1, dtype=wp.mat33, device="cpu")

    def update(stress: Any, strain: np.ndarray) -> tuple[Any, np.ndarray]:
        before = -elements.PRESSURE * np.eye(3) if stress is None else stress
        trial = elements.elastic(before, strain)
        given = wp.array([trial.astype(np.float32)], dtype=wp.mat33, device="cpu")
        wp.launch(project, dim=1, inputs=[given, out, friction], device="cpu")
        found = out.numpy()[0].astype(float)
        return found, found

    return update


@pytest.mark.parametrize("path", ["simple shear", "biaxial"])
@pytest.mark.parametrize(
    ("name", "material"), [("genesis", genesis_material), ("newton", newton_material)]
)
def test_the_engine_yields_at_the_angle_that_was_meant(name, material, path) -> None:
    for phi in PHI:
        stress = elements.load(material(elements.told(name, phi)), path)
        assert elements.mobilised_deg(stress) == pytest.approx(phi, abs=0.2)


def test_landlab_has_the_same_slope_with_its_own_triangle() -> None:
    """Dry, with cohesion."""
    landlab = pytest.importorskip("landlab")
    from landlab.components import LandslideProbability

    from terraphi.terrain.slopes import Sample

    slope, mode = 36.0, 31.0
    grid = landlab.RasterModelGrid((5, 5), xy_spacing=10.0)
    for name, value in {
        "topographic__slope": np.tan(np.radians(slope)),
        "topographic__specific_contributing_area": 50.0,
        "soil__transmissivity": 20.0,
        "soil__saturated_hydraulic_conductivity": 20.0,
        "soil__mode_total_cohesion": 2500.0,
        "soil__minimum_total_cohesion": 2499.0,
        "soil__maximum_total_cohesion": 2501.0,
        "soil__internal_friction_angle": mode,
        "soil__density": 2000.0,
        "soil__thickness": 1.0,
    }.items():
        grid.add_full(name, value, at="node")
    np.random.seed(0)  # noqa: NPY002 - landlab's own generator
    theirs = LandslideProbability(
        grid, number_of_iterations=4000, groundwater__recharge_distribution="uniform",
        groundwater__recharge_min_value=1e-7, groundwater__recharge_max_value=1e-6,
    )  # fmt: skip
    theirs.calculate_landslide_probability()
    node = grid.core_nodes[4]
    rng = np.random.default_rng(0)
    # It draws the thickness too, from 30 % below what it is told to 10 % above.
    depth = rng.triangular(0.7, 1.0, 1.1, 100_000)
    still = np.zeros_like(depth)
    sample = Sample(still, 2500.0 / (2000.0 * 9.81 * depth), still, still + 0.5)
    a, b = sample.terms(np.radians([slope]))
    phi = rng.triangular(0.82 * mode, mode, 1.32 * mode, depth.size)
    ours = (a[0] + b[0] * np.tan(np.radians(phi)) < 1.0).mean()
    assert 0.1 < ours < 0.8
    assert grid.at_node["landslide__probability_of_failure"][node] == pytest.approx(ours, abs=0.03)
