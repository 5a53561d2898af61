"""Whole steps against conservation laws, elasticity and stability."""

from __future__ import annotations

import math

import numpy as np
import pytest

from terraphi.experiment.scenario import COURANT_LIMIT, GRAVITY, Scenario
from terraphi.forward.driver import path_of_steps
from terraphi.forward.ledger import LEDGER_ROWS
from terraphi.paper.plane.bed import geostatic_bed
from terraphi.paper.plane.model import model_of
from terraphi.paper.plane.scalar import faded

ON_NODES = {
    "numerics.cells": 60,
    "bed.left": 0.005,
    "bed.floor": 0.005,
    "bed.width": 0.290,
    "bed.height": 0.165,
}
"""Cells of 5 mm: walls and floor lie on nodes."""


def test_free_fall_without_walls(coarse, steps, far_away):
    scenario = coarse(**far_away, **{"numerics.damping_rate": 0.0})
    soil = geostatic_bed(scenario)
    soil.stress[:] = 0.0
    nowhere = model_of(scenario)._replace(first_x=-9.0, last_x=9.0, floor=-9.0)
    start, count, dt = soil.position.copy(), 200, 5e-5
    fallen = steps(scenario, count, soil=soil, model=nowhere)
    np.testing.assert_allclose(soil.velocity[:, 1], -GRAVITY * count * dt, rtol=1e-11)
    assert np.abs(soil.velocity[:, 0]).max() < 1e-12
    # Symplectic Euler: z = -g Δt² n (n + 1)/2.
    drop = GRAVITY * dt**2 * count * (count + 1) / 2
    np.testing.assert_allclose(start[:, 1] - soil.position[:, 1], drop, rtol=1e-10)
    # Rounding in the gradient times 27 MPa.
    assert np.abs(soil.stress).max() < 1e-3
    mass = soil.mass.sum()
    assert fallen.audit.ledger[0] == pytest.approx([0.0, -mass * GRAVITY * count * dt], rel=1e-12)
    assert not fallen.audit.ledger[1:].any()


def test_damping_alone_is_a_decay_of_its_rate(coarse, steps, far_away):
    scenario = coarse(**far_away)
    soil = geostatic_bed(scenario)
    soil.stress[:] = 0.0
    soil.velocity[:] = [0.01, 0.02]
    nowhere = model_of(scenario)._replace(first_x=-9.0, last_x=9.0, floor=-9.0, gravity=0.0)
    steps(scenario, 100, soil=soil, model=nowhere)
    factor = 0.997 ** (100 * 5e-5 / 8e-6 / 20.0)
    np.testing.assert_allclose(soil.velocity, np.tile([0.01, 0.02], (len(soil.mass), 1)) * factor)


@pytest.mark.parametrize(("order", "kept"), [("before_contact", 1.0), ("after_contact", 0.997)])
def test_damping_before_contact_spares_what_the_leg_moves(coarse, steps, order, kept):
    """Nodes that take the leg's velocity have it whole, or once damped; the books close either way.

    The factor is that of one step of 8 µs at k = 1.
    """
    scenario = coarse(
        **{"motion.start_deg": -0.001, "motion.stop_deg": 10.0, "motion.rate": 1.0},
        **{"numerics.time_step": 8e-6, "numerics.speed_up": 1.0, "leg.friction": 0.0},
        **{"numerics.damping_order": order},
    )
    pushed = steps(scenario, 2)
    # A vertical leg moves backward by ω r; the row of nodes at half its length, beside its back.
    j = round((0.190 - 0.040) / scenario.numerics.cell_size)
    speed = 0.190 - j * scenario.numerics.cell_size
    assert pushed.grid.vx[j].min() == pytest.approx(-kept * speed, rel=1e-4)
    assert pushed.audit.worst[0] < 1e-12


def test_pic_loses_the_spin_that_apic_keeps(coarse, steps, far_away):
    """After one transfer the particles of both have the same velocity and gradient of the grid; of
    its angular momentum PIC has then lost what the gradient holds, Σ m Δx²/4 (∂vz/∂x - ∂vx/∂z)."""
    spun = {}
    for transfer in ("apic", "pic"):
        scenario = coarse(
            **far_away, **{"numerics.damping_rate": 0.0, "numerics.transfer": transfer}
        )
        soil = geostatic_bed(scenario)
        soil.stress[:] = 0.0
        arm = soil.position - [0.15, 0.09]
        soil.velocity[:] = 0.5 * arm @ [[0.0, 1.0], [-1.0, 0.0]]
        before = soil.mass @ (arm[:, 0] * soil.velocity[:, 1] - arm[:, 1] * soil.velocity[:, 0])
        nowhere = model_of(scenario)._replace(first_x=-9.0, last_x=9.0, floor=-9.0, gravity=0.0)
        steps(scenario, 1, soil=soil, model=nowhere)
        arm = soil.position - [0.15, 0.09]
        after = soil.mass @ (arm[:, 0] * soil.velocity[:, 1] - arm[:, 1] * soil.velocity[:, 0])
        spin = soil.mass @ (soil.gradient[:, 2] - soil.gradient[:, 1])
        spin *= scenario.numerics.cell_size**2 / 4
        spun[transfer] = (soil.velocity.copy(), before, after, spin)
    velocity, before, after, spin = spun["apic"]
    assert after + spin == pytest.approx(before, rel=1e-12)
    assert 0.003 * before < spin
    np.testing.assert_array_equal(spun["pic"][0], velocity)
    assert spun["pic"][2:] == (after, 0.0)


