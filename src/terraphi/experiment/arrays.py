"""The types of the arrays in this package, and the check of numbers from outside."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.errors import InputError, needing

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]
HUGE = 1e9
"""Largest number without a narrower range, as a place [m] or a speed [m/s]; chosen, so that a
product of four is finite in single precision."""

MOST_SEED = 2**32 - 1
"""Largest seed."""


def count(name: str, value: Any, low: int, high: int) -> int:
    """A whole number between two ends; raises InputError."""
    is_whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not is_whole or not low <= int(value) <= high:
        raise InputError(f"{name} = {value!r:.60}; {low} to {high} are accepted")
    return int(value)


def generator(rng: Any) -> np.random.Generator:
    """Generator of random numbers, from one or from a seed; raises InputError."""
    try:
        return np.random.default_rng(rng)
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
    if type(array) is np.ndarray or isinstance(array, np.ndarray | float | int | list | tuple):
        return np
    if hasattr(array, "__array_namespace__"):
        return array.__array_namespace__()
    if not hasattr(array, "__dlpack__"):  # no array, or one that NumPy knows
        return np
    with needing(f"arrays of type {type(array).__name__}", "array-api-compat", extra="arrays"):
        from array_api_compat import array_namespace
    return array_namespace(array)


def numbers(
    name: str, values: Any, reference: Any = None, *, shape: tuple[int, ...] | None = None,
    last: tuple[int, ...] = (), low: float = -HUGE, high: float = HUGE, unit: str = "",
) -> Any:  # fmt: skip
    """Check the numbers of an argument, and make them an array.

    Parameters
    ----------
    name
        Of the argument, for messages.
    values
        A number, a sequence, or an array of NumPy or of another library of the array-API standard.
    reference
        Array whose library, type and device the result has; by default those of ``values``, with
        64 bits in NumPy.
    shape
        Shape that they are broadcast to.
    last
        Accepted lengths of the last axis.
    low, high, unit
        Least and largest value, and their unit. An array that JAX or PyTorch traces has no values
        yet, so that they are not checked.

    Raises
    ------
    InputError
        If they are not real numbers, not finite, out of range or of another shape.
    """
    plain = type(values) in (float, int)
    xp = np if plain else namespace(values)
    try:
        array = np.asarray(values) if xp is np else values
    except ValueError:
        raise InputError(f"{name}: its rows differ in length; give an array of numbers") from None
    floating = xp.float64 if xp is np else array.dtype
    real = array.dtype.kind in "iuf" if xp is np else xp.isdtype(array.dtype, "real floating")
    if not real and (xp is np or reference is None or not xp.isdtype(array.dtype, "integral")):
        kind = type(values).__name__ if array.ndim == 0 else f"an array of {array.dtype}"
        raise InputError(f"{name} is {kind}; give real numbers")
    if last and (array.ndim == 0 or array.shape[-1] not in last):
        lengths = " or ".join(map(str, last))
        raise InputError(f"{name} of shape {tuple(array.shape)}: the last axis is {lengths}")
    if not (low <= values <= high if plain else _inside(xp, array, low, high)):
        ends = f"{low:g} to {high:g} {unit}".rstrip()
        raise InputError(f"{_outlier(xp, name, array, low, high)}: {ends} are accepted")
    if reference is not None:
        array = like(reference, array)
        xp = namespace(reference)
    elif xp is np:
        array = np.asarray(array, dtype=floating)
    if shape is None or tuple(array.shape) == shape:
        return array
    try:
        return xp.broadcast_to(array, shape)
    except (ValueError, RuntimeError) as error:
        raise InputError(f"{name} of shape {tuple(array.shape)}: expected {shape}") from error


def _inside(xp: Any, array: Any, low: float, high: float) -> bool:
    """True if all numbers are between two ends, or not known yet."""
    if xp is np:  # a minimum of NaN is NaN
        return not array.size or bool(low <= array.min() and array.max() <= high)
    try:
        return bool(xp.all((array >= low) & (array <= high)))
    except (TypeError, RuntimeError):
        return True


def _outlier(xp: Any, name: str, array: Any, low: float, high: float) -> str:
    """First number out of range, with its place."""
    if xp is not np:
        return f"{name} = {float(xp.min(array)):g} to {float(xp.max(array)):g}"
    place = np.argwhere(~((array >= low) & (array <= high)))[0].tolist()
    return f"{name}{place if place else ''} = {array[tuple(place)]:g}"


def like(reference: Any, values: Any) -> Any:
    """Numbers as an array of the library, type and device of another."""
    xp = namespace(reference)
    if xp is np:
        return np.asarray(values, dtype=reference.dtype)
    if isinstance(values, type(reference)):
        return xp.astype(values, reference.dtype)
    place = {} if (device := getattr(reference, "device", None)) is None else {"device": device}
    return xp.asarray(values, dtype=reference.dtype, **place)  # what JAX traces has no device


def between_rows(table: FloatArray, *places: Any, axis: int = 0) -> Any:
    """Rows of a table at places on its axes from one on [node]; arrays of one shape and library.

    Linear between nodes; beyond the first and the last as between the two that are next.
    """
    # The 2ᵏ corners of the cell that each place lies in, by their rows in the flat table; then one
    # axis after the other, the last first, a + s (b − a) between the ends of that axis. A share s
    # beyond 0 to 1 continues the table.
    xp, end = namespace(places[0]), axis + len(places)
    tail = table.shape[end:]
    rows = like(places[0], table.reshape(*table.shape[:axis], -1, *tail))
    shares, steps, first = [], [0], 0
    for place, count in zip(places, table.shape[axis:end], strict=True):
        low = xp.clip(place, 0, count - 2)
        low = low.astype(np.int64) if xp is np else xp.astype(low, xp.int32)  # which JAX has too
        share = place - like(place, low)
        shares.append(xp.reshape(share, (*share.shape, *(1 for _ in tail))))
        first, steps = first * count + low, [count * at + k for at in steps for k in (0, 1)]
    corners = [xp.take(rows, first + at, axis=axis) for at in steps]
    for share in reversed(shares):
        pairs = zip(corners[::2], corners[1::2], strict=True)
        corners = [low + share * (high - low) for low, high in pairs]
    return corners[0]


def block_means(values: FloatArray, first: IntArray) -> FloatArray:
    """Means over the rows from each first one to the next, shape [block, ...]."""
    count = np.diff(np.append(first, len(values)))
    return np.asarray((np.add.reduceat(values, first).T / count).T)
