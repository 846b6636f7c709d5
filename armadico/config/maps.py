"""Reading of ARIA and MobileSim `.map` files (`armadico.config.mapwriter` writes them).

They are in millimetres and degrees; a `World` is in SI units.

The first line that is not a comment is `2D-Map`, or `2D-Map-Ex` to `2D-Map-Ex4`. In the latter the
keywords of a source begin with its name (`LMS1NumLines:`, `LMS1LINES`); all sources become one map.

These parts are read: the header (`LineMinPos:`, `LineMaxPos:`, `NumLines:`), `LINES`, and the
`Cairn:` lines, `Cairn: TYPE X Y DEGREES "DESCRIPTION" ICON "NAME" [X1 Y1 X2 Y2]`, of these types:

| type | meaning |
| --- | --- |
| `RobotHome` | the start pose |
| `Goal`, `GoalWithHeading` | a named goal; the heading of the former is 0 |
| `StandbyGoal`, `StandbyGoalWithHeading` | the same |
| `Dock`, `DockPioneer` | a charging dock: the pose of a docked robot |
| `ForbiddenArea`, `ForbiddenLine` | a forbidden rectangle or line, turned about 0, 0 |
| `ArmadicoRoom` | a room: NAME and its rectangle |
| `ArmadicoDoor` | a door: NAME, its middle, and the DESCRIPTION is its two rooms, `"A corridor"` |
| `ArmadicoColumn` | a round column: its middle, and the DESCRIPTION is its radius in mm |

The last three are Armadico's. Other types and keywords are ignored. A second goal or dock of one
name becomes `NAME-2`; one without a name has the name of its type.

In a map without `LINES`, the points after `DATA` become walls: the cells of `Resolution:`, at least
`POINT_M`, that hold a point. In a map with `LINES` the points are ignored.

A comment begins at `;` or `#` outside quotes.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from math import cos, isfinite, radians, sin
from pathlib import Path

from msgspec import Struct

from armadico.config.loading import read_text
from armadico.config.worlds import (
    Column,
    Door,
    Pose,
    Room,
    Segment,
    World,
    check_dock,
    check_door,
    hull,
)
from armadico.core.config_errors import ConfigError, ConfigNameError

LIMIT_M = 1e4
"""The largest coordinate."""

POINT_M = 0.05
"""The least size of a point's cell: scans leave gaps of this width between points."""

_FIRST = re.compile(r"2D-Map(-Ex[234]?)?", re.IGNORECASE)
_WORD = re.compile(r'"([^"]*)"|(\S+)')
_CODE = re.compile(r'(?:"[^"]*"|[^#;])*')  # a line without its comment
_SECTION = re.compile(r"(.*?)[-_]?(LINES|DATA)")
_HEADER = re.compile(r"(.*?)[-_]?(LineMinPos|LineMaxPos|NumLines|Resolution):")


def read_map(path: Path | str) -> World:
    """The world of an ARIA `.map` file. Raises ConfigError."""
    return parse_map(read_text(path, or_else="latin-1"), Path(path).stem, path)


def parse_map(text: str, name: str, file: Path | str = "<text>") -> World:
    """The world of the text of a `.map` file. Raises ConfigError."""
    reader = _Reader()
    begun = False
    for number, line in enumerate(text.splitlines(), start=1):
        code = _code(line)
        if begun:
            try:
                reader.line(code, number)
            except ConfigError as error:
                raise error.at(file, number) from None
        elif code:
            begun = _FIRST.fullmatch(code) is not None
            if not begun:
                break
    if not begun:
        raise ConfigError("not an ARIA map; expected 2D-Map in the first line", file, 1)
    return reader.finish(name, file)


class _Cairn(Struct, frozen=True):
    kind: str
    pose: Pose
    description: str
    name: str
    rest: list[str]
    line: int


