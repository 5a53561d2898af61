"""Limit loads.

A plate that moves the soil must meet the limit load of plasticity theory, or φ inferred from forces
has another meaning. The plate is a leg in plane strain with contact at the nodes within half a
cell. The soil is so stiff that the plate reaches its limit load before it has visibly moved. The
last row of the passive wall is the plateau of a leg's force history.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from exact import (
    davis,
    lower_bound,
    moved_wall,
    rankine,
    rough_wall,
    surcharge_factor,
    upper_bound,
)
from runs import ELASTIC, ON_NODES, Run, at_end, benchmark, block_of, loaded, unchecked
from terraphi.experiment.leg import Leg
from terraphi.experiment.scenario import Scenario
from terraphi.experiment.units import GRAVITY

pytestmark = pytest.mark.slow

DENSITY = 1650.0
MODULUS_RATIO = 0.7 / (1.3 * 0.4)
"""M/E at ν = 0.3."""
SIZE = 0.1
"""Height of the wall and width of the footing [m]."""
CONFINEMENT = 1000.0
"""Pressure p of Caquot's correspondence, and of a dead weight [Pa]."""
HEAVY = 20.0
"""Dead weight over γB."""
EDGE = "slip at the edge is spread over one or two cells; errors fall in proportion to Δx"
TOE = "at the toe the plate drives nodes that the floor holds; 5 % of K_p is 1.2° of φ"


def plate_on_soil(phi_deg, cell, cells, stiffness, *, flow="associated", cohesion=0.0, **parts):
    """A scenario of a plate; `parts` are its leg, motion and bed."""
    wave = math.sqrt(stiffness * MODULUS_RATIO / DENSITY)
    return Scenario.model_validate(
        {
            "soil": {
                "density": DENSITY, "youngs_modulus": stiffness, "friction_angle_deg": phi_deg,
                "yield_criterion": "plane_strain", "flow": flow, "cohesion": cohesion,
            },
            "relief": {"enabled": False},
            "numerics": {
                "domain": cells * cell, "cells": cells, "damping_rate": 0.0,
                "contact_band_cells": 0.5, "time_step": parts.pop("courant") * cell / wave,
                "particle_jitter": parts.pop("jitter"),
            },
            **parts,
        }
    )  # fmt: skip


def drive(pressure, pace=0.05):
    """Stiffness E = 10⁵ q_u [Pa], speed with ρ c v = `pace` q_u [m/s], and path 15 q_u/E [m]."""
    stiffness = 1e5 * pressure
    wave = math.sqrt(stiffness * MODULUS_RATIO / DENSITY)
    return stiffness, pace * pressure / (DENSITY * wave), 15.0 * SIZE * pressure / stiffness


def wall(phi_deg, friction, across, *, flow="associated", floor="rough", far=False):
    """K_p along the path of a plate that pushes a bed, h/Δx = `across`; and displacement over h."""
    exact = rough_wall(phi_deg, friction) if friction else rankine(phi_deg)
    stiffness, speed, path = drive(exact * DENSITY * GRAVITY * SIZE)
    if far:  # in soil as soft as that of the leg
        stiffness, speed, path = 5e6, 0.02, 0.1 * SIZE
    cell = SIZE / across
    # A hair beyond the nodes, which then hold the soil behind them.
    thick, left, bottom = 4 * cell, (3 + 1e-6) * cell, (3 + 1e-6) * cell
    front = left + 2 * thick + 2 * cell
    cells = math.ceil((front + (5.0 if friction else 4.0) * SIZE) / cell) + 3
    scenario = plate_on_soil(
        phi_deg, cell, cells, stiffness, flow=flow,
        courant=0.4 if far else 0.6, jitter=0.5 if far else 0.0,
        leg={
            "shape": "plate", "chord": 2 * SIZE + bottom, "half_thickness": thick, "width": 1.0,
            "friction": friction,
        },
        motion={
            "kind": "translation", "start": [front - thick, bottom + 2 * SIZE],
            "velocity": [speed, 0.0], "distance": path, "bin_width": path / 200,
        },
        bed={
            "left": left, "floor": bottom, "width": (cells - 3) * cell - left, "height": SIZE,
            "soil_left": front, "floor_friction": floor,
        },
    )  # fmt: skip
    place, force = loaded(scenario)
    return place / SIZE, -force[:, 0] / (0.5 * DENSITY * GRAVITY * SIZE**2)


