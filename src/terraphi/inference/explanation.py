"""What would explain a record that no friction angle of a library fits.

A slip of the person who recorded it (columns exchanged, a sign turned, another unit, the path read
backwards), or a friction angle beyond the library's end. Each is tried on the library's own curves,
and counts only if it explains the record far better than any angle does as it stands. A record
that neither explains is one that the model does not describe; a wider library would not help.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

BETTER = 0.5
"""Deviation that is left, over that before, up to which an explanation counts [-]."""
CLOSE = 0.3
"""Deviation that is left, of peak-to-peak, up to which a slip counts [-]."""
CLOSE_BEYOND = 0.1
"""The same of an angle beyond the library's end [-]."""
FURTHEST_DEG = 15.0
"""How far beyond the library's end an angle is looked for [deg]."""


def _each(x: float, z: float) -> Callable[[FloatArray], FloatArray]:
    return lambda forces: forces * np.array([[x], [z]])


SLIPS: dict[str, Callable[[FloatArray], FloatArray]] = {
    "Are Fx and Fz exchanged?": lambda forces: forces[::-1],
    "Is the sign of Fx turned? It points forward, as a force on the leg.": _each(-1.0, 1.0),
    "Is the sign of Fz turned? It points up, as a force on the leg.": _each(1.0, -1.0),
    "Are these the forces of the leg on the soil? Those on the leg are meant.": _each(-1.0, -1.0),
    "Does theta run backwards? It grows as the leg moves.": lambda forces: forces[:, ::-1],
    "Are the forces in pounds-force? Newtons are meant.": _each(4.4482216, 4.4482216),
    "Are the forces in kilograms-force? Newtons are meant.": _each(9.80665, 9.80665),
    "Are the forces in grams-force? Newtons are meant.": _each(9.80665e-3, 9.80665e-3),
    "Are the forces in kilonewtons? Newtons are meant.": _each(1e3, 1e3),
    "Are the forces in millinewtons? Newtons are meant.": _each(1e-3, 1e-3),
}
"""Question to what would set the record right; forces have shape [2, theta]."""


@dataclass(frozen=True)
class Explanation:
    """What would explain a record.

    Attributes
    ----------
    question
        Whether it was a slip, as a question; empty if none would explain it.
    beyond
        Which end of the library the angle seems to lie beyond, if one.
    """

    question: str = ""
    beyond: Literal["low", "high"] | None = None


def explain(data: FloatArray, curves: FloatArray, phi_deg: FloatArray) -> Explanation:
    """Try slips and angles beyond the library on a record.

    Parameters
    ----------
    data
        Observation vector [N], shape [2 theta].
    curves
        The library's at closely spaced angles, at the density of the soil [N], [k, 2 theta].
    phi_deg
        These friction angles, increasing [deg], shape [k].
    """
    as_is = _deviation(data, curves).min()
    beyond, end = min((_beyond(data, curves, phi_deg, end), end) for end in ("low", "high"))
    forces = data.reshape(2, -1)
    slips = []
    for question, right in SLIPS.items():
        deviations = _deviation(right(forces).ravel(), curves)
        # At an end of the library a slip explains nothing: more of it would do the same.
        if 0 < int(deviations.argmin()) < len(curves) - 1:
            slips.append((float(deviations.min()), question))
    slip, question = min(slips, default=(np.inf, ""))
    if beyond <= min(slip, CLOSE_BEYOND, BETTER * as_is):
        return Explanation(beyond="low" if end == "low" else "high")
    if slip <= min(CLOSE, BETTER * as_is):
        return Explanation(question=question)
    return Explanation()


def _deviation(data: FloatArray, curves: FloatArray) -> FloatArray:
    """Root mean square deviation from each curve, of the data's peak-to-peak, the larger force's.

    Shapes [2 theta] and [k, 2 theta] -> [k].
    """
    measured, model = data.reshape(2, -1), curves.reshape(len(curves), 2, -1)
    root = np.sqrt(np.square(model - measured).mean(axis=2))
    worst: FloatArray = (root / np.maximum(np.ptp(measured, axis=1), 1e-300)).max(axis=1)
    return worst


def _beyond(data: FloatArray, curves: FloatArray, phi_deg: FloatArray, end: str) -> float:
    """Deviation from the best curve beyond an end, were forces to go on growing as at that end."""
    at, sign = (0, -1.0) if end == "low" else (-1, 1.0)
    edge, inner = curves[at], curves[at + int(-sign)]
    slope = (edge - inner) / abs(phi_deg[at] - phi_deg[at + int(-sign)])
    further = np.linspace(0.0, FURTHEST_DEG, 61)[1:, None]
    return float(_deviation(data, edge + further * slope).min())
