"""Building libraries: nothing is computed twice, and no trouble costs what is finished."""

from __future__ import annotations

import importlib
import logging
import math
import multiprocessing
import os
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from terraphi.experiment.errors import InputError
from terraphi.experiment.files import held
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.scenario import Scenario
from terraphi.forward import MODEL_VERSIONS, Checkpoint, simulate
from terraphi.library.build import build, cases_folder
from terraphi.library.plan import Plan
from terraphi.library.store import Case, Library
from terraphi.library.workers import WorkerPool

building = importlib.import_module("terraphi.library.build")

PHI = "soil.friction_angle_deg"
ANGLES = [20.0, 25.0, 30.0, 35.0, 40.0]
Calls = list[float]


def plan_of(angles: list[float] = ANGLES, *, legs: list[str] | None = None, **more: Any) -> Plan:
    scenario = {"model": "rft", "dimensions": 3, "rft": {"panels": 10}}
    sweep = {"leg.shape": legs or ["straight"], PHI: angles, **more}
    return Plan.model_validate({"name": "mine", "scenario": scenario, "sweep": sweep})


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> Calls:
    """Friction angles simulated, in order."""
    seen: Calls = []

    def counting(scenario: Scenario, **options: Any) -> ForceHistory:
        seen.append(scenario.soil.friction_angle_deg)
        return simulate(scenario, **options)

    monkeypatch.setattr(building, "simulate", counting)
    return seen


def same_forces(one: Library, other: Library) -> bool:
    """Whether two libraries hold the same cases bit by bit."""
    return len(one.cases) == len(other.cases) and all(
        a.scenario == b.scenario
        and a.failure == b.failure
        and (a.history is None) == (b.history is None)
        and (
            a.history is None
            or b.history is None
            or (
                a.history.force.tobytes() == b.history.force.tobytes()
                and a.history.position.tobytes() == b.history.position.tobytes()
            )
        )
        for a, b in zip(one.cases, other.cases, strict=True)
    )


def names(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir())


def test_a_library_is_its_simulations(tmp_path: Path) -> None:
    looks: list[tuple[int, int]] = []
    library = build(plan_of(), tmp_path / "x.nc", progress=lambda *look: looks.append(look))
    for case in library.cases:
        assert case.history is not None
        assert (case.history.force == simulate(case.scenario).force).all()
    assert library.provenance["model_version"] == f"rft-{MODEL_VERSIONS['rft']}"
    assert same_forces(Library.load(tmp_path / "x.nc"), library)
    assert names(tmp_path) == ["x.nc"]
    assert looks == [(i, 5) for i in range(6)]


