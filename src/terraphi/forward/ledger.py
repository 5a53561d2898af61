"""The momentum of the soil step by step: causes of its changes, and the unexplained remainder."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.forward.compiled import kernel

LEDGER_ROWS = ("gravity", "leg", "walls", "damping", "relief")
"""Causes of changes of the soil's momentum, in the order of the ledger's rows."""


class Audit(NamedTuple):
    """The soil's momentum: [kg m/s] in three dimensions, per metre of width in two."""

    ledger: FloatArray
    """Impulses so far (x, z), one row for each of :data:`LEDGER_ROWS`."""
    expected: FloatArray
    """Momentum (x, z) that the soil should have after the last step."""
    impulses: FloatArray
    """Impulses of the last step, rows as in the ledger."""
    worst: FloatArray
    """Largest mismatch of a step over the sum of its impulses' magnitudes [-], shape [1]."""


def empty_audit() -> Audit:
    """Audit before the first step."""
    rows = (len(LEDGER_ROWS), 2)
    return Audit(np.zeros(rows), np.zeros(2), np.zeros(rows), np.zeros(1))


def close_books(audit: Audit, impulses: FloatArray, momentum: tuple[float, float]) -> None:
    """Compare the momentum with that before the last step plus its impulses."""
    scale = np.abs(impulses).sum()
    if scale > 0.0:
        miss = abs(momentum[0] - audit.expected[0]) + abs(momentum[1] - audit.expected[1])
        audit.worst[0] = max(audit.worst[0], miss / scale)


def write_books(audit: Audit, impulses: FloatArray, momentum: tuple[float, float]) -> None:
    """Add a step's impulses to the ledger; ``momentum`` is that of the soil before the step."""
    for axis in range(2):
        audit.expected[axis] = momentum[axis] + impulses[:, axis].sum()
        for row in range(impulses.shape[0]):
            audit.ledger[row, axis] += impulses[row, axis]
            audit.impulses[row, axis] = impulses[row, axis]


def empty_reaction(bins: int) -> FloatArray:
    """Zero impulses of the soil on the leg, a row for each bin of a history, shape [bin, 4].

    In two dimensions the impulse (x, z) as the contact counts it, and as the soil received it
    [kg/s]; in three the impulse (x, z) [N s] and its moment about the hip [N m s], and nothing.
    """
    return np.zeros((bins, 4))


@kernel
def enter_reaction(
    impulse: FloatArray, bin_: int, first: tuple[float, float], second: tuple[float, float]
) -> None:
    """Add to a bin the reaction to what the leg gave the soil in a step: the negative of it."""
    impulse[bin_, 0] -= first[0]
    impulse[bin_, 1] -= first[1]
    impulse[bin_, 2] -= second[0]
    impulse[bin_, 3] -= second[1]
