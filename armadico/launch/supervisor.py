"""Processes of one host: the machine of the wakeup agent (`armadico.agents.supervision.wakeup`).

The wakeup agent decides what starts when. It runs on the mesh, in a thread of this process. The
processes are tied to the main thread.
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
from armadico.core.discovery import agent_class, owners
from armadico.core.resources import WHEELS
from armadico.core.restart_policy import Budget
from armadico.launch.processes import (
    SIMULATOR,
    Process,
    ProcessTable,
    ending,
    logs_folder,
    undisturbed,
)
from armadico.launch.programs import LEAVE_S
from armadico.launch.society import Member, processes
from armadico.mesh.sockets import STOP_SIGNAL
from armadico.observe.journals import head
from armadico.runtime.errors import RunFailedError
from armadico.runtime.process import AgentHost, identity
from armadico.runtime.signals import await_signals

if TYPE_CHECKING:
    from armadico.config.scenarios import Scenario
    from armadico.mesh.base import Mesh

POLL_S: Final = 0.05
"""Polling period for ended processes and new log lines, s."""

LOAD_S: Final = 2.0
"""Period of reading the machine's load, s."""

LOG_BYTES: Final = 4_000_000
"""A longer log is moved to NAME.log.1."""

_LINE = re.compile(r"^\d\d:\d\d:\d\d\.\d{3} \S+ (?P<level>[A-Z]+) ")
_LOUD = ("WARNING", "ERROR", "CRITICAL")


class GaveUpError(RunFailedError):
    """A process ended and is not restarted; the message has its name, the reason and its output."""


@dataclass(frozen=True)
class Plan:
    """Agents to run on this host, and a simulator if the robot agent has no robot."""

    host: str
    namespace: str
    members: tuple[Member, ...]
    simulated: Scenario | None = None
    seed: int = 0
    joining: tuple[str, ...] = ()
    """Options by which the processes find the mesh."""
    together: tuple[tuple[str, ...], ...] = ()
    """Groups of agents that share a process."""
    can: tuple[Member, ...] = ()
    """Agents that it starts on request if their own host is gone."""
    needs: tuple[str, ...] = ()
    """Agents of the whole society that the scenario cannot do without."""
    journal: bool = False
    """Whether the agents publish their inputs and outputs."""
    table: str = ""
    """The digest of the host table; empty: none."""


@dataclass
class Tail:
    """Reads new warnings and errors from a log."""

    name: str
    log: Path
    _read: int = 0
    _rest: str = ""
    _loud: bool = True
    lines: list[str] = field(default_factory=list)

    def loud(self) -> list[str]:
        """New lines at WARNING and above with their continuation lines, prefixed with the name."""
        try:
            if self.log.stat().st_size < self._read:
                self._read, self._rest = 0, ""  # the file was replaced
            with self.log.open("rb") as file:
                file.seek(self._read)
                data = file.read()
        except OSError:  # the log may be deleted, as a temporary file: the society continues
            return []
        if data:
            self._read += len(data)
            *lines, self._rest = (self._rest + data.decode(errors="replace")).split("\n")
            return [text for line in lines if (text := self._format(line))]
        return []

    def turn(self) -> None:
        """Truncate a long log; keep a copy if there is room on the disk."""
        if self._read > LOG_BYTES:
            with suppress(OSError):
                shutil.copyfile(self.log, self.log.with_suffix(".log.1"))
            with suppress(OSError), self.log.open("r+b") as file:
                file.truncate()
            self._read = 0

    def _format(self, line: str) -> str:
        """The line to pass on, or ""."""
        found = _LINE.match(line)
        if found is None:  # continues the line above, as a traceback does
            return f"{self.name}: {line}" if self._loud else ""
        self._loud = found["level"] in _LOUD
        return f"{self.name}: {found['level']} {line[found.end() :]}" if self._loud else ""


class Machine:
    """The wakeup agent's port: passes orders to the main thread, and events back."""

    def __init__(self) -> None:
        self.orders: queue.SimpleQueue[Order] = queue.SimpleQueue()
        self.events: queue.SimpleQueue[Event | Load] = queue.SimpleQueue()

    def read(self, timeout_s: float) -> bytes:
        try:
            return lines(self.events.get(timeout=timeout_s))
        except queue.Empty:
            return b""

    def write(self, data: bytes) -> None:
        for order in orders(data):
            self.orders.put(order)

    def close(self) -> None:
        """See `Port`."""


