"""The fleet agent among others: a list is shared, done once, and outlives whoever dies."""

from __future__ import annotations

from random import Random

import pytest

from armadico.agents.fleet.fleet import TRIES
from armadico.agents.fleet.messages import (
    FleetPassages,
    FleetReply,
    FleetRequest,
    FleetTask,
    FleetTasks,
)
from armadico.core.messages import Cycle, Log, Message, Stop
from armadico.mesh.link_faults import LinkFaults
from armadico.mesh.virtual import VirtualMesh
from armadico.mobile.messages import MissionRequest, Waypoint
from tests.fleet.band import Band

HERE = ((1.0, 0.0), (3.0, 0.0), (5.0, 0.0))
JOINED_S = 2.0


def tasks(count: int, seed: int = 1) -> list[FleetTask]:
    rng = Random(seed)
    places = (Waypoint(rng.uniform(0, 12), rng.uniform(0, 12), 0.0) for _ in range(count))
    return [FleetTask(place, 3.0) for place in places]


def at_work(robots: int = 3, count: int = 9, seed: int = 1) -> Band:
    """Robots that have joined, and the first has been given the list."""
    band = Band(HERE[:robots], tasks(count), seed)
    band.mesh.run(JOINED_S)
    band.give("f/r1")
    band.mesh.run(JOINED_S + 0.1)
    assert band.reply is not None
    assert not band.reply.refusal
    return band


def lines(band: Band, name: str) -> list[str]:
    found: list[str] = []

    def take(_key: str, message: Message, _now: float) -> None:
        assert isinstance(message, Log)
        found.append(message.text)

    band.mesh.watch(take, Log, namespace=name)
    return found


def once(band: Band, count: int) -> bool:
    """Whether each task was done, and by one."""
    doers = band.doers
    return len(doers) == count and all(len(by) == 1 for by in doers.values())


def held_at_30_s(band: Band, name: str) -> set[int]:
    """The tasks that a robot has taken on by then."""
    band.mesh.run(30.0)
    sharing = band.sharing(name)
    held = set(sharing.mine)
    assert held
    return held


def done_without(band: Band, robot: str, held: set[int]) -> None:
    """All is done, each once, and what a robot held by others too."""
    assert band.run(400.0)
    assert once(band, 9)
    assert all(not held & {t} or by != {robot} for t, by in band.doers.items())


@pytest.mark.parametrize("robots", [1, 2, 3])
def test_who_is_given_a_list_tells_the_others_and_each_task_is_done_once(robots: int) -> None:
    band = at_work(robots)
    assert band.run(400.0)
    assert once(band, 9)
    assert len({name for by in band.doers.values() for name in by}) == robots, "by all of them"


def test_more_robots_are_sooner_done() -> None:
    took = []
    for robots in (1, 2, 3):
        band = at_work(robots, 12)
        assert band.run(600.0)
        took.append(band.makespan)
    assert took[0] > 1.5 * took[1] > 1.5 * took[2]


def test_a_robot_that_dies_gives_its_tasks_back() -> None:
    band = at_work()
    held = held_at_30_s(band, "f/r2")
    band.kill("f/r2")
    done_without(band, "r2", held)


def test_a_robot_that_can_do_nothing_gives_its_tasks_back_while_its_fleet_agent_lives() -> None:
    band = at_work()
    held = held_at_30_s(band, "f/r2")
    band.puppet("f/r2").dumb = True
    band.mesh.run(38.0)
    sharing = band.sharing("f/r2")
    assert not sharing.mine
    done_without(band, "r2", held)


def test_the_tasks_of_a_robot_without_a_robot_agent_are_done_by_the_others() -> None:
    """Its fleet agent lives, and reaches no other robot."""
    band = at_work()
    held = held_at_30_s(band, "f/r2")
    band.kill_puppet("f/r2")
    done_without(band, "r2", held)


def test_who_comes_late_is_told_and_takes_its_share() -> None:
    band = at_work(1)
    band.mesh.run(25.0)
    band.enter("f/r2", (6.0, 6.0))
    assert band.run(400.0)
    assert once(band, 9)
    assert {"r2"} in band.doers.values()


