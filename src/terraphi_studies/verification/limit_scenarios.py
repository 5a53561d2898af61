"""Scenarios of the limit loads: a plate that pushes a bed, and half of a strip footing.

The exact limit load is that of the first geometry. It is read there: the soil is so stiff that the
plate has reached it long before anything has visibly moved.

Slip lines of a passive wall: the exact force of weighty soil on a rough upright plate.

Without cohesion and load on the surface the stress grows along each ray from the wall's upper edge
(Sokolovskii, 1965, *Statics of Granular Media*), σ = γ r s(θ), and the two equations of
equilibrium become ordinary ones for s and for the direction of the major principal stress. They
lead from the wall, where that direction is known, to the last ray of the passive zone of Rankine
that lies below the free surface.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from terraphi.experiment.scenario import GRAVITY, Scenario

DENSITY = 1650.0
MODULUS_RATIO = 0.7 / (1.3 * 0.4)
"""M/E at ν = 0.3."""
WALL_HEIGHT, FOOTING_WIDTH = 0.1, 0.1
"""h and B [m]."""
PLATEAU = (0.02, 0.10)
"""Displacements over which the force on a wall that moves far is averaged, over h."""
CONFINEMENT = 1000.0
"""p of a weightless soil, and pressure of a dead weight [Pa]."""
PACE, PACE_OF_DEAD_WEIGHT = 0.05, 0.01
"""ρ c v of a plate over its limit pressure. Dead weight is heavy, and swings for long if pushed."""
HEAVY = 20.0
"""Dead weight over γ B: N_γ then gives 1.5 to 2.6 % of the load."""
COHESION, BOTH = 10e3 / (1000.0 * 9.81), 42.64
"""c/(γ B) of a footing on soil with weight and cohesion, which others computed (see
:mod:`~terraphi_studies.verification.published`), and its exact q_u/c at φ = 30° if it is rough, by
slip lines [-]."""
PRESET, NODES, RESOLVED = "preset", "nodes", "resolved"
"""Names of settings: those of preset ``resolved-2`` (contact on the surface that ends before the
tip, phases, strains of whole cells where soil dilates); contact with the nodes within half a cell,
with a transfer at every step and the strains of each particle, to which the quick presets are
nearest; and those of preset ``resolved`` (as the first, but contact ends at the tip, and
particles of a cell share their dilatation alone)."""
BENEATH = 3
"""Soil beneath the toe of a rough wall, if there is any, is the wall's height over this."""


@dataclass(frozen=True)
class Drive:
    """How stiff the soil is and how the plate is moved.

    Attributes
    ----------
    stiffness
        E [Pa].
    speed
        Of the plate [m/s].
    path
        Of the plate [m].
    courant
        Δt over Δx / c.
    jitter
        Of the particles.
    """

    stiffness: float
    speed: float
    path: float
    courant: float
    jitter: float


MOVED = Drive(5e6, 0.02, PLATEAU[1] * WALL_HEIGHT, 0.4, 0.5)
"""As far as the plateau of a force history, in soil as soft as that of the leg."""


def drive_at_first(pressure: float, length: float, pace: float = PACE) -> Drive:
    """Drive to a limit pressure without moving what is there.

    E = 10⁵ q_u, and the plate goes 15 times as far as q_u/E of its length, 1.5·10⁻⁴ of it.

    Parameters
    ----------
    pressure
        q_u [Pa].
    length
        Of the plate [m].
    pace
        ρ c v of the plate over q_u [-].
    """
    stiffness = 1e5 * pressure
    wave = math.sqrt(stiffness * MODULUS_RATIO / DENSITY)
    return Drive(
        stiffness,
        pace * pressure / (DENSITY * wave),
        15.0 * length * pressure / stiffness,
        0.6,
        0.0,
    )


@cache
def preset(settings: str = PRESET) -> Scenario:
    """Preset ``resolved-2``, or ``resolved`` for :data:`RESOLVED`."""
    return Scenario.load("resolved-2" if settings == PRESET else "resolved")


def _numerics(settings: str, cell: float, cells: int, drive: Drive) -> dict[str, Any]:
    wave = math.sqrt(drive.stiffness * MODULUS_RATIO / DENSITY)
    size = {"domain": cells * cell, "cells": cells, "particle_jitter": drive.jitter}
    if settings == NODES:
        time_step = drive.courant * cell / wave
        return size | {"time_step": time_step, "damping_rate": 0.0, "contact_band_cells": 0.5}
    if settings not in (PRESET, RESOLVED):
        raise ValueError(f"no settings '{settings}'; there are '{PRESET}', '{NODES}', '{RESOLVED}'")
    # All of the preset but the size of things and where particles lie: its Courant number and its
    # steps a phase too.
    soil, numerics = preset(settings).soil, preset(settings).numerics
    time_step = numerics.time_step * soil.p_wave_speed / numerics.cell_size * cell / wave
    return numerics.model_dump() | {
        **size,
        "time_step": time_step,
        "remap_interval": numerics.steps_per_phase * time_step,
        "speed_up": 1.0,
    }


