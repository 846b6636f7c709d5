"""The wheel encoders, and the odometry that the microcontroller computes from them (thesis 4.4).

Encoders measure the turning of the wheels, not the motion over the floor. Slip is drawn for each
wheel and each 0.1 m (a patch of floor): drawn at each step it would average out, drawn once it
would be a miscalibration. Two miscalibrations are drawn once per run: drift (the wheels differ, so
the heading error grows with the distance), and the scale of turns and distances (a wheel base and
wheels of another size than configured in the controller).
"""

from __future__ import annotations

from collections.abc import Callable
from math import cos, floor, sin
from random import Random

from armadico.config.profile import RobotProfile, SensorProfile

TICKS_PER_M = 76_000.0  # 76 ticks for each mm of the wheel's rim
PATCH_M = 0.1
LEAST_LEFT = 0.01
"""A gyroscope that leaves a smaller share of the errors leaves none."""


class Encoder:
    """One wheel's quadrature counter.

    Attributes:
        ticks: Counted since power-on.
        turned: The same, with the fraction.
        scale: Ticks per metre of rim on this patch of floor.
        slips: Whether patches differ.
    """

    __slots__ = (
        *("_patch_m", "_rng", "_slip", "_spin", "_unslipped"),
        *("scale", "slips", "ticks", "turned"),
    )

    def __init__(self, slip: float, scale: float, rng: Random) -> None:
        self.ticks = 0
        self.turned = 0.0
        self.scale = self._unslipped = scale
        self.slips = slip != 0.0
        self._slip = slip
        self._spin = 1.0
        self._patch_m = 0.0  # the rest of the patch
        self._rng = rng

    def slip(self, rim_m: float) -> None:
        """Roll by a distance, perhaps onto the next patch."""
        self._patch_m -= abs(rim_m)
        if self._patch_m <= 0.0:
            self._patch_m += PATCH_M
            self.scale = self._unslipped * (1.0 + self._rng.gauss(0.0, self._slip))

    def rescale(self, scale: float) -> None:
        """Count so many ticks per metre of rim."""
        self.scale = self._unslipped = scale * self._spin

    def spin(self, times: float) -> None:
        """Turn so many times as far as it rolls, from now on."""
        self.scale *= times / self._spin
        self._unslipped *= times / self._spin
        self._spin = times


class Odometry:
    """Speeds and pose as the microcontroller computes them from its two encoders.

    Speeds (m/s, rad/s) are ticks over the last step. The pose (m, rad) starts at zero and is not
    affected by lifting the robot; its heading is not wrapped.
    """

    __slots__ = (
        *("_dt", "_gyro", "_left", "_right", "_track", "_wide"),
        *("left_m_s", "right_m_s", "theta", "usual", "v", "w", "x", "y"),
    )

    def __init__(
        self,
        profile: RobotProfile,
        sensors: SensorProfile,
        dt: float,
        streams: Callable[[str], Random],
    ) -> None:
        track, rng = profile.body.half_track_m, streams("odometry")
        turn_error = sensors.turn_error
        if turn_error and profile.drive is not None:  # scrubbing depends on the floor
            turn_error += profile.drive.scrub
        skew, turn, way = (
            rng.uniform(-most, most)
            for most in (sensors.drift_rad_m * track, turn_error, sensors.way_error)
        )
        ticks = TICKS_PER_M * (1.0 + way)
        self._gyro = 0.0 if profile.drive is None else 1.0 - profile.drive.heading
        self._wide = 2.0 * track
        self._dt = dt
        self._track = 2.0 * track * (1.0 - turn)
        left = 1.0 - self._gyro
        # The largest errors that are drawn, as reported: of turns (rad/rad), a drift (rad/m), and
        # of ways (m/m).
        self.usual = left * turn_error, left * sensors.drift_rad_m, sensors.way_error
        self._left = Encoder(sensors.slip, ticks * (1.0 - skew), streams("slip/left"))
        self._right = Encoder(sensors.slip, ticks * (1.0 + skew), streams("slip/right"))
        self.left_m_s = self.right_m_s = self.v = self.w = 0.0
        self.reset()

    @property
    def ticks(self) -> tuple[int, int]:
        """Left and right ticks since power-on."""
        return self._left.ticks, self._right.ticks

    def reset(self) -> None:
        """Set the odometry to (0, 0, 0)."""
        self.x = self.y = self.theta = 0.0

    def miscalibrate(self, turn: float, drift: float, way: float) -> None:
        """Have these lasting errors: what is counted too little of turns, a drift, of ways.

        rad/rad, rad/m and m/m of what is reported, as in `Correction.wheels`. With a gyroscope the
        wheels' own errors are larger; one that leaves nothing of them has none.
        """
        left, ticks = 1.0 - self._gyro, 1.0 / (1.0 + way)
        more = 1.0 / left if left > LEAST_LEFT else 0.0
        turned = 1.0 + more * (1.0 / (1.0 + turn) - 1.0)  # by the wheels, per true turn
        skew = -more * drift * 0.5 * self._wide
        self._track = self._wide * ticks / max(0.1, turned)
        self._left.rescale(TICKS_PER_M * ticks * (1.0 - skew))
        self._right.rescale(TICKS_PER_M * ticks * (1.0 + skew))

    def slip(self, left: float, right: float) -> None:
        """Let the wheels turn so many times as far as they roll."""
        self._left.spin(left)
        self._right.spin(right)

    def move(self, left_m: float, right_m: float) -> None:
        """The rims roll this far over the floor in one step."""
        one, other = self._left, self._right
        if one.slips:
            one.slip(left_m)
            other.slip(right_m)
        one.turned += left_m * one.scale
        other.turned += right_m * other.scale
        ticks, others = floor(one.turned), floor(other.turned)
        left, right = (ticks - one.ticks) / TICKS_PER_M, (others - other.ticks) / TICKS_PER_M
        one.ticks, other.ticks = ticks, others
        along, turned, dt = 0.5 * (left + right), (right - left) / self._track, self._dt
        if self._gyro:  # measures the body's turning, not the wheels'
            turned += self._gyro * ((right_m - left_m) / self._wide - turned)
        self.left_m_s, self.right_m_s = left / dt, right / dt
        self.v, self.w = along / dt, turned / dt
        heading = self.theta + 0.5 * turned
        self.x += along * cos(heading)
        self.y += along * sin(heading)
        self.theta += turned
