"""Scans cast in walls, drives with a pose for each, and walls as a map."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from math import atan2, hypot, pi
from pathlib import Path
from typing import Any

import numpy as np

from armadico.agents.methods.poses import Floats

BEARINGS: Floats = np.radians(np.arange(-135.0, 135.0, 1.5))


def cast(walls: Floats, pose: Any, bearings: Floats = BEARINGS) -> Floats:
    """The range of each ray, m; inf where nothing is."""
    angles = bearings + pose[2]
    c, s = np.cos(angles)[:, None], np.sin(angles)[:, None]
    x1, y1, x2, y2 = walls.T
    ex, ey = x2 - x1, y2 - y1
    dx, dy = x1 - pose[0], y1 - pose[1]
    with np.errstate(all="ignore"):
        across = c * ey - s * ex
        far = (dx * ey - dy * ex) / across
        along = (dx * s - dy * c) / across
    hit = (far > 0.0) & (along >= -1e-9) & (along <= 1.0 + 1e-9)
    nearest: Floats = np.where(hit, far, np.inf).min(axis=1)
    return nearest


def drive(corners: list[tuple[float, float]], step: float = 0.34, turn: float = 0.4) -> Floats:
    """(n, 3) poses on the way from corner to corner."""
    found: list[tuple[float, float, float]] = []
    heading: float | None = None
    for (x, y), (to_x, to_y) in pairwise(corners):
        to = atan2(to_y - y, to_x - x)
        if heading is not None:
            off = (to - heading + pi) % (2 * pi) - pi
            parts = int(abs(off) / turn) + 1
            found += [(x, y, heading + off * k / parts) for k in range(1, parts + 1)]
        heading, count = to, int(hypot(to_x - x, to_y - y) / step)
        shares = [k / count for k in range(count)]
        found += [(x + f * (to_x - x), y + f * (to_y - y), to) for f in shares]
    return np.array(found)


def map_of(
    path: Path, walls: Iterable[tuple[float, ...]], size: tuple[float, float] = (21.0, 5.0)
) -> str:
    """Write a map of walls, x1, y1, x2, y2 in m, from (0, 0) on; its name."""
    most, *lines = [" ".join(f"{1000 * v:.0f}" for v in each) for each in (size, *walls)]
    head = ["2D-Map", "LineMinPos: 0 0", f"LineMaxPos: {most}", "LINES"]
    path.write_text("\n".join([*head, *lines, ""]))
    return str(path)
