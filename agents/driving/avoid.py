"""The avoid agent: keeps the robot clear of obstacles (thesis 3.5.2, 3.10.1)."""

from __future__ import annotations

from collections.abc import Sequence
from math import atan2, copysign, cos, hypot, inf, pi, radians
from typing import ClassVar, Literal, NamedTuple

from armadico.agents.driving.free_heading import open_heading
from armadico.agents.driving.thesis_avoid import NonNegative, Positive, ZoneParameters, literal
from armadico.agents.methods.geometry import rotated
from armadico.agents.methods.utility import ramp_down
from armadico.core import agent
from armadico.core.exchange import Bid
from armadico.core.messages import Point, RobotState
from armadico.core.parameters import TURN_MARGIN_M, Safety
from armadico.core.resources import WHEELS
from armadico.mobile.behaviour import MOSTLY, Behaviour
from armadico.mobile.geometry import wrap
from armadico.mobile.messages import Pose
from armadico.mobile.motion import Speeds
from armadico.mobile.obstacles import Obstacles
from armadico.mobile.offers import near, open_ways, repelled, speeds_of
from armadico.mobile.safety import ON_THE_SPOT_M_S, Scene, corner_cut, critical
from armadico.mobile.swept_path import free_path, free_turn

FLANKS = ((1.0, 0.0), (0.5, 0.2), (0.2, 0.5), (0.0, 0.8))
"""Shares of `flank_m` tried beside the footprint, and the cost of a tight fit, rad."""

ON_GOAL_M = 0.1
"""Nearer to its goal than this a robot that stands is to turn, and cannot. One that has turned is
held by goto, whose bid there is the largest."""

BID_GAP_S = 0.5
"""Longer than this without a bid, it does not know whether the robot stood still, s."""

KEEPS_S = 0.3
"""The way is free once it has been for so long, s. A wall beside the robot, nearer than the margin,
obstructs it by one reading and not by the next."""

LEAST_REACH_M = 0.3
"""Least distance, before the footprint, over which an open heading must be free, at any bend."""

BACK_MARGIN_M = 0.05
"""Clearance all round while it backs off."""

BACK_STALL_S = 1.0
"""Still stalled this long after it began to back off, s, the way back is blocked."""

SMALL, LATCHED = radians(2), radians(15)


class Way(NamedTuple):
    """Where the trajectory leads: heading in the body frame, rad, and distance to its next bend, m.

    Obstacles beyond the bend are not in the way. The distance is infinite on a straight line.
    """

    heading: float
    bend_m: float


class Parameters(ZoneParameters, frozen=True, kw_only=True):
    """The three zones (figure 3.16) and the behaviour in each.

    `rules` "thesis" follows 3.5.2 and 3.10.1 literally: it uses distance and heading of the closest
    points, turns away from an obstacle in the danger zone, and turns round in the stop zone. "safe"
    uses the free distance along the robot's motion, and turns to the open heading nearest to where
    the trajectory leads.
    """

    rules: Literal["safe", "thesis"] = "safe"
    v_back: NonNegative = 0.08  # m/s, off or along obstacles that it cannot turn away from
    back_room_m: NonNegative = 0.1  # least free distance behind for backing off
    stuck_s: Positive = 2.0  # at rest for this time beyond `goal_m`, the robot is stuck
    goal_m: Positive = 0.4  # nearer to the goal than this it may rest
    escape_s: Positive = 2.5  # time for which avoid frees a stuck robot
    nowhere_s: Positive = 8.0  # driven for this time within `nowhere_m` of one place, it is stuck
    nowhere_m: Positive = 0.35  # radius of such a place
    back_s: Positive = 3.0  # time for which avoid backs off, or turns, before a new try
    let_go: Positive = radians(150)  # a trajectory farther behind than this does not count
    turn_first: Positive = radians(60)  # it turns on the spot to an open heading farther off
    aligned: Positive = radians(15)
    flank_m: NonNegative = 0.15  # clearance beside the footprint on an open heading
    other_side: NonNegative = 0.8  # rad: cost of changing the side on which an obstacle is passed
    reach_m: Positive = 1.1  # distance over which an open heading must be free
    ahead_m: Positive = 0.8  # look-ahead on the trajectory
    cut_least_m: Positive = 0.06  # by how much its corners may be cut near obstacles
    safety: Safety = Safety(slow=0.12)


