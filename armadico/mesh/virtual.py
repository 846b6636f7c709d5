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
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import pairwise
from math import inf
from typing import Any, Protocol, TypeGuard

from armadico.core.agent import Agent, AskFor, Identity, Publish, Subscription, Write
from armadico.core.driver import Announce, Driver, OpenPort, Output, Reply
from armadico.core.journal import Journalled
from armadico.core.mailbox import BURST_S, EVENTS, Mailbox
from armadico.core.messages import JournalPiece, Message, MessageError, checked
from armadico.core.resources import WHEELS
from armadico.core.services import Kind, matches, service_of
from armadico.mesh.presence import Presence
from armadico.mesh.topology import DEFAULT_NAMESPACE, rooted
from armadico.mesh.virtual_network import Clock, Link

LIVELINESS = 0.003
"""How long after a process is killed the others hear of it, s: the socket closes at once."""

LEASE = 1.0
"""Lease: who is unreachable for so long, s, by a cut or a hang, is taken for gone."""

RECONNECT = (0.2, 0.5)
"""How long it then takes to find each other again, s: the pauses between attempts."""

LOOK_AGAIN = 0.02
"""How often a wake-up tries whether a process that hangs or is busy can take it, s."""

ROUNDING = 1e-9
"""A wake-up this little before its time, s, by a clock of its own, is in time."""

DEVICE = "device"
"""The name of what is behind a device agent's port, as links have it."""

CLIENT = "client"
"""The name of those who publish or query from outside the society."""

Watcher = Callable[[str, Message, float], None]

Step = Callable[[Any, Any], None]
"""What happens at a time."""

Way = tuple[str, str]
"""From one agent's address to another's."""


class Device(Protocol):
    """What stands behind a device agent's port in memory: bytes and the time in, bytes out."""

    def receive(self, data: bytes, now: float) -> None:
        """Bytes from the agent."""

    def advance(self, now: float) -> bytes:
        """Live up to this time; what it says meanwhile."""

    @property
    def due(self) -> float:
        """When it next has something to say, s."""


