"""A fleet that others have started: it is found, given a list, watched, and left in order."""

from __future__ import annotations

from collections.abc import Callable
from random import Random

import pytest

from armadico.agents.fleet.commands.attached_fleet import AttachedFleet
from armadico.agents.fleet.commands.view import FleetResult, FleetWatch
from armadico.config.scenarios import Scenario
from armadico.core.judgement import Answer
from armadico.core.messages import Stop
from armadico.launch.society import Options
from armadico.launch.virtual_session import VirtualSession
from armadico.runtime.errors import MissionRefusedError, RunFailedError
from tests.fleet.band import Band

HERE = ((1.0, 0.0), (3.0, 0.0), (5.0, 0.0))
SEEDS = Random(1)
LIST = Scenario(
    name="list",
    world="empty",
    start=(0.0, 0.0, 0.0),
    tasks=tuple((SEEDS.uniform(0, 6), SEEDS.uniform(0, 6), 0.0) for _ in range(6)),
    look_s=2.0,
)


def all_done(result: FleetResult) -> bool:
    """Whether all tasks are done once; these robots have no simulator, so the run is unknown."""
    return result.done == result.tasks and not result.twice


class Attached:
    """Such a run beside robots that drive straight, and what it says."""

    def __init__(self, robots: int = 2, wanted: int | None = None, limit: float = 300.0) -> None:
        self.band = Band(HERE[:robots], (), seed=1)
        self.said: list[str] = []
        self.fleet = AttachedFleet(LIST, Options(limit=limit), wanted, "f", self._join)
        self.fleet.report_to(self.said.append)

    def run(self, at: float = 0.0, then: Callable[[], object] = lambda: None) -> FleetResult:
        """To its end; `then` happens once the list has been worked on for so long, s."""
        waiting = [then]

        def progress(watch: FleetWatch) -> None:
            if waiting and watch.began is not None and watch.now >= watch.began + at:
                waiting.pop()()

        with self.fleet:
            return self.fleet.run(progress)

    def heard(self, *words: str) -> bool:
        return any(all(word in line for word in words) for line in self.said)

    def stop(self, name: str, *, stopped: bool = True, count: int = 1) -> None:
        known = self.band.fleet(name).stopped
        press = known.press if known is not None and not stopped else 1
        stop = Stop(count + (not stopped), stopped, "tester", press)
        self.band.mesh.publish(stop, namespace=name)

    def stopped(self) -> list[str]:
        return [name for name in self.band.names if self.band.fleet(name).stopped is not None]

    def _join(self, namespace: str) -> VirtualSession:
        return VirtualSession(self.band.mesh, namespace)


def test_those_who_are_there_are_found_and_do_the_list() -> None:
    attached = Attached(robots=3)
    result = attached.run()
    assert all_done(result), result.verdict
    assert [row.robot for row in result.robots] == ["r1", "r2", "r3"]
    assert sorted(task for row in result.robots for task in row.tasks) == list(range(6))
    assert not attached.stopped()
    assert not attached.said


def test_of_robots_without_a_simulator_the_way_is_told_by_their_poses_and_no_contacts() -> None:
    result = Attached(robots=1).run()
    (row,) = result.robots
    assert row.collisions is row.bumped is row.min_clearance_m is None
    assert row.way_m > 10.0
    assert "collisions unknown" in result.verdict
    assert result.judgement.answer is Answer.UNKNOWN
    assert "r1's collisions: unknown, no truth" in result.judgement.reason


def test_a_robot_that_dies_is_named_and_the_others_do_its_tasks() -> None:
    attached = Attached()
    result = attached.run(10.0, lambda: attached.band.kill("f/r1"))
    assert all_done(result), result.verdict
    assert attached.heard("f/r1: its fleet agent is silent; other robots take its tasks")
    assert not attached.heard("f/r2")


def test_one_that_is_back_is_said_too() -> None:
    attached = Attached()
    again = [lambda: attached.band.start_agent("f/r1"), lambda: attached.band.kill_agent("f/r1")]
    at = [20.0, 10.0]

    def progress(watch: FleetWatch) -> None:
        if at and watch.began is not None and watch.now >= watch.began + at[-1]:
            at.pop()
            again.pop()()

    with attached.fleet as fleet:
        assert all_done(fleet.run(progress))
    assert attached.heard("f/r1: its fleet agent is back")


