"""The recorder: writes all messages to MCAP files, for Foxglove and other tools.

Each message is a JSON object with a JSON schema derived from its type, because viewers read JSON
and not the CBOR arrays of the wire. An unknown or invalid payload is recorded raw, as CBOR without
a schema, on a separate channel.

Translators (`armadico.observe.translators`) add samples in the formats of other tools, on further
channels.

A topic is `/<namespace>/<key>`; the time of a message is its time of arrival. Besides publications
there are `Here` on the key of a liveliness token, and `Card` and `BidRecord` on the keys of their
queries. Data reaches the operating system within `FLUSH_S`: if the recorder is killed, the file is
readable up to then. (A power cut may lose what the disk had not written.)
"""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO, TYPE_CHECKING, Final

import msgspec
from msgspec import Struct

from armadico.core.messages import (
    PROTOCOL,
    BidHistory,
    BidRecord,
    Card,
    JournalPiece,
    Message,
    MessageError,
    Name,
)
from armadico.core.services import TOKEN
from armadico.observe.translators import Sample, Translator
from armadico.observe.watching import QUERY_S, Presence, Received, as_object, json_schema, read

if TYPE_CHECKING:
    from mcap.writer import Writer

    from armadico.observe.watching import Watcher

FLUSH_S: Final = 0.5  # interval at which data is passed to the operating system
SHOW_S: Final = 1.0  # interval of progress reports
COMPLETE_S: Final = 1.0  # time to wait for missing journal pieces at the end

# Queries for missing pieces of journals:
LATE: Final = 5000  # a recorder that starts late queries this many earlier pieces
TRIES: Final = 10  # queries per piece
AT_ONCE: Final = 20  # pieces of one agent queried at once

PROFILE: Final = "armadico"
SCHEMA_PREFIX: Final = "armadico."
REFUSED: Final = ".refused"  # suffix of the topic of payloads that do not fit their key


class Here(Struct, frozen=True):
    """A liveliness token appeared or disappeared."""

    name: Name
    instance: Name
    there: bool


class McapFile:
    """An open file. Raises OSError."""

    def __init__(
        self, path: Path, about: Mapping[str, Mapping[str, str]], profile: str = PROFILE
    ) -> None:
        """Create a new file; `about` is written to it as metadata records, by name."""
        from mcap.writer import Writer

        self.path = path
        self._stream: IO[bytes] = path.open("xb")
        self._writer: Writer = Writer(self._stream)
        self._schemas: dict[tuple[str, str, bytes], int] = {}  # two kinds may have one name
        # By topic and kind, or a translator's topic: the channel, and its messages so far.
        self._channels: dict[Hashable, tuple[int, int]] = {}
        library = f"armadico {about.get(PROFILE, {}).get('version', '')}".strip()
        try:
            self._writer.start(profile, library)
            for name, words in about.items():
                self._writer.add_metadata(name, dict(words))
            self._writer.flush()  # type: ignore[no-untyped-call]
        except OSError:
            with suppress(OSError):  # of no use without its head, and in the way of the next try
                path.unlink()
            with suppress(OSError):
                self._stream.close()
            raise

    @property
    def size(self) -> int:
        return self.path.stat().st_size

    def add(
        self, namespace: str, key: str, kind: type[Struct] | None, data: bytes, at: int
    ) -> None:
        """Write one message, JSON if it has a kind, else CBOR; `at` in ns since 1970."""
        topic = f"/{namespace}/{key}"

        def register() -> int:
            schema, words = 0, {"namespace": namespace, "key": key}
            if kind is not None:
                text = msgspec.json.encode(json_schema(kind))
                schema = self._schema(SCHEMA_PREFIX + kind.__name__, "jsonschema", text)
            encoding = "cbor" if kind is None else "json"
            return self._writer.register_channel(topic, encoding, schema, words)

        self._put((topic, kind), register, data, at)

    def add_sample(self, sample: Sample, at: int) -> None:
        """Write one sample of a translator's; `at` in ns since 1970."""
        what = sample.channel

        def register() -> int:
            schema = self._schema(what.schema, what.schema_encoding, what.definition.encode())
            words = dict(what.metadata)
            return self._writer.register_channel(what.topic, what.encoding, schema, words)

        self._put(what.topic, register, sample.data, at)

    def flush(self) -> None:
        self._writer.flush()  # type: ignore[no-untyped-call]

    def close(self) -> None:
        """Write the index and close."""
        try:
            self._writer.finish()  # type: ignore[no-untyped-call]
        finally:
            self._stream.close()

    def _put(self, channel: Hashable, register: Callable[[], int], data: bytes, at: int) -> None:
        if channel not in self._channels:
            self._channels[channel] = register(), 0
        number, sequence = self._channels[channel]
        self._channels[channel] = number, sequence + 1
        self._writer.add_message(number, at, data, at, sequence)

    def _schema(self, name: str, encoding: str, definition: bytes) -> int:
        what = name, encoding, definition
        if what not in self._schemas:
            self._schemas[what] = self._writer.register_schema(*what)
        return self._schemas[what]


