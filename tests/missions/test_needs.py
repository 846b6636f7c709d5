"""What an exploration needs."""

from __future__ import annotations

from armadico.config.needs import needs
from armadico.config.scenarios import society


def test_several_tasks_need_all_that_each_of_them_does_once_and_the_robot_first() -> None:
    both = needs(["explore", "move"])
    assert both[0] == society().robot
    assert len(both) == len(set(both))
    assert {"mapping", "path-planning"} < set(both)