def test_who_comes_late_takes_part_and_is_in_the_table() -> None:
    attached = Attached(robots=1)
    result = attached.run(5.0, lambda: attached.band.enter("f/r7", (6.0, 6.0)))
    assert all_done(result), result.verdict
    assert attached.heard("f/r7: has come")
    assert {row.robot: bool(row.tasks) for row in result.robots} == {"r1": True, "r7": True}


def test_so_many_as_are_asked_for_are_waited_for() -> None:
    attached = Attached(robots=2, wanted=3)
    with pytest.raises(RunFailedError, match=r"f/r1, f/r2 of the fleet .* 3 or more"):
        attached.run()
    assert attached.heard("waiting for 3 or more robots")


def test_a_run_that_ends_early_leaves_the_robots_stopped_and_says_that_the_list_goes_on() -> None:
    attached = Attached(limit=20.0)
    result = attached.run()
    assert not result.passed
    assert result.limit_s == 20.0
    assert attached.stopped() == ["f/r1", "f/r2"]
    left = result.tasks - result.done
    assert 0 < left < result.tasks
    assert attached.heard("stopped: f/r1, f/r2; `armadico resume --namespace f/r1` releases one")
    assert attached.heard(f"remembers the list, of which {left} are not done")


def test_whatever_ends_it_stops_the_robots() -> None:
    attached = Attached()

    def interrupt() -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        attached.run(5.0, interrupt)
    assert attached.stopped() == ["f/r1", "f/r2"]


def test_what_nobody_gets_to_is_named_and_the_run_is_over() -> None:
    attached = Attached(limit=600.0)
    x, y, _ = LIST.tasks[3]
    for name in attached.band.names:
        attached.band.puppet(name).unreachable.add((x, y))
    result = attached.run()
    assert result.unreachable == (3,)
    assert result.done == result.tasks - 1
    assert not result.passed
    assert result.limit_s is None, "it did not go on until its limit"
    assert "no robot reaches 3" in result.verdict
    assert not attached.stopped(), "there is nothing left to do"


def test_all_that_die_end_it_and_nothing_is_said_to_be_stopped() -> None:
    attached = Attached()

    def all_die() -> None:
        attached.band.kill("f/r1")
        attached.band.kill("f/r2")

    with pytest.raises(RunFailedError, match="no robot of the fleet 'f' has published for 10 s"):
        attached.run(10.0, all_die)
    assert attached.heard("f/r1: the stop was sent, not acknowledged", "--namespace f/r1")
    assert not attached.heard("stopped: ")


def test_a_robot_that_is_stopped_is_named_and_the_other_does_everything() -> None:
    attached = Attached()
    attached.stop("f/r1")
    result = attached.run()
    assert all_done(result), result.verdict
    assert attached.heard("f/r1: stopped by tester; until that is over it takes no task")
    assert {row.robot: len(row.tasks) for row in result.robots} == {"r1": 0, "r2": 6}


def test_nothing_is_given_to_a_fleet_that_is_stopped() -> None:
    attached = Attached()
    attached.stop("f/r1")
    attached.stop("f/r2")
    with pytest.raises(RunFailedError, match=r"no robot of the fleet 'f' can take a task;.*resume"):
        attached.run()
    assert attached.band.mesh.now < 10.0, "at once"
    attached.stop("f/r1", stopped=False)
    attached.band.mesh.run(attached.band.mesh.now + 5.0)
    assert attached.band.fleet("f/r1").work is None, "there is no list"


def test_a_fleet_that_works_on_a_list_refuses_and_is_left_to_it() -> None:
    attached = Attached()
    other = AttachedFleet(LIST, Options(), None, "f", attached._join)

    def again() -> None:
        with other, pytest.raises(MissionRefusedError, match=r"of which 6 .*; --replace gives it"):
            other.run()

    assert all_done(attached.run(1.0, again))


def test_a_list_that_was_left_is_replaced_if_that_is_asked_for() -> None:
    attached = Attached(limit=20.0)
    assert not all_done(attached.run())
    for name in attached.band.names:
        attached.stop(name, stopped=False, count=1000)
    again = AttachedFleet(LIST, Options(limit=300.0), None, "f", attached._join, replace=True)
    with again:
        result = again.run()
    assert all_done(result), result.verdict
