"""How accurate footfalls are: simulated walks on sand of known φ, as a table.

    python examples/sand_check.py --keep walks --csv worlds.csv --page worlds.md

Worlds of the assumed law (``foot``), of other laws and of ground that is no sand; gaits; frictions
between foot and sand; robots; seeds. A walk takes half a minute to simulate; ``--keep`` keeps it,
so that an interrupted run goes on.
"""

from __future__ import annotations

import time
from dataclasses import fields, replace
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np
import pandas as pd
from go2.control import HEIGHT
from go2.model import GO2_MASS
from go2.sand import Crust, Displaced, Elastic, Ground, Sand, Trodden
from go2.walk import Recording, Walk
from sand_walk import GAITS, sand_log, sand_walk

from terraphi.inference.footfalls import PRINT, TRODDEN, FootfallMap
from terraphi.inference.pool import Anchor
from terraphi.robot.footfalls import footfalls
from terraphi.robot.model import Robot


class World(NamedTuple):
    """What the feet feel: a law, an exponent that is added to its power of depth, and more.

    Mean of φ and its spread over the place [deg], the length over which it changes [m], and the
    cohesion [Pa].
    """

    law: str
    exponent: float
    mean: float
    spread: float = 1.5
    length: float = 1.0
    cohesion: float = 0.0


WORLDS = {
    "foot": World("foot", 0.0, 42.0),
    "foot depth^0.7": World("foot", -0.3, 45.0),
    "rft": World("rft", 0.0, 44.0),
    "hansen": World("hansen", 0.0, 38.5),
    "meyerhof": World("meyerhof", 0.0, 38.5),
    **{f"{law} 26 to 36": World(law, 0.0, 31.0, 4.0, 0.5)
       for law in ("foot", "rft", "hansen", "meyerhof")},
    "damp 75 Pa": World("foot", 0.0, 38.0, cohesion=75.0),
    "damp 200 Pa": World("foot", 0.0, 34.0, cohesion=200.0),
    "floor": World("floor", 0.0, 0.0),
}  # fmt: skip
"""At the first angles in plane strain feet sink 1 to 2 radii, at 26° up to 5."""
GROUNDS: dict[str, Sand] = {
    "mat": Elastic(stiffness=4e3),
    "foam": Elastic(stiffness=3e3, lossy=6e3, relaxation=0.1),
    "soft floor": Elastic(stiffness=3e4),
    "hard layer": Elastic(stiffness=1e5, cover=0.02),
    "crust": Crust(),
    "trodden": Trodden(),
    "clay": Ground(strength=8e3),
    "layer": Ground(stiffness=4e3),
    "clay under a crust": Ground(strength=8e3, crust_N=40.0, thickness=0.004),
    "displaced": Displaced(),
}
"""Ground that is no dry virgin sand, or not only: no footfall may be usable without a note.
The last one is sand by Archimedes' law: nearly all should be."""
HELD_BACK = ("slow", "limp")
"""Gaits that walk in the first world only."""
ANCHOR_M, ANCHOR_SD = 0.5, 1.0 / 3.0
"""A shear test on the first half metre, right to a degree at most."""


def world_walk(
    world: str, gait: str, friction: float, seed: int, duration: float, robot: Path | None
) -> Walk:
    """The walk of one row of the table."""
    soil = WORLDS.get(world, WORLDS["foot"])
    body = None if robot is None else Robot.load(robot)
    walk = sand_walk(
        gait, seed=seed, law=soil.law, duration=duration,
        mean=soil.mean, spread=soil.spread, length=soil.length,
    )  # fmt: skip
    if world in GROUNDS and walk.sand is not None:
        ground = replace(GROUNDS[world], phi=walk.sand.phi, surface=walk.sand.surface)
        if isinstance(ground, Trodden):
            ground = replace(ground, prints=prints_of(walk, walk.run()))
        walk = replace(walk, sand=ground)
    elif walk.sand is not None:
        sand = replace(
            walk.sand, exponent=soil.exponent, surface_friction=friction, cohesion=soil.cohesion
        )
        walk = replace(walk, sand=sand)
    if body is None:
        return walk
    longer = float(body.leg_length.mean() / Robot.load("go2").leg_length.mean())
    heavier = body.mass / GO2_MASS
    physics = replace(
        walk.physics, coulomb=walk.physics.coulomb * heavier, viscous=walk.physics.viscous * heavier
    )
    return replace(
        walk,
        robot=robot,
        physics=physics,
        gait=replace(walk.gait, clearance=walk.gait.clearance * longer),
        aim=replace(walk.aim, height=HEIGHT * longer, speed=walk.aim.speed * longer),
        sand=None if walk.sand is None else replace(walk.sand, radius=body.foot_radius),
    )


