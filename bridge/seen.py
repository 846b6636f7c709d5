"""What a robot's sensors have shown: where something is, and what they saw to be free.

Places are kept in the odometry's frame, so they move along with the robot. A point stays until a
newer reading looks through its place, or for `KEPT_S`: what has left the sensors' view is still
there. A place counts as free for `LATELY_S` after a reading showed it:

- A laser shows what lies between two neighbouring rays, as far as no object of `SHARE` of the
  robot's width fits between them, and at most `DARK_M` along rays without a return.
- A sonar shows its cone up to the nearer of its last two echoes, as one may be lost, and at most
  `HEARD_M`: a smooth wall at a slant returns no echo. Nearer, a sonar of the ring that is square to
  the wall hears it, or this one its edge.

An echo may come from any place of an arc. Its points are those that no other sonar looked through.
Or it comes from a smooth wall, which goes on to both sides, where no sonar hears it: on each
tangent of the arc that no other sonar excludes, space is not seen to be free, and near the arc the
wall counts as heard. Behind and beside the robot, where no sonar looks, memory does: near points
are joined where the robot fits through no gap between them, and go on into unseen cells.

Nearer than a sonar's least range it only knows that something is there: what was heard before stays
where it was.

What a scan would not show it does not refute: the end of a wall that it looks along stays.

A wall at the edge of a laser's view goes on beyond it, unless a place there was seen to be free.
What moves towards the laser is expected to go on: its places of the next moments count as taken.

Frame of the arguments: the body's, x forward, y left, origin at the middle of the wheel axle;
m, rad, s.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import cos, floor, hypot, inf, radians, sin, sqrt, tan, tau
from typing import Final

import numpy as np

from armadico.config.profile import RobotProfile
from armadico.mobile.admissible import View
from armadico.mobile.geometry import Pose2
from armadico.mobile.messages import Echo, Scan
from armadico.mobile.scans import Flags, Floats, beside, edge_on, paired, points_of, ranges_of

KEPT_S: Final = 10.0
"""Greatest age of a point that no reading has looked through since, unless it is near."""

NEAR_M: Final = 0.3
"""Within this of the footprint a point does not age: the gaps between sonars are widest there, and
a robot that stands before an obstacle in such a gap hears it no more."""

LATELY_S: Final = 10.0
"""Time for which a place counts as free after a reading showed it."""

SHARE: Final = 0.75
"""Width, relative to the robot's, of objects that a ray must meet before the robot does. Chosen:
with half the width robots crept, and their maps dropped obstacles before they had passed them."""

DARK_M: Final = 3.0
"""Range up to which a laser sees dark surfaces, as for maps (`grid_mapping`)."""

HEARD_M: Final = 1.0
"""Range up to which a ring of sonars hears a slanted smooth wall or its edge. An edge is heard up
to 0.4 m for certain, up to 1 m by four pings of ten (`configs/robots/sensors.toml`)."""

ARC_M: Final = 1.0
"""Echoes from nearer count on their whole arc, farther ones on the axis: they limit nothing yet."""

ARC: Final = np.array([0.0, -0.95, 0.95, -0.5, 0.5])
"""Places on the arc, as shares of half the cone."""

SURE_RAD: Final = radians(25)
"""A smooth wall is taken to answer if its normal is within this of the axis. By `sensors.toml` it
does so for certain within 15 degrees only: a limit that `docs/safe-motion.md` names."""

TANGENTS: Final = SURE_RAD * np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
ALONG_M: Final = np.linspace(-0.5, 0.5, 11)
"""Normals of walls, from the axis, and places on the wall, from the foot of the normal. At 0.6 m/s
the robot stops within the last one."""

SURE_M: Final = 0.11
"""Up to here along it a wall that nothing excludes counts as an obstacle, farther as unseen: the
corner of a robot that creeps along it would touch it beside the echo's arc."""

GOES_ON_M: Final = 0.15
"""What was heard near the footprint goes on so far, where no sonar has looked since."""

NOISE_M: Final = 0.01
"""Twice the noise of echoes from near."""

