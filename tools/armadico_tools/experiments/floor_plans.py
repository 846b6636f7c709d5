"""Floor plans from seeds: rooms side by side, doors between them, furniture in them.

A plan is passable by construction, and checked: furniture is removed until a flood fill from the
start reaches the goal for a disc as wide as the robot's body plus 20 cm. The fill uses cells of
5 cm whose middles have the disc's radius plus half a cell as distance from every wall. So every
point of the straight lines between neighbouring cells keeps the radius.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations, pairwise
from math import cos, hypot, pi, sin
from pathlib import Path
from random import Random
from typing import Final

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from armadico.config.mapwriter import write_map
from armadico.config.profile import load_profile
from armadico.config.worlds import Door, Pose, Room, Segment, World, hull

BODY_M: Final = 0.33
PASSAGE_M: Final = BODY_M + 0.20
CELL_M: Final = 0.05

SIDES_M: Final = ((8.0, 14.0), (6.0, 10.0))
ROOM_M: Final = 2.4  # least side of a room
BIG_M: Final = 5.5  # a longer side is always divided
DOOR_M: Final = (0.8, 1.1)
CORNER_M: Final = 0.3  # from a door to the end of its wall
EXTRA_DOOR: Final = 0.3  # probability of a door that no way needs
ITEMS: Final = 3  # most pieces of furniture in a room
ITEM_M: Final = (0.25, 0.9)
FREE_M: Final = 0.45  # around start and goal

Rectangle = tuple[float, float, float, float]
Mask = NDArray[np.bool_]
Axis = NDArray[np.float64]


class FloorPlan(Struct, frozen=True):
    """A world, and a start and goal with a way between them."""

    world: World
    start: Pose
    goal: Pose
    items: int  # pieces of furniture


def floor_plan(seed: int) -> FloorPlan:
    """The plan of a seed."""
    rng = Random(f"floor plan/{seed}")
    while True:
        found = _attempt(rng, f"plan-{seed:03d}")
        if found is not None:
            return found


def save(plan: FloorPlan, folder: Path) -> Path:
    """Write the plan's map and scenario. Returns the scenario's file."""
    name = plan.world.name
    write_map(plan.world, folder / f"{name}.map", ("A generated floor plan.",))
    path = folder / f"{name}.toml"
    lines = [
        f'title = "Floor plan {name}, {plan.items} pieces of furniture"',
        f'world = "{name}.map"',
        f"start = {_degrees(plan.start)}",
        f"goal = {_degrees(plan.goal)}",
        'plan = "rooms"',
    ]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def plan_of(task: tuple[Path, int]) -> Path:
    """Write the plan of a seed into a folder. Returns the scenario's file."""
    folder, seed = task
    return save(floor_plan(seed), folder)


def _degrees(pose: Pose) -> list[float]:
    return [pose[0], pose[1], round(pose[2] * 180.0 / pi, 1)]


def _attempt(rng: Random, name: str) -> FloorPlan | None:
    outline = (0.0, 0.0, *(round(rng.uniform(*side), 1) for side in SIDES_M))
    areas = list(_divide(rng, (outline[0], outline[1], outline[2], outline[3])))
    if len(areas) < 2:
        return None
    rooms = tuple(Room(f"R{index}", *area) for index, area in enumerate(areas))
    doors, gaps = _doors(rng, rooms)
    walls = tuple(_walls(rooms, gaps))
    start_room, goal_room = rng.sample(rooms, 2)
    start, goal = _pose(rng, start_room), _pose(rng, goal_room)
    furniture = [_item(rng, room) for room in rooms for _ in range(rng.randint(0, ITEMS))]
    furniture = [item for item in furniture if _clear(item, start) and _clear(item, goal)]
    rng.shuffle(furniture)
    while not passable(walls + _flat(furniture), start, goal):
        if not furniture:
            return None
        furniture.pop()
    everything = walls + _flat(furniture)
    world = World(name, everything, hull(everything), start, {"goal": goal}, rooms, doors)
    return FloorPlan(world, start, goal, len(furniture))


