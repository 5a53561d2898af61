"""The benchmark's deviations, against a sum written out and the published figures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import terraphi_studies as studies
from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.measurements import measurement, reference_rft
from terraphi.library import shipped as choices
from terraphi.library.plan import Plan
from terraphi.library.store import Case, Library
from terraphi_studies import benchmark
from terraphi_studies.benchmark import case_at
from terraphi_studies.measures import nrmsd_percent


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
    monkeypatch.setattr(choices, "shipped_names", lambda *_: ["mine", "mine-legs"])
    shipped = {"mine": straight, "mine-legs": legs}
    monkeypatch.setattr(Library, "load", staticmethod(shipped.__getitem__))
    assert case_at("mine", "straight").scenario.convention == "paper"
    found = case_at("mine", "c")
    assert (found.scenario.convention, found.scenario.leg.shape) == ("plane_strain", "c")
    assert found.scenario.soil.friction_angle_deg == 35.0
    with pytest.raises(InputError, match="no case of leg 'plate' at 35 deg"):
        case_at("mine", "plate")


def half_applied(case: Case) -> Case:
    """A case whose contact applied half of what it counted, kept by the degree."""
    assert case.history is not None
    position = np.radians(np.arange(-134.5, 135.0))
    force = case.history.means(position, np.radians(0.5)) / 2.0
    kept = {"position": position, "x_N": force[:, 0], "z_N": force[:, 1]}
    known = {"applied_force": {name: values.tolist() for name, values in kept.items()}}
    return case._replace(history=replace(case.history, provenance=known))


def test_the_prototype_s_contact_is_told_once_its_libraries_are_whole(ship) -> None:
    whole = Library.load("quick-paper")
    sand = measurement("li2013:yuma/c")
    for name, legs in (("paper-code", ["straight"]), ("paper-code-legs", ["c", "reversed_c"])):
        with pytest.raises(InputError, match=f"^library '{name}' is planned, and its .* not all"):
            benchmark.by_the_prototype("c", sand)
        at = [c for c in whole.cases if c.scenario.soil.friction_angle_deg == benchmark.PHI_DEG]
        cases = [half_applied(c) for c in at if c.scenario.leg.shape in legs]
        ship(name, replace(whole, cases=tuple(cases)))
    found = studies.run("benchmark")
    assert found.data["missing"] == {}
    assert len(found.notes) == 1
    for leg, models in found.data["nrmsd_percent"].items():
        counted, measured = case_at("quick-paper", leg).history, f"li2013:yuma/{leg}"
        for model, factor in (("paper_code", 1.0), ("paper_code_applied", 0.5)):
            expected = nrmsd_percent(measurement(measured).history, counted.scaled(factor))
            assert models[model] == pytest.approx(expected, abs=0.1)
        said = [what for what, _, _ in found.beside_paper if leg in what.split(",")[0].split()]
        assert said == [f"leg {leg}, {m}: NRMSD Fz / Fx" for m in ("MPM", "prototype", "RFT")]


def test_that_the_prototype_s_contact_waits_is_told(ship) -> None:
    found = studies.run("benchmark")
    assert all("paper_code" not in models for models in found.data["nrmsd_percent"].values())
    assert list(found.data["missing"]) == ["straight", "c", "reversed_c"]
    (note,) = found.notes[1:]
    assert note.startswith("Left out: paper_code, leg straight, c, reversed_c: library ")
    assert "'paper-code' is planned, and its 11 simulations are not all finished yet" in note


def test_the_prototype_s_pair_of_k0(ship) -> None:
    for half in ("jaky", "half"):
        library = Library.load(f"quick-k0-{half}")
        ends = tuple(c for c in library.cases if c.scenario.soil.friction_angle_deg in (25.0, 45.0))
        ship(f"paper-code-k0-{half}", replace(library, cases=ends))
    found = studies.run("k0", library="paper-code-k0")
    assert [case["phi_deg"] for case in found.data["cases"]] == [25.0, 45.0]


def test_pairs_of_k0_are_planned_over_the_same_cases() -> None:
    jaky, half = (Plan.load(f"paper-code-k0-{end}").cases() for end in ("jaky", "half"))
    code = Plan.load("paper-code").cases()
    assert [c.soil.friction_angle_deg for c in jaky] == [25.0, 45.0]
    assert [c.replace(**{"soil.k0": 0.5}) for c in jaky] == half
    same = {"soil.friction_angle_deg": 25.0, "numerics.seed": 0}
    assert {c.replace(**same).hash for c in (*jaky, code[0])} == {code[0].hash}


@pytest.mark.parametrize(
    ("study", "library", "named"),
    [
        ("phi_sensitivity", "paper-code", "paper-code"),
        ("recovery", "paper-code", "paper-code"),
        ("k0", "paper-code-k0", "paper-code-k0-jaky"),
    ],
)
def test_a_library_that_is_planned_alone_is_told(study, library, named, ship) -> None:
    with pytest.raises(InputError, match=f"^library '{named}' is planned, .* not all finished yet"):
        studies.run(study, library=library)
