"""How fast is safe: every behaviour that moves the robot asks this of the points it knows.

Nobody drives blind, and nobody faster than it can stop: a behaviour's speed is limited so that,
braking as the controller does, it would come to rest before the nearest remembered point on its
arc; and it does not turn on the spot where a corner would swing into something.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot, inf, sqrt
from typing import Annotated

from msgspec import Meta, Struct

from armadico.agents.methods.sweep import Outline, free_path, free_turn
from armadico.messages import Obstacles, Point

LATENCY_S = 0.2
"""Two cycles: a sonar echo to a command, and the command to the wheels."""


ARCS = 8
"""Arcs that are looked at, each tighter than the one before, to find one that is slow enough."""


class Safety(Struct, frozen=True, forbid_unknown_fields=True):
    """Margins around the body and the braking that is counted on."""

    margin_m: Annotated[float, Meta(ge=0, le=1)] = 0.08
    slow: Annotated[float, Meta(ge=0, le=1)] = 0.0  # m/s: at no more than this
    close_m: Annotated[float, Meta(ge=0, le=1)] = 0.02  # so small a margin will do
    decel: Annotated[float, Meta(gt=0, le=10)] = 0.4  # m/s^2; the controller brakes with 0.6
    creep: Annotated[float, Meta(ge=0, le=1)] = 0.0  # m/s that is always allowed
    turn_decel: Annotated[float, Meta(gt=0, le=20)] = 1.4  # rad/s^2; the controller's is 1.75
    turn_room: Annotated[float, Meta(ge=0, le=3.2)] = 0.12  # rad free, or it does not turn


ON_THE_SPOT_M_S = 0.05
"""Slower than this the robot turns on the spot, and its corners swing,"""

TURN_MARGIN_M = 0.02
"""with so much kept all round."""

CORNER_ROOM_M = 0.45
"""Nearer to something than this, axle to obstacle, a corner of the trajectory is not cut."""

OUTLINE = Outline()


def stopping_distance(v: float, decel: float) -> float:
    """Metres to rest from v m/s, the latency included."""
    return v * LATENCY_S + v * v / (2.0 * decel)


def safe_speed(free: float, decel: float) -> float:
    """The speed, m/s, from which it comes to rest within `free` metres, the latency included."""
    if free == inf:
        return inf
    t = LATENCY_S * decel
    return sqrt(t * t + 2.0 * decel * max(free, 0.0)) - t


def turn_speed(room: float, safety: Safety) -> float:
    """The turn rate, rad/s, from which it comes to rest within `room` rad, the latency included."""
    return safe_speed(room, safety.turn_decel)


def limit(
    v: float, w: float, points: Sequence[Point], safety: Safety
) -> tuple[float, float, float]:
    """The same motion as fast as is safe, and how far its way was free: (v, w, free).

    Slowing keeps w: the robot turns tighter as it comes nearer, away from or along what is there.
    The tighter arc may end sooner than the one that was asked for, so it is looked at again. Where
    the margin leaves next to nothing, `safety.slow` is driven with a smaller one.
    """
    asked = v
    free = ahead = free_path(points, v, w, OUTLINE, safety.margin_m) if v > 0.0 else inf
    for _ in range(ARCS):
        safe = max(safe_speed(ahead, safety.decel), safety.creep)
        if v <= safe:
            break
        v = safe
        ahead = free_path(points, v, w, OUTLINE, safety.margin_m)
    slow = min(asked, safety.slow)
    if 0.0 <= v < slow:
        close = free_path(points, slow, w, OUTLINE, safety.close_m)
        squeezed = min(slow, safe_speed(close, safety.decel))
        if squeezed > v:
            v, ahead = squeezed, close
    share = _turn_share(v, w, ahead, points, safety)
    return v * share if v > 0.0 and share > 0.0 else v, w * share, free


def _turn_share(v: float, w: float, ahead: float, points: Sequence[Point], safety: Safety) -> float:
    """The share of a motion at which its turning, too, can be stopped before something is met."""
    if w == 0.0:
        return 1.0
    if v >= ON_THE_SPOT_M_S:
        room = ahead * abs(w) / v
    else:
        room = free_turn(points, w, OUTLINE, TURN_MARGIN_M)
        if room < safety.turn_room:
            return 0.0
    return min(turn_speed(room, safety) / abs(w), 1.0)


def corner_cut(obstacles: Obstacles, least: float) -> float:
    """How far off the trajectory's corners a way may lead, m: little where something is near."""
    near = obstacles.closest
    return inf if near is None else max(least, hypot(near.x, near.y) - CORNER_ROOM_M)
