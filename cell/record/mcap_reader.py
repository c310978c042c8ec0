"""Reads recordings front to back, also those that were never finished, within bounds.

A recording whose writer was killed has no index and may end in the middle of a record. Everything
before that is good: chunks are whole or absent.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import zstandard
from mcap.exceptions import McapError
from mcap.records import Attachment, Channel, Chunk, Footer, Header, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk

from cell.errors import DecodeError

MAX_RECORD = 256 * 1024 * 1024
"""Most bytes of one record, packed or not."""
_MOST_NAMES = 10_000
_BROKEN = (McapError, zstandard.ZstdError, struct.error, ValueError, EOFError, KeyError, OverflowError)


@dataclass(frozen=True)
class Recorded:
    """A message. topic and ROS type; t: log time [ns]; payload: CDR bytes."""

    topic: str
    ros_type: str
    t: int
    sequence: int
    payload: bytes


class Recording:
    """An MCAP file.

    Attributes:
        profile: of the file's header. finished: the file has its end; known after reading all of it.
        problem: what made the reading end early; empty if nothing did.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.profile = ""
        self.finished = False
        self.problem = ""

    def items(self, topics: frozenset[str] | None = None) -> Iterator[Recorded | Metadata | Attachment]:
        """Metadata, attachments and messages in the file's order.

        Args:
            topics: messages of others are left out.

        Raises:
            DecodeError: the file cannot be opened or is no MCAP file.
        """
        self.finished, self.problem = False, ""
        try:
            file = self.path.open("rb")
        except OSError as error:
            raise DecodeError(f"cannot read {self.path}: {error.strerror}") from None
        with file:
            records = self._records(file)
            try:
                first = next(records, None)
            except _BROKEN as error:
                raise DecodeError(f"{self.path} is no MCAP recording: {_line(error)}") from None
            if not isinstance(first, Header):
                raise DecodeError(f"{self.path} is no MCAP recording: it does not start with a header")
            self.profile = first.profile
            yield from self._until_broken(records, topics)

    def _until_broken(
        self, records: Iterator[Any], topics: frozenset[str] | None
    ) -> Iterator[Recorded | Metadata | Attachment]:
        schemas: dict[int, str] = {}
        channels: dict[int, Channel] = {}
        while True:
            try:
                record = next(records, None)
            except _BROKEN as error:
                self.problem = _line(error)
                return
            if record is None:
                return
            if isinstance(record, Footer):
                self.finished = True
            elif isinstance(record, Metadata | Attachment):
                yield record
            elif isinstance(record, Schema) and len(schemas) < _MOST_NAMES:
                schemas[record.id] = record.name
            elif isinstance(record, Channel) and len(channels) < _MOST_NAMES:
                channels[record.id] = record
            elif isinstance(record, Message):
                channel = channels.get(record.channel_id)
                if channel is not None and (topics is None or channel.topic in topics):
                    kind = schemas.get(channel.schema_id, "")
                    yield Recorded(channel.topic, kind, record.log_time, record.sequence, record.data)

    def _records(self, file: IO[bytes]) -> Iterator[Any]:
        """The file's records with chunks unpacked."""
        bounded: Any = _Bounded(file)
        for record in StreamReader(bounded, emit_chunks=True, record_size_limit=MAX_RECORD).records:
            if not isinstance(record, Chunk):
                yield record
                continue
            size = record.uncompressed_size
            if record.compression == "zstd":
                size = max(size, zstandard.get_frame_parameters(record.data).content_size)
            if size > MAX_RECORD or record.compression not in ("zstd", ""):
                raise ValueError(f"a chunk of {size} bytes with compression {record.compression[:20]!r}")
            yield from breakup_chunk(record, validate_crc=True)


class _Bounded:
    """A file of which no more than `MAX_RECORD` bytes are read at once, whatever a length field says."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file

    def read(self, n: int) -> bytes:
        return self._file.read(min(n, MAX_RECORD))


def _line(error: BaseException) -> str:
    return " ".join((str(error) or type(error).__name__).split())[:200]
