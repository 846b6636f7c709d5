"""A part of a map finds its place on another one, or stays a part of its own."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from armadico.agents.methods.poses import Floats, compose, relative
from armadico.agents.methods.slices import finished
from armadico.agents.slam.logs.logs import drifted
from armadico.agents.slam.slam import Slam
from tests.robot.scans import BEARINGS, cast, drive
from tests.slam.worlds import mapped, ring, square, twins

PATH = square()
BLOCK = ring(4.0, 2.0) + np.array([38.0, 0.0, 38.0, 0.0])
FLOOR = [(30, -8), (50, -8), (50, 8), (30, 8), (30, 1), (24, 1), (24, 1.4), (22, 1.4), (22, 1)]
FLOOR += [(15, 1), (15, -1), (19, -1), (19, -1.3), (20, -1.3), (20, -1), (30, -1), (30, -8)]
HALL = np.array([(*a, *b) for a, b in pairwise(FLOOR)], dtype=np.float64)
"""A hall with a block, and a corridor from it."""

WALLS = np.concatenate([ring(), HALL, BLOCK])
THERE = drive([(33.0, -4.0), (42.0, -4.0)])


def kept(slam: Slam) -> Slam:
    """Another SLAM that continues a map."""
    again = Slam(slam.parameters)
    again.restore(slam.saved([]), slam.map.clouds)
    return again


def taken(
    slam: Slam,
    path: Floats,
    odometry: Floats,
    begun: float = 0.0,
    walls: Floats = WALLS,
    **how: bool,
) -> Floats:
    """The poses by SLAM along a path."""
    rng, found = np.random.default_rng(2), []
    for number, (pose, here) in enumerate(zip(path, odometry, strict=True)):
        ranges = cast(walls, pose) + 0.01 * rng.standard_normal(len(BEARINGS))
        slam.add(begun + 0.1 * number, here, ranges, BEARINGS, **how)
        slam.close_loops()
        found.append(slam.pose_at(here))
    return np.array(found)


def test_a_robot_that_continues_a_map_is_found_on_it_though_its_odometry_begins_elsewhere() -> None:
    slam, _ = mapped(ring(), PATH[:75], PATH[:75])
    again, path = kept(slam), PATH[95:130]
    begin = np.array([-2.0, 7.0, 1.0])  # a wrong start pose
    odometry = compose(begin, relative(path[0], drifted(path, 0.05, 3)))
    assert not again.located
    poses = taken(again, path, odometry)
    assert again.located
    assert again.parts == 1
    assert not again.uncertain
    assert np.hypot(*(poses[-1] - path[-1])[:2]) < 0.1
    stays = again.map.poses[: len(slam.map.poses), :2] - slam.map.poses[:, :2]
    assert np.abs(stays).max() < 0.05
    assert len(again.map.poses) > len(slam.map.poses) + 20


@pytest.mark.long
def test_a_robot_that_is_not_on_the_map_stays_a_part_of_its_own() -> None:
    slam, _ = mapped(ring(), PATH[:75], PATH[:75])
    again = kept(slam)
    taken(again, THERE, relative(THERE[0], THERE))
    assert not again.located
    assert again.parts == 2
    assert "2 parts" in again.uncertain
    assert not again.map.loops[len(slam.map.loops) :]
    assert np.array_equal(again.map.poses[: len(slam.map.poses)], slam.map.poses)
    assert np.count_nonzero(again.map.present) == len(again.map.poses) - len(slam.map.poses)


@pytest.mark.long
def test_a_robot_that_is_carried_joins_the_old_part_again() -> None:
    corners = [(33, -5), (46, -5), (46, 5), (33, 5), (33, 0), (17, 0)]
    first = drive([(float(x), float(y)) for x, y in corners])
    then = drive([(44.0, 1.0), (44.0, -5.0), (35.0, -5.0)])
    slam = Slam()
    taken(slam, first, first)
    assert not slam.evidence.carried
    carried = compose(first[-1], relative(then[0], then))
    poses = taken(slam, then, carried, 100.0)
    assert len(slam.evidence.carried) == 1
    assert slam.located
    assert slam.parts == 1
    assert slam.evidence.relocations == 1
    assert not slam.uncertain
    assert np.hypot(*(poses[-1] - then[-1])[:2]) < 0.1


@pytest.mark.long
def test_a_fixed_map_stays_and_a_robot_that_is_lost_on_it_is_found() -> None:
    slam, _ = mapped(ring(), PATH[:75], PATH[:75])
    again, count = kept(slam), len(slam.map.poses)
    path = PATH[95:130]
    odometry = relative(path[0], drifted(path, 0.05, 3))
    taken(again, path, odometry, mapping=False)
    assert again.located
    assert len(again.map.poses) == count
    more = PATH[130:]
    moved = compose(odometry[-1], relative(path[-1], more))
    poses = taken(again, more, moved, 100.0, mapping=False)
    assert np.hypot(*(poses - more)[:, :2].T).max() < 0.1
    assert len(again.map.poses) == len(again.map.clouds) == len(again.map.part) == count
    assert again.map.poses.tobytes() == slam.map.poses.tobytes()
    # From here on it maps again, on the same map.
    taken(again, PATH[:20], compose(moved[-1], relative(more[-1], PATH[:20])), 200.0)
    assert len(again.map.poses) > count
    assert again.parts == 1
    assert np.hypot(*(again.map.poses[-1] - PATH[19])[:2]) < 0.1


@pytest.mark.long
def test_a_robot_that_does_not_find_itself_on_a_fixed_map_takes_bounded_memory() -> None:
    slam, _ = mapped(ring(), PATH[:40], PATH[:40])
    again = kept(slam)
    turn = np.array([[42.0, -4.0, 0.5 * k] for k in range(110)])
    taken(again, turn, turn, mapping=False)
    assert not again.located
    assert len(again.map.poses) <= len(slam.map.poses) + 101


@pytest.mark.long
def test_a_twin_that_is_not_on_the_map_is_reported_once_the_map_contradicts() -> None:
    there = drive([(-1.0, 0.0), (19.0, 0.0), (-1.0, 0.0)], step=0.4)
    slam, _ = mapped(twins(3.0), there, there)
    again = kept(slam)
    path = drive([(2.0, 3.0), (19.0, 3.0), (-1.0, 3.0), (-1.0, 0.0), (10.0, 0.0)], step=0.4)
    taken(again, path, relative(path[0], path), walls=twins(3.0))
    assert "contradicts the place" in again.uncertain


def test_of_two_places_that_are_alike_none_is_taken() -> None:
    """In a bare room each place looks like the one opposite."""
    room = np.array([(-4, -3, 4, -3), (4, -3, 4, 3), (4, 3, -4, 3), (-4, 3, -4, -3)], dtype=float)
    path = drive([(-2.5, -1.5), (2.5, -1.5), (2.5, 1.5), (-2.5, 1.5), (-2.5, -1.5)], step=0.4)
    slam, _ = mapped(room, path, path)
    again = kept(slam)
    taken(again, path[5:40], relative(path[5], path[5:40]), walls=room)
    assert not again.located
    assert again.parts == 2


@pytest.mark.long
def test_a_robot_is_found_on_a_part_that_another_part_lies_on() -> None:
    slam, _ = mapped(ring(), PATH[:75], PATH[:75])
    apart = kept(slam)
    taken(apart, THERE, relative(THERE[0], THERE))
    again, path = kept(apart), PATH[95:130]
    poses = taken(again, path, relative(path[0], path), 100.0)
    assert again.located
    assert np.hypot(*(poses[-1] - path[-1])[:2]) < 0.1


def test_a_lost_robot_that_maps_again_begins_a_part_where_it_stands() -> None:
    slam, _ = mapped(ring(), PATH[:75], PATH[:75])
    again, here = kept(slam), np.repeat(PATH[100:101], 3, axis=0)
    taken(again, here, 0.0 * here, mapping=False)
    assert again.lost
    taken(again, here[:1], 0.0 * here[:1], 100.0, mapping=True)
    assert not again.lost
    assert again.parts == 2


@pytest.mark.parametrize("dropped", [False, True])
def test_a_place_that_is_found_after_its_scans_were_dropped_changes_nothing(
    dropped: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    slam, _ = mapped(ring(), PATH[:75], PATH[:75])
    again, moved, path = kept(slam), None, PATH[95:130]
    for number, pose in enumerate(path):
        here = relative(path[0], pose)
        again.add(0.1 * number, here, cast(ring(), pose), BEARINGS, mapping=False)
        if moved is not None:
            break
        moved = finished(again.closing_loops())
        if dropped and moved is not None:  # it gives up before the found place is adopted
            monkeypatch.setattr("armadico.agents.slam.slam.LOST_SCANS", 1)
    assert moved is not None
    again.adopt(moved)
    assert again.located is not dropped
    assert again.map.poses[: len(slam.map)].tobytes() == slam.map.poses.tobytes()
