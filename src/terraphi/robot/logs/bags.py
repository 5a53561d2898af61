"""The files of a recorded bag: MCAP, SQLite, and the folder of a rosbag2 with either.

MCAP is read by the package ``mcap``, record by record (https://mcap.dev/spec), so that a file that
is cut off gives what lies before the cut.

SQLite files and folders are read here, and not by the package ``rosbags``, which reads whole bags
only. Of a log of 60 s at 500 Hz, 30 000 messages, its reader returns

- none where a file was cut off at 80 % of its length (here: 24 000 from SQLite, 23 400 from MCAP),
- none where one page of a SQLite file is damaged (here: the 10 000 before the page),
- none where the end of an MCAP file is missing (here: all), and those before the first damaged
  chunk where one is (here: all but that chunk),
- none where the folder has no ``metadata.yaml``, which a recorder that was switched off never wrote
  (here: all; the files say themselves what is in them).

The tables are those of the package ``rosbag2_storage_sqlite3`` of https://github.com/ros2/rosbag2 .
"""

from __future__ import annotations

import mmap
import os
import re
import shutil
import sqlite3
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType
from typing import IO, Any, cast

import numpy as np

from terraphi.experiment.errors import InputError, needing
from terraphi.robot.logs.collect import Messages


@dataclass(frozen=True)
class Topic:
    """A topic in a bag.

    Attributes
    ----------
    name, type
        As recorded.
    encoding
        Of its messages; ROS 2 writes ``cdr``.
    number
        Number of the topic in the file.
    definition
        Of its messages; empty if the file has none.
    """

    name: str
    type: str
    encoding: str
    number: int
    definition: str = ""

    @property
    def plain_type(self) -> str:
        """Package and name of the type, as in ``unitree_go/LowState``.

        The same message is ``unitree_go/msg/LowState`` in ROS 2 and
        ``unitree_go::msg::dds_::LowState_`` on the robot's own bus.
        """
        parts = [part for part in self.type.replace("::", "/").split("/") if part]
        return f"{parts[0]}/{parts[-1].rstrip('_')}" if len(parts) > 1 else self.type


class Storage(ABC):
    """A file with messages.

    Parameters
    ----------
    path
        The file.
    shown
        What to call it in messages, where the file is a temporary copy.
    """

    def __init__(self, path: Path, *, shown: Path | None = None) -> None:
        self.path = path
        self.shown = shown or path
        self.notes: list[str] = []

    def note(self, text: str) -> None:
        """Add a remark to the log's report, unless it is there already."""
        if text not in self.notes:
            self.notes.append(text)

    @abstractmethod
    def topics(self) -> list[Topic]:
        """Topics in the file."""

    @abstractmethod
    def batches(self, topics: list[Topic]) -> Iterator[Messages]:
        """Messages on some topics, in the order of the file."""


def _text(schema: Any) -> str:
    """Definition in a record of an MCAP file, if it is in the language of ``.msg`` files."""
    if schema is None or schema.encoding != "ros2msg":
        return ""
    return str(schema.data, "utf-8", "replace")


MAGIC = b"\x89MCAP0\r\n"
BATCH = 4096

_PACKAGES = {"lz4": "lz4", "zstd": "zstandard"}


def _mcap(shown: Path) -> ModuleType:
    """Import the package mcap; raises InputError that says how to install it."""
    with needing(f"{shown}: reading MCAP", "the package mcap", extra="robot"):
        import mcap.exceptions
        import mcap.reader
        import mcap.records
        import mcap.stream_reader
    return mcap


