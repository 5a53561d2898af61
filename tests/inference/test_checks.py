"""Sensor faults put into a measured record: found, left out, and the angle kept."""

from __future__ import annotations

import functools
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import terraphi
from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.measurements import measurement, names
from terraphi.experiment.scenario import Scenario
from terraphi.forward import simulate
from terraphi.inference.answer import Answer
from terraphi.inference.checks import without_faults
from terraphi.inference.inversion import invert
from terraphi.inference.records import Record, open_record

GRAINS = Path(__file__).parents[2] / "studies" / "data" / "grains"
NAME = "li2013:poppy_loose/straight"


@functools.cache
def plain(name: str) -> Answer:
    """The answer to a shipped record as it is."""
    record = measurement(name)
    history = replace(record.history, provenance={})
    return invert(history, rig=record.rig, density=record.density_kg_m3)


def damaged(change) -> ForceHistory:
    record = measurement(NAME)
    force = record.history.force.copy()
    change(np.degrees(record.history.position), force)
    return replace(record.history, force=force, provenance={})


def answer_to(change):
    return invert(damaged(change), rig="li2013", leg="straight", density=638.0)


def test_shipped_records_have_no_faults() -> None:
    for record in map(without_faults, map(open_record, names())):
        assert not record.damage
        assert record.n_left_out <= 0.05 * len(record.history.position)


def grain_records() -> list[Record]:
    """Of legs in simulated grains, whose forces begin and end sharply."""
    records = []
    for leg in ("straight", "c"):
        for path in sorted(GRAINS.glob(f"?-loose_{leg}_1.csv")):
            table = pd.read_csv(path, comment="#", usecols=["theta_deg", "Fx_N", "Fz_N"])
            records.append(open_record(table, rig="li2013", leg=leg, density=1500.0))
    return records


def with_zeros(record: Record, where: np.ndarray) -> Record:
    force = np.where(where[:, None], 0.0, record.history.force)
    return without_faults(replace(record, history=replace(record.history, force=force)))


def has_dropouts(record: Record) -> bool:
    return any("dropouts" in note for note in record.notes)


def test_zeros_in_soil_are_dropouts_and_those_in_air_are_not() -> None:
    records = [*map(open_record, names()), *grain_records()]
    assert len(records) > 20
    for record in records:
        theta = record.history.theta_deg
        largest = np.abs(record.history.force).max(axis=1)
        for late_deg in (0.0, 5.0, 10.0):  # legs meet the soil up to 9 degrees late
            first, last = np.array(record.rig.air_deg()) + np.array([late_deg, -late_deg])
            air = (theta < first) | (theta > last)
            assert not has_dropouts(with_zeros(record, air)), (record.source, late_deg)
            lost = air.copy()
            lost[np.argmax(np.where(air, 0.0, largest))] = True
            assert has_dropouts(with_zeros(record, lost)), (record.source, late_deg)


def test_zeros_of_a_sensor_that_starts_late_in_the_soil_are_dropouts() -> None:
    record = open_record("li2013:yuma/straight")
    part = replace(record, history=record.history.chosen(record.history.theta_deg > -40.0))
    result = with_zeros(part, np.arange(len(part.history.theta_deg)) < 4)
    assert has_dropouts(result)
    assert result.history.theta_deg[0] == part.history.theta_deg[4]


def dropouts(theta, force):
    force[(theta > -40) & (theta < -37)] = 0.0


def gap(theta, force):
    """Where the lift is steep, so that it differs by a third across it."""
    force[(theta > -66) & (theta < -50)] = 0.0


def spikes(theta, force):
    for at in (-55.0, -20.0, 12.0):
        force[np.abs(theta - at).argmin()] += 6.0


def overflow(theta, force):
    """One reading of a million newtons, of which the others are small parts of a step."""
    force[np.abs(theta + 2.0).argmin(), 0] = 1e6


def held(theta, force):
    inside = (theta > -35) & (theta < -27)
    force[inside, 1] = force[np.flatnonzero(inside)[0], 1]


@pytest.mark.parametrize("change", [dropouts, gap, spikes, overflow])
def test_faults_that_hide_readings_are_left_out(change) -> None:
    answer = answer_to(change)
    assert answer.records[0].n_left_out > 0
    assert answer.verdict == "consistent"
    assert answer.phi.median == pytest.approx(plain(NAME).phi.median, abs=0.4)


