"""Transfers against conservation laws and a plain NumPy twin."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from terraphi.paper.plane.bed import Grid, Particles
from terraphi.paper.plane.transfer import grid_to_particle, particles_to_grid, weights

DX = 0.01
CELLS = 20
DT = 1e-4


def some_particles(count: int = 200, *, seed: int = 3, stressed: bool = True) -> Particles:
    rng = np.random.default_rng(seed)
    position = rng.uniform(0.51 * DX, (CELLS - 0.51) * DX, (count, 2))
    return Particles(
        position=position,
        start=position.copy(),
        velocity=rng.normal(size=(count, 2)),
        gradient=rng.normal(size=(count, 4)) * 30.0,
        stress=rng.normal(size=(count, 4)) * 1e3 * stressed,
        mass=rng.uniform(0.5, 2.0, count),
        volume=rng.uniform(0.5, 2.0, count) * DX**2,
        weight=rng.uniform(0.05, 1.0, count),
    )


def lattice(cells: int = CELLS, per_side: int = 2) -> np.ndarray:
    at = (np.arange(2 * per_side, (cells - 2) * per_side) + 0.5) * DX / per_side
    return np.stack([a.ravel() for a in np.meshgrid(at, at)], axis=1)


def at_rest(position: np.ndarray, volume: float) -> Particles:
    count = len(position)
    return Particles(
        position=position,
        start=position.copy(),
        velocity=np.zeros((count, 2)),
        gradient=np.zeros((count, 4)),
        stress=np.zeros((count, 4)),
        mass=np.ones(count),
        volume=np.full(count, volume),
        weight=np.ones(count),
    )


def empty() -> Grid:
    return Grid(*(np.zeros((CELLS + 2, CELLS + 2)) for _ in range(3)))


def node_places() -> tuple[np.ndarray, np.ndarray]:
    """x and z of the nodes, shape [row, column]."""
    at = np.arange(CELLS + 2) * DX
    return np.meshgrid(at, at)


def spline(distance: np.ndarray) -> np.ndarray:
    """Quadratic B-spline as the convolution of three boxes, written by distance [cells]."""
    d = np.abs(distance)
    return np.where(d < 0.5, 0.75 - d**2, np.where(d < 1.5, 0.5 * (1.5 - d) ** 2, 0.0))


def grid_by_numpy(soil: Particles) -> Grid:
    """Every particle to every node: no base node, no stencil; the tensor formula itself."""
    x, z = node_places()
    rx = x[None] - soil.position[:, 0, None, None]
    rz = z[None] - soil.position[:, 1, None, None]
    w = spline(rx / DX) * spline(rz / DX)
    mass = (soil.weight * soil.mass)[:, None, None]
    affine = soil.gradient.reshape(-1, 2, 2) * (soil.weight * soil.mass)[:, None, None]
    sxx, szz, sxz, _ = soil.stress.T
    tensor = np.stack([np.stack([sxx, sxz], -1), np.stack([sxz, szz], -1)], -2)
    volume = (soil.weight * soil.volume)[:, None, None]
    affine = affine - DT * 4.0 / DX**2 * volume * tensor
    at = np.stack([rx, rz], axis=-1)
    momentum = mass[..., None] * soil.velocity[:, None, None] + np.einsum(
        "pab,pjib->pjia", affine, at
    )
    total = (w[..., None] * momentum).sum(axis=0)
    return Grid((w * mass).sum(axis=0), total[..., 0], total[..., 1])


@given(st.floats(0.5, 1.5))
def test_weights_are_a_partition_of_unity_and_reproduce_lines(offset):
    w = np.array(weights(offset))
    node = np.arange(3)
    assert w.min() >= 0.0
    assert w.sum() == pytest.approx(1.0, abs=1e-14)
    assert w @ node == pytest.approx(offset, abs=1e-14)
    # The second moment about the particle is a quarter cell squared, which the affine
    # transfer's 4/Δx² is the inverse of.
    assert w @ (node - offset) ** 2 == pytest.approx(0.25, abs=1e-14)
    np.testing.assert_allclose(w, spline(node - offset), atol=1e-14)


def test_scatter_matches_numpy():
    soil, grid = some_particles(), empty()
    grid.mass[:] = 7.0  # must be cleared
    momentum = particles_to_grid(soil, grid, DX, DT)
    expected = grid_by_numpy(soil)
    for got, want in zip(grid, expected, strict=True):
        np.testing.assert_allclose(got, want, atol=1e-12 * np.abs(want).max())
    mass = soil.weight * soil.mass
    np.testing.assert_allclose(momentum, mass @ soil.velocity, rtol=1e-12)


@pytest.mark.parametrize("stressed", [False, True])
def test_scatter_conserves_mass_and_both_momenta(stressed):
    soil, grid = some_particles(stressed=stressed), empty()
    momentum = particles_to_grid(soil, grid, DX, DT)
    mass = soil.weight * soil.mass
    assert grid.mass.sum() == pytest.approx(mass.sum(), rel=1e-13)
    scale = np.abs(mass[:, None] * soil.velocity).sum()
    # A symmetric stress does no work on a rigid motion: it adds neither momentum.
    assert grid.vx.sum() == pytest.approx(momentum[0], abs=1e-13 * scale)
    assert grid.vz.sum() == pytest.approx(momentum[1], abs=1e-13 * scale)
    x, z = node_places()
    on_grid = (x * grid.vz - z * grid.vx).sum()
    assert on_grid == pytest.approx(angular_momentum(soil), abs=1e-13 * scale)


def angular_momentum(soil: Particles) -> float:
    """Σ m (x vz - z vx) + m Δx²/4 (∂vz/∂x - ∂vx/∂z): Jiang et al., 2015, section 5.3."""
    mass = soil.weight * soil.mass
    x, z = soil.position.T
    vx, vz = soil.velocity.T
    spin = 0.25 * DX**2 * (soil.gradient[:, 2] - soil.gradient[:, 1])
    return float((mass * (x * vz - z * vx + spin)).sum())


def test_round_trip_conserves_both_momenta():
    soil, grid = some_particles(stressed=False), empty()
    before = angular_momentum(soil)
    px, pz = particles_to_grid(soil, grid, DX, DT)
    occupied = grid.mass > 0
    for field in (grid.vx, grid.vz):
        field[occupied] /= grid.mass[occupied]
    for p in range(len(soil.mass)):
        vx, vz, gradient = grid_to_particle(soil, grid, p, DX)
        soil.velocity[p] = vx, vz
        soil.gradient[p] = gradient
    mass = soil.weight * soil.mass
    scale = np.abs(mass[:, None] * soil.velocity).sum()
    np.testing.assert_allclose(mass @ soil.velocity, [px, pz], atol=1e-13 * scale)
    assert angular_momentum(soil) == pytest.approx(before, abs=1e-13 * scale)


def test_affine_velocity_fields_survive_the_round_trip():
    a, b = np.array([0.3, -0.2]), np.array([[3.0, -7.0], [11.0, 5.0]])
    soil, grid = some_particles(stressed=False), empty()
    soil.velocity[:] = a + soil.position @ b.T
    soil.gradient[:] = b.ravel()
    particles_to_grid(soil, grid, DX, DT)
    x, z = node_places()
    field = a + np.stack([x, z], axis=-1) @ b.T
    # Compared as momenta, for nodes on the fringe hold hardly any mass.
    np.testing.assert_allclose(grid.vx, grid.mass * field[..., 0], atol=1e-12)
    np.testing.assert_allclose(grid.vz, grid.mass * field[..., 1], atol=1e-12)
    grid.vx[:], grid.vz[:] = field[..., 0], field[..., 1]
    for p in range(len(soil.mass)):
        vx, vz, gradient = grid_to_particle(soil, grid, p, DX)
        np.testing.assert_allclose([vx, vz], a + b @ soil.position[p], atol=1e-13)
        np.testing.assert_allclose(gradient, b.ravel(), atol=1e-11)


def test_stress_gradient_accelerates_as_cauchy_says():
    # ρ a = div σ with σ_xx = 2 c x, σ_xz = c' x: a_x = 2c/ρ, a_z = c'/ρ; and along z likewise.
    soil, grid = at_rest(lattice(per_side=4), (DX / 4) ** 2), empty()
    x, z = soil.position.T
    soil.stress[:, 0] = 2e5 * x
    soil.stress[:, 1] = -3e5 * z
    soil.stress[:, 2] = 4e5 * x + 5e5 * z
    particles_to_grid(soil, grid, DX, DT)
    inner = slice(6, CELLS - 5)
    # 16 particles a cell sum the spline's second moment to within two per cent.
    np.testing.assert_allclose(grid.vx[inner, inner], DT * DX**2 * (2e5 + 5e5), rtol=0.02)
    np.testing.assert_allclose(grid.vz[inner, inner], DT * DX**2 * (4e5 - 3e5), rtol=0.02)
