"""What a simulation will take, against simulations; and that nothing is laid out to be counted."""

from __future__ import annotations

import json
import math
import tracemalloc
from pathlib import Path
from typing import Any

import pytest

from terraphi.experiment.documents import shipped_names
from terraphi.experiment.errors import InputError
from terraphi.experiment.scenario import Scenario
from terraphi.forward import forecast as room
from terraphi.forward import simulate
from terraphi.forward.forecast import (
    YEAR,
    Forecast,
    code_for,
    compiles,
    forecast,
    foreseen,
    lasting,
    particle_count,
    place_of_code,
    refuse_too_long,
    refuse_too_many,
    refuse_what_cannot_fit,
    step_count,
)
from terraphi.library.plan import MOST_CASES, Plan
from terraphi.library.store import Library

COARSE = {
    "numerics.cells": 32, "numerics.speed_up": 20.0, "numerics.time_step": 5e-5,
    "bed.left": 0.01, "bed.floor": 0.01, "bed.width": 0.28, "bed.height": 0.16,
    "motion.start_deg": -80.0, "motion.stop_deg": -79.0,
}  # fmt: skip


def test_particles_and_steps_are_those_of_the_simulation() -> None:
    # At its start this leg is above the soil, so no particle is left out.
    coarse = Scenario().replace(**COARSE)
    made = simulate(coarse).provenance
    assert particle_count(coarse) == made["particles"]
    assert step_count(coarse) == made["steps"]
    assert forecast([coarse]).particle_steps == made["particles"] * made["steps"]


@pytest.mark.parametrize("name", ["paper", "resolved", "k4-plane-strain"])
def test_a_shipped_library_took_about_as_long_as_forecast(name: str) -> None:
    cases = Library.load(name).cases
    took = [c.history.provenance["seconds"]["all"] for c in cases if c.history]
    told = forecast([c.scenario for c in cases]).core_seconds
    # They were built on a machine of 512 bits that had more to do.
    assert 0.5 * told < sum(took) < 4.0 * told


def test_memory_is_that_of_the_arrays_at_least() -> None:
    from terraphi.forward.state import first_state

    fine = Scenario().replace(**{"numerics.cells": 256, "numerics.time_step": 2e-6})
    soil = first_state(fine).soil
    arrays = sum(field.nbytes for field in soil)
    # The state and its copy, packets, and a checkpoint made in memory.
    assert 3.0 * arrays < forecast([fine]).bytes - 350e6 < 8.0 * arrays


def test_several_add_up_and_share_the_cores() -> None:
    one = Scenario().replace(**COARSE)
    two = one.replace(**{"motion.stop_deg": -78.0})
    both = forecast([one, two])
    assert both.core_seconds == pytest.approx(3.0 * forecast([one]).core_seconds, rel=0.01)
    assert both.seconds(2) == pytest.approx(2.0 * forecast([one]).core_seconds, rel=0.01)
    assert both.memory(2) == both.memory(9) == 2.0 * both.memory(1)
    assert forecast([one, two], register_bits=128).seconds() > 2.0 * both.seconds()


FAR = {"motion.stop_deg": 1e9}
SLIDE = {
    "kind": "translation", "start": [0.15, 0.3], "velocity": [0.0, -0.1],
    "distance": 1e14, "bin_width": 1e-14,
}  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "key", "what"),
    [
        (FAR, "motion.stop_deg = 1e+09", "memory"),
        ({"model": "rft", **FAR}, "motion.stop_deg = 1e+09", "memory"),
        ({"model": "rft", "motion": SLIDE}, "motion.bin_width = 1e-14", "memory"),
        (
            {"numerics.cells": 4096, "numerics.particles_per_cell_side": 8,
             "numerics.time_step": 1e-7},
            "numerics.cells = 4096", "memory",
        ),
        ({"numerics.time_step": 1e-14}, "numerics.time_step = 1e-14", "years"),
        ({"motion.rate": 1e-9}, "motion.rate = 1e-09", "years"),
        ({"motion.rate": 1e-14}, "motion.rate = 1e-14", "years"),
    ],
)  # fmt: skip
def test_what_cannot_fit_is_refused_by_its_key(
    changes: dict[str, Any], key: str, what: str, monkeypatch
) -> None:
    monkeypatch.setattr(room, "machine_bytes", lambda: 64e9)
    tracemalloc.start()
    try:
        scenario = Scenario().replace(**changes)
        with pytest.raises(InputError) as refused:
            simulate(scenario)
        assert tracemalloc.get_traced_memory()[1] < 50e6
    finally:
        tracemalloc.stop()
    message = str(refused.value)
    assert key in message
    assert what in message
    assert "\n" not in message


