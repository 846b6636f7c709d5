"""The rules as they are: a small part of all runs, and the tools that go through them."""

from __future__ import annotations

import json

import pytest

from armadico.cli.options import INTERRUPTED, UNKNOWN, UsageError
from armadico_tools.commands import model_check
from armadico_tools.explore.identity import key
from armadico_tools.explore.picks import Enumerator, Script
from armadico_tools.explore.recovery import Graph, Never
from armadico_tools.explore.replay import Run, replay
from armadico_tools.explore.search import Limits, Search
from armadico_tools.explore.world import Setup, World
from tests.core.joiners import Joiners, Joining


@pytest.mark.long(but=("setup2",))
@pytest.mark.parametrize(
    "setup",
    [
        Setup(("0.6", "0.5"), kinds=("crash", "owner", "stop")),
        Setup(("0.5", "0.53"), kinds=("bids", "rise")),
        Setup(("0.6", "0.5"), kinds=("hang",)),
        Setup(("0.6", "0.5"), kinds=("fates",)),
        Setup(("0.6", "0.5", "0.5"), kinds=("crash",)),
    ],
)
def test_one_fault_breaks_no_promise(setup: Setup) -> None:
    found = Search(setup, Limits(faults=1)).run()
    assert found.broken == []
    assert found.closed, "every run of any length"
    assert found.states > 100
    assert found.starved <= 7
    assert found.unsettled <= 12


@pytest.mark.parametrize("backwards", [False, True])
def test_of_two_that_may_not_both_stay_one_does(backwards: bool) -> None:
    """All runs of the admission with at most two delays or cuts."""
    picker, runs = Enumerator(2), 0
    while True:
        picker.begin()
        assert not Joiners(Joining(2, backwards), picker).run(), picker.step
        runs += 1
        if not picker.advance():
            break
    assert runs > 300


def test_a_world_is_the_same_whenever_it_happens() -> None:
    world = World(Setup(("0.6", "0.5")))
    keys = []
    for _ in range(40):
        world.step(Script({}))
        keys.append(key(world))
    assert len(set(keys[25:])) == 1, "nothing new comes of a holder that goes on"
    assert len(set(keys)) > 5


def test_every_way_is_picked_once_and_none_too_dear() -> None:
    picker = Enumerator(1)
    seen = set()
    while True:
        picker.begin()
        one = picker.pick("x", ("a", "b", "c"), 1)
        two = picker.pick("y", ("a", "b"), 1)
        free = picker.pick("z", ("a", "b"), 0)
        seen.add((one, two, free))
        if not picker.advance():
            break
    ways = {("a", "a"), ("b", "a"), ("c", "a"), ("a", "b")}
    assert seen == {(*way, free) for way in ways for free in "ab"}


def test_a_holder_deposed_just_before_its_release_does_not_return_at_once() -> None:
    """b receives each cycle 8 ms before a, from which the owner receives nothing."""
    setup = Setup(("0.6", "0.5"), stagger=(8, 0), kinds=("cut",), lasts=(None,))
    world, obeyed = World(setup), 0
    for n in range(1, 108):
        world.step(Script({5: {"event": "cut a>owner ever"}}.get(n, {})))
        obeyed += world.obeyed_now
    assert obeyed > 80
    found = Search(setup, Limits(faults=1)).run()
    assert found.broken == []
    assert found.closed


def test_what_cannot_happen_is_not_replayed() -> None:
    with pytest.raises(ValueError, match="nothing of the kind"):
        replay(Run(Setup(("-", "-")), {1: {"claim a>b": "lost"}}))
    with pytest.raises(ValueError, match="none of"):
        replay(Run(Setup(("-", "-")), {1: {"ack>a": "eaten"}}))


def test_an_endless_loop_is_distinguished_from_an_end() -> None:
    ends = Graph([(1,), (2,), (2,)])
    assert ends.longest([True, True, False]) == 2
    assert ends.settles_within([True] * 3, [False, True, False]) == 2
    round_and_round = Graph([(1,), (2,), (1,)])
    with pytest.raises(Never) as never:
        round_and_round.longest([False, True, True])
    assert sorted(never.value.loop) == [1, 2]
    with pytest.raises(Never):
        round_and_round.settles_within([True] * 3, [False, False, True])


def test_mostly_bad_loops_are_distinguished_from_seldom_bad_ones() -> None:
    seldom = Graph([(1,), (2,), (3,), (0,)])
    seldom.mostly_good([True, False, False, False], 3)
    seldom.mostly_good([True, True, True, False], 1)
    with pytest.raises(Never) as never:
        seldom.mostly_good([True, False, False, False], 5)
    assert sorted(never.value.loop) == [0, 1, 2, 3]
    a_shorter_way = Graph([(1,), (2, 0), (3,), (0,), (0,)])
    with pytest.raises(Never) as never:
        a_shorter_way.mostly_good([True, False, False, False, True], 3)
    assert sorted(never.value.loop) == [0, 1]


def test_the_command_counts_states(capsys: pytest.CaptureFixture[str]) -> None:
    assert model_check.main(["--faults", "0", "--jobs", "1", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["counterexamples"] == []
    assert printed["closed"]
    assert printed["states"] > 100
    assert printed["judgement"]["answer"] == "yes"


def test_runs_that_were_left_out_are_no_kept_promise(capsys: pytest.CaptureFixture[str]) -> None:
    cut = ["--faults", "0", "--cycles", "1", "--jobs", "1"]
    assert model_check.main([*cut, "--json"]) == UNKNOWN
    printed = json.loads(capsys.readouterr().out)
    assert printed["starved_cycles"] is printed["unsettled_cycles"] is None
    assert printed["judgement"]["answer"] == "unknown"
    assert model_check.main(cut) == UNKNOWN
    assert "no promise was broken" not in capsys.readouterr().out


def test_what_was_interrupted_claims_nothing(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(model_check, "_explored", interrupt)
    assert model_check.main(["--jobs", "1"]) == INTERRUPTED
    printed = capsys.readouterr()
    assert "no promise" not in printed.out
    assert "interrupted after 0 of 11" in printed.err


@pytest.mark.parametrize("arguments", [["--kind", "flood"], ["--faults", "-1"]])
def test_the_command_refuses_what_makes_no_sense(arguments: list[str]) -> None:
    with pytest.raises(UsageError):
        model_check.main(arguments)
