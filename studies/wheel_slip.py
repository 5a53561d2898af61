"""How much of a rim's motion along itself the soil feels: wheels by the material point method.

    python studies/wheel_slip.py

A wheel of 120 by 25 mm is let down 18 mm into the soil of `sand3d` while it rolls, and rolls on
level at a given slip. Means over its last half radius of way stand in
``studies/data/wheel_slip.csv``; what lacks there is simulated (two minutes a wheel). Printed are φ
by which law ``foot`` over the rim has that load, less φ of the soil, and pull and torque of both.
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
"""Ways over which the wheel is let down, and rolls level; the first part of that is left out; over
the radius."""
SPEED, CLEAR, SOIL = 0.02, 0.002, 0.075
"""Of the axle [m/s], sped up tenfold; height of the rim above the soil at first, and thickness of
the soil [m]."""
BEHIND, BEFORE = 1.5, 1.6
"""Soil behind the first and before the last place of the axle, over the radius."""
SETTLED = 0.003
"""By which the surface of a bed of particles at random places falls [m]."""
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


def main() -> None:
    """Print each wheel with the law's part, with none and with all of the rim's motion."""
    wheel, angles = Wheel(RADIUS, WIDTH), np.linspace(*angles_deg(0.35), 80)
    shipped = laws.TAKEN_UP
    print("  phi  slip  friction  φ by the law less φ of the soil at a part taken up, over μ, of")
    print(" " * 22 + f"0      {shipped:g}    all   T/(W R), law  P/W, law")
    for phi, slip, friction, pull, load, torque in rows():
        options = {
            "density": DENSITY,
            "surface_friction": friction,
            "mobilization": laws.MOBILIZATION,
        }
        errors, ratios = [], ""
        for laws.TAKEN_UP in (0.0, shipped, 100.0):
            curve = wheel_forces(wheel, DEPTH - SETTLED, slip, phi_deg=angles, **options).load
            read = float(np.interp(load, np.maximum.accumulate(curve), angles))
            errors.append(read - phi)
            if shipped == laws.TAKEN_UP:
                law = wheel_forces(wheel, DEPTH - SETTLED, slip, phi_deg=read, **options)
                ratios = (f"{torque / load / RADIUS:6.2f} {law.torque / law.load / RADIUS:6.2f}"
                          f" {pull / load:6.2f} {law.pull / law.load:6.2f}")  # fmt: skip
        laws.TAKEN_UP = shipped
        print(
            f"{phi:5g} {slip:5g} {friction:6g}  " + "".join(f"{e:+6.1f} " for e in errors) + ratios
        )


if __name__ == "__main__":
    main()
