"""Derives the rights of a society's identities from what their classes declare: sans-IO.

Classes in, a table of rights out. An agent declares `provides`, `answers`, `queries`,
`competes_for`, `owns` and its subscriptions (`armadico.core.individual`), another program what
`armadico.core.guest` lists. What the social intelligence does in every agent is added here.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from typing import Final

from armadico.core import kernel, messages, services
from armadico.core.guest import Guest
from armadico.core.individual import Individual
from armadico.core.kernel import subscriptions
from armadico.core.messages import OLDEST, Message, ParametersRequest
from armadico.core.services import (
    BIDS,
    CARD,
    SETTINGS,
    TOKEN,
    VOID,
    Kind,
    Service,
    by_people,
    expression,
    parent,
    rows_of,
    service_of,
)
from armadico.core.shared import is_shared, shared
from armadico.keys.declarations import declared, in_module, registered
from armadico.keys.rights import (
    EVERYTHING,
    ROUTER,
    Because,
    Critical,
    Does,
    Right,
    Table,
    instances,
)


@dataclass(frozen=True)
class Subject:
    """One identity, and the classes whose declarations give its rights."""

    name: str  # the identity within its namespace: `goto`, `goto+avoid`, `page`, `person-ada`
    # The classes of its agents, by name.
    agents: Mapping[str, type[Individual]] = field(default_factory=dict)
    guest: type[Guest] | None = None  # what it is besides, if it is no agent

    @property
    def speakers(self) -> tuple[str, ...]:
        """What its instances begin with: the names of its agents, or its own."""
        return (*self.agents, *(() if self.guest is None else (self.name,)))


class RightsError(ValueError):
    """Identities that cannot be told apart by what they publish."""


def table(subjects: Sequence[Subject], robot: str = "") -> Table:
    """Return the rights of all identities, the robot's included.

    Keys between robots call it `robot`: the last part of its namespace. Raises RightsError if what
    two identities publish cannot be told apart.
    """
    _check(subjects)
    found: dict[tuple[str, Does, str], Because] = {}
    classes: dict[str, type[Individual]] = {}
    for subject in subjects:
        classes |= subject.agents
        granted = [_of_agent(name, cls, robot) for name, cls in subject.agents.items()]
        if subject.guest is not None:
            granted.append(_of_guest(subject.name, subject.guest))
        for does, key, because in chain.from_iterable(granted):
            found.setdefault((subject.name, does, key), because)
    return Table(
        tuple(Right(*each, because) for each, because in found.items()),
        {subject.name: subject.speakers for subject in subjects},
        tuple(
            Critical(name, resource.name, declared(cls, "critical_for"))
            for name, cls in classes.items()
            for resource in cls.critical_for
        ),
        tuple(name for name, cls in classes.items() if not _declares(cls)),
    )


def _check(subjects: Sequence[Subject]) -> None:
    names = [subject.name for subject in subjects]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise RightsError(f"two identities are called {twice[0]!r}; rename one")
    guests = {subject.name for subject in subjects if subject.guest is not None}
    agents = {agent for subject in subjects for agent in subject.agents}
    if both := sorted(guests & agents):
        raise RightsError(
            f"an agent and another identity are both called {both[0]!r}, so what they publish"
            " cannot be told apart; rename the agent"
        )


_Granted = Iterator[tuple[Does, str, Because]]


def _of_agent(name: str, cls: type[Individual], robot: str) -> _Granted:
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
            yield Does.PUT, key, declared(cls, "provides")
    for message in cls.answers:
        yield from _answered(service_of(message), names, declared(cls, "answers"))
    for message in cls.queries:
        key = expression(service_of(message).asked_by(name))
        yield Does.QUERY, key, declared(cls, "queries")
    for resource in cls.competes_for:
        because = declared(cls, "competes_for")
        yield Does.PUT, resource.utility_key_of(instance), because
        yield Does.PUT, resource.command_key_of(instance), because
        # Under a coordination with an arbiter it proposes, and receives awards.
        proposal, award = service_of(messages.Proposal), service_of(messages.Award)
        yield Does.PUT, expression(proposal.key, resource=resource.name, instance=instance), because
        yield Does.SUBSCRIBE, expression(award.key, resource=resource.name), because
    for resource in cls.owns:
        yield Does.PUT, resource.ack_key, declared(cls, "owns")
    for subscription in subscriptions(cls):
        yield Does.SUBSCRIBE, subscription.pattern, _subscribed(cls, subscription.message)
    yield from _of_every_agent(names)


def _published(message: type[Message], people: bool) -> Iterator[Service]:
    """The rows of a message that an agent, or with `people` a person's program, publishes."""
    return (row for row in rows_of(message) if people or not row.people)


