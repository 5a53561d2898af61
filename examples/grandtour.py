"""φ under footfalls of a GrandTour mission: an ANYmal D's joints, attitude and IMU in Zarr arrays.

    python examples/grandtour.py 2024-11-11-12-42-47 --robot anymal_d.urdf --density 1550±80

It needs numcodecs, and the model of the robot. A mission's folder holds
``data/anymal_state_actuator.tar`` and others, as they are downloaded, or what these tars hold. An
array is a folder with its ``.zarray`` (Zarr 2: shape, chunks, type, compressor) and a file for each
chunk of rows. Read are:

- ``anymal_state_actuator``, 400 Hz: ``00_state_joint_position`` to ``11_``, ``_velocity`` and
  ``_torque``, of LF, RF, LH, RH × HAA, HFE, KFE;
- ``anymal_state_state_estimator``: ``pose_orien`` (x, y, z, w) and ``twist_ang``, in the base's
  axes;
- ``anymal_imu``: ``lin_acc``, in axes that are turned from the base's by 180° about y.

Names, orders and the turn are those of the set's own converter and launch files
(leggedrobotics/grand_tour_box).
"""

from __future__ import annotations

import json
import sys
import tarfile
from collections import Counter
from math import ceil, prod
from pathlib import Path
from typing import Any

import click
import numpy as np

import terraphi
from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.budget import BYTES, unpacking
from terraphi.experiment.errors import InputError
from terraphi.experiment.files import check_is_file
from terraphi.robot.joint_log import FEET, JointLog
from terraphi.robot.logs.messages import MEASURED, add_imu
from terraphi.robot.logs.samples import joint_log

ACTUATORS, STATE, IMU = "anymal_state_actuator", "anymal_state_state_estimator", "anymal_imu"
LEGS = ("FL", "FR", "RL", "RR")
"""Legs in the order of the actuators: LF, RF, LH, RH."""
TO_BASE = np.array([-1.0, 1.0, -1.0])
"""Components in the base's axes over those in the IMU's."""


def topic_of(folder: Path, topic: str) -> Path | None:
    """The tar or folder of a topic in a mission; ``None`` if it is not there."""
    places = [folder / "data" / f"{topic}.tar", folder / "data" / topic]
    return next((place for place in places if place.exists()), None)


def read_mission(folder: Path) -> JointLog:
    """Read a mission's folder.

    Raises
    ------
    InputError
        If an array of the joints is missing or damaged, or a package is.
    """
    found = topic_of(folder, ACTUATORS)
    if found is None:
        raise InputError(f"{folder}: no data/{ACTUATORS} or .tar in it; name a mission's folder")
    notes: list[str] = []
    with _Arrays(found) as arrays:
        values: dict[str, Any] = {"stamp": arrays.stamp()}
        for column, quantity in (
            ("angle", "position"), ("velocity", "velocity"), ("torque", "torque")
        ):  # fmt: skip
            each = [arrays.rows(f"{i:02}_state_joint_{quantity}") for i in range(12)]
            if len({len(one) for one in (*each, values["stamp"])}) > 1:
                raise InputError(f"{found}: its arrays differ in length; download it again")
            legs = np.stack(each, axis=1).reshape(-1, 4, 3)
            values[column] = legs[:, [LEGS.index(foot) for foot in FEET]]
    values["recorded"] = values["stamp"]
    if place := topic_of(folder, STATE):
        with _Arrays(place) as arrays:
            turn, rate = np.roll(arrays.rows("pose_orien"), 1, axis=1), arrays.rows("twist_ang")
            _add(values, arrays.stamp(), notes, STATE, quaternion=turn, angular_velocity=rate)
    if place := topic_of(folder, IMU):
        with _Arrays(place) as arrays:
            _add(values, arrays.stamp(), notes, IMU, acceleration=TO_BASE * arrays.rows("lin_acc"))
    facts = {"notes": notes, "format": "grandtour", "topic": ACTUATORS}
    return joint_log(folder, values, "header stamp", Counter(), facts)


def _add(
    values: dict[str, Any], stamp: Any, notes: list[str], topic: str, **columns: FloatArray
) -> None:
    none = {"quaternion": np.full((len(stamp), 4), np.nan)}
    none |= dict.fromkeys(("angular_velocity", "acceleration"), np.full((len(stamp), 3), np.nan))
    readings = {name: columns.get(name, none[name]) for name in MEASURED}
    add_imu(values, readings | {"stamp": stamp, "recorded": stamp}, [topic], notes)


