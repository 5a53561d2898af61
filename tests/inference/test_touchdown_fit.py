"""The fit of a touch-down against quadrature, and against refits under changed assumptions."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import norm

from terraphi.inference.footfalls import FootfallMap, infer
from terraphi.inference.pool import Normal
from terraphi.inference.touchdowns import (
    Prior,
    Touchdowns,
    fit,
    inertia,
    learn_exponent,
    learn_level,
    noise_covariance,
    picked,
    predicted,
)
from terraphi.laws.foot import LAWS, Foot, moved_mass

PRIOR = Prior()
TORQUES = 24  # gains and frictions of twelve joints
GRAINS = Path(__file__).parents[2] / "studies" / "data" / "grains"


def pressed(phi: float = 34.0, *, level: float = 0.003, seed: int | None = 0) -> Touchdowns:
    """A foot that goes down by 25 mm in 80 ms, with noise as the fit expects it."""
    time = np.arange(0.0, 0.08, 0.002)[None]
    drop = 0.025 * np.sin(0.5 * np.pi * time / 0.08)
    still = np.zeros_like(time)
    observed = Touchdowns(
        foot=np.array([2]), begin=np.zeros(1), place=np.zeros((1, 3)), time=time, drop=drop,
        descent=np.full_like(time, 1.4), speed=still, acceleration=still, force=still,
        per_error=np.zeros((*time.shape, 6)),
        rise=np.zeros((*time.shape, 2)), moved=np.ones(1), heading=np.zeros(1),
        used=np.ones_like(time, dtype=bool), torn=np.zeros(1, bool), saturated=np.zeros(1, bool),
        faulty=np.zeros(1, bool),
        returned=np.zeros(1), peak=np.ones(1), deepest=drop.max(axis=1), broken=np.zeros(1),
    )  # fmt: skip
    force = predicted(LAWS["rft"], PRIOR, observed, np.array([[phi, level, 0.0]]))
    observed = observed._replace(
        force=force, per_error=force[..., None] * [1.0, 1.0, 1.0, 0.0, 0.0, 0.0]
    )
    if seed is not None:
        lower = np.linalg.cholesky(noise_covariance(observed, PRIOR)[0])
        noise = lower @ np.random.default_rng(seed).normal(size=force.shape[1])
        observed = observed._replace(force=force + 0.5 * noise)
    return observed


def test_laplace_agrees_with_quadrature() -> None:
    touchdown = pressed()
    fitted = fit(touchdown, "rft", PRIOR)
    weight = np.linalg.inv(noise_covariance(touchdown, PRIOR)[0])
    half = 4.0 * max(1.0, 1.0 / np.sqrt(fitted.misfit[0])) * fitted.sd[0]
    axes = [
        fitted.phi[0] + np.linspace(-half, half, 41),
        0.003 + np.linspace(-0.012, 0.012, 61),
        np.linspace(-0.035, 0.035, 21),
    ]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    repeated = Touchdowns(*(np.repeat(column, len(grid), axis=0) for column in touchdown))
    left = touchdown.force - predicted(LAWS["rft"], PRIOR, repeated, grid)
    # φ's prior is the pooling's: here only level and drift have one.
    off = grid[:, 1:] / [PRIOR.level_sd, PRIOR.drift_sd]
    chi = np.einsum("nk,kl,nl->n", left, weight, left)

    def moments(misfit: float) -> tuple[float, float]:
        """Mean and standard deviation of φ with the noise, and not the priors, scaled."""
        log = -0.5 * (chi / misfit + (off**2).sum(axis=1))
        mass = np.exp(log - log.max())
        mass /= mass.sum()
        mean = mass @ grid[:, 0]
        return mean, np.sqrt(mass @ (grid[:, 0] - mean) ** 2)

    mean, sd = moments(1.0)
    assert fitted.phi[0] == pytest.approx(mean, abs=0.15 * sd)
    assert fitted.sd[0] == pytest.approx(moments(fitted.misfit[0])[1], rel=0.1)


def test_the_inertia_gives_the_impulse_that_its_mass_takes_up() -> None:
    """Over a landing from above the surface ∫ d(m v)/dt is m v at its end."""
    time = np.linspace(-0.005, 0.05, 4401)[None]
    turn = 0.4 * np.pi * time / 0.05
    drop, rate = 0.03 * np.sin(turn), 0.4 * np.pi / 0.05
    observed = pressed(seed=None)._replace(
        time=time, drop=drop, descent=np.full_like(time, 0.5 * np.pi),
        speed=0.03 * rate * np.cos(turn), acceleration=-(rate**2) * drop,
    )  # fmt: skip
    impulse = np.trapezoid(inertia(PRIOR, observed, drop), time)[0]
    mass = moved_mass(Foot(PRIOR.radius), drop, PRIOR.density)[0]
    momentum = (mass * observed.speed)[0]
    assert impulse == pytest.approx(momentum[-1] - momentum[0], rel=1e-3)
    assert 2.0 < mass[0, -1] / (PRIOR.density * np.pi * PRIOR.radius**3) < 4.0


@pytest.mark.parametrize("soil", ["B", "C", "E"])
@pytest.mark.parametrize("landing", ["l0.5", "l1"])
def test_a_ball_that_lands_in_grains_reads_what_a_slow_one_does(soil: str, landing: str) -> None:
    slow, hit = (landed(f"{soil}-loose_ball_44_{name}1.csv") for name in ("", f"{landing}_"))
    read = [fit(observed, "foot", prior).phi[0] for observed, prior in (slow, hit)]
    assert read[1] == pytest.approx(read[0], abs=2.0)
    # Without the inertia it does not.
    still = hit[0]._replace(acceleration=0.0 * hit[0].speed, speed=0.0 * hit[0].speed)
    assert read[1] - fit(still, "foot", hit[1]).phi[0] > 0.5


def landed(name: str) -> tuple[Touchdowns, Prior]:
    """A record of grains as a touch-down, and its prior."""
    path = GRAINS / name
    density = float(path.read_text().splitlines()[1].split()[2])
    rows = np.loadtxt(path, delimiter=",", skiprows=3)
    rows = rows[(rows[:, 0] > 0.0) & (rows[:, 0] < 25.0)]
    part = [
        rows[part_value].mean(axis=0) for part_value in np.array_split(np.arange(len(rows)), 24)
    ]
    depth, _, force, *moving = np.transpose(part)
    speed, acceleration = moving or (np.full(24, 0.03), np.zeros(24))
    drop = 1e-3 * depth[None]
    gaps = np.diff(drop[0]) / (0.5 * (speed[1:] + speed[:-1]))
    touchdown = Touchdowns(
        foot=np.array([0]), begin=np.zeros(1), place=np.zeros((1, 3)),
        time=np.append(0.0, np.cumsum(gaps))[None], drop=drop,
        descent=np.full((1, 24), 0.5 * np.pi), speed=speed[None], acceleration=acceleration[None],
        force=force[None], per_error=np.zeros((1, 24, 6)),
        rise=np.zeros((1, 24, 2)), moved=np.ones(1), heading=np.zeros(1),
        used=np.ones((1, 24), dtype=bool),
        torn=np.zeros(1, bool), saturated=np.zeros(1, bool),
        faulty=np.zeros(1, bool),
        returned=np.zeros(1), peak=np.ones(1), deepest=drop.max(axis=1), broken=np.zeros(1),
    )  # fmt: skip
    prior = replace(PRIOR, density=density, surface_friction=0.35, level_sd=2e-3, drift_sd=1e-4)
    return touchdown, prior


def test_a_misfit_counts_once_and_the_prior_of_phi_not_at_all() -> None:
    """Noise twice as large doubles the standard deviation, by Birge's ratio."""
    quiet, exact = pressed(seed=1), pressed(seed=None)
    loud = quiet._replace(force=exact.force + 2.0 * (quiet.force - exact.force))
    prior = replace(PRIOR, level_sd=1.0, drift_sd=1.0)  # nothing but noise counts
    first, two = (fit(each, "rft", prior) for each in (quiet, loud))
    assert two.misfit[0] / first.misfit[0] == pytest.approx(4.0, rel=0.2)
    assert two.sd[0] / first.sd[0] == pytest.approx(2.0, rel=0.15)
    sure = fit(loud, "rft", replace(prior, phi_deg=40.0, phi_sd_deg=0.5))
    assert sure.phi[0] == pytest.approx(two.phi[0], abs=0.05 * two.sd[0])
    assert sure.sd[0] == pytest.approx(two.sd[0], rel=0.01)


