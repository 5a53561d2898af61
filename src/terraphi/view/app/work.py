"""The process that reads a dropped file and writes a page, or the reason for refusing it.

``python -m terraphi.view.app.work FOLDER`` reads ``job.json`` and the file that it names, and
writes ``page.html`` or ``refused.txt``.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from terraphi.experiment.errors import InputError
from terraphi.experiment.force_table import CSV_COLUMNS, column_names
from terraphi.view.report.parts import Section

JOB, PAGE, REFUSED = "job.json", "page.html", "refused.txt"
MOST_MEMORY = 6 << 30
"""Address space of the process [byte]."""
MOST_FILE = 500 << 20
"""Largest file that it may write [byte]."""
MOST_SECONDS = 600
"""Processor time [s], of several threads: more than the page waits for."""


def work(folder: Path) -> None:
    """Read the dropped file of a job and write its page.

    Parameters
    ----------
    folder
        Where the job lies and its result goes.
    """
    job = json.loads((folder / JOB).read_text(encoding="utf-8"))
    file = folder / str(job["file"])
    try:
        from terraphi.view.report.page import write

        write([section_of(file, folder, job)], folder / PAGE)
    except InputError as error:
        (folder / REFUSED).write_text(named(str(error), file, job["name"]), encoding="utf-8")
    except MemoryError:
        sentence = f"{job['name']}: needs more memory than is allowed here"
        (folder / REFUSED).write_text(sentence, encoding="utf-8")


def named(sentence: str, file: Path, name: str) -> str:
    """Put the file's own name into an error message, in place of that of the temporary file."""
    ours = "|".join(re.escape(text) for text in (str(file), file.name, f"{file.parent}{os.sep}"))
    found = re.sub(ours, lambda match: name if match[0].endswith(file.name) else "", sentence)
    return found if name in found else f"{name}: {found}"


def section_of(file: Path, folder: Path, job: Mapping[str, Any]) -> Section:
    """Section of the page for a dropped file; raises InputError if it cannot be used."""
    if job["kind"] == "log" or (job["kind"] == "auto" and not has_forces(file)):
        from terraphi.view.report import robot

        found = robot.section(file)
    else:
        found = _inverted(file, folder, job)
    known = {**found.provenance, "result": job["name"]}
    return replace(found, title=str(job["name"]), provenance=known)


def has_forces(file: Path) -> bool:
    """Whether a file's first line looks like that of measured forces rather than of a log."""
    if file.suffix != ".csv":
        return False
    names = column_names(file)
    return len(names) <= len(CSV_COLUMNS) + 1 or any(name in CSV_COLUMNS for name in names)


def _inverted(file: Path, folder: Path, job: Mapping[str, Any]) -> Section:
    from terraphi.experiment.measurements import open_forces
    from terraphi.inference.inversion import invert
    from terraphi.inference.trials import Trial
    from terraphi.library.store import Library
    from terraphi.view.report import inversion

    trial = Trial.of(open_forces(str(file)), str(job["leg"]))
    library = str(job["library"])
    found = invert(
        replace(trial, source=str(job["name"])),
        library=None if library == "auto" else Library.load(library),
        density=job["density"],
        noise=job["noise"],
    )
    found.to_netcdf(folder / "posterior.nc")
    return inversion.section(folder / "posterior.nc")


def bounded() -> None:
    """Limit memory, time and open files of this process, as far as the system can."""
    with contextlib.suppress(ImportError, OSError, ValueError):
        import resource

        for what, most in (
            (resource.RLIMIT_AS, MOST_MEMORY),
            (resource.RLIMIT_FSIZE, MOST_FILE),
            (resource.RLIMIT_CPU, MOST_SECONDS),
            (resource.RLIMIT_CORE, 0),
        ):
            resource.setrlimit(what, (most, most))


if __name__ == "__main__":
    bounded()
    work(Path(sys.argv[1]))
