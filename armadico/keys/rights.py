"""The rights of each identity, derived from what the agents' classes declare.

Pure: classes in; rights, and Zenoh's access control for the robot's router, out. A right is one
kind of Zenoh message on the keys of an expression, and has the line of the declaration that gives
it. Nothing else is allowed. The router enforces it for all its clients. The robot agent's own
process is that router, so `robot` needs no rights.

A key has the publisher's instance, `goto-1f0c...`, so a right has `goto-$*`. That expression also
covers the instances of an agent called `goto-fast`, so rules deny those (`Table.denials`).
"""

from __future__ import annotations

import ast
import inspect
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import Final, NamedTuple

from msgspec import Struct

from armadico.core import kernel, messages, services
from armadico.core.guest import Guest
from armadico.core.individual import Individual
from armadico.core.installed import load_all
from armadico.core.kernel import subscriptions
from armadico.core.messages import OLDEST, Message, ParametersRequest
from armadico.core.services import (
    BIDS,
    CARD,
    TOKEN,
    Kind,
    Service,
    by_people,
    expression,
    parent,
    rows_of,
    service_of,
)
from armadico.core.shared import is_shared, shared
from armadico.mesh.door import ROBOT
from armadico.mesh.topology import rooted

ROUTER: Final = "router/*"
"""The liveliness tokens of routers (`armadico.mesh.zenoh`)."""

EVERYTHING: Final = "**"
PACKAGE: Final = Path(services.__file__).parents[1]


class Does(StrEnum):
    """A kind of Zenoh message from a client to the router, as its access control calls it."""

    PUT = "put"
    DELETE = "delete"
    SUBSCRIBE = "declare_subscriber"
    QUERY = "query"
    ANSWER = "declare_queryable"
    REPLY = "reply"
    TOKEN = "liveliness_token"
    WATCH = "declare_liveliness_subscriber"
    LOOK = "liveliness_query"


WORDS: Final = {
    Does.PUT: "publishes",
    Does.DELETE: "deletes",
    Does.SUBSCRIBE: "subscribes to",
    Does.QUERY: "queries",
    Does.ANSWER: "answers",
    Does.REPLY: "replies on",
    Does.TOKEN: "shows the token",
    Does.WATCH: "watches the tokens",
    Does.LOOK: "queries the tokens",
}


class Because(NamedTuple):
    """The declaration that gives a right."""

    file: str
    line: int
    what: str  # `Goto.competes_for`, or what every agent has

    def __str__(self) -> str:
        return f"{self.file}:{self.line} {self.what}"


class Right(NamedTuple):
    """One identity may send one kind of message on the keys of an expression.

    `key` is without the namespace, as in the table of services.
    """

    identity: str
    does: Does
    key: str
    because: Because


class Critical(NamedTuple):
    """An agent's bids for a resource may be critical. Its owner checks that, not the router."""

    agent: str
    resource: str
    because: Because


@dataclass(frozen=True)
class Member:
    """One identity and the classes whose declarations give its rights.

    Attributes:
        name: The identity within its namespace: `goto`, `goto+avoid`, `page`, `person-ada`.
        agents: The classes of its agents, by name.
        guest: What it is besides, if it is no agent.
    """

    name: str
    agents: Mapping[str, type[Individual]] = field(default_factory=dict)
    guest: type[Guest] | None = None

    @property
    def speakers(self) -> tuple[str, ...]:
        """What its instances begin with: the names of its agents, or its own."""
        return (*self.agents, *(() if self.guest is None else (self.name,)))


class RightsError(ValueError):
    """Members whose rights cannot be told apart."""


# The table ----------------------------------------------------------------------------------------