def _soil(phi_deg: float, flow: str, drive: Drive, cohesion: float = 0.0) -> dict[str, Any]:
    return {
        "density": DENSITY,
        "youngs_modulus": drive.stiffness,
        "friction_angle_deg": phi_deg,
        "yield_criterion": "plane_strain",
        "flow": flow,
        "cohesion": cohesion,
    }


def wall_scenario(
    phi_deg: float,
    friction: float,
    across: int,
    *,
    flow: str = "associated",
    settings: str = NODES,
    floor: str = "rough",
    beneath: bool = False,
    drive: Drive | None = None,
) -> Scenario:
    """A plate that pushes a bed in front of it.

    Parameters
    ----------
    phi_deg, friction
        φ [deg] and μ of the plate.
    across
        h/Δx.
    flow
        ``associated``, or ``dilation`` for ψ = 0.
    settings
        :data:`PRESET` or :data:`NODES`.
    floor
        ``rough`` or ``smooth``.
    beneath
        Whether there is soil between toe and floor. It needs a smooth wall behind it, in line with
        the plate's front, as :func:`~terraphi_studies.verification.driver.push` adds it.
    drive
        Soil's stiffness and plate's path; ``None``: to the limit in the first geometry.
    """
    if drive is None:
        at_toe = passive_pressure(phi_deg, friction) * DENSITY * GRAVITY * WALL_HEIGHT
        drive = drive_at_first(at_toe, WALL_HEIGHT)
    cell = WALL_HEIGHT / across
    # A hair beyond the nodes, which then hold the soil behind them.
    thick, left, bottom = 4 * cell, (3 + 1e-6) * cell, (3 + 1e-6) * cell
    front = left + 2 * thick + 2 * cell
    below = across // BENEATH * cell if beneath else 0.0
    length = (4.0 if friction == 0.0 else 5.0 if phi_deg <= 35.0 else 6.0) * WALL_HEIGHT
    cells = math.ceil((front + length) / cell) + 3
    return Scenario.model_validate(
        {
            "soil": _soil(phi_deg, flow, drive),
            "leg": {
                "shape": "plate",
                # Through the floor, where no soil is beneath.
                "chord": 2 * WALL_HEIGHT + (0.0 if beneath else bottom),
                "half_thickness": thick,
                "width": 1.0,
                "friction": friction,
            },
            "motion": {
                "kind": "translation",
                "start": [front - thick, bottom + below + 2 * WALL_HEIGHT],
                "velocity": [drive.speed, 0.0],
                "distance": drive.path,
                "bin_width": drive.path / 200,
            },
            "bed": {
                "left": left,
                "floor": bottom,
                "width": (cells - 3) * cell - left,
                "height": WALL_HEIGHT + below,
                "soil_left": front,
                "floor_friction": floor,
            },
            "numerics": _numerics(settings, cell, cells, drive),
        }
    )


def _loading(phi_deg: float, base: str, load: str) -> tuple[float, dict[str, float], float]:
    """Limit pressure [Pa], entries of the bed and cohesion [Pa] of a footing's load."""
    if load == "weight":
        pressure = 0.5 * DENSITY * GRAVITY * FOOTING_WIDTH * N_GAMMA[phi_deg, base]
        return pressure, {"gravity": GRAVITY}, 0.0
    if load == "weight and cohesion":
        cohesion = COHESION * DENSITY * GRAVITY * FOOTING_WIDTH
        return BOTH * cohesion, {"gravity": GRAVITY}, cohesion
    pressure = CONFINEMENT * surcharge_factor(phi_deg)
    if load == "cohesion":
        return pressure, {"gravity": 0.0}, CONFINEMENT * math.tan(math.radians(phi_deg))
    light = CONFINEMENT / (HEAVY * DENSITY * FOOTING_WIDTH)
    return pressure, {"gravity": light, "surcharge": CONFINEMENT}, 0.0


