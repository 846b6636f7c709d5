"""The social intelligence of one agent (thesis 3.3): what makes the user's object a contender.

A kernel owns the object that a user wrote, an `Agent`. The driver calls the kernel; the kernel
calls the agent's handlers and hooks, and nothing else of it. It has the clocks, the newest
messages, the latched states, the queries under way, one `Bidding` for each resource that the agent
competes for and one `Owning` for each that it owns. Sans-IO: the driver passes messages and the
time, and sends the contents of `outbox`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import PurePath
from typing import Any, Final, cast

from msgspec.structs import replace

from armadico.core import messages as m
from armadico.core import names
from armadico.core.bidding import Bidding
from armadico.core.coordination import Verdict
from armadico.core.cycles import AHEAD, CycleClock
from armadico.core.desk import Authored, Desk
from armadico.core.individual import Individual
from armadico.core.latched import what_of
from armadico.core.mechanisms import mixed, mixture
from armadico.core.messages import Message
from armadico.core.outgoing import (
    ERROR,
    INFO,
    WARNING,
    Answer,
    Publish,
    Question,
    Refused,
    SendQuery,
)
from armadico.core.owning import Owning
from armadico.core.resources import Resource, declare, differently
from armadico.core.services import (
    RELEASE,
    SPOKEN,
    Gathering,
    Kind,
    Service,
    derived,
    latched,
    service_of,
)
from armadico.core.settings import Settings

# Foreign instances that have gone and are still refused. Late messages come within cycles.
FOREIGN_REMEMBERED: Final = 64


@dataclass(frozen=True, slots=True)
class Subscription:
    """A subscription: messages of a type on the keys of a pattern."""

    message: type[Message]
    pattern: str
    kind: Kind
    # The key that all publishers have in an older protocol; "" if it is none of them.
    shared: str = field(init=False, compare=False)  # kept, as each delivery asks for it

    def __post_init__(self) -> None:
        shared = self.pattern.removesuffix("/**") if self.pattern.endswith("/**") else ""
        object.__setattr__(self, "shared", shared)

    @property
    def shown(self) -> str:
        """The key expression of its own protocol alone, for people."""
        return f"{self.shared}/*" if self.shared else self.pattern


def subscriptions(cls: type[Individual], protocol: int = m.PROTOCOL) -> tuple[Subscription, ...]:
    """Return the subscriptions that an agent declares and those of the social intelligence."""
    triggers = cls.reacts_to.values() if isinstance(cls.reacts_to, Mapping) else [cls.reacts_to]
    kinds = [kind for kind in triggers if kind is not None and kind is not m.Ack]
    kinds += [*cls.needs, *(kind for base in cls.receives for kind in derived(base))]
    if kinds or cls.provides or cls.competes_for or cls.owns:  # needs the robot's cycles
        cycles = (m.RobotState, m.Description)
        kinds = [*(kind for kind in cycles if kind not in cls.provides), *kinds]
    # The robot agent's state tells the others that the stop is released.
    follows = bool(kinds) or m.RobotState in cls.provides
    releases = m.Stop in kinds or m.RobotState in cls.provides
    kinds += [s.message for s in latched() if follows or s.message is not m.Stop]
    services = [service_of(kind) for kind in dict.fromkeys(kinds)]
    for service in services:
        if service.watchers_only:
            raise ValueError(f"{cls.name} listens to {service.key}, which agents may not")
    found = [Subscription(s.message, s.heard_in(protocol), s.kind) for s in services]
    both, claims = dict.fromkeys((*cls.competes_for, *cls.owns)), service_of(m.Claim)
    claimed = (claims.heard_in(protocol, resource=r.name) for r in both)
    found += [Subscription(m.Claim, pattern, Kind.EVENT) for pattern in claimed]
    found += [Subscription(m.Ack, r.ack_key, Kind.STATE) for r in cls.competes_for]
    found += [Subscription(m.Command, r.command_pattern, Kind.EVENT) for r in cls.owns]
    if protocol >= SPOKEN:
        found.append(Subscription(m.Repeat, service_of(m.Repeat).pattern, Kind.EVENT))
    if releases:
        found.append(Subscription(m.Stop, RELEASE.pattern, RELEASE.kind))
    return tuple(found)


_STATE_KEY: Final = service_of(m.RobotState).key


@dataclass(slots=True)
class _Route:
    """What is done with the messages of one kind."""

    accepts: Callable[..., bool] | None = None  # None: by the cycle
    service: Service | None = None  # None: of a resource
    gathering: Gathering | None = None  # of several publishers
    handler: Callable[..., object] | None = None
    turns: tuple[Bidding, ...] = ()  # that it starts


class Kernel(Desk):
    """Runs one agent between its driver and the user's object."""

    def __init__(self, agent: Individual) -> None:
        super().__init__(agent)
        # The state of `rng` before the first draw: a replay begins here.
        self.drawn = agent.rng.getstate()
        self.tenure = 0  # the cycles for which the agent has worked
        # Instances that do not understand its protocol, or have other resources. They stay foreign
        # when they have gone: their last messages may still be on the way.
        self.foreign: dict[str, None] = {}
        self.speaks: dict[str, int] = {}  # the protocols that other instances use, by their cards
        self.elders = False  # whether one of them uses an older protocol than the agent
        self._contending: dict[str, m.Card] = {}  # by instance, for what this agent owns
        # Whether the society has keys, so that no agent of protocol 2 takes part.
        self.closed = False
        self.reachable = True  # whether the robot's router can be reached
        self.subscriptions = subscriptions(type(agent), self.protocol)
        self.alarm: float | None = None  # when the agent wants to be woken, s
        self._settings = Settings(self)
        self._queries = 0
        self._replies: dict[int, Callable[..., None]] = {}  # of the queries under way
        self._owning = {r.name: Owning(self, declare(r)) for r in agent.owns}
        self._bidding = {r.name: Bidding(self, declare(r)) for r in agent.competes_for}
        self.subscriptions += tuple(
            Subscription(kind, service_of(kind).heard_in(self.protocol, resource=name), Kind.EVENT)
            for name, bidding in self._bidding.items()
            for kind in bidding.contender.receives
        )
        self._answerers = {kind: self._handler(kind) for kind in agent.answers}
        self._watches = type(agent).on_message is not Individual.on_message
        self._routes = self._make_routes()

    def _make_routes(self) -> dict[type[Message], _Route]:
        """Return what is done with each kind of message."""
        accepts: dict[type[Message], Callable[..., bool]] = {
            m.RobotState: self._accept_state,
            m.Description: self._accept_description,
            m.Claim: self._accept_claim,
            m.Command: self._accept_command,
            m.Ack: self._accept_ack,
            m.Proposal: self._accept_contended,
            **{
                kind: self._accept_contended
                for bidding in self._bidding.values()
                for kind in bidding.contender.receives
            },
            **{service.message: self._accept_latched for service in latched()},
        }
        of_resources = (m.Claim, m.Command, m.Ack)
        routes: dict[type[Message], _Route] = {}
        for kind in dict.fromkeys((*accepts, *(to.message for to in self.subscriptions))):
            service = None if kind in of_resources else service_of(kind)
            if service is not None and service.gather is not None:
                self.gatherings[kind] = service.gather()
            gathering = self.gatherings.get(kind)
            routes[kind] = _Route(accepts.get(kind), service, gathering, self._handler(kind))
        to = self.agent.reacts_to
        for bidding in self._bidding.values():
            resource = bidding.resource
            by = to.get(resource) if isinstance(to, Mapping) else to
            own = resource.period_s is not None
            routes[m.Ack if by is None or own else by].turns += (bidding,)
        return routes

    def _handler(self, kind: type[Message]) -> Callable[..., Message | None] | None:
        return getattr(self.agent, names.handler_name(kind), None)

    # What the agent uses: see `Agent`, and `Desk` -------------------------------------------------

    def query(
        self,
        key: str,
        request: Message,
        reply: type[Message],
        then: Callable[..., None],
        timeout: float,
    ) -> None:
        """Send a query on a key; `then` gets the reply, or None after the timeout (s)."""
        self._queries += 1
        self._replies[self._queries] = then
        self.outbox.append(SendQuery(self._queries, key, request, reply, timeout))

    def bidding(self, resource: Resource) -> Bidding:
        """Return the contender's side of a resource. Raises KeyError if it does not compete."""
        return self._bidding[resource.name]

    def owning(self, resource: Resource) -> Owning:
        """Return the owner's side of a resource. Raises KeyError if it does not own it."""
        return self._owning[resource.name]

    def latch(self, by: str) -> None:
        known = self.memory.newest(m.Stop) or m.Stop()
        press = self.agent.rng.getrandbits(63)
        counter = m.next_count(known.counter)
        self.publish(m.Stop(counter, stopped=True, by=by, press=press, epoch=self._epoch))
        self._stop_changed()

    def acknowledge(self) -> None:
        """Count a cycle, and acknowledge the owned resources that have the robot's cycles."""
        self.tenure += 1
        for owning in self._owning.values():
            if owning.counter is None:
                owning.acknowledge()

    # What the driver calls -----------------------------------------------------------------------

    def start(self, now: float) -> None:
        self.now = now
        self.tenure = 1
        for owning in self._owning.values():
            owning.start(now)
        self.agent.on_start()
        for message in self.memory.all():  # received before the start
            if type(message) is m.Tuning:
                self._settings.adopt(message)
            route = self._routes.get(type(message))
            if route is not None and route.handler is not None:
                route.handler(message)

    def receive(self, message: Message, now: float) -> None:
        """Process one message of a subscription."""
        self.now = now
        kind = type(message)
        route = self._routes.get(kind) or _Route(service=service_of(kind))
        received: Any = message  # a gathering names its type
        gathering = route.gathering
        if gathering is not None:
            if not (
                gathering.counts(received)
                and self._newer(message, gathering.newest(received), route)
            ):
                return
            gathered = gathering.update(received)
            if gathered is None:
                self.agent.on_message(received)
                return
            message = gathered
        elif not (
            self._newer(message, self.newest.get(kind), route)
            if route.accepts is None
            else route.accepts(message)
        ):
            return
        self.newest[kind] = message
        if route.handler is not None:
            route.handler(message)
        for bidding in route.turns:
            bidding.turn(message)
        if self._watches:
            self.agent.on_message(received)

    def remember(self, message: m.Latched, now: float) -> None:
        """Store a latched state that is received before the start."""
        self.now = now
        if self._note_latched(message):
            self.newest[type(message)] = message

    def on_query(self, request: Message, question: Question, now: float) -> None:
        """Process a received query; the `Answer` enters the outbox now or later."""
        self.now = now
        answerer = self._answerers.get(type(request))
        if answerer is not None:
            reply = answerer(request, question)
            if reply is not None:
                self.outbox.append(Answer(question.id, reply))

    def on_reply(self, number: int, reply: Message | None, now: float) -> None:
        """Process the reply to a query; None after a timeout."""
        self.now = now
        then = self._replies.pop(number, None)
        if then is not None:
            then(reply)

    def on_bytes(self, data: bytes, now: float) -> None:
        """Process bytes from the device."""
        self.now = now
        # After a hang, the device's bytes may come before the wake-up that is due. A command that
        # has timed out must not be executed on them.
        for owning in self._owning.values():
            owning.wake(now)
        cast("Any", self.agent).on_bytes(data)

    def on_link(self, up: bool, why: str, now: float) -> None:
        """Process that the device was opened or lost."""
        self.now = now
        cast("Any", self.agent).on_link(up, why)

    def on_guard(self, acts_s: float, restarts_s: float, now: float) -> None:
        """Process that the device's line has a guard."""
        self.now = now
        cast("Any", self.agent).on_guard(acts_s, restarts_s)

    def on_braked(self, now: float) -> None:
        """Process that the guard has braked the device."""
        self.now = now
        cast("Any", self.agent).on_braked()

    def appeared(self, name: str, instance: str, now: float) -> None:
        """Process a new liveliness token."""
        self.now = now
        self.memory.met(now)
        self.agent.on_appeared(name, instance)

    def met(self, card: m.Card, now: float) -> None:
        """Process an instance's card; messages of an incompatible instance are then rejected."""
        self.now = now
        self.agent.on_card(card)
        if card.instance in self.foreign:
            return
        self.speaks[card.instance] = card.speaks
        self._count_elders()
        self._compare_mechanisms(card)
        if self.closed and card.speaks < SPOKEN:
            why = (
                f"uses protocol {card.speaks}, whose keys all publishers share, and this society"
                f" has keys: install the version of the others (protocol {self.protocol})"
            )
        elif not card.understood(self.protocol):
            why = f"uses protocol {card.speaks}, this agent {m.protocols(self.protocol)}"
        elif differing := differently(card.declares, self._signatures()):
            why = f"declares {differing[0]}, this agent {differing[1]}"
        else:
            return
        self.foreign[card.instance] = None
        gone = [each for each in self.foreign if each not in self.living]
        for instance in gone[:-FOREIGN_REMEMBERED]:
            del self.foreign[instance]
        sender = f"{card.instance} (host {card.host}, pid {card.pid})"
        self.log(f"{sender} {why}: its claims and commands are refused", ERROR)

    def _compare_mechanisms(self, card: m.Card) -> None:
        """Log that agents compete for an owned resource by different mechanisms."""
        if not self._owning.keys().isdisjoint(card.resources):
            before = mixed(self._contending.values())
            self._contending[card.instance] = card
            for name, by in mixed(self._contending.values()).items():
                if name in self._owning and by.keys() != before.get(name, {}).keys():
                    self.log(mixture(name, by), WARNING)

    def forget(self, instance: str) -> None:
        """Forget the card of an instance that has ended, also before this agent has joined."""
        self._contending.pop(instance, None)
        self.speaks.pop(instance, None)
        self._count_elders()

    def disappeared(self, name: str, instance: str, now: float) -> None:
        """Process the end of a liveliness token."""
        self.now = now
        self.forget(instance)
        for bidding in self._bidding.values():
            bidding.gone(instance, now)
        if any(known.instance == instance for known in self.authors.values()):
            self.memory.met(now)  # another instance may have waited for its states
        self.agent.on_disappeared(name, instance)

    def _count_elders(self) -> None:
        older = any(m.OLDEST <= each < self.protocol for each in self.speaks.values())
        self.elders = older and not self.closed

    def router(self, there: bool, now: float) -> None:
        """Process that the robot's router became reachable or unreachable."""
        self.now = now
        if there != self.reachable:
            self.reachable = there
            if there:  # latched states may have been missed while disconnected
                self.memory.met(now)
            self.agent.on_router()

    def wake(self, now: float) -> None:
        """Process everything that is due; called when `wakeup` is reached."""
        self.now = now
        for owning in self._owning.values():
            owning.wake(now)
        for bidding in self._bidding.values():
            bidding.wake(now)
        for message in self.memory.due(now):
            self._give(message)
        if self.alarm is not None and now >= self.alarm:
            self.alarm = None
            self.agent.on_wakeup()

    def _give(self, message: m.Latched) -> None:
        """Publish a latched state again: as its own, or as that of its author, which is gone."""
        if isinstance(message, m.Stop):
            message = replace(message, epoch=self._epoch)
        known, service = self.authors.get(what_of(message)), service_of(type(message))
        author = self.agent.instance if known is None else known.instance
        if author == self.agent.instance or isinstance(message, m.Stop) or self.protocol < SPOKEN:
            self.publish(message)
            return
        key = service.key_for(instance=author) if author else service.key_in(m.OLDEST)
        record = known.record if known is not None else None
        if self.closed and record is None:
            return  # the others refuse what its author has not signed
        self.publish(record or m.Repeat(key, m.encode(message)))
        if self.elders:
            self.outbox.append(Publish(service.key_in(m.OLDEST), message))

    def correct(self, message: m.Latched, instance: str) -> None:
        """Forget a state that is newer than what its own author gives out.

        An author's messages arrive in order, so it did not publish that one.
        """
        known = self.authors.get(what_of(message))
        if known is not None and known.instance == instance:
            self.memory.forget_beyond(message)

    def author(self, message: m.Latched, instance: str, record: m.Repeat | None) -> None:
        """Note who published a latched state, if that is the one that is stored."""
        what = what_of(message)
        if self.memory.newest(*what) != message:
            return
        before = self.authors.get(what)
        if record is None and before is not None and before.instance == instance:
            record = before.record
            kept = record is not None and m.decode(record.payload, type(message)) == message
            record = record if kept else None
        self.authors[what] = Authored(instance, record)

    @property
    def _epoch(self) -> int:
        return 0 if self.cycles.newest is None else self.cycles.newest.epoch

    @property
    def wakeup(self) -> float | None:
        """When `wake` is due, s; None: not at all."""
        due, at = self.alarm, self.memory.wakeup
        if at is not None and (due is None or at < due):
            due = at
        for bidding in self._bidding.values():
            at = bidding.contender.wakeup
            if at is not None and (due is None or at < due):
                due = at
        for owning in self._owning.values():
            at = owning.wakeup
            if at is not None and (due is None or at < due):
                due = at
        return due

    def leave(self, now: float) -> None:
        """Release all held resources and rest all owned ones."""
        self.now = now
        for bidding in self._bidding.values():
            bidding.leave(now)
        for owning in self._owning.values():
            owning.rest()
        self.agent.on_leave()

    def card(self) -> m.Card:
        """Return the agent's identity and what it offers (thesis table 3.1)."""
        agent, identity = self.agent, self.agent.identity
        competes = agent.competes_for
        holds = (r.name for r in competes if self.bidding(r).contender.holding)
        return agent.fill_card(
            m.Card(
                name=agent.name,
                instance=agent.instance,
                host=identity.host,
                pid=identity.pid,
                version=identity.version,
                protocol=m.OLDEST,
                newest=self.protocol if self.protocol > m.OLDEST else 0,
                provides=tuple(map(self._provided, (*agent.provides, *agent.answers))),
                requests=tuple(s.shown for s in self.subscriptions if self._requests(s))
                + tuple(service_of(k).key for k in agent.queries),
                resources=tuple(r.name for r in competes),
                holds=tuple(holds),
                owns=tuple(r.name for r in agent.owns),
                tenure=min(self.tenure, m.LONGEST_TENURE),
                declares=tuple(dict.fromkeys(self._signatures())),
                world=m.line(PurePath(str(getattr(agent.p, "world", None) or "")).stem),
                table=identity.table,
                map=identity.map,
                mechanisms=tuple(
                    f"{name} {each.mechanism}"
                    for name, each in self._bidding.items()
                    if each.mechanism != m.BALLOTS
                ),
            )
        )

    def _provided(self, kind: type[Message]) -> str:
        """Return the key of a kind; of one that others publish, too, for all of them."""
        several = service_of(kind).since > m.OLDEST
        return self.key_of(kind, instance="*") if several else self.key_of(kind)

    def _requests(self, to: Subscription) -> bool:
        """Return whether this agent needs a subscription that not every agent has."""
        common = to.kind is Kind.LATCHED or to.message in (m.Description, m.Repeat)
        return not common or to.message in (*self.agent.receives, *self.agent.needs)

    def _signatures(self) -> list[str]:
        return [each.signature for each in (*self.agent.competes_for, *self.agent.owns)]

    def tune(self, request: m.ParametersRequest, now: float) -> m.ParametersReply:
        """Apply all requested changes or none; return the changeable parameters afterwards."""
        self.now = now
        return self._settings.tune(request)

    def history(self) -> m.BidHistory:
        return m.BidHistory(self.agent.instance, tuple(self.bids))

    # Reception: whether a message counts ----------------------------------------------------------

    def _newer(self, message: Any, before: Any, route: _Route) -> bool:
        """Return whether a message's cycle is fresh and not before the latest message's."""
        service = route.service
        within = None if service is None else service.fresh_cycles
        if within is None:
            return True
        cycle = message.cycle
        if not self.cycles.fresh(cycle, within):
            return False
        if before is None or (service is not None and service.kind is Kind.EVENT):
            return True  # events of several publishers need not be in cycle order
        age = self.cycles.age(before.cycle)
        # A message with a false number, far ahead, does not count as newer.
        return age is None or age < -AHEAD or before.cycle.number <= cycle.number

    def _accept_state(self, state: m.RobotState) -> bool:
        if not self._advance(self.cycles, state.cycle, _STATE_KEY):
            return False
        if self.memory.follow(state.stop, self.now):
            self._stop_changed()
        self.acknowledge()
        return True

    def _accept_description(self, description: m.Description) -> bool:
        self.cycles.period = description.cycle_s
        for gathering in self.gatherings.values():
            gathering.describe(description)
        return True

    def _accept_claim(self, claim: m.Claim) -> bool:
        if claim.ballot.instance in self.foreign:
            return False
        if (owning := self._owning.get(claim.resource)) is not None:
            owning.on_claim(claim)
        rights, ballot = self.agent.identity.rights, claim.ballot
        if (
            rights is not None
            and (claim.critical or ballot.critical)
            and not rights.may_be_critical(ballot.instance, claim.resource)
        ):
            key = self.key_of(m.Claim, resource=claim.resource, instance=ballot.instance)
            self.outbox.append(Refused(key, Verdict.NOT_CRITICAL))
            return False
        if (bidding := self._bidding.get(claim.resource)) is not None:
            bidding.on_claim(claim, self.now)
        return True

    def _accept_contended(self, message: Any) -> bool:
        """Give a message of a resource's mechanism to it."""
        sender = service_of(type(message)).sender_of(message)
        bidding = self._bidding.get(message.resource)
        if bidding is None or sender in self.foreign or not bidding.clock.fresh(message.cycle):
            return False
        bidding.on_message(message, self.now)
        return True

    def _accept_command(self, command: m.Command) -> bool:
        owning = self._owning.get(command.resource)
        if owning is None or command.ballot.instance in self.foreign:
            return False
        owning.on_command(command, self.now)
        return True

    def _accept_ack(self, ack: m.Ack) -> bool:
        bidding = self._bidding.get(ack.resource)
        if bidding is None:  # of a resource that it only watches
            return m.Ack in self.agent.receives
        clock, key = bidding.clock, bidding.resource.ack_key
        counts = (
            clock.fresh(ack.cycle)
            if clock is self.cycles
            else self._advance(clock, ack.cycle, key)  # its acknowledgements make its cycles
        )
        return counts and bidding.on_ack(ack, self.now)

    def _accept_latched(self, message: m.Latched) -> bool:
        news = self._note_latched(message)
        if news and type(message) is m.Stop:
            self._stop_changed()
        if news and type(message) is m.Tuning:
            self._settings.adopt(message)
        return news

    def _note_latched(self, message: m.Latched) -> bool:
        """Store a latched state, report an implausible counter; return whether it is new."""
        memory, kind = self.memory, type(message)
        if isinstance(message, m.Stop) and not message.stopped:
            # The robot agent judges a release; its state shows the others whether the stop counts.
            return memory.release(message) if memory.judges else m.Stop in self.agent.receives
        refused = memory.refused
        news = memory.update(message, self.now)
        if memory.refused != refused:
            done, by = "rejected", ""
            if isinstance(message, m.Stop):
                by = f" by {message.requester}"
                if message.stopped and self.stopped is not None:
                    done = "stopped, with the next known counter"
            why = f"{done}: a {kind.__name__}{by} has an implausible counter"
            self.outbox.append(Refused(service_of(kind).pattern, why))
        return news

    def _stop_changed(self) -> None:
        """Rest all owned resources that the stop concerns; while it is latched no agent bids."""
        if self.stopped is not None:
            for owning in self._owning.values():
                if owning.resource.stops:
                    owning.rest()
        if self._owning:
            stop = self.memory.newest(m.Stop) or m.Stop()
            self.log(f"{'stopped' if stop.stopped else 'released'} by {stop.requester}", WARNING)

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
        for bidding in self._bidding.values():
            if bidding.clock is clock:
                bidding.returned(self.now)
        for owning in self._owning.values():
            if owning.owner.clock is clock:
                owning.owner.returned()

    def _epoch_changed(self, key: str, before: int, cycle: m.Cycle, *, back: bool) -> None:
        # Two owners that take turns are a fault; a restart of the owner is known to the operator.
        why = "two owners may be running" if back else "its owner has restarted"
        text = f"{key}: epoch {before:x} ended, epoch {cycle.epoch:x} began at cycle {cycle.number}"
        self.log(f"{text} ({why})", WARNING if back else INFO)
