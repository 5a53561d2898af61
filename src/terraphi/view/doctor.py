"""Is this installation sound? Versions, processor, the cache of compiled kernels, shipped files."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

from packaging.requirements import Requirement

from terraphi.experiment import measurements
from terraphi.experiment.documents import shipped_names
from terraphi.experiment.errors import InputError
from terraphi.experiment.scenario import Scenario
from terraphi.forward.forecast import SLOWER, is_compiled, place_of_code
from terraphi.library.plan import Plan
from terraphi.library.store import Library

State = Literal["ok", "note", "problem"]


@dataclass(frozen=True)
class Check:
    """The result of one check.

    Attributes
    ----------
    name
        What.
    state
        ``ok``; ``note``: works, and could be better; ``problem``: something will fail.
    found
        In words.
    """

    name: str
    state: State
    found: str


def examine() -> list[Check]:
    """Check Python, packages, processor, kernels and shipped files.

    Returns
    -------
    list of Check
        In the order of the things that rest on each other.
    """
    return [*_software(), *_machine(), *_kernels(), *_shipped()]


def sound(checks: Sequence[Check]) -> bool:
    """Whether none of the checks found a problem."""
    return all(check.state != "problem" for check in checks)


def as_dict(checks: Sequence[Check]) -> dict[str, Any]:
    """All checks, JSON-able."""
    return {"sound": sound(checks), "checks": [asdict(check) for check in checks]}


# -- what is looked at ---------------------------------------------------------------------------


def _software() -> Iterator[Check]:
    try:
        own, wanted = (
            importlib.metadata.version("terraphi"),
            importlib.metadata.requires("terraphi"),
        )
    except importlib.metadata.PackageNotFoundError:
        yield Check("terraphi", "problem", "not installed; run: pip install .")
        return
    yield Check("terraphi", "ok", own)
    yield Check("Python", "ok", f"{platform.python_version()}, {sys.executable}")
    lacking: dict[str, list[str]] = {}
    for requirement in map(Requirement, wanted or []):
        extra = _extra(requirement)
        if extra is None:
            yield _package(requirement)
        elif extra not in {"dev", "docs"} and _package(requirement).state != "ok":
            lacking.setdefault(extra, []).append(requirement.name)
    for extra, names in lacking.items():
        found = f"lacks {', '.join(names)}; if you need it: pip install 'terraphi[{extra}]'"
        yield Check(f"extra '{extra}'", "note", found)


def _extra(requirement: Requirement) -> str | None:
    """Name of the extra that installs a package; None if terraphi always needs it."""
    if requirement.marker is None or requirement.marker.evaluate({"extra": ""}):
        return None
    extras = importlib.metadata.metadata("terraphi").get_all("Provides-Extra") or []
    # A package of no extra is one for another system.
    return next((e for e in extras if requirement.marker.evaluate({"extra": e})), "dev")


def _package(requirement: Requirement) -> Check:
    name = requirement.name
    try:
        version = importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return Check(name, "problem", f"missing; run: pip install '{name}{requirement.specifier}'")
    if not requirement.specifier.contains(version, prereleases=True):
        return Check(name, "problem", f"{version}, but {requirement.specifier} is needed")
    return Check(name, "ok", version)


def _machine() -> Iterator[Check]:
    cores = os.cpu_count() or 1
    allowed = getattr(os, "sched_getaffinity", lambda _process: range(cores))(0)
    yield Check("cores", "ok", f"{len(allowed)} of {cores} may be used")


def _kernels() -> Iterator[Check]:
    """Whether the kernels load, how wide their vectors are, and whether they are compiled."""
    try:
        from terraphi.forward.checkpoint import rests_on
        from terraphi.forward.plane.packing import register_bits
    except Exception as error:  # whatever the compiler says, and it says it in many ways
        yield Check("kernels", "problem", f"cannot be loaded: {error}")
        return
    known = rests_on("packets")
    yield Check("processor", "ok", f"{known['processor']} ({platform.machine()})")
    yield _vectors(register_bits())
    place, _ = place_of_code()
    if place is None:
        found = (
            "no folder for it can be written: kernels are compiled at every start; set "
            "NUMBA_CACHE_DIR"
        )
        yield Check("cache", "note", found)
    elif is_compiled():
        yield Check("cache", "ok", f"kernels are compiled, in {place}")
    else:
        found = f"empty, in {place}: the first simulation compiles its kernels, once"
        yield Check("cache", "note", found)


def _vectors(bits: int) -> Check:
    """How wide the vectors are that simulations use, and what that costs."""
    found = f"{bits} bits, {bits // 64} doubles at a time"
    if bits == max(SLOWER):
        return Check("vectors", "ok", found)
    lacks = "AVX-512" if bits == 256 else "AVX2"
    found += f": without {lacks} simulations take about {SLOWER[bits]:.1f} times as long"
    return Check("vectors", "note", found)


def _shipped() -> Iterator[Check]:
    yield _all_load("measurements", measurements.names(), measurements.measurement)
    yield _all_load("scenarios", shipped_names("scenarios", ".toml"), Scenario.load)
    yield _all_load("plans", shipped_names("plans", ".toml"), Plan.load)
    names = shipped_names("libraries", ".nc")
    if not names:
        yield Check("libraries", "problem", "none is there; install terraphi again")
    for name in names:
        yield _library(name)


def _library(name: str) -> Check:
    what = f"library {name}"
    try:
        found = Library.load(name)
    except InputError as error:
        return Check(what, "problem", str(error))
    whole = len(found.cases) - len(found.failures)
    return Check(what, "ok", f"{whole} of {len(found.cases)} cases, legs {', '.join(found.legs)}")


def _all_load(what: str, names: Sequence[str], load: Callable[[str], object]) -> Check:
    """Whether all shipped files of a kind can be read."""
    if not names:
        return Check(what, "problem", "none is there; install terraphi again")
    for name in names:
        try:
            load(name)
        except InputError as error:
            return Check(what, "problem", f"{name}: {error}")
    return Check(what, "ok", f"{len(names)} load")
