"""What was wrong on a robot's line, counted the same for all protocols."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from armadico.bridge.framing import Framing
from armadico.bridge.odometry import Continuous
from armadico.core.messages import Line

BURST = 50
"""Reports that are decoded at once, after a hang."""


@dataclass
class Counts:
    """A session's counts of what was wrong with what it received."""

    malformed: int = 0  # messages with a good check and bad contents
    absurd: int = 0  # reports of wheels faster than any; they count as not received
    surplus: int = 0  # reports that were too many to be decoded

    def line(self, decoder: Framing[Any], odometry: Continuous) -> Line:
        """All that was wrong on the line so far."""
        return Line(
            decoder.dropped,
            decoder.mangled,
            self.malformed,
            self.absurd,
            self.surplus,
            odometry.resets,
        )


class Ration:
    """Bounds how many reports are decoded: what each costs must not delay a stop."""

    def __init__(self) -> None:
        self._left = float(BURST)

    def surplus(self, count: int, earned: float) -> int:
        """How many of `count` reports are to be passed over, the oldest; `earned` since."""
        self._left = min(self._left + earned, BURST)
        surplus = max(count - int(self._left), 0)
        self._left -= count - surplus
        return surplus
