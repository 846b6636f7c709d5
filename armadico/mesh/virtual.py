"""The virtual mesh: a whole society in one thread, under a virtual clock, from one seed.

Computation takes no virtual time. Deliveries take delays drawn from the distribution measured on
the live mesh, never zero, or the same agent would always be first; what one process sends to
another arrives in order. Equal instants run in order of a sequence number. Each link and each
agent draws from its own stream, derived from the seed and its name, so adding an agent leaves the
others' noise as it was and comparisons are paired. A publication is checked once as the wire would,
and shared frozen. Agents are run by the same driver as live ones (`armadico.core.driver`).

As on the live mesh the process of the robot agent is the router of its namespace: what two others
say to each other passes it. In a namespace that never had an owner of wheels everybody reaches
everybody.

Faults: links that are slow, lossy, cut, or worse (`virtual_network`); processes that die, hang, are
slow, return or have a twin, and clocks of their own. Who is out of reach of the router for longer
than the lease is taken for gone, and found again some time after the cut has healed; to itself it
is cut off (`presence`).
"""

from __future__ import annotations

import heapq
import random
from collections.abc import Callable, Sequence
from typing import Any

from armadico.core.agent import Agent, AskFor, Identity
from armadico.core.messages import Message
from armadico.core.services import matches, service_of
from armadico.mesh.topology import DEFAULT_NAMESPACE, rooted
from armadico.mesh.virtual_device import Ports
from armadico.mesh.virtual_liveliness import LIVELINESS, Liveliness
from armadico.mesh.virtual_network import Clock
from armadico.mesh.virtual_node import Node
from armadico.mesh.virtual_place import CLIENT, Device, Network, Place, Route, address
from armadico.mesh.virtual_queries import Queries, sendable
from armadico.mesh.virtual_star import Star

__all__ = ["LEASE", "LIVELINESS", "RECONNECT", "Device", "Node", "VirtualMesh", "address"]

LEASE = 1.0
"""Lease: who is unreachable for so long, s, by a cut or a hang, is taken for gone."""

RECONNECT = (0.2, 0.5)
"""How long it then takes to find each other again, s: the pauses between attempts."""

Watcher = Callable[[str, Message, float], None]


