"""The interface agent: missions taken on or refused before anything moves; reached is at rest."""

from __future__ import annotations

import pytest

from armadico.agents.interface import Interface, Parameters
from armadico.core.agent import Answer, AskFor, Identity, Publish, Question
from armadico.core.messages import (
    LARGEST_COUNT,
    WAYPOINTS,
    Cycle,
    MissionReply,
    MissionRequest,
    MissionState,
    MissionStatus,
    Plan,
    PlanRequest,
    Point,
    Pose,
    RobotState,
    Trajectory,
    Waypoint,
    decode,
    encode,
)
from armadico.core.services import service_of

GOAL = Waypoint(3.0, 0.0, 0.0)
DOOR = Waypoint(1.0, 0.0, 0.0)
PLAN = Plan((DOOR, GOAL), 3.2, 40.0)
AT_REST, ROLLING = (0.0, 0.0), (0.1, 0.0)


class Desk:
    """An interface agent, and whoever asks it for something."""

    def __init__(self, *, begun: bool = True) -> None:
        self.agent = Interface(Identity("interface-1"))
        if begun:
            self.agent.start(0.0)
        self.number = 0
        self.questions = 0
        self.said: list[object] = []
        self.asked: list[AskFor] = []
        self.replies: dict[int, MissionReply] = {}

    @property
    def now(self) -> float:
        return self.agent.now

    def take(self) -> None:
        for item in self.agent.outbox:
            if isinstance(item, Publish):
                self.said.append(item.message)
            elif isinstance(item, AskFor):
                self.asked.append(item)
            elif isinstance(item, Answer):
                assert isinstance(item.message, MissionReply)
                self.replies[item.id] = item.message
        self.agent.outbox.clear()

    def at(
        self, x: float, y: float = 0.0, theta: float = 0.0, speed: tuple[float, float] = AT_REST
    ) -> None:
        """A cycle later the robot is there."""
        self.number += 1
        now, cycle = self.now + 0.1, Cycle(1, self.number)
        self.agent.receive(RobotState(cycle, 0, 0, 0, *speed, 12, True, False), now)
        self.agent.receive(Pose(cycle, x, y, theta), now)
        self.wake()

    def wake(self) -> None:
        due = self.agent.wakeup
        if due is not None and self.now >= due:
            self.agent.wake(self.now)
        self.take()

    def request(self, request: MissionRequest) -> int:
        self.questions += 1
        self.agent.asked(Question(self.questions, request), self.now)
        self.take()
        return self.questions

    def planned(self, plan: Plan | None) -> None:
        self.agent.replied(self.asked[-1].id, plan, self.now)
        self.take()

    def trajectories(self) -> list[Trajectory]:
        return [message for message in self.said if isinstance(message, Trajectory)]

    def status(self) -> MissionStatus:
        found = [message for message in self.said if isinstance(message, MissionStatus)]
        return found[-1]


@pytest.fixture
def desk() -> Desk:
    """The robot stands at the origin."""
    desk = Desk()
    desk.at(0.0)
    return desk


@pytest.fixture
def driving(desk: Desk) -> Desk:
    """On its way over the door to the goal."""
    desk.request(MissionRequest(GOAL, (DOOR,), planned=False))
    return desk


def test_a_mission_is_refused_when_nobody_knows_where_the_robot_is() -> None:
    desk = Desk()
    asked = desk.request(MissionRequest(GOAL))
    assert "no fresh encoder/pose" in desk.replies[asked].refusal
    assert desk.asked == []


def test_an_old_pose_will_not_do(desk: Desk) -> None:
    for number in range(2, 7):
        cycle = Cycle(1, number)
        desk.agent.receive(RobotState(cycle, 0, 0, 0, 0, 0, 12, True, False), number / 10)
    assert "no fresh encoder/pose" in desk.replies[desk.request(MissionRequest(GOAL))].refusal


def test_over_given_waypoints_it_begins_at_once(desk: Desk) -> None:
    asked = desk.request(MissionRequest(GOAL, (DOOR,), planned=False))
    reply = desk.replies[asked]
    assert (reply.refusal, reply.waypoints) == ("", (DOOR, GOAL))
    assert reply.length == pytest.approx(3.0)
    assert desk.trajectories()[-1] == Trajectory(1, reply.mission, (DOOR, GOAL), Point(0.0, 0.0), 0)
    assert desk.asked == []


def test_a_planned_mission_begins_with_the_plan(desk: Desk) -> None:
    asked = desk.request(MissionRequest(GOAL))
    assert desk.asked[-1].request == PlanRequest(Waypoint(0.0, 0.0, 0.0), GOAL)
    assert desk.asked[-1].timeout == Parameters().planning_s
    assert desk.replies == {}
    desk.planned(PLAN)
    reply = desk.replies[asked]
    assert (reply.waypoints, reply.length) == ((DOOR, GOAL), 3.2)
    assert desk.trajectories()[-1].waypoints == (DOOR, GOAL)


