"""The agent pattern of thesis 3.3 as a base class.

Individual intelligence is what a subclass writes: handlers for messages (`on_<message>`) and, for a
behaviour, `bid`; for an owner of a resource, `obey` and `rest`. Social intelligence comes with this
class: freshness, turns, winner determination, exchange, acknowledgements, the stop, latched states,
the card. An agent holds no socket, thread, clock or sleep. Its driver (`armadico.core.driver`)
passes messages and the time to it and sends the contents of `outbox`.

The modules of figure 3.6: internal state is the subclass's attributes and `latest`; collaboration
is `reacts_to`, `needs`, `receives`, `provides`, `answers` and `queries`; goal is `bid` and the
handlers; competition is `competes_for`; coordination is one `Contender` per resource; helper
methods are here.
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

from armadico.core import changeable, names, parameters
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

MOST_SETTINGS = 256  # parameters set live that are replicated, of all agents together
RESTORED = "those who remember"  # the `by` of a parameter change restored after a restart
LONGEST_REASON = 200  # characters of a bid's reason that are kept
REPORT_S = 2.0  # shortest time between two reports of refused commands, s
# Different reasons in one report. Each excessive speed is a reason of its own.
REASONS_REPORTED = 3

# Refusals that every exchange and every start causes. They are no fault.
EXPECTED_REFUSALS = frozenset({Verdict.STALE_BALLOT, Verdict.OVER, Verdict.LISTENING})


Parameters = parameters.Parameters
Social = parameters.Social


@dataclass(frozen=True)
class Identity:
    """An instance's identity, set by the process that runs it."""

    instance: str
    host: str = "localhost"
    pid: int = 0
    version: str = ""
    rng: random.Random = field(default_factory=random.Random, compare=False)
    table: str = ""  # the digest of its host table; empty: it has none


@dataclass(frozen=True, slots=True)
class Subscription:
    """A subscription: messages of a type on the keys of a pattern."""

    message: type[Message]
    pattern: str
    kind: Kind


@dataclass(frozen=True, slots=True)
class Publish:
    key: str
    message: Message


@dataclass(frozen=True, slots=True)
class Question:
    """A received query. An agent that does not reply at once keeps it for `Agent.answer`."""

    id: int


@dataclass(frozen=True, slots=True)
class SendQuery:
    """Send a query. The reply arrives at `Agent.replied` with this id."""

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
    """Write bytes to the agent's device."""

    data: bytes


@dataclass(frozen=True, slots=True)
class Refused:
    """A rejected message. The driver counts these by reason and reports them at intervals."""

    key: str
    why: str  # the sender, the fault and the consequence; few different texts


Outgoing = Publish | SendQuery | Answer | Write | Refused


@dataclass
class _Owned:
    """A resource that this agent owns."""

    owner: Owner
    counter: CycleCounter | None = None  # only of a resource with its own period
    due: float | None = None  # when the counter's next cycle begins, s
    reported_at: float = float("-inf")


class _Pending:
    """Callbacks of the queries that are not answered yet, by number."""

    def __init__(self) -> None:
        self._last = 0
        self._then: dict[int, Callable[[Any], None]] = {}

    def put(self, then: Callable[[Any], None]) -> int:
        """Return the number of the added callback."""
        self._last += 1
        self._then[self._last] = then
        return self._last

    def pop(self, number: int) -> Callable[[Any], None] | None:
        return self._then.pop(number, None)


