"""The interface agent: missions taken on or refused before anything moves; reached is at rest."""

from __future__ import annotations

from typing import cast

import pytest
from msgspec.structs import replace

from armadico.agents.interface.interface import Interface, Parameters
from armadico.agents.interface.messages import MissionCancel
from armadico.core.agent import WARNING, Identity
from armadico.core.cycles import PERIOD
from armadico.core.messages import (
    Cycle,
    Log,
    LogEvent,
    Message,
    Point,
    RobotState,
    Stop,
    Twist,
)
from armadico.mobile.messages import (
    WAYPOINTS,
    InitialPose,
    MapMoved,
    MissionReply,
    MissionRequest,
    MissionState,
    MissionStatus,
    Moved,
    Plan,
    PlanRequest,
    Pose,
    Stretch,
    Trajectory,
    Waypoint,
)
from armadico.mobile.obstacles import Obstacles
from armadico.testing import Alone, covariance
from tests.robot.robots import described

GOAL = Waypoint(3.0, 0.0, 0.0)
DOOR = Waypoint(1.0, 0.0, 0.0)
PLAN = Plan((DOOR, GOAL), 3.2, 40.0)
AT_REST, ROLLING = (0.0, 0.0), (0.1, 0.0)


class Desk(Alone):
    """An interface agent, and whoever asks it for something."""

    def __init__(self, *, begun: bool = True, parameters: Parameters | None = None) -> None:
        super().__init__(Interface(Identity("interface-1"), parameters), robot=None)
        if begun:
            self.agent.kernel.start(0.0)
        self.questions = 0
        self.x = 0.0  # m, of `drive`

    @property
    def replies(self) -> dict[int, MissionReply]:
        return cast("dict[int, MissionReply]", self.answers)

    def moved(
        self,
        x: float,
        y: float = 0.0,
        theta: float = 0.0,
        speed: tuple[float, float] = AT_REST,
        off_m: float = 0.0,
    ) -> None:
        """A cycle later the robot is there, by a pose that may be so far off."""
        self.speed = speed
        self.state()
        here = Pose(self.at, x, y, theta, covariance(off_m))
        self.give(*self.said(), here)
        self.wake()

    def said(self) -> list[Message]:
        """What else is said in a cycle."""
        return []

    def request(self, request: MissionRequest) -> int:
        self.questions += 1
        self.query(request, self.questions)
        return self.questions


@pytest.fixture
def desk() -> Desk:
    """The robot stands at the origin."""
    desk = Desk()
    desk.moved(0.0)
    return desk


@pytest.fixture
def driving(desk: Desk) -> Desk:
    """On its way over the door to the goal."""
    desk.request(MissionRequest(GOAL, (DOOR,), planned=False))
    return desk


def test_an_old_pose_will_not_do(desk: Desk) -> None:
    for number in range(2, 7):
        cycle = Cycle(1, number)
        desk.agent.kernel.receive(RobotState(cycle, 0, 0, 0, 0, 0, 12, True, False), number / 10)
    assert "no fresh encoder/pose" in desk.replies[desk.request(MissionRequest(GOAL))].refusal


def test_over_given_waypoints_it_begins_at_once(desk: Desk) -> None:
    on_query = desk.request(MissionRequest(GOAL, (DOOR,), planned=False))
    reply = desk.replies[on_query]
    assert (reply.refusal, reply.waypoints) == ("", (DOOR, GOAL))
    assert reply.length == pytest.approx(3.0)
    assert desk.last(Trajectory) == Trajectory(1, reply.mission, (DOOR, GOAL), Point(0.0, 0.0), 0)
    assert desk.on_query == []


def test_a_planned_mission_begins_with_the_plan(desk: Desk) -> None:
    on_query = desk.request(MissionRequest(GOAL))
    assert desk.on_query[-1].request == PlanRequest(Waypoint(0.0, 0.0, 0.0), GOAL)
    assert desk.on_query[-1].timeout == Parameters().planning_s
    assert desk.replies == {}
    desk.reply(PLAN)
    reply = desk.replies[on_query]
    assert (reply.waypoints, reply.length) == ((DOOR, GOAL), 3.2)
    assert desk.last(Trajectory).waypoints == (DOOR, GOAL)


@pytest.mark.parametrize(
    ("plan", "why"),
    [
        (Plan((), refusal="the goal is inside a wall"), "the goal is inside a wall"),
        (None, "no path planning agent answered"),
    ],
)
def test_a_refusal_is_passed_on_and_nothing_moves(desk: Desk, plan: Plan | None, why: str) -> None:
    on_query = desk.request(MissionRequest(GOAL))
    desk.reply(plan)
    assert why in desk.replies[on_query].refusal
    assert not any(trajectory.waypoints for trajectory in desk.all(Trajectory))
    for _ in range(12):
        desk.moved(0.0)
    assert desk.last(MissionStatus).state is MissionState.NONE


def test_a_refused_mission_leaves_the_one_that_is_driven_as_it_was(driving: Desk) -> None:
    before = driving.last(Trajectory)
    driving.request(MissionRequest(Waypoint(99.0, 0.0, 0.0)))
    driving.reply(Plan((), refusal="off the world"))
    for _ in range(12):
        driving.moved(0.5)
    assert driving.last(MissionStatus).state is MissionState.DRIVING
    assert driving.last(Trajectory).mission == before.mission
    assert driving.last(Trajectory).waypoints == before.waypoints


