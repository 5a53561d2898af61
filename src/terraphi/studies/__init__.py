"""Studies: experiments that anyone can run again, each returning data, a table and figures."""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from terraphi.errors import InputError, nearest

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STUDIES = {
    "benchmark": "three legs: our models beside the forces measured in Yuma sand",
    "recovery": "friction angles of fresh simulations, inferred with a library",
}


@dataclass(frozen=True)
class Study:
    """What a study found.

    Attributes
    ----------
    title
        One line.
    header, rows
        A table for people.
    data
        Everything, JSON-able; its keys are fixed.
    figures
        Name to figure.
    """

    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    data: Mapping[str, Any]
    figures: Mapping[str, Figure] = field(default_factory=dict)


def run(name: str, *, library: str | None = None) -> Study:
    """Run a study.

    Parameters
    ----------
    name
        One of :data:`STUDIES`.
    library
        Library to use instead of the study's own choice.

    Returns
    -------
    Study

    Raises
    ------
    InputError
        If there is no such study or library.
    """
    if name not in STUDIES:
        raise InputError(f"unknown study '{name}'; {nearest(name, STUDIES)}")
    module = importlib.import_module(f"terraphi.studies.{name}")
    study: Study = module.run() if library is None else module.run(library=library)
    return study
