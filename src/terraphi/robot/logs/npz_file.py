"""npz: numpy's archive, one array for each column of a JointLog.

``time`` [s], shape [sample]; ``angle`` [rad] and ``torque`` [N m], shape [sample, 4, 3] or
[sample, 12], feet in the order FR, FL, RR, RL, joints hip, thigh, calf; optionally ``velocity``
[rad/s] of the same shape, ``quaternion`` (w, x, y, z), ``angular_velocity`` [rad/s],
``acceleration`` [m/s²] and ``foot_counts`` (FR, FL, RR, RL); any type of number.
"""

from __future__ import annotations

import math
import struct
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import IO

import numpy as np

from terraphi.errors import InputError
from terraphi.robot.logs.block import SHAPES, Array, Block
from terraphi.robot.logs.tables import TIME_ARRAY, check_arrays

MAGIC = b"PK\x03\x04"
ROWS = 16_384

# What damage to an archive makes zipfile raise; an encrypted member is a RuntimeError.
_DAMAGE = (
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
    EOFError,
    KeyError,
    ValueError,
    OverflowError,
    RuntimeError,
)


def read_npz(path: Path) -> Iterator[Block]:
    """Read an npz, compressed or not, piece by piece.

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
    try:
        with ExitStack() as stack:
            archive = stack.enter_context(zipfile.ZipFile(path))
            names = [name.removesuffix(".npy") for name in archive.namelist()]
            columns = check_arrays(str(path), names)
            arrays = {
                name: _Reader(path, name, stack.enter_context(archive.open(f"{name}.npy")))
                for name in [TIME_ARRAY, *columns]
            }
            samples = arrays[TIME_ARRAY].rows
            for name, array in arrays.items():
                if array.rows != samples:
                    raise InputError(
                        f"{path}: {array.rows} rows in '{name}' and {samples} in 'time'; expected "
                        "as many"
                    )
            for start in range(0, samples, ROWS):
                rows = min(ROWS, samples - start)
                block = {name: array.read(rows) for name, array in arrays.items()}
                yield Block(block.pop(TIME_ARRAY).astype(np.float64), block)
    except InputError:
        raise
    except _DAMAGE as error:
        raise InputError(
            f"{path}: not a whole npz file ({error}); write or copy it again"
        ) from error


class _Reader:
    """Rows of one array of an archive, one after the other."""

    def __init__(self, path: Path, name: str, stream: IO[bytes]) -> None:
        self.path, self.name, self.stream = path, name, stream
        try:
            version = np.lib.format.read_magic(stream)
            read = (
                np.lib.format.read_array_header_1_0
                if version == (1, 0)
                else np.lib.format.read_array_header_2_0
            )
            shape, fortran, dtype = read(stream)
        except Exception as error:  # numpy parses the header as Python: ValueError, TokenError...
            raise InputError(f"{path}: array '{name}' is damaged; write it again") from error
        if dtype.kind not in "fiu":
            raise InputError(f"{path}: array '{name}' is of type {dtype}; numbers are expected")
        self.dtype = dtype
        self.shape = self._checked(shape)
        self.rows = shape[0]
        # In columns, an array lies across the file: such a one is read whole.
        self.whole = self._take(math.prod(shape)).reshape(shape, order="F") if fortran else None
        self.at = 0

    def _checked(self, shape: tuple[int, ...]) -> tuple[int, ...]:
        wanted = () if self.name == TIME_ARRAY else SHAPES[self.name]
        if shape and (shape[1:] == wanted or (shape[1:] == (math.prod(wanted),) and wanted)):
            return wanted
        inner = ", ".join(["sample", *map(str, wanted)])
        raise InputError(
            f"{self.path}: array '{self.name}' has shape {list(shape)}; expected [{inner}]"
        )

    def read(self, rows: int) -> Array:
        """The next rows."""
        if self.whole is not None:
            values = self.whole[self.at : self.at + rows]
        else:
            values = self._take(rows * math.prod(self.shape))
        self.at += rows
        return values.reshape(rows, *self.shape)

    def _take(self, count: int) -> Array:
        data = self.stream.read(count * self.dtype.itemsize)
        if len(data) < count * self.dtype.itemsize:
            raise EOFError(f"'{self.name}' ends early")
        return np.frombuffer(data, dtype=self.dtype)
