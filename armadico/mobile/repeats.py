"""Range sensors that repeat their readings while the robot moves: they are frozen, and see nothing.

Noise makes each reading of a real sensor differ, and motion each of a simulated one without noise,
but for some: a sonar's cone hides a turn of some degrees, and beside a wall an echo stays the same.
So several in a row must be the same, of which each ought to differ.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from math import hypot
from typing import Final

from armadico.mobile.geometry import Pose2, wrap
from armadico.mobile.messages import Echo
from armadico.mobile.scans import NOTHING

MOVED_M: Final = 0.05
TURNED_RAD: Final = 0.05
"""A reading ahead changes over this way, and every reading over this turn."""

AHEAD_RAD: Final = 0.6
"""Bearings of a sonar's readings ahead: others may stay the same along a wall."""

ECHOES: Final = 5
SCANS: Final = 3
"""So many readings in a row that ought to have changed and did not, without one that did, show a
frozen sensor. Chosen; in eight worlds, sensors `ideal` and `real`, one in a row was the most.
"""

RECENT: Final = 10
"""A scan is a repetition if it has the ranges of one of so many before it: some lasers repeat the
last few in turn. A sonar's echo is one number, which recurs by chance: it is compared with the
last."""


class Repeats:
    """The readings of one robot's sonars and laser, with the poses of its odometry.

    `echoes` and `scans` are how many in a row show it.

    Attributes:
        sonar: Whether the sonars repeat their echoes; None: none could be compared yet.
        laser: Whether the laser repeats its ranges, likewise.
    """

    def __init__(self, echoes: int = ECHOES, scans: int = SCANS) -> None:
        self._most_echoes, self._most_scans = echoes, scans
        self.sonar: bool | None = None
        self.laser: bool | None = None
        self._echoes: dict[tuple[float, ...], tuple[float, Pose2]] = {}  # by sonar, the last
        self._echoes_same = self._scans_same = 0  # in a row
        self._number: int | None = None  # of the newest scan
        self._since: Pose2 | None = None  # where the last scan was that counted
        self._recent: deque[bytes] = deque(maxlen=RECENT)

    def on_echoes(self, echoes: Iterable[Echo], pose: Pose2) -> None:
        """Compare the echoes of a cycle, at a pose of the odometry (m, m, rad)."""
        for echo in echoes:
            if echo.range is None:
                continue
            key = echo.x, echo.y, echo.bearing
            last, since = self._echoes.setdefault(key, (echo.range, pose))
            moved, same = (
                _moved(since, pose, abs(wrap(echo.bearing)) < AHEAD_RAD),
                echo.range == last,
            )
            if moved or (self.sonar and not same):  # a change tells without a motion
                self._echoes[key] = echo.range, pose
                self._echoes_same = self._echoes_same + 1 if same else 0
                self.sonar = self._echoes_same >= self._most_echoes

    def on_scan(self, number: int, packed: bytes, pose: Pose2) -> None:
        """Compare a scan, as in `Scan`, at a pose of the odometry. The same number is the same."""
        if number == self._number or not packed.strip(NOTHING):
            return  # scans without a range are alike everywhere
        self._number, same = number, packed in self._recent
        self._recent.append(packed)
        if self._since is None:
            self._since = pose
        elif (moved := _moved(self._since, pose)) or (self.laser and not same):
            self._since = pose if moved else self._since
            self._scans_same = self._scans_same + 1 if same else 0
            self.laser = self._scans_same >= self._most_scans


def _moved(since: Pose2, to: Pose2, ahead: bool = True) -> bool:
    turned = abs(wrap(to[2] - since[2])) > TURNED_RAD
    return turned or (ahead and hypot(to[0] - since[0], to[1] - since[1]) > MOVED_M)
