"""Window means, noise and reading angles against quadrature and simulation of noise."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import quad

from terraphi.experiment.documents import DATA
from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.measurements import measurement
from terraphi.experiment.rig import Rig
from terraphi.inference.records import Record, open_record, open_records

RIG = Rig.of("li2013", "straight")


def record(theta_deg: np.ndarray, force: np.ndarray, **more: object) -> Record:
    return Record("test", ForceHistory(np.radians(theta_deg), force), RIG, **more)


def test_means_are_integrals_of_the_line_between_readings() -> None:
    rng = np.random.default_rng(0)
    theta = np.sort(rng.uniform(-90.0, 90.0, 150))
    stroke = record(theta, rng.standard_normal((150, 2)))
    half = 85.0 / 39.0
    for i in (3, 20, 35):
        centre = stroke.theta_deg[i]
        low, high = max(centre - half, theta[0]), min(centre + half, theta[-1])
        kinks = theta[(theta > low) & (theta < high)]
        integral = quad(lambda t: np.interp(t, theta, stroke.history.Fx), low, high,
                        points=kinks, limit=200)[0]  # fmt: skip
        assert stroke.data[0, i] == pytest.approx(integral / (high - low), abs=1e-7)


def test_a_curve_is_read_as_the_record_was() -> None:
    theta = np.arange(-90.0, 90.1, 0.4)
    curve_theta = np.arange(-90.0, 91.0)
    curve = np.stack([3.0 + 0.02 * curve_theta, np.cos(np.radians(curve_theta))])
    force = np.stack([np.interp(theta, curve_theta, row) for row in curve], axis=1)
    stroke = record(theta, force)
    np.testing.assert_allclose(curve @ stroke.operator(curve_theta).T, stroke.data, atol=1e-10)


@pytest.mark.parametrize("readings", [60, 900])
def test_windows_of_shifted_curves_are_those_of_their_readings(readings: int) -> None:
    """The plain form: each curve is interpolated to the readings, and averaged as these are."""
    rng = np.random.default_rng(6)
    theta = np.sort(np.append(rng.uniform(-92.0, 92.0, readings), np.arange(-90.0, 91.0, 4.0)))
    stroke = record(theta, np.ones((len(theta), 2)))
    curve_theta, shifts = np.sort(rng.uniform(-89.0, 95.0, 120)), np.array([-15.0, 0.0, 3.7])
    expected = [
        [stroke.means(np.interp(theta, curve_theta + shift, hat)) for hat in np.eye(120)]
        for shift in shifts
    ]
    operators = stroke.operator(curve_theta, shifts)
    np.testing.assert_allclose(operators, np.swapaxes(expected, 1, 2), atol=1e-13)
    np.testing.assert_array_equal(stroke.operator(curve_theta, 3.7), operators[2])


def test_covariance_of_noise_is_that_of_noisy_readings() -> None:
    """Data is linear in the readings: what one reading each moves makes the covariance."""
    theta = np.arange(-88.0, 88.1, 0.8)
    stroke = record(theta, np.zeros((len(theta), 2)) + 1.0, noise=(0.3, 0.1))
    moved = []
    for errors in np.diag(np.tile([0.3, 0.1], len(theta))).reshape(-1, len(theta), 2):
        moved.append(replace(stroke, history=replace(stroke.history, force=errors)).data.ravel())
    moves = np.array(moved)
    np.testing.assert_allclose(moves.T @ moves, stroke.noise_covariance, rtol=1e-9, atol=1e-12)


def test_covariance_of_rounding_is_that_of_rounded_readings() -> None:
    """Forces that change by steps, each 20 readings long, to a level drawn at random."""
    theta, rng, step = np.arange(-88.0, 88.1, 0.8), np.random.default_rng(5), 0.5
    errors, stated = [], []
    for _ in range(400):
        level = np.cumsum(rng.uniform(1.0, 2.0, (12, 2)), axis=0)
        exact = np.repeat(level, 20, axis=0)[: len(theta)]
        stroke = record(
            theta, step * np.round(exact / step), noise=(0.0, 0.0), resolution=(step, step)
        )
        errors.append((stroke.data - record(theta, exact).data).ravel())
        stated.append(stroke.noise_covariance)
    sample, expected = np.cov(np.array(errors).T), np.mean(stated, axis=0)
    np.testing.assert_allclose(np.diag(sample).mean(), np.diag(expected).mean(), rtol=0.1)
    assert np.abs(sample - expected).max() < 0.3 * np.diag(expected).max()


@pytest.mark.parametrize("sigma", [0.02, 0.2])
def test_noise_is_estimated_from_roughness(sigma: float) -> None:
    theta, rng = np.arange(-90.0, 90.1, 0.25), np.random.default_rng(1)
    smooth = np.stack([5.0 * np.cos(np.radians(theta)), np.sin(np.radians(2.0 * theta))], axis=1)
    noisy = ForceHistory(np.radians(theta), smooth + sigma * rng.standard_normal(smooth.shape))
    assert open_record(noisy, rig="li2013", leg="straight").noise == pytest.approx(
        (sigma, sigma), rel=0.15
    )


def test_long_records_keep_their_means_and_noise() -> None:
    theta, rng = np.linspace(-90.0, 90.0, 50_000), np.random.default_rng(4)
    force = np.stack([np.cos(np.radians(theta)), np.sin(np.radians(theta))], axis=1)
    force += 0.1 * rng.standard_normal(force.shape)
    full = record(theta, force, noise=(0.1, 0.1))
    full = replace(full, history=replace(full.history, moment=force[:, 0] ** 2))
    short = full.binned()
    assert len(short.history.position) <= 4000
    np.testing.assert_allclose(full.data, short.data, atol=2e-3)
    noise = np.diag(full.noise_covariance)
    np.testing.assert_allclose(np.diag(short.noise_covariance), noise, rtol=0.05)
    moments = [item.means(item.history.moment) for item in (full, short)]
    np.testing.assert_allclose(*moments, atol=2e-3)


def test_partial_records_use_the_windows_that_they_cover() -> None:
    theta = np.arange(-60.0, 0.1, 0.5)
    stroke = record(theta, np.ones((len(theta), 2)))
    assert -62.0 <= stroke.theta_deg[0] < stroke.theta_deg[-1] <= 2.0
    assert 12 <= stroke.theta_deg.size <= 15
    with pytest.raises(InputError, match="40 deg"):
        _ = record(np.arange(-20.0, 0.1, 0.5), np.ones((41, 2))).theta_deg
    gap = np.concatenate([np.arange(-80.0, -50.0, 0.5), np.arange(-20.0, 60.0, 0.5)])
    with pytest.raises(InputError, match="no reading between -50"):
        _ = record(gap, np.ones((len(gap), 2))).theta_deg


def test_a_table_is_a_record_and_rows_need_no_order() -> None:
    theta = np.arange(-90.0, 90.1, 1.0)
    table = pd.DataFrame({"theta_deg": theta, "Fx_N": np.cos(np.radians(theta)), "Fz_N": 1.0})
    first, other = (open_record(t, rig="li2013", leg="straight") for t in (table, table.iloc[::-1]))
    np.testing.assert_allclose(first.data, other.data)
    with pytest.raises(InputError, match="no column of Fz"):
        open_record(table.drop(columns="Fz_N"), rig="li2013", leg="straight")


@pytest.mark.parametrize(
    ("given", "mean", "sd"),
    [(1500.0, 1500.0, 75.0), ("1500±30", 1500.0, 30.0), ("1500", 1500.0, 75.0)],
)
def test_density_has_five_percent_unless_said(given: float | str, mean: float, sd: float) -> None:
    item = open_record("li2013:poppy_loose/c", density=given)
    assert (item.density_kg_m3, item.density_sd_kg_m3) == pytest.approx((mean, sd))


def test_copies_are_refused_in_one_file_and_in_other_units(tmp_path: Path) -> None:
    history = measurement("li2013:yuma/straight").history
    table = pd.DataFrame({
        "theta_deg": history.theta_deg, "Fx_N": history.Fx, "Fz_N": history.Fz
    })  # fmt: skip
    trials = pd.concat([table.assign(trial=1), table.assign(trial=2)], ignore_index=True)
    with pytest.raises(InputError, match="has the readings of DataFrame"):
        open_records(trials, rig="li2013", leg="straight")
    repeat = table.assign(trial=2, Fx_N=1.01 * table.Fx_N)
    trials = pd.concat([table.assign(trial=1), repeat], ignore_index=True)
    assert len(open_records(trials, rig="li2013", leg="straight")) == 2
    plate = pd.read_csv(DATA / "examples" / "plate.csv", comment="#")
    plate.to_csv(tmp_path / "plate.csv", index=False)
    kilo = plate.set_axis(["sinkage_m", "force_kN"], axis=1) * 1e-3
    kilo.to_csv(tmp_path / "kilo.csv", index=False)
    with pytest.raises(InputError, match=r"kilo\.csv: has the readings of"):
        open_records([tmp_path / "plate.csv", tmp_path / "kilo.csv"], tool="plate:60")
