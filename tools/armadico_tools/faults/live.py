"""The live back end: a society of real processes, an observer beside it, and its injector.

The processes stay up for many trials. The observer subscribes to all messages, and a tap on the
line between the robot agent and the simulator shows what the robot agent orders.
"""

from __future__ import annotations

import heapq
import os
import queue
import signal
import subprocess
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Self, TypeVar

from armadico.config.scenarios import Scenario, planned
from armadico.core.messages import Ask, BidHistory, Command, Message, decode
from armadico.core.messages import MessageError as UnreadableError
from armadico.core.services import BIDS, service_of
from armadico.launch.processes import agent_words, simulator_words
from armadico.launch.society import Member, Options, members, mission
from armadico.mesh.link_faults import LinkFaults
from armadico.mesh.ports import free_port
from armadico.mobile.messages import MissionRequest, Waypoint
from armadico.observe.view import agent_of
from armadico.observe.watching import kind_at
from armadico.runtime.programs import end
from armadico_tools.faults.checker import Checker
from armadico_tools.faults.injector import Injector
from armadico_tools.faults.plan import Fault
from armadico_tools.faults.record import (
    Bids,
    Came,
    Left,
    Observation,
    Passed,
    Said,
    seconds_since,
)
from armadico_tools.faults.serial_tap import Orders, Tap
from armadico_tools.hosts.namespaces import Network
from armadico_tools.testbed import WATCHER, Namespaces, Place

T = TypeVar("T")

FAR_M: Final = 90_000.0
"""A goal so far straight on that the robot drives for as long as it is observed."""

REACH_M: Final = 100_000.0
"""The interface agent's `reach_m`: it accepts a goal that far."""

ROAD: Final = Scenario(name="road", world="empty", start=(0.0, 0.0, 0.0), goal=(9.0, 0.0, 0.0))
"""Straight on with nothing in the way: only goto has a reason to drive."""

HEARD_S: Final = 1.0
"""A busy observer may receive a command so much later than the line shows that it is obeyed. With
seven processes a core 49 ms were seen in 10 s; the first orders of a run are each another one."""

MISSION_S: Final = 2.0
"""A mission is requested again after this time, as long as there is none."""

SOON_S: Final = 30.0
"""A deadline for what must come, not an expectation."""

ASK_S: Final = 0.3
"""How often the bids of all agents are queried while a condition is awaited."""

HELD_BACK_S: Final = 0.1
"""Observations are taken so much later than they came, to be put in order first."""

EARLIER_S: Final = 0.05
"""A tap receives at once, the mesh later: a command counts as published so long before it was
received, so that it is seen before it is seen to be obeyed."""

