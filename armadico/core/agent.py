"""The base class of agents: what a user declares, writes and calls (thesis 3.3).

Individual intelligence is what a subclass writes: handlers for messages (`on_<message>`) and, for a
behaviour, `bid`; for an owner of a resource, `obey` and `rest`. Social intelligence is the kernel's
(`armadico.core.kernel`): freshness, turns, winner determination, exchange, acknowledgements, the
stop, latched states, the card. An agent holds no socket, thread, clock or sleep.

The modules of figure 3.6: internal state is the subclass's attributes and `latest`; collaboration
is `reacts_to`, `needs`, `receives`, `provides`, `answers` and `queries`; goal is `bid` and the
handlers; competition is `competes_for`; coordination is one `Contender` per resource; helper
methods are here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, ClassVar, TypeVar, cast

from armadico.core import messages as m
from armadico.core import names, parameters
from armadico.core.coordination import Owner
from armadico.core.cycles import CycleClock
from armadico.core.exchange import Bid
from armadico.core.kernel import Identity, Kernel, Subscription, subscriptions
from armadico.core.latched import Memory
from armadico.core.messages import Message
from armadico.core.outgoing import (
    DEBUG,
    ERROR,
    INFO,
    WARNING,
    Answer,
    Outgoing,
    Publish,
    Question,
    Refused,
    SendQuery,
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
    "Answer",
    "DeviceAgent",
    "Identity",
    "Outgoing",
    "Parameters",
    "Publish",
    "Question",
    "Refused",
    "SendQuery",
    "Social",
    "Subscription",
    "Write",
    "subscriptions",
]

M = TypeVar("M", bound=Message)

Parameters = parameters.Parameters
Social = parameters.Social


class Agent:
    """One agent. A subclass declares its messages and resources and adds handlers and methods.

    The framework calls the handlers and hooks, and nothing else of a subclass. A subclass that
    takes the name of another member is refused when it is made (`armadico.core.names`).
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
        self.p: Parameters = self.parameters() if parameters is None else parameters
        self.kernel = Kernel(self)

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

    def on_message(self, message: Any) -> None:
        """Called with each received message that counts, after its handler.

        Of several publishers it is called with each one's message, the handler with the combined
        one.
        """

    def on_card(self, card: m.Card) -> None:
        """Called with the card of a live instance."""

    def on_router(self) -> None:
        """Called when the robot's router becomes reachable or unreachable: `reachable`."""

    def on_leave(self) -> None:
        """Called when the process ends in order, after the resources were released and rested."""

    def fill_card(self, card: m.Card) -> m.Card:
        """Return the agent's card, with what only its class knows."""
        return card

    key_names: Mapping[str, str] = MappingProxyType({})
    """What fills the braces of keys, besides `name` and `instance`."""

    # What a subclass uses ------------------------------------------------------------------------

    why: str = ""
    lacks: str = ""

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
        found = (self.kernel.fresh(kind) for kind in derived(base))
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
        key = self.kernel.key_of(type(request), instance=instance or self.instance)
        self.kernel.query(key, request, service.reply, then, timeout)

    def query_card(
        self, name: str, instance: str, then: Callable[[Any], None], timeout: float = 1.0
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

    def write(self, data: bytes) -> None:
        """Write to the device. Bytes that a pause of the process delays by 0.3 s are dropped."""
        if data:
            self.kernel.outbox.append(Write(data))