def test_what_is_shared_moves_the_answer_as_told() -> None:
    touchdown = pressed(seed=None)
    fitted = fit(touchdown, "rft", PRIOR)
    assert fitted.phi[0] == pytest.approx(34.0, abs=0.1)

    def moved(**changed: float) -> float:
        return float(fit(touchdown, "rft", replace(PRIOR, **changed)).phi[0] - fitted.phi[0])

    told = dict(zip(PRIOR.shared(), fitted.shared[0, TORQUES:], strict=True))
    # If the truth is above what is assumed, φ̂ is off by S; to assume more takes it back.
    assert moved(density=1.03 * PRIOR.density) == pytest.approx(
        -0.03 * PRIOR.density * told["density_kg_m3"], rel=0.1
    )
    assert moved(surface_friction=PRIOR.surface_friction + 0.05) == pytest.approx(
        -0.05 * told["surface_friction"], rel=0.15
    )
    assert moved(radius=0.0222) == pytest.approx(-0.2 * told["foot_radius_mm"], rel=0.15)
    # What reads the way down too large, and a law that grows otherwise with depth.
    deeper = (
        fit(touchdown._replace(drop=1.02 * touchdown.drop), "rft", PRIOR).phi[0] - fitted.phi[0]
    )
    assert deeper == pytest.approx(0.02 * told["odometry_drop"], rel=0.15)
    state = np.array([[34.0, 0.003, 0.0]])
    force = predicted(LAWS["rft"], replace(PRIOR, exponent=0.05), touchdown, state)
    depth = touchdown.drop + 0.003  # an exponent does nothing at the radius
    np.testing.assert_allclose(force, touchdown.force * (depth / PRIOR.radius) ** 0.05)
    steeper = fit(touchdown._replace(force=force), "rft", PRIOR).phi[0] - fitted.phi[0]
    assert steeper == pytest.approx(0.05 * told["law_exponent"], rel=0.15)
    louder = (
        fit(touchdown._replace(force=1.02 * touchdown.force), "rft", PRIOR).phi[0] - fitted.phi[0]
    )
    gains = fitted.shared[0, 6:9].sum()
    assert louder == pytest.approx(gains * 0.02 / 3.0, rel=0.1)