def test_progress_is_reported_along_the_waypoints(driving: Desk) -> None:
    driving.moved(0.5)
    driving.moved(0.5)
    status = driving.last(MissionStatus)
    assert (status.state, status.leg) == (MissionState.DRIVING, 0)
    assert status.to_go == pytest.approx(2.5)
    driving.moved(1.1)
    driving.moved(1.1)
    assert driving.last(MissionStatus).leg == 1
    assert driving.last(MissionStatus).to_go == pytest.approx(1.9)


@pytest.mark.parametrize(
    ("pose", "speed", "state"),
    [
        ((3.0, 0.0, 0.0), AT_REST, MissionState.REACHED),
        ((2.9, 0.05, 0.06), AT_REST, MissionState.REACHED),
        ((3.0, 0.0, 0.0), ROLLING, MissionState.DRIVING),
        ((3.0, 0.0, 0.0), (0.0, 0.1), MissionState.DRIVING),
        ((2.85, 0.0, 0.0), AT_REST, MissionState.DRIVING),
        ((3.0, 0.0, 0.1), AT_REST, MissionState.DRIVING),
        ((3.0, 0.0, 6.25), AT_REST, MissionState.REACHED),
    ],
)
def test_reached_is_near_turned_and_at_rest(
    driving: Desk, pose: tuple[float, float, float], speed: tuple[float, float], state: MissionState
) -> None:
    driving.moved(1.0)
    driving.moved(*pose, speed=speed)
    driving.moved(*pose, speed=speed)
    assert driving.last(MissionStatus).state is state


def test_the_goal_passed_on_the_way_is_not_yet_reached(desk: Desk) -> None:
    home = Waypoint(0.0, 0.0, 0.0)
    desk.request(MissionRequest(home, (GOAL,), planned=False))
    desk.moved(0.0)
    desk.moved(0.0)
    assert desk.last(MissionStatus).state is MissionState.DRIVING


@pytest.mark.parametrize("off_m", [0.05, 0.3])
def test_a_goal_reached_by_a_pose_beyond_the_tolerance_is_reached_with_a_doubt(
    driving: Desk, off_m: float
) -> None:
    driving.moved(1.0)
    driving.moved(3.0, off_m=off_m)
    status = driving.last(MissionStatus)
    assert status.state is MissionState.REACHED, "it does not stand there for ever"
    assert ("+-0.30 m" in status.note) == (off_m > 0.12)
    assert status.outcome == ("unsure" if off_m > 0.12 else "reached")


def test_a_goal_reached_by_a_pose_of_unknown_error_is_reached_with_a_doubt(driving: Desk) -> None:
    driving.moved(1.0)
    driving.moved(3.0)  # without a covariance
    assert driving.last(MissionStatus).outcome == "unsure"
    assert "unknown error" in driving.last(MissionStatus).note


@pytest.mark.parametrize(("off_m", "outcome"), [(0.0, "driving"), (0.3, "unsure")])
def test_a_robot_that_cannot_know_better_ends_its_mission_beside_the_goal_unsure(
    driving: Desk, off_m: float, outcome: str
) -> None:
    driving.moved(1.0)
    for _ in range(4):
        driving.moved(2.8, off_m=off_m)
    assert driving.last(MissionStatus).outcome == outcome


def test_once_reached_there_is_no_trajectory_any_more(driving: Desk) -> None:
    mission = driving.last(Trajectory).mission
    driving.moved(1.0)
    driving.moved(3.0)
    assert driving.last(Trajectory) == Trajectory(2, mission, (), Point(0.0, 0.0), 1)
    said = len(driving.all(Trajectory))
    for _ in range(30):
        driving.moved(3.0)
    assert all(not t.waypoints for t in driving.all(Trajectory)[said:])
    assert driving.last(MissionStatus).state is MissionState.REACHED


def test_who_gives_the_end_of_the_mission_back_does_not_undo_that_it_was_reached(
    driving: Desk,
) -> None:
    driving.moved(1.0)
    driving.moved(3.0)
    driving.agent.kernel.receive(driving.last(Trajectory), driving.agent.now)
    for _ in range(12):
        driving.moved(3.0)
    assert driving.last(MissionStatus).state is MissionState.REACHED


def test_the_trajectory_is_said_again_each_second_with_the_leg_for_latecomers(
    driving: Desk,
) -> None:
    said = len(driving.all(Trajectory))
    for _ in range(31):
        driving.moved(1.2)
    repeated = driving.all(Trajectory)[said:]
    assert len(repeated) == 3
    assert {(t.waypoints, t.start, t.leg) for t in repeated} == {((DOOR, GOAL), Point(0.0, 0.0), 1)}


def test_with_no_mission_it_says_so_each_second_and_names_no_trajectory(desk: Desk) -> None:
    """An empty trajectory would end a mission of which it has not been told yet."""
    for _ in range(25):
        desk.moved(0.0)
    assert desk.last(MissionStatus).state is MissionState.NONE
    assert len([message for message in desk.published if isinstance(message, MissionStatus)]) == 2
    assert desk.all(Trajectory) == []


