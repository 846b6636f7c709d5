"""Agents in one process: the queue, the clock and the wires around their sans-IO drivers.

One thread at a time runs them. While the agents' own thread waits, the threads that receive from
the mesh and from a device's port do themselves what they have received, so that no other has to be
woken on the way from a sensor to a motor. All else goes through the inbox to the agents' thread:
tokens and queries, what comes while somebody is at work or something waits, what has piled up, and
for a while everything after a slow turn, during which nothing was received. Time is
`time.monotonic`, and compared with nobody else's.

Usually a process has one agent. Several share one session, and what they publish for each other
does not leave the process; keys, tokens and cards are the same.
"""

from __future__ import annotations

import contextlib
import gc
import logging
import logging.handlers
import os
import queue
import random
import signal
import socket
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any, Final, NoReturn

from armadico.core.agent import Agent, AskFor, DeviceAgent, Identity, Publish, Subscription, Write
from armadico.core.driver import Announce, Driver, OpenPort, Output, Reply
from armadico.core.journal import Journalled
from armadico.core.mailbox import BURST_S, EVENTS
from armadico.core.messages import Command, Log, Message, MessageError, decode, encoded
from armadico.core.resources import LEAST_SILENCE_S
from armadico.core.restart_policy import MISUSED
from armadico.core.services import Kind, matches
from armadico.mesh.base import Call, Mesh
from armadico.mesh.topology import MeshError, TopologyError
from armadico.runtime.blame import failure
from armadico.runtime.inbox import Inbox
from armadico.runtime.port_reader import Device, Port

if TYPE_CHECKING:
    from armadico.mesh.zenoh import ZenohMesh

LATE_S: Final = 0.05
"""A wake-up later than this lets what has piled up meanwhile come first."""

SETTLE_S: Final = 0.005
"""So long must nothing arrive before a late wake-up fires."""

SLOW_S: Final = 0.02
"""After a longer turn nothing is done on the mesh's reception thread, which must receive,"""

CALM_S: Final = 10.0
"""for so long."""

SENDING_S: Final = 0.001
"""So long after something was sent likewise: Zenoh's one thread must have time to transmit it."""

BUNCHED_S: Final = 0.02
"""What comes on one key sooner than this after the one before is no cycle's: it has piled up."""

JOIN_LOOK_S: Final = 0.2
"""How often a process that waits for its router looks whether it is to end."""

LEAVE_S: Final = 3.0
"""From the signal to the end of the process, whatever hangs."""

_Sent = tuple[Driver, Output, bytes | None]
"""What somebody sends, and its bytes if it was encoded for others of its process."""

LOG_LINES: Final = 1000
"""Lines that wait for a terminal or a disk that takes none; what comes then is lost."""

logger = logging.getLogger("armadico")


