"""Worlds from seeds in which behaviours disagree: nothing is planned around what is in the way.

In each a disc of 0.66 m, twice the robot's width, gets from the start to the goal, by flood fill:
what cannot be driven is drawn again. Whether agents disagree there is measured (`rivals`).
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from functools import cache
from itertools import pairwise
from json import dumps
from math import hypot
from pathlib import Path
from random import Random
from typing import Final

from msgspec import Struct

from armadico.config.mapwriter import write_map
from armadico.config.scenarios import Scenario, load_scenario
from armadico.config.worlds import Pose, Segment, World, before, hull
from armadico_tools.experiments.bidders import PLACE
from armadico_tools.experiments.floor_plans import passable

DISC_M: Final = 0.66

ENDS_M: Final = 0.7
"""Free distance around start and goal."""

CHARGE: Final = 0.35
CAPACITY_AH: Final = 0.04
"""A battery that lasts for some 14 s of fast driving, or 40 s of standing; it is charged in 8 s."""

Box = tuple[float, float, float, float]
"""x1, y1, x2, y2 in m."""

Span = tuple[float, float]


class Made(Struct, frozen=True):
    """A world, a start and a goal; no map shows the `unknown` boxes. `people` have their starts.

    The `place` is worth a visit on the way. In a `dock`, a plate in the open, the battery is
    charged; it starts with the `charge`, a share of its capacity.
    """

    walls: tuple[Segment, ...]
    start: Pose
    goal: Pose
    plan: str = "direct"
    unknown: tuple[Box, ...] = ()
    people: tuple[tuple[float, float], ...] = ()
    place: Pose | None = None
    dock: Pose | None = None
    charge: float = 1.0
    capacity_ah: float | None = None  # None: the robot's

    @property
    def solid(self) -> tuple[Segment, ...]:
        """All that can be touched."""
        return self.walls + tuple(side for box in self.unknown for side in _sides(box))

    @property
    def legs(self) -> tuple[tuple[Pose, Pose], ...]:
        """The ways that must be there, from each aim to the next."""
        aims = (self.start, *(each for each in (self.place, self.dock) if each), self.goal)
        return tuple(pairwise(aims))


def slalom(rng: Random) -> Made:
    """A corridor of 9 by 2.2 m with three boxes of 0.4 m, left and right of its middle."""
    boxes = []
    side = rng.choice((-1.0, 1.0))
    for at in (2.6, 4.5, 6.4):
        x = at + rng.uniform(-0.3, 0.3)
        boxes.append(_box(x, 1.1 + side * rng.uniform(0.15, 0.6), 0.4))
        side = -side
    return Made(_walls((0.0, 0.0, 9.0, 2.2), boxes), (0.8, 1.1, 0.0), (8.2, 1.1, 0.0))


def clutter(rng: Random) -> Made:
    """A room of 9 by 6 m with thirteen boxes of 0.36 m."""
    start = (0.8, rng.uniform(1.0, 5.0), 0.0)
    goal = (8.2, rng.uniform(1.0, 5.0), 0.0)
    boxes = _scattered(rng, 13, 0.36, (1.4, 0.4, 7.6, 5.6), (start, goal))
    return Made(_walls((0.0, 0.0, 9.0, 6.0), boxes), start, goal)


def furniture(rng: Random) -> Made:
    """Two rooms with a door of 0.8 to 1.0 m between them, and boxes that the plan does not know.

    The goal is within 0.5 m of the door's end: one agent parks where another wants to drive on.
    """
    half, door_y, wall_x = rng.uniform(0.4, 0.5), rng.uniform(1.5, 4.5), rng.uniform(4.0, 5.0)
    wall = ((wall_x, 0.0, wall_x, door_y - half), (wall_x, door_y + half, wall_x, 6.0))
    start = (0.8, rng.uniform(1.0, 5.0), 0.0)
    goal = (wall_x + rng.uniform(0.7, 0.9), door_y + rng.uniform(-0.2, 0.2), 0.0)
    boxes = _scattered(rng, 5, 0.4, (1.4, 0.4, wall_x - 0.8, 5.6), (start, (wall_x, door_y, 0.0)))
    return Made(_walls((0.0, 0.0, 9.0, 6.0), ()) + wall, start, goal, "rooms", tuple(boxes))


def blind_end(rng: Random) -> Made:
    """A U of 1.5 m, open to the robot, on the straight line to the goal."""
    x, y = rng.uniform(4.0, 5.0), 3.0 + rng.uniform(-0.4, 0.4)
    half, deep = 0.75, rng.uniform(0.6, 1.2)
    u = (
        (x - deep, y - half, x, y - half),
        (x, y - half, x, y + half),
        (x, y + half, x - deep, y + half),
    )
    ends = (0.8, 3.0 + rng.uniform(-0.3, 0.3), 0.0), (8.2, 3.0 + rng.uniform(-0.3, 0.3), 0.0)
    return Made(_walls((0.0, 0.0, 9.0, 6.0), ()) + u, *ends)


def people(rng: Random) -> Made:
    """A room of 9 by 6 m with six boxes of 0.36 m and three people, who keep clear of the robot."""
    start = (0.8, rng.uniform(1.0, 5.0), 0.0)
    goal = (8.2, rng.uniform(1.0, 5.0), 0.0)
    found = _scattered(rng, 9, 0.36, (1.8, 0.6, 7.6, 5.4), (start, goal))
    walking = tuple(((x1 + x2) / 2, (y1 + y2) / 2) for x1, y1, x2, y2 in found[6:])
    return Made(_walls((0.0, 0.0, 9.0, 6.0), found[:6]), start, goal, people=walking)


def two_goals(rng: Random) -> Made:
    """A room of 9 by 6 m with ten boxes of 0.36 m, and a place worth a visit beside the way."""
    start, goal = (0.8, rng.uniform(1.5, 4.5), 0.0), (8.2, rng.uniform(1.5, 4.5), 0.0)
    place = _beside(rng, start, goal, (3.0, 6.0), (0.5, 1.1))
    boxes = _scattered(rng, 10, 0.36, (1.4, 0.4, 7.6, 5.6), (start, place, goal))
    return Made(_walls((0.0, 0.0, 9.0, 6.0), boxes), start, goal, place=place)


def battery(rng: Random) -> Made:
    """A room of 10 by 6 m with eleven boxes of 0.36 m, and a dock beside the way.

    What the battery has at the start is enough to the dock, and not to the goal.
    """
    start, goal = (0.8, rng.uniform(1.5, 4.5), 0.0), (9.2, rng.uniform(1.5, 4.5), 0.0)
    dock = _beside(rng, start, goal, (3.5, 6.0), (0.8, 1.6))
    boxes = _scattered(rng, 11, 0.36, (1.4, 0.4, 8.6, 5.6), (start, before(dock), dock, goal))
    walls = _walls((0.0, 0.0, 10.0, 6.0), boxes)
    return Made(walls, start, goal, dock=dock, charge=CHARGE, capacity_ah=CAPACITY_AH)


def hall(rng: Random) -> Made:
    """An empty hall of 14 by 6 m."""
    ends = (1.0, rng.uniform(1.5, 4.5), 0.0), (13.0, rng.uniform(1.5, 4.5), 0.0)
    return Made(_walls((0.0, 0.0, 14.0, 6.0), ()), *ends)


MADE: Final[dict[str, Callable[[Random], Made]]] = {
    "slalom": slalom,
    "clutter": clutter,
    "furniture": furniture,
    "blind-end": blind_end,
    "people": people,
    "two-goals": two_goals,
    "battery": battery,
    "hall": hall,
}
"""The generators by the names that a file of cells uses as `world`."""


def made(name: str, seed: int) -> Made:
    """The world of a seed: the first one drawn that a disc of 0.66 m can pass."""
    rng = Random(f"{name}/{seed}")
    while True:
        found = MADE[name](rng)
        if all(passable(found.solid, *leg, DISC_M) for leg in found.legs):
            return found


def scenario(name: str, seed: int) -> Scenario:
    """The world of a seed as a scenario. Its files are this process's own."""
    folder, stem = Path(_folder().name), f"{name}-{seed}"
    path = folder / f"{stem}.toml"
    if not path.is_file():
        found = made(name, seed)
        goals = {"goal": found.goal} | ({PLACE: found.place} if found.place else {})
        docks = {"dock": found.dock} if found.dock else {}
        bounds = hull(found.walls)
        world = World(stem, found.walls, bounds, found.start, goals, docks=docks)
        write_map(world, folder / f"{stem}.map", ("A generated world.",))
        lines = [f"world = {dumps(f'{stem}.map')}", f"plan = {dumps(found.plan)}"]
        ends = (("start", found.start), ("goal", found.goal))
        lines += [f"{key} = [{x:.3f}, {y:.3f}, 0.0]" for key, (x, y, _) in ends]
        for x1, y1, x2, y2 in found.unknown:
            at = f"[{(x1 + x2) / 2:.3f}, {(y1 + y2) / 2:.3f}]"
            size = f"[{x2 - x1:.3f}, {y2 - y1:.3f}]"
            lines += ["[[moving]]", 'kind = "box"', f"at = {at}", f"size = {size}"]
        for x, y in found.people:
            lines += ["[[moving]]", 'kind = "person"', f"at = [{x:.3f}, {y:.3f}]", "speed = 0.8"]
        if found.capacity_ah is not None:
            lines += ["[battery]", f"charge = {found.charge}", f"capacity_ah = {found.capacity_ah}"]
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return load_scenario(path)


