"""Recordings read back: as messages, as tables, as a Rerun recording, in the words of others.

A file that was cut short, by a kill or a full disk, is read as far as it goes.
"""

from __future__ import annotations

import csv
import json
import mmap
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Final, TextIO, cast

from msgspec import Struct

from armadico.core import messages
from armadico.core.messages import BidHistory, BidRecord, Message, MessageError
from armadico.observe.recorder import REFUSED, SCHEMA_PREFIX, Here, McapFile
from armadico.observe.translators import Translator, translator
from armadico.observe.watching import from_object, json_schema

if TYPE_CHECKING:
    from mcap.records import Channel, Schema

    from armadico.config.worlds import World
    from armadico.observe.dashboard.local_map import Zones
    from armadico.observe.dashboard.scene import Scene

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


def rows(path: Path, warn: Warn) -> Iterator[Row]:
    """The messages of a file in the order they were received; `warn` is told if it is cut short.

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
                for row in _decoded(data):
                    read += 1
                    yield row
            except InvalidMagic:
                if read == 0:
                    raise RecordingError(f"{path} is no MCAP file") from None
                warn(f"{path} was cut short: {read} messages could be read")
            except Exception:  # whatever the decoders make of damaged bytes
                warn(f"{path} was cut short: {read} messages could be read")


def _decoded(data: mmap.mmap) -> Iterator[Row]:
    from mcap.records import Channel, Message, Schema, Statistics  # noqa: PLC0415 - an extra
    from mcap.stream_reader import StreamReader  # noqa: PLC0415 - an extra

    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    read = 0
    for record in StreamReader(cast("IO[bytes]", data), validate_crcs=True).records:
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            channels[record.id] = record
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


# Tables -------------------------------------------------------------------------------------------


class Tables:
    """One CSV file a topic: `t` in s from the recording's first message, then the fields.

    A field of a field is `cycle.number`; a list is JSON in one cell, what is missing an empty one.
    """

    def __init__(self, folder: Path) -> None:
        """Write into a folder, which is made. Raises OSError."""
        folder.mkdir(parents=True, exist_ok=True)
        self.folder = folder
        self.rows = 0
        self._first: int | None = None
        self._stack = ExitStack()
        self._files: dict[str, tuple[Any, list[str]]] = {}

    def __enter__(self) -> Tables:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    @property
    def topics(self) -> list[str]:
        """What there was."""
        return sorted(self._files)

    def take(self, row: Row) -> None:
        """Write one row; what is no known message is left out."""
        if not row.schema:
            return
        if self._first is None:
            self._first = row.t
        if row.topic not in self._files:
            self._files[row.topic] = self._begin(row)
        writer, columns = self._files[row.topic]
        cells = dict(_flat(row.fields))
        t = f"{(row.t - self._first) / 1e9:.6f}"
        writer.writerow([t, *(cells.get(column, "") for column in columns)])
        self.rows += 1

    def _begin(self, row: Row) -> tuple[Any, list[str]]:
        name = row.topic.strip("/").replace("/", "_") + ".csv"
        stream: TextIO = self._stack.enter_context(
            (self.folder / name).open("w", newline="", encoding="utf-8")
        )
        writer = csv.writer(stream)
        kind = KINDS.get(row.schema)
        columns = (
            list(_columns(json_schema(kind))) if kind else [name for name, _ in _flat(row.fields)]
        )
        writer.writerow(["t", *columns])
        return writer, columns


def _columns(schema: dict[str, Any], before: str = "") -> Iterator[str]:
    for name, field in schema["properties"].items():
        if field["type"] == "object":
            yield from _columns(field, f"{before}{name}.")
        else:
            yield before + name


def _flat(fields: dict[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in fields.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{before}{name}.")
        else:
            yield before + name, json.dumps(value) if isinstance(value, list) else value


# In the words of others ---------------------------------------------------------------------------


def translated(path: Path, out: Path, name: str, namespace: str | None, warn: Warn) -> int:
    """Write what a translator makes of a recording, and nothing else; returns how many samples.

    So tools that refuse a file of several encodings read it, and recordings that were made without
    the translator. Raises RecordingError, UnknownNameError, ImportError and OSError.
    """
    found = sorted({row.namespace for row in rows(path, lambda _: None)})
    chosen = found if namespace is None else [namespace]
    made = translator(name, chosen)
    others = [each for several in made.values() for each in several]
    if not others:
        return 0
    file, count = McapFile(out, others[0].about, others[0].profile), 0
    try:
        for row in rows(path, warn):
            for each in made.get(row.namespace, ()):
                count += _translate(file, each, row)
    finally:
        file.close()
    return count


def _translate(file: McapFile, by: Translator, row: Row) -> int:
    try:
        message = None if row.key.endswith(REFUSED) else row.message
    except MessageError:
        return 0
    samples = () if message is None else tuple(by.take(row.key, message, row.t))
    for sample in samples:
        file.add_sample(sample, row.t)
    return len(samples)


# Rerun --------------------------------------------------------------------------------------------


def to_rrd(
    path: Path, out: Path, namespace: str | None, world: World | None, zones: Zones, warn: Warn
) -> int:
    """Draw a recording as the dashboard would have; returns how many messages it was.

    Raises RecordingError if it holds several robots and none was named, ImportError without rerun,
    and OSError.
    """
    from armadico.observe.dashboard.scene import Scene  # noqa: PLC0415 - imports rerun
    from armadico.observe.dashboard.server import finish, keep  # noqa: PLC0415 - and this

    chosen = namespace or _only_namespace(path)
    recording = keep({chosen: world}, out)
    scene = Scene(recording, world, chosen, zones)
    count, first = 0, None
    for row in rows(path, warn):
        first = row.t if first is None else first
        if row.namespace == chosen and not row.key.endswith(REFUSED):
            count += _draw(scene, row, (row.t - first) / 1e9)
    finish(recording, out)
    return count


def _draw(scene: Scene, row: Row, t: float) -> bool:
    """Show one message to the scene, if it is one."""
    if row.schema == HERE:
        here = row.fields
        scene.alive(here["instance"], here["there"], t)
        return True
    try:
        message = row.message
    except MessageError:
        return False
    if isinstance(message, BidRecord):
        message = BidHistory(row.key.split("/")[2], (message,))
    if message is not None:
        scene.take(row.key, message, t)
    return message is not None


def _only_namespace(path: Path) -> str:
    found = sorted({row.namespace for row in rows(path, lambda _: None)})
    if len(found) != 1:
        said = ", ".join(found) or "nobody's messages"
        raise RecordingError(f"{path} holds {said}; name one robot: --namespace NS")
    return found[0]
