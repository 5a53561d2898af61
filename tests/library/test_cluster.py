"""Building on a real Dask cluster of separate processes, and what goes wrong on one."""

from __future__ import annotations

import gc
import json
import logging
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
import types
from collections.abc import Iterator
from concurrent.futures import BrokenExecutor
from pathlib import Path
from typing import Any

import pytest
from distributed import LocalCluster

from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.forward import forecast
from terraphi.forward.watch import Checkpoint
from terraphi.library import cluster as clusters
from terraphi.library.build import build, cases_folder
from terraphi.library.cluster import Cluster, pool
from terraphi.library.plan import Plan
from terraphi.library.store import Library
from terraphi.library.workers import heartbeat

HOST = "127.0.0.1"
BUILD = ("library", "build", "p.toml", "--out", "l.nc", "--quiet")


@pytest.fixture(scope="module")
def local() -> Iterator[LocalCluster]:
    """Two workers, each a process of its own with a nurse that starts it again."""
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    with LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        host=HOST,
        dashboard_address=None,
        scheduler_kwargs={"dashboard_address": f"{HOST}:0"},  # its HTTP server, or 8787 it is
        silence_logs=logging.CRITICAL,
    ) as running:
        yield running


def small_plan(**sweep: list[Any]) -> Plan:
    scenario = {"model": "rft", "dimensions": 3, "rft": {"panels": 10}}
    return Plan.model_validate({"name": "small", "scenario": scenario, "sweep": sweep})


def coarse_plan(seeds: int) -> Plan:
    """Some seconds a case, of several blocks of steps."""
    scenario = {
        "numerics": {"cells": 32, "speed_up": 5.0, "time_step": 5e-5, "contact_band_cells": 0.5},
        "soil": {"yield_criterion": "plane_strain"},
        "bed": {"left": 0.010, "floor": 0.010, "width": 0.280, "height": 0.160},
        "motion": {"start_deg": -100.0, "stop_deg": -20.0},
    }
    sweep = {"numerics.seed": list(range(seeds))}
    return Plan.model_validate({"name": "coarse", "scenario": scenario, "sweep": sweep})


def bits(library: Library) -> list[tuple[str, bytes | str]]:
    return [
        (case.scenario.hash, case.history.force.tobytes() if case.history else case.failure)
        for case in library.cases
    ]


def names(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir())


# -- nothing is lost -----------------------------------------------------------------------------


@pytest.mark.slow
def test_a_worker_killed_in_the_middle_costs_nothing(
    local: LocalCluster, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    plan, file = coarse_plan(4), tmp_path / "x.nc"
    notes = tmp_path_factory.mktemp("notes")
    killed: list[int] = []
    submitted: list[str] = []
    over = threading.Event()

    def kill_one() -> None:
        """Kill a worker whose case has kept something: that of a finished case stays a while."""
        while not killed and not over.wait(0.01):
            for note in notes.iterdir():
                kept = note.read_text()
                if kept and Path(kept).is_file():
                    os.kill(int(note.name), signal.SIGKILL)
                    killed.append(int(note.name))
                    break

    with Cluster(local.scheduler_address) as running:
        assert running.workers == 2
        submit = running.executor.submit

        def counting(fn: Any, /, scenario: str, checkpoint: Checkpoint) -> Any:
            def noted(scenario: str, checkpoint: Checkpoint) -> Any:
                """Which process is at which case, for as long as it is."""
                note = notes / str(os.getpid())
                note.write_text(str(checkpoint.path))
                try:
                    return fn(scenario, checkpoint)
                finally:
                    note.write_text("")

            submitted.append(scenario)
            return submit(noted, scenario, checkpoint)

        running.executor.submit = counting  # type: ignore[method-assign]
        looks: list[int] = []
        killer = threading.Thread(target=kill_one)
        killer.start()
        made = build(
            plan,
            file,
            executor=running.executor,
            progress=lambda done, _: looks.append(done),
            checkpoint_every=0.0,
        )
        over.set()
        killer.join()
    assert len(killed) == 1
    assert len(submitted) == len(set(submitted)) == 4
    assert looks == sorted(looks)
    assert looks[-1] == 4
    assert made.failures == {}
    # The folder is visible from the workers here: what was killed went on from its checkpoint.
    resumed = [c.history.provenance.get("resumed_at_step") for c in made.cases if c.history]
    assert any(resumed)
    assert bits(made) == bits(build(plan, tmp_path / "y.nc"))
    assert names(tmp_path) == ["x.nc", "y.nc"]


def test_what_is_no_longer_wanted_stops(local: LocalCluster, tmp_path: Path) -> None:
    """Ctrl-C reaches a case that runs, so that the same command does not queue behind it."""
    plan, file = coarse_plan(4), tmp_path / "x.nc"

    def impatient(_done: int, _total: int) -> None:
        if list(cases_folder(file).glob("*.checkpoint")):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), Cluster(local.scheduler_address) as running:
        build(plan, file, executor=running.executor, progress=impatient, checkpoint_every=0.0)
    began = time.perf_counter()
    with Cluster(local.scheduler_address) as running:
        both = [running.executor.submit(time.time) for _ in range(2)]
        assert all(future.result(timeout=60.0) for future in both)
    assert time.perf_counter() - began < 3.0  # a case takes longer
    assert not file.exists()
    assert cases_folder(file).is_dir()


