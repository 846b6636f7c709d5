"""Everything that is said, kept in MCAP files that Foxglove and other tools open.

Each message is written as a JSON object with a JSON schema drawn from `armadico.core.messages`, not
as the CBOR array that travels: viewers read JSON, and an array without names tells a reader
nothing. A payload that is no known message is kept raw, so nothing that was said is lost: on a
channel of its own, as CBOR without a schema.

Beside them are samples of whatever translators are given (`armadico.observe.translators`): the same
in the words of other people's tools, on channels of their own, for viewers that know no others.

A topic is `/<namespace>/<key>`; the time of a message is when it was received. Besides what is said
there are `Presence` on the key of a liveliness token, `Card` and `BidRecord` on the keys that they
are asked on. What has been received is with the operating system within `FLUSH_S`: killed at any
moment, a recording is readable up to then. (A power cut may cost what the disk had not written.)
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
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
from armadico.observe.watching import ASK_S, Heard, Presence, as_object, json_schema, read

if TYPE_CHECKING:
    from mcap.writer import Writer

    from armadico.observe.watching import Watcher

FLUSH_S: Final = 0.5
"""How often what has been received is handed to the operating system."""

SHOW_S: Final = 1.0
"""How often whoever watches the recorder is told how it goes."""

LATE: Final = 5000
"""A recorder that comes late asks for so many of the pieces before the first that it hears,"""

COMPLETE_S: Final = 1.0
"""How long a recorder that is to end waits for pieces that are missing."""

TRIES: Final = 10
"""for each so often,"""

AT_ONCE: Final = 20
"""and of one agent for so many at once."""

PROFILE: Final = "armadico"
SCHEMA_PREFIX: Final = "armadico."

REFUSED: Final = ".refused"
"""Ends the topic of payloads that are not the message that their key promises."""


class Here(Struct, frozen=True):
    """A liveliness token came or went."""

    name: Name
    instance: Name
    there: bool


class McapFile:
    """One file that is being written. Raises OSError."""

    def __init__(
        self, path: Path, about: Mapping[str, Mapping[str, str]], profile: str = PROFILE
    ) -> None:
        """Begin a file that is not there yet; `about` is kept in it, as metadata by its names."""
        from mcap.writer import Writer

        self.path = path
        self._stream: IO[bytes] = path.open("xb")
        self._writer: Writer = Writer(self._stream)
        self._schemas: dict[type[Struct], int] = {}
        self._channels: dict[tuple[str, type[Struct] | None], tuple[int, int]] = {}
        self._samples: dict[str, tuple[int, int]] = {}
        self._theirs: dict[tuple[str, str], int] = {}
        self._writer.start(profile, f"armadico {about.get(PROFILE, {}).get('version', '')}".strip())
        for name, words in about.items():
            self._writer.add_metadata(name, dict(words))
        self._writer.flush()  # type: ignore[no-untyped-call]

    @property
    def size(self) -> int:
        """Bytes that are in the file."""
        return self.path.stat().st_size

    def add(
        self, namespace: str, key: str, kind: type[Struct] | None, data: bytes, at: int
    ) -> None:
        """Write one message, JSON if it has a kind, else CBOR; `at` in ns since 1970."""
        topic = f"/{namespace}/{key}"
        channel, sequence = self._channels.get((topic, kind), (0, 0))
        if channel == 0:
            channel = self._writer.register_channel(
                topic,
                "cbor" if kind is None else "json",
                0 if kind is None else self._schema(kind),
                {"namespace": namespace, "key": key},
            )
        self._channels[topic, kind] = (channel, sequence + 1)
        self._writer.add_message(channel, at, data, at, sequence)

    def add_sample(self, sample: Sample, at: int) -> None:
        """Write one sample of a translator's; `at` in ns since 1970."""
        what = sample.channel
        channel, sequence = self._samples.get(what.topic, (0, 0))
        if channel == 0:
            named = (what.schema_encoding, what.schema)
            if named not in self._theirs:
                self._theirs[named] = self._writer.register_schema(
                    what.schema, what.schema_encoding, what.definition.encode()
                )
            channel = self._writer.register_channel(
                what.topic, what.encoding, self._theirs[named], dict(what.metadata)
            )
        self._samples[what.topic] = (channel, sequence + 1)
        self._writer.add_message(channel, at, sample.data, at, sequence)

    def flush(self) -> None:
        """Hand everything to the operating system."""
        self._writer.flush()  # type: ignore[no-untyped-call]

    def close(self) -> None:
        """Write the index and close."""
        try:
            self._writer.finish()  # type: ignore[no-untyped-call]
        finally:
            self._stream.close()

    def _schema(self, kind: type[Struct]) -> int:
        if kind not in self._schemas:
            text = msgspec.json.encode(json_schema(kind))
            name = SCHEMA_PREFIX + kind.__name__
            self._schemas[kind] = self._writer.register_schema(name, "jsonschema", text)
        return self._schemas[kind]


