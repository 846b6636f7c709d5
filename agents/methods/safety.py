"""How fast is safe: every behaviour that moves the robot asks this of the points it knows.

Nobody drives blind, and nobody faster than it can stop: a behaviour's speed is limited so that,
braking as the controller does, it would come to rest before the nearest remembered point on its
arc; and it does not turn on the spot where a corner would swing into something.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import inf, sqrt
from typing import Annotated

from msgspec import Meta, Struct

from armadico.agents.methods.sweep import Outline, free_path, free_turn
from armadico.messages import Point

LATENCY_S = 0.2
"""Two frames: a sonar echo to a command, and the command to the wheels."""


ARCS = 8
"""Arcs that are looked at, each tighter than the one before, to find one that is slow enough."""


class Safety(Struct, frozen=True, forbid_unknown_fields=True):
    """Margins around the body and the braking that is counted on."""

    margin_m: Annotated[float, Meta(ge=0, le=1)] = 0.06
    decel: Annotated[float, Meta(gt=0, le=10)] = 0.4  # m/s^2; the controller brakes with 0.6
    creep: Annotated[float, Meta(ge=0, le=1)] = 0.0  # m/s that is always allowed
    turn_room: Annotated[float, Meta(ge=0, le=3.2)] = 0.12  # rad free, or it does not turn


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


def limit(
    v: float, w: float, points: Sequence[Point], safety: Safety
) -> tuple[float, float, float]:
    """The same motion as fast as is safe, and how far its way was free: (v, w, free).

    Slowing keeps w: the robot turns tighter as it comes nearer, away from or along what is there.
    The tighter arc may end sooner than the one that was asked for, so it is looked at again.
    """
    free = ahead = free_path(points, v, w, OUTLINE, safety.margin_m) if v > 0.0 else inf
    for _ in range(ARCS):
        safe = max(safe_speed(ahead, safety.decel), safety.creep)
        if v <= safe:
            break
        v = safe
        ahead = free_path(points, v, w, OUTLINE, safety.margin_m)
    if v < 0.05 and w != 0.0 and free_turn(points, w, OUTLINE, 0.02) < safety.turn_room:
        w = 0.0
    return v, w, free