WOKEN_S: Final = 1.0
"""An agent that hung, or links that were bad, take so long to deal with what had waited."""


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
    """Starts all processes and observes them. A context manager that ends them all.

    `hosts` maps agents' names to hosts; other agents run on the first host of the place.
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
        """No process is started yet; `record` is a file for the messages and the journals."""
        self.place = place
        self.checker = checker or Checker()
        self.record = self.checker.record
        self.agents: dict[str, Agent] = {}
        self.count = 0  # for trials that befall one agent or host after another
        self._file = record
        self._recorder: subprocess.Popen[bytes] | None = None
        self._scenario, self._seed = scenario, seed
        self._hosts = dict(hosts or {})
        self._queue: queue.SimpleQueue[_Item] = queue.SimpleQueue()
        self._due: list[_Item] = []  # a heap of what is held back
        self._orders = Orders()
        self._asked_at = float("-inf")
        self._sent_at = float("inf")  # when the last mission was requested; inf: none is wanted
        self._goals = _goals(scenario)
        self._simulator: subprocess.Popen[bytes] | None = None
        self._mesh = place.onlooker()
        self._mesh.watch_alive(
            lambda _, one, there: self.observe(lambda at: (Came if there else Left)(at, one))
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

    # Processes -----------------------------------------------------------------------------------

    def start(self) -> None:
        """Start the simulator and every agent of the scenario, and have the robot drive."""
        if self._file is not None:
            self._recorder = self._recording(self._file)
        self.start_simulator()
        for member in members(self._scenario, Options(seed=self._seed), self.tap.url):
            far = (f"reach_m={REACH_M:g}",) if member.name == "interface" else ()
            sets = (*member.sets, *far)
            self.add(member.name, member.name, self.host_of(member.name), sets, wait=False)
        for agent in self.agents.values():
            self._meet(agent, known=())
        self.until(lambda: self.record.state is not None, "the robot's first cycle")
        self._sent_at = float("-inf")
        self.until(self.record.on_its_way, "the robot is on its way")

    def _recording(self, path: Path) -> subprocess.Popen[bytes]:
        """A recorder that has begun to write."""
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
        """SIGKILL it, which closes its TCP line."""
        assert self._simulator is not None, "it was started"
        self._simulator.kill()
        self._simulator.wait()

    def add(
        self, label: str, name: str, host: str, sets: Sequence[str] = (), *, wait: bool = True
    ) -> None:
        """Start an agent, which may be a twin of another; `wait` until its token is there."""
        known = self.record.instances(name)
        agent = self.agents[label] = Agent(label, name, host, tuple(sets))
        self._run(agent)
        if wait:
            self._meet(agent, known)

    def restart(self, label: str) -> None:
        """Start an agent again that has ended."""
        agent = self.agents[label]
        known = {*self.record.instances(agent.name), agent.instance}
        self._run(agent)
        self._meet(agent, known)

    def signal(self, label: str, number: signal.Signals) -> None:
        process = self.agents[label].process
        assert process is not None, "it was started"
        os.kill(process.pid, number)
        if number == signal.SIGKILL:
            process.wait()

    def _run(self, agent: Agent) -> None:
        member, journal = Member(agent.name, agent.sets), self._file is not None
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
            return [one for one in self.record.instances(agent.name) if one not in before]

        agent.instance = self.until(new, f"the token of {agent.label}")[-1]

    def on_host(self, *hosts: str) -> tuple[str, ...]:
        """The labels of the agents on some hosts."""
        return tuple(agent.label for agent in self.agents.values() if agent.host in hosts)

    def label_of(self, instance: str) -> str:
        found = [a.label for a in self.agents.values() if a.instance == instance]
        return found[0] if found else agent_of(instance)

    def _keep_going(self) -> None:
        """Request a mission if there is none, or the goal of the last one is reached."""
        now = time.monotonic()
        if self.record.driving or now - self._sent_at < MISSION_S:
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

    # Time ----------------------------------------------------------------------------------------

    def run(self, seconds: float) -> None:
        """Let time pass, and take what comes."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            self._pump(left)

    def until(self, condition: Callable[[], T | None], what: str, within: float = SOON_S) -> T:
        """Take what comes until a condition holds; returns its value. Raises TrialError."""
        end = time.monotonic() + within
        while not (value := condition()):
            left = end - time.monotonic()
            if left <= 0:
                lines = [f"\n    {log.text}" for _, log in list(self.record.logs)[-5:]]
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
        self.checker.update(Passed(now))
        self._keep_going()

    # What comes, on other threads ----------------------------------------------------------------

    def observe(self, make: Callable[[float], Observation | None], at: float | None = None) -> None:
        """Have an observation of some moment (default: now) taken in the order of time."""

        def act(at: float) -> None:
            seen = make(at)
            if seen is not None:
                self.checker.update(seen)

        self._queue.put(_Item(time.monotonic() if at is None else at, act))

    def _arrived(self, key: str, data: bytes) -> None:
        at, kind = time.monotonic(), kind_at(key)
        if kind is not None:
            early = EARLIER_S if kind is Command else 0.0
            self.observe(lambda then: self._read(data, kind, then + early), at - early)

    def _read(self, data: bytes, kind: type[Message], at: float) -> Observation | None:
        try:
            message = decode(data, kind)
        except UnreadableError:
            return None
        if not isinstance(message, BidHistory):
            return Said(at, message)
        if not message.bids:
            return None
        last, state = message.bids[-1], self.record.state
        age = seconds_since(last.cycle, None if state is None else state.cycle)
        return Bids(at, message.instance, last, age)

    def _ask_for_bids(self) -> None:
        now = time.monotonic()
        if now - self._asked_at >= ASK_S:
            self._asked_at = now
            key = BIDS.key_for(name="*", instance="*")
            self._mesh.ask(key, Ask(), 0.5, self._arrived, lambda: None)

    def _crossed(self, data: bytes, at: float) -> None:
        for order in self._orders.feed(data, at):
            self.observe(lambda _, order=order: order, at)  # type: ignore[misc]


