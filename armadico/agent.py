"""The agent pattern of thesis 3.3 as a base class.

Individual intelligence is what a subclass writes: handlers for messages (`on_<message>`) and, for a
behaviour, `bid`. Social intelligence comes with this class: freshness, turns, winner determination,
exchange, the stop latch, the card. An agent holds no socket, thread, clock or sleep: whoever runs
it hands it messages and the time, and sends what it finds in `outbox`.

The modules of figure 3.6: internal state is the subclass's attributes and `latest`; collaboration
is `reacts_to`, `needs`, `hears`, `provides`, `answers` and `asks`; goal is `bid` and the handlers;
competition is `competes_for`; coordination is one `Contender` a resource; helper methods are here.
"""

from __future__ import annotations

import random
import re
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, Literal, TypeVar, cast

from msgspec import Meta, Struct

from armadico import messages as m
from armadico.coordination import Contender
from armadico.cycles import CycleClock
from armadico.exchange import EXCHANGES, Bid
from armadico.messages import Message
from armadico.resources import Resource
from armadico.services import Service, service_of

M = TypeVar("M", bound=Message)

BIDS_REMEMBERED = 50
INFO, WARNING, ERROR = 20, 30, 40


class Social(Struct, frozen=True, forbid_unknown_fields=True):
    """Parameters of the social intelligence, the same for every agent."""

    exchange: Literal["smooth", "abrupt"] = "smooth"
    margin: Annotated[float, Meta(ge=0, le=1)] | None = None  # None: the resource's own
    comparison: Literal["same-cycle", "last-heard"] = "same-cycle"  # the latter is the thesis's


