"""A process on the virtual mesh, as the network sees it."""

from __future__ import annotations

from collections.abc import Callable
from math import inf
from random import Random
from typing import Any, Final, Protocol

from armadico.core.agent import Agent
from armadico.core.messages import Message
from armadico.mesh.presence import Presence
from armadico.mesh.topology import DEFAULT_NAMESPACE
from armadico.mesh.virtual_clock import Scheduler, Step
from armadico.mesh.virtual_network import Link, Way

DEVICE: Final = "device"
"""The name of what is behind a device agent's port, as links have it."""

CLIENT: Final = "client"
"""The name of those who publish or query from outside the society."""


def address(namespace: str, name: str) -> str:
    """What a process is called among all robots': by its name alone where there is one robot."""
    return name if namespace == DEFAULT_NAMESPACE else f"{namespace}/{name}"


class Device(Protocol):
    """What stands behind a device agent's port in memory: bytes and the time in, bytes out."""

    def receive(self, data: bytes, now: float) -> None:
        """Bytes from the agent."""

    def advance(self, now: float) -> bytes:
        """Live up to this time; what it says meanwhile."""

    @property
    def due(self) -> float:
        """When it next has something to say, s."""


class Place:
    """A process on the mesh, as the network sees it."""

    def __init__(self, mesh: Network, namespace: str, name: str) -> None:
        self.namespace = namespace
        self.name = name
        self.address = address(namespace, name)  # by which its links are known
        self.alive = True
        self.hung = False
        self.lost = False  # hung for longer than the lease, and not found again yet
        self.tokens: list[tuple[str, str]] = []  # (name, instance) of those that can be seen
        self.mesh = mesh
        self.uplink: object = None  # what it is linked to: who has the same reaches it
        self.presence = Presence(self.tell, self.tell_router, reachable=True)
        self._look_at = inf

    @property
    def is_router(self) -> bool:
        """Whether it is a robot's process."""
        return False

    def see(self, name: str, instance: str, there: bool) -> None:
        """A token has come, or gone."""
        self.presence.token(name, instance, there)
        self.mind_presence()

    def mind_presence(self) -> None:
        """See that it looks again when that is due."""
        due = self.presence.due
        if due < self._look_at:
            self._look_at = due
            self.mesh.call_at(due, self._introduce, due)

    def _introduce(self, due: float, _: Any) -> None:
        if due == self._look_at:
            self._look_at = inf
            if self.alive:
                self.presence.poll(self.mesh.now)
                self.mind_presence()

    def listeners(self) -> list[tuple[str, Step, Any]]:
        """The patterns that it listens to, what takes a delivery, and as what."""
        raise NotImplementedError

    def queried(self, pattern: str) -> list[Any]:
        """What of it answers queries on the keys of a pattern."""
        raise NotImplementedError

    def asked(self, one: Any, what: tuple[str, Message, int]) -> None:
        """One of them takes a query: the key asked for, the request, and the query's number."""
        raise NotImplementedError

    def tell(self, name: str, instance: str, alive: bool) -> None:
        """Take the news of a token."""
        raise NotImplementedError

    def tell_router(self, there: bool) -> None:
        """Take the news that the robot's router can be reached, or cannot."""
        raise NotImplementedError

    def unsent(self, key: str, why: str) -> None:
        """Something was not sent."""

    def refuse(self, _: Any, what: tuple[str, Message]) -> None:
        """Something was published by a wildcard: nobody takes it."""

    def announce(self, name: str, instance: str) -> None:
        self.tokens.append((name, instance))
        self.mesh.liveliness.join(self, name, instance)

    def kill(self) -> None:
        """SIGKILL: it publishes nothing more, and its tokens go."""
        self.alive = False
        self.mesh.forget_routes()
        self.mesh.liveliness.killed(self)


Route = tuple[Place, Step, Any]
"""Who receives, what takes it, and as what."""


class Network(Scheduler):
    """The places and the links between them: what the parts of a mesh know of it.

    Attributes:
        places: The processes of agents, and the guests.
        refused: Told of a node that may not join, or stay.
        head: Begins the journals, if any are kept.
    """

    # The other parts, in modules of their own. They know the mesh by this class alone, and each
    # other by these names.
    star: Any
    liveliness: Any
    queries: Any
    ports: Any

    def __init__(self, seed: int, ties: Random | None) -> None:
        super().__init__(seed, ties)
        self.places: list[Place] = []
        self.refused: Callable[[Any], None] | None = None
        self.head: Callable[[Agent], bytes] | None = None
        self._links: dict[Way, Link] = {}
        self._routes: dict[Way, list[Route]] = {}  # by namespace and key; made when needed

    def start(self, node: Any, _: Any = None) -> None:
        """Have an agent begin, if it has not yet and its node is linked to a router."""
        raise NotImplementedError

    def spread(
        self,
        sender: str,
        key: str,
        message: Message,
        speaker: Place | None,
        namespace: str = DEFAULT_NAMESPACE,
    ) -> str:
        """Send to all but the speaker; why it could not be received, or an empty text."""
        raise NotImplementedError

    def later(self, source: Place | str, target: Place, call: Step, a: Any, b: Any = None) -> None:
        """Have something called once it has come over the network, if it does."""
        sender = source if isinstance(source, str) else source.address
        if not isinstance(source, str) and not self.star.passes(source, target, (call, a, b)):
            return
        at = self.link(sender, target.address).arrival(self.now)
        if at is not None:
            self.call_at(at, call, a, b)

    def others(self, place: Place | None, namespace: str = DEFAULT_NAMESPACE) -> list[Place]:
        """All others of a place's namespace who are alive, or of the one that is named."""
        namespace = namespace if place is None else place.namespace
        return [
            other
            for other in self.places
            if other.alive and other is not place and other.namespace == namespace
        ]

    def link(self, source: str, target: str) -> Link:
        """The network from one agent to another, to be cut, slowed or made to lose."""
        link = self._links.get((source, target))
        if link is None:
            link = self._links[source, target] = Link(self.stream(f"link/{source}/{target}"))
        return link

    def forget_routes(self) -> None:
        self._routes.clear()
