"""`armadico faults`: what it offers, counts, refuses and repeats."""

from __future__ import annotations

import csv
import json
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from armadico.cli.options import INTERRUPTED, UNKNOWN, UsageError
from armadico.core.config_errors import ConfigError
from armadico_tools import series as any_series
from armadico_tools.commands import faults
from armadico_tools.faults import series, workload
from armadico_tools.faults.fault_types import KINDS, Promise
from armadico_tools.faults.plan import Case, Outcome
from armadico_tools.faults.sightings import Sight
from tests.programs import call

CALM = '{"seed":1,"scenario":"sc1","lasts":4.0,"faults":[["hang",2.0,0.1,["interface"]]]}'


def test_list_names_every_kind_and_promise(capsys: pytest.CaptureFixture[str]) -> None:
    assert faults.main(["--list"]) == 0
    words = {line.split()[0] for line in capsys.readouterr().out.splitlines()}
    assert {*KINDS, *(promise.name for promise in Promise)} <= words
    assert faults.main(["--list", "--json"]) == 0
    assert list(json.loads(capsys.readouterr().out)["kinds"]) == list(KINDS)


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (["--seeds", "0"], "--seeds 0: expected at least 1"),
        (["--kind", "partitoin"], "partition"),
        (["--repeat", CALM, "--seeds", "3"], "--seeds is not used"),
        (["--variant", "peple"], "people"),
        (["--once"], "--planted"),
    ],
)
def test_what_makes_no_sense_is_refused(arguments: list[str], why: str) -> None:
    with pytest.raises(UsageError, match=why):
        faults.main(arguments)


@pytest.mark.parametrize(
    ("mechanisms", "why"),
    [
        (["auction", "damn"], "auction and damn both decide about wheels"),
        (["contract-net"], "task-.*variant 'sonar'"),
    ],
)
def test_mechanisms_that_cannot_decide_are_refused_before_the_first_seed(
    mechanisms: list[str], why: str
) -> None:
    chosen = [word for name in mechanisms for word in ("--coordination", name)]
    with pytest.raises(ConfigError, match=why):
        faults.main(["--seeds", "1", *chosen])


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ("nowhere.json", "nowhere.json"),
        ('{"seed": 1}', "scenario"),
        (CALM[:-1] + ',"variant":"peple"}', "people"),
        (CALM[:-1] + ',"robot":"jakal"}', "jackal"),
    ],
)
def test_a_case_that_is_none_is_refused(given: str, why: str) -> None:
    with pytest.raises(ConfigError, match=why):
        faults.main(["--repeat", given])