def test_held_values_are_left_out() -> None:
    """On the lift of the C, which changes fast."""
    reference = measurement("li2013:glass03_close/c")
    force, theta = reference.history.force.copy(), np.degrees(reference.history.position)
    inside = (theta > -58) & (theta < -50)
    force[inside, 1] = force[np.flatnonzero(inside)[0], 1]
    record = open_record(
        replace(reference.history, force=force, provenance={}),
        rig="li2013",
        leg="c",
        density=1550.0,
    )
    assert without_faults(record).n_left_out >= inside.sum() - 2


def clipped(theta, force):
    np.clip(force[:, 1], None, 0.7 * force[:, 1].max(), out=force[:, 1])


def step(theta, force):
    force[theta > -15.0, 0] += 2.5


def offset(theta, force):
    force[:, 1] += 0.8


@pytest.mark.parametrize("change", [clipped, step, offset])
def test_faults_that_shift_readings_are_misfits(change) -> None:
    answer = answer_to(change)
    assert answer.verdict == "misfit"
    assert answer.warnings


def test_a_record_of_faults_is_refused() -> None:
    def mostly_zero(theta, force):
        force[(theta > -70) & (theta < 60) & (np.arange(len(theta)) % 4 != 0)] = 0.0

    with pytest.raises(InputError, match=r"faulty|no reading"):
        answer_to(mostly_zero)


@pytest.mark.parametrize(
    ("name", "theta", "fx", "fz"),
    [("li2013:yuma/straight", 1, -1, 1), ("li2013:yuma/straight", 1, 1, -1),
     ("li2013:yuma/straight", -1, 1, 1), ("li2013:glass03_close/c", -1, -1, 1),
     ("li2013:glass03_close/c", 1, 1e3, 1e3)],
)  # fmt: skip
def test_the_option_that_is_offered_mends_the_record(
    name: str, theta: float, fx: float, fz: float
) -> None:
    record = measurement(name)
    history, options = record.history, {"rig": record.rig, "density": record.density_kg_m3}
    columns = {"theta": theta * history.theta_deg, "Fx": fx * history.Fx, "Fz": fz * history.Fz}
    answer = invert(pd.DataFrame(columns), **options)
    assert answer.verdict != "consistent"
    [offer] = [sentence for sentence in answer.warnings if "would fall" in sentence]
    remedy = offer.partition("--columns ")[2].partition(":")[0]
    if not remedy:  # the C's shape does not determine the size of its forces
        assert "unit=mN" in offer
        remedy = "unit=mN"
    mended = invert(pd.DataFrame(columns), columns=remedy, **options)
    assert mended.verdict == "consistent"
    assert mended.phi.median == pytest.approx(plain(name).phi.median, abs=1e-4)


def turned_cell(history: ForceHistory, angle_deg: Any) -> pd.DataFrame:
    """What a load cell reads whose z axis tips forward by an angle [deg]."""
    turn = np.exp(1j * np.radians(angle_deg))
    read = (history.Fx + 1j * history.Fz) * turn  # its axes turn clockwise seen from x to z
    return pd.DataFrame({"theta_deg": history.theta_deg, "Fx_N": read.real, "Fz_N": read.imag})


def advice(answer) -> list[str]:
    return [warning for warning in answer.warnings if "--columns" in warning or "--leg" in warning]


@pytest.mark.parametrize(("name", "angle"), [("yuma/c", -45), ("glass03_loose/reversed_c", 90)])
def test_a_turned_load_cell_is_named_with_its_angle(name: str, angle: float) -> None:
    """Within 10°: real soil differs from the model by so much of a turn."""
    record = measurement(f"li2013:{name}")
    table, options = turned_cell(record.history, angle), {"rig": record.rig, "density": 1500.0}
    answer = invert(table, **options)
    assert answer.verdict != "consistent"
    [offer] = advice(answer)
    offered = offer.partition("--columns ")[2].partition(":")[0]
    key, _, value = offered.partition("=")
    assert key == "sensor_angle_deg"
    assert float(value) == pytest.approx(angle, abs=10.0)
    assert invert(table, columns=offered, **options).verdict == "consistent"
    as_it_is = invert(replace(record.history, provenance={}), **options)
    right = invert(table, columns={"sensor_angle_deg": angle}, **options)
    assert right.phi.median == pytest.approx(as_it_is.phi.median, abs=1e-4)


