"""The motion half of the controller: set-points by command, and the speed loops."""

from __future__ import annotations

from collections.abc import Callable
from math import pi, remainder, tau

from armadico.bridge.p2os.commands import Cmd, Command
from armadico.bridge.p2os.profile import P2osRobot
from armadico.bridge.simulator.motion_profile import Axis
from armadico.bridge.simulator.plant import Plant
from armadico.bridge.simulator.speed_loops import SpeedLoops

TOLERANCE_M = 0.005  # the position servo corrects no smaller error
TOLERANCE_RAD = 0.5 * pi / 180
AT_REST_M_S = 0.01  # after an emergency stop, commands are obeyed again below these
AT_REST_RAD_S = 0.02
V_ACCEL_TOP = 2.0  # m/s^2, a P3-DX's; ARIA sends no SETA to a controller whose top is 0
W_ACCEL_TOP = 300 * pi / 180  # rad/s^2, a P3-DX's
STALL_SHARE = 0.4  # of the supply: a blocked motor with more is stalled (StallVal; chosen)
STALL_S = 0.2  # a stalled motor is switched off for this time (StallCount; chosen)


class Motion:
    """Set-points, ramps, and the state of the motors.

    Attributes:
        enabled: Whether the motors are on. While they are off, commands are discarded.
        stalled: Whether an obstacle blocked the motors at the last check.
        heading_set: The last heading set-point (rad, odometry).
    """

    def __init__(self, profile: P2osRobot, plant: Plant, loops: SpeedLoops) -> None:
        self._profile, self._plant, self._loops = profile, plant, loops
        self.enabled = self.stalled = False
        self.heading_set = 0.0
        self._cut = 0  # checks until stalled motors are on again
        self._cut_for = max(1, round(STALL_S / profile.p2os.cycle_s))
        self._emergency = False
        self.restore_limits()

    @property
    def active(self) -> bool:
        """Whether the motors are on and have a set-point to reach."""
        return self.enabled and (self.linear.active or self.angular.active)

    def restore_limits(self) -> None:
        """Restore the profile's limits and ramps, at rest."""
        limits = self._profile.limits
        self.linear = Axis(limits.v_max, limits.v_accel, limits.v_decel, TOLERANCE_M)
        self.angular = Axis(limits.w_max, limits.w_accel, limits.w_decel, TOLERANCE_RAD)

    def run(self, steps: int, held: bool) -> None:
        """Advance by simulation steps; `held`: the watchdog stops the wheels."""
        plant, linear, angular, voltages = (
            self._plant,
            self.linear,
            self.angular,
            self._loops.voltages,
        )
        dt = plant.step_s
        if self._cut or not self.enabled:
            plant.run(steps, _off)
        elif linear.steady(held) and angular.steady(held):
            v_set, w_set = linear.speed, angular.speed
            plant.run(steps, lambda v, w: voltages(v_set, w_set, v, w, dt))
        else:
            plant.run(
                steps,
                lambda v, w: voltages(
                    linear.step(dt, v, held), angular.step(dt, w, held), v, w, dt
                ),
            )

    def check_motors(self) -> None:
        """With each status packet: switch stalled motors off, and on again after `STALL_S`.

        Set-points are kept, ramps restart at rest, and the loops are reset. The same happens when
        blocked wheels are commanded to stop or turn back: there is no speed to brake from.
        """
        held = self._plant.blocked and self.active
        self.stalled = held or self._cut > 0
        if self._cut:
            self._cut -= 1
        elif held:
            if self._push() > STALL_SHARE * self._profile.motor.supply_v:
                self._cut = self._cut_for
            if self._cut or self.linear.turned_back or self.angular.turned_back:
                self.linear.rest()
                self.angular.rest()
                self._loops.reset()

    def obey(self, command: Command) -> None:
        """Execute a command of `MOTIONS`, unless motors or emergency stop forbid it."""
        if self.enabled and not self._stopping():
            MOTIONS[command.number](self, command)

    def enable(self, on: bool) -> None:
        """Switch the motors; on without set-points, off at once."""
        if on == self.enabled:
            return
        self.enabled = on
        self._emergency = False
        self._cut = 0
        self._halt()

    def emergency_stop(self) -> None:
        """Brake without a ramp; commands are ignored until the robot rests."""
        self._halt()
        self._emergency = True

    def drive_wheels(self, command: Command) -> None:
        """VEL2, in the profile's unit."""
        unit_m_s = self._profile.p2os.vel2_mm * 1e-3
        left, right = command.wheels
        self.set_wheels(left * unit_m_s, right * unit_m_s)

    def set_wheels(self, left: float, right: float) -> None:
        """Set the speeds of the wheel rims, m/s."""
        self.linear.set_speed((left + right) / 2)
        self.angular.set_speed((right - left) / (2 * self._profile.body.half_track_m))

    def go_on(self, v: float, w: float) -> None:
        """Follow speeds (m/s, rad/s) without a ramp: the robot has them already."""
        for axis, speed in ((self.linear, v), (self.angular, w)):
            axis.set_speed(speed)
            axis.speed = min(max(speed, -axis.top), axis.top)
        self._loops.hold(*self._plant.holding(v, w))

    def head(self, heading: float) -> None:
        """Turn to a heading of the odometry (rad), the shorter way."""
        self.heading_set = remainder(heading, tau)
        self.angular.set_goal(remainder(heading - self._plant.odometry[2], tau))

    def turn(self, angle: float) -> None:
        """Turn by an angle, rad."""
        self.heading_set = remainder(self._plant.odometry[2] + angle, tau)
        self.angular.set_goal(angle)

    def reset_odometry(self) -> None:
        """Set the odometry to zero; a turn in progress keeps its goal."""
        self.heading_set = remainder(self.heading_set - self._plant.odometry[2], tau)
        self._plant.reset_odometry()

    def limit(self, command: Command) -> None:
        """SETV, SETRV, SETA, SETRA. Zero has no effect; the profile's tops still limit."""
        limits, size = self._profile.limits, abs(command.si)
        linear = command.number in {Cmd.SETV, Cmd.SETA}
        axis = self.linear if linear else self.angular
        ramp = min(size, V_ACCEL_TOP if linear else W_ACCEL_TOP)
        if not size:
            return
        if command.number in {Cmd.SETV, Cmd.SETRV}:
            axis.top = min(size, limits.v_max if linear else limits.w_max)
        elif command.value > 0:
            axis.accel = ramp
        else:
            axis.decel = ramp

    def _push(self) -> float:
        """Voltage of the stronger motor, V."""
        plant, wanted = self._plant, (self.linear.speed, self.angular.speed)
        return max(map(abs, self._loops.voltages(*wanted, plant.v, plant.w, 0.0)))

    def _halt(self) -> None:
        self.linear.halt()
        self.angular.halt()
        self._loops.reset()

    def _stopping(self) -> bool:
        plant = self._plant
        rest = abs(plant.v) < AT_REST_M_S and abs(plant.w) < AT_REST_RAD_S
        self._emergency = self._emergency and not rest
        return self._emergency


def _off(_v: float, _w: float) -> tuple[float, float]:
    return 0.0, 0.0


MOTIONS: dict[int, Callable[[Motion, Command], None]] = {
    Cmd.VEL: lambda motion, command: motion.linear.set_speed(command.si),
    Cmd.RVEL: lambda motion, command: motion.angular.set_speed(command.si),
    Cmd.ROTATE: lambda motion, command: motion.angular.set_speed(command.si),
    Cmd.MOVE: lambda motion, command: motion.linear.set_goal(command.si),
    Cmd.HEAD: lambda motion, command: motion.head(command.si),
    Cmd.DHEAD: lambda motion, command: motion.turn(command.si),
    Cmd.DCHEAD: lambda motion, command: motion.head(motion.heading_set + command.si),
    Cmd.VEL2: lambda motion, command: motion.drive_wheels(command),
    Cmd.STOP: lambda motion, _: motion.set_wheels(0.0, 0.0),
}
LIMITS = (Cmd.SETV, Cmd.SETA, Cmd.SETRV, Cmd.SETRA)
