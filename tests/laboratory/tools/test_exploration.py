"""Explorations are judged by the true world, and finished ones are kept."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from armadico.config.grid_map import FREE, OCCUPIED, UNKNOWN, Cells
from armadico.config.worlds import World, hull
from armadico_tools.experiments import exploration
from armadico_tools.experiments.exploration import Explored, Task, explore, judged
from armadico_tools.experiments.runner import Context, Experiment, Part

WALLS = ((0.0, 0.0, 4.0, 0.0), (4.0, 0.0, 4.0, 2.0), (4.0, 2.0, 0.0, 2.0), (0.0, 2.0, 0.0, 0.0))
ROOM = World("room", WALLS, hull(WALLS))
START = (1.0, 1.0)


def mapped(*, off: float = 0.0, known: float = 5.0) -> Cells:
    """The room as a map that is moved along x, and unknown from some x on."""
    states = np.full((42, 82), OCCUPIED, dtype=np.uint8)
    states[1:-1, 1:-1] = FREE
    states[:, 1 + round(known / 0.05) :] = UNKNOWN
    return Cells(-0.05 + off, -0.05, 0.05, states)


def test_a_map_is_right_where_it_agrees_with_the_world() -> None:
    assert judged(mapped(), ROOM, START, 0.2) == (1.0, 1.0, 1.0)
    moved = judged(mapped(off=0.3), ROOM, START, 0.2)
    assert 0.6 < moved.occupied_right < 0.7  # both walls along x and no other
    assert moved.right < 0.95


def test_what_the_robot_could_reach_and_does_not_know_counts() -> None:
    assert judged(mapped(known=2.0), ROOM, START, 0.2).reached == pytest.approx(0.5, abs=0.05)


@pytest.mark.long
def test_an_exploration_is_judged_and_not_driven_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tasks = [Task("sc3", "turtlebot3-burger", 1)]
    one = Experiment((Part("runs", explore, lambda _: tasks),), exploration.report)
    context = Context(tmp_path, runs=1, source="here")
    context.run(one, "x")
    (found,) = context.found["runs"]
    assert isinstance(found, Explored)
    assert found.good, found
    assert "1 of 1" in (tmp_path / "table.md").read_text()

    def refuse(_task: Task) -> Explored:
        raise AssertionError("it was driven again")

    monkeypatch.setattr(exploration.Exploration, "go", refuse)
    again = Context(tmp_path, runs=1, source="here")
    again.run(one, "x")
    assert again.found["runs"] == [found]
