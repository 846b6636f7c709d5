"""Agents' journals (`core.journal`) described, and read back from a recording.

A journal begins with a `Head`: who the agent is, and all that its decisions hang on besides what
the journal tells: its parameters, the state of its random numbers, what stood in the files that its
parameters name. Journals are read as far as they go: a piece that was lost is a gap, beyond which
nobody knows what the agent had in mind.
"""

from __future__ import annotations

import zlib
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from itertools import islice
from math import isfinite
from pathlib import Path
from random import Random
from typing import Annotated, Any, Final, NamedTuple

import msgspec
from msgspec import Meta, Struct, msgpack
from msgspec.structs import replace

from armadico.config.profile import load_profile
from armadico.config.worlds import load_world
from armadico.core import journal as j
from armadico.core.agent import Agent
from armadico.core.journal import FORMAT, NOTHING, READABLE, START, TAKE
from armadico.core.messages import PROTOCOL, JournalPiece, MessageError, decode
from armadico.core.services import service_of
from armadico.observe.conditions import digest, software

JOURNAL: Final = service_of(JournalPiece).key_for(instance="")
"""How the keys begin on which journals are published."""

LARGEST_FRAME: Final = 64_000_000
"""Bytes that a frame may come to: a damaged one asks for no more memory."""

LENGTH: Final = 4
"""Bytes in which a frame's length stands before it."""

SAMPLES: Final = 20
"""Frames that are looked at to tell two clocks apart."""

Entry = list[Any]
"""See `core.journal`."""

_ENTRIES: Final = msgpack.Decoder(list[Annotated[Entry, Meta(min_length=2)]])

_TIME: Final = (float, int)
_ANY: Final = (object,)

_SHAPES: Final[Mapping[int, tuple[tuple[type, ...], ...]]] = {
    START: (_TIME, (bool,), (bytes,)),
    j.BEGIN: (_TIME,),
    j.WAKE: (_TIME,),
    j.LEAVE: (_TIME,),
    j.TOKEN: (_TIME, (str,), (str,), (bool,)),
    j.DELIVER: (_TIME, (str,), (str,), _ANY),
    j.ASKED: (_TIME, (str,), _ANY, (int,), _TIME),
    j.REPLIED: (_TIME, (int,), _ANY),
    j.RECEIVED: (_TIME, (bytes,)),
    j.LINK: (_TIME, (bool,), (str,)),
    j.ROUTER: (_TIME, (bool,)),
    j.SLOW: (_TIME, _TIME),
    j.REFUSE: (_TIME, (str,), (str,)),
    j.REPORT: (_TIME, (dict,)),
    TAKE: ((bytes,), (*_TIME, type(None))),
}
"""Of what types an entry of each number is, after the number."""

_OUTPUTS: Final = msgpack.Decoder(list[Annotated[list[Any], Meta(min_length=1)]])


class Head(Struct, frozen=True, kw_only=True):
    """Who an agent is, and what its decisions hang on besides what enters it."""

    format: int
    protocol: int
    name: str
    instance: str
    host: str
    pid: int
    version: str
    kind: str  # its class, module:name
    parameters: dict[str, Any]
    random: tuple[int, bytes, float | None]  # the state of its random numbers (`Random.getstate`)
    files: dict[str, str]  # what its parameters name, by the parameter: hashes of the content
    commit: str  # of the code that it ran, and a hash of all that code
    source: str


def head(agent: Agent) -> bytes:
    """The head of an agent's journal. Raises ConfigError if a file that it names is gone."""
    who, kind = agent.identity, type(agent)
    version, words, gauss = agent.drawn
    code = software()
    return msgpack.encode(
        Head(
            format=FORMAT,
            protocol=PROTOCOL,
            name=agent.name,
            instance=agent.instance,
            host=who.host,
            pid=who.pid,
            version=who.version,
            kind=f"{kind.__module__}:{kind.__qualname__}",
            parameters=msgspec.to_builtins(agent.p),
            random=(version, b"".join(word.to_bytes(4, "big") for word in words), gauss),
            files=files(agent.p),
            commit=code.commit,
            source=code.source,
        )
    )


def stream(state: tuple[int, bytes, float | None]) -> Random:
    """Random numbers that go on from a head's state. Raises ValueError if it is none."""
    version, words, gauss = state
    drawn = tuple(int.from_bytes(words[i : i + 4], "big") for i in range(0, len(words), 4))
    made = Random()
    made.setstate((version, drawn, gauss))
    return made