@pytest.mark.parametrize(("name", "mount"), [("poppy_loose/straight", 0), ("poppy_loose/c", 90)])
def test_a_load_cell_on_the_leg_is_named(name: str, mount: int) -> None:
    """And one that is not, where it was said to be."""
    record = measurement(f"li2013:{name}")
    history, options = record.history, {"rig": record.rig, "density": record.density_kg_m3}
    table = turned_cell(history, history.theta_deg + mount)
    [offer] = advice(invert(table, **options))
    offered = offer.partition("--columns ")[2].partition(":")[0]
    assert offered == "sensor_turns=true" + (f",sensor_angle_deg={mount:g}" if mount else "")
    right = invert(replace(history, provenance={}), **options)
    mended = invert(table, columns=offered, **options)
    assert mended.verdict == "consistent"
    assert mended.phi.median == pytest.approx(right.phi.median, abs=0.2)  # tared in other axes
    still = invert(turned_cell(history, 0.0), columns={"sensor_turns": True}, **options)
    assert any("sensor_turns=false" in warning for warning in advice(still))


@pytest.mark.parametrize("scale", [0.5, 1.6])
def test_a_wrong_scale_of_the_angle_is_named(scale: float) -> None:
    """About its own zero, which an offset was given for."""
    record = measurement(NAME)
    history, options = record.history, {"rig": record.rig, "density": record.density_kg_m3}
    table = turned_cell(history, 0.0).assign(theta_deg=scale * history.theta_deg + 20.0)
    answer = invert(table, columns={"theta_offset_deg": -20.0}, **options)
    [offer] = advice(answer)
    offered = offer.partition("--columns ")[2].partition(":")[0]
    pairs = {key: float(value) for key, _, value in (p.partition("=") for p in offered.split(","))}
    assert pairs["theta_scale"] == pytest.approx(1.0 / scale, rel=0.1)
    mended = invert(table, columns=pairs, **options)
    assert mended.verdict == "consistent"
    assert mended.phi.median == pytest.approx(plain(NAME).phi.median, abs=1.5)


def test_no_reading_is_advised_where_two_fit() -> None:
    """Behind the hip a reversed C has much the forces before it, of the other sign of Fz."""
    record = measurement("li2013:glass03_close/reversed_c")
    flipped = replace(record.history, force=record.history.force * [1.0, -1.0], provenance={})
    answer = invert(flipped, rig=record.rig, density=record.density_kg_m3)
    assert answer.verdict != "consistent"
    assert not advice(answer)
    [pair] = [warning for warning in answer.warnings if "fz_sign=-1" in warning]
    assert "theta_sign=-1" in pair


DAMAGES = {
    "gain of Fx": lambda theta, x, z: (theta, 2.0 * x, z),
    "gain of Fz": lambda theta, x, z: (theta, x, 0.5 * z),
    "crosstalk": lambda theta, x, z: (theta, x + 0.3 * z, z),
    "drift": lambda theta, x, z: (theta, x + 0.3 * np.ptp(x) * (theta / 264 + 0.5), z),
    "zero of the angle": lambda theta, x, z: (theta + 25.0, x, z),
    "square root": lambda theta, x, z: (theta, *(np.sign(f) * np.sqrt(np.abs(f)) for f in (x, z))),
}


@pytest.mark.parametrize(
    ("name", "damage"),
    [*zip(["poppy_loose/c", "glass03_loose/reversed_c"] * 3, DAMAGES, strict=True)],
)
def test_a_misfit_for_another_reason_is_advised_no_angle(name: str, damage: str) -> None:
    record = measurement(f"li2013:{name}")
    history = record.history
    theta, x, z = DAMAGES[damage](history.theta_deg, history.Fx, history.Fz)
    table = pd.DataFrame({"theta_deg": theta, "Fx_N": x, "Fz_N": z})
    answer = invert(table, rig=record.rig, density=record.density_kg_m3)
    assert not any(
        key in warning
        for warning in answer.warnings
        for key in ("sensor_angle", "sensor_turns", "theta_scale")
    )


@pytest.mark.parametrize("given", [{"force_on": "soil"}, {"fx_sign": -1}, {"theta_sign": -1}])
def test_an_option_that_was_given_wrongly_is_turned_back(given: dict) -> None:
    record = measurement("li2013:yuma/straight")
    history = record.history
    columns = {"theta": history.theta_deg, "Fx": history.Fx, "Fz": history.Fz}
    answer = invert(
        pd.DataFrame(columns), rig=record.rig, density=record.density_kg_m3, columns=given
    )
    [offer] = [warning for warning in answer.warnings if "--columns" in warning]
    key, _, value = offer.partition("--columns ")[2].partition(":")[0].partition("=")
    assert {key: value} == {
        warning: {"soil": "leg", -1: "1"}[old] for warning, old in given.items()
    }


def test_of_two_legs_that_fit_the_one_that_other_physics_confirms_is_offered() -> None:
    """By `reversed_c` the record is consistent too, at 43 instead of 30°."""
    answer = invert("li2013:yuma/straight", leg="c")
    assert answer.verdict == "misfit"
    assert any("--leg straight" in warning for warning in answer.warnings)


