"""The trajectory and the planner as resources: whoever wants them more has them (3.6)."""

from __future__ import annotations

from random import Random
from typing import Any

import pytest
from msgspec.structs import replace

from armadico.agents.missions.errands import Errand
from armadico.config.scenarios import load_scenario
from armadico.core.exchange import EXCHANGES, Bid
from armadico.core.messages import Claim, Point, RobotState, encode
from armadico.launch.society import Options
from armadico.launch.virtual import Rehearsal
from armadico.mobile.driven import Ordered, Stage
from armadico.mobile.messages import (
    MissionReply,
    MissionRequest,
    MissionState,
    MissionStatus,
    Pose,
    Trajectory,
    Way,
    Waypoint,
)
from armadico.mobile.resources import TRAJECTORY
from armadico.mobile.route import Route
from armadico.runtime.errors import MissionRefusedError
from tests.missions.senders import Sender

A, B, C = Waypoint(1.0, 0.0, 0.0), Waypoint(2.0, 0.0, 0.0), Waypoint(2.0, 2.0, 1.5)


ORIGIN = Point(0.0, 0.0)


def test_an_errand_keeps_why_it_is_unknown_whether_the_robot_is_at_its_goal() -> None:
    errand = Errand(Random(1))
    errand.trajectory(Trajectory(1, 7, (A,), ORIGIN))
    assert errand.resume(A, 7)
    errand.status(MissionStatus(7, MissionState.REACHED, 0.1, note="+-0.30 m"))
    assert (errand.stage, errand.note) == (Stage.REACHED, "+-0.30 m")
    errand.drop()
    assert errand.note == ""


def way(*waypoints: Waypoint, number: int = 1, start: Point = ORIGIN, leg: int = 0) -> Way:
    return Way(number, waypoints, start, leg)


class Once(Sender):
    """Has the robot driven to one goal, with a utility."""

    goal: Waypoint | None = None

    def on_start(self) -> None:
        self.stages: list[Stage] = []
        self.sent = False

    def send(self, pose: Pose) -> None:
        if self.goal is not None and not self.sent:
            self.sent = True
            state = self.latest(RobotState)
            self.errand.go(self.goal, pose, state.v if state else 0.0)

    def on_mission_status(self, status: MissionStatus) -> None:
        super().on_mission_status(status)
        if not self.stages or self.stages[-1] is not self.errand.stage:
            self.stages.append(self.errand.stage)


class Charger(Once):
    name = "other"
    utility = 0.9


class Society:
    """A virtual society that nobody has sent anywhere, and two who may."""

    def __init__(self, scenario: str = "sc4", seed: int = 5, exchange: str = "merging") -> None:
        found = replace(load_scenario(scenario), goal=None, sensors="ideal")
        agents = tuple(a for a in found.agents if a not in ("localization", "relocate"))
        self.rehearsal = Rehearsal(replace(found, agents=agents), Options(seed=seed))
        self.mesh = self.rehearsal.mesh
        self.speeds: list[tuple[float, float]] = []
        self.status: list[MissionStatus] = []
        self.mesh.watch(lambda _k, m, now: self.speeds.append((now, m.v)), RobotState)
        self.mesh.watch(lambda _k, m, _now: self.status.append(m), MissionStatus)
        self.holders: list[tuple[float, str, str]] = []
        self.mesh.watch(self._claimed, Claim)
        self.rehearsal.start()
        self.sender: Any = self.rehearsal.add(Once).agent
        self.other: Any = self.rehearsal.add(Charger).agent
        self.run(3.0)

    def _claimed(self, _key: str, claim: Any, now: float) -> None:
        if claim.resource != "wheels" and claim.utility is not None:
            last = [h for h in self.holders if h[1] == claim.resource][-1:]
            if not last or last[0][2] != claim.ballot.instance:
                self.holders.append((now, claim.resource, claim.ballot.instance))

    def run(self, seconds: float) -> None:
        self.mesh.run(self.mesh.now + seconds)

    def until(self, done: Any, seconds: float) -> None:
        self.mesh.run(self.mesh.now + seconds, done)
        assert done(), (self.sender.stages, self.other.stages, self.status[-3:])

    def who_had(self, resource: str) -> list[str]:
        return [who.split("-")[0] for _, held, who in self.holders if held == resource]


FAR, NEAR = Waypoint(6.3, 4.0, 0.0), Waypoint(1.5, 4.0, 0.0)


def test_one_who_wants_the_robot_somewhere_has_it_planned_and_driven() -> None:
    society = Society()
    society.sender.goal = NEAR
    society.until(lambda: society.sender.errand.stage is Stage.REACHED, 60.0)
    assert society.who_had("planner") == ["sender"]
    assert society.who_had("trajectory") == ["sender"]
    pose = society.sender.latest(Pose)
    assert (pose.x, pose.y) == pytest.approx((NEAR.x, NEAR.y), abs=0.15)


@pytest.mark.long
def test_who_wants_it_more_takes_it_and_the_loser_goes_on_afterwards() -> None:
    society = Society()
    society.sender.goal = FAR
    society.until(lambda: society.sender.errand.stage is Stage.DRIVING, 10.0)
    society.run(4.0)
    society.other.goal = NEAR
    society.until(lambda: society.other.errand.stage is Stage.REACHED, 60.0)
    assert society.sender.errand.stage is Stage.WAITING
    assert society.sender.errand.interrupted
    society.other.errand.drop()
    society.until(lambda: society.sender.errand.stage is Stage.REACHED, 90.0)
    assert society.who_had("trajectory") == ["sender", "other", "sender"]
    pose = society.sender.latest(Pose)
    assert (pose.x, pose.y) == pytest.approx((FAR.x, FAR.y), abs=0.15)


