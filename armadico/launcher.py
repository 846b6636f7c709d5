"""A run as real processes on this machine: simulator, robot agent and every agent, on Zenoh.

The launcher starts them, hands the mission over, watches, and takes everything down again, whatever
happens. It decides nothing: kill it and the society drives on.
"""

from __future__ import annotations

import os
import re
import selectors
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import IO, TYPE_CHECKING, Self

from armadico.agent import WARNING
from armadico.client import Client
from armadico.config.scenarios import Scenario
from armadico.coordination import LISTEN
from armadico.measures import WATCHED, Result, RunWatch
from armadico.messages import Log, Message, MissionReply, Pose, RobotState
from armadico.rehearsal import MissionRefusedError
from armadico.society import Member, Options, members, mission, time_limit, watch

if TYPE_CHECKING:
    from armadico.mesh.zenoh import ZenohMesh

START_S = 20.0
"""What the processes may take to start."""

ANSWER_S = 10.0
"""What the robot may take to answer once its agent is there."""

HEAR_S = 5.0
"""What the interface agent may take to be found; its plan may take longer."""

LINKS_S = 2.0
"""A refusal stands after this: among processes that have just started, links are coming up."""

AGAIN_S = 0.5
"""How long until a mission that was refused is asked for again."""

LEAVE_S = 3.0
"""What a process may take to leave before it is killed."""

SILENT_S = 10.0
"""A run whose robot has said nothing for so long is over."""

ANNOUNCED = re.compile(r" at (tcp://[^;\s]+)")
"""Where the simulator's first line on standard output says that it listens."""


class RunFailedError(RuntimeError):
    """The run cannot begin or go on; the message says why, and what to do."""


class Process:
    """One process of the society, and where its last words are kept."""

    def __init__(self, name: str, command: Sequence[str], log: Path, *, listen: bool = False):
        self.name = name
        self.log = log
        with log.open("wb") as errors:
            self.popen: subprocess.Popen[bytes] = subprocess.Popen(
                [sys.executable, "-m", *command],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE if listen else errors,
                stderr=errors,
                start_new_session=True,  # Ctrl-C is the launcher's; it tells them in order
            )

    def ended(self) -> bool:
        """Whether it is gone."""
        return self.popen.poll() is not None

    def last_words(self, lines: int = 5) -> str:
        """The end of what it wrote."""
        text = self.log.read_text(errors="replace").strip().splitlines()
        return "\n".join(f"    {line}" for line in text[-lines:])


