"""Runs one agent, sans-IO: joining, cards, deliveries, wake-ups, queries, log lines.

Both meshes run agents by this class, so faults found on the virtual mesh are faults of the real
one. The caller passes arriving data and the time, and sends what `drain` returns. The driver holds
no socket, thread or clock.
"""

from __future__ import annotations

from collections import Counter, OrderedDict, deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, cast

from msgspec.structs import replace

from armadico.core.agent import WARNING, Agent, DeviceAgent, Question
from armadico.core.coordination import Verdict
from armadico.core.cycles import epoch_of
from armadico.core.kernel import Subscription
from armadico.core.membership import CARD_S, Admission, Stage, agent_of
from armadico.core.messages import (
    OLDEST,
    Ack,
    Ask,
    Card,
    Claim,
    Latched,
    Log,
    Message,
    MessageError,
    ParametersRequest,
    Repeat,
    RobotState,
    Stop,
    Tuning,
    decode,
)
from armadico.core.outgoing import Answer, Publish, Refused, SendQuery, Write
from armadico.core.services import (
    BIDS,
    CARD,
    RELEASE,
    SETTINGS,
    SPOKEN,
    STOP,
    Kind,
    addressed,
    by_people,
    matches,
    parent,
    service_at,
    service_of,
    shared_key,
)
from armadico.core.shared import is_shared

OPEN_QUERIES: Final = 64  # queries that may wait for their answers; beyond, the oldest is dropped
# Log lines that an agent may publish at once, and per second in the long run, so that an agent
# that is flooded with messages does not flood others.
LINES: Final = 30
LINES_A_S: Final = 2.0
REPORT_S: Final = 5.0  # shortest time between two reports of rejected and dropped messages, s
SLOW_S: Final = 60.0  # shortest time between two reports of slow turns, s
MOST_REASONS: Final = 64  # different reasons that are counted between two reports

# If an agent is called later than it was due, by more than this (s), only this much time passes for
# it: the process was paused or the clock was stepped. Timeouts are for what the agent could have
# observed. The value exceeds every timeout that keeps an agent from acting on messages received
# before the pause.
PAUSE_S: Final = 2.0

# A message on its publisher's own key, and its copy on the key that all publishers share in an
# older protocol, arrive within this time, s. So many are kept to know the copies by.
COPY_S: Final = 1.0
COPIES: Final = 32

ROBOT: Final = "robot"  # the name of the agent that owns the robot's port
NOT_CURRENT: Final = "its publisher is not alive, or it is of an earlier run"
NOT_PEOPLE: Final = "only a person's program releases a stop"


@dataclass(frozen=True, slots=True)
class Announce:
    """Show the agent's liveliness token."""


@dataclass(frozen=True, slots=True)
class OpenPort:
    """Open the agent's device."""


@dataclass(frozen=True, slots=True)
class Reply:
    """Answer a query: `call` is the value given to `asked`."""

    call: Any
    key: str
    message: Message


Output = Publish | SendQuery | Write | Announce | OpenPort | Reply


