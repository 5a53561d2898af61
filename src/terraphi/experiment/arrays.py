"""The types of the arrays in this package, and the seed of random ones."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.errors import InputError

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]


def seed_from(seed: int, rng: Any) -> int:
    """Seed of draws, from ``seed`` or from ``rng`` as SPEC 7 has it.

    An integer ``rng`` is the seed. From a Generator, BitGenerator or SeedSequence one is drawn, so
    that a result can state it. Raises InputError if both are given or ``rng`` is something else.
    """
    if rng is None:
        return seed
    if seed:
        raise InputError("seed and rng are both given; leave out seed")
    if isinstance(rng, int | np.integer) and 0 <= rng < 2**32:
        return int(rng)
    try:
        return int(np.random.default_rng(rng).integers(2**32))
    except (TypeError, ValueError):
        raise InputError(f"rng = {rng!r}; give a seed or a numpy.random.Generator") from None
