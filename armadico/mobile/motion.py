"""The forward model: the predicted motion if a command is obeyed and no other one follows.

All behaviours use it. A command is admissible only if the footprint, swept along the whole motion,
stays clear of every known point. That is the idea of the dynamic window (Fox, Burgard and Thrun,
"The dynamic window approach to collision avoidance", 1997). The motion is predicted from the
*measured* speeds, because the controller's ramps need time to reach a command.

The prediction begins at the cycle of the points:

1. the measured (v, w), or the speeds that their ramps have reached already, while nothing can
   change them: `Body.dead_s`, plus the age of the points, plus the time that a contender's bid may
   wait before it is commanded;
2. the ramps towards the command, for the owner's command timeout `silence_s`, because the
   commanding agent may fail immediately afterwards;
3. the ramps to rest.

So it covers the worst case of the society: a bid up to three cycles old, obeyed for `silence_s`,
and the controller's lag. In the common case, a holder with obstacles of this cycle, it covers
`silence_s` and the lag.

Frame: the body's at the cycle of the points; x forward, y left, m and rad. Times in s.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import cos, hypot, inf, pi, sin, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from armadico.core.messages import Description, Point
from armadico.mobile.swept_path import Outline

Floats = NDArray[np.float64]
Speeds = tuple[float, float]  # (v, w) of the middle of the wheel axle, m/s and rad/s

# From a status packet until the wheels follow a command on it, in cycles, and at least in s: the
# speed loops follow their ramps 0.2 s late, however short a cycle is (measured on the simulated
# Pioneer, see LEAD_S there).
LAG_CYCLES, LAG_S = 2.0, 0.2

# Rotation between two checks of the footprint. A corner 0.3 m away moves 2 cm, so a notch of 1 cm
# may be missed.
STEP_RAD = 0.07
STEP_M = 0.08  # translation between two checks of the footprint
STEPS = 40  # a motion that would need more checks is checked more coarsely

# Most steps of the ramps, which are followed cycle by cycle: 8 s of a Pioneer, which rests within 6
# s from its top speeds. It limits the work for a description with 1,000 m/s, or a day of braking.
RAMP_STEPS = 80

INSTANT_S = 1e-9  # a phase is over this much after its end, in spite of rounding
QUARTER = 0.5 * pi
NO_NEARER_M = 1e-3  # rounding, for a point that is nearer than the margin and may stay as near
ROUNDING_M = 1e-9


def braking(left: float, decel: float, late: float) -> float:
    """Return the speed from which braking at `decel` after `late` s takes a distance `left`."""
    return decel * (sqrt(late * late + 2.0 * left / decel) - late) if left > 0.0 else 0.0


class Body(NamedTuple):
    """The robot's footprint and limits, as its owner describes it (`robot/description`)."""

    outline: Outline
    cycle_s: float  # from one status packet to the next
    silence_s: float  # the owner's command timeout
    v_max: float  # m/s
    w_max: float  # rad/s
    v_accel: float  # m/s^2: the controller's ramps
    v_decel: float
    w_accel: float  # rad/s^2
    w_decel: float

    @classmethod
    def of(cls, about: Description) -> Body:
        return cls(
            Outline(about.front, about.rear, about.half_width),
            about.cycle_s,
            about.silence_s,
            about.v_max,
            about.w_max,
            about.v_accel,
            about.v_decel,
            about.w_accel,
            about.w_decel,
        )

    @property
    def dead_s(self) -> float:
        """The dead time between a command and the wheels, s."""
        return max(LAG_CYCLES * self.cycle_s, LAG_S)

    def stopping_distance(self, v: float, waited: float = 0.0) -> float:
        """Return the distance to rest straight ahead from v m/s without further commands, m.

        `waited`: time since v was measured, or until the next command, s.
        """
        v = abs(v)
        return v * (self.dead_s + self.silence_s + waited) + v * v / (2.0 * self.v_decel)

    def stops_within(self, free: float, waited: float = 0.0) -> float:
        """Return the speed whose `stopping_distance` is `free` m, m/s."""
        return braking(free, self.v_decel, self.dead_s + self.silence_s + waited)

    def stopping_turn(self, w: float, waited: float = 0.0) -> float:
        """Return the angle to rest from w rad/s without further commands, rad."""
        w = abs(w)
        return w * (self.dead_s + self.silence_s + waited) + w * w / (2.0 * self.w_decel)


