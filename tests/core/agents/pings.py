"""A sonar's ping, as the methods that hear it take it."""

from __future__ import annotations

from typing import NamedTuple


class Ping(NamedTuple):
    """From where, m, in which direction, rad, and how far the echo came from, m; None: none."""

    x: float
    y: float
    bearing: float
    range: float | None