@pytest.mark.parametrize("name", shipped_names("scenarios", ".toml"))
def test_shipped_scenarios_fit(name: str, monkeypatch) -> None:
    monkeypatch.setattr(room, "machine_bytes", lambda: 2e9)
    refuse_what_cannot_fit(Scenario.load(name))


def test_a_container_has_what_it_was_given(monkeypatch) -> None:
    monkeypatch.setattr(Path, "read_text", lambda _path: "1000000\n")
    assert room.machine_bytes() == 1e6
    monkeypatch.setattr(Path, "read_text", lambda _path: "max\n")
    assert room.machine_bytes() > 1e8


def test_too_many_workers_and_too_many_years(monkeypatch) -> None:
    monkeypatch.setattr(room, "machine_bytes", lambda: 10e9)
    large = Forecast(8, 1e6, 1e9, 100.0, 20.0, 3e9)
    refuse_too_many(large, 3, "plan 'p'")
    with pytest.raises(InputError, match=r"plan 'p': 4 simulations .* 12 GB .* --workers 3"):
        refuse_too_many(large, 4, "plan 'p'")
    long = Forecast(1000, 1e3, 1e9, 10.0 * YEAR, YEAR / 100.0, 1e6)
    refuse_too_many(long, 11, "plan 'p'")
    for refuse in (refuse_too_many, refuse_too_long):
        with pytest.raises(InputError, match="1,000 cases would take about 10 years on 1 core;"):
            refuse(long, 1, "plan 'p'")
    # Elsewhere there may be room.
    monkeypatch.setattr(room, "machine_bytes", lambda: 1e6)
    with pytest.raises(InputError, match="of memory, and this machine has"):
        refuse_what_cannot_fit(Scenario.load("quick"))
    refuse_what_cannot_fit(Scenario.load("quick"), memory=math.inf)


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (0.4, "less than a second"),
        (20.0, "about 20 s"),
        (119.0, "about 119 s"),
        (1500.0, "about 25 minutes"),
        (86400.0, "about 24 hours"),
        (3.0 * YEAR, "about 3 years"),
        (float("inf"), "over 10,000 years"),
    ],
)
def test_times_are_told_in_the_unit_people_would_take(seconds: float, words: str) -> None:
    assert lasting(seconds) == words


@pytest.mark.parametrize("name", shipped_names("plans", ".toml"))
def test_cases_are_counted_without_being_made(name: str) -> None:
    plan = Plan.load(name)
    assert plan.count == len(plan.cases())


def test_a_plan_of_millions_is_refused_before_it_is_laid_out() -> None:
    plan = Plan(
        name="huge",
        sweep={
            "soil.friction_angle_deg": [20.0 + 0.01 * i for i in range(500)],
            "soil.density": [1500.0 + i for i in range(300)],
            "numerics.seed": list(range(500)),
        },
    )
    assert plan.count == 75_000_000
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match=f"75,000,000 cases.*{MOST_CASES:,}.*friction_angle"):
            plan.cases()
        assert tracemalloc.get_traced_memory()[1] < 1e6
    finally:
        tracemalloc.stop()


QUICK = 'model = "rft"\ndimensions = 3\n'


def test_the_forecast_is_told_once_and_in_json(terraphi, tmp_path) -> None:
    (tmp_path / "s.toml").write_text(QUICK)
    status, out, err = terraphi("simulate", "s.toml", "--json")
    assert status == 0
    assert err.count("forecast: 1 simulation") == 1
    assert json.loads(out)["forecast"]["simulations"] == 1
    assert terraphi("simulate", "s.toml", "-q").err == ""


