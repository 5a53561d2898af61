"""MCAP files, whole or cut off, indexed or not.

Only the outer framing is read here (https://mcap.dev/spec: records of an opcode, a length and a
body), so that a damaged file ends in a sound prefix; records are decoded by the package ``mcap``.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from types import ModuleType
from typing import BinaryIO

import numpy as np

from terraphi.errors import InputError
from terraphi.robot.logs.block import Messages
from terraphi.robot.logs.storage import Storage, Topic

MAGIC = b"\x89MCAP0\r\n"
BATCH = 4096

_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, recorded and published [ns]
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE_OP, _CHUNK = 0x02, 0x03, 0x04, 0x05, 0x06
_PACKAGES = {"lz4": "lz4", "zstd": "zstandard"}


def _mcap(shown: Path) -> ModuleType:
    """The package, or a sentence that says how to get it."""
    try:
        import mcap.records
        import mcap.stream_reader
    except ImportError as error:
        raise InputError(
            f"{shown}: reading MCAP needs the package mcap: pip install 'terraphi[robot]'"
        ) from error
    return mcap


class McapFile(Storage):
    """One MCAP file."""

    def topics(self) -> list[Topic]:
        """Topics in the file."""
        mcap = _mcap(self.shown)
        schemas: dict[int, str] = {}
        channels: dict[int, tuple[int, str, str]] = {}
        with self._open() as stream:
            for code, body in self._records(stream, "survey"):
                data = mcap.stream_reader.ReadDataStream(BytesIO(body))
                try:
                    if code == _SCHEMA:
                        schema = mcap.records.Schema.read(data)
                        schemas[schema.id] = schema.name
                    elif code == _CHANNEL:
                        c = mcap.records.Channel.read(data)
                        channels[c.id] = (c.schema_id, c.topic, c.message_encoding)
                except Exception:  # a damaged record raises struct.error, EndOfFile and more
                    self.note("a damaged description of a topic was passed over")
        return [
            Topic(name, schemas.get(schema, "unknown"), encoding, number)
            for number, (schema, name, encoding) in sorted(channels.items())
        ]

    def batches(self, topics: list[Topic]) -> Iterator[Messages]:
        """Messages on some topics, in the order of the file."""
        wanted = {topic.number for topic in topics}
        messages: list[bytes] = []
        times: list[int] = []
        with self._open() as stream:
            for code, body in self._records(stream, "read"):
                if code != _MESSAGE_OP or len(body) < _MESSAGE.size:
                    continue
                channel, _, recorded, _ = _MESSAGE.unpack_from(body)
                if channel in wanted:
                    messages.append(body[_MESSAGE.size :])
                    times.append(min(recorded, 2**63 - 1))
                if len(messages) == BATCH:
                    yield messages, np.array(times, dtype=np.int64)
                    messages, times = [], []
        if messages:
            yield messages, np.array(times, dtype=np.int64)

    # -- records ---------------------------------------------------------------------------------

    def _open(self) -> BinaryIO:
        stream = self.path.open("rb")
        if stream.read(len(MAGIC)) != MAGIC:
            stream.close()
            raise InputError(
                f"{self.shown}: not an MCAP file, or damaged at its start; copy it again"
            )
        return stream

    def _records(self, stream: BinaryIO, purpose: str) -> Iterator[tuple[int, bytes]]:
        """Records of the file, those inside chunks included, up to where it breaks off."""
        size = self.path.stat().st_size
        if purpose == "survey":
            indexed = self._summary(stream, size)
            if indexed:
                yield from indexed
                return
            stream.seek(len(MAGIC))
        while head := stream.read(_RECORD.size):
            if len(head) < _RECORD.size:
                break
            code, length = _RECORD.unpack(head)
            if code == _FOOTER:
                return
            if length > size - stream.tell():
                break
            if code not in {_SCHEMA, _CHANNEL, _MESSAGE_OP, _CHUNK}:
                stream.seek(length, 1)
                continue
            body = stream.read(length)
            if code == _CHUNK:
                yield from _split(self._unpack(body))
            else:
                yield code, body
        self.note("the file is cut off or damaged; what comes before is read")

    def _summary(self, stream: BinaryIO, size: int) -> list[tuple[int, bytes]]:
        """Descriptions of topics repeated at the file's end; empty if they are not there."""
        tail = _RECORD.size + 20 + len(MAGIC)
        stream.seek(max(size - tail, 0))
        footer = stream.read(tail)
        if len(footer) < tail or footer[0] != _FOOTER or footer[-len(MAGIC) :] != MAGIC:
            return []
        at = struct.unpack_from("<Q", footer, _RECORD.size)[0]
        if not 0 < at < size:
            return []
        stream.seek(at)
        found = [r for r in _split(stream.read(size - tail - at)) if r[0] in {_SCHEMA, _CHANNEL}]
        return found if any(code == _CHANNEL for code, _ in found) else []

    def _unpack(self, body: bytes) -> bytes:
        """Records of a chunk; nothing if it is damaged."""
        mcap = _mcap(self.shown)
        chunk = None
        try:
            chunk = mcap.records.Chunk.read(mcap.stream_reader.ReadDataStream(BytesIO(body)))
            if chunk.compression and chunk.compression not in _PACKAGES:
                raise InputError(
                    f"{self.shown}: compressed with '{chunk.compression[:20]}', which is not "
                    "known; expected lz4, zstd or none: convert it with the mcap command line tool"
                )
            stream, length = mcap.stream_reader.get_chunk_data_stream(chunk, validate_crc=True)
            return bytes(stream.read(length))
        except InputError:
            raise
        except Exception as error:
            if chunk is not None and type(error).__name__ == "UnsupportedCompressionError":
                package = _PACKAGES[chunk.compression]
                raise InputError(
                    f"{self.shown}: compressed with {chunk.compression}, which needs the package "
                    f"{package}: pip install 'terraphi[robot]'"
                ) from error
            # Each decompressor has errors of its own.
            self.note("a damaged chunk was passed over")
            return b""


def _split(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Records that lie one after the other in memory."""
    at, end = 0, len(data)
    while at + _RECORD.size <= end:
        code, length = _RECORD.unpack_from(data, at)
        at += _RECORD.size
        if length > end - at:
            return
        yield code, data[at : at + length]
        at += length
