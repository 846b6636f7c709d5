"""The workload: a whole society drives a shipped scenario to and fro under faults.

It applies the faults and drives. It reports to the checker, which judges, what can be observed from
outside, and also the bids of silent agents.
"""

from __future__ import annotations

import traceback
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from math import hypot
from random import Random
from typing import Final

from msgspec import structs

from armadico.bridge.robot import Robot
from armadico.config.scenarios import load_scenario, society
from armadico.core.coordination import Owner, Verdict
from armadico.core.messages import Claim, Command, Message, RobotState, Stop
from armadico.core.resources import WHEELS
from armadico.launch.society import Options, mission, prepared
from armadico.launch.virtual import Rehearsal
from armadico.mesh.virtual import Node, VirtualMesh
from armadico.mesh.virtual_network import Clock
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
from armadico_tools.faults.contacts import Cause, Surroundings, Witness
from armadico_tools.faults.fault_types import ALTERS, Promise
from armadico_tools.faults.injector import VirtualInjector
from armadico_tools.faults.observations import (
    Astray,
    Bids,
    Denied,
    Left,
    Missed,
    Obeyed,
    Observation,
    Passed,
    Published,
    Refused,
    of_the_wheels,
)
from armadico_tools.faults.plan import Case, Outcome, draw, vary
from armadico_tools.faults.record import SONARS_S, bounds_of
from armadico_tools.faults.recovery import FORGOTTEN_S
from armadico_tools.faults.serial_tap import Orders
from armadico_tools.faults.sightings import Sight

SCENARIOS: Final = ("sc1", "sc2", "sc3", "sc4", "rooms-a", "rooms-b", "offices", "house")

ORDER_S: Final = 0.5
"""Period of checking whether there is a mission."""

MISSION_S: Final = 90.0
"""After this time the robot gets another goal, because it may have lost its way with its pose. The
society has to correct the pose."""

BOOTED_S: Final = 1e5
"""The clocks of processes begin within this range."""

SEEN: Final = (*watched(), Claim, Stop)


def case_of(seed: int, lasts: float, only: Sequence[str] = (), scenario: str | None = None) -> Case:
    """The case of a seed: a scenario and faults, for so many s.

    The faults are of the kinds in `only`, else of some that the seed draws.
    """
    rng = Random(f"faults/{seed}")
    drawn = rng.choice(SCENARIOS)
    varied = vary(Random(f"variation/{seed}"))
    return Case(seed, scenario or drawn, lasts, draw(rng, lasts, tuple(only)), varied)


