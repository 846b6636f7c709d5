"""A ring of sonars that says sensor_msgs/Range, each by itself; sans-IO.

REP-117 and sensor_msgs/Range: +inf, and what is beyond the longest range, is nothing heard; -inf is
something nearer than can be measured; NaN is no measurement. Many a driver says 0 where it has
none, and that is none here, too.
"""

from __future__ import annotations

from math import inf

from armadico.bridge.ros2 import types
from armadico.config.profile import SonarRing

SILENT_S, SILENT_TURNS = 1.0, 4.0
"""A sonar that has said nothing for so long, and so many turns of the ring, is silent."""

SHORT = 0.95
"""A sonar that reaches less than this share of what the profile says hears nothing of the rest."""


class Rangers:
    """What was heard since a cycle, sonar by sonar.

    Attributes:
        wrong: What keeps its readings from being heeded now; empty: nothing does.
    """

    def __init__(self, ring: SonarRing, old_s: float, now: float) -> None:
        """Nobody is missed yet; readings older than `old_s` (s), by the robot's clock, are none."""
        self.wrong = ""
        self._ring, self._old_s = ring, old_s
        self._index = {sonar.frame: index for index, sonar in enumerate(ring.sonars)}
        self._patience = max(SILENT_S, SILENT_TURNS * len(ring.sonars) * ring.period_s)
        self._heard: dict[int, tuple[float, float]] = {}  # when, by the robot's clock, and m
        self._at = [now] * len(ring.sonars)  # when each was heard last

    def frame_of(self, said: types.Range) -> str:
        """Which sonar it is. Raises ValueError if the profile has none such."""
        frame = said.header.frame_id
        if frame not in self._index:
            known = ", ".join(sonar.frame or "" for sonar in self._ring.sonars)
            raise ValueError(f"a range of {frame!r}, which is none of the profile's: {known}")
        return frame

    def on_range(self, said: types.Range, stamp: float, now: float) -> None:
        """Take a reading, of `stamp` (s) by the robot's clock. Raises ValueError: it is none."""
        frame, ring = self.frame_of(said), self._ring
        heard, least, most = float(said.range), float(said.min_range), float(said.max_range)
        if heard == -inf:
            heard = max(least, ring.min_m)
        elif heard > most > 0.0:
            heard = inf
        if heard == inf and 0.0 < most < SHORT * ring.max_m:
            raise ValueError(
                f"{frame} hears {most:g} m far, and the profile's max_m = {ring.max_m:g}: nobody"
                " knows what is between"
            )
        if not heard > 0.0:  # nor is NaN
            return
        index = self._index[frame]
        self._heard[index] = stamp, min(heard, ring.max_m)
        self._at[index] = now

    def collect(self, stamp: float, now: float) -> tuple[tuple[int, float], ...]:
        """What was heard since this was last asked, at a time by either clock, s.

        Nothing at all while one of them is silent: what it would hear is no free way.
        """
        heard, self._heard = self._heard, {}
        silent = [
            sonar.frame or ""
            for sonar, at in zip(self._ring.sonars, self._at, strict=True)
            if now - at > self._patience
        ]
        if silent:
            self.wrong = f"no range of {', '.join(silent)} for {self._patience:.1f} s"
            return ()
        fresh = {i: r for i, (at, r) in heard.items() if abs(stamp - at) <= self._old_s}
        if heard and not fresh:
            age = max((stamp - at for at, _ in heard.values()), key=abs)
            self.wrong = f"their ranges are older than the odometry, by {age:.3g} s"
            return ()
        self.wrong = ""
        return tuple(fresh.items())
