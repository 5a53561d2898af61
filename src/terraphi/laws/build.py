"""Build a library: simulate the cases of a plan on any executor, keep what is finished, resume.

While ``FILE.nc`` is being built, finished cases lie in the folder ``FILE.nc.cases``, one force
history each, named by the hash of its scenario, with the checkpoints of the cases that are running.
The same command continues there after a kill. The folder goes when the library is written.
Processes on many machines can each simulate a share of the cases into it; a build gathers them.
"""

from __future__ import annotations

import logging
import shutil
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, as_completed
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

from terraphi.experiment.errors import InputError, needing
from terraphi.experiment.files import file_lock, folder_lock
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.scenario import Scenario
from terraphi.forward import model_version, simulate, software
from terraphi.laws.plan import Plan
from terraphi.laws.store import Case, Library

log = logging.getLogger(__name__)

CONNECT_SECONDS = 10.0
"""Longest wait for a Dask scheduler [s]."""


def build(
    plan: Plan | Path | str,
    path: Path | str,
    *,
    executor: Executor | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Library:
    """Simulate the cases of a plan that are not there yet, and write the library.

    Parameters
    ----------
    plan
        What to simulate: a plan, its TOML file, or the name of a shipped one.
    path
        File of the library. Cases that it holds already, or that an interrupted build left in
        FILE.nc.cases, are not simulated again.
    executor
        Runs the cases; ``None`` runs them here, one after another.
    progress
        Called with the number of finished cases and of all cases after each.

    Returns
    -------
    Library
        Failed cases are recorded in it, and tried again by the next build.

    Raises
    ------
    InputError
        If the file cannot be written, another build of it is running, or every case failed.

    Examples
    --------
    >>> angles = [20.0, 30.0, 40.0, 50.0]
    >>> plan = terraphi.Plan(
    ...     name="mine",
    ...     scenario=terraphi.Scenario.load("quick"),
    ...     sweep={"soil.friction_angle_deg": angles},
    ... )
    >>> terraphi.build(plan, "mine.nc").phi_deg_by_leg
    {'straight': (20.0, 50.0)}
    """
    plan = plan if isinstance(plan, Plan) else Plan.load(plan)
    path, wanted = Path(path), plan.cases()
    if path.exists() and not path.is_file():
        raise InputError(f"{path}: is a folder or a device; name a file")
    folder = path.with_name(path.name + ".cases")
    with folder_lock(folder):
        finished = _finished(path, folder, wanted)
        failures = _simulate(wanted, finished, folder, executor, progress)
        if len(failures) == len(wanted):
            reason = next(iter(failures.values()))
            raise InputError(f"plan '{plan.name}': every case failed, the first with: {reason}")
        cases = [Case(s, finished.get(s.hash), failures.get(s.hash, "")) for s in wanted]
        provenance = {"plan": plan.model_dump(mode="json"), **software(plan.scenario)}
        library = Library(
            plan.name, tuple(cases), plan.description, plan.caveat, provenance=provenance
        )
        library.save(path)
        shutil.rmtree(folder, ignore_errors=True)  # the library is whole
    return library


def build_share(
    plan: Plan | Path | str,
    path: Path | str,
    share: tuple[int, int],
    *,
    executor: Executor | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> int:
    """Simulate a share of a plan's cases into FILE.nc.cases, while other shares do theirs.

    Parameters
    ----------
    plan, path, executor, progress
        As of :func:`build`, which gathers the cases of all shares into the library.
    share
        Number K of the share, from 1 to N, and N: the cases K, K + N, K + 2 N and so on. A case
        that another process simulates now is left to it.

    Returns
    -------
    int
        Cases of the share that failed or were left to others.

    Raises
    ------
    InputError
        If there is no such share, or a build of the library is running.
    """
    plan = plan if isinstance(plan, Plan) else Plan.load(plan)
    path, (number, count) = Path(path), share
    if not 1 <= number <= count:
        raise InputError(f"share {number}/{count}; give 1/N to N/N")
    folder = path.with_name(path.name + ".cases")
    if not (wanted := plan.cases()[number - 1 :: count]):
        return 0
    with folder_lock(folder, shared=True), ExitStack() as locks:
        free = [s for s in wanted if locks.enter_context(file_lock(folder / f"{s.hash}.lock"))]
        finished = _finished(path, folder, free)
        failures = _simulate(free, finished, folder, executor, progress)
    with suppress(OSError):  # empty where the library has all cases
        folder.rmdir()
    return len(failures) + len(wanted) - len(free)


def _simulate(
    wanted: list[Scenario], finished: dict[str, ForceHistory], folder: Path,
    executor: Executor | None, progress: Callable[[int, int], None] | None,
) -> dict[str, str]:  # fmt: skip
    """Simulate what is not finished, and add it there and to the folder; reasons of failures."""
    missing = [scenario for scenario in wanted if scenario.hash not in finished]
    failures: dict[str, str] = {}
    report, done = progress or (lambda *_: None), len(wanted) - len(missing)
    report(done, len(wanted))
    for scenario, outcome in _outcomes(missing, folder.absolute(), executor):
        if isinstance(outcome, str):
            failures[scenario.hash] = outcome
            log.warning("φ = %g°: %s", scenario.soil.friction_angle_deg, outcome)
        else:
            outcome.to_netcdf(folder / f"{scenario.hash}.nc")
            (folder / f"{scenario.hash}.checkpoint").unlink(missing_ok=True)
            finished[scenario.hash] = outcome
        done += 1
        report(done, len(wanted))
    return failures


def run_case(scenario_json: str, checkpoint: str) -> ForceHistory | str:
    """Simulate one case in a worker; all that goes in and out can be pickled.

    Parameters
    ----------
    scenario_json
        A scenario as JSON.
    checkpoint
        File for its state meanwhile; not used where its folder does not exist, as on a cluster
        without common files.

    Returns
    -------
    ForceHistory or str
        The history, or the reason why the simulation failed.
    """
    scenario, kept = Scenario.model_validate_json(scenario_json), Path(checkpoint)
    try:
        return simulate(scenario, checkpoint=kept if kept.parent.is_dir() else None)
    except (ArithmeticError, RuntimeError, ValueError) as error:
        return str(error)


def _outcomes(
    missing: list[Scenario], folder: Path, executor: Executor | None
) -> Iterator[tuple[Scenario, ForceHistory | str]]:
    """Each scenario with its history, or the reason of its failure, as they finish."""
    arguments = [(s.model_dump_json(), str(folder / f"{s.hash}.checkpoint")) for s in missing]
    if executor is None:
        for scenario, given in zip(missing, arguments, strict=True):
            yield scenario, run_case(*given)
        return
    running: dict[Future[ForceHistory | str], Scenario] = {
        executor.submit(run_case, *given): scenario
        for scenario, given in zip(missing, arguments, strict=True)
    }
    try:
        for future in as_completed(running):
            try:
                outcome = future.result()
            except Exception as error:
                # Of a cluster, whose worker was killed or ran out of memory: of this case alone.
                kind = type(error).__name__
                if not isinstance(error, MemoryError) and kind != "KilledWorker":
                    raise
                outcome = f"{kind}: {error}"
            yield running[future], outcome
    finally:
        for future in running:
            future.cancel()


def _finished(path: Path, folder: Path, wanted: list[Scenario]) -> dict[str, ForceHistory]:
    """Histories by the present version of the model in a library and a folder, by scenario hash."""
    histories = {}
    if path.exists():
        histories = {c.scenario.hash: c.history for c in Library.load(path).cases if c.history}
    for file in sorted(folder.glob("*.nc")):
        try:
            history = ForceHistory.load(file)
        except InputError as error:
            log.warning("%s; it will be simulated again", error)
        else:
            if history.provenance.get("scenario_hash") == file.stem:
                histories[file.stem] = history
    return {
        s.hash: histories[s.hash]
        for s in wanted
        if s.hash in histories
        and histories[s.hash].provenance.get("model_version") == model_version(s)
    }


@contextmanager
def cluster(address: str) -> Iterator[Executor]:
    """Workers of a Dask cluster that is running, by the address of its scheduler.

    Raises
    ------
    InputError
        If Dask is not installed, or no scheduler answers.
    """
    with needing("a Dask cluster", "dask and distributed", extra="cluster"):
        from distributed import Client
    connect: Any = Client  # it publishes no types
    try:
        client = connect(address, timeout=CONNECT_SECONDS, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(f"{address}: no Dask scheduler answers there ({error})") from error
    with client:
        yield client.get_executor()
