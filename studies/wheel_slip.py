"""How much of a rim's tangential velocity counts against the soil, by the material point method.

    python studies/wheel_slip.py

A wheel of 120 by 25 mm is let down 18 mm into the soil of `sand3d` while it rolls, and rolls on
level at a given slip. Means over the last 0.8 radii of way stand in
``studies/data/wheel_slip.csv``; what lacks there is simulated (two minutes a wheel). Printed are φ
by which law ``foot`` over the rim has that load, less φ of the soil, pull and torque of both, and
the means over soils and frictions of its changes with the slip. The level of these errors is that
of one grid and one surface, and is not used.
"""

from __future__ import annotations

import csv

import numpy as np

import pages
import terraphi
from terraphi.experiment.motion import Poses
from terraphi.experiment.scenario import Scenario
from terraphi.laws import wheel as laws
from terraphi.laws.wheel import Wheel, wheel_forces
from terraphi.laws.wrench import angles_deg

CASES = [
    *((phi, slip, 0.3) for phi in (28.0, 36.0) for slip in (0.0, 0.2, 0.5)),
    *((32.0, slip, 0.3) for slip in (-0.3, 0.0, 0.2, 0.5)),
    *((32.0, slip, 0.55) for slip in (0.0, 0.2, 0.5)),
]
"""φ [deg], slip and friction of the rim."""
ROWS = pages.ROOT / "data" / "wheel_slip.csv"
RADIUS, WIDTH, DEPTH, CELL = 0.06, 0.025, 0.018, 0.005
"""Of the wheel, its sinkage, and the cells of its soil [m]."""
DOWN, LEVEL, KEPT = 0.8, 1.5, 0.8
"""Ways over which the wheel is let down, rolls level, and forces are averaged at its end; over the
radius."""
SPEED, CLEAR, SOIL = 0.02, 0.002, 0.075
"""Of the axle [m/s], sped up tenfold; height of the rim above the soil at first, and thickness of
the soil [m]."""
BEHIND, BEFORE = 1.5, 1.6
"""Soil behind the first and before the last place of the axle, over the radius."""
SETTLED = 0.003
"""By which the surface of a bed of particles at random places falls [m]: half a cell and more;
chosen, for it moves all errors alike."""
DENSITY = 1650.0


class Rolling(terraphi.Translation):
    """A level motion of the axle that first goes down, of a wheel that turns."""

    rate: float
    """Of the wheel [rad/s], positive where it rolls toward +x."""

    def poses(self, time: np.ndarray) -> Poses:
        """Poses at given times [s], shape [time]."""
        way, end = self.velocity[0] * time, DOWN * RADIUS
        fall = (DEPTH + CLEAR) / end
        hip = np.stack([way, -fall * np.minimum(way, end)], axis=-1) + np.array(self.start)
        down = np.where(way < end, -fall * self.velocity[0], 0.0)
        velocity = np.stack([np.full(len(time), self.velocity[0]), down], axis=-1)
        return Poses(hip, self.rate * time, velocity, np.full(len(time), self.rate))

    def top_speed(self, reach: float) -> float:
        """Largest speed of any point [m/s]."""
        return 2.0 * self.velocity[0] + self.rate * reach


def scenario(phi_deg: float, slip: float, friction: float) -> Scenario:
    """The wheel in its soil."""
    usual = Scenario.load("sand3d")
    way = (DOWN + LEVEL) * RADIUS
    length = (BEHIND + BEFORE) * RADIUS + way
    room = max(length + 5.0 * CELL, SOIL + 2.0 * CELL + 2.0 * RADIUS + 0.02)
    cells = int(np.ceil(room / CELL))
    start = (2.0 * CELL + BEHIND * RADIUS, 2.0 * CELL + SOIL + CLEAR + RADIUS)
    ratio = 1.0 / (1.0 - slip) if slip >= 0.0 else 1.0 + slip
    values = usual.model_dump(exclude={"rft"})
    values["soil"]["friction_angle_deg"] = phi_deg
    values["leg"] |= {"chord": 0.01, "half_thickness": 0.002, "width": WIDTH, "friction": friction}
    values["bed"] |= {"left": 2.0 * CELL, "floor": 2.0 * CELL, "width": length, "height": SOIL,
                      "breadth": WIDTH + 1.2 * RADIUS}  # fmt: skip
    values["numerics"] |= {"domain": cells * CELL, "cells": cells, "tip_inset_cells": 0.0,
                           "time_step": 7.2e-5, "remap_interval": 4.5e-3, "seed": 1}  # fmt: skip
    values["motion"] = Rolling(start=start, velocity=(SPEED, 0.0), distance=way, bin_width=1e-3,
                               rate=ratio * SPEED / RADIUS)  # fmt: skip
    # A straight leg with round ends and hardly any length is a wheel.
    rim = usual.leg.model_copy(
        update={"chord": 1e-5, "half_thickness": RADIUS, "width": WIDTH, "friction": friction}
    )
    return Scenario(**values).model_copy(update={"leg": rim})


