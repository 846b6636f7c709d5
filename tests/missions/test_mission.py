"""`armadico mission`: runs under a virtual clock, what there is, and what is refused."""

from __future__ import annotations

import json
from contextlib import nullcontext
from pathlib import Path

import pytest

from armadico import cli
from armadico.agents.missions.commands import mission
from armadico.agents.missions.messages import Board
from armadico.cli import options
from armadico.mesh.topology import topology
from armadico.mesh.zenoh import ZenohMesh
from tests.programs import call

BRIEF = """
title = "Brief"
scenario = "surveillance"
steps = [
  { do = "take-photo" },
  { do = "wait", seconds = 1 },
]
"""


@pytest.fixture
def brief(tmp_path: Path) -> Path:
    file = tmp_path / "brief.toml"
    file.write_text(BRIEF, encoding="utf-8")
    return file


def test_a_mission_that_ends_as_asked_is_told_step_by_step(brief: Path) -> None:
    done = call("mission", "run", str(brief), "--virtual", "--seed", "3", "--sensors", "ideal")
    assert done.returncode == 0, done.stderr
    assert "take-photo done: photo in R2" in done.stderr
    assert "wait(1.0) done" in done.stderr
    assert "surveillance: done" in done.stdout


def test_for_programs_it_is_one_object(brief: Path) -> None:
    words = ("mission", "run", str(brief), "--virtual", "--sensors", "ideal", "--json")
    done = call(*words)
    row = json.loads(done.stdout)
    assert row["done"] is True
    assert [task["step"] for task in row["tasks"]] == ["take-photo", "wait(1.0)"]
    assert row["conditions"]["scenario"]["mission"] == str(brief)
    assert call(*words).stdout == done.stdout


def test_a_mission_that_fails_ends_with_1_and_says_why(tmp_path: Path) -> None:
    file = tmp_path / "m.toml"
    file.write_text(BRIEF.replace('"wait", seconds = 1', '"take-photo", room = "R1"'), "utf-8")
    done = call("mission", "run", str(file), "--virtual", "--sensors", "ideal", "--json")
    assert done.returncode == 1
    row = json.loads(done.stdout)
    assert row["done"] is False
    assert row["why"] == "it failed: take-photo(R1): the robot is in R2, not in R1"


def test_one_that_is_not_done_in_time_ends_with_1(brief: Path) -> None:
    done = call("mission", "run", str(brief), "--virtual", "--sensors", "ideal", "--for", "2")
    assert done.returncode == 1
    assert "NOT done: time limit of 2 s" in done.stdout


def test_those_that_are_shipped_are_listed() -> None:
    done = call("mission", "list")
    assert done.returncode == 0
    assert "Photos of R1 and R11" in done.stdout
    rows = {row["name"]: row for row in json.loads(call("mission", "list", "--json").stdout)}
    assert rows["surveillance"]["steps"][1] == "move(R1)"
    assert set(rows) >= {"surveillance", "rounds"}


@pytest.mark.long
def test_where_no_agent_has_missions_that_is_said() -> None:
    with ZenohMesh("mission-test", topology(router=True)):
        for words in (("status",), ("log",), ("log", "m"), ("cancel", "m"), ("cancel", "--all")):
            done = call("mission", *words, "--namespace", "mission-test")
            assert done.returncode == 1, done.stderr
            assert "alive" in done.stderr
            assert "'mission-test'" in done.stderr


@pytest.mark.parametrize(
    ("board", "text", "rows"),
    [
        (None, "no alarms\n", []),
        (
            Board(1, 1, alarms=("R2", "R21"), unchecked=("R21",)),
            "R2               checked\nR21              not checked yet\n",
            [{"room": "R2", "checked": True}, {"room": "R21", "checked": False}],
        ),
    ],
)
def test_alarms_are_listed_apart_from_missions(
    board: Board | None,
    text: str,
    rows: list[dict[str, object]],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(options.Mesh, "client", lambda _: nullcontext())
    monkeypatch.setattr(mission, "_board", lambda _: board)
    assert cli.main(["mission", "alarms"]) == 0
    assert capsys.readouterr().out == text
    assert cli.main(["mission", "alarms", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == rows
