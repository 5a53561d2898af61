"""Speed of a step in three dimensions: fast kernel, plain kernel and NVIDIA Warp on one core.

Warp is none of the developer's tools: ``pip install warp-lang``; without it that line is left out.
Prints lines ``name value``. All take the bed of library ``sand3d``. Warp's step has the velocity
gradient of 27 nodes, the stress update and the forces on 27 nodes, and nothing else; ours is whole
phases, with contact, walls, transfers and means over cells. Warp's stress is first compared with
that of the plain kernel, for velocities that are linear in place, of which all means are the same,
so that it is the same stress update. All run in turns, so that whatever else the machine does slows
all; times are those of the processor, and the best of several turns counts.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from terraphi.experiment.scenario import Scenario
from terraphi.forward.bed import sub_cells
from terraphi.forward.driver import path_of_steps
from terraphi.forward.ledger import empty_audit, empty_reaction
from terraphi.forward.mpm.lanes import FastStrain
from terraphi.forward.mpm.lattice import lattice_of
from terraphi.forward.mpm.plasticity import material_of
from terraphi.forward.mpm.solver import MpmSolver

sys.path.append(str(Path(__file__).parents[1] / "verification"))
from plain import PlainStrain

try:
    import warp as wp
except ImportError:
    wp = None

SAME = 1e-4
"""Largest difference of Warp's stresses from ours over the largest stress [-]."""


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="A step in three dimensions, side by side.")
    parser.add_argument("--turns", type=int, default=3, help="turns of each")
    turns = parser.parse_args().turns
    scenario = Scenario.load("sand3d")
    steps = scenario.numerics.steps_per_phase
    rates: dict[str, list[float]] = {}
    runs: dict[str, Any] = {
        "packets": (lambda n: seconds(scenario, FastStrain, n)[1], steps),
        "plain": (lambda n: seconds(scenario, PlainStrain, n)[1], 4),
    }
    if wp is not None:
        peer = Peer(scenario)
        print(f"largest_difference_of_stresses {peer.difference():.2g}")
        runs["warp"] = (peer.seconds, steps)
    for take, _ in runs.values():
        take(2)
    for _ in range(turns):
        for name, (take, count) in runs.items():
            rates.setdefault(name, []).append(count / take(count))
    best = {name: max(values) for name, values in rates.items()}
    particles, _ = seconds(scenario, FastStrain, 1)
    print(f"packets_particle_steps_per_second {particles * best['packets']:.4g}")
    print(f"packets_per_plain {best['packets'] / best['plain']:.3f}")
    if wp is not None:
        print(f"packets_per_warp {best['packets'] / best['warp']:.3f}")


def seconds(scenario: Scenario, strainer: type[Any], steps: int) -> tuple[int, float]:
    """Number of particles, and processor time of some steps from the first on [s]."""
    solver = MpmSolver(scenario, strainer)
    soil, path = solver.bed(), path_of_steps(scenario, np.arange(steps), 1)
    impulse, audit = empty_reaction(1), empty_audit()
    began = time.process_time()
    solver.advance(soil, path, impulse, audit)
    return len(soil.mass), time.process_time() - began


