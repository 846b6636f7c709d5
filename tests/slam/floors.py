"""A floor of which a robot may have the map of one room alone."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

ROOM = [(0, 0, 6, 0), (6, 0, 6, 1.5), (6, 3.1, 6, 5), (6, 5, 0, 5), (0, 5, 0, 0), (2, 4, 3, 4)]
"""x1, y1, x2, y2 of its walls, m. It has a door."""

CORRIDOR = [
    *((6, 1.5, 9, 1.5), (9, 1.5, 9, 0.8), (9, 0.8, 10, 0.8), (10, 0.8, 10, 1.5)),
    *((10, 1.5, 16, 1.5), (16, 1.5, 16, 0.6), (16, 0.6, 17, 0.6), (17, 0.6, 17, 1.5)),
    *((17, 1.5, 20, 1.5), (20, 1.5, 20, 3.1), (20, 3.1, 14, 3.1), (14, 3.1, 14, 3.9)),
    *((14, 3.9, 12.5, 3.9), (12.5, 3.9, 12.5, 3.1), (12.5, 3.1, 6, 3.1)),
]
"""With niches, behind the door."""

HEADER = ["2D-Map", "LineMinPos: 0 0", "LineMaxPos: 21000 5000", "LINES"]


def map_of(path: Path, walls: Sequence[tuple[float, ...]]) -> str:
    """Write a map; its name."""
    lines = [" ".join(f"{1000 * v:.0f}" for v in wall) for wall in walls]
    path.write_text("\n".join([*HEADER, *lines, ""]))
    return str(path)
