"""The table of services: each message's key, rate and freshness.

Freshness checks and the protocol page use it. The framework's own rows are here; every other
message has its row beside it, added when its module is imported. A package names its modules of
messages by entry points in the group `armadico.messages`; the whole table (`services`) imports all
that are installed. Agents' classes and cards have which of them provide and request a service. A
resource needs no row: its keys come from its declaration (`armadico.core.resources.Resource`).
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum
from functools import cache
from math import inf
from operator import attrgetter
from typing import Final, Never, Protocol

from armadico.core import messages as m
from armadico.core.cycles import PERIOD
from armadico.core.installed import load_all
from armadico.core.resources import declared

QUIET_S: Final = 0.5  # shortest timeout of an observer, whose machine may be busy, s


class Kind(Enum):
    """How a service is published and kept."""

    STATE = "state"  # the latest value replaces the one before
    EVENT = "event"  # each one counts: queued, bounded, never merged
    LATCHED = "latched"  # every agent stores the newest, by its counter (armadico.core.latched)
    QUERY = "query"  # a request and its reply


class Gathering(Protocol):
    """Combines the newest messages of several publishers into one message."""

    def describe(self, description: m.Description) -> None:
        """Set the expected publishers by the robot's description."""

    def counts(self, message: Never) -> bool:
        """Return whether the message's publisher is expected."""

    def newest(self, message: Never) -> m.Message | None:
        """Return the newest message of this message's publisher."""

    def update(self, message: Never) -> m.Message | None:
        """Add a newer message; return the combined one, or None if a publisher is missing."""

    def missing(self, fresh: Callable[[m.Cycle], bool]) -> str:
        """Return the name of the first publisher without a fresh message; "" if there is none."""


@dataclass(frozen=True)
class Service:
    """One row. `key` holds {instance}, {name} or {resource} where it differs between publishers."""

    message: type[m.Message]
    key: str
    kind: Kind
    rate_hz: float | None  # of each publisher; None: irregular
    fresh_cycles: int | None  # older than this in cycles is stale; None: no cycle, never stale
    meaning: str
    reply: type[m.Message] | None = None
    watchers_only: bool = False
    gather: Callable[[], Gathering] | None = None
    """Combines the messages of several publishers into one, which agents receive."""
    sender: str = ""
    """The field of the message that names its publisher, as the last part of its key does."""
    people: bool = False
    """Only programs of people publish it, and no agent may (`by_people`)."""
    since: int = m.OLDEST
    """The protocol from which the last part of the key names the publisher. In older ones all
    publishers share the key without that part."""
    guests: bool = False
    """Whether programs that act for a person publish it, too."""
    named: bool = False
    """Of a query: in a society with keys each identity sends it on a key of its own, which ends
    with its name. So no identity can ask as another one."""

    @property
    def pattern(self) -> str:
        """The key expression that matches every publisher's key."""
        return expression(self.key)

    def asked_by(self, identity: str) -> str:
        """Return the key on which an identity sends a query; "": the society has no keys."""
        return f"{self.key}/{identity}" if self.named and identity else self.key

    def answered_at(self, key: str) -> str:
        """Return the key expression on which a query of a key is answered: of all that ask."""
        return f"{key}/**" if self.named else key

    def key_in(self, protocol: int) -> str:
        """Return the key that agents of a protocol publish on."""
        return self.key if protocol >= self.since else parent(self.key)

    def heard_in(self, protocol: int, **names: str) -> str:
        """Return the key expression that they subscribe to, with the keys of older protocols."""
        pattern = expression(self.key, **names)
        if self.since == m.OLDEST:
            return pattern
        return parent(pattern) + ("" if protocol < self.since else "/**")

    @property
    def heard(self) -> str:
        """The key expression that matches every publisher's key in all understood protocols."""
        return self.heard_in(m.PROTOCOL)

    def sender_of(self, message: m.Message) -> str:
        """Return the publisher that a message names; "" if it names none."""
        return str(_getter(self.sender)(message)) if self.sender else ""

    @property
    def deadline_s(self) -> float | None:
        """The longest time between two messages, s; None: unlimited.

        Only periodic states have one, as claims and commands end with a tenure. Without
        `fresh_cycles` it is two periods.
        """
        if self.kind is not Kind.STATE or self.rate_hz is None:
            return None
        return max((self.fresh_cycles or 0) * PERIOD, 2.0 / self.rate_hz)

    @property
    def stale_after_s(self) -> float:
        """The age from which a message is stale for an observer, s."""
        return inf if self.deadline_s is None else max(self.deadline_s, QUIET_S)

    def key_for(self, **names: str) -> str:
        """Return the key of one publisher. Raises KeyError if a name is missing."""
        return self.key.format(**names)


