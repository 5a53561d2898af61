"""CSV: a line with the names of the columns, then a line for each sample.

``time_s`` [s]; for each foot FR, FL, RR, RL and joint hip, thigh, calf ``FR_hip_angle_rad`` [rad]
and ``FR_hip_torque_Nm`` [N m]; optionally, a group whole or not at all, ``FR_hip_velocity_rad_s``
[rad/s], ``quaternion_w`` to ``_z``, ``angular_velocity_x_rad_s`` to ``_z_`` [rad/s],
``acceleration_x_m_s2`` to ``_z_`` [m/s²] and ``FR_foot_counts``; in any order, with commas.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path

import numpy as np

from terraphi.errors import InputError
from terraphi.robot.joint_log import FloatArray
from terraphi.robot.logs.block import SHAPES, Block
from terraphi.robot.logs.tables import GROUPS, TIME_COLUMN, check_columns

READ_BYTES = 2**22
LONGEST_HEADER = 2**16

WRONG_CELLS = "line with the wrong number of cells"
CUT_OFF = "last line without its end"


def read_csv(path: Path) -> Iterator[Block]:
    """Read a CSV piece by piece.

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
        If the header is not as documented.
    """
    with path.open("rb") as stream:
        header = _header(path, stream.readline(LONGEST_HEADER))
        groups = check_columns(f"{path}, line 1", header)
        places = {group: [header.index(name) for name in GROUPS[group]] for group in groups}
        time = header.index(TIME_COLUMN)
        rest = b""
        while piece := stream.read(READ_BYTES):
            whole, newline, rest = (rest + piece).rpartition(b"\n")
            if newline:
                yield _block(whole + newline, len(header), time, places)
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


def _block(lines: bytes, width: int, time: int, places: dict[str, list[int]]) -> Block:
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
    values = {
        group: table[:, at].reshape(len(table), *SHAPES[group]) for group, at in places.items()
    }
    return Block(table[:, time], values, None, dropped)


def _numbers(lines: bytes, width: int) -> FloatArray:
    """Parse lines of the right number of cells; what is no number becomes NaN."""
    import pandas as pd  # type: ignore[import-untyped]

    options = {"header": None, "names": range(width), "index_col": False, "quoting": 3}
    try:
        table = pd.read_csv(BytesIO(lines), dtype=np.float64, **options)
    except (ValueError, OverflowError):
        words = pd.read_csv(BytesIO(lines), dtype=str, encoding_errors="replace", **options)
        table = words.apply(pd.to_numeric, errors="coerce")
    return np.asarray(table.to_numpy(dtype=np.float64))
