"""Yardsticks: classical local controllers, each of which drives alone.

A yardstick is no mechanism and arbitrates nothing. It is one agent in the place of goto, avoid and
gothrough, with the same robot, perception, trajectory and safe speed, and goto's way of parking. It
shows what a single controller reaches in the worlds in which mechanisms are compared.

Pure pursuit: Coulter, "Implementation of the pure pursuit path tracking algorithm" (1992), with the
regulated speed of Macenski, Singh, Martin and Gines, "Regulated pure pursuit for robot path
tracking" (2023). DWA: Fox, Burgard and Thrun, "The dynamic window approach to collision avoidance"
(1997).
"""

from __future__ import annotations

from itertools import product
from math import atan2, copysign, cos, hypot, inf, pi, sin
from typing import Annotated

import numpy as np
from msgspec import Meta

from armadico.agents.driving.goto import within
from armadico.agents.methods.controllers import CHAPTER_5, Controller
from armadico.agents.methods.geometry import clip
from armadico.core import agent
from armadico.core.exchange import Bid
from armadico.core.messages import Point
from armadico.core.parameters import TURN_MARGIN_M, Safety
from armadico.core.resources import WHEELS
from armadico.mobile.behaviour import MOSTLY, Behaviour
from armadico.mobile.geometry import relative, wrap
from armadico.mobile.messages import Pose
from armadico.mobile.motion import Floats, Speeds
from armadico.mobile.obstacles import Obstacles
from armadico.mobile.safety import Scene, corner_cut
from armadico.mobile.swept_path import free_path, free_turn

Positive = Annotated[float, Meta(gt=0, le=10)]
Weight = Annotated[float, Meta(ge=0, le=10)]
Samples = Annotated[int, Meta(ge=2, le=51)]

UTILITY = 0.6
"""As goto's on its way: agents that dock, search or give way take the wheels from it, too."""

TURNS_RAD_S, REFUSED_S = 0.05, 1.0
"""DWA rotates away to the other side if it has turned slower than the first, rad/s, for the second,
s: the common rules for a safe speed refuse the turn."""


class YardstickParameters(agent.Parameters, frozen=True, kw_only=True):
    """What both share; speeds are goto's."""

    v_max: Positive | None = None
    park_m: Positive = 0.6  # within this of the goal it parks by goto's controller
    cut_least_m: Positive = 0.06  # by how much it may cut a corner near obstacles, as goto
    safety: Safety = Safety()


class PurePursuitParameters(YardstickParameters, frozen=True, kw_only=True):
    """The defaults are those of Nav2's controller; `turn_first` is its minimum angle to rotate."""

    look_s: Positive = 1.5  # the look-ahead is the way of this time,
    look_least_m: Positive = 0.3  # but within these
    look_most_m: Positive = 0.9
    bend_m: Positive = 0.9  # it slows down on arcs of a smaller radius,
    near_m: Positive = 0.6  # and with an obstacle nearer than this,
    slow: Positive = 0.25  # m/s: but not below this speed
    turn_first: Annotated[float, Meta(gt=0, le=pi)] = 0.785  # rad: it turns on the spot


class DwaParameters(YardstickParameters, frozen=True, kw_only=True):
    """Window, `heading` and `velocity` are the authors'; the others are guesses.

    The authors' `clearance` is 0.2. Of 0.2, 1 and 2 the last drove most of ten worlds to the goal.
    """

    window_s: Positive = 0.25  # speeds that the ramps reach within this time
    heading: Weight = 2.0
    clearance: Weight = 2.0
    velocity: Weight = 0.2
    safety: Safety = Safety(slow=0.12)  # as avoid's, which passes what is as near, too
    look_m: Positive = 2.0  # the heading is that to the trajectory so far ahead
    reach_m: Positive = 2.0  # a free way of more is not better
    speeds: Samples = 7
    turns: Samples = 21
    away_m: Positive = 0.5  # so much free way ahead ends the authors' mode of rotating away
    away_w: Positive = 0.5  # rad/s: in that mode


