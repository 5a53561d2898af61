"""Building: resumed without computing twice, the same on any executor, refused in one sentence."""

from __future__ import annotations

import json
import os
from concurrent.futures import CancelledError, Executor, Future, ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from terraphi.experiment.errors import InputError
from terraphi.experiment.files import file_lock, folder_lock
from terraphi.experiment.workers import workers
from terraphi.laws import build as module
from terraphi.laws.build import build, build_share, cluster
from terraphi.laws.plan import Plan
from terraphi.laws.store import Library

PLAN = Plan.model_validate(
    {
        "name": "small",
        "sweep": {"leg.shape": ["straight", "c"], "soil.friction_angle_deg": [25.0, 35.0]},
        "scenario": {
            "model": "rft",
            "dimensions": 3,
            "motion": {
                "kind": "rotation",
                "hip": [0.15, 0.19],
                "start_deg": -100.0,
                "stop_deg": 100.0,
            },
            "relief": {"enabled": False},
        },
    }
)


def forces(library: Library) -> list[np.ndarray]:
    return [case.history.force for case in library.cases]


@pytest.fixture(scope="module")
def complete(tmp_path_factory: pytest.TempPathFactory) -> Library:
    return build(PLAN, tmp_path_factory.mktemp("whole") / "library.nc")


def test_an_interrupted_build_goes_on(complete: Library, tmp_path: Path, monkeypatch) -> None:
    calls, run = [], module.run_case

    def stopping(*given: str):
        calls.append(given)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return run(*given)

    monkeypatch.setattr(module, "run_case", stopping)
    with pytest.raises(KeyboardInterrupt):
        build(PLAN, tmp_path / "library.nc")
    assert len(list((tmp_path / "library.nc.cases").glob("*.nc"))) == 2
    assert not (tmp_path / "library.nc").exists()
    library = build(PLAN, tmp_path / "library.nc")
    assert len(calls) == 5
    assert not (tmp_path / "library.nc.cases").exists()
    for first, other in zip(forces(library), forces(complete), strict=True):
        np.testing.assert_array_equal(first, other)
    build(PLAN, tmp_path / "library.nc")
    assert len(calls) == 5


def test_a_longer_plan_keeps_what_is_there(tmp_path: Path, monkeypatch) -> None:
    before = build(PLAN, tmp_path / "library.nc")
    # An earlier version may have had another hash of the same scenario.
    for case in before.cases:
        case.history.provenance["scenario_hash"] = "another"
    before.save(tmp_path / "library.nc")
    calls, run = [], module.run_case
    monkeypatch.setattr(module, "run_case", lambda *given: calls.append(1) or run(*given))
    more = PLAN.model_copy(
        update={"sweep": {**PLAN.sweep, "leg.shape": ["straight", "c", "reversed_c"]}}
    )
    assert len(build(more, tmp_path / "library.nc").cases) == 6
    assert len(calls) == 2


def test_shares_give_the_library_of_one_run(complete: Library, tmp_path: Path, terraphi) -> None:
    """One is killed in its midst, one is done twice, and another process has a case."""
    path, folder = tmp_path / "library.nc", tmp_path / "library.nc.cases"
    with pytest.raises(KeyboardInterrupt):
        build_share(PLAN, path, (1, 2), progress=lambda done, _: stop(done))
    assert len(list(folder.glob("*.nc"))) == 1
    with file_lock(folder / f"{PLAN.cases()[3].hash}.lock") as free:
        assert free
        assert build_share(PLAN, path, (2, 2)) == 1
        # Other shares may come, but no build.
        with folder_lock(folder, shared=True), pytest.raises(InputError, match="another process"):
            build(PLAN, path)
    assert build_share(PLAN, path, (2, 2)) == 0
    assert {file.suffix for file in folder.iterdir()} == {".nc"}
    assert len(list(folder.glob("*.nc"))) == 3
    library = build(PLAN, path)
    assert not folder.exists()
    for first, other in zip(forces(library), forces(complete), strict=True):
        np.testing.assert_array_equal(first, other)


def stop(done: int) -> None:
    if done == 1:
        raise KeyboardInterrupt


def test_a_share_by_the_command(terraphi) -> None:
    Path("p.toml").write_text(
        'name = "one"\n[sweep]\n"soil.friction_angle_deg" = [20.0, 30.0, 40.0]\n'
        '[scenario]\nmodel = "rft"\ndimensions = 3\n'
    )
    command = ("library", "build", "p.toml", "--out", "l.nc", "--workers", "1")
    shared = terraphi(*command, "--share", "2/2", "--json")
    assert json.loads(shared.out) == {"share": "2/2", "cases": 1, "lacking": 0}
    for wrong in ("0/2", "3/2", "two"):
        refused = terraphi(*command, "--share", wrong)
        assert refused.status == 2
        assert "--share" in refused.err
    assert terraphi(*command).status == 0
    assert len(Library.load("l.nc").cases) == 3


