"""Results: folders written whole or not at all, and nothing of other origin overwritten.

A folder of results has a manifest, which names the files in it that are ours. A single file
contains a mark that names terraphi.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Literal

from pydantic import Field

from terraphi.experiment.documents import Strict
from terraphi.experiment.errors import InputError, printable
from terraphi.experiment.files import (
    MARK,
    atomic_files,
    check_is_file,
    kept_folder,
    makeable,
    netcdf_kind,
    read_bytes,
    writable,
)

MANIFEST = "manifest.json"
SIGNATURE = "made with terraphi"
"""Comment in pictures, tables and models of ours."""


class Manifest(Strict):
    """What a folder of results holds."""

    terraphi_file: Literal["manifest"] = "manifest"
    kind: str
    """What wrote it."""
    files: list[str]
    """Names of the files that may be replaced by others of the same name."""
    digests: dict[str, str] = Field(default_factory=dict)
    """SHA-256 of the files of the last run, hexadecimal."""


_MARKS = (b'<meta name="generator" content="terraphi ', SIGNATURE.encode())


def check_file(path: Path, *, kind: str = "") -> None:
    """Raise InputError if a file cannot be written or is not ours; to be called before the work.

    Parameters
    ----------
    path
        The file to be.
    kind
        Of a NetCDF, the attribute ``terraphi_file`` of those that may be replaced.
    """
    if kind and path.suffix != ".nc" and not path.is_dir():
        raise InputError(f"{path}: is written as NetCDF; name it {path.stem}.nc")
    writable(path)
    if path.exists() and not _is_ours(path, kind):
        what = f"{kind or 'file'} written by terraphi"
        raise InputError(f"{path}: is there, and not a {what}; name another, or move it away")


def _is_ours(path: Path, kind: str) -> bool:
    """True if a file is empty or says that terraphi wrote it."""
    if not path.is_file() or not path.stat().st_size:
        return path.is_file()
    if not kind:
        content = read_bytes(path)
        return any(mark in content for mark in _MARKS)
    with suppress(InputError):  # damaged, or of another format
        return netcdf_kind(path) == kind
    return False


def check_folder(path: Path, *, kind: str, names: Iterable[str] = ()) -> set[str]:
    """Check that results can go to a folder; to be called before the work.

    Parameters
    ----------
    path
        The folder to be.
    kind
        What writes the results, such as ``inversion``.
    names
        Files that will be written there.

    Returns
    -------
    set of str
        Files of earlier results in it, and the manifest.

    Raises
    ------
    InputError
        If it cannot be made or written to, holds files and no manifest, results of another kind,
        or a file of other origin where one of ours would go.
    """
    makeable(path)
    manifest = Manifest(kind="", files=[])
    with suppress(OSError, ValueError):  # none, or none of ours
        manifest = Manifest.model_validate_json(_content(path, MANIFEST))
    ours = {MANIFEST, *manifest.files}
    if manifest.kind not in ("", kind):
        raise InputError(f"{path}: holds results of '{manifest.kind}'; name another folder")
    there = {file.name for file in path.iterdir()} if path.is_dir() else set()
    there = {name for name in there if MARK not in name}  # of this process, or one killed
    # In a folder without a manifest everything is of other origin.
    for name in sorted((there - ours) & {*names} if manifest.kind else there):
        raise InputError(f"{path}: holds '{name}', not written by terraphi; name an empty folder")
    return ours


@contextmanager
def output_folder(path: Path, *, kind: str, last: str) -> Iterator[Path]:
    """Give a temporary folder to write results into, which then replace earlier ones.

    Parameters
    ----------
    path
        The folder of the results.
    kind
        As in :func:`check_folder`, whose errors this raises too.
    last
        The file that comes last: if it is there, all of them are.

    Yields
    ------
    Path
        An empty folder; if the block raises, nothing of it is kept.
    """
    old = check_folder(path, kind=kind)
    with kept_folder(path), atomic_files(path, path, last=last, first=MANIFEST) as made:
        yield made
        new = sorted(file.name for file in made.iterdir())
        check_folder(path, kind=kind, names=new)
        digests = {name: _digest(made, name) for name in new}
        # If the process is killed from here on, the folder is still ours. Files of earlier
        # results that have no successor stay: a name in a manifest is no reason to delete.
        files = sorted({*old, *new} - {MANIFEST})
        manifest = Manifest(kind=kind, files=files, digests=digests)
        made.joinpath(MANIFEST).write_text(manifest.model_dump_json(indent=2), encoding="utf-8")


def _content(folder: Path, name: str) -> bytes:
    """Content of a file in a folder; raises InputError if it is no file, or elsewhere."""
    file = folder / name
    if file.is_symlink() or file.name != name:
        raise InputError(f"{file}: is not in the folder; name a file in it")
    check_is_file(file)
    return read_bytes(file)


def _digest(folder: Path, name: str) -> str:
    return hashlib.sha256(_content(folder, name)).hexdigest()


def changed(path: Path) -> str:
    """Warn of results that are no longer as terraphi wrote them.

    Parameters
    ----------
    path
        A folder of results, or a file of one.

    Returns
    -------
    str
        A sentence; empty if manifest and files agree, or there is no manifest.
    """
    folder = path if path.is_dir() else path.parent
    if not folder.joinpath(MANIFEST).is_file():
        return ""
    try:
        digests = Manifest.model_validate_json(_content(folder, MANIFEST)).digests
        names = digests if path.is_dir() else {path.name} & {*digests}
        other = [name for name in names if _digest(folder, name) != digests[name]]
    except (OSError, ValueError):
        return f"{folder / MANIFEST} is damaged, or a file that it lists is missing"
    named = printable(", ".join(other))
    return f"{named} was changed after terraphi wrote it" if other else ""
