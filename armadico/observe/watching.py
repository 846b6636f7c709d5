"""Observation of a society: all messages in order of arrival, with times.

A watcher has no liveliness token, so agents do not see it, and no agent waits for it. Unlike an
agent it keeps superseded states too, because they may explain what happened. Its queue is bounded;
dropped messages are counted.
"""

from __future__ import annotations

import queue
import time
from collections.abc import Container, Iterator, Sequence
from enum import Enum
from functools import cache
from typing import TYPE_CHECKING, Any, Final, Protocol, TypeVar

import msgspec
from msgspec import inspect

from armadico.core.messages import Ask, Card, JournalRequest, Message, MessageError, decode
from armadico.core.services import BIDS, CARD, Kind, service_at, service_of
from armadico.observe.diagnosis import diagnose, settled
from armadico.observe.findings import NOTHING, Demand, Finding, Sort
from armadico.observe.jsons import JsonObject
from armadico.observe.view import View

if TYPE_CHECKING:
    from armadico.mesh.base import Receiver
    from armadico.mesh.zenoh import ZenohMesh

M = TypeVar("M", bound=Message)

WAITING: Final = 20_000  # capacity of the queue: half a minute of messages of 20 agents
QUERY_S: Final = 1.0  # interval of the queries for cards and bids
LEAST_S: Final = 1.2  # within this time each description, mission status and card has arrived
MOST_S: Final = 4.5  # longest observation of a short command
EVERYTHING: Final = "**"
_EMPTY: Final = Ask()
HEX: Final = "_hex"  # suffix of the name of a field of bytes, written as hexadecimal text


class Received(msgspec.Struct, frozen=True):
    """One payload and its time of arrival (ns of the watcher's clock)."""

    namespace: str
    key: str
    data: bytes
    at: int
    on_query: bool = False  # a reply to a query of the watcher's, not a publication


class Presence(msgspec.Struct, frozen=True):
    """A liveliness token appeared or disappeared."""

    namespace: str
    name: str
    instance: str
    there: bool
    at: int


class Clock:
    """Wall time (ns) that never steps: read once, then advanced by the monotonic clock."""

    def __init__(self) -> None:
        self._offset = time.time_ns() - time.monotonic_ns()

    def __call__(self) -> int:
        return time.monotonic_ns() + self._offset


class Watcher:
    """Receives messages on one mesh per namespace; the caller opens and closes the meshes."""

    def __init__(self, meshes: Sequence[ZenohMesh], waiting: int = WAITING) -> None:
        self.meshes = tuple(meshes)
        self.clock = Clock()
        self.dropped = 0  # messages that did not fit into the queue
        self._queue: queue.Queue[Received | Presence] = queue.Queue(waiting)

    def subscribe(self, pattern: str = EVERYTHING) -> None:
        """Receive messages on matching keys, in every namespace."""
        for mesh in self.meshes:
            mesh.subscribe(pattern, self._receiver(mesh.namespace, on_query=False))

    def watch_alive(self) -> None:
        """Receive changes of liveliness tokens, in every namespace."""
        for mesh in self.meshes:

            def changed(name: str, instance: str, there: bool, ns: str = mesh.namespace) -> None:
                self._put(Presence(ns, name, instance, there, self.clock()))

            mesh.watch_alive(changed)

    def watch_router(self, view: View) -> None:
        """Report to a view whenever the robot's router becomes reachable or unreachable."""
        for mesh in self.meshes:
            mesh.watch_router(lambda there: view.router(there=there, t=self.clock() / 1e9))

    def query(self, pattern: str, timeout: float, request: Message = _EMPTY) -> None:
        """Send a query, by default an empty one; the replies are queued as they arrive."""
        for mesh in self.meshes:
            receiver = self._receiver(mesh.namespace, on_query=True)
            mesh.query(pattern, request, timeout, receiver, lambda: None)

    def query_piece(self, namespace: str, instance: str, number: int, timeout: float) -> None:
        """Query a piece of an instance's journal again."""
        key = service_of(JournalRequest).key_for(instance=instance)
        for mesh in self.meshes:
            if mesh.namespace == namespace:
                on_reply = self._receiver(namespace, on_query=True)
                mesh.query(key, JournalRequest(number), timeout, on_reply, lambda: None)

    def query_cards(self, timeout: float = 1.0) -> None:
        self.query(CARD.key_for(name="*", instance="*"), timeout)

    def query_bids(self, timeout: float = 1.0) -> None:
        """Query the recent bids of all agents, including those that lost."""
        self.query(BIDS.key_for(name="*", instance="*"), timeout)

    def get(self, timeout: float) -> Received | Presence | None:
        """The next item; None if none arrives within `timeout` (s)."""
        try:
            return self._queue.get(block=timeout > 0, timeout=max(timeout, 0.0))
        except queue.Empty:
            return None

    def until(self, deadline: float) -> Iterator[Received | Presence]:
        """The items that arrive until a time of `time.monotonic` (s)."""
        while (left := deadline - time.monotonic()) > 0:
            item = self.get(left)
            if item is not None:
                yield item

    def _receiver(self, namespace: str, *, on_query: bool) -> Receiver:
        def arrived(key: str, data: bytes) -> None:
            self._put(Received(namespace, key, data, self.clock(), on_query))

        return arrived

    def _put(self, item: Received | Presence) -> None:
        try:
            self._queue.put_nowait(item)
        except queue.Full:
            self.dropped += 1


