"""ARIA maps as other people and other programs write them: what they yield, or why not."""

from __future__ import annotations

from math import pi
from pathlib import Path

import pytest

from armadico.config.worlds import World, load_world
from armadico.core.config_errors import ConfigError

HEAD = "2D-Map\nLineMinPos: 0 0\nLineMaxPos: 8000 5000\nNumLines: 5\n"
HOME = 'Cairn: RobotHome 1000 1000 0 "" ICON "Home"\n'
BOX = "0 0 8000 0\n8000 0 8000 5000\n8000 5000 0 5000\n0 5000 0 0\n4000 0 4000 3400\n"
PLAIN = f"{HEAD}{HOME}LINES\n{BOX}DATA\n"
WALLS = [
    *((0.0, 0.0, 8.0, 0.0), (8.0, 0.0, 8.0, 5.0), (8.0, 5.0, 0.0, 5.0), (0.0, 5.0, 0.0, 0.0)),
    (4.0, 0.0, 4.0, 3.4),
]


def loaded(folder: Path, text: str | bytes) -> World:
    file = folder / "my.map"
    file.write_bytes(text.encode() if isinstance(text, str) else text)
    return load_world(file)


def cairn(line: str) -> str:
    return PLAIN.replace(HOME, f"{HOME}Cairn: {line}\n")


SAME: dict[str, str | bytes] = {
    "plain": PLAIN,
    **{f"2D-Map-Ex{n}": PLAIN.replace("2D-Map", f"2D-Map-Ex{n}") for n in ("", "2", "3", "4")},
    "lower case": PLAIN.replace("2D-Map", "2D-map"),
    "a space": PLAIN.replace("2D-Map", "2D-Map "),
    "a comment first": "# made by me\n\n" + PLAIN,
    "byte order mark": b"\xef\xbb\xbf" + PLAIN.encode(),
    "utf-16": PLAIN.encode("utf-16"),
    "windows": PLAIN.replace("\n", "\r\n"),
    "old mac": PLAIN.replace("\n", "\r"),
    "tabs": PLAIN.replace(" ", "\t"),
    "no number of lines": PLAIN.replace("NumLines: 5\n", ""),
    "no data": PLAIN.replace("DATA\n", ""),
    "decimals": PLAIN.replace("8000 5000\nNum", "8000.0 5.0e3\nNum"),
    "more header": PLAIN.replace(HOME, f"LinesAreSorted: true\nMapInfo: GoalType\n{HOME}"),
    "points beside": f"{PLAIN}10 10\n20 20\n",
    "a source": "2D-Map-Ex2\nSources: L1\n"
    + PLAIN.replace("2D-Map\n", "").replace("Line", "L1Line").replace("Num", "L1Num")
    .replace("LINES", "L1LINES").replace("DATA", "L1DATA\n1 1\nDATA"),
    "home at the end": HEAD + f"LINES\n{BOX}DATA\n1 1\n{HOME}",
    "an empty cairn": cairn(""),
    "a cairn of others": cairn('Sim.BoxObstacle 0 0 0 "" ICON "" 2000 700 2500 1300'),
    "an area of homes": cairn('RobotHomeArea 0 0 0 "" ICON "HA" 500 500 1500 1500'),
    "a dock of others": cairn('DockLynx 6000 1000 0 "" ICON "Dock1"'),
}  # fmt: skip


@pytest.mark.parametrize("text", SAME.values(), ids=SAME)
def test_the_same_map_in_another_spelling(tmp_path: Path, text: str | bytes) -> None:
    assert loaded(tmp_path, text) == World("my", tuple(WALLS), (0, 0, 8, 5), start=(1, 1, 0))


def test_the_lines_of_all_sources_are_walls(tmp_path: Path) -> None:
    box = f"{BOX}LMS2-LINES\n1000 2500 2000 2500\n"
    assert len(loaded(tmp_path, PLAIN.replace(BOX, box)).walls) == 6
    with pytest.raises(ConfigError, match=r"my\.map:6: LMS2NumLines: "):
        loaded(tmp_path, PLAIN.replace(HOME, f"{HOME}LMS2NumLines: 2\n").replace(BOX, box))
    after = PLAIN.replace("NumLines: 5", "NumLines: 6") + "1 1\nLINES\n3000 1000 3000 2000\n"
    assert len(loaded(tmp_path, after).walls) == 6


