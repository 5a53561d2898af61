"""Maps of slope stability compared with exact answers, and refusals of unusable files."""

from __future__ import annotations

import json
import socket
import tracemalloc
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.stats import norm, truncnorm

import terraphi
from terraphi.experiment.errors import InputError
from terraphi.inference.footfalls import FootfallMap
from terraphi.terrain import field, inputs, slopes
from terraphi.terrain.slopes import Sample, priors_of

rasterio = pytest.importorskip("rasterio")
pytestmark = pytest.mark.filterwarnings("ignore:Dataset has no geotransform")

from terraphi.terrain.field import STEEPEST, to_logit  # noqa: E402
from terraphi.terrain.inputs import Start, read_elevation, read_points  # noqa: E402
from terraphi.terrain.map import in_words, map_slopes  # noqa: E402

DRY = ("cohesion_Pa=0", "root_cohesion_Pa=0", "wetness=0")


def walked(seed: int, n: int = 60, count: int = 40) -> tuple[Any, Any]:
    rng = np.random.default_rng(seed)
    return rng.uniform(2.0, n - 2.0, count), rng.uniform(2.0, n - 2.0, count)


def test_dry_and_cohesionless_it_is_the_distribution_of_phi(hill, points) -> None:
    # Points that agree but for an error that all share: φ is normal with its sd.
    x, y = walked(0)
    path = points(x, y, np.full(x.size, 31.0), 0.05, 2.0)
    for slope_deg in (28.0, 32.0):
        slope_map = map_slopes(path, hill(slope_deg), prior=DRY)
        middle = {name: layer[20:40, 20:40].mean() for name, layer in slope_map.layers.items()}
        assert middle["p_unstable"] == pytest.approx(norm.cdf(slope_deg, 31.0, 2.0), abs=0.01)
        assert middle["phi_share"] == pytest.approx(1.0, abs=1e-6)
        assert middle["phi_sd"] == pytest.approx(2.0, rel=0.03)
        ratio = np.tan(np.radians(31.0)) / np.tan(np.radians(slope_deg))
        assert middle["fs_median"] == pytest.approx(ratio, rel=0.01)
        area = slope_map.summary["unstable_area_share"]["median"]
        assert area == pytest.approx(float(slope_deg > 31.0), abs=0.02)
    # Two strata on one slope.
    phi = np.where(x < 30.0, 26.0, 40.0) + np.random.default_rng(3).normal(0.0, 1.0, x.size)
    slope_map = map_slopes(points(x, y, phi, 1.0), hill(33.0), prior=DRY)
    assert slope_map.layers["p_unstable"][10:50, 8:20].min() > 0.95
    assert slope_map.layers["p_unstable"][10:50, 40:52].max() < 0.05
    low, high = slope_map.summary["unstable_area_share"]["ci95"]
    assert low < 0.5 < high < low + 0.3


def test_a_shared_error_widens_the_map_and_moves_nothing(hill, points) -> None:
    x, y = walked(2, count=20)
    phi = 42.0 + np.random.default_rng(3).normal(0.0, 0.3, x.size)
    maps = [map_slopes(points(x, y, phi, 0.3, shared), hill(33.0, n=60)) for shared in (0.0, 3.9)]
    (median, sd), (again, wider) = (
        [slope_map.layers[name][20:40, 20:40].mean() for name in ("phi_median", "phi_sd")]
        for slope_map in maps
    )
    assert (median, again) == pytest.approx((42.0, 42.0), abs=0.3)
    assert wider == pytest.approx(np.hypot(sd, 3.9), rel=0.1)


