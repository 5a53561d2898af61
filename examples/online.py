"""φ under footfalls while a robot walks: read a bag as a stream, as a node on the robot would.

    python examples/go2_walk.py --out walk --gait walk --period 1.2 --speed 0.12 --format mcap
    python examples/online.py walk/realistic.mcap --density 1550±80

Fifty messages of a bag (0.1 s of a Go2) at a time go to ``Footfalls.update``, and each footfall is
printed when it is over. At the end comes the map, and what it all took.
"""

from __future__ import annotations

import itertools
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import click
from rosbags.rosbag2 import Reader

from terraphi import Footfalls
from terraphi.inference.footfalls import USABLE
from terraphi.robot.joint_log import JOINT_NAMES, JointLog
from terraphi.robot.logs.bags import LOW_STATE, low_states

MESSAGES = 50
"""Messages that are handed over together."""


def samples(bag: Path) -> Iterator[JointLog]:
    """The LowState messages of a bag, a few at a time."""
    with Reader(bag) as reader:
        states = [c for c in reader.connections if c.msgtype == LOW_STATE]
        messages = ((stamp, raw) for _, stamp, raw in reader.messages(states))
        while some := list(itertools.islice(messages, MESSAGES)):
            columns = low_states(some, JOINT_NAMES, Counter())
            del columns["recorded"]
            yield JointLog(1e-3 * columns.pop("stamp"), **columns)


@click.command()
@click.argument("bag", type=click.Path(exists=True, path_type=Path))
@click.option("--density", help="Bulk density of the soil, such as 1550±80 [kg/m³].")
@click.option("--out", type=click.Path(path_type=Path), help="NetCDF file for the map.")
def main(bag: Path, density: str | None, out: Path | None) -> None:
    """Print footfalls of a BAG as they come, and the map of all."""
    walk, spent, read, footfalls = Footfalls(density=density), 0.0, 0, 0
    first = 0.0  # what the checks and the friction of the joints take, once
    for piece in samples(bag):
        begin = time.process_time()
        new = walk.update(piece)
        took = time.process_time() - begin
        if first or new:
            spent, read, footfalls = spent + took, read + len(piece.time), footfalls + len(new)
        if not first and new:
            first, spent, read, footfalls = took, 0.0, 0, 0
        for one in new:
            answer = f"φ = {one.phi:.1f}° ± {one.sd:.1f}°" if one.verdict == USABLE else one.verdict
            x, y, _ = one.place
            click.echo(f"{one.time:8.2f} s  {one.foot}  x {x:5.2f} m  y {y:5.2f} m  {answer}")
    begin = time.process_time()
    found = walk.map()
    click.echo(repr(found))
    of_map = time.process_time() - begin
    click.echo(
        f"CPU: first footfalls {first:.2f} s, then {1e3 * spent / max(footfalls, 1):.1f} ms each "
        f"({1e6 * spent / max(read, 1):.0f} µs a sample); map {of_map:.2f} s"
    )
    if out is not None:
        found.to_netcdf(out)


if __name__ == "__main__":
    main()
