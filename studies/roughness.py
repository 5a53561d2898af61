"""Exponents of the correlation of a residual over θ, by the residuals of the shipped records.

Printed is the log density of each record's residual under the predictive covariance with each
exponent, less that of the best, and the sum over records; `inference.likelihood.ROUGHNESS` is one
of the two with the largest sums. At 2 the correlation is not defined by differences of neighbors.
"""

from __future__ import annotations

import numpy as np

from terraphi.experiment.measurements import names
from terraphi.inference import likelihood
from terraphi.inference.records import open_record
from terraphi.laws.legs import shipped_legs

EXPONENTS = (1.0, 1.25, 1.5, 1.75)


def log_densities(name: str) -> np.ndarray:
    """Of the residual of a record, for each exponent."""
    fitted = likelihood.Likelihood([open_record(name)], shipped_legs())
    residual = fitted.data - fitted.curves(fitted.least_squares)[0]
    found = []
    for exponent in EXPONENTS:
        likelihood.ROUGHNESS = exponent
        covariance = fitted.predictive_covariance()
        found.append(
            -0.5 * residual @ np.linalg.solve(covariance, residual)
            - 0.5 * np.linalg.slogdet(covariance)[1]
        )
    return np.array(found)


def main() -> None:
    """Print the table."""
    rows = {name: log_densities(name) for name in names()}
    rows["all"] = np.sum([*rows.values()], axis=0)
    print(f"{'exponent':30}" + "".join(f"{exponent:8g}" for exponent in EXPONENTS))
    for name, row in rows.items():
        print(f"{name:30}" + "".join(f"{value:8.1f}" for value in row - row.max()))


if __name__ == "__main__":
    main()