class _Reader:
    """The parts of a map that have been read so far."""

    def __init__(self) -> None:
        self.section = self.source = ""
        self.corners: list[float] = []
        self.announced: dict[str, tuple[int, int]] = {}  # by source: NumLines and its line
        self.counted: Counter[str] = Counter()
        self.points: list[tuple[float, float]] = []
        self.cell_m = POINT_M
        self.walls: list[Segment] = []
        self.start: Pose | None = None
        self.named: Counter[str] = Counter()  # how often a name was used before
        self.goals: dict[str, Pose] = {}
        self.docks: dict[str, tuple[Pose, int]] = {}
        self.forbidden: list[Segment] = []
        self.rooms: dict[str, Room] = {}
        self.doors: dict[str, tuple[Door, int]] = {}
        self.columns: list[Column] = []

    def line(self, line: str, number: int) -> None:
        words = [quoted or plain for quoted, plain in _WORD.findall(line)]
        if not words:
            return
        section = _SECTION.fullmatch(words[0]) if len(words) == 1 else None
        if section is not None:
            self.source, self.section = section.groups()
        elif words[0] == "Cairn:":
            self.cairn(words[1:], number)
        elif words[0].endswith(":"):
            self.header(words[0], words[1:], number)
        elif self.section == "LINES":
            x1, y1, x2, y2 = _metres(_count(words, 4, "X1 Y1 X2 Y2 in mm"))
            self.walls.append((x1, y1, x2, y2))
            self.counted[self.source] += 1
        elif self.section != "DATA":
            raise ConfigError(f"{line!r}: expected `Keyword: ...`, LINES or DATA")
        elif not self.walls:
            x, y = _metres(_count(words, 2, "X Y in mm"))
            self.points.append((x, y))

    def header(self, keyword: str, words: list[str], number: int) -> None:
        known = _HEADER.fullmatch(keyword)
        if known is None:
            return
        source, kind = known.groups()
        if kind == "NumLines":
            announced = _number(_count(words, 1, "a number of lines")[0])
            self.announced[source] = int(announced), number
        elif kind == "Resolution":
            self.cell_m = max(self.cell_m, *_metres(_count(words, 1, "mm")))
        else:
            self.corners += _metres(_count(words, 2, "X Y in mm"))

    def cairn(self, words: list[str], line: int) -> None:
        kind = words[0] if words else ""
        if kind.startswith("Armadico") and kind not in CAIRNS:
            raise ConfigNameError("type of Cairn", kind, CAIRNS)
        if kind not in CAIRNS:
            return
        if len(words) < 7:
            raise ConfigError(f'expected Cairn: {kind} X Y DEGREES "" ICON "NAME"')
        x, y = _metres(words[1:3])
        pose = x, y, radians(_number(words[3]))
        CAIRNS[kind](self, _Cairn(kind, pose, words[4], words[6], words[7:], line))

    def home(self, cairn: _Cairn) -> None:
        if self.start is None:  # the first of several homes counts
            self.start = cairn.pose

    def goal(self, cairn: _Cairn) -> None:
        x, y, heading = cairn.pose
        heading = heading if cairn.kind.endswith("WithHeading") else 0.0
        self.goals[self.called(cairn, self.goals)] = (x, y, heading)

    def dock(self, cairn: _Cairn) -> None:
        self.docks[self.called(cairn, self.docks)] = cairn.pose, cairn.line

    def called(self, cairn: _Cairn, known: Mapping[str, object]) -> str:
        """A cairn's name, with a number if it is in `known`."""
        own = name = cairn.name or cairn.kind
        while name in known:
            self.named[own] += 1
            name = f"{own}-{self.named[own] + 1}"
        return name

    def forbid(self, cairn: _Cairn) -> None:
        x1, y1, x2, y2 = _metres(_count(cairn.rest, 4, "X1 Y1 X2 Y2 in mm after the name"))
        c, s = cos(cairn.pose[2]), sin(cairn.pose[2])
        corners = [(x1, y1), (x2, y1), (x2, y2), (x1, y2), (x1, y1)]
        if cairn.kind == "ForbiddenLine":
            corners = [(x1, y1), (x2, y2)]
        turned = [(x * c - y * s, x * s + y * c) for x, y in corners]
        self.forbidden += [(*a, *b) for a, b in pairwise(turned)]

    def room(self, cairn: _Cairn) -> None:
        x1, y1, x2, y2 = _metres(_count(cairn.rest, 4, "X1 Y1 X2 Y2 in mm after the name"))
        if cairn.pose[2] != 0.0:
            raise ConfigError(f"room {cairn.name!r} is turned; expected 0 degrees")
        if x1 >= x2 or y1 >= y2:
            raise ConfigError(f"room {cairn.name!r}: expected X1 < X2 and Y1 < Y2")
        _refuse_twice(cairn, self.rooms)
        self.rooms[cairn.name] = Room(cairn.name, x1, y1, x2, y2)

    def door(self, cairn: _Cairn) -> None:
        rooms = cairn.description.split()
        if len(rooms) != 2:
            raise ConfigError(
                f"door {cairn.name!r}: the description is {cairn.description!r}; "
                'expected its two rooms, "A corridor"'
            )
        _refuse_twice(cairn, self.doors)
        door = Door(cairn.name, rooms[0], rooms[1], cairn.pose[0], cairn.pose[1])
        self.doors[cairn.name] = door, cairn.line

    def column(self, cairn: _Cairn) -> None:
        (radius,) = _metres([cairn.description])
        if radius <= 0.0:
            raise ConfigError(f"{cairn.description!r} mm: expected a radius above 0")
        self.columns.append((*cairn.pose[:2], radius))

    def finish(self, name: str, file: Path | str) -> World:
        for source, (announced, number) in self.announced.items():
            there = self.counted[source]
            if announced != there:
                message = f"{source}NumLines: {announced}: expected {there}, the number of LINES"
                raise ConfigError(message, file, number)
        for door, number in self.doors.values():
            try:
                check_door(door, self.rooms)
            except ConfigError as error:
                raise error.at(file, number) from None
        try:
            walls = tuple(self.walls) if self.walls else self._of_points()
        except ConfigError as error:
            raise error.at(file) from None
        docks = {dock: pose for dock, (pose, _) in self.docks.items()}
        doors = tuple(door for door, _ in self.doors.values())
        rooms = tuple(self.rooms.values())
        forbidden = tuple(self.forbidden)
        columns = tuple(self.columns)
        around = tuple((x - r, y - r, x + r, y + r) for x, y, r in columns)
        bounds = self._bounds(walls + forbidden + around)
        world = World(
            *(name, walls, bounds, self.start, self.goals, rooms, doors, forbidden, docks, columns),
            solid=bool(walls) and not self.walls,
        )
        for dock, (pose, number) in self.docks.items():
            try:
                check_dock(dock, pose, world)
            except ConfigError as error:
                raise error.at(file, number) from None
        return world

    def _of_points(self) -> tuple[Segment, ...]:
        """The borders of the cells with a point. Raises ConfigError if there are too many cells."""
        if not self.points:
            return ()
        import numpy as np

        from armadico.config.occupancy import MAX_PIXELS, Raster, world_of

        cells = np.rint(np.array(self.points) / self.cell_m).astype(np.int64)
        low = cells.min(axis=0) - 1
        columns, rows = cells.max(axis=0) - low + 2
        if columns * rows > MAX_PIXELS:
            wide = f"{columns * self.cell_m:.0f} m x {rows * self.cell_m:.0f} m"
            raise ConfigError(f"the points cover {wide}: expected at most {MAX_PIXELS:,} cells")
        occupied = np.zeros((rows, columns), dtype=np.bool_)
        occupied[cells[:, 1] - low[1], cells[:, 0] - low[0]] = True
        x, y = ((low - 0.5) * self.cell_m).tolist()
        return world_of(Raster(occupied, ~occupied, self.cell_m, (x, y, 0.0)), "").walls

    def _bounds(self, walls: tuple[Segment, ...]) -> Segment:
        """The rectangle around the header's corners and the walls."""
        corners = [tuple(self.corners[i : i + 2]) for i in range(0, len(self.corners), 2)]
        points = tuple((x, y, x, y) for x, y in corners)
        return hull(points + walls)


