"""What readings at points leave open where the model's forces ripple between them.

Nodes of the grid enter and leave the leg's contact one by one, so that simulated forces ripple by a
few per cent with a period near a degree. A record that is read every degree or so may show the
ripple's crests alone, or its troughs; and one that is read every few degrees knows nothing of the
path between. How far a sensor averages is not known, nor where crests would be on another grid. So
a library is compared through means about the readings (:meth:`ForceHistory.as_read_at`), and the
errors of that have a covariance, learnt from the library's own curves:

- of points beside means about them, with the readings moved along by fractions of their spacing;
- of means about the readings beside means of the whole path. What all curves share of it is in
  the library's curves too, since they are read alike; what one has beside its neighbours over φ is
  not.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from terraphi.history import ForceHistory
from terraphi.inference.residual import peak_to_peak
from terraphi.library import Library

FloatArray = NDArray[np.float64]

MOST_SHIFTS = 10
"""Shifts of the readings within their spacing that are tried at most."""
FEWEST_FOR_GROWTH = 3
"""Cases over phi from which on the size of errors may grow."""
WHITE = 0.5
"""Variance that is added at each window by itself, of that learnt [-]: a few dozen curves that
share one grid show fewer patterns than there are."""


class Reading(NamedTuple):
    """Covariance of what a record's readings leave open, over the friction angle."""

    moment: FloatArray
    """Of forces of unit peak-to-peak, where its size is 1 [-], shape [2 theta, 2 theta]."""
    log_size: FloatArray
    """Coefficients a, b of the log of its size, a + b φ [-]; φ in degrees."""

    def covariance(self, phi_deg: FloatArray, forces: FloatArray) -> FloatArray:
        """Covariance of the window means of a record [N²].

        Parameters
        ----------
        phi_deg
            Friction angles [deg], shape [k].
        forces
            Observation vectors there [N], shape [k, 2 theta].

        Returns
        -------
        ndarray
            Shape [k, 2 theta, 2 theta].
        """
        spans = np.ptp(forces.reshape(len(forces), 2, -1), axis=2)
        size = np.exp(0.5 * (self.log_size[0] + self.log_size[1] * phi_deg))
        each = np.repeat(size[:, None] * spans, forces.shape[1] // 2, axis=1)
        covariance: FloatArray = each[:, :, None] * self.moment * each[:, None, :]
        return covariance


def nothing_open(size: int) -> Reading:
    """Of a record that is known all along the path; ``size`` is 2 theta."""
    return Reading(np.zeros((size, size)), np.zeros(2))


def learn_reading(
    library: Library, leg: str, readings: FloatArray, *, path: bool = True
) -> Reading:
    """What readings leave open, from the library's own curves.

    Parameters
    ----------
    library
        Simulations over the friction angle.
    leg
        Shape of the leg.
    readings
        Leg angles of the record [rad], increasing, shape [sample].
    path
        Whether what is not known of the path between readings counts.

    Returns
    -------
    Reading
        Nothing for a record as dense as the library's bins.
    """
    chosen = sorted(
        (c for c in library.cases if c.history and c.scenario.leg.shape == leg),
        key=lambda case: case.scenario.soil.friction_angle_deg,
    )
    histories = [case.history for case in chosen if case.history is not None]
    size = histories[0].observation().vector.size
    if not _is_coarser(readings, histories[0].position):
        return nothing_open(size)
    found = []
    for history in histories:
        spans = peak_to_peak(history.observation().vector)
        each = np.repeat([spans["Fx"], spans["Fz"]], size // 2)
        found.append(np.stack(reading_errors(history, readings)) / each)
    about, around = np.stack(found, axis=1)
    # What a case has beside the mean of its neighbours has one and a half times the variance of its
    # own part: as much as it has beside a surrogate of such curves.
    beside = float(path) * (around[1:-1] - 0.5 * (around[:-2] + around[2:]))
    phi = np.array([case.scenario.soil.friction_angle_deg for case in chosen])[1:-1]
    about = about[1:-1]
    total = np.square(about).mean(axis=(1, 2)) + np.square(beside).mean(axis=(1, 2))
    # A slope needs more than a few cases; and a path that nothing touches has no error.
    degree = 1 if len(phi) >= FEWEST_FOR_GROWTH else 0
    a, b = np.polynomial.polynomial.polyfit(phi, np.log(np.maximum(total, 1e-30)), degree)[
        [0, degree]
    ]
    b *= degree
    root = np.exp(0.5 * (a + b * phi))[:, None, None]
    moment = _second_moment(about / root) + _second_moment(beside / root)
    return Reading(moment + WHITE * np.diag(np.diag(moment)), np.array([a, b]))


def reading_errors(history: ForceHistory, readings: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Errors of observation vectors from a curve's readings, moved along the path.

    Parameters
    ----------
    history
        A dense curve.
    readings
        Leg angles of a record [rad], increasing, shape [sample].

    Returns
    -------
    about
        Of points less means about them [N], shape [shift, 2 theta].
    around
        Of these less means of the whole path, same.
    """
    seen = readings[(readings >= history.position[0]) & (readings <= history.position[-1])]
    bin_ = float(np.median(np.diff(history.position)))
    spacing = float(np.median(np.diff(seen)))
    count = max(round(spacing / bin_), 1)
    # Whole bins, where there are any: what lies between them is interpolated, and smoother.
    shifts = np.unique(np.linspace(0.0, count, MOST_SHIFTS, endpoint=False).round()) * bin_
    # As far as the curve reaches: a shift back by the rest of the spacing meets the same phase.
    low, high = seen[0] - history.position[0], history.position[-1] - seen[-1]
    both_ways = np.where(shifts <= high + 1e-9, shifts, shifts - count * bin_)
    about, around = [], []
    for shift in both_ways[both_ways >= -low - 1e-9]:
        moved = replace(history, position=history.position - shift)
        force = [np.interp(seen, moved.position, column) for column in history.force.T]
        points = replace(history, position=seen, force=np.stack(force, axis=1))
        means = moved.as_read_at(seen).observation().vector
        about.append(points.observation().vector - means)
        around.append(means - moved.between(seen[0], seen[-1]).observation().vector)
    return np.stack(about), np.stack(around)


def _second_moment(errors: FloatArray) -> FloatArray:
    """Mean outer product, [..., 2 theta] -> [2 theta, 2 theta]."""
    rows = errors.reshape(-1, errors.shape[-1])
    moment: FloatArray = rows.T @ rows / len(rows)
    return moment


def _is_coarser(readings: FloatArray, position: FloatArray) -> bool:
    """Whether readings lie further apart than the samples of a curve."""
    own = float(np.median(np.diff(position)))
    return bool(np.diff(readings).max() > 1.5 * own)
