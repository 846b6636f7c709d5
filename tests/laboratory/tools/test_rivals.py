"""The rivals study: its worlds, and its verdicts on made-up results whose truth is known."""

from __future__ import annotations

from pathlib import Path
from random import Random

import pytest
from msgspec.structs import replace

from armadico.cli.options import UsageError
from armadico.core.messages import BALLOTS
from armadico_tools.commands.experiment import main
from armadico_tools.experiments import Rivals, rivals
from armadico_tools.experiments.driving import Cell, Sample, drive, scenario_of
from armadico_tools.experiments.rivals import (
    Contrast,
    arms,
    cell,
    contrasts,
    pooled,
)
from armadico_tools.experiments.runner import Context

WORLDS = 400


def drawn(name: str, clean: float, factor: float, worlds: int = WORLDS) -> list[Sample]:
    """Made-up runs: a share of them clean, their times those of the world times a factor."""
    rng, world = Random(name), Random("worlds")
    found = []
    for seed in range(worlds):
        tt_s, good = world.uniform(25.0, 45.0) * factor, rng.random() < clean
        tt_s *= rng.uniform(0.95, 1.05)
        found.append(
            Sample(name, seed, good, good, 9.0, 1.0, tt_s, 99.0, 5, collisions=int(not good))
        )
    return found


def verdicts(**of: tuple[float, float]) -> dict[str, Contrast]:
    by_arm = {BALLOTS: drawn(BALLOTS, 0.9, 1.0)}
    by_arm |= {name: drawn(name, *numbers) for name, numbers in of.items()}
    return {one.mechanism: one for one in contrasts(by_arm)}


def test_the_verdicts_are_those_of_the_truth() -> None:
    found = verdicts(worse=(0.7, 1.0), fast=(0.9, 0.9), slow=(0.98, 1.1), alike=(0.93, 1.0))
    assert {name: one.verdict for name, one in found.items()} == {
        "worse": "worse, as fast",
        "fast": "not worse, faster",
        "slow": "better, slower",
        "alike": "not worse, as fast",
    }


def test_few_worlds_decide_nothing() -> None:
    for worlds, verdict in ((29, "too few worlds"), (40, "undecided")):
        by_arm = {BALLOTS: drawn("a", 0.9, 1.0, worlds), "it": drawn("b", 0.85, 1.0, worlds)}
        (one,) = contrasts(by_arm)
        assert one.verdict.startswith(verdict)


@pytest.mark.parametrize(
    ("worlds", "pilot", "told"), [(29, False, 1), (29, True, 0), (40, False, 0)]
)
def test_a_study_without_a_verdict_says_so(
    worlds: int, pilot: bool, told: int, tmp_path: Path
) -> None:
    chosen = Rivals(
        mechanism=("auction",), situation=("people",), behaviours=("default",), pilot=pilot
    )
    context = Context(out=tmp_path, runs=worlds, rivals=chosen)
    runs = [
        replace(one, cell=cell("people", "default", Cell(name)).name, contested_percent=50.0)
        for name in (BALLOTS, "auction")
        for one in drawn(name, 0.8, 1.0, worlds)
    ]
    context.found = {"worlds": runs[:worlds], "runs": runs, "alone": [], "kills": []}
    context.found["contenders"] = []
    rivals.report(context)
    assert sum("No verdict" in text for text in context.lacking) == told


def test_the_p_values_are_corrected_for_the_mechanisms_of_a_table() -> None:
    alone, among = verdicts(it=(0.84, 1.0)), verdicts(it=(0.84, 1.0), a=(0.9, 1.0), b=(0.9, 1.0))
    assert alone["it"].p_corrected == alone["it"].p == among["it"].p
    assert among["it"].p_corrected == pytest.approx(3 * among["it"].p)


def test_a_mechanism_is_compared_in_the_same_worlds() -> None:
    found = [
        replace(one, cell=cell(situation, "default", Cell(name)).name)
        for name in (BALLOTS, "it")
        for situation in ("slalom", "clutter")
        for one in drawn(f"{name} {situation}", 0.8, 1.0, 10)
    ]
    of = pooled(found, [BALLOTS, "it"], ["slalom", "clutter"], "default")
    assert [one.seed for one in of["it"]] == [one.seed for one in of[BALLOTS]] == [*range(10)] * 2


