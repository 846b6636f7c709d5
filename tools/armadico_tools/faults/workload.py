"""The workload: a whole society drives a shipped scenario to and fro under faults.

It applies the faults and drives. It reports to the checker, which judges, what can be observed from
outside, and also the bids of silent agents.
"""

from __future__ import annotations

import traceback
from collections import Counter
from collections.abc import Callable, Container
from dataclasses import replace
from enum import StrEnum
from math import hypot
from random import Random
from typing import Final

from msgspec import structs

from armadico.agents.fleet.messages import FleetReply, FleetRequest, FleetStatus, FleetTask
from armadico.bridge.robot import Robot
from armadico.config.profile import load_profile
from armadico.config.scenarios import Scenario
from armadico.core.config_errors import ConfigError
from armadico.core.coordination import Owner, Verdict
from armadico.core.messages import Claim, Command, Message, RobotState, Stop
from armadico.core.resources import WHEELS
from armadico.core.services import derived
from armadico.launch.society import Options, errand, mission
from armadico.launch.virtual import Rehearsal
from armadico.mesh.virtual import Node, VirtualMesh
from armadico.mesh.virtual_network import Clock
from armadico.mobile.errand import Errands
from armadico.mobile.messages import (
    MissionReply,
    MissionRequest,
    MissionState,
    MissionStatus,
    Pose,
    Scan,
    Sonar,
    Truth,
    Waypoint,
)
from armadico.observe.audit.auditor import watched
from armadico_tools.faults.checker import Checker, Violation
from armadico_tools.faults.contacts import Surroundings
from armadico_tools.faults.fault_types import Promise
from armadico_tools.faults.hand import Hand
from armadico_tools.faults.injector import VirtualInjector
from armadico_tools.faults.observations import (
    Arrived,
    Asked,
    Astray,
    Bids,
    Denied,
    Left,
    Missed,
    Obeyed,
    Observation,
    Ordered,
    Passed,
    Published,
    Refused,
    of_the_wheels,
)
from armadico_tools.faults.plan import Case, Outcome
from armadico_tools.faults.planted import plant
from armadico_tools.faults.record import Bounds, bounds_of
from armadico_tools.faults.recovery import FORGOTTEN_S
from armadico_tools.faults.serial_tap import Orders
from armadico_tools.faults.sightings import Sight
from armadico_tools.faults.variants import BY_HAND, FLEET, VARIANTS, scenario_of

ORDER_S: Final = 0.5
"""Period of checking whether there is a mission."""

SKEW_S: Final = 0.1
"""Without status packets a cycle's odometry may be so much older than the truth, s: a cycle."""

COMPANY: Final = 3
"""Robots of a fleet: the first is watched and has the faults."""

NAMESAKE: Final = "robot"
"""The namespaces of a fleet: the first is the default one, robot1."""

BOOTED_S: Final = 1e5
"""The clocks of processes begin within this range."""

SEEN: Final[tuple[type[Message], ...]] = (*watched(), Claim, Stop)


class End(StrEnum):
    """How a mission ended; the bed itself ends none."""

    REACHED = "reached"
    UNSURE = "at the goal as far as the pose is known, which is not far enough"
    FAILED = "failed"
    REFUSED = "refused"
    FORGOTTEN = "forgotten, and requested again"
    UNFINISHED = "unfinished at the end of the run"


