"""The workload: a whole society drives a shipped scenario to and fro while faults befall it.

It makes the faults and drives; what is right or wrong it leaves to the checker, to which it shows
what can be seen from outside, and besides the bids of those who are silent.
"""

from __future__ import annotations

import traceback
from collections import Counter
from collections.abc import Sequence
from math import hypot, radians
from random import Random
from typing import Any, Final

from msgspec import Struct

from armadico.agent import DeviceAgent
from armadico.bridge.robot import Robot
from armadico.config.loading import find, load
from armadico.config.profile import RobotProfile
from armadico.config.scenarios import load_scenario
from armadico.coordination import Owner, Verdict
from armadico.geometry import wrap
from armadico.mesh.virtual_network import Clock
from armadico.mesh.virtual_node import Node
from armadico.messages import (
    Ballot,
    Claim,
    Command,
    Cycle,
    Message,
    MissionReply,
    MissionRequest,
    MissionState,
    MissionStatus,
    Pose,
    RobotState,
    Truth,
    Waypoint,
)
from armadico.rehearsal import Rehearsal
from armadico.society import Options
from armadico.tools.faults.checker import Checker, Violation
from armadico.tools.faults.inflict import Inflictor
from armadico.tools.faults.kinds import KINDS, Promise
from armadico.tools.faults.observations import Bids, Left, Obeyed, Observation, Passed, Said
from armadico.tools.faults.orders import Orders
from armadico.tools.faults.plan import Case, draw
from armadico.tools.faults.situation import bounds_of

SCENARIOS: Final = ("sc1", "sc2", "sc3", "sc4", "rooms-a", "rooms-b", "offices", "house")

LOOK_S: Final = 0.5
"""How often the workload looks whether there is a mission."""

MISSION_S: Final = 90.0
"""After so long the robot is sent elsewhere: it may have lost its way with its odometry."""

LOST_M: Final = 0.3
"""If the pose is so far off when a mission ends, somebody sets it right: no localization yet."""

BOOTED_S: Final = 1e5
"""Clocks of the processes begin anywhere within this."""

SEEN: Final = (RobotState, Claim, Command, MissionStatus, Truth, Pose)


class Outcome(Struct, frozen=True):
    """What came of one case.

    `faults` counts them by kind, `violations` are (promise, at, text), `longest_s` is the longest
    time from healing to moving again, `missions` how many goals were reached.
    """

    case: Case
    faults: dict[str, int]
    violations: tuple[tuple[str, float, str], ...]
    longest_s: float | None
    missions: int
    driven_m: float


def case_of(
    seed: int, lasts: float, kinds: Sequence[str] = (), scenario: str | None = None
) -> Case:
    """The case that a seed draws: a scenario and faults of some kinds (all), for so many s."""
    rng = Random(f"faults/{seed}")
    drawn = rng.choice(SCENARIOS)
    return Case(seed, scenario or drawn, lasts, draw(rng, lasts, tuple(kinds) or tuple(KINDS)))


