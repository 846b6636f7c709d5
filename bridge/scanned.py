"""What a laser shows: obstacles and free space, seen by its newest scans.

A scan shows what lies between two neighbouring rays, as far as no object of `SHARE` of the robot's
width fits between them, and at most `DARK_M` along rays without a return. A wall at the edge of the
view goes on beyond it, unless a place there was seen to be free. What moves towards the laser is
expected to go on: its places of the next moments count as taken.

Frame: the body's; what is kept is in the odometry's. m, rad, s.
"""

from __future__ import annotations

from math import atan2, cos, inf, remainder, sin, tau
from typing import Final

import numpy as np

from armadico.bridge.cells import LATELY_S, Cells, into, out_of
from armadico.config.profile import Laser
from armadico.mobile.geometry import Pose2
from armadico.mobile.messages import Scan
from armadico.mobile.motion import clearances
from armadico.mobile.scans import Flags, Floats, ranges_of
from armadico.mobile.swept_path import Outline

SHARE: Final = 0.75
"""Width, relative to the robot's, of objects that a ray must meet before the robot does. Chosen:
with half the width robots crept, and their maps dropped obstacles before they had passed them."""

DARK_M: Final = 3.0
"""Range up to which a laser sees dark surfaces, as for maps (`grid_mapping`)."""

KEPT_S: Final = 30.0
"""Greatest age of a point that no scan has looked through since, unless it is near: chosen. What a
robot with a blind side saw there is what it may back into."""

NEAR_M: Final = 0.3
"""Within this of the footprint a point does not age."""

INSIDE_M: Final = 0.05
"""A point counts until it is so far inside the footprint: it came there by noise and drift."""

BETWEEN_S: Final = 0.45
"""For this time a point stays although a scan looks through its place: rays may be lost, or pass
a thin object on both sides. Two turns of a laser at 5 Hz."""

BESIDE_M: Final = 0.15
"""Within this of the footprint the nearest one of the points of that time counts: one ray of a
noisy laser after another would let the robot creep on."""

THIN_M, THIN_S, THIN_SIDE_M = 0.5, 2.0, 0.04
"""Within the first of the footprint a thin object that scans look through stays for this time: few
rays meet a sheet that is seen edge-on. What is wider than the last went away."""

THROUGH_M: Final = 0.1
"""A scan looked through a place that is nearer than its range by this."""

ON_M: Final = np.arange(0.05, 0.45, 0.05)
"""Beyond the last point in view, its wall goes on at these distances: chosen."""

AROUND_M: Final = 0.15
"""Within this of the footprint the place of such a wall stays noted."""

LINE_M: Final = (0.05, 0.3)
"""Points of a wall show its direction if they are so far apart, and so near to the last one."""

APART_S: Final = 0.25
"""Two scans so far apart show what moves: a place that the earlier one looked through is taken."""

WALKS_M: Final = (0.06, 0.5)
"""So far a moving object went from one of these scans to the other: less is noise, and more is
another object."""

AHEAD_S: Final = np.arange(0.15, 0.9, 0.15)
"""Times for which moving objects are expected to go on: a robot stops within the last one, s."""

GONE_S: Final = 1.0
"""A moving object that has left the view counts for this time."""

SOME: Final = 3
"""So many points that move are an object, and not lost rays."""

SAME_M: Final = 0.03
"""One point in each square of this size is enough."""


def met_within(step: float, width: float) -> float:
    """The range within which a ray meets every object of a width, m; rays are `step` rad apart."""
    return width / (2.0 * sin(0.5 * abs(step))) if step else inf


