"""Recordings read back: every message in order, and the agents' journals.

The one reader: whoever turns a recording into something else, explains it or goes through it again
begins here. A file that was cut short, by a kill or a full disk, is read as far as it goes.
"""

from __future__ import annotations

import json
import mmap
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Final, cast

from msgspec import Struct

from armadico.core import messages
from armadico.core.messages import PROTOCOL, Message
from armadico.observe.journals import JOURNAL, Journal, Pieces, without
from armadico.observe.recorder import PROFILE, SCHEMA_PREFIX, Here, part
from armadico.observe.watching import from_object

if TYPE_CHECKING:
    from mcap.records import Channel, Schema

KINDS: Final[dict[str, type[Struct]]] = {
    SCHEMA_PREFIX + kind.__name__: kind
    for kind in (*vars(messages).values(), Here)
    if isinstance(kind, type) and (issubclass(kind, Message) or kind is Here)
}
"""The types that a schema's name stands for."""

HERE: Final = SCHEMA_PREFIX + Here.__name__

Warn = Callable[[str], None]


class RecordingError(ValueError):
    """A file that is no recording."""


@dataclass(frozen=True, slots=True)
class Row:
    """One message of a recording; `t` is when it was received, ns since 1970."""

    t: int
    namespace: str
    key: str
    schema: str  # such as "armadico.Pose"; empty for a payload that is no known message
    data: bytes  # JSON if there is a schema, else as it was sent

    @property
    def topic(self) -> str:
        """The topic in the file."""
        return f"/{self.namespace}/{self.key}"

    @property
    def fields(self) -> dict[str, Any]:
        """The message by field names; empty if it is no known message."""
        found: dict[str, Any] = json.loads(self.data) if self.schema else {}
        return found

    @property
    def message(self) -> Message | None:
        """The message; None for what is none. Raises MessageError if it does not fit its type."""
        kind = KINDS.get(self.schema)
        if kind is None or not issubclass(kind, Message):
            return None
        return from_object(kind, self.fields)


def rows(path: Path, warn: Warn, about: dict[str, str] | None = None) -> Iterator[Row]:
    """The messages of a file in the order they were received; `warn` is told if it is cut short.

    `about` is filled with what the file says of itself, before the first of them.

    Raises RecordingError if the file is no recording, and OSError.
    """
    from mcap.exceptions import InvalidMagic  # noqa: PLC0415 - an extra

    read = 0
    with path.open("rb") as stream:
        if path.stat().st_size == 0:
            raise RecordingError(f"{path} is empty")
        # Mapped, a length that is damaged asks for no more memory than there is file.
        with mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
            try:
                for row in _decoded(data, {} if about is None else about):
                    read += 1
                    yield row
            except InvalidMagic:
                if read == 0:
                    raise RecordingError(f"{path} is no MCAP file") from None
                warn(f"{path} was cut short: {read} messages could be read")
            except Exception:  # whatever the decoders make of damaged bytes
                warn(f"{path} was cut short: {read} messages could be read")


def _decoded(data: mmap.mmap, about: dict[str, str]) -> Iterator[Row]:
    from mcap.records import (  # noqa: PLC0415 - an extra
        Channel,
        Message,
        Metadata,
        Schema,
        Statistics,
    )
    from mcap.stream_reader import StreamReader  # noqa: PLC0415 - an extra

    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    read = 0
    for record in StreamReader(cast("IO[bytes]", data), validate_crcs=True).records:
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            channels[record.id] = record
        elif isinstance(record, Metadata) and record.name == PROFILE:
            about.update(record.metadata)
        elif isinstance(record, Statistics) and record.message_count != read:
            raise RecordingError("a chunk is missing")
        elif isinstance(record, Message):
            read += 1
            channel = channels[record.channel_id]
            schema = schemas.get(channel.schema_id)
            if schema is None or schema.name.startswith(SCHEMA_PREFIX):  # no translator's
                yield _row(channel, schema, record.log_time, record.data)


def _row(channel: Channel, schema: Schema | None, t: int, data: bytes) -> Row:
    topic = channel.topic.strip("/")
    namespace = channel.metadata.get("namespace", topic.partition("/")[0])
    key = channel.metadata.get("key", topic.partition("/")[2])
    name = schema.name if schema is not None and channel.message_encoding == "json" else ""
    return Row(t, namespace, key, name, data)


class Past:
    """A recording, with all its files: what was said, and the journals of who kept one."""

    def __init__(self, path: Path, warn: Warn) -> None:
        """Nothing is read yet but that the file is there.

        Args:
            path: The file, or the first of several.
            warn: Told of what was cut short.

        Raises RecordingError and OSError.
        """
        self.path = path
        self.about: dict[str, str] = {}
        self.damage: list[str] = []
        """What could not be read of it, by whatever has gone through its messages so far."""
        self._warn = warn
        first = next(rows(path, lambda _: None, self.about), None)
        self.began = 0.0 if first is None else first.t / 1e9  # s since 1970

    @property
    def paths(self) -> list[Path]:
        """Its files, in order."""
        further = (part(self.path, number) for number in count(1))
        found = [self.path]
        for path in further:
            if not path.is_file():
                return found
            found.append(path)
        raise AssertionError("there are not endless files")

    def check(self) -> None:
        """Raises RecordingError if those who are in it spoke otherwise than this program."""
        spoken = self.about.get("protocol", "")
        if spoken != str(PROTOCOL):
            raise RecordingError(
                f"{self.path} was recorded with protocol {spoken or 'unknown'}; this program"
                f" speaks {PROTOCOL}: `pip install` the version that recorded it,"
                f" {self.about.get('version', 'whichever that was')}"
            )

    def rows(self) -> Iterator[Row]:
        """All messages in the order they were received. Raises RecordingError and OSError."""
        self.damage = []
        for path in self.paths:
            yield from rows(path, self._damaged)

    def _damaged(self, text: str) -> None:
        self.damage.append(text)
        self._warn(text)

    def journals(self) -> list[Journal]:
        """The journals of all agents that were there, as far as the recording has them.

        Of who was there and kept none the journal is empty, and its fault says so.
        """
        pieces, there = Pieces(), set()
        for row in self.rows():
            if row.key.startswith(JOURNAL) and not row.schema:
                pieces.take(row.namespace, row.data, row.t)
            elif row.schema == HERE:
                there.add((row.namespace, row.fields["instance"]))
        found = pieces.journals()
        kept = {(journal.namespace, journal.instance) for journal in found}
        return found + [without(*who) for who in sorted(there - kept)]