def test_a_fleet_agent_that_was_started_again_alone_knows_what_is_done() -> None:
    """Of one robot: its other agents remember the board."""
    band = at_work(1)
    band.mesh.run(50.0)
    before = set(band.doers)
    assert before
    band.kill_agent("f/r1")
    band.mesh.run(51.0)
    band.start_agent("f/r1")
    band.mesh.run(54.0)
    assert set(band.doers) >= before
    assert band.run(400.0)
    assert once(band, 9)


def test_a_second_list_has_to_wait_and_then_takes_the_first_ones_place() -> None:
    band = at_work()
    band.give("f/r2")
    band.mesh.run(band.mesh.now + 1.0)
    assert band.reply is not None
    assert "works on a list of 9, of which 9 are not done" in band.reply.refusal
    assert band.run(400.0)
    band.give("f/r3")
    band.mesh.run(band.mesh.now + 3.0)
    assert not band.reply.refusal
    assert not band.over
    assert band.run(400.0)
    assert once(band, 9)


def test_a_list_may_take_the_place_of_one_that_is_worked_on_and_that_is_not_brought_back() -> None:
    """Neither by one that was away until the new one was done, and still has the old one."""
    band = at_work(3, 9)
    away, rest = ["f/r3"], ["f/r1", "f/r2"]
    band.mesh.run(15.0)
    band.cut(away, rest)
    two = FleetRequest(band.tasks[:2], replace=True)
    replies: list[Message | None] = []
    band.mesh.query(two, replies.append, namespace="f/r2")
    band.mesh.run(100.0, lambda: band.over)
    (reply,) = replies
    assert isinstance(reply, FleetReply)
    assert not reply.refusal
    shares = [band.sharing(name) for name in (*rest, *away)]
    assert [one.tasks for one in shares] == [2, 2, 9]
    assert not any(one.open for one in shares[:2])
    old = FleetTasks(shares[2].clock.epoch, 0, band.tasks)
    band.mesh.publish(old, namespace="f/r1")  # as the one that is away would give it
    band.mesh.run(band.mesh.now + 1.0)
    assert [band.sharing(name).tasks for name in rest] == [2, 2]
    band.heal(away, rest)
    band.mesh.run(band.mesh.now + 10.0)
    assert [band.sharing(name).tasks for name in band.names] == [2, 2, 2]
    assert band.over


def test_two_fleets_with_one_name_are_told_apart() -> None:
    """Each was given a list of its own before they heard of each other."""
    mesh = VirtualMesh(3)
    one = Band(HERE[:2], tasks(8), 3, mesh=mesh)
    other = Band((), tasks(5, seed=2), 3, mesh=mesh)
    for k, start in enumerate(HERE[:2]):
        other.enter(f"f/r{k + 5}", start)
    sides = ["f/r1", "f/r2"], ["f/r5", "f/r6"]
    one.cut(*sides)
    mesh.run(JOINED_S)
    one.give("f/r1")
    other.give("f/r5")
    mesh.run(20.0)
    said = lines(one, "f/r1") + lines(other, "f/r5")
    heard = [lines(one, name) for name in (*sides[0], *sides[1])]
    one.heal(*sides)
    mesh.run(30.0)
    assert not said
    assert any("two fleets are named 'f'" in text for texts in heard for text in texts)
    for name in sides[0]:
        assert one.sharing(name).tasks == 8
    assert one.run(600.0)
    assert other.run(600.0)
    lists = {one.sharing(name).clock.epoch for name in sides[0]}
    assert one.reply is not None
    assert other.reply is not None
    finished = {*one.fleet("f/r1")._over, *other.fleet("f/r5")._over}
    assert lists <= {one.reply.list, other.reply.list}
    assert {one.reply.list, other.reply.list} <= finished, "nothing of either is lost"


def test_fleets_of_different_names_hear_nothing_of_each_other() -> None:
    mesh = VirtualMesh(4)
    one = Band(HERE[:2], tasks(6), 4, "lab", mesh)
    other = Band(HERE[:2], tasks(6), 4, "yard", mesh)
    mesh.run(JOINED_S)
    one.give("lab/r1")
    assert one.run(300.0)
    assert other.fleet("yard/r1").work is None


