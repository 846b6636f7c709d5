"""The forward model: where the body goes if a command is obeyed and no other one comes.

One for all behaviours. A command is admissible only if the outline swept by all that it may lead
to stays clear of every known point: the idea of the dynamic window (Fox, Burgard and Thrun,
"The dynamic window approach to collision avoidance", 1997), rolled out from the *measured* speeds
because a command is not what the robot does: its ramps need time.

What is rolled out, from the cycle that the points answer:

1. the measured (v, w), or where their ramps have got to already, while nothing can change them:
   `Body.dead_s`, and the cycles that have passed since the points' own, and those that a
   contender's bid may still wait until it is cast;
2. the ramps towards the command, for as long as the robot's owner goes on without another one:
   `silence_s`, because whoever commands now may be dead or cut off in the next instant;
3. the ramps to rest.

So the time counted is what the society promises at the worst: a bid up to three cycles old, obeyed
for `silence_s`, and the controller's own lag. In the common case, a holder with obstacles of this
cycle, it is `silence_s` and the lag.

Frame: the body's at the cycle of the points; x forward, y left, m and rad. Times in s.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import cos, hypot, inf, pi, sin, sqrt
from typing import NamedTuple

from armadico.core.messages import Description, Point
from armadico.mobile.swept_path import Outline

Speeds = tuple[float, float]
"""(v, w) of the middle of the wheel axle, m/s and rad/s."""

LAG_CYCLES, LAG_S = 2.0, 0.2
"""From a status packet until the wheels follow what is commanded on it: the speed loops follow
their ramps 0.2 s late, however short a cycle is (measured on the simulated Pioneer, see LEAD_S
there)."""

STEP_RAD = 0.07
"""The outline is looked at so often while it turns: between two looks a corner that is 0.3 m away
moves 2 cm, and what it could miss is a notch of 1 cm between both."""

STEP_M = 0.08
"""And so often while it drives."""

STEPS = 40
"""At the most: a motion that would need more is looked at more coarsely."""

RAMP_STEPS = 80
"""Ramps are followed cycle by cycle, but in no more steps than so many: that is 8 s of a Pioneer's,
and it rests within 6 from all that it can do. Who says that it drives at 1,000 m/s, or brakes for a
day, costs no more work than this."""

INSTANT_S = 1e-9
"""So much beyond the end of a phase, it is over, whatever rounding says."""

QUARTER = 0.5 * pi

NO_NEARER_M = 1e-3
"""What is nearer than the margin may stay as near as it is: by so much it is rounding."""


def braking(left: float, decel: float, late: float) -> float:
    """The speed from which it comes to rest in so much, if it begins to brake so late (s)."""
    return decel * (sqrt(late * late + 2.0 * left / decel) - late) if left > 0.0 else 0.0


class Body(NamedTuple):
    """What the robot is and can, as its owner describes it (`robot/description`)."""

    outline: Outline
    cycle_s: float  # from one status packet to the next
    silence_s: float  # the owner goes on for so long without a command
    v_max: float  # m/s
    w_max: float  # rad/s
    v_accel: float  # m/s^2: the controller's ramps
    v_decel: float
    w_accel: float  # rad/s^2
    w_decel: float

    @classmethod
    def of(cls, said: Description) -> Body:
        """The body that a description is of."""
        return cls(
            Outline(said.front, said.rear, said.half_width),
            said.cycle_s,
            said.silence_s,
            said.v_max,
            said.w_max,
            said.v_accel,
            said.v_decel,
            said.w_accel,
            said.w_decel,
        )

    @property
    def dead_s(self) -> float:
        """How long the wheels go on as they are, whatever is commanded now, s."""
        return max(LAG_CYCLES * self.cycle_s, LAG_S)

    def stopping_distance(self, v: float, waited: float = 0.0) -> float:
        """Metres to rest straight ahead from v m/s, if nobody commands anything any more.

        `waited`: s that have passed since v was measured, or will pass before anybody commands.
        """
        v = abs(v)
        return v * (self.dead_s + self.silence_s + waited) + v * v / (2.0 * self.v_decel)

    def stops_within(self, free: float, waited: float = 0.0) -> float:
        """The speed from which that takes so many metres, m/s."""
        return braking(free, self.v_decel, self.dead_s + self.silence_s + waited)

    def stopping_turn(self, w: float, waited: float = 0.0) -> float:
        """Radians to rest from w rad/s, likewise."""
        w = abs(w)
        return w * (self.dead_s + self.silence_s + waited) + w * w / (2.0 * self.w_decel)


def ordered(body: Body, before: Speeds, now: Speeds) -> Speeds:
    """(v, w) that the ramps have got to when `now` is measured, and `before` a cycle earlier.

    The wheels follow `Body.dead_s` late. Where they speed up, the trend goes on for so long, as
    steep as the ramps at the most; where they slow down nothing is counted on.
    """
    return (
        _leads(before[0], now[0], body.v_accel, body),
        _leads(before[1], now[1], body.w_accel, body),
    )


def _leads(before: float, now: float, accel: float, body: Body) -> float:
    if abs(now) <= abs(before) or now * before < 0.0:
        return now
    lead = min(abs(now - before) / body.cycle_s, accel) * body.dead_s
    return now + lead if now > 0.0 else now - lead


class Step(NamedTuple):
    """Where the body is on its way: the axle's middle (m), its heading's cosine and sine; when."""

    x: float
    y: float
    cos: float
    sin: float
    at: float


def course(body: Body, measured: Speeds, wanted: Speeds, waited: float = 0.0) -> list[Step]:
    """The whole motion if `wanted` is commanded now, and then nothing more, until it rests.

    Args:
        body: Its ramps and times.
        measured: (v, w) by the wheels now.
        wanted: (v, w) commanded now.
        waited: s that the points are old, or that pass until the command is given.
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
    points: Iterable[Point],
    margin: float,
    *,
    waited: float = 0.0,
) -> float:
    """When the swept outline first has a point within `margin` m, s from now; inf if it never has.

    A point that is nearer already may stay as near as it is, and may be left behind. The rest is as
    for `course`.
    """
    near = _within(body, measured, wanted, points, margin, waited=waited)
    if not near:
        return inf
    found = inf
    front, rear, half = body.outline
    way = course(body, measured, wanted, waited)
    for p in near:
        px, py = p.x, p.y
        least = min(margin, max(px - front, -rear - px, abs(py) - half) - NO_NEARER_M)
        before, behind, aside = front + least, -rear - least, half + least
        for x, y, c, s, at in way:
            dx, dy = px - x, py - y
            if behind < c * dx + s * dy < before and -aside < c * dy - s * dx < aside:
                found = min(found, at)
                break
    return found


def _within(
    body: Body,
    measured: Speeds,
    wanted: Speeds,
    points: Iterable[Point],
    margin: float,
    *,
    waited: float,
) -> list[Point]:
    """The points that the motion could come near at all: most are far, and cost no more than this.

    It goes no farther, and turns no farther, than from its greatest speeds all the time.
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
    return [p for p in points if behind < p.x < ahead and -aside < p.y < aside]


def _ramp(now: float, to: float, up: float, down: float) -> float:
    """One step of the controller's ramp; through zero it brakes first."""
    if now < 0.0 or (now == 0.0 and to < 0.0):
        return -_ramp(-now, -to, up, down)
    if to >= now:
        now += up
        return now if now < to else to
    now -= down
    to = max(to, 0.0)
    return now if now > to else to
