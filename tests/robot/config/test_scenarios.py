"""The shipped worlds and scenarios can be driven; a scenario that cannot says why and where."""

from __future__ import annotations

import re
from math import pi
from pathlib import Path

import msgspec
import pytest
from msgspec.structs import replace

from armadico.config.loading import resource_path
from armadico.config.profile import load_profile
from armadico.config.scenarios import (
    Battery,
    _misplaced,
    blind,
    ideal,
    load_scenario,
    planned,
    scenario_from,
    society,
    with_sensors,
)
from armadico.config.worlds import load_world
from armadico.core.config_errors import ConfigError

WITH_DOCKS = ["floor", "house", "offices", "surveillance"]


def test_who_localizes_follows_the_sensors_unless_the_scenario_names_its_agents() -> None:
    everybody, spared = society().agents, set(society().ideal.without)
    sc1 = load_scenario("sc1")
    assert set(sc1.agents) == set(everybody) - spared
    assert with_sensors(sc1, "real").agents == everybody
    assert with_sensors(sc1, "ideal") == ideal(sc1) == sc1
    named = replace(sc1, agents=("encoder", "localization", "goto"))
    assert with_sensors(named, "real").agents == named.agents
    with pytest.raises(ConfigError, match="no sensors 'rael'"):
        with_sensors(sc1, "rael")


# --- what is refused

OWN = """\
world = "sc4"
start = [1, 1, 0]
goal = [8, 1, 0]
waypoints = [
  [1.5, 2, 90],
  [1.5, 3.6, 0],
]
plan = "rooms"
"""


def own(folder: Path, text: str = OWN) -> Path:
    file = folder / "own.toml"
    file.write_text(text)
    return file


def test_files_count_from_the_scenarios_folder_not_from_where_it_is_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    there, here = tmp_path / "there", tmp_path / "here"
    for folder in (there, here):
        folder.mkdir()
        (folder / "mine.map").write_bytes(resource_path("worlds", "sc4").read_bytes())
    (there / "mine.toml").write_bytes(resource_path("robots", "pioneer-2dx").read_bytes())
    text = OWN.replace('"sc4"', '"mine.map"').replace("plan =", 'robot = "./mine.toml"\nplan =')
    monkeypatch.chdir(here)
    scenario = load_scenario(own(there, text))
    assert scenario.world == str(there / "mine.map")
    assert scenario.robot == str(there / "mine.toml")
    (there / "mine.map").unlink()
    with pytest.raises(ConfigError, match=r"there/mine\.map"):
        load_scenario(there / "own.toml")


def test_waypoints_that_are_wanted_must_be_there(tmp_path: Path) -> None:
    text = 'world = "empty"\nstart = [0, 0, 0]\ngoal = [1, 1, 0]\nplan = "waypoints"\n'
    with pytest.raises(ConfigError, match=r"own.toml:4: .*waypoints"):
        load_scenario(own(tmp_path, text))


def test_a_fault_in_the_world_is_named_in_the_worlds_file(tmp_path: Path) -> None:
    (tmp_path / "hall.map").write_text("2D-Map\nLINES\n1 2 3\n")
    with pytest.raises(ConfigError, match=r"hall.map:3: "):
        load_scenario(own(tmp_path, OWN.replace("sc4", "hall.map")))


# --- from the command line


def test_a_goal_is_a_pose_or_a_name() -> None:
    by_name = scenario_from("sc4", goal="B")
    by_pose = scenario_from("sc4", (3.4, 0.6, pi / 2), (7.4, 0.7, -pi / 2))
    assert by_name == by_pose
    assert planned(by_name)
    assert not planned(scenario_from("sc1", goal="goal"))


HALL = """\
2D-Map
LineMinPos: 0 0
LineMaxPos: 9000 9000
Cairn: RobotHome 1000 1000 0 "" ICON "RobotHome"
LINES
0 5000 8000 5000
DATA
"""
"""Somebody else's map: no rooms of ours."""


@pytest.mark.parametrize(
    ("plan", "asks", "into_the_wall"),
    [("", True, False), ('plan = "direct"', False, True), ('plan = "rooms"', True, False)],
)
def test_a_map_with_walls_is_planned_whoever_made_it(
    tmp_path: Path, plan: str, asks: bool, into_the_wall: bool
) -> None:
    (tmp_path / "hall.map").write_text(HALL)
    own = tmp_path / "own.toml"
    own.write_text(f'world = "hall.map"\nstart = [1, 1, 0]\ngoal = [1, 8, 0]\n{plan}\n')
    scenario = load_scenario(own)
    assert planned(scenario) == asks
    assert blind(scenario) == into_the_wall
    assert planned(scenario_from(tmp_path / "hall.map", goal=(1.0, 8.0, 0.0)))


STAIRS = """\
2D-Map
LineMinPos: 0 0
LineMaxPos: 9000 9000
Cairn: RobotHome 1000 1000 0 "" ICON "RobotHome"
Cairn: ForbiddenLine 0 0 0 "" ICON "" 0 5000 8000 5000
DATA
"""
"""Nothing but what no sensor sees."""