def test_what_is_shared_is_the_scatter_of_angles_when_it_is_drawn() -> None:
    """Of 41 touch-downs in one soil, each with another density, friction, radius, drop or law."""
    observed, prior = pressed(seed=None), replace(PRIOR, exponent_sd=0.03)
    touchdowns, state = picked(observed, np.zeros(41, int)), np.array([[34.0, 0.003, 0.0]])
    spread = norm.ppf((np.arange(41) + 0.5) / 41)
    spread /= spread.std()
    per_unit = dict(
        zip(prior.shared(), fit(observed, "rft", prior).shared[0, TORQUES:], strict=True)
    )
    fields = {"density_kg_m3": "density", "surface_friction": "surface_friction",
              "foot_radius_mm": "radius", "law_exponent": "exponent"}  # fmt: skip
    for name, (_, sd) in prior.shared().items():
        if name == "odometry_drop":
            drawn = touchdowns._replace(drop=(1.0 + sd * spread[:, None]) * touchdowns.drop)
        elif name in fields:
            key, unit = fields[name], 1e-3 if name.endswith("_mm") else 1.0
            forces = [
                predicted(LAWS["rft"], replace(prior, **{key: getattr(prior, key) + unit * item}),
                          observed, state)[0] for item in sd * spread
            ]  # fmt: skip
            drawn = touchdowns._replace(force=np.array(forces))
        else:  # of angles themselves, or between places
            continue
        scatter = np.std(fit(drawn, "rft", prior).phi)
        assert scatter == pytest.approx(abs(per_unit[name]) * sd, rel=0.15), name


