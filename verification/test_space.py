"""Three dimensions.

Smooth round footings on soil of one φ with associated flow are compared with exact loads by slip
lines, a wall as narrow as a leg with one in plane strain, and sheared soil with its strength, by
the numerics of preset `sand3d`.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from exact import circular_footing, ovesen, surcharge_factor
from runs import Run, at_end, loaded, sand3d
from terraphi.experiment.scenario import Scenario
from terraphi.experiment.units import GRAVITY

pytestmark = pytest.mark.slow

DENSITY = 1650.0
DIAMETER = 0.1
"""B of the footing [m]."""
CONFINEMENT = 1000.0
"""p of Caquot's correspondence [Pa]."""
CONTACT = (
    "contact ends at the edge or half a cell before it, which lies within 15 % on both sides of "
    "the exact load on 10 cells; 15 % is 1° of φ"
)


def test_slip_lines_give_published_loads(check):
    why = "three digits are printed, and the lines are some hundredths of R apart"
    check(
        "Slip lines of a smooth circle, weightless soil, φ = 35°",
        "N_c, Cox, Eason and Hopkins (1961)", expected=85.8,
        found=circular_footing(35.0, 1.0, 0.0, 0.0), within=3e-3, why=why,
    )  # fmt: skip
    check(
        "Slip lines of a smooth circle, γR/c = 10, φ = 30°", "q_u/c, Cox (1962)", expected=141.0,
        found=circular_footing(30.0, 1.0, 0.0, 10.0), within=5e-3,
        why=why,
    )  # fmt: skip
    check(
        "Slip lines of a smooth strip, weightless soil, φ = 30°", "N_q",
        expected=surcharge_factor(30.0), found=circular_footing(30.0, 0.0, 1.0, 0.0, strip=True),
        within=1e-3, why="the lines are some hundredths of B apart",
    )  # fmt: skip


def footing(phi_deg, pressure, cohesion, gravity, across, short):
    """Mean pressure [Pa] along the path of a smooth round footing, B/Δx = `across`.

    `pressure` is the exact load, `cohesion` c [Pa], `short` how many cells before the edge contact
    ends: the body is smaller by as much.
    """
    base = sand3d()
    content, cell = base.model_dump(), DIAMETER / across
    stiffness = 1e5 * pressure
    content["soil"] |= {
        "density": DENSITY, "youngs_modulus": stiffness, "friction_angle_deg": phi_deg,
        "yield_surface": "mohr_coulomb", "flow": "associated", "cohesion": cohesion,
    }  # fmt: skip
    # Steps and phases last as long compared with the time that a wave takes through a cell.
    speed = math.sqrt(stiffness * 0.7 / (1.3 * 0.4) / DENSITY)
    scale = cell / base.numerics.cell_size * base.soil.p_wave_speed / speed
    deep, wide = round(1.5 * across), math.ceil((4.0 if phi_deg <= 30.0 else 4.5) * across)
    cells, height, edge = max(wide, deep + 6) + 8, deep * cell, (3 + 1e-6) * cell
    radius, path = DIAMETER / 2 - short * cell, 15.0 * DIAMETER * pressure / stiffness
    content["leg"] |= {
        "shape": "cylinder", "chord": 4 * cell, "width": 2 * radius, "half_thickness": radius,
        "friction": 0.0,
    }  # fmt: skip
    content["motion"] = {
        "kind": "translation", "start": (0.5 * cells * cell, edge + height + 4 * cell),
        "velocity": (0.0, -0.05 * pressure / (DENSITY * speed)), "distance": path,
        "bin_width": path / 200,
    }  # fmt: skip
    content["bed"] |= {
        "left": edge, "floor": edge, "width": (cells - 3) * cell - edge - 2e-6 * cell,
        "height": height, "breadth": 2 * math.ceil(wide / 2) * cell, "gravity": gravity,
    }  # fmt: skip
    content["numerics"] |= {
        "domain": cells * cell, "cells": cells, "speed_up": 1.0, "particle_jitter": 0.0,
        "time_step": scale * base.numerics.time_step, "tip_inset_cells": 0.0,
        "remap_interval": scale * base.numerics.remap_interval,
    }  # fmt: skip
    return loaded(Scenario.model_validate(content))[1][:, 1] / (0.25 * math.pi * DIAMETER**2)


@pytest.mark.parametrize(("phi", "short"), [(30.0, 0.0), (35.0, 0.0), (30.0, 0.5)])
def test_round_footing_on_weightless_soil_meets_slip_lines(check, phi, short):
    exact = circular_footing(phi, 0.0, 1.0, 0.0)
    cohesion = CONFINEMENT * math.tan(math.radians(phi))
    pressure = footing(phi, CONFINEMENT * (exact - 1.0), cohesion, 0.0, 10, short)
    ends = f"contact {'half a cell short of' if short else 'to'} the edge"
    check(
        f"Round footing on weightless soil, φ = {phi:g}°, smooth, B/Δx = 10, {ends}", "N_q",
        expected=exact, found=at_end(1.0 + pressure / CONFINEMENT), within=0.15, why=CONTACT,
    )  # fmt: skip


