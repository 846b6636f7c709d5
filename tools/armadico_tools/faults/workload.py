"""The workload: a whole society drives a shipped scenario to and fro while faults befall it.

It makes the faults and drives; what is right or wrong it leaves to the checker, to which it shows
what can be seen from outside, and besides the bids of those who are silent.
"""

from __future__ import annotations

import traceback
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from math import hypot
from random import Random
from typing import Any, Final

from msgspec import structs

from armadico.bridge.robot import Robot
from armadico.config.scenarios import load_scenario, society
from armadico.core.coordination import Owner, Verdict
from armadico.core.messages import Ack, Claim, Command, Message, RobotState, Stop
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
    Truth,
    Waypoint,
)
from armadico.mobile.obstacles import Obstacles
from armadico_tools.faults.checker import Checker, Violation
from armadico_tools.faults.fault_types import Promise
from armadico_tools.faults.injector import VirtualInjector
from armadico_tools.faults.plan import Case, Outcome, draw, vary
from armadico_tools.faults.record import (
    Astray,
    Bids,
    Denied,
    Left,
    Missed,
    Obeyed,
    Observation,
    Passed,
    Refused,
    Said,
    bounds_of,
    of_the_wheels,
)
from armadico_tools.faults.recovery import FORGOTTEN_S
from armadico_tools.faults.serial_tap import Orders
from armadico_tools.faults.sightings import Sight

SCENARIOS: Final = ("sc1", "sc2", "sc3", "sc4", "rooms-a", "rooms-b", "offices", "house")

LOOK_S: Final = 0.5
"""How often the workload looks whether there is a mission."""

MISSION_S: Final = 90.0
"""After so long the robot is sent elsewhere: it may have lost its way with its pose. What a fault
has put wrong, the society mends itself or not at all."""

BOOTED_S: Final = 1e5
"""Clocks of the processes begin anywhere within this."""

SEEN: Final = (RobotState, Ack, Claim, Command, Stop, MissionStatus, Truth, Pose, Obstacles)


def case_of(seed: int, lasts: float, only: Sequence[str] = (), scenario: str | None = None) -> Case:
    """The case that a seed draws: a scenario and faults, for so many s.

    Of the kinds that are given; else of some that the seed draws.
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
        self.mesh.watch(self._said, *SEEN)
        self.mesh.joined = self._joined
        for node in self.mesh.nodes:
            self._joined(node)
        self._injector = VirtualInjector(self.rehearsal, self.observe, case.variation)
        self._ends = _ends(self.rehearsal)
        self._heading_for = 0
        self._asked = False
        self._mission_at = 0.0  # when it was taken on
        self._none_at: float | None = None  # since when it is not known
        self._status = MissionState.NONE
        self._truth: Truth | None = None
        self._driven = 0.0
        self._looked: dict[str, int] = {}
        self._elsewhere: set[int] = set()  # epochs of robot agents with controllers of their own
        self.missions = self.again = 0
        self.error: tuple[float, str] | None = None
        self._broken: set[Promise] = set()

    def run(self, until: Promise | None = None) -> Outcome:
        """Drive to the end of the case, or until a promise is broken."""
        self._injector.schedule(self.case.faults)
        self.mesh.call_at(1.0, self._order)
        try:
            self.mesh.run(self.case.lasts, None if until is None else lambda: until in self._broken)
        except Exception:  # an agent that raises dies; here the run ends, and shows where
            lines = traceback.format_exc().strip().splitlines()
            where = next((x.strip() for x in reversed(lines) if x.startswith("  File")), "")
            self.error = (self.mesh.now, f"{lines[-1]} ({where})")
        self.observe(Passed(self.mesh.now))
        return self.outcome()

    def outcome(self) -> Outcome:
        """What came of it so far."""
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
            unsaid_s=round(self.checker.unsaid_s, 2),
            sights={sight.name: self.checker.sights.counts[sight] for sight in Sight},
        )

    # What the checker is shown -------------------------------------------------------------------

    def observe(self, seen: Observation) -> list[Violation]:
        """Show the checker one observation."""
        found = self.checker.update(seen)
        self._broken.update(violation.promise for violation in found)
        return found

    def _said(self, _key: str, message: Message, now: float) -> None:
        if not of_the_wheels(message):
            return
        cycle = getattr(message, "cycle", None)
        if cycle is not None and cycle.epoch in self._elsewhere:
            if isinstance(message, Pose):
                self.observe(Astray(now))
            return
        if isinstance(message, Claim) and message.utility is None:
            self._show_bids()  # whether who lets go bids on
        self.observe(Said(now, message))
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

    def _show_bids(self) -> None:
        """The bids that are new since the last look, and who is no longer there."""
        there = set()
        for node in self.mesh.nodes:
            agent = node.agent
            if not node.alive or not agent.competes_for:
                continue
            there.add(agent.instance)
            if agent.bids and id(agent.bids[-1]) != self._looked.get(agent.instance):
                self._looked[agent.instance] = id(agent.bids[-1])
                self.observe(Bids(self.mesh.now, agent.instance, agent.bids[-1]))
        for instance in [name for name in self._looked if name not in there]:
            del self._looked[instance]
            self.observe(Left(self.mesh.now, instance))

    def _refused(self, node: Node) -> None:
        self.observe(Denied(self.mesh.now, node.agent.instance, node.driver.refusal))
        self._injector.refused(node)

    def _joined(self, node: Node) -> None:
        """Tap a robot agent's line, whom it obeys, and which live agents any agent misses."""
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

        _before(agent, "disappeared", disappears)
        if not isinstance(agent, Robot):
            return
        if node.device is self.rehearsal.robot:
            _before(agent, "write", writes)
            _tap_owner(agent.owner(WHEELS), self)
        else:
            _before(agent, "publish", publishes)

    # Missions ------------------------------------------------------------------------------------

    def _order(self, _a: Any = None, _b: Any = None) -> None:
        """Send the robot on when it has arrived, or has no mission."""
        self.mesh.call_at(self.mesh.now + LOOK_S, self._order)
        late = self.mesh.now - self._mission_at > MISSION_S
        if self._asked or (self._status is MissionState.DRIVING and not late):
            return
        if self._status is MissionState.REACHED or late:
            self.missions += self._status is MissionState.REACHED
            self._heading_for = 1 - self._heading_for
        elif self._mission_at:  # it is not known any more
            if self._none_at is None or self.mesh.now - self._none_at < 2 * FORGOTTEN_S:
                return  # whoever starts again has a while to receive it
            self.again += 1
        self._asked = True
        self.mesh.ask(self._ends[self._heading_for], self._answered, timeout=5.0)

    def _answered(self, reply: Message | None) -> None:
        self._asked = False
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


def _before(agent: Any, name: str, then: Callable[..., None]) -> None:
    """Have a method of one instance call a function with its arguments first."""
    method = getattr(agent, name)

    def tapped(*args: Any, **named: Any) -> Any:
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
    """When a case breaks a promise (s), or None. It is run no farther."""
    found = run(case, promise).violations
    return next((at for name, at, _ in found if name == promise.name), None)
