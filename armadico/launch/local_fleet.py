"""A fleet as real processes on this machine: one simulator, and a society for each robot.

The societies are started by a `Launcher` each, in a namespace of its own; the simulator serves all
of their robots. Whatever happens, everything is taken down again.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Final, Self

from armadico.config.discovery import agent_class
from armadico.config.scenarios import Scenario
from armadico.core.messages import FleetClaims, Message
from armadico.launch.fleet import STEP_S, give, names_of, robots_of, tasks_of, time_limit
from armadico.launch.local import Launcher
from armadico.launch.processes import (
    SIMULATOR,
    Process,
    StartError,
    end,
    simulator_words,
    undisturbed,
)
from armadico.launch.society import Options, names
from armadico.observe.fleet import FLEET_WATCHED, FleetResult, FleetWatch
from armadico.runtime.client import Client
from armadico.runtime.errors import RunFailedError

if TYPE_CHECKING:
    from armadico.mesh.base import Mesh

STRANGERS_S: Final = 1.5
"""A fleet that is there already is heard of within this: each robot speaks once a second."""


class LocalFleet:
    """The processes of one run; a context manager that leaves nothing running."""

    def __init__(
        self,
        scenario: Scenario,
        options: Options,
        robots: int | None,
        fleet: str,
        join: Callable[[str], Mesh],
        joining: Sequence[str] = (),
        warn: Callable[[str], None] = lambda _: None,
    ) -> None:
        """Prepare.

        Args:
            scenario: The world, where the robots start, the tasks.
            options: What else was chosen.
            robots: How many; None: all that there is a start for.
            fleet: Its name: the robots' namespaces are in it.
            join: Joins the mesh in a namespace; what it gives is closed at the end.
            joining: Options by which the processes find the mesh.
            warn: Told who is gone and what goes wrong.
        """
        self.scenario, self.options, self.fleet = scenario, options, fleet
        self._ones = robots_of(scenario, robots)
        self.names = names_of(fleet, len(self._ones))
        short = tuple(name.rpartition("/")[2] for name in self.names)
        self.watch = FleetWatch(scenario.name, short, len(scenario.tasks), options.seed)
        self.launchers: list[Launcher] = []
        self.simulator: Process | None = None
        self.logs = Path(tempfile.mkdtemp(prefix="armadico-"))
        self._join, self._joining, self._warn = join, tuple(joining), warn
        self._stack = ExitStack()
        self._strangers: set[str] = set()
        self._lost: set[str] = set()  # robots that are gone

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Take everything down, the simulator last; the logs stay if something went wrong."""
        with undisturbed():
            for launcher in self.launchers:
                launcher.__exit__(kind, error, trace)
            if self.simulator is not None:
                end(self.simulator.popen)
            self._stack.close()
        if error is None:
            shutil.rmtree(self.logs, ignore_errors=True)

    # Starting ------------------------------------------------------------------------------------

    def start(self) -> None:
        """Start everything. Raises RunFailedError if others are there, or one does not start."""
        meshes = [self._joined(name) for name in self.names]
        first = Client(meshes[0])
        first.listen(FleetClaims, then=self._hear)
        first.wait_for(lambda: False, STRANGERS_S)  # all of it: each of them is to be named
        if self._strangers:
            there = sorted(self._strangers)
            raise RunFailedError(
                f"a fleet named {self.fleet!r} is there already, with {', '.join(there)}: another"
                " --namespace names another fleet; Ctrl-C ends that one where it was started,"
                f" `armadico down --namespace {self.fleet}/{there[0]}` what keeps a robot of it up"
            )
        ports = self._start_simulator()
        for name, one, port, mesh in zip(self.names, self._ones, ports, meshes, strict=True):
            chosen = replace(self.options, namespace=name, robot=port, together=self._together(one))
            launcher = Launcher(one, chosen, mesh, name, joining=self._joining, tied=True)
            launcher.tell(self._warn)
            self.launchers.append(launcher)
            launcher.start()
            self._listen(name, launcher.client, claims=len(self.launchers) == 1)

    def run(self, progress: Callable[[FleetWatch], None] | None = None) -> FleetResult:
        """Start, and drive until all tasks are done, or time is up.

        Raises RunFailedError if it cannot go on, MissionRefusedError if nobody takes the tasks.
        """
        self.start()
        first = self.launchers[0].client
        now = first.mesh.now
        self.watch.begin(give(first, tasks_of(self.scenario)), now())
        began = now()
        limit = time_limit(self.scenario, len(self.names), self.options)
        while not self.watch.over and now() < began + limit:
            for launcher in self.launchers:  # each takes what has come to it
                launcher.client.wait_for(lambda: self.watch.over, STEP_S / len(self.launchers))
            if progress is not None:
                progress(self.watch)
            self._look()
        if not self.watch.over:
            self.watch.limit = limit
        return self.watch.result()

    def _look(self) -> None:
        """Say who has gone. A robot that is gone is no reason to end: the others have its tasks.

        Raises RunFailedError if none is left.
        """
        for name, launcher in zip(self.names, self.launchers, strict=True):
            if name in self._lost:
                continue
            try:
                launcher.look()
            except RunFailedError as error:
                self._lost.add(name)
                self._warn(f"{name}: {error}")
                if len(self._lost) == len(self.names):
                    raise

    # Inside --------------------------------------------------------------------------------------

    def _hear(self, said: Message, _now: float) -> None:
        """Before anybody is started: who speaks then is another fleet's."""
        if isinstance(said, FleetClaims) and not self.launchers:
            self._strangers.add(said.robot)

    def _joined(self, namespace: str) -> Mesh:
        mesh = self._join(namespace)
        self._stack.callback(mesh.close)
        return mesh

    def _start_simulator(self) -> list[str]:
        words = simulator_words(
            self.scenario, self.options.seed, self.names[0], also=self.names[1:]
        )
        log = self.logs / f"{SIMULATOR}.log"
        command = [*words, *self._joining]
        self.simulator = Process(SIMULATOR, command, log, listen=True, tied=True)
        try:
            ports = self.simulator.announced()
        except StartError as error:
            raise RunFailedError(str(error)) from None
        assert len(ports) == len(self.names), "one for each robot"
        return ports

    def _together(self, one: Scenario) -> tuple[tuple[str, ...], ...]:
        """Who shares a process: as asked for, or whoever answers people apart from who drives.

        Some thirty processes for three robots take a minute to start on a small machine.
        """
        if self.options.together:
            return self.options.together
        _, *others = names(one, self.options.without)
        asked = tuple(name for name in others if agent_class(name).answers)
        drives = tuple(name for name in others if name not in asked)
        return tuple(group for group in (asked, drives) if len(group) > 1)

    def _listen(self, name: str, client: Client, *, claims: bool) -> None:
        """Watch what a robot publishes; what all do is heard by one client, once."""
        robot = name.rpartition("/")[2]

        def show(message: Message, now: float) -> None:
            self.watch.show(robot, message, now)

        client.listen(*(k for k in FLEET_WATCHED if claims or k is not FleetClaims), then=show)
