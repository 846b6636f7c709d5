"""How likely a laser's ranges are at a pose on a known map, for many poses at once.

The likelihood field of Thrun, Burgard and Fox, *Probabilistic Robotics*, section 6.4: a ray ends
near a wall of the map, or at random. Rays are narrow and come back from all that is not dark, so
there are neither cones nor mirrors here; and neighbours tell nearly the same, so a few of each scan
are weighed. A ray that found nothing tells little: it is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from armadico.agents.localization.sonar_model import Poses
from armadico.agents.methods.grid import Grid
from armadico.mobile.messages import Echo, Scan
from armadico.mobile.scans import ranges_of

Floats = NDArray[np.float32]

BEAMS: Final = 36
"""Rays of a scan that are weighed."""

HIT_M: Final = 0.1
"""Standard deviation of a ray's end about the map: the cells' size, the range's noise, the map's
own errors. Chosen on logs of real robots: with 0.06 the particles settle on a place half a metre
along a corridor when they come back from where the map ends."""

CELL_M: Final = 0.025
"""Of the field: its steps are what a pose is off by."""

LARGE: Final = 1_000_000
"""Cells of a map from which on its own will do: four times as many would take 100 MB and more."""

RIM_M: Final = 0.5
"""So far the field goes on beyond the map: half of the ends at a wall on its edge lie outside."""

COARSE_M: Final = 0.3
"""The same for guesses that are that far apart."""

HIT, RANDOM = 0.9, 0.1
"""Shares of ends at walls of the map, and anywhere."""

WIDE: Final = 400_000
"""Ends that are worked out at once: what the processor's caches hold."""


def beams_of(scan: Scan, most: int = BEAMS) -> list[Echo]:
    """Some of a scan's rays that met something, evenly spread among those; each scan others.

    Raises ValueError if its bytes are no ranges.
    """
    ranges = ranges_of(scan)
    met = np.flatnonzero(np.isfinite(ranges))
    step = max(1, -(-len(met) // most))
    first = scan.number * 7 % step  # which of each few; 7: neighbours in time are none in space
    return [
        Echo(scan.x, scan.y, scan.bearing + scan.step * ray, float(ranges[ray]))
        for ray in met[first::step].tolist()
    ]


class LaserModel:
    """The likelihood of ranges, by a map's clearances."""

    def __init__(self, grid: Grid) -> None:
        """Prepare.

        Args:
            grid: The map: the clearance of each of its cells.
        """
        west, south, east, north = grid.bounds
        beyond = west - RIM_M, south - RIM_M, east + RIM_M, north + RIM_M
        fine = grid.clearance.size <= LARGE
        walls = [(x1, y1, x2, y2) for x1, y1, x2, y2 in grid.walls.tolist()]
        grid = Grid(walls, beyond, min(CELL_M, grid.cell_m) if fine else grid.cell_m)
        clearance = grid.clearance.astype(np.float32)
        self._fine, self._coarse = (
            (HIT * np.exp(-0.5 * (clearance / np.float32(width)) ** 2) + RANDOM)
            .astype(np.float32)
            .ravel()
            for width in (HIT_M, COARSE_M)
        )
        self._rows, self._columns = clearance.shape
        self._west, self._south = (np.float32(low) for low in grid.bounds[:2])
        self._inverse = np.float32(1.0 / grid.cell_m)

    def likelihood(
        self,
        poses: Poses,
        echoes: Sequence[Echo],
        *,
        coarse: bool = False,
        excused: bool = False,  # noqa: ARG002 - the field does not tell what is nearer
    ) -> Floats:
        """The likelihood of each range at each pose, (poses, echoes); see `Model`."""
        ahead, left = _ends(echoes)
        field = self._coarse if coarse else self._fine
        found = np.empty((len(poses), len(echoes)), dtype=np.float32)
        together = max(1, WIDE // max(1, len(echoes)))
        for begin in range(0, len(poses), together):
            part = poses[begin : begin + together]
            x, y = part[:, 0, None] - self._west, part[:, 1, None] - self._south
            c, s = np.cos(part[:, 2, None]), np.sin(part[:, 2, None])
            column = ((x + (c * ahead - s * left)) * self._inverse).astype(np.int32)
            row = ((y + (s * ahead + c * left)) * self._inverse).astype(np.int32)
            np.clip(column, 0, self._columns - 1, out=column)  # the rim is nowhere
            np.clip(row, 0, self._rows - 1, out=row)
            row *= self._columns
            row += column
            np.take(field, row, out=found[begin : begin + together])
        return found


def _ends(echoes: Sequence[Echo]) -> tuple[Floats, Floats]:
    """Where each ray ends in the body frame, m."""
    ends = [
        (e.x + reach * np.cos(e.bearing), e.y + reach * np.sin(e.bearing))
        for e in echoes
        if (reach := e.range) is not None
    ]
    found = np.array(ends, dtype=np.float32).reshape(-1, 2)
    return found[:, 0], found[:, 1]
