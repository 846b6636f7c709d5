"""A ring of sonars that publish sensor_msgs/Range, one message per sonar; sans-IO.

REP-117 and sensor_msgs/Range: +inf, and any value beyond the longest range, is no echo; -inf is an
obstacle nearer than can be measured; NaN is no measurement. Many drivers publish 0 for no
measurement, which is accepted as that.
"""

from __future__ import annotations

from math import inf

from armadico.bridge.ros2 import types
from armadico.config.profile import SonarRing

SILENT_S, SILENT_TURNS = 1.0, 4.0
"""A sonar is silent after this time without a reading, and as many turns of the ring."""

SHORT = 0.95
"""A sonar whose range is below this share of the profile's is rejected: the rest is unknown."""


class Rangers:
    """The readings since the last cycle, by sonar."""

    def __init__(self, ring: SonarRing, old_s: float, now: float) -> None:
        """Readings older than `old_s` (s), by the robot's clock, are not used."""
        self.wrong = ""  # why its readings are not used now; "" if they are
        self._ring, self._old_s = ring, old_s
        self._index = {sonar.frame: index for index, sonar in enumerate(ring.sonars)}
        self._patience = max(SILENT_S, SILENT_TURNS * len(ring.sonars) * ring.period_s)
        self._received: dict[int, tuple[float, float]] = {}  # stamp by the robot's clock, and m
        self._at = [now] * len(ring.sonars)  # when each was received last

    def frame_of(self, message: types.Range) -> str:
        """The frame of the sonar. Raises ValueError if the profile has no such sonar."""
        frame = message.header.frame_id
        if frame not in self._index:
            known = ", ".join(sonar.frame or "" for sonar in self._ring.sonars)
            raise ValueError(f"a range of the unknown frame {frame!r}; the profile has {known}")
        return frame

    def on_range(self, message: types.Range, stamp: float, now: float) -> None:
        """Add a reading with a stamp (s) of the robot's clock. Raises ValueError if unusable."""
        frame, ring = self.frame_of(message), self._ring
        range_m = float(message.range)
        least, most = float(message.min_range), float(message.max_range)
        if range_m == -inf:
            range_m = max(least, ring.min_m)
        elif range_m > most > 0.0:
            range_m = inf
        if range_m == inf and 0.0 < most < SHORT * ring.max_m:
            raise ValueError(
                f"{frame} has a range of {most:g} m, below the profile's max_m = {ring.max_m:g}:"
                " obstacles between are not detected"
            )
        if not range_m > 0.0:  # also rejects NaN
            return
        index = self._index[frame]
        self._received[index] = stamp, min(range_m, ring.max_m)
        self._at[index] = now

    def collect(self, stamp: float, now: float) -> tuple[tuple[int, float], ...]:
        """(sonar, m) of the readings since the last call, at a time by both clocks, s.

        Empty while a sonar is silent, so that its sector does not count as free.
        """
        received, self._received = self._received, {}
        silent = [
            sonar.frame or ""
            for sonar, at in zip(self._ring.sonars, self._at, strict=True)
            if now - at > self._patience
        ]
        if silent:
            self.wrong = f"no range of {', '.join(silent)} for {self._patience:.1f} s"
            return ()
        fresh = {i: r for i, (at, r) in received.items() if abs(stamp - at) <= self._old_s}
        if received and not fresh:
            age = max((stamp - at for at, _ in received.values()), key=abs)
            self.wrong = f"their ranges are older than the odometry, by {age:.3g} s"
            return ()
        self.wrong = ""
        return tuple(fresh.items())
