"""What `armadico campaign` knows of folders of results."""

from __future__ import annotations

import json
from contextlib import closing
from pathlib import Path

import pytest
from msgspec import Struct

from armadico.cli.options import FailedError
from armadico.core.config_errors import ConfigError
from armadico_tools.campaign.command import main
from armadico_tools.experiments.runner import Context, Experiment, Part
from armadico_tools.falsify.series import Row
from armadico_tools.faults.contacts import Cause
from armadico_tools.faults.series import Ran
from armadico_tools.faults.trials import TRIALS
from armadico_tools.results import Rows

PIXEL = bytes.fromhex(
    "89504e470d0a1a0a0000000d49484452000000010000000108060000001f15c4890000000d4944415478da63"
    "64f8cf50"
)


class Square(Struct, frozen=True):
    of: int
    square: int


def square(of: int) -> Square:
    if of == 1003:
        raise KeyboardInterrupt
    return Square(of, of**2)


def report(context: Context) -> str:
    context.file("plot.png").write_bytes(PIXEL)
    return "## Squares <of>\n\n| of | square |\n| --- | --- |\n| 1000 | 1 & 0 |\n\n![p](plot.png)"


SQUARES = Experiment((Part("squares", square, lambda context: context.seeds),), report)


def run(folder: Path, runs: int) -> None:
    with closing(Context(folder, runs=runs, source="here")) as context:
        context.claim("squares")
        context.run(SQUARES, "Squares")


def test_an_interrupted_experiment_is_shown_with_what_is_left_and_no_results(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path / "cut", 10)
    run(tmp_path / "whole", 3)
    assert main(["status", str(tmp_path), "--json"]) == 3
    cut, whole = json.loads(capsys.readouterr().out)
    assert (cut["name"], cut["done"], cut["runs"], cut["finished"]) == ("cut", 3, 10, False)
    assert cut["left_s"] is not None
    assert (whole["name"], whole["results"], whole["finished"]) == ("whole", 3, True)


