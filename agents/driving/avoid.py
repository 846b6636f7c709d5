"""The avoid agent: keeps the robot off what is in its way (thesis 3.5.2, 3.10.1)."""

from __future__ import annotations

from collections.abc import Sequence
from math import atan2, copysign, cos, hypot, inf, pi, radians, sin
from typing import Any, ClassVar, Literal, NamedTuple

from armadico.agents.driving.free_heading import open_heading
from armadico.agents.driving.thesis_avoid import NonNegative, Positive, ZoneParameters, literal
from armadico.agents.methods.utility import ramp_down
from armadico.core import agent
from armadico.core.exchange import Bid
from armadico.core.messages import Point, RobotState
from armadico.core.parameters import TURN_MARGIN_M, Safety
from armadico.core.resources import WHEELS
from armadico.mobile.behaviour import Behaviour
from armadico.mobile.geometry import wrap
from armadico.mobile.messages import Pose
from armadico.mobile.obstacles import Obstacles
from armadico.mobile.safety import ON_THE_SPOT_M_S, Scene, corner_cut, critical
from armadico.mobile.swept_path import free_path, free_turn

FLANKS = ((1.0, 0.0), (0.5, 0.2), (0.2, 0.5), (0.0, 0.8))
"""Shares of the flank that is kept beside the body, and what a tight fit costs, rad."""

LOOKED_AWAY_S = 0.5
"""Longer than this without a bid, and it does not know whether the robot stood still, s."""

LEAST_REACH_M = 0.3
"""An open heading must be open for so long at least, before the body, however near the bend is."""

BACK_MARGIN_M = 0.05
"""Kept all round while it backs off."""

BACK_STALL_S = 1.0
"""Still stalled so long after it began to back off, s, it is the way back that is not free."""

SMALL, LATCHED = radians(2), radians(15)


class Way(NamedTuple):
    """Where the trajectory leads: a heading in the body frame, rad, and how far until it bends, m.

    What lies beyond the bend is not in the way. Infinite if it goes on straight.
    """

    heading: float
    bend_m: float


class Parameters(ZoneParameters, frozen=True, kw_only=True):
    """The three zones (figure 3.16) and what is done in each.

    `rules` "thesis" reads 3.5.2 and 3.10.1 literally: distance and heading of the closest points,
    an obstacle in the danger zone is turned away from, in the stop zone the robot turns round.
    "safe" takes the free way along the robot's motion for the distance, and turns to the open
    heading nearest to where the trajectory leads.
    """

    rules: Literal["safe", "thesis"] = "safe"
    v_back: NonNegative = 0.08  # m/s, backwards off what it cannot turn from
    back_room_m: NonNegative = 0.1  # backs off only with more remembered free behind
    stuck_s: Positive = 2.0  # at rest for so long beyond `goal_m`, the robot is stuck
    goal_m: Positive = 0.4  # nearer to the goal than this it may rest
    escape_s: Positive = 2.5  # time for which avoid works it free
    nowhere_s: Positive = 8.0  # driven for so long within `nowhere_m` of one place, it is stuck
    nowhere_m: Positive = 0.35  # radius of such a place
    back_s: Positive = 3.0  # time for which avoid backs it off, or turns, before a new try
    let_go: Positive = radians(150)  # a trajectory farther behind than this no longer counts
    turn_first: Positive = radians(60)  # an open heading farther off is turned to on the spot
    aligned: Positive = radians(15)
    flank_m: NonNegative = 0.15  # kept beside the body on an open heading
    other_side: NonNegative = 0.8  # rad: what changing the side that something is dodged on costs
    reach_m: Positive = 1.1  # how far an open heading must be open
    ahead_m: Positive = 0.8  # where the trajectory leads: so far along it
    cut_least_m: Positive = 0.06  # by so much its corners may be cut where something is near
    safety: Safety = Safety(slow=0.12)


