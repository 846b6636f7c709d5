"""The virtual mesh: a whole society in one thread, under a virtual clock, from one seed.

Computation takes no virtual time. Deliveries take delays drawn from the distribution measured on
the live mesh, never zero, or the same agent would always be first; what one process sends to
another arrives in order. Equal instants run in order of a sequence number. Each link and each
agent draws from its own stream, derived from the seed and its name, so adding an agent leaves the
others' noise as it was and comparisons are paired. A publication is checked once as the wire would,
and shared frozen. Agents are run by the same driver as live ones (`armadico.core.driver`).

Faults: links that are slow, lossy, cut, or worse (`virtual_network`); processes that die, hang, are
slow, return or have a twin, and clocks of their own. Who is out of reach for longer than the lease
is taken for gone, and found again some time after the cut has healed, as on the live mesh.
"""

from __future__ import annotations

import heapq
import random
from collections.abc import Callable, Sequence
from typing import Any

from armadico.core.agent import Agent, AskFor, Identity, Publish, Subscription, Write
from armadico.core.driver import Announce, OpenPort, Output, Reply, sendable
from armadico.core.mailbox import EVENTS
from armadico.core.messages import Message
from armadico.core.services import Kind, matches, service_of
from armadico.mesh.virtual_liveliness import LEASE, RECONNECT, Presence
from armadico.mesh.virtual_network import Clock, Link
from armadico.mesh.virtual_node import Device, Node, Port
from armadico.mesh.virtual_queries import Questions

BURST = 1024
"""After so many deliveries a slow process's wake-up fires, whatever else waits."""

LOOK_AGAIN = 0.02
"""How often a wake-up tries whether a process that hangs or is busy can take it, s."""

ROUNDING = 1e-9
"""A wake-up this little before its time, s, by a clock of its own, is in time."""

Watcher = Callable[[str, Message, float], None]
Route = tuple[Subscription, Node]


