"""A mission for a client is watched to its end: it is cancelled before it leaves the policy."""

from __future__ import annotations

from math import pi
from pathlib import Path

import pytest

from armadico.agents.interface.messages import MissionCancel
from armadico.core.messages import Cycle, Description, Point, RobotState
from armadico.mobile.messages import (
    MissionReply,
    MissionRequest,
    Plan,
    PlanRequest,
    Pose,
    Terms,
    Trajectory,
    Waypoint,
)
from armadico.mobile.obstacles import Obstacles
from armadico.watch.assistant.assistant import BUSY, TAKEN_BACK
from armadico.watch.assistant.keeper import BESIDE_S, LEARN_S
from armadico.watch.assistant.messages import AssistantReply, AssistantRequest
from armadico.watch.assistant.policy.messages import Approvals, Choice
from tests.watch.policy.house import NOON
from tests.watch.policy.test_approvals import Desk
from tests.watch.test_assistant import STOPPED, Counter

POLICY = """
[default]
area = [[[0, 0], [6, 0], [6, 3], [0, 3]]]
v_max = 0.4
"""
BODY = Description("r", 0.1, 0.25, 0.25, 0.2, 1.0, 1.0, 0.5, 0.5, 2.0, 2.0, 0.4, 2.0)
SURE = (1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4)
TERMS = Terms("assistant: model", 0.4, "assistant")

APPROVED = '[default]\napproval = ["goto"]\n'


class Watched(Desk):
    """An assistant that is told where the robot is."""

    def __init__(
        self, tmp_path: Path, policy: str = POLICY, x: float = 1.0, y: float = 1.5
    ) -> None:
        super().__init__(tmp_path, policy)
        self.cycle = 0
        self.trajectories = 0
        self.receive(BODY)
        self.at(x, y)

    def at(
        self,
        x: float,
        y: float,
        theta: float = 0.0,
        v: float = 0.0,
        covariance: tuple[float, ...] = SURE,
        points: tuple[tuple[float, float], ...] = (),
    ) -> None:
        """A cycle: the robot is there; points are in its frame."""
        self.cycle += 1
        self.now += 0.1
        cycle = Cycle(1, self.cycle)
        self.receive(
            RobotState(cycle, 0, 0, 0, v, 0, 12, True, False),
            Pose(cycle, x, y, theta, covariance),
            Obstacles(cycle, None, None, None, None, tuple(Point(*each) for each in points)),
        )

    def drives(self, *path: tuple[float, float], mission: int = 77, **more: object) -> None:
        self.trajectories += 1
        waypoints = tuple(Waypoint(x, y, 0.0) for x, y in path)
        self.receive(
            Trajectory(self.trajectories, mission, waypoints, **({"terms": TERMS} | more))  # type: ignore[arg-type]
        )

    def plan(self, *path: tuple[float, float]) -> None:
        """The planner answers."""
        assert isinstance(self.queries[-1].request, PlanRequest)
        plan = Plan(tuple(Waypoint(x, y, 0.0) for x, y in path))
        self.hear(plan)

    def ask_with_plan(self, *path: tuple[float, float]) -> AssistantReply:
        x, y = path[-1]
        self.request("goto", x=x, y=y)
        number = self.number
        self.plan(*path)
        return self.replies[number]

    @property
    def cancels(self) -> list[MissionCancel]:
        found = [each.request for each in self.queries]
        return [each for each in found if isinstance(each, MissionCancel)]


def test_a_goal_is_passed_on_with_the_terms_of_its_client(tmp_path: Path) -> None:
    watched = Watched(tmp_path)
    watched.request("goto", x=4, y=1.5)
    watched.plan((4.0, 1.5))
    request = watched.queries[-1].request
    assert isinstance(request, MissionRequest)
    assert request.terms == TERMS
    watched.drives((4.0, 1.5))
    watched.at(1.1, 1.5, v=0.3)
    assert not watched.cancels


@pytest.mark.parametrize("why", ["stopped by ann", "it is 20:00"])
def test_what_comes_while_the_path_is_planned_refuses_the_goal(why: str, tmp_path: Path) -> None:
    watched = Watched(tmp_path, POLICY + 'hours = ["08:00-20:00"]\n')
    watched.agent.clock = lambda: NOON
    watched.request("goto", x=4, y=1.5)
    number = watched.number
    if "stopped" in why:
        watched.receive(STOPPED)
    else:
        watched.agent.clock = lambda: NOON.replace(hour=20)
    watched.plan((4.0, 1.5))
    assert why in watched.replies[number].refusal
    assert len(watched.queries) == 1, "nobody was asked to drive"


