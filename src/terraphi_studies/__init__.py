"""Studies: experiments that anyone can run again, each returning data, a table and figures."""

from __future__ import annotations

import importlib
import inspect
import itertools
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from terraphi.experiment.errors import InputError, nearest
from terraphi.experiment.outputs import check_folder, filling
from terraphi.view.table import Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure


Found = TypeVar("Found")
Progress = Callable[[float, float], None]
"""Called with the work done and the work of all."""


class Outline(NamedTuple):
    """What a study looks at, and how long that takes on one core, roughly."""

    what: str
    takes: str


STUDIES = {
    "measured": Outline(
        "friction angles of the measured sands, by every library, and the verdicts",
        "half a minute",
    ),
    "real_soil": Outline(
        "measured sands, each inverted with what the others taught",
        "a minute",
    ),
    "prediction": Outline(
        "calibrated on the straight leg: the C and the reversed C foretold", "seconds"
    ),
    "calibration": Outline(
        "intervals: how often they hold the truth, and how narrow they are", "1 to 2 minutes"
    ),
    "spacing": Outline(
        "records of few readings: how often their intervals hold the truth", "2 to 3 minutes"
    ),
    "design": Outline("libraries built evenly, and in the order that is suggested", "a minute"),
    "reading": Outline(
        "what the paper's text leaves open, against the forces that it prints", "seconds"
    ),
    "resolution": Outline(
        "from preset paper-1 to resolved, and whether that has arrived", "seconds"
    ),
    "onset": Outline("where the lift of a leg in space rises, and what moves that", "seconds"),
    "refinement": Outline(
        "what cells without size and no speed-up do to libraries, with their uncertainty",
        "a minute",
    ),
    "plates": Outline(
        "plates pressed into real sand: φ by each force law, and what the law is worth", "seconds"
    ),
    "verification": Outline(
        "problems with known answers, by the code that the leg uses", "60 to 120 minutes"
    ),
}

PAPER_LIBRARY = "paper"
"""Library by which the paper's own studies are repeated: the model of its text."""
PROTOTYPE_LIBRARY = "paper-code"
"""Library of the contact of the paper's public prototype, which its text does not describe."""

SIMULATING = ("build", "workers", "cluster")
"""Options of studies of planned cases."""

Beside = tuple[str, str, str]
"""A line of a table ``ours | paper``: what, ours, the paper's."""


@dataclass(frozen=True)
class Study:
    """What a study found.

    Attributes
    ----------
    table
        What it found, for people; its title is the study's.
    data
        Everything, JSON-able; its keys are fixed.
    figures
        Name to figure.
    documents
        File name to text.
    notes
        Sentences for people: what follows from the table.
    beside_paper
        A second table, ours beside the numbers that Xu & Wang print; ``data`` has it too, under
        the same name.
    dpi
        Resolution of the figures [1/in].
    name
        Of :data:`STUDIES`; :func:`run` writes it.
    """

    table: Table
    data: Mapping[str, Any]
    figures: Mapping[str, Figure] = field(default_factory=dict)
    documents: Mapping[str, str] = field(default_factory=dict)
    notes: Sequence[str] = ()
    beside_paper: Sequence[Beside] = ()
    dpi: int = 150
    name: str = ""

    def everything(self) -> dict[str, Any]:
        """The data with the study's name, its notes and tables, JSON-able."""
        names = ("what", "ours", "paper")
        beside = [dict(zip(names, line, strict=True)) for line in self.beside_paper]
        more = {
            "study": self.name,
            "about": STUDIES[self.name].what if self.name else "",
            "notes": list(self.notes),
            "beside_paper": beside,
            "table": {name: getattr(self.table, name) for name in ("title", "header", "rows")},
        }
        return {**self.data, **{key: value for key, value in more.items() if value}}

    def save(self, out: Path) -> tuple[str, ...]:
        """Write ``data.json``, documents and figures (PNG) into a folder, made if need be.

        Returns the names of the files.
        """
        from terraphi.view import plots

        data = json.dumps(self.everything(), indent=2, ensure_ascii=False)
        texts = {"data.json": data, **self.documents}
        with filling(
            out, kind=f"study {self.name}", last="data.json", besides=[kept_in(self.name)]
        ) as made:
            for name, text in texts.items():
                (made / name).write_text(text, encoding="utf-8")
            for name, figure in self.figures.items():
                plots.save(figure, made / f"{name}.png", dpi=self.dpi)
        return *texts, *(f"{name}.png" for name in self.figures)


def kept_in(name: str) -> str:
    """Name of the folder, beside a long study's results, of what is finished of it."""
    return f"{name}.tasks"


def page(
    name: str, table: Table, method: str, notes: Sequence[str], picture: str, figure: str = ""
) -> dict[str, str]:
    """A study's page in Markdown, by the name of its file.

    Parameters
    ----------
    name
        Of the page, and of the figure beside it if that has no other.
    table
        What the study found; its title is the heading.
    method, notes
        Paragraphs, and sentences.
    picture, figure
        What the figure shows in words, and its name.
    """
    parts = [
        f"# {table.title}",
        method,
        "\n".join(f"- {note}" for note in notes),
        table.markdown(),
        f"![{picture}]({figure or name}.png)",
    ]
    return {f"{name}.md": "\n\n".join(parts) + "\n"}


def capitalised(words: str) -> str:
    """Words with a capital in front, and nothing else changed."""
    return words[:1].upper() + words[1:]


def steps(total: int, progress: Progress | None) -> Callable[[Found], Found]:
    """A function that hands on what it is given, and reports one more of all steps as done."""
    done = itertools.count(1)

    def step(found: Found) -> Found:
        if progress is not None:
            progress(next(done), total)
        return found

    return step


def run(
    name: str,
    *,
    out: Path | None = None,
    progress: Progress | None = None,
    **options: Any,
) -> Study:
    """Run a study.

    Parameters
    ----------
    name
        One of :data:`STUDIES`.
    out, progress
        Folder of the results, where a long study keeps what is finished, and a function to be
        called with the work done and the work of all. Both are for studies that take them.
    **options
        Options of that study; those that are None are left to it.

    Raises
    ------
    InputError
        If there is no such study, the study has no such option, or the folder cannot be made.
    """
    if name not in STUDIES:
        raise InputError(f"unknown study '{name}'; {nearest(name, STUDIES)}")
    module = importlib.import_module(f"terraphi_studies.{name}")
    known = inspect.signature(module.run).parameters
    planned = "cases" in known
    given = {option: value for option, value in options.items() if value is not None}
    for option in given:
        if option not in known and not (planned and option in SIMULATING):
            raise InputError(f"study '{name}' has no option '{option}'; leave it out")
    if planned:
        from terraphi_studies.planned import Simulations

        given = {"cases": Simulations(**given, progress=progress)}
    services = {"out": out, "progress": progress}
    given |= {service: value for service, value in services.items() if service in known}
    if out is not None:
        check_folder(out, kind=f"study {name}", names=["data.json"], besides=[kept_in(name)])
    study: Study = module.run(**given)
    return replace(study, name=name)
