"""The gothrough agent: keeps the robot in the middle of narrow places (thesis 3.5.3, 3.10.1)."""

from __future__ import annotations

from math import atan2, cos, hypot, radians, sin
from typing import Annotated, ClassVar, Literal

from msgspec import Meta

from armadico.agents.driving.brisk import Driver, slowed
from armadico.agents.methods.controllers import ahead_of
from armadico.agents.methods.geometry import clip
from armadico.agents.methods.settings import Brisk
from armadico.agents.methods.utility import ramp_down
from armadico.core import agent
from armadico.core.exchange import Bid
from armadico.core.messages import Point
from armadico.core.parameters import Safety
from armadico.core.resources import WHEELS
from armadico.mobile.behaviour import MOSTLY, Behaviour
from armadico.mobile.geometry import wrap
from armadico.mobile.messages import Pose, Waypoint
from armadico.mobile.motion import Speeds
from armadico.mobile.obstacles import Obstacles
from armadico.mobile.safety import corner_cut, unhurried
from armadico.mobile.swept_path import free_path

Positive = Annotated[float, Meta(gt=0, le=10)]

KEEPS = 0.5
"""The holder keeps the wheels down to this share of `clear_m`, since readings vary."""


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """Gothrough's parameters.

    `controller` "proportional" uses v, turn_gain, w_max, gain and v_corner; "brisk" turns and slows
    down as goto's.

    `rules` "thesis" bids whenever obstacles are on both sides. "safe" does not bid if the passage
    is not clear, if the trajectory does not lead through it, or near the goal.
    """

    controller: Literal["proportional", "brisk"] = "proportional"
    rules: Literal["safe", "thesis"] = "safe"
    v_max: Positive | None = None
    v: Positive = 0.5  # m/s through a narrow place
    turn_gain: Positive = 1.5  # rad/s for one rad
    w_max: Positive = radians(50)
    u_low_m: Positive = 0.5  # equation 3.7
    u_high_m: Positive = 1.2
    least_m: Positive = 0.3  # least distance from the narrowest place to the target point
    most_m: Positive = 1.0  # greatest distance from there to that point
    clear_m: Positive = 0.6  # least free distance for a bid
    astray: Positive = radians(45)  # greatest angle to the trajectory's direction
    goal_m: Positive = 0.8  # nearer to the goal than this, goto parks
    ahead_m: Positive = 1.0
    off_line: Positive = 0.15  # rad: greatest angle between the middle and the trajectory
    cut_least_m: Positive = 0.06  # by how much its corners may be cut near obstacles
    gain: Positive = 0.38  # m/s per metre to the trajectory's next bend, as goto's
    v_corner: Positive = 0.2  # least speed towards a bend, m/s
    brisk: Brisk = Brisk()
    safety: Safety = Safety()


