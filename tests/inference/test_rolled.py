"""φ from a wheel's slip, load and sinkage."""

from __future__ import annotations

import re
import warnings
from functools import lru_cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import terraphi
from terraphi.experiment.documents import shipped_file
from terraphi.experiment.errors import InputError
from terraphi.experiment.priors import FRICTION
from terraphi.laws.foot import LAWS, Foot
from terraphi.laws.wheel import Wheel, rolling

GRAINS = Path(__file__).parents[2] / "studies" / "data" / "grains"
CRITICAL_DEG = {"A": 20.0, "B": 26.4, "C": 31.9}
TOOL, WHEEL = "wheel:300x150", Wheel(0.15, 0.15)


SLIP, LOAD_N = np.array([0.05, 0.1, 0.2, 0.3, 0.4]), 100.0
ROLLING = lru_cache(lambda phi: rolling(WHEEL, LOAD_N, SLIP, np.array([phi]), np.array([1600.0])))


def rows(phi: float) -> pd.DataFrame:
    """A wheel under one load at several slips, in soil of the law of 1600 kg/m³."""
    each = {name: values[0] for name, values in ROLLING(phi).items()}
    return pd.DataFrame({"slip": SLIP, "load_N": LOAD_N, **each})


@pytest.mark.parametrize("phi", [28.0, 34.0])
def test_own_rows_return_their_angle(phi: float) -> None:
    answer = terraphi.invert(rows(phi), tool=TOOL, density="1600±1")
    assert answer.phi.median == pytest.approx(phi, abs=0.3)
    assert answer.verdict == "consistent"
    assert not any("check" in warning for warning in answer.warnings)


def test_names_units_and_definitions_of_slip_do_not_matter(tmp_path: Path) -> None:
    table = rows(32.0)[["slip", "load_N", "sinkage_mm"]]
    expected = terraphi.invert(table, tool=TOOL, density=1600).phi.median
    omega = 1.5
    speeds = pd.DataFrame({
        "omega [rad/s]": omega, "v [mm/s]": 150.0 * omega * (1.0 - table.slip),
        "Fz [N]": table.load_N, "z [cm]": 0.1 * table.sinkage_mm,
    })  # fmt: skip
    percent = pd.DataFrame({
        "Wheel slip [%]": 100.0 * table.slip, "Vertikallast [kN]": 1e-3 * table.load_N,
        "sinkage [m]": 1e-3 * table.sinkage_mm,
    })  # fmt: skip
    for variant in (speeds, percent):
        answer = terraphi.invert(variant, tool=TOOL, density=1600)
        assert answer.phi.median == pytest.approx(expected, abs=0.05)
    table.to_csv(tmp_path / "wheel.csv", index=False)
    answer = terraphi.invert(f"{tmp_path}/wheel.csv@{TOOL}", density=1600)
    assert answer.phi.median == pytest.approx(expected, abs=0.05)
    answer.save(tmp_path / "answer")
    assert terraphi.Answer.load(tmp_path / "answer").phi.median == answer.phi.median


def test_braked_slip_needs_its_definition() -> None:
    table = rows(32.0).iloc[:3]
    braked = table.assign(slip=[-0.1, -0.25, 0.1])
    with pytest.raises(InputError, match="slip_is"):
        terraphi.invert(braked, tool=TOOL)
    travel = terraphi.invert(braked, tool=TOOL, columns="slip_is=travel")
    driven = braked.assign(slip=[1.0 - 1.0 / 0.9, 1.0 - 1.0 / 0.75, 0.1])
    same = terraphi.invert(driven, tool=TOOL, columns="slip_is=driven")
    assert same.phi.median == pytest.approx(travel.phi.median, abs=1e-6)


def test_more_load_at_a_sinkage_is_a_larger_angle_and_more_weight_a_smaller() -> None:
    table = rows(30.0)
    base = terraphi.invert(table, tool=TOOL, density=1600)
    heavier = terraphi.invert(table.assign(load_N=1.3 * table.load_N), tool=TOOL, density=1600)
    denser = terraphi.invert(table, tool=TOOL, density=1900)
    assert denser.phi.median < base.phi.median < heavier.phi.median
    assert heavier.phi.median - base.phi.median == pytest.approx(2.2, abs=1.2)


def test_phi_along_the_way_follows_the_soil() -> None:
    halves = [rows(phi).iloc[[1, 2]] for phi in (28.0, 34.0)]
    table = pd.concat([half for half in halves for _ in range(8)], ignore_index=True)
    table["time_s"] = np.arange(len(table), dtype=float)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        along = terraphi.phi_along(table, TOOL, density=1600)
    first, last = (along["phi_deg"][part].mean() for part in (slice(16), slice(16, None)))
    assert last - first == pytest.approx(6.0, abs=0.7)
    assert (along["sd_relative_deg"] < along["sd_deg"]).all()
    assert along["sd_relative_deg"].max() < 1.6
    assert any("Misfit" in str(warning.message) for warning in caught)
    assert (along["time_s"] == table.time_s).all()


