"""The base class of agents: an agent as its user sees it (thesis 3.3).

Individual intelligence is what a subclass declares and writes (`armadico.core.individual`):
handlers for messages (`on_<message>`) and, for a behaviour, `bid`; for an owner of a resource,
`obey` and `rest`. Social intelligence is the kernel's (`armadico.core.kernel`): freshness, turns,
winner determination, exchange, acknowledgements, the stop, latched states, the card. An agent holds
no socket, thread, clock or sleep.

The modules of figure 3.6: internal state is the subclass's attributes and `latest`; collaboration
is `reacts_to`, `needs`, `receives`, `provides`, `answers` and `queries`; goal is `bid` and the
handlers; competition is `competes_for`; coordination is one `Mechanism` per resource; helper
methods are here.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Never, TypeVar, cast

from armadico.core import messages as m
from armadico.core import names, parameters
from armadico.core.coordination import Owner
from armadico.core.cycles import CycleClock
from armadico.core.individual import Identity, Individual
from armadico.core.kernel import Kernel
from armadico.core.latched import Memory
from armadico.core.messages import Message
from armadico.core.outgoing import (
    DEBUG,
    ERROR,
    EXPIRY_S,
    INFO,
    WARNING,
    Answer,
    Question,
    Refused,
    Write,
)
from armadico.core.resources import Resource
from armadico.core.services import CARD, derived, service_of

__all__ = [
    "DEBUG",
    "ERROR",
    "INFO",
    "WARNING",
    "Agent",
    "DeviceAgent",
    "Identity",
    "Parameters",
    "Question",
]

M = TypeVar("M", bound=Message)

Parameters = parameters.Parameters


class Agent(Individual):
    """One agent. A subclass declares its messages and resources and adds handlers and methods.

    The framework calls the handlers and hooks, and nothing else of a subclass. A subclass that
    takes the name of another member is refused when it is made (`armadico.core.names`).
    """

    def __init_subclass__(
        cls,
        *,
        overrides: tuple[str, ...] = (),
        hooks: tuple[str, ...] | None = None,
        **rest: object,
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
        names.check_answers(cls, cls.answers)
        if hooks is not None:
            names.take(cls, hooks)

    def __init__(self, identity: Identity, parameters: Parameters | None = None) -> None:
        super().__init__(identity, parameters)
        self.kernel = Kernel(self)

    @property
    def now(self) -> float:
        """The time, s."""
        return self.kernel.now

    @property
    def cycles(self) -> CycleClock:
        """The robot's cycles."""
        return self.kernel.cycles

    @property
    def memory(self) -> Memory:
        """The latched states."""
        return self.kernel.memory

    @property
    def reachable(self) -> bool:
        """Whether the robot's router can be reached."""
        return self.kernel.reachable

    @property
    def stopped(self) -> m.Stop | None:
        """The robot's stop, while it is latched."""
        return self.kernel.stopped

    def key_of(self, kind: type[Message], **names: str) -> str:
        """Return the key of a kind's service, filled with `names`, else this instance's names."""
        return self.kernel.key_of(kind, **names)

    def publish(self, message: Message, **names: str) -> None:
        """Publish a message on its service's key; `names` fill the key's braces."""
        self.kernel.publish(message, **names)

    def latest(self, kind: type[M]) -> M | None:
        """Return the newest message of a kind, fresh or not."""
        return self.kernel.latest(kind)

    def fresh(self, kind: type[M]) -> M | None:
        """Return the newest message of a kind if it is fresh by the table of services."""
        return self.kernel.fresh(kind)

    def each_fresh(self, base: type[M]) -> list[M]:
        """Return the fresh messages of all subscribed kinds that derive from a base."""
        found = map(self.kernel.fresh, derived(base))
        return [cast("M", message) for message in found if message is not None]

    def query(
        self,
        request: Message,
        then: Callable[[Never], None],  # it names the type of the service's reply, or None
        timeout: float = 2.0,
        instance: str = "",
    ) -> None:
        """Send a query; `then` gets the first reply, or None after the timeout (s).

        `instance` is the receiver, where the service's key has one.
        """
        service = service_of(type(request))
        assert service.reply is not None, f"{service.key} is not a query"
        key = self.kernel.key_of(type(request), instance=instance or self.instance)
        if service.named and self.kernel.closed:
            key = service.asked_by(self.name)
        self.kernel.query(key, request, service.reply, then, timeout)

    def query_card(
        self, name: str, instance: str, then: Callable[[m.Card | None], None], timeout: float = 1.0
    ) -> None:
        """Query an instance's card; `then` gets it, or None after the timeout (s)."""
        key = CARD.key_for(name=name, instance=instance)
        self.kernel.query(key, m.Ask(), m.Card, then, timeout)

    def answer(self, question: Question, reply: Message) -> None:
        self.kernel.outbox.append(Answer(question.id, reply))

    def refuse(self, key: str, why: str) -> None:
        """Count a message of a key that the agent rejects; `why` is one of few different texts."""
        self.kernel.outbox.append(Refused(key, why))

    def wake_at(self, when: float) -> None:
        """Set the agent's only wake-up: `on_wakeup` is called at this time, s."""
        self.kernel.alarm = when

    def holds(self, resource: Resource) -> bool:
        """Return whether the agent holds the resource, by its own state."""
        return self.kernel.bidding(resource).contender.holding

    def share(self, resource: Resource) -> float:
        """Return how much of the resource's command is this agent's, 0 to 1.

        By ballots it is 1 for the holder. With an arbiter it is what the last award says, or what
        `social.told` sets.
        """
        return self.kernel.bidding(resource).contender.share

    def drives(self, resource: Resource, instance: str) -> bool:
        """Return whether an instance's commands carry this agent's bids."""
        return self.kernel.bidding(resource).contender.speaker == instance

    def take_turn(self, resource: Resource, message: Message) -> None:
        """Bid now for the cycle of a message; at most once per cycle."""
        self.kernel.bidding(resource).take(message)

    def acked(self, resource: Resource) -> m.Ack | None:
        """Return the last acknowledgement of the resource's owner."""
        return self.kernel.bidding(resource).contender.ack

    def owner(self, resource: Resource) -> Owner:
        return self.kernel.owning(resource).owner

    def latch(self, by: str) -> None:
        """Latch the robot's stop. Any agent may; only the operator releases it."""
        self.kernel.latch(by)

    def acknowledge(self) -> None:
        """Begin a cycle in the agent that makes the cycles: acknowledge what it owns.

        Other owners acknowledge when they receive the robot's state.
        """
        self.kernel.acknowledge()

    def log(self, text: str, level: int = INFO, event: str = "") -> None:
        """Publish a log line; `event` (`m.LogEvent`) is for programs."""
        self.kernel.log(text, level, event)


names.take(Agent)


class DeviceAgent(Agent, hooks=("address",)):
    """An agent that owns a device: bytes in, bytes out."""

    address: str = ""
    """The device's URL, opened by the transport of its scheme; empty: none is opened."""

    def on_bytes(self, data: bytes) -> None:
        """Called with bytes from the device."""

    def on_link(self, up: bool, why: str) -> None:
        """Called when the device was opened or lost."""

    def on_guard(self, acts_s: float, restarts_s: float) -> None:
        """Called when the device was opened, before `on_link`.

        Without this agent its guard brakes the device after `acts_s`; inf: there is no guard. If
        the guard fails itself, another one brakes after `restarts_s`.
        """

    def on_braked(self) -> None:
        """Called when the guard has written one step of the last write's `brakes`."""

    def write(
        self,
        data: bytes,
        *,
        brakes: tuple[bytes, ...] = (),
        moves: bool = False,
        holds_s: float = EXPIRY_S,
    ) -> None:
        """Write to the device; see `Write`.

        Bytes that a pause of the process delays by 0.3 s are dropped.
        """
        if data or brakes:
            self.kernel.outbox.append(Write(data, brakes, moves, holds_s))
