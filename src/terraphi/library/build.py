"""Build a library: run a plan's cases on an executor, keep what is finished, resume.

While a build of ``FILE.nc`` is under way, finished cases lie in the folder ``FILE.nc.cases``, one
force history each, named by the hash of its scenario, and beside them the checkpoints of the cases
that are running. When the library is whole the folder goes, but for the last good states of cases
that broke down, and for finished cases that the plan does not ask for: no simulation is thrown
away.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import BrokenExecutor, Executor, Future
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

from pydantic import ValidationError

from terraphi.experiment.errors import InputError
from terraphi.experiment.files import made_folder, replacing
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.scenario import Scenario
from terraphi.forward import Checkpoint, model_version, simulate, software
from terraphi.forward.watch import EVERY
from terraphi.library.plan import Plan, describe, unseeded
from terraphi.library.store import Case, Library
from terraphi.library.workers import as_they_end, heartbeat

log = logging.getLogger(__name__)

Progress = Callable[[int, int], None]
"""Called with the number of finished cases and of all cases."""

HASH_LENGTH = 64
"""Digits of a scenario's hash."""
FAILURE = ".failure.json"
"""Suffix of the file that says why a case failed."""


def run_case(scenario_json: str, checkpoint: Checkpoint | None = None) -> ForceHistory | str:
    """Simulate one case in a worker process; what it takes and returns can be pickled.

    Parameters
    ----------
    scenario_json
        A scenario as JSON.
    checkpoint
        Where its state is kept meanwhile; not used where the folder cannot be seen, as on a
        cluster without common files.

    Returns
    -------
    ForceHistory or str
        The history, or one line that says why the simulation failed.
    """
    scenario = Scenario.model_validate_json(scenario_json)
    seen = 0.0

    def report(fraction: float) -> None:
        nonlocal seen
        heartbeat(fraction - seen)
        seen = fraction

    kept = checkpoint if checkpoint and checkpoint.path.parent.is_dir() else None
    try:
        return simulate(scenario, progress=report, checkpoint=kept)
    except (ArithmeticError, RuntimeError, ValueError) as error:
        heartbeat(0.0)  # a stop asked for is no failure of the case
        return f"{type(error).__name__}: {error}"


def cases_folder(path: Path) -> Path:
    """Folder that keeps finished cases while a library is being built."""
    return path.with_name(path.name + ".cases")


def kept_cases(path: Path) -> Path | None:
    """Return the folder of cases that an ended build left behind, or ``None`` if there is none.

    An empty folder is removed.
    """
    folder = cases_folder(path)
    if folder.is_dir():
        _remove_if_empty(folder)
    return folder if folder.is_dir() else None


def _remove_if_empty(folder: Path) -> None:
    """Remove a folder of cases if it is empty."""
    if folder.is_dir() and not any(folder.iterdir()):
        folder.rmdir()


def build(
    plan: Plan,
    path: Path | str,
    *,
    executor: Executor | None = None,
    begin: Callable[[list[Scenario]], None] | None = None,
    progress: Progress | None = None,
    checkpoint_every: float = EVERY,
    memory: float | None = None,
) -> Library:
    """Simulate what a plan asks for and has not been simulated yet, and write the library.

    Parameters
    ----------
    plan
        What to simulate.
    path
        The library's file; cases of the same scenario and model version that it, or an
        interrupted build of it, already holds are taken from there, and so are its replicates of
        cases of the plan. Its calibration and its finer cases stay if the cases are the same.
        What the plan no longer asks for is kept in the folder beside it.
    executor
        Runs the cases, such as that of a :class:`~terraphi.library.workers.WorkerPool` or a
        :class:`~terraphi.library.cluster.Cluster`; ``None`` runs them here, one after another.
    begin
        Called once, before the first simulation, with the cases that are not there yet.
    progress
        Called whenever something may have changed.
    checkpoint_every
        Least time between two checkpoints of a case [s].
    memory
        Of the machine that simulates, as :meth:`Plan.refuse_what_cannot_fit` has it [byte].

    Returns
    -------
    Library
        Failed cases are recorded in it and tried again at the next build.

    Raises
    ------
    InputError
        If the file cannot be written, a worker was killed, or no case at all succeeded.
    """
    path = Path(path)
    if path.exists() and not path.is_file():
        raise InputError(f"{path}: is a folder or a device; name a file")
    # A file that is not a library of ours is not for us to overwrite.
    before = Library.load(path) if path.exists() else None
    folder = cases_folder(path)
    finished, failures = simulate_cases(
        plan,
        folder,
        known=_usable(before.cases) if before else {},
        executor=executor,
        begin=begin,
        progress=progress,
        checkpoint_every=checkpoint_every,
        memory=memory,
    )
    if not finished:
        reason = next(iter(failures.values()))
        raise InputError(f"plan '{plan.name}': every case failed, the first with: {reason}")
    cases = [Case(s, finished.get(s.hash), failures.get(s.hash, "")) for s in plan.cases()]
    library = Library(plan, tuple(cases), software(plan.scenario))
    if before is not None:
        library = _with_what_was_learnt(library, before)
        _keep_what_is_dropped(library, before, folder)
    library.save(path)
    _clear(folder, finished, failures)
    return library