class Agent:
    """One agent. A subclass declares its messages and resources and adds handlers and methods.

    A subclass that takes a name of this class, other than a declaration, a hook or a handler, is
    refused when it is made (`armadico.core.names`).
    """

    name: ClassVar[str] = ""
    reacts_to: ClassVar[type[Message] | Mapping[Resource, type[Message]] | None] = None
    """The message that starts the agent's turn in a cycle, by resource if they differ. None is the
    owner's ack, with which each cycle of a resource begins."""
    needs: ClassVar[tuple[type[Message], ...]] = ()  # must be fresh, or it does not bid
    receives: ClassVar[tuple[type[Message], ...]] = ()  # other subscriptions
    provides: ClassVar[tuple[type[Message], ...]] = ()
    answers: ClassVar[tuple[type[Message], ...]] = ()  # queries it answers
    queries: ClassVar[tuple[type[Message], ...]] = ()  # queries it sends
    competes_for: ClassVar[tuple[Resource, ...]] = ()
    owns: ClassVar[tuple[Resource, ...]] = ()
    alone: ClassVar[bool] = False  # a second instance in the namespace may not join
    parameters: ClassVar[type[Parameters]] = Parameters
    launched_with: ClassVar[tuple[str, ...]] = ()
    """Names of the parameters that the launcher sets from the scenario (see
    `armadico.launch.society.facts`)."""

    changeable: ClassVar[Mapping[str, str]] = MappingProxyType({})
    """Units, by name, of the parameters that may be changed while the agent runs. Names in tables
    have dots. Such parameters are read from `p` at each use, or again in `on_parameters`."""

    borders: ClassVar[Mapping[str, Callable[[float], float]]] = MappingProxyType({})
    """Outlines that a picture draws around the robot: speed in m/s to distance from the footprint
    in m."""

    def __init_subclass__(
        cls, *, overrides: tuple[str, ...] = (), hooks: tuple[str, ...] | None = None, **rest: Any
    ) -> None:
        """Refuse a class that takes a name of the framework, with TypeError.

        Args:
            overrides: Names that it takes on purpose: it calls `super()`.
            hooks: Of a base class for other agents: its methods that these may replace. Its other
                names are taken, too. None: it is no base class.
            rest: For other base classes.
        """
        super().__init_subclass__(**rest)
        names.check(cls, overrides)
        if hooks is not None:
            names.take(cls, hooks)

    def __init__(self, identity: Identity, parameters: Any = None) -> None:
        self.identity = identity
        self.instance = identity.instance
        self.rng = identity.rng
        self.drawn = self.rng.getstate()  # before the first draw: a replay begins here
        self.p: Parameters = self.parameters() if parameters is None else parameters
        self._begun = self.p  # at start
        self._set: dict[str, str] = {}  # set live, by this or an earlier instance: JSON by name
        changeable.allowed(type(self.p), self.changeable)  # raises for a wrong name
        self.now = 0.0
        self.cycles = CycleClock()  # the robot's
        self.tenure = 0  # cycles for which it has worked
        self.outbox: list[Outgoing] = []
        self.memory = Memory(self.rng)  # of latched states
        self.foreign: set[str] = set()  # instances with another protocol or other resources
        self.reachable = True  # whether the robot's router can be reached
        self.bids: deque[m.BidRecord] = deque(maxlen=BIDS_REMEMBERED)
        self._latest: dict[type[Message], Message] = {}
        self._inputs = tuple(service_of(kind).pattern for kind in self.needs)
        self._receivers: dict[type[Message], Callable[[Any], bool]] = {
            m.RobotState: self._receive_state,
            m.Description: self._receive_description,
            m.Claim: self._receive_claim,
            m.Command: self._receive_command,
            m.Ack: self._receive_ack,
            **{service.message: self._receive_latched for service in latched()},
        }
        subscribed = {subscription.message for subscription in self.subscriptions()}
        self._gatherings: dict[type[Message], Gathering] = {  # of several publishers
            kind: gather() for kind in subscribed if (gather := service_of(kind).gather) is not None
        }
        self._handlers = {kind: self._handler(kind) for kind in subscribed}
        self._answerers = {kind: self._handler(kind) for kind in self.answers}
        self._alarm: float | None = None
        self._pending = _Pending()
        self._turned: dict[str, m.Cycle] = {}  # by resource, the cycle of the last turn
        self._owned = {r.name: self._own(declare(r)) for r in self.owns}
        self._contenders = {r.name: self._contend(declare(r)) for r in self.competes_for}
        self._reactions = self._reacting()

    # What a subclass may write -------------------------------------------------------------------

    def bid(self, message: Any) -> Bid | None:  # noqa: ARG002
        """The goal method: return the agent's bid, or None for no bid.

        Called once per cycle with the message that the agent reacts to. All needs are fresh and the
        robot is not stopped. Without a bid, `self.why` may be set to the reason and `self.lacks` to
        the key of the missing input.
        """
        return None

    def bid_for(self, resource: Resource, message: Any) -> Bid | None:  # noqa: ARG002
        """Return the bid for a resource, in an agent that competes for several."""
        return self.bid(message)

    def obey(self, resource: Resource, action: Any) -> None:
        """The owner's method: execute an action (numbers or a message, as the resource has)."""

    def rest(self, resource: Resource) -> None:
        """The owner's method: bring the resource to rest after a release, a timeout or a stop."""

    def measure(self, resource: Resource) -> m.Action:
        """Return what an owned resource does now, in the order of its parameters."""
        return resource.neutral

    def beyond(self, resource: Resource, action: Any) -> str:  # noqa: ARG002
        """Return which owner's limit an action of the right shape exceeds; "" if none."""
        return ""

    def unavailable(self, resource: Resource) -> str:  # noqa: ARG002
        """Return why an owned resource can obey no command now; "" if it can."""
        return ""

    def on_start(self) -> None:
        """Called once, before any message except latched ones."""

    def on_wakeup(self) -> None:
        """Called at the time given to `wake_at`."""

    def on_parameters(self, before: Any) -> None:
        """Called when some of `changeable` were changed; `p` is new, `before` is the old value.

        An agent computes derived values again here. It raises ValueError before that to reject the
        change.
        """

    def on_appeared(self, name: str, instance: str) -> None:
        """Called when an instance's liveliness token appears."""

    def on_disappeared(self, name: str, instance: str) -> None:
        """Called when an instance's liveliness token disappears."""

    def on_card(self, card: m.Card) -> None:
        """Called with the card of a live instance."""

    def on_router(self) -> None:
        """Called when the robot's router becomes reachable or unreachable: `reachable`."""

    # What a subclass uses ------------------------------------------------------------------------

    why: str = ""
    lacks: str = ""

    def key_of(self, kind: type[Message], **names: str) -> str:
        """Return the key of a kind's service, filled with `names`, else this instance's names."""
        key = service_of(kind).key
        if "{" not in key:
            return key
        return key.format(**{"instance": self.instance, "name": self.name, **names})

    def publish(self, message: Message, **names: str) -> None:
        """Publish a message on its service's key; `names` fill the key's braces."""
        service = service_of(type(message))
        key = self.key_of(type(message), **names)
        if service.kind is Kind.LATCHED:
            with suppress(m.MessageError):  # a message that cannot be sent is not stored either
                self.memory.note(m.checked(cast("m.Latched", message)))
        self.outbox.append(Publish(key, message))

    def latest(self, kind: type[M]) -> M | None:
        """Return the newest message of a kind, fresh or not."""
        return cast("M | None", self._latest.get(kind))

    def fresh(self, kind: type[M]) -> M | None:
        """Return the newest message of a kind if it is fresh by the table of services."""
        message = self._latest.get(kind)
        if message is None or not self._in_time(message):
            return None
        return cast("M", message)

    def each_fresh(self, base: type[M]) -> list[M]:
        """Return the fresh messages of all subscribed kinds that derive from a base."""
        found = (self.fresh(kind) for kind in derived(base))
        return [cast("M", message) for message in found if message is not None]

    def query(
        self,
        request: Message,
        then: Callable[[Any], None],
        timeout: float = 2.0,
        instance: str = "",
    ) -> None:
        """Send a query; `then` gets the first reply, or None after the timeout (s).

        `instance` is the receiver, where the service's key has one.
        """
        service = service_of(type(request))
        assert service.reply is not None, f"{service.key} is not a query"
        key = self.key_of(type(request), instance=instance or self.instance)
        self._put(key, request, service.reply, then, timeout)

    def query_card(
        self, name: str, instance: str, then: Callable[[Any], None], timeout: float = 1.0
    ) -> None:
        """Query an instance's card; `then` gets it, or None after the timeout (s)."""
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
        self.outbox.append(SendQuery(self._pending.put(then), key, request, reply, timeout))

    def answer(self, question: Question, reply: Message) -> None:
        self.outbox.append(Answer(question.id, reply))

    def wake_at(self, when: float) -> None:
        """Set the agent's only wake-up: `on_wakeup` is called at this time, s."""
        self._alarm = when

    def holds(self, resource: Resource) -> bool:
        """Return whether the agent holds the resource, by its own state."""
        return self._contenders[resource.name].holding

    def acked(self, resource: Resource) -> m.Ack | None:
        """Return the last acknowledgement of the resource's owner."""
        return self._contenders[resource.name].ack

    def owner(self, resource: Resource) -> Owner:
        return self._owned[resource.name].owner

    @property
    def stopped(self) -> m.Stop | None:
        """The robot's stop, while it is latched."""
        stop = self.memory.newest(m.Stop)
        return stop if stop is not None and stop.stopped else None

    def latch(self, by: str) -> None:
        """Latch the robot's stop. Any agent may; only the operator releases it."""
        known = self.memory.newest(m.Stop) or m.Stop()
        press = self.rng.getrandbits(63)
        self.publish(m.Stop(m.next_count(known.counter), stopped=True, by=by, press=press))
        self._stop_changed()

    def acknowledge(self) -> None:
        """Acknowledge all owned resources, in the agent that makes the cycles.

        Other owners acknowledge when they receive the robot's state.
        """
        for owned in self._owned.values():
            self._acknowledge(owned)

    def log(self, text: str, level: int = INFO, event: str = "") -> None:
        """Publish a log line; `event` (`m.LogEvent`) is for programs."""
        self.publish(m.Log(level, m.line(text), event))

    # What the driver calls -----------------------------------------------------------------------

    def start(self, now: float) -> None:
        self.now = now
        self.tenure = 1
        for owned in self._owned.values():
            if owned.counter is not None:
                owned.due = now
        before = frozenset(vars(self))
        self.on_start()
        names.check_set(self, before)
        for message in self.memory.all():  # received before the start
            if type(message) is m.Tuning:
                self._adopt_settings(message)
            handler = self._handlers.get(type(message))
            if handler is not None:
                handler(message)

    def receive(self, message: Message, now: float) -> None:
        """Process one message of a subscription."""
        self.now = now
        kind = type(message)
        receiver = self._receivers.get(kind)
        gathering = self._gatherings.get(kind)
        if gathering is not None:
            if not (gathering.counts(message) and self._newer(message, gathering.newest(message))):
                return
            gathered = gathering.update(message)
            if gathered is None:
                return
            message = gathered
        elif not (receiver(message) if receiver else self._newer(message, self._latest.get(kind))):
            return
        self._latest[kind] = message
        handler = self._handlers.get(kind)
        if handler is not None:
            handler(message)
        for resource in self._reactions.get(kind, ()):
            if self._begins_turn(resource, message):
                self._turn(resource, message)

    def accepted(self, message: Message) -> bool:
        """Return whether a received message is the newest of its publisher."""
        gathering = self._gatherings.get(type(message))
        if gathering is not None:
            return gathering.newest(message) is message
        return self._latest.get(type(message)) is message

    def remember(self, message: m.Latched, now: float) -> None:
        """Store a latched state that is received before the start."""
        self.now = now
        self._latest[type(message)] = message
        self._on_latched(message)

    def on_query(self, request: Message, question: Question, now: float) -> None:
        """Process a received query; the `Answer` enters the outbox now or later."""
        self.now = now
        answerer = self._answerers.get(type(request))
        if answerer is not None:
            reply = answerer(request, question)
            if reply is not None:
                self.answer(question, reply)

    def on_reply(self, question_id: int, reply: Message | None, now: float) -> None:
        """Process the reply to a query; None after a timeout."""
        self.now = now
        then = self._pending.pop(question_id)
        if then is not None:
            then(reply)

    def appeared(self, name: str, instance: str, now: float) -> None:
        """Process a new liveliness token."""
        self.now = now
        self.memory.met(now)
        self.on_appeared(name, instance)

    def met(self, card: m.Card, now: float) -> None:
        """Process an instance's card; messages of an incompatible instance are then rejected."""
        self.now = now
        self.on_card(card)
        if card.instance in self.foreign:
            return
        if card.protocol != m.PROTOCOL:
            why = f"uses protocol {card.protocol}, this agent {m.PROTOCOL}"
        elif differing := self._resource_mismatch(card):
            why = f"declares {differing}"
        else:
            return
        self.foreign.add(card.instance)
        sender = f"{card.instance} (host {card.host}, pid {card.pid})"
        self.log(f"{sender} {why}: its claims and commands are refused", ERROR)

    def disappeared(self, name: str, instance: str, now: float) -> None:
        """Process the end of a liveliness token."""
        self.now = now
        self.foreign.discard(instance)
        for contender in self._contenders.values():
            self._publish_all(contender.resource, contender.gone(instance, now))
        self.on_disappeared(name, instance)

    def router(self, there: bool, now: float) -> None:
        """Process that the robot's router became reachable or unreachable."""
        self.now = now
        if there != self.reachable:
            self.reachable = there
            if there:  # latched states may have been missed while disconnected
                self.memory.met(now)
            self.on_router()

    def wake(self, now: float) -> None:
        """Process everything that is due; called when `wakeup` is reached."""
        self.now = now
        for owned in self._owned.values():
            self._check_times(owned)
        for contender in self._contenders.values():
            due = contender.wakeup
            if due is not None and now >= due:
                self._publish_all(contender.resource, contender.tick(now))
        for message in self.memory.due(now):
            self.publish(message)
        if self._alarm is not None and now >= self._alarm:
            self._alarm = None
            self.on_wakeup()

    @property
    def wakeup(self) -> float | None:
        """When `wake` is due, s; None: not at all."""
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
        """Release all held resources and rest all owned ones."""
        self.now = now
        for contender in self._contenders.values():
            cycle = contender.clock.newest or m.Cycle(0, 0)
            self._publish_all(contender.resource, contender.bid(cycle, None, now))
        for owned in self._owned.values():
            self._rest(owned)

    @classmethod
    def subscriptions(cls) -> tuple[Subscription, ...]:
        """Return the declared subscriptions and those of the social intelligence."""
        triggers = cls.reacts_to.values() if isinstance(cls.reacts_to, Mapping) else [cls.reacts_to]
        kinds = [kind for kind in triggers if kind is not None and kind is not m.Ack]
        kinds += [*cls.needs, *(kind for base in cls.receives for kind in derived(base))]
        if kinds or cls.provides or cls.competes_for or cls.owns:  # needs the robot's cycles
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
        """Return the agent's identity and what it offers (thesis table 3.1)."""
        identity = self.identity
        resources = dict.fromkeys((*self.competes_for, *self.owns))
        return m.Card(
            name=self.name,
            instance=self.instance,
            host=identity.host,
            pid=identity.pid,
            version=identity.version,
            protocol=m.PROTOCOL,
            provides=tuple(self.key_of(k) for k in (*self.provides, *self.answers)),
            requests=tuple(s.pattern for s in self.subscriptions() if self._requests(s))
            + tuple(service_of(k).key for k in self.queries),
            resources=tuple(r.name for r in self.competes_for),
            holds=tuple(r.name for r in self.competes_for if self.holds(r)),
            owns=tuple(r.name for r in self.owns),
            tenure=min(self.tenure, m.LONGEST_TENURE),
            declares=tuple(r.signature for r in resources),
            world=m.line(PurePath(str(getattr(self.p, "world", None) or "")).stem),
            table=identity.table,
        )

    def _requests(self, to: Subscription) -> bool:
        """Return whether this agent needs a subscription that not every agent has."""
        common = to.kind is Kind.LATCHED or to.message is m.Description
        return not common or to.message in (*self.receives, *self.needs)

    def tune(self, request: m.ParametersRequest, now: float) -> m.ParametersReply:
        """Apply all requested changes or none; return the changeable parameters afterwards."""
        self.now, refusal = now, ""
        if request.change:
            try:
                self._change(request)
            except ValueError as error:
                refusal = m.line(str(error))
        rows = changeable.listed(self.p, self._begun, self.changeable)
        return m.ParametersReply(self.instance, rows, refusal)

    def _change(self, request: m.ParametersRequest) -> None:
        """Apply a request. Raises ValueError with the fault; nothing is changed then."""
        self._apply_settings(request.change, request.by or "an unknown program")
        self._set |= {setting.name: setting.json for setting in request.change}
        self._share_settings()

    def _apply_settings(self, change: tuple[m.Setting, ...], by: str) -> None:
        """Change parameters and publish it. Raises ValueError; nothing is changed then."""
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

    def _share_settings(self) -> None:
        """Publish this agent's settings as part of the latched state of all agents."""
        known = self.memory.newest(m.Tuning) or m.Tuning(0, 0)
        others = [each for each in known.settings if each.agent != self.name]
        mine = [m.AgentSetting(self.name, m.Setting(*each)) for each in self._set.items()]
        if known.settings == (settings := (*others, *mine)):
            return
        by = self.rng.getrandbits(63)
        self.publish(m.Tuning(m.next_count(known.counter), by, settings[-MOST_SETTINGS:]))

    def _adopt_settings(self, tuning: m.Tuning) -> None:
        """Apply the settings that an earlier or another instance of this agent received."""
        mine = {e.setting.name: e.setting.json for e in tuning.settings if e.agent == self.name}
        for name, value in mine.items():
            if self._set.get(name) == value:
                continue
            self._set[name] = value
            try:
                self._apply_settings((m.Setting(name, value),), RESTORED)
            except ValueError as error:  # for example by an instance of another version
                self.log(f"not set as before: {error}", WARNING)
        if set(self._set) - set(mine):  # the publisher did not have them
            self._share_settings()

    def history(self) -> m.BidHistory:
        return m.BidHistory(self.instance, tuple(self.bids))

    # Reception -----------------------------------------------------------------------------------

    def _receive_state(self, state: m.RobotState) -> bool:
        if not self._advance(self.cycles, state.cycle, service_of(m.RobotState).key):
            return False
        self.tenure += 1
        if state.stop != self.memory.newest(m.Stop) and self._on_latched(state.stop):
            self._stop_changed()
        for owned in self._owned.values():
            if owned.counter is None:
                self._acknowledge(owned)
        return True

    def _receive_description(self, description: m.Description) -> bool:
        self.cycles.period = description.cycle_s
        for gathering in self._gatherings.values():
            gathering.describe(description)
        return True

    def _receive_claim(self, claim: m.Claim) -> bool:
        if claim.ballot.instance in self.foreign:
            return False
        contender = self._contenders.get(claim.resource)
        if contender is not None:
            self._publish_all(contender.resource, contender.on_claim(claim, self.now))
        owned = self._owned.get(claim.resource)
        if owned is not None and owned.owner.on_claim(claim):
            self._rest(owned)
        return True

    def _receive_command(self, command: m.Command) -> bool:
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

    def _receive_ack(self, ack: m.Ack) -> bool:
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
            why = f"measured values are ignored: {fault}"
            self.outbox.append(Refused(contender.resource.ack_key, why))
        self._publish_all(contender.resource, contender.acked(ack, self.now))
        return True

    def _receive_latched(self, message: m.Latched) -> bool:
        news = self._on_latched(message)
        if news and type(message) is m.Stop:
            self._stop_changed()
        if news and type(message) is m.Tuning:
            self._adopt_settings(message)
        return news

    def _advance(self, clock: CycleClock, cycle: m.Cycle, key: str) -> bool:
        """Advance a clock to its owner's cycle; report strays and changes of epoch."""
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
        """Discard turns and obeyed cycles of false numbers, as all later numbers are smaller."""
        for contender in self._contenders.values():
            if contender.clock is clock:
                self._turned.pop(contender.resource.name, None)
                contender.returned(self.now)
        for owned in self._owned.values():
            if owned.owner.clock is clock:
                owned.owner.returned()

    def _epoch_changed(self, key: str, before: int, cycle: m.Cycle, *, back: bool) -> None:
        # Two owners that take turns are a fault; a restart of the owner is known to the operator.
        why = "two owners may be running" if back else "its owner has restarted"
        text = f"{key}: epoch {before:x} ended, epoch {cycle.epoch:x} began at cycle {cycle.number}"
        self.log(f"{text} ({why})", WARNING if back else INFO)

    def _on_latched(self, message: m.Latched) -> bool:
        """Store a latched state, report an implausible counter; return whether it is new."""
        memory, kind = self.memory, type(message)
        refused = memory.refused
        news = memory.update(message, self.now)
        if memory.refused != refused:
            done, by = "rejected", ""
            if isinstance(message, m.Stop):
                by = f" by {message.requester}"
                if message.stopped and self.stopped is not None:
                    done = "stopped, with the next known counter"
            why = f"{done}: a {kind.__name__}{by} has an implausible counter"
            self.outbox.append(Refused(service_of(kind).key, why))
        return news

    def _stop_changed(self) -> None:
        """Rest all owned resources that the stop concerns; while it is latched no agent bids."""
        if self.stopped is not None:
            for owned in self._owned.values():
                if owned.owner.resource.stops:
                    self._rest(owned)
        if self._owned:
            stop = self.memory.newest(m.Stop) or m.Stop()
            self.log(f"{'stopped' if stop.stopped else 'released'} by {stop.requester}", WARNING)

    def _newer(self, message: Any, before: Any) -> bool:
        """Return whether a message's cycle is fresh and not before the latest message's."""
        service = service_of(type(message))
        within = service.fresh_cycles
        if within is None:
            return True
        cycle = message.cycle
        if not self.cycles.fresh(cycle, within):
            return False
        if service.kind is Kind.EVENT:  # events of several publishers need not be in cycle order
            return True
        age = None if before is None else self.cycles.age(before.cycle)
        # A message with a false number, far ahead, does not count as newer.
        return age is None or age < -AHEAD or before.cycle.number <= cycle.number

    def _lacks(self, kind: type[Message]) -> str:
        """Return the key on which a fresh message is missing."""
        service, gathering = service_of(kind), self._gatherings.get(kind)
        if gathering is None:
            return service.key
        within = service.fresh_cycles
        return service.key.format(name=gathering.missing(lambda c: self.cycles.fresh(c, within)))

    def _in_time(self, message: Any) -> bool:
        within = service_of(type(message)).fresh_cycles
        return within is None or self.cycles.fresh(message.cycle, within)

    # Bidding -------------------------------------------------------------------------------------

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
        """Return the resources to bid for, by the message type that starts the turn."""
        found: dict[type[Message], tuple[Resource, ...]] = {}
        for resource in self.competes_for:
            to = self.reacts_to
            kind = to.get(resource) if isinstance(to, Mapping) else to
            kind = m.Ack if kind is None or resource.period_s is not None else kind
            found[kind] = (*found.get(kind, ()), resource)
        return found

    def _begins_turn(self, resource: Resource, message: Any) -> bool:
        """Return whether a message starts a turn: one per cycle, none for an older cycle."""
        if type(message) is m.Ack and message.resource != resource.name:
            return False
        last, cycle = self._turned.get(resource.name), message.cycle
        if last is not None and last.epoch == cycle.epoch and cycle.number <= last.number:
            return False
        self._turned[resource.name] = cycle
        return True

    def _turn(self, resource: Resource, message: Any) -> None:
        """Bid for a resource if the inputs are fresh."""
        contender = self._contenders[resource.name]
        stale = next((kind for kind in self.needs if self.fresh(kind) is None), None)
        bid, unsound, self.why, self.lacks = None, False, "", ""
        if not contender.clock.alive(self.now) or not contender.owned:
            self.lacks = resource.ack_key
        elif resource.stops and (stop := self.stopped) is not None:
            self.why = f"stopped by {stop.requester}"
        elif stale is not None:
            self.lacks = self._lacks(stale)
        else:
            proposed = self.bid_for(resource, message)
            bid = self._sound(resource, proposed)
            unsound = bid is None and proposed is not None
        self.why = self.why or (f"no fresh {self.lacks}" if self.lacks else "")
        self._record(resource, message.cycle, bid, unsound=unsound)
        messages = contender.bid(message.cycle, bid, self.now, self._oldest_input())
        self._publish_all(resource, messages)

    def _oldest_input(self) -> m.Cycle | None:
        """Return the oldest cycle of the needed messages; None if none has a cycle."""
        cycles = [c for kind in self.needs if (c := getattr(self._latest.get(kind), "cycle", None))]
        return min(cycles, default=None)

    def _sound(self, resource: Resource, bid: Bid | None) -> Bid | None:
        """Return the bid if it can be sent, else None: a holder's NaN is a release."""
        if bid is None:
            return None
        try:
            if not isinstance(bid, Bid):
                raise TypeError(f"expected a Bid, not {type(bid).__name__}")
            utility, within = float(bid.utility), bid.within
            if not 0.0 <= utility <= 1.0:
                raise ValueError(f"its utility must be from 0 to 1 (got {utility})")
            if within is not None and not isfinite(within):
                within = None
            reason = m.line(str(bid.reason))[:LONGEST_REASON]
            return Bid(utility, resource.pack(bid.action), bool(bid.critical), within, reason)
        except (TypeError, ValueError) as error:
            self.why = m.line(f"its bid is invalid: {error}")[:LONGEST_REASON]
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

    def _publish_all(self, resource: Resource, messages: list[Message]) -> None:
        for message in messages:
            claim = type(message) is m.Claim
            key = resource.utility_key if claim else resource.command_key_of(self.instance)
            self.outbox.append(Publish(key, message))

    def _resource_mismatch(self, card: m.Card) -> str:
        """Return how a card declares a resource of this agent differently; "" if it does not."""
        own = [each.signature for each in (*self.competes_for, *self.owns)]
        differing = differently(card.declares, own)
        return "" if differing is None else f"{differing[0]}, this agent {differing[1]}"

    # Owning --------------------------------------------------------------------------------------

    def _own(self, resource: Resource) -> _Owned:
        period = resource.period_s
        if period is None:
            return _Owned(Owner(resource, self.cycles))
        counter = CycleCounter(self.rng.getrandbits(63), period)
        return _Owned(Owner(resource, CycleClock(period)), counter)

    def _acknowledge(self, owned: _Owned) -> None:
        """Publish the cycle's acknowledgement; report refusals at intervals."""
        resource = owned.owner.resource
        measured = self.measure(resource)
        if measured and (fault := resource.fault(measured)):
            why = f"{type(self).__name__}.measure: {fault}; the values are ignored"
            self.outbox.append(Refused(resource.ack_key, why))
            measured = ()
        ack = owned.owner.ack(measured)
        if ack is not None:
            self.outbox.append(Publish(resource.ack_key, ack))
        refusals = owned.owner.refusals
        if refusals and self.now - owned.reported_at >= REPORT_S:
            owned.reported_at = self.now
            counts = [f"{count} x {verdict}" for verdict, count in refusals.items()]
            if len(counts) > REASONS_REPORTED:
                counts[REASONS_REPORTED:] = [f"{sum(refusals.values())} in all"]
            text = "; ".join(counts)
            level = INFO if set(refusals) <= EXPECTED_REFUSALS else WARNING
            self.log(f"commands refused: {text}", level, m.LogEvent.COMMANDS_REFUSED)
            refusals.clear()

    def _check_times(self, owned: _Owned) -> None:
        """Rest a resource after its command timeout; begin its next cycle if it has its own."""
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

    def _handler(self, kind: type[Message]) -> Callable[..., Any] | None:
        snake = re.sub(r"(?<!^)(?=[A-Z])", "_", kind.__name__).lower()
        return getattr(self, f"on_{snake}", None)


names.take(Agent)


class DeviceAgent(Agent, hooks=("address",), overrides=("now",)):
    """An agent that owns a device: bytes in, bytes out."""

    address: str = ""
    """The device's URL, opened by the transport of its scheme; empty: none is opened."""

    def on_bytes(self, data: bytes) -> None:
        """Called with bytes from the device."""

    def on_link(self, up: bool, why: str) -> None:
        """Called when the device was opened or lost."""

    def write(self, data: bytes) -> None:
        """Write to the device. Bytes that a pause of the process delays by 0.3 s are dropped."""
        if data:
            self.outbox.append(Write(data))

    def receive_bytes(self, data: bytes, now: float) -> None:
        """Process bytes from the device; called by the driver."""
        self.now = now
        # After a hang, the device's bytes may come before the wake-up that is due. A command that
        # has timed out must not be executed on them.
        for owned in self._owned.values():
            self._check_times(owned)
        self.on_bytes(data)

    def update_link(self, up: bool, why: str, now: float) -> None:
        """Process that the device was opened or lost; called by the driver."""
        self.now = now
        self.on_link(up, why)
