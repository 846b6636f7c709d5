"""Missions: what is read, and what is said of what is wrong, with file and line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from armadico.agents.missions.mission_file import Mission, Step, load_mission, read_mission
from armadico.config.places import Places
from armadico.config.profile import load_profile
from armadico.config.shipped import names
from armadico.config.worlds import Room, World, load_world
from armadico.core.config_errors import ConfigError

HOME = (1.5, 2.0)


@pytest.fixture(scope="module")
def building() -> Places:
    return Places(load_world("surveillance"), load_profile("pioneer-2dx").body)


def fault(text: str, places: Places | None = None, start: tuple[float, float] | None = None) -> str:
    with pytest.raises(ConfigError) as caught:
        read_mission(text, "m", places, start, "m.toml")
    return str(caught.value)


def steps(*rows: str, more: str = "") -> str:
    return "\n".join(["steps = [", *(f"  {{ {row} }}," for row in rows), "]", more])


@pytest.mark.parametrize("name", names("missions"))
def test_what_is_shipped_can_be_driven_in_its_building(name: str, building: Places) -> None:
    mission = load_mission(name, building, HOME)
    assert mission.scenario == "surveillance"
    assert mission.procedures[""].steps


def test_a_mission_is_its_steps_and_what_they_are_told(building: Places) -> None:
    mission = load_mission("surveillance", building, HOME)
    told = [str(step) for step in mission.procedures[""].steps]
    assert told == [
        *("move(hall)", "move(R1)", "take-photo"),
        *("move(hall)", "move(R11)", "take-photo", "move(hall)"),
    ]
    assert (mission.priority, mission.on_alarm, mission.energy) == (0.5, "check-alarm", "charge")


def test_a_step_says_when_how_often_how_long_and_what_if_not() -> None:
    text = steps(
        'do = "wait", seconds = 2, when = { battery_above = 0.5 }, repeat = 3, timeout_s = 9.0,'
        ' else = [{ do = "take-photo" }, { do = "wait", seconds = 1 }]'
    )
    (step,) = read_mission(text, "m").procedures[""].steps
    assert isinstance(step, Step)
    assert (step.do, step.arguments) == ("wait", (("seconds", 2.0),))
    assert step.when is not None
    assert step.when.battery_above == 0.5
    assert (step.repeat, step.timeout_s) == (3, 9.0)
    assert [other.do for other in step.otherwise] == ["take-photo", "wait"]


PHOTO = 'steps = [{ do = "take-photo" }]'


def look(row: str, *takes: str) -> str:
    """A mission with a procedure for alarms, of one step."""
    return (
        f'on_alarm = "look"\n{PHOTO}\n[procedures.look]\ntakes = {["room", *takes]}\n'
        f"steps = [\n  {{ {row} }},\n]"
    )


def test_a_room_without_a_way_in_cannot_be_reached_and_one_that_is_full_not_stood_in() -> None:
    shut = ((3.0, 0.0, 3.0, 3.0),)
    box = ((0.0, 0.0, 6.0, 0.0), (6.0, 0.0, 6.0, 3.0), (6.0, 3.0, 0.0, 3.0), (0.0, 3.0, 0.0, 0.0))
    rooms = (
        Room("A", 0.0, 0.0, 3.0, 3.0),
        Room("B", 3.0, 0.0, 6.0, 3.0),
        Room("C", 0.0, 0.0, 0.2, 3.0),
    )
    world = World("w", box + shut, (0.0, 0.0, 6.0, 3.0), rooms=rooms)
    places = Places(world, load_profile("pioneer-2dx").body)
    there = 'steps = [\n  { do = "move", to = "%s" },\n]'
    read_mission(there % "A", "m", places, (1.0, 1.0))
    read_mission(there % "B", "m", places)
    assert fault(there % "B", places, (1.0, 1.0)).startswith(
        "m.toml:2: 'B' cannot be reached from (1, 1)"
    )
    assert fault(there % "C", places).startswith(
        "m.toml:2: the robot can turn nowhere in room 'C' of 'w'"
    )


def test_around_a_building_nobody_is_and_where_nothing_has_a_name_anywhere(
    building: Places,
) -> None:
    points = np.array([[2.0, 2.0], [2.0, 8.0], [10.0, 5.0], [6.0, 8.0], [10.0, 2.0], [0.33, 5.0]])
    assert building.inhabited(points).tolist() == [True, True, True, False, False, True]
    nameless = World("w", building.world.walls, building.world.bounds)
    assert Places(nameless, load_profile("pioneer-2dx").body).inhabited(points).all()


def test_in_a_room_it_stands_in_the_middle_or_as_near_to_it_as_there_is_room() -> None:
    house = Places(load_world("house"), load_profile("pioneer-2dx").body)
    assert house.of("A") == (2.3, 2.0, None)
    x, y, _ = Places(load_world("rooms-a"), house._body).of("A")
    assert house.world.clearance(2.3, 1.5) > 0
    assert load_world("rooms-a").clearance(x, y) > 0.5
    assert abs(x - 2.3) + abs(y - 1.5) < 1.0


def test_a_too_long_text_or_an_invalid_name_is_refused() -> None:
    assert "16,000" in fault("#" * 16_001)
    with pytest.raises(ConfigError, match="a b"):
        read_mission(steps('do = "take-photo"'), "a b")


def test_procedures_are_nested_up_to_a_limit() -> None:
    chain = [f'[procedures.p{n}]\nsteps = [{{ do = "p{n + 1}" }}]' for n in range(9)]
    last = '[procedures.p9]\nsteps = [{ do = "take-photo" }]'
    assert " 8 " in fault("\n".join([steps('do = "p0"'), *chain, last]))


def test_its_scenario_counts_from_its_own_folder_and_is_looked_for_at_once(tmp_path: Path) -> None:
    file = tmp_path / "m.toml"

    def load(scenario: str) -> Mission:
        file.write_text(f'title = "x"\nscenario = "{scenario}"\n{PHOTO}', encoding="utf-8")
        return load_mission(file)

    with pytest.raises(ConfigError, match=r"m\.toml:2: .*'huose'.*'house'"):
        load("huose")
    with pytest.raises(ConfigError, match=r"m\.toml:2: .*/mine\.toml"):
        load("mine.toml")
    (tmp_path / "mine.toml").write_text("", encoding="utf-8")
    assert load("mine.toml").scenario == str(tmp_path / "mine.toml")
    assert load("house").scenario == "house"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("a = " + "[" * 5000 + "]" * 5000, "too deep"),
        (
            'steps = [{ do = "wait", seconds = 1'
            + ', else = [{ do = "wait", seconds = 1' * 300
            + " }]" * 300
            + " }]",
            "too deep",
        ),
        (f"priority = {'9' * 5000}\n" + steps('do = "wait", seconds = 1'), "not TOML"),
        (steps(f'do = "wait", seconds = {"9" * 400}'), "seconds: "),
    ],
)
def test_a_malicious_text_is_refused(text: str, says: str) -> None:
    assert says in fault(text)


def test_too_many_arguments_are_refused() -> None:
    many = ", ".join(f"a{n} = 1" for n in range(17))
    takes = ", ".join(f'"a{n}"' for n in range(17))
    called = f'[procedures.p]\ntakes = [{takes}]\nsteps = [{{ do = "wait", seconds = 1 }}]'
    assert "16" in fault(steps(f'do = "p", {many}', more=called))
    called = '[procedures.p]\ntakes = ["a"]\nsteps = [{ do = "wait", seconds = 1 }]'
    assert "256" in fault(steps(f'do = "p", a = "{"x" * 300}"', more=called))
    assert "256" in fault(steps(f'do = "p", a = {[1] * 100}', more=called))
