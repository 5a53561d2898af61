"""Columns of a CSV and arrays of an npz, in the order in which they are written.

CSV: a line with the names of the columns, then a line for each sample.

``time_s`` [s]; for each foot FR, FL, RR, RL and joint hip, thigh, calf ``FR_hip_angle_rad`` [rad]
and ``FR_hip_torque_Nm`` [N m]; optionally, a group whole or not at all, ``FR_hip_velocity_rad_s``
[rad/s], ``quaternion_w`` to ``_z``, ``angular_velocity_x_rad_s`` to ``_z_`` [rad/s],
``acceleration_x_m_s2`` to ``_z_`` [m/s²] and ``FR_foot_counts``; in any order, with commas.

npz: numpy's archive, one array for each column of a JointLog.

``time`` [s], shape [sample]; ``angle`` [rad] and ``torque`` [N m], shape [sample, 4, 3] or
[sample, 12], feet in the order FR, FL, RR, RL, joints hip, thigh, calf; optionally ``velocity``
[rad/s] of the same shape, ``quaternion`` (w, x, y, z), ``angular_velocity`` [rad/s],
``acceleration`` [m/s²] and ``foot_counts`` (FR, FL, RR, RL); any type of number.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from io import BytesIO
from pathlib import Path

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError, nearest
from terraphi.robot.joint_log import FEET, JOINT_NAMES, JOINTS
from terraphi.robot.logs.collect import REQUIRED, SHAPES, Array, Block
from terraphi.robot.logs.columns import Columns, places

TIME_COLUMN = "time_s"
TIME_ARRAY = "time"


def _joints(suffix: str) -> tuple[str, ...]:
    return tuple(f"{foot}_{joint}_{suffix}" for foot in FEET for joint in JOINTS)


GROUPS: dict[str, tuple[str, ...]] = {
    "angle": _joints("angle_rad"),
    "velocity": _joints("velocity_rad_s"),
    "torque": _joints("torque_Nm"),
    "quaternion": tuple(f"quaternion_{part}" for part in "wxyz"),
    "angular_velocity": tuple(f"angular_velocity_{axis}_rad_s" for axis in "xyz"),
    "acceleration": tuple(f"acceleration_{axis}_m_s2" for axis in "xyz"),
    "foot_counts": tuple(f"{foot}_foot_counts" for foot in FEET),
}
"""Columns of a CSV for each column of a JointLog; all of a group or none."""


def check_columns(place: str, header: list[str], motors: Sequence[str] = JOINT_NAMES) -> list[str]:
    """Groups that a CSV's header holds.

    Parameters
    ----------
    place
        File and line, for messages.
    header
        Names of the columns.
    motors
        Joints that the robot has, as ``FR_hip``; those of the others may be missing.

    Returns
    -------
    list of str
        Names of the groups present.

    Raises
    ------
    InputError
        If a column is unknown, stands twice or is missing.
    """
    known = [TIME_COLUMN, *(name for names in GROUPS.values() for name in names)]
    for name in header:
        if name not in known:
            if name == "theta_deg":
                raise InputError(
                    f"{place}: forces on a leg, and not a robot's log; 'terraphi invert' takes them"
                )
            if name.endswith(("_deg", "_deg_s")):
                raise InputError(
                    f"{place}: column '{name[:60]}': radians are expected, not degrees"
                )
            raise InputError(f"{place}: unknown column {name[:60]!r}; {_hint(name, known)}")
        if header.count(name) > 1:
            raise InputError(f"{place}: column '{name}' stands twice; remove one")
    present = [group for group, names in GROUPS.items() if set(names) & set(header)]
    needed = [TIME_COLUMN]
    for group in dict.fromkeys([*REQUIRED, *present]):
        needed += GROUPS[group]
    optional = {name for joint in JOINT_NAMES if joint not in motors for name in _of(joint)}
    missing = [name for name in needed if name not in header and name not in optional]
    if missing:
        more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        raise InputError(
            f"{place}: column '{missing[0]}'{more} missing; expected {TIME_COLUMN} and for "
            f"{'twelve' if len(motors) == len(JOINT_NAMES) else len(motors)} joints columns like "
            f"{motors[0]}_angle_rad and {motors[0]}_torque_Nm"
        )
    return present


def _of(joint: str) -> tuple[str, ...]:
    """Columns of a joint."""
    at = JOINT_NAMES.index(joint)
    return tuple(GROUPS[group][at] for group in ("angle", "velocity", "torque"))


def check_arrays(place: str, names: Iterable[str]) -> list[str]:
    """Columns that an npz holds; raises InputError if an array is unknown or missing."""
    found = list(names)
    known = [TIME_ARRAY, *SHAPES]
    for name in found:
        if name not in known:
            raise InputError(f"{place}: unknown array {name[:60]!r}; {_hint(name, known)}")
    for name in (TIME_ARRAY, *REQUIRED):
        if name not in found:
            raise InputError(
                f"{place}: array '{name}' is missing; expected {', '.join((TIME_ARRAY, *REQUIRED))}"
                " and, if known, velocity, quaternion, angular_velocity, acceleration, foot_counts"
            )
    return [name for name in SHAPES if name in found]


def _hint(name: str, known: list[str]) -> str:
    """The nearest known name, or an example, since a list of seventy would not help."""
    hint = nearest(name, known)
    return f"expected {TIME_COLUMN}, {known[1]} and the like" if len(hint) > 200 else hint


READ_BYTES = 2**22
LONGEST_HEADER = 2**16

WRONG_CELLS = "line with the wrong number of cells"
CUT_OFF = "last line without its end"


def read_csv(
    path: Path, columns: Columns | None = None, motors: Sequence[str] = JOINT_NAMES
) -> Iterator[Block]:
    """Read a CSV piece by piece.

    Parameters
    ----------
    path
        The file.
    columns
        Which of its columns are what, if they are not named as above.
    motors
        Which joint each motor moves; of joints that no motor moves, all is zero.

    Yields
    ------
    Block
        Stamped in seconds.

    Raises
    ------
    InputError
        If the header is not as documented.
    """
    with path.open("rb") as stream:
        header = _header(path, stream.readline(LONGEST_HEADER))
        if columns is None:
            groups = check_columns(f"{path}, line 1", header, motors)
            at = {
                group: [header.index(name) if name in header else -1 for name in GROUPS[group]]
                for group in groups
            }
            at["time"] = [header.index(TIME_COLUMN)]
        else:
            at = places(columns, header, motors, path)
        scales = {} if columns is None else columns.scales
        rest = b""
        while piece := stream.read(READ_BYTES):
            whole, newline, rest = (rest + piece).rpartition(b"\n")
            if newline:
                yield _block(whole + newline, len(header), at, scales)
        if rest.strip():
            # A number may have lost its last digits, and nobody could tell.
            yield Block(np.empty(0), {}, None, Counter({CUT_OFF: 1}))


def _header(path: Path, line: bytes) -> list[str]:
    try:
        text = line.decode("utf-8-sig").strip()
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path}: not a log; expected CSV, npz, MCAP or the folder of a rosbag2"
        ) from error
    if not text:
        raise InputError(f"{path}, line 1: empty; expected the names of the columns")
    return [name.strip().strip('"') for name in text.split(",")]


def _block(
    lines: bytes, width: int, places: dict[str, list[int]], scales: dict[str, float]
) -> Block:
    dropped: Counter[str] = Counter()
    raw = np.frombuffer(lines, dtype=np.uint8)
    ends = np.flatnonzero(raw == ord("\n"))
    rows = len(ends)
    # Line by line: what one has too many another may lack.
    commas = np.diff(np.searchsorted(np.flatnonzero(raw == ord(",")), ends), prepend=0)
    if np.any(commas != width - 1):
        every = [line for line in lines.split(b"\n") if line.strip()]
        sound = [line for line in every if line.count(b",") == width - 1]
        dropped[WRONG_CELLS] = len(every) - len(sound)
        lines, rows = b"\n".join([*sound, b""]), len(sound)
    table = _numbers(lines, width) if rows else np.empty((0, width))
    if any(-1 in at for at in places.values()):
        table = np.pad(table, ((0, 0), (0, 1)))  # joints that are not there have the last column
    values = {
        group: scales.get(group, 1.0) * table[:, at].reshape(len(table), *SHAPES.get(group, ()))
        for group, at in places.items()
    }
    return Block(values.pop("time"), values, None, dropped)


def _numbers(lines: bytes, width: int) -> FloatArray:
    """Parse lines that have the right number of cells; cells that are not numbers become NaN."""
    import pandas as pd

    options = {"header": None, "names": range(width), "index_col": False, "quoting": 3}
    try:
        table = pd.read_csv(BytesIO(lines), dtype=np.float64, **options)
    except (ValueError, OverflowError):
        words = pd.read_csv(BytesIO(lines), dtype=str, encoding_errors="replace", **options)
        table = words.apply(pd.to_numeric, errors="coerce")
    return np.asarray(table.to_numpy(dtype=np.float64))


MAGIC = b"PK\x03\x04"
ROWS = 16_384


def read_npz(path: Path) -> Iterator[Block]:
    """Read an npz, compressed or not, and hand it on piece by piece.

    Parameters
    ----------
    path
        The file.

    Yields
    ------
    Block
        Stamped in seconds.

    Raises
    ------
    InputError
        If the file is damaged or its arrays are not as documented.
    """
    with path.open("rb") as stream:
        try:
            with np.load(stream) as archive:
                names = [TIME_ARRAY, *check_arrays(str(path), archive.files)]
                arrays = {name: _checked(path, name, archive[name]) for name in names}
        except (InputError, OSError):
            raise
        except Exception as error:  # what zipfile, zlib and NumPy's parser of headers raise
            raise InputError(
                f"{path}: cannot be read as an npz of numbers ({error}); write or copy it again"
            ) from error
    samples = len(arrays[TIME_ARRAY])
    for name, array in arrays.items():
        if len(array) != samples:
            raise InputError(
                f"{path}: {len(array)} rows in '{name}' and {samples} in 'time'; expected as many"
            )
    for start in range(0, samples, ROWS):
        block = {name: array[start : start + ROWS] for name, array in arrays.items()}
        yield Block(block.pop(TIME_ARRAY).astype(np.float64), block)


def _checked(path: Path, name: str, array: Array) -> Array:
    """An array of numbers in the shape of its column; refused if it is none."""
    if array.dtype.kind not in "fiu":
        raise InputError(f"{path}: array '{name}' is of type {array.dtype}; numbers are expected")
    wanted = () if name == TIME_ARRAY else SHAPES[name]
    if not array.ndim or array.shape[1:] not in (wanted, (math.prod(wanted),) if wanted else ()):
        inner = ", ".join(["sample", *map(str, wanted)])
        raise InputError(
            f"{path}: array '{name}' has shape {list(array.shape)}; expected [{inner}]"
        )
    return array.reshape(len(array), *wanted)