class VirtualMesh:
    """The clock, the queue of events and the network between the places on it."""

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
        self.seed = seed
        self.now = 0.0
        self.refused: Callable[[Node], None] | None = None  # told of who may not join, or stay
        self.joined: Callable[[Node], None] | None = None  # told of each node that is added
        self.head: Callable[[Agent], bytes] | None = None  # begins the journals, if any are kept
        self.nodes: list[Node] = []  # the processes of agents,
        self.places: list[Place] = []  # and the guests' too
        self.events = 0
        self.liveliness = Liveliness(self, lease, reconnect)
        self.star = Star(self, reconnect)
        self._ties = ties
        self._heap: list[tuple[float, int, Step, Any, Any]] = []
        self._sequence = 0
        self._links: dict[Way, Link] = {}
        self._routes: dict[Way, list[Route]] = {}  # by namespace and key; made when needed
        self._watchers: dict[tuple[str, type[Message]], list[Watcher]] = {}
        self._ports: list[Port] = []
        self._queries: dict[int, Query] = {}  # that wait for replies
        self._asked = 0

    # Building ------------------------------------------------------------------------------------

    def stream(self, name: str) -> random.Random:
        """A stream of random numbers of one's own."""
        return random.Random(f"{self.seed}/{name}")

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
            self.liveliness.look(node)
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

    # Running -------------------------------------------------------------------------------------

    def run(self, until: float, stop: Callable[[], bool] | None = None) -> None:
        """Let time pass up to `until`, or until `stop` says so (asked after each event)."""
        heap, pop = self._heap, heapq.heappop
        while heap and heap[0][0] <= until:
            self.now, _, call, a, b = pop(heap)
            call(a, b)
            self.events += 1
            if stop is not None and stop():
                return
        if until < inf:
            self.now = max(self.now, until)

    def call_at(self, when: float, call: Step, a: Any = None, b: Any = None) -> None:
        """Have something called at a time."""
        heapq.heappush(self._heap, (when, self._next(), call, a, b))

    def later(self, source: Place | str, target: Place, call: Step, a: Any, b: Any = None) -> None:
        """Have something called once it has come over the network, if it does."""
        sender = source if isinstance(source, str) else source.address
        if not isinstance(source, str) and not self.star.passes(source, target, (call, a, b)):
            return
        at = self.link(sender, target.address).arrival(self.now)
        if at is not None:
            self.call_at(at, call, a, b)

    def _next(self) -> int:
        """What orders equal instants."""
        self._sequence += 1
        if self._ties is None:
            return self._sequence
        return self._ties.getrandbits(32) << 32 | self._sequence

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

    def forget_routes(self) -> None:
        self._routes.clear()

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
        self.put_first(None, asking, then, namespace)

    def put_first(
        self,
        asker: Place | None,
        ask: AskFor,
        then: Callable[[Message | None], None],
        namespace: str = DEFAULT_NAMESPACE,
    ) -> None:
        """Put a query of which the first reply counts."""

        def each(_: str, message: Message) -> bool:
            if not isinstance(message, ask.reply):
                return False
            then(message)
            return True

        self.put(asker, ask.key, ask.request, ask.timeout, each, lambda: then(None), namespace)

    def put(
        self,
        asker: Place | None,
        key: str,
        request: Message,
        timeout: float,
        each: Callable[[str, Message], bool],
        over: Callable[[], None],
        namespace: str = DEFAULT_NAMESPACE,
    ) -> None:
        """Ask everybody who answers on a key, or on the keys of a pattern."""
        self._asked += 1
        number, name, waits = self._asked, CLIENT if asker is None else asker, 0
        shared = sendable(request)
        if isinstance(shared, str):
            if asker is not None:
                asker.unsent(key, shared)
        elif asker is None or not asker.lost:
            for place in self.others(asker, namespace):
                unknown = asker is not None and not self.star.knows(asker, place)
                for one in () if place.lost or unknown else place.queried(key):
                    waits += 1
                    self.later(name, place, place.asked, one, (key, shared, number))
        self._queries[number] = Query(asker, waits, each, over)
        self.call_at(self.now + (timeout if waits else 0.0), self._over, number)

    def reply(self, place: Place, number: int, key: str, message: Message) -> None:
        query = self._queries.get(number)
        shared = sendable(message)
        if isinstance(shared, str):
            place.unsent(key, shared)
        elif query is not None and not place.lost:
            if query.asker is not None:
                self.later(place, query.asker, self._replied, number, (key, shared))
                return
            at = self.link(place.address, CLIENT).arrival(self.now)
            if at is not None:
                self.call_at(at, self._replied, number, (key, shared))

    def _replied(self, number: int, what: tuple[str, Message]) -> None:
        query = self._queries.get(number)
        if query is None:
            return
        query.waits -= 1
        if query.each(what[0], what[1]):
            del self._queries[number]
        elif not query.waits:
            self._over(number, None)

    def _over(self, number: int, _: Any) -> None:
        query = self._queries.pop(number, None)
        if query is not None:
            query.over()

    def others(self, place: Place | None, namespace: str = DEFAULT_NAMESPACE) -> list[Place]:
        """All others of a place's namespace who are alive, or of the one that is named."""
        namespace = namespace if place is None else place.namespace
        return [
            other
            for other in self.places
            if other.alive and other is not place and other.namespace == namespace
        ]

    # Faults --------------------------------------------------------------------------------------

    def link(self, source: str, target: str) -> Link:
        """The network from one agent to another, to be cut, slowed or made to lose."""
        link = self._links.get((source, target))
        if link is None:
            link = self._links[source, target] = Link(self.stream(f"link/{source}/{target}"))
        return link

    def cut(self, sources: Sequence[str], targets: Sequence[str], *, lease: bool = False) -> None:
        """What some agents publish no longer reaches others; both by name (`Liveliness.cut`)."""
        self.liveliness.cut(sources, targets, lease=lease)

    def heal(self, sources: Sequence[str], targets: Sequence[str]) -> None:
        self.liveliness.heal(sources, targets)

    # Devices -------------------------------------------------------------------------------------

    def plug(self, device: Device, node: Node) -> None:
        """A node opens a device."""
        for port in self._ports:
            if port.device is device:
                port.node = node
                return
        port = Port(device, node)
        self._ports.append(port)
        self.call_at(self.now, self._device_due, port)

    def write(self, node: Node, data: bytes) -> None:
        """Bytes for a node's device."""
        link = self.link(node.address, address(node.namespace, DEVICE))
        at = link.arrival(self.now)
        if at is not None:
            self.call_at(at, self._device_receives, node, link.spoil(data))

    def _device_receives(self, node: Node, data: bytes) -> None:
        for port in self._ports:
            if port.device is node.device:
                self._from_device(port, port.device.advance(self.now))
                port.device.receive(data, self.now)

    def _device_due(self, port: Port, _: Any) -> None:
        device = port.device
        self._from_device(port, device.advance(self.now))
        self.call_at(max(device.due, self.now + 1e-6), self._device_due, port)

    def _from_device(self, port: Port, data: bytes) -> None:
        node = port.node
        if data and node.alive:
            link = self.link(address(node.namespace, DEVICE), node.address)
            at = link.arrival(self.now)
            if at is not None:
                self.call_at(at, node.received, link.spoil(data))


