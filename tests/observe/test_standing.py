"""Why the robot stands: planted faults on the virtual mesh, each with its own cause."""

from __future__ import annotations

from armadico.config.discovery import providers
from armadico.observe.standing import Sort, standing
from armadico.observe.why import Chronicle
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
    assert "goto: no bid (no fresh sonar/obstacles)." in found.sentences


def test_who_listens_since_lately_is_told_who_would_provide_what_is_lacking() -> None:
    """Whoever was gone before has left no card; the agents that are installed are known."""
    heard = Overheard().drive()
    heard.mesh.node("sonar").kill()
    heard.let_pass(3.0)
    heard.chronicle = Chronicle()
    heard.let_pass(2.0)
    unknown = heard.standing.cause
    known = standing(heard.view, heard.mesh.now, providers).cause
    assert unknown is not None
    assert known is not None
    assert (unknown.sort, unknown.who) == (Sort.ABSENT, "sonar/obstacles")
    assert (known.sort, known.who) == (Sort.ABSENT, "sonar")


def test_what_several_have_in_common_is_said_once_and_the_cause_comes_last() -> None:
    heard = Overheard().drive()
    heard.mesh.node("sonar").hang()
    found = heard.let_pass(3.0).standing
    assert found.cause is not None
    assert found.sentences[-1] == found.cause.what
    assert len(set(found.sentences)) == len(found.sentences)


def test_an_agent_that_is_installed_is_found_by_what_it_publishes() -> None:
    assert providers("encoder/pose") == ("encoder",)
    assert providers("sonar/obstacles") == ("sonar",)
    assert providers("resource/wheels/ack") == ("robot",)
    assert providers("no/such/key") == ()


def test_a_society_that_has_ended_or_that_is_not_heard_is_blamed_on_nobody() -> None:
    heard = Overheard().drive()
    gap = standing(heard.view, heard.mesh.now + 10.0).cause
    assert gap is not None
    assert (gap.sort, gap.who) == (Sort.UNKNOWN, "")
    assert "for 10.0 s" in gap.what
    for node in heard.mesh.nodes:
        node.leave()
    ended = heard.let_pass(3.0).standing
    assert ended.sentences == ("No agent is alive any more.",)
