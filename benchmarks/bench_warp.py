"""Speed of a step in space beside the same step in NVIDIA Warp, on one core of the processor.

Warp is none of the developer's tools: ``pip install warp-lang``. Prints lines ``name value``. Both
take the bed of plan ``sand3d`` with a Drucker-Prager soil in which each particle strains by
itself. Warp's step has the velocity gradient of 27 nodes, the stress update and the forces on 27
nodes, and nothing else; ours is whole phases, with contact, walls and transfers. The forces of
Warp's step are first compared with those of the reference, so that it is the same step; both then
run in turns, so that whatever else the machine does slows both. Times are those of the processor,
and the best of several turns counts.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import time
from typing import Any

import numpy as np
import warp as wp

from terraphi.experiment.scenario import Scenario
from terraphi.forward.mpm.bed import Soil, geostatic_bed, particle_volume
from terraphi.forward.mpm.phase import Phases, precision_of
from terraphi.forward.mpm.plasticity import Material, material_of
from terraphi.library.plan import Plan

from bench_kernels import seconds_in_space  # isort: skip

wp.config.log_level = wp.LOG_WARNING
wp.set_module_options({"enable_backward": False})
SAME = 1e-4
"""Largest difference of the forces over the largest force [-]."""


@wp.struct
class Law:
    """Constants of a step, and of the grid."""

    lam: wp.float32
    shear: wp.float32
    bulk: wp.float32
    alpha: wp.float32
    beta: wp.float32
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
    """Stress on the Drucker-Prager cone."""
    mean = wp.trace(trial) / 3.0
    even = wp.identity(n=3, dtype=wp.float32)
    deviator = trial - mean * even
    radius = wp.sqrt(0.5 * wp.ddot(deviator, deviator))
    excess = radius + 3.0 * law.alpha * mean
    if mean > law.tip:
        return law.tip * even
    if excess <= 0.0:
        return trial
    multiplier = excess / (law.shear + 9.0 * law.bulk * law.alpha * law.beta)
    left = radius - law.shear * multiplier
    mean -= 3.0 * law.bulk * law.beta * multiplier
    if mean > law.tip or left < 0.0:
        return law.tip * even
    return mean * even + (left / wp.max(radius, 1.0e-12)) * deviator


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
                wp.atomic_add(force, q, law.area * (new * (4.0 * wx[a] * wy[b] * wz[c] * away)))


def main() -> None:
    """Compare, measure and print."""
    parser = argparse.ArgumentParser(description="A step in space beside that of NVIDIA Warp.")
    parser.add_argument("--turns", type=int, default=5, help="turns of each")
    turns = parser.parse_args().turns
    plan = Plan.load("sand3d").scenario
    scenario = plan.replace(
        **{
            "soil.yield_criterion": "triaxial",
            "soil.yield_surface": "mohr_coulomb",
            "soil.friction_angle_deg": 30.0,
            "numerics.dilatation": "particle",
        }
    )
    peer = Peer(scenario)
    print(f"warp_version {importlib.metadata.version('warp-lang')}")
    print(f"largest_difference_of_forces {peer.difference():.2g}")
    steps = scenario.numerics.steps_per_phase
    own_scenarios = {"same_soil": scenario, "sand3d": plan}
    ours: dict[str, list[float]] = {name: [] for name in own_scenarios}
    theirs: list[float] = []
    peer.seconds(2)
    for own in own_scenarios.values():
        seconds_in_space("packets", own, 2)
    for _ in range(turns):
        theirs.append(peer.particles * steps / peer.seconds(steps))
        for name, own in own_scenarios.items():
            particles, lasted = seconds_in_space("packets", own, steps)
            ours[name].append(particles * steps / lasted)
    print(f"warp_particle_steps_per_second {max(theirs):.4g}")
    for name, rates in ours.items():
        print(f"packets_{name}_particle_steps_per_second {max(rates):.4g}")
        print(f"packets_{name}_per_warp {max(rates) / max(theirs):.3f}")


class Peer:
    """Warp's arrays for a scenario."""

    def __init__(self, scenario: Scenario) -> None:
        self.scenario, self.phases = scenario, Phases(scenario, "scalar_nodes")
        self.soil = geostatic_bed(scenario, precision_of("scalar_nodes"))
        self.particles = self.soil.cell.size
        _stir(self.soil)
        self.law = law_of(scenario, self.phases)
        self.speed = wp.array(_triples(self.soil), dtype=wp.vec3, device="cpu")
        self.cell = wp.array(self.soil.cell, dtype=wp.int32, device="cpu")
        self.offset = wp.array(self.soil.offset.astype(np.float32), dtype=wp.vec3, device="cpu")
        full = self.soil.stress[:, [0, 3, 4, 3, 1, 5, 4, 5, 2]].reshape(-1, 3, 3)
        self.stress = wp.array(full.astype(np.float32), dtype=wp.mat33, device="cpu")

    def take(self, steps: int) -> wp.array:
        """Take steps; the forces of all [N]."""
        force = wp.zeros(self.soil.node_mass.size, dtype=wp.vec3, device="cpu")
        given = [self.cell, self.offset, self.stress, self.speed, force, self.law]
        for _ in range(steps):
            wp.launch(strain, dim=self.particles, inputs=given, device="cpu")
        return force

    def seconds(self, steps: int) -> float:
        """Processor time of some steps [s]."""
        began = time.process_time()
        self.take(steps)
        return time.process_time() - began

    def difference(self) -> float:
        """Largest difference of a step's forces from the reference's, over the largest.

        Raises
        ------
        ValueError
            If it is not the same step.
        """
        known = np.zeros((3, self.soil.node_mass.size))
        nodes = (known[0], known[1], known[2])
        time_step = self.scenario.numerics.time_step
        self.phases.strainer.strain(self.soil, nodes, time_step, 0)
        gap = float(np.abs(self.take(1).numpy().T - known).max() / np.abs(known).max())
        if not gap < SAME:
            raise ValueError(f"forces of Warp's step differ by {gap:.2g} of the largest")
        return gap


def law_of(scenario: Scenario, phases: Phases) -> Law:
    """Constants of the scenario for Warp."""
    material: Material = material_of(scenario.soil)
    law, lattice = Law(), phases.lattice
    law.lam, law.shear = material.lame_lambda, material.shear_modulus
    law.bulk = material.lame_lambda + 2.0 / 3.0 * material.shear_modulus
    law.alpha, law.beta, law.tip = material.alpha, material.beta, material.tip
    law.per_cell = scenario.numerics.time_step / lattice.cell_size
    law.area = -particle_volume(scenario) / lattice.cell_size
    law.row, law.layer = lattice.row, lattice.layer
    return law


def _stir(soil: Soil) -> None:
    """Give the nodes velocities at random, so that soil flows here and comes apart there."""
    rng = np.random.default_rng(1)
    for speed in (soil.vx, soil.vy, soil.vz):
        speed[:] = 0.05 * rng.standard_normal(speed.size)


def _triples(soil: Soil) -> Any:
    return np.stack([soil.vx, soil.vy, soil.vz], axis=1).astype(np.float32)


if __name__ == "__main__":
    main()
