"""Compilation of kernels: one decorator, and a cache that never serves old code.

Numba looks only at the file of the outermost function, not at those of the functions that it has
inlined; a change to the latter would silently be ignored. So machine code lies in a folder named
by a digest of all sources. A process that has read other sources than those of its digest, because
they changed while it started, keeps nothing.
"""

from __future__ import annotations

import hashlib
import inspect
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import DTypeLike, NDArray

from terraphi.experiment import leg
from terraphi.experiment.errors import needing

with needing("this simulation", "Numba", extra="simulate"):
    import numba
    import numba.extending

Kernel = TypeVar("Kernel", bound=Callable[..., object])

OPTIONS: dict[str, Any] = {
    "error_model": "numpy",
    "fastmath": {"contract", "nsz", "reassoc"},
    "no_cfunc_wrapper": True,  # for C, one more copy of each kernel to compile
    "nogil": True,
}
"""Numba's options for all kernels."""
_FOLDER = Path(__file__).parent
_EXPERIMENT, _PLANE = (_FOLDER.parent / name for name in ("experiment", "paper/plane"))
_INLINED = [_EXPERIMENT / f"{name}.py" for name in ("arrays", "leg", "units")]
_SOURCES = [*sorted(_FOLDER.rglob("*.py")), *sorted(_PLANE.glob("*.py")), *_INLINED]
"""Sources of the compiled functions, and of the functions and numbers that are inlined."""
_GIVEN = [_EXPERIMENT / f"{name}.py" for name in ("motion", "scenario", "soil")]
"""Sources of the numbers that the kernels are called with."""
_NAME = "terraphi-kernels-"
_UNUSED = 7 * 86400.0
"""Time after which machine code of other sources is removed [s]."""


def kernel(function: Kernel) -> Kernel:
    """Compile a function of scalars, tuples and arrays with Numba at its first call.

    Sums may be reassociated and multiplications fused with additions, which doubles the speed of
    the transfers; the result is still bitwise the same from run to run on one machine, and values
    that are not numbers still spread, so that a breakdown is seen. Multiply, and do not write
    ``x**2``: Numba compiles a power once a process, with the options of whoever asked first, so
    that all later kernels would round as that one does.
    """
    # A call that is not inlined would round differently in the process that compiles than in one
    # that loads the cache.
    return _compiled(function, forceinline=True)


def part(function: Kernel) -> Kernel:
    """Compile a function as a part of the one kernel that calls it, which takes half the time."""
    return _compiled(function, inline="always")


def entry(function: Kernel) -> Kernel:
    """Compile an outermost function, one that only Python calls; see :func:`kernel`.

    It is not inlined into the wrappers that Numba makes for its callers, which would compile it
    three times over and, since the wrappers know nothing of :func:`wide_vectors`, for narrow ones.
    """
    return _compiled(function)


def _compiled(function: Kernel, **options: Any) -> Kernel:
    place = PLACE if _read_at() == _READ_AT else None
    before = numba.config.CACHE_DIR  # type: ignore[attr-defined]  # Numba sets its options by name
    numba.config.CACHE_DIR = str(place or "")  # type: ignore[attr-defined]
    try:
        # Numba asks here, and not later, where the code is to be kept.
        made = numba.njit(**OPTIONS, **options, cache=place is not None)(function)
    finally:
        numba.config.CACHE_DIR = before  # type: ignore[attr-defined]
    return cast(Kernel, made)


def _wide_vectors(_context: Any) -> tuple[Any, Callable[..., Any]]:
    """Let the function that calls this use the widest vectors of the machine.

    LLVM uses but half of a 512-bit register on many processors, for fear of a lower clock: right
    for a few such instructions here and there, wrong for a function that does little else.
    """

    def mark(context: Any, builder: Any, _signature: Any, _arguments: Any) -> Any:
        # Straight into the set: its own `add` knows only attributes without a value.
        set.add(builder.function.attributes, '"prefer-vector-width"="512"')
        return context.get_dummy_value()

    return numba.types.void(), mark


wide_vectors = cast(Callable[[], None], numba.extending.intrinsic(_wide_vectors))


def aligned_zeros(count: int, dtype: DTypeLike = np.float64) -> NDArray[Any]:
    """Zeros that begin where a cache line does; vectors across two lines cost twice."""
    size = np.dtype(dtype).itemsize
    room = np.zeros(count + 64 // size, dtype)
    skip = -room.ctypes.data % 64 // size
    return room[skip : skip + count]


def _digest(sources: Iterable[Path]) -> str:
    digest = hashlib.sha256(numba.__version__.encode())
    for source in sources:
        digest.update(source.read_bytes())
    return digest.hexdigest()


def _read_at() -> list[int]:
    """When each source was last written [ns]."""
    return [source.stat().st_mtime_ns for source in _SOURCES]


def _is_as_written(module: ModuleType) -> bool:
    """True if the functions of a module are those of its file, which may have changed since."""
    file = Path(str(module.__file__))
    now = compile(file.read_text(encoding="utf-8"), str(file), "exec", dont_inherit=True)
    codes = [constant for constant in now.co_consts if isinstance(constant, CodeType)]
    functions = {name: f.__code__ for name, f in inspect.getmembers(module, inspect.isfunction)}
    return all(functions.get(code.co_name, code) == code for code in codes)


def _place_of_cache() -> Path | None:
    """Folder for machine code of these sources; None if none can be written.

    Where the user wants what Numba keeps, else next to the sources, else, where they are installed
    for all, in the user's own folder.
    """
    chosen = getattr(numba.config, "CACHE_DIR", "")
    # Path.home raises for users without one.
    user_cache = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))  # noqa: PTH111
    for parent in [Path(chosen)] if chosen else [_FOLDER / "__pycache__", user_cache / "terraphi"]:
        place = parent / (_NAME + _digest(_SOURCES)[:16])
        try:
            place.mkdir(parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=place).close()
            os.utime(place)  # it is used
        except OSError:
            continue
        for folder in parent.glob(_NAME + "*"):
            with suppress(OSError):  # another process may remove it, too
                if folder.stat().st_mtime < time.time() - _UNUSED:
                    shutil.rmtree(folder)
        return place
    return None


_READ_AT = _read_at()
# The one source that may have been read long before this.
PLACE = _place_of_cache() if _is_as_written(leg) else None
"""Folder in which machine code is kept; ``None`` for nowhere."""
SOURCE_DIGEST = _digest([*_SOURCES, *_GIVEN])
"""SHA-256 of the compiler's version and of all sources that bear on a result, hexadecimal."""