class Rays:
    """A scan, and how far it sees between its rays."""

    def __init__(self, scan: Scan, pose: Pose2, at: float) -> None:
        self.scan, self.pose, self.at = scan, pose, at
        self.ranges = ranges_of(scan)
        hit = np.flatnonzero(np.isfinite(self.ranges))
        bearings, away = scan.bearing + scan.step * hit, self.ranges[hit]
        self.points: Floats = np.empty((len(hit), 2))  # in the body frame of the scan
        self.points[:, 0] = scan.x + away * np.cos(bearings)
        self.points[:, 1] = scan.y + away * np.sin(bearings)
        self._turn = tau / abs(scan.step)  # in rays
        self.turns = round(self._turn) == len(self.ranges)  # they make a whole turn
        # Between two rays it sees as far as the nearer one shows, and half a step beyond the edges.
        last, first = (-1, 0) if self.turns else (0, -1)
        ends = np.concatenate([self.ranges[[last]], self.ranges, self.ranges[[first]]])
        self._between = np.minimum(ends[:-1], ends[1:])
        self._first = remainder(scan.bearing, tau)

    def look(self, places: Floats) -> tuple[Floats, Floats, Flags]:
        """Of each place the distance from the laser, how far it sees that way, and if it does."""
        dx, dy = places[:, 0] - self.scan.x, places[:, 1] - self.scan.y
        ray = (np.arctan2(dy, dx) - self._first) / self.scan.step
        ray[ray < -0.5] += self._turn
        ray[ray >= self._turn - 0.5] -= self._turn
        index = (ray + 1.0).astype(np.intp)
        shown = self._between[np.minimum(index, len(self.ranges))]
        valid: Flags = (ray <= len(self.ranges) - 0.5) & ~np.isnan(shown)
        return np.sqrt(dx * dx + dy * dy), np.where(valid, shown, 0.0), valid

    def through(self, places: Floats) -> Flags:
        """Whether it looks through places."""
        away, shown, seen = self.look(places)
        found: Flags = seen & (shown > away + THROUGH_M)
        return found


class Scanned:
    """Collects scans."""

    def __init__(self, laser: Laser, outline: Outline) -> None:
        self._outline, self._noise = outline, laser.noise_m
        self._width = 2.0 * SHARE * outline.half_width
        self._points: Floats = np.empty((0, 3))  # x, y, and when
        self._beyond: Floats = np.empty((0, 2))  # x, y, where walls leave the laser's view
        self._scans: list[Rays] = []  # of the last `APART_S`
        self._moving: Floats = np.empty((0, 5))  # x, y, when, and the velocity, m/s
        self.moved_at = -inf  # when an object last moved, s

    def update(self, scan: Scan | None, cells: Cells) -> Rays | None:
        """Add a scan; return its rays. None: there is none, or it is known already."""
        last = self._scans[-1].scan.number if self._scans else 0
        if scan is None or scan.number == last != 0:
            self._age(cells)
            return None
        rays = Rays(scan, cells.pose, cells.now)
        reach = min(DARK_M, met_within(scan.step, self._width))
        away, shown, _ = rays.look(cells.places)
        cells.seen[(away <= reach) & (shown >= away)] = cells.now
        new = rays.points
        beside = clearances(self._outline, *new.T)
        new = new[(beside >= 0.0) & (beside < DARK_M)]  # not the robot itself
        self._replace(rays, new, cells)
        self._go_on(rays, cells)
        self._follow(rays, new, cells)
        return rays

    def _age(self, cells: Cells) -> None:
        """Forget points that are too old or where the robot stands, in a cycle without a scan."""
        beside = clearances(self._outline, *into(cells.pose, self._points).T)
        self._points = self._points[_stays(cells.now - self._points[:, 2], beside)]

    def points(self, cells: Cells) -> Floats:
        """Places that count as taken, (n, 2), in the body frame."""
        held = np.concatenate([self._points[:, :2], self._beyond])
        return np.concatenate([into(cells.pose, held), self._expected(cells)])

    def _replace(self, rays: Rays, new: Floats, cells: Cells) -> None:
        """Points in a scan's view are those that it shows; `new` ones are in the body frame."""
        known, pose, now = self._points, cells.pose, cells.now
        at = into(pose, known)
        away, shown, seen = rays.look(at)
        age, beside = now - known[:, 2], clearances(self._outline, *at.T)
        same = np.abs(shown - away) < 3.0 * self._noise
        # What is behind something nearer stays, and near the robot the nearer one of two points.
        later, farther = age > BETWEEN_S, shown > away
        gone = seen & np.where(same, later | ~((beside < BESIDE_M) & farther), later & farther)
        held = np.flatnonzero(gone & ~same & (beside < THIN_M) & (age < THIN_S))
        gone[held[_thin(at[held], rays)]] = False
        added = np.empty((len(new), 3))
        added[:, :2], added[:, 2] = out_of(pose, new), now
        self._points = np.concatenate([known[~gone & _stays(age, beside)], added])

    def _follow(self, rays: Rays, new: Floats, cells: Cells) -> None:
        """Note which of a scan's points move, by comparing two scans."""
        known, now = self._moving, cells.now
        if len(known):
            stays = ~rays.look(into(cells.pose, known))[2]
            self._moving = known[stays & (now - known[:, 2] < GONE_S)]
        self._scans.append(rays)
        while len(self._scans) > 2 and now - self._scans[1].at >= APART_S:
            self._scans.pop(0)
        before = self._scans[0]
        if not 0.0 < now - before.at < GONE_S:
            return
        taken = out_of(cells.pose, new)
        taken = taken[before.through(into(before.pose, taken))]
        if len(taken) < SOME or not len(before.points):
            return
        taken, was = thinned(taken), out_of(before.pose, before.points)
        apart = taken[:, None] - was
        nearest = np.hypot(*apart.transpose(2, 0, 1)).argmin(axis=1)
        went = apart[np.arange(len(taken)), nearest]
        moves = (WALKS_M[0] < np.hypot(*went.T)) & (np.hypot(*went.T) < WALKS_M[1])
        added = np.column_stack([taken, np.full(len(taken), now), went / (now - before.at)])
        self._moving = np.concatenate([self._moving, added[moves]])
        if moves.sum() >= SOME:
            self.moved_at = now

    def _expected(self, cells: Cells) -> Floats:
        """Where moving objects are expected in the next moments, outside the footprint."""
        if not len(self._moving):
            return self._moving[:, :2]
        x_y, at, velocity = np.split(self._moving, [2, 3], axis=1)
        after = (cells.now - at)[:, None] + AHEAD_S[:, None]
        places = into(cells.pose, (x_y[:, None] + after * velocity[:, None]).reshape(-1, 2))
        return places[clearances(self._outline, places[:, 0], places[:, 1]) > 0.0]

    def _go_on(self, rays: Rays, cells: Cells) -> None:
        """Note where walls go on beyond the edges of the view; what is near stays noted."""
        if rays.turns:
            return
        at = into(cells.pose, self._beyond)
        beside = clearances(self._outline, at[:, 0], at[:, 1])
        near = (beside < AROUND_M) & (beside > -INSIDE_M) & ~rays.look(at)[2]
        new = out_of(cells.pose, _beyond_view(rays))
        new = new[cells.age(new) > LATELY_S]
        self._beyond = thinned(np.concatenate([self._beyond[near], new]))


