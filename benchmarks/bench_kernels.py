"""Speed of the kernels of the material point method, side by side on one core.

Prints lines ``name value``. The bed is the paper's, at full resolution and jittered, with a leg in
it. Both kernels run in turns, so that whatever else the machine does slows both; times are those
of the processor, and the best of several turns counts.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np

from terraphi.experiment.scenario import Scenario
from terraphi.forward.compiled import register_use
from terraphi.forward.driver import path_of_steps
from terraphi.forward.mpm import bed as space
from terraphi.forward.mpm.phase import Kernel, Phases, precision_of
from terraphi.forward.plane import lanes, packets, scalar
from terraphi.forward.plane.bed import Particles, empty_grid, geostatic_bed
from terraphi.forward.plane.model import model_of
from terraphi.forward.plane.packing import LANES, aligned_zeros, pack
from terraphi.forward.plane.scalar import empty_audit, empty_reaction
from terraphi.library.plan import Plan


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="Speed of the kernels, side by side.")
    parser.add_argument("--turns", type=int, default=7, help="turns of each kernel")
    parser.add_argument("--steps", type=int, default=300, help="steps in a turn of the fast kernel")
    arguments = parser.parse_args()
    scenario = Scenario().replace(**{"motion.start_deg": -30.0, "motion.stop_deg": 60.0})
    # What packing costs at the ends of a block of thousands of steps is no part of the measure.
    kernels = {
        "packets": (packets.advance, arguments.steps),
        "scalar": (scalar.advance, max(arguments.steps // 3, 2)),
    }
    for advance, _ in kernels.values():
        seconds(advance, scenario, 2)
    rates: dict[str, list[float]] = {name: [] for name in kernels}
    for _ in range(arguments.turns):
        for name, (advance, steps) in kernels.items():
            rates[name].append(particle_steps_per_second(advance, scenario, steps))
    best = {name: max(values) for name, values in rates.items()}
    ratios = np.array(rates["packets"]) / np.array(rates["scalar"])
    print(f"packets_per_scalar_f64 {best['packets'] / best['scalar']:.3f}")
    print(f"packets_per_scalar_f64_median_of_turns {np.median(ratios):.3f}")
    for name, rate in best.items():
        print(f"{name}_particle_steps_per_second {rate:.4g}")
    print(f"lanes {int(LANES)}")
    for line in in_space(arguments.turns):
        print(line)
    print(f"vector_width_ok {int(vector_width_ok(scenario))}")


def particle_steps_per_second(advance: Callable[..., int], scenario: Scenario, steps: int) -> float:
    """Rate [1/s] of all but the first two steps, which carry the cost of packing."""
    particles, short = seconds(advance, scenario, 2)
    _, long = seconds(advance, scenario, steps)
    return particles * (steps - 2) / (long - short)


def seconds(advance: Callable[..., int], scenario: Scenario, steps: int) -> tuple[int, float]:
    """Number of particles, and processor time of some steps [s]."""
    soil: Particles = geostatic_bed(scenario)
    poses, turned, bins = path_of_steps(scenario, np.arange(steps), 1)
    grid, impulse, audit = empty_grid(scenario), empty_reaction(1), empty_audit()
    model = model_of(scenario)
    began = time.process_time()
    advance(soil, grid, model, poses, turned, bins, impulse, audit)
    return len(soil.mass), time.process_time() - began


def in_space(turns: int) -> list[str]:
    """Rates in three dimensions, whole phases with all that they take; and their ratio."""
    scenario = Plan.load("sand3d").scenario
    steps: dict[Kernel, int] = {"packets": scenario.numerics.steps_per_phase, "scalar": 4}
    for kernel in steps:
        seconds_in_space(kernel, scenario, 2)
    rates: dict[Kernel, list[float]] = {kernel: [] for kernel in steps}
    for _ in range(max(turns // 2, 1)):
        for kernel, count in steps.items():
            particles, lasted = seconds_in_space(kernel, scenario, count)
            rates[kernel].append(particles * count / lasted)
    best = {kernel: max(values) for kernel, values in rates.items()}
    return [
        f"space_packets_per_scalar {best['packets'] / best['scalar']:.3f}",
        *(f"space_{name}_particle_steps_per_second {rate:.4g}" for name, rate in best.items()),
    ]


def seconds_in_space(kernel: Kernel, scenario: Scenario, steps: int) -> tuple[int, float]:
    """Number of particles, and processor time of some steps [s]."""
    phases, soil = Phases(scenario, kernel), space.geostatic_bed(scenario, precision_of(kernel))
    phases.weigh_first(soil)
    poses, _, bins = path_of_steps(scenario, np.arange(steps), 1)
    impulse, audit = empty_reaction(1), empty_audit()
    began = time.process_time()
    phases.take(soil, poses, bins, impulse, audit)
    return len(soil.mass), time.process_time() - began


def vector_width_ok(scenario: Scenario) -> bool:
    """Whether the two heavy loops use the machine's widest registers."""
    soil, rows = geostatic_bed(scenario), scenario.numerics.cells + 2
    state = pack(soil, rows, scenario.numerics.cell_size).state
    motion, work = aligned_zeros(int(lanes.MOTION)), aligned_zeros(int(lanes.WORK))
    model = model_of(scenario)
    widest = "zmm" if LANES == 8 else "ymm"
    for loop in (lanes.follow_grid, lanes.scatter):
        used = register_use(loop, state, motion, work, np.uint64(0), np.uint64(1), LANES, model)
        if used[widest] < 0.5 * used["single"]:
            return False
    return True


if __name__ == "__main__":
    main()
