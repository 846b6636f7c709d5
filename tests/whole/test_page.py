"""The page of a fleet, and of missions."""

from __future__ import annotations

import json

import pytest

from armadico.agents.fleet.commands.run import FleetRehearsal
from armadico.config.scenarios import load_scenario
from armadico.launch.society import Options
from armadico.launch.virtual_session import VirtualSession
from armadico.watch.page.model import Robot
from armadico.watch.page.session import Session
from tests.watch.page.stage import Shown, Stage


@pytest.fixture
def stage() -> Stage:
    made = Stage()
    made.ready()
    return made


def test_one_of_several_robots_is_stopped_alone() -> None:
    fleet = FleetRehearsal(load_scenario("fleet"), Options(seed=3), 2, "f")
    names = fleet.names
    places = [VirtualSession(fleet.mesh, name) for name in names]
    session, shown = Session({name: Robot(name) for name in names}, places), Shown()
    session.browsers = shown
    session.on_connect("page 1")
    while fleet.mesh.now < 3.0:
        session.turn()
    assert set(shown.parts) == set(names)
    session.on_message("page 1", json.dumps({"do": "stop", "id": 1, "robot": names[1]}))
    while fleet.mesh.now < 5.0:
        session.turn()
    assert [shown.parts[name]["stop"]["held"] for name in names] == [False, True]


def test_missions_are_ordered_by_name_and_unknown_names_are_refused(stage: Stage) -> None:
    answer = stage.ask("page 1", "order", mission="elsewhere")
    assert not answer["ok"]
    assert "'elsewhere'" in answer["text"]
    answer = stage.ask("page 1", "order", mission="surveillance")
    assert not answer["ok"]  # no agent plans missions here