def test_what_is_forbidden_alone_is_planned_round_and_no_place_to_be_sent_to(
    tmp_path: Path,
) -> None:
    file = tmp_path / "stairs.map"
    file.write_text(STAIRS)
    beyond = scenario_from(file, goal=(1.0, 8.0, 0.0))
    assert planned(beyond)
    assert blind(msgspec.structs.replace(beyond, plan="direct"))
    with pytest.raises(ConfigError, match=r"goal \(1, 4.9\)"):
        scenario_from(file, goal=(1.0, 4.9, 0.0))


def test_a_straight_way_that_is_free_is_not_blind(tmp_path: Path) -> None:
    (tmp_path / "hall.map").write_text(HALL)
    along = scenario_from(tmp_path / "hall.map", goal=(7.0, 4.0, 0.0))
    assert not blind(msgspec.structs.replace(along, plan="direct"))
    assert not blind(scenario_from(tmp_path / "hall.map"))
    assert [blind(load_scenario(name)) for name in ("sc1", "sc2", "sc3", "sc4")] == [
        False,
        True,
        True,
        False,
    ]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("sc4", None, "C"), "'C'"),
        (("sc4", (4.7, 1.0, 0.0), "B"), "start (4.7, 1)"),
        (("sc4", None, (10.0, 1.0, 0.0)), "goal (10, 1)"),
        (("sc9", None, None), "'sc9'"),
        (("sc4", (float("nan"), 1.0, 0.0), "B"), "start (nan, 1)"),
        (("sc4", (498532.0, 4.5e6, 0.0), "B"), "start (498532, 4.5e+06)"),
    ],
)
def test_a_run_that_cannot_be_is_refused(
    arguments: tuple[
        str, tuple[float, float, float] | None, tuple[float, float, float] | str | None
    ],
    message: str,
) -> None:
    with pytest.raises(ConfigError) as caught:
        scenario_from(*arguments)
    assert message in str(caught.value)


def test_a_world_without_a_start_wants_one(tmp_path: Path) -> None:
    (tmp_path / "hall.map").write_text("2D-Map\nLineMaxPos: 9000 9000\nLineMinPos: 0 0\n")
    hall = tmp_path / "hall.map"
    with pytest.raises(ConfigError, match=r"'hall'.*--start"):
        scenario_from(hall)
    assert scenario_from(hall, (1.0, 1.0, 0.0)).goal is None


# --- batteries and docks


def test_a_scenario_says_what_is_left_of_the_battery_and_how_large_it_is(tmp_path: Path) -> None:
    assert load_scenario("sc1").battery == Battery(1.0, None)
    file = own(tmp_path, OWN + "[battery]\ncharge = 0.25\ncapacity_ah = 3.5\n")
    assert load_scenario(file).battery == Battery(0.25, 3.5)


@pytest.mark.parametrize("name", WITH_DOCKS)
def test_every_robot_can_drive_into_every_dock(name: str) -> None:
    world = load_world(name)
    assert world.start is not None
    x, y, theta = world.start
    for robot in ("pioneer-2dx", "amigobot"):
        scenario_from(name, (x, y, theta), robot=robot)


ROOMS = "2D-Map\nLINES\n0 0 9000 0\n9000 0 9000 6000\n9000 6000 0 6000\n0 6000 0 0\n"


@pytest.mark.parametrize(
    ("partition", "joined"),
    [
        ("4500 0 4500 6000", False),
        ("4500 0 4500 5900", False),  # a gap of 0.10 m
        ("4500 0 4500 5000", True),
        ("8000 0 8000 6000", True),  # behind the goal
    ],
)
def test_a_goal_that_walls_shut_off_is_an_error_before_anything_drives(
    tmp_path: Path, partition: str, joined: bool
) -> None:
    (tmp_path / "two.map").write_text(f"{ROOMS}{partition}\n")
    file = tmp_path / "own.toml"
    for plan in ("rooms", "seen", "direct"):
        file.write_text(
            f'world = "two.map"\nstart = [1, 1, 0]\ngoal = [6, 1, 0]\nplan = "{plan}"\n'
        )
        if joined:
            assert load_scenario(file).goal == (6.0, 1.0, 0.0)
            continue
        with pytest.raises(ConfigError, match=r"own\.toml:3: goal \(6, 1\).*start \(1, 1\)"):
            load_scenario(file)


@pytest.mark.parametrize(("y", "free"), [(0.3, True), (0.3 - 1e-9, True), (0.2999, False)])
def test_a_distance_that_is_too_small_reads_as_smaller_than_the_limit(y: float, free: bool) -> None:
    world, body = load_world("sc4"), load_profile("pioneer-2dx").body
    assert body.circle_m == pytest.approx(0.3, abs=1e-3)
    faults = [*_misplaced(world, ("start",), (1.0, y + body.circle_m - 0.3, 0.0), body)]
    if free:
        assert not faults
        return
    ((_, message),) = faults
    shown, least = map(float, re.findall(r"(\d\.\d+) m\b", message))
    assert shown < least
