"""What kinds of task need, by the table that is shipped and by others."""

from __future__ import annotations

import pytest

from armadico.config.needs import needs, tasks
from armadico.config.scenarios import ideal, load_scenario, with_sensors
from armadico.core.config_errors import ConfigNameError

SC4 = load_scenario("sc4")


def test_to_go_to_a_point_needs_what_the_thesis_says() -> None:
    """3.8.3: the robot, the encoder, the sonar, the goto, the gothrough, the avoid and the path
    planning agents; and who takes missions."""
    assert set(needs(["move"])) == {
        *("robot", "encoder", "sonar", "goto", "gothrough", "avoid", "path-planning", "interface"),
    }


@pytest.mark.parametrize(
    ("scenario", "kinds"),
    [
        (SC4, ("move", "localize")),
        (ideal(SC4), ("move",)),
        (load_scenario("sc1"), ("drive",)),
        (with_sensors(load_scenario("sc1"), "real"), ("drive", "localize")),
        (None, ("move", "localize")),
    ],
)
def test_which_tasks_a_scenario_is(scenario: object, kinds: tuple[str, ...]) -> None:
    assert tasks(scenario) == kinds  # type: ignore[arg-type]


def test_an_unknown_task_is_told_with_the_nearest() -> None:
    with pytest.raises(ConfigNameError) as caught:
        needs(["mvoe"])
    assert (caught.value.kind, caught.value.near) == ("task", "move")
