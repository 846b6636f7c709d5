"""The worlds of the BARN challenge, and its score.

`maps/barn.txt` has 250 of its 300 worlds: all except every sixth, 0, 6, ... 294, which the public
test uses. A line has a world's number, the length of the challenge's reference path (m), and the
occupied cells of the field, 30 rows of 30 from the lower left corner, as bits in base64. A file of
worlds may also be JSON: a list of `{"world": 1, "cylinders": [[x, y], ...], "path_length": 11.9}`.

Frame: the challenge's (Gazebo's); m. Sources: Perille, Truong, Xiao and Stone, "Benchmarking Metric
Ground Navigation", SSRR 2020; the rule is `run.py` of github Daffan/the-barn-challenge (MIT).
"""

from __future__ import annotations

from base64 import b64decode
from binascii import Error as Base64Error
from math import isfinite
from pathlib import Path
from typing import Annotated, Final

import msgspec
from msgspec import Meta, Struct

from armadico.config.loading import read_text
from armadico.config.worlds import Column, World
from armadico.core.config_errors import ConfigError

SHIPPED: Final = Path(__file__).with_name("maps") / "barn.txt"

RADIUS_M: Final = 0.075
CELL_M: Final = 0.15
ROWS: Final = 30
CORNER: Final = (-4.425, 5.175)
"""The middle of the lower left cell."""

BELOW: Final = 34
"""Rows of the fence below the cells: the lane where the robot starts."""

START: Final = (-2.25, 3.0, 90.0)
GOAL: Final = (-2.25, 13.0, 90.0)
REACHED_M: Final = 1.0
STARTED_M: Final = 0.1
LIMIT_S: Final = 100.0
TOP_M_S: Final = 2.0
"""The optimal time is that of the reference path at this speed."""

CLIPS: Final = (2.0, 4.0)
"""Least time that counts, in optimal times: since 2024, and before."""


class BarnWorld(Struct, frozen=True):
    """One world: its cylinders, and the length of its reference path, m."""

    number: int
    cylinders: tuple[tuple[float, float], ...]
    path_m: float

    def score(self, seconds: float | None, clip: float = CLIPS[0]) -> float:
        """The score for a time, s; None: the goal was not reached."""
        if seconds is None:
            return 0.0
        optimal = self.path_m / TOP_M_S
        return optimal / min(max(seconds, clip * optimal), 8.0 * optimal)

    def world(self) -> World:
        """The world of the robot."""
        columns: tuple[Column, ...] = tuple((x, y, RADIUS_M) for x, y in self.cylinders)
        bounds = (-4.5, 0.0, 0.0, 14.0)
        return World(f"barn-{self.number}", (), bounds, columns=columns)


class _Listed(Struct):
    """A world in JSON."""

    world: Annotated[int, Meta(ge=0)]
    cylinders: list[tuple[float, float]]
    path_length: Annotated[float, Meta(gt=0, le=1e4)]


def read_worlds(path: Path = SHIPPED) -> dict[int, BarnWorld]:
    """The worlds of a file by their numbers. Raises ConfigError."""
    text = read_text(path)
    found = _of_json(text, path) if text.lstrip().startswith("[") else _of_lines(text, path)
    worlds: dict[int, BarnWorld] = {}
    for world in found:
        if world.number in worlds:
            raise ConfigError(f"world {world.number} is defined twice", path)
        if not all(isfinite(x) and isfinite(y) for x, y in world.cylinders):
            raise ConfigError(f"world {world.number}: a cylinder's position is not finite", path)
        worlds[world.number] = world
    if not worlds:
        raise ConfigError("the file has no worlds", path)
    return dict(sorted(worlds.items()))


def _cell(row: int, column: int) -> tuple[float, float]:
    x, y = CORNER
    return round(x + column * CELL_M, 3), round(y + row * CELL_M, 3)


FENCE: Final = (
    *(_cell(row, column) for row in range(-BELOW, 0) for column in (0, ROWS - 1)),
    *(_cell(-BELOW, column) for column in range(1, ROWS - 1)),
)
"""Cylinders below the cells in every world: the sides and the end of the lane."""


def _of_lines(text: str, path: Path) -> list[BarnWorld]:
    worlds = []
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip() or line.startswith("#"):
            continue
        try:
            name, length, data = line.split()
            bits = int.from_bytes(b64decode(data, validate=True), "little")
            path_m = float(length)
            if bits >> ROWS * ROWS or not 0.0 < path_m <= 1e4:
                raise ValueError
            cells = [_cell(*divmod(k, ROWS)) for k in range(ROWS * ROWS) if bits >> k & 1]
            worlds.append(BarnWorld(int(name), (*FENCE, *cells), path_m))
        except (ValueError, Base64Error):
            raise ConfigError(
                "expected NUMBER METRES CELLS, the cells in base64", path, number
            ) from None
    return worlds


def _of_json(text: str, path: Path) -> list[BarnWorld]:
    try:
        listed = msgspec.json.decode(text, type=list[_Listed])
    except msgspec.DecodeError as error:
        raise ConfigError(f"not a list of worlds: {error}", path) from None
    return [BarnWorld(one.world, tuple(one.cylinders), one.path_length) for one in listed]