class Workload:
    """One case, being run."""

    def __init__(self, case: Case, checker: Checker | None = None) -> None:
        self.case = case
        scenario = load_scenario(case.scenario)
        profile = load(find("robots", scenario.robot), RobotProfile)
        self.checker = checker or Checker(bounds_of(profile))
        self._clocks = Random(f"clocks/{case.seed}")
        self.rehearsal = Rehearsal(scenario, Options(seed=case.seed), self._clock)
        self.mesh = self.rehearsal.mesh
        self.mesh.watch(self._said, *SEEN)
        self.mesh.joined = self._joined
        for node in self.mesh.nodes:
            self._joined(node)
        self._inflictor = Inflictor(self.rehearsal, self._show)
        self._ends = _ends(self.rehearsal)
        self._heading_for = 0
        self._asked = False
        self._mission_at = 0.0
        self._status = MissionState.NONE
        self._at: Pose | None = None
        self._truth: Truth | None = None
        self._driven = 0.0
        self._looked: dict[str, int] = {}
        self.missions = 0
        self.error: tuple[float, str] | None = None

    def run(self) -> Outcome:
        """Drive to the end of the case."""
        self._inflictor.schedule(self.case.faults)
        self.mesh.call_at(1.0, self._look)
        try:
            self.mesh.run(self.case.lasts)
        except Exception:  # an agent that raises dies; here the run ends, and says where
            lines = traceback.format_exc().strip().splitlines()
            where = next((x.strip() for x in reversed(lines) if x.startswith("  File")), "")
            self.error = (self.mesh.now, f"{lines[-1]} ({where})")
        self._show(Passed(self.mesh.now))
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
        )

    # What the checker is shown -------------------------------------------------------------------

    def _show(self, seen: Observation) -> list[Violation]:
        return self.checker.take(seen)

    def _said(self, _key: str, message: Message, now: float) -> None:
        self._show(Said(now, message))
        if isinstance(message, MissionStatus):
            self._status = message.state
        elif isinstance(message, Pose):
            self._at = message
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
                self._show(Bids(self.mesh.now, agent.instance, agent.bids[-1]))
        for instance in [name for name in self._looked if name not in there]:
            del self._looked[instance]
            self._show(Left(self.mesh.now, instance))

    def _joined(self, node: Node) -> None:
        """Tap a robot agent's line, and see whom it obeys."""
        agent = node.agent
        if isinstance(agent, Robot):
            _tap_line(agent, self)
            _tap_owner(agent.owner, self)

    # Missions ------------------------------------------------------------------------------------

    def _look(self, _a: Any = None, _b: Any = None) -> None:
        """Send the robot on when it has arrived, or has no mission."""
        self.mesh.call_at(self.mesh.now + LOOK_S, self._look)
        late = self.mesh.now - self._mission_at > MISSION_S
        if self._asked or (self._status is MissionState.DRIVING and not late):
            return
        if self._status is MissionState.REACHED or late:
            self.missions += self._status is MissionState.REACHED
            self._heading_for = 1 - self._heading_for
        self._put_right()
        self._asked = True
        self.mesh.ask(self._ends[self._heading_for], self._answered, timeout=5.0)

    def _answered(self, reply: Message | None) -> None:
        self._asked = False
        if isinstance(reply, MissionReply) and not reply.refusal:
            self._mission_at = self.mesh.now
            self._status = MissionState.DRIVING

    def _put_right(self) -> None:
        """Start the encoder agent again where the robot is, if it is far from there."""
        at, truth = self._at, self._truth
        if at is None or truth is None or hypot(at.x - truth.x, at.y - truth.y) < LOST_M:
            return
        for node in self._inflictor.alive("encoder"):
            if not node.hung:
                node.kill()
                self.rehearsal.start(
                    "encoder", f"x={truth.x}", f"y={truth.y}", f"theta={wrap(truth.theta)}"
                )

    def _clock(self, _name: str) -> Clock:
        return Clock(self._clocks.uniform(0.0, BOOTED_S))


def _ends(rehearsal: Rehearsal) -> tuple[MissionRequest, MissionRequest]:
    """There, and back."""
    scenario = rehearsal.scenario
    planned = scenario.plan == "rooms"
    between = scenario.waypoints if scenario.plan == "waypoints" else ()
    there = tuple(_waypoint(pose) for pose in between)
    return (
        MissionRequest(_waypoint(scenario.goal), there, planned),
        MissionRequest(_waypoint(scenario.start), there[::-1], planned),
    )


def _waypoint(pose: tuple[float, float, float]) -> Waypoint:
    return Waypoint(pose[0], pose[1], radians(pose[2]))


def _tap_line(agent: DeviceAgent, workload: Workload) -> None:
    orders, write = Orders(), agent.write

    def tapped(data: bytes) -> None:
        write(data)
        for order in orders.feed(data, workload.mesh.now):
            workload.checker.take(order)

    vars(agent)["write"] = tapped


def _tap_owner(owner: Owner, workload: Workload) -> None:
    judge = owner.judge

    def tapped(cycle: Cycle, ballot: Ballot, *, stopped: bool, sound: bool) -> Verdict:
        verdict = judge(cycle, ballot, stopped=stopped, sound=sound)
        if verdict is Verdict.OBEYED:
            workload.checker.take(Obeyed(workload.mesh.now, ballot, cycle))
        return verdict

    vars(owner)["judge"] = tapped


def run(case: Case) -> Outcome:
    """Run a case."""
    return Workload(case).run()
