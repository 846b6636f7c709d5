"""The battery charger: to the dock in time, in, and out again; what is enough (3.2.2, 3.6.4)."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from itertools import pairwise
from math import degrees, hypot
from typing import Any, ClassVar

import pytest
from msgspec.structs import replace

from armadico.agents.missions.messages import ChargeState, ChargeStatus, EnergyReply, EnergyRequest
from armadico.config.scenarios import Battery, Scenario, load_scenario
from armadico.config.worlds import load_world
from armadico.core.agent import Identity
from armadico.core.messages import Log, Message
from armadico.launch.society import Options
from armadico.launch.virtual import Rehearsal
from armadico.mobile.driven import Stage
from armadico.mobile.geometry import relative
from armadico.mobile.messages import BatteryLevel, Pose, Truth, Waypoint
from armadico.mobile.resources import TRAJECTORY
from tests.missions.senders import Sender

CHARGING = ("battery-sensor", "battery-charger", "dock")
E = Waypoint(12.6, 1.2, -1.57)
SMALL = 0.8
"""Ah: such a battery is charged in minutes."""


class Rounds(Sender):
    """Stands in for mission planning: has the robot driven to one goal after another."""

    queries: ClassVar[tuple[type[Message], ...]] = (EnergyRequest,)
    utility = 0.45  # a mission of priority 0.5

    def __init__(self, identity: Identity, parameters: Any = None) -> None:
        super().__init__(identity, parameters)
        self.goals: list[Waypoint] = []
        self.reached = 0

    def send(self, pose: Pose) -> None:
        if self.errand.stage is Stage.REACHED:
            self.reached += 1
            self.errand.drop()
        if self.goals and not self.errand.under_way:
            self.errand.go(self.goals.pop(0), pose)


class Society:
    """A virtual society with a battery, and somebody who sends the robot about."""

    def __init__(
        self,
        charge: float,
        world: str = "house",
        *,
        seed: int = 3,
        capacity_ah: float = SMALL,
        start: tuple[float, float, float] | None = None,
        sensors: str = "ideal",
        without: tuple[str, ...] = (),
    ) -> None:
        found: Scenario = load_scenario(world)
        gone = ("localization", "relocate") if sensors == "ideal" else ()
        agents = tuple(a for a in (*found.agents, *CHARGING) if a not in (*gone, *without))
        scenario = replace(
            found,
            goal=None,
            agents=agents,
            sensors=sensors,
            start=start or found.start,
            battery=Battery(charge, capacity_ah),
        )
        self.docks = load_world(scenario.world).docks
        self.rehearsal = Rehearsal(scenario, Options(seed=seed))
        self.mesh = self.rehearsal.mesh
        self.states: list[tuple[float, ChargeState]] = []
        self.logs: list[str] = []
        self.truth: Any = None
        self.least_volts = 99.0
        self.mesh.watch(self._status, ChargeStatus)
        self.mesh.watch(lambda _k, log, _t: self.logs.append(log.text), Log)
        self.mesh.watch(self._true, Truth)
        self.mesh.watch(self._level, BatteryLevel)
        self.rehearsal.start()
        self.sender: Any = self.rehearsal.add(Rounds).agent

    def _status(self, _key: str, status: Any, now: float) -> None:
        if not self.states or self.states[-1][1] is not status.state:
            self.states.append((now, status.state))

    def _true(self, _key: str, truth: Any, _now: float) -> None:
        self.truth = truth

    def _level(self, _key: str, level: Any, _now: float) -> None:
        self.least_volts = min(self.least_volts, level.volts)

    @property
    def state(self) -> ChargeState:
        return self.states[-1][1]

    @property
    def off_dock(self) -> tuple[float, float, float]:
        """How far off the nearest dock's pose the robot truly is: m, m, degrees."""
        here = (self.truth.x, self.truth.y, self.truth.theta)
        dock = min(self.docks.values(), key=lambda d: hypot(d[0] - here[0], d[1] - here[1]))
        ahead, aside, turned = relative(dock, here)
        return ahead, aside, degrees(turned)

    def run(self, seconds: float) -> None:
        self.mesh.run(self.mesh.now + seconds)

    def until(self, done: Callable[[], bool], seconds: float) -> None:
        self.mesh.run(self.mesh.now + seconds, done)
        assert done(), (self.states[-6:], self.logs[-6:], self.sender.errand.stage)

    def kill(self, name: str) -> None:
        next(n for n in self.mesh.nodes if n.alive and n.agent.name == name).kill()

    def restart(self, name: str) -> None:
        self.kill(name)
        self.run(0.5)
        self.rehearsal.enter(name)


