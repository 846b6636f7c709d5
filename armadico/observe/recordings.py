"""Recordings read back: every message in order, and the agents' journals.

The one reader: whoever turns a recording into something else, explains it or goes through it again
begins here. A file that was cut short, by a kill or a full disk, is read as far as it goes; of a
damaged one all whole chunks are read.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from itertools import count, groupby
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from msgspec import Struct

from armadico.core.messages import (
    PROTOCOL,
    BidHistory,
    BidRecord,
    JournalPiece,
    Message,
    MessageError,
    decode,
)
from armadico.core.services import message_types
from armadico.observe.journals import JOURNAL, Journal, Pieces, without
from armadico.observe.recorder import PROFILE, REFUSED, SCHEMA_PREFIX, Here, part
from armadico.observe.watching import from_object

if TYPE_CHECKING:
    from mcap.records import Channel, Schema


@cache
def kinds() -> dict[str, type[Struct]]:
    """The types that the names of schemas stand for: every message that is installed."""
    types: tuple[type[Struct], ...] = (*message_types(), Here)
    return {SCHEMA_PREFIX + kind.__name__: kind for kind in types}


HERE: Final = SCHEMA_PREFIX + Here.__name__

Warn = Callable[[str], None]


class RecordingError(ValueError):
    """A file that is no recording."""


Stored = tuple[Path, tuple[int, int]]
"""Where a message is: in which file, and `salvage.Place`."""


def stored(places: Iterable[Stored]) -> Iterator[bytes]:
    """What some messages of recordings carry, read again; one chunk is in memory at a time.

    Raises ValueError if a file is not as it was any more, and OSError.
    """
    from armadico.observe.salvage import Messages

    for path, those in groupby(places, key=itemgetter(0)):
        with path.open("rb") as stream:
            messages = Messages(stream)
            for _, place in those:
                try:
                    yield messages.read(place)
                except OSError:
                    raise
                except Exception as error:  # whatever the decoders make of other bytes
                    raise ValueError(f"{path} has changed: {error}") from None


@dataclass(frozen=True, slots=True)
class Row:
    """One message of a recording; `t` is when it was received, ns since 1970."""

    t: int
    namespace: str
    key: str
    schema: str  # such as "armadico.Pose"; empty for a payload that is no known message
    data: bytes  # JSON if there is a schema, else as it was sent
    place: Stored  # where that is

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
        kind = kinds().get(self.schema)
        if kind is None or not issubclass(kind, Message):
            return None
        return from_object(kind, self.fields)

    @property
    def received(self) -> Message | None:
        """The message as a watcher received it, a bid within a history; None: it cannot be read."""
        if self.key.endswith(REFUSED):
            return None
        try:
            message = self.message
        except MessageError:
            return None
        if isinstance(message, BidRecord):
            return BidHistory(self.key.split("/")[2], (message,))
        return message


def rows(path: Path, warn: Warn, about: dict[str, str] | None = None) -> Iterator[Row]:
    """The messages of a file in the order they were received.

    What is damaged is skipped, up to the next whole chunk, and `warn` is told what is missing, in s
    from the first message. Memory is needed for one chunk at a time. `about` is filled with what
    the file says of itself, before the first message.

    Raises RecordingError if the file is no recording, and OSError.
    """
    from mcap.records import (
        Channel,
        Footer,
        Message,
        Metadata,
        Schema,
        Statistics,
    )

    from armadico.observe.salvage import MAGIC, described, records

    damage, schemas, channels = _Damage(path, warn), dict[int, Schema](), dict[int, Channel]()
    with path.open("rb") as stream:
        if (start := stream.read(len(MAGIC))) != MAGIC:
            what = "was cut short in its first bytes" if start else "is empty"
            raise RecordingError(f"{path} {what if MAGIC.startswith(start) else 'is no MCAP file'}")
        for record, place in records(stream):
            kept = [] if record is None else [record]
            lacks = isinstance(record, Message) and record.channel_id not in channels
            if record is None or (lacks and not damage.found):
                damage.skipped()
                with path.open("rb") as again:
                    kept = described(again)  # what was skipped may be there, too
            for one in kept:
                if isinstance(one, Schema):
                    schemas[one.id] = one
                elif isinstance(one, Channel):
                    channels[one.id] = one
                elif isinstance(one, Metadata) and one.name == PROFILE and about is not None:
                    about.update(one.metadata)
            if isinstance(record, Message) and record.channel_id in channels:
                damage.read(record.log_time)
                channel = channels[record.channel_id]
                schema = schemas.get(channel.schema_id)
                if schema is None or schema.name.startswith(SCHEMA_PREFIX):  # no translator's
                    yield _row(channel, schema, record.log_time, record.data, (path, place))
            elif isinstance(record, Statistics):
                damage.counted(record.message_count)
            elif isinstance(record, Footer):
                damage.whole = True
    damage.finish()


class _Damage:
    """Reports what is missing in a file."""

    def __init__(self, path: Path, warn: Warn) -> None:
        self.whole = False  # whether its end was read
        self.found = False  # whether something was skipped
        self._path, self._warn = path, warn
        self._messages = self._first = self._last = 0  # times in ns since 1970
        self._gap = False
        self._missing: int | None = None

    def read(self, t: int) -> None:
        self._first = self._first if self._messages else t
        if self._gap:
            self._gap = False
            between = f"between {self._seconds(self._last)} and {self._seconds(t)}"
            where = f": messages {between} are missing" if self._messages else " at its beginning"
            self._warn(f"{self._path} is damaged{where}")
        self._messages, self._last = self._messages + 1, t

    def skipped(self) -> None:
        self._gap = self.found = True

    def counted(self, messages: int) -> None:
        """The file says how many messages it holds."""
        self._missing = messages - self._messages

    def finish(self) -> None:
        """The end of what can be read has come."""
        read = f"{self._messages} messages could be read"
        until = f", up to {self._seconds(self._last)}" if self._messages else ""
        if not self.whole:
            self._warn(f"{self._path} was cut short: {read}{until}")
        elif self._missing:
            self._warn(f"{self._path} is damaged: {read}, {self._missing} could not")
        elif self._gap or self._missing is None:
            self._warn(f"{self._path} is damaged near its end: {read}{until}")

    def _seconds(self, t: int) -> str:
        return f"{(t - self._first) / 1e9:.1f} s"


def _row(channel: Channel, schema: Schema | None, t: int, data: bytes, place: Stored) -> Row:
    topic = channel.topic.strip("/")
    namespace = channel.metadata.get("namespace", topic.partition("/")[0])
    key = channel.metadata.get("key", topic.partition("/")[2])
    name = schema.name if schema is not None and channel.message_encoding == "json" else ""
    return Row(t, namespace, key, name, data, place)


def _read_pieces(places: Iterable[Stored]) -> Iterator[bytes]:
    """What some pieces of journals hold, in that order. Raises ValueError and OSError."""
    for data in stored(places):
        yield decode(data, JournalPiece).data


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
        spoken = self.about.get("protocol")
        if spoken is None:
            raise RecordingError(
                f"{self.path} does not say which protocol was spoken: another program wrote it, or"
                " its beginning is missing; `armadico record` and `armadico run --record` write"
                " recordings"
            )
        if spoken != str(PROTOCOL):
            version = self.about.get("version", "")
            raise RecordingError(
                f"{self.path} was recorded with protocol {spoken}; this program speaks {PROTOCOL}:"
                f" `pip install` the version that recorded it{', ' * bool(version)}{version}"
            )

    def rows(self) -> Iterator[Row]:
        """All messages in the order they were received. Raises RecordingError and OSError."""
        self.damage = []
        for path in self.paths:
            yield from rows(path, self._damaged)

    def _damaged(self, text: str) -> None:
        self.damage.append(text)
        self._warn(text)

    def journals(self, instances: Collection[str] | None = None) -> list[Journal]:
        """The journals of these agents, or of all that were there, as far as they were recorded.

        Of who was there and kept none the journal is empty, and its fault says so. What they hold
        stays in the file, and is read there again each time that it is gone through.
        """
        pieces, there = Pieces(_read_pieces), set()
        for row in self.rows():
            if row.key.startswith(JOURNAL) and not row.schema:
                if instances is None or row.key.removeprefix(JOURNAL) in instances:
                    pieces.add(row.namespace, row.data, row.t, row.place)
            elif row.schema == HERE and (instances is None or row.fields["instance"] in instances):
                there.add((row.namespace, row.fields["instance"]))
        found = pieces.journals()
        kept = {(journal.namespace, journal.instance) for journal in found}
        return found + [without(*who) for who in sorted(there - kept)]
