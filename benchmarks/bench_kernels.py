"""Speed of the plane kernels, plain and fast, on one core.

Prints lines ``name value``. The bed is the paper's, at full resolution and jittered, with a leg in
it. The kernels run in turns, so that whatever else the machine does slows both; times are those of
the processor, and the best of several turns counts. That the fast loops use the machine's vectors
is tested in ``tests/forward/plane/test_packets.py``.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from terraphi.experiment.scenario import Scenario
from terraphi.forward.driver import Kernel, path_of_steps
from terraphi.forward.ledger import empty_audit, empty_reaction
from terraphi.forward.mpm.solver import MpmSolver
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
    for kernel in steps:
        seconds(PLANE, kernel, 2)  # compiles
    rates: dict[Kernel, list[float]] = {kernel: [] for kernel in steps}
    for _ in range(arguments.turns):
        for kernel, count in steps.items():
            rates[kernel].append(particle_steps_per_second(PLANE, kernel, count))
    ratios = np.array(rates["packets"]) / np.array(rates["scalar"])
    print(f"packets_per_scalar {max(rates['packets']) / max(rates['scalar']):.3f}")
    print(f"packets_per_scalar_median_of_turns {np.median(ratios):.3f}")
    for kernel, values in rates.items():
        print(f"{kernel}_particle_steps_per_second {max(values):.4g}")


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
