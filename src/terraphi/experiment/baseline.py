"""What a sensor reads without soil: its zero, its drift and the weight of the leg.

While the leg is clear of the soil, at rest or not, each channel of a record reads

    b(t, θ) = a + d t + s sin θ + c cos θ,

with the time t counted in rows: a zero, a drift, and a weight that turns with the frame of the leg.
The means over rests and over stretches of 5° in air are fitted by least squares: the zero, with the
weight or the drift if the angles determine it and the Bayesian information criterion (Schwarz 1978)
wants it. A drift is looked for between two rests alone, and not together with a weight: the forces
of another leg, which is in soil there, could pass for both.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from terraphi.experiment.arrays import BoolArray, FloatArray, block_means
from terraphi.experiment.history import CHANNEL_UNITS

REST_DEG, FEWEST_ROWS, LONGER = 0.5, 10, 5.0
"""Path within which a leg rests [deg]; rows that it does so at least, as a number and over those
that moving takes [-]."""
STRETCH_DEG = 5.0
"""Path in air that counts as one reading [deg]."""
FEWEST_STRETCHES = 3
"""Stretches in air that tare a record without a rest: in fewer a slow rise of the forces of another
leg, or of a wrong angle, passes for a zero."""
UNEXPLAINED, SCATTER = 0.015, 0.005
"""Force of good records in air, and its standard deviation there, of peak-to-peak [-]: up to 0.016
and 0.008 in the shipped ones of straight legs."""
SMOOTH = 0.025
"""Root mean square that readings may be off the fit and still be of air, of peak-to-peak [-]: 0.02
in the shipped records."""
OFFSET = 0.04
"""Force in air above which a record without a rest is not as good as tared, of peak-to-peak [-]:
root mean square, at most 0.02 in the shipped records."""
ZERO, DRIFT, WEIGHT = [0], [0, 1], [0, 2, 3]
"""Columns of the design that are fitted together."""


def at_rest(theta_deg: FloatArray) -> BoolArray:
    """Rows in which the leg rests, of those in the order of time, shape [row]."""
    starts, anchor = [0], theta_deg[0]
    for i, angle in enumerate(theta_deg.tolist()):
        if abs(angle - anchor) > REST_DEG:
            starts.append(i)
            anchor = angle
    counts = np.diff([*starts, len(theta_deg)])
    return np.repeat(counts >= max(FEWEST_ROWS, LONGER * float(np.median(counts))), counts)


def without_baseline(
    theta_deg: FloatArray,
    values: FloatArray,
    air: BoolArray,
    channels: Sequence[str],
    *,
    fewest: int = FEWEST_STRETCHES,
    least: float = OFFSET,
) -> tuple[FloatArray, list[str]]:
    """Take off what a sensor reads in air, if there was a rest or it is more than good ones read.

    Parameters
    ----------
    theta_deg
        Leg angles in the order of time [deg], shape [row].
    values
        Channels [N] or [N m], shape [row, channel].
    air
        Rows in which the leg is clear of the soil, shape [row].
    channels
        Name of each channel, such as ``Fx``.
    fewest, least
        Stretches in air, and force in air of peak-to-peak [-], from which a record without a rest
        is tared.

    Returns
    -------
    ndarray, list of str
        Channels without it; and what was taken off, a sentence each.
    """
    still, count = at_rest(theta_deg), len(theta_deg)
    group = np.where(still, 1e3, 0.0) + np.floor(theta_deg / STRETCH_DEG)
    first = np.flatnonzero(np.append(True, (np.diff(group) != 0.0) | np.diff(air)))
    in_air, span = air[first], np.maximum(np.ptp(values, axis=0), 1e-12)
    time, theta = np.linspace(0.0, 1.0, count), np.radians(theta_deg)
    design = np.stack([time**0, time, np.sin(theta), np.cos(theta)], axis=1)
    means, read = (block_means(rows, first)[in_air] for rows in (design, values / span))
    resting = time[first[in_air]][still[first[in_air]]]
    loaded = np.append(time[~air], 0.5)
    ends = {"start": resting < loaded.min(), "end": resting > loaded.max()}
    rests = [end for end, those in ends.items() if those.any()]
    best, lowest, solved, weighed = ZERO, np.inf, np.zeros((1, len(span))), True
    for terms in (ZERO, WEIGHT, DRIFT)[: 3 if len(rests) > 1 else 2] if len(read) else ():
        weights = np.linalg.pinv(means[:, terms])
        residual = np.square(read - means[:, terms] @ weights @ read).sum(axis=0)
        sd = np.sqrt(max(residual.max() / max(len(read) - len(terms), 1), SCATTER**2))
        spread = np.einsum("nk,kl,nl->n", design[:, terms], weights @ weights.T, design[:, terms])
        error = sd * np.sqrt(spread.max())
        if np.linalg.matrix_rank(means[:, terms]) < len(terms) or error > OFFSET / 2.0:
            weighed &= terms is not WEIGHT
            continue
        fit = len(read) * np.log(residual / len(read) + UNEXPLAINED**2).sum()
        criterion = fit + len(terms) * len(span) * np.log(len(read))
        if criterion < lowest and residual.max() < SMOOTH**2 * len(read):
            best, lowest, solved = terms, criterion, weights @ read * span
    baseline = design[:, best] @ solved
    size = np.sqrt(np.square(means[:, best] @ solved / span).mean(axis=0))
    if not (np.isfinite(lowest) and (rests or (len(read) >= fewest and size.max() >= least))):
        return values, []
    coefficients = np.zeros((design.shape[1], len(span)))
    coefficients[best] = solved

    def sizes(of: FloatArray) -> str:
        each = zip(channels, of, strict=True)
        return ", ".join(f"{name} {size:+.2f} {CHANNEL_UNITS[name]}" for name, size in each)

    by = f"the rest in air at the {' and the '.join(rests)}" if rests else "the angles in air"
    notes = [f"Tared by {by}: {sizes(coefficients[0])}."]
    if best == DRIFT:
        notes.append(f"A drift is taken off, linear between the rests: {sizes(coefficients[1])}.")
    if best == WEIGHT:
        amplitude = np.hypot(*coefficients[2:])
        notes.append(f"The leg's own weight is taken off, a sine of θ in air: {sizes(amplitude)}.")
    elif not weighed:
        notes.append("The leg's own weight is taken to be subtracted: too few angles in air.")
    return values - baseline, notes