# What outlives it ---------------------------------------------------------------------------------


def restarted(driving: Desk) -> Desk:
    """Another interface agent, that is given back what the others remember."""
    other = Desk(begun=False)
    other.agent.kernel.remember(driving.last(Trajectory), 0.1)
    other.agent.kernel.start(0.1)
    other.collect()
    return other


def test_one_that_starts_again_goes_on_with_the_mission(driving: Desk) -> None:
    known = driving.last(Trajectory)
    other = restarted(driving)
    other.moved(1.2)
    other.moved(1.2)
    assert other.last(MissionStatus).state is MissionState.DRIVING
    assert (other.last(MissionStatus).mission, other.last(MissionStatus).leg) == (known.mission, 1)
    assert all(trajectory.waypoints for trajectory in other.all(Trajectory))
    other.moved(3.0)
    assert other.last(MissionStatus).state is MissionState.REACHED
    assert other.last(Trajectory) == Trajectory(
        known.counter + 1, known.mission, (), Point(0.0, 0.0), 1
    )


def test_one_that_starts_again_after_the_goal_begins_nothing(driving: Desk) -> None:
    driving.moved(1.0)
    driving.moved(3.0)
    other = restarted(driving)
    for _ in range(12):
        other.moved(3.0)
    assert other.last(MissionStatus).state is MissionState.NONE
    assert not any(trajectory.waypoints for trajectory in other.all(Trajectory))


def test_a_mission_that_it_is_told_late_goes_on_too(desk: Desk) -> None:
    told = Trajectory(7, 42, (DOOR, GOAL), Point(0.0, 0.0), 0)
    for _ in range(12):
        desk.moved(0.0)
    desk.give(told)
    desk.moved(0.5)
    desk.moved(0.5)
    assert (desk.last(MissionStatus).state, desk.last(MissionStatus).mission) == (
        MissionState.DRIVING,
        42,
    )


@pytest.mark.parametrize(
    ("goal", "over"),
    [
        (Waypoint(800_000.0, 800_000.0, 0.0), ()),
        (Waypoint(Parameters().reach_m + 1.0, 0.0, 0.0), ()),
        (GOAL, (Waypoint(0.0, -Parameters().reach_m - 1.0, 0.0),)),
    ],
)
def test_without_a_plan_no_goal_or_waypoint_is_out_of_reach(
    desk: Desk, goal: Waypoint, over: tuple[Waypoint, ...]
) -> None:
    on_query = desk.request(MissionRequest(goal, over, planned=False))
    assert "at most 200 m are driven without a plan" in desk.replies[on_query].refusal
    assert desk.all(Trajectory) == []


LONG = tuple(Waypoint(0.01 * n, 0.0, 0.0) for n in range(1, WAYPOINTS))


def test_one_more_is_refused_and_not_driven_by_nobody(desk: Desk) -> None:
    """With its goal it has a point more than a trajectory: it was taken on, and never said."""
    on_query = desk.request(MissionRequest(GOAL, (*LONG, GOAL), planned=False))
    assert "it has 1,025 points, at most 1,024" in desk.replies[on_query].refusal
    assert desk.all(Trajectory) == []
    desk.moved(0.0)
    assert all(m.state is MissionState.NONE for m in desk.published if isinstance(m, MissionStatus))


# A robot that is lost -----------------------------------------------------------------------------


def lost(desk: Desk, cycles: int = 3) -> None:
    for _ in range(cycles):
        desk.moved(0.0, off_m=1.0)


def test_a_planned_mission_of_a_lost_robot_waits_and_is_planned_anew_when_it_is_found(
    desk: Desk,
) -> None:
    desk.request(MissionRequest(GOAL))
    desk.reply(PLAN)
    mission = desk.last(Trajectory).mission
    lost(desk)
    assert desk.last(MissionStatus).state is MissionState.DRIVING
    assert "lost" in desk.last(MissionStatus).note
    assert len(desk.on_query) == 1
    for _ in range(3):
        desk.moved(1.5, 0.5)
    assert desk.last(MissionStatus).note == ""
    assert [query.request for query in desk.on_query[1:]] == [
        PlanRequest(Waypoint(1.5, 0.5, 0.0), GOAL, "the robot was lost")
    ]
    desk.reply(Plan((GOAL,), 1.6, 20.0))
    found = desk.last(Trajectory)
    assert (found.mission, found.waypoints, found.start) == (mission, (GOAL,), Point(1.5, 0.5))


def test_a_lost_robot_takes_a_mission_and_it_is_planned_once_it_is_found(desk: Desk) -> None:
    lost(desk)
    on_query = desk.request(MissionRequest(GOAL))
    assert desk.replies[on_query].refusal == ""
    assert desk.on_query == []
    desk.moved(1.0, 2.0)
    assert [query.request for query in desk.on_query] == [
        PlanRequest(Waypoint(1.0, 2.0, 0.0), GOAL, "the robot was lost")
    ]


def test_a_lost_robot_has_not_arrived_wherever_its_pose_is(driving: Desk) -> None:
    driving.moved(1.0)
    for _ in range(3):
        driving.moved(3.0, off_m=1.0)
    assert driving.last(MissionStatus).state is MissionState.DRIVING