def _bed_of_footing(phi_deg: float, load: str) -> tuple[float, float]:
    """Width and depth of the bed over B, beyond what the exact mechanism takes in."""
    sizes = {
        "weight": ((25.0, 4.0, 1.5), (35.0, 6.0, 2.0), (40.0, 8.0, 2.6)),
        "pressure": ((25.0, 5.0, 1.75), (35.0, 8.0, 2.5), (40.0, 10.5, 3.2)),
    }["weight" if load == "weight" else "pressure"]
    return next((wide, deep) for most, wide, deep in sizes if phi_deg <= most)


def footing_scenario(
    phi_deg: float,
    base: str,
    across: int,
    *,
    load: str,
    settings: str = NODES,
    room: tuple[float, float] | None = None,
    drive: Drive | None = None,
) -> Scenario:
    """Half a strip footing that is pressed into a bed, as far as to its limit load.

    Parameters
    ----------
    phi_deg
        φ [deg].
    base
        ``smooth`` or ``rough``.
    across
        B/Δx.
    load
        ``weight`` of the soil for N_γ; for N_q its ``cohesion``, or a ``dead weight`` on it; or
        ``weight and cohesion``, for φ = 30° and a rough base alone.
    settings
        As in :func:`wall_scenario`, or :data:`RESOLVED`.
    room
        Width and depth of the bed over B; ``None``: beyond the exact mechanism.
    drive
        As in :func:`wall_scenario`.
    """
    cell = FOOTING_WIDTH / across
    wide, deep = room or _bed_of_footing(phi_deg, load)
    thick, left, bottom = 4 * cell, (4 + 1e-6) * cell, (3 + 1e-6) * cell
    height, width = round(deep * across) * cell, wide * FOOTING_WIDTH
    cells = max(
        math.ceil((left + width) / cell) + 3, math.ceil((bottom + height + thick) / cell) + 8
    )
    pressure, weights, cohesion = _loading(phi_deg, base, load)
    pace = PACE_OF_DEAD_WEIGHT if load == "dead weight" else PACE
    drive = drive or drive_at_first(pressure, FOOTING_WIDTH, pace)
    return Scenario.model_validate(
        {
            "soil": _soil(phi_deg, "associated", drive, cohesion),
            # From within the wall, the plane of symmetry, to the footing's edge: the plate's tip.
            "leg": {
                "shape": "plate",
                "chord": FOOTING_WIDTH / 2 + 3 * cell,
                "half_thickness": thick,
                "width": 1.0,
                "friction": 100.0 if base == "rough" else 0.0,
            },
            "motion": {
                "kind": "translation",
                "start": [left - 3 * cell, bottom + height + thick],
                "orientation_deg": -90.0,
                "velocity": [0.0, -drive.speed],
                "distance": drive.path,
                "bin_width": drive.path / 200,
            },
            "bed": {
                "left": left,
                "floor": bottom,
                "width": width - 2e-6 * cell,
                "height": height,
                **weights,
            },
            "numerics": _numerics(settings, cell, cells, drive),
        }
    )


_N_GAMMA = {
    "smooth": {25.0: 3.461, 30.0: 7.653, 35.0: 17.58, 40.0: 43.19, 45.0: 117.6},
    "rough": {25.0: 6.491, 30.0: 14.75, 35.0: 34.48, 40.0: 85.57, 45.0: 234.2},
}
N_GAMMA = {(phi, base): value for base, row in _N_GAMMA.items() for phi, value in row.items()}
"""Exact N_γ by the method of characteristics, by φ [deg] and base."""


def passive_pressure(phi_deg: float, friction: float) -> float:
    """Exact K_p of a wall, the horizontal part: Rankine's if it is smooth, else by slip lines."""
    if friction == 0.0:
        return math.tan(math.pi / 4 + math.radians(phi_deg) / 2) ** 2
    return rough_passive_pressure(phi_deg, friction)


def passive_source(friction: float) -> str:
    """Where the value of :func:`passive_pressure` comes from, in words."""
    if friction == 0.0:
        return "K_p = tan²(45° + φ/2) (Rankine)"
    angle = math.degrees(math.atan(friction))
    return f"slip lines, δ = {angle:.2f}° or φ if that is less, horizontal part"


def per_degree(exact: Callable[[float], float], phi_deg: float, *, apart: float = 1.0) -> float:
    """Logarithmic slope of a limit load, d ln(load)/dφ [1/deg].

    Parameters
    ----------
    exact
        From φ [deg] to the load.
    phi_deg
        φ [deg].
    apart
        Between the two angles, evenly to both sides, whose loads are compared [deg].
    """
    high, low = phi_deg + 0.5 * apart, phi_deg - 0.5 * apart
    return (math.log(exact(high)) - math.log(exact(low))) / apart


