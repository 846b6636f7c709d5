"""The day of surveillance: its missions can be read, and its books are right."""

from __future__ import annotations

import zlib

import pytest
from msgspec.structs import replace

from armadico.agents.missions.messages import (
    Board,
    BoardMission,
    Course,
    MissionEnd,
    StepEnd,
    StepResult,
)
from armadico.agents.missions.mission_file import read_mission
from armadico.config.places import Places
from armadico.config.profile import load_profile
from armadico.config.worlds import load_world
from armadico_tools.experiments import surveillance
from armadico_tools.experiments.surveillance import Day, Watchman, as_table, scenario, text_of


def test_a_mission_of_the_day_can_be_done_in_its_building() -> None:
    found = scenario()
    places = Places(load_world(found.world), load_profile(found.robot).body)
    mission = read_mission(text_of(["R1", "R21"], 0.8), "photos", places, found.start[:2])
    assert mission.priority == 0.8
    assert [step.do for step in mission.procedures[""].steps] == ["move", "take-photo"] * 2


def test_a_full_battery_lasts_for_two_hours_half_of_them_driven() -> None:
    capacity = scenario().battery.capacity_ah
    assert capacity is not None
    assert 1.0 < capacity < load_profile("pioneer-2dx").battery.capacity_ah


def test_what_becomes_of_each_mission_is_counted_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(surveillance, "MISSION_EVERY_S", 1e9)
    monkeypatch.setattr(surveillance, "ALARM_EVERY_S", 1e9)
    watchman = Watchman(5, 0.001)
    watchman.ordered = {7: None}
    for state in (
        *(MissionEnd.QUEUED, MissionEnd.ACTIVE, MissionEnd.ACTIVE, MissionEnd.SUSPENDED),
        *(MissionEnd.ACTIVE, MissionEnd.DONE, MissionEnd.DONE),
    ):
        looked = StepResult("check-alarm(R1)", StepEnd.DONE, "", 1.0)
        course = Course(results=(looked, replace(looked, end=StepEnd.FAILED)))
        text = zlib.compress(b"")
        mission = BoardMission(7, "photos", 0.5, state, text=text, course=course)
        watchman._board(Board(1, 1, (mission,)))
    assert watchman.ordered == {7: MissionEnd.DONE}
    assert watchman.counts["checked"] == 1
    assert watchman.counts["suspended"] == watchman.counts["resumed"] == 1


def test_a_mission_without_a_reported_end_is_lost() -> None:
    lost = Day(1, 8.0, 3, 0, 2, 0, 1, 0, 0, 4, 1, 1, 2, 11.5, 0.3, 0, ())
    assert "| 1 | 3 | 0 | 2 | 0 | 1 |" in as_table([lost])