@pytest.mark.parametrize("phi", [25.0, 35.0])
def test_smooth_wall_meets_rankine(check, phi):
    check(
        f"Passive wall, φ = {phi:g}°, smooth, on a smooth floor, associated, h/Δx = 20", "K_p",
        expected=rankine(phi), found=at_end(wall(phi, 0.0, 20, floor="smooth")[1]), within=0.02,
        why=EDGE,
    )  # fmt: skip


@pytest.mark.parametrize("phi", [25.0, 35.0])
def test_rough_wall_meets_slip_lines(check, phi):
    check(
        f"Passive wall, φ = {phi:g}°, μ = 0.35, on a rough floor, associated, h/Δx = 20",
        "K_p", expected=rough_wall(phi, 0.35), found=at_end(wall(phi, 0.35, 20)[1]),
        within=0.03, why=EDGE,
    )  # fmt: skip


@pytest.mark.parametrize("phi", [25.0, 35.0])
def test_wall_without_dilation_lies_between_davis_and_associated_flow(check, phi):
    lowest, highest = rankine(davis(phi)), rankine(phi)
    middle = 0.5 * (0.95 * lowest + 1.05 * highest)
    check(
        f"Passive wall, φ = {phi:g}°, smooth, on a rough floor, ψ = 0, h/Δx = 20", "K_p",
        expected=middle, found=at_end(wall(phi, 0.0, 20, flow="dilation")[1]),
        within=1.05 * highest / middle - 1.0,
        why="from 5 % below K_p at Davis's reduced angle to 5 % above that of associated flow: no "
        "exact one is known",
    )  # fmt: skip


def test_wall_that_moves_far_carries_what_its_toe_takes_in(check):
    place, pressure = wall(35.0, 0.0, 40, far=True)
    over = (place >= 0.02) & (place <= 0.10)
    check(
        "Passive wall that moves by 0.1 h, φ = 35°, smooth, on a rough floor, associated, "
        "h/Δx = 40",
        "K_p, mean over 0.02 to 0.1 h", expected=moved_wall(35.0, 0.06),
        found=float(pressure[over].mean()), within=0.05, why=TOE,
    )  # fmt: skip


def test_slip_lines_lie_between_published_bounds(check):
    exact, problem = rough_wall(35.0, 0.35), "Slip lines, φ = 35°, μ = 0.35"
    why = "a bound holds exactly; the integration is good to a millionth"
    check(
        problem, "K_p over Lancellotta's lower bound", expected=1.0, within=1e-6, why=why,
        found=exact / lower_bound(35.0, 0.35), sense="at_least",
    )  # fmt: skip
    check(
        problem, "K_p over Soubra and Macuh's upper bound", expected=1.0, within=1e-6, why=why,
        found=exact / upper_bound(35.0, 0.35), sense="at_most",
    )  # fmt: skip


def footing(phi_deg, base, across, *, dead_weight=False):
    """N_q = 1 + q/p along the path of half a strip footing, B/Δx = `across`.

    Of weightless soil by Caquot's correspondence, a cohesion c = p tan φ in place of a pressure p
    all around; or of a dead weight p on soil of little weight, whose N_γ is taken off.
    """
    exact = surcharge_factor(phi_deg)
    stiffness, speed, path = drive(CONFINEMENT * exact, 0.01 if dead_weight else 0.05)
    cell = SIZE / across
    wide, deep = next(
        size
        for most, *size in ((25.0, 5.0, 1.75), (35.0, 8.0, 2.5), (40.0, 10.5, 3.2))
        if phi_deg <= most
    )
    thick, left, bottom = 4 * cell, (4 + 1e-6) * cell, (3 + 1e-6) * cell
    height = round(deep * across) * cell
    cells = max(
        math.ceil((left + wide * SIZE) / cell) + 3, math.ceil((bottom + height + thick) / cell) + 8
    )
    light = CONFINEMENT / (HEAVY * DENSITY * SIZE)
    weights = {"gravity": light, "surcharge": CONFINEMENT} if dead_weight else {"gravity": 0.0}
    scenario = plate_on_soil(
        phi_deg, cell, cells, stiffness, courant=0.6, jitter=0.0,
        cohesion=0.0 if dead_weight else CONFINEMENT * math.tan(math.radians(phi_deg)),
        # From within the left wall, the plane of symmetry, to the footing's edge: the plate's tip.
        leg={
            "shape": "plate", "chord": SIZE / 2 + 3 * cell, "half_thickness": thick, "width": 1.0,
            "friction": 100.0 if base == "rough" else 0.0,
        },
        motion={
            "kind": "translation", "start": [left - 3 * cell, bottom + height + thick],
            "orientation_deg": -90.0, "velocity": [0.0, -speed], "distance": path,
            "bin_width": path / 200,
        },
        bed={
            "left": left, "floor": bottom, "width": wide * SIZE - 2e-6 * cell, "height": height,
            **weights,
        },
    )  # fmt: skip
    pressure = loaded(scenario)[1][:, 1] / (SIZE / 2)
    own = 0.5 * 3.461 / HEAVY if dead_weight else 0.0  # N_γ of a smooth strip at 25°
    return pressure / CONFINEMENT + 1.0 - own