def test_a_mean_lies_within_its_rows_and_an_outlier_moves_little() -> None:
    rng = np.random.default_rng(4)
    table = pd.concat([rows(30.0)] * 12, ignore_index=True)
    noisy = table.assign(sinkage_mm=table.sinkage_mm + rng.normal(0.0, 0.5, len(table)))
    answer = terraphi.invert(noisy, tool=TOOL, density=1600)
    assert answer.phi.median == pytest.approx(30.0, abs=0.7)
    assert answer.verdict == "consistent"
    spiked = table.iloc[:10].copy()
    spiked.loc[3, "sinkage_mm"] = 0.5
    assert terraphi.invert(spiked, tool=TOOL, density=1600).phi.median == pytest.approx(
        30.0, abs=0.7
    )


def test_columns_with_gaps_and_the_sign_of_the_torque() -> None:
    table = pd.concat([rows(31.0)] * 25, ignore_index=True)  # more than are read one by one
    gaps = table.assign(torque_Nm=np.where(np.arange(len(table)) % 2, table.torque_Nm, np.nan))
    whole, part = (terraphi.invert(t, tool=TOOL, density=1600) for t in (table, gaps))
    assert part.phi.median == pytest.approx(whole.phi.median, abs=0.3)
    brakes = rows(31.0).drop(columns="pull_N").assign(torque_Nm=-rows(31.0).torque_Nm)
    assert any("brakes" in text for text in terraphi.invert(brakes, tool=TOOL).warnings)


@pytest.mark.parametrize("friction", ["0.05±0.02", "0.65±0.05", "0.3"])
def test_a_stated_friction_is_kept(friction: str) -> None:
    table = rows(31.0)
    answer = terraphi.invert(table, tool=TOOL, friction=friction, density=1600)
    assert answer.leg_friction == float(friction.partition("±")[0])
    with pytest.raises(InputError, match="friction"):
        terraphi.invert("li2013:yuma/c", friction=friction)


def test_rows_that_contradict_each_other_are_a_misfit() -> None:
    table = rows(30.0)
    crossed = table.assign(sinkage_mm=table.sinkage_mm.to_numpy()[::-1])
    assert terraphi.invert(crossed, tool=TOOL, density=1600).verdict == "misfit"


@pytest.mark.parametrize("column", ["torque_Nm", "pull_N"])
def test_a_torque_or_pull_that_no_soil_bears_is_a_misfit(column: str) -> None:
    table = rows(30.0)
    wrong = table.assign(**{column: 0.9 * table.load_N * (0.15 if column == "torque_Nm" else 1.0)})
    assert terraphi.invert(wrong, tool=TOOL).verdict == "misfit"


def test_a_torque_beyond_soil_and_rim_is_named_once() -> None:
    """Rows that brake are in the verdict's median alone, so that two sentences had two numbers."""
    table = rows(30.0)
    table["torque_Nm"] = 0.15 * table.load_N * [1.2, 1.4, 1.6, 1.8, 2.0]
    table.loc[0, "slip"] = 0.0
    answer = terraphi.invert(table, tool=TOOL)
    assert answer.verdict == "misfit"
    sentences = [answer.reason, *answer.warnings]
    assert sum("load times radius" in sentence for sentence in sentences) == 1


def test_a_torque_beyond_soil_is_named_where_the_verdict_is_another() -> None:
    """The verdict's median has the rows without slip, or the load is out of range before."""
    table = rows(30.0)
    table["torque_Nm"] = 0.15 * table.load_N * [0.1, 0.1, 0.1, 1.4, 1.4]
    table["slip"] = [0.0, 0.02, 0.05, 0.2, 0.3]
    heavy = table.assign(load_N=30.0 * table.load_N)
    heavy["torque_Nm"] = 3.0 * 0.15 * heavy.load_N
    for wrong, verdict in ((table, "consistent"), (heavy, "out_of_range")):
        answer = terraphi.invert(wrong, tool=TOOL)
        assert answer.verdict == verdict
        assert any("The torque is" in warning for warning in answer.warnings)


def test_a_pull_without_sense_is_named() -> None:
    """One that goes up and down about the law's, and is as large as it on average."""
    path = shipped_file("examples", "wheel", ".csv")
    table = pd.read_csv(path, comment="#")
    tool = "wheel:314.7x165"
    assert not any("scatters" in text for text in terraphi.invert(table, tool=tool).warnings)
    table["pull_N"] = [-30.0, 40.0, -10.0, 30.0, 0.0, 60.0]
    assert any("The pull scatters" in text for text in terraphi.invert(table, tool=tool).warnings)