class Port:
    """A device, and the node that has it open: the newest one that came with it."""

    def __init__(self, device: Device, node: Node) -> None:
        self.device = device
        self.node = node


class Query:
    def __init__(
        self,
        asker: Place | None,
        waits: int,
        each: Callable[[str, Message], bool],
        over: Callable[[], None],
    ) -> None:
        self.asker = asker  # none: somebody outside the society
        self.waits = waits  # how many may still reply
        self.each = each  # takes a reply; whether that is enough
        self.over = over  # told that there will be no more


class Place:
    """A process on the mesh, as the network sees it."""

    def __init__(self, mesh: VirtualMesh, namespace: str, name: str) -> None:
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
            self.mesh.call_at(due, self._look, due)

    def _look(self, due: float, _: Any) -> None:
        if due == self._look_at:
            self._look_at = inf
            if self.alive:
                self.presence.look(self.mesh.now)
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

    def show(self, name: str, instance: str) -> None:
        self.tokens.append((name, instance))
        self.mesh.liveliness.join(self, name, instance)

    def kill(self) -> None:
        """SIGKILL: it publishes nothing more, and its tokens go."""
        self.alive = False
        self.mesh.forget_routes()
        self.mesh.liveliness.killed(self)


Route = tuple[Place, Step, Any]
"""Who receives, what takes it, and as what."""