def files(parameters: Any) -> dict[str, str]:
    """Hashes of what stands in the files that parameters name: the world, the make of robot, a map.

    What an agent of one's own names by other parameters is not looked at. Raises ConfigError.
    """
    found = {}
    for name, hashed in _READ.items():
        value = getattr(parameters, name, None)
        if value:
            found[name] = hashed(value)
    return found


def _world(name: str) -> str:
    return digest(replace(load_world(name), name=""))


def _profile(name: str) -> str:
    return digest(load_profile(name))


def _map(name: str) -> str:
    """A saved map is a .yaml and the picture beside it."""
    path, found = Path(name), sha256()
    for each in sorted(path.parent.glob(f"{path.stem}.*")):
        found.update(each.read_bytes())
    return found.hexdigest()[:16]


_READ: Final[Mapping[str, Callable[[str], str]]] = {
    "world": _world,
    "profile": _profile,
    "resume": _map,
}


# Read back ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Frames:
    """The frames of a journal, read one after another from where its pieces are kept.

    A day of a robot's journals does not fit in memory, so only the places of the pieces are kept.
    """

    pieces: tuple[tuple[int, Any], ...] = ()  # when each was received, ns since 1970; its place
    read: Callable[[Iterable[Any]], Iterator[bytes]] = iter  # pieces by places: these are places
    size: int = 0  # bytes

    def __bool__(self) -> bool:
        return bool(self.pieces)

    def __iter__(self) -> Iterator[tuple[int, bytes]]:
        """Each frame, and when it was received, ns since 1970. Raises ValueError and OSError."""
        for at, frame in self.parts():
            if at is not None:
                yield at, frame

    def parts(self) -> Iterator[tuple[int | None, bytes]]:
        """The same, and at last, with None, what is left of a frame that is not whole."""
        waiting = b""
        read = self.read(place for _, place in self.pieces)
        for (at, _), data in zip(self.pieces, read, strict=True):
            waiting += data
            while len(waiting) >= LENGTH and len(waiting) >= (end := LENGTH + _length(waiting)):
                yield at, waiting[LENGTH:end]
                waiting = waiting[end:]
        if waiting:
            yield None, waiting


def _length(frame: bytes) -> int:
    return int.from_bytes(frame[:LENGTH], "big")


