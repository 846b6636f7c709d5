"""Agents' journals (`core.journal`): their head, and reading them from a recording.

A journal begins with a `Head`: the agent's identity, and all that its decisions depend on besides
the entries: its parameters, the state of its random numbers, and the files that its parameters
name. A journal is read up to its first missing piece, because the agent's state beyond is unknown.
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
from armadico.core.membership import agent_of
from armadico.core.messages import (
    OLDEST,
    PROTOCOL,
    JournalPiece,
    MessageError,
    decode,
    protocols,
)
from armadico.core.services import service_of
from armadico.observe.conditions import digest, software

JOURNAL: Final = service_of(JournalPiece).key_for(instance="")  # prefix of the keys of journals

# Largest uncompressed frame, bytes: limits the memory that a damaged frame can claim.
LARGEST_FRAME: Final = 64_000_000

LENGTH: Final = 4  # bytes of the length before each frame
SAMPLES: Final = 20  # frames used to estimate the offset between two clocks

Entry = list[Any]  # see `core.journal`
Place = Any  # of a piece's content, as its reader knows it; by default the content itself

_ENTRIES: Final = msgpack.Decoder(list[Annotated[Entry, Meta(min_length=2)]])

_TIME: Final = (float, int)
_ANY: Final = (object,)

_SHAPES: Final[Mapping[int, tuple[tuple[type, ...], ...]]] = {  # by number, types of the rest
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
    j.GUARDED: (_TIME, _TIME, _TIME),
    j.BRAKED: (_TIME,),
    j.LATCH: (_TIME, (str,)),
    j.SLOW: (_TIME, _TIME),
    j.REFUSE: (_TIME, (str,), (str,)),
    j.REPORT: (_TIME, (dict,)),
    TAKE: ((bytes,), (*_TIME, type(None))),
}

_OUTPUTS: Final = msgpack.Decoder(list[Annotated[list[object], Meta(min_length=1)]])


class Head(Struct, frozen=True, kw_only=True):
    """An agent's identity, and what its decisions depend on besides its inputs."""

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
    files: dict[str, str]  # hashes of the files that its parameters name, by parameter
    commit: str  # of the code that it ran
    source: str  # hash of that code
    table: str = ""  # the digests in its card, of its host table and its map
    map: str = ""


def head(agent: Agent) -> bytes:
    """The head of an agent's journal. Raises ConfigError if a file that it names is missing."""
    identity, kind = agent.identity, type(agent)
    version, words, gauss = agent.kernel.drawn
    code = software()
    return msgpack.encode(
        Head(
            format=FORMAT,
            protocol=identity.protocol,
            name=agent.name,
            instance=agent.instance,
            host=identity.host,
            pid=identity.pid,
            table=identity.table,
            map=identity.map,
            version=identity.version,
            kind=f"{kind.__module__}:{kind.__qualname__}",
            parameters=msgspec.to_builtins(agent.p),
            random=(version, b"".join(word.to_bytes(4, "big") for word in words), gauss),
            files=files(agent.p),
            commit=code.commit,
            source=code.source,
        )
    )


def stream(state: tuple[int, bytes, float | None]) -> Random:
    """A random generator with the state of a head. Raises ValueError if that is invalid."""
    version, words, gauss = state
    drawn = tuple(int.from_bytes(words[i : i + 4], "big") for i in range(0, len(words), 4))
    made = Random()
    made.setstate((version, drawn, gauss))
    return made


