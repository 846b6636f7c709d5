"""Scenarios with missions and docks."""

from __future__ import annotations

from pathlib import Path

import pytest
from msgspec.structs import replace

from armadico.config.mapwriter import write_map
from armadico.config.profile import POSE_M, load_profile
from armadico.config.scenarios import (
    load_scenario,
    on_mission,
)
from armadico.config.slots import slot
from armadico.config.worlds import DOCK_LANE_M, load_world
from armadico.core.config_errors import ConfigError
from tests.robot.config.test_scenarios import OWN, own


def test_a_dock_that_a_wall_is_in_the_way_of_is_refused(tmp_path: Path) -> None:
    world = load_world("sc4")
    before_m = DOCK_LANE_M + load_profile("pioneer-2dx").body.circle_m + 0.5 * POSE_M
    for dock in (
        (4.40, 1.0, 0.0),  # its front in a wall
        (0.3, 1.0, 0.0),  # and before it
        (before_m, 1.0, 0.0),  # and there room to turn, but none for the error of the pose
    ):
        file = tmp_path / "docked.map"
        write_map(replace(world, docks={"one": dock}), file)
        text = OWN.replace('"sc4"', f'"{file}"')
        load_scenario(own(tmp_path, text))  # nobody is to be charged
        text += 'agents = ["encoder", "battery-charger", "dock"]\n'
        with pytest.raises(ConfigError, match=r"own\.toml:1: .*dock 'one'"):
            load_scenario(own(tmp_path, text))


def on_a_mission(folder: Path, *lines: str) -> Path:
    file = folder / "s.toml"
    given = ['world = "surveillance"', "start = [1.5, 2.0, 90.0]", *lines]
    file.write_text("\n".join(given), encoding="utf-8")
    return file


def test_where_a_mission_is_done_those_take_part_who_do_it(tmp_path: Path) -> None:
    scenario = load_scenario(on_a_mission(tmp_path, 'mission = "surveillance"'))
    assert "mission-planning" not in scenario.agents
    doing = on_mission(scenario)
    assert set(doing.agents) == {*scenario.agents, *slot("missions").besides}
    assert on_mission(doing) == doing
    assert on_mission(load_scenario("house")) == load_scenario("house")
    other = on_mission(load_scenario("surveillance"), "rounds")
    assert (other.mission, other.goal) == ("rounds", None)