@pytest.mark.parametrize("relief", [False, True])
def test_mass_and_momentum_are_accounted_for(coarse, steps, relief):
    """Through the vertical, so that particles are far from their place and may fade."""
    scenario = coarse(
        **{
            "motion.start_deg": -30.0,
            "motion.stop_deg": 30.0,
            "relief.enabled": relief,
            "relief.distance": 0.01,
        }
    )
    soil = geostatic_bed(scenario)
    done = steps(scenario, 5000, soil=soil)
    assert done.lost == -1
    assert done.audit.worst[0] < 1e-10
    ledger = dict(zip(LEDGER_ROWS, done.audit.ledger, strict=True))
    assert np.allclose(done.impulse.sum(axis=0), -np.tile(ledger["leg"], 2), rtol=1e-12)
    momentum = (soil.weight * soil.mass) @ soil.velocity
    scale = np.abs(done.audit.ledger).sum()
    np.testing.assert_allclose(done.audit.ledger.sum(axis=0), momentum, atol=1e-11 * scale)
    if relief:
        assert soil.weight.min() < 0.5
        assert np.abs(ledger["relief"]).max() > 0
    else:
        assert (soil.weight == 1.0).all()
        assert not ledger["relief"].any()
        assert done.grid.mass.sum() == pytest.approx(soil.mass.sum(), rel=1e-12)


@pytest.mark.parametrize("criterion", ["plane_strain", "paper", "triaxial"])
def test_bed_at_rest_stays_at_rest(coarse, steps, far_away, criterion):
    scenario = coarse(
        **far_away,
        **{
            **ON_NODES,
            "numerics.speed_up": 1.0,
            "numerics.time_step": 3e-5,
            "soil.yield_criterion": criterion,
            "soil.friction_angle_deg": 30.0,
        },
    )
    soil = geostatic_bed(scenario)
    start = soil.position.copy()
    done = steps(scenario, 1500, soil=soil)
    assert not done.impulse.any()
    # Elastic self-weight settlement is 8 µm; no more than that is lost to unlucky places and, with
    # the paper's yield, to stresses at rest that lie outside it.
    assert np.abs(soil.position - start).max() < 20e-6
    assert np.abs(soil.velocity).max() < 1e-3
    depth = 0.170 - soil.position[:, 1]
    deep = depth > 0.02
    slope = (soil.stress[deep, 1] @ depth[deep]) / (depth[deep] @ depth[deep])
    assert slope == pytest.approx(-1650.0 * GRAVITY, rel=0.02)
    if criterion == "plane_strain":
        lateral = soil.stress[deep, 0].sum() / soil.stress[deep, 1].sum()
        assert lateral == pytest.approx(0.5, abs=0.02)  # K0 = 1 - sin 30°
    # The floor carries the weight in the end.
    weight = soil.mass.sum() * GRAVITY * 3e-5 * 1500
    assert done.audit.ledger[LEDGER_ROWS.index("walls"), 1] == pytest.approx(weight, rel=0.02)


COARSE_BOX = {
    "numerics.cells": 32,
    "bed.left": 0.010,
    "bed.floor": 0.010,
    "bed.width": 0.280,
    "bed.height": 0.160,
}


def elastic(coarse, far_away, **changes) -> Scenario:
    return coarse(
        **far_away,
        **{
            **ON_NODES,
            "numerics.time_step": 3e-5,
            "numerics.particle_jitter": 0.0,
            "soil.cohesion": 1e9,
            "bed.floor_friction": "smooth",
            **changes,
        },
    )


def test_oedometer_under_self_weight(coarse, steps, far_away):
    """Gravity switched on: surface settles γh²/2M = 8.2 µm, K = ν/(1 - ν), σ_v = γ depth."""
    scenario = elastic(
        coarse, far_away, **{"numerics.damping_rate": 1000.0, "numerics.speed_up": 1.0}
    )
    soil = geostatic_bed(scenario)
    soil.stress[:] = 0.0
    steps(scenario, 1000, soil=soil)
    settled = soil.start[:, 1] - soil.position[:, 1]
    top = settled[soil.start[:, 1] > 0.165].mean()
    assert top == pytest.approx(8.2e-6, rel=0.03)
    depth = 0.170 - soil.position[:, 1]
    inner = (depth > 0.01) & (depth < 0.155)
    bottom = 1650 * GRAVITY * 0.165
    vertical = -1650 * GRAVITY * depth[inner]
    np.testing.assert_allclose(soil.stress[inner, 1], vertical, rtol=0, atol=0.03 * bottom)
    ratio = soil.stress[inner, 0].sum() / soil.stress[inner, 1].sum()
    assert ratio == pytest.approx(0.3 / 0.7, rel=0.01)