def test_the_forecast_of_a_library(terraphi, tmp_path) -> None:
    (tmp_path / "p.toml").write_text(
        'name = "p"\n[sweep]\n"soil.friction_angle_deg" = [25.0, 30.0]\n[scenario]\n' + QUICK
    )
    status, out, err = terraphi(
        "library", "build", "p.toml", "--out", "p.nc", "--workers", "1", "--json"
    )
    assert status == 0
    assert err.count("forecast: 2 simulations") == 1
    assert json.loads(out)["forecast"] | {"seconds": 0, "memory_bytes": 0} == {
        "simulations": 2, "particles": 0, "particle_steps": 0.0, "seconds": 0, "memory_bytes": 0,
        "cores": 1, "compiling_seconds": 0.0,
    }  # fmt: skip


def test_the_forecast_of_a_library_is_of_what_is_left(terraphi, tmp_path) -> None:
    """Of a build that was cut short, a plan that grew, and one that is whole."""

    def built(angles: str) -> tuple[str, int]:
        sweep = f'name = "p"\n[sweep]\n"soil.friction_angle_deg" = {angles}\n'
        (tmp_path / "p.toml").write_text(f"{sweep}[scenario]\n{QUICK}")
        status, out, err = terraphi(
            "library", "build", "p.toml", "--out", "p.nc", "--workers", "1", "--json"
        )
        assert status == 0
        return err, json.loads(out)["forecast"]["simulations"]

    assert "are left" not in built("[25.0, 30.0]")[0]
    err, simulations = built("[25.0, 30.0, 35.0]")
    assert (err.count("1 of 3 simulations are left"), simulations) == (1, 1)
    assert err.count("forecast: 1 simulation:") == 1
    err, simulations = built("[25.0, 30.0, 35.0]")
    assert (err.count("0 of 3 simulations are left"), simulations) == (1, 0)
    assert "forecast" not in err


@pytest.mark.parametrize("command", ["simulate", "library build"])
def test_nothing_is_written_of_what_cannot_fit(command: str, terraphi, tmp_path) -> None:
    head = "" if command == "simulate" else 'name = "p"\n[sweep]\n"numerics.seed" = [1, 2]\n'
    section = "motion" if command == "simulate" else "scenario.motion"
    (tmp_path / "x.toml").write_text(f"{head}[{section}]\nstop_deg = 1e9\n")
    status, out, err = terraphi(*command.split(), "x.toml", "--out", "x.nc")
    assert (status, out) == (2, "")
    assert err.count("\n") == 1
    assert "motion.stop_deg = 1e+09" in err
    assert [entry.name for entry in tmp_path.iterdir()] == ["x.toml"]


KINDS = {"paper-1": "packets.march", "resolved": "packet_phases.march", "space": "phase.step"}


@pytest.mark.parametrize("kind", KINDS)
def test_compiling_at_first_use_is_told(kind: str, monkeypatch, tmp_path) -> None:
    """Of that outermost function which the scenario calls, and of no other."""
    space = Plan.load("sand3d").cases()[0]
    scenarios = {n: space if n == "space" else Scenario.load(n) for n in KINDS}
    folder = tmp_path / "kernels"
    folder.mkdir()
    places = {code_for(s): place_of_code(code_for(s)) for s in scenarios.values()}
    monkeypatch.setattr(room, "place_of_code", lambda code: (folder, places[code][1]))
    for name in KINDS.values():
        (folder / f"{name}-1.py311.nbi").touch()
    assert not compiles(scenarios.values())
    assert "compiling" not in foreseen(list(scenarios.values())).sentence()
    (folder / f"{KINDS[kind]}-1.py311.nbi").unlink()
    for name, scenario in scenarios.items():
        assert ("of compiling at first use" in foreseen([scenario]).sentence()) == (name == kind)
        assert compiles([scenario]) == (name == kind)
    assert foreseen([Scenario(model="rft")]).compiling_seconds == 0.0
