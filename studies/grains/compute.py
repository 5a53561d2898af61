"""Make the records that are missing, one after the other, as the queue of ``soils.toml`` has them.

    python studies/grains/compute.py --work FOLDER --out studies/data/grains

What is interrupted goes on with the same command: a record that is there is not made again, nor
is a bed. The engine has one process at the lowest priority.
"""

from __future__ import annotations

import argparse
import fcntl
import os
import subprocess
import sys
import time
import tomllib
from collections.abc import Container, Iterator
from pathlib import Path

import elements
import run


def make(stem: str, work: Path, out: Path) -> None:
    """Make a record that is named as its file, ``SOIL_BODY_SEED`` or ``SOIL_TEST_SEED``."""
    name, body = stem.rsplit("_", 1)[0].split("_", 1)
    seed, soil = int(stem.rsplit("_", 1)[1]), run.soils()[name]
    bodies = {f"rig-{rig.name}": rig for rig in run.rigs()}
    bodies |= {leg: run.Rig(leg) for leg in ("straight", "c", "reversed_c")}
    if body in elements.TESTS:
        elements.test(name, body, seed, work, out)
    elif body in bodies:
        run.record(soil, bodies[body], seed, work, out)
    elif body.startswith("wheel"):
        run.rolled(soil, body, seed, work, out)
    else:
        run.pressed(soil, body, seed, work, out)


def missing(out: Path, failed: Container[str]) -> Iterator[str]:
    """Names of the records to make, as ``soils.toml`` has them now."""
    for stem in tomllib.loads((run.HERE / "soils.toml").read_text())["queue"]["records"]:
        if stem not in failed and not (out / f"{stem}.csv").exists():
            yield stem


def main() -> None:
    """Make what is missing; what the engine fails at is named and passed over."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--work", type=Path, required=True, help="folder for the engine's files")
    parser.add_argument("--out", type=Path, required=True, help="folder for the records")
    parser.add_argument("record", nargs="?", help="only this one")
    options = parser.parse_args()
    if options.record:
        make(options.record, options.work, options.out)
        return
    options.work.mkdir(parents=True, exist_ok=True)
    lock = (options.work / "lock").open("w")
    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)  # one process at a time
    os.nice(19)
    failed: set[str] = set()
    while stem := next(missing(options.out, failed), ""):
        begin = time.monotonic()
        command = [sys.executable, __file__, "--work", options.work, "--out", options.out, stem]
        if subprocess.run(command, check=False).returncode:
            failed.add(stem)
        print(f"{stem}: {time.monotonic() - begin:.0f} s", flush=True)


if __name__ == "__main__":
    main()