class _Arrays:
    """The arrays of one topic, in a tar or a folder."""

    def __init__(self, place: Path) -> None:
        self._place, self._tar = place, None
        if place.is_dir():
            return
        check_is_file(place)
        try:
            self._tar = tarfile.open(place, "r:")  # noqa: SIM115 - closed by __exit__
        except tarfile.TarError as error:
            raise InputError(f"{place}: not a whole tar ({error}); download it again") from error

    def __enter__(self) -> _Arrays:
        return self

    def __exit__(self, *_: object) -> None:
        if self._tar is not None:
            self._tar.close()

    def stamp(self) -> Any:
        """Header stamps [ns]."""
        return np.rint(1e9 * self.rows("timestamp")).astype(np.int64)

    def _file(self, name: str) -> bytes:
        if self._tar is None:
            check_is_file(path := self._place / name)
            return path.read_bytes()
        try:
            # The topic's folder is the outermost one in the tar.
            found = self._tar.extractfile(f"{self._place.stem}/{name}")
        except (KeyError, tarfile.TarError) as error:
            raise InputError(f"{self._place}: no '{name}' in it; download it again") from error
        if found is None:
            raise InputError(f"{self._place}: '{name}' is no file; download it again")
        return found.read()

    def rows(self, name: str) -> FloatArray:
        """An array, shape [sample, ...]; raises InputError if it is not there or damaged."""
        try:
            about = json.loads(self._file(f"{name}/.zarray"))
            shape, chunk, kind = about["shape"], about["chunks"], np.dtype(about["dtype"])
            whole = chunk[1:] == shape[1:] and chunk[0] > 0 and about["order"] == "C"
            plain = not about.get("filters") and about.get("zarr_format", 2) == 2
            if not (whole and plain and kind.kind in "fiu"):
                raise ValueError(
                    "unfiltered chunks of whole rows of numbers, of version 2, are expected"
                )
            if max(prod(chunk), prod(shape)) * max(kind.itemsize, 8) > BYTES:
                raise ValueError(f"more than {BYTES / 1e9:.2g} GB")
            codec = _codec(about["compressor"], str(self._place))
            last, row = ".0" * (len(shape) - 1), prod(shape[1:])
            parts = [np.zeros((0, *shape[1:]), kind)]
            with unpacking(f"{self._place}: it", [self._place]):
                for i in range(ceil(shape[0] / chunk[0])):
                    # Chunks are as long as the longest: of the last one, only the rows that are.
                    count = min(chunk[0], shape[0] - i * chunk[0])
                    content: Any = self._file(f"{name}/{i}{last}")
                    if hasattr(codec, "decode_partial"):
                        content = codec.decode_partial(content, 0, count * row)
                    elif codec is not None:
                        content = codec.decode(content)
                    numbers = np.frombuffer(content, kind, count * row)
                    parts.append(numbers.reshape(count, *shape[1:]))
                return np.concatenate(parts).astype(np.float64)
        except InputError:
            raise
        except (ValueError, KeyError, TypeError, RuntimeError, IndexError) as error:
            why = " ".join(str(error).split())
            raise InputError(f"{self._place}: array '{name}' cannot be read ({why})") from error


def _codec(compressor: Any, source: str) -> Any:
    """Codec of chunks; ``None`` if they are not compressed."""
    if compressor is None:
        return None
    try:
        from numcodecs import get_codec
    except ImportError:
        raise InputError(f"{source}: reading Zarr needs numcodecs; pip install numcodecs") from None
    return get_codec(compressor)


@click.command()
@click.argument("mission", type=click.Path(path_type=Path))
@click.option("--robot", required=True, help="URDF, MJCF or TOML of the robot.")
@click.option("--density", default="1550±80", show_default=True, help="Of the soil [kg/m³].")
def main(mission: Path, robot: str, density: str) -> None:
    """Print φ under the footfalls of a mission."""
    try:
        walk = terraphi.footfalls(read_mission(mission), robot=robot, density=density)
    except InputError as error:
        sys.exit(f"grandtour: {error}")
    click.echo(walk.summary().to_string(index=False))
    for warning in walk.warnings:
        click.echo(warning)


if __name__ == "__main__":
    main()
