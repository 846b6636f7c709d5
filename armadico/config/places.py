"""Named places of a world: where a robot stands in a room, and what it can reach."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from functools import cached_property
from math import ceil, inf, isfinite
from typing import Final

import numpy as np
from numpy.typing import NDArray

from armadico.config.profile import Body
from armadico.config.worlds import Room, Segment, World
from armadico.core.config_errors import ConfigError, ConfigNameError, advice

CELL_M: Final = 0.05
"""Cell of the grid for reachability."""

CELLS_MOST: Final = 16_000_000
"""Most cells of that grid: in a world above 200 m x 200 m every place counts as reachable."""

STEP_M: Final = 0.1
"""Spacing of the candidate points in a room, from its middle on."""

ROOMY_M: Final = 0.2
"""Preferred clearance of a point in a room, beyond the robot's turning circle."""

Place = tuple[float, float, float | None]
"""x, y in m and a heading in rad; None: any."""

Points = NDArray[np.float64]


class Places:
    """The rooms and goals of one world, for one robot."""

    def __init__(self, world: World, body: Body) -> None:
        self.world = world
        self._body = body
        self._rooms = {room.name: room for room in world.rooms}
        self._found: dict[str, Place] = {}

    @property
    def names(self) -> list[str]:
        """The names of rooms and goals, sorted."""
        return sorted({*self._rooms, *self.world.goals})

    @property
    def rooms(self) -> list[str]:
        """The rooms, sorted."""
        return sorted(self._rooms)

    def of(self, name: str) -> Place:
        """The pose of a goal, or the point of a room for the robot.

        That point is the one nearest to the middle of the room where the robot can turn. Raises
        ConfigNameError for an unknown name, ConfigError for a room without such a point.
        """
        if name not in self._found:
            goal, room = self.world.goals.get(name), self._rooms.get(name)
            if goal is None and room is None:
                message = f"no place {name!r} in {self.world.name!r}; {advice(name, self.names)}"
                raise ConfigNameError("place", name, self.names, message=message)
            self._found[name] = goal if goal is not None else self._within(self._rooms[name])
        return self._found[name]

    def unreachable(self, start: tuple[float, float], names: Iterable[str]) -> Iterable[str]:
        """The places that the robot cannot reach from a start, m."""
        for name in names:
            x, y, _ = self.of(name)
            if not self.joined(start, (x, y)):
                yield name

    def joined(self, start: tuple[float, float], place: tuple[float, float]) -> bool:
        """Whether the robot's width fits along some path between two points, or it is not known."""
        x1, y1, x2, y2 = self.world.bounds
        cells = (x2 - x1) * (y2 - y1) / CELL_M**2
        if not self.world.barriers or not all(map(isfinite, start)) or cells > CELLS_MOST:
            return True
        return bool(self._around(*self._cell(*start)) & self._around(*self._cell(*place)))

    def inhabited(self, points: Points) -> NDArray[np.bool_]:
        """Which points, (n, 2) in m, can be reached from a named place or a dock.

        This excludes the outside of a building and closed cavities. All points can be reached in a
        world without named places.
        """
        found = set[int]()
        for name in self.names:
            with suppress(ConfigError):  # a room in which the robot cannot turn
                found |= self._around(*self._cell(*self.of(name)[:2]))
        for x, y, _ in self.world.docks.values():
            found |= self._around(*self._cell(x, y))
        if not found:
            return np.ones(len(points), dtype=np.bool_)
        there = np.isin(self._regions, [*found])
        near = np.pad(there, 1)  # a point of another grid may lie beside the free cell
        near[1:] |= near[:-1].copy()
        near[:-1] |= near[1:].copy()
        near[:, 1:] |= near[:, :-1].copy()
        near[:, :-1] |= near[:, 1:].copy()
        cells = np.rint((points - np.array(self.world.bounds[:2])) / CELL_M).astype(np.intp)
        columns, rows = np.clip(cells, 0, np.array(there.shape) - 1).T
        found_at: NDArray[np.bool_] = near[columns + 1, rows + 1]
        return found_at

    # Inside --------------------------------------------------------------------------------------

    def _within(self, room: Room) -> Place:
        middle_x, middle_y = (room.x1 + room.x2) / 2, (room.y1 + room.y2) / 2
        xs, ys = (
            middle + STEP_M * np.arange(-ceil(half / STEP_M), ceil(half / STEP_M) + 1)
            for middle, half in (
                (middle_x, (room.x2 - room.x1) / 2),
                (middle_y, (room.y2 - room.y1) / 2),
            )
        )
        grid_x, grid_y = (axis.ravel() for axis in np.meshgrid(xs, ys))
        inside = (room.x1 < grid_x) & (grid_x < room.x2) & (room.y1 < grid_y) & (grid_y < room.y2)
        grid_x, grid_y = grid_x[inside], grid_y[inside]
        clearance = np.full(grid_x.shape, inf)
        for wall in self.world.barriers:
            np.minimum(clearance, _distances(grid_x, grid_y, wall), out=clearance)
        away = np.round(np.hypot(grid_x - middle_x, grid_y - middle_y), 6)
        for radius in (self._body.circle_m + ROOMY_M, self._body.goal_room_m):
            free = clearance >= radius
            if free.any():
                nearest = int(np.argmin(np.where(free, away, inf)))
                return round(float(grid_x[nearest]), 3), round(float(grid_y[nearest]), 3), None
        raise ConfigError(
            f"the robot can turn nowhere in room {room.name!r} of {self.world.name!r}: it needs"
            f" {self._body.goal_room_m:.2f} m to every wall ({self._body.goal_needs})"
        )

    @cached_property
    def _free(self) -> NDArray[np.bool_]:
        """(column, row) cells where the robot's middle can be in some heading."""
        x1, y1, x2, y2 = self.world.bounds
        radius = self._body.width_m / 2
        xs, ys = np.arange(x1, x2 + CELL_M, CELL_M), np.arange(y1, y2 + CELL_M, CELL_M)
        free = np.ones((len(xs), len(ys)), dtype=np.bool_)
        for wall in self.world.barriers:
            left, right = (np.searchsorted(xs, at) for at in _span(wall[0], wall[2], radius))
            low, high = (np.searchsorted(ys, at) for at in _span(wall[1], wall[3], radius))
            near_x, near_y = np.meshgrid(xs[left:right], ys[low:high], indexing="ij")
            free[left:right, low:high] &= _distances(near_x, near_y, wall) >= radius
        return free

    def _cell(self, x: float, y: float) -> tuple[int, int]:
        x1, y1, _, _ = self.world.bounds
        columns, rows = self._free.shape
        column, row = round((x - x1) / CELL_M), round((y - y1) / CELL_M)
        return min(max(column, 0), columns - 1), min(max(row, 0), rows - 1)

    def _around(self, column: int, row: int) -> set[int]:
        """The regions of a cell; of a cell that is not free, those of its neighbours."""
        found = self._regions[column, row]
        if found:
            return {int(found)}
        beside = self._regions[max(column - 1, 0) : column + 2, max(row - 1, 0) : row + 2]
        return {int(region) for region in np.unique(beside) if region}

    @cached_property
    def _regions(self) -> NDArray[np.int64]:
        """By (column, row) the number of a free cell's region, else 0."""
        return regions(self._free)


