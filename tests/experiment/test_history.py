"""Force histories: exact means, the observation vector, files there and back."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.scenario import Scenario

BINS_DEG = np.arange(-134.95, 135.0, 0.1)
Force = Callable[[np.ndarray], np.ndarray]


def history_of(fx: Force, fz: Force, theta_deg: np.ndarray = BINS_DEG) -> ForceHistory:
    force = np.stack([fx(theta_deg), fz(theta_deg)], axis=1)
    return ForceHistory(np.radians(theta_deg), force)


def bumps(theta_deg: np.ndarray) -> np.ndarray:
    """About what a leg feels [N]."""
    return 9.0 * np.exp(-(((theta_deg + 12.0) / 35.0) ** 2)) - 1.5 * np.sin(theta_deg / 20.0)


# -- means and the observation vector ----------------------------------------------------------


def test_the_angles_are_the_papers() -> None:
    seen = history_of(bumps, bumps).observation()
    assert seen.theta_deg == pytest.approx(-85.0 + 170.0 / 39.0 * np.arange(40))
    assert seen.vector.shape == (80,)
    assert (seen.vector == np.concatenate([seen.Fx, seen.Fz])).all()


def test_a_constant_stays_that_constant() -> None:
    seen = history_of(lambda t: 0 * t + 3.7, lambda t: 0 * t - 1.2).observation()
    assert seen.Fx == pytest.approx(3.7, rel=1e-12)
    assert seen.Fz == pytest.approx(-1.2, rel=1e-12)


def test_a_line_is_its_value_at_each_angle() -> None:
    seen = history_of(lambda t: 2.0 * t + 1.0, lambda t: -0.1 * t).observation()
    assert seen.Fx == pytest.approx(2.0 * seen.theta_deg + 1.0, abs=1e-10)
    assert seen.Fz == pytest.approx(-0.1 * seen.theta_deg, abs=1e-12)


def test_the_mean_of_a_parabola() -> None:
    """Over c ± h it is c² + h²/3; chords of 0.1° add (0.1)²/6."""
    seen = history_of(lambda t: t**2, lambda t: t**3).observation()
    half = 85.0 / 39.0
    assert seen.Fx == pytest.approx(seen.theta_deg**2 + half**2 / 3.0 + 0.01 / 6.0, abs=1e-3)
    # And of a cubic c³ + c h².
    assert seen.Fz == pytest.approx(seen.theta_deg**3 + seen.theta_deg * half**2, abs=1.0)


def test_agreement_with_a_plain_mean_of_the_bins() -> None:
    """A window of 4.36° holds 43 or 44 bins; both see all but parts of two of them."""
    history = history_of(bumps, lambda t: bumps(-t))
    seen = history.observation()
    half = 85.0 / 39.0
    for j, angle in enumerate(seen.theta_deg):
        inside = np.abs(BINS_DEG - angle) <= half
        assert seen.Fx[j] == pytest.approx(history.Fx[inside].mean(), abs=0.02)
        assert seen.Fz[j] == pytest.approx(history.Fz[inside].mean(), abs=0.02)


@settings(max_examples=30, deadline=None)
@given(
    steps=st.lists(st.floats(0.01, 5.0), min_size=60, max_size=80),
    seed=st.integers(0, 2**32 - 1),
)
def test_means_of_irregular_samples_are_exact(steps: list[float], seed: int) -> None:
    """Against adaptive quadrature of the piecewise linear record."""
    x = np.concatenate([[0.0], np.cumsum(steps)])
    rng = np.random.default_rng(seed)
    force = rng.normal(size=(len(x), 2))
    history = ForceHistory(x, force, coordinate="time")
    centre, half = rng.uniform(0.2 * x[-1], 0.8 * x[-1]), rng.uniform(0.05, 0.2) * x[-1]
    found = history.means(np.array([centre]), half)[0]
    kinks = x[(x > centre - half) & (x < centre + half)]
    for axis in range(2):
        total, _ = quad(
            lambda at, axis=axis: np.interp(at, x, force[:, axis]),
            centre - half,
            centre + half,
            points=kinks,
            limit=200,
        )
        assert found[axis] == pytest.approx(total / (2.0 * half), abs=1e-9)


def test_windows_are_cut_at_both_ends_of_the_record() -> None:
    """Over -85°..: the first window keeps its inner half, whose mean lies a quarter further in."""
    theta = np.linspace(-85.0, 85.0, 1701)
    seen = history_of(lambda t: t, lambda t: 0 * t + 1.0, theta).observation()
    quarter = 85.0 / 39.0 / 2.0
    assert seen.Fx[[0, -1]] == pytest.approx([-85.0 + quarter, 85.0 - quarter])
    assert seen.Fx[1:-1] == pytest.approx(seen.theta_deg[1:-1], abs=1e-10)
    assert seen.Fz == pytest.approx(1.0, rel=1e-12)


@given(factor=st.floats(0.01, 3.0), sign=st.sampled_from([-1.0, 1.0]))
def test_the_observation_is_linear_in_the_force(factor: float, sign: float) -> None:
    history = history_of(bumps, lambda t: bumps(-t), np.linspace(-90, 90, 200))
    expected = sign * factor * history.observation().vector
    assert history.scaled(sign * factor).observation().vector == pytest.approx(expected)


def test_sampling_hardly_matters() -> None:
    """Ten times coarser, and at random angles: the same vector to a part in a thousand."""
    fine = history_of(bumps, bumps).observation().vector
    coarse = history_of(bumps, bumps, np.arange(-134.5, 135.0, 1.0)).observation().vector
    angles = np.sort(np.random.default_rng(1).uniform(-135.0, 135.0, 2000))
    assert coarse == pytest.approx(fine, abs=0.01)
    assert history_of(bumps, bumps, angles).observation().vector == pytest.approx(fine, abs=0.01)


def test_a_window_outside_the_record() -> None:
    with pytest.raises(ValueError, match="outside the recorded range"):
        history_of(bumps, bumps).means(np.array([10.0]), 0.1)


def test_peaks_on_one_degree_means() -> None:
    """A tent of 10 N at 20° with slopes of 1 N/°: its mean over ± 0.5° is 9.75 N."""
    history = history_of(
        lambda t: np.maximum(10.0 - np.abs(t - 20.0), 0.0),
        lambda t: np.maximum(8.0 - np.abs(t + 55.0), 0.0) + 99.0 * (np.abs(t) > 90.0),
        np.arange(-135.0, 135.01, 0.1),
    )
    peaks = history.peaks()
    assert (peaks.theta_Fx_deg, peaks.theta_Fz_deg) == (20.0, -55.0)
    assert (peaks.Fx, peaks.Fz) == pytest.approx((9.75, 7.75), abs=0.01)


# -- records that cannot be inverted -----------------------------------------------------------


def refusal(history: ForceHistory) -> str:
    with pytest.raises(InputError) as caught:
        history.observation()
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(
    ("theta_deg", "said"),
    [
        (np.arange(-90.0, 1.0), "theta covers -90.0 to 0.0 deg, but the whole window -85 to 85"),
        (np.arange(0.0, 91.0), "theta covers 0.0 to 90.0 deg"),
        (np.arange(-82.0, 91.0), "theta covers -82.0 to 90.0 deg"),
        (np.linspace(-90.0, 90.0, 9), "only 7 angles lie within |theta| <= 85 deg, at least 40"),
        (np.array([-90.0, 90.0]), "only 0 angles"),
        (np.r_[-90.0:-29.0, 1.0:91.0], "no angle between -30.0 and 1.0 deg; gaps of up to 20 deg"),
        (np.r_[-135.0, -90.0, -50.0:91.0], "no angle between -90.0 and -50.0 deg"),
        (np.r_[-90.0:61.0, 120.0, 135.0], "no angle between 60.0 and 120.0 deg"),
    ],
)
def test_records_that_do_not_cover_the_window(theta_deg: np.ndarray, said: str) -> None:
    assert said in refusal(history_of(bumps, bumps, theta_deg))


def test_a_record_that_ends_anywhere_near_the_window_s_end_is_refused_or_used() -> None:
    """Wherever it ends there is an answer, and it is one of the two."""
    edge = 85.0 - 85.0 / 39.0
    for end in edge + np.array([-1e-3, -1e-12, 0.0, 1e-12, 1e-3, 1e-2, 0.5]):
        history = history_of(bumps, bumps, np.linspace(-end, end, 300))
        if end < edge + 5e-3:
            assert "theta covers" in refusal(history)
        else:
            assert np.isfinite(history.observation().vector).all()


def test_forces_that_are_all_zero() -> None:
    def nothing(theta: np.ndarray) -> np.ndarray:
        return 0 * theta

    assert "Fx is zero at every angle" in refusal(history_of(nothing, nothing))
    outside = history_of(bumps, lambda t: 1.0 * (np.abs(t) > 90.0))
    assert "Fz is zero at every angle within |theta| <= 85 deg" in refusal(outside)


def test_the_file_is_named_where_there_is_one(tmp_path: Path) -> None:
    file = tmp_path / "half.csv"
    history_of(bumps, bumps, np.arange(-90.0, 1.0)).to_csv(file)
    assert refusal(ForceHistory.from_csv(file)).startswith("half.csv: theta covers")


def test_a_history_over_displacement_has_no_angles() -> None:
    history = ForceHistory(np.arange(3.0), np.ones((3, 2)), coordinate="displacement")
    with pytest.raises(ValueError, match="function of displacement"):
        history.observation()


@pytest.mark.parametrize(
    ("position", "shape", "coordinate", "said"),
    [
        ([0.0, 1.0], (3, 2), "theta", "shape"),
        ([0.0, 1.0], (2, 3), "theta", "shape"),
        ([0.0, 0.0], (2, 2), "theta", "increase"),
        ([1.0, 0.0], (2, 2), "time", "increase"),
        ([0.0, 1.0], (2, 2), "angle", "'angle' is not one of"),
    ],
)
def test_histories_that_cannot_be(
    position: list[float], shape: tuple[int, int], coordinate: str, said: str
) -> None:
    with pytest.raises(ValueError, match=said):
        ForceHistory(np.array(position), np.zeros(shape), coordinate)


# -- files -------------------------------------------------------------------------------------


def random_history(coordinate: str = "theta", axes: tuple[str, ...] = ("x", "z")) -> ForceHistory:
    rng = np.random.default_rng(7)
    position = np.radians(BINS_DEG) if coordinate == "theta" else np.cumsum(rng.uniform(size=500))
    force = rng.normal(scale=10.0 ** rng.integers(-8, 3, size=(len(position), len(axes))))
    provenance = {"scenario": Scenario().model_dump(mode="json"), "seconds": {"all": 0.1}, "φ": [1]}
    return ForceHistory(position, force, coordinate, axes, provenance)


@pytest.mark.parametrize("coordinate", ["theta", "displacement", "time"])
@pytest.mark.parametrize("axes", [("x", "z"), ("x", "y", "z")])
def test_netcdf_there_and_back_bit_by_bit(
    tmp_path: Path, coordinate: str, axes: tuple[str, ...]
) -> None:
    history = random_history(coordinate, axes)
    history.to_netcdf(tmp_path / "x.nc")
    found = ForceHistory.from_netcdf(tmp_path / "x.nc")
    assert found.position.tobytes() == history.position.tobytes()
    assert found.force.tobytes() == history.force.tobytes()
    assert (found.coordinate, found.axes) == (coordinate, axes)
    assert found.provenance == history.provenance


def test_a_netcdf_describes_itself(tmp_path: Path) -> None:
    random_history().to_netcdf(tmp_path / "x.nc")
    with xr.open_dataset(tmp_path / "x.nc", engine="h5netcdf") as plain:
        assert plain["theta_deg"].attrs["units"] == "degree"
        assert plain["theta_deg"].values == pytest.approx(BINS_DEG)
        assert plain["Fx"].attrs["units"] == "N"
        assert plain["Fx"].dims == ("theta_deg",)


def test_a_netcdf_with_degrees_alone_is_read(tmp_path: Path) -> None:
    history = random_history()
    history.to_netcdf(tmp_path / "x.nc")
    with xr.open_dataset(tmp_path / "x.nc", engine="h5netcdf") as plain:
        plain.load().drop_vars("theta").to_netcdf(tmp_path / "y.nc", engine="h5netcdf")
    found = ForceHistory.from_netcdf(tmp_path / "y.nc")
    assert found.position == pytest.approx(history.position, rel=1e-15)


@pytest.mark.parametrize("gone", ["Fx", "theta_deg", "coordinate", "provenance"])
def test_a_netcdf_that_lacks_something(tmp_path: Path, gone: str) -> None:
    history = random_history()
    history.to_netcdf(tmp_path / "x.nc")
    with xr.open_dataset(tmp_path / "x.nc", engine="h5netcdf") as plain:
        content = plain.load()
    if gone in content.attrs:
        del content.attrs[gone]
    else:
        content = content.drop_vars(["Fx", "Fz"] if gone == "Fx" else ["theta", "theta_deg"])
    content.to_netcdf(tmp_path / "y.nc", engine="h5netcdf")
    with pytest.raises(InputError, match=r"y\.nc: not as terraphi writes a force history"):
        ForceHistory.from_netcdf(tmp_path / "y.nc")


@pytest.mark.parametrize("axes", [("y", "z"), ("z",), ("x", "y"), ()])
def test_a_netcdf_of_other_axes_is_refused(tmp_path: Path, axes: tuple[str, ...]) -> None:
    random_history(axes=("x", "y", "z")).to_netcdf(tmp_path / "x.nc")
    with xr.open_dataset(tmp_path / "x.nc", engine="h5netcdf") as plain:
        content = plain.load().drop_vars([f"F{axis}" for axis in "xyz" if axis not in axes])
    content.to_netcdf(tmp_path / "y.nc", engine="h5netcdf")
    found = ", ".join(axes) or "none"
    with pytest.raises(InputError, match=rf"y\.nc: .*axes are {found}; x, forward, and z, up, are"):
        ForceHistory.from_netcdf(tmp_path / "y.nc")


def test_a_library_is_no_history(tmp_path: Path) -> None:
    attributes = {"terraphi_file": "library", "terraphi_schema": 1}
    xr.Dataset({"a": 1.0}, attrs=attributes).to_netcdf(tmp_path / "x.nc", engine="h5netcdf")
    with pytest.raises(InputError, match="not a force history"):
        ForceHistory.from_netcdf(tmp_path / "x.nc")


def test_csv_there_and_back(tmp_path: Path) -> None:
    """Angles to twelve digits, forces to six."""
    history = history_of(bumps, lambda t: 1e-3 * bumps(-t))
    history.to_csv(tmp_path / "x.csv")
    found = ForceHistory.from_csv(tmp_path / "x.csv")
    assert found.position == pytest.approx(history.position, abs=1e-11)
    assert found.force == pytest.approx(history.force, rel=5e-6)
    assert found.provenance == {"file": "x.csv"}
    lines = (tmp_path / "x.csv").read_text().splitlines()
    assert lines[0] == "theta_deg,Fx_N,Fz_N"
    assert lines[1].startswith("-134.95,")
    # What was read is written the same.
    found.to_csv(tmp_path / "y.csv")
    assert (tmp_path / "y.csv").read_bytes() == (tmp_path / "x.csv").read_bytes()


def test_close_angles_stay_apart_in_a_csv(tmp_path: Path) -> None:
    theta = np.concatenate([[-90.0], np.arange(10) * 1e-5, [90.0]])
    history_of(bumps, bumps, theta).to_csv(tmp_path / "x.csv")
    assert ForceHistory.from_csv(tmp_path / "x.csv").theta_deg == pytest.approx(theta, abs=1e-9)


@pytest.mark.parametrize("name", ["x.csv", "x.nc"])
def test_a_place_that_cannot_be_written(tmp_path: Path, name: str) -> None:
    history, place = random_history(), tmp_path / "absent" / name
    write = history.to_csv if name.endswith("csv") else history.to_netcdf
    with pytest.raises(InputError, match=f"{name}: cannot be written"):
        write(place)
    assert list(tmp_path.iterdir()) == []


def test_scaling_leaves_the_rest() -> None:
    history = random_history()
    doubled = history.scaled(2.0)
    assert (doubled.force == 2.0 * history.force).all()
    assert doubled.provenance == history.provenance
    assert math.isclose(doubled.Fz[5], 2.0 * history.Fz[5])


# -- window and resampling -----------------------------------------------------------------------


def test_engaged_window_keeps_its_ends() -> None:
    theta = np.arange(-90.0, 91.0)
    history = ForceHistory(np.radians(theta), np.stack([theta, -theta], axis=1))
    kept = history.engaged()
    assert kept.theta_deg == pytest.approx(np.arange(-85.0, 86.0))
    assert kept.Fx == pytest.approx(kept.theta_deg)


def test_a_line_read_at_other_angles_is_the_line() -> None:
    theta = np.linspace(-90.0, 90.0, 1801)
    history = ForceHistory(np.radians(theta), np.stack([theta, 3.0 - theta], axis=1))
    fewer = history.as_read_at(np.radians(np.arange(-80.0, 81.0, 7.0)))
    assert fewer.Fx == pytest.approx(np.arange(-80.0, 81.0, 7.0))
    assert fewer.Fz == pytest.approx(3.0 - np.arange(-80.0, 81.0, 7.0))
    # Beyond its own ends there is nothing to be read.
    assert history.as_read_at(np.radians(np.arange(-120.0, 121.0, 1.0))).theta_deg[0] > -90.5


def test_a_reading_is_the_mean_over_its_share_of_the_path() -> None:
    theta = np.arange(-90.0, 90.0, 0.1) + 0.05
    history = ForceHistory(np.radians(theta), np.stack([np.exp(theta / 20), theta**2], axis=1))
    # Two readings 0.6° apart after a gap of 3°: their shares are 0.6° wide, the others' 1°.
    readings = np.radians(np.r_[-88.0:-1.0:3.0, 0.0, 3.0, 3.6, 6.0:88.0:2.0])
    seen = history.as_read_at(readings)
    assert seen.position == pytest.approx(readings)
    at = int(np.argmin(np.abs(readings)))
    for i, half in ((at, 0.5), (at + 1, 0.3), (at + 2, 0.3), (at + 3, 0.5)):
        x = np.degrees(readings[i])
        exact = 20 * (np.exp((x + half) / 20) - np.exp((x - half) / 20)) / (2 * half)
        assert seen.Fx[i] == pytest.approx(exact, rel=1e-4)
    # Dense records leave the curve as it is, and so does one's own sampling.
    whole = history.as_read_at(np.radians(np.arange(-80.0, 80.01, 0.5)))
    assert np.array_equal(whole.position, history.between(*whole.position[[0, -1]]).position)
    assert np.abs(whole.theta_deg).max() == pytest.approx(79.95)
    assert np.array_equal(seen.as_read_at(readings).force, seen.force)
    assert history.as_read_at(None) is history


def test_the_largest_force_of_a_path_keeps_its_sign() -> None:
    force = np.stack([[0.0, -14.0, -3.0], [1.0, 80.0, -5.0]], axis=1)
    moved = ForceHistory(np.array([0.0, 0.1, 0.2]), force, "time")
    assert moved.summary()["peak_Fx_N"] == -14.0
    assert moved.summary()["peak_Fz_N"] == 80.0


@given(st.floats(0.1, 3.0), st.integers(-60, 60))
def test_a_peak_is_the_first_of_a_plateau(height: float, first: int) -> None:
    """Whatever round-off does to the means over equal readings."""
    found = history_of(
        lambda theta: height * ((theta > first - 0.9) & (theta < first + 12.0)), bumps
    ).peaks()
    assert (found.Fx, found.theta_Fx_deg) == (pytest.approx(height), first + 0.0)


def test_a_history_outside_the_window_has_no_peaks_and_says_so() -> None:
    theta = np.radians(np.linspace(-135.0, -120.0, 20))
    early = ForceHistory(theta, np.ones((20, 2)))
    assert "theta_peak_Fz_deg" not in early.summary()
    with pytest.raises(ValueError, match="no whole degree"):
        early.peaks()


# -- what a contact applied --------------------------------------------------------------------


def test_what_was_applied_goes_with_the_history() -> None:
    known = {"seed": 3, "applied_force": {"position": [0.1, 0.3], "x_N": [1, 2], "z_N": [3, 5]}}
    counted = ForceHistory(np.linspace(0.0, 0.4, 5), np.ones((5, 2)), provenance=known)
    applied = counted.applied()
    assert applied is not None
    assert applied.Fx.tolist() == [1.0, 2.0]
    assert applied.Fz.tolist() == [3.0, 5.0]
    assert applied.position.tolist() == [0.1, 0.3]
    assert applied.provenance == {"seed": 3}
    assert applied.applied() is None
    # At another density both change.
    halved = counted.scaled(0.5).applied()
    assert halved is not None
    assert halved.force == pytest.approx(applied.force / 2.0)
    assert counted.applied().force.tolist() == applied.force.tolist()