class Node(Place):
    """An agent's process: its driver, and what makes it hang, slow or wrong about the time.

    Without a clock of its own it takes the mesh's time for its own.
    """

    def __init__(
        self,
        agent: Agent,
        mesh: VirtualMesh,
        device: Device | None,
        clock: Clock | None,
        admit: bool,
        namespace: str,
    ) -> None:
        self.agent = agent
        super().__init__(mesh, namespace, agent.name)
        self.device = device
        self.clock = clock
        self.mailbox: Mailbox[Callable[[], None]] = Mailbox()
        self.waits = True  # for a router, before its agent begins
        self.hangs = 0
        self.work_s = 0.0  # for each delivery: what else it would have been through at once
        self._busy = False
        self._worked = 0  # deliveries since its last wake-up, or since nothing waited
        self._wake_due: float | None = None
        self._admit = admit
        self.begun = False
        self.driver = Driver(agent, self.time, admit=admit)
        self.keep_journal()

    @property
    def is_router(self) -> bool:
        return WHEELS in self.agent.owns

    def keep_journal(self) -> None:
        """From its beginning, if it has not begun and the mesh has somebody read it."""
        head = self.mesh.head
        if head is not None and not self.begun:
            told = head(self.agent)
            self.driver = Journalled(
                self.agent, self.time, told, admit=self._admit, publishes=False
            )

    def pieces(self) -> list[JournalPiece]:
        """What its journal has come to since this was last asked; nothing if it keeps none."""
        return self.driver.pieces() if isinstance(self.driver, Journalled) else []

    @property
    def time(self) -> float:
        """What it takes for the time, s."""
        now = self.mesh.now
        return now if self.clock is None else self.clock.read(now)

    def begin(self) -> None:
        self.begun = True
        self.driver.begin(self.time)
        self._drain()

    # Faults --------------------------------------------------------------------------------------

    def leave(self) -> None:
        """SIGTERM: it lets go of what it holds, and ends."""
        self.driver.leave(self.time)
        self._send(self.driver.take())
        self.kill()

    def hang(self) -> None:
        """SIGSTOP: what arrives waits, its token stays for the lease."""
        if not self.hung:
            self.hung = True
            self.mesh.liveliness.hung(self)

    def resume(self) -> None:
        """SIGCONT: everything that waited arrives in a burst."""
        self.hung = False
        self._flush()
        self.mesh.liveliness.woken(self)
        self.mesh.star.woken(self)

    def slow_down(self, work_s: float) -> None:
        """It needs so long for each delivery from now on, s; 0 is as fast as ever."""
        self.work_s = work_s
        if not work_s and not self._busy:
            self._flush()

    def jump(self, ahead: float) -> None:
        """Its clock shows so much more at once, s."""
        self._own_clock().jump(ahead)
        self._mind_wakeup(anew=True)

    def drift(self, rate: float) -> None:
        """Its clock runs so many times as fast as it should from now on."""
        self._own_clock().drift(self.mesh.now, rate)
        self._mind_wakeup(anew=True)

    def _own_clock(self) -> Clock:
        if self.clock is None:
            self.clock = Clock()
        return self.clock

    # What arrives --------------------------------------------------------------------------------

    def listeners(self) -> list[tuple[str, Step, Any]]:
        return [(to.pattern, self._deliver, to) for to in self.agent.subscriptions()]

    def _deliver(self, to: Subscription, what: tuple[str, Message | bytes]) -> None:
        if not self.alive:
            return
        key, message = what
        if self._waits():
            keep = 1 if to.kind is Kind.STATE else EVENTS
            self._hand(lambda: self.driver.deliver(to, key, message, self.time), key, keep)
            return
        driver = self.driver
        driver.deliver(to, key, message, self.mesh.now if self.clock is None else self.time)
        out = driver.take()
        if out:
            self._send(out)
        wanted, due = driver.wakeup, self._wake_due
        if wanted is not None and (due is None or self.clock is not None or wanted < due):
            self._mind_wakeup()

    def queried(self, pattern: str) -> list[Any]:
        return [key for key in self.driver.queries if matches(pattern, key)]

    def asked(self, one: Any, what: tuple[str, Message, int]) -> None:
        _, request, number = what
        self._hand(lambda: self.driver.asked(one, request, number, self.time), f"query/{one}")

    def tell(self, name: str, instance: str, alive: bool) -> None:
        self._hand(
            lambda: self.driver.token(name, instance, alive, self.time), f"token/{instance}", 1
        )

    def tell_router(self, there: bool) -> None:
        if self.begun:
            self._hand(lambda: self.driver.router(there, self.time), "router", 1)
        else:
            self.driver.router(there, self.time)

    def received(self, data: bytes, _: Any) -> None:
        """Take bytes from the device."""
        self._hand(lambda: self.driver.received(data, self.time), "device")

    def _replied(self, number: int, message: Message | None) -> None:
        self._hand(lambda: self.driver.replied(number, message, self.time), f"reply/{number}")

    def _hand(self, deliver: Callable[[], None], lane: str, keep: int = EVENTS) -> None:
        """Deliver something, or keep it in a lane while it hangs or is busy."""
        if not self.alive:
            return
        if self._waits():
            self.mailbox.put(lane, lambda: self._through(deliver), keep)
            self._work()
        else:
            self._through(deliver)

    def _waits(self) -> bool:
        """Whether what arrives must wait: nothing overtakes what waits already."""
        return self.hung or bool(self.work_s) or self._busy or bool(self.mailbox)

    def _through(self, deliver: Callable[[], None]) -> None:
        if self.alive:
            deliver()
            self._drain()

    def _flush(self) -> None:
        while not self.hung and not self._busy and (item := self.mailbox.take()):
            item()
        self._own_up()

    def _work(self) -> None:
        """A slow process takes one thing after another; what it sends comes at the end of each."""
        while not (self._busy or self.hung) and (item := self.mailbox.take()):
            self._worked += 1
            item()
        if not self._busy:
            self._worked = 0
        self._own_up()

    def _own_up(self) -> None:
        """Have the agent report what its mailbox had no room for, as a process does."""
        if self.hung or self._busy or not self.alive:
            return
        if dropped := self.mailbox.take_dropped():
            self.driver.report(dropped, self.time)
            self._send(self.driver.take())

    def _has_worked(self, out: list[Output], _: Any) -> None:
        self._busy = False
        if self.hung:  # it goes on where it was
            self.mailbox.put("worked", lambda: self._send(out))
        elif self.alive:
            self._send(out)
            wanted = self.driver.wakeup
            worked_s = (self._worked - 1) * self.work_s
            if wanted is not None and self.time >= wanted and worked_s >= BURST_S:
                self._wake(self._wake_due or 0.0, None)
            if self.work_s:
                self._work()
            else:
                self._flush()
            self._mind_wakeup()

    # What is sent --------------------------------------------------------------------------------

    def _drain(self) -> None:
        """Send what the agent has put into its outbox, at once or when its work is done."""
        out = self.driver.take()
        if self.work_s and self.alive:
            self._busy = True
            self.mesh.call_at(self.mesh.now + self.work_s, self._has_worked, out)
            return
        if out:
            self._send(out)
        self._mind_wakeup()
        if self.driver.refusal and self.alive:
            if self.mesh.refused is not None:
                self.mesh.refused(self)
            self.leave()

    def _send(self, out: list[Output]) -> None:
        for item in out:
            if type(item) is Publish:
                why = self.mesh.spread(self.address, item.key, item.message, self)
                if why:
                    self.unsent(item.key, why)
            elif isinstance(item, Write):
                self.mesh.write(self, item.data)
            elif isinstance(item, AskFor):
                self._ask(item)
            elif isinstance(item, Reply):
                self.mesh.reply(self, item.call, item.key, item.message)
            elif isinstance(item, Announce):
                self.show(self.name, self.agent.instance)
            elif isinstance(item, OpenPort) and self.device is not None:
                self.mesh.plug(self.device, self)
                self.driver.link(True, "", self.time)
                self._drain()

    def _ask(self, item: AskFor) -> None:
        self.mesh.put_first(self, item, lambda message: self._replied(item.id, message))

    def unsent(self, key: str, why: str) -> None:
        """See `Place`: the agent says so."""
        self.driver.refuse(key, why, self.time)
        self._send(self.driver.take())

    # Wake-ups ------------------------------------------------------------------------------------

    def _mind_wakeup(self, *, anew: bool = False) -> None:
        """See that it is woken when the agent wants it; `anew`: its clock has changed."""
        if anew:
            self._wake_due = None
        wanted = self.driver.wakeup
        if wanted is None or not self.alive:
            return
        due = wanted if self.clock is None else self.clock.when(wanted)
        if self._wake_due is None or due < self._wake_due:
            self._wake_due = due
            self.mesh.call_at(max(due, self.mesh.now), self._wake, due)

    def _wake(self, due: float, _: Any) -> None:
        if self._wake_due != due:
            return  # an earlier one took its place
        self._wake_due = None
        if not self.alive:
            return
        if self.hung or self._busy:
            self._wake_due = self.mesh.now + LOOK_AGAIN
            self.mesh.call_at(self._wake_due, self._wake, self._wake_due)
            return
        now, wanted = self.time, self.driver.wakeup
        if wanted is not None and now < wanted < now + ROUNDING:
            now = wanted
        self._worked = 0
        self.driver.wake(now)
        self._drain()