def test_field_and_draws_are_those_of_scikit_learn(hill, points) -> None:
    """Length, means, deviations and correlations against the process at the places themselves."""
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import ConstantKernel, DotProduct, Matern, WhiteKernel

    class OfPlace(Matern):
        def __call__(self, X: Any, Y: Any = None, eval_gradient: bool = False) -> Any:
            return super().__call__(X[:, :2], None if Y is None else Y[:, :2], eval_gradient)

    class OfCovariates(DotProduct):
        def __call__(self, X: Any, Y: Any = None, eval_gradient: bool = False) -> Any:
            return super().__call__(X[:, 2:], None if Y is None else Y[:, 2:], eval_gradient)

        def diag(self, X: Any) -> Any:
            return super().diag(X[:, 2:])

    kernel = ConstantKernel(0.1, field.PROCESS) * OfPlace(12.0, (6.0, 600.0), nu=1.5) + (
        WhiteKernel(field.SHORT_START, field.SHORT) + ConstantKernel(field.LEVEL_SD**2, "fixed")
        + ConstantKernel(field.EFFECT_SD**2, "fixed") * OfCovariates(0.0, "fixed")
    )  # fmt: skip
    n = 60
    rows, columns = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    heights = 0.5 * (n - rows) + 3.0 * np.sin(columns / 9.0) + 2.0 * np.sin(rows / 5.0)
    x, y = walked(2, count=30)
    phi = 30.0 + 3.0 * np.sin(x / 12.0) + np.random.default_rng(4).normal(0.0, 1.0, x.size)
    slope_map = map_slopes(points(x, y, phi, 1.0), hill(heights=heights), draws=64)
    # Inputs of the process at some cells: place, both covariates standardized.
    cells = [(10, 15), (12, 18), (30, 31), (50, 5)]
    whole = slice(0, n)
    layers = [layer(whole).astype(float) for layer in (slope_map.dem.read, slope_map.dem.slope)]
    scaled = [(layer - layer.mean()) / layer.std() for layer in layers]
    asked = np.array(
        [
            [slope_map.dem.x[c], slope_map.dem.y[r], scaled[0][r, c], scaled[1][r, c]]
            for r, c in cells
        ]
    )
    reference, at_points = slope_map.points, scaled_at(slope_map, scaled)
    z = to_logit(reference["phi_deg"]) - to_logit(30.0)
    alpha = (reference["sd_deg"] / field.degrees_per_z(reference["phi_deg"])).to_numpy() ** 2
    process = GaussianProcessRegressor(kernel, alpha=alpha, n_restarts_optimizer=2, random_state=0)
    process.fit(np.column_stack([reference[["x_m", "y_m"]], at_points]), z)
    length = process.kernel_.get_params()["k1__k2__length_scale"]
    assert slope_map.field.learnt["length_m"] == pytest.approx(length, rel=0.01)
    mean, covariance = process.predict(asked, return_cov=True)
    short = slope_map.field.learnt["short_sd"] ** 2
    sd = np.sqrt(np.diag(covariance) - short)
    z = to_logit(np.array([slope_map.layers["phi_median"][cell] for cell in cells]))
    assert z == pytest.approx(mean + to_logit(30.0), abs=0.05 * sd.mean())
    tan = STEEPEST / (1 + np.exp(-z))
    shown = np.array([slope_map.layers["phi_sd"][cell] for cell in cells])
    wanted = np.degrees(tan * (1 - tan / STEEPEST) / (1 + tan**2)) * sd
    assert shown == pytest.approx(wanted, rel=0.05)
    # Joint draws, in which two cells are correlated as in the process.
    fitted = field.fit(reference, at_points, slope_map.dem, draws=4096)
    here = fitted.window(slope_map.dem.x, slope_map.dem.y)
    covariates = np.array([[layer[cell] for cell in cells] for layer in scaled])
    drawn = here.draws(slice(None))[:, *zip(*cells, strict=True)].T + (
        covariates.T @ here.drawn_effects
    )
    wanted = covariance - short * np.eye(len(cells))
    assert drawn.mean(axis=1) == pytest.approx(mean + to_logit(30.0), abs=0.1 * sd.mean())
    assert np.cov(drawn) == pytest.approx(wanted, abs=0.08 * wanted.max())


def scaled_at(slope_map: Any, scaled: list[Any]) -> Any:
    """Standardized covariates at the points of a map."""
    cells = slope_map.points["row"], slope_map.points["column"]
    return np.stack([layer[cells] for layer in scaled], axis=-1)


