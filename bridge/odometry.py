"""A robot's own odometry, made continuous: what its speeds do not explain is no step of it."""

from __future__ import annotations

from math import cos, hypot, remainder, sin, tau

from armadico.bridge.session import Pose

# A step is believed up to what the reported speeds explain over the time since the last one and
# this many cycles more (reports get lost), plus what rounding and braking may add.
SPARE_CYCLES = 2
SPARE_M = 0.05
SPARE_RAD = 0.15

# Over a silence it is believed for no longer than the wheels may have turned meanwhile: the
# controller's watchdog, 2 s, and braking.
LONGEST_S = 4.0


class Continuous:
    """Adds up the steps of an odometry that may be reset.

    A step that the speeds do not explain is a reset: the pose stays where it was and goes on from
    there. The robot's axes may then lie otherwise than the pose's, so its steps are turned into the
    pose's.

    Attributes:
        pose: In the odometry's frame, m, m, rad (not wrapped).
        resets: Steps not believed so far.
    """

    def __init__(self, cycle_s: float) -> None:
        """At the frame's origin; the robot reports once in `cycle_s` (s)."""
        self.pose = Pose()
        self.resets = 0
        self._reach_s = SPARE_CYCLES * cycle_s
        self._axes = (1.0, 0.0)  # cosine and sine of the pose's heading less the robot's

    def _align(self, theta: float) -> None:
        """Take the robot's heading (rad) for the pose's: they go on together from here."""
        off = remainder(self.pose.theta - theta, tau)
        self._axes = (cos(off), sin(off))

    def _add(
        self,
        step: tuple[float, float, float],
        fastest: tuple[float, float],
        elapsed: float,
        theta: float,
    ) -> None:
        """Add a step, if it is one.

        Args:
            step: Along the robot's axes: m, m, rad.
            fastest: Of the speeds reported before and after it, without signs: m/s, rad/s.
            elapsed: Since the report before, s.
            theta: The heading that is reported after it, rad.
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
