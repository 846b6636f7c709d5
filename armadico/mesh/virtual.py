"""The virtual mesh: a whole society in one thread, under a virtual clock, from one seed.

Computation takes no virtual time. Deliveries take delays drawn from the distribution measured on
the live mesh, never zero, or the same agent would always be first; what one process says to
another arrives in order. Equal instants run in order of a sequence number. Each link and each
agent draws from its own stream, derived from the seed and its name, so adding an agent leaves the
others' noise as it was and comparisons are paired. A publication is encoded once, decoded once, and
shared frozen.
"""

from __future__ import annotations

import heapq
import random
from collections.abc import Callable, Sequence
from typing import Any, Protocol

from armadico.agent import Agent, Answer, AskFor, DeviceAgent, Identity, Publish, Question, Write
from armadico.mailbox import Mailbox
from armadico.messages import Message, decode, encode
from armadico.services import Kind, service_of

DELAY_MEDIAN = 0.0006
DELAY_SPREAD = 0.45
"""Log-normal: median in s and sigma, as measured between processes on one machine at 10 Hz."""

LIVELINESS = 0.003
"""How long after a process is killed the others hear of it, s: the socket closes at once."""

Watcher = Callable[[str, Message, float], None]


class Device(Protocol):
    """What stands behind a device agent's port in memory: bytes and the time in, bytes out."""

    def receive(self, data: bytes, now: float) -> None:
        """Bytes from the agent."""

    def advance(self, now: float) -> bytes:
        """Live up to this time; what it says meanwhile."""

    @property
    def due(self) -> float:
        """When it next has something to say, s."""


class Link:
    """One direction between two processes."""

    __slots__ = ("delay", "last", "loss", "rng", "up")

    def __init__(self, rng: random.Random) -> None:
        self.rng = rng
        self.last = 0.0
        self.up = True
        self.loss = 0.0
        self.delay = 0.0  # s, on top of the usual

    def arrival(self, now: float) -> float | None:
        """When something sent now arrives, s; None if it is lost."""
        if not self.up or (self.loss and self.rng.random() < self.loss):
            return None
        at = now + self.delay + DELAY_MEDIAN * self.rng.lognormvariate(0.0, DELAY_SPREAD)
        self.last = max(at, self.last)
        return self.last


class Node:
    """One agent's process on the virtual mesh."""

    def __init__(self, agent: Agent, mesh: VirtualMesh) -> None:
        self.agent = agent
        self.name = agent.name
        self.mailbox = Mailbox()
        self.alive = True
        self.hung = False
        self.wake_due: float | None = None
        self.device: Device | None = None
        self.there: set[str] = set()  # instances that it knows of
        self._mesh = mesh

    def kill(self) -> None:
        """SIGKILL: it says nothing more, and its token goes."""
        self._mesh.kill(self)

    def hang(self) -> None:
        """SIGSTOP: what arrives waits, its token stays."""
        self.hung = True

    def resume(self) -> None:
        """SIGCONT: everything that waited arrives in a burst."""
        self.hung = False
        self._mesh.flush(self)


