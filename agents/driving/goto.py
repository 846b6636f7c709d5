"""The goto agent: drives the robot to the goal pose (thesis 3.5.1, 4.6)."""

from __future__ import annotations

from collections.abc import Sequence
from math import atan2, cos, hypot, inf, radians, sin
from typing import Annotated, ClassVar, Literal

from msgspec import Meta
from msgspec.structs import replace

from armadico.agents.driving.brisk import Driver, slowed
from armadico.agents.methods.controllers import SETTINGS, Controller, Law, Mode, Settings
from armadico.agents.methods.settings import Brisk
from armadico.agents.methods.utility import ramp_down
from armadico.core import agent
from armadico.core.exchange import Bid
from armadico.core.parameters import Safety
from armadico.core.resources import WHEELS
from armadico.mobile.behaviour import CREEP_M, MOSTLY, Behaviour
from armadico.mobile.geometry import wrap
from armadico.mobile.messages import Pose, Waypoint
from armadico.mobile.motion import Body, Speeds
from armadico.mobile.obstacles import Obstacles
from armadico.mobile.offers import near, onward, speeds_of
from armadico.mobile.safety import corner_cut, unhurried

Speed = Annotated[float, Meta(gt=0, le=10)]
Metres = Annotated[float, Meta(gt=0, le=10)]
Angle = Annotated[float, Meta(gt=0, le=3.1416)]
Share = Annotated[float, Meta(ge=0, le=1)]


ARRIVED = 0.01
"""Length of the vector at the goal, which only has to turn the robot."""


class Parameters(agent.Parameters, frozen=True, kw_only=True):
    """Goto's parameters.

    `controller` "brisk" is faster and has its own settings (`brisk`); the parameter set `brisk`
    selects it. The others are the thesis's, with `settings`, ahead_m, park_m, cut_least_m and calm.

    `rules` "thesis" follows 3.10.1 literally: utility by the distance to each waypoint, straight to
    the waypoint, both controllers mixed near each (5.2.1), obstacles ignored. "safe" measures to
    the final goal, keeps to the line between waypoints, and drives no faster than it can stop.
    """

    controller: Literal["brisk", "fast", "precise", "collaborative"] = "collaborative"
    settings: Literal["chapter-5", "chapter-4"] = "chapter-5"
    rules: Literal["safe", "thesis"] = "safe"
    v_max: Speed | None = None
    ahead_m: Metres = 0.6  # look-ahead on the line between waypoints
    park_m: Metres = 1.0  # within this of the goal it drives straight to it, mixing in `precise`
    cut_least_m: Metres = 0.06  # by how much it may cut a corner near obstacles
    calm_from: Angle = radians(5)  # it slows down from this angle to its target
    calm_over: Angle = radians(30)  # angle beyond `calm_from` at which the speed reaches 0
    calm_least: Share = 0.2  # least share of the speed: it must progress while it turns
    brisk: Brisk = Brisk()
    safety: Safety = Safety()
    p_max: Share = 1.0  # equation 3.6
    p_min: Share = 0.6
    u_low_m: Metres = 0.15
    u_high_m: Metres = 0.5