def test_given_waypoints_are_not_planned_anew(driving: Desk) -> None:
    lost(driving)
    driving.moved(0.5)
    assert driving.on_query == []


def test_without_a_plan_from_where_it_is_found_it_waits_and_the_status_says_so(
    desk: Desk,
) -> None:
    desk.request(MissionRequest(GOAL))
    desk.reply(PLAN)
    before = desk.last(Trajectory)
    lost(desk)
    desk.moved(1.5, 0.5)
    desk.reply(NO_WAY)
    known = desk.last(Trajectory)
    assert (known.waypoints, known.waits) == (before.waypoints, True)
    stay(desk, 1.0, at=1.5)
    assert desk.last(MissionStatus).note == "waits: door D is shut"


# A way that is blocked ----------------------------------------------------------------------------

SOME = Parameters()
NO_WAY = Plan((), refusal="door D is shut")
ROUND = Plan((Waypoint(1.0, 2.0, 0.0), GOAL), 5.0, 60.0)


@pytest.fixture
def planned(desk: Desk) -> Desk:
    """On the planner's way to the goal."""
    desk.request(MissionRequest(GOAL))
    desk.reply(PLAN)
    return desk


def stay(desk: Desk, seconds: float, at: float = 0.2, *, off_m: float = 0.0) -> None:
    """The robot stands there for so long."""
    for _ in range(round(seconds * 10)):
        desk.moved(at, off_m=off_m)


def blocked(desk: Desk) -> None:
    """It has stood until the way is asked for anew."""
    before = len(desk.on_query)
    stay(desk, SOME.nearer_s + 0.5)
    assert len(desk.on_query) == before + 1


def test_a_robot_that_gets_no_nearer_is_planned_another_way_and_the_planner_is_told_why(
    planned: Desk,
) -> None:
    mission = planned.last(Trajectory)
    blocked(planned)
    assert planned.on_query[-1].request == PlanRequest(
        Waypoint(0.2, 0.0, 0.0), GOAL, "no nearer for 10 s"
    )
    planned.reply(ROUND)
    now = planned.last(Trajectory)
    assert (now.mission, now.waypoints) == (mission.mission, ROUND.waypoints)
    assert now.start == Point(0.2, 0.0)
    assert (now.planned, now.waits) == (True, False)
    assert now.counter == mission.counter + 1


def test_while_it_gets_nearer_however_slowly_it_drives_on(planned: Desk) -> None:
    on_query = len(planned.on_query)
    for step in range(60):
        stay(planned, 0.5, at=0.2 + 0.02 * step)
    assert len(planned.on_query) == on_query


def test_beside_the_goal_there_is_no_other_way(planned: Desk) -> None:
    """It turns there, or somebody stands in its way."""
    planned.moved(1.1)
    on_query = len(planned.on_query)
    stay(planned, 2 * SOME.nearer_s, at=2.8)
    assert len(planned.on_query) == on_query


def test_without_another_way_it_waits_says_so_and_asks_again(planned: Desk) -> None:
    mission = planned.last(Trajectory)
    blocked(planned)
    planned.reply(NO_WAY)
    waiting = planned.last(Trajectory)
    assert (waiting.mission, waiting.waypoints) == (mission.mission, mission.waypoints)
    assert waiting.waits
    stay(planned, 1.0)
    status = planned.last(MissionStatus)
    assert (status.state, status.note) == (MissionState.DRIVING, "waits: door D is shut")
    on_query = len(planned.on_query)
    stay(planned, SOME.again_s + 0.2)
    assert len(planned.on_query) == on_query + 1
    planned.reply(PLAN)
    assert not planned.last(Trajectory).waits
    stay(planned, 1.0)
    assert planned.last(MissionStatus).note == ""


def test_without_a_planner_the_present_path_is_kept(planned: Desk) -> None:
    """The path may still be free: behaviours avoid obstacles."""
    before = planned.last(Trajectory)
    see(planned, Point(1.0, 0.1))
    planned.reply(None)
    known = planned.last(Trajectory)
    assert (known.waypoints, known.waits, known.counter) == (before.waypoints, False, 1)
    stay(planned, SOME.again_s + SOME.nearer_s)
    planned.reply(None)
    warnings = [m for m in planned.published if isinstance(m, Log) and m.level >= WARNING]
    assert len(warnings) == 1
    planned.moved(1.0)
    assert planned.last(MissionStatus).note == ""


def test_a_step_of_its_clock_fails_no_mission(planned: Desk) -> None:
    stay(planned, 2.0)
    planned.now += 3600.0  # or it was hung for so long
    stay(planned, 2.0)
    assert planned.last(MissionStatus).state is MissionState.DRIVING
    assert planned.on_query == planned.on_query[:1], "nothing is in the way"
    stay(planned, SOME.nearer_s)
    assert len(planned.on_query) == 2, "what counts goes on counting"


def test_without_a_planner_too_a_mission_fails_that_comes_no_nearer(planned: Desk) -> None:
    blocked(planned)
    planned.reply(None)
    for _ in range(round(SOME.give_up_s) + 5):
        stay(planned, 1.0)
        if planned.waits:
            planned.reply(None)
    assert planned.last(MissionStatus).state is MissionState.FAILED