def n_gamma_per_degree(phi_deg: float, base: str) -> float:
    """The same of N_γ, from the values of the table on both sides, or at its lower end."""
    low, high = max(phi_deg - 5.0, 25.0), phi_deg + 5.0
    return math.log(N_GAMMA[high, base] / N_GAMMA[low, base]) / (high - low)


def surcharge_factor(phi_deg: float) -> float:
    """N_q = exp(π tan φ) tan²(45° + φ/2) (Prandtl, Reissner)."""
    phi = math.radians(phi_deg)
    return math.exp(math.pi * math.tan(phi)) * math.tan(math.pi / 4 + phi / 2) ** 2


def davis(phi_deg: float) -> float:
    """Reduced friction angle at ψ = 0, tan φ* = sin φ (Davis, 1968) [deg]."""
    return math.degrees(math.atan(math.sin(math.radians(phi_deg))))


def moved_pressure(phi_deg: float, moved: float) -> float:
    """K_p of a smooth wall that has moved, over the height of the first surface.

    The wedge in front of it slides on the plane that rises from the toe at 45° - φ/2. As the toe
    goes on by d, so does that plane, and takes in soil of mass ρ d h; the force is that of the
    wedge's mass, F = W tan(45° + φ/2), with W = γ h² tan(45° + φ/2) / 2 + γ d h. (The soil heaves
    as a block with an upright front. A somewhat flatter plane, which runs out of it below, would be
    still weaker, but by 0.2 % at most at 0.1 h.)

    Parameters
    ----------
    phi_deg
        φ [deg], with associated flow.
    moved
        d/h [-].

    Returns
    -------
    float
        F over γ h²/2: K_p (1 + 2 d / (h tan(45° + φ/2))).
    """
    slope = math.tan(math.pi / 4 + math.radians(phi_deg) / 2)
    return slope**2 * (1.0 + 2.0 * moved / slope)


WAY = 30.0
"""Length of the integration [-]; the last ray is approached as its negative exponential."""


@cache
def rough_passive_pressure(phi_deg: float, friction: float) -> float:
    """K_p of a rough upright wall, the horizontal part, by slip lines.

    Parameters
    ----------
    phi_deg
        φ [deg], with associated flow.
    friction
        μ of the wall. Soil slips on itself along a wall that is rougher than tan φ.

    Returns
    -------
    float
        Force normal to the wall over γ h²/2 [-].
    """
    phi = math.radians(phi_deg)
    sine = math.sin(phi)
    delta = min(math.atan(friction), phi)
    # The wall holds soil down that is heaved: the major stress dips below the horizontal by this.
    dip = 0.5 * (delta + math.asin(min(1.0, math.sin(delta) / sine)))
    at_wall, last_ray = dip - 0.5 * math.pi, 0.25 * math.pi - 0.5 * phi

    def miss(stress: float) -> float:
        """By how much the last ray lies beyond Rankine's [rad]."""
        start = [0.5 * math.pi, stress, at_wall]
        found = solve_ivp(_along_the_rays, (0.0, WAY), start, "LSODA", args=(sine,),
                          rtol=1e-10, atol=1e-12)  # fmt: skip
        return float(found.y[0, -1]) - last_ray

    # From Rankine's upwards; far above the solution the equations are stiff.
    low = high = 1.0 / (1.0 - sine)
    while miss(high) > 0.0:
        low, high = high, 1.1 * high
    stress = low if low == high else float(brentq(miss, low, high, xtol=1e-9))
    return stress * (1.0 - sine * math.cos(2.0 * at_wall))


def _along_the_rays(_: float, state: list[float], sine: float) -> list[float]:
    """Change of θ, s and ψ, all over that of a parameter in which no ray is singular.

    θ is that of the ray below the free surface and ψ that of the major stress from the ray [rad].
    Equilibrium along and across the ray, of σ (1 ± sin φ cos 2ψ) and σ sin φ sin 2ψ, is linear in
    s' and ψ'; its determinant, which falls to nothing at the last ray, is that of θ here.
    """
    angle, stress, turn = state
    cosine, other = math.cos(2.0 * turn), math.sin(2.0 * turn)
    along = math.sin(angle) - stress * (1.0 + 3.0 * sine * cosine)
    across = math.cos(angle) - 3.0 * stress * sine * other
    return [
        -2.0 * sine * (sine - cosine),
        -2.0 * sine * (other * along - cosine * across),
        -(sine * other * across - (1.0 - sine * cosine) * along) / stress,
    ]
