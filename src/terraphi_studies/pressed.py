"""A force law of flat discs by the material point method in space, from the cases of plan `plates`.

The simulated forces swing as particles pass through cells of 6 mm, so that each curve is taken as
the parabola over sinkage that fits it best. Between curves ln F is a cubic over the friction angle
and linear in the logarithm of the diameter; forces are proportional to the density, as the soil has
no cohesion. It is asked within what was simulated, and a little beyond its diameters.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError
from terraphi.forward.foot_laws import Foot
from terraphi.library.plan import Plan
from terraphi_studies.planned import Simulations

PLAN = "plates"
FIRST = 1e-3
"""Sinkage at which a simulated plate has met all particles beneath it [m]."""
BEYOND = 1.4
"""Factor beyond the simulated diameters up to which the law answers [-]."""


class PressedDiscs:
    """Forces on discs that are pressed straight down; :class:`~terraphi.forward.foot_laws.FootLaw`.

    Attributes
    ----------
    friction_angle_deg
        First and last one that was simulated [deg]; beyond, forces are those at the end.
    deepest
        Sinkage that was simulated [m].
    """

    name = "mpm3d"

    def __init__(self) -> None:
        from scipy.interpolate import CubicSpline

        plan = Plan.load(PLAN)
        finished = Simulations().histories(plan)
        cases = [(s.leg.width, s.soil.friction_angle_deg, finished[s.hash]) for s in plan.cases()]
        diameters, angles = np.unique([case[0] for case in cases]), np.unique([c[1] for c in cases])
        self.deepest = float(cases[0][2].position[-1])
        self._depths = np.linspace(FIRST, self.deepest, 57)
        logs = np.zeros((len(angles), len(diameters), len(self._depths)))
        for width, phi, history in cases:
            met = history.position > FIRST
            upward = history.force[met, history.axes.index("z")]
            parabola = np.polyfit(history.position[met], upward, 2)
            at = np.searchsorted(angles, phi), np.searchsorted(diameters, width)
            logs[at] = np.log(np.polyval(parabola, self._depths))
        self._logs = CubicSpline(angles, logs)
        self._diameters = np.log(diameters)
        self._density = plan.scenario.soil.density
        self.friction_angle_deg = float(angles[0]), float(angles[-1])

    def reaches(self, diameter: float) -> bool:
        """Whether a diameter [m] is close enough to those that were simulated."""
        low, high = np.exp(self._diameters)
        return bool(low / BEYOND <= diameter <= high * BEYOND)

    def force(
        self,
        foot: Foot,
        depth: ArrayLike,
        descent: ArrayLike,
        *,
        friction_angle_deg: ArrayLike,
        density: float,
        surface_friction: float,
    ) -> FloatArray:
        """Force on a disc that goes straight down; it is rough, of friction 0.5, whatever is asked.

        Raises
        ------
        InputError
            If the foot is no disc of about the simulated sizes.
        """
        del descent, surface_friction
        if foot.shape != "disc" or not self.reaches(2.0 * foot.radius):
            low, high = 1e3 * np.exp(self._diameters)
            raise InputError(
                f"law '{self.name}' knows discs of {low / BEYOND:.0f} to {high * BEYOND:.0f} mm, "
                f"not a {foot.shape} of {2e3 * foot.radius:g} mm"
            )
        low, high = self._diameters
        share = (np.log(2.0 * foot.radius) - low) / (high - low)
        angle, sunk = np.broadcast_arrays(
            np.clip(friction_angle_deg, *self.friction_angle_deg), np.asarray(depth, np.float64)
        )
        each, which = np.unique(angle, return_inverse=True)
        logs = self._logs(each)  # [angle, diameter, depth]
        curves = (1.0 - share) * logs[:, 0] + share * logs[:, 1]
        place = np.interp(sunk, self._depths, np.arange(len(self._depths)))
        left = np.minimum(place.astype(np.int64), len(self._depths) - 2)
        row, part = which.reshape(angle.shape), place - left
        inside = (1.0 - part) * curves[row, left] + part * curves[row, left + 1]
        lift = density / self._density * np.exp(inside) * np.clip(sunk / FIRST, 0.0, 1.0)
        return np.stack([np.zeros_like(lift), lift], axis=-1)


@cache
def pressed_discs() -> PressedDiscs:
    """The law, from the shipped cases."""
    return PressedDiscs()