_getter: Final = cache(attrgetter)
_S, _E, _L, _Q = Kind.STATE, Kind.EVENT, Kind.LATCHED, Kind.QUERY
SPOKEN: Final = 3  # the protocol from which the keys of several publishers name the publisher


def _spoken(
    message: type[m.Message],
    key: str,
    kind: Kind,
    meaning: str,
    rate_hz: float | None = None,
    fresh_cycles: int | None = None,
    sender: str = "",
    *,
    guests: bool = False,
) -> Service:
    """Return a row of several publishers, each with its own last part of the key."""
    whole = f"{key}/{{instance}}"
    return Service(
        *(message, whole, kind, rate_hz, fresh_cycles, meaning),
        sender=sender,
        since=SPOKEN,
        guests=guests,
    )


def _each(
    message: type[m.Message],
    key: str,
    meaning: str,
    rate_hz: float | None = None,
    *,
    sender: str = "",
    people: bool = False,
    watchers_only: bool = False,
) -> Service:
    """Return a row of events, on a key of each publisher in all protocols."""
    fresh = None if rate_hz is None else 3
    key = f"{key}/{{instance}}"
    return Service(
        *(message, key, _E, rate_hz, fresh, meaning),
        sender=sender,
        people=people,
        watchers_only=watchers_only,
    )


def _asked(message: type[m.Message], key: str, meaning: str, reply: type[m.Message]) -> Service:
    """Return a row of a query."""
    return Service(message, key, _Q, None, None, meaning, reply)


_rows: list[Service] = [
    Service(m.RobotState, "robot/state", _S, 10, 3, "odometry, speeds, battery; moves the cycle"),
    Service(m.Description, "robot/description", _S, 1, None, "the robot's body and limits"),
    _each(m.Stop, "robot/release", "release the stop, if its press is this one", people=True),
    _spoken(m.Stop, "robot/stop", _L, "stop the robot; any process may", guests=True),
    _spoken(
        m.Claim, "resource/{resource}/utility", _E, "the holder's bid", 10, 3, "ballot.instance"
    ),
    Service(m.Ack, "resource/{resource}/ack", _S, 10, 3, "the obeyed and the largest ballot"),
    _each(
        *(m.Command, "resource/{resource}/cmd", "the holder's action", 10), sender="ballot.instance"
    ),
    _each(m.Command, "robot/cmd", "the same, for the wheels", 10, sender="ballot.instance"),
    _each(
        *(m.Proposal, "resource/{resource}/proposal", "a bid that is made to an arbiter", 10),
        sender="instance",
    ),
    _each(m.Award, "resource/{resource}/award", "an arbiter's decision", 10, sender="instance"),
    _asked(m.Ask, "agent/{name}/{instance}/card", "identity, offers", m.Card),
    _asked(m.Ask, "agent/{name}/{instance}/bids", "recent bids", m.BidHistory),
    _asked(
        *(m.ParametersRequest, "agent/{name}/{instance}/parameters"),
        "the parameters that may be changed live; change them",
        m.ParametersReply,
    ),
    _asked(
        *(m.Ask, "agent/{name}/{instance}/settings"),
        "the same, for programs that may not change them",
        m.ParametersReply,
    ),
    Service(m.ParameterChange, "agent/{name}/{instance}/changed", _E, None, None, "a changed one"),
    _spoken(m.Tuning, "tuning", _L, "an agent's parameters that were changed live"),
    _each(m.Repeat, "repeat", "a latched state of an agent that is gone"),
    Service(m.Void, "keys/void", _E, 2, None, "the keys that were revoked", watchers_only=True),
    Service(
        *(m.MonitorReport, "monitor/{instance}", _S, 1, None),
        "missing agents; which monitor acts",
        sender="instance",
    ),
    _each(m.Log, "log", "log lines for people"),
    _each(
        *(m.JournalPiece, "journal", "an agent's inputs and outputs, if it keeps a journal"),
        watchers_only=True,
    ),
    _asked(
        *(m.JournalRequest, "journal/{instance}/piece"),
        "a piece of it, while the agent keeps it",
        m.JournalPiece,
    ),
]

