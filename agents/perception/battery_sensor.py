"""The battery sensor agent: estimates the battery's charge and publishes alarms (thesis 3.4.3).

The voltage under load is a poor measure. It sags by the internal resistance, drops while a motor
starts, and rises while charging. A P2OS packet has it in steps of 0.1 V, 3 % of a lead-acid
battery. So the current is computed by the motor model of 4.5 from the measured speeds. The voltage
is corrected by the sag of that current. The charge drawn is counted, and the count follows the
voltage slowly, as in an observer (Plett, "Battery Management Systems", volume 2, 2015, chapters 1
and 3: coulomb counting corrected by the voltage).
"""

from __future__ import annotations

from math import floor, inf
from typing import Annotated, ClassVar

from msgspec import Meta

from armadico.agents.methods.energy import motor_power
from armadico.config.profile import RobotProfile, load_profile
from armadico.core import agent
from armadico.core.agent import WARNING, Agent
from armadico.core.messages import Cycle, Message, RobotState
from armadico.mobile.messages import BatteryAlarm, BatteryLevel

Seconds = Annotated[float, Meta(gt=0, le=3600)]

# A longer cycle counts as this long: the voltage shows what was used during a gap.
LONGEST_S = 1.0

ALARM_STEP_V = 0.1

# Readings outside these shares of the empty and of the full voltage are rejected.
PLAUSIBLE = 0.5, 1.5

SECONDS_PER_HOUR = 3600.0


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """The battery, and how often its level is published."""

    profile: str = "pioneer-2dx"
    capacity_ah: Annotated[float, Meta(gt=0, le=1e4)] | None = None  # None: the profile's
    slow_s: Seconds = 5.0  # publication period with a full battery
    quick_s: Seconds = 0.5  # publication period with a battery that must be charged
    alarm_v: Annotated[float, Meta(gt=0, le=1e4)] | None = None  # None: the profile's `low_v`
    lag_s: Seconds = 60.0  # time constant of the correction of the counted charge by the voltage
    unread_s: Seconds = 5.0  # a warning is logged if no plausible voltage comes for this time


class BatterySensor(Agent):
    """Estimates the charge each cycle; publishes it more often the lower it is."""

    name = "battery-sensor"
    alone = True
    receives: ClassVar[tuple[type[Message], ...]] = (RobotState,)
    provides: ClassVar[tuple[type[Message], ...]] = (BatteryLevel, BatteryAlarm)
    parameters = Parameters
    launched_with = ("profile", "capacity_ah")
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Parameters | None = None) -> None:
        super().__init__(identity, parameters)
        profile = load_profile(self.p.profile)
        self._battery = profile.battery
        self._gauge = Gauge(profile, self.p.capacity_ah or self._battery.capacity_ah, self.p.lag_s)
        self._updated_at: float | None = None
        self._read_at: float | None = None  # the last plausible reading
        self._unread = False  # whether the lack of readings has been logged
        self._published_at, self._charging = -inf, False
        self._alarmed = inf  # tenths of a volt

    def on_robot_state(self, state: RobotState) -> None:
        dt = 0.0 if self._updated_at is None else min(self.now - self._updated_at, LONGEST_S)
        self._updated_at = self.now
        if self._read_at is None:
            self._read_at = self.now
        if not self._gauge.update(state.battery_v, state.v, state.w, state.charging, dt):
            self._not_read(state.battery_v)
            return
        self._read_at, self._unread = self.now, False
        changed = state.charging != self._charging
        if changed or self.now - self._published_at >= self.period:
            self._published_at, self._charging = self.now, state.charging
            self._publish_level(state.cycle)

    @property
    def period(self) -> float:
        """The publication period, s."""
        battery, p = self._battery, self.p
        share = (self._gauge.volts - battery.empty_v) / (battery.full_v - battery.empty_v)
        return p.quick_s + min(max(share, 0.0), 1.0) * (p.slow_s - p.quick_s)

    def _publish_level(self, cycle: Cycle) -> None:
        gauge = self._gauge
        volts, share = gauge.volts, gauge.share
        self.publish(BatteryLevel(cycle, volts, share, gauge.joules, self._charging))
        if self._charging or volts > (self.p.alarm_v or self._battery.low_v):
            self._alarmed = inf
            return
        tenths = floor(volts / ALARM_STEP_V)
        if tenths < self._alarmed:
            self._alarmed = tenths
            self.publish(BatteryAlarm(cycle, volts, share))
            left = f"{volts:.1f} V, {100 * share:.0f} % are left"
            self.log(f"the battery has to be charged: {left}", WARNING)

    def _not_read(self, volts: float) -> None:
        assert self._read_at is not None, "it has begun"
        if not self._unread and self.now - self._read_at >= self.p.unread_s:
            self._unread = True
            self.log(f"the controller reports {volts:.1f} V, not a battery's voltage", WARNING)


class Gauge:
    """The estimate for one battery. Its share is 1 when full, and 0 when it must be charged."""

    def __init__(self, profile: RobotProfile, capacity_ah: float, lag_s: float) -> None:
        """`lag_s`: the time constant of the correction by the voltage, s; shorter at first."""
        self._profile, self._battery = profile, profile.battery
        self._capacity_as = capacity_ah * SECONDS_PER_HOUR
        self._lag_s = lag_s
        self._readings = 0
        self.share = 1.0

    @property
    def known(self) -> bool:
        """Whether there has been a reading."""
        return self._readings > 0

    @property
    def volts(self) -> float:
        """The voltage at rest, V."""
        battery = self._battery
        return battery.empty_v + self.share * (battery.full_v - battery.empty_v)

    @property
    def joules(self) -> float:
        """The energy until it must be charged, J."""
        mean = 0.5 * (self.volts + self._battery.empty_v)
        return self.share * self._capacity_as * mean

    def update(self, volts: float, v: float, w: float, charging: bool, dt: float) -> bool:
        """Update the estimate with one cycle; return whether the voltage is plausible.

        The voltage is that at the terminals, V, speeds are as measured, m/s and rad/s, and `dt` is
        the time since the previous cycle, s.
        """
        battery = self._battery
        if not PLAUSIBLE[0] * battery.empty_v <= volts <= PLAUSIBLE[1] * battery.full_v:
            return False
        amperes = battery.idle_a + motor_power(self._profile, v, w) / volts
        if charging:
            taper = max(1.0 - battery.taper_from, 1e-3)
            amperes -= battery.charge_a * min(1.0, (1.0 - self.share) / taper)
        self._readings += 1
        rest = volts + battery.internal_ohm * amperes
        measured = (rest - battery.empty_v) / (battery.full_v - battery.empty_v)
        counted = self.share - amperes * dt / self._capacity_as
        gain = max(dt / self._lag_s, 1.0 / self._readings)
        self.share = min(max(counted + min(gain, 1.0) * (measured - counted), 0.0), 1.0)
        return True