@pytest.mark.long
def test_with_little_left_it_charges_and_the_mission_ends_afterwards() -> None:
    society = Society(0.24, start=(E.x, E.y, E.theta))
    society.sender.goals = [Waypoint(2.2, 3.0, 1.57), E]
    society.until(lambda: society.sender.reached == 2, 900.0)
    found = [state for _, state in society.states]
    steps = [s for s in found if s in (ChargeState.DOCKING, ChargeState.CHARGING)]
    assert steps[:2] == [ChargeState.DOCKING, ChargeState.CHARGING]
    left = found.index(ChargeState.CHARGING) + 1
    assert found[left] is ChargeState.LEAVING
    assert society.truth.charge > 0.35
    assert society.truth.collisions == 0
    assert society.least_volts > 10.2


@pytest.mark.long(but=("house-31",))
@pytest.mark.parametrize(("world", "seed"), [("house", 31), ("floor", 33)])
def test_by_sonars_and_localization_it_docks_within_a_few_centimetres(
    world: str, seed: int
) -> None:
    society = Society(0.4, world, seed=seed, capacity_ah=5.0, sensors="real")
    society.until(lambda: society.states[-1][1] is ChargeState.CHARGING, 120.0)
    society.run(2.0)
    ahead, aside, turned = society.off_dock
    assert abs(ahead) < 0.04
    assert abs(aside) < 0.04
    assert abs(turned) < 5.0
    assert society.truth.collisions == 0
    assert abs(society.truth.v) < 0.01


def test_anybodys_robot_that_stands_for_a_task_is_not_driven_away() -> None:
    """What standing is worth, the charger sees by the claim for the trajectory, of any agent."""
    society = Society(0.9, capacity_ah=5.0)
    society.until(lambda: society.mesh.now > 3.0, 5.0)
    society.sender.errand.stand(society.sender.latest(Pose))
    society.run(2.0)
    society.rehearsal.robot.plant.battery.charge = 0.4
    society.restart("battery-sensor")  # it knows at once
    society.run(20.0)
    assert {state for _, state in society.states} == {ChargeState.NONE}
    society.sender.errand.drop()
    society.until(lambda: society.state is ChargeState.TO_DOCK, 5.0)


def test_lined_up_it_does_not_let_go_of_the_trajectory() -> None:
    society = Society(0.3, capacity_ah=2.0)
    charger: Any = next(n.agent for n in society.mesh.nodes if n.agent.name == "battery-charger")
    society.until(lambda: charger.errand.stage is Stage.REACHED, 60.0)
    bid = charger.bid_for(TRAJECTORY, None)
    assert bid is not None
    society.until(lambda: society.state is ChargeState.DOCKING, 5.0)
    assert charger.bid_for(TRAJECTORY, None).action == bid.action


@pytest.mark.long
def test_below_10_4_volts_it_goes_before_every_mission() -> None:
    society = Society(0.12, capacity_ah=5.0, start=(E.x, E.y, E.theta))
    society.sender.utility = 0.9
    society.sender.goals = [Waypoint(10.5, 8.0, 0.0)]
    society.until(lambda: society.state is ChargeState.CHARGING, 150.0)
    assert society.sender.reached == 0
    assert society.sender.errand.under_way


@pytest.mark.long
def test_with_half_left_it_charges_only_when_nobody_else_wants_to_drive() -> None:
    society = Society(0.45, capacity_ah=21.0)
    society.run(2.0)
    assert society.state is ChargeState.TO_DOCK  # nobody else wants to drive
    busy = Society(0.45, capacity_ah=21.0)
    busy.sender.goals = [E]
    busy.until(lambda: busy.sender.reached == 1, 120.0)
    assert ChargeState.DOCKING not in {state for _, state in busy.states}