@pytest.mark.long
def test_seeds_are_counted_with_the_commit_and_the_next_call_goes_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["--seeds", "2", "--minutes", "0.2", "--jobs", "1", "--out", str(tmp_path)]
    assert faults.main([*arguments, "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["seeds"] == 2
    assert said["simulated_s"] == 24.0
    assert set(said["violations"]) == {promise.name for promise in Promise}
    assert faults.main([*arguments, "--kind", "hang"]) == 0
    assert "4 seeds on this commit, 0 broke a promise" in capsys.readouterr().out
    assert faults.main([*arguments, "--first", "0", "--json"]) == 0  # by the outcomes that are kept
    assert json.loads(capsys.readouterr().out) == said
    with (tmp_path / series.SEEDS).open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["seed"] for row in rows] == ["0", "1", "2", "3"]
    assert [row["kinds"] for row in rows] == ["", "", "hang", "hang"]
    assert all(row["commit"] for row in rows)


def test_one_case_is_repeated_from_text_or_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "case.json"
    path.write_text(CALM, encoding="utf-8")
    for given in (CALM, str(path)):
        assert faults.main(["--repeat", given]) == 0
        assert "no promise was broken" in capsys.readouterr().out


def breaks_if_it_hangs(run: Callable[[Case], Outcome]) -> Callable[..., Outcome]:
    """As if every hang broke a promise."""

    def ran(case: Case, *_: object) -> Outcome:
        outcome = run(replace(case, lasts=min(case.lasts, 1.0), faults=()))
        found = [("MOVES", f.at + 0.1, "it stands") for f in case.faults if f.kind == "hang"]
        return replace(outcome, case=case, violations=tuple(found))

    return ran


def test_a_violation_prints_a_command_that_repeats_it_and_exits_with_1(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    broken = breaks_if_it_hangs(workload.run)
    monkeypatch.setattr(workload, "run", broken)
    monkeypatch.setattr(series, "run", broken)
    arguments = ["--seeds", "2", "--minutes", "1", "--jobs", "1", "--out", str(tmp_path)]
    arguments += ["--kind", "hang", "--kind", "drop"]
    assert faults.main(arguments) == 1
    out = capsys.readouterr().out
    (line,) = [line for line in out.splitlines() if line.startswith("armadico faults --repeat")]
    program, command, *rest = shlex.split(line)
    assert (program, command) == ("armadico", "faults")
    assert [f[0] for f in json.loads(rest[1])["faults"]] == ["hang"]
    assert faults.main(rest) == 1
    assert "MOVES broken: it stands" in capsys.readouterr().out


@pytest.mark.long
def test_interrupted_it_keeps_and_tells_what_was_counted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    run = any_series.run

    def interrupted(function: Any, tasks: Any, *rest: Any) -> None:
        run(function, tasks[:1], *rest)
        raise KeyboardInterrupt

    monkeypatch.setattr(any_series, "run", interrupted)
    arguments = ["--seeds", "9", "--minutes", "0.2", "--jobs", "1", "--out", str(tmp_path)]
    assert faults.main(arguments) == INTERRUPTED
    said = capsys.readouterr()
    assert "interrupted after 1 of 9 seeds" in said.err
    assert "1 seeds" in said.out


@pytest.mark.long
def test_a_full_disk_is_one_line(tmp_path: Path) -> None:
    (tmp_path / series.SEEDS).symlink_to("/dev/full")
    done = call("faults", "--seeds", "1", "--minutes", "0.2", "--jobs", "1", "--out", str(tmp_path))
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    assert "No space left on device" in done.stderr.splitlines()[-1]


@pytest.mark.long
def test_contacts_and_what_happened_are_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    ran = workload.run

    def touched(case: Case, *judged: Any) -> Outcome:
        outcome = ran(replace(case, faults=()), *judged)
        moving = {"": 3.0, "pose": 1.0}
        return replace(outcome, contacts={"pose": 2}, moving_s=moving, ends={"FORGOTTEN": 1})

    monkeypatch.setattr(series, "run", touched)
    arguments = ["--seeds", "2", "--minutes", "0.2", "--jobs", "1", "--out", str(tmp_path)]
    assert faults.main(arguments) == UNKNOWN, "the void share is above its goal"
    out = capsys.readouterr().out
    assert "unknown: contacts were void for 25.0% of the moving time" in out
    assert "contacts 0, void 4: pose 4" in out
    assert "moving 8 s, contacts void 25.0% of it (goal: 2%): pose 25.0%" in out
    assert "requested again 2" in out
    assert "a better bid takes over" in out
    assert faults.main([*arguments, "--json"]) == UNKNOWN
    said = json.loads(capsys.readouterr().out)
    assert said["judgement"]["answer"] == "unknown"
    assert said["void_contacts"] == {"pose": 4}
    assert said["void_share"] == {"pose": 0.25}
    assert sum(part["seeds"] for part in said["variants"].values()) == 2
    assert {*said["sights"]} == {sight.name for sight in Sight}


@pytest.mark.parametrize(
    ("moving", "code", "said"),
    [
        ({"": 99.0, "line": 1.0}, 0, ""),
        ({"": 97.0, "line": 3.0}, UNKNOWN, "unknown: contacts were void for 3.0%"),
        ({}, UNKNOWN, "unknown: the share of void contacts"),
    ],
)
def test_void_contacts_above_the_goal_or_not_known_are_no_success(
    moving: dict[str, float],
    code: int,
    said: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def over(_run: object, tasks: list[series.Task], _jobs: int, _label: str, done: Any) -> bool:
        for task in tasks:
            done(task, Outcome(Case(task.seed, "sc1", 12.0, ()), {}, (), moving_s=moving))
        return True

    monkeypatch.setattr(any_series, "over", over)
    assert faults.main(["--seeds", "1", "--out", str(tmp_path)]) == code
    assert said in capsys.readouterr().out


@pytest.mark.long
def test_a_campaign_in_which_a_situation_never_came_to_pass_fails(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(series, "CAMPAIGN", 1)
    monkeypatch.setattr(series, "CAMPAIGN_S", 10.0)
    arguments = ["--seeds", "1", "--minutes", "0.2", "--jobs", "1", "--out", str(tmp_path)]
    assert faults.main(arguments) == 1
    assert f"never occurred: {Sight.WATCHDOG.value}" in capsys.readouterr().out
    assert faults.main([*arguments, "--kind", "hang"]) == 0


@pytest.mark.long
def test_planted_defects_are_kept_and_not_run_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--planted", "stands", "--first", "1", "--minutes", "0.2", "--scenario", "sc1"]
    words += ["--variant", "sonar", "--jobs", "1", "--out", str(tmp_path), "--json"]
    faults.main([*words, "--seeds", "1"])
    first = json.loads(capsys.readouterr().out)
    assert [first[name]["seeds"] for name in ("none", "stands")] == [1, 1]
    left: list[series.Task] = []

    def over(_run: object, tasks: list[series.Task], *_rest: object) -> bool:
        left.extend(tasks)
        return True

    monkeypatch.setattr(any_series, "over", over)
    faults.main([*words, "--seeds", "2"])
    assert json.loads(capsys.readouterr().out) == first
    assert [(task.seed, task.planted) for task in left] == [(2, ""), (2, "stands")]


def test_a_defect_that_was_found_is_left_out_of_further_seeds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run: list[tuple[int, str]] = []

    def over(_run: object, tasks: list[series.Task], _jobs: int, _label: str, done: Any) -> bool:
        for task in tasks:
            run.append((task.seed, task.planted))
            broken = (("ARRIVES", 9.0, "late"),) if task.seed == 2 and task.planted else ()
            done(task, Outcome(Case(task.seed, "sc1", 12.0, ()), {}, broken))
        return True

    monkeypatch.setattr(any_series, "over", over)
    words = ["--planted", "stands", "--planted", "lazy", "--once", "--first", "1", "--seeds", "9"]
    assert faults.main([*words, "--out", str(tmp_path)]) == 0
    assert run == [(seed, name) for seed in (1, 2) for name in ("", "stands", "lazy")]
