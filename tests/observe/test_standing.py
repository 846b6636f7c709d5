"""Why the robot stands: planted faults on the virtual mesh, each with its own cause."""

from __future__ import annotations

from armadico.observe.standing import Sort
from tests.observe.overheard import Overheard


def test_a_robot_that_moves_has_no_cause_and_one_without_a_goal_says_so() -> None:
    heard = Overheard()
    idle = heard.standing
    assert idle.stands
    assert idle.cause is not None
    assert idle.cause.sort is Sort.NO_GOAL
    moving = heard.drive().standing
    assert not moving.stands
    assert moving.cause is None
    assert "goto drives" in moving.sentences[0]


def test_the_chain_ends_at_the_agent_that_is_not_alive() -> None:
    heard = Overheard().drive()
    heard.mesh.node("sonar").kill()
    found = heard.let_pass(3.0).standing
    assert found.cause is not None
    assert (found.cause.sort, found.cause.who) == (Sort.ABSENT, "sonar")
    assert "goto has no bid: no fresh sonar/obstacles." in found.sentences
