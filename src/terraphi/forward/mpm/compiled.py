"""How kernels are compiled: one decorator, and a cache that never serves old code."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar, cast

import numba

Kernel = TypeVar("Kernel", bound=Callable[..., object])

_FOLDER = Path(__file__).parent
_SOURCES = [*sorted(_FOLDER.glob("*.py")), _FOLDER.parents[1] / "leg.py"]


def kernel(function: Kernel) -> Kernel:
    """Compile a scalar function with Numba, cached on disk.

    Sums may be reassociated and multiplications fused with additions, which doubles the speed of
    the transfers; the result is still bitwise the same from run to run on one machine, and values
    that are not numbers still spread, so that a breakdown is seen.

    Parameters
    ----------
    function
        A function of scalars, tuples and arrays.

    Returns
    -------
    callable
        The same function, compiled at its first call.
    """
    compiled = numba.njit(
        cache=True,
        error_model="numpy",
        fastmath={"contract", "nsz", "reassoc"},
        # A call that is not inlined would round differently in the process that compiles than in
        # one that loads the cache.
        forceinline=True,
    )(function)
    return cast(Kernel, compiled)


def _drop_stale_cache() -> None:
    """Remove cached machine code if any source of the kernels has changed since it was made.

    Numba looks only at the file of the outermost function, not at those of the functions that it
    has inlined; a change to the latter would silently be ignored. Only the cache beside the sources
    is looked after: an installed package, whose files change together, needs no more.
    """
    digest = hashlib.sha256(numba.__version__.encode())
    for source in _SOURCES:
        digest.update(source.read_bytes())
    cache = _FOLDER / "__pycache__"
    stamp = cache / "kernels.sha256"
    try:
        if stamp.is_file() and stamp.read_text() == digest.hexdigest():
            return
        for folder in {source.parent / "__pycache__" for source in _SOURCES}:
            for old in [*folder.glob("*.nbi"), *folder.glob("*.nbc")]:
                old.unlink(missing_ok=True)
        cache.mkdir(exist_ok=True)
        stamp.write_text(digest.hexdigest())
    except OSError:
        return


_drop_stale_cache()