def test_a_wheel_beside_a_leg_has_a_picture(tmp_path: Path) -> None:
    """Whose bodies differ in friction."""
    wheel = f"{shipped_file('examples', 'wheel', '.csv')}@wheel:314.7x165"
    answer = terraphi.invert([wheel, "li2013:yuma/straight"], density=1605)
    assert answer.leg_friction is None
    answer.save(tmp_path / "both")
    assert (tmp_path / "both" / "answer.png").stat().st_size > 10_000


def test_cohesion_of_a_wheel_is_refused_with_its_reason() -> None:
    dry = terraphi.invert(rows(30.0), tool=TOOL, cohesion="0")
    assert dry.phi == terraphi.invert(rows(30.0), tool=TOOL).phi
    with pytest.raises(InputError, match="as in dry soil"):
        terraphi.invert(rows(30.0), tool=TOOL, cohesion="500±100")


def test_a_pull_of_the_other_sign_is_named() -> None:
    path = shipped_file("examples", "wheel", ".csv")
    table = pd.read_csv(path, comment="#")
    answer = terraphi.invert(table.assign(pull_N=-table.pull_N), tool="wheel:314.7x165")
    assert any("pull differs" in warning for warning in answer.warnings)
    assert not any("pull" in w for w in terraphi.invert(path, tool="wheel:314.7x165").warnings[:1])


def test_a_pull_that_falls_with_the_slip_is_named_without_a_torque() -> None:
    table = rows(32.0).drop(columns="torque_Nm")
    turned = table.assign(pull_N=-table.pull_N)
    texts = [
        " ".join(terraphi.invert(t, tool=TOOL, density=1600).warnings) for t in (table, turned)
    ]
    assert ["check its sign" in text for text in texts] == [False, True]


def test_rows_deeper_than_the_law_are_left_out() -> None:
    table = rows(30.0)
    deep = table.assign(sinkage_mm=[*table.sinkage_mm[:4], 120.0])
    answer = terraphi.invert(deep, tool=TOOL, density=1600)
    assert answer.phi.median == pytest.approx(30.0, abs=0.5)
    assert any("deeper" in warning for warning in answer.warnings)
    with pytest.raises(InputError, match="deeper"):
        terraphi.invert(table.assign(sinkage_mm=120.0), tool=TOOL)


def test_joint_answer_with_a_plate_of_the_same_soil() -> None:
    z = np.linspace(1e-3, 0.06, 60)
    force = LAWS["foot"].force(
        Foot(0.0755, "disc"), z, 0.5 * np.pi, friction_angle_deg=31.0, density=1550.0,
        surface_friction=FRICTION.mean,
    )[:, 1]  # fmt: skip
    plate = pd.DataFrame({"sinkage_mm": 1e3 * z, "force_N": force})
    answer = terraphi.invert([(rows(30.0), TOOL), (plate, "plate:151")], density=1550)
    assert len(answer.records) == 2
    assert answer.phi.sd < terraphi.invert(rows(30.0), tool=TOOL, density=1550).phi.sd


def test_published_wheel_is_within_the_interval() -> None:
    """Ding et al. (2011): a smooth wheel on sand whose angle is printed as 31.9°."""
    path = shipped_file("examples", "wheel", ".csv")
    answer = terraphi.invert(path, tool="wheel:314.7x165", density=1605)
    low, high = answer.phi.ci95
    assert answer.verdict == "consistent"
    assert low < 31.9 < high


def test_picture_has_what_was_measured_and_the_law_of_a_stored_answer(tmp_path: Path) -> None:
    path = shipped_file("examples", "wheel", ".csv")
    answer = terraphi.invert(path, tool="wheel:314.7x165", density=1605)
    answer.save(tmp_path / "answer")
    stored = type(answer).load(tmp_path / "answer")
    table = pd.read_csv(path, comment="#")
    for axes in stored.plot().axes:
        if (role := axes.get_ylabel()) in ("sinkage [mm]", "pull [N]", "torque [N m]"):
            name = role.replace(" [", "_").rstrip("]").replace("N m", "Nm")
            law, points = axes.get_lines()
            np.testing.assert_allclose(points.get_ydata(), table[name])
            # Ding et al. by their own φ: within 10 % of the range in the median.
            residual = np.abs(law.get_ydata() - table[name]) / np.ptp(table[name])
            assert np.median(residual) < 0.1
    table = table.drop(columns="sinkage_mm")
    unsunk = terraphi.invert(table, tool="wheel:314.7x165", density=1605)
    assert len(unsunk.plot().axes) == 5


