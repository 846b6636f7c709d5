"""A fleet as real processes on this machine: one simulator, and a society for each robot.

A `Launcher` starts each society in a namespace of its own; one simulator serves all robots. All of
it is ended in any case.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from dataclasses import replace
from types import TracebackType
from typing import TYPE_CHECKING

from armadico.agents.fleet.commands.run import HEAR_S, FleetRun, names_of, robots_of
from armadico.agents.fleet.messages import FleetClaims
from armadico.config.scenarios import Scenario
from armadico.core.discovery import agent_class
from armadico.core.messages import Message
from armadico.launch.client import Client
from armadico.launch.local import Launcher
from armadico.launch.processes import ProcessTable, ending, logs_folder, undisturbed
from armadico.launch.society import Options, names
from armadico.runtime.errors import RunFailedError

if TYPE_CHECKING:
    from armadico.mesh.base import Mesh


class LocalFleet(FleetRun):
    """The processes of one run; a context manager that leaves nothing running."""

    def __init__(
        self,
        scenario: Scenario,
        options: Options,
        robots: int | None,
        fleet: str,
        join: Callable[[str], Mesh],
        joining: Sequence[str] = (),
    ) -> None:
        """Set up a run of `robots` (None: all that there is a start for).

        Their namespaces are in `fleet`. `join` joins the mesh in a namespace; the mesh is closed at
        the end. `joining` are options by which the processes find it.
        """
        super().__init__(scenario, options, fleet)
        ones = robots_of(scenario, robots)
        self.table = ProcessTable(names_of(fleet, 1)[0], logs_folder(fleet), joining, tied=True)
        self._ones = dict(zip(names_of(fleet, len(ones)), ones, strict=True))
        self._launchers: dict[str, Launcher] = {}
        self._lost: set[str] = set()  # robots that are gone
        self._join, self._joining = join, joining
        self._meshes = ExitStack()

    @property
    def names(self) -> list[str]:
        return list(self._ones)

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End all processes, the simulator last; logs are kept as for one robot."""
        well = isinstance(error, KeyboardInterrupt)
        well |= error is None and self.watch.result().passed
        began = bool(self.table.processes)
        with undisturbed():
            for launcher in self._launchers.values():
                launcher.stop()
            self.table.end()
            self._meshes.close()
        if not began or (well and not any(each.ended for each in self._launchers.values())):
            self.table.remove_logs()

    # Starting ------------------------------------------------------------------------------------

    def start(self) -> None:
        """Start all. Raises RunFailedError if the fleet exists already, or a start fails."""
        meshes = [self._meshes.enter_context(closing(self._join(name))) for name in self.names]
        self._refuse_company(Client(meshes[0]))
        also, seed = self.names[1:], self.options.seed
        ports = self.table.start_simulator(self.scenario, seed, also=also).announced()
        for (name, one), port, mesh in zip(self._ones.items(), ports, meshes, strict=True):
            together = self.options.together or _together(one, self.options)
            launcher = Launcher(
                one,
                replace(
                    self.options,
                    namespace=name,
                    robot=port,
                    simulator=self.table.simulator,
                    together=together,
                ),
                mesh,
                name,
                joining=self._joining,
                tied=True,
                logs=self.table.logs,
            )
            launcher.report_to(self._warn)
            self._launchers[name] = launcher
            launcher.start()
            self.meet(name, launcher.client)

    def _refuse_company(self, client: Client) -> None:
        there: set[str] = set()

        def add(claims: Message, _now: float) -> None:
            if isinstance(claims, FleetClaims):
                there.add(claims.robot)

        client.listen(FleetClaims, then=add)
        client.wait_for(lambda: False, HEAR_S)  # the whole time: each robot is to be named
        if there:
            robots = sorted(there)
            raise RunFailedError(
                f"a fleet named {self.fleet!r} is there already, with {', '.join(robots)}: another"
                " --namespace names another fleet; Ctrl-C ends that one where it was started,"
                f" `armadico down --namespace {self.fleet}/{robots[0]}` what keeps a robot of it up"
            )

    def goes_on(self, elapsed: float) -> bool:  # noqa: ARG002
        """Go on without a lost robot: the others take its tasks. Not without the simulator."""
        for process in self.table.processes:
            if process.ended():
                how = ending(process.popen.returncode)
                self.watch.lose(f"the simulator has ended ({how})")
                self._warn(f"the {self.watch.lost}; {process.log}:\n{process.last_lines()}")
                return False
        for name, launcher in self._launchers.items():
            if name in self._lost:
                continue
            try:
                launcher.poll()
            except RunFailedError as error:
                self._lost.add(name)
                self._warn(f"{name}: {error}")
                if len(self._lost) == len(self.names):
                    raise
        return True


def _together(one: Scenario, options: Options) -> tuple[tuple[str, ...], ...]:
    """Return which agents share a process: those that answer queries, and those that drive.

    One process per agent, some thirty for three robots, takes a minute to start on a small machine.
    """
    _, *others = names(one, options.without)
    answering = tuple(name for name in others if agent_class(name).answers)
    drives = tuple(name for name in others if name not in answering)
    return tuple(group for group in (answering, drives) if len(group) > 1)
