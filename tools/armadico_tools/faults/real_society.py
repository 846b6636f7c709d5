"""A real society that stays up for many trials: processes, a tap on the line, and an onlooker."""

from __future__ import annotations

import heapq
import os
import queue
import signal
import subprocess
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Self, TypeVar

from armadico.config.scenarios import Scenario, planned
from armadico.core.messages import Ask, Command, Message, decode
from armadico.core.messages import MessageError as UnreadableError
from armadico.core.services import BIDS, service_of
from armadico.launch.processes import agent_words, simulator_words
from armadico.launch.society import Member, Options, members, mission
from armadico.mesh.ports import free_port
from armadico.mobile.messages import MissionRequest, Waypoint
from armadico.observe.view import agent_of
from armadico.observe.watching import kind_at
from armadico.runtime.programs import end
from armadico_tools.faults.checker import Checker
from armadico_tools.faults.event_log import Account
from armadico_tools.faults.observations import Faulted, Passed, Said
from armadico_tools.faults.serial_tap import Tap
from armadico_tools.faults.wheel_commands import Orders
from armadico_tools.testbed import Place

T = TypeVar("T")

FAR_M: Final = 90_000.0
"""A goal so far straight on that the robot drives for as long as it is watched."""

REACH_M: Final = 100_000.0
"""The interface agent's `reach_m`: it takes a goal that far."""

ROAD: Final = Scenario(name="road", world="empty", start=(0.0, 0.0, 0.0), goal=(9.0, 0.0, 0.0))
"""Straight on with nothing in the way: only goto has a reason to drive."""

MISSION_S: Final = 2.0
"""A mission is asked for again after so long, as long as there is none."""

SOON_S: Final = 30.0
"""A deadline for what must come, not an expectation."""

ASK_S: Final = 0.3
"""How often all agents are queried for their bids while one waits for something."""


HELD_BACK_S: Final = 0.1
"""Everything is looked at so much later than it came, to be put in order first."""

EARLIER_S: Final = 0.05
"""A tap receives at once, the mesh later: a command counts as published so long before it was
received, so that it is seen before it is seen to be obeyed."""


class TrialError(RuntimeError):
    """A trial could not be made; the message names what did not come."""


@dataclass
class Agent:
    """One process of the society. `label` is its agent's name, or one of its own for a twin."""

    label: str
    name: str
    host: str
    sets: tuple[str, ...]
    process: subprocess.Popen[bytes] | None = None
    instance: str = ""


@dataclass(order=True)
class _Item:
    at: float
    act: Callable[[float], None] = field(compare=False)


