"""What was wrong on a robot's line, counted the same for both protocols."""

from __future__ import annotations

from typing import Any

from armadico.bridge.framing import Framing
from armadico.bridge.odometry import Continuous
from armadico.core.messages import Line


class Counting:
    """A session's counts of what was wrong on its line.

    Attributes:
        decoder: Counts what was dropped.
        malformed: Messages so far with a good check and bad contents.
        absurd: Reports so far of wheels faster than any; they count as not received.
        surplus: Reports so far that were too many to be looked at.
        odometry: Counts its resets.
    """

    decoder: Framing[Any]
    odometry: Continuous
    malformed = absurd = surplus = 0

    @property
    def line(self) -> Line:
        """What was wrong on the line so far."""
        return Line(
            self.decoder.dropped,
            self.decoder.mangled,
            self.malformed,
            self.absurd,
            self.surplus,
            self.odometry.resets,
        )
