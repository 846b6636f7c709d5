"""Giveway: robots that drive straight on through a corridor, if their agents let them."""

from __future__ import annotations

import pytest

from armadico.agents.fleet.giveway import SPOKEN_S, UNSEEN_S
from armadico.agents.fleet.messages import FleetPassages
from armadico.core.messages import Stop
from armadico.core.outgoing import Publish, Refused
from armadico.mobile.messages import Trajectory
from armadico.testing.alone import claims
from tests.fleet.corridor import MOUTHS, Fleet, Robot, corridor


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> str:
    return corridor(tmp_path_factory.mktemp("worlds"))


def why(robot: Robot) -> str:
    return robot.bid.reason


def test_two_that_come_from_both_sides_drive_through_one_after_the_other(world: str) -> None:
    fleet = Fleet(Robot("a", world, 3.0, 15.0), Robot("b", world, 15.5, 3.0))
    fleet.run(20.0)
    waits = fleet.robots["b"]
    assert waits.x == pytest.approx(MOUTHS[1] + 2.0, abs=0.4), "clear of the mouth"
    assert waits.speed == (0.0, 0.0)
    fleet.run(60.0)
    assert fleet.arrived
    assert fleet.entered == ["a", "b"], "the nearer one first"
    assert fleet.most == 1


@pytest.mark.long
def test_five_queue_and_no_two_are_inside_at_once(world: str) -> None:
    there = [Robot(f"a{k}", world, 3.0 - 1.2 * k, 16.0) for k in range(3)]
    back = [Robot(f"b{k}", world, 15.0 + 1.2 * k, 2.0) for k in range(2)]
    fleet = Fleet(*there, *back)
    fleet.run(25.0)
    assert any(why(robot).startswith("waits behind a") for robot in there)
    fleet.run(200.0)
    assert fleet.arrived
    assert fleet.most == 1
    order = [name for name in fleet.entered if name[0] == "a"]
    assert order == ["a0", "a1", "a2"], "no robot has to drive past the one before it"


def test_a_robot_that_stays_inside_enters_after_those_that_drive_through(world: str) -> None:
    fleet = Fleet(Robot("a", world, 3.0, 9.0), Robot("b", world, 17.0, 2.0))
    fleet.run(100.0)
    assert fleet.arrived
    assert fleet.entered == ["b", "a"]


def test_what_a_robot_wanted_that_has_fallen_silent_is_not_waited_for(world: str) -> None:
    fleet = Fleet(Robot("a", world, 3.0, 9.0), Robot("b", world, 17.0, 2.0))
    fleet.run(4.0)
    del fleet.robots["b"]
    fleet.run(SPOKEN_S + 35.0)
    assert fleet.arrived


def test_a_passage_in_which_a_robot_died_is_entered_once_it_is_not_expected_there(
    world: str,
) -> None:
    fleet = Fleet(Robot("a", world, 3.0, 15.0), Robot("b", world, 15.5, 3.0))
    fleet.run(17.0)
    assert fleet.robots.pop("a").inside
    fleet.run(UNSEEN_S - 1.0)
    left = fleet.robots["b"]
    assert left.speed == (0.0, 0.0)
    fleet.run(8.0)
    assert left.inside, "what stands in there its sensors have seen by now"


def test_an_agent_that_restarts_inside_has_the_passage_again(world: str) -> None:
    fleet = Fleet(Robot("a", world, 3.0, 15.0), Robot("b", world, 15.5, 3.0))
    fleet.run(17.0)
    before = fleet.robots["a"]
    assert before.inside
    again = Robot("a", world, before.x, 15.0, start=2)
    again.number, again.now = before.number, before.now
    fleet.robots["a"] = again
    fleet.run(80.0)
    assert fleet.arrived
    assert fleet.most == 1


def test_a_robot_inside_without_the_passage_backs_off_the_way_it_came(world: str) -> None:
    first = Robot("b", world, 11.0, 9.0)
    fleet = Fleet(first)
    fleet.run(6.0)
    intruder = Robot("a", world, 4.0, 15.0)
    intruder.number, intruder.now = first.number, first.now
    intruder.push(28)
    assert intruder.inside
    fleet.robots["a"] = intruder
    fleet.run(1.5)
    assert intruder.speed[0] <= 0.0
    fleet.run(15.0)
    assert intruder.x < MOUTHS[0] - 0.6, "and out of the mouth, where the other one comes out"
    assert intruder.speed == (0.0, 0.0)


def test_a_robot_with_another_map_is_reported_and_its_passages_are_ignored(world: str) -> None:
    robot = Robot("a", world, 3.0, 15.0)
    passages = robot.agent.sharing  # type: ignore[attr-defined]
    cycle = passages.clock.cycles.newest
    for _ in range(20):
        robot.tick()
        cycle = passages.clock.cycles.newest
    assert cycle is not None
    other = FleetPassages("b", "giveway-b", type(cycle)(cycle.epoch ^ 1, 3), (), (0,))
    robot.agent.kernel.receive(other, robot.now)
    refused = [item for item in robot.agent.kernel.outbox if isinstance(item, Refused)]
    assert "b has another map" in refused[0].why
    assert not [item for item in robot.agent.kernel.outbox if isinstance(item, Publish)]
    for _ in range(300):
        robot.tick()
    assert robot.there


def test_without_a_goal_or_a_map_it_drives_nothing(world: str) -> None:
    blind = Robot("a", None, 3.0, 15.0)
    for _ in range(200):
        blind.tick()
    assert why(blind) == "there is no map"
    idle = Robot("a", world, 3.0, 15.0)
    idle.give(Trajectory(2, 2, ()))
    idle.tick()
    assert why(idle) == "no goal"
    assert claims(blind.published) == claims(idle.published) == []


def test_the_message_says_what_is_held_wanted_and_waited_for(world: str) -> None:
    fleet = Fleet(Robot("a", world, 3.0, 15.0), Robot("b", world, 15.5, 3.0))
    fleet.run(15.0)
    a, b = (
        [m for m in robot.published if isinstance(m, FleetPassages)][-1]
        for robot in fleet.robots.values()
    )
    assert [claim.resource for claim in a.claims] == ["passage-0"]
    assert (a.waits, b.claims, b.through, b.waits) == (False, (), (0,), True)


def test_a_robot_that_was_stopped_before_a_passage_leaves_it_to_the_others(world: str) -> None:
    stopped = Robot("a", world, 2.5, 15.0)
    fleet = Fleet(stopped, Robot("b", world, 17.0, 3.0))
    stopped.give(Stop(1, stopped=True, by="a person"))
    stopped.goal = stopped.x  # where it stands
    fleet.run(60.0)
    assert fleet.robots["b"].there