@cache
def _folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="armadico-worlds-")


def _walls(room: Box, boxes: Sequence[Box]) -> tuple[Segment, ...]:
    return tuple(side for box in (room, *boxes) for side in _sides(box))


def _sides(box: Box) -> tuple[Segment, ...]:
    x1, y1, x2, y2 = box
    return (x1, y1, x2, y1), (x2, y1, x2, y2), (x2, y2, x1, y2), (x1, y2, x1, y1)


def _box(x: float, y: float, side: float) -> Box:
    half = side / 2
    return round(x - half, 3), round(y - half, 3), round(x + half, 3), round(y + half, 3)


def _beside(rng: Random, start: Pose, goal: Pose, x: Span, off: Span) -> Pose:
    """A pose within that span of x, m, and so far beside the line from start to goal."""
    at = rng.uniform(*x)
    line = start[1] + (goal[1] - start[1]) * (at - start[0]) / (goal[0] - start[0])
    return round(at, 3), round(line + rng.choice((-1.0, 1.0)) * rng.uniform(*off), 3), 0.0


def _scattered(
    rng: Random, count: int, side: float, within: Box, clear_of: Sequence[Pose]
) -> list[Box]:
    """Boxes at random places, none of them near those poses or upon another."""
    found: list[Box] = []
    middles: list[tuple[float, float]] = []
    while len(found) < count:
        x, y = rng.uniform(within[0], within[2]), rng.uniform(within[1], within[3])
        free = all(hypot(x - at[0], y - at[1]) >= ENDS_M + side for at in clear_of)
        if free and all(hypot(x - mx, y - my) >= 1.5 * side for mx, my in middles):
            middles.append((x, y))
            found.append(_box(x, y, side))
    return found
