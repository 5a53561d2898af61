"""A folder that one process at a time works in."""

from __future__ import annotations

import fcntl
import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from terraphi.errors import InputError
from terraphi.files import made_folder

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
    """A lock on a folder, which is made if it is not there; ends with the handle."""
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
    """Whether an open folder is still the one of its name."""
    try:
        return os.path.samestat(folder.stat(), os.fstat(handle))
    except FileNotFoundError:
        return False