@pytest.mark.parametrize(
    ("plan", "why"),
    [
        (Plan((), refusal="the goal is inside a wall"), "the goal is inside a wall"),
        (None, "nobody plans"),
    ],
)
def test_a_refusal_is_passed_on_and_nothing_moves(desk: Desk, plan: Plan | None, why: str) -> None:
    asked = desk.request(MissionRequest(GOAL))
    desk.planned(plan)
    assert why in desk.replies[asked].refusal
    assert not any(trajectory.waypoints for trajectory in desk.trajectories())
    for _ in range(12):
        desk.at(0.0)
    assert desk.status().state is MissionState.NONE


def test_a_refused_mission_leaves_the_one_that_is_driven_as_it_was(driving: Desk) -> None:
    before = driving.trajectories()[-1]
    driving.request(MissionRequest(Waypoint(99.0, 0.0, 0.0)))
    driving.planned(Plan((), refusal="off the world"))
    for _ in range(12):
        driving.at(0.5)
    assert driving.status().state is MissionState.DRIVING
    assert driving.trajectories()[-1].mission == before.mission
    assert driving.trajectories()[-1].waypoints == before.waypoints


def test_another_mission_takes_the_place_of_the_one_before(driving: Desk) -> None:
    first = driving.trajectories()[-1]
    driving.request(MissionRequest(DOOR, planned=False))
    second = driving.trajectories()[-1]
    assert second.mission != first.mission
    assert second.waypoints == (DOOR,)


def test_progress_is_reported_along_the_waypoints(driving: Desk) -> None:
    driving.at(0.5)
    driving.at(0.5)
    status = driving.status()
    assert (status.state, status.leg) == (MissionState.DRIVING, 0)
    assert status.to_go == pytest.approx(2.5)
    driving.at(1.1)
    driving.at(1.1)
    assert driving.status().leg == 1
    assert driving.status().to_go == pytest.approx(1.9)


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
    driving.at(1.0)
    driving.at(*pose, speed=speed)
    driving.at(*pose, speed=speed)
    assert driving.status().state is state


def test_the_goal_passed_on_the_way_is_not_yet_reached(desk: Desk) -> None:
    home = Waypoint(0.0, 0.0, 0.0)
    desk.request(MissionRequest(home, (GOAL,), planned=False))
    desk.at(0.0)
    desk.at(0.0)
    assert desk.status().state is MissionState.DRIVING


def test_once_reached_there_is_no_trajectory_any_more(driving: Desk) -> None:
    mission = driving.trajectories()[-1].mission
    driving.at(1.0)
    driving.at(3.0)
    assert driving.trajectories()[-1] == Trajectory(2, mission, (), Point(0.0, 0.0), 1)
    said = len(driving.trajectories())
    for _ in range(30):
        driving.at(3.0)
    assert all(not t.waypoints for t in driving.trajectories()[said:])
    assert driving.status().state is MissionState.REACHED


def test_who_gives_the_end_of_the_mission_back_does_not_undo_that_it_was_reached(
    driving: Desk,
) -> None:
    driving.at(1.0)
    driving.at(3.0)
    driving.agent.receive(driving.trajectories()[-1], driving.agent.now)
    for _ in range(12):
        driving.at(3.0)
    assert driving.status().state is MissionState.REACHED


def test_the_trajectory_is_said_again_each_second_with_the_leg_for_latecomers(
    driving: Desk,
) -> None:
    said = len(driving.trajectories())
    for _ in range(31):
        driving.at(1.2)
    repeated = driving.trajectories()[said:]
    assert len(repeated) == 3
    assert {(t.waypoints, t.start, t.leg) for t in repeated} == {((DOOR, GOAL), Point(0.0, 0.0), 1)}


def test_cut_off_while_waypoints_were_passed_it_still_knows_when_the_goal_is_reached(
    desk: Desk,
) -> None:
    over = (Waypoint(2.0, 0.0, 0.0), Waypoint(2.0, 2.0, 0.0), Waypoint(6.0, 2.0, 0.0))
    desk.request(MissionRequest(Waypoint(8.0, 2.0, 0.0), over, planned=False))
    desk.at(1.0)
    desk.at(4.0, 2.0)
    desk.at(4.1, 2.0)
    assert desk.status().leg == 2


def test_with_no_mission_it_says_so_each_second_and_names_no_trajectory(desk: Desk) -> None:
    """An empty trajectory would end a mission of which it has not been told yet."""
    for _ in range(25):
        desk.at(0.0)
    assert desk.status().state is MissionState.NONE
    assert len([message for message in desk.said if isinstance(message, MissionStatus)]) == 2
    assert desk.trajectories() == []


def test_each_mission_and_each_end_has_a_larger_counter(desk: Desk) -> None:
    for goal in (GOAL, DOOR):
        desk.request(MissionRequest(goal, planned=False))
        desk.at(goal.x)
        desk.at(goal.x)
    assert [trajectory.counter for trajectory in desk.trajectories()] == [1, 2, 3, 4]
    assert [bool(trajectory.waypoints) for trajectory in desk.trajectories()] == [1, 0, 1, 0]


