"""What `armadico up` makes of the name of a mission."""

from __future__ import annotations

from pathlib import Path

import pytest

from armadico.cli.options import UsageError
from armadico.cli.up import _scenario, main
from armadico.config.needs import needs, tasks
from armadico.config.scenarios import society
from armadico.launch.supervisor import Plan
from tests.robot.cli.test_up import no_table, plan  # noqa: F401 - a fixture


def names(found: Plan) -> list[str]:
    return [member.name for member in found.members]


def test_a_mission_is_as_few_as_it_needs_in_its_own_scenario_and_who_watches() -> None:
    found = plan("rounds")
    scenario = _scenario(main.parse(["rounds"]))
    assert scenario is not None
    assert scenario.name == "surveillance"
    assert names(found) == [*needs(tasks(scenario), helps=True), *society().watch]
    assert {"mission-planning", "battery-charger", "planner-onward"} < set(names(found))
    assert "mapping" not in names(found)
    assert {"mission-planning", "battery-charger"} < set(found.needs)
    assert not {"planner-onward", "relocate", "monitor"} & set(found.needs), "it goes on without"


def test_a_mission_of_ones_own_needs_what_its_steps_do(tmp_path: Path) -> None:
    file = tmp_path / "look.toml"
    file.write_text(
        'scenario = "surveillance"\nenergy = "risk"\nsteps = [{ do = "move", to = "R1" }]\n'
    )
    found = names(plan(str(file)))
    assert "mission-planning" in found
    assert not {"battery-charger", "planner-onward"} & set(found)


def test_a_mission_without_a_scenario_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "look.toml"
    file.write_text('steps = [{ do = "wait", seconds = 1.0 }]\n')
    with pytest.raises(UsageError, match="look"):
        plan(str(file))