class Gaps:
    """The missing pieces of journals; agents keep the newest pieces, so they can be queried."""

    def __init__(self) -> None:
        self._next: dict[tuple[str, str], int] = {}  # after the newest piece, by instance
        self._missing: dict[tuple[str, str], dict[int, int]] = {}  # with the number of queries

    def add(self, namespace: str, piece: JournalPiece) -> bool:
        """Register a piece; True if it arrived for the first time."""
        agent, number = (namespace, piece.instance), piece.number
        missing, after = self._missing.setdefault(agent, {}), self._next.get(agent, 0)
        if number < after:
            return missing.pop(number, None) is not None
        for lost in range(max(after, number - LATE), number):
            missing[lost] = 0
        self._next[agent] = number + 1
        return True

    def due(self) -> list[tuple[str, str, int]]:
        """The pieces to query now, as (namespace, instance, number); counts the query."""
        found = []
        for agent, missing in self._missing.items():
            for number in [n for n, often in missing.items() if often < TRIES][:AT_ONCE]:
                missing[number] += 1
                found.append((*agent, number))
        return found

    def expect(self, namespace: str, instance: str) -> None:
        """Mark the first piece of a live agent as missing, if others of its robot keep journals."""
        agent = (namespace, instance)
        if agent not in self._next and any(space == namespace for space, _ in self._next):
            self._next[agent], self._missing[agent] = 1, {0: 0}

    @property
    def lost(self) -> int:
        return sum(map(len, self._missing.values()))


class Recording:
    """Writes received items to files; the caller provides the times.

    A file that has grown to `max_bytes` is closed and the next begun: `run.mcap`, `run-001.mcap`
    and so on. Each begins with the live agents, their cards and the latched samples, so that each
    can be read alone.
    """

    def __init__(
        self,
        path: Path,
        about: Mapping[str, str] | None = None,
        max_bytes: int | None = None,
        translators: Mapping[str, Sequence[Translator]] | None = None,
    ) -> None:
        """Create the first file; `translators` are by namespace. Raises OSError."""
        self.messages = 0
        self.refused = 0
        self.gaps = Gaps()
        self.there: dict[tuple[str, str, str], Presence] = {}
        self._cards: dict[tuple[str, str, str], tuple[Received, Card]] = {}
        self._bids: dict[tuple[str, str], frozenset[BidRecord]] = {}
        self._translators = translators or {}
        self._kept: dict[str, Sample] = {}  # latched samples, by topic
        self._about = {PROFILE: {"protocol": str(PROTOCOL), **(about or {})}}
        self._first, self._max_bytes = path, max_bytes
        self.files = 1
        self._earlier = 0
        self._file = McapFile(path, self._about)

    @property
    def path(self) -> Path:
        return self._file.path

    @property
    def size(self) -> int:
        """Bytes in all files."""
        return self._earlier + self._file.size

    def add(self, item: Received | Presence) -> None:
        if isinstance(item, Presence):
            self._on_presence(item)
            return
        try:
            message = read(item)
        except MessageError:
            self.refused += 1
            self._add(item, None, item.data, item.key + REFUSED)
            return
        if message is None:
            self._add(item, None, item.data)
        elif isinstance(message, JournalPiece):
            if self.gaps.add(item.namespace, message):
                self._add(item, None, item.data)  # raw: it is compressed
        elif isinstance(message, BidHistory) and item.on_query:
            self._on_bids(item, message)
        elif isinstance(message, Card) and item.on_query:
            self._on_card(item, message)
        else:
            self._write(item, message)
            self._translate(item, message)

    def misses_cards(self) -> bool:
        """Whether the card of a live agent is missing."""
        return any(agent not in self._cards for agent in self.there)

    def flush(self) -> None:
        """Pass everything to the operating system; begin the next file if this one is full."""
        self._file.flush()
        if self._max_bytes is not None and self._file.size >= self._max_bytes:
            self._next_file()

    def close(self) -> None:
        self._file.close()

    def _on_presence(self, item: Presence) -> None:
        agent = (item.namespace, item.name, item.instance)
        if item.there == (agent in self.there):
            return  # liveliness may report the same twice
        if item.there:
            self.there[agent] = item
        else:
            del self.there[agent]
            self._cards.pop(agent, None)
            self._bids.pop((item.namespace, item.instance), None)
        self._show_presence(item, item.at)

    def _on_card(self, item: Received, card: Card) -> None:
        agent = (item.namespace, card.name, card.instance)
        if self._cards.get(agent, (None, None))[1] != card:
            self._cards[agent] = (item, card)
            self._write(item, card)

    def _on_bids(self, item: Received, history: BidHistory) -> None:
        """Write the bids that the previous answer did not contain."""
        agent = (item.namespace, history.instance)
        known = self._bids.get(agent, frozenset())
        self._bids[agent] = frozenset(history.bids)
        for bid in history.bids:
            if bid not in known:
                self._write(item, bid)

    def _show_presence(self, item: Presence, at: int) -> None:
        key = TOKEN.format(name=item.name, instance=item.instance)
        here = Here(item.name, item.instance, item.there)
        self._file.add(item.namespace, key, Here, msgspec.json.encode(here), at)
        self.messages += 1

    def _write(self, item: Received, message: Message) -> None:
        self._add(item, type(message), msgspec.json.encode(as_object(message)))

    def _translate(self, item: Received, message: Message) -> None:
        for translator in self._translators.get(item.namespace, ()):
            for sample in translator.translate(item.key, message, item.at):
                self._file.add_sample(sample, item.at)
                if sample.channel.latched:
                    self._kept[sample.channel.topic] = sample

    def _add(
        self, item: Received, kind: type[Struct] | None, data: bytes, key: str | None = None
    ) -> None:
        self._file.add(item.namespace, key or item.key, kind, data, item.at)
        self.messages += 1

    def _next_file(self) -> None:
        now = time.time_ns()
        self._file.close()
        self._earlier += self._file.path.stat().st_size
        self._file = McapFile(part(self._first, self.files), self._about)
        self.files += 1
        for presence in self.there.values():
            self._show_presence(presence, now)
        for item, card in self._cards.values():
            data = msgspec.json.encode(as_object(card))
            self._file.add(item.namespace, item.key, Card, data, now)
        for sample in self._kept.values():
            self._file.add_sample(sample, now)


