"""What a simulation will take, against simulations; and what cannot fit is refused."""

from __future__ import annotations

import tracemalloc
from typing import Any

import pytest

from terraphi.experiment.errors import InputError
from terraphi.experiment.scenario import Scenario
from terraphi.forward import forecast as module
from terraphi.forward import simulate
from terraphi.forward.forecast import forecast, step_count


def test_particles_and_steps_are_those_of_the_simulation(space) -> None:
    # At its start this leg is above the soil, so no particle is left out.
    scenario = space.scenario(**{**space.away, "motion.stop_deg": -179.0})
    made = simulate(scenario).provenance
    assert forecast(scenario).particles == made["particles"]
    assert step_count(scenario) == made["steps"]


def test_memory_is_that_of_the_arrays_at_least(space) -> None:
    fine = space.scenario(**{"numerics.cells": 80, "numerics.time_step": 3e-5})
    arrays = sum(field.nbytes for field in space.solver(fine, "packets").bed())
    assert arrays < forecast(fine).bytes - module.BYTES_AT_REST < 8.0 * arrays


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"motion.stop_deg": 1e9}, "GB of memory"),
        ({"model": "rft", "motion.stop_deg": 1e9}, "GB of memory"),
        (
            {"numerics.cells": 4096, "numerics.particles_per_cell_side": 8,
             "numerics.time_step": 1e-7},
            "GB of memory",
        ),
        ({"numerics.time_step": 1e-14}, "years"),
        ({"motion.rate": 1e-14}, "years"),
    ],
)  # fmt: skip
def test_what_cannot_fit_is_refused(changes: dict[str, Any], what: str, monkeypatch) -> None:
    monkeypatch.setattr(module, "machine_bytes", lambda: 64e9)
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match=what):
            simulate(Scenario().replace(**changes))
        assert tracemalloc.get_traced_memory()[1] < 50e6  # nothing is laid out to be counted
    finally:
        tracemalloc.stop()
