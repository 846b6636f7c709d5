"""The measures of a mission of several tasks, and of an exploration."""

from __future__ import annotations

from armadico.agents.missions.messages import (
    Board,
    BoardMission,
    Course,
    ExploreState,
    ExploreStatus,
    MissionEnd,
    StepEnd,
    StepResult,
)
from armadico.core.judgement import Answer
from armadico.core.messages import (
    Cycle,
)
from armadico.mobile.messages import (
    Pose,
)
from armadico.observe.measures import TaskResult
from tests.robot.observe.test_measures import MISSION, Run


def test_an_exploration_that_failed_is_not_astray() -> None:
    run = Run().begin()
    run.cycle(0.0)
    run.show(Pose(Cycle(1, 9), 0.0, 0.0, 0.0))
    run.show(ExploreStatus(MISSION, ExploreState.FAILED, note="there is no way back"))
    assert run.watch.done
    assert run.watch.astray is None


def board(state: MissionEnd, note: str = "", mission: int = MISSION) -> Board:
    results = (StepResult("move(R1)", StepEnd.DONE, "in R1", 3.25),)
    return Board(
        1, 1, (BoardMission(mission, "m", 0.5, state, course=Course(results=results), note=note),)
    )


def test_a_mission_removed_from_the_board_is_over() -> None:
    run = Run(goal=None).begin()
    run.cycle(0.0)
    run.show(Board(1, 1, ()))  # published before it was accepted
    assert not run.watch.done
    run.show(board(MissionEnd.ACTIVE))
    run.show(board(MissionEnd.ACTIVE, mission=MISSION + 1))
    assert run.watch.done
    result = run.watch.result()
    assert result.done is False
    assert result.why


def test_a_mission_that_is_done_only_perhaps_is_neither_done_nor_passed() -> None:
    run = Run(goal=None).begin()
    run.cycle(0.0)
    run.show(board(MissionEnd.DONE, "move(R1): +-0.30 m"))
    result = run.watch.result()
    assert run.watch.done
    assert result.done is None
    assert result.judgement.answer is Answer.UNKNOWN
    assert result.outcome == "unsure: move(R1): +-0.30 m"


def test_a_mission_of_several_tasks_is_done_or_not_and_has_its_steps() -> None:
    for end, note in (
        (MissionEnd.DONE, ""),
        (MissionEnd.FAILED, "no way"),
        (MissionEnd.CANCELLED, ""),
    ):
        run = Run(goal=None).begin()
        run.cycle(0.0)
        run.show(board(MissionEnd.ACTIVE, mission=MISSION + 1))
        assert run.watch.result().done is None
        run.show(board(MissionEnd.ACTIVE, "waits"))
        assert not run.watch.done
        assert "waits" in run.watch.result().outcome
        run.show(board(end, note))
        result = run.watch.result()
        assert run.watch.done
        assert result.done == result.passed == (end is MissionEnd.DONE)
        assert note in result.outcome
        assert result.tasks == (TaskResult("move(R1)", "done", "in R1", 3.25),)
        assert run.watch.astray is None
