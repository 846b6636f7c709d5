"""A run as real processes on this machine: simulator, robot agent and every agent, on Zenoh.

The launcher starts them, hands the mission over, watches, and takes everything down again, whatever
happens.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

from armadico.config.scenarios import Scenario
from armadico.core.restart_policy import MISUSED
from armadico.launch.processes import START_S, Process, ProcessTable, ending, logs_folder
from armadico.launch.run import IDLE_S, SILENT_S, LiveRun
from armadico.launch.society import Member, Options, members, processes
from armadico.mobile.messages import MissionStatus
from armadico.observe.measures import UNDER_WAY, Result, RunWatch
from armadico.runtime.errors import RunFailedError

if TYPE_CHECKING:
    from armadico.mesh.base import Mesh

ANSWER_S = 10.0
"""What the robot may take to answer once its agent is alive."""

ALONE_S = 5.0
"""What the agents of one of two runs may take to leave."""

NAMES_S = 3.0
"""What the name of another society's robot agent may take to be received."""

LOOK_S = 0.1

INSTEAD = (
    "--attach drives with it, --namespace NAME without; `armadico down` ends what a killed run"
    " has left"
)
"""What to do about somebody else's society."""


class Launcher(LiveRun):
    """The processes of one run; a context manager that leaves nothing running.

    Attributes:
        members: The agents that were started.
        table: Their processes, with the simulator's.
        ended: Those that ended before they were asked to.
    """

    def __init__(
        self,
        scenario: Scenario,
        options: Options,
        mesh: Mesh,
        namespace: str,
        *,
        silent_s: float = SILENT_S,
        idle_s: float = IDLE_S,
        joining: Sequence[str] = (),
        tied: bool = False,
        logs: Path | None = None,
    ) -> None:
        """Prepare.

        Args:
            scenario: As in `LiveRun`, and so are `options`, `mesh`, `silent_s` and `idle_s`.
            options: What else was chosen for the run.
            mesh: Where the launcher listens.
            namespace: The robot's subtree of keys.
            silent_s: When a silent robot ends the run.
            idle_s: When unclaimed wheels do.
            joining: As in `ProcessTable`, and so are `tied` and `logs`.
            tied: The processes leave when this one is killed.
            logs: The folder of the logs, shared with other robots; None: one of its own.
        """
        super().__init__(scenario, options, mesh, silent_s=silent_s, idle_s=idle_s)
        self.members: tuple[Member, ...] = ()
        self.table = ProcessTable(
            namespace,
            joining,
            tied,
            options.journal,
            logs or logs_folder(),
            prefix="" if logs is None else f"{namespace.rpartition('/')[2]}-",
        )
        self._namespace = namespace
        self.ended: set[Process] = set()

    @property
    def processes(self) -> list[Process]:
        return self.table.processes

    @property
    def logs(self) -> Path:
        return self.table.logs

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Take everything down; the logs stay unless the run passed or a person ended it."""
        began = bool(self.processes)
        self.stop()
        well = isinstance(error, KeyboardInterrupt)
        well |= error is None and self.watch.result().passed
        if not began or (well and not self.ended):
            self.table.remove_logs()

    def run(
        self,
        progress: Callable[[RunWatch], None] | None = None,
        warn: Callable[[str], None] | None = None,
    ) -> Result:
        """See `Run`. Wait for the end of another mission that takes the place of this run's.

        The processes end with the run, and the mission would with them.
        """
        result = super().run(progress, warn)
        if self.watch.replaced:
            self._warn(
                "another mission has taken this run's place; all that the run has started stays"
                " until that one is over, or until Ctrl-C"
            )
            while self._under_way():
                self.wait_on()
        return result

    def _under_way(self) -> bool:
        status = self.client.fresh(MissionStatus)
        return status is not None and status.state in UNDER_WAY

    # Starting ------------------------------------------------------------------------------------

    def start(self) -> None:
        """Start everything. Raises RunFailedError if others are alive, or one does not start."""
        self._refuse_company()
        port = self.options.robot or self.start_simulator()
        self.members = members(self.scenario, self.options, port)
        for name, group in processes(self.members, self.options.together).items():
            self.start_agent(*group, name=name)
        if not self._comes(lambda: not self._missing(), START_S):
            raise RunFailedError(
                f"did not start within {START_S:.0f} s: {', '.join(self._missing())}"
                " (`armadico doctor` checks ports and packages)"
            )
        self._refuse_a_second_run()
        if not self._comes(self._ready_to_drive, ANSWER_S):
            raise RunFailedError(
                f"the robot on {port} did not answer within {ANSWER_S:.0f} s;"
                f" {self.words_of_the_robot()}"
            )

    def _refuse_company(self) -> None:
        """A robot that is in the namespace already is not ours to drive."""
        self.client.settle()
        there = self._robots()
        if there:
            raise RunFailedError(
                f"a robot is in the namespace {self._namespace!r} already: {there[0][1]}"
                f" (armadico ps shows whose); {INSTEAD}"
            )

    def _refuse_a_second_run(self) -> None:
        """Of two runs that begin together one drives at most, and only with its own agents."""
        end = self.now() + ALONE_S
        seen: set[str] = set()  # a card that came once may be late the next time
        while strangers := self._others(who for who in self.client.alive if who[0] in self.names):
            seen.update(strangers)
            self._check_alive()  # an encoder agent that finds another leaves
            if self.now() >= end:
                raise RunFailedError(
                    f"others came into the namespace {self._namespace!r} meanwhile:"
                    f" {', '.join(sorted(seen))}; use another one: --namespace NAME"
                )
            self.client.wait_for(lambda: None, LOOK_S)

    def _others(self, agents: Iterable[tuple[str, str]]) -> list[str]:
        """Instances of agents, by their names and instances, that somebody else has started."""
        ours = {process.popen.pid for process in self.processes}
        cards = [self.client.card(*who) for who in sorted(agents)]
        return [card.instance for card in cards if card is not None and card.pid not in ours]

    def start_simulator(self, port: int = 0) -> str:
        """Start a simulator on a TCP port, 0: one that is free; returns its URL."""
        return self.table.start_simulator(self.scenario, self.options.seed, port).announced()[0]

    def start_agent(self, *group: Member, name: str = "") -> Process:
        """Start an agent as a process, or several as one; by default it is called as the first."""
        return self.table.start_agents(name or group[0].name, group)

    def _comes(self, condition: Callable[[], bool], within: float) -> bool:
        """Whether something becomes so; without a robot agent nothing arrives, and it is polled.

        Raises RunFailedError if a process has ended.
        """

        def comes() -> bool:
            self._check_alive()
            return condition()

        end = self.now() + within
        while not self.client.wait_for(comes, LOOK_S):
            if self.now() >= end:
                return False
        return True

    # While it runs -------------------------------------------------------------------------------

    def _check_alive(self) -> None:
        for process in self.processes:
            if process.ended():
                said = f"{ending(process.popen.returncode)}:\n{process.last_words()}"
                if process.popen.returncode == MISUSED:
                    said += self._company(process.name)
                raise RunFailedError(f"{process.name} ended with {said}")

    def _company(self, name: str) -> str:
        """What to say of the society in whose way an agent was; empty if there is none.

        The agent may have received tokens and cards that have not come here yet: they are waited
        for, `NAMES_S` at most.
        """
        found = self.client.wait_for(lambda: self._others(self._robots()), NAMES_S)
        if not found and not any(other == name for other, _ in self.client.alive):
            return ""
        whose = f", with the robot agent {found[0]}" if found else ""
        return f"\nA society is up in the namespace {self._namespace!r}{whose}: {INSTEAD}"

    def poll(self) -> None:
        """Say once who has gone.

        Raises RunFailedError if another's agent has taken the place of one.
        """
        for process in self.processes:
            if process.ended() and process not in self.ended:
                self.ended.add(process)
                if process.popen.returncode == MISUSED:  # another's of its kind is there
                    self._check_alive()
                self._warn(
                    f"{process.name} is gone ({ending(process.popen.returncode)});"
                    f" its last words, of {process.log}:\n{process.last_words()}"
                )
        super().poll()

    def words_of_the_robot(self) -> str:
        """The last words of the newest robot agent."""
        words = [process.last_words() for process in self.processes if process.has_robot]
        return f"the robot agent says:\n{words[-1] if words else '    nothing'}"

    # Leaving -------------------------------------------------------------------------------------

    def stop(self) -> None:
        """Take everything down: the behaviours let go, the robot stops, the simulator ends last."""
        self.table.end()