_by_message: dict[type[m.Message], Service] = {
    service.message: service for service in _rows if service.message is not m.Ask
}

STOP: Final = _by_message[m.Stop]
VOID: Final = _by_message[m.Void]
RELEASE: Final = next(s for s in _rows if s.people)
CARD = next(s for s in _rows if s.key.endswith("/card"))
BIDS = next(s for s in _rows if s.key.endswith("/bids"))
SETTINGS = next(s for s in _rows if s.key.endswith("/settings"))
TOKEN = "agent/{name}/{instance}"  # the key of a live instance's liveliness token


def register(service: Service) -> Service:
    """Add a row. Raises ValueError if the message or the key has another one."""
    known = _by_message.get(service.message)
    if known is not None and known != service:
        raise ValueError(f"{service.message.__name__} already travels on {known.key}")
    holder = next((row.message for row in _rows if row.key == service.key), service.message)
    if holder is not service.message:
        raise ValueError(
            f"{service.message.__name__}: {service.key} already carries {holder.__name__}"
        )
    if known is None:
        _rows.append(service)
        derived.cache_clear()
        _row_at.cache_clear()
        addressed.cache_clear()
    _by_message[service.message] = service
    return service


def services() -> tuple[Service, ...]:
    """Return the rows of all installed or imported messages: the framework's, then by module."""
    load_all()
    own = m.__name__
    return tuple(
        sorted(_rows, key=lambda row: (row.message.__module__ != own, row.message.__module__))
    )


def state(
    message: type[m.Message],
    key: str,
    rate_hz: float,
    fresh_cycles: int | None,
    meaning: str,
    *,
    watchers_only: bool = False,
    gather: Callable[[], Gathering] | None = None,
) -> Service:
    """Add a row of a state."""
    return register(
        Service(
            message,
            key,
            Kind.STATE,
            rate_hz,
            fresh_cycles,
            meaning,
            watchers_only=watchers_only,
            gather=gather,
        )
    )


def event(
    message: type[m.Message],
    key: str,
    meaning: str,
    *,
    rate_hz: float | None = None,
    fresh_cycles: int | None = None,
    several: bool = False,
    sender: str = "",
    guests: bool = False,
) -> Service:
    """Add a row of an event.

    With `several` publishers each has a key of its own, with its id as the last part; `sender` is
    the message's field that repeats it, if there is one. `guests`: programs that act for a person
    publish it, too.
    """
    if several:
        return register(
            _spoken(
                *(message, key, Kind.EVENT, meaning, rate_hz, fresh_cycles, sender), guests=guests
            )
        )
    return register(Service(message, key, Kind.EVENT, rate_hz, fresh_cycles, meaning))


def latch(
    message: type[m.Latched], key: str, meaning: str, *, rate_hz: float | None = None
) -> Service:
    """Add a row of a latched state (`armadico.core.latched`), which every agent publishes."""
    return register(_spoken(message, key, Kind.LATCHED, meaning, rate_hz))


def query(
    message: type[m.Message],
    key: str,
    reply: type[m.Message],
    meaning: str,
    *,
    named: bool = False,
) -> Service:
    """Add a row of a query; `named` as in `Service`."""
    return register(
        Service(message, key, Kind.QUERY, None, None, meaning, reply=reply, named=named)
    )


def service_of(message: type[m.Message]) -> Service:
    """Return the row of a message type. Raises KeyError if there is none."""
    try:
        return _by_message[message]
    except KeyError:
        raise KeyError(
            f"{getattr(message, '__name__', message)!r} is no message with a row in the table of"
            " services; services.register adds one"
        ) from None