class Avoid(Behaviour):
    """Slows down, turns away, or stops and turns, as the nearest obstacle demands."""

    name = "avoid"
    reacts_to = Obstacles
    parameters = Parameters
    launched_with = ("v_max", "safety.unmapped")
    changeable: ClassVar = {
        "v_max": "m/s",
        "v_top": "m/s",
        "v_caution": "m/s",
        "v_danger": "m/s",
        "w_max": "rad/s",
        "flank_m": "m",
        "safety.margin_m": "m",
    }
    borders: ClassVar = {
        "stop": Parameters().stop.border,
        "danger": Parameters().danger.border,
        "caution": Parameters().caution.border,
    }
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Any = None) -> None:
        super().__init__(identity, parameters)
        self._side = 0.0  # +1 left, -1 right: latched while the same thing is dodged
        self._side_at: tuple[float, float] = (0.0, 0.0)
        self._moved_at = inf  # when the robot was last seen to move on its mission
        self._looked_at = -inf  # when it last looked: not while the robot is stopped
        self._escape_until = -inf
        self._around: tuple[float, float] = (inf, inf)  # the place that it does not get away from
        self._around_since = inf
        self._turned_out = False  # of that place, or has tried to
        self._back_until = -inf
        self._backs_since = inf
        self._turns_until = -inf

    def on_mission(self) -> None:
        """Nothing is dodged yet."""
        self._side = 0.0
        self._moved_at = self._around_since = self.now

    def propose(self, pose: Pose, obstacles: Obstacles) -> Bid | None:
        """How to keep off what is in the way, and how much that helps."""
        state = self.latest(RobotState)
        assert state is not None, "nobody bids without robot/state"
        if self.p.rules == "safe":
            return self._safe(obstacles, pose, state)
        bid = literal(obstacles, state.v, self.body.outline, self.p)
        if bid is None:
            self.why = "nothing in the way"
        return bid

    def _safe(self, obstacles: Obstacles, pose: Pose, state: RobotState) -> Bid | None:
        p, points, scene = self.p, obstacles.points, self.scene(obstacles)
        v, way = max(state.v, 0.0), self._way(pose, obstacles)
        along = self._along(points, v, state.w)
        free = min(along, self._toward(points, way))
        utility = ramp_down(free, p.stop.border(v), p.caution.border(v))
        if self._stuck(pose, state):
            utility = 1.0
        self._unlatch(pose)
        if utility <= 0.0:
            if not self.holds(WHEELS):
                self.why = "nothing in the way"
                return None
            return Bid(0.0, self._onward(scene, way.heading, v), reason="the way is free")
        action, reason = self._act(scene, way, pose, v)
        left = along - self.body.stopping_distance(v)
        within = None if left == inf else max(0.0, 0.5 * left / max(v, 0.05))
        return Bid(utility, action, critical(scene, p.safety), within, reason)

    def _along(self, points: Sequence[Point], v: float, w: float) -> float:
        """The free way on the present arc, m; on the spot there is none to be free."""
        if v <= ON_THE_SPOT_M_S:
            return inf
        return free_path(points, v, w, self.body.outline, self.p.safety.margin_m)

    def _toward(self, points: Sequence[Point], way: Way) -> float:
        """The free way to where the trajectory leads, m, once it has turned there.

        While avoid holds this counts whatever the angle: else it would let go as soon as it has
        turned away, only for the other to turn back. Before, what is far aside is not in the way.
        """
        limit_angle = self.p.let_go if self.holds(WHEELS) else self.p.u_heading_low
        if abs(way.heading) > limit_angle:
            return inf
        turned = _rotated(points, way.heading)
        free = free_path(turned, 1.0, 0.0, self.body.outline, self.p.safety.margin_m)
        return free if free < way.bend_m else inf

    def _act(self, scene: Scene, way: Way, pose: Pose, v: float) -> tuple[tuple[float, float], str]:
        """The zones, by the free way along the open heading: slow down; and turn; stop and turn."""
        p, points, outline = self.p, scene.points, self.body.outline
        if self.now < self._back_until and (back := self._back(scene)) is not None:
            return back, "back off and try again"
        heading = self._heading(points, way, pose)
        if heading is None:
            return self._turn_on_the_spot(scene, way.heading), "shut in: look for a way out"
        free = free_path(_rotated(points, heading), 1.0, 0.0, outline, TURN_MARGIN_M)
        now = free_path(points, 1.0, 0.0, outline, TURN_MARGIN_M)
        speed, zone = self._zone(min(free, now), v)
        speed *= max(0.0, cos(heading))
        if zone == "stop" or abs(heading) > p.turn_first:
            speed = 0.0 if abs(heading) > p.aligned else min(speed, p.v_danger)
        w = max(-p.w_max, min(p.w_max, p.turn_gain * heading))
        speed, w, _ = self.limited_in(scene, speed, w, p.safety)
        degrees = heading * 180 / pi
        turns = speed < 0.02
        self._turned_out |= turns and self.now < self._escape_until
        if turns and abs(w) < 0.05:
            return self._turn_on_the_spot(scene, heading), f"{zone}: turn out to {degrees:.0f} deg"
        return (speed, w), f"{zone}: open at {degrees:.0f} deg"

    def _zone(self, free: float, v: float) -> tuple[float, str]:
        """The speed for a free way, m/s, and the zone's name."""
        p = self.p
        stop, danger, caution = (zone.border(v) for zone in (p.stop, p.danger, p.caution))
        top = min(p.v_max or inf, p.v_top)
        if free >= danger:
            share = min((free - danger) / max(caution - danger, 1e-6), 1.0)
            return min(p.v_caution + share * (top - p.v_caution), top), "caution"
        if free >= stop:
            share = (free - stop) / max(danger - stop, 1e-6)
            return min(p.v_danger + share * (p.v_caution - p.v_danger), top), "danger"
        return 0.0, "stop"

    def _heading(self, points: Sequence[Point], way: Way, pose: Pose) -> float | None:
        """The open heading that costs least: off the wanted one, off the present one, a tight fit.

        The side on which something is dodged is latched: the other one must be much better.
        """
        best: tuple[float, float] | None = None
        wanted, outline = way.heading, self.body.outline
        reach = min(self.p.reach_m, outline.front + max(way.bend_m, LEAST_REACH_M))
        for flank, tight in FLANKS:
            half = outline.half_width + flank * self.p.flank_m
            for side in (1.0, -1.0):
                found = open_heading(points, wanted, half, reach, side)
                if found is None:
                    continue
                off = wrap(found - wanted)
                other = self._side != 0.0 and off * self._side < -SMALL
                cost = abs(off) + 0.4 * abs(found) + tight + (self.p.other_side if other else 0.0)
                if best is None or cost < best[0]:
                    best = (cost, found)
        if best is None:
            return None
        off = wrap(best[1] - wanted)
        if abs(off) > LATCHED and copysign(1.0, off) != self._side:
            self._side, self._side_at = copysign(1.0, off), (pose.x, pose.y)
        return best[1]

    def _stuck(self, pose: Pose, state: RobotState) -> bool:
        """Whether the robot gets nowhere, far from its goal: then avoid works it free.

        Whoever holds the wheels may see no way and command nothing, with nothing in *its* way; or
        two turn it to and fro. If no agent is obeyed, none drives, and that is not for avoid to
        mend.
        """
        ack = self.acked(WHEELS)
        at = None if ack is None or ack.obeyed is None else ack.obeyed_cycle
        driven = at is not None and self.cycles.fresh(at)
        looked_away, self._looked_at = self._looked_away, self.now
        near = self.route.to_go(pose.x, pose.y) < self.p.goal_m
        excused = looked_away or near or not driven
        self._watch_rest(excused or abs(state.v) > 0.02 * self.sureness or abs(state.w) > 0.05)
        self._watch_place(pose, excused)
        self._watch_stall(state.stalled)
        return self.now < max(self._escape_until, self._back_until)

    @property
    def _looked_away(self) -> bool:
        return self.now - self._looked_at > LOOKED_AWAY_S

    def _watch_rest(self, moving: bool) -> None:
        if moving:
            self._moved_at = self.now
        elif self.now - self._moved_at > self.p.stuck_s:
            self._moved_at = self.now
            if self._turned_out:  # too near to something, or it was turned back
                self._back_off()
            else:
                self._escape_until = self.now + self.p.escape_s

    def _watch_place(self, pose: Pose, excused: bool) -> None:
        away = hypot(pose.x - self._around[0], pose.y - self._around[1])
        if away > self.p.nowhere_m:
            self._around, self._around_since = (pose.x, pose.y), self.now
            self._turned_out = False
        elif excused:
            self._around_since = self.now
        elif self.now - self._around_since > self.p.nowhere_s / self.sureness:
            self._around_since = self.now
            self._back_off()

    def _watch_stall(self, stalled: bool) -> None:
        """What stalls the wheels is touched, at an unknown place of the body.

        Whoever turns may push it with a corner, for as long as it turns. The way that it came is
        free; unless it is stalled on that: then it turns for as long before it tries that again.
        """
        if not stalled or self.now < self._turns_until:
            return
        if self.now >= self._back_until:
            self._back_off()
        elif self.now - self._backs_since > BACK_STALL_S:
            self._back_until, self._turns_until = self.now, self.now + self.p.back_s

    def _back_off(self) -> None:
        self._backs_since, self._back_until = self.now, self.now + self.p.back_s

    def _back(self, scene: Scene) -> tuple[float, float] | None:
        """Straight back, if there is room behind."""
        mirrored = [Point(-p.x, p.y) for p in scene.points]
        behind = free_path(mirrored, 1.0, 0.0, self.body.outline.turned_round, BACK_MARGIN_M)
        if behind <= self.p.back_room_m:
            return None
        v, w, _ = self.limited_in(scene, -self.p.v_back, 0.0, self.p.safety)
        return (v, w) if v < 0.0 else None

    def _unlatch(self, pose: Pose) -> None:
        """Forget the side once the dodge is far behind and avoid does not hold."""
        away = hypot(pose.x - self._side_at[0], pose.y - self._side_at[1])
        if self._side and not self.holds(WHEELS) and away > 1.0:
            self._side = 0.0

    def _turn_on_the_spot(self, scene: Scene, heading: float) -> tuple[float, float]:
        """Turn to the side of the open heading, or the other; if neither goes, back off."""
        sign = self._side or copysign(1.0, heading)
        for direction in (sign, -sign):
            room = free_turn(scene.points, direction, self.body.outline, TURN_MARGIN_M)
            if room > self.p.safety.turn_room:
                v, w, _ = self.limited_in(scene, 0.0, direction * self.p.w_stop, self.p.safety)
                if w != 0.0:
                    return v, w
        return self._back(scene) or (0.0, 0.0)

    def _onward(self, scene: Scene, wanted: float, v: float) -> tuple[float, float]:
        """What to command in the cycle or two until another agent takes over."""
        w = max(-self.p.w_max, min(self.p.w_max, self.p.turn_gain * wanted))
        return self.limited_in(scene, v, w, self.p.safety)[:2]

    def _way(self, pose: Pose, obstacles: Obstacles) -> Way:
        """Where the trajectory leads; it bends or ends if the point ahead is nearer than asked."""
        cut = corner_cut(obstacles, self.body, self.p.cut_least_m)
        target = self.route.ahead(pose.x, pose.y, self.p.ahead_m, cut)[0]
        dx, dy = target.x - pose.x, target.y - pose.y
        away = hypot(dx, dy)
        bends = away < 0.99 * self.p.ahead_m
        return Way(wrap(atan2(dy, dx) - pose.theta), away if bends else inf)


def _rotated(points: Sequence[Point], heading: float) -> list[Point]:
    """The points as seen after turning on the spot."""
    c, s = cos(heading), sin(heading)
    return [Point(c * p.x + s * p.y, c * p.y - s * p.x) for p in points]
