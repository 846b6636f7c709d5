"""Continuous odometry: a step that the robot's speeds do not explain is a reset."""

from __future__ import annotations

from math import cos, hypot, remainder, sin, tau

from armadico.bridge.session import Pose

# A step is accepted up to what the reported speeds explain over the time since the last report and
# this many cycles more (reports get lost), plus what rounding and braking may add.
SPARE_CYCLES = 2
SPARE_M = 0.05
SPARE_RAD = 0.15

# Without reports it is accepted for at most the time that the wheels may have turned: the
# controller's watchdog, 2 s, and braking.
LONGEST_S = 4.0


class Continuous:
    """Adds up the steps of an odometry that may be reset.

    A step that the speeds do not explain is a reset: the pose stays and continues from there. The
    robot's axes may then differ from the pose's, so its steps are rotated into the pose's.
    """

    def __init__(self, cycle_s: float) -> None:
        """Start at the frame's origin; the robot reports once in `cycle_s` (s)."""
        self.pose = Pose()  # in the odometry's frame, m, m, rad (not wrapped)
        self.resets = 0  # number of resets so far
        self._reach_s = SPARE_CYCLES * cycle_s
        self._axes = (1.0, 0.0)  # cosine and sine of the pose's heading less the robot's

    def _align(self, theta: float) -> None:
        """Equate the robot's heading (rad) with the pose's from here on."""
        off = remainder(self.pose.theta - theta, tau)
        self._axes = (cos(off), sin(off))

    def _add(
        self,
        step: tuple[float, float, float],
        fastest: tuple[float, float],
        elapsed: float,
        theta: float,
    ) -> None:
        """Add a step, or count a reset.

        Args:
            step: Along the robot's axes: m, m, rad.
            fastest: Greater magnitudes of the speeds reported before and after it: m/s, rad/s.
            elapsed: Time since the report before, s.
            theta: The heading reported after it, rad.
        """
        dx, dy, turn = step
        time_s = min(elapsed, LONGEST_S) + self._reach_s
        way, spin = SPARE_M + fastest[0] * time_s, SPARE_RAD + fastest[1] * time_s
        if hypot(dx, dy) <= way and abs(turn) <= spin:
            pose, (c, s) = self.pose, self._axes
            self.pose = Pose(pose.x + c * dx - s * dy, pose.y + s * dx + c * dy, pose.theta + turn)
        else:
            self.resets += 1
            self._align(theta)
