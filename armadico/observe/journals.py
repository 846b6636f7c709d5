"""Agents' journals (`core.journal`) described, and read back from a recording.

A journal begins with a `Head`: who the agent is, and all that its decisions hang on besides what
the journal tells: its parameters, the state of its random numbers, what stood in the files that its
parameters name. Journals are read as far as they go: a piece that was lost is a gap, beyond which
nobody knows what the agent had in mind.
"""

from __future__ import annotations

import zlib
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from hashlib import sha256
from math import isfinite
from pathlib import Path
from random import Random
from typing import Annotated, Any, Final

import msgspec
from msgspec import Meta, Struct, msgpack
from msgspec.structs import replace

from armadico.config.profile import load_profile
from armadico.config.worlds import load_world
from armadico.core import journal as j
from armadico.core.agent import Agent
from armadico.core.journal import FORMAT, NOTHING, START, TAKE
from armadico.core.messages import PROTOCOL, JournalPiece, MessageError, decode
from armadico.core.services import service_of
from armadico.observe.conditions import digest, software

JOURNAL: Final = service_of(JournalPiece).key_for(instance="")
"""How the keys begin on which journals are published."""

LARGEST_FRAME: Final = 64_000_000
"""Bytes that a frame may come to: a damaged one asks for no more memory."""

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
class Journal:
    """The journal of one instance, as far as a recording has it."""

    namespace: str
    name: str
    instance: str
    head: Head | None  # none: it cannot be gone through again; `fault` says why
    fault: str  # what is wrong with it, or missing; empty if it is whole
    frames: tuple[tuple[int, bytes], ...]  # when it was received, ns since 1970, and the frame

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

    @property
    def size(self) -> int:
        """Bytes of its frames."""
        return sum(len(frame) for _, frame in self.frames)

    @property
    def began(self) -> float:
        """When the agent began, s since 1970 by the recorder's clock."""
        try:
            start = next(self.entries(), None)
        except ValueError:  # a damaged one: `entries` says so
            start = None
        return self.offset + (float(start[1]) if start else 0.0)

    @property
    def offset(self) -> float:
        """What the recorder's clock showed when the agent's showed 0, s: at most so much later.

        The least of what some frames say: each was on its way for a while.
        """
        some = self.frames[:: max(len(self.frames) // SAMPLES, 1)]
        found: list[float] = []
        for at, frame in some:
            with suppress(ValueError):  # a damaged one: `entries` says so
                found.append(at / 1e9 - _last(frame))
        return min(found, default=0.0)


class Pieces:
    """Takes the pieces of all journals of a recording, in any order, and puts them together."""

    def __init__(self) -> None:
        self._pieces: dict[tuple[str, str], dict[int, tuple[int, bytes]]] = defaultdict(dict)

    def take(self, namespace: str, data: bytes, at: int) -> None:
        """One piece as it was published, at a time (ns since 1970); what is none is left out."""
        try:
            piece = decode(data, JournalPiece)
        except MessageError:
            return
        self._pieces[namespace, piece.instance].setdefault(piece.number, (at, piece.data))

    def journals(self) -> list[Journal]:
        """All journals, by the times at which they began."""
        found = [_journal(*who, pieces) for who, pieces in self._pieces.items()]
        return sorted(found, key=lambda one: (one.frames[0][0] if one.frames else 0, one.instance))


def without(namespace: str, instance: str) -> Journal:
    """An agent that was there, and of whose journal nothing was recorded."""
    why = "it kept no journal: agents that are started with --journal do, or by run --record"
    return Journal(namespace, instance.rpartition("-")[0], instance, None, why, ())


def _journal(namespace: str, instance: str, pieces: Mapping[int, tuple[int, bytes]]) -> Journal:
    name = instance.rpartition("-")[0]
    frames, fault = [], ""
    first, last = min(pieces), max(pieces)
    if first:
        fault = "the recording began after the agent did: the beginning of its journal is missing"
        return Journal(namespace, name, instance, None, fault, ())
    lost = next((number for number in range(last + 1) if number not in pieces), None)
    whole = range(last + 1 if lost is None else lost)
    if lost is not None:
        fault = f"a gap: piece {lost} of {last + 1} of its journal was lost"
    waiting, since = b"", None
    for number in whole:
        at, data = pieces[number]
        waiting, since = waiting + data, at
        while len(waiting) >= 4 and len(waiting) >= 4 + int.from_bytes(waiting[:4], "big"):
            end = 4 + int.from_bytes(waiting[:4], "big")
            frames.append((since, waiting[4:end]))
            waiting = waiting[end:]
    if waiting:
        fault = fault or "its last piece is not whole"
    head, why = _head(frames[0][1]) if frames else (None, "nothing of its journal was recorded")
    return Journal(namespace, name, instance, head, why or fault, tuple(frames))


def _head(frame: bytes) -> tuple[Head | None, str]:
    try:
        start = _unpacked(frame)[0]
        if start[0] != START:
            raise ValueError("no start")
        plain = msgpack.decode(start[3])
        version = plain["format"]
        if version != FORMAT:
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
