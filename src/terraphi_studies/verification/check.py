"""What a verification is made of: checks, the tasks that make them, and families of problems.

A module of problems defines ``FAMILY``, a :class:`Family`, and is entered in
:data:`terraphi_studies.verification.FAMILIES`. Its tasks are independent of each other and made of
what travels between processes: a function at module level and JSON-able arguments.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, kw_only=True)
class Check:
    """One number that is known, beside the one that the program gives.

    Attributes
    ----------
    problem
        What is computed, a few words.
    case
        Which variant of the problem.
    quantity
        What is compared, with its unit in brackets unless it has none.
    expected, obtained
        The known and the computed value; an ``obtained`` that is not finite misses.
    tolerance
        Largest deviation allowed.
    relative
        Whether deviation and tolerance are relative to ``expected``.
    sense
        ``equal``; ``at_most`` or ``at_least``: a deviation to the other side does no harm.
    resolution
        Grid, particles and time step, in words.
    source
        Formula or reference of the expected value.
    note
        What a reader should know besides.
    cause
        Why it misses, if it does; printed in the verdict of a miss alone.
    settings
        Which numerics, where a problem is solved with several: ``preset`` for those of preset
        ``resolved``, else a name.
    """

    problem: str
    case: str
    quantity: str
    expected: float
    obtained: float
    tolerance: float
    relative: bool = True
    sense: Literal["equal", "at_most", "at_least"] = "equal"
    resolution: str = ""
    source: str = ""
    note: str = ""
    cause: str = ""
    settings: str = ""
    per_degree: float = 0.0

    @property
    def deviation(self) -> float:
        """Obtained less expected, relative to the latter if so compared; nan if not finite."""
        difference = self.obtained - self.expected
        if not math.isfinite(difference):
            return math.nan
        return difference / abs(self.expected) if self.relative else difference

    @property
    def deviation_deg(self) -> float:
        """By how much φ would have to differ for the force obtained [deg]; nan if no such force."""
        ratio = self.obtained / self.expected if self.per_degree else math.nan
        return math.log(ratio) / self.per_degree if ratio > 0.0 else math.nan

    @property
    def passed(self) -> bool:
        """Whether the deviation is within the tolerance."""
        too_low = self.sense != "at_most" and not self.deviation >= -self.tolerance
        too_high = self.sense != "at_least" and not self.deviation <= self.tolerance
        return not (too_low or too_high)

    def as_dict(self) -> dict[str, Any]:
        """Fields, deviation and verdict, JSON-able: a number that is none becomes null.

        ``deviation_percent`` is null where deviations are not relative, ``deviation_deg`` where
        the expected value is no force that rises with φ.
        """
        content = dataclasses.asdict(self)
        content |= {
            "deviation": self.deviation,
            "deviation_percent": 100.0 * self.deviation if self.relative else math.nan,
            "deviation_deg": self.deviation_deg,
            "passed": self.passed,
        }
        return {
            key: None if isinstance(value, float) and not math.isfinite(value) else value
            for key, value in content.items()
        }

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> Check:
        """Check that :meth:`as_dict` wrote."""
        names = {entry.name for entry in dataclasses.fields(cls)}
        known = {key: value for key, value in content.items() if key in names}
        obtained = known["obtained"]
        return cls(**{**known, "obtained": math.nan if obtained is None else float(obtained)})


@dataclass(frozen=True)
class Outcome:
    """What a task found.

    Attributes
    ----------
    checks
        Its checks.
    curves
        Whatever the family's figures are drawn from, JSON-able.
    """

    checks: Sequence[Check]
    curves: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Task:
    """Work that can be done anywhere and in any order.

    Attributes
    ----------
    name
        Unlike any other of the family.
    function
        At module level; takes ``arguments`` by keyword. A long one calls
        ``terraphi.library.workers.heartbeat(0.0)`` now and then, so that it can be stopped.
    arguments
        JSON-able.
    cost
        Rough time on one core [s], for the progress display.
    """

    name: str
    function: Callable[..., Outcome]
    arguments: Mapping[str, Any] = field(default_factory=dict)
    cost: float = 1.0


@dataclass(frozen=True)
class Family:
    """Problems that belong together: one section of the document.

    Attributes
    ----------
    title
        Heading.
    meaning
        One or two sentences: what it means if these pass.
    full, quick
        The tasks, and those of a tier of seconds, for tests.
    figures
        From task name to outcome, to file name (without suffix) to figure.
    """

    title: str
    meaning: str
    full: Sequence[Task]
    quick: Sequence[Task]
    figures: Callable[[Mapping[str, Outcome]], Mapping[str, Figure]] = lambda _: {}


def numbered(
    name: str,
    function: Callable[..., Outcome],
    runs: Iterable[Mapping[str, Any]],
    cost: float = 1.0,
) -> list[Task]:
    """A task of a function for each of some arguments, named by their number."""
    return [Task(f"{name}-{n}", function, run, cost) for n, run in enumerate(runs)]