@pytest.mark.parametrize(("chord", "begins"), [(0.0762, False), (0.045, True)])
def test_a_short_leg_is_noticed(chord: float, begins: bool) -> None:
    scenario = {"model": "rft", "dimensions": 3, "leg": {"chord": chord}}
    made = simulate(Scenario.model_validate(scenario))
    answer = invert(
        ForceHistory(made.position, made.force), rig="li2013", leg="straight", density=1650
    )
    assert any("Contact begins" in warning for warning in answer.warnings) == begins


def logged(name: str, change) -> pd.DataFrame:
    """A shipped record as a rig logs it: three seconds of rest, a stroke, three seconds of rest.

    A change adds to the forces by the share of the time and the leg angle [deg], [row, 2].
    """
    history = measurement(name).history
    moving = np.arange(-132.0, 132.0, 0.5)
    theta = np.concatenate([np.full(75, -132.0), moving, np.full(75, 132.0)])
    force = np.stack(
        [np.interp(theta, history.theta_deg, item) for item in history.force.T], axis=1
    )
    force[:75] = force[-75:] = 0.0
    force += 0.02 * np.random.default_rng(0).standard_normal(force.shape)
    force += change(np.linspace(0.0, 1.0, len(theta))[:, None], np.radians(theta)[:, None])
    return pd.DataFrame({"theta_deg": theta, "Fx_N": force[:, 0], "Fz_N": force[:, 1]})


ZERO = np.array([-0.5, 1.0])
CHANGES = {
    "zero": lambda t, theta: ZERO + 0.0 * t,
    "drift": lambda t, theta: ZERO + t * np.array([0.7, -0.8]),
    "weight": lambda t, theta: ZERO + np.sin(theta) * [0.8, -0.4] + np.cos(theta) * [-0.4, 0.8],
}


@pytest.mark.parametrize(
    ("name", "change"),
    [("li2013:yuma/straight", "zero"), ("li2013:poppy_loose/c", "drift"),
     ("li2013:yuma/straight", "weight")],
)  # fmt: skip
def test_a_record_is_put_right_by_what_the_sensor_reads_in_air(name: str, change: str) -> None:
    record = measurement(name)
    options = {"rig": record.rig, "density": record.density_kg_m3}
    answer = invert(logged(name, CHANGES[change]), **options)
    assert answer.verdict == "consistent"
    assert answer.phi.median == pytest.approx(plain(name).phi.median, abs=0.8)
    as_it_is = {"air_before_deg": -180.0, "air_after_deg": 180.0}
    assert invert(logged(name, CHANGES[change]), columns=as_it_is, **options).verdict == "misfit"


@pytest.mark.parametrize("name", ["li2013:yuma/straight", "li2013:poppy_loose/reversed_c"])
def test_a_good_record_is_left_as_it_is(name: str) -> None:
    record = measurement(name)
    history, options = record.history, {"rig": record.rig, "density": record.density_kg_m3}
    table = {"theta_deg": history.theta_deg, "Fx_N": history.Fx, "Fz_N": history.Fz}
    answer = invert(pd.DataFrame(table), **options)
    assert answer.phi.median == pytest.approx(plain(name).phi.median, abs=1e-6)


def test_forces_of_another_leg_in_soil_are_not_taken_for_air() -> None:
    frame = logged("li2013:glass03_close/reversed_c", CHANGES["zero"])
    assert invert(frame, rig="li2013", leg="straight", density=1550.0).verdict != "consistent"


@pytest.mark.parametrize("name", names()[::4])
def test_a_coarse_sensor_widens_the_interval(name: str) -> None:
    record = measurement(name)
    history, options = record.history, {"rig": record.rig, "density": record.density_kg_m3}
    rounded = replace(history, force=0.5 * np.round(history.force / 0.5), provenance={})
    answer = invert(rounded, **options)
    assert answer.verdict == plain(name).verdict
    difference = abs(answer.phi.median - plain(name).phi.median)
    assert difference < 2.5 * answer.budget_deg["noise"]


def grains_frame(name: str) -> pd.DataFrame:
    table = np.loadtxt(GRAINS / f"{name}.csv", delimiter=",", skiprows=3)[:, :3]
    return pd.DataFrame(table, columns=["theta_deg", "Fx_N", "Fz_N"])


