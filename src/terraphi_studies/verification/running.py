"""Tasks of a verification on an executor; what is finished is kept until all of it is.

A kept outcome is used again only by the same task of the same code: its file is named by the
task and a hash of its arguments and of the sources that bear on the numbers.
"""

from __future__ import annotations

import hashlib
import json
import logging
from collections.abc import Iterator, Mapping
from concurrent.futures import BrokenExecutor, Executor
from pathlib import Path
from typing import Any

import numba
import numpy as np

from terraphi.experiment.errors import InputError
from terraphi.experiment.files import made_folder, replacing
from terraphi.library.workers import as_they_end
from terraphi_studies import Progress
from terraphi_studies.verification.check import Check, Outcome, Task

log = logging.getLogger(__name__)

Key = tuple[str, str]
"""Names of family and task."""

_PACKAGE = Path(__file__).parents[2]
_SOURCES = (
    *("terraphi/experiment/*.py", "terraphi/forward/plane/*.py", "terraphi/forward/mpm/*.py"),
    *("terraphi/forward/__init__.py", "terraphi/library/plan.py"),
    *("terraphi/data/scenarios/*.toml", "terraphi/data/plans/*.toml"),
    "terraphi_studies/verification/*.py",
)


def run_tasks(
    tasks: Mapping[Key, Task],
    *,
    keep: Path | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> dict[Key, Outcome]:
    """Do what has not been done yet.

    Parameters
    ----------
    tasks
        Tasks by names of family and task.
    keep
        Folder that keeps finished outcomes; made if need be.
    executor
        Runs the tasks; ``None`` runs them here, one after another.
    progress
        Called with the cost done and the cost of all.

    Returns
    -------
    dict
        Outcomes in the order of the tasks.

    Raises
    ------
    InputError
        If the folder cannot be made or a worker was killed.
    """
    files = _files(tasks, keep)
    found = {key: outcome for key, file in files.items() if (outcome := _read(file)) is not None}
    log.info("%d of %d tasks are done already", len(found), len(tasks))
    total = sum(task.cost for task in tasks.values())

    def tell() -> None:
        if progress is not None:
            progress(sum(tasks[key].cost for key in found), total)

    tell()
    missing = {key: task for key, task in tasks.items() if key not in found}
    for key, outcome in _here(missing) if executor is None else _on(executor, missing):
        found[key] = outcome
        if key in files:
            with replacing(files[key]) as temporary:
                temporary.write_text(json.dumps(_as_dict(outcome)))
        tell()
    return {key: found[key] for key in tasks}


def _here(tasks: Mapping[Key, Task]) -> Iterator[tuple[Key, Outcome]]:
    for key, task in tasks.items():
        yield key, task.function(**task.arguments)


def _on(executor: Executor, tasks: Mapping[Key, Task]) -> Iterator[tuple[Key, Outcome]]:
    """Outcomes as they come; the costliest tasks begin first."""
    order = sorted(tasks, key=lambda key: -tasks[key].cost)
    running = {executor.submit(tasks[key].function, **tasks[key].arguments): key for key in order}
    try:
        for key, future in as_they_end(running):
            yield key, future.result()
    except BrokenExecutor as error:
        raise InputError(
            "a worker was killed, for want of memory perhaps; with fewer workers the same command "
            "may go through"
        ) from error


def forget(tasks: Mapping[Key, Task], keep: Path) -> None:
    """Remove kept outcomes of some tasks, of whatever code, and the folder if that leaves none."""
    for name in map(_name, tasks):
        for file in keep.glob(f"{name}.*.json"):
            file.unlink(missing_ok=True)
    if keep.is_dir() and not any(keep.iterdir()):
        keep.rmdir()


def _files(tasks: Mapping[Key, Task], keep: Path | None) -> dict[Key, Path]:
    """File of each task's outcome; none if nothing is kept."""
    if keep is None:
        return {}
    place, code = made_folder(keep), _code_digest()
    return {key: place / f"{_name(key)}.{_digest(task, code)}.json" for key, task in tasks.items()}


def _name(key: Key) -> str:
    return ".".join(key)


def _digest(task: Task, code: str) -> str:
    """Hash of what a task is, beside its name."""
    function = f"{task.function.__module__}.{task.function.__qualname__}"
    identity = json.dumps([function, dict(task.arguments), code], sort_keys=True)
    return hashlib.sha256(identity.encode()).hexdigest()[:16]


def _code_digest() -> str:
    """Hash of what the outcomes depend on: our sources, and the versions they rest on."""
    digest = hashlib.sha256(f"{np.__version__} {numba.__version__}".encode())
    for pattern in _SOURCES:
        for source in sorted(_PACKAGE.glob(pattern)):
            digest.update(source.read_bytes())
    return digest.hexdigest()


def _as_dict(outcome: Outcome) -> dict[str, Any]:
    return {"checks": [check.as_dict() for check in outcome.checks], "curves": outcome.curves}


def _read(file: Path) -> Outcome | None:
    """Outcome in a file, if there is a usable one."""
    try:
        content = json.loads(file.read_text())
        checks = [Check.from_dict(entry) for entry in content["checks"]]
        return Outcome(checks, content["curves"])
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError) as error:
        log.warning("%s cannot be used (%s); it will be computed again", file, error)
        return None
