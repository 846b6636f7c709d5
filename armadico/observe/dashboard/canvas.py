"""Where a scene draws: one root in a recording, one clock, and a rate for each entity.

Rerun keeps every row it is given, so what is drawn how often decides how much memory an hour takes.
`RATES_HZ` is that decision: what is not in it is drawn as it comes, up to `FASTEST_HZ`.
"""

from __future__ import annotations

from typing import Any, Final

import rerun as rr

TIMELINE: Final = "t"
"""Seconds since the recording began."""

FASTEST_HZ: Final = 12.0
"""Nothing is drawn more often, however short the robot's cycle is."""

RATES_HZ: Final[dict[str, float]] = {
    "map/world/path": 1.0,
    "map/world/mapped": 0.5,
    "map/world/echoes": 1.0,
    "map/world/robot/sonar": 5.0,
    "map/world/particles": 4.0,
    "map/world/unsure": 5.0,
    "map/world/odom": 5.0,
    "local/robot/sonar": 5.0,
    "local/robot/scan": 5.0,
    "local/cells": 4.0,
    "local/robot/zones": 5.0,
    "battery": 1.0,
    "status": 2.0,
    "society/table": 1.0,
}

EARLY: Final = 0.2
"""A drawing may come this share of its period too early, since cycles do not come exactly."""

Colour = tuple[int, int, int, int]
"""Red, green, blue and opacity, 0 to 255."""


def rgba(hexadecimal: str, alpha: int = 255) -> Colour:
    """A colour such as #0072b2."""
    red, green, blue = bytes.fromhex(hexadecimal.removeprefix("#"))
    return red, green, blue, alpha


def pixels(width: float) -> float:
    """A radius in points of the screen, whatever the zoom; rerun takes positive ones for metres."""
    return -width


class Canvas:
    """One namespace's part of a recording."""

    def __init__(self, recording: rr.RecordingStream, root: str) -> None:
        self._recording = recording
        self._root = root.strip("/")
        self._drawn_at: dict[str, float] = {}

    def due(self, path: str, t: float) -> bool:
        """Whether an entity may be drawn at t (s), by its rate; true counts as drawn.

        Time that goes back, as in a recording that is played again, starts afresh.
        """
        before = self._drawn_at.get(path)
        period = 1.0 / RATES_HZ.get(path, FASTEST_HZ)
        if before is not None and 0.0 <= t - before < (1.0 - EARLY) * period:
            return False
        self._drawn_at[path] = t
        return True

    def draw(self, path: str, t: float, *what: Any) -> None:
        """Draw an entity as it is from t (s) on."""
        self._recording.set_time(TIMELINE, duration=t)
        self._recording.log(f"{self._root}/{path}", *what)

    def fix(self, path: str, *what: Any) -> None:
        """Draw an entity as it is at all times."""
        self._recording.log(f"{self._root}/{path}", *what, static=True)

    def number(self, path: str, t: float, value: float) -> None:
        """A point of a curve; NaN leaves a gap."""
        self.draw(path, t, rr.Scalars(value))

    def curve(self, path: str, name: str, colour: Colour, width: float = 2.0) -> None:
        self.fix(path, rr.SeriesLines(colors=[colour], names=[name], widths=[width]))