class RealSociety:
    """Starts all processes, sees everything. A context manager that ends them all.

    `hosts` has where agents run, by name; who is not named is on the first host of the place.
    """

    def __init__(
        self,
        place: Place,
        *,
        scenario: Scenario = ROAD,
        hosts: Mapping[str, str] | None = None,
        seed: int = 0,
        checker: Checker | None = None,
        record: Path | None = None,
    ) -> None:
        """Nobody is started yet; `record` is a file for what is said, journals included."""
        self.place = place
        self._record = record
        self._recorder: subprocess.Popen[bytes] | None = None
        self.account = Account(checker)
        self.agents: dict[str, Agent] = {}
        self.count = 0  # for trials that take one after another in turn
        self._scenario, self._seed = scenario, seed
        self._hosts = dict(hosts or {})
        self._queue: queue.SimpleQueue[_Item] = queue.SimpleQueue()
        self._due: list[_Item] = []  # a heap: what is held back, too
        self._orders = Orders()
        self._asked_at = float("-inf")
        self._sent_at = float("inf")  # when the last mission was asked for; inf: none is wanted
        self._goals = _goals(scenario)
        self._simulator: subprocess.Popen[bytes] | None = None
        self._mesh = place.onlooker()
        self._mesh.watch_alive(
            lambda _, instance, there: self._put(lambda at: self.account.token(at, instance, there))
        )
        self._mesh.subscribe("**", self._arrived)
        # A tap on a port of the robot's host, which leads to where the simulator will be.
        host = self.host_of("robot")
        self._sim_port = place.inside(host, free_port)
        self.tap = place.inside(host, Tap, f"tcp://127.0.0.1:{self._sim_port}", self._crossed)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        if self._recorder is not None:
            end(self._recorder)  # in order: the others are killed
        self.place.kill()
        self.tap.close()
        self._mesh.close()

    def host_of(self, name: str) -> str:
        return self._hosts.get(name, self.place.hosts[0])

    # Starting ------------------------------------------------------------------------------------

    def start(self) -> None:
        """Start the simulator and every agent of the scenario, and have it drive."""
        if self._record is not None:
            self._recorder = self._recording(self._record)
        self.start_simulator()
        for member in members(self._scenario, Options(seed=self._seed), self.tap.url):
            far = (f"reach_m={REACH_M:g}",) if member.name == "interface" else ()
            sets = (*member.sets, *far)
            self.add(member.name, member.name, self.host_of(member.name), sets, wait=False)
        for agent in self.agents.values():
            self._meet(agent, known=())
        self.until(lambda: self.account.view.state is not None, "the robot's first cycle")
        self._sent_at = float("-inf")
        self.until(self.account.driving, "the robot is on its way")

    def _recording(self, path: Path) -> subprocess.Popen[bytes]:
        """A recorder, once it is at work."""
        host, joining = self.place.watching
        path = path.resolve()
        words = ["record", str(path), "--quiet", "--namespace", self.place.namespace, *joining]
        recorder = self.place.start(host, "recorder", words)
        self.until(lambda: path.is_file() and path.stat().st_size > 0, "the recording's beginning")
        return recorder

    def start_simulator(self) -> None:
        """Start it, or start it again where it was."""
        host, namespace = self.host_of("robot"), self.place.namespace
        words = simulator_words(self._scenario, self._seed, namespace, self._sim_port)
        words += self.place.joining_onlooker()
        self._simulator = self.place.start(host, "simulator", words)

    def kill_simulator(self) -> None:
        """SIGKILL it: its TCP line is gone."""
        assert self._simulator is not None, "it was started"
        self._simulator.kill()
        self._simulator.wait()

    def add(
        self, label: str, name: str, host: str, sets: Sequence[str] = (), *, wait: bool = True
    ) -> Agent:
        """Start an agent, which may be a twin of another; `wait` until its token is there."""
        known = set(self.account.instances(name))
        agent = self.agents[label] = Agent(label, name, host, tuple(sets))
        self._run(agent)
        if wait:
            self._meet(agent, known)
        return agent

    def restart(self, label: str) -> float:
        """Start an agent again, which has ended; returns when its process was started (s)."""
        agent = self.agents[label]
        known = {*self.account.instances(agent.name), agent.instance}
        at = time.monotonic()
        self._run(agent)
        self._meet(agent, known)
        return at

    def _run(self, agent: Agent) -> None:
        member, journal = Member(agent.name, agent.sets), self._record is not None
        words = agent_words([member], self.place.namespace, journal=journal)
        words += self.place.joining(agent.host)
        agent.process = self.place.start(agent.host, agent.label, words)

    def _meet(self, agent: Agent, known: Iterable[str]) -> None:
        """Wait for the token of an instance that is not known yet."""
        before = set(known)

        def new() -> list[str]:
            if agent.process is not None and agent.process.poll() is not None:
                words = "\n".join(self.place.last_words(agent.label))
                raise TrialError(f"{agent.label} ended:\n{words}")
            return [who for who in self.account.instances(agent.name) if who not in before]

        self.until(new, f"the token of {agent.label}")
        agent.instance = new()[-1]

    # Missions ------------------------------------------------------------------------------------

    def _keep_going(self) -> None:
        """Ask for a mission if there is none, or the last one's goal is reached."""
        now = time.monotonic()
        if self.account.on_mission() or now - self._sent_at < MISSION_S:
            return
        self._sent_at = now
        goal = self._goals[0]
        self._goals.rotate(-1)
        self._mesh.ask(
            service_of(MissionRequest).key,
            MissionRequest(goal, planned=planned(self._scenario)),
            MISSION_S,
            lambda *_: None,  # the outcome is published on mission/status
            lambda: None,
        )

    # Faults --------------------------------------------------------------------------------------

    def signal(self, label: str, number: signal.Signals) -> float:
        """Send a signal; returns when (s), just before. Ends and stops are faults that it notes."""
        agent = self.agents[label]
        assert agent.process is not None, "it was started"
        at = time.monotonic()
        os.kill(agent.process.pid, number)
        if number == signal.SIGKILL:
            agent.process.wait()
        return at

    def next_agent(self) -> str:
        label = list(self.agents)[self.count % len(self.agents)]
        self.count += 1
        return label

    @contextmanager
    def fault(self, kind: str, *whom: str) -> Iterator[None]:
        """Show the checker that a fault begins, and in the end that it is over.

        Where links are cut the onlooker may receive less than the robot until all are back.
        """
        for began in (True, False):

            def note(at: float, began: bool = began) -> None:
                self.account.deafen(began and kind == "partition")
                self.account.take(Faulted(at, kind, whom, began))

            self._put(note)
            if began:
                yield

    # Time ----------------------------------------------------------------------------------------

    @staticmethod
    def now() -> float:
        """The onlooker's time, s."""
        return time.monotonic()

    def run(self, seconds: float) -> None:
        """Let time pass, and take what comes."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            self._pump(left)

    def until(self, condition: Callable[[], T | None], what: str, within: float = SOON_S) -> T:
        """Take what comes until a condition is true, asked after each thing. Raises TrialError."""
        end = time.monotonic() + within
        while not (value := condition()):
            left = end - time.monotonic()
            if left <= 0:
                lines = [f"\n    {log.text}" for _, log in list(self.account.logs)[-5:]]
                raise TrialError(f"not within {within:.0f} s: {what}{''.join(lines)}")
            self._ask_for_bids()
            self._pump(min(left, 0.1))
        assert value is not None, "it is true"
        return value

    def _pump(self, wait: float) -> None:
        """Take what is due, in the order of time; wait for it if there is nothing yet."""
        if self._due:
            wait = min(wait, max(self._due[0].at + HELD_BACK_S - time.monotonic(), 0.0))
        with suppress(queue.Empty):
            heapq.heappush(self._due, self._queue.get(timeout=wait))
        now = time.monotonic() - HELD_BACK_S
        with suppress(queue.Empty):
            while True:
                heapq.heappush(self._due, self._queue.get_nowait())
        while self._due and self._due[0].at <= now:
            item = heapq.heappop(self._due)
            item.act(item.at)
        self.account.take(Passed(now))
        self._keep_going()

    # What comes, on other threads ----------------------------------------------------------------

    def _put(self, act: Callable[[float], None], at: float | None = None) -> None:
        self._queue.put(_Item(time.monotonic() if at is None else at, act))

    def _arrived(self, key: str, data: bytes) -> None:
        at, kind = time.monotonic(), kind_at(key)
        if kind is None:
            return

        def read(_: float, kind: type[Message] = kind) -> None:
            with suppress(UnreadableError):
                self.account.take(Said(at, decode(data, kind)))

        self._put(read, at - EARLIER_S if kind is Command else at)

    def _ask_for_bids(self) -> None:
        now = time.monotonic()
        if now - self._asked_at >= ASK_S:
            self._asked_at = now
            key = BIDS.key_for(name="*", instance="*")
            self._mesh.ask(key, Ask(), 0.5, self._arrived, lambda: None)

    def _crossed(self, data: bytes, at: float) -> None:
        for order in self._orders.feed(data, at):
            self._put(lambda _, order=order: self.account.take(order), at)  # type: ignore[misc]

    def bidding(self, label: str) -> bool:
        """Whether an agent's bids were received lately."""
        return self.account.bids_now(self.agents[label].instance)

    def label_of(self, instance: str) -> str:
        found = [a.label for a in self.agents.values() if a.instance == instance]
        return found[0] if found else agent_of(instance)


def _goals(scenario: Scenario) -> deque[Waypoint]:
    """There, and back again, for as long as it is watched; on the road only there."""
    if scenario is ROAD:
        return deque([Waypoint(FAR_M, 0.0, 0.0)])
    there = mission(scenario)
    assert there is not None, "faults are injected on the way to a goal"
    return deque([there.goal, Waypoint(*scenario.start)])