def test_the_robot_does_not_stop_where_the_winner_s_way_joins_the_present_one() -> None:
    society = Society("house")
    society.sender.goal = Waypoint(12.6, 1.2, -1.57)
    society.until(lambda: society.sender.errand.stage is Stage.DRIVING, 10.0)
    society.until(lambda: society.speeds[-1][1] > 0.3 and society.sender.latest(Pose).x > 4.0, 60.0)
    begun = society.mesh.now
    society.other.goal = Waypoint(9.0, 4.7, 0.0)  # in the corridor, the way it drives anyway
    society.until(lambda: society.other.errand.stage is Stage.DRIVING, 10.0)
    taken = society.mesh.now
    society.run(1.0)
    assert min(v for t, v in society.speeds if begun < t < taken + 1.0) > 0.25


def test_two_who_ask_the_planner_at_once_both_get_their_plan_the_better_first() -> None:
    society = Society()
    society.sender.goal, society.other.goal = FAR, NEAR
    society.until(lambda: society.sender.errand.plan and society.other.errand.plan, 10.0)
    assert society.who_had("planner")[-2:] == ["other", "sender"]


def test_people_are_told_that_the_robot_is_not_theirs() -> None:
    society = Society()
    society.sender.goal = FAR
    society.until(lambda: society.sender.errand.stage is Stage.DRIVING, 10.0)
    with pytest.raises(MissionRefusedError, match=r"sender-.* has the robot driven"):
        society.rehearsal.client.request_mission(MissionRequest(NEAR), find=5.0, again=0.0)


def test_who_dies_is_waited_for_and_finds_its_way_still_driven() -> None:
    society = Society()
    society.sender.goal = FAR
    society.until(lambda: society.sender.errand.stage is Stage.DRIVING, 10.0)
    goal, number = society.sender.errand.goal, society.sender.errand.way
    node = next(n for n in society.mesh.nodes if n.agent is society.sender)
    node.kill()
    society.run(3.0)
    again: Any = society.rehearsal.add(Sender, start=1).agent
    society.run(1.0)
    assert again.errand.resume(goal, number)
    again.sent = True
    society.until(lambda: again.errand.stage is Stage.REACHED, 90.0)
    assert {s.mission for s in society.status if s.state is MissionState.DRIVING} == {number}


def test_a_way_that_is_left_by_everybody_ends() -> None:
    society = Society()
    society.sender.goal = FAR
    society.until(lambda: society.sender.errand.stage is Stage.DRIVING, 10.0)
    society.sender.errand.drop()
    society.run(3.0)
    assert society.status[-1].state is MissionState.NONE
    assert society.speeds[-1][1] == pytest.approx(0.0, abs=0.02)


# The exchange alone ------------------------------------------------------------------------------


def merged(loser: Way, bid: Way) -> Way:
    packed = Bid(0.9, encode(bid))
    handover = EXCHANGES["merging"].begin(TRAJECTORY, encode(loser), 0.5, packed, 0.5)
    return TRAJECTORY.unpack(handover.action(1, packed))


def test_a_way_that_begins_on_the_loser_s_is_joined_to_it() -> None:
    joined = merged(way(A, B, C), way(Waypoint(3.0, 1.0, 0.0), number=2, start=Point(2.0, 1.0)))
    assert [(w.x, w.y) for w in joined.waypoints] == [(1, 0), (2, 0), (2, 1), (3, 1)]
    assert joined.id == 2
    assert joined.start == Point(0.0, 0.0)


def test_what_the_robot_has_passed_already_is_not_driven_again() -> None:
    loser = way(A, B, C, leg=1)
    joined = merged(loser, way(Waypoint(3.0, 1.0, 0.0), number=2, start=Point(2.0, 1.0)))
    assert [(w.x, w.y) for w in joined.waypoints] == [(2, 0), (2, 1), (3, 1)]
    assert joined.start == Point(1.0, 0.0)


def test_a_way_that_begins_elsewhere_is_driven_as_it_is() -> None:
    other = way(Waypoint(3.0, 1.0, 0.0), number=2, start=Point(5.0, 5.0))
    assert merged(way(A, B, C), other) == other


def test_the_winner_s_next_way_is_not_joined_to_the_first_loser_s() -> None:
    first, second = (
        way(C, number=2, start=Point(1.5, 0.0)),
        way(A, number=3, start=Point(1.5, 0.0)),
    )
    handover = EXCHANGES["merging"].begin(
        TRAJECTORY, encode(way(A, B, C)), 0.5, Bid(0.9, encode(first)), 0.5
    )
    assert TRAJECTORY.unpack(handover.action(9, Bid(0.9, encode(second)))) == second


def test_up_to_ends_at_a_place_on_the_way_and_looks_along_it() -> None:
    route = Route((A, B, C), Point(0.0, 0.0))
    assert route.up_to(2.0, 0.5)[:2] == (A, B)
    assert route.up_to(2.0, 0.5)[-1].theta == pytest.approx(1.5708, abs=1e-3)
    assert route.up_to(1.0, 1.0) == ()
    assert route.off(1.0, 1.0) == pytest.approx(1.0)


def test_an_order_that_is_withdrawn_before_its_answer_comes_is_not_the_next_one() -> None:
    order = Ordered()
    order.request(0.0)
    order.drop()
    assert order.pending, "the next one waits until the robot is not sent off twice"
    assert not order.answered(MissionReply(7, length=3.0), 0.5)
    assert (order.stage, order.mission, order.own) == (Stage.NONE, 0, {7})
