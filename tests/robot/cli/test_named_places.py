"""Names of places on the command line: listed, added, removed, driven to."""

from __future__ import annotations

import json
import math
from contextlib import ExitStack
from pathlib import Path

import pytest

from armadico.cli import goto, main
from armadico.cli.options import gazetteer
from armadico.config.named import DATA_VARIABLE
from armadico.launch.pidfile import PidFile, Share

Captured = pytest.CaptureFixture[str]

NOBODY = ("--namespace", "nobody-is-here")


@pytest.fixture(autouse=True)
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(DATA_VARIABLE, str(tmp_path))


def run(*words: str) -> int:
    return main([*words, *NOBODY])


def test_a_place_is_added_listed_and_removed(capsys: Captured) -> None:
    assert run("places", "add", "kitchen", "2", "1.5", "90", "--world", "house") == 0
    assert run("places", "--world", "house", "--json") == 0
    found = json.loads(capsys.readouterr().out.splitlines()[-1])
    kitchen = {"name": "kitchen", "sort": "added", "x": 2.0, "y": 1.5, "heading_deg": 90.0}
    assert kitchen in found
    assert run("places", "remove", "kitchen", "--world", "house") == 0
    assert run("places", "--world", "house") == 0
    assert "kitchen" not in capsys.readouterr().out.splitlines()[-1]


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("places", "add"), "NAME"),
        (("places", "remove", "E", "2"), "one word too many"),
        (("places", "add", "kitchen"), "here, or X Y"),
        (("places", "add", "kitchen", "2", "y"), "here, or X Y"),
        (("places", "add", "kitchen", "2", "1", "400"), "360"),
        (("places", "remove", "E"), "edit the map"),
        (("places", "remove", "F"), "no place 'F'"),
        (("goto", "coridor"), "did you mean 'corridor'"),
        (("goto", "4"), "X Y [DEG]"),
        (("goto", "4", "1e9"), "at most"),
    ],
)
def test_wrong_words_are_named_and_nothing_is_done(
    words: tuple[str, ...], why: str, capsys: Captured
) -> None:
    assert run(*words, "--world", "house") == 2
    assert why in capsys.readouterr().err


def test_without_a_world_it_is_said_what_to_give(capsys: Captured) -> None:
    for words in (("places",), ("goto", "kitchen")):
        assert run(*words) == 2
        assert "--world" in capsys.readouterr().err


def test_the_pose_of_a_robot_that_is_not_there_gets_no_name(capsys: Captured) -> None:
    assert run("places", "add", "kitchen", "here", "--world", "house") == 1
    assert "kitchen" not in capsys.readouterr().out


def test_numbers_are_a_pose_as_ever() -> None:
    found = goto.goal(goto.main.parse(["-1", ".5", "-90"]))
    assert found == (-1.0, 0.5, pytest.approx(-math.pi / 2))
    assert goto.goal(goto.main.parse(["4", "+2"])) == (4.0, 2.0, None)


def test_the_world_is_that_of_the_society_that_runs_here(tmp_path: Path) -> None:
    with ExitStack() as stack:
        file = stack.enter_context(PidFile("nobody-is-here", "desk"))
        robot = "turtlebot4"
        file.write(Share(1, "desk", "nobody-is-here", ("goto",), "", world="house", robot=robot))
        found = gazetteer(None, "nobody-is-here")
        assert found is not None
        assert found.world.name == "house"
        other = gazetteer("sc1", "nobody-is-here")
        assert other is not None
        assert other.world.name == "sc1", "--world comes first"
    assert gazetteer(None, "nobody-is-here") is None