def test_one_that_waits_goes_on_waiting_while_nobody_plans(planned: Desk) -> None:
    blocked(planned)
    planned.reply(NO_WAY)
    stay(planned, SOME.again_s + 0.2)
    planned.reply(None)
    assert planned.last(Trajectory).waits


def test_where_no_way_becomes_free_the_mission_fails_with_the_reason(planned: Desk) -> None:
    mission = planned.last(Trajectory).mission
    blocked(planned)
    planned.reply(NO_WAY)
    for _ in range(round(SOME.give_up_s)):
        stay(planned, 1.0)
        if planned.waits:
            planned.reply(NO_WAY)
    assert planned.last(MissionStatus).state is MissionState.FAILED
    assert planned.last(MissionStatus).mission == mission
    assert "door D is shut" in planned.last(MissionStatus).note
    ended = planned.last(Trajectory)
    assert (ended.mission, ended.waypoints, ended.waits) == (mission, (), False)
    on_query = len(planned.on_query)
    planned.give(ended)  # a peer gives back what it remembers
    stay(planned, 20.0)
    assert planned.last(MissionStatus).state is MissionState.FAILED
    assert len(planned.on_query) == on_query
    planned.request(MissionRequest(DOOR))
    planned.reply(PLAN)
    assert planned.last(Trajectory).waypoints == PLAN.waypoints


def test_ways_that_lead_no_nearer_are_not_tried_for_ever(planned: Desk) -> None:
    """Two doors that are shut, each seen only from before it."""
    patience = SOME.give_up_s + ROUND.length / SOME.give_up_m_s
    for _ in range(round(patience) + 20):
        stay(planned, 1.0)
        if planned.waits:
            planned.reply(ROUND)
    assert planned.last(MissionStatus).state is MissionState.FAILED
    assert "no nearer" in planned.last(MissionStatus).note
    assert "no agent drives (" in planned.last(MissionStatus).note, "what was seen"


def touch(desk: Desk, x: float, *, after_s: float = 5.0, epoch: int = 1) -> None:
    """The robot touches something ahead there, by its odometry, and backs off."""
    stay(desk, after_s)
    desk.epoch, desk.odometry = epoch, (x, 0.0, 0.0)
    for desk.touch in (Point(0.2, 0.0), Point(0.2, 0.0), None):
        desk.state()


def test_at_the_third_contact_at_one_place_the_mission_fails_and_says_where(
    planned: Desk,
) -> None:
    mission = planned.last(Trajectory).mission
    for x in (1.0, 1.1):
        touch(planned, x)
        assert planned.last(MissionStatus).state is MissionState.DRIVING
    touch(planned, 0.9)
    status, ended = planned.last(MissionStatus), planned.last(Trajectory)
    assert (status.state, status.mission) == (MissionState.FAILED, mission)
    assert "ahead at (0.20, 0.00)" in status.note
    assert (ended.mission, ended.waypoints) == (mission, ())


def test_a_robot_that_cannot_be_driven_fails_its_mission_and_starts_none(planned: Desk) -> None:
    stay(planned, 1.0)
    planned.number += 1
    planned.give(RobotState(planned.at, 0, 0, 0, 0, 0, 12, True, False, fault="deaf base"))
    status, ended = planned.last(MissionStatus), planned.last(Trajectory)
    assert (status.state, status.note) == (MissionState.FAILED, "deaf base")
    assert ended.waypoints == ()
    assert planned.replies[planned.request(MissionRequest(GOAL))].refusal == "deaf base"


def test_contacts_far_apart_long_ago_or_in_another_mission_do_not_count(planned: Desk) -> None:
    for x in (1.0, 2.0, 1.0, 2.0):
        touch(planned, x)
    touch(planned, 1.0, after_s=SOME.contacts_s)
    planned.request(MissionRequest(GOAL))
    planned.reply(PLAN)
    touch(planned, 1.0)
    touch(planned, 1.0)
    assert planned.last(MissionStatus).state is MissionState.DRIVING


@pytest.mark.parametrize("hindrance", ["lost", "stopped", "given"])
def test_a_robot_that_may_not_get_nearer_is_not_blocked(desk: Desk, hindrance: str) -> None:
    given = hindrance == "given"
    desk.request(MissionRequest(GOAL, (DOOR,), planned=not given))
    if not given:
        desk.reply(PLAN)
    if hindrance == "stopped":
        desk.give(Stop(1, True, "somebody", 1))
    on_query, off_m = len(desk.on_query), 1.0 if hindrance == "lost" else 0.0
    stay(desk, SOME.stays_s - 5.0, off_m=off_m)
    assert desk.last(MissionStatus).state is MissionState.DRIVING
    stay(desk, SOME.lost_s, off_m=off_m)
    assert len(desk.on_query) == on_query
    status = desk.last(MissionStatus)
    stopped = hindrance == "stopped"
    assert status.state is (MissionState.DRIVING if stopped else MissionState.FAILED)
    assert {"lost": "lost for", "stopped": "", "given": "nobody plans"}[hindrance] in status.note


