"""The robot's controller; sans-IO: the client's bytes and the time in, the robot's bytes out.

It behaves like a Pioneer's controller, traps included. Its watchdog stops the wheels when the
client falls silent, but the set-points stay: the next packet, even a pulse, sets the robot in
motion again. A session that was not closed stays open, and takes a new client's SYNC0, SYNC1 and
SYNC2 for PULSE, OPEN and CLOSE.
"""

from __future__ import annotations

from collections.abc import Callable
from math import remainder, tau
from typing import NamedTuple

from armadico.bridge.p2os.commands import Cmd, Command, command, decode_command
from armadico.bridge.p2os.configuration import (
    Configuration,
    Encoders,
    encode_configuration,
    encode_encoders,
    encode_text,
)
from armadico.bridge.p2os.packets import QUIET_S, Decoder, encode
from armadico.bridge.p2os.profile import P2osRobot
from armadico.bridge.p2os.status import Status, encode_status
from armadico.bridge.simulator.motion import (
    LIMITS,
    MOTIONS,
    STALL_S,
    STALL_SHARE,
    V_ACCEL_TOP,
    W_ACCEL_TOP,
    Motion,
)
from armadico.bridge.simulator.plant import Plant
from armadico.bridge.simulator.simulated import Controller
from armadico.bridge.simulator.sonar_schedule import ALL, Firing
from armadico.bridge.simulator.speed_loops import SpeedLoops
from armadico.bridge.simulator.traps import KIND, Trap

SERIAL_NUMBER = "SIM"  # tells ARIA that this is a simulator, so it searches no further hardware
IDLE_S = 10.0  # MobileSim's timeout for a handshake
PWM_MAX = 500  # as on a real P3-DX
WORLD_M = 1e4  # larger than any world; 32 bits of mm would put the robot 2000 km away
PULSE = command(Cmd.PULSE)
FLOOD = 40 * PULSE
"""Longer than any packet, so only pulses. One pulse replaces it, so that no stop is delayed."""
_STANDING_MM_S = 0.5  # below this a wheel's speed is reported as zero


class Steps(NamedTuple):
    """Times of a controller, in steps of the plant."""

    cycle: int  # from one status packet to the next
    period: int  # from one ping to the next
    patience: int  # of the watchdog
    quiet: int  # until an incomplete packet is discarded
    idle: int  # until a silent client is disconnected

    @classmethod
    def of(cls, profile: P2osRobot, step_s: float) -> Steps:
        units, period_s = profile.p2os, profile.sonar.period_s
        times_s = (units.cycle_s, period_s, units.watchdog_s, QUIET_S, IDLE_S)
        cycle, period, patience, quiet, idle = (round(each / step_s) for each in times_s)
        return cls(cycle, period, patience, quiet + 1, idle)


