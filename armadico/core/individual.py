"""What a user declares and writes of an agent (thesis 3.3): its individual intelligence."""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import ClassVar, Never, Protocol

from armadico.core import messages as m
from armadico.core.exchange import Bid
from armadico.core.messages import Message
from armadico.core.parameters import Parameters
from armadico.core.resources import Resource


class Rights(Protocol):
    """What instances may do in a society with keys, beside what its router enforces."""

    def may_be_critical(self, instance: str, resource: str, /) -> bool:
        """Return whether an instance's bids for a resource may be critical."""

    def may_own(self, instance: str, resource: str, /) -> bool:
        """Return whether an instance may own a resource."""


@dataclass(frozen=True)
class Identity:
    """An instance's identity, set by the process that runs it."""

    instance: str
    host: str = "localhost"
    pid: int = 0
    version: str = ""
    rng: random.Random = field(default_factory=random.Random, compare=False)
    table: str = ""  # the digest of its host table; empty: it has none
    map: str = ""  # the digest of its map; empty: it has none
    protocol: int = m.PROTOCOL  # that it uses; an older one is to try and replay what came before
    rights: Rights | None = field(default=None, compare=False)
    """Those of all instances; None: the society has no keys."""


class Individual:
    """The declarations of an agent, and the hooks that its kernel calls.

    An argument of type `Never` is the subclass's to name: its own message, action or parameters.
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
    competes_later: tuple[str, ...] = ()
    """How the names of resources begin that it competes for and that do not exist yet when it
    starts, such as `task-`. An instance has none if it knows that there will be none."""

    critical_for: ClassVar[tuple[Resource, ...]] = ()
    """Of the resources in `competes_for`, those for which its bids may be critical."""
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

    def __init__(self, identity: Identity, parameters: Parameters | None = None) -> None:
        self.identity = identity
        self.instance = identity.instance
        self.rng = identity.rng
        self.p: Parameters = self.parameters() if parameters is None else parameters

    why: str = ""
    lacks: str = ""

    def bid(self, message: Never) -> Bid | None:  # noqa: ARG002
        """The goal method: return the agent's bid, or None for no bid.

        Called once per cycle with the message that the agent reacts to. All needs are fresh and the
        robot is not stopped. Without a bid, `self.why` may be set to the reason and `self.lacks` to
        the key of the missing input.
        """
        return None

    def bid_for(self, resource: Resource, message: Never) -> Bid | None:  # noqa: ARG002
        """Return the bid for a resource, in an agent that competes for several."""
        return self.bid(message)

    def begins(self, resource: Resource, message: Never) -> bool:  # noqa: ARG002
        """Return whether a message that the agent reacts to starts its turn.

        An agent that waits for messages of several publishers returns False, and begins its turn
        with `take_turn`.
        """
        return True

    def obey(self, resource: Resource, action: Never) -> None:
        """The owner's method: execute an action (numbers or a message, as the resource has)."""

    def rest(self, resource: Resource) -> None:
        """The owner's method: bring the resource to rest after a release, a timeout or a stop."""

    def measure(self, resource: Resource) -> m.Action:
        """Return what an owned resource does now, in the order of its parameters."""
        return resource.neutral

    def beyond(self, resource: Resource, action: Never) -> str:  # noqa: ARG002
        """Return which owner's limit an action of the right shape exceeds; "" if none."""
        return ""

    def unavailable(self, resource: Resource) -> str:  # noqa: ARG002
        """Return why an owned resource can obey no command now; "" if it can."""
        return ""

    def on_start(self) -> None:
        """Called once, before any message except latched ones."""

    def on_wakeup(self) -> None:
        """Called at the time given to `wake_at`."""

    def on_parameters(self, before: Never) -> None:
        """Called when some of `changeable` were changed; `p` is new, `before` is the old value.

        An agent computes derived values again here. It raises ValueError before that to reject the
        change.
        """

    def on_appeared(self, name: str, instance: str) -> None:
        """Called when an instance's liveliness token appears."""

    def on_disappeared(self, name: str, instance: str) -> None:
        """Called when an instance's liveliness token disappears."""

    def on_message(self, message: Message) -> None:
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
