"""The records of an MCAP file in order, also if parts are damaged.

MCAP's own reader ends at the first damaged byte. Chunks have checksums, so this reader continues
with the next intact chunk. One record is in memory at a time.
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

# Largest record that is read, bytes: limits the memory that a damaged length can claim.
LARGEST: Final = 256 * 2**20

# A chunk with a larger compression ratio counts as damaged: recordings have up to 10.
DENSEST: Final = 250

# Budget of bytes read and unpacked in vain, as a multiple of the file's size; then the rest of the
# file is skipped. Without it, bytes that resemble many chunks would cost quadratic time.
FAILING: Final = 64
AT_LEAST: Final = 64 * 2**20  # smallest budget, bytes

# Bytes searched at once for the next chunk: at most, and at first. The window grows, so little is
# read twice where chunks are small and close.
WINDOW: Final = 2**20
FIRST_WINDOW: Final = 2**10

_HEAD: Final = struct.Struct("<BQ")  # of a record: opcode, and length without this head

# The beginning of a compressed chunk, or of the record that ends the messages: reading can go on.
_AGAIN: Final = re.compile(rb"\x06.{36}(?:\x04\0\0\0zstd|\x03\0\0\0lz4)|\x0f\x04\0{7}", re.DOTALL)
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

_IN_CHUNKS: Final = {Opcode.SCHEMA, Opcode.CHANNEL}  # besides messages

# Records after the last chunk that do not describe messages, and private records.
_SKIPPED: Final = {*Opcode, *range(0x80, 0x100)} - {*_READ, Opcode.MESSAGE}

IN_A_ROW: Final = 3  # intact records that confirm a place at which reading continues

Place = tuple[int, int]  # offset of a message's chunk in the file, offset in the unpacked chunk


def records(stream: IO[bytes]) -> Iterator[tuple[McapRecord | None, Place]]:
    """The records with their places, including those in chunks; None where bytes were skipped.

    The last record is a Footer, unless the file is incomplete. The work is linear in the file's
    size, whatever its content.
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


def beginning(stream: IO[bytes], at: int) -> Iterator[McapRecord]:
    """The whole records of a chunk that the end of the file cuts; they have no checksum.

    Raises an error of any kind where they end.
    """
    stream.seek(at)
    opcode, length = _HEAD.unpack(stream.read(_HEAD.size))
    data = stream.read(LARGEST)
    if opcode != Opcode.CHUNK or len(data) >= length:
        return
    body = ReadDataStream(BytesIO(data))
    body.read(2 * 8)  # times
    size = min(body.read8(), LARGEST)
    body.read4()  # the checksum
    compression = body.read_prefixed_string()
    body.read8()
    packed = data[body.count :]
    if compression == "zstd":
        packed = zstandard.ZstdDecompressor().decompressobj().decompress(packed)
    elif compression == "lz4":
        packed = LZ4FrameDecompressor().decompress(packed, max_length=size)
    for record, offset in _within(packed[:size]):
        if offset + _HEAD.size + _HEAD.unpack_from(packed, offset)[1] > len(packed):
            return  # the cut is in it
        yield record


class Messages:
    """Reads messages at places from `records`; one chunk is in memory at a time."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._file = _File(stream)
        self._at = -1
        self._contents = b""

    def read(self, place: Place) -> bytes:
        """The payload of a message. Raises ValueError or another error if the file has changed."""
        at, offset = place
        if at != self._at:
            self._at, self._contents = at, self._file.contents(at)
        opcode, length = _HEAD.unpack_from(self._contents, offset)
        if opcode != Opcode.MESSAGE:
            raise ValueError(f"no message begins at byte {offset} of the chunk at {at}")
        body = ReadDataStream(BytesIO(self._contents[offset + _HEAD.size :][:length]))
        data: bytes = Message.read(body, length).data
        return data


def described(stream: IO[bytes]) -> list[McapRecord]:
    """Schemas, channels and metadata from the file's summary; empty if that is damaged."""
    found: list[McapRecord] = []
    with suppress(Exception):  # decoders can raise anything on damaged bytes
        stream.seek(0)
        reader = SeekingReader(stream, record_size_limit=LARGEST)
        if (summary := reader.get_summary()) is not None:
            found += [*summary.schemas.values(), *summary.channels.values()]
        found += reader.iter_metadata()
    return found


