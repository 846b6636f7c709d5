"""Runs agents in one process: the queue, the clock and the I/O around their sans-IO drivers.

One thread at a time runs them. While the agents' thread waits, the threads that receive from the
mesh and from a device's port process their messages themselves, so that no thread is woken between
a sensor and a motor. The rest goes through the inbox to the agents' thread: tokens and queries,
messages that arrive while a thread works or items wait, and bunched messages. After a slow turn,
during which nothing was received, everything does for a while. Time is `time.monotonic`, and is not
compared with other processes'.

Usually a process has one agent. Several agents share one session, and their messages for each other
do not leave the process; keys, tokens and cards are the same.
"""

from __future__ import annotations

import contextlib
import gc
import logging
import logging.handlers
import os
import queue
import random
import socket
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Final, NoReturn

from armadico.core.agent import Agent, DeviceAgent, Identity
from armadico.core.driver import Announce, Driver, OpenPort, Output, Reply
from armadico.core.individual import Rights
from armadico.core.installed import version_of
from armadico.core.journal import Journalled
from armadico.core.kernel import Subscription
from armadico.core.mailbox import BURST_S, EVENTS, URGENT
from armadico.core.messages import (
    PROTOCOL,
    Command,
    Log,
    Message,
    MessageError,
    Repeat,
    decode,
    encoded,
)
from armadico.core.outgoing import Publish, SendQuery, Write
from armadico.core.resources import LEAST_SILENCE_S
from armadico.core.restart_policy import MISUSED
from armadico.core.services import Kind, matches
from armadico.mesh import sockets
from armadico.mesh.base import Call, Mesh
from armadico.mesh.door import Door
from armadico.mesh.topology import MeshError, TopologyError
from armadico.runtime.blame import failure
from armadico.runtime.inbox import Inbox
from armadico.runtime.port import Port
from armadico.runtime.port_reader import Device
from armadico.runtime.seals import Seals
from armadico.runtime.signals import arm_deadline, await_end, await_signals

if TYPE_CHECKING:
    from armadico.mesh.zenoh import ZenohMesh

LATE_S: Final = 0.05  # before a later wake-up, the waiting messages are processed, s
SETTLE_S: Final = 0.005  # a late wake-up runs after this time without an arrival, s

# After a turn longer than `SLOW_S`, nothing is processed on the mesh's reception thread for
# `CALM_S`, because that thread must receive.
SLOW_S: Final = 0.02
CALM_S: Final = 10.0

# Nor for this time after sending, s: Zenoh's one thread must have time to transmit.
SENDING_S: Final = 0.001

# Messages on one key that arrive closer together than this, s, were delayed and are bunched.
BUNCHED_S: Final = 0.02

JOIN_POLL_S: Final = 0.2  # how often a process that waits for its router checks whether to end, s
BY_SIGNAL: Final = "armadico stop"  # which sends the signal
LOG_LINES: Final = 1000  # lines that wait for a blocked terminal or disk; further ones are dropped

