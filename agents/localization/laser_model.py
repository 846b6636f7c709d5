"""The likelihood of a laser's ranges at poses on a known map, for many poses at once.

The likelihood field of Thrun, Burgard and Fox, *Probabilistic Robotics*, section 6.4: a ray ends
near a wall of the map, or at random. Rays are narrow and return from all surfaces that are not
dark, so neither cones nor mirrors are modelled. Neighbouring rays carry nearly the same
information, so only some of each scan are weighed. Rays without a return are left out.
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
"""Rays weighed per scan."""

HIT_M: Final = 0.1
"""Standard deviation of a ray's end about the map (Nav2's sigma_hit): cell size, range noise, map
errors. Chosen on logs of real robots: with 0.06 the particles settle half a metre along a corridor
when they return from beyond the map's end."""

CELL_M: Final = 0.025
"""Cell size of the field: its steps limit the accuracy of the pose."""

LARGE: Final = 1_000_000
"""Maps with more cells keep their own cell size: four times as many cells take over 100 MB."""

RIM_M: Final = 0.5
"""Margin of the field beyond the map: half of the rays to a wall on its edge end outside."""

COARSE_M: Final = 0.3
"""Standard deviation for guesses that are that far apart."""

HIT, RANDOM = 0.9, 0.1
"""Shares of rays that end at walls of the map, and anywhere (Nav2's z_hit, z_rand)."""

WIDE: Final = 400_000
"""Ray ends computed at once, which fit into the processor's caches."""


def beams_of(scan: Scan) -> list[Echo]:
    """Some of a scan's rays with a return, evenly spaced; other rays in each scan.

    Raises ValueError if its bytes are not ranges.
    """
    ranges = ranges_of(scan)
    met = np.flatnonzero(np.isfinite(ranges))
    step = max(1, -(-len(met) // BEAMS))
    first = scan.number * 7 % step  # 7: consecutive scans do not use neighbouring rays
    return [
        Echo(scan.x, scan.y, scan.bearing + scan.step * ray, float(ranges[ray]))
        for ray in met[first::step].tolist()
    ]


class LaserModel:
    """A likelihood field, computed from a map's clearances."""

    def __init__(self, grid: Grid) -> None:
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
        excused: bool = False,  # noqa: ARG002 - the field has no information on nearer objects
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
            np.clip(column, 0, self._columns - 1, out=column)  # the rim is far from any wall
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