def test_an_interrupted_build_goes_on_where_it_stopped(
    tmp_path: Path, calls: Calls, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "x.nc"
    counting = building.simulate

    def impatient(scenario: Scenario, **options: Any) -> ForceHistory:
        if scenario.soil.friction_angle_deg == 35.0:
            raise KeyboardInterrupt
        return counting(scenario, **options)

    with monkeypatch.context() as patch:
        patch.setattr(building, "simulate", impatient)
        with pytest.raises(KeyboardInterrupt):
            build(plan_of(), file)
    assert not file.exists()
    assert len(names(cases_folder(file))) == 3
    looks: list[tuple[int, int]] = []
    resumed = build(plan_of(), file, progress=lambda *look: looks.append(look))
    assert calls == ANGLES  # three before, two after, none twice
    assert looks[0] == (3, 5)
    assert names(tmp_path) == ["x.nc"]
    assert same_forces(resumed, build(plan_of(), tmp_path / "y.nc"))


def test_a_finished_library_is_not_computed_again(tmp_path: Path, calls: Calls) -> None:
    first = build(plan_of(), tmp_path / "x.nc")
    again = build(plan_of(), tmp_path / "x.nc")
    assert len(calls) == 5
    assert same_forces(first, again)


def test_a_plan_that_grows_reuses_its_library(tmp_path: Path, calls: Calls) -> None:
    build(plan_of([25.0, 35.0]), tmp_path / "x.nc")
    grown = build(plan_of(legs=["straight", "c"]), tmp_path / "x.nc")
    assert calls == [25.0, 35.0, 20.0, 30.0, 40.0, *ANGLES]
    assert same_forces(grown, build(plan_of(legs=["straight", "c"]), tmp_path / "y.nc"))


def test_a_library_that_is_built_again_keeps_what_was_learnt_of_it(
    tmp_path: Path, calls: Calls
) -> None:
    path = tmp_path / "mine.nc"
    made = build(plan_of(), path)
    again = [c.scenario.replace(**{"numerics.seed": 7}) for c in made.cases[:2]]
    replicates = tuple(Case(s, simulate(s), "") for s in again)
    known = {"library_hash": made.hash, "certificate": {"seed": 0}}
    replace(made, replicates=replicates, calibration=known).save(path)
    # For nothing, then with one more angle, then without that of a replicate.
    same = build(plan_of(), path)
    assert [c.digest for c in same.replicates] == [c.digest for c in replicates]
    assert same.calibration == Library.load(path).calibration == known
    larger = build(plan_of([*ANGLES, 45.0]), path)
    assert [c.digest for c in larger.replicates] == [c.digest for c in replicates]
    assert larger.calibration == {}
    smaller = build(plan_of([ANGLES[1], *ANGLES[2:]]), path)
    assert [c.digest for c in smaller.replicates] == [replicates[1].digest]
    assert calls == [*ANGLES, 45.0]


def test_what_a_plan_no_longer_asks_for_is_kept(
    tmp_path: Path, calls: Calls, caplog: pytest.LogCaptureFixture
) -> None:
    """Of the library that it replaces, and of an interrupted build of another plan."""
    path, folder = tmp_path / "x.nc", cases_folder(tmp_path / "x.nc")
    build(plan_of(), path)
    folder.mkdir()
    other = plan_of([50.0]).cases()[0]
    simulate(other).to_netcdf(folder / f"{other.hash}.nc")
    (folder / "notes").mkdir()
    (folder / "notes.txt").write_text("mine")
    # What is no finished simulation goes.
    (folder / f"{plan_of([55.0]).cases()[0].hash}.checkpoint").write_text("half")
    with caplog.at_level(logging.WARNING):
        build(plan_of([25.0, 30.0, 60.0]), path)
    dropped = [s.hash for s in plan_of([20.0, 35.0, 40.0]).cases()]
    kept = sorted(["notes", "notes.txt", *(f"{name}.nc" for name in [other.hash, *dropped])])
    assert names(folder) == kept
    assert "4 finished simulations that the plan does not ask for are kept in" in caplog.text
    build(plan_of([*ANGLES, 50.0]), path)
    assert calls == [*ANGLES, 60.0]
    assert len(names(folder)) == 3  # that at 60° is kept now


def test_a_case_under_the_name_of_another_is_not_taken(
    tmp_path: Path, calls: Calls, caplog: pytest.LogCaptureFixture
) -> None:
    file = tmp_path / "x.nc"
    one, other = plan_of([25.0, 30.0]).cases()
    cases_folder(file).mkdir()
    simulate(other).to_netcdf(cases_folder(file) / f"{one.hash}.nc")
    with caplog.at_level(logging.WARNING):
        library = build(plan_of([25.0]), file)
    assert calls == [25.0]
    assert "holds another scenario than its name says" in caplog.text
    assert library.cases[0].history is not None
    assert (library.cases[0].history.force == simulate(one).force).all()


def test_a_machine_that_is_not_this_one_refuses_for_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("terraphi.forward.forecast.machine_bytes", lambda: 1.0)
    with pytest.raises(InputError, match="of memory, and this machine has"):
        build(plan_of(), tmp_path / "x.nc")
    with pytest.raises(InputError, match=r"every case failed, the first with: InputError.*memory"):
        build(plan_of(), tmp_path / "x.nc", memory=math.inf)


def test_two_builds_of_one_file_do_not_meddle_with_each_other(tmp_path: Path) -> None:
    path = tmp_path / "mine.nc"
    with held(cases_folder(path)):
        finished = cases_folder(path) / "of the other build"
        finished.touch()
        with pytest.raises(InputError, match=r"mine\.nc\.cases: another build is at work here"):
            build(plan_of(), path)
        assert finished.exists()
        assert not path.exists()
    assert len(build(plan_of(), path).cases) == len(ANGLES)


def test_another_version_of_the_model_is_computed_again(
    tmp_path: Path, calls: Calls, monkeypatch: pytest.MonkeyPatch
) -> None:
    build(plan_of(), tmp_path / "x.nc")
    monkeypatch.setitem(MODEL_VERSIONS, "rft", MODEL_VERSIONS["rft"] + 1)
    build(plan_of(), tmp_path / "x.nc")
    assert len(calls) == 10


def failing_at(angle: float, error: Exception) -> Callable[..., ForceHistory]:
    def fails(scenario: Scenario, **options: Any) -> ForceHistory:
        if scenario.soil.friction_angle_deg == angle:
            raise error
        return simulate(scenario, **options)

    return fails


@pytest.mark.parametrize(
    "error", [ValueError("too wet"), RuntimeError("blew up"), FloatingPointError("nan")]
)
def test_a_failed_case_is_recorded_and_tried_again(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    error: Exception,
) -> None:
    file = tmp_path / "x.nc"
    with monkeypatch.context() as patch:
        patch.setattr(building, "simulate", failing_at(30.0, error))
        library = build(plan_of(), file)
    key = "leg.shape = straight, soil.friction_angle_deg = 30.0"
    reason = f"{type(error).__name__}: {error}"
    assert library.failures == Library.load(file).failures == {key: reason}
    assert f"{key} failed: {reason}" in caplog.text
    assert library.curves("straight").phi_deg.tolist() == [20.0, 25.0, 35.0, 40.0]
    assert names(tmp_path) == ["x.nc"]

    seen: Calls = []
    monkeypatch.setattr(
        building,
        "simulate",
        lambda scenario, **_: (
            seen.append(scenario.soil.friction_angle_deg) or simulate(scenario)  # type: ignore[func-returns-value]
        ),
    )
    whole = build(plan_of(), file)
    assert seen == [30.0]
    assert whole.failures == {}


def test_a_failure_that_is_a_result_is_kept_and_not_tried_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    why = "went wrong at step 7; the last good state, before step 6, is in /some/where"
    seen: Calls = []

    def fails(scenario: Scenario, **options: Any) -> ForceHistory:
        seen.append(scenario.soil.friction_angle_deg)
        return failing_at(30.0, RuntimeError(why))(scenario, **options)

    monkeypatch.setattr(building, "simulate", fails)
    for tried in (ANGLES, []):
        seen.clear()
        finished, failures = building.simulate_cases(plan_of(), tmp_path, keep_failures=True)
        assert seen == tried
        assert len(finished) == 4
        reasons = {reason.partition(";")[0] for reason in failures.values()}
        assert reasons == {"RuntimeError: went wrong at step 7"}
    # Where the state was kept is of one machine and one day.
    assert building.failed_cases(tmp_path) == failures
    assert "/some/where" not in next(iter(failures.values()))
    # Another model may do better.
    monkeypatch.setitem(MODEL_VERSIONS, "rft", MODEL_VERSIONS["rft"] + 1)
    assert building.failed_cases(tmp_path) == {}


def test_a_failure_that_is_known_elsewhere_is_not_tried_again(tmp_path: Path, calls: Calls) -> None:
    plan = plan_of(ANGLES[:2])
    lost = plan.cases()[0].hash
    finished, failures = building.simulate_cases(
        plan, tmp_path / "cases", known_failures={lost: "it broke down there"}
    )
    assert failures == {lost: "it broke down there"}
    assert list(finished) == [plan.cases()[1].hash]
    assert calls == [ANGLES[1]]


def test_a_record_of_a_failure_that_cannot_be_read_is_tried_again(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / f"0abc{building.FAILURE}").write_text('{"reason": ')
    assert building.failed_cases(tmp_path) == {}
    assert "it will be tried again" in caplog.text


def test_a_case_that_the_model_refuses(tmp_path: Path) -> None:
    """Resistive force theory knows no cohesion, and says so."""
    plan = plan_of([25.0], **{"soil.cohesion": [0.0, 100.0]})
    assert "cohesion = 100 Pa" in next(iter(build(plan, tmp_path / "x.nc").failures.values()))


def test_no_library_of_failures_alone(tmp_path: Path) -> None:
    plan = plan_of(**{"soil.cohesion": [100.0]})
    with pytest.raises(
        InputError, match=r"plan 'mine': every case failed, the first with: .*cohes"
    ):
        build(plan, tmp_path / "x.nc")
    assert names(tmp_path) == []


@pytest.mark.parametrize("damage", ["truncated", "garbage", "empty", "no provenance"])
def test_a_broken_case_is_computed_again(
    tmp_path: Path, calls: Calls, damage: str, caplog: pytest.LogCaptureFixture
) -> None:
    file, plan = tmp_path / "x.nc", plan_of()
    folder = cases_folder(file)
    folder.mkdir()
    for scenario in plan.cases():
        simulate(scenario).to_netcdf(folder / f"{scenario.hash}.nc")
    victim = folder / f"{plan.cases()[2].hash}.nc"
    if damage == "no provenance":
        history = ForceHistory.from_netcdf(victim)
        ForceHistory(history.position, history.force).to_netcdf(victim)
    else:
        content = victim.read_bytes()
        victim.write_bytes({"truncated": content[:-100], "garbage": b"1" * 99}.get(damage, b""))
    with caplog.at_level(logging.WARNING):
        library = build(plan, file)
    assert calls == [30.0]
    assert library.failures == {}
    assert ("computed again" in caplog.text) == (damage != "no provenance")
    assert names(tmp_path) == ["x.nc"]


def test_a_case_of_a_scenario_unknown_today_is_computed_again(tmp_path: Path, calls: Calls) -> None:
    file, plan = tmp_path / "x.nc", plan_of([25.0])
    cases_folder(file).mkdir()
    scenario = plan.cases()[0]
    history = simulate(scenario)
    old = {**history.provenance, "scenario": {"soil": {"wetness": 3}}}
    ForceHistory(history.position, history.force, provenance=old).to_netcdf(
        cases_folder(file) / f"{scenario.hash}.nc"
    )
    build(plan, file)
    assert calls == [25.0]


def test_a_file_that_is_no_library_is_left_alone(tmp_path: Path, calls: Calls) -> None:
    file = tmp_path / "x.nc"
    file.write_text("my thesis")
    with pytest.raises(InputError, match=r"x\.nc: not a whole NetCDF"):
        build(plan_of(), file)
    assert calls == []
    assert file.read_text() == "my thesis"
    assert names(tmp_path) == ["x.nc"]


def test_a_place_that_cannot_be_written(tmp_path: Path, calls: Calls) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=r"x\.nc\.cases: cannot be made"):
        build(plan_of(), tmp_path / "file" / "x.nc")
    assert calls == []


