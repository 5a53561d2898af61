"""How well footfalls tell φ: simulated walks on sand of known φ, in a table.

    python examples/sand_check.py --seeds 5 --keep walks

Matched worlds (the law that is assumed), worlds of other laws with and without an anchor, and a
hard floor. A walk takes about a minute to simulate; ``--keep`` keeps it for the next time.
"""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np
from go2.walk import Recording
from sand_walk import sand_log, sand_walk

from terraphi.robot.footfall_map import Anchor
from terraphi.robot.footfalls import FootfallMap, footfalls

CASES = {"rft": 33.0, "floor": 0.0, "meyerhof": 38.5, "vesic": 38.5, "hansen": 38.5}
"""Laws of the world, and the mean φ at which a Go2 does not sink too deep to walk [deg]."""
ANCHOR_M, ANCHOR_SD = 0.5, 1.0
"""A shear test speaks of the first half metre, right to a degree."""


class Score(NamedTuple):
    """How one walk was told."""

    footfalls: int
    usable: int
    rmse: float
    bias: float
    held68: float
    held95: float
    absolute: float
    anchored: float


def recorded(keep: Path | None, gait: str, law: str, seed: int, duration: float) -> Recording:
    """A simulated walk, or the one that was kept."""
    place = None if keep is None else keep / f"{law}-{gait}-{seed}-{duration:g}.npz"
    if place is not None and place.exists():
        with np.load(place) as kept:
            return Recording(**{f.name: kept[f.name] for f in fields(Recording)})
    walk = sand_walk(gait, seed=seed, law=law, duration=duration, mean=CASES[law])
    recording = walk.run()
    if place is not None:
        place.parent.mkdir(parents=True, exist_ok=True)
        np.savez(place, **{f.name: getattr(recording, f.name) for f in fields(Recording)})
    return recording


def score(gait: str, law: str, seed: int, recording: Recording) -> Score:
    """Compare what a walk's log tells with what was true."""
    walk = sand_walk(gait, seed=seed, law=law, mean=CASES[law])
    log = sand_log(recording, seed=100 + seed)
    found = footfalls(log)
    usable = int(found.usable.sum())
    if walk.sand is None or not usable:
        return Score(len(found.verdict), usable, *[np.nan] * 6)
    start = recording.position[0, :2]
    truth = walk.sand.phi(found.path[:, 1:] + start)
    off = found.path_phi - truth
    each = (found.phi - walk.sand.phi(found.place[:, :2] + start))[found.usable]
    own = found.sd[found.usable]
    near = found.path[:, 1] <= ANCHOR_M
    # The shear test errs as it says.
    err = np.random.default_rng(seed).normal(0.0, ANCHOR_SD / 3.0)
    anchor = Anchor(-1.0, ANCHOR_M, float(truth[near].mean() + err), ANCHOR_SD / 3.0)
    held = footfalls(log, anchors=[anchor])
    return Score(
        len(found.verdict),
        usable,
        float(np.sqrt(np.mean(off**2))),
        float(off.mean()),
        float(np.mean(np.abs(each) < own)),
        float(np.mean(np.abs(each) < 1.96 * own)),
        _absolute(found, off),
        float(np.sqrt(np.mean((held.path_phi - truth) ** 2))),
    )


def _absolute(found: FootfallMap, off: np.ndarray) -> float:
    """Part of the path whose truth lies in the absolute 95 % band."""
    return float(np.mean(np.abs(off) < 1.96 * found.path_absolute_sd))


@click.command()
@click.option("--seeds", type=int, default=5, show_default=True)
@click.option("--duration", type=float, default=20.0, show_default=True, help="Of a walk [s].")
@click.option("--keep", type=click.Path(path_type=Path), help="Folder for simulated walks.")
@click.option("--law", "laws", type=click.Choice(sorted(CASES)), multiple=True, default=CASES)
def main(seeds: int, duration: float, keep: Path | None, laws: tuple[str, ...]) -> None:
    """Simulate walks on sand and print how well their footfalls tell φ, as Markdown."""
    head = ("world", "gait", "seed", "footfalls", "usable", "map RMSE [deg]", "mean error [deg]",
            "in 68 % relative", "in 95 % relative", "path in 95 % absolute",
            "anchored RMSE [deg]")  # fmt: skip
    click.echo("| " + " | ".join(head) + " |\n" + "|---" * len(head) + "|")
    for law in laws:
        for gait in ("walk", "trot"):
            for seed in range(seeds):
                try:
                    recording = recorded(keep, gait, law, seed, duration)
                except RuntimeError as fallen:
                    click.echo(f"| {law} | {gait} | {seed} | {fallen} |")
                    continue
                found = score(gait, law, seed, recording)
                numbers = ["–" if np.isnan(v) else f"{v:.2f}" for v in found[2:]]
                cells = (law, gait, str(seed), str(found.footfalls), str(found.usable), *numbers)
                click.echo("| " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
