"""Verification: problems with known answers, computed by the code that the leg uses.

Each family of problems is a module of its own (:mod:`~terraphi_studies.verification.check` says
what it is made of). ``docs/verification.md`` is written by this study.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from concurrent.futures import Executor
from contextlib import ExitStack
from pathlib import Path

from terraphi.experiment.errors import InputError, nearest
from terraphi.view.table import Table
from terraphi_studies import Study
from terraphi_studies.verification.check import Family
from terraphi_studies.verification.document import SHORT_HEADER, data_of, markdown, table
from terraphi_studies.verification.running import forget, run_tasks

FAMILIES = (
    "elements",
    "rest",
    "waves",
    "sliding",
    "limit_loads",
    "plate",
    "collapse",
    "conservation",
    "order",
    "kernels",
)
"""Modules of problems, in the order of the document."""


def run(
    *,
    only: str | None = None,
    quick: bool = False,
    out: Path | None = None,
    workers: int = 1,
    executor: Executor | None = None,
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
        Processes; 1 computes here. Ignored if there is an ``executor``.
    executor
        Runs the tasks.
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
    families = {name: _family(name) for name in _chosen(only)}
    tasks = {
        (name, task.name): task for name, family in families.items() for task in family.tasks(quick)
    }
    keep = None if out is None else out / "verification.tasks"
    with ExitStack() as stack:
        if executor is None and workers > 1:
            from terraphi.library.workers import WorkerPool

            executor = stack.enter_context(WorkerPool(workers)).executor
        try:
            done = run_tasks(tasks, keep=keep, executor=executor, progress=progress)
        except KeyboardInterrupt:
            if keep is None:
                raise
            raise InputError(
                f"{out}: interrupted; finished tasks are kept in {keep}, and the same command "
                "goes on from there"
            ) from None
    found = {
        name: {task: outcome for (family, task), outcome in done.items() if family == name}
        for name in families
    }
    figures = {
        name: family.figures(found[name]) if family.figures is not None else {}
        for name, family in families.items()
    }
    data = data_of(families, found, quick=quick)
    study = Study(
        table=Table(
            f"Verification: {data['passed']} checks pass, {data['missed']} miss",
            SHORT_HEADER,
            table(data),
        ),
        data=data,
        figures={key: figure for drawn in figures.values() for key, figure in drawn.items()},
        documents={
            "verification.md": markdown(families, data, {k: list(v) for k, v in figures.items()})
        },
    )
    if keep is not None:
        forget(tasks, keep)
    return study


def _chosen(only: str | None) -> tuple[str, ...]:
    if only is None:
        return FAMILIES
    if only not in FAMILIES:
        raise InputError(f"unknown family of problems '{only}'; {nearest(only, FAMILIES)}")
    return (only,)


def _family(name: str) -> Family:
    module = importlib.import_module(f"terraphi_studies.verification.{name}")
    family: Family = module.FAMILY
    return family