def test_compression_wave_runs_at_its_speed(coarse, steps, far_away):
    """The bed, let go, bounces with the period 4h/c_p of a column on a rigid floor."""
    scenario = elastic(coarse, far_away, **{"numerics.damping_rate": 0.0})
    period = 4 * 0.165 / 127.7
    count = round(0.5 * period / 3e-5)
    soil = geostatic_bed(scenario)
    soil.stress[:] = 0.0
    steps(scenario, count // 2, soil=soil)
    fastest = soil.velocity[:, 1].mean()
    steps(scenario, count - count // 2, soil=soil)
    # At half a period it turns; the mean velocity then changes by g every second.
    late = -soil.velocity[:, 1].mean() / GRAVITY
    assert fastest < -0.5 * GRAVITY * 0.25 * period
    assert abs(late) < 0.03 * period


def test_quiet_just_below_the_courant_limit(coarse, steps, far_away):
    """Elastic soil, no damping: nothing but the time step keeps a disturbance from growing."""
    scenario = elastic(
        coarse,
        far_away,
        **COARSE_BOX,
        **{
            "numerics.particle_jitter": 1.0,
            "numerics.damping_rate": 0.0,
            "soil.k0": 0.4286,
        },
    )
    scenario = scenario.replace(**{"numerics.time_step": 0.999 * scenario.time_step_limit})
    assert rms_after_disturbance(scenario, steps, 2000) < 5e-3


def test_unstable_well_above_the_courant_limit(coarse, steps, far_away):
    """The limit is not idle: half as much again, and the same bed blows up."""
    scenario = elastic(coarse, far_away, **COARSE_BOX, **{"numerics.particle_jitter": 1.0})
    step = 1.5 / COURANT_LIMIT * scenario.time_step_limit
    numerics = scenario.numerics.model_copy(update={"time_step": step})
    scenario = scenario.model_copy(update={"numerics": numerics})
    assert not rms_after_disturbance(scenario, steps, 2000) < 1.0


def rms_after_disturbance(scenario: Scenario, steps, count: int) -> float:
    """RMS velocity [m/s] that an initial random 1 mm/s has become; infinite if particles left."""
    soil = geostatic_bed(scenario)
    rng = np.random.default_rng(scenario.numerics.seed)
    soil.velocity[:] = 1e-3 * rng.standard_normal(soil.velocity.shape)
    if steps(scenario, count, soil=soil).lost >= 0:
        return math.inf
    return float(np.sqrt((soil.velocity**2).sum(axis=1).mean()))


# -- relief against its formula -----------------------------------------------------------------

PAPER = model_of(Scenario())
"""Distance 20 mm, rate 2 /rad, least 0.05."""


def decay(turned: float) -> float:
    return math.exp(-2.0 * turned)


def after(turns: int, turned: float, *, dx: float = 0.03) -> float:
    weight = 1.0
    for _ in range(turns):
        weight = faded(weight, dx, 0.0, decay(turned), PAPER)
    return weight


def test_decays_by_the_angle_turned_whatever_the_step():
    for turns in (1, 10, 1000):
        assert after(turns, 0.7 / turns) == pytest.approx(math.exp(-1.4), rel=1e-12)


def test_only_far_particles_after_the_vertical_fade():
    factor = decay(0.1)
    assert faded(0.8, 0.0199, 0.0, factor, PAPER) == 0.8
    assert faded(0.8, 0.012, 0.016, factor, PAPER) == 0.8  # exactly 20 mm is not beyond it
    assert faded(0.8, 0.0, -0.0201, factor, PAPER) < 0.8
    assert faded(0.8, 0.03, 0.0, decay(0.0), PAPER) == 0.8


@pytest.mark.parametrize("speed_up", [1.0, 20.0])
def test_turned_angle_counts_from_the_vertical_and_does_not_see_the_speed_up(speed_up):
    scenario = Scenario().replace(
        **{
            "motion.start_deg": -10.0,
            "motion.stop_deg": 20.0,
            "numerics.speed_up": speed_up,
            "numerics.time_step": 1.5e-5,
        }
    )
    count = math.ceil(math.radians(30.0) / (0.2 * speed_up * 1.5e-5))
    _, turned, _ = path_of_steps(scenario, np.arange(count), 300)
    step = 0.2 * speed_up * 1.5e-5
    assert turned.sum() == pytest.approx(math.radians(20.0), abs=2 * step)
    assert not turned[: int(math.radians(9.99) / step)].any()