def prints_of(walk: Walk, recording: Recording) -> np.ndarray:
    """Places and depths of the prints that a walk left [m], shape [print, 3]."""
    assert walk.sand is not None
    place, loaded = recording.foot_position, recording.force[..., 2] > 0.0
    depth = walk.sand.surface(place) - (place[..., 2] - walk.sand.radius)
    prints = []
    for foot in range(4):
        starts = np.flatnonzero(np.diff(loaded[:, foot].astype(int), prepend=0) > 0)
        for rows in np.split(np.arange(len(place)), starts)[1:]:
            at = rows[depth[rows, foot].argmax()]
            prints.append([*place[at, foot, :2], depth[at, foot]])
    return np.array(prints)


def recorded(walk: Walk, place: Path | None) -> Recording:
    """A simulated walk, or the one that was kept."""
    if place is not None and place.exists():
        with np.load(place) as kept:
            return Recording(**{f.name: kept[f.name] for f in fields(Recording)})
    recording = walk.run()
    if place is not None:
        place.parent.mkdir(parents=True, exist_ok=True)
        np.savez(place, **{f.name: getattr(recording, f.name) for f in fields(Recording)})
    return recording


def score(walk: Walk, recording: Recording, seed: int) -> dict[str, float]:
    """Compare what a walk's log gives with what was true."""
    log = sand_log(recording, seed=100 + seed)
    robot: str | Path = walk.robot or "go2"
    begun = time.perf_counter()
    found = footfalls(log, robot=robot)
    spent = time.perf_counter() - begun
    usable, printed = found.usable, [verdict in (PRINT, TRODDEN) for verdict in found.verdict]
    numbers = {"footfalls": len(usable), "usable": int(usable.sum()), "s_per_min": spent}
    numbers["s_per_min"] *= 60.0 / float(log.time[-1] - log.time[0])
    numbers["virgin"] = len(usable) - sum(printed)
    numbers["notes"] = len(found.warnings) - 2  # of the density, and that there is no anchor
    if walk.sand is None or isinstance(walk.sand, Elastic | Crust | Ground) or not usable.any():
        return numbers
    start = recording.position[0, :2]
    truth = walk.sand.phi(found.path[:, 1:] + start)
    near = found.path[:, 1] <= ANCHOR_M
    # The shear test errs as it says.
    err = np.random.default_rng(seed).normal(0.0, ANCHOR_SD)
    anchor = Anchor(-1.0, ANCHOR_M, float(truth[near].mean() + err), ANCHOR_SD)
    held = footfalls(log, robot=robot, anchors=[anchor])

    def off(one: FootfallMap) -> np.ndarray:
        there = walk.sand.phi(one.place[:, :2] + start)  # type: ignore[union-attr]
        return (one.phi - there)[one.usable]

    each, whole = off(found), np.hypot(found.sd, found.shared_sd)[usable]
    # What is added to all footfalls alike is no part of the relative band.
    apart, own = each - each.mean(), found.sd[usable]
    there = walk.sand.phi(found.place[usable, :2] + start)
    return {
        **numbers,
        "contrast": np.polyfit(there, found.phi[usable], 1)[0],
        "bias": each.mean(),
        "rmse": np.sqrt(np.mean(each**2)),
        "absolute_sd": np.mean(whole),
        "relative68": np.mean(np.abs(apart) < own),
        "relative95": np.mean(np.abs(apart) < 1.96 * own),
        "absolute68": np.mean(np.abs(each) < whole),
        "absolute95": np.mean(np.abs(each) < 1.96 * whole),
        "anchored_rmse": np.sqrt(np.mean(off(held) ** 2)),
        "anchored95": np.mean(np.abs(held.path_phi - truth) < 1.96 * held.path_absolute_sd),
    }


