"""What the sensors see and the map has not, for as long as it is worth planning by.

A layer of points over the planner's map. An echo that a wall of the map explains, anywhere on the
arc that it may have come from, adds nothing. What is left is believed once it was heard again in
the same place, doubted by each ping that goes past it, and fades: somebody who walks by is heard
once or twice in each place, and a door that is shut as long as the robot looks at it.

Without a map nothing explains an echo, and what was seen is the map: it is kept until something
looks through it, so that no dead end is driven into twice.
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
    """How much is believed of a ping, and for how long. Evidence is in echoes."""

    cell_m: float = 0.1
    reach_m: float = 1.5  # what is farther is left for a nearer ping, as when a map is made
    near_m: float = 0.15  # a wall of the map so near, and as far as the pose is off, explains it
    arc_rad: float = 0.45  # off the axis: smooth walls answer by the side lobes
    doubt_m: float = 1.5  # no farther does a ping doubt
    axis_rad: float = 0.15  # a ping doubts what is so near to its axis
    margin_m: float = 0.15  # and so far short of its echo
    miss: float = 1.0  # so much is taken by one
    silent_m: float = 1.0  # no echo doubts so far, and only a little: a slanting wall is silent
    silence: float = 0.3
    believed: float = 1.5  # echoes: one alone may be anybody's
    most: float = 8.0
    fade_s: float = 20.0  # to the e-th part: what was seen for long is believed for 33 s more
    jump_m: float = 0.5  # a pose that jumps so far was wrong before


WITHOUT_A_MAP: Final = Settings(
    reach_m=1.1, doubt_m=1.6, axis_rad=0.2, most=4.0, miss=2.0, fade_s=3600.0
)


class Scanned(Struct, frozen=True):
    """The same of a scan: a ray is narrow and sure."""

    cell_m: float = 0.05
    reach_m: float = 8.0
    evidence: float = 2.0  # of one ray: believed at once
    margin_m: float = 0.12  # a ray that went so much farther than a point
    miss: float = 1.0  # takes so much of it


class _Cell(Struct):
    x: float
    y: float
    evidence: float
    at: float  # when that was


class Seen:
    """The layer over one map's grid. World frame, m; times in s of whoever asks."""

    def __init__(self, known: Grid | None, settings: Settings | None = None) -> None:
        """Nothing is seen yet; `known` is the map's grid, if there is a map."""
        self.p = settings or (WITHOUT_A_MAP if known is None else Settings())
        self._known = known
        self._cells: dict[tuple[int, int], _Cell] = {}
        self.scanned = Scanned()
        self._last: Posed | None = None

    def move(self, pose: Posed) -> None:
        """The robot's pose in this cycle; after a jump nothing is known of what was seen."""
        before, self._last = self._last, pose
        if before is not None and hypot(pose.x - before.x, pose.y - before.y) > self.p.jump_m:
            self._cells.clear()

    def add(self, pose: Posed, echo: Echo, off_m: float, now: float) -> None:
        """Take one ping of a robot at a pose, which may be so far off."""
        p = self.p
        bearing = pose.theta + echo.bearing
        x, y = to_world((pose.x, pose.y, pose.theta), echo.x, echo.y)
        heard = echo.range
        if heard is None:
            self._doubt(x, y, bearing, p.silent_m, p.silence, now)
            return
        self._doubt(x, y, bearing, min(heard, p.doubt_m) - p.margin_m, p.miss, now)
        if heard <= p.reach_m and not self._explained(x, y, bearing, heard, p.near_m + off_m):
            self._add(x + heard * cos(bearing), y + heard * sin(bearing), 1.0, now)

    def take_scan(self, pose: Posed, scan: Scan, off_m: float, now: float) -> None:
        """Take a scan of a robot at a pose, which may be so far off.

        Raises ValueError if its bytes are no ranges.
        """
        s, here = self.scanned, (pose.x, pose.y, pose.theta)
        ranges = ranges_of(scan)
        self._look_through(here, scan, ranges, now)
        bearings = bearings_of(scan) + pose.theta
        seen = ranges <= s.reach_m
        x, y = to_world(here, scan.x, scan.y)
        xs, ys = (
            x + ranges[seen] * np.cos(bearings[seen]),
            y + ranges[seen] * np.sin(bearings[seen]),
        )
        if self._known is not None:  # most of what it sees are the map's walls
            new = self._known.clearances(xs, ys) > self.p.near_m + off_m
        else:
            new = np.ones(len(xs), dtype=np.bool_)
        cells = (xs // s.cell_m) + 1j * (ys // s.cell_m)  # one number, which sorts faster
        _, first = np.unique(cells, return_index=True)
        for k in np.sort(first[new[first]]).tolist():
            self._add(float(xs[k]), float(ys[k]), s.evidence, now, s.cell_m)

    def _look_through(self, here: Pose2, scan: Scan, ranges: Floats, now: float) -> None:
        """Doubt what a scan looks through: both rays beside it went farther."""
        s, cells = self.scanned, list(self._cells.items())
        if not cells or not len(ranges):
            return
        placed = np.array([(cell.x, cell.y) for _, cell in cells])
        x, y = to_world(here, scan.x, scan.y)
        dx, dy = placed[:, 0] - x, placed[:, 1] - y
        bearings = np.arctan2(dy, dx) - here[2]
        low, high, inside = beside(bearings, scan.bearing, scan.step, len(ranges))
        beyond = np.hypot(dx, dy) + s.margin_m
        with np.errstate(invalid="ignore"):  # of a ray without a valid range nothing is known
            through = inside & (ranges[low] > beyond) & (ranges[high] > beyond)
        for k in np.flatnonzero(through).tolist():
            key, cell = cells[k]
            cell.evidence, cell.at = self._left(cell, now) - s.miss, now
            if cell.evidence <= 0.0:
                del self._cells[key]

    def forget(self, now: float, recent_s: float) -> None:
        """Keep only what was seen a moment ago."""
        self._cells = {k: c for k, c in self._cells.items() if now - c.at <= recent_s}

    def touch(self, pose: Posed, x: float, y: float, now: float) -> None:
        """Something touched the robot there (body frame): that is sure, unless it is a wall."""
        at = Placed(*to_world((pose.x, pose.y, pose.theta), x, y))
        if self._clearance(at.x, at.y) > self.p.near_m:
            self._add(at.x, at.y, self.p.most, now)

    def points(self, now: float) -> tuple[Segment, ...]:
        """What is believed to stand there now, as walls without length; what is not, is dropped."""
        for key, cell in list(self._cells.items()):
            if self._left(cell, now) < 0.5:
                del self._cells[key]
        believed = (c for c in self._cells.values() if self._left(c, now) >= self.p.believed)
        return tuple(sorted((c.x, c.y, c.x, c.y) for c in believed))

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

    def _doubt(
        self, x: float, y: float, bearing: float, free: float, share: float, now: float
    ) -> None:
        """A ping had nothing before `free` m on its axis."""
        c, s, slope = cos(bearing), sin(bearing), tan(self.p.axis_rad)
        for key, cell in list(self._cells.items()):
            dx, dy = cell.x - x, cell.y - y
            along = c * dx + s * dy
            if 0.0 < along < free and abs(c * dy - s * dx) <= slope * along:
                cell.evidence, cell.at = self._left(cell, now) - share, now
                if cell.evidence <= 0.0:
                    del self._cells[key]

    def _explained(self, x: float, y: float, bearing: float, heard: float, near: float) -> bool:
        """Whether the map has a wall where the echo may come from, or one that hides the place."""
        if self._known is None:
            return False
        for angle in bearing + self.p.arc_rad * _ARC:
            if self._clearance(x + heard * cos(angle), y + heard * sin(angle)) <= near:
                return True
        there = Placed(x + heard * cos(bearing), y + heard * sin(bearing))
        return self._known.clearance_between(Placed(x, y), there) == 0.0

    def _clearance(self, x: float, y: float) -> float:
        if self._known is None:
            return inf
        return float(self._known.clearance[self._known.cell(Placed(x, y))])
