"""The front end of SLAM: where a scan lies on the scans before it, and whether it contradicts them.

It holds no map: `slam` gives it the key scans near the robot, `localization` the newest ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from msgspec import Struct

from armadico.agents.methods.odometry_model import OdometryModel, OdometryParameters
from armadico.agents.methods.parameters import Count, Positive
from armadico.agents.methods.poses import Floats, jacobian_of_step, transformed
from armadico.agents.methods.scan_matching import (
    LEAST_MATCHED,
    LikelihoodField,
    Match,
    MatcherParameters,
    PointCloud,
    Prior,
    Window,
    correlate,
    in_world,
    point_cloud,
    point_to_line,
    share_of,
    through_walls,
    voxel_filtered,
)

RAYS_APART: Final = 0.0132
"""Of a scanner whose rays are closer than half of this, rad, only some are matched: normals are
fitted to neighbours, and the noise of the ranges must be small beside their distance."""

KeyScans = Sequence[tuple[Floats, PointCloud]]
"""Poses and points of key scans, the newest last."""


class FrontEndParameters(Struct, frozen=True, kw_only=True):
    """Names as in slam_toolbox, else as in Cartographer, where these have the parameter."""

    max_range: Positive = 20.0  # m, of rays that count (max_laser_range)
    minimum_travel_distance: Positive = 0.3  # m from one key scan to the next,
    minimum_travel_heading: Positive = 0.3  # or rad
    scan_buffer_size: Count = 50  # key scans of the local map
    correlation_search_space_dimension: Positive = 0.6  # m, half of the window, at most
    search_minimum: Positive = 0.15  # m, the window at least,
    search_minimum_angle: Positive = 0.12  # rad
    search_deviations: Positive = 1.5  # of the odometry, that are added to it
    match_good: Positive = 0.65  # share of points that fit, from which a match counts fully,
    match_weak: Positive = 0.4  # up to which it counts least:
    match_weak_information: Positive = 0.05
    lost_share: Positive = 0.3  # of a badly fitting scan or of the map that contradict each other:
    lost_scans: Count = 3  # that many such scans, and the robot counts as carried
    matcher: MatcherParameters = MatcherParameters()
    odometry: OdometryParameters = OdometryParameters()


class FrontEnd:
    """Places scans on a local map, with the odometry as a prior; learns the odometry's errors."""

    def __init__(self, parameters: FrontEndParameters, *, sides: bool = False) -> None:
        """Begin with odometry of the assumed deviations.

        With `sides` the two sides of a wall are told apart.
        """
        self.parameters = parameters
        self._sides = sides
        self.model = OdometryModel(parameters.odometry)
        self.field: LikelihoodField | None = None  # of the local map of the newest match

    def matched(
        self,
        local: PointCloud,
        cloud: PointCloud,
        guess: Floats,
        step: Floats,
        usual: float = 1.0,
    ) -> tuple[Match, Prior]:
        """The match on a local map: in a small window, then in the full one if it fits badly.

        Args:
            local: Points and normals of the local map, in the world.
            cloud: Of the scan.
            guess: The pose by the odometry.
            step: By the odometry, since the scan before.
            usual: Share of points that fit, of which `match_good` is taken.
        """
        p, prior = self.parameters, self.model.prior(step)
        reach = float(np.hypot(*cloud.points.T).max()) + 1.5
        self.field = likelihood = LikelihoodField(local, guess[:2], reach, p.matcher)
        found = self.search(likelihood, cloud, guess, prior)
        wide = self.model.prior(step, factors=(1.0, 1.0))
        if found.inliers < p.match_good * usual and wide != prior:
            other = self.search(likelihood, cloud, guess, wide)
            if other.inliers > found.inliers + 0.05:
                return other, wide
        return found, prior

    def search(
        self, likelihood: LikelihoodField, cloud: PointCloud, guess: Floats, prior: Prior
    ) -> Match:
        """The best pose about a guess, by correlation, then from points to lines."""
        p, most = self.parameters, self.parameters.correlation_search_space_dimension
        window = Window(
            min(most, p.search_minimum + p.search_deviations * prior.position),
            min(0.6, p.search_minimum_angle + p.search_deviations * prior.heading),
        )
        m = p.matcher
        sample = voxel_filtered(cloud.points, m.voxel_filter_size, m.voxel_filter_points)
        pose, _ = correlate(likelihood, sample, guess, window, prior)
        facing = cloud.normals if self._sides else None
        return point_to_line(likelihood, cloud.points, pose, prior, guess, facing)

    def information(self, match: Match) -> Floats:
        """(3, 3) of a match in the world: that of a match that fits badly counts less."""
        p = self.parameters
        good = (p.match_good - match.inliers) / (p.match_good - p.match_weak)
        share = float(p.match_weak_information ** min(1.0, max(0.0, good)))
        found: Floats = share * match.information
        return found

    def learn(
        self, match: Match, prior: Prior, step: Floats, moved: Floats, *, heading: bool = False
    ) -> None:
        """Learn the odometry's errors from a step, if its match is good and determined.

        `step` is by the odometry, `moved` by scan matching. With `heading`, those of the heading
        alone are learned where the position is not determined.
        """
        if match.inliers < self.parameters.match_good:
            return
        least = np.linalg.eigvalsh(match.information[:2, :2])[0]
        determined = bool(least > 4.0 * prior.position**-2)
        if determined or heading:
            self.model.learn(step, moved, position=determined)

    def contradicts(
        self,
        before: KeyScans,
        since: KeyScans,
        pose: Floats,
        cloud: PointCloud,
        origin: tuple[float, float],
        *,
        last: bool,
        field: LikelihoodField | None = None,
    ) -> bool | None:
        """Whether a scan contradicts some key scans, False if it fits, None if neither.

        It is placed where it fits best. Then it contradicts by the walls of the map that it looks
        through, or by its points where the map is free, if those stand where the doubtful scans
        before it have seen them: people move. It must contradict more than it fits, since moved
        furniture changes only a part of a scan.

        Args:
            before: The key scans.
            since: Doubtful key scans after these.
            pose: Of the scan.
            cloud: Of the scan.
            origin: The scanner in the robot's frame, m.
            last: Whether it is the last scan of those that decide: a bad fit is enough.
            field: Of the key scans, if it is drawn already.
        """
        p, reach = self.parameters, float(np.hypot(*cloud.points.T).max()) + 1.5
        likelihood = field or LikelihoodField(in_world(before), pose[:2], reach, p.matcher)
        match = self.search(likelihood, cloud, pose, Prior(0.3, 0.3))
        if match.inliers >= p.match_good:
            return False
        if match.inliers < p.match_weak and last:
            return True  # by now the robot may have left what the map shows
        walls = likelihood.points
        share, passed, met = through_walls(before, walls, match.pose, cloud, origin)
        known, empty = passed + met > 0, (passed >= 2) & (passed > 2 * met)
        if since:
            there = LikelihoodField(in_world(since), pose[:2], reach, p.matcher)
            empty &= there.near(transformed(pose, cloud.points))
        share = max(share, share_of(empty, known, LEAST_MATCHED))
        return True if share > max(p.lost_share, match.inliers) else None


def after_step(covariance: Floats, start: Floats, step: Floats, more: Floats) -> Floats:
    """A covariance in the world, (3, 3), after a step from a pose that adds to it."""
    turn = jacobian_of_step(start, step)
    moved: Floats = turn @ covariance @ turn.T + more
    return moved


def matched_points(
    ranges: Floats, bearings: Floats, origin: tuple[float, float], max_range: float
) -> PointCloud:
    """The points of a scan that are matched: of dense rays every second, third, ... one."""
    every = 1
    if len(bearings) > 1 and bearings[0] != bearings[-1]:
        step = abs(float(bearings[-1] - bearings[0])) / (len(bearings) - 1)
        every = max(1, int(RAYS_APART / step))
    return point_cloud(ranges[::every], bearings[::every], origin, max_range)
