"""A run as real processes on this machine: the simulator and every agent, on Zenoh.

The launcher starts them, sends the mission, watches, and ends everything, also after an error.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

from armadico.config.scenarios import Scenario
from armadico.core.restart_policy import MISUSED
from armadico.launch.processes import SIMULATOR, START_S, Process, ProcessTable, ending, logs_folder
from armadico.launch.run import LiveRun
from armadico.launch.society import Member, Options, members, processes
from armadico.mobile.messages import MissionStatus
from armadico.observe.measures import UNDER_WAY, Phase, Result, RunWatch
from armadico.runtime.errors import RunFailedError

if TYPE_CHECKING:
    from armadico.mesh.base import Mesh

ANSWER_S = 10.0
"""Time for the robot to answer once its agent is alive."""

ALONE_S = 5.0
"""Time for the agents of a second run to leave."""

NAMES_S = 3.0
"""Time to receive the name of another society's robot agent."""

POLL_S = 0.1

INSTEAD = (
    "--attach drives with it, --namespace NAME starts another one; `armadico down` ends the rest"
    " of a killed run"
)
"""What to do about another society in the namespace."""


class Launcher(LiveRun):
    """The processes of one run; a context manager that leaves nothing running."""

    def __init__(
        self,
        scenario: Scenario,
        options: Options,
        mesh: Mesh,
        namespace: str,
        *,
        joining: Sequence[str] = (),
        tied: bool = False,
        logs: Path | None = None,
    ) -> None:
        """`scenario`, `options` and `mesh` are as in `LiveRun`, others as in `ProcessTable`.

        `logs` is a folder shared with other robots; None: its own.
        """
        options = replace(options, namespace=namespace)
        super().__init__(scenario, options, mesh)
        self.members: tuple[Member, ...] = ()  # the agents that were started
        # Their processes, with the simulator's.
        self.table = ProcessTable(
            namespace,
            logs or logs_folder(namespace),
            joining,
            tied,
            options.journal,
            prefix="" if logs is None else f"{namespace.rpartition('/')[2]}-",
        )
        self._namespace = namespace
        self.ended: set[Process] = set()  # processes that ended during the run

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
        """End everything; the logs stay unless the run passed or Ctrl-C ended it."""
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
        """See `Run`. If another mission replaces this run's, wait until that one ends.

        Otherwise it would lose its processes, which end with the run.
        """
        result = super().run(progress, warn)
        if self.watch.phase is Phase.REPLACED:
            self._warn(
                "another mission has replaced this run's; the processes stay until it ends, or"
                " until Ctrl-C"
            )
            while self._under_way():
                self.wait_on()
        return result

    def _under_way(self) -> bool:
        status = self.client.fresh(MissionStatus)
        return status is not None and status.state in UNDER_WAY

    # Starting ------------------------------------------------------------------------------------

    def start(self) -> None:
        """Start everything. Raises RunFailedError if another robot is there, or a start fails."""
        self._refuse_company()
        port = self.options.robot or self.start_simulator()
        simulator = self.options.simulator or self.table.simulator
        self.watch.view.simulator = simulator
        options = replace(self.options, simulator=simulator)
        self.members = members(self.scenario, options, port)
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
                f"the robot on {port} did not answer within {ANSWER_S:.0f} s; {self.robot_advice()}"
            )

    def _refuse_company(self) -> None:
        """Raises RunFailedError if a robot is in the namespace already."""
        self.client.settle()
        robots = self._robots()
        if robots:
            raise RunFailedError(
                f"a robot agent is already in the namespace {self._namespace!r}: {robots[0][1]}"
                f" (see armadico ps); {INSTEAD}"
            )

    def _refuse_a_second_run(self) -> None:
        """Raises RunFailedError if another run has started agents at the same time."""
        end = self.now() + ALONE_S
        seen: set[str] = set()  # kept, since a card may be late the next time
        while strangers := self._others(one for one in self.client.alive if one[0] in self.names):
            seen.update(strangers)
            self._check_alive()  # an encoder agent that finds another one ends
            if self.now() >= end:
                raise RunFailedError(
                    f"other agents joined the namespace {self._namespace!r} during the start:"
                    f" {', '.join(sorted(seen))}; use --namespace NAME"
                )
            self.client.wait_for(lambda: None, POLL_S)

    def _others(self, agents: Iterable[tuple[str, str]]) -> list[str]:
        """The instances among (name, instance) that this launcher has not started."""
        ours = {process.popen.pid for process in self.processes}
        cards = [self.client.card(*agent) for agent in sorted(agents)]
        return [card.instance for card in cards if card is not None and card.pid not in ours]

    def start_simulator(self, port: int = 0) -> str:
        """Start a simulator on a TCP port (0: a free one); returns its address."""
        return self.table.start_simulator(self.scenario, self.options.seed, port).announced()[0]

    def start_agent(self, *group: Member, name: str = "") -> Process:
        """Start agents as one process, by default with the name of the first."""
        return self.table.start_agents(name or group[0].name, group)

    def _comes(self, condition: Callable[[], bool], within: float) -> bool:
        """Whether a condition becomes true in time. Raises RunFailedError if a process has ended.

        It is polled, since nothing arrives without a robot agent.
        """

        def comes() -> bool:
            self._check_alive()
            return condition()

        end = self.now() + within
        while not self.client.wait_for(comes, POLL_S):
            if self.now() >= end:
                return False
        return True

    # While it runs -------------------------------------------------------------------------------

    def _check_alive(self) -> None:
        for process in self.processes:
            if process.ended():
                why = f"{ending(process.popen.returncode)}:\n{process.last_lines()}"
                if process.popen.returncode == MISUSED:
                    why += self._company(process.name)
                raise RunFailedError(f"{process.name} ended with {why}")

    def _company(self, name: str) -> str:
        """A line about another society because of which an agent ended; "" without one.

        That agent may have received tokens and cards that have not arrived here yet, so this waits
        up to `NAMES_S` for them.
        """
        found = self.client.wait_for(lambda: self._others(self._robots()), NAMES_S)
        if not found and not any(other == name for other, _ in self.client.alive):
            return ""
        robot = f", with the robot agent {found[0]}" if found else ""
        return f"\nA society runs in the namespace {self._namespace!r}{robot}: {INSTEAD}"

    def poll(self) -> None:
        """Report each ended process once.

        Raises RunFailedError if another society's agent has replaced one.
        """
        for process in self.processes:
            if process.ended() and process not in self.ended:
                self.ended.add(process)
                if process.popen.returncode == MISUSED:  # another agent of its name is alive
                    self._check_alive()
                how = ending(process.popen.returncode)
                self._warn(
                    f"{process.name} has ended ({how}); the end of"
                    f" {process.log}:\n{process.last_lines()}"
                )
                if process.name == SIMULATOR:
                    self.watch.lose(f"the simulator has ended ({how})")
        if self.watch.phase is not Phase.LOST:
            super().poll()

    def robot_advice(self) -> str:
        """The end of the newest robot agent's log."""
        words = [process.last_lines() for process in self.processes if process.has_robot]
        return f"the log of the robot agent:\n{words[-1] if words else '    (empty)'}"

    # Leaving -------------------------------------------------------------------------------------

    def stop(self) -> None:
        """End everything: the behaviours first, then the robot agent, then the simulator."""
        self.table.end()
