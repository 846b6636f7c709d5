"""Learning: it finds what is better, says what is not shown, and refuses what can show nothing."""

from __future__ import annotations

from collections.abc import Sequence
from math import log
from pathlib import Path
from random import Random

import pytest

from armadico.cli.options import UsageError
from armadico.config.parameters import load_set
from armadico_tools.campaign import learn, utilities
from armadico_tools.campaign.learn import GENERATIONS, Dimension, Search, Task, size_of, toml_of
from armadico_tools.campaign.learn_command import main
from armadico_tools.campaign.utilities import Episode
from armadico_tools.experiments.driving import Cell, Sample

TWO = [Dimension("goto", "p_min", 1.0, 0.0, 10.0), Dimension("goto", "p_max", 2.0, 0.0, 10.0)]


class Made:
    """Drives nothing: the time has its least at two values, with noise of the world."""

    def __init__(self, best: Sequence[float] = (1.6, 1.4), effect: float = 1.0) -> None:
        self.best, self.effect, self.seen = best, effect, list[Task]()

    def __call__(self, tasks: Sequence[Task]) -> list[Sample]:
        self.seen += tasks
        return [self._one(*task) for task in tasks]

    def _one(self, cell: Cell, seed: int) -> Sample:
        values = [float(each.partition("=")[2]) for each in cell.sets] or [1.0, 2.0]
        off = sum(log(value / best) ** 2 for value, best in zip(values, self.best, strict=True))
        tt_s = 30.0 * (1.0 + self.effect * off) * Random(seed).uniform(0.8, 1.2)
        return Sample(cell.name, seed, True, True, 9.0, 0.0, tt_s, 99.0, 0, collisions=0)


def search(made: Made, runs: int = 900) -> Search:
    size = size_of(len(TWO), runs)
    return Search(Cell("first"), ("clutter", "slalom"), TWO, size, made)


def test_the_better_values_are_found_and_shown_in_unseen_worlds() -> None:
    made = Made()
    one = search(made)
    learnt = one.run()
    searched = {seed for _, seed in made.seen}
    values = [float(each.partition("=")[2]) for each in learnt]
    assert values == pytest.approx([1.6, 1.4], rel=0.2)
    result, samples = one.test(learnt)
    assert result.verdict == "better"
    assert result.ratio is not None
    assert result.ratio < 0.85
    assert not searched & {sample.seed for sample in samples}
    assert len(made.seen) <= one.size.runs


def test_utilities_are_compared_with_the_agents_own_by_ballots() -> None:
    """Without weights `learned` is refused, so the first set is driven by ballots."""
    size = size_of(0, 0)
    base, first = Cell("first", coordination="learned"), Cell("first")
    one = Search(base, ("clutter",), [], size, Made(), first=first)
    weights = ("goto.social.utility=[1.0]",)
    assert [one.task(sets, 0)[0].coordination for sets in ((), weights)] == [None, "learned"]


@pytest.mark.long
def test_the_same_search_is_the_same_again_and_another_seed_is_another() -> None:
    one, again, other = search(Made()), search(Made()), search(Made())
    other.seed = 1
    assert one.run() == again.run() != other.run()
    assert one.history == again.history


def test_candidates_drive_the_same_worlds_and_those_that_are_behind_are_left_out() -> None:
    made = Made()
    one = search(made)
    one.run()
    first = [step for step in one.history if step.generation == 0]
    worlds: dict[str, set[int]] = {}
    for cell, seed in made.seen:
        worlds.setdefault(" ".join(cell.sets), set()).add(seed)
    driven = [worlds[step.sets] for step in first]
    assert all(a <= b or b <= a for a in driven for b in driven)
    counts = {step.worlds for step in first}
    assert min(counts) < max(counts)
    assert one.history[-1].generation + 1 >= GENERATIONS


def test_values_that_matter_nothing_are_no_improvement() -> None:
    one = search(Made(effect=0.0))
    result, _ = one.test(one.run())
    assert result.verdict == "undecided"
    assert result.better is None


def test_the_least_budget_is_enough_for_its_generations_however_even_the_race_is() -> None:
    one = search(Made(effect=0.0), size_of(len(TWO), 0).least)
    one.run()
    assert one.history[-1].generation + 1 >= GENERATIONS


def test_only_numbers_with_declared_bounds_are_learnt_from_where_the_set_begins() -> None:
    found = {one.name: one for one in learn.dimensions(["gothrough"], (), {})}
    assert {"u_low_m", "clear_m"} <= {*found}
    assert not {"controller", "rules", "v_max"} & {*found}
    assert found["u_low_m"].value(0.5) == found["u_low_m"].begins == 0.5
    assert found["u_low_m"].value(1.0) == 2.0
    begun = learn.dimensions(["gothrough"], ("gothrough.clear_m",), {"gothrough": ("clear_m=0.4",)})
    assert [one.begins for one in begun] == [0.4]
    assert Dimension("x", "y", 4.0, 0.0, 5.0).value(1.0) == 5.0