class VirtualMesh:
    """The clock, the queue of events and the network between the nodes."""

    def __init__(self, seed: int = 0) -> None:
        self.seed = seed
        self.now = 0.0
        self.nodes: list[Node] = []
        self.events = 0
        self._heap: list[tuple[float, int, Callable[[Any, Any], None], Any, Any]] = []
        self._sequence = 0
        self._links: dict[tuple[str, str], Link] = {}
        self._subscribers: dict[type[Message], list[Node]] = {}
        self._watchers: dict[type[Message], list[Watcher]] = {}
        self._questions: dict[int, tuple[Node | None, int, type[Message]]] = {}
        self._client_replies: dict[int, Callable[[Message | None], None]] = {}
        self._question_ids = 0

    # Building ------------------------------------------------------------------------------------

    def stream(self, name: str) -> random.Random:
        """A stream of random numbers of one's own."""
        return random.Random(f"{self.seed}/{name}")

    def identity(self, name: str, start: int = 0) -> Identity:
        """Who the `start`-th instance of an agent is."""
        rng = self.stream(f"agent/{name}/{start}")
        return Identity(f"{name}-{rng.getrandbits(64):016x}", "virtual", 0, "virtual", rng)

    def add(self, agent: Agent, device: Device | None = None) -> Node:
        """A process joins, now."""
        node = Node(agent, self)
        self.nodes.append(node)
        for kind in agent.subscriptions():
            self._subscribers.setdefault(kind, []).append(node)
        if device is not None:
            node.device = device
            self.call_at(self.now, self._device_due, node)
        self.call_at(self.now, self._start, node)
        return node

    def watch(self, watcher: Watcher, *kinds: type[Message]) -> None:
        """Be shown every message of these kinds the moment it is said, without being heard."""
        for kind in kinds:
            self._watchers.setdefault(kind, []).append(watcher)

    def call_at(
        self, when: float, call: Callable[[Any, Any], None], a: Any = None, b: Any = None
    ) -> None:
        """Have something called at a time."""
        self._sequence += 1
        heapq.heappush(self._heap, (when, self._sequence, call, a, b))

    def publish(self, message: Message, sender: str = "client", key: str | None = None) -> None:
        """Say something from outside the society, as a command-line tool would."""
        self._publish(sender, Publish(key or service_of(type(message)).key, message))

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
        self._put_question(None, ask, "client", then)

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
        for subscribers in self._subscribers.values():
            if node in subscribers:
                subscribers.remove(node)
        for other in self.nodes:
            if other.alive:
                self.call_at(self.now + LIVELINESS, self._gone, other, node)

    def flush(self, node: Node) -> None:
        """Hand a node what waited for it."""
        while not node.hung and (item := node.mailbox.take()):
            item()

    # Inside --------------------------------------------------------------------------------------

    def _start(self, node: Node, _: Any) -> None:
        agent = node.agent
        agent.start(self.now)
        if isinstance(agent, DeviceAgent) and node.device is not None:
            agent.take_link(True, "", self.now)
        self._drain(node)
        for other in self.nodes:
            if other.alive and other is not node:
                self._later(node.name, other, self._appear, node)
                self._later(other.name, node, self._appear, other)

    def _later(self, source: str, node: Node, call: Callable[[Any, Any], None], what: Any) -> None:
        at = self.link(source, node.name).arrival(self.now)
        if at is not None:
            self.call_at(at, call, node, what)

    def _appear(self, node: Node, other: Node) -> None:
        instance = other.agent.instance

        def deliver() -> None:
            if instance not in node.there:
                node.there.add(instance)
                node.agent.appeared(other.name, instance, self.now)
                self._drain(node)

        if other.alive:
            self._hand(node, deliver)

    def _gone(self, node: Node, other: Node) -> None:
        instance = other.agent.instance

        def deliver() -> None:
            if instance in node.there:
                node.there.remove(instance)
                node.agent.disappeared(other.name, instance, self.now)
                self._drain(node)

        self._hand(node, deliver)

    def _hand(self, node: Node, deliver: Callable[[], None]) -> None:
        """Deliver an event, or keep it while the node hangs."""
        if not node.alive:
            return
        if node.hung:
            node.mailbox.put_event(deliver)
        else:
            deliver()

    def _deliver(self, node: Node, message: Message) -> None:
        if not node.alive:
            return
        if node.hung:
            self._keep(node, message)
            return
        agent = node.agent
        agent.receive(message, self.now)
        if agent.outbox:
            self._drain(node)
        else:
            self._mind_wakeup(node)

    def _keep(self, node: Node, message: Message) -> None:
        service = service_of(type(message))

        def deliver() -> None:
            self._deliver(node, message)

        if service.kind is Kind.STATE:
            node.mailbox.put_state(service.key, deliver)
        else:
            node.mailbox.put_event(deliver)

    def _drain(self, node: Node) -> None:
        """Send what an agent has put into its outbox."""
        agent = node.agent
        out, agent.outbox = agent.outbox, []
        for item in out:
            if isinstance(item, Publish):
                self._publish(node.name, item, node)
            elif isinstance(item, Write):
                self._later_device(node, item.data)
            elif isinstance(item, AskFor):
                self._put_question(node, item, node.name, None)
            elif isinstance(item, Answer):
                self._route_answer(node, item)
        self._mind_wakeup(node)

    def _publish(self, sender: str, item: Publish, speaker: Node | None = None) -> None:
        """Send to everybody but the speaker, to another instance of the same agent too."""
        message = item.message
        kind = type(message)
        shared = decode(encode(message), kind)
        for watcher in self._watchers.get(kind, ()):
            watcher(item.key, shared, self.now)
        now, links = self.now, self._links
        for node in self._subscribers.get(kind, ()):
            if node is speaker:
                continue
            link = links.get((sender, node.name)) or self.link(sender, node.name)
            at = link.arrival(now)
            if at is not None:
                self._sequence += 1
                heapq.heappush(self._heap, (at, self._sequence, self._deliver, node, shared))

    def _mind_wakeup(self, node: Node) -> None:
        due = node.agent.wakeup
        if due is not None and (node.wake_due is None or due < node.wake_due):
            node.wake_due = due
            self.call_at(max(due, self.now), self._wake, node, due)

    def _wake(self, node: Node, due: float) -> None:
        if node.wake_due != due:
            return  # an earlier one took its place
        node.wake_due = None
        if not node.alive:
            return
        if node.hung:
            node.wake_due = self.now + 0.1
            self.call_at(node.wake_due, self._wake, node, node.wake_due)
            return
        node.agent.wake(self.now)
        self._drain(node)

    # Queries -------------------------------------------------------------------------------------

    def _put_question(
        self,
        node: Node | None,
        ask: AskFor,
        sender: str,
        then: Callable[[Message | None], None] | None,
    ) -> None:
        self._question_ids += 1
        number = self._question_ids
        self._questions[number] = (node, ask.id, ask.reply)
        if then is not None:
            self._client_replies[number] = then
        request = decode(encode(ask.request), type(ask.request))
        for other in self.nodes:
            if other.alive and answers(other.agent, ask.key, request):
                self._later(sender, other, self._ask, Question(number, request))
        self.call_at(self.now + ask.timeout, self._answered, number, None)

    def _ask(self, node: Node, question: Question) -> None:
        def deliver() -> None:
            node.agent.asked(question, self.now)
            self._drain(node)

        self._hand(node, deliver)

    def _route_answer(self, node: Node, answer: Answer) -> None:
        found = self._questions.get(answer.id)
        if found is None:
            return
        asker, _, reply = found
        message = decode(encode(answer.message), reply)
        target = "client" if asker is None else asker.name
        at = self.link(node.name, target).arrival(self.now)
        if at is not None:
            self.call_at(at, self._answered, answer.id, message)

    def _answered(self, number: int, message: Message | None) -> None:
        found = self._questions.pop(number, None)
        if found is None:
            return
        node, ask_id, _ = found
        if node is None:
            self._client_replies.pop(number)(message)
            return

        def deliver() -> None:
            node.agent.replied(ask_id, message, self.now)
            self._drain(node)

        self._hand(node, deliver)

    # Devices -------------------------------------------------------------------------------------

    def _later_device(self, node: Node, data: bytes) -> None:
        at = self.link(node.name, "device").arrival(self.now)
        if at is not None:
            self.call_at(at, self._device_receives, node, data)

    def _device_receives(self, node: Node, data: bytes) -> None:
        if node.device is not None:
            self._from_device(node, node.device.advance(self.now))
            node.device.receive(data, self.now)

    def _device_due(self, node: Node, _: Any) -> None:
        device = node.device
        if device is None:
            return
        self._from_device(node, device.advance(self.now))
        self.call_at(max(device.due, self.now + 1e-6), self._device_due, node)

    def _from_device(self, node: Node, data: bytes) -> None:
        if data and node.alive:
            at = self.link("device", node.name).arrival(self.now)
            if at is not None:
                self.call_at(at, self._bytes, node, data)

    def _bytes(self, node: Node, data: bytes) -> None:
        agent = node.agent
        assert isinstance(agent, DeviceAgent), f"{node.name} owns no device"

        def deliver() -> None:
            agent.take_bytes(data, self.now)
            self._drain(node)

        self._hand(node, deliver)


def answers(agent: Agent, key: str, request: Message) -> bool:
    """Whether an agent answers a query on a key."""
    return type(request) in agent.answers and service_of(type(request)).key == key


def cards(nodes: Sequence[Node]) -> list[Message]:
    """The cards of those that are alive."""
    return [node.agent.card() for node in nodes if node.alive]
