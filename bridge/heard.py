"""What a ring of sonars shows: obstacles and free space, heard by its last pings.

A sonar shows its cone up to the nearer of its last two echoes, as one may be lost, and at most
`HEARD_M`: a smooth wall at a slant returns no echo. Nearer, a sonar of the ring that is square to
the wall hears it, or this one its edge.

An echo may come from any place of an arc. Its points are those that no other sonar looked through.
Or it comes from a smooth wall, which goes on to both sides, where no sonar hears it: on each
tangent of the arc that no other sonar excludes, space is not seen to be free, and near the arc the
wall counts as heard. Near points are joined where the robot fits through no gap between them.

Nearer than a sonar's least range it only knows that something is there: what was heard before stays
where it was.

Frame: the body's; what is kept is in the odometry's. m, rad, s.
"""

from __future__ import annotations

from collections.abc import Callable
from math import cos, inf, radians, sin, tan, tau
from typing import Final

import numpy as np

from armadico.bridge.cells import CELL_M, LATELY_S, Cells, into, out_of
from armadico.config.profile import SonarRing
from armadico.mobile.messages import Echo
from armadico.mobile.motion import clearances
from armadico.mobile.scans import Flags, Floats
from armadico.mobile.swept_path import Outline

KEPT_S: Final = 10.0
"""Greatest age of a point that no sonar has looked through since, unless it is near."""

NEAR_M: Final = 0.3
"""Within this of the footprint a point does not age: the gaps between sonars are widest there, and
a robot that stands before an obstacle in such a gap hears it no more."""

HEARD_M: Final = 1.0
"""Range up to which a ring of sonars hears a slanted smooth wall or its edge. An edge is heard up
to 0.4 m for certain, up to 1 m by four pings of ten (`configs/robots/sensors.toml`)."""

OPEN_M: Final = 0.4
"""As `HEARD_M`, of a sonar at an end of the ring: beyond that end no other one hears a wall that is
at a slant to this one."""

SILENT_S: Final = 2.0
"""For this time a place counts as free where only a smooth wall that is square to the sonar, or an
edge by chance, would have been heard: chosen."""

ARC_M: Final = 1.0
"""Echoes from nearer count on their whole arc, farther ones on the axis: they limit nothing yet."""

ARC: Final = np.array([0.0, -0.95, 0.95, -0.5, 0.5])
"""Places on the arc, as shares of half the cone."""

ANSWERS_RAD: Final = radians(25)
"""A wall whose normal is within this of a silent sonar's axis is excluded."""

SURE_RAD: Final = radians(25)
"""A smooth wall answers for certain if its normal is within this of the axis (`gone_deg`)."""

TANGENTS: Final = SURE_RAD * np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
ALONG_M: Final = np.linspace(-0.5, 0.5, 11)
"""Normals of walls, from the axis, and places on the wall, from the foot of the normal. At 0.6 m/s
the robot stops within the last one."""

SURE_M: Final = 0.11
"""Up to here along it a wall that nothing excludes counts as an obstacle, farther as unseen: the
corner of a robot that creeps along it would touch it beside the echo's arc."""

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

PINGS: Final = 1.9
"""So many pings through a place forget what was heard there, each one counted by the chance that it
would have heard an edge: one echo may be lost, and farther than `EDGE_M` not each edge is heard."""

PAIR_S: Final = 1.0
"""Two pings of a sonar within this count together: the nearer echo, since one may be lost."""

BESIDE_RAD: Final = radians(25)
"""A sonar within this of another one's bearing is beside it."""

SAME_M: Final = 0.03
"""A point within this of a known one replaces it."""

Mount = tuple[float, float, float]
"""x, y and bearing of a sonar."""