class _File:
    """A file that may be damaged, with the budget for failed attempts."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream = stream
        self.size = stream.seek(0, SEEK_END)
        self._spare = FAILING * self.size + AT_LEAST  # bytes

    def tried(self, attempt: Callable[[], T]) -> T | None:
        """The result of an attempt; None if it fails or the budget is used up."""
        if self._spare <= 0:
            return None
        before = self._spare
        with suppress(Exception):  # decoders can raise anything on damaged bytes
            found = attempt()
            self._spare = before
            return found
        return None

    def record(self, at: int) -> tuple[list[tuple[McapRecord, int]], int]:
        """The record at an offset, or the records of a chunk with their offsets; and its end.

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
            raise ValueError("a record's length is wrong")
        return [(record, 0)], end

    def contents(self, at: int) -> bytes:
        """The unpacked chunk at an offset. Raises if damaged."""
        opcode, length, _ = self._head(at)
        if opcode != Opcode.CHUNK:
            raise ValueError(f"no chunk begins at byte {at}")
        return self._contents(length)

    def after(self, at: int) -> int | None:
        """Where reading continues after a damaged record: at its end or the next chunk."""
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
        """Check that several records in a row are intact. Raises if not."""
        for _ in range(IN_A_ROW):
            if at < self.size - len(MAGIC):  # the magic ends the file too
                _, at = self.record(at)

    def _head(self, at: int) -> tuple[int, int, int]:
        """Opcode, length and end of a record. Raises ValueError if it is too long."""
        self._stream.seek(at)
        head = self._read(_HEAD.size)
        if len(head) < _HEAD.size:
            raise ValueError("a record is incomplete")
        opcode, length = _HEAD.unpack(head)
        end = at + _HEAD.size + length
        if end > self.size or (length > LARGEST and opcode not in _SKIPPED):
            raise ValueError("a record is too long")
        return opcode, length, end

    def _contents(self, length: int) -> bytes:
        body = ReadDataStream(BytesIO(self._read(length)))
        chunk = Chunk.read(body)
        if body.count != length:
            raise ValueError("a record's length is wrong")
        if chunk.uncompressed_size <= DENSEST * len(chunk.data):  # else it is not unpacked
            self._spare -= chunk.uncompressed_size
        return _unpacked(chunk)

    def _read(self, length: int) -> bytes:
        self._spare -= length
        return self._stream.read(length)

    def _search(self, at: int) -> int:
        """The next offset where bytes resemble a chunk or the end of the messages; -1: none."""
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
    """The records of a chunk and their offsets. Raises if one is damaged."""
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
    """The unpacked content of a chunk. Raises if it is larger than declared.

    The decompressors do not enforce the declared size: 13 kB may unpack to gigabytes.
    """
    size, data = chunk.uncompressed_size, chunk.data
    if size > min(LARGEST, DENSEST * len(data)):
        raise ValueError("a chunk is too large")
    if chunk.compression == "zstd":
        if zstandard.frame_content_size(data) not in (-1, size):
            raise ValueError("a chunk's size is wrong")
        data = zstandard.ZstdDecompressor().decompress(data, max_output_size=size)
    elif chunk.compression == "lz4":
        data = LZ4FrameDecompressor().decompress(data, max_length=size + 1)
    if len(data) != size or data[:1] == b"\0":
        raise ValueError("a chunk's content is wrong")
    if chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise ValueError("a chunk's checksum is wrong")
    return data
