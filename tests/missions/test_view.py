"""What a view of a society tells of its missions."""

from __future__ import annotations

from armadico.agents.missions.messages import (
    Board,
    BoardMission,
    Course,
    MissionEnd,
    StepEnd,
    StepResult,
)
from armadico.observe.view import View

# Resources ----------------------------------------------------------------------------------------


# Messages and rates -------------------------------------------------------------------------------


def test_the_active_mission_of_a_board_is_described() -> None:
    view = View()
    assert view.tasks == ""
    done = StepResult("move(hall)", StepEnd.DONE)
    course = Course(results=(done, StepResult("dock", StepEnd.FAILED)))
    active = BoardMission(
        7,
        "survey",
        0.5,
        MissionEnd.ACTIVE,
        course=course,
        doing="take-photo",
        ahead=("wait(5.0)",),
        note="slow",
    )
    waits = BoardMission(8, "later", 0.2, MissionEnd.QUEUED)
    view.learn(Board(3, 1, (waits, active)), 1.0)
    assert view.tasks == "survey: 1 done, take-photo, 1 to come, slow"
    view.learn(Board(4, 1, (waits,)), 2.0)
    assert view.tasks == ""