# Decoding -----------------------------------------------------------------------------------------


def kind_at(key: str) -> type[Message] | None:
    """The type of message published or replied on a key; None if no service has the key."""
    service = service_at(key)
    if service is None:
        return None
    return service.reply if service.kind is Kind.QUERY else service.message


def read(item: Received) -> Message | None:
    """The message in a payload; None if its key is unknown. Raises MessageError."""
    kind = kind_at(item.key)
    return None if kind is None else decode(item.data, kind)


def read_or_none(item: Received) -> Message | None:
    """The message in a payload; None if its key is unknown or it cannot be decoded."""
    try:
        return read(item)
    except MessageError:
        return None


class Account(Protocol):
    """What receives all of a society as a view does, and keeps one."""

    @property
    def view(self) -> View: ...

    def token(self, instance: str, *, there: bool, t: float) -> None: ...

    def update(self, key: str, message: Message | None, t: float) -> None: ...

    def learn(self, message: Message, t: float) -> None: ...


def show(to: View | Account, item: Received | Presence) -> None:
    """Pass one item to a view or an account."""
    t = item.at / 1e9
    if isinstance(item, Presence):
        to.token(item.instance, there=item.there, t=t)
        return
    message = read_or_none(item)
    if not item.on_query:
        to.update(item.key, message, t)
    elif message is not None:
        to.learn(message, t)
        if isinstance(message, Card) and message.clock:
            view = to if isinstance(to, View) else to.view
            view.ahead[message.instance] = message.clock - t


