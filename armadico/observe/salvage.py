"""The records of an MCAP file, in order, whatever was damaged among them.

MCAP's own reader ends at the first damaged byte. Chunks have checksums of their own, so here the
reading goes on with the next whole one. Memory is needed for one record at a time.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from io import BytesIO
from os import SEEK_END
from typing import IO, Final, TypeVar

import zstandard
from lz4.frame import LZ4FrameDecompressor
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import (
    Channel,
    Chunk,
    Footer,
    Header,
    McapRecord,
    Message,
    MessageIndex,
    Metadata,
    Schema,
    Statistics,
)

T = TypeVar("T")

MAGIC: Final = b"\x89MCAP0\r\n"

LARGEST: Final = 256 * 2**20
"""Bytes of the largest record that is read: a damaged length asks for no more memory."""

DENSEST: Final = 250
"""A chunk that holds more than so many times its own bytes is damaged: recordings hold up to 10."""

FAILING: Final = 64
"""So many times the size of a file are read and unpacked in vain, before its rest is left out. Else
bytes that look like the beginnings of many chunks cost time by the square of their number."""

AT_LEAST: Final = 64 * 2**20
"""The same for a small file, bytes."""

WINDOW: Final = 2**20
"""Bytes that are searched at once for the next chunk at the most,"""

FIRST_WINDOW: Final = 2**10
"""and at first: where chunks are small and near, little is read twice."""

_HEAD: Final = struct.Struct("<BQ")
"""Of a record: what it is, and its length without this."""

_AGAIN: Final = re.compile(rb"\x06.{36}(?:\x04\0\0\0zstd|\x03\0\0\0lz4)|\x0f\x04\0{7}", re.DOTALL)
"""How a compressed chunk begins, or what ends the messages: where the reading may go on."""

_LONGEST_MATCH: Final = 45

_READ: Final[dict[int, Callable[[ReadDataStream], McapRecord]]] = {
    Opcode.HEADER: Header.read,
    Opcode.FOOTER: Footer.read,
    Opcode.SCHEMA: Schema.read,
    Opcode.CHANNEL: Channel.read,
    Opcode.CHUNK: Chunk.read,
    Opcode.MESSAGE_INDEX: MessageIndex.read,
    Opcode.STATISTICS: Statistics.read,
    Opcode.METADATA: Metadata.read,
}

_IN_CHUNKS: Final = {Opcode.SCHEMA, Opcode.CHANNEL}
"""Besides messages."""

_SKIPPED: Final = {*Opcode, *range(0x80, 0x100)} - {*_READ, Opcode.MESSAGE}
"""Records after the last chunk that say nothing of messages, and what others may have added."""


IN_A_ROW: Final = 3
"""So many whole records show that the reading goes on at the right place."""

Place = tuple[int, int]
"""Where a message is: where its chunk begins in the file, and where it begins in that chunk."""


def records(stream: IO[bytes]) -> Iterator[tuple[McapRecord | None, Place]]:
    """Its records with their places, those in chunks among them; None where bytes were skipped.

    The last one is a Footer, unless the file was cut short. The work is linear in the file's size,
    whatever stands in it.
    """
    at, file = stream.tell(), _File(stream)
    while at < file.size:
        found = file.tried(partial(file.record, at))
        if found is None:
            yield None, (at, 0)
            if (after := file.after(at)) is None:
                return
            at = after
            continue
        for record, offset in found[0]:
            yield record, (at, offset)
            if isinstance(record, Footer):
                return
        at = found[1]


class Messages:
    """Reads messages again, by the places that `records` gave; one chunk is in memory at a time."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._file = _File(stream)
        self._at = -1
        self._contents = b""

    def read(self, place: Place) -> bytes:
        """What a message carries. Raises ValueError, or another error, if the file has changed."""
        at, offset = place
        if at != self._at:
            self._at, self._contents = at, self._file.contents(at)
        opcode, length = _HEAD.unpack_from(self._contents, offset)
        if opcode != Opcode.MESSAGE:
            raise ValueError("no message begins there")
        body = ReadDataStream(BytesIO(self._contents[offset + _HEAD.size :][:length]))
        data: bytes = Message.read(body, length).data
        return data


def described(stream: IO[bytes]) -> list[McapRecord]:
    """What a file's end says of its schemas, channels and metadata; nothing if that is damaged."""
    found: list[McapRecord] = []
    with suppress(Exception):  # whatever the decoders make of damaged bytes
        stream.seek(0)
        reader = SeekingReader(stream, record_size_limit=LARGEST)
        if (summary := reader.get_summary()) is not None:
            found += [*summary.schemas.values(), *summary.channels.values()]
        found += reader.iter_metadata()
    return found


