"""Files: written whole or not at all, and read with a sentence for whatever is wrong."""

from __future__ import annotations

import fcntl
import io
import logging
import os
import re
import sys
import tempfile
import traceback
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError


@dataclass(frozen=True)
class Variable:
    """A variable of a file.

    Attributes
    ----------
    values
        Its values, an array of any shape; text as ``str``.
    """

    values: Any


@dataclass(frozen=True)
class Contents:
    """What stands in a file; reads like an ``xarray.Dataset``.

    Attributes
    ----------
    attrs
        Attributes of the file.
    data_vars
        Variables that are no coordinates, in the order of the file.
    coords
        Coordinates: variables named as a dimension, or named by a ``coordinates`` attribute (CF
        conventions 1.11, chapter 5).
    """

    attrs: Mapping[str, Any]
    data_vars: Mapping[str, Variable]
    coords: Mapping[str, Variable]

    def __getitem__(self, name: str) -> Variable:
        """A variable; raises KeyError if there is none of that name."""
        return self.coords[name] if name in self.coords else self.data_vars[name]

    def __contains__(self, name: object) -> bool:
        return name in self.coords or name in self.data_vars


def read_whole(path: Path) -> Contents:
    """Load a whole NetCDF-4 file; scale, offset and calendar attributes are not applied.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    Contents

    Raises
    ------
    Exception
        Whatever the HDF5 library raises for a file that is missing, cut short or of another format:
        OSError, KeyError, ValueError and more.
    """
    import h5netcdf

    with h5netcdf.File(path, "r", decode_vlen_strings=True) as file:
        found = {name: Variable(np.asarray(v[...])) for name, v in file.variables.items()}
        attributes = dict(file.attrs)
        named = [attributes.pop("coordinates", "")]
        named += [str(v.attrs.get("coordinates", "")) for v in file.variables.values()]
        coordinates = {*file.dimensions, *" ".join(named).split()}
    return Contents(
        attributes,
        {name: v for name, v in found.items() if name not in coordinates},
        {name: v for name, v in found.items() if name in coordinates},
    )


DAMAGE = (EOFError, LookupError, OSError, RuntimeError, ValueError)
"""What the HDF5 stack raises on a damaged file."""


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Write a file under a temporary name beside its own, and rename it when it is whole.

    Parameters
    ----------
    path
        The file to make or replace.

    Yields
    ------
    Path
        The temporary name; removed if the block raises.

    Raises
    ------
    InputError
        If the folder cannot be written to or the disk is full.
    """
    temporary: Path | None = None
    try:
        handle, name = tempfile.mkstemp(
            prefix=f".{path.name}.", suffix=path.suffix, dir=path.parent
        )
        os.close(handle)
        temporary = Path(name)
        # mkstemp makes private files; a result is as readable as any other file of its owner.
        mask = os.umask(0)
        os.umask(mask)
        temporary.chmod(0o666 & ~mask)
        yield temporary
        temporary.replace(path)
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(
            f"{path}: cannot be written ({reason}); free some space or choose another place"
        ) from error
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


def is_there(path: Path) -> bool:
    """Whether something can be read at a place: a file, a pipe, or ``-``, standard input."""
    return str(path) == "-" or (path.exists() and not path.is_dir())


def read_bytes(path: Path) -> bytes:
    """Return all bytes of a file, a pipe, or standard input (``-``).

    Raises
    ------
    InputError
        If there is no such file, it is a folder, or it cannot be read.
    """
    if not is_there(path):
        raise InputError(_absent(path))
    try:
        return sys.stdin.buffer.read() if str(path) == "-" else path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error


def check_is_file(path: Path, expected: str = "") -> None:
    """Refuse a pipe or standard input where a file on a disk is needed (for random access).

    Parameters
    ----------
    path
        The place.
    expected
        What should be there, for people.

    Raises
    ------
    InputError
        If it is a pipe or standard input, a folder, or there is no file.
    """
    if path.is_file():
        return
    if is_there(path):
        raise InputError(f"{path}: a pipe, which is read only once; save it to a file, and name it")
    raise InputError(_absent(path, expected))


def _absent(path: Path, expected: str = "") -> str:
    """Say that a path does not exist, or that it is a folder."""
    if path.is_dir():
        return f"{path}: is a folder; {f'expected {expected}' if expected else 'name a file'}"
    return f"{path}: no such file{expected and '; expected '}{expected}"


def plain_number(text: str) -> float:
    """Parse a decimal number; unlike ``float``, refuse ``1_000`` and full-width digits.

    Raises
    ------
    ValueError
        If it is none, as ``1_000`` and full-width digits are none.
    """
    if "_" in text or not text.isascii():
        raise ValueError(f"'{text}' is not a number")
    return float(text)


def number_with_sd(text: str) -> tuple[float, float | None]:
    """Parse ``35``, ``35±2``, ``35+-2`` or ``35+/-2``: a number, its standard deviation or None.

    Raises
    ------
    ValueError
        As :func:`plain_number`.
    """
    mean, sign, sd = re.sub(r"\+/?-", "±", text.strip()).partition("±")
    return plain_number(mean), plain_number(sd) if sign else None


def write_netcdf(dataset: Any, path: Path, *, encoding: Any = None) -> None:
    """Write a NetCDF-4 file, whole or not at all.

    Parameters
    ----------
    dataset
        An ``xarray.Dataset`` or ``xarray.DataTree``.
    path
        The file to make or replace.
    encoding
        As in ``xarray.Dataset.to_netcdf``.

    Raises
    ------
    InputError
        If the folder cannot be written to or the disk is full.
    """
    # Made in memory: on a full disk the HDF5 library raises anything, and then takes the
    # interpreter down when it tries again to close the file.
    # Our own buffer and a copy of it: xarray's memoryview would be in the way of HDF5, which closes
    # its end of the buffer when it is collected.
    buffer = io.BytesIO()
    dataset.to_netcdf(buffer, engine="h5netcdf", encoding=encoding)
    with replacing(path) as temporary:
        temporary.write_bytes(buffer.getvalue())


def _permitted(place: Path) -> None:
    if not os.access(place, os.W_OK):
        raise InputError(f"{place}: no permission to write; choose another place")


def writable(path: Path) -> None:
    """Raise InputError before any work is done if a file could not be written."""
    if path.is_dir():
        raise InputError(f"{path}: is a folder; name a file")
    if not path.parent.is_dir():
        raise InputError(f"{path.parent}: no such folder; make it first")
    _permitted(path.parent)


def makeable(path: Path) -> None:
    """Raise InputError before any work is done if a folder could not be made."""
    there = next(place for place in (path, *path.absolute().parents) if place.exists())
    if not there.is_dir():
        raise InputError(f"{there}: is a file; name a folder")
    _permitted(there)


def made_folder(path: Path) -> Path:
    """Make a folder for results if it is not there."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{path}: cannot be made a folder ({error.strerror})") from error
    _permitted(path)
    return path


