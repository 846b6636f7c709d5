"""Avoid's three zones (thesis 3.5.2, figure 3.16), and its rules as in the text."""

from __future__ import annotations

from math import atan2, copysign, hypot, radians
from typing import Annotated

from msgspec import Meta, Struct

from armadico.agents.methods.utility import ramp_down
from armadico.core import agent
from armadico.core.exchange import Bid
from armadico.core.messages import Point
from armadico.mobile.geometry import turning_circle
from armadico.mobile.obstacles import Obstacles
from armadico.mobile.swept_path import Outline

NonNegative = Annotated[float, Meta(ge=0, le=10)]
Positive = Annotated[float, Meta(gt=0, le=10)]


class Zone(Struct, frozen=True, forbid_unknown_fields=True):
    """The border of a zone: a distance plus a time, so that it grows with the speed."""

    distance_m: NonNegative
    time_s: NonNegative

    def border(self, v: float) -> float:
        """The border at a speed (m/s), m."""
        return self.distance_m + self.time_s * abs(v)


class ZoneParameters(agent.Parameters, frozen=True, kw_only=True):
    """The zones, and the robot's speeds and turn rates in each."""

    v_max: Positive | None = None
    stop: Zone = Zone(0.05, 0.25)
    danger: Zone = Zone(0.20, 0.55)
    caution: Zone = Zone(0.45, 1.30)
    v_top: Positive = 0.55  # at the caution zone's outer border, m/s
    v_caution: Positive = 0.38  # at its inner border
    v_danger: NonNegative = 0.12  # at the danger zone's inner border
    turn_gain: Positive = 1.7  # rad/s per rad
    w_max: Positive = radians(60)
    w_stop: Positive = radians(45)
    abeam: Positive = radians(80)  # thesis: bearing to which an obstacle is steered
    u_heading_low: Positive = radians(40)
    u_heading_high: Positive = radians(120)


def literal(obstacles: Obstacles, v: float, outline: Outline, p: ZoneParameters) -> Bid | None:
    """The bid by equations 3.8 and 3.9, with the closest point and the closest one in front.

    `v` is the measured speed, m/s. None without an obstacle in the way.
    """
    around = turning_circle(*outline)  # subtracted from a range, it gives the distance left
    borders = [zone.border(v) for zone in (p.stop, p.danger, p.caution)]
    best: tuple[float, float, Point] | None = None
    for point in (obstacles.closest, obstacles.front):
        if point is None:
            continue
        left = max(hypot(point.x, point.y) - around, 0.0)
        bearing = abs(atan2(point.y, point.x))
        utility = min(
            ramp_down(bearing, p.u_heading_low, p.u_heading_high),
            ramp_down(left, borders[0], borders[2]),
        )
        if best is None or utility > best[0]:
            best = (utility, left, point)
    if best is None or best[0] <= 0.0:
        return None
    utility, left, point = best
    time_left = left / max(abs(v), 0.02)
    return Bid(utility, _action(left, point, borders, p), within=time_left)


def _action(
    left: float, point: Point, borders: list[float], p: ZoneParameters
) -> tuple[float, float]:
    """Slow down; slow down and turn away; stop and turn round."""
    stop, danger, caution = borders
    top = p.v_max or p.v_top
    slow = min(p.v_caution, top)
    bearing = atan2(point.y, point.x)
    if left < stop:
        return 0.0, -copysign(p.w_stop, bearing)
    if left < danger:
        share = (left - stop) / max(danger - stop, 1e-6)
        error = bearing - copysign(p.abeam, bearing)
        least = min(p.v_danger, top)
        turn = max(-p.w_max, min(p.w_max, p.turn_gain * error))
        return least + share * (slow - least), turn
    share = (left - danger) / max(caution - danger, 1e-6)
    return slow + share * (top - slow), 0.0
