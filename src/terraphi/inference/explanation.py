"""What would explain a record that no friction angle of a library fits.

A slip of the person who recorded it (columns exchanged, a sign turned, another unit, the path read
backwards), a sensor that was not tared, whose zero moved or that was saturated, or a friction angle
beyond the library's end. Each is tried on the library's own curves, and counts only if it explains
the record far better than any angle does as it stands. A record that none explains is one that the
model does not describe; a wider library would not help.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.history import WINDOW_DEG
from terraphi.inference.findings import Doubt, Side

BETTER = 0.5
"""Deviation that is left, over that before, up to which an explanation counts [-]."""
BETTER_CUT = 0.7
"""The same of a force that is cut off [-]: noise hides how well that explains a record. Of 36 whole
ones, with noise of 1 and 3 % of the peak, none came below 1."""
CLOSE = 0.3
"""Deviation that is left, of peak-to-peak, up to which a slip counts [-]."""
CLOSE_BEYOND = 0.1
"""The same of an angle beyond the library's end [-]."""
OFFSET, STEP, CLOSE_OFFSET = 0.05, 0.1, 0.05
"""Constant force that counts as an offset, or as a step or hidden by saturation, and the deviation
left up to which it does, of peak-to-peak [-]. With an offset curves of another model come within
0.1 of a library's, and with either the shipped measurements within 0.07."""
FURTHEST_DEG = 15.0
"""How far beyond the library's end an angle is looked for [deg]."""
USUAL_DEG = (18.0, 50.0)
"""Friction angles of dry granular soils in plane strain [deg]: smooth glass beads, loose, have
some 20 to 25, dense sand at a few kilopascals up to some 50."""
STEP_WINDOWS = 3
"""Fewest windows of the record before a step and after it, and of a saturated sensor."""


def _each(x: float, z: float) -> Callable[[FloatArray], FloatArray]:
    return lambda forces: forces * np.array([[x], [z]])


SLIPS: dict[str, Callable[[FloatArray], FloatArray]] = {
    "exchanged": lambda forces: forces[::-1],
    "turned_Fx": _each(-1.0, 1.0),
    "turned_Fz": _each(1.0, -1.0),
    "on_the_soil": _each(-1.0, -1.0),
    "backwards": lambda forces: forces[:, ::-1],
    "pounds_force": _each(4.4482216, 4.4482216),
    "kilograms_force": _each(9.80665, 9.80665),
    "grams_force": _each(9.80665e-3, 9.80665e-3),
    "kilonewtons": _each(1e3, 1e3),
    "millinewtons": _each(1e-3, 1e-3),
}
"""Code of a doubt to what would set the record right; forces have shape [2, theta]."""
OFFSETS = ("tared", "moved", "saturated")
"""Codes of an offset, of a step and of a limit, which have a size to fit."""


@dataclass(frozen=True)
class Explanation:
    """What would explain a record.

    Attributes
    ----------
    question
        Whether it was a slip, and which; ``None`` if none would explain it.
    beyond
        Which end of the library the angle seems to lie beyond, if one.
    """

    question: Doubt | None = None
    beyond: Side | None = None


def explain(data: FloatArray, phi_deg: FloatArray, curves: FloatArray) -> Explanation:
    """Try slips and angles beyond the library on a record.

    Parameters
    ----------
    data
        Observation vector [N], shape [2 theta].
    phi_deg
        Closely spaced friction angles, increasing [deg], shape [k].
    curves
        The library's there, at the density of the soil [N], [k, 2 theta].
    """
    as_is = float(_deviation(data, curves).min())
    beyond, end = min((_beyond(data, curves, phi_deg, end), end) for end in ("low", "high"))
    forces = data.reshape(2, -1)
    slips = []
    for code, right in SLIPS.items():
        deviations = _deviation(right(forces).ravel(), curves)
        # At an end of the library a slip explains nothing: more of it would do the same.
        if 0 < int(deviations.argmin()) < len(curves) - 1:
            slips.append((float(deviations.min()), code))
    slip, code = min(slips, default=(np.inf, ""))
    offset, tare = _least(_offset(data, curves))
    left, step = _least(_step(data, curves))
    cut, saturated = _least(_saturated(data, curves))
    if cut <= min(CLOSE_OFFSET, BETTER_CUT * min(as_is, slip, beyond), offset, left):
        return Explanation(question=saturated)
    if left <= min(CLOSE_OFFSET, BETTER * min(as_is, slip, beyond, offset)):
        return Explanation(question=step)
    # It has a number to fit, as an angle beyond the end has, and a slip has none.
    if offset <= min(CLOSE_OFFSET, BETTER * min(as_is, slip, beyond)):
        return Explanation(question=tare)
    if beyond <= min(slip, CLOSE_BEYOND, BETTER * as_is):
        return Explanation(beyond="low" if end == "low" else "high")
    if slip <= min(CLOSE, BETTER * as_is):
        return Explanation(question=Doubt(code))
    return Explanation()


def _deviation(data: FloatArray, curves: FloatArray) -> FloatArray:
    """Root mean square deviation from each curve, of the data's peak-to-peak, the larger force's.

    Shapes [2 theta] and [k, 2 theta] -> [k].
    """
    measured, model = data.reshape(2, -1), curves.reshape(len(curves), 2, -1)
    root = np.sqrt(np.square(model - measured).mean(axis=2))
    return (root / np.maximum(np.ptp(measured, axis=1), 1e-300)).max(axis=1)


