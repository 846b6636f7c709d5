"""One case on the virtual mesh: the robot agent, its simulator and a hostile holder, nothing else.

So whatever prevents contacts is in the robot agent.
"""

from __future__ import annotations

from dataclasses import replace
from math import atan2, cos, inf, sin
from typing import Final

import numpy as np
from msgspec import Struct
from msgspec.structs import replace as altered

from armadico.bridge.kind import kind_of
from armadico.bridge.robot import Parameters, Robot
from armadico.bridge.simulator.robots import staged
from armadico.bridge.simulator.simulated import SimulatedRobot
from armadico.bridge.simulator.traps import KIND
from armadico.config.moving import Moving
from armadico.config.profile import load_profile
from armadico.config.scenarios import Scenario
from armadico.core import agent
from armadico.core.exchange import Bid
from armadico.core.messages import Message, RobotState
from armadico.core.resources import WHEELS
from armadico.mesh.link_faults import LinkFaults
from armadico.mesh.topology import DEFAULT_NAMESPACE
from armadico.mesh.virtual import VirtualMesh
from armadico.mesh.virtual_place import address
from armadico.mobile.messages import Scan, Sonar, Truth
from armadico.mobile.scans import points_of
from armadico_tools.falsify.cases import Case
from armadico_tools.faults.contacts import PREVENTABLE, Judge

UTILITY: Final = 0.99

SETTLE_S: Final = 1.0
"""Time of the handshake with the controller."""

SLOW_M_S: Final = 0.05
"""A slower robot counts as this fast, in the time to a contact."""

SPARED_S: Final = 1.0
"""The worth of a case that ends by a contact that no sensor could have prevented, s."""


class Plan(agent.Parameters, frozen=True, kw_only=True):
    """What the hostile holder commands: see `Case`."""

    commands: tuple[tuple[float, float], ...] = ((0.0, 0.0),)
    towards: float = 0.0
    each_s: float = 1.0
    w_max: float = 1.0


class Hostile(agent.Agent):
    """A holder that bids in every cycle and drives on, whatever is in the way."""

    name = "hostile"
    competes_for = (WHEELS,)
    reacts_to = RobotState
    receives = (Sonar, Scan)
    parameters = Plan
    p: Plan

    def __init__(self, identity: agent.Identity, parameters: Plan) -> None:
        super().__init__(identity, parameters)
        self._began: float | None = None

    def bid(self, _state: RobotState) -> Bid:
        """Bid the command of the present phase, turned towards what is nearest."""
        if self._began is None:
            self._began = self.now
        phase = int((self.now - self._began) / self.p.each_s) % len(self.p.commands)
        v, w = self.p.commands[phase]
        w += self.p.towards * self._bearing()
        return Bid(UTILITY, (v, max(-self.p.w_max, min(w, self.p.w_max))))

    def _bearing(self) -> float:
        """The direction of the nearest reading, rad; 0 without one."""
        sonar, scan = self.latest(Sonar), self.latest(Scan)
        echoes = () if sonar is None else sonar.echoes
        places = np.array(
            [
                (e.x + e.range * cos(e.bearing), e.y + e.range * sin(e.bearing))
                for e in echoes
                if e.range is not None
            ]
        ).reshape(-1, 2)
        if scan is not None:
            places = np.concatenate([places, points_of(scan)])
        if not len(places):
            return 0.0
        x, y = places[np.argmin(np.hypot(*places.T))].tolist()
        return atan2(y, x)


class Outcome(Struct, frozen=True):
    """The result of a case.

    `worth` is what the search minimises: the shortest time to a contact, s, or minus the speed of
    one (m/s) that the sensors could have prevented. `cause` is that of the first contact, "" if
    there is none; `at` its time, s.
    """

    case: Case
    cycles: int
    worth: float
    cause: str = ""
    at: float = 0.0
    speed: float = 0.0

    @property
    def found(self) -> bool:
        """Whether a contact was made that the sensors could have prevented."""
        return self.cause in {cause.value for cause in PREVENTABLE}


class Trial:
    """A case, under way until its first contact that is the robot's."""

    def __init__(self, case: Case) -> None:
        profile = load_profile(case.robot)
        self.case, self.mesh = case, VirtualMesh(case.seed)
        self.robot = _simulated(case, self.mesh)
        self.robot.watch(self.mesh.publish)
        plan = Plan(
            commands=case.commands,
            towards=case.towards,
            each_s=case.lasts / len(case.commands),
            w_max=profile.limits.w_max,
        )
        own = Parameters(port="memory:", profile=case.robot)
        self.mesh.add(Robot(self.mesh.identity(Robot.name), own), self.robot)
        self.mesh.add(Hostile(self.mesh.identity(Hostile.name), plan))
        link = self.mesh.link(*(address(DEFAULT_NAMESPACE, n) for n in ("hostile", "robot")))
        link.faults = LinkFaults(delay=case.delay)
        self._judge = Judge(self.robot.plant)
        self._reach = self.robot.plant.body.reach_m
        self.cycles, self.worth = 0, inf
        self._speed = self._hit_at = self._hit_speed = 0.0
        self.cause = ""
        self.mesh.watch(self._on_reading, Sonar, Scan)
        self.mesh.watch(self._on_truth, Truth)

    def run(self) -> Outcome:
        self.mesh.run(SETTLE_S + self.case.lasts, lambda: bool(self.cause))
        return Outcome(
            self.case,
            self.cycles,
            round(self.worth, 6),
            self.cause,
            round(self._hit_at, 3),
            round(self._hit_speed, 3),
        )

    def _on_reading(self, _key: str, message: Message, now: float) -> None:
        assert isinstance(message, Sonar | Scan), "only readings are watched"
        self._judge.on_reading(message, now)

    def _on_truth(self, _key: str, message: Message, now: float) -> None:
        assert isinstance(message, Truth), "only the truth is watched"
        self.cycles += 1
        before, pace = self._speed, abs(message.v) + self._reach * abs(message.w)
        self._speed = pace
        cause = self._judge.on_truth(message)
        if cause is not None:
            self._hit_at, self._hit_speed, self.cause = now, before, cause.value
            self.worth = -max(before, pace) if cause in PREVENTABLE else SPARED_S
        elif message.clearance is not None and pace > 0.0:
            self.worth = min(self.worth, message.clearance / max(pace, SLOW_M_S))


def run(case: Case) -> Outcome:
    """Run a case to its end, or to the first contact. Raises ConfigError."""
    return Trial(case).run()


def _simulated(case: Case, mesh: VirtualMesh) -> SimulatedRobot:
    """The simulated robot among the people of a case, with sensors that lose readings."""
    people = tuple(
        Moving(kind="person", at=(x, y), speed=speed, radius=0.25, heeds=False)
        for x, y, speed in case.people
    )
    scenario = Scenario(world=case.world, start=case.start, robot=case.robot, moving=people)
    kind = kind_of(load_profile(case.robot))
    kind.check()
    profile, stage = staged(scenario, mesh.stream, "", KIND & kind.unkind, 0.0)
    lossy = altered(stage.sensors, dropout=case.dropout, laser_dropout=case.dropout)
    return kind.simulated(profile, replace(stage, sensors=lossy))