class Workload:
    def __init__(self, case: Case, checker: Callable[[Bounds], Checker] = Checker) -> None:
        self.case = case
        varied = case.variation
        scenario, options = scenario_of(case)
        serial = load_profile(scenario.robot).section == "p2os"
        skew_s = 0.0 if serial else SKEW_S
        self.checker = checker(
            replace(
                bounds_of(scenario),
                skew_s=skew_s,
                coordination=case.coordination,
                margin=varied.margin,
            )
        )
        self._clocks = Random(f"clocks/{case.seed}")
        ties = Random(f"ties/{case.seed}") if varied.ties else None
        self.rehearsal = Rehearsal(
            scenario,
            options,
            self._clock,
            mesh=VirtualMesh(case.seed, ties=ties, lease=varied.lease),
        )
        self._others = _others(self.rehearsal) if VARIANTS[case.variant].does == FLEET else []
        self.mesh = self.rehearsal.mesh
        self.mesh.refused = self._refused
        self.mesh.watch(self._on_message, *SEEN)
        self.mesh.joined = self._joined
        for node in self.mesh.nodes:
            self._joined(node)
        self._injector = VirtualInjector(self.rehearsal, self.observe, case.variation)
        around = Surroundings(self.rehearsal.robot.plant)
        self.mesh.watch(lambda _, __, now: around.look(now), Sonar, Scan)
        self.checker.touched = around.touched
        if serial:
            _before(self.rehearsal.robot, "receive", self._arrives)
        self._arrived = Orders()
        self._orders = _orders_of(self.rehearsal.scenario, options)
        self._heading_for = 0
        self._requested = self._ordered = False
        self._rests_until = 0.0
        self._number = self._done = 0  # of the mission; of a fleet's list, and its tasks done
        self._none_at: float | None = None  # since when there is none
        self._under_way, self._doubt = MissionState.NONE, ""
        self._by_status = scenario.mission is None and not scenario.tasks
        if not self._by_status:
            self.mesh.watch(self._on_progress, *derived(Errands), FleetStatus)
        hand = VARIANTS[case.variant].does == BY_HAND
        self._hand = Hand(self.rehearsal, case.seed) if hand else None
        self._truth: Truth | None = None
        self._driven = 0.0
        self._last_bids: dict[str, int] = {}  # ids of the last records, by instance
        self._elsewhere: set[int] = set()  # epochs of robot agents with other controllers
        self.ends: Counter[End] = Counter()
        self.error: tuple[float, str] | None = None
        self._broken: set[Promise] = set()

    def run(self, until: Container[Promise] = ()) -> Outcome:
        """Drive to the end of the case, or until one of these promises is broken."""
        self._injector.schedule(self.case.faults)
        self.mesh.call_at(1.0, self._order)
        try:
            self.mesh.run(self.case.lasts, lambda: any(each in until for each in self._broken))
        except Exception:  # an agent that raises dies; here the run ends, with the place
            lines = traceback.format_exc().strip().splitlines()
            where = next((x.strip() for x in reversed(lines) if x.startswith("  File")), "")
            self.error = (self.mesh.now, f"{lines[-1]} ({where})")
        self.observe(Passed(self.mesh.now))
        self.ends[End.UNFINISHED] += self._under_way is MissionState.DRIVING
        return self.outcome()

    def outcome(self) -> Outcome:
        """The result so far."""
        found = [(v.promise.name, round(v.at, 3), v.text) for v in self.checker.violations]
        if self.error is not None:
            found.append((Promise.NO_ERROR.name, round(self.error[0], 3), self.error[1]))
        return Outcome(
            case=self.case,
            faults=dict(Counter(fault.kind for fault in self.case.faults)),
            violations=tuple(found),
            longest_s=self.checker.longest,
            missions=self.ends[End.REACHED],
            driven_m=round(self._driven, 2),
            contacts=dict(sorted(self.checker.contacts.items())),
            moving_s={why: round(s, 1) for why, s in sorted(self.checker.moving_s.items())},
            overconfident_s=round(self.checker.overconfident_s, 2),
            ends={end.name: count for end, count in sorted(self.ends.items()) if count},
            needed=self.checker.needed(),
            sights={sight.name: self.checker.sights.counts[sight] for sight in Sight},
        )

    # Observations --------------------------------------------------------------------------------

    def observe(self, seen: Observation) -> list[Violation]:
        """Pass an observation to the checker."""
        found = self.checker.update(seen)
        self._broken.update(violation.promise for violation in found)
        return found

    def _on_message(self, _key: str, message: Message, now: float) -> None:
        if not of_the_wheels(message) or self._of_a_stranger(message):
            return
        cycle = getattr(message, "cycle", None)
        if cycle is not None and cycle.epoch in self._elsewhere:
            if isinstance(message, Pose):
                self.observe(Astray(now))
            return
        if isinstance(message, Claim) and message.utility is None:
            self._show_bids()  # to know whether an agent that releases still bids
        self.observe(Published(now, message))
        if isinstance(message, MissionStatus) and self._by_status:
            self._on_status(message)
        elif isinstance(message, Truth):
            if self._truth is not None:
                self._driven += hypot(message.x - self._truth.x, message.y - self._truth.y)
            self._truth = message
            self._show_bids()

    def _of_a_stranger(self, message: Message) -> bool:
        """Whether it is a claim or command of an agent of another protocol."""
        if not self._injector.skewed or not isinstance(message, Claim | Command):
            return False
        return message.ballot.instance in self._injector.skewed

    def _show_bids(self) -> None:
        """Observe new bids for the wheels, and agents that have gone."""
        there = set()
        for node in self._nodes:
            agent, instance = node.agent, node.agent.instance
            if (
                not node.alive
                or WHEELS not in agent.competes_for
                or instance in self._injector.skewed
            ):
                continue
            there.add(instance)
            bids = agent.kernel.bids
            newest = next((bid for bid in reversed(bids) if of_the_wheels(bid)), None)
            if newest is not None and id(newest) != self._last_bids.get(instance):
                self._last_bids[instance] = id(newest)
                self.observe(Bids(self.mesh.now, instance, newest))
        for instance in [name for name in self._last_bids if name not in there]:
            del self._last_bids[instance]
            self.observe(Left(self.mesh.now, instance))

    @property
    def _nodes(self) -> list[Node]:
        """The processes of the watched robot."""
        where = self.rehearsal.namespace
        return [node for node in self.mesh.nodes if node.namespace == where]

    def check_obeyed(self, command: Command) -> None:
        """An agent of another protocol must not drive: its messages may mean something else."""
        if command.ballot.instance in self._injector.skewed and self.error is None:
            self.error = (
                self.mesh.now,
                f"{command.ballot.instance}, of another protocol, is obeyed",
            )

    def _arrives(self, data: bytes, now: float) -> None:
        for _ in self._arrived.feed(data, now):
            self.observe(Arrived(now))

    def _refused(self, node: Node) -> None:
        if node.namespace != self.rehearsal.namespace:
            return
        self.observe(Denied(self.mesh.now, node.agent.instance, node.driver.refusal))
        self._injector.refused(node)

    def _joined(self, node: Node) -> None:
        """Tap a robot agent's line and verdicts, and any agent's false losses of others."""
        agent, orders = node.agent, Orders()
        if node.namespace != self.rehearsal.namespace:
            return

        def disappears(_name: str, instance: str, _now: float) -> None:
            nodes = self._nodes
            if any(other.alive and other.agent.instance == instance for other in nodes):
                self.observe(Missed(self.mesh.now, instance))

        def writes(data: bytes) -> None:
            for order in orders.feed(data, self.mesh.now):
                self.observe(order)

        def publishes(message: Message) -> None:
            if isinstance(message, RobotState):
                self._elsewhere.add(message.cycle.epoch)

        def drives(v: float, w: float) -> None:
            self.observe(Ordered(self.mesh.now, v, w))

        def connects(_data: bytes) -> None:
            session = vars(agent).get("_session")
            if session is not None and "drive" not in vars(session):
                _before(session, "drive", drives)

        def guard_brakes() -> None:
            self.observe(Ordered(self.mesh.now, 0.0, 0.0))

        if self.case.planted:
            plant(self.case.planted, agent)
        _before(agent.kernel, "disappeared", disappears)
        if not isinstance(agent, Robot):
            return
        if node.device is self.rehearsal.robot:
            serial = load_profile(self.rehearsal.scenario.robot).section == "p2os"
            _before(agent, "write", writes if serial else connects)
            _before(node, "braked", guard_brakes)
            _tap_owner(agent.owner(WHEELS), self)
        else:
            _before(agent.kernel, "publish", publishes)

    # Missions ------------------------------------------------------------------------------------

    def _order(self, _a: object = None, _b: object = None) -> None:
        """Order the next mission when the last one has ended, or is forgotten."""
        self.mesh.call_at(self.mesh.now + ORDER_S, self._order)
        if self._requested or self._under_way in (MissionState.DRIVING, MissionState.PLANNING):
            return
        if self._under_way in (MissionState.REACHED, MissionState.FAILED):
            if self._ordered:
                reached = End.UNSURE if self._doubt else End.REACHED
                self.ends[reached if self._under_way is MissionState.REACHED else End.FAILED] += 1
                self._heading_for, self._ordered = 1 - self._heading_for, False
                self._rests_until = self.mesh.now + self.case.variation.pause
            if self.mesh.now < self._rests_until:
                return
        elif self._ordered:  # it was forgotten
            if self._none_at is None or self.mesh.now - self._none_at < 2 * FORGOTTEN_S:
                return  # a restarted agent has a while to receive it
            self.ends[End.FORGOTTEN] += 1
        self._requested, self._ordered = True, False
        self._under_way = MissionState.NONE
        order = self._orders[self._heading_for % len(self._orders)]
        self.mesh.query(order, self._answered, timeout=5.0)

    def _answered(self, reply: Message | None) -> None:
        self._requested = False
        if isinstance(reply, FleetReply):
            reply = MissionReply(reply.list, reply.refusal)
        if not isinstance(reply, MissionReply):
            return
        if reply.refusal:
            self.ends[End.REFUSED] += 1
            return
        self._ordered, self._number, self._none_at = True, reply.mission, None
        self._under_way = MissionState.DRIVING
        order = self._orders[self._heading_for % len(self._orders)]
        if isinstance(order, MissionRequest):
            self.observe(Asked(self.mesh.now, reply.mission, order.goal))

    def _on_progress(self, _key: str, message: Message, _now: float) -> None:
        if isinstance(message, Errands):
            self._on_errands(message)
        elif isinstance(message, FleetStatus):
            self._on_tasks(message)

    def _on_errands(self, errands: Errands) -> None:
        """The progress of a mission of several tasks."""
        for each in errands.errands:
            if each.number == self._number and self._ordered:
                ended = MissionState.FAILED if each.failed else MissionState.REACHED
                self._under_way = ended if each.over else MissionState.DRIVING

    def _on_tasks(self, status: FleetStatus) -> None:
        """The progress of a fleet's list; each task is a mission."""
        if self._ordered and status.list == self._number:
            self.ends[End.REACHED] += max(status.done - self._done, 0)
            self._done = status.done
            if status.done >= status.tasks:
                self._ordered, self._under_way, self._done = False, MissionState.NONE, 0

    def _on_status(self, status: MissionStatus) -> None:
        """The progress of a goal."""
        ended = self._under_way in (MissionState.REACHED, MissionState.FAILED)
        if not (ended and status.state is MissionState.NONE):
            self._doubt = status.doubt
            self._under_way = status.state  # a new interface agent knows of no mission that ended
        if status.state is not MissionState.NONE:
            self._none_at = None
        elif self._none_at is None:
            self._none_at = self.mesh.now

    def _clock(self, _name: str) -> Clock:
        return Clock(self._clocks.uniform(0.0, BOOTED_S))