def page(rows: pd.DataFrame) -> str:
    """Means over gaits and seeds of each world, robot and friction, as Markdown."""
    head = ("world", "robot", "foot friction", "walks", "usable", "usable of virgin ground",
            "bias [°]", "RMSE [°]", "absolute ± [°]", "in relative 68 / 95 %",
            "in absolute 68 / 95 %", "RMSE anchored [°]", "contrast, read / true")  # fmt: skip
    lines = [head, ("---",) * len(head)]
    for keys, walks in rows.groupby(["world", "robot", "friction"], sort=False):
        mean = walks.mean(numeric_only=True)
        usable = [
            f"{walks['usable'].sum() / max(walks[of].sum(), 1):.0%}"
            for of in ("footfalls", "virgin")
        ]
        cells = (*map(str, keys), str(len(walks)), *usable)
        if "bias" in mean and np.isfinite(mean["bias"]):
            within = [
                f"{mean[f'{band}68']:.0%} / {mean[f'{band}95']:.0%}"
                for band in ("relative", "absolute")
            ]
            *degrees, anchored = (
                f"{mean[name]:.1f}" for name in ("bias", "rmse", "absolute_sd", "anchored_rmse")
            )
            cells += (*degrees, *within, anchored, f"{mean['contrast']:.2f}")
        lines.append(cells + ("–",) * (len(head) - len(cells)))
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


@click.command()
@click.option(
    "--world",
    "worlds",
    multiple=True,
    default=[*WORLDS, *GROUNDS],
    type=click.Choice([*WORLDS, *GROUNDS]),
)
@click.option("--gait", "gaits", type=click.Choice(sorted(GAITS)), multiple=True, default=GAITS)
@click.option("--friction", "frictions", type=float, multiple=True, default=(0.5, 0.3))
@click.option("--robot", type=click.Path(path_type=Path), help="URDF or MJCF instead of the Go2.")
@click.option("--seeds", type=int, default=5, show_default=True)
@click.option("--duration", type=float, default=12.0, show_default=True, help="Of a walk [s].")
@click.option("--keep", type=click.Path(path_type=Path), help="Folder for simulated walks.")
@click.option("--kept-only", is_flag=True, help="Leave out walks that are not kept.")
@click.option("--csv", type=click.Path(path_type=Path), help="A row a walk.")
@click.option(
    "--page", "out", type=click.Path(path_type=Path), help="Means over seeds, as Markdown."
)
def main(
    worlds: tuple[str, ...],
    gaits: tuple[str, ...],
    frictions: tuple[float, ...],
    robot: Path | None,
    seeds: int,
    duration: float,
    keep: Path | None,
    kept_only: bool,
    csv: Path | None,
    out: Path | None,
) -> None:
    """Simulate walks on sand and write how accurate their footfalls are."""
    rows = []
    name = "go2" if robot is None else Robot.load(robot).name
    for seed in range(seeds):
        for world in worlds:
            # Formulas of bearing capacity have no friction; slow and limping walks are of the first
            # world.
            law = WORLDS[world].law if world in WORLDS else world
            for friction in frictions if law in ("foot", "rft") else frictions[:1]:
                for gait in gaits if world == "foot" else [g for g in gaits if g not in HELD_BACK]:
                    row = {"world": world, "robot": name, "gait": gait, "friction": friction}
                    file = f"{name}-{world}-{gait}-{friction:g}-{seed}-{duration:g}.npz"
                    place = None if keep is None else keep / file
                    if kept_only and (place is None or not place.exists()):
                        continue
                    walk = world_walk(world, gait, friction, seed, duration, robot)
                    try:
                        found = score(walk, recorded(walk, place), seed)
                    except click.ClickException as fallen:
                        click.echo(f"{file}: {fallen.message}", err=True)
                        continue
                    rows.append({**row, "seed": seed, **found})
                    click.echo(f"{file}: {found}", err=True)
                    if csv is not None:
                        pd.DataFrame(rows).to_csv(csv, index=False, float_format="%.4g")
    table = page(pd.DataFrame(rows))
    click.echo(table)
    if out is not None:
        out.write_text(table, encoding="utf-8")


if __name__ == "__main__":
    main()