class Table(Struct, frozen=True):
    """The rights of a society.

    Attributes:
        rights: All of them. Those of `robot` are for people: it is the router.
        speakers: By identity, what its instances begin with.
        critical: The agents whose bids may be critical.
        silent: Agents whose classes declare nothing beyond what every agent does.
    """

    rights: tuple[Right, ...]
    speakers: dict[str, tuple[str, ...]]
    critical: tuple[Critical, ...] = ()
    silent: tuple[str, ...] = ()

    def of(self, identity: str) -> list[Right]:
        return [right for right in self.rights if right.identity == identity]

    def denials(self, identity: str) -> list[tuple[str, str]]:
        """(own, other) speakers: an expression of `own` would cover instances of `other`, too."""
        own = self.speakers[identity]
        others = {one for name in self.speakers for one in self.speakers[name] if one not in own}
        return [(one, other) for one in own for other in sorted(others) if _begins(other, one)]

    def allowed(self, identity: str, does: Does) -> set[str]:
        """Return the key expressions of one kind of message, without `denied`."""
        return {right.key for right in self.of(identity) if right.does is does}

    def denied(self, identity: str, does: Does) -> set[str]:
        """Return the key expressions that are another speaker's within those allowed."""
        keys = [key.split("/") for key in self.allowed(identity, does)]
        return {
            "/".join(instances(other) if chunk == instances(own) else chunk for chunk in chunks)
            for own, other in self.denials(identity)
            for chunks in keys
            if instances(own) in chunks
        }

    def expressions(self, identity: str) -> dict[Does, tuple[set[str], set[str]]]:
        """Return `allowed` and `denied` of each kind of message, for `permits`."""
        return {does: (self.allowed(identity, does), self.denied(identity, does)) for does in Does}

    def why(self, identity: str, does: Does, key: str) -> Right | None:
        """Return the right that allows a message; None if it is forbidden."""
        if any(covers(denied, key) for denied in self.denied(identity, does)):
            return None
        rights = (right for right in self.of(identity) if right.does is does)
        return next((right for right in rights if covers(right.key, key)), None)

    def on(self, key: str) -> list[Right]:
        """Return the rights whose expressions meet a key or key expression."""
        return [right for right in self.rights if meet(right.key, key)]

    def speaker(self, instance: str) -> str:
        """Return the agent, or the other identity, of an instance; "" if it is of none."""
        every = {one for speakers in self.speakers.values() for one in speakers}
        return max((one for one in every if _begins(instance, one)), key=len, default="")

    def may_be_critical(self, instance: str, resource: str) -> bool:
        """Return whether an instance's bids for a resource may be critical."""
        by = self.speaker(instance)
        return any(each.agent == by and each.resource == resource for each in self.critical)

    def may_own(self, instance: str, resource: str) -> bool:
        """Return whether an instance may acknowledge a resource."""
        by, ack = self.speaker(instance), f"resource/{resource}/ack"
        mine = (name for name, speakers in self.speakers.items() if by in speakers)
        return any(self.why(name, Does.PUT, ack) for name in mine)

    def access_control(self, namespace: str, robots: Iterable[str] = ()) -> dict[str, object]:
        """Return Zenoh's `access_control` for the robot's router.

        A subject is a user name, `<namespace>/<identity>`. What the router sends to a client is
        not restricted, because it follows from what that client could declare.

        Args:
            namespace: The robot's.
            robots: The namespaces of the robots that share keys with it. Their routers are
                clients of this one and may subscribe to those keys.
        """
        load_all()  # what robots share
        told = _rule("told", Does, [EVERYTHING], flow="egress")
        shares = [rooted(namespace, f"{first}/**") for first in sorted(shared())]
        rules = [told, _rule("shared keys", [Does.SUBSCRIBE], shares)]
        subjects: list[dict[str, object]] = []
        policies: list[dict[str, object]] = []

        def add(name: str, own: Sequence[dict[str, object]], *common: str) -> None:
            rules.extend(own)
            subjects.append({"id": name, "usernames": [name]})
            ids = [*common, *(str(rule["id"]) for rule in own)]
            policies.append({"rules": ids, "subjects": [name]})

        for identity in self.speakers:
            if identity != ROBOT:
                add(f"{namespace}/{identity}", [*self._rules(namespace, identity)], "told")
        for robot in robots:
            watches = _rule(f"{robot}: router", [Does.WATCH, Does.LOOK], [rooted(robot, ROUTER)])
            add(f"{robot}/{ROBOT}", [watches], "told", "shared keys")
        return {
            "enabled": True,
            "default_permission": "deny",
            "rules": rules,
            "subjects": subjects,
            "policies": policies,
        }

    def _rules(self, namespace: str, identity: str) -> Iterator[dict[str, object]]:
        """One rule for all kinds of messages with the same keys, and one for those denied."""
        found: dict[tuple[tuple[str, ...], tuple[str, ...]], list[Does]] = {}
        for does in Does:
            if keys := self.allowed(identity, does):
                denied = self.denied(identity, does)
                found.setdefault((tuple(sorted(keys)), tuple(sorted(denied))), []).append(does)
        for number, ((allow, deny), kinds) in enumerate(found.items()):
            rule = f"{namespace}/{identity}: {number}"
            yield _rule(rule, kinds, [rooted(namespace, key) for key in allow])
            if deny:
                keys_of = [rooted(namespace, key) for key in deny]
                yield _rule(f"{rule} not", kinds, keys_of, permission="deny")


