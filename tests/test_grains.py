"""Clumps that LIGGGHTS moves, compared with the mechanics of a rigid body; needs its program."""

from __future__ import annotations

import math
import shutil
from dataclasses import replace
from pathlib import Path

import compute
import elements
import engine
import numpy as np
import pytest
import run
import table
import yade

import errors
from terraphi.laws.legs import shipped_legs

SOIL = replace(run.soils()["I-loose"], spread=0.0)
engine_is_there = pytest.mark.skipif(not shutil.which("liggghts"), reason="no LIGGGHTS")
STEP = 1e-4


def soil_of(clump: str) -> engine.Soil:
    """A soil of equal grains of 6 mm."""
    return replace(SOIL, clump=clump)


def exact(aspect: float) -> tuple[float, float, float]:
    """Radius [m], mass [kg] and moment of inertia across [kg m2] of a dimer as large as 6 mm.

    Its volume is that of two balls cut off where they meet, a solid of revolution.
    """
    x = np.linspace(0.0, aspect, 200_001)  # along, in radii
    y2 = 1.0 - np.square(x - (aspect - 1.0))
    volume = 2.0 * math.pi * np.trapezoid(y2, x)
    across = 2.0 * math.pi * np.trapezoid(y2 * x**2 + y2**2 / 4.0, x)
    radius = (math.pi / 6.0 * 6e-3**3 / volume) ** (1.0 / 3.0)
    return radius, engine.DENSITY * volume * radius**3, engine.DENSITY * across * radius**5


@pytest.mark.parametrize("aspect", [1.25, 1.5])
def test_dimers_are_as_large_as_the_ball_they_stand_for(aspect: float) -> None:
    balls = 6e-3 * engine.spheres(f"dimer of aspect {aspect}")
    radius, _, _ = exact(aspect)
    assert balls[0, 3] == pytest.approx(radius, rel=2e-4)  # by a grid of 100 points along
    assert np.ptp(balls[:, 0]) + 2.0 * balls[0, 3] == pytest.approx(2.0 * aspect * balls[0, 3])


@pytest.mark.parametrize("clump", sorted(engine.CLUMPS))
def test_volume_of_a_clump_by_points_at_random(clump: str) -> None:
    balls = engine.spheres(clump)
    points = np.random.default_rng(1).uniform(-0.9, 0.9, (400_000, 3))
    assert np.abs(balls[:, :3]).max() + balls[0, 3] < 0.9
    difference = np.linalg.norm(points[:, None] - balls[:, :3], axis=2)
    share = float((difference < balls[:, 3]).any(axis=1).mean())
    error = 1.8**3 * math.sqrt(share / 400_000)
    assert share * 1.8**3 == pytest.approx(math.pi / 6.0, abs=3.0 * error)


def moved(clump: str, folder: Path, *, height: float, tilt: float = 0.0, more: str = "",
          rest: float = 0.0, time: float = 0.02) -> np.ndarray:  # fmt: skip
    """What one clump does in a time [s] that begins some time after it was let go.

    It stands as its template does, gravity is tilted [deg], and ``more`` is done before. Rows of
    spheres, columns of x, y, z and velocity.
    """
    soil, (sine, cosine) = soil_of(clump), (f(math.radians(tilt)) for f in (math.sin, math.cos))
    steps = round(time / STEP)
    templates = engine.templates(soil, 1).replace("ntry 1000000", "ntry 100000")
    deck = f"""{engine.header(soil, walls=False)}region box block -0.05 0.05 -0.05 0.05 -0.01 0.2 &
  units box
create_box 2 box
{engine.contacts(soil)}
timestep {STEP}
fix integrate all {engine.integrator(soil)}
fix gravity all gravity {engine.GRAVITY} vector {sine} 0 {-cosine}
fix floor all {engine.WALL} primitive type 2 zplane 0
{templates}region fill block -0.001 0.001 -0.001 0.001 {height} {height + 1e-3} &
  units box
fix pour all insert/pack seed {engine.prime(9)} distributiontemplate sizes maxattempt 9 &
  insert_every once overlapcheck yes all_in no orientation template region fill &
  particles_in_region 1
run 1
unfix pour
run {round(rest / STEP)}
{more}dump first all custom 1 first.dump id x y z vx vy vz
run 0
undump first
run {steps}
dump last all custom 1 last.dump id x y z vx vy vz
run 0
"""
    engine.run(deck, folder, "one")
    first, last = (engine.dump(folder / f"{name}.dump") for name in ("first", "last"))
    return (last[last[:, 0].argsort()] - first[first[:, 0].argsort()])[:, 1:]


@engine_is_there
def test_a_clump_falls_as_a_body(tmp_path: Path) -> None:
    spheres = moved("tetrahedron of four", tmp_path, height=0.1, rest=0.01, time=0.02)
    gained = engine.GRAVITY * 0.02
    np.testing.assert_allclose(spheres[:, 3:], [[0.0, 0.0, -gained]] * 4, atol=1e-4 * gained)
    fallen = 0.5 * engine.GRAVITY * (0.03**2 - 0.01**2)
    np.testing.assert_allclose(spheres[:, 2], -fallen, rtol=0.02)  # within two steps of 300


