"""Verification: problems with known answers, computed by the code that the leg uses.

Each family of problems is a module of its own (:mod:`~terraphi_studies.verification.check` says
what it is made of). ``docs/verification.md`` is written by this study.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from terraphi.experiment.errors import InputError, nearest
from terraphi.library.workers import WorkerPool
from terraphi_studies import Study, kept_in
from terraphi_studies.verification.check import Family, Outcome
from terraphi_studies.verification.document import data_of, markdown, short_table
from terraphi_studies.verification.running import forget, run_tasks

FAMILIES = (
    "elements",
    "rest",
    "waves",
    "sliding",
    "limit_loads",
    "published",
    "plate",
    "collapse",
    "conservation",
    "order",
    "kernels",
    "space",
    "round_footings",
)
"""Modules of problems, in the order of the document."""


def run(
    *,
    only: str | None = None,
    quick: bool = False,
    out: Path | None = None,
    workers: int = 1,
    progress: Callable[[float, float], None] | None = None,
) -> Study:
    """Compute all problems, or one family of them.

    Parameters
    ----------
    only
        One of :data:`FAMILIES`; all of them if not given.
    quick
        Coarse beds and few steps: seconds, for tests. The document has the full ones.
    out
        Folder in which finished tasks are kept while the study is under way: the same call goes on
        from there after an interruption.
    workers
        Processes; 1 computes here.
    progress
        Called with the work done and the work of all, in seconds by estimate.

    Returns
    -------
    Study
        ``data``: by family, its ``checks``, its ``curves`` by task; ``passed``, ``missed``.
        ``documents``: ``verification.md``.

    Raises
    ------
    InputError
        If there is no such family, or the run was interrupted and goes on from ``out``.
    SimulationError
        If a solution breaks down.
    """
    if only is not None and only not in FAMILIES:
        raise InputError(f"unknown family of problems '{only}'; {nearest(only, FAMILIES)}")
    families = {name: family_of(name) for name in ((only,) if only else FAMILIES)}
    tasks = {
        (name, task.name): task
        for name, family in families.items()
        for task in (family.quick if quick else family.full)
    }
    keep = None if out is None else out / kept_in("verification")
    with ExitStack() as stack:
        executor = stack.enter_context(WorkerPool(workers)).executor if workers > 1 else None
        try:
            done = run_tasks(tasks, keep=keep, executor=executor, progress=progress)
        except KeyboardInterrupt:
            if keep is None:
                raise
            raise InputError(
                f"{out}: interrupted; finished tasks are kept in {keep}, and the same command "
                "goes on from there"
            ) from None
    found: dict[str, dict[str, Outcome]] = {name: {} for name in families}
    for (name, task), outcome in done.items():
        found[name][task] = outcome
    figures = {name: family.figures(found[name]) for name, family in families.items()}
    data = data_of(found, quick=quick)
    study = Study(
        table=short_table(data),
        data=data,
        figures={key: figure for drawn in figures.values() for key, figure in drawn.items()},
        documents={
            "verification.md": markdown(families, data, {k: list(v) for k, v in figures.items()})
        },
    )
    if keep is not None:
        forget(tasks, keep)
    return study


def family_of(name: str) -> Family:
    """The family of a module of problems."""
    family: Family = importlib.import_module(f"terraphi_studies.verification.{name}").FAMILY
    return family
