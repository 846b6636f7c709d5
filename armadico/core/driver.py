"""One agent's life, sans-IO: joining, cards, deliveries, wake-ups, questions, lines for people.

Both meshes run agents by this class, so what seeds find on the virtual one is what happens live.
Whoever runs it hands it what arrives and the time, and sends what it finds in `take()`. It holds no
socket, thread or clock.
"""

from __future__ import annotations

from collections import Counter, OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from msgspec.structs import replace

from armadico.core.agent import (
    WARNING,
    Agent,
    Answer,
    AskFor,
    DeviceAgent,
    Publish,
    Question,
    Refused,
    Subscription,
    Write,
)
from armadico.core.membership import CARD_S, Admission, Stage
from armadico.core.messages import (
    Ack,
    Ask,
    BidHistory,
    Card,
    Claim,
    Command,
    Latched,
    Log,
    Message,
    MessageError,
    ParametersRequest,
    decode,
)
from armadico.core.services import BIDS, CARD

QUESTIONS: Final = 64
"""Queries that may wait for their answers; the oldest is let go of."""

LINES: Final = 30
"""Lines for people that one agent may publish at once,"""

LINES_A_S: Final = 2.0
"""and for ever, a second: whoever is flooded must not flood."""

REPORT_S: Final = 5.0
"""What was refused or dropped is reported at most so often."""


PAUSE_S: Final = 2.0
"""An agent that was not run for longer than this, although it was to be, counts only this: its
process was paused, or its clock was stepped. Its limits are for what it could have observed. It is
longer than any limit that keeps an agent from acting on what it received before the pause."""


@dataclass(frozen=True, slots=True)
class Announce:
    """Show the agent's liveliness token."""


@dataclass(frozen=True, slots=True)
class OpenPort:
    """Open the agent's device."""


@dataclass(frozen=True, slots=True)
class Reply:
    """Answer a query: `call` is whatever `asked` was given."""

    call: Any
    key: str
    message: Message


Output = Publish | AskFor | Write | Announce | OpenPort | Reply


