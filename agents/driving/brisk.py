"""Goto's `brisk` controller: as fast along the line as the robot's ramps and turns allow.

The thesis's laws slow down in proportion to the remaining distance, so half a metre takes as long
as five. This one uses the speed from which the robot can still stop, turn into the next leg, or
stop turning: `braking`. It steers from the predicted pose when the wheels follow (`late_s`). Its
turn rate has a bounded acceleration and jerk, so that it turns fast and smoothly.

Near the goal it turns to the goal's heading while it brakes.
"""

from __future__ import annotations

from math import cos, inf, sin, sqrt

from msgspec.structs import replace

from armadico.agents.methods.geometry import Placed, Posed, Positioned, clip, direction, distance
from armadico.agents.methods.settings import Brisk
from armadico.mobile.geometry import wrap
from armadico.mobile.motion import Body, Speeds, braking
from armadico.mobile.route import Route

SAME_M = 0.02
"""Waypoints closer than this are one."""

RESTS_M_S = 0.03
"""At less than this speed it does not approach the goal any more."""


def slowed(settings: Brisk, body: Body, v_max: float | None) -> Brisk:
    """The settings within the limits of a robot and of a scenario (m/s)."""
    v, w = min(settings.v, v_max or inf, body.v_max), min(settings.w, body.w_max)
    v_decel, w_accel = min(settings.v_decel, body.v_decel), min(settings.w_accel, body.w_accel)
    return replace(
        settings,
        v=v,
        w=w,
        v_decel=v_decel,
        w_accel=w_accel,
        w_decel=min(settings.w_decel, body.w_decel),
        park_decel=min(settings.park_decel, body.w_decel),
    )


class Driver:
    """Drives along a route and parks at its end."""

    def __init__(self, settings: Brisk) -> None:
        self.settings = settings
        self.reset()

    def reset(self) -> None:
        self._turning = False
        self._accel = 0.0
        self.off_m = 0.0  # the pose's standard deviation

    def steer(
        self, pose: Posed, measured: Speeds, before: Speeds, route: Route, cut: float, period: float
    ) -> Speeds:
        s = self.settings
        there = self.soon(pose, measured, before)
        goal = route.goal
        assert goal is not None, "there is a goal"
        self._settle(pose, measured, goal, route)
        if self._turning:
            return self._park(there, goal, before, period)
        ahead = self._ahead(there, route, s.look_m + s.look_s * max(measured[0], 0.0), cut)
        off = wrap(direction(there, ahead) - there.theta)
        return self.toward(off, there, route, before, period)

    def toward(
        self, off: float, there: Placed, route: Route, before: Speeds, period: float
    ) -> Speeds:
        """The speeds to turn by `off` from the predicted pose and continue along the route."""
        v = min(self.settings.v, self._calm(off), self._corners(there, route))
        return v, self._smooth(before[1], self._turn(off, self.settings.w_decel), period)

    def _park(self, there: Placed, goal: Posed, before: Speeds, period: float) -> Speeds:
        """The speeds to stop beside the goal while turning to its heading."""
        s = self.settings
        left = distance(there, goal) * cos(direction(there, goal) - there.theta)
        v = braking(left - s.short_m, s.v_decel, s.late_s)
        off = wrap(goal.theta - there.theta)
        w = 0.0 if abs(off) <= s.stop_rad else self._turn(off, s.park_decel)
        return v, self._smooth(before[1], w, period)

    def soon(self, pose: Posed, measured: Speeds, before: Speeds) -> Placed:
        """The predicted pose when the wheels follow."""
        late = self.settings.late_s
        v, w = 0.5 * (measured[0] + before[0]), 0.5 * (measured[1] + before[1])
        middle = pose.theta + 0.5 * late * w
        way = late * v
        x, y = pose.x + way * cos(middle), pose.y + way * sin(middle)
        return Placed(x, y, pose.theta + late * w)

    def _settle(self, pose: Posed, measured: Speeds, goal: Posed, route: Route) -> None:
        s, rho = self.settings, distance(pose, goal)
        if self._turning:  # it stops within its tolerance, or approaches again
            rests = rho <= max(s.leave_m, self.off_m)  # beyond, it could be nearer than it knows
            self._turning = rests or (rho <= s.turn_m and measured[0] > RESTS_M_S)
        elif route.last_leg:
            abeam = cos(direction(pose, goal) - pose.theta) <= 0.0
            self._turning = rho <= (s.beside_m if abeam else s.turn_m)

    def _ahead(self, at: Placed, route: Route, look: float, cut: float) -> Posed:
        """The point to steer to, on the last leg's line beyond the goal if needed."""
        points = route.ahead(at.x, at.y, look, cut)
        if len(points) > 1 or not route.last_leg:
            return points[0]
        goal = points[0]
        away = distance(at, goal)
        leg = route.direction
        along = cos(leg) * (goal.x - at.x) + sin(leg) * (goal.y - at.y)
        if away >= look or abs(sqrt(max(away**2 - along**2, 0.0))) > self.settings.on_line_m:
            return goal
        more = look - along
        return Placed(goal.x + more * cos(leg), goal.y + more * sin(leg))

    def _turn(self, off: float, decel: float) -> float:
        s = self.settings
        w = min(s.w, braking(abs(off), decel, s.turn_s))
        return w if off > 0.0 else -w

    def _calm(self, off: float) -> float:
        s = self.settings
        return s.v * clip(1.0 - (abs(off) - s.calm_from) / s.calm_over, 0.0, 1.0)

    def _corners(self, at: Placed, route: Route) -> float:
        """The speed from which it can still turn into the next legs and stop at the goal, m/s."""
        s = self.settings
        most, way = inf, 0.0
        before: tuple[float, float] | None = None
        here: Positioned = at
        for to in route.waypoints[route.leg :]:
            length = distance(here, to)
            if length < SAME_M:
                continue
            heading = direction(here, to)
            if before is not None:
                bend = abs(wrap(heading - before[0]))
                over = clip(0.5 * (length + before[1]), SAME_M, s.corner_m)
                v = max(s.corner_w * over / max(bend, 1e-6), s.corner_v)
                left = max(way - 0.5 * over, 0.0)
                most = min(most, v + braking(left, s.v_decel, v / s.v_decel + s.late_s))
            way += length
            here, before = to, (heading, length)
            if way > s.v**2 / s.v_decel + s.corner_m:
                return most
        return min(most, braking(way, s.v_decel, s.late_s))

    def _smooth(self, before: float, wanted: float, period: float) -> float:
        s = self.settings
        accel = clip((wanted - before) / s.settle_s, -s.w_accel, s.w_accel)
        step = s.w_jerk * period
        self._accel = clip(accel, self._accel - step, self._accel + step)
        return before + self._accel * period
