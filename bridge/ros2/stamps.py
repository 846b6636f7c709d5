"""The robot's clock, and the cycles by the stamps of its odometry; sans-IO."""

from __future__ import annotations

import struct
from enum import Enum, auto

from armadico.bridge.ros2.profile import Ros2

_STAMP = {0: struct.Struct(">iI"), 1: struct.Struct("<iI")}  # by CDR's second byte
_STAMP_AT = 4


class Timing(Enum):
    """How an odometry's stamp relates to the earlier ones."""

    REPEATED = auto()  # the same stamp as before
    BACKWARDS = auto()  # an earlier stamp
    BETWEEN = auto()  # before the next cycle is due
    DUE = auto()  # makes a cycle


class Stamps:
    """The newest stamp of the odometry, and when the next cycle is due.

    Attributes:
        stamp: The newest, s by the robot's clock.
        at: When it was received, s by our clock; None: not since `begin`.
    """

    def __init__(self, ros2: Ros2) -> None:
        self.stamp, self._due = -1.0, 0.0
        self.at: float | None = None
        self._cycle_s = ros2.cycle_s
        self._slack = 0.5 / ros2.odom_hz

    def begin(self) -> None:
        """Treat the next odometry as the first."""
        self.at = None

    def judge(self, stamp: float) -> Timing:
        """Classify the stamp of an odometry, s."""
        if stamp == self.stamp:
            return Timing.REPEATED
        if self.at is not None and stamp < self.stamp:
            return Timing.BACKWARDS
        early = self.at is not None and stamp < self._due - self._slack
        return Timing.BETWEEN if early else Timing.DUE

    def note(self, stamp: float, now: float) -> None:
        """Keep the stamp of a valid odometry."""
        self.stamp, self.at = stamp, now

    def count(self, stamp: float, now: float) -> bool:
        """Count a cycle. Returns whether it is the first."""
        first = self.at is None
        late = first or stamp - self._due >= self._cycle_s
        self._due = (stamp if late else self._due) + self._cycle_s
        self.note(stamp, now)
        return first

    def set_back(self, stamp: float) -> None:
        """Continue from an earlier stamp."""
        self.stamp, self._due = stamp, stamp + self._cycle_s

    def time(self, now: float) -> float | None:
        """The robot's time, s; None: unknown."""
        return None if self.at is None else max(self.stamp + now - self.at, 0.0)


def stamp_of(payload: bytes) -> float:
    """The stamp of a message with a header, s of the robot's clock. Raises ValueError."""
    order = _STAMP.get(payload[1] if len(payload) >= _STAMP_AT + 8 else -1)
    if order is None:
        raise ValueError(f"{len(payload)} bytes have no stamp")
    sec, nanosec = order.unpack_from(payload, _STAMP_AT)
    return float(sec) + 1e-9 * float(nanosec)
