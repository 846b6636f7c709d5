"""Missions: what is read, and what is said of what is wrong, with file and line."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
import pytest

from armadico.agents.missions import mission_file as missions
from armadico.agents.missions.mission_file import Mission, Step, load_mission, read_mission
from armadico.agents.missions.task import Task
from armadico.config.places import Places
from armadico.config.profile import load_profile
from armadico.config.shipped import names
from armadico.config.worlds import Room, World, load_world
from armadico.core.config_errors import ConfigError, ConfigNameError

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
CALLS = """
[procedures.photo-of]
takes = ["room"]
steps = [
  { do = "move", to = "$room" },
]
"""


CIRCLE = """
[procedures.a]
steps = [
  { do = "b" },
]
[procedures.b]
steps = [
  { do = "a" },
]
"""
OWN_CIRCLE = """
[procedures.a]
steps = [
  { do = "take-photo", else = [{ do = "a" }] },
]
"""
TASK = """
[procedures.move]
steps = [{ do = "take-photo" }]
"""
TWICE_ELSE = (
    'do = "move", to = "R1", else = [{ do = "wait", seconds = 1, else = [{ do = "wait" }] }]'
)

IN = """
[procedures.in]
takes = ["room"]
when = { room = "$room" }
steps = [{ do = "take-photo" }]
"""


def look(row: str, *takes: str) -> str:
    """A mission with a procedure for alarms, of one step."""
    return (
        f'on_alarm = "look"\n{PHOTO}\n[procedures.look]\ntakes = {["room", *takes]}\n'
        f"steps = [\n  {{ {row} }},\n]"
    )


WRONG_STEPS = [
    ('do = "mve", to = "R1"', "2: no task or procedure 'mve'; did you mean 'move'?"),
    ('do = "move", to = "R111"', "2: no place 'R111' in 'surveillance'; did you mean 'R11'?"),
    ('do = "move", too = "R1"', "2: unknown key too of 'move'; did you mean 'to'?"),
    ('do = "move"', "2: missing key to in steps[0]"),
    ('du = "move"', "2: a step needs a key do; did you mean 'do'?"),
    ('do = "wait", seconds = "l"', '2: steps[0].seconds = "l": expected a number, not a string'),
    ('do = "wait", seconds = -1', "2: steps[0].seconds = -1: expected a number >= 0.0"),
    (
        'do = "take-photo", when = { batery_above = 0.2 }',
        "2: unknown key steps[0].when.batery_above; did you mean 'battery_above'?",
    ),
    (
        'do = "take-photo", when = { room = "R3" }',
        "2: no room 'R3' in 'surveillance'; did you mean",
    ),
    ('do = "take-photo", when = {}', "2: when is empty"),
    ('do = "photo-of", rom = "R1"', "2: unknown key rom of 'photo-of'; did you mean 'room'?"),
    ('do = "photo-of"', "2: 'photo-of' needs an argument room"),
    ('do = "photo-of", room = "R4"', "8: no place 'R4' in 'surveillance'"),
    ('do = "move", to = "$room"', "2: to = '$room': the procedure takes no 'room'"),
    (TWICE_ELSE, "2: else within else"),
]

WRONG = [
    (steps('do = "move", to = ""'), "2: no place '' in 'surveillance'"),
    (steps('do = "in", room = 3', more=IN), "7: room = 3.0: expected a room's name"),
    (steps('do = "in", room = [1, 2]', more=IN), "7: room = (1.0, 2.0): expected a room's name"),
    (f"{PHOTO}\n[procedures.a]\n{PHOTO}\n[procedures.b]\nsteps = []", "5: procedures.b.steps = []"),
    (f"{PHOTO}\n[procedures.a]\n{PHOTO}\ngoal = 3", "4: procedures.a.goal = 3: expected a string"),
    (f'{PHOTO}\n[procedures."a.b"]\ngoal = 3', "3: procedures.a.b.goal = 3: expected a string"),
    (look('do = "move", to = "R111"'), "6: no place 'R111' in 'surveillance'; did you mean 'R11'?"),
    (look('do = "move", to = "$rom"'), "6: to = '$rom': the procedure takes no 'rom'"),
    (look('do = "wait", seconds = "$s"', "s"), "1: 'look' needs an argument s"),
    (steps('do = "a"', more=CIRCLE), "11: procedure 'a' calls itself: a -> b -> a"),
    (steps('do = "a"', more=OWN_CIRCLE), "7: procedure 'a' calls itself: a -> a"),
    (steps('do = "take-photo"', more=TASK), "5: procedure 'move'"),
    ('on_alarm = "chek"', "missing key steps"),
    (f'on_alarm = "chek-alarm"\n{PHOTO}', "1: no task or procedure 'chek-alarm'; did you mean"),
    (f'on_alarm = "wait"\n{PHOTO}', "1: wait takes no room"),
    (f"priority = 2.0\n{PHOTO}", "1: priority = 2.0: expected a number <= 1.0"),
    (f'energy = "chrge"\n{PHOTO}', "1: energy = \"chrge\": did you mean 'charge'?"),
    ("steps = []", "1: steps = []: expected "),
    ('title = "x"', "missing key steps"),
    ("steps = [", "1: not TOML"),
]


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


def test_what_can_be_got_to_is_what_a_flood_from_there_reaches() -> None:
    body = load_profile("pioneer-2dx").body
    box = ((0.0, 0.0, 6.0, 0.0), (6.0, 0.0, 6.0, 6.0), (6.0, 6.0, 0.0, 6.0), (0.0, 6.0, 0.0, 0.0))
    for seed in range(5):
        rng = random.Random(seed)
        ends = ([rng.uniform(0.0, 6.0) for _ in range(4)] for _ in range(9))
        walls = tuple((x, y, x + 0.4 * (a - 3.0), y + 0.4 * (b - 3.0)) for x, y, a, b in ends)
        goals = {f"g{n}": (rng.uniform(0, 6), rng.uniform(0, 6), 0.0) for n in range(40)}
        world = World("w", box + walls, (0.0, 0.0, 6.0, 6.0), goals=goals)
        places = Places(world, body)
        start = next(goal[:2] for goal in goals.values() if places._free[places._cell(*goal[:2])])
        reached, edge = set[tuple[int, int]](), [places._cell(*start)]
        while edge:
            column, row = cell = edge.pop()
            inside = 0 <= column < places._free.shape[0] and 0 <= row < places._free.shape[1]
            if cell not in reached and inside and places._free[cell]:
                reached.add(cell)
                edge += [(column + 1, row), (column - 1, row), (column, row + 1), (column, row - 1)]
        cut_off = set[str]()
        for name, goal in goals.items():
            column, row = cell = places._cell(*goal[:2])
            beside = {(column + a, row + b) for a in (-1, 0, 1) for b in (-1, 0, 1)}
            if not reached & ({cell} if places._free[cell] else beside):
                cut_off.add(name)
        assert {*places.unreachable(start, goals)} == cut_off


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


def test_a_task_may_be_told_whole_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    class Counts(Task):
        """Somebody's task."""

        class Arguments(Task.Arguments, frozen=True):
            times: int
            pair: tuple[int, ...] = ()
            share: float = 0.0

    monkeypatch.setattr(missions, "task_class", lambda _: Counts)
    row = 'do = "wait", times = 3, pair = [1, 2], share = 2'
    (step,) = read_mission(steps(row), "m").procedures[""].steps
    told = missions.arguments_of(step)
    assert (told.times, told.pair, told.share) == (3, (1, 2), 2.0)
    assert isinstance(told.times, int)
    assert isinstance(told.share, float)
    assert "steps[0].times = 2.5: expected a whole number" in fault(
        steps('do = "wait", times = 2.5')
    )


def test_a_mission_is_compared_by_value() -> None:
    text = steps('do = "move", to = "R1"')
    assert read_mission(text, "m") == read_mission(text, "m")
    assert isinstance(read_mission(text, "m"), Mission)


def test_an_unknown_mission_is_said_with_the_nearest(tmp_path: Path) -> None:
    with pytest.raises(ConfigNameError) as caught:
        load_mission("surveilance")
    assert caught.value.near == "surveillance"
    with pytest.raises(ConfigError, match=r"none\.toml"):
        load_mission(tmp_path / "none.toml")


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
