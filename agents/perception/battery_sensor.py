"""The battery sensor agent: estimates the battery's charge and publishes alarms (thesis 3.4.3)."""

from __future__ import annotations

from math import floor, inf
from typing import Annotated, ClassVar

from msgspec import Meta

from armadico.agents.perception.battery import Gauge
from armadico.config.profile import load_profile
from armadico.core import agent
from armadico.core.agent import WARNING, Agent
from armadico.core.messages import Cycle, Message, RobotState
from armadico.mobile.messages import BatteryAlarm, BatteryLevel

Seconds = Annotated[float, Meta(gt=0, le=3600)]

# A longer cycle counts as this long: the voltage shows what was used during a gap.
LONGEST_S = 1.0

ALARM_STEP_V = 0.1


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