def test_ctrl_c_ends_in_one_sentence(local: LocalCluster, tmp_path: Path) -> None:
    scenario = coarse_plan(1).scenario
    sections = scenario.model_dump(mode="json", exclude_defaults=True)
    lines = ['name = "coarse"', "[sweep]", '"numerics.seed" = [0, 1, 2, 3]']
    for section, content in sections.items():
        lines += [f"[scenario.{section}]", *(f"{k} = {json.dumps(v)}" for k, v in content.items())]
    (tmp_path / "p.toml").write_text("\n".join(lines))
    command = [sys.executable, "-m", "terraphi.cli", *BUILD, "--cluster", local.scheduler_address]
    started = subprocess.Popen(
        [*command, "--checkpoint-every", "0"],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    while not list(tmp_path.glob("l.nc.cases/*.checkpoint")):
        assert started.poll() is None
        time.sleep(0.05)
    os.killpg(started.pid, signal.SIGINT)
    out, err = started.communicate(timeout=120)
    refused((started.returncode, out, err), "interrupted", "kept in l.nc.cases")
    assert not (tmp_path / "l.nc").exists()


# -- one sentence --------------------------------------------------------------------------------


@pytest.fixture
def terraphi(terraphi: Any, tmp_path: Path) -> Any:
    """Run a command in a folder with a small plan."""
    plan = small_plan(**{"soil.friction_angle_deg": [20.0, 30.0, 40.0]})
    (tmp_path / "p.toml").write_text(
        'name = "small"\n[sweep]\n"soil.friction_angle_deg" = [20.0, 30.0, 40.0]\n'
        '[scenario]\nmodel = "rft"\ndimensions = 3\n[scenario.rft]\npanels = 10\n'
    )
    assert Plan.load(tmp_path / "p.toml").cases() == plan.cases()
    return terraphi


def refused(ran: tuple[int, str, str], *words: str) -> None:
    status, out, err = ran
    assert (status, out) == (2, "")
    assert len(err.strip().splitlines()) == 1, err
    for word in words:
        assert word in err


def test_build_on_a_cluster_by_the_command_line(
    local: LocalCluster, terraphi: Any, tmp_path: Path
) -> None:
    status, out, err = terraphi(*BUILD, "--cluster", local.scheduler_address, "--json")
    assert (status, err) == (0, "")
    assert json.loads(out)["cases"] == 3
    here = build(Plan.load(tmp_path / "p.toml"), tmp_path / "y.nc")
    assert bits(Library.load(tmp_path / "l.nc")) == bits(here)


def test_a_cluster_is_asked_for_its_own_room_and_time(
    local: LocalCluster, terraphi: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No case fits this machine, and one core of it would be at work for more than a year."""
    longest = forecast.forecast(Plan.load(tmp_path / "p.toml").cases()).longest_seconds
    monkeypatch.setattr(forecast, "machine_bytes", lambda: 1.0)
    monkeypatch.setattr(forecast, "YEAR", 2.0 * longest)
    assert terraphi(*BUILD, "--workers", "1").status == 2
    status, _, err = terraphi(*BUILD, "--cluster", local.scheduler_address)
    assert (status, err) == (0, "")
    monkeypatch.setattr(forecast, "YEAR", 1.2 * longest)
    (tmp_path / "l.nc").unlink()
    status, _, err = terraphi(*BUILD, "--cluster", local.scheduler_address)
    assert status == 2
    assert "3 cases would take" in err
    assert "on 2 cores" in err
    assert not (tmp_path / "l.nc").exists()


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return int(probe.getsockname()[1])


@pytest.mark.parametrize("address", [f"tcp://{HOST}:PORT", f"{HOST}:PORT", "nonsense", "a://b:1"])
def test_nobody_answers(
    address: str, terraphi: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(clusters, "CONNECT_SECONDS", 0.5)
    address = address.replace("PORT", str(free_port()))
    refused(terraphi(*BUILD, "--cluster", address), address, "'dask scheduler' prints")
    assert names(tmp_path) == ["p.toml"]


def test_no_old_client_is_collected_while_one_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []

    def client(*_: Any, **__: Any) -> None:
        seen.append(gc.isenabled())
        raise OSError

    monkeypatch.setattr("distributed.Client", client)
    with pytest.raises(InputError, match="no Dask scheduler answers"):
        clusters.Cluster("tcp://127.0.0.1:1")
    assert seen == [False]
    assert gc.isenabled()


def test_without_the_extra(terraphi: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    refused(terraphi(*BUILD, "--cluster", "x:1"), "distributed", "pip install 'terraphi[cluster]'")


def test_workers_and_a_cluster(terraphi: Any) -> None:
    ran = terraphi(*BUILD, "--cluster", "x:1", "--workers", "3")
    refused(ran, "leave out one of --workers and --cluster")


def test_a_study_that_simulates_takes_a_cluster(terraphi: Any) -> None:
    refused(terraphi("study", "sensitivity", "--cluster", "x:1"), "name a --build FOLDER")
    refused(terraphi("study", "recovery", "--cluster", "x:1"), "has no option 'cluster'")
    with pytest.raises(InputError, match="no Dask scheduler answers at 'nonsense'"):
        pool(None, "nonsense", default=1)


def test_other_versions_on_a_worker(
    local: LocalCluster, terraphi: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    ours = {**clusters.versions(), "numba": "0.1"}
    monkeypatch.setattr(clusters, "versions", lambda: ours)
    ran = terraphi(*BUILD, "--cluster", local.scheduler_address)
    refused(ran, "a worker on ", "has numba ", "this side 0.1", "install the same", "are kept")
    assert not (tmp_path / "l.nc").exists()


def test_other_versions_on_the_scheduler(
    local: LocalCluster, terraphi: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    import distributed

    real = distributed.Client.get_versions

    def older(self: Any, **options: Any) -> Any:
        found = real(self, **options)
        found["client"]["packages"]["dask"] = "1.0"
        return found

    monkeypatch.setattr(distributed.Client, "get_versions", older)
    ran = terraphi(*BUILD, "--cluster", local.scheduler_address)
    refused(ran, "has dask 20", "this side 1.0; install the same versions on both")


# -- a scheduler of its own for what ends it -----------------------------------------------------

BLOCKED = """
import sys
class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == "terraphi":
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Blocked())
"""


@pytest.fixture
def scheduler(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[str, Any]]:
    """A scheduler and, if asked for, a worker as people start them; the former as a process."""
    blocked = getattr(request, "param", None) == "blocked"
    extra = tmp_path / "site"
    extra.mkdir()
    if blocked:
        (extra / "sitecustomize.py").write_text(BLOCKED)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(extra), *sys.path])}
    port = free_port()
    address = f"tcp://{HOST}:{port}"
    command = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", HOST]
    quiet: Any = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "env": environment}
    main_process = subprocess.Popen([*command, "--port", str(port), "--no-dashboard"], **quiet)
    command = [sys.executable, "-m", "distributed.cli.dask_worker", address, "--host", HOST]
    more = ["--no-dashboard", "--no-nanny", "--nthreads", "1", "--death-timeout", "20"]
    worker = subprocess.Popen([*command, *more, "--local-directory", str(extra)], **quiet)
    yield address, main_process
    for process in (worker, main_process):
        process.kill()
        process.wait()


@pytest.mark.parametrize("scheduler", ["blocked"], indirect=True)
def test_a_cluster_without_terraphi(scheduler: tuple[str, Any], tmp_path: Path) -> None:
    plan = small_plan(**{"soil.friction_angle_deg": [20.0, 30.0, 40.0]})
    with (
        Cluster(scheduler[0]) as running,
        pytest.raises(InputError, match="cannot load terraphi as it is here; install the same"),
    ):
        build(plan, tmp_path / "x.nc", executor=running.executor)
    assert not (tmp_path / "x.nc").exists()


@pytest.mark.slow
def test_a_scheduler_that_is_lost(scheduler: tuple[str, Any], tmp_path: Path) -> None:
    plan, file = coarse_plan(3), tmp_path / "x.nc"

    def deadly(done: int, _total: int) -> None:
        if done == 1:
            scheduler[1].kill()

    with (
        pytest.raises(InputError, match=re.escape(f"{scheduler[0]} is gone; finished cases are")),
        Cluster(scheduler[0]) as running,
    ):
        build(plan, file, executor=running.executor, progress=deadly, checkpoint_every=0.0)
    assert not file.exists()
    (kept,) = cases_folder(file).glob("*.nc")
    known = ForceHistory.from_netcdf(kept).force.tobytes()
    assert known in [force for _, force in bits(build(plan, file))]


def test_a_case_that_kills_every_worker_is_recorded(tmp_path: Path) -> None:
    from distributed.scheduler import KilledWorker

    translated = clusters._Translated.__new__(clusters._Translated)
    translated._address = "tcp://x"
    told = translated._in_our_words(KilledWorker("task", None, 3))  # type: ignore[arg-type]
    assert isinstance(told, RuntimeError)
    assert not isinstance(told, BrokenExecutor)
    assert "was killed" in str(told)


# -- the page ------------------------------------------------------------------------------------


def test_the_lines_for_slurm_run(
    local: LocalCluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As they stand on the page, but for the plan, on processes here in place of Slurm's jobs."""
    page = (Path(__file__).parents[2] / "docs" / "cluster.md").read_text()
    (block,) = re.findall(r"```python\n(.*?)```", page, re.S)
    asked: dict[str, Any] = {}

    class SLURMCluster:
        def __init__(self, **options: Any) -> None:
            asked.update(options)
            self.scheduler_address = local.scheduler_address

        def __enter__(self) -> SLURMCluster:
            return self

        def __exit__(self, *_: object) -> None:
            pass

        def scale(self, *, jobs: int) -> None:
            asked["jobs"] = jobs

    jobqueue = types.ModuleType("dask_jobqueue")
    jobqueue.SLURMCluster = SLURMCluster  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "dask_jobqueue", jobqueue)
    monkeypatch.chdir(tmp_path)
    quick = small_plan(**{"soil.friction_angle_deg": [20.0, 30.0, 40.0]})
    monkeypatch.setattr(Plan, "load", lambda _name: quick)
    exec(compile(block, "cluster.md", "exec"), {"__name__": "__main__"})
    assert {"cores", "processes", "memory", "walltime", "jobs"} <= asked.keys()
    (made,) = tmp_path.glob("*.nc")
    assert bits(Library.load(made)) == bits(build(quick, tmp_path / "y.nc"))


def test_heartbeat_outside_a_task() -> None:
    heartbeat(0.0)
