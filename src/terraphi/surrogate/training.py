"""What a library holds of one leg: points of its parameters, and the forces there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError
from terraphi.experiment.scenario import Scenario
from terraphi.library.plan import value_of
from terraphi.library.store import Library, differ_beyond

DENSITY = "soil.density"
NOT_PARAMETERS = ("leg.shape", "numerics.seed")
"""Keys that plans vary and that are no parameters of the soil or the setup."""
FEWEST_CASES = 3


@dataclass(frozen=True, eq=False)
class Training:
    """Points and forces of one leg.

    Attributes
    ----------
    bounds
        Dotted scenario key of each parameter to its bounds, in the order of the columns.
    values
        Parameters in their own units, shape [case, d].
    theta_deg
        Leg angles [deg], shape [theta].
    forces
        Observation vectors [Fx, Fz] [N], shape [case, 2 theta].
    scenario
        That of the first case.
    """

    bounds: Mapping[str, tuple[float, float]]
    values: FloatArray
    theta_deg: FloatArray
    forces: FloatArray
    scenario: Scenario

    @property
    def density(self) -> FloatArray:
        """Density of each case [kg/m3], shape [case]."""
        keys = list(self.bounds)
        if DENSITY in keys:
            return self.values[:, keys.index(DENSITY)]
        return np.full(len(self.values), self.scenario.soil.density)


def parameters(library: Library) -> dict[str, tuple[float, float]]:
    """Dotted keys of the parameters that a library varies, and the bounds of their values.

    Parameters
    ----------
    library
        Of a plan with a sweep or a sample. Of what is swept the bounds are those of the cases
        that every leg has; of what is sampled, those of the box.

    Raises
    ------
    InputError
        If it varies none that is a number.
    """
    found = _varied(library)
    if not found:
        raise InputError(f"library '{library.name}' varies no parameter")
    return found


def is_of_several(library: Library) -> bool:
    """Whether a library varies more than one parameter."""
    return len(_varied(library)) > 1


def _varied(library: Library) -> dict[str, tuple[float, float]]:
    """Keys and bounds of :func:`parameters`; empty if there are none."""
    plan, found = library.plan, {}
    for key, values in plan.swept.items():
        numbers = [v for v in values if isinstance(v, int | float) and not isinstance(v, bool)]
        if key not in NOT_PARAMETERS and len(numbers) == len(values) > 1:
            low, high = _reached(library, key)
            if low < high:
                found[key] = (low, high)
    if plan.sample:
        for i, (key, (low, high)) in enumerate(plan.sample.keys.items()):
            extra = [point[i] for point in plan.sample.also]
            found[key] = (min(low, *extra, low), max(high, *extra, high))
    return found


def _reached(library: Library, key: str) -> tuple[float, float]:
    """Least and largest value of a key that no leg lacks."""
    by_leg: dict[str, list[float]] = {}
    for case in library.cases:
        if case.history:
            by_leg.setdefault(case.scenario.leg.shape, []).append(
                float(value_of(case.scenario, key))
            )
    return max(map(min, by_leg.values())), min(map(max, by_leg.values()))


def training(library: Library, leg: str, *, readings: FloatArray | None = None) -> Training:
    """Points and forces of one leg of a library.

    Parameters
    ----------
    library
        Simulations over one parameter or several.
    leg
        Shape of the leg.
    readings
        As in :meth:`Library.curves`.

    Raises
    ------
    InputError
        If the library lacks the leg, has too few cases of it, varies no parameter or what is none,
        or its histories cannot be inverted.
    """
    bounds = parameters(library)
    chosen = library.rotations(leg, over_phi="soil.friction_angle_deg" in bounds)
    if len(chosen) < FEWEST_CASES:
        raise InputError(
            f"library '{library.name}' has {len(chosen)} cases of leg '{leg}'; at least "
            f"{FEWEST_CASES} are needed"
        )
    if differ_beyond(chosen, bounds):
        raise InputError(
            f"library '{library.name}' varies more than {', '.join(bounds)}: its cases of leg "
            f"'{leg}' differ in what is no number, and would count as scatter; build one for each"
        )
    values = np.array([[float(value_of(c.scenario, k)) for k in bounds] for c in chosen])
    seen = [c.history.as_read_at(readings).observation() for c in chosen if c.history]
    forces = np.stack([o.vector for o in seen])
    return Training(bounds, values, seen[0].theta_deg, forces, chosen[0].scenario)
