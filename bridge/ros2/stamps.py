"""The robot's clock, and the cycles that the stamps of its odometry make; sans-IO."""

from __future__ import annotations

import struct
from enum import Enum, auto

from armadico.bridge.ros2.profile import Ros2

_STAMP = {0: struct.Struct(">iI"), 1: struct.Struct("<iI")}  # by CDR's second byte
_STAMP_AT = 4


class Timing(Enum):
    """What the stamp of an odometry makes of it."""

    REPEATED = auto()  # the stamp of the one before
    BACKWARDS = auto()  # an earlier one
    BETWEEN = auto()  # between two cycles
    DUE = auto()  # a cycle


class Stamps:
    """The newest stamp of the odometry, and when the next cycle is due.

    Attributes:
        stamp: The newest, s by the robot's clock.
        at: When that was received, s by ours; None: none was since `begin`.
    """

    def __init__(self, ros2: Ros2) -> None:
        self.stamp, self._due = -1.0, 0.0
        self.at: float | None = None
        self._cycle_s = ros2.cycle_s
        self._slack = 0.5 / ros2.odom_hz

    def begin(self) -> None:
        """The next odometry is the first."""
        self.at = None

    def judge(self, stamp: float) -> Timing:
        """What the stamp of an odometry (s) makes of it."""
        if stamp == self.stamp:
            return Timing.REPEATED
        if self.at is not None and stamp < self.stamp:
            return Timing.BACKWARDS
        early = self.at is not None and stamp < self._due - self._slack
        return Timing.BETWEEN if early else Timing.DUE

    def note(self, stamp: float, now: float) -> None:
        """An odometry is sound, as far as it was read."""
        self.stamp, self.at = stamp, now

    def count(self, stamp: float, now: float) -> bool:
        """An odometry makes a cycle; whether it is the first."""
        first = self.at is None
        late = first or stamp - self._due >= self._cycle_s
        self._due = (stamp if late else self._due) + self._cycle_s
        self.note(stamp, now)
        return first

    def set_back(self, stamp: float) -> None:
        """From this stamp on the odometry has to go forwards."""
        self.stamp, self._due = stamp, stamp + self._cycle_s

    def time(self, now: float) -> float | None:
        """The robot's time, s; None: it is not known."""
        return None if self.at is None else max(self.stamp + now - self.at, 0.0)


def stamp_of(payload: bytes) -> float:
    """When a message with a header was measured, s of the robot's clock. Raises ValueError."""
    order = _STAMP.get(payload[1] if len(payload) >= _STAMP_AT + 8 else -1)
    if order is None:
        raise ValueError(f"{len(payload)} bytes have no stamp")
    sec, nanosec = order.unpack_from(payload, _STAMP_AT)
    return float(sec) + 1e-9 * float(nanosec)
