"""Writing of ARIA `.map` files."""

from __future__ import annotations

import re
from collections.abc import Sequence
from math import degrees
from pathlib import Path

from armadico.config.worlds import Pose, World
from armadico.core.config_errors import ConfigError

_UNFIT = re.compile(r'["#;\x00-\x1f\x7f-\x9f\u2028\u2029]')


def write_map(world: World, path: Path | str, comments: Sequence[str] = ()) -> None:
    """Save a world as a `.map` for ARIA and MobileSim. Coordinates are rounded to 1 mm."""
    Path(path).write_text(format_map(world, comments), encoding="utf-8")


def format_map(world: World, comments: Sequence[str] = ()) -> str:
    """The text of a `.map` file. Raises ConfigError for a name that the format does not allow."""
    x1, y1, x2, y2 = _millimetres(world.bounds)
    lines = ["2D-Map", *(f"# {comment}" for comment in comments)]
    lines += [f"LineMinPos: {x1} {y1}", f"LineMaxPos: {x2} {y2}"]
    if world.walls:  # ARIA rejects NumLines: 0
        lines.append(f"NumLines: {len(world.walls)}")
    if world.start is not None:
        lines.append(_cairn("RobotHome", world.start, "", "RobotHome"))
    lines += [_cairn("GoalWithHeading", pose, "", name) for name, pose in world.goals.items()]
    lines += [_cairn("Dock", pose, "", name) for name, pose in world.docks.items()]
    for k, line in enumerate(world.forbidden):
        cairn = _cairn("ForbiddenLine", (0.0, 0.0, 0.0), "", f"forbidden-{k}")
        lines.append(" ".join([cairn, *map(str, _millimetres(line))]))
    for room in world.rooms:
        corners = _millimetres((room.x1, room.y1, room.x2, room.y2))
        cairn = _cairn("ArmadicoRoom", (0.0, 0.0, 0.0), "", _one_word(room.name))
        lines.append(" ".join([cairn, *map(str, corners)]))
    for door in world.doors:
        rooms = f"{_one_word(door.room_a)} {_one_word(door.room_b)}"
        lines.append(_cairn("ArmadicoDoor", (door.x, door.y, 0.0), rooms, door.name))
    for k, (x, y, radius) in enumerate(world.columns):
        mm = str(*_millimetres([radius]))
        lines.append(_cairn("ArmadicoColumn", (x, y, 0.0), mm, f"column-{k}"))
    lines += ["LINES", *(" ".join(map(str, _millimetres(wall))) for wall in world.walls), "DATA"]
    return "\n".join(lines) + "\n"


def _cairn(kind: str, pose: Pose, description: str, name: str) -> str:
    if not name or _UNFIT.search(name):
        raise ConfigError(f"name {name!r}: a .map file allows no quote, # or ;")
    x, y = _millimetres(pose[:2])
    heading = round(degrees(pose[2]), 6) + 0.0  # + 0.0: no -0
    return f'Cairn: {kind} {x} {y} {heading:.6f} "{description}" ICON "{name}"'


def _one_word(name: str) -> str:
    if len(name.split()) != 1 or name != name.strip():
        raise ConfigError(f"room {name!r}: expected one word, since doors name it")
    return name


def _millimetres(values: Sequence[float]) -> list[int]:
    return [round(value * 1000.0) for value in values]