class AgentHost:
    """Runs agents on a mesh that has been joined."""

    def __init__(
        self,
        agents: Sequence[Agent],
        mesh: Mesh,
        connect: Mapping[str, Callable[[], Port]] | None = None,
        wall: Callable[[], float] = time.time,
        *,
        admit: bool = True,
        head: Callable[[Agent], bytes] | None = None,
    ) -> None:
        """Prepare.

        Args:
            agents: Who lives in this process.
            mesh: The mesh that they share, and whose time is theirs.
            connect: What opens the port of a device agent, by its instance.
            wall: s since 1970, shown to people only.
            admit: Without, they join whoever is alive.
            head: They keep journals, and this says how each begins; none: they keep none.
        """
        self.inbox = Inbox(mesh)
        self.refusal = ""  # why one of them may not join, or stay
        self._mesh = mesh
        self._clock = mesh.now
        self._stopping = threading.Event()
        self._leaving = False
        self._failure: BaseException | None = None  # of a turn on the reception thread
        self._until: float | None = None  # when the agents' thread wakes by itself
        self._calm_at = float("-inf")  # not before is anything done on the reception thread
        now = self._clock()
        self.drivers = [
            Driver(agent, now, admit=admit, wall=wall)
            if head is None
            else Journalled(agent, now, head(agent), admit=admit, wall=wall)
            for agent in agents
        ]
        self._listeners: dict[str, list[tuple[Subscription, Driver]]] = {}  # by pattern
        self._inside: dict[str, list[tuple[Subscription, Driver]]] = {}  # by key, in this process
        self._local: deque[tuple[Driver, Subscription, str, Message]] = deque()
        self._devices: dict[str, Device] = {}
        for driver in self.drivers:
            agent = driver.agent
            for to in agent.subscriptions():
                self._listeners.setdefault(to.pattern, []).append((to, driver))
            opens = (connect or {}).get(agent.instance)
            if isinstance(agent, DeviceAgent) and opens is not None:
                self._devices[agent.instance] = Device(
                    driver, opens, self.inbox, self._clock, self._at_once
                )

    # Its life ------------------------------------------------------------------------------------

    def live(self) -> None:
        """Run until `request_stop` or a `refusal`; what an agent raises comes out."""
        self._join()
        for driver in self.drivers:
            driver.begin(self._clock())
        self._send()
        while not (self._stopping.is_set() or self.refusal):
            self._turn()
            if self._failure is not None:
                raise self._failure

    def leave(self) -> None:
        """Let go of what the agents hold, see that it is heard, and close their ports."""
        self._leaving = True
        try:
            for driver in self.drivers:
                driver.leave(self._clock())
            self._send()
        finally:
            for device in self._devices.values():
                device.stop()

    def wait_joined(self) -> None:
        """Wait until the process is linked to its router, or until `request_stop`.

        Without a router nobody can be seen, and it would join as if it were the first.
        """
        while not (self._stopping.is_set() or self._mesh.wait_joined(JOIN_LOOK_S)):
            pass

    def request_stop(self) -> None:
        """Have `live` return soon; may be called from another thread."""
        self._stopping.set()
        self.inbox.ring()

    def _join(self) -> None:
        """Listen first, be seen last: drivers announce themselves once they may."""
        for pattern, listeners in self._listeners.items():
            self._listen(pattern, listeners)
        for driver in self.drivers:
            for key in driver.queries:
                self._mesh.answer(key, self._question(driver, key))
        self._mesh.watch_alive(self._token)
        self._mesh.watch_router(self._router)

    # One turn ------------------------------------------------------------------------------------

    def _turn(self) -> None:
        """Deliver what waits, then wake who is due, then wait."""
        due = self._until = self._due()
        wait = None if due is None else due - self._clock()
        # Who comes late hung: what has piled up is seen before any time-out is believed.
        settle = SETTLE_S if wait is not None and wait < -LATE_S else 0.0
        if settle:
            self._calm_at = max(self._calm_at, self._clock() + LATE_S)
        wait = settle if settle else None if wait is None else max(wait, 0.0)
        began, spent, longest = None, 0.0, 0.0
        while spent - longest < BURST_S:
            item = self.inbox.get(wait)
            if item is None:
                break
            began = self._clock() if began is None else began
            call, args = item
            call(*args)
            self._send()
            now, wait = self._clock(), settle
            began, took = now, now - began
            spent, longest = spent + took, max(longest, took)
        for driver in self.drivers:
            due = driver.wakeup
            if due is not None and self._clock() >= due:
                self._timed(driver, driver.wake)
                self._send()
        if dropped := self.inbox.take_dropped():
            self.drivers[0].report(dropped, self._clock())
            self._send()

    def _due(self) -> float | None:
        """When the next agent is to be woken."""
        return min((at for d in self.drivers if (at := d.wakeup) is not None), default=None)

    def _on_reception(self, call: Callable[..., None], args: tuple[Any, ...]) -> None:
        """Do on the mesh's thread what it received; and see that it has time to be that thread."""
        began = self._clock()
        sent = self._at_once(call, args)
        now = self._clock()
        if now - began > SLOW_S:
            self._calm_at = now + CALM_S
        elif sent:
            self._calm_at = max(self._calm_at, now + SENDING_S)

    def _at_once(self, call: Callable[..., None], args: tuple[Any, ...]) -> bool:
        """Do something on another thread, after `Inbox.at_once`; whether there was to be sent."""
        sent, due = False, None
        if self._failure is not None:  # half a turn was the last one
            self.inbox.done()
            return sent
        try:
            call(*args)
            sent = self._send(at_once=True)
            due = self._due()
        except BaseException as error:  # `live` raises it again
            self._failure = error
        finally:
            self.inbox.done()
        sooner = due is not None and (self._until is None or due < self._until)
        if sooner or self._failure is not None or self.refusal:
            self.inbox.ring()
        return sent

    def _timed(self, driver: Driver, step: Callable[..., None], *args: Any) -> None:
        """One step of a driver's, which is told if it took long."""
        began = self._clock()
        step(*args, began)
        took = self._clock() - began
        if took > driver.agent.cycles.period:
            driver.slow(took)

    def _send(self, *, at_once: bool = False) -> bool:
        """Deliver what the drivers have for one another, then send; whether there was anything.

        Commands and bytes for the device go out before the next delivery. `at_once`: on the
        reception thread; from the first that may block on, the rest is left to the agents' own.
        """
        first: list[_Sent] = []
        sent: list[_Sent] = []
        said = False
        while True:
            for driver in self.drivers:
                for item in driver.drain():
                    said, data = True, None
                    if len(self.drivers) > 1 and type(item) is Publish:
                        item, data = self._hand_over(driver, item)  # noqa: PLW2901
                    (first if _urgent(item) else sent).append((driver, item, data))
                if driver.refusal:
                    self.refusal = driver.refusal
            while first and (not at_once or self._goes_at_once(first[0][1])):
                self._put(*first.pop(0))
            if not self._local:
                break
            driver, to, key, message = self._local.popleft()
            self._timed(driver, driver.deliver, to, key, message)
        sent = first + sent
        for index, (driver, item, data) in enumerate(sent):
            if at_once and not self._goes_at_once(item):
                self.inbox.put("out", self._put_all, sent[index:])
                break
            self._put(driver, item, data)
        return said

    def _goes_at_once(self, item: Output) -> bool:
        """Whether sending it asks nothing of the mesh but to be passed on."""
        return type(item) is Write or (type(item) is Publish and self._mesh.has_said(item.key))

    def _put_all(self, sent: Sequence[_Sent]) -> None:
        for driver, item, data in sent:
            self._put(driver, item, data)

    def _hand_over(self, driver: Driver, item: Publish) -> tuple[Publish, bytes | None]:
        """Give a publication to those in this process who listen; returns it as they have it.

        Shared, and as it comes out at the other end of the mesh, with the bytes for that, so that
        it is encoded once: what cannot be sent, here too nobody receives. `_put` says so.
        """
        listeners = [found for found in self._inside_of(item.key) if found[1] is not driver]
        if not listeners:
            return item, None
        try:
            data, message = encoded(item.message)
        except MessageError:
            return item, None
        for to, other in listeners:
            self._local.append((other, to, item.key, message))
        return Publish(item.key, message), data

    def _unsent(self, driver: Driver, item: Output, error: MessageError) -> None:
        """What could not be decoded is counted, logged and dropped: it ends no agent."""
        assert isinstance(item, Publish | AskFor | Reply), "nothing else holds a message"
        if isinstance(item, AskFor):
            self.inbox.put(_lane(driver, item), self._replied, driver, item, "", None)
        driver.refuse(item.key, error, self._clock())
        self.inbox.put("refused", lambda: None, keep=1)  # so that the turn after it says so

    def _put(self, driver: Driver, item: Output, data: bytes | None) -> None:
        try:
            self._pass_on(driver, item, data)
        except MessageError as error:
            self._unsent(driver, item, error)

    def _pass_on(self, driver: Driver, item: Output, data: bytes | None) -> None:
        """Give it to the mesh or the port. Raises MessageError for what cannot be sent."""
        if type(item) is Publish:
            if isinstance(item.message, Log):
                logger.log(item.message.level, "%s", item.message.text)
            self._mesh.publish(item.key, item.message, data)
        elif isinstance(item, Write):
            self._write(driver, item)
        elif isinstance(item, AskFor):
            self._ask(driver, item)
        elif isinstance(item, Reply):
            item.call.reply(item.key, item.message)
        elif isinstance(item, Announce):
            self._mesh.declare_alive(driver.agent.name, driver.agent.instance)
        elif isinstance(item, OpenPort):
            device = self._devices.get(driver.agent.instance)
            if device is not None:
                device.start()

    def _write(self, driver: Driver, item: Write) -> None:
        """Give bytes to the device, unless the process was stopped since they were decided on.

        They are what somebody asked for before that. An agent that leaves says its last word.
        """
        device, now = self._devices.get(driver.agent.instance), self._clock()
        if device is None:
            return
        if now - driver.now < LEAST_SILENCE_S or self._leaving:
            device.write(item.data)
        else:
            driver.refuse("its device", f"written over {LEAST_SILENCE_S:g} s late", now)

    def _inside_of(self, key: str) -> list[tuple[Subscription, Driver]]:
        """Who in this process listens on a key."""
        found = self._inside.get(key)
        if found is None:
            found = self._inside[key] = [
                listener
                for pattern, listeners in self._listeners.items()
                if matches(pattern, key)
                for listener in listeners
            ]
        return found

    # What arrives --------------------------------------------------------------------------------

    def _listen(self, pattern: str, listeners: Sequence[tuple[Subscription, Driver]]) -> None:
        to = listeners[0][0]
        keep = 1 if to.kind is Kind.STATE else EVENTS
        deliver, last = self._deliver, float("-inf")

        def arrived(key: str, data: bytes) -> None:
            nonlocal last
            before, last = last, self._clock()
            apart = last - before > BUNCHED_S and last > self._calm_at
            if apart and self.inbox.at_once():
                self._on_reception(deliver, (listeners, key, data))
            else:
                self.inbox.put(key, deliver, listeners, key, data, keep=keep)

        self._mesh.subscribe(pattern, arrived)

    def _deliver(
        self, listeners: Sequence[tuple[Subscription, Driver]], key: str, data: bytes
    ) -> None:
        """Hand a payload to all who listen, decoded once."""
        payload: bytes | Message = data
        if len(listeners) > 1:
            with contextlib.suppress(MessageError):  # each says so by itself
                payload = decode(data, listeners[0][0].message)
        for to, driver in listeners:
            self._timed(driver, driver.deliver, to, key, payload)

    def _token(self, name: str, instance: str, alive: bool) -> None:
        self.inbox.put(f"token/{instance}", self._news, name, instance, alive, keep=1)

    def _router(self, there: bool) -> None:
        def tell() -> None:
            for driver in self.drivers:
                driver.router(there, self._clock())

        self.inbox.put("router", tell, keep=1)

    def _news(self, name: str, instance: str, alive: bool) -> None:
        for driver in self.drivers:
            driver.token(name, instance, alive, self._clock())

    # Queries -------------------------------------------------------------------------------------

    def _question(self, driver: Driver, key: str) -> Callable[[Call], None]:
        def arrived(call: Call) -> None:
            self.inbox.put(f"query/{key}", self._asked, driver, key, call)

        return arrived

    def _asked(self, driver: Driver, key: str, call: Call) -> None:
        self._timed(driver, driver.asked, key, call.payload, call)

    def _ask(self, driver: Driver, item: AskFor) -> None:
        lane = _lane(driver, item)

        def replied(key: str, data: bytes) -> None:
            self.inbox.put(lane, self._replied, driver, item, key, data)

        def over() -> None:
            self.inbox.put(lane, self._replied, driver, item, "", None)

        self._mesh.ask(item.key, item.request, item.timeout, replied, over)

    def _replied(self, driver: Driver, item: AskFor, key: str, data: bytes | None) -> None:
        reply = None
        if data is not None:
            try:
                reply = decode(data, item.reply)
            except MessageError as error:
                driver.refuse(key, error, self._clock())
                return
        driver.replied(item.id, reply, self._clock())


