"""Occupancy grids of unknown, free and occupied cells: messages and files.

In a message the cells are deflated, one byte each: 1,000 x 1,000 cells of a building take 5 to
20 kB. A grid that is too large for a message gets larger cells until it fits. Files are those of a
ROS map_server (`.yaml` and `.pgm`), which hold the whole grid, and ARIA's `.map`, which holds the
borders of the occupied cells.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Protocol

import numpy as np
import yaml
from numpy.typing import NDArray

from armadico.config.mapwriter import format_map
from armadico.config.occupancy import (
    MAX_WALLS,
    Raster,
    read_raster,
    walls_in,
    world_of,
)
from armadico.config.worlds import Segment, World
from armadico.config.writing import held, write_files, written_first
from armadico.core.config_errors import ConfigError
from armadico.core.discovery import MAPPERS, find
from armadico.mobile.messages import Echo, OccupancyGrid, Pose, Scan

States = NDArray[np.uint8]

UNKNOWN, FREE, OCCUPIED = 0, 1, 2
"""The states of a cell."""

PACKED_MOST: Final = 60_000
"""Most bytes of cells in a message, which leaves room for its other fields."""

CELLS_MOST: Final = 16_000_000
"""Most cells that are unpacked: 200 m x 200 m in cells of 5 cm."""

CELLS_M: Final = (0.01, 1.0)
"""Sizes of cells with which mapping can continue: smaller ones would fill the memory, larger ones
hide doors."""

PIXELS: Final = np.array([205, 254, 0], dtype=np.uint8)
"""Grey by state, as map_saver writes it."""

SUFFIXES: Final = (".yaml", ".yml", ".map")
"""Files that a grid is saved as."""


@dataclass(frozen=True)
class Cells:
    """A grid in the world: rows along y, columns along x, from the lower left corner at (x, y)."""

    x: float
    y: float
    cell_m: float
    states: States

    @property
    def bounds(self) -> Segment:
        """The covered rectangle, m."""
        rows, columns = self.states.shape
        return self.x, self.y, self.x + columns * self.cell_m, self.y + rows * self.cell_m

    def area(self, state: int) -> float:
        """The area of the cells in a state, m^2."""
        return float(np.count_nonzero(self.states == state)) * self.cell_m**2

    def at(self, x: float, y: float) -> int:
        """The state at a point, m; unknown outside."""
        row, column = int((y - self.y) // self.cell_m), int((x - self.x) // self.cell_m)
        rows, columns = self.states.shape
        if not (0 <= row < rows and 0 <= column < columns):
            return UNKNOWN
        return int(self.states[row, column])

    def world(self, name: str) -> World:
        """A world with the occupied cells as walls."""
        occupied, free = self.states == OCCUPIED, self.states == FREE
        return world_of(Raster(occupied, free, self.cell_m, (self.x, self.y, 0.0)), name)


NOTHING: Final = Cells(0.0, 0.0, 0.05, np.zeros((0, 0), dtype=np.uint8))
"""A grid without cells."""


class Mapper(Protocol):
    """Makes a grid from readings at known poses; the entry point `grid` of `armadico.mappers`."""

    @property
    def full(self) -> bool:
        """Whether readings were omitted because the map would be too large."""

    def see(self, pose: Pose, scan: Scan) -> None:
        """Add a scan of a robot at a pose in the world."""

    def add(self, pose: Pose, echo: Echo) -> None:
        """Add one ping of a sonar."""

    def stand(self, pose: Pose, corners: Sequence[tuple[float, float]]) -> None:
        """Add the footprint, by its corners in the robot's frame, as free."""

    def settle(self) -> None:
        """End a session: readings of a later one may soon change what this one has found."""

    def cells(self) -> Cells:
        """The grid so far."""


def new_mapper(half_cone: float = 0.0) -> Mapper:
    """The installed mapper, with an empty grid, for sonars of half a cone (rad)."""
    mapper: Mapper = find(MAPPERS, "grid").load()(half_cone)
    return mapper


def message_of(cells: Cells, revision: int = 0, map_id: int = 0) -> OccupancyGrid:
    """The grid as a message, with larger cells if needed."""
    while (
        cells.states.size > CELLS_MOST
        or len(packed := zlib.compress(cells.states.tobytes(), 6)) > PACKED_MOST
    ):
        cells = coarser(cells)
    rows, columns = cells.states.shape
    shape = cells.cell_m, rows, columns
    return OccupancyGrid(cells.x, cells.y, *shape, packed, revision, map_id)