class Driver:
    """Runs one agent. Everything is called by one thread; times are s, by any one clock.

    The agent's own time is that clock's, less what passed at once beyond `PAUSE_S`.

    Attributes:
        now: When the driver was called last, s by the caller's clock.
    """

    def __init__(
        self,
        agent: Agent,
        now: float,
        *,
        admit: bool = True,
        wall: Callable[[], float] | None = None,
    ) -> None:
        """Begin to look around.

        Args:
            agent: Whose life it is.
            now: The time, s.
            admit: Without, it joins whoever is alive.
            wall: Wall time for the card, s since 1970: for people only.
        """
        self.agent = agent
        self.now = now
        self._paused_s = 0.0  # that did not pass for the agent
        self.stage = Stage.LOOKING
        self.refusal = ""  # why it may not join, or stay
        self.alive: set[tuple[str, str]] = set()  # (name, instance) of the others
        self.refused: Counter[str] = Counter()  # since it was last reported, by key and reason
        self._admission = (
            Admission(
                agent.name,
                agent.instance,
                now,
                alone=agent.alone,
                owns=[resource.name for resource in agent.owns],
            )
            if admit
            else None
        )
        self._wall = wall
        self._out: list[Output] = []
        self._look_at: float | None = now  # when the admission looks again
        self._announced = False
        self._calls: OrderedDict[int, tuple[Any, str]] = OrderedDict()
        self._call_ids = 0
        self._cards: dict[int, str] = {}  # cards asked for: the instance, by the question's id
        self._lines = float(LINES)
        self._lines_at = now
        self._left_out = 0
        self._why_refused = ""
        self._reported_at = float("-inf")

    # Its life ------------------------------------------------------------------------------------

    def begin(self, now: float) -> None:
        """Go as far as it may at once."""
        self._passes(now)
        if self._admission is None:
            self._look_at = None
            self._start(now)
        else:
            self._progress(now)

    @property
    def started(self) -> bool:
        """Whether the agent is at work."""
        return self.stage is Stage.JOINED

    @property
    def wakeup(self) -> float | None:
        """When `wake` should be called, s, if nothing comes before."""
        return self._due()

    def _due(self) -> float | None:
        mine = self._look_at
        if self.stage is not Stage.JOINED:
            return mine
        due = self.agent.wakeup
        if due is None:
            return mine
        due += self._paused_s
        return due if mine is None else min(due, mine)

    def _passes(self, now: float) -> float:
        """Note the time; what it is for the agent, s."""
        if now - self.now > PAUSE_S:
            due = self._due()
            until = self.now if due is None else max(self.now, due)
            self._paused_s += max(now - until - PAUSE_S, 0.0)
        self.now = now
        return now - self._paused_s

    def wake(self, now: float) -> None:
        own = self._passes(now)
        if self.stage is Stage.JOINED:
            due = self.agent.wakeup
            if due is not None and now >= due + self._paused_s:
                self.agent.wake(max(own, due))  # the sum above is rounded
        if self._look_at is not None and now >= self._look_at:
            self._progress(now)

    def leave(self, now: float) -> None:
        """Let go of what the agent holds, and rest what it owns."""
        self.agent.outbox.clear()  # half a turn, if there is one, is not sent
        own = self._passes(now)
        if self.stage is Stage.JOINED:
            self.agent.stop(own)

    def drain(self) -> list[Output]:
        """What is to be sent, each once, in order."""
        agent = self.agent
        if not agent.outbox:
            if not self._out:
                return []
            sent, self._out = self._out, []
            return sent
        while agent.outbox:
            out, agent.outbox = agent.outbox, []
            for item in out:
                if type(item) is Publish:
                    if type(item.message) is Log and not self._may_log():
                        continue
                    self._out.append(item)
                elif isinstance(item, Answer):
                    self._answer(item)
                elif isinstance(item, Refused):
                    self._refuse(item.key, item.why, self.now)
                else:
                    self._out.append(item)
        sent, self._out = self._out, []
        return sent

    # What arrives --------------------------------------------------------------------------------

    def deliver(self, to: Subscription, key: str, payload: bytes | Message, now: float) -> None:
        """Take what was published on a key, encoded or not."""
        own = self._passes(now)
        message: Any = payload
        kind = type(message)  # `isinstance` of a message goes through its ABC: slow, and not needed
        if kind is bytes or kind in _ADDRESSED:
            message = self._read(to.message, key, payload, now)
            if message is None:
                return
        if self.refused:
            self._report(now)  # what came too soon after the last report
        if self.stage is Stage.JOINED:
            self.agent.receive(message, own)
        elif isinstance(message, Latched) and self.stage is not Stage.REFUSED:
            self.agent.remember(message, own)

    def token(self, name: str, instance: str, alive: bool, now: float) -> None:
        """Take the news of a liveliness token, whichever way."""
        own = self._passes(now)
        who = (name, instance)
        if instance == self.agent.instance or alive == (who in self.alive):
            return
        (self.alive.add if alive else self.alive.discard)(who)
        if self._admission is not None:
            if alive:
                self._admission.appeared(name, instance, now)
            else:
                self._admission.disappeared(instance, now)
        if self.stage is Stage.JOINED:
            tell = self.agent.appeared if alive else self.agent.disappeared
            tell(name, instance, own)
        self._progress(now)

    def router(self, there: bool, now: float) -> None:
        """Take the news that the robot's router can be reached, or cannot."""
        own = self._passes(now)
        if self.stage is Stage.JOINED:
            self.agent.take_router(there, own)
        else:
            self.agent.reachable = there

    def answers(self, key: str) -> type[Message] | None:
        """The kind of query that it answers on a key, if it does."""
        return self._answers(key)

    def _answers(self, key: str) -> type[Message] | None:
        if key in {self._card_key, self._bids_key}:
            return Ask
        if key == self._parameters_key:
            return ParametersRequest
        for kind in self.agent.answers:
            if self.agent.key_of(kind) == key:
                return kind
        return None

    @property
    def queries(self) -> dict[str, type[Message]]:
        """The keys on which it answers, and what it is asked there."""
        return self._queries()

    def _queries(self) -> dict[str, type[Message]]:
        own: dict[str, type[Message]] = {
            self._card_key: Ask,
            self._bids_key: Ask,
            self._parameters_key: ParametersRequest,
        }
        return {self.agent.key_of(kind): kind for kind in self.agent.answers} | own

    def asked(self, key: str, payload: bytes | Message, call: Any, now: float) -> None:
        """Take a query; its `Reply`, with this `call`, comes now or later, or never."""
        own = self._passes(now)
        if key == self._card_key:
            if self._announced:
                self._out.append(Reply(call, key, self._card()))
        elif key == self._bids_key:
            self._out.append(Reply(call, key, self._history()))
        elif (kind := self._answers(key)) is not None and self.stage is Stage.JOINED:
            request = self._read(kind, key, payload, now)
            if request is None:
                return
            if type(request) is ParametersRequest:
                self._out.append(Reply(call, key, self.agent.tune(request, own)))
                return
            self._call_ids += 1
            self._calls[self._call_ids] = (call, key)
            if len(self._calls) > QUESTIONS:
                self._calls.popitem(last=False)
            self.agent.asked(Question(self._call_ids, request), own)

    def replied(self, question: int, reply: Message | None, now: float) -> None:
        """Take the reply to an `AskFor`; None if none came in time, or no more will come."""
        own = self._passes(now)
        if question >= 0:
            self.agent.replied(question, reply, own)
            return
        instance = self._cards.pop(question, None)
        if instance is None or self._admission is None:
            return
        # A card speaks for its own instance only: nobody takes another's place, or its word away.
        card = reply if isinstance(reply, Card) and reply.instance == instance else None
        self._admission.answered(instance, card, now)
        if card is not None and (card.name, card.instance) in self.alive:
            self.agent.met(card, own)
        self._progress(now)

    def received(self, data: bytes, now: float) -> None:
        """Take bytes from the device."""
        assert isinstance(self.agent, DeviceAgent), f"{self.agent.name} owns no device"
        self.agent.take_bytes(data, self._passes(now))

    def link(self, up: bool, why: str, now: float) -> None:
        """Take the news that the device was opened, or is gone."""
        assert isinstance(self.agent, DeviceAgent), f"{self.agent.name} owns no device"
        self.agent.take_link(up, why, self._passes(now))

    def slow(self, took: float) -> None:
        """Take how long one delivery or wake-up took, s."""
        period = self.agent.cycles.period
        if took > period and self.stage is Stage.JOINED:
            self.agent.log(
                f"{self.agent.instance}: too slow: one turn took {took:.2f} s, a cycle is"
                f" {period:g} s",
                WARNING,
            )

    def refuse(self, key: str, why: object, now: float) -> None:
        """Count what was refused, or could not be sent, on a key; and now and then say so."""
        self._passes(now)
        self._refuse(key, why, now)

    def report(self, dropped: dict[str, int], now: float) -> None:
        """Say now and then what was dropped or refused."""
        self._passes(now)
        for key, count in dropped.items():
            self.refused[f"too busy: dropped on {key}"] += count
        self._report(now)

    # Inside: nothing here calls what is called from outside, which may be overridden -------------

    def _refuse(self, key: str, why: object, now: float) -> None:
        counted = f"on {key}: {why}"
        if len(self.refused) < QUESTIONS or counted in self.refused:
            self.refused[counted] += 1
        self._report(now)

    def _report(self, now: float) -> None:
        if not self.refused or now - self._reported_at < REPORT_S:
            return
        self._reported_at = now
        text = "; ".join(f"{count} x {why}" for why, count in self.refused.most_common(3))
        self.agent.log(f"{self.agent.instance}: refused or dropped: {text}", WARNING)
        self.refused.clear()

    def _progress(self, now: float) -> None:
        """Ask for cards, show the token, begin, or leave, as it may by now."""
        admission = self._admission
        if admission is None or self.stage is Stage.REFUSED:
            self._look_at = None
            return
        admission.tenure = self.agent.tenure
        for name, instance in admission.questions(now):
            number = -1 - self._call_ids
            self._call_ids += 1
            self._cards[number] = instance
            key = CARD.key_for(name=name, instance=instance)
            self._out.append(AskFor(number, key, Ask(), Card, CARD_S))
        stage = admission.check(now)
        if stage is Stage.CLAIMING or stage is Stage.JOINED:
            self._announce()
        if stage is Stage.JOINED and self.stage is not Stage.JOINED:
            self._start(now)
        self.stage, self.refusal = stage, admission.refusal
        self._look_at = admission.wakeup

    def _announce(self) -> None:
        if not self._announced:
            self._announced = True
            self._out.append(Announce())

    def _start(self, now: float) -> None:
        """Begin work; who is alive already is told of as if it had come now."""
        self._announce()
        self.stage = Stage.JOINED
        own = now - self._paused_s
        self.agent.start(own)
        for name, instance in sorted(self.alive):
            self.agent.appeared(name, instance, own)
        if isinstance(self.agent, DeviceAgent):
            self._out.append(OpenPort())

    @property
    def _card_key(self) -> str:
        return CARD.key_for(name=self.agent.name, instance=self.agent.instance)

    @property
    def _bids_key(self) -> str:
        return BIDS.key_for(name=self.agent.name, instance=self.agent.instance)

    @property
    def _parameters_key(self) -> str:
        return self.agent.key_of(ParametersRequest)

    def _card(self) -> Card:
        card = self.agent.card()
        return card if self._wall is None else replace(card, clock=self._wall())

    def _history(self) -> BidHistory:
        return self.agent.history()

    def _answer(self, answer: Answer) -> None:
        call, key = self._calls.pop(answer.id, (None, ""))
        if key:
            self._out.append(Reply(call, key, answer.message))

    def _read(
        self, kind: type[Message], key: str, payload: bytes | Message, now: float
    ) -> Message | None:
        """The message in a payload; None, counted and now and then reported, if there is none."""
        try:
            message = payload if isinstance(payload, Message) else decode(payload, kind)
        except MessageError as error:
            fault = str(error)
        else:
            fault = misaddressed(key, message)
            if not fault:
                return message
        self._refuse(key, fault, now)
        return None

    def _may_log(self) -> bool:
        """Whether one more line may go out: so many at once, so many a second for ever."""
        now = self.agent.now
        passed = max(now - self._lines_at, 0.0)
        self._lines = min(self._lines + LINES_A_S * passed, LINES)
        self._lines_at = now
        if self._lines < 1.0:
            self._left_out += 1
            return False
        self._lines -= 1.0
        if self._left_out:
            left_out, self._left_out = self._left_out, 0
            self.agent.log(f"{left_out} lines were left out", WARNING)
        return True


_ADDRESSED: Final = frozenset({Command, Claim, Ack})
"""Messages that say whose they are, or what they are about, as their keys do."""


def misaddressed(key: str, message: Message) -> str:
    """What is wrong with a message on a key: nobody commands or claims in another's name."""
    said: Any = message
    if type(message) is Command:
        if key.rpartition("/")[2] != said.ballot.instance:
            return f"a command with the ballot of {said.ballot.instance}"
    elif type(message) in _ADDRESSED and key.split("/")[1] != said.resource:
        return f"it is about {said.resource}"
    return ""
