"""φ under footfalls while a robot walks: read a bag as a stream, as a node on the robot would.

    python examples/go2_walk.py --out walk --gait walk --period 1.2 --duration 20 --format mcap
    python examples/online.py walk/realistic.mcap --density 1550±80

Fifty messages of a bag (0.1 s of a Go2) at a time go to ``Footfalls.update``, and each footfall is
printed when it is over. At the end comes the map, and what it all took.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from pathlib import Path

import click
from rosbags.highlevel import AnyReader

from terraphi import Footfalls, InputError, JointLog, Messages
from terraphi.inference.footfalls import USABLE
from terraphi.robot.logs.bags import IMU, JOINT_STATE, LOW_STATE, typestore

MESSAGES = 50
"""Messages that are handed over together."""


def samples(bag: Path) -> Iterator[JointLog]:
    """The messages of a bag as a subscriber has them, a few at a time."""
    kinds = (LOW_STATE, JOINT_STATE, IMU)
    messages = Messages()
    with AnyReader([bag], default_typestore=typestore()) as reader:
        chosen = [c for c in reader.connections if c.msgtype in kinds]
        received = (reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages(chosen))
        while some := list(itertools.islice(received, MESSAGES)):
            if piece := messages.take(*some):
                yield piece


@click.command()
@click.argument("bag", type=click.Path(exists=True, path_type=Path))
@click.option("--density", help="Bulk density of the soil, such as 1550±80 [kg/m³].")
@click.option("--out", type=click.Path(path_type=Path), help="NetCDF file for the map.")
def main(bag: Path, density: str | None, out: Path | None) -> None:
    """Print footfalls of a BAG as they come, and the map of all."""
    walk, calls, count = Footfalls(density=density), [0.0], 0
    for piece in itertools.chain(samples(bag), [None]):
        begin = time.perf_counter()
        new = walk.wait() if piece is None else walk.update(piece)
        if piece is not None:
            calls.append(time.perf_counter() - begin)
        count += len(new)
        for footfall in new:
            is_usable, (x, y, _) = footfall.verdict == USABLE, footfall.place
            answer = f"φ = {footfall.phi:.1f}° ± {footfall.absolute_sd:.1f}°"
            click.echo(
                f"{footfall.time:8.2f} s  {footfall.foot}  x {x:5.2f} m  y {y:5.2f} m  "
                f"{answer if is_usable else footfall.verdict}"
            )
    spent = time.process_time()
    begin = time.process_time()
    try:
        soil = walk.map()
    except InputError as error:
        raise click.ClickException(str(error)) from error
    click.echo(repr(soil))
    for warning in soil.warnings:
        click.echo(f"Warning: {warning}")
    of_map = time.process_time() - begin
    click.echo(
        f"{len(calls) - 1} calls, the longest of {1e3 * max(calls):.1f} ms; CPU "
        f"{1e3 * spent / max(count, 1):.0f} ms a footfall with the start, map {of_map:.1f} s"
    )
    if out is not None:
        soil.to_netcdf(out)


if __name__ == "__main__":
    main()