class Star:
    """Who is linked to which router: what two say to each other passes it.

    The router is the process of the newest robot agent whose predecessor is gone. While it hangs
    what others say waits in it; when it is gone they are cut off, from each other too, and look for
    the next one again and again.
    """

    def __init__(self, mesh: VirtualMesh, reconnect: tuple[float, float]) -> None:
        self.troubled = False  # whether anything has gone wrong yet: before, all reach all
        self._mesh = mesh
        self._reconnects = reconnect
        self._rng = mesh.stream("star")
        self._routers: dict[str, Node] = {}  # by namespace
        self._held: dict[Node, list[tuple[Place, Place, tuple[Step, Any, Any]]]] = {}
        self._seeking: set[Place] = set()  # that will try to link

    def router(self, namespace: str) -> Node | None:
        """The router of a namespace, alive or not; None if there never was one."""
        return self._routers.get(namespace)

    def has_router(self, place: Place) -> bool:
        """Whether a place is linked to a router, is one, or needs none."""
        return place.uplink is not place or self._routers.get(place.namespace) is place

    def knows(self, place: Place, other: Place) -> bool:
        """Whether a place knows of another of its namespace, as far as routers tell it."""
        return not self.troubled or place.uplink is other.uplink

    def is_link(self, way: Way) -> bool:
        """Whether there is a link between two addresses, and not only a way by routers."""
        if any(each.rpartition("/")[2] == DEVICE for each in way):
            return True
        ends = [self._routers.get(_namespace(each)) for each in way]
        if ends[0] is ends[1]:
            return ends[0] is None or ends[0].address in way
        return all(end is None or end.address == each for end, each in zip(ends, way, strict=True))

    def join(self, place: Place) -> None:
        """Somebody starts: with whom it is linked."""
        router = self._routers.get(place.namespace)
        if _can_route(place) and (router is None or not router.alive):
            self._lead(place)
        elif router is None:
            pass  # everybody reaches everybody
        elif self._reaches(place, router):
            place.uplink = router
        else:
            self.troubled = True
            place.uplink = place
            place.presence.link(False, self._mesh.now)
            self._seek(place)

    # What passes ---------------------------------------------------------------------------------

    def passes(self, source: Place, target: Place, what: tuple[Step, Any, Any]) -> bool:
        """Whether something passes now; it waits if a router between the two hangs."""
        if not self.troubled:
            return True
        routers = self._between(source, target)
        hung = next((router for router in routers or () if router.hung), None)
        if hung is not None:
            self._held.setdefault(hung, []).append((source, target, what))
        return routers is not None and hung is None

    def delays(self, source: Place, target: Place) -> bool:
        """Whether a router between the two hangs, so that news of one's end comes later."""
        return any(router.hung for router in self._between(source, target) or ())

    def _between(self, source: Place, target: Place) -> list[Node] | None:
        """The routers by which one reaches another; None if it does not."""
        if source.namespace == target.namespace:
            router = source.uplink
            if router is not target.uplink:
                return None
            if not isinstance(router, Node) or router is source or router is target:
                return []
            routers = [router]
        else:
            routers = []
            for place in (source, target):
                router = self._routers.get(place.namespace)
                if router is not None and place.uplink is not router:
                    return None
                routers += [] if router is None else [router]
        way = [source, *routers, target]
        for one, other in pairwise(way):
            if one is not other and not self._mesh.link(one.address, other.address).up:
                return None
        between = [router for router in routers if router is not source and router is not target]
        return between if all(router.alive for router in between) else None

    # Losing a router, and finding it -------------------------------------------------------------

    def lose(self, router: Node, _: Any = None) -> None:
        """A router is gone, or hangs for longer than the lease: all are cut off."""
        self.troubled = True
        self._held.pop(router, None)
        others = self._mesh.others(router)
        for place in others:
            if place.uplink is router:
                self.cut_off(place)
        if router.alive:
            return
        for place in others:
            self._mesh.liveliness.gone(place, router)
        if self._routers[router.namespace] is router:
            second = next((place for place in others if _can_route(place)), None)
            if second is not None:  # its process would not have come up, and is started anew
                self._lead(second)

    def cut_off(self, place: Place) -> None:
        """A place has lost its router: it reaches only itself."""
        self.troubled = True
        place.uplink = place
        place.presence.link(False, self._mesh.now)
        self._seek(place)

    def woken(self, node: Node) -> None:
        """A process goes on: so does what has waited in it, and those find it that it has lost."""
        router = self._routers.get(node.namespace)
        if router is not node:
            if router is not None and node.uplink is not router:
                self._seek(node)
            return
        for source, target, what in self._held.pop(node, ()):
            self._mesh.later(source, target, *what)
        for place in self._mesh.others(node):
            if place.uplink is not node:
                self._seek(place)

    def reach(self, place: Place) -> None:
        """A place links to its router again, at once if it can."""
        router = self._routers.get(place.namespace)
        if router is None or place.uplink is router or not place.alive:
            return
        if self._reaches(place, router):
            self._link(place, router)
        else:
            self._seek(place)

    def _lead(self, router: Node) -> None:
        """A process is the router of its namespace from now on."""
        self._routers[router.namespace] = router.uplink = router
        for place in self._mesh.others(router):
            if place.uplink is None:
                place.uplink = router
            else:
                self._seek(place)

    def _seek(self, place: Place) -> None:
        """Try to reach the router some time later."""
        if place not in self._seeking:
            self._seeking.add(place)
            at = self._mesh.now + self._rng.uniform(*self._reconnects)
            self._mesh.call_at(at, self._try, place)

    def _try(self, place: Place, _: Any) -> None:
        self._seeking.discard(place)
        if self._works(self._routers[place.namespace]) and not place.hung:
            self.reach(place)  # else it is woken, or replaced

    def _link(self, place: Place, router: Node) -> None:
        place.uplink = router
        place.presence.link(True, self._mesh.now)
        place.mind_presence()
        liveliness = self._mesh.liveliness
        liveliness.look(place)
        for name, instance in place.tokens:
            liveliness.join(place, name, instance)
        if isinstance(place, Node):
            self._mesh.start(place)

    def _reaches(self, place: Place, router: Node) -> bool:
        ready = self._works(router) and not place.hung and not place.lost
        return ready and not self._is_cut(place, router)

    def _works(self, router: Node) -> bool:
        return router.alive and not router.hung and not router.lost

    def _is_cut(self, place: Place, router: Node) -> bool:
        there, back = (place.address, router.address), (router.address, place.address)
        return not (self._mesh.link(*there).up and self._mesh.link(*back).up)