class Killed(Executor):
    """A cluster whose worker is killed in each second case."""

    def __init__(self) -> None:
        self.count = 0

    def submit(self, work, /, *given, **options):
        self.count += 1
        future: Future = Future()
        if self.count % 2:
            future.set_exception(MemoryError("worker killed"))
        else:
            future.set_result(work(*given, **options))
        return future


def test_a_worker_of_a_cluster_that_is_killed_is_a_failed_case(
    complete: Library, tmp_path: Path
) -> None:
    library = build(PLAN, tmp_path / "library.nc", executor=Killed())
    assert [case.failure for case in library.cases if case.history is None] == [
        "MemoryError: worker killed"
    ] * 2
    again = build(PLAN, tmp_path / "library.nc")
    for first, other in zip(forces(again), forces(complete), strict=True):
        np.testing.assert_allclose(first, other, atol=1e-5)  # in single precision in a file


class Lost(Executor):
    """A cluster whose scheduler is lost."""

    def submit(self, work, /, *given, **options):
        future: Future = Future()
        future.set_exception(CancelledError())
        return future


def test_a_lost_cluster_ends_the_build_and_nothing_is_lost(tmp_path: Path) -> None:
    with pytest.raises(CancelledError):
        build(PLAN, tmp_path / "library.nc", executor=Lost())
    assert not (tmp_path / "library.nc").exists()


def test_a_share_without_cases_has_nothing_to_do(tmp_path: Path) -> None:
    assert build_share(PLAN, tmp_path / "library.nc", (7, 9)) == 0
    assert not any(tmp_path.iterdir())


@pytest.mark.slow
def test_processes_give_the_same(complete: Library, tmp_path: Path) -> None:
    with workers(2) as pool:
        library = build(PLAN, tmp_path / "library.nc", executor=pool)
    for first, other in zip(forces(library), forces(complete), strict=True):
        np.testing.assert_array_equal(first, other)


def test_any_executor_gives_the_same(complete: Library, tmp_path: Path) -> None:
    observed: list[tuple[int, int]] = []
    with ThreadPoolExecutor(2) as pool:
        library = build(
            PLAN, tmp_path / "library.nc", executor=pool, progress=lambda *n: observed.append(n)
        )
    assert observed[0] == (0, 4)
    assert observed[-1] == (4, 4)
    for first, other in zip(forces(library), forces(complete), strict=True):
        np.testing.assert_array_equal(first, other)


@pytest.mark.slow
def test_a_dask_cluster_gives_the_same(complete: Library, tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None
        ) as local,
        cluster(local.scheduler_address) as executor,
    ):
        library = build(PLAN, tmp_path / "library.nc", executor=executor)
    for first, other in zip(forces(library), forces(complete), strict=True):
        np.testing.assert_array_equal(first, other)


def test_failures_are_kept_and_tried_again(tmp_path: Path, monkeypatch) -> None:
    run = module.run_case

    def failing(scenario: str, checkpoint: str):
        return "it broke down" if '"shape":"c"' in scenario else run(scenario, checkpoint)

    monkeypatch.setattr(module, "run_case", failing)
    library = build(PLAN, tmp_path / "library.nc")
    assert [case.failure for case in library.cases] == ["", "", "it broke down", "it broke down"]
    monkeypatch.setattr(module, "run_case", run)
    assert not any(case.failure for case in build(PLAN, tmp_path / "library.nc").cases)
    monkeypatch.setattr(module, "run_case", lambda *_: "it broke down")
    with pytest.raises(InputError, match="every case failed"):
        build(PLAN, tmp_path / "other.nc")


def test_places_that_cannot_be_used_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(InputError, match="folder"):
        build(PLAN, tmp_path)
    if os.name == "posix":
        from terraphi.experiment.files import folder_lock

        with (
            folder_lock(tmp_path / "library.nc.cases"),
            pytest.raises(InputError, match="another process"),
        ):
            build(PLAN, tmp_path / "library.nc")
    monkeypatch.setattr("terraphi.laws.build.CONNECT_SECONDS", 0.5)
    with pytest.raises(InputError, match="no Dask scheduler"), cluster("tcp://127.0.0.1:1"):
        pass