class Avoid(Behaviour):
    """Slows down, turns away, or stops and turns, depending on the nearest obstacle."""

    name = "avoid"
    reacts_to = Obstacles
    critical_for = (WHEELS,)
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

    def __init__(self, identity: agent.Identity, parameters: Parameters | None = None) -> None:
        super().__init__(identity, parameters)
        self._side = 0.0  # +1 left, -1 right: latched while it passes the same obstacle
        self._side_at: tuple[float, float] = (0.0, 0.0)
        self._moved_at = inf  # when the robot last moved on its mission
        self._bid_at = -inf  # when it last computed a bid: not while the robot is stopped
        self._escape_until = -inf
        self._around: tuple[float, float] = (inf, inf)  # the place that it does not leave
        self._around_since = inf
        self._turned_out = False  # of that place, or tried to
        self._back_until = -inf
        self._backs_since = inf
        self._turns_until = -inf
        self._creeps = 1.0  # +1 on, -1 back
        self._needed = (0.0, -inf)  # its last utility above 0, and when

    def on_refused(self, w: float) -> None:
        """Turn round the other way."""
        self._side = -w or self._side

    def on_mission(self) -> None:
        """Reset the latched side and the timers."""
        self._side = 0.0
        self._moved_at = self._around_since = self.now

    def propose(self, pose: Pose, obstacles: Obstacles) -> Bid | None:
        """The speeds that keep clear of obstacles, and their utility."""
        state = self.latest(RobotState)
        assert state is not None, "a bid needs robot/state"
        if self.p.rules == "safe":
            return self._safe(obstacles, pose, state)
        bid = literal(obstacles, state.v, self.body.outline, self.p)
        if bid is None:
            self.why = "nothing in the way"
        return bid

    def rate(self, bid: Bid | None, actions: Sequence[Speeds]) -> Sequence[float]:
        """By the free way on each arc; the nearer to its bid, the better, where it has one."""
        obstacles = self.fresh(Obstacles)
        if obstacles is None or self._body is None:
            return ()
        margin = self.p.safety.margin_m
        free = open_ways(obstacles.points, self.body, actions, margin, self.p.reach_m)
        if bid is None or bid.utility <= 0.0:
            return free
        share, wish = bid.utility, near(speeds_of(bid), actions)
        pairs = zip(free, wish, strict=True)
        return [f if f <= -1.0 else (1.0 - share) * f + share * n for f, n in pairs]

    def vector(self, bid: Bid | None) -> Speeds:  # noqa: ARG002
        """Away from what is near: the faster the robot, the farther it reaches."""
        obstacles, state = self.fresh(Obstacles), self.latest(RobotState)
        if obstacles is None or state is None or self._body is None:
            return 0.0, 0.0
        sphere, margin = self.p.danger.border(state.v), self.p.safety.margin_m
        return repelled(obstacles.points, self.body.outline, sphere, margin)

    def _safe(self, obstacles: Obstacles, pose: Pose, state: RobotState) -> Bid | None:
        p, points, scene = self.p, obstacles.points, self.scene(obstacles)
        v, way = max(state.v, 0.0), self._way(pose, obstacles)
        along = self._along(points, v, state.w)
        free = min(along, self._toward(points, way))
        utility = ramp_down(free, p.stop.border(v), p.caution.border(v))
        if self._stuck(pose, state):
            utility = 1.0
        utility = self._steadied(utility)
        self._unlatch(pose)
        if utility <= 0.0:
            if self.share(WHEELS) < MOSTLY:
                self.why = "nothing in the way"
                return None
            return Bid(0.0, self._onward(scene, way.heading, v), reason="the way is free")
        action, reason = self._act(scene, way, pose, v)
        left = along - self.body.stopping_distance(v)
        within = None if left == inf else max(0.0, 0.5 * left / max(v, 0.05))
        return Bid(utility, action, critical(scene, p.safety), within, reason)

    def _steadied(self, utility: float) -> float:
        """The utility; a holder's stays for `KEEPS_S` after the way was last obstructed."""
        if utility > 0.0:
            self._needed = utility, self.now
        elif self.share(WHEELS) >= MOSTLY and self.now - self._needed[1] <= KEEPS_S:
            return self._needed[0]
        return utility

    def _along(self, points: Sequence[Point], v: float, w: float) -> float:
        """The free distance on the present arc, m; infinite while it turns on the spot.

        It does, too, while its inner wheel turns backwards. Otherwise avoid would take the wheels
        from an agent that turns round beside a wall, stop the motion ahead, and release them.
        """
        if v <= ON_THE_SPOT_M_S or v < abs(w) * self.body.outline.half_width:
            return inf
        return free_path(points, v, w, self.body.outline, self.p.safety.margin_m)

    def _toward(self, points: Sequence[Point], way: Way) -> float:
        """The free distance where the trajectory leads, m, after turning there.

        While avoid holds the wheels this counts at any angle. Otherwise it would release them after
        turning away, and the next holder would turn back. Before, obstacles far aside do not count.
        """
        limit_angle = self.p.let_go if self.share(WHEELS) >= MOSTLY else self.p.u_heading_low
        if abs(way.heading) > limit_angle:
            return inf
        turned = rotated(points, way.heading)
        free = free_path(turned, 1.0, 0.0, self.body.outline, self.p.safety.margin_m)
        return free if free < way.bend_m else inf

    def _act(self, scene: Scene, way: Way, pose: Pose, v: float) -> tuple[tuple[float, float], str]:
        """The action in the zone of the open heading: slow down; also turn; stop and turn."""
        p, points, outline = self.p, scene.points, self.body.outline
        if self.now < self._back_until and (back := self._back(scene)) is not None:
            return back, "back off and try again"
        heading = self._heading(points, way, pose)
        if heading is None:
            return self._turn_on_the_spot(scene, way.heading), "shut in: look for a way out"
        free = free_path(rotated(points, heading), 1.0, 0.0, outline, TURN_MARGIN_M)
        now = free_path(points, 1.0, 0.0, outline, TURN_MARGIN_M)
        speed, zone = self._zone(min(free, now), v)
        speed *= max(0.0, cos(heading))
        if zone == "stop" or abs(heading) > p.turn_first:
            speed = 0.0 if abs(heading) > p.aligned else min(speed, p.v_danger)
        w = max(-p.w_max, min(p.w_max, p.turn_gain * heading))
        speed, w = self.limited_in(scene, speed, w, p.safety)
        if self.refuses(speed, w):
            return self._turn_on_the_spot(scene, heading), "the robot agent refuses the motion"
        degrees = heading * 180 / pi
        turns = speed < 0.02
        self._turned_out |= turns and self.now < self._escape_until
        if turns and abs(w) < 0.05:
            return self._turn_on_the_spot(scene, heading), f"{zone}: turn out to {degrees:.0f} deg"
        return (speed, w), f"{zone}: open at {degrees:.0f} deg"

    def _zone(self, free: float, v: float) -> tuple[float, str]:
        """The speed for a free distance, m/s, and the zone's name."""
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
        """The open heading with the least cost: angles to the path and to the present heading, fit.

        The side on which an obstacle is passed is latched: the other side must be much better.
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
        """Whether the robot makes no progress far from its goal: then avoid frees it.

        The holder may see no way and command nothing, without an obstacle in *its* way, or two
        holders may turn the robot to and fro. If the robot obeys no agent, avoid cannot help.
        """
        ack = self.acked(WHEELS)
        at = None if ack is None or ack.obeyed is None else ack.obeyed_cycle
        driven = at is not None and self.cycles.fresh(at)
        idle, self._bid_at = self.now - self._bid_at > BID_GAP_S, self.now
        near = ON_GOAL_M < self.route.to_go(pose.x, pose.y) < self.p.goal_m
        excused = idle or near or not driven
        self._update_rest(
            excused or abs(state.v) > 0.02 * self.pose_confidence or abs(state.w) > 0.05
        )
        self._update_place(pose, excused)
        self._update_stall(state.stalled)
        return self.now < max(self._escape_until, self._back_until)

    def _update_rest(self, moving: bool) -> None:
        if moving:
            self._moved_at = self.now
        elif self.now - self._moved_at > self.p.stuck_s:
            self._moved_at = self.now
            if self._turned_out:  # too near to an obstacle, or another agent turned it back
                self._back_off()
            else:
                self._escape_until = self.now + self.p.escape_s

    def _update_place(self, pose: Pose, excused: bool) -> None:
        away = hypot(pose.x - self._around[0], pose.y - self._around[1])
        if away > self.p.nowhere_m:
            self._around, self._around_since = (pose.x, pose.y), self.now
            self._turned_out = False
        elif excused:
            self._around_since = self.now
        elif self.now - self._around_since > self.p.nowhere_s / self.pose_confidence:
            self._around_since = self.now
            self._back_off()

    def _update_stall(self, stalled: bool) -> None:
        """Back off from an obstacle that stalls the wheels, at an unknown place of the footprint.

        A robot that turns may push it with a corner for as long as it turns. The way it came is
        free. If it stalls on that, too, it turns for as long before it tries again.
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
        """The speeds straight back, if there is free distance behind."""
        mirrored = [Point(-p.x, p.y) for p in scene.points]
        behind = free_path(mirrored, 1.0, 0.0, self.body.outline.turned_round, BACK_MARGIN_M)
        if behind <= self.p.back_room_m:
            return None
        v, w = self.limited_in(scene, -self.p.v_back, 0.0, self.p.safety)
        return (v, w) if v < 0.0 and not self.refuses(v, w) else None

    def _unlatch(self, pose: Pose) -> None:
        """Clear the side once the passed obstacle is far behind and avoid does not hold."""
        away = hypot(pose.x - self._side_at[0], pose.y - self._side_at[1])
        if self._side and self.share(WHEELS) < MOSTLY and away > 1.0:
            self._side = 0.0

    def _turn_on_the_spot(self, scene: Scene, heading: float) -> tuple[float, float]:
        """Turn to the side of the open heading, or to the other; else back off, else creep."""
        sign = self._side or copysign(1.0, heading)
        for direction in (sign, -sign):
            room = free_turn(scene.points, direction, self.body.outline, TURN_MARGIN_M)
            if room > self.p.safety.turn_room:
                v, w = self.limited_in(scene, 0.0, direction * self.p.w_stop, self.p.safety)
                if w != 0.0 and not self.refuses(v, w):
                    return v, w
        if (back := self._back(scene)) is None:
            return self._creep(scene)
        self._back_off()  # for a while: the way of one cycle makes no room to turn
        return back

    def _creep(self, scene: Scene) -> tuple[float, float]:
        """Straight on, or straight back, along a wall that is too near for anything else.

        It goes on until it can turn, and the other way once that is blocked.
        """
        for creeps in (self._creeps, -self._creeps):
            v, _ = self.limited_in(scene, creeps * self.p.v_back, 0.0, self.p.safety)
            if abs(v) >= 0.5 * self.p.v_back and not self.refuses(v, 0.0):
                self._creeps = creeps
                return v, 0.0
        return 0.0, 0.0

    def _onward(self, scene: Scene, wanted: float, v: float) -> tuple[float, float]:
        """The command for the cycle or two until another agent takes over."""
        w = max(-self.p.w_max, min(self.p.w_max, self.p.turn_gain * wanted))
        return self.limited_in(scene, v, w, self.p.safety)

    def _way(self, pose: Pose, obstacles: Obstacles) -> Way:
        """Where the trajectory leads; it bends or ends if its point is nearer than `ahead_m`."""
        cut = corner_cut(obstacles, self.body, self.p.cut_least_m)
        target = self.route.ahead(pose.x, pose.y, self.p.ahead_m, cut)[0]
        dx, dy = target.x - pose.x, target.y - pose.y
        away = hypot(dx, dy)
        bends = away < 0.99 * self.p.ahead_m
        return Way(wrap(atan2(dy, dx) - pose.theta), away if bends else inf)