class Yardstick(Behaviour):
    """Drives along the trajectory alone, and parks at its end."""

    reacts_to = Pose
    launched_with = ("v_max", "safety.unmapped")
    p: YardstickParameters

    def __init__(
        self, identity: agent.Identity, parameters: agent.Parameters | None = None
    ) -> None:
        super().__init__(identity, parameters)
        self._parking = Controller()
        self._commanded = (0.0, 0.0)

    @property
    def most(self) -> Speeds:
        """The largest (v, w), m/s and rad/s: goto's."""
        return self._parking.settings.fast.v, self._parking.settings.fast.w

    def on_body(self) -> None:
        self._parking.settings = within(CHAPTER_5, self.body, self.p.v_max)

    def on_mission(self) -> None:
        self._parking.reset()

    def propose(self, pose: Pose, obstacles: Obstacles) -> Bid | None:
        goal = self.route.goal
        assert goal is not None, "there is a goal"
        left = hypot(goal.x - pose.x, goal.y - pose.y)
        if self.route.last_leg and left <= self.p.park_m:
            before = self._commanded if self.share(WHEELS) >= MOSTLY else self.measured
            self._parking.off_m = pose.deviation
            self._parking.off_rad = pose.heading_deviation
            v, w = self._parking.steer(pose, [goal], before, self.body.cycle_s)
        else:
            most = self.body.stops_within(self.route.to_go(pose.x, pose.y))
            v, w = self.drive(pose, obstacles, min(self.most[0], most))
        v, w = self._commanded = self.limited(v, w, obstacles, self.p.safety)
        return Bid(UTILITY, (v, w), reason=f"{left:.1f} m from the goal")

    def drive(self, pose: Pose, obstacles: Obstacles, most: float) -> Speeds:
        """The speeds along the trajectory, m/s and rad/s; v is at most `most`."""
        raise NotImplementedError

    def ahead(self, pose: Pose, obstacles: Obstacles, look_m: float) -> Point:
        """The point of the trajectory so far ahead, in the body frame."""
        cut = corner_cut(obstacles, self.body, self.p.cut_least_m)
        to = self.route.ahead(pose.x, pose.y, look_m, cut)[0]
        x, y, _ = relative((pose.x, pose.y, pose.theta), (to.x, to.y, 0.0))
        return Point(x, y)


class PurePursuit(Yardstick):
    """Follows the trajectory on arcs to a point ahead, and stops for an obstacle on its arc."""

    name = "pure-pursuit"
    parameters = PurePursuitParameters
    p: PurePursuitParameters

    def drive(self, pose: Pose, obstacles: Obstacles, most: float) -> Speeds:
        p, outline = self.p, self.body.outline
        look = clip(p.look_s * self.measured[0], p.look_least_m, p.look_most_m)
        to = self.ahead(pose, obstacles, look)
        bearing = atan2(to.y, to.x)
        if abs(bearing) > p.turn_first:
            fast = self._parking.settings.fast
            return 0.0, clip(fast.turn * bearing, -fast.w, fast.w)
        bend = curvature(to)
        near = min((outline.clearance(q.x, q.y) for q in obstacles.points), default=inf)
        share = min(1.0, near / p.near_m) / max(1.0, p.bend_m * abs(bend))
        v = min(most, max(self.most[0] * share, p.slow))
        free = free_path(obstacles.points, 1.0, bend, outline, p.safety.margin_m)
        v = min(v, self.body.stops_within(free) if free < inf else v)
        return v, v * bend


def curvature(to: Point) -> float:
    """Coulter's 2 y / L^2: the curvature of the arc to a point in the body frame (m), rad/m."""
    return 2.0 * to.y / max(to.x * to.x + to.y * to.y, 1e-6)


