"""Several whole societies on one virtual mesh, their robots in one world."""

from __future__ import annotations

from typing import Any

import pytest
from msgspec.structs import replace

from armadico.agents.fleet.commands.run import FleetRehearsal, robots_of
from armadico.agents.fleet.commands.view import FleetResult, FleetWatch
from armadico.agents.fleet.messages import FleetStatus
from armadico.config.scenarios import Scenario, load_scenario
from armadico.core.config_errors import ConfigError
from armadico.core.messages import Cycle, Proposal
from armadico.core.resources import WHEELS
from armadico.launch.society import Options
from armadico.mobile.messages import FleetProposals
from armadico.observe.contention import Contention

FLEET = load_scenario("fleet")
SHORT = replace(FLEET, tasks=FLEET.tasks[:1] + FLEET.tasks[9:11], look_s=2.0)


def run(scenario: Scenario, robots: int, seed: int, **options: Any) -> FleetResult:
    return FleetRehearsal(scenario, Options(seed=seed, **options), robots).run()


def test_two_robots_share_the_tasks_and_touch_nothing() -> None:
    result = run(SHORT, 2, 1)
    assert result.passed, result.verdict
    assert all(row.tasks for row in result.robots)
    assert all(row.way_m > 3.0 for row in result.robots)


def test_a_mechanism_for_tasks_that_only_one_robot_wants_has_nothing_to_decide() -> None:
    class Central:
        arbiter, resource = "central", "task-"

        def contender(self, *_: Any) -> None:
            return None

    watch = FleetWatch("fleet", ("r1", "r2"), 1)
    watch.contention = Contention({"central": Central()})
    assert "not known" in watch.result().undecided
    for robot, contended in (("r1", 0), ("r2", 1)):
        for instance in (f"fleet-{robot}a", f"fleet-{robot}b"):  # a redundant robot's are no rivals
            asked = (Proposal("task-0", Cycle(1, 1), instance, 0.5),)
            watch.update(robot, FleetProposals(robot, instance, Cycle(1, 1), asked), 1.0)
        assert watch.result().contended == contended
        assert bool(watch.result().undecided) is not bool(contended)


def test_the_bids_that_the_agents_of_a_fleet_keep_are_read_at_its_end() -> None:
    class Made:
        arbiter, resource = "judge", WHEELS

        def contender(self, *_: Any) -> None:
            return None

    fleet = FleetRehearsal(SHORT, Options(limit=1.0), 2)
    fleet.watch.contention = Contention({"made": Made()})
    for rehearsal in fleet.robots.values():
        rehearsal.watch.contention = fleet.watch.contention
    assert fleet.run().contended is not None


@pytest.mark.long
def test_the_same_seed_is_the_same_run() -> None:
    one, other = (run(SHORT, 2, 5, limit=20.0) for _ in range(2))
    assert all(row.way_m > 1.0 for row in one.robots), "both are on their way"
    assert one == other
    assert run(SHORT, 2, 6, limit=20.0) != one


def test_a_robot_that_has_fallen_silent_is_not_said_to_hold_anything() -> None:
    watch = FleetWatch("fleet", ("r1", "r2"), 3)
    watch.update("r1", FleetStatus(1, 3, 0, (0,)), 1.0)
    watch.update("r2", FleetStatus(1, 3, 0, (1, 2)), 1.0)
    assert watch.remark == "0 of 3 done; held: r1 1, r2 2"
    watch.update("r1", FleetStatus(1, 3, 0, (0,)), 7.0)
    assert watch.remark == "0 of 3 done; held: r1 1, r2 silent"


@pytest.mark.long
def test_a_robot_that_dies_on_the_way_stands_there_and_the_others_do_its_tasks() -> None:
    fleet = FleetRehearsal(SHORT, Options(seed=2), 2)
    dies, lives = fleet.names

    def kill(_: FleetWatch) -> None:
        holds = fleet.watch.status.get("r1")
        if holds is not None and holds.holds and fleet.mesh.now > 12.0:
            fleet.kill(dies)

    result = fleet.run(kill)
    assert result.done == result.tasks, result.verdict
    assert not result.twice
    assert not any(node.alive for node in fleet.mesh.nodes if node.namespace == dies)
    assert any(node.alive for node in fleet.mesh.nodes if node.namespace == lives)


def test_a_robot_hears_nothing_of_anothers_own() -> None:
    fleet = FleetRehearsal(SHORT, Options(seed=3), 2)
    fleet.mesh.run(5.0)
    one, other = (fleet.mesh.node("goto", name).agent for name in fleet.names)
    assert one.cycles.newest is not None
    assert other.cycles.newest is not None
    assert one.cycles.newest.epoch != other.cycles.newest.epoch


@pytest.mark.parametrize("count", [0, 11])
def test_as_many_robots_as_there_are_starts(count: int) -> None:
    with pytest.raises(ConfigError, match=f"{count} robots: fleet has starts for 1 to 10"):
        robots_of(FLEET, count)


def test_a_fleet_needs_tasks_and_robots_stand_beside_each_other() -> None:
    with pytest.raises(ConfigError, match="has no tasks"):
        robots_of(load_scenario("sc1"), 1)
    crowded = replace(FLEET, others=((1.6, 1.5, 0.0),))
    with pytest.raises(ConfigError, match=r"cannot start at 1\.\d, 1\.5"):
        FleetRehearsal(crowded, Options(), 2)