@pytest.mark.parametrize("share", [0.5, 0.65])
@pytest.mark.parametrize(
    ("name", "leg"), [("C-loose_straight_1", "straight"), ("B-loose_c_1", "c"),
                      ("E-loose_reversed_c_1", "reversed_c")],
)  # fmt: skip
def test_a_ceiling_is_seen_though_the_forces_of_rough_soil_fall_below_it(
    name: str, leg: str, share: float
) -> None:
    frame = grains_frame(name)
    given = {"rig": "li2013", "leg": leg, "density": 1400, "grain_size_mm": 6.0}
    assert not any("saturates" in text for text in invert(frame, **given).warnings)
    frame["Fx_N"] = frame["Fx_N"].clip(upper=share * frame["Fx_N"].max())
    answer = invert(frame, **given)
    assert answer.verdict == "misfit"
    assert "saturates" in answer.warnings[0]


@pytest.mark.parametrize("name", ["B-loose_straight_1", "B-loose_straight_2", "A-loose_straight_1"])
def test_a_sensor_without_its_zero_is_named_and_no_leg(name: str) -> None:
    """In air its readings are all the same: they are its zero, and no values that were held."""
    frame = grains_frame(name)
    frame["Fx_N"] += 0.7
    frame["Fz_N"] -= 1.3
    answer = invert(frame, rig="li2013", leg="straight", density="1418±30", grain_size_mm=6.0)
    assert answer.verdict == "misfit"
    assert "in air" in answer.warnings[0]
    assert "reversed_c" not in answer.reason
    assert not any("cohesion" in text for text in answer.warnings)


def test_stated_angles_in_air_tare_a_record_or_are_refused() -> None:
    frame = grains_frame("B-loose_straight_1")
    given = {"rig": "li2013", "leg": "straight", "density": "1418±30", "grain_size_mm": 6.0}
    right = invert(frame, **given).phi.median
    tared = invert(frame, columns={"air_before_deg": -81.0}, **given)  # it was zero there
    assert tared.phi.median == pytest.approx(right, abs=1e-6)
    frame["Fx_N"] += 0.7
    frame["Fz_N"] -= 1.3
    answer = invert(frame, columns={"air_before_deg": -81.0}, **given)
    assert answer.verdict == "consistent"
    assert answer.phi.median == pytest.approx(right, abs=0.3)
    for angle, why in ((-120.0, "no reading is there"), (60.0, "not those of air")):
        with pytest.raises(InputError, match=why):
            invert(frame, columns={"air_before_deg": angle}, **given)


def test_tools_have_usual_angles_too() -> None:
    frame = pd.read_csv(GRAINS / "B-loose_disc_60_1.csv", comment="#")
    right = invert(frame, tool="plate:60", density="1416±30", grain_size_mm=6.0)
    assert not any("unusual" in text for text in right.warnings)
    frame["Fz_N"] /= 4.448  # lbf, labelled N
    wrong = invert(frame, tool="plate:60", density="1416±30", grain_size_mm=6.0)
    assert any("unusual for dry soil" in text for text in wrong.warnings)


def test_two_soils_as_one_are_a_misfit_on_one_leg() -> None:
    given = {"rig": "li2013", "leg": "straight", "density": "1418±30", "grain_size_mm": 6.0}
    pair = [GRAINS / f"{soil}-loose_straight_1.csv" for soil in "BC"]
    assert invert(pair, **given).verdict == "misfit"
    same = [GRAINS / f"B-loose_straight_{seed}.csv" for seed in (1, 2)]
    assert invert(same, **given).verdict == "consistent"


def test_grains_of_a_calibration_that_a_record_does_not_state_are_named() -> None:
    given = {"rig": "li2013", "leg": "straight", "density": "1400±30"}
    file = GRAINS / "B-loose_straight_1.csv"
    calibration = terraphi.calibrate(file, 26.8, 1.0, grain_size_mm=6.0, **given)
    other = {"forces": GRAINS / "C-loose_straight_1.csv", "calibration": calibration, **given}
    assert any("grains of 6 mm" in text for text in invert(**other).warnings)
    stated = invert(**other, grain_size_mm=6.0)
    assert not any("grains of 6 mm, and" in text for text in stated.warnings)


def test_a_cohesion_without_its_error_is_known_to_a_third() -> None:
    given = {"rig": "li2013", "leg": "straight", "density": "1418±30", "grain_size_mm": 6.0}
    file = GRAINS / "B-loose_straight_1.csv"
    bare, stated = (invert(file, cohesion=c, **given).phi for c in ("150", "150±50"))
    assert (bare.median, bare.sd) == pytest.approx((stated.median, stated.sd))
    assert bare.sd > invert(file, cohesion="150±0", **given).phi.sd + 0.1
