"""The forces on a leg between the friction angles of a library: two Gaussian processes.

Which wiggle of a force history belongs to the surrogate and which to the residual is a choice, and
it must be made once. The paper's residual covariance (Xu & Wang) has a correlation length of about
6°, that of the particles' scatter. A surrogate free to follow such short structure learns scatter
as if it were physics: its derivative with respect to phi grows rough, a residual covariance
without white noise weighs just that roughness most, and inversions of fresh simulations land
degrees away from the truth with intervals that exclude it. So the surrogate may not vary over the
leg angle faster than twice the residual's length; results are the same from 10° to 15°.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from terraphi.surrogate.gaussian_process import KroneckerGP

FloatArray = NDArray[np.float64]

SHORTEST_THETA_LENGTH_DEG = 12.0
"""Lower bound of the correlation length over the leg angle [deg], twice the residual's 6°."""


@dataclass(frozen=True, eq=False)
class LegSurrogate:
    """The forces on one leg as a function of the friction angle, a process for each component.

    Its observation vectors are d = [Fx(theta_1..m), Fz(theta_1..m)], the order of the paper.
    """

    Fx: KroneckerGP
    Fz: KroneckerGP

    @classmethod
    def fit(
        cls,
        phi_deg: ArrayLike,
        theta_deg: ArrayLike,
        Fx: ArrayLike,
        Fz: ArrayLike,
        *,
        shortest_theta_length_deg: float = SHORTEST_THETA_LENGTH_DEG,
        restarts: int = 3,
        seed: int = 0,
    ) -> Self:
        """Fit a process to each component.

        Parameters
        ----------
        phi_deg, theta_deg
            Friction and leg angles [deg], shapes [phi] and [theta].
        Fx, Fz
            Forward and upward force of the soil on the leg [N], shape [phi, theta].
        shortest_theta_length_deg, restarts, seed
            As in `KroneckerGP.fit`.

        Raises
        ------
        ValueError
            As in `KroneckerGP.fit`.
        """
        fx, fz = (
            KroneckerGP.fit(
                phi_deg,
                theta_deg,
                force,
                shortest_theta_length_deg=shortest_theta_length_deg,
                restarts=restarts,
                seed=seed,
            )
            for force in (Fx, Fz)
        )
        return cls(Fx=fx, Fz=fz)

    @property
    def theta_deg(self) -> FloatArray:
        """Leg angles of a prediction [deg], shape [theta]."""
        return self.Fx.theta_deg

    @property
    def phi_bounds_deg(self) -> tuple[float, float]:
        """Smallest and largest training friction angle [deg]."""
        return float(self.Fx.phi_deg[0]), float(self.Fx.phi_deg[-1])

    @property
    def phi_step_deg(self) -> float:
        """Largest spacing of the training friction angles [deg]."""
        return float(np.diff(self.Fx.phi_deg).max())

    def predict(self, phi_deg: ArrayLike, *, scale: float = 1.0) -> FloatArray:
        """Mean observation vectors [N], shape [k] -> [k, 2 theta].

        Parameters
        ----------
        phi_deg
            Friction angles [deg], shape [k].
        scale
            Factor on the forces [-], such as the soil's density over the library's.
        """
        return scale * np.hstack([self.Fx.predict(phi_deg), self.Fz.predict(phi_deg)])

    def predict_variance(self, phi_deg: ArrayLike, *, scale: float = 1.0) -> FloatArray:
        """Variance of the latent forces of `predict` [N^2], shape [k] -> [k, 2 theta]."""
        pairs = [gp.predict(phi_deg, return_variance=True) for gp in (self.Fx, self.Fz)]
        return scale**2 * np.hstack([variance for _, variance in pairs])