# What outlives it ---------------------------------------------------------------------------------


def restarted(driving: Desk) -> Desk:
    """Another interface agent, that is given back what the others remember."""
    other = Desk(begun=False)
    other.agent.remember(driving.trajectories()[-1], 0.1)
    other.agent.start(0.1)
    other.take()
    return other


def test_one_that_starts_again_goes_on_with_the_mission(driving: Desk) -> None:
    known = driving.trajectories()[-1]
    other = restarted(driving)
    other.at(1.2)
    other.at(1.2)
    assert other.status().state is MissionState.DRIVING
    assert (other.status().mission, other.status().leg) == (known.mission, 1)
    assert all(trajectory.waypoints for trajectory in other.trajectories())
    other.at(3.0)
    assert other.status().state is MissionState.REACHED
    assert other.trajectories()[-1] == Trajectory(
        known.counter + 1, known.mission, (), Point(0.0, 0.0), 1
    )


def test_one_that_starts_again_after_the_goal_begins_nothing(driving: Desk) -> None:
    driving.at(1.0)
    driving.at(3.0)
    other = restarted(driving)
    for _ in range(12):
        other.at(3.0)
    assert other.status().state is MissionState.NONE
    assert not any(trajectory.waypoints for trajectory in other.trajectories())


def test_a_mission_that_it_is_told_late_goes_on_too(desk: Desk) -> None:
    told = Trajectory(7, 42, (DOOR, GOAL), Point(0.0, 0.0), 0)
    for _ in range(12):
        desk.at(0.0)
    desk.agent.receive(told, desk.now)
    desk.at(0.5)
    desk.at(0.5)
    assert (desk.status().state, desk.status().mission) == (MissionState.DRIVING, 42)


def test_only_one_may_be_there() -> None:
    assert Interface.alone


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
    asked = desk.request(MissionRequest(goal, over, planned=False))
    assert "at most 200 m are driven without a plan" in desk.replies[asked].refusal
    assert desk.trajectories() == []


def test_each_waypoint_may_be_within_reach_of_the_one_before(desk: Desk) -> None:
    far = tuple(Waypoint(150.0 * n, 0.0, 0.0) for n in (1, 2, 3))
    asked = desk.request(MissionRequest(far[-1], far[:-1], planned=False))
    assert desk.replies[asked].refusal == ""


LONG = tuple(Waypoint(0.01 * n, 0.0, 0.0) for n in range(1, WAYPOINTS))


def test_as_many_points_as_can_be_said_are_driven(desk: Desk) -> None:
    asked = desk.request(MissionRequest(GOAL, LONG, planned=False))
    assert desk.replies[asked].refusal == ""
    assert decode(encode(desk.trajectories()[-1]), Trajectory).waypoints == (*LONG, GOAL)


def test_one_more_is_refused_and_not_driven_by_nobody(desk: Desk) -> None:
    """With its goal it has a point more than a trajectory: it was taken on, and never said."""
    asked = desk.request(MissionRequest(GOAL, (*LONG, GOAL), planned=False))
    assert "it has 1,025 points, at most 1,024" in desk.replies[asked].refusal
    assert desk.trajectories() == []
    desk.at(0.0)
    assert all(m.state is MissionState.NONE for m in desk.said if isinstance(m, MissionStatus))


@pytest.mark.parametrize(
    ("plan", "why"),
    [
        (Plan((*LONG, GOAL, GOAL), 20.0), "it has 1,025 points"),
        (Plan((), 0.0), "the plan leads nowhere"),
        (Plan((Waypoint(1e6, 0.0, 0.0), Waypoint(-1e6, 0.0, 0.0))), "nobody could be told of it"),
    ],
    ids=["long", "empty", "far"],
)
def test_a_plan_that_nobody_could_be_told_of_is_refused(
    driving: Desk, plan: Plan, why: str
) -> None:
    before = driving.trajectories()
    asked = driving.request(MissionRequest(GOAL))
    driving.planned(plan)
    assert why in driving.replies[asked].refusal
    assert driving.trajectories() == before, "the mission before goes on"
    driving.at(0.2)
    driving.at(0.3)
    assert driving.status().state is MissionState.DRIVING


def test_after_the_largest_counter_there_is_one_more_for_a_mission(desk: Desk) -> None:
    desk.agent.memory.note(Trajectory(LARGEST_COUNT, 1, ()))
    asked = desk.request(MissionRequest(GOAL, planned=False))
    assert not desk.replies[asked].refusal
    assert desk.trajectories()[-1].counter == 0


def test_it_says_how_far_it_is_as_often_as_the_table_promises_with_nothing_to_do_too() -> None:
    """Else whoever watches an idle society is told of silences that are none."""
    promised = service_of(MissionStatus).rate_hz
    assert promised is not None
    assert promised * Interface.parameters().repeat_s <= 1.0