def _keep_what_is_dropped(library: Library, before: Library, folder: Path) -> None:
    """Keep finished cases of the file that the library replaces and does not have, in a folder."""
    there, were = ((*one.cases, *one.replicates, *one.fine) for one in (library, before))
    usable = _usable(were)
    for name in usable.keys() - {case.scenario.hash for case in there}:
        made_folder(folder)
        usable[name].to_netcdf(folder / f"{name}.nc")


def _clear(folder: Path, finished: Iterable[str], failed: Iterable[str]) -> None:
    """Remove what is kept of cases, named by their hashes, once the library has them.

    Histories of other cases stay, and last good states of cases that failed.
    """
    done, kept = set(finished), set(failed)
    if not folder.is_dir():
        return
    for file in folder.iterdir():
        of = file.name.lstrip(".")[:HASH_LENGTH]
        if len(of) < HASH_LENGTH or set(of) - set("0123456789abcdef") or not file.is_file():
            continue
        # Checkpoints, and what a killed process left under a temporary name, are no histories.
        if of in done or (of not in kept and file.name != f"{of}.nc"):
            file.unlink(missing_ok=True)
    if more := len(finished_cases(folder)):
        log.warning(
            "%d finished simulations that the plan does not ask for are kept in %s; a plan that "
            "does finds them there, and nothing else needs them",
            more,
            folder,
        )
    _remove_if_empty(folder)


def _with_what_was_learnt(library: Library, before: Library) -> Library:
    """Return the library with what else the file has that it replaces: see :func:`build`."""
    cases = {c.scenario.hash for c in library.cases}
    kinds = {unseeded(c.scenario) for c in library.cases}
    usable = _usable(before.replicates)
    kept = tuple(
        c
        for c in before.replicates
        if c.scenario.hash in usable
        and c.scenario.hash not in cases
        and unseeded(c.scenario) in kinds
    )
    same = [c.digest for c in library.cases] == [c.digest for c in before.cases]
    whole = len(kept) == len(before.replicates)
    calibration = before.calibration if same and whole else {}
    if before.fine and not same:
        log.warning("library '%s' is no longer refined: its cases have changed", library.name)
    return replace(
        library,
        replicates=kept,
        calibration=calibration,
        fine=before.fine if same else (),
        refinement=before.refinement if same else {},
    )


def simulate_cases(
    plan: Plan,
    folder: Path,
    *,
    known: Mapping[str, ForceHistory] = MappingProxyType({}),
    executor: Executor | None = None,
    begin: Callable[[list[Scenario]], None] | None = None,
    progress: Progress | None = None,
    checkpoint_every: float = EVERY,
    memory: float | None = None,
    keep_failures: bool = False,
    known_failures: Mapping[str, str] = MappingProxyType({}),
) -> tuple[dict[str, ForceHistory], dict[str, str]]:
    """Simulate what a plan asks for and has not been simulated yet, each case to a file of its own.

    Parameters
    ----------
    plan
        What to simulate.
    folder
        Finished cases are kept here, named by the hash of their scenario, and checkpoints of those
        that are running; what is here already is taken as it is.
    known
        Further finished cases, by the hash of their scenario.
    executor, begin, progress, checkpoint_every, memory
        As in :func:`build`.
    keep_failures
        Whether that a case fails is a result too: the reason is then kept in a file beside the
        histories, and the case not tried again.
    known_failures
        Why further cases fail, by the hash of their scenario; these are not tried either.

    Returns
    -------
    dict, dict
        Finished histories, and why the others failed, by the hash of their scenario.

    Raises
    ------
    InputError
        If the folder cannot be written, a worker was killed, or a case could never be held or
        finished here.
    """
    wanted = plan.cases()
    plan.refuse_what_cannot_fit(memory=memory)
    made_folder(folder)
    there = {**known, **finished_cases(folder)}
    finished = {s.hash: there[s.hash] for s in wanted if s.hash in there}
    hopeless = {**known_failures, **(failed_cases(folder) if keep_failures else {})}
    failures = {s.hash: hopeless[s.hash] for s in wanted if s.hash in hopeless}
    # A worker may stand in another folder, or on another machine with the same files.
    place = folder.absolute()
    checkpoints = {
        s.hash: Checkpoint(place / f"{s.hash}.checkpoint", checkpoint_every) for s in wanted
    }
    missing = {s.hash: s for s in wanted if s.hash not in finished and s.hash not in failures}
    if begin is not None:
        begin(list(missing.values()))

    def keep(scenario: Scenario, outcome: ForceHistory | str) -> None:
        if isinstance(outcome, str):
            failures[scenario.hash] = outcome
            if keep_failures:
                _keep_failure(folder, scenario, outcome)
            log.warning("%s failed: %s", describe(plan, scenario), outcome)
        else:
            outcome.to_netcdf(folder / f"{scenario.hash}.nc")
            checkpoints[scenario.hash].remove()
            finished[scenario.hash] = outcome
        look()

    def look() -> None:
        if progress is not None:
            settled = sum(key in finished or key in failures for key in missing)
            progress(len(wanted) - len(missing) + settled, len(wanted))

    try:
        look()
        if executor is None:
            for key, scenario in missing.items():
                keep(scenario, run_case(scenario.model_dump_json(), checkpoints[key]))
        else:
            _run_on(executor, list(missing.values()), checkpoints, keep, look)
    except BaseException:
        if executor is None:  # its workers may have something to keep even now
            _remove_if_empty(folder)
        raise
    _remove_if_empty(folder)
    return finished, failures


