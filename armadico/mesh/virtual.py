"""The virtual mesh: a whole society in one thread, under a virtual clock, from one seed.

Computation takes no virtual time. Deliveries take random delays with the distribution measured on
the live mesh. They are never zero: otherwise the same agent would always be first. Messages of one
process to another arrive in order. Events at equal times run in order of a sequence number. Each
link and each agent has its own random stream, derived from the seed and its name. So adding an
agent does not change the others' noise, and comparisons are paired. A publication is checked once
as by encoding, and the frozen message is shared. Agents run by the same driver as live ones
(`armadico.core.driver`).

As on the live mesh the robot agent's process is the router of its namespace: messages between two
other processes pass it. In a namespace that never had an owner of wheels, all processes reach each
other.

Faults: links that are slow, lossy, cut, or worse (`virtual_network`); processes that die, hang, are
slow, return or have a twin, and clocks of their own. A process that the router cannot reach for
longer than the lease counts as gone, and is found again some time after the cut has healed. To
itself it is disconnected (`presence`).
"""

from __future__ import annotations

import heapq
import random
from collections.abc import Callable, Sequence

from armadico.core.agent import Agent, Identity
from armadico.core.messages import PROTOCOL, Message
from armadico.core.outgoing import SendQuery
from armadico.core.services import keys_of, matches, service_of
from armadico.mesh.link_faults import WHOLE
from armadico.mesh.topology import DEFAULT_NAMESPACE, rooted
from armadico.mesh.virtual_device import Ports
from armadico.mesh.virtual_liveliness import LIVELINESS, Liveliness
from armadico.mesh.virtual_network import DELAYS, Clock
from armadico.mesh.virtual_node import Node
from armadico.mesh.virtual_place import CLIENT, Device, Network, Place, Route, address, guest
from armadico.mesh.virtual_queries import Queries, sendable
from armadico.mesh.virtual_star import Star

__all__ = ["LEASE", "LIVELINESS", "RECONNECT", "Device", "Node", "VirtualMesh", "address"]

LEASE = 1.0  # s without contact, by a cut or a hang, after which a process counts as gone
RECONNECT = (0.2, 0.5)  # shortest and longest pause between attempts to reconnect, s

Watcher = Callable[[str, Message, float], None]