@pytest.mark.parametrize("soil", CRITICAL_DEG)
def test_wheels_in_grains_lie_within_the_interval(soil: str) -> None:
    paths = [*GRAINS.glob(f"{soil}-loose_wheel_120x25_s*_1.csv")]
    assert len(paths) >= 4
    for path in paths:
        density = float(re.findall(r"density (\d+)", path.read_text(encoding="utf-8"))[0])
        table = pd.read_csv(path, comment="#")
        table = table[(table.sinkage_mm - table.sinkage_mm.max()).abs() < 0.01].iloc[15:]
        slip = float(re.findall(r"_s([-.0-9]+)_", path.name)[0])
        row = table[["load_N", "sinkage_mm"]].mean().to_frame().T.assign(slip=slip)
        answer = terraphi.invert(row, tool="wheel:120x25", density=density, grain_size_mm=6,
                                 columns="slip_is=travel")  # fmt: skip
        low, high = answer.phi.ci95
        assert low < CRITICAL_DEG[soil] < high


def test_without_a_sinkage_pull_and_torque_determine_a_wide_angle() -> None:
    table = rows(32.0).drop(columns="sinkage_mm")
    answer = terraphi.invert(table, tool=TOOL, density=1600)
    deep = rows(32.0)["sinkage_mm"].median()
    depths = re.findall(r"law has (\d+) to (\d+) mm", " ".join(answer.warnings))[0]
    assert answer.phi.median == pytest.approx(32.0, abs=1.5)
    assert 3.0 < answer.phi.sd < 7.0
    assert float(depths[0]) < deep < float(depths[1])
    with pytest.raises(InputError, match="sinkage"):
        terraphi.phi_along(table, TOOL)


@pytest.mark.parametrize("column", ["pull_N", "torque_Nm"])
def test_pull_or_torque_alone_leave_the_prior(column: str) -> None:
    """The mean of a uniform angle from 18 to 50° is 34°, its standard deviation 9.2°."""
    table = rows(24.0)[["slip", "load_N", column]]
    answer = terraphi.invert(table, tool=TOOL, density=1600)
    assert answer.phi.sd > 6.5
    assert answer.phi.ci95[0] < 22.0
    assert answer.phi.ci95[1] > 43.0
    assert any("posterior equals the prior" in text for text in answer.warnings)


def test_a_pull_above_the_torque_is_no_angle() -> None:
    """P v ≤ T ω: at a small slip the pull is less than the torque over the radius."""
    table = rows(30.0).drop(columns="sinkage_mm").iloc[:2]
    wrong = table.assign(pull_N=table.torque_Nm / 0.15 + 0.2 * table.load_N)
    assert terraphi.invert(wrong, tool=TOOL).verdict == "misfit"


def test_wheels_in_grains_without_a_sinkage() -> None:
    inside = []
    for path in GRAINS.glob("?-loose_wheel_120x25_s0*_1.csv"):
        soil = path.name[0]
        if soil not in CRITICAL_DEG:
            continue
        density = float(re.findall(r"density (\d+)", path.read_text(encoding="utf-8"))[0])
        table = pd.read_csv(path, comment="#")
        table = table[(table.sinkage_mm - table.sinkage_mm.max()).abs() < 0.01].iloc[15:]
        row = table[["load_N", "pull_N", "torque_Nm"]].mean().to_frame().T
        row["slip"] = float(re.findall(r"_s([.0-9]+)_", path.name)[0])
        low, high = terraphi.invert(row, tool="wheel:120x25", density=density).phi.ci95
        inside.append(low < CRITICAL_DEG[soil] < high)
    assert len(inside) >= 12
    assert np.mean(inside) >= 0.9


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"slip": [5, 10, 20, 30, 40]}, "slip_unit"),
        ({"load_N": -100.0}, "load"),
        ({"sinkage_mm": 160.0}, "radius"),
        ({"slip": 0.9}, "slip"),
    ],
)
def test_bad_rows_are_one_sentence(change: dict[str, object], words: str) -> None:
    with pytest.raises(InputError, match=words) as raised:
        terraphi.invert(rows(30.0).assign(**change), tool=TOOL)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("column", ["slip", "load_N", "sinkage_mm"])
def test_a_column_that_lacks_is_named(column: str) -> None:
    table = rows(30.0)[["slip", "load_N", "sinkage_mm"]].drop(columns=column)
    with pytest.raises(InputError, match=column.partition("_")[0]):
        terraphi.invert(table, tool=TOOL)


@pytest.mark.parametrize("text", ["wheel:300", "wheel:300x150+lugs:2x10", "wheel:300x150+30x100"])
def test_a_wheel_that_is_none(text: str) -> None:
    with pytest.raises(InputError, match="tool"):
        terraphi.invert(rows(30.0), tool=text)
