"""Maps of slope stability against answers that are exact, and refusals of what is no map."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

from terraphi.inference.prior import Marginal
from terraphi.robot.footfall_files import write_footfalls
from terraphi.robot.footfalls import FootfallMap
from terraphi.terrain import slopes
from terraphi.terrain.slopes import QUANTITIES, Sample, priors_of

rasterio = pytest.importorskip("rasterio")
pytest.importorskip("sklearn")
pytestmark = pytest.mark.filterwarnings("ignore:Dataset has no geotransform")

from terraphi.terrain.field import STEEPEST, to_logit  # noqa: E402
from terraphi.terrain.map import map_slopes  # noqa: E402
from terraphi.terrain.points import Start, read_points  # noqa: E402
from terraphi.terrain.raster import read_elevation  # noqa: E402

DRY = ("cohesion_Pa=0", "root_cohesion_Pa=0", "wetness=0")


def walked(rng: np.random.Generator, n: int = 60, count: int = 40) -> tuple[Any, Any]:
    return rng.uniform(2.0, n - 2.0, count), rng.uniform(2.0, n - 2.0, count)


@pytest.mark.parametrize("slope_deg", [28.0, 32.0])
def test_dry_and_cohesionless_it_is_the_distribution_of_phi(hill, points, slope_deg) -> None:
    # Points that agree but for an error that all have in common: φ is normal with its sd.
    x, y = walked(np.random.default_rng(0))
    path = points(x, y, np.full(x.size, 31.0), 0.05, 2.0)
    found = map_slopes(path, hill(slope_deg), prior=DRY)
    middle = (slice(20, 40), slice(20, 40))
    exact = norm.cdf(slope_deg, 31.0, 2.0)
    assert found.layers["p_unstable"][middle].mean() == pytest.approx(exact, abs=0.01)
    assert found.layers["phi_share"][middle].mean() == pytest.approx(1.0, abs=1e-6)
    assert found.layers["phi_sd"][middle].mean() == pytest.approx(2.0, rel=0.03)
    ratio = np.tan(np.radians(31.0)) / np.tan(np.radians(slope_deg))
    assert found.layers["fs_median"][middle].mean() == pytest.approx(ratio, rel=0.01)


def test_a_common_error_widens_the_map_and_moves_nothing(hill, points) -> None:
    x, y = walked(np.random.default_rng(2))
    rng = np.random.default_rng(3)
    phi = 42.0 + rng.normal(0.0, 0.3, x.size)
    maps = [
        map_slopes(points(x, y, phi, 0.3, shared), hill(33.0), prior=DRY).layers
        for shared in (0.0, rng.uniform(3.8, 4.0, x.size))
    ]
    median, sd = ([layers[name][20:40, 20:40].mean() for layers in maps]
                  for name in ("phi_median", "phi_sd"))  # fmt: skip
    assert median == pytest.approx([42.0, 42.0], abs=0.3)
    assert sd[1] == pytest.approx(np.hypot(sd[0], 3.9), rel=0.1)


def test_two_strata_on_one_slope(hill, points) -> None:
    rng = np.random.default_rng(1)
    x, y = walked(rng, count=60)
    phi = np.where(x < 30.0, 26.0, 40.0) + rng.normal(0.0, 1.0, x.size)
    found = map_slopes(points(x, y, phi, 1.0), hill(33.0), prior=DRY)
    p = found.layers["p_unstable"]
    assert p[10:50, 8:20].min() > 0.97
    assert p[10:50, 40:52].max() < 0.03
    low, high = found.summary["unstable_area_share"]["ci95"]
    assert low < 0.5 < high
    assert high - low < 0.25


def test_lattice_and_draws_are_those_of_the_process_itself(hill, points, monkeypatch) -> None:
    """Means, deviations and correlations against scikit-learn's predictions at the places."""
    from sklearn.gaussian_process import GaussianProcessRegressor

    kept: list[Any] = []
    fit = GaussianProcessRegressor.fit
    monkeypatch.setattr(
        GaussianProcessRegressor, "fit", lambda self, *a: kept.append(self) or fit(self, *a)
    )
    rng = np.random.default_rng(2)
    n = 60
    rows, columns = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    heights = 0.5 * (n - rows) + 3.0 * np.sin(columns / 9.0) + 2.0 * np.sin(rows / 5.0)
    x, y = walked(rng)
    phi = 30.0 + 3.0 * np.sin(x / 12.0) + rng.normal(0.0, 1.0, x.size)
    found = map_slopes(points(x, y, phi, 1.0), hill(heights=heights), draws=64)
    (process,) = kept
    # The model itself at some cells: place, both covariates standardised.
    cells = [(10, 15), (12, 18), (30, 31), (50, 5)]
    layers = [found.dem.height.astype(float), found.dem.slope.astype(float)]
    scaled = [(one - one.mean()) / one.std() for one in layers]
    asked = np.array(
        [[found.dem.x[c], found.dem.y[r], scaled[0][r, c], scaled[1][r, c]] for r, c in cells]
    )
    mean, covariance = process.predict(asked, return_cov=True)
    short = found.learnt.short_sd**2
    sd = np.sqrt(np.diag(covariance) - short)
    z = to_logit(np.array([found.layers["phi_median"][cell] for cell in cells]))
    assert z == pytest.approx(mean + to_logit(30.0), abs=0.05 * sd.mean())
    per_z = np.degrees(1.0) * np.array(
        [t * (1 - t / STEEPEST) / (1 + t**2) for t in STEEPEST / (1 + np.exp(-z))]
    )
    shown = np.array([found.layers["phi_sd"][cell] for cell in cells])
    assert shown == pytest.approx(per_z * sd, rel=0.05)
    # Draws of the lattice, correlated as the process is between two of its places.
    drawn = found.learnt.draws(4096, 3)
    a, b = 10 * found.learnt.x.size + 12, 11 * found.learnt.x.size + 20
    places = [(i % found.learnt.x.size, i // found.learnt.x.size) for i in (a, b)]
    at = np.array([[found.learnt.x[i], found.learnt.y[j], 0.0, 0.0] for i, j in places])
    wanted = process.predict(at, return_cov=True)[1] - short * np.eye(2)
    assert np.cov(drawn[:, a], drawn[:, b]) == pytest.approx(wanted, rel=0.1)


def test_infinite_slope_against_arithmetic_by_hand() -> None:
    # c = 2 kPa, ρ = 1800, h = 1 m normal to a slope of 30 deg, half saturated.
    given = ("cohesion_Pa=1000", "root_cohesion_Pa=2000", "root_loss=0.5", "depth_m=1",
             "wetness=0.5", "density_kg_m3=1800")  # fmt: skip
    sample = Sample.of(priors_of(given), 2, 0)
    a, b = sample.terms(np.radians([30.0]))
    assert a[0] == pytest.approx(2000.0 / (1800 * 9.81 * 0.5))
    assert b[0] == pytest.approx((1.0 - 0.5 / 1.8) / np.tan(np.radians(30.0)))
    # Duncan, Wright & Brandon: with vertical depth z and pore pressure m γw z cos² θ.
    z, theta = 1.0 / np.cos(np.radians(30.0)), np.radians(30.0)
    weight, u = 1800 * 9.81 * z, 0.5 * 1000 * 9.81 * z * np.cos(theta) ** 2
    tan_phi = 0.6
    other = (2000.0 + (weight * np.cos(theta) ** 2 - u) * tan_phi) / (
        weight * np.sin(theta) * np.cos(theta)
    )
    assert (a + b * tan_phi)[0] == pytest.approx(other)


def test_probability_median_and_share_against_plain_monte_carlo() -> None:
    rng = np.random.default_rng(0)
    priors = priors_of(("cohesion_Pa=0:2000", "wetness=0.3+-0.2"))
    a, b = Sample.of(priors, 1024, 0).terms(np.radians([32.0]))
    mean, sd = np.array([to_logit(33.0)]), np.array([0.15])
    many = {key: priors[key].draw(200_000, rng) for key in QUANTITIES}
    c = many["cohesion_Pa"] + (1 - many["root_loss"]) * many["root_cohesion_Pa"]
    steep = np.radians(32.0)
    first = c / (many["density_kg_m3"] * 9.81 * many["depth_m"] * np.sin(steep))
    second = (1 - many["wetness"] * 1000 / many["density_kg_m3"]) / np.tan(steep)
    tan_phi = STEEPEST / (1 + np.exp(-(mean + sd * rng.standard_normal(200_000))))
    factor = first + second * tan_phi
    assert slopes.unstable(mean, sd, a, b)[0] == pytest.approx((factor < 1).mean(), abs=0.01)
    normal = Sample.of(priors, 1024, 0).normal
    median, share = slopes.spread(mean, sd, normal, a, b)
    assert median[0] == pytest.approx(np.median(factor), rel=0.02)
    assert share[0] == pytest.approx(second.mean() ** 2 * tan_phi.var() / factor.var(), abs=0.02)


@pytest.mark.filterwarnings("error")
def test_soil_that_nothing_presses_on_is_told_without_a_warning() -> None:
    # Neutrally buoyant and saturated, B = 0: F = A at every φ.
    a, b = np.array([[0.5, 2.0, 0.9, 1.1]]), np.zeros((1, 4))
    found = slopes.unstable(np.zeros(1), np.ones(1), a, b)
    assert found == pytest.approx([0.5])


def test_quantiles_of_priors_are_those_of_their_draws() -> None:
    for marginal in (Marginal(2.0, 5.0), Marginal(0.0, 1.0, (0.9, 0.3))):
        drawn = np.sort(marginal.draw(100_000, np.random.default_rng(0)))
        shares = np.array([0.05, 0.5, 0.95])
        found = slopes.quantiles(marginal, shares)
        assert found == pytest.approx(np.quantile(drawn, shares), abs=0.02)


def test_the_command_writes_maps_that_open(terraphi, hill, points, tmp_path) -> None:
    x, y = walked(np.random.default_rng(0))
    heights = np.add.outer(np.linspace(30.0, 0.0, 60), np.zeros(60))
    heights[:5, :5] = -9999.0
    hill(heights=heights)
    points(x, y, np.full(x.size, 30.0), first="# crs: EPSG:32611")
    wet = hill(heights=np.full((60, 60), 0.25), name="wet.tif")
    ran = terraphi("map", "points.csv", "--dem", "dem.tif", "--out", "maps", "--wetness", str(wet),
                   "--prior", "cohesion_Pa=0:100", "--json")  # fmt: skip
    assert ran.status == 0, ran.err
    told = json.loads(ran.out)
    assert told == json.loads((tmp_path / "maps" / "map.json").read_text())
    assert told["points_used"] == 40
    with rasterio.open(tmp_path / "maps" / "p_unstable.tif") as file:
        p = file.read(1)
        assert file.crs.to_epsg() == 32611
        assert file.bounds == (0.0, 0.0, 60.0, 60.0)
    assert np.isnan(p[0, 0])
    assert ((p[10:] >= 0.0) & (p[10:] <= 1.0)).all()
    with rasterio.open(tmp_path / "maps" / "extrapolated.tif") as file:
        assert file.nodata == 255
        assert set(np.unique(file.read(1))) <= {0, 1, 255}
    # A table program's mark at the beginning hides no comment.
    file = tmp_path / "points.csv"
    file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes())
    again = terraphi("map", "points.csv", "--dem", "dem.tif", "--out", "maps")
    assert again.status == 0
    assert "Wide guesses, which nobody has measured, stand for: cohesion_Pa" in again.out
    assert terraphi("report", "maps", "--out", "r.html").status == 0
    assert "Factor of safety below 1 on" in (tmp_path / "r.html").read_text()


def test_footfalls_come_as_they_were_written(terraphi, hill, tmp_path) -> None:
    """Both files of a walk make one map, its places turned and moved to where it began."""
    x, y = walked(np.random.default_rng(0), count=8)
    phi = np.full(8, 30.0)
    phi[1] = np.nan
    n, one = np.full(8, 1.0), np.zeros(1)
    verdict = ("usable", "too little sinkage", "saturated", *["usable"] * 5)
    walk = FootfallMap(
        time=n, foot=("FR",) * 8, place=np.column_stack([y, -x, n]), sinkage=n, phi=phi, sd=n,
        shared_sd=n, misfit=n, verdict=verdict, path=np.zeros((1, 3)), path_phi=one,
        path_relative_sd=one, path_absolute_sd=one, shared={}, by_law={},
    )  # fmt: skip
    write_footfalls(walk, tmp_path / "walk.nc")
    dem = hill(left=5e5)
    told = []
    for name in ("walk.nc", "walk.csv"):
        # Northward is ahead, and west is left.
        ran = terraphi("map", name, "--dem", "dem.tif", "--out", "maps", "--start", "5e5,0,0",
                       "--json")  # fmt: skip
        assert ran.status == 0, ran.err
        told.append(json.loads(ran.out))
        assert told[-1]["points_used"] == 6
        assert told[-1]["points_left_out"] == 2
    assert told[0]["unstable_area_share"] == told[1]["unstable_area_share"]
    found, *_ = read_points(tmp_path / "walk.nc", read_elevation(dem), Start(5e5, 0.0, 0.0))
    assert found.x_m == pytest.approx(5e5 + np.delete(x, [1, 2]))
    assert found.y_m == pytest.approx(np.delete(y, [1, 2]))
    lost = terraphi("map", "walk.nc", "--dem", "dem.tif", "--out", "lost")
    assert "--start says where they began" in lost.err


def long_rows(path: Path) -> None:
    """Give each row one value more than there are names."""
    head, *rows = path.read_text().splitlines()
    path.write_text("\n".join([head, *(f"{row},9.0" for row in rows)]))


Change = Callable[[Any, Any], Any]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda hill, _: hill(crs=None), "has no coordinate system (CRS)"),
        (lambda hill, _: hill(crs="EPSG:4326"), "coordinates are degrees (EPSG:4326)"),
        (lambda hill, _: hill(crs="EPSG:2229"), "expected metres"),
        (lambda hill, _: hill(unit="ft"), "its elevations are in ft, expected metres"),
        (lambda _, points: long_rows(points([1.0] * 4, 2.0, 31.0, 2.5)), "not a CSV of points"),
        (lambda hill, _: hill(left=1000.0), "is off dem.tif"),
        (lambda hill, _: hill(heights=np.full((60, 60), -9999.0)), "has no elevations"),
        (lambda hill, _: hill(heights=np.where(np.arange(60) < 30, 1.0, -9999.0)
                              * np.ones((60, 1))), "has no elevation, or no slope, at"),
        (lambda _, points: points([1.0] * 4, 2.0, 30.0, first="# crs: EPSG:32612"), "project one"),
        (lambda _, points: points([1.0] * 4, 2.0, 30.0, first="# crs: x"), "is no coordinate"),
        (lambda hill, points: (hill(left=5e5), points([-117.2] * 4, 34.1, 30.0)), "these degrees?"),
        (lambda _, points: points([1.0] * 4, 2.0, 0.6), "expected 2 to 60 degrees"),
        (lambda _, points: points([1.0] * 4, 2.0, 75.0), "line 2: phi_deg = 75"),
        (lambda _, points: points([1.0] * 4, 2.0, 30.0, 0.0), "line 2: sd_deg = 0"),
        (lambda _, points: points([1.0, np.nan] * 2, 2.0, 30.0), "line 3: a value is missing"),
        (lambda _, points: points([1.0] * 2, 2.0, 30.0), "a map needs 3"),
    ],
)  # fmt: skip
def test_what_is_no_map(terraphi, hill, points, tmp_path, change: Change, words) -> None:
    hill()
    points(np.arange(4) * 10.0 + 5.0, 20.0, 30.0)
    change(hill, points)
    ran = terraphi("map", "points.csv", "--dem", "dem.tif", "--out", "maps")
    assert (ran.status, ran.out) == (2, "")
    assert words in ran.err
    assert ran.err.count("\n") == 1
    assert not (tmp_path / "maps").exists()


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (("--start", "5e5,0"), "expected X,Y,BEARING"),
        (("--prior", "cohesion=3"), "did you mean 'cohesion_Pa'"),
        (("--prior", "wetness=0:2"), "wetness lies between 0 and 1"),
        (("--prior", "depth_m=deep"), "expected KEY=LOW:HIGH"),
        (("--wetness", "wet.tif"), "expected shares from 0 to 1"),
        (("--wetness", "other.tif"), "its grid is not that of dem.tif"),
        (("--covariate", "moved.tif"), "its coordinate system is EPSG:32612"),
        (("--covariate", "points.csv"), "not a raster that can be read"),
        (("--covariate", "no.tif"), "no such file"),
        (("--covariate", "slope.tif"), "slope.tif: 'slope' is a covariate already"),
        (("--covariate", "burn.tif", "--wetness", "part.tif"), "part.tif: has no data at some"),
        (("--covariate", "part.tif", "--wetness", "half.tif"), "part.tif: has no data at some"),
    ],
)
def test_what_does_not_fit_the_elevations(terraphi, hill, points, tmp_path, args, words) -> None:
    hill()
    hill(heights=np.full((60, 60), 40.0), name="wet.tif")
    hill(n=50, name="other.tif")
    hill(name="moved.tif", crs="EPSG:32612")
    half = np.full((60, 60), 0.5)
    for name in ("slope.tif", "burn.tif", "half.tif"):
        hill(heights=half, name=name)
    hill(heights=np.where(np.arange(60) < 30, half, -9999.0), name="part.tif")
    points(np.arange(4) * 10.0 + 5.0, 20.0, 30.0)
    ran = terraphi("map", "points.csv", "--dem", "dem.tif", "--out", "maps", *args)
    assert (ran.status, ran.out) == (2, "")
    assert words in ran.err
    assert ran.err.count("\n") == 1
    assert not (tmp_path / "maps").exists()
