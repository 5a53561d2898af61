"""Whether the cases of a library can be simulated again to the last bit, and whether they are.

A simulation ends in the same bits wherever all is the same that its arithmetic rests on: the model
and its kernel, the compiler, NumPy, the C library and the processor. Each history says what it
rested on; here that is compared with what is at hand, and on request the case is made again.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from terraphi.experiment.documents import shipped_names
from terraphi.experiment.errors import InputError
from terraphi.forward import model_version, rests_on, simulate
from terraphi.library.plan import Plan, describe
from terraphi.library.store import Case, Library

WORDS = {
    "model_version": "model",
    "kernel_source": "source of the kernel",
    "processor_features": "features of the processor",
    "vector_lanes": "doubles in a vector",
    "libc": "C library",
    "numpy_instructions": "vector instructions of NumPy",
}
"""Readable names of recorded keys."""
_LONGEST = 24
_LONG_MINUTES = 1.5
"""Run time above which the time of a case is told before it is simulated again [s]."""


@dataclass(frozen=True)
class Rebuilt:
    """A case that was simulated again.

    Attributes
    ----------
    case
        Which one, for people.
    same_bits
        Whether its forces are the same to the last bit.
    largest_change
        Largest difference of a force over the largest force [-].
    differences
        What it rests on that differs from what it rested on, in words; empty if nothing does.
    """

    case: str
    same_bits: bool
    largest_change: float
    differences: tuple[str, ...]

    @property
    def sentence(self) -> str:
        """What came of it."""
        if self.same_bits:
            return f"{self.case}: simulated again, the same to the last bit."
        reason = "; ".join(self.differences) or "and nothing that it rests on: please report this"
        return (
            f"{self.case}: simulated again, forces differ by up to {self.largest_change:.1e} of "
            f"the largest ({reason})."
        )

    def as_dict(self) -> dict[str, Any]:
        """JSON-able."""
        return asdict(self)


def differences(case: Case) -> tuple[str, ...]:
    """What differs here from the machine and versions that made a case, in words; or empty.

    Parameters
    ----------
    case
        One that did not fail.
    """
    assert case.history is not None
    known = case.history.provenance
    there = {"model_version": known.get("model_version"), **known.get("rests_on", {})}
    here = {"model_version": model_version(case.scenario), **rests_on(case.scenario)}
    if "rests_on" not in known:
        return ("it was made before libraries recorded what their bits rest on",)
    return tuple(
        f"{WORDS.get(name, name)}: {_short(there.get(name))} there, {_short(value)} here"
        for name, value in here.items()
        if there.get(name) != value
    )


def account(library: Library, *, source: str = "FILE.nc") -> dict[str, Any]:
    """What a library's bits are and rest on, and whether they can be expected here.

    Parameters
    ----------
    library
        Any.
    source
        Name or file that it was loaded from, for the command that checks it.

    Returns
    -------
    dict
        ``digest`` of all cases of its plan, in order, without replicates and finer ones; ``cases``
        (case to its digest), ``rests_on`` (of the first case), ``expected`` (whether the same bits
        can be expected here), ``sentence``. JSON-able.
    """
    whole = [case for case in library.cases if case.history]
    different = tuple(dict.fromkeys(word for case in whole for word in differences(case)))
    first = whole[0].history.provenance if whole[0].history else {}
    return {
        "digest": hashlib.sha256("".join(c.digest for c in library.cases).encode()).hexdigest(),
        "cases": {describe(library.plan, case.scenario): case.digest for case in library.cases},
        "rests_on": {"machine": first.get("machine"), **first.get("rests_on", {})},
        "expected": not different,
        "sentence": _sentence(library, different, source),
    }


def rebuild(
    library: Library, number: int, *, progress: Callable[[float], None] | None = None
) -> Rebuilt:
    """Simulate a case of a library again and compare all bits.

    Parameters
    ----------
    library
        Any.
    number
        Which case, from 1 in the plan's order.
    progress
        Called now and then with the fraction done, 0 to 1.

    Raises
    ------
    InputError
        If there is no such case, or it failed when the library was built.
    """
    if not 1 <= number <= len(library.cases):
        raise InputError(
            f"library '{library.name}' has the cases 1 to {len(library.cases)}, not {number}"
        )
    case = library.cases[number - 1]
    name = f"case {number} ({describe(library.plan, case.scenario)})"
    if case.history is None:
        raise InputError(f"library '{library.name}': {name} failed: {case.failure}")
    again = Case(case.scenario, simulate(case.scenario, progress=progress), "")
    assert again.history is not None
    largest = float(np.abs(case.history.force).max()) or 1.0
    change = float(np.abs(again.history.force - case.history.force).max()) / largest
    return Rebuilt(name, again.digest == case.digest, change, differences(case))


def _sentence(library: Library, different: tuple[str, ...], source: str) -> str:
    """Whether the same bits can be expected of a build here, and how to check."""
    check = (
        f"'terraphi library show {source} --check' simulates a case again{_lasting(library)} and "
        "compares"
    )
    if different:
        why = "; ".join(different)
        return f"forces may come out otherwise in their last digits here ({why}); {check}"
    if library.name in shipped_names("plans", ".toml"):
        plan = Plan.load(library.name)
        if [s.hash for s in plan.cases()] == [c.scenario.hash for c in library.cases]:
            file = f"'terraphi library build {library.name} --out FILE.nc'"
            return f"{file} gives the same forces to the last bit here; {check}"
    return f"its plan gives the same forces to the last bit here; {check}"


def _lasting(library: Library) -> str:
    """How long the cases took, where that was long."""
    minutes = [
        case.history.provenance.get("seconds", {}).get("all", 0.0) / 60.0
        for case in library.cases
        if case.history is not None
    ]
    if max(minutes, default=0.0) < _LONG_MINUTES:
        return ""
    return f" (they took {min(minutes):.0f} to {max(minutes):.0f} minutes there)"


def _short(value: Any) -> str:
    """A value for a message; of a hash its beginning is enough."""
    text = "not recorded" if value is None else str(value)
    return text if len(text) <= _LONGEST else f"{text[:12]}..."