class Microcontroller(Controller):
    """A Pioneer's controller on a simulated robot.

    The owner passes what it read to `receive`, then calls `advance` and writes the result.
    """

    def __init__(
        self,
        profile: P2osRobot,
        plant: Plant,
        loops: SpeedLoops,
        traps: frozenset[Trap] = KIND,
    ) -> None:
        super().__init__(plant)
        self.decoder = Decoder()
        self._profile, self._traps = profile, traps
        self._motion = Motion(profile, plant, loops)
        self._firing = Firing(profile.sonar, plant.ping, plant.sonar_readings)
        self._steps = Steps.of(profile, plant.step_s)
        self._received_at = self._fed_at = self._next_status = self._next_ping = 0
        self._sync = 0  # the SYNC awaited; 3 or more once in step
        self._open = self._closed = False
        self._encoder_packets = 0
        self._digital_out = 0
        self._pretended_v = 0.0

    @property
    def is_open(self) -> bool:
        """Whether a client has requested status packets."""
        return self._open

    @property
    def hangs_up(self) -> bool:
        """Whether the connection should end, so that the next client can connect.

        CLOSE ends it, even if the client keeps it, as AriaCoda does. A long silence ends it if no
        status packets were requested. A client that requested them may listen without limit.
        """
        idle = not self._open and self._now - self._received_at >= self._steps.idle
        return Trap.PORT not in self._traps and (self._closed or idle)

    def receive(self, data: bytes) -> None:
        """Process the client's bytes; they take effect at the time reached."""
        self._fed_at = self._now
        for payload in self.decoder.feed(data.replace(FLOOD, PULSE), self.time_s):
            self._received_at = self._now
            if self._sync < 3:
                self._synchronise(payload)
            else:
                self._obey(decode_command(payload))

    def go_on(self, v: float, w: float) -> None:
        self._fed_at = self._now
        self._motion.go_on(v, w)

    def disconnect(self) -> None:
        """End the session as CLOSE does: the connection has ended, or is a new one.

        A serial line does not show that its client died; a TCP connection does.
        """
        self.decoder = Decoder()
        self._out.clear()
        self._close()
        self._closed = False
        self._received_at = self._now

    def _next_report(self) -> int:
        return self._next_status

    def _next_event(self, until: int) -> int:
        until = super()._next_event(until)
        if self._open:
            until = min(until, self._next_ping)
        if self.decoder.pending:
            until = min(until, self._fed_at + self._steps.quiet)
        trip = self._received_at + self._steps.patience
        return trip if self._now < trip < until else until

    def _move(self, steps: int) -> None:
        self._motion.run(steps, self._watchdog_tripped())

    def _report(self) -> None:
        if self.decoder.pending and self._now == self._fed_at + self._steps.quiet:
            self.receive(b"")  # discards the incomplete packet, and decodes what follows: a stop
        if self._open:
            self._on_schedule()

    def _watchdog_tripped(self) -> bool:
        return self._now >= self._received_at + self._steps.patience

    def _on_schedule(self) -> None:
        if self._now >= self._next_ping:
            self._firing.fire()
            self._next_ping += self._steps.period
        if self._now >= self._next_status:
            self._send_status()
            self._next_status += self._steps.cycle

    def _synchronise(self, payload: bytes) -> None:
        """Answer SYNC0, SYNC1, SYNC2 in that order; anything else restarts the sequence."""
        if Trap.FIRST_PACKET in self._traps:
            payload = payload[:1]
            self._sync = payload[0]
        elif payload == b"\x00":
            self._sync = 0
        if payload != bytes([self._sync]):
            self._sync = 0
            return
        if self._sync == 2:
            payload += self._names()
            self._motion.restore_limits()
        self._out += encode(payload)
        self._sync += 1

    def _names(self) -> bytes:
        units = self._profile.p2os
        return b"".join(map(encode_text, (units.name, units.class_name, units.subclass)))

    def _obey(self, command: Command) -> None:
        """Execute a command; unknown ones are ignored."""
        if command.number in MOTIONS:
            self._motion.obey(command)
        elif command.number in LIMITS:
            self._motion.limit(command)
        elif command.number in _COMMANDS:
            _COMMANDS[command.number](self, command)

    def _start(self) -> None:
        """OPEN: status packets after one cycle, sonar on, motors unchanged."""
        if self._open:
            return
        self._open = True
        if Trap.ODOMETRY in self._traps:
            self._motion.reset_odometry()
        self._next_status = self._now + self._steps.cycle
        self._next_ping = self._now + self._steps.period
        self._firing.restore_order()
        self._firing.arrays = ALL

    def _close(self) -> None:
        self._motion.enable(False)
        self._firing.switch(0)
        self._open, self._closed = False, True
        self._sync = self._encoder_packets = 0

    def _set_digital_out(self, command: Command) -> None:
        mask, values = command.value >> 8, command.value & 0xFF
        self._digital_out = self._digital_out & ~mask | values & mask

    def _request_encoders(self, command: Command) -> None:
        self._encoder_packets = command.value
        if command.value == 1:
            self._send_encoders()

    def _send_encoders(self) -> None:
        self._out += encode(encode_encoders(Encoders(*self._plant.encoder_counts)))

    def _send_configuration(self) -> None:
        self._out += encode(encode_configuration(_configuration(self._profile, self._motion)))

    def _set_pose(self, command: Command) -> None:
        if command.pose is not None and max(map(abs, command.pose[:2])) <= WORLD_M:
            x, y, theta = command.pose
            self._plant.set_pose(x, y, remainder(theta, tau))

    def _pretend_battery(self, command: Command) -> None:
        self._pretended_v = command.si

    def _send_status(self) -> None:
        """Send the status packet, preceded by the encoders' if requested."""
        if self._encoder_packets > 1:
            self._send_encoders()
        plant, motion = self._plant, self._motion
        x, y, theta = plant.odometry
        left, right = plant.left_m_s, plant.right_m_s
        motion.check_motors()
        status = Status(
            x_m=x,
            y_m=y,
            theta_rad=theta,
            left_m_s=left,
            right_m_s=right,
            battery_v=self._pretended_v or plant.battery.volts,
            moving=max(abs(left), abs(right)) * 1e3 > _STANDING_MM_S,
            left_stall=motion.stalled,
            right_stall=motion.stalled,
            motors_enabled=motion.enabled,
            charging=plant.battery.charging,
            sonar_arrays=self._firing.arrays,
            control_rad=motion.heading_set,
            turning_rad_s=plant.w,
            echoes=self._firing.collect(),
            digital_out=self._digital_out,
        )
        short = Trap.SHORT in self._traps
        self._out += encode(encode_status(status, self._profile.p2os, short=short))