def test_a_disk_that_fills_up_keeps_what_was_finished(
    tmp_path: Path, calls: Calls, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "x.nc"
    build(plan_of([20.0]), file)
    before = file.read_bytes()
    write = Path.write_bytes

    def fills_up(path: Path, content: bytes) -> int:
        if len(calls) == 3:
            raise OSError(28, "No space left on device")
        return write(path, content)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_bytes", fills_up)
        with pytest.raises(InputError, match=r"No space left on device.*free some space"):
            build(plan_of(), file)
    assert file.read_bytes() == before
    assert len(names(cases_folder(file))) == 1
    build(plan_of(), file)
    assert calls == [20.0, 25.0, 30.0, 30.0, 35.0, 40.0]


# -- long cases --------------------------------------------------------------------------------


def coarse_plan(**sweep: list[Any]) -> Plan:
    """Half a second a case, of several blocks of steps."""
    scenario = {
        "numerics": {
            "cells": 32,
            "speed_up": 20.0,
            "time_step": 5e-5,
            "contact_band_cells": 0.5,
        },
        "soil": {"yield_criterion": "plane_strain", "friction_angle_deg": 45.0},
        "bed": {"left": 0.010, "floor": 0.010, "width": 0.280, "height": 0.160},
        "motion": {"start_deg": -130.0, "stop_deg": -20.0},
    }
    return Plan.model_validate({"name": "coarse", "scenario": scenario, "sweep": sweep})


def test_a_solution_that_blows_up_is_recorded_and_the_build_goes_on(tmp_path: Path) -> None:
    """Associated flow whose particles swell with the soil, once the leg reaches it at -75°."""
    plan = coarse_plan(
        **{
            "numerics.particle_volume": ["updated"],
            "soil.flow": ["associated"],
            "motion.stop_deg": [-20.0, -110.0],
            "numerics.seed": [0, 1],
        }
    )
    file = tmp_path / "x.nc"
    library = build(plan, file)
    assert [bool(case.failure) for case in library.cases] == [True, True, False, False]
    for case in library.cases[:2]:
        assert case.failure.startswith("SimulationError: the solution broke down between steps ")
        for words in ("particle ", "theta = -", "likely cause: associated flow", "last good state"):
            assert words in case.failure
        kept = cases_folder(file) / f"{case.scenario.hash}.checkpoint"
        assert str(kept) in case.failure
        assert kept.is_file()
    assert Library.load(file).failures == library.failures
    assert len(names(cases_folder(file))) == 2

    # The next build tries again, from that state on, and finds the same; what succeeded stays.
    again = build(plan, file)
    assert again.failures == library.failures
    assert same_forces(again, library)


def test_a_case_that_was_stopped_is_taken_up_where_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, plan = tmp_path / "x.nc", coarse_plan(**{"numerics.seed": [0, 1]})
    told = 0

    def impatient(advance: float) -> None:
        nonlocal told
        told += 1
        if told == 7:  # in the middle of the second case
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(building, "heartbeat", impatient)
        with pytest.raises(KeyboardInterrupt):
            build(plan, file)
    first, second = (scenario.hash for scenario in plan.cases())
    assert names(cases_folder(file)) == sorted([f"{first}.nc", f"{second}.checkpoint"])
    resumed = build(plan, file)
    assert names(tmp_path) == ["x.nc"]
    histories = [case.history for case in resumed.cases if case.history]
    assert [history.provenance.get("resumed_at_step") for history in histories] == [None, [4000]]
    assert same_forces(resumed, build(plan, tmp_path / "y.nc"))


KILLED = """
import sys
from pathlib import Path
from terraphi.library.build import build
from terraphi.library.store import Plan
plan = Plan.model_validate_json(sys.stdin.read())
print("ready", flush=True)
build(plan, Path(sys.argv[1]), checkpoint_every=0.0)
"""


def test_a_killed_build_loses_no_more_than_the_interval(tmp_path: Path) -> None:
    """Killed as soon as its first checkpoint is there, then run to its end."""
    file, plan = tmp_path / "x.nc", coarse_plan(**{"numerics.seed": [0, 1]})
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    started = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(file)],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        env=environment,
    )
    assert started.stdin is not None
    started.stdin.write(plan.model_dump_json().encode())
    started.stdin.close()
    first = cases_folder(file) / f"{plan.cases()[0].hash}.checkpoint"
    for _ in range(6000):
        if first.exists():
            break
        time.sleep(0.01)
    started.kill()
    started.wait()
    assert not file.exists()
    resumed = build(plan, file)
    history = resumed.cases[0].history
    assert history is not None
    assert history.provenance["resumed_at_step"][0] >= 2000
    assert names(tmp_path) == ["x.nc"]
    assert same_forces(resumed, build(plan, tmp_path / "y.nc"))


