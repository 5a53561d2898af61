"""What an inversion says besides its numbers: a verdict and doubts, as codes with numbers.

Their sentences are in `words`, and nowhere else.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

Side = Literal["low", "high"]


@dataclass(frozen=True)
class Doubt:
    """Why an answer may not be what was asked for.

    Attributes
    ----------
    code
        A key of `words.DOUBTS`.
    numbers
        What its sentence needs.
    source
        The history that it is about, where there are several; empty: the only one, or all.
    """

    code: str
    numbers: Mapping[str, Any] = field(default_factory=dict)
    source: str = ""


@dataclass(frozen=True)
class Measure:
    """A number that a verdict rests on, and how large or small it may be.

    Attributes
    ----------
    code
        A key of `words.MEASURES`.
    value
        The number [-].
    most, least
        Its limits; ``None`` if it has none.
    about
        What it is a number of: a force, an edge, a parameter.
    source
        The history, where there are several.
    """

    code: str
    value: float
    most: float | None = None
    least: float | None = None
    about: str = ""
    source: str = ""

    @property
    def exceeded(self) -> bool:
        """Whether it is beyond a limit."""
        above = self.most is not None and self.value > self.most
        return above or (self.least is not None and self.value < self.least)

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers and words."""
        return dict(vars(self))


@dataclass(frozen=True)
class Verdict:
    """What the numbers allow to say of an inversion.

    Attributes
    ----------
    verdict
        ``"consistent"``, ``"misfit"`` (nothing in the library reproduces the forces) or
        ``"out_of_range"`` (an edge cuts the posterior off, and more than a misfit would do by
        itself).
    edge
        Which edge cuts it off; None unless out of range.
    code
        Which case of these it is: a key of `words.VERDICTS`.
    numbers
        What its sentence needs.
    measures
        The numbers that it rests on.
    """

    verdict: Literal["consistent", "misfit", "out_of_range"]
    edge: Side | None
    code: str
    numbers: Mapping[str, Any] = field(default_factory=dict)
    measures: tuple[Measure, ...] = ()

    @property
    def reason(self) -> str:
        """The verdict as a sentence."""
        from terraphi.inference.words import of_verdict

        return of_verdict(self)