@pytest.mark.slow
def test_neighborhoods_give_the_field_of_all_points(hill, points, monkeypatch) -> None:
    x, y = walked(2, n=240, count=300)
    phi = 30.0 + 3.0 * np.sin(x / 30.0) + np.random.default_rng(4).normal(0.0, 1.5, x.size)
    reference = points(x, y, phi, np.random.default_rng(5).uniform(0.5, 2.0, x.size))
    all_points = map_slopes(reference, hill(n=240), draws=256)
    monkeypatch.setattr(field, "POINTS", 150)
    near = map_slopes(reference, hill(n=240), draws=256)
    assert near.field.reach < 60.0
    sd = all_points.layers["phi_sd"]
    shift = (near.layers["phi_median"] - all_points.layers["phi_median"]) / sd
    assert np.nanmax(np.abs(shift)) < 1.0
    assert np.sqrt(np.nanmean(shift**2)) < 0.25
    # Half of the points determine the level, and each place.
    assert 0.95 < np.nanmean(near.layers["phi_sd"] / sd) < 1.2
    areas = [made.summary["unstable_area_share"]["median"] for made in (near, all_points)]
    assert areas[0] == pytest.approx(areas[1], abs=0.03)


def test_windows_and_stripes_give_the_map_of_a_single_one(hill, points, monkeypatch) -> None:
    x, y = walked(3)
    rng = np.random.default_rng(6)
    heights = np.add.outer(np.linspace(40.0, 0.0, 60), 3.0 * np.sin(np.arange(60) / 7.0))
    heights[50:, :9] = -9999.0
    given = (
        points(x, np.clip(y, 12.0, None), 30.0 + rng.normal(0.0, 2.0, x.size)),
        hill(heights=heights),
    )
    single = terraphi.map(*given, seed=3)
    monkeypatch.setattr(inputs, "STRIPE", 16)
    cut = terraphi.map(*given, seed=3)
    for name, layer in cut.layers.items():
        # The posterior is interpolated between other nodes.
        np.testing.assert_allclose(layer, single.layers[name], atol=5e-3, rtol=2e-3)
    for name in ("cells", "mean_p_unstable", "mean_phi_share", "extrapolated_share"):
        assert cut.summary[name] == pytest.approx(single.summary[name], abs=1e-4)
    areas = [made.summary["unstable_area_share"]["ci95"] for made in (cut, single)]
    assert areas[0] == pytest.approx(areas[1], abs=2e-3)


def test_windows_meet_without_a_seam(monkeypatch) -> None:
    """The mean steps across an edge by at most twice what it does between other columns."""
    monkeypatch.setattr(field, "POINTS", 60)
    rng = np.random.default_rng(0)
    place = rng.uniform(0.0, 400.0, (2000, 2))
    slope = np.sin(place[:, :1] / 50.0)
    phi = 31.0 + 3.0 * np.sin(place[:, 1] / 60.0) + 2.0 * slope[:, 0] + rng.normal(0.0, 3.0, 2000)
    table = pd.DataFrame({"x_m": place[:, 0], "y_m": place[:, 1], "phi_deg": phi, "sd_deg": 3.0,
                          "shared_sd_deg": 0.0})  # fmt: skip
    fitted = field.fit(table, slope, SimpleNamespace(shape=(400, 400), cell=1.0), draws=16)
    side = int(fitted.reach)
    y = 300.5 - np.arange(side)
    first, second = (fitted.window(start + np.arange(side) + 0.5, y) for start in (150, 150 + side))
    np.testing.assert_array_equal(first.effects, second.effects)
    drawn = [here.draws(slice(None)) for here in (first, second)]
    for number, (a, b) in enumerate(((first.mean, second.mean), drawn)):
        steps = np.sqrt(np.square(np.diff(np.concatenate([a, b], axis=-1))).mean(axis=-2))
        inner = np.delete(steps, side - 1, axis=-1).max(axis=-1)
        # A draw of few points steps more than the mean, but by less than a tenth of the error.
        most = 0.1 * np.sqrt(first.variance.mean()) if number else 2.0 * inner
        assert (steps[..., side - 1] < most).all()


