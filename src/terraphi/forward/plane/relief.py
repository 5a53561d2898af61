"""Tail-phase relief: soil that the leg has carried far from its place fades (Xu & Wang)."""

from __future__ import annotations

import math
from typing import NamedTuple

from terraphi.experiment.scenario import Scenario
from terraphi.forward.compiled import kernel


class Fading(NamedTuple):
    """Constants of the relief, as the kernels take them."""

    distance: float
    """Displacement beyond which a particle fades [m]; inf where there is no relief."""
    rate: float
    """[1/rad]."""
    least: float
    """[-]."""


def fading_of(scenario: Scenario) -> Fading:
    """Constants of a scenario; without effect if disabled or if the leg does not rotate."""
    relief = scenario.relief
    active = relief.enabled and scenario.motion.kind == "rotation"
    return Fading(relief.distance if active else math.inf, relief.rate, relief.least)


@kernel
def decay(turned: float, fading: Fading) -> float:
    """Factor on the weights of particles that are far, exp(-rate |Δθ|) [-].

    Parameters
    ----------
    turned
        |Δθ| of the step once θ > 0 [rad], zero before.
    fading
        :class:`Fading`.
    """
    return math.exp(-fading.rate * turned)


@kernel
def faded(weight: float, dx: float, dz: float, factor: float, fading: Fading) -> float:
    """Weight of a particle after a step, q ← max(q_min, q exp(-rate |Δθ|)) once it is far.

    Without branches and calls, so that it can be done to many particles at once.

    Parameters
    ----------
    weight
        q [-].
    dx, dz
        Displacement since the start [m].
    factor
        :func:`decay` of the step [-].
    fading
        :class:`Fading`.

    Returns
    -------
    float
        q [-].
    """
    less = max(fading.least, weight * factor)
    return less if math.sqrt(dx * dx + dz * dz) > fading.distance else weight