class Dwa(Yardstick):
    """Drives with the best of the speeds that it can reach, and from which it can stop.

    If it can stop with none that drives on, it rotates away until there is a way ahead.
    """

    name = "dwa"
    parameters = DwaParameters
    p: DwaParameters

    def __init__(self, identity: agent.Identity, parameters: DwaParameters | None = None) -> None:
        super().__init__(identity, parameters)
        self._away = 0.0  # +1 to the left, -1 to the right: it rotates away
        self._turned_at = 0.0  # when it last turned, in that mode

    def drive(self, pose: Pose, obstacles: Obstacles, most: float) -> Speeds:
        p, points = self.p, obstacles.points
        to = self.ahead(pose, obstacles, p.look_m)
        found = best(self.scene(obstacles), to, (most, self.most[1]), p)
        if found is not None and not any(self.limited(*found, obstacles, p.safety)):
            found = None  # the common rule for a safe speed, which looks at more than the arc
        ahead = free_path(points, 1.0, 0.0, self.body.outline, p.safety.margin_m)
        if found is not None and (not self._away or ahead >= p.away_m):
            self._away = 0.0
            return found
        if not self._away:
            nearest = min(points, key=lambda q: hypot(q.x, q.y), default=Point(1.0, 0.0))
            self._away, self._turned_at = copysign(1.0, -nearest.y), self.now
        if abs(self.measured[1]) > TURNS_RAD_S:
            self._turned_at = self.now
        elif self.now - self._turned_at > REFUSED_S:
            self._away, self._turned_at = -self._away, self.now
        return 0.0, self._away * min(p.away_w, self.most[1])


def best(scene: Scene, to: Point, most: Speeds, p: DwaParameters) -> Speeds | None:
    """The admissible (v, w) of the dynamic window with the largest objective; None: none drives on.

    The robot should get `to` a point in the body frame, m; `most` is the largest (v, w), m/s and
    rad/s.
    """
    body, (v, w), (most_v, most_w) = scene.body, scene.measured, most
    slow = clip(v - body.v_decel * p.window_s, 0.0, most_v)
    fast = clip(v + body.v_accel * p.window_s, 0.0, most_v)
    turn = body.w_accel * p.window_s
    vs = np.linspace(slow, fast, p.speeds)
    ws = np.clip(np.linspace(w - turn, w + turn, p.turns), -most_w, most_w)
    actions = list(product(vs.tolist(), ws.tolist()))
    far = p.reach_m + hypot(max(body.outline.front, body.outline.rear), body.outline.half_width)
    near = scene._replace(points=[q for q in scene.points if hypot(q.x, q.y) <= far])
    free = np.array([free_way(near, each, p.safety.margin_m) for each in actions])
    can_stop = free >= [body.stopping_distance(a, scene.age) for a, _ in actions]
    if not can_stop[len(ws) if vs[0] == 0.0 else 0 :].any():
        return None
    objective = (
        p.heading * np.array([_heading(scene, to, each) for each in actions])
        + p.clearance * np.minimum(free / p.reach_m, 1.0)
        + p.velocity * np.array([a for a, _ in actions]) / max(most_v, 1e-3)
    )
    objective[~can_stop] = 0.0  # and so worse for its neighbours: more room beside obstacles
    smooth = _smoothed(objective.reshape(len(vs), len(ws))).ravel()
    smooth[~can_stop] = -inf
    return actions[int(np.argmax(smooth))]


def free_way(scene: Scene, action: Speeds, margin: float) -> float:
    """The free way on the arc of (v, w), m; 0 on the spot, negative if it cannot turn there."""
    (v, w), outline = action, scene.body.outline
    if v > 0.0:
        return free_path(scene.points, v, w, outline, margin)
    free = free_turn(scene.points, copysign(1.0, w), outline, TURN_MARGIN_M)
    return 0.0 if free >= scene.body.stopping_turn(w, scene.age) else -1.0


def _heading(scene: Scene, to: Point, action: Speeds) -> float:
    """How well it faces the point once it has braked to rest: 1, and 0 with its back to it."""
    v, w = action
    way = scene.body.stopping_distance(v)
    turn = copysign(scene.body.stopping_turn(w), w)
    x, y = way * cos(0.5 * turn), way * sin(0.5 * turn)
    return 1.0 - abs(wrap(atan2(to.y - y, to.x - x) - turn)) / pi


def _smoothed(values: Floats) -> Floats:
    """The mean of each value and its eight neighbours; the edge is repeated."""
    wide = np.pad(values, 1, mode="edge")
    mean: Floats = np.lib.stride_tricks.sliding_window_view(wide, (3, 3)).mean(axis=(2, 3))
    return mean
