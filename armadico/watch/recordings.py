"""Reading recordings: all messages in order, and the agents' journals.

All exports, explanations and replays use it. An incomplete file (recorder killed, disk full) is
read up to its end, a damaged one up to the damage.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Final

import msgspec
from msgspec import Struct

from armadico.core.changeable import differing
from armadico.core.messages import (
    OLDEST,
    PROTOCOL,
    BidHistory,
    BidRecord,
    JournalPiece,
    Message,
    MessageError,
    ParametersReply,
    Setting,
    TomlValue,
    decode,
    protocols,
)
from armadico.core.services import message_types
from armadico.observe.journals import JOURNAL, Journal, Pieces, without
from armadico.observe.jsons import JsonObject
from armadico.observe.watching import Presence, from_object
from armadico.watch.recorder import PROFILE, REFUSED, SCHEMA_PREFIX, Here, part

if TYPE_CHECKING:
    from mcap.records import Channel, Schema

    from armadico.watch.mcap_records import Place


@cache
def kinds() -> dict[str, type[Struct]]:
    """The types by schema name: every installed message."""
    types: tuple[type[Struct], ...] = (*message_types(), Here)
    return {SCHEMA_PREFIX + kind.__name__: kind for kind in types}


HERE: Final = SCHEMA_PREFIX + Here.__name__

Warn = Callable[[str], None]


class RecordingError(ValueError):
    """The file is not a recording."""


class UnreadError(RecordingError):
    """The file may be a recording, and none of its messages can be read."""


@dataclass(frozen=True, slots=True)
class Row:
    """One message of a recording; `t` is its time of arrival, ns since 1970."""

    t: int
    namespace: str
    key: str
    schema: str  # such as "armadico.Pose"; empty for an unknown payload
    data: bytes  # JSON if there is a schema, else the raw payload
    place: Place

    @property
    def topic(self) -> str:
        return f"/{self.namespace}/{self.key}"

    @property
    def fields(self) -> JsonObject:
        """The message by field names; empty for an unknown payload."""
        found: JsonObject = json.loads(self.data) if self.schema else {}
        return found

    @property
    def message(self) -> Message | None:
        """The message; None for other data. Raises MessageError if it does not fit its type."""
        kind = kinds().get(self.schema)
        if kind is None or not issubclass(kind, Message):
            return None
        return from_object(kind, self.fields)

    @property
    def received(self) -> Message | None:
        """The message as a watcher received it; None if it cannot be decoded.

        A bid comes in a `BidHistory`.
        """
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
    """The messages of a file in the order of arrival; one chunk is in memory at a time.

    A file is read up to where it ends or is damaged; `warn` receives a text about that, with the
    time in s from the first message. `about` receives the file's metadata before the first message
    is yielded.

    Raises RecordingError if the file is not a recording, and OSError.
    """
    from mcap.exceptions import EndOfFile
    from mcap.records import Channel, Message, Metadata, Schema, Statistics

    from armadico.watch.mcap_records import records

    _check_start(path)
    schemas, channels = dict[int, Schema](), dict[int, Channel]()
    first, last, number, damage = 0, 0, 0, ""
    try:
        for record, place in records(path):
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                channels[record.id] = record
            elif isinstance(record, Metadata) and record.name == PROFILE and about is not None:
                about.update(record.metadata)
            elif isinstance(record, Statistics) and record.message_count != number:
                damage = "is damaged"  # such as a chunk whose opcode is another
            elif isinstance(record, Message):
                last = record.log_time
                first, number = first or last, number + 1
                channel = channels[record.channel_id]
                schema = schemas.get(channel.schema_id)
                if schema is None or schema.name.startswith(SCHEMA_PREFIX):  # else a translator's
                    yield _row(channel, schema, record.log_time, record.data, place)
    except OSError:
        raise
    except EndOfFile:
        damage = "was cut short"
    except Exception:  # decoders can raise anything on damaged bytes
        damage = "is damaged"
    if damage:
        until = f", up to {(last - first) / 1e9:.1f} s" if number else ""
        warn(
            f"{path} {damage}: {number} messages could be read{until}, {_missing(path, number)}; if"
            f" that is not enough, try `mcap recover {path} -o recovered.mcap`"
        )


def _missing(path: Path, read: int) -> str:
    """How many messages could not be read, by what the recorder counted at the file's end."""
    from mcap.reader import SeekingReader

    with path.open("rb") as stream, suppress(Exception):  # damaged bytes can raise anything
        summary = SeekingReader(stream).get_summary()
        statistics = None if summary is None else summary.statistics
        if statistics is not None and statistics.message_count > read:
            return f"{statistics.message_count - read} are missing"
    return "how many are missing is not known"


def _check_start(path: Path) -> None:
    from armadico.watch.mcap_records import MAGIC

    with path.open("rb") as stream:
        start = stream.read(len(MAGIC))
    if not MAGIC.startswith(start):
        raise RecordingError(f"{path} is not an MCAP file")
    if start != MAGIC:
        what = "was cut short in its first bytes" if start else "is empty"
        raise UnreadError(f"{path} {what}")


def _row(channel: Channel, schema: Schema | None, t: int, data: bytes, place: Place) -> Row:
    topic = channel.topic.strip("/")
    namespace = channel.metadata.get("namespace", topic.partition("/")[0])
    key = channel.metadata.get("key", topic.partition("/")[2])
    name = schema.name if schema is not None and channel.message_encoding == "json" else ""
    return Row(t, namespace, key, name, data, place)


