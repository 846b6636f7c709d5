"""Counts of invalid data on a robot's line, the same for all protocols."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from armadico.bridge.framing import Framing
from armadico.bridge.odometry import Continuous
from armadico.core.messages import Line

BURST = 50
"""Greatest number of reports decoded at once, after a hang."""


@dataclass
class Counts:
    """A session's counts of invalid data."""

    malformed: int = 0  # messages with a valid check and invalid contents
    absurd: int = 0  # reports of impossible wheel speeds, which are discarded
    surplus: int = 0  # reports that were too many to be decoded

    def line(self, decoder: Framing[Any], odometry: Continuous) -> Line:
        return Line(
            decoder.dropped,
            decoder.mangled,
            self.malformed,
            self.absurd,
            self.surplus,
            odometry.resets,
        )


class Ration:
    """Limits the number of reports decoded: their cost must not delay a stop."""

    def __init__(self) -> None:
        self._left, self._at = float(BURST), 0.0

    def surplus(self, count: int, now: float, rate: float) -> int:
        """How many of `count` reports to skip, oldest first; `rate` are allowed per second."""
        self._left = min(self._left + (now - self._at) * rate, BURST)
        self._at = now
        surplus = max(count - int(self._left), 0)
        self._left -= count - surplus
        return surplus