_Found = Iterator[tuple[float, Doubt]]
"""Deviations from the best curves of a record that is mended, and the question that mends it."""


def _least(found: _Found) -> tuple[float, Doubt | None]:
    return min(found, key=operator.itemgetter(0), default=(np.inf, None))


def _offset(data: FloatArray, curves: FloatArray) -> _Found:
    """Deviation from the best curve once the mean is taken from one force, and the question."""
    apart = data.reshape(2, -1) - curves.reshape(len(curves), 2, -1)
    spans = np.ptp(data.reshape(2, -1), axis=1)
    for axis, name in enumerate(("Fx", "Fz")):
        sizes = apart[:, axis].mean(axis=1)
        left = apart.copy()
        left[:, axis] -= sizes[:, None]
        share = np.sqrt(np.square(left).mean(axis=2)) / np.maximum(spans, 1e-300)
        best = int(share.max(axis=1).argmin())
        inside = 0 < best < len(curves) - 1
        if inside and abs(sizes[best]) > OFFSET * spans[axis]:
            question = Doubt("tared", {"force": name, "size_N": float(sizes[best])})
            yield float(share[best].max()), question


def _step(data: FloatArray, curves: FloatArray) -> _Found:
    """Deviation from the best curve once one force is shifted from a window on, and the question.

    For means over windows hide the noise that hides a step from who looks at readings.
    """
    apart = data.reshape(2, -1) - curves.reshape(len(curves), 2, -1)
    spans, count = np.maximum(np.ptp(data.reshape(2, -1), axis=1), 1e-300), apart.shape[2]
    squares = np.square(apart).sum(axis=2)
    theta_deg = np.linspace(-WINDOW_DEG, WINDOW_DEG, count)
    for axis, name in enumerate(("Fx", "Fz")):
        sums = np.cumsum(apart[:, axis, ::-1], axis=1)[:, ::-1]
        sizes = sums / np.arange(count, 0, -1)
        left = np.sqrt(np.maximum(squares[:, axis, None] - sizes * sums, 0.0) / count)
        other = np.sqrt(squares[:, 1 - axis] / count) / spans[1 - axis]
        share = np.maximum(left / spans[axis], other[:, None])[:, STEP_WINDOWS:-STEP_WINDOWS]
        best, after = np.unravel_index(int(share.argmin()), share.shape)
        first = int(after) + STEP_WINDOWS
        size = float(sizes[best, first])
        if 0 < best < len(curves) - 1 and abs(size) > STEP * spans[axis]:
            at = 0.5 * (theta_deg[first - 1] + theta_deg[first])
            question = Doubt("moved", {"force": name, "size_N": size, "theta_deg": float(at)})
            yield float(share[best, after]), question


def _saturated(data: FloatArray, curves: FloatArray) -> _Found:
    """Deviation from the best curve once one force is cut off at a limit, and the question.

    Of curves, as many of the windows of largest force are taken to be at the limit, which is what
    the record has there on average, as leave least. Noise that hides a flat top from who looks at
    readings hardly shows in means over windows.
    """
    measured, model = data.reshape(2, -1), curves.reshape(len(curves), 2, -1)
    spans, count = np.maximum(np.ptp(measured, axis=1), 1e-300), model.shape[2]
    squares = np.square(measured - model).sum(axis=2)
    many = np.arange(1, count + 1)
    for axis, sign in ((0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0)):
        order = np.argsort(-sign * model[:, axis], axis=1)
        own = np.take_along_axis(sign * model[:, axis], order, axis=1)
        read = (sign * measured[axis])[order]
        limits = np.cumsum(read, axis=1) / many
        at_limit = np.cumsum(np.square(read), axis=1) - many * np.square(limits)
        rest = squares[:, axis, None] - np.cumsum(np.square(read - own), axis=1)
        left = np.sqrt(np.maximum(at_limit + rest, 0.0) / count) / spans[axis]
        other = np.sqrt(squares[:, 1 - axis] / count) / spans[1 - axis]
        share = np.maximum(left, other[:, None])
        # What is cut off is above the limit, and more than a deviation might be.
        hidden = own[:, :1] - limits
        share[(hidden < STEP * spans[axis]) | (limits > own) | (many < STEP_WINDOWS)] = np.inf
        best, last = np.unravel_index(int(share.argmin()), share.shape)
        if 0 < best < len(curves) - 1 and np.isfinite(share[best, last]):
            numbers = {"force": ("Fx", "Fz")[axis], "size_N": float(sign * limits[best, last])}
            yield float(share[best, last]), Doubt("saturated", numbers)


def _beyond(data: FloatArray, curves: FloatArray, phi_deg: FloatArray, end: str) -> float:
    """Deviation from the best curve beyond an end, were forces to go on growing as at that end."""
    at, sign = (0, -1.0) if end == "low" else (-1, 1.0)
    edge, inner = curves[at], curves[at + int(-sign)]
    slope = (edge - inner) / abs(phi_deg[at] - phi_deg[at + int(-sign)])
    further = np.linspace(0.0, FURTHEST_DEG, 61)[1:, None]
    return float(_deviation(data, edge + further * slope).min())
