"""`armadico faults --live`: faults on real processes, watched by the checker of promises."""

from __future__ import annotations

import csv
import json
from contextlib import nullcontext
from pathlib import Path

import pytest

from armadico.cli import main
from armadico.cli.options import UNKNOWN
from armadico_tools.faults import campaign, series
from armadico_tools.faults.plan import Case, Outcome
from armadico_tools.faults.series import TRIALS as ROWS
from armadico_tools.faults.series import Line, Summary, lines
from armadico_tools.faults.trials import TRIALS
from tests.programs import call

SOON = 90.0

KINDS = ("holder-hung", "nobody-left")


@pytest.mark.long
@pytest.mark.live
def test_trials_are_made_measured_and_kept(tmp_path: Path) -> None:
    words = ["--live", "--trials", "1", "--json", "--out", str(tmp_path)]
    words += [word for kind in KINDS for word in ("--kind", kind)]
    done = call("faults", *words, within=SOON)
    found = json.loads(done.stdout)
    assert not found["violations"], done.stderr
    assert not found["failed"]
    measured = {(line["kind"], line["figure"]) for line in found["lines"]}
    assert measured == {(kind, f.name) for kind in KINDS for f in TRIALS[kind].figures}
    assert all(line["worst"] >= line["median"] >= 0 for line in found["lines"])
    with (tmp_path / ROWS).open(newline="") as rows:
        kept = {
            (row["kinds"], name)
            for row in csv.DictReader(rows)
            for name in json.loads(row["figures"])
        }
    assert kept == measured


def test_an_aim_is_kept_by_median_and_worst() -> None:
    for median, worst, kept in ((200, 400, True), (201, 400, False), (10, 401, False)):
        assert Line("k", "f", "", 3, median, worst, 200, 400).kept is kept
    assert Line("k", "f", "", 3, 5000, 9000, None, None).kept


def test_figures_of_trials_are_summed_up_by_kind() -> None:
    summary, trial = Summary(), TRIALS["holder-killed"]
    for value in (10.0, 30.0, 450.0):
        case = Case(0, "road", 1.0, ())
        summary.add(Outcome(case, {}, (), kind=trial.name, figures={"next obeyed": value}))
    (line,) = lines(summary, TRIALS.values())
    assert (line.trials, line.median, line.worst, line.kept) == (3, 30.0, 450.0, False)


def test_the_kinds_are_listed_with_what_counts(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["faults", "--live", "--list"]) == 0
    out = capsys.readouterr().out
    for trial in TRIALS.values():
        assert trial.name in out
        assert all(figure.text in out for figure in trial.figures)


def test_without_root_the_alternative_is_named(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("os.geteuid", lambda: 1000)
    assert main(["faults", "--live", "--kind", "host-lost"]) == 1
    printed = capsys.readouterr().err
    assert "needs root (sudo)" in printed
    assert "holder-killed" in printed


def test_trials_that_were_left_out_are_not_passed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("os.geteuid", lambda: 1000)
    monkeypatch.setattr(campaign, "place_for", lambda *_: nullcontext())
    monkeypatch.setattr(campaign, "make_trials", lambda *_, **__: [])
    monkeypatch.setattr(series, "lines", lambda *_: [Line("k", "f", "", 3, 1, 1, None, None)])
    words = ["faults", "--live", "--out", str(tmp_path)]
    assert main(words) == UNKNOWN
    assert main([*words, "--kind", "holder-killed"]) == 0


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--live", "--trials", "0"], "at least 1"),
        (["--live", "--kind", "holder-kiled"], "did you mean 'holder-killed'?"),
        (["--live", "--seeds", "3"], "--seeds is only for runs without --live"),
        (["--trials", "3"], "--trials is only for runs with --live"),
        (["--recording", "nothing.mcap"], "nothing.mcap"),
    ],
)
def test_what_is_wrong_is_named(
    words: list[str], expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["faults", *words]) == 2
    assert expected in capsys.readouterr().err
