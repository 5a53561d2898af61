"""Speed of the kernels of the material point method, plain and fast, on one core.

Prints lines ``name value``. In two dimensions the bed is the paper's, at full resolution and
jittered, with a leg in it; in three it is that of the library ``sand3d``. The kernels run in turns,
so that whatever else the machine does slows both; times are those of the processor, and the best of
several turns counts. That the fast loops use the machine's vectors is tested in
``tests/forward/plane/test_packets.py``.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from terraphi.experiment.scenario import Scenario
from terraphi.forward.driver import Kernel, path_of_steps
from terraphi.forward.ledger import empty_audit, empty_reaction
from terraphi.forward.mpm.solver import MpmSolver
from terraphi.forward.plane.bed import LANES
from terraphi.forward.plane.solver import PlaneSolver

PLANE = Scenario().replace(**{"motion.start_deg": -30.0, "motion.stop_deg": 60.0})


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="Speed of the kernels.")
    parser.add_argument("--turns", type=int, default=7, help="turns of each kernel")
    parser.add_argument("--steps", type=int, default=300, help="steps in a turn of the fast kernel")
    arguments = parser.parse_args()
    steps: dict[Kernel, int] = {
        "packets": arguments.steps,
        "scalar": max(arguments.steps // 3, 4),
    }
    compare("", PLANE, steps, arguments.turns)
    sand = Scenario.load("sand3d")
    phase = sand.numerics.steps_per_phase
    compare("space_", sand, {"packets": 2 * phase, "scalar": phase}, max(arguments.turns // 2, 1))
    print(f"lanes {int(LANES)}")


def compare(prefix: str, scenario: Scenario, steps: dict[Kernel, int], turns: int) -> None:
    """Print the best rate of each kernel, and the ratio of the fast to the plain one."""
    for kernel in steps:
        seconds(scenario, kernel, 2)  # compiles
    rates: dict[Kernel, list[float]] = {kernel: [] for kernel in steps}
    for _ in range(turns):
        for kernel, count in steps.items():
            rates[kernel].append(particle_steps_per_second(scenario, kernel, count))
    ratios = np.array(rates["packets"]) / np.array(rates["scalar"])
    print(f"{prefix}packets_per_scalar {max(rates['packets']) / max(rates['scalar']):.3f}")
    print(f"{prefix}packets_per_scalar_median_of_turns {np.median(ratios):.3f}")
    for kernel, values in rates.items():
        print(f"{prefix}{kernel}_particle_steps_per_second {max(values):.4g}")


def particle_steps_per_second(scenario: Scenario, kernel: Kernel, steps: int) -> float:
    """Rate [1/s] without what a block of steps costs at its ends, such as packing."""
    particles, short = seconds(scenario, kernel, 2)
    _, long = seconds(scenario, kernel, steps)
    return particles * (steps - 2) / (long - short)


def seconds(scenario: Scenario, kernel: Kernel, steps: int) -> tuple[int, float]:
    """Number of particles, and processor time of some steps from the first on [s]."""
    solver = (PlaneSolver if scenario.dimensions == 2 else MpmSolver)(scenario, kernel)
    soil, path = solver.bed(), path_of_steps(scenario, np.arange(steps), 1)
    impulse, audit = empty_reaction(1), empty_audit()
    began = time.process_time()
    solver.advance(soil, path, impulse, audit)
    return len(soil.mass), time.process_time() - began


if __name__ == "__main__":
    main()