def test_a_goal_waits_for_what_a_new_assistant_has_not_received_yet(tmp_path: Path) -> None:
    desk = Desk(tmp_path, POLICY)
    assert desk.request("goto", x=4, y=1.5) is None, "no refusal"
    assert "one request" in desk.refusal("goto", x=2, y=1.5)
    cycle = Cycle(1, 1)
    desk.receive(BODY, RobotState(cycle, 0, 0, 0, 0, 0, 12, True, False))
    assert not desk.queries
    desk.receive(Pose(cycle, 1.0, 1.5, 0.0, SURE))
    assert isinstance(desk.queries[-1].request, PlanRequest)


def test_a_goal_is_refused_if_the_robot_stays_unknown(tmp_path: Path) -> None:
    desk = Desk(tmp_path, POLICY)
    assert desk.request("goto", x=4, y=1.5) is None
    desk.pass_s(2.0)
    assert "no robot/description" in desk.replies[desk.number].refusal


def test_a_path_that_leaves_the_area_is_refused_before_the_robot_moves(tmp_path: Path) -> None:
    watched = Watched(tmp_path)
    assert "the path" in watched.ask_with_plan((3.0, 4.0), (4.0, 1.5)).refusal
    assert len(watched.queries) == 1, "nobody was asked to drive"


def test_a_path_that_is_planned_anew_and_leaves_the_area_ends_the_mission(tmp_path: Path) -> None:
    watched = Watched(tmp_path)
    watched.drives((4.0, 1.5))
    watched.drives((2.0, 3.5), (4.0, 1.5))
    (cancel,) = watched.cancels
    assert cancel.mission == 77
    assert "the path is" in cancel.by


@pytest.mark.parametrize(
    ("place", "named"),
    [
        ({"x": 3.0, "y": 3.2}, "the robot is outside"),
        ({"x": 3.0, "y": 2.9}, "the robot is nearer"),
        ({"x": 3.0, "y": 2.3, "theta": pi / 2, "v": 0.6}, "where the robot can stop"),
        ({"x": 3.0, "y": 0.7, "theta": pi / 2, "v": -0.6}, "where the robot can stop"),
        ({"x": 3.0, "y": 2.5, "covariance": (0.04, 0, 0, 0.09, 0, 0)}, "the robot is nearer"),
        ({"x": 3.0, "y": 1.5, "covariance": (0.4, 0, 0, 0.4, 0, 0)}, "not known"),
        ({"x": 3.0, "y": 1.5, "covariance": ()}, "not known"),
    ],
)
def test_a_mission_ends_where_the_robot_leaves_or_is_about_to(
    place: dict, named: str, tmp_path: Path
) -> None:
    watched = Watched(tmp_path)
    watched.drives((5.0, 1.5))
    watched.now += 3.0
    watched.at(**place)
    assert [cancel.mission for cancel in watched.cancels] == [77]
    assert named in watched.cancels[0].by


@pytest.mark.parametrize("more", [{"terms": None}, {"terms": Terms("ann")}])
def test_the_missions_of_people_are_not_watched(more: dict, tmp_path: Path) -> None:
    watched = Watched(tmp_path)
    watched.drives((9.0, 9.0), **more)
    watched.at(8.0, 8.0, v=1.0)
    assert not watched.cancels


def test_a_mission_ends_if_the_assistant_comes_back_without_its_policy() -> None:
    counter = Counter()
    counter.receive(Trajectory(1, 77, (Waypoint(4.0, 1.5, 0.0),), terms=TERMS))
    counter.now += BESIDE_S
    counter.agent.kernel.wake(counter.now)
    counter.collect()
    cancel = counter.queries[-1].request
    assert isinstance(cancel, MissionCancel)
    assert (cancel.mission, cancel.by) == (77, "the policy: its policy is not known here")