def test_a_task_to_which_one_robot_has_no_way_is_anothers() -> None:
    band = Band(HERE[:2], tasks(6), 5)
    far = band.tasks[2].goal
    band.mesh.run(JOINED_S)
    band.puppet("f/r1").unreachable.add((far.x, far.y))
    band.give("f/r1")
    assert band.run(400.0)
    assert band.doers[2] == {"r2"}


def test_a_list_is_over_when_all_have_given_up_what_is_left_and_another_is_taken_on() -> None:
    band = at_work(2)
    place = band.tasks[2].goal
    for name in band.names:
        band.puppet(name).unreachable.add((place.x, place.y))
    heard = lines(band, "f/r2")
    band.mesh.run(400.0, lambda: len(band.doers) == 8)
    band.give("f/r1")
    band.mesh.run(band.mesh.now + 1.0)
    assert band.reply is not None
    assert "of which 1 are not done" in band.reply.refusal, "it is tried some times"
    band.mesh.run(band.mesh.now + 200.0)
    assert "the list is over: no robot reaches 2" in heard
    assert len([text for text in heard if text.startswith("task 2 is given back")]) == TRIES
    band.give("f/r1")
    band.mesh.run(band.mesh.now + 3.0)
    assert not band.reply.refusal
    assert len(band.doers) == 0, "by both"


def test_what_one_robot_has_not_tried_is_waited_for_until_it_can() -> None:
    band = at_work(2)
    place = band.tasks[2].goal
    band.puppet("f/r1").unreachable.add((place.x, place.y))
    band.mesh.publish(Stop(1, True, "tester", 1), namespace="f/r2")
    heard = lines(band, "f/r1")
    band.mesh.run(600.0)
    assert len([text for text in heard if text.startswith("task 2 is given back")]) > TRIES
    assert not [text for text in heard if "the list is over" in text]
    assert len(band.doers) == 8
    band.mesh.publish(Stop(2, False, "tester", 1), namespace="f/r2")
    assert band.run(100.0)
    assert band.doers[2] == {"r2"}


def test_a_robot_that_is_stopped_gives_its_tasks_back_and_takes_some_again() -> None:
    band = at_work(2)
    band.mesh.run(20.0)
    band.mesh.publish(Stop(1, True, "tester", 1), namespace="f/r1")
    band.mesh.run(24.0)
    sharing = band.sharing("f/r1")
    assert not sharing.mine
    band.mesh.publish(Stop(2, False, "tester", 1), namespace="f/r1")
    band.mesh.run(27.0)
    assert sharing.mine


def test_a_robot_that_somebody_sends_elsewhere_gives_its_tasks_back() -> None:
    band = at_work(2)
    band.mesh.run(20.0)
    sharing = band.sharing("f/r1")
    away = MissionRequest(Waypoint(30.0, 30.0, 0.0))
    band.mesh.query(away, lambda _: None, namespace="f/r1")
    band.mesh.run(24.0)
    assert not sharing.mine
    assert band.run(600.0)
    assert once(band, 9)


@pytest.mark.parametrize("waits", [True, False])
def test_a_robot_that_waits_before_a_passage_keeps_its_task_and_one_that_is_stuck_does_not(
    waits: bool,
) -> None:
    band = at_work(1, 2)
    heard = lines(band, "f/r1")
    band.puppet("f/r1").blocked = True
    for _ in range(20):
        said = FleetPassages("r1", "giveway-1", Cycle(1, 1), waits=waits)
        band.mesh.publish(said, key="fleet/r1/passages", namespace="f/r1")
        band.mesh.run(band.mesh.now + 2.0)
    assert any("no nearer for 30 s" in text for text in heard) != waits


def test_talk_does_not_grow_with_the_tasks() -> None:
    def said(count: int) -> int:
        band = at_work(3, count)
        band.mesh.run(band.mesh.now + 20.0)  # by then all are held
        band.published = 0
        band.mesh.run(band.mesh.now + 20.0)
        return band.published

    assert said(40) <= said(12) + 10


@pytest.mark.parametrize("seed", range(3))
def test_nothing_is_done_twice_or_lost_where_a_third_of_all_messages_are(seed: int) -> None:
    band = at_work(3, 9, seed)
    names = [f"{name}/fleet" for name in band.names]
    for a in names:
        for b in names:
            if a != b:
                band.mesh.link(a, b).faults = LinkFaults(loss=0.3)
    assert band.run(600.0)
    assert once(band, 9)