_Sent = tuple[Driver, Output, bytes | None]  # an output, and its bytes if encoded already

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
        door: Door | None = None,
    ) -> None:
        """Prepare to run agents on a mesh, which has their time.

        `connect` has functions that open the ports of device agents, by instance. `wall` returns
        wall time, s since 1970, shown to people only. Without `admit` they join without admission.
        `head` returns the head of an agent's journal; None: they keep none. `door` is the process's
        identity; None: the society is open.
        """
        self.inbox = Inbox(mesh)
        self.refusal = ""  # why one of them may not join, or stay
        self._mesh = mesh
        names = [agent.name for agent in agents]
        self._seals = None if door is None else Seals(door, names, wall)
        self._clock = mesh.now
        self._stopping = threading.Event()
        self._leaving = False
        self._failure: BaseException | None = None  # of a turn on the reception thread
        self._until: float | None = None  # when the agents' thread wakes by itself
        self._calm_at = float("-inf")  # when the reception thread may process messages again
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
            driver.kernel.closed = door is not None
            for to in driver.kernel.subscriptions:
                self._listeners.setdefault(to.pattern, []).append((to, driver))
            opens = (connect or {}).get(agent.instance)
            if isinstance(agent, DeviceAgent) and opens is not None:
                self._devices[agent.instance] = Device(
                    driver, opens, self.inbox, self._clock, self._at_once
                )

    # Life cycle ----------------------------------------------------------------------------------

    def live(self) -> None:
        """Run until `request_stop` or a `refusal`. Raises what an agent raises."""
        self._join()
        for driver in self.drivers:
            driver.begin(self._clock())
        self._send()
        while not (self._stopping.is_set() or self.refusal):
            self._turn()
            if self._failure is not None:
                raise self._failure

    def leave(self) -> None:
        """Release all held resources, publish that, and close the ports."""
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

        Without a router no other agent is visible, and it would join as if it were the first.
        """
        while not (self._stopping.is_set() or self._mesh.wait_joined(JOIN_POLL_S)):
            pass

    def request_stop(self) -> None:
        """Make `live` return soon; may be called from another thread."""
        self._stopping.set()
        self.inbox.ring()

    def latch(self) -> None:
        """Latch the robot's stop, ordered by a signal; may be called from another thread.

        The robot agent does it where it runs; elsewhere any agent publishes the stop.
        """
        owners = (d for d in self.drivers if any(each.stops for each in d.agent.owns))
        driver = next(owners, self.drivers[0])
        device = self._devices.get(driver.agent.instance)
        # One of several stops that wait is kept: a device's guard has to know, whichever it is.
        latch = device.latch if device else lambda by: driver.latch(by, self._clock())
        self.inbox.put(URGENT, latch, BY_SIGNAL, keep=1)

    def _join(self) -> None:
        """Subscribe before the drivers announce their agents."""
        for pattern, listeners in self._listeners.items():
            self._listen(pattern, listeners)
        for driver in self.drivers:
            for key in driver.queries:
                self._mesh.answer(key, self._query_receiver(driver, key))
        self._mesh.watch_alive(self._on_token)
        self._mesh.watch_router(self._on_router)

    # One turn ------------------------------------------------------------------------------------

    def _turn(self) -> None:
        """Wait for messages and deliver them, then wake the agents that are due."""
        due = self._until = self._due()
        wait = None if due is None else due - self._clock()
        # A late wake-up means that the process hung: waiting messages come before any timeout.
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
        return min((at for d in self.drivers if (at := d.wakeup) is not None), default=None)

    def _on_reception(self, call: Callable[..., None], args: tuple[object, ...]) -> None:
        """Process a message on the reception thread, and leave that thread time to receive."""
        began = self._clock()
        sent = self._at_once(call, args)
        now = self._clock()
        if now - began > SLOW_S:
            self._calm_at = now + CALM_S
        elif sent:
            self._calm_at = max(self._calm_at, now + SENDING_S)

    def _at_once(self, call: Callable[..., None], args: tuple[object, ...]) -> bool:
        """Call on a foreign thread, after `Inbox.at_once`; return whether anything was sent."""
        sent, due = False, None
        if self._failure is not None:  # an interrupted turn was the last one
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

    def _timed(self, driver: Driver, step: Callable[..., None], *args: object) -> None:
        """Call a driver's method, and report to the driver if it took longer than a cycle."""
        began = self._clock()
        step(*args, began)
        took = self._clock() - began
        if took > driver.kernel.cycles.period:
            driver.slow(took)

    def _send(self, *, at_once: bool = False) -> bool:
        """Deliver outputs within the process, then send; return whether there was any output.

        Commands and bytes for the device are sent before the next delivery. `at_once`: on the
        reception thread; from the first output that may block, the agents' thread sends the rest.
        """
        first: list[_Sent] = []
        sent: list[_Sent] = []
        found = False
        while True:
            for driver in self.drivers:
                for item in driver.drain():
                    found, data = True, None
                    if len(self.drivers) > 1 and type(item) is Publish:
                        item, data = self._deliver_inside(driver, item)  # noqa: PLW2901
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
        return found

    def _goes_at_once(self, item: Output) -> bool:
        """Return whether sending an output cannot block."""
        return type(item) is Write or (type(item) is Publish and self._mesh.is_declared(item.key))

    def _put_all(self, sent: Sequence[_Sent]) -> None:
        for driver, item, data in sent:
            self._put(driver, item, data)

    def _deliver_inside(self, driver: Driver, item: Publish) -> tuple[Publish, bytes | None]:
        """Queue a publication for this process's subscribers; return it as decoded, and its bytes.

        They share the message as it is decoded from the mesh, so it is encoded only once. A message
        that cannot be sent is not delivered here either; `_put` reports it.
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

    def _put(self, driver: Driver, item: Output, data: bytes | None) -> None:
        """Send; a message that could not be decoded is counted, logged and dropped."""
        try:
            self._pass_on(driver, item, data)
        except MessageError as error:
            assert isinstance(item, Publish | SendQuery | Reply), "nothing else holds a message"
            if isinstance(item, SendQuery):
                self.inbox.put(_lane(driver, item), self._replied, driver, item, "", None)
            driver.refuse(item.key, error, self._clock())
            self.inbox.put("refused", lambda: None, keep=1)  # so that a turn follows, and reports

    def _pass_on(self, driver: Driver, item: Output, data: bytes | None) -> None:
        """Send by the mesh or the port. Raises MessageError for a message that cannot be sent."""
        if type(item) is Publish:
            if isinstance(item.message, Log):
                logger.log(item.message.level, "%s", item.message.text)
            self._mesh.publish(item.key, item.message, data)
            if self._seals is not None:
                sealed = self._seals.seal(item.key, item.message, data)
                if sealed is not None:
                    self._mesh.publish(driver.kernel.key_of(Repeat), sealed)
        elif isinstance(item, Write):
            self._write(driver, item)
        elif isinstance(item, SendQuery):
            self._query(driver, item)
        elif isinstance(item, Reply):
            item.call.reply(item.key, item.message)
        elif isinstance(item, Announce):
            self._mesh.declare_alive(driver.agent.name, driver.agent.instance)
        elif isinstance(item, OpenPort):
            device = self._devices.get(driver.agent.instance)
            if device is not None:
                device.start()

    def _write(self, driver: Driver, item: Write) -> None:
        """Write to the device, unless the process was paused since the agent's decision.

        The bytes would follow a command from before the pause. A leaving agent's last bytes are
        always written.
        """
        device, now = self._devices.get(driver.agent.instance), self._clock()
        if device is None:
            return
        if now - driver.now < LEAST_SILENCE_S or self._leaving:
            # The guard counts from when it has the bytes, the agent from its decision.
            holds_s = max(item.holds_s - (now - driver.now), 0.0)
            device.write(replace(item, holds_s=holds_s))
        else:
            driver.refuse("its device", f"written over {LEAST_SILENCE_S:g} s late", now)

    def _inside_of(self, key: str) -> list[tuple[Subscription, Driver]]:
        """Return this process's subscribers of a key."""
        found = self._inside.get(key)
        if found is None:
            found = self._inside[key] = [
                listener
                for pattern, listeners in self._listeners.items()
                if matches(pattern, key)
                for listener in listeners
            ]
        return found

    # Inputs --------------------------------------------------------------------------------------

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
        """Deliver a payload to its subscribers, decoded once if there are several."""
        payload: bytes | Message = data
        if self._seals is not None and listeners[0][0].message is Repeat:
            fault = self._fault(data)
            if fault:
                for _, driver in listeners:
                    driver.refuse(key, fault, self._clock())
                return
        if len(listeners) > 1:
            with contextlib.suppress(MessageError):  # each driver reports it
                payload = decode(data, listeners[0][0].message)
        for to, driver in listeners:
            self._timed(driver, driver.deliver, to, key, payload)

    def _fault(self, data: bytes) -> str:
        """Return why a repeated state does not count; "" if it does."""
        assert self._seals is not None, "only a society with keys has them"
        try:
            return self._seals.fault(decode(data, Repeat))
        except MessageError as error:
            return str(error)

    def _on_token(self, name: str, instance: str, alive: bool) -> None:
        def deliver() -> None:
            for driver in self.drivers:
                driver.token(name, instance, alive, self._clock())

        self.inbox.put(f"token/{instance}", deliver, keep=1)

    def _on_router(self, there: bool) -> None:
        def deliver() -> None:
            for driver in self.drivers:
                driver.router(there, self._clock())

        self.inbox.put("router", deliver, keep=1)

    # Queries -------------------------------------------------------------------------------------

    def _query_receiver(self, driver: Driver, key: str) -> Callable[[Call], None]:
        def arrived(call: Call) -> None:
            at = call.key if key.endswith("/**") else key  # it may be asked on a pattern, too
            self.inbox.put(f"query/{key}", self._on_query, driver, at, call)

        return arrived

    def _on_query(self, driver: Driver, key: str, call: Call) -> None:
        self._timed(driver, driver.on_query, key, call.payload, call)

    def _query(self, driver: Driver, item: SendQuery) -> None:
        lane = _lane(driver, item)

        def on_reply(key: str, data: bytes) -> None:
            self.inbox.put(lane, self._replied, driver, item, key, data)

        def over() -> None:
            self.inbox.put(lane, self._replied, driver, item, "", None)

        self._mesh.query(item.key, item.request, item.timeout, on_reply, over)

    def _replied(self, driver: Driver, item: SendQuery, key: str, data: bytes | None) -> None:
        reply = None
        if data is not None:
            try:
                reply = decode(data, item.reply)
            except MessageError as error:
                driver.refuse(key, error, self._clock())
                return
        driver.on_reply(item.id, reply, self._clock())


