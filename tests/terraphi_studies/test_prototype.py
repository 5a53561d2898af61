"""What the prototype's contact counts and applies; on made-up histories."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

import terraphi_studies as studies
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.measurements import measurement
from terraphi.experiment.scenario import Scenario
from terraphi.library.plan import Plan
from terraphi_studies import prototype
from terraphi_studies.benchmark import FinishedCase

THETA = np.radians(np.arange(-95.0, 20.0, 0.1) + 0.05)
PLAN = Plan.load("prototype")


def history(fz: float, fx: float, applied: float) -> ForceHistory:
    """Two broad bumps with these peaks [N], of which a share is applied; kept by the degree."""
    shape = [np.exp(-(((THETA - math.radians(at)) / 0.5) ** 2)) for at in (0.0, -50.0)]
    force = np.stack([fx * shape[0], fz * shape[1]], axis=1)
    kept = applied * force.reshape(-1, 10, 2).mean(axis=1)
    known = {"position": THETA.reshape(-1, 10).mean(axis=1), "x_N": kept[:, 0], "z_N": kept[:, 1]}
    provenance = {"applied_force": {name: values.tolist() for name, values in known.items()}}
    return ForceHistory(THETA, force, provenance=provenance)


def by_name(found: dict[str, ForceHistory]) -> dict[str, ForceHistory]:
    """Histories by the hash of the scenario that the plan has under a name."""
    names = {PLAN.scenario.name: PLAN.scenario.hash} | {
        variant.key: variant.scenario.hash for variant in PLAN.variants()
    }
    return {names[name]: made for name, made in found.items()}


def test_a_force_that_grows_with_the_speed_is_told_from_one_that_does_not() -> None:
    def at(k: float) -> ForceHistory:
        return history(4.0 + 3.0 * k, 5.0 + 2.0 * k, applied=0.5)

    at_45 = history(14.0, 15.5, applied=0.25)
    found = prototype.study_of(
        PLAN,
        by_name({"25°, its code": at(1.0), "25°, its code, k = 2": at(2.0),
                 "25°, its code, k = 4": at(4.0), "45°, its code": at_45}),
    )  # fmt: skip
    lines = {(ln["phi_deg"], ln["kind"], ln["force"]): ln for ln in found.data["without_speed"]}
    assert {phi for phi, _, _ in lines} == {25.0}
    for kind, part in (("counted", 1.0), ("applied", 0.5)):
        for force, left, share in (("Fz", 4.0, 4.0 / 7.0), ("Fx", 5.0, 5.0 / 7.0)):
            line = lines[25.0, kind, force]
            assert line["peak_N"] == pytest.approx(part * left, rel=1e-3)
            assert line["share"] == pytest.approx(share, rel=1e-3)
            assert line["line_off_percent"] < 0.1
            assert line["speeds"] == [1.0, 2.0, 4.0]
    # Half is not applied; of the other half 4/7 of the lift and 5/7 of the thrust stay.
    (parts,) = [note for note in found.notes if "are not applied" in note]
    assert "50 to 50 % are not applied, 14 to 21 % are applied and go with the speed" in parts
    assert "29 to 36 % are left" in parts
    row = next(row for row in found.table.rows if row[0] == "25°, its code, a line to k = 0")
    assert row[1:5] == ("4.0 N", "5.0 N", "2.0 / 2.5 N", "50 / 50 %")
    said = next(note for note in found.notes if note.startswith("its code, counted"))
    assert "leaves 57 to 71 % at k = 0" in said
    (case,) = [c for c in found.data["cases"] if c["name"] == "45°, its code"]
    assert case["share_of_peaks"] == pytest.approx({"Fz": 0.25, "Fx": 0.25}, rel=1e-3)
    assert case["share_of_path"] == pytest.approx({"Fz": 0.25, "Fx": 0.25}, rel=1e-3)
    assert case["angles_deg"] == {"Fz": -50.0, "Fx": 0.0}
    # At 45° exactly the paper's, at 25° by (7/8.6 - 1, 7/10.2 - 1).
    off = math.sqrt(((7.0 / 8.6 - 1.0) ** 2 + (7.0 / 10.2 - 1.0) ** 2) / 4.0)
    assert found.data["off_by_percent"]["its code"] == pytest.approx(100.0 * off, abs=0.2)
    assert "25°, hip at 190 mm" in found.data["missing"]
    json.dumps(found.everything(), allow_nan=False)


def test_deviations_from_the_sand_are_of_what_is_finished() -> None:
    sand = measurement("li2013:yuma/straight")
    at = np.radians(np.arange(-89.5, 90.0))
    measured = sand.history.means(at, np.radians(0.5))
    kept = {"position": at.tolist(), "x_N": measured[:, 0].tolist(), "z_N": measured[:, 1].tolist()}
    twice = ForceHistory(
        sand.history.position, 2.0 * sand.history.force, provenance={"applied_force": kept}
    )
    scenario = Scenario.load("paper-code-1").replace(**{"soil.density": sand.density_kg_m3})
    found = prototype._in_yuma([FinishedCase(scenario, twice)])
    # 35° is an angle of library paper; twice the sand's force is off by its root mean square.
    (row,) = found
    assert row["phi_deg"] == 35.0
    assert row["applied"] == pytest.approx({"Fx": 0.0, "Fz": 0.0}, abs=0.3)
    assert min(row["counted"].values()) > 10.0
    assert set(row) == {"phi_deg", "counted", "applied", "text"}


def test_what_is_shipped_is_of_the_plan() -> None:
    found = studies.run("prototype")
    data = found.everything()
    assert data["missing"] == []
    assert [line["what"] for line in data["beside_paper"]] == [
        "peaks Fz / Fx at 25°", "peaks Fz / Fx at 45°",
        "leg angle of first resistance (ours: median)",
    ]  # fmt: skip
    for case in data["cases"]:
        # Of a contact that counts what it applies, all; of the prototype's, by far not.
        share = case["share_of_path"].values()
        if case["model"] == "its text":
            assert list(share) == pytest.approx([1.0, 1.0], abs=1e-3)
        else:
            assert 0.3 < min(share) <= max(share) < 0.7
    angles = {row["phi_deg"] for row in data["nrmsd_percent"]}
    assert 25.0 in angles
    assert set(found.figures) == {"prototype"}


def test_damping_keeps_its_factor_a_step() -> None:
    for variant in PLAN.variants():
        numerics = variant.scenario.numerics
        assert numerics.damping_factor == pytest.approx(0.997, abs=1e-8)