@dataclass(frozen=True)
class Journal:
    """The journal of one instance, as far as a recording has it."""

    namespace: str
    name: str
    instance: str
    head: Head | None  # none: it cannot be gone through again; `fault` says why
    fault: str  # what is wrong with it, or missing; empty if it is whole
    frames: Frames

    def entries(self) -> Iterator[Entry]:
        """Its entries in order. Raises ValueError where it is damaged."""
        before = None
        for _, frame in self.frames:
            for entry in _unpacked(frame):
                number = entry[0]
                if (number == START) != (before is None) or number == TAKE == before:
                    raise ValueError(f"an entry {number} after {before}")
                before = number
                yield entry

    @cached_property
    def began(self) -> float:
        """When the agent began, s since 1970 by the recorder's clock."""
        try:
            start = next(self.entries(), None)
        except ValueError:  # a damaged one: `entries` says so
            start = None
        return self.offset + (float(start[1]) if start else 0.0)

    @property
    def received(self) -> int:
        """When its first piece was, ns since 1970; 0 without one."""
        return self.frames.pieces[0][0] if self.frames else 0

    @property
    def offset(self) -> float:
        """What the recorder's clock showed when the agent's showed 0, s: at most so much later.

        The least of what some frames say: each was on its way for a while.
        """
        found: list[float] = []
        some = islice(self.frames, 0, None, max(len(self.frames.pieces) // SAMPLES, 1))
        with suppress(ValueError):  # the file has changed: `entries` says so
            for at, frame in some:
                with suppress(ValueError):  # a damaged one: `entries` says so
                    found.append(at / 1e9 - _last(frame))
        return min(found, default=0.0)


class Pieces:
    """Takes the pieces of all journals of a recording, in any order, and puts them together."""

    def __init__(self, read: Callable[[Iterable[Any]], Iterator[bytes]] = iter) -> None:
        """Nothing was taken yet.

        Args:
            read: What the pieces at some places hold, in their order; by default each place is what
                the piece holds. It is pickled with a journal.
        """
        self._read = read
        self._pieces: dict[tuple[str, str], dict[int, _Piece]] = defaultdict(dict)

    def add(self, namespace: str, data: bytes, at: int, place: Any = None) -> None:
        """One piece as it was published, at a time (ns since 1970); what is none is left out."""
        try:
            piece = decode(data, JournalPiece)
        except MessageError:
            return
        held = piece.data
        kept = _Piece(at, held if place is None else place, len(held), held[:LENGTH])
        self._pieces[namespace, piece.instance].setdefault(piece.number, kept)

    def journals(self) -> list[Journal]:
        """All journals, by the times at which they began."""
        found = [_journal(*who, pieces, self._read) for who, pieces in self._pieces.items()]
        return sorted(found, key=lambda one: (one.received, one.instance))


class _Piece(NamedTuple):
    """One piece of a journal, without what it holds."""

    at: int  # when it was received, ns since 1970
    place: Any
    size: int
    begins: bytes  # its first bytes


def without(namespace: str, instance: str) -> Journal:
    """An agent that was there, and of whose journal nothing was recorded."""
    why = "it kept no journal: agents that are started with --journal do, or by run --record"
    return Journal(namespace, instance.rpartition("-")[0], instance, None, why, Frames())


def _journal(
    namespace: str,
    instance: str,
    pieces: Mapping[int, _Piece],
    read: Callable[[Iterable[Any]], Iterator[bytes]],
) -> Journal:
    name, fault = instance.rpartition("-")[0], ""
    first, last = min(pieces), max(pieces)
    if first:
        fault = "the recording began after the agent did: the beginning of its journal is missing"
        return Journal(namespace, name, instance, None, fault, Frames())
    lost = next((number for number in range(last + 1) if number not in pieces), None)
    whole = [pieces[number] for number in range(last + 1 if lost is None else lost)]
    if lost is not None:
        fault = f"a gap: piece {lost} of {last + 1} of its journal was lost"
    frames = Frames(tuple((p.at, p.place) for p in whole), read, sum(p.size for p in whole))
    if not fault and not _is_whole(whole, frames):
        fault = "its last piece is not whole"
    _, first_frame = next(frames.parts(), (None, b""))
    head, why = _head(first_frame) if first_frame else (None, "nothing of its journal was recorded")
    return Journal(namespace, name, instance, head, why or fault, frames)


def _is_whole(pieces: Sequence[_Piece], frames: Frames) -> bool:
    """Whether the last frame ends with the last piece.

    Each frame begins with a piece, as journals are written. Others are read to find out.
    """
    left = 0
    for piece in pieces:
        left = (left or LENGTH + _length(piece.begins)) - piece.size
        if left < 0 or len(piece.begins) < LENGTH:
            return all(at is not None for at, _ in frames.parts())
    return not left


def _head(frame: bytes) -> tuple[Head | None, str]:
    try:
        start = _unpacked(frame)[0]
        if start[0] != START:
            raise ValueError("no start")
        plain = msgpack.decode(start[3])
        version = plain["format"]
        if version not in READABLE:
            return None, f"its journal is of format {version}; this program reads {FORMAT}"
        if plain["protocol"] != PROTOCOL:
            spoken = plain["protocol"]
            return None, f"it spoke protocol {spoken}; this program speaks {PROTOCOL}"
        return msgspec.convert(plain, Head), ""
    except (ValueError, TypeError, KeyError, IndexError):  # msgspec's are ValueErrors
        return None, "its journal does not begin with who it is"


def _unpacked(frame: bytes) -> list[Entry]:
    """The entries of a frame. Raises ValueError if it is damaged."""
    try:
        unpacker = zlib.decompressobj()
        data = unpacker.decompress(frame, LARGEST_FRAME)
        if not unpacker.eof:
            raise ValueError("too long, or cut short")
        entries = _ENTRIES.decode(data)
    except (zlib.error, msgspec.DecodeError) as error:
        raise ValueError(str(error)) from None
    for entry in entries:
        if not _sound(entry):
            raise ValueError(f"no entry of a journal: {entry[0]!r:.20}")
    return entries


def _sound(entry: Entry) -> bool:
    """Whether it is what `core.journal` says that entries are."""
    number, *rest = entry
    shape = _SHAPES.get(number) if isinstance(number, int) else None
    if shape is None or len(shape) != len(rest):
        return False
    if not all(map(isinstance, rest, shape)):
        return False
    if number != TAKE:
        return isfinite(rest[0])
    try:
        return bool(_OUTPUTS.decode(rest[0])) or rest[0] == NOTHING
    except msgspec.DecodeError:
        return False


def _last(frame: bytes) -> float:
    """The agent's time of a frame's last entry that has one, s."""
    entries: Iterable[Entry] = reversed(_unpacked(frame))
    return next((float(entry[1]) for entry in entries if entry[0] != TAKE), 0.0)
