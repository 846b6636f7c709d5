"""The records of an MCAP file with their places, up to its end or the first damaged byte.

The readers of `mcap` do not state places, and take a file's tail of zeros, as after a loss of
power, for millions of empty records.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Iterator
from io import BytesIO
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import Final, NamedTuple, cast

from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Footer, McapRecord, Message, Metadata, Schema, Statistics
from mcap.stream_reader import breakup_chunk

MAGIC: Final = b"\x89MCAP0\r\n"

# Largest record that is read, bytes: limits the memory that a damaged length can claim.
LARGEST: Final = 256 * 2**20

_HEAD: Final = struct.Struct("<BQ")  # of a record: opcode, and length without this head

_READ: Final[dict[int, Callable[[ReadDataStream], McapRecord]]] = {
    Opcode.SCHEMA: Schema.read,
    Opcode.CHANNEL: Channel.read,
    Opcode.METADATA: Metadata.read,
    Opcode.STATISTICS: Statistics.read,
    Opcode.FOOTER: Footer.read,
}


class Place(NamedTuple):
    """Where a record is."""

    path: Path
    at: int  # offset of the record or of its chunk in the file
    number: int  # in that chunk


def records(path: Path) -> Iterator[tuple[McapRecord, Place]]:
    """The records up to the footer, including those in chunks; one chunk is in memory.

    Raises EndOfFile where the file ends before its footer, other errors of any kind where it is
    damaged, and OSError.
    """
    with path.open("rb") as stream:
        at = stream.seek(len(MAGIC))
        while len(head := stream.read(_HEAD.size)) == _HEAD.size:
            opcode, length = _HEAD.unpack(head)
            if opcode == 0 or length > LARGEST:
                raise McapError(f"no record begins at byte {at}")
            if len(body := stream.read(length)) < length:
                break
            for number, record in enumerate(_parsed(opcode, body)):
                yield record, Place(path, at, number)
            if opcode == Opcode.FOOTER:
                return
            at = stream.tell()
    raise EndOfFile(f"the file ends at byte {at}")


def _parsed(opcode: int, body: bytes) -> list[McapRecord]:
    """A record, or those in a chunk; empty for kinds that are not used."""
    data = ReadDataStream(BytesIO(body))
    if opcode == Opcode.CHUNK:
        chunk = Chunk.read(data)
        if chunk.uncompressed_size > LARGEST:  # it would take that much memory
            raise ValueError(f"a chunk of {chunk.uncompressed_size} bytes")
        return breakup_chunk(chunk, validate_crc=True)
    if opcode == Opcode.MESSAGE:
        return [Message.read(data, len(body))]
    return [_READ[opcode](data)] if opcode in _READ else []


def payloads(places: Iterable[Place]) -> Iterator[bytes]:
    """The payloads of messages; one chunk is in memory at a time.

    Raises ValueError if a file has changed, and OSError.
    """
    for (path, at), those in groupby(places, key=attrgetter("path", "at")):
        numbers = [place.number for place in those]
        try:
            with path.open("rb") as stream:
                stream.seek(at)
                opcode, length = _HEAD.unpack(stream.read(_HEAD.size))
                found = _parsed(opcode, stream.read(min(length, LARGEST)))
            kept = [cast("Message", found[number]).data for number in numbers]
        except OSError:
            raise
        except Exception as error:  # decoders can raise anything on changed bytes
            raise ValueError(f"{path} has changed: {error}") from None
        yield from kept