def _can_route(place: Place) -> TypeGuard[Node]:
    return isinstance(place, Node) and place.is_router


class Liveliness:
    """Who is alive, as each sees it: tokens, leases, cuts and hangs, as Zenoh has them.

    A process that is killed is missed at once: its socket closes. One that is cut off or hangs is
    missed when its lease runs out; to itself it is cut off from then on. Some time after the cut
    has healed, or it has woken, it is linked again.
    """

    def __init__(self, mesh: VirtualMesh, lease: float, reconnect: tuple[float, float]) -> None:
        self._mesh = mesh
        self._lease = lease
        self._reconnects = reconnect
        self._rng = mesh.stream("presence")
        self._cuts: Counter[Way] = Counter()
        self._parted: set[frozenset[str]] = set()  # names whose connection's lease ran out

    def look(self, place: Place) -> None:
        """A process has joined: it is told who is alive."""
        for other in self._mesh.others(place):
            if not other.lost:
                self._show(other, place)

    def join(self, place: Place, name: str, instance: str) -> None:
        """A process declares its token: the others are told."""
        for other in self._mesh.others(place):
            if not other.lost:
                self._tell_of(place, other, name, instance)

    def killed(self, place: Place) -> None:
        """A process is gone: who reached it sees its socket close, the others its lease end."""
        star = self._mesh.star
        router = star.router(place.namespace)
        if router is place:
            star.troubled = True
            self._mesh.call_at(self._mesh.now + LIVELINESS, star.lose, place)
            return
        for other in self._mesh.others(place):
            by = other if router is None else router
            reached = self._mesh.link(place.address, by.address).up and not place.lost
            at = self._mesh.now + (LIVELINESS if reached else self._lease)
            self._mesh.call_at(at, self._missed, other, place)

    # Hangs ---------------------------------------------------------------------------------------

    def hung(self, node: Node) -> None:
        """A node hangs from now on."""
        node.hangs += 1
        self._mesh.star.troubled = True
        self._mesh.call_at(self._mesh.now + self._lease, self._hung_for_long, node, node.hangs)

    def woken(self, node: Node) -> None:
        """It is back, and has dealt with what waited for it; tell it what it has lost meanwhile."""
        if not node.lost:
            return
        router = self._mesh.star.router(node.namespace)
        if router is None or router is node:
            for other in self._mesh.others(node):
                self.gone(node, other)
        else:
            self._mesh.star.cut_off(node)
        if router is None:
            at = self._mesh.now + self._rng.uniform(*self._reconnects)
            self._mesh.call_at(at, self._found, node, node.hangs)
        else:
            node.lost = False

    def _hung_for_long(self, node: Node, hang: int) -> None:
        if node.alive and node.hung and node.hangs == hang:
            node.lost = True
            if self._mesh.star.router(node.namespace) is node:
                self._mesh.star.lose(node)
                return
            for other in self._mesh.others(node):
                self._missed(other, node)

    def _found(self, node: Node, hang: int) -> None:
        """It is linked again, where there is no router."""
        if node.alive and not node.hung and node.hangs == hang:
            node.lost = False
            self.look(node)
            for name, instance in node.tokens:
                self.join(node, name, instance)

    # Cuts ----------------------------------------------------------------------------------------

    def cut(self, sources: Iterable[str], targets: Iterable[str], *, lease: bool) -> None:
        """What sources publish no longer reaches targets, by names.

        With a `lease` the connection ends both ways when it runs out, as TCP's does; without,
        nobody ever notices but by the silence. A cut between two that have no link, because a
        router is between them, does nothing.
        """
        self._mesh.star.troubled = True
        for way in _ways(sources, targets):
            self._cuts[way] += 1
            if self._mesh.star.is_link(way):
                self._mesh.link(*way).up = False
            if lease:
                at = self._mesh.now + self._lease
                self._mesh.call_at(at, self._cut_for_long, way, self._cuts[way])

    def heal(self, sources: Iterable[str], targets: Iterable[str]) -> None:
        wait = self._rng.uniform(*self._reconnects)
        for way in _ways(sources, targets):
            self._cuts[way] -= 1
            if self._cuts[way]:
                continue
            if frozenset(way) in self._parted:
                self._mesh.call_at(self._mesh.now + wait, self._reconnect, way)
            else:
                self._mesh.link(*way).up = True
                for place, other in self._pairs(frozenset(way)):
                    self._catch_up(place, other)

    def _catch_up(self, place: Place, other: Place) -> None:
        """A link was cut for less than the lease: tokens that came meanwhile come now."""
        router = self._mesh.star.router(place.namespace)
        if router is None and not (place.lost or other.lost):
            self._show(other, place)
        elif other is router and place.uplink is router:
            self.look(place)
            for name, instance in place.tokens:
                self.join(place, name, instance)

    def _cut_for_long(self, way: Way, _: Any) -> None:
        """Part them, if they are still cut; one that was cut anew meanwhile is parted early."""
        pair = frozenset(way)
        if not self._cuts[way] or pair in self._parted:
            return
        self._parted.add(pair)
        if self._mesh.star.is_link(way):
            self._both_ways(way, up=False)
        for place, other in self._pairs(pair):
            router = self._mesh.star.router(place.namespace)
            if router is None:
                self.gone(place, other)
            elif other is router and place.uplink is router:
                self._mesh.star.cut_off(place)
                # Those that are cut off at this instant, too, do not miss each other.
                self._mesh.call_at(self._mesh.now + LIVELINESS, self._parted_from, place)

    def _parted_from(self, place: Place, _: Any) -> None:
        """A place is cut off: those that are still linked to the router miss it."""
        for other in self._mesh.others(place):
            self._missed(other, place)

    def _reconnect(self, way: Way, _: Any) -> None:
        pair = frozenset(way)
        if self._cuts[way] or self._cuts[way[1], way[0]] or pair not in self._parted:
            return
        self._parted.remove(pair)
        self._both_ways(way, up=True)
        for place, other in self._pairs(pair):
            router = self._mesh.star.router(place.namespace)
            if router is None and other.alive and not (place.lost or other.lost):
                self._show(other, place)
            elif other is router:
                self._mesh.star.reach(place)

    def _pairs(self, pair: frozenset[str]) -> Iterator[tuple[Place, Place]]:
        """Places that are alive and others, by the addresses of both, either way round."""
        for place in self._mesh.places:
            for other in self._mesh.places:
                if place.alive and place is not other and {place.address, other.address} == pair:
                    yield place, other

    def _both_ways(self, way: Way, *, up: bool) -> None:
        self._mesh.link(way[0], way[1]).up = self._mesh.link(way[1], way[0]).up = up

    # Telling -------------------------------------------------------------------------------------

    def _show(self, place: Place, other: Place) -> None:
        """One's tokens come to another; those of another robot's nobody looks for."""
        if place.namespace != other.namespace:
            return
        for name, instance in place.tokens:
            self._tell_of(place, other, name, instance)

    def _tell_of(self, place: Place, other: Place, name: str, instance: str) -> None:
        self._mesh.later(place, other, self._appear, other, (name, instance))

    def _appear(self, place: Place, what: tuple[str, str]) -> None:
        if place.alive:
            place.see(*what, True)

    def _missed(self, place: Place, other: Place) -> None:
        """The tokens of another go; a router that hangs between the two reports it afterwards."""
        if self._mesh.star.delays(other, place):
            self._mesh.call_at(self._mesh.now + LOOK_AGAIN, self._missed, place, other)
        else:
            self.gone(place, other)

    def gone(self, place: Place, other: Place) -> None:
        """One sees the tokens of another go."""
        if place.namespace != other.namespace:
            return
        for name, instance in other.tokens:
            place.see(name, instance, False)


def address(namespace: str, name: str) -> str:
    """What a process is called among all robots': by its name alone where there is one robot."""
    return name if namespace == DEFAULT_NAMESPACE else f"{namespace}/{name}"


def _namespace(address: str) -> str:
    """The namespace of a process, by its address."""
    return address.rpartition("/")[0] or DEFAULT_NAMESPACE


def _ways(sources: Iterable[str], targets: Iterable[str]) -> list[Way]:
    there = tuple(targets)
    return [(source, target) for source in sources for target in there if source != target]


def sendable(message: Message) -> Message | str:
    """The message as the others receive it, or why they cannot."""
    try:
        return checked(message)
    except MessageError as error:
        return str(error)