class Upkeep:
    """Keeps a share up; a context manager that ends all its processes."""

    def __init__(
        self, plan: Plan, mesh: Mesh, report: Callable[[str], None], budget: Budget | None = None
    ) -> None:
        """`report` receives warnings and errors, a line at a time."""
        self.plan = plan
        self.table = ProcessTable(
            plan.namespace,
            logs_folder(plan.namespace),
            plan.joining,
            tied=True,
            journal=plan.journal,
        )
        self.machine = Machine()
        self._report = report
        self._groups = processes(plan.members, plan.together)
        self._lent = {member.name: (member,) for member in plan.can}
        self._tails: dict[str, Tail] = {}
        self._ending: dict[str, float] = {}  # by label: time of SIGKILL after SIGTERM
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
        self.wakeup = Wakeup(identity(Wakeup.name, plan.host, plan.table), parameters)
        self._agents = AgentHost(
            [self.wakeup],
            mesh,
            {self.wakeup.instance: lambda: self.machine},
            head=head if plan.journal else None,
        )
        self._thread = threading.Thread(target=self._live, name="wakeup", daemon=True)

    def __enter__(self) -> Upkeep:
        # For `armadico stop` on this host, which signals this pid.
        await_signals({STOP_SIGNAL: self._agents.latch})
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        with undisturbed():
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
        """Keep all processes up until interrupted. Raises GaveUpError when the budget is spent.

        `ready` is called once with the time until all agents were on the mesh, s.
        """
        begun = time.monotonic()
        while True:
            order = self._ordered()
            if order is not None and order.do is Do.READY:
                ready(time.monotonic() - begun)
            elif order is not None:
                self._obey(order)
            self._report_ended()
            self._report_load()
            self._relay()

    # The wakeup agent ----------------------------------------------------------------------------

    def _live(self) -> None:
        """Run the wakeup agent; an early end of this thread ends the share."""
        try:
            self._agents.live()
            why = self._agents.refusal
        except Exception as error:  # any: without this agent nothing is restarted
            why = f"{type(error).__name__}: {error}"
        if why:
            self.machine.orders.put(Order(Do.GIVE_UP, text=f"the wakeup agent ended: {why}"))
        self._agents.leave()

    def _ordered(self) -> Order | None:
        """The next order, or None after `POLL_S`."""
        try:
            return self.machine.orders.get(timeout=POLL_S)
        except queue.Empty:
            return None

    def _obey(self, order: Order) -> None:
        process = self.table.named(order.label)
        match order.do:
            case Do.START if process is None:
                try:
                    self._start(order.label)
                except OSError as error:  # no memory or process left: as if it had ended at once
                    self.machine.events.put(Event(order.label, 0, "no start", 1, str(error)))
            case Do.KILL if process is not None:
                process.popen.kill()
            case Do.END if process is not None:
                process.popen.terminate()
                self._ending[order.label] = time.monotonic() + LEAVE_S
            case Do.SAY:
                self._relay()  # the log of the process comes first
                self._report(order.text)
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
        self.machine.events.put(Event(label, process.popen.pid))

    def _members(self, label: str) -> list[Member]:
        """Agents of a process, with the simulator's address and id for those that use them."""
        known = {"port": self._port, "simulator": self.table.simulator or None}
        return [
            Member(
                member.name,
                (
                    *member.sets,
                    *(
                        f"{fact}={value}"
                        for fact, value in known.items()
                        if value is not None and fact in agent_class(member.name).launched_with
                    ),
                ),
            )
            for member in self._groups.get(label) or self._lent[label]
        ]

    def _start_simulator(self) -> Process:
        """Start the simulator, again on the same port, where the robot agent expects it."""
        assert self.plan.simulated is not None, "there was one"
        port = 0 if self._port is None else int(self._port.rpartition(":")[2])
        process = self.table.start_simulator(self.plan.simulated, self.plan.seed, port)
        if self._port is None:
            self._port = process.announced()[0]
        return process

    # Watching ------------------------------------------------------------------------------------

    def _report_ended(self) -> None:
        """Report ended processes to the wakeup agent, and kill those that did not end in time."""
        for label, at in self._ending.items():
            if time.monotonic() >= at and (process := self.table.named(label)) is not None:
                process.popen.kill()
        for process in self.table.take_ended():
            label, code = process.name, process.popen.returncode
            self._well &= self._ending.pop(label, None) is not None
            self.machine.events.put(Event(label, 0, ending(code), code, process.last_lines()))

    def _report_load(self) -> None:
        """Report the machine's load to the wakeup agent."""
        if time.monotonic() >= self._load_at:
            self._load_at = time.monotonic() + LOAD_S
            self.machine.events.put(Load(psutil.getloadavg()[0] / (psutil.cpu_count() or 1)))

    def _relay(self) -> None:
        """Pass on warnings and errors from the logs."""
        for tail in self._tails.values():
            for line in tail.loud():
                self._report(line)
            tail.turn()
