"""`armadico explore` and `armadico map`: what is kept, and what is refused beforehand."""

from __future__ import annotations

from pathlib import Path

import pytest

from armadico.agents.missions.commands import explore
from armadico.config import grid_map
from armadico.config.grid_map import FREE
from armadico.config.scenarios import exploring, load_scenario
from armadico.config.worlds import load_world
from armadico.launch.virtual import Rehearsal
from tests.programs import call, heavy, imports_nothing

EXACT = ("sc3", "--sensors", "ideal")
LASER = ("--profile", "jackal", "--sensors", "real", "--virtual")
"""A robot with sonars, whose odometry has no error."""


@pytest.mark.parametrize("name", ["explore", "map"])
def test_help_has_examples_and_imports_nothing_heavy(name: str) -> None:
    done = heavy("armadico.cli", [name, "--help"], ("numpy", "zenoh", "msgspec", "cbor2", "rich"))
    assert imports_nothing(done)
    assert done.stdout.count(f"  armadico {name} ") >= 2


def test_an_exploration_ends_with_a_map_that_can_be_gone_on_with(tmp_path: Path) -> None:
    """A robot that nobody told anything, to the far end of a small world and back."""
    assert "path-planning" not in exploring(load_scenario("sc3")).agents
    saved, picture = tmp_path / "sc3.yaml", tmp_path / "sc3.png"
    words = ("explore", *EXACT, "--virtual", "--seed", "1", "--map", str(saved))
    done = call(*words, "--plot", str(picture))
    assert done.returncode == 0, done.stderr
    assert "exploration done" in done.stderr
    assert picture.read_bytes().startswith(b"\x89PNG")
    cells = grid_map.read(saved)
    assert cells.area(FREE) > 10.0
    assert load_world(saved).walls
    again = tmp_path / "again.map"
    words = ("explore", *EXACT, "--virtual", "--resume", str(saved), "--map", str(again))
    resumed = call(*words, "--json")
    assert resumed.returncode == 0, resumed.stderr
    assert "0 of them not reached" in resumed.stderr
    assert load_world(again).walls
    places = [int(run.stderr.partition("known, ")[2].split()[0]) for run in (done, resumed)]
    assert places[1] < places[0] / 2


def test_a_virtual_one_that_is_interrupted_keeps_the_map_so_far(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def goes_on(_run: Rehearsal, elapsed: float) -> bool:
        if elapsed > 5.0:
            raise KeyboardInterrupt
        return True

    monkeypatch.setattr(Rehearsal, "goes_on", goes_on)
    saved = tmp_path / "so-far.yaml"
    with pytest.raises(KeyboardInterrupt):
        explore.main([*EXACT, "--virtual", "--no-plot", "--map", str(saved)])
    assert grid_map.read(saved).area(FREE) > 0.0


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        (("explore",), 2, "name a scenario"),
        (("explore", "sc3", "--goal", "1", "1", "0"), 2, "--goal"),
        (("explore", "sc3", "--virtual", "--within", "2", "0", "1", "1"), 2, "X1 < X2"),
        (("explore", "sc3", "--virtual", "--within", "0", "0", "1e7", "1"), 2, "1,000,000 m"),
        (("explore", "sc3", "--virtual", "--within", "-1e7", "0", "1", "1"), 2, "1,000,000 m"),
        (("explore", "sc3", "--virtual", "--within", "-1e5"), 2, "expected 4 arguments"),
        (("explore", "sc3", "--virtual", "--within", "0", "0", "1", "inf"), 2, "1,000,000 m"),
        (("explore", "sc3", "--virtual", "--map", "a.png"), 2, "expected .yaml"),
        (("explore", "sc3", "--virtual", "--map", "/proc/a.map"), 1, "cannot write /proc/a.map"),
        (("explore", "sc3", "--virtual", "--map", "/no/such/a.map"), 1, "no such folder"),
        (("explore", "sc3", "--virtual", "--runs", "2", "--map", "a.map"), 2, "one run's map"),
        (("explore", "sc3", "--virtual", "--resume", "/no/such.yaml"), 2, "/no/such.yaml"),
        (("explore", "sc3", "--attach", "--resume", "a.yaml"), 2, "--resume"),
        (("explore", "sc3", "--virtual"), 2, "pioneer-2dx"),
        (("explore", *EXACT, "--virtual", "--without", "mapping"), 2, "without mapping"),
        (("explore", "sc3", *LASER, "--with", "localization"), 2, "with localization"),
        (("explore", "sc3", *LASER, "--without", "encoder"), 2, "can be without gothrough"),
        (("explore", *EXACT, "--virtual", "--within", "5", "0", "6", "2"), 1, "not in the rect"),
        (("map",), 2, "what"),
        (("map", "load", "a.yaml"), 2, "a.yaml: there is no such file"),
        (
            ("explore", "house", "--profile", "jackal", "--virtual", "--resume", "a.yaml"),
            2,
            "a.yaml",
        ),
        (("map", "save", "a.png"), 2, "expected .yaml"),
    ],
)
def test_a_wrong_use_is_told_clearly(words: tuple[str, ...], code: int, says: str) -> None:
    done = call(*words)
    assert done.returncode == code, done.stderr
    assert says in done.stderr
    assert "Traceback" not in done.stderr