INSIDE_M: Final = 0.05
"""A point counts until it is so far inside the footprint: it came there by noise and drift."""

THROUGH_M: Final = 0.1
"""A sonar looked through a place that is nearer than its echo by this."""

EDGE_M: Final = 0.4
"""Nearer than this a sonar hears each edge, so it looks through from any direction: else what was
heard in a gap between sonars would hold a robot for good."""

FACING: Final = cos(radians(25))
"""A place is looked through from the direction from which it was hit, within this: a wall answers
from some directions only."""

TWICE_S: Final = 0.5
"""A ring pings twice in this time, so one ping whose echo was lost removes nothing."""

PAIR_S: Final = 1.0
"""Two pings of a sonar within this count together: the nearer echo, since one may be lost."""

BESIDE_RAD: Final = radians(25)
"""A sonar within this of another one's bearing is beside it."""

SAME_M: Final = 0.03
"""A point within this of a known one replaces it."""

ON_M: Final = np.arange(0.05, 0.45, 0.05)
"""Beyond the last point in a laser's view, its wall goes on at these distances: chosen."""

BETWEEN_S: Final = 0.45
"""For this time a point stays although a scan looks through its place: rays may be lost, or pass
a thin object on both sides. Two turns of a laser at 5 Hz."""

APART_S: Final = 0.25
"""Two scans so far apart show what moves: a place that the earlier one looked through is taken."""

WALKS_M: Final = (0.06, 0.5)
"""So far a moving object went from one of these scans to the other: less is noise, and more is
another object."""

AHEAD_S: Final = np.arange(0.15, 0.9, 0.15)
"""Times for which moving objects are expected to go on: a robot stops within the last one, s."""

GONE_S: Final = 1.0
"""A moving object that has left the view counts for this time. Where one was seen lately, so long a
place counts as free after a reading showed it: another may have stepped there."""

SOME: Final = 3
"""So many points that move are an object, and not lost rays."""

LINE_M: Final = (0.05, 0.3)
"""Points of a wall show its direction if they are so far apart, and so near to the last one."""

CELL_M: Final = 0.1
CELLS: Final = 64
"""Size and number of the cells of free space, in both directions, with the robot in the middle."""

AROUND_M: Final = 0.05
"""Beyond the footprint, where the robot stands, space counts as free."""


Mount = tuple[float, float, float]
"""x, y and bearing of a sonar."""


def met_within(step: float, width: float) -> float:
    """The range within which a ray meets every object of a width, m; rays are `step` rad apart."""
    return width / (2.0 * sin(0.5 * abs(step))) if step else inf


def looked_through(away: float) -> float:
    """The distance up to which a sonar that heard nothing nearer than `away` looked through, m."""
    return min(HEARD_M, away - THROUGH_M)