_COMMANDS: dict[int, Callable[[Microcontroller, Command], None]] = {
    Cmd.OPEN: lambda self, _: self._start(),
    Cmd.CLOSE: lambda self, _: self._close(),
    Cmd.POLLING: lambda self, command: self._firing.poll(command.data),
    Cmd.ENABLE: lambda self, command: self._motion.enable(command.value != 0),
    Cmd.SETO: lambda self, _: self._motion.reset_odometry(),
    Cmd.CONFIG: lambda self, _: self._send_configuration(),
    Cmd.ENCODER: lambda self, command: self._request_encoders(command),
    Cmd.SONAR: lambda self, command: self._firing.switch(command.value),
    Cmd.DIGOUT: lambda self, command: self._set_digital_out(command),
    Cmd.E_STOP: lambda self, _: self._motion.emergency_stop(),
    Cmd.SIM_SET_POSE: lambda self, command: self._set_pose(command),
    Cmd.BATTEST: lambda self, command: self._pretend_battery(command),
}


def _configuration(profile: P2osRobot, motion: Motion) -> Configuration:
    """The CONFIGpac's contents; auto_baud stays 0, which keeps clients from HOSTBAUD."""
    limits, units = profile.limits, profile.p2os
    linear, angular = motion.linear, motion.angular
    return Configuration(
        class_name=units.class_name,
        subclass=units.subclass,
        serial_number=SERIAL_NUMBER,
        name=units.name,
        version="S.1",
        v_top=limits.v_max,
        w_top=limits.w_max,
        v_max=linear.top,
        v_accel_top=V_ACCEL_TOP,
        w_accel_top=W_ACCEL_TOP,
        pwm_max=PWM_MAX,
        stall_pwm=round(STALL_SHARE * PWM_MAX),
        stall_s=STALL_S,
        w_max=angular.top,
        v_accel=linear.accel,
        v_decel=linear.decel,
        w_accel=angular.accel,
        w_decel=angular.decel,
        cycle_s=units.cycle_s,
        watchdog_s=units.watchdog_s,
        low_battery_v=profile.battery.empty_v,
        front_sonar=1,
        sonar_period_s=profile.sonar.period_s,
    )
