r"""Where a leg first meets the soil: it tells how high its hip is, and hardly depends on friction.

Forces rise from nothing when the leg's lowest point comes to the soil. If a record reaches a small
share of its largest force at :math:`\theta`, and another of the same leg at :math:`\theta_0`, then
with :math:`d(\theta)` the depth of the lowest point below the hip

.. math:: h - h_0 = d(\theta) - d(\theta_0)

is how much higher above the soil the hip of the first was. Simulated legs whose hip is 7 mm higher
are told to be 6 to 8 mm higher, whatever the leg and the friction angle.

A wrong height looks like another friction angle, and no residual shows it: a millimetre more reads
as 0.5 to 0.7° less by the straight leg, 0.7 to 0.8° by the reversed C and 0.4° by the C (the same
cases, through `sand3d` as simulated). Where a simulated leg meets the soil depends on its grid, by
millimetres; so a measured record is set beside the shipped ones, whose hip was meant to be 20 mm
above the soil. They are up to 9 mm apart among themselves. Were each medium left out in turn,
two records of twelve would be asked about, those of poppy seeds on the straight leg and the
reversed C.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.history import WINDOW_DEG, ForceHistory
from terraphi.experiment.leg import Leg
from terraphi.experiment.measurements import (
    is_of_their_apparatus,
    measurement,
    medium_and_leg,
    names,
)
from terraphi.inference.findings import Doubt
from terraphi.inference.noise import resolution_of
from terraphi.library.store import Library

SHARE, MOST_SHARE = 0.02, 0.1
"""Force at the first contact, over the largest: as a rule, and at most where readings are noisy."""
CLEAR = 5.0
"""The same over the noise of a mean, at least."""
LOADED = 0.25
"""Force over the largest at which a leg surely is in the soil."""
MEAN_DEG = 1.0
"""Width of the means that are looked at [deg]."""
APART_DEG = 2.0
"""Distance of readings beyond which they do not tell the contact [deg]."""
MEDIAN = 5
"""Means of which the median is taken, so that a spike or a dropout is no contact."""
IN_AIR, ZERO = 4, 12
"""Means in air before the contact: at least, and of which the zero of the sensor is taken."""
MARGIN_M = 0.003
"""How far beyond those of the shipped records a height is taken for usual [m]."""


@dataclass(frozen=True)
class Contact:
    """The first contact of a record's leg with the soil.

    Attributes
    ----------
    theta_deg
        Leg angle there [deg].
    hip_higher_m
        By how much the hip is higher above the soil than those of the shipped records are on
        average, if the leg and the zero of the leg angle are the same [m].
    usual_m
        Between which heights nothing is said [m].
    """

    theta_deg: float
    hip_higher_m: float
    usual_m: tuple[float, float]

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers."""
        return {**asdict(self), "usual_m": list(self.usual_m)}

    def doubt(self) -> Doubt | None:
        """What is asked about it, if the height is unusual."""
        low, high = self.usual_m
        if low <= self.hip_higher_m <= high:
            return None
        way = "higher" if self.hip_higher_m > 0.0 else "lower"
        size_mm = 1e3 * abs(self.hip_higher_m)
        return Doubt("height", {"theta_deg": self.theta_deg, "size_mm": size_mm, "way": way})


def first_contact(history: ForceHistory, shape: str, library: Library) -> Contact | None:
    """Find the first contact of a measured record, beside those of the shipped ones.

    Parameters
    ----------
    history
        Forces over the leg angle.
    shape
        Of its leg.
    library
        What it is inverted with: its legs, and the heights of their hips.

    Returns
    -------
    Contact or None
        ``None`` if the record does not begin in air, or is too noisy or too coarse to tell, or the
        library's apparatus is not that of the shipped records, or varies.
    """
    if not all(is_of_their_apparatus(case.scenario) for case in library.cases):
        return None
    found = contact_deg(history)
    if found is None:
        return None
    theta_deg, share = found
    known = _known_depths(shape, round(share, 3))
    if not known:
        return None
    mean = float(np.mean(known))
    higher = float(_leg(shape).depth(np.radians([theta_deg]))[0]) - mean
    usual = min(known) - mean - MARGIN_M, max(known) - mean + MARGIN_M
    return Contact(theta_deg, higher, usual)