def _answered(service: Service, names: Mapping[str, str], because: Because) -> _Granted:
    key = service.answered_at(expression(service.key, **names))
    yield Does.ANSWER, key, because
    yield Does.REPLY, key, because


def _of_every_agent(names: Mapping[str, str]) -> _Granted:
    """What the social intelligence does in every agent."""
    for message in COMMON:
        for service in _published(message, people=False):
            because = registered(service, "every agent publishes")
            yield Does.PUT, expression(service.key, **names), because
    journal = service_of(messages.JournalRequest)
    for service in (CARD, BIDS, SETTINGS, service_of(ParametersRequest), journal):
        yield from _answered(service, names, registered(service, "every agent answers"))
    yield Does.QUERY, CARD.pattern, registered(CARD, "every agent queries cards")
    yield (
        Does.TOKEN,
        expression(TOKEN, **names),
        in_module(services, "TOKEN", "every agent's token"),
    )
    yield Does.SUBSCRIBE, VOID.key, registered(VOID, "every agent subscribes")
    yield from _watched()


COMMON: Final = (
    *(messages.Log, messages.ParameterChange, messages.JournalPiece),
    *(messages.Stop, messages.Tuning, messages.Repeat),
)
"""What every agent publishes, whatever its class declares."""


def _watched() -> _Granted:
    because = in_module(services, "TOKEN", "every client watches tokens")
    yield Does.WATCH, expression(TOKEN), because
    yield Does.WATCH, ROUTER, because
    # Watching with history gives the same: a program that only queries them would seem to be alone.
    yield Does.LOOK, expression(TOKEN), because
    yield Does.LOOK, ROUTER, because


def _of_guest(name: str, cls: type[Guest]) -> _Granted:
    """What a program does that is no agent; it publishes on keys with its identity."""
    own = {"instance": instances(name)}
    for part in (cls, *cls.parts()):
        for message in part.provides:
            for row in _published(message, by_people(f"{name}-")):
                yield Does.PUT, expression(row.key, **own), declared(part, "provides")
        for message in part.queries:
            key = expression(service_of(message).asked_by(name))
            yield Does.QUERY, key, declared(part, "queries")
    for message in cls.receives:
        for row in rows_of(message):
            yield Does.SUBSCRIBE, row.heard, declared(cls, "receives")
    if cls.commands:
        yield from _of_person(name, cls, own)
    if cls.reads:
        because = declared(cls, "reads")
        for key in (EVERYTHING, *(f"{first}/**" for first in sorted(shared()))):
            yield Does.SUBSCRIBE, key, because
        for service in (CARD, BIDS, SETTINGS, service_of(messages.JournalRequest)):
            yield Does.QUERY, service.pattern, because
    yield from _watched()


def _of_person(name: str, cls: type[Guest], own: Mapping[str, str]) -> _Granted:
    because = declared(cls, "commands")
    for service in services.services():
        if service.kind is Kind.QUERY:
            yield Does.QUERY, expression(service.asked_by(name)), because
        elif service.guests or service.people:
            yield Does.PUT, expression(service.key, **own), because


def _declares(cls: type[Individual]) -> bool:
    lists = (cls.provides, cls.answers, cls.queries, cls.competes_for, cls.owns)
    return any(lists) or bool(cls.receives) or bool(cls.needs) or cls.reacts_to is not None


def _subscribed(cls: type[Individual], message: type[Message]) -> Because:
    """Return the declaration by which an agent subscribes to a kind of message."""
    for attribute in ("needs", "receives"):
        if issubclass(message, getattr(cls, attribute)):
            return declared(cls, attribute)
    if message in (messages.Claim, messages.Ack, messages.Command):
        contends = cls.competes_for and message is not messages.Command
        return declared(cls, "competes_for" if contends else "owns")
    to = cls.reacts_to
    if message is to or (isinstance(to, Mapping) and message in to.values()):
        return declared(cls, "reacts_to")
    return in_module(kernel, "subscriptions", "every agent subscribes")