class Peer:
    """Warp's arrays for a scenario, with velocities that are linear in place."""

    def __init__(self, scenario: Scenario) -> None:
        self.scenario, self.plain = scenario, MpmSolver(scenario, PlainStrain)
        self.soil = soil = self.plain.bed()
        material, lattice, self.law = material_of(scenario.soil), lattice_of(scenario), Law()
        node = np.arange(lattice.nodes)
        place = np.stack([node % lattice.row, node % lattice.layer // lattice.row - 0.5,
                          node // lattice.layer])  # fmt: skip
        slope = np.random.default_rng(1).standard_normal((3, 3))
        soil.velocity[:] = slope @ (lattice.cell_size * place)
        self.law.lam, self.law.shear = material.lame_lambda, material.shear_modulus
        self.law.sine, self.law.tip = material.sin_friction, material.tip
        self.law.per_cell = scenario.numerics.time_step / lattice.cell_size
        self.law.area = -float(np.prod(sub_cells(scenario)[1])) / lattice.cell_size
        self.law.row, self.law.layer = lattice.row, lattice.layer
        speeds = np.ascontiguousarray(soil.velocity.T.astype(np.float32))
        full = soil.stress[:, [0, 3, 4, 3, 1, 5, 4, 5, 2]].reshape(-1, 3, 3).astype(np.float32)
        self.speed = wp.array(speeds, dtype=wp.vec3, device="cpu")
        self.cell = wp.array(soil.cell, dtype=wp.int32, device="cpu")
        self.offset = wp.array(soil.offset.astype(np.float32), dtype=wp.vec3, device="cpu")
        self.stress = wp.array(full, dtype=wp.mat33, device="cpu")

    def take(self, steps: int) -> None:
        """Take steps."""
        force = wp.zeros(self.soil.node_mass.size, dtype=wp.vec3, device="cpu")
        given = [self.cell, self.offset, self.stress, self.speed, force, self.law]
        for _ in range(steps):
            wp.launch(strain, dim=self.soil.cell.size, inputs=given, device="cpu")

    def seconds(self, steps: int) -> float:
        """Processor time of some steps [s]."""
        began = time.process_time()
        self.take(steps)
        return time.process_time() - began

    def difference(self) -> float:
        """Largest difference of a step's stresses from the plain kernel's, over the largest."""
        force, time_step = np.zeros_like(self.soil.velocity), self.scenario.numerics.time_step
        self.plain.strainer.strain(self.soil, force, time_step, 0)
        self.take(1)
        known = self.soil.stress[:, [0, 3, 4, 3, 1, 5, 4, 5, 2]].reshape(-1, 3, 3)
        gap = float(np.abs(self.stress.numpy() - known).max() / np.abs(known).max())
        if not gap < SAME:
            raise ValueError(f"stresses of Warp's step differ by {gap:.2g} of the largest")
        return gap


if wp is not None:
    wp.config.log_level = wp.LOG_WARNING
    wp.set_module_options({"enable_backward": False})

    @wp.struct
    class Law:
        """Constants of a step, and of the grid."""

        lam: wp.float32
        shear: wp.float32
        sine: wp.float32
        tip: wp.float32
        per_cell: wp.float32
        area: wp.float32
        row: wp.int32
        layer: wp.int32

    @wp.func
    def weights(x: wp.float32) -> wp.vec3:
        """Quadratic splines of the three nearest nodes."""
        return wp.vec3(0.5 * (0.5 - x) * (0.5 - x), 0.75 - x * x, 0.5 * (0.5 + x) * (0.5 + x))

    @wp.func
    def returned(trial: wp.mat33, law: Law) -> wp.mat33:
        """Stress on the surface of Matsuoka and Nakai, by a radial return without dilation.

        √J₂ = x (t - m) with x² + q x³ = sin² φ, q = (3 - sin² φ) cos 3θ / √27.
        """
        mean = wp.trace(trial) / 3.0
        even = wp.identity(n=3, dtype=wp.float32)
        if mean >= law.tip:
            return law.tip * even
        deviator = trial - mean * even
        j2 = 0.5 * wp.ddot(deviator, deviator)
        radius = wp.sqrt(wp.max(j2, 1.0e-12))
        lode = 1.5 * wp.sqrt(3.0) * wp.determinant(deviator) / (radius * radius * radius)
        square = law.sine * law.sine
        q = (3.0 - square) * lode / wp.sqrt(27.0)
        x = law.sine
        for _ in range(4):
            x -= (x * x * (1.0 + q * x) - square) / (x * (2.0 + 3.0 * q * x))
        most = x * (law.tip - mean)
        if radius <= most:
            return trial
        return mean * even + (most / radius) * deviator

    @wp.kernel
    def strain(
        cell: wp.array(dtype=wp.int32),
        offset: wp.array(dtype=wp.vec3),
        stress: wp.array(dtype=wp.mat33),
        speed: wp.array(dtype=wp.vec3),
        force: wp.array(dtype=wp.vec3),
        law: Law,
    ):
        """Strain the particles and add the forces of their new stress to the nodes."""
        p = wp.tid()
        base, at = cell[p], offset[p]
        wx, wy, wz = weights(at[0]), weights(at[1]), weights(at[2])
        slope = wp.mat33(0.0)
        for c in range(3):
            for b in range(3):
                for a in range(3):
                    away = wp.vec3(float(a) - 1.0, float(b) - 1.0, float(c) - 1.0) - at
                    q = base + (c - 1) * law.layer + (b - 1) * law.row + a - 1
                    slope += wp.outer(speed[q], 4.0 * wx[a] * wy[b] * wz[c] * away)
        slope *= law.per_cell
        rate, spin = 0.5 * (slope + wp.transpose(slope)), 0.5 * (slope - wp.transpose(slope))
        old = stress[p]
        trial = old + spin * old - old * spin + 2.0 * law.shear * rate
        trial += law.lam * wp.trace(rate) * wp.identity(n=3, dtype=wp.float32)
        new = returned(trial, law)
        stress[p] = new
        for c in range(3):
            for b in range(3):
                for a in range(3):
                    away = wp.vec3(float(a) - 1.0, float(b) - 1.0, float(c) - 1.0) - at
                    q = base + (c - 1) * law.layer + (b - 1) * law.row + a - 1
                    push = new * (4.0 * wx[a] * wy[b] * wz[c] * away)
                    wp.atomic_add(force, q, law.area * push)


if __name__ == "__main__":
    main()
