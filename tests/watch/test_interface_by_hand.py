"""The interface agent and a view, while a person drives."""

from __future__ import annotations

import pytest

from armadico.core.messages import Cycle, Message
from armadico.mobile.messages import (
    MissionRequest,
    MissionState,
    MissionStatus,
    PlanRequest,
    Trajectory,
    Waypoint,
)
from armadico.observe.view import View
from armadico.watch.teleop.messages import TeleopStatus
from tests.robot.agents.test_interface import GOAL, PLAN, Desk, touch


class ByHand(Desk):
    """With a hand on the stick, or none."""

    hand = ""

    def said(self) -> list[Message]:
        return [TeleopStatus(self.at, self.hand)]


@pytest.fixture
def desk() -> ByHand:
    """On the planner's way to the goal."""
    desk = ByHand()
    desk.moved(0.0)
    desk.request(MissionRequest(GOAL))
    desk.reply(PLAN)
    return desk


def test_a_robot_that_was_driven_by_hand_has_its_way_planned_anew_when_the_hand_is_off(
    desk: ByHand,
) -> None:
    desk.hand = "ann"
    desk.moved(0.5, 1.0)
    assert desk.last(MissionStatus).note == "ann drives by hand"
    assert len(desk.on_query) == 1
    desk.hand = ""
    desk.moved(1.5, 1.5)
    assert [query.request for query in desk.on_query[1:]] == [
        PlanRequest(Waypoint(1.5, 1.5, 0.0), GOAL, "the robot was driven by hand")
    ]
    desk.reply(None)  # nobody plans: the way that there is is gone on with
    assert not desk.last(Trajectory).waits


def test_what_a_hand_has_it_touch_is_the_hand_s(desk: ByHand) -> None:
    desk.hand = "somebody"
    for _ in range(5):
        touch(desk, 1.0)
    assert desk.last(MissionStatus).state is MissionState.DRIVING


def test_a_hand_is_not_known_without_fresh_messages() -> None:
    view, status = View(), TeleopStatus(Cycle(1, 1), "ann", True, 0, 0, 1, 1)
    view.learn(status, 1.0)
    assert [view.hand(at) for at in (2.9, 3.1)] == [status, None]
