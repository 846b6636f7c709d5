"""One host's share of a society as processes: started, watched, started again, taken down.

The thesis's wakeup agent, and for now its monitor. It decides nothing about who drives.
"""

from __future__ import annotations

import re
import shutil
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

from armadico.config.discovery import agent_class
from armadico.core.restart_policy import Budget, Supervision
from armadico.launch.processes import (
    SIMULATOR,
    Process,
    StartError,
    agent_words,
    end_in_order,
    ending,
    simulator_words,
)
from armadico.launch.society import Member, processes
from armadico.runtime.client import Client

if TYPE_CHECKING:
    from armadico.config.scenarios import Scenario
    from armadico.core.messages import Card
    from armadico.mesh.zenoh import ZenohMesh

LOOK_S: Final = 0.05
"""How often ended processes and new log lines are looked for."""

CARD_S: Final = 0.5
"""What an agent may take to answer the query for its card, before it is queried again."""

LOG_BYTES: Final = 4_000_000
"""A log that is longer is kept as NAME.log.1, and begun anew."""

_LINE = re.compile(r"^\d\d:\d\d:\d\d\.\d{3} \S+ (?P<level>[A-Z]+) ")
_LOUD = ("WARNING", "ERROR", "CRITICAL")


class GaveUpError(RuntimeError):
    """A process ended, and starting it again has no use; the message says which, why, and more."""


@dataclass(frozen=True)
class Plan:
    """What is to be up: the agents, and a simulator if the robot agent has no robot."""

    host: str
    namespace: str
    members: tuple[Member, ...]
    simulated: Scenario | None = None
    seed: int = 0
    joining: tuple[str, ...] = ()
    """Options by which the processes find the mesh."""
    together: tuple[tuple[str, ...], ...] = ()
    """Agents that share a process."""


@dataclass
class Tail:
    """New lines of a log, as far as people need to know them."""

    name: str
    log: Path
    _read: int = 0
    _rest: str = ""
    _loud: bool = True
    lines: list[str] = field(default_factory=list)

    def loud(self) -> list[str]:
        """New lines at WARNING and worse, and what belongs to them, with the agent's name."""
        size = self.log.stat().st_size
        if size > self._read:
            with self.log.open("rb") as file:
                file.seek(self._read)
                data = file.read()
            self._read += len(data)
            *lines, self._rest = (self._rest + data.decode(errors="replace")).split("\n")
            return [said for line in lines if (said := self._said(line))]
        return []

    def turn(self) -> None:
        """Begin the file anew once it is long; what it held stays beside it."""
        if self._read > LOG_BYTES:
            shutil.copyfile(self.log, self.log.with_suffix(".log.1"))
            with self.log.open("r+b") as file:
                file.truncate()
            self._read = 0

    def _said(self, line: str) -> str:
        """A line as it is passed on; empty if it is not."""
        found = _LINE.match(line)
        if found is None:  # the rest of what began above: a traceback, say
            return f"{self.name}: {line}" if self._loud else ""
        self._loud = found["level"] in _LOUD
        return f"{self.name}: {found['level']} {line[found.end() :]}" if self._loud else ""


