"""ARIA maps: what is read, what is refused and where, and that what is written reads back."""

from __future__ import annotations

from itertools import pairwise
from math import cos, pi, sin
from pathlib import Path
from zlib import compress

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from armadico.config.maps import parse_map, read_map
from armadico.config.mapwriter import format_map, write_map
from armadico.config.shipped import names
from armadico.config.worlds import Door, Room, Unseen, World, digest, hull, load_world
from armadico.core.config_errors import ConfigError

MAP = """\
2D-Map
# walls of one room ; and a comment in a comment
LineMinPos: -500 0
LineMaxPos: 4000 3000
NumLines: 2
MapInfo: something of another program's
Cairn: RobotHome 500 600 90.000000 "" ICON "RobotHome 1"
Cairn: RobotHome 1 2 3 "" ICON "RobotHome 2"
Cairn: Goal 1000 2000 45.000000 "" ICON "over there"
Cairn: GoalWithHeading 1000 2000 -90.000000 "" ICON "table"   # and on
Cairn: ForbiddenLine 0 0 0.000000 "" ICON "" 0 0 1 1
Cairn: Dock 1000 1000 180.000000 "" ICON "by the wall"
Cairn: ArmadicoRoom 0 0 0.000000 "" ICON "A" 0 0 2000 3000
Cairn: ArmadicoRoom 0 0 0.000000 "" ICON "B" 2000 0 4000 3000
Cairn: ArmadicoDoor 2000 1500 0.000000 "A B" ICON "the door"
LINES
0 0 4000 0
2000 0 2000 1000.5
DATA
17 18
"""


def test_lines_cairns_and_corners_become_a_world_in_si() -> None:
    assert parse_map(MAP, "two") == World(
        name="two",
        walls=((0.0, 0.0, 4.0, 0.0), (2.0, 0.0, 2.0, 1.0005)),
        bounds=(-0.5, 0.0, 4.0, 3.0),
        start=(0.5, 0.6, pi / 2),
        goals={"over there": (1.0, 2.0, 0.0), "table": (1.0, 2.0, -pi / 2)},
        rooms=(Room("A", 0.0, 0.0, 2.0, 3.0), Room("B", 2.0, 0.0, 4.0, 3.0)),
        doors=(Door("the door", "A", "B", 2.0, 1.5),),
        forbidden=((0.0, 0.0, 0.001, 0.001),),
        docks={"by the wall": (1.0, 1.0, pi)},
    )


def test_forbidden_areas_are_turned_about_the_origin_as_in_aria() -> None:
    cairn = 'Cairn: ForbiddenArea 0 0 90.000000 "" ICON "stairs" 1000 2000 3000 5000\n'
    world = parse_map(f"2D-Map\n{cairn}", "w")
    corners = [(-2.0, 1.0), (-2.0, 3.0), (-5.0, 3.0), (-5.0, 1.0), (-2.0, 1.0)]
    for line, (a, b) in zip(world.forbidden, pairwise(corners), strict=True):
        assert line == pytest.approx((*a, *b))
    assert len(world.forbidden) == 4
    assert world.bounds == pytest.approx((-5.0, 1.0, -2.0, 3.0))
    assert (world.walls, len(world.barriers)) == ((), 4)
    again = parse_map(format_map(world), "w")
    assert format_map(again) == format_map(world)
    assert len(again.forbidden) == 4
    with pytest.raises(ConfigError, match=r"m\.map:2: '1000 2000'"):
        parse_map(f"2D-Map\n{cairn.replace(' 3000 5000', '')}", "w", "m.map")


def test_bounds_hold_walls_that_a_stale_header_does_not() -> None:
    text = "2D-Map\nLineMinPos: 0 0\nLineMaxPos: 1 1\nLINES\n-1000 0 0 5000\n"
    assert parse_map(text, "w").bounds == (-1.0, 0.0, 0.001, 5.0)
    assert parse_map("2D-Map\nLINES\n1000 0 2000 5000\n", "w").bounds == (1.0, 0.0, 2.0, 5.0)