class Gaps:
    """Which pieces of journals are missing: they can be asked for again while they are kept."""

    def __init__(self) -> None:
        self._next: dict[tuple[str, str], int] = {}  # after the newest piece, by instance
        self._missing: dict[tuple[str, str], dict[int, int]] = {}  # and how often it was asked for

    def add(self, namespace: str, piece: JournalPiece) -> bool:
        """Know of a piece that came; whether it is there for the first time."""
        who, number = (namespace, piece.instance), piece.number
        missing, after = self._missing.setdefault(who, {}), self._next.get(who, 0)
        if number < after:
            return missing.pop(number, None) is not None
        for lost in range(max(after, number - LATE), number):
            missing[lost] = 0
        self._next[who] = number + 1
        return True

    def ask(self) -> list[tuple[str, str, int]]:
        """Which are to be asked for now: namespace, instance, number; each a few times."""
        found = []
        for who, missing in self._missing.items():
            for number in [n for n, often in missing.items() if often < TRIES][:AT_ONCE]:
                missing[number] += 1
                found.append((*who, number))
        return found

    def expect(self, namespace: str, instance: str) -> None:
        """Miss the first piece of who is there and was not heard, where others keep journals."""
        who = (namespace, instance)
        if who not in self._next and any(space == namespace for space, _ in self._next):
            self._next[who], self._missing[who] = 1, {0: 0}

    @property
    def lost(self) -> int:
        return sum(map(len, self._missing.values()))


