"""The live back end: a society of real processes, an observer, and an injector.

The processes stay up for many trials. The observer subscribes to all messages, and a tap on the
line between the robot agent and the simulator shows the robot agent's orders.
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
from armadico.core.membership import agent_of
from armadico.core.messages import Ask, BidHistory, Command, Message, decode
from armadico.core.messages import MessageError as UnreadableError
from armadico.core.services import BIDS, service_of
from armadico.launch.processes import agent_words, simulator_words
from armadico.launch.programs import end
from armadico.launch.society import Member, Options, members, mission
from armadico.mesh.link_faults import LinkFaults
from armadico.mesh.ports import free_port
from armadico.mobile.messages import MissionRequest, Waypoint
from armadico.observe.watching import kind_at
from armadico_tools.faults.checker import Checker
from armadico_tools.faults.injector import Injector
from armadico_tools.faults.observations import Bids, Came, Left, Observation, Passed, Published
from armadico_tools.faults.plan import Fault
from armadico_tools.faults.record import seconds_since
from armadico_tools.faults.serial_tap import Orders, Tap
from armadico_tools.hosts.namespaces import Network
from armadico_tools.testbed import WATCHER, Namespaces, Place

T = TypeVar("T")

FAR_M: Final = 90_000.0
"""A goal so far ahead that the robot drives as long as it is observed."""

REACH_M: Final = 100_000.0
"""The interface agent's `reach_m`, so that it accepts the goal."""

ROAD: Final = Scenario(name="road", world="empty", start=(0.0, 0.0, 0.0), goal=(9.0, 0.0, 0.0))
"""Straight ahead without obstacles: only goto bids."""

COMMAND_DELAY_S: Final = 1.0
"""Longest delay of a command at a busy observer after the order that obeys it. With seven processes
per core 49 ms were measured in 10 s; the first orders of a run differ each time."""

MISSION_S: Final = 2.0
"""A mission is requested again after this time, as long as there is none."""

SOON_S: Final = 30.0
"""Time limit for an expected event."""

QUERY_S: Final = 0.3
"""Period of querying all agents' bids while a condition is awaited."""

HELD_BACK_S: Final = 0.1
"""Observations are processed after this delay, to sort them by time."""

EARLIER_S: Final = 0.05
"""The tap reports at once, the mesh later. So a command counts as published this much before its
reception, to precede the observation that it is obeyed."""

WOKEN_S: Final = 1.0
"""Time to process what had waited, for an agent that hung, or after bad links."""


class TrialError(RuntimeError):
    """A trial was impossible; the message names the event that is missing."""


