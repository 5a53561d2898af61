"""Studies: experiments that anyone can run again, each returning data, a table and figures."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from terraphi.errors import InputError, nearest

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from terraphi.build import Progress

STUDIES = {
    "benchmark": "three legs: our models beside the forces measured in Yuma sand",
    "recovery": "friction angles of fresh simulations, inferred with a library",
    "sensitivity": "what moves the simulated forces: one setting changed at a time",
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
    notes
        Sentences for people: what follows from the table.
    method
        How it was found, a paragraph.
    """

    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    data: Mapping[str, Any]
    figures: Mapping[str, Figure] = field(default_factory=dict)
    notes: Sequence[str] = ()
    method: str = ""

    def markdown(self) -> str:
        """All of it as a page in Markdown, with the first figure as a PNG beside it."""
        table = [self.header, ["---"] * len(self.header), *self.rows]
        parts = [
            f"# {self.title}",
            self.method,
            "\n".join(f"- {note}" for note in self.notes),
            "\n".join("| " + " | ".join(row) + " |" for row in table),
            "".join(f"![{figure}]({figure}.png)" for figure in list(self.figures)[:1]),
        ]
        return "\n\n".join(part for part in parts if part) + "\n"


def run(name: str, *, library: str | None = None, cases: Path | None = None) -> Study:
    """Run a study.

    Parameters
    ----------
    name
        One of :data:`STUDIES`.
    library
        Library to use instead of the study's own choice.
    cases
        Folder of simulations to use besides those that the package ships.

    Returns
    -------
    Study

    Raises
    ------
    InputError
        If there is no such study or library, or the study has no use for one of the two.
    """
    module = _module(name)
    options = {"library": library, "cases": cases}
    given = {option: value for option, value in options.items() if value is not None}
    for option in given:
        if option not in inspect.signature(module.run).parameters:
            use = {"library": "makes no use of a library", "cases": "simulates nothing of its own"}
            raise InputError(f"study '{name}' {use[option]}; leave that option out")
    study: Study = module.run(**given)
    return study


def outlook(name: str, cases: Path) -> str:
    """What :func:`simulate` would do, and for how long; arguments and errors as there."""
    found: str = _simulating(name).outlook(cases)
    return found


def simulate(
    name: str, cases: Path, *, executor: Executor | None = None, progress: Progress | None = None
) -> None:
    """Simulate what a study lacks.

    Parameters
    ----------
    name
        One of :data:`STUDIES`.
    cases
        Folder that keeps the simulations, a file each; what is in it is not simulated again.
    executor, progress
        As in :func:`terraphi.build.build`.

    Raises
    ------
    InputError
        If there is no such study, it simulates nothing, or the folder cannot be written.
    """
    _simulating(name).simulate(cases, executor=executor, progress=progress)


def _module(name: str) -> ModuleType:
    if name not in STUDIES:
        raise InputError(f"unknown study '{name}'; {nearest(name, STUDIES)}")
    return importlib.import_module(f"terraphi.studies.{name}")


def _simulating(name: str) -> ModuleType:
    module = _module(name)
    if not hasattr(module, "outlook"):
        raise InputError(f"study '{name}' simulates nothing of its own; leave --build out")
    return module