def permits(allowed: Iterable[str], denied: Iterable[str], key: str) -> bool:
    """Return whether key expressions allow a key, or an expression, as Zenoh decides it."""
    covered = any(covers(rule, key) for rule in allowed)
    return covered and not any(covers(rule, key) for rule in denied)


def instances(speaker: str) -> str:
    """Return the expression of all instances of an agent, or of another identity."""
    return f"{speaker}-$*"


def _begins(name: str, speaker: str) -> bool:
    return name.startswith(f"{speaker}-")


def _rule(
    name: str,
    does: Iterable[Does],
    keys: Sequence[str],
    *,
    flow: str = "ingress",
    permission: str = "allow",
) -> dict[str, object]:
    return {
        "id": name,
        "messages": [each.value for each in does],
        "flows": [flow],
        "permission": permission,
        "key_exprs": list(keys),
    }


# Deriving -----------------------------------------------------------------------------------------


def table(members: Sequence[Member], robot: str = "") -> Table:
    """Return the rights of all members.

    Args:
        members: All identities, the robot's included.
        robot: What keys between robots call it: the last part of its namespace.

    Raises RightsError if two members cannot be told apart.
    """
    _check(members)
    found: dict[tuple[str, Does, str], Because] = {}
    critical: dict[Critical, None] = {}
    silent: dict[str, None] = {}
    for member in members:
        for name, cls in member.agents.items():
            for does, key, because in _of_agent(name, cls, robot):
                found.setdefault((member.name, does, key), because)
            critical |= dict.fromkeys(_critical(name, cls))
            if not _declares(cls):
                silent[name] = None
        if member.guest is not None:
            for does, key, because in _of_guest(member.name, member.guest):
                found.setdefault((member.name, does, key), because)
    rights = tuple(Right(*each, because) for each, because in found.items())
    speakers = {member.name: member.speakers for member in members}
    return Table(rights, speakers, tuple(critical), tuple(silent))


def _check(members: Sequence[Member]) -> None:
    if twice := [name for name, often in Counter(m.name for m in members).items() if often > 1]:
        raise RightsError(f"two identities are called {twice[0]!r}; rename one")
    guests = {member.name for member in members if member.guest is not None}
    agents = {agent for member in members for agent in member.agents}
    if both := sorted(guests & agents):
        raise RightsError(
            f"an agent and another identity are both called {both[0]!r}, so what they publish"
            " cannot be told apart; rename the agent"
        )


_Own = Iterator[tuple[Does, str, Because]]


def _of_agent(name: str, cls: type[Individual], robot: str) -> _Own:
    """What one agent does, by its class and by what every agent does."""
    instance = instances(name)
    names = {"name": name, "instance": instance, "robot": robot}

    def keys(message: type[Message]) -> Iterator[str]:
        for row in _published(message, people=False):
            key = expression(row.key, **names)
            yield key
            if row.since > OLDEST and is_shared(key):
                yield parent(key)  # robots of an older protocol have this one

    for message in cls.provides:
        for key in keys(message):
            yield Does.PUT, key, declared_at(cls, "provides")
    for message in cls.answers:
        yield from _answered(service_of(message), names, declared_at(cls, "answers"))
    for message in cls.queries:
        yield Does.QUERY, expression(service_of(message).key), declared_at(cls, "queries")
    for resource in cls.competes_for:
        because = declared_at(cls, "competes_for")
        yield Does.PUT, resource.utility_key_of(instance), because
        yield Does.PUT, resource.command_key_of(instance), because
    for resource in cls.owns:
        yield Does.PUT, resource.ack_key, declared_at(cls, "owns")
    for subscription in subscriptions(cls):
        yield Does.SUBSCRIBE, subscription.pattern, _subscribed(cls, subscription.message)
    yield from _of_every_agent(names)