def _read_pieces(places: Iterable[Place]) -> Iterator[bytes]:
    """The contents of pieces of journals, in order. Raises ValueError and OSError."""
    from armadico.watch.mcap_records import payloads

    for data in payloads(places):
        yield decode(data, JournalPiece).data


def messages_of(
    path: Path, kinds: Collection[type[Struct]], namespace: str | None, warn: Warn
) -> tuple[list[tuple[float, Message | Presence]], dict[str, TomlValue]]:
    """One robot's messages of some kinds in a recording, with their times, s.

    With them the parameters of its agents that the journals have: the world, the robot's profile. A
    `ParametersReply`, which no agent publishes, is made of each journal, and a `Presence` of each
    liveliness token that appeared or disappeared, if `kinds` has it. The path is the file, or the
    first of several; without a namespace there is one robot. `warn` receives a text about each
    damaged or incomplete file. Raises RecordingError and OSError.
    """
    past = Past(path, warn)
    past.check()
    schemas = {SCHEMA_PREFIX + kind.__name__ for kind in kinds}
    found: dict[str, list[tuple[float, Message | Presence]]] = {}
    tokens: list[Presence] = []
    for row in past.rows():
        if row.schema == HERE and Presence in kinds:
            tokens.append(
                msgspec.convert({**row.fields, "namespace": row.namespace, "at": row.t}, Presence)
            )
        elif row.schema in schemas and (message := row.message) is not None:
            found.setdefault(row.namespace, []).append((row.t / 1e9, message))
    names = ", ".join(sorted(found))
    if namespace is not None and namespace not in found:
        raise RecordingError(f"holds no messages of {namespace!r}; it has {names}")
    if namespace is None and len(found) > 1:
        raise RecordingError(f"holds several robots: choose one of {names}")
    if not found:
        raise RecordingError("holds no odometry: no state of a robot")
    robot = namespace or next(iter(found))
    found[robot] += [(each.at / 1e9, each) for each in tokens if each.namespace == robot]
    given: dict[str, TomlValue] = {}
    for each in past.journals():
        if each.namespace == robot and each.head:
            if ParametersReply in kinds:
                reply = _parameters(each.instance, each.head.parameters)
                found[robot].append((each.began, reply))
            given = {k: v for k, v in each.head.parameters.items() if v} | given
    return found[robot], given


def _parameters(instance: str, parameters: dict[str, TomlValue]) -> ParametersReply:
    """The parameters with which an agent was launched, as it would tell them."""
    rows = (
        Setting(name, msgspec.json.encode(value).decode())
        for name, value in differing(parameters, {})
    )
    return ParametersReply(instance, (), fixed=tuple(rows))


def files_of(path: Path) -> list[Path]:
    """A recording's files: this one, and those in which `--max-size` continued it."""
    found = [path]
    for further in (part(path, number) for number in count(1)):
        if not further.is_file():
            break
        found.append(further)
    return found


class Past:
    """A recording with all its files: messages and journals."""

    def __init__(self, path: Path, warn: Warn) -> None:
        """Read the metadata and the first message.

        The path is the file, or the first of several. `warn` receives a text about each damaged or
        incomplete file. Raises RecordingError and OSError.
        """
        self.path = path
        self.about: dict[str, str] = {}
        self.damage: list[str] = []  # texts of the last call of `rows`, as far as it was iterated
        self._warn = warn
        first = next(rows(path, lambda _: None, self.about), None)
        self.began = 0.0 if first is None else first.t / 1e9  # s since 1970

    @property
    def paths(self) -> list[Path]:
        return files_of(self.path)

    def check(self) -> None:
        """Raises UnreadError if it was recorded with a protocol that this program does not read."""
        protocol = self.about.get("protocol")
        if protocol is None:
            raise UnreadError(
                f"{self.path} does not name its protocol: another program wrote it, or its"
                " beginning is missing; make one with `armadico record` or `armadico run --record`"
            )
        if protocol not in map(str, range(OLDEST, PROTOCOL + 1)):
            version = self.about.get("version", "")
            raise UnreadError(
                f"{self.path} was recorded with protocol {protocol}, but this program reads"
                f" {protocols()}: `pip install` the version that recorded it"
                f"{', ' * bool(version)}{version}"
            )

    def rows(self) -> Iterator[Row]:
        """All messages in the order of arrival. Raises RecordingError and OSError."""
        self.damage = []
        for path in self.paths:
            yield from rows(path, self._damaged)

    def _damaged(self, text: str) -> None:
        self.damage.append(text)
        self._warn(text)

    def journals(self, instances: Collection[str] | None = None) -> list[Journal]:
        """The journals of these instances, or of all, as far as they were recorded.

        An agent that kept no journal has an empty one, with a `fault`. Contents stay in the file
        and are read from it at each iteration.
        """
        pieces, there = Pieces(_read_pieces), set()
        for row in self.rows():
            if row.key.startswith(JOURNAL) and not row.schema:
                if instances is None or row.key.removeprefix(JOURNAL) in instances:
                    pieces.add(row.namespace, row.data, row.t, row.place)
            elif row.schema == HERE and (instances is None or row.fields["instance"] in instances):
                there.add((row.namespace, str(row.fields["instance"])))
        found = pieces.journals()
        kept = {(journal.namespace, journal.instance) for journal in found}
        return found + [without(*agent) for agent in sorted(there - kept)]
