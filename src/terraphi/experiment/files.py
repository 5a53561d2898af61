"""Files: written whole or not at all, and read with one sentence for whatever is wrong."""

from __future__ import annotations

import errno
import io
import itertools
import math
import os
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.budget import BYTES, ITEMS, NESTING
from terraphi.experiment.errors import InputError, sentence_from_validation

if TYPE_CHECKING:
    from pydantic import BaseModel

# -- reading -------------------------------------------------------------------------------------

PART = 1 << 20
"""Part of a file that is read at a time [byte]."""


def is_there(path: Path) -> bool:
    """True if something can be read there: a file, a pipe, or ``-``, standard input."""
    return str(path) == "-" or (path.exists() and not path.is_dir())


def read_bytes(path: Path) -> bytes:
    """All bytes of a file, a pipe, or standard input (``-``).

    Raises InputError if it is something else, or too large.
    """
    try:
        is_input = str(path) == "-"
        if not (is_input or path.is_file() or path.is_fifo()):
            path.stat()  # none there
            what = "folder" if path.is_dir() else "device"
            raise InputError(f"{path}: is a {what}; name a file")
        with nullcontext(sys.stdin.buffer) if is_input else path.open("rb") as stream:
            # In parts: memory for all that may come would be taken at once.
            parts = iter(lambda: stream.read(PART), b"")
            content = b"".join(itertools.islice(parts, BYTES // PART + 1))
    except InputError:
        raise
    except (OSError, ValueError) as error:  # a name with a null byte is a ValueError
        why = getattr(error, "strerror", "") or str(error)
        raise InputError(f"{path}: {why.lower()}") from error
    if len(content) > BYTES:
        raise InputError(f"{path}: larger than {BYTES / 1e9:.2g} GB; cut it into parts")
    return content


def read_text(path: Path) -> str:
    """Text of a file in UTF-8, with or without a byte order mark; raises InputError."""
    try:
        return read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not a text file; UTF-8 is expected") from error


def check_is_file(path: Path, expected: str = "a file") -> None:
    """Raise InputError, which says what is expected, if there is no regular file on disk."""
    if not path.is_file():
        state = "is a folder" if path.is_dir() else "no such file"
        state = "is a pipe or device; save it to a file first" if is_there(path) else state
        raise InputError(f"{path}: {state}; expected {expected}")


def path_of(name: str, value: Any) -> Path:
    """Path of a file that an argument gives; raises InputError."""
    try:
        return Path(value)
    except TypeError:
        kind = type(value).__name__
        raise InputError(f"{name} is {kind}; give the path of a file") from None


def label_of(path: Path | str) -> str:
    """Name of a file, as results state it: bytes that are not UTF-8 are escaped."""
    return str(path).encode(errors="backslashreplace").decode()


def plain_number(text: str) -> float:
    """Parse a decimal number; unlike ``float``, refuse ``1_000`` and full-width digits.

    Raises ValueError if it is none.
    """
    if "_" in text or not text.isascii():
        raise ValueError(f"'{text}' is not a number")
    return float(text)


def number_with_sd(text: str) -> tuple[float, float | None]:
    """Parse ``35``, ``35±2``, ``35+-2`` or ``35+/-2``: a number and its standard deviation or None.

    Raises ValueError if it is none of these.
    """
    mean, sign, sd = re.sub(r"\+/?-", "±", text.strip()).partition("±")
    return plain_number(mean), plain_number(sd) if sign else None


# -- writing -------------------------------------------------------------------------------------

MARK = ".terraphi-"
"""What is between the target and eight random characters in the name of a temporary folder."""
LEAST_AGE = 1.0
"""Age at which a temporary folder must be locked, or it is one of a killed process [s]; chosen."""


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Give a place for a file in a temporary folder, and move the file when it is whole.

    Parameters
    ----------
    path
        The file to make or replace.

    Yields
    ------
    Path
        A file of the same name; it is removed if the block raises.

    Raises
    ------
    InputError
        If the folder cannot be written to or the disk is full.
    """
    with atomic_files(path, path.parent, last=path.name) as folder:
        yield folder / path.name


@contextmanager
def atomic_files(target: Path, folder: Path, *, last: str, first: str = "") -> Iterator[Path]:
    """Give a temporary folder, and move its files to another when they are whole.

    Parameters
    ----------
    target
        What is made.
    folder
        Where the files belong, and the temporary folder is: on the same file system, even if the
        folder is a link or a mount point.
    last
        The file that comes last: if it is there, all of them are.
    first
        The file that comes first.

    Yields
    ------
    Path
        An empty folder; nothing of it is kept if the block raises.

    Raises
    ------
    InputError
        If a folder cannot be written to or the disk is full.
    """
    try:
        with temporary_folder(folder / target.name) as made:
            try:
                yield made
            except InputError as error:  # named as it will be
                raise InputError(str(error).replace(str(made), str(folder))) from error
            names = [file.name for file in made.iterdir() if file.is_file()]
            names.sort(key=lambda name: (name == last) - (name == first))
            if in_the_way := next((n for n in names if folder.joinpath(n).is_dir()), None):
                raise OSError(errno.EISDIR, f"{in_the_way} is a folder")
            _move(names, made, folder, last)
    except OSError as error:
        reason = error.strerror or error
        raise InputError(f"{target}: cannot be written ({reason}); try another place") from error


def _move(names: list[str], made: Path, folder: Path, last: str) -> None:
    """Move all files, or leave those that were there; if killed, the last is missing."""
    several = len(names) > 1  # a single move is whole by itself
    kept = Path(tempfile.mkdtemp(dir=made)) if several else made
    for name in names if several else ():
        if folder.joinpath(name).exists():
            shutil.copy2(folder / name, kept)
    try:
        if several:
            folder.joinpath(last).unlink(missing_ok=True)
        for name in names:
            made.joinpath(name).replace(folder / name)
    except OSError:
        for name in names if several else ():
            if kept.joinpath(name).exists():
                kept.joinpath(name).replace(folder / name)
            elif not made.joinpath(name).exists():
                folder.joinpath(name).unlink(missing_ok=True)
        raise


def writable(path: Path) -> None:
    """Raise InputError if a file could not be written; to be called before the work."""
    if path.is_dir():
        raise InputError(f"{path}: is a folder; name a file")
    if not path.parent.is_dir():
        raise InputError(f"{path.parent}: no such folder; make it first")
    makeable(path.parent)


def makeable(path: Path) -> None:
    """Raise InputError if a folder could not be made; to be called before the work."""
    there = next(place for place in (path, *path.absolute().parents) if place.exists())
    if not there.is_dir():
        raise InputError(f"{there}: is a file; name a folder")
    if not os.access(there, os.W_OK):
        raise InputError(f"{there}: no permission to write; choose another place")


def made_folder(path: Path) -> Path:
    """Make a folder if it is not there; raises InputError if it cannot be made."""
    with kept_folder(path):
        return path


@contextmanager
def kept_folder(path: Path) -> Iterator[None]:
    """Make a folder and those above it; if the block raises, what is still empty of them goes.

    Raises InputError if it cannot be made.
    """
    new = [place for place in (path, *path.parents) if not place.exists()]
    try:
        try:
            path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            why = f"{path}: cannot be made a folder ({error.strerror}); try another place"
            raise InputError(why) from error
        yield
    except BaseException:
        for place in new:
            with suppress(OSError):
                place.rmdir()
        raise


@contextmanager
def folder_lock(folder: Path, *, shared: bool = False) -> Iterator[None]:
    """Lock a folder, made if needed, during the block; raises InputError if another process has it.

    A process that is killed gives the lock up. Processes with a ``shared`` lock may work together.
    """
    with kept_folder(folder), opened_folder(folder) as handle:
        try:
            lock(handle, shared=shared)
        except BlockingIOError as error:
            raise InputError(f"{folder}: another process works here; wait for it") from error
        except OSError:  # a file system without locks
            pass
        yield


@contextmanager
def file_lock(path: Path) -> Iterator[bool]:
    """Lock a file, made for this alone, during the block; false if another process has it."""
    with path.open("ab") as file:
        try:
            lock(file.fileno())
        except BlockingIOError:
            yield False
            return
        except OSError:  # a file system without locks
            pass
        try:  # whoever had it may have removed it since it was opened here
            is_there = os.path.samestat(os.fstat(file.fileno()), path.stat())
        except FileNotFoundError:
            is_there = False
        if not is_there:
            yield False
            return
        try:
            yield True
        finally:
            path.unlink(missing_ok=True)


def lock(handle: int, *, shared: bool = False) -> None:
    """Lock an open file or folder; raises OSError if another has it. Browsers have no locks."""
    import fcntl

    fcntl.flock(handle, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)


@contextmanager
def opened_folder(folder: Path) -> Iterator[int]:
    """Open a folder during the block, and give its descriptor; raises OSError if it is none."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        yield handle
    finally:
        os.close(handle)


@contextmanager
def temporary_folder(target: Path) -> Iterator[Path]:
    """Give a temporary folder next to a target, and remove those there of killed processes.

    Parameters
    ----------
    target
        The file or folder that is made in it. A process that is alive has a lock on its folder.
    """
    for old in target.parent.glob(f".*{MARK}????????"):
        with suppress(OSError), opened_folder(old) as handle:
            there = os.fstat(handle)
            if there.st_uid == os.geteuid() and time.time() - there.st_mtime > LEAST_AGE:
                lock(handle)
                shutil.rmtree(old)
    prefix = f".{target.name[:40]}{MARK}"
    with (
        tempfile.TemporaryDirectory(
            dir=target.parent, prefix=prefix, ignore_cleanup_errors=True
        ) as name,
        folder_lock(Path(name)),
    ):
        yield Path(name)


# -- NetCDF --------------------------------------------------------------------------------------


Attributes = TypeVar("Attributes", bound="BaseModel")


@dataclass(frozen=True)
class NetcdfFile(Generic[Attributes]):
    """What a NetCDF file holds; without ``xarray``, whose import takes 0.5 s.

    Attributes
    ----------
    attrs
        Attributes of the file, checked.
    variables
        Arrays of all variables, in the order of the file; text as ``str``. Names of those in groups
        begin with the group, as in ``posterior/phi``.
    sizes
        Length of each dimension that was asked for so far.
    """

    attrs: Attributes
    variables: dict[str, Any]
    sizes: dict[str, int] = field(default_factory=dict)

    def _array(self, name: str, dims: tuple[str | int, ...]) -> Any:
        """A variable of the shape expected; raises ValueError if there is none."""
        values = self.variables.get(name)
        if values is None:
            raise ValueError(f"no variable '{name}'")
        for dim, size in zip(dims, values.shape, strict=False):
            self.sizes.setdefault(str(dim), dim if isinstance(dim, int) else size)
        if values.shape != tuple(self.sizes.get(str(dim)) for dim in dims):
            axes = ", ".join(f"{dim} = {self.sizes.get(str(dim))}" for dim in dims)
            raise ValueError(f"'{name}' has shape {values.shape}, expected {axes}")
        return values

    def numbers(self, name: str, *dims: str | int, finite: bool = True) -> FloatArray:
        """A variable of real numbers.

        Parameters
        ----------
        name
            The variable.
        dims
            Its dimensions: lengths, or names, each with the same length in the whole file.
        finite
            Whether infinite values and those that are not a number are refused.

        Raises
        ------
        ValueError
            If it is missing, of another type or shape, or not finite.
        """
        values = self._array(name, dims)
        if values.dtype.kind not in "biuf":
            raise ValueError(f"'{name}' holds {values.dtype}, expected numbers")
        values = values.astype(np.float64)
        if finite and not np.isfinite(values).all():
            raise ValueError(f"'{name}' holds values that are not finite")
        return values

    def texts(self, name: str, dim: str) -> tuple[str, ...]:
        """A variable of text along a dimension; raises ValueError as :meth:`numbers` does."""
        values = tuple(self._array(name, (dim,)).tolist())
        if not all(isinstance(value, str) for value in values):
            raise ValueError(f"'{name}' holds no text")
        return values


@contextmanager
def open_netcdf(
    path: Path, attributes: type[Attributes], *, kind: str, schema: int | None, remedy: str = ""
) -> Iterator[NetcdfFile[Attributes]]:
    """Load a NetCDF file that terraphi wrote, for the time of a block that makes a result of it.

    Parameters
    ----------
    path
        The file.
    attributes
        Model that the attributes of the file must fill.
    kind
        Value of the attribute ``terraphi_file`` expected.
    schema
        Version of its layout expected.
    remedy
        What to do with a file of another kind, after a semicolon.

    Raises
    ------
    InputError
        If the file is missing, not a NetCDF, truncated, of another kind or schema; or if the block
        raises LookupError, TypeError or ValueError, as for a variable that is missing.
    """
    from pydantic import ValidationError

    if netcdf_kind(path) != kind:
        raise InputError(f"{path}: a NetCDF file, but not a {kind} written by terraphi{remedy}")
    try:
        attrs, variables = _read(path)
    except Exception as error:  # damage raises anything in the libraries that read it
        raise InputError(f"{path}: not a whole NetCDF file; build or copy it again") from error
    version = str(attrs.get("terraphi_schema"))
    if version != str(schema):
        raise InputError(f"{path}: schema version {version}, not {schema}; build the {kind} again")
    with as_written(path, kind):
        try:
            checked = attributes.model_validate(attrs)
        except ValidationError as error:
            sentence = sentence_from_validation(error, str(path), attributes)
            raise InputError(f"{sentence}; make the {kind} again") from error
        yield NetcdfFile(checked, variables)


@contextmanager
def as_written(path: Path, kind: str) -> Iterator[None]:
    """Raise InputError if a block does not find in a file of ours what this version writes."""
    try:
        yield
    except InputError:
        raise
    except (AttributeError, LookupError, TypeError, ValueError) as error:
        why = f"{path}: not as this version writes {kind} ({error}); make it again"
        raise InputError(why) from error


def netcdf_kind(path: Path) -> str:
    """Kind of a NetCDF file of ours, found without reading its variables; empty if there is none.

    Raises InputError if the file is missing or no NetCDF, exceeds a limit of
    :mod:`terraphi.experiment.budget`, or has links, which readers would follow without end or into
    other files; or for a variable as :func:`_memory` does.
    """
    import h5py

    check_is_file(path)
    try:
        with h5py.File(path) as file:
            groups, addresses, size = [file], {h5py.h5o.get_info(file.id).addr}, 0
            while groups:
                group = groups.pop()
                for name in group:
                    where = f"{path}: '{group.name.rstrip('/')}/{name}'"
                    # Asked before it is opened: an external link opens another file, or a pipe.
                    linked = not isinstance(group.get(name, getlink=True), h5py.HardLink)
                    if linked or (address := h5py.h5o.get_info(group[name].id).addr) in addresses:
                        raise InputError(f"{where} is a link; write it without links")
                    addresses.add(address)
                    item = group[name]
                    if len(addresses) > ITEMS or item.name.count("/") > NESTING:
                        more = f"more than {ITEMS} variables or {NESTING} groups within another"
                        raise InputError(f"{path}: has {more}; name a file of terraphi")
                    size += _memory(item, where) if isinstance(item, h5py.Dataset) else 0
                    groups += [item] if isinstance(item, h5py.Group) else []
            kind = str(file.attrs.get("terraphi_file", ""))
    except InputError:
        raise
    except Exception as error:  # damage raises anything in HDF5
        raise InputError(f"{path}: not a whole NetCDF file; build or copy it again") from error
    if size > BYTES:
        raise InputError(f"{path}: its variables take {size / 1e9:.3g} GB, expected at most 1 GB")
    return kind


def _memory(variable: Any, where: str) -> int:
    """Memory that a variable takes while it is read [byte], found before any value is.

    Raises InputError if its values lie in other files, which may be private or a pipe, or have a
    filter that NetCDF-4 does not need, for which HDF5 would load a plugin.
    """
    from h5py import h5d, h5z

    accepted = {h5z.FILTER_DEFLATE, h5z.FILTER_SHUFFLE, h5z.FILTER_FLETCHER32}
    layout = variable.id.get_create_plist()
    # Before the shape, for which HDF5 may open the files that a virtual variable is made of.
    if layout.get_external_count() or layout.get_layout() == h5d.VIRTUAL:
        raise InputError(f"{where} lies in another file; write its values into this one")
    if {layout.get_filter(i)[0] for i in range(layout.get_nfilters())} - accepted:
        raise InputError(f"{where} has a filter other than deflate; compress it with zlib alone")
    # A chunk is unpacked whole, and may be larger than the variable.
    shape = variable.shape or ()
    lengths = map(max, shape, variable.chunks or shape)
    return int(variable.id.dtype.itemsize * math.prod(lengths))


def _read(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Attributes and variables of a NetCDF-4 file.

    Scale, offset and calendar attributes are not applied.
    """
    import h5netcdf

    with h5netcdf.File(path, "r", decode_vlen_strings=True) as file:
        groups = {"": file, **{f"{name}/": group for name, group in file.groups.items()}}
        variables = {
            f"{at}{n}": np.asarray(v[...])
            for at, group in groups.items()
            for n, v in group.variables.items()
        }
        return dict(file.attrs), variables


def write_netcdf(dataset: Any, path: Path) -> None:
    """Write a NetCDF-4 file, whole or not at all.

    Parameters
    ----------
    dataset
        An ``xarray.Dataset`` or ``xarray.DataTree``.
    path
        The file to make or replace.

    Raises
    ------
    InputError
        If the folder cannot be written to or the disk is full.
    """
    # Made in memory: on a full disk HDF5 raises anything, and may take the interpreter down when
    # it tries again to close the file.
    buffer = io.BytesIO()
    dataset.to_netcdf(buffer, engine="h5netcdf")
    with atomic_write(path) as temporary:
        temporary.write_bytes(buffer.getvalue())