def _lane(driver: Driver, item: AskFor) -> str:
    """Where the replies to a query wait."""
    return f"reply/{driver.agent.instance}/{item.id}"


def _urgent(item: Output) -> bool:
    """Whether it is for the device, or for an owner to obey."""
    return type(item) is Write or (type(item) is Publish and type(item.message) is Command)


def identity(name: str, host: str | None = None) -> Identity:
    """Who a new instance of an agent is: its id is the name and 64 random bits, new each time."""
    rng = random.SystemRandom()
    return Identity(
        instance=f"{name}-{rng.getrandbits(64):016x}",
        host=host or socket.gethostname(),
        pid=os.getpid(),
        version=installed_version(),
        rng=random.Random(rng.getrandbits(64)),
    )


def installed_version() -> str:
    """The version of Armadico that is installed."""
    try:
        return version("armadico")
    except PackageNotFoundError:
        return "unknown"


def serve(
    agents: Sequence[Agent],
    mesh: ZenohMesh,
    connect: Mapping[str, Callable[[], Port]] | None = None,
    wall: Callable[[], float] = time.time,
    *,
    head: Callable[[Agent], bytes] | None = None,
) -> NoReturn:
    """Run agents as this process, from joining the mesh to the end of the process.

    SIGTERM and SIGINT end it in order, with exit code 0; an exception of an agent's is logged and
    ends it with 1, somebody who is in its way with 2. Either way it is over within `LEAVE_S`, if
    need be by SIGALRM: neither Zenoh's threads nor an agent that hangs can keep it.
    """
    host = AgentHost(agents, mesh, connect, wall=wall, head=head)
    _await_signal(host.request_stop)
    _log_from_a_thread()
    code = 0
    try:
        mesh.open()
        host.wait_joined()
        gc.collect()
        gc.freeze()  # what lives for ever is not looked at again
        host.live()
        if host.refusal:
            logger.error("in the namespace %r %s", mesh.namespace, host.refusal)
            code = MISUSED
    except (MeshError, TopologyError) as error:
        logger.error("%s", error)  # a matter of where, not of the program: no traceback
        code = MISUSED  # another robot agent or program is in its way, or its sockets' folder is
    except Exception as error:
        if told := failure(error):
            logger.error("%s", told)
        else:
            logger.exception("%s failed", ", ".join(agent.instance for agent in agents))
        code = 1
    _arm_deadline()
    with contextlib.suppress(Exception):
        host.leave()
    if not mesh.close():
        logger.warning("the mesh did not close in time, and is left behind")
    logging.shutdown()
    for listener in _listeners:
        listener.stop()
    with contextlib.suppress(OSError):  # a full disk
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(code)  # Zenoh's threads are not waited for


