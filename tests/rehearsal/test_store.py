"""Answers are kept for whatever explains the drive afterwards."""

from __future__ import annotations

import os
import stat
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from armadico.config.named import DATA_VARIABLE
from armadico.core.discovery import REHEARSALS, find
from armadico.core.judgement import yes
from armadico.rehearsal.answer import Rehearsed
from armadico.rehearsal.fork import Errand
from armadico.rehearsal.store import MOST, ROBOTS, note, told

GOAL = (3.0, 1.0, 0.5)
ERRAND = Errand(goal=GOAL)


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(DATA_VARIABLE, str(tmp_path))
    return tmp_path


START = (1.0, 1.0)


def found(goal: tuple[float, float, float] = GOAL, arrives: int = 4) -> Rehearsed:
    return Rehearsed(
        judgement=yes(),
        arrives=arrives,
        samples=4,
        time_s=(1, 2, 3),
        start=START,
        goal=goal,
        world="/maps/house.map",
    )


def test_drive_has_the_newest_answer_of_its_goal_before_it() -> None:
    note("a/robot", ERRAND, found(arrives=3), 90.0)
    note("a/robot", ERRAND, found(), 100.0)
    note("a/robot", Errand(goal=(9.0, 1.0, 0.0)), found((9.0, 1.0, 0.0)), 110.0)
    note("a/robot", ERRAND, found(arrives=0), 300.0)
    to = (3.1, 1.0)
    kept = find(REHEARSALS, "told").load()("a/robot", (1.2, 1.0), to, "house", 120.0)
    assert (kept["at"], kept["arrives"], kept["samples"]) == (100.0, 4, 4)
    assert told("a/robot", START, to, "", 120.0), "its map is not known"
    assert told("a/robot", START, to, "house", 80.0) is None, "none was before it"
    assert told("a/robot", START, to, "house", 5000.0) is None, "too long ago"
    assert told("a/robot", (1.6, 1.0), to, "house", 120.0) is None, "it begins elsewhere"
    assert told("a/robot", START, to, "offices", 120.0) is None, "on another map"
    assert told("other", START, to, "house", 120.0) is None


def test_what_if_is_no_rehearsal_of_the_drive_that_follows() -> None:
    note("robot", Errand(goal=GOAL, without=("avoid",)), found(), 100.0)
    note("robot", ERRAND, Rehearsed(judgement=yes(), goal=GOAL), 100.0)
    note("robot", ERRAND, found(), 100.0, named="other.map")
    note("robot", Errand(), found(), 100.0)  # the mission under way goes on
    assert told("robot", START, GOAL[:2], "house", 120.0) is None


def test_only_the_newest_are_kept(folder: Path) -> None:
    for k in range(MOST + 5):
        note("robot", ERRAND, found(), float(k))
    (file,) = folder.rglob("*.jsonl")
    assert len(file.read_bytes().splitlines()) == MOST


def test_answer_needs_no_disk(folder: Path) -> None:
    (folder / "armadico").write_text("a file in the way")
    note("robot", ERRAND, found(), 100.0)
    assert told("robot", START, GOAL[:2], "house", 120.0) is None


def test_answers_of_several_processes_are_all_kept_and_private(folder: Path) -> None:
    with ThreadPoolExecutor(4) as pool:  # each opens its own lock, as a process does
        list(pool.map(lambda k: note("robot", ERRAND, found(), float(k)), range(40)))
    (file,) = folder.rglob("*.jsonl")
    assert len(file.read_bytes().splitlines()) == 40
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert stat.S_IMODE(file.parent.stat().st_mode) == 0o700
    assert [*file.parent.iterdir()] == [file]


def test_robots_of_long_ago_are_dropped(folder: Path) -> None:
    for k in range(ROBOTS + 1):
        note(f"robot{k}", ERRAND, found(), float(k))
        newest = folder / "armadico" / "rehearsals" / f"robot{k}.jsonl"
        os.utime(newest, (k, k))
    names = {each.stem for each in newest.parent.iterdir()}
    assert len(names) == ROBOTS
    assert "robot0" not in names