def ordered(body: Body, before: Speeds, now: Speeds, most: Speeds = (inf, inf)) -> Speeds:
    """Return the (v, w) of the ramps when `now` is measured, and `before` a cycle earlier.

    The wheels follow `Body.dead_s` late. While they accelerate, the trend is extrapolated by that
    time, at most as steep as the ramps, and to `most`: no ramp goes beyond the largest order of
    that time. While they brake, it is not.
    """
    return (
        _leads(before[0], now[0], body.v_accel, body, most[0]),
        _leads(before[1], now[1], body.w_accel, body, most[1]),
    )


def ramped(body: Body, now: Speeds, to: Speeds, after: float) -> Speeds:
    """Return the (v, w) that ramps from `now` towards `to` reach after a time, s."""
    return (
        _ramp(now[0], to[0], body.v_accel * after, body.v_decel * after),
        _ramp(now[1], to[1], body.w_accel * after, body.w_decel * after),
    )


def _leads(before: float, now: float, accel: float, body: Body, most: float) -> float:
    if abs(now) <= abs(before) or now * before < 0.0:
        return now
    lead = min(abs(now - before) / body.cycle_s, accel) * body.dead_s
    lead = min(lead, max(most - abs(now), 0.0))
    return now + lead if now > 0.0 else now - lead


class Step(NamedTuple):
    """A pose of the predicted motion: the axle's middle (m), cosine and sine of the heading."""

    x: float
    y: float
    cos: float
    sin: float
    at: float  # s from now


def course(body: Body, measured: Speeds, wanted: Speeds, waited: float = 0.0) -> list[Step]:
    """Return the motion until rest if `wanted` is commanded now, and nothing after.

    `measured` and `wanted` are (v, w); `waited` is the age of the points, or the time until the
    command, s.
    """
    (v, w), (to_v, to_w) = measured, wanted
    dead = waited + body.dead_s
    ends = dead + body.silence_s
    rest = max(abs(v), abs(to_v)) / body.v_decel + max(abs(w), abs(to_w)) / body.w_decel
    coarse = (ends + rest) / STEPS
    ramped = max(body.cycle_s, (ends + rest) / RAMP_STEPS)
    x = y = heading = at = 0.0
    steps: list[Step] = []
    while True:
        pace_v, pace_w = abs(v) / STEP_M, abs(w) / STEP_RAD
        pace = pace_v if pace_v > pace_w else pace_w  # steps a second
        step = 1.0 / pace if pace > 0.0 else inf
        step = max(step, coarse)
        if at < dead:
            left = dead - at + INSTANT_S
            step = step if step < left else left
            next_v, next_w = v, w
        else:
            step = min(step, ramped)
            if at < ends:
                left = ends - at + INSTANT_S
                step = step if step < left else left
                next_v = _ramp(v, to_v, body.v_accel * step, body.v_decel * step)
                next_w = _ramp(w, to_w, body.w_accel * step, body.w_decel * step)
            elif v == 0.0 and w == 0.0:
                return steps
            else:
                next_v = _ramp(v, 0.0, 0.0, body.v_decel * step)
                next_w = _ramp(w, 0.0, 0.0, body.w_decel * step)
        turn, way = 0.5 * (w + next_w) * step, 0.5 * (v + next_v) * step
        middle = heading + 0.5 * turn
        x += way * cos(middle)
        y += way * sin(middle)
        heading += turn
        v, w, at = next_v, next_w, at + step
        steps.append(Step(x, y, cos(heading), sin(heading), at))