@contextmanager
def damage_told(sentence: str, *more: type[Exception]) -> Iterator[None]:
    """Turn the errors of a damaged NetCDF file into one InputError.

    Parameters
    ----------
    sentence
        What to say.
    *more
        What is raised besides, where a file is of ours by its looks, and its content is not.

    Raises
    ------
    InputError
        For whatever the HDF5 stack raises on damage. That a package is missing, or memory, is none,
        and nor is a mistake of ours.
    """
    import h5netcdf  # noqa: F401 - xarray would say that it does not know the format

    kinds: tuple[type[Exception], ...] = (*DAMAGE, *more)
    try:
        yield
    except InputError:
        raise
    except kinds as error:
        _forget(error)
        raise InputError(sentence) from error


def _forget(error: Exception) -> None:
    """Close files that an error left open now, without h5netcdf's warnings."""
    before = sys.unraisablehook
    sys.unraisablehook = lambda _: None
    try:
        traceback.clear_frames(error.__traceback__)
    finally:
        sys.unraisablehook = before


def open_netcdf(path: Path, *, kind: str, schema: int) -> Contents:
    """Load a NetCDF file that terraphi wrote, or raise InputError with the reason.

    Parameters
    ----------
    path
        The file.
    kind
        Value of the attribute ``terraphi_file`` expected.
    schema
        Version of its layout expected.

    Returns
    -------
    Contents
        Reads like an ``xarray.Dataset``.

    Raises
    ------
    InputError
        If the file is missing, not a NetCDF, truncated, of another kind or schema.
    """
    check_is_file(path)
    why = "not a whole NetCDF file (truncated, or of another format); build or copy it again"
    with damage_told(f"{path}: {why}"):
        dataset = read_whole(path)
    if dataset.attrs.get("terraphi_file") != kind:
        raise InputError(f"{path}: a NetCDF file, but not a {kind} written by terraphi")
    found = dataset.attrs.get("terraphi_schema")
    if found != schema:
        raise InputError(
            f"{path}: {kind} of schema version {found}, this terraphi reads version {schema}; "
            "build it again with this version"
        )
    return dataset


def positions(dataset: Any) -> FloatArray:
    """Positions [rad or m or s] in a file of ours, which holds θ in degrees for people as well.

    Raises KeyError if the file holds none.
    """
    coordinate = str(dataset.attrs["coordinate"])
    in_degrees = coordinate == "theta" and "theta" not in dataset.coords
    name = "theta_deg" if in_degrees else coordinate
    if name not in dataset.coords:  # xarray would number the samples instead
        raise KeyError(name)
    values = np.asarray(dataset[name].values, dtype=np.float64)
    return np.radians(values) if in_degrees else values


log = logging.getLogger(__name__)


@contextmanager
def held(folder: Path) -> Iterator[None]:
    """Keep other builds out of a folder of cases; a build that is killed lets go of it.

    Raises
    ------
    InputError
        If another holds it, or it cannot be made.
    """
    handle = _locked(folder)
    while not _is_at(folder, handle):  # another build removed it as it ended
        os.close(handle)
        handle = _locked(folder)
    try:
        yield
    finally:
        os.close(handle)


def _locked(folder: Path) -> int:
    """Make a folder if needed and lock it; closing the returned handle releases the lock."""
    made_folder(folder)
    try:
        handle = os.open(folder, os.O_RDONLY)
    except FileNotFoundError:
        return _locked(folder)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        os.close(handle)
        raise InputError(
            f"{folder}: another build is at work here; wait for it, or stop it and run this again"
        ) from error
    except OSError as error:  # a file system without locks
        log.info("%s cannot be locked (%s); let no other build use it", folder, error)
    return handle


def _is_at(folder: Path, handle: int) -> bool:
    """Whether the path of an opened folder still leads to it."""
    try:
        return os.path.samestat(folder.stat(), os.fstat(handle))
    except FileNotFoundError:
        return False
