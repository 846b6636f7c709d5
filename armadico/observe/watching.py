"""What watchers share: all messages in order of arrival, with their times.

A watcher is a guest: it has no token, agents do not see it, and nothing that it does is waited for.
Unlike an agent it keeps every message, states too, since the one that was overtaken may be the one
that explains what happened. The queue is bounded; what it had no room for is counted.
"""

from __future__ import annotations

import queue
import time
from collections.abc import Iterator, Sequence
from enum import Enum
from functools import cache
from typing import TYPE_CHECKING, Any, Final, TypeVar

import msgspec
from msgspec import inspect

from armadico.core.messages import Ask, JournalRequest, Message, MessageError, decode
from armadico.core.services import BIDS, CARD, Kind, service_at, service_of

if TYPE_CHECKING:
    from armadico.mesh.zenoh import ZenohMesh
    from armadico.observe.view import View
    from armadico.observe.why import Chronicle

M = TypeVar("M", bound=Message)

WAITING: Final = 20_000
"""What may wait for a watcher that is busy: at 20 agents, half a minute's talk."""

ASK_S: Final = 1.0
"""How often everybody is asked for their bids and cards, by whoever watches."""

EVERYTHING: Final = "**"

HEX: Final = "_hex"
"""Ends the name of a field that is bytes, written as hexadecimal text."""


class Heard(msgspec.Struct, frozen=True):
    """One payload, and when it came (ns of the watcher's clock)."""

    namespace: str
    key: str
    data: bytes
    at: int
    asked: bool = False  # a reply to a query of the watcher's, not a publication


class Presence(msgspec.Struct, frozen=True):
    """A liveliness token came or went."""

    namespace: str
    name: str
    instance: str
    there: bool
    at: int


class Clock:
    """Wall time that never steps back: read once, then counted on by the monotonic clock."""

    def __init__(self) -> None:
        self._offset = time.time_ns() - time.monotonic_ns()

    def __call__(self) -> int:
        return time.monotonic_ns() + self._offset


class Watcher:
    """Listens on one mesh for each namespace; they have been opened, and are closed, elsewhere."""

    def __init__(self, meshes: Sequence[ZenohMesh], waiting: int = WAITING) -> None:
        self.meshes = tuple(meshes)
        self.clock = Clock()
        self.dropped = 0  # what there was no room for
        self._queue: queue.Queue[Heard | Presence] = queue.Queue(waiting)

    def subscribe(self, pattern: str = EVERYTHING) -> None:
        """Keep messages published on matching keys, in every namespace."""
        for mesh in self.meshes:
            mesh.subscribe(pattern, self._receiver(mesh.namespace, asked=False))

    def watch_alive(self) -> None:
        """Keep tokens as they come and go, in every namespace."""
        for mesh in self.meshes:

            def changed(name: str, instance: str, there: bool, ns: str = mesh.namespace) -> None:
                self._put(Presence(ns, name, instance, there, self.clock()))

            mesh.watch_alive(changed)

    def watch_router(self, view: View) -> None:
        """Have a view know whether the robot's router can be reached, at once as it changes."""
        for mesh in self.meshes:
            mesh.watch_router(lambda there: view.router(there=there, t=self.clock() / 1e9))

    def ask(self, pattern: str, timeout: float) -> None:
        """Put an empty question; the replies are kept as they come."""
        for mesh in self.meshes:
            mesh.ask(
                pattern, Ask(), timeout, self._receiver(mesh.namespace, asked=True), lambda: None
            )

    def ask_for_piece(self, namespace: str, instance: str, number: int, timeout: float) -> None:
        """Ask an instance for a piece of its journal again."""
        key = service_of(JournalRequest).key_for(instance=instance)
        for mesh in self.meshes:
            if mesh.namespace == namespace:
                taken = self._receiver(namespace, asked=True)
                mesh.ask(key, JournalRequest(number), timeout, taken, lambda: None)

    def ask_for_cards(self, timeout: float = 1.0) -> None:
        self.ask(CARD.key_for(name="*", instance="*"), timeout)

    def ask_for_bids(self, timeout: float = 1.0) -> None:
        """Query everybody's recent bids, losers' too."""
        self.ask(BIDS.key_for(name="*", instance="*"), timeout)

    def get(self, timeout: float) -> Heard | Presence | None:
        """The next thing that came; None if nothing does within `timeout` (s)."""
        try:
            return self._queue.get(block=timeout > 0, timeout=max(timeout, 0.0))
        except queue.Empty:
            return None

    def until(self, deadline: float) -> Iterator[Heard | Presence]:
        """What comes until a time of `time.monotonic` (s)."""
        while (left := deadline - time.monotonic()) > 0:
            item = self.get(left)
            if item is not None:
                yield item

    def _receiver(self, namespace: str, *, asked: bool) -> Any:
        def arrived(key: str, data: bytes) -> None:
            self._put(Heard(namespace, key, data, self.clock(), asked))

        return arrived

    def _put(self, item: Heard | Presence) -> None:
        try:
            self._queue.put_nowait(item)
        except queue.Full:
            self.dropped += 1


# What a payload is --------------------------------------------------------------------------------


