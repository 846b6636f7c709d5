"""A process on the virtual mesh, as the network sees it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import inf
from random import Random
from typing import Any, Final, Never, Protocol

from armadico.core.agent import Agent
from armadico.core.messages import Message
from armadico.mesh.presence import Presence
from armadico.mesh.topology import DEFAULT_NAMESPACE
from armadico.mesh.virtual_clock import Scheduler, Step
from armadico.mesh.virtual_network import Link, Way

DEVICE: Final = "device"  # a device's name, for its links
CLIENT: Final = "client"  # the name of publishers and clients outside the society


def address(namespace: str, name: str) -> str:
    """Return a process's address among those of all robots; of the default robot its name."""
    return name if namespace == DEFAULT_NAMESPACE else f"{namespace}/{name}"


def guest(name: str) -> str:
    """Return the id under which a client publishes."""
    return f"guest-{name}"


class Device(Protocol):
    """A device in memory behind a device agent's port: bytes and the time in, bytes out."""

    def receive(self, data: bytes, now: float) -> None:
        """Process bytes from the agent."""

    def advance(self, now: float) -> bytes:
        """Simulate up to this time, s; return the bytes sent meanwhile."""

    @property
    def due(self) -> float:
        """When it sends next, s."""


class Place:
    """A process on the mesh, as the network sees it."""

    def __init__(self, mesh: Network, namespace: str, name: str) -> None:
        self.namespace = namespace
        self.name = name
        self.address = address(namespace, name)  # by which its links are known
        self.alive = True
        self.hung = False
        self.lost = False  # hung for longer than the lease, and not found again yet
        self.tokens: list[tuple[str, str]] = []  # declared ones: (name, instance)
        self.mesh = mesh
        self.uplink: object = None  # its router; places with the same uplink reach each other
        self.presence = Presence(self.on_token, self.on_router, reachable=True)
        self._poll_at = inf

    @property
    def is_router(self) -> bool:
        """Whether it is a robot's process."""
        return False

    def update_token(self, name: str, instance: str, there: bool) -> None:
        """Process that a token appeared (`there`) or disappeared."""
        self.presence.token(name, instance, there, self.mesh.now)
        self.schedule_poll()

    def schedule_poll(self) -> None:
        """Schedule the next poll of `presence`."""
        due = self.presence.due
        if due < self._poll_at:
            self._poll_at = due
            self.mesh.call_at(due, self._poll, due)

    def _poll(self, due: float, _: object) -> None:
        if due == self._poll_at:
            self._poll_at = inf
            if self.alive:
                self.presence.poll(self.mesh.now)
                self.schedule_poll()

    def listeners(self) -> list[tuple[str, Step, object]]:
        """Return its subscriptions: the pattern, the call for a delivery, its first argument."""
        raise NotImplementedError

    def queryables(self, pattern: str) -> Sequence[object]:
        """Return the first arguments of `on_query` for the keys of a pattern."""
        raise NotImplementedError

    def on_query(self, queryable: Never, what: tuple[str, Message, int]) -> None:
        """Process a query: its key, the request, and the query's number."""
        raise NotImplementedError

    def on_token(self, name: str, instance: str, alive: bool) -> None:
        """Process the filtered change of a token."""
        raise NotImplementedError

    def on_router(self, there: bool) -> None:
        """Process that the robot's router became reachable (`there`) or unreachable."""
        raise NotImplementedError

    def unsent(self, key: str, why: str) -> None:
        """Process that a message could not be sent."""

    def refuse(self, _: object, what: tuple[str, Message]) -> None:
        """Reject a publication by a wildcard."""

    def announce(self, name: str, instance: str) -> None:
        self.tokens.append((name, instance))
        self.mesh.liveliness.join(self, name, instance)

    def kill(self) -> None:
        """SIGKILL: it publishes nothing more, and its tokens disappear."""
        self.alive = False
        self.mesh.forget_routes()
        self.mesh.liveliness.killed(self)


Route = tuple[Place, Step, object]  # the receiver, the call for a delivery, its first argument


class Network(Scheduler):
    """The places and the links between them: the mesh as its parts see it."""

    # The other parts, in modules of their own. They use only this class and these names.
    star: Any
    liveliness: Any
    queries: Any
    ports: Any

    def __init__(self, seed: int, ties: Random | None) -> None:
        super().__init__(seed, ties)
        self.places: list[Place] = []  # the processes of agents, and the guests
        # Called with a node that may not join, or stay.
        self.refused: Callable[..., None] | None = None
        # Returns the head of an agent's journal, if journals are kept.
        self.head: Callable[[Agent], bytes] | None = None
        self._links: dict[Way, Link] = {}
        self._routes: dict[Way, list[Route]] = {}  # by namespace and key; made when needed

    def start(self, node: Any, _: object = None) -> None:
        """Begin a node's agent if it is linked to a router and has not begun."""
        raise NotImplementedError

    def spread(
        self,
        sender: str,
        key: str,
        message: Message,
        publisher: Place | None,
        namespace: str = DEFAULT_NAMESPACE,
    ) -> str:
        """Send to all except the publisher; return why it could not be received, or ""."""
        raise NotImplementedError

    def later(
        self,
        source: Place | str,
        target: Place,
        call: Step,
        a: object,
        b: object = None,
        *,
        reliable: bool = False,
    ) -> None:
        """Schedule a call for when it has passed the network, unless it is lost.

        What is sent reliably is lost by cuts alone.
        """
        sender = source if isinstance(source, str) else source.address
        if not isinstance(source, str) and not self.star.passes(source, target, (call, a, b)):
            return
        at = self.link(sender, target.address).arrival(self.now, reliable=reliable)
        if at is not None:
            self.call_at(at, call, a, b)

    def others(self, place: Place | None, namespace: str = DEFAULT_NAMESPACE) -> list[Place]:
        """Return all other live places of a place's namespace, or of the given one."""
        namespace = namespace if place is None else place.namespace
        return [
            other
            for other in self.places
            if other.alive and other is not place and other.namespace == namespace
        ]

    def link(self, source: str, target: str) -> Link:
        """Return the link from one address to another, whose faults may be set."""
        link = self._links.get((source, target))
        if link is None:
            link = self._links[source, target] = Link(self.stream(f"link/{source}/{target}"))
        return link

    def forget_routes(self) -> None:
        self._routes.clear()