def test_round_footing_on_soil_with_weight_meets_slip_lines(check):
    cohesion = DENSITY * GRAVITY * DIAMETER / 2 / 10.0
    exact = circular_footing(30.0, 1.0, 0.0, 10.0)
    pressure = footing(30.0, exact * cohesion, cohesion, GRAVITY, 10, 0.5)
    check(
        "Round footing, γR/c = 10, φ = 30°, smooth, B/Δx = 10, contact half a cell short of the "
        "edge",
        "q_u/c", expected=exact, found=at_end(pressure / cohesion), within=0.15, why=CONTACT,
    )  # fmt: skip


@pytest.mark.parametrize(("phi", "surface"), [(25.0, "matsuoka_nakai"), (45.0, "mohr_coulomb")])
def test_narrow_wall_bears_more_than_plane_strain(check, phi, surface):
    """An upright slab as deep and wide as the buried leg, soil on both sides, Δx 3.5 mm."""
    depth, breadth, path, means = 0.054, 0.0254, 4e-3, []
    base = sand3d(
        86,
        **{
            "soil.friction_angle_deg": phi, "soil.yield_surface": surface,
            "numerics.speed_up": 1.0,
        },
    )  # fmt: skip
    for flat in (False, True):
        content, cell = base.model_dump(), base.numerics.cell_size
        content["leg"] |= {
            "shape": "plate", "chord": depth + 0.02, "half_thickness": 5e-3, "width": breadth,
        }  # fmt: skip
        content["motion"] = {
            "kind": "translation", "velocity": (-0.02, 0.0), "distance": path,
            "start": (0.5 * base.numerics.domain, base.bed.floor + base.bed.height + 0.02),
            "bin_width": path / 40,
        }  # fmt: skip
        if flat:  # a slab a cell thick on either side of the plane of symmetry
            content["leg"]["width"] = content["bed"]["breadth"] = 2 * cell
        place, force = loaded(Scenario.model_validate(content))
        means.append(abs(float(force[place > 0.5 * path, 0].mean())) / content["leg"]["width"])
    check(
        f"Narrow wall, φ = {phi:g}°, `{surface}`, ψ = 0, b/h = 0.47, h/Δx = 15",
        "thrust over that in plane strain (Ovesen 1964)", expected=ovesen(phi, breadth / depth),
        found=means[0] / means[1], within=0.15,
        why="Ovesen's formula fits tests that scatter by as much",
    )  # fmt: skip


def strength_borne(scenario, first_deg):
    """Mobilised sin φ over sin φ of soil that is sheared, weighed by its mean stress.

    Soil counts whose plastic shear strain grows by more than 0.3 in a second of the leg's motion,
    under more than 200 Pa, at the end of each phase. φ of a stress state is that of plane strain,
    I₁ I₂/I₃ = 9 + 6 tan² φ.
    """
    run, numerics = Run(scenario), scenario.numerics
    steps, done = numerics.steps_per_phase, 0
    own_time = steps * numerics.time_step * numerics.speed_up
    theta, borne, due = scenario.motion.start_deg, 0.0, 0.0
    while theta < scenario.motion.stop_deg:
        before = run.soil.strain.astype(np.float64)
        run.follow(done, steps)
        done += steps
        theta += math.degrees(scenario.motion.top_coordinate_rate * own_time)
        if theta < first_deg:
            continue
        sheared = (run.soil.strain - before) / own_time > 0.3
        xx, yy, zz, xy, xz, yz = -run.soil.stress[sheared].astype(np.float64).T
        rows = ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))
        low, middle, high = np.linalg.eigvalsh(np.moveaxis(np.array(rows), -1, 0)).T
        mean, product = (low + middle + high) / 3.0, low * middle * high
        pairs = low * middle + middle * high + high * low
        with np.errstate(divide="ignore", invalid="ignore"):
            tangent2 = np.maximum(3.0 * mean * pairs / product - 9.0, 0.0) / 6.0
        counts = (mean > 200.0) & (low > 0.0)
        borne += float(mean[counts] @ np.sqrt(tangent2 / (1.0 + tangent2))[counts])
        due += float(mean[counts].sum())
    return borne / due / math.sin(math.radians(scenario.soil.friction_angle_deg))


@pytest.mark.parametrize("phi", [35.0, 50.0])
def test_soil_that_flows_is_at_yield(check, phi):
    """Waves that nothing damps would make soil flow below its strength."""
    changes = {"motion.start_deg": -80.0, "motion.stop_deg": -40.0}
    scenario = sand3d(**{"soil.friction_angle_deg": phi, **changes})
    check(
        f"Straight leg of `sand3d` on its way in, φ = {phi:g}°", "strength borne over strength",
        expected=1.0, found=strength_borne(scenario, -50.0), within=0.02, sense="at_least",
        why="2 % of the strength is half a degree; undamped soil bore 86 % at 50°, and half the "
        "force",
    )  # fmt: skip