def _orders_of(scenario: Scenario, options: Options) -> tuple[Message, ...]:
    """The missions to the scenario's goal and back to its start, or its mission of several tasks.

    Raises ConfigError for a scenario without either.
    """
    if scenario.tasks:
        look_s = scenario.look_s
        tasks = tuple(FleetTask(Waypoint(*pose), look_s) for pose in scenario.tasks)
        return (FleetRequest(tasks, replace=True),)
    if scenario.mission is not None:
        order = errand(scenario, options)
        assert order is not None, "it is a mission"
        return (order,)
    there = mission(scenario)
    if there is None:
        raise ConfigError(f"{scenario.name}: no goal and no mission; faults need one")
    back = Waypoint(*scenario.start)
    return there, structs.replace(there, goal=back, waypoints=there.waypoints[::-1])


def _others(rehearsal: Rehearsal) -> list[Rehearsal]:
    """The other robots of a fleet, in the world of the first and on its mesh."""
    scenario, options, mesh = rehearsal.scenario, rehearsal.options, rehearsal.mesh
    found = []
    for number, start in enumerate(scenario.others[: COMPANY - 1], 2):
        mine = replace(options, namespace=f"{NAMESAKE}{number}")
        found.append(Rehearsal(structs.replace(scenario, start=start), mine, mesh=mesh))
    rehearsal.robot.meet(*(other.robot for other in found))
    return found