def complaint(text: str) -> str:
    """What is said about a text; nothing if it is a map."""
    try:
        parse_map(text, "any")
    except ConfigError as error:
        return str(error)
    return ""


@given(st.text())
def test_no_text_does_worse_than_a_config_error_with_a_place(text: str) -> None:
    for whole in (text, "2D-Map\nLINES\n" + text, "2D-Map\nCairn: " + text):
        message = complaint(whole)
        assert message == "" or message.startswith("<text>:")


# --- writing


@pytest.mark.parametrize("name", names("worlds"))
def test_a_world_that_is_written_reads_back(name: str) -> None:
    world = load_world(name)
    text = format_map(world, ["a comment"])
    assert parse_map(text, name) == world
    assert format_map(parse_map(text, name), ["a comment"]) == text


def test_files_are_written_and_found_by_their_path(tmp_path: Path) -> None:
    world = load_world("sc4")
    write_map(world, tmp_path / "mine.map")
    assert read_map(tmp_path / "mine.map").walls == world.walls
    assert load_world(tmp_path / "mine.map").name == "mine"
    (tmp_path / "mine.png").touch()
    with pytest.raises(ConfigError, match=r"ARIA \.map.*map_server"):
        load_world(tmp_path / "mine.png")


@pytest.mark.parametrize("name", ["", 'a"b', "a#b", "a;b", "a\nb"])
def test_a_name_that_a_map_cannot_hold_is_refused(name: str) -> None:
    world = World("w", (), (0, 0, 1, 1), goals={name: (0, 0, 0)})
    with pytest.raises(ConfigError, match=r"^name "):
        format_map(world)


def test_rooms_are_one_word() -> None:
    world = World("w", (), (0, 0, 1, 1), rooms=(Room("big hall", 0, 0, 1, 1),))
    with pytest.raises(ConfigError, match="'big hall'"):
        format_map(world)


# --- what a world can be asked


def test_rooms_know_who_is_in_them() -> None:
    world = load_world("sc4")
    for x, y, name in ((1.0, 1.0, "A"), (8.0, 1.0, "B"), (4.0, 4.0, "corridor")):
        room = world.room_at(x, y)
        assert room is not None
        assert room.name == name
    assert world.room_at(-1.0, 0.0) is None
    assert Room("r", 0.0, 0.0, 2.0, 2.0).away(1.0, 0.5) == -0.5
    assert Room("r", 0.0, 0.0, 2.0, 2.0).away(5.0, 6.0) == 5.0


class Later(World, frozen=True):
    """A world of a later version."""

    storeys: int = 1


def test_a_digest_is_that_of_the_map_on_any_computer_and_in_any_version() -> None:
    grid = bytes(100)
    unseen = [Unseen(0.0, 0.0, 0.3, 0.05, 20, 40, compress(grid, level)) for level in (0, 9)]
    wall = (0.0, 0.0, cos(0.3), sin(0.3))
    world = World("w", (wall,), hull((wall,)), rooms=(Room("r", *wall),), unseen=unseen[0])
    nudged = (-0.0, 0.0, wall[2] + 1e-15, wall[3] - 1e-15)
    same = {"unseen": unseen[1], "walls": (nudged,), "name": "v", "doubts": ("why",)}
    assert digest(replace(world, **same)) == digest(world)
    later = {name: getattr(world, name) for name in world.__struct_fields__}
    assert digest(Later(**later)) == digest(world)
    other = compress(b"\x01" + grid[1:])
    for change in (
        {"walls": ((0.0, 0.0, 1.0, 0.01),)},
        {"rooms": (Room("s", *wall),)},
        {"solid": True},
        {"docks": {"d": (0.0, 0.0, 0.0)}},
        {"unseen": replace(unseen[0], packed=other)},
        {"unseen": replace(unseen[0], refused=True)},
        {"unseen": None},
    ):
        assert digest(replace(world, **change)) != digest(world)


def test_a_map_without_walls_announces_none_since_aria_refuses_a_count_of_0() -> None:
    assert "NumLines" not in format_map(World(name="w", walls=(), bounds=(0.0, 0.0, 1.0, 1.0)))