def test_many_points_do_not_take_the_square_of_memory(hill, points, monkeypatch) -> None:
    monkeypatch.setattr(field, "POINTS", 40)
    x, y = walked(3, count=3000)
    ground = read_elevation(hill())
    reference, _ = read_points(points(x, y, 30.0 + np.sin(x / 9.0)), ground)
    tracemalloc.start()
    fitted = field.fit(reference, np.zeros((len(reference), 1)), ground)
    middle = slice(22, 38)
    mean = fitted.window(ground.x[middle], ground.y[middle]).mean
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    # Merging leaves at most 900 points, of which a matrix takes 6.5 MB, and the search a dozen.
    assert peak < 10e6
    expected = to_logit(30.0 + np.sin(ground.x[middle] / 9.0))
    assert mean[8] == pytest.approx(expected, abs=0.1)  # 1.6 degrees


def test_slope_of_an_inclined_plane(hill) -> None:
    heights = np.add.outer(0.4 * np.arange(20), 0.3 * np.arange(20))
    dem = read_elevation(hill(heights=heights))
    assert np.tan(dem.slope(slice(0, 20))) == pytest.approx(0.5, rel=1e-5)


def test_infinite_slope_against_arithmetic_by_hand() -> None:
    # c = 2.5 kPa, ρ = 1800, h = 1 m normal to a slope of 30 deg, half saturated.
    given = ("cohesion_Pa=1000", "root_cohesion_Pa=2000", "root_loss=0.25", "depth_m=1",
             "wetness=0.5", "density_kg_m3=1800")  # fmt: skip
    sample = Sample.of(priors_of(given), 2, 0)
    # Duncan, Wright & Brandon: with vertical depth z and pore pressure m γw z cos² θ.
    z, theta = 1.0 / np.cos(np.radians(30.0)), np.radians(30.0)
    weight, u = 1800 * 9.81 * z, 0.5 * 1000 * 9.81 * z * np.cos(theta) ** 2
    other = (2500.0 + (weight * np.cos(theta) ** 2 - u) * 0.6) / (
        weight * np.sin(theta) * np.cos(theta)
    )
    surely = np.array([to_logit(np.degrees(np.arctan(0.6)))]), np.array([1e-6])
    factor = slopes.median(*surely, np.array([theta]), None, sample)
    assert factor[0] == pytest.approx(other)


def test_probability_median_and_share_against_plain_monte_carlo() -> None:
    rng, n = np.random.default_rng(0), 200_000
    sample = Sample.of(priors_of(("cohesion_Pa=0:2000", "wetness=0.3+-0.2")), 1024, 0)
    mean, sd = np.array([to_logit(33.0)]), np.array([0.15])
    c = rng.uniform(0, 2000, n) + (1 - rng.uniform(0, 1, n)) * rng.uniform(0, 4000, n)
    wet = truncnorm.rvs(-1.5, 3.5, 0.3, 0.2, size=n, random_state=rng)
    depth, density = rng.uniform(0.5, 1.5, n), rng.uniform(1600, 2000, n)
    steep = np.radians(32.0)
    first = c / (density * 9.81 * depth * np.sin(steep))
    second = (1 - wet * 1000 / density) / np.tan(steep)
    tan_phi = STEEPEST / (1 + np.exp(-(mean + sd * rng.standard_normal(n))))
    factor = first + second * tan_phi
    of_cell = mean, sd, np.array([steep]), None, sample
    unstable = slopes.unstable(mean, sd, sample.critical(of_cell[2]))
    assert unstable[0] == pytest.approx((factor < 1).mean(), abs=0.01)
    assert slopes.median(*of_cell)[0] == pytest.approx(np.median(factor), rel=0.02)
    share = second.mean() ** 2 * tan_phi.var() / factor.var()
    assert slopes.phi_share(*of_cell)[0] == pytest.approx(share, abs=0.02)
    # A share by the definition of the index, Var E[F | φ] / Var F, where B varies by itself.
    b = np.linspace(0.1, 1.9, 1000)
    tan_phi = STEEPEST / (1 + np.exp(-(mean + 1.5 * sd * sample.normal)))
    factor = 0.2 + np.multiply.outer(tan_phi, b)
    expected = factor.mean(axis=1).var() / factor.var()
    # On 45°: A = c √2, B = 1 - m.
    made = Sample(sample.normal, np.full(1000, 0.2 * np.sqrt(0.5)), 1.0 - b, np.ones(1000))
    share = slopes.phi_share(mean, 1.5 * sd, np.array([0.25 * np.pi]), None, made)
    assert share[0] == pytest.approx(expected, rel=0.1)
    # Neutrally buoyant and saturated, B = 0: F = A at every φ.
    strength = np.array([0.5, 2.0, 0.9, 1.1]) * np.sqrt(0.5)
    made = Sample(np.zeros(4), strength, np.ones(4), np.ones(4))
    critical = made.critical(np.array([0.25 * np.pi]))
    assert slopes.unstable(np.zeros(1), np.ones(1), critical) == pytest.approx([0.5])


