"""How kernels are compiled: one decorator, and a cache that never serves old code."""

from __future__ import annotations

import ast
import hashlib
import re
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
import numba.extending

Kernel = TypeVar("Kernel", bound=Callable[..., object])

_OPTIONS: dict[str, Any] = {
    "cache": True,
    "error_model": "numpy",
    "fastmath": {"contract", "nsz", "reassoc"},
}

_FOLDER = Path(__file__).parent
_NOT_OF_THE_MODEL = {"__init__.py", "breakdown.py", "checkpoint.py", "fields.py"}
_IN_PLANE = [*sorted(_FOLDER.glob("*.py")), _FOLDER.parents[1] / "experiment" / "leg.py"]
_SOURCES = [*_IN_PLANE, *sorted((_FOLDER.parent / "mpm3d").glob("*.py"))]


def kernel(function: Kernel) -> Kernel:
    """Compile a scalar function with Numba, cached on disk.

    Sums may be reassociated and multiplications fused with additions, which doubles the speed of
    the transfers; the result is still bitwise the same from run to run on one machine, and values
    that are not numbers still spread, so that a breakdown is seen. Multiply, and do not write
    ``x**2``: Numba compiles a power once a process, with the options of whoever asked first, so
    that all later kernels would round as that one does.

    Parameters
    ----------
    function
        A function of scalars, tuples and arrays.

    Returns
    -------
    callable
        The same function, compiled at its first call.
    """
    # A call that is not inlined would round differently in the process that compiles than in one
    # that loads the cache.
    return cast(Kernel, numba.njit(**_OPTIONS, forceinline=True)(function))


def entry(function: Kernel) -> Kernel:
    """Compile an outermost function, one that only Python calls; see :func:`kernel`.

    It is not inlined into the wrappers that Numba makes for its callers, which would compile it
    three times over and, since the wrappers know nothing of :func:`wide_vectors`, for narrow ones.

    Parameters
    ----------
    function
        A function of scalars, tuples and arrays.

    Returns
    -------
    callable
        The same function, compiled at its first call.
    """
    return cast(Kernel, numba.njit(**_OPTIONS)(function))


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


def register_use(function: Callable[..., object], *arguments: object) -> Counter[str]:
    """Count the arithmetic instructions on real numbers in a kernel, compiled anew for x86.

    Parameters
    ----------
    function
        A compiled function.
    *arguments
        What it is called with; it may change them.

    Returns
    -------
    Counter
        By register: ``zmm`` (512 bits), ``ymm`` (256), ``xmm`` (128), ``single`` (one number).
    """
    fresh = numba.njit(**{**_OPTIONS, "cache": False})(getattr(function, "py_func", function))
    fresh(*arguments)
    (code,) = fresh.inspect_asm().values()
    used: Counter[str] = Counter()
    for kind, operands in _ARITHMETIC.findall(code):
        register = next((name for name in ("zmm", "ymm") if name in operands), "xmm")
        used[register if kind == "p" else "single"] += 1
    return used


_ARITHMETIC = re.compile(
    r"^\s+v?(?:fn?m(?:add|sub)\d*|mul|add|sub|div|sqrt)([ps])[ds]\s(.*)$", re.M
)


def _digest_of_sources() -> str:
    digest = hashlib.sha256(numba.__version__.encode())
    for source in _SOURCES:
        digest.update(source.read_bytes())
    return digest.hexdigest()


def _code_of(source: Path) -> set[str]:
    """What a source does, statement by statement: without words about it, layout and imports."""
    tree = ast.parse(source.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            node.body = [part for part in body if not _is_silent(part)] or [ast.Pass()]  # type: ignore[attr-defined]
    return {ast.unparse(statement) for statement in tree.body}


def _is_silent(statement: ast.AST) -> bool:
    """Whether a statement is an import, a docstring, or a text below a value."""
    if isinstance(statement, ast.Import | ast.ImportFrom):
        return True
    return (
        isinstance(statement, ast.Expr)
        and isinstance(statement.value, ast.Constant)
        and isinstance(statement.value.value, str)
    )


def _digest_of_model(sources: Iterable[Path]) -> str:
    """Digest of what the sources do, however it is spread over files and wherever these lie."""
    codes: set[str] = set()
    for source in sources:
        if source.name not in _NOT_OF_THE_MODEL:
            codes |= _code_of(source)
    return hashlib.sha256("\n".join([numba.__version__, *sorted(codes)]).encode()).hexdigest()


SOURCE_DIGEST = _digest_of_model(_IN_PLANE)
"""SHA-256 of the compiler's version and of the code that bears on a result, hexadecimal.

Words about the code, and code that only keeps, shows or explains a result, do not count."""
SOURCE_DIGEST_IN_SPACE = _digest_of_model(_SOURCES)
"""The same with the code of three dimensions."""


def _cache_folders() -> list[Path]:
    """Where Numba keeps machine code of the sources; the first one also keeps their digest."""
    beside = dict.fromkeys(source.parent for source in _SOURCES)
    chosen = getattr(numba.config, "CACHE_DIR", "")  # Numba sets its options by name
    if not chosen:
        return [folder / "__pycache__" for folder in beside]
    # As Numba names them: by the folder of the source, and a hash of its path.
    return [
        Path(chosen) / f"{folder.name}_{hashlib.sha1(str(folder.absolute()).encode()).hexdigest()}"
        for folder in beside
    ]


def _drop_stale_cache() -> None:
    """Remove cached machine code if any source of the kernels has changed since it was made.

    Numba looks only at the file of the outermost function, not at those of the functions that it
    has inlined; a change to the latter would silently be ignored.
    """
    digest, folders = _digest_of_sources(), _cache_folders()
    stamp = folders[0] / "kernels.sha256"
    try:
        if stamp.is_file() and stamp.read_text() == digest:
            return
        for folder in folders:
            for old in [*folder.glob("*.nbi"), *folder.glob("*.nbc")]:
                old.unlink(missing_ok=True)
        folders[0].mkdir(parents=True, exist_ok=True)
        stamp.write_text(digest)
    except OSError:
        return


_drop_stale_cache()
