"""Damage put into whole records is found, and whole records are left alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.measurements import measurement, medium_and_leg, names
from terraphi.experiment.scenario import Scenario
from terraphi.inference.defects import inspect_record, touches_soil_deg
from terraphi.inference.inversion import invert
from terraphi.inference.trials import Trial
from terraphi.library.store import Library

RNG = np.random.default_rng(3)
IN_AIR = (-88.0, 120.0)


@pytest.fixture(scope="module", name="library")
def _library() -> Library:
    return Library.load("quick-plane-strain")


def truth(every: int = 10) -> ForceHistory:
    whole = Library.load("quick-plane-strain-truths").cases[4].history
    assert whole is not None
    return replace(whole, position=whole.position[::every], force=whole.force[::every])


PHI = 33.97


def codes(history: ForceHistory) -> list[tuple[str, str]]:
    return [(d.code, d.force) for d in inspect_record(history, touches_deg=IN_AIR).defects]


@pytest.mark.parametrize("medium", ["yuma", "poppy_loose", "glass03_close"])
@pytest.mark.parametrize("leg", ["straight", "c", "reversed_c"])
def test_measured_records_are_whole(library: Library, medium: str, leg: str) -> None:
    record = measurement(f"li2013:{medium}/{leg}").history
    inspection = inspect_record(record, touches_deg=touches_soil_deg(library, leg))
    assert inspection.history is record
    assert inspection.defects == ()


@pytest.mark.parametrize("medium", ["yuma", "poppy_loose"])
def test_where_no_simulation_goes_nothing_is_said_of_air(medium: str) -> None:
    # Library sand3d ends at 90 deg, where its reversed C still touches soil.
    library = Library.load("sand3d")
    touches = touches_soil_deg(library, "reversed_c")
    assert touches is not None
    assert touches[1] == np.inf
    assert -90.0 < touches[0] < -70.0
    record = measurement(f"li2013:{medium}/reversed_c").history
    assert inspect_record(record, touches_deg=touches).defects == ()
    # Where the leg was simulated out of the soil, a force in air is one.
    shifted = replace(record, force=record.force + np.array([0.0, 0.5]))
    codes = {defect.code for defect in inspect_record(shifted, touches_deg=touches).defects}
    assert codes == {"offset"}


@pytest.mark.parametrize("name", ["quick-plane-strain", "resolved", "rft3d"])
@pytest.mark.parametrize("every", [1, 5, 10, 40])
@pytest.mark.parametrize("digits", [None, 3])
def test_simulated_records_are_whole(name: str, every: int, digits: int | None) -> None:
    library = Library.load(name)
    damaged = []
    for case in library.cases:
        assert case.history is not None
        force = case.history.force[::every]
        force = force if digits is None else np.round(force, digits)
        history = replace(case.history, position=case.history.position[::every], force=force)
        touches = touches_soil_deg(library, case.scenario.leg.shape)
        damaged += inspect_record(history, touches_deg=touches).defects
    # Of up to 54 records; read every 4° the coarse library's own spikes stand alone.
    assert sum(d.rows for d in damaged) <= (4 if every == 40 else 2)


@pytest.mark.parametrize("every", [1, 10])
@pytest.mark.parametrize("share", [0.1, 0.2, 0.3])
def test_dropouts_are_left_out_and_the_angle_stays(
    library: Library, every: int, share: float
) -> None:
    whole = truth(every)
    lost = RNG.random(len(whole.position)) < share
    zeroed = replace(whole, force=np.where(lost[:, None], 0.0, whole.force))
    inspection = inspect_record(zeroed, touches_deg=IN_AIR)
    loaded = lost & (np.abs(whole.theta_deg) < 30.0)  # deep in the soil, whatever the threshold
    gone = np.setdiff1d(whole.theta_deg, inspection.history.theta_deg)
    assert np.isin(whole.theta_deg[loaded], gone).all()
    assert {d.code for d in inspection.defects} == {"dropout"}
    answer = invert(zeroed, library=library)
    assert answer.record.data["left_out"] == sum(d.rows for d in inspection.defects) > 0
    assert answer.phi.ci95[0] < PHI < answer.phi.ci95[1]
    assert "dropout" in {doubt.code for doubt in answer.warnings}


@pytest.mark.parametrize("left", [-0.02, 0.05])
def test_dropouts_to_a_zero_that_is_a_little_off(library: Library, left: float) -> None:
    whole = truth()
    lost = np.random.default_rng(6).random(len(whole.position)) < 0.2
    answer = invert(
        replace(whole, force=np.where(lost[:, None], left, whole.force)), library=library
    )
    assert answer.record.data["left_out"] > 10
    assert answer.phi.ci95[0] < PHI < answer.phi.ci95[1] or answer.verdict.verdict == "misfit"


def test_dropouts_of_one_force() -> None:
    whole = truth()
    force = whole.force.copy()
    at = np.flatnonzero(np.abs(whole.theta_deg + 40.0) < 10.0)[::3]
    force[at, 1] = 0.0
    (defect,) = inspect_record(replace(whole, force=force)).defects
    assert (defect.code, defect.force, defect.rows) == ("dropout", "Fz", len(at))


def test_held_values_and_spikes() -> None:
    whole = truth(1)
    force = whole.force.copy()
    at = int(np.searchsorted(whole.theta_deg, -40.0))
    force[at : at + 50, 0] = force[at, 0]
    (defect,) = inspect_record(replace(whole, force=force)).defects
    assert (defect.code, defect.force, defect.rows) == ("held", "Fx", 49)
    assert defect.theta_deg == pytest.approx(tuple(whole.theta_deg[[at + 1, at + 49]]))
    force = whole.force.copy()
    force[at, 1] *= 10.0
    (defect,) = inspect_record(replace(whole, force=force)).defects
    assert (defect.code, defect.force, defect.rows) == ("spike", "Fz", 1)


def test_a_sensor_that_sticks_to_the_end_is_named() -> None:
    whole = truth(1)
    at = int(np.searchsorted(whole.theta_deg, 30.0))
    force = whole.force.copy()
    force[at:, 0] = force[at, 0]
    with pytest.raises(InputError, match=r"between 30\.0 and .* \(held values of Fx\)"):
        inspect_record(replace(whole, force=force))
    # A force that is nothing from there on is that of a leg in air.
    force[at:, 0] = 0.01 * force[:, 0].max()
    assert all(one.code != "held" for one in inspect_record(replace(whole, force=force)).defects)


def test_ten_spikes_are_left_out_too() -> None:
    """They are not to set the scale by which they are told from other readings."""
    whole = truth()
    force, inside = whole.force.copy(), np.flatnonzero(np.abs(whole.theta_deg) < 80.0)
    at = inside[8::16]
    force[at, 1] += 5.0 * force.max()
    (defect,) = inspect_record(replace(whole, force=force)).defects
    assert (defect.code, defect.force, defect.rows) == ("spike", "Fz", len(at))


def test_rows_of_exact_zeros_are_lost_under_a_small_load_too() -> None:
    """Noise gives every other reading some force; a third of the stroke of this leg is light."""
    case = next(c for c in Library.load("quick-paper").cases if c.scenario.leg.shape == "c")
    assert case.history is not None
    whole, rng = case.history.engaged(), np.random.default_rng(8)
    noise = 0.01 * np.abs(whole.force).max() * rng.normal(size=whole.force.shape)
    lost = rng.random(len(whole.position)) < 0.3
    force = np.where(lost[:, None], 0.0, whole.force + noise)
    left = inspect_record(replace(whole, force=force)).history
    assert (left.force == 0.0).all(axis=1).sum() < 0.03 * lost.sum()
    assert len(left.position) > 0.95 * (~lost).sum()


def test_angles_that_a_record_does_not_have_are_no_damage() -> None:
    # They are refused for what they are where the record is compared with a library.
    whole = truth(1)
    some = whole.theta_deg < -20.0
    force = whole.force[some].copy()
    force[-200:-196] = 0.0
    record = replace(whole, position=whole.position[some], force=force)
    assert [defect.code for defect in inspect_record(record).defects] == ["dropout"]


@pytest.mark.parametrize("every", [1, 10])
def test_a_clipped_top_is_left_out_if_short_and_refused_if_not(every: int) -> None:
    whole = truth(every)
    for share in (0.5, 0.8):
        top = share * whole.force.max(axis=0)
        said = r"^no undamaged reading between -\d.*° \(.*clipped top of F.*wider range: gaps of at"
        with pytest.raises(InputError, match=said) as refused:
            inspect_record(replace(whole, force=np.minimum(whole.force, top)))
        assert len(str(refused.value).split()) <= 35
        assert ". " not in str(refused.value)
    smooth = whole.means(np.radians(np.arange(-130.0, 130.0)), np.radians(3.0))
    record = ForceHistory(np.radians(np.arange(-130.0, 130.0)), smooth)
    assert inspect_record(record).defects == ()
    clipped = record.force.copy()
    clipped[:, 1] = np.minimum(clipped[:, 1], 0.9 * clipped[:, 1].max())
    (defect,) = inspect_record(replace(record, force=clipped)).defects
    assert (defect.code, defect.force) == ("clipped", "Fz")


def test_an_offset_in_air_makes_a_misfit(library: Library) -> None:
    whole = truth()
    moved = replace(whole, force=whole.force + np.array([0.0, 0.1 * np.ptp(whole.Fz)]))
    assert ("offset", "Fz") in codes(moved)
    drifting = whole.force + np.linspace(0.0, 0.2, len(whole.position))[:, None] * [0.0, 20.0]
    assert ("offset", "Fz") in codes(replace(whole, force=drifting))
    answer = invert(moved, library=library)
    assert answer.verdict.verdict == "misfit"
    assert answer.verdict.code == "damaged"
    assert "kept" in {d["treatment"] for d in answer.record.data["defects"]}


def test_a_simulated_leg_that_lifts_soil_is_not_damaged(library: Library) -> None:
    """Without relief, soil stays on the leg where it is in air in the library."""
    whole = Library.load("quick-plane-strain-truths").cases[4].history
    assert whole is not None
    scenario = Scenario.model_validate(whole.provenance["scenario"])
    other = scenario.replace(**{"relief.enabled": False}).model_dump(mode="json")
    lifted = whole.force - np.where(whole.theta_deg > 122.0, 1.0, 0.0)[:, None]
    record = replace(whole, force=lifted, provenance={**whole.provenance, "scenario": other})
    answer = invert(record, library=library)
    assert answer.verdict.code != "damaged"
    assert [doubt.code for doubt in answer.warnings] == ["unlike"]


def test_a_step_in_the_stroke_makes_a_misfit() -> None:
    theta = np.arange(-90.0, 90.5, 0.5)
    smooth = np.cos(np.radians(theta))[:, None] * [6.0, 4.0]
    record = ForceHistory(np.radians(theta), smooth)
    assert inspect_record(record).defects == ()
    force = smooth + np.where(theta > 12.0, 2.5, 0.0)[:, None] * [0.0, 1.0]
    (defect,) = inspect_record(replace(record, force=force)).defects
    assert (defect.code, defect.force) == ("step", "Fz")
    assert defect.theta_deg == pytest.approx((12.0, 12.5), abs=0.6)


def test_a_joint_inversion_leaves_them_out_too(library: Library) -> None:
    whole = truth()
    force = whole.force.copy()
    force[np.abs(whole.theta_deg + 36.0) < 8.0] = 0.0
    record = replace(whole, force=force)
    answer = invert(
        [Trial(record, "straight")], library=library, prior=["density=1500:1800"], steps=300
    )
    assert any(said.code == "dropout" for said in answer.warnings)
    phi = answer.marginal["soil.friction_angle_deg"]
    assert phi.ci95[0] < PHI < phi.ci95[1]


def test_a_zero_that_noise_may_hide_is_a_doubt(library: Library) -> None:
    """Off by 1 % of the peak under noise of 3 %, one of four consistent intervals missed."""
    sizes = {}
    for window in (85.5, 130.0):
        whole = truth().engaged(window_deg=window)
        rng, peak = np.random.default_rng(4), np.abs(whole.force).max()
        force = whole.force + peak * 0.03 * rng.normal(size=whole.force.shape)
        for provenance in ({}, whole.provenance):
            answer = invert(replace(whole, force=force, provenance=provenance), library=library)
            assert answer.verdict.verdict == "consistent"
            found = [doubt for doubt in answer.warnings if doubt.code == "zero_unseen"]
            assert len(found) == (not provenance)
            if found:
                sizes[window] = found[0].numbers["size_N"] / peak
    # Readings in air narrow it down: fifty of them to a standard error of the median.
    assert sizes[130.0] == pytest.approx(1.25 * 0.03 / np.sqrt(50.0), rel=0.4)
    assert sizes[130.0] < 0.7 * sizes[85.5]


def test_noise_in_air_is_no_offset() -> None:
    theta = np.linspace(-90.0, 90.0, 400)
    smooth = np.maximum(np.cos(np.radians(1.2 * theta)), 0.0)[:, None] * [8.0, 6.0]
    record = ForceHistory(np.radians(theta), smooth)
    flagged = 0
    for seed in range(50):
        noise = np.random.default_rng(seed).normal(0.0, 0.8, smooth.shape)
        noisy = replace(record, force=smooth + noise)
        found = inspect_record(noisy, touches_deg=(-85.0, 85.0)).defects
        flagged += any(defect.code == "offset" for defect in found)
    assert flagged <= 1


def test_a_million_readings_are_looked_at() -> None:
    theta = np.linspace(-90.0, 90.0, 1_000_000)
    force = np.cos(np.radians(theta))[:, None] * [6.0, 4.0]
    assert inspect_record(ForceHistory(np.radians(theta), force)).defects == ()


def test_a_slow_sensor_in_a_fast_log_is_no_damage() -> None:
    whole = truth(1)
    slow = whole.force[(np.arange(len(whole.position)) // 5) * 5]
    assert inspect_record(replace(whole, force=slow)).history is not None


def test_both_forces_may_pass_zero_in_a_coarse_record() -> None:
    theta = np.arange(-90.0, 90.0, 0.25)
    force = np.round(np.stack([np.sin(np.radians(2.0 * theta)), np.sin(np.radians(theta))], 1) * 5)
    assert inspect_record(ForceHistory(np.radians(theta), force)).defects == ()


@pytest.mark.parametrize("count_N", [0.02, 0.05, 0.1])
def test_a_coarse_sensor_is_no_damaged_one(count_N: float) -> None:
    found = {}
    for name in names():
        record = measurement(name).history
        coarse = replace(record, force=np.round(record.force / count_N) * count_N)
        touches = touches_soil_deg(Library.load("resolved"), medium_and_leg(name)[1])
        found[name] = inspect_record(coarse, touches_deg=touches).defects
    assert not any(found.values()), found


def test_what_one_channel_reads_once_is_no_top() -> None:
    theta = np.radians(np.linspace(-90.0, 90.0, 181))
    fz = np.where(np.abs(np.arange(181) - 60) < 30, 5.0, 0.0) + 0.01 * np.arange(181)
    fx = np.where(np.arange(181) == 60, 1.0, 0.0)
    fz[60] = 0.0
    inspect_record(ForceHistory(theta, np.stack([fx, fz], axis=1)))


def test_most_of_a_record_must_be_left() -> None:
    whole = truth()
    force = whole.force.copy()
    force[np.arange(len(force)) % 5 != 0] = 0.0
    with pytest.raises(InputError, match="of the readings are damaged"):
        inspect_record(replace(whole, force=force))
