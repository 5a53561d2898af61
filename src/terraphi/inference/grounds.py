r"""Ground without a friction angle: laws of clay and of a layer, compared with those of sand.

A force that rises from nothing with the depth can be fitted by a law of sand at some φ. Whether the
ground is sand shows in the shape of the rise, over all footfalls of a walk. Clay bears nine times
its undrained strength c_u on the area of contact (A. W. Skempton, *Building Research Congress* 1
(1951) 180), a mat, foam or snow a force that grows evenly with the depth:

.. math:: F = 9\, c_u\, \pi z (2R - z)\ \text{(at most } 9\, c_u\, \pi R^2),\qquad F = k\, z .

Both have one number for each footfall, as sand has φ, and the same level, drift, noise and inertia.
So have other laws of sand, whose residuals show how likely each is in place of the walk's own.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from terraphi.experiment.arrays import FloatArray
from terraphi.inference.touchdowns import Fit, Prior, Touchdowns, evenly, fit, is_slow, picked
from terraphi.laws.foot import Foot, FootLaw

SANDS = ("foot", "rft", "hansen")
"""Laws of sand that differ in their growth with depth, for whichever law the walk is read."""
LIKELY = ("foot", "rft", "hansen", "meyerhof")
"""Laws of sand whose φ counts in the absolute error of a walk, each by its probability."""
OWN_PART, COST_SCALE = 0.7, 0.05
"""Probability of the law by which a walk is read before any footfall, which the others share as to
the rest [-], and the mean of ln χ² that divides a probability by e. Of 36 simulated walks in sand
of these laws, of Archimedes' and of damp sand, each kind left out in turn: the likelihood of their
errors chose 0.7 or 0.85, and 0.05."""
HIGHEST_RFT_DEG = 65.0
"""Largest φ of ``rft`` as another law [deg]; chosen: no table of it ends, and differences between
places must not end at 50°."""
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
    # The circle in which a ball meets the surface: π z (2R − z), full from z = R on; a disc's is.
    cap = np.minimum(depth, foot.radius) if foot.shape == "ball" else foot.radius * (depth > 0.0)
    return 9.0 * UNITS["clay"] * math.pi * cap * (2.0 * foot.radius - cap)


def _rival(name: str, unit: Callable[[Foot, FloatArray], FloatArray]) -> FootLaw:
    def force(
        part: int, foot: Foot, depth: ArrayLike, _descent: ArrayLike, phi_deg: ArrayLike, *_: float
    ) -> FloatArray:
        depth = np.maximum(np.asarray(depth, dtype=np.float64), 0.0)
        return part * strength(phi_deg) * unit(foot, depth)

    return FootLaw(name, force)


def strength(phi_deg: ArrayLike) -> FloatArray:
    """Strength over its unit [-] at the φ that stands for it [deg]."""
    return np.asarray(np.exp((np.asarray(phi_deg) - MEAN_DEG) / FOLD_DEG))


RIVALS = {
    "clay": _rival("clay", _contact), "layer": _rival("layer", lambda _, z: UNITS["layer"] * z),
}  # fmt: skip


def slow(touchdowns: Touchdowns, prior: Prior) -> Touchdowns:
    """Touch-downs that tell one kind of ground from another, :data:`MOST_COMPARED` at most."""
    return evenly(picked(touchdowns, is_slow(touchdowns, prior)), MOST_COMPARED)


class Comparison(NamedTuple):
    """What a walk's footfalls are by other laws.

    Attributes
    ----------
    ground
        What the ground is, if it is no sand: a sentence, else an empty string.
    probability, phi_deg
        Of each law of sand: its probability [-], and the median φ by it [deg].
    read_deg
        Median φ of the same footfalls by the walk's law as it was learned [deg].
    """

    ground: str
    probability: dict[str, float]
    phi_deg: dict[str, float]
    read_deg: float = math.nan

    def spread_deg(self, law: str) -> float:
        """Root mean square distance of φ by the other laws from that by the walk's [deg]."""
        return math.sqrt(sum(
            probability * (self.phi_deg[name] - self.read_deg) ** 2
            for name, probability in self.probability.items() if name != law
        ))  # fmt: skip


def prior_of(law: str | FootLaw, prior: Prior) -> Prior:
    """The prior for another law than the walk's, with its largest angle and no exponent learned."""
    highest = HIGHEST_RFT_DEG if law == "rft" else prior.highest_deg
    return replace(prior, exponent=0.0, highest_deg=highest)


def compared(touchdowns: Touchdowns, law: str, prior: Prior, *, enough: bool) -> Comparison:
    """Compare laws of sand with each other, and with clay and a layer.

    Parameters
    ----------
    touchdowns
        Those of one walk on virgin ground, feet that sank in, of :func:`slow`.
    law, prior
        Law by which the walk is read, and its prior with the exponent that was learned.
    enough
        There are enough of them: otherwise no law is more likely than before.
    """

    def fitted(named: str | FootLaw, exponent: float = 0.0) -> Fit:
        return fit(touchdowns, named, replace(prior_of(named, prior), exponent=exponent))

    def cost(of: Fit) -> FloatArray:
        return np.log(np.maximum(of.cost, 1e-6))

    # Each law as it is: one that needs another growth with depth is less likely.
    plain = {name: fitted(name) for name in dict.fromkeys((law, *LIKELY))}
    means = {name: float(cost(each).mean()) if enough else 0.0 for name, each in plain.items()}
    rest = (1.0 - OWN_PART) / (len(plain) - 1)
    weight = {
        name: (OWN_PART if name == law else rest)
        * math.exp((min(means.values()) - mean) / COST_SCALE)
        for name, mean in means.items()
    }  # fmt: skip
    read = fitted(law, prior.exponent)
    comparison = Comparison(
        "",
        {name: each / sum(weight.values()) for name, each in weight.items()},
        {name: float(np.median(each.phi)) for name, each in plain.items()},
        float(np.median(read.phi)),
    )
    if not enough:
        return comparison
    # Each kind of ground by its best law over the walk; then footfall by footfall, whose noise
    # differs. The walk's law may grow with depth as it was learned, but no slower than in any sand.
    grown = fitted(law, LEAST_EXPONENT) if prior.exponent < LEAST_EXPONENT else read
    sands = [grown, *(plain[name] for name in SANDS if name != law)]
    sand = min(map(cost, sands), key=np.mean)
    rivals = {name: fitted(rival) for name, rival in RIVALS.items()}
    best = min(rivals, key=lambda name: float(cost(rivals[name]).mean()))
    least = 0.0 if law == "foot" and prior.exponent < NO_SAND else BEST_BY
    if float(np.median(cost(rivals[best]) - sand)) > -least:
        return comparison
    size = UNITS[best] * float(np.median(strength(rivals[best].phi)))
    kind = {
        "clay": f"clay, turf or other cohesive soil (shear strength {1e-3 * size:.0f} kPa)",
        "layer": f"a mat, foam, snow or clay (its force grows by {1e-3 * size:.1f} N/mm)",
    }[best]
    text = f"not a soil with a friction angle: forces grow with depth as on {kind}"
    return comparison._replace(ground=text)