def test_a_worker_that_sees_no_folder_keeps_nothing(tmp_path: Path) -> None:
    scenario = coarse_plan(**{"numerics.seed": [0]}).cases()[0].replace(**{"motion.stop_deg": -120})
    far = Checkpoint(tmp_path / "elsewhere" / "c", every=0.0)
    assert isinstance(building.run_case(scenario.model_dump_json(), far), ForceHistory)
    assert names(tmp_path) == []


# -- executors ---------------------------------------------------------------------------------


def test_any_executor_builds_the_same_library(tmp_path: Path) -> None:
    with ThreadPoolExecutor(3) as executor:
        threaded = build(plan_of(), tmp_path / "x.nc", executor=executor)
    assert same_forces(threaded, build(plan_of(), tmp_path / "y.nc"))


def test_two_processes_build_the_same_library(tmp_path: Path) -> None:
    plan = plan_of([*ANGLES, 85.0], **{"soil.cohesion": [0.0, 100.0]})
    looks: list[int] = []
    with WorkerPool(2) as pool:

        def look(finished: int, total: int) -> None:
            assert total == 12
            pool.counted(finished)
            looks.append(finished)

        parallel = build(plan, tmp_path / "x.nc", executor=pool.executor, progress=look)
        # The six that failed did so before they had done anything, and count as done all the same.
        assert pool.counted(6) == pytest.approx(6.0)
        assert pool.counted(12) == 12
    assert looks[0] == 0
    assert looks[-1] == 12
    assert looks == sorted(looks)
    serial = build(plan, tmp_path / "y.nc")
    assert same_forces(parallel, serial)
    assert same_forces(Library.load(tmp_path / "x.nc"), serial)
    assert len(serial.failures) == 6
    assert multiprocessing.active_children() == []


