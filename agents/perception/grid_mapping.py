"""An occupancy grid from sonars and lasers, in log-odds (Moravec and Elfes, 1985).

A laser's ray is a line: cells on it are free, the cell at its end is occupied.

A sonar has a cone and returns one range. All cells before the echo are free, more certainly near
the axis. One cell or a few on the arc are occupied, but which is unknown. Three rules limit the
damage of that ambiguity:

- An arc's evidence goes to those of its cells that are already likely to be occupied, if any
  (Konolige's MURIEL, 1997), so that far arcs do not close doors.
- Cells behind a likely occupied one are not cleared: a wall at a glancing angle does not answer,
  and what is behind it did.
- A ping without an echo may have been reflected away, so it clears only near cells, and weakly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace as replaced
from math import ceil, floor
from typing import Any, Final

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from armadico.agents.methods.geometry import Posed
from armadico.agents.methods.poses import wrapped
from armadico.config.grid_map import FREE, NOTHING, OCCUPIED, UNKNOWN, Cells
from armadico.mobile.geometry import compose, to_world
from armadico.mobile.messages import Echo, Scan
from armadico.mobile.scans import bearings_of, ranges_of

BINS: Final = 15
"""Slices of a cone: in each, a likely occupied cell hides those behind it."""

GROW_M: Final = 4.0
"""Extra size by which the grid grows."""

TOGETHER: Final = 90
"""Rays of a scan that are drawn together: more do not fit into a processor's cache."""


NEAR_CELLS: Final = 1
"""A wall that two maps draw this many cells apart is the same: walls lie between cells."""


class Settings(Struct, frozen=True):
    """Weights of a ping and of a ray, in log-odds."""

    cell_m: float = 0.05
    reach_m: float = 1.5  # greatest range of a ping's evidence: farther arcs close doors
    silent_m: float = 0.8  # greatest distance cleared by a ping without an echo
    hit: float = 1.0  # greatest evidence for one cell of an arc
    spread: float = 2.5  # evidence shared by all cells of an arc
    miss: float = 0.5  # evidence for free on the axis, near the sonar
    silence: float = 0.2  # evidence for free there by a ping without an echo
    most: float = 4.0  # limit of the log-odds: contrary evidence of seconds changes it
    free: float = 0.85  # log-odds of a free cell: a probability of 0.3
    occupied: float = 1.2  # log-odds of an occupied cell: 0.77
    far: float = 0.3  # share of the evidence at `reach_m`
    size_m: float = 200.0  # greatest width and height of the grid
    seen_m: float = 8.0  # greatest range of a laser's rays: beyond, gaps are wider than cells
    unseen_m: float = 3.0  # greatest range of a ray without a return: the surface may be dark
    seen: float = 1.2  # evidence of a ray's end
    through: float = 0.4  # evidence for free of each cell on the ray