def contact_deg(history: ForceHistory, share: float = SHARE) -> tuple[float, float] | None:
    """Leg angle at which the leg meets the soil [deg], and at what share of the largest force.

    Parameters
    ----------
    history
        Forces over the leg angle, beginning in air.
    share
        To be looked for; where readings are noisy it is more.

    Returns
    -------
    tuple or None
        ``None`` if the history does not begin in air or is too noisy to tell.
    """
    from scipy.ndimage import median_filter

    theta_deg = np.arange(history.theta_deg[0] + 0.5 * MEAN_DEG, WINDOW_DEG, MEAN_DEG)
    theta_deg = theta_deg[theta_deg < history.theta_deg[-1]]
    if len(theta_deg) <= max(IN_AIR, MEDIAN) or len(history.position) < MEDIAN:
        return None
    plane = replace(history, force=np.stack([history.Fx, history.Fz], axis=1), axes=("x", "z"))
    means = plane.means(np.radians(theta_deg), math.radians(0.5 * MEAN_DEG))
    means = median_filter(means, size=(MEDIAN, 1), mode="nearest")
    if not np.ptp(means, axis=0).any():
        return None
    noise = _noise(plane)
    rise = _rise(means, slice(0, IN_AIR), share, noise)
    if rise is not None:  # The zero may drift, and is looked for again right before the contact.
        rise = _rise(means, slice(max(rise.at - ZERO, 0), rise.at), rise.share, noise)
    if rise is None:
        return None
    pair = slice(rise.at, rise.at + 2)
    met = float(np.interp(rise.share, rise.size[pair], theta_deg[pair]))
    return (met, rise.share) if _is_read(history, met) else None


class _Rise(NamedTuple):
    """Force over its largest, the last mean in air before it rises, and the share that says so."""

    size: FloatArray
    at: int
    share: float


def _rise(means: FloatArray, in_air: slice, share: float, noise: float) -> _Rise | None:
    """Where the force rises above a share, or its noise, over the zero that is read in air."""
    size = np.hypot(*(means - np.median(means[in_air], axis=0)).T)
    share = max(share, CLEAR * noise / float(size.max()))
    size /= size.max()
    loaded = int(np.argmax(size >= LOADED))
    at = int(np.flatnonzero(size[:loaded] < share).max(initial=0))
    return None if share > MOST_SHARE or at < IN_AIR else _Rise(size, at, share)


def _is_read(history: ForceHistory, theta_deg: float) -> bool:
    """Whether there are readings close to an angle on both sides."""
    after = int(np.searchsorted(history.theta_deg, theta_deg))
    around = history.theta_deg[max(after - 2, 0) : after + 2]
    return bool(np.diff(around).max(initial=0.0) <= APART_DEG * (1.0 + 1e-6))


def _noise(history: ForceHistory) -> float:
    """Standard deviation of the noise of a mean [N], by second differences of the readings."""
    rough = np.diff(history.force, n=2, axis=0)
    # The median size of normal deviates is 0.67 of their deviation; that of these is six times.
    reading = float(np.median(np.abs(rough), axis=0).max() / 0.6745 / math.sqrt(6.0))
    spacing = float(np.median(np.diff(history.theta_deg)))
    # Rounding to counts of a coarse sensor errs by that much, and means may not take it off.
    count = max(map(resolution_of, history.force.T))
    return max(reading * min(1.0, math.sqrt(spacing / MEAN_DEG)), count / math.sqrt(12.0))


def _leg(shape: str) -> Leg:
    return Leg.model_validate({"shape": shape})


@cache
def _known_depths(shape: str, share: float) -> tuple[float, ...]:
    """Depth of a leg at its first contact in each shipped record [m]."""
    records = (measurement(name) for name in names() if medium_and_leg(name)[1] == shape)
    found = [contact_deg(one.history, share) for one in records]
    angles = [one[0] for one in found if one is not None]
    return tuple(_leg(shape).depth(np.radians(angles)).tolist()) if angles else ()