class Instead(Executor):
    """Another executor that runs one function whatever it is given."""

    def __init__(self, executor: Executor, function: Callable[..., Any]) -> None:
        self._executor, self._function = executor, function

    def submit(self, fn: Any, /, *args: Any, **options: Any) -> Future[Any]:
        return self._executor.submit(self._function, *args, **options)


def test_a_worker_that_dies_does_not_lose_the_others_results(
    tmp_path: Path, calls: Calls, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One worker takes 20°, 25° and dies over 30°; the pool is broken from then on."""
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    fatal = importlib.import_module("worker_tasks").run_or_die
    file = tmp_path / "x.nc"
    with WorkerPool(1) as pool, pytest.raises(InputError, match="worker was killed"):
        build(plan_of(), file, executor=Instead(pool.executor, fatal))
    # The cases that nobody tried are not failures, so there is no library yet.
    assert not file.exists()
    kept = [ForceHistory.from_netcdf(f) for f in cases_folder(file).iterdir()]
    angles = sorted(h.provenance["scenario"]["soil"]["friction_angle_deg"] for h in kept)
    assert angles == [20.0, 25.0]
    whole = build(plan_of(), file)
    assert calls == [30.0, 35.0, 40.0]
    assert same_forces(whole, build(plan_of(), tmp_path / "y.nc"))


def test_an_interrupted_parallel_build_cancels_what_waits(tmp_path: Path) -> None:
    """And keeps what was finished."""
    file = tmp_path / "x.nc"

    def impatient(finished: int, total: int) -> None:
        if finished == 2:
            raise KeyboardInterrupt

    class Slow(Executor):
        """Runs the first two tasks, and never the others."""

        def __init__(self) -> None:
            self.futures: list[Future[Any]] = []

        def submit(self, fn: Any, /, *args: Any, **options: Any) -> Future[Any]:
            future: Future[Any] = Future()
            if len(self.futures) < 2:
                future.set_result(fn(*args))
            self.futures.append(future)
            return future

    slow = Slow()
    with pytest.raises(KeyboardInterrupt):
        build(plan_of(), file, executor=slow, progress=impatient)
    assert [future.cancelled() for future in slow.futures] == [False, False, True, True, True]
    assert len(names(cases_folder(file))) == 2
    assert not file.exists()
