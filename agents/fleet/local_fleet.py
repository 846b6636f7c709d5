"""A fleet as real processes on this machine: one simulator, and a society for each robot.

The societies are started by a `Launcher` each, in a namespace of its own; the simulator serves all
of their robots. Whatever happens, everything is taken down again.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

from armadico.agents.fleet.live_fleet import HEAR_S, LiveFleet
from armadico.agents.fleet.messages import FleetClaims
from armadico.agents.fleet.run import names_of, robots_of
from armadico.config.discovery import agent_class
from armadico.config.scenarios import Scenario
from armadico.core.messages import Message
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
from armadico.runtime.client import Client
from armadico.runtime.errors import RunFailedError

if TYPE_CHECKING:
    from armadico.mesh.base import Mesh


class LocalFleet(LiveFleet):
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
            scenario: As in `LiveFleet`, and so are `options`, `fleet`, `join` and `warn`.
            options: What else was chosen.
            robots: How many; None: all that there is a start for.
            fleet: Its name.
            join: Joins the mesh in a namespace.
            joining: Options by which the processes find the mesh.
            warn: Told who is gone and what goes wrong.
        """
        super().__init__(scenario, options, fleet, join, warn)
        self._ones = robots_of(scenario, robots)
        self.names = names_of(fleet, len(self._ones))
        self.launchers: list[Launcher] = []
        self.simulator: Process | None = None
        self.logs = Path(tempfile.mkdtemp(prefix="armadico-"))
        self._joining = tuple(joining)
        self._strangers: set[str] = set()
        self._lost: set[str] = set()  # robots that are gone

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
            super().__exit__(kind, error, trace)
        if error is None:
            shutil.rmtree(self.logs, ignore_errors=True)

    # Starting ------------------------------------------------------------------------------------

    def start(self) -> None:
        """Start everything. Raises RunFailedError if others are there, or one does not start."""
        meshes = [self._joined(name) for name in self.names]
        first = Client(meshes[0])
        first.listen(FleetClaims, then=self._hear)
        first.wait_for(lambda: False, HEAR_S)  # all of it: each of them is to be named
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
            self._listen(name, launcher.client)
            self.clients.append(launcher.client)

    def look(self) -> None:
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