@dataclass
class Agent:
    """One process of the society. `label` is its agent's name, or another one for a twin."""

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
    """Starts all processes and observes them; as a context manager it ends them.

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
        """Prepare; `record` is a file for messages and journals. Starts no process."""
        self.place = place
        self.checker = checker or Checker()
        self.record = self.checker.record
        self.agents: dict[str, Agent] = {}
        self.count = 0  # for trials with one agent or host after another
        self._file = record
        self._recorder: subprocess.Popen[bytes] | None = None
        self._scenario, self._seed = scenario, seed
        self._hosts = dict(hosts or {})
        self._queue: queue.SimpleQueue[_Item] = queue.SimpleQueue()
        self._due: list[_Item] = []  # a heap of delayed observations
        self._orders = Orders()
        self._queried_at = float("-inf")
        self._sent_at = float("inf")  # when the last mission was requested; inf: not yet wanted
        self._goals = _goals(scenario)
        self._simulator: subprocess.Popen[bytes] | None = None
        self._mesh = place.onlooker()
        self._mesh.watch_alive(
            lambda _, one, there: self.observe(lambda at: (Came if there else Left)(at, one))
        )
        self._mesh.subscribe("**", self._arrived)
        # A tap on a port of the robot's host, which connects to the simulator's port.
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
        """Start the simulator and every agent of the scenario, and let the robot drive."""
        if self._file is not None:
            self._recorder = self._recording(self._file)
        self.start_simulator()
        for member in members(self._scenario, Options(seed=self._seed), self.tap.url):
            far = (f"reach_m={REACH_M:g}",) if member.name == "interface" else ()
            sets = (*member.sets, *far)
            self.add(member.name, member.name, self.host_of(member.name), sets, wait=False)
        for agent in self.agents.values():
            self._meet(agent, known=())
        self.until(lambda: self.record.owner.state is not None, "the robot's first cycle")
        self._sent_at = float("-inf")
        self.until(self.record.on_its_way, "the robot is on its way")

    def _recording(self, path: Path) -> subprocess.Popen[bytes]:
        """Start a recorder, and wait until it writes."""
        host, joining = self.place.watching
        path = path.resolve()
        words = ["record", str(path), "--quiet", "--namespace", self.place.namespace, *joining]
        recorder = self.place.start(host, "recorder", words)
        self.until(lambda: path.is_file() and path.stat().st_size > 0, "the recording's beginning")
        return recorder

    def start_simulator(self) -> None:
        """Start the simulator, or restart it on the same port."""
        host, namespace = self.host_of("robot"), self.place.namespace
        words = simulator_words(self._scenario, self._seed, namespace, self._sim_port)
        words += self.place.joining_onlooker()
        self._simulator = self.place.start(host, "simulator", words)

    def kill_simulator(self) -> None:
        """Kill it by SIGKILL, which closes its TCP line."""
        assert self._simulator is not None, "it was started"
        self._simulator.kill()
        self._simulator.wait()

    def add(
        self, label: str, name: str, host: str, sets: Sequence[str] = (), *, wait: bool = True
    ) -> None:
        """Start an agent, which may be a twin of another; `wait` for its token."""
        known = self.record.contest.instances(name)
        agent = self.agents[label] = Agent(label, name, host, tuple(sets))
        self._run(agent)
        if wait:
            self._meet(agent, known)

    def restart(self, label: str) -> None:
        """Restart an agent that has ended."""
        agent = self.agents[label]
        known = {*self.record.contest.instances(agent.name), agent.instance}
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
        """Wait for the token of an instance that is not in `known`."""
        before = set(known)

        def new() -> list[str]:
            if agent.process is not None and agent.process.poll() is not None:
                words = "\n".join(self.place.last_lines(agent.label))
                raise TrialError(f"{agent.label} ended:\n{words}")
            return [one for one in self.record.contest.instances(agent.name) if one not in before]

        agent.instance = self.until(new, f"the token of {agent.label}")[-1]

    def on_host(self, *hosts: str) -> tuple[str, ...]:
        """The labels of the agents on some hosts."""
        return tuple(agent.label for agent in self.agents.values() if agent.host in hosts)

    def label_of(self, instance: str) -> str:
        found = [a.label for a in self.agents.values() if a.instance == instance]
        return found[0] if found else agent_of(instance)

    def _keep_going(self) -> None:
        """Request a mission if there is none, or the last goal is reached."""
        now = time.monotonic()
        if self.record.driving or now - self._sent_at < MISSION_S:
            return
        self._sent_at = now
        goal = self._goals[0]
        self._goals.rotate(-1)
        self._mesh.query(
            service_of(MissionRequest).key,
            MissionRequest(goal, planned=planned(self._scenario)),
            MISSION_S,
            lambda *_: None,  # the outcome is published on mission/status
            lambda: None,
        )

    # Time ----------------------------------------------------------------------------------------

    def run(self, seconds: float) -> None:
        """Process observations for some time."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            self._pump(left)

    def until(self, condition: Callable[[], T | None], what: str, within: float = SOON_S) -> T:
        """Process observations until a condition holds. Returns its value. Raises TrialError."""
        end = time.monotonic() + within
        while not (value := condition()):
            left = end - time.monotonic()
            if left <= 0:
                lines = [f"\n    {log.text}" for _, log in list(self.record.kept.logs)[-5:]]
                raise TrialError(f"not within {within:.0f} s: {what}{''.join(lines)}")
            self._query_bids()
            self._pump(min(left, 0.1))
        assert value is not None, "it is true"
        return value

    def _pump(self, wait: float) -> None:
        """Process due observations in the order of time; wait for the next one."""
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

    # Callbacks on other threads ------------------------------------------------------------------

    def observe(self, make: Callable[[float], Observation | None], at: float | None = None) -> None:
        """Queue an observation of a moment (default: now), for processing in order."""

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
            return Published(at, message)
        if not message.bids:
            return None
        last, state = message.bids[-1], self.record.owner.state
        age = seconds_since(last.cycle, None if state is None else state.cycle)
        return Bids(at, message.instance, last, age)

    def _query_bids(self) -> None:
        now = time.monotonic()
        if now - self._queried_at >= QUERY_S:
            self._queried_at = now
            key = BIDS.key_for(name="*", instance="*")
            self._mesh.query(key, Ask(), 0.5, self._arrived, lambda: None)

    def _crossed(self, data: bytes, at: float) -> None:
        for order in self._orders.feed(data, at):
            self.observe(lambda _, order=order: order, at)  # type: ignore[misc]