def _stays(age: Floats, beside: Floats) -> Flags:
    """Whether points stay, by their age (s) and distance from the footprint (m)."""
    found: Flags = ((age <= KEPT_S) | (beside < NEAR_M)) & (beside > -INSIDE_M) & (beside < DARK_M)
    return found


def thinned(places: Floats) -> Floats:
    """One place of each square of `SAME_M`."""
    squares = np.floor(places / SAME_M) @ (1.0, 1e6)
    return places[np.unique(squares, return_index=True)[1]]


def _thin(places: Floats, rays: Rays) -> Flags:
    """Whether places have none of the others beside them, as seen from the laser."""
    ways = places - (rays.scan.x, rays.scan.y)
    ways /= np.hypot(*ways.T)[:, None]
    apart = places - places[:, None]
    side = np.abs(ways[:, None, 0] * apart[..., 1] - ways[:, None, 1] * apart[..., 0])
    beside = (side > THIN_SIDE_M) & (np.hypot(*apart.transpose(2, 0, 1)) < 5.0 * THIN_SIDE_M)
    found: Flags = ~beside.any(axis=1)
    return found


def _beyond_view(rays: Rays) -> Floats:
    """Places on the walls that reach the edges of a laser's view, if they go on straight."""
    found = [np.empty((0, 2))]
    quarter = rays.points[: len(rays.points) // 4], rays.points[: -len(rays.points) // 4 : -1]
    for edge in quarter:
        if len(edge) < SOME:
            continue
        off = np.hypot(*(edge - edge[0]).T)
        count = np.argmax(off > LINE_M[1]) or len(off)
        if off[:count].max() < LINE_M[0]:
            continue
        wall = edge[:count]
        middle = wall.mean(axis=0)
        dx, dy = (wall - middle).T
        angle = 0.5 * atan2(2.0 * (dx @ dy), dx @ dx - dy @ dy)  # of the principal axis
        along = np.array([cos(angle), sin(angle)])
        last = (wall[0] - middle) @ along
        found.append(middle + along * (last + np.sign(last) * ON_M[:, None]))
    on = np.concatenate(found)
    return on[~rays.look(on)[2]]
