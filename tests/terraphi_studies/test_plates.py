"""The study of plates: the measured windows, and tables that cannot be used."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from terraphi.experiment.errors import InputError
from terraphi.forward.foot_laws import Foot
from terraphi.library.plan import Plan
from terraphi.robot.footfall_fit import Prior
from terraphi_studies import Study, plates
from terraphi_studies.planned import Simulations
from terraphi_studies.pressed import pressed_discs


@pytest.fixture(scope="module")
def found() -> Study:
    return plates.run()


def test_resistive_force_theory_reads_the_windows_as_measured(found: Study) -> None:
    """26.4–29.5° with the 60 mm plate and 30.1–33.8° with that of 100 mm, by another program."""
    read: dict[float, list[float]] = {60.0: [], 100.0: []}
    for test in found.data["tests"]:
        if test["law"] == "rft":
            read[test["diameter_mm"]] += [p for p in test["phi_by_window_deg"] if p is not None]
    for width, low, high in ((60.0, 26.0, 30.0), (100.0, 30.0, 34.2)):
        assert all(low < phi < high for phi in read[width])


def test_footfalls_take_their_law_term_from_here(found: Study) -> None:
    assert Prior().law_sd_deg == pytest.approx(found.data["law_sd_deg"], abs=0.1)


def test_absolute_interval_holds_the_angle_of_repose(found: Study) -> None:
    held = [t["ci95_absolute"][0] < 29.0 < t["ci95_absolute"][1] for t in found.data["tests"]]
    assert np.mean(held) > 0.9


def test_a_table_of_ones_own(tmp_path: Path) -> None:
    """A plate that obeys the law exactly, in units that the table names."""
    lines = [",".join(plates.COLUMNS)]
    from terraphi.forward.foot_laws import LAWS

    for depth in np.arange(0.5, 20.0, 0.5):
        force = LAWS["rft"].force(
            Foot(0.04, "disc"), depth / 1e3, np.pi / 2, friction_angle_deg=31.0,
            density=plates.DENSITY, surface_friction=0.5,
        )[1]  # fmt: skip
        lines.append(f"small,a,80,{depth},{force}")
    table = tmp_path / "own.csv"
    table.write_text("\n".join(lines))
    study = plates.run(data=table)
    (test,) = [t for t in study.data["tests"] if t["law"] == "rft"]
    assert test["phi_deg"] == pytest.approx(31.0, abs=0.1)
    assert test["box"] == "small"


@pytest.mark.filterwarnings("error")
def test_a_table_without_readings_in_a_window_has_no_spread(tmp_path: Path) -> None:
    lines = [f"deep,a,80,{depth},{5.0 * depth}" for depth in range(30, 50)]
    table = tmp_path / "deep.csv"
    table.write_text("\n".join([",".join(plates.COLUMNS), *lines]))
    study = plates.run(data=table)
    assert study.data["law_sd_deg"] is None
    assert not any("scatters" in note for note in study.notes)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("box,test,diameter_mm,sinkage_mm\n", "lacks the column 'force_N'"),
        ("box,test,diameter_mm,sinkage_mm,force_N\na,1,60,x,1\n", "line 2: holds what is not"),
        ("box,test,diameter_mm,sinkage_mm,force_N\na,1,0.06,1,1\n", "line 2: diameter 0.06 mm"),
        ("box,test,diameter_mm,sinkage_mm,force_N\n", "holds no readings"),
    ],
)
def test_an_unusable_table_is_told(tmp_path: Path, text: str, says: str) -> None:
    table = tmp_path / "bad.csv"
    table.write_text(text)
    with pytest.raises(InputError, match=says):
        plates.run(data=table)


def test_simulated_plates_are_foretold_from_their_neighbours() -> None:
    """Each simulated history through the law, at its own density and at another's."""
    plan = Plan.load("plates")
    finished = Simulations().histories(plan)
    for case in plan.cases():
        history = finished[case.hash]
        late = history.position > 4e-3
        foretold = pressed_discs().force(
            Foot(0.5 * case.leg.width, "disc"), history.position[late], 0.5 * np.pi,
            friction_angle_deg=case.soil.friction_angle_deg, density=2.0 * case.soil.density,
            surface_friction=0.5,
        )[:, 1]  # fmt: skip
        upward = history.force[late, history.axes.index("z")]
        assert foretold.mean() == pytest.approx(2.0 * upward.mean(), rel=0.02)


def test_a_plate_between_the_simulated_ones_bears_a_force_between_theirs() -> None:
    def lift(radius: float, phi: float) -> float:
        found = pressed_discs().force(
            Foot(radius, "disc"), 0.015, 0.5 * np.pi, friction_angle_deg=phi, density=1330.0,
            surface_friction=0.5,
        )  # fmt: skip
        return float(found[1])

    for phi in (24.0, 29.0, 35.0):
        assert lift(0.03, phi) < lift(0.04, phi) < lift(0.05, phi)
        assert lift(0.04, phi) < lift(0.04, phi + 1.0)
    with pytest.raises(InputError, match="43 to 140 mm, not a disc of 200 mm"):
        lift(0.1, 30.0)


def own_table(folder: Path, width: int, first: float) -> Path:
    """A plate whose force is 3 N a millimetre, over 40 mm."""
    rows = [f"small,a,{width},{depth},{3 * depth}" for depth in first + np.arange(0.0, 40.0, 0.5)]
    table = folder / "own.csv"
    table.write_text("\n".join([",".join(plates.COLUMNS), *rows]))
    return table


@pytest.mark.parametrize(("width", "first"), [(200, 0.5), (80, 30.0)])
def test_what_was_not_simulated_is_asked_of_the_other_laws(
    tmp_path: Path, width: int, first: float
) -> None:
    """Too wide, or deeper than any simulated plate from the start on: no reading is cut."""
    (whole,) = plates.read(own_table(tmp_path, width, first))
    tests, laws = plates.asked([whole])
    assert "mpm3d" not in laws
    assert tests == [whole]


def test_a_plate_that_is_too_wide_to_have_been_simulated_has_its_other_laws(tmp_path: Path) -> None:
    study = plates.run(data=own_table(tmp_path, 200, 0.5))
    assert {test["law"] for test in study.data["tests"]} == set(plates.LAWS)
