"""`armadico explore` and `armadico map`: what is kept, and what is refused beforehand."""

from __future__ import annotations

from pathlib import Path

import pytest

from armadico import cli
from armadico.agents.missions.commands import explore
from armadico.config import grid_map
from armadico.config.grid_map import FREE
from armadico.config.scenarios import exploring, load_scenario
from armadico.config.worlds import load_world
from armadico.launch.virtual import Rehearsal
from tests.programs import call

EXACT = ("sc3", "--sensors", "ideal")


def test_an_exploration_ends_with_a_map_that_can_be_gone_on_with(tmp_path: Path) -> None:
    """A robot that nobody told anything, to the far end of a small world and back."""
    assert "path-planning" not in exploring(load_scenario("sc3")).agents
    saved = tmp_path / "sc3.yaml"
    words = ("explore", *EXACT, "--virtual", "--seed", "1", "--map", str(saved))
    done = call(*words)
    assert done.returncode == 0, done.stderr
    assert "exploration done" in done.stderr
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
        explore.main([*EXACT, "--virtual", "--map", str(saved)])
    assert grid_map.read(saved).area(FREE) > 0.0


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--map", "/proc/a.map"), "cannot write /proc/a.map"),
        (("--map", "/no/such/a.map"), "no such folder"),
        (("--within", "5", "0", "6", "2"), "not in the rect"),
    ],
)
def test_what_cannot_be_done_is_said_and_the_exit_code_is_1(
    words: tuple[str, ...], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["explore", *EXACT, "--virtual", *words]) == 1
    assert says in capsys.readouterr().err