def files(parameters: object) -> dict[str, str]:
    """Hashes of the files that parameters name: world, profile and map, by parameter.

    Other parameters of third-party agents are ignored. Raises ConfigError.
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
    # A saved map is a .yaml file and an image beside it.
    path, found = Path(name), sha256()
    for each in sorted(path.parent.glob(f"{path.stem}.*")):
        found.update(each.read_bytes())
    return found.hexdigest()[:16]


_READ: Final[Mapping[str, Callable[[str], str]]] = {
    "world": _world,
    "profile": _profile,
    "resume": _map,
}


# Reading ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Frames:
    """The frames of a journal, read from its pieces one after another.

    Only the places of the pieces are in memory: the journals of a day do not fit.
    """

    pieces: tuple[tuple[int, Place], ...] = ()  # time of arrival, ns since 1970, and place
    read: Callable[[Iterable[Place]], Iterator[bytes]] = iter  # places to pieces
    size: int = 0  # bytes

    def __bool__(self) -> bool:
        return bool(self.pieces)

    def __iter__(self) -> Iterator[tuple[int, bytes]]:
        """Each frame and its time of arrival, ns since 1970. Raises ValueError and OSError."""
        for at, frame in self.parts():
            if at is not None:
                yield at, frame

    def parts(self) -> Iterator[tuple[int | None, bytes]]:
        """Like iteration; an incomplete last frame follows with None as its time."""
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
    """The journal of one instance, as far as it was recorded."""

    namespace: str
    name: str
    instance: str
    head: Head | None  # none: it cannot be replayed, because of `fault`
    fault: str  # what is damaged or missing; empty if it is complete
    frames: Frames

    def entries(self) -> Iterator[Entry]:
        """The entries in order. Raises ValueError where the journal is damaged."""
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
        """When the agent started, s since 1970 by the recorder's clock."""
        try:
            start = next(self.entries(), None)
        except ValueError:  # damaged: `entries` reports it
            start = None
        return self.offset + (float(start[1]) if start else 0.0)

    @property
    def received(self) -> int:
        """When its first piece was received, ns since 1970; 0 without pieces."""
        return self.frames.pieces[0][0] if self.frames else 0

    @property
    def offset(self) -> float:
        """The recorder's clock minus the agent's clock, s: an upper bound.

        It is the minimum over some frames, because each was delayed on its way.
        """
        found: list[float] = []
        some = islice(self.frames, 0, None, max(len(self.frames.pieces) // SAMPLES, 1))
        with suppress(ValueError):  # the file has changed: `entries` reports it
            for at, frame in some:
                with suppress(ValueError):  # damaged: `entries` reports it
                    found.append(at / 1e9 - _last(frame))
        return min(found, default=0.0)


class Pieces:
    """Assembles the journals of a recording from pieces in any order."""

    def __init__(self, read: Callable[[Iterable[Place]], Iterator[bytes]] = iter) -> None:
        """Start without pieces.

        `read` returns the contents of the pieces at given places, in order. By default a place is
        the content itself. It is pickled with a journal.
        """
        self._read = read
        self._pieces: dict[tuple[str, str], dict[int, _Piece]] = defaultdict(dict)

    def add(self, namespace: str, data: bytes, at: int, place: Place = None) -> None:
        """Add a published piece, received at a time (ns since 1970); ignore invalid payloads."""
        try:
            piece = decode(data, JournalPiece)
        except MessageError:
            return
        held = piece.data
        kept = _Piece(at, held if place is None else place, len(held), held[:LENGTH])
        self._pieces[namespace, piece.instance].setdefault(piece.number, kept)

    def journals(self) -> list[Journal]:
        """All journals, in the order of their first pieces."""
        found = [_journal(*agent, pieces, self._read) for agent, pieces in self._pieces.items()]
        return sorted(found, key=lambda one: (one.received, one.instance))


class _Piece(NamedTuple):
    """One piece of a journal, without its content."""

    at: int  # when it was received, ns since 1970
    place: Place
    size: int
    begins: bytes  # its first bytes


def without(namespace: str, instance: str) -> Journal:
    """The empty journal of an agent that was alive, but of which no piece was recorded."""
    why = "it kept no journal: start agents with --journal, or use run --record"
    return Journal(namespace, agent_of(instance), instance, None, why, Frames())


def _journal(
    namespace: str,
    instance: str,
    pieces: Mapping[int, _Piece],
    read: Callable[[Iterable[Place]], Iterator[bytes]],
) -> Journal:
    name, fault = agent_of(instance), ""
    first, last = min(pieces), max(pieces)
    if first:
        fault = "the recording began after the agent started: its journal's beginning is missing"
        return Journal(namespace, name, instance, None, fault, Frames())
    lost = next((number for number in range(last + 1) if number not in pieces), None)
    whole = [pieces[number] for number in range(last + 1 if lost is None else lost)]
    if lost is not None:
        fault = f"a gap: piece {lost} of {last + 1} of its journal is missing"
    frames = Frames(tuple((p.at, p.place) for p in whole), read, sum(p.size for p in whole))
    if not fault and not _is_whole(whole, frames):
        fault = "its last piece is incomplete"
    _, first_frame = next(frames.parts(), (None, b""))
    head, why = _head(first_frame) if first_frame else (None, "nothing of its journal was recorded")
    return Journal(namespace, name, instance, head, why or fault, frames)


def _is_whole(pieces: Sequence[_Piece], frames: Frames) -> bool:
    """Whether the last frame ends with the last piece.

    Journals are written so that each frame begins with a piece; others are read completely.
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
        protocol = plain["protocol"]
        if not OLDEST <= protocol <= PROTOCOL:
            return None, f"it used protocol {protocol}; this program reads {protocols()}"
        return msgspec.convert(plain, Head), ""
    except (ValueError, TypeError, KeyError, IndexError):  # msgspec's are ValueErrors
        return None, "its journal does not begin with a valid head"


def _unpacked(frame: bytes) -> list[Entry]:
    """The entries of a frame. Raises ValueError if it is damaged."""
    try:
        unpacker = zlib.decompressobj()
        data = unpacker.decompress(frame, LARGEST_FRAME)
        if not unpacker.eof:
            raise ValueError("a frame is too long or incomplete")
        entries = _ENTRIES.decode(data)
    except (zlib.error, msgspec.DecodeError) as error:
        raise ValueError(str(error)) from None
    for entry in entries:
        if not _sound(entry):
            raise ValueError(f"not an entry of a journal: {entry[0]!r:.20}")
    return entries


def _sound(entry: Entry) -> bool:
    """Whether an entry has the types that `core.journal` defines."""
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