def simulated(case: tuple[float, float, float]) -> list[float]:
    """Pull and load [N], and torque [N m]."""
    history = terraphi.simulate(scenario(*case))
    last = history.position > (DOWN + LEVEL - KEPT) * RADIUS
    return [float(row[last].mean()) for row in (history.Fx, history.Fz, -history.moment)]


def rows() -> list[list[float]]:
    """φ, slip, friction, pull, load and torque of each case; simulated where the file lacks it."""
    header = ["phi_deg", "slip", "friction", "pull_N", "load_N", "torque_Nm"]
    kept = {}
    if ROWS.exists():
        with ROWS.open(encoding="utf-8", newline="") as file:
            kept = {
                row[:3]: row[3:] for row in (tuple(map(float, r)) for r in [*csv.reader(file)][1:])
            }
    for case in CASES:
        if case not in kept:
            kept[case] = tuple(round(value, 4) for value in simulated(case))
            with ROWS.open("w", encoding="utf-8", newline="") as file:
                csv.writer(file, lineterminator="\n").writerows(
                    [header, *([*case, *forces] for case, forces in kept.items())]
                )
    return [[*case, *kept[case]] for case in CASES]


def angle(row: list[float], part: float) -> float:
    """φ by which the law with a part has the load of a wheel, less φ of the soil [deg]."""
    laws.TANGENTIAL = part
    phi, slip, friction, _, load, _ = row
    angles = np.linspace(*angles_deg(0.35), 80)
    borne = law_at(slip, friction, angles).load
    return float(np.interp(load, np.maximum.accumulate(borne), angles)) - phi


def law_at(slip: float, friction: float, phi_deg: float | np.ndarray) -> laws.WheelForces:
    """Forces by the law on the wheel at its sinkage."""
    return wheel_forces(Wheel(RADIUS, WIDTH), DEPTH - SETTLED, slip, phi_deg=phi_deg,
                        density=DENSITY, surface_friction=friction)  # fmt: skip


def main() -> None:
    """Print each wheel at parts of 0, as shipped and all; and the changes with the slip by part."""
    simulated_rows, shipped = rows(), laws.TANGENTIAL
    print("  phi  slip friction  error: none  shipped  all   T/(W R), law   P/W, law")
    for row in simulated_rows:
        phi, slip, friction, pull, load, torque = row
        errors = [angle(row, part) for part in (0.0, 100.0, shipped)]
        law = law_at(slip, friction, phi + errors[2])
        print(f"{phi:5g} {slip:5g} {friction:6g}   "
              + " ".join(f"{error:+7.1f}" for error in (errors[0], errors[2], errors[1]))
              + f" {torque / load / RADIUS:7.2f} {law.torque / law.load / RADIUS:5.2f}"
              + f" {pull / load:8.2f} {law.pull / law.load:5.2f}")  # fmt: skip
    for part in (0.8, 0.9, 1.0, 1.1, 1.2, 100.0):
        error = {tuple(row[:3]): angle(row, part) for row in simulated_rows}
        groups = sorted({(row[0], row[2]) for row in simulated_rows})
        driven, free = (
            np.array([error[phi, high, mu] - error[phi, low, mu] for phi, mu in groups])
            for low, high in ((0.2, 0.5), (0.2, 0.0))
        )
        print(f"part {part:5g}: 0.2 to 0.5 {driven.mean():+.2f} ({driven.min():+.1f} to "
              f"{driven.max():+.1f}), without slip {free.mean():+.2f}")  # fmt: skip
    laws.TANGENTIAL = shipped


if __name__ == "__main__":
    main()