class Heard:
    """Collects echoes."""

    def __init__(self, ring: SonarRing, outline: Outline) -> None:
        self._outline = outline
        self._least = ring.min_m + NOISE_M
        self._slope = tan(radians(ring.cone_deg) / 2)
        self._arc = radians(ring.cone_deg) / 2 * ARC
        # Bearings of sonars that have a sonar beside them on both sides.
        bearings = sorted(radians(sonar.bearing_deg) for sonar in ring.sonars)
        gaps = np.diff([*bearings, bearings[0] + tau])
        wide = gaps > 2.0 * SURE_RAD
        self._open = {b for k, b in enumerate(bearings) if wide[k] or wide[k - 1]}
        # x, y in the odometry's frame, when, the direction of the sonar that hit it, and whether
        # one looked through from elsewhere since, and how often from there
        self._points: Floats = np.empty((0, 7))
        self._readings: dict[Mount, list[tuple[float, float]]] = {}  # the last two: range, when
        self._walls: dict[Mount, tuple[Floats, float]] = {}  # where they may go on, and when heard

    def update(self, echo: Echo, cells: Cells) -> None:
        """Add an echo, or its absence."""
        now, pose = cells.now, cells.pose
        away = inf if echo.range is None else echo.range
        mount = echo.x, echo.y, echo.bearing
        self._readings[mount] = [*self._readings.get(mount, [])[-1:], (away, now)]
        free = self._nearer(mount, now)
        ahead, aside, off = _from_axis(cells.places, mount)
        beam = (ahead > 0.0) & (aside < self._slope * ahead + 0.5 * CELL_M)
        reach = OPEN_M if any(abs(echo.bearing - b) < 1e-6 for b in self._open) else HEARD_M
        beam &= off < min(free, reach)
        until = np.where(off < EDGE_M, now, now - LATELY_S + SILENT_S)
        cells.seen[beam] = np.maximum(cells.seen, until)[beam]
        heading = echo.bearing + pose[2]
        at = self._forget(mount, away, heading, cells)
        if free >= ARC_M:
            self._walls.pop(mount, None)
        if echo.range is None:
            return
        blind = away < self._least
        if blind and (explains := self._explains(echo, at)) < inf:
            self._suspect(echo, explains, cells)
            return
        bearings = echo.bearing + (self._arc if away < ARC_M else self._arc[:1])
        places = np.column_stack(
            [echo.x + away * np.cos(bearings), echo.y + away * np.sin(bearings)]
        )
        for other, readings in self._readings.items():
            if 0.0 < abs(other[2] - echo.bearing) < BESIDE_RAD:
                places = places[~self._through(places, other, readings[-1][0])]
        if blind:
            front, rear, half = self._outline
            places = np.clip(places, (-rear, -half), (front, half))
        if away < ARC_M:
            self._suspect(echo, away, cells)
        if len(at):
            gaps = np.hypot(*(at[:, None] - places).transpose(2, 0, 1))
            self._points = self._points[(gaps >= SAME_M).all(axis=1)]
        new = np.zeros((len(places), 7))
        new[:, :2] = out_of(pose, places)
        new[:, 2:5] = now, cos(heading), sin(heading)
        self._points = np.concatenate([self._points, new])

    def _forget(self, mount: Mount, away: float, heading: float, cells: Cells) -> Floats:
        """Forget what a sonar looked through often enough; return the places of the others."""
        known = self._points
        at = into(cells.pose, known[:, :2])
        ahead, aside, off = _from_axis(at, mount)
        through = (aside < self._slope * ahead) & (off < min(HEARD_M, away - THROUGH_M))
        facing = cos(heading) * known[:, 3] + sin(heading) * known[:, 4] > FACING
        facing |= off < EDGE_M - THROUGH_M
        known[through & ~facing, 5] = 1.0
        chance = np.minimum(1.0, EDGE_M / np.maximum(off, 1e-9))  # that an edge would be heard
        known[through & facing, 6] += chance[through & facing]
        gone = known[:, 6] >= PINGS
        self._points = known[~gone]
        return at[~gone]

    def age(self, cells: Cells) -> None:
        """Forget points that are too old or where the robot stands."""
        at = into(cells.pose, self._points)
        beside = clearances(self._outline, at[:, 0], at[:, 1])
        stays = (cells.now - self._points[:, 2] <= KEPT_S) | (beside < NEAR_M)
        self._points = self._points[stays & (beside > -INSIDE_M)]

    def forget(self, looked: Callable[[Floats], Flags], cells: Cells) -> None:
        """Forget old points where a better sensor `looked` through: near ones do not age."""
        old = cells.now - self._points[:, 2] > KEPT_S
        if old.any():
            self._points = self._points[~(old & looked(into(cells.pose, self._points)))]

    def points(self, cells: Cells) -> tuple[Floats, Floats, Floats]:
        """Places that were heard, that are taken by inference, and that may be taken, (n, 2)."""
        at, doubted = into(cells.pose, self._points), self._points[:, 5] > 0.0
        sure = at[~doubted]
        near = sure[clearances(self._outline, sure[:, 0], sure[:, 1]) < NEAR_M]
        filled = _filled(near, 2.0 * self._outline.half_width)
        walls = [places for places, at in self._walls.values() if cells.now - at < PAIR_S]
        places = into(cells.pose, np.concatenate([np.empty((0, 2)), *walls]))
        heard = np.tile(np.abs(ALONG_M) < SURE_M, len(places) // len(ALONG_M))
        inferred, maybe = [filled, places[heard]], [places[~heard], at[doubted]]
        return sure, np.concatenate(inferred), np.concatenate(maybe)

    def _nearer(self, mount: Mount, now: float) -> float:
        """The nearer one of a sonar's last two ranges, m: an echo may be lost. 0: too long ago."""
        return min((away for away, at in self._readings[mount] if now - at < PAIR_S), default=0.0)

    def _suspect(self, echo: Echo, away: float, cells: Cells) -> None:
        """Note where walls may go on that an echo may come from."""
        normals = echo.bearing + TANGENTS
        normals = normals[[self._may_be(normal, echo, away, cells.now) for normal in normals]]
        mount = echo.x, echo.y, echo.bearing
        self._walls[mount] = out_of(cells.pose, _on_walls(echo, away, normals)), cells.now

    def _explains(self, echo: Echo, known: Floats) -> float:
        """The distance of the known point that explains an echo from the least range; else inf."""
        dx, dy = known[:, 0] - echo.x, known[:, 1] - echo.y
        away = np.hypot(dx, dy)
        facing = np.cos(np.arctan2(dy, dx) - echo.bearing) > cos(SURE_RAD)
        return float(min(away[facing & (away < self._least + SAME_M)], default=inf))

    def _may_be(self, normal: float, echo: Echo, away: float, now: float) -> bool:
        """Whether no sonar's newest reading excludes a wall with this normal."""
        for x, y, bearing in self._readings:
            if abs(bearing - normal) < ANSWERS_RAD:
                due = away + cos(normal) * (echo.x - x) + sin(normal) * (echo.y - y)
                if due < HEARD_M and self._nearer((x, y, bearing), now) > due + THROUGH_M:
                    return False
        return True

    def _through(self, places: Floats, mount: Mount, away: float) -> Flags:
        """Whether a sonar that heard nothing nearer than `away` looked through places."""
        ahead, aside, off = _from_axis(places, mount)
        found: Flags = (aside < self._slope * ahead) & (off < min(HEARD_M, away - THROUGH_M))
        return found


def _from_axis(places: Floats, mount: Mount) -> tuple[Floats, Floats, Floats]:
    """Of each place how far ahead of a sonar, how far off its axis, and how far away it is, m."""
    dx, dy = places[:, 0] - mount[0], places[:, 1] - mount[1]
    c, s = cos(mount[2]), sin(mount[2])
    return c * dx + s * dy, np.abs(c * dy - s * dx), np.sqrt(dx * dx + dy * dy)


def _filled(points: Floats, width: float) -> Floats:
    """Places between points that are less than a width apart: the robot fits through no such gap.

    What was heard of a wall is a few points of it, and a corner of the footprint may turn into it
    between them.
    """
    one, other = np.triu_indices(len(points), 1)
    apart = np.hypot(*(points[one] - points[other]).T)
    pairs = (apart > 2.0 * SAME_M) & (apart < width)
    begin, way = points[one[pairs]], (points[other] - points[one])[pairs]
    between = np.concatenate([begin + share * way for share in (0.25, 0.5, 0.75)])
    thinned: Floats = np.unique(np.round(between / SAME_M), axis=0) * SAME_M
    return thinned


def _on_walls(echo: Echo, away: float, normals: Floats) -> Floats:
    """Places on walls with these normals that return an echo."""
    c, s = np.cos(normals)[:, None], np.sin(normals)[:, None]
    x, y = echo.x + away * c - ALONG_M * s, echo.y + away * s + ALONG_M * c
    return np.column_stack([x.ravel(), y.ravel()])