class Parameters(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What a file or ``--set KEY=VALUE`` may change; subclasses add their own."""

    social: Social = Social()


@dataclass(frozen=True)
class Identity:
    """Who an instance is: set by whoever runs it."""

    instance: str
    host: str = "localhost"
    pid: int = 0
    version: str = ""
    rng: random.Random = field(default_factory=random.Random, compare=False)


@dataclass(frozen=True, slots=True)
class Publish:
    """Say a message on a key."""

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


Outgoing = Publish | AskFor | Answer | Write


class Agent:
    """One agent. A subclass declares what it talks about, and fills in handlers and `bid`."""

    name: ClassVar[str] = ""
    reacts_to: ClassVar[type[Message] | None] = None  # starts its turn in a cycle
    needs: ClassVar[tuple[type[Message], ...]] = ()  # must be fresh, or it does not bid
    hears: ClassVar[tuple[type[Message], ...]] = ()  # merely listened to
    provides: ClassVar[tuple[type[Message], ...]] = ()
    answers: ClassVar[tuple[type[Message], ...]] = ()  # queries it answers
    asks: ClassVar[tuple[type[Message], ...]] = ()  # queries it puts
    competes_for: ClassVar[tuple[Resource, ...]] = ()
    alone: ClassVar[bool] = False  # a second instance in the namespace may not join
    parameters: ClassVar[type[Parameters]] = Parameters

    def __init__(self, identity: Identity, parameters: Any = None) -> None:
        self.identity = identity
        self.instance = identity.instance
        self.rng = identity.rng
        self.p: Parameters = self.parameters() if parameters is None else parameters
        self.now = 0.0
        self.cycles = CycleClock()
        self.outbox: list[Outgoing] = []
        self.stop_latch = m.Stop()
        self.foreign: set[str] = set()  # instances that speak another protocol
        self.bids: deque[m.BidRecord] = deque(maxlen=BIDS_REMEMBERED)
        self._latest: dict[type[Message], Message] = {}
        self._inputs = tuple(service_of(kind).key for kind in self.needs)
        self._handlers = {
            kind: self._handler(kind) for kind in (*self.subscriptions(), *self.answers)
        }
        self._alarm: float | None = None
        self._asked: dict[int, Callable[[Any], None]] = {}
        self._next_id = 0
        self._turned: m.Cycle | None = None  # the cycle of the last turn
        social: Social = self.p.social
        self._contenders = {
            r.name: Contender(
                r,
                self.instance,
                self.cycles,
                EXCHANGES[social.exchange],
                social.margin,
                same_cycle=social.comparison == "same-cycle",
            )
            for r in self.competes_for
        }

    # What a subclass may write -------------------------------------------------------------------

    def bid(self, message: Any) -> Bid | None:  # noqa: ARG002
        """The goal method: what it would do now, and how much that helps; None: nothing.

        Called once a cycle with the message that the agent reacts to, all needs fresh, the robot
        not stopped. `self.why` may be set to say why there is no bid.
        """
        return None

    def bid_for(self, resource: Resource, message: Any) -> Bid | None:  # noqa: ARG002
        """The same, for an agent that competes for more than one resource."""
        return self.bid(message)

    def on_start(self) -> None:
        """Called once, before any message."""

    def on_wakeup(self) -> None:
        """Called at the time given to `wake_at`."""

    def on_appeared(self, name: str, instance: str) -> None:
        """An instance of an agent has joined."""

    def on_disappeared(self, name: str, instance: str) -> None:
        """An instance's liveliness token has gone."""

    # What a subclass uses ------------------------------------------------------------------------

    why: str = ""

    def publish(self, message: Message, **names: str) -> None:
        """Say a message on its service's key; `names` fill the key's braces."""
        key = service_of(type(message)).key
        if "{" in key:
            key = key.format(instance=self.instance, name=self.name, **names)
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

    def ask(self, request: Message, then: Callable[[Any], None], timeout: float = 2.0) -> None:
        """Put a query; `then` gets the first reply, or None if nobody answered in time."""
        service = service_of(type(request))
        assert service.reply is not None, f"{service.key} is not a query"
        self._next_id += 1
        self._asked[self._next_id] = then
        self.outbox.append(AskFor(self._next_id, service.key, request, service.reply, timeout))

    def answer(self, question: Question, reply: Message) -> None:
        """Answer a query, now or later."""
        self.outbox.append(Answer(question.id, reply))

    def wake_at(self, when: float) -> None:
        """Have `on_wakeup` called at that time, s; the one wake-up it may ask for."""
        self._alarm = when

    def holds(self, resource: Resource) -> bool:
        """Whether it holds the resource, as far as it knows."""
        return self._contenders[resource.name].holding

    def log(self, text: str, level: int = INFO) -> None:
        """Say a line to people."""
        self.publish(m.Log(level, text[:2000]))

    # What whoever runs it calls ------------------------------------------------------------------

    def start(self, now: float) -> None:
        """Begin."""
        self.now = now
        self.on_start()

    def receive(self, message: Message, now: float) -> None:
        """Take one message that it subscribed to."""
        self.now = now
        kind = type(message)
        if isinstance(message, m.Claim | m.Command) and message.ballot.instance in self.foreign:
            return
        if isinstance(message, m.RobotState):
            if not self._take_state(message):
                return
        elif isinstance(message, m.Claim):
            contender = self._contenders.get(message.resource)
            if contender is not None:
                self._say(contender.hear(message, now))
        elif not self._acceptable(message):
            return
        self._latest[kind] = message
        handler = self._handlers.get(kind)
        if handler is not None:
            handler(message)
        if kind is self.reacts_to and self._begins_turn(cast("Any", message).cycle):
            self._turn(message)

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
        then = self._asked.pop(question_id, None)
        if then is not None:
            then(reply)

    def appeared(self, name: str, instance: str, now: float) -> None:
        """Take the news of a liveliness token."""
        self.now = now
        self.on_appeared(name, instance)

    def met(self, card: m.Card, now: float) -> None:
        """Take the card of an instance: what speaks another protocol is not listened to."""
        self.now = now
        if card.protocol != m.PROTOCOL and card.instance not in self.foreign:
            self.foreign.add(card.instance)
            self.log(
                f"{card.instance} (host {card.host}, pid {card.pid}) speaks protocol"
                f" {card.protocol}, this one {m.PROTOCOL}: its claims and commands are refused",
                ERROR,
            )

    def disappeared(self, name: str, instance: str, now: float) -> None:
        """Take the news that a liveliness token has gone."""
        self.now = now
        for contender in self._contenders.values():
            self._say(contender.gone(instance, now))
        self.on_disappeared(name, instance)

    def wake(self, now: float) -> None:
        """Take the time, when `wakeup` has come."""
        self.now = now
        for contender in self._contenders.values():
            due = contender.wakeup
            if due is not None and now >= due:
                self._say(contender.tick(now))
        if self._alarm is not None and now >= self._alarm:
            self._alarm = None
            self.on_wakeup()

    @property
    def wakeup(self) -> float | None:
        """When `wake` should be called, s, if nothing comes before."""
        due = self._alarm
        for contender in self._contenders.values():
            at = contender.wakeup
            if at is not None and (due is None or at < due):
                due = at
        return due

    def stop(self, now: float) -> None:
        """Leave: what it holds is let go of."""
        self.now = now
        for contender in self._contenders.values():
            self._say(contender.bid(self._cycle(), None, contender.resource.neutral, now))

    @classmethod
    def subscriptions(cls) -> dict[type[Message], Service]:
        """What it listens to, the state and the claims that its social intelligence needs too."""
        kinds: list[type[Message]] = [m.RobotState]
        if cls.competes_for:
            kinds.append(m.Claim)
        if cls.reacts_to is not None:
            kinds.append(cls.reacts_to)
        kinds += [*cls.needs, *cls.hears]
        return {kind: service_of(kind) for kind in kinds}

    def card(self) -> m.Card:
        """Who it is and what it offers (thesis table 3.1)."""
        who = self.identity
        return m.Card(
            name=self.name,
            instance=self.instance,
            host=who.host,
            pid=who.pid,
            version=who.version,
            protocol=m.PROTOCOL,
            provides=tuple(service_of(k).key for k in (*self.provides, *self.answers)),
            requests=tuple(s.key for s in self.subscriptions().values())
            + tuple(service_of(k).key for k in self.asks),
            resources=tuple(r.name for r in self.competes_for),
            holds=tuple(r.name for r in self.competes_for if self.holds(r)),
        )

    def history(self) -> m.BidHistory:
        """Its recent bids."""
        return m.BidHistory(self.instance, tuple(self.bids))

    # How it does that ----------------------------------------------------------------------------

    def _take_state(self, state: m.RobotState) -> bool:
        epoch = self.cycles.newest.epoch if self.cycles.newest else None
        if not self.cycles.advance(state.cycle, self.now):
            return False
        said, known = state.stop, self.stop_latch
        if said.counter >= known.counter or (said.stopped and not known.stopped):
            self.stop_latch = said
        elif epoch is not None and self.stop_latch.stopped:
            # A restarted robot agent has forgotten the stop; whoever asked for it may have gone.
            self.publish(self.stop_latch)
        for contender in self._contenders.values():
            self._say(contender.echo(state.largest, state.obeyed, state.obeyed_cycle, self.now))
        return True

    def _acceptable(self, message: Message) -> bool:
        """Refuse what answers a cycle that is long past or not yet there."""
        return self._in_time(message)

    def _in_time(self, message: Message) -> bool:
        """Whether it may be acted upon, by the table of services."""
        within = service_of(type(message)).fresh_cycles
        return within is None or self.cycles.fresh(cast("Any", message).cycle, within)

    def _begins_turn(self, cycle: m.Cycle) -> bool:
        """One turn a cycle, and none for an older one, however often its message comes."""
        last = self._turned
        if last is not None and last.epoch == cycle.epoch and cycle.number <= last.number:
            return False
        self._turned = cycle
        return True

    def _turn(self, message: Any) -> None:
        """One turn: a bid for each resource, if its inputs are fresh."""
        state = self.latest(m.RobotState)
        stale = next((kind for kind in self.needs if self.fresh(kind) is None), None)
        for resource in self.competes_for:
            self.why = ""
            if state is None or not self.cycles.alive(self.now):
                bid, self.why = None, "no fresh robot/state"
            elif self.stop_latch.stopped:
                bid, self.why = None, f"stopped by {self.stop_latch.by}"
            elif stale is not None:
                bid, self.why = None, f"no fresh {service_of(stale).key}"
            else:
                bid = self._sound(resource, self.bid_for(resource, message))
            self._record(resource, message.cycle, bid)
            measured = resource.neutral if state is None else resource.measured(state)
            contender = self._contenders[resource.name]
            self._say(contender.bid(message.cycle, bid, measured, self.now))

    def _sound(self, resource: Resource, bid: Bid | None) -> Bid | None:
        """A bid that could not be sent is no bid: the holder's own NaN is a release."""
        if bid is None:
            return None
        whole = len(bid.action) == len(resource.parameters)
        finite = all(abs(number) <= m.LARGEST for number in bid.action)  # NaN is not
        if whole and finite and 0.0 <= bid.utility <= 1.0:
            return bid
        self.why = f"its bid is not sound: {bid}"
        self.log(self.why, ERROR)
        return None

    def _record(self, resource: Resource, cycle: m.Cycle, bid: Bid | None) -> None:
        inputs = self._inputs
        if bid is None:
            record = m.BidRecord(cycle, resource.name, None, False, (), self.why, inputs)
        else:
            record = m.BidRecord(
                cycle, resource.name, bid.utility, bid.critical, bid.action, bid.reason, inputs
            )
        self.bids.append(record)

    def _say(self, messages: list[Message]) -> None:
        for message in messages:
            if isinstance(message, m.Claim):
                self.publish(message, resource=message.resource)
            else:
                self.publish(message)

    def _cycle(self) -> m.Cycle:
        return self.cycles.newest or m.Cycle(0, 0)

    def _handler(self, kind: type[Message]) -> Callable[[Any], Any] | None:
        snake = re.sub(r"(?<!^)(?=[A-Z])", "_", kind.__name__).lower()
        return getattr(self, f"on_{snake}", None)


class DeviceAgent(Agent):
    """An agent that owns a device: bytes in, bytes out."""

    def on_bytes(self, data: bytes) -> None:
        """Bytes from the device."""

    def on_link(self, up: bool, why: str) -> None:
        """The device was opened, or is gone."""

    def write(self, data: bytes) -> None:
        """Bytes for the device."""
        if data:
            self.outbox.append(Write(data))

    def take_bytes(self, data: bytes, now: float) -> None:
        """Called by whoever runs it."""
        self.now = now
        self.on_bytes(data)

    def take_link(self, up: bool, why: str, now: float) -> None:
        """Called by whoever runs it."""
        self.now = now
        self.on_link(up, why)
