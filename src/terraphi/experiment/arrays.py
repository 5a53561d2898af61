"""The types of the arrays in this package, the library of one, and the seed of random ones."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.errors import InputError, needing

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


def namespace(array: Any) -> Any:
    """Functions of the array-API standard for an array: NumPy, or its own library's.

    Raises
    ------
    InputError
        If its library does not follow the standard and array-api-compat, which wraps PyTorch and
        others, is not installed.
    """
    if isinstance(array, np.ndarray | float | int | list | tuple):
        return np
    if hasattr(array, "__array_namespace__"):
        return array.__array_namespace__()
    with needing(f"arrays of type {type(array).__name__}", "array-api-compat", extra="arrays"):
        from array_api_compat import array_namespace
    return array_namespace(array)


def like(reference: Any, values: Any) -> Any:
    """Numbers as an array of the library, type and device of another."""
    xp = namespace(reference)
    if xp is np:
        return np.asarray(values, dtype=reference.dtype)
    if isinstance(values, type(reference)):
        return xp.astype(values, reference.dtype)
    place = {} if (device := getattr(reference, "device", None)) is None else {"device": device}
    return xp.asarray(values, dtype=reference.dtype, **place)  # what JAX traces has no device


def whole(places: Any) -> Any:
    """Numbers cut to whole ones, as indices; in 32 bits, which JAX has too."""
    xp = namespace(places)
    return places.astype(np.int64) if xp is np else xp.astype(places, xp.int32)
