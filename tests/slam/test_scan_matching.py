"""Scan matching: the pose that a scan was taken at is found, and how sure that is."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from armadico.agents.methods.poses import Floats, compose, relative, transformed
from armadico.agents.methods.scan_matching import (
    LikelihoodField,
    MatcherParameters,
    PointCloud,
    Prior,
    Window,
    branch_and_bound,
    correlate,
    in_world,
    looked_at,
    point_cloud,
    point_to_line,
    voxel_filtered,
)
from armadico.agents.methods.slices import finished
from tests.robot.scans import BEARINGS, cast
from tests.slam.worlds import ring

P = MatcherParameters()
HERE = np.array([-3.5, -1.0, 1.5])
ZERO = np.zeros(3)


def scan(pose: Floats) -> PointCloud:
    return point_cloud(cast(ring(), pose), BEARINGS)


def field(half: float = 14.0) -> LikelihoodField:
    """Of a scan from `HERE` and one from a little farther on."""
    there = compose(HERE, np.array([0.4, 0.05, 0.1]))
    near = in_world([(HERE, scan(HERE)), (there, scan(there))])
    return LikelihoodField(near, HERE[:2], half, P)


FIELD = field()


def test_normals_look_at_the_scanner_and_are_square_to_the_walls() -> None:
    room = np.array([[-2, -2, 2, -2], [2, -2, 2, 2], [2, 2, -2, 2], [-2, 2, -2, -2]], dtype=float)
    cloud = point_cloud(cast(room, ZERO), BEARINGS)
    known = ~np.isnan(cloud.normals[:, 0])
    assert known.mean() > 0.85
    assert ((cloud.points * cloud.normals)[known].sum(axis=1) < 0).all()
    assert np.median(np.abs(cloud.normals[known]).max(axis=1)) > 0.999


def score(pose: np.ndarray, points: np.ndarray) -> float:
    columns, rows = FIELD.cells(transformed(pose, points)).T
    return float(FIELD.values[rows * FIELD.size + columns].mean())


def shifts(offsets: np.ndarray, turns: np.ndarray) -> np.ndarray:
    axes = np.meshgrid(offsets, offsets, turns)
    return np.column_stack([axis.ravel() for axis in axes])


@settings(max_examples=20, deadline=None)
@given(x=st.floats(-0.25, 0.25), y=st.floats(-0.25, 0.25), turn=st.floats(-0.2, 0.2))
def test_a_small_shift_is_found(x: float, y: float, turn: float) -> None:
    at = compose(HERE, np.array([0.2, 0.0, 0.05]))
    cloud, guess = scan(at), at + np.array([x, y, turn])
    prior = Prior(0.3, 0.3)
    points = voxel_filtered(cloud.points, 0.1, 200)
    pose, score = correlate(FIELD, points, guess, Window(0.4, 0.35), prior)
    match = point_to_line(FIELD, cloud.points, pose, prior, guess)
    assert score > 0.7
    assert match.inliers > 0.8
    off = relative(at, match.pose)
    assert np.abs(off).max() < 0.03


@settings(max_examples=8, deadline=None)
@given(x=st.floats(-1.5, 1.5), y=st.floats(-1.5, 1.5), turn=st.floats(-0.3, 0.3))
def test_branch_and_bound_finds_the_best_of_a_large_window(x: float, y: float, turn: float) -> None:
    cloud, guess = scan(HERE), HERE + np.array([x, y, turn])
    points = voxel_filtered(cloud.points, 0.15, 120)
    found = finished(branch_and_bound(FIELD, points, guess, Window(2.0, 0.35), 0.4))
    assert found is not None
    assert np.abs(relative(HERE, found.pose)).max() < 0.1
    assert abs(score(found.pose, points) - found.score) < 0.2


def test_branch_and_bound_is_exhaustive_search_faster() -> None:
    cloud = scan(HERE)
    points = voxel_filtered(cloud.points, 0.3, 60)
    window, guess = Window(0.5, 0.06), HERE + np.array([0.2, -0.1, 0.03])
    found = finished(branch_and_bound(FIELD, points, guess, window, 0.1))
    assert found is not None
    offsets = np.arange(-10, 26) * P.resolution
    turns = np.arange(-3, 4) * P.coarse_angle_resolution
    best = max(score(guess + shift, points) for shift in shifts(offsets, turns))
    assert found.score == pytest.approx(best, abs=1e-2)


@pytest.mark.parametrize("turn", [-0.15, 0.0, 0.12])
def test_correlation_finds_the_best_pose_of_its_window(turn: float) -> None:
    points = voxel_filtered(scan(HERE).points, 0.1, 200)
    guess, prior = HERE + np.array([0.2, -0.14, turn]), Prior(0.2, 0.2)
    _, found = correlate(FIELD, points, guess, Window(0.3, 0.2), prior)
    offsets = np.arange(-3, 4) * 2 * P.resolution
    turns = np.arange(-10, 11) * P.coarse_angle_resolution
    assert found >= max(score(guess + shift, points) for shift in shifts(offsets, turns)) - 0.01


def test_nothing_is_found_where_nothing_fits() -> None:
    elsewhere = np.array([1e3, 1e3, 0.0])
    points = scan(HERE).points
    assert finished(branch_and_bound(FIELD, points, elsewhere, Window(1.0, 0.1), 0.3)) is None
    assert point_to_line(FIELD, points, elsewhere).inliers == 0.0


def test_a_bare_corridor_tells_nothing_along_it() -> None:
    walls = np.array([[-50.0, -1.0, 50.0, -1.0], [-50.0, 1.0, 50.0, 1.0]])
    cloud = point_cloud(cast(walls, ZERO), BEARINGS)
    bare = LikelihoodField(in_world([(ZERO, cloud)]), ZERO[:2], 22.0, P)
    match = point_to_line(bare, cloud.points, ZERO)
    along, across = match.information[0, 0], match.information[1, 1]
    assert across > 500.0 * max(along, 1e-9)
    # Only the prior keeps the pose.
    guess = np.array([0.2, 0.05, 0.0])
    pose = point_to_line(bare, cloud.points, guess, Prior(0.1, 0.1)).pose
    assert abs(pose[0] - 0.2) < 0.05
    assert abs(pose[1]) < 0.01


def test_the_far_side_of_a_thin_wall_does_not_pull_a_pose_to_the_near_one() -> None:
    """Seen from the other side for the first time, 0.1 m behind the side that is known."""
    side = np.array([[1.0, -3.0, 1.0, 3.0]])
    near = LikelihoodField(
        in_world([(ZERO, point_cloud(cast(side, ZERO), BEARINGS))]), ZERO[:2], 8.0, P
    )
    behind = np.array([2.0, 0.0, np.pi])
    cloud = point_cloud(cast(side + np.array([0.1, 0.0, 0.1, 0.0]), behind), BEARINGS)
    prior = Prior(0.1, 0.1)
    pulled = point_to_line(near, cloud.points, behind, prior).pose
    assert abs(pulled[0] - 2.0) > 0.05
    kept = point_to_line(near, cloud.points, behind, prior, facing=cloud.normals).pose
    assert kept[:2] == pytest.approx(behind[:2])
    same, off = point_cloud(cast(side, ZERO), BEARINGS), np.array([0.05, 0.0, 0.0])
    found = point_to_line(near, same.points, off, prior, facing=same.normals).pose
    assert abs(found[0]) < 0.01


def test_rays_through_known_walls_are_counted() -> None:
    cloud = scan(HERE)
    back = relative(HERE, ZERO)
    known = transformed(back, transformed(HERE, cloud.points))
    visible, through = looked_at(cloud, known, (0.0, 0.0))
    assert visible.mean() > 0.9
    assert through.mean() < 0.05
    assert looked_at(cloud, 0.4 * known, (0.0, 0.0))[1].mean() > 0.5
    assert looked_at(cloud, 2.0 * known, (0.0, 0.0))[0].mean() < 0.1