class Driver:
    """Runs one agent. All calls come from one thread; times are s of any one clock.

    The agent's own time is that clock's, less pauses beyond `PAUSE_S`.
    """

    def __init__(
        self,
        agent: Agent,
        now: float,
        *,
        admit: bool = True,
        wall: Callable[[], float] | None = None,
    ) -> None:
        """Begin admission.

        Without `admit` the agent joins without admission. `wall` returns wall time for the card, s
        since 1970: for people only.
        """
        self.agent = agent
        self.kernel = agent.kernel
        self.now = now  # time of the last call, s by the caller's clock
        self._paused_s = 0.0  # time that did not pass for the agent
        self.stage = Stage.LOOKING
        self.refusal = ""  # why it may not join, or stay
        self.alive: set[tuple[str, str]] = set()  # (name, instance) of the others
        self.refused: Counter[str] = Counter()  # by key and reason, since the last report
        self._admission = (
            Admission(
                agent.name,
                agent.instance,
                now,
                alone=agent.alone,
                owns=[resource.name for resource in agent.owns],
                protocol=agent.identity.protocol,
                rights=agent.identity.rights,
            )
            if admit
            else None
        )
        self._wall = wall
        names = {"name": agent.name, "instance": agent.instance}
        self._card_key, self._bids_key = CARD.key_for(**names), BIDS.key_for(**names)
        self._settings_key = SETTINGS.key_for(**names)
        self._served: dict[str, type[Message]] = {
            **{service_of(k).answered_at(self.kernel.key_of(k)): k for k in agent.answers},
            self._card_key: Ask,
            self._bids_key: Ask,
            self._settings_key: Ask,
            self.kernel.key_of(ParametersRequest): ParametersRequest,
        }
        self._out: list[Output] = []
        self._check_at: float | None = now  # when the admission is checked again
        self._announced = False
        self._calls: OrderedDict[int, tuple[object, str]] = OrderedDict()
        self._call_ids = 0
        self._cards: dict[int, str] = {}  # queried cards: the instance, by the query's id
        self._lines = float(LINES)
        self._lines_at = now
        self._left_out = 0
        self._reported_at = float("-inf")
        self._slow: list[float] = []  # turns since the last report that were slow, s each
        self._slow_at = float("-inf")
        self._epochs: frozenset[int] | None = None  # of live robot agents; None: any epoch counts
        self._copied: deque[tuple[float, Message]] = deque(maxlen=COPIES)  # may be, with the time

    # Life cycle ----------------------------------------------------------------------------------

    def begin(self, now: float) -> None:
        """Start the admission, or the agent if there is none."""
        self._pass(now)
        if self._admission is None:
            self._check_at = None
            self._start(now)
        else:
            self._progress(now)

    @property
    def started(self) -> bool:
        return self.stage is Stage.JOINED

    def _due(self) -> float | None:
        """When `wake` is due, s; None: not at all."""
        mine = self._check_at
        if self.stage is not Stage.JOINED:
            return mine
        due = self.kernel.wakeup
        if due is None:
            return mine
        due += self._paused_s
        return due if mine is None else min(due, mine)

    wakeup = property(_due)

    def _pass(self, now: float) -> float:
        """Note the time; return the agent's own time, s."""
        if now - self.now > PAUSE_S:
            due = self._due()
            until = self.now if due is None else max(self.now, due)
            self._paused_s += max(now - until - PAUSE_S, 0.0)
        self.now = now
        return now - self._paused_s

    def wake(self, now: float) -> None:
        own = self._pass(now)
        if self.stage is Stage.JOINED:
            due = self.kernel.wakeup
            if due is not None and now >= due + self._paused_s:
                self.kernel.wake(max(own, due))  # the sum above is rounded
        if self._check_at is not None and now >= self._check_at:
            self._progress(now)

    def leave(self, now: float) -> None:
        """Release all held resources and rest all owned ones."""
        self.kernel.outbox.clear()  # an interrupted turn is not sent
        own = self._pass(now)
        if self.stage is Stage.JOINED:
            self.kernel.leave(own)

    def drain(self) -> list[Output]:
        """Return the outputs since the last call, in order."""
        kernel = self.kernel
        if not kernel.outbox:
            if not self._out:
                return []
            sent, self._out = self._out, []
            return sent
        while kernel.outbox:
            out, kernel.outbox = kernel.outbox, []
            for item in out:
                if type(item) is Publish:
                    if type(item.message) is Log and not self._may_log():
                        continue
                    self._out.append(item)
                    self._copy(item)
                elif isinstance(item, Answer):
                    self._answer(item)
                elif isinstance(item, Refused):
                    self._refuse(item.key, item.why, self.now)
                else:
                    self._out.append(item)
        sent, self._out = self._out, []
        return sent

    # Inputs --------------------------------------------------------------------------------------

    def deliver(self, to: Subscription, key: str, payload: bytes | Message, now: float) -> None:
        """Process a publication of a subscribed key, encoded or not."""
        own = self._pass(now)
        message: Any = payload
        kind = type(message)  # `isinstance` of a message goes through its ABC: slow, and not needed
        if kind is bytes or kind in addressed():
            message = self._read(to.message, key, payload, now)
            if message is None:
                return
        if not self._is_current(to, key, message):
            self._refuse_stray(to, key, message, own)
            return
        record: Repeat | None = None
        if type(message) is Repeat:
            record = message
            message = self._repeated(key, record, now)
            if message is None:
                return
        if to.shared and not self._counts(to.shared, key, message, now):
            return
        if self.refused or self._slow:
            self._report(now)  # may be due since
        publisher = ""
        if to.kind is Kind.LATCHED and to.shared not in ("", key):
            publisher = key.rpartition("/")[2]
            self.kernel.correct(message, publisher)
        if self.stage is Stage.JOINED:
            self.kernel.receive(message, own)
        elif isinstance(message, Latched) and self.stage is not Stage.REFUSED:
            self.kernel.remember(message, own)
        if record is not None:
            self.kernel.author(message, record.publisher, record if record.signature else None)
        elif to.kind is Kind.LATCHED:
            self.kernel.author(message, publisher, None)

    def token(self, name: str, instance: str, alive: bool, now: float) -> None:
        """Process that a liveliness token appeared (`alive`) or disappeared."""
        own = self._pass(now)
        other = (name, instance)
        if instance == self.agent.instance or alive == (other in self.alive):
            return
        (self.alive.add if alive else self.alive.discard)(other)
        (self.kernel.living.add if alive else self.kernel.living.discard)(instance)
        if name == ROBOT:
            self._note_epochs()
        if self._admission is not None:
            if alive:
                self._admission.appeared(name, instance, now)
            else:
                self._admission.disappeared(instance, now)
        if self.stage is Stage.JOINED:
            notify = self.kernel.appeared if alive else self.kernel.disappeared
            notify(name, instance, own)
        elif not alive:  # its card may have come already
            self.kernel.forget(instance)
        self._progress(now)

    def router(self, there: bool, now: float) -> None:
        """Process that the robot's router became reachable (`there`) or unreachable."""
        own = self._pass(now)
        if self.stage is Stage.JOINED:
            self.kernel.router(there, own)
        else:
            self.kernel.reachable = there

    def latch(self, by: str, now: float) -> None:
        """Latch the robot's stop."""
        own = self._pass(now)
        if self.stage is Stage.JOINED:
            self.kernel.now = own
            self.kernel.latch(by)

    def answers(self, key: str) -> type[Message] | None:
        """Return the type of query that is answered on a key; None if none is."""
        return self._asked(key)[0]

    def _asked(self, key: str) -> tuple[type[Message] | None, str]:
        """Return the type of query that is answered on a key, and the identity that it names.

        The router admits a key that names an identity from that alone, if the society has keys.
        """
        closed = self.kernel.closed
        found = self._served.get(key)
        if found is None and not closed:  # the key's end proves nothing: it names nobody
            found = self._served.get(f"{key}/**")
        if found is not None:
            return found, ""
        above, _, asker = key.rpartition("/")
        return self._served.get(f"{above}/**"), asker if closed else ""

    @property
    def queries(self) -> dict[str, type[Message]]:
        """The keys of answered queries, with the type of each query."""
        return dict(self._served)

    def on_query(self, key: str, payload: bytes | Message, call: object, now: float) -> None:
        """Process a query. Its `Reply` with this `call` comes now, later or never."""
        own = self._pass(now)
        if key == self._card_key:
            if self._announced:
                self._out.append(Reply(call, key, self._card()))
        elif key == self._bids_key:
            self._out.append(Reply(call, key, self.kernel.history()))
        elif key == self._settings_key:
            self._out.append(Reply(call, key, self.kernel.tune(ParametersRequest(), own)))
        elif self.stage is Stage.JOINED:
            kind, asker = self._asked(key)
            if kind is None:
                return
            request = self._read(kind, key, payload, now)
            if request is None:
                return
            if type(request) is ParametersRequest:
                self._out.append(Reply(call, key, self.kernel.tune(request, own)))
                return
            self._call_ids += 1
            self._calls[self._call_ids] = (call, key)
            if len(self._calls) > OPEN_QUERIES:
                self._calls.popitem(last=False)
            self.kernel.on_query(request, Question(self._call_ids, asker), own)

    def on_reply(self, question: int, reply: Message | None, now: float) -> None:
        """Process the reply to an `SendQuery`; None after a timeout."""
        own = self._pass(now)
        if question >= 0:
            self.kernel.on_reply(question, reply, own)
            return
        instance = self._cards.pop(question, None)
        if instance is None or self._admission is None:
            return
        # A card counts for its own instance only, so that no instance can replace another.
        card = reply if isinstance(reply, Card) and reply.instance == instance else None
        self._admission.on_card(instance, card, now)
        if card is not None and (card.name, card.instance) in self.alive:
            self.kernel.met(card, own)
            if card.name == ROBOT:
                self._note_epochs()
        self._progress(now)

    def received(self, data: bytes, now: float) -> None:
        """Process bytes from the device."""
        assert isinstance(self.agent, DeviceAgent), f"{self.agent.name} owns no device"
        self.kernel.on_bytes(data, self._pass(now))

    def link(self, up: bool, why: str, now: float) -> None:
        """Process that the device was opened or lost."""
        assert isinstance(self.agent, DeviceAgent), f"{self.agent.name} owns no device"
        self.kernel.on_link(up, why, self._pass(now))

    def guarded(self, acts_s: float, restarts_s: float, now: float) -> None:
        """Process that the device's line has a guard; see `DeviceAgent.on_guard`."""
        self.kernel.on_guard(acts_s, restarts_s, self._pass(now))

    def braked(self, now: float) -> None:
        """Process that the guard has braked the device by one step."""
        self.kernel.on_braked(self._pass(now))

    def slow(self, took: float) -> None:
        """Count a delivery or wake-up that took `took` s, if that is longer than a cycle.

        The first one is logged at once, the others together, at most once in `SLOW_S`.
        """
        if took > self.kernel.cycles.period and self.stage is Stage.JOINED:
            self._slow.append(took)
            self._report(self.now)

    def refuse(self, key: str, why: object, now: float) -> None:
        """Count a message of a key that was rejected or not sent, for the next report."""
        self._pass(now)
        self._refuse(key, why, now)

    def report(self, dropped: dict[str, int], now: float) -> None:
        """Add dropped messages, by key, to the next report; report if it is due."""
        self._pass(now)
        for key, count in dropped.items():
            self.refused[f"too busy: dropped on {key}"] += count
        self._report(now)

    # Inside: nothing here calls a public method, which a subclass may override -------------------

    def _refuse(self, key: str, why: object, now: float) -> None:
        counted = f"on {key}: {why}"
        if len(self.refused) < MOST_REASONS or counted in self.refused:
            self.refused[counted] += 1
        self._report(now)

    def _refuse_stray(self, to: Subscription, key: str, message: Any, own: float) -> None:
        """Refuse a message that is not of this society; answer a state in this agent's name."""
        if type(message) is Stop and self.kernel.cycles.newest is None:
            return  # it joins: it drives nothing, and its first state of the robot has the stop
        self._refuse(key, NOT_CURRENT, self.now)
        if to.kind is Kind.LATCHED and key.rpartition("/")[2] == self.agent.instance:
            self.kernel.memory.answer(message, own)  # others have accepted it as this agent's

    def _report(self, now: float) -> None:
        instance = self.agent.instance
        if self._slow and now - self._slow_at >= SLOW_S:
            count, worst, since = len(self._slow), max(self._slow), now - self._slow_at
            turns = "one turn" if count == 1 else f"{count} turns in {since:.0f} s, the longest"
            period = self.kernel.cycles.period
            text = f"{instance}: too slow: {turns} took {worst:.2f} s, a cycle is {period:g} s"
            self._slow_at = now
            self._slow.clear()
            self.kernel.log(text, WARNING)
        if not self.refused or now - self._reported_at < REPORT_S:
            return
        self._reported_at = now
        text = "; ".join(f"{count} x {why}" for why, count in self.refused.most_common(3))
        self.kernel.log(f"{instance}: rejected or dropped: {text}", WARNING)
        self.refused.clear()

    def _progress(self, now: float) -> None:
        """Query cards, announce, start or refuse the agent, as the admission decides."""
        admission = self._admission
        if admission is None or self.stage is Stage.REFUSED:
            self._check_at = None
            return
        admission.tenure = self.kernel.tenure
        for name, instance in admission.queries(now):
            number = -1 - self._call_ids
            self._call_ids += 1
            self._cards[number] = instance
            key = CARD.key_for(name=name, instance=instance)
            self._out.append(SendQuery(number, key, Ask(), Card, CARD_S))
        stage = admission.check(now)
        if stage is Stage.CLAIMING or stage is Stage.JOINED:
            self._announce()
        if stage is Stage.JOINED and self.stage is not Stage.JOINED:
            self._start(now)
        self.stage, self.refusal = stage, admission.refusal
        self._check_at = admission.wakeup

    def _announce(self) -> None:
        if not self._announced:
            self._announced = True
            self._out.append(Announce())

    def _start(self, now: float) -> None:
        """Start the agent; instances that are alive already appear to it now."""
        self._announce()
        self.stage = Stage.JOINED
        own = now - self._paused_s
        self.kernel.start(own)
        for name, instance in sorted(self.alive):
            self.kernel.appeared(name, instance, own)
        if isinstance(self.agent, DeviceAgent):
            self._out.append(OpenPort())

    def _card(self) -> Card:
        card = self.kernel.card()
        return card if self._wall is None else replace(card, clock=self._wall())

    def _answer(self, answer: Answer) -> None:
        call, key = self._calls.pop(answer.id, (None, ""))
        if key:
            self._out.append(Reply(call, key, answer.message))

    def _read(
        self, kind: type[Message], key: str, payload: bytes | Message, now: float
    ) -> Message | None:
        """Return the message in a payload; None if it is rejected, which is reported."""
        try:
            message = payload if isinstance(payload, Message) else decode(payload, kind)
        except MessageError as error:
            fault = str(error)
        else:
            fault = misaddressed(key, message)
            if not fault and type(message) is Stop and matches(RELEASE.pattern, key):
                alive = key.rpartition("/")[2] in self.kernel.living
                fault = NOT_PEOPLE if alive else ""
            if not fault:
                return message
        self._refuse(key, fault, now)
        return None

    def _note_epochs(self) -> None:
        """Note the epochs of the live robot agents."""
        robots = [instance for name, instance in self.alive if name == ROBOT]
        epochs = {epoch_of(instance) for instance in robots}
        older = any(self.kernel.speaks.get(each, SPOKEN) < SPOKEN for each in robots)
        found = frozenset(each for each in epochs if each is not None)
        self._epochs = None if older or len(found) < len(epochs) else found

    def _is_current(self, to: Subscription, key: str, message: Message) -> bool:
        """Return whether a message is of this society, by what it shows of its live processes.

        A recording can be published again, also while the robot agent restarts, but not the
        liveliness tokens in it. Commands, claims and sensors' messages have the robot's cycle.
        """
        if type(message) is RobotState:
            return self._epochs is None or message.cycle.epoch in self._epochs
        if to.message is Repeat:
            return key.rpartition("/")[2] in self.kernel.living
        if not to.shared or service_of(to.message).sender:
            return True
        publisher = key.rpartition("/")[2] if key != to.shared else ""
        if publisher in self.kernel.living:
            return True
        if to.kind is not Kind.LATCHED:  # a person's program has no token
            return not publisher or by_people(publisher)
        if type(message) is not Stop:
            return not publisher  # of protocol 2
        newest = self.kernel.cycles.newest
        return not message.epoch or (newest is not None and message.epoch == newest.epoch)

    def _repeated(self, key: str, repeat: Repeat, now: float) -> Latched | None:
        """Return the latched state that an agent repeats; None if it is refused."""
        service, message = service_at(repeat.key), None
        if service is None or service.kind is not Kind.LATCHED or service.message is Stop:
            self._refuse(key, f"it repeats {repeat.key}", now)
        else:
            message = self._read(service.message, repeat.key, repeat.payload, now)
        return cast("Latched | None", message)

    def _copy(self, item: Publish) -> None:
        """Publish also on the key of older protocols, while an agent is alive that uses one.

        The protocols of other robots are not known.
        """
        if self.kernel.elders or is_shared(item.key):
            shared = shared_key(item.message, item.key)
            if shared and shared != item.key:
                self._out.append(Publish(shared, item.message))

    def _counts(self, shared: str, key: str, message: Message, now: float) -> bool:
        """Return whether a message counts that comes on its publisher's own key, or the shared one.

        What an agent publishes on both counts once, on its own key. So on the shared key only
        publishers of an older protocol are heard.
        """
        if key != shared:
            if parent(key) != shared:  # further parts after the publisher
                self._refuse(key, Verdict.NOT_ITS_KEY, now)
                return False
            self._copied.append((now, message))
            return True
        for copied in self._copied:
            if copied[1] == message and now - copied[0] < COPY_S:
                self._copied.remove(copied)
                return False
        service = service_of(type(message))
        if self.kernel.speaks.get(service.sender_of(message), 0) < service.since:
            return True
        self._refuse(key, Verdict.NOT_ITS_KEY, now)
        return False

    def _may_log(self) -> bool:
        """Return whether the limits `LINES` and `LINES_A_S` allow one more log line."""
        now = self.kernel.now
        passed = max(now - self._lines_at, 0.0)
        self._lines = min(self._lines + LINES_A_S * passed, LINES)
        self._lines_at = now
        if self._lines < 1.0:
            self._left_out += 1
            return False
        self._lines -= 1.0
        if self._left_out:
            left_out, self._left_out = self._left_out, 0
            self.kernel.log(f"{left_out} log lines were dropped", WARNING)
        return True


def misaddressed(key: str, message: Message) -> str:
    """Return why a message does not belong on its key; "" if it does."""
    service = service_of(type(message))
    publisher = key.rpartition("/")[2]
    if type(message) is Stop:
        return _stop_misaddressed(key, publisher, message)
    if type(message) is Tuning and key != "tuning":
        ours = message.topic == agent_of(publisher)
        return "" if ours else f"it is about {message.topic or 'several agents'}"
    if (type(message) is Claim or type(message) is Ack) and key.split("/")[1] != message.resource:
        return f"it is about {message.resource}"
    sender = service.sender_of(message)
    if not sender or publisher == sender:
        return ""
    shared = service.since > OLDEST and key.count("/") < service.key.count("/")
    return "" if shared else Verdict.NOT_ITS_KEY


def _stop_misaddressed(key: str, publisher: str, stop: Stop) -> str:
    """Return why a stop or a release does not belong on its key; "" if it does.

    On the key that all publishers share in protocol 2, both do.
    """
    if matches(RELEASE.pattern, key):
        if stop.stopped:
            return "it is a stop"
        return "" if by_people(publisher) else NOT_PEOPLE
    return "it is a release" if not stop.stopped and matches(STOP.pattern, key) else ""