class Observer:
    """Observes one society: a watcher, the view that it updates, and queries once per second."""

    def __init__(
        self, mesh: ZenohMesh, demand: Demand = NOTHING, to: View | Account | None = None
    ) -> None:
        """Subscribe on an open mesh. `to` receives everything; by default a new view."""
        self.watcher, self.demand = Watcher([mesh]), demand
        self.to: View | Account = View() if to is None else to
        self.view = self.to if isinstance(self.to, View) else self.to.view
        self._query_at = float("-inf")
        # The time up to which the view knows everything, by its clock, s. Judging takes time in
        # which nothing is received, and that is no silence.
        self.now = self.watcher.clock() / 1e9
        self.view.begin(self.now)
        self.watcher.watch_alive()
        self.watcher.watch_router(self.view)
        self.watcher.subscribe()

    def take(self, for_s: float = 0.0) -> None:
        """Receive for a time, s; 0: take what has arrived."""
        end = time.monotonic() + for_s
        while True:
            if (now := time.monotonic()) >= self._query_at:
                self._query_at = now + (QUERY_S if self.view.complete else QUERY_S / 4)
                self.view.ask(self.watcher.clock() / 1e9)
                self.watcher.query_cards()
                self.watcher.query_bids()
            for item in self.watcher.until(min(end, self._query_at)):
                show(self.to, item)
            if time.monotonic() >= end:
                break
        over = self.watcher.clock()  # what arrived during a slow step still counts
        self.now = over / 1e9
        while (arrived := self.watcher.get(0.0)) is not None:
            show(self.to, arrived)
            if arrived.at > over:
                break

    def settle(
        self, least_s: float = LEAST_S, most_s: float = MOST_S, of: Container[Sort] | None = None
    ) -> tuple[Finding, ...]:
        """The diagnosis, as soon as a longer observation would change no finding of these codes."""
        self.take(least_s)
        end = time.monotonic() + most_s - least_s
        while not settled(found := self.findings, of) and time.monotonic() < end:
            self.take(QUERY_S / 4)
        return found

    @property
    def findings(self) -> tuple[Finding, ...]:
        """The diagnosis of what was received so far."""
        return diagnose(self.view, self.demand, self.now)


def as_object(value: object) -> object:
    """A message as a nested dictionary by field names; fields that are None are omitted.

    An optional number thus stays a number in the schema, as plotting tools expect. Encoded bytes
    become hexadecimal text in a separate field, `<name>_hex`.
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


def from_object(kind: type[M], found: object) -> M:
    """The message from a result of `as_object`. Raises MessageError."""
    try:
        plain = _arrays(_type_info(kind), found)
        return msgspec.convert(plain, kind)
    except (msgspec.ValidationError, TypeError, ValueError, AttributeError) as error:
        raise MessageError(f"not a {kind.__name__}: {error}") from None


_type_info = cache(inspect.type_info)


def _arrays(kind: inspect.Type, found: Any) -> object:
    """Objects converted back to the arrays of the wire format."""
    if isinstance(kind, inspect.StructType):
        return [_field(field, found) for field in kind.fields]
    if isinstance(kind, inspect.UnionType):
        return None if found is None else _arrays(_not_none(kind), found)
    if isinstance(kind, inspect.VarTupleType):
        return [_arrays(kind.item_type, each) for each in found]
    return found


def _field(field: inspect.Field, found: dict[str, Any]) -> object:
    """The value of one field; its default if an older recording lacks it."""
    if field.name + HEX in found:
        return bytes.fromhex(found[field.name + HEX])
    if field.name in found or field.default is msgspec.NODEFAULT:
        return _arrays(field.type, found.get(field.name))
    return msgspec.to_builtins(field.default)


@cache
def json_schema(kind: type[msgspec.Struct]) -> JsonObject:
    """The JSON schema of `as_object`'s result, without references and unions (little support)."""
    return {"title": kind.__name__, **_schema(inspect.type_info(kind))}


def _schema(kind: inspect.Type) -> JsonObject:
    if isinstance(kind, inspect.StructType):
        optional = {f.name for f in kind.fields if isinstance(f.type, inspect.UnionType)}
        raw = {f.name for f in kind.fields if isinstance(f.type, inspect.BytesType)}
        text: JsonObject = {"type": "string"}
        encoded = {f.name + HEX: text for f in kind.fields if _may_be_bytes(f.type)}
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
    inspect.LiteralType: "string",
}


def _may_be_bytes(kind: inspect.Type) -> bool:
    among = kind.types if isinstance(kind, inspect.UnionType) else (kind,)
    return any(isinstance(each, inspect.BytesType) for each in among)


def _not_none(kind: inspect.UnionType) -> inspect.Type:
    """The type of an optional field without None and bytes (which have their own field)."""
    aside = (inspect.NoneType, inspect.BytesType)
    (only,) = (each for each in kind.types if not isinstance(each, aside))
    return only