class Seen:
    """Collects readings; `view` returns what they show."""

    def __init__(self, profile: RobotProfile) -> None:
        body = profile.body
        self._footprint = -body.rear_m, body.front_m, body.width_m / 2
        self._width = SHARE * body.width_m
        ring, laser = profile.sonar, profile.laser
        self._noise = max(0.0 if laser is None else laser.noise_m, 0.0 if ring is None else NOISE_M)
        self._least = 0.0 if ring is None else ring.min_m + NOISE_M
        self._blind = 0.0 if laser is None else laser.min_m + 3.0 * laser.noise_m
        self._cone = 0.0 if ring is None else radians(ring.cone_deg) / 2
        # x, y in the odometry's frame, when, the direction of the sonar that hit it, and whether
        # one looked through from elsewhere since
        self._echoed: Floats = np.empty((0, 6))
        self._scanned: Floats = np.empty((0, 3))  # x, y, and when
        self._rows: dict[float, Floats] = {}  # by time: all points of the scans that left some
        self._beyond: Floats = np.empty((0, 2))  # x, y, where walls leave the laser's view
        self._readings: dict[Mount, list[tuple[float, float]]] = {}  # the last two: range, when
        self._walls: dict[Mount, tuple[Floats, float]] = {}  # where they may go on, and when heard
        # Of the last `APART_S`: when, the scan, its ranges, and the pose.
        self._scans: list[tuple[float, Scan, Floats, Pose2]] = []
        self._moving: Floats = np.empty((0, 5))  # x, y, when, and the velocity, m/s
        self._moved_at = -inf  # when an object last moved
        self._number = -1  # of the newest scan
        self._corner: tuple[int, int] | None = None  # of the cells, in cells
        self._free: Floats = np.full((CELLS, CELLS), -inf)  # when last seen, s
        self._pose: Pose2 = (0.0, 0.0, 0.0)
        self._now = 0.0
        self._middles: Floats = CELL_M * (np.arange(CELLS, dtype=np.float64) + 0.5)  # either way

    def update(self, echoes: Iterable[Echo], scan: Scan | None, pose: Pose2, now: float) -> None:
        """Add one cycle's readings, of a robot at a pose by its odometry."""
        self._pose, self._now = pose, now
        self._shift(pose)
        rear, front, half = self._footprint
        x, y, free = self._cells(hypot(max(front, -rear) + AROUND_M, half + AROUND_M))
        around = (rear - AROUND_M < x) & (x < front + AROUND_M) & (np.abs(y) < half + AROUND_M)
        free[around] = now
        self._free_cones([self._hear(echo) for echo in echoes])
        if scan is not None:
            self._look(scan)
        self._echoed, self._scanned = self._kept(self._echoed), self._kept(self._scanned)

    def view(self, within: float) -> View:
        """What is known of the surroundings, up to a distance (m) ahead, behind and aside."""
        echoed, doubted = self._from_world(self._echoed[:, :2]), self._echoed[:, 5] > 0.0
        echoed, cleared = echoed[~doubted], echoed[doubted]
        known = self._from_world(np.concatenate([self._scanned[:, :2], self._beyond]))
        points = np.concatenate([echoed, known, self._expected()])
        points = points[(np.abs(points) < within).all(axis=1)]
        x, y, free = self._cells(sqrt(2.0) * within)
        lately = GONE_S if self._now - self._moved_at < LATELY_S else LATELY_S
        unseen = (self._now - free > lately) & (np.abs(x) < within) & (np.abs(y) < within)
        cells = paired(x[unseen], y[unseen])
        near = echoed[self._beside(echoed) < NEAR_M]
        beside_near = cells[self._beside(cells) < NEAR_M + GOES_ON_M]
        gaps = np.hypot(*(beside_near[:, None] - near).transpose(2, 0, 1))
        hidden = beside_near[(gaps < GOES_ON_M).any(axis=1)]
        walls = [places for places, at in self._walls.values() if self._now - at < PAIR_S]
        places = self._from_world(np.concatenate([np.empty((0, 2)), *walls]))
        sure = np.tile(np.abs(ALONG_M) < SURE_M, len(places) // len(ALONG_M))
        filled = _filled(near, 2.0 * self._footprint[2])
        points = np.concatenate([points, filled, hidden, places[sure]])
        return View(
            points, np.concatenate([cells, places[~sure], cleared]), 0.5 * CELL_M, self._noise
        )

    def _hear(self, echo: Echo) -> tuple[Mount, float]:
        """Add an echo, or its absence. Returns how far the sonar saw its cone to be free, m."""
        away = inf if echo.range is None else echo.range
        mount = echo.x, echo.y, echo.bearing
        before = self._readings.get(mount, [])[-1:]
        self._readings[mount] = [*before, (away, self._now)]
        free = self._nearer(mount)
        seen = mount, min(free, HEARD_M)
        known, heading = self._echoed, echo.bearing + self._pose[2]
        facing = cos(heading) * known[:, 3] + sin(heading) * known[:, 4] > FACING
        old = self._now - known[:, 2] > TWICE_S
        at = self._from_world(known[:, :2])
        along = self._along(at, mount)
        through = along < looked_through(free)
        known[old & through & ~facing, 5] = 1.0
        gone = facing & through
        gone |= along < looked_through(min(free, EDGE_M))
        stays = ~(old & gone)
        known = self._echoed = known[stays]
        if free >= ARC_M:
            self._walls.pop(mount, None)
        if echo.range is None:
            return seen
        blind = away < self._least
        if blind and (explains := self._explains(echo, at[stays])) < inf:
            self._suspect(echo, explains)
            return seen
        bearings = echo.bearing + self._cone * (ARC if away < ARC_M else ARC[:1])
        places = paired(echo.x + away * np.cos(bearings), echo.y + away * np.sin(bearings))
        for other in self._readings:
            if 0.0 < abs(other[2] - echo.bearing) < BESIDE_RAD:
                heard = self._readings[other][-1][0]
                places = places[self._along(places, other) >= looked_through(heard)]
        if blind:
            rear, front, half = self._footprint
            places = np.clip(places, (rear, -half), (front, half))
        if away < ARC_M:
            self._suspect(echo, away)
        new = np.zeros((len(places), 6))
        new[:, :2] = self._to_world(places)
        new[:, 2:5] = self._now, cos(heading), sin(heading)
        off = np.hypot(*(known[:, None, :2] - new[:, :2]).transpose(2, 0, 1))
        self._echoed = np.concatenate([known[(off >= SAME_M).all(axis=1)], new])
        return seen

    def _free_cones(self, seen: list[tuple[Mount, float]]) -> None:
        """Note that sonars have seen their cones to be free, each up to a distance in m."""
        if not seen:
            return
        x, y, free = self._cells(max(hypot(x, y) + reach for (x, y, _), reach in seen))
        mounts = [(x, y, cos(bearing), sin(bearing), reach) for (x, y, bearing), reach in seen]
        at_x, at_y, c, s, reach = np.array(mounts).T[:, :, None, None]
        dx, dy = x - at_x, y - at_y
        ahead, aside = c * dx + s * dy, np.abs(c * dy - s * dx)
        beam = (aside < tan(self._cone) * ahead + 0.5 * CELL_M) & (ahead > 0.0)
        free[(beam & (np.hypot(dx, dy) < reach)).any(axis=0)] = self._now

    def _nearer(self, mount: Mount) -> float:
        """The nearer one of a sonar's last two ranges, m: an echo may be lost. 0: too long ago."""
        return min(
            (away for away, at in self._readings[mount] if self._now - at < PAIR_S), default=0.0
        )

    def _suspect(self, echo: Echo, away: float) -> None:
        """Note where walls may go on that an echo may come from."""
        normals = echo.bearing + TANGENTS
        normals = normals[[self._may_be(normal, echo, away) for normal in normals]]
        mount = echo.x, echo.y, echo.bearing
        self._walls[mount] = self._to_world(_on_walls(echo, away, normals)), self._now

    def _explains(self, echo: Echo, known: Floats) -> float:
        """The distance of the known point that explains an echo from the least range; else inf."""
        dx, dy = known[:, 0] - echo.x, known[:, 1] - echo.y
        away = np.hypot(dx, dy)
        facing = np.cos(np.arctan2(dy, dx) - echo.bearing) > cos(SURE_RAD)
        return float(min(away[facing & (away < self._least + SAME_M)], default=inf))

    def _may_be(self, normal: float, echo: Echo, away: float) -> bool:
        """Whether no sonar's newest reading excludes a wall with this normal."""
        for x, y, bearing in self._readings:
            if abs(bearing - normal) < SURE_RAD:
                due = away + cos(normal) * (echo.x - x) + sin(normal) * (echo.y - y)
                if due < HEARD_M and self._nearer((x, y, bearing)) > due + THROUGH_M:
                    return False
        return True

    def _along(self, places: Floats, mount: Mount) -> Floats:
        """The distances of places from a sonar, m; inf outside of its cone."""
        dx, dy = places[:, 0] - mount[0], places[:, 1] - mount[1]
        c, s = cos(mount[2]), sin(mount[2])
        beam = np.abs(c * dy - s * dx) < tan(self._cone) * (c * dx + s * dy)
        found: Floats = np.where(beam, np.hypot(dx, dy), inf)
        return found

    def _look(self, scan: Scan) -> None:
        """Add a scan: points in its view are those that it shows."""
        if scan.number == self._number and scan.number:
            return
        self._number = scan.number
        ranges = ranges_of(scan)
        reach = min(DARK_M, met_within(scan.step, self._width))
        x, y, free = self._cells(hypot(scan.x, scan.y) + 1.5 * reach)
        near = np.abs(x - scan.x) + np.abs(y - scan.y) < 1.5 * reach
        cells = paired(x[near], y[near])
        away, shown, _ = _rays(scan, ranges, cells)
        fresh = np.where(shown >= np.minimum(away, reach + CELL_M), self._now, -inf)
        fresh[away > reach] = -inf
        free[near] = np.maximum(free[near], fresh)
        away, shown, seen = _rays(scan, ranges, self._from_world(self._echoed[:, :2]))
        # Near ones do not age, and no sonar may look there any more: they do where a laser looks.
        gone = seen & (shown > away + THROUGH_M) & (self._now - self._echoed[:, 2] > KEPT_S)
        self._echoed = self._echoed[~gone]
        known = self._scanned
        away, shown, seen = _rays(scan, ranges, self._from_world(known[:, :2]))
        # Nearer than its least range no scan shows a point again, so none refutes it: rays that
        # pass it, or are lost, would remove it for good.
        blind = away <= self._blind
        old = self._now - known[:, 2] > BETWEEN_S
        passed = seen & (shown >= away + 3.0 * self._noise) & old & ~blind
        seen &= (shown < away + 3.0 * self._noise) | passed
        if passed.any():
            # A door's leaf may have been opened meanwhile: what looks along it shows neither.
            ended = self._now - known[passed, 2] > KEPT_S
            seen[passed] = ended | ~self._edge_on(known[passed], scan)
        points = points_of(scan)
        rear, front, half = self._footprint
        own = (rear < points[:, 0]) & (points[:, 0] < front) & (np.abs(points[:, 1]) < half)
        points = points[~own & (np.hypot(points[:, 0], points[:, 1]) < DARK_M)]
        new = np.column_stack([self._to_world(points), np.full(len(points), self._now)])
        kept = known[~seen & ~blind], _thinned(known[~seen & blind])
        self._scanned = np.concatenate([*kept, new])
        times = {*np.unique(self._scanned[:, 2]).tolist()}
        rows = {**self._rows, self._now: new[:, :2]}
        self._rows = {at: row for at, row in rows.items() if at in times}
        self._go_on(scan, ranges)
        self._follow(scan, ranges)

    def _edge_on(self, points: Floats, scan: Scan) -> Flags:
        """Which points are on a surface that the scan looks along, each by the scan that saw it.

        Not by others: a person who walks away leaves a row of points.
        """
        eye = self._to_world(np.array([[scan.x, scan.y]]))[0]
        found = np.zeros(len(points), dtype=np.bool_)
        for at in np.unique(points[:, 2]).tolist():
            its = points[:, 2] == at
            found[its] = edge_on(points[its, :2], self._rows[at], eye, scan.step)
        return found

    def _follow(self, scan: Scan, ranges: Floats) -> None:
        """Note which of a scan's points move towards the laser, by comparing two scans."""
        known, taken = self._moving, self._scanned[self._scanned[:, 2] == self._now, :2]
        if len(known):
            stays = ~_rays(scan, ranges, self._from_world(known[:, :2]))[2]
            self._moving = known[stays & (self._now - known[:, 2] < GONE_S)]
        self._scans.append((self._now, scan, ranges, self._pose))
        while len(self._scans) > 2 and self._now - self._scans[1][0] >= APART_S:
            self._scans.pop(0)
        at, before, were, pose = self._scans[0]
        if not 0.0 < self._now - at < GONE_S:
            return
        away, shown, seen = _rays(before, were, _into(pose, taken))
        taken = taken[seen & (shown > away + THROUGH_M)]
        if len(taken) < SOME:
            return
        taken, was = _thinned(taken), _out_of(pose, points_of(before))
        if not len(was):
            return
        apart = taken[:, None] - was
        nearest = np.hypot(*apart.transpose(2, 0, 1)).argmin(axis=1)
        went = apart[np.arange(len(taken)), nearest]
        moves = (WALKS_M[0] < np.hypot(*went.T)) & (np.hypot(*went.T) < WALKS_M[1])
        new = np.column_stack([taken, np.full(len(taken), self._now), went / (self._now - at)])
        self._moving = np.concatenate([self._moving, new[moves]])
        if moves.sum() >= SOME:
            self._moved_at = self._now

    def _expected(self) -> Floats:
        """Where moving objects are expected in the next moments, outside the footprint."""
        if not len(self._moving):
            return self._moving[:, :2]
        x_y, at, velocity = np.split(self._moving, [2, 3], axis=1)
        after = (self._now - at)[:, None] + AHEAD_S[:, None]
        places = self._from_world((x_y[:, None] + after * velocity[:, None]).reshape(-1, 2))
        return places[self._beside(places) > 0.0]

    def _go_on(self, scan: Scan, ranges: Floats) -> None:
        """Note where walls go on beyond the edges of a laser's view; what is near stays noted."""
        assert self._corner is not None, "after an update"
        at = self._from_world(self._beyond)
        beside = self._beside(at)
        near = (beside < AROUND_M + CELL_M) & (beside > -INSIDE_M) & ~_rays(scan, ranges, at)[2]
        new = self._to_world(_beyond_view(scan, ranges))
        cells = np.floor(new / CELL_M).astype(np.intp) - self._corner
        held = ((cells >= 0) & (cells < CELLS)).all(axis=1)
        new, (i, j) = new[held], cells[held].T
        both = np.concatenate([self._beyond[near], new[self._now - self._free[i, j] > LATELY_S]])
        self._beyond = _thinned(both)

    def _kept(self, points: Floats) -> Floats:
        """Points that are neither too old nor where the robot stands."""
        beside = self._beside(self._from_world(points[:, :2]))
        stays = (self._now - points[:, 2] <= KEPT_S) | (beside < NEAR_M)
        return points[stays & (beside > -INSIDE_M)]

    def _beside(self, at: Floats) -> Floats:
        """By how much the footprint can grow until places are on its edge, m; below 0: inside."""
        rear, front, half = self._footprint
        ahead = np.maximum(at[:, 0] - front, rear - at[:, 0])
        beside: Floats = np.maximum(ahead, np.abs(at[:, 1]) - half)
        return beside

    def _shift(self, pose: Pose2) -> None:
        """Move the cells so that the robot is in the middle one."""
        corner = floor(pose[0] / CELL_M) - CELLS // 2, floor(pose[1] / CELL_M) - CELLS // 2
        before, self._corner = self._corner or corner, corner
        for axis in (0, 1):
            by = corner[axis] - before[axis]
            if by:
                free = np.roll(self._free, -by, axis)
                gone = slice(CELLS - by, None) if by > 0 else slice(None, -by)
                free[gone if axis == 0 else (slice(None), gone)] = -inf
                self._free = free if abs(by) < CELLS else np.full_like(free, -inf)

    def _cells(self, within: float) -> tuple[Floats, Floats, Floats]:
        """All cells within a distance (m) and some more: the middles in the body frame (x and y).

        And when they were last seen to be free: a part of `_free`, to be written to.
        """
        assert self._corner is not None, "after an update"
        most = CELLS // 2  # the number of the robot's own cell
        reach = min(int(within / CELL_M) + 1, most) if within < inf else most
        part = slice(most - reach, most + reach + 1)
        dx = (self._middles[part] + (self._corner[0] * CELL_M - self._pose[0]))[:, None]
        dy = self._middles[part] + (self._corner[1] * CELL_M - self._pose[1])
        c, s = cos(self._pose[2]), sin(self._pose[2])
        return c * dx + s * dy, c * dy - s * dx, self._free[part, part]

    def _from_world(self, places: Floats) -> Floats:
        return _into(self._pose, places)

    def _to_world(self, places: Floats) -> Floats:
        return _out_of(self._pose, places)


def _thinned(places: Floats) -> Floats:
    """The first of the places, (n, 2 or more), in each square of `SAME_M`."""
    squares = np.floor(places[:, :2] / SAME_M) @ (1.0, 1e6)
    return places[np.unique(squares, return_index=True)[1]]


def _into(pose: Pose2, places: Floats) -> Floats:
    """Places of the odometry's frame in the body's."""
    dx, dy = places[:, 0] - pose[0], places[:, 1] - pose[1]
    c, s = cos(pose[2]), sin(pose[2])
    return paired(c * dx + s * dy, c * dy - s * dx)


def _out_of(pose: Pose2, places: Floats) -> Floats:
    """Places of the body's frame in the odometry's."""
    x, y = places[:, 0], places[:, 1]
    c, s = cos(pose[2]), sin(pose[2])
    found: Floats = paired(c * x - s * y, s * x + c * y) + pose[:2]
    return found


def _rays(scan: Scan, ranges: Floats, places: Floats) -> tuple[Floats, Floats, Flags]:
    """Of each place the distance from the laser, how far the rays beside it see, and if they do."""
    dx, dy = places[:, 0] - scan.x, places[:, 1] - scan.y
    low, high, inside = beside(np.arctan2(dy, dx), scan.bearing, scan.step, len(ranges))
    shown = np.minimum(ranges[low], ranges[high])
    valid: Flags = inside & ~np.isnan(shown)
    return np.hypot(dx, dy), np.where(valid, shown, 0.0), valid


def _filled(points: Floats, width: float) -> Floats:
    """Places between points that are less than a width apart: the robot fits through no such gap.

    What was heard of a wall is a few points of it, and a corner of the footprint may turn into it
    between them.
    """
    if len(points) < 2:  # mostly nothing is near
        return np.empty((0, 2))
    one, other = np.triu_indices(len(points), 1)
    apart = np.hypot(*(points[one] - points[other]).T)
    pairs = (apart > 2.0 * SAME_M) & (apart < width)
    begin, way = points[one[pairs]], (points[other] - points[one])[pairs]
    between = np.concatenate([begin + share * way for share in (0.25, 0.5, 0.75)])
    thinned = np.unique(np.round(between / SAME_M) @ (1.0, 1.0j)) * SAME_M
    return paired(thinned.real, thinned.imag)


def _beyond_view(scan: Scan, ranges: Floats) -> Floats:
    """Places on the walls that reach the edges of a laser's view, if they go on straight."""
    if round(tau / abs(scan.step)) <= len(ranges):  # a whole turn
        return np.empty((0, 2))
    found = [np.empty((0, 2))]
    rays = np.arange(len(ranges) // 4)
    for inwards in (rays, len(ranges) - 1 - rays):
        edge = inwards[np.isfinite(ranges[inwards])]
        if len(edge) < SOME:
            continue
        away, bearings = ranges[edge], scan.bearing + scan.step * edge
        x, y = scan.x + away * np.cos(bearings), scan.y + away * np.sin(bearings)
        off = np.hypot(x - x[:1], y - y[:1])
        count = np.argmax(off > LINE_M[1]) or len(off)
        if off[:count].max() < LINE_M[0]:
            continue
        middle = np.array([x[:count].mean(), y[:count].mean()])
        dx, dy = x[:count] - middle[0], y[:count] - middle[1]
        angle = 0.5 * np.arctan2(2.0 * (dx @ dy), dx @ dx - dy @ dy)  # of the principal axis
        along = np.array([np.cos(angle), np.sin(angle)])
        last = along[0] * dx[0] + along[1] * dy[0]
        on = middle + along * (last + np.sign(last) * ON_M[:, None])
        found.append(on[~_rays(scan, ranges, on)[2]])
    return np.concatenate(found)


def _on_walls(echo: Echo, away: float, normals: Floats) -> Floats:
    """Places on walls with these normals that return an echo."""
    c, s = np.cos(normals)[:, None], np.sin(normals)[:, None]
    x, y = echo.x + away * c - ALONG_M * s, echo.y + away * s + ALONG_M * c
    return paired(x.ravel(), y.ravel())
