"""One agent in one process: the queue, the clock and the wires around a sans-IO agent.

One thread runs the agent. The mesh's reception thread, and for a device agent the thread that reads
the port, only put into its inbox and ring; so from a message's arrival to what the agent publishes
there is one change of thread. Time is `time.monotonic`, and compared with nobody else's.
"""

from __future__ import annotations

import contextlib
import gc
import logging
import os
import random
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Final, NoReturn

from msgspec.structs import replace

from armadico.admission import CARD_S, Admission, Stage
from armadico.agent import Agent, Answer, AskFor, DeviceAgent, Identity, Publish, Question, Write
from armadico.device import Device, Port
from armadico.inbox import Inbox
from armadico.mesh.topology import MeshError
from armadico.messages import Ask, Card, Log, Message
from armadico.services import BIDS, CARD, Kind, Service, service_of
from armadico.supervision import MISUSED

if TYPE_CHECKING:
    from armadico.mesh.zenoh import Call, ZenohMesh

LATE_S: Final = 0.05
"""A wake-up later than this lets what has piled up meanwhile come first."""

SETTLE_S: Final = 0.005
"""So long must nothing arrive before a late wake-up fires."""

BURST: Final = 1024
"""After so many deliveries a wake-up that is due fires anyway: a flood must not hold it up."""

QUESTIONS: Final = 64
"""Queries that may wait for their answers; the oldest is let go of."""

LEAVE_S: Final = 3.0
"""From the signal to the end of the process, whatever hangs."""

logger = logging.getLogger("armadico")