def _run_on(
    executor: Executor,
    scenarios: list[Scenario],
    checkpoints: dict[str, Checkpoint],
    keep: Callable[[Scenario, ForceHistory | str], None],
    look: Callable[[], None],
) -> None:
    """Run cases on an executor and keep each as it finishes."""
    running: dict[Future[ForceHistory | str], Scenario] = {
        executor.submit(run_case, scenario.model_dump_json(), checkpoints[scenario.hash]): scenario
        for scenario in scenarios
    }
    for scenario, future in as_they_end(running, look):
        if future.cancelled():
            raise InputError(
                "the executor dropped a case; finished cases are kept, and the same command goes "
                "on from there"
            )
        error = future.exception()
        if isinstance(error, BrokenProcessPool):
            raise InputError(
                "a worker was killed, for want of memory perhaps; finished cases are kept, and "
                "the same command with fewer workers goes on from there"
            ) from error
        if isinstance(error, BrokenExecutor):
            raise InputError(str(error)) from error
        keep(scenario, f"{type(error).__name__}: {error}" if error else future.result())


def finished_cases(folder: Path) -> dict[str, ForceHistory]:
    """Histories in a folder by scenario hash; unreadable or outdated files are skipped."""
    found = {}
    for file in sorted(folder.glob("[0-9a-f]*.nc")):
        try:
            history = ForceHistory.from_netcdf(file)
        except InputError as error:
            log.warning("%s; it will be computed again", error)
            continue
        if not _is_current(history):
            continue
        own = Scenario.model_validate(history.provenance["scenario"]).hash
        if own != file.stem:
            log.warning(
                "%s: holds another scenario than its name says, %s; it is not taken", file, own
            )
            continue
        found[file.stem] = history
    return found


def failed_cases(folder: Path) -> dict[str, str]:
    """Reasons of failed cases in a folder by scenario hash; those of other models are skipped."""
    found = {}
    for file in sorted(folder.glob("[0-9a-f]*" + FAILURE)):
        try:
            kept = json.loads(file.read_text(encoding="utf-8"))
            scenario = Scenario.model_validate(kept["scenario"])
            if kept["model_version"] == model_version(scenario):
                found[scenario.hash] = str(kept["reason"])
        except (KeyError, TypeError, ValueError) as error:
            log.warning("%s: not a record of a failure (%s); it will be tried again", file, error)
    return found


def _keep_failure(folder: Path, scenario: Scenario, reason: str) -> None:
    # Where the last good state lies is of this machine and this day.
    record = {
        "scenario": scenario.model_dump(mode="json"),
        "model_version": model_version(scenario),
        "reason": reason.partition("; the last good state")[0],
    }
    with replacing(folder / (scenario.hash + FAILURE)) as temporary:
        temporary.write_text(json.dumps(record, indent=1, ensure_ascii=False), encoding="utf-8")


def _usable(cases: Iterable[Case]) -> dict[str, ForceHistory]:
    """Histories that the current model version made, by scenario hash."""
    return {c.scenario.hash: c.history for c in cases if c.history and _is_current(c.history)}


def _is_current(history: ForceHistory) -> bool:
    """Whether the current model version made this history."""
    scenario = history.provenance.get("scenario")
    if scenario is None:
        return False
    try:
        current = model_version(Scenario.model_validate(scenario))
    except ValidationError:  # of a version with other scenarios
        return False
    return bool(history.provenance.get("model_version") == current)