def part(path: Path, number: int) -> Path:
    """The name of a further file of a recording; 1 is the second file."""
    return path.with_stem(f"{path.stem}-{number:03d}")


def record(
    watcher: Watcher,
    recording: Recording,
    show: Callable[[Recording], None],
    duration: float | None = None,
    over: Callable[[], bool] = lambda: False,
) -> None:
    """Record for `duration` (s), or until `over` returns True; it is called for each item.

    The watcher's meshes must be open; the recording stays open. Do not end it by an exception, such
    as KeyboardInterrupt: in the middle of a write that leaves an incomplete file.
    """
    watcher.watch_alive()
    watcher.subscribe()
    end = float("inf") if duration is None else time.monotonic() + duration
    flush_at = query_at = show_at = time.monotonic()
    while (now := time.monotonic()) < end and not over():
        if now >= query_at:
            query_at = now + QUERY_S
            _query(watcher, recording)
        if now >= flush_at:
            flush_at = now + FLUSH_S
            recording.flush()
        if now >= show_at:
            show_at = now + SHOW_S
            show(recording)
        item = watcher.get(min(flush_at, end) - now)
        if item is not None:
            recording.add(item)
    _complete(watcher, recording)


def _complete(watcher: Watcher, recording: Recording) -> None:
    """Query missing pieces once more, and wait up to `COMPLETE_S` for them."""
    for namespace, _, instance in recording.there:  # such as an agent that has just started
        recording.gaps.expect(namespace, instance)
    missing = recording.gaps.due()
    for lost in missing:
        watcher.query_piece(*lost, COMPLETE_S)
    end = time.monotonic() + COMPLETE_S
    while missing and recording.gaps.lost and (left := end - time.monotonic()) > 0:
        item = watcher.get(left)
        if item is not None:
            recording.add(item)


def _query(watcher: Watcher, recording: Recording) -> None:
    if recording.there:
        watcher.query_bids(QUERY_S)
    for lost in recording.gaps.due():
        watcher.query_piece(*lost, QUERY_S)
    if recording.misses_cards():
        watcher.query_cards(QUERY_S)
