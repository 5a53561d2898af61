"""Where results go: never over what this program did not write.

A folder of results has a manifest, which names the files in it that are ours with their digests. A
single file says itself what wrote it.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import tempfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from terraphi.experiment.errors import InputError
from terraphi.experiment.files import made_folder, makeable, replacing, writable

MANIFEST = "manifest.json"
SIGNATURE = "made with terraphi"
"""Comment in a film of ours."""
_HDF5 = b"\x89HDF\r\n\x1a\n"
_MARKS = (b'<meta name="generator" content="terraphi ', SIGNATURE.encode())
_NEAR_AN_END = 1 << 14
"""Bytes at either end of a page or a film in which its mark stands."""

Files = dict[str, list[str]]
"""Name of a file to the digests that it may have."""


class Manifest(NamedTuple):
    """What a folder of results says of itself."""

    kind: str
    files: Files


def check_file(path: Path, *, kind: str = "") -> None:
    """Raise InputError before any work if a file cannot be written or is not terraphi's.

    Parameters
    ----------
    path
        The file to be.
    kind
        Of a NetCDF, the value of the attribute ``terraphi_file`` of one that may be replaced.

    Raises
    ------
    InputError
        If a NetCDF's name does not end in ``.nc``; if it is a folder or a device, its folder is not
        there or cannot be written to, or it holds what this program did not write, or something of
        another kind.
    """
    if kind:
        check_netcdf_name(path)
    writable(path)
    if path.exists() and not path.is_file():
        raise InputError(f"{path}: is a device or a pipe; name a file")
    if path.is_file() and path.stat().st_size and not _is_ours(path, kind):
        what = f"a {kind} written by" if kind else "written by"
        raise InputError(
            f"{path}: is there, and not {what} terraphi; name another file, or move that one away"
        )


def check_netcdf_name(path: Path) -> None:
    """Raise InputError for a NetCDF that is not called so, and might hide a library by its name."""
    if path.suffix != ".nc" and not path.is_dir():
        raise InputError(f"{path}: is written as NetCDF; name it {path.stem}.nc")


def _is_ours(path: Path, kind: str) -> bool:
    """Whether a file says that this program wrote it."""
    try:
        with path.open("rb") as stream:
            ends = stream.read(_NEAR_AN_END)
            stream.seek(max(path.stat().st_size - _NEAR_AN_END, 0))
            ends += stream.read()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    if not kind:
        return any(mark in ends for mark in _MARKS)
    if not ends.startswith(_HDF5):
        return False
    import h5py

    try:
        with h5py.File(path) as file:
            found = file.attrs.get("terraphi_file")
    except (OSError, RuntimeError, ValueError):  # damaged, and so nobody can tell
        return False
    return bool(found == kind)


def check_folder(
    path: Path, *, kind: str, names: Collection[str] = (), besides: Collection[str] = ()
) -> None:
    """Raise InputError before any work if a folder cannot be made or is not terraphi's.

    Parameters
    ----------
    path
        The folder to be.
    kind
        Of the results, for people: ``inversion``.
    names
        Files that will be written there.
    besides
        What may be in it although there is no manifest yet.

    Raises
    ------
    InputError
        If it cannot be made or written to; if it is neither new nor empty nor has a manifest; or if
        it holds other results, or a file that would be replaced is not as this program wrote it.
    """
    makeable(path)
    if not path.is_dir():
        return
    manifest = _manifest(path)
    if manifest is None:
        others = sorted(entry.name for entry in path.iterdir() if entry.name not in besides)
        if others:
            raise InputError(
                f"{path}: holds what terraphi did not write, such as '{others[0]}'; name a new or "
                "an empty folder"
            )
        return
    if manifest.files and manifest.kind != kind:
        raise InputError(
            f"{path}: holds the results of another command ({manifest.kind}); name another folder"
        )
    ours = manifest.files
    for name in {*ours, *names}:
        file = path / name
        if not file.exists() or (file.is_file() and _digest(file) in ours.get(name, ())):
            continue
        why = "was changed since terraphi wrote it" if name in ours else "is not one of terraphi's"
        raise InputError(f"{file}: {why}; move it away, or name another folder")


@contextmanager
def filling(path: Path, *, kind: str, last: str, besides: Collection[str] = ()) -> Iterator[Path]:
    """Give a temporary folder to write results into; at the end they replace earlier ones.

    Parameters
    ----------
    path
        The folder of the results.
    kind
        As in :func:`check_folder`.
    last
        The file that comes last: where it stands, all that it speaks of does.
    besides
        As in :func:`check_folder`.

    Yields
    ------
    Path
        An empty folder; if the block raises, nothing of it is kept.

    Raises
    ------
    InputError
        As :func:`check_folder` does.
    """
    check_folder(path, kind=kind, besides=besides)
    was_there = path.is_dir()
    before = _manifest(made_folder(path))
    if before is None:
        _write_manifest(path, Manifest(kind, {}))  # so that it is ours even if we are killed
    try:
        with tempfile.TemporaryDirectory(dir=path, prefix=".unfinished-") as unfinished:
            made = Path(unfinished)
            yield made
            new = {file.name: [_digest(file)] for file in made.iterdir()}
            check_folder(path, kind=kind, names=new)
            _take_over(path, made, before.files if before else {}, Manifest(kind, new), last)
    except BaseException:
        if before is None and _manifest(path) == (kind, {}):
            path.joinpath(MANIFEST).unlink()
            if not was_there:
                with contextlib.suppress(OSError):  # somebody keeps something there by now
                    path.rmdir()
        raise


def _take_over(path: Path, made: Path, old: Files, wanted: Manifest, last: str) -> None:
    """Replace old files by new ones; if interrupted at any point, the manifest stays right."""
    new = wanted.files
    every = {name: [*old.get(name, ()), *new.get(name, ())] for name in {**old, **new}}
    _write_manifest(path, wanted._replace(files=every))
    for name in sorted(old, key=lambda name: name != last):
        if name == last or name not in new:
            path.joinpath(name).unlink(missing_ok=True)
    for name in sorted(new, key=lambda name: name == last):
        made.joinpath(name).replace(path / name)
    _write_manifest(path, wanted)


def _manifest(path: Path) -> Manifest | None:
    """Files that terraphi wrote in a folder; ``None`` if it has no manifest."""
    try:
        content = json.loads(path.joinpath(MANIFEST).read_text(encoding="utf-8"))
        if content["terraphi_file"] != "manifest":
            return None
        files = {Path(str(n)).name: [str(d) for d in ds] for n, ds in content["files"].items()}
        return Manifest(str(content["kind"]), files)
    except (OSError, AttributeError, KeyError, RecursionError, TypeError, ValueError):
        return None


def _write_manifest(path: Path, manifest: Manifest) -> None:
    files = dict(sorted(manifest.files.items()))
    content = {"terraphi_file": "manifest", "kind": manifest.kind, "files": files}
    with replacing(path / MANIFEST) as temporary:
        temporary.write_text(json.dumps(content, indent=2), encoding="utf-8")


def _digest(file: Path) -> str:
    """SHA-256 of a file, hexadecimal."""
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