GOALS: dict[str, tuple[list[str], list[tuple[str, float]]]] = {
    "one name": (
        ['Goal 1000 1000 90 "" ICON "A"', 'GoalWithHeading 2000 1000 90 "" ICON "A"'],
        [("A", 0.0), ("A-2", pi / 2)],
    ),
    "no name": (
        ['Goal 1000 1000 0 "" ICON ""', 'Goal 2000 1000 0 "" ICON ""'],
        [("Goal", 0.0), ("Goal-2", 0.0)],
    ),
    "the next name, too": (
        [f'Goal 1000 1000 0 "" ICON "{name}"' for name in ("A", "A-2", "A")],
        [("A", 0.0), ("A-2", 0.0), ("A-3", 0.0)],
    ),
    "standby": (
        ['StandbyGoalWithHeading 6000 1000 90 "" ICON "S1"', 'StandbyGoal 1 1 90 "" ICON "S2"'],
        [("S1", pi / 2), ("S2", 0.0)],
    ),
    "marks of comments": (
        ['Goal 6000 1000 0 "" ICON "Room #4; left"  # a comment'],
        [("Room #4; left", 0.0)],
    ),
    "latin-1": (['Goal 6000 1000 0 "" ICON "Büro"'], [("Büro", 0.0)]),
}


@pytest.mark.parametrize(("cairns", "goals"), GOALS.values(), ids=GOALS)
def test_goals_have_names_of_their_own(
    tmp_path: Path, cairns: list[str], goals: list[tuple[str, float]]
) -> None:
    text = "".join(f"Cairn: {line}\n" for line in cairns)
    world = loaded(tmp_path, PLAIN.replace(HOME, HOME + text).encode("latin-1"))
    assert [(name, pose[2]) for name, pose in world.goals.items()] == goals


def test_so_have_docks(tmp_path: Path) -> None:
    docks = 'Dock 6000 1000 0 "" ICON ""\nCairn: Dock 6000 2000 0 "" ICON ""'
    assert [*loaded(tmp_path, cairn(docks)).docks] == ["Dock", "Dock-2"]


def points(step: int) -> str:
    across = "".join(f"{x} 0\n{x} 5000\n" for x in range(0, 8001, step))
    upright = "".join(f"0 {y}\n8000 {y}\n" for y in range(0, 5001, step))
    return across + upright + "".join(f"4000 {y}\n" for y in range(0, 3400, step))


@pytest.mark.parametrize(("step", "resolution"), [(50, ""), (20, ""), (100, "Resolution: 100\n")])
def test_a_map_of_points_has_walls_where_they_are(
    tmp_path: Path, step: int, resolution: str
) -> None:
    world = loaded(tmp_path, f"2D-Map\n{resolution}{HOME}DATA\n{points(step)}")
    for x, y, away in ((1.0, 1.0, 1.0), (3.0, 1.0, 1.0), (4.0, 4.2, 0.8), (7.5, 2.0, 0.5)):
        assert world.clearance(x, y) == pytest.approx(away, abs=0.051)
    assert world.crossed((1.0, 1.0), (7.0, 1.0))
    assert not world.crossed((1.0, 4.2), (7.0, 4.2))
    assert world.clearance(4.0, 1.02) == 0.0  # within a wall


WRONG: dict[str, tuple[str | bytes, str]] = {
    "nothing": ("", ":1: "),
    "another file": ("3D-Map\n", ":1: "),
    "of the future": (PLAIN.replace("2D-Map", "2D-Map-Ex9"), ":1: "),
    "bytes": (bytes(range(256)), ":1: "),
    "far": (PLAIN.replace("4000 3400", "4000 34000000"), ":11: 34000000: "),
    "commas": (PLAIN.replace("4000 0 4000 3400", "4000, 0, 4000, 3400"), ":11: '4000,': "),
    "not finite": (PLAIN.replace("4000 3400", "4000 inf"), ":11: 'inf': "),
    "a line missing": (PLAIN.replace("NumLines: 5", "NumLines: 6"), ":4: NumLines: 6"),
    "no colon": (PLAIN.replace(HOME, f"PointsAreSorted true\n{HOME}"), ":5: "),
    "no icon": (PLAIN.replace(HOME, "Cairn: RobotHome 1000 1000 0\n"), ":5: "),
    "a dock in a wall": (cairn('Dock 7950 2500 0 "" ICON "D"'), ":6: dock 'D' at (7.95, 2.5) "),
    "a point of text": ("2D-Map\nDATA\n1 one\n", ":3: 'one': "),
    "half a point": ("2D-Map\nDATA\n1\n", ":3: '1': "),
    "points too far apart": ("2D-Map\nDATA\n0 0\n9000000 9000000\n", ": "),
}


@pytest.mark.parametrize(("text", "place"), WRONG.values(), ids=WRONG)
def test_what_is_no_map_is_an_error_that_names_its_place(
    tmp_path: Path, text: str | bytes, place: str
) -> None:
    with pytest.raises(ConfigError) as caught:
        loaded(tmp_path, text)
    assert str(caught.value).startswith(f"{tmp_path / 'my.map'}{place}")
