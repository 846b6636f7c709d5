"""The agent pattern of thesis 3.3 as a base class.

Individual intelligence is what a subclass writes: handlers for messages (`on_<message>`) and, for a
behaviour, `bid`; for an owner of a resource, `obey` and `rest`. Social intelligence comes with this
class: freshness, turns, winner determination, exchange, acknowledgements, the stop, latched states,
the card. An agent holds no socket, thread, clock or sleep: whoever runs it (`armadico.core.driver`)
hands it messages and the time, and sends what it finds in `outbox`.

The modules of figure 3.6: internal state is the subclass's attributes and `latest`; collaboration
is `reacts_to`, `needs`, `hears`, `provides`, `answers` and `asks`; goal is `bid` and the handlers;
competition is `competes_for`; coordination is one `Contender` a resource; helper methods are here.
"""

from __future__ import annotations

import random
import re
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from math import isfinite
from pathlib import PurePath
from types import MappingProxyType
from typing import Any, ClassVar, TypeVar, cast

from armadico.core import changeable, parameters
from armadico.core import messages as m
from armadico.core.coordination import COMPARISONS, Contender, Owner, Verdict
from armadico.core.cycles import AHEAD, CycleClock, CycleCounter
from armadico.core.exchange import EXCHANGES, Bid
from armadico.core.latched import Memory
from armadico.core.messages import Message
from armadico.core.resources import Resource, declare, differently
from armadico.core.services import CARD, Gathering, Kind, derived, latched, service_of

M = TypeVar("M", bound=Message)

BIDS_REMEMBERED = 50
DEBUG, INFO, WARNING, ERROR = 10, 20, 30, 40

MOST_SETTINGS = 256
"""That are remembered of all agents."""

REMEMBERED = "those who remember"
"""By whom a parameter is changed that was set before its instance was started."""

LONGEST_REASON = 200
"""Characters of a bid's reason that are kept."""

REPORT_S = 2.0
"""Refused commands are reported at most so often."""

REASONS_TOLD = 3
"""So many different reasons are; a speed beyond what the robot can is another one each time."""

AT_WORK = frozenset({Verdict.STALE_BALLOT, Verdict.OVER, Verdict.LISTENING})
"""Refusals that come of every exchange and every start: the protocol at work, and no fault."""


Parameters = parameters.Parameters
Social = parameters.Social


@dataclass(frozen=True)
class Identity:
    """Who an instance is: set by whoever runs it."""

    instance: str
    host: str = "localhost"
    pid: int = 0
    version: str = ""
    rng: random.Random = field(default_factory=random.Random, compare=False)


@dataclass(frozen=True, slots=True)
class Subscription:
    """What an agent listens to: messages of a type on the keys of a pattern."""

    message: type[Message]
    pattern: str
    kind: Kind


@dataclass(frozen=True, slots=True)
class Publish:
    """Publish a message on a key."""

    key: str
    message: Message


@dataclass(frozen=True, slots=True)
class Question:
    """Somebody's query, to be answered now or later."""

    id: int
    request: Message


@dataclass(frozen=True, slots=True)
class AskFor:
    """Put a query on the mesh; the answer comes back to `Agent.replied` with this id."""

    id: int
    key: str
    request: Message
    reply: type[Message]
    timeout: float


@dataclass(frozen=True, slots=True)
class Answer:
    """The answer to a `Question`."""

    id: int
    message: Message


@dataclass(frozen=True, slots=True)
class Write:
    """Bytes for the device that the agent owns."""

    data: bytes


@dataclass(frozen=True, slots=True)
class Refused:
    """Something on a key was not believed: counted by reason, and now and then reported."""

    key: str
    why: str  # who, what was wrong, and what was done with it; few different ones


Outgoing = Publish | AskFor | Answer | Write | Refused


@dataclass
class _Owned:
    """A resource that this agent owns, and when its next cycle is due if it counts its own."""

    owner: Owner
    counter: CycleCounter | None = None
    due: float | None = None
    complained_at: float = float("-inf")


class _Asked:
    """The queries that are not answered yet: what is done with each answer, by number."""

    def __init__(self) -> None:
        self._last = 0
        self._then: dict[int, Callable[[Any], None]] = {}

    def put(self, then: Callable[[Any], None]) -> int:
        """Note one; return its number."""
        self._last += 1
        self._then[self._last] = then
        return self._last

    def pop(self, number: int) -> Callable[[Any], None] | None:
        return self._then.pop(number, None)