@engine_is_there
def test_a_dimer_turns_by_its_moment_of_inertia(tmp_path: Path) -> None:
    """A force on one of its spheres moves the middle by F/m and turns it by F δ/I."""
    force, time = 1e-4, 0.02
    more = f"""group one id 1
fix push one addforce 0 {force} 0
"""
    spheres = moved("dimer of aspect 1.5", tmp_path, height=0.1, more=more, time=time)
    radius, mass, inertia = exact(1.5)
    assert spheres[:, 4].mean() == pytest.approx(force / mass * time, rel=0.01)
    turned = abs(np.diff(spheres[:, 4]).item()) / radius  # they are a radius apart
    assert turned == pytest.approx(
        force * 0.5 * radius / inertia * time, rel=0.02
    )  # 1e5 points at random


@engine_is_there
@pytest.mark.parametrize("over", [-1.0, 1.0, 8.0])
def test_a_flat_clump_slides_where_friction_says(over: float, tmp_path: Path) -> None:
    """On a plane tilted to the angle of friction and so much more [deg]."""
    clump = "flat square of four"
    angle = math.degrees(math.atan(SOIL.leg_friction)) + over
    height = 6e-3 * float(engine.spheres(clump)[0, 3])
    time = 0.3
    spheres = moved(clump, tmp_path, height=height, tilt=angle, rest=0.1, time=time)
    tilt = math.radians(angle)
    acceleration = engine.GRAVITY * (math.sin(tilt) - SOIL.leg_friction * math.cos(tilt))
    speed = float(spheres[:, 3].mean())
    if over < 0.0:
        assert abs(speed) < 1e-3
    else:
        assert speed == pytest.approx(acceleration * time, rel=0.05)


def test_law_is_learned_from_all_loose_grains() -> None:
    """Those of other shapes, sizes, rigs and by another code, too."""
    legs = shipped_legs().error.legs
    names = {leg: {row.name for row in errors.grains() if row.rig.leg == leg} for leg in legs}
    assert {leg: {*of_leg.training} for leg, of_leg in legs.items()} == names


def test_a_soil_that_is_left_out_is_in_no_record_of_training(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of soil B another code has records, and legs on other rigs."""
    reading = {"read": 28.0, "shift": 0.0, "nrmsd": 0.1}
    monkeypatch.setattr(errors, "readings", lambda row: reading)
    without = table.law_without.__wrapped__("B").error.legs
    expected = {row.name for row in table.loose() if row.letter != "B"}
    assert {name for of_leg in without.values() for name in of_leg.training} == expected


def test_queue_has_records_that_can_be_made(tmp_path: Path) -> None:
    bodies = {f"rig-{rig.name}" for rig in run.rigs()} | {"straight", "c", "reversed_c"}
    queue, soils = list(compute.missing(tmp_path, ())), run.soils()
    assert len(queue) == len({*queue}) > 100
    for stem in queue:
        name, body, seed = stem.split("_", 1)[0], *stem.split("_", 1)[1].rsplit("_", 1)
        assert name in soils
        if body.startswith("wheel"):
            diameter, _, (_, height), slip = run.wheel_of(body)
            assert 0.0 <= height < 0.5 * diameter
            assert -1.0 < slip < 1.0
        else:
            assert body in bodies | {*elements.TESTS} or run.foot_of(body)[0].radius > 0.0
        assert int(seed) > 0
    (tmp_path / f"{queue[0]}.csv").touch()
    assert list(compute.missing(tmp_path, {queue[2]})) == [queue[1], *queue[3:]]


def test_second_code_begins_with_the_same_spheres_in_a_cell_that_holds_them(tmp_path: Path) -> None:
    soil, box = run.soils()["B-loose"], (-0.06, 0.06, -0.04, 0.04)
    task = yade.packed(soil, 1, box, 0.05, tmp_path, walls=True)
    grains, fixed = (np.load(tmp_path / f"{name}.npy") for name in ("grains", "fixed"))
    lines = (tmp_path / "lattice.data").read_text().splitlines()
    assert f"{len(grains)} atoms" in lines
    assert len(fixed) == task["fixed"]
    centers, radii = grains[:, 1:4], 0.5 * grains[:, :1]
    assert (centers - radii > 0.0).all()
    assert (centers + radii < task["size"]).all()
    apart = np.linalg.norm(centers[:, None] - fixed[:, 1:4], axis=2)
    assert (apart > radii + 0.5 * fixed[:, 0]).all()
    # Mindlin's stiffness k = 8 G* a, where Hertz's contact of radius a bears F = 4 E* a³ / 3 R*.
    poisson, reduced = engine.POISSON, 0.25 * soil.diameter
    plane, shear = soil.youngs / 2.0 / (1.0 - poisson**2), soil.youngs / 4.0 / (1.0 + poisson)
    a = (0.75 * yade.PRESSURE * soil.diameter**2 * reduced / plane) ** (1.0 / 3.0)
    k = 8.0 * shear / (2.0 - poisson) * a
    assert task["stiffness"] == pytest.approx(k * reduced**2)
