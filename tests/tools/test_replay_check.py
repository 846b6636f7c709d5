"""The thirty recordings: every shipped scenario, every kind of fault that can be recorded."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from subprocess import CompletedProcess

import pytest

from armadico import cli
from armadico.cli import options, run
from armadico.config.loading import names
from armadico.observe.replay import Difference, Outcome
from armadico_tools.commands import replay_check, trials
from armadico_tools.faults.real_series import ALL

LEFT_OUT = {"round-trip-100", "one-way-300"}
"""Slow links lose nothing, and recordings of them would be of the same."""


def test_there_are_thirty_of_every_scenario_and_every_fault() -> None:
    assert len({plan.name for plan in replay_check.PLANS}) == len(replay_check.PLANS) == 30
    driven = {plan.words[1] for plan in replay_check.PLANS if plan.words[0] == "run"}
    assert driven == set(names("scenarios"))
    faults = {plan.words[1] for plan in replay_check.PLANS if plan.words[0] == "trials"}
    assert faults == set(ALL) - LEFT_OUT


@pytest.mark.parametrize("plan", replay_check.PLANS, ids=lambda plan: plan.name)
def test_each_is_a_command_that_can_be_called(plan: replay_check.Plan) -> None:
    parser = {"run": run.parser, "trials": trials.parser}[plan.words[0]]()
    args = parser.parse_args([*plan.words[1:], "--record", "x.mcap"])
    assert args.record == Path("x.mcap")


def test_one_that_differs_or_is_not_whole_is_counted() -> None:
    who = {"namespace": "robot1", "name": "goto", "instance": "goto-1"}
    other = Difference(at=1.0, output=3, then=("a",), now=("b",), inputs=())
    plan = replay_check.PLANS[0]
    good = replay_check.Replayed(plan, [Outcome(**who, outputs=5)], 1.0, "")
    gap = replay_check.Replayed(plan, [Outcome(**who, outputs=5, end="a gap")], 1.0, "")
    bad = replay_check.Replayed(plan, [Outcome(**who, outputs=5, difference=other)], 1.0, "")
    none = replay_check.Replayed(plan, [], 0.0, "not recorded: no")
    assert [each.equal for each in (good, gap, bad, none)] == [True, False, False, False]
    said = replay_check._summary([good, gap, bad, none])
    assert said.startswith("1 of 4 recordings equal from beginning to end: 3 agents")
    assert "1 agents differ, of 1 the journal is not whole" in said


def test_one_that_was_refused_is_told_with_the_reason_whatever_was_recorded_meanwhile(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    why = "armadico run: a robot is in the namespace 'robot1' already: robot-7"

    def refused(words: Sequence[str]) -> CompletedProcess[str]:
        assert words[0] != "replay", "what was recorded is of somebody else's society"
        Path(words[-1]).write_bytes(b"of another society")
        return CompletedProcess(words, options.FAILED, "", f"sc1: starting\n{why}\n")

    monkeypatch.setattr(replay_check, "_called", refused)
    found = replay_check._one(replay_check.PLANS[0], tmp_path)
    assert not found.equal
    assert replay_check._line(found) == f"sc1: refused: {why}"


def test_one_that_is_not_there_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["replay-check", "sc44"]) == options.USAGE
    assert "armadico replay-check --list" in capsys.readouterr().err
    assert cli.main(["replay-check", "--list"]) == 0
    assert capsys.readouterr().out.count("\n") == 30