class Workload:
    def __init__(self, case: Case, checker: Checker | None = None) -> None:
        self.case = case
        varied = case.variation
        options = Options(
            seed=case.seed,
            margin=varied.margin,
            sensors=case.sensors,
            besides=society().ideal.without,
        )
        scenario = prepared(load_scenario(case.scenario), options)
        self.checker = checker or Checker(replace(bounds_of(scenario), skew_s=0.0))
        self._clocks = Random(f"clocks/{case.seed}")
        ties = Random(f"ties/{case.seed}") if varied.ties else None
        self.rehearsal = Rehearsal(
            scenario,
            options,
            self._clock,
            mesh=VirtualMesh(case.seed, ties=ties, lease=varied.lease),
        )
        self.mesh = self.rehearsal.mesh
        self.mesh.refused = self._refused
        self.mesh.watch(self._on_message, *SEEN)
        self.mesh.joined = self._joined
        for node in self.mesh.nodes:
            self._joined(node)
        self._injector = VirtualInjector(self.rehearsal, self.observe, case.variation)
        self._surroundings = Surroundings(self.rehearsal.robot.plant)
        stops_s, decel = SONARS_S + self.checker.record.bounds.stop_s, bounds_of(scenario).v_decel
        self._witness = Witness(
            self._surroundings.outline, lambda v: v * stops_s + v * v / (2.0 * decel)
        )
        self.checker.contact_cause = self._contact_cause
        self.mesh.watch(self._on_reading, Sonar, Scan)
        self._ends = _ends(self.rehearsal)
        self._heading_for = 0
        self._requested = False
        self._mission_at = 0.0  # when it was accepted
        self._none_at: float | None = None  # since when there is none
        self._status = MissionState.NONE
        self._truth: Truth | None = None
        self._driven = 0.0
        self._last_bids: dict[str, int] = {}  # ids of the last records, by instance
        self._elsewhere: set[int] = set()  # epochs of robot agents with other controllers
        self.missions = self.again = 0
        self.error: tuple[float, str] | None = None
        self._broken: set[Promise] = set()

    def run(self, until: Promise | None = None) -> Outcome:
        """Drive to the end of the case, or until a promise is broken."""
        self._injector.schedule(self.case.faults)
        self.mesh.call_at(1.0, self._order)
        try:
            self.mesh.run(self.case.lasts, None if until is None else lambda: until in self._broken)
        except Exception:  # an agent that raises dies; here the run ends, with the place
            lines = traceback.format_exc().strip().splitlines()
            where = next((x.strip() for x in reversed(lines) if x.startswith("  File")), "")
            self.error = (self.mesh.now, f"{lines[-1]} ({where})")
        self.observe(Passed(self.mesh.now))
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
            missions=self.missions,
            driven_m=round(self._driven, 2),
            again=self.again,
            contacts=dict(sorted(self.checker.contacts.items())),
            moving_s={why: round(s, 1) for why, s in sorted(self.checker.moving_s.items())},
            overconfident_s=round(self.checker.overconfident_s, 2),
            sights={sight.name: self.checker.sights.counts[sight] for sight in Sight},
        )

    # Observations --------------------------------------------------------------------------------

    def observe(self, seen: Observation) -> list[Violation]:
        """Pass an observation to the checker."""
        found = self.checker.update(seen)
        self._broken.update(violation.promise for violation in found)
        return found

    def _on_message(self, _key: str, message: Message, now: float) -> None:
        if not of_the_wheels(message):
            return
        cycle = getattr(message, "cycle", None)
        if cycle is not None and cycle.epoch in self._elsewhere:
            if isinstance(message, Pose):
                self.observe(Astray(now))
            return
        if isinstance(message, Claim) and message.utility is None:
            self._show_bids()  # to know whether an agent that releases still bids
        self.observe(Published(now, message))
        if isinstance(message, MissionStatus):
            ended = self._status is MissionState.REACHED and message.state is MissionState.NONE
            if not ended:  # a new interface agent publishes nothing of a mission that has ended
                self._status = message.state
            if message.state is not MissionState.NONE:
                self._none_at = None
            elif self._none_at is None:
                self._none_at = now
        elif isinstance(message, Truth):
            if self._truth is not None:
                self._driven += hypot(message.x - self._truth.x, message.y - self._truth.y)
            self._truth = message
            self._show_bids()

    def _on_reading(self, _key: str, message: Message, now: float) -> None:
        assert isinstance(message, Sonar | Scan), "only readings are watched"
        around, faults = self._surroundings, self.checker.record.faults.active
        around.look(now)
        speed = abs(self.rehearsal.robot.plant.speeds[0])
        altered = any(fault.kind in ALTERS for fault in faults)
        self._witness.on_reading(now, around.pose, speed, message, altered=altered)

    def _contact_cause(self) -> Cause | None:
        place_at = self._surroundings.touched()
        return None if place_at is None else self._witness.judge(place_at)

    def _show_bids(self) -> None:
        """Observe new bids, and agents that have gone."""
        there = set()
        for node in self.mesh.nodes:
            agent = node.agent
            if not node.alive or not agent.competes_for:
                continue
            there.add(agent.instance)
            if agent.kernel.bids and id(agent.kernel.bids[-1]) != self._last_bids.get(
                agent.instance
            ):
                self._last_bids[agent.instance] = id(agent.kernel.bids[-1])
                self.observe(Bids(self.mesh.now, agent.instance, agent.kernel.bids[-1]))
        for instance in [name for name in self._last_bids if name not in there]:
            del self._last_bids[instance]
            self.observe(Left(self.mesh.now, instance))

    def _refused(self, node: Node) -> None:
        self.observe(Denied(self.mesh.now, node.agent.instance, node.driver.refusal))
        self._injector.refused(node)

    def _joined(self, node: Node) -> None:
        """Tap a robot agent's line and verdicts, and any agent's false losses of others."""
        agent, orders = node.agent, Orders()

        def disappears(_name: str, instance: str, _now: float) -> None:
            nodes = self.mesh.nodes
            if any(other.alive and other.agent.instance == instance for other in nodes):
                self.observe(Missed(self.mesh.now, instance))

        def writes(data: bytes) -> None:
            for order in orders.feed(data, self.mesh.now):
                self.observe(order)

        def publishes(message: Message) -> None:
            if isinstance(message, RobotState):
                self._elsewhere.add(message.cycle.epoch)

        _before(agent.kernel, "disappeared", disappears)
        if not isinstance(agent, Robot):
            return
        if node.device is self.rehearsal.robot:
            _before(agent, "write", writes)
            _tap_owner(agent.owner(WHEELS), self)
        else:
            _before(agent.kernel, "publish", publishes)

    # Missions ------------------------------------------------------------------------------------

    def _order(self, _a: object = None, _b: object = None) -> None:
        """Send the robot on when it has arrived, or has no mission."""
        self.mesh.call_at(self.mesh.now + ORDER_S, self._order)
        late = self.mesh.now - self._mission_at > MISSION_S
        if self._requested or (self._status is MissionState.DRIVING and not late):
            return
        if self._status is MissionState.REACHED or late:
            self.missions += self._status is MissionState.REACHED
            self._heading_for = 1 - self._heading_for
        elif self._mission_at:  # it was forgotten
            if self._none_at is None or self.mesh.now - self._none_at < 2 * FORGOTTEN_S:
                return  # a restarted agent has a while to receive it
            self.again += 1
        self._requested = True
        self.mesh.query(self._ends[self._heading_for], self._answered, timeout=5.0)

    def _answered(self, reply: Message | None) -> None:
        self._requested = False
        if isinstance(reply, MissionReply) and not reply.refusal:
            self._mission_at = self.mesh.now
            self._status = MissionState.DRIVING

    def _clock(self, _name: str) -> Clock:
        return Clock(self._clocks.uniform(0.0, BOOTED_S))


def _ends(rehearsal: Rehearsal) -> tuple[MissionRequest, MissionRequest]:
    """The missions to the scenario's goal, and back to its start."""
    there = mission(rehearsal.scenario)
    assert there is not None, "faults are injected on the way to a goal"
    back = Waypoint(*rehearsal.scenario.start)
    return there, structs.replace(there, goal=back, waypoints=there.waypoints[::-1])


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
            workload.observe(Obeyed(workload.mesh.now, command.ballot, command.cycle))
        elif verdict is not Verdict.RELEASED:
            workload.observe(Refused(workload.mesh.now, command.ballot, verdict.name))
        return verdict

    vars(owner)["judge"] = tapped


def run(case: Case, until: Promise | None = None) -> Outcome:
    """Run a case to its end, or until a promise is broken."""
    return Workload(case).run(until)


def when_broken(case: Case, promise: Promise) -> float | None:
    """When a case breaks a promise (s), or None. The run ends there."""
    found = run(case, promise).violations
    return next((at for name, at, _ in found if name == promise.name), None)