@pytest.mark.parametrize("is_wet", [False, True])
def test_medians_between_nodes_and_shares_of_a_raster_are_those_of_each_cell(is_wet: bool) -> None:
    """Within 1 %, and 1 % of the variance, of the sample's own numbers; few cells exactly."""
    rng, count = np.random.default_rng(2), 20_000
    sample = Sample.of(priors_of(("cohesion_Pa=0:2000", "wetness=0.3+-0.2")), 256, 0)
    ranges = (-0.5, 1.5), (0.05, 0.4), (0.1, 0.9), (0.0, 1.0)
    z, sd, theta, wet = (rng.uniform(*ends, count) for ends in ranges)
    cells = z, sd, theta, wet if is_wet else None
    few = tuple(None if values is None else values[::1000] for values in cells)
    wetness = wet[::1000, None] if is_wet else sample.wetness
    carried = 1.0 - wetness * sample.lightness
    tan_phi = slopes.tangent(z[::1000, None] + sd[::1000, None] * sample.normal)
    inclination = theta[::1000, None]
    factor = sample.strength / np.sin(inclination) + carried / np.tan(inclination) * tan_phi
    exact = np.median(factor, axis=1)
    np.testing.assert_allclose(slopes.median(*few, sample), exact, rtol=1e-9)
    medians = slopes.median(*cells, sample)[::1000]
    np.testing.assert_allclose(medians, exact, rtol=0.01)
    assert np.ptp(medians / exact) > 1e-6  # they are between nodes
    # Each draw of φ with all draws of the other quantities.
    a = (sample.strength / np.sin(inclination))[:, None]
    b = np.broadcast_to(carried / np.tan(inclination), factor.shape)[:, None]
    crossed = a + b * tan_phi[:, :, None]
    share = crossed.mean(axis=2).var(axis=1) / crossed.var(axis=(1, 2))
    np.testing.assert_allclose(slopes.phi_share(*few, sample), share, atol=0.01)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_landlab_has_the_same_slope_with_its_own_triangle() -> None:
    """Dry, with cohesion."""
    landlab = pytest.importorskip("landlab")
    from landlab.components import LandslideProbability

    slope, mode = 36.0, 31.0
    grid = landlab.RasterModelGrid((5, 5), xy_spacing=10.0)
    for name, value in {
        "topographic__slope": np.tan(np.radians(slope)),
        "topographic__specific_contributing_area": 50.0,
        "soil__transmissivity": 20.0,
        "soil__saturated_hydraulic_conductivity": 20.0,
        "soil__mode_total_cohesion": 2500.0,
        "soil__minimum_total_cohesion": 2499.0,
        "soil__maximum_total_cohesion": 2501.0,
        "soil__internal_friction_angle": mode,
        "soil__density": 2000.0,
        "soil__thickness": 1.0,
    }.items():
        grid.add_full(name, value, at="node")
    np.random.seed(0)  # noqa: NPY002 - landlab's own generator
    theirs = LandslideProbability(
        grid, number_of_iterations=4000, groundwater__recharge_distribution="uniform",
        groundwater__recharge_min_value=1e-7, groundwater__recharge_max_value=1e-6,
    )  # fmt: skip
    theirs.calculate_landslide_probability()
    node = grid.core_nodes[4]
    rng = np.random.default_rng(0)
    # It draws the thickness too, from 30 % below the given one to 10 % above.
    depth = rng.triangular(0.7, 1.0, 1.1, 100_000)
    still = np.zeros_like(depth)
    sample = Sample(still, 2500.0 / (2000.0 * 9.81 * depth), still, still + 0.5)
    phi = rng.triangular(0.82 * mode, mode, 1.32 * mode, depth.size)
    ours = (to_logit(phi) < sample.critical(np.radians([slope]))[0]).mean()
    assert 0.1 < ours < 0.8
    assert grid.at_node["landslide__probability_of_failure"][node] == pytest.approx(ours, abs=0.03)