class Agent:
    """One agent. A subclass declares what it talks about, and fills in handlers and methods."""

    name: ClassVar[str] = ""
    reacts_to: ClassVar[type[Message] | Mapping[Resource, type[Message]] | None] = None
    """Starts its turn in a cycle; by resource, if it competes for several that differ in that. None
    is the owner's ack, which each cycle of a resource begins with."""
    needs: ClassVar[tuple[type[Message], ...]] = ()  # must be fresh, or it does not bid
    hears: ClassVar[tuple[type[Message], ...]] = ()  # merely listened to
    provides: ClassVar[tuple[type[Message], ...]] = ()
    answers: ClassVar[tuple[type[Message], ...]] = ()  # queries it answers
    asks: ClassVar[tuple[type[Message], ...]] = ()  # queries it puts
    competes_for: ClassVar[tuple[Resource, ...]] = ()
    owns: ClassVar[tuple[Resource, ...]] = ()
    alone: ClassVar[bool] = False  # a second instance in the namespace may not join
    parameters: ClassVar[type[Parameters]] = Parameters
    launched_with: ClassVar[tuple[str, ...]] = ()
    """Facts of a scenario that its launcher sets: the parameters of these names (see
    `armadico.launch.society.facts`)."""

    changeable: ClassVar[Mapping[str, str]] = MappingProxyType({})
    """Units, by name, of those parameters that may be changed while it is at work; those in tables
    with dots. They are read from `p` where they are used, or anew in `on_parameters`."""

    borders: ClassVar[Mapping[str, Callable[[float], float]]] = MappingProxyType({})
    """What a picture shows around the robot: distances from its outline, m, by its speed, m/s."""

    def __init__(self, identity: Identity, parameters: Any = None) -> None:
        self.identity = identity
        self.instance = identity.instance
        self.rng = identity.rng
        self.drawn = self.rng.getstate()  # before anything is: a life that is replayed begins here
        self.p: Parameters = self.parameters() if parameters is None else parameters
        self._begun = self.p  # as it was started
        self._set: dict[str, str] = {}  # live since, by this instance or one before it: JSON
        changeable.allowed(type(self.p), self.changeable)  # a name that is none is told of at once
        self.now = 0.0
        self.cycles = CycleClock()  # the robot's
        self.tenure = 0  # cycles for which it has been at work
        self.outbox: list[Outgoing] = []
        self.memory = Memory(self.rng)  # of latched states
        self.foreign: set[str] = set()  # instances that speak otherwise
        self.reachable = True  # whether the robot's router can be reached
        self.bids: deque[m.BidRecord] = deque(maxlen=BIDS_REMEMBERED)
        self._latest: dict[type[Message], Message] = {}
        self._inputs = tuple(service_of(kind).pattern for kind in self.needs)
        self._takers: dict[type[Message], Callable[[Any], bool]] = {
            m.RobotState: self._take_state,
            m.Description: self._take_description,
            m.Claim: self._take_claim,
            m.Command: self._take_command,
            m.Ack: self._take_ack,
            **{service.message: self._take_latched for service in latched()},
        }
        listened = {subscription.message for subscription in self.subscriptions()}
        self._gatherings: dict[type[Message], Gathering] = {  # of several publishers
            kind: gather() for kind in listened if (gather := service_of(kind).gather) is not None
        }
        self._handlers = {kind: self._handler(kind) for kind in (*listened, *self.answers)}
        self._alarm: float | None = None
        self._asked = _Asked()
        self._turned: dict[str, m.Cycle] = {}  # by resource, the cycle of its last turn
        self._owned = {r.name: self._own(declare(r)) for r in self.owns}
        self._contenders = {r.name: self._contend(declare(r)) for r in self.competes_for}
        self._reactions = self._reacting()

    # What a subclass may write -------------------------------------------------------------------

    def bid(self, message: Any) -> Bid | None:  # noqa: ARG002
        """The goal method: what it would do now, and how much that helps; None: nothing.

        Called once a cycle with the message that the agent reacts to, all needs fresh, the robot
        not stopped. `self.why` may be set to say why there is no bid, and `self.lacks` to the key
        of what would be needed for one.
        """
        return None

    def bid_for(self, resource: Resource, message: Any) -> Bid | None:  # noqa: ARG002
        """The same, for an agent that competes for more than one resource."""
        return self.bid(message)

    def obey(self, resource: Resource, action: Any) -> None:
        """The owner's method: do this, numbers or a message as the resource declares."""

    def rest(self, resource: Resource) -> None:
        """The owner's method: do nothing more; after a release, a silence or a stop."""

    def measure(self, resource: Resource) -> m.Action:
        """What a resource that it owns does now, in the order of its parameters."""
        return resource.neutral

    def beyond(self, resource: Resource, action: Any) -> str:  # noqa: ARG002
        """What is wrong with an action of the right shape, by the owner's limits; "" if nothing."""
        return ""

    def unavailable(self, resource: Resource) -> str:  # noqa: ARG002
        """Why a resource that it owns can obey nobody now; "" if it can."""
        return ""

    def on_start(self) -> None:
        """Called once, before any message but latched ones."""

    def on_wakeup(self) -> None:
        """Called at the time given to `wake_at`."""

    def on_parameters(self, before: Any) -> None:
        """Some of `changeable` were changed: `p` has the new ones, `before` is what it was.

        What was worked out from them is worked out again. ValueError, raised before that, refuses
        them.
        """

    def on_appeared(self, name: str, instance: str) -> None:
        """An instance of an agent has joined."""

    def on_disappeared(self, name: str, instance: str) -> None:
        """An instance's liveliness token has gone."""

    def on_met(self, card: m.Card) -> None:
        """An instance that is alive has given its card."""

    def on_router(self) -> None:
        """The robot's router can be reached again, or no more: `reachable`."""

    # What a subclass uses ------------------------------------------------------------------------

    why: str = ""
    lacks: str = ""

    def key_of(self, kind: type[Message], **names: str) -> str:
        """The key of a kind's service; braces are filled by `names`, or by who this one is."""
        key = service_of(kind).key
        if "{" not in key:
            return key
        return key.format(**{"instance": self.instance, "name": self.name, **names})

    def publish(self, message: Message, **names: str) -> None:
        """Publish a message on its service's key; `names` fill the key's braces."""
        service = service_of(type(message))
        key = self.key_of(type(message), **names)
        if service.kind is Kind.LATCHED:
            with suppress(m.MessageError):  # what nobody can be told of, nobody remembers
                self.memory.note(m.checked(cast("m.Latched", message)))
        self.outbox.append(Publish(key, message))

    def latest(self, kind: type[M]) -> M | None:
        """The newest message of a kind, fresh or not."""
        return cast("M | None", self._latest.get(kind))

    def fresh(self, kind: type[M]) -> M | None:
        """The newest message of a kind, if by the table of services it may be acted upon."""
        message = self._latest.get(kind)
        if message is None or not self._in_time(message):
            return None
        return cast("M", message)

    def each_fresh(self, base: type[M]) -> list[M]:
        """The fresh messages of all kinds that derive from a base which it hears."""
        found = (self.fresh(kind) for kind in derived(base))
        return [cast("M", message) for message in found if message is not None]

    def ask(
        self,
        request: Message,
        then: Callable[[Any], None],
        timeout: float = 2.0,
        instance: str = "",
    ) -> None:
        """Put a query; `then` gets the first reply, or None if nobody answered in time.

        `instance` says whose answer is wanted, where a service's key has a place for that.
        """
        service = service_of(type(request))
        assert service.reply is not None, f"{service.key} is not a query"
        key = self.key_of(type(request), instance=instance or self.instance)
        self._put(key, request, service.reply, then, timeout)

    def ask_card(
        self, name: str, instance: str, then: Callable[[Any], None], timeout: float = 1.0
    ) -> None:
        """Ask an instance for its card; `then` gets it, or None if it did not answer in time."""
        key = CARD.key_for(name=name, instance=instance)
        self._put(key, m.Ask(), m.Card, then, timeout)

    def _put(
        self,
        key: str,
        request: Message,
        reply: type[Message],
        then: Callable[[Any], None],
        timeout: float,
    ) -> None:
        self.outbox.append(AskFor(self._asked.put(then), key, request, reply, timeout))

    def answer(self, question: Question, reply: Message) -> None:
        """Answer a query, now or later."""
        self.outbox.append(Answer(question.id, reply))

    def wake_at(self, when: float) -> None:
        """Have `on_wakeup` called at that time, s; the one wake-up it may ask for."""
        self._alarm = when

    def holds(self, resource: Resource) -> bool:
        """Whether it holds the resource, as far as it knows."""
        return self._contenders[resource.name].holding

    def acked(self, resource: Resource) -> m.Ack | None:
        """What the resource's owner last acknowledged."""
        return self._contenders[resource.name].ack

    def owner(self, resource: Resource) -> Owner:
        """The judge of a resource that it owns."""
        return self._owned[resource.name].owner

    @property
    def stopped(self) -> m.Stop | None:
        """The robot's stop, while it is latched."""
        stop = self.memory.newest(m.Stop)
        return stop if stop is not None and stop.stopped else None

    def latch(self, by: str) -> None:
        """Stop the robot, as anybody may; `by` says who or what. People release it, on purpose."""
        known = self.memory.newest(m.Stop) or m.Stop()
        press = self.rng.getrandbits(63)
        self.publish(m.Stop(m.next_count(known.counter), stopped=True, by=by, press=press))
        self._stop_changed()

    def acknowledge(self) -> None:
        """Acknowledge what it owns: for who makes the cycles itself. Others do on the state."""
        for owned in self._owned.values():
            self._acknowledge(owned)

    def log(self, text: str, level: int = INFO, event: str = "") -> None:
        """Publish a line for people; `event` says what happened to programs (`m.LogEvent`)."""
        self.publish(m.Log(level, m.line(text), event))

    # What whoever runs it calls ------------------------------------------------------------------

    def start(self, now: float) -> None:
        """Begin."""
        self.now = now
        self.tenure = 1
        for owned in self._owned.values():
            if owned.counter is not None:
                owned.due = now
        self.on_start()
        for message in self.memory.all():  # of what it was told before
            if type(message) is m.Tuning:
                self._take_over_settings(message)
            handler = self._handlers.get(type(message))
            if handler is not None:
                handler(message)

    def receive(self, message: Message, now: float) -> None:
        """Take one message that it subscribed to."""
        self.now = now
        kind = type(message)
        take = self._takers.get(kind)
        gathering = self._gatherings.get(kind)
        if gathering is not None:
            if not (gathering.counts(message) and self._newer(message, gathering.newest(message))):
                return
            gathered = gathering.update(message)
            if gathered is None:
                return
            message = gathered
        elif not (take(message) if take else self._newer(message, self._latest.get(kind))):
            return
        self._latest[kind] = message
        handler = self._handlers.get(kind)
        if handler is not None:
            handler(message)
        for resource in self._reactions.get(kind, ()):
            if self._begins_turn(resource, message):
                self._turn(resource, message)

    def accepted(self, message: Message) -> bool:
        """Whether a message that it was given is the newest by its publisher."""
        gathering = self._gatherings.get(type(message))
        if gathering is not None:
            return gathering.newest(message) is message
        return self._latest.get(type(message)) is message

    def remember(self, message: m.Latched, now: float) -> None:
        """Take a latched state before it has begun."""
        self.now = now
        self._latest[type(message)] = message
        self._on_latched(message)

    def asked(self, question: Question, now: float) -> None:
        """Take a query, and put the `Answer` into the outbox now or later."""
        self.now = now
        handler = self._handlers.get(type(question.request))
        if handler is not None:
            reply = handler(question)
            if reply is not None:
                self.answer(question, reply)

    def replied(self, question_id: int, reply: Message | None, now: float) -> None:
        """Take the answer to something that was asked; None if there was none."""
        self.now = now
        then = self._asked.pop(question_id)
        if then is not None:
            then(reply)

    def appeared(self, name: str, instance: str, now: float) -> None:
        """Take the news of a liveliness token."""
        self.now = now
        self.memory.met(now)
        self.on_appeared(name, instance)

    def met(self, card: m.Card, now: float) -> None:
        """Take an instance's own card: who speaks otherwise is not listened to."""
        self.now = now
        self.on_met(card)
        if card.instance in self.foreign:
            return
        who = f"{card.instance} (host {card.host}, pid {card.pid})"
        if card.protocol != m.PROTOCOL:
            why = f"speaks protocol {card.protocol}, this one {m.PROTOCOL}"
        elif differing := self._declared_otherwise(card):
            why = f"means {differing}"
        else:
            return
        self.foreign.add(card.instance)
        self.log(f"{who} {why}: its claims and commands are refused", ERROR)

    def disappeared(self, name: str, instance: str, now: float) -> None:
        """Take the news that a liveliness token has gone."""
        self.now = now
        self.foreign.discard(instance)
        for contender in self._contenders.values():
            self._say(contender.resource, contender.gone(instance, now))
        self.on_disappeared(name, instance)

    def take_router(self, there: bool, now: float) -> None:
        """Take the news that the robot's router can be reached, or cannot."""
        self.now = now
        if there != self.reachable:
            self.reachable = there
            if there:  # who was cut off may have missed what is latched
                self.memory.met(now)
            self.on_router()

    def wake(self, now: float) -> None:
        """Take the time, when `wakeup` has come."""
        self.now = now
        for owned in self._owned.values():
            self._mind(owned)
        for contender in self._contenders.values():
            due = contender.wakeup
            if due is not None and now >= due:
                self._say(contender.resource, contender.tick(now))
        for message in self.memory.due(now):
            self.publish(message)
        if self._alarm is not None and now >= self._alarm:
            self._alarm = None
            self.on_wakeup()

    @property
    def wakeup(self) -> float | None:
        """When `wake` should be called, s, if nothing comes before."""
        due = self._alarm
        if self._contenders:
            for contender in self._contenders.values():
                at = contender.wakeup
                if at is not None and (due is None or at < due):
                    due = at
        if self._owned:
            for owned in self._owned.values():
                for at in (owned.due, owned.owner.silent_at):
                    if at is not None and (due is None or at < due):
                        due = at
        at = self.memory.wakeup
        return at if at is not None and (due is None or at < due) else due

    def stop(self, now: float) -> None:
        """Leave: what it holds is let go of, what it owns rests."""
        self.now = now
        for contender in self._contenders.values():
            cycle = contender.clock.newest or m.Cycle(0, 0)
            self._say(contender.resource, contender.bid(cycle, None, now))
        for owned in self._owned.values():
            self._rest(owned)

    @classmethod
    def subscriptions(cls) -> tuple[Subscription, ...]:
        """What it listens to, and what its social intelligence needs too."""
        triggers = cls.reacts_to.values() if isinstance(cls.reacts_to, Mapping) else [cls.reacts_to]
        kinds = [kind for kind in triggers if kind is not None and kind is not m.Ack]
        kinds += [*cls.needs, *(kind for heard in cls.hears for kind in derived(heard))]
        if kinds or cls.provides or cls.competes_for or cls.owns:  # it lives by the robot's cycles
            kinds = [m.RobotState, m.Description, *kinds]
        kinds += [service.message for service in latched()]
        services = [service_of(kind) for kind in dict.fromkeys(kinds)]
        for service in services:
            if service.watchers_only:
                raise ValueError(f"{cls.name} listens to {service.key}, which agents may not")
        found = [Subscription(s.message, s.pattern, s.kind) for s in services]
        both = dict.fromkeys((*cls.competes_for, *cls.owns))
        found += [Subscription(m.Claim, r.utility_key, Kind.EVENT) for r in both]
        found += [Subscription(m.Ack, r.ack_key, Kind.STATE) for r in cls.competes_for]
        found += [Subscription(m.Command, r.command_pattern, Kind.EVENT) for r in cls.owns]
        return tuple(found)

    def card(self) -> m.Card:
        """Who it is and what it offers (thesis table 3.1)."""
        who = self.identity
        resources = dict.fromkeys((*self.competes_for, *self.owns))
        return m.Card(
            name=self.name,
            instance=self.instance,
            host=who.host,
            pid=who.pid,
            version=who.version,
            protocol=m.PROTOCOL,
            provides=tuple(self.key_of(k) for k in (*self.provides, *self.answers)),
            requests=tuple(s.pattern for s in self.subscriptions() if self._asks_for(s))
            + tuple(service_of(k).key for k in self.asks),
            resources=tuple(r.name for r in self.competes_for),
            holds=tuple(r.name for r in self.competes_for if self.holds(r)),
            owns=tuple(r.name for r in self.owns),
            tenure=min(self.tenure, m.LONGEST_TENURE),
            declares=tuple(r.signature for r in resources),
            world=m.line(PurePath(str(getattr(self.p, "world", None) or "")).stem),
        )

    def _asks_for(self, to: Subscription) -> bool:
        """Whether it listens by its own wish, and not because everybody does."""
        everybodys = to.kind is Kind.LATCHED or to.message is m.Description
        return not everybodys or to.message in (*self.hears, *self.needs)

    def tune(self, request: m.ParametersRequest, now: float) -> m.ParametersReply:
        """Change what is asked for, all or none, and tell what may be changed, as it is then."""
        self.now, refusal = now, ""
        if request.change:
            try:
                self._change(request)
            except ValueError as error:
                refusal = m.line(str(error))
        rows = changeable.told(self.p, self._begun, self.changeable)
        return m.ParametersReply(self.instance, rows, refusal)

    def _change(self, request: m.ParametersRequest) -> None:
        """Raises ValueError saying what is wrong, and nothing is changed."""
        self._put_settings(request.change, request.by or "somebody")
        self._set |= {setting.name: setting.json for setting in request.change}
        self._remember_settings()

    def _put_settings(self, change: tuple[m.Setting, ...], by: str) -> None:
        """Change parameters, and tell of it. Raises ValueError, and nothing is changed."""
        before = self.p
        self.p = changeable.changed(before, self.changeable, change)
        try:
            self.on_parameters(before)
        except ValueError:
            self.p = before
            raise
        for name, old, new in changeable.differences(before, self.p, tuple(self.changeable)):
            self.publish(m.ParameterChange(self.name, self.instance, name, old, new, by))
            self.log(f"{name} = {new}, before {old}: changed by {by}")

    def _remember_settings(self) -> None:
        """Have everybody remember what was set, beside what was of others."""
        known = self.memory.newest(m.Tuning) or m.Tuning(0, 0)
        others = [each for each in known.settings if each.agent != self.name]
        mine = [m.AgentSetting(self.name, m.Setting(*each)) for each in self._set.items()]
        if known.settings == (settings := (*others, *mine)):
            return
        by = self.rng.getrandbits(63)
        self.publish(m.Tuning(m.next_count(known.counter), by, settings[-MOST_SETTINGS:]))

    def _take_over_settings(self, said: m.Tuning) -> None:
        """Be set as the agent was before this instance, or as another instance of it is."""
        mine = {e.setting.name: e.setting.json for e in said.settings if e.agent == self.name}
        for name, value in mine.items():
            if self._set.get(name) == value:
                continue
            self._set[name] = value
            try:
                self._put_settings((m.Setting(name, value),), REMEMBERED)
            except ValueError as error:  # by one of another version, say
                self.log(f"not set as before: {error}", WARNING)
        if set(self._set) - set(mine):  # whoever said this did not know of them
            self._remember_settings()

    def history(self) -> m.BidHistory:
        """Its recent bids."""
        return m.BidHistory(self.instance, tuple(self.bids))

    # How it takes messages -----------------------------------------------------------------------

    def _take_state(self, state: m.RobotState) -> bool:
        if not self._advance(self.cycles, state.cycle, service_of(m.RobotState).key):
            return False
        self.tenure += 1
        if state.stop != self.memory.newest(m.Stop) and self._on_latched(state.stop):
            self._stop_changed()
        for owned in self._owned.values():
            if owned.counter is None:
                self._acknowledge(owned)
        return True

    def _take_description(self, description: m.Description) -> bool:
        self.cycles.period = description.cycle_s
        for gathering in self._gatherings.values():
            gathering.describe(description)
        return True

    def _take_claim(self, claim: m.Claim) -> bool:
        if claim.ballot.instance in self.foreign:
            return False
        contender = self._contenders.get(claim.resource)
        if contender is not None:
            self._say(contender.resource, contender.on_claim(claim, self.now))
        owned = self._owned.get(claim.resource)
        if owned is not None and owned.owner.on_claim(claim):
            self._rest(owned)
        return True

    def _take_command(self, command: m.Command) -> bool:
        owned = self._owned.get(command.resource)
        if owned is None or command.ballot.instance in self.foreign:
            return False
        owner, resource = owned.owner, owned.owner.resource
        if self.unavailable(resource):
            owner.refusals[Verdict.UNAVAILABLE] += 1
            return False
        action, fault = command.action, ""
        if action is not None:
            fault = resource.fault(action)
            fault = fault or self.beyond(resource, resource.unpack(action))
        stopped = resource.stops and self.stopped is not None
        verdict = owner.judge(command, self.now, stopped=stopped, fault=fault)
        if verdict is Verdict.OBEYED and action is not None:
            self.obey(resource, resource.unpack(action))
        elif verdict is Verdict.RELEASED:
            self._rest(owned)
        elif verdict is Verdict.OUT_OF_RANGE:
            owner.refusals[f"{command.ballot.instance}: {fault}"] += 1
            owner.refusals.pop(verdict, None)
        return True

    def _take_ack(self, ack: m.Ack) -> bool:
        contender = self._contenders.get(ack.resource)
        if contender is None:
            return False
        if contender.resource.period_s is not None:
            if not self._advance(contender.clock, ack.cycle, contender.resource.ack_key):
                return False
        elif not contender.clock.fresh(ack.cycle):
            return False
        known = contender.ack.cycle if contender.ack is not None else ack.cycle
        if known.epoch == ack.cycle.epoch and known.number > ack.cycle.number:
            return False
        if ack.measured and (fault := contender.resource.fault(ack.measured)):
            why = f"what is measured is left out: {fault}"
            self.outbox.append(Refused(contender.resource.ack_key, why))
        self._say(contender.resource, contender.acked(ack, self.now))
        return True

    def _take_latched(self, message: m.Latched) -> bool:
        news = self._on_latched(message)
        if news and type(message) is m.Stop:
            self._stop_changed()
        if news and type(message) is m.Tuning:
            self._take_over_settings(message)
        return news

    def _advance(self, clock: CycleClock, cycle: m.Cycle, key: str) -> bool:
        """Take a cycle's owner's word for it; tell of a stray, and once of a change of epoch."""
        before, strays, returns = clock.newest, clock.strays, clock.returns
        moved = clock.advance(cycle, self.now)
        if clock.strays != strays:
            self.outbox.append(Refused(key, clock.stray))
        if clock.returns != returns:
            self._returned(clock)
        if moved and before is not None and before.epoch != cycle.epoch:
            self._epoch_changed(key, before.epoch, cycle, back=clock.left(cycle.epoch))
        return moved

    def _returned(self, clock: CycleClock) -> None:
        """Forget what answered numbers that were never true: all that comes is smaller."""
        for contender in self._contenders.values():
            if contender.clock is clock:
                self._turned.pop(contender.resource.name, None)
                contender.returned(self.now)
        for owned in self._owned.values():
            if owned.owner.clock is clock:
                owned.owner.returned()

    def _epoch_changed(self, key: str, before: int, cycle: m.Cycle, *, back: bool) -> None:
        """Whoever starts an owner again knows; of two that take turns people must hear."""
        why = "are two owners at work?" if back else "its owner was started again"
        text = f"{key}: epoch {before:x} is silent, epoch {cycle.epoch:x} goes on ({why})"
        text += f": followed from cycle {cycle.number} on"
        self.log(text, WARNING if back else INFO)

    def _on_latched(self, message: m.Latched) -> bool:
        """Remember a latched state; tell of a counter that cannot be. Whether it is news."""
        memory, kind = self.memory, type(message)
        refused = memory.refused
        news = memory.update(message, self.now)
        if memory.refused != refused:
            done, by = "not believed", ""
            if isinstance(message, m.Stop):
                by = f" by {message.who}"
                if message.stopped and self.stopped is not None:
                    done = "stopped all the same, and counted on from what is known"
            why = f"{done}: a {kind.__name__}{by} with a counter far beyond all that is known"
            self.outbox.append(Refused(service_of(kind).key, why))
        return news

    def _stop_changed(self) -> None:
        """Rest at once: nobody bids while the stop is latched, and whoever does is refused."""
        if self.stopped is not None:
            for owned in self._owned.values():
                if owned.owner.resource.stops:
                    self._rest(owned)
        if self._owned:
            stop = self.memory.newest(m.Stop) or m.Stop()
            self.log(f"{'stopped' if stop.stopped else 'released'} by {stop.who}", WARNING)

    def _newer(self, message: Any, before: Any) -> bool:
        """Refuse what answers a cycle that is long past, not yet there, or before the latest."""
        service = service_of(type(message))
        within = service.fresh_cycles
        if within is None:
            return True
        cycle = message.cycle
        if not self.cycles.fresh(cycle, within):
            return False
        if service.kind is Kind.EVENT:  # of several: who hears the robot later is not out of order
            return True
        age = None if before is None else self.cycles.age(before.cycle)
        # One that answers a number which was never true is no newer than any.
        return age is None or age < -AHEAD or before.cycle.number <= cycle.number

    def _lacks(self, kind: type[Message]) -> str:
        """The key on which something fresh should have come."""
        service, gathering = service_of(kind), self._gatherings.get(kind)
        if gathering is None:
            return service.key
        within = service.fresh_cycles
        return service.key.format(name=gathering.missing(lambda c: self.cycles.fresh(c, within)))

    def _in_time(self, message: Any) -> bool:
        """Whether it may be acted upon, by the table of services."""
        within = service_of(type(message)).fresh_cycles
        return within is None or self.cycles.fresh(message.cycle, within)

    # How it bids ---------------------------------------------------------------------------------

    def _contend(self, resource: Resource) -> Contender:
        social: Social = self.p.social
        period = resource.period_s
        return Contender(
            resource,
            self.instance,
            self.cycles if period is None else CycleClock(period),
            EXCHANGES[social.exchange or resource.exchange],
            self.rng,
            social.margin,
            COMPARISONS[social.comparison],
        )

    def _reacting(self) -> dict[type[Message], tuple[Resource, ...]]:
        """By the type that starts a turn, the resources that are then bid for."""
        found: dict[type[Message], tuple[Resource, ...]] = {}
        for resource in self.competes_for:
            to = self.reacts_to
            kind = to.get(resource) if isinstance(to, Mapping) else to
            kind = m.Ack if kind is None or resource.period_s is not None else kind
            found[kind] = (*found.get(kind, ()), resource)
        return found

    def _begins_turn(self, resource: Resource, message: Any) -> bool:
        """One turn a cycle, and none for an older one, however often its message comes."""
        if type(message) is m.Ack and message.resource != resource.name:
            return False
        last, cycle = self._turned.get(resource.name), message.cycle
        if last is not None and last.epoch == cycle.epoch and cycle.number <= last.number:
            return False
        self._turned[resource.name] = cycle
        return True

    def _turn(self, resource: Resource, message: Any) -> None:
        """One turn: a bid for a resource, if its inputs are fresh."""
        contender = self._contenders[resource.name]
        stale = next((kind for kind in self.needs if self.fresh(kind) is None), None)
        bid, unsound, self.why, self.lacks = None, False, "", ""
        if not contender.clock.alive(self.now) or not contender.owned:
            self.lacks = resource.ack_key
        elif resource.stops and (stop := self.stopped) is not None:
            self.why = f"stopped by {stop.who}"
        elif stale is not None:
            self.lacks = self._lacks(stale)
        else:
            proposed = self.bid_for(resource, message)
            bid = self._sound(resource, proposed)
            unsound = bid is None and proposed is not None
        self.why = self.why or (f"no fresh {self.lacks}" if self.lacks else "")
        self._record(resource, message.cycle, bid, unsound=unsound)
        self._say(resource, contender.bid(message.cycle, bid, self.now, self._oldest_input()))

    def _oldest_input(self) -> m.Cycle | None:
        """The oldest cycle of what it needs; None if it needs nothing that has one."""
        cycles = [c for kind in self.needs if (c := getattr(self._latest.get(kind), "cycle", None))]
        return min(cycles, default=None)

    def _sound(self, resource: Resource, bid: Bid | None) -> Bid | None:
        """A bid that can be sent. One that cannot is no bid: a holder's own NaN is a release."""
        if bid is None:
            return None
        try:
            if not isinstance(bid, Bid):
                raise TypeError(f"{type(bid).__name__} is no Bid")
            utility, within = float(bid.utility), bid.within
            if not 0.0 <= utility <= 1.0:
                raise ValueError(f"its utility is {utility}, and not from 0 to 1")
            if within is not None and not isfinite(within):
                within = None
            reason = m.line(str(bid.reason))[:LONGEST_REASON]
            return Bid(utility, resource.pack(bid.action), bool(bid.critical), within, reason)
        except (TypeError, ValueError) as error:
            self.why = m.line(f"its bid is not sound: {error}")[:LONGEST_REASON]
        self.log(f"{self.instance}: {self.why}", ERROR)
        return None

    def _record(
        self, resource: Resource, cycle: m.Cycle, bid: Bid | None, *, unsound: bool
    ) -> None:
        inputs = self._inputs
        if bid is None:
            why = m.line(self.why)[:LONGEST_REASON]
            lacks = m.line(self.lacks)
            record = m.BidRecord(cycle, resource.name, None, False, (), why, inputs, lacks, unsound)
        else:
            record = m.BidRecord(
                cycle, resource.name, bid.utility, bid.critical, bid.action, bid.reason, inputs
            )
        self.bids.append(record)

    def _say(self, resource: Resource, messages: list[Message]) -> None:
        for message in messages:
            claim = type(message) is m.Claim
            key = resource.utility_key if claim else resource.command_key_of(self.instance)
            self.outbox.append(Publish(key, message))

    def _declared_otherwise(self, card: m.Card) -> str:
        """How somebody means a resource of one's own otherwise than oneself."""
        own = [each.signature for each in (*self.competes_for, *self.owns)]
        differing = differently(card.declares, own)
        return "" if differing is None else f"{differing[0]} where this one means {differing[1]}"

    # How it owns ---------------------------------------------------------------------------------

    def _own(self, resource: Resource) -> _Owned:
        period = resource.period_s
        if period is None:
            return _Owned(Owner(resource, self.cycles))
        counter = CycleCounter(self.rng.getrandbits(63), period)
        return _Owned(Owner(resource, CycleClock(period)), counter)

    def _acknowledge(self, owned: _Owned) -> None:
        """Say what is obeyed, once a cycle; and now and then what was refused."""
        resource = owned.owner.resource
        measured = self.measure(resource)
        if measured and (fault := resource.fault(measured)):
            why = f"{type(self).__name__}.measure: {fault}; it is left out"
            self.outbox.append(Refused(resource.ack_key, why))
            measured = ()
        ack = owned.owner.ack(measured)
        if ack is not None:
            self.outbox.append(Publish(resource.ack_key, ack))
        refusals = owned.owner.refusals
        if refusals and self.now - owned.complained_at >= REPORT_S:
            owned.complained_at = self.now
            told = [f"{count} x {verdict}" for verdict, count in refusals.items()]
            if len(told) > REASONS_TOLD:
                told[REASONS_TOLD:] = [f"{sum(refusals.values())} in all"]
            text = "; ".join(told)
            level = INFO if set(refusals) <= AT_WORK else WARNING
            self.log(f"commands refused: {text}", level, m.LogEvent.COMMANDS_REFUSED)
            refusals.clear()

    def _mind(self, owned: _Owned) -> None:
        """Its own cycle, and the silence after which it rests."""
        silent_at = owned.owner.silent_at
        if silent_at is not None and self.now >= silent_at:
            resource = owned.owner.resource
            after = resource.silence(self.cycles.period)
            self.log(f"{resource.name}: no valid command for {after:g} s: stop", WARNING)
            self._rest(owned)
        if owned.counter is not None and owned.due is not None and self.now >= owned.due:
            owned.owner.clock.advance(owned.counter.next(self.now), self.now)
            late = self.now - owned.due
            owned.due += owned.counter.period * (1 + late // owned.counter.period)
            self._acknowledge(owned)

    def _rest(self, owned: _Owned) -> None:
        owned.owner.rested()
        self.rest(owned.owner.resource)

    def _handler(self, kind: type[Message]) -> Callable[[Any], Any] | None:
        snake = re.sub(r"(?<!^)(?=[A-Z])", "_", kind.__name__).lower()
        return getattr(self, f"on_{snake}", None)


class DeviceAgent(Agent):
    """An agent that owns a device: bytes in, bytes out."""

    address: str = ""
    """The URL of its device, which the transport of its scheme opens; none: nothing is opened."""

    def on_bytes(self, data: bytes) -> None:
        """Bytes from the device."""

    def on_link(self, up: bool, why: str) -> None:
        """The device was opened, or is gone."""

    def write(self, data: bytes) -> None:
        """Bytes for the device. What a pause of the process holds up for 0.3 s is not sent."""
        if data:
            self.outbox.append(Write(data))

    def take_bytes(self, data: bytes, now: float) -> None:
        """Called by whoever runs it.

        Who hung for longer than a silence rests what it owns first: the device's bytes may come
        before the wake-up that is due, and what they cause would be what was asked for before.
        """
        self.now = now
        for owned in self._owned.values():
            self._mind(owned)
        self.on_bytes(data)

    def take_link(self, up: bool, why: str, now: float) -> None:
        """Called by whoever runs it."""
        self.now = now
        self.on_link(up, why)