def test_an_assistant_without_a_policy_leaves_missions_to_one_that_has_one_while_it_is_alive() -> (
    None
):
    counter = Counter()
    counter.receive(Trajectory(1, 77, (Waypoint(4.0, 1.5, 0.0),), terms=TERMS))
    assert not counter.queries, "it has just started, and may not have heard of another one"
    counter.now = LEARN_S
    counter.receive(Approvals(policy="policy.toml"))
    counter.receive(Trajectory(2, 77, (Waypoint(4.0, 1.5, 0.0),), terms=TERMS))
    assert not counter.queries
    assert "another assistant agent" in counter.refusal("goto", x=2.0, y=1.0)
    assert "another assistant agent" not in counter.refusal("stop")
    counter.now += BESIDE_S
    counter.receive(Trajectory(3, 77, (Waypoint(4.0, 1.5, 0.0),), terms=TERMS))
    assert isinstance(counter.queries[-1].request, MissionCancel), "that one has ended"


def test_where_a_divided_network_is_one_again_the_other_assistant_is_heard_first() -> None:
    counter = Counter()
    counter.now = 100.0
    counter.receive(Trajectory(1, 77, (Waypoint(4.0, 1.5, 0.0),), terms=TERMS))
    counter.now += BESIDE_S / 3
    counter.receive(Approvals(policy="policy.toml"))
    counter.now += BESIDE_S - 0.1
    counter.receive(Trajectory(2, 77, (Waypoint(4.0, 1.5, 0.0),), terms=TERMS))
    assert not counter.queries


def test_an_echo_ends_nothing_and_what_stays_does(tmp_path: Path) -> None:
    watched = _with_people(tmp_path)
    watched.drives((4.0, 4.9))
    for points in [((0.6, 0.0),), (), ((0.6, 0.0),), ((0.6, 0.0),), ()]:
        watched.at(2.0, 4.9, v=0.2, points=points)
    assert not watched.cancels
    for _ in range(3):
        watched.at(2.0, 4.9, v=0.2, points=((0.6, 0.0),))
    (cancel,) = watched.cancels
    assert "perhaps a person" in cancel.by


def test_the_walls_of_the_map_are_no_people(tmp_path: Path) -> None:
    watched = _with_people(tmp_path)
    watched.drives((4.0, 4.9))
    for _ in range(5):
        watched.at(3.5, 4.7, v=0.2, points=((0.0, -0.7), (0.3, -0.5)))
    assert not watched.cancels


def _with_people(tmp_path: Path) -> Watched:
    return Watched(tmp_path, "[default]\npeople_m = 0.5\n", 2.0, 4.9)


def test_if_nobody_cancels_the_robot_is_stopped(tmp_path: Path) -> None:
    watched = Watched(tmp_path)
    watched.drives((5.0, 1.5))
    for _ in range(3):
        watched.at(3.0, 3.2)
        assert not watched.stops
        watched.hear(None)
    assert len(watched.cancels) == 3
    (stop,) = watched.stops
    assert "nobody cancels" in stop.by


def test_one_cancellation_at_a_time(tmp_path: Path) -> None:
    watched = Watched(tmp_path)
    watched.drives((5.0, 1.5))
    for _ in range(5):
        watched.at(3.0, 3.2)
    assert len(watched.cancels) == 1
    watched.hear(MissionReply(77))
    watched.drives()
    watched.at(3.0, 3.2)
    assert len(watched.cancels) == 1


def test_a_new_way_through_a_room_that_nobody_approved_ends_the_mission(tmp_path: Path) -> None:
    watched = Watched(tmp_path, '[default]\napproval_rooms = ["C", "B"]\n', 2.3, 2.0)
    waits = watched.ask_with_plan((4.8, 4.9), (6.9, 2.0))
    watched.answer(watched.code(), Choice.YES)
    watched.at(2.3, 2.0)
    watched.plan((4.8, 4.9), (6.9, 2.0))
    watched.drives((4.8, 4.9), (6.9, 2.0))
    assert not watched.cancels, "before the reply"
    watched.hear(MissionReply(77))
    assert watched.poll(waits.approval).mission == 77
    watched.drives((4.8, 4.9), (6.9, 2.0))
    assert not watched.cancels
    watched.drives((2.0, 7.0), (4.8, 4.9), (6.9, 2.0))
    (cancel,) = watched.cancels
    assert "through B, which nobody has approved" in cancel.by


def test_a_way_straight_through_a_room_waits_for_approval(tmp_path: Path) -> None:
    """No corner of the path is in the room."""
    watched = Watched(tmp_path, '[default]\napproval_rooms = ["corridor"]\n', 2.0, 2.0)
    assert "through corridor" in watched.ask_with_plan((2.0, 8.0)).text
    watched.drives((2.0, 8.0), by="assistant: model")
    (cancel,) = watched.cancels
    assert "through corridor, which nobody has approved" in cancel.by


