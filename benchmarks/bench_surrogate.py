"""The surrogate over several parameters: time and memory, against one dense covariance matrix.

Prints lines ``name value``. Times are those of the processor; the dense matrix is as large as it
may be without a wait, and its cost at full size follows from the cube and the square of that.
"""

from __future__ import annotations

import time
import tracemalloc

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.stats import qmc
from threadpoolctl import threadpool_limits

from terraphi.surrogate.design import fit
from terraphi.surrogate.process import Process

FloatArray = NDArray[np.float64]

CASES, DENSE_CASES, PARAMETERS = 1000, 64, 3
THETA_DEG = np.linspace(-85.0, 85.0, 40)


def forces(points: FloatArray) -> FloatArray:
    """Curves that change with all three parameters, shape [case, theta]."""
    first, second, third = points.T[:, :, None]
    wave = np.sin(THETA_DEG / 25.0 + first) * np.exp(0.5 * second)
    return wave + 0.3 * third * np.cos(THETA_DEG / 15.0)


def main() -> None:
    """Measure and print."""
    unit = qmc.Sobol(PARAMETERS, rng=0).random_base2(10)[:CASES]
    points = 2.0 * unit - 1.0
    rng = np.random.default_rng(0)
    values = forces(points) + 1e-3 * rng.standard_normal((CASES, THETA_DEG.size))
    with threadpool_limits(limits=1, user_api="blas"):
        began = time.process_time()
        process = fit(points, THETA_DEG, values)
        fitting = time.process_time() - began
        began = time.process_time()
        tracemalloc.start()
        Process.condition(points, THETA_DEG, values, process.kernel)
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        condition = time.process_time() - began
        began = time.process_time()
        some = points[:DENSE_CASES]
        kernel = process.kernel
        dense = kernel.signal_variance * np.kron(
            kernel.over_points(some, some), kernel.over_angles(THETA_DEG)
        ) + kernel.noise_variance * np.eye(some.shape[0] * THETA_DEG.size)
        cho_solve(cho_factor(dense), values[:DENSE_CASES].ravel())
        larger = CASES / DENSE_CASES
        dense_seconds = (time.process_time() - began) * larger**3
    print(f"surrogate_cases_times_angles {values.size}")
    print(f"surrogate_fit_seconds {fitting:.3g}")
    print(f"surrogate_condition_seconds {condition:.3g}")
    print(f"surrogate_condition_peak_megabytes {peak / 1e6:.3g}")
    print(f"dense_extrapolated_per_kronecker_seconds {dense_seconds / condition:.3g}")
    print(f"dense_matrix_per_kronecker_bytes {8.0 * values.size**2 / peak:.3g}")


if __name__ == "__main__":
    main()
