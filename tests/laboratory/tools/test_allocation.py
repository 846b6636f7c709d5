"""The experiment on tasks between robots: what is drawn is the same for all, and kills matter."""

from __future__ import annotations

from armadico_tools.experiments.allocation import (
    ARBITER,
    BOTH,
    KILLS,
    MECHANISMS,
    NONE,
    ROBOT,
    SPARE,
    Puppets,
    Task,
    share,
    tasks,
)


def test_a_seed_draws_the_same_situation_for_all_mechanisms() -> None:
    drawn = [Puppets(Task(name, ROBOT, 3)) for name in MECHANISMS]
    assert len({(*each.places, each.killed, each.at) for each in drawn}) == 1
    assert Puppets(Task("ballots", ROBOT, 4)).places != drawn[0].places


def test_a_mechanism_without_an_arbiter_loses_none() -> None:
    found = {(each.killed, each.mechanism) for each in tasks([1], KILLS)}
    assert (NONE, "alliance") in found
    assert (ARBITER, "contract-net") in found
    assert (ARBITER, "ballots") not in found


def test_contracts_are_lost_with_the_manager_and_a_robot_and_kept_with_one_of_them() -> None:
    kills = (ROBOT, ARBITER, BOTH, SPARE)
    done = {killed: share(Task("contract-net", killed, 1003)).done for killed in kills}
    assert done == {ROBOT: 12, ARBITER: 12, BOTH: done[BOTH], SPARE: 12}
    assert done[BOTH] < 12