class Recording:
    """What is heard goes in, files come out; the clock is the caller's.

    A file that has grown to `max_bytes` is closed and the next begun: `run.mcap`, `run-001.mcap`
    and so on. Each begins with who is there, their cards and the latched samples, so that each can
    be read alone.
    """

    def __init__(
        self,
        path: Path,
        about: Mapping[str, str] | None = None,
        max_bytes: int | None = None,
        translators: Mapping[str, Sequence[Translator]] | None = None,
    ) -> None:
        """Begin the first file. Raises OSError, FileExistsError among them.

        `translators` are those of each namespace.
        """
        self.messages = 0
        self.refused = 0
        self.gaps = Gaps()
        self.there: dict[tuple[str, str, str], Presence] = {}
        self._cards: dict[tuple[str, str, str], tuple[Heard, Card]] = {}
        self._bids: dict[tuple[str, str], frozenset[BidRecord]] = {}
        self._translators = translators or {}
        self._kept: dict[str, Sample] = {}  # latched ones, by their topics
        self._about = {PROFILE: {"protocol": str(PROTOCOL), **(about or {})}}
        self._first, self._max_bytes = path, max_bytes
        self.files = 1
        self._earlier = 0
        self._file = McapFile(path, self._about)

    @property
    def path(self) -> Path:
        """The file that is being written."""
        return self._file.path

    @property
    def size(self) -> int:
        """Bytes in all files."""
        return self._earlier + self._file.size

    def add(self, item: Heard | Presence) -> None:
        """Keep one thing that came."""
        if isinstance(item, Presence):
            self._take_presence(item)
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
                self._add(item, None, item.data)  # which is packed as it is
        elif isinstance(message, BidHistory) and item.asked:
            self._take_bids(item, message)
        elif isinstance(message, Card) and item.asked:
            self._take_card(item, message)
        else:
            self._say(item, message)
            self._translate(item, message)

    def misses_cards(self) -> bool:
        """Whether somebody is there who has not shown a card."""
        return any(who not in self._cards for who in self.there)

    def flush(self) -> None:
        """Hand what was taken to the operating system, and go on to the next file if it is time."""
        self._file.flush()
        if self._max_bytes is not None and self._file.size >= self._max_bytes:
            self._next_file()

    def close(self) -> None:
        self._file.close()

    def _take_presence(self, item: Presence) -> None:
        who = (item.namespace, item.name, item.instance)
        if item.there == (who in self.there):
            return  # liveliness may say the same twice
        if item.there:
            self.there[who] = item
        else:
            del self.there[who]
            self._cards.pop(who, None)
            self._bids.pop((item.namespace, item.instance), None)
        self._show_presence(item, item.at)

    def _take_card(self, item: Heard, card: Card) -> None:
        who = (item.namespace, card.name, card.instance)
        if self._cards.get(who, (None, None))[1] != card:
            self._cards[who] = (item, card)
            self._say(item, card)

    def _take_bids(self, item: Heard, history: BidHistory) -> None:
        """Keep those that the last answer did not have."""
        who = (item.namespace, history.instance)
        known = self._bids.get(who, frozenset())
        self._bids[who] = frozenset(history.bids)
        for bid in history.bids:
            if bid not in known:
                self._say(item, bid)

    def _show_presence(self, item: Presence, at: int) -> None:
        key = TOKEN.format(name=item.name, instance=item.instance)
        here = Here(item.name, item.instance, item.there)
        self._file.add(item.namespace, key, Here, msgspec.json.encode(here), at)
        self.messages += 1

    def _say(self, item: Heard, message: Message) -> None:
        self._add(item, type(message), msgspec.json.encode(as_object(message)))

    def _translate(self, item: Heard, message: Message) -> None:
        for translator in self._translators.get(item.namespace, ()):
            for sample in translator.translate(item.key, message, item.at):
                self._file.add_sample(sample, item.at)
                if sample.channel.latched:
                    self._kept[sample.channel.topic] = sample

    def _add(
        self, item: Heard, kind: type[Struct] | None, data: bytes, key: str | None = None
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
        for heard, card in self._cards.values():
            data = msgspec.json.encode(as_object(card))
            self._file.add(heard.namespace, heard.key, Card, data, now)
        for sample in self._kept.values():
            self._file.add_sample(sample, now)


def part(path: Path, number: int) -> Path:
    """The name of a further file of a recording: 1 is the second."""
    return path.with_stem(f"{path.stem}-{number:03d}")


def record(
    watcher: Watcher,
    recording: Recording,
    show: Callable[[Recording], None],
    duration: float | None = None,
    over: Callable[[], bool] = lambda: False,
) -> None:
    """Record until `duration` (s) is over, or until it is `over`, which is asked now and then.

    The watcher's meshes are open; the recording is left open. Nothing else should end it: an
    exception within what writes, KeyboardInterrupt say, leaves a file that is not whole.
    """
    watcher.watch_alive()
    watcher.subscribe()
    end = float("inf") if duration is None else time.monotonic() + duration
    flush_at = ask_at = show_at = time.monotonic()
    while (now := time.monotonic()) < end and not over():
        if now >= ask_at:
            ask_at = now + ASK_S
            _ask(watcher, recording)
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
    """Ask once more for the pieces that are missing, and wait for them a moment."""
    for namespace, _, instance in recording.there:  # one that has only just come, say
        recording.gaps.expect(namespace, instance)
    missing = recording.gaps.ask()
    for lost in missing:
        watcher.ask_for_piece(*lost, COMPLETE_S)
    end = time.monotonic() + COMPLETE_S
    while missing and recording.gaps.lost and (left := end - time.monotonic()) > 0:
        item = watcher.get(left)
        if item is not None:
            recording.add(item)


def _ask(watcher: Watcher, recording: Recording) -> None:
    if recording.there:
        watcher.ask_for_bids(ASK_S)
    for lost in recording.gaps.ask():
        watcher.ask_for_piece(*lost, ASK_S)
    if recording.misses_cards():
        watcher.ask_for_cards(ASK_S)