class Goto(Behaviour):
    """Proposes the speeds that follow the trajectory and park at its end."""

    name = "goto"
    reacts_to = Pose
    parameters = Parameters
    launched_with: ClassVar[tuple[str, ...]] = ("controller", "v_max", "safety.unmapped")
    changeable: ClassVar = {
        "v_max": "m/s",
        "ahead_m": "m",
        "park_m": "m",
        "calm_least": "",
        "safety.margin_m": "m",
        "safety.slow": "m/s",
    }
    p: Parameters

    def __init__(self, identity: agent.Identity, parameters: Parameters | None = None) -> None:
        super().__init__(identity, parameters)
        brisk = self.p.controller == "brisk"
        self._driver = Driver(self.p.brisk) if brisk else None
        mode = Mode.COLLABORATIVE if brisk else Mode(self.p.controller)
        self._controller = Controller(SETTINGS[self.p.settings], mode)
        self._controller.mixes_on_the_way = self.p.rules == "thesis"
        self._commanded = (0.0, 0.0)

    def on_body(self) -> None:
        self._controller.settings = within(SETTINGS[self.p.settings], self.body, self.p.v_max)
        if self._driver is not None:
            self._driver.settings = slowed(self.p.brisk, self.body, self.p.v_max)

    def on_mission(self) -> None:
        self._controller.reset()
        if self._driver is not None:
            self._driver.reset()

    def propose(self, pose: Pose, obstacles: Obstacles) -> Bid | None:
        """The speeds along the trajectory, and their utility."""
        wanted = v, w = self._desired(pose, obstacles)
        held = False
        if self.p.rules == "safe":
            v, w = self.limited(v, w, obstacles, self.p.safety)
            # Where an obstacle lets it do nothing, the largest bid would keep others from freeing
            # it. The robot agent's readings may show one that the obstacles do not.
            held = (v == w == 0.0 and any(wanted)) or self.refuses(v, w)
        self._commanded = (v, w)
        utility = self.p.p_min if held else self._utility(pose)
        return Bid(utility, (v, w), reason=self._reason(pose, v, w))

    def rate(self, bid: Bid | None, actions: Sequence[Speeds]) -> Sequence[float]:
        """By progress and heading; near the goal, where it parks, by its bid."""
        pose, obstacles, goal = self.fresh(Pose), self.fresh(Obstacles), self.route.goal
        if bid is None or pose is None or obstacles is None or goal is None:
            return ()
        if self.route.last_leg and hypot(goal.x - pose.x, goal.y - pose.y) <= self.p.park_m:
            return near(speeds_of(bid), actions)
        to = self._ahead(pose, obstacles)[0]
        bearing = wrap(atan2(to.y - pose.y, to.x - pose.x) - pose.theta)
        return onward(bearing, self._controller.settings.fast.v, actions)

    def vector(self, bid: Bid | None) -> Speeds:
        """Towards the point that it steers to, shorter near the goal; there its heading."""
        pose, obstacles, goal = self.fresh(Pose), self.fresh(Obstacles), self.route.goal
        if bid is None or pose is None or obstacles is None or goal is None:
            return 0.0, 0.0
        off = hypot(goal.x - pose.x, goal.y - pose.y)
        length = min(off / self.p.u_high_m, 1.0)
        to = self._ahead(pose, obstacles)[0]
        heading = atan2(to.y - pose.y, to.x - pose.x)
        close = self.route.last_leg and off <= self._controller.settings.leave_m
        if close and speeds_of(bid)[0] == 0.0:  # it has arrived, and turns on the spot
            length, heading = ARRIVED, goal.theta
        turn = wrap(heading - pose.theta)
        return length * cos(turn), length * sin(turn)

    def _reason(self, pose: Pose, v: float, w: float) -> str:
        """Where it drives to; that it stands beside the goal, if it cannot know the way there."""
        goal = self.route.goal
        assert goal is not None, "there is a goal"
        off = hypot(goal.x - pose.x, goal.y - pose.y)
        if (
            self.route.last_leg
            and self._controller.settings.leave_m < off <= pose.deviation
            and v == w == 0.0
        ):
            return f"{off:.2f} m from the goal, and the pose is known to +-{pose.deviation:.2f} m"
        return f"to waypoint {self.route.leg + 1} of {len(self.route.waypoints)}"

    def _desired(self, pose: Pose, obstacles: Obstacles) -> Speeds:
        """The controller's speeds before any limit by obstacles."""
        before = self._commanded if self.share(WHEELS) >= MOSTLY else self.measured
        period = self.body.cycle_s
        if self._driver is not None:
            cut = corner_cut(obstacles, self.body, self.p.brisk.cut_m)
            self._driver.off_m = pose.deviation
            v, w = self._driver.steer(pose, self.measured, before, self.route, cut, period)
            v = min(v, self._at_sight(pose, obstacles))
            return unhurried(v, w, self.scene(obstacles), self.p.safety), w
        ahead = self._ahead(pose, obstacles)
        controller = self._controller
        controller.off_m, controller.off_rad = pose.deviation, pose.heading_deviation
        v, w = controller.steer(pose, ahead, before, period)
        return (min(v, self._calm(pose, ahead[0])) if self.p.rules == "safe" else v), w

    def _at_sight(self, pose: Pose, obstacles: Obstacles) -> float:
        """The speed from which it can stop within the visible part of its path, m/s."""
        reach, body = self.p.brisk.sight_m, self.body
        if reach is None:
            return inf
        seen = self.seen_ahead(pose, obstacles.points, reach)
        free = seen - body.outline.front - self.p.safety.margin_m
        return body.stops_within(max(free, CREEP_M))

    def _calm(self, pose: Pose, target: Waypoint) -> float:
        """The speed limit while the robot turns to its target, m/s.

        At full speed it would swing wide of the line, and beside a door hit the post.
        """
        off = abs(wrap(atan2(target.y - pose.y, target.x - pose.x) - pose.theta))
        share = 1.0 - (off - self.p.calm_from) / self.p.calm_over
        return self._controller.settings.fast.v * min(max(share, self.p.calm_least), 1.0)

    def _ahead(self, pose: Pose, obstacles: Obstacles) -> list[Waypoint]:
        """What to steer along: the remaining waypoints, or points on the line between them."""
        route, goal = self.route, self.route.goal
        assert goal is not None, "there is a goal"
        parking = route.last_leg and hypot(goal.x - pose.x, goal.y - pose.y) <= self.p.park_m
        if self.p.rules == "thesis" or parking:
            return list(route.waypoints[route.leg :])
        cut = corner_cut(obstacles, self.body, self.p.cut_least_m)
        return route.ahead(pose.x, pose.y, self.p.ahead_m, cut)

    def _utility(self, pose: Pose) -> float:
        """Equation 3.6."""
        p, goal = self.p, self.route.goal
        assert goal is not None, "there is a goal"
        if p.rules == "thesis":
            target = self.route.target
            assert target is not None, "there is a goal"
            left = hypot(target.x - pose.x, target.y - pose.y)
        elif self.route.last_leg:
            left = hypot(goal.x - pose.x, goal.y - pose.y)
        else:
            left = p.u_high_m
        return ramp_down(left, p.u_low_m, p.u_high_m, p.p_max, p.p_min)


def within(settings: Settings, body: Body, v_max: float | None) -> Settings:
    """The controllers' settings within a robot's limits, with its ramps if they have ramps.

    `v_max` is a scenario's limit for the fast controller, m/s.
    """

    def law(of: Law, most: float) -> Law:
        return replace(of, v=min(of.v, most, body.v_max), w=min(of.w, body.w_max))

    made = replace(
        settings,
        fast=law(settings.fast, inf if v_max is None else v_max),
        precise=law(settings.precise, inf),
    )
    if made.v_accel == inf:  # chapter 4 drives without ramps
        return made
    return replace(made, v_accel=body.v_accel, v_decel=body.v_decel, w_accel=body.w_accel)