def _before(agent: object, name: str, then: Callable[..., None]) -> None:
    """Make a method of one instance call a function with its arguments first."""
    method = getattr(agent, name)

    def tapped(*args: object, **named: object) -> object:
        then(*args)
        return method(*args, **named)

    vars(agent)[name] = tapped


def _tap_owner(owner: Owner, workload: Workload) -> None:
    judge = owner.judge

    def tapped(command: Command, now: float, *, stopped: bool = False, fault: str = "") -> Verdict:
        verdict = judge(command, now, stopped=stopped, fault=fault)
        if verdict is Verdict.OBEYED:
            workload.check_obeyed(command)
            workload.observe(Obeyed(workload.mesh.now, command.ballot, command.cycle))
        elif verdict is not Verdict.RELEASED:
            workload.observe(Refused(workload.mesh.now, command.ballot, verdict.name))
        return verdict

    vars(owner)["judge"] = tapped


def run(
    case: Case,
    until: Container[Promise] = (),
    checker: Callable[[Bounds], Checker] = Checker,
) -> Outcome:
    """Run a case to its end, or until one of these promises is broken."""
    return Workload(case, checker).run(until)


def when_broken(case: Case, promise: Promise) -> float | None:
    """When a case breaks a promise (s), or None. The run ends there."""
    found = run(case, (promise,)).violations
    return next((at for name, at, _ in found if name == promise.name), None)