class Mapper:
    """Log-odds of a part of the world, which grows with what is sensed."""

    def __init__(self, half_cone: float = 0.0) -> None:
        """Prepare for sonars with half a cone of this angle, rad; 0: none."""
        self.p = Settings()
        self._half = half_cone
        self._row = self._column = 0  # of the corner, in cells from `_lines`
        self.full = False  # readings were left out, since the map would become too large
        self._lines = (0.0, 0.0)  # m; a resumed map's cells may be offset from multiples of cell_m
        self._odds: NDArray[np.float32] = np.zeros((0, 0), dtype=np.float32)

    def resume(self, cells: Cells) -> None:
        """Continue a map with its cells. New evidence may change what it has."""
        self.p = replace(self.p, cell_m=cells.cell_m)
        self._row = self._column = 0
        self._lines = cells.x, cells.y
        odds = np.zeros(cells.states.shape, dtype=np.float32)
        odds[cells.states == FREE] = -2.0 * self.p.free
        odds[cells.states == OCCUPIED] = 2.0 * self.p.occupied
        self._odds = odds

    def begin_on(self, cells: Cells) -> None:
        """Begin an unknown map with the cells of another one, to compare both."""
        self.resume(replaced(cells, states=np.full_like(cells.states, UNKNOWN)))

    def settle(self) -> None:
        """End a session: what it has is as sure as a map that is resumed, and no surer."""
        p = self.p
        np.clip(self._odds, -2.0 * p.free, 2.0 * p.occupied, out=self._odds)

    def add(self, pose: Posed, echo: Echo) -> None:
        """Add one ping of a robot at a pose in the world."""
        p = self.p
        x, y, bearing = compose((pose.x, pose.y, pose.theta), (echo.x, echo.y, echo.bearing))
        no_echo = echo.range is None
        distance = p.silent_m if echo.range is None else echo.range
        half = self._half
        span = min(distance + 2.0 * p.cell_m, p.reach_m)
        angles = bearing + half * np.linspace(-1.0, 1.0, 5)
        xs = np.append(x + span * np.cos(angles), x)
        ys = np.append(y + span * np.sin(angles), y)
        window = self._window(xs.min(), ys.min(), xs.max(), ys.max())
        if window is None:
            return
        odds, dx, dy = window[0], window[1] - x, window[2] - y
        away = np.hypot(dx, dy)
        off = wrapped(np.arctan2(dy, dx) - bearing)
        cone = (np.abs(off) <= half) & (away <= span)
        fading = 1.0 - (1.0 - p.far) * away / p.reach_m
        centred = 1.0 - (off / half) ** 2
        thick = p.cell_m
        before = cone & (away < distance - thick)
        solid = before & (odds > p.occupied)
        if solid.any():
            slices = np.clip(((off / half + 1.0) * 0.5 * BINS).astype(np.intp), 0, BINS - 1)
            nearest = np.full(BINS, np.inf)
            np.minimum.at(nearest, slices[solid], away[solid])
            before &= away <= nearest[slices] + thick
        odds[before] -= ((p.silence if no_echo else p.miss) * fading * centred)[before]
        arc = cone & (np.abs(away - distance) <= thick)
        if not no_echo and arc.any():
            belief = np.exp(odds[arc]) * np.exp(-4.0 * (off[arc] / half) ** 2)
            odds[arc] += np.minimum(p.hit, p.spread * belief / belief.sum()) * fading[arc]
        np.clip(odds, -p.most, p.most, out=odds)

    def stand(self, pose: Posed, corners: Sequence[tuple[float, float]]) -> None:
        """Mark the robot's footprint as free: a convex outline in the body frame."""
        at = (pose.x, pose.y, pose.theta)
        outline = np.array([to_world(at, *corner) for corner in corners])
        low, high = outline.min(axis=0), outline.max(axis=0)
        window = self._window(low[0], low[1], high[0], high[1])
        if window is None:
            return
        odds, xs, ys = window
        inside = np.ones(odds.shape, dtype=np.bool_)
        for (x1, y1), (x2, y2) in zip(outline, np.roll(outline, -1, axis=0), strict=True):
            inside &= (x2 - x1) * (ys - y1) - (y2 - y1) * (xs - x1) >= 0.0
        odds[inside] = -self.p.most

    def see(self, pose: Posed, scan: Scan) -> None:
        """Add a laser's scan of a robot at a pose in the world.

        Raises ValueError if its bytes are not ranges.
        """
        p, size = self.p, self.p.cell_m
        ranges, bearings = ranges_of(scan), bearings_of(scan) + pose.theta
        x, y = to_world((pose.x, pose.y, pose.theta), scan.x, scan.y)
        met = ranges <= p.seen_m  # False for NaN
        far = np.where(met, ranges, np.where(np.isinf(ranges), p.unseen_m, p.seen_m))
        valid = ~np.isnan(ranges)
        bearings, far, met = bearings[valid], far[valid], met[valid]
        if not len(far):
            return
        ahead, left = np.cos(bearings), np.sin(bearings)
        to_x, to_y = x + far * ahead, y + far * left
        window = self._window(
            *(min(x, float(to_x.min())) - size, min(y, float(to_y.min())) - size),
            *(max(x, float(to_x.max())) + size, max(y, float(to_y.max())) + size),
        )
        if window is None:
            return
        odds, xs, ys = window
        west, south, across = float(xs[0, 0]), float(ys[0, 0]), odds.shape[1]

        def at(some_x: NDArray[np.float64], some_y: NDArray[np.float64]) -> NDArray[np.intp]:
            column = np.floor((some_x - west) / size + 0.5).astype(np.intp)
            cell: NDArray[np.intp] = np.floor((some_y - south) / size + 0.5).astype(np.intp)
            cell *= across
            cell += column
            return cell

        through, ends = np.zeros(odds.size, dtype=np.bool_), far - np.where(met, size, 0.0)
        for begin in range(0, len(far), TOGETHER):
            some = slice(begin, begin + TOGETHER)
            steps = np.arange(0.0, far[some].max(), 0.5 * size)
            ray, step = np.nonzero(steps < ends[some, None])
            on_way = steps[step]
            through[at(x + on_way * ahead[some][ray], y + on_way * left[some][ray])] = True
        there = np.zeros(odds.size, dtype=np.bool_)
        there[at(to_x[met], to_y[met])] = True
        through &= ~there
        odds += (p.seen * there - p.through * through).reshape(odds.shape).astype(np.float32)
        np.clip(odds, -p.most, p.most, out=odds)

    def cells(self) -> Cells:
        """The known cells, cropped to their bounds."""
        odds, p = self._odds, self.p
        states = np.where(odds >= p.occupied, OCCUPIED, np.where(odds <= -p.free, FREE, 0))
        rows, columns = (np.flatnonzero(states.any(axis=axis)) for axis in (1, 0))
        if not len(rows):
            return NOTHING
        top, left = int(rows[0]), int(columns[0])
        part = states[top : rows[-1] + 1, left : columns[-1] + 1].astype(np.uint8)
        x, y = self._lines
        corner = x + (self._column + left) * p.cell_m, y + (self._row + top) * p.cell_m
        return Cells(*corner, p.cell_m, part)

    def _window(
        self, x1: float, y1: float, x2: float, y2: float
    ) -> tuple[NDArray[np.float32], NDArray[Any], NDArray[Any]] | None:
        """The cells of a rectangle, and their centres; None if the grid would become too large."""
        size, (x, y) = self.p.cell_m, self._lines
        left, low = floor((x1 - x) / size), floor((y1 - y) / size)
        right, high = ceil((x2 - x) / size), ceil((y2 - y) / size)
        if not self._cover(low, left, high, right):
            return None
        rows = slice(low - self._row, high - self._row)
        columns = slice(left - self._column, right - self._column)
        xs = x + (np.arange(left, right) + 0.5) * size
        ys = y + (np.arange(low, high) + 0.5) * size
        return self._odds[rows, columns], xs[None, :], ys[:, None]

    def _cover(self, low: int, left: int, high: int, right: int) -> bool:
        """Grow until a rectangle of cells is inside; return whether it is."""
        rows, columns = self._odds.shape
        if not rows:
            self._row, self._column = low, left
        grow = (
            max(self._row - low, 0),
            max(high - self._row - rows, 0),
            max(self._column - left, 0),
            max(right - self._column - columns, 0),
        )
        if not any(grow):
            return True
        more = ceil(GROW_M / self.p.cell_m)
        below, above, before, after = (n + more if n else 0 for n in grow)
        most = self.p.size_m / self.p.cell_m
        if rows + below + above > most or columns + before + after > most:
            self.full = True
            return False
        self._odds = np.pad(self._odds, ((below, above), (before, after)))
        self._row -= below
        self._column -= before
        return True