class VirtualMesh:
    """The clock, the queue of events and the network between the nodes."""

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
        self._ties = ties
        self.nodes: list[Node] = []
        self.events = 0
        self._heap: list[tuple[float, int, Callable[[Any, Any], None], Any, Any]] = []
        self._sequence = 0
        self._links: dict[tuple[str, str], Link] = {}
        self._routes: dict[str, tuple[Route, ...]] = {}  # by key, who listens; made when needed
        self._watchers: dict[type[Message], list[Watcher]] = {}
        self.joined: Callable[[Node], None] | None = None  # told of each node that is added
        self._ports: list[Port] = []
        self._presence = Presence(self, lease, reconnect)
        self._questions = Questions(self)

    # Building ------------------------------------------------------------------------------------

    def stream(self, name: str) -> random.Random:
        """A stream of random numbers of one's own."""
        return random.Random(f"{self.seed}/{name}")

    def identity(self, name: str, start: int = 0) -> Identity:
        """Who the `start`-th instance of an agent is."""
        rng = self.stream(f"agent/{name}/{start}")
        return Identity(f"{name}-{rng.getrandbits(64):016x}", "virtual", 0, "virtual", rng)

    def add(
        self,
        agent: Agent,
        device: Device | None = None,
        clock: Clock | None = None,
        *,
        admit: bool = True,
    ) -> Node:
        """A process starts, now; a device that another had open is its own once it has joined.

        Without `admit` it joins at once, whoever is alive.
        """
        node = Node(agent, self, clock, admit=admit)
        node.device = device
        self.nodes.append(node)
        self._routes.clear()
        self.call_at(self.now, self._start, node)
        if self.joined is not None:
            self.joined(node)
        return node

    def watch(self, watcher: Watcher, *kinds: type[Message]) -> None:
        """Be shown every message of these kinds the moment it is published, without being heard."""
        for kind in kinds:
            self._watchers.setdefault(kind, []).append(watcher)

    def call_at(
        self, when: float, call: Callable[[Any, Any], None], a: Any = None, b: Any = None
    ) -> None:
        """Have something called at a time."""
        heapq.heappush(self._heap, (when, self._next(), call, a, b))

    def _next(self) -> int:
        """What orders equal instants."""
        self._sequence += 1
        if self._ties is None:
            return self._sequence
        return self._ties.getrandbits(32) << 32 | self._sequence

    def publish(self, message: Message, sender: str = "client", key: str | None = None) -> None:
        """Publish something from outside the society, as a command-line tool would."""
        self._publish(sender, Publish(key or service_of(type(message)).key, message))

    def publish_bytes(self, data: bytes, key: str, sender: str = "client") -> None:
        """Publish a payload, whatever it is, from outside the society."""
        for route in self._listeners(key):
            at = self.link(sender, route[1].name).arrival(self.now)
            if at is not None:
                self.call_at(at, self._deliver, route, (key, data))

    def arrive(self, message: Message, name: str, key: str) -> None:
        """Have something arrive, now, that was published on a key for an agent long ago."""
        for route in self._listeners(key):
            if route[1].name == name:
                self.call_at(self.now, self._deliver, route, (key, message))

    def ask(
        self,
        request: Message,
        then: Callable[[Message | None], None],
        timeout: float = 5.0,
    ) -> None:
        """Put a query from outside the society."""
        service = service_of(type(request))
        assert service.reply is not None, f"{service.key} is not a query"
        ask = AskFor(0, service.key, request, service.reply, timeout)
        self._questions.put(None, ask, then)

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
        self.now = max(self.now, until)

    def node(self, name: str) -> Node:
        """The newest node of an agent's name. Raises KeyError if there is none."""
        for node in reversed(self.nodes):
            if node.name == name:
                return node
        raise KeyError(name)

    # Faults --------------------------------------------------------------------------------------

    def link(self, source: str, target: str) -> Link:
        """The network from one agent to another, to be cut, slowed or made to lose."""
        link = self._links.get((source, target))
        if link is None:
            link = self._links[source, target] = Link(self.stream(f"link/{source}/{target}"))
        return link

    def kill(self, node: Node) -> None:
        """End a process without a word."""
        node.alive = False
        self._routes.clear()
        self._presence.killed(node)

    def leave(self, node: Node) -> None:
        """Have a process end in order."""
        node.driver.leave(node.time)
        self._send(node, node.driver.take())
        self.kill(node)

    def hang(self, node: Node) -> None:
        """Stop a process; what arrives waits for it."""
        if not node.hung:
            node.hung = True
            self._presence.hung(node)

    def resume(self, node: Node) -> None:
        """Let a process go on, with all that waited for it."""
        node.hung = False
        self.flush(node)
        self._presence.woken(node)

    def slow_down(self, node: Node, work_s: float) -> None:
        """Have a process need so long for each delivery, s; 0 is as fast as ever."""
        node.work_s = work_s
        if not work_s and not node.busy:
            self.flush(node)

    def cut(self, sources: Sequence[str], targets: Sequence[str], *, lease: bool = False) -> None:
        """What some agents publish no longer reaches others; both by name (`Presence.cut`)."""
        self._presence.cut(sources, targets, lease=lease)

    def heal(self, sources: Sequence[str], targets: Sequence[str]) -> None:
        """Undo a cut."""
        self._presence.heal(sources, targets)

    def unsent(self, node: Node | None, key: str, why: str) -> None:
        """Have an agent say that something was not sent; None is a client, who says nothing."""
        if node is not None:
            node.driver.refuse(key, why, node.time)
            self._send(node, node.driver.take())

    def flush(self, node: Node) -> None:
        """Hand a node what waited for it."""
        while not node.hung and not node.busy and (item := node.mailbox.take()):
            item()
        self._own_up(node)

    # Inside --------------------------------------------------------------------------------------

    def _start(self, node: Node, _: Any) -> None:
        if node.alive:
            self._presence.look(node)
            node.driver.begin(node.time)
            self._drain(node)

    def later(self, source: str, node: Node, call: Callable[[Any, Any], None], what: Any) -> None:
        """Have something happen to a node once it has come over the network from a source."""
        at = self.link(source, node.name).arrival(self.now)
        if at is not None:
            self.call_at(at, call, node, what)

    def hand(self, node: Node, deliver: Callable[[], None], lane: str, keep: int = EVENTS) -> None:
        """Deliver something, or keep it in a lane while the node hangs or is busy."""
        if not node.alive:
            return
        if self._waits(node):
            node.mailbox.put(lane, lambda: self._through(node, deliver), keep)
            self._work(node)
        else:
            self._through(node, deliver)

    @staticmethod
    def _waits(node: Node) -> bool:
        """Whether what arrives must wait: nothing overtakes what waits already."""
        return node.hung or bool(node.work_s) or node.busy or bool(node.mailbox)

    def _through(self, node: Node, deliver: Callable[[], None]) -> None:
        if node.alive:
            deliver()
            self._drain(node)

    def _deliver(self, route: Route, what: tuple[str, Message | bytes]) -> None:
        to, node = route
        if not node.alive:
            return
        key, message = what
        if self._waits(node):
            keep = 1 if to.kind is Kind.STATE else EVENTS
            self.hand(node, lambda: node.driver.deliver(to, key, message, node.time), key, keep)
            return
        driver = node.driver
        driver.deliver(to, key, message, self.now if node.clock is None else node.time)
        out = driver.take()
        if out:
            self._send(node, out)
        wanted, due = driver.wakeup, node.wake_due
        if wanted is not None and (due is None or node.clock is not None or wanted < due):
            self.mind_wakeup(node)

    def _work(self, node: Node) -> None:
        """A slow process takes one thing after another; what it sends comes at the end of each."""
        while not (node.busy or node.hung) and (item := node.mailbox.take()):
            node.worked += 1
            item()
        self._own_up(node)

    def _own_up(self, node: Node) -> None:
        """Have an agent say what its mailbox had no room for, as a process does."""
        if node.hung or node.busy or not node.alive:
            return
        if dropped := node.mailbox.take_dropped():
            node.driver.report(dropped, node.time)
            self._send(node, node.driver.take())

    def _worked(self, node: Node, out: list[Output]) -> None:
        node.busy = False
        if node.hung:  # it goes on where it was
            node.mailbox.put("worked", lambda: self._send(node, out))
        elif node.alive:
            self._send(node, out)
            if node.worked >= BURST:
                self._wake(node, node.wake_due or 0.0)
            if node.work_s:
                self._work(node)
            else:
                self.flush(node)
            self.mind_wakeup(node)

    def _drain(self, node: Node) -> None:
        """Send what an agent has put into its outbox, at once or when its work is done."""
        out = node.driver.take()
        if node.work_s and node.alive:
            node.busy = True
            self.call_at(self.now + node.work_s, self._worked, node, out)
            return
        if out:
            self._send(node, out)
        self.mind_wakeup(node)
        if node.driver.refusal and node.alive:
            if self.refused is not None:
                self.refused(node)
            self.leave(node)

    def _send(self, node: Node, out: list[Output]) -> None:
        for item in out:
            if type(item) is Publish:
                self._publish(node.name, item, node)
            elif isinstance(item, Write):
                self._later_device(node, item.data)
            elif isinstance(item, AskFor):
                self._questions.put(node, item)
            elif isinstance(item, Reply):
                self._questions.answer(node, item)
            elif isinstance(item, Announce):
                node.announced = True
                self._presence.join(node)
            elif isinstance(item, OpenPort) and node.device is not None:
                self._plug(node.device, node)
                node.driver.link(True, "", node.time)
                self._drain(node)

    def _listeners(self, key: str) -> tuple[Route, ...]:
        """Who listens on a key, in the order in which they were added."""
        routes = self._routes.get(key)
        if routes is None:
            routes = self._routes[key] = tuple(
                (to, node)
                for node in self.nodes
                if node.alive
                for to in node.agent.subscriptions()
                if matches(to.pattern, key)
            )
        return routes

    def _publish(self, sender: str, item: Publish, speaker: Node | None = None) -> None:
        """Send to everybody but the speaker, to another instance of the same agent too."""
        key = item.key
        watchers = self._watchers.get(type(item.message), ())
        routes = self._listeners(key)
        if not watchers and not routes:
            return
        shared = sendable(item)
        if isinstance(shared, str):
            self.unsent(speaker, key, shared)
            return
        for watcher in watchers:
            watcher(key, shared, self.now)
        if speaker is not None and speaker.lost:
            return
        now, links, what = self.now, self._links, (key, shared)
        for route in routes:
            node = route[1]
            if node is speaker or node.lost:
                continue
            link = links.get((sender, node.name)) or self.link(sender, node.name)
            at = link.arrival(now)
            while at is not None:
                heapq.heappush(self._heap, (at, self._next(), self._deliver, route, what))
                at = link.again(at) if link.faults.duplicate else None

    def mind_wakeup(self, node: Node, *, anew: bool = False) -> None:
        """See that a node is woken when its agent wants it; `anew`: its clock has changed."""
        if anew:
            node.wake_due = None
        wanted = node.driver.wakeup
        if wanted is None or not node.alive:
            return
        due = node.when(wanted)
        if node.wake_due is None or due < node.wake_due:
            node.wake_due = due
            self.call_at(max(due, self.now), self._wake, node, due)

    def _wake(self, node: Node, due: float) -> None:
        if node.wake_due != due:
            return  # an earlier one took its place
        node.wake_due = None
        if not node.alive:
            return
        if node.hung or (node.busy and node.worked < BURST):
            node.wake_due = self.now + LOOK_AGAIN
            self.call_at(node.wake_due, self._wake, node, node.wake_due)
            return
        now, wanted = node.time, node.driver.wakeup
        if wanted is not None and now < wanted < now + ROUNDING:
            now = wanted
        node.worked = 0
        node.driver.wake(now)
        self._drain(node)

    # Devices -------------------------------------------------------------------------------------

    def _plug(self, device: Device, node: Node) -> None:
        for port in self._ports:
            if port.device is device:
                port.node = node
                return
        port = Port(device, node)
        self._ports.append(port)
        self.call_at(self.now, self._device_due, port)

    def _later_device(self, node: Node, data: bytes) -> None:
        link = self.link(node.name, "device")
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
            link = self.link("device", node.name)
            at = link.arrival(self.now)
            if at is not None:
                self.call_at(at, self._bytes, node, link.spoil(data))

    def _bytes(self, node: Node, data: bytes) -> None:
        if self._waits(node):
            self.hand(node, lambda: node.driver.received(data, node.time), "device")
        elif node.alive:
            node.driver.received(data, node.time)
            self._drain(node)