class Upkeep:
    """Keeps a share up; a context manager that leaves nothing running."""

    def __init__(
        self, plan: Plan, mesh: ZenohMesh, say: Callable[[str], None], budget: Budget | None = None
    ) -> None:
        """`say` is told what goes wrong, a line at a time."""
        self.plan = plan
        self.supervision = Supervision(budget)
        self.logs = Path(tempfile.mkdtemp(prefix="armadico-"))
        self.processes: dict[str, Process] = {}
        self._client = Client(mesh)
        self._say = say
        self._groups = processes(plan.members, plan.together)
        self._tails: dict[str, Tail] = {}
        self._port: str | None = None
        self._seen: dict[tuple[str, str], Card] = {}
        self._ask_at: dict[tuple[str, str], float] = {}  # when who has not answered is asked anew
        self._waiting: dict[str, float] = {}  # who has not been seen since, s
        self._well = True

    def __enter__(self) -> Upkeep:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        end_in_order(list(self.processes.values()))
        self._relay()
        if self._well and (kind is None or issubclass(kind, KeyboardInterrupt)):
            shutil.rmtree(self.logs, ignore_errors=True)  # nothing went wrong: nothing to read

    def start(self) -> None:
        """Start everything. Raises GaveUpError if the simulator does not come up."""
        if self.plan.simulated is not None:
            self._start_simulator(self.plan.simulated)
        for label in self._groups:
            self._start(label)

    def keep(self, ready: Callable[[float], None]) -> None:
        """Keep everything up until interrupted. Raises GaveUpError when the budget is spent.

        `ready` is told, once, how long it took (s) until everybody could be seen on the mesh.
        """
        begun, told = time.monotonic(), False
        while True:
            self._client.wait_for(self._anybody_ended, LOOK_S)
            self._mourn()
            for label in self.supervision.due(time.monotonic()):
                self._start_again(label)
            self._relay()
            self._greet()
            if not (told or self._waiting):
                told = True
                ready(time.monotonic() - begun)

    # Starting ------------------------------------------------------------------------------------

    def _start_simulator(self, scenario: Scenario) -> None:
        port = 0 if self._port is None else int(self._port.rpartition(":")[2])
        words = simulator_words(scenario, self.plan.seed, self.plan.namespace, port)
        process = self._run(SIMULATOR, words, listen=True)
        if self._port is None:  # later ones take the same port, and the robot agent finds them
            try:
                self._port = process.announced()[0]
            except StartError as error:
                self._well = False
                raise GaveUpError(str(error)) from None

    def _start(self, label: str) -> None:
        group = [
            Member(member.name, (*member.sets, f"port={self._port}"))
            if self._port is not None and "port" in agent_class(member.name).launched_with
            else member
            for member in self._groups[label]
        ]
        self._run(label, agent_words(group, self.plan.namespace))
        self._waiting[label] = time.monotonic()

    def _start_again(self, label: str) -> None:
        if label == SIMULATOR:
            assert self.plan.simulated is not None, "there was one"
            self._start_simulator(self.plan.simulated)
        else:
            self._start(label)

    def _run(self, label: str, words: Sequence[str], *, listen: bool = False) -> Process:
        log = self.logs / f"{label}.log"
        before = self.processes.get(label)
        if before is not None and before.popen.stdout is not None:
            before.popen.stdout.close()
        process = Process(label, [*words, *self.plan.joining], log, listen=listen, tied=True)
        self.processes[label] = process
        self._tails.setdefault(label, Tail(label, log))
        return process

    # Watching ------------------------------------------------------------------------------------

    def _anybody_ended(self) -> bool:
        return any(process.ended() for process in self.processes.values())

    def _mourn(self) -> None:
        for label, process in list(self.processes.items()):
            if not process.ended():
                continue
            del self.processes[label]
            self._waiting.setdefault(label, time.monotonic())
            self._well = False
            code = process.popen.returncode
            why = self.supervision.ended(label, code, time.monotonic())
            if why is not None:
                self._relay()
                raise GaveUpError(
                    f"{label} ended with {ending(code)}, and is not started again: {why}."
                    f" Its last words:\n{process.last_words()}"
                )
            if self.supervision.kept_out(label):
                self._relay()  # it says itself who
                self._say(
                    f"{label} left: somebody is in its way; the others go on, and it is tried"
                    " again now and then"
                )
            else:
                self._say(f"{label} ended with {ending(code)}; it is started again")

    def _relay(self) -> None:
        """Pass on what the processes log of faults."""
        for tail in self._tails.values():
            for line in tail.loud():
                self._say(line)
            tail.turn()

    def _greet(self) -> None:
        """See who is on the mesh by now; the simulator is no agent, and is not waited for.

        Cards are asked for all at once, and come while the loop waits: one that hangs, here or on
        another host, delays nobody.
        """
        self._waiting.pop(SIMULATOR, None)
        if not self._waiting:
            return
        awaited = {m.name for label in self._waiting for m in self._groups.get(label, ())}
        now = time.monotonic()
        for who in sorted(self._client.alive):
            asked = who in self._seen or self._ask_at.get(who, now) > now
            if who[0] in awaited and not asked:
                self._ask_at[who] = now + CARD_S
                self._client.request_card(*who, CARD_S, partial(self._answered, who))
        here = {(c.name, c.pid) for c in self._seen.values() if c.host == self.plan.host}
        for label, process in self.processes.items():
            group = self._groups.get(label, ())
            up = all((member.name, process.popen.pid) in here for member in group)
            if up and self._waiting.pop(label, None) is not None:
                self.supervision.began(label, now)

    def _answered(self, who: tuple[str, str], card: Card | None) -> None:
        self._ask_at.pop(who, None)
        if card is not None:
            self._seen[who] = card