def test_the_interval_of_a_touchdown_is_the_scatter_of_drawn_ones() -> None:
    """Level, drift and noise as the fit expects them."""
    observed, rng = pressed(seed=None), np.random.default_rng(4)
    touchdowns = picked(observed, np.zeros(400, int))
    state = np.column_stack([np.full(400, 34.0), *(0.004 * rng.normal(size=(2, 400)))])
    prior = replace(PRIOR, level_sd=0.004, drift_sd=0.004)
    force = predicted(LAWS["rft"], prior, touchdowns, state)
    lower = np.linalg.cholesky(noise_covariance(observed._replace(force=force[:1]), prior)[0])
    drawn = touchdowns._replace(force=force + rng.normal(size=force.shape) @ lower.T)
    fitted = fit(drawn, "rft", prior)
    assert np.std((fitted.phi - 34.0) / fitted.sd) == pytest.approx(1.0, rel=0.15)


def test_growth_with_depth_is_learnt_from_the_courses_of_force() -> None:
    """Sand whose resistance grows slower with depth than the law's by a power of 0.3."""
    levels = np.linspace(0.0, 0.006, 30)
    each = [pressed(40.4, level=level, seed=i) for i, level in enumerate(levels)]
    touchdown = Touchdowns._make(map(np.concatenate, zip(*each, strict=True)))
    depth = np.maximum(touchdown.drop + 0.003, 1e-4)
    softer = touchdown._replace(force=touchdown.force * (depth / PRIOR.radius) ** -0.3)
    assert learn_exponent(touchdown, "rft", PRIOR).exponent == pytest.approx(0.0, abs=0.08)
    result = learn_exponent(softer, "rft", PRIOR)
    assert result.exponent == pytest.approx(-0.3, abs=0.08)
    assert fit(softer, "rft", result).phi.mean() == pytest.approx(40.4, abs=0.8)


def test_levels_of_a_walk_are_learned_from_it_and_shared() -> None:
    """Feet that first meet force 5 ± 1 mm deep, on sand of one angle."""
    observed, rng = pressed(seed=None), np.random.default_rng(3)
    levels = rng.normal(0.005, 0.001, 60)
    touchdown = picked(observed, np.zeros(60, int))
    state = np.column_stack([np.full(60, 36.0), levels, np.zeros(60)])
    force = predicted(LAWS["rft"], PRIOR, touchdown, state)
    lower = np.linalg.cholesky(noise_covariance(observed._replace(force=force[:1]), PRIOR)[0])
    touchdown = touchdown._replace(force=force + rng.normal(size=force.shape) @ lower.T)
    prior = learn_level(touchdown, "rft", PRIOR)
    assert prior.level == pytest.approx(0.005, abs=0.0005)
    # The scatter of levels, and the prior's 10 mm, which count as one more touch-down.
    assert prior.level_sd == pytest.approx(math.sqrt(0.001**2 + 0.01**2 / 61.0), rel=0.2)
    each, common = (fit(touchdown, "rft", some).phi for some in (PRIOR, prior))
    assert common.std() < 0.95 * each.std()
    assert common.mean() == pytest.approx(36.0, abs=0.2)
    # One touch-down says little of others.
    assert learn_level(picked(touchdown, [0]), "rft", PRIOR).level_sd > 0.005


