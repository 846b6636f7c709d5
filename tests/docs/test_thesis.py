"""The page on the thesis: where the set `thesis` departs is told; its tables are of its rows."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from armadico.config.parameters import load_set
from armadico_tools import kept_results
from armadico_tools.experiments.statistics import alone
from armadico_tools.kept_results import Kept, kept, main, outcomes, pairs, smoothness
from armadico_tools.results import Rows
from tests.docs.blocks import ROOT

PAGE = ROOT / "docs" / "thesis.md"
HEADINGS = ("### What the set sets", "### Where it departs")
SETTING = re.compile(r"`([a-z_]+(?:\.[a-z_]+)+=[^`]+)`")
PLACE = re.compile(r"`([\w/]+\.py):(\w+)`")
SECTION = re.compile(r"^\d+\.\d+|^none")


def rows(heading: str) -> list[list[str]]:
    """The table under a heading, without its head."""
    text = PAGE.read_text(encoding="utf-8")
    part = text.partition(f"{heading}\n")[2].partition("\n#")[0]
    lines = [line.strip("| ").split(" | ") for line in part.splitlines() if line.startswith("| ")]
    return lines[2:]


def test_the_page_names_what_the_set_sets_and_nothing_else() -> None:
    there = {
        f"{agent}.{setting}" for agent, given in load_set("thesis").items() for setting in given
    }
    named = [s for row in rows(HEADINGS[0]) for s in SETTING.findall(row[-1])]
    assert sorted(named) == sorted(there)


def test_each_departure_names_the_section_and_the_code_that_departs() -> None:
    departures = rows(HEADINGS[1])
    assert len(departures) >= 12
    for row in departures:
        assert SECTION.match(row[0]), row
        places = PLACE.findall(row[-1])
        assert places, row
        for path, name in places:
            text = (ROOT / path).read_text(encoding="utf-8")
            assert re.search(rf"^\s*(?:def |class )?{name}\b[^\n]*[:=(]", text, re.MULTILINE), row


def run(cell: str, seed: int, tt_s: float | None) -> Kept:
    reached = tt_s is not None
    return Kept(
        cell,
        seed,
        reached,
        tt_s=tt_s or 99.0,
        td_m=5.0,
        fo_deg=1.0,
        p_percent=99.0,
        exchanges=3,
        commit="abc",
        collisions=0,
        command_step_v=0.25,
    )


@pytest.fixture
def two_arms(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(kept_results, "FOLDER", tmp_path / "kept")
    source = tmp_path / "runs.csv"
    times = {"a": [10.0, 20.0, None, 40.0], "b": [11.0, None, None, 43.0]}
    arms = [run(cell, s, tt) for cell, found in times.items() for s, tt in enumerate(found)]
    Rows(source, Kept).add(*arms)
    assert main([str(source), "x", *times]) == 0


@pytest.mark.usefixtures("two_arms")
def test_a_run_that_was_not_reached_has_no_time_and_counts_as_the_longest_in_the_median() -> None:
    _, _, first, second, *_ = outcomes("x").splitlines()
    assert first.startswith("| a | 3 of 4 | 0 | 23.3 ± 15.3 | 30.0 | 3.0 ± 0.0 ")
    assert second.startswith("| b | 2 of 4 | 0 | 27.0 ± 22.6 | not reached | ")
    assert outcomes("x").endswith("Commit `abc`.")


@pytest.mark.usefixtures("two_arms")
def test_pairs_count_who_alone_reaches_and_time_only_what_both_reach() -> None:
    line = pairs("x", [("a", "b")]).splitlines()[2]
    assert line.startswith("| a to b | 1, 0 | 1 | +2.0 (2) | ")


@pytest.mark.usefixtures("two_arms")
def test_what_no_run_of_a_cell_has_is_left_empty_and_not_nought() -> None:
    assert smoothness("x").splitlines()[2] == "| a | 0.250 | - | - | - |"


@pytest.mark.usefixtures("two_arms")
def test_nothing_is_replaced_by_cells_that_are_not_there(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for source, cell in (("runs.csv", "c"), ("none.csv", "a")):
        with pytest.raises(SystemExit):
            main([str(tmp_path / source), "x", cell])
        assert source in capsys.readouterr().err
    assert list(kept("x")) == ["a", "b"]
    assert main([str(tmp_path / "runs.csv"), "x", "b"]) == 0
    assert list(kept("x")) == ["b"]


@pytest.mark.usefixtures("two_arms")
def test_rows_that_are_not_kept_are_an_error_and_make_no_folder() -> None:
    with pytest.raises(FileNotFoundError):
        kept("y")


def test_the_exact_p_of_pairs() -> None:
    assert alone(0, 0) == 1.0
    assert alone(5, 0) == pytest.approx(2 * 0.5**5)
    assert alone(0, 5) == alone(5, 0)