def see(desk: Desk, *points: Point, seconds: float = 2.0) -> None:
    """The robot drives on and there is something, in its body's frame."""
    for _ in range(round(10 * seconds)):
        desk.moved(0.1 + 0.01 * desk.number)
        seen = Obstacles(Cycle(1, desk.number), None, None, None, None, points)
        desk.give(seen)
        desk.wake()


def test_something_across_the_way_is_planned_round_before_the_robot_stands(planned: Desk) -> None:
    see(planned, Point(1.0, 0.1))
    request = planned.on_query[-1].request
    assert isinstance(request, PlanRequest)
    assert request.why == "something stands across the way"
    planned.reply(ROUND)
    assert planned.last(Trajectory).waypoints == ROUND.waypoints


@pytest.mark.parametrize("point", [Point(1.0, 0.3), Point(2.0, 0.0), Point(-0.3, 0.0)])
def test_what_is_beside_the_way_far_ahead_or_behind_is_not_across_it(
    planned: Desk, point: Point
) -> None:
    on_query = len(planned.on_query)
    see(planned, point)
    assert len(planned.on_query) == on_query


@pytest.mark.parametrize(("aside", "across"), [(0.2, True), (0.23, False)])
def test_for_who_drives_fast_what_is_beside_the_body_s_way_is_across_it(
    aside: float, across: bool
) -> None:
    """As wide as the robot is, whichever it is, and the next look decides."""
    desk = Desk(parameters=Parameters(flank_m=0.05, across_s=0.0))
    desk.agent.kernel.receive(described(), 0.0)
    desk.moved(0.0)
    desk.request(MissionRequest(GOAL))
    desk.reply(PLAN)
    on_query = len(desk.on_query)
    see(desk, Point(0.9, aside), seconds=0.4)
    assert (len(desk.on_query) > on_query) is across


def test_a_plan_that_leads_the_same_way_changes_nothing(planned: Desk) -> None:
    """What was seen is a wall of the map after all, or gone."""
    before = planned.last(Trajectory)
    see(planned, Point(1.0, 0.1))
    planned.reply(Plan((Waypoint(1.1, 0.02, 0.0), GOAL), 2.9, 38.0))
    assert planned.last(Trajectory).counter == before.counter


def test_one_that_starts_again_goes_on_waiting_and_asks_for_a_way(planned: Desk) -> None:
    blocked(planned)
    planned.reply(NO_WAY)
    other = restarted(planned)
    stay(other, SOME.again_s + 0.5)
    assert other.last(MissionStatus).state is MissionState.DRIVING
    assert [query.request for query in other.on_query[:1]] == [
        PlanRequest(Waypoint(0.2, 0.0, 0.0), GOAL, "no way was free")
    ]
    other.reply(ROUND)
    assert not other.last(Trajectory).waits


@pytest.mark.parametrize(("replaces", "taken"), [(None, True), (0, False)])
@pytest.mark.parametrize("planned", [False, True])
def test_a_request_may_say_that_it_takes_nobody_elses_place(
    replaces: int | None, taken: bool, planned: bool
) -> None:
    desk = Desk()
    desk.moved(0.0)
    desk.request(MissionRequest(GOAL, planned=False))
    mission = desk.replies[1].mission
    number = desk.request(MissionRequest(DOOR, planned=planned, replaces=replaces))
    if planned and taken:
        desk.reply(PLAN)
    assert (desk.replies[number].refusal == "") == taken
    assert len({trajectory.mission for trajectory in desk.all(Trajectory)}) == 1 + taken
    if not taken:
        assert "under way on another mission" in desk.replies[number].refusal
        again = desk.request(MissionRequest(DOOR, planned=False, replaces=mission))
        assert not desk.replies[again].refusal


def test_nor_does_it_once_somebody_else_was_faster_than_its_plan() -> None:
    desk = Desk()
    desk.moved(0.0)
    number = desk.request(MissionRequest(GOAL, replaces=0))
    desk.request(MissionRequest(DOOR, planned=False))
    desk.reply(PLAN)
    assert "under way on another mission" in desk.replies[number].refusal
    assert len(desk.all(Trajectory)) == 1


def test_a_mission_that_says_where_the_robot_stands_waits_for_the_pose_to_be_there() -> None:
    desk, here = Desk(), Waypoint(1.0, 1.0, 0.0)
    desk.moved(5.0, 5.0)
    on_query = desk.request(MissionRequest(GOAL, planned=False, start=here))
    assert InitialPose(1.0, 1.0, 0.0) in desk.published
    desk.moved(5.0, 5.0)
    assert not desk.replies
    desk.moved(1.0, 1.0)
    assert desk.replies[on_query].refusal == ""
    assert desk.last(Trajectory).start == Point(1.0, 1.0)


def test_without_an_encoder_agent_that_takes_it_on_such_a_mission_is_refused() -> None:
    desk = Desk()
    desk.moved(5.0, 5.0)
    on_query = desk.request(MissionRequest(GOAL, planned=False, start=Waypoint(1.0, 1.0, 0.0)))
    for _ in range(25):
        desk.moved(5.0, 5.0)
    assert "no encoder agent" in desk.replies[on_query].refusal