def cancel(watched: Watched, by: str = "model") -> AssistantReply | None:
    return watched.put(AssistantRequest("cancel", "{}", by))


def test_a_goal_whose_path_is_planned_for_the_policy_is_taken_back_by_its_client_alone(
    tmp_path: Path,
) -> None:
    watched = Watched(tmp_path)
    watched.request("goto", x=4.0, y=1.5)
    goto, query = watched.number, watched.queries[-1]
    assert isinstance(query.request, PlanRequest)
    assert "no goal of yours" in (cancel(watched, "other") or AssistantReply()).refusal
    assert goto not in watched.replies
    assert (cancel(watched) or AssistantReply()).text
    assert watched.replies[goto].refusal == TAKEN_BACK
    path = (Waypoint(1.0, 1.5, 0.0), Waypoint(4.0, 1.5, 0.0))
    watched.hear(Plan(path), query.id)
    assert watched.queries[-1] is query, "nothing is passed on"
    watched.request("goto", x=3.0, y=1.5)
    assert watched.queries[-1] is not query, "the next one is planned"


@pytest.mark.usefixtures("rehearsals")
def test_a_rehearsal_keeps_no_order_waiting_and_is_none_that_can_be_cancelled(
    tmp_path: Path,
) -> None:
    watched = Watched(tmp_path)
    path = Plan((Waypoint(1.0, 1.5, 0.0), Waypoint(4.0, 1.5, 0.0)))

    def rehearse() -> tuple[int, int]:
        assert watched.request("rehearse", x=4.0, y=1.5) is None
        assert isinstance(watched.queries[-1].request, PlanRequest)
        return watched.number, watched.queries[-1].id

    number, query = rehearse()
    assert watched.refusal("rehearse", x=3.0, y=1.5) == BUSY, "one plan at a time"
    assert "no goal of yours" in (cancel(watched) or AssistantReply()).refusal
    watched.request("goto", x=4.0, y=1.5)
    watched.plan((4.0, 1.5))
    assert isinstance(watched.queries[-1].request, MissionRequest), "it goes on meanwhile"
    watched.hear(path, query)
    assert watched.replies[number] == AssistantReply()
    number, query = rehearse()  # while a mission agent has the order
    watched.hear(path, query)
    assert watched.replies[number] == AssistantReply()


@pytest.mark.usefixtures("rehearsals")
def test_a_rehearsal_at_the_start_keeps_no_order_waiting(tmp_path: Path) -> None:
    desk = Desk(tmp_path, POLICY)
    assert desk.request("rehearse", x=4, y=1.5) is None
    assert desk.request("goto", x=4, y=1.5) is None, "no refusal"
    cycle = Cycle(1, 1)
    desk.receive(BODY, RobotState(cycle, 0, 0, 0, 0, 0, 12, True, False))
    for _ in range(2):
        desk.receive(Pose(cycle, 1.0, 1.5, 0.0, SURE))
    assert [type(each.request) for each in desk.queries] == [PlanRequest, PlanRequest]


def test_a_request_that_waits_for_a_person_is_taken_back(tmp_path: Path) -> None:
    desk = Watched(tmp_path, APPROVED)
    waits = desk.ask_with_plan((4.0, 1.5))
    code, asked = desk.code(), len(desk.queries)
    assert (cancel(desk) or AssistantReply()).text
    assert TAKEN_BACK in desk.poll(waits.approval).refusal
    assert "it is over" in desk.answer(code).refusal
    assert len(desk.queries) == asked


def test_nobody_is_asked_for_a_goal_that_cannot_be_reached(tmp_path: Path) -> None:
    watched = Watched(tmp_path, APPROVED)
    watched.request("goto", x=-5, y=1.5)
    why = "the goal is outside of the map"
    watched.hear(Plan((), refusal=why))
    assert watched.replies[watched.number].refusal == why
    assert watched.ask_with_plan((4.0, 1.5)).approval
    code = watched.code()
    watched.answer(code)
    assert isinstance(watched.queries[-1].request, MissionRequest)


def test_a_society_without_a_planner_asks_a_person(tmp_path: Path) -> None:
    watched = Watched(tmp_path, APPROVED)
    watched.request("goto", x=4, y=1.5)
    watched.hear(None)
    assert watched.replies[watched.number].approval
