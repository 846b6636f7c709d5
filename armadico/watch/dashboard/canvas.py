"""The canvas of a scene: one root in a recording, one timeline, and a rate for each entity.

Rerun keeps every row, so the drawing rates determine the memory used. An entity that is not in
`RATES_HZ` is drawn at up to `FASTEST_HZ`.
"""

from __future__ import annotations

from typing import Final

import rerun as rr

TIMELINE: Final = "t"  # seconds since the recording began
FASTEST_HZ: Final = 12.0  # largest rate, also if the robot's cycle is shorter

RATES_HZ: Final[dict[str, float]] = {
    "map/world/path": 1.0,
    "map/world/mapped": 0.5,
    "map/world/slam": 0.5,
    "map/world/echoes": 1.0,
    "map/world/particles": 4.0,
    "map/world/unsure": 5.0,
    "local/robot/sonar": 5.0,
    "local/robot/scan": 5.0,
    "local/robot/cells": 4.0,
    "local/robot/zones": 5.0,
}

EARLY: Final = 0.2  # share of its period by which an entity may be drawn early: cycles jitter

Colour = tuple[int, int, int, int]  # red, green, blue and opacity, 0 to 255


def rgba(hexadecimal: str, alpha: int = 255) -> Colour:
    """A colour such as #0072b2."""
    red, green, blue = bytes.fromhex(hexadecimal.removeprefix("#"))
    return red, green, blue, alpha


def pixels(width: float) -> float:
    """A radius in screen points at any zoom; rerun interprets positive radii as metres."""
    return -width


class Canvas:
    """One namespace's part of a recording."""

    def __init__(self, recording: rr.RecordingStream, root: str) -> None:
        self._recording = recording
        self._root = root.strip("/")
        self._drawn_at: dict[str, float] = {}

    def due(self, path: str, t: float) -> bool:
        """Whether an entity may be drawn at t (s), by its rate; True counts as drawn.

        A time before the last one, as when a recording is played again, is always due.
        """
        before = self._drawn_at.get(path)
        period = 1.0 / RATES_HZ.get(path, FASTEST_HZ)
        if before is not None and 0.0 <= t - before < (1.0 - EARLY) * period:
            return False
        self._drawn_at[path] = t
        return True

    def draw(self, path: str, t: float, *what: rr.AsComponents) -> None:
        """Draw an entity, valid from t (s) on."""
        self._recording.set_time(TIMELINE, duration=t)
        self._recording.log(f"{self._root}/{path}", *what)

    def fix(self, path: str, *what: rr.AsComponents) -> None:
        """Draw an entity, valid at all times."""
        self._recording.log(f"{self._root}/{path}", *what, static=True)