def test_the_command_writes_maps_that_open(terraphi, hill, points, tmp_path) -> None:
    x, y = walked(0, count=12)
    heights = np.add.outer(np.linspace(30.0, 0.0, 60), np.zeros(60))
    heights[:5, :5] = -9999.0
    hill(heights=heights)
    # Excel begins a file with a byte-order mark.
    points(x, y, np.full(x.size, 30.0), first="\ufeff# crs: EPSG:32611")
    hill(heights=np.full((60, 60), 0.25), name="wet.tif")
    hill(heights=np.random.default_rng(0).random((60, 60)), name="burn.tif")
    rasters = ("--wetness", "wet.tif", "--covariate", "burn.tif")
    ran = terraphi("map", "points.csv", "--dem", "dem.tif", "--out", "maps", *rasters,
                   "--prior", "cohesion_Pa=0:100", "--json")  # fmt: skip
    assert ran.status == 0, ran.err
    summary = json.loads(ran.out)
    assert summary == json.loads((tmp_path / "maps" / "map.json").read_text())
    guessed = in_words(summary)[-1]
    assert "depth_m" in guessed
    assert "wetness" not in guessed  # which is the raster's
    assert summary["points_used"] == 12
    assert summary["field"]["covariates"] == ["elevation", "slope", "burn"]
    with rasterio.open(tmp_path / "maps" / "p_unstable.tif") as file:
        p = file.read(1)
        assert file.crs.to_epsg() == 32611
        assert file.bounds == (0.0, 0.0, 60.0, 60.0)
    assert np.isnan(p[0, 0])
    assert ((p[10:] >= 0.0) & (p[10:] <= 1.0)).all()
    with rasterio.open(tmp_path / "maps" / "extrapolated.tif") as file:
        assert set(np.unique(file.read(1))) == {0, 1, 255}


@pytest.mark.parametrize("bearing", [0.0, 90.0])
def test_footfalls_are_placed_where_the_walk_began(hill, tmp_path, bearing) -> None:
    x, y = walked(0, count=8)
    phi = np.full(8, 30.0)
    phi[1] = np.nan
    n, item = np.full(8, 1.0), np.zeros(1)
    verdict = ("usable", "too little sinkage", "saturated", *["usable"] * 5)
    # Northward is ahead, and west is left; or eastward is, and north.
    ahead, left = (y, -x) if bearing == 0.0 else (x, y)
    walk = FootfallMap(
        time=n, foot=("FR",) * 8, place=np.column_stack([ahead, left, n]), sinkage=n, phi=phi, sd=n,
        shared_sd=n, misfit=n, verdict=verdict, path=np.zeros((1, 3)), path_phi=item,
        path_relative_sd=item, path_absolute_sd=item, shared={}, by_law={},
    )  # fmt: skip
    walk.to_netcdf(tmp_path / "walk.nc")
    ground = read_elevation(hill(left=5e5))
    for name in ("walk.nc", "walk.csv"):
        result, left_out = read_points(tmp_path / name, ground, Start(5e5, 0.0, bearing))
        assert left_out == 2
        assert result["x_m"].to_numpy() == pytest.approx(5e5 + np.delete(x, [1, 2]), abs=1e-4)
        assert result["y_m"].to_numpy() == pytest.approx(np.delete(y, [1, 2]), abs=1e-4)
        cells = np.floor(60 - np.delete(y, [1, 2])), np.floor(np.delete(x, [1, 2]))
        assert (cells == result[["row", "column"]].to_numpy().T).all()


