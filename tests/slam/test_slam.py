"""SLAM on generated places: drift is removed, and twins are not folded."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from armadico.agents.methods.poses import Floats, compose, relative
from armadico.agents.slam.logs.logs import drifted
from armadico.agents.slam.loop_closure import LoopParameters
from armadico.agents.slam.pose_graph import GraphParameters, Kernel
from armadico.agents.slam.slam import Slam, SlamParameters
from tests.robot.scans import BEARINGS, cast, drive
from tests.slam.worlds import false_loops, mapped, off, ring, square, twins

PATH = square()


def test_a_drift_of_metres_becomes_centimetres() -> None:
    odometry = drifted(PATH, 0.1, 2)
    assert np.hypot(*(odometry - PATH)[:, :2].T).max() > 1.0
    slam, _ = mapped(ring(), PATH, odometry)
    assert off(slam, PATH).max() < 0.1
    assert len(slam.map.loops) > 20
    assert not false_loops(slam, PATH)
    assert slam.map.revision >= 1
    assert not slam.uncertain


def test_loops_do_it() -> None:
    path = PATH[:100]
    parameters = SlamParameters(do_loop_closing=False)
    alone, _ = mapped(ring(), path, drifted(path, 0.1, 2), parameters)
    assert not alone.map.loops
    assert alone.map.revision == 0


def test_the_covariance_grows_with_the_way_and_shrinks_at_a_loop() -> None:
    _, updates = mapped(ring(), PATH, drifted(PATH, 0.05, 1))
    covariances = [update.covariance for update in updates if update.key]
    deviation = np.sqrt([np.trace(each[:2, :2]) for each in covariances])
    assert deviation[:70].max() > 5.0 * deviation[2]
    assert deviation[-1] < 0.2 * deviation.max()


FORCED = LoopParameters(loop_search_minimum_distance=4.0, loop_search_maximum_distance=4.0)
CORNERS = [(-1, 0), (0, 0), (19, 0), (-1, 0), (-1, 3), (19, 3), (-1, 3), (-1, 0)]
TWINS = drive([(float(x), float(y)) for x, y in CORNERS], step=0.4)


def test_a_twin_corridor_is_not_folded() -> None:
    slam, _ = mapped(twins(3.0), TWINS, drifted(TWINS, 0.1, 1))
    assert not [weight for weight in false_loops(slam, TWINS) if weight > 0.5]
    assert off(slam, TWINS).max() < 0.3


@pytest.mark.long
def test_false_loops_to_a_twin_are_switched_off_and_without_a_kernel_they_fold_the_map() -> None:
    slam, _ = mapped(twins(3.0), TWINS, drifted(TWINS, 0.05, 1), SlamParameters(loops=FORCED))
    false = false_loops(slam, TWINS)
    assert len(false) > 20
    assert not [weight for weight in false if weight > 0.5]
    assert off(slam, TWINS).max() < 0.3
    assert "contradict" in slam.uncertain
    slam.map.graph.parameters = GraphParameters(loss=Kernel.NONE)
    slam.map.poses = slam.map.graph.optimise(slam.map.poses)
    assert off(slam, TWINS).max() > 0.8


def test_scans_that_cannot_be_used_are_left_out() -> None:
    slam, pose = Slam(), PATH[0]
    ranges = cast(ring(), pose)
    assert slam.add(1.0, [np.nan, 0.0, 0.0], ranges, BEARINGS) is None
    assert slam.add(1.0, pose, np.full(len(ranges), np.nan), BEARINGS) is None
    first = slam.add(2.0, pose, ranges, BEARINGS)
    assert first is not None
    assert first.key
    assert slam.add(2.0, pose, ranges, BEARINGS) is None  # time does not go on,
    assert slam.add(1.5, pose, ranges, BEARINGS) is None  # or goes back
    assert slam.evidence.rejected == 4
    there = slam.add(1e9, pose, ranges, BEARINGS)  # a jump forward is no harm
    assert there is not None
    assert not there.key


def test_nan_among_the_ranges_and_a_scanner_upside_down_give_the_same_map() -> None:
    path = PATH[:40]
    odometry = drifted(path, 0.05, 3)
    slam, turned = Slam(), Slam()
    for number, pose in enumerate(path):
        ranges = cast(ring(), pose)
        ranges[::9] = np.nan
        slam.add(0.1 * number, odometry[number], ranges, BEARINGS, number=number)
        turned.add(0.1 * number, odometry[number], ranges[::-1], BEARINGS[::-1], number=number)
    assert off(slam, path).max() < 0.08
    assert np.abs(slam.map.poses - turned.map.poses).max() < 0.02


def test_a_scanner_that_is_not_in_the_middle() -> None:
    slam, path = Slam(), PATH[:40]
    for number, pose in enumerate(path):
        c, s = np.cos(pose[2]), np.sin(pose[2])
        at = pose[0] + 0.3 * c, pose[1] + 0.3 * s, pose[2]
        ranges = cast(ring(), at)
        slam.add(0.1 * number, pose, ranges, BEARINGS, origin=(0.3, 0.0), number=number)
    assert off(slam, path).max() < 0.08


def test_a_robot_that_is_carried_to_another_room_is_noticed() -> None:
    hall = np.array([[30, -8, 50, -8], [50, -8, 50, 8], [50, 8, 30, 8], [30, 8, 30, -8]])
    walls = np.concatenate([ring(), hall, ring(4.0, 2.0) + np.array([45.0, 3.0, 45.0, 3.0])])
    slam, path, carried = Slam(), PATH[:40], drive([(33.0, -4.0), (42.0, -4.0)])
    odometry = [*path, *compose(path[-1], relative(carried[0], carried))]
    for number, pose in enumerate([*path, *carried]):
        slam.add(0.1 * number, odometry[number], cast(walls, pose), BEARINGS, number=number)
        slam.close_loops()
        if number == len(path) - 1:
            assert not slam.evidence.carried
    assert len(slam.evidence.carried) == 1
    assert "carried" in slam.uncertain
    assert not slam.map.loops
    # The new room has its own walls, as they are to each other.
    there = slam.evidence.carried[0]
    found = relative(slam.map.poses[there], slam.map.poses[-1])
    truth = relative(carried[slam.map.numbers[there] - len(path)], carried[-1])
    assert np.abs(found - truth).max() < 0.15


def box(x: float, y: float, half: float = 0.2) -> Floats:
    """(4, 4) walls of something square."""
    turns = [(-half, -half), (half, -half), (half, half), (-half, half), (-half, -half)]
    return np.array([(x + a, y + b, x + c, y + d) for (a, b), (c, d) in pairwise(turns)])


def test_a_robot_that_is_carried_to_a_place_with_nearer_walls_is_noticed() -> None:
    """Its scans look through no wall: they end where the map is free."""
    hall = ring(16.0, 2.0)
    narrow = np.concatenate([ring(3.0, 0.2), box(1.0, 0.5)]) + 60.0
    slam, path = Slam(), drive([(-6.0, -4.0), (6.0, -4.0)])
    carried = drive([(59.0, 59.0), (61.0, 59.0), (61.0, 60.5)], step=0.31)
    odometry = [*path, *compose(path[-1], relative(carried[0], carried))]
    walls = np.concatenate([hall, narrow])
    for number, pose in enumerate([*path, *carried]):
        slam.add(0.1 * number, odometry[number], cast(walls, pose), BEARINGS, number=number)
        if number == len(path) - 1:
            assert not slam.evidence.carried
    assert slam.evidence.carried == [len(path)]


def test_people_and_moved_furniture_do_not_count_as_another_place() -> None:
    """A crowd hides a third of the walls, other people at each scan; then new boxes stand there."""
    slam, path, rng = Slam(), PATH[:60], np.random.default_rng(4)
    boxes = np.concatenate([box(-3.0, 3.0), box(0.0, 3.1), box(3.2, 0.5), box(3.0, -2.0)])
    for number, pose in enumerate(path):
        ranges = cast(ring() if number < 35 else np.concatenate([ring(), boxes]), pose)
        if 10 <= number < 35:
            for bearing in rng.uniform(-2.2, 2.2, 6):
                near = rng.uniform(0.6, 1.5)
                ranges[np.abs(BEARINGS - bearing) < 0.2 / near] = near
        slam.add(0.1 * number, path[number], ranges, BEARINGS, number=number)
    assert not slam.evidence.carried
    assert off(slam, path).max() < 0.2


def test_of_a_dense_scanner_only_some_rays_are_matched() -> None:
    dense = np.linspace(-2.3, 2.3, 1081)
    slam = Slam()
    slam.add(0.0, PATH[0], cast(ring(), PATH[0], dense), dense)
    assert 300 < len(slam.map.clouds[0].points) < 400


def test_the_memory_is_bounded() -> None:
    slam, _ = mapped(ring(), PATH[:60], PATH[:60], SlamParameters(maximum_key_scans=20))
    assert len(slam.map.poses) == len(slam.map.clouds) == 20
    assert slam.full


def test_the_covariance_on_the_map_near_the_robot_does_not_grow_with_the_way() -> None:
    """What a robot drives by: without a loop only the place of that map becomes uncertain."""
    path = PATH[: len(PATH) // 3]
    parameters = SlamParameters(do_loop_closing=False)
    _, updates = mapped(ring(), path, drifted(path, 0.1, 2), parameters)
    first, last = updates[10], updates[-1]
    assert last.covariance[0, 0] + last.covariance[1, 1] > 2.0 * np.trace(first.covariance[:2, :2])
    assert np.trace(last.near_covariance[:2, :2]) < 2.0 * np.trace(first.near_covariance[:2, :2])
    assert np.trace(last.near_covariance[:2, :2]) < 0.1**2


@pytest.mark.long
def test_a_jump_of_the_odometry_is_no_motion() -> None:
    odometry = drifted(PATH, 0.05, 1)
    odometry[60:] = compose(
        compose(odometry[60], np.array([4.0, -3.0, 0.4])), relative(odometry[60], odometry[60:])
    )
    slam, _ = mapped(ring(), PATH, odometry)
    assert len(slam.evidence.leaps) == 1
    assert off(slam, PATH).max() < 0.1
    assert slam.parts == 1
    assert not slam.uncertain
    assert np.hypot(*(slam.pose_at(odometry[-1]) - PATH[-1])[:2]) < 0.1


def test_a_jump_of_the_odometry_that_no_scan_explains_is_a_doubt() -> None:
    slam = Slam()
    for number, pose in enumerate(PATH[:40]):
        jumped = number >= 30
        # Where the robot really is after the jump nothing looks like the map.
        there = cast(
            ring(4.0 if jumped else 9.0, 1.0 if jumped else 5.0), 0.4 * pose if jumped else pose
        )
        here = pose + np.array([6.0, 0.0, 0.0]) if jumped else pose
        slam.add(0.1 * number, here, there, BEARINGS, number=number)
    assert "the odometry jumped 1 times" in slam.uncertain