def test_the_page_has_tables_pictures_and_links_and_nothing_from_elsewhere(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run(tmp_path / "whole", 3)
    assert main(["report", str(tmp_path)]) == 0
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<h3>Squares &lt;of&gt;</h3>" in page
    assert "<td>1000</td><td>1 &amp; 0</td>" in page
    assert "data:image/png;base64,iVBOR" in page
    assert 'href="whole/squares.csv"' in page
    assert "http" not in page


def test_a_folder_without_results_is_said_to_be_one(tmp_path: Path) -> None:
    with pytest.raises(FailedError, match="no results"):
        main(["status", str(tmp_path)])


@pytest.mark.parametrize("damaged", [b"", b'{"half'])
def test_a_damaged_series_is_bad_input_and_not_left_out(tmp_path: Path, damaged: bytes) -> None:
    (tmp_path / "squares").mkdir()
    (tmp_path / "squares" / "about.json").write_bytes(damaged)
    with pytest.raises(ConfigError, match=r"squares/about\.json.*move it away"):
        main(["status", str(tmp_path)])


@pytest.mark.parametrize("left", [0, 2])  # lines, with the head
def test_a_table_whose_results_are_lost_is_not_finished(
    left: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run(tmp_path / "whole", 3)
    store = tmp_path / "whole" / "found.csv"
    store.write_bytes(b"".join(store.read_bytes().splitlines(keepends=True)[:left]))
    assert main(["status", str(tmp_path), "--json"]) == 3
    (found,) = json.loads(capsys.readouterr().out)
    kept = max(left - 1, 0)
    assert (found["results"], found["lost"], found["finished"]) == (kept, 3 - kept, False)
    main(["status", str(tmp_path)])
    assert "are lost" in capsys.readouterr().out
    run(tmp_path / "whole", 3)
    main(["status", str(tmp_path)])
    assert "finished" in capsys.readouterr().out


def test_whether_a_series_is_finished_that_says_not_how_much_was_wanted_is_not_known(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "outcomes.csv").write_text("key,of,found\n", encoding="utf-8")
    assert main(["status", str(tmp_path), "--json"]) == 3
    (found,) = json.loads(capsys.readouterr().out)
    assert (found["results"], found["finished"]) == (0, None)
    main(["status", str(tmp_path)])
    assert "not known" in capsys.readouterr().out


@pytest.mark.parametrize("name", ["found.csv", "falsify.csv", "outcomes.csv", "trials.csv"])
def test_a_damaged_store_is_named_with_its_line_and_not_counted(tmp_path: Path, name: str) -> None:
    run(tmp_path / "whole", 3)
    path = tmp_path / "whole" / name
    path.write_bytes(b"\0\0\0\0")
    with pytest.raises(ConfigError, match=rf"{name}:1"):
        main(["status", str(tmp_path)])


@pytest.mark.parametrize("what", ["status", "report"])
def test_only_a_complete_series_passes_and_the_others_say_why(
    what: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run(tmp_path / "whole", 3)
    assert main([what, str(tmp_path)]) == 0
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path / "cut", 10)
    capsys.readouterr()
    assert main([what, str(tmp_path)]) == 3
    assert "unknown: cut: 3 results, squares: 3 of 10" in capsys.readouterr().err


def test_a_finished_series_that_lacks_something_is_as_unknown_as_its_experiment_was(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def lacking(context: Context) -> str:
        context.lacking.append("no arm was contended")
        return report(context)

    with closing(Context(tmp_path / "whole", runs=3, source="here")) as context:
        context.claim("squares")
        context.run(Experiment(SQUARES.parts, lacking), "Squares")
    assert main(["status", str(tmp_path)]) == 3
    assert "no arm was contended" in capsys.readouterr().err


def test_a_finished_series_without_a_result_does_not_pass(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run(tmp_path / "none", 0)
    assert main(["status", str(tmp_path)]) == 3
    assert "shows nothing" in capsys.readouterr().err


def ran(commit: str, violations: str = "", **others: object) -> Ran:
    return Ran(commit, 1, "sc4", 60.0, violations=violations, **others)


def test_runs_of_no_known_experiment_such_as_of_learning_are_not_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run(tmp_path / "whole", 3)
    run(tmp_path / "learn" / "goto", 3)
    (tmp_path / "learn" / "goto" / "about.json").unlink()
    assert main(["status", str(tmp_path)]) == 3
    assert "unknown: goto, runs without about.json: 3 results" in capsys.readouterr().err


def test_a_broken_promise_of_the_newest_commit_fails_the_series_and_an_older_one_does_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "outcomes.csv").write_text("key,of,found\n", encoding="utf-8")
    seeds = Rows(tmp_path / "seeds.csv", Ran)
    seeds.add(ran("old", "COLLISION:1"), ran("new"))
    assert main(["status", str(tmp_path)]) == 3
    seeds.add(ran("new", "COLLISION:1"))
    assert main(["status", str(tmp_path)]) == 1
    assert "1 of 2 seeds broke a promise" in capsys.readouterr().err


def test_a_figure_of_a_trial_without_a_number_is_unknown_and_the_others_count(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    trials = Rows(tmp_path / "trials.csv", Ran)
    trial, figure = next((t, f) for t in TRIALS.values() for f in t.figures if f.worst is not None)
    trials.add(ran("a", kinds=trial.name, figures=json.dumps({figure.name: None})))
    assert main(["status", str(tmp_path)]) == 3
    assert f"no number in 1 trials: {trial.name} {figure.name}" in capsys.readouterr().err
    late = (figure.worst or 0.0) + 1.0
    trials.add(ran("a", kinds=trial.name, figures=json.dumps({figure.name: late})))
    assert main(["status", str(tmp_path)]) == 1
    assert f"aims missed: {trial.name} {figure.name}" in capsys.readouterr().err


def test_a_contact_that_sensors_could_prevent_fails_its_series(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    contacts = json.dumps({Cause.SEEN: 2})
    Rows(tmp_path / "falsify.csv", Row).add(Row("a", "pioneer", "sc4", 1, 10, 1, contacts, 0.0))
    assert main(["status", str(tmp_path)]) == 1
    assert "2 contacts that the sensors could have prevented" in capsys.readouterr().err
