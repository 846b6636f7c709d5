"""Sensed obstacles that the map does not have, for as long as planning should consider them.

A layer of points over the planner's map. An echo that a wall of the map explains, anywhere on the
arc it may come from, adds nothing. Other points count once a second echo confirms them. Each ping
that passes them lowers their evidence, and they fade: a person walking by is detected once or twice
at each place, a closed door as long as the robot faces it.

Without a map no echo is explained, and the points are the map: they last until a sensor looks
through them, so that the robot does not enter a dead end twice.
"""

from __future__ import annotations

from math import cos, exp, hypot, inf, sin, tan
from typing import Final

import numpy as np
from msgspec import Struct

from armadico.agents.methods.geometry import Placed, Posed
from armadico.agents.methods.grid import Grid
from armadico.config.worlds import Segment
from armadico.mobile.geometry import Pose2, to_world
from armadico.mobile.messages import Echo, Scan
from armadico.mobile.scans import Floats, bearings_of, beside, ranges_of

_ARC: Final = np.linspace(-1.0, 1.0, 9)


class Settings(Struct, frozen=True):
    """Weights of a ping, and their duration. Evidence is in echoes."""

    cell_m: float = 0.1
    reach_m: float = 1.5  # greatest range of an echo that adds evidence, as in mapping
    near_m: float = 0.15  # a wall of the map within this, plus the pose's deviation, explains it
    arc_rad: float = 0.45  # off the axis: smooth walls answer in the side lobes
    doubt_m: float = 1.5  # greatest distance at which a ping lowers evidence
    axis_rad: float = 0.15  # greatest angle off its axis at which a ping lowers evidence
    margin_m: float = 0.15  # least distance before its echo at which a ping lowers evidence
    miss: float = 1.0  # evidence subtracted by a ping
    silent_m: float = 1.0  # greatest such distance without an echo: walls at a slant are silent
    silence: float = 0.3  # evidence subtracted by a ping without an echo
    counted: float = 1.5  # least evidence that counts: one echo alone may be a person's
    most: float = 8.0
    fade_s: float = 20.0  # time constant of the evidence: the greatest counts for 33 s
    jump_m: float = 0.5  # a pose that jumps by this was wrong before


WITHOUT_A_MAP: Final = Settings(
    reach_m=1.1, doubt_m=1.6, axis_rad=0.2, most=4.0, miss=2.0, fade_s=3600.0
)


class Scanned(Struct, frozen=True):
    """The same for a scan: a ray is narrow and certain."""

    cell_m: float = 0.05
    reach_m: float = 8.0
    evidence: float = 2.0  # of one ray: counts at once
    margin_m: float = 0.12  # a ray longer by this passed through a point
    miss: float = 1.0  # evidence subtracted by a ray that passed through


class _Cell(Struct):
    x: float
    y: float
    evidence: float
    at: float  # time of that evidence