def _divide(rng: Random, area: Rectangle) -> Iterator[Rectangle]:
    """Rooms, by repeatedly cutting the longer side."""
    x1, y1, x2, y2 = area
    wide = x2 - x1 >= y2 - y1
    side = x2 - x1 if wide else y2 - y1
    if side < 2 * ROOM_M or (side < BIG_M and rng.random() < 0.4):
        yield area
        return
    cut = round((x1 if wide else y1) + rng.uniform(ROOM_M, side - ROOM_M), 1)
    parts = (
        ((x1, y1, cut, y2), (cut, y1, x2, y2)) if wide else ((x1, y1, x2, cut), (x1, cut, x2, y2))
    )
    for part in parts:
        yield from _divide(rng, part)


def _shared(a: Room, b: Room) -> Segment | None:
    """The wall between two rooms, if it is long enough for a door."""
    low_x, high_x = max(a.x1, b.x1), min(a.x2, b.x2)
    low_y, high_y = max(a.y1, b.y1), min(a.y2, b.y2)
    least = DOOR_M[0] + 2 * CORNER_M
    if low_x == high_x and high_y - low_y >= least:
        return low_x, low_y, high_x, high_y
    if low_y == high_y and high_x - low_x >= least:
        return low_x, low_y, high_x, high_y
    return None


def _doors(rng: Random, rooms: Sequence[Room]) -> tuple[tuple[Door, ...], list[Segment]]:
    """Doors that connect all rooms, and some more; and their gaps."""
    walls = [(a, b, wall) for a, b in combinations(rooms, 2) if (wall := _shared(a, b))]
    rng.shuffle(walls)
    group = {room.name: room.name for room in rooms}
    doors: list[Door] = []
    gaps: list[Segment] = []
    for a, b, (x1, y1, x2, y2) in walls:
        joins = group[a.name] != group[b.name]
        if not joins and rng.random() >= EXTRA_DOOR:
            continue
        old, new = group[b.name], group[a.name]
        group = {name: new if of == old else of for name, of in group.items()}
        length = hypot(x2 - x1, y2 - y1)
        width = min(round(rng.uniform(*DOOR_M), 2), length - 2 * CORNER_M)
        middle = rng.uniform(CORNER_M + width / 2, length - CORNER_M - width / 2) / length
        x, y = x1 + middle * (x2 - x1), y1 + middle * (y2 - y1)
        dx, dy = (width / 2, 0.0) if y1 == y2 else (0.0, width / 2)
        x, y = round(x, 2), round(y, 2)
        doors.append(Door(f"D{len(doors)}", a.name, b.name, x, y))
        gaps.append((x - dx, y - dy, x + dx, y + dy))
    return tuple(doors), gaps


def _walls(rooms: Sequence[Room], gaps: Sequence[Segment]) -> Iterator[Segment]:
    """The borders of all rooms, each once and without gaps."""
    upright: dict[float, list[tuple[float, float]]] = {}
    level: dict[float, list[tuple[float, float]]] = {}
    for room in rooms:
        for x in (room.x1, room.x2):
            upright.setdefault(x, []).append((room.y1, room.y2))
        for y in (room.y1, room.y2):
            level.setdefault(y, []).append((room.x1, room.x2))
    for x, spans in sorted(upright.items()):
        open_ = [(y1, y2) for x1, y1, x2, y2 in gaps if x1 == x2 == x]
        yield from ((x, low, x, high) for low, high in _without(spans, open_))
    for y, spans in sorted(level.items()):
        open_ = [(x1, x2) for x1, y1, x2, y2 in gaps if y1 == y2 == y]
        yield from ((low, y, high, y) for low, high in _without(spans, open_))


def _without(
    spans: Sequence[tuple[float, float]], gaps: Sequence[tuple[float, float]]
) -> Iterator[tuple[float, float]]:
    """The union of spans without the gaps, as few stretches as possible."""
    ends = sorted({end for span in (*spans, *gaps) for end in span})
    begin: float | None = None
    for low, high in pairwise(ends):
        middle = 0.5 * (low + high)
        solid = any(a < middle < b for a, b in spans) and not any(a < middle < b for a, b in gaps)
        if solid and begin is None:
            begin = low
        if not solid and begin is not None:
            yield begin, low
            begin = None
    if begin is not None:
        yield begin, ends[-1]