CAIRNS: dict[str, Callable[[_Reader, _Cairn], None]] = {
    "RobotHome": _Reader.home,
    "Goal": _Reader.goal,
    "GoalWithHeading": _Reader.goal,
    "StandbyGoal": _Reader.goal,
    "StandbyGoalWithHeading": _Reader.goal,
    "Dock": _Reader.dock,
    "DockPioneer": _Reader.dock,
    "ForbiddenArea": _Reader.forbid,
    "ForbiddenLine": _Reader.forbid,
    "ArmadicoRoom": _Reader.room,
    "ArmadicoDoor": _Reader.door,
    "ArmadicoColumn": _Reader.column,
}
"""The method that reads each type of cairn."""


def _metres(words: Sequence[str]) -> list[float]:
    metres = [_number(word) / 1000.0 for word in words]
    for word, value in zip(words, metres, strict=True):
        if abs(value) > LIMIT_M:
            raise ConfigError(f"{word}: expected millimetres within {LIMIT_M:g} m")
    return metres


def _number(word: str) -> float:
    try:
        value = float(word)
    except ValueError:
        raise ConfigError(f"{word!r}: expected a number") from None
    if not isfinite(value):
        raise ConfigError(f"{word!r}: expected a finite number")
    return value


def _count(words: list[str], count: int, expected: str) -> list[str]:
    if len(words) < count:
        raise ConfigError(f"{' '.join(words)!r}: expected {expected}")
    return words[:count]


def _code(line: str) -> str:
    """A line without its comment."""
    found = _CODE.match(line)
    return found[0].strip() if found is not None else ""


def _refuse_twice(cairn: _Cairn, known: Mapping[str, object]) -> None:
    if cairn.name in known:
        raise ConfigError(f"a second {cairn.kind} {cairn.name!r}; expected another name")
