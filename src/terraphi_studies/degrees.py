"""How many degrees of friction angle a change of the force is worth.

A force that is off by some percent, because of the grid, say, is taken for another friction angle:
for the one whose force differs by as much. What a degree is worth is read off a library itself,
d ln F/dφ of its straight leg between 30 and 35°, with F the mean of a force's magnitude over the 40
leg angles of an inversion.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache

import numpy as np

from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.library.store import Library
from terraphi_studies.measures import FORCES, both

LIBRARY = "resolved"
"""Library by which measured forces are inverted."""
LEG = "straight"
BETWEEN_DEG = (30.0, 35.0)


def histories_of(library: Library) -> dict[float, ForceHistory]:
    """Friction angle [deg] to the straight leg's history, in increasing order.

    Raises InputError if there is none, or the legs do not rotate.
    """
    found = {
        case.scenario.soil.friction_angle_deg: case.history
        for case in library.cases
        if case.history is not None and case.scenario.leg.shape == LEG
    }
    if not found:
        raise InputError(f"library '{library.name}' has no leg '{LEG}'; it has {library.legs}")
    if any(history.coordinate != "theta" for history in found.values()):
        raise InputError(f"library '{library.name}' is one of translations; this needs rotations")
    return {phi: found[phi] for phi in sorted(found)}


def rise_per_degree(histories: Mapping[float, ForceHistory]) -> dict[str, float]:
    """Logarithmic slope of the forces, d ln F/dφ, between 30 and 35° [1/deg], by force.

    Parameters
    ----------
    histories
        By friction angle [deg]; on both sides of that range, or at its ends. Between two of them
        ln F goes with φ along a straight line.

    Raises
    ------
    InputError
        If the angles do not span the range.
    """
    low, high = BETWEEN_DEG
    angles = sorted(histories)
    if not angles or angles[0] > low or angles[-1] < high:
        span = f"{angles[0]:g} to {angles[-1]:g}°" if angles else "none"
        raise InputError(f"friction angles: {span}; from {low:g} to {high:g}° are needed")
    seen = [histories[angle].observation() for angle in angles]
    found = {}
    for force in FORCES:
        size = [float(np.abs(o.Fz if force == "Fz" else o.Fx).mean()) for o in seen]
        first, last = np.interp(BETWEEN_DEG, angles, np.log(size))
        found[force] = float(last - first) / (high - low)
    return found


@cache
def rise_of(library: str = LIBRARY) -> dict[str, float]:
    """:func:`rise_per_degree` of a library's straight leg, by the library's name."""
    return rise_per_degree(histories_of(Library.load(library)))


def in_degrees(percent: float, force: str, *, library: str = LIBRARY) -> float:
    """The friction angle that does to a force what a change by some percent does [deg].

    ln(1 + percent/100) / (d ln F/dφ), in the convention of the library whose forces say what a
    degree is worth. Raises ValueError if nothing is left of the force.
    """
    if percent <= -100.0:
        raise ValueError(f"a change by {percent:g} % leaves no force")
    return math.log1p(percent / 100.0) / rise_of(library)[force]


def worth(percent: Mapping[str, float], *, library: str = LIBRARY) -> str:
    """Changes of both forces [%] in degrees, such as ``-1.4 / -2.2°``, that of F_z first."""
    turned = {force: in_degrees(percent[force], force, library=library) for force in FORCES}
    return both(turned, "°", "+.1f")


def said(library: str = LIBRARY) -> str:
    """What a degree is worth, and by which library, in a sentence."""
    percent = {force: 100.0 * rise for force, rise in rise_of(library).items()}
    return (
        f"Degrees of φ: what the change does to a force, the friction angle would; by library "
        f"`{library}` a degree is worth {both(percent, ' %')} of "
        f"F_z / F_x (its d ln F/dφ at {BETWEEN_DEG[0]:g} to {BETWEEN_DEG[1]:g}°, straight leg, in "
        "its own convention of φ)."
    )