def touches_at(
    body: Body,
    measured: Speeds,
    wanted: Speeds,
    points: Iterable[Point] | Floats,
    margin: float,
    *,
    waited: float = 0.0,
) -> float:
    """Return when the swept footprint first has a point within `margin` m, s from now; else inf.

    A point that is nearer already may stay as near, and may be left behind. Other arguments are as
    for `course`.
    """
    near = _within(body, measured, wanted, points, margin, waited=waited)
    if not len(near):
        return inf
    px, py = near[:, 0], near[:, 1]
    beside = clearances(body.outline, px, py)
    # The slack shrinks with the distance, to none within half of the margin, by which a point may
    # be wrong: else a robot that is told to drive on would come nearer by it in each cycle, until
    # it touches.
    slack = ROUNDING_M + NO_NEARER_M * np.clip(2.0 * beside / (margin or 1.0) - 1.0, 0.0, 1.0)
    least = np.minimum(margin, beside - slack)
    way = course(body, measured, wanted, waited)
    x, y, c, s, _ = np.array(way).reshape(-1, 5, 1).transpose(1, 0, 2)
    dx, dy = px - x, py - y
    met = clearances(body.outline, c * dx + s * dy, c * dy - s * dx) < least
    steps = np.flatnonzero(met.any(axis=1))
    return way[steps[0]].at if len(steps) else inf


def clearances(outline: Outline, x: Floats, y: Floats) -> Floats:
    """Return the distances of places from the footprint, m; negative inside of it."""
    front, rear, half = outline
    ahead, aside = np.maximum(x - front, -rear - x), np.abs(y) - half
    found: Floats = np.hypot(np.maximum(ahead, 0.0), np.maximum(aside, 0.0))
    return found + np.minimum(np.maximum(ahead, aside), 0.0)


def _within(
    body: Body,
    measured: Speeds,
    wanted: Speeds,
    points: Iterable[Point] | Floats,
    margin: float,
    *,
    waited: float,
) -> Floats:
    """Return the points within an upper bound of the motion, by its largest speeds.

    Most points are far away and are culled here.
    """
    front, rear, half = body.outline
    time = waited + body.dead_s + body.silence_s
    v = max(abs(measured[0]), min(abs(wanted[0]), abs(measured[0]) + body.v_accel * body.silence_s))
    w = max(abs(measured[1]), min(abs(wanted[1]), abs(measured[1]) + body.w_accel * body.silence_s))
    way = v * time + v * v / (2.0 * body.v_decel)
    turn = w * time + w * w / (2.0 * body.w_decel)
    if turn < QUARTER:
        s = sin(turn)
        ahead, behind = way + front + half * s, rear + half * s
        aside = way * s + half + max(front, rear) * s
        if measured[0] < 0.0 or wanted[0] < 0.0:
            behind += way
    else:
        ahead = behind = aside = way + hypot(max(front, rear), half)
    ahead, behind, aside = ahead + margin, -behind - margin, aside + margin
    if isinstance(points, np.ndarray):
        x, y = points[:, 0], points[:, 1]
        within: Floats = points[(behind < x) & (x < ahead) & (np.abs(y) < aside)]
        return within
    near = [(p.x, p.y) for p in points if behind < p.x < ahead and -aside < p.y < aside]
    return np.array(near, dtype=np.float64).reshape(-1, 2)


def _ramp(now: float, to: float, up: float, down: float) -> float:
    """Return the speed after one step of the controller's ramp; it brakes to zero first."""
    if now < 0.0 or (now == 0.0 and to < 0.0):
        return -_ramp(-now, -to, up, down)
    if to >= now:
        now += up
        return now if now < to else to
    left = now - down
    if to >= 0.0 or left >= 0.0:
        return left if left > to else to
    back = up * left / down  # the rest of the step, the other way
    return back if back > to else to
