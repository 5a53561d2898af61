"""How large the forces are over the parameters: what is divided out before they are modelled.

Forces on a leg grow several times over the range of a friction angle, and so do the deviations of
a curve from its neighbours. Divided by their size, they are close to what a stationary process
describes. The logarithm of the size is a polynomial of the parameters, by least squares, of the
degree that foretells left-out cases best (PRESS; Allen, *Technometrics* 16:125, 1974).
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

DEGREES = (0, 1, 2)
CASES_PER_COEFFICIENT = 1.25
"""Cases that there must be for each coefficient."""


@dataclass(frozen=True, eq=False)
class Size:
    """A polynomial for the logarithm of the root mean square force.

    Attributes
    ----------
    degree
        Of the polynomial.
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
        best = (np.inf, 0, np.zeros(1))
        for degree in DEGREES:
            terms = _terms(points, degree)
            if degree and CASES_PER_COEFFICIENT * terms.shape[1] > len(points):
                break
            inverse = np.linalg.pinv(terms)
            coefficients = inverse @ sizes
            # What a case adds to its own prediction tells what would be foretold without it.
            own = np.einsum("ij,ji->i", terms, inverse)
            left_out = (sizes - terms @ coefficients) / np.maximum(1.0 - own, 1e-9)
            press = float(np.square(left_out).sum())
            if press < best[0]:
                best = (press, degree, coefficients)
        return cls(*best[1:])

    def __call__(self, points: FloatArray) -> FloatArray:
        """Size of the forces [N], shape [k, d] -> [k]."""
        size: FloatArray = np.exp(_terms(points, self.degree) @ self.coefficients)
        return size


def _terms(points: FloatArray, degree: int) -> FloatArray:
    """All products of up to so many parameters, the empty one included; shape [k, term]."""
    return np.column_stack(
        [
            points[:, list(chosen)].prod(axis=1)
            for k in range(degree + 1)
            for chosen in itertools.combinations_with_replacement(range(points.shape[1]), k)
        ]
    )
