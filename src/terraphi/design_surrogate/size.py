"""How large the forces are over the parameters: what is divided out before they are modelled.

Forces on a leg grow several times over the range of a friction angle, and so do the deviations of
a curve from its neighbours. Divided by their size they are close to what a stationary process
describes. The logarithm of the size is a Gaussian process of its own: what is not known of it is an
error that multiplies both forces on the leg alike, at all leg angles.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from terraphi.design_surrogate.process import DesignGP

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Size:
    """The root mean square force on a leg over the parameters.

    Attributes
    ----------
    process
        Of the logarithm of the force in newtons; it has no leg angles, or rather one.
    """

    process: DesignGP

    @classmethod
    def fit(cls, points: FloatArray, forces: FloatArray, *, seed: int = 0) -> Self:
        """Fit it.

        Parameters
        ----------
        points
            Parameters scaled to [-1, 1], shape [case, d].
        forces
            [N], shape [case, force].
        seed
            Of the optimiser's random start.

        Raises
        ------
        ValueError
            If all cases have forces of one size.
        """
        sizes = np.log(np.sqrt(np.mean(np.square(forces), axis=1)))
        return cls(DesignGP.fit(points, [0.0], sizes[:, None], seed=seed))

    def __call__(self, points: FloatArray) -> FloatArray:
        """Size of the forces [N], shape [k, d] -> [k]."""
        size: FloatArray = np.exp(
            self.process.rotated_mean(points)[:, 0] * self.process.basis[0, 0]
        )
        return size

    def variance(self, points: FloatArray) -> FloatArray:
        """Variance of the size relative to its square [-], shape [k, d] -> [k]."""
        return self.both(points)[1]

    def both(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Size [N] and its relative variance [-] at once, shape [k, d] -> [k] each."""
        logarithm, variance = self.process.predict(points)
        return np.exp(logarithm[:, 0]), variance[:, 0]