def compared(seen: Cells, before: Cells) -> tuple[int, int]:
    """How many walls of two maps contradict each other, and how many could, in cells.

    Both have the same lines of cells. A wall of one counts where the other knows the cell, and it
    contradicts where that is free with no wall near. Free cells alone say nothing: most of a
    room is free in any building.
    """
    size, (rows, columns) = before.cell_m, seen.states.shape
    row, column = round((seen.y - before.y) / size), round((seen.x - before.x) / size)
    there = np.full((rows + 2 * NEAR_CELLS, columns + 2 * NEAR_CELLS), UNKNOWN, dtype=np.uint8)
    row, column = row - NEAR_CELLS, column - NEAR_CELLS
    low, left = max(row, 0), max(column, 0)
    part = before.states[low : max(row + len(there), 0), left : max(column + there.shape[1], 0)]
    there[low - row :, left - column :][: part.shape[0], : part.shape[1]] = part
    here = np.pad(seen.states, NEAR_CELLS, constant_values=UNKNOWN)
    against = both = 0
    for walls, other in ((here, there), (there, here)):
        near = _wide(other == OCCUPIED)
        alone = int(np.count_nonzero((walls == OCCUPIED) & (other == FREE) & ~near))
        against += alone
        both += alone + int(np.count_nonzero((walls == OCCUPIED) & near))
    return against, both


def _wide(cells: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The cells within `NEAR_CELLS` of some, along rows and columns."""
    for axis in (0, 1):
        steps = range(-NEAR_CELLS, NEAR_CELLS + 1)
        cells = np.logical_or.reduce([np.roll(cells, step, axis) for step in steps])
    return cells