def test_nothing_is_fetched_from_the_network(terraphi, hill, points, tmp_path, monkeypatch) -> None:
    """Neither what a points file calls its coordinate system nor a raster is an address."""
    monkeypatch.setenv("GDAL_HTTP_TIMEOUT", "1")

    def refusal(dem: str) -> str:
        ran = terraphi("map", "points.csv", "--dem", dem, "--out", "maps")
        assert ran.status == 2
        return ran.err

    hill()
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(0.1)
        address = f"http://127.0.0.1:{server.getsockname()[1]}/dem.tif"
        points(np.arange(4) * 10.0 + 5.0, 20.0, 30.0, first=f"# crs: {address}")
        assert "its coordinate system is http" in refusal("dem.tif")
        points(np.arange(4) * 10.0 + 5.0, 20.0, 30.0)
        source = f"<SourceFilename>/vsicurl/{address}</SourceFilename>"
        band = f'<VRTRasterBand dataType="Float32" band="1"><SimpleSource>{source}</SimpleSource>'
        (tmp_path / "vrt.tif").write_text(
            f'<VRTDataset rasterXSize="9" rasterYSize="9">{band}</VRTRasterBand></VRTDataset>'
        )
        (tmp_path / "wms.tif").write_text(
            f'<GDAL_WMS><Service name="WMS"><ServerUrl>{address}</ServerUrl></Service></GDAL_WMS>'
        )
        for name in ("vrt.tif", "wms.tif"):
            assert "cannot be read as a GeoTIFF" in refusal(name)
        with pytest.raises(TimeoutError):
            server.accept()


def test_the_only_message_is_ours(hill, points, capfd) -> None:
    path = points([1.0] * 4, 2.0, 30.0, first='# crs: geogcs["x"]')
    with pytest.raises(InputError, match="coordinate system is geogcs"):
        read_points(path, read_elevation(hill()))
    assert capfd.readouterr().err == ""


def long_rows(path: Any) -> None:
    head, *rows = path.read_text().splitlines()
    path.write_text("\n".join([head, *(f"{row},9.0" for row in rows)]))


HALF = np.where(np.arange(60) < 30, np.arange(60), -9999.0) * np.ones((60, 1))