def test_a_robot_that_moves_is_not_told_where_it_stands() -> None:
    desk = Desk()
    desk.moved(5.0, 5.0, speed=ROLLING)
    on_query = desk.request(MissionRequest(GOAL, planned=False, start=Waypoint(1.0, 1.0, 0.0)))
    assert "it moves" in desk.replies[on_query].refusal
    assert not [said for said in desk.published if isinstance(said, InitialPose)]


def test_a_place_that_is_not_taken_on_in_time_starts_no_robot_later() -> None:
    desk = Desk()
    desk.moved(5.0, 5.0)
    on_query = desk.request(MissionRequest(GOAL, planned=False, start=Waypoint(1.0, 1.0, 0.0)))
    desk.now += 600.0
    desk.wake()
    desk.moved(1.0, 1.0, speed=ROLLING)
    assert "no encoder agent" in desk.replies[on_query].refusal
    assert not desk.all(Trajectory)


def test_while_a_way_is_planned_the_robot_is_placed_nowhere_else() -> None:
    desk = Desk()
    desk.moved(5.0, 5.0)
    desk.request(MissionRequest(GOAL))
    again = desk.request(MissionRequest(DOOR, planned=False, start=Waypoint(1.0, 1.0, 0.0)))
    assert "under way" in desk.replies[again].refusal
    assert not [said for said in desk.published if isinstance(said, InitialPose)]


# A map that is made meanwhile ---------------------------------------------------------------------

SHIFT = MapMoved(2, (Moved(2.0, 0.0, 2.0, 1.0, 0.0),))


def on_map(desk: Desk, x: float, revision: int, y: float = 0.0) -> None:
    desk.state()
    desk.give(Pose(desk.at, x, y, 0.0, revision=revision))
    desk.wake()


def test_goal_and_path_move_with_the_map_and_a_path_is_planned_on_it() -> None:
    desk = Desk()
    on_map(desk, 0.0, 1)
    desk.request(MissionRequest(GOAL))
    desk.reply(replace(PLAN, revision=1))
    desk.give(SHIFT)
    trajectory = desk.last(Trajectory)
    assert trajectory.revision == 2
    assert trajectory.waypoints == (Waypoint(1.0, 1.0, 0.0), Waypoint(3.0, 1.0, 0.0))
    on_map(desk, 0.1, 1)  # of the cycle before
    assert not desk.waits
    on_map(desk, 0.1, 2, 1.0)
    request = desk.on_query[-1].request
    assert isinstance(request, PlanRequest)
    assert (request.start, request.goal) == (Waypoint(0.1, 1.0, 0.0), trajectory.waypoints[-1])
    desk.reply(replace(PLAN, revision=1))
    assert desk.last(Trajectory) == trajectory, "a plan on the old map is not driven"
    on_map(desk, 0.2, 2, 1.0)
    way = (Waypoint(2.0, 1.2, 0.0), Waypoint(3.0, 1.0, 0.0))
    desk.reply(Plan(way, 3.0, revision=2))
    assert desk.last(Trajectory).waypoints == way


@pytest.mark.parametrize("first", ["map", "request"])
def test_a_goal_of_the_old_map_moves_whichever_comes_first(first: str) -> None:
    desk = Desk()
    on_map(desk, 0.0, 1)
    request = MissionRequest(GOAL, planned=False, revision=1)
    desk.give(*([SHIFT] if first == "map" else []))
    desk.request(request)
    desk.give(*([] if first == "map" else [SHIFT]))
    assert desk.last(Trajectory).waypoints == (Waypoint(3.0, 1.0, 0.0),)
    assert desk.last(Trajectory).revision == 2


def test_a_goal_of_the_new_map_stays_if_the_message_of_its_move_comes_later() -> None:
    desk = Desk()
    on_map(desk, 0.0, 1)
    desk.request(MissionRequest(GOAL, planned=False, revision=2))
    desk.give(SHIFT)
    assert desk.last(Trajectory).waypoints == (GOAL,)


# What nobody has seen ----------------------------------------------------------------------------

THROUGH = (Stretch(1.0, 0.0, 2.0, 0.0),)


def test_the_parts_that_nobody_has_seen_are_said_and_driven_with_care(desk: Desk) -> None:
    on_query = desk.request(MissionRequest(GOAL))
    desk.reply(replace(PLAN, unseen=THROUGH))
    assert desk.replies[on_query].unseen == THROUGH
    assert desk.last(Trajectory).unseen == THROUGH
    desk.moved(1.2)
    desk.moved(3.0)
    assert desk.last(MissionStatus).state is MissionState.REACHED
    assert desk.last(Trajectory).unseen == ()


def test_a_missions_rule_holds_for_plans_under_way_and_after_a_restart(desk: Desk) -> None:
    desk.request(MissionRequest(GOAL, rule="refuse"))
    assert desk.on_query[-1].request == PlanRequest(Waypoint(0.0, 0.0, 0.0), GOAL, rule="refuse")
    desk.reply(PLAN)
    for each in (desk, restarted(desk)):
        each.moved(0.5)
        lost(each)
        each.moved(0.5)
        request = each.on_query[-1].request
        assert isinstance(request, PlanRequest)
        assert (request.rule, request.why) == ("refuse", "the robot was lost")


# Late ---------------------------------------------------------------------------------------------