class AgentProcess:
    """Runs one agent on a mesh that has been joined."""

    def __init__(
        self,
        agent: Agent,
        mesh: ZenohMesh,
        connect: Callable[[], Port] | None = None,
        clock: Callable[[], float] = time.monotonic,
        wall: Callable[[], float] = time.time,
    ) -> None:
        """`clock` counts s from anywhere; `wall` (s since 1970) is only shown to people."""
        self.agent = agent
        self.inbox = Inbox()
        self.refusal = ""  # why it may not join, or stay
        self._wall = wall
        self._admission: Admission | None = None
        self._mesh = mesh
        self._clock = clock
        self._stopping = threading.Event()
        self._device: Device | None = None
        self._closed: Device | None = None  # the device, as long as nobody has opened it
        if isinstance(agent, DeviceAgent) and connect is not None:
            self._device = self._closed = Device(agent, connect, self.inbox, clock)
        self._calls: dict[int, tuple[Call, str]] = {}
        self._call_ids = 0
        self._there: set[tuple[str, str]] = set()
        self._joined = False
        self._dropped = 0

    def admit(self) -> bool:
        """Look around before joining; False, with a `refusal`, if somebody is in the way.

        Without it `live` joins whoever is there.
        """
        agent = self.agent
        admission = Admission(agent.name, agent.instance, self._clock(), alone=agent.alone)
        self._admission = admission
        self._mesh.watch_alive(self._alive)
        while admission.look(self._clock()) is Stage.LOOKING and not self._stopping.is_set():
            self._ask_cards()
            due = admission.wakeup
            item = self.inbox.take(None if due is None else max(due - self._clock(), 0.0))
            if item is not None:
                item()
        self.refusal = admission.refusal
        return not self.refusal

    def live(self) -> None:
        """Run the agent until `request_stop` or a `refusal`; what it raises comes out."""
        self._join()
        self.agent.start(self._clock())
        self._send()
        if self._admission is None:
            self._open_port()
        else:
            for name, instance in sorted(self._there):
                self.agent.appeared(name, instance, self._clock())
            self._pass_admission()
        while not self._stopping.is_set():
            self._turn()

    def leave(self) -> None:
        """Let go of what the agent holds, see that it is heard, and close its port."""
        self.agent.outbox.clear()  # half a turn, if there is one, is not sent
        try:
            self.agent.stop(self._clock())
            self._send()
        finally:
            if self._device is not None:
                self._device.stop()

    def _open_port(self) -> None:
        device, self._closed = self._closed, None
        if device is not None:
            device.start()

    def request_stop(self) -> None:
        """Have `live` return soon; may be called from another thread."""
        self._stopping.set()
        self.inbox.ring()

    # One turn ------------------------------------------------------------------------------------

    def _turn(self) -> None:
        """Deliver what waits, then wake the agent if it is time, then wait."""
        due = self._due()
        wait = None if due is None else due - self._clock()
        if wait is not None and wait < -LATE_S:
            wait = SETTLE_S
        for _ in range(BURST):
            item = self.inbox.take(wait)
            if item is None:
                break
            item()
            self._send()
            wait = SETTLE_S if wait == SETTLE_S else 0.0
        due = self.agent.wakeup
        if due is not None and self._clock() >= due:
            self.agent.wake(self._clock())
            self._send()
        self._pass_admission()
        self._report_dropped()

    def _due(self) -> float | None:
        """When something is to be done, if nothing comes before."""
        mine = None if self._admission is None else self._admission.wakeup
        due = [at for at in (self.agent.wakeup, mine) if at is not None]
        return min(due, default=None)

    def _pass_admission(self) -> None:
        """Open the port once nobody is in the way; leave if somebody came who stays."""
        if self._admission is None:
            return
        self._ask_cards()
        stage = self._admission.look(self._clock())
        if stage is Stage.JOINED:
            self._open_port()
        elif stage is Stage.REFUSED:
            self.refusal = self._admission.refusal
            self._stopping.set()

    def _send(self) -> None:
        agent = self.agent
        while agent.outbox:
            out, agent.outbox = agent.outbox, []
            for item in out:
                if isinstance(item, Publish):
                    self._publish(item)
                elif isinstance(item, Write):
                    if self._device is not None:
                        self._device.write(item.data)
                elif isinstance(item, AskFor):
                    self._ask(item)
                else:
                    self._answer(item)

    def _publish(self, item: Publish) -> None:
        message = item.message
        if isinstance(message, Log):
            logger.log(message.level, "%s", message.text)
        self._mesh.publish(item.key, message)

    def _report_dropped(self) -> None:
        dropped = self.inbox.dropped
        if dropped > self._dropped:
            logger.warning("too busy: %d events were dropped", dropped - self._dropped)
            self._dropped = dropped

    # Joining -------------------------------------------------------------------------------------

    def _join(self) -> None:
        """Listen first, be seen last."""
        agent, mesh = self.agent, self._mesh
        for kind, service in type(agent).subscriptions().items():
            self._listen(kind, service)
        for kind in agent.answers:
            self._answers(kind, service_of(kind).pattern)
        names = {"name": agent.name, "instance": agent.instance}
        self._answers(Ask, CARD.key_for(**names), self._card)
        self._answers(Ask, BIDS.key_for(**names), agent.history)
        if self._admission is None:
            mesh.watch_alive(self._alive)
        mesh.declare_alive(agent.name, agent.instance)
        self._joined = True

    def _card(self) -> Card:
        return replace(self.agent.card(), clock=self._wall())

    # What arrives --------------------------------------------------------------------------------

    def _listen(self, kind: type[Message], service: Service) -> None:
        if service.watchers_only:
            raise ValueError(f"{self.agent.name} listens to {service.key}, which agents may not")
        inbox, is_state = self.inbox, service.kind is Kind.STATE

        def arrived(key: str, data: bytes) -> None:
            def deliver() -> None:
                message = self._mesh.read(kind, key, data)
                if message is not None:
                    self.agent.receive(message, self._clock())

            if is_state:
                inbox.put_state(key, deliver)
            else:
                inbox.put_event(deliver)

        self._mesh.subscribe(service.pattern, arrived)

    def _alive(self, name: str, instance: str, there: bool) -> None:
        def deliver() -> None:
            who = (name, instance)
            if instance == self.agent.instance or there == (who in self._there):
                return
            now = self._clock()
            (self._there.add if there else self._there.discard)(who)
            if self._admission is not None:
                if there:
                    self._admission.appeared(name, instance, now)
                else:
                    self._admission.disappeared(instance, now)
            if self._joined:
                tell = self.agent.appeared if there else self.agent.disappeared
                tell(name, instance, now)

        self.inbox.put_event(deliver)

    def _ask_cards(self) -> None:
        """Ask whoever is new who it is."""
        assert self._admission is not None, "it is asked for an admission"
        for name, instance in self._admission.questions(self._clock()):
            self._ask_card(name, instance, self._admission)

    def _ask_card(self, name: str, instance: str, admission: Admission) -> None:
        def replied(key: str, data: bytes) -> None:
            def deliver() -> None:
                card = self._mesh.read(Card, key, data)
                if card is not None:
                    admission.answered(instance, card, self._clock())
                    self.agent.met(card, self._clock())

            self.inbox.put_event(deliver)

        def over() -> None:
            self.inbox.put_event(lambda: admission.answered(instance, None, self._clock()))

        key = CARD.key_for(name=name, instance=instance)
        self._mesh.ask(key, Ask(), CARD_S, replied, over)

    # Queries -------------------------------------------------------------------------------------

    def _answers(
        self, kind: type[Message], key: str, reply: Callable[[], Message] | None = None
    ) -> None:
        """Answer a query by `reply`, or else by the agent."""

        def arrived(call: Call) -> None:
            def deliver() -> None:
                if reply is not None:
                    call.reply(key, reply())
                    return
                request = self._mesh.read(kind, call.key, call.payload)
                if request is not None:
                    self._question(call, key, request)

            self.inbox.put_event(deliver)

        self._mesh.answer(key, arrived)

    def _question(self, call: Call, key: str, request: Message) -> None:
        self._call_ids += 1
        self._calls[self._call_ids] = (call, key)
        if len(self._calls) > QUESTIONS:
            del self._calls[next(iter(self._calls))]
        self.agent.asked(Question(self._call_ids, request), self._clock())

    def _answer(self, item: Answer) -> None:
        call, key = self._calls.pop(item.id, (None, ""))
        if call is not None:
            call.reply(key, item.message)

    def _ask(self, item: AskFor) -> None:
        def replied(key: str, data: bytes) -> None:
            def deliver() -> None:
                reply = self._mesh.read(item.reply, key, data)
                if reply is not None:
                    self.agent.replied(item.id, reply, self._clock())

            self.inbox.put_event(deliver)

        def over() -> None:
            self.inbox.put_event(lambda: self.agent.replied(item.id, None, self._clock()))

        self._mesh.ask(item.key, item.request, item.timeout, replied, over)


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
    agent: Agent,
    mesh: ZenohMesh,
    connect: Callable[[], Port] | None = None,
    wall: Callable[[], float] = time.time,
) -> NoReturn:
    """Run one agent as this process, from joining the mesh to the end of the process.

    SIGTERM and SIGINT end it in order, with exit code 0; an exception of the agent's is logged and
    ends it with 1, somebody who is in its way with 2. Either way it is over within `LEAVE_S`, if
    need be by SIGALRM: neither Zenoh's threads nor an agent that hangs can keep it.
    """
    process = AgentProcess(agent, mesh, connect, wall=wall)
    _await_signal(process.request_stop)
    code = 0
    try:
        mesh.open()
        gc.collect()
        gc.freeze()  # what lives for ever is not looked at again
        if process.admit():
            process.live()
        if process.refusal:
            logger.error("in the namespace %r %s", mesh.namespace, process.refusal)
            code = MISUSED
    except MeshError as error:
        logger.error("%s", error)  # a matter of where, not of the program: no traceback
        code = 1
    except Exception:
        logger.exception("%s failed", agent.instance)
        code = 1
    _arm_deadline()
    with contextlib.suppress(Exception):
        process.leave()
    if not mesh.close():
        logger.warning("the mesh did not close in time, and is left behind")
    logging.shutdown()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)  # Zenoh's threads are not waited for


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