def walked(soil: str, phi: np.ndarray, *, exponent: float = 0.0) -> FootfallMap:
    """Footfalls by law foot on soil of a law, φ given for each, every 0.2 m."""
    count = len(phi)
    state = np.stack([phi, np.full(count, 0.003), np.zeros(count)], axis=-1)
    touchdown = pressed(seed=None)
    observed = Touchdowns._make(np.repeat(column, count, axis=0) for column in touchdown)
    place = np.column_stack([0.2 * np.arange(count), np.zeros((count, 2))])
    force = predicted(LAWS[soil], replace(PRIOR, exponent=exponent), observed, state)
    observed = observed._replace(place=place, force=force, deepest=np.full(count, 0.03))
    shared = Normal(np.zeros(TORQUES), 1e-6 * np.eye(TORQUES))
    return infer(
        observed, shared, place[:, [0, 0, 1]], prior=PRIOR,
        law="foot", anchors=[], feet=("FR", "FL", "RR", "RL"), notes=[], provenance={},
    )  # fmt: skip


@pytest.mark.parametrize(("soil", "read"), [("foot", (0.95, 1.05)), ("rft", (0.3, 0.7))])
def test_differences_between_places_are_inside_their_interval(
    soil: str, read: tuple[float, float]
) -> None:
    """Law foot reads differences on soil of rft too small: by its growth with depth it is known."""
    phi = 40.0 + 2.0 * np.sin(np.arange(24.0))
    footfall_map = walked(soil, phi)
    assert footfall_map.usable.all()
    slope = np.polyfit(phi, footfall_map.phi, 1)[0]
    assert read[0] < slope < read[1]
    difference = np.abs((footfall_map.phi - footfall_map.phi.mean()) - (phi - phi.mean()))
    assert np.all(difference < 1.96 * footfall_map.sd)
    # The error of the scale is about as large as stated, or there is none.
    assert footfall_map.sd.max() < 2.0 * max(difference.max(), 0.2)


@pytest.mark.parametrize(
    ("soil", "phi"), [("rft", 30.0), ("hansen", 34.0), ("meyerhof", 34.0), ("meyerhof", 38.0)]
)
def test_other_laws_are_inside_the_absolute_interval_where_they_fit_as_well(
    soil: str, phi: float
) -> None:
    """Law foot reads their sand 3.5 to 8° high; the forces show how they grow with depth."""
    footfall_map = walked(soil, np.full(12, phi))
    off = footfall_map.phi - phi
    assert np.all(off > 3.0)
    assert np.all(off < 1.96 * footfall_map.absolute_sd)
    # Between places of one walk it is no error.
    assert footfall_map.sd.max() < 1.0
    if soil == "meyerhof":
        assert any(f"law meyerhof rather than foot: by it φ is {phi:.0f}°" in note
                   for note in footfall_map.warnings)  # fmt: skip


def test_sand_of_the_law_itself_keeps_its_interval() -> None:
    """Where the law fits best, others add next to nothing to its 2.6°."""
    footfall_map = walked("foot", np.full(12, 36.0))
    assert footfall_map.shared["law_offset_deg"]["sd"] < 2.8


@pytest.mark.parametrize(("exponent", "noted"), [(-0.45, True), (-0.2, False)])
def test_soil_that_grows_slower_with_depth_than_dry_sand_is_noted(
    exponent: float, noted: bool
) -> None:
    footfall_map = walked("foot", np.full(12, 36.0), exponent=exponent)
    assert footfall_map.shared["law_exponent"]["mean"] == pytest.approx(exponent, abs=0.05)
    assert any("damp" in note for note in footfall_map.warnings) == noted


def test_noise_has_its_three_parts() -> None:
    touchdown = pressed(seed=None)
    still = np.zeros_like(touchdown.time)
    for force, speed in ((0.0, 0.0), (100.0, 0.0), (0.0, 2.0)):
        item = touchdown._replace(force=still + force, speed=still + speed)
        # What it takes to set the soil below the foot in motion is known to 30 %.
        hit = 0.3 * inertia(PRIOR, item, item.drop)[0]
        sd = np.sqrt(1.5**2 + (0.04 * force) ** 2 + hit**2)
        matrix = noise_covariance(item, PRIOR)[0]
        assert np.sqrt(np.diag(matrix)) == pytest.approx(sd, rel=1e-5)
        assert matrix[0, 4] == pytest.approx(sd[0] * sd[4] * np.exp(-1.0))  # 8 ms apart
        assert (hit.max() > 3.0) == (speed > 0.0)
