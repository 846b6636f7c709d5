"""Which parts of a map are passages, and how a way enters them."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import pytest

from armadico.agents.fleet.passages import Passages, passages_of
from armadico.config.worlds import load_world
from tests.fleet.rectangles import map_of

ROOMS = [(0.0, 0.0), (10.0, 0.0), (10.0, 4.0), (0.0, 4.0), (0.0, 0.0)]
BOUNDS = (0.0, 0.0, 10.0, 4.0)


def found(*lines: list[tuple[float, float]]) -> Passages:
    """The passages of a hall of 10 m x 4 m with some walls in it."""
    walls = tuple((*a, *b) for line in (ROOMS, *lines) for a, b in pairwise(line))
    return Passages(walls, BOUNDS)


def corridor(width: float) -> Passages:
    """Two rooms, and a corridor from x = 4 to 6 in the middle."""
    low, high = 2.0 - width / 2, 2.0 + width / 2
    return found(
        [(4.0, 0.0), (4.0, low), (6.0, low), (6.0, 0.0)],
        [(4.0, 4.0), (4.0, high), (6.0, high), (6.0, 4.0)],
    )


@pytest.mark.parametrize("width", [0.7, 1.1, 1.6])
def test_a_corridor_too_narrow_for_two_is_one_passage(width: float) -> None:
    passages = corridor(width)
    assert passages.count == 1
    assert passages.at(5.0, 2.0) == 0
    assert passages.at(1.0, 2.0) is None
    assert passages.at(9.0, 3.7) is None, "nor is the corner of a room"


def test_where_two_can_pass_each_other_is_none() -> None:
    assert corridor(2.2).count == 0
    assert found().count == 0
    assert passages_of(load_world("hall")).count == 0, "whatever is passed there leaves 2 m"


@pytest.mark.parametrize("width", [0.8, 1.0])
def test_a_door_in_a_thin_wall_is_a_passage(width: float) -> None:
    passages = found([(5.0, 0.0), (5.0, 2.0 - width / 2)], [(5.0, 2.0 + width / 2), (5.0, 4.0)])
    assert passages.count == 1
    assert passages.at(5.0, 2.0) == 0
    assert passages.at(4.0, 2.0) is passages.at(6.0, 2.0) is None


def test_a_long_dead_end_is_a_passage_and_a_short_one_is_none() -> None:
    long = found([(6.0, 1.2), (10.0, 1.2)])
    assert long.count == 1
    assert long.at(9.0, 0.6) == 0
    short = found([(9.6, 1.2), (10.0, 1.2)])
    assert short.count == 0


@pytest.mark.parametrize(("side", "together"), [(2.0, True), (4.0, False)])
def test_two_passages_with_no_room_to_wait_between_them_are_one(
    side: float, together: bool, tmp_path: Path
) -> None:
    path, end = tmp_path / "bay.map", 5.0 + side
    bay = (5.0, 2.0 - side / 2, end, 2.0 + side / 2)
    doors = (4.0, 1.5, 5.0, 2.5), (end, 1.5, end + 1.0, 2.5)
    path.write_text(map_of([(0.0, 0.0, 4.0, 4.0), *doors, bay, (end + 1.0, 0.0, end + 5.0, 4.0)]))
    passages = passages_of(load_world(str(path)))
    one, other = passages.at(4.5, 2.0), passages.at(end + 0.5, 2.0)
    assert one is not None
    assert other is not None
    assert (one == other) == (passages.at(5.0 + side / 2, 2.0) == one) == together


def test_a_way_enters_a_passage_once_and_at_its_mouth() -> None:
    passages = corridor(1.1)
    assert passages.along([(1.0, 2.0), (3.0, 2.0)]) == []
    ((away, number),) = passages.along([(1.0, 2.0), (5.0, 2.0), (9.0, 2.0)])
    assert number == 0
    assert away == pytest.approx(3.0, abs=0.3)
    assert passages.along([(5.0, 2.0), (9.0, 2.0)])[0] == (pytest.approx(0.0, abs=0.15), 0)


def test_the_same_map_has_the_same_passages_and_another_one_has_others() -> None:
    assert corridor(1.1).id == corridor(1.1).id
    assert corridor(1.1).id != corridor(1.4).id