@pytest.mark.parametrize(
    ("phi", "base"), [(30.0, "smooth"), (40.0, "smooth"), (25.0, "rough")],
)  # fmt: skip
def test_strip_footing_meets_prandtl(check, phi, base):
    check(
        f"Strip footing on weightless soil, φ = {phi:g}°, {base}, associated, B/Δx = 20", "N_q",
        expected=surcharge_factor(phi), found=at_end(footing(phi, base, 20)), within=0.05, why=EDGE,
    )  # fmt: skip


def test_strip_footing_under_dead_weight_meets_prandtl(check):
    check(
        "Strip footing between dead weights, φ = 25°, smooth, associated, B/Δx = 10", "N_q",
        expected=surcharge_factor(25.0), within=0.10,
        found=at_end(footing(25.0, "smooth", 10, dead_weight=True)),
        why="the edge, as above, on cells twice as large",
    )  # fmt: skip


@pytest.mark.parametrize(("slope_deg", "friction"), [(22.0, 0.35), (45.0, 0.35), (19.0, 0.35)])
def test_block_slides_and_sticks_as_coulomb_says(check, slope_deg, friction):
    """An elastic block of soil on a tilted plate, put down with damping, then let go."""
    changes = {
        **ON_NODES, "numerics.contact_band_cells": 0.5, "numerics.damping_rate": 500.0,
        "soil.cohesion": ELASTIC,
    }  # fmt: skip
    scenario = benchmark(64, courant=0.4, **changes)
    slope, cell = math.radians(slope_deg), scenario.numerics.cell_size
    down = np.array([math.cos(slope), -math.sin(slope)])
    outward = np.array([math.sin(slope), math.cos(slope)])
    plate = Leg(shape="plate", chord=0.5, half_thickness=0.02, friction=friction)
    # Hip to tip points down the slope, and the plate's upper face goes through the foot.
    foot = np.array([0.045, 0.235])
    hip = foot - 0.1 * down - plate.half_thickness * outward
    pose = (*hip.tolist(), math.atan2(-down[0], -down[1]), 0.0, 0.0, 0.0)
    # Soil touches a node from one and a half cells off, and the band holds nodes off the plate.
    corner = foot + cell * outward
    soil = block_of(corner.tolist(), (0.080, 0.040), cell / 2, scenario.soil.density, tilt=-slope)
    scenario = unchecked(scenario, "bed", left=-9.0, width=18.0, floor=-9.0)
    scenario = scenario.model_copy(update={"leg": plate})
    time_step = scenario.numerics.time_step
    Run(scenario, soil).advance(round(0.03 / time_step), pose=pose)
    run = Run(unchecked(scenario, "numerics", damping_rate=0.0), soil)
    between, speed = round(0.004 / time_step), []
    for _ in range(30):
        run.advance(between, pose=pose)
        speed.append(float(soil.mass @ (soil.velocity @ down) / soil.mass.sum()))
    found = float(np.polyfit(between * time_step * np.arange(1, 31), speed, 1)[0])
    expected = max(0.0, GRAVITY * (math.sin(slope) - friction * math.cos(slope)))
    check(
        f"Block on an incline of {slope_deg:g}°, μ = {friction:g}",
        "a = g (sin b − μ cos b), or 0 [m/s²]", expected=expected, found=found,
        within=0.01 * (GRAVITY * math.sin(slope) if expected == 0.0 else 1.0),
        absolute=expected == 0.0,
        why="the block rocks as it is let go; 1 % of the slope's own pull where it sticks",
    )  # fmt: skip