def _published(message: type[Message], people: bool) -> Iterator[Service]:
    """The rows of a message that an agent, or with `people` a person's program, publishes."""
    return (row for row in rows_of(message) if people or not row.people)


def _answered(service: Service, names: Mapping[str, str], because: Because) -> _Own:
    key = expression(service.key, **names)
    yield Does.ANSWER, key, because
    yield Does.REPLY, key, because


def _of_every_agent(names: Mapping[str, str]) -> _Own:
    """What the social intelligence does in every agent."""
    for message in COMMON:
        for service in _published(message, people=False):
            because = _registered(service, "every agent publishes")
            yield Does.PUT, expression(service.key, **names), because
    for service in (CARD, BIDS, service_of(ParametersRequest), service_of(messages.JournalRequest)):
        yield from _answered(service, names, _registered(service, "every agent answers"))
    yield Does.QUERY, CARD.pattern, _registered(CARD, "every agent queries cards")
    yield Does.TOKEN, expression(TOKEN, **names), _core(services, "TOKEN", "every agent's token")
    yield from _watched()


COMMON: Final = (
    *(messages.Log, messages.ParameterChange, messages.JournalPiece),
    *(messages.Stop, messages.Tuning, messages.Repeat),
)
"""What every agent publishes, whatever its class declares."""


def _watched() -> _Own:
    because = _core(services, "TOKEN", "every client watches tokens")
    yield Does.WATCH, expression(TOKEN), because
    yield Does.WATCH, ROUTER, because
    # Watching with history gives the same: a program that only queries them would seem to be alone.
    yield Does.LOOK, expression(TOKEN), because
    yield Does.LOOK, ROUTER, because


def _of_guest(name: str, cls: type[Guest]) -> _Own:
    """What a program does that is no agent; it publishes on keys with its identity."""
    own = {"instance": instances(name)}
    for part in (cls, *cls.parts()):
        for message in part.provides:
            for row in _published(message, by_people(f"{name}-")):
                yield Does.PUT, expression(row.key, **own), declared_at(part, "provides")
        for message in part.queries:
            yield Does.QUERY, service_of(message).pattern, declared_at(part, "queries")
    for message in cls.receives:
        for row in rows_of(message):
            yield Does.SUBSCRIBE, row.heard, declared_at(cls, "receives")
    if cls.commands:
        yield from _of_person(cls, own)
    if cls.reads:
        because = declared_at(cls, "reads")
        for key in (EVERYTHING, *(f"{first}/**" for first in sorted(shared()))):
            yield Does.SUBSCRIBE, key, because
        for service in (CARD, BIDS, service_of(messages.JournalRequest)):
            yield Does.QUERY, service.pattern, because
    yield from _watched()


def _of_person(cls: type[Guest], own: Mapping[str, str]) -> _Own:
    because = declared_at(cls, "commands")
    for service in services.services():
        if service.kind is Kind.QUERY:
            yield Does.QUERY, service.pattern, because
        elif service.guests or service.people:
            yield Does.PUT, expression(service.key, **own), because


def _critical(name: str, cls: type[Individual]) -> Iterator[Critical]:
    for resource in cls.critical_for:
        yield Critical(name, resource.name, declared_at(cls, "critical_for"))


def _declares(cls: type[Individual]) -> bool:
    lists = (cls.provides, cls.answers, cls.queries, cls.competes_for, cls.owns)
    return any(lists) or bool(cls.receives) or bool(cls.needs) or cls.reacts_to is not None


def _subscribed(cls: type[Individual], message: type[Message]) -> Because:
    """Return the declaration by which an agent subscribes to a kind."""
    for attribute in ("needs", "receives"):
        listed: tuple[type[Message], ...] = getattr(cls, attribute)
        if any(
            message is each or (each.__subclasses__() and issubclass(message, each))
            for each in listed
        ):
            return declared_at(cls, attribute)
    if message in (messages.Claim, messages.Ack, messages.Command):
        return declared_at(
            cls,
            "owns"
            if cls.owns and message is messages.Command
            else "competes_for"
            if cls.competes_for
            else "owns",
        )
    to = cls.reacts_to
    if message is to or (isinstance(to, Mapping) and message in to.values()):
        return declared_at(cls, "reacts_to")
    return _core(kernel, "subscriptions", "every agent subscribes")


# Where a declaration is ---------------------------------------------------------------------------