class VirtualMesh(Network):
    """The network between the places on it, under its own clock."""

    def __init__(
        self,
        seed: int = 0,
        *,
        ties: random.Random | None = None,
        lease: float = LEASE,
    ) -> None:
        """Begin without processes.

        `ties` draws the order of events at equal times; None: as they were scheduled.
        """
        super().__init__(seed, ties)
        self.joined: Callable[[Node], None] | None = None  # called with each added node
        self.nodes: list[Node] = []  # the processes of agents
        self.liveliness = Liveliness(self, lease, RECONNECT)
        self.star = Star(self, RECONNECT)
        self.queries = Queries(self)
        self.ports = Ports(self)
        self.protocols: dict[str, int] = {}  # that the next instances of agents use, by name
        self._watchers: dict[tuple[str, type[Message]], list[Watcher]] = {}

    # Building ------------------------------------------------------------------------------------

    def identity(self, name: str, start: int = 0, namespace: str = DEFAULT_NAMESPACE) -> Identity:
        """Return the identity of an agent's `start`-th instance."""
        rng = self.stream(f"agent/{address(namespace, name)}/{start}")
        instance = f"{name}-{rng.getrandbits(64):016x}"
        protocol = self.protocols.get(name, PROTOCOL)
        return Identity(instance, "virtual", 0, "virtual", rng, protocol=protocol)

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
        """Start an agent's process now.

        A device that another process has open becomes its own once it has joined. Without `admit`
        it joins without admission. With `waits`, its agent begins only when there is a router.
        """
        node = Node(agent, self, device, clock, admit, namespace)
        node.waits = waits
        self.nodes.append(node)
        self.add_place(node)
        self.call_at(self.now, self.start, node)
        if self.joined is not None:
            self.joined(node)
        return node

    def add_place(self, place: Place) -> None:
        self.places.append(place)
        self._routes.clear()
        self.star.join(place)

    def start(self, node: Node, _: object = None) -> None:
        """Begin a node's agent if it is linked to a router and has not begun."""
        if node.alive and not node.begun and (self.star.has_router(node) or not node.waits):
            self.liveliness.introduce(node)
            node.begin()

    def keep_journals(self, head: Callable[[Agent], bytes]) -> None:
        """Let all nodes that have not begun yet, and later ones, keep a journal: `Node.pieces`."""
        self.head = head
        for node in self.nodes:
            node.keep_journal()

    def watch(
        self, watcher: Watcher, *kinds: type[Message], namespace: str = DEFAULT_NAMESPACE
    ) -> None:
        """Call a watcher with each message of these kinds when a robot's agent publishes it.

        A watcher is no participant of the mesh.
        """
        for kind in kinds:
            self._watchers.setdefault((namespace, kind), []).append(watcher)

    def node(self, name: str, namespace: str = DEFAULT_NAMESPACE) -> Node:
        """Return the newest node of an agent's name. Raises KeyError if there is none."""
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
        """Publish from outside the society, as a command-line tool does."""
        for each in [key] if key else keys_of(message, guest(sender)):
            self.spread(address(namespace, sender), each, message, None, namespace)

    def publish_bytes(self, data: bytes, key: str) -> None:
        """Publish any payload from outside the society."""
        for place, deliver, to in self.routes(DEFAULT_NAMESPACE, key):
            self.later(CLIENT, place, deliver, to, (key, data))

    def arrive(self, message: Message, name: str, key: str) -> None:
        """Deliver a late message on a key to an agent now."""
        for place, deliver, to in self.routes(DEFAULT_NAMESPACE, key):
            if place.name == name:
                self.call_at(self.now, deliver, to, (key, message))

    def routes(self, namespace: str, key: str) -> list[Route]:
        """Return the receivers of a key, in the order in which they were added."""
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
        publisher: Place | None,
        namespace: str = DEFAULT_NAMESPACE,
    ) -> str:
        """Send a publication to all receivers except its publisher.

        It takes the links of the address `sender`. A `publisher` of None is outside the society,
        and only then does `namespace` count. Returns why the message cannot be received, or an
        empty text.
        """
        namespace = namespace if publisher is None else publisher.namespace
        watchers = self._watchers.get((namespace, type(message)), ())
        routes = self.routes(namespace, key)
        if not watchers and not routes:
            return ""
        shared = sendable(message)
        if isinstance(shared, str):
            return shared
        for watcher in watchers:
            watcher(key, shared, self.now)
        if publisher is not None and publisher.lost:
            return ""
        now, links, heap, what = self.now, self._links, self._heap, (key, shared)
        star = self.star if self.star.troubled else None
        push, following = heapq.heappush, self._next
        for place, deliver, to in routes:
            if place is publisher or place.lost:
                continue
            if star is not None and publisher is not None:
                passes = star.passes(publisher, place, (deliver, to, what))
                if not passes:
                    continue
            link = links.get((sender, place.address)) or self.link(sender, place.address)
            if link.faults is WHOLE:  # as `arrival`, at half the cost
                at = now + DELAYS[int(link.rng.random() * 1024)]
                link.last = max(link.last, at)
                push(heap, (link.last, following(), deliver, to, what))
                continue
            late = link.arrival(now)
            while late is not None:
                push(heap, (late, following(), deliver, to, what))
                late = link.again(late) if link.faults.duplicate else None
        return ""

    # Queries -------------------------------------------------------------------------------------

    def query(
        self,
        request: Message,
        then: Callable[[Message | None], None],
        timeout: float = 5.0,
        namespace: str = DEFAULT_NAMESPACE,
    ) -> None:
        """Send a query from outside the society; `then` gets the first reply, or None."""
        service = service_of(type(request))
        assert service.reply is not None, f"{service.key} is not a query"
        query = SendQuery(0, service.key, request, service.reply, timeout)
        self.queries.put_first(None, query, then, namespace)

    # Faults --------------------------------------------------------------------------------------

    def cut(self, sources: Sequence[str], targets: Sequence[str], *, lease: bool = False) -> None:
        """Cut the links from some agents to others, by name (`Liveliness.cut`)."""
        self.liveliness.cut(sources, targets, lease=lease)

    def heal(self, sources: Sequence[str], targets: Sequence[str]) -> None:
        self.liveliness.heal(sources, targets)
