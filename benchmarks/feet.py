"""Time of forces on feet, and of a step of MuJoCo: the numbers of docs/how-to/simulators.md."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path

import mujoco
import numpy as np

from terraphi.laws.foot import Foot
from terraphi.laws.wrench import Mesh, force

CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
SIDES = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6],
         [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]  # fmt: skip
BOX = Mesh.of((CORNERS - 0.5) * [0.2, 0.1, 0.04], SIDES)


def best(call: Callable[[], object], repeat: int) -> float:
    """Least time of a call [µs], which other processes do not lengthen."""
    call()
    times = []
    for _ in range(repeat):
        began = time.perf_counter()
        for _ in range(10):
            call()
        times.append(time.perf_counter() - began)
    return 1e5 * min(times)


def main() -> None:
    """Print a line for each."""
    rng = np.random.default_rng(0)
    for count, repeat in ((4, 2000), (10_000, 10)):
        pose, velocity = np.zeros((count, 7)), np.zeros((count, 6))
        pose[:, 2], pose[:, 3:] = 0.01, [1.0, 0.0, 0.0, 0.0]
        pose[:, 4:6] = rng.normal(0.0, 0.1, (count, 2))
        velocity[:, :3], velocity[:, 3:] = -0.1, rng.standard_normal((count, 3))
        for name, foot in (("balls", Foot(0.022)), ("boxes", BOX)):
            on_feet = partial(force, foot, pose, velocity, phi_deg=33.0, density=1600.0)
            print(f"{count} {name}: {best(on_feet, repeat):.1f} µs")
    sys.path.append(str(Path(__file__).parents[1] / "examples"))
    build, physics = (getattr(import_module("go2.model"), name) for name in ("build", "Physics"))
    model = build(physics(step=0.002, floor=False))
    data = mujoco.MjData(model)
    print(f"step of a Go2: {best(lambda: mujoco.mj_step(model, data), 500):.1f} µs")


if __name__ == "__main__":
    main()
