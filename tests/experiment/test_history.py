"""Force histories: exact means, the observation vector, files there and back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory, window_weights
from terraphi.experiment.reading import read_forces
from terraphi.experiment.scenario import Scenario
from terraphi.paper.likelihood import observe

BINS_DEG = np.arange(-134.95, 135.0, 0.1)
Force = Callable[[np.ndarray], np.ndarray]


def history_of(fx: Force, fz: Force, theta_deg: np.ndarray = BINS_DEG) -> ForceHistory:
    force = np.stack([fx(theta_deg), fz(theta_deg)], axis=1)
    return ForceHistory(np.radians(theta_deg), force)


def bumps(theta_deg: np.ndarray) -> np.ndarray:
    """About what a leg feels [N]."""
    return 9.0 * np.exp(-(((theta_deg + 12.0) / 35.0) ** 2)) - 1.5 * np.sin(theta_deg / 20.0)


# -- means and the observation vector ----------------------------------------------------------


def test_a_line_is_its_value_at_the_angles_of_the_paper() -> None:
    observation = observe(history_of(lambda t: 2.0 * t + 1.0, lambda t: 0 * t - 1.2))
    assert observation.theta_deg == pytest.approx(-85.0 + 170.0 / 39.0 * np.arange(40))
    assert observation.Fx == pytest.approx(2.0 * observation.theta_deg + 1.0, abs=1e-10)
    assert observation.Fz == pytest.approx(-1.2, rel=1e-12)
    assert (observation.vector == np.concatenate([observation.Fx, observation.Fz])).all()


@settings(max_examples=30, deadline=None)
@given(
    steps=st.lists(st.floats(0.01, 5.0), min_size=60, max_size=80),
    seed=st.integers(0, 2**32 - 1),
)
def test_means_of_irregular_samples_are_exact(steps: list[float], seed: int) -> None:
    """Means, and weights of a moment, against adaptive quadrature of the lines."""
    x = np.concatenate([[0.0], np.cumsum(steps)])
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(len(x), 3))
    history = ForceHistory(x, values[:, :2], coordinate="time", moment=values[:, 2])
    centre, half = rng.uniform(0.2 * x[-1], 0.8 * x[-1]), rng.uniform(0.05, 0.2) * x[-1]
    windows = np.array([centre])
    result = [
        *history.means(windows, half)[0],
        *(window_weights(x, windows - half, windows + half) @ values[:, 2]),
    ]
    kinks = x[(x > centre - half) & (x < centre + half)]
    for i in range(3):
        total, _ = quad(
            lambda at, i=i: np.interp(at, x, values[:, i]),
            centre - half,
            centre + half,
            points=kinks,
            limit=200,
        )
        assert result[i] == pytest.approx(total / (2.0 * half), abs=1e-9)


def test_windows_are_cut_at_both_ends_of_the_record() -> None:
    """Over -85°..: the first window keeps its inner half, whose mean lies a quarter further in."""
    theta = np.linspace(-85.0, 85.0, 1701)
    history = history_of(lambda t: t, lambda t: 0 * t + 1.0, theta)
    observation = observe(history)
    quarter = 85.0 / 39.0 / 2.0
    assert observation.Fx[[0, -1]] == pytest.approx([-85.0 + quarter, 85.0 - quarter])
    assert observation.Fx[1:-1] == pytest.approx(observation.theta_deg[1:-1], abs=1e-10)
    with pytest.raises(ValueError, match="outside the recorded range"):
        history.means(np.array([10.0]), 0.1)


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
    assert history.summary()["peak_Fz_N"] == peaks.Fz


@given(st.floats(0.1, 3.0), st.integers(-60, 60))
def test_a_peak_is_the_first_of_a_plateau(height: float, first: int) -> None:
    """Whatever round-off does to the means over equal readings."""
    result = history_of(
        lambda theta: height * ((theta > first - 0.9) & (theta < first + 12.0)), bumps
    ).peaks()
    assert (result.Fx, result.theta_Fx_deg) == (pytest.approx(height), first + 0.0)


def test_the_largest_force_of_a_path_keeps_its_sign() -> None:
    force = np.stack([[0.0, -14.0, -3.0], [1.0, 80.0, -5.0]], axis=1)
    pressed = ForceHistory(np.array([0.0, 0.1, 0.2]), force, "displacement").summary()
    assert (pressed["peak_Fx_N"], pressed["peak_Fz_N"]) == (-14.0, 80.0)
    early = ForceHistory(np.radians(np.linspace(-135.0, -120.0, 20)), np.ones((20, 2)))
    with pytest.raises(ValueError, match="no whole degree"):
        early.peaks()
    assert early.summary()["peak_Fz_N"] == 1.0


@pytest.mark.parametrize(
    ("position", "shape", "changes", "words"),
    [
        ([0.0, 1.0], (3, 2), {}, "force has shape"),
        ([0.0, 1.0], (2, 2), {"moment": np.array([0.0, np.nan])}, "moment must be finite"),
        ([0.0, 0.0], (2, 2), {}, "increase"),
        ([0.0, 1.0], (2, 2), {"coordinate": "angle"}, "'angle' is not one of"),
    ],
)
def test_histories_that_cannot_be(
    position: list[float], shape: tuple[int, int], changes: dict[str, object], words: str
) -> None:
    with pytest.raises(ValueError, match=words):
        ForceHistory(np.array(position), np.zeros(shape), **changes)  # type: ignore[arg-type]


# -- files -------------------------------------------------------------------------------------


def random_history(
    coordinate: str = "theta", axes: tuple[str, ...] = ("x", "z"), moment: bool = False
) -> ForceHistory:
    rng = np.random.default_rng(7)
    position = np.radians(BINS_DEG) if coordinate == "theta" else np.cumsum(rng.uniform(size=500))
    force = rng.normal(scale=10.0 ** rng.integers(-8, 3, size=(len(position), len(axes))))
    provenance = {"scenario": Scenario().model_dump(mode="json"), "seconds": {"all": 0.1}, "φ": [1]}
    about_hip = rng.normal(size=len(position)) if moment else None
    return ForceHistory(position, force, coordinate, axes, provenance, about_hip)


@pytest.mark.parametrize(
    ("coordinate", "axes", "moment"),
    [
        ("theta", ("x", "z"), True),
        ("time", ("x", "y", "z"), True),
    ],
)
def test_netcdf_there_and_back_bit_by_bit(
    tmp_path: Path, coordinate: str, axes: tuple[str, ...], moment: bool
) -> None:
    history = random_history(coordinate, axes, moment)
    history.to_netcdf(tmp_path / "x.nc")
    result = ForceHistory.load(tmp_path / "x.nc")
    assert result.position.tobytes() == history.position.tobytes()
    assert result.force.tobytes() == history.force.tobytes()
    assert (result.coordinate, result.axes) == (coordinate, axes)
    assert result.provenance == history.provenance
    assert (result.moment is not None) == moment
    assert not moment or result.moment.tobytes() == history.moment.tobytes()  # type: ignore[union-attr]


def test_a_netcdf_describes_itself_and_needs_degrees_alone(tmp_path: Path) -> None:
    history = random_history(moment=True)
    history.to_netcdf(tmp_path / "x.nc")
    with xr.open_dataset(tmp_path / "x.nc", engine="h5netcdf") as plain:
        assert plain["theta_deg"].attrs["units"] == "degree"
        assert plain["theta_deg"].values == pytest.approx(BINS_DEG)
        assert plain["Fx"].attrs["units"] == "N"
        assert plain["M"].attrs["units"] == "N m"
        assert plain["Fx"].dims == ("theta_deg",)
        plain.load().drop_vars("theta").to_netcdf(tmp_path / "y.nc", engine="h5netcdf")
    result = ForceHistory.load(tmp_path / "y.nc")
    assert result.position == pytest.approx(history.position, rel=1e-15)


@pytest.mark.parametrize("gone", [["Fx"], ["theta", "theta_deg"], ["provenance"]])
def test_a_netcdf_that_lacks_something(tmp_path: Path, gone: list[str]) -> None:
    random_history().to_netcdf(tmp_path / "x.nc")
    with xr.open_dataset(tmp_path / "x.nc", engine="h5netcdf") as plain:
        content = plain.load().drop_vars(gone, errors="ignore")
    content.attrs = {key: value for key, value in content.attrs.items() if key not in gone}
    content.to_netcdf(tmp_path / "y.nc", engine="h5netcdf")
    with pytest.raises(InputError, match=r"y\.nc: .*make (it|the force history) again"):
        ForceHistory.load(tmp_path / "y.nc")


@pytest.mark.parametrize(
    ("key", "value"),
    [("reading", 5), ("scenario", [])],
)
def test_a_netcdf_whose_provenance_has_other_types(tmp_path: Path, key: str, value: object) -> None:
    replace(random_history(), provenance={key: value}).to_netcdf(tmp_path / "x.nc")
    with pytest.raises(InputError, match=rf"x\.nc: provenance.{key}.* should be"):
        ForceHistory.load(tmp_path / "x.nc")


def test_csv_there_and_back(tmp_path: Path) -> None:
    """Angles to twelve digits, forces to six; close angles stay apart."""
    theta = np.concatenate([BINS_DEG[:900], BINS_DEG[900] + np.arange(10) * 1e-5])
    history = history_of(bumps, lambda t: 1e-3 * bumps(-t), theta)
    history.to_csv(tmp_path / "x.csv")
    result = read_forces(tmp_path / "x.csv")
    assert result.position == pytest.approx(history.position, abs=1e-11)
    assert result.force == pytest.approx(history.force, rel=5e-6)
    assert result.provenance == {"file": "x.csv"}
    # What was read is written the same.
    result.to_csv(tmp_path / "y.csv")
    assert (tmp_path / "y.csv").read_bytes() == (tmp_path / "x.csv").read_bytes()
    with pytest.raises(InputError, match=r"z\.nc: cannot be written"):
        history.to_netcdf(tmp_path / "absent" / "z.nc")


# -- window and resampling -----------------------------------------------------------------------


@given(factor=st.floats(0.01, 3.0), sign=st.sampled_from([-1.0, 1.0]))
def test_means_and_moment_are_linear_in_the_force(factor: float, sign: float) -> None:
    plain = history_of(bumps, lambda t: bumps(-t), np.linspace(-90, 90, 200))
    history = ForceHistory(plain.position, plain.force, moment=0.1 * plain.Fx)
    scaled = history.scaled(sign * factor)
    expected = sign * factor * observe(history).vector
    assert observe(scaled).vector == pytest.approx(expected)
    assert scaled.moment == pytest.approx(0.1 * scaled.Fx)


def test_a_part_of_a_history_keeps_its_ends() -> None:
    theta = np.arange(-90.0, 91.0)
    full_history = ForceHistory(np.radians(theta), np.stack([theta, -theta], axis=1), moment=theta)
    kept = full_history.between(*np.radians([-85.0, 85.0]))
    assert kept.theta_deg == pytest.approx(np.arange(-85.0, 86.0))
    assert kept.Fx == pytest.approx(kept.theta_deg)
    assert kept.moment == pytest.approx(kept.theta_deg)


def test_what_was_applied_goes_with_the_history(tmp_path: Path) -> None:
    kept = {"position": [0.1, 0.3], "x_N": [1, 2], "z_N": [3, 5]}
    force = np.ones((5, 2))
    counted = ForceHistory(np.linspace(0.0, 0.4, 5), force, provenance={"applied_force": kept})
    counted.to_netcdf(tmp_path / "x.nc")
    applied = ForceHistory.load(tmp_path / "x.nc").applied()
    assert applied is not None
    assert (applied.Fx.tolist(), applied.Fz.tolist()) == ([1.0, 2.0], [3.0, 5.0])
    assert applied.position.tolist() == [0.1, 0.3]
    assert applied.applied() is None