class McapFile(Storage):
    """One MCAP file, whole or cut off, indexed or not."""

    def topics(self) -> list[Topic]:
        """Topics in the file."""
        schemas, channels = self._summary()
        if not channels:
            mcap = _mcap(self.shown)
            for record in self._records():
                if isinstance(record, mcap.records.Schema):
                    schemas[record.id] = record
                elif isinstance(record, mcap.records.Channel):
                    channels[record.id] = record
        return [
            Topic(
                name=channel.topic,
                type=schemas[channel.schema_id].name if channel.schema_id in schemas else "unknown",
                encoding=channel.message_encoding,
                number=number,
                definition=_text(schemas.get(channel.schema_id)),
            )
            for number, channel in sorted(channels.items())
        ]

    def batches(self, topics: list[Topic]) -> Iterator[Messages]:
        """Messages on some topics, in the order of the file."""
        message = _mcap(self.shown).records.Message
        wanted = {topic.number for topic in topics}
        messages: list[bytes] = []
        times: list[int] = []
        for record in self._records():
            if isinstance(record, message) and record.channel_id in wanted:
                messages.append(record.data)
                times.append(min(record.log_time, 2**63 - 1))
            if len(messages) == BATCH:
                yield messages, np.array(times, dtype=np.int64)
                messages, times = [], []
        if messages:
            yield messages, np.array(times, dtype=np.int64)

    def _records(self) -> Iterator[Any]:
        """Records of the file, those inside chunks included, up to where it breaks off."""
        mcap = _mcap(self.shown)
        with self.path.open("rb") as stream:
            if stream.read(len(MAGIC)) != MAGIC:
                raise InputError(
                    f"{self.shown}: not an MCAP file, or damaged at its start; copy it again"
                )
            # A damaged length asks a file for terabytes, and a map of it for what is left.
            content = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
            content.seek(len(MAGIC))
            reader = mcap.stream_reader.StreamReader(
                cast("IO[bytes]", content),
                skip_magic=True,
                emit_chunks=True,
                record_size_limit=len(content),
            )
            try:
                for record in reader.records:
                    if isinstance(record, mcap.records.Footer):
                        return
                    if isinstance(record, mcap.records.Chunk):
                        yield from self._unpacked(record)
                    else:
                        yield record
            except (InputError, OSError, MemoryError):
                raise
            except Exception:  # damage raises struct.error, UnicodeDecodeError, EndOfFile and more
                self.note("the file is cut off or damaged; what comes before is read")

    def _summary(self) -> tuple[dict[int, Any], dict[int, Any]]:
        """Schemas and channels repeated at the file's end; empty if they are not there."""
        mcap = _mcap(self.shown)
        with self.path.open("rb") as stream:
            try:
                reader = mcap.reader.SeekingReader(
                    stream, record_size_limit=self.path.stat().st_size
                )
                found = reader.get_summary()
            except Exception:  # as above: the end of the file is missing or damaged
                found = None
        return ({}, {}) if found is None else (found.schemas, found.channels)

    def _unpacked(self, chunk: Any) -> list[Any]:
        """Records of a chunk; none if it is damaged."""
        mcap = _mcap(self.shown)
        if chunk.compression and chunk.compression not in _PACKAGES:
            raise InputError(
                f"{self.shown}: compressed with '{chunk.compression[:20]}', which is not known; "
                "expected lz4, zstd or none: convert it with the mcap command line tool"
            )
        try:
            return list(mcap.stream_reader.breakup_chunk(chunk, validate_crc=True))
        except mcap.exceptions.UnsupportedCompressionError as error:
            raise InputError(
                f"{self.shown}: compressed with {chunk.compression}, which needs the package "
                f"{_PACKAGES[chunk.compression]}: pip install 'terraphi[robot]'"
            ) from error
        except Exception:  # each decompressor has errors of its own
            self.note("a damaged chunk was passed over")
            return []


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
            definitions = self._definitions(connection)
        return [replace(topic, definition=definitions.get(topic.type, "")) for topic in found]

    def _definitions(self, connection: sqlite3.Connection) -> dict[str, str]:
        """Definitions of messages, which recorders write since ROS 2 Iron."""
        query = (
            "SELECT topic_type, encoded_message_definition FROM message_definitions "
            "WHERE encoding = 'ros2msg'"
        )
        try:
            return {str(kind): str(text) for kind, text in connection.execute(query)}
        except sqlite3.Error:
            return {}

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
        """Decompress a message if it is compressed (compression mode MESSAGE of rosbag2)."""
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
    """Import the package zstandard; raises InputError that says how to install it."""
    with needing(f"{shown}: compressed with zstd, which", "the package zstandard", extra="robot"):
        import zstandard
    return zstandard


def open_database(path: Path, stack: ExitStack, *, shown: Path | None = None) -> SqliteFile:
    """Open a database; of one that was cut off, only the whole pages.

    SQLite reads the missing part of a page as zeros, which would give rows that nobody wrote.

    Parameters
    ----------
    path
        The file.
    stack
        Removes the temporary copy at the end, if one is needed.
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
    """Open the files of a rosbag2 folder, in the order of recording.

    Parameters
    ----------
    path
        The folder.
    stack
        Removes unpacked files at the end.

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
    """Unpack a compressed file into a temporary folder; the path of the copy."""
    zstandard = _zstandard(file)
    folder = Path(stack.enter_context(TemporaryDirectory()))
    plain = folder / file.stem
    try:
        with file.open("rb") as packed, plain.open("wb") as out:
            shutil.copyfileobj(zstandard.ZstdDecompressor().stream_reader(packed), out)
    except zstandard.ZstdError as error:
        raise InputError(f"{file}: cannot be decompressed ({error}); copy it again") from error
    return plain