def declared_at(cls: type, attribute: str) -> Because:
    """Return the class and line that declare an attribute, which a base class may do."""
    holder = next((base for base in cls.__mro__ if attribute in vars(base)), cls)
    what = f"{cls.__name__}.{attribute}"
    if holder is not cls:
        what += f", of {holder.__name__}"
    file, line = _line_of(holder, attribute)
    return Because(file, line, what)


@cache
def _line_of(cls: type, attribute: str) -> tuple[str, int]:
    try:
        source = inspect.getsourcefile(cls)
    except TypeError:  # made in an interactive session
        source = None
    if source is None:
        return "?", 0
    tree = _parsed(source)
    for node in () if tree is None else ast.walk(tree):
        if isinstance(node, ast.ClassDef) and node.name == cls.__name__:
            for statement in node.body:
                if attribute in _assigned(statement):
                    return _shown(source), statement.lineno
            return _shown(source), node.lineno
    return _shown(source), 0


@cache
def _parsed(source: str) -> ast.Module | None:
    try:
        return ast.parse(Path(source).read_text(encoding="utf-8"))
    except (OSError, ValueError, SyntaxError):
        return None


def _assigned(statement: ast.stmt) -> set[str]:
    if isinstance(statement, ast.AnnAssign):
        targets: list[ast.expr] = [statement.target]
    elif isinstance(statement, ast.Assign):
        targets = statement.targets
    elif isinstance(statement, ast.FunctionDef):
        return {statement.name}
    else:
        return set()
    return {target.id for target in targets if isinstance(target, ast.Name)}


@cache
def _core(module: object, name: str, what: str) -> Because:
    """Return the line of a module's own function or constant."""
    source = str(inspect.getsourcefile(module))  # type: ignore[arg-type]
    tree = _parsed(source)
    body = [] if tree is None else tree.body
    line = next((each.lineno for each in body if name in _assigned(each)), 0)
    return Because(_shown(source), line, what)


@cache
def _registered(service: Service, what: str) -> Because:
    """Return the line of a service's key in the module that registers it."""
    first = service.key.partition("/{")[0] if service.since > OLDEST else service.key
    module = inspect.getmodule(service.message)
    for where in (services, module):
        source = None if where is None else inspect.getsourcefile(where)
        tree = None if source is None else _parsed(source)
        if source is None or tree is None:
            continue
        for node in ast.walk(tree):
            if isinstance(node, ast.Constant) and node.value in (service.key, first):
                return Because(_shown(source), node.lineno, what)
    return _core(services, "services", what)


def _shown(source: str) -> str:
    path = Path(source)
    try:
        return str(Path(PACKAGE.name) / path.relative_to(PACKAGE))
    except ValueError:
        return str(path)


# Key expressions ----------------------------------------------------------------------------------


def covers(rule: str, key: str) -> bool:
    """Return whether a rule's key expression includes a key, or another expression, entirely.

    As Zenoh does it: `*` is one part, `**` any number of parts, `$*` any text within a part.
    """
    return _covers(tuple(rule.split("/")), tuple(key.split("/")))


def _covers(rule: tuple[str, ...], key: tuple[str, ...]) -> bool:
    if not rule or not key:
        return all(chunk == "**" for chunk in rule) and not key
    if rule[0] == "**":
        return _covers(rule[1:], key) or _covers(rule, key[1:])
    return (
        key[0] != "**"
        and _chunk(rule[0]).fullmatch(key[0]) is not None
        and _covers(rule[1:], key[1:])
    )


@cache
def _chunk(chunk: str) -> re.Pattern[str]:
    if chunk == "*":
        return re.compile(".*", re.DOTALL)
    return re.compile(".*".join(map(re.escape, chunk.split("$*"))), re.DOTALL)


def meet(one: str, other: str) -> bool:
    """Return whether two key expressions have a key in common, as far as `$*` can be compared."""
    return _meet(tuple(one.split("/")), tuple(other.split("/")))


def _meet(one: tuple[str, ...], other: tuple[str, ...]) -> bool:
    if not one or not other:
        return all(chunk == "**" for chunk in one + other)
    if "**" in (one[0], other[0]):
        return _meet(one[1:], other) or _meet(one, other[1:])
    alike = _chunk(one[0]).fullmatch(other[0]) or _chunk(other[0]).fullmatch(one[0])
    return alike is not None and _meet(one[1:], other[1:])
