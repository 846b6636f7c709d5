"""A society of real processes, a tap on the robot's line, and an observer of what is said."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, closing
from itertools import pairwise
from pathlib import Path

from armadico.bridge.p2os.commands import Cmd
from armadico.config.scenarios import Scenario, ideal
from armadico.core.messages import (
    Ack,
    Ask,
    Ballot,
    BidHistory,
    BidRecord,
    Claim,
    Command,
    Description,
    Log,
    Message,
    RobotState,
    decode,
)
from armadico.core.resources import WHEELS
from armadico.core.services import BIDS
from armadico.launch.client import Client
from armadico.launch.local import Launcher
from armadico.launch.processes import SIMULATOR, Process, ProcessTable
from armadico.launch.society import Member, Options
from armadico.mesh.base import Mesh
from armadico.mesh.sockets import RUNTIME_VARIABLE
from armadico.mesh.topology import topology
from armadico.mesh.zenoh import ZenohMesh
from armadico.mobile.messages import Pose, Truth
from armadico.observe.view import View
from armadico_tools.faults.serial_tap import Tap
from armadico_tools.testbed import joining_onlooker, onlooker
from tests.robot.speeds import moves

SOON = 40.0
"""s; a deadline, not an expectation."""

LINE = ideal(Scenario(name="line", world="sc1", start=(-1.5, 0.0, 0.0), goal=(6.5, 0.0, 0.0)))
"""8 m straight on, nothing in the way: goto alone has anything to do."""


class Linked(ProcessTable):
    """Links the simulator to the observer, which sees the truth without a robot agent, too."""

    def start(self, name: str, words: Sequence[str], *, listen: bool = False) -> Process:
        more = joining_observer(self.namespace) if name == SIMULATOR else ()
        return super().start(name, [*words, *more], listen=listen)


class Tapped(Launcher):
    """A launcher that puts a tap between the robot agent and its simulator."""

    tap: Tap | None = None

    def __init__(self, scenario: Scenario, options: Options, mesh: Mesh, namespace: str) -> None:
        super().__init__(scenario, options, mesh, namespace)
        self.table = Linked(namespace, logs=self.table.logs)

    def start_simulator(self, port: int = 0) -> str:
        url = super().start_simulator(port)
        self.tap = self.tap or Tap(url)
        return self.tap.url

    def stop(self) -> None:
        super().stop()
        if self.tap is not None:
            self.tap.close()
            self.tap = None


class Observer:
    """Keeps what is said, as it comes."""

    def __init__(self, mesh: ZenohMesh) -> None:
        self.client = Client(mesh)
        self.view = View()
        self.states: list[RobotState] = []
        self.acks: list[Ack] = []
        self.truths: list[Truth] = []
        self.commands: list[Command] = []
        self.logs: list[str] = []
        kinds = (RobotState, Description, Ack, Truth, Pose, Command, Claim, Log)
        self.client.listen(*kinds, then=self._keep)

    def until(self, condition: Callable[[], object], what: str) -> None:
        """Wait for something to be so. AssertionError with the last state if it does not come."""
        if not self.client.wait_for(condition, SOON):
            last = [*self.states[-1:], *self.acks[-1:]]
            said = "\n  ".join(self.logs[-10:])
            there = f"alive: {', '.join(sorted(self.names))}"
            raise AssertionError(f"not within {SOON:.0f} s: {what}\n {last}\n {there}\n  {said}")

    @property
    def state(self) -> RobotState:
        return self.states[-1]

    @property
    def names(self) -> set[str]:
        """The names of the agents whose tokens are there."""
        return {name for name, _ in self.client.alive}

    @property
    def holder(self) -> str:
        """The instance that was obeyed last; nobody since a release."""
        return self.view.last_driver(WHEELS.name)

    def obeyed_lately(self) -> bool:
        return self.view.driver(WHEELS.name, time.monotonic()) is not None

    def driving(self) -> bool:
        """Whether the robot is on its way, by the truth, and somebody is obeyed."""
        truth = self.view.truth
        return truth is not None and truth.v > 0.2 and self.obeyed_lately()

    def at_rest(self) -> bool:
        return abs(self.truths[-1].v) < 0.01 and abs(self.truths[-1].w) < 0.01

    def cycles(self, count: int) -> None:
        """Let so many cycles pass."""
        last = self.state.cycle.number + count
        self.until(lambda: self.state.cycle.number >= last, f"cycle {last}")

    def truths_pass(self, count: int) -> None:
        """Let so many cycles of the simulator pass."""
        last = len(self.truths) + count
        self.until(lambda: len(self.truths) >= last, f"{count} cycles")

    def pid_of(self, name: str, instance: str) -> int:
        """The process of an instance, by its card."""
        card = self.client.card(name, instance)
        assert card is not None, "it answers"
        return card.pid

    def drives_on(self, cycles: int = 8) -> None:
        """Somebody is obeyed for cycles that come after this call, and the robot moves."""
        first = self.state.cycle

        def on() -> bool:
            at = self.acks[-1].obeyed_cycle
            behind = at is not None and (
                at.epoch != first.epoch or at.number >= first.number + cycles
            )
            return behind and self.driving()

        self.until(on, "somebody is obeyed and the robot moves")

    def bids(self, name: str, instance: str) -> tuple[BidRecord, ...]:
        """What an agent tells of its recent bids; none if it does not answer."""
        key = BIDS.key_for(name=name, instance=instance)
        replies: list[bytes] = []
        over: list[bool] = []
        mesh = self.client.mesh
        mesh.query(key, Ask(), 2.0, lambda _, data: replies.append(data), lambda: over.append(True))
        self.until(lambda: over, "the answer")
        return decode(replies[0], BidHistory).bids if replies else ()

    def _keep(self, message: Message, now: float) -> None:
        self.view.learn(message, now)
        match message:
            case RobotState():
                self.states.append(message)
            case Ack():
                self.acks.append(message)
            case Truth():
                self.truths.append(message)
            case Command():
                self.commands.append(message)
            case Log():
                self.logs.append(message.text)


class Society(Observer):
    """One society on a mesh of its own; a context manager that leaves nothing running."""

    def __init__(self, mesh: ZenohMesh, launcher: Tapped, scenario: Scenario = LINE) -> None:
        super().__init__(mesh)
        self.scenario = scenario
        self.launcher = launcher

    @property
    def tap(self) -> Tap:
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


def ballots_never_go_down(acks: list[Ack]) -> None:
    """What is refused by, and what is obeyed, only grows within an epoch; nor do cycles.

    After a release nobody is obeyed, until somebody with a larger ballot is.
    """
    for before, after in pairwise(acks):
        fell = after.cycle <= before.cycle or _rank(after.largest) < _rank(before.largest)
        assert before.cycle.epoch != after.cycle.epoch or not fell, f"{before}\n{after}"
    for before, after in pairwise(ack for ack in acks if ack.obeyed is not None):
        fell = _rank(after.obeyed) < _rank(before.obeyed)
        assert before.cycle.epoch != after.cycle.epoch or not fell, f"{before}\n{after}"


def _rank(ballot: Ballot | None) -> tuple[int, float, bool, str]:
    if ballot is None:
        return (-1, 0.0, False, "")
    return (ballot.term, ballot.utility, ballot.critical, ballot.instance)


def mesh_of(namespace: str) -> ZenohMesh:
    """A session as a tool has it."""
    return ZenohMesh(namespace, topology(), starts=True)


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