def cells_of(message: OccupancyGrid) -> Cells:
    """The grid of a message. Raises ValueError if it is invalid or too large."""
    count = message.rows * message.columns
    if count > CELLS_MOST:
        raise ValueError(f"{count:,} cells; expected at most {CELLS_MOST:,}")
    if message.cell < CELLS_M[0]:
        raise ValueError(f"cells of {message.cell:g} m; expected at least {CELLS_M[0]:g} m")
    inflater = zlib.decompressobj()
    try:
        plain = inflater.decompress(message.packed, count + 1)  # bounds the memory
    except zlib.error as error:
        raise ValueError(f"its cells are not deflated: {error}") from None
    states = np.frombuffer(plain, dtype=np.uint8)
    if len(states) != count or (count and states.max() > OCCUPIED):
        raise ValueError(f"expected {message.rows} x {message.columns} cells")
    states = states.reshape(message.rows, message.columns)
    if (walls := walls_in(states == OCCUPIED)) > MAX_WALLS:
        raise ValueError(f"cells with {walls:,} borders; expected at most {MAX_WALLS:,}")
    return Cells(message.x, message.y, message.cell, states)


def coarser(cells: Cells) -> Cells:
    """The grid with cells twice as large: occupied if any part is, else unknown if any is."""
    rows, columns = cells.states.shape
    even = np.pad(cells.states, ((0, rows % 2), (0, columns % 2)))
    blocks = even.reshape((rows + 1) // 2, 2, (columns + 1) // 2, 2)
    states = np.where((blocks == OCCUPIED).any(axis=(1, 3)), OCCUPIED, blocks.min(axis=(1, 3)))
    return Cells(cells.x, cells.y, 2.0 * cells.cell_m, states.astype(np.uint8))


def check_suffix(path: Path) -> None:
    """Raises ConfigError for a file name that is not of a map."""
    if path.suffix not in SUFFIXES:
        expected = "expected .yaml (a ROS map_server's, with a .pgm beside it) or .map (ARIA's)"
        raise ConfigError(f"{path}: {expected}")
    try:
        path.name.encode()
    except UnicodeEncodeError:
        raise ConfigError(f"{str(path)!r}: expected a name in UTF-8, for its image") from None


def save(cells: Cells, path: Path, more: Mapping[Path, bytes] | None = None) -> list[Path]:
    """Save a grid in the format of the suffix; returns the files. Raises ConfigError, OSError.

    Existing files are replaced only when all new ones are on the disk, `more` among them, and not
    while another process holds the map.
    """
    check_suffix(path)
    with held(path, alone=True):
        return _saved(cells, path, more)


def _saved(cells: Cells, path: Path, more: Mapping[Path, bytes] | None) -> list[Path]:
    if path.suffix == ".map":
        comments = ("Made by driving; the borders of occupied cells.",)
        files = {path: format_map(cells.world(path.stem), comments).encode(), **(more or {})}
        write_files(files)
        return [*files]
    image = path.with_suffix(".pgm")
    rows, columns = cells.states.shape
    pixels = PIXELS[np.flipud(cells.states)]
    about = {
        "image": image.name,
        "resolution": float(f"{cells.cell_m:.6g}"),
        "origin": [round(cells.x, 6), round(cells.y, 6), 0.0],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
    }
    text = yaml.safe_dump(about, sort_keys=False, default_flow_style=None, allow_unicode=True)
    head = f"P5\n{columns} {rows}\n255\n"
    files = {path: text.encode(), image: head.encode() + pixels.tobytes(), **(more or {})}
    write_files(files)
    return [*files]


def check_writable(path: Path) -> None:
    """Raises OSError if `save` could not write there now."""
    for file in (path,) if path.suffix == ".map" else (path, path.with_suffix(".pgm")):
        new = written_first(file)
        new.open("wb").close()
        new.unlink()


def read(path: Path | str) -> Cells:
    """A grid from a map_server's files, to continue mapping. Raises ConfigError."""
    raster = read_raster(path)
    x, y, turned = raster.origin
    if turned:
        raise ConfigError(f"origin: turned by {turned:g} rad; expected 0", Path(path))
    least, most = CELLS_M
    if not least <= raster.cell_m <= most:
        fault = f"resolution: {raster.cell_m:g}: expected {least:g} to {most:g} m"
        raise ConfigError(fault, Path(path))
    states = np.where(raster.occupied, OCCUPIED, np.where(raster.free, FREE, UNKNOWN))
    return Cells(x, y, raster.cell_m, states.astype(np.uint8))
