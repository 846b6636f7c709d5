"""One host's share of a society as processes: starts, watches, restarts and ends them.

The machine of the wakeup agent (`armadico.agents.supervision.wakeup`), which decides what is
started when. That agent runs in a thread of this process, on the mesh; processes belong to the
main thread, which they are tied to.
"""

from __future__ import annotations

import queue
import re
import shutil
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Final

import psutil

from armadico.agents.supervision.wakeup import (
    Do,
    Event,
    Load,
    Order,
    Parameters,
    Wakeup,
    lines,
    orders,
)
from armadico.config.discovery import agent_class, owners
from armadico.core.resources import WHEELS
from armadico.core.restart_policy import Budget
from armadico.launch.processes import SIMULATOR, Process, ProcessTable, ending
from armadico.launch.society import Member, processes
from armadico.observe.journals import head
from armadico.runtime.errors import RunFailedError
from armadico.runtime.process import AgentHost, identity
from armadico.runtime.programs import LEAVE_S

if TYPE_CHECKING:
    from armadico.config.scenarios import Scenario
    from armadico.mesh.base import Mesh

LOOK_S: Final = 0.05
"""How often ended processes and new log lines are looked for."""

LOAD_S: Final = 2.0
"""How often the machine's load is read."""

LOG_BYTES: Final = 4_000_000
"""A log that is longer is kept as NAME.log.1, and begun anew."""

_LINE = re.compile(r"^\d\d:\d\d:\d\d\.\d{3} \S+ (?P<level>[A-Z]+) ")
_LOUD = ("WARNING", "ERROR", "CRITICAL")


class GaveUpError(RunFailedError):
    """A process ended, and a restart is useless; the message has its name and the reason."""


@dataclass(frozen=True)
class Plan:
    """The processes to run: the agents, and a simulator if the robot agent has no robot."""

    host: str
    namespace: str
    members: tuple[Member, ...]
    simulated: Scenario | None = None
    seed: int = 0
    joining: tuple[str, ...] = ()
    """Options by which the processes find the mesh."""
    together: tuple[tuple[str, ...], ...] = ()
    """Agents that share a process."""
    can: tuple[Member, ...] = ()
    """Agents that it would start besides, if their own host is gone."""
    needs: tuple[str, ...] = ()
    """Agents of the whole society that what is asked for cannot do without."""
    journal: bool = False
    """Whether the agents publish what enters and leaves them."""


@dataclass
class Tail:
    """New lines of a log that people should see."""

    name: str
    log: Path
    _read: int = 0
    _rest: str = ""
    _loud: bool = True
    lines: list[str] = field(default_factory=list)

    def loud(self) -> list[str]:
        """Return new lines of WARNING and worse with their continuations and the agent's name."""
        try:
            if self.log.stat().st_size < self._read:
                self._read, self._rest = 0, ""  # the file has been replaced
            with self.log.open("rb") as file:
                file.seek(self._read)
                data = file.read()
        except OSError:  # as if temporary files were cleaned up: the society goes on
            return []
        if data:
            self._read += len(data)
            *lines, self._rest = (self._rest + data.decode(errors="replace")).split("\n")
            return [said for line in lines if (said := self._said(line))]
        return []

    def turn(self) -> None:
        """Rotate a long file; its old content is kept, if there is space."""
        if self._read > LOG_BYTES:
            with suppress(OSError):
                shutil.copyfile(self.log, self.log.with_suffix(".log.1"))
            with suppress(OSError), self.log.open("r+b") as file:
                file.truncate()
            self._read = 0

    def _said(self, line: str) -> str:
        """Return a line as it is passed on; empty if it is not."""
        found = _LINE.match(line)
        if found is None:  # a continuation, such as a traceback
            return f"{self.name}: {line}" if self._loud else ""
        self._loud = found["level"] in _LOUD
        return f"{self.name}: {found['level']} {line[found.end() :]}" if self._loud else ""


class Machine:
    """The wakeup agent's port: orders go to the thread that has the processes, events come back."""

    def __init__(self) -> None:
        self.orders: queue.SimpleQueue[Order] = queue.SimpleQueue()
        self._events: queue.SimpleQueue[Event | Load] = queue.SimpleQueue()

    def tell(self, event: Event | Load) -> None:
        """Pass on an event of a process, or the machine's load."""
        self._events.put(event)

    def read(self, timeout_s: float) -> bytes:
        try:
            return lines(self._events.get(timeout=timeout_s))
        except queue.Empty:
            return b""

    def write(self, data: bytes) -> None:
        for order in orders(data):
            self.orders.put(order)

    def close(self) -> None:
        """See `Port`."""


