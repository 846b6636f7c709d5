"""Societies of several packages: who takes part when a robot with a laser explores."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from armadico.agents.missions.messages import ExploreRequest
from armadico.config.scenarios import exploring, load_scenario, with_sensors
from armadico.core.config_errors import ConfigError
from armadico.launch.society import (
    Options,
    errand,
    members,
    prepared,
)

JACKAL = prepared(load_scenario("house"), Options(), profile="jackal")


def test_a_robot_with_a_laser_and_real_sensors_explores_by_slam() -> None:
    found = [member.name for member in members(exploring(JACKAL), Options(), "memory:")]
    assert {"slam", "explore", "laser", "path-planning"} < set(found)
    assert not {"localization", "relocate", "mapping"} & set(found)
    exact = exploring(with_sensors(JACKAL, "ideal"))
    assert "mapping" in exact.agents
    assert not {"slam", "path-planning"} & set(exact.agents)


def test_an_exploration_leaves_out_the_mission() -> None:
    found = exploring(prepared(load_scenario("surveillance"), Options(), profile="jackal"))
    assert isinstance(errand(found, Options()), ExploreRequest)
    assert not {"mission-planning", "battery-charger", "dock"} & set(found.agents)


@pytest.mark.parametrize("rival", ["localization", "mapping"])
def test_slam_beside_an_agent_that_publishes_the_same_is_refused(rival: str) -> None:
    agents = (*exploring(JACKAL).agents, rival)
    with pytest.raises(ConfigError, match=f"agents slam and {rival}: .*--without {rival}"):
        members(replace(JACKAL, agents=agents), Options(), "memory:")
    members(replace(JACKAL, agents=agents), Options(without=(rival,)), "memory:")
