"""How large the forces are over the parameters: what is divided out before they are modelled.

Forces on a leg grow several times over the range of a friction angle, and so do the deviations of
a curve from its neighbours. Divided by their size, they are close to what a stationary process
describes. The logarithm of the size is a polynomial of the parameters, by least squares.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

DEGREES = (2, 1, 0)
CASES_PER_COEFFICIENT = 1.25


@dataclass(frozen=True, eq=False)
class Size:
    """A polynomial for the logarithm of the root mean square force.

    Attributes
    ----------
    degree
        2, or less where there are too few cases.
    coefficients
        Of the terms, logarithms of a force in newtons.
    """

    degree: int
    coefficients: FloatArray

    @classmethod
    def fit(cls, points: FloatArray, forces: FloatArray) -> Self:
        """Fit it.

        Parameters
        ----------
        points
            Parameters scaled to [-1, 1], shape [case, d].
        forces
            [N], shape [case, force].
        """
        sizes = np.log(np.sqrt(np.mean(np.square(forces), axis=1)))
        degree = next(
            k for k in DEGREES
            if k == 0 or CASES_PER_COEFFICIENT * _terms(points, k).shape[1] <= len(points)
        )  # fmt: skip
        coefficients, *_ = np.linalg.lstsq(_terms(points, degree), sizes, rcond=None)
        return cls(degree, np.asarray(coefficients, dtype=np.float64))

    def __call__(self, points: FloatArray) -> FloatArray:
        """Size of the forces [N], shape [k, d] -> [k]."""
        size: FloatArray = np.exp(_terms(points, self.degree) @ self.coefficients)
        return size


def _terms(points: FloatArray, degree: int) -> FloatArray:
    """One, the parameters, and their products, as far as the degree goes; shape [k, term]."""
    columns = [np.ones(len(points))]
    if degree > 0:
        columns += list(points.T)
    if degree > 1:
        one, other = np.triu_indices(points.shape[1])
        columns += list((points[:, one] * points[:, other]).T)
    return np.column_stack(columns)