def _lane(driver: Driver, item: SendQuery) -> str:
    return f"reply/{driver.agent.instance}/{item.id}"


def _urgent(item: Output) -> bool:
    """Return whether an output is for the device or is a command."""
    return type(item) is Write or (type(item) is Publish and type(item.message) is Command)


def identity(
    name: str,
    host: str | None = None,
    table: str = "",
    protocol: int = PROTOCOL,
    rights: Rights | None = None,
) -> Identity:
    """Return a new instance's identity; its id is the name and 64 random bits.

    `table` is the digest of the host table that the process was launched with, and
    `rights` as in `Identity`.
    """
    rng = random.SystemRandom()
    return Identity(
        instance=f"{name}-{rng.getrandbits(64):016x}",
        host=host or socket.gethostname(),
        pid=os.getpid(),
        version=version_of("armadico"),
        rng=random.Random(rng.getrandbits(64)),
        table=table,
        protocol=protocol,
        rights=rights,
    )


def serve(
    agents: Sequence[Agent],
    mesh: ZenohMesh,
    connect: Mapping[str, Callable[[], Port]] | None = None,
    wall: Callable[[], float] = time.time,
    *,
    head: Callable[[Agent], bytes] | None = None,
) -> NoReturn:
    """Run agents as this process, from joining the mesh to the end of the process.

    The signals of `ending` end it in order, with exit code 0. An agent's exception is logged, exit
    code 1; a conflicting instance gives 2. The process then ends within `LEAVE_S`, if necessary by
    SIGALRM: neither Zenoh's threads nor a hanging agent can delay it.
    """
    host = AgentHost(agents, mesh, connect, wall=wall, head=head, door=mesh.door)
    await_end(host.request_stop)
    await_signals({sockets.STOP_SIGNAL: host.latch})  # without a connection: none can be in its way
    _log_from_a_thread()
    code = 0
    try:
        mesh.open()
        host.wait_joined()
        gc.collect()
        gc.freeze()  # permanent objects are not scanned again
        host.live()
        if host.refusal:
            logger.error("in the namespace %r %s", mesh.namespace, host.refusal)
            code = MISUSED
    except (MeshError, TopologyError) as error:
        logger.error("%s", error)  # the place is wrong, not the program: no traceback
        code = MISUSED  # another robot agent or program conflicts, or the sockets' folder is wrong
    except Exception as error:
        if text := failure(error):
            logger.error("%s", text)
        else:
            logger.exception("%s failed", ", ".join(agent.instance for agent in agents))
        code = 1
    arm_deadline()
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
    """Passes log lines to another thread; drops lines if the queue is full."""

    def enqueue(self, record: logging.LogRecord) -> None:
        with contextlib.suppress(queue.Full):
            self.queue.put_nowait(record)


def _log_from_a_thread() -> None:
    """Write the log in another thread, so that a blocked terminal does not stop a robot."""
    root = logging.getLogger()
    handlers = root.handlers[:]
    if not handlers or any(isinstance(handler, _Queued) for handler in handlers):
        return
    lines: queue.Queue[logging.LogRecord] = queue.Queue(LOG_LINES)
    listener = logging.handlers.QueueListener(lines, *handlers)
    root.handlers[:] = [_Queued(lines)]
    listener.start()
    _listeners.append(listener)
