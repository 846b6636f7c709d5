"""A society of real processes, a tap on the robot's line."""

from __future__ import annotations

import os
import signal
from collections.abc import Sequence
from contextlib import AbstractContextManager, closing
from pathlib import Path

from armadico.bridge.p2os.commands import Cmd
from armadico.config.scenarios import Scenario, ideal
from armadico.core.messages import PROTOCOL
from armadico.launch.local import Launcher
from armadico.launch.processes import SIMULATOR, Process, ProcessTable
from armadico.launch.society import Member, Options
from armadico.mesh.base import Mesh
from armadico.mesh.sockets import RUNTIME_VARIABLE
from armadico.mesh.zenoh import ZenohMesh
from armadico_tools.testbed import joining_onlooker, onlooker
from tests.robot.society import SOON, Observer
from tests.whole.live.speeds import PacketTap, moves

LINE = ideal(Scenario(name="line", world="sc1", start=(-1.5, 0.0, 0.0), goal=(6.5, 0.0, 0.0)))
"""8 m straight on, nothing in the way: goto alone has anything to do."""


class Linked(ProcessTable):
    """Links the simulator to the observer, which sees the truth without a robot agent, too."""

    protocol = PROTOCOL  # that the next agents use

    def start(self, name: str, words: Sequence[str], *, listen: bool = False) -> Process:
        agents = ("--protocol", str(self.protocol))
        more = joining_observer(self.namespace) if name == SIMULATOR else agents
        return super().start(name, [*words, *more], listen=listen)


class Tapped(Launcher):
    """A launcher that puts a tap between the robot agent and its simulator."""

    tap: PacketTap | None = None

    def __init__(self, scenario: Scenario, options: Options, mesh: Mesh, namespace: str) -> None:
        super().__init__(scenario, options, mesh, namespace)
        self.table = Linked(namespace, logs=self.table.logs)

    def start_simulator(self, port: int = 0) -> str:
        url = super().start_simulator(port)
        self.tap = self.tap or PacketTap(url)
        return self.tap.url

    def stop(self) -> None:
        super().stop()
        if self.tap is not None:
            self.tap.close()
            self.tap = None


class Society(Observer):
    """One society on a mesh of its own; a context manager that leaves nothing running."""

    def __init__(self, mesh: ZenohMesh, launcher: Tapped, scenario: Scenario = LINE) -> None:
        super().__init__(mesh)
        self.scenario = scenario
        self.launcher = launcher

    @property
    def tap(self) -> PacketTap:
        assert self.launcher.tap is not None, "the simulator was started"
        return self.launcher.tap

    def drive(self) -> None:
        """Start everybody, hand the mission over, and wait until the robot is on its way."""
        self.launcher.start()
        self.launcher.begin()
        self.until(self.driving, "the robot is on its way")

    def process(self, name: str) -> Process:
        """The newest process of a name."""
        return next(p for p in reversed(self.launcher.processes) if p.name == name)

    def send(self, name: str, number: signal.Signals) -> None:
        os.kill(self.process(name).popen.pid, number)

    def kill(self, name: str) -> None:
        """SIGKILL, and wait for the process to end."""
        process = self.process(name)
        process.popen.kill()
        process.popen.wait(SOON)

    def restart(self, name: str) -> Process:
        """A new process of an agent, as the first was."""
        member = next(m for m in self.launcher.members if m.name == name)
        return self.launcher.start_agent(Member(name, member.sets))

    def nobody_else_died(self, *dead: str) -> None:
        """All but these are alive, and are seen to be if there is a robot agent."""
        newest = {process.name: process for process in self.launcher.processes}
        ended = {name for name, process in newest.items() if process.ended()}
        assert ended == set(dead), f"ended: {sorted(ended)}"
        if "robot" in dead:
            return
        agents = {member.name for member in self.launcher.members} - set(dead)
        self.until(lambda: self.names == agents, f"tokens: {sorted(agents)}")

    def stops(self, since: int) -> None:
        """A stop is ordered after a position on the line, and the wheels come to rest."""

        def ordered() -> bool:
            said = [c for c in self.tap.commands(since) if c.number in (Cmd.VEL, Cmd.RVEL)]
            return bool(said) and not any(map(moves, said[-2:]))

        self.until(ordered, "a stop is ordered")
        self.until(self.at_rest, "the wheels rest")

    def nobody_drives(self, cycles: int = 8) -> None:
        """Nobody has the wheels turn, for a while."""
        mark = len(self.tap.packets)
        self.truths_pass(cycles)
        orders = [command for command in self.tap.commands(mark) if moves(command)]
        assert not orders, f"{self.holder} drives: {orders}"
        assert self.at_rest(), f"it moves: {self.truths[-1]}"


def observers_mesh(namespace: str) -> AbstractContextManager[ZenohMesh]:
    """An open session of an observer: it receives from simulators without a robot agent, too."""
    return closing(onlooker(namespace, _beside()))


def joining_observer(namespace: str) -> tuple[str, ...]:
    """The options by which a simulator is linked to the observer, and not to the robot's router."""
    return joining_onlooker(namespace, _beside())


def _beside() -> Path:
    return Path(os.environ[RUNTIME_VARIABLE]) / "observer"


def launcher_of(
    mesh: ZenohMesh, scenario: Scenario = LINE, options: Options | None = None
) -> Tapped:
    """A launcher with a tap, in the mesh's namespace."""
    return Tapped(scenario, options or Options(), mesh, mesh.namespace)