def regions(free: NDArray[np.bool_]) -> NDArray[np.int64]:
    """The region numbers of the cells, from 1; 0 where `free` is False.

    Cells with a common side belong to one region. Runs of cells in a row are joined with the
    touching runs of the next row. This is fast enough for the order of a mission: a world of
    100 m x 100 m has four million cells.
    """
    steps = np.diff(np.pad(free, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    columns, begins = np.nonzero(steps == 1)
    ends = np.nonzero(steps == -1)[1]
    runs = [*zip(columns.tolist(), begins.tolist(), ends.tolist(), strict=True)]
    parents = list(range(len(runs)))

    def root(run: int) -> int:
        while parents[run] != run:
            parents[run] = parents[parents[run]]
            run = parents[run]
        return run

    before = 0
    for run, (column, begin, end) in enumerate(runs):
        while runs[before][0] < column - 1 or (
            runs[before][0] == column - 1 and runs[before][2] <= begin
        ):
            before += 1
        other = before
        while runs[other][0] == column - 1 and runs[other][1] < end:
            parents[root(other)] = root(run)
            other += 1
    found = np.zeros(free.shape, dtype=np.int64)
    roots = np.array([root(run) + 1 for run in range(len(runs))], dtype=np.int64)
    found[free] = np.repeat(roots, ends - begins)
    return found


def _span(a: float, b: float, radius: float) -> tuple[float, float]:
    return min(a, b) - radius, max(a, b) + radius


def _distances(x: Points, y: Points, wall: Segment) -> Points:
    """The distances of points from a wall, m."""
    x1, y1, x2, y2 = wall
    dx, dy = x2 - x1, y2 - y1
    square = dx * dx + dy * dy
    along = (
        np.clip(((x - x1) * dx + (y - y1) * dy) / square, 0.0, 1.0) if square else np.zeros_like(x)
    )
    return np.asarray(np.hypot(x - x1 - along * dx, y - y1 - along * dy))