class LiveInjector(Injector):
    """Sends signals to processes, and sets faults of links between hosts."""

    def __init__(self, society: RealSociety) -> None:
        super().__init__(lambda seen: society.observe(lambda _: seen, seen.at))
        self._society = society
        self.acted_at = 0.0  # just before the last change
        self.acts = {
            "crash": self._crash,
            "hang": self._hang,
            "robot-restart": self._robot_restart,
            "partition": self._partition,
            "delay": self._worsen,
            "drop": self._worsen,
        }

    @property
    def now(self) -> float:
        return time.monotonic()

    def begin(self, fault: Fault, _: object = None) -> None:
        self.acted_at = self.now
        super().begin(fault)

    def end(self, fault: Fault, _: object = None) -> None:
        """Remove a fault, and wait until its targets have recovered."""
        self.acted_at = self.now
        super().end(fault)

    def _crash(self, fault: Fault, begins: bool) -> None:
        for label in fault.targets:
            if begins:
                self._society.signal(label, signal.SIGKILL)
            else:
                self._society.restart(label)

    def _hang(self, fault: Fault, begins: bool) -> None:
        for label in fault.targets:
            self._society.signal(label, signal.SIGSTOP if begins else signal.SIGCONT)
        if not begins:
            self._society.run(WOKEN_S)

    def _robot_restart(self, _fault: Fault, begins: bool) -> None:
        """Remove the simulator and its line, which voids the same promises.

        Without a line nothing can be ordered, and a restarted simulator stands still.
        """
        if begins:
            self._society.kill_simulator()
        else:
            self._society.start_simulator()
            self._drives_again()

    def _partition(self, fault: Fault, begins: bool) -> None:
        """Disconnect the hosts of some agents; amount 1: by their own network devices."""
        society, hosts = self._society, self._network.hosts
        there = {society.agents[label].host for label in fault.targets}
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
            alive = society.record.contest.alive
            society.until(lambda: alive.keys() >= every, "all tokens are back")

    def _worsen(self, fault: Fault, begins: bool) -> None:
        """Degrade all links between hosts, except the observer's."""
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
        society.until(lambda: society.record.kept.moves_after(since), "speeds are ordered again")
        society.until(society.record.on_its_way, "the robot is on its way again")

    @property
    def _network(self) -> Network:
        place = self._society.place
        assert isinstance(place, Namespaces), "it needs hosts"
        return place.network


def _goals(scenario: Scenario) -> deque[Waypoint]:
    """The scenario's goal and start in turns; on the road only a far goal."""
    if scenario is ROAD:
        return deque([Waypoint(FAR_M, 0.0, 0.0)])
    there = mission(scenario)
    assert there is not None, "faults are injected on the way to a goal"
    return deque([there.goal, Waypoint(*scenario.start)])