def aimed(situation: str, seed: int, *sets: str, mechanism: str | None = None) -> Sample:
    """One run of a situation of the second plan."""
    of = cell(situation, "default", Cell(mechanism or BALLOTS, coordination=mechanism))
    return drive((replace(of, sets=(*of.sets, *sets)), seed))


@pytest.mark.parametrize("mechanism", [None, "priority"])
def test_a_place_beside_the_way_is_visited_and_the_goal_is_reached(mechanism: str | None) -> None:
    sample = aimed("two-goals", 1, mechanism=mechanism)
    assert (sample.reached, sample.visited, sample.clean) == (True, True, True)


def test_the_goal_alone_is_not_clean() -> None:
    blind = aimed("two-goals", 1, "visit.u_high_m=0.3", "visit.u_low_m=0.1")
    assert (blind.reached, blind.collisions, blind.visited, blind.clean) == (True, 0, False, False)


def test_a_battery_is_charged_on_the_way() -> None:
    sample = aimed("battery", 1)
    assert sample.clean
    assert sample.least_charge is not None
    assert sample.least_charge > 0.0


def test_an_empty_battery_ends_a_run_and_is_not_clean() -> None:
    sample = aimed("battery", 1, "recharge.below=0.01", "recharge.urgent=0.0")
    assert (sample.least_charge, sample.note) == (0.0, "the battery is empty")
    assert not sample.clean
    assert not replace(sample, reached=True, collisions=0).clean


@pytest.mark.parametrize("situation", ["two-goals", "battery"])
def test_a_mechanism_that_names_agents_names_the_one_with_a_goal_of_its_own(situation: str) -> None:
    named = {}
    for name, arm in arms(Rivals()).items():
        of = cell(situation, "default", arm)
        scenario_of(of)  # each setting is one of its arbiter's
        named[name] = any(f'"{of.besides[-1]}"' in text for text in of.sets)
    assert {name for name, it in named.items() if it} >= {
        *("aria", "priority", "sequencing", "subsumption", "twist-mux"),
    }
    assert not any(named[name] for name in (BALLOTS, "auction", "mean"))


def test_a_mechanism_without_its_library_is_named_and_refused_where_it_was_chosen(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("armadico.core.mechanisms.find_spec", lambda _: None)
    assert {*rivals.left_out(Rivals())} == {"arbitration-graph", "behaviour-tree"}
    assert not {"arbitration-graph", "behaviour-tree"} & {*arms(Rivals())}
    assert not rivals.left_out(Rivals(mechanism=("auction",)))
    context = Context(out=tmp_path, rivals=Rivals(situation=("people",), behaviours=("default",)))
    context.found = {part.name: [] for part in rivals.RIVALS.parts}
    rivals.report(context)
    for name in rivals.left_out(Rivals()):
        assert any(f"Not compared: {name}; " in text for text in context.lacking)
    with pytest.raises(UsageError, match=r"behaviour-tree: .*armadico\[rivals\]"):
        arms(Rivals(mechanism=("behaviour-tree",)))


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["rivals", "--mechanism", "auktion"], "auktion.*auction"),
        (["table-5.1", "--yardstick", "dwa"], "rivals only"),
        (["table-5.1", "--pilot"], "rivals only"),
    ],
)
def test_wrong_choices_are_refused(words: list[str], expected: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=expected):
        main([*words, "--out", str(tmp_path / "results")])


@pytest.mark.long
@pytest.mark.timeout(300)
def test_a_small_study_fills_its_tables(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rivals, "BIDDERS", (3, 6))
    words = ["--situation", "clutter", "--behaviours", "thesis", "--mechanism", "auction"]
    words += ["--yardstick", "pure-pursuit"]
    out = ["--pilot", "--runs", "1", "--jobs", "1", "--out", str(tmp_path)]
    assert main(["rivals", *words, *out]) == 0
    text = (tmp_path / "rivals-pilot" / "table.md").read_text(encoding="utf-8")
    for begins in ("| clutter thesis | 2 | ", "| auction | 1 | ", "| auction | two | 1 of 1 | "):
        assert begins in text
    assert "| clutter | thesis | pure-pursuit | 1 | " in text
    assert text.count("## ") == 6
