"""Loop closure: recognising that the robot is where it was before.

Candidates are earlier chains of scans within a radius that follows the uncertainty of the pose. A
candidate is matched by branch and bound, and must score well, fit lines, have no rival elsewhere
and determine all three coordinates. One that moves the pose visibly must agree with others first.

None of these tests rejects a twin of a place: its matches score well and agree with each other. A
twin outside the radius is not tried, and one within it contradicts the true loops, so that the
kernel of the pose graph switches it off.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from math import hypot
from typing import Final, NamedTuple

import numpy as np
from msgspec import Struct

from armadico.agents.methods.parameters import Count, Positive
from armadico.agents.methods.poses import (
    Floats,
    compose,
    relative,
    rotation,
    transformed,
    wrapped,
)
from armadico.agents.methods.scan_matching import (
    Indices,
    LikelihoodField,
    MatcherParameters,
    PointCloud,
    Window,
    branch_and_bound,
    in_world,
    point_to_line,
    voxel_filtered,
)
from armadico.agents.methods.slices import Sliced

FIELD_WORK: Final = 80
"""Work of a point of a new field, in look-ups (`slices`)."""

ICP_WORK: Final = 350
"""Work of a point that is moved towards its line, in all rounds."""


class LoopParameters(Struct, frozen=True, kw_only=True):
    """Names as in slam_toolbox where it has the parameter."""

    loop_search_minimum_distance: Positive = 1.5  # m, the radius of a pose that is known well
    loop_search_deviations: Positive = 3.0  # standard deviations that are added to it
    loop_search_share: Positive = 0.02  # of the way since the last loop, that is added at least
    loop_search_maximum_distance: Positive = 5.0  # m
    loop_search_angle: Positive = 0.6  # rad, and less for a pose that is known well:
    loop_search_angle_sure: Positive = 0.35
    loop_minimum_way: Positive = 8.0  # m between the two visits (loop_match_minimum_chain_size)
    loop_chain: Count = 6  # scans of the old visit before and after the nearest,
    loop_chain_way: Positive = 6.0  # and no farther along the way, m
    loop_scans: Count = 4  # of the present visit
    loop_places: Count = 2  # that are tried for each scan
    loop_match_minimum_response_fine: Positive = 0.45
    loop_minimum_inliers: Positive = 0.5
    loop_maximum_spread: Positive = 0.6  # m, to a rival
    loop_minimum_information: Positive = 50.0  # smallest eigenvalue: fails in a bare corridor
    loop_support: Count = 3  # that agree, for a loop that moves the pose by more than
    loop_near: Positive = 0.25  # m or
    loop_near_angle: Positive = 0.06  # rad
    loop_support_way: Positive = 1.0  # m that those must span,
    loop_memory: Positive = 12.0  # and within which they must come


class Loop(NamedTuple):
    """A place that was recognised: the pose of a scan in the frame of an earlier one."""

    start: int
    end: int
    pose: Floats
    information: Floats  # in the frame of the start
    score: float
    inliers: float
    moved: float  # m that the pose would move


class Refusal(Enum):
    """Why a candidate is no loop."""

    SCORE = "score"
    INLIERS = "inliers"
    RIVAL = "rival"
    CORRIDOR = "corridor"
    ALONE = "no support yet"


class Track(NamedTuple):
    """The key scans of a map at a time; entries beyond the poses are not used."""

    poses: Floats  # (n, 3)
    way: Sequence[float]  # driven at each, m
    clouds: Sequence[PointCloud]
    part: Indices  # of the map that each is of; loops are within one


class LoopCloser:
    """Finds loops of the newest scan, and waits for those that need support."""

    def __init__(self, parameters: LoopParameters, matcher: MatcherParameters) -> None:
        """Begin without candidates."""
        self.parameters, self.matcher = parameters, matcher
        self.pending: list[Loop] = []
        self.refused: dict[Refusal, int] = dict.fromkeys(Refusal, 0)

    def radius(self, deviation: float, way: float) -> float:
        """How far the newest scan may be from the place that it recognises, m.

        By the standard deviation of its position since the last loop, m, and the way driven since
        then, m.
        """
        p = self.parameters
        uncertain = max(p.loop_search_deviations * deviation, p.loop_search_share * way)
        return min(p.loop_search_maximum_distance, p.loop_search_minimum_distance + uncertain)

    def finding(self, track: Track, radius: float) -> Sliced[list[Loop]]:
        """The loops of the newest scan that are accepted now, with those that they support."""
        found: list[Loop] = []
        for near in self._places(track, radius):
            loop = yield from self._matched(track, near, radius)
            if isinstance(loop, Refusal):
                self.refused[loop] += 1
            else:
                found += self._supported(track, loop)
        return found

    def _places(self, track: Track, radius: float) -> list[int]:
        """The nearest earlier scan of each visit, by place and a little by heading."""
        p, newest = self.parameters, len(track.poses) - 1
        way, here = np.asarray(track.way[: newest + 1]), track.poses[newest]
        mine = track.part[: newest + 1] == track.part[newest]
        old = np.flatnonzero(mine & (way[newest] - way > p.loop_minimum_way))
        away = np.hypot(*(track.poses[old, :2] - here[:2]).T)
        old, away = old[away < radius], away[away < radius]
        turn = np.abs(wrapped(track.poses[old, 2] - here[2]))
        found: list[int] = []
        for scan in old[np.argsort(away + 0.3 * turn, kind="stable")].tolist():
            if len(found) == p.loop_places:
                break
            if all(abs(way[scan] - way[other]) >= p.loop_chain_way for other in found):
                found.append(scan)
        return found

    def _matched(self, track: Track, near: int, radius: float) -> Sliced[Loop | Refusal]:
        """The newest scans on the chain about an earlier one."""
        p, newest = self.parameters, len(track.poses) - 1
        way, here = track.way, track.poses[newest]
        chain = [
            scan
            for scan in range(max(0, near - p.loop_chain), min(near + p.loop_chain, newest - 1) + 1)
            if way[newest] - way[scan] > 0.6 * p.loop_minimum_way
            and track.part[scan] == track.part[newest]
        ]
        mine = range(max(0, newest - p.loop_scans + 1), newest + 1)
        points = np.concatenate(
            [transformed(relative(here, track.poses[k]), track.clouds[k].points) for k in mine]
        )
        reach = float(np.hypot(*points.T).max())
        old = in_world([(track.poses[k], track.clouds[k]) for k in chain])
        field = LikelihoodField(old, here[:2], reach + radius + 1.0, self.matcher)
        yield FIELD_WORK * len(old.points)
        sure = radius < 2.0
        angle = p.loop_search_angle_sure if sure else p.loop_search_angle
        sample = voxel_filtered(points, 0.15, 250)
        score = p.loop_match_minimum_response_fine
        window = Window(radius, angle)
        candidate = yield from branch_and_bound(field, sample, here, window, score)
        if candidate is None:
            return Refusal.SCORE
        if candidate.spread > p.loop_maximum_spread:
            return Refusal.RIVAL
        match = point_to_line(field, points, candidate.pose)
        yield ICP_WORK * len(points)
        if match.inliers < p.loop_minimum_inliers:
            return Refusal.INLIERS
        shift = match.pose - candidate.pose
        if hypot(shift[0], shift[1]) > 0.3:
            return Refusal.INLIERS
        information = match.information / p.loop_scans  # their points repeat each other
        if float(np.linalg.eigvalsh(information)[0]) < p.loop_minimum_information:
            return Refusal.CORRIDOR
        turn = rotation(track.poses[near, 2])
        moved = match.pose - here
        return Loop(
            near,
            newest,
            relative(track.poses[near], match.pose),
            turn.T @ information @ turn,
            candidate.score,
            match.inliers,
            hypot(moved[0], moved[1]),
        )

    def _supported(self, track: Track, loop: Loop) -> list[Loop]:
        """A loop with those that agree with it, if it needs none or has enough of them."""
        p, way = self.parameters, track.way
        turn = relative(track.poses[loop.start], track.poses[loop.end])[2] - loop.pose[2]
        if loop.moved < p.loop_near and abs(wrapped(turn)) < p.loop_near_angle:
            return [loop]
        now = way[loop.end]
        self.pending = [old for old in self.pending if now - way[old.end] < p.loop_memory]
        agree = [old for old in self.pending if _agree(track, old, loop)]
        self.pending.append(loop)
        span = max((now - way[old.end] for old in agree), default=0.0)
        if len(agree) < p.loop_support - 1 or (agree and span <= p.loop_support_way):
            self.refused[Refusal.ALONE] += 1
            return []
        found = [*agree, loop]
        kept = {id(one) for one in found}
        self.pending = [old for old in self.pending if id(old) not in kept]
        return found


def _agree(track: Track, a: Loop, b: Loop) -> bool:
    """Whether the circle over two loops and the ways between them closes."""
    there = compose(a.pose, relative(track.poses[a.end], track.poses[b.end]))
    here = compose(relative(track.poses[a.start], track.poses[b.start]), b.pose)
    return agree(there, here, track.way[a.end] - track.way[b.end], 0.05)


def agree(one: Floats, other: Floats, way: float, angle: float) -> bool:
    """Whether two poses are one, within an angle (rad) and what the odometry errs over a way, m."""
    off = relative(one, other)
    return hypot(off[0], off[1]) < 0.2 + 0.02 * abs(way) and abs(float(off[2])) < angle
