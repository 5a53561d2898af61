"""Both forces on a leg over several parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from terraphi.design_surrogate.process import DesignGP
from terraphi.design_surrogate.size import Size
from terraphi.design_surrogate.training import DENSITY, Training

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class DesignSurrogate:
    """A process for each force on one leg, over named parameters.

    Forces of cohesionless soil are proportional to its density but for what its stiffness does, so
    the processes model forces over density and over their size at the density of the library, and
    both multiply them again: the density may be a parameter whether the library varies it or not.

    Attributes
    ----------
    bounds
        Dotted key of each parameter that the library varies to its bounds.
    reference_density
        Density that stands for itself where none is given [kg/m3].
    size
        Size of the forces at the reference density [N].
    Fx, Fz
        Processes of the forces over their size [-].
    """

    bounds: Mapping[str, tuple[float, float]]
    reference_density: float
    size: Size
    Fx: DesignGP
    Fz: DesignGP

    @classmethod
    def fit(cls, data: Training, *, seed: int = 0) -> Self:
        """Fit a process to each force; errors as in `DesignGP.fit`.

        Parameters
        ----------
        data
            Points and forces.
        seed
            Of the optimiser's random start.
        """
        reference = data.scenario.soil.density
        scaled = data.forces * (reference / data.density)[:, None]
        points = to_unit(data.values, data.bounds)
        size = Size.fit(points, scaled, seed=seed)
        scaled /= size(points)[:, None]
        half = data.theta_deg.size
        parts = (scaled[:, :half], scaled[:, half:])
        fx, fz = (DesignGP.fit(points, data.theta_deg, part, seed=seed) for part in parts)
        return cls(data.bounds, reference, size, fx, fz)

    @property
    def theta_deg(self) -> FloatArray:
        """Leg angles [deg], shape [theta]."""
        return self.Fx.theta_deg

    @property
    def processes(self) -> tuple[DesignGP, DesignGP]:
        """Those of Fx and Fz."""
        return self.Fx, self.Fz

    def points(self, named: Mapping[str, FloatArray]) -> FloatArray:
        """Scaled points of parameters by key, each of shape [k] -> [k, d].

        Raises
        ------
        KeyError
            If a parameter of the library is missing.
        """
        return to_unit(np.column_stack([named[key] for key in self.bounds]), self.bounds)

    def scale(self, named: Mapping[str, FloatArray]) -> FloatArray:
        """Factor of density and size on what the processes predict [N], shape [k]."""
        scale: FloatArray = self._relative_density(named) * self.size(self.points(named))
        return scale

    def located(self, named: Mapping[str, FloatArray]) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Points, scale and variance of the common factor at once; as the three methods."""
        points = self.points(named)
        size, variance = self.size.both(points)
        return points, self._relative_density(named) * size, variance

    def _relative_density(self, named: Mapping[str, FloatArray]) -> FloatArray | float:
        density = named.get(DENSITY)
        return 1.0 if density is None else density / self.reference_density

    def factor_variance(self, named: Mapping[str, FloatArray]) -> FloatArray:
        """Variance of the factor by which both forces may be wrong alike [-], shape [k]."""
        return self.size.variance(self.points(named))

    def slopes(
        self, named: Mapping[str, FloatArray], keys: Sequence[str], steps: Sequence[float]
    ) -> list[FloatArray]:
        """Slopes of each force over some parameters, by central differences, in the basis.

        Parameters
        ----------
        named
            Points: dotted key to values, shape [k] each.
        keys, steps
            Parameters, and the step of each, in its unit.

        Returns
        -------
        list of ndarray
            Of Fx and Fz [N per unit], shape [k, key, theta]; a basis of the leg angles each.
        """
        found: list[list[FloatArray]] = [[], []]
        for key, step in zip(keys, steps, strict=True):
            ends = [{**named, key: named[key] + side * step} for side in (-1.0, 1.0)]
            for process, slopes in zip(self.processes, found, strict=True):
                low, high = (
                    self.scale(end)[:, None] * process.rotated_mean(self.points(end))
                    for end in ends
                )
                slopes.append((high - low) / (2.0 * step))
        return [np.stack(slopes, axis=1) for slopes in found]

    def predict(self, named: Mapping[str, FloatArray]) -> tuple[FloatArray, FloatArray]:
        """Mean [N] and variance [N^2] of the forces, parameters of shape [k] -> [k, 2 theta].

        Parameters
        ----------
        named
            Dotted key to values in the key's own unit; ``soil.density`` may be left out.
        """
        points, scale = self.points(named), self.scale(named)[:, None]
        parts = [process.predict(points) for process in self.processes]
        mean = scale * np.hstack([mean for mean, _ in parts])
        variance = np.square(scale) * np.hstack([variance for _, variance in parts])
        return mean, variance + self.factor_variance(named)[:, None] * np.square(mean)


def to_unit(values: FloatArray, bounds: Mapping[str, tuple[float, float]]) -> FloatArray:
    """Parameters scaled from their bounds to [-1, 1], shape [k, d]."""
    low, high = np.array(list(bounds.values())).T
    unit: FloatArray = 2.0 * (values - low) / (high - low) - 1.0
    return unit


def from_unit(points: FloatArray, bounds: Mapping[str, tuple[float, float]]) -> FloatArray:
    """Inverse of :func:`to_unit`."""
    low, high = np.array(list(bounds.values())).T
    values: FloatArray = low + 0.5 * (points + 1.0) * (high - low)
    return values