_listeners: list[logging.handlers.QueueListener] = []


class _Queued(logging.handlers.QueueHandler):
    """Hands lines to a thread of their own; what there is no room for is lost."""

    def enqueue(self, record: logging.LogRecord) -> None:
        with contextlib.suppress(queue.Full):
            self.queue.put_nowait(record)


def _log_from_a_thread() -> None:
    """Have another thread write the log: a terminal that stands still must not stop a robot."""
    root = logging.getLogger()
    handlers = root.handlers[:]
    if not handlers or any(isinstance(handler, _Queued) for handler in handlers):
        return
    lines: queue.Queue[logging.LogRecord] = queue.Queue(LOG_LINES)
    listener = logging.handlers.QueueListener(lines, *handlers)
    root.handlers[:] = [_Queued(lines)]
    listener.start()
    _listeners.append(listener)


def _await_signal(leave: Callable[[], None]) -> None:
    """Have a thread wait for SIGTERM or SIGINT; to be called before there are other threads.

    A signal handler would not do: one that comes between two instructions and the wait for the
    inbox runs only after that wait, which on a silent mesh is never.
    """
    ending = {signal.SIGTERM, signal.SIGINT}
    signal.pthread_sigmask(signal.SIG_BLOCK, ending)  # inherited by every thread from here on

    def wait() -> None:
        signal.sigwait(ending)
        _arm_deadline()
        leave()

    threading.Thread(target=wait, name="signals", daemon=True).start()


def _arm_deadline() -> None:
    """Have this process killed if it has not ended in time; once."""
    if signal.getitimer(signal.ITIMER_REAL)[0] == 0.0:
        signal.setitimer(signal.ITIMER_REAL, LEAVE_S)