class LiveInjector(Injector):
    """Sends signals to processes, and puts faults on the links between hosts."""

    def __init__(self, society: RealSociety) -> None:
        super().__init__(lambda seen: society.observe(lambda _: seen, seen.at))
        self._society = society
        self.acted_at = 0.0  # just before the last fault was put in, or taken out

    @property
    def now(self) -> float:
        return time.monotonic()

    def act(self, fault: Fault, *, begins: bool) -> None:
        """Put a fault in, or take it out and wait until what it befell is there again."""
        self.acted_at = self.now
        act = self._worsen if fault.kind in {"delay", "drop"} else None
        act = act or getattr(self, "_" + fault.kind.replace("-", "_"))
        act(fault, begins)

    def _crash(self, fault: Fault, begins: bool) -> None:
        for label in fault.whom:
            if begins:
                self._society.signal(label, signal.SIGKILL)
            else:
                self._society.restart(label)

    def _hang(self, fault: Fault, begins: bool) -> None:
        for label in fault.whom:
            self._society.signal(label, signal.SIGSTOP if begins else signal.SIGCONT)
        if not begins:
            self._society.run(WOKEN_S)

    def _robot_restart(self, fault: Fault, begins: bool) -> None:  # noqa: ARG002
        """The simulator and its line are gone, which voids the same promises.

        With no line nothing can be ordered, and a simulator that comes back stands still.
        """
        if begins:
            self._society.kill_simulator()
        else:
            self._society.start_simulator()
            self._drives_again()

    def _partition(self, fault: Fault, begins: bool) -> None:
        """The hosts of some agents are cut off from the others; 1: by their own cards."""
        society, hosts = self._society, self._network.hosts
        there = {society.agents[label].host for label in fault.whom}
        if fault.amount:
            for host in there:
                hosts[host].carrier(not begins)
        elif begins:
            here = (*(host for host in society.place.hosts if host not in there), WATCHER)
            self._network.change(lambda switch: switch.partition(here, there))
        else:
            self._network.change(lambda switch: switch.heal())
        if not begins:
            every = {agent.instance for agent in society.agents.values()}
            society.until(lambda: society.record.alive.keys() >= every, "all tokens are back")

    def _worsen(self, fault: Fault, begins: bool) -> None:
        """All links between hosts are bad; the observer's own stay whole."""
        if begins:
            links = [link for link in self._network.switch.links() if WATCHER not in link]
            bad = LinkFaults(loss=fault.amount)
            if fault.kind == "delay":
                bad = LinkFaults(delay=fault.amount, jitter=fault.spread)
            self._network.change(lambda switch: switch.set(links, bad))
        else:
            self._network.change(lambda switch: switch.heal())
            self._drives_again()
            self._society.run(WOKEN_S)

    def _drives_again(self) -> None:
        society, since = self._society, self.acted_at
        society.until(lambda: society.record.moves_after(since), "speeds are ordered again")
        society.until(society.record.on_its_way, "the robot is on its way again")

    @property
    def _network(self) -> Network:
        place = self._society.place
        assert isinstance(place, Namespaces), "it needs hosts"
        return place.network


def _goals(scenario: Scenario) -> deque[Waypoint]:
    """There and back again, for as long as it is observed; on the road only there."""
    if scenario is ROAD:
        return deque([Waypoint(FAR_M, 0.0, 0.0)])
    there = mission(scenario)
    assert there is not None, "faults are injected on the way to a goal"
    return deque([there.goal, Waypoint(*scenario.start)])
