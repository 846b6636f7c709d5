"""`armadico run --watch`: again whenever a file changes that a run has read, and what moved."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from msgspec.structs import replace

from armadico.cli import options, watch
from armadico.cli.watch import Outcome, Watched, drive, edited, moved
from armadico.observe.measures import Result
from tests.cli.test_run import run
from tests.house.tree import ROOT

SCENARIO = 'world = "my.map"\nsensors = "ideal"\nstart = [1, 1, 0]\ngoal = [{x}, 1, 0]\n'
MAP = """\
2D-Map
LineMinPos: 0 0
LineMaxPos: 4000 2000
NumLines: 4
LINES
0 0 4000 0
4000 0 4000 2000
4000 2000 0 2000
0 2000 0 0
DATA
"""

NOW = 2**63
"""Later than any file was written."""

DRIVEN = Result("made up", 3, True, 5.0, 0.5, 20.0, 98.0, {"goto": 100.0}, 2, 0, 0.3)

Captured = pytest.CaptureFixture[str]


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def aged(path: Path) -> Path:
    """As if it had been written an hour before."""
    os.utime(path, ns=(path.stat().st_mtime_ns - 3_600_000_000_000,) * 2)
    return path


def written(name: str, text: str) -> Path:
    Path(name).write_text(text)
    return Path(name)


# What has changed ---------------------------------------------------------------------------------


def test_what_is_edited_put_in_place_or_back_has_changed() -> None:
    edited, replaced, gone, still = (aged(written(name, "1")) for name in "abcd")
    watched = Watched()
    watched.add([edited, replaced, gone, still], since_ns=NOW)
    assert watched.changed() == []
    edited.write_text("2")
    aged(written("new", "1")).replace(replaced)
    gone.unlink()
    assert watched.changed() == [edited, replaced]
    assert watched.changed() == []
    gone.write_text("1")
    assert watched.changed() == [gone]


def test_what_was_written_while_the_run_read_it_has_changed() -> None:
    path = written("a", "1")
    watched = Watched()
    watched.add([path], since_ns=path.stat().st_mtime_ns)
    assert watched.changed() == [path]
    watched.add([path], since_ns=0)
    assert watched.changed() == []


def test_it_waits_until_an_editor_is_done() -> None:
    one, two = (aged(written(name, "1")) for name in "ab")
    watched = Watched()
    watched.add([one, two], since_ns=NOW)
    steps: Iterator[Callable[[], object]] = iter(
        [lambda: None, lambda: one.write_text("2"), lambda: two.write_text("2"), lambda: None]
    )
    assert watched.wait(lambda: (next(steps)(), None)[1]) == [one, two]
    assert not [*steps]


def test_only_what_a_person_edits_is_watched(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(here / "cache"))
    (here / "cache").mkdir()
    mine = written("mine.toml", "")
    paths = [mine, written("cache/kept.npz", ""), written("x.pyc", ""), here, here / "none"]
    others = [os.__file__, pytest.__file__, "/proc/self/stat", "/dev/null"]
    ours = str(ROOT / "agents" / "goto.py")
    found = edited([*map(str, paths), *others, ours, str(ROOT / "armadico/agents/goto.py")])
    assert found == sorted([str(mine.resolve()), ours])


# What moved ---------------------------------------------------------------------------------------


def test_what_moved_is_told_since_the_last_and_since_the_first_run() -> None:
    better = replace(DRIVEN, tt_s=18.0, exchanges=5, shares={"goto": 90.0, "avoid": 10.0})
    assert [" ".join(line.split()) for line in moved(DRIVEN, DRIVEN, better)] == [
        "TT s 20.00 -> 18.00 -2.00",
        "avoid % 0.00 -> 10.00 +10.00",
        "goto % 100.00 -> 90.00 -10.00",
        "exch. 2 -> 5 +3",
    ]
    worse = replace(DRIVEN, tt_s=21.5, min_clearance_m=None)
    assert next(" ".join(line.split()) for line in moved(DRIVEN, better, worse)) == (
        "TT s 18.00 -> 21.50 +3.50, +1.50 since the first run"
    )
    assert moved(DRIVEN, DRIVEN, worse)[-1].split() == ["clear.", "m", "0.30", "->", "-"]
    assert moved(DRIVEN, DRIVEN, replace(DRIVEN, tt_s=20.001)) == []


# The whole of it ----------------------------------------------------------------------------------


@dataclass
class Person:
    """Does one thing between looks when the last run is over, and then interrupts."""

    steps: list[Callable[[], object]]
    patient: bool = False

    def pause(self) -> None:
        if self.patient:  # the look at which no more changes
            self.patient = False
        elif self.steps:
            self.steps.pop(0)()
            self.patient = True
        else:
            raise KeyboardInterrupt


def test_a_run_has_read_its_scenario_its_map_and_every_agents_code(here: Path) -> None:
    written("my.map", MAP)
    written("my.toml", SCENARIO.format(x=2))
    outcome = drive(["my.toml", "--virtual"])
    assert outcome.code == 0
    assert outcome.result is not None
    assert outcome.result.reached
    ours = {here / "my.toml", here / "my.map"}
    agents = {ROOT / "agents" / "goto.py", ROOT / "armadico" / "core" / "behaviour.py"}
    assert outcome.read >= {path.resolve() for path in ours | agents}
    assert all(
        path.is_relative_to(here.resolve()) or path.is_relative_to(ROOT) for path in outcome.read
    )
    written("my.toml", "goal = [")
    broken = drive(["my.toml", "--virtual"])
    assert broken.code == options.USAGE
    assert broken.result is None or not broken.result.reached
    assert here.resolve() / "my.toml" in broken.read


def test_it_runs_again_until_ctrl_c(
    here: Path, capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a run is made of is tried above: here its outcome is made up."""
    mine = aged(written("my.toml", ""))
    seen: list[list[str]] = []
    outcomes = [
        Outcome(0, DRIVEN, frozenset({mine})),
        Outcome(2, None, frozenset()),  # half an edit
        Outcome(1, replace(DRIVEN, tt_s=25.0, reached=False), frozenset({mine})),
        Outcome(1, replace(DRIVEN, tt_s=25.0, reached=False), frozenset({mine})),
    ]
    monkeypatch.setattr(watch, "drive", lambda words: seen.append(words) or outcomes.pop(0))
    person = Person([lambda n=n: mine.write_text(str(n)) for n in ("[", "22", "333")])
    assert watch.main(["my.toml", "--virtual"], person.pause) == 0
    assert seen == [["my.toml", "--virtual"]] * 4
    said = capsys.readouterr().out.splitlines()
    assert said[0] == f"{DRIVEN.scenario} seed 3: {DRIVEN.verdict}"
    assert "Ctrl-C ends it" in said[1]
    assert said[2:4] == ["changed: my.toml"] * 2
    assert said[4].startswith("made up seed 3: NOT reached")
    assert said[5].split() == ["TT", "s", "20.00", "->", "25.00", "+5.00"]
    assert said[6] == "changed: my.toml"
    assert said[8] == "  nothing moved"
    assert len(said) == 9


def test_a_first_run_that_was_called_wrongly_is_the_last(
    here: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    written("my.map", MAP)
    written("my.toml", SCENARIO.format(x=2))
    code = watch.main(
        ["my.toml", "--virtual", "--controller", "fastt"], lambda: pytest.fail("it waits")
    )
    assert code == options.USAGE
    assert "fastt" in capfd.readouterr().err


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("sc1",), "--virtual"),
        (("sc1", "--virtual", "--runs", "3"), "--runs"),
        (("sc1", "--virtual", "--json"), "--json"),
        (("fleet", "--virtual"), "one robot"),
        (("sc11", "--virtual"), "did you mean 'sc1'?"),
        (("--virtual",), "name a scenario"),
    ],
)
def test_what_cannot_be_watched_is_refused(
    capsys: Captured, words: tuple[str, ...], says: str
) -> None:
    code, out, err = run(capsys, *words, "--watch")
    assert (code, out) == (options.USAGE, "")
    assert says in err
