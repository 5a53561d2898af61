r"""Ground without a friction angle: laws of clay and of a layer, compared with those of sand.

A force that rises from nothing with the depth can be fitted by a law of sand at some φ. Whether the
ground is sand shows in the shape of the rise, over all footfalls of a walk. Clay bears nine times
its undrained strength c_u on the area of contact (A. W. Skempton, *Building Research Congress* 1
(1951) 180), a mat, foam or snow a force that grows evenly with the depth:

.. math:: F = 9\, c_u\, \pi z (2R - z)\ \text{(at most } 9\, c_u\, \pi R^2),\qquad F = k\, z .

Both have one number for each footfall, as sand has φ, and the same level, drift, noise and inertia.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from terraphi.experiment.arrays import FloatArray
from terraphi.inference.touchdowns import Fit, Prior, Touchdowns, evenly, fit, is_slow, picked
from terraphi.laws.foot import Foot, FootLaw

SANDS = ("foot", "rft", "hansen")
"""Laws of sand that differ in their growth with depth, for whichever law the walk is read."""
LEAST_EXPONENT = -0.3
"""Exponent of law ``foot`` down to which its growth with depth counts as sand's [-]: −0.15 to −0.3
in grains that are pressed slowly."""
BEST_BY = 0.15
"""By how much the median of ln χ² has to be smaller by a rival law [-]. Walks on sand of the laws
``foot``, ``rft``, ``hansen``, ``meyerhof``, ``vesic`` and Archimedes' have −0.03 to 0.7 (26),
simulated grains 0.05 to 1, clay of 6 to 12 kPa −0.5 to −1.2, layers of 3 to 6 kN/m −0.2 to −0.6;
softer ones −0.1, into which feet sink as far as into deep sand."""
NO_SAND = -0.55
"""Exponent of a walk below which no sand's forces grow [-], so that a rival that fits no worse is
enough: −0.52 at least on simulated sand, damp sand of 200 Pa included; −0.6 and less on clay and
layers."""
MOST_COMPARED = 40
"""Most footfalls that are compared, evenly chosen (time)."""
MEAN_DEG, FOLD_DEG = 32.0, 7.0
"""The strength of a rival law is its unit times exp((φ − mean) / fold), so that its logarithm takes
the place of φ in the fit: 0.1 to 13 units over the range of φ."""
UNITS = {"clay": 8e3, "layer": 5e3}
"""Unit of strength: c_u [Pa] and k [N/m]."""


def _contact(foot: Foot, depth: FloatArray) -> FloatArray:
    # The circle in which a ball meets the surface: π z (2R − z), full from z = R on.
    cap = np.minimum(depth, foot.radius)
    return 9.0 * UNITS["clay"] * math.pi * cap * (2.0 * foot.radius - cap)


def _linear(_foot: Foot, depth: FloatArray) -> FloatArray:
    return UNITS["layer"] * depth


def _rival(name: str, unit: Callable[[Foot, FloatArray], FloatArray]) -> FootLaw:
    def force(
        foot: Foot, depth: ArrayLike, _descent: ArrayLike, phi_deg: ArrayLike, *_: float
    ) -> FloatArray:
        lift = strength(phi_deg) * unit(foot, np.maximum(np.asarray(depth, dtype=np.float64), 0.0))
        return np.stack([np.zeros_like(lift), lift], axis=-1)

    return FootLaw(name, force)


def strength(phi_deg: ArrayLike) -> FloatArray:
    """Strength over its unit [-] at the φ that stands for it [deg]."""
    return np.asarray(np.exp((np.asarray(phi_deg) - MEAN_DEG) / FOLD_DEG))


RIVALS = {"clay": _rival("clay", _contact), "layer": _rival("layer", _linear)}


def slow(touchdowns: Touchdowns, prior: Prior) -> Touchdowns:
    """Touch-downs that tell one kind of ground from another, :data:`MOST_COMPARED` at most."""
    return evenly(picked(touchdowns, is_slow(touchdowns, prior)), MOST_COMPARED)


def without_angle(touchdowns: Touchdowns, law: str, prior: Prior) -> str:
    """What the ground is, if it is no sand: a sentence, else an empty string.

    Parameters
    ----------
    touchdowns
        Those of one walk on virgin ground, feet that sank in, of :func:`slow`.
    law, prior
        Law by which the walk is read, and its prior with the exponent that was learned.
    """

    def fitted(named: str | FootLaw) -> Fit:
        # The walk's law may grow with depth as it was learned, but no slower than in any sand.
        exponent = max(prior.exponent, LEAST_EXPONENT) if named == law else 0.0
        return fit(touchdowns, named, replace(prior, exponent=exponent))

    def cost(of: Fit) -> FloatArray:
        return np.log(np.maximum(of.cost, 1e-6))

    # Each kind of ground by its best law over the walk; then footfall by footfall, whose noise
    # differs.
    sand = min((cost(fitted(name)) for name in {law, *SANDS}), key=np.mean)
    rivals = {name: fitted(rival) for name, rival in RIVALS.items()}
    best = min(rivals, key=lambda name: float(cost(rivals[name]).mean()))
    enough = 0.0 if law == "foot" and prior.exponent < NO_SAND else BEST_BY
    if float(np.median(cost(rivals[best]) - sand)) > -enough:
        return ""
    size = UNITS[best] * float(np.median(strength(rivals[best].phi)))
    kind = {
        "clay": f"clay, turf or other cohesive soil (shear strength {1e-3 * size:.0f} kPa)",
        "layer": f"a mat, foam, snow or clay (its force grows by {1e-3 * size:.1f} N/mm)",
    }[best]
    return f"not a soil with a friction angle: forces grow with depth as on {kind}"