class VirtualMesh(Network):
    """The network between the places on it, under its own clock."""

    def __init__(
        self,
        seed: int = 0,
        *,
        ties: random.Random | None = None,
        lease: float = LEASE,
        reconnect: tuple[float, float] = RECONNECT,
    ) -> None:
        """A network with nobody in it yet.

        Args:
            seed: Of all that is random.
            ties: Draws the order of equal instants; None: as they were put in.
            lease: Who cannot be heard for so long, s, is taken for gone.
            reconnect: How long it then takes to find each other again, s: from, to.
        """
        super().__init__(seed, ties)
        self.joined: Callable[[Node], None] | None = None  # told of each node that is added
        self.nodes: list[Node] = []  # the processes of agents
        self.liveliness = Liveliness(self, lease, reconnect)
        self.star = Star(self, reconnect)
        self.queries = Queries(self)
        self.ports = Ports(self)
        self._watchers: dict[tuple[str, type[Message]], list[Watcher]] = {}

    # Building ------------------------------------------------------------------------------------

    def identity(self, name: str, start: int = 0, namespace: str = DEFAULT_NAMESPACE) -> Identity:
        """Who the `start`-th instance of an agent is."""
        rng = self.stream(f"agent/{address(namespace, name)}/{start}")
        return Identity(f"{name}-{rng.getrandbits(64):016x}", "virtual", 0, "virtual", rng)

    def add(
        self,
        agent: Agent,
        device: Device | None = None,
        clock: Clock | None = None,
        *,
        admit: bool = True,
        waits: bool = True,
        namespace: str = DEFAULT_NAMESPACE,
    ) -> Node:
        """A process starts, now; a device that another had open is its own once it has joined.

        Without `admit` it joins at once, whoever is alive. While there is no router that it could
        be a client of, its agent does not begin, unless it is one that `waits` for none.
        """
        node = Node(agent, self, device, clock, admit, namespace)
        node.waits = waits
        self.nodes.append(node)
        self.take_in(node)
        self.call_at(self.now, self.start, node)
        if self.joined is not None:
            self.joined(node)
        return node

    def take_in(self, place: Place) -> None:
        self.places.append(place)
        self._routes.clear()
        self.star.join(place)

    def start(self, node: Node, _: Any = None) -> None:
        """Have its agent begin, if it has not yet and is linked to a router."""
        if node.alive and not node.begun and (self.star.has_router(node) or not node.waits):
            self.liveliness.introduce(node)
            node.begin()

    def keep_journals(self, head: Callable[[Agent], bytes]) -> None:
        """Whoever has not begun yet, and whoever joins later, keeps a journal: `Node.pieces`."""
        self.head = head
        for node in self.nodes:
            node.keep_journal()

    def watch(
        self, watcher: Watcher, *kinds: type[Message], namespace: str = DEFAULT_NAMESPACE
    ) -> None:
        """Watch every message of these kinds that one robot's agents publish, at that moment.

        Whoever watches does not take part.
        """
        for kind in kinds:
            self._watchers.setdefault((namespace, kind), []).append(watcher)

    def node(self, name: str, namespace: str = DEFAULT_NAMESPACE) -> Node:
        """The newest node of an agent's name. Raises KeyError if there is none."""
        for node in reversed(self.nodes):
            if node.name == name and node.namespace == namespace:
                return node
        raise KeyError(name)

    # Publications --------------------------------------------------------------------------------

    def publish(
        self,
        message: Message,
        sender: str = CLIENT,
        key: str | None = None,
        namespace: str = DEFAULT_NAMESPACE,
    ) -> None:
        """Publish something from outside the society, as a command-line tool would."""
        key = key or service_of(type(message)).key
        self.spread(address(namespace, sender), key, message, None, namespace)

    def publish_bytes(self, data: bytes, key: str, sender: str = CLIENT) -> None:
        """Publish a payload, whatever it is, from outside the society."""
        for place, deliver, to in self.routes(DEFAULT_NAMESPACE, key):
            self.later(sender, place, deliver, to, (key, data))

    def arrive(self, message: Message, name: str, key: str) -> None:
        """Have something arrive, now, that was published on a key for an agent long ago."""
        for place, deliver, to in self.routes(DEFAULT_NAMESPACE, key):
            if place.name == name:
                self.call_at(self.now, deliver, to, (key, message))

    def routes(self, namespace: str, key: str) -> list[Route]:
        """Who receives what is published on a key, in the order in which they were added."""
        routes = self._routes.get((namespace, key))
        if routes is None:
            where = rooted(namespace, key)
            routes = self._routes[namespace, key] = [
                (place, place.refuse if "*" in key else deliver, to)
                for place in self.places
                if place.alive
                for pattern, deliver, to in place.listeners()
                if matches(rooted(place.namespace, pattern), where)
            ]
        return routes

    def spread(
        self,
        sender: str,
        key: str,
        message: Message,
        speaker: Place | None,
        namespace: str = DEFAULT_NAMESPACE,
    ) -> str:
        """Send to everybody but the speaker, to another instance of the same agent too.

        Args:
            sender: Whose links it takes.
            key: What it is published on.
            message: What is published.
            speaker: Who publishes it; None: somebody outside the society,
            namespace: of this robot.

        Returns:
            Why it could not be received, or an empty text.
        """
        namespace = namespace if speaker is None else speaker.namespace
        watchers = self._watchers.get((namespace, type(message)), ())
        routes = self.routes(namespace, key)
        if not watchers and not routes:
            return ""
        shared = sendable(message)
        if isinstance(shared, str):
            return shared
        for watcher in watchers:
            watcher(key, shared, self.now)
        if speaker is not None and speaker.lost:
            return ""
        now, links, heap, what = self.now, self._links, self._heap, (key, shared)
        star = self.star if self.star.troubled else None
        for place, deliver, to in routes:
            if place is speaker or place.lost:
                continue
            if star is not None and speaker is not None:
                passes = star.passes(speaker, place, (deliver, to, what))
                if not passes:
                    continue
            link = links.get((sender, place.address)) or self.link(sender, place.address)
            at = link.arrival(now)
            while at is not None:
                heapq.heappush(heap, (at, self._next(), deliver, to, what))
                at = link.again(at) if link.faults.duplicate else None
        return ""

    # Queries -------------------------------------------------------------------------------------

    def ask(
        self,
        request: Message,
        then: Callable[[Message | None], None],
        timeout: float = 5.0,
        namespace: str = DEFAULT_NAMESPACE,
    ) -> None:
        """Put a query from outside the society; `then` is told its first reply, or None."""
        service = service_of(type(request))
        assert service.reply is not None, f"{service.key} is not a query"
        asking = AskFor(0, service.key, request, service.reply, timeout)
        self.queries.put_first(None, asking, then, namespace)

    # Faults --------------------------------------------------------------------------------------

    def cut(self, sources: Sequence[str], targets: Sequence[str], *, lease: bool = False) -> None:
        """What some agents publish no longer reaches others; both by name (`Liveliness.cut`)."""
        self.liveliness.cut(sources, targets, lease=lease)

    def heal(self, sources: Sequence[str], targets: Sequence[str]) -> None:
        self.liveliness.heal(sources, targets)