@pytest.mark.parametrize(
    ("change", "args", "words"),
    [
        (lambda hill, _: hill(crs=None), "", "no coordinate system"),
        (lambda hill, _: hill(crs="EPSG:4326"), "", "coordinates are degrees (EPSG:4326)"),
        (lambda hill, _: hill(crs="EPSG:2229"), "", "to metres"),
        (lambda hill, _: hill(unit="ft"), "", "elevations are in ft"),
        (lambda hill, _: hill(heights=HALF + 2e30), "", "has values beyond 1e+30"),
        (lambda hill, _: hill(heights=1j + HALF), "", "values are complex64, expected real"),
        # A code for no data that is not marked as one; a picture; Mercator at 60° north.
        (lambda hill, _: hill(heights=np.maximum(HALF, -999.0)), "", "elevations from -999 to"),
        (lambda hill, _: hill(bands=3), "", "has 3 bands, expected one"),
        (lambda hill, _: hill(crs="EPSG:3857", bottom=8.4e6), "", "are 2 by 2 m for 1 m on the"),
        (lambda hill, _: hill(crs="+proj=eqc +R=3396190 +units=m"), "", "not of a place on the"),
        (lambda hill, _: hill(left=1000.0), "", "is outside dem.tif"),
        (lambda hill, _: hill(heights=HALF), "", "dem.tif has no elevation there"),
        (lambda _, points: points([1.0] * 4, 2.0, 30.0, first="# crs: EPSG:32612"), "", "project"),
        (lambda _, points: points([1.0] * 4, 2.0, 75.0), "", "line 2: phi_deg = 75"),
        (lambda _, points: points([1.0, np.nan] * 2, 2.0, 30.0), "", "line 3: x_m = nan"),
        (lambda _, points: points([1.0] * 2, 2.0, 30.0), "", "2 of 2 points usable"),
        (lambda _, points: long_rows(points([1.0] * 4, 2.0, 31.0)), "", "line 2: 5 cells"),
        (None, "--start 5e5,0", "expected X,Y,BEARING"),
        (None, "--prior cohesion=3", "did you mean 'cohesion_Pa'"),
        (None, "--prior wetness=0:2", "wetness lies between 0 and 1"),
        (
            lambda hill, _: hill(heights=HALF * 0.0 + 7.0, name="b.tif"),
            "--covariate b.tif",
            "does not vary",
        ),
        (lambda hill, _: hill(name="wet.tif"), "--wetness wet.tif", "expected 0 to 1"),
        (lambda hill, _: hill(n=50, name="b.tif"), "--covariate b.tif", "its grid is not that of"),
    ],
)
def test_refusals(terraphi, hill, points, tmp_path, change, args, words) -> None:
    hill()
    points(np.arange(4) * 10.0 + 5.0, 20.0, 30.0)
    if change:
        change(hill, points)
    ran = terraphi("map", "points.csv", "--dem", "dem.tif", "--out", "maps", *args.split())
    assert (ran.status, ran.out, ran.err.count("\n")) == (2, "", 1)
    assert words in ran.err
    assert not (tmp_path / "maps").exists()


def test_public_map_takes_what_python_has_and_is_what_is_saved(
    hill, points, tmp_path: Path
) -> None:
    x, y = np.meshgrid(np.arange(10.0, 60.0, 10.0), np.arange(10.0, 60.0, 10.0))
    path, dem = points(x.ravel(), y.ravel(), 33.0 + 0.05 * x.ravel(), 1.0), hill(33.0)
    slope_map = terraphi.map(str(path), str(dem), prior="cohesion_Pa=0:500", seed=5, draws=16)
    again = terraphi.map(pd.read_csv(path), dem, prior=["cohesion_Pa=0:500"], seed=5, draws=16)
    layers = slope_map.to_xarray()
    assert again.to_xarray().identical(layers)
    slope_map.save(tmp_path / "slopes")
    for name, layer in layers.items():
        with rasterio.open(tmp_path / "slopes" / f"{name}.tif") as file:
            np.testing.assert_array_equal(file.read(1), layer)
            column, row = ~file.transform @ (float(layer.x[3]), float(layer.y[7]))
            assert (column, row) == (3.5, 7.5)
    with pytest.raises(terraphi.InputError, match="DataFrame, row 2: phi_deg"):
        terraphi.map(pd.read_csv(path).assign(phi_deg=[30.0, 30.0, 95.0] + [30.0] * 22), dem)


@pytest.mark.parametrize("size", [60.0, 12.0])
def test_ground_beyond_the_points_is_marked_and_named(hill, points, size) -> None:
    x, y = np.meshgrid(np.linspace(0.5, size - 0.5, 12), np.linspace(0.5, size - 0.5, 12))
    made = map_slopes(points(x.ravel(), y.ravel(), np.full(144, 30.0), 1.0), hill(20.0), prior=DRY)
    marks, far = made.layers["extrapolated"], made.layers["phi_sd"]
    share = (marks == 1).sum() / (marks != 255).sum()
    assert made.summary["extrapolated_share"] == pytest.approx(share, abs=1e-9)
    assert ("extrapolated.tif" in repr(made)) == (share > 0.0)
    assert (share > 0.5) == (size < 60.0)
    if share > 0.5:
        assert far[marks == 1].mean() > 1.2 * far[marks == 0].mean()
