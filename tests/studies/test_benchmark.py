"""The benchmark's deviations, against a sum written out and the published figures."""

from __future__ import annotations

import numpy as np
import pytest

from terraphi.errors import InputError
from terraphi.history import ForceHistory
from terraphi.library import Library
from terraphi.measurements import measurement, reference_rft
from terraphi.studies import benchmark
from terraphi.studies.benchmark import case_at, nrmsd_percent


def test_deviation_of_a_constant_offset() -> None:
    theta = np.radians(np.arange(-90.0, 91.0))
    force = np.stack([np.cos(theta), np.sin(theta)], axis=1)
    offset = ForceHistory(theta, force + np.array([0.1, 0.2]))
    measured = ForceHistory(theta, force)
    found = nrmsd_percent(measured, offset)
    assert found["Fx"] == pytest.approx(10.0 / (1.0 - np.cos(np.radians(84.0))), rel=1e-3)
    assert found["Fz"] == pytest.approx(20.0 / (2.0 * np.sin(np.radians(84.0))), rel=1e-3)


@pytest.mark.parametrize(
    ("leg", "fz", "fx"),
    [("straight", 11.5, 3.5), ("c", 23.7, 16.5), ("reversed_c", 188.7, 75.9)],
)
def test_published_deviations_of_the_authors_own_theory(leg: str, fz: float, fx: float) -> None:
    # Xu & Wang print these for the resistive force theory of Li et al. in Yuma sand.
    name = f"li2013:yuma/{leg}"
    found = nrmsd_percent(measurement(name).history, reference_rft(name))
    assert found["Fz"] == pytest.approx(fz, abs=1.5)
    assert found["Fx"] == pytest.approx(fx, abs=1.5)


def test_forces_are_brought_to_the_density_of_the_sand() -> None:
    case = benchmark.case_at("quick-paper", "straight")
    sand = measurement("li2013:poppy_loose/straight")
    assert sand.density_kg_m3 == 638.0
    found = benchmark.in_the_sand(case, sand)
    assert found.Fz == pytest.approx(case.history.Fz * 638.0 / 1650.0)
    assert benchmark._rft(sand, dimensions=3).soil.density == 638.0


def test_a_leg_comes_from_the_library_or_else_from_its_companion(monkeypatch) -> None:
    here, legs = Library.load("quick-paper"), Library.load("quick-plane-strain")
    straight = Library(
        here.plan, tuple(c for c in here.cases if c.scenario.leg.shape == "straight")
    )
    monkeypatch.setattr(benchmark, "shipped_names", lambda *_: ["mine", "mine-legs"])
    shipped = {"mine": straight, "mine-legs": legs}
    monkeypatch.setattr(Library, "load", staticmethod(shipped.__getitem__))
    assert case_at("mine", "straight").scenario.convention == "paper"
    found = case_at("mine", "c")
    assert (found.scenario.convention, found.scenario.leg.shape) == ("plane_strain", "c")
    assert found.scenario.soil.friction_angle_deg == 35.0
    with pytest.raises(InputError, match="no case of leg 'plate' at 35 deg"):
        case_at("mine", "plate")
