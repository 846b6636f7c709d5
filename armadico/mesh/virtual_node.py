"""An agent's process on the virtual mesh."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Final

from armadico.core.agent import Agent
from armadico.core.driver import Announce, Driver, OpenPort, Output, Reply
from armadico.core.journal import Journalled
from armadico.core.kernel import Subscription
from armadico.core.mailbox import BURST_S, EVENTS, Mailbox
from armadico.core.messages import JournalPiece, Message
from armadico.core.outgoing import EXPIRY_S, Publish, SendQuery, Write
from armadico.core.resources import WHEELS
from armadico.core.services import Kind, matches
from armadico.mesh.virtual_clock import Step
from armadico.mesh.virtual_network import Clock
from armadico.mesh.virtual_place import Device, Network, Place

RETRY_S: Final = 0.02  # pause before a wake-up of a hanging or busy process is tried again, s
ROUNDING: Final = 1e-9  # by a process's own clock, a wake-up this much too early is in time, s


class Node(Place):
    """An agent's process: its driver, and its faults (hanging, slow, wrong clock).

    Without its own clock it uses the mesh's time.
    """

    def __init__(
        self,
        agent: Agent,
        mesh: Network,
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
        self.work_s = 0.0  # processing time of each delivery, s
        self._busy = False
        self._worked = 0  # deliveries since the last wake-up, or since the mailbox was empty
        self._wake_due: float | None = None
        self._admit = admit
        self.begun = False
        self.driver = Driver(agent, self.time, admit=admit)
        self.keep_journal()

    @property
    def is_router(self) -> bool:
        return WHEELS in self.agent.owns

    def keep_journal(self) -> None:
        """Begin a journal, if the mesh keeps journals and the agent has not begun."""
        head = self.mesh.head
        if head is not None and not self.begun:
            self.driver = Journalled(
                self.agent, self.time, head(self.agent), admit=self._admit, publishes=False
            )

    def pieces(self) -> list[JournalPiece]:
        """Return the journal's new pieces since the last call; none if it keeps no journal."""
        return self.driver.pieces() if isinstance(self.driver, Journalled) else []

    @property
    def time(self) -> float:
        """The process's own time, s."""
        now = self.mesh.now
        return now if self.clock is None else self.clock.read(now)

    def begin(self) -> None:
        self.begun = True
        self.driver.begin(self.time)
        self._drain()

    # Faults --------------------------------------------------------------------------------------

    def leave(self) -> None:
        """SIGTERM: it releases what it holds, and ends."""
        self.driver.leave(self.time)
        self._send(self.driver.drain())
        self.kill()

    def kill(self) -> None:
        super().kill()
        self.mesh.ports.closed(self)

    def hang(self) -> None:
        """SIGSTOP: deliveries wait, its token stays for the lease."""
        if not self.hung:
            self.hung = True
            self.mesh.liveliness.hung(self)

    def resume(self) -> None:
        """SIGCONT: all waiting deliveries arrive in a burst."""
        self.hung = False
        self._flush()
        self.mesh.liveliness.woken(self)
        self.mesh.star.woken(self)

    def slow_down(self, work_s: float) -> None:
        """Set the processing time of each delivery, s."""
        self.work_s = work_s
        if not work_s and not self._busy:
            self._flush()

    def jump(self, ahead: float) -> None:
        """Advance its clock at once, s."""
        self._own_clock().jump(ahead)
        self._schedule_wakeup(anew=True)

    def drift(self, rate: float) -> None:
        """Set the rate of its clock from now on; 1 is exact."""
        self._own_clock().drift(self.mesh.now, rate)
        self._schedule_wakeup(anew=True)

    def _own_clock(self) -> Clock:
        if self.clock is None:
            self.clock = Clock()
        return self.clock

    # Inputs --------------------------------------------------------------------------------------

    def listeners(self) -> list[tuple[str, Step, object]]:
        return [(to.pattern, self._deliver, to) for to in self.driver.kernel.subscriptions]

    def _deliver(self, to: Subscription, what: tuple[str, Message | bytes]) -> None:
        if not self.alive:
            return
        key, message = what
        if self.hung or self.work_s or self._busy or self.mailbox.lanes:  # `_waits`: it costs
            keep = 1 if to.kind is Kind.STATE else EVENTS
            self._accept(lambda: self.driver.deliver(to, key, message, self.time), key, keep)
            return
        driver = self.driver
        driver.deliver(to, key, message, self.mesh.now if self.clock is None else self.time)
        out = driver.drain()
        if out:
            self._send(out)
        wanted, due = driver.wakeup, self._wake_due
        if wanted is not None and (due is None or self.clock is not None or wanted < due):
            self._schedule_wakeup()

    def queryables(self, pattern: str) -> list[str]:
        return [key for key in self.driver.queries if matches(pattern, key)]

    def on_query(self, queryable: str, what: tuple[str, Message, int]) -> None:
        key, request, number = what
        at = key if queryable.endswith("/**") else queryable  # it may be asked on a pattern, too
        self._accept(
            lambda: self.driver.on_query(at, request, number, self.time),
            f"query/{queryable}",
        )

    def on_token(self, name: str, instance: str, alive: bool) -> None:
        self._accept(
            lambda: self.driver.token(name, instance, alive, self.time), f"token/{instance}", 1
        )

    def on_router(self, there: bool) -> None:
        if self.begun:
            self._accept(lambda: self.driver.router(there, self.time), "router", 1)
        else:
            self.driver.router(there, self.time)

    def received(self, data: bytes, _: object) -> None:
        """Process bytes from the device."""
        self._accept(lambda: self.driver.received(data, self.time), "device")

    def braked(self) -> None:
        """Process that the guard of its device's line has braked by one step."""
        self._accept(lambda: self.driver.braked(self.time), "braked")

    def _replied(self, number: int, message: Message | None) -> None:
        self._accept(lambda: self.driver.on_reply(number, message, self.time), f"reply/{number}")

    def _accept(self, deliver: Callable[[], None], lane: str, keep: int = EVENTS) -> None:
        """Deliver now, or queue in a lane while the process hangs or is busy."""
        if not self.alive:
            return
        if self._waits():
            self.mailbox.put(lane, lambda: self._process(deliver), keep)
            self._work()
        else:
            self._process(deliver)

    def _waits(self) -> bool:
        """Return whether deliveries must wait, also behind waiting ones."""
        return self.hung or bool(self.work_s) or self._busy or bool(self.mailbox)

    def _process(self, deliver: Callable[[], None]) -> None:
        if self.alive:
            deliver()
            self._drain()

    def _flush(self) -> None:
        while not self.hung and not self._busy and (item := self.mailbox.get()):
            item()
        self._report_dropped()

    def _work(self) -> None:
        """Process deliveries one by one, as a slow process; outputs follow at the end of each."""
        while not (self._busy or self.hung) and (item := self.mailbox.get()):
            self._worked += 1
            item()
        if not self._busy:
            self._worked = 0
        self._report_dropped()

    def _report_dropped(self) -> None:
        if self.hung or self._busy or not self.alive:
            return
        if dropped := self.mailbox.take_dropped():
            self.driver.report(dropped, self.time)
            self._send(self.driver.drain())

    def _has_worked(self, out: list[Output], _: object) -> None:
        self._busy = False
        if self.hung:  # it continues later where it was
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
            self._schedule_wakeup()

    # Outputs -------------------------------------------------------------------------------------

    def _drain(self) -> None:
        """Send the agent's outputs, now or at the end of the processing time."""
        out = self.driver.drain()
        if self.work_s and self.alive:
            self._busy = True
            self.mesh.call_at(self.mesh.now + self.work_s, self._has_worked, out)
            return
        if out:
            self._send(out)
        self._schedule_wakeup()
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
                self.mesh.ports.write(self, item)
            elif isinstance(item, SendQuery):
                then = partial(self._replied, item.id)
                self.mesh.queries.put_first(self, item, then)
            elif isinstance(item, Reply):
                self.mesh.queries.reply(self, item.call, item.key, item.message)
            elif isinstance(item, Announce):
                self.announce(self.name, self.agent.instance)
            elif isinstance(item, OpenPort) and self.device is not None:
                self.mesh.ports.plug(self.device, self)
                if any(resource.stops for resource in self.agent.owns):
                    # This guard has priority over all, and never fails.
                    self.driver.guarded(EXPIRY_S, EXPIRY_S, self.time)
                self.driver.link(True, "", self.time)
                self._drain()

    def unsent(self, key: str, why: str) -> None:
        self.driver.refuse(key, why, self.time)
        self._send(self.driver.drain())

    # Wake-ups ------------------------------------------------------------------------------------

    def _schedule_wakeup(self, *, anew: bool = False) -> None:
        """Schedule the agent's next wake-up; `anew`: its clock has changed."""
        if anew:
            self._wake_due = None
        wanted = self.driver.wakeup
        if wanted is None or not self.alive:
            return
        due = wanted if self.clock is None else self.clock.when(wanted)
        if self._wake_due is None or due < self._wake_due:
            self._wake_due = due
            self.mesh.call_at(max(due, self.mesh.now), self._wake, due)

    def _wake(self, due: float, _: object) -> None:
        if self._wake_due != due:
            return  # an earlier one replaced it
        self._wake_due = None
        if not self.alive:
            return
        if self.hung or self._busy:
            self._wake_due = self.mesh.now + RETRY_S
            self.mesh.call_at(self._wake_due, self._wake, self._wake_due)
            return
        now, wanted = self.time, self.driver.wakeup
        if wanted is not None and now < wanted < now + ROUNDING:
            now = wanted
        self._worked = 0
        self.driver.wake(now)
        self._drain()
