"""`armadico trials`: faults on real processes, watched by the checker of promises."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

from armadico.cli import main
from armadico_tools.faults.real_series import ALL, Line, Series
from armadico_tools.faults.real_trials import TRIALS
from tests.programs import call

SOON = 90.0

KINDS = ("holder-hung", "nobody-left")


@pytest.mark.live
def test_trials_are_made_measured_and_kept(tmp_path: Path) -> None:
    words = ("--trials", "1", "--json", "--out", str(tmp_path))
    done = call("trials", *KINDS, *words, within=SOON)
    found = json.loads(done.stdout)
    assert not found["violations"], done.stderr
    assert not found["failed"]
    measured = {(line["kind"], line["figure"]) for line in found["lines"]}
    assert measured == {(kind, f.name) for kind in KINDS for f in TRIALS[kind].figures}
    assert all(line["worst"] >= line["median"] >= 0 for line in found["lines"])
    with (tmp_path / "trials.csv").open(newline="") as rows:
        kept = {(row["kind"], row["figure"]) for row in csv.DictReader(rows)}
    assert kept == measured
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert {line["kind"] for line in summary["lines"]} == set(KINDS)


def test_an_aim_is_kept_by_median_and_worst() -> None:
    for median, worst, kept in ((200, 400, True), (201, 400, False), (10, 401, False)):
        assert Line("k", "f", "", 3, median, worst, 200, 400).kept is kept
    assert Line("k", "f", "", 3, 5000, 9000, None, None).kept


def test_a_series_without_trials_or_with_one_that_failed_is_not_kept() -> None:
    trial = TRIALS["holder-killed"]
    assert not Series(trial).kept
    assert Series(trial, rows=[{"next obeyed": 20.0}]).kept
    assert not Series(trial, rows=[{"next obeyed": 20.0}], failed=["it did not start"]).kept
    assert not Series(trial, rows=[{"next obeyed": 450.0}]).kept


def test_the_kinds_are_listed_with_what_counts(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["trials", "--list"]) == 0
    out = capsys.readouterr().out
    for trial in ALL.values():
        assert trial.name in out
        assert all(figure.text in out for figure in trial.figures)


def test_a_kind_that_is_not_there_is_told_the_nearest(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["trials", "holder-kiled"]) == 2
    assert "did you mean 'holder-killed'?" in capsys.readouterr().err


def test_without_root_it_says_so_and_what_can_be_done(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("os.geteuid", lambda: 1000)
    assert main(["trials", "host-lost"]) == 1
    said = capsys.readouterr().err
    assert "needs root (sudo)" in said
    assert "holder-killed" in said


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["trials", "--trials", "0"], "at least 1"),
        (["trials", "--recording", "nothing.mcap"], "nothing.mcap"),
    ],
)
def test_what_is_wrong_is_named(
    words: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words) == 2
    assert says in capsys.readouterr().err
