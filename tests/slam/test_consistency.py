"""A map that folds over itself is doubted; doors, people and small errors are no fold."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from armadico.agents.methods.poses import Floats, compose, relative
from armadico.agents.methods.scan_matching import PointCloud, point_cloud
from armadico.agents.methods.slices import finished
from armadico.agents.slam.commands import view
from armadico.agents.slam.consistency import (
    ConsistencyParameters,
    Contradiction,
    contradictions,
    most_uncertain,
)
from armadico.agents.slam.pose_graph import Edge
from armadico.agents.slam.slam import Slam, SlamParameters
from armadico.agents.slam.states import Mode, Moved, Proof
from armadico.config.grid_map import FREE, Cells
from tests.robot.scans import BEARINGS, cast

HALF = 1.1
"""Of the width of a corridor, m."""

Scan = tuple[Floats, PointCloud]


def corridor(length: float = 24.0, door: tuple[float, float] | None = None) -> Floats:
    """(n, 4) walls of a corridor along x, the left one with a door or an opening."""
    a, b = door or (length / 2, length / 2)
    left = [(0.0, HALF, a, HALF), (b, HALF, length, HALF)]
    ends = [(0.0, -HALF, 0.0, HALF), (length, -HALF, length, HALF)]
    return np.array([*left, (0.0, -HALF, length, -HALF), *ends])


def driven(walls: Floats, frame: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> list[Scan]:
    """Scans along a corridor, which is placed on the map at a pose."""
    found = []
    for x in np.arange(1.0, 23.0, 0.5):
        pose = np.array([x, 0.0, 0.0])
        cloud = point_cloud(cast(walls, pose), BEARINGS, max_range=15.0)
        found.append((compose(np.array(frame), pose), cloud))
    return found


def doubtful(*visits: Sequence[Scan], apart: float = 30.0) -> list[Contradiction]:
    """The places of a map of several visits, with so much way between them, m."""
    scans, way = [], []
    for number, visit in enumerate(visits):
        scans += visit
        way += [number * apart + 0.5 * k for k in range(len(visit))]
    poses = np.array([pose for pose, _ in scans])
    clouds = [cloud for _, cloud in scans]
    return finished(contradictions(poses, way, clouds, (0.0, 0.0), ConsistencyParameters()))


ACROSS = (12.0, -12.0, np.pi / 2)
"""Where a second corridor lies across the middle of the first one."""


@pytest.mark.parametrize("angle", [90.0, 60.0])
def test_a_corridor_that_runs_through_the_walls_of_another_is_found_with_its_place(
    angle: float,
) -> None:
    turn = np.radians(angle)
    frame = (12.0 - 12.0 * np.cos(turn), -12.0 * np.sin(turn), turn)
    places = doubtful(driven(corridor()), driven(corridor(), frame))
    assert places
    for place in places:
        assert np.hypot(place.x - 12.0, place.y) < 3.0
    assert sum(place.length for place in places) > 4.0


def test_corridors_beside_each_other_are_right() -> None:
    beside = (0.0, 2.0 * HALF + 0.2, 0.0)
    assert not doubtful(driven(corridor()), driven(corridor(), beside))
    assert not doubtful(driven(corridor()), driven(corridor()))


@pytest.mark.parametrize("width", [0.9, 1.8])
def test_a_door_that_was_closed_and_is_open_later_is_no_fold(width: float) -> None:
    beyond = [(8.0, HALF, 8.0, 7.0), (8.0, 7.0, 14.0, 7.0), (14.0, HALF, 14.0, 7.0)]
    opened = np.vstack([corridor(door=(11.0 - width / 2, 11.0 + width / 2)), beyond])
    assert not doubtful(driven(corridor()), driven(opened))


def test_people_who_stood_there_are_no_wall() -> None:
    scans = driven(corridor())
    rng = np.random.default_rng(1)
    crowd = []
    for pose, _ in scans:  # they walk: nobody stands where they stood in the scan before
        people = [
            (x, y, x + 0.3, y)
            for x, y in rng.uniform((2.0, -0.9), (22.0, 0.9), (12, 2)).tolist()
            if abs(x - pose[0]) > 0.6
        ]
        seen = cast(np.vstack([corridor(), people]), pose)
        crowd.append((pose, point_cloud(seen, BEARINGS, max_range=15.0)))
    assert not doubtful(crowd, scans)


@pytest.mark.parametrize("off", [0.3, 0.8])
def test_a_wall_that_is_drawn_twice_is_a_small_error(off: float) -> None:
    assert not doubtful(driven(corridor()), driven(corridor(), (0.0, off, 0.0)))


def test_what_one_visit_saw_is_not_held_against_itself() -> None:
    near = [driven(corridor())[14:26], driven(corridor(), ACROSS)[14:26]]
    assert doubtful(*near)
    assert not doubtful(*near, apart=7.0)


# The error of places ------------------------------------------------------------------------------


def chain(loops: Sequence[tuple[int, int]] = ()) -> tuple[Floats, list[float], list[Edge]]:
    """A way of 100 m there and back in steps of 1 m, with loops."""
    poses = np.array([(min(k, 100 - k), 0.0, 0.0 if k < 50 else np.pi) for k in range(101)])
    pairs = [(k, k + 1) for k in range(100)]
    information = np.diag([0.02**-2, 0.02**-2, 0.01**-2])
    edges = [
        Edge(a, b, relative(poses[a], poses[b]), information, (a, b) in loops)
        for a, b in [*pairs, *loops]
    ]
    return poses, [float(k) for k in range(101)], edges


def test_the_deviation_grows_with_a_way_without_loops_and_a_loop_bounds_it() -> None:
    poses, way, edges = chain()
    alone = finished(most_uncertain(poses, way, edges, np.ones(len(edges))))
    # Each heading's error shifts the end by its distance from there, 50 m at the turn.
    arms = np.concatenate([np.arange(50), np.arange(50)])
    assert alone.metres == pytest.approx(0.01 * np.sqrt(np.sum(arms**2)), rel=0.1)
    assert alone.way > 95.0
    poses, way, edges = chain([(0, 100), (10, 90), (25, 75)])
    closed = finished(most_uncertain(poses, way, edges, np.ones(len(edges))))
    assert closed.chain <= 51.0
    weights = np.array([1.0] * 100 + [0.0] * 3)  # switched off: as if they were not there
    off = finished(most_uncertain(poses, way, edges, weights))
    assert off == alone


# What a user sees ---------------------------------------------------------------------------------


def folded() -> Slam:
    slam, scans = Slam(), [*driven(corridor()), *driven(corridor(), ACROSS)]
    information = np.diag([1e4, 1e4, 1e4])
    for number, (pose, cloud) in enumerate(scans):
        slam.map.add(pose, 30.5 if number == 44 else 0.5, cloud, number, 0)
        if number:
            step = relative(slam.map.poses[number - 1], pose)
            slam.map.graph.add(Edge(number - 1, number, step, information))
    slam.finish()
    return slam


def test_a_folded_map_says_so_and_its_picture_shows_where() -> None:
    slam = folded()
    assert "contradicts itself" in slam.uncertain
    cells = Cells(-5.0, -15.0, 0.05, np.full((600, 700), FREE, dtype=np.uint8))
    marked = np.argwhere((np.asarray(view.picture(cells, slam)) == view.DOUBT).all(axis=2))
    scale = 1600 / 700
    y, x = marked.mean(axis=0) / scale * 0.05
    assert (x - 5.0, 15.0 - y) == pytest.approx((12.0, 0.0), abs=1.0)


def test_a_doubtful_place_beyond_the_grid_is_on_the_picture() -> None:
    slam = folded()
    cells = Cells(0.0, -1.5, 0.05, np.full((60, 80), FREE, dtype=np.uint8))  # x from 0 to 4 m
    shades = np.asarray(view.picture(cells, slam))
    assert (shades == view.DOUBT).all(axis=2).any()
    free = np.argwhere((shades == 255).all(axis=2))
    scale = len(shades) / 21.5  # m: the way through the second corridor
    assert np.ptp(free, axis=0) / scale == pytest.approx((3.0, 4.0), abs=0.2)


def test_while_driving_a_map_is_checked_as_it_grows_and_after_each_optimisation() -> None:
    slam = folded()
    slam.evidence.contradictions, slam.evidence.checked = [], (0, 0)
    finished(slam.checking())
    assert slam.evidence.contradictions
    checked = slam.evidence.checked
    finished(slam.checking())  # nothing is new
    assert slam.evidence.checked == checked
    poses = slam.map.poses.copy()
    poses[44:, 0] += 40.0  # a loop has shown where the second corridor is
    slam.adopt(Moved(poses))
    finished(slam.checking())
    assert not slam.evidence.contradictions


# Of a place that was found on the map -------------------------------------------------------------

HALL = np.array([(0, 0, 20, 0), (20, 0, 20, 12), (20, 12, 0, 12), (0, 12, 0, 0)], dtype=np.float64)
SCREEN = [(2.0, 5.0, 18.0, 5.0), (2.0, 3.0, 18.0, 3.0)]


def proved(before: Sequence[Floats]) -> Slam:
    """A map of a hall, and a part that was joined to it: three scans of the empty hall.

    `before` has the walls that stood in the hall in each scan of the map.
    """
    slam = Slam(SlamParameters(do_loop_closing=False))
    slam.mode = Mode.MAPPING  # the robot's place on the map is known
    slam.evidence.proof = Proof(len(before), len(before) + 3)
    information = np.diag([1e4, 1e4, 1e4])
    for number, walls in enumerate([*before, *[HALL] * 3]):
        pose = np.array([4.0 + 0.4 * (number % 30), 4.0, 0.0])
        cloud = point_cloud(cast(walls, pose), BEARINGS, max_range=20.0)
        slam.map.add(pose, 0.4, cloud, number, 0)
        if number:
            slam.map.graph.add(Edge(number - 1, number, np.array([0.4, 0.0, 0.0]), information))
        if number >= len(before):
            slam.close_loops()
    return slam


def test_people_who_were_there_when_the_map_was_made_do_not_contradict_a_place_on_it() -> None:
    rng = np.random.default_rng(1)

    def crowd() -> Floats:
        x, y = rng.uniform((1.0, 5.0), (19.0, 11.0), (30, 2)).T
        return np.vstack([HALL, np.column_stack([x, y, x + 0.4, y])])

    assert not proved([crowd() for _ in range(30)]).evidence.contradicted


def test_a_wall_that_is_looked_through_contradicts_a_place() -> None:
    assert proved([np.vstack([HALL, SCREEN])] * 30).evidence.contradicted