class Seen:
    """The layer over one map's grid. World frame, m; times in s of the caller's clock."""

    def __init__(self, known: Grid | None, settings: Settings | None = None) -> None:
        """Prepare without points; `known` is the map's grid, if there is a map."""
        self.p = settings or (WITHOUT_A_MAP if known is None else Settings())
        self._known = known
        self._cells: dict[tuple[int, int], _Cell] = {}
        self.scanned = Scanned()
        self._last: Posed | None = None

    def move(self, pose: Posed) -> None:
        """Update the robot's pose; after a jump all points are dropped."""
        before, self._last = self._last, pose
        if before is not None and hypot(pose.x - before.x, pose.y - before.y) > self.p.jump_m:
            self._cells.clear()

    def add(self, pose: Posed, echo: Echo, off_m: float, now: float) -> None:
        """Add one ping of a robot at a pose with standard deviation `off_m`."""
        p = self.p
        bearing = pose.theta + echo.bearing
        x, y = to_world((pose.x, pose.y, pose.theta), echo.x, echo.y)
        distance = echo.range
        if distance is None:
            self._lower_evidence(x, y, bearing, p.silent_m, p.silence, now)
            return
        self._lower_evidence(x, y, bearing, min(distance, p.doubt_m) - p.margin_m, p.miss, now)
        if distance <= p.reach_m and not self._explained(x, y, bearing, distance, p.near_m + off_m):
            self._add(x + distance * cos(bearing), y + distance * sin(bearing), 1.0, now)

    def add_scan(self, pose: Posed, scan: Scan, off_m: float, now: float) -> None:
        """Add a scan of a robot at a pose with standard deviation `off_m`.

        Raises ValueError if the scan's bytes are not ranges.
        """
        s, here = self.scanned, (pose.x, pose.y, pose.theta)
        ranges = ranges_of(scan)
        self._clear_behind(here, scan, ranges, now)
        bearings = bearings_of(scan) + pose.theta
        seen = ranges <= s.reach_m
        x, y = to_world(here, scan.x, scan.y)
        xs, ys = (
            x + ranges[seen] * np.cos(bearings[seen]),
            y + ranges[seen] * np.sin(bearings[seen]),
        )
        if self._known is not None:  # most of the returns are from the map's walls
            new = self._known.clearances(xs, ys) > self.p.near_m + off_m
        else:
            new = np.ones(len(xs), dtype=np.bool_)
        cells = (xs // s.cell_m) + 1j * (ys // s.cell_m)  # one number, which sorts faster
        _, first = np.unique(cells, return_index=True)
        for k in np.sort(first[new[first]]).tolist():
            self._add(float(xs[k]), float(ys[k]), s.evidence, now, s.cell_m)

    def _clear_behind(self, here: Pose2, scan: Scan, ranges: Floats, now: float) -> None:
        """Lower the evidence of points that a scan passed: both rays beside them are longer."""
        s, cells = self.scanned, list(self._cells.items())
        if not cells or not len(ranges):
            return
        placed = np.array([(cell.x, cell.y) for _, cell in cells])
        x, y = to_world(here, scan.x, scan.y)
        dx, dy = placed[:, 0] - x, placed[:, 1] - y
        bearings = np.arctan2(dy, dx) - here[2]
        low, high, inside = beside(bearings, scan.bearing, scan.step, len(ranges))
        beyond = np.hypot(dx, dy) + s.margin_m
        with np.errstate(invalid="ignore"):  # NaN: a ray without a valid range
            through = inside & (ranges[low] > beyond) & (ranges[high] > beyond)
        for k in np.flatnonzero(through).tolist():
            key, cell = cells[k]
            cell.evidence, cell.at = self._left(cell, now) - s.miss, now
            if cell.evidence <= 0.0:
                del self._cells[key]

    def forget(self, now: float, recent_s: float) -> None:
        self._cells = {k: c for k, c in self._cells.items() if now - c.at <= recent_s}

    def touch(self, pose: Posed, x: float, y: float, now: float) -> None:
        """Add the point of a collision (body frame), with full evidence, unless it is a wall."""
        at = Placed(*to_world((pose.x, pose.y, pose.theta), x, y))
        if self._clearance(at.x, at.y) > self.p.near_m:
            self._add(at.x, at.y, self.p.most, now)

    def points(self, now: float) -> tuple[Segment, ...]:
        """The obstacles that count now, as walls without length; drops points without evidence."""
        for key, cell in list(self._cells.items()):
            if self._left(cell, now) < 0.5:
                del self._cells[key]
        counted = (c for c in self._cells.values() if self._left(c, now) >= self.p.counted)
        return tuple(sorted((c.x, c.y, c.x, c.y) for c in counted))

    def _left(self, cell: _Cell, now: float) -> float:
        return cell.evidence * exp((cell.at - now) / self.p.fade_s)

    def _add(
        self, x: float, y: float, evidence: float, now: float, cell_m: float | None = None
    ) -> None:
        p = self.p
        side = cell_m or p.cell_m
        if self._known is not None and not self._known.inside(Placed(x, y)):
            return
        key = int(x // side), int(y // side)
        cell = self._cells.get(key)
        if cell is None:
            self._cells[key] = _Cell(x, y, min(evidence, p.most), now)
            return
        cell.evidence = min(self._left(cell, now) + evidence, p.most)
        cell.at = now

    def _lower_evidence(
        self, x: float, y: float, bearing: float, free: float, share: float, now: float
    ) -> None:
        """Lower the evidence of points near a ping's axis, up to `free` m."""
        c, s, slope = cos(bearing), sin(bearing), tan(self.p.axis_rad)
        for key, cell in list(self._cells.items()):
            dx, dy = cell.x - x, cell.y - y
            along = c * dx + s * dy
            if 0.0 < along < free and abs(c * dy - s * dx) <= slope * along:
                cell.evidence, cell.at = self._left(cell, now) - share, now
                if cell.evidence <= 0.0:
                    del self._cells[key]

    def _explained(self, x: float, y: float, bearing: float, distance: float, near: float) -> bool:
        """Whether the map has a wall where the echo may come from, or one that hides the place."""
        if self._known is None:
            return False
        for angle in bearing + self.p.arc_rad * _ARC:
            if self._clearance(x + distance * cos(angle), y + distance * sin(angle)) <= near:
                return True
        there = Placed(x + distance * cos(bearing), y + distance * sin(bearing))
        return self._known.clearance_between(Placed(x, y), there) == 0.0

    def _clearance(self, x: float, y: float) -> float:
        if self._known is None:
            return inf
        return float(self._known.clearance[self._known.cell(Placed(x, y))])