class _File:
    """A file that may be damaged, and how much work may still be done on it in vain."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream = stream
        self.size = stream.seek(0, SEEK_END)
        self._spare = FAILING * self.size + AT_LEAST  # bytes

    def tried(self, attempt: Callable[[], T]) -> T | None:
        """What comes of an attempt; None if that fails, as all do once too much was in vain."""
        if self._spare <= 0:
            return None
        before = self._spare
        with suppress(Exception):  # whatever the decoders make of damaged bytes
            found = attempt()
            self._spare = before
            return found
        return None

    def record(self, at: int) -> tuple[list[tuple[McapRecord, int]], int]:
        """The record at a place, or those of a chunk and where each begins in it; where it ends.

        Raises if damaged.
        """
        opcode, length, end = self._head(at)
        if opcode in _SKIPPED:
            return [], end
        if opcode == Opcode.CHUNK:
            return list(_within(self._contents(length))), end
        body = ReadDataStream(BytesIO(self._read(length)))
        record = _READ[opcode](body)
        if body.count != length:
            raise ValueError("its length is wrong")
        return [(record, 0)], end

    def contents(self, at: int) -> bytes:
        """What the chunk at a place holds. Raises if damaged."""
        opcode, length, _ = self._head(at)
        if opcode != Opcode.CHUNK:
            raise ValueError("no chunk begins there")
        return self._contents(length)

    def after(self, at: int) -> int | None:
        """Where it goes on after a damaged record: where that ends, or with the next chunk."""
        found = self.tried(partial(self._goes_on, at))
        while found is None and self._spare > 0 and (at := self._search(at + 1)) >= 0:
            found = self.tried(partial(self._sound, at))
        return found

    def _goes_on(self, at: int) -> int:
        _, _, end = self._head(at)
        self._whole(end)
        return end

    def _sound(self, at: int) -> int:
        opcode, _, _ = self._head(at)
        if opcode == Opcode.CHUNK:  # which has a checksum
            self.record(at)
        else:
            self._whole(at)
        return at

    def _whole(self, at: int) -> None:
        """Look whether several records in a row are whole from a place on. Raises if not."""
        for _ in range(IN_A_ROW):
            if at < self.size - len(MAGIC):  # which ends the file, too
                _, at = self.record(at)

    def _head(self, at: int) -> tuple[int, int, int]:
        """What a record is, its length, and where it ends. Raises ValueError if it is too long."""
        self._stream.seek(at)
        head = self._read(_HEAD.size)
        if len(head) < _HEAD.size:
            raise ValueError("cut short")
        opcode, length = _HEAD.unpack(head)
        end = at + _HEAD.size + length
        if end > self.size or (length > LARGEST and opcode not in _SKIPPED):
            raise ValueError("too long")
        return opcode, length, end

    def _contents(self, length: int) -> bytes:
        body = ReadDataStream(BytesIO(self._read(length)))
        chunk = Chunk.read(body)
        if body.count != length:
            raise ValueError("its length is wrong")
        if chunk.uncompressed_size <= DENSEST * len(chunk.data):  # else it is not unpacked
            self._spare -= chunk.uncompressed_size
        return _unpacked(chunk)

    def _read(self, length: int) -> bytes:
        self._spare -= length
        return self._stream.read(length)

    def _search(self, at: int) -> int:
        """Where something begins as a chunk or the end does, from a place on; -1: nowhere."""
        size = FIRST_WINDOW
        while True:
            self._stream.seek(at)
            window = self._stream.read(size)
            if (found := _AGAIN.search(window)) is not None:
                return at + found.start()
            if len(window) < size:
                return -1
            at += size - _LONGEST_MATCH
            size = min(2 * size, WINDOW)


def _within(contents: bytes) -> Iterator[tuple[McapRecord, int]]:
    """The records of a chunk, and where each begins. Raises if one is damaged."""
    stream = ReadDataStream(BytesIO(contents))
    while (offset := stream.count) < len(contents):
        opcode, length = stream.read1(), stream.read8()
        if opcode == Opcode.MESSAGE:
            yield Message.read(stream, length), offset
        elif opcode in _IN_CHUNKS:
            yield _READ[opcode](stream), offset
        else:
            stream.read(length)


def _unpacked(chunk: Chunk) -> bytes:
    """What a chunk holds. Raises if that is more than it declares, before it is read.

    What a damaged or crafted chunk declares binds no decompressor: 13 kB may hold gigabytes.
    """
    size, data = chunk.uncompressed_size, chunk.data
    if size > min(LARGEST, DENSEST * len(data)):
        raise ValueError("too large")
    if chunk.compression == "zstd":
        if zstandard.frame_content_size(data) not in (-1, size):
            raise ValueError("its size is wrong")
        data = zstandard.ZstdDecompressor().decompress(data, max_output_size=size)
    elif chunk.compression == "lz4":
        data = LZ4FrameDecompressor().decompress(data, max_length=size + 1)
    if len(data) != size or data[:1] == b"\0":
        raise ValueError("its contents are wrong")
    if chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise ValueError("its checksum is wrong")
    return data