def test_a_learnt_set_is_a_file_of_parameters(tmp_path: Path) -> None:
    file = tmp_path / "learnt.toml"
    sets = ("gothrough.u_low_m=0.61", "gothrough.clear_m=0.4", "avoid.v_top=0.7")
    file.write_text(toml_of(sets, ["why"]), encoding="utf-8")
    assert load_set(file) == {"gothrough": ("u_low_m=0.61", "clear_m=0.4"), "avoid": ("v_top=0.7",)}


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["goto", "--budget", "100runs"], r"100runs is too small.*10 numbers.*--budget \d{3}runs"),
        (["goto", "--only", "goto.p"], "goto.p.*goto.p_m"),
        (["goti"], "'goti'.*goto"),
        (["goto", "--world", "maze"], "'maze'.*clutter"),
        (["auction"], "'auction'.*avoid"),
        (["goto", "--utilities", "--only", "goto.p_min"], "leave out --only"),
        (["goto", "--utilities", "--budget", "50runs"], r"50runs is too.*utilities.*\d{3}runs$"),
    ],
)
def test_wrong_searches_are_refused(words: list[str], expected: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=expected):
        main([*words, "--out", str(tmp_path)])


def episodes(count: int, saved: float = 0.0, *, agent: str = "goto") -> list[Episode]:
    """What a bid gained: 3 s for each m/s of progress, `saved` s, more in another situation."""
    chance, found = Random(agent), []
    for at in range(count):
        v = chance.uniform(0.0, 0.6)
        gained = 3.0 * v + saved + 5.0 * (at % 2) + chance.gauss(0.0, 0.3)
        known = (1.0, 0.6, v, 0.0, 0.3, 1.0, v, 1.0)
        found.append(Episode(agent, known, str(at % 2), gained))
    return found


def test_a_learned_utility_predicts_what_a_bid_saves_against_others_in_like_situations() -> None:
    both = episodes(400) + episodes(400, 1.0, agent="avoid")
    goto, avoid = utilities.fit(both, ["goto", "avoid"])
    fast, slow = ((1.0, 0.6, v, 0.0, 0.3, 1.0, v, 1.0) for v in (0.5, 0.1))
    found = {
        (one.agent, name): sum(w * x for w, x in zip(one.weights, known, strict=True))
        for one in (goto, avoid)
        for name, known in (("fast", fast), ("slow", slow))
    }
    assert found["goto", "fast"] - found["goto", "slow"] == pytest.approx(1.2, abs=0.15)
    assert found["avoid", "fast"] - found["goto", "fast"] == pytest.approx(1.0, abs=0.15)
    assert goto.explained is not None
    assert goto.explained > 0.5


def test_features_that_tell_nothing_explain_nothing_of_other_episodes() -> None:
    chance = Random(1)
    known = [tuple([1.0] + [chance.uniform(0.0, 1.0) for _ in range(7)]) for _ in range(100)]
    (one,) = utilities.fit([Episode("goto", x, "a", chance.gauss(0, 1)) for x in known], ["goto"])
    assert one.explained is not None
    assert one.explained < 0.05


def test_an_agent_with_few_episodes_keeps_its_own_utility() -> None:
    found = utilities.fit(episodes(utilities.EPISODES - 1), ["goto", "avoid"])
    assert [(one.episodes, one.weights) for one in found] == [(utilities.EPISODES - 1, ()), (0, ())]


@pytest.mark.long
def test_utilities_are_learnt_from_runs_and_drive(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, value in (("GENERATIONS", 1), ("TESTS", 1), ("BLOCK", 1), ("MEASURED", 0)):
        monkeypatch.setattr(learn, name, value)
    monkeypatch.setattr(utilities, "EPISODES", 4)
    words = ["goto", "avoid", "--utilities", "--world", "slalom", "--budget", "8runs"]
    assert main([*words, "--jobs", "1", "--out", str(tmp_path)]) in (0, 1, 3)
    assert "episodes goto" in capsys.readouterr().out
    found = load_set(tmp_path / "utilities-goto-avoid" / "learnt.toml")
    assert all(setting.startswith("social.utility=[") for (setting,) in found.values())
    assert found


@pytest.mark.long
def test_a_search_that_was_interrupted_continues(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, value in (("GENERATIONS", 1), ("TESTS", 2), ("BLOCK", 1), ("BLOCKS", 1)):
        monkeypatch.setattr(learn, name, value)
    monkeypatch.setattr(learn, "MEASURED", 0)
    words = ["goto", "--only", "goto.p_min", "--world", "hall", "--budget", "10runs", "--jobs", "1"]
    assert main([*words, "--out", str(tmp_path)]) in (0, 1, 3)
    assert "Verdict" in capsys.readouterr().out
    folder = tmp_path / "goto"
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert {"learnt.toml", "history.csv", "test.csv", "found.csv"} == {*before}
    monkeypatch.setattr(learn, "drive", None)  # all is kept
    main([*words, "--out", str(tmp_path)])
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