@cache
def derived(kind: type[m.Message]) -> tuple[type[m.Message], ...]:
    """Return the message types that a type in an agent's `receives` means.

    A type with a row or fields means itself. Another one is a base: it means all installed types
    that derive from it, which may be none.
    """
    if kind in _by_message or kind.__struct_fields__:
        return (kind,)
    return tuple(row.message for row in services() if issubclass(row.message, kind))


def keys_of(message: m.Message, guest: str) -> list[str]:
    """Return the keys on which a program that is no agent publishes a message.

    It does not know which protocols the agents use, so it publishes in all.
    """
    service = service_of(type(message))
    own = RELEASE if type(message) is m.Stop and not message.stopped else service
    key = own.key_for(instance=service.sender_of(message) or guest)
    shared = parent(service.key_for(instance=guest)) if service.since > m.OLDEST else ""
    return [key, shared] if shared else [key]


PEOPLE: Final = ("person", "page", "guest")


def by_people(publisher: str) -> bool:
    """Return whether the id of a publisher is that of a person's program.

    It is `person-<user>-...` or `page-...` with keys, and `guest-...` without.
    """
    return publisher.partition("-")[0] in PEOPLE


def rows_of(message: type[m.Message]) -> tuple[Service, ...]:
    """Return all rows of a message type; most have one. Raises KeyError if there is none."""
    rows = tuple(service for service in _rows if service.message is message)
    return rows or (service_of(message),)


def service_at(key: str) -> Service | None:
    """Return the row of a key, with its resource's own rate; None if there is none."""
    service = _row_at(key)
    if service is None or "{resource}" not in service.key:
        return service
    resource = declared(key.split("/")[1])
    if resource is None:  # not installed here: the duration of its cycles is unknown
        return replace(service, rate_hz=None)
    return service if resource.period_s is None else replace(service, rate_hz=1 / resource.period_s)


@cache
def _row_at(key: str) -> Service | None:
    return next((service for service in services() if matches(service.heard, key)), None)


@cache
def addressed() -> frozenset[type[m.Message]]:
    """Return the messages whose fields repeat the publisher or the resource of their keys."""
    rows = (row for row in services() if row.sender or row.people or "{resource}" in row.key)
    return frozenset(row.message for row in rows)


def latched() -> tuple[Service, ...]:
    return tuple(s for s in services() if s.kind is Kind.LATCHED)


def message_types() -> list[type[m.Message]]:
    """Return all installed message types in the order of their modules, without bases."""
    modules = dict.fromkeys([m.__name__, *(row.message.__module__ for row in services())])
    return [
        kind
        for name in modules
        for kind in vars(sys.modules[name]).values()
        if isinstance(kind, type)
        and issubclass(kind, m.Message)
        and kind.__module__ == name
        and not kind.__subclasses__()
    ]


def parent(key: str) -> str:
    """Return a key without its last part."""
    return key.rpartition("/")[0]


def expression(key: str, **names: str) -> str:
    """Return the key expression of all keys of a row; `names` fill some of its braces."""
    chunks = key.split("/")
    return "/".join(names.get(c.strip("{}"), "*") if "{" in c else c for c in chunks)


def requested(message: type[m.Message], card: m.Card) -> bool:
    """Return whether an agent subscribes to a message, in any understood protocol."""
    heard = service_of(message).heard
    return any(matches(heard, key) for key in card.requests)


def shared_key(message: m.Message, key: str) -> str:
    """Return the key without the publisher, as older protocols have it; "" if they have `key`."""
    service = _by_message.get(type(message))
    return "" if service is None or service.since == m.OLDEST else parent(key)


def matches(pattern: str, key: str) -> bool:
    """Return whether a key expression of chunks, `*` and `**` intersects a key or another one."""
    return _meet(pattern.split("/"), key.split("/"))


def _meet(one: list[str], other: list[str]) -> bool:
    if not (one and other):
        return all(chunk == "**" for chunk in one + other)
    if "**" in (one[0], other[0]):
        return _meet(one[1:], other) or _meet(one, other[1:])
    return (one[0] == other[0] or "*" in (one[0], other[0])) and _meet(one[1:], other[1:])