@pytest.mark.long(but=("battery-sensor-charging",))
@pytest.mark.parametrize(
    ("name", "when"),
    [
        ("battery-charger", ChargeState.DOCKING),
        ("dock", ChargeState.DOCKING),
        ("battery-sensor", ChargeState.CHARGING),
    ],
)
def test_whoever_dies_on_the_way_into_the_dock_it_is_charged(name: str, when: ChargeState) -> None:
    society = Society(0.3, capacity_ah=2.0)
    society.until(lambda: bool(society.states) and society.state is when, 60.0)
    society.run(2.0)
    society.restart(name)
    society.until(lambda: society.truth.charge > 0.35, 120.0)
    assert society.state is ChargeState.CHARGING
    assert society.truth.collisions == 0


@pytest.mark.long
def test_a_charger_that_dies_while_it_backs_out_leaves_a_robot_that_drives_on() -> None:
    x, y, theta = load_world("house").docks["dock"]
    society = Society(0.7, capacity_ah=2.0, start=(x, y, theta))
    society.run(3.0)
    assert society.state is ChargeState.CHARGING
    society.sender.goals = [E]
    society.until(lambda: society.state is ChargeState.LEAVING, 20.0)
    society.run(1.0)
    society.kill("battery-charger")
    society.until(lambda: society.sender.reached == 1, 120.0)
    assert society.truth.collisions == 0


def test_a_silent_battery_sensor_is_told_of_and_the_voltage_itself_goes() -> None:
    society = Society(0.1, capacity_ah=5.0, without=("battery-sensor",))
    society.run(20.0)
    assert {state for _, state in society.states} == {ChargeState.NONE}
    society.until(lambda: society.state is ChargeState.CHARGING, 120.0)
    assert any("no battery/level" in text for text in society.logs)


@pytest.mark.long
def test_a_dock_without_power_is_tried_beside_and_then_left() -> None:
    society = Society(0.4, capacity_ah=5.0)
    society.rehearsal.robot.plant.battery._docks = ()
    society.until(lambda: any("will not do: no contact" in text for text in society.logs), 200.0)
    states = [state for _, state in society.states]
    tries = [
        pair for pair in pairwise(states) if pair == (ChargeState.DOCKING, ChargeState.LEAVING)
    ]
    assert len(tries) == 5
    assert society.truth.collisions == 0


def test_a_dock_that_will_not_do_is_left_for_another_one() -> None:
    society = Society(0.3, "floor")
    heard: list[ChargeStatus] = []
    society.mesh.watch(lambda _k, status, _t: heard.append(status), ChargeStatus)
    society.until(lambda: society.state is ChargeState.TO_DOCK, 30.0)
    first = heard[-1].name
    charger = next(node for node in society.mesh.nodes if node.name == "battery-charger").agent
    charger.errand.stage, charger.errand.note = Stage.FAILED, "somebody stands before it"
    society.until(lambda: heard[-1].name not in ("", first), 15.0)
    society.until(lambda: society.state is ChargeState.TO_DOCK, 10.0)


def test_without_a_dock_on_the_map_people_are_told() -> None:
    society = Society(0.1, "sc4")
    society.run(10.0)
    assert any("no dock on the map" in text for text in society.logs)
    reply = query(society, E)
    assert "no dock on the map" in reply.note


# Use case 2: is it enough? ------------------------------------------------------------------------


def query(society: Society, goal: Waypoint, energy: float = 0.0) -> EnergyReply:
    replies: list[Any] = []
    society.sender.query(EnergyRequest(goal, energy), replies.append, timeout=8.0)
    society.until(lambda: bool(replies), 10.0)
    assert replies[0] is not None
    found: EnergyReply = replies[0]
    return found


@cache
def waiting() -> Society:
    society = Society(0.55, capacity_ah=5.0)
    society.run(8.0)
    return society


def test_what_is_needed_is_the_way_there_the_way_on_to_a_dock_and_a_reserve() -> None:
    society = waiting()
    near, far = query(society, Waypoint(1.5, 1.5, 0.0)), query(society, E)
    assert near.enough
    assert far.enough
    assert near.needed < far.needed
    more = query(society, E, 5000.0)
    assert more.needed - far.needed == pytest.approx(1.3 * 5000.0, rel=0.05)
    assert far.left == pytest.approx(0.55 * 5.0 * 3600 * 10.8, rel=0.05)
    assert "kJ are left" in far.note


def test_a_goal_from_which_no_dock_is_reached_is_not_enough() -> None:
    reply = query(waiting(), Waypoint(99.0, 0.0, 0.0))
    assert not reply.enough
    assert "no way from there to a dock" in reply.note
