"""Pictures of a map: its path, its loops and where it contradicts itself; and what has changed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from armadico.agents.slam.slam import Slam
from armadico.cli.options import FailedError
from armadico.config.grid_map import FREE, OCCUPIED, UNKNOWN, Cells

SIZE: Final = 1600
"""Pixels along the longer side, about."""

SHADES: Final = np.array([190, 255, 0], dtype=np.uint8)
PATH: Final = (40, 110, 200)
LOOP: Final = (40, 160, 80)
OFF: Final = (210, 60, 50)
START: Final = (230, 140, 0)
DOUBT: Final = (200, 0, 160)


def picture(cells: Cells, slam: Slam) -> Image.Image:
    """The grid with the path (blue), loops (green, red if switched off) and the start (orange).

    Walls that other scans looked through are marked in magenta, with a circle around each place.
    """
    shades = np.flipud(SHADES[np.where(cells.states == OCCUPIED, 2, cells.states == FREE)])
    grid = Image.fromarray(shades)
    corner = np.array([cells.x, cells.y])
    # The grid has a largest size; the path and doubtful places may be beyond it.
    places = np.vstack(
        [slam.map.poses[:, :2], *(place.cells for place in slam.evidence.contradictions)]
    )
    end = corner + cells.cell_m * np.array(grid.size)
    every = np.vstack([places, corner, end])
    west, south = every.min(axis=0).tolist()
    wide, tall = (np.ptp(every, axis=0) / cells.cell_m).tolist()
    factor = SIZE / max(wide, tall)
    scale, height = factor / cells.cell_m, max(1, round(tall * factor))
    image = Image.new("RGB", (max(1, round(wide * factor)), height), (int(SHADES[0]),) * 3)
    size = max(1, round(grid.width * factor)), max(1, round(grid.height * factor))
    left, top = round((cells.x - west) * scale), height - round((cells.y - south) * scale) - size[1]
    image.paste(grid.resize(size, Image.Resampling.BOX).convert("RGB"), (left, top))

    def spot(x: float, y: float) -> tuple[float, float]:
        return (x - west) * scale, height - (y - south) * scale

    spots = [spot(x, y) for x, y, _ in slam.map.poses.tolist()]
    draw = ImageDraw.Draw(image)
    if len(spots) > 1:
        draw.line(spots, fill=PATH, width=2)
    for loop, off in zip(slam.map.loops, slam.map.switched_off, strict=True):
        ends = [spots[loop.start], spots[loop.end]]
        draw.line(ends, fill=OFF if off else LOOP, width=1)
    for place in slam.evidence.contradictions:
        for x, y in (spot(*cell) for cell in place.cells.tolist()):
            draw.rectangle((x - 2, y - 2, x + 2, y + 2), fill=DOUBT)
        x, y = spot(place.x, place.y)
        far = 10.0 + scale * float(np.hypot(*(place.cells - [place.x, place.y]).T).max())
        draw.ellipse((x - far, y - far, x + far, y + far), outline=DOUBT, width=3)
    x, y = spots[0]
    draw.ellipse((x - 5, y - 5, x + 5, y + 5), fill=START)
    return image


def save(cells: Cells, slam: Slam, path: Path) -> None:
    """Write the picture as a PNG. Raises OSError."""
    picture(cells, slam).save(path, format="PNG")


# What has changed ---------------------------------------------------------------------------------

NEW: Final = (20, 90, 230)
GONE: Final = (225, 60, 40)
FIRST: Final = (205, 235, 205)
NEAR: Final = 3
"""Cells: an occupied cell so near in the other grid is the same wall, which neither is exact of."""


@dataclass(frozen=True)
class Changed:
    """What one session saw otherwise than those before it."""

    image: Image.Image
    new: float  # m^2 that are occupied and were free
    gone: float  # m^2 that are free and were occupied
    first: float  # m^2 that were unknown


def changed(before: Cells, after: Cells, every: Cells) -> Changed:
    """The joined grid, with what is new (blue), gone (red) and seen for the first time (green).

    A cell counts if both the earlier sessions and the later one have seen it, and no wall of the
    other is within 0.15 m.
    """
    was, now, states = _laid([before, after, every])
    new = (now == OCCUPIED) & (was == FREE) & ~_wider(was == OCCUPIED)
    gone = (was == OCCUPIED) & (now == FREE) & ~_wider(now == OCCUPIED)
    first = (was == UNKNOWN) & (now != UNKNOWN)
    colours = np.repeat(SHADES[np.where(states == OCCUPIED, 2, states == FREE)][..., None], 3, 2)
    colours[first & (states == FREE)] = FIRST
    colours[_wider(gone, 1) & (states != OCCUPIED)] = GONE  # a single cell is hard to see
    colours[_wider(new, 1)] = NEW
    grid = Image.fromarray(np.flipud(colours).copy())
    factor = max(1, SIZE // max(grid.size))
    grid = grid.resize((grid.width * factor, grid.height * factor), Image.Resampling.NEAREST)
    rows = (
        ((0, 0, 0), "wall"),
        (NEW, "new: stands where it was free"),
        (GONE, "gone: free where something stood"),
        (FIRST, "seen for the first time"),
        ((int(SHADES[0]),) * 3, "unknown"),
    )
    area = every.cell_m**2
    counts = (float(np.count_nonzero(one)) * area for one in (new, gone, first))
    return Changed(_with_legend(grid, rows), *counts)


def _laid(grids: Sequence[Cells]) -> list[NDArray[np.uint8]]:
    """Grids with cells of one size on one another, unknown where one has no cells."""
    size = grids[0].cell_m
    places = [(round(one.y / size), round(one.x / size), *one.states.shape) for one in grids]
    low, left = (min(place[axis] for place in places) for axis in (0, 1))
    rows = max(row + height for row, _, height, _ in places) - low
    columns = max(column + width for _, column, _, width in places) - left
    laid = []
    for one, (row, column, height, width) in zip(grids, places, strict=True):
        wide = np.full((rows, columns), UNKNOWN, dtype=np.uint8)
        wide[row - low : row - low + height, column - left : column - left + width] = one.states
        laid.append(wide)
    return laid


def _wider(cells: NDArray[np.bool_], by: int = NEAR) -> NDArray[np.bool_]:
    """Cells with one within a square of so many cells to each side."""
    found = cells.copy()
    for axis in (0, 1):
        once = found.copy()
        for step in range(1, by + 1):
            ahead, behind = [slice(None)] * 2, [slice(None)] * 2
            ahead[axis], behind[axis] = slice(step, None), slice(None, -step)
            found[tuple(ahead)] |= once[tuple(behind)]
            found[tuple(behind)] |= once[tuple(ahead)]
    return found


def _with_legend(
    grid: Image.Image, rows: Sequence[tuple[tuple[int, int, int], str]]
) -> Image.Image:
    """A picture with the meaning of its colours below it."""
    line, edge = 26, 12
    wide = max(grid.width, 320)
    image = Image.new("RGB", (wide, grid.height + 2 * edge + line * len(rows)), (255, 255, 255))
    image.paste(grid, (0, 0))
    draw = ImageDraw.Draw(image)
    font = ImageFont.load_default(16)
    for number, (colour, text) in enumerate(rows):
        top = grid.height + edge + line * number
        draw.rectangle((edge, top, edge + 28, top + 18), fill=colour, outline=(90, 90, 90))
        draw.text((edge + 40, top - 1), text, fill=(0, 0, 0), font=font)
    return image


def check(path: Path | None) -> None:
    """Raises FailedError if a picture could not be written to a path."""
    if path is not None and not path.resolve().parent.is_dir():
        raise FailedError(f"cannot write {path}: there is no such folder")
