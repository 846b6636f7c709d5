"""The records of an MCAP file, in order, whatever was damaged among them.

MCAP's own reader ends at the first damaged byte. Chunks have checksums of their own, so here the
reading goes on with the next whole one. Memory is needed for one record at a time.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from io import BytesIO
from os import SEEK_END
from typing import IO, Final

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
    MessageIndex,
    Metadata,
    Schema,
    Statistics,
)
from mcap.stream_reader import breakup_chunk

MAGIC: Final = b"\x89MCAP0\r\n"

LARGEST: Final = 256 * 2**20
"""Bytes of the largest record that is read: a damaged length asks for no more memory."""

WINDOW: Final = 2**20
"""Bytes that are searched at once for the next chunk."""

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

_SKIPPED: Final = {*Opcode, *range(0x80, 0x100)} - {*_READ, Opcode.MESSAGE}
"""Records after the last chunk that say nothing of messages, and what others may have added."""


IN_A_ROW: Final = 3
"""So many whole records show that the reading goes on at the right place."""


def records(stream: IO[bytes]) -> Iterator[McapRecord | None]:
    """Its records, those in chunks among them; None where damaged bytes were skipped.

    The last one is a Footer, unless the file was cut short.
    """
    at = stream.tell()
    size = stream.seek(0, SEEK_END)
    while at < size:
        try:
            found, end = _record(stream, at, size)
        except Exception:  # whatever the decoders make of damaged bytes
            after = _after(stream, at, size)
            yield None
            if after is None:
                return
            at = after
            continue
        yield from found
        if any(isinstance(record, Footer) for record in found):
            return
        at = end


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


def _record(stream: IO[bytes], at: int, size: int) -> tuple[list[McapRecord], int]:
    """The record at a place, unpacked if it is a chunk, and where it ends. Raises if damaged."""
    opcode, length, end = _head(stream, at, size)
    if opcode in _SKIPPED:
        return [], end
    body = ReadDataStream(BytesIO(stream.read(length)))
    record = _READ[opcode](body)
    if body.count != length:
        raise ValueError("its length is wrong")
    if not isinstance(record, Chunk):
        return [record], end
    return breakup_chunk(_unpacked(record), validate_crc=True), end


def _unpacked(chunk: Chunk) -> Chunk:
    """The chunk without compression. Raises if it holds more than it declares, before it is read.

    What a damaged or crafted chunk declares binds no decompressor: 13 kB may hold gigabytes.
    """
    size, data = chunk.uncompressed_size, chunk.data
    if size > LARGEST:
        raise ValueError("too large")
    if chunk.compression == "zstd":
        if zstandard.frame_content_size(data) not in (-1, size):
            raise ValueError("its size is wrong")
        data = zstandard.ZstdDecompressor().decompress(data, max_output_size=size)
    elif chunk.compression == "lz4":
        data = LZ4FrameDecompressor().decompress(data, max_length=size + 1)
    if len(data) != size or data[:1] == b"\0":
        raise ValueError("its contents are wrong")
    return replace(chunk, compression="", data=data)


def _head(stream: IO[bytes], at: int, size: int) -> tuple[int, int, int]:
    """What a record is, its length, and where it ends. Raises ValueError if it does not fit."""
    stream.seek(at)
    head = stream.read(_HEAD.size)
    if len(head) < _HEAD.size:
        raise ValueError("cut short")
    opcode, length = _HEAD.unpack(head)
    end = at + _HEAD.size + length
    if end > size or (length > LARGEST and opcode not in _SKIPPED):
        raise ValueError("too long")
    return opcode, length, end


def _after(stream: IO[bytes], at: int, size: int) -> int | None:
    """Where it goes on after a damaged record: where that ends, or with the next whole chunk."""
    with suppress(Exception):
        _, _, end = _head(stream, at, size)
        _whole(stream, end, size)
        return end
    while (found := _search(stream, at + 1)) is not None:
        with suppress(Exception):
            opcode, _, _ = _head(stream, found, size)
            if opcode == Opcode.CHUNK:  # which has a checksum
                _record(stream, found, size)
            else:
                _whole(stream, found, size)
            return found
        at = found
    return None


def _whole(stream: IO[bytes], at: int, size: int) -> None:
    """Look whether several records in a row are whole from a place on. Raises if not."""
    for _ in range(IN_A_ROW):
        if at < size - len(MAGIC):  # which ends the file, too
            _, at = _record(stream, at, size)


def _search(stream: IO[bytes], at: int) -> int | None:
    """Where something begins as a chunk or the end does, from a place on."""
    while True:
        stream.seek(at)
        window = stream.read(WINDOW)
        if (found := _AGAIN.search(window)) is not None:
            return at + found.start()
        if len(window) < WINDOW:
            return None
        at += WINDOW - _LONGEST_MATCH