class Launcher:
    """The processes of one run; a context manager that leaves nothing running."""

    def __init__(
        self,
        scenario: Scenario,
        options: Options,
        mesh: ZenohMesh,
        namespace: str,
        *,
        silent_s: float = SILENT_S,
        joining: Sequence[str] = (),
    ) -> None:
        """Prepare.

        Args:
            scenario: What is driven, and who takes part.
            options: What else was chosen for the run.
            mesh: Where the launcher listens.
            namespace: The robot's subtree of keys.
            silent_s: A run whose robot has said nothing for so long is over.
            joining: Options by which the processes find the mesh, if it is not the default one.
        """
        self.scenario = scenario
        self.options = options
        self.members: tuple[Member, ...] = ()
        self.client = Client(mesh)
        self.watch = watch(scenario, options)
        self.limit = time_limit(0.0)
        self.logs = Path(tempfile.mkdtemp(prefix="armadico-"))
        self.processes: list[Process] = []
        self._namespace = namespace
        self._silent_s = silent_s
        self._joining = tuple(joining)
        self._warn: Callable[[str], None] = lambda _: None
        self._warned = ""
        self._mourned: set[Process] = set()
        self.client.listen(*WATCHED, then=self.watch.show)
        self.client.listen(Log, then=self._pass_on)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.stop()
        if error is None and not self._mourned:
            shutil.rmtree(self.logs, ignore_errors=True)  # nothing went wrong: nothing to read

    # Starting ------------------------------------------------------------------------------------

    def start(self) -> None:
        """Start everything. Raises RunFailedError if somebody is here or does not come up."""
        self._refuse_company()
        port = self.options.robot or self.start_simulator()
        self.members = members(self.scenario, self.options, port)
        for member in self.members:
            self.start_agent(member)
        self._wait_for_everybody()
        self._wait_for_the_robot(port)
        self._refuse_a_second_robot()

    def begin(self) -> None:
        """Hand the mission over. Raises MissionRefusedError or RunFailedError."""
        reply = self._ask()
        until = time.monotonic() + LINKS_S
        while reply.refusal and time.monotonic() < until:
            self.client.wait_for(lambda: None, AGAIN_S)
            reply = self._ask()
        if reply.refusal:
            raise MissionRefusedError(reply.refusal)
        self.limit = time_limit(reply.length)
        self.watch.begin(reply.mission)

    def _ask(self) -> MissionReply:
        reply = self.client.ask(mission(self.scenario), timeout=30.0, patience=HEAR_S)
        if not isinstance(reply, MissionReply):
            raise RunFailedError("no interface agent answered mission/request")
        return reply

    def run(
        self,
        progress: Callable[[RunWatch], None] | None = None,
        warn: Callable[[str], None] | None = None,
    ) -> Result:
        """Drive to the goal or the time limit; `warn` is told who is gone and what goes wrong."""
        self._warn = warn or self._warn
        self.start()
        self.begin()
        end = time.monotonic() + self.limit
        while not self.watch.done and time.monotonic() < end:
            self.client.wait_for(lambda: self.watch.done, 0.2)
            if progress is not None:
                progress(self.watch)
            self._mourn()
        return self.watch.result()

    def _refuse_company(self) -> None:
        """A robot that is in the namespace already is not ours to drive."""
        self.client.settle()
        there = self._robots()
        if there:
            raise RunFailedError(
                f"a robot is in the namespace {self._namespace!r} already: {there[0]}"
                " (armadico ps shows whose); use another one: --namespace NAME"
            )

    def _refuse_a_second_robot(self) -> None:
        """Two runs that begin together find nobody, and then drive each other's robots."""
        robots = self._robots()
        if len(robots) > 1:
            raise RunFailedError(
                f"another robot came into the namespace {self._namespace!r} meanwhile:"
                f" {', '.join(robots)}; use another one: --namespace NAME"
            )

    def _robots(self) -> list[str]:
        """The instances of robot agents in the namespace."""
        return [instance for name, instance in sorted(self.client.alive) if name == "robot"]

    def start_simulator(self, port: int = 0) -> str:
        """Start a simulator on a TCP port, 0: one that is free; returns its URL."""
        scenario = self.scenario
        x, y, degrees = scenario.start
        process = Process(
            "simulator",
            [
                "armadico",
                "sim",
                scenario.world,
                f"--port={port}",
                f"--seed={self.options.seed}",
                f"--sensors={scenario.sensors}",
                f"--robot={scenario.robot}",
                f"--namespace={self._namespace}",
                *self._joining,
                *("--start", str(x), str(y), str(degrees)),
            ],
            self.logs / "simulator.log",
            listen=True,
        )
        self.processes.append(process)
        assert process.popen.stdout is not None, "it was asked for"
        line = _line(process.popen.stdout, START_S)
        found = ANNOUNCED.search(line)
        if found is None:
            raise RunFailedError(f"the simulator did not start:\n{process.last_words()}")
        return found.group(1)

    def start_agent(self, member: Member) -> Process:
        """Start one agent as a process."""
        settings = [word for value in member.sets for word in ("--set", value)]
        process = Process(
            member.name,
            [
                *("armadico", "agent", member.name, "--namespace", self._namespace),
                *self._joining,
                *settings,
            ],
            self.logs / f"{member.name}.log",
        )
        self.processes.append(process)
        return process

    def _wait_for_everybody(self) -> None:
        """Until all tokens are there."""
        names = {member.name for member in self.members}

        def here() -> bool:
            self._check_alive()
            return names <= {name for name, _ in self.client.alive}

        if not self.client.wait_for(here, START_S):
            missing = names - {name for name, _ in self.client.alive}
            raise RunFailedError(
                f"did not start within {START_S:.0f} s: {', '.join(sorted(missing))}"
            )

    def _wait_for_the_robot(self, port: str) -> None:
        """Until it talks and obeys, and the encoder agent, if it takes part, knows where it is."""
        kinds: list[type[Message]] = [RobotState]
        if any(member.name == "encoder" for member in self.members):
            kinds.append(Pose)

        def talks() -> bool:
            self._check_alive()
            state = self.client.latest(RobotState)
            listens = state is None or state.frame.number <= LISTEN  # and refuses, meanwhile
            return not listens and all(self.client.age(kind) < 1.0 for kind in kinds)

        if not self.client.wait_for(talks, ANSWER_S):
            raise RunFailedError(
                f"the robot on {port} did not answer within {ANSWER_S:.0f} s;"
                f" the robot agent says:\n{self._last_words('robot')}"
            )

    # While it runs -------------------------------------------------------------------------------

    def _check_alive(self) -> None:
        for process in self.processes:
            if process.ended():
                code = process.popen.returncode
                raise RunFailedError(
                    f"{process.name} ended with status {code}:\n{process.last_words()}"
                )

    def _mourn(self) -> None:
        """Say once who has gone; without the robot there is no run."""
        for process in self.processes:
            if process.ended() and process not in self._mourned:
                self._mourned.add(process)
                self._warn(f"{process.name} is gone (status {process.popen.returncode})")
        if self.client.age(RobotState) > self._silent_s:
            raise RunFailedError(
                f"the robot has said nothing for {self._silent_s:g} s;"
                f" the robot agent says:\n{self._last_words('robot')}"
            )

    def _pass_on(self, message: Message, _now: float) -> None:
        """What an agent says of faults is said to whoever runs it, too."""
        if isinstance(message, Log) and message.level >= WARNING and message.text != self._warned:
            self._warned = message.text
            self._warn(message.text)

    def _last_words(self, name: str) -> str:
        """Of the newest process of that name."""
        words = [process.last_words() for process in self.processes if process.name == name]
        return words[-1] if words else "    nothing"

    # Leaving -------------------------------------------------------------------------------------

    def stop(self) -> None:
        """Take everything down: the behaviours let go, the robot stops, the simulator ends last.

        A second Ctrl-C does not interrupt it: it is bounded, and nothing may be left behind.
        """
        simulators = [p for p in self.processes if p.name == "simulator"]
        robots = [p for p in self.processes if p.name == "robot"]
        others = [p for p in self.processes if p not in simulators and p not in robots]
        with _undisturbed():
            for group in (others, robots, simulators):
                _end(group)
        self.processes.clear()


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Without SIGINT; only the main thread could be disturbed by it."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _end(processes: Sequence[Process]) -> None:
    """Ask them to leave, and kill whoever does not."""
    for process in processes:
        with suppress(ProcessLookupError):
            process.popen.terminate()
    deadline = time.monotonic() + LEAVE_S
    for process in processes:
        try:
            process.popen.wait(max(deadline - time.monotonic(), 0.0))
        except subprocess.TimeoutExpired:
            process.popen.kill()
            process.popen.wait()
        if process.popen.stdout is not None:
            process.popen.stdout.close()


def _line(pipe: IO[bytes], timeout: float) -> str:
    """The first line of a pipe, or what there is of it in time."""
    data = b""
    deadline = time.monotonic() + timeout
    with selectors.DefaultSelector() as selector:
        selector.register(pipe, selectors.EVENT_READ)
        while b"\n" not in data and (left := deadline - time.monotonic()) > 0:
            if not selector.select(left):
                break
            chunk = os.read(pipe.fileno(), 4096)
            if not chunk:
                break
            data += chunk
    return data.decode(errors="replace").partition("\n")[0]
