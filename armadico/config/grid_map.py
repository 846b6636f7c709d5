"""Occupancy grids: cells that are unknown, free or occupied; how they travel, and files of them.

As bytes the cells are deflated, a byte each: 1,000 x 1,000 cells of a building take 5 to 20 kB. A
grid that is still too large for a message is made of larger cells until it fits, so there is always
something to be seen. Files are those of a ROS map_server (`.yaml` and `.pgm`), which hold all of
it, and ARIA's `.map`, which holds the borders of what is occupied.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import yaml
from numpy.typing import NDArray

from armadico.config.errors import ConfigError
from armadico.config.mapwriter import format_map
from armadico.config.occupancy import (
    MAX_WALLS,
    Raster,
    read_raster,
    walls_in,
    world_of,
)
from armadico.config.worlds import Segment, World
from armadico.config.writing import write_files, written_first
from armadico.mobile.messages import OccupancyGrid

States = NDArray[np.uint8]

UNKNOWN, FREE, OCCUPIED = 0, 1, 2
"""What a cell is."""

PACKED_MOST: Final = 60_000
"""Bytes of cells in one message: what else is in it fits beside them."""

CELLS_MOST: Final = 16_000_000
"""What is more than this is not unpacked: 200 m x 200 m in cells of 5 cm."""

CELLS_M: Final = (0.01, 1.0)
"""Cells in which a map can be gone on with: smaller ones would fill the memory, larger ones hide
doors."""

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
        """The rectangle that it covers, m."""
        rows, columns = self.states.shape
        return self.x, self.y, self.x + columns * self.cell_m, self.y + rows * self.cell_m

    def area(self, state: int) -> float:
        """How much is in a state, m^2."""
        return float(np.count_nonzero(self.states == state)) * self.cell_m**2

    def at(self, x: float, y: float) -> int:
        """The state at a place; unknown outside."""
        row, column = int((y - self.y) // self.cell_m), int((x - self.x) // self.cell_m)
        rows, columns = self.states.shape
        if not (0 <= row < rows and 0 <= column < columns):
            return UNKNOWN
        return int(self.states[row, column])

    def world(self, name: str) -> World:
        """Its occupied cells as walls."""
        occupied, free = self.states == OCCUPIED, self.states == FREE
        return world_of(Raster(occupied, free, self.cell_m, (self.x, self.y, 0.0)), name)


NOTHING: Final = Cells(0.0, 0.0, 0.05, np.zeros((0, 0), dtype=np.uint8))
"""A grid without cells."""


def message_of(cells: Cells, revision: int = 0) -> OccupancyGrid:
    """The grid as a message, in larger cells if it does not fit otherwise."""
    while (
        cells.states.size > CELLS_MOST
        or len(packed := zlib.compress(cells.states.tobytes(), 6)) > PACKED_MOST
    ):
        cells = coarser(cells)
    rows, columns = cells.states.shape
    return OccupancyGrid(cells.x, cells.y, cells.cell_m, rows, columns, packed, revision)


def cells_of(message: OccupancyGrid) -> Cells:
    """The grid in a message. Raises ValueError if it is none that a map could be made of."""
    count = message.rows * message.columns
    if count > CELLS_MOST:
        raise ValueError(f"{count:,} cells, at most {CELLS_MOST:,} are read")
    if message.cell < CELLS_M[0]:
        raise ValueError(f"cells of {message.cell:g} m, at least {CELLS_M[0]:g} m are read")
    inflater = zlib.decompressobj()
    try:
        plain = inflater.decompress(message.packed, count + 1)  # and no more, whatever it holds
    except zlib.error as error:
        raise ValueError(f"its cells are not deflated: {error}") from None
    states = np.frombuffer(plain, dtype=np.uint8)
    if len(states) != count or (count and states.max() > OCCUPIED):
        raise ValueError(f"not {message.rows} x {message.columns} cells")
    states = states.reshape(message.rows, message.columns)
    if (walls := walls_in(states == OCCUPIED)) > MAX_WALLS:
        raise ValueError(f"cells with {walls:,} borders, at most {MAX_WALLS:,} are read")
    return Cells(message.x, message.y, message.cell, states)


def coarser(cells: Cells) -> Cells:
    """The same in cells twice as large: occupied if any is, else unknown if any is."""
    rows, columns = cells.states.shape
    even = np.pad(cells.states, ((0, rows % 2), (0, columns % 2)))
    blocks = even.reshape((rows + 1) // 2, 2, (columns + 1) // 2, 2)
    states = np.where((blocks == OCCUPIED).any(axis=(1, 3)), OCCUPIED, blocks.min(axis=(1, 3)))
    return Cells(cells.x, cells.y, 2.0 * cells.cell_m, states.astype(np.uint8))


def check_suffix(path: Path) -> None:
    """Raises ConfigError for a file whose name does not say what kind of map it is."""
    if path.suffix not in SUFFIXES:
        expected = "expected .yaml (a ROS map_server's, with a .pgm beside it) or .map (ARIA's)"
        raise ConfigError(f"{path}: {expected}")
    try:
        path.name.encode()
    except UnicodeEncodeError:
        fault = "a name that is no UTF-8; what names its image could not be written"
        raise ConfigError(f"{str(path)!r}: {fault}") from None


def save(cells: Cells, path: Path) -> list[Path]:
    """Write a grid as its file's suffix says; the files written. Raises ConfigError, OSError.

    What was there before stays as it was until all of the new is on the disk.
    """
    check_suffix(path)
    if path.suffix == ".map":
        comments = ("Made by driving; the borders of what echoes.",)
        write_files({path: format_map(cells.world(path.stem), comments).encode()})
        return [path]
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
    write_files({path: text.encode(), image: head.encode() + pixels.tobytes()})
    return [path, image]


def check_writable(path: Path) -> None:
    """Whether `save` could write there now. Raises OSError."""
    for file in (path,) if path.suffix == ".map" else (path, path.with_suffix(".pgm")):
        new = written_first(file)
        new.open("wb").close()
        new.unlink()


def read(path: Path | str) -> Cells:
    """A grid that was saved as a map_server's. Raises ConfigError."""
    raster = read_raster(path)
    x, y, turned = raster.origin
    if turned:
        raise ConfigError(f"origin: turned by {turned:g} rad; a grid goes on unturned", Path(path))
    least, most = CELLS_M
    if not least <= raster.cell_m <= most:
        fault = f"resolution: {raster.cell_m:g}: a grid goes on in cells of {least:g} to {most:g} m"
        raise ConfigError(fault, Path(path))
    states = np.where(raster.occupied, OCCUPIED, np.where(raster.free, FREE, UNKNOWN))
    return Cells(x, y, raster.cell_m, states.astype(np.uint8))
