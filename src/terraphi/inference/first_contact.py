r"""Where a leg first meets the soil: it tells how high its hip is, and hardly depends on friction.

Forces rise from nothing when the leg's lowest point comes to the soil. If a record reaches a small
share of its largest force at :math:`\theta`, and another of the same leg at :math:`\theta_0`, then
with :math:`d(\theta)` the depth of the lowest point below the hip

.. math:: h - h_0 = d(\theta) - d(\theta_0)

is how much higher above the soil the hip of the first was. Simulated legs whose hip is 7 mm higher
are told to be 6 to 8 mm higher, whatever the leg and the friction angle.

A wrong height looks like another friction angle: by the straight leg a millimetre more reads
as 0.6 to 1.0° less (`study prediction`), and no residual shows it. Where a simulated leg meets the
soil depends on its grid, by millimetres; so a measured record is set beside the shipped ones, whose
hip was meant to be 20 mm above the soil. They are up to 9 mm apart among themselves.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from functools import cache
from typing import Any

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.leg import Leg
from terraphi.experiment.measurements import measurement, medium_and_leg, names
from terraphi.experiment.scenario import Scenario
from terraphi.inference.findings import Doubt

SHARE, MOST_SHARE = 0.02, 0.1
"""Force at the first contact, over the largest: as a rule, and at most where readings are noisy."""
CLEAR = 5.0
"""The same over the noise of a mean, at least."""
LOADED = 0.25
"""Force over the largest at which a leg surely is in the soil."""
WINDOW_DEG = 1.0
"""Width of the means that are looked at [deg]."""
IN_AIR, ZERO = 4, 12
"""Means in air before the contact: at least, and of which the zero of the sensor is taken."""
MARGIN_M = 0.003
"""How far beyond those of the shipped records a height is taken for usual [m]."""
APPARATUS, SAME = {"chord": 0.0762, "hip_height": 0.020}, 0.05
"""The leg and the height of the hip of the shipped records [m], and how nearly a library has to
have them [-]."""


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


def first_contact(history: ForceHistory, shape: str, scenario: Scenario) -> Contact | None:
    """Find the first contact of a measured record, beside those of the shipped ones.

    Parameters
    ----------
    history
        Forces over the leg angle.
    shape
        Of its leg.
    scenario
        What it is inverted as: length of the leg, and height of the hip.

    Returns
    -------
    Contact or None
        ``None`` if the record does not begin in air or is too noisy to tell, or the apparatus is
        not that of the shipped records.
    """
    size = {"chord": scenario.leg.chord, "hip_height": scenario.hip_height}
    if not all(math.isclose(size[key], value, rel_tol=SAME) for key, value in APPARATUS.items()):
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
    return Contact(theta_deg, higher, (min(known) - mean - MARGIN_M, max(known) - mean + MARGIN_M))


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
    first, last = history.theta_deg[[0, -1]].tolist()
    theta_deg = np.arange(first + 0.5 * WINDOW_DEG, last, WINDOW_DEG)
    if len(theta_deg) <= IN_AIR:
        return None
    means = history.means(np.radians(theta_deg), math.radians(0.5 * WINDOW_DEG))
    zero = np.median(means[:IN_AIR], axis=0)
    if not (means != zero).any():
        return None
    # The sensor's zero may drift, and is looked for again right before the contact.
    for again in (True, False):
        size = np.hypot(*(means - zero).T)
        share = max(share, CLEAR * _noise(means) / float(size.max()))
        loaded = int(np.argmax(size >= LOADED * size.max()))
        at = int(np.flatnonzero(size[:loaded] < share * size.max()).max(initial=0))
        if share > MOST_SHARE or at < IN_AIR:
            break
        if not again:
            pair = slice(at, at + 2)
            return float(np.interp(share * size.max(), size[pair], theta_deg[pair])), share
        zero = np.median(means[max(at - ZERO, 0) : at], axis=0)
    return None


def _noise(means: FloatArray) -> float:
    """Standard deviation of the noise of a mean [N], by second differences."""
    rough = np.diff(means, n=2, axis=0)
    # The median size of normal deviates is 0.67 of their deviation; that of these is six times.
    return float(np.median(np.abs(rough), axis=0).max() / 0.6745 / math.sqrt(6.0))


def _leg(shape: str) -> Leg:
    return Leg.model_validate({"shape": shape})


@cache
def _known_depths(shape: str, share: float) -> tuple[float, ...]:
    """Depth of a leg at its first contact in each shipped record [m]."""
    records = (measurement(name) for name in names() if medium_and_leg(name)[1] == shape)
    found = [contact_deg(one.history, share) for one in records]
    angles = [one[0] for one in found if one is not None]
    return tuple(_leg(shape).depth(np.radians(angles)).tolist()) if angles else ()