class Gothrough(Behaviour):
    """Steers for the middle between the obstacles on the left and on the right."""

    name = "gothrough"
    reacts_to = Obstacles
    parameters = Parameters
    launched_with = ("v_max", "safety.unmapped")
    changeable: ClassVar = {
        "v_max": "m/s",
        "v": "m/s",
        "v_corner": "m/s",
        "w_max": "rad/s",
        "safety.margin_m": "m",
    }
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Parameters | None = None) -> None:
        super().__init__(identity, parameters)
        self._commanded = (0.0, 0.0)
        self._driver = Driver(self.p.brisk)
        self._ahead: list[Waypoint] = []  # the rest of the trajectory, as far as needed

    def on_body(self) -> None:
        self._driver.settings = slowed(self.p.brisk, self.body, self.p.v_max)

    def propose(self, pose: Pose, obstacles: Obstacles) -> Bid | None:
        """The speeds through the passage; the utility grows with its narrowness."""
        left, right = obstacles.left, obstacles.right
        if left is None or right is None:
            return self._none("not between two things")
        half = 0.5 * hypot(left.x - right.x, left.y - right.y)
        utility = ramp_down(half, self.p.u_low_m, self.p.u_high_m)
        if utility <= 0.0:
            return self._none("not narrow")
        goal = self._goal(pose, obstacles)
        if self.p.rules == "safe" and (why := self._abstains(pose, goal)):
            return self._none(why)
        target = self._target(left, right, goal)
        alpha = atan2(target.y, target.x)
        if self.p.rules == "safe":
            astray = atan2(goal.y, goal.x)
            alpha = clip(alpha, astray - self.p.off_line, astray + self.p.off_line)
        return self._steer(alpha, utility, pose, obstacles)

    def _none(self, why: str) -> Bid | None:
        """No bid; a holder offers the wheels while they still turn."""
        self.why = why
        if self.share(WHEELS) < MOSTLY:
            return None
        if self.p.rules == "safe":
            obstacles = self.latest(Obstacles)
            assert obstacles is not None, "the pattern sees to that"
            self._commanded = self.limited(*self._commanded, obstacles, self.p.safety)
        return Bid(0.0, self._commanded, reason=why)

    def _abstains(self, pose: Pose, goal: Point) -> str:
        """The reason why the trajectory does not lead through here, or an empty string."""
        route = self.route
        if abs(atan2(goal.y, goal.x)) > self.p.astray:
            return "the trajectory leads elsewhere"
        if route.last_leg and route.to_go(pose.x, pose.y) < self.p.goal_m:
            return "the goal is near"
        return ""

    def _goal(self, pose: Pose, obstacles: Obstacles) -> Point:
        if self.p.rules == "thesis":
            self._ahead = list(self.route.waypoints[self.route.leg :])
        else:
            cut = corner_cut(obstacles, self.body, self.p.cut_least_m)
            self._ahead = self.route.ahead(pose.x, pose.y, self.p.ahead_m, cut)
        to = self._ahead[0]
        dx, dy = to.x - pose.x, to.y - pose.y
        c, s = cos(pose.theta), sin(pose.theta)
        return Point(c * dx + s * dy, c * dy - s * dx)

    def _target(self, left: Point, right: Point, goal: Point) -> Point:
        """The middle of the way to the goal, projected onto the axis between both sides (3.5.3)."""
        mx, my = 0.5 * (left.x + right.x), 0.5 * (left.y + right.y)
        across = hypot(left.x - right.x, left.y - right.y)
        ax, ay = (left.y - right.y) / across, (right.x - left.x) / across  # square to left-right
        if ax * goal.x + ay * goal.y < 0.0:
            ax, ay = -ax, -ay
        along = 0.5 * ((goal.x - mx) * ax + (goal.y - my) * ay)
        along = min(max(along, self.p.least_m), self.p.most_m)
        return Point(mx + along * ax, my + along * ay)

    def _steer(self, alpha: float, utility: float, pose: Pose, obstacles: Obstacles) -> Bid | None:
        p = self.p
        if p.rules == "safe" and abs(alpha) > p.astray:
            return self._none("the middle is not ahead")
        brisk = p.controller == "brisk"
        v, w = self._brisk(alpha, pose) if brisk else self._proportional(alpha, pose)
        if p.rules == "safe":
            # Of the wanted arc: of a slower robot, which turns as fast, it would be another one, so
            # the holder would release as soon as it is slowed down.
            free = free_path(obstacles.points, v, w, self.body.outline, p.safety.margin_m)
            if free < (KEEPS * p.clear_m if self.share(WHEELS) >= MOSTLY else p.clear_m):
                return self._none(f"only {free:.2f} m of free way")
        if brisk:
            v = unhurried(v, w, self.scene(obstacles), p.safety)
        if p.rules == "safe":
            v, w = self.limited(v, w, obstacles, p.safety)
            if self.refuses(v, w):  # its bid would keep others from freeing the robot
                return self._none("the robot agent refuses the motion")
        self._commanded = (v, w)
        return Bid(utility, (v, w), reason=f"{utility:.2f} at {alpha:.2f} rad")

    def _brisk(self, alpha: float, pose: Pose) -> Speeds:
        before = self._commanded if self.share(WHEELS) >= MOSTLY else self.measured
        soon = self._driver.soon(pose, self.measured, before)
        off = alpha - wrap(soon.theta - pose.theta)
        return self._driver.toward(off, soon, self.route, before, self.body.cycle_s)

    def _proportional(self, alpha: float, pose: Pose) -> Speeds:
        p = self.p
        v = min(p.v, p.v_max or p.v) * max(0.2, cos(alpha))
        if p.rules == "safe":
            v = min(v, max(p.v_corner, p.gain * ahead_of(pose, self._ahead, p.v / p.gain)))
        return v, clip(p.turn_gain * alpha, -p.w_max, p.w_max)