def drive(
    desk: Desk,
    seconds: float,
    v: float,
    *,
    by: str = "goto-1",
    capped: str = "",
    ordered: float = 1.0,
) -> None:
    """Drive on at `v` m/s; the obeyed command is of `by`, and `ordered` if it is capped."""
    wanted = Twist(ordered if capped else v, 0.0)
    for _ in range(round(10 * seconds)):
        desk.x += 0.1 * v
        desk.number += 1
        desk.now += PERIOD
        state = RobotState(
            *(desk.at, desk.x, 0.0, 0.0, v, 0.0, 12.5, True, False),
            driver=by,
            ordered=wanted,
            admitted=Twist(v, 0.0),
            capped=capped,
        )
        desk.give(state, Pose(desk.at, desk.x, 0.0, 0.0, covariance(0.0)))


def test_a_mission_in_good_time_is_not_late(driving: Desk) -> None:
    drive(driving, 9.0, 0.3)
    status = driving.last(MissionStatus)
    assert status.late == ""
    assert status.due_s is not None
    assert 0.0 < status.due_s < 60.0


@pytest.mark.parametrize(
    ("by", "capped", "blamed"),
    [
        ("goto-1", "", "goto drives too slowly"),
        ("", "", "no agent drives"),
        ("goto-1", "something is sensed ahead", "slows goto down: something is sensed ahead"),
    ],
)
def test_a_late_mission_says_so_under_way_with_who_delays_it(
    driving: Desk, by: str, capped: str, blamed: str
) -> None:
    drive(driving, 90.0, 0.01, by=by, capped=capped)
    status = driving.last(MissionStatus)
    assert status.state is MissionState.DRIVING
    assert status.due_s is not None
    assert status.due_s < 0.0
    assert "late" in status.late
    assert blamed in status.late
    assert sum(log.event == LogEvent.LATE for log in driving.all(Log)) == 1


@pytest.mark.parametrize(("capped", "late"), [("something is sensed ahead", False), ("", True)])
def test_a_cap_postpones_the_due_time_by_what_it_took(
    driving: Desk, capped: str, late: bool
) -> None:
    drive(driving, 50.0, 0.05, capped=capped)
    assert bool(driving.last(MissionStatus).late) == late


@pytest.mark.parametrize(
    ("ordered", "v", "late"),
    [
        pytest.param(0.08, 0.06, True, id="slow by itself"),
        pytest.param(0.14, 0.06, False, id="slow because it heeds the cap"),
        pytest.param(1.0, 0.06, False, id="fast"),
    ],
)
def test_a_cap_spares_nothing_of_what_the_agent_itself_is_too_slow(
    driving: Desk, ordered: float, v: float, late: bool
) -> None:
    drive(driving, 50.0, v, capped="something is sensed ahead", ordered=ordered)
    assert bool(driving.last(MissionStatus).late) == late


def test_the_one_who_ordered_a_mission_is_named_also_by_the_next_interface_agent(
    desk: Desk,
) -> None:
    desk.request(MissionRequest(GOAL, (DOOR,), planned=False, by="anna"))
    drive(desk, 60.0, 0.01)
    status = desk.last(MissionStatus)
    assert (status.owner, status.delay[:24]) == ("anna", "The mission of anna is 2")
    after = Desk()
    after.give(desk.last(Trajectory))
    after.moved(0.0)
    after.moved(0.0)
    assert after.last(MissionStatus).owner == "anna"


def test_a_stop_by_a_person_postpones_the_due_time_and_is_stated(driving: Desk) -> None:
    for _ in range(600):
        driving.state(Stop(1, True, "operator"))
        driving.give(Pose(driving.at, 0.0, 0.0, 0.0, covariance(0.0)))
    assert driving.last(MissionStatus).late == ""
    driving.state(Stop(2, False, "operator"))
    drive(driving, 60.0, 0.01)
    late = driving.last(MissionStatus).late
    assert "goto drives too slowly" in late
    assert "not counted: 6" in late


def test_a_mission_without_poses_goes_on_to_report_and_says_why_it_is_late(driving: Desk) -> None:
    driving.all(MissionStatus).clear()
    for _ in range(600):
        driving.state()
        driving.wake()
    status = driving.last(MissionStatus)
    assert status.state is MissionState.DRIVING
    assert "no pose is published" in status.late


def test_a_cancelled_goal_ends_where_the_robot_is_without_a_stop(driving: Desk) -> None:
    driving.moved(0.5)
    driving.moved(0.5)
    mission = driving.last(MissionStatus).mission
    driving.query(MissionCancel(mission + 1, "ann"), 40)
    driving.moved(0.6)
    driving.moved(0.6)
    assert driving.last(MissionStatus).state is MissionState.DRIVING, "another one's number"
    assert driving.query(MissionCancel(mission, "ann"), 41) == MissionReply(mission)
    status = driving.last(MissionStatus)
    assert (status.state, status.note) == (MissionState.FAILED, "cancelled by ann")
    assert driving.last(Trajectory).waypoints == ()
    late = driving.query(MissionCancel(mission, "ann"), 42)
    assert isinstance(late, MissionReply)
    assert "ended already: failed" in late.refusal
    again = driving.request(MissionRequest(GOAL, (DOOR,), planned=False))
    assert driving.replies[again].refusal == "", "nothing is latched"