class Upkeep:
    """Keeps a share's processes running; a context manager that ends all of them."""

    def __init__(
        self, plan: Plan, mesh: Mesh, say: Callable[[str], None], budget: Budget | None = None
    ) -> None:
        """`say` receives reports of faults, one line at a time."""
        self.plan = plan
        self.table = ProcessTable(plan.namespace, plan.joining, tied=True, journal=plan.journal)
        self.machine = Machine()
        self._say = say
        self._groups = processes(plan.members, plan.together)
        self._lent = {member.name: (member,) for member in plan.can}
        self._tails: dict[str, Tail] = {}
        self._ending: dict[str, float] = {}  # processes that are ending, and when they are killed
        self._port: str | None = None
        self._well = True
        self._load_at = 0.0
        budget = budget or Budget()
        labels = {label: tuple(m.name for m in group) for label, group in self._groups.items()}
        simulator: dict[str, tuple[str, ...]] = {SIMULATOR: ()} if plan.simulated else {}
        parameters = Parameters(
            host=plan.host,
            processes=simulator | labels,
            can=tuple(self._lent),
            needs=plan.needs,
            router=next(owners((m.name for m in plan.members), WHEELS), ""),
            restarts=budget.restarts,
            within_s=budget.within_s,
        )
        self.wakeup = Wakeup(identity(Wakeup.name, plan.host), parameters)
        self._agents = AgentHost(
            [self.wakeup],
            mesh,
            {self.wakeup.instance: lambda: self.machine},
            head=head if plan.journal else None,
        )
        self._thread = threading.Thread(target=self._live, name="wakeup", daemon=True)

    def __enter__(self) -> Upkeep:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self._thread.is_alive():
            self._agents.request_stop()
            self._thread.join(LEAVE_S)
        self.table.end()
        self._relay()
        if self._well and (kind is None or issubclass(kind, KeyboardInterrupt)):
            self.table.remove_logs()

    def start(self) -> None:
        """Start all processes. Raises RunFailedError if the simulator does not start."""
        self._thread.start()
        if self.plan.simulated is not None:
            self._start(SIMULATOR)
        for label in self._groups:
            self._start(label)

    def keep(self, ready: Callable[[float], None]) -> None:
        """Keep all processes running until interrupted. Raises GaveUpError if the budget is spent.

        `ready` is told, once, how long it took (s) until everybody could be seen on the mesh.
        """
        begun = time.monotonic()
        while True:
            order = self._ordered()
            if order is not None and order.do is Do.READY:
                ready(time.monotonic() - begun)
            elif order is not None:
                self._obey(order)
            self._mourn()
            self._weigh()
            self._relay()

    # The wakeup agent ----------------------------------------------------------------------------

    def _live(self) -> None:
        """Run the wakeup agent's thread; an exception in it ends the share."""
        try:
            self._agents.live()
            why = self._agents.refusal
        except Exception as error:  # without this thread no process would be restarted
            why = f"{type(error).__name__}: {error}"
        if why:
            self.machine.orders.put(Order(Do.GIVE_UP, text=f"the wakeup agent is gone: {why}"))
        self._agents.leave()

    def _ordered(self) -> Order | None:
        """Return the next order, or None after a while."""
        try:
            return self.machine.orders.get(timeout=LOOK_S)
        except queue.Empty:
            return None

    def _obey(self, order: Order) -> None:
        process = self.table.named(order.label)
        match order.do:
            case Do.START if process is None:
                try:
                    self._start(order.label)
                except OSError as error:  # out of memory or processes: as if it had ended at once
                    self.machine.tell(Event(order.label, 0, "no start", 1, str(error)))
            case Do.KILL if process is not None:
                process.popen.kill()
            case Do.END if process is not None:
                process.popen.terminate()
                self._ending[order.label] = time.monotonic() + LEAVE_S
            case Do.SAY:
                self._relay()  # the process's own log lines come first
                self._say(order.text)
            case Do.GIVE_UP:
                self._relay()
                raise GaveUpError(order.text)

    # Starting ------------------------------------------------------------------------------------

    def _start(self, label: str) -> None:
        if label == SIMULATOR:
            process = self._start_simulator()
        else:
            process = self.table.start_agents(label, self._members(label))
        self._tails.setdefault(label, Tail(label, process.log))
        self.machine.tell(Event(label, process.popen.pid))

    def _members(self, label: str) -> list[Member]:
        """Return the agents of a process, with the simulator's port for the robot agent."""
        return [
            Member(member.name, (*member.sets, f"port={self._port}"))
            if self._port is not None and "port" in agent_class(member.name).launched_with
            else member
            for member in self._groups.get(label) or self._lent[label]
        ]

    def _start_simulator(self) -> Process:
        """Start the simulator; a restart uses the same port, which the robot agent knows."""
        assert self.plan.simulated is not None, "there was one"
        port = 0 if self._port is None else int(self._port.rpartition(":")[2])
        process = self.table.start_simulator(self.plan.simulated, self.plan.seed, port)
        if self._port is None:
            self._port = process.announced()[0]
        return process

    # Watching ------------------------------------------------------------------------------------

    def _mourn(self) -> None:
        """Report ended processes to the wakeup agent, and kill those that are overdue."""
        for label, at in self._ending.items():
            if time.monotonic() >= at and (process := self.table.named(label)) is not None:
                process.popen.kill()
        for process in self.table.take_ended():
            label, code = process.name, process.popen.returncode
            self._well &= self._ending.pop(label, None) is not None
            self.machine.tell(Event(label, 0, ending(code), code, process.last_words()))

    def _weigh(self) -> None:
        """Report the machine's load to the wakeup agent regularly."""
        if time.monotonic() >= self._load_at:
            self._load_at = time.monotonic() + LOAD_S
            self.machine.tell(Load(psutil.getloadavg()[0] / (psutil.cpu_count() or 1)))

    def _relay(self) -> None:
        """Pass on warnings and errors in the processes' logs."""
        for tail in self._tails.values():
            for line in tail.loud():
                self._say(line)
            tail.turn()