def kind_at(key: str) -> type[Message] | None:
    """The message that is published, or replied, on a key; None if no service has that key."""
    service = service_at(key)
    if service is None:
        return None
    return service.reply if service.kind is Kind.QUERY else service.message


def read(heard: Heard) -> Message | None:
    """The message in a payload; None if its key is not known. Raises MessageError."""
    kind = kind_at(heard.key)
    return None if kind is None else decode(heard.data, kind)


def read_or_none(heard: Heard) -> Message | None:
    """The message in a payload, if there is one."""
    try:
        return read(heard)
    except MessageError:
        return None


def show(view: View | Chronicle, item: Heard | Presence) -> None:
    """Have a view, or a chronicle, know of one thing that came."""
    if isinstance(item, Presence):
        view.token(item.instance, there=item.there, t=item.at / 1e9)
        return
    message = read_or_none(item)
    if not item.asked:
        view.update(item.key, message, item.at / 1e9)
    elif message is not None:
        view.learn(message, item.at / 1e9)


def listen(watcher: Watcher, to: View | Chronicle, for_s: float) -> None:
    """Show a view what comes for so long (s), and have everybody asked for cards and bids."""
    end = time.monotonic() + for_s
    while (now := time.monotonic()) < end:
        watcher.ask_for_cards()
        watcher.ask_for_bids()
        for item in watcher.until(min(end, now + ASK_S)):
            show(to, item)


def as_object(value: Any) -> Any:
    """A message as a dictionary by field names, through and through; what is None is left out.

    So a number that may be missing is a number in the schema, which is what plotting tools expect.
    An action that is a message, encoded, is hexadecimal text in a field of its own, `<name>_hex`.
    """
    if isinstance(value, msgspec.Struct):
        fields = ((name, getattr(value, name)) for name in value.__struct_fields__)
        return {
            name + HEX if isinstance(found, bytes) else name: as_object(found)
            for name, found in fields
            if found is not None
        }
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, tuple | list):
        return [as_object(each) for each in value]
    return value.value if isinstance(value, Enum) else value


def from_object(kind: type[M], found: Any) -> M:
    """The message that `as_object` was given. Raises MessageError."""
    try:
        plain = _arrays(_type_info(kind), found)
        return msgspec.convert(plain, kind)
    except (msgspec.ValidationError, TypeError, ValueError, AttributeError) as error:
        raise MessageError(f"not a {kind.__name__}: {error}") from None


_type_info = cache(inspect.type_info)


def _arrays(kind: inspect.Type, found: Any) -> Any:
    """Objects back to the arrays that messages travel as."""
    if isinstance(kind, inspect.StructType):
        return [_field(field, found) for field in kind.fields]
    if isinstance(kind, inspect.UnionType):
        return None if found is None else _arrays(_not_none(kind), found)
    if isinstance(kind, inspect.VarTupleType):
        return [_arrays(kind.item_type, each) for each in found]
    return found


def _field(field: inspect.Field, found: dict[str, Any]) -> Any:
    """One field; one that an older recording does not have is as its default."""
    if field.name + HEX in found:
        return bytes.fromhex(found[field.name + HEX])
    if field.name in found or field.default is msgspec.NODEFAULT:
        return _arrays(field.type, found.get(field.name))
    return msgspec.to_builtins(field.default)


@cache
def json_schema(kind: type[msgspec.Struct]) -> dict[str, Any]:
    """The JSON schema of `as_object`'s result: no references and no unions, which few read."""
    return {"title": kind.__name__, **_schema(inspect.type_info(kind))}


def _schema(kind: inspect.Type) -> dict[str, Any]:
    if isinstance(kind, inspect.StructType):
        optional = {f.name for f in kind.fields if isinstance(f.type, inspect.UnionType)}
        raw = {f.name for f in kind.fields if isinstance(f.type, inspect.BytesType)}
        encoded = {f.name + HEX: {"type": "string"} for f in kind.fields if _may_be_bytes(f.type)}
        return {
            "type": "object",
            "properties": {f.name: _schema(f.type) for f in kind.fields if f.name not in raw}
            | encoded,
            "required": [f.name for f in kind.fields if f.name not in optional | raw],
        }
    if isinstance(kind, inspect.UnionType):
        return _schema(_not_none(kind))
    if isinstance(kind, inspect.VarTupleType):
        return {"type": "array", "items": _schema(kind.item_type)}
    return {"type": _SCALARS[type(kind)]}


_SCALARS: Final[dict[type[inspect.Type], str]] = {
    inspect.BoolType: "boolean",
    inspect.IntType: "integer",
    inspect.FloatType: "number",
    inspect.StrType: "string",
    inspect.EnumType: "string",
}


def _may_be_bytes(kind: inspect.Type) -> bool:
    among = kind.types if isinstance(kind, inspect.UnionType) else (kind,)
    return any(isinstance(each, inspect.BytesType) for each in among)


def _not_none(kind: inspect.UnionType) -> inspect.Type:
    """What it is, unless it is missing, or bytes: those have a field of their own."""
    aside = (inspect.NoneType, inspect.BytesType)
    (only,) = (each for each in kind.types if not isinstance(each, aside))
    return only
