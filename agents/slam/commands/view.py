"""The picture of a map: the grid, the path, the loops and where it contradicts itself."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
from PIL import Image, ImageDraw

from armadico.agents.slam.slam import Slam
from armadico.config.grid_map import FREE, OCCUPIED, Cells

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