def _pose(rng: Random, room: Room) -> Pose:
    x = rng.uniform(room.x1 + 2 * FREE_M, room.x2 - 2 * FREE_M)
    y = rng.uniform(room.y1 + 2 * FREE_M, room.y2 - 2 * FREE_M)
    return round(x, 2), round(y, 2), round(rng.randrange(-170, 190, 10) * pi / 180.0, 6)


def _item(rng: Random, room: Room) -> list[tuple[float, float]]:
    """The corners of a box at a random place in a room, turned or not."""
    length, width = (rng.uniform(*ITEM_M) for _ in range(2))
    turned = rng.choice((0.0, 0.0, rng.uniform(0.0, pi / 2)))
    reach = 0.5 * hypot(length, width)
    x = rng.uniform(room.x1 + reach, room.x2 - reach)
    y = rng.uniform(room.y1 + reach, room.y2 - reach)
    c, s = cos(turned), sin(turned)
    signs = ((1, 1), (-1, 1), (-1, -1), (1, -1))
    halves = [(0.5 * length * a, 0.5 * width * b) for a, b in signs]
    return [(round(x + c * a - s * b, 3), round(y + s * a + c * b, 3)) for a, b in halves]


def _flat(furniture: Sequence[Sequence[tuple[float, float]]]) -> tuple[Segment, ...]:
    pairs = (zip(item, (*item[1:], item[0]), strict=True) for item in furniture)
    return tuple((*a, *b) for sides in pairs for a, b in sides)


def _clear(item: Sequence[tuple[float, float]], pose: Pose) -> bool:
    """Whether a pose has room around it, and is outside the box."""
    mx = sum(x for x, _ in item) / len(item)
    my = sum(y for _, y in item) / len(item)
    reach = max(hypot(x - mx, y - my) for x, y in item)
    return hypot(pose[0] - mx, pose[1] - my) >= reach + max(
        FREE_M, load_profile("pioneer-2dx").body.circle_m
    )


def passable(walls: Sequence[Segment], start: Pose, goal: Pose, width: float = PASSAGE_M) -> bool:
    """Whether a disc of a width (m) can move from start to goal."""
    from scipy.ndimage import label

    free, xs, ys = free_cells(walls, 0.5 * width + 0.5 * CELL_M)
    cells = []
    for pose in (start, goal):
        i, j = (round((at - axis[0]) / CELL_M) for at, axis in ((pose[0], xs), (pose[1], ys)))
        if not free[i, j]:
            return False
        cells.append((i, j))
    parts, _ = label(free)  # neighbours share a side
    return bool(parts[cells[0]] == parts[cells[1]])


def free_cells(walls: Sequence[Segment], radius: float) -> tuple[Mask, Axis, Axis]:
    """The cells whose middles are at least `radius` (m) from every wall, and their coordinates."""
    x1, y1, x2, y2 = hull(tuple(walls))
    xs = np.arange(x1, x2 + CELL_M / 2, CELL_M)
    ys = np.arange(y1, y2 + CELL_M / 2, CELL_M)
    free: Mask = np.ones((len(xs), len(ys)), dtype=np.bool_)
    for ax, ay, bx, by in walls:
        near = radius + CELL_M
        rows = (xs >= min(ax, bx) - near) & (xs <= max(ax, bx) + near)
        columns = (ys >= min(ay, by) - near) & (ys <= max(ay, by) + near)
        px, py = xs[rows, None], ys[None, columns]
        dx, dy = bx - ax, by - ay
        along = np.clip(((px - ax) * dx + (py - ay) * dy) / (dx * dx + dy * dy), 0.0, 1.0)
        away = np.hypot(px - ax - along * dx, py - ay - along * dy)
        free[np.ix_(rows, columns)] &= away >= radius
    return free, xs, ys
