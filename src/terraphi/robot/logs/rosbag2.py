"""rosbag2: a folder of SQLite or MCAP files.

Tables as in the package ``rosbag2_storage_sqlite3`` of https://github.com/ros2/rosbag2 . The
folder's ``metadata.yaml`` is not needed: a recorder that was switched off never wrote it, and the
files say what is in them.
"""

from __future__ import annotations

import os
import re
import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import ExitStack, closing
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType
from typing import Any

import numpy as np

from terraphi.errors import InputError
from terraphi.robot.logs.block import Messages
from terraphi.robot.logs.mcap_file import BATCH, MAGIC, McapFile
from terraphi.robot.logs.storage import Storage, Topic

SQLITE_MAGIC = b"SQLite format 3\0"
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
LARGEST_MESSAGE = 2**24
"""Size [bytes] beyond which a compressed message is taken for damage."""


class SqliteFile(Storage):
    """One SQLite file of a bag."""

    def topics(self) -> list[Topic]:
        """Topics in the file."""
        query = "SELECT id, name, type, serialization_format FROM topics ORDER BY id"
        found = []
        with closing(self._connect()) as connection:
            try:
                for number, name, kind, encoding in connection.execute(query):
                    found.append(Topic(str(name), str(kind), str(encoding), int(number)))
            except (sqlite3.Error, TypeError, ValueError) as error:
                if not found:
                    raise InputError(
                        f"{self.shown}: not a rosbag2 database, or damaged at its start ({error}); "
                        "copy or record it again"
                    ) from error
                self._cut_off(error)
        return found

    def batches(self, topics: list[Topic]) -> Iterator[Messages]:
        """Messages on some topics, in the order of recording."""
        marks = ",".join("?" * len(topics))
        query = f"SELECT timestamp, data FROM messages WHERE topic_id IN ({marks}) ORDER BY id"
        with closing(self._connect()) as connection:
            try:
                rows = connection.execute(query, [topic.number for topic in topics])
            except sqlite3.Error as error:
                self._cut_off(error)
                return
            while True:
                batch: list[tuple[Any, Any]] = []
                try:
                    # Row by row, so that those before a damaged page are not lost with it.
                    batch.extend(islice(rows, BATCH))
                except sqlite3.Error as error:
                    self._cut_off(error)
                    rows = connection.cursor()  # exhausted
                if not batch:
                    return
                yield self._messages(batch)

    def _messages(self, rows: list[tuple[Any, Any]]) -> Messages:
        sound = [(t, m) for t, m in rows if isinstance(t, int) and isinstance(m, bytes)]
        if len(sound) < len(rows):
            self.note("rows of the database without a message were passed over")
        messages = [self._inflated(message) for _, message in sound]
        return messages, np.array([time for time, _ in sound], dtype=np.int64)

    def _inflated(self, message: bytes) -> bytes:
        """A message of a bag that compresses each one by itself; others as they are."""
        if message[:4] != ZSTD_MAGIC:
            return message
        zstandard = _zstandard(self.shown)
        try:
            packer = zstandard.ZstdDecompressor()
            return bytes(packer.decompress(message, max_output_size=LARGEST_MESSAGE))
        except zstandard.ZstdError:
            return b""  # dropped as malformed, and counted

    def _connect(self) -> sqlite3.Connection:
        # A recorder that crashed leaves a write-ahead log, which SQLite must be let at; otherwise
        # the file is promised not to change, and nothing is written beside it.
        unfinished = self.path.with_name(self.path.name + "-wal")
        promise = "" if unfinished.exists() and unfinished.stat().st_size else "&immutable=1"
        uri = f"{self.path.resolve().as_uri()}?mode=ro{promise}"
        try:
            connection = sqlite3.connect(uri, uri=True)
            # Lets a file be read that is shorter than its header says.
            connection.execute("PRAGMA writable_schema=ON")
        except sqlite3.Error as error:
            raise InputError(
                f"{self.shown}: cannot be opened as a database ({error}); copy it again"
            ) from error
        return connection

    def _cut_off(self, error: Exception) -> None:
        self.note(f"the database is cut off or damaged ({error}); what comes before is read")


def _zstandard(shown: Path) -> ModuleType:
    """The package, or a sentence that says how to get it."""
    try:
        import zstandard
    except ImportError as error:
        raise InputError(
            f"{shown}: compressed with zstd, which needs the package zstandard: "
            "pip install 'terraphi[robot]'"
        ) from error
    return zstandard


def open_database(path: Path, stack: ExitStack, *, shown: Path | None = None) -> SqliteFile:
    """Storage of a database, of its whole pages only if it was cut off.

    SQLite reads the missing part of a page as zeros, and so makes rows that nobody wrote.

    Parameters
    ----------
    path
        The file.
    stack
        Takes care of a temporary copy, if there has to be one.
    shown
        What to call the file in messages.

    Returns
    -------
    SqliteFile
    """
    shown = shown or path
    with path.open("rb") as stream:
        page = int.from_bytes(stream.read(18)[16:], "big")
    page = 65_536 if page == 1 else page
    excess = path.stat().st_size % page if page else 0
    if not excess:
        return SqliteFile(path, shown=shown)
    copy = Path(stack.enter_context(TemporaryDirectory())) / path.name
    shutil.copyfile(path, copy)
    os.truncate(copy, copy.stat().st_size - excess)
    return SqliteFile(copy, shown=shown)


def open_bag(path: Path, stack: ExitStack) -> list[Storage]:
    """Storages of a folder, in the order of recording.

    Parameters
    ----------
    path
        The folder.
    stack
        Takes care of files that have to be unpacked.

    Returns
    -------
    list of Storage

    Raises
    ------
    InputError
        If the folder holds no bag, or a package is missing.
    """
    suffixes = (".db3", ".mcap", ".db3.zstd", ".mcap.zstd")
    files = [file for file in path.iterdir() if file.name.endswith(suffixes) and file.is_file()]
    if not files:
        raise InputError(
            f"{path}: a folder without .db3 or .mcap files; name the folder that ros2 bag wrote"
        )
    files.sort(
        key=lambda file: [(int(t or 0), s) for t, s in re.findall(r"(\d+)|(\D+)", file.name)]
    )
    storages: list[Storage] = []
    for file in files:
        plain = _unpacked(file, stack) if file.suffix == ".zstd" else file
        with plain.open("rb") as stream:
            magic = stream.read(16)
        if magic[: len(MAGIC)] == MAGIC:
            storages.append(McapFile(plain, shown=file))
        elif magic == SQLITE_MAGIC:
            storages.append(open_database(plain, stack, shown=file))
        elif len(files) == 1:
            what = "the file is empty" if not magic else "neither SQLite nor MCAP"
            raise InputError(f"{file}: {what}; copy or record it again")
    if not storages:
        raise InputError(f"{path}: none of its {len(files)} files is a SQLite or MCAP file")
    return storages


def _unpacked(file: Path, stack: ExitStack) -> Path:
    """A temporary copy of a compressed file."""
    zstandard = _zstandard(file)
    folder = Path(stack.enter_context(TemporaryDirectory()))
    plain = folder / file.stem
    try:
        with file.open("rb") as packed, plain.open("wb") as out:
            shutil.copyfileobj(zstandard.ZstdDecompressor().stream_reader(packed), out)
    except zstandard.ZstdError as error:
        raise InputError(f"{file}: cannot be decompressed ({error}); copy it again") from error
    return plain
